//! What is known of an episode before its first frame, and how it is to be stored.

use akrobat_cameras::{Modality, Rig, SegmentLabel};
use akrobat_model::Pose;
use akrobat_model::robot::BaseKind;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Everything about an episode that is not in its observations.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeInfo {
    /// Identity of the trajectory: unique within a dataset.
    pub id: String,
    /// Whether the judge accepted the trajectory.
    pub success: bool,
    /// Seed of the trajectory.
    pub seed: u64,
    /// Position of the trajectory in its file.
    pub traj_index: u32,
    /// Number of frames that will follow.
    pub frames: u32,
    /// Frames per second; the last interval may be shorter.
    pub frame_rate_hz: f64,
    /// Number of the grasp within the task.
    pub grasp_id: u32,
    /// Object link that is held.
    pub grasp_link: String,
    /// Tool frame in that link.
    pub link_from_tool: Pose,
    /// Position of the active joint at the start, rad or m.
    pub start: f64,
    /// Position of the active joint to reach, rad or m.
    pub goal: f64,
    /// Scene name.
    pub scene_id: String,
    /// Object name.
    pub object_id: String,
    /// Robot name.
    pub robot_id: String,
    /// Kind of base the robot was planned with.
    pub base_kind: BaseKind,
    /// Names of the robot columns: base, arm, fingers.
    pub robot_joints: Vec<String>,
    /// How many of the last robot columns are fingers.
    pub finger_joints: usize,
    /// Names of the object columns.
    pub object_joints: Vec<String>,
    /// The object joint that is driven to the goal.
    pub active_joint: String,
    /// Pose of the robot's root link, below which the base joints move.
    pub world_from_robot_root: Pose,
    /// The cameras.
    pub rig: Rig,
    /// Images of every camera that are stored in HDF5 shards.
    pub modalities: Vec<Modality>,
    /// Points of every frame's cloud; 0 where there are none.
    pub cloud_points: usize,
    /// What is stored of each point.
    pub cloud: CloudLayout,
    /// What the segment ids stand for.
    pub labels: Vec<SegmentLabel>,
    /// The task file's text.
    pub task_toml: String,
    /// Whatever else tells how the episode came to be: content hashes, backends, lighting, sensors. No
    /// dates, hosts or timings, so that the same input gives the same bytes.
    pub provenance: serde_json::Value,
    /// Files that MCAP logs carry along: URDFs, for instance.
    pub attachments: Vec<Attachment>,
}

/// What is stored of the points of a cloud.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CloudLayout {
    /// Frame of positions and normals: `world`, `base` or `camera`, which is the rig's first.
    pub frame: String,
    /// How the points were chosen.
    pub sampling: String,
    /// Whether they have colours.
    pub color: bool,
    /// Whether they have normals.
    pub normals: bool,
}

impl Default for CloudLayout {
    fn default() -> Self {
        let (frame, sampling) = ("world".into(), "farthest".into());
        Self { frame, sampling, color: true, normals: false }
    }
}

/// A file carried in an MCAP log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attachment {
    /// File name.
    pub name: String,
    /// Media type, such as `application/xml`.
    pub media_type: String,
    /// Content.
    pub content: Vec<u8>,
}

impl EpisodeInfo {
    /// The rig as TOML.
    pub(crate) fn rig_toml(&self) -> String {
        toml::to_string(&self.rig).expect("a rig is plain data with text keys")
    }
}

/// How depth images are stored.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum DepthEncoding {
    /// Unsigned 16-bit millimetres, rounded; 0 where invalid, not finite or beyond 65.535 m.
    #[default]
    Millimetres,
    /// 32-bit float metres; 0 where invalid or not finite.
    Metres,
}

impl DepthEncoding {
    /// Value of the attribute `depth_unit`.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Millimetres => "mm",
            Self::Metres => "m",
        }
    }

    /// Metres per stored unit: the attribute `depth_scale`.
    pub fn scale(self) -> f64 {
        match self {
            Self::Millimetres => 0.001,
            Self::Metres => 1.0,
        }
    }
}

/// Depth in whole millimetres; 0 where it is invalid or does not fit.
pub(crate) fn millimetres(depth_m: f32) -> u16 {
    // The product is exact and so is the sum, so that this rounds halves up. Casts saturate.
    let rounded = (f64::from(depth_m) * 1000.0 + 0.5) as i32;
    if rounded > 0 && rounded <= i32::from(u16::MAX) { rounded as u16 } else { 0 }
}

/// Depth in metres; 0 where it is invalid.
pub(crate) fn metres(depth_m: f32) -> f32 {
    if depth_m.is_finite() && depth_m > 0.0 { depth_m } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_that_cannot_be_stored_is_invalid() {
        assert_eq!(millimetres(1.2344), 1234);
        assert_eq!(millimetres(65.535), 65535);
        for invalid in [0.0, -1.0, f32::NAN, f32::INFINITY, 65.536, 0.0004] {
            assert_eq!(millimetres(invalid), 0, "{invalid}");
        }
        assert_eq!(metres(f32::NAN), 0.0);
        assert_eq!(metres(70.5), 70.5);
    }
}
