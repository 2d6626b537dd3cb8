//! Phases laid out in time, and what identifies and describes a trajectory.

use akrobat_model::trajectory::{DensePath, Grasp, Phase, Regrasp, Trajectory, TrajectoryHeader};
use akrobat_model::{JointPath, hash};

use super::{Pair, Run};
use crate::approach::{Approach, Timed, Transfer};
use crate::config::PlannerConfig;
use crate::dense::Limits;
use crate::trajopt::{Waypoints, smooth};

/// Time step of sampled finger motion, seconds.
const FINGER_STEP_S: f64 = 0.03;

/// What one grasp does. Configurations are base, arm, and maybe more that is not the robot's.
pub(super) struct Leg<'a> {
    /// The grasp.
    pub grasp: &'a Grasp,
    /// How the hand gets there from the grasp before; none for the first.
    pub transfer: Option<Transfer>,
    /// Optimised waypoints.
    pub waypoints: Waypoints,
    /// Dense samples through them.
    pub samples: Waypoints,
    /// Positions of all object joints at each sample.
    pub objects: Vec<Vec<f64>>,
    /// How the hand leaves at the end, where it lets go.
    pub release: Option<Timed>,
}

/// A dense path that grows phase by phase.
struct Timeline<'a> {
    run: &'a Run<'a>,
    dense: DensePath,
    time_s: f64,
    /// Number of base and arm columns.
    planned: usize,
    /// Where the object's joints are.
    object: Vec<f64>,
    /// Where the fingers are.
    fingers: Vec<f64>,
}

impl Timeline<'_> {
    fn push(&mut self, x: &[f64], phase: Phase) {
        let row = [&x[..self.planned], &self.fingers].concat();
        self.dense.push(self.time_s, row, self.object.iter().copied(), phase);
    }

    fn follow(&mut self, motion: &Timed, phase: Phase) {
        for (dt, x) in motion {
            self.time_s += dt;
            self.push(x, phase);
        }
    }

    /// Moves the fingers to `target` while the robot stands still at `x`.
    fn move_fingers(&mut self, x: &[f64], target: &[f64], phase: Phase) {
        let robot = &self.run.task.robot;
        let limits = Limits::of(robot, &robot.gripper_joints);
        let from = self.fingers.clone();
        let delta: Vec<f64> = target.iter().zip(&from).map(|(to, from)| to - from).collect();
        let duration = limits.rest_to_rest(&delta).max(0.2);
        let count = (duration / FINGER_STEP_S).ceil().max(4.0) as usize;
        let step = duration / count as f64 * 1.02;
        for i in 1..=count {
            let s = smooth(i as f64 / count as f64);
            self.fingers = from.iter().zip(&delta).map(|(from, d)| from + d * s).collect();
            self.time_s += step;
            self.push(x, phase);
        }
    }
}

