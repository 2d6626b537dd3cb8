//! Pixels as points, tile by tile.

use akrobat_cameras::CameraFrame;
use akrobat_model::Pose;
use akrobat_simd::{LANES, Lanes, Row, xyz};
use nalgebra::{Isometry3, Matrix4, Point3};

use super::leaf::{LEAF, Leaf, ROWS};
use super::{CloudConfig, PixelPoint};

/// Where points are kept.
pub(super) struct Crop {
    low: [f32; 3],
    high: [f32; 3],
    center: [f32; 3],
    square_radius: f32,
}

impl Crop {
    /// With the handle in the cloud's frame.
    pub fn new(config: &CloudConfig, handle: &Point3<f64>) -> Self {
        let region = config.region.map(|region| region.map(|v| v as f32));
        let corner = |first: usize, open: f32| {
            region.map_or([open; 3], |r| [r[first], r[first + 1], r[first + 2]])
        };
        Self {
            low: corner(0, f32::NEG_INFINITY),
            high: corner(3, f32::INFINITY),
            center: std::array::from_fn(|i| handle[i] as f32),
            square_radius: config.radius_m.map_or(f32::INFINITY, |r| (r * r) as f32),
        }
    }

    /// Bit i is set where the point in lane i is dropped.
    #[inline(always)]
    fn drops<L: Lanes>(&self, point: [L; 3]) -> u32 {
        let [x, y, z] = xyz!(i => point[i] - L::splat(self.center[i]));
        let mut dropped = L::splat(self.square_radius).less(x * x + y * y + z * z);
        for axis in 0..3 {
            dropped |= point[axis].less(L::splat(self.low[axis]));
            dropped |= L::splat(self.high[axis]).less(point[axis]);
        }
        dropped
    }
}

/// The points of all cameras' pixels: tiles of [`LANES`] columns and [`ROWS`] rows, which are neighbours in space, along
/// Z-order curves.
pub(super) struct Tiles {
    /// A tile's points, row by row.
    pub leaves: Vec<Leaf>,
    /// For each leaf its camera, and the column and row of its first pixel.
    places: Vec<(usize, u32, u32)>,
}

impl Tiles {
    #[inline(always)]
    pub fn new<L: Lanes>(cameras: &[CameraFrame], frame_from_world: &Pose, crop: &Crop) -> Self {
        let most = cameras.iter().map(|camera| camera.intrinsics.pixels() / LEAF + 1).sum();
        let mut tiles = Self { leaves: Vec::with_capacity(most), places: Vec::with_capacity(most) };
        for (number, camera) in cameras.iter().enumerate() {
            let i = camera.intrinsics;
            let rays = Rays::new(camera, frame_from_world);
            let count = [i.width.div_ceil(LANES as u32), i.height.div_ceil(ROWS as u32)];
            let edge = count[0].max(count[1]).next_power_of_two();
            for code in 0..edge * edge {
                let (x, y) = (every_second_bit(code), every_second_bit(code >> 1));
                if x < count[0] && y < count[1] {
                    let (u, v) = (x * LANES as u32, y * ROWS as u32);
                    if let Some(leaf) = rays.tile::<L>(camera, u, v, crop) {
                        tiles.leaves.push(leaf);
                        tiles.places.push((number, u, v));
                    }
                }
            }
        }
        tiles
    }

    /// The pixel and the point at `leaf * LEAF + lane`.
    pub fn pixel_point(&self, cameras: &[CameraFrame], place: usize) -> PixelPoint {
        let (leaf, lane) = (place / LEAF, place % LEAF);
        let (camera, u, v) = self.places[leaf];
        let (row, column) = (v as usize + lane / LANES, u as usize + lane % LANES);
        let pixel = row * cameras[camera].intrinsics.width as usize + column;
        PixelPoint { camera, pixel, position: self.leaves[leaf].point(lane) }
    }
}

/// The even bits of a number, moved together.
const fn every_second_bit(code: u32) -> u32 {
    let mut bits = code & 0x5555_5555;
    bits = (bits | (bits >> 1)) & 0x3333_3333;
    bits = (bits | (bits >> 2)) & 0x0f0f_0f0f;
    bits = (bits | (bits >> 4)) & 0x00ff_00ff;
    (bits | (bits >> 8)) & 0x0000_ffff
}

/// From pixels and depths to points of the cloud's frame.
struct Rays {
    /// Point of column `u` and row `v` at depth `d`: `origin + d * (forward + right[u] + down[v])`.
    origin: [f32; 3],
    /// Axis by axis, in lanes of columns.
    right: [Vec<Row>; 3],
    /// The forward direction is part of it.
    down: Vec<[f32; 3]>,
    frame_from_camera: Matrix4<f64>,
    frame_from_world: Isometry3<f32>,
}

