//! One cloud of a fixed number of points from all cameras.
//!
//! Every valid pixel of the unquantised depth images becomes a point in the world frame; what lies outside the crop is
//! dropped; farthest-point sampling, or voxels, pick the points from the rest.

use akrobat_cameras::{CameraFrame, CloudPoint};
use akrobat_model::Pose;
use nalgebra::{Matrix4, Point3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod farthest;
mod voxel;

/// How clouds are made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CloudConfig {
    /// Number of points of every cloud; 0 for no clouds.
    pub points: usize,
    /// How points are chosen.
    pub sampling: CloudSampling,
    /// Edge of the smallest voxels of voxel sampling, metres.
    pub voxel_m: f64,
    /// Keep only points within this distance of the handle, metres.
    pub radius_m: Option<f64>,
    /// Keep only points in this box of the cloud's frame: `[xmin ymin zmin xmax ymax zmax]`, metres.
    pub region: Option<[f64; 6]>,
    /// Frame of the points.
    pub frame: CloudFrame,
    /// Whether points have colours.
    pub color: bool,
    /// Whether points have surface normals.
    pub normals: bool,
}

impl Default for CloudConfig {
    fn default() -> Self {
        Self {
            points: 4096,
            sampling: CloudSampling::Farthest,
            voxel_m: 0.01,
            radius_m: None,
            region: None,
            frame: CloudFrame::World,
            color: true,
            normals: false,
        }
    }
}

impl CloudConfig {
    /// Checks the values.
    ///
    /// # Errors
    /// What was expected and what was got.
    pub fn check(&self) -> Result<(), String> {
        const MOST: usize = 1 << 20;
        if self.points > MOST {
            return Err(format!("a cloud has at most {MOST} points, got {}", self.points));
        }
        if !(self.voxel_m.is_finite() && self.voxel_m >= 1e-4) {
            return Err(format!("voxel_m must be at least 0.0001, got {}", self.voxel_m));
        }
        if let Some(radius) = self.radius_m.filter(|r| !(r.is_finite() && *r > 0.0)) {
            return Err(format!("radius_m must be above 0, got {radius}"));
        }
        match &self.region {
            Some(r) if !(0..3).all(|i| r[i] < r[i + 3]) => Err(format!(
                "the region must be xmin ymin zmin xmax ymax zmax, each minimum below its maximum, \
                 got {r:?}"
            )),
            _ => Ok(()),
        }
    }
}

/// How the points of a cloud are chosen.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CloudSampling {
    /// Each point is the one farthest from all before it.
    #[default]
    Farthest,
    /// One point per voxel, of the voxel size that leaves the number asked for.
    Voxel,
}

impl CloudSampling {
    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Farthest => "farthest",
            Self::Voxel => "voxel",
        }
    }
}

/// Frame of a cloud's points.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum CloudFrame {
    /// The world.
    #[default]
    World,
    /// The robot's base link.
    Base,
    /// The rig's first camera.
    Camera,
}

impl CloudFrame {
    /// Name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::World => "world",
            Self::Base => "base",
            Self::Camera => "camera",
        }
    }
}

/// Where things are while a cloud is taken.
#[derive(Debug, Clone, Copy)]
pub struct CloudPlace {
    /// Handle in the world, metres.
    pub handle: Point3<f64>,
    /// Pose of the robot's base link.
    pub world_from_base: Pose,
}

/// A cloud.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Cloud {
    /// Positions and colours; colours are 0 where not asked for.
    pub points: Vec<CloudPoint>,
    /// Unit normals in the cloud's frame; empty where not asked for.
    pub normals: Vec<[f32; 3]>,
}

/// Fuses one frame's images.
///
/// The result has exactly `config.points` points. Farthest-point sampling gives them in its order, so that
/// any head of the cloud is a coarser cloud of the same scene. Where fewer pixels are valid, the points repeat
/// from the first; where none is, all are zero.
pub fn fuse(cameras: &[CameraFrame], place: &CloudPlace, config: &CloudConfig) -> Cloud {
    if config.points == 0 {
        return Cloud::default();
    }
    let frame_from_world = match (config.frame, cameras.first()) {
        (CloudFrame::Base, _) => place.world_from_base.inverse(),
        (CloudFrame::Camera, Some(camera)) => camera.world_from_camera.inverse(),
        (CloudFrame::World, _) | (CloudFrame::Camera, None) => Pose::identity(),
    };
    let crop = Crop::new(config, &(frame_from_world * place.handle));
    let mut points = Points::default();
    for (camera, index) in cameras.iter().zip(0u32..) {
        gather(camera, index, &frame_from_world, &crop, &mut points);
    }
    let order = match config.sampling {
        CloudSampling::Farthest => farthest::farthest_points(&points.positions(), config.points),
        CloudSampling::Voxel => {
            voxel::sample(&points.positions(), config.voxel_m as f32, config.points)
        }
    };
    if order.is_empty() {
        return Cloud {
            points: vec![[0.0; 6]; config.points],
            normals: if config.normals { vec![[0.0; 3]; config.points] } else { Vec::new() },
        };
    }
    let chosen = || order.iter().cycle().take(config.points);
    let rotation = frame_from_world.rotation.cast::<f32>();
    let normal = |&index: &usize| {
        let (camera, pixel) = points.source[index];
        let normal = cameras[camera as usize].normals.get(pixel as usize).copied();
        (rotation * nalgebra::Vector3::from(normal.unwrap_or_default())).into()
    };
    Cloud {
        points: chosen().map(|&index| points.colored(index, cameras, config.color)).collect(),
        normals: if config.normals { chosen().map(normal).collect() } else { Vec::new() },
    }
}

