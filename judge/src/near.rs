//! Pairs of moving bodies, with what is known about them from the configurations before: neighbouring
//! configurations differ little, so most pairs need no look at all.

use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;

use crate::bodies::Obstacle;
use crate::convex::{ConvexPiece, Deepest, DepthProbe, Plane};
use crate::kinematics::Frame;

/// Everything nearer than this is gathered at once, metres.
const MARGIN_M: f64 = 0.04;

/// The corners of a box in another frame. While a body moves, none of its points moves farther than
/// the farthest corner of a box around it.
#[derive(Debug, Clone, Copy)]
pub struct Corners([Vector; 8]);

impl Corners {
    /// The corners of `bounds`, given in the inner frame, in the outer one.
    pub fn of(bounds: &Aabb, frame: &Frame) -> Self {
        Self(bounds.vertices().map(|corner| frame.point(corner)))
    }

    /// How far a point of the box can have moved, metres.
    pub fn moved_since(&self, earlier: &Self) -> f64 {
        let squares = self.0.iter().zip(&earlier.0).map(|(a, b)| a.distance_squared(*b));
        squares.fold(0.0, f64::max).sqrt()
    }
}

/// The gap between two solids when it was last measured.
#[derive(Debug, Clone)]
pub struct Gap {
    corners: Corners,
    gap_m: f64,
}

/// The deepest point of the surface of `a` inside `b`, in the frame of `b`, if deeper than `floor_m`.
pub fn surface_in_solid(
    probe: &mut DepthProbe,
    a: &ConvexPiece,
    b: &ConvexPiece,
    b_from_a: &Frame,
    memory: &mut Option<Gap>,
    floor_m: f64,
) -> Option<Deepest> {
    let corners = Corners::of(&a.bounds, b_from_a);
    if memory.as_ref().is_some_and(|gap| corners.moved_since(&gap.corners) < gap.gap_m) {
        return None;
    }
    *memory = None;
    let vertices: Vec<Vector> = a.vertices.iter().map(|&v| b_from_a.point(v)).collect();
    let gap_m = b
        .planes
        .iter()
        .map(|plane| vertices.iter().map(|&v| plane.distance(v)).fold(f64::MAX, f64::min))
        .fold(f64::MIN, f64::max);
    if gap_m > 0.0 {
        *memory = Some(Gap { corners, gap_m });
    }
    if gap_m >= -floor_m {
        return None;
    }
    let mut best: Option<Deepest> = None;
    for triangle in &a.triangles {
        let triangle = triangle.map(|vertex| vertices[vertex as usize]);
        let floor_m = best.map_or(floor_m, |deepest| deepest.depth_m);
        best = probe.deepest(&b.planes, &triangle, floor_m).or(best);
    }
    best
}

/// Decides what an intrusion means.
pub trait Intrusions {
    /// Is this owner's geometry of interest at all?
    fn wanted(&self, owner: u32) -> bool;
    /// Only intrusions into this owner deeper than this are of interest, metres.
    fn floor_m(&self, owner: u32) -> f64;
    /// Something of this owner is this deep; the point is in the obstacle's frame.
    fn found(&mut self, owner: u32, deepest: Deepest);
}

/// What of an obstacle is near a solid.
#[derive(Debug)]
pub struct Near {
    corners: Corners,
    /// Triangles, with the face of the solid that last kept each of them out.
    triangles: Vec<(u32, u32)>,
    solids: Vec<(u32, Option<Gap>)>,
}

impl Near {
    fn gather(corners: Corners, obstacle: &Obstacle, wanted: impl Fn(u32) -> bool) -> Self {
        let reach = Aabb::from_points(corners.0).add_half_extents(Vector::splat(MARGIN_M));
        let triangles = obstacle.triangle_bvh.intersect_aabb(&reach);
        let solids = obstacle.solid_bvh.intersect_aabb(&reach);
        Self {
            corners,
            triangles: triangles
                .filter(|&t| wanted(obstacle.triangle_owners[t as usize]))
                .map(|t| (t, 0))
                .collect(),
            solids: solids
                .filter(|&s| wanted(obstacle.solid_owners[s as usize]))
                .map(|s| (s, None))
                .collect(),
        }
    }

    /// Reports how deep the obstacle's surfaces reach into `solid`, and the solid's surface into the
    /// obstacle's solids. `memory` belongs to this pair.
    pub fn visit(
        memory: &mut Option<Self>,
        probe: &mut DepthProbe,
        solid: &ConvexPiece,
        obstacle: &Obstacle,
        obstacle_from_solid: &Frame,
        intrusions: &mut impl Intrusions,
    ) {
        let corners = Corners::of(&solid.bounds, obstacle_from_solid);
        let near = match memory {
            Some(near) if corners.moved_since(&near.corners) < MARGIN_M => near,
            _ => memory.insert(Self::gather(corners, obstacle, |owner| intrusions.wanted(owner))),
        };
        if !near.triangles.is_empty() {
            let planes = moved_planes(&solid.planes, obstacle_from_solid);
            for (index, keeps_out) in &mut near.triangles {
                let triangle = &obstacle.triangles[*index as usize];
                let owner = obstacle.triangle_owners[*index as usize];
                let floor_m = intrusions.floor_m(owner);
                let outside =
                    |plane: &Plane| triangle.iter().all(|&v| plane.distance(v) >= -floor_m);
                if outside(&planes[*keeps_out as usize]) {
                    continue;
                }
                if let Some(plane) = planes.iter().position(outside) {
                    *keeps_out = plane as u32;
                } else if let Some(deepest) = probe.deepest(&planes, triangle, floor_m) {
                    intrusions.found(owner, deepest);
                }
            }
        }
        for (index, gap) in &mut near.solids {
            let owner = obstacle.solid_owners[*index as usize];
            let other = &obstacle.solids[*index as usize];
            let floor_m = intrusions.floor_m(owner);
            if let Some(deepest) =
                surface_in_solid(probe, solid, other, obstacle_from_solid, gap, floor_m)
            {
                intrusions.found(owner, deepest);
            }
        }
    }
}

fn moved_planes(planes: &[Plane], frame: &Frame) -> Vec<Plane> {
    planes
        .iter()
        .map(|plane| {
            let normal = frame.rotation * plane.normal;
            Plane { normal, offset: plane.offset + normal.dot(frame.translation) }
        })
        .collect()
}
