//! Loads tasks, robots and scenes from files.

use std::path::{Path, PathBuf};

use crate::task::Task;
use crate::{ModelError, Robot};

/// Where files are looked up that are not found relative to the file that names them.
#[derive(Debug, Clone, Default)]
pub struct AssetSearch {
    /// Folders, in order.
    pub folders: Vec<PathBuf>,
}

/// Loads a robot file.
///
/// # Errors
/// Any [`ModelError`] of the robot file, its URDF or its meshes.
pub fn robot(_path: &Path, _search: &AssetSearch) -> Result<Robot, ModelError> {
    Err(ModelError::bad_value("robot", "loading is not there yet"))
}

/// Loads a task file and everything it names.
///
/// # Errors
/// Any [`ModelError`] of the task, robot, object, scene or grasp files.
pub fn task(_path: &Path, _search: &AssetSearch) -> Result<Task, ModelError> {
    Err(ModelError::bad_value("task", "loading is not there yet"))
}
