//! A production run: plans the tasks of many generated scenes, resumable, with statistics.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use akrobat_model::ModelError;
use akrobat_model::events::Event;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::generate_scene::{SCENES_FILE, SceneEntry, SceneSet, SceneTask};
use super::{Context, PlanRequest, folder_of, plan};
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
    /// Folder of generated scenes.
    pub scenes: PathBuf,
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
    /// Scenes to plan in, at most; all where absent.
    #[serde(default)]
    pub scene_count: Option<usize>,
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
    /// Number of scenes, instead of the job's.
    pub scene_count: Option<usize>,
    /// No task is begun after this time, seconds.
    pub time_budget_s: Option<f64>,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// Number of threads; one for each core where absent.
    pub threads: Option<usize>,
}

/// What a task gave: the file beside its trajectories.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct Record {
    scene: String,
    confinement: f64,
    layout: String,
    class: String,
    robot: String,
    accepted: usize,
    seconds: f64,
    counts: BTreeMap<String, u64>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    error: Option<String>,
}

/// Sums over tasks.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Yield {
    /// Tasks planned.
    pub tasks: usize,
    /// Those of which a trajectory was accepted.
    pub solved: usize,
    /// Accepted trajectories.
    pub accepted: usize,
    /// Wall time of planning, seconds.
    pub seconds: f64,
}

impl Yield {
    fn add(&mut self, record: &Record) {
        self.tasks += 1;
        self.solved += usize::from(record.accepted > 0);
        self.accepted += record.accepted;
        self.seconds += record.seconds;
    }

    /// Accepted trajectories an hour.
    pub fn per_hour(&self) -> f64 {
        if self.seconds > 0.0 { self.accepted as f64 * 3600.0 / self.seconds } else { 0.0 }
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
    /// All of them.
    pub total: Yield,
    /// By confinement, from open to confined.
    pub by_confinement: BTreeMap<String, Yield>,
    /// By arrangement of the units.
    pub by_layout: BTreeMap<String, Yield>,
    /// By class of object.
    pub by_class: BTreeMap<String, Yield>,
    /// By robot.
    pub by_robot: BTreeMap<String, Yield>,
    /// What stopped trajectories and tasks, with how often.
    pub reasons: BTreeMap<String, u64>,
}

impl ProduceReport {
    /// True where nothing is left.
    pub fn is_complete(&self) -> bool {
        self.left == 0
    }
}

/// Plans the tasks of a job that no earlier run has planned. Interrupted, it goes on where it was.
///
/// # Errors
/// Where the job or its scenes are wrong, the output cannot be written, or the user asks to stop.
pub fn produce(request: &ProduceRequest, context: &Context<'_>) -> Result<ProduceReport, Error> {
    let (job, set) = load(request)?;
    let folder = folder_of(&request.job);
    let scenes = folder.join(&job.scenes);
    let output = request.output.clone().unwrap_or_else(|| folder.join(&job.output));
    let tasks = tasks(&job, &set, request.scene_count.or(job.scene_count));
    if tasks.is_empty() {
        return Err(Error::Usage(format!(
            "{}: no task is left by its classes and robots; the scenes have classes {} and robots {}",
            request.job.display(),
            names(&set.classes),
            names(&set.robots)
        )));
    }
    let budget = request.time_budget_s.map(Duration::from_secs_f64);
    let began = Instant::now();
    let mut report = ProduceReport {
        name: job.name.clone(),
        output: output.clone(),
        ..ProduceReport::default()
    };
    context.observer.event(&Event::StageStarted { stage: STAGE, total: Some(tasks.len() as u64) });
    for (index, (scene, task)) in tasks.iter().enumerate() {
        let path = record_path(&output, scene, task);
        let record = match read_record(&path)? {
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
                let record = plan_one(request, &job, &scenes, scene, task, &path, context)?;
                write_record(&path, &record)?;
                record
            }
        };
        report.add(&record);
        context.observer.event(&Event::Progress { stage: STAGE, done: index as u64 + 1 });
    }
    let seconds = began.elapsed().as_secs_f64();
    context.observer.event(&Event::StageFinished { stage: STAGE, seconds });
    Ok(report)
}

fn names(counts: &BTreeMap<String, usize>) -> String {
    counts.keys().cloned().collect::<Vec<_>>().join(", ")
}

