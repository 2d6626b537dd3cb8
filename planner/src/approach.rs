//! The way to the grasp: from a resting configuration through free space to a pre-grasp pose, then
//! straight along the approach direction.

use akrobat_model::Robot;
use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::collision::{MovingCheck, RobotBody};
use crate::config::PlannerConfig;
use crate::dense::{Limits, timed_spline};
use crate::ik::{self, Tool};
use crate::kernels::obstacles::Obstacles;
use crate::kinematics::{Frame, Kinematics};
use crate::ptp::{Domain, Query, RobotSpace, Settings};
use crate::trajopt::smooth;
use crate::world::World;

/// Time step of sampled approaches, seconds.
pub const STEP_S: f64 = 0.03;
/// Samples of the straight reach.
const REACH_STEPS: usize = 10;
/// Resting configurations tried.
const HOME_TRIES: usize = 24;

/// Plans approaches for one robot in one world; the fingers are open, the object rests at its start.
pub struct ApproachPlanner<'a> {
    /// The robot.
    pub robot: &'a Robot,
    /// The robot compiled with open fingers; variables are base and arm.
    pub kinematics: &'a Kinematics,
    /// Its spheres.
    pub body: &'a RobotBody,
    /// Its tool.
    pub tool: &'a Tool,
    /// Distance fields.
    pub world: &'a World,
    /// Settings.
    pub config: &'a PlannerConfig,
    /// Position of the object's driven joint.
    pub object_q: f64,
    /// Horizontal direction away from the object.
    pub outward: Vector3<f64>,
}

/// Timed samples of a motion: time steps, seconds, and configurations.
pub type Timed = Vec<(f64, Vec<f64>)>;

/// Timed samples of both phases, without the first (home) and including the grasp.
#[derive(Debug, Clone)]
pub struct Approach {
    /// Where it starts.
    pub home: Vec<f64>,
    /// Free-space samples and their time steps, seconds.
    pub free: Timed,
    /// Reach samples and their time steps, seconds.
    pub reach: Timed,
}

/// The way of the open hand from one grasp to another: each part without its first sample.
#[derive(Debug, Clone)]
pub struct Transfer {
    /// Straight back from the old grasp.
    pub retreat: Timed,
    /// Through free space.
    pub free: Timed,
    /// Straight to the new grasp.
    pub reach: Timed,
}

/// Why there is no approach.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// The straight reach is out of the arm's range or collides.
    Reach,
    /// No resting configuration near the grasp is free.
    Home,
    /// Free space gave no path within the iterations.
    Path,
}

impl Failure {
    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reach => "approach_reach",
            Self::Home => "approach_home",
            Self::Path => "approach_path",
        }
    }
}

