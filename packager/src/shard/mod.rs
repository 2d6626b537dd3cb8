//! HDF5 shards: episodes as robomimic and the AutoMoMa recorder lay them out, written while they
//! are rendered.
//!
//! `data/demo_i/` holds, for T frames:
//!
//! - `actions`, `processed_actions` `[T, columns]` f32: row t is the absolute joint target that leads
//!   from frame t to frame t + 1; the last row repeats. There is no scaling, so both are equal.
//! - `obs/{actions, joint_pos, joint_vel, gripper_pos, eef_pos, eef_quat, base_pose}`; row t of
//!   `obs/actions` is the action that led to frame t (for frame 0, its own joint positions). The images are hard-linked here.
//! - `camera_obs/<camera>_{rgb, depth, segmentation, intrinsics, world_from_camera}` and, where they were
//!   asked for, `_{instance, semantic, normals, xyz, flow, scene_flow}`. The lens' model and coefficients are
//!   attributes of `_intrinsics`. Of cameras slower than the episode, `_time` says when the image that
//!   stands at a frame was taken.
//! - `point_cloud` `[T, points, 6]` f32: `x y z` in metres, in the frame that its attribute names; `r g b` in
//!   0..255 (`[T, points, 3]` where there are no colours). `point_cloud_normals` `[T, points, 3]` where asked for.
//! - `states/articulation/<name>/{joint_position, joint_velocity, root_pose, root_velocity}` of
//!   robot and object, and their first rows under `initial_state/`.
//! - `segment_labels/{id, group, name, class, class_id, instance_id}`, `class_labels/{id, name}`,
//!   `instance_labels/{id, name}`, `time`, `phase`.
//!
//! Colours may be image files instead of arrays: `<camera>_rgb_encoded` and `<camera>_rgb_offsets`, see
//! [`ColorEncoding`](crate::ColorEncoding).
//!
//! Images and clouds have one frame per chunk. Chunks are encoded on all cores and written in
//! order, so the bytes do not depend on the number of threads.

mod encoded;
pub(crate) mod series;

use std::path::Path;

use akrobat_cameras::{CameraFrame, CloudPoint, Modality, Observation, SegmentTable};
use akrobat_model::{Pose, pose};
use hdf5::Dataset;
use rayon::prelude::*;

use crate::codec::Compression;
use crate::color;
use crate::dataset::{DatasetConfig, EpisodeReader};
use crate::episode::{DepthEncoding, EpisodeInfo, metres, millimetres};
use crate::error::{PackError, Result};
use crate::h5::{GroupWriter, H5Writer, write_chunk, write_error};
use crate::storage::StorageConfig;
use crate::trajectory_file::phase_names;
use encoded::EncodedImages;
use series::{Series, pose_rows, targets, twists, velocities};

/// Value of the root attribute `format`.
pub const FORMAT: &str = "akrobat.shard";

/// Value of the root attribute `format_version`.
pub const FORMAT_VERSION: u32 = 1;

/// Root attribute that holds the dataset's configuration as JSON.
pub(crate) const DATASET_ATTRIBUTE: &str = "dataset";

/// Frames that are encoded together: enough for the cores, few enough for memory.
const FRAMES_PER_BATCH: usize = 8;

/// Writes one shard, an episode at a time.
#[derive(Debug)]
pub struct ShardWriter {
    file: H5Writer,
    data: GroupWriter,
    storage: StorageConfig,
    episodes: u32,
    frames: u64,
    open: Option<OpenEpisode>,
}

