//! A camera and the bodies before it.

use std::ops::Range;

use akrobat_model::Pose;

use crate::backend::PlacedCamera;
use crate::clusters::Sphere;

/// Sub-pixel positions per pixel of the fixed-point grid.
pub(super) const SUBPIXELS: i32 = 256;

/// Positions on the grid within this distance of the origin (8,192 pixels) are used as they are; what
/// reaches farther is clipped.
pub(super) const GUARD: f32 = (1 << 21) as f32;

/// A rotation and a translation in single precision.
#[derive(Debug, Clone, Copy)]
pub(super) struct Transform {
    /// Row-major rotation.
    pub rotation: [[f32; 3]; 3],
    pub translation: [f32; 3],
}

impl Transform {
    pub fn new(pose: &Pose) -> Self {
        let matrix = pose.rotation.to_rotation_matrix();
        let t = pose.translation.vector;
        Self {
            rotation: std::array::from_fn(|row| {
                std::array::from_fn(|column| matrix[(row, column)] as f32)
            }),
            translation: [t.x as f32, t.y as f32, t.z as f32],
        }
    }

    #[inline(always)]
    pub fn rotate(&self, v: [f32; 3]) -> [f32; 3] {
        let r = &self.rotation;
        std::array::from_fn(|i| r[i][0] * v[0] + r[i][1] * v[1] + r[i][2] * v[2])
    }

    #[inline(always)]
    pub fn apply(&self, p: [f32; 3]) -> [f32; 3] {
        let q = self.rotate(p);
        std::array::from_fn(|i| q[i] + self.translation[i])
    }
}

/// One camera at one instant.
#[derive(Debug)]
pub(super) struct View {
    pub width: usize,
    /// The rows that are drawn; they begin at a tile.
    pub rows: Range<usize>,
    /// Length of a row in the visibility buffers: the width, padded to whole tiles.
    pub stride: usize,
    pub near: f32,
    pub far: f32,
    /// Focal lengths and principal point, pixels.
    pub focal: [f64; 2],
    pub center: [f64; 2],
    /// Camera-frame pose of every body.
    pub camera_from_body: Vec<Transform>,
    /// Inward unit normals of the four planes through the eye and the edges of what is drawn.
    sides: [[f32; 3]; 4],
}

impl View {
    /// The view of some rows of a camera on bodies.
    pub fn new(camera: &PlacedCamera, world_from_body: &[Pose], rows: Range<usize>) -> Self {
        let i = &camera.intrinsics;
        let camera_from_world = camera.world_from_camera.inverse();
        let unit = |v: [f64; 3]| {
            let norm = v.iter().map(|c| c * c).sum::<f64>().sqrt();
            v.map(|c| (c / norm) as f32)
        };
        let width = f64::from(i.width);
        let (top, bottom) = (rows.start as f64, rows.end as f64);
        Self {
            width: i.width as usize,
            stride: (i.width as usize).next_multiple_of(super::occlusion::TILE),
            near: camera.near_m as f32,
            far: camera.far_m as f32,
            focal: [i.fx, i.fy],
            center: [i.cx, i.cy],
            camera_from_body: world_from_body
                .iter()
                .map(|world_from_body| Transform::new(&(camera_from_world * world_from_body)))
                .collect(),
            sides: [
                unit([i.fx, 0.0, i.cx]),
                unit([-i.fx, 0.0, width - i.cx]),
                unit([0.0, i.fy, i.cy - top]),
                unit([0.0, -i.fy, bottom - i.cy]),
            ],
            rows,
        }
    }

    /// Component `axis` of the ray `(x, y, 1)` through the centre of a pixel.
    #[inline(always)]
    pub fn ray(&self, axis: usize, pixel: usize) -> f32 {
        ((pixel as f64 + 0.5 - self.center[axis]) / self.focal[axis]) as f32
    }

    /// A body's sphere in the camera frame.
    #[inline(always)]
    pub fn sphere(&self, body: usize, sphere: &Sphere) -> Sphere {
        let center = self.camera_from_body[body].apply(sphere.center);
        // Rounding of the transformation is far below a thousandth of the distance's millimetres.
        let slack = 1e-6 * (center[0].abs() + center[1].abs() + center[2].abs());
        Sphere { center, radius: sphere.radius + slack }
    }

    /// False only where nothing of the sphere (camera frame) can be in the image.
    #[inline(always)]
    pub fn may_see(&self, sphere: &Sphere) -> bool {
        let [x, y, z] = sphere.center;
        let r = sphere.radius;
        z + r >= self.near
            && z - r <= self.far
            && self.sides.iter().all(|n| n[0] * x + n[1] * y + n[2] * z >= -r)
    }

    /// Pixels `[x0, y0, x1, y1]` (inclusive) that a sphere in front of the near plane can cover; `None`
    /// where it is outside the image or reaches the near plane.
    #[inline(always)]
    pub fn pixel_box(&self, sphere: &Sphere) -> Option<[usize; 4]> {
        let [x, y, z] = sphere.center;
        let r = sphere.radius;
        if z - r < self.near {
            return None;
        }
        let (z_near, z_far) = (z - r, z + r);
        let low = |v: f32| v / if v < 0.0 { z_near } else { z_far };
        let high = |v: f32| v / if v > 0.0 { z_near } else { z_far };
        let range = |v: f32, axis: usize, pixels: Range<usize>| {
            let (f, c) = (self.focal[axis] as f32, self.center[axis] as f32);
            // One pixel of slack outlasts rounding and snapping.
            let from = (low(v - r) * f + c - 1.0).max(pixels.start as f32);
            let to = (high(v + r) * f + c + 1.0).min(pixels.end as f32 - 1.0);
            (from <= to).then_some((from as usize, to as usize))
        };
        let (x0, x1) = range(x, 0, 0..self.width)?;
        let (y0, y1) = range(y, 1, self.rows.clone())?;
        Some([x0, y0, x1, y1])
    }
}
