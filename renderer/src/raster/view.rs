//! What changes with every frame and camera: projection, light and body poses.

use akrobat_gpu::{Context, GpuError, StorageBuffer, wgpu};
use akrobat_model::Pose;
use bytemuck::{Pod, Zeroable};
use nalgebra::{Point3, Vector3};

use super::pipeline::{Pipeline, SHADOW_FORMAT};
use crate::lighting::{MOST_LIGHTS, Reflection, Source, WorldLight};
use crate::shadow::{self, LightMaps};
use crate::{FrameState, Lighting, PlacedCamera, RenderScene};

/// The instance attributes `Body` of the shader.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct BodyInView {
    /// Rows of the 3 x 4 matrix.
    camera_from_body: [[f32; 4]; 3],
    segment_id: u32,
}

impl BodyInView {
    fn new(camera_from_body: &Pose, segment_id: u16) -> Self {
        Self { camera_from_body: rows(camera_from_body), segment_id: segment_id.into() }
    }
}

/// The structure `Light` of the shader, camera frame.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
struct LightUniform {
    /// Unit vector to a directional light (w = 0), or the position of another (w = 1).
    place: [f32; 4],
    /// Axis of a spot, and the cosine of its outer angle; for other lights -2, which every cosine exceeds.
    axis: [f32; 4],
    /// Colour, and the inverse of what the outer cosine lacks to the inner one.
    rgb: [f32; 4],
    first_map: u32,
    map_count: u32,
    padding: [u32; 2],
}

/// The structure `ShadowMap` of the shader.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
struct MapUniform {
    /// Rows of the 3 x 4 matrix.
    light_from_camera: [[f32; 4]; 3],
    focal: f32,
    near_m: f32,
    far_m: f32,
    padding: f32,
}

/// Most shadow maps: six around each of the lights.
pub const MOST_MAPS: usize = 6 * MOST_LIGHTS;

/// The uniform `View` of the shader; `vec3` members begin at multiples of 16 bytes.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct ViewUniform {
    scale: [f32; 2],
    offset: [f32; 2],
    near_m: f32,
    far_m: f32,
    light_count: u32,
    pbr: u32,
    up_direction: [f32; 4],
    sky_rgb: [f32; 4],
    ground_rgb: [f32; 3],
    bias_m: f32,
    normal_offset_texels: f32,
    padding: [f32; 3],
    lights: [LightUniform; MOST_LIGHTS],
    maps: [MapUniform; MOST_MAPS],
}

impl ViewUniform {
    /// What projects; no light.
    fn new(camera: &PlacedCamera) -> Self {
        let k = &camera.intrinsics;
        let (width, height) = (f64::from(k.width), f64::from(k.height));
        Self {
            scale: [(2.0 * k.fx / width) as f32, (2.0 * k.fy / height) as f32],
            offset: [(2.0 * k.cx / width - 1.0) as f32, (2.0 * k.cy / height - 1.0) as f32],
            near_m: camera.near_m as f32,
            far_m: camera.far_m as f32,
            ..Self::zeroed()
        }
    }

    fn lit(camera: &PlacedCamera, lights: &FrameLights<'_>) -> Self {
        let world_from_camera = &camera.world_from_camera;
        let camera_from_world = world_from_camera.inverse();
        let padded = |[x, y, z]: [f32; 3], w: f32| [x, y, z, w];
        let turn =
            |v: Vector3<f64>| -> [f32; 3] { (camera_from_world.rotation * v).cast::<f32>().into() };
        let [sky, ground] = lights.lighting.environment.sky_and_ground();
        let mut uniform = Self {
            light_count: lights.lights.len() as u32,
            pbr: u32::from(lights.lighting.reflection == Reflection::Pbr),
            up_direction: padded(turn(Vector3::z()), 0.0),
            sky_rgb: padded(sky, 0.0),
            ground_rgb: ground,
            bias_m: shadow::BIAS_M,
            normal_offset_texels: shadow::NORMAL_OFFSET_TEXELS,
            ..Self::new(camera)
        };
        let mut map_count = 0;
        for ((light, maps), slot) in lights.lights.iter().zip(&lights.maps).zip(&mut uniform.lights)
        {
            let place =
                |p: Point3<f64>| -> [f32; 3] { (camera_from_world * p).cast::<f32>().into() };
            let no_cone = [0.0, 0.0, 0.0, -2.0];
            (slot.place, slot.axis) = match light.source {
                Source::Directional(to_light) => (padded(turn(to_light), 0.0), no_cone),
                Source::Point(position) => (padded(place(position), 1.0), no_cone),
                Source::Spot(position, axis, [_, outer]) => {
                    (padded(place(position), 1.0), padded(turn(axis), outer as f32))
                }
            };
            let inverse_width = match light.source {
                Source::Spot(_, _, [inner, outer]) => (1.0 / (inner - outer)) as f32,
                _ => 1.0,
            };
            slot.rgb = padded(light.rgb, inverse_width);
            slot.first_map = map_count as u32;
            let cameras = maps.as_ref().map_or(&[][..], |maps| &maps.cameras);
            slot.map_count = cameras.len() as u32;
            for map in cameras {
                let light_from_camera = map.world_from_camera.inverse() * world_from_camera;
                uniform.maps[map_count] = MapUniform {
                    light_from_camera: rows(&light_from_camera),
                    focal: map.intrinsics.fx as f32,
                    near_m: map.near_m as f32,
                    far_m: map.far_m as f32,
                    padding: 0.0,
                };
                map_count += 1;
            }
        }
        uniform
    }
}

