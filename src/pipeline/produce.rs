//! A production run: plans the tasks of many generated scenes, resumable, with statistics.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use akrobat_model::events::Event;
use akrobat_model::{ModelError, load};
use akrobat_planner::Reuse;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::generate_scene::{SCENES_FILE, SceneEntry, SceneSet, SceneTask};
use super::plan::plan_reusing;
use super::yields::Yields;
use super::{Context, PlanRequest, folder_of};
use crate::Error;

const STAGE: &str = "tasks";
/// Bounds of the bins of confinement that yields are told for.
const BINS: [f64; 4] = [0.25, 0.5, 0.75, 1.0];

/// A production job (TOML). Paths are relative to the job file.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ProductionFile {
    /// Name for reports.
    pub name: String,
    /// Folder of scenes as `akrobat generate scene` and `akrobat generate variants` write it, or several.
    pub scenes: Folders,
    /// Folder of the trajectory files.
    pub output: PathBuf,
    /// Classes of objects to plan for; all where empty.
    #[serde(default)]
    pub classes: Vec<String>,
    /// Robots to plan for; all that the scenes have tasks for where empty.
    #[serde(default)]
    pub robots: Vec<String>,
    /// Trajectories of each task, at most.
    #[serde(default = "ten")]
    pub limit: usize,
    /// Scenes of each folder to plan in, at most; all where absent.
    #[serde(default)]
    pub scene_count: Option<usize>,
    /// Objects of each class, scene and robot to plan for, at most; all where absent.
    #[serde(default)]
    pub objects_per_class: Option<usize>,
}

/// A folder, or a list of folders.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum Folders {
    /// One.
    One(PathBuf),
    /// Several, whose scenes have different names.
    Several(Vec<PathBuf>),
}

impl Folders {
    fn as_slice(&self) -> &[PathBuf] {
        match self {
            Self::One(folder) => std::slice::from_ref(folder),
            Self::Several(folders) => folders,
        }
    }
}

fn ten() -> usize {
    10
}

/// What is to be done.
#[derive(Debug, Clone, Default)]
pub struct ProduceRequest {
    /// Job file.
    pub job: PathBuf,
    /// Folder of the trajectory files, instead of the job's.
    pub output: Option<PathBuf>,
    /// Number of scenes of each folder, instead of the job's.
    pub scene_count: Option<usize>,
    /// Number of objects of each class and scene, instead of the job's.
    pub objects_per_class: Option<usize>,
    /// No task is begun after this time, seconds.
    pub time_budget_s: Option<f64>,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// Number of threads; one for each core where absent.
    pub threads: Option<usize>,
}

/// What a task gave: the file beside its trajectories.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct Record {
    pub scene: String,
    #[serde(default)]
    pub confinement: Option<f64>,
    pub layout: String,
    pub class: String,
    pub robot: String,
    pub accepted: usize,
    pub seconds: f64,
    pub counts: BTreeMap<String, u64>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub error: Option<String>,
}

impl Record {
    /// What stopped trajectories of the task, or the task, with how often.
    pub fn reasons(&self) -> Vec<(String, u64)> {
        let stopped = |(name, _): &(&String, &u64)| {
            ["rejected", "failed", "refused"].iter().any(|word| name.contains(word))
        };
        let counts = self.counts.iter().filter(stopped);
        let mut reasons: Vec<_> = counts.map(|(name, count)| (name.clone(), *count)).collect();
        if self.error.is_some() {
            reasons.push(("task could not be planned".into(), 1));
        } else if self.accepted == 0 {
            reasons.push(("task without a trajectory".into(), 1));
        }
        reasons
    }

    /// The bin of confinement that its scene falls into.
    pub fn confinement_bin(&self) -> String {
        let Some(confinement) = self.confinement else { return "imported".into() };
        let bin = BINS.iter().position(|&high| confinement <= high).unwrap_or(BINS.len() - 1);
        let low = if bin == 0 { 0.0 } else { BINS[bin - 1] };
        format!("{low:.2} to {:.2}", BINS[bin])
    }
}

/// A task of the job.
#[derive(Debug, Clone, Copy)]
struct Job<'a> {
    /// Folder of the set that the scene is of.
    folder: &'a Path,
    scene: &'a SceneEntry,
    task: &'a SceneTask,
}

impl Job<'_> {
    fn file(&self) -> PathBuf {
        self.folder.join(&self.task.file)
    }
}

/// What the run has given so far, earlier runs of the job included.
#[derive(Debug, Clone, Default, Serialize)]
pub struct ProduceReport {
    /// Name of the job.
    pub name: String,
    /// Folder of the trajectory files.
    pub output: PathBuf,
    /// Tasks that were planned in this run.
    pub planned: usize,
    /// Tasks that earlier runs had planned.
    pub resumed: usize,
    /// Tasks that the time budget left.
    pub left: usize,
    /// What planning gave.
    #[serde(flatten)]
    pub yields: Yields,
}

