//! The interface of all renderers.

use akrobat_cameras::{CameraFrame, Intrinsics};
use akrobat_model::Pose;

use crate::{FrameState, RenderError, RenderScene};

/// A camera at its place at one instant.
#[derive(Debug, Clone)]
pub struct PlacedCamera {
    /// Name, from the rig.
    pub name: String,
    /// Intrinsics.
    pub intrinsics: Intrinsics,
    /// Nearest z-depth seen, metres.
    pub near_m: f64,
    /// Farthest z-depth seen, metres.
    pub far_m: f64,
    /// Pose of the camera (x right, y down, z forward).
    pub world_from_camera: Pose,
    /// Whether surface normals are wanted. A backend that has none leaves [`CameraFrame::normals`] empty, and
    /// they are taken from the depth image.
    pub normals: bool,
}

/// Renders frames after the image model of [`crate::scene`].
pub trait Backend: Send {
    /// Name in reports: `soft`, `wgpu`, `sapien`.
    fn name(&self) -> &str;

    /// One image set per camera, in their order.
    ///
    /// What is derived from `scene.bodies` may be kept between calls that pass the same allocation.
    ///
    /// # Errors
    /// [`RenderError::Device`] where the device fails, [`RenderError::Scene`] where the scene does not
    /// fit it.
    fn render(
        &mut self,
        scene: &RenderScene,
        frame: &FrameState,
        cameras: &[PlacedCamera],
    ) -> Result<Vec<CameraFrame>, RenderError>;

    /// Several frames, each with its cameras, as [`Backend::render`] gives them. Backends that are
    /// costly to call (another language, another process) override this.
    ///
    /// # Errors
    /// As [`Backend::render`].
    fn render_batch(
        &mut self,
        scene: &RenderScene,
        frames: &[(FrameState, Vec<PlacedCamera>)],
    ) -> Result<Vec<Vec<CameraFrame>>, RenderError> {
        frames.iter().map(|(frame, cameras)| self.render(scene, frame, cameras)).collect()
    }
}