impl Rays {
    fn new(camera: &CameraFrame, frame_from_world: &Pose) -> Self {
        let i = &camera.intrinsics;
        let matrix = (frame_from_world * camera.world_from_camera).to_homogeneous();
        let column = |axis: usize, scale: f64| {
            std::array::from_fn::<f64, 3, _>(|row| matrix[(row, axis)] * scale)
        };
        let forward = column(2, 1.0);
        let right =
            |u: usize, axis: usize| (matrix[(axis, 0)] * ((u as f64 + 0.5 - i.cx) / i.fx)) as f32;
        let lanes = |axis: usize| {
            let row = |x: usize| Row(std::array::from_fn(|lane| right(x * LANES + lane, axis)));
            (0..(i.width as usize).div_ceil(LANES)).map(row).collect()
        };
        let down = |v: u32| {
            let down = column(1, (f64::from(v) + 0.5 - i.cy) / i.fy);
            std::array::from_fn(|axis| (down[axis] + forward[axis]) as f32)
        };
        Self {
            origin: column(3, 1.0).map(|c| c as f32),
            right: std::array::from_fn(lanes),
            down: (0..i.height).map(down).collect(),
            frame_from_camera: matrix,
            frame_from_world: frame_from_world.cast(),
        }
    }

    /// The points of the tile whose first pixel is in column `u` and row `v`; `None` where it has none.
    #[inline(always)]
    fn tile<L: Lanes>(&self, camera: &CameraFrame, u: u32, v: u32, crop: &Crop) -> Option<Leaf> {
        let i = &camera.intrinsics;
        let (mut points, mut held) = ([[Row::default(); ROWS]; 3], 0);
        for row in 0..ROWS.min((i.height - v) as usize) {
            let v = v as usize + row;
            let start = v * i.width as usize + u as usize;
            let depth_m = depth_row(&camera.depth_m[start..], (i.width - u) as usize);
            let depth = L::load(&depth_m);
            let mut valid = L::splat(0.0).less(depth) & depth.less(L::splat(f32::INFINITY));
            let point = if camera.distortion.is_pinhole() {
                let down = &self.down[v];
                let right = xyz!(i => L::load(&self.right[i][u as usize / LANES]));
                xyz!(i => L::splat(self.origin[i]) + depth * (right[i] + L::splat(down[i])))
            } else {
                let rows = self.distorted(camera, u as usize, v, &depth_m, &mut valid);
                xyz!(i => L::load(&rows[i]))
            };
            held |= (valid & !crop.drops(point)) << (row * LANES);
            for axis in 0..3 {
                point[axis].store(&mut points[axis][row]);
            }
        }
        Leaf::new(points, held)
    }

    /// Points behind a lens, of the lanes in `valid`; lanes for which the model gives no ray are taken out of it.
    #[cold]
    fn distorted(
        &self,
        camera: &CameraFrame,
        u: usize,
        v: usize,
        depth_m: &Row,
        valid: &mut u32,
    ) -> [Row; 3] {
        let mut rows = [Row::default(); 3];
        let width = camera.intrinsics.width as usize;
        for lane in 0..LANES {
            if *valid >> lane & 1 == 0 {
                continue;
            }
            let point = match camera.xyz.get(v * width + u + lane) {
                Some(world) => Some(self.frame_from_world * Point3::from(*world)),
                None => {
                    camera.model().ray([(u + lane) as f64 + 0.5, v as f64 + 0.5]).map(|[x, y]| {
                        let depth_m = f64::from(depth_m.0[lane]);
                        let point = Point3::new(x * depth_m, y * depth_m, depth_m);
                        self.frame_from_camera.transform_point(&point).cast()
                    })
                }
            };
            match point {
                Some(point) => (0..3).for_each(|axis| rows[axis].0[lane] = point[axis]),
                None => *valid &= !(1 << lane),
            }
        }
        rows
    }
}

/// The first `width` depths, as far as a row of lanes goes; 0 beyond.
#[inline(always)]
fn depth_row(depths_m: &[f32], width: usize) -> Row {
    match depths_m.first_chunk::<LANES>() {
        Some(lanes) if width >= LANES => Row(*lanes),
        _ => {
            let mut row = Row::default();
            row.0.iter_mut().zip(depths_m.iter().take(width)).for_each(|(to, from)| *to = *from);
            row
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn z_order_separates_the_bits() {
        let codes = (0..16u32).map(|code| (every_second_bit(code), every_second_bit(code >> 1)));
        let first: Vec<_> = codes.take(6).collect();
        assert_eq!(first, [(0, 0), (1, 0), (0, 1), (1, 1), (2, 0), (3, 0)]);
        assert_eq!(every_second_bit(0x5555_5555), 0xffff);
    }

    #[test]
    fn lanes_beyond_the_image_are_empty() {
        assert_eq!(depth_row(&[1.0; 20], 8).0, [1.0; LANES]);
        assert_eq!(depth_row(&[1.0; 20], 3).0, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(depth_row(&[1.0; 2], 5).0, [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
