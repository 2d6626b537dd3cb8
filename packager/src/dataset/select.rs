//! New datasets from the episodes of others: subsets and unions. Episodes are copied as they are stored.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::manifest::{DatasetConfig, ManifestEntry, StoredEpisode};
use super::reader::DatasetReader;
use super::writer::DatasetWriter;
use crate::error::{PackError, Result};

/// Which episodes are wanted. Empty lists want all.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Selection {
    /// Object names.
    pub objects: Vec<String>,
    /// Scene names.
    pub scenes: Vec<String>,
    /// Robot names.
    pub robots: Vec<String>,
    /// Parts of the dataset: `train`, `valid`, `test`, …
    pub splits: Vec<String>,
    /// Only episodes with this success.
    pub success: Option<bool>,
    /// At most this many.
    pub count: Option<usize>,
    /// Of more than `count`, take those that start in as many different states as possible; else the
    /// first.
    pub maximise_unique_starts: bool,
}

/// What a selection took.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Selected {
    /// Episodes taken.
    pub episodes: usize,
    /// Stored episodes of the source.
    pub of: usize,
    /// Different start states among those taken.
    pub unique_starts: usize,
    /// Different start states among those that fit.
    pub unique_starts_available: usize,
}

/// Writes the episodes that fit a selection into a new dataset.
///
/// # Errors
/// [`PackError::Content`] where a name does not occur or nothing fits, and where reading or writing
/// fails.
pub fn filter(folder: &Path, output: &Path, selection: &Selection) -> Result<Selected> {
    let source = DatasetReader::open(folder)?;
    check_names(&source, selection)?;
    let fitting: Vec<(&ManifestEntry, &StoredEpisode)> = source
        .entries()
        .iter()
        .filter_map(|entry| Some((entry, entry.stored.as_ref()?)))
        .filter(|(entry, stored)| fits(entry, stored, selection))
        .collect();
    let chosen = choose(&fitting, selection);
    if chosen.is_empty() {
        let expected = "at least one episode that fits";
        return Err(PackError::content(folder, "selection", expected, "none"));
    }
    let mut writer = DatasetWriter::create(output, source.config().clone())?;
    for &index in &chosen {
        writer.copy_episode(&source, fitting[index].0)?;
    }
    writer.close()?;
    let starts = |indices: &mut dyn Iterator<Item = usize>| {
        indices.map(|i| &fitting[i].1.start_state).collect::<HashSet<_>>().len()
    };
    Ok(Selected {
        episodes: chosen.len(),
        of: source.episodes().count(),
        unique_starts: starts(&mut chosen.iter().copied()),
        unique_starts_available: starts(&mut (0..fitting.len())),
    })
}

fn fits(entry: &ManifestEntry, stored: &StoredEpisode, selection: &Selection) -> bool {
    let wanted = |names: &[String], name: &str| names.is_empty() || names.iter().any(|n| n == name);
    wanted(&selection.objects, &stored.object_id)
        && wanted(&selection.scenes, &stored.scene_id)
        && wanted(&selection.robots, &stored.robot_id)
        && wanted(&selection.splits, entry.split.as_deref().unwrap_or(""))
        && selection.success.is_none_or(|success| success == stored.success)
}

/// A name that does not occur is a slip, not an empty selection.
fn check_names(source: &DatasetReader, selection: &Selection) -> Result<()> {
    let mut known: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for entry in source.entries() {
        let Some(stored) = &entry.stored else { continue };
        known.entry("object").or_default().insert(&stored.object_id);
        known.entry("scene").or_default().insert(&stored.scene_id);
        known.entry("robot").or_default().insert(&stored.robot_id);
        known.entry("split").or_default().extend(entry.split.as_deref());
    }
    let wanted = [
        ("object", &selection.objects),
        ("scene", &selection.scenes),
        ("robot", &selection.robots),
        ("split", &selection.splits),
    ];
    for (kind, names) in wanted {
        let choices = known.remove(kind).unwrap_or_default();
        if let Some(name) = names.iter().find(|name| !choices.contains(name.as_str())) {
            let choices = choices.into_iter().collect::<Vec<_>>().join(", ");
            let expected = format!("one of: {choices}");
            return Err(PackError::content(source.folder(), kind, expected, name));
        }
    }
    Ok(())
}

