//! Computes depth, colour and segment of every pixel from its nearest triangle.

use std::ops::Range;

use akrobat_cameras::CameraFrame;
use akrobat_model::{Material, TriMesh};

use super::light::{CameraLights, Reflector, SceneLights};
use super::view::{Transform, View};
use super::visibility::Visibility;
use crate::RenderScene;
use crate::backend::PlacedCamera;
use crate::clusters::ClusteredScene;
use crate::srgb::SrgbTables;

/// The images of one camera.
pub(super) fn shade(
    view: &View,
    camera: &PlacedCamera,
    scene: &RenderScene,
    lights: &SceneLights,
    clusters: &ClusteredScene,
    visibility: &Visibility,
) -> CameraFrame {
    let pixels = view.width * view.height;
    let mut frame = CameraFrame {
        rgb: scene.lighting.background_rgb.repeat(pixels),
        depth_m: vec![0.0; pixels],
        segmentation: vec![0; pixels],
        normals: if camera.normals { vec![[0.0; 3]; pixels] } else { Vec::new() },
        ..CameraFrame::new(&camera.name, camera.intrinsics, camera.world_from_camera)
    };
    let shading = Shading {
        view,
        scene,
        clusters,
        visibility,
        lights: CameraLights::new(&scene.lighting, lights, &camera.world_from_camera),
        world_from_camera: Transform::new(&camera.world_from_camera),
        srgb: SrgbTables::get(),
        rays_x: (0..view.width).map(|u| view.ray(0, u)).collect(),
    };
    shading.fill(&mut frame);
    frame
}

/// Pixels that are shaded at once where that is possible.
const LANES: usize = 8;

/// What shading reads.
struct Shading<'a> {
    view: &'a View,
    scene: &'a RenderScene,
    clusters: &'a ClusteredScene,
    visibility: &'a Visibility,
    lights: CameraLights<'a>,
    world_from_camera: Transform,
    srgb: &'static SrgbTables,
    /// x of the ray `(x, y, 1)` through the pixel centres of each column.
    rays_x: Vec<f32>,
}

