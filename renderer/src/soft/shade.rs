//! Computes depth, colour and segment of every pixel from its nearest triangle.
//!
//! Row by row: runs of pixels that show the same triangle first get its depth, normal and albedo, block by block; then the whole
//! row gets its light. Lanes are arrays, which the compiler turns into vector instructions.

use std::ops::Range;

use akrobat_model::{Material, TriMesh};

use super::light::{CameraLights, Reflector};
use super::view::{Transform, View};
use super::visibility::Visibility;
use crate::RenderScene;
use crate::clusters::ClusteredScene;
use crate::srgb::SrgbTables;

/// Pixels that are computed at once.
pub(super) const LANES: usize = 8;

/// A value for each of some neighbouring pixels.
pub(super) type Lanes = [f32; LANES];

/// The images of a view's rows.
pub(super) struct Images<'a> {
    pub rgb: &'a mut [u8],
    pub depth_m: &'a mut [f32],
    pub segmentation: &'a mut [u16],
    /// Empty where they are not wanted.
    pub normals: &'a mut [[f32; 3]],
}

/// What shading reads.
pub(super) struct Shading<'a> {
    pub view: &'a View,
    pub scene: &'a RenderScene,
    pub clusters: &'a ClusteredScene,
    pub visibility: &'a Visibility,
    pub lights: &'a CameraLights<'a>,
    pub world_from_camera: Transform,
    pub srgb: &'static SrgbTables,
}

impl Shading<'_> {
    /// Fills the images. Pixels whose value in [`Visibility::triangle`] is at most `known` keep what the images have.
    pub fn fill(&self, images: &mut Images<'_>, known: Option<u32>) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            unsafe { self.fill_avx2(images, known) };
            return;
        }
        self.fill_inline(images, known);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn fill_avx2(&self, images: &mut Images<'_>, known: Option<u32>) {
        self.fill_inline(images, known);
    }

    #[inline(always)]
    fn fill_inline(&self, images: &mut Images<'_>, known: Option<u32>) {
        let (width, stride) = (self.view.width, self.view.stride);
        let mut row = Row::new(self.view);
        let mut surfaces = Surfaces::new();
        for v in self.view.rows.clone() {
            let place = v - self.view.rows.start;
            let triangles = &self.visibility.triangle[place * stride..][..width];
            let is_new = |value: &u32| known.is_none_or(|known| *value > known);
            let Some(first) = triangles.iter().position(is_new) else { continue };
            let last = triangles.iter().rposition(is_new).unwrap_or(first);
            let columns = first..last + 1;
            row.ray_y = self.view.ray(1, v);
            let mut start = columns.start;
            while start < columns.end {
                let value = triangles[start];
                let run = triangles[start..columns.end].iter().position(|&other| other != value);
                let end = run.map_or(columns.end, |length| start + length);
                if value == 0 {
                    row.depth[start..end].fill(0.0);
                    row.segment[start..end].fill(0);
                } else if is_new(&value) {
                    row.add_run(self, surfaces.get(self, value), start..end);
                }
                start = end;
            }
            self.light(&mut row, columns.clone());
            self.encode(&mut row, columns.clone());
            let at = place * width;
            let pixels = at + columns.start..at + columns.end;
            let triangles = &triangles[columns.clone()];
            if known.is_none() {
                images.depth_m[pixels.clone()].copy_from_slice(&row.depth[columns.clone()]);
                images.segmentation[pixels.clone()].copy_from_slice(&row.segment[columns.clone()]);
            } else {
                let depths =
                    images.depth_m[pixels.clone()].iter_mut().zip(&row.depth[columns.clone()]);
                let segments = images.segmentation[pixels.clone()].iter_mut();
                let segments = segments.zip(&row.segment[columns.clone()]);
                for ((value, depth), segment) in triangles.iter().zip(depths).zip(segments) {
                    if is_new(value) {
                        *depth.0 = *depth.1;
                        *segment.0 = *segment.1;
                    }
                }
            }
            let colors = images.rgb[3 * pixels.start..3 * pixels.end].as_chunks_mut::<3>().0;
            for ((color, value), u) in colors.iter_mut().zip(triangles).zip(columns.clone()) {
                if *value != 0 && is_new(value) {
                    *color = row.rgb.each_ref().map(|channel| channel[u]);
                }
            }
            if let Some(normals) = images.normals.get_mut(pixels) {
                for ((normal, value), u) in normals.iter_mut().zip(triangles).zip(columns) {
                    if *value != 0 && is_new(value) {
                        let n = row.normal.each_ref().map(|axis| axis[u]);
                        *normal = self.world_from_camera.rotate(n);
                    }
                }
            }
        }
    }

    /// Makes the row's normals unit vectors that face the eye, and computes colours (linear RGB).
    #[inline(always)]
    fn light(&self, row: &mut Row, columns: Range<usize>) {
        for start in columns.clone().step_by(LANES) {
            let ray_x: Lanes = block(&row.rays_x, start);
            let mut n = row.normal.each_ref().map(|axis| block(axis, start));
            for i in 0..LANES {
                let square = n[0][i] * n[0][i] + n[1][i] * n[1][i] + n[2][i] * n[2][i];
                let scale = if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 };
                let along = n[0][i] * ray_x[i] + n[1][i] * row.ray_y + n[2][i];
                let scale = if along > 0.0 { -scale } else { scale };
                (0..3).for_each(|axis| n[axis][i] *= scale);
            }
            for axis in 0..3 {
                row.normal[axis][start..start + LANES].copy_from_slice(&n[axis]);
            }
            if let Some(directions) = &self.lights.directions {
                let light = self.lights.on_lanes(n, directions);
                for channel in 0..3 {
                    let albedo: Lanes = block(&row.albedo[channel], start);
                    for i in 0..LANES {
                        row.color[channel][start + i] = albedo[i] * light[channel][i];
                    }
                }
            }
        }
        if self.lights.directions.is_some() {
            return;
        }
        for u in columns.filter(|&u| row.depth[u] > 0.0) {
            let reflector = Reflector {
                albedo: row.albedo.each_ref().map(|channel| channel[u]),
                metallic: row.metallic[u],
                roughness: row.roughness[u],
            };
            let point = [row.rays_x[u], row.ray_y, 1.0].map(|ray| ray * row.depth[u]);
            let normal = row.normal.each_ref().map(|axis| axis[u]);
            let color = self.lights.reflected(&reflector, point, normal);
            (0..3).for_each(|channel| row.color[channel][u] = color[channel]);
        }
    }

    /// Colours as levels.
    #[inline(always)]
    fn encode(&self, row: &mut Row, columns: Range<usize>) {
        for (levels, colors) in row.rgb.iter_mut().zip(&row.color) {
            for start in columns.clone().step_by(LANES) {
                let encoded = self.srgb.encode_lanes(&block(colors, start));
                levels[start..start + LANES].copy_from_slice(&encoded);
            }
        }
    }
}

