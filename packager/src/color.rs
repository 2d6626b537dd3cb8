//! Colour images as PNG and JPEG files.

use std::io::Cursor;

use akrobat_cameras::CameraFrame;
use image::{ImageEncoder, ImageFormat, ImageReader, Limits};

use crate::storage::ColorEncoding;

/// Quality of JPEG images.
const JPEG_QUALITY: u8 = 95;

/// Name of an encoding in our files; `None` where colours are plain arrays.
pub(crate) fn file_format(encoding: ColorEncoding) -> Option<&'static str> {
    match encoding {
        ColorEncoding::Native => None,
        ColorEncoding::Png => Some("png"),
        ColorEncoding::Jpeg => Some("jpeg"),
    }
}

/// One camera's colours as an image file. `Native` gives PNG, too.
pub(crate) fn encode(images: &CameraFrame, encoding: ColorEncoding) -> image::ImageResult<Vec<u8>> {
    let (width, height) = (images.intrinsics.width, images.intrinsics.height);
    let rgb8 = image::ExtendedColorType::Rgb8;
    let mut file = Vec::new();
    match encoding {
        ColorEncoding::Native | ColorEncoding::Png => {
            use image::codecs::png::{CompressionType, FilterType, PngEncoder};
            let quality = CompressionType::Default;
            PngEncoder::new_with_quality(&mut file, quality, FilterType::Adaptive).write_image(
                &images.rgb,
                width,
                height,
                rgb8,
            )?;
        }
        ColorEncoding::Jpeg => {
            image::codecs::jpeg::JpegEncoder::new_with_quality(&mut file, JPEG_QUALITY)
                .write_image(&images.rgb, width, height, rgb8)?;
        }
    }
    Ok(file)
}

/// Colours `[height, width, 3]` of a PNG or JPEG file that must be of exactly this size.
///
/// # Errors
/// What is wrong with the file. Nothing larger than the image that is expected is ever held in memory.
pub fn decode(file: &[u8], width: u32, height: u32) -> Result<Vec<u8>, String> {
    let mut reader =
        ImageReader::new(Cursor::new(file)).with_guessed_format().map_err(|e| e.to_string())?;
    if !matches!(reader.format(), Some(ImageFormat::Png | ImageFormat::Jpeg)) {
        return Err("is neither PNG nor JPEG".into());
    }
    let mut limits = Limits::default();
    limits.max_image_width = Some(width);
    limits.max_image_height = Some(height);
    limits.max_alloc = Some(16 * u64::from(width) * u64::from(height) + (1 << 20));
    reader.limits(limits);
    let image = reader.decode().map_err(|e| e.to_string())?;
    let found = (image.width(), image.height());
    if found != (width, height) {
        return Err(format!("is {} x {}, expected {width} x {height}", found.0, found.1));
    }
    match image {
        image::DynamicImage::ImageRgb8(image) => Ok(image.into_raw()),
        other => Err(format!("has colours {:?}, expected RGB of 8 bits", other.color())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use akrobat_cameras::Intrinsics;

    fn gradient(width: u32, height: u32) -> CameraFrame {
        let pixel = |i: u32| [(i % width) as u8 * 3, (i / width) as u8 * 4, 90];
        let intrinsics = Intrinsics::from_focal_length(width, height, 18.0, 20.955);
        let mut images = CameraFrame::new("fixed", intrinsics, akrobat_model::Pose::identity());
        images.rgb = (0..width * height).flat_map(pixel).collect();
        images
    }

    #[test]
    fn png_is_exact_and_jpeg_is_close() {
        let images = gradient(64, 48);
        let png = encode(&images, ColorEncoding::Png).unwrap();
        assert_eq!(decode(&png, 64, 48).unwrap(), images.rgb);
        let jpeg = decode(&encode(&images, ColorEncoding::Jpeg).unwrap(), 64, 48).unwrap();
        let worst = jpeg.iter().zip(&images.rgb).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst < Some(16), "{worst:?}");
        assert_ne!(jpeg, images.rgb);
    }

    #[test]
    fn images_of_another_size_are_refused() {
        let png = encode(&gradient(64, 48), ColorEncoding::Png).unwrap();
        assert!(decode(&png, 32, 24).is_err());
        assert!(decode(&png, 640, 480).unwrap_err().contains("expected 640 x 480"));
        assert!(decode(&png[..png.len() / 2], 64, 48).is_err());
        assert!(decode(b"GIF89a", 64, 48).is_err());
    }
}