impl Shading<'_> {
    fn fill(&self, frame: &mut CameraFrame) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            unsafe { self.fill_avx2(frame) };
            return;
        }
        self.fill_inline(frame);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn fill_avx2(&self, frame: &mut CameraFrame) {
        self.fill_inline(frame);
    }

    #[inline(always)]
    fn fill_inline(&self, frame: &mut CameraFrame) {
        let View { width, height, stride, .. } = *self.view;
        for v in 0..height {
            let row = &self.visibility.triangle[v * stride..][..width];
            let ray_y = self.view.ray(1, v);
            let mut start = 0;
            while start < width {
                let value = row[start];
                let run = row[start..].iter().position(|&other| other != value);
                let end = run.map_or(width, |length| start + length);
                if value != 0 {
                    self.fill_run(frame, value, v, start..end, ray_y);
                }
                start = end;
            }
        }
    }

    /// Shades neighbouring pixels of one row that show the same triangle.
    #[inline(always)]
    fn fill_run(
        &self,
        frame: &mut CameraFrame,
        value: u32,
        v: usize,
        columns: Range<usize>,
        ray_y: f32,
    ) {
        let surface = Surface::new(self, value);
        let at = v * self.view.width;
        let pixels = at + columns.start..at + columns.end;
        let rays_x = &self.rays_x[columns];
        let depths = &mut frame.depth_m[pixels.clone()];
        for (depth, &ray_x) in depths.iter_mut().zip(rays_x) {
            *depth = surface.depth(ray_x, ray_y, self.view.far);
        }
        frame.segmentation[pixels.clone()].fill(surface.segment);
        if let Some(normals) = frame.normals.get_mut(pixels.clone()) {
            for ((normal, &depth), &ray_x) in normals.iter_mut().zip(&*depths).zip(rays_x) {
                let weights = surface.weights([ray_x * depth, ray_y * depth, depth]);
                let facing = surface.normal_at(weights, [ray_x, ray_y, 1.0]);
                *normal = self.world_from_camera.rotate(facing);
            }
        }
        let colors = frame.rgb[3 * pixels.start..3 * pixels.end].as_chunks_mut::<3>().0;
        if let Some(light) = surface.flat_light.filter(|_| !surface.is_textured) {
            let [r, g, b, _] = surface.material.base_color;
            colors.fill(self.encode([r, g, b], light));
            return;
        }
        let Some(directions) = &self.lights.directions else {
            return self.fill_lit(colors, &surface, depths, rays_x, ray_y);
        };
        if let (Some(light), Some(texture)) = (surface.flat_light, surface.texture()) {
            let blocks = colors.chunks_mut(LANES).zip(depths.chunks(LANES));
            for ((colors, depths), rays_x) in blocks.zip(rays_x.chunks(LANES)) {
                self.fill_textured(colors, &surface, texture, light, depths, rays_x, ray_y);
            }
            return;
        }
        for ((color, &depth), &ray_x) in colors.iter_mut().zip(&*depths).zip(rays_x) {
            let weights = surface.weights([ray_x * depth, ray_y * depth, depth]);
            let light = surface.flat_light.unwrap_or_else(|| {
                self.lights.on(surface.normal_at(weights, [ray_x, ray_y, 1.0]), directions)
            });
            *color = self.encode(surface.albedo(weights, self.srgb), light);
        }
    }

    /// Colours of up to [`LANES`] textured pixels in the same light: what [`Surface::albedo`] and [`Shading::encode`] compute, in
    /// steps that the compiler turns into vector instructions.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "the parts of a run, which is not worth a type")]
    fn fill_textured(
        &self,
        colors: &mut [[u8; 3]],
        surface: &Surface<'_>,
        texture: &image::RgbaImage,
        light: [f32; 3],
        depths: &[f32],
        rays_x: &[f32],
        ray_y: f32,
    ) {
        let (mut depth, mut ray_x) = ([0.0; LANES], [0.0; LANES]);
        depth[..depths.len()].copy_from_slice(depths);
        ray_x[..rays_x.len()].copy_from_slice(rays_x);
        let uvs = surface.corners.map(|vertex| surface.mesh.uvs[vertex]);
        let size = [texture.width() as i32, texture.height() as i32];
        let (mut low, mut high) = ([[0i32; LANES]; 2], [[0i32; LANES]; 2]);
        let mut fraction = [[0.0f32; LANES]; 2];
        for i in 0..LANES {
            let point = [ray_x[i] * depth[i], ray_y * depth[i], depth[i]];
            let uv = mix(uvs, surface.weights(point));
            for axis in 0..2 {
                let wrapped = uv[axis] - uv[axis].floor();
                // Not a number becomes zero.
                let wrapped = if wrapped >= 0.0 { wrapped } else { 0.0 };
                let place = wrapped * size[axis] as f32 - 0.5;
                let first = place.floor();
                let at = first as i32;
                let at = if at < 0 { size[axis] - 1 } else { at };
                low[axis][i] = if at >= size[axis] { 0 } else { at };
                high[axis][i] = if low[axis][i] + 1 == size[axis] { 0 } else { low[axis][i] + 1 };
                fraction[axis][i] = place - first;
            }
        }
        let texels = texture.as_raw().as_chunks::<4>().0;
        let mut corners = [[[0.0f32; LANES]; 3]; 4];
        for i in 0..colors.len() {
            let rows = [low[1][i], high[1][i]].map(|row| row as usize * size[0] as usize);
            let columns = [low[0][i], high[0][i]].map(|column| column as usize);
            for (corner, at) in [
                rows[0] + columns[0],
                rows[0] + columns[1],
                rows[1] + columns[0],
                rows[1] + columns[1],
            ]
            .into_iter()
            .enumerate()
            {
                let texel = texels[at];
                for channel in 0..3 {
                    corners[corner][channel][i] = self.srgb.decode(texel[channel]);
                }
            }
        }
        for channel in 0..3 {
            let factor = surface.material.base_color[channel];
            let [a, b, c, d] = corners.map(|corner| corner[channel]);
            let mut linear = [0.0f32; LANES];
            for i in 0..LANES {
                let top = a[i] + (b[i] - a[i]) * fraction[0][i];
                let bottom = c[i] + (d[i] - c[i]) * fraction[0][i];
                linear[i] = factor * (top + (bottom - top) * fraction[1][i]) * light[channel];
            }
            for (color, &value) in colors.iter_mut().zip(&linear) {
                color[channel] = self.srgb.encode(value);
            }
        }
    }

    /// Colours where light depends on more than the normal.
    fn fill_lit(
        &self,
        colors: &mut [[u8; 3]],
        surface: &Surface<'_>,
        depths: &[f32],
        rays_x: &[f32],
        ray_y: f32,
    ) {
        for ((color, &depth), &ray_x) in colors.iter_mut().zip(depths).zip(rays_x) {
            let point = [ray_x * depth, ray_y * depth, depth];
            let weights = surface.weights(point);
            let reflector = Reflector {
                albedo: surface.albedo(weights, self.srgb),
                metallic: surface.material.metallic,
                roughness: surface.material.roughness,
            };
            let normal = surface.normal_at(weights, [ray_x, ray_y, 1.0]);
            let linear = self.lights.reflected(&reflector, point, normal);
            *color = linear.map(|c| self.srgb.encode(c));
        }
    }

    #[inline(always)]
    fn encode(&self, albedo: [f32; 3], light: [f32; 3]) -> [u8; 3] {
        std::array::from_fn(|i| self.srgb.encode(albedo[i] * light[i]))
    }
}

