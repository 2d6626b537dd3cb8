//! Trajectory files together with the task that they were planned for.

use std::path::Path;

use akrobat_model::TrajectorySet;
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::Task;
use akrobat_packager::trajectory_file;

use super::render::{check_unchanged, task_path};
use crate::Error;

/// Reads a trajectory file and loads its task from the inputs that were planned with.
///
/// # Errors
/// Where the file cannot be read, or its inputs cannot be found or have changed.
pub fn planned_task(
    trajectories: &Path,
    search: &AssetSearch,
) -> Result<(TrajectorySet, Task), Error> {
    let set = trajectory_file::read(trajectories)?;
    let task_path = task_path(trajectories, &set);
    let task = load::task_from_text(set.header.task_toml.clone(), &task_path, search)?;
    check_unchanged(trajectories, &set, &task)?;
    Ok((set, task))
}

/// The wanted positions in a trajectory file of `count`; all where nothing is said.
///
/// # Errors
/// [`Error::Usage`] where there is no such position.
pub(super) fn selection(
    trajectories: &Path,
    wanted: Option<&[usize]>,
    count: usize,
) -> Result<Vec<usize>, Error> {
    let Some(wanted) = wanted else { return Ok((0..count).collect()) };
    match wanted.iter().find(|&&index| index >= count) {
        None => Ok(wanted.to_vec()),
        Some(index) => Err(Error::Usage(format!(
            "{}: no episode {index}; valid choices: 0 to {}",
            trajectories.display(),
            count.saturating_sub(1)
        ))),
    }
}
