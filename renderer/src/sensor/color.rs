//! Exposure, motion blur, noise and compression of colour images.

use akrobat_cameras::sensor::{ColorSensor, MotionBlur};
use image::codecs::jpeg::{JpegDecoder, JpegEncoder};
use image::{DynamicImage, ExtendedColorType};

use crate::seed::{Normal, Seed};
use crate::srgb::SrgbTables;

/// Times of the images that are averaged, relative to the frame's, seconds.
pub fn blur_offsets_s(blur: &MotionBlur) -> Vec<f64> {
    let samples = f64::from(blur.samples);
    (0..blur.samples).map(|k| blur.exposure_s * ((f64::from(k) + 0.5) / samples - 0.5)).collect()
}

/// The mean of several images in linear light.
///
/// # Panics
/// Without images, or where they differ in size.
pub fn average(images: &[&[u8]]) -> Vec<u8> {
    let srgb = SrgbTables::get();
    let scale = 1.0 / images.len() as f32;
    (0..images[0].len())
        .map(|i| srgb.encode(images.iter().map(|image| srgb.decode(image[i])).sum::<f32>() * scale))
        .collect()
}

/// Factor of the light in one episode.
pub fn exposure_gain(sensor: &ColorSensor, episode: Seed) -> f64 {
    let jitter = Normal::default().next(&mut episode.stream()) * sensor.exposure_jitter_ev;
    (sensor.exposure_ev + jitter).exp2()
}

/// The image that the sensor takes of `rgb`.
pub fn take(
    rgb: &[u8],
    [width, height]: [u32; 2],
    sensor: &ColorSensor,
    gain: f64,
    seed: Seed,
) -> Vec<u8> {
    let srgb = SrgbTables::get();
    let mut image = match sensor.noise {
        Some(noise) => {
            let (mut random, mut normal) = (seed.stream(), Normal::default());
            let full = noise.full_well_electrons;
            let level = |&level: &u8| {
                let electrons = (f64::from(srgb.decode(level)) * gain).min(1.0) * full;
                // A normal number stands for Poisson's, whose variance is its mean.
                let deviation = (electrons + noise.read_electrons.powi(2)).sqrt();
                let counted = electrons + deviation * normal.next(&mut random);
                srgb.encode((counted / full) as f32)
            };
            rgb.iter().map(level).collect()
        }
        None if gain == 1.0 => rgb.to_vec(),
        None => {
            let levels: Vec<u8> =
                (0..=255).map(|level| srgb.encode(srgb.decode(level) * gain as f32)).collect();
            rgb.iter().map(|&level| levels[usize::from(level)]).collect::<Vec<u8>>()
        }
    };
    if let Some(quality) = sensor.jpeg_quality {
        // Encoding to memory can only fail for images larger than rigs allow; then they stay as they are.
        if let Some(decoded) = compressed(&image, width, height, quality) {
            image = decoded;
        }
    }
    image
}

fn compressed(rgb: &[u8], width: u32, height: u32, quality: u8) -> Option<Vec<u8>> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode(rgb, width, height, ExtendedColorType::Rgb8)
        .ok()?;
    let decoder = JpegDecoder::new(std::io::Cursor::new(bytes)).ok()?;
    Some(DynamicImage::from_decoder(decoder).ok()?.into_rgb8().into_raw())
}

#[cfg(test)]
mod tests {
    use super::*;
    use akrobat_cameras::sensor::PixelNoise;

    const SIZE: [u32; 2] = [200, 100];

    fn gray(level: u8) -> Vec<u8> {
        vec![level; 3 * (SIZE[0] * SIZE[1]) as usize]
    }

    fn linear_variance(image: &[u8]) -> (f64, f64) {
        let srgb = SrgbTables::get();
        let values: Vec<f64> = image.iter().map(|&level| f64::from(srgb.decode(level))).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let squares = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
        (mean, squares / values.len() as f64)
    }

    #[test]
    fn the_variance_of_noise_is_affine_in_the_light() {
        let noise = PixelNoise { full_well_electrons: 500.0, read_electrons: 8.0 };
        let sensor = ColorSensor { noise: Some(noise), ..ColorSensor::default() };
        for level in [120u8, 160, 200] {
            let image = take(&gray(level), SIZE, &sensor, 1.0, Seed::new(1));
            let (mean, variance) = linear_variance(&image);
            let light = f64::from(SrgbTables::get().decode(level));
            let expected = (light * 500.0 + 64.0) / (500.0 * 500.0);
            assert!((mean / light - 1.0).abs() < 0.02, "{level}: {mean} instead of {light}");
            assert!((variance / expected - 1.0).abs() < 0.05, "{level}: {variance} {expected}");
        }
        // Control: without shot noise the variance would not depend on the light.
        let [dark, bright] = [120, 200]
            .map(|level| linear_variance(&take(&gray(level), SIZE, &sensor, 1.0, Seed::new(1))).1);
        assert!(bright > 2.0 * dark);
    }

    #[test]
    fn a_stop_doubles_the_light() {
        let sensor = ColorSensor { exposure_ev: 1.0, ..ColorSensor::default() };
        let gain = exposure_gain(&sensor, Seed::new(1));
        let bright = take(&gray(100), SIZE, &sensor, gain, Seed::new(1));
        let (mean, _) = linear_variance(&bright);
        let light = f64::from(SrgbTables::get().decode(100));
        assert!((mean / (2.0 * light) - 1.0).abs() < 0.01);
        let jittered = ColorSensor { exposure_jitter_ev: 0.5, ..ColorSensor::default() };
        let stops: Vec<f64> =
            (0..4000).map(|k| exposure_gain(&jittered, Seed::new(k)).log2()).collect();
        let deviation = (stops.iter().map(|s| s * s).sum::<f64>() / 4000.0).sqrt();
        assert!((deviation - 0.5).abs() < 0.03, "{deviation}");
    }

    #[test]
    fn blur_averages_light_over_the_exposure() {
        let offsets = blur_offsets_s(&MotionBlur { exposure_s: 0.02, samples: 4 });
        let expected = [-0.0075, -0.0025, 0.0025, 0.0075];
        assert!(offsets.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{offsets:?}");
        // Half black, half white: linear 0.5 is level 188.
        assert_eq!(average(&[&[0, 255], &[255, 255]]), [188, 255]);
    }

    #[test]
    fn jpeg_changes_little_and_less_at_higher_quality() {
        let image: Vec<u8> = (0..SIZE[1])
            .flat_map(|v| (0..SIZE[0]).flat_map(move |u| [(u + v) as u8, (2 * u) as u8, 90]))
            .collect();
        let error = |quality| {
            let sensor = ColorSensor { jpeg_quality: Some(quality), ..ColorSensor::default() };
            let taken = take(&image, SIZE, &sensor, 1.0, Seed::new(1));
            let squares = taken.iter().zip(&image).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
            squares.sum::<f64>() / image.len() as f64
        };
        let (fine, coarse) = (error(95), error(20));
        assert!(fine > 0.0 && fine < coarse && coarse < 200.0, "{fine} {coarse}");
    }
}
