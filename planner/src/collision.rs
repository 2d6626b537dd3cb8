//! Clearance of a robot's spheres: to the world, to the moving object and to each other.

use std::cell::RefCell;

use akrobat_model::Robot;
use nalgebra::{SMatrix, SVector, Vector3};
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use crate::kernels::validity::Validity;
use crate::kinematics::{Frame, Kinematics, MAX_VARIABLES, NodeFrames, Variables};
use crate::spheres::{Sphere, SphereModel};
use crate::world::World;

/// A sphere that hangs from a node.
#[derive(Debug, Clone, Copy)]
pub struct NodeSphere {
    /// The node.
    pub node: usize,
    /// Centre in the node's frame.
    pub center: Vector3<f64>,
    /// Radius.
    pub radius: f64,
    /// Link, for reports and pair masks.
    pub link: usize,
    /// Moves with the base only: stands on the floor.
    pub on_base: bool,
    /// Does not move: only the robot's other links and the object can touch it.
    pub rests: bool,
    /// Moves rigidly with the tool.
    pub on_tool: bool,
}

/// Pairs of robot links that can collide.
pub type LinkPairs = Vec<(usize, usize)>;

/// Number of random configurations that decide which pairs always touch.
const MASK_SAMPLES: usize = 300;

/// Finds the link pairs that must be checked: neither adjacent (through links without geometry and
/// fixed joints), nor listed in the robot file, nor touching at rest or in nearly all configurations.
pub fn self_collision_pairs(robot: &Robot, model: &SphereModel) -> LinkPairs {
    let variables = [&robot.base_joints[..], &robot.arm_joints].concat();
    let kinematics =
        Kinematics::compile(&robot.tree, &robot.world_from_root, &variables, &robot.rest);
    let mut pairs = pairs_to_compare(robot, model, &kinematics);
    let body = RobotBody::new(robot, model, &pairs, &kinematics);
    let hits: Vec<Vec<bool>> = mask_samples(robot, &kinematics, &variables)
        .par_iter()
        .map(|x| body.touching(x, &kinematics))
        .collect();
    let hits: Vec<usize> = (0..pairs.len())
        .map(|pair| {
            // What touches at rest always touches.
            let at_rest = if hits[0][pair] { MASK_SAMPLES } else { 0 };
            at_rest + hits.iter().filter(|hit| hit[pair]).count()
        })
        .collect();
    let always = MASK_SAMPLES * 9 / 10;
    let mut keep = hits.iter().map(|&h| h < always);
    pairs.retain(|_| keep.next().unwrap_or(true));
    pairs
}

/// The link pairs that could be compared: neither adjacent (through links without geometry and fixed
/// joints) nor listed in the robot file. Some of them may always touch.
pub fn comparable_pairs(robot: &Robot, model: &SphereModel) -> LinkPairs {
    let variables = [&robot.base_joints[..], &robot.arm_joints].concat();
    let kinematics =
        Kinematics::compile(&robot.tree, &robot.world_from_root, &variables, &robot.rest);
    pairs_to_compare(robot, model, &kinematics)
}

fn pairs_to_compare(robot: &Robot, model: &SphereModel, kinematics: &Kinematics) -> LinkPairs {
    let by_link = |link: usize| model.spheres.iter().filter(move |s| s.link == link);
    let links: Vec<usize> =
        (0..robot.tree.links().len()).filter(|&l| by_link(l).next().is_some()).collect();
    let name = |link: usize| robot.tree.links()[link].name.as_str();
    let listed = |a: usize, b: usize| {
        let ignored = robot.file.self_collision_ignore.iter();
        ignored
            .chain(&robot.file.spheres.overstated)
            .any(|[x, y]| (x == name(a) && y == name(b)) || (x == name(b) && y == name(a)))
    };
    let mut pairs: LinkPairs = Vec::new();
    for (i, &a) in links.iter().enumerate() {
        for &b in &links[i + 1..] {
            let node = |l: usize| kinematics.attachment(l).node;
            let related = node(a) == node(b) || are_neighbours(robot, kinematics, a, b);
            if !related && !listed(a, b) {
                pairs.push((a, b));
            }
        }
    }
    pairs
}

