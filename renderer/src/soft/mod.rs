//! The CPU rasteriser: no graphics driver needed, the same bytes on every machine and thread count.
//!
//! Per camera, a *visibility* pass finds the nearest triangle of every pixel, and a *shading* pass then
//! computes depth, colour and segment once per pixel. Edge functions are exact integers on a grid of
//! 1/256 pixel with the top-left rule, so neighbouring triangles leave neither gaps nor double hits.
//! Hot loops are compiled twice, for AVX2 and for the baseline; without fused multiply-add both
//! compute the same bits.

mod clip;
mod drawing;
mod light;
mod occlusion;
mod raster;
mod shade;
mod surface;
mod texture;
mod view;
mod visibility;

use std::ops::Range;

use akrobat_cameras::CameraFrame;
use rayon::prelude::*;

use crate::backend::{Backend, PlacedCamera};
use crate::{FrameState, RenderError, RenderScene};
use drawing::Drawing;
use light::{CameraLights, SceneLights};
use shade::Images;
use view::View;

/// Largest image edge, pixels: what the fixed-point grid can hold with its guard band.
const LARGEST_EDGE: u32 = 4096;

/// The CPU rasteriser. Cameras, and bands of their rows, are rendered in parallel on rayon's current pool.
#[derive(Debug, Default)]
pub struct SoftBackend {
    /// Of each band of each camera, kept between frames.
    drawings: Vec<Vec<Drawing>>,
    /// Of each shadow map.
    shadows: Vec<Drawing>,
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
        let lights = SceneLights::new(scene, clusters, frame, &mut self.shadows);
        let lights: Vec<_> = cameras
            .iter()
            .map(|camera| CameraLights::new(&scene.lighting, &lights, &camera.world_from_camera))
            .collect();
        let mut frames: Vec<CameraFrame> =
            cameras.iter().map(|camera| empty_frame(scene, camera)).collect();
        let bands = band_count(cameras.len());
        self.drawings.resize_with(cameras.len().max(self.drawings.len()), Vec::new);
        let mut work = Vec::new();
        let places = cameras.iter().zip(&lights).zip(&mut frames).zip(&mut self.drawings);
        for (((camera, lights), frame), drawings) in places {
            let rows = band_rows(camera.intrinsics.height as usize, bands);
            drawings.resize_with(rows.len(), Drawing::default);
            let bands = images_of_bands(frame, &rows).into_iter().zip(rows).zip(drawings);
            work.extend(bands.map(|((images, rows), drawing)| Band {
                camera,
                lights,
                images,
                rows,
                drawing,
            }));
        }
        let shown = vec![true; scene.bodies.len()];
        work.into_par_iter().with_max_len(1).for_each(|band| {
            let Band { camera, lights, mut images, rows, drawing } = band;
            let view = View::new(camera, &frame.world_from_body, rows);
            drawing.draw(&view, camera, scene, clusters, frame, &shown);
            drawing.shade(&view, camera, scene, clusters, lights, &mut images);
        });
        Ok(frames)
    }
}

/// Some rows of a camera's image.
struct Band<'a> {
    camera: &'a PlacedCamera,
    lights: &'a CameraLights<'a>,
    images: Images<'a>,
    rows: Range<usize>,
    drawing: &'a mut Drawing,
}

/// Bands of each image, so that all threads have work until the end. One thread needs one: what lies in two bands is
/// drawn twice.
fn band_count(cameras: usize) -> usize {
    const BANDS_PER_THREAD: usize = 2;
    match rayon::current_num_threads() {
        1 => 1,
        threads => (threads * BANDS_PER_THREAD).div_ceil(cameras.max(1)),
    }
}

/// The rows of at most `count` bands of about the same height, which begin at tiles.
fn band_rows(height: usize, count: usize) -> Vec<Range<usize>> {
    const SMALLEST: usize = 4 * occlusion::TILE;
    let rows = height.div_ceil(count.max(1)).max(SMALLEST).next_multiple_of(occlusion::TILE);
    (0..height).step_by(rows).map(|start| start..(start + rows).min(height)).collect()
}

/// What a camera sees where nothing is.
fn empty_frame(scene: &RenderScene, camera: &PlacedCamera) -> CameraFrame {
    let pixels = camera.intrinsics.pixels();
    CameraFrame {
        rgb: scene.lighting.background_rgb.repeat(pixels),
        depth_m: vec![0.0; pixels],
        segmentation: vec![0; pixels],
        normals: if camera.normals { vec![[0.0; 3]; pixels] } else { Vec::new() },
        ..CameraFrame::new(&camera.name, camera.intrinsics, camera.world_from_camera)
    }
}

/// A frame's images, divided among bands that cover all rows in order.
fn images_of_bands<'a>(frame: &'a mut CameraFrame, bands: &[Range<usize>]) -> Vec<Images<'a>> {
    fn take<'a, T>(rest: &mut &'a mut [T], count: usize) -> &'a mut [T] {
        let (head, tail) = std::mem::take(rest).split_at_mut(count);
        *rest = tail;
        head
    }
    let width = frame.intrinsics.width as usize;
    let has_normals = usize::from(!frame.normals.is_empty());
    let mut rgb = frame.rgb.as_mut_slice();
    let mut depth_m = frame.depth_m.as_mut_slice();
    let mut segmentation = frame.segmentation.as_mut_slice();
    let mut normals = frame.normals.as_mut_slice();
    let images = bands.iter().map(|rows| {
        let pixels = rows.len() * width;
        Images {
            rgb: take(&mut rgb, 3 * pixels),
            depth_m: take(&mut depth_m, pixels),
            segmentation: take(&mut segmentation, pixels),
            normals: take(&mut normals, has_normals * pixels),
        }
    });
    images.collect()
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
