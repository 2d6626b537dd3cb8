//! Reading every byte of a dataset back and looking for what should not be there.
//!
//! Arrays are read a few frames at a time, so memory depends on the size of an image, not of a shard.

mod arrays;
mod episode;
mod log;

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use akrobat_model::events::{Event, Observer};
use serde::Serialize;

use super::description::{DESCRIPTION, Description};
use super::manifest::{Container, DatasetConfig, MANIFEST, Status, StoredEpisode};
use super::reader::{DatasetReader, EpisodeReader};
use super::writer::{SHARD_FOLDER, sha256_of_file};
use crate::error::Result;

/// Name of the progress stage.
const STAGE: &str = "validating";

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
pub fn validate(folder: &Path, observer: &dyn Observer) -> Result<Report> {
    let started = std::time::Instant::now();
    let dataset = DatasetReader::open(folder)?;
    let mut report = Report::default();
    check_description(&dataset, &mut report);
    check_manifest(&dataset, &mut report);
    check_files(&dataset, &mut report);
    let total = dataset.episodes().count() as u64;
    observer.event(&Event::StageStarted { stage: STAGE, total: Some(total) });
    for (id, stored) in dataset.episodes() {
        if observer.cancelled() {
            report.add("dataset", "validation was interrupted; the rest was not looked at");
            break;
        }
        report.episodes += 1;
        report.frames += u64::from(stored.frames);
        let result = dataset
            .file_of(stored)
            .and_then(|path| check_stored(&path, id, stored, dataset.config(), &mut report));
        if let Err(error) = result {
            report.add(format!("{} episode {id}", stored.shard), error.to_string());
        }
        observer.event(&Event::Progress { stage: STAGE, done: report.episodes });
    }
    let seconds = started.elapsed().as_secs_f64();
    observer.event(&Event::StageFinished { stage: STAGE, seconds });
    Ok(report)
}

/// Reads one stored episode completely.
///
/// # Errors
/// Where it cannot be read at all.
pub(super) fn check_stored(
    path: &Path,
    id: &str,
    stored: &StoredEpisode,
    config: &DatasetConfig,
    report: &mut Report,
) -> Result<()> {
    match config.container {
        Container::Hdf5 => {
            let episode = EpisodeReader::open(path, &stored.key)?;
            episode::check(&episode, id, stored, config, report)
        }
        Container::Mcap => log::check(path, id, stored, config, report),
    }
}

fn check_description(dataset: &DatasetReader, report: &mut Report) {
    if !dataset.is_complete() {
        report.add(DESCRIPTION, "the dataset was not completed; resume or repair it");
    }
    match Description::is_sealed(dataset.folder()) {
        Ok(true) => {}
        Ok(false) => report.add(DESCRIPTION, "its own checksum does not fit: damaged or edited"),
        Err(error) => report.add(DESCRIPTION, error.to_string()),
    }
    if let Some(expected) = &dataset.description().manifest_sha256 {
        match sha256_of_file(&dataset.folder().join(MANIFEST)) {
            Ok(found) if found == *expected => {}
            Ok(found) => report
                .add(MANIFEST, format!("the checksum is {found}, {DESCRIPTION} says {expected}")),
            Err(error) => report.add(MANIFEST, error.to_string()),
        }
    }
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
    let mut listed = BTreeMap::new();
    for (id, stored) in dataset.episodes() {
        let sha256 = listed.entry(&stored.shard).or_insert(&stored.shard_sha256);
        if *sha256 != &stored.shard_sha256 {
            let message = format!("episode {id} states another checksum than those before it");
            report.add(&stored.shard, message);
        }
    }
    for (name, expected) in &listed {
        let path = dataset.folder().join(name);
        match sha256_of_file(&path) {
            Ok(found) if found == **expected => {
                report.bytes += std::fs::metadata(&path).map_or(0, |m| m.len());
            }
            Ok(found) => {
                report.add(*name, format!("the checksum is {found}, the manifest says {expected}"))
            }
            Err(error) => report.add(*name, error.to_string()),
        }
    }
    let found = std::fs::read_dir(dataset.folder().join(SHARD_FOLDER)).into_iter().flatten();
    let mut unlisted: Vec<String> = found
        .flatten()
        .map(|entry| format!("{SHARD_FOLDER}/{}", entry.file_name().to_string_lossy()))
        .filter(|name| !listed.contains_key(name))
        .collect();
    unlisted.sort();
    for name in unlisted {
        report.add(name, "no line of the manifest lists this file");
    }
}
