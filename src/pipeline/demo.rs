//! Everything once, on built-in inputs: generate, plan, render, package, report.

use std::path::{Path, PathBuf};

use akrobat_assets::AssetError;
use akrobat_assets::demo::{self, DemoPaths};
use serde::{Deserialize, Serialize};

use super::{
    BackendChoice, Context, EpisodeFilter, Format, PlanRequest, RenderReport, RenderRequest,
    ReportRequest, plan, render, report,
};
use crate::Error;
use crate::report::{IndexEntry, ReportOptions, RunDetails, write_index};

/// Which robot acts in the demo.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum DemoRobotChoice {
    /// TIAGo where the Python package `example-robot-data` is installed, else the built-in robot.
    #[default]
    Auto,
    /// TIAGo, from the Python package `example-robot-data`.
    Tiago,
    /// The built-in robot of primitive shapes.
    Pillar,
}

/// What the demo does.
#[derive(Debug, Clone)]
pub struct DemoRequest {
    /// Folder of everything that is written: empty or new.
    pub output: PathBuf,
    /// Who acts.
    pub robot: DemoRobotChoice,
    /// Trajectories planned for each task.
    pub limit: usize,
    /// Episodes rendered for each task.
    pub episodes: usize,
    /// Seed of the kitchen and of the plans.
    pub seed: u64,
    /// Which renderer draws.
    pub backend: BackendChoice,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
}

/// What one task of the demo gave.
#[derive(Debug, Clone, Serialize)]
pub struct DemoTask {
    /// Task name.
    pub name: String,
    /// Trajectory file.
    pub trajectories: PathBuf,
    /// Number of accepted trajectories in it.
    pub accepted: usize,
    /// Wall time of planning, seconds.
    pub plan_seconds: f64,
    /// What rendering and packaging gave.
    pub rendered: RenderReport,
    /// The page about it.
    pub page: PathBuf,
}

/// What the demo gave.
#[derive(Debug, Clone, Serialize)]
pub struct DemoReport {
    /// The page to open.
    pub page: PathBuf,
    /// Its tasks.
    pub tasks: Vec<DemoTask>,
}

/// Runs the demo.
///
/// # Errors
/// Where the output cannot be written, TIAGo is asked for and not installed, a stage fails, or the user
/// asked to stop.
pub fn demo(request: &DemoRequest, context: &Context<'_>) -> Result<DemoReport, Error> {
    check_empty(&request.output)?;
    let robot_data = robot_data(request, context)?;
    let inputs = request.output.join("inputs");
    let paths = demo::write(&inputs, request.seed, robot_data.as_deref())?;
    let mut tasks = Vec::new();
    for task in chosen_tasks(&paths, robot_data.is_some()) {
        tasks.push(run_task(request, &paths, task, context)?);
    }
    let entries: Vec<IndexEntry> = tasks.iter().map(|task| entry(&request.output, task)).collect();
    let page = write_index(&request.output, "Akrobat demo", &entries)?;
    Ok(DemoReport { page, tasks })
}

/// The demo does not mix its files with others.
fn check_empty(output: &Path) -> Result<(), Error> {
    let Ok(mut entries) = std::fs::read_dir(output) else {
        if output.exists() {
            let message = format!("{}: cannot write: it is not a folder", output.display());
            return Err(Error::Usage(message));
        }
        return std::fs::create_dir_all(output).map_err(|e| Error::write(output, &e));
    };
    if entries.next().is_some() {
        return Err(Error::Usage(format!(
            "{}: the folder is not empty; choose another with -o, or remove it",
            output.display()
        )));
    }
    Ok(())
}

