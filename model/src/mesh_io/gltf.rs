//! glTF 2.0 and GLB, turned from Y up to Z up.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use base64::Engine;
use gltf::mesh::Mode;
use nalgebra::{Matrix3, Matrix4, Rotation3, UnitQuaternion, Vector3};

use super::texture;
use super::transform::mapped;
use super::{MeshFile, placed};
use crate::{Material, ModelError, Pose, TriMesh};

/// A mesh node of a glTF scene.
#[derive(Debug, Clone)]
pub struct MeshNode {
    /// The node's name, else its mesh's, else `node_<index>`.
    pub name: String,
    /// The node's rigid pose, Z up; any scale is in the meshes.
    pub world_from_node: Pose,
    /// One mesh per primitive, in the node's frame turned Z up.
    pub meshes: Vec<TriMesh>,
}

/// A glTF file's default scene.
#[derive(Debug, Clone)]
pub struct GltfScene {
    /// The nodes that carry meshes, in scene order.
    pub nodes: Vec<MeshNode>,
    /// What was missing or odd, in the user's words.
    pub notes: Vec<String>,
}

/// All meshes of a file in its scene's frame.
pub(super) fn load_flat(path: &Path) -> Result<MeshFile, ModelError> {
    let GltfScene { nodes, notes } = load_scene(path)?;
    let meshes = nodes.iter().flat_map(|n| placed(&n.meshes, &n.world_from_node)).collect();
    Ok(MeshFile { meshes, notes })
}

/// Loads the default scene of a `.gltf` or `.glb` file.
///
/// # Errors
/// [`ModelError`] naming the file: unreadable, malformed, truncated, or without meshes.
pub fn load_scene(path: &Path) -> Result<GltfScene, ModelError> {
    let bytes = std::fs::read(path).map_err(|e| ModelError::read(path, e))?;
    let invalid = |reason: String| ModelError::invalid(path, reason);
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice(&bytes)
        .map_err(|e| invalid(format!("not a valid or whole glTF file: {e}")))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let buffers = load_buffers(&document, folder, blob).map_err(invalid)?;
    for accessor in document.accessors() {
        check_accessor(&accessor, &buffers).map_err(invalid)?;
    }
    let mut reader =
        Reader { folder, buffers, materials: HashMap::new(), nodes: vec![], notes: vec![] };
    let scene = document
        .default_scene()
        .or_else(|| document.scenes().next())
        .ok_or_else(|| invalid("the file has no scene".into()))?;
    for node in scene.nodes() {
        reader.node(&node, &Matrix4::identity()).map_err(invalid)?;
    }
    Ok(GltfScene { nodes: reader.nodes, notes: reader.notes })
}

struct Reader<'a> {
    folder: &'a Path,
    buffers: Vec<Vec<u8>>,
    materials: HashMap<Option<usize>, Material>,
    nodes: Vec<MeshNode>,
    notes: Vec<String>,
}

