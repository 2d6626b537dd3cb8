//! Mesh files in, and primitives as meshes.

pub mod tessellate;
