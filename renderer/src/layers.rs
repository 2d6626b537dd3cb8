//! Images that follow from depth and segmentation: instances, classes, normals, positions and motion.

use akrobat_cameras::{CameraFrame, CameraModel, SegmentTable};
use akrobat_model::Pose;
use nalgebra::{Point3, Vector3};

use crate::FrameState;

/// Instance ids of a segmentation.
pub fn instances(segmentation: &[u16], table: &SegmentTable) -> Vec<u16> {
    segmentation.iter().map(|&segment| table.instance(segment)).collect()
}

/// Class ids of a segmentation.
pub fn classes(segmentation: &[u16], table: &SegmentTable) -> Vec<u16> {
    segmentation.iter().map(|&segment| table.class(segment)).collect()
}

/// The rays `(x, y, 1)` of all pixel centres, as `(x, y)`, row by row; NaN outside the lens' field.
pub fn rays(model: &CameraModel) -> Vec<[f32; 2]> {
    let i = model.intrinsics;
    let pixels = (0..i.height).flat_map(|v| (0..i.width).map(move |u| (u, v)));
    let ray = |(u, v)| {
        let ray = model.ray([f64::from(u) + 0.5, f64::from(v) + 0.5]);
        ray.map_or([f32::NAN; 2], |ray| ray.map(|c| c as f32))
    };
    pixels.map(ray).collect()
}

/// World-frame positions of all pixels, metres; 0 where depth is invalid.
pub fn positions(depth_m: &[f32], rays: &[[f32; 2]], world_from_camera: &Pose) -> Vec<[f32; 3]> {
    let point = |(&depth, &[x, y]): (&f32, &[f32; 2])| {
        if depth <= 0.0 || x.is_nan() {
            return [0.0; 3];
        }
        let [x, y, z] = [x * depth, y * depth, depth].map(f64::from);
        let p = world_from_camera * Point3::new(x, y, z);
        [p.x as f32, p.y as f32, p.z as f32]
    };
    depth_m.iter().zip(rays).map(point).collect()
}

/// Unit normals in the world frame, facing the camera, from depth alone: on each image axis, the
/// neighbour of the same segment whose depth is closer.
pub fn normals_from_depth(image: &CameraFrame, rays: &[[f32; 2]]) -> Vec<[f32; 3]> {
    let i = image.intrinsics;
    let (width, height) = (i.width as usize, i.height as usize);
    let point = |pixel: usize| {
        let depth = image.depth_m[pixel];
        Vector3::new(rays[pixel][0] * depth, rays[pixel][1] * depth, depth)
    };
    let rotation = image.world_from_camera.rotation.cast::<f32>();
    let mut normals = vec![[0.0; 3]; width * height];
    for v in 0..height {
        for u in 0..width {
            let at = v * width + u;
            if image.depth_m[at] <= 0.0 || rays[at][0].is_nan() {
                continue;
            }
            let tangent = |before: Option<usize>, after: Option<usize>| {
                let usable = |other: &usize| {
                    image.segmentation[*other] == image.segmentation[at]
                        && image.depth_m[*other] > 0.0
                        && !rays[*other][0].is_nan()
                };
                let step = |other: usize| (image.depth_m[other] - image.depth_m[at]).abs();
                match (before.filter(usable), after.filter(usable)) {
                    (Some(a), Some(b)) if step(a) < step(b) => Some(point(at) - point(a)),
                    (_, Some(b)) => Some(point(b) - point(at)),
                    (Some(a), None) => Some(point(at) - point(a)),
                    (None, None) => None,
                }
            };
            let right = tangent((u > 0).then(|| at - 1), (u + 1 < width).then_some(at + 1));
            let down = tangent((v > 0).then(|| at - width), (v + 1 < height).then_some(at + width));
            let toward = -point(at);
            let normal = match (right, down) {
                (Some(right), Some(down)) => right.cross(&down).try_normalize(0.0),
                _ => None,
            };
            let normal = normal.unwrap_or_else(|| toward.normalize());
            let facing = if normal.dot(&toward) < 0.0 { -normal } else { normal };
            normals[at] = (rotation * facing).into();
        }
    }
    normals
}

/// Where the scene and a camera are at two instants.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    /// The instant of the images.
    pub now: &'a FrameState,
    /// The later one.
    pub next: &'a FrameState,
    /// Pose of the camera at the later instant.
    pub world_from_next_camera: Pose,
}

impl Motion<'_> {
    /// Motion of every pixel's point in the world, metres, and in the image, pixels; 0 where nothing is
    /// seen. Every segment is rigid, so both are exact; what leaves the image or goes behind the camera
    /// has no flow.
    pub fn flows(
        &self,
        image: &CameraFrame,
        rays: &[[f32; 2]],
        segment_body: impl Fn(u16) -> Option<usize>,
    ) -> (Vec<[f32; 3]>, Vec<[f32; 2]>) {
        let model = image.model();
        let width = image.intrinsics.width as usize;
        let next_camera_from_world = self.world_from_next_camera.inverse();
        let bodies = self.now.world_from_body.iter().zip(&self.next.world_from_body);
        let moves: Vec<Pose> = bodies.map(|(now, next)| next * now.inverse()).collect();
        let mut in_world = vec![[0.0; 3]; rays.len()];
        let mut in_image = vec![[0.0; 2]; rays.len()];
        for (pixel, &[x, y]) in rays.iter().enumerate() {
            let depth = image.depth_m[pixel];
            if depth <= 0.0 || x.is_nan() {
                continue;
            }
            let Some(body) = segment_body(image.segmentation[pixel]) else { continue };
            let [x, y, z] = [x * depth, y * depth, depth].map(f64::from);
            let point = image.world_from_camera * Point3::new(x, y, z);
            let moved = moves[body] * point;
            in_world[pixel] = (moved - point).cast::<f32>().into();
            let seen = next_camera_from_world * moved;
            if let Some([u, v]) = model.project(seen.coords.into()) {
                let from = [(pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5];
                in_image[pixel] = [(u - from[0]) as f32, (v - from[1]) as f32];
            }
        }
        (in_world, in_image)
    }
}
