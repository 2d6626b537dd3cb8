//! Rasteriser on a graphics processor (Vulkan, Metal or Direct3D 12, through wgpu).
//!
//! Geometry is uploaded once per scene. A frame uploads one matrix per body and camera, draws every
//! camera in one submission and reads all images back at once. Matrices `camera_from_body` are composed in
//! f64, so precision does not depend on the distance from the world's origin.

mod geometry;
mod pipeline;
mod targets;
mod view;

use std::sync::Arc;

use akrobat_cameras::CameraFrame;
use akrobat_gpu::{AdapterChoice, AdapterDescription, Context, GpuError};

use self::geometry::UploadedBodies;
use self::pipeline::Pipeline;
use self::targets::Targets;
use self::view::{FrameLights, Frustum, Views};
use crate::{Backend, FrameState, PlacedCamera, RenderBody, RenderError, RenderScene};

/// The `wgpu` backend.
#[derive(Debug)]
pub struct WgpuBackend {
    context: Context,
    pipeline: Pipeline,
    views: Views,
    targets: Targets,
    uploaded: Option<UploadedBodies>,
}

impl WgpuBackend {
    /// Opens the adapter of the user's choice.
    ///
    /// # Errors
    /// [`RenderError::Device`] where there is none; the message lists those there are.
    pub fn open(choice: &AdapterChoice) -> Result<Self, RenderError> {
        Self::new(Context::new(choice).map_err(device_error)?)
    }

    /// Renders on an opened device.
    ///
    /// # Errors
    /// [`RenderError::Device`] where the device refuses the shaders.
    pub fn new(context: Context) -> Result<Self, RenderError> {
        let pipeline = Pipeline::new(&context).map_err(device_error)?;
        let views = Views::new(&context, &pipeline).map_err(device_error)?;
        Ok(Self { context, pipeline, views, targets: Targets::default(), uploaded: None })
    }

    /// The adapter in use.
    pub fn adapter(&self) -> &AdapterDescription {
        self.context.adapter()
    }

    fn uploaded(&mut self, bodies: &Arc<[RenderBody]>) -> Result<&UploadedBodies, GpuError> {
        let uploaded = match self.uploaded.take() {
            Some(current) if Arc::ptr_eq(current.source(), bodies) => current,
            _ => UploadedBodies::new(&self.context, &self.pipeline, bodies)?,
        };
        Ok(self.uploaded.insert(uploaded))
    }

    fn draw(
        &mut self,
        scene: &RenderScene,
        frame: &FrameState,
        cameras: &[PlacedCamera],
    ) -> Result<Vec<CameraFrame>, GpuError> {
        self.targets.fit(&self.context, cameras)?;
        let lights = FrameLights::new(scene, frame);
        self.views.write(&self.context, &self.pipeline, scene, frame, &lights, cameras)?;
        self.uploaded(&scene.bodies)?;
        let Self { context, pipeline, views, targets, uploaded } = self;
        let bodies = uploaded.as_ref().expect("uploaded above");
        let mut encoder = context.device().create_command_encoder(&Default::default());
        for (index, (view, casters)) in lights.views().enumerate() {
            let mut pass = views.begin_map(&mut encoder, index, scene.bodies.len());
            pass.set_pipeline(pipeline.shadow());
            bodies.draw_shapes(&mut pass, frame, &Frustum::new(view), casters);
        }
        for (index, camera) in cameras.iter().enumerate() {
            let mut pass = targets.begin(&mut encoder, index, scene.lighting.background_rgb);
            pass.set_pipeline(pipeline.raster());
            views.bind(&mut pass, index, scene.bodies.len());
            bodies.draw(&mut pass, frame, &Frustum::new(camera));
        }
        targets.copy_out(&mut encoder);
        context.queue().submit([encoder.finish()]);
        targets.read(context, cameras)
    }
}

impl Backend for WgpuBackend {
    fn name(&self) -> &str {
        "wgpu"
    }

    fn render(
        &mut self,
        scene: &RenderScene,
        frame: &FrameState,
        cameras: &[PlacedCamera],
    ) -> Result<Vec<CameraFrame>, RenderError> {
        if frame.world_from_body.len() != scene.bodies.len() {
            return Err(RenderError::Scene {
                scene: scene.name.clone(),
                message: format!(
                    "expected the poses of its {} bodies, got {}",
                    scene.bodies.len(),
                    frame.world_from_body.len()
                ),
            });
        }
        if cameras.is_empty() {
            return Ok(Vec::new());
        }
        self.draw(scene, frame, cameras).map_err(|error| match error {
            GpuError::TooLarge { .. } => {
                RenderError::Scene { scene: scene.name.clone(), message: error.to_string() }
            }
            other => device_error(other),
        })
    }
}

fn device_error(error: GpuError) -> RenderError {
    RenderError::Device { backend: "wgpu", message: error.to_string() }
}