/// Positions of the episodes to take, in order. In rounds over the start states, each gives its next
/// episode, which no other choice of that size beats in the number of states.
fn choose(fitting: &[(&ManifestEntry, &StoredEpisode)], selection: &Selection) -> Vec<usize> {
    let count = selection.count.unwrap_or(fitting.len()).min(fitting.len());
    if !selection.maximise_unique_starts {
        return (0..count).collect();
    }
    let mut taken_of: BTreeMap<&str, usize> = BTreeMap::new();
    let mut order: Vec<(usize, usize)> = Vec::new();
    for (index, (_, stored)) in fitting.iter().enumerate() {
        let round = taken_of.entry(stored.start_state.as_str()).or_default();
        order.push((*round, index));
        *round += 1;
    }
    order.sort_unstable();
    let mut chosen: Vec<usize> = order.into_iter().take(count).map(|(_, index)| index).collect();
    chosen.sort_unstable();
    chosen
}

/// What became of a union.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Merged {
    /// Stored episodes of the new dataset.
    pub episodes: usize,
    /// Lines that stood in more than one source and were taken once.
    pub duplicates: usize,
}

/// Writes all episodes of several datasets into a new one: in the order given, with one rig, one kind of
/// file and the storage of the first.
///
/// # Errors
/// [`PackError::Content`] where the datasets do not fit together, or share episodes and `skip_duplicates` is
/// not set, and where reading or writing fails.
pub fn merge(folders: &[PathBuf], output: &Path, skip_duplicates: bool) -> Result<Merged> {
    let sources: Vec<DatasetReader> =
        folders.iter().map(|folder| DatasetReader::open(folder)).collect::<Result<_>>()?;
    let Some(first) = sources.first() else {
        return Err(PackError::content(output, "merge", "at least one dataset", "none"));
    };
    for source in &sources {
        check_alike(first, source)?;
    }
    let mut writer = DatasetWriter::create(output, union(&sources))?;
    let mut merged = Merged { episodes: 0, duplicates: 0 };
    for source in &sources {
        for entry in source.entries() {
            if !writer.contains(&entry.id) {
                writer.copy_episode(source, entry)?;
                merged.episodes += usize::from(entry.stored.is_some());
            } else if skip_duplicates {
                merged.duplicates += 1;
            } else {
                let expected = "episodes that no dataset before has (or leave to skip duplicates)";
                return Err(PackError::content(source.folder(), "episode", expected, &entry.id));
            }
        }
    }
    writer.close()?;
    Ok(merged)
}

fn check_alike(first: &DatasetReader, other: &DatasetReader) -> Result<()> {
    let (a, b) = (first.config(), other.config());
    let differing = [
        ("container", a.container == b.container),
        ("rig", a.rig == b.rig),
        ("colour encoding", a.storage.color == b.storage.color),
        ("depth encoding", a.storage.depth == b.storage.depth),
    ];
    match differing.iter().find(|(_, same)| !same) {
        None => Ok(()),
        Some((what, _)) => {
            let expected = format!("that of {}", first.folder().display());
            Err(PackError::content(other.folder(), *what, expected, "another"))
        }
    }
}

fn union(sources: &[DatasetReader]) -> DatasetConfig {
    let mut config = sources[0].config().clone();
    let mut provenances = vec![config.provenance.clone()];
    for source in &sources[1..] {
        let other = source.config();
        let new: Vec<_> =
            other.licences.iter().filter(|l| !config.licences.contains(l)).cloned().collect();
        config.licences.extend(new);
        if !provenances.contains(&other.provenance) {
            provenances.push(other.provenance.clone());
        }
    }
    if provenances.len() > 1 {
        config.provenance = serde_json::json!({ "merged_from": provenances });
    }
    config
}
