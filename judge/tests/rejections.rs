//! Broken trajectories, each of which must be refused for the right reason.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[allow(dead_code, reason = "not every test needs all of it")]
mod common;

use akrobat_judge::{Judge, JudgeConfig, JudgeError, RobotSphere};
use akrobat_model::task::Task;
use akrobat_model::trajectory::ContactException;
use akrobat_model::{Phase, Rejection, Trajectory, Verdict, pose};
use common::*;

fn judge(task: &Task) -> Judge {
    Judge::new(task, &spheres(), &exceptions(), JudgeConfig::default()).unwrap()
}

fn verdict_in(task: &Task, edit: impl Fn(&mut Trajectory)) -> Verdict {
    let mut trajectory = trajectory();
    edit(&mut trajectory);
    judge(task).judge(&trajectory)
}

/// The edited trajectory is refused for `reason`; the one before the edit is not.
fn refuses(reason: Rejection, edit: impl Fn(&mut Trajectory)) -> Verdict {
    let task = task();
    let before = verdict_in(&task, |_| {});
    assert_eq!(before.rejection, None, "{}", before.detail);
    let verdict = verdict_in(&task, edit);
    assert_eq!(verdict.rejection, Some(reason), "{verdict:?}");
    assert!(!verdict.detail.is_empty());
    verdict
}

/// With another body in the scene, the trajectory is refused for `reason`.
fn refuses_with_body(
    reason: Rejection,
    body: akrobat_model::SceneBody,
    spheres: &[RobotSphere],
) -> Verdict {
    let mut task = task();
    let name = body.name.clone();
    task.scene.bodies.push(body);
    let judge = Judge::new(&task, spheres, &exceptions(), JudgeConfig::default()).unwrap();
    let verdict = judge.judge(&trajectory());
    assert_eq!(verdict.rejection, Some(reason), "{verdict:?}");
    assert!(verdict.detail.contains(&name), "{}", verdict.detail);
    verdict
}

fn middle(trajectory: &Trajectory) -> usize {
    let range = trajectory.manipulation_samples();
    // A waypoint near the fastest part.
    range.start() + 14 * trajectory.substeps as usize
}

#[test]
fn accepts_what_is_right_and_measures_it() {
    let verdict = judge(&task()).judge(&trajectory());
    assert!(verdict.accepted(), "{}", verdict.detail);
    assert!(
        verdict.anchor_translation_m > 0.0 && verdict.anchor_translation_m < 1e-4,
        "{verdict:?}"
    );
    assert!(verdict.anchor_rotation_rad < 1e-5);
    assert!((verdict.base_yaw_rad - GOALS[0]).abs() < 1e-4);
    assert!(verdict.velocity_fraction > 0.1 && verdict.velocity_fraction < 1.0);
    assert!(verdict.acceleration_fraction > 0.01 && verdict.acceleration_fraction < 1.0);
    assert!(verdict.penetration_m < 5e-3);
    assert_eq!(verdict.samples as usize, 2 * trajectory().dense.len() - 1);
}

#[test]
fn one_bad_waypoint() {
    let verdict = refuses(Rejection::AnchorTranslation, |t| {
        let sample = middle(t);
        edit_robot(t, sample, |row| row[X] += 0.005);
    });
    assert!((verdict.anchor_translation_m - 0.005).abs() < 1e-4);
}

#[test]
fn one_bad_sample_between_waypoints() {
    refuses(Rejection::AnchorTranslation, |t| {
        let sample = middle(t) + 2;
        edit_robot(t, sample, |row| row[X] += 0.005);
    });
}

#[test]
fn perturbed_grasp_reference() {
    refuses(Rejection::AnchorTranslation, |t| t.grasp.link_from_tool.translation.x += 0.002);
    let verdict = refuses(Rejection::AnchorRotation, |t| {
        t.grasp.link_from_tool *= pose::from_xyz_rpy([0.0; 3], [0.0, 0.0, 0.02]);
    });
    assert!((verdict.anchor_rotation_rad - 0.02).abs() < 1e-4);
    // Negative control: a tenth of either is within tolerance.
    let small = verdict_in(&task(), |t| {
        t.grasp.link_from_tool.translation.x += 0.0002;
        t.grasp.link_from_tool *= pose::from_xyz_rpy([0.0; 3], [0.0, 0.0, 0.002]);
    });
    assert!(small.accepted(), "{}", small.detail);
}

