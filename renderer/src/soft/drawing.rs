//! What a camera sees, with what does not move drawn once for a camera that stays where it is.
//!
//! What does not move is always drawn first, so that where two surfaces are at the same depth the same one is seen whether
//! it was drawn anew or not.

use std::sync::Arc;

use akrobat_model::Pose;

use super::light::CameraLights;
use super::shade::{Images, Shading};
use super::view::{Transform, View};
use super::visibility::Visibility;
use crate::clusters::ClusteredScene;
use crate::srgb::SrgbTables;
use crate::{BodyGroup, FrameState, Lighting, PlacedCamera, RenderBody, RenderScene};

/// Everything that what does not move looks like depends on.
#[derive(Debug)]
struct Standpoint {
    bodies: Arc<[RenderBody]>,
    shown: Vec<bool>,
    /// Poses of those that do not move.
    world_from_body: Vec<Pose>,
    camera: PlacedCamera,
    rows: std::ops::Range<usize>,
}

/// A camera's drawing of some rows, kept from frame to frame.
#[derive(Debug, Default)]
pub(super) struct Drawing {
    visibility: Visibility,
    /// Of the last frame.
    standpoint: Option<Standpoint>,
    /// What does not move, from the second frame at the same standpoint on.
    still: Option<Box<Still>>,
}

/// What does not move, as seen from a standpoint.
#[derive(Debug)]
struct Still {
    visibility: Visibility,
    images: Option<StillImages>,
}

/// Images of it, where no shadow can fall on it from what moves.
#[derive(Debug)]
struct StillImages {
    lighting: Lighting,
    rgb: Vec<u8>,
    depth_m: Vec<f32>,
    segmentation: Vec<u16>,
    normals: Vec<[f32; 3]>,
}

impl StillImages {
    fn new(lighting: &Lighting, images: &Images<'_>) -> Self {
        Self {
            lighting: lighting.clone(),
            rgb: images.rgb.to_vec(),
            depth_m: images.depth_m.to_vec(),
            segmentation: images.segmentation.to_vec(),
            normals: images.normals.to_vec(),
        }
    }

    fn copy_to(&self, images: &mut Images<'_>) {
        images.rgb.copy_from_slice(&self.rgb);
        images.depth_m.copy_from_slice(&self.depth_m);
        images.segmentation.copy_from_slice(&self.segmentation);
        images.normals.copy_from_slice(&self.normals);
    }
}

impl Drawing {
    /// Draws the bodies (by place) that are `shown`.
    pub fn draw(
        &mut self,
        view: &View,
        camera: &PlacedCamera,
        scene: &RenderScene,
        clusters: &ClusteredScene,
        frame: &FrameState,
        shown: &[bool],
    ) {
        let is_still =
            |body: &RenderBody| matches!(body.group, BodyGroup::Scene | BodyGroup::Clutter);
        let bodies = || scene.bodies.iter().zip(shown);
        let still: Vec<bool> = bodies().map(|(body, &shown)| shown && is_still(body)).collect();
        let moving: Vec<bool> = bodies().map(|(body, &shown)| shown && !is_still(body)).collect();
        let poses = || {
            let bodies = scene.bodies.iter().zip(&frame.world_from_body);
            bodies.filter(|(body, _)| is_still(body)).map(|(_, pose)| pose)
        };
        let is_same = self.standpoint.as_ref().is_some_and(|last| {
            Arc::ptr_eq(&last.bodies, &scene.bodies)
                && last.shown == shown
                && last.rows == view.rows
                && sees_the_same(&last.camera, camera)
                && last.world_from_body.iter().eq(poses())
        });
        if !is_same {
            self.still = None;
            self.standpoint = Some(Standpoint {
                bodies: scene.bodies.clone(),
                shown: shown.to_vec(),
                world_from_body: poses().copied().collect(),
                camera: camera.clone(),
                rows: view.rows.clone(),
            });
        }
        match &self.still {
            Some(still) => self.visibility.copy_from(&still.visibility),
            None => {
                self.visibility.reset(view);
                self.visibility.draw(view, clusters, &still);
                let visibility = || self.visibility.clone();
                self.still =
                    is_same.then(|| Box::new(Still { visibility: visibility(), images: None }));
            }
        }
        self.visibility.draw(view, clusters, &moving);
    }

    /// Fills the images of what was drawn last; they come empty.
    pub fn shade(
        &mut self,
        view: &View,
        camera: &PlacedCamera,
        scene: &RenderScene,
        clusters: &ClusteredScene,
        lights: &CameraLights<'_>,
        images: &mut Images<'_>,
    ) {
        let world_from_camera = Transform::new(&camera.world_from_camera);
        let srgb = SrgbTables::get();
        let shading = |visibility| Shading {
            view,
            scene,
            clusters,
            visibility,
            lights,
            world_from_camera,
            srgb,
        };
        let still = self.still.as_deref_mut().filter(|_| !lights.has_shadows());
        let known = still.map(|still| {
            let is_known = |known: &&StillImages| {
                known.lighting == scene.lighting && known.normals.len() == images.normals.len()
            };
            match still.images.as_ref().filter(is_known) {
                Some(known) => known.copy_to(images),
                None => {
                    shading(&still.visibility).fill(images, None);
                    still.images = Some(StillImages::new(&scene.lighting, images));
                }
            }
            still.visibility.last_value()
        });
        shading(&self.visibility).fill(images, known);
    }

    /// What was drawn last.
    pub fn visibility(&self) -> &Visibility {
        &self.visibility
    }
}

fn sees_the_same(a: &PlacedCamera, b: &PlacedCamera) -> bool {
    a.intrinsics == b.intrinsics
        && (a.near_m, a.far_m) == (b.near_m, b.far_m)
        && a.world_from_camera == b.world_from_camera
}
