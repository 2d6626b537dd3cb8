//! Penalties against finite differences, clearances against exact distances, link pairs.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use std::sync::{Arc, OnceLock};

use akrobat_model::Pose;
use akrobat_model::task::Task;
use akrobat_planner::closure::Closure;
use akrobat_planner::collision::{MovingCheck, Obstacle, Penalty, RobotBody};
use akrobat_planner::esdf::{Esdf, Triangles, collect_triangles};
use akrobat_planner::ik::SeedRegion;
use akrobat_planner::kinematics::{Frame, Kinematics};
use akrobat_planner::trajopt::Problem;
use akrobat_planner::world::{World, handle_center, moved_links, outward};
use akrobat_planner::{PlannerConfig, Preparation, akr};
use common::{distance_to_soup, grasp_at, numbers};
use nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Step of central differences, rad or m: short beside a voxel.
const STEP: f64 = 1e-7;
const VOXEL_M: f64 = 0.03;
/// Outside a field's grid, only this much distance is known, metres.
const FIELD_REACH_M: f64 = 0.15;
/// Sphere pairs further apart than this are not reported, metres.
const PAIR_REACH_M: f64 = 0.05;

/// Summit-Franka at a chest of drawers.
struct Bench {
    task: Task,
    preparation: Preparation,
    world: World,
    kinematics: Kinematics,
    body: RobotBody,
}

fn bench() -> Option<&'static Bench> {
    static BENCH: OnceLock<Option<Bench>> = OnceLock::new();
    let build = || {
        let task = common::task("summit_drawer_empty")?;
        let preparation = Preparation::new(&task).unwrap();
        let config = PlannerConfig {
            voxel_size_m: VOXEL_M,
            workspace_m: [4.0, 4.0, 4.0],
            ..PlannerConfig::default()
        };
        let world = World::build(&task, &config);
        let grasp = grasp_at(&task.object, Pose::identity());
        let akr = akr::assemble(&task.robot, &task.object, &grasp).unwrap();
        let root = &task.robot.world_from_root;
        let kinematics = Kinematics::compile(&akr.tree, root, &akr.variables, &akr.rest);
        let (spheres, pairs) = (&preparation.spheres, &preparation.self_pairs);
        let body = RobotBody::new(&task.robot, spheres, pairs, &kinematics);
        Some(Bench { task, preparation, world, kinematics, body })
    };
    BENCH.get_or_init(build).as_ref()
}

impl Bench {
    /// The robot in front of the object, the arm anywhere, the drawer anywhere.
    fn sample(&self, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let handle = handle_center(&self.task.object);
        let region = SeedRegion {
            base: 3,
            mount: [0.2, 0.0],
            outward: outward(&self.task.object, &handle),
            distance_m: [0.4, 0.9],
            half_angle: 0.8,
        };
        let target = Frame { translation: handle, ..Frame::identity() };
        let mut x = region.sample(&self.kinematics, &target, rng);
        x[10] = rng.random_range(0.0..0.38);
        x
    }

    fn without_pairs(&self) -> RobotBody {
        let spheres = &self.preparation.spheres;
        RobotBody::new(&self.task.robot, spheres, &Vec::new(), &self.kinematics)
    }

    /// A world of which all but one thing was taken away.
    fn only(&self, fixed: bool, moving: bool, floor: bool) -> World {
        let mut world = self.world.clone();
        if !fixed {
            world.fixed = Arc::new(Esdf::empty(1.0));
        }
        if !moving {
            world.moving = Arc::new(Esdf::empty(1.0));
        }
        if !floor {
            world.floor_z = -10.0;
        }
        world
    }

    fn penalty(&self, body: &RobotBody, world: &World, x: &[f64], margin: f64) -> Penalty {
        let mut out = Penalty::zero();
        let frames = self.kinematics.forward(x);
        body.penalty(&self.kinematics, &frames, world, x, 10, margin, &mut out);
        out
    }

