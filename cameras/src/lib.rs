//! Camera models, rigs (where cameras are mounted) and the observations they yield.
//!
//! Camera frames are OpenCV's: x right, y down, z forward. Depth is z-depth in metres. Images are
//! row-major from the top left.

pub mod error;
pub mod intrinsics;
pub mod observation;
pub mod rig;

pub use error::RigError;
pub use intrinsics::Intrinsics;
pub use observation::{CameraFrame, CloudPoint, Observation, SegmentLabel};
pub use rig::{CameraMount, CameraSpec, Rig};
