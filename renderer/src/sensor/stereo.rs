//! Active stereo: two infrared images with a projected pattern, matched.

use akrobat_cameras::sensor::Stereo;
use akrobat_cameras::{CameraFrame, Intrinsics};
use rayon::prelude::*;

use crate::seed::{Normal, Seed};
use crate::srgb::SrgbTables;

/// What both cameras see; the left one is the rig's.
#[derive(Debug, Clone, Copy)]
pub struct StereoPair<'a> {
    /// Ideal images of the rig's camera, a pinhole.
    pub left: &'a CameraFrame,
    /// Ideal images of the same camera, moved along its x axis by the baseline.
    pub right: &'a CameraFrame,
}

/// Share of the visible light's luminance that counts as ambient infrared.
const AMBIENT_SHARE: f32 = 0.5;

/// The depth that the sensor measures, metres, in the left image; 0 where it measures none.
pub fn measure(pair: &StereoPair<'_>, sensor: &Stereo, seed: Seed) -> Vec<f32> {
    let i = pair.left.intrinsics;
    let baseline = sensor.baseline_m as f32;
    // The projector is in the middle: to the right of the left camera, to the left of the right one.
    let [left, right] =
        [(pair.left, 0.5 * baseline, "left"), (pair.right, -0.5 * baseline, "right")].map(
            |(image, projector_x_m, name)| infrared(image, projector_x_m, sensor, seed.name(name)),
        );
    let disparity = match_images(&left, &right, i.width as usize, sensor);
    let scale = (i.fx * sensor.baseline_m) as f32;
    let depth = |&disparity: &f32| {
        let depth = scale / disparity;
        if disparity > 0.0 && depth <= sensor.max_m as f32 { depth } else { 0.0 }
    };
    disparity.iter().map(depth).collect()
}

/// Luminance with the projected pattern and noise, 0 to 255.
fn infrared(image: &CameraFrame, projector_x_m: f32, sensor: &Stereo, seed: Seed) -> Vec<u8> {
    let srgb = SrgbTables::get();
    let (mut random, mut normal) = (seed.stream(), Normal::default());
    let Intrinsics { width, fx, fy, cx, cy, .. } = image.intrinsics;
    let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|v| v as f32);
    let pixel = |pixel: usize| {
        let [r, g, b] = [0, 1, 2].map(|i| srgb.decode(image.rgb[3 * pixel + i]));
        let luminance = 0.2126 * r + 0.7152 * g + 0.0722 * b;
        let depth = image.depth_m[pixel];
        let mut light = AMBIENT_SHARE * luminance;
        if depth > 0.0 {
            let (u, v) = ((pixel % width as usize) as f32, (pixel / width as usize) as f32);
            let (x, y) = ((u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy);
            let direction = [x - projector_x_m / depth, y];
            // Infrared paints differ less than colours do: half of the reflection is the surface's luminance.
            let reflection = 0.5 + 0.5 * luminance;
            let falloff = (depth * depth).max(0.1).recip().min(1.5);
            light += sensor.dot_intensity as f32 * reflection * falloff * dots(direction, sensor);
        }
        light += (sensor.infrared_noise * normal.next(&mut random)) as f32;
        (light.clamp(0.0, 1.0) * 255.0).round() as u8
    };
    (0..image.depth_m.len()).map(pixel).collect()
}

/// Light of the pattern in a direction from the projector: a dot at a random place of every other cell,
/// the same for all devices.
fn dots(direction: [f32; 2], sensor: &Stereo) -> f32 {
    /// Width of a dot, cells.
    const RADIUS: f32 = 0.35;
    let place = direction.map(|tangent| tangent * sensor.dots_per_rad as f32);
    let cell = place.map(|p| p.floor());
    let mut light = 0.0f32;
    for dy in -1..=1 {
        for dx in -1..=1 {
            let corner = [cell[0] + dx as f32, cell[1] + dy as f32];
            let hash = mixed(corner[0] as i32, corner[1] as i32);
            if hash & 1 == 0 {
                continue;
            }
            let part = |shift: u32| ((hash >> shift) & 0x3ff) as f32 / 1024.0;
            let (x, y) = (place[0] - corner[0] - part(1), place[1] - corner[1] - part(11));
            light = light.max((-(x * x + y * y) / (2.0 * RADIUS * RADIUS)).exp());
        }
    }
    light
}