#[test]
fn swapped_joints() {
    refuses(Rejection::AnchorTranslation, |t| {
        for path in [&mut t.dense.robot, &mut t.waypoints_robot] {
            path.values_mut().chunks_exact_mut(7).for_each(|row| row.swap(0, 1));
        }
    });
}

#[test]
fn stale_robot_row_while_the_object_moves() {
    refuses(Rejection::AnchorTranslation, |t| {
        let sample = middle(t) + 1;
        let before: Vec<f32> = t.dense.robot.row(sample - 1).to_vec();
        edit_robot(t, sample, |row| row.copy_from_slice(&before));
    });
}

#[test]
fn stale_forward_kinematics() {
    // The whole robot path lags one sample behind the object.
    refuses(Rejection::AnchorTranslation, |t| {
        for sample in t.manipulation_samples().skip(1).collect::<Vec<_>>().into_iter().rev() {
            let before: Vec<f32> = t.dense.robot.row(sample - 1).to_vec();
            edit_robot(t, sample, |row| row.copy_from_slice(&before));
        }
    });
}

#[test]
fn values_that_are_not_numbers() {
    refuses(Rejection::Malformed, |t| t.dense.robot.values_mut()[10] = f32::NAN);
    refuses(Rejection::Malformed, |t| t.dense.object.values_mut()[10] = f32::INFINITY);
    refuses(Rejection::Malformed, |t| t.waypoints_robot.values_mut()[10] = f32::NAN);
    refuses(Rejection::Malformed, |t| t.dense.times_s[5] = f64::NAN);
    refuses(Rejection::Malformed, |t| t.goal = f64::NAN);
    refuses(Rejection::Malformed, |t| t.grasp.link_from_tool.translation.y = f64::NAN);
}

#[test]
fn arrays_that_do_not_fit_together() {
    refuses(Rejection::Malformed, |t| t.dense.times_s.swap(7, 8));
    refuses(Rejection::Malformed, |t| t.dense.times_s.truncate(9));
    refuses(Rejection::Malformed, |t| {
        t.dense.phase.pop();
    });
    refuses(Rejection::Malformed, |t| t.dense.object = akrobat_model::JointPath::new(1));
    refuses(Rejection::Malformed, |t| t.manipulation_start += 1);
    refuses(Rejection::Malformed, |t| t.manipulation_start = u32::MAX - 500);
    refuses(Rejection::Malformed, |t| t.substeps = 4);
    refuses(Rejection::Malformed, |t| t.grasp.link = "no such link".into());
    refuses(Rejection::Malformed, |t| t.dense.phase[120] = Phase::Approach);
    refuses(Rejection::Malformed, |t| t.dense.phase[20] = Phase::Release);
    refuses(Rejection::Malformed, |t| t.dense = akrobat_model::trajectory::DensePath::default());
}

#[test]
fn waypoint_that_is_not_on_the_dense_path() {
    refuses(Rejection::Malformed, |t| t.waypoints_robot.values_mut()[12 * 7 + LIFT] += 1e-3);
    refuses(Rejection::Malformed, |t| t.waypoints_object.values_mut()[12 * 2] += 1e-3);
}

#[test]
fn object_that_does_not_reach_its_goal() {
    let judge = judge(&task());
    let short = judge.judge(&trajectory_with(GOALS[0], 0.95, 0.01));
    assert_eq!(short.rejection, Some(Rejection::ObjectMotion), "{}", short.detail);
    // A goal of its own choosing does not help.
    let modest = judge.judge(&trajectory_with(0.95, 0.95, 0.01));
    assert_eq!(modest.rejection, Some(Rejection::ObjectMotion), "{}", modest.detail);
}

