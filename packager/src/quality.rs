//! What no frame of a dataset may be.

use akrobat_cameras::Observation;

/// Farthest a cloud's point may lie from the world's origin, metres.
pub(crate) const CLOUD_RANGE_M: f32 = 100.0;

/// Brightest value of a frame that still counts as black.
pub(crate) const BLACK: u8 = 2;

/// True where nothing can be seen in the image.
pub(crate) fn is_black(rgb: &[u8]) -> bool {
    rgb.iter().all(|&value| value <= BLACK)
}

/// Why a frame cannot be used, if so: the same that validation would complain about.
pub fn defect(observation: &Observation) -> Option<String> {
    let frame = observation.frame;
    if observation.robot.iter().chain(&observation.object).any(|v| !v.is_finite()) {
        return Some(format!("frame {frame}: a joint position is NaN or infinite"));
    }
    let inside = |p: &[f32; 6]| p[..3].iter().all(|v| v.abs() <= CLOUD_RANGE_M);
    if !observation.cloud.iter().all(inside) {
        return Some(format!("frame {frame}: the cloud has points beyond {CLOUD_RANGE_M} m"));
    }
    let unusable = |camera: &akrobat_cameras::CameraFrame| {
        // What was not asked for is empty.
        if !camera.rgb.is_empty() && is_black(&camera.rgb) {
            return Some("is black");
        }
        let blind = !camera.depth_m.iter().any(|d| d.is_finite() && *d > 0.0);
        (blind && !camera.depth_m.is_empty()).then_some("has no depth")
    };
    let found = observation.cameras.iter().find_map(|c| Some((&c.name, unusable(c)?)));
    found.map(|(camera, what)| format!("frame {frame}: camera {camera} {what}"))
}
