//! Computes depth, colour and segment of every pixel from its nearest triangle.
//!
//! Row by row: depths follow from what the visibility pass interpolated; runs of pixels that show the same triangle then
//! get its normal and albedo, block by block, and all of them that lie side by side get their light. Lanes are arrays, which
//! the compiler turns into vector instructions.

use std::ops::Range;

use super::light::{CameraLights, Reflector};
use super::surface::{Look, Surface, Surfaces, Varying};
use super::texture;
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
    /// Fills the images. Pixels that show nothing, or whose value in [`Visibility::triangle`] is at most `known`, keep what
    /// the images have.
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
        let known = known.unwrap_or(0);
        let mut row = Row::new(self.view);
        let mut surfaces = Surfaces::new();
        for (place, v) in self.view.rows.clone().enumerate() {
            let triangles = &self.visibility.triangle[place * stride..][..width];
            let inverse_depths = &self.visibility.inverse_depth[place * stride..];
            row.ray_y = self.view.ray(1, v);
            let mut next = 0;
            while let Some(skipped) = triangles[next..].iter().position(|&value| value > known) {
                let start = next + skipped;
                let length = triangles[start..].iter().position(|&value| value <= known);
                let stop = length.map_or(width, |length| start + length);
                row.set_depths(inverse_depths, start..stop, self.view.far);
                next = start;
                while next < stop {
                    let value = triangles[next];
                    let length = triangles[next..stop].iter().position(|&other| other != value);
                    let end = length.map_or(stop, |length| next + length);
                    row.add_run(self, surfaces.get(self, value), next..end);
                    next = end;
                }
                row.finish(self);
                row.copy_to(images, self, start..stop, place * width);
            }
        }
    }
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
    /// Linear RGB.
    albedo: [Vec<f32>; 3],
    metallic: Vec<f32>,
    roughness: Vec<f32>,
    /// sRGB.
    rgb: Vec<[u8; 3]>,
    /// Pixels whose light is yet to be computed.
    unlit: Range<usize>,
}

impl Row {
    fn new(view: &View) -> Self {
        let length = view.width + LANES;
        let lanes = || vec![0.0; length];
        Self {
            rays_x: (0..length).map(|u| view.ray(0, u)).collect(),
            ray_y: 0.0,
            depth: lanes(),
            segment: vec![0; length],
            normal: std::array::from_fn(|_| lanes()),
            albedo: std::array::from_fn(|_| lanes()),
            metallic: lanes(),
            roughness: lanes(),
            rgb: vec![[0; 3]; length],
            unlit: 0..0,
        }
    }

    /// Depths of pixels, from their inverses.
    #[inline(always)]
    fn set_depths(&mut self, inverse_depths: &[f32], columns: Range<usize>, far: f32) {
        for start in columns.step_by(LANES) {
            let mut depth = block(inverse_depths, start);
            for depth in &mut depth {
                let depth_m = 1.0 / *depth;
                *depth = if depth_m < far { depth_m } else { far };
            }
            set_block(&mut self.depth, start, &depth);
        }
    }

    /// Pixels that show the same surface, to the right of all others so far.
    #[inline(always)]
    fn add_run(&mut self, shading: &Shading<'_>, surface: &Surface<'_>, columns: Range<usize>) {
        self.segment[columns.clone()].fill(surface.segment);
        match &surface.look {
            Look::Uniform { rgb, normal } => {
                self.finish(shading);
                self.rgb[columns.clone()].fill(*rgb);
                for (values, &value) in self.normal.iter_mut().zip(normal) {
                    values[columns.clone()].fill(value);
                }
            }
            Look::Varying(varying) => {
                if self.unlit.is_empty() {
                    self.unlit.start = columns.start;
                }
                self.unlit.end = columns.end;
                self.add_varying(shading, varying, columns);
            }
        }
    }

    #[inline(always)]
    fn add_varying(&mut self, shading: &Shading<'_>, varying: &Varying<'_>, columns: Range<usize>) {
        let material = varying.material;
        if shading.lights.directions.is_none() {
            self.metallic[columns.clone()].fill(material.metallic);
            self.roughness[columns.clone()].fill(material.roughness);
        }
        for start in columns.clone().step_by(LANES) {
            let depth = block(&self.depth, start);
            let ray_x = block(&self.rays_x, start);
            let weights = varying.weights(&ray_x, self.ray_y, &depth);
            for (normal, value) in self.normal.iter_mut().zip(varying.normal(&weights)) {
                set_block(normal, start, &value);
            }
            let [red, green, blue, _] = material.base_color.map(|base| [base; LANES]);
            let mut albedo = [red, green, blue];
            if let Some(texture) = varying.texture {
                let count = LANES.min(columns.end - start);
                let texel = texture::sample(texture, varying.uv(&weights), count, shading.srgb);
                for (albedo, texel) in albedo.iter_mut().zip(texel) {
                    (0..LANES).for_each(|i| albedo[i] *= texel[i]);
                }
            }
            for (values, albedo) in self.albedo.iter_mut().zip(&albedo) {
                set_block(values, start, albedo);
            }
        }
    }

