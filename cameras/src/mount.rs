//! Where cameras are mounted.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::PoseValues;

/// Where a camera is mounted. Poses are of the OpenCV camera frame (x right, y down, z forward).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, rename_all = "snake_case", tag = "on")]
pub enum CameraMount {
    /// Rigidly on a robot link.
    Link {
        /// Link name; `tool`, `base` and `mount` stand for the tool frame, the base link and the link
        /// that carries the first arm joint.
        link: String,
        /// Camera pose in that frame: `[x y z qw qx qy qz]` or a 4 x 4 matrix.
        link_from_camera: PoseValues,
    },
    /// On a robot link, turned at every frame so that it looks at the tool, its image upright: a camera
    /// on a pan-tilt head.
    LookAtTool {
        /// Link name or alias, as for a rigid mount.
        link: String,
        /// Camera position in that link's frame, metres.
        position: [f64; 3],
    },
    /// At rest in the world.
    World {
        /// Camera pose: `[x y z qw qx qy qz]` or a 4 x 4 matrix.
        world_from_camera: PoseValues,
    },
    /// At rest in the world, looking at a point, its image upright.
    LookAt {
        /// What `position` and `target` are relative to.
        #[serde(default)]
        relative_to: Reference,
        /// Camera position, metres.
        position: [f64; 3],
        /// The point in the middle of the image (without a shifted principal point), metres.
        target: [f64; 3],
    },
    /// At rest in the world, looking at the middle of the way that the object's handle takes. The position is
    /// given in a frame there whose z axis points up and whose x axis points horizontally out of the object,
    /// against the direction in which the handle is approached. Where the line of sight is blocked or the
    /// place is inside something, the nearest of several places around it serves (to the other side,
    /// nearer, higher).
    LookAtHandle {
        /// Camera position relative to the middle of the handle's way, metres.
        offset: [f64; 3],
    },
}

/// A frame at rest, with z up, that positions can be given in.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Reference {
    /// The world.
    #[default]
    World,
    /// The object's root.
    Object,
    /// The middle of the handle's way; x points horizontally out of the object.
    Handle,
}

/// Names that a link mount may use besides the robot's own links.
pub const LINK_ALIASES: [&str; 3] = ["tool", "base", "mount"];

impl CameraMount {
    /// The link that carries the camera, if a robot link does.
    pub fn link(&self) -> Option<&str> {
        match self {
            Self::Link { link, .. } | Self::LookAtTool { link, .. } => Some(link),
            Self::World { .. } | Self::LookAt { .. } | Self::LookAtHandle { .. } => None,
        }
    }

    /// In a few words, for people.
    pub fn describe(&self) -> String {
        match self {
            Self::Link { link, .. } => format!("on link {link}"),
            Self::LookAtTool { link, .. } => format!("on link {link}, looking at the tool"),
            Self::World { .. } => "in the world".into(),
            Self::LookAt { relative_to, .. } => {
                let frame = match relative_to {
                    Reference::World => "world",
                    Reference::Object => "object",
                    Reference::Handle => "handle",
                };
                format!("at rest in the {frame}'s frame")
            }
            Self::LookAtHandle { .. } => "at rest, looking at the handle".into(),
        }
    }

    pub(crate) fn check(&self) -> Result<(), String> {
        match self {
            Self::Link { link_from_camera: pose, .. } | Self::World { world_from_camera: pose } => {
                pose.to_pose().map(drop)
            }
            Self::LookAtTool { position, .. } => finite("position", position),
            Self::LookAt { position, target, .. } => {
                finite("position", position)?;
                finite("target", target)?;
                let way: [f64; 3] = std::array::from_fn(|i| target[i] - position[i]);
                long_enough("from position to target", &way)
            }
            Self::LookAtHandle { offset } => long_enough("offset", offset),
        }
    }
}

fn finite(what: &str, values: &[f64; 3]) -> Result<(), String> {
    if values.iter().all(|v| v.is_finite()) {
        return Ok(());
    }
    Err(format!("{what} must be three finite numbers, got {values:?}"))
}

fn long_enough(what: &str, way: &[f64; 3]) -> Result<(), String> {
    let distance = way.iter().map(|v| v * v).sum::<f64>().sqrt();
    if distance.is_finite() && distance >= 0.05 {
        return Ok(());
    }
    Err(format!("{what} must be at least 0.05 m long, got {way:?}"))
}