/// A hash of a cell (the finaliser of MurmurHash3).
fn mixed(x: i32, y: i32) -> u32 {
    let mut hash = (x as u32).wrapping_mul(0x9E37_79B1) ^ (y as u32).wrapping_mul(0x85EB_CA77);
    hash = (hash ^ (hash >> 16)).wrapping_mul(0x85EB_CA6B);
    hash = (hash ^ (hash >> 13)).wrapping_mul(0xC2B2_AE35);
    hash ^ (hash >> 16)
}

/// Disparities of the left image, pixels; 0 where none is found.
fn match_images(left: &[u8], right: &[u8], width: usize, sensor: &Stereo) -> Vec<f32> {
    let height = left.len() / width;
    let range = sensor.max_disparity_px as usize + 1;
    let radius = sensor.census_radius as usize;
    let (left, right) = (census(left, width, radius), census(right, width, radius));
    let unknown = ((2 * radius + 1) * (2 * radius + 1)) as u16;
    let mut costs = vec![unknown; left.len() * range];
    costs.par_chunks_exact_mut(width * range).enumerate().for_each(|(v, row)| {
        for u in 0..width {
            for d in 0..range.min(u + 1) {
                let bits = left[v * width + u] ^ right[v * width + u - d];
                row[u * range + d] = bits.count_ones() as u16;
            }
        }
    });
    let volume = Volume { width, height, range, costs };
    let sums = volume.aggregated(sensor.small_step_cost as u16, sensor.large_step_cost as u16);
    let mut disparity = vec![0.0; left.len()];
    disparity.par_chunks_exact_mut(width).enumerate().for_each(|(v, row)| {
        choose(&sums[v * width * range..(v + 1) * width * range], range, sensor, row);
    });
    disparity
}

/// Census transform: one bit for each pixel of a window, set where it is darker than the middle.
fn census(image: &[u8], width: usize, radius: usize) -> Vec<u64> {
    let height = image.len() / width;
    let clamped = |place: usize, step: usize, size: usize| {
        (place + step).saturating_sub(radius).min(size - 1)
    };
    let bits = |pixel: usize| {
        let (u, v) = (pixel % width, pixel / width);
        let mut bits = 0u64;
        for row in 0..=2 * radius {
            for column in 0..=2 * radius {
                let other = clamped(v, row, height) * width + clamped(u, column, width);
                bits = bits << 1 | u64::from(image[other] < image[pixel]);
            }
        }
        bits
    };
    (0..image.len()).map(bits).collect()
}

/// Matching costs `[height, width, range]`.
struct Volume {
    width: usize,
    height: usize,
    range: usize,
    costs: Vec<u16>,
}

impl Volume {
    /// Sum over paths from the left, the right, above and below.
    fn aggregated(&self, small_step: u16, large_step: u16) -> Vec<u16> {
        let Self { width, height, range, costs } = self;
        let stride = width * range;
        let mut sums = vec![0u16; costs.len()];
        sums.par_chunks_exact_mut(stride).zip(costs.par_chunks_exact(stride)).for_each(
            |(sums, costs)| {
                let mut path = Path::new(*range, small_step, large_step);
                for u in 0..*width {
                    path.step(&costs[u * range..][..*range], &mut sums[u * range..][..*range]);
                }
                path.restart();
                for u in (0..*width).rev() {
                    path.step(&costs[u * range..][..*range], &mut sums[u * range..][..*range]);
                }
            },
        );
        // Columns have no contiguous rows to share out; a band of columns per thread would need copies.
        for down in [true, false] {
            let mut paths: Vec<Path> =
                (0..*width).map(|_| Path::new(*range, small_step, large_step)).collect();
            for step in 0..*height {
                let v = if down { step } else { height - 1 - step };
                let (sums, costs) =
                    (&mut sums[v * stride..][..stride], &costs[v * stride..][..stride]);
                paths
                    .par_iter_mut()
                    .with_min_len(64)
                    .zip(sums.par_chunks_exact_mut(*range))
                    .zip(costs.par_chunks_exact(*range))
                    .for_each(|((path, sums), costs)| path.step(costs, sums));
            }
        }
        sums
    }
}

