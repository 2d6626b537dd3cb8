//! What stands on the floor of a scene, seen from above, in square cells.

use akrobat_model::{Pose, SceneBody};
use nalgebra::{Point3, Vector2, Vector3};

use super::layout::parts_bounds;

/// Edge of a cell, metres.
const CELL_M: f64 = 0.05;
/// What lies between these heights above the floor is in the way of furniture and robots, metres.
const IN_THE_WAY_M: [f64; 2] = [0.04, 1.9];
/// Cells are looked at along an edge at most this many.
const MOST_CELLS: usize = 4000;

/// A rectangle on the floor: pose of its back's middle with x to the front.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rectangle {
    /// Middle of its back, metres.
    pub back: Vector2<f64>,
    /// The way that its front faces, radians.
    pub yaw: f64,
    /// Depth and width, metres.
    pub size: [f64; 2],
}

impl Rectangle {
    /// Pose of its back's middle.
    pub fn world_from_back(&self) -> Pose {
        let turn = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.yaw);
        Pose::from_parts(Vector3::new(self.back.x, self.back.y, 0.0).into(), turn)
    }

    /// The rectangle that reaches from `from_m` to `to_m` in front of its back, wider by `wider_m` in all.
    #[must_use]
    pub fn stretch(&self, from_m: f64, to_m: f64, wider_m: f64) -> Self {
        let ahead = Vector2::new(self.yaw.cos(), self.yaw.sin()) * from_m;
        Self {
            back: self.back + ahead,
            yaw: self.yaw,
            size: [to_m - from_m, self.size[1] + wider_m],
        }
    }

    /// Points of it, half a cell apart, its edges among them.
    fn points(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        let steps = self.size.map(|edge| (2.0 * edge / CELL_M).ceil().max(1.0) as usize);
        let ahead = Vector2::new(self.yaw.cos(), self.yaw.sin());
        let left = Vector2::new(-ahead.y, ahead.x);
        (0..=steps[0]).flat_map(move |i| {
            (0..=steps[1]).map(move |j| {
                let x = self.size[0] * i as f64 / steps[0] as f64;
                let y = self.size[1] * (j as f64 / steps[1] as f64 - 0.5);
                self.back + ahead * x + left * y
            })
        })
    }
}

/// Cells of the floor and what is on them.
#[derive(Debug, Clone)]
pub struct Ground {
    low: Vector2<f64>,
    counts: [usize; 2],
    floor: Vec<bool>,
    taken: Vec<bool>,
}

impl Ground {
    /// Looks at bodies from above. Where none has a floor at z = 0, all of their extent counts as floor.
    pub fn new(bodies: &[SceneBody]) -> Self {
        let all = bodies.iter().flat_map(|body| {
            body.collision_parts().iter().map(move |part| (body.world_from_body, part))
        });
        let (low, high) = parts_bounds(all).unwrap_or_default();
        let counts = [0, 1].map(|axis| {
            (((high[axis] - low[axis]) / CELL_M).ceil().max(1.0) as usize).min(MOST_CELLS)
        });
        let cells = counts[0] * counts[1];
        let mut ground =
            Self { low: low.xy(), counts, floor: vec![false; cells], taken: vec![false; cells] };
        for body in bodies {
            for part in body.collision_parts() {
                let world_from_part = body.world_from_body;
                part.triangulate().iter().for_each(|mesh| {
                    let corner = |i: u32| {
                        let position = mesh.positions[i as usize].map(f64::from);
                        (world_from_part * Point3::from(position)).coords
                    };
                    for triangle in &mesh.triangles {
                        ground.add(&triangle.map(corner));
                    }
                });
            }
        }
        if !ground.floor.contains(&true) {
            ground.floor.fill(true);
        }
        ground
    }

    /// Marks the cells below a triangle, by points on it.
    fn add(&mut self, [a, b, c]: &[Vector3<f64>; 3]) {
        let longest = (b - a).norm().max((c - a).norm()).max((c - b).norm());
        let steps = ((1.5 * longest / CELL_M).ceil() as usize).clamp(1, 2000);
        for i in 0..=steps {
            for j in 0..=steps - i {
                let (u, v) = (i as f64 / steps as f64, j as f64 / steps as f64);
                let point = a + (b - a) * u + (c - a) * v;
                let Some(cell) = self.cell(&point.xy()) else { continue };
                if point.z.abs() < IN_THE_WAY_M[0] {
                    self.floor[cell] = true;
                } else if (IN_THE_WAY_M[0]..IN_THE_WAY_M[1]).contains(&point.z) {
                    self.taken[cell] = true;
                }
            }
        }
    }

