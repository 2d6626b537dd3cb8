//! Animated GIFs with one palette for all frames.

use std::borrow::Cow;

use color_quant::NeuQuant;
use gif::{DisposalMethod, Encoder, Frame, Repeat};
use image::RgbImage;
use image::imageops::{FilterType, resize};

use crate::Error;

/// Colours of the palette; the last entry of the table stands for "as in the frame before".
const COLORS: usize = 255;
const UNCHANGED: u8 = 255;
/// Largest difference of a channel at which a pixel keeps the colour it has: less flicker, smaller
/// files.
const HOLD: u8 = 2;
/// Pixels that the palette is learned from.
const PALETTE_SAMPLES: usize = 200_000;
/// Widths tried, as fractions of the full one, until the file is small enough.
const SCALES: [f64; 5] = [1.0, 0.85, 0.7, 0.6, 0.5];

/// Encodes frames of equal size as an endless animation, as large as `limit_bytes` allows (the smallest
/// scale is taken even where it does not).
///
/// # Errors
/// [`Error::Failed`] without frames, or with frames larger than a GIF can be.
pub fn encode(frames: &[RgbImage], interval_s: f64, limit_bytes: usize) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    for scale in SCALES {
        let scaled: Vec<RgbImage> = frames.iter().map(|frame| shrink(frame, scale)).collect();
        bytes = encode_at_size(&scaled, interval_s)
            .map_err(|error| Error::Failed(format!("cannot encode a GIF: {error}")))?;
        if bytes.len() <= limit_bytes {
            break;
        }
    }
    match bytes.is_empty() {
        true => Err(Error::Failed("cannot encode a GIF: no frames".into())),
        false => Ok(bytes),
    }
}

fn shrink(frame: &RgbImage, scale: f64) -> RgbImage {
    if scale == 1.0 {
        return frame.clone();
    }
    let side = |pixels: u32| ((f64::from(pixels) * scale).round() as u32).max(1);
    resize(frame, side(frame.width()), side(frame.height()), FilterType::Triangle)
}

fn encode_at_size(frames: &[RgbImage], interval_s: f64) -> Result<Vec<u8>, gif::EncodingError> {
    let mut bytes = Vec::new();
    let Some(first) = frames.first() else { return Ok(bytes) };
    let side = |pixels: u32| u16::try_from(pixels).unwrap_or(u16::MAX);
    let (width, height) = (side(first.width()), side(first.height()));
    let mut palette = Palette::learn(frames);
    let mut encoder = Encoder::new(&mut bytes, width, height, &palette.table())?;
    encoder.set_repeat(Repeat::Infinite)?;
    let mut shown: Vec<u8> = Vec::new();
    for frame in frames {
        let pixels = palette.pixels(frame, &mut shown);
        encoder.write_frame(&Frame {
            width,
            height,
            delay: (interval_s * 100.0).round() as u16,
            dispose: DisposalMethod::Keep,
            transparent: Some(UNCHANGED),
            buffer: Cow::Owned(pixels),
            ..Frame::default()
        })?;
    }
    drop(encoder);
    Ok(bytes)
}

/// The colours of an animation.
struct Palette {
    colors: Vec<[u8; 3]>,
    /// Index of the nearest colour by the six high bits of each channel, once looked up.
    nearest: Vec<Option<u8>>,
}

