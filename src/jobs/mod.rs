//! One job, many processes: who makes which part, and what happens when one of them dies.
//!
//! A job is cut into parts whose content is known before anything is rendered, so that a part has the
//! same bytes whoever makes it. A worker makes a part in an attempt folder of its own and renames that into place
//! when it is whole: the first wins, and nothing is doubled or half-written. The ledger only keeps workers from
//! making the same part at once; were it lost, the parts that are there would be found again.

pub mod ledger;
pub mod slurm;

use std::path::{Path, PathBuf};

pub use ledger::{Claim, Ledger};

/// Folder of a running job in its output; it is removed when the job is complete.
pub const JOB_FOLDER: &str = ".job";

/// Where a job keeps what is not part of its result.
#[derive(Debug, Clone)]
pub struct JobFolder(PathBuf);

impl JobFolder {
    /// The job folder of an output.
    pub fn of(output: &Path) -> Self {
        Self(output.join(JOB_FOLDER))
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// The ledger's file.
    pub fn ledger(&self) -> PathBuf {
        self.0.join("ledger.sqlite")
    }

    /// The file that says which job this is.
    pub fn fingerprint(&self) -> PathBuf {
        self.0.join("fingerprint")
    }

    /// Folder of the attempts, one folder each.
    pub fn attempts(&self) -> PathBuf {
        self.0.join("attempts")
    }

    /// Where part `number` is once it is whole.
    pub fn part(&self, number: usize) -> PathBuf {
        self.0.join("parts").join(format!("{number:06}"))
    }
}
