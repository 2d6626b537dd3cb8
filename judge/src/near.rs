//! Pairs of moving bodies, with what is known about them from the configurations before.

use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;

use crate::bodies::Obstacle;
use crate::convex::{ConvexPiece, Deepest, DepthProbe, Plane};
use crate::kinematics::Frame;
use crate::travel::{RelativeWay, Travel};

/// Everything nearer than this is gathered at once, metres.
const MARGIN_M: f64 = 0.04;
/// Where there is nothing within this, it is not looked at again before it can be there, metres.
const WIDE_MARGIN_M: f64 = 0.3;
/// A gap of this size at the face that last had one is worth no search for a wider one …
const NARROW_GAP_M: f64 = 0.002;
/// … and a search ends at a gap of this size, metres.
const WIDE_GAP_M: f64 = 0.02;

/// A body that has not moved farther than this in the other's frame is where it was, metres.
const SAME_PLACE_M: f64 = 1e-5;

/// What is known about a pair of solids.
#[derive(Debug, Clone, Copy)]
struct Gap {
    /// They are apart until the way of one in the other's frame is this long, metres.
    free_until: f64,
    /// Faces of either solid that last had all of the other outside.
    faces: [u32; 2],
}

impl Default for Gap {
    fn default() -> Self {
        Self { free_until: f64::NEG_INFINITY, faces: [0; 2] }
    }
}

/// What is known about a pair of solids of the robot.
#[derive(Debug, Clone, Default)]
pub struct SolidPair {
    way: RelativeWay,
    gap: Gap,
    /// Length of the way when it was last looked at.
    looked_at: Option<f64>,
}

/// The smallest distance of the corners of `a` from a face of `b`: of a face that separates them well enough, or else the
/// largest over all faces. `face` is tried first and becomes the one with the distance given.
fn separation(a: &[Vector], planes: &[Plane], face: &mut u32) -> f64 {
    let beyond = |plane: &Plane| a.iter().map(|&v| plane.distance(v)).fold(f64::MAX, f64::min);
    let mut best = beyond(&planes[*face as usize]);
    if best > NARROW_GAP_M {
        return best;
    }
    for (index, plane) in planes.iter().enumerate() {
        if best > WIDE_GAP_M {
            break;
        }
        // One corner that is not farther out than the best tells enough of a face.
        if plane.distance(a[0]) > best {
            let distance = beyond(plane);
            if distance > best {
                (best, *face) = (distance, index as u32);
            }
        }
    }
    best
}

/// The deepest point of either solid's surface inside the other, in the frame of `b`, if deeper than `floor_m`.
/// `travel` is the sum of both ways in the world; `b_from_a` is asked for only where they are near.
pub fn solids_in_each_other(
    probe: &mut DepthProbe,
    a: &ConvexPiece,
    b: &ConvexPiece,
    b_from_a: impl Fn() -> Frame,
    travel: Travel,
    memory: &mut SolidPair,
    floor_m: f64,
) -> Option<Deepest> {
    if memory.way.skips(travel) {
        return None;
    }
    let frame = b_from_a();
    let way = memory.way.follow(&a.bounds, &frame);
    if way >= memory.gap.free_until && memory.looked_at.is_none_or(|at| way - at >= SAME_PLACE_M) {
        memory.looked_at = Some(way);
        let found = depth_in_each_other(probe, a, b, &frame, way, &mut memory.gap, floor_m);
        if found.is_some() {
            return found;
        }
    }
    memory.way.skip(memory.gap.free_until.max(way), travel);
    None
}

