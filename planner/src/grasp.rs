//! Grasps: antipodal sampling on the handle, or poses from a file, with a check that the gripper fits.

use std::collections::BTreeMap;

use akrobat_model::task::{ManipulatedObject, Task};
use akrobat_model::trajectory::Grasp;
use akrobat_model::{Pose, Robot};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::esdf::{Esdf, Triangles, collect_triangles};
use crate::kinematics::Frame;
use crate::spheres::{SphereModel, link_triangles, surface_samples};
use crate::world::{handle_center, handle_parts, handle_triangles, is_handle_part, outward};

/// Surface points tried on the handle, and approach directions tried around the closing axis.
const SURFACE_POINTS: usize = 500;
const DIRECTIONS: usize = 16;
/// How far beyond the middle of the pads the handle may lie, metres.
const DEPTHS_M: [f64; 3] = [0.0, -0.006, 0.006];
/// How far the pads reach along the approach direction from the tool's origin, metres.
const PAD_REACH_M: f64 = 0.008;
/// Largest angle between the pads and the surface: friction coefficient 0.5.
const FRICTION_ANGLE: f64 = 0.46;
/// Width kept free beyond the handle when the fingers are open, metres.
const OPENING_SPARE_M: f64 = 0.008;
/// Clearances of the hand, of the open fingers to the handle, and of the fingers to everything else, metres.
const HAND_CLEARANCE_M: f64 = 0.004;
const OPEN_CLEARANCE_M: f64 = 0.001;
const FINGER_CLEARANCE_M: f64 = 0.002;
/// Voxel of the fields around the handle, and their reach, metres.
const VOXEL_M: f64 = 0.005;
const REACH_M: f64 = 0.22;

/// Geometry around the handle, in the held link's frame, at the object's start.
struct Surroundings {
    handle: Esdf,
    others: Esdf,
}

/// A link that moves rigidly with the tool, sampled in its own frame.
struct GripperLink {
    link: usize,
    is_finger: bool,
    points: Vec<Vector3<f64>>,
    spheres: Vec<(Vector3<f64>, f64)>,
}

/// Points and spheres of the gripper in the tool frame.
#[derive(Default)]
struct GripperShape {
    hand_points: Vec<Vector3<f64>>,
    hand_spheres: Vec<(Vector3<f64>, f64)>,
    finger_points: Vec<Vector3<f64>>,
    finger_spheres: Vec<(Vector3<f64>, f64)>,
}

/// At most `count` grasps of a task, the best first: from its file, else sampled. Both are checked
/// against the gripper's shape. Returns the grasps and the number of candidates that were looked at.
pub fn grasps(task: &Task, spheres: &SphereModel, seed: u64, count: usize) -> (Vec<Grasp>, usize) {
    let candidates = candidates(task, seed);
    let around = Surroundings::build(task);
    let robot = &task.robot;
    let gripper = gripper_links(robot, spheres);
    let open = GripperShape::new(robot, &gripper, robot.file.gripper.open_width_m);
    let fits: Vec<Option<f64>> = candidates
        .par_iter()
        .map(|candidate| {
            around.misfit(robot, &gripper, &open, candidate).is_none().then_some(candidate.score)
        })
        .collect();
    let mut fitting: Vec<&Candidate> =
        candidates.iter().zip(&fits).filter(|(_, fit)| fit.is_some()).map(|(c, _)| c).collect();
    fitting.sort_by(|a, b| b.score.total_cmp(&a.score));
    let chosen = diverse(&fitting, count);
    let link = &task.object.tree.links()[task.object.handle_link].name;
    let grasps = chosen.iter().enumerate().map(|(id, candidate)| Grasp {
        id: id as u32,
        link: link.clone(),
        link_from_tool: candidate.link_from_tool,
        width_m: candidate.width_m,
    });
    (grasps.collect(), candidates.len())
}

