//! One triangle into the visibility buffers.

use super::view::SUBPIXELS;

/// Corners on the fixed-point grid.
pub(super) type GridTriangle = [[i32; 2]; 3];

/// Inverse depth over the image: `a u + b v + c` at pixel `(u, v)`, kept within what the corners have.
#[derive(Debug, Clone, Copy)]
pub(super) struct InverseDepth {
    pub a: f64,
    pub b: f64,
    pub c: f64,
    pub smallest: f32,
    pub largest: f32,
}

/// Where triangles are drawn: inverse depth and triangle id per pixel.
pub(super) struct Target<'a> {
    pub width: i32,
    /// Rows of the image that are drawn: the first, and the one after the last. The buffers begin with the first.
    pub rows: [i32; 2],
    pub stride: usize,
    /// These two are longer than all rows by [`LANES`].
    pub inverse_depth: &'a mut [f32],
    pub triangle: &'a mut [u32],
}

impl Target<'_> {
    /// Where a row starts in the buffers.
    #[inline(always)]
    fn row(&self, y: i32) -> usize {
        (y - self.rows[0]) as usize * self.stride
    }

    /// Pixels `[x0, y0, x1, y1]` (inclusive) whose centres lie in the triangle's bounding box.
    #[inline(always)]
    pub fn pixel_box(&self, corners: &GridTriangle) -> Option<[i32; 4]> {
        let range = |axis: usize, [from, end]: [i32; 2]| {
            let [a, b, c] = [corners[0][axis], corners[1][axis], corners[2][axis]];
            let (first, last) = (first_pixel(a.min(b).min(c)), last_pixel(a.max(b).max(c)));
            (first.max(from), last.min(end - 1))
        };
        let (x0, x1) = range(0, [0, self.width]);
        let (y0, y1) = range(1, self.rows);
        (x0 <= x1 && y0 <= y1).then_some([x0, y0, x1, y1])
    }
}

/// The first pixel whose centre is not before a place on the grid.
#[inline(always)]
pub(super) fn first_pixel(place: i32) -> i32 {
    (place + SUBPIXELS / 2 - 1) >> SUBPIXELS.ilog2()
}

/// The last pixel whose centre is not behind a place on the grid.
#[inline(always)]
pub(super) fn last_pixel(place: i32) -> i32 {
    (place - SUBPIXELS / 2) >> SUBPIXELS.ilog2()
}

/// `step_x u + step_y v + at_origin >= 0` at the pixels on the inner side of an edge.
#[derive(Clone, Copy)]
struct Edge {
    step_x: i64,
    step_y: i64,
    at_origin: i64,
}

impl Edge {
    /// The edge from `p` to `q` of a triangle with positive area (clockwise on the screen, y down).
    /// Points exactly on it belong to it if it is a top edge (horizontal, interior below) or a left edge.
    #[inline(always)]
    fn new(p: [i32; 2], q: [i32; 2]) -> Self {
        let [px, py] = p.map(i64::from);
        let [qx, qy] = q.map(i64::from);
        let (dx, dy) = (qx - px, qy - py);
        let owns_points_on_it = dy < 0 || (dy == 0 && dx > 0);
        let half = i64::from(SUBPIXELS / 2);
        Self {
            step_x: -dy * i64::from(SUBPIXELS),
            step_y: dx * i64::from(SUBPIXELS),
            at_origin: dx * (half - py) - dy * (half - px) - i64::from(!owns_points_on_it),
        }
    }

    #[inline(always)]
    fn at(&self, x: i32, y: i32) -> i64 {
        self.step_x * i64::from(x) + self.step_y * i64::from(y) + self.at_origin
    }

    /// Narrows `[from, to]` to the pixels of row `y` on the inner side.
    #[inline(always)]
    fn narrow(&self, y: i32, inverse_step_x: f64, from: &mut i32, to: &mut i32) {
        let offset = self.step_y * i64::from(y) + self.at_origin;
        if self.step_x == 0 {
            if offset < 0 {
                *to = *from - 1;
            }
            return;
        }
        // The quotient in floating point is right to within one pixel; the integers then decide.
        let crossing = (-(offset as f64) * inverse_step_x).clamp(-1e6, 1e6);
        if self.step_x > 0 {
            let mut first = crossing.ceil() as i32;
            if self.at(first - 1, y) >= 0 {
                first -= 1;
            } else if self.at(first, y) < 0 {
                first += 1;
            }
            *from = (*from).max(first);
        } else {
            let mut last = crossing.floor() as i32;
            if self.at(last + 1, y) >= 0 {
                last += 1;
            } else if self.at(last, y) < 0 {
                last -= 1;
            }
            *to = (*to).min(last);
        }
    }
}