fn depth_in_each_other(
    probe: &mut DepthProbe,
    a: &ConvexPiece,
    b: &ConvexPiece,
    b_from_a: &Frame,
    way: f64,
    memory: &mut Gap,
    floor_m: f64,
) -> Option<Deepest> {
    let (a_in_b, gap) = entering(a, b, b_from_a, way, memory)?;
    let a_from_b = b_from_a.inverse();
    let b_in_a = placed(&b.vertices, &a_from_b);
    let other_gap = separation(&b_in_a, &a.planes, &mut memory.faces[1]);
    if other_gap > 0.0 {
        memory.free_until = way + other_gap;
        return None;
    }
    if gap.max(other_gap) >= -floor_m {
        return None;
    }
    let into_b = deepest_of(probe, a, &a_in_b, &b.planes, floor_m);
    let floor_m = into_b.map_or(floor_m, |deepest| deepest.depth_m);
    let into_a = deepest_of(probe, b, &b_in_a, &a.planes, floor_m);
    into_a.map(|d| Deepest { point: b_from_a.point(d.point), ..d }).or(into_b)
}

/// The deepest point of the surface of `a` inside `b`, in the frame of `b`, if deeper than `floor_m`.
fn surface_in_solid(
    probe: &mut DepthProbe,
    a: &ConvexPiece,
    b: &ConvexPiece,
    b_from_a: &Frame,
    way: f64,
    memory: &mut Gap,
    floor_m: f64,
) -> Option<Deepest> {
    if way < memory.free_until {
        return None;
    }
    let (vertices, gap) = entering(a, b, b_from_a, way, memory)?;
    if gap >= -floor_m { None } else { deepest_of(probe, a, &vertices, &b.planes, floor_m) }
}

/// The corners of `a` in the frame of `b`, and how far beyond a face of `b` they all are at most; `None`, with a note of
/// how long it holds, where that face or their distance keeps the two apart.
fn entering(
    a: &ConvexPiece,
    b: &ConvexPiece,
    b_from_a: &Frame,
    way: f64,
    memory: &mut Gap,
) -> Option<(Vec<Vector>, f64)> {
    let apart = b_from_a.point(a.center).distance(b.center) - a.radius - b.radius;
    if apart > 0.0 {
        memory.free_until = way + apart;
        return None;
    }
    let a_in_b = placed(&a.vertices, b_from_a);
    let gap = separation(&a_in_b, &b.planes, &mut memory.faces[0]);
    if gap > 0.0 {
        memory.free_until = way + gap;
        return None;
    }
    Some((a_in_b, gap))
}

fn placed(points: &[Vector], frame: &Frame) -> Vec<Vector> {
    points.iter().map(|&point| frame.point(point)).collect()
}

