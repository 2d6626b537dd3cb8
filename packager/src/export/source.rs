//! What is exported: the chosen episodes of a dataset, read frame by frame with every claim checked.

use std::path::PathBuf;

use akrobat_cameras::{CameraSpec, Distortion};
use akrobat_model::{Pose, pose};
use serde::Serialize;

use super::columns::{Motion, Table};
use super::config::{ExportConfig, Needs};
use crate::dataset::{Array, Container, DatasetReader, EpisodeReader, StoredEpisode, Values};
use crate::error::{PackError, Result};
use crate::h5::H5Reader;
use crate::whole_folder::confined;

/// Longest episode that is believed: nearly a day at 30 frames a second.
const MAX_FRAMES: usize = 1 << 21;

/// The episodes of a dataset that an export takes.
#[derive(Debug)]
pub struct Source {
    dataset: DatasetReader,
    config: ExportConfig,
    selected: Vec<Selected>,
    cameras: Vec<CameraSpec>,
}

#[derive(Debug)]
struct Selected {
    id: String,
    stored: StoredEpisode,
    path: PathBuf,
}

/// Positions, velocities and root of an articulation over `T` frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Articulation {
    /// Its name.
    pub name: String,
    /// Names of the joints.
    pub joints: Vec<String>,
    /// `[T, joints]`, rad or m.
    pub position: Vec<f32>,
    /// `[T, joints]`, rad/s or m/s.
    pub velocity: Vec<f32>,
    /// `[T, 7]`, `x y z qw qx qy qz` in the world.
    pub root_pose: Vec<f32>,
    /// `[T, 6]`, m/s and rad/s in the world.
    pub root_velocity: Vec<f32>,
}

/// Intrinsics and poses of a camera over `T` frames.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSeries {
    /// Name.
    pub name: String,
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// The lens.
    pub distortion: Distortion,
    /// K, `[T, 3, 3]`.
    pub intrinsics: Vec<f64>,
    /// `[T, 4, 4]`, OpenCV camera frame.
    pub world_from_camera: Vec<f64>,
}

/// What is known of an episode, in words and numbers.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EpisodeAttributes {
    /// Identity of the trajectory.
    pub id: String,
    /// Number of frames.
    pub frames: usize,
    /// Frames per second.
    pub frame_rate_hz: f64,
    /// Whether the judge accepted the trajectory.
    pub success: bool,
    /// Seed of the trajectory.
    pub seed: u64,
    /// Position of the trajectory in its file.
    pub traj_index: u32,
    /// Number of the grasp.
    pub grasp_id: u32,
    /// Object link that is held.
    pub grasp_link: String,
    /// Tool frame in that link, `x y z qw qx qy qz`.
    pub grasp_pose: Vec<f64>,
    /// Position of the driven joint at the start, rad or m.
    pub start: f64,
    /// Position of the driven joint to reach, rad or m.
    pub goal: f64,
    /// The driven joint.
    pub active_joint: String,
    /// Scene name.
    pub scene_id: String,
    /// Object name.
    pub object_id: String,
    /// Robot name.
    pub robot_id: String,
    /// Kind of the base: `holonomic`, `fixed`, `differential`.
    pub base_kind: String,
    /// Instruction in words.
    pub instruction: String,
    /// True where the episode is meant for validation.
    pub validation: bool,
}

/// An episode without its images and clouds.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// Position in the export, from 0.
    pub index: usize,
    /// What is known of it.
    pub attributes: EpisodeAttributes,
    /// Times `[T]`, seconds.
    pub time_s: Vec<f64>,
    /// Phases `[T]`, numbers as in [`akrobat_model::Phase`].
    pub phase: Vec<u8>,
    /// Actions as the configuration wants them.
    pub action: Table,
    /// States as the configuration wants them.
    pub state: Table,
    /// How many of the first robot joints are the base.
    pub base_joints: usize,
    /// How many of the last robot joints are fingers.
    pub finger_joints: usize,
    /// Absolute joint targets `[T, joints]`.
    pub target: Vec<f32>,
    /// The robot.
    pub robot: Articulation,
    /// The object.
    pub object: Articulation,
    /// Tool poses `[T, 7]`, `x y z qw qx qy qz` in the world.
    pub eef: Vec<f32>,
    /// Poses of the base link `[T, 7]`, `x y z qw qx qy qz` in the world.
    pub base: Vec<f32>,
    /// The cameras, in the order of the export.
    pub cameras: Vec<CameraSeries>,
    /// Points of each cloud; 0 where there are none.
    pub cloud_points: usize,
    /// The task file's text.
    pub task_toml: String,
}