    /// Compares gradients with central differences; gives the largest gradient component of each variable.
    fn check_gradient(&self, body: &RobotBody, world: &World, margin: f64, seed: u64) -> Vec<f64> {
        let mut rng = numbers(seed);
        let mut largest = vec![0.0f64; 11];
        let mut before: Option<Penalty> = None;
        let mut told_apart = 0;
        for _ in 0..30 {
            let x = self.sample(&mut rng);
            let penalty = self.penalty(body, world, &x, margin);
            for i in 0..11 {
                let cost = |by: f64| {
                    let mut x = x.clone();
                    x[i] += by;
                    self.penalty(body, world, &x, margin).cost
                };
                let expected = (cost(STEP) - cost(-STEP)) / (4.0 * STEP);
                let tolerance = 1e-4 * (1.0 + penalty.gradient.amax());
                let gap = (penalty.gradient[i] - expected).abs();
                assert!(gap < tolerance, "variable {i}: {} {expected}", penalty.gradient[i]);
                largest[i] = largest[i].max(expected.abs());
                // Negative control: the gradient elsewhere is another one.
                let other = before.as_ref().map_or(expected, |p| p.gradient[i]);
                told_apart += usize::from((other - expected).abs() > tolerance);
            }
            assert!(penalty.cost >= penalty.largest * penalty.largest);
            before = Some(penalty);
        }
        assert!(told_apart > 20, "only {told_apart} components differ between configurations");
        largest
    }
}

#[test]
fn gradient_of_the_resting_world() {
    let Some(bench) = bench() else { return };
    let (body, world) = (bench.without_pairs(), bench.only(true, false, false));
    let largest = bench.check_gradient(&body, &world, 0.15, 1);
    assert!(largest[..9].iter().all(|g| *g > 1e-3), "{largest:?}");
    assert_eq!(largest[10], 0.0);
}

#[test]
fn gradient_of_the_moving_part() {
    let Some(bench) = bench() else { return };
    let (body, world) = (bench.without_pairs(), bench.only(false, true, false));
    let largest = bench.check_gradient(&body, &world, 0.08, 2);
    assert!(largest[10] > 1e-3, "the object's joint counts: {largest:?}");
    assert!(largest[..3].iter().all(|g| *g > 1e-3), "{largest:?}");
}

#[test]
fn gradient_of_the_floor() {
    let Some(bench) = bench() else { return };
    let (body, world) = (bench.without_pairs(), bench.only(false, false, true));
    let largest = bench.check_gradient(&body, &world, 0.4, 3);
    // The base cannot get off the floor.
    assert!(largest[..3].iter().all(|g| *g < 1e-6), "{largest:?}");
    assert!(largest[4..8].iter().all(|g| *g > 1e-3), "{largest:?}");
}

#[test]
fn gradient_of_pairs_of_links() {
    let Some(bench) = bench() else { return };
    let world = bench.only(false, false, false);
    let largest = bench.check_gradient(&bench.body, &world, 0.08, 4);
    assert!(largest[..3].iter().chain(&largest[10..]).all(|g| *g < 1e-6), "{largest:?}");
    assert!(largest[4..8].iter().all(|g| *g > 1e-3), "{largest:?}");
    // Without pairs nothing is left.
    let mut rng = numbers(4);
    let x = bench.sample(&mut rng);
    assert_eq!(bench.penalty(&bench.without_pairs(), &world, &x, 0.08).cost, 0.0);
}

/// Exact clearance by brute force, from the model's trees and triangles.
struct BruteForce<'a> {
    bench: &'a Bench,
    resting: Triangles,
    moved: Vec<bool>,
}

impl<'a> BruteForce<'a> {
    fn new(bench: &'a Bench) -> Self {
        let (task, object) = (&bench.task, &bench.task.object);
        let moved = moved_links(object);
        let mut resting = Triangles::new();
        for body in task.scene.bodies.iter().filter(|b| b.class != "floor" && b.class != "ground") {
            for part in body.collision_parts() {
                collect_triangles(&part.triangulate(), &body.world_from_body, &mut resting);
            }
        }
        let mut this = Self { bench, resting: Triangles::new(), moved };
        resting.extend(this.object_triangles(0.0, false));
        this.resting = resting;
        this
    }

    /// Triangles of the object's moved or unmoved links, in the world.
    fn object_triangles(&self, q: f64, moved: bool) -> Triangles {
        let object = &self.bench.task.object;
        let poses = object.tree.link_poses(&object.world_from_root, &object.configuration(q));
        let mut out = Triangles::new();
        for (index, link) in object.tree.links().iter().enumerate() {
            if self.moved[index] == moved {
                let parts =
                    if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
                for part in parts {
                    collect_triangles(&part.triangulate(), &poses[index], &mut out);
                }
            }
        }
        out
    }

