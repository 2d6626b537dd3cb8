//! How well two renderings of the same frame agree.
//!
//! The definitions, for whoever repeats them elsewhere:
//!
//! - A pixel is **inner** where its 3 x 3 neighbourhood, as far as it lies within the image, carries one
//!   segment id in the *reference* segmentation and is smooth in the reference depth: on each of the four
//!   lines of three pixels through the centre (horizontal, vertical, both diagonals) that lie within the
//!   image, with depths `a, c, b` (`c` in the centre), either nothing is seen in all three or something
//!   in all three, and then `|c^2 (1/a + 1/b - 2/c)| <= 0.01 m`.
//!   Inverse depth is affine in pixel coordinates on every plane, so planes are smooth however steeply they
//!   are seen, while depth steps and sharp edges are not. All other pixels lie on **silhouettes**.
//! - **Depth agreement** is the share, of the inner pixels where either image sees anything, in which both do
//!   and the depths differ by at most the tolerance.
//! - **Inner share** is the share of inner pixels in all compared images together: a single view of a wire
//!   rack may consist of silhouettes, but the mask must not hide most of what is compared.
//! - **Intersection over union** of a segment id is taken over all pixels of the image, silhouettes
//!   included, for each id that covers at least 500 pixels of either image.

use std::collections::BTreeMap;
use std::fmt;

use akrobat_cameras::CameraFrame;

/// Largest deviation from a plane that counts as smooth, metres.
const SMOOTH_M: f64 = 0.01;

/// Largest angle between agreeing normals, radians.
pub const NORMAL_TOLERANCE_RAD: f64 = 0.02;

/// What two renderings must reach to count as the same image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// Largest depth difference of an agreeing pixel, metres.
    pub depth_m: f64,
    /// Least share of inner pixels whose depth agrees.
    pub depth_agreement: f64,
    /// Least inner share, so that the mask cannot hide the differences.
    pub inner_share: f64,
    /// Intersection over union that every large segment must exceed.
    pub segment_iou: f64,
    /// Pixels a segment must cover to be judged.
    pub segment_pixels: usize,
}

impl Default for Tolerance {
    fn default() -> Self {
        Self {
            depth_m: 0.002,
            depth_agreement: 0.99,
            inner_share: 0.85,
            segment_iou: 0.97,
            segment_pixels: 500,
        }
    }
}

/// How one segment id agrees.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentAgreement {
    /// The id.
    pub id: u16,
    /// Pixels in the reference.
    pub reference_pixels: usize,
    /// Pixels in the other image.
    pub other_pixels: usize,
    /// Intersection over union.
    pub iou: f64,
}

/// How two images agree.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Camera name.
    pub camera: String,
    /// Pixels of the image.
    pub pixels: usize,
    /// Pixels away from silhouettes.
    pub inner_pixels: usize,
    /// Inner pixels where either image sees anything.
    pub seen_pixels: usize,
    /// Share of those whose depth agrees; 1 where there are none.
    pub depth_agreement: f64,
    /// 99th percentile of the depth difference where both images see something, metres.
    pub depth_p99_m: f64,
    /// Largest difference of a colour channel on inner pixels where both images agree in segment, levels.
    pub color_p99: u8,
    /// Structural similarity of the colours, 1 for equal images; see [`ssim`].
    pub ssim: f64,
    /// Share of the inner pixels, seen in both images, whose normals are within [`NORMAL_TOLERANCE_RAD`]; 1 where either
    /// image has no normals.
    pub normal_agreement: f64,
    /// Segments of at least the tolerance's pixels in either image.
    pub segments: Vec<SegmentAgreement>,
}

