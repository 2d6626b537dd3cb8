//! Compiled kinematics, the closure constraint and inverse kinematics against the model's trees and
//! finite differences.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use akrobat_model::{KinematicTree, Pose, Robot, pose};
use akrobat_planner::akr::{self, Akr};
use akrobat_planner::closure::{self, Closure};
use akrobat_planner::ik::{self, Effort, SeedRegion, Tool};
use akrobat_planner::kinematics::{Frame, Kinematics, MAX_VARIABLES, rotation_log};
use common::{apart, frame_apart, grasp_at, manipulated, numbers, random_configuration};
use nalgebra::{SVector, Vector3, Vector6};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Step of central differences, rad or m.
const STEP: f64 = 1e-6;
/// Their error: rounding over the step, and the step squared.
const DIFFERENCE_TOLERANCE: f64 = 1e-7;

/// The tree's configuration with `variables` at `x` and everything else at `rest`.
fn full(tree: &KinematicTree, variables: &[usize], x: &[f64], rest: &[f64]) -> Vec<f64> {
    let mut q = rest.to_vec();
    for (&joint, &value) in variables.iter().zip(x) {
        q[tree.column(joint).unwrap()] = value;
    }
    q
}

/// Values of `variables` in a configuration of the tree.
fn values(tree: &KinematicTree, variables: &[usize], q: &[f64]) -> Vec<f64> {
    variables.iter().map(|&j| tree.joint_position(j, q)).collect()
}

/// Largest gap between compiled and model poses of all links at one configuration.
fn largest_gap(tree: &KinematicTree, kinematics: &Kinematics, x: &[f64], poses: &[Pose]) -> f64 {
    let frames = kinematics.forward(x);
    let links = 0..tree.links().len();
    links.map(|l| frame_apart(&kinematics.link_frame(&frames, l), &poses[l])).fold(0.0, f64::max)
}

fn planned(robot: &Robot) -> Vec<usize> {
    [&robot.base_joints[..], &robot.arm_joints].concat()
}

#[test]
fn compiled_links_are_where_the_model_has_them() {
    let (Some(robot), Some(objects)) = (common::summit(), common::objects()) else { return };
    let mut rng = numbers(1);
    let parents_first = |tree: &KinematicTree| -> Vec<usize> {
        tree.order().iter().copied().filter(|j| tree.dof_joints().contains(j)).collect()
    };
    let mut trees = vec![(&robot.tree, planned(&robot))];
    trees.push((&robot.tree, parents_first(&robot.tree)));
    trees.extend(objects.iter().map(|tree| (tree, parents_first(tree))));
    trees.extend(objects.iter().map(|tree| (tree, vec![tree.dof_joints()[0]])));
    for (tree, mut variables) in trees {
        variables.truncate(MAX_VARIABLES);
        for _ in 0..10 {
            let root = common::random_pose(&mut rng);
            let rest = random_configuration(tree, &mut rng);
            let kinematics = Kinematics::compile(tree, &root, &variables, &rest);
            assert_eq!(kinematics.dof(), variables.len());
            let x = values(tree, &variables, &random_configuration(tree, &mut rng));
            let q = full(tree, &variables, &x, &rest);
            let gap = largest_gap(tree, &kinematics, &x, &tree.link_poses(&root, &q));
            assert!(gap < 1e-12, "{}: {gap}", tree.name);
            // Negative control: another configuration has other poses.
            let other = largest_gap(tree, &kinematics, &x, &tree.link_poses(&root, &rest));
            assert!(other > 1e-3, "{}: {other}", tree.name);
        }
    }
}

/// Summit-Franka holding a drawer by its box, and the drawer's place for which this is possible.
struct Held {
    robot: Robot,
    akr: Akr,
    kinematics: Kinematics,
    closure: Closure,
    world_from_object: Pose,
    /// A configuration that satisfies the constraint.
    on_constraint: Vec<f64>,
}

impl Held {
    fn new(joint: &str, seed: u64) -> Option<Self> {
        let robot = common::summit()?;
        let tree = common::objects()?.into_iter().find(|t| t.joint_index(joint).is_ok());
        let tree = tree.unwrap_or_else(|| panic!("no shared object has a joint {joint}"));
        let mut rng = numbers(seed);
        let active = tree.joint_index(joint).unwrap();
        let mut object = manipulated(&tree, active, Pose::identity());
        let grasp = grasp_at(&object, pose::from_xyz_rpy([0.3, 0.1, 0.2], [0.4, -1.2, 0.3]));
        let mut q = robot.rest.clone();
        for &joint in &planned(&robot) {
            q[robot.tree.column(joint).unwrap()] += rng.random_range(-0.2..=0.2);
        }
        let poses = robot.tree.link_poses(&robot.world_from_root, &q);
        let held = poses[robot.tool_link] * robot.link_from_tool * grasp.link_from_tool.inverse();
        let opened = 0.2;
        let root_from_link = tree.link_poses(&Pose::identity(), &object.configuration(opened));
        object.world_from_root = held * root_from_link[object.handle_link].inverse();
        let akr = akr::assemble(&robot, &object, &grasp).unwrap();
        let kinematics =
            Kinematics::compile(&akr.tree, &robot.world_from_root, &akr.variables, &akr.rest);
        let closure = Closure::new(&akr, &kinematics, &object.world_from_root).unwrap();
        let mut on_constraint = values(&robot.tree, &planned(&robot), &q);
        on_constraint.push(opened);
        let world_from_object = object.world_from_root;
        Some(Self { robot, akr, kinematics, closure, world_from_object, on_constraint })
    }

