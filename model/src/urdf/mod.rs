//! URDF in and out.

mod inertia;
mod joint;
mod link;
mod read;
mod resolve;
mod write;
mod xml;

pub use read::{UrdfFile, load, read};
pub use write::{to_string, write_with_meshes};