/// A frame's lights and the views that their shadows are drawn from.
pub struct FrameLights<'a> {
    pub lighting: &'a Lighting,
    pub lights: Vec<WorldLight>,
    pub maps: Vec<Option<LightMaps>>,
}

impl<'a> FrameLights<'a> {
    pub fn new(scene: &'a RenderScene, frame: &FrameState) -> Self {
        let lights = WorldLight::all(&scene.lighting);
        let maps = shadow::light_maps(scene, frame, &lights);
        Self { lighting: &scene.lighting, lights, maps }
    }

    /// The views of all maps, in the order of their layers, with what casts shadows in each.
    pub fn views(&self) -> impl Iterator<Item = (&PlacedCamera, &[bool])> {
        let views = |maps: &'_ LightMaps| maps.cameras.len();
        debug_assert!(self.maps.iter().flatten().map(views).sum::<usize>() <= MOST_MAPS);
        self.maps
            .iter()
            .flatten()
            .flat_map(|maps| maps.cameras.iter().map(|camera| (camera, &maps.casters[..])))
    }
}

/// The upper three rows of a pose's matrix.
fn rows(pose: &Pose) -> [[f32; 4]; 3] {
    let matrix = pose.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)] as f32))
}

/// Per-frame buffers and shadow maps, grown as needed. Views are those of the lights first, then the cameras.
#[derive(Debug)]
pub struct Views {
    stride: usize,
    uniforms: StorageBuffer<u8>,
    /// Group 0 where cameras are drawn, and where shadow maps are.
    groups: [wgpu::BindGroup; 2],
    bodies: StorageBuffer<BodyInView>,
    maps: ShadowMaps,
    light_views: usize,
}

/// One square layer for each shadow map.
#[derive(Debug)]
struct ShadowMaps {
    pixels: u32,
    all: wgpu::TextureView,
    layers: Vec<wgpu::TextureView>,
}

impl ShadowMaps {
    fn new(context: &Context, pixels: u32, count: usize) -> Self {
        let texture = context.device().create_texture(&wgpu::TextureDescriptor {
            label: Some("shadow maps"),
            size: wgpu::Extent3d {
                width: pixels,
                height: pixels,
                depth_or_array_layers: count as u32,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: SHADOW_FORMAT,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let view = |first: u32, count: Option<u32>, dimension| {
            texture.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(dimension),
                base_array_layer: first,
                array_layer_count: count,
                ..Default::default()
            })
        };
        let layer = |index: usize| view(index as u32, Some(1), wgpu::TextureViewDimension::D2);
        Self {
            pixels,
            all: view(0, None, wgpu::TextureViewDimension::D2Array),
            layers: (0..count).map(layer).collect(),
        }
    }
}

impl Views {
    pub fn new(context: &Context, pipeline: &Pipeline) -> Result<Self, GpuError> {
        let alignment = context.device().limits().min_uniform_buffer_offset_alignment as usize;
        let stride = size_of::<ViewUniform>().next_multiple_of(alignment);
        let uniforms = uniform_buffer(context, stride)?;
        // What is bound must exist, even where no light casts shadows.
        let maps = ShadowMaps::new(context, 1, 1);
        let groups = bind_groups(context, pipeline, &uniforms, &maps);
        let bodies = body_buffer(context, 1)?;
        Ok(Self { stride, uniforms, groups, bodies, maps, light_views: 0 })
    }

