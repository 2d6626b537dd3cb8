//! Dealing episodes to parts for training and evaluation.
//!
//! Whole groups go to one part, so that what evaluation sees in `valid` and `test` was never trained on.
//! `test_seen` holds episodes apart whose start states training does see: the paper's seen and unseen
//! conditions. The outcome depends on the episodes and the seed alone, not on their order.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::description::{DESCRIPTION, Description};
use super::manifest::{self, MANIFEST, ManifestEntry, StoredEpisode};
use crate::error::{PackError, Result};
use crate::folder_lock::FolderLock;

/// What is kept together.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum SplitBy {
    /// Episodes of one scene.
    Scene,
    /// Episodes that start with the same joint positions.
    #[default]
    StartState,
    /// Episodes with one object.
    Object,
    /// Nothing: every episode by itself.
    Episode,
}

/// How episodes are dealt.
#[derive(Debug, Clone, PartialEq)]
pub struct SplitConfig {
    /// What is kept together.
    pub by: SplitBy,
    /// Fractions of the episodes for `train`, `valid` and `test`; they add up to 1.
    pub fractions: [f64; 3],
    /// Fraction that is taken from `train` for `test_seen`.
    pub seen: f64,
    /// Another seed deals otherwise.
    pub seed: u64,
}

/// Names of the parts that the fractions stand for.
const PARTS: [&str; 3] = ["train", "valid", "test"];

/// Name of the part whose start states training sees, too.
const TEST_SEEN: &str = "test_seen";

/// Deals the episodes of a dataset and notes it in the manifest. Gives the number of episodes of each part.
///
/// # Errors
/// [`PackError::Content`] where the fractions are not possible or the dataset is not complete, and where
/// reading or writing fails.
pub fn split(folder: &Path, config: &SplitConfig) -> Result<BTreeMap<String, usize>> {
    let [train, valid, test] = config.fractions;
    let in_range = |f: &f64| (0.0..=1.0).contains(f);
    if !config.fractions.iter().all(in_range)
        || (train + valid + test - 1.0).abs() > 1e-6
        || !(0.0..=train).contains(&config.seen)
    {
        let got = format!("{train}, {valid}, {test}, and {} of train seen", config.seen);
        return Err(PackError::content(folder, "fractions", "parts of 1 that add up to it", got));
    }
    let _lock = FolderLock::exclusive(folder)?;
    let description = Description::read(folder)?;
    if !description.complete {
        let path = folder.join(DESCRIPTION);
        return Err(PackError::content(&path, "complete", "a complete dataset", "false"));
    }
    let (mut entries, _) = manifest::read(folder)?;
    deal(&mut entries, config);
    let lines = manifest::to_lines(&entries);
    crate::whole_file::write(&folder.join(MANIFEST), lines.as_bytes())?;
    let sha256 = akrobat_model::hash::of_bytes(lines.as_bytes());
    Description::complete(description.config, sha256).write(folder)?;
    let mut counts = BTreeMap::new();
    for part in entries.into_iter().filter_map(|entry| entry.split) {
        *counts.entry(part).or_default() += 1;
    }
    Ok(counts)
}

fn deal(entries: &mut [ManifestEntry], config: &SplitConfig) {
    let group_of = |entry: &ManifestEntry, stored: &StoredEpisode| match config.by {
        SplitBy::Scene => stored.scene_id.clone(),
        SplitBy::StartState => stored.start_state.clone(),
        SplitBy::Object => stored.object_id.clone(),
        SplitBy::Episode => entry.id.clone(),
    };
    let mut groups: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (index, entry) in entries.iter().enumerate() {
        if let Some(stored) = &entry.stored {
            groups.entry(group_of(entry, stored)).or_default().push(index);
        }
    }
    let mut groups: Vec<(String, Vec<usize>)> = groups
        .into_iter()
        .map(|(name, members)| (shuffle_key(config.seed, &name), members))
        .collect();
    groups.sort();
    let parts = parts_of(&groups, config.fractions);
    for ((_, members), part) in groups.iter().zip(&parts) {
        for &index in members {
            entries[index].split = Some(PARTS[*part].to_owned());
        }
    }
    hold_out_seen(entries, config);
}

/// Order that looks random and does not depend on anything but the seed.
fn shuffle_key(seed: u64, name: &str) -> String {
    akrobat_model::hash::of_bytes(format!("{seed}/{name}").as_bytes())
}

/// Part of each group: always the one that lacks most; then none that is wanted stays empty.
fn parts_of(groups: &[(String, Vec<usize>)], fractions: [f64; 3]) -> Vec<usize> {
    let total: usize = groups.iter().map(|(_, members)| members.len()).sum();
    let mut lacking = fractions.map(|fraction| fraction * total as f64);
    let mut parts = Vec::with_capacity(groups.len());
    for (_, members) in groups {
        let part = (0..3).rev().max_by(|&a, &b| lacking[a].total_cmp(&lacking[b])).unwrap_or(0);
        lacking[part] -= members.len() as f64;
        parts.push(part);
    }
    for wanted in 0..3 {
        if fractions[wanted] == 0.0 || parts.contains(&wanted) {
            continue;
        }
        let count_of = |part: usize| parts.iter().filter(|&&p| p == part).count();
        let giver = (0..3).max_by_key(|&part| count_of(part)).unwrap_or(0);
        if count_of(giver) > 1 {
            let last = parts.iter().rposition(|&part| part == giver);
            parts[last.expect("the giver has more than one group")] = wanted;
        }
    }
    parts
}

/// Moves episodes from `train` to `test_seen`, of start states of which at least one more stays.
fn hold_out_seen(entries: &mut [ManifestEntry], config: &SplitConfig) {
    let stored = entries.iter().filter(|entry| entry.stored.is_some()).count();
    let mut wanted = (config.seen * stored as f64).round() as usize;
    let mut training: Vec<(String, usize, String)> = Vec::new();
    let mut remaining: BTreeMap<String, usize> = BTreeMap::new();
    for (index, entry) in entries.iter().enumerate() {
        if let (Some("train"), Some(stored)) = (entry.split.as_deref(), &entry.stored) {
            let state = stored.start_state.clone();
            *remaining.entry(state.clone()).or_default() += 1;
            training.push((shuffle_key(config.seed, &entry.id), index, state));
        }
    }
    training.sort();
    for (_, index, state) in training {
        let left = remaining.get_mut(&state).expect("every state was counted");
        if wanted > 0 && *left > 1 {
            *left -= 1;
            wanted -= 1;
            entries[index].split = Some(TEST_SEEN.to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_are_dealt_whole_and_none_stays_empty() {
        let groups = |sizes: &[usize]| -> Vec<(String, Vec<usize>)> {
            sizes.iter().map(|&size| (String::new(), vec![0; size])).collect()
        };
        assert_eq!(parts_of(&groups(&[5]), [0.8, 0.1, 0.1]), [0]);
        let mut three = parts_of(&groups(&[5, 5, 5]), [0.8, 0.1, 0.1]);
        three.sort_unstable();
        assert_eq!(three, [0, 1, 2]);
        let hundred = parts_of(&groups(&[1; 100]), [0.8, 0.1, 0.1]);
        let count = |part| hundred.iter().filter(|&&p| p == part).count();
        assert_eq!([0, 1, 2].map(count), [80, 10, 10]);
        assert!(parts_of(&groups(&[1; 9]), [1.0, 0.0, 0.0]).iter().all(|&part| part == 0));
    }
}
