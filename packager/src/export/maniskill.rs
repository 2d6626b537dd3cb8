//! ManiSkill: `trajectory.h5` with `traj_<i>` and `trajectory.json`.
//!
//! T frames are T observations and T - 1 actions: `actions[t]` leads from `obs[t]` to `obs[t + 1]`.
//!
//! - `obs/agent/{qpos, qvel}`, `obs/extra/{tcp_pose, base_pose, object_qpos}` (`x y z qw qx qy qz`, world).
//! - `obs/sensor_data/<camera>/{rgb u8, depth i16 millimetres, segmentation i16}` `[T, H, W, channels]`;
//!   depth beyond 32.767 m is 0, invalid.
//! - `obs/sensor_param/<camera>/{intrinsic_cv [T, 3, 3], extrinsic_cv [T, 3, 4], cam2world_gl [T, 4, 4]}`:
//!   camera from world in the OpenCV frame, and world from camera in the OpenGL frame.
//! - `obs/pointcloud/{xyzw [T, N, 4], rgb u8 [T, N, 3]}`.
//! - `env_states/articulations/<name> [T, 13 + 2 n]`: root position, quaternion (wxyz), linear and angular
//!   velocity, joint positions, joint velocities.

use std::path::{Path, PathBuf};

use akrobat_model::{Pose, pose};
use nalgebra::{UnitQuaternion, Vector3};
use serde_json::{Value, json};

use super::config::{ActionKind, BaseActions};
use super::sink::{ExportHeader, Sink};
use super::source::{Articulation, CameraSeries, Episode, FrameBatch};
use super::stack::{self, FrameStack};
use super::{write_attributes, write_conventions};
use crate::error::{PackError, Result};
use crate::h5::{GroupWriter, H5Writer};

/// The environment that replays the file, as the JSON file names it: `gymnasium.make` imports what stands before
/// the colon (`python/akrobat/maniskill.py`).
pub(crate) const ENVIRONMENT: &str = "akrobat.maniskill:AkrobatReplay-v1";

/// Seeds of NumPy's generator, which ManiSkill sets, have 32 bits.
const SEED_BITS: u64 = 0xffff_ffff;

/// Writes one ManiSkill recording.
pub(super) struct ManiskillSink {
    file: Option<H5Writer>,
    path: PathBuf,
    header: ExportHeader,
    episodes: Vec<Value>,
    tasks: Vec<String>,
    stacks: Vec<[FrameStack; 3]>,
    cloud: Option<[FrameStack; 2]>,
}

impl ManiskillSink {
    pub fn create(folder: &Path, header: &ExportHeader) -> Result<Self> {
        let path = folder.join("trajectory.h5");
        let file = H5Writer::create(&path)?;
        write_conventions(&file.root(), header)?;
        Ok(Self {
            file: Some(file),
            path,
            header: header.clone(),
            episodes: Vec::new(),
            tasks: Vec::new(),
            stacks: Vec::new(),
            cloud: None,
        })
    }

    fn control_mode(&self) -> &'static str {
        match (self.header.config.actions, self.header.config.base) {
            (ActionKind::JointPosition, BaseActions::Absolute) => "pd_joint_pos",
            (ActionKind::JointVelocity, _) => "pd_joint_vel",
            (ActionKind::EefPose, _) => "pd_ee_pose",
            (ActionKind::EefDelta, _) => "pd_ee_delta_pose",
            (ActionKind::JointPosition, _) => "pd_joint_pos_base_delta",
        }
    }

    fn description(&self) -> Value {
        json!({
            "env_info": {
                "env_id": ENVIRONMENT,
                "max_episode_steps": self.header.episode_frames[1] - 1,
                "env_kwargs": {
                    "obs_mode": "rgb+depth+segmentation+pointcloud",
                    "control_mode": self.control_mode(),
                    "control_freq": self.header.frame_rate_hz,
                    "tasks": self.tasks,
                    "rig": { "name": "exported", "cameras": self.header.cameras },
                },
            },
            "commit_info": null,
            "source_type": "motionplanning",
            "source_desc": format!("{}, replayed and rendered by Akrobat", self.header.name),
            "conventions": self.header.conventions,
            "action_names": self.header.action_names,
            "state_names": self.header.state_names,
            "episodes": self.episodes,
        })
    }
}

