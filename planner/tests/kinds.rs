//! Rigid and planar objects with a real robot, changes of grasp, and explanations of what cannot be done.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use akrobat_judge::{Judge, JudgeConfig, RobotSphere};
use akrobat_model::events::Silent;
use akrobat_model::robot::BaseKind;
use akrobat_model::task::Task;
use akrobat_model::{Phase, Rejection, Trajectory, load, pose};
use akrobat_planner::plan::explain;
use akrobat_planner::world::World;
use akrobat_planner::{PlanError, PlanOutcome, PlannerConfig, Preparation, plan};

/// A task of `configs/` for the robot whose files are shared, with `edit` applied to its text.
fn task(name: &str, edit: impl Fn(String) -> String) -> Option<Task> {
    let path = common::config(&format!("tasks/{name}.toml"));
    let text = std::fs::read_to_string(&path).unwrap();
    Some(load::task_from_text(edit(text), &path, &common::search()?).unwrap())
}

struct Planned {
    outcome: PlanOutcome,
    judge: Judge,
}

fn planned(task: &Task, config: &PlannerConfig) -> Planned {
    let preparation = Preparation::new(task).unwrap();
    let spheres = preparation.spheres.spheres.iter();
    let spheres: Vec<RobotSphere> =
        spheres.map(|s| RobotSphere { link: s.link, center: s.center, radius: s.radius }).collect();
    let judge =
        Judge::new(task, &spheres, &preparation.exceptions, JudgeConfig::default()).unwrap();
    let world = World::build(task, config);
    let outcome = plan(task, &preparation, &world, config, &Silent, &|t| judge.judge(t)).unwrap();
    Planned { outcome, judge }
}

fn small() -> PlannerConfig {
    PlannerConfig { limit: 2, ik_seeds: 200, ik_clusters: 8, ..PlannerConfig::default() }
}

fn phases(trajectory: &Trajectory) -> Vec<Phase> {
    let mut phases = trajectory.dense.phase.clone();
    phases.dedup();
    phases
}

#[test]
fn a_mug_is_picked_up_and_put_down() {
    let mobile = |text: String| {
        let text = text.replace("panda.toml", "summit_franka.toml");
        text.replace("pose = [-3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]", "") + "\n[grasps]\ncount = 4\n"
    };
    let Some(task) = task("panda_mug_table", mobile) else { return };
    let Planned { outcome, judge } = planned(&task, &small());
    let trajectories = &outcome.set.trajectories;
    assert!(!trajectories.is_empty(), "{:?} {:?}", outcome.counts, outcome.notes);
    let goals = &task.file.goal.poses;
    for trajectory in trajectories {
        assert!(judge.judge(trajectory).accepted());
        let last = trajectory.waypoints_object.row_f64(29);
        let near = goals.iter().any(|g| (last[0] - g[0]).hypot(last[1] - g[1]) < 1e-3);
        assert!(near, "{last:?}");
        let highest = (0..30).map(|k| trajectory.waypoints_object.row(k)[2]).fold(0.0, f32::max);
        assert!(highest > 0.45 + 0.05, "it was not lifted: {highest}");
        let expected =
            [Phase::Approach, Phase::Reach, Phase::Grasp, Phase::Manipulate, Phase::Release];
        assert_eq!(phases(trajectory), expected);
        // Negative control: the mug slips in the hand.
        let mut slipped = trajectory.clone();
        let columns = slipped.dense.object.columns();
        let middle = trajectory.waypoint_sample(15) + 1;
        slipped.dense.object.values_mut()[middle * columns] += 0.004;
        assert_eq!(judge.judge(&slipped).rejection, Some(Rejection::AnchorTranslation));
    }
}

#[test]
fn a_chair_is_pulled_across_the_floor() {
    let few = |text: String| text + "\n[grasps]\ncount = 4\n";
    let Some(task) = task("summit_chair_room", few) else { return };
    let Planned { outcome, judge } = planned(&task, &small());
    let trajectories = &outcome.set.trajectories;
    assert!(!trajectories.is_empty(), "{:?} {:?}", outcome.counts, outcome.notes);
    for trajectory in trajectories {
        assert!(judge.judge(trajectory).accepted());
        assert_eq!(trajectory.waypoints_object.columns(), 3);
        let last = trajectory.waypoints_object.row_f64(29);
        let reached = task.file.goal.poses.iter().any(|goal| {
            let (_, _, yaw) = pose::from_xyz_wxyz(*goal).unwrap().rotation.euler_angles();
            let turned = (last[2] - yaw).sin().abs();
            (last[0] - goal[0]).hypot(last[1] - goal[1]) < 1e-3 && turned < 0.01
        });
        assert!(reached, "{last:?}");
        assert_eq!(phases(trajectory).last(), Some(&Phase::Release));
    }
}

#[test]
fn a_blocked_drawer_is_explained() {
    let blocked = |text: String| {
        text + "\n[[scene.box]]\nname = \"crate\"\nsize = [0.5, 1.4, 1.6]\n\
                pose = [-2.9, 0.0, 0.8, 1.0, 0.0, 0.0, 0.0]\n"
    };
    let explained = |edit: &dyn Fn(String) -> String| {
        let task = task("summit_drawer_empty", edit)?;
        let preparation = Preparation::new(&task).unwrap();
        let config = PlannerConfig { workspace_m: [3.0, 3.0, 2.0], ..small() };
        let world = World::build(&task, &config);
        Some(explain(&task, &preparation, &world, &config, &Silent).unwrap())
    };
    let Some(found) = explained(&blocked) else { return };
    let open = found.reach.last().unwrap();
    assert_eq!(open.free, 0, "{open:?}");
    assert!(open.blocked_by.iter().any(|b| b.obstacle.contains("crate")), "{open:?}");
    assert!(found.closest.iter().any(|v| v.stage == "collision"), "{:?}", found.closest);
    // Negative control: without the crate the goals are free, and nothing is blamed on it.
    let clear = explained(&|text| text).unwrap();
    assert!(clear.reach.iter().all(|at| at.free > 0), "{:?}", clear.reach);
    assert!(clear.closest.is_empty());
    assert!(!format!("{clear:?}").contains("crate"));
}

#[test]
fn a_differential_base_is_refused() {
    let Some(mut task) = task("summit_drawer_empty", |text| text) else { return };
    task.robot.file.base.kind = BaseKind::Differential;
    let refused = Preparation::new(&task).unwrap_err();
    assert!(matches!(refused, PlanError::DifferentialBase { .. }));
    let message = refused.to_string();
    for part in ["summit_franka", "differential", "holonomic, fixed"] {
        assert!(message.contains(part), "{message}");
    }
}
