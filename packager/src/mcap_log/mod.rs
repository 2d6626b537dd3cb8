//! MCAP logs in the `ros2` profile: one file per episode.
//!
//! Topics: `/camera/<name>/color/image/compressed`, `/camera/<name>/depth/image_raw`,
//! `/camera/<name>/camera_info`, `/points`, `/tf`, `/tf_static`, `/joint_states`. URDFs, rig and task
//! are attachments, everything else that is known of the episode stands in metadata records. Stamps count
//! from the start of the trajectory.

pub(crate) mod cdr;
pub(crate) mod content;
pub(crate) mod definitions;
mod messages;
pub(crate) mod read;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use akrobat_cameras::{CameraFrame, Observation};
use akrobat_model::Pose;
use mcap::records::{MessageHeader, Metadata};
use mcap::{Compression, McapError, WriteOptions, Writer};
use rayon::prelude::*;

use crate::color;
use crate::dataset::DatasetConfig;
use crate::episode::EpisodeInfo;
use crate::error::{PackError, Result};
use crate::shard::check_observation;
use crate::storage::ColorEncoding;
use crate::whole_file::PartialFile;
use messages::optical_frame;

/// Metadata record that holds the dataset's configuration as JSON.
pub(crate) const DATASET_METADATA: &str = "akrobat.dataset";

/// Metadata record that tells what is known of the episode.
pub(crate) const EPISODE_METADATA: &str = "akrobat.episode";

/// Bytes after which a compressed chunk of messages is closed.
const CHUNK_BYTES: u64 = 4 << 20;

/// Writes one episode.
pub struct McapWriter {
    writer: Writer<BufWriter<File>>,
    partial: PartialFile,
    info: EpisodeInfo,
    color: ColorEncoding,
    channels: Channels,
    frames: u32,
}

impl McapWriter {
    /// Starts the log that will be `path`.
    ///
    /// # Errors
    /// [`PackError::Unwritable`] where the file cannot be created, [`PackError::Io`].
    pub fn create(path: &Path, info: EpisodeInfo, dataset: &DatasetConfig) -> Result<Self> {
        let color = dataset.storage.color;
        let partial = PartialFile::create(path)?;
        let file = File::create(partial.path()).map_err(|e| PackError::create(path, e))?;
        let options = WriteOptions::new()
            .profile("ros2")
            .library("akrobat")
            .compression(Some(Compression::Zstd))
            .compression_threads(0)
            .chunk_size(Some(CHUNK_BYTES));
        let error = |e| mcap_error(path, e);
        let mut writer = options.create(BufWriter::new(file)).map_err(error)?;
        let channels = Channels::add(&mut writer, &info).map_err(error)?;
        write_metadata(&mut writer, &info).map_err(error)?;
        let metadata = [("config".to_owned(), dataset.to_json())].into();
        let record = Metadata { name: DATASET_METADATA.into(), metadata };
        writer.write_metadata(&record).map_err(error)?;
        write_attachments(&mut writer, &info).map_err(error)?;
        Ok(Self { writer, partial, info, color, channels, frames: 0 })
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where the observation does not fit the episode, [`PackError::Io`].
    pub fn push(&mut self, observation: &Observation) -> Result<()> {
        let path = self.partial.final_path();
        check_observation(path, &self.info, self.frames as usize, observation)?;
        let time_ns = nanoseconds(observation.time_s);
        let images: Vec<[Vec<u8>; 3]> = observation
            .cameras
            .par_iter()
            .map(|camera| camera_messages(path, time_ns, camera, self.color))
            .collect::<Result<_>>()?;
        let mut outgoing = Vec::new();
        if self.frames == 0 {
            let root = [(format!("{}/root", self.info.robot_id), self.info.world_from_robot_root)];
            outgoing.push((self.channels.tf_static, messages::transforms(time_ns, &root)));
        }
        outgoing
            .push((self.channels.tf, messages::transforms(time_ns, &moving_frames(observation))));
        outgoing.push((self.channels.joint_states, joint_state(time_ns, &self.info, observation)));
        for (channels, messages) in self.channels.cameras.iter().zip(images) {
            outgoing.extend(channels.iter().copied().zip(messages));
        }
        if self.info.cloud_points > 0 {
            let frame = match (self.info.cloud.frame.as_str(), self.info.rig.cameras.first()) {
                ("camera", Some(camera)) => messages::optical_frame(&camera.name),
                (frame, _) => frame.to_owned(),
            };
            let cloud = messages::point_cloud(time_ns, &frame, &observation.cloud);
            outgoing.push((self.channels.points, cloud));
        }
        let sequence = self.frames;
        self.frames += 1;
        for (channel_id, data) in outgoing {
            let header =
                MessageHeader { channel_id, sequence, log_time: time_ns, publish_time: time_ns };
            self.writer.write_to_known_channel(&header, &data).map_err(|e| mcap_error(path, e))?;
        }
        Ok(())
    }

    /// Completes the log and gives it its final name.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where frames are missing, [`PackError::Io`].
    pub fn finish(mut self) -> Result<()> {
        let path = self.partial.final_path();
        if self.frames != self.info.frames {
            let item = format!("episode {}", self.info.id);
            let expected = format!("{} frames", self.info.frames);
            return Err(PackError::inconsistent(path, item, expected, self.frames.to_string()));
        }
        self.writer.finish().map_err(|e| mcap_error(path, e))?;
        let buffered = self.writer.into_inner();
        buffered.into_inner().map_err(|e| PackError::io(path, e.into_error()))?;
        self.partial.commit()
    }
}

impl std::fmt::Debug for McapWriter {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("McapWriter").field("partial", &self.partial).finish_non_exhaustive()
    }
}

