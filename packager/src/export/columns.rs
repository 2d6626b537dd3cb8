//! Actions and states: the columns of a trajectory, expressed as trainers want them.

use akrobat_model::Pose;
use nalgebra::{UnitQuaternion, Vector3};
use serde::Serialize;

use super::config::{
    ActionKind, BaseActions, EefFrame, ExportConfig, GripperColumns, QuatOrder, StateKind,
};

/// A row-major table with named columns.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Table {
    /// Names of the columns.
    pub names: Vec<String>,
    /// Values `[rows, columns]`.
    pub values: Vec<f32>,
}

impl Table {
    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.names.len()
    }
}

/// The motion of one episode, `T` rows each.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    /// Names of the joint columns: base, arm, fingers.
    pub joints: &'a [String],
    /// How many of the first columns are the base: 3, or 0 where it is fixed.
    pub base_joints: usize,
    /// How many of the last columns are fingers.
    pub finger_joints: usize,
    /// Times `[T]`, seconds.
    pub time_s: &'a [f64],
    /// Positions `[T, joints]`.
    pub position: &'a [f32],
    /// Velocities `[T, joints]`.
    pub velocity: &'a [f32],
    /// Absolute targets `[T, joints]`: row t leads to frame t + 1, the last repeats.
    pub target: &'a [f32],
    /// Tool poses `[T]`.
    pub world_from_tool: &'a [Pose],
    /// Poses of the base link `[T]`.
    pub world_from_base: &'a [Pose],
}

