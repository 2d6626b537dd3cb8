//! What can go wrong while rendering.

use akrobat_cameras::RigError;
use akrobat_model::ModelError;

use crate::gates::Refusal;

/// Why frames could not be rendered.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A file, a name or a value of the user's input is wrong.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The rig is invalid or does not fit the robot.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// The trajectory does not belong to this task, or is not whole.
    #[error("trajectory {id}: {message}")]
    Trajectory {
        /// Identity of the trajectory.
        id: String,
        /// What was expected and what was got.
        message: String,
    },
    /// The scene holds more than a backend or the output format can take.
    #[error("scene {scene}: {message}")]
    Scene {
        /// Name of the scene.
        scene: String,
        /// What was expected and what was got.
        message: String,
    },
    /// A frame is unfit for a dataset.
    #[error("trajectory {id}, frame {frame}: {refusal}")]
    Refused {
        /// Identity of the trajectory.
        id: String,
        /// Number of the frame.
        frame: u32,
        /// What is wrong with it.
        refusal: Refusal,
    },
    /// The backend's device is missing or failed.
    #[error("backend {backend}: {message}")]
    Device {
        /// Name of the backend.
        backend: &'static str,
        /// What failed, and what to do about it where that is known.
        message: String,
    },
}