impl Run<'_> {
    /// Lays the phases out in time.
    pub(super) fn trajectory(
        &self,
        key: &str,
        seed: u64,
        goal: f64,
        legs: Vec<Leg<'_>>,
        approach: Option<&Approach>,
    ) -> Trajectory {
        let (robot, object) = (&self.task.robot, &self.task.object);
        let columns = robot.trajectory_joints();
        let planned = columns.len() - robot.gripper_joints.len();
        let open = robot.finger_positions(robot.file.gripper.open_width_m);
        let closed = |leg: &Leg<'_>| robot.finger_positions(leg.grasp.width_m);
        let start_q =
            object.tree.column(object.active_joint).map_or(0.0, |c| legs[0].objects[0][c]);
        let substeps = (legs[0].samples.len() - 1) / (legs[0].waypoints.len() - 1).max(1);
        let mut line = Timeline {
            run: self,
            dense: DensePath {
                robot: JointPath::new(columns.len()),
                object: JointPath::new(object.tree.dof()),
                ..DensePath::default()
            },
            time_s: 0.0,
            planned,
            object: legs[0].objects[0].clone(),
            fingers: open.clone(),
        };
        let first = &legs[0].samples[0];
        if let Some(approach) = approach {
            line.push(&approach.home, Phase::Approach);
            line.follow(&approach.free, Phase::Approach);
            line.follow(&approach.reach, Phase::Reach);
            line.move_fingers(first, &closed(&legs[0]), Phase::Grasp);
        } else {
            line.fingers = closed(&legs[0]);
            line.push(first, Phase::Grasp);
        }

        let limits = Limits::of(robot, &columns[..planned]);
        let count: usize = legs.iter().map(|leg| leg.waypoints.len()).sum();
        let even = self.config.duration_s / (count - 1) as f64;
        let step = even / substeps as f64;
        let stretch = legs.iter().map(|leg| limits.stretch(&leg.samples, step));
        let interval = even * stretch.fold(1.0, f64::max);

        let mut waypoints_robot = JointPath::new(columns.len());
        let mut waypoints_object = JointPath::new(object.tree.dof());
        let mut starts = Vec::new();
        for (index, leg) in legs.iter().enumerate() {
            let first = &leg.samples[0];
            if let Some(transfer) = &leg.transfer {
                let left_at = legs[index - 1].samples.last().unwrap_or(first);
                line.move_fingers(left_at, &open, Phase::Regrasp);
                line.follow(&transfer.retreat, Phase::Regrasp);
                line.follow(&transfer.free, Phase::Regrasp);
                line.follow(&transfer.reach, Phase::Regrasp);
                line.move_fingers(first, &closed(leg), Phase::Regrasp);
            }
            starts.push((waypoints_robot.rows() as u32, line.dense.len() as u32 - 1));
            let begin = line.time_s;
            for (k, (x, object)) in leg.samples.iter().zip(&leg.objects).enumerate().skip(1) {
                line.time_s = begin + interval * k as f64 / substeps as f64;
                line.object.clone_from(object);
                line.push(x, Phase::Manipulate);
            }
            for (x, object) in leg.waypoints.iter().zip(leg.objects.iter().step_by(substeps)) {
                waypoints_robot.push([&x[..planned], &line.fingers].concat());
                waypoints_object.push(object.iter().copied());
            }
            if let Some(release) = &leg.release {
                line.move_fingers(leg.samples.last().unwrap_or(first), &open, Phase::Release);
                line.follow(release, Phase::Release);
            }
        }
        let regrasp = |(&(first_waypoint, dense_start), leg): (&(u32, u32), &Leg<'_>)| Regrasp {
            first_waypoint,
            dense_start,
            grasp: leg.grasp.clone(),
        };
        Trajectory {
            id: self.identity(key),
            seed,
            grasp: legs[0].grasp.clone(),
            start: start_q,
            goal,
            waypoints_robot,
            waypoints_object,
            waypoint_interval_s: interval,
            manipulation_start: starts[0].1,
            substeps: substeps as u32,
            regrasps: starts.iter().zip(&legs).skip(1).map(regrasp).collect(),
            dense: line.dense,
            verdict: None,
        }
    }

    pub(super) fn pair_number(&self, pair: &Pair) -> u64 {
        let fields = [pair.hold, pair.start, pair.goal_index, pair.rank];
        fields.iter().fold(0, |number, &field| number << 16 | field as u64)
    }

    fn identity(&self, key: &str) -> String {
        // How many are wanted says nothing about any one of them.
        let config = PlannerConfig { limit: 0, ..self.config.clone() };
        let config = serde_json::to_string(&config).unwrap_or_default();
        let text = format!(
            "{:?}|{}|{}|{key}|{config}",
            self.task.content_hashes, self.task.toml, self.task.file.seed,
        );
        hash::of_bytes(text.as_bytes())[..16].to_string()
    }

    pub(super) fn header(&self) -> TrajectoryHeader {
        let task = self.task;
        let object = &task.object;
        let joint = |j: usize| object.tree.joints()[j].name.clone();
        TrajectoryHeader {
            task_toml: task.toml.clone(),
            task_dir: task.dir.display().to_string(),
            task_name: task.file.name.clone(),
            scene_id: task.scene.name.clone(),
            object_id: object.name.clone(),
            robot_id: task.robot.name.clone(),
            base_kind: task.robot.file.base.kind,
            content_hashes: task.content_hashes.clone(),
            robot_joints: task.robot.trajectory_joint_names(),
            object_joints: object.tree.dof_joints().iter().map(|&j| joint(j)).collect(),
            active_joint: joint(object.active_joint),
            contact_exceptions: self.preparation.exceptions.clone(),
            seed: task.file.seed,
            planner_config: serde_json::to_value(self.config).unwrap_or_default(),
            backend: "cpu".into(),
            counts: self.counts.clone(),
        }
    }
}
