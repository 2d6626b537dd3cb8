//! Triangle meshes and their materials.

use std::sync::Arc;

/// A surface appearance: metallic-roughness PBR, as glTF defines it.
#[derive(Debug, Clone)]
pub struct Material {
    /// Name in the source file, for reports.
    pub name: String,
    /// Linear RGBA factor in 0..1, multiplied with the texture where there is one.
    pub base_color: [f32; 4],
    /// sRGB texture, row 0 at the top; texture coordinate v = 0 is the *top* row.
    pub base_color_texture: Option<Arc<image::RgbaImage>>,
    /// 0 dielectric .. 1 metal.
    pub metallic: f32,
    /// 0 mirror .. 1 matt.
    pub roughness: f32,
}

impl Default for Material {
    fn default() -> Self {
        Self {
            name: "default".into(),
            base_color: [0.7, 0.7, 0.7, 1.0],
            base_color_texture: None,
            metallic: 0.0,
            roughness: 0.8,
        }
    }
}

/// An indexed triangle mesh with one material, metres, counter-clockwise front faces.
#[derive(Debug, Clone, Default)]
pub struct TriMesh {
    /// Vertex positions.
    pub positions: Vec<[f32; 3]>,
    /// Unit vertex normals: empty, or one per position.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates: empty, or one per position.
    pub uvs: Vec<[f32; 2]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Appearance of every triangle.
    pub material: Material,
}

impl TriMesh {
    /// Smallest and largest corner of the axis-aligned bounding box; `None` without vertices.
    pub fn bounds(&self) -> Option<([f32; 3], [f32; 3])> {
        let first = *self.positions.first()?;
        Some(self.positions.iter().fold((first, first), |(low, high), p| {
            (std::array::from_fn(|i| low[i].min(p[i])), std::array::from_fn(|i| high[i].max(p[i])))
        }))
    }

    /// The three corners of triangle `index`.
    pub fn corners(&self, index: usize) -> [[f32; 3]; 3] {
        self.triangles[index].map(|vertex| self.positions[vertex as usize])
    }
}
