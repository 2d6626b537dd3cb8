//! What spheres must stay clear of, eight places at a time: primitives, distance fields, a floor.

use nalgebra::{Matrix3, Vector3};

use crate::esdf::Esdf;
use crate::kinematics::Frame;
use akrobat_simd::{LANES, Lanes, Row, xyz};

/// A solid with its own frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Solid {
    /// Half edges along x, y, z, metres.
    Box {
        /// Half edges, metres.
        half: [f64; 3],
    },
    /// Flat ends, axis along z.
    Cylinder {
        /// Radius, metres.
        radius: f64,
        /// Half the length, metres.
        half_length: f64,
    },
    /// Round ends, axis along z; a sphere where `half_length` is zero.
    Capsule {
        /// Radius, metres.
        radius: f64,
        /// Half the distance between the centres of the ends, metres.
        half_length: f64,
    },
}

/// A solid in the world, in single precision.
#[derive(Debug, Clone, Copy)]
struct Placed {
    solid: Kind,
    /// Rows of the rotation from world to solid.
    rotation: [[f32; 3]; 3],
    center: [f32; 3],
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Box([f32; 3]),
    Cylinder([f32; 2]),
    Capsule([f32; 2]),
}

/// A distance field and where it stands.
#[derive(Debug, Clone)]
struct Field<'a> {
    grid: &'a Esdf,
    /// Rows of the rotation from world to field.
    rotation: [[f32; 3]; 3],
    /// World origin in the field's frame.
    translation: [f32; 3],
}

/// Everything that spheres must stay clear of.
#[derive(Debug, Clone, Default)]
pub struct Obstacles<'a> {
    solids: Vec<Placed>,
    fields: Vec<Field<'a>>,
    floor_z: Option<f32>,
}

/// Most solids that one bit mask tells apart; more share the last bit.
const MASK_BITS: usize = 64;

/// Which solids and fields may be touched by what is inside a bounding sphere.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Near {
    solids: u64,
    fields: u32,
}

impl Near {
    #[inline(always)]
    pub(crate) fn is_empty(self) -> bool {
        self.solids == 0 && self.fields == 0
    }
}

/// Eight points, by coordinate.
pub(crate) type Points<L> = [L; 3];

fn rows_of(rotation: &Matrix3<f64>) -> [[f32; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| rotation[(i, j)] as f32))
}

fn single(v: &Vector3<f64>) -> [f32; 3] {
    [v.x as f32, v.y as f32, v.z as f32]
}

impl<'a> Obstacles<'a> {
    /// Nothing.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a solid.
    pub fn add_solid(&mut self, world_from_solid: &Frame, solid: Solid) {
        let kind = match solid {
            Solid::Box { half } => Kind::Box(half.map(|h| h as f32)),
            Solid::Cylinder { radius, half_length } => {
                Kind::Cylinder([radius as f32, half_length as f32])
            }
            Solid::Capsule { radius, half_length } => {
                Kind::Capsule([radius as f32, half_length as f32])
            }
        };
        self.solids.push(Placed {
            solid: kind,
            rotation: rows_of(&world_from_solid.rotation.transpose()),
            center: single(&world_from_solid.translation),
        });
    }

    /// Adds a distance field.
    pub fn add_field(&mut self, world_from_field: &Frame, grid: &'a Esdf) {
        let rotation = world_from_field.rotation.transpose();
        self.fields.push(Field {
            grid,
            rotation: rows_of(&rotation),
            translation: single(&(-rotation * world_from_field.translation)),
        });
    }

    /// Sets a floor below which nothing may be but what moves with the base alone.
    pub fn set_floor(&mut self, z_m: f64) {
        self.floor_z = Some(z_m as f32);
    }

    /// Solids and fields that a sphere may touch in any lane.
    #[inline(always)]
    pub(crate) fn near<L: Lanes>(&self, centers: &Points<L>, radius: f32) -> Near {
        let mut near = Near { solids: 0, fields: 0 };
        for (index, solid) in self.solids.iter().enumerate() {
            if solid.touches(centers, radius) != 0 {
                near.solids |= 1 << index.min(MASK_BITS - 1);
            }
        }
        for (index, field) in self.fields.iter().enumerate() {
            if field.may_touch(centers, radius) {
                near.fields |= 1 << index;
            }
        }
        near
    }

    /// Those of `near` that a sphere may touch in any lane.
    #[inline(always)]
    pub(crate) fn nearer<L: Lanes>(&self, near: Near, centers: &Points<L>, radius: f32) -> Near {
        let mut out = Near { solids: 0, fields: 0 };
        let mut solids = near.solids;
        while solids != 0 {
            let bit = solids & solids.wrapping_neg();
            solids ^= bit;
            if self.touched(Near { solids: bit, fields: 0 }, centers, radius) != 0 {
                out.solids |= bit;
            }
        }
        for (index, field) in self.fields.iter().enumerate() {
            if near.fields & 1 << index != 0 && field.may_touch(centers, radius) {
                out.fields |= 1 << index;
            }
        }
        out
    }

