//! What cameras yield for one frame.

use akrobat_model::Phase;
use akrobat_model::Pose;

use crate::Intrinsics;

/// One camera's images at one frame.
#[derive(Debug, Clone)]
pub struct CameraFrame {
    /// Camera name, from the rig.
    pub name: String,
    /// Intrinsics.
    pub intrinsics: Intrinsics,
    /// Pose of the camera (x right, y down, z forward).
    pub world_from_camera: Pose,
    /// sRGB colours `[height, width, 3]`.
    pub rgb: Vec<u8>,
    /// z-depth in metres `[height, width]`; 0 where nothing is seen between near and far.
    pub depth_m: Vec<f32>,
    /// Segment ids `[height, width]`; 0 is background. See [`SegmentLabel`].
    pub segmentation: Vec<u16>,
}

/// What a segment id stands for: one robot link, object link or scene body.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct SegmentLabel {
    /// Id in the segmentation images, from 1.
    pub id: u16,
    /// `robot`, `object` or `scene`.
    pub group: String,
    /// Link's or body's name.
    pub name: String,
    /// Semantic class.
    pub class: String,
}

/// A point of a fused cloud: world-frame position in metres and sRGB colour in 0..255, as f32
/// `[x y z r g b]`.
pub type CloudPoint = [f32; 6];

/// Everything seen at one frame.
#[derive(Debug, Clone)]
pub struct Observation {
    /// Frame number within the episode, from 0.
    pub frame: u32,
    /// Time on the trajectory's dense path, seconds.
    pub time_s: f64,
    /// Phase of the trajectory.
    pub phase: Phase,
    /// Images, in the rig's order.
    pub cameras: Vec<CameraFrame>,
    /// Fused cloud; always the configured number of points, or empty where none is asked for.
    pub cloud: Vec<CloudPoint>,
    /// Robot joint positions in the trajectory's columns (rad, m).
    pub robot: Vec<f64>,
    /// Positions of all object joints (rad, m).
    pub object: Vec<f64>,
    /// Pose of the tool frame.
    pub world_from_tool: Pose,
    /// Pose of the robot's base link: the child of the yaw joint, or the root of a fixed-base robot.
    pub world_from_base: Pose,
    /// Pose of the object's root.
    pub world_from_object: Pose,
}
