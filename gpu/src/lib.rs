//! Access to graphics processors, shared by the planner and the renderer.
//!
//! [`Context`] opens one device, [`StorageBuffer`] and [`Readback`] move typed data to and from it,
//! [`Shader`] composes and validates WGSL. Nothing here needs 64-bit floats or subgroup operations,
//! so every WebGPU-class device and the software Vulkan driver of Mesa serve.

mod adapter;
mod buffer;
mod context;
mod error;
mod shader;

pub use adapter::{AdapterChoice, AdapterDescription, AdapterKind, adapters};
pub use buffer::{Readback, StorageBuffer};
pub use context::Context;
pub use error::GpuError;
pub use shader::{Shader, ShaderPart};
pub use wgpu;
