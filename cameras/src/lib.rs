//! Camera models, rigs (where cameras are mounted), sensor specifications and the observations they
//! yield.
//!
//! Camera frames are OpenCV's: x right, y down, z forward. Depth is z-depth in metres. Images are
//! row-major from the top left.

pub mod distortion;
pub mod error;
pub mod intrinsics;
pub mod modality;
pub mod model;
pub mod mount;
pub mod observation;
pub mod pose_values;
pub mod rig;
pub mod sensor;

pub use distortion::{BrownConrady, Distortion, KannalaBrandt};
pub use error::RigError;
pub use intrinsics::Intrinsics;
pub use modality::Modality;
pub use model::CameraModel;
pub use mount::{CameraMount, Reference};
pub use observation::{CameraFrame, CloudPoint, Observation, SegmentLabel, SegmentTable};
pub use pose_values::PoseValues;
pub use rig::{CameraSpec, Jitter, Rig};
pub use sensor::Sensor;