/// What the candidates of a task that do not fit would touch, with how many of them.
pub fn misfits(task: &Task, spheres: &SphereModel, seed: u64) -> BTreeMap<String, u64> {
    let candidates = candidates(task, seed);
    let around = Surroundings::build(task);
    let robot = &task.robot;
    let gripper = gripper_links(robot, spheres);
    let open = GripperShape::new(robot, &gripper, robot.file.gripper.open_width_m);
    let found: Vec<Option<&'static str>> = candidates
        .par_iter()
        .map(|candidate| around.misfit(robot, &gripper, &open, candidate))
        .collect();
    let mut counts = BTreeMap::new();
    for misfit in found.into_iter().flatten() {
        *counts.entry(misfit.to_owned()).or_default() += 1;
    }
    counts
}

fn candidates(task: &Task, seed: u64) -> Vec<Candidate> {
    if task.grasp_poses.is_empty() {
        sample_antipodal(&task.object, task.robot.file.gripper.open_width_m, seed)
    } else {
        from_poses(task)
    }
}

#[derive(Debug, Clone)]
struct Candidate {
    link_from_tool: Pose,
    width_m: f64,
    score: f64,
}

/// Antipodal candidates (Nguyen, *Constructing force-closure grasps*, IJRR 1988): opposite surface points
/// within the friction cones, approached from all directions around the line between them.
fn sample_antipodal(object: &ManipulatedObject, open_width_m: f64, seed: u64) -> Vec<Candidate> {
    let triangles = handle_triangles(object);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Vec::new();
    let Some(areas) = cumulative_areas(&triangles) else { return out };
    let start = object.tree.link_poses(&object.world_from_root, &object.start);
    let world_from_link = Frame::from(&start[object.handle_link]);
    let center = world_from_link.inverse_transform(&handle_center(object));
    let out_direction = outward(object, &handle_center(object));
    let inward = -world_from_link.rotation.tr_mul(&out_direction);
    let points: Vec<_> =
        (0..SURFACE_POINTS).map(|_| random_surface_point(&triangles, &areas, &mut rng)).collect();
    let opposites: Vec<_> = points
        .par_iter()
        .map(|(point, normal)| opposite_point(&triangles, point, normal))
        .collect();
    for ((point, normal), opposite) in points.into_iter().zip(opposites) {
        let inside_region = object
            .handle_region
            .is_none_or(|r| (0..3).all(|i| point[i] >= r[i] && point[i] <= r[i + 3]));
        let Some((width, opposite)) = opposite else { continue };
        let aligned = opposite.dot(&normal).abs();
        if !inside_region
            || width > open_width_m - OPENING_SPARE_M
            || aligned < FRICTION_ANGLE.cos()
        {
            continue;
        }
        let middle = point - normal * (width / 2.0);
        for step in 0..DIRECTIONS {
            let angle = std::f64::consts::TAU * step as f64 / DIRECTIONS as f64;
            for depth in DEPTHS_M {
                let approach = perpendicular(&normal, angle);
                let pose = tool_pose(&(middle - approach * depth), &normal, &approach);
                let score = aligned + 0.7 * approach.dot(&inward)
                    - 2.0 * (middle - center).norm()
                    - 5.0 * depth.abs();
                out.push(Candidate { link_from_tool: pose, width_m: width, score });
            }
        }
    }
    out
}

fn from_poses(task: &Task) -> Vec<Candidate> {
    let triangles = handle_triangles(&task.object);
    let open = task.robot.file.gripper.open_width_m;
    let candidate = |(rank, pose): (usize, &Pose)| Candidate {
        link_from_tool: *pose,
        width_m: clamp_width(&triangles, pose, open),
        score: -(rank as f64),
    };
    task.grasp_poses.iter().enumerate().map(candidate).collect()
}