/// The rest configuration, and random ones.
fn mask_samples(robot: &Robot, kinematics: &Kinematics, variables: &[usize]) -> Vec<Vec<f64>> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(0);
    let rest = variables.iter().map(|&j| robot.tree.joint_position(j, &robot.rest)).collect();
    let random = |_| {
        let limits = kinematics.lower().iter().zip(kinematics.upper());
        limits.map(|(low, high)| rng.random_range(low.max(-3.2)..=high.min(3.2))).collect()
    };
    std::iter::once(rest).chain((1..MASK_SAMPLES).map(random)).collect()
}

/// True where one variable at most lies between two links.
fn are_neighbours(robot: &Robot, kinematics: &Kinematics, a: usize, b: usize) -> bool {
    let moved_by = |l: usize| kinematics.attachment(l).node.map_or(0, |n| kinematics.moved_by(n));
    let fingers = |l: usize| robot.finger_links.contains(&l);
    (moved_by(a) ^ moved_by(b)).count_ones() <= 1 || (fingers(a) && fingers(b))
}

/// Spheres and pairs, placed on one compiled tree.
#[derive(Debug, Clone)]
pub struct RobotBody {
    /// All spheres, sorted by node.
    pub spheres: Vec<NodeSphere>,
    /// Index pairs of spheres of links that can collide, grouped by link pair.
    groups: Vec<PairGroup>,
    /// Bounding sphere of each link's spheres in its node's frame.
    bounds: Vec<LinkBound>,
}

#[derive(Debug, Clone)]
struct LinkBound {
    node: usize,
    rests: bool,
    center: Vector3<f64>,
    radius: f64,
    first: usize,
    last: usize,
}

#[derive(Debug, Clone, Copy)]
struct PairGroup {
    a: usize,
    b: usize,
}

/// Which fields a link may touch, and whether it may touch anything.
#[derive(Debug, Clone, Copy)]
struct Near {
    fixed: bool,
    moving: bool,
    any: bool,
}

impl Near {
    /// The spheres of a link that must be looked at.
    fn spheres(self, bound: &LinkBound) -> std::ops::Range<usize> {
        if self.any { bound.first..bound.last } else { 0..0 }
    }
}

thread_local! {
    /// Where this thread places links and spheres, so that a check asks for no memory.
    static PLACED: RefCell<Placed> = RefCell::default();
}

/// Links and spheres in the world.
#[derive(Default)]
struct Placed {
    /// Centre of each link's bounding sphere.
    bound_centers: Vec<Vector3<f64>>,
    /// What each link may touch.
    near: Vec<Near>,
    /// Checked pairs of links that may touch.
    pairs: Vec<PairGroup>,
    /// Centres of the spheres of links that may touch anything; of others, whatever they were.
    centers: Vec<Vector3<f64>>,
}

/// Distance beyond which clearances are not told apart, metres.
pub(crate) const FAR_M: f64 = 0.02;
/// The same for the robot's own links, metres.
pub(crate) const PAIR_FAR_M: f64 = 0.05;

/// What is closest to a collision.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clearance {
    /// Smallest distance, metres; negative in collision.
    pub distance_m: f64,
    /// Link whose sphere it is.
    pub link: usize,
    /// What it is close to.
    pub to: Obstacle,
}

/// Something a sphere can touch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Obstacle {
    /// Nothing near.
    Nothing,
    /// The resting world.
    Fixed,
    /// The object's moved links.
    Moving,
    /// The floor.
    Floor,
    /// Another link of the robot.
    Link(usize),
}

