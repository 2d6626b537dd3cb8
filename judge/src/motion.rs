//! The checks that need no geometry: anchor, object motion, joint limits, base yaw.

use akrobat_model::robot::Robot;
use akrobat_model::task::{ManipulatedObject, Task};
use akrobat_model::trajectory::Segment;
use akrobat_model::{JointKind, JointPath, KinematicTree, Rejection, Trajectory};

use crate::JudgeConfig;
use crate::finding::{Finding, Worst};
use crate::path::Configuration;

/// Worst values of the checks of this module.
#[derive(Debug, Default)]
pub struct Motion {
    /// Metres.
    pub anchor_translation_m: f64,
    /// Radians.
    pub anchor_rotation_rad: f64,
    /// Fraction of the limit.
    pub velocity_fraction: f64,
    /// Fraction of the limit.
    pub acceleration_fraction: f64,
    /// Radians.
    pub base_yaw_rad: f64,
    /// What was found wrong, in no particular order.
    pub findings: Vec<Finding>,
}

impl Motion {
    fn refuse(&mut self, rejection: Rejection, detail: String) {
        self.findings.push(Finding::new(rejection, detail));
    }

    /// The object starts where the task says, reaches a goal of the task, and only its driven joint
    /// moves, only while it is held.
    pub fn check_object(&mut self, trajectory: &Trajectory, task: &Task, config: &JudgeConfig) {
        self.object_moved(object_motion(trajectory, task, config));
    }

    /// Notes what was found wrong with the object's motion.
    pub fn object_moved(&mut self, found: Result<(), String>) {
        if let Err(detail) = found {
            self.refuse(Rejection::ObjectMotion, detail);
        }
    }

    /// Position limits of the robot's moving joints and of all object joints.
    pub fn check_positions(
        &mut self,
        configurations: &[Configuration],
        robot: &Robot,
        object: &ManipulatedObject,
        config: &JudgeConfig,
    ) {
        let mut worst = Worst::default();
        let robot_columns = robot.trajectory_joints();
        let object_columns = object.tree.dof_joints();
        for configuration in configurations {
            for (tree, columns, row) in [
                (&robot.tree, &robot_columns[..], &configuration.robot),
                (&object.tree, object_columns, &configuration.object),
            ] {
                for (joint, position) in moving_positions(tree, columns, row) {
                    let [low, high] = tree.joints()[joint].limits;
                    let beyond = (low - position).max(position - high);
                    worst.see(beyond, (configuration.place, tree, joint, position));
                }
            }
        }
        if let Some((place, tree, joint, position)) = worst.above(config.position_tolerance) {
            let joint = &tree.joints()[joint];
            self.refuse(
                Rejection::PositionLimit,
                format!(
                    "{place}: joint \"{}\" of {} is at {position:.5}, {:.5} outside its limits [{:.5}, {:.5}]",
                    joint.name, tree.name, worst.value, joint.limits[0], joint.limits[1]
                ),
            );
        }
    }

    /// Velocity and acceleration limits of the robot, by divided differences of the dense samples. The
    /// robot is at rest before the first and after the last one.
    pub fn check_rates(&mut self, trajectory: &Trajectory, robot: &Robot, config: &JudgeConfig) {
        let (mut speed, mut acceleration) = (Worst::default(), Worst::default());
        for (column, joint) in robot.trajectory_joints().into_iter().enumerate() {
            let samples = Column::new(&trajectory.dense.robot, column, &trajectory.dense.times_s);
            if let Some(limit) = robot.tree.joints()[joint].velocity_limit {
                for (sample, value) in samples.speeds().into_iter().enumerate() {
                    speed.see(value / limit, (sample, joint, value, limit));
                }
            }
            let limit = robot.acceleration_limit(joint);
            for (sample, value) in samples.accelerations().into_iter().enumerate() {
                acceleration.see(value / limit, (sample, joint, value, limit));
            }
        }
        self.velocity_fraction = speed.value;
        self.acceleration_fraction = acceleration.value;
        let name = |joint: usize| &robot.tree.joints()[joint].name;
        if let Some((sample, joint, value, limit)) = speed.above(1.0 + config.rate_tolerance) {
            self.refuse(
                Rejection::VelocityLimit,
                format!(
                    "samples {sample} to {}: joint \"{}\" moves at {value:.4}, its limit is {limit:.4} per second",
                    sample + 1,
                    name(joint)
                ),
            );
        }
        if let Some((sample, joint, value, limit)) = acceleration.above(1.0 + config.rate_tolerance)
        {
            self.refuse(
                Rejection::AccelerationLimit,
                format!(
                    "sample {sample}: joint \"{}\" accelerates with {value:.4}, its limit is {limit:.4} per second squared",
                    name(joint)
                ),
            );
        }
    }