/// Free width between the pads once they first touch what is between them: the handle's largest width
/// along the pads, which reach [`PAD_REACH_M`] to both sides of the tool's origin.
fn clamp_width(triangles: &Triangles, link_from_tool: &Pose, open_width_m: f64) -> f64 {
    let (closing, approach) =
        (link_from_tool.rotation * Vector3::y(), link_from_tool.rotation * Vector3::z());
    let gap = |side: f64, along: f64| {
        let middle = link_from_tool.translation.vector + approach * along;
        let from = middle + closing * (side * open_width_m / 2.0);
        let nearest = ray_hits(triangles, &from, &(closing * -side)).map(|(t, _)| t);
        nearest.fold(open_width_m / 2.0, f64::min)
    };
    let steps = (-4..=4).map(|step| PAD_REACH_M * f64::from(step) / 4.0);
    let narrowest = steps.flat_map(|along| [gap(1.0, along), gap(-1.0, along)]);
    open_width_m - 2.0 * narrowest.fold(f64::INFINITY, f64::min)
}

impl Surroundings {
    fn build(task: &Task) -> Self {
        let object = &task.object;
        let start = object.tree.link_poses(&object.world_from_root, &object.start);
        let link_from_world = start[object.handle_link].inverse();
        let (mut handle, mut others) = (Triangles::new(), Triangles::new());
        for part in handle_parts(object) {
            collect_triangles(&part.triangulate(), &Pose::identity(), &mut handle);
        }
        for (index, link) in object.tree.links().iter().enumerate() {
            let parts = if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
            for part in parts {
                let is_handle = index == object.handle_link && is_handle_part(object, &part.name);
                if !is_handle {
                    let frame = link_from_world * start[index];
                    collect_triangles(&part.triangulate(), &frame, &mut others);
                }
            }
        }
        for body in &task.scene.bodies {
            for part in body.collision_parts() {
                let frame = link_from_world * body.world_from_body;
                collect_triangles(&part.triangulate(), &frame, &mut others);
            }
        }
        let world_center = handle_center(object);
        let center = (link_from_world * Point3::from(world_center)).coords;
        let grip = handle_triangles(object);
        let corners = || grip.iter().flatten();
        let low = corners().fold(center, |a, c| a.inf(c)) - Vector3::repeat(REACH_M);
        let high = corners().fold(center, |a, c| a.sup(c)) + Vector3::repeat(REACH_M);
        let out = link_from_world.rotation * outward(object, &world_center);
        let seeds = [0.1, 0.15, 0.2].map(|d| center + out * d);
        let near = |t: &[Vector3<f64>; 3]| {
            (0..3).all(|i| {
                t.iter().any(|c| c[i] > low[i] - 0.1) && t.iter().any(|c| c[i] < high[i] + 0.1)
            })
        };
        others.retain(near);
        handle.retain(near);
        Self {
            handle: Esdf::build(&handle, low, high, VOXEL_M, &seeds),
            others: if others.is_empty() {
                Esdf::empty(1.0)
            } else {
                Esdf::build(&others, low, high, VOXEL_M, &seeds)
            },
        }
    }

    /// What is not free: the hand or the open fingers at the grasp and on the way to it, or the closed
    /// fingers, which may touch nothing but the handle.
    fn misfit(
        &self,
        robot: &Robot,
        gripper: &[GripperLink],
        open: &GripperShape,
        candidate: &Candidate,
    ) -> Option<&'static str> {
        let tool = Frame::from(&candidate.link_from_tool);
        let approach = tool.rotation * Vector3::z();
        for back in [0.0, 0.015, 0.04, 0.08] {
            let at = Frame { translation: tool.translation - approach * back, ..tool };
            if !self.hand_is_free(open, &at) {
                return Some("the hand touches something");
            }
            if !self.open_fingers_are_free(open, &at) {
                return Some("the open fingers touch something");
            }
        }
        let closed = GripperShape::new(robot, gripper, candidate.width_m);
        let free = self.fingers_avoid_others(&closed, &tool);
        (!free).then_some("the closed fingers touch something besides the handle")
    }

    fn hand_is_free(&self, shape: &GripperShape, tool: &Frame) -> bool {
        let is_free = |p: &Vector3<f64>, least: f64| {
            let p = tool.transform(p);
            self.others.exceeds(&p, least) && self.handle.exceeds(&p, least)
        };
        shape.hand_points.iter().all(|p| is_free(p, HAND_CLEARANCE_M))
            && shape.hand_spheres.iter().all(|(c, r)| is_free(c, r + FINGER_CLEARANCE_M))
    }

    fn open_fingers_are_free(&self, shape: &GripperShape, tool: &Frame) -> bool {
        let off_handle =
            |p: &Vector3<f64>| self.handle.exceeds(&tool.transform(p), OPEN_CLEARANCE_M);
        shape.finger_points.iter().all(off_handle) && self.fingers_avoid_others(shape, tool)
    }

    fn fingers_avoid_others(&self, shape: &GripperShape, tool: &Frame) -> bool {
        let is_free = |p: &Vector3<f64>, least: f64| self.others.exceeds(&tool.transform(p), least);
        shape.finger_points.iter().all(|p| is_free(p, FINGER_CLEARANCE_M))
            && shape.finger_spheres.iter().all(|(c, r)| is_free(c, r + FINGER_CLEARANCE_M))
    }
}