    fn clearance(&self, x: &[f64], moving: MovingCheck) -> f64 {
        let robot = &self.bench.task.robot;
        let mut q = robot.rest.clone();
        let planned = robot.base_joints.iter().chain(&robot.arm_joints);
        for (&joint, &value) in planned.zip(x) {
            q[robot.tree.column(joint).unwrap()] = value;
        }
        for (&joint, value) in robot.gripper_joints.iter().zip(robot.finger_positions(0.03)) {
            q[robot.tree.column(joint).unwrap()] = value;
        }
        let poses = robot.tree.link_poses(&robot.world_from_root, &q);
        let last_moving = |link: usize| {
            let chain = robot.tree.chain_to(link);
            let moves = |j: &usize| robot.base_joints.contains(j) || robot.arm_joints.contains(j);
            chain.into_iter().rev().find(moves)
        };
        let moved = self.object_triangles(x[10], true);
        let spheres = &self.bench.preparation.spheres.spheres;
        let center =
            |link: usize, c: [f64; 3]| (poses[link] * Point3::from(Vector3::from(c))).coords;
        let mut least = f64::INFINITY;
        for sphere in spheres {
            let at = center(sphere.link, sphere.center);
            least = least.min(distance_to_soup(&at, &self.resting) - sphere.radius);
            if last_moving(sphere.link) != robot.base_joints.last().copied() {
                least = least.min(at.z - sphere.radius);
            }
            let rigid_with_tool = last_moving(sphere.link) == last_moving(robot.tool_link);
            if moving == MovingCheck::All || !rigid_with_tool {
                least = least.min(distance_to_soup(&at, &moved) - sphere.radius);
            }
        }
        for &(a, b) in &self.bench.preparation.self_pairs {
            for s in spheres.iter().filter(|s| s.link == a) {
                for t in spheres.iter().filter(|t| t.link == b) {
                    let apart = (center(a, s.center) - center(b, t.center)).norm();
                    let distance = apart - s.radius - t.radius;
                    least = if distance < PAIR_REACH_M { least.min(distance) } else { least };
                }
            }
        }
        least
    }
}

#[test]
fn clearance_is_the_exact_one_within_a_voxel() {
    let Some(bench) = bench() else { return };
    let brute = BruteForce::new(bench);
    let mut rng = numbers(5);
    // Half a voxel's diagonal bounds the error of interpolating a distance.
    let tolerance = VOXEL_M * 3f64.sqrt() / 2.0;
    let (mut free, mut touching) = (0, 0);
    for round in 0..60 {
        let x = bench.sample(&mut rng);
        let check = if round % 2 == 0 { MovingCheck::All } else { MovingCheck::NotTool };
        let frames = bench.kinematics.forward(&x);
        let none = f64::NEG_INFINITY;
        let found = bench.body.clearance(&frames, &bench.world, x[10], check, none);
        let ours = found.distance_m.min(FIELD_REACH_M);
        let exact = brute.clearance(&x, check).min(FIELD_REACH_M);
        if exact > 0.0 {
            free += 1;
            assert!((ours - exact).abs() < tolerance, "round {round}: {found:?} {exact}");
        } else {
            touching += 1;
            assert!(ours < tolerance, "round {round}: {ours} {exact}");
        }
        // With a threshold, the verdict is the same.
        for enough in [-0.02, 0.0, 0.03] {
            let early = bench.body.clearance(&frames, &bench.world, x[10], check, enough);
            assert_eq!(early.distance_m < enough, ours < enough);
        }
    }
    assert!(free >= 10 && touching >= 5, "{free} free, {touching} touching");
}

#[test]
fn pairs_leave_out_neighbours_and_include_far_links() {
    let Some(bench) = bench() else { return };
    let tree = &bench.task.robot.tree;
    let checked = |a: &str, b: &str| {
        let (a, b) = (tree.link_index(a).unwrap(), tree.link_index(b).unwrap());
        let pairs = &bench.preparation.self_pairs;
        pairs.contains(&(a, b)) || pairs.contains(&(b, a))
    };
    for i in 0..7 {
        let (a, b) = (format!("panda_link{i}"), format!("panda_link{}", i + 1));
        assert!(!checked(&a, &b), "{a} and {b} are neighbours");
    }
    for arm in ["panda_link4", "panda_link5", "panda_link6", "panda_hand", "panda_leftfinger"] {
        for base in ["summit_base", "front_left_wheel"] {
            assert!(checked(arm, base), "{arm} can hit {base}");
        }
    }
    assert!(checked("panda_hand", "panda_link2"));
    let listed = &bench.task.robot.file.self_collision_ignore;
    assert!(!listed.is_empty() && listed.iter().all(|[a, b]| !checked(a, b)));
    assert!(!checked("front_left_wheel", "summit_base"), "rigid with each other");
}

