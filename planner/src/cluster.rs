//! Clustering of configurations: k-means, then affinity propagation on its centres, as the paper does.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Squared distance of two configurations with weights for each coordinate.
fn distance2(a: &[f64], b: &[f64], weights: &[f64]) -> f64 {
    a.iter().zip(b).zip(weights).map(|((a, b), w)| w * (a - b) * (a - b)).sum()
}

/// Picks at most `most` representatives (indices) of `points`.
///
/// Points are first reduced to `most_means` medoids by k-means, then to exemplars by affinity
/// propagation; where that gives fewer than `least` or does not converge, `most` k-means medoids serve.
pub fn representatives(
    points: &[Vec<f64>],
    weights: &[f64],
    least: usize,
    most: usize,
    most_means: usize,
    seed: u64,
) -> Vec<usize> {
    if points.len() <= most {
        return (0..points.len()).collect();
    }
    let medoids = if points.len() > most_means {
        k_means_medoids(points, weights, most_means, seed)
    } else {
        (0..points.len()).collect()
    };
    let reduced: Vec<&[f64]> = medoids.iter().map(|&i| points[i].as_slice()).collect();
    match affinity_propagation(&reduced, weights) {
        Some(exemplars) if (least..=most).contains(&exemplars.len()) => {
            exemplars.into_iter().map(|e| medoids[e]).collect()
        }
        _ => k_means_medoids(points, weights, most, seed),
    }
}

/// k-means (Lloyd's algorithm, k-means++ starts; Arthur and Vassilvitskii, SODA 2007); returns, for
/// each mean, the index of the nearest point, sorted.
pub fn k_means_medoids(points: &[Vec<f64>], weights: &[f64], k: usize, seed: u64) -> Vec<usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut means = plus_plus_starts(points, weights, k.min(points.len()), &mut rng);
    let mut assigned = vec![usize::MAX; points.len()];
    for _ in 0..20 {
        let mut changed = false;
        for (point, slot) in points.iter().zip(&mut assigned) {
            let nearest = nearest(&means, point, weights);
            changed |= std::mem::replace(slot, nearest) != nearest;
        }
        if !changed {
            break;
        }
        for (cluster, mean) in means.iter_mut().enumerate() {
            let members = || points.iter().zip(&assigned).filter(move |(_, a)| **a == cluster);
            let count = members().count();
            if count > 0 {
                mean.fill(0.0);
                for (point, _) in members() {
                    mean.iter_mut().zip(point).for_each(|(m, p)| *m += p / count as f64);
                }
            }
        }
    }
    let mut medoids: Vec<usize> = means
        .iter()
        .filter_map(|mean| {
            (0..points.len()).min_by(|&a, &b| {
                distance2(&points[a], mean, weights)
                    .total_cmp(&distance2(&points[b], mean, weights))
            })
        })
        .collect();
    medoids.sort_unstable();
    medoids.dedup();
    medoids
}

fn nearest(means: &[Vec<f64>], point: &[f64], weights: &[f64]) -> usize {
    let distance = |mean: &Vec<f64>| distance2(mean, point, weights);
    (0..means.len())
        .min_by(|&a, &b| distance(&means[a]).total_cmp(&distance(&means[b])))
        .unwrap_or(0)
}

fn plus_plus_starts(
    points: &[Vec<f64>],
    weights: &[f64],
    k: usize,
    rng: &mut ChaCha8Rng,
) -> Vec<Vec<f64>> {
    let mut means = vec![points[rng.random_range(0..points.len())].clone()];
    let mut gaps: Vec<f64> = points.iter().map(|p| distance2(p, &means[0], weights)).collect();
    while means.len() < k {
        let total: f64 = gaps.iter().sum();
        if total <= 0.0 {
            break;
        }
        let mut pick = rng.random_range(0.0..total);
        let chosen = gaps.iter().position(|g| {
            pick -= g;
            pick < 0.0
        });
        let mean = points[chosen.unwrap_or(points.len() - 1)].clone();
        for (gap, point) in gaps.iter_mut().zip(points) {
            *gap = gap.min(distance2(point, &mean, weights));
        }
        means.push(mean);
    }
    means
}