impl Comparison {
    /// Compares `other` with `reference`.
    ///
    /// # Panics
    /// Where the images are not of the same size.
    pub fn new(reference: &CameraFrame, other: &CameraFrame, tolerance: &Tolerance) -> Self {
        assert_eq!(reference.depth_m.len(), other.depth_m.len(), "images of different size");
        let inner = inner_pixels(reference);
        let mut differences = Vec::new();
        let mut color_differences = Vec::new();
        let (mut seen_pixels, mut agreeing) = (0, 0);
        for pixel in (0..inner.len()).filter(|&pixel| inner[pixel]) {
            let (a, b) = (f64::from(reference.depth_m[pixel]), f64::from(other.depth_m[pixel]));
            if a == 0.0 && b == 0.0 {
                continue;
            }
            seen_pixels += 1;
            if a != 0.0 && b != 0.0 {
                differences.push((a - b).abs());
                agreeing += usize::from((a - b).abs() <= tolerance.depth_m);
            }
            if reference.segmentation[pixel] == other.segmentation[pixel] {
                let levels = 3 * pixel..3 * pixel + 3;
                let pairs = reference.rgb[levels.clone()].iter().zip(&other.rgb[levels]);
                color_differences.push(pairs.map(|(x, y)| x.abs_diff(*y)).max().unwrap_or(0));
            }
        }
        differences.sort_by(f64::total_cmp);
        color_differences.sort_unstable();
        Self {
            camera: reference.name.clone(),
            pixels: inner.len(),
            inner_pixels: inner.iter().filter(|&&is_inner| is_inner).count(),
            seen_pixels,
            depth_agreement: share(agreeing, seen_pixels),
            depth_p99_m: percentile_99(&differences).unwrap_or(0.0),
            color_p99: percentile_99(&color_differences).unwrap_or(0),
            ssim: ssim(reference, other),
            normal_agreement: normal_agreement(reference, other, &inner),
            segments: segment_agreements(reference, other, tolerance.segment_pixels),
        }
    }

    /// The first demand of `tolerance` on a single image that is not met, in words.
    pub fn violation(&self, tolerance: &Tolerance) -> Option<String> {
        if self.depth_agreement < tolerance.depth_agreement {
            return Some(format!(
                "{}: depth agrees within {} m in {:.2}% of {} pixels, at least {:.2}% must",
                self.camera,
                tolerance.depth_m,
                100.0 * self.depth_agreement,
                self.seen_pixels,
                100.0 * tolerance.depth_agreement
            ));
        }
        let worst = self.segments.iter().min_by(|a, b| a.iou.total_cmp(&b.iou))?;
        (worst.iou <= tolerance.segment_iou).then(|| {
            format!(
                "{}: segment {} has an intersection over union of {:.4}, which must exceed {}",
                self.camera, worst.id, worst.iou, tolerance.segment_iou
            )
        })
    }
}

/// The first demand of `tolerance` that a set of compared images does not meet, in words.
pub fn violation(comparisons: &[Comparison], tolerance: &Tolerance) -> Option<String> {
    let inner_share = share(
        comparisons.iter().map(|comparison| comparison.inner_pixels).sum(),
        comparisons.iter().map(|comparison| comparison.pixels).sum(),
    );
    if inner_share < tolerance.inner_share {
        return Some(format!(
            "only {:.1}% of the pixels lie away from silhouettes, at least {:.1}% must",
            100.0 * inner_share,
            100.0 * tolerance.inner_share
        ));
    }
    comparisons.iter().find_map(|comparison| comparison.violation(tolerance))
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let worst = self.segments.iter().map(|segment| segment.iou).fold(1.0, f64::min);
        write!(
            f,
            "{}: {:.1}% inner pixels, depth agrees in {:.3}% of {} (99th percentile {:.2e} m), worst \
             IoU of {} segments {worst:.4}, 99th percentile of the colour difference {} levels, SSIM \
             {:.4}, normals agree in {:.3}%",
            self.camera,
            100.0 * share(self.inner_pixels, self.pixels),
            100.0 * self.depth_agreement,
            self.seen_pixels,
            self.depth_p99_m,
            self.segments.len(),
            self.color_p99,
            self.ssim,
            100.0 * self.normal_agreement
        )
    }
}

