//! Small pictures for the page: colour maps, encoding, `data:` addresses.

use akrobat_cameras::{CameraFrame, SegmentLabel};
use base64::Engine;
use image::codecs::jpeg::JpegEncoder;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, RgbImage, RgbaImage};

use crate::Error;

/// Quality of photographs on the page, percent.
const JPEG_QUALITY: u8 = 84;

/// Colours of the depth map from near to far, sRGB, at equal steps.
const DEPTH_STOPS: [[f32; 3]; 6] = [
    [255.0, 236.0, 150.0],
    [250.0, 170.0, 80.0],
    [226.0, 88.0, 88.0],
    [150.0, 50.0, 124.0],
    [74.0, 34.0, 110.0],
    [20.0, 16.0, 52.0],
];
/// Colour of pixels without depth and without segment.
const NOTHING: [u8; 3] = [0, 0, 0];

/// An address that holds the content itself.
pub fn data_uri(media_type: &str, content: &[u8]) -> String {
    format!(
        "data:{media_type};base64,{}",
        base64::engine::general_purpose::STANDARD.encode(content)
    )
}

/// A JPEG as an address.
pub fn jpeg_uri(picture: &RgbImage) -> Result<String, Error> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
        .encode_image(picture)
        .map_err(|error| Error::Failed(format!("cannot encode a JPEG: {error}")))?;
    Ok(data_uri("image/jpeg", &bytes))
}

/// A PNG with transparency as an address.
pub fn png_uri(picture: &RgbaImage) -> Result<String, Error> {
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Best, FilterType::Adaptive)
        .write_image(picture, picture.width(), picture.height(), ExtendedColorType::Rgba8)
        .map_err(|error| Error::Failed(format!("cannot encode a PNG: {error}")))?;
    Ok(data_uri("image/png", &bytes))
}

/// The colour image of a camera.
pub fn color(frame: &CameraFrame) -> RgbImage {
    painted(frame, |pixel| std::array::from_fn(|channel| frame.rgb[3 * pixel + channel]))
}

/// The depth image of a camera, bright where near, by the logarithm of the depth; black where nothing is
/// seen. Both ends of the range must be positive.
pub fn depth(frame: &CameraFrame, [near_m, far_m]: [f32; 2]) -> RgbImage {
    let span = (far_m / near_m).ln().max(1e-6);
    painted(frame, |pixel| match frame.depth_m[pixel] {
        depth_m if depth_m > 0.0 => depth_color((depth_m / near_m).ln() / span),
        _ => NOTHING,
    })
}

/// Colour at a fraction of the way from near to far.
pub fn depth_color(fraction: f32) -> [u8; 3] {
    let steps = (DEPTH_STOPS.len() - 1) as f32;
    let at = fraction.clamp(0.0, 1.0) * steps;
    let before = (at as usize).min(DEPTH_STOPS.len() - 2);
    let mix = at - before as f32;
    std::array::from_fn(|c| {
        let [a, b] = [DEPTH_STOPS[before][c], DEPTH_STOPS[before + 1][c]];
        (a + (b - a) * mix).round() as u8
    })
}

/// The segmentation of a camera, in the colours of [`segment_color`].
pub fn segmentation(frame: &CameraFrame, labels: &[SegmentLabel]) -> RgbImage {
    painted(frame, |pixel| match frame.segmentation[pixel] {
        0 => NOTHING,
        id => segment_color(id, labels),
    })
}

/// Warm colours for the robot, greens for the object, blues for the scene; neighbouring ids differ.
pub fn segment_color(id: u16, labels: &[SegmentLabel]) -> [u8; 3] {
    let group = labels.iter().find(|label| label.id == id).map_or("", |label| label.group.as_str());
    // Multiples of the golden ratio spread any run of ids evenly.
    let spread = |factor: f64| (f64::from(id) * factor).fract();
    let (hue, width) = match group {
        "robot" => (8.0, 44.0),
        "object" => (96.0, 70.0),
        _ => (190.0, 46.0),
    };
    let hue = hue + width * spread(0.618_034);
    let (saturation, value) = match group {
        "robot" | "object" => (0.78, 0.62 + 0.36 * spread(0.754_878)),
        _ => (0.32, 0.42 + 0.45 * spread(0.754_878)),
    };
    from_hsv(hue, saturation, value)
}

/// sRGB from hue (degrees), saturation and value.
fn from_hsv(hue: f64, saturation: f64, value: f64) -> [u8; 3] {
    [5.0, 3.0, 1.0].map(|offset| {
        let k = (offset + hue / 60.0) % 6.0;
        let dip = k.min(4.0 - k).clamp(0.0, 1.0);
        (255.0 * value * (1.0 - saturation * dip)).round() as u8
    })
}

fn painted(frame: &CameraFrame, color_of: impl Fn(usize) -> [u8; 3]) -> RgbImage {
    let (width, height) = (frame.intrinsics.width, frame.intrinsics.height);
    RgbImage::from_fn(width, height, |u, v| image::Rgb(color_of((v * width + u) as usize)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_hold_their_content_in_base64() {
        // RFC 4648, section 10.
        assert_eq!(data_uri("text/plain", b"foobar"), "data:text/plain;base64,Zm9vYmFy");
        assert_eq!(data_uri("text/plain", b"foob"), "data:text/plain;base64,Zm9vYg==");
    }

    #[test]
    fn pictures_survive_their_encoding() {
        let picture = RgbaImage::from_fn(7, 3, |u, v| image::Rgba([u as u8 * 30, v as u8, 9, 255]));
        let uri = png_uri(&picture).unwrap();
        let base64 = uri.strip_prefix("data:image/png;base64,").unwrap();
        let bytes = base64::engine::general_purpose::STANDARD.decode(base64).unwrap();
        assert_eq!(image::load_from_memory(&bytes).unwrap().to_rgba8(), picture);
    }

    #[test]
    fn depth_darkens_with_distance_and_is_clamped() {
        let brightness = |f: f32| depth_color(f).iter().map(|&c| u32::from(c)).sum::<u32>();
        let steps: Vec<u32> = (0..=20).map(|k| brightness(k as f32 / 20.0)).collect();
        assert!(steps.windows(2).all(|pair| pair[0] > pair[1]), "{steps:?}");
        assert_eq!(depth_color(-1.0), depth_color(0.0));
        assert_eq!(depth_color(9.0), depth_color(1.0));
    }

    #[test]
    fn hues_are_those_of_the_color_wheel() {
        assert_eq!(from_hsv(0.0, 1.0, 1.0), [255, 0, 0]);
        assert_eq!(from_hsv(120.0, 1.0, 1.0), [0, 255, 0]);
        assert_eq!(from_hsv(240.0, 0.5, 1.0), [128, 128, 255]);
    }
}