impl ShardWriter {
    /// Starts the shard that will be `path`.
    ///
    /// # Errors
    /// [`PackError::Unwritable`] where the file cannot be created, [`PackError::Inconsistent`] where
    /// `storage` is not possible.
    pub fn create(path: &Path, dataset: &DatasetConfig) -> Result<Self> {
        let storage = dataset.storage.clone();
        if let Some(problem) = storage.problem() {
            return Err(PackError::inconsistent(path, "the shard", "possible storage", problem));
        }
        let file = H5Writer::create(path)?;
        let root = file.root();
        root.attr_str("format", FORMAT)?;
        root.attr("format_version", FORMAT_VERSION)?;
        for (name, value) in CONVENTIONS {
            root.attr_str(name, value)?;
        }
        // What all shards share is in each of them, so that a dataset can be put together from its shards.
        root.attr_str(DATASET_ATTRIBUTE, &dataset.to_json())?;
        let data = root.group("data")?;
        Ok(Self { file, data, storage, episodes: 0, frames: 0, open: None })
    }

    /// Number of finished episodes.
    pub fn episodes(&self) -> u32 {
        self.episodes
    }

    /// Bytes in the file so far.
    pub fn size(&self) -> u64 {
        self.file.size()
    }

    /// Starts an episode and returns its key, `demo_i`.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where an episode is still open or `info` contradicts itself.
    pub fn begin_episode(&mut self, info: EpisodeInfo) -> Result<String> {
        let path = self.file.path();
        if let Some(open) = &self.open {
            return Err(PackError::inconsistent(
                path,
                format!("episode {}", info.id),
                "the previous episode to be finished",
                format!("episode {} open", open.info.id),
            ));
        }
        check_info(path, &info)?;
        let key = format!("demo_{}", self.episodes);
        let group = self.data.group(&key)?;
        self.open = Some(OpenEpisode::create(group, &key, info, &self.storage)?);
        Ok(key)
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where the observation does not fit the episode, [`PackError::Io`]
    /// where the disk fails.
    pub fn push(&mut self, observation: Observation) -> Result<()> {
        let path = self.file.path().to_path_buf();
        let open = self.open.as_mut().ok_or_else(|| no_episode(&path))?;
        open.push(&path, observation)
    }

    /// Drops the open episode; its key is used again. The bytes that its chunks took stay unused.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where none is open, [`PackError::Io`] where the disk fails.
    pub fn abandon_episode(&mut self) -> Result<()> {
        let open = self.open.take().ok_or_else(|| no_episode(self.file.path()))?;
        drop(open);
        self.data.remove(&format!("demo_{}", self.episodes))
    }

    /// Completes the episode.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where frames are missing, [`PackError::Io`] where the disk fails.
    pub fn finish_episode(&mut self) -> Result<()> {
        let path = self.file.path().to_path_buf();
        let open = self.open.take().ok_or_else(|| no_episode(&path))?;
        self.frames += u64::from(open.info.frames);
        open.finish(&path)?;
        self.episodes += 1;
        self.file.flush()
    }

    /// Takes over an episode as it is stored elsewhere, and returns its key here.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where an episode is open, and where copying fails.
    pub(crate) fn copy_episode(&mut self, source: &EpisodeReader) -> Result<String> {
        if let Some(open) = &self.open {
            let got = format!("episode {} open", open.info.id);
            return Err(PackError::inconsistent(
                self.file.path(),
                "a copy",
                "no open episode",
                got,
            ));
        }
        let key = format!("demo_{}", self.episodes);
        let (file, root) = source.source();
        self.data.copy_from(file, root, &key)?;
        self.frames += source.frames()?;
        self.episodes += 1;
        self.file.flush()?;
        Ok(key)
    }

    /// Closes the shard and gives it its final name.
    ///
    /// # Errors
    /// [`PackError::Inconsistent`] where an episode is still open, [`PackError::Io`].
    pub fn finish(self) -> Result<()> {
        if let Some(open) = &self.open {
            return Err(PackError::inconsistent(
                self.file.path(),
                "the shard",
                "all episodes to be finished",
                format!("episode {} open", open.info.id),
            ));
        }
        self.data.attr("total", self.frames)?;
        self.data
            .attr_str("env_args", r#"{"env_name": "akrobat", "type": 2, "env_kwargs": {}}"#)?;
        drop(self.data);
        self.file.finish()
    }
}

fn no_episode(path: &Path) -> PackError {
    PackError::inconsistent(path, "a frame", "an episode to be begun", "none")
}

/// What every reader has to know, as attributes of the root.
const CONVENTIONS: [(&str, &str); 9] = [
    ("quat_order", "wxyz"),
    ("length_unit", "m"),
    ("angle_unit", "rad"),
    ("time_unit", "s"),
    ("world_frame", "right-handed, z up"),
    ("camera_frame", "OpenCV: x right, y down, z forward"),
    ("image_order", "RGB, row 0 at the top, pixel centres at integer + 0.5"),
    ("depth_kind", "z-depth along the optical axis; 0 is invalid"),
    (
        "action_semantics",
        "actions[t] is the absolute joint target that leads to obs[t+1]; the last repeats",
    ),
];

/// The datasets of one camera.
#[derive(Debug)]
struct CameraDatasets {
    images: Vec<(Modality, Dataset)>,
    /// Colours, where they are stored as image files.
    color_files: Option<EncodedImages>,
}

/// An episode between its first and last frame.
#[derive(Debug)]
struct OpenEpisode {
    info: EpisodeInfo,
    group: GroupWriter,
    camera_group: GroupWriter,
    cameras: Vec<CameraDatasets>,
    cloud: Option<Dataset>,
    cloud_normals: Option<Dataset>,
    storage: StorageConfig,
    series: Series,
    batch: Vec<Observation>,
}

impl OpenEpisode {
    fn create(
        group: GroupWriter,
        key: &str,
        info: EpisodeInfo,
        storage: &StorageConfig,
    ) -> Result<Self> {
        write_attributes(&group, &info)?;
        write_labels(&group.group("segment_labels")?, &info)?;
        let table = SegmentTable::new(&info.labels);
        write_names(&group.group("class_labels")?, &table.classes)?;
        write_names(&group.group("instance_labels")?, &table.instances)?;
        let obs = group.group("obs")?;
        let camera_group = group.group("camera_obs")?;
        let frames = info.frames as usize;
        let mut cameras = Vec::new();
        for camera in &info.rig.cameras {
            let size = [frames, camera.height as usize, camera.width as usize];
            let mut datasets = CameraDatasets { images: Vec::new(), color_files: None };
            for &modality in &info.modalities {
                let mut name = format!("{}_{}", camera.name, modality.name());
                match color::file_format(storage.color).filter(|_| modality == Modality::Rgb) {
                    None => {
                        let images = create_images(&camera_group, &name, modality, size, storage)?;
                        datasets.images.push((modality, images));
                    }
                    Some(format) => {
                        let size = [camera.height, camera.width];
                        let files =
                            EncodedImages::create(&camera_group, &camera.name, format, size)?;
                        datasets.color_files = Some(files);
                        name.push_str("_encoded");
                    }
                }
                obs.link(&format!("/data/{key}/camera_obs/{name}"), &name)?;
            }
            cameras.push(datasets);
        }
        let cloud = match info.cloud_points {
            0 => None,
            _ => Some(create_cloud(&group, &obs, key, &info, storage)?),
        };
        let cloud_normals = match info.cloud_points {
            points if points > 0 && info.cloud.normals => {
                let name = "point_cloud_normals";
                let (shape, chunk) = ([frames, points, 3], [1, points, 3]);
                let normals = group.chunked::<f32>(name, &shape, &chunk, storage.compression())?;
                group.dataset_attr_str(&normals, "frame", &info.cloud.frame)?;
                obs.link(&format!("/data/{key}/{name}"), name)?;
                Some(normals)
            }
            _ => None,
        };
        let series = Series::new(info.rig.cameras.len());
        drop(obs);
        let (storage, batch) = (storage.clone(), Vec::new());
        Ok(Self {
            info,
            group,
            camera_group,
            cameras,
            cloud,
            cloud_normals,
            storage,
            series,
            batch,
        })
    }

    fn push(&mut self, path: &Path, observation: Observation) -> Result<()> {
        check_observation(path, &self.info, self.series.len(), &observation)?;
        self.series.push(&observation);
        self.batch.push(observation);
        if self.batch.len() == FRAMES_PER_BATCH { self.write_batch(path) } else { Ok(()) }
    }

    fn write_batch(&mut self, path: &Path) -> Result<()> {
        let batch = std::mem::take(&mut self.batch);
        let first = self.series.len() - batch.len();
        let jobs: Vec<ChunkJob<'_>> =
            batch.iter().enumerate().flat_map(|(i, o)| self.jobs(first + i, o)).collect();
        let compression = self.storage.compression();
        let encoded: Vec<_> = jobs.par_iter().map(|job| job.encode(compression)).collect();
        for (job, chunk) in jobs.iter().zip(&encoded) {
            let mut offset = vec![0; job.dataset.ndim()];
            offset[0] = job.frame as u64;
            write_chunk(job.dataset, &offset, chunk)
                .map_err(|e| write_error(path, &job.dataset.name(), &e))?;
        }
        drop(jobs);
        self.write_color_files(path, &batch)
    }

    fn write_color_files(&mut self, path: &Path, batch: &[Observation]) -> Result<()> {
        let encoding = self.storage.color;
        for (index, camera) in self.cameras.iter_mut().enumerate() {
            let Some(files) = &mut camera.color_files else { continue };
            let name = &self.info.rig.cameras[index].name;
            let encoded: Vec<Vec<u8>> = batch
                .par_iter()
                .map(|observation| color::encode(&observation.cameras[index], encoding))
                .collect::<image::ImageResult<_>>()
                .map_err(|e| encoded::encode_error(path, name, &e))?;
            encoded.iter().try_for_each(|file| files.push(path, file))?;
        }
        Ok(())
    }

    fn jobs<'a>(&'a self, frame: usize, observation: &'a Observation) -> Vec<ChunkJob<'a>> {
        let depth = self.storage.depth;
        let images =
            self.cameras.iter().zip(&observation.cameras).flat_map(move |(datasets, images)| {
                datasets.images.iter().map(move |(modality, dataset)| {
                    let data = match modality {
                        Modality::Rgb => ChunkData::Bytes(&images.rgb),
                        Modality::Depth => ChunkData::Depth(images, depth),
                        Modality::Segmentation => ChunkData::Ids(&images.segmentation),
                        Modality::Instance => ChunkData::Ids(&images.instance),
                        Modality::Semantic => ChunkData::Ids(&images.semantic),
                        Modality::Normals => ChunkData::Floats(images.normals.as_flattened()),
                        Modality::Xyz => ChunkData::Floats(images.xyz.as_flattened()),
                        Modality::Flow => ChunkData::Floats(images.flow.as_flattened()),
                        Modality::SceneFlow => ChunkData::Floats(images.scene_flow.as_flattened()),
                    };
                    ChunkJob { dataset, frame, data }
                })
            });
        let cloud = self.cloud.iter().map(|dataset| {
            let data = match self.info.cloud.color {
                true => ChunkData::Floats(observation.cloud.as_flattened()),
                false => ChunkData::Positions(&observation.cloud),
            };
            ChunkJob { dataset, frame, data }
        });
        let normals = self.cloud_normals.iter().map(|dataset| ChunkJob {
            dataset,
            frame,
            data: ChunkData::Floats(observation.cloud_normals.as_flattened()),
        });
        images.chain(cloud).chain(normals).collect()
    }

    fn finish(mut self, path: &Path) -> Result<()> {
        if self.series.len() != self.info.frames as usize {
            return Err(PackError::inconsistent(
                path,
                format!("episode {}", self.info.id),
                format!("{} frames", self.info.frames),
                format!("{} frames", self.series.len()),
            ));
        }
        self.write_batch(path)?;
        write_series(&self.group, &self.info, &self.series)?;
        write_states(&self.group, &self.info, &self.series)?;
        for (camera, series) in self.info.rig.cameras.iter().zip(&self.series.cameras) {
            let frames = self.series.len();
            let intrinsics = format!("{}_intrinsics", camera.name);
            let dataset =
                self.camera_group.array(&intrinsics, &[frames, 3, 3], &series.intrinsics)?;
            let lens = &camera.distortion;
            self.camera_group.dataset_attr_str(&dataset, "distortion_model", lens.name())?;
            let coefficients = lens.coefficients();
            self.camera_group.dataset_attr_list(&dataset, "distortion", &coefficients)?;
            if camera.rate_hz.is_some() {
                let times: Vec<f64> =
                    series.captured.iter().map(|&frame| self.series.time_s[frame]).collect();
                let name = format!("{}_time", camera.name);
                let dataset = self.camera_group.array(&name, &[frames], &times)?;
                self.camera_group.dataset_attr_str(&dataset, "unit", "s")?;
            }
            let extrinsics = format!("{}_world_from_camera", camera.name);
            self.camera_group.array(&extrinsics, &[frames, 4, 4], &series.world_from_camera)?;
        }
        for (camera, datasets) in self.info.rig.cameras.iter().zip(self.cameras) {
            if let Some(files) = datasets.color_files {
                files.finish(path, &self.camera_group, &camera.name)?;
            }
        }
        Ok(())
    }
}

/// One chunk to encode and write.
struct ChunkJob<'a> {
    dataset: &'a Dataset,
    frame: usize,
    data: ChunkData<'a>,
}

/// What a chunk holds.
enum ChunkData<'a> {
    Bytes(&'a [u8]),
    Depth(&'a CameraFrame, DepthEncoding),
    Ids(&'a [u16]),
    Floats(&'a [f32]),
    /// The first three values of each point.
    Positions(&'a [CloudPoint]),
}

impl ChunkJob<'_> {
    fn encode(&self, compression: Compression) -> Vec<u8> {
        let encode = |raw: &[u8], element_size| compression.encode(raw, element_size);
        match &self.data {
            ChunkData::Bytes(bytes) => encode(bytes, 1),
            ChunkData::Depth(images, DepthEncoding::Millimetres) => {
                encode(&le_bytes(&images.depth_m, |d| millimetres(d).to_le_bytes()), 2)
            }
            ChunkData::Depth(images, DepthEncoding::Metres) => {
                encode(&le_bytes(&images.depth_m, |d| metres(d).to_le_bytes()), 4)
            }
            ChunkData::Ids(ids) => encode(&le_bytes(ids, u16::to_le_bytes), 2),
            ChunkData::Floats(values) => encode(&le_bytes(values, f32::to_le_bytes), 4),
            ChunkData::Positions(points) => {
                let positions: Vec<f32> = points.iter().flat_map(|p| &p[..3]).copied().collect();
                encode(&le_bytes(&positions, f32::to_le_bytes), 4)
            }
        }
    }
}

fn le_bytes<T: Copy, const N: usize>(values: &[T], bytes: impl Fn(T) -> [u8; N]) -> Vec<u8> {
    let mut encoded = vec![0; values.len() * N];
    for (place, &value) in encoded.as_chunks_mut::<N>().0.iter_mut().zip(values) {
        *place = bytes(value);
    }
    encoded
}

fn check_info(path: &Path, info: &EpisodeInfo) -> Result<()> {
    let item = || format!("episode {}", info.id);
    if info.finger_joints > info.robot_joints.len() {
        let expected = format!("at most {} finger joints", info.robot_joints.len());
        return Err(PackError::inconsistent(
            path,
            item(),
            expected,
            info.finger_joints.to_string(),
        ));
    }
    if info.robot_id.is_empty() || info.object_id.is_empty() || info.robot_id == info.object_id {
        let got = format!("robot {:?} and object {:?}", info.robot_id, info.object_id);
        return Err(PackError::inconsistent(path, item(), "two different names", got));
    }
    Ok(())
}

pub(crate) fn check_observation(
    path: &Path,
    info: &EpisodeInfo,
    frame: usize,
    observation: &Observation,
) -> Result<()> {
    let mut counts = vec![
        ("frame number".to_string(), frame, observation.frame as usize),
        ("cameras".into(), info.rig.cameras.len(), observation.cameras.len()),
        ("robot columns".into(), info.robot_joints.len(), observation.robot.len()),
        ("object columns".into(), info.object_joints.len(), observation.object.len()),
        ("cloud points".into(), info.cloud_points, observation.cloud.len()),
        (
            "cloud normals".into(),
            if info.cloud.normals { info.cloud_points } else { 0 },
            observation.cloud_normals.len(),
        ),
    ];
    for (camera, images) in info.rig.cameras.iter().zip(&observation.cameras) {
        let pixels = camera.width as usize * camera.height as usize;
        if camera.name != images.name {
            let item = format!("frame {frame} of episode {}: camera", info.id);
            return Err(PackError::inconsistent(path, item, &camera.name, &images.name));
        }
        for &modality in &info.modalities {
            let found = match modality {
                Modality::Rgb => images.rgb.len() / 3,
                Modality::Depth => images.depth_m.len(),
                Modality::Segmentation => images.segmentation.len(),
                Modality::Instance => images.instance.len(),
                Modality::Semantic => images.semantic.len(),
                Modality::Normals => images.normals.len(),
                Modality::Xyz => images.xyz.len(),
                Modality::Flow => images.flow.len(),
                Modality::SceneFlow => images.scene_flow.len(),
            };
            counts.push((format!("{} {} pixels", camera.name, modality.name()), pixels, found));
        }
    }
    for (what, expected, got) in counts {
        if expected != got {
            let item = format!("frame {frame} of episode {}: {what}", info.id);
            return Err(PackError::inconsistent(path, item, expected.to_string(), got.to_string()));
        }
    }
    if frame >= info.frames as usize {
        let item = format!("episode {}", info.id);
        return Err(PackError::inconsistent(path, item, format!("{} frames", info.frames), "more"));
    }
    Ok(())
}

fn create_images(
    group: &GroupWriter,
    name: &str,
    modality: Modality,
    [frames, height, width]: [usize; 3],
    storage: &StorageConfig,
) -> Result<Dataset> {
    let channels = modality.channels();
    let (shape, chunk) = ([frames, height, width, channels], [1, height, width, channels]);
    let compression = storage.compression();
    match modality {
        Modality::Rgb => group.chunked::<u8>(name, &shape, &chunk, compression),
        Modality::Depth => {
            let depth = match storage.depth {
                DepthEncoding::Millimetres => {
                    group.chunked::<u16>(name, &shape, &chunk, compression)
                }
                DepthEncoding::Metres => group.chunked::<f32>(name, &shape, &chunk, compression),
            }?;
            group.dataset_attr_str(&depth, "depth_unit", storage.depth.unit())?;
            group.dataset_attr(&depth, "depth_scale", storage.depth.scale())?;
            Ok(depth)
        }
        Modality::Segmentation | Modality::Instance | Modality::Semantic => {
            group.chunked::<u16>(name, &shape, &chunk, compression)
        }
        Modality::Normals | Modality::Xyz | Modality::Flow | Modality::SceneFlow => {
            let values = group.chunked::<f32>(name, &shape, &chunk, compression)?;
            let (unit, frame) = match modality {
                Modality::Normals => ("1", "world"),
                Modality::Flow => ("pixels to the next image", "image"),
                Modality::SceneFlow => ("m to the next image", "world"),
                _ => ("m", "world"),
            };
            group.dataset_attr_str(&values, "unit", unit)?;
            group.dataset_attr_str(&values, "frame", frame)?;
            Ok(values)
        }
    }
}

fn create_cloud(
    group: &GroupWriter,
    obs: &GroupWriter,
    key: &str,
    info: &EpisodeInfo,
    storage: &StorageConfig,
) -> Result<Dataset> {
    let (layout, points) = (&info.cloud, info.cloud_points);
    let columns = if layout.color { 6 } else { 3 };
    let shape = [info.frames as usize, points, columns];
    let (chunk, compression) = ([1, points, columns], storage.compression());
    let cloud = group.chunked::<f32>("point_cloud", &shape, &chunk, compression)?;
    let names = if layout.color { "x y z r g b" } else { "x y z" };
    group.dataset_attr_str(&cloud, "columns", names)?;
    group.dataset_attr_str(&cloud, "frame", &layout.frame)?;
    group.dataset_attr_str(&cloud, "sampling", &layout.sampling)?;
    group.dataset_attr_str(&cloud, "unit", "m; colours 0..255")?;
    obs.link(&format!("/data/{key}/point_cloud"), "point_cloud")?;
    Ok(cloud)
}

fn write_attributes(group: &GroupWriter, info: &EpisodeInfo) -> Result<()> {
    // Signed: robomimic subtracts from it.
    group.attr("num_samples", i64::from(info.frames))?;
    group.attr("success", info.success)?;
    group.attr("seed", info.seed)?;
    group.attr("traj_index", info.traj_index)?;
    group.attr("frame_rate_hz", info.frame_rate_hz)?;
    group.attr("grasp_id", info.grasp_id)?;
    group.attr_str("grasp_link", &info.grasp_link)?;
    group.attr_list("grasp_pose", &pose::to_xyz_wxyz(&info.link_from_tool))?;
    group.attr("start_angle", info.start)?;
    group.attr("goal_angle", info.goal)?;
    group.attr_str("active_joint", &info.active_joint)?;
    group.attr_str("episode_id", &info.id)?;
    group.attr_str("scene_id", &info.scene_id)?;
    group.attr_str("object_id", &info.object_id)?;
    group.attr_str("robot_id", &info.robot_id)?;
    let base_kind = toml::Value::try_from(info.base_kind).expect("a unit variant has a TOML form");
    group.attr_str("base_kind", base_kind.as_str().unwrap_or_default())?;
    group.attr_strings("robot_joints", &info.robot_joints)?;
    group.attr_strings("object_joints", &info.object_joints)?;
    group.attr("finger_joints", info.finger_joints as u64)?;
    let cameras: Vec<&str> = info.rig.cameras.iter().map(|c| c.name.as_str()).collect();
    group.attr_strings("cameras", &cameras)?;
    let modalities: Vec<&str> = info.modalities.iter().map(|m| m.name()).collect();
    group.attr_strings("modalities", &modalities)?;
    group.attr_str("task_toml", &info.task_toml)?;
    group.attr_str("rig_toml", &info.rig_toml())?;
    group.attr_str("provenance", &info.provenance.to_string())
}

fn write_labels(group: &GroupWriter, info: &EpisodeInfo) -> Result<()> {
    let labels = &info.labels;
    let ids: Vec<u16> = labels.iter().map(|l| l.id).collect();
    group.array("id", &[labels.len()], &ids)?;
    group.strings("group", &labels.iter().map(|l| &l.group).collect::<Vec<_>>())?;
    group.strings("name", &labels.iter().map(|l| &l.name).collect::<Vec<_>>())?;
    group.strings("class", &labels.iter().map(|l| &l.class).collect::<Vec<_>>())?;
    let table = SegmentTable::new(labels);
    let classes: Vec<u16> = ids.iter().map(|&id| table.class(id)).collect();
    let instances: Vec<u16> = ids.iter().map(|&id| table.instance(id)).collect();
    group.array("class_id", &[labels.len()], &classes)?;
    group.array("instance_id", &[labels.len()], &instances)?;
    Ok(())
}

/// Ids from 1 and their names.
fn write_names(group: &GroupWriter, names: &[String]) -> Result<()> {
    let ids: Vec<u16> = (1..).take(names.len()).collect();
    group.array("id", &[names.len()], &ids)?;
    group.strings("name", names)?;
    Ok(())
}

fn write_series(group: &GroupWriter, info: &EpisodeInfo, series: &Series) -> Result<()> {
    let (frames, columns) = (series.len(), info.robot_joints.len());
    let time = group.array("time", &[frames], &series.time_s)?;
    group.dataset_attr_str(&time, "unit", "s")?;
    let phase = group.array("phase", &[frames], &series.phase)?;
    group.dataset_attr_str(&phase, "names", &phase_names())?;
    let actions = targets(&series.robot, columns);
    group.array("actions", &[frames, columns], &actions)?;
    group.array("processed_actions", &[frames, columns], &actions)?;

    let obs = group.existing("obs")?;
    // The action that led to a frame is the target that is reached there.
    obs.array("actions", &[frames, columns], &series.robot)?;
    obs.array("joint_pos", &[frames, columns], &series.robot)?;
    let velocity = velocities(&series.time_s, &series.robot, columns);
    obs.array("joint_vel", &[frames, columns], &velocity)?;
    let fingers: Vec<f32> = series
        .robot
        .chunks(columns.max(1))
        .flat_map(|row| &row[columns - info.finger_joints..])
        .copied()
        .collect();
    obs.array("gripper_pos", &[frames, info.finger_joints], &fingers)?;
    let tool = pose_rows(&series.world_from_tool);
    let part = |from: usize, to: usize| -> Vec<f32> {
        tool.chunks(7).flat_map(|row| &row[from..to]).copied().collect()
    };
    let position = obs.array("eef_pos", &[frames, 3], &part(0, 3))?;
    let rotation = obs.array("eef_quat", &[frames, 4], &part(3, 7))?;
    let base = obs.array("base_pose", &[frames, 7], &pose_rows(&series.world_from_base))?;
    for dataset in [&position, &rotation, &base] {
        obs.dataset_attr_str(dataset, "frame", "world")?;
    }
    Ok(())
}

/// One articulation's rows over all frames.
struct Articulation<'a> {
    name: &'a str,
    columns: usize,
    positions: &'a [f32],
    world_from_root: &'a [Pose],
}

fn write_states(group: &GroupWriter, info: &EpisodeInfo, series: &Series) -> Result<()> {
    let robot_root = vec![info.world_from_robot_root; series.len()];
    let articulations = [
        Articulation {
            name: &info.robot_id,
            columns: info.robot_joints.len(),
            positions: &series.robot,
            world_from_root: &robot_root,
        },
        Articulation {
            name: &info.object_id,
            columns: info.object_joints.len(),
            positions: &series.object,
            world_from_root: &series.world_from_object,
        },
    ];
    let states = group.group("states")?.group("articulation")?;
    let initial = group.group("initial_state")?.group("articulation")?;
    for articulation in articulations {
        // A slash would open another group.
        let name = articulation.name.replace('/', "_");
        write_articulation(&states.group(&name)?, &articulation, &series.time_s, series.len())?;
        let rows = series.len().min(1);
        write_articulation(&initial.group(&name)?, &articulation, &series.time_s, rows)?;
    }
    Ok(())
}

/// Writes the first `rows` rows.
fn write_articulation(
    group: &GroupWriter,
    articulation: &Articulation<'_>,
    time_s: &[f64],
    rows: usize,
) -> Result<()> {
    let Articulation { columns, positions, world_from_root, .. } = *articulation;
    let velocity = velocities(time_s, positions, columns);
    let root_velocity = twists(time_s, world_from_root);
    group.array("joint_position", &[rows, columns], &positions[..rows * columns])?;
    group.array("joint_velocity", &[rows, columns], &velocity[..rows * columns])?;
    group.array("root_pose", &[rows, 7], &pose_rows(&world_from_root[..rows]))?;
    group.array("root_velocity", &[rows, 6], &root_velocity[..rows * 6])?;
    Ok(())
}