/// Folder of the robot descriptions that TIAGo comes from, where it is to act.
fn robot_data(request: &DemoRequest, context: &Context<'_>) -> Result<Option<PathBuf>, Error> {
    if request.robot == DemoRobotChoice::Pillar {
        return Ok(None);
    }
    let folders = context.asset_search(&request.assets)?.folders;
    let found = folders.into_iter().find(|f| f.join("robots/tiago_description").is_dir());
    if found.is_none() && request.robot == DemoRobotChoice::Tiago {
        return Err(Error::Usage(
            "TIAGo's description is not installed: `pip install example-robot-data`, or give its folder (the one that holds robots/tiago_description) with --assets; valid choices without it: auto, pillar".into(),
        ));
    }
    Ok(found)
}

fn chosen_tasks(paths: &DemoPaths, tiago: bool) -> Vec<&Path> {
    let suffix = if tiago { "_tiago" } else { "_pillar" };
    let stem =
        |path: &Path| path.file_stem().is_some_and(|s| s.to_string_lossy().ends_with(suffix));
    paths.tasks.iter().map(PathBuf::as_path).filter(|path| stem(path)).collect()
}

fn run_task(
    request: &DemoRequest,
    paths: &DemoPaths,
    task: &Path,
    context: &Context<'_>,
) -> Result<DemoTask, Error> {
    let name = task.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let folder = request.output.join(&name);
    std::fs::create_dir_all(&folder).map_err(|e| Error::write(&folder, &e))?;
    let assets = [&request.assets[..], &paths.search_folders].concat();
    let trajectories = folder.join("trajectories.h5");
    let planned = plan(
        &PlanRequest {
            task: task.to_path_buf(),
            output: Some(trajectories.clone()),
            assets: assets.clone(),
            limit: Some(request.limit),
            ..PlanRequest::default()
        },
        context,
    )?;
    let accepted = planned.set.trajectories.len();
    if accepted == 0 {
        return Err(Error::Failed(format!("{name}: the judge accepted no trajectory")));
    }
    let rendered = render(
        &RenderRequest {
            trajectories: trajectories.clone(),
            output: folder.join("dataset"),
            assets: assets.clone(),
            backend: request.backend,
            format: Format::Both,
            filter: EpisodeFilter {
                episodes: Some((0..request.episodes.min(accepted)).collect::<Vec<_>>().into()),
                ..EpisodeFilter::default()
            },
            ..RenderRequest::default()
        },
        context,
    )?;
    let files = report(
        &ReportRequest {
            trajectories: trajectories.clone(),
            output: folder,
            assets,
            backend: request.backend,
            options: ReportOptions {
                shown: request.episodes.min(accepted),
                ..ReportOptions::default()
            },
            run: Some(RunDetails::from(&planned)),
            ..ReportRequest::default()
        },
        context,
    )?;
    Ok(DemoTask {
        name,
        trajectories,
        accepted,
        plan_seconds: planned.stage_seconds.values().sum(),
        rendered,
        page: files.first().cloned().unwrap_or_default(),
    })
}

fn entry(output: &Path, task: &DemoTask) -> IndexEntry {
    let relative = |path: &Path| path.strip_prefix(output).unwrap_or(path).display().to_string();
    let folder = task.page.parent().unwrap_or(output);
    let preview = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|e| e == "gif"))
        .min();
    IndexEntry {
        name: task.name.clone(),
        link: relative(&task.page),
        picture: preview.map(|path| relative(&path)),
        summary: format!(
            "{} trajectories accepted in {:.0} s; {} episodes, {} images rendered and packaged in {:.0} s",
            task.accepted,
            task.plan_seconds,
            task.rendered.episodes,
            task.rendered.images,
            task.rendered.seconds
        ),
    }
}

impl From<AssetError> for Error {
    fn from(error: AssetError) -> Self {
        match error {
            AssetError::Dimension { .. } | AssetError::NotApplicable { .. } => {
                Self::Usage(error.to_string())
            }
            AssetError::Model(error) => Self::Input(error),
            AssetError::Occupied { .. } => Self::Usage(error.to_string()),
            AssetError::Write { path, source } => Self::write(&path, &source),
            _ => Self::Failed(error.to_string()),
        }
    }
}
