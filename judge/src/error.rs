//! What can be wrong with what a judge is built from.

use akrobat_model::ModelError;

/// Why a judge cannot be built.
#[derive(Debug, thiserror::Error)]
pub enum JudgeError {
    /// A tolerance is negative or not finite.
    #[error("judge configuration: {name} = {value}, expected a finite number that is not negative")]
    Config {
        /// Name of the value.
        name: &'static str,
        /// The value.
        value: f64,
    },
    /// A collision sphere is attached to nothing, or its numbers are not finite, or its radius is negative.
    #[error("collision sphere {index}: {message}")]
    Sphere {
        /// Index in the list of spheres.
        index: usize,
        /// What was expected and what was got.
        message: String,
    },
    /// A contact exception names a link or a part that does not exist.
    #[error(transparent)]
    Name(#[from] ModelError),
    /// A collision shape has vertices that are not finite.
    #[error("{owner}: collision shape \"{part}\" has vertices that are not finite")]
    Shape {
        /// Link or body.
        owner: String,
        /// Part.
        part: String,
    },
}
