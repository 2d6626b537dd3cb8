//! One episode of an HDF5 shard.

use std::collections::HashSet;
use std::fmt::Debug;

use super::Report;
use super::arrays::{ArrayCheck, time_problems};
use crate::dataset::manifest::{DatasetConfig, StoredEpisode};
use crate::dataset::reader::{EpisodeReader, Values};
use crate::error::{PackError, Result};

/// Bytes of an array that are held in memory at once.
const BLOCK_BYTES: usize = 32 << 20;

/// Groups with one value for the episode, or one for each label, instead of one for each frame.
const ONCE_AN_EPISODE: [&str; 4] =
    ["initial_state/", "segment_labels/", "class_labels/", "instance_labels/"];

/// Checks an episode against its line and against itself.
pub(super) fn check(
    episode: &EpisodeReader,
    id: &str,
    stored: &StoredEpisode,
    config: &DatasetConfig,
    report: &mut Report,
) -> Result<()> {
    let place = |name: &str| format!("{} {} {name}", stored.shard, stored.key);
    check_attributes(episode, id, stored, |name, message| report.add(place(name), message))?;
    let frames = stored.frames as usize;
    let labels = match episode.array("segment_labels/id")?.values {
        Values::U16(ids) => ids.into_iter().chain([0]).collect(),
        _ => HashSet::new(),
    };
    let names = episode.array_names()?;
    let modalities = episode.texts("modalities")?;
    for camera in &config.rig.cameras {
        let images = modalities.iter().map(String::as_str);
        for kind in images.chain(["intrinsics", "world_from_camera"]) {
            let name = format!("camera_obs/{}_{kind}", camera.name);
            if !names.contains(&name) {
                report.add(place(&name), "is missing");
            }
        }
    }
    let is_linked = |name: &str| {
        name.starts_with("point_cloud") || names.contains(&format!("camera_obs/{name}"))
    };
    for name in &names {
        let shape = episode.shape(name)?;
        let per_frame = !ONCE_AN_EPISODE.iter().any(|group| name.starts_with(group));
        if per_frame && shape.first() != Some(&frames) {
            report.add(place(name), format!("{shape:?} is not {frames} frames"));
        }
        // Hard links under `obs/` are looked at under their first name.
        if name.strip_prefix("obs/").is_some_and(is_linked) {
            continue;
        }
        let far_m = config
            .rig
            .cameras
            .iter()
            .find(|camera| *name == format!("camera_obs/{}_depth", camera.name))
            .map(|camera| camera.far_m as f32);
        let mut check = ArrayCheck::new(name, &labels, far_m);
        // A damaged block does not hide what is wrong with the other arrays.
        if let Err(error) = read_blocks(episode, name, &shape, &mut check) {
            report.add(place(name), error.to_string());
        }
        for message in check.finish() {
            report.add(place(name), message);
        }
    }
    if let Values::F64(times_s) = episode.array("time")?.values {
        for message in time_problems(&times_s, episode.number("frame_rate_hz")?) {
            report.add(place("time"), message);
        }
    }
    check_actions(episode, report, &place)
}

fn read_blocks(
    episode: &EpisodeReader,
    name: &str,
    shape: &[usize],
    check: &mut ArrayCheck<'_>,
) -> Result<()> {
    const LARGEST_ELEMENT: usize = 8;
    let rows = shape.first().copied().unwrap_or(1);
    let row = shape.get(1..).unwrap_or_default().iter();
    let row_bytes = row.fold(LARGEST_ELEMENT, |bytes, &length| bytes.saturating_mul(length));
    let step = (BLOCK_BYTES / row_bytes.max(1)).max(1);
    for first in (0..rows).step_by(step) {
        check.push(&episode.rows(name, first..(first + step).min(rows))?);
    }
    Ok(())
}

/// The manifest repeats what the episode's attributes say.
fn check_attributes(
    episode: &EpisodeReader,
    id: &str,
    stored: &StoredEpisode,
    mut problem: impl FnMut(&str, String),
) -> Result<()> {
    let mut compare = |name: &str, found: &dyn Debug, expected: &dyn Debug| {
        let (found, expected) = (format!("{found:?}"), format!("{expected:?}"));
        if found != expected {
            problem(name, format!("is {found}, the manifest says {expected}"));
        }
    };
    let found = StoredEpisode::of_episode(episode)?;
    compare("episode_id", &episode.text("episode_id")?, &id);
    compare("num_samples", &found.frames, &stored.frames);
    compare("success", &found.success, &stored.success);
    compare("seed", &found.seed, &stored.seed);
    compare("traj_index", &found.traj_index, &stored.traj_index);
    compare("grasp_id", &found.grasp_id, &stored.grasp_id);
    compare("scene_id", &found.scene_id, &stored.scene_id);
    compare("object_id", &found.object_id, &stored.object_id);
    compare("robot_id", &found.robot_id, &stored.robot_id);
    compare("start_state", &found.start_state, &stored.start_state);
    // JSON readers may be wrong in the last place.
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-12 * a.abs().max(b.abs());
    for (name, found, expected) in
        [("start_angle", found.start, stored.start), ("goal_angle", found.goal, stored.goal)]
    {
        if !close(found, expected) {
            problem(name, format!("is {found}, the manifest says {expected}"));
        }
    }
    Ok(())
}

/// `actions[t]` leads to `obs/joint_pos[t + 1]`.
fn check_actions(
    episode: &EpisodeReader,
    report: &mut Report,
    place: &dyn Fn(&str) -> String,
) -> Result<()> {
    let (actions, positions) = (episode.array("actions")?, episode.array("obs/joint_pos")?);
    let (Values::F32(actions), Values::F32(reached)) = (&actions.values, &positions.values) else {
        let expected = "f32 values in actions and obs/joint_pos";
        return Err(PackError::content(episode.path(), "actions", expected, "another type"));
    };
    let columns = positions.shape.get(1).copied().unwrap_or(0);
    let kept = actions.len().saturating_sub(columns);
    if actions.get(..kept) != reached.get(columns..) {
        report.add(place("actions"), "do not lead to the next frame's joint positions");
    }
    Ok(())
}
