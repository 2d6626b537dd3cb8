//! Where the handle is, and which cameras see it.

use akrobat_cameras::CameraFrame;
use akrobat_model::task::Task;
use akrobat_model::trajectory::Grasp;
use akrobat_model::{ModelError, Pose};
use nalgebra::Point3;

use crate::FrameState;

/// How far something may lie in front of the handle without hiding it, metres: the fingers that hold it
/// do, and the handle has a thickness of its own.
pub const HANDLE_DEPTH_TOLERANCE_M: f64 = 0.05;

/// The place on the object where it is held: the origin of the tool frame at the grasp, fixed to the held
/// link.
#[derive(Debug, Clone, Copy)]
pub struct Handle {
    link: usize,
    link_from_tool: Pose,
}

impl Handle {
    /// The handle that a grasp holds.
    ///
    /// # Errors
    /// [`ModelError::UnknownName`] where the object has no such link.
    pub fn new(task: &Task, grasp: &Grasp) -> Result<Self, ModelError> {
        let link = task.object.tree.link_index(&grasp.link)?;
        Ok(Self { link, link_from_tool: grasp.link_from_tool })
    }

    /// Pose that the tool has while it holds the handle.
    pub fn world_from_grasp(&self, frame: &FrameState) -> Pose {
        frame.world_from_object_link[self.link] * self.link_from_tool
    }

    /// Position of the handle in the world, metres.
    pub fn position(&self, frame: &FrameState) -> Point3<f64> {
        self.world_from_grasp(frame).translation.vector.into()
    }
}

/// What one camera sees of the handle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum HandleVisibility {
    /// It projects outside the image, or lies behind the camera.
    OutOfView,
    /// It projects into the image, but something more than [`HANDLE_DEPTH_TOLERANCE_M`] nearer covers it.
    Occluded,
    /// It projects into the image and nothing is in the way.
    Visible,
}

/// What each camera sees of a point of the world (metres): the point is projected through the stored
/// intrinsics and pose and compared with the depth image at that pixel.
pub fn handle_visibility(
    cameras: &[CameraFrame],
    world_position: &Point3<f64>,
) -> Vec<HandleVisibility> {
    cameras.iter().map(|camera| visibility_in(camera, world_position)).collect()
}

fn visibility_in(camera: &CameraFrame, world_position: &Point3<f64>) -> HandleVisibility {
    let p = camera.world_from_camera.inverse_transform_point(world_position);
    let i = &camera.intrinsics;
    if p.z <= 0.0 {
        return HandleVisibility::OutOfView;
    }
    let (u, v) = (i.fx * p.x / p.z + i.cx, i.fy * p.y / p.z + i.cy);
    let inside = (0.0..f64::from(i.width)).contains(&u) && (0.0..f64::from(i.height)).contains(&v);
    if !inside {
        return HandleVisibility::OutOfView;
    }
    let depth_m = f64::from(camera.depth_m[v as usize * i.width as usize + u as usize]);
    if depth_m > 0.0 && depth_m < p.z - HANDLE_DEPTH_TOLERANCE_M {
        HandleVisibility::Occluded
    } else {
        HandleVisibility::Visible
    }
}
