//! A door opened with two grasps, one after the other, and what may be wrong with the change.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

#[allow(dead_code, reason = "not every test needs all of it")]
mod common;

use akrobat_judge::{Judge, JudgeConfig};
use akrobat_model::trajectory::{DensePath, Grasp, Regrasp};
use akrobat_model::{JointPath, Phase, Rejection, Trajectory, Verdict};
use common::*;

const CLOSED: f64 = HANDLE_WIDTH_M / 2.0;
/// How much higher the second grasp holds the handle, metres.
const HIGHER_M: f64 = 0.03;
const FIRST_WAYPOINTS: u32 = 14;
const SECOND_WAYPOINTS: u32 = 16;

struct Path {
    dense: DensePath,
    time_s: f64,
}

impl Path {
    /// Adds `count` samples of a motion from rest to rest; `state` gives door angle, distance back from the
    /// handle, lift and finger position at progress 0 to 1.
    fn add(&mut self, count: u32, step_s: f64, phase: Phase, state: impl Fn(f64) -> [f64; 4]) {
        for k in 1..=count {
            self.time_s += step_s;
            self.push(state(minimum_jerk(f64::from(k) / f64::from(count))), phase);
        }
    }

    fn push(&mut self, [angle, back, lift, finger]: [f64; 4], phase: Phase) {
        let [x, y, yaw] = base_at(angle);
        let (x, y) = (x - back * angle.cos(), y + back * angle.sin());
        let row = [x, y, yaw, lift, 0.0, finger, finger];
        self.dense.push(self.time_s, row, [angle, 0.0], phase);
    }

    fn at(&self) -> u32 {
        self.dense.len() as u32 - 1
    }
}

/// Opens the door to `change` with one grasp and to `goal` with another.
fn regrasped(change: f64, goal: f64) -> Trajectory {
    let dense =
        DensePath { robot: JointPath::new(7), object: JointPath::new(2), ..DensePath::default() };
    let mut path = Path { dense, time_s: 0.0 };
    path.push([0.0, 0.3, 0.0, OPEN], Phase::Approach);
    path.add(80, 0.025, Phase::Approach, |s| [0.0, 0.3 * (1.0 - s), 0.0, OPEN]);
    path.add(20, 0.025, Phase::Grasp, |s| [0.0, 0.0, 0.0, OPEN + (CLOSED - OPEN) * s]);
    let manipulation_start = path.at();
    let step_s = WAYPOINT_INTERVAL_S / f64::from(SUBSTEPS);
    let first_steps = (FIRST_WAYPOINTS - 1) * SUBSTEPS;
    path.add(first_steps, step_s, Phase::Manipulate, |s| [change * s, 0.0, 0.0, CLOSED]);
    let fingers = |s: f64| CLOSED + (OPEN - CLOSED) * s;
    path.add(20, 0.025, Phase::Regrasp, |s| [change, 0.0, 0.0, fingers(s)]);
    path.add(40, 0.025, Phase::Regrasp, |s| [change, 0.15 * s, 0.0, OPEN]);
    path.add(40, 0.025, Phase::Regrasp, |s| [change, 0.15, HIGHER_M * s, OPEN]);
    path.add(40, 0.025, Phase::Regrasp, |s| [change, 0.15 * (1.0 - s), HIGHER_M, OPEN]);
    path.add(20, 0.025, Phase::Regrasp, |s| [change, 0.0, HIGHER_M, fingers(1.0 - s)]);
    let dense_start = path.at();
    let second_steps = (SECOND_WAYPOINTS - 1) * SUBSTEPS;
    let angle = |s: f64| change + (goal - change) * s;
    path.add(second_steps, step_s, Phase::Manipulate, |s| [angle(s), 0.0, HIGHER_M, CLOSED]);

    let mut higher = grasp();
    higher.id = 1;
    higher.link_from_tool.translation.z += HIGHER_M;
    let mut trajectory = Trajectory {
        id: "regrasped".into(),
        seed: 0,
        grasp: grasp(),
        start: 0.0,
        goal,
        waypoints_robot: JointPath::new(7),
        waypoints_object: JointPath::new(2),
        waypoint_interval_s: WAYPOINT_INTERVAL_S,
        manipulation_start,
        substeps: SUBSTEPS,
        regrasps: vec![Regrasp { first_waypoint: FIRST_WAYPOINTS, dense_start, grasp: higher }],
        dense: path.dense,
        verdict: None,
    };
    for waypoint in 0..FIRST_WAYPOINTS + SECOND_WAYPOINTS {
        let sample = trajectory.waypoint_sample(waypoint as usize);
        trajectory.waypoints_robot.push(trajectory.dense.robot.row_f64(sample));
        trajectory.waypoints_object.push(trajectory.dense.object.row_f64(sample));
    }
    trajectory
}

fn verdict(edit: impl Fn(&mut Trajectory)) -> Verdict {
    let mut trajectory = regrasped(0.5, GOALS[0]);
    edit(&mut trajectory);
    let judge = Judge::new(&task(), &spheres(), &exceptions(), JudgeConfig::default()).unwrap();
    judge.judge(&trajectory)
}

fn refuses(reason: Rejection, edit: impl Fn(&mut Trajectory)) {
    let verdict = verdict(edit);
    assert_eq!(verdict.rejection, Some(reason), "{verdict:?}");
}

/// Dense samples between the two grasps.
fn between(t: &Trajectory) -> std::ops::Range<usize> {
    let segments = t.segments();
    segments[0].samples.end() + 1..*segments[1].samples.start()
}