    /// A sliding and a turning object.
    fn both() -> Option<[Self; 2]> {
        Some([Self::new("drawer_slider_0", 3)?, Self::new("door_joint_0", 4)?])
    }

    /// How far the object's root is from its place, by the model's own kinematics.
    fn model_gap(&self, x: &[f64]) -> f64 {
        let q = full(&self.akr.tree, &self.akr.variables, x, &self.akr.rest);
        let poses = self.akr.tree.link_poses(&self.robot.world_from_root, &q);
        let root = poses[self.akr.object_root] * self.akr.root_link_from_object;
        apart(&root, &self.world_from_object)
    }

    fn near(&self, spread: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
        self.on_constraint.iter().map(|v| v + rng.random_range(-spread..=spread)).collect()
    }
}

/// `x` with variable `i` moved by `by`.
fn moved(x: &[f64], i: usize, by: f64) -> Vec<f64> {
    let mut x = x.to_vec();
    x[i] += by;
    x
}

/// Compares Jacobian and point gradients of every link with central differences.
fn check_derivatives(tree: &KinematicTree, kinematics: &Kinematics, x: &[f64]) {
    let frames = kinematics.forward(x);
    let gradient = Vector3::new(0.3, -0.8, 0.5);
    for link in 0..tree.links().len() {
        let Some(node) = kinematics.attachment(link).node else { continue };
        let offset = Vector3::new(0.1, -0.2, 0.15);
        let at = |x: &[f64]| {
            let frame = kinematics.link_frame(&kinematics.forward(x), link);
            (frame.transform(&offset), frame.rotation)
        };
        let point = at(x).0;
        let jacobian = kinematics.jacobian(&frames, node, &point);
        let mut row = SVector::<f64, MAX_VARIABLES>::zeros();
        kinematics.add_point_gradient(&frames, node, &point, &gradient, &mut row);
        for i in 0..MAX_VARIABLES {
            let mut expected = Vector6::zeros();
            if i < kinematics.dof() {
                let (after, before) = (at(&moved(x, i, STEP)), at(&moved(x, i, -STEP)));
                let linear = (after.0 - before.0) / (2.0 * STEP);
                let angular = rotation_log(&(after.1 * before.1.transpose())) / (2.0 * STEP);
                expected.fixed_rows_mut::<3>(0).copy_from(&linear);
                expected.fixed_rows_mut::<3>(3).copy_from(&angular);
            }
            let gap = (jacobian.column(i) - expected).amax();
            let name = &tree.links()[link].name;
            assert!(gap < DIFFERENCE_TOLERANCE, "link {name}, variable {i}: {gap}");
            let gap = (row[i] - gradient.dot(&expected.fixed_rows::<3>(0))).abs();
            assert!(gap < DIFFERENCE_TOLERANCE, "gradient at {name}, variable {i}: {gap}");
        }
    }
}

#[test]
fn derivatives_agree_with_finite_differences() {
    let Some(helds) = Held::both() else { return };
    let mut rng = numbers(5);
    let robot = &helds[0].robot;
    let kinematics =
        Kinematics::compile(&robot.tree, &robot.world_from_root, &planned(robot), &robot.rest);
    for _ in 0..5 {
        let q = random_configuration(&robot.tree, &mut rng);
        check_derivatives(&robot.tree, &kinematics, &values(&robot.tree, &planned(robot), &q));
        for held in &helds {
            let q = random_configuration(&held.akr.tree, &mut rng);
            let x = values(&held.akr.tree, &held.akr.variables, &q);
            check_derivatives(&held.akr.tree, &held.kinematics, &x);
        }
    }
}

