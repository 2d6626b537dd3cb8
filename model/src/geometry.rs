//! Shapes attached to links and scene bodies.

use std::sync::Arc;

use crate::{Material, Pose, TriMesh};

/// A geometric shape in its own frame, metres.
#[derive(Debug, Clone)]
pub enum Shape {
    /// Box centred on the origin; full edge lengths.
    Box {
        /// Edge lengths along x, y, z.
        size: [f64; 3],
    },
    /// Cylinder centred on the origin, axis along z.
    Cylinder {
        /// Radius.
        radius: f64,
        /// Full length along z.
        length: f64,
    },
    /// Sphere centred on the origin.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// Triangle meshes of one file, one per material; the scale is already applied.
    Mesh {
        /// The file the meshes came from, as the user named it.
        source: String,
        /// Sub-meshes by material, shared between all uses of the file.
        meshes: Arc<Vec<TriMesh>>,
    },
}

/// A shape placed in a link's or body's frame.
#[derive(Debug, Clone)]
pub struct Part {
    /// Name for reports and for selecting parts (handles): the element's own name where it has
    /// one, else the mesh file's stem, else the shape's kind.
    pub name: String,
    /// Pose of the shape in the link's or body's frame.
    pub link_from_part: Pose,
    /// The shape.
    pub shape: Shape,
    /// Appearance that overrides the mesh's own, where the file states one.
    pub material: Option<Material>,
}

impl Part {
    /// The part's triangles in the frame of its link or body: primitives are tessellated
    /// (cylinders with 32 sides, spheres with 32 x 16 facets), mesh materials are kept unless
    /// [`Part::material`] overrides them.
    pub fn triangulate(&self) -> Vec<TriMesh> {
        crate::mesh_io::tessellate::part_meshes(self)
    }
}
