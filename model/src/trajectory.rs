//! Trajectories: 30 waypoints, the dense path between them, and what was found out about them.

use std::ops::{Range, RangeInclusive};

use serde::{Deserialize, Serialize};

use crate::robot::BaseKind;
use crate::{Pose, Verdict};

/// What happens during a part of a trajectory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Phase {
    /// Free-space motion with open fingers.
    Approach = 0,
    /// Straight motion to the grasp with open fingers.
    Reach = 1,
    /// The fingers close; nothing else moves.
    Grasp = 2,
    /// The held object moves.
    Manipulate = 3,
    /// Release, retreat and re-approach between two grasps.
    Regrasp = 4,
    /// The fingers open at the end.
    Release = 5,
}

impl Phase {
    /// All phases, by their number in files.
    pub const ALL: [Self; 6] =
        [Self::Approach, Self::Reach, Self::Grasp, Self::Manipulate, Self::Regrasp, Self::Release];

    /// True where the fingers hold the object.
    pub fn holds(self) -> bool {
        self == Self::Manipulate
    }
}

/// A row-major table of joint positions (rad, m), `[rows, columns]`. Single precision, as it is stored,
/// so that what is judged is what is saved.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointPath {
    columns: usize,
    values: Vec<f32>,
}

impl JointPath {
    /// An empty table.
    pub fn new(columns: usize) -> Self {
        Self { columns, values: Vec::new() }
    }

    /// A table from row-major values; `None` if they do not fill whole rows.
    pub fn from_values(columns: usize, values: Vec<f32>) -> Option<Self> {
        let whole =
            if columns == 0 { values.is_empty() } else { values.len().is_multiple_of(columns) };
        whole.then_some(Self { columns, values })
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.values.len().checked_div(self.columns).unwrap_or(0)
    }

    /// Row `index`.
    pub fn row(&self, index: usize) -> &[f32] {
        &self.values[index * self.columns..][..self.columns]
    }

    /// Row `index` in double precision.
    pub fn row_f64(&self, index: usize) -> Vec<f64> {
        self.row(index).iter().map(|&v| f64::from(v)).collect()
    }

    /// Appends a row.
    ///
    /// # Panics
    /// If the row does not have [`JointPath::columns`] values.
    pub fn push(&mut self, row: impl IntoIterator<Item = f64>) {
        self.values.extend(row.into_iter().map(|v| v as f32));
        assert_eq!(self.values.len() % self.columns.max(1), 0, "row of the wrong length");
    }

    /// All values, row-major.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// All values, row-major, to change in place.
    pub fn values_mut(&mut self) -> &mut [f32] {
        &mut self.values
    }
}

/// How the tool holds the object.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasp {
    /// Number within the task.
    pub id: u32,
    /// Name of the object's link that is held.
    pub link: String,
    /// Tool frame (z approach, y closing) in that link's frame.
    pub link_from_tool: Pose,
    /// Distance between the pads when closed on the handle, metres.
    pub width_m: f64,
}

/// A change of grasp: the hand lets go, the object rests, and the manipulation goes on with another hold.
#[derive(Debug, Clone, PartialEq)]
pub struct Regrasp {
    /// First waypoint of the new grasp. The object is where the waypoint before has left it.
    pub first_waypoint: u32,
    /// Dense sample of that waypoint.
    pub dense_start: u32,
    /// The new grasp.
    pub grasp: Grasp,
}

/// The part of a manipulation that is done with one grasp.
#[derive(Debug, Clone, PartialEq)]
pub struct Segment<'a> {
    /// The grasp.
    pub grasp: &'a Grasp,
    /// Its waypoints.
    pub waypoints: Range<usize>,
    /// Dense samples, from its first to its last waypoint.
    pub samples: RangeInclusive<usize>,
}

/// The path that is executed, rendered and judged: samples in time, linear in between.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct DensePath {
    /// Increasing times from 0, seconds, `[N]`.
    pub times_s: Vec<f64>,
    /// Robot joint positions `[N, robot columns]`.
    pub robot: JointPath,
    /// Object joint positions `[N, object DoF]`, every joint of the object.
    pub object: JointPath,
    /// Phase of each sample `[N]`: that of the motion which *arrives* at it.
    pub phase: Vec<Phase>,
}

/// One instant of a dense path.
#[derive(Debug, Clone, PartialEq)]
pub struct PathSample {
    /// Robot joint positions in the trajectory's columns.
    pub robot: Vec<f64>,
    /// Positions of all object joints.
    pub object: Vec<f64>,
    /// Phase.
    pub phase: Phase,
}