impl Episode {
    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.time_s.len()
    }

    /// Mean position of the fingers `[T, fingers]`, as stored.
    pub fn fingers(&self, values: &[f32]) -> Vec<f32> {
        let columns = self.robot.joints.len();
        let rows = values.chunks(columns.max(1));
        rows.flat_map(|row| &row[columns - self.finger_joints..]).copied().collect()
    }
}

/// Depth as the dataset stores it.
#[derive(Debug, Clone, PartialEq)]
pub enum Depth {
    /// Millimetres, 0 where invalid.
    Millimetres(Vec<u16>),
    /// Metres, 0 where invalid.
    Metres(Vec<f32>),
}

impl Depth {
    /// In millimetres; 0 where invalid or beyond 65.535 m.
    pub fn millimetres(&self) -> Vec<u16> {
        match self {
            Self::Millimetres(values) => values.clone(),
            Self::Metres(values) => {
                values.iter().map(|&v| crate::episode::millimetres(v)).collect()
            }
        }
    }

    /// Some of the pixels.
    pub fn part(&self, pixels: std::ops::Range<usize>) -> Self {
        match self {
            Self::Millimetres(values) => Self::Millimetres(values[pixels].to_vec()),
            Self::Metres(values) => Self::Metres(values[pixels].to_vec()),
        }
    }

    /// In metres.
    pub fn metres(&self) -> Vec<f32> {
        match self {
            // The nearest single to the number of millimetres over 1000.
            Self::Millimetres(values) => {
                values.iter().map(|&v| (f64::from(v) / 1000.0) as f32).collect()
            }
            Self::Metres(values) => values.clone(),
        }
    }
}

/// Images of one camera for a few frames; empty where they were not asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraBatch {
    /// sRGB `[frames, height, width, 3]`.
    pub rgb: Vec<u8>,
    /// z-depth `[frames, height, width]`.
    pub depth: Depth,
    /// Segment ids `[frames, height, width]`.
    pub segmentation: Vec<u16>,
}

/// A few consecutive frames of an episode.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameBatch {
    /// Number of the first frame.
    pub first: usize,
    /// Number of frames.
    pub count: usize,
    /// The cameras, in the order of the export.
    pub cameras: Vec<CameraBatch>,
    /// Clouds `[frames, points, 6]`: metres in the world, colours 0..255.
    pub cloud: Vec<f32>,
}

impl Source {
    /// Chooses episodes of a dataset: those of `positions` among the stored ones (all where absent) that
    /// the configuration's robot made.
    ///
    /// # Errors
    /// [`PackError::Content`] where the dataset holds MCAP logs, names files elsewhere, or lacks what was
    /// asked for.
    pub fn open(
        dataset: DatasetReader,
        positions: Option<&[usize]>,
        config: &ExportConfig,
    ) -> Result<Self> {
        let folder = dataset.folder().to_path_buf();
        let manifest = folder.join(crate::dataset::manifest::MANIFEST);
        if dataset.config().container != Container::Hdf5 {
            let expected = "HDF5 shards (`akrobat render --format hdf5`)";
            return Err(PackError::content(&folder, "container", expected, "MCAP logs"));
        }
        let all: Vec<(String, StoredEpisode)> =
            dataset.episodes().map(|(id, stored)| (id.to_owned(), stored.clone())).collect();
        if let Some(&wrong) = positions.iter().copied().flatten().find(|&&p| p >= all.len()) {
            let expected = format!("0 to {}", all.len().saturating_sub(1));
            return Err(PackError::content(&manifest, "episode", expected, wrong.to_string()));
        }
        let wanted = |position: &usize| positions.is_none_or(|list| list.contains(position));
        let mut selected = Vec::new();
        for (_, (id, stored)) in all.iter().enumerate().filter(|(p, _)| wanted(p)) {
            if config.robot.as_ref().is_some_and(|robot| *robot != stored.robot_id) {
                continue;
            }
            check_key(&manifest, &stored.key)?;
            let path = confined(&folder, &stored.shard, &manifest)?;
            selected.push(Selected { id: id.clone(), stored: stored.clone(), path });
        }
        if selected.is_empty() {
            let robots: std::collections::BTreeSet<&str> =
                all.iter().map(|(_, stored)| stored.robot_id.as_str()).collect();
            let robots = robots.into_iter().collect::<Vec<_>>().join(", ");
            let expected = format!("stored episodes of the robot asked for; there are: {robots}");
            return Err(PackError::content(&manifest, "episodes", expected, "none"));
        }
        let cameras = chosen_cameras(&dataset, config)?;
        Ok(Self { dataset, config: config.clone(), selected, cameras })
    }