#[inline(always)]
fn block(values: &[f32], start: usize) -> Lanes {
    std::array::from_fn(|i| values[start + i])
}

/// What is known of a row's pixels. All lists are longer than the row by [`LANES`], so that blocks may reach beyond it: what comes
/// after a run is overwritten by the next.
struct Row {
    /// The ray through a pixel's centre is `(rays_x[u], ray_y, 1)`.
    rays_x: Vec<f32>,
    ray_y: f32,
    depth: Vec<f32>,
    segment: Vec<u16>,
    /// Camera frame.
    normal: [Vec<f32>; 3],
    /// Linear RGB, likewise [`Self::color`].
    albedo: [Vec<f32>; 3],
    metallic: Vec<f32>,
    roughness: Vec<f32>,
    color: [Vec<f32>; 3],
    /// sRGB.
    rgb: [Vec<u8>; 3],
}

impl Row {
    fn new(view: &View) -> Self {
        let lanes = || vec![0.0; view.width + LANES];
        Self {
            rays_x: (0..view.width + LANES).map(|u| view.ray(0, u)).collect(),
            ray_y: 0.0,
            depth: lanes(),
            segment: vec![0; view.width + LANES],
            normal: std::array::from_fn(|_| lanes()),
            albedo: std::array::from_fn(|_| lanes()),
            metallic: lanes(),
            roughness: lanes(),
            color: std::array::from_fn(|_| lanes()),
            rgb: std::array::from_fn(|_| vec![0; view.width + LANES]),
        }
    }

