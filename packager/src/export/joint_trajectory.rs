//! ROS 2 `trajectory_msgs/msg/JointTrajectory`: `episode_<i>.yaml` for people and `ros2 topic pub`, and
//! `episode_<i>.mcap` for `ros2 bag play`.
//!
//! Real robots have one controller for each group of joints, so there is one trajectory for the base (its
//! virtual joints x, y, yaw in the world), one for the arm and one for the gripper, on the topics
//! `/base/joint_trajectory`, `/arm/joint_trajectory` and `/gripper/joint_trajectory`. The YAML file maps group
//! names to messages.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use akrobat_model::robot::BaseKind;
use akrobat_model::{TrajectorySet, trajectory::DensePath};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};

use super::sink::Sink;
use super::source::{Episode, FrameBatch};
use crate::error::{PackError, Result};
use crate::mcap_log::cdr::CdrWriter;
use crate::mcap_log::definitions;
use crate::shard::series::velocities;
use crate::whole_file::{self, PartialFile};

/// Interface name.
const INTERFACE: &str = "trajectory_msgs/msg/JointTrajectory";

/// Writes a folder of trajectories.
pub(super) struct JointTrajectorySink {
    folder: PathBuf,
}

impl JointTrajectorySink {
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_path_buf() }
    }
}

impl Sink for JointTrajectorySink {
    fn begin(&mut self, episode: &Episode) -> Result<()> {
        let joints = Joints {
            names: &episode.robot.joints,
            base: episode.base_joints,
            fingers: episode.finger_joints,
        };
        let stem = self.folder.join(format!("episode_{}", episode.index));
        let motion = [&episode.robot.position[..], &episode.robot.velocity];
        write_pair(&stem, &groups(&joints, &episode.time_s, motion))
    }

    fn frames(&mut self, _: &Episode, _: &FrameBatch) -> Result<()> {
        Ok(())
    }

    fn end(&mut self, _: &Episode) -> Result<()> {
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }
}

/// Writes the dense paths of a trajectory file into an empty folder: `trajectory_<i>.yaml` and `.mcap`.
/// `finger_joints` of the last robot columns are fingers.
///
/// # Errors
/// [`PackError::Io`].
pub fn write_set(folder: &Path, set: &TrajectorySet, finger_joints: usize) -> Result<()> {
    let names = &set.header.robot_joints;
    let base = if set.header.base_kind == BaseKind::Fixed { 0 } else { 3 };
    let joints = Joints { names, base, fingers: finger_joints };
    for (index, trajectory) in set.trajectories.iter().enumerate() {
        let DensePath { times_s, robot, .. } = &trajectory.dense;
        let velocity = velocities(times_s, robot.values(), names.len());
        let stem = folder.join(format!("trajectory_{index}"));
        write_pair(&stem, &groups(&joints, times_s, [robot.values(), &velocity]))?;
    }
    Ok(())
}

struct Joints<'a> {
    names: &'a [String],
    base: usize,
    fingers: usize,
}

/// One message.
struct Group {
    name: &'static str,
    joints: Vec<String>,
    points: Vec<Point>,
}

struct Point {
    positions: Vec<f64>,
    velocities: Vec<f64>,
    nanoseconds: u64,
}

/// The messages of base, arm and gripper, without those that have no joints.
fn groups(joints: &Joints<'_>, time_s: &[f64], [position, velocity]: [&[f32]; 2]) -> Vec<Group> {
    let columns = joints.names.len();
    let arm_end = columns - joints.fingers;
    let ranges =
        [("base", 0..joints.base), ("arm", joints.base..arm_end), ("gripper", arm_end..columns)];
    let groups = ranges.into_iter().filter(|(_, range)| !range.is_empty());
    groups
        .map(|(name, range)| {
            let part = |values: &[f32], t: usize| -> Vec<f64> {
                values[t * columns..][range.clone()].iter().map(|&v| f64::from(v)).collect()
            };
            let points = time_s.iter().enumerate().map(|(t, &time)| Point {
                positions: part(position, t),
                velocities: part(velocity, t),
                nanoseconds: (time * 1e9).round() as u64,
            });
            Group { name, joints: joints.names[range.clone()].to_vec(), points: points.collect() }
        })
        .collect()
}

