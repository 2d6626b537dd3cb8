//! RRT-Connect (Kuffner and LaValle, *RRT-Connect: An Efficient Approach to Single-Query Path Planning*,
//! ICRA 2000), growing whichever tree is smaller.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::tree::Tree;
use super::{Domain, Edges, Settings, mix};
use crate::kernels::validity::Config;
use crate::kinematics::MAX_VARIABLES;
use akrobat_simd::Simd;

/// A path as the search leaves it.
pub(super) struct Connection {
    pub(super) path: Vec<Config>,
    pub(super) iterations: usize,
    pub(super) nodes: usize,
}

/// Trees start with room for this many nodes.
const FIRST_ROOM: usize = 4096;

/// Connects two free configurations; `None` where the budget does not suffice.
pub(super) fn connect(
    edges: &mut impl Edges,
    domain: &Domain,
    settings: &Settings,
    start: &Config,
    goal: &Config,
    rng: &mut ChaCha8Rng,
    simd: Simd,
) -> Option<Connection> {
    if edges.is_free(start, goal) {
        return Some(Connection { path: vec![*start, *goal], iterations: 0, nodes: 2 });
    }
    let room = settings.nodes.min(FIRST_ROOM);
    let mut trees = [start, goal].map(|root| Tree::new(root, &domain.weights, room, simd));
    for iteration in 1..=settings.iterations {
        let nodes = trees[0].len() + trees[1].len();
        if nodes >= settings.nodes {
            return None;
        }
        let from = usize::from(trees[1].len() < trees[0].len());
        let target = sample(domain, rng);
        let Some(new) = extend(edges, &mut trees[from], &target, settings.step as f32) else {
            continue;
        };
        let bridge = trees[from].node(new);
        let Some(other) = reach(edges, &mut trees[1 - from], &bridge, settings.step as f32) else {
            continue;
        };
        let ends = if from == 0 { [new, other] } else { [other, new] };
        let mut path = trees[0].path_to_root(ends[0]);
        path.reverse();
        path.extend(trees[1].path_to_root(ends[1]).into_iter().skip(1));
        let nodes = trees[0].len() + trees[1].len();
        return Some(Connection { path, iterations: iteration, nodes });
    }
    None
}

/// Independent random numbers for one attempt.
pub(super) fn numbers(seed: u64, attempt: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(attempt as u64);
    rng
}

fn sample(domain: &Domain, rng: &mut ChaCha8Rng) -> Config {
    let mut q = [0.0; MAX_VARIABLES];
    for (i, value) in q[..domain.dof()].iter_mut().enumerate() {
        let (low, high) = (domain.lower[i] as f32, domain.upper[i] as f32);
        *value = low + (high - low) * rng.random::<f32>();
    }
    q
}

/// One branch towards `target`, at most `step` long. Gives the new node.
fn extend(edges: &mut impl Edges, tree: &mut Tree, target: &Config, step: f32) -> Option<usize> {
    let (near, distance) = tree.nearest(target);
    let from = tree.node(near);
    let to = if distance <= step { *target } else { mix(&from, target, step / distance) };
    edges.is_free(&from, &to).then(|| tree.push(&to, near))
}

/// Branches all the way to `target`. Gives the node there.
fn reach(edges: &mut impl Edges, tree: &mut Tree, target: &Config, step: f32) -> Option<usize> {
    let (mut at, distance) = tree.nearest(target);
    let from = tree.node(at);
    let count = (distance / step).ceil().max(1.0);
    let mut last = from;
    for i in 1..=count as usize {
        let to = if i == count as usize { *target } else { mix(&from, target, i as f32 / count) };
        if !edges.is_free(&last, &to) {
            return None;
        }
        at = tree.push(&to, at);
        last = to;
    }
    Some(at)
}
