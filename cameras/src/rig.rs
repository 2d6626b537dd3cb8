//! Rigs: which cameras there are and where they are mounted.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A set of cameras (TOML).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rig {
    /// Name for reports and manifests.
    pub name: String,
    /// The cameras, in the order of the outputs.
    pub cameras: Vec<CameraSpec>,
}

/// One camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CameraSpec {
    /// Name in the outputs (`ego_topdown`, `ego_wrist`, `fixed`, …): letters, digits and `_`.
    pub name: String,
    /// Image width, pixels.
    #[serde(default = "default_width")]
    pub width: u32,
    /// Image height, pixels.
    #[serde(default = "default_height")]
    pub height: u32,
    /// Focal length over a 20.955 mm horizontal aperture, millimetres.
    pub focal_mm: f64,
    /// Nearest depth seen, metres.
    #[serde(default = "default_near")]
    pub near_m: f64,
    /// Farthest depth seen, metres.
    #[serde(default = "default_far")]
    pub far_m: f64,
    /// Where the camera is.
    pub mount: CameraMount,
}

fn default_width() -> u32 {
    320
}
fn default_height() -> u32 {
    240
}
fn default_near() -> f64 {
    0.01
}
fn default_far() -> f64 {
    20.0
}

/// Where a camera is mounted. Poses are of the OpenCV camera frame (x right, y down, z forward).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "snake_case", tag = "on")]
pub enum CameraMount {
    /// Rigidly on a robot link.
    Link {
        /// Link name; `tool`, `base` and `mount` stand for the tool frame, the base link and the link
        /// that carries the first arm joint.
        link: String,
        /// Camera pose in that frame, `[x y z qw qx qy qz]`.
        link_from_camera: [f64; 7],
    },
    /// At rest in the world.
    World {
        /// Camera pose, `[x y z qw qx qy qz]`.
        world_from_camera: [f64; 7],
    },
    /// At rest in the world, looking at the object's handle at the first frame, from a direction given
    /// in a frame at the handle whose x axis points horizontally out of the object towards the robot.
    LookAtHandle {
        /// Camera position relative to the handle, metres.
        offset: [f64; 3],
    },
}
