//! Pictures of point clouds: discs under a fixed orthographic view, nearest in front.

use akrobat_cameras::CloudPoint;
use image::RgbaImage;
use nalgebra::{Matrix3, Point3, Vector3};

/// Size of the pictures, pixels.
const WIDTH: u32 = 420;
const HEIGHT: u32 = 315;
/// Radius of a point, pixels.
const RADIUS: f64 = 2.3;
/// Points within this distance of the centre of interest decide what fits into the picture, metres.
const FOCUS_M: f64 = 1.1;
/// Share of these points on either side that does not.
const OUTLIERS: f64 = 0.01;

/// A direction to look from.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// For the caption.
    pub name: &'static str,
    /// Angle about z from the direction out of the object, radians.
    azimuth: f64,
    /// Angle above the horizon, radians.
    elevation: f64,
}

/// The fixed views.
pub const VIEWS: [View; 3] = [
    View { name: "from above", azimuth: 0.0, elevation: std::f64::consts::FRAC_PI_2 },
    View { name: "from the left, 35° up", azimuth: 0.9, elevation: 0.61 },
    View { name: "from the right, 35° up", azimuth: -0.9, elevation: 0.61 },
];

/// Draws a cloud on a transparent ground. `outward_rad` is the heading (about z) of the direction out
/// of the object, from which angles count; `center` is what the picture is about, in the cloud's frame.
pub fn draw(
    cloud: &[CloudPoint],
    view: &View,
    outward_rad: f64,
    center: &Point3<f64>,
) -> RgbaImage {
    let mut picture = RgbaImage::new(WIDTH, HEIGHT);
    let view_from_world = rotation(view, outward_rad);
    let position = |p: &CloudPoint| Vector3::new(p[0], p[1], p[2]).map(f64::from);
    let mut points: Vec<(Vector3<f64>, [u8; 3])> = cloud
        .iter()
        .map(|p| (view_from_world * position(p), [p[3] as u8, p[4] as u8, p[5] as u8]))
        .collect();
    let center = view_from_world * center.coords;
    let in_focus = points.iter().map(|(p, _)| p).filter(|p| (*p - center).norm() <= FOCUS_M);
    let [(left, right), (bottom, top), (back, front)] =
        [0, 1, 2].map(|axis| central_range(in_focus.clone().map(|p| p[axis])));
    let scale = (f64::from(WIDTH) / (right - left).max(0.1))
        .min(f64::from(HEIGHT) / (top - bottom).max(0.1))
        * 0.94;
    points.sort_by(|(a, _), (b, _)| a.z.total_cmp(&b.z));
    for (p, color) in points {
        let u = f64::from(WIDTH) / 2.0 + (p.x - (left + right) / 2.0) * scale;
        let v = f64::from(HEIGHT) / 2.0 - (p.y - (bottom + top) / 2.0) * scale;
        // What is farther away is paler, which gives the picture depth.
        let nearness = ((p.z - back) / (front - back).max(1e-6)).clamp(0.0, 1.0);
        splat(&mut picture, [u, v], color, 0.6 + 0.4 * nearness);
    }
    picture
}

/// Axes of the picture (right, up, towards the viewer) as rows.
fn rotation(view: &View, outward_rad: f64) -> Matrix3<f64> {
    let (sin_a, cos_a) = (outward_rad + view.azimuth).sin_cos();
    let (sin_e, cos_e) = view.elevation.sin_cos();
    let towards = Vector3::new(cos_e * cos_a, cos_e * sin_a, sin_e);
    let right = Vector3::new(-sin_a, cos_a, 0.0);
    let up = towards.cross(&right);
    Matrix3::from_rows(&[right.transpose(), up.transpose(), towards.transpose()])
}

fn central_range(values: impl Iterator<Item = f64>) -> (f64, f64) {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return (0.0, 0.0) };
    let at = |share: f64| sorted[(share * last as f64).round() as usize];
    (at(OUTLIERS), at(1.0 - OUTLIERS))
}

fn splat(picture: &mut RgbaImage, [u, v]: [f64; 2], color: [u8; 3], strength: f64) {
    let reach = RADIUS.ceil() as i64;
    for y in v as i64 - reach..=v as i64 + reach {
        for x in u as i64 - reach..=u as i64 + reach {
            let inside = (0..i64::from(WIDTH)).contains(&x) && (0..i64::from(HEIGHT)).contains(&y);
            let distance = (x as f64 + 0.5 - u).hypot(y as f64 + 0.5 - v);
            if inside && distance <= RADIUS {
                // A darker rim keeps neighbours apart.
                let rim = if distance > RADIUS - 0.9 { 0.82 } else { 1.0 };
                let [r, g, b] = color.map(|c| (f64::from(c) * rim) as u8);
                let alpha = (255.0 * strength) as u8;
                picture.put_pixel(x as u32, y as u32, image::Rgba([r, g, b, alpha]));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where the opaque pixels of a colour lie on average, `[u, v]`.
    fn center(picture: &RgbaImage, is: fn(&image::Rgba<u8>) -> bool) -> [f64; 2] {
        let hits: Vec<(u32, u32)> = picture
            .enumerate_pixels()
            .filter(|(.., p)| p[3] > 0 && is(p))
            .map(|(u, v, _)| (u, v))
            .collect();
        let mean = |of: fn(&(u32, u32)) -> u32| {
            hits.iter().map(|hit| f64::from(of(hit))).sum::<f64>() / hits.len() as f64
        };
        [mean(|hit| hit.0), mean(|hit| hit.1)]
    }

    const RED: CloudPoint = [1.0, 0.0, 0.0, 255.0, 0.0, 0.0];
    const GREEN: CloudPoint = [0.0, 1.0, 0.0, 0.0, 255.0, 0.0];

    #[test]
    fn the_view_from_above_has_the_outward_direction_at_the_bottom() {
        let picture = draw(&[RED, GREEN], &VIEWS[0], 0.0, &Point3::origin());
        let (red, green) = (center(&picture, |p| p[0] > 99), center(&picture, |p| p[1] > 99));
        assert!(red[1] > green[1] + 50.0, "red at {red:?}, green at {green:?}");
        assert!(red[0] < green[0] - 50.0, "red at {red:?}, green at {green:?}");
    }

    #[test]
    fn what_is_nearer_covers_what_is_behind() {
        let below = [0.0, 0.0, 0.0, 0.0, 255.0, 0.0];
        let above = [0.0, 0.0, 1.0, 255.0, 0.0, 0.0];
        for cloud in [[below, above], [above, below]] {
            let picture = draw(&cloud, &VIEWS[0], 0.3, &Point3::origin());
            assert_eq!(picture.get_pixel(WIDTH / 2, HEIGHT / 2).0[..3], [255, 0, 0]);
        }
    }

    #[test]
    fn an_empty_cloud_gives_an_empty_picture() {
        assert!(draw(&[], &VIEWS[1], 0.0, &Point3::origin()).pixels().all(|pixel| pixel[3] == 0));
    }
}
