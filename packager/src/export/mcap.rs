//! MCAP: one `episode_<i>.mcap` per episode, in ROS 2 interfaces.

use std::path::{Path, PathBuf};

use akrobat_cameras::{CameraFrame, Intrinsics, Modality, Observation, Rig};
use akrobat_model::robot::BaseKind;
use akrobat_model::{Phase, Pose};

use super::maniskill::pose_of_matrix;
use super::sink::{ExportHeader, Sink};
use super::source::{CameraBatch, Episode, FrameBatch, pose_of_row};
use crate::dataset::{Container, DatasetConfig};
use crate::episode::{CloudLayout, EpisodeInfo};
use crate::error::Result;
use crate::mcap_log::McapWriter;

/// Writes a folder of logs.
pub(super) struct McapSink {
    folder: PathBuf,
    header: ExportHeader,
    open: Option<McapWriter>,
}

impl McapSink {
    pub fn new(folder: &Path, header: &ExportHeader) -> Self {
        Self { folder: folder.to_path_buf(), header: header.clone(), open: None }
    }

    fn info(&self, episode: &Episode) -> EpisodeInfo {
        let known = &episode.attributes;
        let grasp: Vec<f32> = known.grasp_pose.iter().map(|&v| v as f32).collect();
        let root = episode.robot.root_pose.get(..7).and_then(pose_of_row);
        EpisodeInfo {
            id: known.id.clone(),
            success: known.success,
            seed: known.seed,
            traj_index: known.traj_index,
            frames: episode.frames() as u32,
            frame_rate_hz: known.frame_rate_hz,
            grasp_id: known.grasp_id,
            grasp_link: known.grasp_link.clone(),
            link_from_tool: pose_of_row(&grasp).unwrap_or_else(Pose::identity),
            start: known.start,
            goal: known.goal,
            scene_id: known.scene_id.clone(),
            object_id: known.object_id.clone(),
            robot_id: known.robot_id.clone(),
            base_kind: match episode.base_joints {
                0 => BaseKind::Fixed,
                _ => BaseKind::Holonomic,
            },
            robot_joints: episode.robot.joints.clone(),
            finger_joints: episode.finger_joints,
            object_joints: episode.object.joints.clone(),
            active_joint: known.active_joint.clone(),
            world_from_robot_root: root.unwrap_or_else(Pose::identity),
            rig: Rig { name: self.header.name.clone(), cameras: self.header.cameras.clone() },
            modalities: Modality::DEFAULT.to_vec(),
            cloud_points: episode.cloud_points,
            cloud: CloudLayout::default(),
            labels: Vec::new(),
            task_toml: episode.task_toml.clone(),
            provenance: self.header.provenance.clone(),
            attachments: Vec::new(),
        }
    }
}

impl Sink for McapSink {
    fn begin(&mut self, episode: &Episode) -> Result<()> {
        let path = self.folder.join(format!("episode_{}.mcap", episode.index));
        let info = self.info(episode);
        let dataset = DatasetConfig {
            container: Container::Mcap,
            provenance: self.header.provenance.clone(),
            ..DatasetConfig::new(&self.header.name, info.rig.clone())
        };
        self.open = Some(McapWriter::create(&path, info, &dataset)?);
        Ok(())
    }

    fn frames(&mut self, episode: &Episode, batch: &FrameBatch) -> Result<()> {
        let log = self.open.as_mut().expect("frames come between begin and end");
        for offset in 0..batch.count {
            log.push(&observation(episode, batch, offset))?;
        }
        Ok(())
    }

    fn end(&mut self, _: &Episode) -> Result<()> {
        self.open.take().expect("an episode that ends was begun").finish()
    }

    fn finish(&mut self) -> Result<()> {
        Ok(())
    }
}

/// Frame `offset` of a batch, as it was observed.
fn observation(episode: &Episode, batch: &FrameBatch, offset: usize) -> Observation {
    let frame = batch.first + offset;
    let row = |values: &[f32], columns: usize| -> Vec<f64> {
        values[frame * columns..][..columns].iter().map(|&v| f64::from(v)).collect()
    };
    let pose =
        |values: &[f32]| pose_of_row(&values[frame * 7..][..7]).unwrap_or_else(Pose::identity);
    let cloud = batch.cloud.chunks_exact(6 * episode.cloud_points.max(1)).nth(offset);
    let points = cloud.unwrap_or_default().chunks_exact(6);
    Observation {
        frame: frame as u32,
        time_s: episode.time_s[frame],
        phase: Phase::ALL.get(episode.phase[frame] as usize).copied().unwrap_or(Phase::Manipulate),
        cameras: (0..batch.cameras.len())
            .map(|camera| camera_frame(episode, camera, &batch.cameras[camera], offset, frame))
            .collect(),
        cloud: points.map(|p| [p[0], p[1], p[2], p[3], p[4], p[5]]).collect(),
        cloud_normals: Vec::new(),
        robot: row(&episode.robot.position, episode.robot.joints.len()),
        object: row(&episode.object.position, episode.object.joints.len()),
        world_from_tool: pose(&episode.eef),
        world_from_base: pose(&episode.base),
        world_from_object: pose(&episode.object.root_pose),
    }
}

fn camera_frame(
    episode: &Episode,
    camera: usize,
    images: &CameraBatch,
    offset: usize,
    frame: usize,
) -> CameraFrame {
    let series = &episode.cameras[camera];
    let pixels = series.width * series.height;
    let k = &series.intrinsics[9 * frame..][..9];
    let intrinsics = Intrinsics {
        width: series.width as u32,
        height: series.height as u32,
        fx: k[0],
        fy: k[4],
        cx: k[2],
        cy: k[5],
    };
    let world_from_camera = pose_of_matrix(&series.world_from_camera[16 * frame..][..16]);
    CameraFrame {
        distortion: series.distortion,
        captured_frame: frame as u32,
        rgb: images.rgb[3 * pixels * offset..][..3 * pixels].to_vec(),
        depth_m: images.depth.part(pixels * offset..pixels * (offset + 1)).metres(),
        segmentation: vec![0; pixels],
        ..CameraFrame::new(&series.name, intrinsics, world_from_camera)
    }
}