/// Edge of the windows of [`ssim`], pixels.
const SSIM_WINDOW: usize = 8;

/// Mean structural similarity of the luma (Rec. 601, of the sRGB levels) over windows of 8 x 8 pixels, every fourth in
/// either direction (Wang, Bovik, Sheikh and Simoncelli, *Image Quality Assessment: From Error Visibility to Structural
/// Similarity*, IEEE TIP 2004, with their constants).
pub fn ssim(reference: &CameraFrame, other: &CameraFrame) -> f64 {
    let luma = |frame: &CameraFrame| -> Vec<f64> {
        let pixels = frame.rgb.chunks_exact(3);
        pixels
            .map(|p| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2]))
            .collect()
    };
    let (a, b) = (luma(reference), luma(other));
    let width = reference.intrinsics.width as usize;
    let height = reference.intrinsics.height as usize;
    let (mut sum, mut windows) = (0.0, 0);
    for top in (0..(height + 1).saturating_sub(SSIM_WINDOW)).step_by(4) {
        for left in (0..(width + 1).saturating_sub(SSIM_WINDOW)).step_by(4) {
            sum += window_similarity(&a, &b, width, top * width + left);
            windows += 1;
        }
    }
    if windows == 0 { 1.0 } else { sum / f64::from(windows) }
}

fn window_similarity(a: &[f64], b: &[f64], width: usize, first: usize) -> f64 {
    let count = (SSIM_WINDOW * SSIM_WINDOW) as f64;
    let mut sums = [0.0; 5];
    for row in 0..SSIM_WINDOW {
        for pixel in first + row * width..first + row * width + SSIM_WINDOW {
            let (x, y) = (a[pixel], b[pixel]);
            for (sum, term) in sums.iter_mut().zip([x, y, x * x, y * y, x * y]) {
                *sum += term;
            }
        }
    }
    let [x, y, xx, yy, xy] = sums.map(|sum| sum / count);
    let (c1, c2) = ((0.01f64 * 255.0).powi(2), (0.03f64 * 255.0).powi(2));
    let (variances, covariance) = (xx - x * x + yy - y * y, xy - x * y);
    (2.0 * x * y + c1) * (2.0 * covariance + c2) / ((x * x + y * y + c1) * (variances + c2))
}

fn normal_agreement(reference: &CameraFrame, other: &CameraFrame, inner: &[bool]) -> f64 {
    if reference.normals.is_empty() || other.normals.is_empty() {
        return 1.0;
    }
    let least = NORMAL_TOLERANCE_RAD.cos();
    let (mut both, mut agreeing) = (0, 0);
    for pixel in (0..inner.len()).filter(|&pixel| inner[pixel]) {
        if reference.segmentation[pixel] == 0 || other.segmentation[pixel] == 0 {
            continue;
        }
        let (a, b) = (reference.normals[pixel], other.normals[pixel]);
        let cosine: f64 = (0..3).map(|i| f64::from(a[i]) * f64::from(b[i])).sum();
        both += 1;
        agreeing += usize::from(cosine >= least);
    }
    share(agreeing, both)
}

/// Which pixels lie away from silhouettes; see the module's definition.
pub fn inner_pixels(reference: &CameraFrame) -> Vec<bool> {
    let k = &reference.intrinsics;
    let pixels = (0..k.height).flat_map(|v| (0..k.width).map(move |u| (u, v)));
    pixels.map(|(u, v)| is_inner(reference, u, v)).collect()
}

/// Steps to one end of each line through a pixel; the other end lies opposite.
const LINES: [(i64, i64); 4] = [(1, 0), (0, 1), (1, 1), (1, -1)];

