//! The error of everything that reads user files.

use std::path::{Path, PathBuf};

/// What is wrong with a user's file or value. Every message says where, what was found and what
/// would have been valid; all of them are exit code 2 on the command line.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file could not be opened or read.
    #[error("{}: cannot read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is there but its content is not what its format demands.
    #[error("{}: {message}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What was expected, what was got, and where.
        message: String,
    },
    /// A name that does not exist where it was looked up.
    #[error("{context}: unknown {what} \"{name}\"; valid choices: {}", choices.join(", "))]
    UnknownName {
        /// The file or section that holds the name.
        context: String,
        /// What kind of thing was looked up: link, joint, body, …
        what: &'static str,
        /// The name that was not found.
        name: String,
        /// The names that exist.
        choices: Vec<String>,
    },
    /// A value outside its valid range.
    #[error("{context}: {message}")]
    BadValue {
        /// The file or section that holds the value.
        context: String,
        /// What was expected and what was got.
        message: String,
    },
}

impl ModelError {
    /// An [`ModelError::Invalid`] from borrowed parts.
    pub fn invalid(path: &Path, message: impl Into<String>) -> Self {
        Self::Invalid { path: path.to_path_buf(), message: message.into() }
    }

    /// An [`ModelError::Read`] from borrowed parts.
    pub fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Read { path: path.to_path_buf(), source }
    }

    /// An [`ModelError::BadValue`].
    pub fn bad_value(context: impl Into<String>, message: impl Into<String>) -> Self {
        Self::BadValue { context: context.into(), message: message.into() }
    }

    /// An [`ModelError::UnknownName`].
    pub fn unknown(
        context: impl Into<String>,
        what: &'static str,
        name: impl Into<String>,
        choices: impl IntoIterator<Item = String>,
    ) -> Self {
        Self::UnknownName {
            context: context.into(),
            what,
            name: name.into(),
            choices: choices.into_iter().collect(),
        }
    }
}
