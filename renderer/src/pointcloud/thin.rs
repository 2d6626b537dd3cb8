//! Thins points with voxels.

use super::Sample;

/// Thinning goes on while more than this many times the number wanted remain...
const ENOUGH: usize = 4;
/// ...and is taken back where fewer than this many halves of it would.
const LEAST_HALVES: usize = 3;

/// One point per occupied voxel, the first of each; the edge (metres) doubles from `voxel_m` while more than four
/// times the points wanted remain, and stops where a further doubling would leave less than one and a
/// half times as many. Few points stay as they are.
pub(super) fn thin(mut points: Vec<Sample>, voxel_m: f32, wanted: usize) -> Vec<Sample> {
    let mut edge_m = voxel_m.max(1e-4);
    while points.len() > ENOUGH * wanted {
        let thinned = one_per_voxel(&points, edge_m);
        if 2 * thinned.len() < LEAST_HALVES * wanted {
            break;
        }
        points = thinned;
        edge_m *= 2.0;
    }
    points
}

fn one_per_voxel(points: &[Sample], edge_m: f32) -> Vec<Sample> {
    const FREE: u64 = u64::MAX;
    let capacity = (2 * points.len()).next_power_of_two();
    let mut table = vec![FREE; capacity];
    let mut kept = Vec::with_capacity(points.len().min(1 << 16));
    let inverse_edge = 1.0 / edge_m;
    for point in points {
        let key = key_of(point.position, inverse_edge);
        let mut slot = (key.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 20) as usize & (capacity - 1);
        while table[slot] != FREE && table[slot] != key {
            slot = (slot + 1) & (capacity - 1);
        }
        if table[slot] == FREE {
            table[slot] = key;
            kept.push(*point);
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
