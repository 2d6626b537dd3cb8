//! Free-space motion: RRT-Connect, shortcuts and smoothing.
//!
//! [`RobotSpace`] checks edges in lanes of eight configurations. The search counts iterations and never looks at a
//! clock, so that a seed fixes the path.

mod robot_space;
mod rrt;
mod simplify;
mod tree;

pub use robot_space::{Query, RobotSpace};

use crate::kernels::validity::Config;
use crate::kinematics::MAX_VARIABLES;

/// Where samples come from and how distances are measured.
#[derive(Debug, Clone)]
pub struct Domain {
    /// Lower bounds of samples (rad, m).
    pub lower: Vec<f64>,
    /// Upper bounds of samples (rad, m).
    pub upper: Vec<f64>,
    /// Weight of each variable in distances.
    pub weights: Vec<f64>,
}

/// How long to search, how densely to check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// Largest weighted length of a branch that one sample adds.
    pub step: f64,
    /// Weighted distance between checked configurations on an edge.
    pub resolution: f64,
    /// Samples, for each attempt.
    pub iterations: usize,
    /// Nodes of both trees together, for each attempt.
    pub nodes: usize,
    /// Random shortcuts that are tried on a path.
    pub shortcuts: usize,
    /// Rounds of corner cutting.
    pub smoothing_rounds: usize,
    /// A path is checked again this many times as densely before it is given out; where that finds a collision, the
    /// next attempt checks its edges as densely.
    pub certify: usize,
    /// Attempts, each with its own random numbers.
    pub attempts: usize,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            step: 0.8,
            resolution: 0.04,
            iterations: 10_000,
            nodes: 100_000,
            shortcuts: 40,
            smoothing_rounds: 0,
            certify: 4,
            attempts: 3,
        }
    }
}

/// A path, and what it took to find it.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Configurations from start to goal (rad, m); straight edges between them are free.
    pub path: Vec<Vec<f64>>,
    /// Samples that were drawn.
    pub iterations: usize,
    /// Nodes of both trees.
    pub nodes: usize,
}

/// Why there is no path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NoPath {
    /// The start collides.
    #[error("the start is in collision")]
    Start,
    /// The goal collides.
    #[error("the goal is in collision")]
    Goal,
    /// The budget is used up.
    #[error("no path within the iterations")]
    Budget,
}

/// Says whether straight edges are free. The search assumes that `from` is.
trait Edges {
    fn is_free(&mut self, from: &Config, to: &Config) -> bool;
}

impl Domain {
    fn dof(&self) -> usize {
        self.lower.len()
    }

    fn distance(&self, a: &Config, b: &Config) -> f32 {
        let term = |i: usize| (self.weights[i] as f32 * (a[i] - b[i])).powi(2);
        (0..self.dof()).map(term).sum::<f32>().sqrt()
    }
}

fn single(values: &[f64]) -> Config {
    let mut out = [0.0; MAX_VARIABLES];
    out.iter_mut().zip(values).for_each(|(o, v)| *o = *v as f32);
    out
}

fn mix(a: &Config, b: &Config, t: f32) -> Config {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t)
}

/// The path in double precision, its ends exactly as they were asked for.
fn exact_ends(path: &[Config], start: &[f64], goal: &[f64]) -> Vec<Vec<f64>> {
    let dof = start.len();
    let mut out: Vec<Vec<f64>> =
        path.iter().map(|x| x[..dof].iter().map(|&v| f64::from(v)).collect()).collect();
    if let Some(first) = out.first_mut() {
        first.copy_from_slice(start);
    }
    if let Some(last) = out.last_mut() {
        last.copy_from_slice(goal);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use akrobat_simd::Simd;

    /// A square whose points are checked one by one.
    struct Square {
        free: fn(f32, f32) -> bool,
    }

    impl Edges for Square {
        fn is_free(&mut self, from: &Config, to: &Config) -> bool {
            (0..=200).all(|i| {
                let x = mix(from, to, i as f32 / 200.0);
                (self.free)(x[0], x[1])
            })
        }
    }

    fn way(free: fn(f32, f32) -> bool, iterations: usize) -> Option<Vec<Config>> {
        let domain = Domain { lower: vec![0.0; 2], upper: vec![1.0; 2], weights: vec![1.0; 2] };
        let settings = Settings { step: 0.1, iterations, shortcuts: 80, ..Settings::default() };
        let ends = [single(&[0.1, 0.1]), single(&[0.9, 0.1])];
        let (mut edges, mut rng) = (Square { free }, rrt::numbers(4, 0));
        let simd = Simd::detect();
        let found =
            rrt::connect(&mut edges, &domain, &settings, &ends[0], &ends[1], &mut rng, simd)?;
        Some(simplify::simplify(&mut edges, &domain, &settings, found.path, &mut rng))
    }

    #[test]
    fn finds_the_gap_and_stays_free() {
        // A wall with a gap at its upper end.
        let wall: fn(f32, f32) -> bool = |x, y| !(0.45..0.55).contains(&x) || y > 0.8;
        let path = way(wall, 2000).unwrap();
        let (first, last) = (path[0], path[path.len() - 1]);
        assert_eq!((&first[..2], &last[..2]), (&[0.1, 0.1][..], &[0.9, 0.1][..]));
        for pair in path.windows(2) {
            for i in 0..=100 {
                let x = mix(&pair[0], &pair[1], i as f32 / 100.0);
                assert!(wall(x[0], x[1]), "{x:?}");
            }
        }
        assert!(path.len() <= 5, "shortcuts leave few corners: {}", path.len());
    }

    #[test]
    fn a_closed_wall_has_no_path() {
        assert!(way(|x, _| !(0.45..0.55).contains(&x), 300).is_none());
    }
}
