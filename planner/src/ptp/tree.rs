//! A tree of configurations that is searched eight nodes at a time.

use crate::kernels::validity::Config;
use crate::kinematics::MAX_VARIABLES;
use akrobat_simd::{Kernel, LANES, Lanes, Row, Simd, least, run};

/// Coordinate of the places of a block that hold no node yet: farther than any node.
const NOWHERE: f32 = 1e18;

/// Nodes in blocks of eight, each block one row for each variable.
pub(super) struct Tree {
    dof: usize,
    weights: Config,
    simd: Simd,
    blocks: Vec<Row>,
    parents: Vec<u32>,
}

impl Tree {
    /// A tree of one node with room for `capacity`, so that growing does not allocate.
    pub(super) fn new(root: &Config, weights: &[f64], capacity: usize, simd: Simd) -> Self {
        let mut own = [0.0; MAX_VARIABLES];
        own.iter_mut().zip(weights).for_each(|(o, w)| *o = *w as f32);
        let mut tree = Self {
            dof: weights.len(),
            weights: own,
            simd,
            blocks: Vec::with_capacity(capacity.div_ceil(LANES) * weights.len()),
            parents: Vec::with_capacity(capacity),
        };
        tree.push(root, 0);
        tree
    }

    pub(super) fn len(&self) -> usize {
        self.parents.len()
    }

    /// Adds a node and gives its index.
    pub(super) fn push(&mut self, q: &Config, parent: usize) -> usize {
        let index = self.parents.len();
        if index.is_multiple_of(LANES) {
            self.blocks.extend(std::iter::repeat_n(Row([NOWHERE; LANES]), self.dof));
        }
        let block = index / LANES * self.dof;
        for (row, value) in self.blocks[block..].iter_mut().zip(&q[..self.dof]) {
            row.0[index % LANES] = *value;
        }
        self.parents.push(parent as u32);
        index
    }

    pub(super) fn node(&self, index: usize) -> Config {
        let mut q = [0.0; MAX_VARIABLES];
        let block = index / LANES * self.dof;
        for (value, row) in q[..self.dof].iter_mut().zip(&self.blocks[block..]) {
            *value = row.0[index % LANES];
        }
        q
    }

    /// The nearest node (the first of equals) and its weighted distance.
    pub(super) fn nearest(&self, target: &Config) -> (usize, f32) {
        let (squared, index) = run(self.simd, Nearest { tree: self, target });
        (index, squared.sqrt())
    }

    #[inline(always)]
    fn nearest_in<L: Lanes>(&self, target: &Config) -> (f32, usize) {
        let mut best = (f32::INFINITY, 0);
        for (block, rows) in self.blocks.chunks_exact(self.dof).enumerate() {
            let mut sum = L::splat(0.0);
            for (i, row) in rows.iter().enumerate() {
                let d = (L::load(row) - L::splat(target[i])) * L::splat(self.weights[i]);
                sum = sum + d * d;
            }
            if sum.less(L::splat(best.0)) != 0 {
                let mut squared = Row::default();
                sum.store(&mut squared);
                let (value, lane) = least(&squared);
                best = (value, block * LANES + lane);
            }
        }
        best
    }

    /// Configurations from node `index` to the root.
    pub(super) fn path_to_root(&self, index: usize) -> Vec<Config> {
        let mut path = vec![self.node(index)];
        let mut at = index;
        while at != 0 {
            at = self.parents[at] as usize;
            path.push(self.node(at));
        }
        path
    }
}

/// [`Tree::nearest`].
struct Nearest<'a> {
    tree: &'a Tree,
    target: &'a Config,
}

impl Kernel for Nearest<'_> {
    type Output = (f32, usize);

    #[inline(always)]
    fn run<L: Lanes>(self) -> (f32, usize) {
        self.tree.nearest_in::<L>(self.target)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    #[test]
    fn the_nearest_node_is_that_of_a_plain_search() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut draw = || -> Config {
            std::array::from_fn(|i| if i < 3 { rng.random_range(-1.0..1.0f32) } else { 0.0 })
        };
        let weights = [1.0, 2.0, 0.5];
        let nodes: Vec<Config> = (0..77).map(|_| draw()).collect();
        for simd in [Simd::Portable, Simd::detect()] {
            let mut tree = Tree::new(&nodes[0], &weights, nodes.len(), simd);
            nodes[1..].iter().for_each(|q| {
                tree.push(q, 0);
            });
            for _ in 0..100 {
                let target = draw();
                let squared = |q: &Config| {
                    (0..3).map(|i| (weights[i] as f32 * (q[i] - target[i])).powi(2)).sum::<f32>()
                };
                let expected = (0..nodes.len())
                    .min_by(|&a, &b| squared(&nodes[a]).total_cmp(&squared(&nodes[b])))
                    .unwrap();
                assert_eq!(tree.nearest(&target).0, expected);
            }
        }
    }
}