impl ProduceReport {
    /// True where nothing is left.
    pub fn is_complete(&self) -> bool {
        self.left == 0
    }
}

/// Plans the tasks of a job that no earlier run has planned. Interrupted, it goes on where it was. Tasks that
/// could not be loaded or planned at all are tried again.
///
/// # Errors
/// Where the job, its scenes or a robot are wrong, the output cannot be written, or the user asks to stop.
pub fn produce(request: &ProduceRequest, context: &Context<'_>) -> Result<ProduceReport, Error> {
    let (job, sets) = read_job(request)?;
    let output =
        request.output.clone().unwrap_or_else(|| folder_of(&request.job).join(&job.output));
    let tasks = tasks(request, &job, &sets);
    if tasks.is_empty() {
        return Err(Error::Usage(format!(
            "{}: no task is left by its classes and robots; the scenes have classes {} and robots {}",
            request.job.display(),
            names(&counts(&sets, |set| &set.classes)),
            names(&counts(&sets, |set| &set.robots))
        )));
    }
    check_robots(request, &tasks, context)?;
    let budget = request.time_budget_s.map(Duration::from_secs_f64);
    let began = Instant::now();
    let reuse = Reuse::default();
    let mut report = ProduceReport {
        name: job.name.clone(),
        output: output.clone(),
        ..ProduceReport::default()
    };
    context.observer.event(&Event::StageStarted { stage: STAGE, total: Some(tasks.len() as u64) });
    for (index, task) in tasks.iter().enumerate() {
        let path = record_path(&output, task);
        let record = match read_record(&path)?.filter(|record| record.error.is_none()) {
            Some(record) => {
                report.resumed += 1;
                record
            }
            None if budget.is_some_and(|budget| began.elapsed() >= budget) => {
                report.left += 1;
                continue;
            }
            None => {
                report.planned += 1;
                let record = plan_one(request, &job, task, &path, context, &reuse)?;
                write_record(&path, &record)?;
                record
            }
        };
        report.yields.add(&record);
        context.observer.event(&Event::Progress { stage: STAGE, done: index as u64 + 1 });
    }
    let seconds = began.elapsed().as_secs_f64();
    context.observer.event(&Event::StageFinished { stage: STAGE, seconds });
    Ok(report)
}

/// A task of each robot is loaded before anything is planned: where its files are not found, no task of it can be
/// planned.
fn check_robots(
    request: &ProduceRequest,
    tasks: &[Job<'_>],
    context: &Context<'_>,
) -> Result<(), Error> {
    let search = context.asset_search(&request.assets)?;
    let mut seen = BTreeSet::new();
    for task in tasks {
        if seen.insert(&task.task.robot) {
            load::task(&task.file(), &search)?;
        }
    }
    Ok(())
}

fn names(counts: &BTreeMap<String, usize>) -> String {
    counts.keys().cloned().collect::<Vec<_>>().join(", ")
}

/// A set of scenes, with the folder that it is in.
type PlacedSet = (PathBuf, SceneSet);

/// Sums of what several sets count.
fn counts(
    sets: &[PlacedSet],
    of: fn(&SceneSet) -> &BTreeMap<String, usize>,
) -> BTreeMap<String, usize> {
    let mut sums = BTreeMap::new();
    for (name, count) in sets.iter().flat_map(|(_, set)| of(set)) {
        *sums.entry(name.clone()).or_default() += count;
    }
    sums
}

fn read_job(request: &ProduceRequest) -> Result<(ProductionFile, Vec<PlacedSet>), Error> {
    let text =
        std::fs::read_to_string(&request.job).map_err(|e| ModelError::read(&request.job, e))?;
    let job: ProductionFile = toml::from_str(&text)
        .map_err(|e| ModelError::invalid(&request.job, e.message().to_owned()))?;
    let base = folder_of(&request.job);
    let sets = job.scenes.as_slice().iter().map(|folder| read_set(&base.join(folder)));
    let sets = sets.collect::<Result<Vec<_>, _>>()?;
    let mut seen = BTreeSet::new();
    if let Some(twice) =
        sets.iter().flat_map(|(_, set)| &set.scenes).find(|scene| !seen.insert(&scene.name))
    {
        let message = format!("scenes: two scenes are called \"{}\"", twice.name);
        return Err(ModelError::invalid(&request.job, message).into());
    }
    for (what, asked, known) in [
        ("classes", &job.classes, counts(&sets, |set| &set.classes)),
        ("robots", &job.robots, counts(&sets, |set| &set.robots)),
    ] {
        if let Some(unknown) = asked.iter().find(|name| !known.contains_key(*name)) {
            let known = names(&known);
            let message = format!("{what}: unknown \"{unknown}\"; valid choices: {known}");
            return Err(ModelError::invalid(&request.job, message).into());
        }
    }
    Ok((job, sets))
}

fn read_set(folder: &Path) -> Result<PlacedSet, Error> {
    let path = folder.join(SCENES_FILE);
    let text = std::fs::read_to_string(&path).map_err(|e| ModelError::read(&path, e))?;
    let set = serde_json::from_str(&text).map_err(|e| ModelError::invalid(&path, e.to_string()))?;
    Ok((folder.to_path_buf(), set))
}

/// The tasks, one object of every scene first, so that a run that is cut short has seen all scenes. All robots
/// open an object in turn, since they share its distance fields.
fn tasks<'a>(
    request: &ProduceRequest,
    job: &ProductionFile,
    sets: &'a [PlacedSet],
) -> Vec<Job<'a>> {
    let scene_count = request.scene_count.or(job.scene_count);
    let chosen = sets.iter().flat_map(|(folder, set)| {
        let count = scene_count.unwrap_or(set.scenes.len()).min(set.scenes.len());
        // Spread over the set, whose confinement rises.
        (0..count).map(move |k| (folder, &set.scenes[k * set.scenes.len() / count.max(1)]))
    });
    let most = request.objects_per_class.or(job.objects_per_class);
    let mut tasks: Vec<_> = chosen
        .enumerate()
        .flat_map(|(place, (folder, scene))| {
            let mut rounds: BTreeMap<&str, usize> = BTreeMap::new();
            wanted(job, most, scene).into_iter().map(move |task| {
                let round = rounds.entry(&task.robot).or_default();
                *round += 1;
                ((*round, place), Job { folder, scene, task })
            })
        })
        .collect();
    tasks.sort_by_key(|(order, _)| *order);
    tasks.into_iter().map(|(_, task)| task).collect()
}

