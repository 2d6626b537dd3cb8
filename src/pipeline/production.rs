//! What a folder of trajectory files holds: counts, where bases stood, how far things were opened, how much starts
//! differ. Files are read one at a time and only sums are kept.

use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, HashSet};
use std::hash::{Hash as _, Hasher as _};
use std::path::{Path, PathBuf};

use akrobat_cameras::Rig;
use akrobat_model::events::Event;
use akrobat_model::robot::BaseKind;
use akrobat_model::{Pose, Trajectory, TrajectorySet};
use akrobat_packager::trajectory_file;
use akrobat_renderer::pointcloud::CloudConfig;
use akrobat_renderer::{Backend, EpisodeConfig, EpisodeRenderer};
use image::RgbImage;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use serde::Serialize;

use super::produce::{Record, read_record};
use super::render::{BackendChoice, Source, load_rig, open_backend};
use super::{Context, Yields};
use crate::Error;
use crate::report::picture;

const STAGE: &str = "files";
/// Edge of the cells in which bases are counted, metres.
pub const CELL_M: f64 = 0.1;
/// Sectors that base headings are counted in.
const SECTORS: usize = 12;
/// Bins of a histogram of openings.
const BINS: usize = 12;
/// Starts count as different where a joint differs by this much, rad or m.
const SAME_START: f64 = 1e-3;

/// The folder in question.
#[derive(Debug, Clone, Default)]
pub struct ProductionRequest {
    /// Folder of trajectory files, as `akrobat produce` writes it; also of folders of them.
    pub folder: PathBuf,
    /// Trajectories to draw, spread over the files.
    pub pictures: usize,
    /// Cameras of the pictures; `paper` where absent.
    pub rig: Option<String>,
    /// Which renderer draws.
    pub backend: BackendChoice,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
}

/// What a folder of trajectory files holds.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Production {
    /// The folder.
    pub folder: PathBuf,
    /// Trajectory files.
    pub files: usize,
    /// Trajectories in them.
    pub trajectories: usize,
    /// Those that the judge accepted.
    pub accepted: usize,
    /// Motion in them, seconds.
    pub motion_s: f64,
    /// What planning gave and took, where it is known.
    #[serde(flatten)]
    pub yields: Yields,
    /// How far things were opened, by class of object.
    pub openings: BTreeMap<String, Opening>,
    /// Where bases stood when they took hold, by robot.
    pub bases: BTreeMap<String, BaseCoverage>,
    /// How much starts differ, by robot.
    pub starts: BTreeMap<String, StartDiversity>,
    /// Trajectories that should have been drawn and could not, and why.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub not_drawn: Vec<String>,
}

/// How far things were opened, rad (hinges) or m (drawers).
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Opening {
    /// Trajectories.
    pub trajectories: usize,
    /// Smallest, mean and largest opening.
    pub least: f64,
    /// Mean opening.
    pub mean: f64,
    /// Largest opening.
    pub most: f64,
    /// Openings, in steps of [`Opening::step`] from 0.
    pub histogram: Vec<usize>,
    /// Width of a bin.
    pub step: f64,
    #[serde(skip)]
    values: Vec<f32>,
}

/// Where bases stood when they took hold, in the object's frame: x to its front, y to its left.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct BaseCoverage {
    /// Trajectories counted: those of a moving base and an object with a stated pose.
    pub trajectories: usize,
    /// Edge of a cell, metres.
    pub cell_m: f64,
    /// Cells with a base in them.
    pub cells: usize,
    /// Cells that as many bases spread evenly over would be as uncertain: exp of the entropy.
    pub effective_cells: f64,
    /// Share of 30-degree sectors of heading that occur.
    pub headings: f64,
    /// Smallest and largest distance from the object's root, metres.
    pub distance_m: [f64; 2],
    /// Bases by cell, `[x, y, count]`, in cells from the object's root.
    pub heat: Vec<[i64; 3]>,
}

/// How much the states differ that trajectories start in.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct StartDiversity {
    /// Trajectories.
    pub trajectories: usize,
    /// Start states of robot and base that differ by more than 1e-3 rad or m.
    pub starts: usize,
    /// States in which objects are grasped that differ by as much.
    pub grasped: usize,
    /// Grasps of an object that differ, summed over objects.
    pub grasps: usize,
    /// Standard deviation of each joint where objects are grasped, by name.
    pub deviation: BTreeMap<String, f64>,
}

