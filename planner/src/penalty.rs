//! cuRobo's recipe inside our kernels, so that algorithm and speed of code can be told apart.
//!
//! Every waypoint between start and goal is free; the anchor, clearances and joint limits are penalties; 100
//! iterations of L-BFGS with four points in each line search from 12 seeds, of which the best that keeps the tolerances
//! is taken afterwards (Sundaralingam et al., *cuRobo: Parallelized Collision-Free Minimum-Jerk Robot Motion
//! Generation*, 2023). [`crate::trajopt`] is what planning uses by default.

use nalgebra::Vector6;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::lbfgs::{self, Settings};
use crate::trajopt::{Problem, Waypoints};

/// Seeds of each pair of start and goal: the straight line, and lines that are bent at random.
const SEEDS: usize = 12;
const BEND: f64 = 0.3;
const SETTINGS: Settings<'_> = Settings {
    iterations: 100,
    history: 15,
    step_lengths: &[0.01, 0.3, 0.7, 1.0],
    longest_step: 0.2,
};
/// Weights of the squared displacement of the anchor (1/m^2, 1/rad^2) and of squared clearance hinges (1/m^2).
const ANCHOR_WEIGHT: f64 = 3e4;
const CLEARANCE_WEIGHT: f64 = 4e4;
/// Tolerances of the filter: the judge's (m, rad).
const ANCHOR_M: f64 = 1e-3;
const ANCHOR_RAD: f64 = 1e-2;

impl Problem<'_> {
    /// Waypoints from start to goal by cuRobo's recipe; `None` where no seed keeps the tolerances.
    pub fn optimise_by_penalties(&self, start: &[f64], goal: &[f64]) -> Option<Waypoints> {
        let mut best: Option<(f64, Waypoints)> = None;
        for seed in 0..SEEDS {
            let mut path = self.bent_line(start, goal, seed as u64);
            let value = self.descend(&mut path);
            if best.as_ref().is_none_or(|(least, _)| value < *least) && self.keeps_tolerances(&path)
            {
                best = Some((value, path));
            }
        }
        best.map(|(_, path)| path)
    }

    /// The straight line from start to goal, bent at random by all seeds but the first.
    fn bent_line(&self, start: &[f64], goal: &[f64], seed: u64) -> Waypoints {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let reach = if seed == 0 { 0.0 } else { BEND };
        let bends: Vec<f64> = start.iter().map(|_| rng.random_range(-1.0..=1.0) * reach).collect();
        let last = self.config.waypoints - 1;
        let at = |step: usize| {
            let s = step as f64 / last as f64;
            let bulge = (std::f64::consts::PI * s).sin();
            let mut x: Vec<f64> = start.iter().zip(goal).map(|(a, b)| a + (b - a) * s).collect();
            // The object's joint stays on its way.
            x.iter_mut().zip(&bends).take(start.len() - 1).for_each(|(x, b)| *x += b * bulge);
            self.kinematics.clamp(&mut x);
            x
        };
        (0..=last).map(at).collect()
    }

    /// Minimises in place over all waypoints but the first and the last. Gives the cost.
    fn descend(&self, path: &mut Waypoints) -> f64 {
        let (dof, last) = (self.kinematics.dof(), path.len() - 1);
        let mut inner: Vec<f64> = path[1..last].concat();
        let mut cost = |inner: &[f64], gradient: &mut [f64]| {
            path[1..last].iter_mut().zip(inner.chunks(dof)).for_each(|(x, y)| x.copy_from_slice(y));
            self.penalised(path, gradient)
        };
        let value = lbfgs::minimise(&SETTINGS, &mut inner, &mut cost);
        path[1..last].iter_mut().zip(inner.chunks(dof)).for_each(|(x, y)| x.copy_from_slice(y));
        value
    }

    /// Cost of a path, and its gradient with respect to the waypoints between the ends.
    pub fn penalised(&self, path: &Waypoints, gradient: &mut [f64]) -> f64 {
        let (dof, last) = (self.kinematics.dof(), path.len() - 1);
        let mut cost = self.smoothness(path);
        for (t, own) in (1..last).zip(gradient.chunks_mut(dof)) {
            let terms = self.waypoint_terms(&path[t], CLEARANCE_WEIGHT);
            let frames = self.kinematics.forward(&path[t]);
            let anchor = self.closure.linearise(self.kinematics, &frames);
            let pull = anchor.jacobian.tr_mul(&anchor.error) * ANCHOR_WEIGHT;
            cost += terms.cost + ANCHOR_WEIGHT * anchor.error.norm_squared();
            for (i, value) in own.iter_mut().enumerate() {
                *value = 2.0 * (terms.gradient[i] + pull[i] + self.smoothness_slope(path, t, i));
            }
        }
        cost
    }

    fn keeps_tolerances(&self, path: &Waypoints) -> bool {
        let spare = self.config.clearance_m - self.config.min_clearance_m;
        path.iter().all(|x| {
            let error: Vector6<f64> = self.closure.error(&self.kinematics.forward(x));
            error.fixed_rows::<3>(0).norm() <= ANCHOR_M
                && error.fixed_rows::<3>(3).norm() <= ANCHOR_RAD
                && self.waypoint_terms(x, 1.0).largest <= spare
        })
    }
}
