//! Task file -> judged trajectories -> trajectory file.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};

use akrobat_judge::{Judge, JudgeConfig, RobotSphere};
use akrobat_model::events::Event;
use akrobat_model::load;
use akrobat_model::task::Task;
use akrobat_model::{ModelError, TrajectorySet};
use akrobat_packager::trajectory_file;
use akrobat_planner::plan::Explanation;
use akrobat_planner::spheres::SphereFit;
use akrobat_planner::world::World;
use akrobat_planner::{Backend, Optimiser, PlanError, PlannerConfig, Preparation, Reuse};

use super::{Context, check_writable, folder_of, on_threads};
use crate::Error;

/// Where batches are computed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum PlanBackend {
    /// `wgpu` where there is a graphics processor, else `cpu`.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// The graphics processor, or a software Vulkan driver.
    Wgpu,
}

impl PlanBackend {
    fn open(self) -> Result<Backend, Error> {
        let opened = match self {
            Self::Auto => Backend::auto(),
            Self::Cpu => Ok(Backend::Cpu),
            Self::Wgpu => Backend::wgpu(),
        };
        opened.map_err(|error| Error::Failed(format!("{error}; `--backend cpu` needs no adapter")))
    }
}

/// What is to be planned.
#[derive(Debug, Clone, Default)]
pub struct PlanRequest {
    /// Task file.
    pub task: PathBuf,
    /// Trajectory file to write; none where the trajectories are only wanted in memory.
    pub output: Option<PathBuf>,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// Replaces the task's seed.
    pub seed: Option<u64>,
    /// Replaces the task's limit on the number of trajectories.
    pub limit: Option<usize>,
    /// Number of threads; one for each core where absent. The result does not depend on it.
    pub threads: Option<usize>,
    /// Find out what stops each stage as well.
    pub explain: bool,
    /// Where inverse kinematics and trajectory optimisation are computed.
    pub backend: PlanBackend,
    /// Replaces the task's way of optimising.
    pub optimiser: Option<Optimiser>,
}

/// What planning gave.
#[derive(Debug, Clone)]
pub struct PlanReport {
    /// The accepted trajectories. The task's folder is absolute here, and relative in the file.
    pub set: TrajectorySet,
    /// What computed the batches.
    pub backend: String,
    /// Counts by stage, and by reason of failure or rejection.
    pub counts: BTreeMap<String, u64>,
    /// Wall time by stage, seconds.
    pub stage_seconds: BTreeMap<String, f64>,
    /// Durations of each step of each pair of start and goal, seconds of one thread.
    pub step_seconds: BTreeMap<String, Vec<f64>>,
    /// What stops each stage, where it was asked for.
    pub explanation: Option<Explanation>,
    /// How well the collision spheres stand for each link.
    pub sphere_fits: Vec<SphereFit>,
    /// Repairs made while loading, contacts that are tolerated, details of rejections.
    pub notes: Vec<String>,
}

/// Plans a task, judges each trajectory, and writes the accepted ones. Nothing is written where none
/// is accepted.
///
/// # Errors
/// Where the task is wrong, the output cannot be written, or the user asked to stop.
pub fn plan(request: &PlanRequest, context: &Context<'_>) -> Result<PlanReport, Error> {
    plan_reusing(request, context, &Reuse::default())
}

/// [`plan()`], with what is kept from other tasks.
///
/// # Errors
/// As for [`plan()`].
pub fn plan_reusing(
    request: &PlanRequest,
    context: &Context<'_>,
    reuse: &Reuse,
) -> Result<PlanReport, Error> {
    if let Some(output) = &request.output {
        check_writable(output)?;
    }
    let search = context.asset_search(&request.assets)?;
    let (task, config) = load_task(request, &search)?;
    let backend = request.backend.open()?;
    for note in task.object.notes.iter().chain(&task.scene.notes) {
        context.observer.event(&Event::Warning { message: note });
    }
    let observer = context.observer;
    let mut report = on_threads(request.threads, || {
        plan_task(&backend, &task, &config, request.explain, observer, reuse)
    })?;
    if let (Some(output), false) = (&request.output, report.set.trajectories.is_empty()) {
        report.set.header.task_dir = relative_folder(folder_of(output), folder_of(&request.task))?;
        trajectory_file::write(output, &report.set)?;
    }
    report.set.header.task_dir = absolute(folder_of(&request.task))?.display().to_string();
    Ok(report)
}

