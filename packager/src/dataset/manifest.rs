//! The manifest: one JSON line per episode, and the description of the dataset.

use std::path::Path;

use akrobat_cameras::Rig;
use serde::{Deserialize, Serialize};

use crate::episode::DepthEncoding;
use crate::error::{PackError, Result};
use crate::mcap_log::ColorEncoding;

/// File name of the manifest in a dataset folder.
pub const MANIFEST: &str = "manifest.jsonl";

/// File name of the description in a dataset folder.
pub const DESCRIPTION: &str = "dataset.json";

/// Value of `format` in the description.
pub const FORMAT: &str = "akrobat.dataset";

/// Value of `format_version` in the description.
pub const FORMAT_VERSION: u32 = 1;

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
    /// How depth is stored in HDF5 shards; MCAP logs hold millimetres.
    pub depth: DepthEncoding,
    /// How colour is stored in MCAP logs.
    pub color: ColorEncoding,
    /// A shard is closed after this many episodes.
    pub episodes_per_shard: u32,
    /// A shard is also closed once it holds at least this many bytes.
    pub shard_bytes: Option<u64>,
    /// The cameras.
    pub rig: Rig,
    /// Licences of everything that is seen.
    pub licences: Vec<Licence>,
    /// What else tells how the dataset came to be. No dates, hosts or timings.
    pub provenance: serde_json::Value,
}

impl DatasetConfig {
    /// HDF5 shards of 50 episodes with depth in millimetres.
    pub fn new(name: impl Into<String>, rig: Rig) -> Self {
        Self {
            name: name.into(),
            container: Container::default(),
            depth: DepthEncoding::default(),
            color: ColorEncoding::default(),
            episodes_per_shard: 50,
            shard_bytes: None,
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

/// The description file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Description {
    pub format: String,
    pub format_version: u32,
    /// True once all episodes were written and the dataset was closed.
    pub complete: bool,
    pub config: DatasetConfig,
}

impl Description {
    pub fn new(config: DatasetConfig, complete: bool) -> Self {
        Self { format: FORMAT.into(), format_version: FORMAT_VERSION, complete, config }
    }

    pub fn write(&self, folder: &Path) -> Result<()> {
        let mut text = serde_json::to_string_pretty(self).expect("plain data has a JSON form");
        text.push('\n');
        crate::whole_file::write(&folder.join(DESCRIPTION), text.as_bytes())
    }

    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(DESCRIPTION);
        let text = std::fs::read_to_string(&path).map_err(|e| PackError::read(&path, e))?;
        let description: Self =
            serde_json::from_str(&text).map_err(|e| PackError::damaged(&path, e.to_string()))?;
        if description.format != FORMAT || description.format_version != FORMAT_VERSION {
            let expected = format!("{FORMAT} {FORMAT_VERSION}");
            let got = format!("{} {}", description.format, description.format_version);
            return Err(PackError::content(&path, "format", expected, got));
        }
        Ok(description)
    }
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
    /// Position of the active joint to reach, rad or m.
    pub goal: f64,
    /// Scene name.
    pub scene_id: String,
    /// Object name.
    pub object_id: String,
    /// Robot name.
    pub robot_id: String,
}

/// Lines of a manifest as they stand in the file.
pub(crate) fn to_lines(entries: &[ManifestEntry]) -> String {
    let line = |entry| serde_json::to_string(entry).expect("plain data has a JSON form") + "\n";
    entries.iter().map(line).collect()
}

/// Reads the manifest. A last line without its end is what a killed run left: it is not returned.
/// Gives the number of bytes of the whole lines as well.
pub(crate) fn read(folder: &Path) -> Result<(Vec<ManifestEntry>, u64)> {
    let path = folder.join(MANIFEST);
    let bytes = std::fs::read(&path).map_err(|e| PackError::read(&path, e))?;
    let whole = bytes.iter().rposition(|&b| b == b'\n').map_or(0, |end| end + 1);
    let mut entries = Vec::new();
    for (index, line) in bytes[..whole].split_inclusive(|&b| b == b'\n').enumerate() {
        entries.push(serde_json::from_slice(line).map_err(|e| {
            let item = format!("line {}", index + 1);
            PackError::content(&path, item, "an episode as JSON", e.to_string())
        })?);
    }
    Ok((entries, whole as u64))
}
