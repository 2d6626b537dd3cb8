//! Farthest-point sampling, exact, with a tree of boxes that skips what a new sample cannot change
//! (after Han et al., *QuickFPS: Architecture and Algorithm Co-Design for Farthest Point Sampling*, 2023).
//!
//! The tree is laid over the points in the order they come in: images list theirs tile by tile, so that no
//! sorting is needed for the boxes to be small. Hot loops are compiled twice, for AVX2 and for the
//! baseline; both compute the same bits.

/// Points of a leaf.
const LEAF: usize = 32;

/// Children of a node.
const FAN: usize = 8;

/// Indices of up to `wanted` points: first the one farthest from the centroid, then always one that is
/// farthest from all chosen before; of equally far ones the first. Points at the same place are chosen once.
pub(super) fn farthest_points(axes: &[&[f32]; 3], wanted: usize) -> Vec<usize> {
    let count = axes[0].len();
    let Some(first) = farthest_from_centroid(axes) else { return Vec::new() };
    let mut tree = Tree::new(axes);
    let mut chosen = Vec::with_capacity(wanted.min(count));
    let mut next = first;
    while chosen.len() < wanted {
        chosen.push(next);
        tree.add(std::array::from_fn(|i| axes[i][next]));
        match tree.farthest() {
            Some(farthest) => next = farthest,
            None => break,
        }
    }
    chosen
}

fn farthest_from_centroid(axes: &[&[f32]; 3]) -> Option<usize> {
    let count = axes[0].len();
    let centroid =
        axes.map(|axis| (axis.iter().map(|&v| f64::from(v)).sum::<f64>() / count as f64) as f32);
    let square = |place: usize| {
        (0..3).map(|i| (axes[i][place] - centroid[i]) * (axes[i][place] - centroid[i])).sum::<f32>()
    };
    let farther =
        |best: (usize, f32), next: (usize, f32)| if next.1 > best.1 { next } else { best };
    (0..count).map(|place| (place, square(place))).reduce(farther).map(|(place, _)| place)
}

/// Lowest and highest corner of a box.
type Corners = ([f32; 3], [f32; 3]);

/// Boxes of one level, in groups of [`FAN`], with the largest square distance in each.
#[derive(Debug, Default)]
struct Level {
    low: [Vec<[f32; FAN]>; 3],
    high: [Vec<[f32; FAN]>; 3],
    largest: Vec<[f32; FAN]>,
    /// Groups that the current sample may change.
    visited: Vec<u32>,
}

/// Square distances of all points from the nearest sample.
#[derive(Debug)]
struct Tree {
    /// Points by leaves; the last one is filled up.
    points: Vec<[[f32; LEAF]; 3]>,
    /// Negative for what fills up.
    square: Vec<[f32; LEAF]>,
    /// From the leaves' boxes to the root's group.
    levels: Vec<Level>,
    /// Leaves that the current sample may change.
    leaves: Vec<u32>,
}

impl Tree {
    fn new(axes: &[&[f32]; 3]) -> Self {
        let count = axes[0].len();
        let leaves = count.div_ceil(LEAF);
        let mut points = vec![[[0.0; LEAF]; 3]; leaves];
        let mut square = vec![[-1.0; LEAF]; leaves];
        let mut boxes = Vec::with_capacity(leaves);
        for leaf in 0..leaves {
            let members = leaf * LEAF..((leaf + 1) * LEAF).min(count);
            let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
            for (axis, values) in axes.iter().enumerate() {
                let values = &values[members.clone()];
                points[leaf][axis] = [values[0]; LEAF];
                points[leaf][axis][..values.len()].copy_from_slice(values);
                low[axis] = values.iter().copied().fold(f32::INFINITY, f32::min);
                high[axis] = values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            }
            square[leaf][..members.len()].fill(f32::INFINITY);
            boxes.push((low, high));
        }
        let mut levels = Vec::new();
        loop {
            let (level, parents) = Level::new(&boxes);
            levels.push(level);
            if parents.len() <= 1 {
                break;
            }
            boxes = parents;
        }
        Self { points, square, levels, leaves: Vec::new() }
    }

    /// Takes a sample into account.
    fn add(&mut self, sample: [f32; 3]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            unsafe { self.add_avx2(sample) };
            return;
        }
        self.add_inline(sample);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn add_avx2(&mut self, sample: [f32; 3]) {
        self.add_inline(sample);
    }

    #[inline(always)]
    fn add_inline(&mut self, sample: [f32; 3]) {
        let top = self.levels.len() - 1;
        self.levels[top].visited.clear();
        self.levels[top].visited.push(0);
        for number in (1..=top).rev() {
            let (below, level) = self.levels.split_at_mut(number);
            let children = &mut below[number - 1].visited;
            children.clear();
            level[0].touched(sample, children);
        }
        self.leaves.clear();
        self.levels[0].touched(sample, &mut self.leaves);
        for &leaf in &self.leaves {
            let leaf = leaf as usize;
            let largest = update(&self.points[leaf], &mut self.square[leaf], sample);
            self.levels[0].largest[leaf / FAN][leaf % FAN] = largest;
        }
        for number in 1..=top {
            let (below, level) = self.levels.split_at_mut(number);
            for &group in &below[number - 1].visited {
                let group = group as usize;
                let largest = maximum(&below[number - 1].largest[group]);
                level[0].largest[group / FAN][group % FAN] = largest;
            }
        }
    }

    /// The first point that is farthest from all samples; `None` where all lie on samples.
    fn farthest(&self) -> Option<usize> {
        let mut place = 0;
        for level in self.levels.iter().rev() {
            let group = &level.largest[place];
            place = place * FAN + first_largest(group);
        }
        let within = first_largest(&self.square[place]);
        (self.square[place][within] > 0.0).then_some(place * LEAF + within)
    }
}