/// Indices of `wanted` points of an organised or unorganised list, by farthest-point sampling; fewer where
/// points coincide. Fastest where neighbours in the list are neighbours in space.
pub fn farthest_indices(points: &[[f32; 3]], wanted: usize) -> Vec<usize> {
    let axis = |i: usize| points.iter().map(|p| p[i]).collect::<Vec<_>>();
    let (x, y, z) = (axis(0), axis(1), axis(2));
    farthest::farthest_points(&[&x, &y, &z], wanted)
}

/// The pixels' points, axis by axis.
#[derive(Debug, Default)]
struct Points {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    /// Camera and pixel.
    source: Vec<(u32, u32)>,
}

impl Points {
    fn positions(&self) -> [&[f32]; 3] {
        [&self.x, &self.y, &self.z]
    }

    fn reserve(&mut self, count: usize) {
        self.x.reserve(count);
        self.y.reserve(count);
        self.z.reserve(count);
        self.source.reserve(count);
    }

    fn push(&mut self, [x, y, z]: [f32; 3], source: (u32, u32)) {
        self.x.push(x);
        self.y.push(y);
        self.z.push(z);
        self.source.push(source);
    }

    fn colored(&self, index: usize, cameras: &[CameraFrame], color: bool) -> CloudPoint {
        let [x, y, z] = [self.x[index], self.y[index], self.z[index]];
        let (camera, pixel) = self.source[index];
        match cameras[camera as usize].rgb.get(3 * pixel as usize..3 * pixel as usize + 3) {
            Some(rgb) if color => {
                [x, y, z, f32::from(rgb[0]), f32::from(rgb[1]), f32::from(rgb[2])]
            }
            _ => [x, y, z, 0.0, 0.0, 0.0],
        }
    }
}

/// Where points are kept.
struct Crop {
    low: [f32; 3],
    high: [f32; 3],
    center: [f32; 3],
    square_radius: f32,
}

impl Crop {
    fn new(config: &CloudConfig, handle: &Point3<f64>) -> Self {
        let region = config.region.map(|region| region.map(|v| v as f32));
        let corner = |first: usize, open: f32| {
            region.map_or([open; 3], |r| [r[first], r[first + 1], r[first + 2]])
        };
        Self {
            low: corner(0, f32::NEG_INFINITY),
            high: corner(3, f32::INFINITY),
            center: std::array::from_fn(|i| handle[i] as f32),
            square_radius: config.radius_m.map_or(f32::INFINITY, |r| (r * r) as f32),
        }
    }

    #[inline(always)]
    fn keeps(&self, p: [f32; 3]) -> bool {
        let square: f32 = (0..3).map(|i| (p[i] - self.center[i]) * (p[i] - self.center[i])).sum();
        (0..3).all(|i| self.low[i] <= p[i] && p[i] <= self.high[i]) && square <= self.square_radius
    }
}

/// Edges of the pixel tiles in which points are listed, so that neighbours in the list are neighbours in space.
const TILE: [u32; 2] = [8, 4];

/// Columns and rows of a tile's pixels, along a Z-order curve too: what a few invalid pixels leave of a tile stays small.
const WITHIN_TILE: [(u32, u32); (TILE[0] * TILE[1]) as usize] = {
    let mut places = [(0, 0); (TILE[0] * TILE[1]) as usize];
    let mut code = 0;
    while code < places.len() as u32 {
        places[code as usize] = (every_second_bit(code), every_second_bit(code >> 1));
        code += 1;
    }
    places
};