/// Pixels that are tested at once.
pub(super) const LANES: usize = 8;

/// Triangles that span at most this much of the grid along either axis are tested in blocks of [`LANES`] pixels: their edge
/// functions stay below 2^30 wherever the pixel box reaches.
pub(super) const SMALL: [i32; 2] = [32 * SUBPIXELS, 80 * SUBPIXELS];

/// Draws `corners` with `id` at the pixels in `bounds` where it is nearer than what is there. `largest` is the largest inverse
/// depth of its corners, and `depth` is asked for only if something may be drawn.
#[inline(always)]
pub(super) fn draw(
    target: &mut Target<'_>,
    corners: &GridTriangle,
    bounds: [i32; 4],
    id: u32,
    largest: f32,
    depth: impl FnOnce() -> Option<InverseDepth>,
) {
    let span = |axis: usize| {
        let [a, b, c] = corners.map(|corner| corner[axis]);
        a.max(b).max(c) - a.min(b).min(c)
    };
    if span(0) <= SMALL[0] && span(1) <= SMALL[1] {
        return draw_small(target, corners, bounds, id, largest, depth);
    }
    let [p, mut q, mut r] = *corners;
    let area = i64::from(q[0] - p[0]) * i64::from(r[1] - p[1])
        - i64::from(q[1] - p[1]) * i64::from(r[0] - p[0]);
    if area == 0 {
        return;
    }
    if area < 0 {
        std::mem::swap(&mut q, &mut r);
    }
    let edges = [Edge::new(p, q), Edge::new(q, r), Edge::new(r, p)];
    if let Some(depth) = depth() {
        draw_spans(target, &edges, bounds, id, &depth);
    }
}

/// An edge of a small triangle, as [`Edge`], counted from the first pixel of the triangle's pixel box.
#[derive(Clone, Copy)]
struct SmallEdge {
    step_x: i32,
    step_y: i32,
    at_first: i32,
}

impl SmallEdge {
    #[inline(always)]
    fn new(p: [i32; 2], q: [i32; 2], first: [i32; 2]) -> Self {
        let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
        let owns_points_on_it = dy < 0 || (dy == 0 && dx > 0);
        let center = first.map(|pixel| pixel * SUBPIXELS + SUBPIXELS / 2);
        Self {
            step_x: -dy * SUBPIXELS,
            step_y: dx * SUBPIXELS,
            at_first: dx * (center[1] - p[1])
                - dy * (center[0] - p[0])
                - i32::from(!owns_points_on_it),
        }
    }
}

/// [`draw`] for triangles within [`SMALL`].
#[inline(always)]
pub(super) fn draw_small(
    target: &mut Target<'_>,
    corners: &GridTriangle,
    [x0, y0, x1, y1]: [i32; 4],
    id: u32,
    largest: f32,
    depth: impl FnOnce() -> Option<InverseDepth>,
) {
    let [p, mut q, mut r] = *corners;
    let area = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    if area == 0 {
        return;
    }
    if area < 0 {
        std::mem::swap(&mut q, &mut r);
    }
    let edges = [(p, q), (q, r), (r, p)].map(|(p, q)| SmallEdge::new(p, q, [x0, y0]));
    if x0 == x1 {
        draw_column(target, edges, [x0, y0, y1], id, largest, depth);
    } else {
        draw_blocks(target, &edges, [x0, y0, x1, y1], id, largest, depth);
    }
}

#[inline(always)]
fn draw_column(
    target: &mut Target<'_>,
    edges: [SmallEdge; 3],
    [x, y0, y1]: [i32; 3],
    id: u32,
    largest: f32,
    depth: impl FnOnce() -> Option<InverseDepth>,
) {
    let mut ask = Some(depth);
    let mut known = None;
    let mut at = edges.map(|edge| edge.at_first);
    for y in y0..=y1 {
        let place = target.row(y) + x as usize;
        if (at[0] | at[1] | at[2]) >= 0 && target.inverse_depth[place] < largest {
            if let Some(ask) = ask.take() {
                known = ask();
            }
            let Some(depth) = &known else { return };
            let value = at_pixel(depth, row_start(depth, y), x);
            if value > target.inverse_depth[place] {
                target.inverse_depth[place] = value;
                target.triangle[place] = id;
            }
        }
        (0..3).for_each(|e| at[e] += edges[e].step_y);
    }
}

