//! Closed convex solids and how deep a triangle reaches into one.

use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;
use parry3d_f64::transformation::try_convex_hull;

/// A body thinner than this has no inside: metres of volume per surface area.
const FLAT_M: f64 = 1e-6;
/// Cosine above which two faces of a hull count as one plane.
const SAME_PLANE_COSINE: f64 = 1.0 - 1e-10;

/// A half space: `normal . x <= offset`.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    /// Outward unit normal.
    pub normal: Vector,
    /// Distance from the origin along the normal, metres.
    pub offset: f64,
}

impl Plane {
    /// Signed distance of a point, positive outside, metres.
    pub fn distance(&self, point: Vector) -> f64 {
        self.normal.dot(point) - self.offset
    }
}

/// A closed convex solid with an inside.
#[derive(Debug, Clone)]
pub struct ConvexPiece {
    /// Corners.
    pub vertices: Vec<Vector>,
    /// Surface, as corner indices.
    pub triangles: Vec<[u32; 3]>,
    /// Faces.
    pub planes: Vec<Plane>,
    /// Bounding box.
    pub bounds: Aabb,
    /// Centre of a ball around it.
    pub center: Vector,
    /// Radius of that ball, metres.
    pub radius: f64,
    /// Volume, cubic metres.
    pub volume: f64,
}

impl ConvexPiece {
    /// The convex hull of finite points; `None` where it is flat or empty.
    pub fn hull(points: &[Vector]) -> Option<Self> {
        if points.len() < 4 {
            return None;
        }
        let (vertices, triangles) = try_convex_hull(points).ok()?;
        let center = vertices.iter().sum::<Vector>() / vertices.len() as f64;
        let (mut volume, mut area) = (0.0, 0.0);
        let mut planes: Vec<Plane> = Vec::new();
        for triangle in &triangles {
            let [a, b, c] = triangle.map(|vertex| vertices[vertex as usize]);
            let normal_times_two_areas = (b - a).cross(c - a);
            volume += normal_times_two_areas.dot(a - center) / 6.0;
            area += normal_times_two_areas.length() / 2.0;
            let Some(normal) = normal_times_two_areas.try_normalize() else { continue };
            if planes.iter().all(|plane| plane.normal.dot(normal) < SAME_PLANE_COSINE) {
                // The farthest input point bounds the face whatever the hull's rounding was.
                let offset = points.iter().map(|p| normal.dot(*p)).fold(f64::MIN, f64::max);
                planes.push(Plane { normal, offset });
            }
        }
        if volume <= FLAT_M * area {
            return None;
        }
        let bounds = Aabb::from_points(vertices.iter().copied());
        let center = bounds.center();
        let radius = vertices.iter().map(|v| v.distance(center)).fold(0.0, f64::max);
        Some(Self { vertices, triangles, planes, bounds, center, radius, volume })
    }

    /// Signed distance of a point to the nearest face plane, negative inside, metres.
    pub fn distance(&self, point: Vector) -> f64 {
        self.planes.iter().map(|plane| plane.distance(point)).fold(f64::MIN, f64::max)
    }
}

/// The deepest point of something inside a convex solid.
#[derive(Debug, Clone, Copy)]
pub struct Deepest {
    /// Distance to the nearest face, metres.
    pub depth_m: f64,
    /// The point.
    pub point: Vector,
}

/// Finds how deep triangles reach into convex solids. The depth of a point is its distance to the
/// nearest face; that of a triangle is the largest over *all* its points, found by clipping it
/// against the faces moved inwards, so nothing hides between surface samples.
#[derive(Debug, Default)]
pub struct DepthProbe {
    polygon: Vec<Vector>,
    clipped: Vec<Vector>,
}

impl DepthProbe {
    /// Depths are found to this precision, metres.
    const PRECISION_M: f64 = 1e-6;
    /// Each cut through the centre takes away about half of the polygon.
    const MAX_CUTS: usize = 40;