fn load(request: &ProduceRequest) -> Result<(ProductionFile, SceneSet), Error> {
    let text =
        std::fs::read_to_string(&request.job).map_err(|e| ModelError::read(&request.job, e))?;
    let job: ProductionFile = toml::from_str(&text)
        .map_err(|e| ModelError::invalid(&request.job, e.message().to_owned()))?;
    let path = folder_of(&request.job).join(&job.scenes).join(SCENES_FILE);
    let text = std::fs::read_to_string(&path).map_err(|e| ModelError::read(&path, e))?;
    let set: SceneSet =
        serde_json::from_str(&text).map_err(|e| ModelError::invalid(&path, e.to_string()))?;
    for (what, asked, known) in
        [("classes", &job.classes, &set.classes), ("robots", &job.robots, &set.robots)]
    {
        if let Some(unknown) = asked.iter().find(|name| !known.contains_key(*name)) {
            let message = format!("{what}: unknown \"{unknown}\"; valid choices: {}", names(known));
            return Err(ModelError::invalid(&request.job, message).into());
        }
    }
    Ok((job, set))
}

/// The tasks, one of every scene first, so that a run that is cut short has seen all scenes.
fn tasks<'a>(
    job: &ProductionFile,
    set: &'a SceneSet,
    scene_count: Option<usize>,
) -> Vec<(&'a SceneEntry, &'a SceneTask)> {
    let wanted = |task: &&SceneTask| {
        (job.classes.is_empty() || job.classes.contains(&task.class))
            && (job.robots.is_empty() || job.robots.contains(&task.robot))
    };
    let count = scene_count.unwrap_or(set.scenes.len()).min(set.scenes.len());
    // Spread over the set, whose confinement rises.
    let chosen = (0..count).map(|k| &set.scenes[k * set.scenes.len() / count.max(1)]);
    let mut tasks: Vec<_> = chosen
        .enumerate()
        .flat_map(|(place, scene)| {
            let of_scene = scene.tasks.iter().filter(wanted).enumerate();
            of_scene.map(move |(round, task)| ((round, place), (scene, task))).collect::<Vec<_>>()
        })
        .collect();
    tasks.sort_by_key(|(order, _)| *order);
    tasks.into_iter().map(|(_, task)| task).collect()
}

fn record_path(output: &Path, scene: &SceneEntry, task: &SceneTask) -> PathBuf {
    let stem = task.file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    output.join(&scene.name).join(format!("{stem}.json"))
}

fn read_record(path: &Path) -> Result<Option<Record>, Error> {
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
    scenes: &Path,
    scene: &SceneEntry,
    task: &SceneTask,
    record_path: &Path,
    context: &Context<'_>,
) -> Result<Record, Error> {
    let folder = folder_of(record_path);
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, &e))?;
    let began = Instant::now();
    let planned = plan(
        &PlanRequest {
            task: scenes.join(&task.file),
            output: Some(record_path.with_extension("h5")),
            assets: request.assets.clone(),
            limit: Some(job.limit),
            threads: request.threads,
            ..PlanRequest::default()
        },
        context,
    );
    let (accepted, counts, error) = match planned {
        Ok(report) => (report.set.trajectories.len(), report.counts, None),
        Err(error @ Error::Interrupted(_)) => return Err(error),
        Err(error) => (0, BTreeMap::new(), Some(error.to_string())),
    };
    Ok(Record {
        scene: scene.name.clone(),
        confinement: scene.confinement,
        layout: scene.layout.clone(),
        class: task.class.clone(),
        robot: task.robot.clone(),
        accepted,
        seconds: began.elapsed().as_secs_f64(),
        counts,
        error,
    })
}

impl ProduceReport {
    fn add(&mut self, record: &Record) {
        let bin =
            BINS.iter().position(|&high| record.confinement <= high).unwrap_or(BINS.len() - 1);
        let low = if bin == 0 { 0.0 } else { BINS[bin - 1] };
        let confinement = format!("{low:.2} to {:.2}", BINS[bin]);
        self.total.add(record);
        for (sums, key) in [
            (&mut self.by_confinement, &confinement),
            (&mut self.by_layout, &record.layout),
            (&mut self.by_class, &record.class),
            (&mut self.by_robot, &record.robot),
        ] {
            sums.entry(key.clone()).or_default().add(record);
        }
        let reasons = record.counts.iter().filter(|(name, _)| {
            ["rejected", "failed", "refused"].iter().any(|word| name.contains(word))
        });
        for (name, count) in reasons {
            *self.reasons.entry(name.clone()).or_default() += count;
        }
        if record.error.is_some() {
            *self.reasons.entry("task could not be planned".into()).or_default() += 1;
        } else if record.accepted == 0 {
            *self.reasons.entry("task without a trajectory".into()).or_default() += 1;
        }
    }
}