/// A picture of a trajectory.
#[derive(Debug, Clone)]
pub struct Shot {
    /// What it shows.
    pub caption: String,
    /// The picture.
    pub picture: RgbImage,
}

/// True where a folder holds trajectory files and is no dataset.
pub fn is_production(folder: &Path) -> bool {
    !folder.join(akrobat_packager::dataset::MANIFEST).exists()
        && !folder.join("dataset.json").exists()
        && files_below(folder).is_ok_and(|files| !files.is_empty())
}

/// Trajectory files in a folder and those below it, sorted.
///
/// # Errors
/// Where a folder cannot be read.
pub fn files_below(folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let mut files = Vec::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(next) = open.pop() {
        let entries =
            std::fs::read_dir(&next).map_err(|e| akrobat_model::ModelError::read(&next, e))?;
        for path in entries.flatten().map(|entry| entry.path()) {
            let is_hidden =
                path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
            if path.is_dir() && !is_hidden {
                open.push(path);
            } else if path.extension().is_some_and(|e| e == "h5") && !is_hidden {
                files.push(path);
            }
        }
    }
    files.sort();
    Ok(files)
}

/// Looks through a folder of trajectory files, and draws some of them.
///
/// # Errors
/// Where a file cannot be read or drawn, or the user asks to stop.
pub fn production(
    request: &ProductionRequest,
    context: &Context<'_>,
) -> Result<(Production, Vec<Shot>), Error> {
    let files = files_below(&request.folder)?;
    if files.is_empty() {
        let folder = request.folder.display();
        return Err(Error::Usage(format!("{folder}: no trajectory file in it or below")));
    }
    let began = std::time::Instant::now();
    context.observer.event(&Event::StageStarted { stage: STAGE, total: Some(files.len() as u64) });
    let mut sums = Sums::default();
    for (index, file) in files.iter().enumerate() {
        if context.observer.cancelled() {
            return Err(Error::Interrupted("nothing was written".into()));
        }
        let set = trajectory_file::read(file)?;
        sums.add(file, &set)?;
        context.observer.event(&Event::Progress { stage: STAGE, done: index as u64 + 1 });
    }
    let seconds = began.elapsed().as_secs_f64();
    context.observer.event(&Event::StageFinished { stage: STAGE, seconds });
    sums.add_fruitless(&request.folder)?;
    let mut production = sums.finish(&request.folder, files.len());
    let shots = shots(request, &files, &mut production.not_drawn, context)?;
    Ok((production, shots))
}

#[derive(Default)]
struct Sums {
    production: Production,
    heat: BTreeMap<String, Heat>,
    starts: BTreeMap<String, Starts>,
}

#[derive(Default)]
struct Heat {
    cells: BTreeMap<[i64; 2], i64>,
    sectors: [bool; SECTORS],
    distance_m: Option<[f64; 2]>,
    count: usize,
}

#[derive(Default)]
struct Starts {
    names: Vec<String>,
    starts: HashSet<u64>,
    grasped: HashSet<u64>,
    grasps: HashSet<u64>,
    count: usize,
    /// Running mean and sum of squared deviations of each joint (Welford 1962).
    mean: Vec<f64>,
    squares: Vec<f64>,
}

impl Sums {
    fn add(&mut self, file: &Path, set: &TrajectorySet) -> Result<(), Error> {
        let record = match read_record(&file.with_extension("json"))? {
            Some(record) => record,
            None => record_of(set),
        };
        self.production.trajectories += set.trajectories.len();
        self.production.yields.add(&record);
        let world_from_object = object_pose(set);
        for trajectory in &set.trajectories {
            let accepted = trajectory.verdict.as_ref().is_some_and(|v| v.accepted());
            self.production.accepted += usize::from(accepted);
            self.production.motion_s += trajectory.dense.duration_s();
            let opening = self.production.openings.entry(record.class.clone());
            let opening = opening.or_insert_with(Opening::empty);
            opening.values.push((trajectory.goal - trajectory.start).abs() as f32);
            self.starts.entry(record.robot.clone()).or_default().add(set, trajectory);
            if let (BaseKind::Holonomic, Some(pose)) = (set.header.base_kind, &world_from_object) {
                self.heat.entry(record.robot.clone()).or_default().add(trajectory, pose);
            }
        }
        Ok(())
    }

