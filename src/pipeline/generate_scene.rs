//! Generated kitchens: many scenes with their tasks, statistics and a contact sheet.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use akrobat_assets::robot::DemoRobot;
use akrobat_assets::room::{self, GeneratedScene, TaskRobot};
use akrobat_model::events::Event;
use akrobat_model::hash;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::generate::written_whole;
use super::{Context, on_threads, overview};
use crate::Error;

const STAGE: &str = "scenes";
/// The list of all scenes and tasks, in the folder of a generated set.
pub const SCENES_FILE: &str = "scenes.json";

/// The scenes to be made.
#[derive(Debug, Clone)]
pub struct GenerateScenesRequest {
    /// Number of scenes.
    pub count: usize,
    /// Confinement of the first and the last scene, 0 for open .. 1 for confined; spread evenly between.
    pub confinement: [f64; 2],
    /// Seed of the first scene; the next ones follow.
    pub seed: u64,
    /// Robot files that tasks are written for; the built-in robot where empty.
    pub robots: Vec<PathBuf>,
    /// Draw each scene and a contact sheet.
    pub pictures: bool,
    /// Number of threads; one for each core where absent. The result does not depend on it.
    pub threads: Option<usize>,
    /// Folder to write: empty or new.
    pub output: PathBuf,
}

/// A task of a generated scene.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SceneTask {
    /// Task file, relative to the folder of the set.
    pub file: PathBuf,
    /// Class of its object.
    pub class: String,
    /// Robot.
    pub robot: String,
}

/// A generated scene.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SceneEntry {
    /// Name and folder.
    pub name: String,
    /// Seed.
    pub seed: u64,
    /// 0 for open .. 1 for confined; none of variants of imported scenes.
    #[serde(default)]
    pub confinement: Option<f64>,
    /// How the units stand, or the imported scene that this is a variant of.
    pub layout: String,
    /// Width of the aisle, metres; none of variants of imported scenes.
    #[serde(default)]
    pub aisle_m: Option<f64>,
    /// Share of the floor on which a disc of 0.4 m radius can stand.
    pub free_floor: f64,
    /// Number of bodies.
    pub bodies: usize,
    /// Attempts until every check passed.
    pub attempts: u64,
    /// Hash of its geometry.
    pub sha256: String,
    /// Its tasks.
    pub tasks: Vec<SceneTask>,
}

/// `scenes.json`, and what the command reports.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SceneSet {
    /// Folder as it was given.
    #[serde(skip)]
    pub output: PathBuf,
    /// The scenes.
    pub scenes: Vec<SceneEntry>,
    /// Number of scenes by layout.
    pub layouts: BTreeMap<String, usize>,
    /// Number of tasks by class of object.
    pub classes: BTreeMap<String, usize>,
    /// Number of tasks by robot.
    pub robots: BTreeMap<String, usize>,
    /// Mean share of free floor in the more open and in the more confined half.
    pub free_floor: [f64; 2],
    /// Wall time, seconds; not part of the file, which depends on the seed alone.
    #[serde(skip)]
    pub seconds: f64,
}

/// Makes scenes. Each has passed its checks: nothing intersects, its doors open, a robot reaches each target;
/// and no two are the same.
///
/// # Errors
/// Where a seed gives no scene, the output cannot be written, or the user asks to stop.
pub fn generate_scenes(
    request: &GenerateScenesRequest,
    context: &Context<'_>,
) -> Result<SceneSet, Error> {
    set_written_whole(&request.output, request.count, request.threads, |folder| {
        write_set(folder, request, context)
    })
}

/// Has a set of `count` scenes written into a folder, which is there only when the set is whole.
pub(super) fn set_written_whole(
    output: &Path,
    count: usize,
    threads: Option<usize>,
    write: impl Fn(&Path) -> Result<SceneSet, Error> + Send + Sync,
) -> Result<SceneSet, Error> {
    if count == 0 {
        return Err(Error::Usage("--count: expected at least 1, got 0".into()));
    }
    let began = Instant::now();
    let mut set = None;
    written_whole(output, |folder| {
        set = Some(on_threads(threads, || write(folder))?);
        Ok(())
    })?;
    let set = set.ok_or_else(|| Error::Failed("nothing was written".into()))?;
    Ok(SceneSet { output: output.to_path_buf(), seconds: began.elapsed().as_secs_f64(), ..set })
}

