//! Reading every byte of a dataset back and looking for what should not be there.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use serde::Serialize;

use super::manifest::{Container, MANIFEST, Status, StoredEpisode};
use super::reader::{Array, DatasetReader, EpisodeReader, Values};
use super::writer::sha256_of_file;
use crate::error::{PackError, Result};

/// Farthest a cloud's point may lie from the world's origin, metres.
const CLOUD_RANGE_M: f32 = 100.0;

/// Brightest value of a frame that still counts as black.
const BLACK: u8 = 2;

/// Something that is wrong with a dataset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// File, episode and array, as far as they are known.
    pub place: String,
    /// What is wrong.
    pub message: String,
}

/// What was found.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Report {
    /// Stored episodes that were read.
    pub episodes: u64,
    /// Their frames.
    pub frames: u64,
    /// Bytes of their files.
    pub bytes: u64,
    /// Everything that is wrong.
    pub problems: Vec<Problem>,
}

impl Report {
    fn add(&mut self, place: impl Into<String>, message: impl Into<String>) {
        self.problems.push(Problem { place: place.into(), message: message.into() });
    }
}

/// Reads a dataset and reports what is wrong with it.
///
/// # Errors
/// Only where there is no dataset to read: no description or no manifest. All else is in the report.
pub fn validate(folder: &Path) -> Result<Report> {
    let dataset = DatasetReader::open(folder)?;
    let mut report = Report::default();
    if !dataset.is_complete() {
        report.add("dataset.json", "the dataset was not completed; resume it");
    }
    check_manifest(&dataset, &mut report);
    check_files(&dataset, &mut report);
    for (id, stored) in dataset.episodes() {
        report.episodes += 1;
        report.frames += u64::from(stored.frames);
        let result = match dataset.config().container {
            Container::Hdf5 => dataset
                .episode(stored)
                .and_then(|episode| check_episode(&episode, id, stored, &mut report)),
            Container::Mcap => check_log(&folder.join(&stored.shard)),
        };
        if let Err(error) = result {
            report.add(format!("{} episode {id}", stored.shard), error.to_string());
        }
    }
    Ok(report)
}

fn check_manifest(dataset: &DatasetReader, report: &mut Report) {
    let mut seen = HashSet::new();
    for (index, entry) in dataset.entries().iter().enumerate() {
        let place = format!("{MANIFEST} line {}", index + 1);
        if !seen.insert(&entry.id) {
            report.add(&place, format!("episode {} is listed twice", entry.id));
        }
        if (entry.status == Status::Accepted) != entry.stored.is_some() {
            report.add(&place, "only accepted episodes are stored, and all of them");
        }
    }
}

/// Checksums of all listed files, and files that no line lists.
fn check_files(dataset: &DatasetReader, report: &mut Report) {
    let listed: HashMap<&str, &str> =
        dataset.episodes().map(|(_, s)| (s.shard.as_str(), s.shard_sha256.as_str())).collect();
    let mut names: Vec<_> = listed.keys().copied().collect();
    names.sort_unstable();
    for name in names {
        let path = dataset.folder().join(name);
        match sha256_of_file(&path) {
            Ok(sha256) if sha256 == listed[name] => {
                report.bytes += std::fs::metadata(&path).map_or(0, |m| m.len());
            }
            Ok(sha256) => report
                .add(name, format!("the checksum is {sha256}, the manifest says {}", listed[name])),
            Err(error) => report.add(name, error.to_string()),
        }
    }
    let found = std::fs::read_dir(dataset.folder().join("shards")).into_iter().flatten().flatten();
    for entry in found {
        let name = format!("shards/{}", entry.file_name().to_string_lossy());
        if !listed.contains_key(name.as_str()) {
            report.add(name, "no line of the manifest lists this file");
        }
    }
}

/// Groups with one value for the episode, or one for each label, instead of one for each frame.
const ONCE_AN_EPISODE: [&str; 4] =
    ["initial_state/", "segment_labels/", "class_labels/", "instance_labels/"];

fn check_episode(
    episode: &EpisodeReader,
    id: &str,
    stored: &StoredEpisode,
    report: &mut Report,
) -> Result<()> {
    let place = |name: &str| format!("{} {} {name}", stored.shard, stored.key);
    let frames = stored.frames as usize;
    if episode.frames()? != u64::from(stored.frames) {
        let message = format!("num_samples is not the manifest's {frames}");
        report.add(place("num_samples"), message);
    }
    if episode.text("episode_id")? != id {
        report.add(place("episode_id"), format!("is not the manifest's {id}"));
    }
    let labels = match episode.array("segment_labels/id")?.values {
        Values::U16(ids) => ids.into_iter().chain([0]).collect(),
        _ => HashSet::new(),
    };
    for name in episode.array_names()? {
        let array = episode.array(&name)?;
        let per_frame = !ONCE_AN_EPISODE.iter().any(|group| name.starts_with(group));
        if per_frame && array.shape.first() != Some(&frames) {
            report.add(place(&name), format!("{:?} is not {frames} frames", array.shape));
        }
        // Hard links under `obs/` were looked at under their first name.
        let image = ["_rgb", "_depth", "_segmentation", "point_cloud"];
        let linked = name.starts_with("obs/") && image.iter().any(|end| name.ends_with(end));
        for message in array_problems(&name, &array, &labels).into_iter().filter(|_| !linked) {
            report.add(place(&name), message);
        }
    }
    check_actions(episode, report, &place)
}