    /// The base does not turn away too far while it drives the object with one grasp.
    pub fn check_base_yaw(&mut self, trajectory: &Trajectory, robot: &Robot, config: &JudgeConfig) {
        let Some(column) = robot.base_joints.len().checked_sub(1) else { return };
        let yaw = |sample: usize| f64::from(trajectory.dense.robot.row(sample)[column]);
        let mut worst = Worst::default();
        for segment in trajectory.segments() {
            let start = yaw(*segment.samples.start());
            for sample in segment.samples {
                worst.see((yaw(sample) - start).abs(), sample);
            }
        }
        self.base_yaw_rad = worst.value;
        if let Some(sample) = worst.above(config.base_yaw_rad) {
            self.refuse(
                Rejection::BaseYaw,
                format!(
                    "sample {sample}: the base has turned by {:.3} rad since it took hold",
                    worst.value
                ),
            );
        }
    }
}

fn object_motion(trajectory: &Trajectory, task: &Task, config: &JudgeConfig) -> Result<(), String> {
    let object = &task.object;
    let active = column_of(&object.tree, object.active_joint)
        .ok_or("the driven joint does not move by itself: it is fixed or follows another")?;
    let start = object.start[active];
    let travel = (trajectory.goal - start).abs();
    let name = &object.tree.joints()[object.active_joint].name;

    let limits = object.tree.joints()[object.active_joint].limits;
    let goals = task.file.goal.positions.iter().map(|goal| goal.max(limits[0]).min(limits[1]));
    let off_goal = goals.map(|goal| (goal - trajectory.goal).abs()).fold(f64::MAX, f64::min);
    if off_goal > config.goal_tolerance * travel + config.standstill_tolerance {
        return Err(format!(
            "the goal {:.4} of joint \"{name}\" is none of the task's",
            trajectory.goal
        ));
    }

    let waypoint = |row: usize| f64::from(trajectory.waypoints_object.row(row)[active]);
    let first = waypoint(0);
    let start_allowance = config.start_tolerance * travel + config.standstill_tolerance;
    if (first - start).abs() > start_allowance || (trajectory.start - start).abs() > start_allowance
    {
        return Err(format!(
            "joint \"{name}\" is at {first:.4} at the first waypoint (stated start {:.4}), the task starts at {start:.4}",
            trajectory.start
        ));
    }
    let last = waypoint(trajectory.waypoints_object.rows() - 1);
    if (last - trajectory.goal).abs() > config.goal_tolerance * travel {
        return Err(format!(
            "joint \"{name}\" is at {last:.4} at the last waypoint, its goal is {:.4}",
            trajectory.goal
        ));
    }

    let segments = trajectory.segments();
    for sample in 0..trajectory.dense.len() {
        let rests_at = rest_sample(&segments, sample);
        for (column, &position) in trajectory.dense.object.row(sample).iter().enumerate() {
            let expected = match rests_at {
                _ if column != active => object.start[column],
                Some(rest) => f64::from(trajectory.dense.object.row(rest)[column]),
                None => continue,
            };
            let off = (f64::from(position) - expected).abs();
            if off > config.standstill_tolerance {
                let joint = &object.tree.joints()[object.tree.dof_joints()[column]].name;
                return Err(format!(
                    "sample {sample}: joint \"{joint}\" should stand still at {expected:.4} and is {off:.5} away from it"
                ));
            }
        }
    }
    Ok(())
}