/// Which spheres are compared with the object's moved links.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MovingCheck {
    /// All: the object is not held.
    All,
    /// All but those rigid with the tool, whose place on the handle the grasp has settled.
    NotTool,
}

/// Weighted Gauss-Newton terms of a hinge cost: value, gradient and Hessian approximation.
#[derive(Debug, Clone)]
pub struct Penalty {
    /// Sum of squared hinges.
    pub cost: f64,
    /// Largest hinge.
    pub largest: f64,
    /// Gradient / 2.
    pub gradient: SVector<f64, MAX_VARIABLES>,
    /// Hessian / 2.
    pub hessian: SMatrix<f64, MAX_VARIABLES, MAX_VARIABLES>,
}

impl Penalty {
    /// Zero.
    pub fn zero() -> Self {
        Self { cost: 0.0, largest: 0.0, gradient: SVector::zeros(), hessian: SMatrix::zeros() }
    }

    /// Adds `hinge^2` where the residual's derivative is `row`.
    pub fn add(&mut self, hinge: f64, row: &SVector<f64, MAX_VARIABLES>) {
        self.cost += hinge * hinge;
        self.largest = self.largest.max(hinge);
        self.gradient += row * hinge;
        for (column, &by) in row.iter().enumerate().filter(|(_, by)| **by != 0.0) {
            self.hessian.column_mut(column).axpy(by, row, 1.0);
        }
    }
}

impl RobotBody {
    /// Places the spheres on `kinematics` (compiled from the robot's tree, or a tree whose first links
    /// are the robot's).
    pub fn new(
        robot: &Robot,
        model: &SphereModel,
        pairs: &LinkPairs,
        kinematics: &Kinematics,
    ) -> Self {
        let tool_node = kinematics.attachment(robot.tool_link).node;
        let base_node = robot.base_joints.len().checked_sub(1);
        let mut spheres: Vec<NodeSphere> = Vec::new();
        let mut bounds: Vec<(usize, LinkBound)> = Vec::new();
        for link in 0..robot.tree.links().len() {
            let attachment = kinematics.attachment(link);
            let node = attachment.node.unwrap_or(kinematics.world_node());
            let first = spheres.len();
            for sphere in model.spheres.iter().filter(|s| s.link == link) {
                let center = nalgebra::Point3::from(Vector3::from(sphere.center));
                spheres.push(NodeSphere {
                    node,
                    center: (attachment.node_from_link * center).coords,
                    radius: sphere.radius,
                    link,
                    on_base: base_node == Some(node),
                    rests: attachment.node.is_none(),
                    on_tool: tool_node == Some(node),
                });
            }
            if spheres.len() > first {
                bounds.push((link, bound(&spheres, first, node)));
            }
        }
        let position = |link: usize| bounds.iter().position(|(l, _)| *l == link);
        let groups = pairs
            .iter()
            .filter_map(|&(a, b)| Some(PairGroup { a: position(a)?, b: position(b)? }))
            .collect();
        Self { spheres, groups, bounds: bounds.into_iter().map(|(_, b)| b).collect() }
    }

