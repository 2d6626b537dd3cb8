//! Replays trajectories and renders what cameras see of them.
//!
//! A [`RenderScene`] is what can be seen, a [`FrameState`] is where everything is at one instant,
//! and a [`Backend`] turns both into images. Every backend follows the image model of [`scene`].

pub mod appearance;
pub mod backend;
mod clusters;
pub mod compare;
pub mod detail;
pub mod enclosure;
pub mod error;
mod front;
pub mod gates;
pub mod handle;
pub mod layers;
pub mod lens;
pub mod lighting;
pub mod observe;
pub mod placement;
pub mod pointcloud;
#[cfg(feature = "wgpu")]
pub mod raster;
mod raycast;
pub mod replay;
pub mod scene;
pub mod seed;
pub mod sensor;
mod shadow;
pub mod soft;
mod srgb;
pub mod supersampling;

pub use appearance::{Appearance, Variation};
pub use backend::{Backend, PlacedCamera};
pub use detail::Detail;
pub use error::RenderError;
pub use lighting::Lighting;
pub use observe::{Episode, EpisodeConfig, EpisodeRenderer};
pub use replay::FrameState;
pub use scene::{BodyGroup, RenderBody, RenderScene};
pub use soft::SoftBackend;
pub use supersampling::Supersampling;