    /// Tasks without a trajectory file have left a record alone.
    fn add_fruitless(&mut self, folder: &Path) -> Result<(), Error> {
        let mut open = vec![folder.to_path_buf()];
        while let Some(next) = open.pop() {
            let Ok(entries) = std::fs::read_dir(&next) else { continue };
            for path in entries.flatten().map(|entry| entry.path()) {
                if path.is_dir() {
                    open.push(path);
                } else if path.extension().is_some_and(|e| e == "json")
                    && !path.with_extension("h5").exists()
                    && let Some(record) = read_record(&path)?
                {
                    self.production.yields.add(&record);
                }
            }
        }
        Ok(())
    }

    fn finish(mut self, folder: &Path, files: usize) -> Production {
        self.production.openings.values_mut().for_each(Opening::finish);
        Production {
            folder: folder.to_path_buf(),
            files,
            bases: self.heat.into_iter().map(|(robot, heat)| (robot, heat.finish())).collect(),
            starts: self.starts.into_iter().map(|(robot, s)| (robot, s.finish())).collect(),
            ..self.production
        }
    }
}

/// What is known of a trajectory file without the record of a production.
fn record_of(set: &TrajectorySet) -> Record {
    let header = &set.header;
    let number = |tail: &str| tail.chars().all(|c| c.is_ascii_digit());
    let class = header.object_id.rsplit_once('_').filter(|(_, tail)| number(tail));
    let accepted = |t: &&Trajectory| t.verdict.as_ref().is_some_and(|v| v.accepted());
    Record {
        scene: header.scene_id.clone(),
        confinement: None,
        layout: "imported".into(),
        class: class.map_or(header.object_id.clone(), |(class, _)| class.to_owned()),
        robot: header.robot_id.clone(),
        accepted: set.trajectories.iter().filter(accepted).count(),
        seconds: 0.0,
        counts: header.counts.clone(),
        error: None,
    }
}

/// Where the object stands, as its task says.
fn object_pose(set: &TrajectorySet) -> Option<Pose> {
    let task: toml::Value = toml::from_str(&set.header.task_toml).ok()?;
    let pose = task.get("object")?.get("pose")?.as_array()?;
    let number = |value: &toml::Value| {
        value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
    };
    let [x, y, z, qw, qx, qy, qz]: [f64; 7] =
        pose.iter().filter_map(number).collect::<Vec<_>>().try_into().ok()?;
    let turn = UnitQuaternion::try_new(Quaternion::new(qw, qx, qy, qz), 1e-9)?;
    Some(Pose::from_parts(Vector3::new(x, y, z).into(), turn))
}

impl Heat {
    fn add(&mut self, trajectory: &Trajectory, world_from_object: &Pose) {
        if trajectory.waypoints_robot.rows() == 0 {
            return;
        }
        let row = trajectory.waypoints_robot.row(0);
        let [x, y, yaw] = [row[0], row[1], row[2]].map(f64::from);
        let at = world_from_object.inverse() * nalgebra::Point3::new(x, y, 0.0);
        let front = world_from_object.rotation * Vector3::x();
        let heading = (yaw - front.y.atan2(front.x)).rem_euclid(std::f64::consts::TAU);
        let cell = [at.x, at.y].map(|value| (value / CELL_M).floor() as i64);
        *self.cells.entry(cell).or_default() += 1;
        let sector = (heading / std::f64::consts::TAU * SECTORS as f64) as usize;
        self.sectors[sector.min(SECTORS - 1)] = true;
        let distance = at.x.hypot(at.y);
        let [near, far] = self.distance_m.unwrap_or([distance; 2]);
        self.distance_m = Some([near.min(distance), far.max(distance)]);
        self.count += 1;
    }

    fn finish(self) -> BaseCoverage {
        let all = self.count.max(1) as f64;
        let entropy: f64 = self
            .cells
            .values()
            .map(|&count| count as f64 / all)
            .map(|share| -share * share.ln())
            .sum();
        let sectors = self.sectors.iter().filter(|&&seen| seen).count();
        BaseCoverage {
            trajectories: self.count,
            cell_m: CELL_M,
            cells: self.cells.len(),
            effective_cells: entropy.exp(),
            headings: sectors as f64 / SECTORS as f64,
            distance_m: self.distance_m.unwrap_or_default(),
            heat: self.cells.into_iter().map(|([x, y], count)| [x, y, count]).collect(),
        }
    }
}

