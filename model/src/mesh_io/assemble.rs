//! Builds an indexed mesh from corners whose position, texture coordinate and normal are indexed
//! separately, as in OBJ and COLLADA.

use std::collections::HashMap;

use crate::TriMesh;

/// Indices of one polygon corner into a file's arrays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Corner {
    pub position: usize,
    pub uv: Option<usize>,
    pub normal: Option<usize>,
}

/// The arrays that corners index.
pub struct Attributes<'a> {
    pub positions: &'a [[f32; 3]],
    /// Texture coordinates with v = 0 at the bottom row, as OBJ and COLLADA have them.
    pub uvs: &'a [[f32; 2]],
    pub normals: &'a [[f32; 3]],
}

/// Collects polygons of one material into a [`TriMesh`], sharing equal corners.
#[derive(Default)]
pub struct Assembler {
    vertex_of_corner: HashMap<Corner, u32>,
    positions: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    normals: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    any_uv: bool,
    lacks_normals: bool,
}

impl Assembler {
    /// Adds a polygon, triangulated.
    ///
    /// # Panics
    /// If a corner's index is out of range; the parsers check that.
    pub fn polygon(&mut self, corners: &[Corner], attributes: &Attributes) {
        let outline: Vec<[f32; 3]> =
            corners.iter().map(|c| attributes.positions[c.position]).collect();
        for triangle in super::polygon::triangulate(&outline) {
            let vertices = triangle.map(|i| self.vertex(corners[i], attributes));
            self.triangles.push(vertices);
        }
    }

    fn vertex(&mut self, corner: Corner, attributes: &Attributes) -> u32 {
        if let Some(&vertex) = self.vertex_of_corner.get(&corner) {
            return vertex;
        }
        let vertex = self.positions.len() as u32;
        self.positions.push(attributes.positions[corner.position]);
        let [u, v] = corner.uv.map_or([0.0, 1.0], |i| attributes.uvs[i]);
        self.uvs.push([u, 1.0 - v]);
        let normal = corner.normal.map(|i| attributes.normals[i]).and_then(unit);
        self.normals.push(normal.unwrap_or_default());
        self.any_uv |= corner.uv.is_some();
        self.lacks_normals |= normal.is_none();
        self.vertex_of_corner.insert(corner, vertex);
        vertex
    }

    /// The mesh, without material; `None` where no polygon had an area to triangulate.
    pub fn finish(self) -> Option<TriMesh> {
        (!self.triangles.is_empty()).then(|| TriMesh {
            positions: self.positions,
            normals: if self.lacks_normals { Vec::new() } else { self.normals },
            uvs: if self.any_uv { self.uvs } else { Vec::new() },
            triangles: self.triangles,
            ..TriMesh::default()
        })
    }
}

/// `v` at length one; `None` where it has no direction.
pub fn unit(v: [f32; 3]) -> Option<[f32; 3]> {
    let length = v.iter().map(|x| x * x).sum::<f32>().sqrt();
    (length > 1e-12 && length.is_finite()).then(|| v.map(|x| x / length))
}