/// Samples the links that are rigid with the tool.
fn gripper_links(robot: &Robot, spheres: &SphereModel) -> Vec<GripperLink> {
    let links = (0..robot.tree.links().len()).filter(|&link| rigid_with_tool(robot, link));
    links
        .map(|link| {
            let own = spheres.spheres.iter().filter(|s| s.link == link);
            GripperLink {
                link,
                is_finger: robot.finger_links.contains(&link),
                points: surface_samples(&link_triangles(&robot.tree.links()[link]), 0.006, 700),
                spheres: own.map(|s| (s.center.into(), s.radius)).collect(),
            }
        })
        .collect()
}

impl GripperShape {
    /// The gripper with this free width between the pads.
    fn new(robot: &Robot, gripper: &[GripperLink], width_m: f64) -> Self {
        let mut q = robot.rest.clone();
        for (&joint, position) in robot.gripper_joints.iter().zip(robot.finger_positions(width_m)) {
            if let Some(column) = robot.tree.column(joint) {
                q[column] = position;
            }
        }
        let poses = robot.tree.link_poses(&Pose::identity(), &q);
        let tool_from_world = (poses[robot.tool_link] * robot.link_from_tool).inverse();
        let mut shape = Self::default();
        for part in gripper {
            let tool_from_link = Frame::from(&(tool_from_world * poses[part.link]));
            let points = part.points.iter().map(|p| tool_from_link.transform(p));
            let spheres = part.spheres.iter().map(|(c, r)| (tool_from_link.transform(c), *r));
            if part.is_finger {
                shape.finger_points.extend(points);
                shape.finger_spheres.extend(spheres);
            } else {
                shape.hand_points.extend(points);
                shape.hand_spheres.extend(spheres);
            }
        }
        shape
    }
}

/// True for links that no arm joint separates from the tool (the fingers included).
fn rigid_with_tool(robot: &Robot, link: usize) -> bool {
    let arm_joints = |l: usize| -> Vec<usize> {
        let chain = robot.tree.chain_to(l);
        chain
            .into_iter()
            .filter(|j| robot.arm_joints.contains(j) || robot.base_joints.contains(j))
            .collect()
    };
    arm_joints(link) == arm_joints(robot.tool_link)
}