#[test]
fn object_that_moves_when_it_should_not() {
    refuses(Rejection::ObjectMotion, |t| t.dense.object.values_mut()[30 * 2] = 0.01);
    // The other joint.
    refuses(Rejection::ObjectMotion, |t| {
        t.dense.object.values_mut().chunks_exact_mut(2).for_each(|row| row[1] = 0.01);
        t.waypoints_object.values_mut().chunks_exact_mut(2).for_each(|row| row[1] = 0.01);
    });
}

#[test]
fn joint_beyond_its_position_limit() {
    let verdict = refuses(Rejection::PositionLimit, |t| bump_approach(t, LIFT, 0.31));
    assert!(verdict.detail.contains("lift"), "{}", verdict.detail);
    assert!(verdict_in(&task(), |t| bump_approach(t, LIFT, 0.29)).accepted());
}

#[test]
fn too_fast() {
    let verdict = refuses(Rejection::VelocityLimit, |t| {
        t.dense.times_s.iter_mut().for_each(|time| *time *= 0.3);
    });
    assert!(verdict.velocity_fraction > 1.01);
}

#[test]
fn too_abrupt() {
    let verdict = refuses(Rejection::AccelerationLimit, |t| {
        (20..40).for_each(|sample| edit_robot(t, 2 * sample, |row| row[LIFT] += 0.005));
    });
    assert!(verdict.acceleration_fraction > 1.01 && verdict.velocity_fraction < 1.0);
    // A path that is still moving at its last sample cannot be executed either.
    refuses(Rejection::AccelerationLimit, |t| {
        let start = 40;
        t.dense.times_s.drain(..start);
        let first = t.dense.times_s[0];
        t.dense.times_s.iter_mut().for_each(|time| *time = (*time - first) / 1.5);
        t.dense.phase.drain(..start);
        t.dense.robot =
            akrobat_model::JointPath::from_values(7, t.dense.robot.values()[start * 7..].to_vec())
                .unwrap();
        t.dense.object =
            akrobat_model::JointPath::from_values(2, t.dense.object.values()[start * 2..].to_vec())
                .unwrap();
        t.manipulation_start -= start as u32;
    });
}

#[test]
fn base_that_turns_too_far() {
    let verdict = judge(&task()).judge(&trajectory_with(GOALS[1], GOALS[1], 0.01));
    assert_eq!(verdict.rejection, Some(Rejection::BaseYaw), "{}", verdict.detail);
    assert!((verdict.base_yaw_rad - GOALS[1]).abs() < 1e-3);
}

#[test]
fn beam_through_a_wall() {
    // A thin vertical board in the way of the beam.
    let board = || body("board", [0.3, 0.002, 0.3], [-0.8, 0.5, 0.5]);
    refuses_with_body(Rejection::SphereCollision, board(), &spheres());
    let verdict = refuses_with_body(Rejection::MeshPenetration, board(), &[]);
    assert!(verdict.penetration_m > 0.02);
}

