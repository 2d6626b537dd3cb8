//! The bodies' triangles, materials and textures in device memory.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use akrobat_gpu::{Context, GpuError, StorageBuffer, wgpu};
use akrobat_model::TriMesh;
use akrobat_model::mesh::Material;
use bytemuck::{Pod, Zeroable};

use super::pipeline::Pipeline;
use super::view::{Bounds, Frustum};
use crate::{FrameState, RenderBody};

/// A vertex in its body's frame, metres.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Vertex {
    position: [f32; 3],
    normal: [f32; 3],
    uv: [f32; 2],
}

/// The uniform `Material` of the shader.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct MaterialUniform {
    base_color: [f32; 3],
    metallic: f32,
    roughness: f32,
    padding: [f32; 3],
}

/// A mesh's place in the shared buffers.
#[derive(Debug, Clone)]
struct PackedMesh {
    indices: Range<u32>,
    first_vertex: i32,
    bounds: Bounds,
}

/// A mesh of a body, and what it is drawn with.
#[derive(Debug, Clone)]
struct Draw {
    body: usize,
    mesh: usize,
    material_offset: u32,
    texture: usize,
}

/// Everything that stays the same from frame to frame.
#[derive(Debug)]
pub struct UploadedBodies {
    source: Arc<[RenderBody]>,
    vertices: StorageBuffer<Vertex>,
    indices: StorageBuffer<u32>,
    meshes: Vec<PackedMesh>,
    /// In the order of their textures.
    draws: Vec<Draw>,
    /// Group 1 for each texture; the first is white.
    materials: Vec<wgpu::BindGroup>,
}

impl UploadedBodies {
    pub fn new(
        context: &Context,
        pipeline: &Pipeline,
        bodies: &Arc<[RenderBody]>,
    ) -> Result<Self, GpuError> {
        let mut packer = Packer::new(context);
        let mut draws = Vec::new();
        for (place, body) in bodies.iter().enumerate() {
            for (source, material) in body.meshes.iter().zip(&body.materials) {
                if let Some(mesh) = packer.mesh(source) {
                    let material_offset = packer.material(material);
                    let texture = packer.texture(source, material);
                    draws.push(Draw { body: place, mesh, material_offset, texture });
                }
            }
        }
        draws.sort_by_key(|draw| draw.texture);
        let usage = wgpu::BufferUsages::VERTEX;
        let vertices = StorageBuffer::new(context, "vertices", &packer.vertices, usage)?;
        let usage = wgpu::BufferUsages::INDEX;
        let indices = StorageBuffer::new(context, "indices", &packer.indices, usage)?;
        let materials = packer.bind_groups(context, pipeline)?;
        let source = bodies.clone();
        Ok(Self { source, vertices, indices, meshes: packer.meshes, draws, materials })
    }

    /// The bodies this was made from.
    pub fn source(&self) -> &Arc<[RenderBody]> {
        &self.source
    }

    /// Draws what may be visible in a camera; body `i` is instance `i`.
    pub fn draw(&self, pass: &mut wgpu::RenderPass<'_>, frame: &FrameState, frustum: &Frustum) {
        pass.set_vertex_buffer(0, self.vertices.raw().slice(..));
        pass.set_index_buffer(self.indices.raw().slice(..), wgpu::IndexFormat::Uint32);
        for draw in &self.draws {
            let mesh = &self.meshes[draw.mesh];
            if !frustum.may_see(&frame.world_from_body[draw.body], &mesh.bounds) {
                continue;
            }
            let instance = draw.body as u32;
            pass.set_bind_group(1, &self.materials[draw.texture], &[draw.material_offset]);
            pass.draw_indexed(mesh.indices.clone(), mesh.first_vertex, instance..instance + 1);
        }
    }

    /// Draws, without materials, the bodies that cast shadows.
    pub fn draw_shapes(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        frame: &FrameState,
        frustum: &Frustum,
        casters: &[bool],
    ) {
        pass.set_vertex_buffer(0, self.vertices.raw().slice(..));
        pass.set_index_buffer(self.indices.raw().slice(..), wgpu::IndexFormat::Uint32);
        for draw in self.draws.iter().filter(|draw| casters[draw.body]) {
            let mesh = &self.meshes[draw.mesh];
            if frustum.may_see(&frame.world_from_body[draw.body], &mesh.bounds) {
                let instance = draw.body as u32;
                pass.draw_indexed(mesh.indices.clone(), mesh.first_vertex, instance..instance + 1);
            }
        }
    }
}

/// Collects meshes and textures, each once.
struct Packer<'a> {
    context: &'a Context,
    vertices: Vec<Vertex>,
    indices: Vec<u32>,
    meshes: Vec<PackedMesh>,
    mesh_of_address: HashMap<*const TriMesh, usize>,
    textures: Vec<Arc<image::RgbaImage>>,
    material_stride: usize,
    material_bytes: Vec<u8>,
}

impl<'a> Packer<'a> {
    fn new(context: &'a Context) -> Self {
        let alignment = context.device().limits().min_uniform_buffer_offset_alignment as usize;
        let white = image::RgbaImage::from_pixel(1, 1, image::Rgba([255; 4]));
        Self {
            context,
            vertices: Vec::new(),
            indices: Vec::new(),
            meshes: Vec::new(),
            mesh_of_address: HashMap::new(),
            textures: vec![Arc::new(white)],
            material_stride: size_of::<MaterialUniform>().next_multiple_of(alignment),
            material_bytes: Vec::new(),
        }
    }

