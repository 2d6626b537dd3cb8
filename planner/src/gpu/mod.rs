//! The planner's kernels on a graphics processor.
//!
//! Robots, fields and problems are data in storage buffers: one set of shaders (`planner/shaders/`) serves all tasks. A
//! batch is uploaded, iterates on the device, and is read back once. Everything there is single precision; what comes back
//! is polished and checked in double precision as the CPU's own results are.

mod ik;
mod layout;
mod pipelines;
mod probe;
mod trajopt;

use akrobat_gpu::{
    AdapterChoice, AdapterDescription, AdapterKind, Context, GpuError, StorageBuffer, wgpu,
};
use bytemuck::Pod;

pub use ik::Reached;

use self::layout::{Body, Joint, Scene};
use self::pipelines::Pipelines;
use crate::world::World;

/// An opened device with the planner's shaders.
#[derive(Debug)]
pub struct Gpu {
    context: Context,
    pipelines: Pipelines,
}

impl Gpu {
    /// Opens the adapter of the user's choice.
    ///
    /// # Errors
    /// [`GpuError`] where there is none, or it refuses the shaders.
    pub fn open(choice: &AdapterChoice) -> Result<Self, GpuError> {
        let context = Context::new(choice)?;
        let pipelines = Pipelines::new(&context)?;
        context.check()?;
        Ok(Self { context, pipelines })
    }

    /// The adapter in use.
    pub fn adapter(&self) -> &AdapterDescription {
        self.context.adapter()
    }

    /// Uploads a world's distance fields.
    ///
    /// # Errors
    /// [`GpuError::TooLarge`] where the device cannot hold them.
    pub fn session(&self, world: &World) -> Result<Session<'_>, GpuError> {
        let (scene, values) = layout::scene(world);
        let distances = self.storage("distances", &values)?;
        Ok(Session { gpu: self, scene, distances })
    }

    /// Chunks of seeds that are worth solving ahead: all of them for processors with room for many.
    pub(crate) fn chunks_ahead(&self) -> usize {
        if self.adapter().kind == AdapterKind::Software { 1 } else { 8 }
    }

    fn storage<T: Pod>(&self, label: &str, values: &[T]) -> Result<StorageBuffer<T>, GpuError> {
        StorageBuffer::new(&self.context, label, values, wgpu::BufferUsages::empty())
    }
}

/// A world on the device.
#[derive(Debug)]
pub struct Session<'a> {
    gpu: &'a Gpu,
    scene: Scene,
    distances: StorageBuffer<f32>,
}

impl Session<'_> {
    /// The device.
    pub(crate) fn gpu(&self) -> &Gpu {
        self.gpu
    }

    /// Group 0: the world, chains and a body.
    fn stage(&self, joints: &[Joint], body: Option<&Body>) -> Result<wgpu::BindGroup, GpuError> {
        let gpu = self.gpu;
        let mut scene = self.scene;
        let (mut spheres, mut links, mut pairs) = (&[][..], &[][..], &[][..]);
        if let Some(body) = body {
            (spheres, links, pairs) = (&body.spheres, &body.links, &body.pairs);
        }
        (scene.links, scene.pairs) = (links.len() as u32, pairs.len() as u32);
        let uniform = wgpu::BufferUsages::UNIFORM;
        let scene = StorageBuffer::new(&gpu.context, "scene", &[scene], uniform)?;
        let joints = gpu.storage("joints", joints)?;
        let spheres = gpu.storage("spheres", spheres)?;
        let links = gpu.storage("links", links)?;
        let pairs = gpu.storage("pairs", pairs)?;
        let bindings = [
            scene.binding(),
            joints.binding(),
            spheres.binding(),
            links.binding(),
            pairs.binding(),
            self.distances.binding(),
        ];
        Ok(gpu.pipelines.stage_group(&gpu.context, bindings))
    }
}

/// Dispatches passes one after the other; each waits for what the one before has written.
fn run(
    gpu: &Gpu,
    groups: [&wgpu::BindGroup; 2],
    passes: impl IntoIterator<Item = (pipelines::Kernel, usize)>,
) {
    let mut encoder = gpu.context.device().create_command_encoder(&Default::default());
    {
        let mut pass = encoder.begin_compute_pass(&Default::default());
        for (group, index) in groups.into_iter().zip(0..) {
            pass.set_bind_group(index, group, &[]);
        }
        for (kernel, invocations) in passes {
            pass.set_pipeline(gpu.pipelines.get(kernel));
            let groups = (invocations as u32).div_ceil(kernel.workgroup());
            pass.dispatch_workgroups(groups, 1, 1);
        }
    }
    gpu.context.queue().submit([encoder.finish()]);
}
