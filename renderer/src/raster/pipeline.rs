//! The render pipeline and the layouts of what it binds.

use akrobat_gpu::{Context, GpuError, Shader, ShaderPart, wgpu};

use super::geometry::Vertex;
use super::view::BodyInView;

/// Colour attachment: sRGB-encoded by the shader.
pub const COLOR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
/// z-depth attachment, metres.
pub const DISTANCE_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Float;
/// Segmentation attachment.
pub const SEGMENT_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// Normal attachment: camera frame, octahedral, 16 bits an axis.
pub const NORMAL_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;
/// Depth-test attachment: reversed, 1 at near and 0 at far.
pub const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

const IMAGE_MODEL: ShaderPart<'_> =
    ShaderPart { name: "image_model.wgsl", source: include_str!("../shaders/image_model.wgsl") };
const RASTER: ShaderPart<'_> =
    ShaderPart { name: "raster.wgsl", source: include_str!("../shaders/raster.wgsl") };

/// Shadow maps: reversed depth, 1 at near and 0 where nothing is.
pub const SHADOW_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;

const VERTEX_ATTRIBUTES: [wgpu::VertexAttribute; 3] =
    wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3, 2 => Float32x2];
const BODY_ATTRIBUTES: [wgpu::VertexAttribute; 4] =
    wgpu::vertex_attr_array![3 => Float32x4, 4 => Float32x4, 5 => Float32x4, 6 => Uint32];

/// The pipeline and its bind group layouts.
#[derive(Debug)]
pub struct Pipeline {
    view_layout: wgpu::BindGroupLayout,
    light_view_layout: wgpu::BindGroupLayout,
    material_layout: wgpu::BindGroupLayout,
    raster: wgpu::RenderPipeline,
    shadow: wgpu::RenderPipeline,
}

impl Pipeline {
    pub fn new(context: &Context) -> Result<Self, GpuError> {
        let device = context.device();
        let view_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("view"),
            entries: &[
                dynamic_uniform(0, wgpu::ShaderStages::VERTEX_FRAGMENT),
                wgpu::BindGroupLayoutEntry {
                    binding: 1,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Depth,
                        view_dimension: wgpu::TextureViewDimension::D2Array,
                        multisampled: false,
                    },
                    count: None,
                },
            ],
        });
        let light_view_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("light's view"),
            entries: &[dynamic_uniform(0, wgpu::ShaderStages::VERTEX_FRAGMENT)],
        });
        let material_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("material"),
            entries: &[
                dynamic_uniform(0, wgpu::ShaderStages::FRAGMENT),
                wgpu::BindGroupLayoutEntry {
                    binding: 1,
                    visibility: wgpu::ShaderStages::FRAGMENT,
                    ty: wgpu::BindingType::Texture {
                        sample_type: wgpu::TextureSampleType::Float { filterable: false },
                        view_dimension: wgpu::TextureViewDimension::D2,
                        multisampled: false,
                    },
                    count: None,
                },
            ],
        });
        let module = Shader::compose("raster", &[IMAGE_MODEL, RASTER])?.module(context);
        let raster = raster_pipeline(context, &module, &[&view_layout, &material_layout]);
        let shadow = shadow_pipeline(context, &module, &light_view_layout);
        context.check()?;
        Ok(Self { view_layout, light_view_layout, material_layout, raster, shadow })
    }

    /// Layout of group 0 where shadow maps are drawn: the light's view alone.
    pub fn light_view_layout(&self) -> &wgpu::BindGroupLayout {
        &self.light_view_layout
    }

    /// Draws shadow maps.
    pub fn shadow(&self) -> &wgpu::RenderPipeline {
        &self.shadow
    }

    /// Layout of group 0: the view's uniform and the shadow maps.
    pub fn view_layout(&self) -> &wgpu::BindGroupLayout {
        &self.view_layout
    }

    /// Layout of group 1: the material's uniform and texture.
    pub fn material_layout(&self) -> &wgpu::BindGroupLayout {
        &self.material_layout
    }

    pub fn raster(&self) -> &wgpu::RenderPipeline {
        &self.raster
    }
}

/// One uniform structure out of several in a buffer, chosen by offset when it is bound.
fn dynamic_uniform(binding: u32, visibility: wgpu::ShaderStages) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: true,
            min_binding_size: None,
        },
        count: None,
    }
}

fn pipeline_layout(context: &Context, groups: &[&wgpu::BindGroupLayout]) -> wgpu::PipelineLayout {
    let groups: Vec<_> = groups.iter().map(|group| Some(*group)).collect();
    context.device().create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("raster"),
        bind_group_layouts: &groups,
        immediate_size: 0,
    })
}

fn vertex_buffers() -> [Option<wgpu::VertexBufferLayout<'static>>; 2] {
    [
        Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<Vertex>() as u64,
            step_mode: wgpu::VertexStepMode::Vertex,
            attributes: &VERTEX_ATTRIBUTES,
        }),
        Some(wgpu::VertexBufferLayout {
            array_stride: size_of::<BodyInView>() as u64,
            step_mode: wgpu::VertexStepMode::Instance,
            attributes: &BODY_ATTRIBUTES,
        }),
    ]
}

fn nearest_wins(format: wgpu::TextureFormat) -> wgpu::DepthStencilState {
    wgpu::DepthStencilState {
        format,
        depth_write_enabled: Some(true),
        depth_compare: Some(wgpu::CompareFunction::Greater),
        stencil: Default::default(),
        bias: Default::default(),
    }
}

fn raster_pipeline(
    context: &Context,
    module: &wgpu::ShaderModule,
    groups: &[&wgpu::BindGroupLayout],
) -> wgpu::RenderPipeline {
    let targets = [COLOR_FORMAT, DISTANCE_FORMAT, SEGMENT_FORMAT, NORMAL_FORMAT].map(|format| {
        Some(wgpu::ColorTargetState { format, blend: None, write_mask: wgpu::ColorWrites::ALL })
    });
    context.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("raster"),
        layout: Some(&pipeline_layout(context, groups)),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("vertex"),
            compilation_options: Default::default(),
            buffers: &vertex_buffers(),
        },
        // Neither face is culled: everything is visible from both sides.
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(nearest_wins(DEPTH_FORMAT)),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some("fragment"),
            compilation_options: Default::default(),
            targets: &targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}

fn shadow_pipeline(
    context: &Context,
    module: &wgpu::ShaderModule,
    group: &wgpu::BindGroupLayout,
) -> wgpu::RenderPipeline {
    context.device().create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("shadow"),
        layout: Some(&pipeline_layout(context, &[group])),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("vertex"),
            compilation_options: Default::default(),
            buffers: &vertex_buffers(),
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(nearest_wins(SHADOW_FORMAT)),
        multisample: Default::default(),
        fragment: None,
        multiview_mask: None,
        cache: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shaders_are_valid() {
        if let Err(error) = Shader::compose("raster", &[IMAGE_MODEL, RASTER]) {
            panic!("{error}");
        }
    }
}