impl Starts {
    fn add(&mut self, set: &TrajectorySet, trajectory: &Trajectory) {
        if trajectory.waypoints_robot.rows() == 0 || trajectory.dense.robot.rows() == 0 {
            return;
        }
        let row = trajectory.waypoints_robot.row(0);
        if self.names.is_empty() {
            self.names = set.header.robot_joints.clone();
            self.mean = vec![0.0; row.len()];
            self.squares = vec![0.0; row.len()];
        }
        self.count += 1;
        self.starts.insert(fingerprint(trajectory.dense.robot.row(0), ""));
        self.grasped.insert(fingerprint(row, ""));
        let object = format!("{} {}", set.header.scene_id, set.header.object_id);
        let mut grasp = DefaultHasher::new();
        (&object, trajectory.grasp.id).hash(&mut grasp);
        self.grasps.insert(grasp.finish());
        for ((value, mean), squares) in row.iter().zip(&mut self.mean).zip(&mut self.squares) {
            let before = f64::from(*value) - *mean;
            *mean += before / self.count as f64;
            *squares += before * (f64::from(*value) - *mean);
        }
    }

    fn finish(self) -> StartDiversity {
        let count = self.count.max(1) as f64;
        let deviation = self.squares.iter().map(|squares| (squares / count).sqrt());
        StartDiversity {
            trajectories: self.count,
            starts: self.starts.len(),
            grasped: self.grasped.len(),
            grasps: self.grasps.len(),
            deviation: self.names.into_iter().zip(deviation).collect(),
        }
    }
}

fn fingerprint(row: &[f32], salt: &str) -> u64 {
    let mut hasher = DefaultHasher::new();
    salt.hash(&mut hasher);
    for value in row {
        ((f64::from(*value) / SAME_START).round() as i64).hash(&mut hasher);
    }
    hasher.finish()
}

impl Opening {
    fn empty() -> Self {
        Self {
            trajectories: 0,
            least: 0.0,
            mean: 0.0,
            most: 0.0,
            histogram: Vec::new(),
            step: 0.0,
            values: Vec::new(),
        }
    }

    fn finish(&mut self) {
        let values = std::mem::take(&mut self.values);
        let all = values.iter().copied().map(f64::from);
        self.trajectories = values.len();
        self.least = all.clone().fold(f64::INFINITY, f64::min);
        self.most = all.clone().fold(0.0, f64::max);
        self.mean = all.clone().sum::<f64>() / values.len().max(1) as f64;
        self.step = (self.most / BINS as f64).max(1e-6);
        self.histogram = vec![0; BINS];
        for value in all {
            self.histogram[((value / self.step) as usize).min(BINS - 1)] += 1;
        }
    }
}

/// One trajectory of every few files, at the end of its manipulation.
fn shots(
    request: &ProductionRequest,
    files: &[PathBuf],
    not_drawn: &mut Vec<String>,
    context: &Context<'_>,
) -> Result<Vec<Shot>, Error> {
    if request.pictures == 0 {
        return Ok(Vec::new());
    }
    let rig = load_rig(request.rig.as_deref().unwrap_or("paper"))?;
    let rig = Rig { cameras: rig.cameras.into_iter().take(1).collect(), ..rig };
    let mut backend = open_backend(request.backend, context)?;
    let count = request.pictures.min(files.len());
    let mut shots = Vec::new();
    for index in 0..count {
        let file = &files[index * files.len() / count];
        match shot(file, &rig, request, backend.as_mut(), context) {
            Ok(shot) => shots.extend(shot),
            Err(error @ Error::Interrupted(_)) => return Err(error),
            // The counts hold without it.
            Err(error) => not_drawn.push(error.to_string()),
        }
    }
    Ok(shots)
}

/// The first trajectory of a file; none where there is none.
fn shot(
    file: &Path,
    rig: &Rig,
    request: &ProductionRequest,
    backend: &mut dyn Backend,
    context: &Context<'_>,
) -> Result<Option<Shot>, Error> {
    let set = trajectory_file::read(file)?;
    if set.trajectories.is_empty() {
        return Ok(None);
    }
    let source = Source::load(file, set, &request.assets, context)?;
    let cloud = CloudConfig { points: 0, ..CloudConfig::default() };
    let config = EpisodeConfig { cloud, ..EpisodeConfig::default() };
    let renderer = EpisodeRenderer::new(&source.task, &source.scene, rig, config);
    let episode = renderer.episode(&source.set.trajectories[0])?;
    let observation = episode.observe(episode.frame_count() * 9 / 10, backend)?;
    let header = &source.set.header;
    let caption = format!("{}: {} by {}", header.scene_id, header.object_id, header.robot_id);
    let picture = observation.cameras.first().map(picture::color);
    Ok(picture.map(|picture| Shot { caption, picture }))
}
