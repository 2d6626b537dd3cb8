//! Computes depth, colour and segment of every pixel from its nearest triangle.

use akrobat_cameras::CameraFrame;
use akrobat_model::TriMesh;

use super::view::{Transform, View};
use super::visibility::Visibility;
use crate::backend::PlacedCamera;
use crate::clusters::ClusteredScene;
use crate::srgb::SrgbTables;
use crate::{Lighting, RenderScene};

/// The images of one camera.
pub(super) fn shade(
    view: &View,
    camera: &PlacedCamera,
    scene: &RenderScene,
    clusters: &ClusteredScene,
    visibility: &Visibility,
) -> CameraFrame {
    let pixels = view.width * view.height;
    let mut frame = CameraFrame {
        name: camera.name.clone(),
        intrinsics: camera.intrinsics,
        world_from_camera: camera.world_from_camera,
        rgb: scene.lighting.background_rgb.repeat(pixels),
        depth_m: vec![0.0; pixels],
        segmentation: vec![0; pixels],
    };
    let light = CameraLight::new(&scene.lighting, &view.camera_from_world);
    let srgb = SrgbTables::get();
    let rays_x: Vec<f32> = (0..view.width)
        .map(|u| ((u as f64 + 0.5 - view.center[0]) / view.focal[0]) as f32)
        .collect();
    for v in 0..view.height {
        let ray_y = ((v as f64 + 0.5 - view.center[1]) / view.focal[1]) as f32;
        let row = &visibility.triangle[v * view.stride..][..view.width];
        let mut last: Option<(u32, Surface<'_>)> = None;
        for (u, &value) in row.iter().enumerate() {
            if value == 0 {
                continue;
            }
            if last.as_ref().is_none_or(|(of, _)| *of != value) {
                last =
                    Some((value, Surface::new(view, scene, clusters, visibility, value, &light)));
            }
            let Some((_, surface)) = &last else { continue };
            let at = v * view.width + u;
            let (depth, color) = surface.at(rays_x[u], ray_y, view.far, &light, srgb);
            frame.depth_m[at] = depth;
            frame.segmentation[at] = surface.segment;
            let encoded = color.map(|linear| srgb.encode(linear));
            frame.rgb[3 * at..3 * at + 3].copy_from_slice(&encoded);
        }
    }
    frame
}

/// Light in the camera frame.
struct CameraLight {
    sun: [f32; 3],
    up: [f32; 3],
    sun_rgb: [f32; 3],
    middle_rgb: [f32; 3],
    half_difference_rgb: [f32; 3],
}

impl CameraLight {
    fn new(lighting: &Lighting, camera_from_world: &Transform) -> Self {
        let (sky, ground) = (lighting.sky_rgb, lighting.ground_rgb);
        Self {
            sun: camera_from_world.rotate(lighting.sun_unit()),
            up: camera_from_world.rotate([0.0, 0.0, 1.0]),
            sun_rgb: lighting.sun_rgb,
            middle_rgb: std::array::from_fn(|i| 0.5 * (ground[i] + sky[i])),
            half_difference_rgb: std::array::from_fn(|i| 0.5 * (sky[i] - ground[i])),
        }
    }

    /// Light on a surface with unit normal `n`, which faces the camera.
    #[inline(always)]
    fn on(&self, n: [f32; 3]) -> [f32; 3] {
        let (toward_sun, upward) = (dot(n, self.sun).max(0.0), dot(n, self.up));
        std::array::from_fn(|i| {
            self.middle_rgb[i] + self.half_difference_rgb[i] * upward + self.sun_rgb[i] * toward_sun
        })
    }
}

/// A triangle ready to be evaluated at pixels.
struct Surface<'a> {
    segment: u16,
    mesh: &'a TriMesh,
    /// Vertices in the mesh.
    corners: [usize; 3],
    camera_from_body: &'a Transform,
    /// First corner, camera frame.
    origin: [f64; 3],
    /// Plane `normal . p = offset`, camera frame.
    normal: [f64; 3],
    offset: f64,
    nearest: f32,
    farthest: f32,
    /// `dot(p - origin, gradient[i])` is the weight of corner i + 1 at a point p of the plane.
    gradient: [[f64; 3]; 2],
    /// Light on the whole triangle where it has no vertex normals.
    flat_light: Option<[f32; 3]>,
}

