//! Manifest and description built anew from whole shards.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use akrobat_model::events::{Event, Observer};
use serde::Serialize;

use super::description::Description;
use super::manifest::{
    self, Container, DatasetConfig, MANIFEST, ManifestEntry, Status, StoredEpisode,
};
use super::reader::EpisodeReader;
use super::validate::{Problem, Report, check_stored};
use super::writer::{self, SHARD_FOLDER, sha256_of_file};
use crate::error::{PackError, Result};
use crate::folder_lock::FolderLock;
use crate::h5::H5Reader;
use crate::mcap_log::read::{LogRecord, for_each_record};
use crate::mcap_log::{DATASET_METADATA, EPISODE_METADATA, content};
use crate::shard::DATASET_ATTRIBUTE;

/// Folder that takes shards that are not whole.
pub const DAMAGED_FOLDER: &str = "damaged";

/// Name of the progress stage.
const STAGE: &str = "repairing";

/// What repairing found and did.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Repaired {
    /// Stored episodes of the repaired dataset.
    pub episodes: usize,
    /// Those among them that the manifest had not listed, or not rightly.
    pub recovered: usize,
    /// Episodes and shards that are gone.
    pub lost: Vec<Problem>,
}

/// Rebuilds `dataset.json` and `manifest.jsonl` from the shards that are whole. Others are moved to
/// `damaged/`; temporary files are deleted.
///
/// # Errors
/// [`PackError`] where neither the description nor any shard tells what the dataset is, or the disk
/// fails.
pub fn repair(folder: &Path, observer: &dyn Observer) -> Result<Repaired> {
    let started = std::time::Instant::now();
    let _lock = FolderLock::exclusive(folder)?;
    writer::refuse_links(folder)?;
    let shards = folder.join(SHARD_FOLDER);
    let mut files = writer::files_in(&shards)?;
    writer::remove_partial(folder)?;
    writer::remove_partial(&shards)?;
    files.retain(|path| path.exists());
    files.sort();
    let config = configuration(folder, &files)?;
    let before = readable_lines(folder);
    let trusted: HashSet<&str> = before
        .iter()
        .filter_map(|entry| Some(entry.stored.as_ref()?.shard_sha256.as_str()))
        .collect();
    let mut repaired = Repaired::default();
    let mut found = Vec::new();
    observer.event(&Event::StageStarted { stage: STAGE, total: Some(files.len() as u64) });
    for (index, path) in files.iter().enumerate() {
        match entries_of(path, &config, &trusted) {
            Ok(entries) => found.extend(entries),
            Err(error) => {
                let place = move_aside(folder, path)?;
                repaired.lost.push(Problem { place, message: error.to_string() });
            }
        }
        observer.event(&Event::Progress { stage: STAGE, done: index as u64 + 1 });
    }
    let entries = reconcile(&before, found, &mut repaired);
    let lines = manifest::to_lines(&entries);
    crate::whole_file::write(&folder.join(MANIFEST), lines.as_bytes())?;
    let sha256 = akrobat_model::hash::of_bytes(lines.as_bytes());
    Description::complete(config, sha256).write(folder)?;
    let seconds = started.elapsed().as_secs_f64();
    observer.event(&Event::StageFinished { stage: STAGE, seconds });
    Ok(repaired)
}

/// The description's configuration where it is as it was written, else that which the shards carry.
fn configuration(folder: &Path, files: &[PathBuf]) -> Result<DatasetConfig> {
    let description = Description::read(folder);
    if let (Ok(description), Ok(true)) = (&description, Description::is_sealed(folder)) {
        return Ok(description.config.clone());
    }
    match files.iter().find_map(|path| carried_configuration(path).ok()) {
        Some(config) => Ok(config),
        None => description.map(|description| description.config),
    }
}

fn carried_configuration(path: &Path) -> Result<DatasetConfig> {
    if is_log(path) {
        let mut text = None;
        for_each_record(path, |record| {
            if let LogRecord::Metadata { name: DATASET_METADATA, entries } = record {
                text = entries.get("config").cloned();
            }
        })?;
        let text = text.unwrap_or_default();
        return serde_json::from_str(&text).map_err(|e| {
            PackError::content(path, DATASET_METADATA, "a configuration", e.to_string())
        });
    }
    let file = H5Reader::open(path)?;
    file.attr_json(file.root(), DATASET_ATTRIBUTE)
}

fn is_log(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension == "mcap")
}

/// Lines that can be read; what is damaged is what the shards tell anew.
fn readable_lines(folder: &Path) -> Vec<ManifestEntry> {
    let bytes = std::fs::read(folder.join(MANIFEST)).unwrap_or_default();
    bytes.split(|&b| b == b'\n').filter_map(|line| serde_json::from_slice(line).ok()).collect()
}

