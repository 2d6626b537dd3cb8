//! Objects that no joint holds: a block that is picked up and put down, and a screen that is pushed along the
//! floor; and what may be wrong with either.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[allow(dead_code, reason = "not every test needs all of it")]
mod common;

use akrobat_judge::{Judge, JudgeConfig};
use akrobat_model::pose::from_xyz_rpy;
use akrobat_model::task::{ManipulatedObject, ObjectKind, Task};
use akrobat_model::trajectory::{ContactException, DensePath, Grasp};
use akrobat_model::{
    JointPath, KinematicTree, Link, Phase, Pose, Rejection, Trajectory, Verdict, free_object,
};
use common::*;
use std::f64::consts::FRAC_PI_2;

const CLOSED: f64 = HANDLE_WIDTH_M / 2.0;
/// How far to the side the object is brought, and how far it is lifted on the way, metres.
const ASIDE_M: f64 = 0.6;
const LIFT_M: f64 = 0.1;
/// Height of the tool with the lift at zero, and of the stands, metres.
const TOOL_M: f64 = 0.5;
const STAND_M: f64 = 0.45;
const WAYPOINTS: u32 = 30;

/// Height of the object's underside at rest.
fn floor_of(kind: ObjectKind) -> f64 {
    if kind == ObjectKind::Rigid { STAND_M } else { 0.0 }
}

/// Pose of the object `aside` from its start and lifted by `up`.
fn pose_of(kind: ObjectKind, aside: f64, up: f64) -> Pose {
    from_xyz_rpy([0.05, aside, floor_of(kind) + up], [0.0; 3])
}

/// The block stands on one of two stands, the screen on the floor.
fn task_of(kind: ObjectKind, goal_up: f64) -> Task {
    let mut task = task();
    let height = TOOL_M + 0.05 - floor_of(kind);
    let part = block("block", [0.1, HANDLE_WIDTH_M, height], [0.0, 0.0, height / 2.0]);
    let link = Link { name: "block".into(), collisions: vec![part], ..Link::default() };
    let lone = KinematicTree::new("block".into(), vec![link], Vec::new()).unwrap();
    let start = pose_of(kind, 0.0, 0.0);
    let tree = free_object::with_virtual_joints(lone, kind, &start).unwrap();
    let goal = pose_of(kind, ASIDE_M, goal_up);
    let word = if kind == ObjectKind::Rigid { "rigid" } else { "planar" };
    let goal_row = akrobat_model::pose::to_xyz_wxyz(&goal);
    let toml = format!(
        "name = \"carry\"\n[robot]\nfile = \"beam.toml\"\n[object]\nkind = \"{word}\"\nurdf = \"block.urdf\"\n[goal]\nposes = [{goal_row:?}]\n"
    );
    task.file = toml::from_str(&toml).unwrap();
    task.toml = toml;
    task.object = ManipulatedObject {
        name: "block".into(),
        world_from_root: Pose::identity(),
        active_joint: tree.joint_index("object_x").unwrap(),
        handle_link: 0,
        handle_parts: vec!["block".into()],
        handle_region: None,
        start: free_object::positions(kind, &start),
        notes: Vec::new(),
        tree,
    };
    if kind == ObjectKind::Rigid {
        for (name, y) in [("first stand", 0.0), ("second stand", ASIDE_M)] {
            task.scene.bodies.push(body(name, [0.12, 0.12, STAND_M], [0.05, y, STAND_M / 2.0]));
        }
    }
    task
}

/// Three motions, one after the other, of which this is the progress of number `index`.
fn third(s: f64, index: usize) -> f64 {
    minimum_jerk((3.0 * s - index as f64).clamp(0.0, 1.0))
}