fn write_set(
    folder: &Path,
    request: &GenerateScenesRequest,
    context: &Context<'_>,
) -> Result<SceneSet, Error> {
    let robots = task_robots(folder, &request.robots)?;
    let observer = context.observer;
    let began = Instant::now();
    observer.event(&Event::StageStarted { stage: STAGE, total: Some(request.count as u64) });
    let done = AtomicU64::new(0);
    let one = |index: usize| -> Result<(SceneEntry, Option<image::RgbImage>), Error> {
        if observer.cancelled() {
            return Err(Error::Interrupted("nothing was written".into()));
        }
        let share = index as f64 / (request.count - 1).max(1) as f64;
        let [from, to] = request.confinement;
        let scene = room::generate(request.seed + index as u64, from + (to - from) * share)?;
        let entry = write_scene(folder, &format!("kitchen_{:04}", index + 1), &scene, &robots)?;
        let picture = match request.pictures {
            true => Some(overview::scene_picture(&folder.join(&entry.name).join("scene.glb"))?),
            false => None,
        };
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        observer.event(&Event::Progress { stage: STAGE, done });
        Ok((entry, picture))
    };
    let made: Vec<_> = (0..request.count).into_par_iter().map(one).collect::<Result<_, _>>()?;
    observer.event(&Event::StageFinished { stage: STAGE, seconds: began.elapsed().as_secs_f64() });
    let (scenes, pictures): (Vec<SceneEntry>, Vec<_>) = made.into_iter().unzip();
    check_distinct(&scenes)?;
    let pictures: Vec<image::RgbImage> = pictures.into_iter().flatten().collect();
    finish_set(folder, scenes, &pictures)
}

/// Writes what a folder of scenes says of itself: a contact sheet, where there are pictures, and `scenes.json`.
pub(super) fn finish_set(
    folder: &Path,
    scenes: Vec<SceneEntry>,
    pictures: &[image::RgbImage],
) -> Result<SceneSet, Error> {
    if !pictures.is_empty() {
        overview::write_sheet(&folder.join("contact_sheet.png"), pictures)?;
    }
    let set = statistics(scenes);
    let path = folder.join(SCENES_FILE);
    let text = serde_json::to_string_pretty(&set).map_err(|e| Error::Failed(e.to_string()))?;
    std::fs::write(&path, text + "\n").map_err(|e| Error::write(&path, &e))?;
    Ok(set)
}

/// The robots' names and files: those given by absolute path, the built-in one copied beside the scenes.
pub(super) fn task_robots(folder: &Path, given: &[PathBuf]) -> Result<Vec<TaskRobot>, Error> {
    if given.is_empty() {
        DemoRobot::Pillar.write(&folder.join("robots"))?;
        let file = "../../robots/pillar.toml".into();
        return Ok(vec![TaskRobot { name: "pillar".into(), file }]);
    }
    let robot = |file: &PathBuf| {
        let whole = file.canonicalize().map_err(|e| akrobat_model::ModelError::read(file, e))?;
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Ok(TaskRobot { name, file: whole.display().to_string() })
    };
    given.iter().map(robot).collect()
}

fn write_scene(
    folder: &Path,
    name: &str,
    scene: &GeneratedScene,
    robots: &[TaskRobot],
) -> Result<SceneEntry, Error> {
    let tasks = scene.write(&folder.join(name), name, robots)?;
    let task = |(file, class, robot): (String, akrobat_assets::object::ObjectClass, String)| {
        SceneTask { file: Path::new(name).join(file), class: class.name().into(), robot }
    };
    let layout = serde_json::to_value(scene.layout).unwrap_or_default();
    Ok(SceneEntry {
        name: name.into(),
        seed: scene.seed,
        confinement: Some(rounded(scene.confinement)),
        layout: layout.as_str().unwrap_or_default().into(),
        aisle_m: Some(rounded(scene.aisle_m)),
        free_floor: rounded(scene.free_floor),
        bodies: scene.bodies.len(),
        attempts: scene.attempts,
        sha256: hash::of_file(&folder.join(name).join("scene.glb"))?,
        tasks: tasks.into_iter().map(task).collect(),
    })
}

pub(super) fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

pub(super) fn check_distinct(scenes: &[SceneEntry]) -> Result<(), Error> {
    let mut seen = HashSet::new();
    match scenes.iter().find(|scene| !seen.insert(&scene.sha256)) {
        Some(scene) => Err(Error::Failed(format!("{} repeats another scene", scene.name))),
        None => Ok(()),
    }
}

fn statistics(scenes: Vec<SceneEntry>) -> SceneSet {
    let mut layouts = BTreeMap::new();
    let (mut classes, mut robots) = (BTreeMap::new(), BTreeMap::new());
    for scene in &scenes {
        *layouts.entry(scene.layout.clone()).or_default() += 1;
        for task in &scene.tasks {
            *classes.entry(task.class.clone()).or_default() += 1;
            *robots.entry(task.robot.clone()).or_default() += 1;
        }
    }
    // Imported scenes have no stated confinement: what is free orders them.
    let order = |scene: &SceneEntry| scene.confinement.unwrap_or(-scene.free_floor);
    let middle = scenes.iter().map(order).sum::<f64>() / scenes.len().max(1) as f64;
    let mean = |confined: bool| {
        let in_half = |s: &&SceneEntry| (order(s) > middle) == confined;
        // Equally confined scenes, or a single one, are their own other half.
        let both = !scenes.iter().any(|s| in_half(&s));
        let half = scenes.iter().filter(|s| both || in_half(s));
        let shares: Vec<f64> = half.map(|s| s.free_floor).collect();
        rounded(shares.iter().sum::<f64>() / shares.len().max(1) as f64)
    };
    let free_floor = [mean(false), mean(true)];
    SceneSet { output: PathBuf::new(), scenes, layouts, classes, robots, free_floor, seconds: 0.0 }
}
