//! What real sensors make of ideal images. The models and their sources are documented with their
//! specifications in [`akrobat_cameras::sensor`].
//!
//! Random numbers depend on the user's seed, the episode, the camera and the frame alone.

pub mod color;
pub mod kinect;
pub mod redwood;
pub mod stereo;

pub use stereo::StereoPair;