impl Palette {
    fn learn(frames: &[RgbImage]) -> Self {
        let pixels: usize = frames.iter().map(|frame| frame.pixels().len()).sum();
        // An odd step does not line up with the columns.
        let step = (pixels / PALETTE_SAMPLES).max(1) | 1;
        let samples: Vec<u8> = frames
            .iter()
            .flat_map(RgbImage::pixels)
            .step_by(step)
            .flat_map(|pixel| [pixel[0], pixel[1], pixel[2], 255])
            .collect();
        let colors = NeuQuant::new(1, COLORS, &samples).color_map_rgb();
        let colors = colors.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).take(COLORS).collect();
        Self { colors, nearest: vec![None; 1 << 18] }
    }

    /// The colour table of the file.
    fn table(&self) -> Vec<u8> {
        let mut table: Vec<[u8; 3]> = self.colors.clone();
        table.resize(COLORS + 1, [0; 3]);
        table.concat()
    }

    /// A frame's pixels as indices, given those that are `shown` so far, which it updates.
    fn pixels(&mut self, frame: &RgbImage, shown: &mut Vec<u8>) -> Vec<u8> {
        let first = shown.is_empty();
        shown.resize(frame.pixels().len(), 0);
        let pixels = frame.pixels().zip(shown.iter_mut());
        let mut index_of = |color: [u8; 3], shown: &mut u8| {
            if !first && largest_difference(self.colors[usize::from(*shown)], color) <= HOLD {
                return UNCHANGED;
            }
            let index = self.nearest(color);
            if !first && index == *shown {
                return UNCHANGED;
            }
            *shown = index;
            index
        };
        pixels.map(|(pixel, shown)| index_of(pixel.0, shown)).collect()
    }

    fn nearest(&mut self, color: [u8; 3]) -> u8 {
        let cell = color.iter().fold(0, |cell, &c| cell << 6 | usize::from(c >> 2));
        if let Some(index) = self.nearest[cell] {
            return index;
        }
        let center = color.map(|c| i32::from(c & !3) + 2);
        let distance = |candidate: &[u8; 3]| -> i32 {
            (0..3).map(|i| (i32::from(candidate[i]) - center[i]).pow(2)).sum()
        };
        let ranked = self.colors.iter().zip(0u8..).min_by_key(|(candidate, _)| distance(candidate));
        let index = ranked.map_or(0, |(_, index)| index);
        self.nearest[cell] = Some(index);
        index
    }
}

fn largest_difference(a: [u8; 3], b: [u8; 3]) -> u8 {
    (0..3).map(|i| a[i].abs_diff(b[i])).max().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::AnimationDecoder;
    use image::codecs::gif::GifDecoder;

    fn moving_square(frames: u32) -> Vec<RgbImage> {
        let paint = |at: u32| {
            RgbImage::from_fn(64, 32, |u, v| match (u / 8, v / 8) {
                (column, 1) if column == at % 8 => image::Rgb([230, 40, 30]),
                _ => image::Rgb([(u * 3) as u8, (v * 7) as u8, 90]),
            })
        };
        (0..frames).map(paint).collect()
    }

    fn decode(bytes: &[u8]) -> Vec<image::Frame> {
        let decoder = GifDecoder::new(std::io::Cursor::new(bytes)).unwrap();
        decoder.into_frames().collect_frames().unwrap()
    }

    #[test]
    fn frames_come_back_in_order_time_and_color() {
        let frames = moving_square(6);
        let decoded = decode(&encode(&frames, 0.1, usize::MAX).unwrap());
        assert_eq!(decoded.len(), frames.len());
        for (frame, original) in decoded.iter().zip(&frames) {
            assert_eq!(frame.delay().numer_denom_ms(), (100, 1));
            let worst = frame
                .buffer()
                .pixels()
                .zip(original.pixels())
                .map(|(a, b)| largest_difference([a[0], a[1], a[2]], b.0));
            let mean = worst.map(f64::from).sum::<f64>() / f64::from(64 * 32);
            assert!(mean < 6.0, "mean difference {mean}");
        }
    }

    #[test]
    fn a_limit_makes_the_picture_smaller() {
        let frames = moving_square(6);
        let full = encode(&frames, 0.1, usize::MAX).unwrap();
        let small = encode(&frames, 0.1, full.len() - 1).unwrap();
        assert!(decode(&small)[0].buffer().width() < 64);
    }

    #[test]
    fn no_frames_are_an_error() {
        assert!(encode(&[], 0.1, usize::MAX).is_err());
    }
}
