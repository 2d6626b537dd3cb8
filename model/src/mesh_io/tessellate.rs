//! Parts as triangles.

use crate::{Part, TriMesh};

/// The triangles of a part in its link's frame; see [`Part::triangulate`].
pub fn part_meshes(_part: &Part) -> Vec<TriMesh> {
    Vec::new()
}
