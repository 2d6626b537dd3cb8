//! What can be wrong with a rig.

use std::path::PathBuf;

/// Why a rig cannot be used. Every message says what was expected, what was found and where.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The file could not be read.
    #[error("{}: cannot read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The text is not a rig.
    #[error("{context}: {message}")]
    Syntax {
        /// The file or preset.
        context: String,
        /// Where and what.
        message: String,
    },
    /// A value is outside its range.
    #[error("{context}: camera \"{camera}\": {message}")]
    BadValue {
        /// The file or preset.
        context: String,
        /// The camera.
        camera: String,
        /// What was expected and what was found.
        message: String,
    },
    /// There is no such preset.
    #[error("unknown rig preset \"{name}\"; valid choices: {}", choices.join(", "))]
    UnknownPreset {
        /// The name asked for.
        name: String,
        /// The presets.
        choices: Vec<String>,
    },
    /// A camera is mounted on a link that the robot does not have.
    #[error(
        "rig \"{rig}\": camera \"{camera}\": unknown link \"{link}\"; valid choices: {}",
        choices.join(", ")
    )]
    UnknownLink {
        /// The rig.
        rig: String,
        /// The camera.
        camera: String,
        /// The link asked for.
        link: String,
        /// Aliases and links.
        choices: Vec<String>,
    },
    /// A sensor's value is outside its range.
    #[error("{context}: {message}")]
    BadSensor {
        /// The file or preset.
        context: String,
        /// What was expected and what was found.
        message: String,
    },
    /// There is no such sensor preset.
    #[error("unknown sensor preset \"{name}\"; valid choices: {}", choices.join(", "))]
    UnknownSensor {
        /// The name asked for.
        name: String,
        /// The presets.
        choices: Vec<String>,
    },
}
