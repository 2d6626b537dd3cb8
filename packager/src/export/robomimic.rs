//! robomimic: `demos.hdf5` with `data/demo_<i>/{actions, actions_unscaled, states, rewards, dones, obs}` and
//! `mask/{train, valid, success}`.
//!
//! Actions are scaled column by column to [-1, 1] over the whole export: `unscaled = actions * action_scale +
//! action_offset`, both attributes of `data`; columns that never change become 0. `actions_unscaled` holds
//! the exact values. `obs` has `state`, `joint_pos`, `joint_vel`, `gripper_pos`, `eef_pos`, `eef_quat`,
//! `base_pose`, `object`, `<camera>_image` and `<camera>_depth` (f32 metres). Next observations are not
//! stored twice: load with `load_next_obs=False`.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::sink::{ExportHeader, Sink};
use super::source::{Episode, FrameBatch};
use super::stack::{self, FrameStack};
use super::{write_attributes, write_camera_series, write_conventions};
use crate::error::Result;
use crate::h5::{GroupWriter, H5Writer};

/// File name in the output folder.
const FILE: &str = "demos.hdf5";

/// Writes one file of demonstrations.
pub(super) struct RobomimicSink {
    file: Option<H5Writer>,
    path: PathBuf,
    data: Option<GroupWriter>,
    scale: Vec<f64>,
    offset: Vec<f64>,
    masks: Masks,
    frames: u64,
    stacks: Vec<[FrameStack; 2]>,
}

#[derive(Default)]
struct Masks {
    train: Vec<String>,
    valid: Vec<String>,
    success: Vec<String>,
}

impl RobomimicSink {
    pub fn create(folder: &Path, header: &ExportHeader) -> Result<Self> {
        let path = folder.join(FILE);
        let file = H5Writer::create(&path)?;
        let data = file.root().group("data")?;
        write_conventions(&data, header)?;
        let [low, high] = [&header.action_statistics.min, &header.action_statistics.max];
        let ranges: Vec<(f64, f64)> = low.iter().copied().zip(high.iter().copied()).collect();
        let scale: Vec<f64> = ranges
            .iter()
            .map(|(low, high)| if high > low { (high - low) / 2.0 } else { 1.0 })
            .collect();
        let offset: Vec<f64> = ranges.iter().map(|(low, high)| (low + high) / 2.0).collect();
        data.attr_list("action_scale", &scale)?;
        data.attr_list("action_offset", &offset)?;
        data.attr_str("action_scaling", "unscaled = actions * action_scale + action_offset")?;
        let environment = json!({
            "env_name": header.name,
            // A gym environment, in robomimic's numbering.
            "type": 2,
            "env_kwargs": { "cameras": header.cameras.iter().map(|c| &c.name).collect::<Vec<_>>() },
        });
        data.attr_str("env_args", &environment.to_string())?;
        Ok(Self {
            file: Some(file),
            path,
            data: Some(data),
            scale,
            offset,
            masks: Masks::default(),
            frames: 0,
            stacks: Vec::new(),
        })
    }

    fn scaled(&self, values: &[f32]) -> Vec<f32> {
        let columns = self.scale.len().max(1);
        let scaled = |(i, &value): (usize, &f32)| {
            let column = i % columns;
            let unit = (f64::from(value) - self.offset[column]) / self.scale[column];
            unit.clamp(-1.0, 1.0) as f32
        };
        values.iter().enumerate().map(scaled).collect()
    }
}

