//! Farthest-point sampling, exact, with buckets that skip what a new sample cannot change
//! (Han et al., *QuickFPS: Architecture and Algorithm Co-Design for Farthest Point Sampling*, 2023).

use super::{Sample, square_distance};

/// Largest number of points of a bucket.
const BUCKET: usize = 64;

/// Points close together, with how far each is from the nearest sample so far.
struct Bucket {
    low: [f32; 3],
    high: [f32; 3],
    positions: Vec<[f32; 3]>,
    /// Index of each point in the input.
    index: Vec<usize>,
    square_distance: Vec<f32>,
    /// Place of the farthest point in the bucket.
    farthest: usize,
}

impl Bucket {
    fn new(members: &[usize], points: &[Sample]) -> Self {
        let positions: Vec<[f32; 3]> = members.iter().map(|&i| points[i].position).collect();
        let bound = |pick: fn(f32, f32) -> f32| {
            std::array::from_fn(|axis| {
                positions.iter().map(|p| p[axis]).fold(positions[0][axis], pick)
            })
        };
        Self {
            low: bound(f32::min),
            high: bound(f32::max),
            square_distance: vec![f32::INFINITY; positions.len()],
            index: members.to_vec(),
            farthest: 0,
            positions,
        }
    }

    fn largest(&self) -> f32 {
        self.square_distance[self.farthest]
    }

    /// True where a sample at `position` is nearer to some point than the samples before.
    fn may_change(&self, position: [f32; 3]) -> bool {
        let nearest: [f32; 3] =
            std::array::from_fn(|i| position[i].max(self.low[i]).min(self.high[i]));
        square_distance(nearest, position) < self.largest()
    }

    fn add(&mut self, sample: [f32; 3]) {
        let mut best = (f32::NEG_INFINITY, usize::MAX);
        for (place, (distance, &position)) in
            self.square_distance.iter_mut().zip(&self.positions).enumerate()
        {
            *distance = distance.min(square_distance(position, sample));
            let index = self.index[place];
            if *distance > best.0 || (*distance == best.0 && index < best.1) {
                best = (*distance, index);
                self.farthest = place;
            }
        }
    }
}

/// Indices of up to `wanted` points: first the one farthest from the centroid, then always the one farthest from
/// all chosen before; of equally far ones the lowest index. Points at the same place are chosen once.
pub(super) fn farthest_points(points: &[Sample], wanted: usize) -> Vec<usize> {
    let Some(first) = farthest_from_centroid(points) else { return Vec::new() };
    let mut members: Vec<usize> = (0..points.len()).collect();
    let mut buckets = Vec::new();
    split(&mut members, points, &mut buckets);
    let mut chosen = vec![first];
    let mut largest: Vec<f32> = vec![f32::INFINITY; buckets.len()];
    while chosen.len() < wanted.min(points.len()) {
        let sample = points[chosen[chosen.len() - 1]].position;
        for (bucket, largest) in buckets.iter_mut().zip(&mut largest) {
            if bucket.may_change(sample) {
                bucket.add(sample);
                *largest = bucket.largest();
            }
        }
        let mut best = (0.0, usize::MAX);
        for (bucket, &distance) in buckets.iter().zip(&largest) {
            if distance < best.0 {
                continue;
            }
            let index = bucket.index[bucket.farthest];
            if distance > best.0 || index < best.1 {
                best = (distance, index);
            }
        }
        if best.0 <= 0.0 {
            break;
        }
        chosen.push(best.1);
    }
    chosen
}

fn farthest_from_centroid(points: &[Sample]) -> Option<usize> {
    let mut sum = [0.0f64; 3];
    for point in points {
        (0..3).for_each(|i| sum[i] += f64::from(point.position[i]));
    }
    let centroid = sum.map(|v| (v / points.len() as f64) as f32);
    let distances = points.iter().map(|point| square_distance(point.position, centroid));
    let farther =
        |best: (usize, f32), next: (usize, f32)| if next.1 > best.1 { next } else { best };
    distances.enumerate().reduce(farther).map(|(index, _)| index)
}

/// Halves along the longest extent until a bucket holds the points.
fn split(members: &mut [usize], points: &[Sample], buckets: &mut Vec<Bucket>) {
    let bucket = Bucket::new(members, points);
    if members.len() <= BUCKET {
        buckets.push(bucket);
        return;
    }
    let extent = |axis: usize| bucket.high[axis] - bucket.low[axis];
    let axis = (0..3).max_by(|&i, &j| extent(i).total_cmp(&extent(j))).unwrap_or(0);
    let middle = members.len() / 2;
    members.select_nth_unstable_by(middle, |&i, &j| {
        points[i].position[axis].total_cmp(&points[j].position[axis]).then(i.cmp(&j))
    });
    let (left, right) = members.split_at_mut(middle);
    split(left, points, buckets);
    split(right, points, buckets);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    fn naive(points: &[Sample], wanted: usize) -> Vec<usize> {
        let mut chosen = vec![farthest_from_centroid(points).unwrap()];
        while chosen.len() < wanted {
            let distance = |i: usize| {
                let distances =
                    chosen.iter().map(|&c| square_distance(points[i].position, points[c].position));
                distances.fold(f32::INFINITY, f32::min)
            };
            let next = (0..points.len()).rev().max_by(|&i, &j| distance(i).total_cmp(&distance(j)));
            chosen.push(next.unwrap());
        }
        chosen
    }

    #[test]
    fn buckets_choose_what_the_plain_algorithm_does() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let points: Vec<Sample> = (0..900)
            .map(|pixel| Sample {
                // A coarse grid makes many ties.
                position: std::array::from_fn(|_| random.random_range(0..14) as f32 * 0.1),
                pixel,
                camera: 0,
            })
            .collect();
        let chosen = farthest_points(&points, 150);
        assert_eq!(chosen, naive(&points, 150));
    }

    #[test]
    fn duplicates_are_chosen_once() {
        let at = |x: f32| Sample { position: [x, 0.0, 0.0], pixel: 0, camera: 0 };
        assert_eq!(farthest_points(&[at(0.0), at(1.0), at(0.0), at(1.0)], 4).len(), 2);
        assert!(farthest_points(&[], 4).is_empty());
    }
}