impl ApproachPlanner<'_> {
    /// Plans to the configuration `grasp` (base and arm).
    ///
    /// # Errors
    /// The step that failed.
    pub fn plan(&self, grasp: &[f64], seed: u64) -> Result<Approach, Failure> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let reach = self.reach(grasp).ok_or(Failure::Reach)?;
        let home = self.home(grasp, &mut rng).ok_or(Failure::Home)?;
        let corners = self.free_path(&home, &reach[0], seed).ok_or(Failure::Path)?;
        let free = self.timed_corners(&corners);
        Ok(Approach { home, free, reach: self.timed(&reach) })
    }

    /// Plans from a hold at `from` to one at `to` (base and arm), the object at rest.
    ///
    /// # Errors
    /// The step that failed.
    pub fn transfer(&self, from: &[f64], to: &[f64], seed: u64) -> Result<Transfer, Failure> {
        let mut retreat = self.reach(from).ok_or(Failure::Reach)?;
        let reach = self.reach(to).ok_or(Failure::Reach)?;
        let corners = self.free_path(&retreat[0], &reach[0], seed).ok_or(Failure::Path)?;
        retreat.reverse();
        Ok(Transfer {
            retreat: self.timed(&retreat),
            free: self.timed_corners(&corners),
            reach: self.timed(&reach),
        })
    }

    /// Straight back from a hold at `grasp` (base and arm) with open fingers.
    ///
    /// # Errors
    /// [`Failure::Reach`].
    pub fn retreat(&self, grasp: &[f64]) -> Result<Timed, Failure> {
        let mut retreat = self.reach(grasp).ok_or(Failure::Reach)?;
        retreat.reverse();
        Ok(self.timed(&retreat))
    }

    /// Through free space from one configuration to another.
    ///
    /// # Errors
    /// [`Failure::Path`].
    pub fn across(&self, from: &[f64], to: &[f64], seed: u64) -> Result<Timed, Failure> {
        let corners = self.free_path(from, to, seed).ok_or(Failure::Path)?;
        Ok(self.timed_corners(&corners))
    }

    fn limits(&self) -> Limits {
        Limits::of(self.robot, &[&self.robot.base_joints[..], &self.robot.arm_joints].concat())
    }

    /// Moves along a spline through `knots`.
    pub fn timed(&self, knots: &[Vec<f64>]) -> Timed {
        let clamp = |x: &mut [f64]| self.kinematics.clamp(x);
        let (samples, dt) = timed_spline(knots, &self.limits(), STEP_S, clamp);
        samples.into_iter().map(|x| (dt, x)).collect()
    }

    /// Moves from corner to corner, at rest in each.
    fn timed_corners(&self, corners: &[Vec<f64>]) -> Timed {
        let limits = self.limits();
        let mut free = Vec::new();
        for pair in corners.windows(2) {
            let delta: Vec<f64> = pair[1].iter().zip(&pair[0]).map(|(b, a)| b - a).collect();
            let duration = limits.rest_to_rest(&delta);
            let count = (duration / STEP_S).ceil().max(4.0) as usize;
            for i in 1..=count {
                let s = smooth(i as f64 / count as f64);
                let x = pair[0].iter().zip(&delta).map(|(a, d)| a + d * s).collect();
                free.push((duration / count as f64 * 1.02, x));
            }
        }
        free
    }

    /// Configurations from the pre-grasp pose to the grasp, the base at rest.
    fn reach(&self, grasp: &[f64]) -> Option<Vec<Vec<f64>>> {
        let at_grasp = self.tool.frame(&self.kinematics.forward(grasp));
        let back = at_grasp.rotation * -Vector3::z();
        let mut path = vec![grasp.to_vec()];
        for step in 1..=REACH_STEPS {
            let distance = self.config.approach_distance_m * step as f64 / REACH_STEPS as f64;
            let target = Frame { translation: at_grasp.translation + back * distance, ..at_grasp };
            let mut x = path[step - 1].clone();
            if !ik::solve(self.kinematics, self.tool, &target, &mut x, self.robot.base_joints.len())
            {
                return None;
            }
            let jump =
                x.iter().zip(&path[step - 1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let check = if step == REACH_STEPS { MovingCheck::All } else { MovingCheck::NotTool };
            if jump > 0.3 || !self.free(&x, check) {
                return None;
            }
            path.push(x);
        }
        path.reverse();
        Some(path)
    }

    fn free(&self, x: &[f64], check: MovingCheck) -> bool {
        let frames = self.kinematics.forward(x);
        let least = self.config.min_clearance_m;
        self.body.clearance(&frames, self.world, self.object_q, check, least).distance_m >= least
    }

    /// A resting configuration: the arm retracted, the base farther out (a fixed base stays).
    fn home(&self, grasp: &[f64], rng: &mut ChaCha8Rng) -> Option<Vec<f64>> {
        let base = self.robot.base_joints.len();
        let retract = &self.robot.file.arm.retract;
        (0..HOME_TRIES).find_map(|attempt| {
            let mut x = grasp.to_vec();
            // Where the folded arm is not free, later tries leave it more and more as it is at the grasp.
            let folded = (1.5 * (1.0 - attempt as f64 / (HOME_TRIES - 1) as f64)).min(1.0);
            for (q, rest) in x[base..].iter_mut().zip(retract) {
                *q += (rest - *q) * folded;
            }
            if base == 3 {
                // First tries keep their distance; later ones settle for less.
                let eagerness = 1.0 - attempt as f64 / HOME_TRIES as f64;
                let out = rng.random_range(0.1..=0.8) * eagerness;
                let side = rng.random_range(-0.3..=0.3) * eagerness;
                x[0] += self.outward.x * out - self.outward.y * side;
                x[1] += self.outward.y * out + self.outward.x * side;
                x[2] += rng.random_range(-0.5..=0.5) * eagerness;
            }
            self.kinematics.clamp(&mut x);
            self.free(&x, MovingCheck::All).then_some(x)
        })
    }

    fn free_path(&self, home: &[f64], pregrasp: &[f64], seed: u64) -> Option<Vec<Vec<f64>>> {
        let base = self.robot.base_joints.len();
        let bound = |side: fn(f64, f64) -> f64, sign: f64, limits: &[f64]| -> Vec<f64> {
            (0..home.len())
                .map(|i| {
                    // The base roams little beyond start and goal.
                    let spare = if i < base { 0.6 } else { f64::INFINITY };
                    let near = side(home[i], pregrasp[i]) + sign * spare;
                    let limit = limits[i].clamp(-4.0 * 3.2, 4.0 * 3.2);
                    if sign < 0.0 { near.max(limit) } else { near.min(limit) }
                })
                .collect()
        };
        let domain = Domain {
            lower: bound(f64::min, -1.0, self.kinematics.lower()),
            upper: bound(f64::max, 1.0, self.kinematics.upper()),
            weights: vec![1.0; home.len()],
        };
        let mut obstacles = Obstacles::new();
        obstacles.add_field(&Frame::identity(), &self.world.fixed);
        let world_from_moved = self.world.joint.world_from_moved(self.object_q);
        obstacles.add_field(&world_from_moved, &self.world.moving);
        obstacles.set_floor(self.world.floor_z);
        let settings = Settings { iterations: self.config.ptp_iterations, ..Settings::default() };
        let space = RobotSpace {
            validity: &self.body.validity(self.kinematics, self.config.min_clearance_m),
            obstacles: &obstacles,
            domain: &domain,
            settings: &settings,
        };
        let query = Query { start: home.to_vec(), goal: pregrasp.to_vec(), seed };
        space.plan(&query).ok().map(|found| found.path)
    }
}