impl Motion<'_> {
    /// The actions of all frames.
    pub fn actions(&self, config: &ExportConfig) -> Table {
        let mut names = self.base_action_names(config);
        let arm = &self.joints[self.base_joints..self.joints.len() - self.finger_joints];
        match config.actions {
            ActionKind::JointPosition => names.extend(arm.iter().cloned()),
            ActionKind::JointVelocity => names.extend(arm.iter().map(|j| format!("{j}.velocity"))),
            ActionKind::EefPose => names.extend(pose_names(config.quat)),
            ActionKind::EefDelta => {
                let parts = ["dx", "dy", "dz", "rx", "ry", "rz"];
                names.extend(parts.map(|part| format!("eef.{part}")));
            }
        }
        names.extend(self.gripper_names(config));
        let frames = self.time_s.len();
        let values = (0..frames).flat_map(|t| self.action(config, t)).collect();
        Table { names, values }
    }

    /// The states of all frames.
    pub fn states(&self, config: &ExportConfig) -> Table {
        let fingers = self.joints.len() - self.finger_joints;
        let joints = || {
            let body = self.joints[..fingers].iter().cloned();
            body.chain(self.gripper_names(config)).collect::<Vec<_>>()
        };
        let velocities = || joints().into_iter().map(|name| format!("{name}.velocity"));
        let names = match config.state {
            StateKind::Joints => joints(),
            StateKind::JointsVelocities => joints().into_iter().chain(velocities()).collect(),
            StateKind::EefPose => {
                let base = self.joints[..self.base_joints].iter().cloned();
                let eef = pose_names(config.quat).into_iter();
                base.chain(eef).chain(self.gripper_names(config)).collect()
            }
            StateKind::All => {
                let eef = pose_names(config.quat);
                joints().into_iter().chain(velocities()).chain(eef).collect()
            }
        };
        let values = (0..self.time_s.len()).flat_map(|t| self.state(config, t)).collect();
        Table { names, values }
    }

    fn state(&self, config: &ExportConfig, t: usize) -> Vec<f32> {
        let (position, velocity) = (self.row(self.position, t), self.row(self.velocity, t));
        let joints = |row: &[f32]| {
            let body = row[..row.len() - self.finger_joints].to_vec();
            [body, self.gripper(config, row)].concat()
        };
        let eef = || pose_values(&self.tool_pose(config.eef_frame, t), config.quat);
        match config.state {
            StateKind::Joints => joints(position),
            StateKind::JointsVelocities => [joints(position), joints(velocity)].concat(),
            StateKind::EefPose => {
                let base = position[..self.base_joints].to_vec();
                [base, eef(), self.gripper(config, position)].concat()
            }
            StateKind::All => [joints(position), joints(velocity), eef()].concat(),
        }
    }

    fn action(&self, config: &ExportConfig, t: usize) -> Vec<f32> {
        let next = (t + 1).min(self.time_s.len() - 1);
        let (position, target) = (self.row(self.position, t), self.row(self.target, t));
        let seconds = self.time_s[next] - self.time_s[t];
        let rate = |change: f64| if seconds > 0.0 { change / seconds } else { 0.0 };
        let velocity = config.actions == ActionKind::JointVelocity;
        let mut values = match self.base_joints {
            0 => Vec::new(),
            _ => self.base_action(config.base, velocity, position, target, &rate),
        };
        let arm = self.base_joints..self.joints.len() - self.finger_joints;
        match config.actions {
            ActionKind::JointPosition => values.extend(&target[arm]),
            ActionKind::JointVelocity => {
                let pairs = target[arm.clone()].iter().zip(&position[arm]);
                values
                    .extend(pairs.map(|(&to, &from)| rate(f64::from(to) - f64::from(from)) as f32));
            }
            ActionKind::EefPose => {
                values.extend(pose_values(&self.tool_pose(config.eef_frame, next), config.quat));
            }
            ActionKind::EefDelta => {
                let [from, to] = [t, next].map(|t| self.tool_pose(config.eef_frame, t));
                let shift = to.translation.vector - from.translation.vector;
                let turn = (to.rotation * from.rotation.inverse()).scaled_axis();
                values.extend(shift.iter().chain(turn.iter()).map(|&v| v as f32));
            }
        }
        values.extend(self.gripper(config, target));
        values
    }

    fn base_action(
        &self,
        mode: BaseActions,
        velocity: bool,
        position: &[f32],
        target: &[f32],
        rate: &dyn Fn(f64) -> f64,
    ) -> Vec<f32> {
        if mode == BaseActions::Absolute && !velocity {
            return target[..3].to_vec();
        }
        let [x, y, yaw] = [0, 1, 2].map(|i| f64::from(target[i]) - f64::from(position[i]));
        let shift = match mode {
            BaseActions::Absolute | BaseActions::Relative => Vector3::new(x, y, 0.0),
            BaseActions::Local => {
                let heading = f64::from(position[2]);
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -heading)
                    * Vector3::new(x, y, 0.0)
            }
        };
        let change = [shift.x, shift.y, wrapped(yaw)];
        change.map(|v| if velocity { rate(v) as f32 } else { v as f32 }).to_vec()
    }

    fn base_action_names(&self, config: &ExportConfig) -> Vec<String> {
        let suffix = match (config.actions, config.base) {
            (ActionKind::JointVelocity, BaseActions::Local) => ".local_velocity",
            (ActionKind::JointVelocity, _) => ".velocity",
            (_, BaseActions::Absolute) => "",
            (_, BaseActions::Relative) => ".delta",
            (_, BaseActions::Local) => ".local_delta",
        };
        self.joints[..self.base_joints].iter().map(|joint| format!("{joint}{suffix}")).collect()
    }

    fn gripper_names(&self, config: &ExportConfig) -> Vec<String> {
        match config.gripper {
            GripperColumns::Opening if self.finger_joints > 0 => vec!["gripper".into()],
            _ => self.joints[self.joints.len() - self.finger_joints..].to_vec(),
        }
    }

    fn gripper(&self, config: &ExportConfig, row: &[f32]) -> Vec<f32> {
        let fingers = &row[row.len() - self.finger_joints..];
        match config.gripper {
            GripperColumns::Opening if !fingers.is_empty() => {
                let sum: f64 = fingers.iter().copied().map(f64::from).sum();
                vec![(sum / fingers.len() as f64) as f32]
            }
            _ => fingers.to_vec(),
        }
    }

    fn tool_pose(&self, frame: EefFrame, t: usize) -> Pose {
        match frame {
            EefFrame::World => self.world_from_tool[t],
            EefFrame::Base => self.world_from_base[t].inverse() * self.world_from_tool[t],
        }
    }

    fn row<'a>(&self, values: &'a [f32], t: usize) -> &'a [f32] {
        &values[t * self.joints.len()..][..self.joints.len()]
    }
}

