//! Points that are neighbours in space, in lanes.

use akrobat_simd::{LANES, Lanes, Row, xyz};

/// Rows of a leaf.
pub(super) const ROWS: usize = 4;

/// Points of a leaf: a pixel tile's.
pub(super) const LEAF: usize = ROWS * LANES;

/// Up to [`LEAF`] points.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Leaf {
    /// Coordinates, axis by axis; a lane without a point repeats one that another lane holds.
    pub points: [[Row; ROWS]; 3],
    /// Square distance of every point from the nearest sample, infinite before the first; negative where there is no point.
    pub square: [Row; ROWS],
}

impl Leaf {
    /// The points in the lanes whose bit is set in `held`; `None` where none is.
    #[inline(always)]
    pub fn new(mut points: [[Row; ROWS]; 3], held: u32) -> Option<Self> {
        let mut square = [Row([f32::INFINITY; LANES]); ROWS];
        if held != u32::MAX {
            if held == 0 {
                return None;
            }
            let some = held.trailing_zeros() as usize;
            for lane in (0..LEAF).filter(|lane| held >> lane & 1 == 0) {
                let (row, within) = (lane / LANES, lane % LANES);
                for axis in &mut points {
                    axis[row].0[within] = axis[some / LANES].0[some % LANES];
                }
                square[row].0[within] = -1.0;
            }
        }
        Some(Self { points, square })
    }

    /// A list's points in its order, so that point `i` is lane `i % LEAF` of leaf `i / LEAF`.
    pub fn of_list(list: &[[f32; 3]]) -> Vec<Self> {
        let leaf = |chunk: &[[f32; 3]]| {
            let (mut points, mut held) = ([[Row::default(); ROWS]; 3], 0);
            for (lane, point) in chunk.iter().enumerate() {
                for axis in 0..3 {
                    points[axis][lane / LANES].0[lane % LANES] = point[axis];
                }
                held |= 1 << lane;
            }
            Self::new(points, held)
        };
        list.chunks(LEAF).filter_map(leaf).collect()
    }

    /// Whether a lane holds a point.
    #[inline(always)]
    pub fn holds(&self, lane: usize) -> bool {
        self.square[lane / LANES].0[lane % LANES] >= 0.0
    }

    /// How many lanes hold a point.
    #[inline(always)]
    pub fn count(&self) -> usize {
        let held = |row: &Row| row.0.iter().filter(|&&square| square >= 0.0).count();
        self.square.iter().map(held).sum()
    }

    /// A lane's point.
    #[inline(always)]
    pub fn point(&self, lane: usize) -> [f32; 3] {
        xyz!(i => self.points[i][lane / LANES].0[lane % LANES])
    }

    /// Lowest and highest corner of the box around the points.
    #[inline(always)]
    pub fn corners<L: Lanes>(&self) -> ([f32; 3], [f32; 3]) {
        let mut corners = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let first = L::load(&self.points[axis][0]);
            let (mut low, mut high) = (first, first);
            for row in 1..ROWS {
                let row = L::load(&self.points[axis][row]);
                (low, high) = (low.min(row), high.max(row));
            }
            (corners.0[axis], corners.1[axis]) = (low.smallest(), high.largest());
        }
        corners
    }

    /// Square distances of all lanes from a place.
    #[inline(always)]
    pub fn square_distances<L: Lanes>(&self, place: [L; 3]) -> [L; ROWS] {
        let mut out = [L::splat(0.0); ROWS];
        for row in 0..ROWS {
            let [x, y, z] = xyz!(i => L::load(&self.points[i][row]) - place[i]);
            out[row] = x * x + y * y + z * z;
        }
        out
    }

    /// Takes a sample into account; gives the largest of the points' square distances.
    #[inline(always)]
    pub fn add<L: Lanes>(&mut self, sample: [L; 3]) -> f32 {
        let distances = self.square_distances(sample);
        let mut largest = L::splat(-1.0);
        for row in 0..ROWS {
            let nearest = distances[row].min(L::load(&self.square[row]));
            nearest.store(&mut self.square[row]);
            largest = largest.max(nearest);
        }
        largest.largest()
    }
}
