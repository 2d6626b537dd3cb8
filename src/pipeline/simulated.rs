//! What the robot really did, in the place of what was planned.

use std::collections::BTreeMap;
use std::path::Path;

use akrobat_model::trajectory::DensePath;
use akrobat_model::{JointPath, ModelError, Phase, Trajectory, TrajectorySet, hash};
use akrobat_packager::audit_file;

use super::replay::audit_path;
use crate::Error;

/// Replaces the paths of a trajectory file by those of its audit. Returns why the others cannot be shown, by position: they failed in
/// physics, or were not driven.
///
/// # Errors
/// Where there is no audit of this very file.
pub(super) fn replace_paths(
    trajectories: &Path,
    set: &mut TrajectorySet,
) -> Result<BTreeMap<usize, String>, Error> {
    let path = audit_path(trajectories);
    if !path.is_file() {
        return Err(Error::Usage(format!(
            "{}: there is no such file: simulated states come from `akrobat replay {}`",
            path.display(),
            trajectories.display()
        )));
    }
    let audit = audit_file::read(&path)?;
    if audit.trajectories_sha256 != hash::of_file(trajectories)? {
        let message = format!("is the audit of another file than {}", trajectories.display());
        return Err(ModelError::invalid(&path, message).into());
    }
    let mut episodes: BTreeMap<usize, _> =
        audit.episodes.into_iter().map(|episode| (episode.episode as usize, episode)).collect();
    let mut unfit = BTreeMap::new();
    for (index, trajectory) in set.trajectories.iter_mut().enumerate() {
        match episodes.remove(&index) {
            None => drop(unfit.insert(index, "not_replayed".to_owned())),
            Some(episode) if !episode.success => drop(unfit.insert(index, episode.reason)),
            Some(episode) => {
                let dense = episode.simulated().ok_or_else(|| {
                    ModelError::invalid(&path, format!("the traces of episode {index} differ"))
                })?;
                replace(trajectory, dense);
            }
        }
    }
    Ok(unfit)
}

fn replace(trajectory: &mut Trajectory, dense: DensePath) {
    let waypoints = trajectory.waypoints_robot.rows();
    let first = dense.phase.iter().position(|&phase| phase == Phase::Manipulate).unwrap_or(0);
    let intervals = waypoints.saturating_sub(1).max(1);
    let substeps = (dense.len() - 1 - first) / intervals;
    let rows = |path: &JointPath| {
        let mut table = JointPath::new(path.columns());
        for waypoint in 0..waypoints {
            table.push(path.row_f64(first + waypoint * substeps));
        }
        table
    };
    trajectory.waypoints_robot = rows(&dense.robot);
    trajectory.waypoints_object = rows(&dense.object);
    let end = first + substeps;
    trajectory.waypoint_interval_s = dense.times_s[end] - dense.times_s[first];
    trajectory.manipulation_start = first as u32;
    trajectory.substeps = substeps as u32;
    trajectory.dense = dense;
}
