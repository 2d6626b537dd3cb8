//! Mesh files in, and primitives as meshes.
//!
//! Every reader returns metres in the file's own axes, with two conventions applied: glTF, which is
//! Y up by definition, is turned Z up; COLLADA's `<up_axis>` is ignored, as RViz, MoveIt and Gazebo
//! ignore it (robot files are modelled against that behaviour and often state the wrong axis).

use std::path::Path;

use crate::{ModelError, TriMesh};

mod assemble;
mod cache;
mod dae;
pub mod gltf;
mod obj;
mod polygon;
mod stl;
pub mod tessellate;
mod texture;
mod transform;

pub use cache::MeshCache;
pub use transform::{placed, scaled};

/// The file name extensions that [`load`] reads.
pub const EXTENSIONS: [&str; 5] = ["obj", "stl", "dae", "gltf", "glb"];

/// What a mesh file holds.
#[derive(Debug, Clone, Default)]
pub struct MeshFile {
    /// One mesh per material (and per node, where the format has nodes).
    pub meshes: Vec<TriMesh>,
    /// What was missing or odd and did not stop the load, in the user's words.
    pub notes: Vec<String>,
}

/// Loads the meshes of a file, by its extension; see [`EXTENSIONS`].
///
/// # Errors
/// [`ModelError`] naming the file: unreadable, unknown extension, malformed, no triangles, an index
/// out of range, a vertex that is not finite.
pub fn load(path: &Path) -> Result<Vec<TriMesh>, ModelError> {
    load_with_notes(path).map(|file| file.meshes)
}

/// [`load`], with what was missing or odd in the file.
///
/// # Errors
/// As [`load`].
pub fn load_with_notes(path: &Path) -> Result<MeshFile, ModelError> {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    let read = || std::fs::read(path).map_err(|e| ModelError::read(path, e));
    let file = match extension.as_str() {
        "obj" => obj::parse(path, &read()?)?,
        "stl" => stl::parse(path, &read()?)?,
        "dae" => dae::parse(path, &read()?)?,
        "gltf" | "glb" => gltf::load_flat(path)?,
        _ => {
            return Err(ModelError::invalid(
                path,
                format!(
                    "unknown mesh format \"{extension}\"; valid choices: {}",
                    EXTENSIONS.join(", ")
                ),
            ));
        }
    };
    check(path, &file.meshes)?;
    Ok(file)
}

/// Refuses meshes that later stages could not work with.
fn check(path: &Path, meshes: &[TriMesh]) -> Result<(), ModelError> {
    if meshes.iter().all(|mesh| mesh.triangles.is_empty()) {
        return Err(ModelError::invalid(path, "the file has no triangles"));
    }
    for mesh in meshes {
        if let Some(index) = mesh.positions.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
            return Err(ModelError::invalid(
                path,
                format!("vertex {index} is not finite: {:?}", mesh.positions[index]),
            ));
        }
        let count = mesh.positions.len();
        if let Some(bad) = mesh.triangles.iter().flatten().find(|&&v| v as usize >= count) {
            return Err(ModelError::invalid(
                path,
                format!("a triangle names vertex {bad}, but there are {count} vertices"),
            ));
        }
    }
    Ok(())
}
