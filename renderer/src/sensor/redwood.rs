//! Structured light with a distortion that changes with depth.

use akrobat_cameras::sensor::Redwood;

use super::kinect::shifted;
use crate::seed::{Normal, Seed};

/// Control points of the distortion field across and down the image.
const GRID: [usize; 2] = [9, 7];

/// Interpolating between independent values lowers the variance to (2/3)^2 of theirs on average.
const INTERPOLATION_GAIN: f64 = 1.5;

/// Distance between the depths at which the distortion is given, metres; the first is at 1 m.
const SLICE_M: f64 = 2.0;

/// The smooth field by which a camera's depths are distorted: standard normal over the image.
#[derive(Debug, Clone)]
pub struct DistortionField {
    values: Vec<f64>,
    size: [usize; 2],
}

impl DistortionField {
    /// Draws the field of one camera of `width` x `height` pixels.
    pub fn new(width: usize, height: usize, seed: Seed) -> Self {
        let (mut random, mut normal) = (seed.stream(), Normal::default());
        let values =
            (0..GRID[0] * GRID[1]).map(|_| INTERPOLATION_GAIN * normal.next(&mut random)).collect();
        Self { values, size: [width, height] }
    }

    /// The field at a pixel.
    pub fn at(&self, u: usize, v: usize) -> f64 {
        let axis = |place: usize, axis: usize| {
            let last = GRID[axis] - 1;
            let position = place as f64 / (self.size[axis].max(2) - 1) as f64 * last as f64;
            let low = (position as usize).min(last - 1);
            (low, position - low as f64)
        };
        let ((column, x), (row, y)) = (axis(u, 0), axis(v, 1));
        let value = |column: usize, row: usize| self.values[row * GRID[0] + column];
        let along = |row: usize| value(column, row) * (1.0 - x) + value(column + 1, row) * x;
        along(row) * (1.0 - y) + along(row + 1) * y
    }
}

/// Standard deviation of the distortion factor at a depth: linear between the slices.
fn spread(sensor: &Redwood, depth_m: f64) -> f64 {
    let last = sensor.distortion.len() - 1;
    let position = ((depth_m - 1.0) / SLICE_M).clamp(0.0, last as f64);
    let low = (position as usize).min(last - 1);
    let fraction = position - low as f64;
    sensor.distortion[low] * (1.0 - fraction) + sensor.distortion[low + 1] * fraction
}

/// The depth that the sensor measures, metres; 0 where it measures none.
pub fn measure(
    depth_m: &[f32],
    width: usize,
    sensor: &Redwood,
    field: &DistortionField,
    seed: Seed,
) -> Vec<f32> {
    let (mut random, mut normal) = (seed.stream(), Normal::default());
    let height = depth_m.len() / width.max(1);
    let steps_m = sensor.focal_baseline_px_m / sensor.quantum_px;
    let noise_steps = sensor.disparity_noise_px / sensor.quantum_px;
    let mut measured = Vec::with_capacity(depth_m.len());
    for v in 0..height {
        for u in 0..width {
            let [shift_u, shift_v, noise] = [0; 3].map(|_| normal.next(&mut random));
            let x = shifted(u, shift_u * sensor.edge_shift_px, width);
            let y = shifted(v, shift_v * sensor.edge_shift_px, height);
            // Two by two pixels share a measurement.
            let (x, y) = (x & !1, y & !1);
            let ideal = f64::from(depth_m[y * width + x]);
            let factor = 1.0 + spread(sensor, ideal) * field.at(x, y);
            let distorted = ideal / factor.max(0.5);
            let disparity = (steps_m / distorted + noise * noise_steps).round();
            let valid = ideal > 0.0 && ideal <= sensor.max_m && disparity >= 1.0;
            measured.push(if valid { (steps_m / disparity) as f32 } else { 0.0 });
        }
    }
    measured
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 320;
    const HEIGHT: usize = 240;

    fn run(depth: impl Fn(usize, usize) -> f32, sensor: &Redwood, seed: u64) -> Vec<(f64, f64)> {
        let pixels = (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (u, v)));
        let depth_m: Vec<f32> = pixels.map(|(u, v)| depth(u, v)).collect();
        let field = DistortionField::new(WIDTH, HEIGHT, Seed::new(seed).name("field"));
        let measured = measure(&depth_m, WIDTH, sensor, &field, Seed::new(seed));
        depth_m.into_iter().zip(measured).map(|(a, b)| (a.into(), b.into())).collect()
    }

    #[test]
    fn disparities_are_rounded_and_as_noisy_as_published() {
        // Depth by row pairs, so that shifts and shared pixels hardly matter.
        let ramp = |_: usize, v: usize| 2.0 + 0.002 * (v / 2) as f32;
        let sensor = Redwood { distortion: [0.0; 5], edge_shift_px: 0.0, ..Redwood::default() };
        let mut squares = 0.0;
        let pairs = run(ramp, &sensor, 1);
        for (ideal, measured) in &pairs {
            let steps = 8.0 * 35.13 / measured;
            assert!((steps - steps.round()).abs() < 1e-4, "{steps}");
            squares += (35.13 / measured - 35.13 / ideal).powi(2);
        }
        let variance = squares / pairs.len() as f64;
        // 1/36 of a pixel, and eighths of a pixel, which add a twelfth of their square.
        let published = (1.0f64 / 36.0).powi(2) + 0.125f64.powi(2) / 12.0;
        assert!((variance / published - 1.0).abs() < 0.06, "{variance} instead of {published}");
    }

    #[test]
    fn distortion_grows_with_depth_as_specified() {
        for (depth, expected) in [(1.0f32, 0.002), (4.0, 0.009), (9.0, 0.024)] {
            let sensor = Redwood {
                disparity_noise_px: 0.0,
                quantum_px: 1e-4,
                edge_shift_px: 0.0,
                ..Redwood::default()
            };
            let mut squares = 0.0;
            const SEEDS: u64 = 40;
            for seed in 0..SEEDS {
                let pairs = run(|_, _| depth, &sensor, seed);
                let deviation =
                    pairs.iter().map(|(ideal, measured)| (ideal / measured - 1.0).powi(2));
                squares += deviation.sum::<f64>() / pairs.len() as f64;
            }
            let found = (squares / SEEDS as f64).sqrt();
            assert!(
                (found / expected - 1.0).abs() < 0.15,
                "{depth}: {found} instead of {expected}"
            );
        }
    }

    #[test]
    fn two_by_two_pixels_share_a_measurement() {
        let sensor = Redwood {
            distortion: [0.0; 5],
            edge_shift_px: 0.0,
            disparity_noise_px: 0.0,
            ..Redwood::default()
        };
        let pairs = run(|u, v| 1.0 + 0.01 * ((7 * u + 13 * v) % 50) as f32, &sensor, 1);
        for (v, u) in (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (v, u))) {
            assert_eq!(pairs[v * WIDTH + u].1, pairs[(v & !1) * WIDTH + (u & !1)].1);
        }
        assert!(run(|_, _| 11.0, &sensor, 1).iter().all(|pair| pair.1 == 0.0));
    }
}