impl Reader<'_> {
    fn node(&mut self, node: &gltf::Node, file_from_parent: &Matrix4<f64>) -> Result<(), String> {
        let columns = node.transform().matrix();
        let parent_from_node = Matrix4::from_fn(|row, column| f64::from(columns[column][row]));
        let file_from_node = file_from_parent * parent_from_node;
        if let Some(mesh) = node.mesh() {
            let name = node.name().or(mesh.name()).map(str::to_owned);
            let name = name.unwrap_or_else(|| format!("node_{}", node.index()));
            let mut meshes = Vec::new();
            for primitive in mesh.primitives() {
                meshes.extend(self.primitive(&primitive, &name)?);
            }
            if !meshes.is_empty() {
                self.nodes.push(upright(name, &meshes, &file_from_node)?);
            }
        }
        node.children().try_for_each(|child| self.node(&child, &file_from_node))
    }

    fn primitive(
        &mut self,
        primitive: &gltf::Primitive,
        name: &str,
    ) -> Result<Option<TriMesh>, String> {
        if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            return Ok(None);
        }
        let material = self.material(&primitive.material());
        let uv_set =
            primitive.material().pbr_metallic_roughness().base_color_texture().map_or(0, |info| {
                info.texture_transform().and_then(|t| t.tex_coord()).unwrap_or(info.tex_coord())
            });
        let reader = primitive.reader(|buffer| self.buffers.get(buffer.index()).map(Vec::as_slice));
        let positions: Vec<[f32; 3]> = reader
            .read_positions()
            .ok_or_else(|| format!("node \"{name}\": a primitive has no positions"))?
            .collect();
        let normals: Vec<[f32; 3]> = reader.read_normals().map_or_else(Vec::new, Iterator::collect);
        let uvs: Vec<[f32; 2]> =
            reader.read_tex_coords(uv_set).map_or_else(Vec::new, |c| c.into_f32().collect());
        let uvs = transformed_uvs(uvs, &primitive.material());
        let indices: Vec<u32> = match reader.read_indices() {
            Some(indices) => indices.into_u32().collect(),
            None => (0..positions.len() as u32).collect(),
        };
        if let Some(bad) = indices.iter().find(|&&i| i as usize >= positions.len()) {
            let count = positions.len();
            return Err(format!("node \"{name}\": index {bad} is out of range 0..{count}"));
        }
        let count = positions.len();
        Ok(Some(TriMesh {
            normals: if normals.len() == count { normals } else { Vec::new() },
            uvs: if uvs.len() == count { uvs } else { Vec::new() },
            triangles: triangles(primitive.mode(), &indices),
            positions,
            material,
        }))
    }

    fn material(&mut self, material: &gltf::Material) -> Material {
        if let Some(known) = self.materials.get(&material.index()) {
            return known.clone();
        }
        let pbr = material.pbr_metallic_roughness();
        let texture = pbr.base_color_texture().and_then(|info| {
            let image = info.texture().source();
            self.image(image.source())
                .map(Arc::new)
                .map_err(|reason| {
                    self.notes.push(format!("image {}: {reason}: left out", image.index()));
                })
                .ok()
        });
        // A primitive without a material gets the same grey as in every other format: glTF's own
        // default (white metal) is meant for viewers with an environment map.
        let material_or_default = if material.index().is_none() {
            Material::default()
        } else {
            Material {
                name: material.name().unwrap_or("unnamed").to_owned(),
                base_color: pbr.base_color_factor(),
                base_color_texture: texture,
                metallic: pbr.metallic_factor(),
                roughness: pbr.roughness_factor(),
            }
        };
        self.materials.insert(material.index(), material_or_default.clone());
        material_or_default
    }

    fn image(&self, source: gltf::image::Source) -> Result<image::RgbaImage, String> {
        match source {
            gltf::image::Source::Uri { uri, .. } => texture::decode(&read_uri(self.folder, uri)?),
            gltf::image::Source::View { view, .. } => {
                let buffer = self.buffers.get(view.buffer().index());
                let range = view.offset()..view.offset().saturating_add(view.length());
                let bytes = buffer.and_then(|b| b.get(range)).ok_or("outside its buffer")?;
                texture::decode(bytes)
            }
        }
    }
}

/// Turns a node with its meshes Z up and splits its transform into a rigid pose and the rest, which is
/// baked into the meshes.
fn upright(
    name: String,
    meshes: &[TriMesh],
    file_from_node: &Matrix4<f64>,
) -> Result<MeshNode, String> {
    let linear: Matrix3<f64> = file_from_node.fixed_view::<3, 3>(0, 0).into_owned();
    if !file_from_node.iter().all(|v| v.is_finite()) || linear.determinant().abs() < 1e-18 {
        return Err(format!("node \"{name}\": its transform is singular or not finite"));
    }
    let z_up_from_y_up =
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
    let rotation = UnitQuaternion::from_rotation_matrix(&nearest_rotation(&linear));
    let translation: Vector3<f64> = file_from_node.fixed_view::<3, 1>(0, 3).into_owned();
    let rest = rotation.to_rotation_matrix().inverse() * linear;
    let baked = z_up_from_y_up.to_homogeneous() * rest.to_homogeneous();
    let world_from_node = Pose::from_parts(
        (z_up_from_y_up * translation).into(),
        z_up_from_y_up * rotation * z_up_from_y_up.inverse(),
    );
    Ok(MeshNode { name, world_from_node, meshes: mapped(meshes, &baked) })
}

/// The rotation closest to a regular matrix, by polar decomposition.
fn nearest_rotation(linear: &Matrix3<f64>) -> Rotation3<f64> {
    let svd = linear.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Rotation3::identity() };
    let sign = (u * v_t).determinant().signum();
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign));
    Rotation3::from_matrix_unchecked(u * flip * v_t)
}

fn triangles(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => (2..indices.len())
            .map(|i| {
                let [a, b] = if i % 2 == 0 { [i - 2, i - 1] } else { [i - 1, i - 2] };
                [indices[a], indices[b], indices[i]]
            })
            .collect(),
        Mode::TriangleFan => {
            (2..indices.len()).map(|i| [indices[0], indices[i - 1], indices[i]]).collect()
        }
        _ => indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    }
}

