//! Colours of textures.

use super::shade::{LANES, Lanes};
use crate::srgb::SrgbTables;

/// Bilinear samples, the first `count` of them, in linear RGB with repeat wrapping.
#[inline(always)]
pub(super) fn sample(
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
