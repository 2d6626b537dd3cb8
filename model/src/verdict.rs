//! What the judge says about one trajectory.

use serde::{Deserialize, Serialize};

/// Why a trajectory was refused. The first reason found, in this order of precedence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rejection {
    /// A value is NaN or infinite, an array has the wrong length, or times do not increase.
    Malformed,
    /// The grasped handle and the tool moved apart: translation above tolerance.
    AnchorTranslation,
    /// The grasped handle and the tool moved apart: rotation above tolerance.
    AnchorRotation,
    /// The fingers are open while they hold, or closed while they leave the object or go to it again.
    Grip,
    /// The object does not start closed or does not reach its goal, or moves while it is not held.
    ObjectMotion,
    /// A planar object is lifted or tilted by the hand that moves it.
    LeftPlane,
    /// A rigid or planar object is put down, or stands at the start, where nothing carries it.
    Unsupported,
    /// A joint position limit is exceeded.
    PositionLimit,
    /// A joint velocity limit is exceeded.
    VelocityLimit,
    /// A joint acceleration limit is exceeded.
    AccelerationLimit,
    /// The base turns too far between start and goal.
    BaseYaw,
    /// A collision sphere of the robot touches the scene, the object or another link.
    SphereCollision,
    /// The robot's mesh enters the scene, the object or itself.
    MeshPenetration,
    /// The moving object enters the scene.
    ObjectCollision,
}

impl Rejection {
    /// All reasons, in order of precedence.
    pub const ALL: [Self; 14] = [
        Self::Malformed,
        Self::AnchorTranslation,
        Self::AnchorRotation,
        Self::Grip,
        Self::ObjectMotion,
        Self::LeftPlane,
        Self::Unsupported,
        Self::PositionLimit,
        Self::VelocityLimit,
        Self::AccelerationLimit,
        Self::BaseYaw,
        Self::SphereCollision,
        Self::MeshPenetration,
        Self::ObjectCollision,
    ];

    /// The name used in files and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Malformed => "malformed",
            Self::AnchorTranslation => "anchor_translation",
            Self::AnchorRotation => "anchor_rotation",
            Self::Grip => "grip",
            Self::ObjectMotion => "object_motion",
            Self::LeftPlane => "left_plane",
            Self::Unsupported => "unsupported",
            Self::PositionLimit => "position_limit",
            Self::VelocityLimit => "velocity_limit",
            Self::AccelerationLimit => "acceleration_limit",
            Self::BaseYaw => "base_yaw",
            Self::SphereCollision => "sphere_collision",
            Self::MeshPenetration => "mesh_penetration",
            Self::ObjectCollision => "object_collision",
        }
    }
}

/// The judge's findings on one trajectory: the worst value of every check over all samples.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// `None` where the trajectory is accepted.
    pub rejection: Option<Rejection>,
    /// One sentence: which sample, which joint or link pair, how much.
    pub detail: String,
    /// Largest distance between the tool and its place on the handle while held, metres.
    pub anchor_translation_m: f64,
    /// Largest angle between them, radians.
    pub anchor_rotation_rad: f64,
    /// Largest joint speed as a fraction of its limit.
    pub velocity_fraction: f64,
    /// Largest joint acceleration as a fraction of its limit.
    pub acceleration_fraction: f64,
    /// Base yaw excursion during the manipulation, radians.
    pub base_yaw_rad: f64,
    /// Deepest mesh penetration outside the listed finger-handle pairs, metres.
    pub penetration_m: f64,
    /// Number of configurations checked.
    pub samples: u32,
}

impl Verdict {
    /// True where nothing was found wrong.
    pub fn accepted(&self) -> bool {
        self.rejection.is_none()
    }
}
