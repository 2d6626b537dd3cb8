//! Phases laid out in time, and what identifies and describes a trajectory.

use akrobat_model::trajectory::{DensePath, Phase, Trajectory, TrajectoryHeader};
use akrobat_model::{JointPath, hash};

use super::{Hold, Pair, Run};
use crate::approach::Approach;
use crate::config::PlannerConfig;
use crate::dense::Limits;
use crate::trajopt::{Waypoints, smooth};

/// Time step of sampled finger motion, seconds.
const FINGER_STEP_S: f64 = 0.03;

impl Run<'_> {
    /// Lays the phases out in time.
    pub(super) fn trajectory(
        &self,
        hold: &Hold,
        pair: &Pair,
        seed: u64,
        waypoints: &Waypoints,
        samples: &Waypoints,
        approach: Option<&Approach>,
    ) -> Trajectory {
        let (robot, object) = (&self.task.robot, &self.task.object);
        let columns = robot.trajectory_joints();
        let planned = columns.len() - robot.gripper_joints.len();
        let start_q = samples[0][planned];
        let open = robot.finger_positions(robot.file.gripper.open_width_m);
        let closed = robot.finger_positions(hold.grasp.width_m);
        let mut dense = DensePath {
            robot: JointPath::new(columns.len()),
            object: JointPath::new(object.tree.dof()),
            ..DensePath::default()
        };
        let mut time = 0.0;
        let row = |x: &[f64], fingers: &[f64]| [&x[..planned], fingers].concat();
        if let Some(approach) = approach {
            let rest = object.configuration(start_q);
            dense.push(time, row(&approach.home, &open), rest.clone(), Phase::Approach);
            for (phase, samples) in
                [(Phase::Approach, &approach.free), (Phase::Reach, &approach.reach)]
            {
                for (dt, x) in samples {
                    time += dt;
                    dense.push(time, row(x, &open), rest.clone(), phase);
                }
            }
            let limits = Limits::of(robot, &robot.gripper_joints);
            let delta: Vec<f64> = closed.iter().zip(&open).map(|(c, o)| c - o).collect();
            let duration = limits.rest_to_rest(&delta).max(0.2);
            let count = (duration / FINGER_STEP_S).ceil().max(4.0) as usize;
            let step = duration / count as f64 * 1.02;
            for i in 1..=count {
                let s = smooth(i as f64 / count as f64);
                let fingers: Vec<f64> = open.iter().zip(&delta).map(|(o, d)| o + d * s).collect();
                time += step;
                dense.push(time, row(&samples[0], &fingers), rest.clone(), Phase::Grasp);
            }
        } else {
            let phase = Phase::Grasp;
            dense.push(time, row(&samples[0], &closed), object.configuration(start_q), phase);
        }
        let manipulation_start = dense.len() as u32 - 1;
        let limits = Limits::of(robot, &columns[..planned]);
        let intervals = (self.config.waypoints - 1) as f64;
        let substeps = self.config.substeps as f64;
        let even = self.config.duration_s / intervals;
        let interval = even * limits.stretch(samples, even / substeps).max(1.0);
        let manipulation_begin = time;
        for (k, x) in samples.iter().enumerate().skip(1) {
            let time = manipulation_begin + interval * k as f64 / substeps;
            dense.push(time, row(x, &closed), object.configuration(x[planned]), Phase::Manipulate);
        }
        let mut waypoints_robot = JointPath::new(columns.len());
        let mut waypoints_object = JointPath::new(object.tree.dof());
        for x in waypoints {
            waypoints_robot.push(row(x, &closed));
            waypoints_object.push(object.configuration(x[planned]));
        }
        Trajectory {
            id: self.identity(pair),
            seed,
            grasp: hold.grasp.clone(),
            start: start_q,
            goal: self.task.file.goal.positions[pair.goal_index],
            waypoints_robot,
            waypoints_object,
            waypoint_interval_s: interval,
            manipulation_start,
            substeps: self.config.substeps as u32,
            dense,
            verdict: None,
        }
    }

    pub(super) fn pair_number(&self, pair: &Pair) -> u64 {
        let fields = [pair.hold, pair.start, pair.goal_index, pair.rank];
        fields.iter().fold(0, |number, &field| number << 16 | field as u64)
    }

    fn identity(&self, pair: &Pair) -> String {
        // How many are wanted says nothing about any one of them.
        let config = PlannerConfig { limit: 0, ..self.config.clone() };
        let config = serde_json::to_string(&config).unwrap_or_default();
        let text = format!(
            "{:?}|{}|{}|{}|{config}",
            self.task.content_hashes,
            self.task.toml,
            self.task.file.seed,
            self.pair_number(pair)
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
