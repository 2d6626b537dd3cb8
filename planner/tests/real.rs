//! A real task planned and judged, repeated for determinism, and its trajectories damaged.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use std::collections::BTreeSet;
use std::sync::OnceLock;

use akrobat_judge::{Judge, JudgeConfig, RobotSphere};
use akrobat_model::events::Silent;
use akrobat_model::task::Task;
use akrobat_model::trajectory::DensePath;
use akrobat_model::{JointPath, Rejection, Trajectory, TrajectorySet, load, pose};
use akrobat_planner::world::World;
use akrobat_planner::{PlanOutcome, PlannerConfig, Preparation, plan};
use nalgebra::{Translation3, UnitQuaternion, Vector3};

const TASK: &str = "tasks/summit_drawer_empty.toml";

/// The task with a few lines appended.
fn task(appended: &str) -> Option<Task> {
    let path = common::config(TASK);
    let text = std::fs::read_to_string(&path).unwrap() + appended;
    Some(load::task_from_text(text, &path, &common::search()?).unwrap())
}

fn judge(task: &Task, preparation: &Preparation) -> Judge {
    let spheres = preparation.spheres.spheres.iter();
    let spheres: Vec<RobotSphere> =
        spheres.map(|s| RobotSphere { link: s.link, center: s.center, radius: s.radius }).collect();
    Judge::new(task, &spheres, &preparation.exceptions, JudgeConfig::default()).unwrap()
}

/// The task with its judge and trajectories, planned once for all tests.
struct Planned {
    task: Task,
    preparation: Preparation,
    judge: Judge,
    outcome: PlanOutcome,
}

fn planned() -> Option<&'static Planned> {
    static PLANNED: OnceLock<Option<Planned>> = OnceLock::new();
    let plan_it = || {
        let task = task("\n[grasps]\ncount = 5\n")?;
        let preparation = Preparation::new(&task).unwrap();
        let judge = judge(&task, &preparation);
        let config = PlannerConfig { limit: 10, ik_seeds: 300, ..PlannerConfig::default() };
        let world = World::build(&task, &config);
        let outcome =
            plan(&task, &preparation, &world, &config, &Silent, &|t| judge.judge(t)).unwrap();
        Some(Planned { task, preparation, judge, outcome })
    };
    PLANNED.get_or_init(plan_it).as_ref()
}

#[test]
fn a_real_drawer_is_opened_in_many_ways() {
    let Some(Planned { task, judge, outcome, .. }) = planned() else { return };
    let trajectories = &outcome.set.trajectories;
    assert!(trajectories.len() >= 10, "{} accepted: {:?}", trajectories.len(), outcome.counts);
    let grasps: BTreeSet<u32> = trajectories.iter().map(|t| t.grasp.id).collect();
    assert!(grasps.len() >= 3, "grasps {grasps:?}");
    let ids: BTreeSet<&str> = trajectories.iter().map(|t| t.id.as_str()).collect();
    assert_eq!(ids.len(), trajectories.len(), "identities repeat");
    assert_eq!(outcome.counts["accepted"], trajectories.len() as u64);
    for trajectory in trajectories {
        assert_eq!(trajectory.waypoints_robot.rows(), 30);
        let verdict = judge.judge(trajectory);
        assert!(verdict.accepted(), "{}: {}", trajectory.id, verdict.detail);
        assert_eq!(trajectory.verdict.as_ref(), Some(&verdict));
        for row in 0..30 {
            let gap = anchor_gap(task, trajectory, row);
            assert!(gap < 1e-4, "{} waypoint {row}: {gap}", trajectory.id);
        }
    }
}

/// How far (m, rad) the tool is from the grasp at a waypoint, by the model's trees.
fn anchor_gap(task: &Task, trajectory: &Trajectory, row: usize) -> f64 {
    let (robot, object) = (&task.robot, &task.object);
    let q = robot.configuration(&trajectory.waypoints_robot.row_f64(row));
    let robot_poses = robot.tree.link_poses(&robot.world_from_root, &q);
    let object_q = trajectory.waypoints_object.row_f64(row);
    let object_poses = object.tree.link_poses(&object.world_from_root, &object_q);
    let held = object.tree.link_index(&trajectory.grasp.link).unwrap();
    let tool = robot_poses[robot.tool_link] * robot.link_from_tool;
    common::apart(&tool, &(object_poses[held] * trajectory.grasp.link_from_tool))
}

#[test]
fn the_same_seed_gives_the_same_set_on_any_number_of_threads() {
    let Some(Planned { preparation, outcome, .. }) = planned() else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("grasps.txt");
    let line = |t: &Trajectory| {
        pose::to_xyz_wxyz(&t.grasp.link_from_tool).map(|v| v.to_string()).join(" ") + "\n"
    };
    let lines: BTreeSet<String> = outcome.set.trajectories.iter().map(line).collect();
    std::fs::write(&file, lines.into_iter().collect::<String>()).unwrap();
    let section = format!("\n[grasps]\nfile = {:?}\nframe = \"link\"\ncount = 2\n", file);
    let planned_on = |threads: usize, seed: u64| -> TrajectorySet {
        let path = common::config(TASK);
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.replace("seed = 1\n", &format!("seed = {seed}\n")) + &section;
        let task = load::task_from_text(text, &path, &common::search().unwrap()).unwrap();
        assert_eq!(task.file.seed, seed);
        let judge = judge(&task, preparation);
        let config = PlannerConfig { limit: 3, ik_seeds: 100, ..PlannerConfig::default() };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let world = World::build(&task, &config);
        let planned =
            || plan(&task, preparation, &world, &config, &Silent, &|t| judge.judge(t)).unwrap();
        pool.install(planned).set
    };
    let one = planned_on(1, 1);
    assert!(!one.trajectories.is_empty());
    assert_eq!(one, planned_on(2, 1));
    let other = planned_on(2, 2);
    assert!(!other.trajectories.is_empty());
    assert_ne!(one.trajectories, other.trajectories);
    for (a, b) in one.trajectories.iter().zip(&other.trajectories) {
        assert_ne!(a.id, b.id);
        assert_ne!(a.waypoints_robot, b.waypoints_robot);
    }
}