/// The dense sample at whose position the driven joint rests at `sample`; `None` where it may move. A later
/// grasp takes over where the one before has left off.
pub fn rest_sample(segments: &[Segment<'_>], sample: usize) -> Option<usize> {
    let left_at = segments.iter().rfind(|s| *s.samples.end() < sample).map(|s| *s.samples.end());
    match segments.iter().find(|s| s.samples.contains(&sample)) {
        Some(segment) if *segment.samples.start() == sample => left_at,
        Some(_) => None,
        None => left_at.or_else(|| segments.first().map(|s| *s.samples.start())),
    }
}

/// Column of a joint that moves by itself.
fn column_of(tree: &KinematicTree, joint: usize) -> Option<usize> {
    tree.dof_joints().iter().position(|&other| other == joint)
}

/// Positions of the joints of `columns` at `row`, and of the joints that follow them.
fn moving_positions<'a>(
    tree: &'a KinematicTree,
    columns: &'a [usize],
    row: &'a [f64],
) -> impl Iterator<Item = (usize, f64)> + 'a {
    let own = columns.iter().copied().zip(row.iter().copied());
    let following = tree.joints().iter().enumerate().filter_map(|(joint, description)| {
        let mimic = description.mimic.as_ref().filter(|_| description.kind != JointKind::Fixed)?;
        let source = columns.iter().position(|&column| column == mimic.joint)?;
        Some((joint, mimic.multiplier * row[source] + mimic.offset))
    });
    own.chain(following)
}

/// Positions of one joint over time.
struct Column<'a> {
    positions: Vec<f64>,
    /// Half a unit in the last place of each stored position: what rounding may have done to it.
    rounding: Vec<f64>,
    times_s: &'a [f64],
}

impl<'a> Column<'a> {
    fn new(path: &JointPath, column: usize, times_s: &'a [f64]) -> Self {
        let stored: Vec<f32> = (0..path.rows()).map(|sample| path.row(sample)[column]).collect();
        Self {
            positions: stored.iter().map(|&p| f64::from(p)).collect(),
            rounding: stored.iter().map(|p| f64::from(p.abs() * f32::EPSILON / 2.0)).collect(),
            times_s,
        }
    }

    /// Velocity between neighbouring samples, and how much of it single precision may have made up.
    fn velocities(&self) -> Vec<(f64, f64)> {
        (1..self.positions.len())
            .map(|i| {
                let span = self.times_s[i] - self.times_s[i - 1];
                let rounding = (self.rounding[i] + self.rounding[i - 1]) / span;
                ((self.positions[i] - self.positions[i - 1]) / span, rounding)
            })
            .collect()
    }

    /// Least speed between neighbouring samples that the stored numbers prove.
    fn speeds(&self) -> Vec<f64> {
        self.velocities().into_iter().map(|(v, rounding)| (v.abs() - rounding).max(0.0)).collect()
    }

    /// Least acceleration at every sample that the stored numbers prove: the change of velocity over
    /// half of the time of both neighbouring intervals. Outside the path the joint rests.
    fn accelerations(&self) -> Vec<f64> {
        let velocities = self.velocities();
        let span = |interval: usize| self.times_s[interval + 1] - self.times_s[interval];
        let intervals = velocities.len();
        (0..self.positions.len())
            .map(|sample| {
                let before = sample.checked_sub(1).filter(|&i| i < intervals);
                let after = Some(sample).filter(|&i| i < intervals);
                let (v0, e0) = before.map_or((0.0, 0.0), |i| velocities[i]);
                let (v1, e1) = after.map_or((0.0, 0.0), |i| velocities[i]);
                let time = match (before, after) {
                    (Some(a), Some(b)) => (span(a) + span(b)) / 2.0,
                    (Some(only), None) | (None, Some(only)) => span(only),
                    (None, None) => return 0.0,
                };
                (((v1 - v0).abs() - e0 - e1) / time).max(0.0)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_of_a_parabola_are_exact_and_its_ends_are_jumps() {
        let times: Vec<f64> = [0.0, 0.1, 0.3, 0.4, 0.7].to_vec();
        let mut path = JointPath::new(1);
        for t in &times {
            path.push([t * t]);
        }
        let column = Column::new(&path, 0, &times);
        let accelerations = column.accelerations();
        for inner in &accelerations[1..4] {
            assert!((inner - 2.0).abs() < 1e-4, "{accelerations:?}");
        }
        // The velocity of the last interval, 1.1, must vanish within one interval of 0.3 s.
        assert!((accelerations[4] - 1.1 / 0.3).abs() < 1e-4);
        assert!((column.speeds()[3] - 1.1).abs() < 1e-5);
    }

    #[test]
    fn rounding_of_large_numbers_is_no_acceleration() {
        let times: Vec<f64> = (0..200).map(|k| f64::from(k) * 1e-3).collect();
        let mut path = JointPath::new(1);
        for t in &times {
            path.push([100.0 + 1e-3 * t]);
        }
        let inner = &Column::new(&path, 0, &times).accelerations()[1..199];
        assert!(inner.iter().all(|&a| a < 1e-6), "{inner:?}");
    }
}
