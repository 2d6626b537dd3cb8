//! AutoMoMa: `recording.hdf5` in the layout of the authors' recorder.
//!
//! `data/demo_<i>/{actions, processed_actions}`, `obs/{actions, joint_pos, joint_vel, gripper_pos, eef_pos,
//! eef_quat}`, `camera_obs/<camera>_{rgb u8, depth f32 metres}`, `states/articulation/{robot, <object>}/
//! {joint_position, joint_velocity, root_pose, root_velocity}` and their first rows under `initial_state`.
//! The robot is named `robot` there. With `--base relative`, the first three action columns are changes of
//! the base's pose along the world's axes, as `--mobile_base_relative` of their recorder makes them.
//! Beyond the authors': `<camera>_{intrinsics, world_from_camera}` and `point_cloud`.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::sink::{ExportHeader, Sink};
use super::source::{Articulation, Episode, FrameBatch};
use super::stack::{self, FrameStack};
use super::{write_attributes, write_camera_series, write_conventions};
use crate::error::Result;
use crate::h5::{GroupWriter, H5Writer};

/// File name in the output folder.
const FILE: &str = "recording.hdf5";

/// Writes one recording.
pub(super) struct AutomomaSink {
    file: Option<H5Writer>,
    path: PathBuf,
    data: Option<GroupWriter>,
    frames: u64,
    stacks: Vec<[FrameStack; 2]>,
    cloud: Option<FrameStack>,
}

impl AutomomaSink {
    pub fn create(folder: &Path, header: &ExportHeader) -> Result<Self> {
        let path = folder.join(FILE);
        let file = H5Writer::create(&path)?;
        let data = file.root().group("data")?;
        write_conventions(&data, header)?;
        let environment = json!({ "env_name": header.name, "type": 2, "env_kwargs": {} });
        data.attr_str("env_args", &environment.to_string())?;
        let (file, data) = (Some(file), Some(data));
        Ok(Self { file, path, data, frames: 0, stacks: Vec::new(), cloud: None })
    }
}

impl Sink for AutomomaSink {
    fn begin(&mut self, episode: &Episode) -> Result<()> {
        let data = self.data.as_ref().expect("episodes come before the end");
        let group = data.group(&format!("demo_{}", episode.index))?;
        write_attributes(&group, episode)?;
        let frames = episode.frames();
        let action = (&[frames, episode.action.columns()], &episode.action.values);
        group.array("actions", action.0, action.1)?;
        group.array("processed_actions", action.0, action.1)?;
        let obs = group.group("obs")?;
        obs.array("actions", action.0, action.1)?;
        let columns = episode.robot.joints.len();
        obs.array("joint_pos", &[frames, columns], &episode.robot.position)?;
        obs.array("joint_vel", &[frames, columns], &episode.robot.velocity)?;
        let fingers = episode.fingers(&episode.robot.position);
        obs.array("gripper_pos", &[frames, episode.finger_joints], &fingers)?;
        let part = |from: usize, to: usize| -> Vec<f32> {
            episode.eef.chunks(7).flat_map(|row| &row[from..to]).copied().collect()
        };
        obs.array("eef_pos", &[frames, 3], &part(0, 3))?;
        let rotation = obs.array("eef_quat", &[frames, 4], &part(3, 7))?;
        obs.dataset_attr_str(&rotation, "quat_order", "wxyz")?;
        for (name, rows) in [("states", frames), ("initial_state", 1)] {
            let states = group.group(name)?.group("articulation")?;
            write_articulation(&states.group("robot")?, &episode.robot, rows)?;
            write_articulation(&states.group(&episode.object.name)?, &episode.object, rows)?;
        }
        let cameras = group.group("camera_obs")?;
        write_camera_series(&cameras, episode)?;
        self.stacks = episode
            .cameras
            .iter()
            .map(|camera| {
                let shape = |channels| [frames, camera.height, camera.width, channels];
                let name = |kind: &str| format!("{}_{kind}", camera.name);
                let depth = FrameStack::create::<f32>(&cameras, &name("depth"), &shape(1))?;
                cameras.dataset_attr_str(depth.dataset(), "depth_unit", "m")?;
                Ok([FrameStack::create::<u8>(&cameras, &name("rgb"), &shape(3))?, depth])
            })
            .collect::<Result<_>>()?;
        self.cloud = match episode.cloud_points {
            0 => None,
            points => Some(FrameStack::create::<f32>(&group, "point_cloud", &[frames, points, 6])?),
        };
        self.frames += frames as u64;
        Ok(())
    }

    fn frames(&mut self, _: &Episode, batch: &FrameBatch) -> Result<()> {
        let first = batch.first;
        let mut frames = Vec::new();
        for ([rgb, depth], camera) in self.stacks.iter().zip(&batch.cameras) {
            let metres = stack::bytes(&camera.depth.metres(), f32::to_le_bytes);
            frames.push(stack::Frames { stack: rgb, first, bytes: camera.rgb.clone() });
            frames.push(stack::Frames { stack: depth, first, bytes: metres });
        }
        if let Some(cloud) = &self.cloud {
            let bytes = stack::bytes(&batch.cloud, f32::to_le_bytes);
            frames.push(stack::Frames { stack: cloud, first, bytes });
        }
        stack::write(&self.path, batch.count, &frames)
    }

    fn end(&mut self, _: &Episode) -> Result<()> {
        self.stacks.clear();
        self.cloud = None;
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        let Some(file) = self.file.take() else { return Ok(()) };
        if let Some(data) = self.data.take() {
            data.attr("total", self.frames)?;
        }
        file.finish()
    }
}

/// Writes the first `rows` rows.
fn write_articulation(group: &GroupWriter, articulation: &Articulation, rows: usize) -> Result<()> {
    let joints = articulation.joints.len();
    let table = |name: &str, values: &[f32], columns: usize| {
        group.array(name, &[rows, columns], &values[..rows * columns]).map(drop)
    };
    table("joint_position", &articulation.position, joints)?;
    table("joint_velocity", &articulation.velocity, joints)?;
    table("root_pose", &articulation.root_pose, 7)?;
    table("root_velocity", &articulation.root_velocity, 6)
}
