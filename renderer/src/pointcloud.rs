//! One cloud of a fixed number of points from all cameras.
//!
//! Every valid pixel of the unquantised depth images becomes a point in the world frame; what lies outside the crop is
//! dropped; farthest-point sampling, or voxels, pick the points from the rest.

use akrobat_cameras::{CameraFrame, CloudPoint};
use akrobat_model::Pose;
use akrobat_simd::{Kernel, Lanes, Simd, run};
use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod farthest;
mod leaf;
mod tiles;
mod voxel;

use leaf::Leaf;
use tiles::{Crop, Tiles};

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
    let sample = Sample { cameras, frame_from_world: &frame_from_world, crop: &crop, config };
    let chosen = run(Simd::detect(), sample);
    if chosen.is_empty() {
        return Cloud {
            points: vec![[0.0; 6]; config.points],
            normals: if config.normals { vec![[0.0; 3]; config.points] } else { Vec::new() },
        };
    }
    let chosen = || chosen.iter().cycle().take(config.points);
    let rotation = frame_from_world.rotation.cast::<f32>();
    let normal = |pixel: &PixelPoint| {
        let normal = cameras[pixel.camera].normals.get(pixel.pixel).copied();
        (rotation * nalgebra::Vector3::from(normal.unwrap_or_default())).into()
    };
    Cloud {
        points: chosen().map(|pixel| pixel.colored(cameras, config.color)).collect(),
        normals: if config.normals { chosen().map(normal).collect() } else { Vec::new() },
    }
}

/// Makes points of the pixels and chooses from them.
struct Sample<'a> {
    cameras: &'a [CameraFrame],
    frame_from_world: &'a Pose,
    crop: &'a Crop,
    config: &'a CloudConfig,
}

impl Kernel for Sample<'_> {
    type Output = Vec<PixelPoint>;

    #[inline(always)]
    fn run<L: Lanes>(self) -> Vec<PixelPoint> {
        let mut tiles = Tiles::new::<L>(self.cameras, self.frame_from_world, self.crop);
        let chosen = match self.config.sampling {
            CloudSampling::Farthest => {
                farthest::farthest_points::<L>(&mut tiles.leaves, self.config.points)
            }
            CloudSampling::Voxel => {
                voxel::sample(&tiles.leaves, self.config.voxel_m as f32, self.config.points)
            }
        };
        chosen.into_iter().map(|place| tiles.pixel_point(self.cameras, place)).collect()
    }
}

/// Indices of `wanted` points of an organised or unorganised list, by farthest-point sampling; fewer where
/// points coincide or are not finite. Fastest where neighbours in the list are neighbours in space.
pub fn farthest_indices(points: &[[f32; 3]], wanted: usize) -> Vec<usize> {
    struct Farthest(Vec<Leaf>, usize);

    impl Kernel for Farthest {
        type Output = Vec<usize>;

        #[inline(always)]
        fn run<L: Lanes>(mut self) -> Vec<usize> {
            farthest::farthest_points::<L>(&mut self.0, self.1)
        }
    }
    let finite = |point: &[f32; 3]| point.iter().all(|v| v.is_finite());
    let kept: Vec<usize> = (0..points.len()).filter(|&i| finite(&points[i])).collect();
    let list: Vec<_> = kept.iter().map(|&i| points[i]).collect();
    let chosen = run(Simd::detect(), Farthest(Leaf::of_list(&list), wanted));
    chosen.into_iter().map(|place| kept[place]).collect()
}

/// A pixel's point in the cloud's frame.
struct PixelPoint {
    camera: usize,
    pixel: usize,
    position: [f32; 3],
}

impl PixelPoint {
    fn colored(&self, cameras: &[CameraFrame], color: bool) -> CloudPoint {
        let [x, y, z] = self.position;
        match cameras[self.camera].rgb.get(3 * self.pixel..3 * self.pixel + 3) {
            Some(rgb) if color => {
                [x, y, z, f32::from(rgb[0]), f32::from(rgb[1]), f32::from(rgb[2])]
            }
            _ => [x, y, z, 0.0, 0.0, 0.0],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