    /// Each moving link's node, its bounding sphere in the node's frame (centre and radius, metres), and its spheres.
    pub(crate) fn moving_links(
        &self,
    ) -> impl Iterator<Item = (usize, Vector3<f64>, f64, std::ops::Range<usize>)> + '_ {
        let moving = self.bounds.iter().filter(|b| !b.rests);
        moving.map(|b| (b.node, b.center, b.radius, b.first..b.last))
    }

    /// Pairs of [`Self::moving_links`] that can collide.
    pub(crate) fn moving_pairs(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let number = |bound: usize| self.bounds[..bound].iter().filter(|b| !b.rests).count();
        let moving = |group: &&PairGroup| [group.a, group.b].iter().all(|&i| !self.bounds[i].rests);
        self.groups.iter().filter(moving).map(move |group| (number(group.a), number(group.b)))
    }

    /// For each checked pair of links, whether their spheres overlap.
    fn touching(&self, x: &Variables, kinematics: &Kinematics) -> Vec<bool> {
        let frames = kinematics.forward(x);
        let centers = self.centers(&frames);
        let overlap = |group: &PairGroup| {
            let (a, b) = (&self.bounds[group.a], &self.bounds[group.b]);
            let place = |bound: &LinkBound| frames.frames[bound.node].transform(&bound.center);
            (place(a) - place(b)).norm() < a.radius + b.radius
                && (a.first..a.last).any(|i| {
                    (b.first..b.last).any(|j| {
                        let sum = self.spheres[i].radius + self.spheres[j].radius;
                        (centers[i] - centers[j]).norm_squared() < sum * sum
                    })
                })
        };
        self.groups.iter().map(overlap).collect()
    }

    /// The same spheres and link pairs, compiled for searches in free space that keep `margin_m`.
    pub fn validity(&self, kinematics: &Kinematics, margin_m: f64) -> Validity {
        let in_link = |s: &NodeSphere| {
            let node_from_link = Frame::from(&kinematics.attachment(s.link).node_from_link);
            let center = node_from_link.inverse_transform(&s.center).into();
            Sphere { link: s.link, center, radius: s.radius }
        };
        let spheres: Vec<Sphere> = self.spheres.iter().map(in_link).collect();
        let link = |group: usize| self.spheres[self.bounds[group].first].link;
        let pairs: LinkPairs = self.groups.iter().map(|g| (link(g.a), link(g.b))).collect();
        let on_base = self.spheres.iter().find(|s| s.on_base);
        let base_joints = on_base.map_or(0, |s| s.node + 1);
        Validity::new(kinematics, &spheres, &pairs, base_joints, margin_m)
    }

    /// World centres of all spheres.
    pub fn centers(&self, frames: &NodeFrames) -> Vec<Vector3<f64>> {
        self.spheres.iter().map(|s| frames.frames[s.node].transform(&s.center)).collect()
    }

    /// True where every sphere that moves with the base alone keeps `least` metres from the resting world.
    pub fn base_is_free(&self, frames: &NodeFrames, world: &World, least: f64) -> bool {
        self.spheres.iter().filter(|s| s.on_base).all(|s| {
            let center = frames.frames[s.node].transform(&s.center);
            world.fixed.exceeds(&center, s.radius + least)
        })
    }

    /// Smallest clearance at a configuration, with the object's driven joint at `object_q`; obstacles farther
    /// than [`FAR_M`] and link pairs farther apart than 5 cm may be left out. Stops early once something is closer than `enough`.
    pub fn clearance(
        &self,
        frames: &NodeFrames,
        world: &World,
        object_q: f64,
        moving: MovingCheck,
        enough: f64,
    ) -> Clearance {
        let mut worst = Clearance { distance_m: f64::INFINITY, link: 0, to: Obstacle::Nothing };
        let mut note = |distance_m: f64, link: usize, to: Obstacle| {
            if distance_m < worst.distance_m {
                worst = Clearance { distance_m, link, to };
            }
            worst.distance_m < enough
        };
        let world_from_moved = world.joint.world_from_moved(object_q);
        let far = enough.max(FAR_M);
        let pair_far = enough.max(PAIR_FAR_M);
        PLACED.with_borrow_mut(|scene| {
            self.place(frames, world, &world_from_moved, far, pair_far, scene);
            // Nothing more is looked at once something is too close.
            let _ = self.distances(scene, world, &world_from_moved, moving, far, &mut note)
                || self.near_pairs(scene, pair_far, |a, b, distance| {
                    note(distance, self.spheres[a].link, Obstacle::Link(self.spheres[b].link))
                });
        });
        worst
    }

    /// Tells `note` the distances of spheres to fields and floor until it says that they are enough; true where it did.
    fn distances(
        &self,
        scene: &Placed,
        world: &World,
        world_from_moved: &Frame,
        moving: MovingCheck,
        far: f64,
        note: &mut impl FnMut(f64, usize, Obstacle) -> bool,
    ) -> bool {
        for (bound, near) in self.bounds.iter().zip(&scene.near) {
            for index in near.spheres(bound) {
                let (sphere, center) = (&self.spheres[index], &scene.centers[index]);
                let reach = sphere.radius + far;
                let fixed = || world.fixed.distance(center) - sphere.radius;
                if near.fixed
                    && !world.fixed.is_beyond(center, reach)
                    && note(fixed(), sphere.link, Obstacle::Fixed)
                {
                    return true;
                }
                let floor = center.z - sphere.radius - world.floor_z;
                if !sphere.on_base && !sphere.rests && note(floor, sphere.link, Obstacle::Floor) {
                    return true;
                }
                if near.moving && (moving == MovingCheck::All || !sphere.on_tool) {
                    let local = world_from_moved.inverse_transform(center);
                    if world.moving.is_beyond(&local, reach) {
                        continue;
                    }
                    let distance = world.moving.distance(&local) - sphere.radius;
                    if note(distance, sphere.link, Obstacle::Moving) {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Places the bounding spheres of all links, and the spheres of those that come within `reach` of a field or
    /// the floor, or within `pair_reach` of another link. Distances are 1-Lipschitz; a voxel's diagonal is left for their
    /// interpolation.
    fn place(
        &self,
        frames: &NodeFrames,
        world: &World,
        world_from_moved: &Frame,
        reach: f64,
        pair_reach: f64,
        placed: &mut Placed,
    ) {
        let Placed { bound_centers, near, pairs, centers } = placed;
        bound_centers.clear();
        bound_centers
            .extend(self.bounds.iter().map(|b| frames.frames[b.node].transform(&b.center)));
        near.clear();
        near.extend(self.bounds.iter().zip(&*bound_centers).map(|(bound, center)| {
            let least = bound.radius + reach;
            let local = world_from_moved.inverse_transform(center);
            let fixed = !bound.rests && !world.fixed.is_beyond(center, least);
            let moving = !world.moving.is_beyond(&local, least);
            let floor = !bound.rests && center.z - world.floor_z < least;
            Near { fixed, moving, any: fixed || moving || floor }
        }));
        pairs.clear();
        for group in &self.groups {
            let (a, b) = (&self.bounds[group.a], &self.bounds[group.b]);
            let apart = bound_centers[group.a] - bound_centers[group.b];
            let least = a.radius + b.radius + pair_reach;
            if apart.norm_squared() < least * least {
                (near[group.a].any, near[group.b].any) = (true, true);
                pairs.push(*group);
            }
        }
        // Those that are not near keep what they were, and nobody looks at them.
        centers.resize(self.spheres.len(), Vector3::zeros());
        for (bound, near) in self.bounds.iter().zip(&*near) {
            for index in near.spheres(bound) {
                centers[index] = frames.frames[bound.node].transform(&self.spheres[index].center);
            }
        }
    }

    /// Tells `each` the sphere pairs of near link pairs whose distance is below `reach`, until it returns true; true where
    /// it did.
    fn near_pairs(
        &self,
        scene: &Placed,
        reach: f64,
        mut each: impl FnMut(usize, usize, f64) -> bool,
    ) -> bool {
        for group in &scene.pairs {
            let (a, b) = (&self.bounds[group.a], &self.bounds[group.b]);
            let around_b = &scene.bound_centers[group.b];
            for i in a.first..a.last {
                let (center, radius) = (&scene.centers[i], self.spheres[i].radius);
                let least = radius + b.radius + reach;
                if (center - around_b).norm_squared() > least * least {
                    continue;
                }
                for j in b.first..b.last {
                    let sum = radius + self.spheres[j].radius;
                    let squared = (center - scene.centers[j]).norm_squared();
                    if squared < (sum + reach) * (sum + reach) && each(i, j, squared.sqrt() - sum) {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Hinge penalties of every clearance below `margin`: `sum (margin - d)^2`, over the variables of
    /// `kinematics`, whose variable `object_variable` is the driven joint.
    #[allow(clippy::too_many_arguments)] // every one is a different thing; a struct would only rename them
    pub fn penalty(
        &self,
        kinematics: &Kinematics,
        frames: &NodeFrames,
        world: &World,
        x: &Variables,
        object_variable: usize,
        margin: f64,
        out: &mut Penalty,
    ) {
        let world_from_moved = world.joint.world_from_moved(x[object_variable]);
        PLACED.with_borrow_mut(|scene| {
            self.place(frames, world, &world_from_moved, margin, margin, scene);
            self.add_penalties(
                kinematics,
                frames,
                world,
                (&world_from_moved, object_variable),
                margin,
                scene,
                out,
            );
        });
    }

    #[allow(clippy::too_many_arguments)] // as above
    fn add_penalties(
        &self,
        kinematics: &Kinematics,
        frames: &NodeFrames,
        world: &World,
        (world_from_moved, object_variable): (&Frame, usize),
        margin: f64,
        scene: &Placed,
        out: &mut Penalty,
    ) {
        let centers = &scene.centers;
        for (bound, near) in self.bounds.iter().zip(&scene.near) {
            for index in near.spheres(bound) {
                let (sphere, center) = (&self.spheres[index], &centers[index]);
                let reach = sphere.radius + margin;
                let mut add = |hinge: f64, gradient: &Vector3<f64>, by_object: f64| {
                    let mut row = SVector::zeros();
                    kinematics.add_point_gradient(
                        frames,
                        sphere.node,
                        center,
                        &-gradient,
                        &mut row,
                    );
                    row[object_variable] += by_object;
                    out.add(hinge, &row);
                };
                if near.fixed && !world.fixed.is_beyond(center, reach) {
                    let (distance, gradient) = world.fixed.distance_and_gradient(center);
                    if distance < reach {
                        add(reach - distance, &gradient, 0.0);
                    }
                }
                if !sphere.on_base && !sphere.rests && center.z - world.floor_z < reach {
                    add(reach - (center.z - world.floor_z), &Vector3::z(), 0.0);
                }
                if near.moving && !sphere.on_tool {
                    let local = world_from_moved.inverse_transform(center);
                    if world.moving.is_beyond(&local, reach) {
                        continue;
                    }
                    let (distance, gradient) = world.moving.distance_and_gradient(&local);
                    if distance < reach {
                        let gradient = world_from_moved.rotation * gradient;
                        let by_object = gradient.dot(&world.joint.point_velocity(center));
                        add(reach - distance, &gradient, by_object);
                    }
                }
            }
        }
        self.near_pairs(scene, margin, |a, b, distance| {
            let Some(direction) = (centers[a] - centers[b]).try_normalize(1e-9) else {
                return false;
            };
            let mut row = SVector::zeros();
            let (sa, sb) = (&self.spheres[a], &self.spheres[b]);
            kinematics.add_point_gradient(frames, sa.node, &centers[a], &-direction, &mut row);
            kinematics.add_point_gradient(frames, sb.node, &centers[b], &direction, &mut row);
            out.add(margin - distance, &row);
            false
        });
    }
}

fn bound(spheres: &[NodeSphere], first: usize, node: usize) -> LinkBound {
    let own = &spheres[first..];
    let center = own.iter().map(|s| s.center).sum::<Vector3<f64>>() / own.len().max(1) as f64;
    let radius = own.iter().map(|s| (s.center - center).norm() + s.radius).fold(0.0, f64::max);
    let rests = own.iter().all(|s| s.rests);
    LinkBound { node, rests, center, radius, first, last: spheres.len() }
}