    /// Computes the light of pixels that are still without.
    #[inline(always)]
    fn finish(&mut self, shading: &Shading<'_>) {
        let columns = std::mem::take(&mut self.unlit);
        for start in columns.clone().step_by(LANES) {
            let ray_x = block(&self.rays_x, start);
            let normal = self.normal.each_ref().map(|axis| block(axis, start));
            let mut away = [false; LANES];
            for i in 0..LANES {
                let along = normal[0][i] * ray_x[i] + normal[1][i] * self.ray_y + normal[2][i];
                away[i] = along > 0.0;
            }
            let normal = unit_normals(normal, away);
            for (values, value) in self.normal.iter_mut().zip(&normal) {
                set_block(values, start, value);
            }
            let albedo = self.albedo.each_ref().map(|channel| block(channel, start));
            let color = match &shading.lights.directions {
                Some(directions) => shading.lights.diffused(&albedo, &normal, directions),
                None => self.reflected(shading, start..(start + LANES).min(columns.end)),
            };
            let levels = color.map(|channel| shading.srgb.encode_lanes(&channel));
            let rgb = &mut self.rgb[start..start + LANES];
            for (i, rgb) in rgb.iter_mut().enumerate() {
                *rgb = levels.each_ref().map(|channel| channel[i]);
            }
        }
    }

    /// Linear RGB of at most [`LANES`] pixels under lights that need their places.
    #[inline(always)]
    fn reflected(&self, shading: &Shading<'_>, columns: Range<usize>) -> [Lanes; 3] {
        let mut colors = [[0.0; LANES]; 3];
        for (i, u) in columns.enumerate() {
            let reflector = Reflector {
                albedo: self.albedo.each_ref().map(|channel| channel[u]),
                metallic: self.metallic[u],
                roughness: self.roughness[u],
            };
            let point = [self.rays_x[u], self.ray_y, 1.0].map(|ray| ray * self.depth[u]);
            let normal = self.normal.each_ref().map(|axis| axis[u]);
            let color = shading.lights.reflected(&reflector, point, normal);
            (0..3).for_each(|channel| colors[channel][i] = color[channel]);
        }
        colors
    }

    /// Copies pixels to the images, in which the row begins at `first`.
    #[inline(always)]
    fn copy_to(
        &self,
        images: &mut Images<'_>,
        shading: &Shading<'_>,
        columns: Range<usize>,
        first: usize,
    ) {
        let pixels = first + columns.start..first + columns.end;
        images.depth_m[pixels.clone()].copy_from_slice(&self.depth[columns.clone()]);
        images.segmentation[pixels.clone()].copy_from_slice(&self.segment[columns.clone()]);
        images.rgb.as_chunks_mut().0[pixels.clone()].copy_from_slice(&self.rgb[columns.clone()]);
        if let Some(normals) = images.normals.get_mut(pixels) {
            for (normal, u) in normals.iter_mut().zip(columns) {
                let in_camera = self.normal.each_ref().map(|axis| axis[u]);
                *normal = shading.world_from_camera.rotate(in_camera);
            }
        }
    }
}

/// Unit vectors along normals of any length, or against those that point `away` from the eye.
#[inline(always)]
pub(super) fn unit_normals<const N: usize>(
    mut normals: [[f32; N]; 3],
    away: [bool; N],
) -> [[f32; N]; 3] {
    let n = &mut normals;
    for i in 0..N {
        let square = n[0][i] * n[0][i] + n[1][i] * n[1][i] + n[2][i] * n[2][i];
        let scale = if square > 0.0 { 1.0 / square.sqrt() } else { 0.0 };
        let scale = if away[i] { -scale } else { scale };
        n[0][i] *= scale;
        n[1][i] *= scale;
        n[2][i] *= scale;
    }
    normals
}

#[inline(always)]
fn block(values: &[f32], start: usize) -> Lanes {
    let mut lanes = [0.0; LANES];
    lanes.copy_from_slice(&values[start..start + LANES]);
    lanes
}

#[inline(always)]
fn set_block(values: &mut [f32], start: usize, lanes: &Lanes) {
    values[start..start + LANES].copy_from_slice(lanes);
}