    /// Pixels that show the same surface.
    #[inline(always)]
    fn add_run(&mut self, shading: &Shading<'_>, surface: &Surface<'_>, columns: Range<usize>) {
        self.segment[columns.clone()].fill(surface.segment);
        if shading.lights.directions.is_none() {
            self.metallic[columns.clone()].fill(surface.material.metallic);
            self.roughness[columns.clone()].fill(surface.material.roughness);
        }
        let base = surface.material.base_color;
        for start in columns.clone().step_by(LANES) {
            let lanes = start..start + LANES;
            let ray_x = block(&self.rays_x, start);
            let depth = surface.depth(&ray_x, self.ray_y, shading.view.far);
            self.depth[lanes.clone()].copy_from_slice(&depth);
            if surface.texture.is_none() && surface.is_flat {
                for axis in 0..3 {
                    self.normal[axis][lanes.clone()].fill(surface.normals[0][axis]);
                    self.albedo[axis][lanes.clone()].fill(base[axis]);
                }
                continue;
            }
            let weights = surface.weights(&ray_x, self.ray_y, &depth);
            for axis in 0..3 {
                let values = surface.normals.map(|normal| normal[axis]);
                let normal =
                    if surface.is_flat { [values[0]; LANES] } else { mix(values, &weights) };
                self.normal[axis][lanes.clone()].copy_from_slice(&normal);
            }
            let Some(texture) = surface.texture else {
                for channel in 0..3 {
                    self.albedo[channel][lanes.clone()].fill(base[channel]);
                }
                continue;
            };
            let uv = std::array::from_fn(|axis| mix(surface.uvs.map(|uv| uv[axis]), &weights));
            let count = LANES.min(columns.end - start);
            let texel = sample(texture, uv, count, shading.srgb);
            for channel in 0..3 {
                let albedo = texel[channel].map(|value| base[channel] * value);
                self.albedo[channel][lanes.clone()].copy_from_slice(&albedo);
            }
        }
    }
}

/// Surfaces that were looked up last: neighbouring rows mostly show the same.
struct Surfaces<'a> {
    kept: Vec<(u32, Option<Surface<'a>>)>,
}

impl<'a> Surfaces<'a> {
    /// A power of two.
    const COUNT: u32 = 256;

    fn new() -> Self {
        Self { kept: (0..Self::COUNT).map(|_| (0, None)).collect() }
    }

    #[inline(always)]
    fn get(&mut self, shading: &Shading<'a>, value: u32) -> &Surface<'a> {
        let place = value.wrapping_mul(0x9E37_79B1) >> (u32::BITS - Self::COUNT.ilog2());
        let (kept, surface) = &mut self.kept[place as usize];
        if *kept != value {
            *kept = value;
            *surface = None;
        }
        match surface {
            Some(surface) => surface,
            None => surface.insert(Surface::new(shading, value)),
        }
    }
}

/// A triangle ready to be evaluated at pixels.
struct Surface<'a> {
    segment: u16,
    material: &'a Material,
    /// Where the mesh has texture coordinates.
    texture: Option<&'a image::RgbaImage>,
    /// Plane `normal . p = offset`, camera frame.
    normal: [f64; 3],
    offset: f64,
    nearest: f32,
    farthest: f32,
    /// First corner, camera frame.
    origin: [f32; 3],
    /// `dot(p - origin, gradient[i])` is the weight of corner i + 1 at a point p of the plane.
    gradient: [[f32; 3]; 2],
    /// Whether the normal is the same on the whole triangle.
    is_flat: bool,
    /// Normals of the corners, camera frame, of any length and side.
    normals: [[f32; 3]; 3],
    /// Texture coordinates of the corners.
    uvs: [[f32; 2]; 3],
}

impl<'a> Surface<'a> {
    #[inline(always)]
    fn new(shading: &Shading<'a>, value: u32) -> Self {
        let Shading { view, scene, clusters, visibility, .. } = shading;
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
        let (is_flat, normals) = if mesh.normals.len() == mesh.positions.len() {
            let [a, b, c] = corners.map(|vertex| mesh.normals[vertex]);
            (a == b && a == c, [a, b, c].map(|n| camera_from_body.rotate(n)))
        } else {
            let scale = inverse_square.sqrt();
            (true, [normal.map(|c| (c * scale) as f32); 3])
        };
        let has_uvs = mesh.uvs.len() == mesh.positions.len();
        let texture = material.base_color_texture.as_deref().filter(|t| has_uvs && !t.is_empty());
        Self {
            segment: body.segment_id,
            texture,
            uvs: if texture.is_some() { corners.map(|v| mesh.uvs[v]) } else { [[0.0; 2]; 3] },
            material,
            offset: dot64(normal, exact[0]),
            nearest: p[0][2].min(p[1][2]).min(p[2][2]).max(view.near),
            farthest: p[0][2].max(p[1][2]).max(p[2][2]),
            origin: p[0],
            gradient: [cross(e2, normal), cross(normal, e1)]
                .map(|g| g.map(|c| (c * inverse_square) as f32)),
            is_flat,
            normals,
            normal,
        }
    }

