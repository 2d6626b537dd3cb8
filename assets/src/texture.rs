//! Small procedural textures that tile without seams.

use image::{Rgb, RgbImage};

/// Edge length of every texture, pixels.
pub const TEXTURE_SIZE: u32 = 128;

/// A procedural texture in sRGB.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Texture {
    /// Wood grain that runs along v.
    Wood {
        /// Mean colour, sRGB in 0..1.
        tone: [f64; 3],
        /// Seed of the grain.
        seed: u64,
    },
    /// 2 x 2 square tiles with joints.
    Tiles {
        /// Mean colour of the tiles, sRGB in 0..1.
        tone: [f64; 3],
        /// Seed of the tiles' shades.
        seed: u64,
    },
    /// Metal brushed along u.
    Brushed {
        /// Mean colour, sRGB in 0..1.
        tone: [f64; 3],
        /// Seed of the strokes.
        seed: u64,
    },
}

impl Texture {
    /// The image, [`TEXTURE_SIZE`] pixels square.
    pub fn image(&self) -> RgbImage {
        RgbImage::from_fn(TEXTURE_SIZE, TEXTURE_SIZE, |x, y| {
            let unit = |pixel: u32| (f64::from(pixel) + 0.5) / f64::from(TEXTURE_SIZE);
            let (tone, shade) = self.shade(unit(x), unit(y));
            Rgb(tone.map(|c| ((c * shade).clamp(0.0, 1.0) * 255.0).round() as u8))
        })
    }

    /// Mean colour and brightness factor at a texture coordinate in 0..1.
    fn shade(&self, u: f64, v: f64) -> ([f64; 3], f64) {
        match *self {
            Self::Wood { tone, seed } => {
                let bend = periodic_noise(u, v, [3, 2], seed) * 0.12;
                let rings = periodic_noise(u + bend, v, [24, 2], seed ^ 1);
                let fibres = periodic_noise(u, v, [64, 4], seed ^ 2);
                (tone, 0.86 + 0.2 * rings + 0.08 * fibres)
            }
            Self::Tiles { tone, seed } => {
                let (column, row) = ((u * 2.0).floor(), (v * 2.0).floor());
                let (across, down) = (u * 2.0 - column, v * 2.0 - row);
                let to_joint = across.min(1.0 - across).min(down.min(1.0 - down));
                let tile = hash(column as i64, row as i64, seed);
                let speckle = periodic_noise(u, v, [32, 32], seed ^ 3);
                let joint = if to_joint < 0.02 { 0.72 } else { 1.0 };
                (tone, joint * (0.94 + 0.06 * tile + 0.04 * speckle))
            }
            Self::Brushed { tone, seed } => {
                let strokes = periodic_noise(u, v, [4, 64], seed);
                (tone, 0.92 + 0.12 * strokes)
            }
        }
    }
}

/// Value noise in 0..1 with `cells` lattice cells along u and v, periodic in both.
fn periodic_noise(u: f64, v: f64, cells: [i64; 2], seed: u64) -> f64 {
    let (x, y) = (u * cells[0] as f64, v * cells[1] as f64);
    let (column, row) = (x.floor(), y.floor());
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let (across, down) = (smooth(x - column), smooth(y - row));
    let at = |i: i64, j: i64| {
        hash((column as i64 + i).rem_euclid(cells[0]), (row as i64 + j).rem_euclid(cells[1]), seed)
    };
    let mix = |a: f64, b: f64, t: f64| a + (b - a) * t;
    mix(mix(at(0, 0), at(1, 0), across), mix(at(0, 1), at(1, 1), across), down)
}

/// A number in 0..1 for a lattice point: the SplitMix64 finaliser (Steele et al., OOPSLA 2014).
fn hash(i: i64, j: i64, seed: u64) -> f64 {
    let mut bits = (i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15)
        ^ (j as u64).wrapping_mul(0xD1B5_4A32_D192_ED03)
        ^ seed.wrapping_mul(0x94D0_49BB_1331_11EB);
    bits = (bits ^ (bits >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ (bits >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((bits ^ (bits >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    const KINDS: [fn(u64) -> Texture; 3] = [
        |seed| Texture::Wood { tone: [0.6, 0.4, 0.25], seed },
        |seed| Texture::Tiles { tone: [0.7, 0.7, 0.7], seed },
        |seed| Texture::Brushed { tone: [0.6, 0.6, 0.62], seed },
    ];

    #[test]
    fn the_seed_decides_the_image() {
        for kind in KINDS {
            assert_eq!(kind(7).image(), kind(7).image());
            assert_ne!(kind(7).image(), kind(8).image());
        }
    }

    #[test]
    fn noise_tiles_without_a_seam() {
        for step in 0..50 {
            let t = f64::from(step) / 50.0;
            let jump = (periodic_noise(1e-9, t, [8, 4], 3)
                - periodic_noise(1.0 - 1e-9, t, [8, 4], 3))
            .abs();
            assert!(jump < 1e-6, "{jump}");
        }
    }
}