impl<'a> Surface<'a> {
    fn new(
        view: &'a View,
        scene: &'a RenderScene,
        clusters: &'a ClusteredScene,
        visibility: &Visibility,
        value: u32,
        light: &CameraLight,
    ) -> Self {
        let (drawn, index) = visibility.lookup(value);
        let instance = &clusters.instances[drawn.instance as usize];
        let cluster = &instance.mesh.clusters[drawn.cluster as usize];
        let triangle = instance.mesh.triangles[cluster.triangles.start + index];
        let mesh: &TriMesh = &instance.mesh.mesh;
        let p = triangle.corners.map(|corner| {
            let vertex = drawn.first_vertex as usize + usize::from(corner);
            visibility.position.each_ref().map(|axis| f64::from(axis[vertex]))
        });
        let (e1, e2) = (subtract(p[1], p[0]), subtract(p[2], p[0]));
        let normal = cross(e1, e2);
        let square = dot64(normal, normal);
        let inverse_square = if square > 0.0 { 1.0 / square } else { 0.0 };
        let z = p.map(|p| p[2] as f32);
        let offset = dot64(normal, p[0]);
        let flat_light = (mesh.normals.len() != mesh.positions.len()).then(|| {
            let scale = inverse_square.sqrt();
            // The eye is at the origin: the plane's near side has a negative offset.
            let sign = if offset > 0.0 { -scale } else { scale };
            light.on(normal.map(|c| (c * sign) as f32))
        });
        Self {
            segment: scene.bodies[instance.body].segment_id,
            mesh,
            corners: mesh.triangles[triangle.source as usize].map(|vertex| vertex as usize),
            camera_from_body: &view.camera_from_body[instance.body],
            origin: p[0],
            offset,
            nearest: z[0].min(z[1]).min(z[2]).max(view.near),
            farthest: z[0].max(z[1]).max(z[2]),
            gradient: [
                cross(e2, normal).map(|c| c * inverse_square),
                cross(normal, e1).map(|c| c * inverse_square),
            ],
            normal,
            flat_light,
        }
    }

    /// Depth (metres) and linear colour where the ray `(x, y, 1)` meets the triangle.
    #[inline(always)]
    fn at(
        &self,
        ray_x: f32,
        ray_y: f32,
        far: f32,
        light: &CameraLight,
        srgb: &SrgbTables,
    ) -> (f32, [f32; 3]) {
        let ray = [f64::from(ray_x), f64::from(ray_y), 1.0];
        let exact = self.offset / dot64(self.normal, ray);
        // Coverage is decided on the grid, so the ray may just miss the triangle: stay within its depths.
        let depth = (exact as f32).min(self.farthest).max(self.nearest).min(far);
        let weights = self.weights(ray.map(|c| c * f64::from(depth)));
        let received = self.flat_light.unwrap_or_else(|| {
            let normals = self.corners.map(|vertex| self.mesh.normals[vertex]);
            let n = normalized(self.camera_from_body.rotate(mix(normals, weights)));
            let away = n[0] * ray_x + n[1] * ray_y + n[2] > 0.0;
            light.on(if away { n.map(|c| -c) } else { n })
        });
        let albedo = self.albedo(weights, srgb);
        (depth, std::array::from_fn(|i| albedo[i] * received[i]))
    }

    /// Weights of the corners at a point of the plane, kept within the triangle.
    #[inline(always)]
    fn weights(&self, point: [f64; 3]) -> [f32; 3] {
        let offset = subtract(point, self.origin);
        let second = (dot64(offset, self.gradient[0]) as f32).clamp(0.0, 1.0);
        let third = (dot64(offset, self.gradient[1]) as f32).clamp(0.0, 1.0 - second);
        [1.0 - second - third, second, third]
    }

    #[inline(always)]
    fn albedo(&self, weights: [f32; 3], srgb: &SrgbTables) -> [f32; 3] {
        let material = &self.mesh.material;
        let [r, g, b, _] = material.base_color;
        let Some(texture) = &material.base_color_texture else { return [r, g, b] };
        if self.mesh.uvs.len() != self.mesh.positions.len() || texture.is_empty() {
            return [r, g, b];
        }
        let uv = mix(self.corners.map(|vertex| self.mesh.uvs[vertex]), weights);
        let texel = bilinear(texture, uv, srgb);
        [r * texel[0], g * texel[1], b * texel[2]]
    }
}

/// Bilinear sample in linear RGB with repeat wrapping.
fn bilinear(texture: &image::RgbaImage, uv: [f32; 2], srgb: &SrgbTables) -> [f32; 3] {
    let size = [texture.width(), texture.height()];
    let axis = |i: usize| {
        let wrapped = uv[i] - uv[i].floor();
        let place = if wrapped.is_finite() { wrapped * size[i] as f32 - 0.5 } else { 0.0 };
        let first = place.floor();
        let low = (first as i64).rem_euclid(i64::from(size[i])) as u32;
        ([low, (low + 1) % size[i]], place - first)
    };
    let ((x, fraction_x), (y, fraction_y)) = (axis(0), axis(1));
    let texel = |x: u32, y: u32| {
        let [r, g, b, _] = texture.get_pixel(x, y).0;
        [srgb.decode(r), srgb.decode(g), srgb.decode(b)]
    };
    let (top, bottom) = (
        lerp(texel(x[0], y[0]), texel(x[1], y[0]), fraction_x),
        lerp(texel(x[0], y[1]), texel(x[1], y[1]), fraction_x),
    );
    lerp(top, bottom, fraction_y)
}

#[inline(always)]
fn lerp(a: [f32; 3], b: [f32; 3], fraction: f32) -> [f32; 3] {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * fraction)
}

#[inline(always)]
fn mix<const N: usize>(values: [[f32; N]; 3], weights: [f32; 3]) -> [f32; N] {
    std::array::from_fn(|i| {
        values[0][i] * weights[0] + values[1][i] * weights[1] + values[2][i] * weights[2]
    })
}

#[inline(always)]
fn normalized(v: [f32; 3]) -> [f32; 3] {
    let square = dot(v, v);
    let scale = if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 };
    v.map(|c| c * scale)
}

#[inline(always)]
fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn dot64(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

#[inline(always)]
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
