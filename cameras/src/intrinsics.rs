//! Pinhole intrinsics.

use serde::{Deserialize, Serialize};

/// Horizontal aperture of Isaac Sim's default camera, millimetres; focal lengths in millimetres
/// (as the paper states them) refer to it.
pub const ISAAC_HORIZONTAL_APERTURE_MM: f64 = 20.955;

/// An ideal pinhole camera. Pixel centres lie at integer + 0.5: the top-left pixel covers
/// `[0, 1) x [0, 1)`, so a centred principal point is `(width / 2, height / 2)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// Square pixels, centred principal point, from a focal length and a horizontal aperture (same unit).
    pub fn from_focal_length(width: u32, height: u32, focal_mm: f64, aperture_mm: f64) -> Self {
        let f = f64::from(width) * focal_mm / aperture_mm;
        let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
        Self { width, height, fx: f, fy: f, cx, cy }
    }

    /// Square pixels, centred principal point, from a horizontal field of view (radians).
    pub fn from_horizontal_fov(width: u32, height: u32, fov_rad: f64) -> Self {
        Self::from_focal_length(width, height, 0.5 / (fov_rad / 2.0).tan(), 1.0)
    }

    /// From the 3 x 3 matrix K, row-major.
    pub fn from_matrix(width: u32, height: u32, k: &[[f64; 3]; 3]) -> Self {
        Self { width, height, fx: k[0][0], fy: k[1][1], cx: k[0][2], cy: k[1][2] }
    }

    /// The 3 x 3 matrix K, row-major.
    pub fn matrix(&self) -> [[f64; 3]; 3] {
        [[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]]
    }

    /// Camera-frame point (metres) of pixel centre `(u + 0.5, v + 0.5)` at z-depth `depth_m`.
    pub fn unproject(&self, u: u32, v: u32, depth_m: f64) -> [f64; 3] {
        [
            (f64::from(u) + 0.5 - self.cx) / self.fx * depth_m,
            (f64::from(v) + 0.5 - self.cy) / self.fy * depth_m,
            depth_m,
        ]
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Horizontal and vertical field of view without distortion, radians.
    pub fn field_of_view_rad(&self) -> [f64; 2] {
        let angle = |pixels: u32, focal: f64, center: f64| {
            (center / focal).atan() + ((f64::from(pixels) - center) / focal).atan()
        };
        [angle(self.width, self.fx, self.cx), angle(self.height, self.fy, self.cy)]
    }
}
