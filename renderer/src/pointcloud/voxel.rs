//! Voxel sampling: one point per occupied voxel.

use super::leaf::{LEAF, Leaf};

/// Indices of up to `wanted` points: the first of each voxel, of the largest voxels that still leave as many
/// as wanted (to 1%); evenly spread over the list where they leave more. Voxels are never smaller than
/// `voxel_m`, so there may be fewer.
///
/// A point is given as `leaf * LEAF + lane`.
pub(super) fn sample(leaves: &[Leaf], voxel_m: f32, wanted: usize) -> Vec<usize> {
    let lanes = |(number, leaf): (usize, &Leaf)| {
        let held = (0..LEAF).filter(|&lane| leaf.holds(lane));
        held.map(|lane| (number * LEAF + lane, leaf.point(lane))).collect::<Vec<_>>()
    };
    let points: Vec<_> = leaves.iter().enumerate().flat_map(lanes).collect();
    let mut kept = one_per_voxel(&points, voxel_m);
    if kept.len() > wanted {
        let (mut small, mut large) = (voxel_m, 2.0 * voxel_m);
        loop {
            let fewer = one_per_voxel(&points, large);
            if fewer.len() < wanted || large > 1e3 {
                break;
            }
            (kept, small, large) = (fewer, large, 2.0 * large);
        }
        while large / small > 1.01 {
            let middle = (small * large).sqrt();
            let fewer = one_per_voxel(&points, middle);
            if fewer.len() < wanted {
                large = middle;
            } else {
                (kept, small) = (fewer, middle);
            }
        }
    }
    let count = kept.len();
    if count <= wanted { kept } else { (0..wanted).map(|i| kept[i * count / wanted]).collect() }
}

fn one_per_voxel(points: &[(usize, [f32; 3])], edge_m: f32) -> Vec<usize> {
    const FREE: u64 = u64::MAX;
    let capacity = (2 * points.len()).next_power_of_two();
    let mut table = vec![FREE; capacity];
    let mut kept = Vec::new();
    let inverse_edge = 1.0 / edge_m;
    for &(place, position) in points {
        let key = key_of(position, inverse_edge);
        let mut slot = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20) as usize & (capacity - 1);
        while table[slot] != FREE && table[slot] != key {
            slot = (slot + 1) & (capacity - 1);
        }
        if table[slot] == FREE {
            table[slot] = key;
            kept.push(place);
        }
    }
    kept
}

/// The voxel's three indices, 21 bits each: the top bit is never set.
fn key_of(position: [f32; 3], inverse_edge: f32) -> u64 {
    const BITS: u32 = 21;
    position.iter().fold(0, |key, &v| {
        let index = (v * inverse_edge).floor() as i64;
        (key << BITS) | (index as u64 & ((1 << BITS) - 1))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voxels_give_the_number_asked_for_and_no_two_in_one_place() {
        let point = |i: usize| [(i % 100) as f32 * 0.01, (i / 100) as f32 * 0.01, 0.0];
        let leaves = Leaf::of_list(&(0..10_000).map(point).collect::<Vec<_>>());
        let chosen = sample(&leaves, 0.001, 400);
        assert_eq!(chosen.len(), 400);
        // 400 points on a square metre are 5 cm apart.
        for (i, &a) in chosen.iter().enumerate() {
            for &b in &chosen[..i] {
                let [p, q] = [point(a), point(b)];
                assert!((p[0] - q[0]).hypot(p[1] - q[1]) > 0.009, "{a} {b}");
            }
        }
        let few = sample(&leaves, 0.1, 4000);
        assert!((100..=144).contains(&few.len()), "{}", few.len());
    }
}