fn trajectory_of(kind: ObjectKind, down_m: f64) -> Trajectory {
    let lift_m = if kind == ObjectKind::Rigid { LIFT_M } else { 0.0 };
    let columns = free_object::joint_names(kind).len();
    let mut dense = DensePath {
        robot: JointPath::new(7),
        object: JointPath::new(columns),
        ..DensePath::default()
    };
    // The tool holds the object 3 cm behind its middle.
    let row = |aside: f64, up: f64, back: f64, finger: f64| {
        [0.02 - 0.8 - back, aside, 0.0, up, 0.0, finger, finger]
    };
    let mut time_s = 0.0;
    let mut add = |dense: &mut DensePath, dt: f64, row: [f64; 7], object: Pose, phase: Phase| {
        time_s += dt;
        dense.push(time_s, row, free_object::positions(kind, &object), phase);
    };
    let start = pose_of(kind, 0.0, 0.0);
    add(&mut dense, 0.0, row(0.0, 0.0, 0.3, OPEN), start, Phase::Approach);
    for k in 1..=80 {
        let back = 0.3 * (1.0 - minimum_jerk(f64::from(k) / 80.0));
        add(&mut dense, 0.025, row(0.0, 0.0, back, OPEN), start, Phase::Approach);
    }
    for k in 1..=20 {
        let finger = OPEN + (CLOSED - OPEN) * minimum_jerk(f64::from(k) / 20.0);
        add(&mut dense, 0.025, row(0.0, 0.0, 0.0, finger), start, Phase::Grasp);
    }
    let manipulation_start = dense.len() as u32 - 1;
    let steps = (WAYPOINTS - 1) * SUBSTEPS;
    for k in 1..=steps {
        let s = f64::from(k) / f64::from(steps);
        let up = lift_m * third(s, 0) - down_m * third(s, 2);
        let aside = ASIDE_M * third(s, 1);
        let row = row(aside, up, 0.0, CLOSED);
        add(&mut dense, 0.04, row, pose_of(kind, aside, up), Phase::Manipulate);
    }
    let (up, end) = (lift_m - down_m, pose_of(kind, ASIDE_M, lift_m - down_m));
    for k in 1..=20 {
        let finger = CLOSED + (OPEN - CLOSED) * minimum_jerk(f64::from(k) / 20.0);
        add(&mut dense, 0.025, row(ASIDE_M, up, 0.0, finger), end, Phase::Release);
    }
    for k in 1..=80 {
        let back = 0.3 * minimum_jerk(f64::from(k) / 80.0);
        add(&mut dense, 0.025, row(ASIDE_M, up, back, OPEN), end, Phase::Release);
    }
    let mut trajectory = Trajectory {
        id: "carried".into(),
        seed: 0,
        grasp: Grasp {
            id: 0,
            link: "block".into(),
            link_from_tool: from_xyz_rpy(
                [-0.03, 0.0, TOOL_M - floor_of(kind)],
                [0.0, FRAC_PI_2, 0.0],
            ),
            width_m: HANDLE_WIDTH_M,
        },
        start: 0.05,
        goal: 0.05,
        waypoints_robot: JointPath::new(7),
        waypoints_object: JointPath::new(columns),
        waypoint_interval_s: 0.04 * f64::from(SUBSTEPS),
        manipulation_start,
        substeps: SUBSTEPS,
        regrasps: Vec::new(),
        dense,
        verdict: None,
    };
    for waypoint in 0..WAYPOINTS as usize {
        let sample = trajectory.waypoint_sample(waypoint);
        trajectory.waypoints_robot.push(trajectory.dense.robot.row_f64(sample));
        trajectory.waypoints_object.push(trajectory.dense.object.row_f64(sample));
    }
    trajectory
}

fn judged(task: &Task, trajectory: &Trajectory, config: JudgeConfig) -> Verdict {
    let exceptions = ["left_finger", "right_finger"].map(|finger| ContactException {
        robot_link: finger.into(),
        object_link: "block".into(),
        object_part: "block".into(),
    });
    Judge::new(task, &spheres(), &exceptions, config).unwrap().judge(trajectory)
}

fn verdict(kind: ObjectKind, edit: impl Fn(&mut Task, &mut Trajectory)) -> Verdict {
    let down_m = if kind == ObjectKind::Rigid { LIFT_M } else { 0.0 };
    let (mut task, mut trajectory) = (task_of(kind, 0.0), trajectory_of(kind, down_m));
    edit(&mut task, &mut trajectory);
    judged(&task, &trajectory, JudgeConfig::default())
}

fn refuses(kind: ObjectKind, reason: Rejection, edit: impl Fn(&mut Task, &mut Trajectory)) {
    let verdict = verdict(kind, edit);
    assert_eq!(verdict.rejection, Some(reason), "{verdict:?}");
}

/// A waypoint in the middle of the way, and its dense sample.
fn middle(t: &Trajectory) -> (usize, usize) {
    (14, t.waypoint_sample(14))
}

/// Changes one column of the object at a waypoint.
fn shift_object(t: &mut Trajectory, (waypoint, sample): (usize, usize), column: usize, by: f32) {
    let columns = t.dense.object.columns();
    t.dense.object.values_mut()[sample * columns + column] += by;
    t.waypoints_object.values_mut()[waypoint * columns + column] += by;
}

#[test]
fn accepts_both_kinds() {
    for kind in [ObjectKind::Rigid, ObjectKind::Planar] {
        let verdict = verdict(kind, |_, _| {});
        assert!(verdict.accepted(), "{kind:?}: {}", verdict.detail);
    }
}

#[test]
fn the_object_stays_in_the_hand() {
    for (kind, column) in [(ObjectKind::Rigid, 2), (ObjectKind::Planar, 0)] {
        refuses(kind, Rejection::AnchorTranslation, |_, t| {
            shift_object(t, middle(t), column, 0.005);
        });
        let yaw = if kind == ObjectKind::Rigid { 3 } else { 2 };
        refuses(kind, Rejection::AnchorRotation, |_, t| {
            t.grasp.link_from_tool *= from_xyz_rpy([0.0; 3], [0.02, 0.0, 0.0]);
        });
        refuses(kind, Rejection::AnchorRotation, |_, t| {
            // About the tool's own place: only the angle is wrong.
            let at = t.grasp.link_from_tool.translation.vector;
            let (sin, cos) = 0.02f64.sin_cos();
            shift_object(t, middle(t), yaw, 0.02);
            shift_object(t, middle(t), 0, (at.x - cos * at.x) as f32);
            shift_object(t, middle(t), 1, (-sin * at.x) as f32);
        });
    }
}