/// A triangle ready to be evaluated at pixels.
struct Surface<'a> {
    segment: u16,
    mesh: &'a TriMesh,
    material: &'a Material,
    is_textured: bool,
    /// Vertices in the mesh.
    corners: [usize; 3],
    camera_from_body: &'a Transform,
    /// Plane `normal . p = offset`, camera frame.
    normal: [f64; 3],
    offset: f64,
    nearest: f32,
    farthest: f32,
    /// First corner, camera frame.
    origin: [f32; 3],
    /// `dot(p - origin, gradient[i])` is the weight of corner i + 1 at a point p of the plane.
    gradient: [[f32; 3]; 2],
    /// Unit normal that faces the eye, camera frame, where it is the same on the whole triangle.
    flat_normal: Option<[f32; 3]>,
    /// Light on the whole triangle where it is the same everywhere.
    flat_light: Option<[f32; 3]>,
}

impl<'a> Surface<'a> {
    #[inline(always)]
    fn new(shading: &Shading<'a>, value: u32) -> Self {
        let Shading { view, scene, clusters, visibility, lights, .. } = shading;
        let (drawn, index) = visibility.lookup(value);
        let instance = &clusters.instances[drawn.instance as usize];
        let cluster = &instance.mesh.clusters[drawn.cluster as usize];
        let triangle = instance.mesh.triangles[cluster.triangles.start + index];
        let mesh: &TriMesh = &instance.mesh.mesh;
        let body = &scene.bodies[instance.body];
        let material = &body.materials[instance.part];
        let camera_from_body = &view.camera_from_body[instance.body];
        let corners = mesh.triangles[triangle.source as usize].map(|vertex| vertex as usize);
        let p = triangle.corners.map(|corner| {
            let vertex = drawn.first_vertex as usize + usize::from(corner);
            visibility.position.each_ref().map(|axis| axis[vertex])
        });
        let exact = p.map(|p| p.map(f64::from));
        let (e1, e2) = (subtract(exact[1], exact[0]), subtract(exact[2], exact[0]));
        let normal = cross(e1, e2);
        let square = dot64(normal, normal);
        let inverse_square = if square > 0.0 { 1.0 / square } else { 0.0 };
        let offset = dot64(normal, exact[0]);
        let flat_normal = if mesh.normals.len() == mesh.positions.len() {
            let common = common_normal(mesh, corners);
            common.and_then(|n| facing(normalized(camera_from_body.rotate(n)), p))
        } else {
            let scale = inverse_square.sqrt();
            // The eye is at the origin: a normal that faces it has a negative offset.
            let sign = if offset > 0.0 { -scale } else { scale };
            Some(normal.map(|c| (c * sign) as f32))
        };
        Self {
            segment: body.segment_id,
            is_textured: material.base_color_texture.as_ref().is_some_and(|t| !t.is_empty())
                && mesh.uvs.len() == mesh.positions.len(),
            mesh,
            material,
            corners,
            camera_from_body,
            offset,
            nearest: p[0][2].min(p[1][2]).min(p[2][2]).max(view.near),
            farthest: p[0][2].max(p[1][2]).max(p[2][2]),
            origin: p[0],
            gradient: [cross(e2, normal), cross(normal, e1)]
                .map(|g| g.map(|c| (c * inverse_square) as f32)),
            flat_normal,
            flat_light: lights
                .directions
                .as_ref()
                .and_then(|directions| flat_normal.map(|n| lights.on(n, directions))),
            normal,
        }
    }