/// `actions[t]` leads to `obs/joint_pos[t + 1]`.
fn check_actions(
    episode: &EpisodeReader,
    report: &mut Report,
    place: &dyn Fn(&str) -> String,
) -> Result<()> {
    let (actions, positions) = (episode.array("actions")?, episode.array("obs/joint_pos")?);
    if let (Values::F32(actions), Values::F32(reached)) = (&actions.values, &positions.values) {
        let columns = positions.shape.get(1).copied().unwrap_or(0);
        let kept = actions.len().saturating_sub(columns);
        if actions.get(..kept) != reached.get(columns..) {
            report.add(place("actions"), "do not lead to the next frame's joint positions");
        }
    }
    Ok(())
}

fn array_problems(name: &str, array: &Array, labels: &HashSet<u16>) -> Vec<String> {
    let mut problems = Vec::new();
    let frame_values = array.shape.get(1..).map_or(1, |axes| axes.iter().product::<usize>()).max(1);
    match &array.values {
        Values::U8(values) if name.ends_with("_rgb") => {
            let black = |frame: &[u8]| frame.iter().all(|&v| v <= BLACK);
            problems.extend(
                frames_where(values, frame_values, black).map(|f| format!("frame {f} is black")),
            );
        }
        Values::U16(values) if name.ends_with("_depth") => {
            let blind = |frame: &[u16]| frame.iter().all(|&v| v == 0);
            problems.extend(
                frames_where(values, frame_values, blind)
                    .map(|f| format!("frame {f} has no depth")),
            );
        }
        Values::U16(values) if name.ends_with("_segmentation") => {
            let unknown: HashSet<u16> =
                values.iter().copied().filter(|v| !labels.contains(v)).collect();
            problems.extend(unknown.iter().min().map(|id| format!("segment {id} has no label")));
        }
        Values::F32(values) => problems.extend(float_problems(name, values, frame_values)),
        Values::F64(values) => {
            problems.extend(
                values.iter().any(|v| !v.is_finite()).then(|| "holds NaN or infinity".to_owned()),
            );
            if name == "time" && values.windows(2).any(|w| w[1] <= w[0]) {
                problems.push("times do not increase".to_owned());
            }
        }
        Values::U8(_) | Values::U16(_) => {}
    }
    problems
}

fn float_problems(name: &str, values: &[f32], frame_values: usize) -> Vec<String> {
    let mut problems = Vec::new();
    if values.iter().any(|v| !v.is_finite()) {
        problems.push("holds NaN or infinity".to_owned());
    }
    if name.ends_with("_depth") {
        let blind = |frame: &[f32]| frame.iter().all(|&v| v == 0.0);
        problems.extend(
            frames_where(values, frame_values, blind).map(|f| format!("frame {f} has no depth")),
        );
    }
    if name.ends_with("point_cloud") {
        let far = |p: &[f32]| p[..3].iter().any(|v| v.abs() > CLOUD_RANGE_M);
        let pale = |p: &[f32]| p[3..].iter().any(|v| !(0.0..=255.0).contains(v));
        let points = || values.chunks_exact(6);
        if points().any(far) {
            problems.push(format!("has points beyond {CLOUD_RANGE_M} m"));
        }
        if points().any(pale) {
            problems.push("has colours outside 0..255".to_owned());
        }
    }
    problems
}

fn frames_where<'a, T>(
    values: &'a [T],
    frame_values: usize,
    bad: impl Fn(&[T]) -> bool + 'a,
) -> impl Iterator<Item = usize> + 'a {
    values.chunks(frame_values).enumerate().filter(move |(_, f)| bad(f)).map(|(index, _)| index)
}

/// Reads all messages of a log with their checksums.
fn check_log(path: &Path) -> Result<()> {
    let bytes = std::fs::read(path).map_err(|e| PackError::read(path, e))?;
    let damaged = |e: mcap::McapError| PackError::damaged(path, e.to_string());
    for message in mcap::MessageStream::new(&bytes).map_err(damaged)? {
        message.map_err(damaged)?;
    }
    Ok(())
}
