//! What a dataset holds: counts, arrays with their sizes and compression, ranges of the joints.
//!
//! Images are not read, only what HDF5 says of their storage; joint positions are read an episode at a time.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use hdf5::types::TypeDescriptor;
use serde::Serialize;

use super::manifest::{Container, Status, StoredEpisode};
use super::reader::{DatasetReader, EpisodeReader, Values};
use crate::error::{PackError, Result};
use crate::h5::read_error;

/// What a dataset holds.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// The dataset's name.
    pub name: String,
    /// False where the run that wrote it has not come to its end.
    pub complete: bool,
    /// Episodes that are stored.
    pub episodes: u64,
    /// Episodes that the judge refused.
    pub filtered: u64,
    /// Episodes that were given up.
    pub quarantined: u64,
    /// Why episodes are not stored, and how many for each reason.
    pub reasons: BTreeMap<String, u64>,
    /// Frames of all stored episodes.
    pub frames: u64,
    /// Shards or logs.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Start states that differ from each other.
    pub unique_starts: u64,
    /// Stored episodes of each robot.
    pub robots: BTreeMap<String, u64>,
    /// Stored episodes of each object.
    pub objects: BTreeMap<String, u64>,
    /// Stored episodes of each scene.
    pub scenes: BTreeMap<String, u64>,
    /// Arrays by name, over all episodes of HDF5 shards.
    pub arrays: BTreeMap<String, ArraySummary>,
    /// Joints of each robot, in the order of their columns.
    pub joints: BTreeMap<String, Vec<JointSummary>>,
}

/// One array over all episodes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ArraySummary {
    /// Type of its elements, such as `uint8`.
    pub element: String,
    /// Length of every axis of a row.
    pub row: Vec<usize>,
    /// Rows of all episodes.
    pub rows: u64,
    /// Bytes of its elements.
    pub raw_bytes: u64,
    /// Bytes that its chunks take in the files.
    pub stored_bytes: u64,
}

/// Positions of one joint over all frames, rad or m.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JointSummary {
    /// The joint's name.
    pub name: String,
    /// Frames of all episodes.
    pub rows: u64,
    /// Smallest position.
    pub min: f64,
    /// Mean position.
    pub mean: f64,
    /// Largest position.
    pub max: f64,
}

/// Summarises a dataset.
///
/// # Errors
/// Where a file is missing, damaged or of another kind.
pub fn summarize(folder: &Path) -> Result<Summary> {
    let dataset = DatasetReader::open(folder)?;
    let config = dataset.config();
    let mut summary = Summary {
        name: config.name.clone(),
        complete: dataset.is_complete(),
        ..Summary::default()
    };
    for entry in dataset.entries() {
        match entry.status {
            Status::Accepted => summary.episodes += 1,
            Status::Filtered => summary.filtered += 1,
            Status::Quarantined => summary.quarantined += 1,
        }
        if entry.status != Status::Accepted {
            *summary.reasons.entry(entry.reason.clone()).or_default() += 1;
        }
    }
    let (mut starts, mut files) = (BTreeSet::new(), BTreeSet::new());
    for (_, stored) in dataset.episodes() {
        summary.add_episode(stored);
        starts.insert(&stored.start_state);
        if files.insert(&stored.shard) {
            let path = dataset.file_of(stored)?;
            summary.bytes += path.metadata().map_err(|e| PackError::read(&path, e))?.len();
        }
        if config.container == Container::Hdf5 {
            let episode = dataset.episode(stored)?;
            summary.add_arrays(&episode)?;
            summary.add_joints(&episode, &stored.robot_id)?;
        }
    }
    summary.unique_starts = starts.len() as u64;
    summary.files = files.len() as u64;
    Ok(summary)
}

/// The joint positions of the robot.
const POSITIONS: &str = "obs/joint_pos";

impl Summary {
    fn add_episode(&mut self, stored: &StoredEpisode) {
        self.frames += u64::from(stored.frames);
        let names = [
            (&mut self.robots, &stored.robot_id),
            (&mut self.objects, &stored.object_id),
            (&mut self.scenes, &stored.scene_id),
        ];
        for (counts, name) in names {
            *counts.entry(name.clone()).or_default() += 1;
        }
    }

    fn add_arrays(&mut self, episode: &EpisodeReader) -> Result<()> {
        let names = episode.array_names()?;
        // What stands below `obs/` a second time takes no space of its own.
        let again = |name: &&String| {
            name.strip_prefix("obs/").is_some_and(|n| {
                n.starts_with("point_cloud") || names.contains(&format!("camera_obs/{n}"))
            })
        };
        for name in names.iter().filter(|name| !again(name)) {
            let (stored_bytes, element_size, element) = storage(episode, name)?;
            let shape = episode.shape(name)?;
            let row = shape.get(1..).unwrap_or_default();
            let rows = shape.first().copied().unwrap_or(1) as u64;
            let array = self.arrays.entry(name.clone()).or_insert_with(|| ArraySummary {
                element,
                row: row.to_vec(),
                rows: 0,
                raw_bytes: 0,
                stored_bytes: 0,
            });
            let row_bytes = row.iter().fold(element_size, |n, &d| n.saturating_mul(d as u64));
            array.rows += rows;
            array.raw_bytes = array.raw_bytes.saturating_add(rows.saturating_mul(row_bytes));
            array.stored_bytes += stored_bytes;
        }
        Ok(())
    }

    fn add_joints(&mut self, episode: &EpisodeReader, robot: &str) -> Result<()> {
        let names = episode.texts("robot_joints")?;
        let Values::F32(positions) = episode.array(POSITIONS)?.values else {
            return Err(PackError::content(
                episode.path(),
                POSITIONS,
                "f32 values",
                "another type",
            ));
        };
        let joints = self.joints.entry(robot.to_owned()).or_insert_with(|| {
            let (min, mean, max) = (f64::INFINITY, 0.0, f64::NEG_INFINITY);
            let joint =
                |name: &String| JointSummary { name: name.clone(), rows: 0, min, mean, max };
            names.iter().map(joint).collect()
        });
        if joints.len() != names.len() {
            let (expected, got) = (format!("{} joints", joints.len()), names.len().to_string());
            return Err(PackError::content(episode.path(), "robot_joints", expected, got));
        }
        for row in positions.chunks_exact(names.len().max(1)) {
            for (joint, &position) in joints.iter_mut().zip(row) {
                let position = f64::from(position);
                joint.min = joint.min.min(position);
                joint.max = joint.max.max(position);
                joint.rows += 1;
                joint.mean += (position - joint.mean) / joint.rows as f64;
            }
        }
        Ok(())
    }
}

/// Bytes in the file, bytes of an element, and its type.
fn storage(episode: &EpisodeReader, name: &str) -> Result<(u64, u64, String)> {
    let (file, root) = episode.source();
    let error = |e: hdf5::Error| read_error(file.path(), name, &e);
    let place = format!("{root}/{name}");
    // Colours that are stored as image files are arrays of bytes to the reader.
    let dataset = file.dataset(&place).or_else(|_| file.dataset(&format!("{place}_encoded")))?;
    let element = dataset.dtype().and_then(|t| t.to_descriptor()).map_err(error)?;
    let name = match &element {
        TypeDescriptor::Float(size) => format!("float{}", 8 * (*size as usize)),
        other => other.to_string(),
    };
    Ok((dataset.storage_size(), element.size() as u64, name))
}
