//! Farthest-point sampling, exact, with a tree of boxes that skips what a new sample cannot change
//! (after Han et al., *QuickFPS: Architecture and Algorithm Co-Design for Farthest Point Sampling*, 2023).
//!
//! The tree is laid over leaves in the order they come in: images list theirs tile by tile, so that no
//! sorting is needed for the boxes to be small.

use akrobat_simd::{LANES, Lanes, Row, xyz};

use super::leaf::{LEAF, Leaf, ROWS};

/// Children of a node.
const FAN: usize = LANES;

/// Up to `wanted` points of the leaves: first the one farthest from the centroid, then always one that is
/// farthest from all chosen before; of equally far ones the first. Points at the same place are chosen once.
///
/// A point is given as `leaf * LEAF + lane`.
#[inline(always)]
pub(super) fn farthest_points<L: Lanes>(leaves: &mut [Leaf], wanted: usize) -> Vec<usize> {
    let Some(first) = farthest_from_centroid::<L>(leaves) else { return Vec::new() };
    let mut tree = Tree::new::<L>(leaves);
    let mut chosen = Vec::with_capacity(wanted.min(leaves.len() * LEAF));
    let mut next = first;
    while chosen.len() < wanted {
        chosen.push(next);
        tree.add::<L>(leaves, leaves[next / LEAF].point(next % LEAF));
        match tree.farthest::<L>(leaves) {
            Some(farthest) => next = farthest,
            None => break,
        }
    }
    chosen
}

#[inline(always)]
fn farthest_from_centroid<L: Lanes>(leaves: &[Leaf]) -> Option<usize> {
    let centroid = centroid::<L>(leaves)?;
    let middle = xyz!(i => L::splat(centroid[i]));
    let mut best = (-1.0, 0);
    for (leaf, points) in leaves.iter().enumerate() {
        let square = points.square_distances(middle);
        let mut largest = square[0];
        for row in 1..ROWS {
            largest = largest.max(square[row]);
        }
        let largest = largest.largest();
        if largest > best.0 {
            for row in (0..ROWS).rev() {
                let mut distances = Row::default();
                square[row].store(&mut distances);
                for within in (0..LANES).rev() {
                    let lane = row * LANES + within;
                    // A lane without a point repeats one that another holds.
                    if distances.0[within] == largest && points.holds(lane) {
                        best = (largest, leaf * LEAF + lane);
                    }
                }
            }
        }
    }
    Some(best.1)
}

/// Mean of all points; `None` where there are none.
#[inline(always)]
fn centroid<L: Lanes>(leaves: &[Leaf]) -> Option<[f32; 3]> {
    let (mut sum, mut count) = ([0.0f64; 3], 0usize);
    for leaf in leaves {
        let held = leaf.count();
        count += held;
        for axis in 0..3 {
            if held == LEAF {
                let mut rows = L::load(&leaf.points[axis][0]);
                for row in 1..ROWS {
                    rows = rows + L::load(&leaf.points[axis][row]);
                }
                let mut row = Row::default();
                rows.store(&mut row);
                sum[axis] += row.0.iter().map(|&v| f64::from(v)).sum::<f64>();
            } else {
                let points = (0..LEAF).filter(|&lane| leaf.holds(lane));
                sum[axis] += points.map(|lane| f64::from(leaf.point(lane)[axis])).sum::<f64>();
            }
        }
    }
    (count > 0).then(|| sum.map(|s| (s / count as f64) as f32))
}

/// [`FAN`] boxes, with the largest square distance in each.
#[derive(Debug, Clone, Copy)]
struct Group {
    low: [Row; 3],
    high: [Row; 3],
    largest: Row,
}

impl Group {
    /// What fills up a group is never reached.
    const EMPTY: Self = Self {
        low: [Row([f32::INFINITY; FAN]); 3],
        high: [Row([f32::NEG_INFINITY; FAN]); 3],
        largest: Row([-1.0; FAN]),
    };

    #[inline(always)]
    fn set(&mut self, child: usize, low: [f32; 3], high: [f32; 3]) {
        for axis in 0..3 {
            self.low[axis].0[child] = low[axis];
            self.high[axis].0[child] = high[axis];
        }
        self.largest.0[child] = f32::INFINITY;
    }

    /// The box around all.
    #[inline(always)]
    fn corners<L: Lanes>(&self) -> ([f32; 3], [f32; 3]) {
        (xyz!(i => L::load(&self.low[i]).smallest()), xyz!(i => L::load(&self.high[i]).largest()))
    }