fn is_inner(frame: &CameraFrame, u: u32, v: u32) -> bool {
    let center = (v * frame.intrinsics.width + u) as usize;
    LINES.iter().all(|&(right, down)| {
        let ends = [pixel_at(frame, u, v, (right, down)), pixel_at(frame, u, v, (-right, -down))];
        let id = frame.segmentation[center];
        let one_segment = ends.iter().flatten().all(|&end| frame.segmentation[end] == id);
        let depth = |pixel: usize| f64::from(frame.depth_m[pixel]);
        let smooth = match ends {
            [Some(a), Some(b)] => is_smooth(depth(a), depth(center), depth(b)),
            _ => true,
        };
        one_segment && smooth
    })
}

/// Index of the pixel a step away from `(u, v)`, if it lies within the image.
fn pixel_at(frame: &CameraFrame, u: u32, v: u32, (right, down): (i64, i64)) -> Option<usize> {
    let k = &frame.intrinsics;
    let (u, v) = (i64::from(u) + right, i64::from(v) + down);
    let inside = (0..i64::from(k.width)).contains(&u) && (0..i64::from(k.height)).contains(&v);
    inside.then_some((v * i64::from(k.width) + u) as usize)
}

/// Whether three depths in a row can belong to one surface; 0 is nothing.
fn is_smooth(a: f64, c: f64, b: f64) -> bool {
    let seen = [a, c, b].map(|depth| depth > 0.0);
    match seen {
        [true, true, true] => (c * c * (1.0 / a + 1.0 / b - 2.0 / c)).abs() <= SMOOTH_M,
        [false, false, false] => true,
        _ => false,
    }
}

fn segment_agreements(
    reference: &CameraFrame,
    other: &CameraFrame,
    least_pixels: usize,
) -> Vec<SegmentAgreement> {
    // Pixels in the reference, in the other image, and in both, by id.
    let mut counts: BTreeMap<u16, [usize; 3]> = BTreeMap::new();
    for (&a, &b) in reference.segmentation.iter().zip(&other.segmentation) {
        counts.entry(a).or_default()[0] += 1;
        counts.entry(b).or_default()[1] += 1;
        counts.entry(a).or_default()[2] += usize::from(a == b);
    }
    counts
        .into_iter()
        .filter(|(id, [in_reference, in_other, _])| {
            *id != 0 && (*in_reference).max(*in_other) >= least_pixels
        })
        .map(|(id, [reference_pixels, other_pixels, in_both])| SegmentAgreement {
            id,
            reference_pixels,
            other_pixels,
            iou: share(in_both, reference_pixels + other_pixels - in_both),
        })
        .collect()
}

/// `part / whole`; 1 for an empty whole.
fn share(part: usize, whole: usize) -> f64 {
    if whole == 0 { 1.0 } else { part as f64 / whole as f64 }
}

fn percentile_99<T: Copy>(sorted: &[T]) -> Option<T> {
    sorted.get(sorted.len().checked_sub(1)? * 99 / 100).copied()
}

#[cfg(test)]
mod tests {
    use akrobat_cameras::Intrinsics;
    use akrobat_model::Pose;

    use super::*;

    const WIDTH: u32 = 64;
    const HEIGHT: u32 = 48;

    /// An image whose pixels are given by column and row as depth and segment id.
    fn frame(pixel: impl Fn(u32, u32) -> (f64, u16)) -> CameraFrame {
        let pixels: Vec<_> = (0..HEIGHT)
            .flat_map(|v| (0..WIDTH).map(move |u| (u, v)))
            .map(|(u, v)| pixel(u, v))
            .collect();
        CameraFrame {
            rgb: vec![0; 3 * pixels.len()],
            depth_m: pixels.iter().map(|p| p.0 as f32).collect(),
            segmentation: pixels.iter().map(|p| p.1).collect(),
            ..CameraFrame::new(
                "test",
                Intrinsics::from_horizontal_fov(WIDTH, HEIGHT, 1.0),
                Pose::identity(),
            )
        }
    }