    /// The dataset.
    pub fn dataset(&self) -> &DatasetReader {
        &self.dataset
    }

    /// The cameras that are exported.
    pub fn cameras(&self) -> &[CameraSpec] {
        &self.cameras
    }

    /// Number of episodes.
    pub fn len(&self) -> usize {
        self.selected.len()
    }

    /// True without episodes, which [`Source::open`] refuses.
    pub fn is_empty(&self) -> bool {
        self.selected.is_empty()
    }

    /// Opens an episode and reads everything but images and clouds.
    ///
    /// # Errors
    /// As reading its arrays.
    pub fn episode(&self, index: usize) -> Result<(Episode, FrameReader)> {
        let Selected { id, stored, path } = &self.selected[index];
        let reader = EpisodeReader::open(path, &stored.key)?;
        let file = H5Reader::open(path)?;
        let opened = Opened { path, id, stored, reader: &reader, file: &file };
        let episode = opened.read(index, &self.config, &self.cameras)?;
        let shapes = opened.frame_shapes(&episode)?;
        Ok((episode, FrameReader { reader, path: path.clone(), shapes }))
    }
}

/// Keys name groups right below `data/`.
fn check_key(manifest: &std::path::Path, key: &str) -> Result<()> {
    let plain = !key.is_empty() && key.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    if plain {
        return Ok(());
    }
    Err(PackError::content(manifest, "key", "letters, digits and `_`", format!("{key:?}")))
}

/// The cameras asked for. Their names become names of files and groups.
fn chosen_cameras(dataset: &DatasetReader, config: &ExportConfig) -> Result<Vec<CameraSpec>> {
    let place = dataset.folder().join(crate::dataset::DESCRIPTION);
    let rig = &dataset.config().rig;
    rig.validate("rig").map_err(|e| PackError::damaged(&place, e.to_string()))?;
    if config.cameras.is_empty() {
        return Ok(rig.cameras.clone());
    }
    let chosen = config.cameras.iter().map(|name| {
        rig.cameras.iter().find(|camera| camera.name == *name).cloned().ok_or_else(|| {
            let names: Vec<&str> = rig.cameras.iter().map(|c| c.name.as_str()).collect();
            let expected = format!("one of {}", names.join(", "));
            PackError::content(&place, "camera", expected, format!("{name:?}"))
        })
    });
    chosen.collect()
}

/// An episode whose file is open.
struct Opened<'a> {
    path: &'a std::path::Path,
    id: &'a str,
    stored: &'a StoredEpisode,
    reader: &'a EpisodeReader,
    file: &'a H5Reader,
}