impl Sink for ManiskillSink {
    fn begin(&mut self, episode: &Episode) -> Result<()> {
        let file = self.file.as_ref().expect("episodes come before the end");
        let group = file.root().group(&format!("traj_{}", episode.index))?;
        write_attributes(&group, episode)?;
        let (frames, known) = (episode.frames(), &episode.attributes);
        let steps = frames - 1;
        let columns = episode.action.columns();
        group.array("actions", &[steps, columns], &episode.action.values[..steps * columns])?;
        let last =
            |value: bool| -> Vec<bool> { (0..steps).map(|t| value && t + 1 == steps).collect() };
        group.array("terminated", &[steps], &last(known.success))?;
        group.array("truncated", &[steps], &last(!known.success))?;
        group.array("success", &[steps], &last(known.success))?;
        let obs = group.group("obs")?;
        let agent = obs.group("agent")?;
        let joints = episode.robot.joints.len();
        agent.array("qpos", &[frames, joints], &episode.robot.position)?;
        agent.array("qvel", &[frames, joints], &episode.robot.velocity)?;
        let extra = obs.group("extra")?;
        extra.array("tcp_pose", &[frames, 7], &episode.eef)?;
        extra.array("base_pose", &[frames, 7], &episode.base)?;
        let object = [frames, episode.object.joints.len()];
        extra.array("object_qpos", &object, &episode.object.position)?;
        extra.array("state", &[frames, episode.state.columns()], &episode.state.values)?;
        let articulations = group.group("env_states")?.group("articulations")?;
        for articulation in [&episode.robot, &episode.object] {
            let rows = env_state(articulation, frames);
            let columns = 13 + 2 * articulation.joints.len();
            articulations.array(&articulation.name, &[frames, columns], &rows)?;
        }
        let (data, param) = (obs.group("sensor_data")?, obs.group("sensor_param")?);
        self.stacks = episode
            .cameras
            .iter()
            .map(|camera| {
                write_parameters(&param.group(&camera.name)?, camera, frames)?;
                image_stacks(&data.group(&camera.name)?, camera, frames)
            })
            .collect::<Result<_>>()?;
        self.cloud = match episode.cloud_points {
            0 => None,
            points => {
                let group = obs.group("pointcloud")?;
                let xyzw = FrameStack::create::<f32>(&group, "xyzw", &[frames, points, 4])?;
                let rgb = FrameStack::create::<u8>(&group, "rgb", &[frames, points, 3])?;
                Some([xyzw, rgb])
            }
        };
        let task = self.tasks.iter().position(|task| *task == episode.task_toml);
        let task = task.unwrap_or_else(|| {
            self.tasks.push(episode.task_toml.clone());
            self.tasks.len() - 1
        });
        let seed = known.seed & SEED_BITS;
        let still: serde_json::Map<String, Value> =
            episode.cameras.iter().filter_map(still_camera).collect();
        self.episodes.push(json!({
            "episode_id": episode.index,
            "episode_seed": seed,
            "control_mode": self.control_mode(),
            "elapsed_steps": steps,
            "reset_kwargs": {
                "seed": seed,
                "options": {
                    "task": task,
                    "robot": &episode.robot.position[..joints],
                    "object": &episode.object.position[..object[1]],
                    "goal": known.goal,
                    "cameras": still,
                },
            },
            "success": known.success,
            "fail": !known.success,
            "robot": known.robot_id,
            "object": known.object_id,
            "scene": known.scene_id,
            "trajectory": known.id,
            "instruction": known.instruction,
            "robot_joints": episode.robot.joints,
            "object_joints": episode.object.joints,
        }));
        Ok(())
    }

    fn frames(&mut self, episode: &Episode, batch: &FrameBatch) -> Result<()> {
        let first = batch.first;
        let mut frames = Vec::new();
        for ([rgb, depth, segmentation], camera) in self.stacks.iter().zip(&batch.cameras) {
            let signed = |v: u16| i16::try_from(v).unwrap_or(0).to_le_bytes();
            let depths = stack::bytes(&camera.depth.millimetres(), signed);
            let segments = stack::bytes(&camera.segmentation, signed);
            frames.push(stack::Frames { stack: rgb, first, bytes: camera.rgb.clone() });
            frames.push(stack::Frames { stack: depth, first, bytes: depths });
            frames.push(stack::Frames { stack: segmentation, first, bytes: segments });
        }
        if let Some([xyzw, rgb]) = &self.cloud {
            let points = batch.cloud.chunks_exact(6);
            let positions: Vec<f32> =
                points.clone().flat_map(|p| [p[0], p[1], p[2], 1.0]).collect();
            // Casts saturate.
            let colors: Vec<u8> =
                points.flat_map(|p| [p[3], p[4], p[5]]).map(|c| c.round() as u8).collect();
            let positions = stack::bytes(&positions, f32::to_le_bytes);
            frames.push(stack::Frames { stack: xyzw, first, bytes: positions });
            frames.push(stack::Frames { stack: rgb, first, bytes: colors });
        }
        debug_assert!(first < episode.frames());
        stack::write(&self.path, batch.count, &frames)
    }