/// Channel ids; those of a camera are colour, depth and info.
#[derive(Debug)]
struct Channels {
    cameras: Vec<[u16; 3]>,
    points: u16,
    tf: u16,
    tf_static: u16,
    joint_states: u16,
}

impl Channels {
    fn add(
        writer: &mut Writer<BufWriter<File>>,
        info: &EpisodeInfo,
    ) -> std::result::Result<Self, McapError> {
        let mut channel = |topic: &str, interface: &str| {
            let definition = definitions::ros2msg(interface);
            let schema = writer.add_schema(interface, "ros2msg", definition.as_bytes())?;
            writer.add_channel(schema, topic, "cdr", &BTreeMap::new())
        };
        let mut cameras = Vec::new();
        for camera in &info.rig.cameras {
            let topic = |suffix: &str| format!("/camera/{}/{suffix}", camera.name);
            cameras.push([
                channel(&topic("color/image/compressed"), "sensor_msgs/msg/CompressedImage")?,
                channel(&topic("depth/image_raw"), "sensor_msgs/msg/Image")?,
                channel(&topic("camera_info"), "sensor_msgs/msg/CameraInfo")?,
            ]);
        }
        Ok(Self {
            cameras,
            points: channel("/points", "sensor_msgs/msg/PointCloud2")?,
            tf: channel("/tf", "tf2_msgs/msg/TFMessage")?,
            tf_static: channel("/tf_static", "tf2_msgs/msg/TFMessage")?,
            joint_states: channel("/joint_states", "sensor_msgs/msg/JointState")?,
        })
    }
}

fn mcap_error(path: &Path, error: McapError) -> PackError {
    match error {
        McapError::Io(source) => PackError::io(path, source),
        other => PackError::Library {
            path: path.to_path_buf(),
            item: "MCAP records".into(),
            message: other.to_string(),
        },
    }
}

fn nanoseconds(time_s: f64) -> u64 {
    (time_s * 1e9).round() as u64
}

fn camera_messages(
    path: &Path,
    time_ns: u64,
    camera: &CameraFrame,
    encoding: ColorEncoding,
) -> Result<[Vec<u8>; 3]> {
    let format = color::file_format(encoding).unwrap_or("png");
    let data = color::encode(camera, encoding).map_err(|e| PackError::Library {
        path: path.to_path_buf(),
        item: format!("colour image of {}", camera.name),
        message: e.to_string(),
    })?;
    Ok([
        messages::compressed_image(time_ns, &camera.name, format, &data),
        messages::depth_image(time_ns, camera),
        messages::camera_info(time_ns, camera),
    ])
}

fn moving_frames(observation: &Observation) -> Vec<(String, Pose)> {
    let cameras = observation.cameras.iter().map(|c| (optical_frame(&c.name), c.world_from_camera));
    let bodies = [
        ("base".to_owned(), observation.world_from_base),
        ("tool".to_owned(), observation.world_from_tool),
        ("object".to_owned(), observation.world_from_object),
    ];
    bodies.into_iter().chain(cameras).collect()
}

fn joint_state(time_ns: u64, info: &EpisodeInfo, observation: &Observation) -> Vec<u8> {
    let names: Vec<&str> =
        info.robot_joints.iter().chain(&info.object_joints).map(String::as_str).collect();
    let positions = [&observation.robot[..], &observation.object].concat();
    messages::joint_state(time_ns, &names, &positions)
}

fn write_metadata(
    writer: &mut Writer<BufWriter<File>>,
    info: &EpisodeInfo,
) -> std::result::Result<(), McapError> {
    let entries = [
        ("episode_id", info.id.clone()),
        ("success", info.success.to_string()),
        ("seed", info.seed.to_string()),
        ("traj_index", info.traj_index.to_string()),
        ("frames", info.frames.to_string()),
        ("grasp_id", info.grasp_id.to_string()),
        ("start", info.start.to_string()),
        ("goal", info.goal.to_string()),
        ("active_joint", info.active_joint.clone()),
        ("scene_id", info.scene_id.clone()),
        ("object_id", info.object_id.clone()),
        ("robot_id", info.robot_id.clone()),
        ("provenance", info.provenance.to_string()),
    ];
    let metadata = entries.map(|(key, value)| (key.to_owned(), value)).into();
    writer.write_metadata(&Metadata { name: EPISODE_METADATA.into(), metadata })
}

fn write_attachments(
    writer: &mut Writer<BufWriter<File>>,
    info: &EpisodeInfo,
) -> std::result::Result<(), McapError> {
    let (rig, toml) = (info.rig_toml(), "application/toml");
    let own = [("task.toml", toml, info.task_toml.as_bytes()), ("rig.toml", toml, rig.as_bytes())];
    let given =
        info.attachments.iter().map(|a| (a.name.as_str(), a.media_type.as_str(), &a.content[..]));
    for (name, media_type, data) in own.into_iter().chain(given) {
        writer.attach(&mcap::Attachment {
            log_time: 0,
            create_time: 0,
            name: name.to_owned(),
            media_type: media_type.to_owned(),
            data: data.into(),
        })?;
    }
    Ok(())
}