/// Picks `count` candidates: the best, then always the one farthest from those picked (5 cm count as
/// much as 0.5 rad).
fn diverse<'a>(candidates: &[&'a Candidate], count: usize) -> Vec<&'a Candidate> {
    let Some(first) = candidates.first() else { return Vec::new() };
    let pool = candidates;
    // The smaller of `gap` and the distance of two candidates, whose angle is worked out only where it matters.
    let nearer = |gap: f64, a: &Candidate, b: &Candidate| {
        let t = a.link_from_tool.translation.vector - b.link_from_tool.translation.vector;
        let shift = t.norm() / 0.05;
        if shift >= gap {
            return gap;
        }
        let r = a.link_from_tool.rotation.angle_to(&b.link_from_tool.rotation);
        gap.min(shift.hypot(r / 0.5))
    };
    let mut gaps: Vec<f64> = pool.iter().map(|c| nearer(f64::INFINITY, c, first)).collect();
    let mut chosen = vec![*first];
    while chosen.len() < count {
        let Some(next) = (0..pool.len()).max_by(|&a, &b| gaps[a].total_cmp(&gaps[b])) else {
            break;
        };
        if gaps[next] < 0.05 {
            break;
        }
        chosen.push(pool[next]);
        for (gap, candidate) in gaps.iter_mut().zip(pool) {
            *gap = nearer(*gap, candidate, pool[next]);
        }
    }
    chosen
}

/// Tool pose with y along `closing` and z along `approach` (unit, perpendicular).
fn tool_pose(origin: &Vector3<f64>, closing: &Vector3<f64>, approach: &Vector3<f64>) -> Pose {
    let rotation = Matrix3::from_columns(&[closing.cross(approach), *closing, *approach]);
    Pose::from_parts(
        Translation3::from(*origin),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)),
    )
}

/// A unit vector perpendicular to `axis`, turned by `angle` about it.
fn perpendicular(axis: &Vector3<f64>, angle: f64) -> Vector3<f64> {
    let helper = if axis.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
    let u = axis.cross(&helper).normalize();
    u * angle.cos() + axis.cross(&u) * angle.sin()
}

fn cumulative_areas(triangles: &Triangles) -> Option<Vec<f64>> {
    let mut sum = 0.0;
    let areas: Vec<f64> = triangles
        .iter()
        .map(|[a, b, c]| {
            sum += (b - a).cross(&(c - a)).norm() / 2.0;
            sum
        })
        .collect();
    (sum > 0.0).then_some(areas)
}

fn random_surface_point(
    triangles: &Triangles,
    areas: &[f64],
    rng: &mut ChaCha8Rng,
) -> (Vector3<f64>, Vector3<f64>) {
    let total = areas.last().copied().unwrap_or(0.0);
    let pick = rng.random_range(0.0..total);
    let [a, b, c] = &triangles[areas.partition_point(|&s| s <= pick).min(areas.len() - 1)];
    let (mut u, mut v) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
    if u + v > 1.0 {
        (u, v) = (1.0 - u, 1.0 - v);
    }
    let normal = (b - a).cross(&(c - a)).try_normalize(1e-12).unwrap_or_else(Vector3::z);
    (a + (b - a) * u + (c - a) * v, normal)
}

/// Where the ray into the surface leaves the handle: the distance and that surface's normal.
fn opposite_point(
    triangles: &Triangles,
    point: &Vector3<f64>,
    normal: &Vector3<f64>,
) -> Option<(f64, Vector3<f64>)> {
    ray_hits(triangles, point, &-normal)
        .filter(|(t, _)| *t > 0.0015)
        .min_by(|(a, _), (b, _)| a.total_cmp(b))
}

/// Crossings of a ray with triangles, with unit normals (Möller and Trumbore, 1997).
fn ray_hits<'a>(
    triangles: &'a Triangles,
    from: &Vector3<f64>,
    direction: &Vector3<f64>,
) -> impl Iterator<Item = (f64, Vector3<f64>)> + 'a {
    let (from, direction) = (*from, *direction);
    triangles.iter().filter_map(move |[a, b, c]| {
        let (e1, e2) = (b - a, c - a);
        let p = direction.cross(&e2);
        let determinant = e1.dot(&p);
        if determinant.abs() < 1e-14 {
            return None;
        }
        let s = from - a;
        let u = s.dot(&p) / determinant;
        let q = s.cross(&e1);
        let v = direction.dot(&q) / determinant;
        let t = e2.dot(&q) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0)
            .then(|| Some((t, e1.cross(&e2).try_normalize(1e-14)?)))
            .flatten()
    })
}
