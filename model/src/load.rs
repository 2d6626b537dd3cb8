//! Loads tasks, robots and scenes from files.

use std::path::{Path, PathBuf};

use crate::task::Task;
use crate::{ModelError, Robot};

mod grasps;
mod hashes;
mod object;
mod robot;
mod scene;
mod task;

/// Where files are looked up that are not found relative to the file that names them.
#[derive(Debug, Clone, Default)]
pub struct AssetSearch {
    /// Folders, in order.
    pub folders: Vec<PathBuf>,
}

impl AssetSearch {
    /// The file that `referrer` names: relative to the referrer's folder, else in the search folders.
    ///
    /// # Errors
    /// [`ModelError::Invalid`] about the referrer, with every path that was tried.
    pub fn find(&self, named: &Path, referrer: &Path) -> Result<PathBuf, ModelError> {
        let beside = referrer.parent().unwrap_or(Path::new(""));
        let folders = std::iter::once(beside).chain(self.folders.iter().map(PathBuf::as_path));
        let mut tried = Vec::new();
        for candidate in folders.map(|folder| folder.join(named)) {
            if candidate.is_file() {
                return Ok(candidate);
            }
            let candidate = candidate.display().to_string();
            if !tried.contains(&candidate) {
                tried.push(candidate);
            }
        }
        Err(ModelError::invalid(
            referrer,
            format!("file \"{}\" not found; tried: {}", named.display(), tried.join(", ")),
        ))
    }
}

/// Loads a robot file. A robot with a fixed base stands at the origin; a task may place it.
///
/// # Errors
/// Any [`ModelError`] of the robot file, its URDF or its meshes.
pub fn robot(path: &Path, search: &AssetSearch) -> Result<Robot, ModelError> {
    robot::load(path, search).map(|loaded| loaded.robot)
}

/// Loads a task file and everything it names.
///
/// # Errors
/// Any [`ModelError`] of the task, robot, object, scene or grasp files.
pub fn task(path: &Path, search: &AssetSearch) -> Result<Task, ModelError> {
    task::load(path, search)
}

/// Loads what the text of a task file names, as if it stood at `path` (which need not exist).
///
/// # Errors
/// As [`task`].
pub fn task_from_text(text: String, path: &Path, search: &AssetSearch) -> Result<Task, ModelError> {
    task::from_text(text, path, search)
}

/// A TOML file's text and content; unknown keys are errors that list the valid ones.
fn parse_toml<T: serde::de::DeserializeOwned>(path: &Path) -> Result<(String, T), ModelError> {
    let text = std::fs::read_to_string(path).map_err(|e| ModelError::read(path, e))?;
    let parsed = parse_toml_text(path, &text)?;
    Ok((text, parsed))
}

/// The content of a TOML text; `path` names it in errors.
fn parse_toml_text<T: serde::de::DeserializeOwned>(
    path: &Path,
    text: &str,
) -> Result<T, ModelError> {
    toml::from_str(text).map_err(|e| ModelError::invalid(path, e.to_string().trim_end()))
}

/// `section of file`, for messages.
fn place(path: &Path, section: &str) -> String {
    format!("{}: {section}", path.display())
}

/// Checks that a position is finite and within a joint's limits.
fn check_position(place: &str, joint: &crate::Joint, position: f64) -> Result<(), ModelError> {
    let [lower, upper] = joint.limits;
    // Positions written with a few digits may lie on a limit.
    let tolerance = 1e-6;
    if position.is_finite() && (lower - tolerance..=upper + tolerance).contains(&position) {
        return Ok(());
    }
    Err(ModelError::bad_value(
        place,
        format!(
            "position {position} of joint \"{}\" is outside its limits {lower} to {upper}",
            joint.name
        ),
    ))
}

/// A joint's index by name, in an error about `place` where there is none.
fn joint_index(place: &str, tree: &crate::KinematicTree, name: &str) -> Result<usize, ModelError> {
    tree.joint_index(name).map_err(|e| at_place(place, e))
}

/// A link's index by name, in an error about `place` where there is none.
fn link_index(place: &str, tree: &crate::KinematicTree, name: &str) -> Result<usize, ModelError> {
    tree.link_index(name).map_err(|e| at_place(place, e))
}

fn at_place(place: &str, error: ModelError) -> ModelError {
    match error {
        ModelError::UnknownName { context, what, name, choices } => {
            ModelError::UnknownName { context: format!("{place} ({context})"), what, name, choices }
        }
        other => other,
    }
}
