//! What makes a frame unfit for a dataset.

use std::fmt;

use akrobat_cameras::{CameraFrame, Observation};
use nalgebra::Point3;

use crate::backend::PlacedCamera;
use crate::enclosure::Enclosures;
use crate::raycast::first_hit;
use crate::{FrameState, RenderScene};

/// Why a frame is refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Refusal {
    /// All pixels of an image are black.
    BlackFrame {
        /// The camera.
        camera: String,
    },
    /// No pixel gave a point to the cloud.
    EmptyCloud,
    /// A camera is inside a body.
    CameraInside {
        /// The camera.
        camera: String,
        /// The body.
        body: String,
    },
    /// The images do not show the state that the trajectory has at the frame's time.
    PoseDiffers {
        /// The camera.
        camera: String,
    },
}

impl Refusal {
    /// Short name, for counts.
    pub fn name(&self) -> &'static str {
        match self {
            Self::BlackFrame { .. } => "black_frame",
            Self::EmptyCloud => "empty_cloud",
            Self::CameraInside { .. } => "camera_inside",
            Self::PoseDiffers { .. } => "pose_differs",
        }
    }
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BlackFrame { camera } => write!(f, "black_frame: camera {camera} sees nothing"),
            Self::EmptyCloud => {
                write!(f, "empty_cloud: no camera measures any depth in the region")
            }
            Self::CameraInside { camera, body } => {
                write!(f, "camera_inside: camera {camera} is inside {body}")
            }
            Self::PoseDiffers { camera } => {
                write!(f, "pose_differs: camera {camera} does not show the trajectory's state")
            }
        }
    }
}

/// Levels up to this are black.
const BLACK: u8 = 3;

/// Rays across and down an image that are compared with the scene.
const PROBES: [u32; 2] = [4, 3];

/// Depths agree where they differ by no more than this, metres, and this share.
const DEPTH_TOLERANCE: (f64, f64) = (0.01, 0.01);

/// The first camera that is inside a body.
pub fn camera_inside(
    enclosures: &Enclosures<'_>,
    frame: &FrameState,
    cameras: &[PlacedCamera],
) -> Option<Refusal> {
    cameras.iter().find_map(|camera| {
        let eye = Point3::from(camera.world_from_camera.translation.vector);
        enclosures.body_around(frame, &eye).map(|body| Refusal::CameraInside {
            camera: camera.name.clone(),
            body: format!("{} {}", body.group.name(), body.name),
        })
    })
}

/// The first of the ideal images (pinholes) that does not show `frame`: at some pixels, rays through the scene as
/// the trajectory has it are compared with the depth image. Most must agree.
pub fn pose_differs(
    scene: &RenderScene,
    frame: &FrameState,
    images: &[CameraFrame],
    cameras: &[PlacedCamera],
) -> Option<Refusal> {
    let differs = |(image, camera): &(&CameraFrame, &PlacedCamera)| {
        let (agreeing, probes) = agreement(scene, frame, image, camera);
        2 * agreeing < probes
    };
    let (image, _) = images.iter().zip(cameras).find(differs)?;
    Some(Refusal::PoseDiffers { camera: image.name.clone() })
}

fn agreement(
    scene: &RenderScene,
    frame: &FrameState,
    image: &CameraFrame,
    camera: &PlacedCamera,
) -> (usize, usize) {
    let i = camera.intrinsics;
    let eye = Point3::from(camera.world_from_camera.translation.vector);
    let (mut agreeing, mut probes) = (0, 0);
    for row in 0..PROBES[1] {
        for column in 0..PROBES[0] {
            let u = (2 * column + 1) * i.width / (2 * PROBES[0]);
            let v = (2 * row + 1) * i.height / (2 * PROBES[1]);
            let ray = Point3::from(i.unproject(u, v, 1.0));
            let along = |depth: f64| camera.world_from_camera * (ray * depth);
            // From the near plane on, as the renderer does.
            let start = along(camera.near_m);
            let hit = first_hit(scene, &frame.world_from_body, &start, &along(camera.far_m));
            let expected =
                hit.map_or(0.0, |distance| ((start - eye).norm() + distance) / ray.coords.norm());
            let found = f64::from(image.depth_m[(v * i.width + u) as usize]);
            let tolerance = DEPTH_TOLERANCE.0 + DEPTH_TOLERANCE.1 * expected;
            probes += 1;
            agreeing += usize::from((found - expected).abs() <= tolerance);
        }
    }
    (agreeing, probes)
}

/// What is wrong with a finished frame itself.
pub fn unusable(observation: &Observation) -> Option<Refusal> {
    let black = |c: &&CameraFrame| !c.rgb.is_empty() && c.rgb.iter().all(|&level| level <= BLACK);
    if let Some(camera) = observation.cameras.iter().find(black) {
        return Some(Refusal::BlackFrame { camera: camera.name.clone() });
    }
    let is_empty = |point: &[f32; 6]| point[..3] == [0.0; 3];
    let empty = !observation.cloud.is_empty() && observation.cloud.iter().all(is_empty);
    empty.then_some(Refusal::EmptyCloud)
}
