//! Trajectory file -> page to look at.

use std::path::PathBuf;

use akrobat_model::load;
use akrobat_model::task::Task;
use akrobat_packager::trajectory_file;
use akrobat_planner::spheres;

use super::BackendChoice;
use super::Context;
use super::render::{check_unchanged, load_rig, open_backend, task_path};
use crate::Error;
use crate::report::{self, ReportInput, ReportOptions, RunDetails};

/// What is to be shown.
#[derive(Debug, Clone, Default)]
pub struct ReportRequest {
    /// Trajectory file.
    pub trajectories: PathBuf,
    /// Folder to write.
    pub output: PathBuf,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// Which renderer draws.
    pub backend: BackendChoice,
    /// A rig preset's name or a rig file; `paper` where absent.
    pub rig: Option<String>,
    /// How much is shown.
    pub options: ReportOptions,
    /// What is known of the planning run besides its file; what the task alone tells, where absent.
    pub run: Option<RunDetails>,
}

/// Writes the page of a trajectory file. Returns the files written, the page first.
///
/// # Errors
/// Where the trajectories, the rig or the assets are wrong, a device or the disk fails, or the user
/// asked to stop.
pub fn report(request: &ReportRequest, context: &Context<'_>) -> Result<Vec<PathBuf>, Error> {
    let set = trajectory_file::read(&request.trajectories)?;
    let search = context.asset_search(&request.assets)?;
    let task_path = task_path(&request.trajectories, &set);
    let task = load::task_from_text(set.header.task_toml.clone(), &task_path, &search)?;
    check_unchanged(&request.trajectories, &set, &task)?;
    let rig = load_rig(request.rig.as_deref().unwrap_or("paper"))?;
    let mut backend = open_backend(request.backend, context)?;
    let run = match &request.run {
        Some(run) => run.clone(),
        None => known_again(&task)?,
    };
    let input = ReportInput { task: &task, set: &set, rig: &rig, run: Some(&run) };
    let (folder, options) = (&request.output, &request.options);
    report::write(folder, &input, options, backend.as_mut(), context.observer)
}

/// What follows from the task alone, so that it need not be kept: how well the spheres fit, and what
/// loading noted.
fn known_again(task: &Task) -> Result<RunDetails, Error> {
    let robot = &task.robot;
    let spheres = spheres::of_robot(robot, robot.spheres_path.as_deref())?;
    let notes = robot.notes.iter().chain(&task.object.notes).chain(&task.scene.notes);
    Ok(RunDetails {
        sphere_fits: spheres.fits,
        notes: notes.cloned().collect(),
        ..RunDetails::default()
    })
}
