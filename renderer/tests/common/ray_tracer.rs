//! The image model, spelled out: one ray per pixel against every triangle, in f64.

use std::ops::RangeInclusive;

use akrobat_cameras::CameraFrame;
use akrobat_model::{Pose, TriMesh};
use akrobat_renderer::lighting::{Light, Reflection, Shadow};
use akrobat_renderer::{BodyGroup, FrameState, Lighting, PlacedCamera, RenderScene};
use nalgebra::{Point3, Vector3};

type Vec3 = Vector3<f64>;

struct World<'a> {
    triangles: Vec<Triangle<'a>>,
    lighting: &'a Lighting,
}

struct Triangle<'a> {
    segment_id: u16,
    group: BodyGroup,
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
    let world = World { triangles: triangles(scene, frame), lighting: &scene.lighting };
    let k = camera.intrinsics;
    let mut image = CameraFrame::new(&camera.name, k, camera.world_from_camera);
    let eye = camera.world_from_camera.translation.vector;
    for v in 0..k.height {
        for u in 0..k.width {
            // z-depth is the parameter along a ray whose z component is 1 in the camera frame.
            let ray = camera.world_from_camera.rotation * Vec3::from(k.unproject(u, v, 1.0));
            match first_hit(&world.triangles, camera.near_m..=camera.far_m, &eye, &ray) {
                Some(hit) => {
                    image.rgb.extend(color(&world, &hit, &eye, &ray));
                    image.normals.push(normal(&hit, &ray).cast::<f32>().into());
                    image.depth_m.push(hit.depth_m as f32);
                    image.segmentation.push(hit.triangle.segment_id);
                }
                None => {
                    image.rgb.extend(scene.lighting.background_rgb);
                    image.normals.push([0.0; 3]);
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
                Triangle { segment_id, group: body.group, mesh, vertices, corners, world_from_body }
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

/// Unit normal of the surface, facing the eye.
fn normal(hit: &Hit<'_>, ray: &Vec3) -> Vec3 {
    let Triangle { mesh, vertices, corners, world_from_body, .. } = hit.triangle;
    let normal = if mesh.normals.is_empty() {
        let [a, b, c] = corners;
        (b - a).cross(&(c - a))
    } else {
        let blended: Vec3 = (0..3)
            .map(|i| Vec3::from(mesh.normals[vertices[i]].map(f64::from)) * hit.weights[i])
            .sum();
        world_from_body.rotation * blended
    }
    .normalize();
    if normal.dot(ray) > 0.0 { -normal } else { normal }
}

/// How far off its surface a shadow ray starts, metres.
const LIFT_M: f64 = 1e-4;

/// Colour of the point that a ray from `eye` meets.
fn color(world: &World<'_>, hit: &Hit<'_>, eye: &Vec3, ray: &Vec3) -> [u8; 3] {
    let lighting = world.lighting;
    let point = eye + ray * hit.depth_m;
    let n = normal(hit, ray);
    let to_eye = -ray.normalize();
    let albedo = albedo(hit);
    let material = &hit.triangle.mesh.material;
    let (metallic, roughness) = (f64::from(material.metallic), f64::from(material.roughness));
    let pbr = lighting.reflection == Reflection::Pbr;
    let [sky, ground] = lighting.environment.sky_and_ground();
    let ambient = |z: f64, channel: usize| {
        let (sky, ground) = (f64::from(sky[channel]), f64::from(ground[channel]));
        ground + (sky - ground) * (1.0 + z) / 2.0
    };
    let cos_eye = n.dot(&to_eye).max(1e-4);
    let mirror = 2.0 * cos_eye * n - to_eye;
    let blended = mirror.z + (n.z - mirror.z) * roughness;
    let mut linear: [f64; 3] = std::array::from_fn(|channel| {
        if !pbr {
            return albedo[channel] * ambient(n.z, channel);
        }
        let f0 = 0.04 + (albedo[channel] - 0.04) * metallic;
        albedo[channel] * (1.0 - metallic) * ambient(n.z, channel)
            + environment_share(f0, cos_eye, roughness) * ambient(blended, channel)
    });
    for light in &lighting.lights {
        let (to_light, distance, strength, rgb, shadow) = arriving(light, &point);
        let facing = n.dot(&to_light);
        if facing <= 0.0 || strength <= 0.0 {
            continue;
        }
        let hidden = world.triangles.iter().any(|triangle| {
            let casts = match shadow {
                Shadow::None => false,
                Shadow::Moving => triangle.group != BodyGroup::Scene,
                Shadow::All => true,
            };
            casts
                && intersect(&(point + n * LIFT_M), &to_light, &triangle.corners)
                    .is_some_and(|(along, _)| along > LIFT_M && along < distance)
        });
        if hidden {
            continue;
        }
        for channel in 0..3 {
            let reflectance = if pbr {
                let f0 = 0.04 + (albedo[channel] - 0.04) * metallic;
                let diffuse = albedo[channel] * (1.0 - metallic);
                ggx(diffuse, f0, roughness, &n, &to_light, &to_eye)
            } else {
                albedo[channel]
            };
            linear[channel] += reflectance * f64::from(rgb[channel]) * strength * facing;
        }
    }
    linear.map(|c| (255.0 * encode(c.clamp(0.0, 1.0))).round() as u8)
}

/// Unit vector to a light, distance, strength at a point, colour and what casts shadows.
fn arriving(light: &Light, point: &Vec3) -> (Vec3, f64, f64, [f32; 3], Shadow) {
    let vector = |v: &[f32; 3]| Vec3::from(v.map(f64::from));
    match light {
        Light::Directional { direction, rgb, shadow, .. } => {
            (vector(direction).normalize(), f64::INFINITY, 1.0, *rgb, *shadow)
        }
        Light::Point { position, rgb, shadow, .. } => {
            let way = vector(position) - point;
            (way.normalize(), way.norm(), 1.0 / way.norm_squared(), *rgb, *shadow)
        }
        Light::Spot { position, target, rgb, inner_deg, outer_deg, shadow, .. } => {
            let way = vector(position) - point;
            let axis = (vector(target) - vector(position)).normalize();
            let [inner, outer] = [inner_deg, outer_deg].map(|a| f64::from(*a).to_radians().cos());
            let x = ((-way.normalize().dot(&axis) - outer) / (inner - outer)).clamp(0.0, 1.0);
            let strength = x * x * (3.0 - 2.0 * x) / way.norm_squared();
            (way.normalize(), way.norm(), strength, *rgb, *shadow)
        }
    }
}

fn environment_share(f0: f64, cos_eye: f64, roughness: f64) -> f64 {
    let r = [1.0 - roughness, 0.0425 - 0.0275 * roughness];
    let a004 = (r[0] * r[0]).min((-9.28 * cos_eye).exp2()) * r[0] + r[1];
    let scale = -1.04 * a004 + 1.04 - 0.572 * roughness;
    let offset = 1.04 * a004 - 0.04 + 0.022 * roughness;
    f0 * scale + offset
}

/// pi times glTF's metallic-roughness reflectance, spelled out with D, G and F apart.
fn ggx(diffuse: f64, f0: f64, roughness: f64, n: &Vec3, l: &Vec3, v: &Vec3) -> f64 {
    let alpha = roughness.max(0.05).powi(2);
    let h = (l + v).normalize();
    let (nl, nv, nh, vh) = (n.dot(l), n.dot(v).max(1e-4), n.dot(&h).max(0.0), v.dot(&h).max(0.0));
    let fresnel = f0 + (1.0 - f0) * (1.0 - vh).powi(5);
    let pi_d = alpha.powi(2) / (nh.powi(2) * (alpha.powi(2) - 1.0) + 1.0).powi(2);
    let lambda = |c: f64| (((1.0 + alpha.powi(2) * (1.0 / (c * c) - 1.0)).sqrt()) - 1.0) / 2.0;
    let g = 1.0 / (1.0 + lambda(nl) + lambda(nv));
    diffuse * (1.0 - fresnel) + fresnel * pi_d * g / (4.0 * nl * nv)
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