/// The recursion of semi-global matching along one path.
struct Path {
    before: Vec<u16>,
    now: Vec<u16>,
    small_step: u16,
    large_step: u16,
}

impl Path {
    fn new(range: usize, small_step: u16, large_step: u16) -> Self {
        Self { before: vec![0; range], now: vec![0; range], small_step, large_step }
    }

    fn restart(&mut self) {
        self.before.fill(0);
    }

    fn step(&mut self, costs: &[u16], sums: &mut [u16]) {
        let least = self.before.iter().copied().min().unwrap_or(0);
        let jump = least + self.large_step;
        let last = costs.len() - 1;
        for d in 0..costs.len() {
            let mut best = self.before[d].min(jump);
            if d > 0 {
                best = best.min(self.before[d - 1] + self.small_step);
            }
            if d < last {
                best = best.min(self.before[d + 1] + self.small_step);
            }
            self.now[d] = costs[d] + (best - least);
            sums[d] += self.now[d];
        }
        std::mem::swap(&mut self.before, &mut self.now);
    }
}

/// Disparities of one row from the summed costs `[width, range]`.
fn choose(sums: &[u16], range: usize, sensor: &Stereo, row: &mut [f32]) {
    let width = row.len();
    let of = |u: usize| &sums[u * range..][..range];
    let best_of_left: Vec<usize> = (0..width).map(|u| first_least(of(u).iter().copied())).collect();
    // The right image's costs are the same volume, read along its diagonals.
    let best_of_right: Vec<usize> =
        (0..width).map(|u| first_least((0..range.min(width - u)).map(|d| of(u + d)[d]))).collect();
    for u in 0..width {
        let d = best_of_left[u];
        if d == 0 || d + 1 >= range || d > u {
            continue;
        }
        let costs = of(u);
        let rival =
            (0..range).filter(|other| other.abs_diff(d) > 1).map(|other| costs[other]).min();
        let needed = u32::from(costs[d]) * (100 + sensor.uniqueness_percent);
        let is_unique = rival.is_none_or(|rival| u32::from(rival) * 100 >= needed);
        let back = best_of_right[u - d];
        if !is_unique || (back.abs_diff(d) as f64) > sensor.left_right_px {
            continue;
        }
        let [before, here, after] = [d - 1, d, d + 1].map(|place| f32::from(costs[place]));
        // Costs of binary strings are V-shaped: two lines of equal slope (Shimizu and Okutomi, ICCV 2001).
        let slope = before.max(after) - here;
        let offset = if slope > 0.0 { 0.5 * (before - after) / slope } else { 0.0 };
        row[u] = d as f32 + offset.clamp(-0.5, 0.5);
    }
}