impl Opened<'_> {
    fn read(&self, index: usize, config: &ExportConfig, cameras: &[CameraSpec]) -> Result<Episode> {
        let frames = self.stored.frames as usize;
        if frames == 0 || frames > MAX_FRAMES {
            let expected = format!("1 to {MAX_FRAMES}");
            return Err(PackError::content(self.path, "frames", expected, frames.to_string()));
        }
        let group = self.file.group(&format!("data/{}", self.stored.key))?;
        let joints = self.reader.texts("robot_joints")?;
        let finger_joints = self.file.attr::<u64>(&group, "finger_joints")? as usize;
        let base_kind = self.reader.text("base_kind")?;
        let base_joints = if base_kind == "fixed" { 0 } else { 3 };
        if base_joints + finger_joints > joints.len() {
            let expected = format!("at least {} robot joints", base_joints + finger_joints);
            let got = joints.len().to_string();
            return Err(PackError::content(self.path, "robot_joints", expected, got));
        }
        let columns = joints.len();
        let time_s = self.f64s("time", &[frames])?;
        let target = self.f32s("actions", &[frames, columns])?;
        let robot = self.articulation(&self.stored.robot_id, joints)?;
        let object =
            self.articulation(&self.stored.object_id, self.reader.texts("object_joints")?)?;
        let eef = self.poses()?;
        let base = self.f32s("obs/base_pose", &[frames, 7])?;
        let world_from_tool = self.pose_list("obs/eef_pos and obs/eef_quat", &eef)?;
        let world_from_base = self.pose_list("obs/base_pose", &base)?;
        let motion = Motion {
            joints: &robot.joints,
            base_joints,
            finger_joints,
            time_s: &time_s,
            position: &robot.position,
            velocity: &robot.velocity,
            target: &target,
            world_from_tool: &world_from_tool,
            world_from_base: &world_from_base,
        };
        let (action, state) = (motion.actions(config), motion.states(config));
        let attributes = self.attributes(config, base_kind)?;
        let stored_points = self.cloud_points(frames)?;
        let cloud_points = match config.points.map(|points| points as usize) {
            None => stored_points,
            Some(points) if points <= stored_points => points,
            Some(points) => {
                let expected = format!("at most the {stored_points} points that are stored");
                return Err(PackError::content(self.path, "points", expected, points.to_string()));
            }
        };
        Ok(Episode {
            index,
            attributes,
            phase: self.u8s("phase", &[frames])?,
            time_s,
            action,
            state,
            base_joints,
            finger_joints,
            target,
            robot,
            object,
            eef,
            base,
            cameras: cameras.iter().map(|c| self.camera(c)).collect::<Result<_>>()?,
            cloud_points,
            task_toml: self.reader.text("task_toml")?,
        })
    }

    fn attributes(&self, config: &ExportConfig, base_kind: String) -> Result<EpisodeAttributes> {
        let group = self.file.group(&format!("data/{}", self.stored.key))?;
        let stored = self.stored;
        let grasp_pose = self.file.attr_list::<f64>(&group, "grasp_pose")?;
        if grasp_pose.len() != 7 {
            let got = format!("{} values", grasp_pose.len());
            return Err(PackError::content(self.path, "grasp_pose", "7 values", got));
        }
        let made = || instruction(&stored.object_id);
        Ok(EpisodeAttributes {
            id: self.id.to_owned(),
            frames: stored.frames as usize,
            frame_rate_hz: self.file.attr(&group, "frame_rate_hz")?,
            success: stored.success,
            seed: stored.seed,
            traj_index: stored.traj_index,
            grasp_id: stored.grasp_id,
            grasp_link: self.reader.text("grasp_link")?,
            grasp_pose,
            start: self.file.attr(&group, "start_angle")?,
            goal: stored.goal,
            active_joint: self.reader.text("active_joint")?,
            scene_id: stored.scene_id.clone(),
            object_id: stored.object_id.clone(),
            robot_id: stored.robot_id.clone(),
            base_kind,
            instruction: config.instruction.clone().unwrap_or_else(made),
            validation: is_validation(self.id, config.validation),
        })
    }

    fn articulation(&self, name: &str, joints: Vec<String>) -> Result<Articulation> {
        let frames = self.stored.frames as usize;
        let place = format!("states/articulation/{}", name.replace('/', "_"));
        let table = |kind: &str, columns| self.f32s(&format!("{place}/{kind}"), &[frames, columns]);
        Ok(Articulation {
            name: name.replace('/', "_"),
            position: table("joint_position", joints.len())?,
            velocity: table("joint_velocity", joints.len())?,
            root_pose: table("root_pose", 7)?,
            root_velocity: table("root_velocity", 6)?,
            joints,
        })
    }

    fn camera(&self, camera: &CameraSpec) -> Result<CameraSeries> {
        let (frames, name) = (self.stored.frames as usize, &camera.name);
        Ok(CameraSeries {
            name: name.clone(),
            width: camera.width as usize,
            height: camera.height as usize,
            distortion: camera.distortion,
            intrinsics: self.f64s(&format!("camera_obs/{name}_intrinsics"), &[frames, 3, 3])?,
            world_from_camera: self
                .f64s(&format!("camera_obs/{name}_world_from_camera"), &[frames, 4, 4])?,
        })
    }

    /// Rows `x y z qw qx qy qz` of the tool.
    fn poses(&self) -> Result<Vec<f32>> {
        let frames = self.stored.frames as usize;
        let position = self.f32s("obs/eef_pos", &[frames, 3])?;
        let rotation = self.f32s("obs/eef_quat", &[frames, 4])?;
        let rows = position.chunks(3).zip(rotation.chunks(4));
        Ok(rows.flat_map(|(p, q)| p.iter().chain(q)).copied().collect())
    }

    fn pose_list(&self, item: &str, rows: &[f32]) -> Result<Vec<Pose>> {
        let poses = rows.chunks(7).map(|row| pose_of_row(row).ok_or(row));
        poses.collect::<std::result::Result<_, _>>().map_err(|row| {
            PackError::content(self.path, item, "positions and quaternions", format!("{row:?}"))
        })
    }

    fn cloud_points(&self, frames: usize) -> Result<usize> {
        let place = format!("data/{}/point_cloud", self.stored.key);
        if self.file.root().link_exists(&place) {
            let shape = self.file.dataset(&place)?.shape();
            match shape[..] {
                [rows, points, 6] if rows == frames => Ok(points),
                _ => {
                    let expected = format!("shape [{frames}, points, 6]");
                    Err(PackError::content(self.path, place, expected, format!("{shape:?}")))
                }
            }
        } else {
            Ok(0)
        }
    }

    /// Checks the shapes of what is read frame by frame, so that no frame is larger than the rig says.
    fn frame_shapes(&self, episode: &Episode) -> Result<Shapes> {
        let frames = episode.frames();
        for camera in &episode.cameras {
            for (kind, channels) in [("rgb", 3), ("depth", 1), ("segmentation", 1)] {
                let place = format!("data/{}/camera_obs/{}_{kind}", self.stored.key, camera.name);
                let shape = self.file.dataset(&place)?.shape();
                if shape != [frames, camera.height, camera.width, channels] {
                    let expected =
                        format!("[{frames}, {}, {}, {channels}]", camera.height, camera.width);
                    return Err(PackError::content(
                        self.path,
                        place,
                        expected,
                        format!("{shape:?}"),
                    ));
                }
            }
        }
        let cameras =
            episode.cameras.iter().map(|c| (c.name.clone(), c.width * c.height)).collect();
        Ok(Shapes { frames, cameras, cloud_points: episode.cloud_points })
    }

    fn array(&self, name: &str, shape: &[usize]) -> Result<Values> {
        let array = self.reader.array(name)?;
        if array.shape == shape {
            return Ok(array.values);
        }
        let (expected, got) = (format!("shape {shape:?}"), format!("shape {:?}", array.shape));
        Err(PackError::content(self.path, name, expected, got))
    }

    fn f32s(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        match self.array(name, shape)? {
            Values::F32(values) => Ok(values),
            _ => Err(PackError::content(self.path, name, "f32 values", "another type")),
        }
    }

    fn f64s(&self, name: &str, shape: &[usize]) -> Result<Vec<f64>> {
        match self.array(name, shape)? {
            Values::F64(values) => Ok(values),
            _ => Err(PackError::content(self.path, name, "f64 values", "another type")),
        }
    }

    fn u8s(&self, name: &str, shape: &[usize]) -> Result<Vec<u8>> {
        match self.array(name, shape)? {
            Values::U8(values) => Ok(values),
            _ => Err(PackError::content(self.path, name, "u8 values", "another type")),
        }
    }
}

