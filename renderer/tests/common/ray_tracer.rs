//! The image model, spelled out: one ray per pixel against every triangle, in f64.

use std::ops::RangeInclusive;

use akrobat_cameras::CameraFrame;
use akrobat_model::{Pose, TriMesh};
use akrobat_renderer::{FrameState, Lighting, PlacedCamera, RenderScene};
use nalgebra::{Point3, Vector3};

type Vec3 = Vector3<f64>;

struct Triangle<'a> {
    segment_id: u16,
    mesh: &'a TriMesh,
    vertices: [usize; 3],
    /// World frame.
    corners: [Vec3; 3],
    world_from_body: &'a Pose,
}

struct Hit<'a> {
    depth_m: f64,
    triangle: &'a Triangle<'a>,
    /// Weights of the three corners.
    weights: [f64; 3],
}

/// Renders a camera after the image model.
pub fn ray_traced(scene: &RenderScene, frame: &FrameState, camera: &PlacedCamera) -> CameraFrame {
    let triangles = triangles(scene, frame);
    let k = camera.intrinsics;
    let mut image = CameraFrame::new(&camera.name, k, camera.world_from_camera);
    let eye = camera.world_from_camera.translation.vector;
    for v in 0..k.height {
        for u in 0..k.width {
            // z-depth is the parameter along a ray whose z component is 1 in the camera frame.
            let ray = camera.world_from_camera.rotation * Vec3::from(k.unproject(u, v, 1.0));
            match first_hit(&triangles, camera.near_m..=camera.far_m, &eye, &ray) {
                Some(hit) => {
                    image.rgb.extend(color(&hit, &ray, &scene.lighting));
                    image.depth_m.push(hit.depth_m as f32);
                    image.segmentation.push(hit.triangle.segment_id);
                }
                None => {
                    image.rgb.extend(scene.lighting.background_rgb);
                    image.depth_m.push(0.0);
                    image.segmentation.push(0);
                }
            }
        }
    }
    image
}

fn triangles<'a>(scene: &'a RenderScene, frame: &'a FrameState) -> Vec<Triangle<'a>> {
    let mut triangles = Vec::new();
    for (body, world_from_body) in scene.bodies.iter().zip(&frame.world_from_body) {
        for mesh in &body.meshes {
            triangles.extend(mesh.triangles.iter().map(|triangle| {
                let vertices = triangle.map(|vertex| vertex as usize);
                let corners = vertices.map(|vertex| {
                    let position = Point3::from(mesh.positions[vertex]).cast::<f64>();
                    (world_from_body * position).coords
                });
                let segment_id = body.segment_id;
                Triangle { segment_id, mesh, vertices, corners, world_from_body }
            }));
        }
    }
    triangles
}

fn first_hit<'a>(
    triangles: &'a [Triangle<'a>],
    visible_m: RangeInclusive<f64>,
    eye: &Vec3,
    ray: &Vec3,
) -> Option<Hit<'a>> {
    triangles
        .iter()
        .filter_map(|triangle| {
            let (depth_m, weights) = intersect(eye, ray, &triangle.corners)?;
            visible_m.contains(&depth_m).then_some(Hit { depth_m, triangle, weights })
        })
        .min_by(|a, b| a.depth_m.total_cmp(&b.depth_m))
}

/// Parameter along the ray and weights of the corners (Cramer's rule).
fn intersect(eye: &Vec3, ray: &Vec3, corners: &[Vec3; 3]) -> Option<(f64, [f64; 3])> {
    let [a, b, c] = corners;
    let (ab, ac, from_a) = (b - a, c - a, eye - a);
    let determinant = -ray.dot(&ab.cross(&ac));
    if determinant == 0.0 {
        return None;
    }
    let weight_b = -ray.dot(&from_a.cross(&ac)) / determinant;
    let weight_c = -ray.dot(&ab.cross(&from_a)) / determinant;
    let weight_a = 1.0 - weight_b - weight_c;
    let inside = weight_a >= 0.0 && weight_b >= 0.0 && weight_c >= 0.0;
    inside.then(|| (from_a.dot(&ab.cross(&ac)) / determinant, [weight_a, weight_b, weight_c]))
}

fn color(hit: &Hit<'_>, ray: &Vec3, lighting: &Lighting) -> [u8; 3] {
    let Triangle { mesh, vertices, corners, world_from_body, .. } = hit.triangle;
    let mut normal = if mesh.normals.is_empty() {
        let [a, b, c] = corners;
        (b - a).cross(&(c - a))
    } else {
        let blended: Vec3 = (0..3)
            .map(|i| Vec3::from(mesh.normals[vertices[i]].map(f64::from)) * hit.weights[i])
            .sum();
        world_from_body.rotation * blended
    }
    .normalize();
    if normal.dot(ray) > 0.0 {
        normal = -normal;
    }
    let albedo = albedo(hit);
    let sun = lighting.sun_unit().map(f64::from);
    let facing_sun = normal.dot(&Vec3::from(sun)).max(0.0);
    std::array::from_fn(|channel| {
        let ground = f64::from(lighting.ground_rgb[channel]);
        let sky = f64::from(lighting.sky_rgb[channel]);
        let ambient = ground + (sky - ground) * (1.0 + normal.z) / 2.0;
        let linear =
            albedo[channel] * (ambient + f64::from(lighting.sun_rgb[channel]) * facing_sun);
        (255.0 * encode(linear.clamp(0.0, 1.0))).round() as u8
    })
}

fn albedo(hit: &Hit<'_>) -> [f64; 3] {
    let Triangle { mesh, vertices, .. } = hit.triangle;
    let material = &mesh.material;
    let texel = match &material.base_color_texture {
        Some(texture) if !mesh.uvs.is_empty() => {
            let uv: [f64; 2] = std::array::from_fn(|axis| {
                (0..3).map(|i| f64::from(mesh.uvs[vertices[i]][axis]) * hit.weights[i]).sum()
            });
            bilinear(texture, uv)
        }
        _ => [1.0; 3],
    };
    std::array::from_fn(|channel| f64::from(material.base_color[channel]) * texel[channel])
}

fn bilinear(texture: &image::RgbaImage, [u, v]: [f64; 2]) -> [f64; 3] {
    let (width, height) = texture.dimensions();
    let (x, y) = (u * f64::from(width) - 0.5, v * f64::from(height) - 0.5);
    let texel = |column: f64, row: f64, channel: usize| {
        let column = column.rem_euclid(f64::from(width)) as u32;
        let row = row.rem_euclid(f64::from(height)) as u32;
        decode(f64::from(texture.get_pixel(column, row)[channel]) / 255.0)
    };
    let (left, top) = (x.floor(), y.floor());
    let (right_weight, bottom_weight) = (x - left, y - top);
    std::array::from_fn(|channel| {
        let blend = |row: f64| {
            texel(left, row, channel) * (1.0 - right_weight)
                + texel(left + 1.0, row, channel) * right_weight
        };
        blend(top) * (1.0 - bottom_weight) + blend(top + 1.0) * bottom_weight
    })
}

fn encode(linear: f64) -> f64 {
    if linear <= 0.0031308 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

fn decode(encoded: f64) -> f64 {
    if encoded <= 0.04045 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
}