impl Sink for RobomimicSink {
    fn begin(&mut self, episode: &Episode) -> Result<()> {
        let data = self.data.as_ref().expect("episodes come before the end");
        let key = format!("demo_{}", episode.index);
        let group = data.group(&key)?;
        write_attributes(&group, episode)?;
        let frames = episode.frames();
        let columns = episode.action.columns();
        group.array("actions", &[frames, columns], &self.scaled(&episode.action.values))?;
        group.array("actions_unscaled", &[frames, columns], &episode.action.values)?;
        let state: Vec<f32> = rows(episode).flatten().copied().collect();
        let state_columns = state.len() / frames;
        group.array("states", &[frames, state_columns], &state)?;
        let mut rewards = vec![0f32; frames];
        let mut dones = vec![0u8; frames];
        dones[frames - 1] = 1;
        rewards[frames - 1] = f32::from(u8::from(episode.attributes.success));
        group.array("rewards", &[frames], &rewards)?;
        group.array("dones", &[frames], &dones)?;
        let obs = group.group("obs")?;
        write_low_dimensional(&obs, episode)?;
        write_camera_series(&obs, episode)?;
        self.stacks = episode
            .cameras
            .iter()
            .map(|camera| {
                let shape = |channels| [frames, camera.height, camera.width, channels];
                let name = |kind: &str| format!("{}_{kind}", camera.name);
                let image = FrameStack::create::<u8>(&obs, &name("image"), &shape(3))?;
                let depth = FrameStack::create::<f32>(&obs, &name("depth"), &shape(1))?;
                obs.dataset_attr_str(depth.dataset(), "depth_unit", "m")?;
                Ok([image, depth])
            })
            .collect::<Result<_>>()?;
        let mask = if episode.attributes.validation {
            &mut self.masks.valid
        } else {
            &mut self.masks.train
        };
        mask.push(key.clone());
        if episode.attributes.success {
            self.masks.success.push(key);
        }
        self.frames += frames as u64;
        Ok(())
    }

    fn frames(&mut self, _: &Episode, batch: &FrameBatch) -> Result<()> {
        let frames: Vec<stack::Frames<'_>> = self
            .stacks
            .iter()
            .zip(&batch.cameras)
            .flat_map(|([image, depth], camera)| {
                let metres = stack::bytes(&camera.depth.metres(), f32::to_le_bytes);
                [
                    stack::Frames { stack: image, first: batch.first, bytes: camera.rgb.clone() },
                    stack::Frames { stack: depth, first: batch.first, bytes: metres },
                ]
            })
            .collect();
        stack::write(&self.path, batch.count, &frames)
    }

    fn end(&mut self, _: &Episode) -> Result<()> {
        self.stacks.clear();
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        let Some(file) = self.file.take() else { return Ok(()) };
        if let Some(data) = self.data.take() {
            data.attr("total", self.frames)?;
        }
        let mask = file.root().group("mask")?;
        for (name, keys) in [
            ("train", &self.masks.train),
            ("valid", &self.masks.valid),
            ("success", &self.masks.success),
        ] {
            mask.strings(name, keys)?;
        }
        drop(mask);
        file.finish()
    }
}

/// Robot and object positions, frame by frame: what `states` holds.
fn rows(episode: &Episode) -> impl Iterator<Item = impl Iterator<Item = &f32>> {
    let robot = episode.robot.position.chunks(episode.robot.joints.len().max(1));
    let object = episode.object.position.chunks(episode.object.joints.len().max(1));
    robot.zip(object).map(|(robot, object)| robot.iter().chain(object))
}

fn write_low_dimensional(obs: &GroupWriter, episode: &Episode) -> Result<()> {
    let frames = episode.frames();
    let columns = episode.robot.joints.len();
    obs.array("state", &[frames, episode.state.columns()], &episode.state.values)?;
    obs.array("joint_pos", &[frames, columns], &episode.robot.position)?;
    obs.array("joint_vel", &[frames, columns], &episode.robot.velocity)?;
    let fingers = episode.fingers(&episode.robot.position);
    obs.array("gripper_pos", &[frames, episode.finger_joints], &fingers)?;
    let part = |from: usize, to: usize| -> Vec<f32> {
        episode.eef.chunks(7).flat_map(|row| &row[from..to]).copied().collect()
    };
    let position = obs.array("eef_pos", &[frames, 3], &part(0, 3))?;
    let rotation = obs.array("eef_quat", &[frames, 4], &part(3, 7))?;
    let base = obs.array("base_pose", &[frames, 7], &episode.base)?;
    for dataset in [&position, &rotation, &base] {
        obs.dataset_attr_str(dataset, "frame", "world")?;
    }
    for dataset in [&rotation, &base] {
        obs.dataset_attr_str(dataset, "quat_order", "wxyz")?;
    }
    obs.array("object", &[frames, episode.object.joints.len()], &episode.object.position)?;
    Ok(())
}