impl Level {
    /// The level of these boxes, and the boxes of its groups.
    fn new(boxes: &[Corners]) -> (Self, Vec<Corners>) {
        let groups = boxes.len().div_ceil(FAN);
        let mut level = Self {
            low: std::array::from_fn(|_| vec![[0.0; FAN]; groups]),
            high: std::array::from_fn(|_| vec![[0.0; FAN]; groups]),
            // What fills up a group is never reached.
            largest: vec![[-1.0; FAN]; groups],
            visited: Vec::new(),
        };
        let mut parents = vec![([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]); groups];
        for (place, (low, high)) in boxes.iter().enumerate() {
            let (group, within) = (place / FAN, place % FAN);
            for axis in 0..3 {
                level.low[axis][group][within] = low[axis];
                level.high[axis][group][within] = high[axis];
                parents[group].0[axis] = parents[group].0[axis].min(low[axis]);
                parents[group].1[axis] = parents[group].1[axis].max(high[axis]);
            }
            level.largest[group][within] = f32::INFINITY;
        }
        (level, parents)
    }

    /// Appends the boxes, of the visited groups, in which a sample is nearer to some point than all before.
    #[inline(always)]
    fn touched(&self, sample: [f32; 3], touched: &mut Vec<u32>) {
        for &group in &self.visited {
            let at = group as usize;
            let mut square = [0.0f32; FAN];
            for axis in 0..3 {
                let (low, high) = (&self.low[axis][at], &self.high[axis][at]);
                for i in 0..FAN {
                    let outside = (low[i] - sample[axis]).max(sample[axis] - high[i]).max(0.0);
                    square[i] += outside * outside;
                }
            }
            let largest = &self.largest[at];
            let mut mask = 0u32;
            for i in 0..FAN {
                mask |= u32::from(square[i] < largest[i]) << i;
            }
            while mask != 0 {
                touched.push(group * FAN as u32 + mask.trailing_zeros());
                mask &= mask - 1;
            }
        }
    }
}

/// Lowers the square distances of a leaf's points to those from `sample`; gives the largest.
#[inline(always)]
fn update(points: &[[f32; LEAF]; 3], square: &mut [f32; LEAF], sample: [f32; 3]) -> f32 {
    let mut largest = [-1.0f32; FAN];
    for chunk in 0..LEAF / FAN {
        for lane in 0..FAN {
            let i = chunk * FAN + lane;
            let x = points[0][i] - sample[0];
            let y = points[1][i] - sample[1];
            let z = points[2][i] - sample[2];
            let nearest = square[i].min(x * x + y * y + z * z);
            square[i] = nearest;
            largest[lane] = largest[lane].max(nearest);
        }
    }
    maximum(&largest)
}

#[inline(always)]
fn maximum(values: &[f32; FAN]) -> f32 {
    let half: [f32; 4] = std::array::from_fn(|i| values[i].max(values[i + 4]));
    half[0].max(half[1]).max(half[2].max(half[3]))
}

fn first_largest(values: &[f32]) -> usize {
    let mut best = 0;
    for (place, value) in values.iter().enumerate() {
        if *value > values[best] {
            best = place;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn naive(axes: &[&[f32]; 3], wanted: usize) -> Vec<usize> {
        let square = |a: usize, b: usize| {
            let [x, y, z] = [0, 1, 2].map(|i| axes[i][a] - axes[i][b]);
            x * x + y * y + z * z
        };
        let mut chosen = vec![farthest_from_centroid(axes).unwrap()];
        while chosen.len() < wanted {
            let distance =
                |i: usize| chosen.iter().map(|&c| square(i, c)).fold(f32::INFINITY, f32::min);
            let places = (0..axes[0].len()).rev();
            let next = places.max_by(|&i, &j| distance(i).total_cmp(&distance(j)));
            chosen.push(next.unwrap());
        }
        chosen
    }

    fn random_points(count: usize, coarse: bool) -> [Vec<f32>; 3] {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        std::array::from_fn(|_| {
            let value = |_| match coarse {
                // A coarse grid makes many ties.
                true => random.random_range(0..14) as f32 * 0.1,
                false => random.random::<f32>(),
            };
            (0..count).map(value).collect()
        })
    }

    #[test]
    fn the_tree_chooses_what_the_plain_algorithm_does() {
        for (count, coarse) in [(900, false), (900, true), (3000, false), (33, false)] {
            let points = random_points(count, coarse);
            let axes = points.each_ref().map(Vec::as_slice);
            let wanted = 150.min(count);
            assert_eq!(farthest_points(&axes, wanted), naive(&axes, wanted), "{count} {coarse}");
        }
    }

    #[test]
    fn both_compilations_give_the_same_bits() {
        let points = random_points(2000, false);
        let axes = points.each_ref().map(Vec::as_slice);
        let (mut fast, mut plain) = (Tree::new(&axes), Tree::new(&axes));
        for place in [7, 300, 1999, 4] {
            let sample = axes.map(|axis| axis[place]);
            fast.add(sample);
            plain.add_inline(sample);
        }
        assert_eq!(fast.square, plain.square);
        assert_eq!(fast.farthest(), plain.farthest());
    }

    #[test]
    fn duplicates_are_chosen_once() {
        let (x, zero) = ([0.0, 1.0, 0.0, 1.0], [0.0; 4]);
        assert_eq!(farthest_points(&[&x, &zero, &zero], 4).len(), 2);
        assert!(farthest_points(&[&[], &[], &[]], 4).is_empty());
    }
}