fn write_pair(stem: &Path, groups: &[Group]) -> Result<()> {
    whole_file::write(&stem.with_extension("yaml"), yaml(groups).as_bytes())?;
    write_log(&stem.with_extension("mcap"), groups)
}

fn yaml(groups: &[Group]) -> String {
    let mut text = String::from(
        "# trajectory_msgs/msg/JointTrajectory by group of joints; rad, m, s; the base in the world.\n",
    );
    // Writing to a string cannot fail.
    for group in groups {
        let names: Vec<String> = group.joints.iter().map(|joint| format!("{joint:?}")).collect();
        let _ = write!(
            text,
            "{}:\n  header:\n    stamp: {{sec: 0, nanosec: 0}}\n    frame_id: world\n  joint_names: [{}]\n  points:\n",
            group.name,
            names.join(", ")
        );
        for point in &group.points {
            let list = |values: &[f64]| -> String {
                values.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(", ")
            };
            let (sec, nanosec) = split(point.nanoseconds);
            let _ = write!(
                text,
                "    - positions: [{}]\n      velocities: [{}]\n      accelerations: []\n      effort: []\n      time_from_start: {{sec: {sec}, nanosec: {nanosec}}}\n",
                list(&point.positions),
                list(&point.velocities),
            );
        }
    }
    text
}

fn split(nanoseconds: u64) -> (i32, u32) {
    let seconds = i32::try_from(nanoseconds / 1_000_000_000).unwrap_or(i32::MAX);
    (seconds, (nanoseconds % 1_000_000_000) as u32)
}

fn write_log(path: &Path, groups: &[Group]) -> Result<()> {
    let partial = PartialFile::create(path)?;
    let file = File::create(partial.path()).map_err(|e| PackError::create(path, e))?;
    let error = |e: McapError| match e {
        McapError::Io(source) => PackError::io(path, source),
        other => PackError::Library {
            path: path.to_path_buf(),
            item: "MCAP records".into(),
            message: other.to_string(),
        },
    };
    let options = WriteOptions::new().profile("ros2").library("akrobat").compression_threads(0);
    let mut writer: Writer<BufWriter<File>> =
        options.create(BufWriter::new(file)).map_err(error)?;
    let definition = definitions::ros2msg(INTERFACE);
    let schema = writer.add_schema(INTERFACE, "ros2msg", definition.as_bytes()).map_err(error)?;
    for group in groups {
        let topic = format!("/{}/joint_trajectory", group.name);
        let channel_id =
            writer.add_channel(schema, &topic, "cdr", &BTreeMap::new()).map_err(error)?;
        let header = MessageHeader { channel_id, sequence: 0, log_time: 0, publish_time: 0 };
        writer.write_to_known_channel(&header, &message(group)).map_err(error)?;
    }
    writer.finish().map_err(error)?;
    let buffered = writer.into_inner();
    buffered.into_inner().map_err(|e| PackError::io(path, e.into_error()))?;
    partial.commit()
}

fn message(group: &Group) -> Vec<u8> {
    let mut cdr = CdrWriter::new();
    cdr.u32(0);
    cdr.u32(0);
    cdr.string("world");
    cdr.length(group.joints.len());
    group.joints.iter().for_each(|joint| cdr.string(joint));
    cdr.length(group.points.len());
    for point in &group.points {
        cdr.f64_sequence(point.positions.iter().copied());
        cdr.f64_sequence(point.velocities.iter().copied());
        cdr.length(0);
        cdr.length(0);
        let (seconds, nanoseconds) = split(point.nanoseconds);
        cdr.i32(seconds);
        cdr.u32(nanoseconds);
    }
    cdr.finish()
}