#[derive(Debug)]
struct Shapes {
    frames: usize,
    cameras: Vec<(String, usize)>,
    cloud_points: usize,
}

/// Reads images and clouds of one episode.
#[derive(Debug)]
pub struct FrameReader {
    reader: EpisodeReader,
    path: PathBuf,
    shapes: Shapes,
}

impl FrameReader {
    /// Up to `count` frames from `first` on; empty where there are none left.
    ///
    /// # Errors
    /// As reading the arrays.
    pub fn batch(&self, first: usize, count: usize, needs: Needs) -> Result<FrameBatch> {
        let frames = first..(first + count).min(self.shapes.frames);
        let mut cameras = Vec::new();
        for (name, pixels) in &self.shapes.cameras {
            cameras.push(self.camera(name, *pixels, frames.clone(), needs)?);
        }
        let mut cloud = Vec::new();
        if needs.cloud && self.shapes.cloud_points > 0 {
            for frame in frames.clone() {
                let array = self.reader.frame("point_cloud", frame)?;
                let Values::F32(values) = array.values else {
                    return Err(self.wrong_type("point_cloud"));
                };
                cloud.extend_from_slice(&values[..6 * self.shapes.cloud_points]);
            }
        }
        Ok(FrameBatch { first, count: frames.len(), cameras, cloud })
    }