fn first_least(costs: impl Iterator<Item = u16>) -> usize {
    let (mut best, mut least) = (0, u16::MAX);
    for (place, cost) in costs.enumerate() {
        if cost < least {
            (best, least) = (place, cost);
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use akrobat_model::Pose;

    const WIDTH: u32 = 320;
    const HEIGHT: u32 = 240;

    /// A grey world in which the depth along a ray is known for any camera at `(x, 0, 0)` that looks along z.
    fn view(x_m: f64, depth: impl Fn(f64, f64) -> f64) -> CameraFrame {
        let intrinsics = Intrinsics::from_horizontal_fov(WIDTH, HEIGHT, 1.2);
        let pixels: Vec<[f64; 3]> = (0..HEIGHT)
            .flat_map(|v| (0..WIDTH).map(move |u| intrinsics.unproject(u, v, 1.0)))
            .collect();
        CameraFrame {
            rgb: vec![128; 3 * pixels.len()],
            depth_m: pixels.iter().map(|ray| depth(x_m, ray[0]) as f32).collect(),
            segmentation: vec![1; pixels.len()],
            ..CameraFrame::new("ir", intrinsics, Pose::translation(x_m, 0.0, 0.0))
        }
    }

    fn measured(
        sensor: &Stereo,
        depth: impl Fn(f64, f64) -> f64 + Copy,
    ) -> (CameraFrame, Vec<f32>) {
        let (left, right) = (view(0.0, depth), view(sensor.baseline_m, depth));
        let pair = StereoPair { left: &left, right: &right };
        let found = measure(&pair, sensor, Seed::new(1));
        (left, found)
    }

    /// Share of valid pixels in the middle of the image, and the root mean square of their disparity error.
    fn disparity_error_px(sensor: &Stereo, depth_m: f64) -> (f64, f64) {
        let (left, found) = measured(sensor, |_, _| depth_m);
        let scale = left.intrinsics.fx * sensor.baseline_m;
        let middle = |pixel: &usize| (60..300).contains(&(pixel % WIDTH as usize));
        let pixels: Vec<usize> = (0..found.len()).filter(middle).collect();
        let errors: Vec<f64> = pixels
            .iter()
            .filter(|&&pixel| found[pixel] > 0.0)
            .map(|&pixel| scale / f64::from(found[pixel]) - scale / depth_m)
            .collect();
        let squares = errors.iter().map(|e| e * e).sum::<f64>();
        (errors.len() as f64 / pixels.len() as f64, (squares / errors.len() as f64).sqrt())
    }

    #[test]
    fn disparities_of_a_wall_are_found_to_a_fraction_of_a_pixel() {
        // Depth errors grow with the square of the depth because disparity errors do not.
        let errors = [0.6, 1.07, 1.9].map(|m| (m, disparity_error_px(&Stereo::default(), m)));
        for (depth_m, (valid, error)) in errors {
            assert!(
                valid > 0.9 && error < 0.35,
                "{depth_m} m: {valid} valid, {error} px: {errors:?}"
            );
        }
        // Control: without a pattern there is nothing to match on a grey wall.
        let blank = Stereo { dot_intensity: 0.0, ..Stereo::default() };
        let (valid, _) = disparity_error_px(&blank, 1.07);
        assert!(valid < 0.3, "{valid}");
    }

    #[test]
    fn what_one_camera_does_not_see_is_not_measured() {
        // A wall 1 m away before another 2 m away; its right edge is at x = 0 in the world.
        let depth = |x: f64, ray: f64| if x + ray < 0.0 { 1.0 } else { 2.0 };
        let mirrored = |x: f64, ray: f64| if x + ray > 0.0 { 1.0 } else { 2.0 };
        let sensor = Stereo::default();
        let expected = WIDTH as f64 / (2.0 * 0.6f64.tan()) * sensor.baseline_m * (1.0 - 0.5);
        // Left of a near surface, the right camera's view is blocked; right of one, it is not.
        let invalid = |depth: &dyn Fn(f64, f64) -> f64| {
            let (_, found) = measured(&sensor, depth);
            let rows = found.chunks_exact(WIDTH as usize);
            let near_edge = |row: &[f32]| row[130..190].iter().filter(|&&d| d == 0.0).count();
            rows.map(near_edge).sum::<usize>() as f64 / f64::from(HEIGHT)
        };
        let (open, blocked) = (invalid(&depth), invalid(&mirrored));
        assert!((blocked - expected).abs() < 4.0, "{blocked} columns, expected {expected}");
        assert!(open < 0.5 * blocked, "{open} {blocked}");
    }

    #[test]
    fn what_is_too_near_is_not_measured() {
        let sensor = Stereo { max_disparity_px: 16, ..Stereo::default() };
        let (_, found) = measured(&sensor, |_, _| 0.4);
        let valid = found.iter().filter(|&&d| (d - 0.4).abs() < 0.05).count();
        assert_eq!(valid, 0, "29 pixels of disparity");
    }
}