    /// Index of the packed mesh; `None` where there is nothing to draw.
    fn mesh(&mut self, mesh: &Arc<TriMesh>) -> Option<usize> {
        let address = Arc::as_ptr(mesh);
        if let Some(&index) = self.mesh_of_address.get(&address) {
            return Some(index);
        }
        let (low, high) = mesh.bounds().filter(|_| !mesh.triangles.is_empty())?;
        let first_vertex = self.vertices.len();
        let first_index = self.indices.len() as u32;
        if mesh.normals.len() == mesh.positions.len() {
            self.vertices
                .extend((0..mesh.positions.len()).map(|i| vertex(mesh, i, mesh.normals[i])));
            self.indices.extend(mesh.triangles.iter().flatten());
        } else {
            for index in 0..mesh.triangles.len() {
                let normal = plane_normal(mesh.corners(index));
                let corners = mesh.triangles[index].map(|i| vertex(mesh, i as usize, normal));
                self.vertices.extend(corners);
            }
            self.indices.extend(0..3 * mesh.triangles.len() as u32);
        }
        self.meshes.push(PackedMesh {
            indices: first_index..self.indices.len() as u32,
            first_vertex: first_vertex as i32,
            bounds: Bounds::from_corners(low, high),
        });
        self.mesh_of_address.insert(address, self.meshes.len() - 1);
        Some(self.meshes.len() - 1)
    }

    /// Offset of the material's uniform.
    fn material(&mut self, material: &Material) -> u32 {
        let offset = self.material_bytes.len();
        let [r, g, b, _] = material.base_color;
        let Material { metallic, roughness, .. } = *material;
        let uniform =
            MaterialUniform { base_color: [r, g, b], metallic, roughness, padding: [0.0; 3] };
        self.material_bytes.extend(bytemuck::bytes_of(&uniform));
        self.material_bytes.resize(offset + self.material_stride, 0);
        offset as u32
    }

    fn texture(&mut self, mesh: &TriMesh, material: &Material) -> usize {
        let has_uvs = mesh.uvs.len() == mesh.positions.len();
        let Some(image) = material.base_color_texture.as_ref().filter(|_| has_uvs) else {
            return 0;
        };
        let known = self.textures.iter().position(|other| Arc::ptr_eq(other, image));
        known.unwrap_or_else(|| {
            self.textures.push(image.clone());
            self.textures.len() - 1
        })
    }

    fn bind_groups(
        &self,
        context: &Context,
        pipeline: &Pipeline,
    ) -> Result<Vec<wgpu::BindGroup>, GpuError> {
        let usage = wgpu::BufferUsages::UNIFORM;
        let uniforms = StorageBuffer::new(context, "materials", &self.material_bytes, usage)?;
        let bind = |image: &Arc<image::RgbaImage>| {
            let view = upload(self.context, image)?;
            Ok(context.device().create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("material"),
                layout: pipeline.material_layout(),
                entries: &[
                    wgpu::BindGroupEntry {
                        binding: 0,
                        resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                            buffer: uniforms.raw(),
                            offset: 0,
                            size: wgpu::BufferSize::new(size_of::<MaterialUniform>() as u64),
                        }),
                    },
                    wgpu::BindGroupEntry {
                        binding: 1,
                        resource: wgpu::BindingResource::TextureView(&view),
                    },
                ],
            }))
        };
        // Without meshes there are no uniforms to bind, and nothing asks for them.
        let used = if self.meshes.is_empty() { &[] } else { &self.textures[..] };
        used.iter().map(bind).collect()
    }
}

fn vertex(mesh: &TriMesh, index: usize, normal: [f32; 3]) -> Vertex {
    let uv = mesh.uvs.get(index).copied().unwrap_or_default();
    Vertex { position: mesh.positions[index], normal, uv }
}

/// Normal of a triangle's plane, of any length.
fn plane_normal(corners: [[f32; 3]; 3]) -> [f32; 3] {
    let [a, b, c] = corners.map(|corner| nalgebra::Vector3::from(corner).cast::<f64>());
    let normal = (b - a).cross(&(c - a));
    normal.try_normalize(0.0).unwrap_or_default().cast::<f32>().into()
}

/// Copies an image into an sRGB texture, which the device decodes per texel.
fn upload(context: &Context, image: &image::RgbaImage) -> Result<wgpu::TextureView, GpuError> {
    let (width, height) = image.dimensions();
    let available = context.device().limits().max_texture_dimension_2d;
    if width.max(height) > available {
        return Err(GpuError::TooLarge {
            what: "a texture".into(),
            needed: format!("{width} x {height} pixels"),
            available: format!("{available} x {available} pixels"),
        });
    }
    let size = wgpu::Extent3d { width, height, depth_or_array_layers: 1 };
    let texture = context.device().create_texture(&wgpu::TextureDescriptor {
        label: Some("base color"),
        size,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::Rgba8UnormSrgb,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    });
    let layout = wgpu::TexelCopyBufferLayout {
        offset: 0,
        bytes_per_row: Some(4 * width),
        rows_per_image: Some(height),
    };
    context.queue().write_texture(texture.as_image_copy(), image.as_raw(), layout, size);
    Ok(texture.create_view(&Default::default()))
}