/// The rows of the penalty recipe's gradient, by central differences.
#[test]
fn gradient_of_the_penalty_recipe() {
    let Some(bench) = bench() else { return };
    let grasp = grasp_at(&bench.task.object, Pose::identity());
    let akr = akr::assemble(&bench.task.robot, &bench.task.object, &grasp).unwrap();
    let anchor = &bench.task.object.world_from_root;
    let closure = Closure::new(&akr, &bench.kinematics, anchor).unwrap();
    let config = PlannerConfig { waypoints: 5, ..PlannerConfig::default() };
    let dof = bench.kinematics.dof();
    let problem = Problem {
        kinematics: &bench.kinematics,
        closure: &closure,
        body: &bench.body,
        world: &bench.world,
        config: &config,
        velocity_weights: Problem::weights(config.velocity_weights, 3, dof),
        acceleration_weights: Problem::weights(config.acceleration_weights, 3, dof),
        mobility: vec![1.0; dof],
    };
    // Near the constraint, where the residual's derivative is exact, and far from everything else.
    let mut x = vec![0.0; dof];
    let rest = bench.task.robot.arm_joints.iter();
    let arm = rest.map(|&j| bench.task.robot.tree.joint_position(j, &bench.task.robot.rest));
    x[3..dof - 1].iter_mut().zip(arm).for_each(|(x, q)| *x = q);
    let mut path: Vec<Vec<f64>> = (0..5)
        .map(|t| x.iter().enumerate().map(|(i, x)| x + 0.01 * ((t * t + i) as f64).sin()).collect())
        .collect();
    // A constraint that this path nearly fulfils: the object stands where the middle waypoint has it.
    let frames = bench.kinematics.forward(&path[2]);
    let attachment = bench.kinematics.attachment(akr.object_root);
    let node = frames.frames[attachment.node.unwrap()];
    let held = node.compose(&Frame::from(&(attachment.node_from_link * akr.root_link_from_object)));
    let rotation = nalgebra::UnitQuaternion::from_matrix(&held.rotation);
    let place = Pose::from_parts(held.translation.into(), rotation);
    let closure = Closure::new(&akr, &bench.kinematics, &place).unwrap();
    let problem = Problem { closure: &closure, ..problem };
    let mut gradient = vec![0.0; 3 * dof];
    problem.penalised(&path, &mut gradient);
    let mut unused = gradient.clone();
    let largest = gradient.iter().fold(0.0f64, |a, g| a.max(g.abs()));
    for t in 1..4 {
        for i in 0..dof {
            let at = path[t][i];
            let mut value = |to: f64| {
                path[t][i] = to;
                problem.penalised(&path, &mut unused)
            };
            let slope = (value(at + 1e-6) - value(at - 1e-6)) / 2e-6;
            path[t][i] = at;
            let own = gradient[(t - 1) * dof + i];
            assert!(
                (slope - own).abs() < 2e-3 * largest,
                "waypoint {t} variable {i}: {slope} {own}"
            );
        }
    }
    assert!(largest > 1.0, "the path is off the constraint: {largest}");
}

/// A link that stands still is in the way of the arm and of the object, not of the floor.
#[test]
fn resting_links_are_compared_with_the_arm() {
    let Some(bench) = bench() else { return };
    // The same robot, its base taken for a pedestal.
    let robot = &bench.task.robot;
    let kinematics =
        Kinematics::compile(&robot.tree, &robot.world_from_root, &robot.arm_joints, &robot.rest);
    let (spheres, pairs) = (&bench.preparation.spheres, &bench.preparation.self_pairs);
    let body = RobotBody::new(robot, spheres, pairs, &kinematics);
    assert!(body.spheres.iter().any(|s| s.rests));
    let least = |x: &[f64]| {
        let frames = kinematics.forward(x);
        let found = body.clearance(&frames, &bench.world, 0.0, MovingCheck::All, -1.0);
        (found.distance_m, found.to)
    };
    let rest: Vec<f64> =
        robot.arm_joints.iter().map(|&j| robot.tree.joint_position(j, &robot.rest)).collect();
    assert!(least(&rest).0 > 0.0, "{:?}", least(&rest));
    // The hand folded into its own foot.
    let (distance, to) = least(&[0.0, -1.7, 0.0, -3.0, 0.0, 0.3, 0.0]);
    assert!(distance < 0.0 && matches!(to, Obstacle::Link(_)), "{distance} {to:?}");
}