    /// Depth (metres) where the rays `(x, y, 1)` meet the triangle.
    #[inline(always)]
    fn depth(&self, ray_x: &Lanes, ray_y: f32, far: f32) -> Lanes {
        let [nx, ny, nz] = self.normal;
        let ny_y = ny * f64::from(ray_y);
        let mut depth = [0.0; LANES];
        for i in 0..LANES {
            let exact = (self.offset / (nx * f64::from(ray_x[i]) + ny_y + nz)) as f32;
            // Coverage is decided on the grid, so the ray may just miss the triangle: stay within its depths.
            let near = if exact < self.farthest { exact } else { self.farthest };
            let depth_m = if near > self.nearest { near } else { self.nearest };
            depth[i] = if depth_m < far { depth_m } else { far };
        }
        depth
    }

    /// Weights of the corners at points of the plane, kept within the triangle.
    #[inline(always)]
    fn weights(&self, ray_x: &Lanes, ray_y: f32, depth: &Lanes) -> [Lanes; 3] {
        let mut weights = [[0.0; LANES]; 3];
        let [g, h] = self.gradient;
        for i in 0..LANES {
            let x = ray_x[i] * depth[i] - self.origin[0];
            let y = ray_y * depth[i] - self.origin[1];
            let z = depth[i] - self.origin[2];
            let second = within(x * g[0] + y * g[1] + z * g[2], 1.0);
            let third = within(x * h[0] + y * h[1] + z * h[2], 1.0 - second);
            weights[0][i] = 1.0 - second - third;
            weights[1][i] = second;
            weights[2][i] = third;
        }
        weights
    }
}

/// A value kept from 0 to `most`; 0 for what is not a number.
#[inline(always)]
fn within(value: f32, most: f32) -> f32 {
    let value = if value > 0.0 { value } else { 0.0 };
    if value < most { value } else { most }
}

/// Values of three corners, weighted.
#[inline(always)]
fn mix(values: [f32; 3], weights: &[Lanes; 3]) -> Lanes {
    let mut mixed = [0.0; LANES];
    for i in 0..LANES {
        mixed[i] =
            values[0] * weights[0][i] + values[1] * weights[1][i] + values[2] * weights[2][i];
    }
    mixed
}

/// Bilinear samples, the first `count` of them, in linear RGB with repeat wrapping.
#[inline(always)]
fn sample(
    texture: &image::RgbaImage,
    uv: [Lanes; 2],
    count: usize,
    srgb: &SrgbTables,
) -> [Lanes; 3] {
    let size = [texture.width() as i32, texture.height() as i32];
    let (mut low, mut high) = ([[0i32; LANES]; 2], [[0i32; LANES]; 2]);
    let mut fraction = [[0.0f32; LANES]; 2];
    for axis in 0..2 {
        for i in 0..LANES {
            let wrapped = uv[axis][i] - uv[axis][i].floor();
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
    // All texels are asked for before any is used: most wait for memory.
    let texels = texture.as_raw().as_chunks::<4>().0;
    let mut fetched = [[[0u8; 4]; LANES]; 4];
    for i in 0..count {
        let rows = [low[1][i], high[1][i]].map(|row| row as usize * size[0] as usize);
        let columns = [low[0][i], high[0][i]].map(|column| column as usize);
        fetched[0][i] = texels[rows[0] + columns[0]];
        fetched[1][i] = texels[rows[0] + columns[1]];
        fetched[2][i] = texels[rows[1] + columns[0]];
        fetched[3][i] = texels[rows[1] + columns[1]];
    }
    let mut corners = [[[0.0f32; LANES]; 3]; 4];
    for (corner, texels) in corners.iter_mut().zip(&fetched) {
        for (i, texel) in texels.iter().enumerate().take(count) {
            for channel in 0..3 {
                corner[channel][i] = srgb.decode(texel[channel]);
            }
        }
    }
    let mut sampled = [[0.0; LANES]; 3];
    for channel in 0..3 {
        let [a, b, c, d] = corners.map(|corner| corner[channel]);
        for i in 0..LANES {
            let top = a[i] + (b[i] - a[i]) * fraction[0][i];
            let bottom = c[i] + (d[i] - c[i]) * fraction[0][i];
            sampled[channel][i] = top + (bottom - top) * fraction[1][i];
        }
    }
    sampled
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