/// Negative control: the comparison sees an object joint that is taken for locked.
#[test]
fn a_missing_column_is_noticed() {
    let Some([held, _]) = Held::both() else { return };
    let x = &held.on_constraint;
    let variables = &held.akr.variables[..10];
    let rest = full(&held.akr.tree, &held.akr.variables, x, &held.akr.rest);
    let root = &held.robot.world_from_root;
    let locked = Kinematics::compile(&held.akr.tree, root, variables, &rest);
    let jacobian = |kinematics: &Kinematics, x: &[f64]| {
        let frames = kinematics.forward(x);
        let node = kinematics.attachment(held.akr.object_root).node.unwrap();
        let point = kinematics.link_frame(&frames, held.akr.object_root).translation;
        kinematics.jacobian(&frames, node, &point)
    };
    let gap = jacobian(&held.kinematics, x) - jacobian(&locked, &x[..10]);
    assert!(gap.columns(0, 10).amax() < DIFFERENCE_TOLERANCE);
    assert!(gap.column(10).norm() > 0.9);
}

#[test]
fn residual_agrees_with_finite_differences() {
    let Some(helds) = Held::both() else { return };
    let mut rng = numbers(7);
    for held in &helds {
        // On the constraint the rows are exact; beside it, to first order in the residual.
        for (spread, tolerance) in [(0.0, 1e-6), (1e-3, 2e-2)] {
            let x = held.near(spread, &mut rng);
            let error = |x: &[f64]| held.closure.error(&held.kinematics.forward(x));
            let residual = held.closure.linearise(&held.kinematics, &held.kinematics.forward(&x));
            assert!((residual.error - error(&x)).amax() < 1e-15);
            assert!(residual.error.amax() <= 20.0 * spread + 1e-9);
            for i in 0..held.kinematics.dof() {
                let difference =
                    (error(&moved(&x, i, STEP)) - error(&moved(&x, i, -STEP))) / (2.0 * STEP);
                let gap = (residual.jacobian.column(i) - difference).amax();
                assert!(gap < tolerance, "variable {i}: {gap}");
            }
            let object = held.kinematics.dof() - 1;
            assert!(residual.jacobian.column(object).norm() > 0.9, "the object's joint counts");
        }
    }
}

#[test]
fn projection_holds_the_constraint() {
    let Some(helds) = Held::both() else { return };
    for held in &helds {
        assert!(held.model_gap(&held.on_constraint) < 1e-9);
        let dof = held.kinematics.dof();
        for hold_object in [false, true] {
            let (mut held_count, tries) = (0, 100);
            let mut rng = numbers(8);
            for _ in 0..tries {
                let start = held.near(0.05, &mut rng);
                assert!(held.model_gap(&start) > closure::TOLERANCE);
                let mut x = start.clone();
                held.kinematics.clamp(&mut x);
                let clamped = x.clone();
                let free = vec![1.0; dof];
                if !held.closure.project(&held.kinematics, &mut x, &free, hold_object) {
                    continue;
                }
                held_count += 1;
                let residual = held.closure.error(&held.kinematics.forward(&x));
                assert!(residual.amax() < closure::TOLERANCE);
                assert!(held.model_gap(&x) < 2.0 * closure::TOLERANCE);
                assert!(held.kinematics.within_limits(&x, 0.0));
                assert_eq!(x[dof - 1] == clamped[dof - 1], hold_object);
            }
            assert!(held_count > tries * 9 / 10, "only {held_count} of {tries}");
        }
    }
}

#[test]
fn projection_leaves_immobile_variables_alone() {
    let Some([held, _]) = Held::both() else { return };
    let mut rng = numbers(9);
    let mut mobility = vec![1.0; held.kinematics.dof()];
    mobility[..3].fill(0.0);
    let mut x = held.near(0.03, &mut rng);
    let base = x[..3].to_vec();
    assert!(held.closure.project(&held.kinematics, &mut x, &mobility, true));
    assert_eq!(x[..3], base);
    assert!(held.model_gap(&x) < 2.0 * closure::TOLERANCE);
    // Nothing moves: nothing converges.
    let mut stuck = held.near(0.03, &mut rng);
    let none = vec![0.0; held.kinematics.dof()];
    assert!(!held.closure.project(&held.kinematics, &mut stuck, &none, false));
}

/// Summit-Franka compiled, with its tool.
struct Arm {
    robot: Robot,
    kinematics: Kinematics,
    tool: Tool,
}

impl Arm {
    fn new() -> Option<Self> {
        let robot = common::summit()?;
        let variables = planned(&robot);
        let kinematics =
            Kinematics::compile(&robot.tree, &robot.world_from_root, &variables, &robot.rest);
        let tool = Tool::new(&robot, &kinematics).unwrap();
        Some(Self { robot, kinematics, tool })
    }

    /// The tool's pose by the model's own kinematics.
    fn model_tool(&self, x: &[f64]) -> Pose {
        let q = full(&self.robot.tree, &planned(&self.robot), x, &self.robot.rest);
        let poses = self.robot.tree.link_poses(&self.robot.world_from_root, &q);
        poses[self.robot.tool_link] * self.robot.link_from_tool
    }