    fn camera(
        &self,
        name: &str,
        pixels: usize,
        frames: std::ops::Range<usize>,
        needs: Needs,
    ) -> Result<CameraBatch> {
        let mut batch = CameraBatch {
            rgb: Vec::new(),
            depth: Depth::Millimetres(Vec::new()),
            segmentation: Vec::new(),
        };
        for frame in frames {
            if needs.rgb {
                let item = format!("camera_obs/{name}_rgb");
                match self.image(&item, frame, 3 * pixels)?.values {
                    Values::U8(values) => batch.rgb.extend(values),
                    _ => return Err(self.wrong_type(&item)),
                }
            }
            if needs.depth {
                let item = format!("camera_obs/{name}_depth");
                match (self.image(&item, frame, pixels)?.values, &mut batch.depth) {
                    (Values::U16(values), Depth::Millimetres(depth)) => depth.extend(values),
                    (Values::F32(values), Depth::Metres(depth)) => depth.extend(values),
                    (Values::F32(values), depth) => *depth = Depth::Metres(values),
                    _ => return Err(self.wrong_type(&item)),
                }
            }
            if needs.segmentation {
                let item = format!("camera_obs/{name}_segmentation");
                match self.image(&item, frame, pixels)?.values {
                    Values::U16(values) => batch.segmentation.extend(values),
                    _ => return Err(self.wrong_type(&item)),
                }
            }
        }
        Ok(batch)
    }

    fn image(&self, name: &str, frame: usize, values: usize) -> Result<Array> {
        let array = self.reader.frame(name, frame)?;
        let got: usize = array.shape.iter().product();
        if got == values {
            return Ok(array);
        }
        let expected = format!("{values} values a frame");
        Err(PackError::content(&self.path, name, expected, got.to_string()))
    }

    fn wrong_type(&self, name: &str) -> PackError {
        PackError::content(&self.path, name, "its documented type", "another type")
    }
}

/// A pose from `x y z qw qx qy qz` in single precision.
pub(crate) fn pose_of_row(row: &[f32]) -> Option<Pose> {
    let row: [f32; 7] = row.try_into().ok()?;
    pose::from_xyz_wxyz(row.map(f64::from))
}

/// `microwave_1001` -> "Open the microwave."
fn instruction(object_id: &str) -> String {
    let kept: Vec<&str> =
        object_id.split('_').filter(|part| !part.chars().all(|c| c.is_ascii_digit())).collect();
    let name = if kept.is_empty() { object_id.to_owned() } else { kept.join(" ") };
    format!("Open the {name}.")
}

/// Chooses by identity alone, so that a choice does not change as a dataset grows.
fn is_validation(id: &str, share: f64) -> bool {
    use sha2::Digest;
    let digest = sha2::Sha256::digest(id.as_bytes());
    let number = digest.iter().take(8).fold(0u64, |number, &byte| number << 8 | u64::from(byte));
    (number as f64) < share * 2f64.powi(64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instructions_name_the_object_alone() {
        assert_eq!(instruction("microwave_1001"), "Open the microwave.");
        assert_eq!(instruction("sektion_cabinet"), "Open the sektion cabinet.");
        assert_eq!(instruction("7221"), "Open the 7221.");
    }

    #[test]
    fn the_share_for_validation_is_about_what_was_asked_for() {
        let ids: Vec<String> = (0..1000).map(|i| format!("episode {i}")).collect();
        let count = |share| ids.iter().filter(|id| is_validation(id, share)).count();
        assert_eq!((count(0.0), count(1.0)), (0, 1000));
        assert!((70..130).contains(&count(0.1)));
        assert!(ids.iter().all(|id| !is_validation(id, 0.1) || is_validation(id, 0.2)));
    }

    #[test]
    fn millimetres_and_metres_agree() {
        let depth = Depth::Millimetres((0..=u16::MAX).collect());
        assert_eq!(Depth::Metres(depth.metres()).millimetres(), depth.millimetres());
    }
}