    /// Bit i is set where a sample is nearer to box i than some point in there is to all samples before.
    #[inline(always)]
    fn touched<L: Lanes>(&self, sample: [L; 3]) -> u32 {
        let zero = L::splat(0.0);
        let outside = xyz!(i => {
            let below = L::load(&self.low[i]) - sample[i];
            below.max(sample[i] - L::load(&self.high[i])).max(zero)
        });
        let [x, y, z] = outside;
        (x * x + y * y + z * z).less(L::load(&self.largest))
    }
}

/// Numbers of nodes that the current sample may change.
#[derive(Debug)]
struct Touched {
    /// Longer than all nodes by [`FAN`].
    nodes: Vec<u32>,
    count: usize,
}

impl Touched {
    fn new(most: usize) -> Self {
        Self { nodes: vec![0; most + FAN], count: 0 }
    }

    /// Appends a group's children that are in `mask`: all eight are written, without a branch on any.
    #[inline(always)]
    fn append(&mut self, group: u32, mask: u32) {
        if let Some(out) = self.nodes[self.count..].first_chunk_mut::<FAN>() {
            for (node, child) in out.iter_mut().zip(&CHILDREN[mask as usize % CHILDREN.len()]) {
                *node = group * FAN as u32 + u32::from(*child);
            }
        }
        self.count += mask.count_ones() as usize;
    }

    #[inline(always)]
    fn all(&self) -> &[u32] {
        &self.nodes[..self.count]
    }
}

/// Places of the set bits of every byte.
static CHILDREN: [[u8; FAN]; 1 << FAN] = {
    let mut places = [[0; FAN]; 1 << FAN];
    let mut mask = 0;
    while mask < places.len() {
        let (mut bit, mut count) = (0, 0);
        while bit < FAN {
            if mask >> bit & 1 == 1 {
                places[mask][count] = bit as u8;
                count += 1;
            }
            bit += 1;
        }
        mask += 1;
    }
    places
};

/// The boxes over the leaves.
#[derive(Debug)]
struct Tree {
    /// From the leaves' boxes to the root's group.
    levels: Vec<Vec<Group>>,
    /// Of the leaves, then of the groups of each level.
    touched: Vec<Touched>,
}

impl Tree {
    #[inline(always)]
    fn new<L: Lanes>(leaves: &[Leaf]) -> Self {
        let mut touched = vec![Touched::new(leaves.len())];
        let mut level = vec![Group::EMPTY; leaves.len().div_ceil(FAN)];
        for (number, leaf) in leaves.iter().enumerate() {
            let (low, high) = leaf.corners::<L>();
            level[number / FAN].set(number % FAN, low, high);
        }
        let mut levels = Vec::new();
        while level.len() > 1 {
            let mut above = vec![Group::EMPTY; level.len().div_ceil(FAN)];
            for (number, group) in level.iter().enumerate() {
                let (low, high) = group.corners::<L>();
                above[number / FAN].set(number % FAN, low, high);
            }
            touched.push(Touched::new(level.len()));
            levels.push(std::mem::replace(&mut level, above));
        }
        levels.push(level);
        touched.push(Touched { nodes: vec![0], count: 1 });
        Self { levels, touched }
    }

    /// Takes a sample into account.
    #[inline(always)]
    fn add<L: Lanes>(&mut self, leaves: &mut [Leaf], sample: [f32; 3]) {
        let sample = xyz!(i => L::splat(sample[i]));
        for (number, level) in self.levels.iter().enumerate().rev() {
            let (below, groups) = self.touched.split_at_mut(number + 1);
            let children = &mut below[number];
            children.count = 0;
            for &group in groups[0].all() {
                children.append(group, level[group as usize].touched(sample));
            }
        }
        for &leaf in self.touched[0].all() {
            let leaf = leaf as usize;
            self.levels[0][leaf / FAN].largest.0[leaf % FAN] = leaves[leaf].add(sample);
        }
        for number in 1..self.levels.len() {
            let (below, above) = self.levels.split_at_mut(number);
            for &group in self.touched[number].all() {
                let group = group as usize;
                let largest = L::load(&below[number - 1][group].largest).largest();
                above[0][group / FAN].largest.0[group % FAN] = largest;
            }
        }
    }

    /// The first point that is farthest from all samples; `None` where all lie on samples.
    #[inline(always)]
    fn farthest<L: Lanes>(&self, leaves: &[Leaf]) -> Option<usize> {
        let (mut place, mut square) = (0, 0.0);
        for level in self.levels.iter().rev() {
            let largest = L::load(&level[place].largest);
            square = largest.largest();
            place = place * FAN + first_not_below(largest, square)?;
        }
        if square <= 0.0 {
            return None;
        }
        for (row, squares) in leaves[place].square.iter().enumerate() {
            if let Some(within) = first_not_below(L::load(squares), square) {
                return Some(place * LEAF + row * LANES + within);
            }
        }
        None
    }
}