    /// Lanes in which a sphere is closer than its radius to one of `near`.
    #[inline(always)]
    pub(crate) fn touched<L: Lanes>(&self, near: Near, centers: &Points<L>, radius: f32) -> u32 {
        let mut hits = 0;
        let mut solids = near.solids;
        while solids != 0 {
            let first = solids.trailing_zeros() as usize;
            solids &= solids - 1;
            let last = if first == MASK_BITS - 1 { self.solids.len() } else { first + 1 };
            for solid in &self.solids[first..last] {
                hits |= solid.touches(centers, radius);
            }
        }
        for (index, field) in self.fields.iter().enumerate() {
            if near.fields & 1 << index != 0 {
                hits |= field.touched(centers, radius);
            }
        }
        hits
    }

    /// Lanes in which a sphere reaches below the floor.
    #[inline(always)]
    pub(crate) fn below_floor<L: Lanes>(&self, z: L, radius: f32) -> u32 {
        self.floor_z.map_or(0, |floor| z.less(L::splat(floor + radius)))
    }
}

impl Placed {
    /// Lanes in which a sphere overlaps the solid.
    #[inline(always)]
    fn touches<L: Lanes>(&self, centers: &Points<L>, radius: f32) -> u32 {
        let d: Points<L> = xyz!(i => centers[i] - L::splat(self.center[i]));
        let [x, y, z] = xyz!(i => dot(&self.rotation[i], &d));
        match self.solid {
            Kind::Box([hx, hy, hz]) => {
                let (x, y, z) = (beyond(x, hx), beyond(y, hy), beyond(z, hz));
                (x * x + y * y + z * z).less(L::splat(radius * radius))
            }
            Kind::Cylinder([own, half]) => {
                let side = ((x * x + y * y).sqrt() - L::splat(own)).max(L::splat(0.0));
                let end = beyond(z, half);
                (side * side + end * end).less(L::splat(radius * radius))
            }
            Kind::Capsule([own, half]) => {
                let end = beyond(z, half);
                let sum = own + radius;
                (x * x + y * y + end * end).less(L::splat(sum * sum))
            }
        }
    }
}

#[inline(always)]
fn dot<L: Lanes>(row: &[f32; 3], d: &Points<L>) -> L {
    d[0] * L::splat(row[0]) + d[1] * L::splat(row[1]) + d[2] * L::splat(row[2])
}

/// How far values are beyond `-half..half`.
#[inline(always)]
fn beyond<L: Lanes>(value: L, half: f32) -> L {
    (value.abs() - L::splat(half)).max(L::splat(0.0))
}

impl Field<'_> {
    /// Voxel coordinates of eight world points, brought into the grid.
    #[inline(always)]
    fn coordinates<L: Lanes>(&self, points: &Points<L>) -> [Row; 3] {
        let inverse = 1.0 / self.grid.voxel_m() as f32;
        let low = self.grid.low();
        xyz!(i => {
            let shifted = dot(&self.rotation[i], points)
                + L::splat(self.translation[i] - low[i] as f32);
            // The last voxel is never the base of an interpolation.
            let top = (self.grid.size()[i] - 1) as f32 * (1.0 - 1e-6);
            let mut row = Row::default();
            (shifted * L::splat(inverse)).max(L::splat(0.0)).min(L::splat(top)).store(&mut row);
            row
        })
    }

    /// Value at the nearest voxel, for one lane.
    #[inline(always)]
    fn nearest(&self, coordinates: &[Row; 3], lane: usize) -> f32 {
        let [nx, ny, _] = self.grid.size();
        let [x, y, z] = xyz!(i => (coordinates[i].0[lane] + 0.5) as usize);
        self.grid.values()[(z * ny + y) * nx + x]
    }

    /// Distances are 1-Lipschitz; a voxel's diagonal is left for their interpolation, as much again for signs.
    #[inline(always)]
    fn slack(&self) -> f32 {
        2.0 * self.grid.voxel_m() as f32
    }

    #[inline(always)]
    fn may_touch<L: Lanes>(&self, centers: &Points<L>, radius: f32) -> bool {
        let coordinates = self.coordinates(centers);
        let mut least = f32::INFINITY;
        for lane in 0..LANES {
            least = least.min(self.nearest(&coordinates, lane));
        }
        least < radius + self.slack()
    }

    #[inline(always)]
    fn touched<L: Lanes>(&self, centers: &Points<L>, radius: f32) -> u32 {
        let coordinates = self.coordinates(centers);
        let reach = radius + self.slack();
        let mut hits = 0;
        for lane in 0..LANES {
            if self.nearest(&coordinates, lane) < reach
                && self.interpolated(&coordinates, lane) < radius
            {
                hits |= 1 << lane;
            }
        }
        hits
    }

    /// Trilinear value, for one lane.
    fn interpolated(&self, coordinates: &[Row; 3], lane: usize) -> f32 {
        let [nx, ny, _] = self.grid.size();
        let u: [f32; 3] = std::array::from_fn(|i| coordinates[i].0[lane]);
        let base = u.map(|v| v as usize);
        let f: [f32; 3] = std::array::from_fn(|i| u[i] - base[i] as f32);
        let values = &self.grid.values()[(base[2] * ny + base[1]) * nx + base[0]..];
        let lerp = |a: f32, b: f32, t: f32| a + (b - a) * t;
        let edge = |offset: usize| lerp(values[offset], values[offset + 1], f[0]);
        let face = |offset: usize| lerp(edge(offset), edge(offset + nx), f[1]);
        lerp(face(0), face(nx * ny), f[2])
    }
}