    /// The deepest point of a triangle inside the solid bounded by `planes` if it is deeper than
    /// `floor_m` (>= 0).
    ///
    /// Depth is concave over the triangle, so cutting away what is less deep than the centre converges
    /// on the maximum (the centre-of-gravity method).
    pub fn deepest(
        &mut self,
        planes: &[Plane],
        triangle: &[Vector; 3],
        floor_m: f64,
    ) -> Option<Deepest> {
        self.polygon.clear();
        self.polygon.extend_from_slice(triangle);
        let mut best: Option<Deepest> = None;
        let mut level = floor_m;
        for _ in 0..Self::MAX_CUTS {
            if !self.clip(planes, level) {
                break;
            }
            let point = self.polygon.iter().sum::<Vector>() / self.polygon.len() as f64;
            let depth_m = planes.iter().map(|p| -p.distance(point)).fold(f64::MAX, f64::min);
            if depth_m <= level {
                break;
            }
            best = Some(Deepest { depth_m, point });
            if depth_m - level < Self::PRECISION_M {
                break;
            }
            level = depth_m;
        }
        best
    }

    /// Keeps the part of the polygon that is at least `depth_m` inside all planes; false if none is.
    fn clip(&mut self, planes: &[Plane], depth_m: f64) -> bool {
        for plane in planes {
            let outside = |point: Vector| plane.distance(point) + depth_m;
            if self.polygon.iter().all(|&p| outside(p) <= 0.0) {
                continue;
            }
            self.clipped.clear();
            for (index, &from) in self.polygon.iter().enumerate() {
                let to = self.polygon[(index + 1) % self.polygon.len()];
                let (from_outside, to_outside) = (outside(from), outside(to));
                if from_outside <= 0.0 {
                    self.clipped.push(from);
                }
                if (from_outside <= 0.0) != (to_outside <= 0.0) {
                    let fraction = from_outside / (from_outside - to_outside);
                    self.clipped.push(from + (to - from) * fraction);
                }
            }
            std::mem::swap(&mut self.polygon, &mut self.clipped);
            if self.polygon.is_empty() {
                return false;
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn unit_cube() -> ConvexPiece {
        let corners: Vec<Vector> = (0..8)
            .map(|i| Vector::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2 & 1)))
            .collect();
        ConvexPiece::hull(&corners).unwrap()
    }

    #[test]
    fn a_cube_has_six_faces() {
        let cube = unit_cube();
        assert_eq!(cube.planes.len(), 6);
        assert!((cube.volume - 1.0).abs() < 1e-12);
        assert!((cube.distance(Vector::splat(0.5)) + 0.5).abs() < 1e-12);
    }

    #[test]
    fn flat_point_sets_have_no_inside() {
        let square: Vec<Vector> =
            (0..4).map(|i| Vector::new(f64::from(i & 1), f64::from(i >> 1), 0.0)).collect();
        assert!(ConvexPiece::hull(&square).is_none());
        assert!(ConvexPiece::hull(&square[..2]).is_none());
    }

    #[test]
    fn a_large_triangle_through_a_cube_is_deepest_in_the_middle() {
        let big = [(-9.0, -9.0), (9.0, -9.0), (0.0, 12.0)].map(|(x, y)| Vector::new(x, y, 0.6));
        let deepest = DepthProbe::default().deepest(&unit_cube().planes, &big, 0.0).unwrap();
        assert!((deepest.depth_m - 0.4).abs() < 1e-5, "{deepest:?}");
        assert!(DepthProbe::default().deepest(&unit_cube().planes, &big, 0.41).is_none());
    }

    proptest! {
        /// The depth is at least that of every sample of the triangle, and hardly more than the best.
        #[test]
        fn depth_is_the_maximum_over_the_triangle(numbers in prop::array::uniform9(-0.5..1.5f64)) {
            let cube = unit_cube();
            let [a, b, c] = [0, 3, 6].map(|i| Vector::new(numbers[i], numbers[i + 1], numbers[i + 2]));
            let found = DepthProbe::default().deepest(&cube.planes, &[a, b, c], 0.0).map_or(0.0, |d| d.depth_m);
            const STEPS: u32 = 60;
            let mut sampled = 0.0f64;
            for i in 0..=STEPS {
                for j in 0..=STEPS - i {
                    let (u, v) = (f64::from(i) / f64::from(STEPS), f64::from(j) / f64::from(STEPS));
                    sampled = sampled.max(-cube.distance(a + (b - a) * u + (c - a) * v));
                }
            }
            prop_assert!(found >= sampled - 1e-5);
            let spacing = ((b - a).length() + (c - a).length()) / f64::from(STEPS);
            prop_assert!(found <= sampled + spacing);
        }
    }
}