/// The first lane that holds at least `value`.
#[inline(always)]
fn first_not_below<L: Lanes>(lanes: L, value: f32) -> Option<usize> {
    let found = !lanes.less(L::splat(value)) & ((1 << LANES) - 1);
    (found != 0).then(|| found.trailing_zeros() as usize)
}

#[cfg(test)]
mod tests {
    use akrobat_simd::{Kernel, Simd, run};
    use rand::{RngExt, SeedableRng};

    use super::*;

    struct Sample(Vec<Leaf>, usize);

    impl Kernel for Sample {
        type Output = (Vec<usize>, Vec<Leaf>);

        #[inline(always)]
        fn run<L: Lanes>(mut self) -> Self::Output {
            (farthest_points::<L>(&mut self.0, self.1), self.0)
        }
    }

    fn sampled(points: &[[f32; 3]], wanted: usize) -> Vec<usize> {
        run(Simd::detect(), Sample(Leaf::of_list(points), wanted)).0
    }

    fn naive(points: &[[f32; 3]], wanted: usize) -> Vec<usize> {
        let square = |a: [f32; 3], b: [f32; 3]| {
            let [x, y, z] = [0, 1, 2].map(|i| a[i] - b[i]);
            x * x + y * y + z * z
        };
        let count = points.len();
        let mean = |i: usize| points.iter().map(|p| f64::from(p[i])).sum::<f64>() / count as f64;
        let centroid = [0, 1, 2].map(|i| mean(i) as f32);
        let first_of_largest = |value: &dyn Fn(usize) -> f32| {
            (0..count).rev().max_by(|&i, &j| value(i).total_cmp(&value(j))).unwrap()
        };
        let mut chosen = vec![first_of_largest(&|i| square(points[i], centroid))];
        while chosen.len() < wanted {
            let distance =
                |i: usize| chosen.iter().map(|&c| square(points[i], points[c])).fold(1e9, f32::min);
            chosen.push(first_of_largest(&distance));
        }
        chosen
    }

    fn random_points(count: usize, coarse: bool) -> Vec<[f32; 3]> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut value = || match coarse {
            // A coarse grid makes many ties.
            true => random.random_range(0..14) as f32 * 0.1,
            false => random.random::<f32>(),
        };
        (0..count).map(|_| std::array::from_fn(|_| value())).collect()
    }

    #[test]
    fn the_tree_chooses_what_the_plain_algorithm_does() {
        for (count, coarse) in [(900, false), (900, true), (3000, false), (33, false)] {
            let points = random_points(count, coarse);
            let wanted = 150.min(count);
            assert_eq!(sampled(&points, wanted), naive(&points, wanted), "{count} {coarse}");
        }
    }

    #[test]
    fn lanes_without_a_point_are_never_chosen() {
        let points = random_points(700, false);
        // Every third place holds no point.
        let mut leaves: Vec<Leaf> = Vec::new();
        let mut places = Vec::new();
        for (number, chunk) in points.chunks(LEAF).enumerate() {
            let mut rows = [[Row([f32::NAN; LANES]); ROWS]; 3];
            let mut held = 0;
            for (lane, point) in chunk.iter().enumerate().filter(|(lane, _)| lane % 3 != 0) {
                (0..3).for_each(|axis| rows[axis][lane / LANES].0[lane % LANES] = point[axis]);
                held |= 1 << lane;
                places.push(number * LEAF + lane);
            }
            leaves.extend(Leaf::new(rows, held));
        }
        let kept: Vec<_> = places.iter().map(|&place| points[place]).collect();
        let expected: Vec<_> = naive(&kept, 120).iter().map(|&i| places[i]).collect();
        assert_eq!(run(Simd::detect(), Sample(leaves, 120)).0, expected);
    }

    #[test]
    fn all_lanes_give_the_same_bits() {
        let leaves = Leaf::of_list(&random_points(2000, false));
        let fast = run(Simd::detect(), Sample(leaves.clone(), 50));
        let plain = run(Simd::Portable, Sample(leaves, 50));
        assert_eq!(fast, plain);
    }

    #[test]
    fn duplicates_are_chosen_once() {
        let points = [0.0, 1.0, 0.0, 1.0].map(|x| [x, 0.0, 0.0]);
        assert_eq!(sampled(&points, 4).len(), 2);
        assert!(sampled(&[], 4).is_empty());
    }
}