#[test]
fn the_goal_must_be_reached() {
    for kind in [ObjectKind::Rigid, ObjectKind::Planar] {
        refuses(kind, Rejection::ObjectMotion, |task, _| task.file.goal.poses[0][1] += 0.002);
        let near = verdict(kind, |task, _| task.file.goal.poses[0][1] += 0.0005);
        assert!(near.accepted(), "{}", near.detail);
        refuses(kind, Rejection::ObjectMotion, |task, _| {
            let turned = from_xyz_rpy([0.0; 3], [0.0, 0.0, 0.02]);
            let [_, _, _, w, x, y, z] = akrobat_model::pose::to_xyz_wxyz(&turned);
            task.file.goal.poses[0][3..].copy_from_slice(&[w, x, y, z]);
        });
    }
}

#[test]
fn the_object_rests_before_and_after() {
    for kind in [ObjectKind::Rigid, ObjectKind::Planar] {
        for column in 0..free_object::joint_names(kind).len() {
            let nudge = |t: &mut Trajectory, sample: usize| {
                let columns = t.dense.object.columns();
                t.dense.object.values_mut()[sample * columns + column] += 0.001;
            };
            refuses(kind, Rejection::ObjectMotion, |_, t| nudge(t, 40));
            refuses(kind, Rejection::ObjectMotion, |_, t| nudge(t, t.dense.len() - 5));
        }
        refuses(kind, Rejection::ObjectMotion, |task, _| task.object.start[1] += 0.002);
    }
}

#[test]
fn nothing_hangs_in_the_air() {
    // Let go of 3 cm above the second stand, although the goal says so.
    let (task, trajectory) =
        (task_of(ObjectKind::Rigid, 0.03), trajectory_of(ObjectKind::Rigid, LIFT_M - 0.03));
    let verdict = judged(&task, &trajectory, JudgeConfig::default());
    assert_eq!(verdict.rejection, Some(Rejection::Unsupported), "{}", verdict.detail);
    for stand in ["first stand", "second stand"] {
        refuses(ObjectKind::Rigid, Rejection::Unsupported, |task, _| {
            task.scene.bodies.retain(|body| body.name != stand);
        });
    }
}

#[test]
fn the_hand_lets_go_before_it_leaves() {
    for kind in [ObjectKind::Rigid, ObjectKind::Planar] {
        refuses(kind, Rejection::Grip, |_, t| {
            for sample in t.manipulation_samples().end() + 1..t.dense.len() {
                let row = &mut t.dense.robot.values_mut()[sample * 7..][..7];
                (row[5], row[6]) = (CLOSED as f32, CLOSED as f32);
            }
        });
    }
}

#[test]
fn a_planar_object_is_neither_lifted_nor_tilted() {
    // With the hand's own tolerances wide open, so that nothing else refuses.
    let loose = JudgeConfig {
        anchor_translation_m: 0.01,
        anchor_rotation_rad: 0.1,
        ..JudgeConfig::default()
    };
    let with = |edit: &dyn Fn(&mut Trajectory)| {
        let mut trajectory = trajectory_of(ObjectKind::Planar, 0.0);
        edit(&mut trajectory);
        judged(&task_of(ObjectKind::Planar, 0.0), &trajectory, loose)
    };
    assert!(with(&|_| {}).accepted());
    // A swell of the lift over the way.
    let lift = |t: &mut Trajectory, height: f64| {
        let range = t.manipulation_samples();
        for sample in range.clone() {
            let s = (sample - range.start()) as f64 / (range.end() - range.start()) as f64;
            let up = height * (std::f64::consts::PI * s).sin().powi(3);
            t.dense.robot.values_mut()[sample * 7 + LIFT] += up as f32;
        }
        for waypoint in 0..WAYPOINTS as usize {
            let lift = t.dense.robot.row(t.waypoint_sample(waypoint))[LIFT];
            t.waypoints_robot.values_mut()[waypoint * 7 + LIFT] = lift;
        }
    };
    let lifted = with(&|t| lift(t, 0.002));
    assert_eq!(lifted.rejection, Some(Rejection::LeftPlane), "{}", lifted.detail);
    assert!(with(&|t| lift(t, 0.0008)).accepted());
    let tilt = |t: &mut Trajectory, angle: f64| {
        t.grasp.link_from_tool *= from_xyz_rpy([0.0; 3], [0.0, 0.0, angle]);
    };
    let tilted = with(&|t| tilt(t, 0.02));
    assert_eq!(tilted.rejection, Some(Rejection::LeftPlane), "{}", tilted.detail);
    assert!(with(&|t| tilt(t, 0.001)).accepted());
}

#[test]
fn nothing_is_hit_with_the_object() {
    for kind in [ObjectKind::Rigid, ObjectKind::Planar] {
        // In the block's way, out of the fingers'.
        refuses(kind, Rejection::ObjectCollision, |task, _| {
            let post = body("post", [0.02, 0.05, 1.2], [0.09, ASIDE_M / 2.0, 0.6]);
            task.scene.bodies.push(post);
        });
    }
}
