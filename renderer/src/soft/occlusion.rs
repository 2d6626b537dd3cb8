//! Skips clusters that lie wholly behind what has been drawn.

use super::view::View;

/// Edge of a tile, pixels.
pub(super) const TILE: usize = 8;

/// The farthest visible point of every tile, brought up to date when it is asked for.
#[derive(Debug, Clone, Default)]
pub(super) struct TileDepths {
    columns: usize,
    /// The image's row at which the tiles begin.
    top: usize,
    /// Smallest inverse depth per tile; too small is safe.
    smallest: Vec<f32>,
    stale: Vec<bool>,
}

impl TileDepths {
    pub fn reset(&mut self, view: &View) {
        self.columns = view.stride / TILE;
        self.top = view.rows.start;
        let tiles = self.columns * view.rows.len().div_ceil(TILE);
        self.smallest.clear();
        self.smallest.resize(tiles, 0.0);
        self.stale.clear();
        self.stale.resize(tiles, false);
    }

    /// Columns and rows of the tiles that a box reaches.
    #[inline(always)]
    fn tiles(&self, [x0, y0, x1, y1]: [usize; 4]) -> [usize; 4] {
        [x0, y0 - self.top, x1, y1 - self.top].map(|v| v / TILE)
    }

    /// Notes that pixels of a box may have come nearer.
    #[inline(always)]
    pub fn touch(&mut self, pixel_box: [usize; 4]) {
        let [x0, y0, x1, y1] = self.tiles(pixel_box);
        for row in y0..=y1 {
            self.stale[row * self.columns + x0..=row * self.columns + x1].fill(true);
        }
    }

    /// True where everything in the box is nearer than inverse depth `nearest` (or as near).
    #[inline(always)]
    pub fn hides(
        &mut self,
        pixel_box: [usize; 4],
        nearest: f32,
        inverse_depth: &[f32],
        view: &View,
    ) -> bool {
        let [x0, y0, x1, y1] = self.tiles(pixel_box);
        for row in y0..=y1 {
            for column in x0..=x1 {
                let tile = row * self.columns + column;
                if self.smallest[tile] >= nearest {
                    continue;
                }
                if !std::mem::take(&mut self.stale[tile]) {
                    return false;
                }
                self.smallest[tile] = smallest_in_tile(inverse_depth, view, column, row);
                if self.smallest[tile] < nearest {
                    return false;
                }
            }
        }
        true
    }
}

#[inline(always)]
fn smallest_in_tile(inverse_depth: &[f32], view: &View, column: usize, row: usize) -> f32 {
    let mut lanes = [f32::INFINITY; TILE];
    for y in row * TILE..((row + 1) * TILE).min(view.rows.len()) {
        let start = y * view.stride + column * TILE;
        for (lane, &value) in lanes.iter_mut().zip(&inverse_depth[start..start + TILE]) {
            *lane = if value < *lane { value } else { *lane };
        }
    }
    lanes.into_iter().fold(f32::INFINITY, f32::min)
}
