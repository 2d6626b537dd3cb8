//! Closed triangle surfaces: boxes, solids of revolution and bent rods.

use std::collections::HashMap;
use std::f64::consts::TAU;

use akrobat_model::Pose;
use nalgebra::{Point3, Vector3};

/// A corner of a triangle: indices into the positions and the texture coordinates of its [`Solid`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Corner {
    /// Index of the position.
    pub position: usize,
    /// Index of the texture coordinate.
    pub uv: usize,
}

/// A closed, outward-facing triangle surface. Positions are shared between the triangles that meet in
/// them, so that closedness can be read off the indices.
#[derive(Debug, Clone, Default)]
pub struct Solid {
    /// Vertex positions, metres.
    pub positions: Vec<Point3<f64>>,
    /// Texture coordinates, metres along the surface.
    pub uvs: Vec<[f64; 2]>,
    /// Triangles, counter-clockwise seen from outside.
    pub triangles: Vec<[Corner; 3]>,
}

impl Solid {
    /// The axis-aligned box between two corners, metres.
    pub fn cuboid(low: [f64; 3], high: [f64; 3]) -> Self {
        let positions = (0..8)
            .map(|corner| {
                Point3::from(std::array::from_fn::<f64, 3, _>(|axis| {
                    if corner >> axis & 1 == 1 { high[axis] } else { low[axis] }
                }))
            })
            .collect();
        let mut solid = Self { positions, ..Self::default() };
        for normal in 0..3 {
            let (u, v) = ((normal + 1) % 3, (normal + 2) % 3);
            for side in [0, 1] {
                let corner = |a: usize, b: usize| side << normal | a << u | b << v;
                let mut quad = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                if side == 0 {
                    quad.reverse();
                }
                // The texture's v runs along z on every upright face, so that wood grain stands upright.
                let (s, t) = if normal == 1 { (v, u) } else { (u, v) };
                solid.push_quad(quad, s, t);
            }
        }
        solid
    }

    fn push_quad(&mut self, quad: [usize; 4], s: usize, t: usize) {
        let first_uv = self.uvs.len();
        self.uvs.extend(quad.map(|p| [self.positions[p][s], self.positions[p][t]]));
        let corner = |k: usize| Corner { position: quad[k], uv: first_uv + k };
        self.triangles.push([corner(0), corner(1), corner(2)]);
        self.triangles.push([corner(0), corner(2), corner(3)]);
    }

    /// The solid of revolution about z of a profile of `(radius, z)` points in metres, which starts and
    /// ends on the axis and runs upwards along the outside.
    pub fn lathe(profile: &[[f64; 2]], sides: usize) -> Self {
        let rings: Vec<Ring> = profile
            .iter()
            .map(|&[radius, z]| Ring {
                centre: Point3::new(0.0, 0.0, z),
                axes: [Vector3::x() * radius, Vector3::y() * radius],
            })
            .collect();
        Self::skin(&rings, sides)
    }

    /// An upright rod: radius and height in metres, from z = 0.
    pub fn rod(radius: f64, height: f64, sides: usize) -> Self {
        Self::lathe(&[[0.0, 0.0], [radius, 0.0], [radius, height], [0.0, height]], sides)
    }

    /// A round rod bent along a path that lies in a plane with the given normal; metres.
    pub fn bent_rod(path: &[Point3<f64>], normal: Vector3<f64>, radius: f64, sides: usize) -> Self {
        let last = path.len() - 1;
        let ring = |at: usize, radius: f64| {
            let along = path[(at + 1).min(last)] - path[at.saturating_sub(1)];
            let side = along.cross(&normal).normalize();
            Ring { centre: path[at], axes: [side * radius, -normal.normalize() * radius] }
        };
        let mut rings = vec![ring(0, 0.0)];
        rings.extend((0..path.len()).map(|at| ring(at, radius)));
        rings.push(ring(last, 0.0));
        Self::skin(&rings, sides)
    }

    /// Joins consecutive rings; a ring of zero radius is one vertex.
    fn skin(rings: &[Ring], sides: usize) -> Self {
        let mut solid = Self::default();
        let mut length = 0.0;
        let mut previous: Option<Vec<Corner>> = None;
        for (at, ring) in rings.iter().enumerate() {
            if at > 0 {
                length += (ring.edge(0.0) - rings[at - 1].edge(0.0)).norm();
            }
            let corners = solid.push_ring(ring, sides, length);
            if let Some(below) = previous {
                for side in 0..sides {
                    solid.push_strip([
                        below[side],
                        below[side + 1],
                        corners[side + 1],
                        corners[side],
                    ]);
                }
            }
            previous = Some(corners);
        }
        solid
    }

    fn push_ring(&mut self, ring: &Ring, sides: usize, length: f64) -> Vec<Corner> {
        let first = self.positions.len();
        let pole = ring.is_pole();
        let count = if pole { 1 } else { sides };
        self.positions.extend((0..count).map(|side| ring.edge(side as f64 / sides as f64)));
        let around = ring.axes[0].norm() * TAU;
        (0..=sides)
            .map(|side| {
                self.uvs.push([around * side as f64 / sides as f64, length]);
                Corner { position: first + side % count, uv: self.uvs.len() - 1 }
            })
            .collect()
    }