    /// Depth (metres) where the ray `(x, y, 1)` meets the triangle.
    #[inline(always)]
    fn depth(&self, ray_x: f32, ray_y: f32, far: f32) -> f32 {
        let ray = [f64::from(ray_x), f64::from(ray_y), 1.0];
        let exact = (self.offset / dot64(self.normal, ray)) as f32;
        // Coverage is decided on the grid, so the ray may just miss the triangle: stay within its depths.
        exact.min(self.farthest).max(self.nearest).min(far)
    }

    /// Weights of the corners at a point of the plane, kept within the triangle.
    #[inline(always)]
    fn weights(&self, point: [f32; 3]) -> [f32; 3] {
        let offset: [f32; 3] = std::array::from_fn(|i| point[i] - self.origin[i]);
        let second = dot(offset, self.gradient[0]).clamp(0.0, 1.0);
        let third = dot(offset, self.gradient[1]).clamp(0.0, 1.0 - second);
        [1.0 - second - third, second, third]
    }

    /// Unit normal that faces the eye, camera frame.
    #[inline(always)]
    fn normal_at(&self, weights: [f32; 3], ray: [f32; 3]) -> [f32; 3] {
        self.flat_normal.unwrap_or_else(|| {
            let normals = self.corners.map(|vertex| self.mesh.normals[vertex]);
            let n = normalized(self.camera_from_body.rotate(mix(normals, weights)));
            if dot(n, ray) > 0.0 { n.map(|c| -c) } else { n }
        })
    }

    fn texture(&self) -> Option<&'a image::RgbaImage> {
        self.material.base_color_texture.as_deref().filter(|_| self.is_textured)
    }

    #[inline(always)]
    fn albedo(&self, weights: [f32; 3], srgb: &SrgbTables) -> [f32; 3] {
        let material = self.material;
        let [r, g, b, _] = material.base_color;
        match &material.base_color_texture {
            Some(texture) if self.is_textured => {
                let uv = mix(self.corners.map(|vertex| self.mesh.uvs[vertex]), weights);
                let texel = bilinear(texture, uv, srgb);
                [r * texel[0], g * texel[1], b * texel[2]]
            }
            _ => [r, g, b],
        }
    }
}

/// The vertex normal that all corners share, body frame.
#[inline(always)]
fn common_normal(mesh: &TriMesh, [a, b, c]: [usize; 3]) -> Option<[f32; 3]> {
    let n = &mesh.normals;
    (n[a] == n[b] && n[a] == n[c]).then_some(n[a])
}

/// The normal, or its opposite, that faces the eye from the whole of a triangle (camera frame); `None` where
/// neither does. What holds at the corners holds in between, since the condition is linear.
#[inline(always)]
fn facing(normal: [f32; 3], corners: [[f32; 3]; 3]) -> Option<[f32; 3]> {
    let away = corners.map(|p| dot(normal, p) > 0.0);
    match away {
        [true, true, true] => Some(normal.map(|c| -c)),
        [false, false, false] => Some(normal),
        _ => None,
    }
}

/// Bilinear sample in linear RGB with repeat wrapping.
#[inline(always)]
fn bilinear(texture: &image::RgbaImage, uv: [f32; 2], srgb: &SrgbTables) -> [f32; 3] {
    let size = [texture.width() as usize, texture.height() as usize];
    let axis = |i: usize| {
        let wrapped = uv[i] - uv[i].floor();
        let place = if wrapped.is_finite() { wrapped * size[i] as f32 - 0.5 } else { 0.0 };
        let first = place.floor();
        // `first` is -1 at least and the size at most.
        let low = if first < 0.0 { size[i] - 1 } else { first as usize };
        let low = if low >= size[i] { 0 } else { low };
        let high = if low + 1 == size[i] { 0 } else { low + 1 };
        ([low, high], place - first)
    };
    let ((x, fraction_x), (y, fraction_y)) = (axis(0), axis(1));
    let texels = texture.as_raw().as_chunks::<4>().0;
    let texel = |x: usize, y: usize| {
        let [r, g, b, _] = texels[y * size[0] + x];
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
