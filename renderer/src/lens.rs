//! Images of lenses that distort, from images of pinholes.
//!
//! A pinhole camera at the same place, large enough for all that the lens sees, is rendered and
//! resampled: segments are those of the nearest pixel, colours are linear between pixels (in linear light), and
//! depth is that of the surface on the lens' own ray where neighbouring pixels lie on one smooth surface, else that
//! of the nearest pixel.

use akrobat_cameras::{CameraFrame, CameraModel, Intrinsics};

use crate::srgb::SrgbTables;

/// Pixels of the pinhole for each pixel of the lens in its middle.
const OVERSAMPLING: f64 = 1.5;

/// Largest tangent of the angle off the axis that is rendered: 75 degrees. Beyond, images are black and invalid.
const LARGEST_TANGENT: f64 = 3.73;

/// Largest edge of the pinhole's image, pixels.
const LARGEST_EDGE: f64 = 4096.0;

/// Neighbours whose depths deviate from a plane by more than this share are on different surfaces.
const SMOOTH: f32 = 0.01;

/// Where each pixel of a lens is found in a pinhole's image.
#[derive(Debug, Clone)]
pub struct LensMap {
    model: CameraModel,
    pinhole: Intrinsics,
    /// Position in the pinhole's image, pixels; NaN where the lens sees nothing.
    source: Vec<[f32; 2]>,
}

impl LensMap {
    /// The map of a lens; `None` for pinholes, which are rendered as they are.
    pub fn new(model: CameraModel) -> Option<Self> {
        if model.distortion.is_pinhole() {
            return None;
        }
        let i = model.intrinsics;
        let pixels = (0..i.height).flat_map(|v| (0..i.width).map(move |u| (u, v)));
        let rays: Vec<Option<[f64; 2]>> = pixels
            .map(|(u, v)| {
                let ray = model.ray([f64::from(u) + 0.5, f64::from(v) + 0.5])?;
                (ray[0].hypot(ray[1]) <= LARGEST_TANGENT).then_some(ray)
            })
            .collect();
        let (mut low, mut high) = ([-0.01f64; 2], [0.01f64; 2]);
        for ray in rays.iter().flatten() {
            for axis in 0..2 {
                low[axis] = low[axis].min(ray[axis]);
                high[axis] = high[axis].max(ray[axis]);
            }
        }
        let pinhole = enclosing(i, low, high);
        let place = |ray: &Option<[f64; 2]>| {
            ray.map_or([f32::NAN; 2], |[x, y]| {
                [(pinhole.fx * x + pinhole.cx) as f32, (pinhole.fy * y + pinhole.cy) as f32]
            })
        };
        Some(Self { model, pinhole, source: rays.iter().map(place).collect() })
    }

    /// The pinhole to render.
    pub fn pinhole(&self) -> Intrinsics {
        self.pinhole
    }

    /// The lens' images from the pinhole's.
    pub fn resample(&self, image: &CameraFrame) -> CameraFrame {
        let srgb = SrgbTables::get();
        let mut out = CameraFrame::new(&image.name, self.model.intrinsics, image.world_from_camera);
        out.distortion = self.model.distortion;
        out.captured_frame = image.captured_frame;
        let has_normals = !image.normals.is_empty();
        for &source in &self.source {
            if source[0].is_nan() {
                out.rgb.extend([0; 3]);
                out.depth_m.push(0.0);
                out.segmentation.push(0);
                out.normals.extend(has_normals.then_some([0.0; 3]));
                continue;
            }
            let cell = Cell::new(&self.pinhole, source);
            out.rgb.extend(cell.color(&image.rgb, srgb));
            out.depth_m.push(cell.depth(&image.depth_m, &image.segmentation));
            out.segmentation.push(image.segmentation[cell.nearest]);
            out.normals.extend(has_normals.then(|| image.normals[cell.nearest]));
        }
        out
    }

    /// A depth image alone.
    pub fn resample_depth(&self, depth_m: &[f32], segmentation: &[u16]) -> Vec<f32> {
        let depth = |&source: &[f32; 2]| match source[0].is_nan() {
            true => 0.0,
            false => Cell::new(&self.pinhole, source).depth(depth_m, segmentation),
        };
        self.source.iter().map(depth).collect()
    }
}

/// A pinhole that sees all rays between `low` and `high`.
fn enclosing(lens: Intrinsics, low: [f64; 2], high: [f64; 2]) -> Intrinsics {
    let axis = |focal: f64, axis: usize| {
        let span = high[axis] - low[axis];
        // A pixel of margin on either side, for interpolation.
        let focal = (focal * OVERSAMPLING).min((LARGEST_EDGE - 2.0) / span);
        let size = ((span * focal).ceil() as u32 + 2).min(LARGEST_EDGE as u32);
        (size, focal, 1.0 - low[axis] * focal)
    };
    let ((width, fx, cx), (height, fy, cy)) = (axis(lens.fx, 0), axis(lens.fy, 1));
    Intrinsics { width, height, fx, fy, cx, cy }
}

/// The four pixels around a position.
struct Cell {
    /// Top left, top right, bottom left, bottom right.
    pixels: [usize; 4],
    weights: [f32; 4],
    nearest: usize,
}

impl Cell {
    fn new(image: &Intrinsics, [u, v]: [f32; 2]) -> Self {
        let axis = |position: f32, size: u32| {
            let place = (position - 0.5).clamp(0.0, size as f32 - 1.0);
            let low = (place.floor() as u32).min(size.saturating_sub(2));
            (low as usize, ((low + 1).min(size - 1)) as usize, place - low as f32)
        };
        let (left, right, x) = axis(u, image.width);
        let (top, bottom, y) = axis(v, image.height);
        let width = image.width as usize;
        let pixels = [top, bottom].map(|row| [row * width + left, row * width + right]);
        let pixels = [pixels[0][0], pixels[0][1], pixels[1][0], pixels[1][1]];
        let weights = [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y];
        let nearest = pixels[usize::from(x >= 0.5) + 2 * usize::from(y >= 0.5)];
        Self { pixels, weights, nearest }
    }

    fn color(&self, rgb: &[u8], srgb: &SrgbTables) -> [u8; 3] {
        std::array::from_fn(|channel| {
            let levels = self.pixels.iter().zip(self.weights);
            srgb.encode(levels.map(|(&p, w)| srgb.decode(rgb[3 * p + channel]) * w).sum())
        })
    }

    /// Inverse depth is affine in pixel coordinates on every plane.
    fn depth(&self, depth_m: &[f32], segmentation: &[u16]) -> f32 {
        let nearest = depth_m[self.nearest];
        let segment = segmentation[self.nearest];
        let depths = self.pixels.map(|pixel| depth_m[pixel]);
        let one_surface = self.pixels.iter().all(|&pixel| segmentation[pixel] == segment)
            && depths.iter().all(|&depth| depth > 0.0);
        if !one_surface {
            return nearest;
        }
        let [a, b, c, d] = depths.map(|depth| 1.0 / depth);
        if ((a + d) - (b + c)).abs() * nearest > SMOOTH
            || depths.iter().any(|depth| (depth / nearest - 1.0).abs() > 0.1)
        {
            return nearest;
        }
        1.0 / [a, b, c, d]
            .iter()
            .zip(self.weights)
            .map(|(inverse, weight)| inverse * weight)
            .sum::<f32>()
    }
}
