//! The inner loops of planning ask the allocator for nothing: what they need is there before the first iteration.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;

use akrobat_planner::akr;
use akrobat_planner::closure::Closure;
use akrobat_planner::collision::{MovingCheck, Penalty, RobotBody};
use akrobat_planner::ik::{self, Tool};
use akrobat_planner::kinematics::Kinematics;
use akrobat_planner::trajopt::Problem;
use akrobat_planner::world::World;
use akrobat_planner::{PlannerConfig, Preparation};

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

/// The system's allocator, which counts what each thread asks it for.
struct Counting;

// SAFETY: everything is handed on to the system's allocator as it came; counting does not allocate.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // A thread that ends has no counter any more, and nobody asks for it.
        let _ = ALLOCATIONS.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's promises are those that the system's allocator asks for.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// How often `work` asks for memory on this thread when it is done for the second time: what a thread keeps for all that
/// follows is there then.
fn again(mut work: impl FnMut()) -> usize {
    work();
    allocations(work)
}

/// How often `work` asks for memory on this thread.
fn allocations(work: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.get();
    work();
    ALLOCATIONS.get() - before
}

#[test]
fn the_counter_counts() {
    let mut kept = Vec::new();
    assert_eq!(allocations(|| kept.push(vec![1.0; 100])), 2);
    assert_eq!(allocations(|| kept[0][3] = 2.0), 0);
}

#[test]
fn loops_do_not_allocate() {
    let Some(task) = common::task("summit_drawer_kitchen") else { return };
    let preparation = Preparation::new(&task).unwrap();
    let world = World::build(&task, &PlannerConfig::default());
    let (robot, object) = (&task.robot, &task.object);
    let grasp = akrobat_planner::grasp::grasps(&task, &preparation.spheres, 1, 8).0.remove(0);
    let akr = akr::assemble(robot, object, &grasp).unwrap();
    let kinematics =
        Kinematics::compile(&akr.tree, &robot.world_from_root, &akr.variables, &akr.rest);
    let body = RobotBody::new(robot, &preparation.spheres, &preparation.self_pairs, &kinematics);
    let closure = Closure::new(&akr, &kinematics, &object.world_from_root).unwrap();
    let (dof, tool) = (kinematics.dof(), Tool::new(robot, &kinematics).unwrap());
    let mobility = vec![1.0; dof];

    // A configuration that holds the handle.
    let mut rng = common::numbers(1);
    let held = |rng: &mut _| {
        let mut x: Vec<f64> =
            (0..dof).map(|i| common::number_within(&kinematics, i, rng)).collect();
        x[dof - 1] = 0.05;
        closure.project(&kinematics, &mut x, &mobility, true).then_some(x)
    };
    let start = (0..1000).find_map(|_| held(&mut rng)).unwrap();

    assert_eq!(again(|| _ = black_box(kinematics.forward(&start))), 0, "forward kinematics");
    let frames = kinematics.forward(&start);
    let clearance =
        || _ = black_box(body.clearance(&frames, &world, 0.05, MovingCheck::All, f64::MIN));
    assert_eq!(again(clearance), 0, "clearance");
    let mut penalty = Penalty::zero();
    let penalised =
        || body.penalty(&kinematics, &frames, &world, &start, dof - 1, 0.3, &mut penalty);
    assert_eq!(again(penalised), 0, "penalties");
    assert!(penalty.cost > 0.0, "no sphere is near anything");
    let mut moved = start.clone();
    let projected = || {
        moved.iter_mut().for_each(|v| *v += 0.01);
        assert!(closure.project(&kinematics, &mut moved, &mobility, true));
    };
    assert_eq!(again(projected), 0, "projection");
    let mut solved = start.clone();
    let target = tool.frame(&frames);
    let solve = || {
        solved.iter_mut().for_each(|v| *v += 0.05);
        assert!(ik::solve(&kinematics, &tool, &target, &mut solved, 0));
    };
    assert_eq!(again(solve), 0, "inverse kinematics");

    // Many iterations cost no allocation more than one.
    let optimised = |iterations: usize| {
        let config = PlannerConfig { iterations, ..PlannerConfig::default() };
        let problem = Problem {
            kinematics: &kinematics,
            closure: &closure,
            body: &body,
            world: &world,
            config: &config,
            velocity_weights: Problem::weights(config.velocity_weights, 3, dof),
            acceleration_weights: Problem::weights(config.acceleration_weights, 3, dof),
            mobility: mobility.clone(),
        };
        let end = problem.follow(&start, 0.3).unwrap();
        let mut path = problem.straight(&start, &end).unwrap();
        (allocations(|| problem.optimise(&mut path)), problem.cost(&path).0)
    };
    optimised(1);
    let ((few, rough), (many, smooth)) = (optimised(1), optimised(20));
    assert!(smooth < rough, "more iterations lower the cost: {smooth} {rough}");
    assert_eq!(few, many, "trajectory optimisation");
}
