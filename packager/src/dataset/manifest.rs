//! The manifest: one JSON line per episode, and what all episodes share.

use std::path::Path;

use akrobat_cameras::Rig;
use serde::{Deserialize, Serialize};

use super::reader::{EpisodeReader, Values};
use crate::error::{PackError, Result};
use crate::storage::StorageConfig;

/// File name of the manifest in a dataset folder.
pub const MANIFEST: &str = "manifest.jsonl";

/// Kind of the files that hold the episodes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Container {
    /// HDF5 shards of many episodes.
    #[default]
    Hdf5,
    /// One MCAP log per episode.
    Mcap,
}

/// What all episodes of a dataset share.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetConfig {
    /// Name for reports.
    pub name: String,
    /// Kind of the files.
    pub container: Container,
    /// How the files store the episodes.
    pub storage: StorageConfig,
    /// The cameras.
    pub rig: Rig,
    /// Licences of everything that is seen.
    pub licences: Vec<Licence>,
    /// What else tells how the dataset came to be. No dates, hosts or timings.
    pub provenance: serde_json::Value,
}

impl DatasetConfig {
    /// As JSON, for the files of the dataset to carry.
    pub(crate) fn to_json(&self) -> String {
        serde_json::to_string(self).expect("plain data has a JSON form")
    }

    /// HDF5 shards of 50 episodes with depth in millimetres.
    pub fn new(name: impl Into<String>, rig: Rig) -> Self {
        Self {
            name: name.into(),
            container: Container::default(),
            storage: StorageConfig::default(),
            rig,
            licences: Vec::new(),
            provenance: serde_json::Value::Null,
        }
    }
}

/// Licence of one asset.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Licence {
    /// Robot, object or scene name.
    pub asset: String,
    /// SPDX expression; empty where the asset's files state none.
    pub license: String,
    /// Where the asset comes from.
    pub source: String,
}

/// What became of an episode.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// Stored.
    Accepted,
    /// Refused by the judge; not rendered.
    Filtered,
    /// Rendering failed or gave something unusable; not stored.
    Quarantined,
}

/// One line of the manifest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ManifestEntry {
    /// Identity of the trajectory.
    pub id: String,
    /// What became of it.
    pub status: Status,
    /// Why, where it was not accepted.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub reason: String,
    /// Part of the dataset that it was dealt to: `train`, `valid`, `test`, …
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub split: Option<String>,
    /// Where it is stored, if it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stored: Option<StoredEpisode>,
}

/// An accepted episode's place and attributes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StoredEpisode {
    /// File, relative to the dataset folder.
    pub shard: String,
    /// Group below `data/` in HDF5 shards; empty in MCAP logs.
    pub key: String,
    /// SHA-256 of the whole file.
    pub shard_sha256: String,
    /// Number of frames.
    pub frames: u32,
    /// Whether the judge accepted the trajectory.
    pub success: bool,
    /// Seed of the trajectory.
    pub seed: u64,
    /// Position of the trajectory in its file.
    pub traj_index: u32,
    /// Number of the grasp.
    pub grasp_id: u32,
    /// Position of the active joint at the start, rad or m.
    pub start: f64,
    /// Identity of the first frame's joint positions: episodes that start alike have the same.
    pub start_state: String,
    /// Position of the active joint to reach, rad or m.
    pub goal: f64,
    /// Scene name.
    pub scene_id: String,
    /// Object name.
    pub object_id: String,
    /// Robot name.
    pub robot_id: String,
}

/// Identity of what an episode starts with: the joint positions of robot and object as they are stored.
pub(crate) fn start_state(positions: impl Iterator<Item = f32>) -> String {
    let bytes: Vec<u8> = positions.flat_map(f32::to_le_bytes).collect();
    akrobat_model::hash::of_bytes(&bytes)[..16].to_owned()
}

/// Lines of a manifest as they stand in the file.
pub(crate) fn to_lines(entries: &[ManifestEntry]) -> String {
    let line = |entry| serde_json::to_string(entry).expect("plain data has a JSON form") + "\n";
    entries.iter().map(line).collect()
}

impl StoredEpisode {
    /// Everything that the episode itself says; its place and checksum are left empty.
    ///
    /// # Errors
    /// [`PackError::Content`] where an attribute is absent.
    pub fn of_episode(episode: &EpisodeReader) -> Result<Self> {
        let frames = episode.frames()?;
        let first = |name: &str| match episode.rows(name, 0..1)?.values {
            Values::F32(values) => Ok(values),
            _ => Err(PackError::content(episode.path(), name, "f32 values", "another type")),
        };
        let object_id = episode.text("object_id")?;
        let object = format!("states/articulation/{}/joint_position", object_id.replace('/', "_"));
        let start_state = match frames {
            0 => String::new(),
            _ => start_state(first("obs/joint_pos")?.into_iter().chain(first(&object)?)),
        };
        Ok(Self {
            shard: String::new(),
            key: String::new(),
            shard_sha256: String::new(),
            frames: u32::try_from(frames).map_err(|_| {
                PackError::content(episode.path(), "num_samples", "32 bits", frames.to_string())
            })?,
            success: episode.number("success")?,
            seed: episode.number("seed")?,
            traj_index: episode.number("traj_index")?,
            grasp_id: episode.number("grasp_id")?,
            start: episode.number("start_angle")?,
            start_state,
            goal: episode.number("goal_angle")?,
            scene_id: episode.text("scene_id")?,
            object_id,
            robot_id: episode.text("robot_id")?,
        })
    }

    /// What is wrong with the place: a shard must be a plain name below `shards/`.
    fn problem(&self) -> Option<String> {
        let plain = |name: &str| {
            !name.is_empty()
                && !name.starts_with('.')
                && name.chars().all(|c| c.is_ascii_alphanumeric() || "._-".contains(c))
        };
        if !self.shard.strip_prefix("shards/").is_some_and(plain) {
            return Some(format!("shard {:?}, which is not a file in shards/", self.shard));
        }
        let plain_key = self.key.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        (!plain_key).then(|| format!("key {:?}", self.key))
    }
}

/// Reads the manifest. A last line without its end is what a killed run left: it is not returned.
/// Gives the number of bytes of the whole lines as well.
pub(crate) fn read(folder: &Path) -> Result<(Vec<ManifestEntry>, u64)> {
    let path = folder.join(MANIFEST);
    let bytes = std::fs::read(&path).map_err(|e| PackError::read(&path, e))?;
    let whole = bytes.iter().rposition(|&b| b == b'\n').map_or(0, |end| end + 1);
    let mut entries = Vec::new();
    for (index, line) in bytes[..whole].split_inclusive(|&b| b == b'\n').enumerate() {
        let item = || format!("line {}", index + 1);
        let entry: ManifestEntry = serde_json::from_slice(line)
            .map_err(|e| PackError::content(&path, item(), "an episode as JSON", e.to_string()))?;
        if let Some(problem) = entry.stored.as_ref().and_then(StoredEpisode::problem) {
            return Err(PackError::content(&path, item(), "a place in this dataset", problem));
        }
        entries.push(entry);
    }
    Ok((entries, whole as u64))
}
