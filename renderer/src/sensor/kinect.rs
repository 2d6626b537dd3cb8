//! Structured light: shifted pixels, rounded disparity, shadows, no grazing surfaces.

use akrobat_cameras::sensor::Kinect;

use crate::seed::{Normal, Seed};

/// An ideal depth image and what goes with it.
#[derive(Debug, Clone, Copy)]
pub struct IdealDepth<'a> {
    /// Image width, pixels.
    pub width: usize,
    /// Focal length along x, pixels.
    pub focal_px: f64,
    /// z-depth, metres; 0 is invalid.
    pub depth_m: &'a [f32],
    /// Cosine of the angle between the surface's normal and the line of sight.
    pub facing: &'a [f32],
}

/// The depth that the sensor measures, metres; 0 where it measures none.
pub fn measure(ideal: &IdealDepth<'_>, sensor: &Kinect, seed: Seed) -> Vec<f32> {
    let (mut random, mut normal) = (seed.stream(), Normal::default());
    let IdealDepth { width, depth_m, .. } = *ideal;
    let height = depth_m.len() / width.max(1);
    let least_facing = sensor.grazing_rad.cos() as f32;
    let lit = lit_by_projector(ideal, sensor);
    let step = sensor.focal_baseline_px_m / sensor.quantum_px;
    let mut measured = Vec::with_capacity(depth_m.len());
    for v in 0..height {
        for u in 0..width {
            let [shift_u, shift_v, noise] = [0; 3].map(|_| normal.next(&mut random));
            let source = shifted(v, shift_v * sensor.edge_shift_px, height) * width
                + shifted(u, shift_u * sensor.edge_shift_px, width);
            let depth = f64::from(depth_m[source]);
            let is_seen = depth >= sensor.min_m.max(1e-6)
                && depth <= sensor.max_m
                && lit[source]
                && ideal.facing[source] >= least_facing;
            let disparity = (step / depth + noise * sensor.disparity_noise).round();
            let valid = is_seen && disparity >= 1.0;
            measured.push(if valid { (step / disparity) as f32 } else { 0.0 });
        }
    }
    measured
}

/// A pixel's place along one axis, moved and kept within the image.
pub(super) fn shifted(place: usize, shift_px: f64, size: usize) -> usize {
    (place as f64 + shift_px).round().clamp(0.0, size as f64 - 1.0) as usize
}