    /// Depth of a floor one metre below a camera that looks ahead, seen down to grazing rays.
    fn floor(v: u32) -> f64 {
        f64::from(WIDTH) / (f64::from(v) + 1.5)
    }

    fn compare(reference: &CameraFrame, other: &CameraFrame) -> Comparison {
        Comparison::new(reference, other, &Tolerance::default())
    }

    #[test]
    fn a_grazing_plane_is_inner_up_to_the_border() {
        assert!(inner_pixels(&frame(|_, v| (floor(v), 1))).iter().all(|&is_inner| is_inner));
    }

    #[test]
    fn depth_steps_and_segment_borders_are_silhouettes() {
        let inner = inner_pixels(&frame(|u, _| (if u < 20 { 1.0 } else { 1.03 }, 1)));
        let row = |u: usize| inner[10 * WIDTH as usize + u];
        assert_eq!([18, 19, 20, 21].map(row), [true, false, false, true]);
        let inner = inner_pixels(&frame(|u, _| (1.0, if u < 20 { 1 } else { 2 })));
        let row = |u: usize| inner[10 * WIDTH as usize + u];
        assert_eq!([18, 19, 20, 21].map(row), [true, false, false, true]);
    }

    #[test]
    fn equal_images_agree() {
        let image = frame(|u, v| (floor(v), if u < 30 { 1 } else { 2 }));
        let comparison = compare(&image, &image);
        assert_eq!(comparison.segments.len(), 2);
        assert_eq!(violation(&[comparison], &Tolerance::default()), None);
    }

    #[test]
    fn each_demand_can_be_violated() {
        let wall = |depth: f64| frame(move |_, _| (depth, 1));
        let violated = |a: &CameraFrame, b: &CameraFrame| {
            violation(&[compare(a, b)], &Tolerance::default()).expect("a violation")
        };
        assert!(violated(&wall(1.0), &wall(1.003)).contains("depth agrees"));
        assert!(violated(&wall(1.0), &frame(|_, _| (0.0, 0))).contains("depth agrees"));
        assert!(violated(&frame(|_, _| (0.0, 0)), &wall(1.0)).contains("depth agrees"));
        let noise = frame(|u, v| (1.0, 1 + ((u + v) % 2) as u16));
        assert!(violated(&noise, &noise).contains("silhouettes"));
        let halves = |at: u32| frame(move |u, _| (1.0, if u < at { 1 } else { 2 }));
        assert!(violated(&halves(32), &halves(34)).contains("intersection over union"));
    }

    #[test]
    fn similarity_sees_structure() {
        let paint = |level: &dyn Fn(u32, u32) -> u8| {
            let mut image = frame(|_, _| (1.0, 1));
            for v in 0..HEIGHT {
                for u in 0..WIDTH {
                    let pixel = 3 * (v * WIDTH + u) as usize;
                    image.rgb[pixel..pixel + 3].fill(level(u, v));
                }
            }
            image
        };
        let stripes = paint(&|u, _| if u % 6 < 3 { 60 } else { 190 });
        let brighter = paint(&|u, _| if u % 6 < 3 { 62 } else { 192 });
        let moved = paint(&|u, _| if (u + 2) % 6 < 3 { 60 } else { 190 });
        assert!((ssim(&stripes, &stripes) - 1.0).abs() < 1e-12);
        assert!(ssim(&stripes, &brighter) > 0.99);
        assert!(ssim(&stripes, &moved) < 0.5);
    }

    #[test]
    fn background_does_not_count_as_agreeing_depth() {
        let patch = |depth: f64| {
            frame(move |u, v| {
                if (10..14).contains(&u) && (10..14).contains(&v) { (depth, 1) } else { (0.0, 0) }
            })
        };
        let comparison = compare(&patch(1.0), &patch(1.1));
        assert_eq!(comparison.depth_agreement, 0.0, "{comparison}");
    }
}