/// An angle in (-pi, pi].
fn wrapped(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let turned = angle.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}

fn pose_names(order: QuatOrder) -> Vec<String> {
    let quaternion = match order {
        QuatOrder::Wxyz => ["qw", "qx", "qy", "qz"],
        QuatOrder::Xyzw => ["qx", "qy", "qz", "qw"],
    };
    ["x", "y", "z"].iter().chain(&quaternion).map(|part| format!("eef.{part}")).collect()
}

fn pose_values(pose: &Pose, order: QuatOrder) -> Vec<f32> {
    let [x, y, z, qw, qx, qy, qz] = akrobat_model::pose::to_xyz_wxyz(pose);
    let values = match order {
        QuatOrder::Wxyz => [x, y, z, qw, qx, qy, qz],
        QuatOrder::Xyzw => [x, y, z, qx, qy, qz, qw],
    };
    values.iter().map(|&v| v as f32).collect()
}

/// Least, greatest and mean value and standard deviation of each column.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct ColumnStatistics {
    /// Least values.
    pub min: Vec<f64>,
    /// Greatest values.
    pub max: Vec<f64>,
    /// Means.
    pub mean: Vec<f64>,
    /// Standard deviations of the population.
    pub std: Vec<f64>,
    /// Number of rows.
    pub count: u64,
    #[serde(skip)]
    squares: Vec<f64>,
}

impl ColumnStatistics {
    /// Takes the rows of a table (Welford's update, column by column).
    pub fn add(&mut self, table: &Table) {
        let columns = table.columns();
        if self.count == 0 {
            self.min = vec![f64::INFINITY; columns];
            self.max = vec![f64::NEG_INFINITY; columns];
            self.mean = vec![0.0; columns];
            self.std = vec![0.0; columns];
            self.squares = vec![0.0; columns];
        }
        for row in table.values.chunks_exact(columns.max(1)) {
            self.count += 1;
            for (c, value) in row.iter().map(|&v| f64::from(v)).enumerate() {
                self.min[c] = self.min[c].min(value);
                self.max[c] = self.max[c].max(value);
                let before = value - self.mean[c];
                self.mean[c] += before / self.count as f64;
                self.squares[c] += before * (value - self.mean[c]);
            }
        }
        let count = self.count.max(1) as f64;
        self.std = self.squares.iter().map(|s| (s / count).sqrt()).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use akrobat_model::pose;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// Turn of the tool about y in the base's frame, rad.
    const TILT: f64 = 1.0;

    struct Sample {
        joints: Vec<String>,
        time_s: Vec<f64>,
        position: Vec<f32>,
        target: Vec<f32>,
        velocity: Vec<f32>,
        tool: Vec<Pose>,
        base: Vec<Pose>,
    }

    fn sample() -> Sample {
        // The base looks along +y and drives 1 m along +y, turning over the cut at pi.
        let rows =
            [[0.0, 0.0, FRAC_PI_2 as f32, 0.5, 0.01, 0.03], [0.0, 1.0, 2.0, 0.7, 0.02, 0.04]];
        let base = rows.map(|r| {
            pose::from_xyz_rpy([r[0] as f64, r[1] as f64, 0.0], [0.0, 0.0, f64::from(r[2])])
        });
        let tool = base.map(|b| b * pose::from_xyz_rpy([0.6, 0.0, 1.0], [0.0, TILT, 0.0]));
        Sample {
            joints: ["x", "y", "yaw", "arm", "f1", "f2"].map(String::from).into(),
            time_s: vec![0.0, 0.5],
            position: rows.concat(),
            target: [rows[1], rows[1]].concat(),
            velocity: vec![0.0; 12],
            tool: tool.into(),
            base: base.into(),
        }
    }

    fn motion(s: &Sample) -> Motion<'_> {
        Motion {
            joints: &s.joints,
            base_joints: 3,
            finger_joints: 2,
            time_s: &s.time_s,
            position: &s.position,
            velocity: &s.velocity,
            target: &s.target,
            world_from_tool: &s.tool,
            world_from_base: &s.base,
        }
    }

