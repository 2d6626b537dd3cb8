//! Which trajectories of a file are meant.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use akrobat_model::{Trajectory, TrajectorySet};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::selection;
use crate::Error;

/// Positions in a trajectory file, ascending: `0,5-9`.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(try_from = "String", into = "String")]
#[schemars(with = "String")]
pub struct EpisodeList(Vec<usize>);

impl FromStr for EpisodeList {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let number = |text: &str| {
            text.trim()
                .parse::<usize>()
                .map_err(|_| format!("expected numbers and ranges such as 0,5-9, got \"{text}\""))
        };
        const MOST: usize = 10_000_000;
        let mut episodes = Vec::new();
        for item in text.split(',') {
            let (first, last) = item.split_once('-').unwrap_or((item, item));
            let (first, last) = (number(first)?, number(last)?);
            if first > last {
                return Err(format!("the range {item} is empty: its end comes first"));
            }
            if last - first >= MOST {
                return Err(format!("the range {item} has more than {MOST} episodes"));
            }
            episodes.extend(first..=last);
        }
        episodes.sort_unstable();
        episodes.dedup();
        Ok(Self(episodes))
    }
}

impl TryFrom<String> for EpisodeList {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<EpisodeList> for String {
    fn from(list: EpisodeList) -> Self {
        list.to_string()
    }
}

impl From<EpisodeList> for Vec<usize> {
    fn from(EpisodeList(episodes): EpisodeList) -> Self {
        episodes
    }
}

impl From<Vec<usize>> for EpisodeList {
    fn from(mut episodes: Vec<usize>) -> Self {
        episodes.sort_unstable();
        episodes.dedup();
        Self(episodes)
    }
}

impl fmt::Display for EpisodeList {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        for run in self.0.chunk_by(|a, b| a + 1 == *b) {
            match run {
                [single] => write!(f, "{separator}{single}")?,
                _ => write!(f, "{separator}{}-{}", run[0], run[run.len() - 1])?,
            }
            separator = ",";
        }
        Ok(())
    }
}

/// Which trajectories are rendered; what is not given does not matter.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EpisodeFilter {
    /// Positions in the trajectory file, such as `0,5-9`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub episodes: Option<EpisodeList>,
    /// Names of objects.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<String>,
    /// Names of scenes.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub scenes: Vec<String>,
    /// Only those that the judge accepted (`true`), or only the others (`false`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub success: Option<bool>,
}

impl EpisodeFilter {
    /// This filter, with what another one says instead of what it says itself.
    #[must_use]
    pub fn narrowed(&self, by: &Self) -> Self {
        let names = |own: &Vec<String>, other: &Vec<String>| {
            if other.is_empty() { own.clone() } else { other.clone() }
        };
        Self {
            episodes: by.episodes.clone().or_else(|| self.episodes.clone()),
            objects: names(&self.objects, &by.objects),
            scenes: names(&self.scenes, &by.scenes),
            success: by.success.or(self.success),
        }
    }

    /// Positions of the wanted trajectories of a file; none, where its object or scene is not wanted.
    ///
    /// # Errors
    /// [`Error::Usage`] where a position is beyond the file's end.
    pub fn select(&self, file: &Path, set: &TrajectorySet) -> Result<Vec<usize>, Error> {
        let wanted = self.episodes.as_ref().map(|EpisodeList(wanted)| wanted.as_slice());
        let wanted = selection(file, wanted, set.trajectories.len())?;
        let named = |names: &[String], name: &String| names.is_empty() || names.contains(name);
        if !named(&self.objects, &set.header.object_id)
            || !named(&self.scenes, &set.header.scene_id)
        {
            return Ok(Vec::new());
        }
        let accepted =
            |t: &Trajectory| t.verdict.as_ref().is_some_and(|verdict| verdict.accepted());
        let fits = |&index: &usize| {
            self.success.is_none_or(|success| accepted(&set.trajectories[index]) == success)
        };
        Ok(wanted.into_iter().filter(fits).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn episode_lists_are_sorted_sets_and_print_as_ranges() {
        let list: EpisodeList = "7, 0,5-7".parse().unwrap();
        assert_eq!(list.0, [0, 5, 6, 7]);
        assert_eq!(list.to_string(), "0,5-7");
        for wrong in ["", "a", "1-", "3-1", "-2", "0-99999999999"] {
            assert!(wrong.parse::<EpisodeList>().is_err(), "{wrong}");
        }
    }
}
