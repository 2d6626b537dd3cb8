//! A camera's projection: lens and intrinsics.

use crate::{Distortion, Intrinsics};

/// Where a camera puts points (camera frame, metres) in its image (pixels).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraModel {
    /// Size, focal lengths and principal point.
    pub intrinsics: Intrinsics,
    /// The lens.
    pub distortion: Distortion,
}

impl CameraModel {
    /// Pixel position of a point in front of the camera; `None` for what lies behind.
    pub fn project(&self, [x, y, z]: [f64; 3]) -> Option<[f64; 2]> {
        if z.is_nan() || z <= 0.0 {
            return None;
        }
        let [x, y] = self.distortion.distort([x / z, y / z]);
        let i = &self.intrinsics;
        Some([i.fx * x + i.cx, i.fy * y + i.cy])
    }

    /// The ray `(x, y, 1)` that a pixel position sees, as `(x, y)`; `None` outside the lens' field.
    pub fn ray(&self, [u, v]: [f64; 2]) -> Option<[f64; 2]> {
        let i = &self.intrinsics;
        self.distortion.undistort([(u - i.cx) / i.fx, (v - i.cy) / i.fy])
    }
}
