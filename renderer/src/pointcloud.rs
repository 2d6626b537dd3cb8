//! One cloud of a fixed number of points from all cameras.
//!
//! Every valid pixel of the unquantised depth images becomes a point in the world frame; what lies outside the crop is
//! dropped; voxels thin the rest to a few times the number asked for (one point a voxel, the first in
//! the order of cameras, rows and columns); farthest-point sampling picks the points from these.

use akrobat_cameras::{CameraFrame, CloudPoint};
use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod farthest;
mod thin;

/// How clouds are made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CloudConfig {
    /// Number of points of every cloud; 0 for no clouds.
    pub points: usize,
    /// Edge of the smallest thinning voxels, metres; doubled while more than enough points remain.
    pub voxel_m: f64,
    /// Keep only points within this distance of the handle, metres.
    pub radius_m: Option<f64>,
    /// Keep only points in this box of the world: `[xmin ymin zmin xmax ymax zmax]`, metres.
    pub region: Option<[f64; 6]>,
}

impl Default for CloudConfig {
    fn default() -> Self {
        Self { points: 4096, voxel_m: 0.01, radius_m: None, region: None }
    }
}

/// Fuses one frame's images.
///
/// The result has exactly `config.points` points, in the order of the sampling, so that any head of it is a
/// coarser cloud of the same scene. Where fewer pixels are valid, the points repeat from the first; where
/// none is, all are zero.
pub fn fuse(
    cameras: &[CameraFrame],
    handle_position: &Point3<f64>,
    config: &CloudConfig,
) -> Vec<CloudPoint> {
    if config.points == 0 {
        return Vec::new();
    }
    let crop = Crop::new(config, handle_position);
    let mut points = Vec::new();
    for (camera, index) in cameras.iter().zip(0u16..) {
        gather(camera, index, &crop, &mut points);
    }
    let thinned = thin::thin(points, config.voxel_m as f32, config.points);
    let order = farthest::farthest_points(&thinned, config.points);
    let chosen: Vec<CloudPoint> = order.iter().map(|&i| colored(&thinned[i], cameras)).collect();
    if chosen.is_empty() {
        return vec![[0.0; 6]; config.points];
    }
    chosen.iter().copied().cycle().take(config.points).collect()
}

/// A pixel's point.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// World frame, metres.
    position: [f32; 3],
    pixel: u32,
    camera: u16,
}

fn colored(sample: &Sample, cameras: &[CameraFrame]) -> CloudPoint {
    let rgb = &cameras[usize::from(sample.camera)].rgb[3 * sample.pixel as usize..][..3];
    let [x, y, z] = sample.position;
    [x, y, z, f32::from(rgb[0]), f32::from(rgb[1]), f32::from(rgb[2])]
}

/// Where points are kept.
struct Crop {
    low: [f32; 3],
    high: [f32; 3],
    center: [f32; 3],
    square_radius: f32,
}

impl Crop {
    fn new(config: &CloudConfig, handle_position: &Point3<f64>) -> Self {
        let region = config.region.map(|region| region.map(|v| v as f32));
        let corner = |first: usize, open: f32| {
            region.map_or([open; 3], |r| [r[first], r[first + 1], r[first + 2]])
        };
        Self {
            low: corner(0, f32::NEG_INFINITY),
            high: corner(3, f32::INFINITY),
            center: std::array::from_fn(|i| handle_position[i] as f32),
            square_radius: config.radius_m.map_or(f32::INFINITY, |r| (r * r) as f32),
        }
    }

    fn keeps(&self, p: [f32; 3]) -> bool {
        (0..3).all(|i| self.low[i] <= p[i] && p[i] <= self.high[i])
            && square_distance(p, self.center) <= self.square_radius
    }
}

fn square_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

fn gather(camera: &CameraFrame, index: u16, crop: &Crop, points: &mut Vec<Sample>) {
    let i = &camera.intrinsics;
    let rotation = camera.world_from_camera.rotation.to_rotation_matrix();
    let origin = camera.world_from_camera.translation.vector;
    let column = |axis: usize, scale: f64| rotation.matrix().column(axis).into_owned() * scale;
    let (step_u, step_v) = (column(0, 1.0 / i.fx), column(1, 1.0 / i.fy));
    for v in 0..i.height {
        let row_ray = column(2, 1.0) + step_v * (f64::from(v) + 0.5 - i.cy);
        for u in 0..i.width {
            let pixel = v * i.width + u;
            let depth_m = f64::from(camera.depth_m[pixel as usize]);
            if depth_m <= 0.0 {
                continue;
            }
            let world = origin + (row_ray + step_u * (f64::from(u) + 0.5 - i.cx)) * depth_m;
            let position = [world.x as f32, world.y as f32, world.z as f32];
            if crop.keeps(position) {
                points.push(Sample { position, pixel, camera: index });
            }
        }
    }
}