/// The episodes of a shard. One whose checksum is not that of the manifest is read completely.
fn entries_of(
    path: &Path,
    config: &DatasetConfig,
    trusted: &HashSet<&str>,
) -> Result<Vec<ManifestEntry>> {
    let sha256 = sha256_of_file(path)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let shard = format!("{SHARD_FOLDER}/{name}");
    let mut entries = match config.container {
        Container::Hdf5 => episodes_of_shard(path)?,
        Container::Mcap => vec![episode_of_log(path)?],
    };
    for (id, stored) in &mut entries {
        stored.shard.clone_from(&shard);
        stored.shard_sha256.clone_from(&sha256);
        if trusted.contains(sha256.as_str()) {
            continue;
        }
        let mut report = Report::default();
        check_stored(path, id, stored, config, &mut report)?;
        if let Some(problem) = report.problems.first() {
            let message = format!("{}: {}", problem.place, problem.message);
            return Err(PackError::Damaged { path: path.to_path_buf(), message });
        }
    }
    let line = |(id, stored)| ManifestEntry {
        id,
        status: Status::Accepted,
        reason: String::new(),
        split: None,
        stored: Some(stored),
    };
    Ok(entries.into_iter().map(line).collect())
}

fn episodes_of_shard(path: &Path) -> Result<Vec<(String, StoredEpisode)>> {
    let file = H5Reader::open(path)?;
    let mut keys =
        file.group("data")?.member_names().map_err(|e| crate::h5::read_error(path, "data", &e))?;
    let number = |key: &str| key.strip_prefix("demo_").and_then(|n| n.parse::<u64>().ok());
    keys.sort_by_key(|key| number(key));
    drop(file);
    let read = |key: String| {
        let episode = EpisodeReader::open(path, &key)?;
        let stored = StoredEpisode { key, ..StoredEpisode::of_episode(&episode)? };
        Ok((episode.text("episode_id")?, stored))
    };
    keys.into_iter().map(read).collect()
}

fn episode_of_log(path: &Path) -> Result<(String, StoredEpisode)> {
    let mut known: Option<std::collections::BTreeMap<String, String>> = None;
    let mut start_state = String::new();
    for_each_record(path, |record| match record {
        LogRecord::Metadata { name: EPISODE_METADATA, entries } => known = Some(entries.clone()),
        LogRecord::Message { topic: topic @ "/joint_states", data, .. }
            if start_state.is_empty() =>
        {
            if let Ok(content::Content::Joints { positions }) = content::parse(topic, data) {
                start_state = manifest::start_state(positions.iter().map(|&v| v as f32));
            }
        }
        _ => {}
    })?;
    let known = known.unwrap_or_default();
    fn value<T: std::str::FromStr>(
        path: &Path,
        known: &std::collections::BTreeMap<String, String>,
        name: &str,
    ) -> Result<T> {
        known.get(name).and_then(|text| text.parse().ok()).ok_or_else(|| {
            let got = known.get(name).map_or("none", String::as_str);
            PackError::content(path, format!("{EPISODE_METADATA} {name}"), "a value", got)
        })
    }
    let stored = StoredEpisode {
        shard: String::new(),
        key: String::new(),
        shard_sha256: String::new(),
        frames: value(path, &known, "frames")?,
        success: value(path, &known, "success")?,
        seed: value(path, &known, "seed")?,
        traj_index: value(path, &known, "traj_index")?,
        grasp_id: value(path, &known, "grasp_id")?,
        start: value(path, &known, "start")?,
        start_state,
        goal: value(path, &known, "goal")?,
        scene_id: value(path, &known, "scene_id")?,
        object_id: value(path, &known, "object_id")?,
        robot_id: value(path, &known, "robot_id")?,
    };
    Ok((value(path, &known, "episode_id")?, stored))
}

fn move_aside(folder: &Path, path: &Path) -> Result<String> {
    let damaged = folder.join(DAMAGED_FOLDER);
    std::fs::create_dir_all(&damaged).map_err(|e| PackError::create(&damaged, e))?;
    let name = path.file_name().unwrap_or_default();
    std::fs::rename(path, damaged.join(name)).map_err(|e| PackError::io(path, e))?;
    Ok(format!("{SHARD_FOLDER}/{}", name.to_string_lossy()))
}

/// The old lines in their order, as far as their episodes are there, then what was not listed.
fn reconcile(
    before: &[ManifestEntry],
    found: Vec<ManifestEntry>,
    repaired: &mut Repaired,
) -> Vec<ManifestEntry> {
    repaired.episodes = found.len();
    let order: Vec<String> = found.iter().map(|entry| entry.id.clone()).collect();
    let mut found: HashMap<String, ManifestEntry> =
        found.into_iter().map(|entry| (entry.id.clone(), entry)).collect();
    let mut entries = Vec::new();
    for old in before {
        match (&old.stored, found.remove(&old.id)) {
            (_, Some(entry)) => {
                let entry = ManifestEntry { split: old.split.clone(), ..entry };
                repaired.recovered += usize::from(entry != *old);
                entries.push(entry);
            }
            (None, None) => entries.push(old.clone()),
            (Some(stored), None) => repaired.lost.push(Problem {
                place: format!("{} episode {}", stored.shard, old.id),
                message: "the episode is not in any whole shard".into(),
            }),
        }
    }
    for id in order {
        if let Some(entry) = found.remove(&id) {
            repaired.recovered += 1;
            entries.push(entry);
        }
    }
    entries
}