#[inline(always)]
fn draw_blocks(
    target: &mut Target<'_>,
    edges: &[SmallEdge; 3],
    [x0, y0, x1, y1]: [i32; 4],
    id: u32,
    largest: f32,
    depth: impl FnOnce() -> Option<InverseDepth>,
) {
    let mut ask = Some(depth);
    let mut known = None;
    for left in (x0..=x1).step_by(LANES) {
        let lanes = (x1 - left + 1).min(LANES as i32);
        // Lanes beyond the pixel box count as outside.
        let beyond: [i32; LANES] = std::array::from_fn(|i| -i32::from(i as i32 >= lanes));
        let along: [[i32; LANES]; 3] =
            std::array::from_fn(|e| std::array::from_fn(|i| edges[e].step_x * i as i32));
        let mut start = edges.map(|edge| edge.at_first + edge.step_x * (left - x0));
        for y in y0..=y1 {
            let place = target.row(y) + left as usize;
            let inverse_depths = target.inverse_depth[place..].first_chunk_mut::<LANES>();
            let ids = target.triangle[place..].first_chunk_mut::<LANES>();
            // A lane beyond the pixel box leaves what it finds there: another row, or the buffers' surplus.
            let (Some(inverse_depths), Some(ids)) = (inverse_depths, ids) else { return };
            let outside: [i32; LANES] = std::array::from_fn(|i| {
                (start[0] + along[0][i])
                    | (start[1] + along[1][i])
                    | (start[2] + along[2][i])
                    | beyond[i]
                    | -i32::from(inverse_depths[i] >= largest)
            });
            if outside.iter().fold(-1, |all, lane| all & lane) >= 0 {
                if let Some(ask) = ask.take() {
                    known = ask();
                }
                let Some(depth) = &known else { return };
                let row = row_start(depth, y);
                for i in 0..LANES {
                    let value = at_pixel(depth, row, left + i as i32);
                    let nearer = (value > inverse_depths[i]) & (outside[i] >= 0);
                    inverse_depths[i] = if nearer { value } else { inverse_depths[i] };
                    ids[i] = if nearer { id } else { ids[i] };
                }
            }
            (0..3).for_each(|e| start[e] = start[e].wrapping_add(edges[e].step_y));
        }
    }
}

#[inline(always)]
fn draw_spans(
    target: &mut Target<'_>,
    edges: &[Edge; 3],
    [x0, y0, x1, y1]: [i32; 4],
    id: u32,
    depth: &InverseDepth,
) {
    let inverse_steps = edges.map(|edge| 1.0 / edge.step_x as f64);
    for y in y0..=y1 {
        let (mut from, mut to) = (x0, x1);
        for (edge, &inverse_step) in edges.iter().zip(&inverse_steps) {
            edge.narrow(y, inverse_step, &mut from, &mut to);
        }
        if from > to {
            continue;
        }
        let row = target.row(y);
        let span = row + from as usize..row + to as usize + 1;
        let start = row_start(depth, y);
        let pixels = target.inverse_depth[span.clone()].iter_mut().zip(&mut target.triangle[span]);
        for (step, (inverse_depth, triangle)) in pixels.enumerate() {
            let value = at_pixel(depth, start, from + step as i32);
            let nearer = value > *inverse_depth;
            *inverse_depth = if nearer { value } else { *inverse_depth };
            *triangle = if nearer { id } else { *triangle };
        }
    }
}

#[inline(always)]
fn row_start(depth: &InverseDepth, y: i32) -> f32 {
    (depth.b * f64::from(y) + depth.c) as f32
}

