//! The CPU rasteriser: no graphics driver needed, the same bytes on every machine and thread count.
//!
//! Per camera, a *visibility* pass finds the nearest triangle of every pixel, and a *shading* pass then
//! computes depth, colour and segment once per pixel. Edge functions are exact integers on a grid of
//! 1/256 pixel with the top-left rule, so neighbouring triangles leave neither gaps nor double hits.
//! Hot loops are compiled twice, for AVX2 and for the baseline; without fused multiply-add both
//! compute the same bits.

mod clip;
mod light;
mod occlusion;
mod raster;
mod shade;
mod view;
mod visibility;

use akrobat_cameras::CameraFrame;
use rayon::prelude::*;

use crate::backend::{Backend, PlacedCamera};
use crate::{FrameState, RenderError, RenderScene};
use light::SceneLights;
use view::View;
use visibility::Visibility;

/// Largest image edge, pixels: what the fixed-point grid can hold with its guard band.
const LARGEST_EDGE: u32 = 4096;

/// The CPU rasteriser. Cameras are rendered in parallel on rayon's current pool.
#[derive(Debug, Default)]
pub struct SoftBackend {
    /// Buffers per camera, kept between frames.
    visibility: Vec<Visibility>,
}

impl SoftBackend {
    /// A rasteriser without buffers; they grow with use.
    pub fn new() -> Self {
        Self::default()
    }
}

impl Backend for SoftBackend {
    fn name(&self) -> &str {
        "soft"
    }

    fn render(
        &mut self,
        scene: &RenderScene,
        frame: &FrameState,
        cameras: &[PlacedCamera],
    ) -> Result<Vec<CameraFrame>, RenderError> {
        for camera in cameras {
            check_size(camera)?;
        }
        if frame.world_from_body.len() != scene.bodies.len() {
            return Err(RenderError::Scene {
                scene: scene.name.clone(),
                message: format!(
                    "{} bodies, but the frame has poses of {}",
                    scene.bodies.len(),
                    frame.world_from_body.len()
                ),
            });
        }
        let clusters = scene.clusters();
        self.visibility.resize_with(cameras.len().max(self.visibility.len()), Visibility::default);
        let lights = SceneLights::new(scene, clusters, frame);
        let render_one = |(camera, visibility): (&PlacedCamera, &mut Visibility)| {
            let view = View::new(camera, &frame.world_from_body, |_| true);
            visibility.find(&view, clusters);
            shade::shade(&view, camera, scene, &lights, clusters, visibility)
        };
        Ok(cameras.par_iter().zip(&mut self.visibility).map(render_one).collect())
    }
}

fn check_size(camera: &PlacedCamera) -> Result<(), RenderError> {
    let size = &camera.intrinsics;
    if (1..=LARGEST_EDGE).contains(&size.width) && (1..=LARGEST_EDGE).contains(&size.height) {
        return Ok(());
    }
    Err(RenderError::Device {
        backend: "soft",
        message: format!(
            "camera \"{}\" is {} x {} pixels; each edge must be 1 to {LARGEST_EDGE}",
            camera.name, size.width, size.height
        ),
    })
}