    /// Uploads projections, lights and body poses of every light's view and every camera.
    pub fn write(
        &mut self,
        context: &Context,
        pipeline: &Pipeline,
        scene: &RenderScene,
        frame: &FrameState,
        lights: &FrameLights<'_>,
        cameras: &[PlacedCamera],
    ) -> Result<(), GpuError> {
        let light_views: Vec<&PlacedCamera> = lights.views().map(|(view, _)| view).collect();
        let count = light_views.len() + cameras.len();
        let mut uniforms = vec![0; count * self.stride];
        let mut bodies = Vec::with_capacity(count * scene.bodies.len());
        let views = light_views.iter().map(|view| (*view, ViewUniform::new(view)));
        let views = views.chain(cameras.iter().map(|c| (c, ViewUniform::lit(c, lights))));
        for (slot, (camera, uniform)) in uniforms.chunks_mut(self.stride).zip(views) {
            slot[..size_of::<ViewUniform>()].copy_from_slice(bytemuck::bytes_of(&uniform));
            let camera_from_world = camera.world_from_camera.inverse();
            bodies.extend(scene.bodies.iter().zip(&frame.world_from_body).map(
                |(body, world_from_body)| {
                    BodyInView::new(&(camera_from_world * world_from_body), body.segment_id)
                },
            ));
        }
        self.light_views = light_views.len();
        let pixels = scene.lighting.shadow_map_pixels;
        let stale_maps = self.light_views > 0
            && (self.maps.pixels != pixels || self.maps.layers.len() < self.light_views);
        if stale_maps {
            self.maps = ShadowMaps::new(context, pixels, self.light_views);
        }
        let stale_uniforms = uniforms.len() > self.uniforms.len();
        if stale_uniforms {
            self.uniforms = uniform_buffer(context, uniforms.len())?;
        }
        if stale_maps || stale_uniforms {
            self.groups = bind_groups(context, pipeline, &self.uniforms, &self.maps);
        }
        if bodies.len() > self.bodies.len() {
            self.bodies = body_buffer(context, bodies.len())?;
        }
        self.uniforms.write(context, &uniforms);
        self.bodies.write(context, &bodies);
        Ok(())
    }

    /// Makes camera `index`'s view and its `body_count` bodies those of the following draws.
    pub fn bind(&self, pass: &mut wgpu::RenderPass<'_>, index: usize, body_count: usize) {
        self.bind_view(pass, 0, self.light_views + index, body_count);
    }

    /// Starts drawing shadow map `index`.
    pub fn begin_map<'encoder>(
        &self,
        encoder: &'encoder mut wgpu::CommandEncoder,
        index: usize,
        body_count: usize,
    ) -> wgpu::RenderPass<'encoder> {
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("shadow map"),
            color_attachments: &[],
            depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                view: &self.maps.layers[index],
                depth_ops: Some(wgpu::Operations {
                    load: wgpu::LoadOp::Clear(0.0),
                    store: wgpu::StoreOp::Store,
                }),
                stencil_ops: None,
            }),
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
        self.bind_view(&mut pass, 1, index, body_count);
        pass
    }

    fn bind_view(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        group: usize,
        index: usize,
        body_count: usize,
    ) {
        let size = body_count * size_of::<BodyInView>();
        let range = (index * size) as u64..((index + 1) * size) as u64;
        pass.set_bind_group(0, &self.groups[group], &[(index * self.stride) as u32]);
        if !range.is_empty() {
            pass.set_vertex_buffer(1, self.bodies.raw().slice(range));
        }
    }
}

fn uniform_buffer(context: &Context, len: usize) -> Result<StorageBuffer<u8>, GpuError> {
    StorageBuffer::zeroed(context, "views", len, wgpu::BufferUsages::UNIFORM)
}

fn body_buffer(context: &Context, len: usize) -> Result<StorageBuffer<BodyInView>, GpuError> {
    StorageBuffer::zeroed(context, "bodies in view", len, wgpu::BufferUsages::VERTEX)
}

