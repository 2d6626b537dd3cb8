//! A sample of the trajectories of many files.

use std::collections::{BTreeMap, BinaryHeap};
use std::path::PathBuf;

use akrobat_model::hash;
use akrobat_packager::trajectory_file;

use super::episodes::EpisodeFilter;
use crate::Error;

/// Draws `count` of the trajectories that pass a filter; gives their positions by file. Each has a number that only its
/// identity and the seed decide, and the smallest are taken: the sample depends neither on the order of the files
/// nor, as long as a trajectory is in it, on what else there is to draw from.
///
/// # Errors
/// Where a file cannot be read, or a position of the filter is beyond its end.
pub fn sample<'a>(
    files: impl Iterator<Item = &'a PathBuf>,
    filter: &EpisodeFilter,
    count: usize,
    seed: u64,
) -> Result<BTreeMap<PathBuf, Vec<usize>>, Error> {
    // The largest of the smallest is on top.
    let mut drawn: BinaryHeap<(String, &PathBuf, usize)> = BinaryHeap::new();
    for file in files {
        let set = trajectory_file::read(file)?;
        for index in filter.select(file, &set)? {
            let id = &set.trajectories[index].id;
            drawn.push((hash::of_bytes(format!("{seed} {id}").as_bytes()), file, index));
            if drawn.len() > count {
                drawn.pop();
            }
        }
    }
    let mut by_file: BTreeMap<PathBuf, Vec<usize>> = BTreeMap::new();
    for (_, file, index) in drawn {
        by_file.entry(file.clone()).or_default().push(index);
    }
    by_file.values_mut().for_each(|positions| positions.sort_unstable());
    Ok(by_file)
}