/// Texture coordinates under the base colour's `KHR_texture_transform`, where there is one.
fn transformed_uvs(uvs: Vec<[f32; 2]>, material: &gltf::Material) -> Vec<[f32; 2]> {
    let info = material.pbr_metallic_roughness().base_color_texture();
    let Some(transform) = info.and_then(|info| info.texture_transform()) else { return uvs };
    let ([du, dv], [su, sv]) = (transform.offset(), transform.scale());
    let (sin, cos) = transform.rotation().sin_cos();
    let place = |[u, v]: [f32; 2]| {
        let (u, v) = (u * su, v * sv);
        [cos * u + sin * v + du, -sin * u + cos * v + dv]
    };
    uvs.into_iter().map(place).collect()
}

fn load_buffers(
    document: &gltf::Document,
    folder: &Path,
    mut blob: Option<Vec<u8>>,
) -> Result<Vec<Vec<u8>>, String> {
    let load = |buffer: gltf::Buffer| {
        let bytes = match buffer.source() {
            gltf::buffer::Source::Bin => blob.take().ok_or("the binary chunk is missing")?,
            gltf::buffer::Source::Uri(uri) => read_uri(folder, uri)?,
        };
        if bytes.len() < buffer.length() {
            return Err(format!(
                "buffer {} is truncated: expected {} bytes, got {}",
                buffer.index(),
                buffer.length(),
                bytes.len()
            ));
        }
        Ok(bytes)
    };
    document.buffers().map(load).collect()
}

/// Content of a relative URI or a `data:` URI.
fn read_uri(folder: &Path, uri: &str) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, encoded) = data.split_once(";base64,").ok_or("a data URI is not base64")?;
        let engine = base64::engine::general_purpose::STANDARD;
        return engine.decode(encoded).map_err(|e| format!("a data URI is malformed: {e}"));
    }
    let path = folder.join(percent_decoded(uri));
    std::fs::read(&path).map_err(|e| format!("cannot read {}: {e}", path.display()))
}

/// Undoes `%20` and the like; what is not a valid escape stays.
pub(super) fn percent_decoded(uri: &str) -> String {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, tail @ ..] = rest {
        let escape = tail.get(..2).and_then(|hex| std::str::from_utf8(hex).ok());
        match escape.filter(|_| *first == b'%').and_then(|hex| u8::from_str_radix(hex, 16).ok()) {
            Some(byte) => {
                bytes.push(byte);
                rest = &tail[2..];
            }
            None => {
                bytes.push(*first);
                rest = tail;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

/// Refuses an accessor that reads beyond its buffer view, or a view beyond its buffer.
fn check_accessor(accessor: &gltf::Accessor, buffers: &[Vec<u8>]) -> Result<(), String> {
    if let Some(sparse) = accessor.sparse() {
        let index_size = sparse.indices().index_type().size();
        check_span(
            &sparse.indices().view(),
            sparse.indices().offset(),
            sparse.count(),
            index_size,
            buffers,
        )?;
        check_span(
            &sparse.values().view(),
            sparse.values().offset(),
            sparse.count(),
            accessor.size(),
            buffers,
        )?;
    }
    match accessor.view() {
        Some(view) => {
            check_span(&view, accessor.offset(), accessor.count(), accessor.size(), buffers)
        }
        None => Ok(()),
    }
}

fn check_span(
    view: &gltf::buffer::View,
    offset: usize,
    count: usize,
    element_bytes: usize,
    buffers: &[Vec<u8>],
) -> Result<(), String> {
    let buffer_bytes = buffers.get(view.buffer().index()).map_or(0, Vec::len);
    let stride = view.stride().unwrap_or(element_bytes);
    let span = count.saturating_sub(1).saturating_mul(stride).saturating_add(element_bytes);
    let end_in_view = offset.saturating_add(if count == 0 { 0 } else { span });
    if end_in_view > view.length()
        || view.offset().saturating_add(view.length()) > buffer_bytes
        || stride < element_bytes
    {
        return Err(format!(
            "truncated: {count} elements end at byte {end_in_view} of buffer view {}, which has {} bytes in a buffer of {buffer_bytes}",
            view.index(),
            view.length()
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percent_escapes() {
        assert_eq!(percent_decoded("a%20b.png"), "a b.png");
        assert_eq!(percent_decoded("100%.png"), "100%.png");
    }

    #[test]
    fn mirrored_nodes_get_a_proper_rotation() {
        let mirror = Matrix3::from_diagonal(&Vector3::new(-1.0, 2.0, 1.0));
        assert!((nearest_rotation(&mirror).matrix().determinant() - 1.0).abs() < 1e-12);
    }
}