/// Lists a camera's points tile by tile, tiles along a Z-order curve.
fn gather(
    camera: &CameraFrame,
    index: u32,
    frame_from_world: &Pose,
    crop: &Crop,
    points: &mut Points,
) {
    let i = camera.intrinsics;
    points.reserve(i.pixels());
    let rays = Rays::new(camera, frame_from_world);
    let tiles = [i.width.div_ceil(TILE[0]), i.height.div_ceil(TILE[1])];
    let edge = tiles[0].max(tiles[1]).next_power_of_two();
    for code in 0..edge * edge {
        let (x, y) = (every_second_bit(code), every_second_bit(code >> 1));
        if x >= tiles[0] || y >= tiles[1] {
            continue;
        }
        for (du, dv) in WITHIN_TILE {
            let (u, v) = (x * TILE[0] + du, y * TILE[1] + dv);
            if u >= i.width || v >= i.height {
                continue;
            }
            let pixel = v * i.width + u;
            let depth_m = camera.depth_m[pixel as usize];
            if depth_m <= 0.0 {
                continue;
            }
            if let Some(position) = rays.point(camera, u, v, depth_m)
                && crop.keeps(position)
            {
                points.push(position, (index, pixel));
            }
        }
    }
}

/// The even bits of a number, moved together.
const fn every_second_bit(code: u32) -> u32 {
    let mut bits = code & 0x5555_5555;
    bits = (bits | (bits >> 1)) & 0x3333_3333;
    bits = (bits | (bits >> 2)) & 0x0f0f_0f0f;
    bits = (bits | (bits >> 4)) & 0x00ff_00ff;
    (bits | (bits >> 8)) & 0x0000_ffff
}

/// From pixels and depths to points of the cloud's frame.
struct Rays {
    /// Point of column `u` and row `v` at depth `d`: `origin + d * (forward + right[u] + down[v])`.
    origin: [f32; 3],
    right: Vec<[f32; 3]>,
    /// The forward direction is part of it.
    down: Vec<[f32; 3]>,
    frame_from_camera: Matrix4<f64>,
    frame_from_world: nalgebra::Isometry3<f32>,
}

impl Rays {
    fn new(camera: &CameraFrame, frame_from_world: &Pose) -> Self {
        let i = &camera.intrinsics;
        let matrix = (frame_from_world * camera.world_from_camera).to_homogeneous();
        let column = |axis: usize, scale: f64| {
            std::array::from_fn::<f64, 3, _>(|row| matrix[(row, axis)] * scale)
        };
        let forward = column(2, 1.0);
        let right = |u: u32| column(0, (f64::from(u) + 0.5 - i.cx) / i.fx).map(|c| c as f32);
        let down = |v: u32| {
            let down = column(1, (f64::from(v) + 0.5 - i.cy) / i.fy);
            std::array::from_fn(|axis| (down[axis] + forward[axis]) as f32)
        };
        Self {
            origin: column(3, 1.0).map(|c| c as f32),
            right: (0..i.width).map(right).collect(),
            down: (0..i.height).map(down).collect(),
            frame_from_camera: matrix,
            frame_from_world: frame_from_world.cast(),
        }
    }

    #[inline(always)]
    fn point(&self, camera: &CameraFrame, u: u32, v: u32, depth_m: f32) -> Option<[f32; 3]> {
        if !camera.distortion.is_pinhole() {
            let pixel = v as usize * camera.intrinsics.width as usize + u as usize;
            return match camera.xyz.get(pixel) {
                Some(world) => Some((self.frame_from_world * Point3::from(*world)).into()),
                None => self.distorted_point(camera, u, v, depth_m),
            };
        }
        let (right, down) = (&self.right[u as usize], &self.down[v as usize]);
        Some(std::array::from_fn(|axis| self.origin[axis] + depth_m * (right[axis] + down[axis])))
    }

    #[cold]
    fn distorted_point(
        &self,
        camera: &CameraFrame,
        u: u32,
        v: u32,
        depth_m: f32,
    ) -> Option<[f32; 3]> {
        let [x, y] = camera.model().ray([f64::from(u) + 0.5, f64::from(v) + 0.5])?;
        let depth_m = f64::from(depth_m);
        let point = Point3::new(x * depth_m, y * depth_m, depth_m);
        let point = self.frame_from_camera.transform_point(&point);
        Some([point.x as f32, point.y as f32, point.z as f32])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn z_order_separates_the_bits() {
        let codes = (0..16u32).map(|code| (every_second_bit(code), every_second_bit(code >> 1)));
        let first: Vec<_> = codes.take(6).collect();
        assert_eq!(first, [(0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (3, 0)]);
        assert_eq!(every_second_bit(0x5555_5555), 0xffff);
    }

    #[test]
    fn configurations_are_checked() {
        let with = |change: fn(&mut CloudConfig)| {
            let mut config = CloudConfig::default();
            change(&mut config);
            config.check()
        };
        assert!(with(|_| ()).is_ok());
        assert!(with(|c| c.points = usize::MAX).unwrap_err().contains("points"));
        assert!(with(|c| c.voxel_m = 0.0).unwrap_err().contains("voxel_m"));
        assert!(with(|c| c.radius_m = Some(-1.0)).unwrap_err().contains("radius_m"));
        assert!(with(|c| c.region = Some([1.0; 6])).unwrap_err().contains("region"));
    }
}
