//! Cuts off what lies before the near plane or too far beside the image for the fixed-point grid
//! (Sutherland and Hodgman, *Reentrant Polygon Clipping*, CACM 1974).

use super::raster::GridTriangle;
use super::view::{GUARD, SUBPIXELS, View};

/// A corner: its camera-frame position, and its place on the grid where that is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corner {
    pub position: [f64; 3],
    pub grid: Option<[i32; 2]>,
}

/// Half-spaces `n . p >= offset` of the camera frame that together are safe to project.
fn half_spaces(view: &View) -> [([f64; 3], f64); 5] {
    let guard = f64::from(GUARD) / f64::from(SUBPIXELS);
    let ([fx, fy], [cx, cy]) = (view.focal, view.center);
    [
        ([0.0, 0.0, 1.0], f64::from(view.near)),
        ([fx, 0.0, guard + cx], 0.0),
        ([-fx, 0.0, guard - cx], 0.0),
        ([0.0, fy, guard + cy], 0.0),
        ([0.0, -fy, guard - cy], 0.0),
    ]
}

/// Calls `draw` with triangles that make up the part of a triangle that can be projected.
///
/// Two triangles with a common edge cut it at the same points: a cut is computed from the end that is kept
/// to the one that is not, whichever triangle asks.
pub(super) fn clip(view: &View, corners: [Corner; 3], mut draw: impl FnMut(&GridTriangle)) {
    let mut polygon = corners.to_vec();
    for (normal, offset) in half_spaces(view) {
        let height = |corner: &Corner| {
            let p = corner.position;
            normal[0] * p[0] + normal[1] * p[1] + normal[2] * p[2] - offset
        };
        let mut kept = Vec::with_capacity(polygon.len() + 1);
        for (index, corner) in polygon.iter().enumerate() {
            let next = &polygon[(index + 1) % polygon.len()];
            let (here, there) = (height(corner), height(next));
            if here >= 0.0 {
                kept.push(*corner);
            }
            if (here >= 0.0) != (there >= 0.0) {
                kept.push(if here >= 0.0 {
                    cut(corner, here, next, there)
                } else {
                    cut(next, there, corner, here)
                });
            }
        }
        polygon = kept;
    }
    let grid: Vec<[i32; 2]> =
        polygon.iter().map(|corner| corner.grid.unwrap_or_else(|| snap(view, corner))).collect();
    for pair in grid.windows(2).skip(1) {
        draw(&[grid[0], pair[0], pair[1]]);
    }
}

/// Where the plane cuts the edge from the corner kept (`height >= 0`) to the corner lost.
fn cut(kept: &Corner, kept_height: f64, lost: &Corner, lost_height: f64) -> Corner {
    let fraction = kept_height / (kept_height - lost_height);
    let position = std::array::from_fn(|i| {
        kept.position[i] + fraction * (lost.position[i] - kept.position[i])
    });
    Corner { position, grid: None }
}

fn snap(view: &View, corner: &Corner) -> [i32; 2] {
    let [x, y, z] = corner.position;
    let depth = z.max(f64::from(view.near));
    let snap = |v: f64, axis: usize| {
        ((view.focal[axis] * v / depth + view.center[axis]) * f64::from(SUBPIXELS)).round() as i32
    };
    [snap(x, 0), snap(y, 1)]
}