    fn assert_close(got: &[f32], expected: &[f64]) {
        assert_eq!(got.len(), expected.len());
        for (g, e) in got.iter().zip(expected) {
            assert!((f64::from(*g) - e).abs() < 1e-6, "{got:?} is not {expected:?}");
        }
    }

    #[test]
    fn absolute_positions_are_the_targets_bit_for_bit() {
        let s = sample();
        let table = motion(&s).actions(&ExportConfig::default());
        assert_eq!(table.values, s.target);
        assert_eq!(table.names, s.joints);
    }

    #[test]
    fn a_base_that_drives_ahead_moves_along_its_own_x() {
        let s = sample();
        let config = |base| ExportConfig {
            base,
            gripper: GripperColumns::Opening,
            ..ExportConfig::default()
        };
        let turn = 2.0 - f64::from(FRAC_PI_2 as f32);
        let local = motion(&s).actions(&config(BaseActions::Local));
        assert_eq!(local.columns(), 5);
        assert_close(&local.values[..5], &[1.0, 0.0, turn, 0.7, 0.03]);
        assert_close(&local.values[5..8], &[0.0, 0.0, 0.0]);
        let relative = motion(&s).actions(&config(BaseActions::Relative));
        assert_close(&relative.values[..5], &[0.0, 1.0, turn, 0.7, 0.03]);
    }

    #[test]
    fn velocities_integrate_to_the_next_frame() {
        let s = sample();
        let config = ExportConfig { actions: ActionKind::JointVelocity, ..ExportConfig::default() };
        let table = motion(&s).actions(&config);
        let reached: Vec<f32> = (0..4).map(|c| s.position[c] + 0.5 * table.values[c]).collect();
        assert_close(&reached, &[0.0, 1.0, 2.0, 0.7]);
        // Fingers stay position targets; the last row commands rest.
        assert_close(&table.values[4..6], &[0.02, 0.04]);
        assert_close(&table.values[6..10], &[0.0; 4]);
    }

    #[test]
    fn a_tool_that_the_base_carries_does_not_move_in_its_frame() {
        let s = sample();
        let delta = |eef_frame| {
            let config = ExportConfig {
                actions: ActionKind::EefDelta,
                eef_frame,
                ..ExportConfig::default()
            };
            motion(&s).actions(&config).values[3..9].to_vec()
        };
        assert_close(&delta(EefFrame::Base), &[0.0; 6]);
        assert!(delta(EefFrame::World)[1] > 0.5);
        let pose = |quat| {
            let config =
                ExportConfig { actions: ActionKind::EefPose, quat, ..ExportConfig::default() };
            motion(&s).actions(&config).values[3..10].to_vec()
        };
        let (w, y) = ((TILT / 2.0).cos(), (TILT / 2.0).sin());
        assert_close(&pose(QuatOrder::Wxyz), &[0.6, 0.0, 1.0, w, 0.0, y, 0.0]);
        assert_close(&pose(QuatOrder::Xyzw), &[0.6, 0.0, 1.0, 0.0, y, 0.0, w]);
    }

    #[test]
    fn turns_take_the_short_way() {
        assert!((wrapped(2.0 * PI - 0.1) + 0.1).abs() < 1e-12);
        assert!((wrapped(-PI) - PI).abs() < 1e-12);
    }

    #[test]
    fn statistics_are_those_of_all_rows() {
        let mut statistics = ColumnStatistics::default();
        for values in [vec![1.0, 2.0], vec![3.0, 4.0, 8.0, 0.0]] {
            statistics.add(&Table { names: vec!["a".into(), "b".into()], values });
        }
        assert_eq!((statistics.min, statistics.max), (vec![1.0, 0.0], vec![8.0, 4.0]));
        assert_eq!((statistics.mean, statistics.count), (vec![4.0, 2.0], 3));
        let expected = (26.0f64 / 3.0).sqrt();
        assert!((statistics.std[0] - expected).abs() < 1e-12);
    }
}
