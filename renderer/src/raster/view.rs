//! What changes with every frame and camera: projection, light and body poses.

use akrobat_gpu::{Context, GpuError, StorageBuffer, wgpu};
use akrobat_model::Pose;
use bytemuck::{Pod, Zeroable};
use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::pipeline::Pipeline;
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
        let matrix = camera_from_body.to_homogeneous();
        Self {
            camera_from_body: std::array::from_fn(|row| {
                std::array::from_fn(|column| matrix[(row, column)] as f32)
            }),
            segment_id: segment_id.into(),
        }
    }
}

/// The uniform `View` of the shader; `vec3` members are padded to 16 bytes.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct ViewUniform {
    scale: [f32; 2],
    offset: [f32; 2],
    near_m: f32,
    far_m: f32,
    padding: [f32; 2],
    sun_direction: [f32; 4],
    sun_rgb: [f32; 4],
    up_direction: [f32; 4],
    sky_rgb: [f32; 4],
    ground_rgb: [f32; 4],
}

impl ViewUniform {
    fn new(camera: &PlacedCamera, lighting: &Lighting) -> Self {
        let k = &camera.intrinsics;
        let (width, height) = (f64::from(k.width), f64::from(k.height));
        let camera_from_world = camera.world_from_camera.rotation.inverse();
        let padded = |[x, y, z]: [f32; 3]| [x, y, z, 0.0];
        Self {
            scale: [(2.0 * k.fx / width) as f32, (2.0 * k.fy / height) as f32],
            offset: [(2.0 * k.cx / width - 1.0) as f32, (2.0 * k.cy / height - 1.0) as f32],
            near_m: camera.near_m as f32,
            far_m: camera.far_m as f32,
            padding: [0.0; 2],
            sun_direction: padded(rotate(&camera_from_world, lighting.sun_unit())),
            sun_rgb: padded(lighting.sun_rgb),
            up_direction: padded(rotate(&camera_from_world, [0.0, 0.0, 1.0])),
            sky_rgb: padded(lighting.sky_rgb),
            ground_rgb: padded(lighting.ground_rgb),
        }
    }
}

fn rotate(rotation: &UnitQuaternion<f64>, direction: [f32; 3]) -> [f32; 3] {
    (rotation * Vector3::from(direction).cast::<f64>()).cast::<f32>().into()
}

/// Per-frame buffers, grown as needed.
#[derive(Debug)]
pub struct Views {
    stride: usize,
    uniforms: StorageBuffer<u8>,
    group: wgpu::BindGroup,
    bodies: StorageBuffer<BodyInView>,
}

impl Views {
    pub fn new(context: &Context, pipeline: &Pipeline) -> Result<Self, GpuError> {
        let alignment = context.device().limits().min_uniform_buffer_offset_alignment as usize;
        let stride = size_of::<ViewUniform>().next_multiple_of(alignment);
        let uniforms = uniform_buffer(context, stride)?;
        let group = bind_group(context, pipeline, &uniforms);
        let bodies = body_buffer(context, 1)?;
        Ok(Self { stride, uniforms, group, bodies })
    }

    /// Uploads projection, light and body poses of every camera.
    pub fn write(
        &mut self,
        context: &Context,
        pipeline: &Pipeline,
        scene: &RenderScene,
        frame: &FrameState,
        cameras: &[PlacedCamera],
    ) -> Result<(), GpuError> {
        let mut uniforms = vec![0; cameras.len() * self.stride];
        let mut bodies = Vec::with_capacity(cameras.len() * scene.bodies.len());
        for (slot, camera) in uniforms.chunks_mut(self.stride).zip(cameras) {
            let uniform = ViewUniform::new(camera, &scene.lighting);
            slot[..size_of::<ViewUniform>()].copy_from_slice(bytemuck::bytes_of(&uniform));
            let camera_from_world = camera.world_from_camera.inverse();
            bodies.extend(scene.bodies.iter().zip(&frame.world_from_body).map(
                |(body, world_from_body)| {
                    BodyInView::new(&(camera_from_world * world_from_body), body.segment_id)
                },
            ));
        }
        if uniforms.len() > self.uniforms.len() {
            self.uniforms = uniform_buffer(context, uniforms.len())?;
            self.group = bind_group(context, pipeline, &self.uniforms);
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
        let size = body_count * size_of::<BodyInView>();
        let range = (index * size) as u64..((index + 1) * size) as u64;
        pass.set_bind_group(0, &self.group, &[(index * self.stride) as u32]);
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

fn bind_group(
    context: &Context,
    pipeline: &Pipeline,
    uniforms: &StorageBuffer<u8>,
) -> wgpu::BindGroup {
    context.device().create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("view"),
        layout: pipeline.view_layout(),
        entries: &[wgpu::BindGroupEntry {
            binding: 0,
            resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                buffer: uniforms.raw(),
                offset: 0,
                size: wgpu::BufferSize::new(size_of::<ViewUniform>() as u64),
            }),
        }],
    })
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