    fn push_strip(&mut self, [a, b, c, d]: [Corner; 4]) {
        if a.position != b.position {
            self.triangles.push([a, b, c]);
        }
        if c.position != d.position {
            self.triangles.push([a, c, d]);
        }
    }

    /// The solid moved by a pose.
    pub fn moved(mut self, pose: &Pose) -> Self {
        for position in &mut self.positions {
            *position = pose * *position;
        }
        self
    }

    /// Smallest and largest corner of the bounding box.
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let empty = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        self.positions.iter().fold(empty, |(low, high), p| {
            (std::array::from_fn(|i| low[i].min(p[i])), std::array::from_fn(|i| high[i].max(p[i])))
        })
    }

    /// Signed volume, m^3: positive where the triangles face outwards.
    pub fn volume(&self) -> f64 {
        let six_volumes = self.triangles.iter().map(|triangle| {
            let [a, b, c] = triangle.map(|corner| self.positions[corner.position].coords);
            a.dot(&b.cross(&c))
        });
        six_volumes.sum::<f64>() / 6.0
    }

    /// True where every edge is shared by exactly two triangles that run along it in opposite directions.
    pub fn is_closed(&self) -> bool {
        let mut edges: HashMap<[usize; 2], usize> = HashMap::new();
        for triangle in &self.triangles {
            for k in 0..3 {
                let edge = [triangle[k].position, triangle[(k + 1) % 3].position];
                *edges.entry(edge).or_default() += 1;
            }
        }
        edges.iter().all(|(&[a, b], &count)| count == 1 && edges.get(&[b, a]) == Some(&1))
    }

    /// Unit normals of every triangle's corners: the area-weighted mean over the faces that meet there
    /// within 40 degrees of its own, so that edges stay sharp and round sides are smooth.
    pub fn corner_normals(&self) -> Vec<[Vector3<f64>; 3]> {
        const COS_CREASE: f64 = 0.766;
        let face_normals: Vec<Vector3<f64>> = self
            .triangles
            .iter()
            .map(|triangle| {
                let [a, b, c] = triangle.map(|corner| self.positions[corner.position]);
                (b - a).cross(&(c - a))
            })
            .collect();
        let mut faces_of_position: Vec<Vec<usize>> = vec![Vec::new(); self.positions.len()];
        for (face, triangle) in self.triangles.iter().enumerate() {
            for corner in triangle {
                faces_of_position[corner.position].push(face);
            }
        }
        let corner_normal = |face: usize, corner: Corner| {
            let own = face_normals[face].normalize();
            let smooth = faces_of_position[corner.position]
                .iter()
                .map(|&other| face_normals[other])
                .filter(|normal| normal.normalize().dot(&own) > COS_CREASE);
            smooth.sum::<Vector3<f64>>().normalize()
        };
        self.triangles
            .iter()
            .enumerate()
            .map(|(face, triangle)| triangle.map(|corner| corner_normal(face, corner)))
            .collect()
    }
}

/// An ellipse of vertices; a pole where both axes vanish.
struct Ring {
    centre: Point3<f64>,
    axes: [Vector3<f64>; 2],
}

impl Ring {
    fn edge(&self, turn: f64) -> Point3<f64> {
        let (sin, cos) = (turn * TAU).sin_cos();
        self.centre + self.axes[0] * cos + self.axes[1] * sin
    }

    fn is_pole(&self) -> bool {
        self.axes[0].norm() == 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solids_are_closed_and_face_outwards() {
        let path: Vec<Point3<f64>> =
            (0..=8).map(|k| Point3::new((k as f64 * 0.3).sin(), k as f64 * 0.3, 0.0)).collect();
        let solids = [
            (Solid::cuboid([0.0; 3], [1.0, 2.0, 3.0]), 6.0, 1e-12),
            (Solid::rod(0.5, 2.0, 64), 0.5 * 0.5 * 2.0 * std::f64::consts::PI, 0.005),
            (Solid::lathe(&[[0.0, -1.0], [1.0, 0.0], [0.0, 1.0]], 64), TAU / 3.0, 0.005),
            (Solid::bent_rod(&path, Vector3::z(), 0.01, 12), 8.6e-4, 1e-4),
        ];
        for (solid, volume, tolerance) in solids {
            assert!(solid.is_closed());
            assert!((solid.volume() - volume).abs() < tolerance, "{} {volume}", solid.volume());
        }
    }

    #[test]
    fn a_missing_triangle_is_noticed() {
        let mut open = Solid::cuboid([0.0; 3], [1.0; 3]);
        open.triangles.pop();
        assert!(!open.is_closed());
        let mut flipped = Solid::cuboid([0.0; 3], [1.0; 3]);
        flipped.triangles[3].swap(0, 1);
        assert!(!flipped.is_closed());
    }

    #[test]
    fn box_edges_stay_sharp_and_rods_are_smooth() {
        for normals in Solid::cuboid([0.0; 3], [1.0; 3]).corner_normals() {
            assert!(normals.iter().all(|n| n.amax() > 0.999));
        }
        let rod = Solid::rod(1.0, 1.0, 32);
        for (triangle, normals) in rod.triangles.iter().zip(rod.corner_normals()) {
            for (corner, normal) in triangle.iter().zip(normals) {
                if normal.z.abs() < 0.5 {
                    let radial = rod.positions[corner.position].coords.xy();
                    assert!(normal.xy().dot(&radial) > 0.99);
                }
            }
        }
    }
}