    fn end(&mut self, _: &Episode) -> Result<()> {
        self.stacks.clear();
        self.cloud = None;
        Ok(())
    }

    fn finish(&mut self) -> Result<()> {
        let Some(file) = self.file.take() else { return Ok(()) };
        file.finish()?;
        let text = format!("{:#}\n", self.description());
        let path = self.path.with_extension("json");
        std::fs::write(&path, text).map_err(|e| PackError::io(&path, e))
    }
}

fn image_stacks(
    group: &GroupWriter,
    camera: &CameraSeries,
    frames: usize,
) -> Result<[FrameStack; 3]> {
    let shape = |channels| [frames, camera.height, camera.width, channels];
    let depth = FrameStack::create::<i16>(group, "depth", &shape(1))?;
    group.dataset_attr_str(depth.dataset(), "depth_unit", "mm")?;
    Ok([
        FrameStack::create::<u8>(group, "rgb", &shape(3))?,
        depth,
        FrameStack::create::<i16>(group, "segmentation", &shape(1))?,
    ])
}

fn write_parameters(group: &GroupWriter, camera: &CameraSeries, frames: usize) -> Result<()> {
    let intrinsics: Vec<f32> = camera.intrinsics.iter().map(|&v| v as f32).collect();
    group.array("intrinsic_cv", &[frames, 3, 3], &intrinsics)?;
    let mut extrinsics = Vec::new();
    let mut gl_poses = Vec::new();
    for matrix in camera.world_from_camera.chunks_exact(16) {
        let world_from_camera = pose_of_matrix(matrix);
        let camera_from_world = pose::to_matrix(&world_from_camera.inverse());
        extrinsics.extend(camera_from_world[..3].as_flattened().iter().map(|&v| v as f32));
        // OpenGL's camera looks along -z with y up.
        let flip = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let gl = pose::to_matrix(&(world_from_camera * flip));
        gl_poses.extend(gl.as_flattened().iter().map(|&v| v as f32));
    }
    group.array("extrinsic_cv", &[frames, 3, 4], &extrinsics)?;
    group.array("cam2world_gl", &[frames, 4, 4], &gl_poses)?;
    Ok(())
}

/// Name and world pose (`x y z qw qx qy qz`) of a camera that stands still: where it was put may have depended on the
/// whole trajectory, which the environment does not know.
fn still_camera(camera: &CameraSeries) -> Option<(String, Value)> {
    let mut poses = camera.world_from_camera.chunks_exact(16);
    let first = poses.next()?;
    let stands = poses.all(|pose| pose == first);
    stands.then(|| (camera.name.clone(), json!(pose::to_xyz_wxyz(&pose_of_matrix(first)))))
}

/// A pose from a row-major 4 x 4 matrix.
pub(super) fn pose_of_matrix(matrix: &[f64]) -> Pose {
    let m = nalgebra::Matrix3::from_fn(|row, column| matrix[4 * row + column]);
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(m);
    let translation = nalgebra::Translation3::new(matrix[3], matrix[7], matrix[11]);
    Pose::from_parts(translation, UnitQuaternion::from_rotation_matrix(&rotation))
}

fn env_state(articulation: &Articulation, frames: usize) -> Vec<f32> {
    let joints = articulation.joints.len();
    let row = |values: &[f32], columns: usize, t: usize| values[t * columns..][..columns].to_vec();
    (0..frames)
        .flat_map(|t| {
            [
                row(&articulation.root_pose, 7, t),
                row(&articulation.root_velocity, 6, t),
                row(&articulation.position, joints, t),
                row(&articulation.velocity, joints, t),
            ]
            .concat()
        })
        .collect()
}