    fn reachable_target(&self, rng: &mut ChaCha8Rng) -> Pose {
        let q = random_configuration(&self.robot.tree, rng);
        self.model_tool(&values(&self.robot.tree, &planned(&self.robot), &q))
    }

    fn region(&self) -> SeedRegion {
        SeedRegion {
            base: 3,
            mount: [0.2, 0.0],
            outward: Vector3::x(),
            distance_m: [0.2, 0.8],
            half_angle: std::f64::consts::PI,
        }
    }
}

#[test]
fn solutions_reach_the_target() {
    let Some(arm) = Arm::new() else { return };
    let mut rng = numbers(10);
    let (mut solved, mut tries) = (0, 0);
    for _ in 0..40 {
        let target = arm.reachable_target(&mut rng);
        for _ in 0..10 {
            tries += 1;
            let mut x = arm.region().sample(&arm.kinematics, &Frame::from(&target), &mut rng);
            assert!(arm.kinematics.within_limits(&x, 0.0));
            if ik::solve(&arm.kinematics, &arm.tool, &Frame::from(&target), &mut x, 0) {
                solved += 1;
                // Each component is within the tolerance.
                let gap = apart(&arm.model_tool(&x), &target);
                assert!(gap < 3f64.sqrt() * ik::TOLERANCE + 1e-9, "{gap}");
                assert!(arm.kinematics.within_limits(&x, 0.0));
            }
        }
    }
    assert!(solved * 2 > tries, "{solved} of {tries}");
}

#[test]
fn a_frozen_base_stays() {
    let Some(arm) = Arm::new() else { return };
    let mut rng = numbers(11);
    let mut solved = 0;
    for _ in 0..50 {
        let q = random_configuration(&arm.robot.tree, &mut rng);
        let mut x = values(&arm.robot.tree, &planned(&arm.robot), &q);
        let target = arm.model_tool(&x);
        x[3..].iter_mut().for_each(|v| *v += rng.random_range(-0.3..=0.3));
        arm.kinematics.clamp(&mut x);
        let base = x[..3].to_vec();
        if ik::solve(&arm.kinematics, &arm.tool, &Frame::from(&target), &mut x, 3) {
            solved += 1;
            assert!(apart(&arm.model_tool(&x), &target) < 2.0 * ik::TOLERANCE);
        }
        assert_eq!(x[..3], base);
    }
    assert!(solved > 25, "{solved} of 50");
}

#[test]
fn an_unreachable_target_is_not_reached() {
    let Some(arm) = Arm::new() else { return };
    let mut rng = numbers(12);
    for _ in 0..20 {
        let mut target = arm.reachable_target(&mut rng);
        target.translation.z += 3.0;
        let target = Frame::from(&target);
        let mut x = arm.region().sample(&arm.kinematics, &target, &mut rng);
        assert!(!ik::solve(&arm.kinematics, &arm.tool, &target, &mut x, 0));
        assert!(x.iter().all(|v| v.is_finite()));
    }
}

#[test]
fn batches_do_not_depend_on_the_number_of_threads() {
    let Some(arm) = Arm::new() else { return };
    let target = Frame::from(&arm.reachable_target(&mut numbers(13)));
    let batch = |threads: usize, seed: u64, enough: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let search = ik::Search {
                kinematics: &arm.kinematics,
                tool: &arm.tool,
                target: &target,
                region: &arm.region(),
                seed,
                effort: Effort { seeds: 300, enough },
                prefilter: &|x| x[3] > -1.0,
                accept: &|x| x[4] < 1.0,
            };
            search.on_cpu()
        })
    };
    let one = batch(1, 5, usize::MAX);
    assert!(!one.accepted.is_empty());
    assert!(one.accepted.iter().all(|x| x[4] < 1.0));
    assert!(one.solved >= one.accepted.len() && one.solved <= 300);
    assert_eq!(one, batch(2, 5, usize::MAX));
    assert_ne!(one.accepted, batch(2, 6, usize::MAX).accepted);
    // Where a few suffice, they are the first of the same.
    let few = batch(2, 5, 5);
    assert!(few.seeds < 300 && few.accepted.len() >= 5);
    assert_eq!(few.accepted, one.accepted[..few.accepted.len()]);
}

#[test]
fn limits_that_are_drawn_in_hold_their_margin() {
    let Some(arm) = Arm::new() else { return };
    let mut drawn = arm.kinematics.clone();
    drawn.draw_in_limits(10, 0.02);
    let mut x = vec![100.0; 10];
    drawn.clamp(&mut x);
    assert!(arm.kinematics.within_limits(&x, 0.02 - 1e-12));
    assert!(!arm.kinematics.within_limits(&x, 0.03));
}
