//! Free-space problems whose configurations are checked one by one by a closure.

use super::rrt::{connect, numbers};
use super::simplify::simplify;
use super::{Domain, Edges, Settings, exact_ends, single};
use crate::kernels::lanes::Simd;
use crate::kernels::validity::Config;

/// A free-space problem: limits for sampling, a metric, and a validity check of configurations.
pub struct Space<'a> {
    /// Lower bounds of samples.
    pub lower: Vec<f64>,
    /// Upper bounds of samples.
    pub upper: Vec<f64>,
    /// Weight of each coordinate in distances.
    pub weights: Vec<f64>,
    /// True for configurations without collision.
    pub valid: &'a (dyn Fn(&[f64]) -> bool + Sync),
    /// Weighted length of a step of a tree.
    pub step: f64,
    /// Weighted distance of checks along an edge.
    pub resolution: f64,
}

/// Random shortcuts that are tried on a path.
const SHORTCUTS: usize = 80;

struct ByConfiguration<'a> {
    domain: &'a Domain,
    valid: &'a (dyn Fn(&[f64]) -> bool + Sync),
    resolution: f64,
}

impl Edges for ByConfiguration<'_> {
    fn is_free(&mut self, from: &Config, to: &Config) -> bool {
        let distance = f64::from(self.domain.distance(from, to));
        let count = (distance / self.resolution).ceil().max(1.0) as usize;
        let dof = self.domain.dof();
        let at = |i: usize| -> Vec<f64> {
            let t = i as f64 / count as f64;
            let mix = |(a, b): (&f32, &f32)| f64::from(*a) + (f64::from(*b) - f64::from(*a)) * t;
            from[..dof].iter().zip(&to[..dof]).map(mix).collect()
        };
        // Bisection order finds collisions in the middle first.
        let mut order: Vec<usize> = (1..=count).collect();
        order.sort_by_key(|i| std::cmp::Reverse(i.trailing_zeros()));
        order.into_iter().all(|i| (self.valid)(&at(i)))
    }
}

impl Space<'_> {
    fn domain(&self) -> Domain {
        Domain {
            lower: self.lower.clone(),
            upper: self.upper.clone(),
            weights: self.weights.clone(),
        }
    }

    /// True where the straight edge from `a` (known valid) to `b` is free.
    pub fn edge_is_free(&self, a: &[f64], b: &[f64]) -> bool {
        let domain = self.domain();
        let (valid, resolution) = (self.valid, self.resolution);
        ByConfiguration { domain: &domain, valid, resolution }.is_free(&single(a), &single(b))
    }

    /// A path from `start` to `goal`, both valid, ends included; `None` within `iterations`.
    pub fn plan(
        &self,
        start: &[f64],
        goal: &[f64],
        iterations: usize,
        seed: u64,
    ) -> Option<Vec<Vec<f64>>> {
        let domain = self.domain();
        let settings = Settings {
            step: self.step,
            iterations,
            shortcuts: SHORTCUTS,
            smoothing_rounds: 0,
            ..Settings::default()
        };
        let (valid, resolution) = (self.valid, self.resolution);
        let mut edges = ByConfiguration { domain: &domain, valid, resolution };
        let mut rng = numbers(seed, 0);
        let ends = [single(start), single(goal)];
        let simd = Simd::detect();
        let found = connect(&mut edges, &domain, &settings, &ends[0], &ends[1], &mut rng, simd)?;
        let path = simplify(&mut edges, &domain, &settings, found.path, &mut rng);
        Some(exact_ends(&path, start, goal))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(x: &[f64]) -> bool {
        // A wall at 0.45..0.55 with a gap above 0.8.
        !(0.45..0.55).contains(&x[0]) || x[1] > 0.8
    }

    fn space(valid: &(dyn Fn(&[f64]) -> bool + Sync)) -> Space<'_> {
        Space {
            lower: vec![0.0; 2],
            upper: vec![1.0; 2],
            weights: vec![1.0; 2],
            valid,
            step: 0.1,
            resolution: 0.01,
        }
    }

    #[test]
    fn finds_the_gap_and_stays_free() {
        let space = space(&wall);
        let path = space.plan(&[0.1, 0.1], &[0.9, 0.1], 2000, 4).unwrap();
        assert_eq!(
            (path[0].as_slice(), path.last().unwrap().as_slice()),
            (&[0.1, 0.1][..], &[0.9, 0.1][..])
        );
        for pair in path.windows(2) {
            for i in 0..=100 {
                let t = f64::from(i) / 100.0;
                let x: Vec<f64> =
                    pair[0].iter().zip(&pair[1]).map(|(a, b)| a + (b - a) * t).collect();
                assert!(wall(&x));
            }
        }
        assert!(path.len() <= 5, "shortcuts leave few corners: {}", path.len());
    }

    #[test]
    fn a_closed_wall_has_no_path() {
        let closed = |x: &[f64]| !(0.45..0.55).contains(&x[0]);
        assert!(space(&closed).plan(&[0.1, 0.1], &[0.9, 0.1], 300, 4).is_none());
    }
}