impl DensePath {
    /// Number of samples.
    pub fn len(&self) -> usize {
        self.times_s.len()
    }

    /// True without samples.
    pub fn is_empty(&self) -> bool {
        self.times_s.is_empty()
    }

    /// Duration, seconds.
    pub fn duration_s(&self) -> f64 {
        self.times_s.last().copied().unwrap_or(0.0)
    }

    /// Appends a sample.
    pub fn push(
        &mut self,
        time_s: f64,
        robot: impl IntoIterator<Item = f64>,
        object: impl IntoIterator<Item = f64>,
        phase: Phase,
    ) {
        self.times_s.push(time_s);
        self.robot.push(robot);
        self.object.push(object);
        self.phase.push(phase);
    }

    /// The state at `time_s`, clamped to the path; linear between samples.
    ///
    /// # Panics
    /// On an empty path.
    pub fn sample(&self, time_s: f64) -> PathSample {
        let last = self.len() - 1;
        let after = self.times_s.partition_point(|&t| t < time_s).min(last);
        let before = after.saturating_sub(1);
        let span = self.times_s[after] - self.times_s[before];
        let fraction =
            if span > 0.0 { ((time_s - self.times_s[before]) / span).clamp(0.0, 1.0) } else { 1.0 };
        let mix = |path: &JointPath| {
            let pairs = path.row(before).iter().zip(path.row(after));
            pairs.map(|(&a, &b)| f64::from(a) + (f64::from(b) - f64::from(a)) * fraction).collect()
        };
        PathSample { robot: mix(&self.robot), object: mix(&self.object), phase: self.phase[after] }
    }
}

/// One trajectory.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// Identity: hash of scene, object, grasp, seed and configuration; never of a worker or a retry.
    pub id: String,
    /// The seed of its own random numbers.
    pub seed: u64,
    /// The grasp; the first where it changes.
    pub grasp: Grasp,
    /// Position of the active object joint at the first waypoint, rad or m.
    pub start: f64,
    /// Position of the active object joint that the last waypoint must reach, rad or m.
    pub goal: f64,
    /// Robot waypoints of the manipulation `[T, robot columns]`, T = 30 by default.
    pub waypoints_robot: JointPath,
    /// Object waypoints `[T, object DoF]`.
    pub waypoints_object: JointPath,
    /// Time between waypoints, seconds.
    pub waypoint_interval_s: f64,
    /// Dense sample index of waypoint 0.
    pub manipulation_start: u32,
    /// Dense samples from one waypoint to the next: waypoint k is sample `manipulation_start + k * substeps`,
    /// up to the first change of grasp.
    pub substeps: u32,
    /// Changes of grasp on the way, in order; none where one grasp reaches the goal.
    pub regrasps: Vec<Regrasp>,
    /// The dense path of all phases.
    pub dense: DensePath,
    /// The judge's findings, once judged.
    pub verdict: Option<Verdict>,
}

impl Trajectory {
    /// Dense sample range of the manipulation, first to last waypoint, changes of grasp included.
    pub fn manipulation_samples(&self) -> RangeInclusive<usize> {
        let last = self.segments().pop().map_or(0, |segment| *segment.samples.end());
        self.manipulation_start as usize..=last
    }

    /// The manipulation by grasp: one more than there are changes of grasp.
    pub fn segments(&self) -> Vec<Segment<'_>> {
        let first = (0, self.manipulation_start, &self.grasp);
        let later = self.regrasps.iter().map(|r| (r.first_waypoint, r.dense_start, &r.grasp));
        let starts: Vec<(u32, u32, &Grasp)> = std::iter::once(first).chain(later).collect();
        let ends = starts[1..].iter().map(|&(waypoint, ..)| waypoint as usize);
        let ends = ends.chain([self.waypoints_robot.rows()]);
        let segment = |(&(waypoint, sample, grasp), end): (&(u32, u32, _), usize)| {
            let (waypoint, sample) = (waypoint as usize, sample as usize);
            let intervals = end.saturating_sub(waypoint + 1);
            Segment {
                grasp,
                waypoints: waypoint..end,
                samples: sample..=sample + intervals * self.substeps as usize,
            }
        };
        starts.iter().zip(ends).map(segment).collect()
    }

    /// Dense sample of waypoint `index`.
    pub fn waypoint_sample(&self, index: usize) -> usize {
        let later = self.regrasps.iter().rev();
        let starts = later.map(|r| (r.first_waypoint as usize, r.dense_start as usize));
        let mut starts = starts.chain([(0, self.manipulation_start as usize)]);
        let (waypoint, sample) =
            starts.find(|&(waypoint, _)| waypoint <= index).unwrap_or_default();
        sample + (index - waypoint) * self.substeps as usize
    }

    /// Times of the frames at `rate_hz`, seconds from the start of the dense path: frame k is at
    /// k / `rate_hz` after the first sample rendered; the last frame is the path's end.
    pub fn frame_times(&self, rate_hz: f64, manipulation_only: bool) -> Vec<f64> {
        let (from, to) = if manipulation_only {
            let range = self.manipulation_samples();
            (self.dense.times_s[*range.start()], self.dense.times_s[*range.end()])
        } else {
            (0.0, self.dense.duration_s())
        };
        let frames = ((to - from) * rate_hz - 1e-6).ceil().max(0.0) as usize + 1;
        (0..frames).map(|k| (from + k as f64 / rate_hz).min(to)).collect()
    }
}

