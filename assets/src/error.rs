//! What can go wrong while assets are written.

use std::path::{Path, PathBuf};

use akrobat_model::ModelError;

/// The error of everything that writes assets.
#[derive(Debug, thiserror::Error)]
pub enum AssetError {
    /// A file or folder could not be written.
    #[error("{}: cannot write: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A texture could not be encoded or written.
    #[error("{}: cannot write texture: {source}", path.display())]
    Texture {
        /// The file.
        path: PathBuf,
        /// What the encoder said.
        source: image::ImageError,
    },
    /// A folder that would be written holds something already.
    #[error("{}: the folder is not empty; name a new one, or remove it first", folder.display())]
    Occupied {
        /// The folder.
        folder: PathBuf,
    },
    /// A description does not form a kinematic tree.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A dimension outside what can be built.
    #[error("{what}: expected {expected}, got {value}")]
    Dimension {
        /// The appliance and its dimension.
        what: &'static str,
        /// The valid range, in words.
        expected: &'static str,
        /// The value in question, metres.
        value: f64,
    },
    /// A parameter that a class of objects does not have.
    #[error("{class}: has no {parameter} to choose")]
    NotApplicable {
        /// The class.
        class: &'static str,
        /// The parameter.
        parameter: &'static str,
    },
    /// No attempt at a scene passed its checks.
    #[error("scene of seed {seed}: no attempt passed the checks; the last one failed by {reason}")]
    Scene {
        /// The seed.
        seed: u64,
        /// What the last attempt failed by.
        reason: String,
    },
    /// A manifest could not be expressed as JSON.
    #[error("cannot write a manifest: {0}")]
    Manifest(serde_json::Error),
}

impl AssetError {
    pub(crate) fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write { path: path.to_path_buf(), source }
    }
}

/// Writes a whole file.
pub(crate) fn write_file(path: &Path, content: impl AsRef<[u8]>) -> Result<(), AssetError> {
    std::fs::write(path, content).map_err(|e| AssetError::write(path, e))
}

/// Makes a folder and the ones above it.
pub(crate) fn make_folder(path: &Path) -> Result<(), AssetError> {
    std::fs::create_dir_all(path).map_err(|e| AssetError::write(path, e))
}