/// A way to spoil a trajectory, and what the judge must say.
struct Damage {
    name: &'static str,
    inflict: fn(&mut Trajectory),
    expected: Rejection,
}

/// Dense sample of a waypoint.
fn sample_of(t: &Trajectory, waypoint: usize) -> usize {
    t.manipulation_start as usize + waypoint * t.substeps as usize
}

/// Column of the elbow: three base joints and three arm joints come before it.
const ELBOW: usize = 6;

fn bend(path: &mut JointPath, row: usize, column: usize, by: f32) {
    let at = row * path.columns() + column;
    path.values_mut()[at] += by;
}

fn repeat_row(path: &mut JointPath, row: usize) {
    let columns = path.columns();
    path.values_mut().copy_within((row - 1) * columns..row * columns, row * columns);
}

fn swap_columns(path: &mut JointPath, a: usize, b: usize) {
    let columns = path.columns();
    path.values_mut().chunks_mut(columns).for_each(|row| row.swap(a, b));
}

fn first_rows(path: &JointPath, rows: usize) -> JointPath {
    let columns = path.columns();
    JointPath::from_values(columns, path.values()[..rows * columns].to_vec()).unwrap()
}

fn first_samples(dense: &DensePath, samples: usize) -> DensePath {
    DensePath {
        times_s: dense.times_s[..samples].to_vec(),
        robot: first_rows(&dense.robot, samples),
        object: first_rows(&dense.object, samples),
        phase: dense.phase[..samples].to_vec(),
    }
}

const DAMAGES: [Damage; 11] = [
    Damage {
        name: "one bad waypoint, on the path as well",
        inflict: |t| {
            let sample = sample_of(t, 15);
            bend(&mut t.waypoints_robot, 15, ELBOW, 0.05);
            bend(&mut t.dense.robot, sample, ELBOW, 0.05);
        },
        expected: Rejection::AnchorTranslation,
    },
    Damage {
        name: "one waypoint beside the path",
        inflict: |t| bend(&mut t.waypoints_robot, 15, ELBOW, 0.05),
        expected: Rejection::Malformed,
    },
    Damage {
        name: "grasp stated 2 mm off",
        inflict: |t| {
            t.grasp.link_from_tool *= Translation3::new(0.002, 0.0, 0.0);
        },
        expected: Rejection::AnchorTranslation,
    },
    Damage {
        name: "grasp stated 0.02 rad off",
        inflict: |t| {
            t.grasp.link_from_tool *= UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.02);
        },
        expected: Rejection::AnchorRotation,
    },
    Damage {
        name: "two joint columns swapped",
        inflict: |t| {
            swap_columns(&mut t.waypoints_robot, 4, ELBOW);
            swap_columns(&mut t.dense.robot, 4, ELBOW);
        },
        expected: Rejection::AnchorTranslation,
    },
    Damage {
        name: "a stale robot row while the object moves",
        inflict: |t| {
            let row = sample_of(t, 15) + 2;
            repeat_row(&mut t.dense.robot, row);
        },
        expected: Rejection::AnchorTranslation,
    },
    Damage {
        name: "not a number",
        inflict: |t| bend(&mut t.dense.robot, 3, ELBOW, f32::NAN),
        expected: Rejection::Malformed,
    },
    Damage {
        name: "twice as fast",
        inflict: |t| {
            t.dense.times_s.iter_mut().for_each(|time| *time *= 0.5);
            t.waypoint_interval_s *= 0.5;
        },
        expected: Rejection::VelocityLimit,
    },
    Damage {
        name: "path cut off",
        inflict: |t| t.dense = first_samples(&t.dense, t.dense.len() - 5),
        expected: Rejection::Malformed,
    },
    Damage {
        name: "ends before the goal",
        inflict: |t| {
            t.dense = first_samples(&t.dense, sample_of(t, 19) + 1);
            t.waypoints_robot = first_rows(&t.waypoints_robot, 20);
            t.waypoints_object = first_rows(&t.waypoints_object, 20);
        },
        expected: Rejection::ObjectMotion,
    },
    Damage {
        name: "the object opens by itself during the approach",
        inflict: |t| bend(&mut t.dense.object, 2, 0, 0.05),
        expected: Rejection::ObjectMotion,
    },
];

#[test]
fn damaged_trajectories_are_refused_for_the_right_reason() {
    let Some(Planned { judge, outcome, .. }) = planned() else { return };
    for trajectory in outcome.set.trajectories.iter().step_by(3) {
        assert!(judge.judge(trajectory).accepted());
        for damage in &DAMAGES {
            let mut damaged = trajectory.clone();
            (damage.inflict)(&mut damaged);
            let verdict = judge.judge(&damaged);
            let (name, id) = (damage.name, &trajectory.id);
            assert_eq!(
                verdict.rejection,
                Some(damage.expected),
                "{name}, {id}: {}",
                verdict.detail
            );
        }
    }
}