#[inline(always)]
fn at_pixel(depth: &InverseDepth, row_start: f32, x: i32) -> f32 {
    let value = row_start + depth.a as f32 * x as f32;
    let value = if value < depth.largest { value } else { depth.largest };
    if value > depth.smallest { value } else { depth.smallest }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};

    /// How often each pixel is covered by triangles drawn ever nearer.
    fn coverage(triangles: &[GridTriangle], width: i32, height: i32) -> Vec<u32> {
        let pixels = (width * height) as usize;
        let mut count = vec![0; pixels];
        for corners in triangles {
            let mut inverse_depth = vec![0.0; pixels + LANES];
            let mut triangle = vec![0; pixels + LANES];
            let mut target = Target {
                width,
                rows: [0, height],
                stride: width as usize,
                inverse_depth: &mut inverse_depth,
                triangle: &mut triangle,
            };
            let flat = InverseDepth { a: 0.0, b: 0.0, c: 1.0, smallest: 1.0, largest: 1.0 };
            if let Some(bounds) = target.pixel_box(corners) {
                draw(&mut target, corners, bounds, 1, 1.0, || Some(flat));
            }
            triangle.iter().zip(&mut count).for_each(|(&id, count)| *count += id);
        }
        count
    }

    /// A grid of jittered points, so that cells are convex, split along alternating diagonals.
    fn jittered_sheet(cells: i32, cell: i32, seed: u64) -> Vec<GridTriangle> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut points = Vec::new();
        for row in 0..=cells {
            for column in 0..=cells {
                let mut jitter = |at: i32| {
                    let inner = at > 0 && at < cells;
                    at * cell + if inner { random.random_range(-cell / 4..=cell / 4) } else { 0 }
                };
                let (x, y) = (jitter(column), jitter(row));
                points.push([x, y]);
            }
        }
        let at = |row: i32, column: i32| points[(row * (cells + 1) + column) as usize];
        let mut triangles = Vec::new();
        for row in 0..cells {
            for column in 0..cells {
                let [a, b] = [at(row, column), at(row, column + 1)];
                let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
                if (row + column) % 2 == 0 {
                    triangles.extend([[a, b, c], [b, c, d]]);
                } else {
                    triangles.extend([[a, d, b], [d, c, a]]);
                }
            }
        }
        triangles
    }

    #[test]
    fn neighbours_share_every_pixel_exactly_once() {
        // Cells from a fifth of a pixel to 23 pixels; multiples of 128 put corners on pixel centres.
        for (cells, cell) in [(300, 50), (100, 128), (40, 384), (12, 1280), (4, 6000)] {
            let pixels = cells * cell / SUBPIXELS;
            let sheet = jittered_sheet(cells, cell, 7);
            let count = coverage(&sheet, pixels, pixels);
            assert!(count.iter().all(|&n| n == 1), "cells of {cell}");
            let torn = coverage(&sheet[1..], pixels, pixels);
            assert!(cell < SUBPIXELS || torn.contains(&0), "a missing triangle must show");
        }
    }

    #[test]
    fn spans_and_blocks_agree() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        for _ in 0..500 {
            let base: [i32; 2] = std::array::from_fn(|_| random.random_range(-4000..14000));
            let corners: GridTriangle =
                std::array::from_fn(|_| base.map(|b| b + random.random_range(0..=SMALL[0])));
            let [p, mut q, mut r] = corners;
            let area = i64::from(q[0] - p[0]) * i64::from(r[1] - p[1])
                - i64::from(q[1] - p[1]) * i64::from(r[0] - p[0]);
            if area < 0 {
                std::mem::swap(&mut q, &mut r);
            }
            let edges = [Edge::new(p, q), Edge::new(q, r), Edge::new(r, p)];
            let depth = InverseDepth { a: 0.01, b: 0.02, c: 0.5, smallest: 0.1, largest: 2.0 };
            let images = [true, false].map(|few| {
                let (mut inverse_depth, mut triangle) =
                    (vec![0.0; 4096 + LANES], vec![0; 4096 + LANES]);
                let mut target = Target {
                    width: 64,
                    rows: [0, 64],
                    stride: 64,
                    inverse_depth: &mut inverse_depth,
                    triangle: &mut triangle,
                };
                let Some(bounds) = target.pixel_box(&corners) else { return Default::default() };
                if area == 0 {
                    return Default::default();
                }
                if few {
                    draw_small(&mut target, &corners, bounds, 1, 2.0, || Some(depth));
                } else {
                    draw_spans(&mut target, &edges, bounds, 1, &depth);
                }
                (inverse_depth, triangle)
            });
            assert_eq!(images[0], images[1]);
        }
    }
}