fn load_task(
    request: &PlanRequest,
    search: &load::AssetSearch,
) -> Result<(Task, PlannerConfig), Error> {
    let mut task = load::task(&request.task, search)?;
    task.file.seed = request.seed.unwrap_or(task.file.seed);
    let mut config: PlannerConfig =
        task.file.planner.clone().try_into().map_err(|e: toml::de::Error| {
            ModelError::invalid(&request.task, format!("[planner]: {}", e.message()))
        })?;
    config.limit = request.limit.unwrap_or(config.limit);
    config.optimiser = request.optimiser.unwrap_or(config.optimiser);
    if let Err(message) = config.check() {
        return Err(ModelError::invalid(&request.task, format!("[planner]: {message}")).into());
    }
    Ok((task, config))
}

fn plan_task(
    backend: &Backend,
    task: &Task,
    config: &PlannerConfig,
    explain: bool,
    observer: &dyn akrobat_model::events::Observer,
    reuse: &Reuse,
) -> Result<PlanReport, Error> {
    let began = std::time::Instant::now();
    let (prepared, world) =
        rayon::join(|| prepare(task, reuse), || World::reusing(task, config, reuse));
    let ((preparation, judge), prepared_s) = (prepared?, began.elapsed().as_secs_f64());
    let judge_one = |trajectory: &_| judge.judge(trajectory);
    let mut outcome = akrobat_planner::plan_on(
        backend,
        task,
        &preparation,
        &world,
        config,
        observer,
        &judge_one,
    )?;
    outcome.stage_seconds.insert("spheres, distance field and judge".into(), prepared_s);
    let explanation = explain
        .then(|| akrobat_planner::plan::explain(task, &preparation, &world, config, observer))
        .transpose()?;
    let loaded = task.object.notes.iter().chain(&task.scene.notes);
    Ok(PlanReport {
        set: outcome.set,
        backend: backend.to_string(),
        counts: outcome.counts,
        stage_seconds: outcome.stage_seconds,
        step_seconds: outcome.step_seconds,
        explanation,
        sphere_fits: preparation.spheres.fits,
        notes: loaded.chain(judge.notes()).chain(&outcome.notes).cloned().collect(),
    })
}

/// Spheres and masks of the robot, and who judges what is planned with them.
fn prepare(task: &Task, reuse: &Reuse) -> Result<(Preparation, Judge), Error> {
    let preparation = Preparation::reusing(task, reuse)?;
    let spheres: Vec<RobotSphere> = preparation
        .spheres
        .spheres
        .iter()
        .map(|s| RobotSphere { link: s.link, center: s.center, radius: s.radius })
        .collect();
    let judge = Judge::new(task, &spheres, &preparation.exceptions, JudgeConfig::default())?;
    Ok((preparation, judge))
}

impl From<PlanError> for Error {
    fn from(error: PlanError) -> Self {
        match error {
            PlanError::Model(error) => Self::Input(error),
            PlanError::Cancelled => Self::Interrupted("nothing was written".into()),
            PlanError::DifferentialBase { .. } => Self::Usage(error.to_string()),
            PlanError::Device(error) => Self::Failed(error.to_string()),
        }
    }
}

pub(super) fn absolute(folder: &Path) -> Result<PathBuf, Error> {
    Ok(folder.canonicalize().map_err(|e| ModelError::read(folder, e))?)
}

/// Path from one folder to another, so that trajectory and task can move together.
pub(super) fn relative_folder(from: &Path, to: &Path) -> Result<String, Error> {
    let (from, to) = (absolute(from)?, absolute(to)?);
    let shared = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    let up = from.components().skip(shared).map(|_| Component::ParentDir);
    let path: PathBuf = up.chain(to.components().skip(shared)).collect();
    Ok(if path == Path::new("") { ".".into() } else { path.display().to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_relative_to_one_another() {
        let root = tempfile::tempdir().unwrap();
        let (a, b) = (root.path().join("a/x"), root.path().join("b"));
        std::fs::create_dir_all(&a).unwrap();
        std::fs::create_dir_all(&b).unwrap();
        assert_eq!(relative_folder(&a, &b).unwrap(), "../../b");
        assert_eq!(relative_folder(root.path(), &a).unwrap(), "a/x");
        assert_eq!(relative_folder(&a, &a).unwrap(), ".");
        assert!(relative_folder(&a, &root.path().join("none")).is_err());
    }
}