/// Affinity propagation (Frey and Dueck, Science 315, 2007) with similarity = -squared distance, the
/// median as preference and damping 0.5. Returns the exemplars; `None` if it does not settle.
pub fn affinity_propagation(points: &[&[f64]], weights: &[f64]) -> Option<Vec<usize>> {
    const ITERATIONS: usize = 200;
    const SETTLED: usize = 15;
    const DAMPING: f64 = 0.5;
    let n = points.len();
    if n < 2 {
        return Some((0..n).collect());
    }
    let mut similarity: Vec<f64> =
        (0..n * n).map(|cell| -distance2(points[cell / n], points[cell % n], weights)).collect();
    let mut off_diagonal: Vec<f64> =
        (0..n * n).filter(|c| c / n != c % n).map(|c| similarity[c]).collect();
    off_diagonal.sort_unstable_by(f64::total_cmp);
    let middle = off_diagonal.len() / 2;
    let preference = f64::midpoint(off_diagonal[middle - 1], off_diagonal[middle]);
    (0..n).for_each(|i| similarity[i * n + i] = preference);

    let (mut responsibility, mut availability) = (vec![0.0; n * n], vec![0.0; n * n]);
    let mut exemplars: Vec<usize> = Vec::new();
    let mut unchanged = 0;
    for _ in 0..ITERATIONS {
        for i in 0..n {
            let row = i * n..(i + 1) * n;
            let sums = availability[row.clone()].iter().zip(&similarity[row]).map(|(a, s)| a + s);
            let (mut best, mut second, mut at) = (f64::NEG_INFINITY, f64::NEG_INFINITY, 0);
            for (k, value) in sums.enumerate() {
                if value > best {
                    (second, best, at) = (best, value, k);
                } else if value > second {
                    second = value;
                }
            }
            for k in 0..n {
                let rival = if k == at { second } else { best };
                let cell = &mut responsibility[i * n + k];
                *cell = DAMPING * *cell + (1.0 - DAMPING) * (similarity[i * n + k] - rival);
            }
        }
        for k in 0..n {
            let own = responsibility[k * n + k];
            let support: f64 =
                (0..n).filter(|&i| i != k).map(|i| responsibility[i * n + k].max(0.0)).sum();
            for i in 0..n {
                let value = if i == k {
                    support
                } else {
                    (own + support - responsibility[i * n + k].max(0.0)).min(0.0)
                };
                let cell = &mut availability[i * n + k];
                *cell = DAMPING * *cell + (1.0 - DAMPING) * value;
            }
        }
        let now: Vec<usize> =
            (0..n).filter(|&k| responsibility[k * n + k] + availability[k * n + k] > 0.0).collect();
        unchanged = if now == exemplars { unchanged + 1 } else { 0 };
        exemplars = now;
        if unchanged >= SETTLED && !exemplars.is_empty() {
            return Some(exemplars);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn blobs(per_blob: usize) -> Vec<Vec<f64>> {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut points = Vec::new();
        for center in [[0.0, 0.0], [5.0, 0.0], [0.0, 5.0], [5.0, 5.0]] {
            for _ in 0..per_blob {
                points.push(center.iter().map(|c| c + rng.random_range(-0.4..0.4)).collect());
            }
        }
        points
    }

    #[test]
    fn both_methods_find_separate_blobs() {
        let points = blobs(12);
        let blob = |index: &usize| index / 12;
        let mut by_means: Vec<usize> =
            k_means_medoids(&points, &[1.0, 1.0], 4, 1).iter().map(blob).collect();
        by_means.sort_unstable();
        assert_eq!(by_means, [0, 1, 2, 3]);
        let slices: Vec<&[f64]> = points.iter().map(Vec::as_slice).collect();
        let exemplars = affinity_propagation(&slices, &[1.0, 1.0]).unwrap();
        let mut found: Vec<usize> = exemplars.iter().map(blob).collect();
        found.dedup();
        assert_eq!(found, [0, 1, 2, 3], "every blob has an exemplar");
    }

    #[test]
    fn the_number_of_representatives_is_bounded() {
        let points = blobs(50);
        let chosen = representatives(&points, &[1.0, 1.0], 10, 30, 100, 3);
        assert!((4..=30).contains(&chosen.len()), "{}", chosen.len());
        assert!(representatives(&points[..5], &[1.0, 1.0], 10, 30, 100, 3).len() == 5);
    }

    /// Sixty points without symmetry.
    fn scattered() -> Vec<Vec<f64>> {
        let point = |i: f64| vec![(1.7 * i).sin(), (2.3 * i + 0.5).sin(), (0.9 * i).cos()];
        (0..60).map(|i| point(f64::from(i))).collect()
    }

    const WEIGHTS: [f64; 3] = [1.0, 0.5, 2.0];

    /// scikit-learn 1.9.1: `AffinityPropagation(damping=0.5, preference=median, affinity="precomputed", random_state=0)`
    /// with the negative squared distances of the points times the square roots of the weights, and their median off
    /// the diagonal; `cluster_centers_indices_`.
    #[test]
    fn exemplars_are_those_of_scikit_learn() {
        let points = scattered();
        let slices: Vec<&[f64]> = points.iter().map(Vec::as_slice).collect();
        let expected = [2, 4, 8, 17, 18, 19, 44, 48, 55];
        assert_eq!(affinity_propagation(&slices, &WEIGHTS).unwrap(), expected);
        // Negative control: the weights matter.
        assert_ne!(affinity_propagation(&slices, &[1.0; 3]).unwrap(), expected);
    }

    /// scikit-learn 1.9.1: `KMeans(5, n_init=20, random_state=0)` on the same points, scaled by 0.8 and moved to five
    /// corners; the points nearest to `cluster_centers_`.
    #[test]
    fn medoids_are_those_of_scikit_learn() {
        let corners =
            [[0.0, 0.0, 0.0], [6.0, 0.0, 0.0], [0.0, 6.0, 0.0], [0.0, 0.0, 6.0], [6.0, 6.0, 6.0]];
        let mut points = scattered();
        for (point, corner) in points.iter_mut().zip(corners.iter().cycle()) {
            point.iter_mut().zip(corner).for_each(|(x, c)| *x = c + 0.8 * *x);
        }
        // Lloyd's algorithm keeps to the valley it starts in; theirs is the best of twenty starts.
        let found = |weights: &[f64]| {
            let is_best = |seed| k_means_medoids(&points, weights, 5, seed) == [9, 26, 33, 37, 50];
            (0..20).filter(|&seed| is_best(seed)).count()
        };
        assert!(found(&WEIGHTS) >= 10, "{}", found(&WEIGHTS));
        // Negative control: the weights matter.
        assert_eq!(found(&[1.0, 4.0, 0.2]), 0);
    }
}
