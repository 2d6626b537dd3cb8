//! Shorter and rounder paths whose edges are all free.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::{Domain, Edges, Settings, mix};
use crate::kernels::validity::Config;

/// Corners nearer to both neighbours than this (weighted) are not cut.
const SHORTEST_CUT: f32 = 0.02;

/// Drops and cuts what can be spared. Ends stay.
pub(super) fn simplify(
    edges: &mut impl Edges,
    domain: &Domain,
    settings: &Settings,
    mut path: Vec<Config>,
    rng: &mut ChaCha8Rng,
) -> Vec<Config> {
    skip(edges, &mut path);
    for _ in 0..settings.shortcuts {
        if path.len() < 3 {
            break;
        }
        shortcut(edges, domain, &mut path, rng);
    }
    skip(edges, &mut path);
    for _ in 0..settings.smoothing_rounds {
        path = cut_corners(edges, domain, &path);
    }
    path
}

/// From each configuration straight to the last one that can be reached.
fn skip(edges: &mut impl Edges, path: &mut Vec<Config>) {
    let mut at = 0;
    while at + 2 < path.len() {
        let far = (at + 2..path.len()).rev().find(|&far| edges.is_free(&path[at], &path[far]));
        if let Some(far) = far {
            path.drain(at + 1..far);
        }
        at += 1;
    }
}

/// One straight edge between two random places of the path, by length.
fn shortcut(edges: &mut impl Edges, domain: &Domain, path: &mut Vec<Config>, rng: &mut ChaCha8Rng) {
    let lengths: Vec<f32> = path.windows(2).map(|w| domain.distance(&w[0], &w[1])).collect();
    let total: f32 = lengths.iter().sum();
    let mut place = || {
        let mut left = rng.random::<f32>() * total;
        for (edge, &length) in lengths.iter().enumerate() {
            if left < length {
                return (edge, left / length);
            }
            left -= length;
        }
        (lengths.len() - 1, 1.0)
    };
    let (mut a, mut b) = (place(), place());
    if a.0 > b.0 {
        std::mem::swap(&mut a, &mut b);
    }
    if a.0 == b.0 {
        return;
    }
    let from = mix(&path[a.0], &path[a.0 + 1], a.1);
    let to = mix(&path[b.0], &path[b.0 + 1], b.1);
    if edges.is_free(&from, &to) {
        path.splice(a.0 + 1..=b.0, [from, to]);
    }
}

/// Replaces each corner by two, a quarter of the way to its neighbours (Chaikin, *An Algorithm for High-Speed
/// Curve Generation*, CGIP 1974), where the new edge is free.
fn cut_corners(edges: &mut impl Edges, domain: &Domain, path: &[Config]) -> Vec<Config> {
    let mut out = vec![path[0]];
    for corner in path.windows(3) {
        let [before, at, after] = [&corner[0], &corner[1], &corner[2]];
        let near = domain.distance(before, at).min(domain.distance(at, after));
        let (first, second) = (mix(at, before, 0.25), mix(at, after, 0.25));
        if near > SHORTEST_CUT && edges.is_free(&first, &second) {
            out.extend([first, second]);
        } else {
            out.push(*at);
        }
    }
    out.extend(path.last().filter(|_| path.len() > 1));
    out
}
