//! What can go wrong while files are written or read.

use std::path::{Path, PathBuf};

/// Result of everything in this crate.
pub type Result<T> = std::result::Result<T, PackError>;

/// What went wrong with which file. [`PackError::exit_code`] tells bad input from a failing machine.
#[derive(Debug, thiserror::Error)]
pub enum PackError {
    /// The machine failed while writing or reading: full disk, lost mount, I/O error.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// An input file cannot be opened.
    #[error("{}: cannot read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The output cannot be created where it was asked for.
    #[error("{}: cannot write here: {source}", path.display())]
    Unwritable {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not of its format: truncated, not HDF5, damaged.
    #[error("{}: {message}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What was found, in the words of the reading library where it spoke.
        message: String,
    },
    /// A dataset or attribute of a file is not what the format demands.
    #[error("{}: {item}: expected {expected}, got {got}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Path of the dataset, attribute or manifest line in the file.
        item: String,
        /// What the format demands.
        expected: String,
        /// What the file holds.
        got: String,
    },
    /// Data that was handed over to be written contradicts itself.
    #[error("{}: cannot write {item}: expected {expected}, got {got}", path.display())]
    Inconsistent {
        /// The file that was to be written.
        path: PathBuf,
        /// The value.
        item: String,
        /// What it has to be.
        expected: String,
        /// What it is.
        got: String,
    },
    /// The HDF5 or MCAP library refused to write, for no reason the system gave.
    #[error("{}: writing {item} failed: {message}", path.display())]
    Library {
        /// The file.
        path: PathBuf,
        /// What was being written.
        item: String,
        /// What the library said.
        message: String,
    },
}

impl PackError {
    /// Exit code of the command line: 1 where the machine failed, 2 where the input or the chosen
    /// output place is at fault.
    pub fn exit_code(&self) -> i32 {
        match self {
            Self::Io { .. } | Self::Library { .. } => 1,
            Self::Read { .. }
            | Self::Unwritable { .. }
            | Self::Damaged { .. }
            | Self::Content { .. }
            | Self::Inconsistent { .. } => 2,
        }
    }

    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_path_buf(), source }
    }

    pub(crate) fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Read { path: path.to_path_buf(), source }
    }

    /// A failure to create an output: a full disk is the machine's fault, all else the place's.
    pub(crate) fn create(path: &Path, source: std::io::Error) -> Self {
        match source.kind() {
            std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
                Self::io(path, source)
            }
            _ => Self::Unwritable { path: path.to_path_buf(), source },
        }
    }

    pub(crate) fn damaged(path: &Path, message: impl Into<String>) -> Self {
        Self::Damaged { path: path.to_path_buf(), message: message.into() }
    }

    pub(crate) fn content(
        path: &Path,
        item: impl Into<String>,
        expected: impl Into<String>,
        got: impl Into<String>,
    ) -> Self {
        Self::Content {
            path: path.to_path_buf(),
            item: item.into(),
            expected: expected.into(),
            got: got.into(),
        }
    }

    pub(crate) fn inconsistent(
        path: &Path,
        item: impl Into<String>,
        expected: impl Into<String>,
        got: impl Into<String>,
    ) -> Self {
        Self::Inconsistent {
            path: path.to_path_buf(),
            item: item.into(),
            expected: expected.into(),
            got: got.into(),
        }
    }
}