/// Which pixels the projector reaches. It is rectified with the camera: a point at depth `z` lies
/// `f b / z` columns to the left in its image, where only the nearest point of each column is lit.
fn lit_by_projector(ideal: &IdealDepth<'_>, sensor: &Kinect) -> Vec<bool> {
    /// What lies deeper than the nearest by less than this share is the same surface.
    const SAME_SURFACE: f32 = 0.02;
    let shift = (ideal.focal_px * sensor.projector_baseline_m) as f32;
    if shift == 0.0 {
        return vec![true; ideal.depth_m.len()];
    }
    let width = ideal.width;
    let column = |u: usize, depth: f32| (u as f32 - shift / depth).floor();
    let mut lit = Vec::with_capacity(ideal.depth_m.len());
    let mut nearest = vec![f32::INFINITY; width];
    for row in ideal.depth_m.chunks_exact(width) {
        nearest.fill(f32::INFINITY);
        for (u, &depth) in row.iter().enumerate().filter(|(_, depth)| **depth > 0.0) {
            // Neighbouring columns, so that no light falls between the samples of a slope.
            for place in [column(u, depth), column(u, depth) + 1.0] {
                if (0.0..width as f32).contains(&place) {
                    let entry = &mut nearest[place as usize];
                    *entry = entry.min(depth);
                }
            }
        }
        lit.extend(row.iter().enumerate().map(|(u, &depth)| {
            let place = column(u, depth);
            let hidden = depth > 0.0
                && (0.0..width as f32).contains(&place)
                && depth > nearest[place as usize] * (1.0 + SAME_SURFACE);
            !hidden
        }));
    }
    lit
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 320;
    const HEIGHT: usize = 240;

    fn measured(depth: impl Fn(usize, usize) -> f32, sensor: &Kinect) -> (Vec<f32>, Vec<f32>) {
        let pixels = (0..HEIGHT).flat_map(|v| (0..WIDTH).map(move |u| (u, v)));
        let depth_m: Vec<f32> = pixels.map(|(u, v)| depth(u, v)).collect();
        let facing = vec![1.0; depth_m.len()];
        let ideal =
            IdealDepth { width: WIDTH, focal_px: 300.0, depth_m: &depth_m, facing: &facing };
        let measured = measure(&ideal, sensor, Seed::new(1));
        (depth_m, measured)
    }

    /// Depth that changes so slowly that shifted pixels do not matter, but crosses many steps.
    fn ramp(u: usize, v: usize) -> f32 {
        1.5 + 1e-5 * (v * WIDTH + u) as f32
    }

    #[test]
    fn disparities_are_rounded_and_as_noisy_as_published() {
        let sensor = Kinect { edge_shift_px: 0.0, ..Kinect::default() };
        let step = sensor.focal_baseline_px_m / sensor.quantum_px;
        let (ideal, measured) = measured(ramp, &sensor);
        let mut errors = Vec::new();
        for (&ideal, &measured) in ideal.iter().zip(&measured) {
            let disparity = step / f64::from(measured);
            assert!((disparity - disparity.round()).abs() < 1e-4, "{disparity}");
            errors.push(disparity - step / f64::from(ideal));
        }
        // Noise of a sixth of a step, then rounding, which adds a twelfth of a square step.
        let variance = errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64;
        let published = (1.0f64 / 6.0).powi(2) + 1.0 / 12.0;
        assert!((variance / published - 1.0).abs() < 0.03, "{variance} instead of {published}");
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        assert!(mean.abs() < 0.01, "{mean}");
        // Control: twice the noise is not within the tolerance.
        let noisy = Kinect { disparity_noise: 1.0 / 3.0, ..sensor };
        let (ideal, measured) = self::measured(ramp, &noisy);
        let errors =
            ideal.iter().zip(&measured).map(|(&a, &b)| step / f64::from(b) - step / f64::from(a));
        let variance = errors.map(|e| e * e).sum::<f64>() / ideal.len() as f64;
        assert!(variance / published > 1.5, "{variance}");
    }

    #[test]
    fn edges_are_as_ragged_as_published() {
        let edge = |u: usize, _: usize| if u < WIDTH / 2 { 1.0 } else { 3.0 };
        let sensor = Kinect { projector_baseline_m: 0.0, ..Kinect::default() };
        let (_, measured) = measured(edge, &sensor);
        let crossed = |column: usize, expect_near: bool| {
            let rows = (0..HEIGHT).filter(|v| (measured[v * WIDTH + column] < 2.0) != expect_near);
            rows.count() as f64 / HEIGHT as f64
        };
        // A normal shift of sigma 1/2 rounds to a pixel or more to one side with probability P(N > 1) = 0.1587.
        for share in [crossed(WIDTH / 2 - 1, true), crossed(WIDTH / 2, false)] {
            assert!((share - 0.1587).abs() < 0.07, "{share}");
        }
        assert_eq!(crossed(WIDTH / 2 - 5, true), 0.0);
    }

    #[test]
    fn the_projector_casts_a_shadow_of_the_width_that_geometry_says() {
        let near = 100..200;
        let box_before_wall = |u: usize, _: usize| if near.contains(&u) { 1.0 } else { 2.0 };
        let sensor = Kinect { edge_shift_px: 0.0, disparity_noise: 0.0, ..Kinect::default() };
        let (_, measured) = measured(box_before_wall, &sensor);
        let row = &measured[100 * WIDTH..101 * WIDTH];
        let invalid: Vec<usize> = (0..WIDTH).filter(|&u| row[u] == 0.0).collect();
        // f b (1/z1 - 1/z2) = 300 * 0.075 * 0.5 = 11.25 pixels, left of the box for a projector to the right.
        assert!((10..=13).contains(&invalid.len()), "{invalid:?}");
        assert!(invalid.iter().all(|u| (86..100).contains(u)), "{invalid:?}");
        let unshadowed = Kinect { projector_baseline_m: 0.0, ..sensor };
        assert!(!self::measured(box_before_wall, &unshadowed).1.contains(&0.0));
    }

    #[test]
    fn what_is_out_of_range_or_grazing_is_not_measured() {
        let sensor = Kinect::default();
        assert!(measured(|_, _| 0.3, &sensor).1.iter().all(|&depth| depth == 0.0));
        assert!(measured(|_, _| 9.0, &sensor).1.iter().all(|&depth| depth == 0.0));
        let depth_m = vec![1.0; 64];
        let facing = vec![0.1; 64];
        let ideal = IdealDepth { width: 8, focal_px: 300.0, depth_m: &depth_m, facing: &facing };
        assert!(measure(&ideal, &sensor, Seed::new(0)).iter().all(|&depth| depth == 0.0));
    }
}