/// The tasks of a scene that a job asks for, with the first `most` objects of each class for each robot.
fn wanted<'a>(
    job: &ProductionFile,
    most: Option<usize>,
    scene: &'a SceneEntry,
) -> Vec<&'a SceneTask> {
    let mut counts: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    let tasks = scene.tasks.iter().filter(|task| {
        let count = counts.entry((&task.class, &task.robot)).or_default();
        *count += 1;
        (job.classes.is_empty() || job.classes.contains(&task.class))
            && (job.robots.is_empty() || job.robots.contains(&task.robot))
            && most.is_none_or(|most| *count <= most)
    });
    tasks.collect()
}

fn record_path(output: &Path, job: &Job<'_>) -> PathBuf {
    let stem = job.task.file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    output.join(&job.scene.name).join(format!("{stem}.json"))
}

pub(super) fn read_record(path: &Path) -> Result<Option<Record>, Error> {
    let Ok(text) = std::fs::read_to_string(path) else { return Ok(None) };
    let record =
        serde_json::from_str(&text).map_err(|e| ModelError::invalid(path, e.to_string()))?;
    Ok(Some(record))
}

fn write_record(path: &Path, record: &Record) -> Result<(), Error> {
    let text = serde_json::to_string_pretty(record).map_err(|e| Error::Failed(e.to_string()))?;
    let file = tempfile::Builder::new()
        .prefix(".akrobat-")
        .tempfile_in(folder_of(path))
        .map_err(|e| Error::write(path, &e))?;
    std::fs::write(file.path(), text + "\n").map_err(|e| Error::write(path, &e))?;
    file.as_file().sync_all().map_err(|e| Error::write(path, &e))?;
    file.persist(path).map_err(|e| Error::write(path, &e.error))?;
    Ok(())
}

/// Plans a task. What is wrong with one task does not end the run; that the user wants to stop does.
fn plan_one(
    request: &ProduceRequest,
    job: &ProductionFile,
    task: &Job<'_>,
    record_path: &Path,
    context: &Context<'_>,
    reuse: &Reuse,
) -> Result<Record, Error> {
    let folder = folder_of(record_path);
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, &e))?;
    let began = Instant::now();
    let planned = plan_reusing(
        &PlanRequest {
            task: task.file(),
            output: Some(record_path.with_extension("h5")),
            assets: request.assets.clone(),
            limit: Some(job.limit),
            threads: request.threads,
            ..PlanRequest::default()
        },
        context,
        reuse,
    );
    let (accepted, counts, error) = match planned {
        Ok(report) => (report.set.trajectories.len(), report.counts, None),
        Err(error @ Error::Interrupted(_)) => return Err(error),
        Err(error) => (0, BTreeMap::new(), Some(error.to_string())),
    };
    Ok(Record {
        scene: task.scene.name.clone(),
        confinement: task.scene.confinement,
        layout: task.scene.layout.clone(),
        class: task.task.class.clone(),
        robot: task.task.robot.clone(),
        accepted,
        seconds: began.elapsed().as_secs_f64(),
        counts,
        error,
    })
}