#[test]
fn accepts_a_change_of_grasp() {
    let verdict = verdict(|_| {});
    assert!(verdict.accepted(), "{}", verdict.detail);
    assert!(verdict.anchor_translation_m < 1e-4);
}

#[test]
fn each_grasp_has_its_own_turn_of_the_base() {
    // With one grasp the base would turn by more than it may: see `base_that_turns_too_far`.
    let judge = Judge::new(&task(), &spheres(), &exceptions(), JudgeConfig::default()).unwrap();
    let mut slow = regrasped(1.1, GOALS[1]);
    slow.dense.times_s.iter_mut().for_each(|time| *time *= 1.5);
    let verdict = judge.judge(&slow);
    assert!(verdict.accepted(), "{}", verdict.detail);
    assert!((verdict.base_yaw_rad - 1.1).abs() < 1e-3, "{verdict:?}");
}

#[test]
fn each_grasp_is_judged_by_itself() {
    refuses(Rejection::AnchorTranslation, |t| t.regrasps[0].grasp = grasp());
    refuses(Rejection::AnchorTranslation, |t| {
        t.regrasps[0].grasp.link_from_tool.translation.x += 0.002;
    });
    refuses(Rejection::AnchorTranslation, |t| t.grasp.link_from_tool.translation.x += 0.002);
    refuses(Rejection::Malformed, |t| t.regrasps[0].grasp.link = "dor".into());
    refuses(Rejection::Malformed, |t| {
        t.regrasps[0].grasp.link_from_tool.translation.x = f64::NAN;
    });
}

#[test]
fn the_hand_must_open_before_it_leaves() {
    refuses(Rejection::Grip, |t| {
        for sample in between(t) {
            let row = &mut t.dense.robot.values_mut()[sample * 7..][..7];
            row[5] = CLOSED as f32;
            row[6] = CLOSED as f32;
        }
    });
    // Hardly wider than the handle is not open.
    refuses(Rejection::Grip, |t| {
        for sample in between(t) {
            let row = &mut t.dense.robot.values_mut()[sample * 7..][..7];
            row[5] = row[5].min(CLOSED as f32 + 0.001);
            row[6] = row[6].min(CLOSED as f32 + 0.001);
        }
    });
}

#[test]
fn the_hand_must_close_before_it_pulls() {
    refuses(Rejection::Grip, |t| {
        let segment = t.segments()[1].samples.clone();
        for sample in segment {
            t.dense.robot.values_mut()[sample * 7 + 5] = OPEN as f32;
        }
        for waypoint in FIRST_WAYPOINTS as usize..30 {
            t.waypoints_robot.values_mut()[waypoint * 7 + 5] = OPEN as f32;
        }
    });
}

#[test]
fn the_object_rests_while_nobody_holds_it() {
    refuses(Rejection::ObjectMotion, |t| {
        let middle = between(t).nth(60).unwrap();
        t.dense.object.values_mut()[middle * 2] += 0.01;
    });
    // Nor may it be elsewhere when the second grasp takes over.
    refuses(Rejection::ObjectMotion, |t| {
        let first = *t.segments()[1].samples.start();
        t.dense.object.values_mut()[first * 2] -= 2e-4;
        t.waypoints_object.values_mut()[FIRST_WAYPOINTS as usize * 2] -= 2e-4;
    });
}

#[test]
fn nothing_is_hit_on_the_way_to_the_second_grasp() {
    let post_at = |x: f64| {
        let mut task = task();
        // Where the mast is when the hand is farthest back, or half a metre behind that.
        let [base_x, base_y, _] = base_at(0.5);
        let (x, y) = (base_x - x * 0.5f64.cos(), base_y + x * 0.5f64.sin());
        task.scene.bodies.push(body("post", [0.05, 0.05, 1.0], [x, y, 0.5]));
        let judge = Judge::new(&task, &spheres(), &exceptions(), JudgeConfig::default()).unwrap();
        judge.judge(&regrasped(0.5, GOALS[0]))
    };
    let hit = post_at(0.35);
    assert_eq!(hit.rejection, Some(Rejection::MeshPenetration), "{}", hit.detail);
    assert!(hit.detail.contains("post") && hit.detail.contains("Regrasp"), "{}", hit.detail);
    let clear = post_at(0.8);
    assert!(clear.accepted(), "{}", clear.detail);
}

#[test]
fn the_parts_must_fit_together() {
    refuses(Rejection::Malformed, |t| t.regrasps[0].first_waypoint = 1);
    refuses(Rejection::Malformed, |t| t.regrasps[0].first_waypoint = 29);
    refuses(Rejection::Malformed, |t| t.regrasps[0].first_waypoint = 40);
    refuses(Rejection::Malformed, |t| t.regrasps[0].dense_start = 3);
    refuses(Rejection::Malformed, |t| t.regrasps[0].dense_start += 1);
    refuses(Rejection::Malformed, |t| t.regrasps.clear());
    refuses(Rejection::Malformed, |t| {
        let sample = between(t).start;
        t.dense.phase[sample] = Phase::Manipulate;
    });
    refuses(Rejection::Malformed, |t| {
        t.dense.phase[10] = Phase::Regrasp;
    });
    let spare = |id| Grasp { id, ..grasp() };
    refuses(Rejection::Malformed, |t| {
        let dense_start = t.regrasps[0].dense_start;
        t.regrasps.push(Regrasp { first_waypoint: 20, dense_start, grasp: spare(2) });
    });
}