fn bind_groups(
    context: &Context,
    pipeline: &Pipeline,
    uniforms: &StorageBuffer<u8>,
    maps: &ShadowMaps,
) -> [wgpu::BindGroup; 2] {
    let view = wgpu::BindGroupEntry {
        binding: 0,
        resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
            buffer: uniforms.raw(),
            offset: 0,
            size: wgpu::BufferSize::new(size_of::<ViewUniform>() as u64),
        }),
    };
    let all_maps = wgpu::BindGroupEntry {
        binding: 1,
        resource: wgpu::BindingResource::TextureView(&maps.all),
    };
    let group = |layout, entries: &[wgpu::BindGroupEntry<'_>]| {
        let label = Some("view");
        context.device().create_bind_group(&wgpu::BindGroupDescriptor { label, layout, entries })
    };
    [
        group(pipeline.view_layout(), &[view.clone(), all_maps]),
        group(pipeline.light_view_layout(), &[view]),
    ]
}

/// An axis-aligned box in a body's frame, metres.
#[derive(Debug, Clone)]
pub struct Bounds {
    center: Point3<f64>,
    half_extents: Vector3<f64>,
}

impl Bounds {
    pub fn from_corners(low: [f32; 3], high: [f32; 3]) -> Self {
        let [low, high] = [low, high].map(|corner| Vector3::from(corner).cast::<f64>());
        Self { center: Point3::from((low + high) / 2.0), half_extents: (high - low) / 2.0 }
    }
}

/// What a camera can see: the intersection of half-spaces `normal . p + offset >= 0`, camera frame.
#[derive(Debug)]
pub struct Frustum {
    camera_from_world: Pose,
    half_spaces: [(Vector3<f64>, f64); 6],
}

impl Frustum {
    pub fn new(camera: &PlacedCamera) -> Self {
        let k = &camera.intrinsics;
        let (width, height) = (f64::from(k.width), f64::from(k.height));
        let half_spaces = [
            // 0 <= u z <= width z, with u z = fx x + cx z; likewise for v.
            (Vector3::new(k.fx, 0.0, k.cx), 0.0),
            (Vector3::new(-k.fx, 0.0, width - k.cx), 0.0),
            (Vector3::new(0.0, k.fy, k.cy), 0.0),
            (Vector3::new(0.0, -k.fy, height - k.cy), 0.0),
            (Vector3::z(), -camera.near_m),
            (-Vector3::z(), camera.far_m),
        ];
        Self { camera_from_world: camera.world_from_camera.inverse(), half_spaces }
    }

    /// False only where no point of the box is in the frustum.
    pub fn may_see(&self, world_from_body: &Pose, bounds: &Bounds) -> bool {
        let camera_from_body = self.camera_from_world * world_from_body;
        let center = camera_from_body * bounds.center;
        self.half_spaces.iter().all(|(normal, offset)| {
            let in_body = camera_from_body.inverse_transform_vector(normal);
            let reach = in_body.abs().dot(&bounds.half_extents);
            normal.dot(&center.coords) + offset + reach >= 0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use akrobat_cameras::Intrinsics;

    use super::*;

    fn camera() -> PlacedCamera {
        PlacedCamera {
            name: "test".into(),
            intrinsics: Intrinsics::from_horizontal_fov(320, 240, std::f64::consts::FRAC_PI_2),
            near_m: 0.1,
            far_m: 10.0,
            world_from_camera: Pose::identity(),
            normals: false,
        }
    }

    #[test]
    fn only_boxes_outside_the_frustum_are_culled() {
        let frustum = Frustum::new(&camera());
        let unit = Bounds::from_corners([-0.5; 3], [0.5; 3]);
        let sees = |x: f64, y: f64, z: f64| frustum.may_see(&Pose::translation(x, y, z), &unit);
        assert!(sees(0.0, 0.0, 2.0));
        assert!(sees(0.0, 0.0, 0.0), "the camera is inside the box");
        assert!(sees(2.4, 0.0, 2.0), "straddles the right edge");
        assert!(!sees(4.0, 0.0, 2.0), "right of the image");
        assert!(!sees(-4.0, 0.0, 2.0), "left of the image");
        assert!(!sees(0.0, 4.0, 2.0), "below the image");
        assert!(!sees(0.0, -4.0, 2.0), "above the image");
        assert!(!sees(0.0, 0.0, -1.0), "behind the camera");
        assert!(!sees(0.0, 0.0, 11.0), "beyond far");
    }

    #[test]
    fn distance_from_the_origin_costs_no_precision() {
        let far_away = Pose::translation(1e6, -1e6, 1e6);
        let camera_from_body = far_away.inverse() * (far_away * Pose::translation(0.0, 0.0, 1.25));
        let body = BodyInView::new(&camera_from_body, 3);
        assert!((body.camera_from_body[2][3] - 1.25).abs() < 1e-6, "{body:?}");
    }
}