/// What is common to all trajectories of a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TrajectoryHeader {
    /// The task file's text, complete: it names robot, object and scene.
    pub task_toml: String,
    /// Folder of the task file, relative to the folder of the trajectory file where that is possible.
    pub task_dir: String,
    /// Task name.
    pub task_name: String,
    /// Scene, object and robot names.
    pub scene_id: String,
    /// Object name.
    pub object_id: String,
    /// Robot name.
    pub robot_id: String,
    /// Kind of base the robot is planned with.
    pub base_kind: BaseKind,
    /// SHA-256 by input file, named as in the task.
    pub content_hashes: std::collections::BTreeMap<String, String>,
    /// Names of the robot columns.
    pub robot_joints: Vec<String>,
    /// Names of the object columns: all its DoF joints.
    pub object_joints: Vec<String>,
    /// The object joint that is driven to the goal.
    pub active_joint: String,
    /// Robot link, object link, and (as a pattern) object part that are allowed to touch.
    pub contact_exceptions: Vec<ContactException>,
    /// The task's seed.
    pub seed: u64,
    /// The planner's configuration.
    pub planner_config: serde_json::Value,
    /// Planner backend.
    pub backend: String,
    /// Counts of proposals by stage and of rejections by reason.
    pub counts: std::collections::BTreeMap<String, u64>,
}

/// A pair that may touch: fingers and the handle they hold.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ContactException {
    /// Robot link.
    pub robot_link: String,
    /// Object link.
    pub object_link: String,
    /// Part of the object link, as a pattern with `*`.
    pub object_part: String,
}

/// Trajectories of one task.
#[derive(Debug, Clone, PartialEq)]
pub struct TrajectorySet {
    /// What they share.
    pub header: TrajectoryHeader,
    /// The trajectories, in an order that does not depend on the number of threads.
    pub trajectories: Vec<Trajectory>,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trajectory(regrasps: Vec<Regrasp>) -> Trajectory {
        Trajectory {
            id: String::new(),
            seed: 0,
            grasp: grasp(0),
            start: 0.0,
            goal: 1.0,
            waypoints_robot: JointPath::from_values(1, vec![0.0; 30]).unwrap(),
            waypoints_object: JointPath::from_values(1, vec![0.0; 30]).unwrap(),
            waypoint_interval_s: 0.1,
            manipulation_start: 7,
            substeps: 5,
            regrasps,
            dense: DensePath::default(),
            verdict: None,
        }
    }

    fn grasp(id: u32) -> Grasp {
        Grasp { id, link: String::new(), link_from_tool: Pose::identity(), width_m: 0.01 }
    }

    #[test]
    fn one_grasp_is_one_segment() {
        let trajectory = trajectory(Vec::new());
        assert_eq!(trajectory.manipulation_samples(), 7..=7 + 29 * 5);
        assert_eq!(trajectory.segments().len(), 1);
        assert_eq!(trajectory.waypoint_sample(3), 22);
    }

    #[test]
    fn segments_meet_at_a_change_of_grasp() {
        let change = Regrasp { first_waypoint: 12, dense_start: 100, grasp: grasp(4) };
        let trajectory = trajectory(vec![change]);
        let segments = trajectory.segments();
        assert_eq!((segments[0].waypoints.clone(), segments[0].samples.clone()), (0..12, 7..=62));
        assert_eq!(
            (segments[1].waypoints.clone(), segments[1].samples.clone()),
            (12..30, 100..=185)
        );
        assert_eq!(segments[1].grasp.id, 4);
        assert_eq!(trajectory.manipulation_samples(), 7..=185);
        assert_eq!([11, 12, 29].map(|k| trajectory.waypoint_sample(k)), [62, 100, 185]);
    }
}
