//! Free-space motion: RRT-Connect (Kuffner and LaValle, ICRA 2000) with random shortcuts.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

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

struct Tree {
    nodes: Vec<(Vec<f64>, usize)>,
}

enum Growth {
    Reached(usize),
    Advanced(usize),
    Trapped,
}

impl Space<'_> {
    fn distance(&self, a: &[f64], b: &[f64]) -> f64 {
        let terms = a.iter().zip(b).zip(&self.weights);
        terms.map(|((a, b), w)| (w * (a - b)).powi(2)).sum::<f64>().sqrt()
    }

    /// True where the straight edge from `a` (known valid) to `b` is free.
    pub fn edge_is_free(&self, a: &[f64], b: &[f64]) -> bool {
        let count = (self.distance(a, b) / self.resolution).ceil().max(1.0) as usize;
        // Bisection order finds collisions in the middle first.
        let mut order: Vec<usize> = (1..=count).collect();
        order.sort_by_key(|i| std::cmp::Reverse(i.trailing_zeros()));
        order.into_iter().all(|i| (self.valid)(&mix(a, b, i as f64 / count as f64)))
    }

    /// A path from `start` to `goal`, both valid, ends included; `None` within `iterations`.
    pub fn plan(
        &self,
        start: &[f64],
        goal: &[f64],
        iterations: usize,
        seed: u64,
    ) -> Option<Vec<Vec<f64>>> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        if self.edge_is_free(start, goal) {
            return Some(vec![start.to_vec(), goal.to_vec()]);
        }
        let mut trees = [Tree::new(start), Tree::new(goal)];
        for iteration in 0..iterations {
            let (from, to) = (iteration % 2, 1 - iteration % 2);
            let target: Vec<f64> = self
                .lower
                .iter()
                .zip(&self.upper)
                .map(|(&low, &high)| rng.random_range(low..=high))
                .collect();
            let (Growth::Reached(new) | Growth::Advanced(new)) =
                self.extend(&mut trees[from], &target)
            else {
                continue;
            };
            let bridge = trees[from].nodes[new].0.clone();
            loop {
                match self.extend(&mut trees[to], &bridge) {
                    Growth::Advanced(_) => {}
                    Growth::Trapped => break,
                    Growth::Reached(other) => {
                        let mut path = trees[0].path_to(if from == 0 { new } else { other });
                        path.reverse();
                        path.extend(
                            trees[1]
                                .path_to(if from == 0 { other } else { new })
                                .into_iter()
                                .skip(1),
                        );
                        return Some(self.shortcut(path, &mut rng));
                    }
                }
            }
        }
        None
    }

    fn extend(&self, tree: &mut Tree, target: &[f64]) -> Growth {
        let near = tree.nearest(self, target);
        let from = tree.nodes[near].0.clone();
        let distance = self.distance(&from, target);
        let reaches = distance <= self.step;
        let to = if reaches { target.to_vec() } else { mix(&from, target, self.step / distance) };
        if !self.edge_is_free(&from, &to) {
            return Growth::Trapped;
        }
        tree.nodes.push((to, near));
        let index = tree.nodes.len() - 1;
        if reaches { Growth::Reached(index) } else { Growth::Advanced(index) }
    }

    /// Replaces random stretches by straight edges, then drops waypoints that are not needed.
    fn shortcut(&self, mut path: Vec<Vec<f64>>, rng: &mut ChaCha8Rng) -> Vec<Vec<f64>> {
        for _ in 0..80 {
            if path.len() < 3 {
                break;
            }
            let a = rng.random_range(0..path.len() - 2);
            let b = rng.random_range(a + 2..path.len());
            let (u, v) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
            let from = if a == 0 { path[0].clone() } else { mix(&path[a], &path[a + 1], u) };
            let to =
                if b + 1 == path.len() { path[b].clone() } else { mix(&path[b - 1], &path[b], v) };
            if self.edge_is_free(&from, &to) {
                let mut shorter = path[..=a].to_vec();
                if a > 0 {
                    shorter.push(from);
                }
                if b + 1 < path.len() {
                    shorter.push(to);
                }
                shorter.extend_from_slice(&path[b..]);
                path = shorter;
            }
        }
        let mut index = 1;
        while index + 1 < path.len() {
            if self.edge_is_free(&path[index - 1], &path[index + 1]) {
                path.remove(index);
            } else {
                index += 1;
            }
        }
        path
    }
}

impl Tree {
    fn new(root: &[f64]) -> Self {
        Self { nodes: vec![(root.to_vec(), 0)] }
    }

    fn nearest(&self, space: &Space<'_>, target: &[f64]) -> usize {
        let distance = |i: &usize| space.distance(&self.nodes[*i].0, target);
        (0..self.nodes.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    }

    /// Configurations from node `index` to the root.
    fn path_to(&self, index: usize) -> Vec<Vec<f64>> {
        let mut path = vec![self.nodes[index].0.clone()];
        let mut at = index;
        while at != 0 {
            at = self.nodes[at].1;
            path.push(self.nodes[at].0.clone());
        }
        path
    }
}

fn mix(a: &[f64], b: &[f64], t: f64) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a + (b - a) * t).collect()
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
                assert!(wall(&mix(&pair[0], &pair[1], i as f64 / 100.0)));
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