/// The deepest point of a solid's surface, whose corners are at `vertices`, inside `planes`.
fn deepest_of(
    probe: &mut DepthProbe,
    solid: &ConvexPiece,
    vertices: &[Vector],
    planes: &[Plane],
    floor_m: f64,
) -> Option<Deepest> {
    let mut best: Option<Deepest> = None;
    for triangle in &solid.triangles {
        let triangle = triangle.map(|vertex| vertices[vertex as usize]);
        let floor_m = best.map_or(floor_m, |deepest| deepest.depth_m);
        best = probe.deepest(planes, &triangle, floor_m).or(best);
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

/// A triangle near a solid.
#[derive(Debug)]
struct NearTriangle {
    index: u32,
    /// The face of the solid that last kept it out, and for how long it does.
    face: u32,
    free_until: f64,
}

/// What of an obstacle is near a solid.
#[derive(Debug)]
pub struct Near {
    /// Nothing else comes near until the way of the solid in the obstacle's frame is this long, metres.
    complete_until: f64,
    /// Nothing touches until then.
    free_until: f64,
    /// Length of the way when it was last looked at.
    looked_at: f64,
    triangles: Vec<NearTriangle>,
    solids: Vec<(u32, Gap)>,
}

impl Near {
    fn gather(
        solid: &ConvexPiece,
        obstacle: &Obstacle,
        obstacle_from_solid: &Frame,
        way: f64,
        wanted: impl Fn(u32) -> bool,
    ) -> Self {
        let corners = solid.bounds.vertices().map(|corner| obstacle_from_solid.point(corner));
        let tight = Aabb::from_points(corners);
        let wide = tight.add_half_extents(Vector::splat(WIDE_MARGIN_M));
        let nothing = obstacle.triangle_bvh.intersect_aabb(&wide).next().is_none()
            && obstacle.solid_bvh.intersect_aabb(&wide).next().is_none();
        if nothing {
            let complete_until = way + WIDE_MARGIN_M;
            let (triangles, solids) = (Vec::new(), Vec::new());
            let free_until = complete_until;
            return Self { complete_until, free_until, looked_at: way, triangles, solids };
        }
        let reach = tight.add_half_extents(Vector::splat(MARGIN_M));
        let triangles = obstacle.triangle_bvh.intersect_aabb(&reach);
        let solids = obstacle.solid_bvh.intersect_aabb(&reach);
        Self {
            complete_until: way + MARGIN_M,
            free_until: way,
            looked_at: way,
            triangles: triangles
                .filter(|&t| wanted(obstacle.triangle_owners[t as usize]))
                .map(|index| NearTriangle { index, face: 0, free_until: f64::NEG_INFINITY })
                .collect(),
            solids: solids
                .filter(|&s| wanted(obstacle.solid_owners[s as usize]))
                .map(|s| (s, Gap::default()))
                .collect(),
        }
    }

    /// Reports how deep the obstacle's surfaces reach into `solid`, and the solid's surface into the
    /// obstacle's solids. `memory` belongs to this pair, `travel` is the sum of both ways in the world;
    /// `obstacle_from_solid` is asked for only where something is near.
    pub fn visit(
        (way, memory): &mut (RelativeWay, Option<Self>),
        probe: &mut DepthProbe,
        solid: &ConvexPiece,
        obstacle: &Obstacle,
        obstacle_from_solid: impl Fn() -> Frame,
        travel: Travel,
        intrusions: &mut impl Intrusions,
    ) {
        if way.skips(travel) {
            return;
        }
        let frame = obstacle_from_solid();
        let length = way.follow(&solid.bounds, &frame);
        let near = match memory {
            Some(near) if length < near.complete_until => {
                if length < near.free_until || length - near.looked_at < SAME_PLACE_M {
                    way.skip(near.free_until.max(length), travel);
                    return;
                }
                near
            }
            _ => {
                let wanted = |owner| intrusions.wanted(owner);
                memory.insert(Self::gather(solid, obstacle, &frame, length, wanted))
            }
        };
        near.looked_at = length;
        near.surfaces_in(probe, solid, obstacle, &frame, length, intrusions);
        for (index, gap) in &mut near.solids {
            let owner = obstacle.solid_owners[*index as usize];
            let other = &obstacle.solids[*index as usize];
            let floor_m = intrusions.floor_m(owner);
            let found = surface_in_solid(probe, solid, other, &frame, length, gap, floor_m);
            if let Some(deepest) = found {
                intrusions.found(owner, deepest);
            }
        }
        near.update_free_until();
        way.skip(near.free_until.max(length), travel);
    }

    fn update_free_until(&mut self) {
        let triangles = self.triangles.iter().map(|t| t.free_until);
        let solids = self.solids.iter().map(|(_, gap)| gap.free_until);
        self.free_until = triangles.chain(solids).fold(self.complete_until, f64::min);
    }

    fn surfaces_in(
        &mut self,
        probe: &mut DepthProbe,
        solid: &ConvexPiece,
        obstacle: &Obstacle,
        obstacle_from_solid: &Frame,
        way: f64,
        intrusions: &mut impl Intrusions,
    ) {
        if self.triangles.iter().all(|t| way < t.free_until) {
            return;
        }
        let planes = moved_planes(&solid.planes, obstacle_from_solid);
        for near in self.triangles.iter_mut().filter(|t| way >= t.free_until) {
            let triangle = &obstacle.triangles[near.index as usize];
            let owner = obstacle.triangle_owners[near.index as usize];
            let gap = separation(triangle, &planes, &mut near.face);
            if gap > 0.0 {
                near.free_until = way + gap;
                continue;
            }
            let floor_m = intrusions.floor_m(owner);
            if gap < -floor_m
                && let Some(deepest) = probe.deepest(&planes, triangle, floor_m)
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