#[test]
fn board_that_is_not_a_closed_body() {
    // The same board as two bare triangles: only its surface against the robot's solids can tell.
    let mut board = body("sheet", [1.0; 3], [-0.8, 0.5, 0.5]);
    let sheet = akrobat_model::TriMesh {
        positions: vec![
            [-0.15, 0.0, -0.15],
            [0.15, 0.0, -0.15],
            [0.15, 0.0, 0.15],
            [-0.15, 0.0, 0.15],
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..akrobat_model::TriMesh::default()
    };
    board.visuals[0].shape = akrobat_model::Shape::Mesh {
        source: "sheet".into(),
        meshes: std::sync::Arc::new(vec![sheet]),
    };
    refuses_with_body(Rejection::SphereCollision, board.clone(), &spheres());
    refuses_with_body(Rejection::MeshPenetration, board, &[]);
}

#[test]
fn sphere_that_touches_a_box() {
    // During the grasp the beam's spheres reach z = 0.54 at y = -0.2; the beam itself only 0.53.
    let task_with = |bottom: f64| {
        let mut task = task();
        task.scene.bodies.push(body("lamp", [0.02, 0.02, 0.1], [-0.58, -0.2, bottom + 0.05]));
        task
    };
    let touching = judge(&task_with(0.537)).judge(&trajectory());
    assert_eq!(touching.rejection, Some(Rejection::SphereCollision), "{}", touching.detail);
    let clear = judge(&task_with(0.541)).judge(&trajectory());
    assert!(clear.accepted(), "{}", clear.detail);
}

#[test]
fn beam_into_its_own_chassis() {
    let low = |t: &mut Trajectory| bump_approach(t, LIFT, -0.25);
    refuses(Rejection::SphereCollision, low);
    let mut trajectory = trajectory();
    low(&mut trajectory);
    let judge = Judge::new(&task(), &[], &exceptions(), JudgeConfig::default()).unwrap();
    let verdict = judge.judge(&trajectory);
    assert_eq!(verdict.rejection, Some(Rejection::MeshPenetration), "{}", verdict.detail);
    assert!(
        verdict.detail.contains("chassis") && verdict.detail.contains("beam"),
        "{}",
        verdict.detail
    );
}

#[test]
fn only_listed_pairs_may_touch() {
    let squeezing = trajectory_with(GOALS[0], GOALS[0], 0.002);
    let task = task();
    let config = JudgeConfig::default();
    assert!(judge(&task).judge(&squeezing).accepted());
    let strict = Judge::new(&task, &spheres(), &exceptions()[..1], config).unwrap();
    let verdict = strict.judge(&squeezing);
    assert_eq!(verdict.rejection, Some(Rejection::MeshPenetration), "{}", verdict.detail);
    assert!(verdict.detail.contains("right_finger") && verdict.detail.contains("handle"));
}

#[test]
fn exceptions_end_where_the_handle_does() {
    let squeezing = trajectory_with(GOALS[0], GOALS[0], 0.002);
    let mut task = task();
    task.object.handle_region = Some([-0.1, -0.6, 0.3, -0.03, -0.4, 0.7]);
    assert!(judge(&task).judge(&squeezing).accepted());
    task.object.handle_region = Some([-0.1, -0.6, 0.6, -0.03, -0.4, 0.7]);
    let verdict = judge(&task).judge(&squeezing);
    assert_eq!(verdict.rejection, Some(Rejection::MeshPenetration), "{}", verdict.detail);
}

#[test]
fn door_that_swings_into_a_shelf() {
    refuses_with_body(
        Rejection::ObjectCollision,
        body("shelf", [0.1, 0.1, 0.06], [-0.3, 0.1, 0.72]),
        &spheres(),
    );
}

#[test]
fn cabinet_built_into_a_counter_may_stay_so() {
    let mut task = task();
    // It is 1 cm inside the closed door's upper edge, from above.
    task.scene.bodies.push(body("counter", [0.64, 0.8, 0.02], [0.29, 0.0, 0.79]));
    let verdict = judge(&task).judge(&trajectory());
    assert!(verdict.accepted(), "{}", verdict.detail);
}

#[test]
fn impossible_judges_are_refused() {
    let task = task();
    let config = JudgeConfig::default();
    let on_nothing = RobotSphere { link: 99, center: [0.0; 3], radius: 0.1 };
    assert!(matches!(
        Judge::new(&task, &[on_nothing], &[], config),
        Err(JudgeError::Sphere { index: 0, .. })
    ));
    let inverted = RobotSphere { link: 1, center: [0.0; 3], radius: -0.1 };
    assert!(matches!(Judge::new(&task, &[inverted], &[], config), Err(JudgeError::Sphere { .. })));
    for (link, part) in [("left_fingr", "handle"), ("left_finger", "handel")] {
        let misspelt = ContactException {
            robot_link: link.into(),
            object_link: "door".into(),
            object_part: part.into(),
        };
        assert!(matches!(Judge::new(&task, &[], &[misspelt], config), Err(JudgeError::Name(_))));
    }
    let negative = JudgeConfig { penetration_m: -1.0, ..config };
    assert!(matches!(Judge::new(&task, &[], &[], negative), Err(JudgeError::Config { .. })));
}

#[test]
fn says_what_it_does_not_look_at() {
    let judge = judge(&task());
    assert!(judge.notes().iter().any(|note| note.contains("floor")), "{:?}", judge.notes());
}