    fn cell(&self, at: &Vector2<f64>) -> Option<usize> {
        let index = [0, 1].map(|axis| ((at[axis] - self.low[axis]) / CELL_M).floor());
        let inside = (0..2).all(|i| index[i] >= 0.0 && (index[i] as usize) < self.counts[i]);
        inside.then(|| index[1] as usize * self.counts[0] + index[0] as usize)
    }

    /// Corners of what is known.
    pub fn bounds(&self) -> [Vector2<f64>; 2] {
        let size = Vector2::from(self.counts.map(|count| count as f64 * CELL_M));
        [self.low, self.low + size]
    }

    /// True where a rectangle has floor below it and nothing on it.
    pub fn is_free(&self, rectangle: &Rectangle) -> bool {
        let mut points = rectangle.points();
        points.all(|at| self.cell(&at).is_some_and(|cell| self.floor[cell] && !self.taken[cell]))
    }

    /// True where nothing is on a rectangle; it may reach beyond the floor.
    pub fn is_clear(&self, rectangle: &Rectangle) -> bool {
        rectangle.points().all(|at| self.cell(&at).is_none_or(|cell| !self.taken[cell]))
    }

    /// Puts something on a rectangle.
    pub fn take(&mut self, rectangle: &Rectangle) {
        for at in rectangle.points() {
            if let Some(cell) = self.cell(&at) {
                self.taken[cell] = true;
            }
        }
    }

    /// Share of the floor's cells on which a disc of a radius can stand.
    pub fn free_share(&self, radius_m: f64) -> f64 {
        let reach = (radius_m / CELL_M).ceil() as isize;
        let offsets: Vec<[isize; 2]> = (-reach..=reach)
            .flat_map(|i| (-reach..=reach).map(move |j| [i, j]))
            .filter(|[i, j]| (*i as f64).hypot(*j as f64) * CELL_M <= radius_m)
            .collect();
        let (width, height) = (self.counts[0] as isize, self.counts[1] as isize);
        let stands = |cell: &usize| {
            let (x, y) = ((cell % self.counts[0]) as isize, (cell / self.counts[0]) as isize);
            offsets.iter().all(|[i, j]| {
                let (x, y) = (x + i, y + j);
                let inside = (0..width).contains(&x) && (0..height).contains(&y);
                !inside || !self.taken[(y * width + x) as usize]
            })
        };
        let floor: Vec<usize> = (0..self.floor.len()).filter(|&cell| self.floor[cell]).collect();
        floor.iter().filter(|cell| stands(cell)).count() as f64 / floor.len().max(1) as f64
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use akrobat_model::{Part, Shape, TriMesh};

    use super::*;

    fn slab(name: &str, size: [f64; 3], at: [f64; 3]) -> SceneBody {
        let shape = Shape::Box { size };
        let part =
            Part { name: name.into(), link_from_part: Pose::identity(), shape, material: None };
        SceneBody {
            name: name.into(),
            class: name.into(),
            world_from_body: Pose::translation(at[0], at[1], at[2]),
            visuals: vec![part],
            collisions: Vec::new(),
        }
    }

    #[test]
    fn furniture_takes_its_place_and_lamps_take_none() {
        let floor = slab("floor", [4.0, 4.0, 0.1], [0.0, 0.0, -0.05]);
        let table = slab("table", [1.0, 1.0, 0.7], [1.0, 0.0, 0.35]);
        let lamp = slab("lamp", [0.5, 0.5, 0.2], [-1.0, 0.0, 2.4]);
        let mut ground = Ground::new(&[floor, table, lamp]);
        let square = |x: f64| Rectangle { back: Vector2::new(x, 0.0), yaw: 0.0, size: [0.4; 2] };
        assert!(ground.is_free(&square(-1.2)), "below the lamp");
        assert!(!ground.is_free(&square(0.9)), "on the table");
        assert!(!ground.is_free(&square(1.8)), "beyond the floor");
        ground.take(&square(-1.2));
        assert!(!ground.is_free(&square(-1.1)));
        assert!((0.7..0.9).contains(&ground.free_share(0.2)), "{}", ground.free_share(0.2));
        assert!(Ground::new(&[]).free_share(0.2) >= 0.0);
        // A mesh without triangles is no floor.
        let nothing = TriMesh::default();
        let shape = Shape::Mesh { source: "n.obj".into(), meshes: Arc::new(vec![nothing]) };
        let mut empty = slab("empty", [1.0; 3], [0.0; 3]);
        empty.visuals[0].shape = shape;
        assert!(Ground::new(&[empty]).bounds()[0].x.is_finite());
    }
}
