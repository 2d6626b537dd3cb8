//! Exports: datasets in the layouts that trainers and tools read.
//!
//! An export reads a dataset once for its statistics ([`ExportHeader::scan`]) and once for its content,
//! episode by episode and a few frames at a time, and hands both to the [`Sink`] of a format. The sinks
//! of the HDF5 and MCAP formats are here; those that need a Python library are the host's.

mod act;
mod automoma;
mod card;
mod columns;
mod config;
mod joint_trajectory;
mod licence;
mod maniskill;
mod mcap;
mod robomimic;
mod sink;
mod source;
mod stack;

use std::path::Path;

pub use card::write_card;
pub use columns::{ColumnStatistics, Motion, Table};
pub use config::{
    ActionKind, BaseActions, EefFrame, ExportConfig, ExportFormat, GripperColumns, McapProfile,
    Needs, QuatOrder, StateKind,
};
pub use joint_trajectory::write_set as write_joint_trajectories;
pub use licence::non_commercial;
pub use sink::{ExportHeader, Sink};
pub use source::{
    Articulation, CameraBatch, CameraSeries, Depth, Episode, EpisodeAttributes, FrameBatch,
    FrameReader, Source,
};

use crate::error::Result;
use crate::h5::GroupWriter;

/// The writer of a format into an empty folder; `None` where a Python library has to write it.
///
/// # Errors
/// [`crate::PackError`] where files cannot be created.
pub fn native_sink(
    format: ExportFormat,
    folder: &Path,
    header: &ExportHeader,
) -> Result<Option<Box<dyn Sink>>> {
    Ok(Some(match format {
        ExportFormat::Act => Box::new(act::ActSink::new(folder, header)),
        ExportFormat::Robomimic => Box::new(robomimic::RobomimicSink::create(folder, header)?),
        ExportFormat::Maniskill => Box::new(maniskill::ManiskillSink::create(folder, header)?),
        ExportFormat::Automoma => Box::new(automoma::AutomomaSink::create(folder, header)?),
        ExportFormat::Mcap if header.config.profile == McapProfile::Ros2 => {
            Box::new(mcap::McapSink::new(folder, header))
        }
        ExportFormat::JointTrajectory => {
            Box::new(joint_trajectory::JointTrajectorySink::new(folder))
        }
        ExportFormat::Lerobot
        | ExportFormat::Dp3
        | ExportFormat::DiffusionPolicy
        | ExportFormat::Mcap => return Ok(None),
    }))
}

/// Writes the conventions of an export as text attributes.
fn write_conventions(group: &GroupWriter, header: &ExportHeader) -> Result<()> {
    for (topic, words) in &header.conventions {
        group.attr_str(topic, words)?;
    }
    group.attr_strings("action_names", &header.action_names)?;
    group.attr_strings("state_names", &header.state_names)?;
    group.attr("frame_rate_hz", header.frame_rate_hz)?;
    group.attr_str("written_by", "akrobat export")
}

/// Writes what is known of an episode as attributes.
fn write_attributes(group: &GroupWriter, episode: &Episode) -> Result<()> {
    let known = &episode.attributes;
    // Signed: robomimic subtracts from it.
    group.attr("num_samples", episode.frames() as i64)?;
    group.attr("success", known.success)?;
    group.attr("seed", known.seed)?;
    group.attr("traj_index", known.traj_index)?;
    group.attr("grasp_id", known.grasp_id)?;
    group.attr_str("grasp_link", &known.grasp_link)?;
    group.attr_list("grasp_pose", &known.grasp_pose)?;
    group.attr("start_angle", known.start)?;
    group.attr("goal_angle", known.goal)?;
    group.attr_str("active_joint", &known.active_joint)?;
    group.attr_str("episode_id", &known.id)?;
    group.attr_str("scene_id", &known.scene_id)?;
    group.attr_str("object_id", &known.object_id)?;
    group.attr_str("robot_id", &known.robot_id)?;
    group.attr_str("base_kind", &known.base_kind)?;
    group.attr_str("instruction", &known.instruction)?;
    group.attr_strings("robot_joints", &episode.robot.joints)?;
    group.attr_strings("object_joints", &episode.object.joints)
}

/// K and pose of every camera at every frame: `<camera>_intrinsics`, `<camera>_world_from_camera`.
fn write_camera_series(group: &GroupWriter, episode: &Episode) -> Result<()> {
    let frames = episode.frames();
    for camera in &episode.cameras {
        let name = |kind: &str| format!("{}_{kind}", camera.name);
        group.array(&name("intrinsics"), &[frames, 3, 3], &camera.intrinsics)?;
        group.array(&name("world_from_camera"), &[frames, 4, 4], &camera.world_from_camera)?;
    }
    Ok(())
}
