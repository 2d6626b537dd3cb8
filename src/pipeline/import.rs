//! Recordings of other tools -> trajectory file.

use std::path::PathBuf;

use akrobat_judge::{Judge, JudgeConfig, RobotSphere};
use akrobat_model::events::Event;
use akrobat_model::load;
use akrobat_model::task::Task;
use akrobat_model::trajectory::{DensePath, Grasp, TrajectoryHeader};
use akrobat_model::{JointPath, ModelError, Phase, Trajectory, TrajectorySet, hash};
use akrobat_packager::import::{self, Recording, Recordings};
use akrobat_packager::trajectory_file;
use akrobat_planner::Preparation;
use serde::Serialize;
use serde_json::json;

use super::export::host_for;
use super::plan::{absolute, relative_folder};
use super::{Context, check_writable, folder_of, on_threads};
use crate::Error;

/// Movement of the driven joint, rad or m, below which it counts as still.
const STILL: f64 = 1e-4;

/// What is to be imported.
#[derive(Debug, Clone)]
pub struct ImportRequest {
    /// AutoMoMa's `traj_data.pt` or recorder HDF5, or ManiSkill's `trajectory.h5`.
    pub input: PathBuf,
    /// The task that was recorded.
    pub task: PathBuf,
    /// Trajectory file to write.
    pub output: PathBuf,
    /// Seconds between the rows of the input.
    pub interval_s: Option<f64>,
    /// Factor of the object's positions: -1 where the recorder counts the other way round.
    pub object_sign: f64,
    /// Keep motions that the recorder did not call a success.
    pub keep_failures: bool,
    /// Judge the motions as planned ones are.
    pub judge: bool,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// Number of threads; one for each core where absent.
    pub threads: Option<usize>,
}

/// What an import gave.
#[derive(Debug, Clone, Serialize)]
pub struct ImportReport {
    /// The trajectory file.
    pub output: PathBuf,
    /// Which tool wrote the input.
    pub tool: &'static str,
    /// Trajectories written.
    pub trajectories: usize,
    /// Motions that were left out, each with the reason.
    pub skipped: Vec<String>,
    /// Trajectories that the judge accepted; none where it was not asked.
    pub accepted: Option<usize>,
}

/// AutoMoMa's frames of a whole trajectory: 30 waypoints over 119 thirtieths of a second.
const WAYPOINT_INTERVAL_S: f64 = 119.0 / 30.0 / 29.0;
/// Samples from one waypoint to the next, as many as the judge wants: robots drive there in a straight line of
/// joint space.
const WAYPOINT_SUBSTEPS: usize = 8;
/// Recorders' frames.
const FRAME_INTERVAL_S: f64 = 1.0 / 30.0;

/// Imports recordings as trajectories.
///
/// # Errors
/// Where the input or the task is wrong, or the output cannot be written.
pub fn import(request: &ImportRequest, context: &Context<'_>) -> Result<ImportReport, Error> {
    check_writable(&request.output)?;
    check_request(request)?;
    let search = context.asset_search(&request.assets)?;
    let task = load::task(&request.task, &search)?;
    let recordings = read(request, &task, context)?;
    let interval_s = request.interval_s.unwrap_or(match recordings.waypoints {
        true => WAYPOINT_INTERVAL_S,
        false => FRAME_INTERVAL_S,
    });
    let content = hash::of_file(&request.input)?;
    let converter = Converter { request, task: &task, recordings: &recordings, interval_s };
    converter.check_columns()?;
    let mut skipped = Vec::new();
    let mut trajectories = Vec::new();
    for motion in &recordings.motions {
        let reason = match motion.success || request.keep_failures {
            false => Some("the recorder did not call it a success"),
            true => None,
        };
        match reason.map_or_else(|| converter.trajectory(motion, &content), |r| Err(r.into())) {
            Ok(trajectory) => trajectories.push(trajectory),
            Err(reason) => skipped.push(format!("{}: {reason}", motion.key)),
        }
    }
    for reason in &skipped {
        context.observer.event(&Event::Warning { message: reason });
    }
    if trajectories.is_empty() {
        let message = format!("no motion to import; {}", skipped.join("; "));
        return Err(ModelError::invalid(&request.input, message).into());
    }
    let mut set = TrajectorySet { header: header(request, &task, recordings.tool)?, trajectories };
    let accepted = match request.judge {
        true => Some(on_threads(request.threads, || judge(&mut set, &task))?),
        false => None,
    };
    set.header.task_dir = relative_folder(folder_of(&request.output), folder_of(&request.task))?;
    trajectory_file::write(&request.output, &set)?;
    Ok(ImportReport {
        output: request.output.clone(),
        tool: recordings.tool,
        trajectories: set.trajectories.len(),
        skipped,
        accepted,
    })
}

fn check_request(request: &ImportRequest) -> Result<(), Error> {
    let usage = |message: String| Err(Error::Usage(message));
    match request.interval_s {
        Some(interval) if !(interval.is_finite() && interval > 0.0) => {
            usage(format!("--interval: expected seconds above 0, got {interval}"))
        }
        _ if request.object_sign.abs() != 1.0 => {
            usage(format!("--object-sign: expected 1 or -1, got {}", request.object_sign))
        }
        _ => Ok(()),
    }
}

fn read(request: &ImportRequest, task: &Task, context: &Context<'_>) -> Result<Recordings, Error> {
    let is_torch = request.input.extension().is_some_and(|e| e == "pt" || e == "pth");
    if is_torch {
        return host_for(context, "reading PyTorch files", "export")?
            .read_traj_data(&request.input);
    }
    Ok(import::read_recording(&request.input, &task.robot.name, &task.object.name)?)
}

struct Converter<'a> {
    request: &'a ImportRequest,
    task: &'a Task,
    recordings: &'a Recordings,
    interval_s: f64,
}

impl Converter<'_> {
    fn robot_columns(&self) -> usize {
        self.task.robot.trajectory_joints().len()
    }

    /// Robots may come with one column for all fingers, objects with the driven joint alone.
    fn check_columns(&self) -> Result<(), Error> {
        let (columns, fingers) = (self.robot_columns(), self.task.robot.gripper_joints.len());
        let single = columns - fingers + 1;
        let got = self.recordings.robot_columns;
        if got != columns && !(fingers > 0 && got == single) {
            let names = self.task.robot.trajectory_joint_names().join(", ");
            let message =
                format!("expected {columns} (or {single}) robot columns ({names}), got {got}");
            return Err(ModelError::invalid(&self.request.input, message).into());
        }
        let (all, got) = (self.task.object.tree.dof(), self.recordings.object_columns);
        if got != all && got != 1 {
            let message = format!("expected {all} (or 1) object columns, got {got}");
            return Err(ModelError::invalid(&self.request.input, message).into());
        }
        Ok(())
    }

    fn robot_row(&self, motion: &Recording, t: usize) -> Vec<f64> {
        let given = self.recordings.robot_columns;
        let row = &motion.robot[t * given..][..given];
        let last = row[given - 1];
        let missing = std::iter::repeat_n(last, self.robot_columns() - given);
        row.iter().copied().chain(missing).map(f64::from).collect()
    }

    fn object_row(&self, motion: &Recording, t: usize) -> Vec<f64> {
        let given = self.recordings.object_columns;
        let row = &motion.object[t * given..][..given];
        let signed = |v: f32| f64::from(v) * self.request.object_sign;
        if given == self.task.object.tree.dof() {
            return row.iter().copied().map(signed).collect();
        }
        self.task.object.configuration(signed(row[0]))
    }

    /// The motion with the part marked in which the object moves.
    fn trajectory(&self, motion: &Recording, content: &str) -> Result<Trajectory, String> {
        let Task { robot, object, .. } = self.task;
        let active =
            object.tree.column(object.active_joint).ok_or("the driven joint has no position")?;
        let driven: Vec<f64> =
            (0..motion.rows).map(|t| self.object_row(motion, t)[active]).collect();
        let (from, to) = match self.recordings.waypoints {
            true => (0, motion.rows - 1),
            false => moving(&driven).ok_or("the driven joint never moves")?,
        };
        let mut dense = DensePath {
            robot: JointPath::new(self.robot_columns()),
            object: JointPath::new(object.tree.dof()),
            ..DensePath::default()
        };
        // Frames are kept as they are: with two waypoints, the manipulation may have any number of them.
        let (samples, substeps) = match self.recordings.waypoints {
            true => (WAYPOINT_SUBSTEPS, WAYPOINT_SUBSTEPS),
            false => (1, to - from),
        };
        let (from, to) = (samples * from, samples * to);
        for sample in 0..=samples * (motion.rows - 1) {
            let phase = match sample {
                t if t <= from => Phase::Approach,
                t if t <= to => Phase::Manipulate,
                _ => Phase::Release,
            };
            let (t, fraction) = (sample / samples, (sample % samples) as f64 / samples as f64);
            let between = |row: &dyn Fn(usize) -> Vec<f64>| match sample % samples {
                0 => row(t),
                _ => lerp(&row(t), &row(t + 1), fraction),
            };
            let robot = between(&|t| self.robot_row(motion, t));
            let object = between(&|t| self.object_row(motion, t));
            dense.push((t as f64 + fraction) * self.interval_s, robot, object, phase);
        }
        let mut waypoints_robot = JointPath::new(self.robot_columns());
        let mut waypoints_object = JointPath::new(object.tree.dof());
        for t in (from..=to).step_by(substeps) {
            waypoints_robot.push(dense.robot.row_f64(t));
            waypoints_object.push(dense.object.row_f64(t));
        }
        let identity = format!("{content} {} {}", motion.key, self.interval_s);
        Ok(Trajectory {
            id: hash::of_bytes(identity.as_bytes())[..16].to_owned(),
            seed: motion.seed,
            grasp: self.grasp(motion.grasp_id, &dense, from, robot),
            start: driven[from / samples],
            goal: driven[to / samples],
            waypoints_robot,
            waypoints_object,
            waypoint_interval_s: substeps as f64 / samples as f64 * self.interval_s,
            manipulation_start: from as u32,
            substeps: substeps as u32,
            regrasps: Vec::new(),
            dense,
            verdict: None,
        })
    }

    /// The grasp is where the tool is when the object starts to move.
    fn grasp(
        &self,
        id: u32,
        dense: &DensePath,
        from: usize,
        robot: &akrobat_model::Robot,
    ) -> Grasp {
        let object = &self.task.object;
        let row = dense.robot.row_f64(from);
        let links = robot.tree.link_poses(&robot.world_from_root, &robot.configuration(&row));
        let world_from_tool = links[robot.tool_link] * robot.link_from_tool;
        let object_links =
            object.tree.link_poses(&object.world_from_root, &dense.object.row_f64(from));
        let gripper = &robot.file.gripper;
        let finger = row.len() - robot.gripper_joints.len();
        let fraction = match (gripper.closed.first(), gripper.open.first(), row.get(finger)) {
            (Some(closed), Some(open), Some(at)) if open != closed => {
                ((at - closed) / (open - closed)).clamp(0.0, 1.0)
            }
            _ => 0.0,
        };
        Grasp {
            id,
            link: object.tree.links()[object.handle_link].name.clone(),
            link_from_tool: object_links[object.handle_link].inverse() * world_from_tool,
            width_m: fraction * gripper.open_width_m,
        }
    }
}

fn lerp(from: &[f64], to: &[f64], fraction: f64) -> Vec<f64> {
    from.iter().zip(to).map(|(a, b)| a + fraction * (b - a)).collect()
}

/// The first and last sample between which a position changes.
fn moving(positions: &[f64]) -> Option<(usize, usize)> {
    let moves = |pair: &[f64]| (pair[1] - pair[0]).abs() > STILL;
    let first = positions.windows(2).position(moves)?;
    let last = positions.windows(2).rposition(moves)?;
    Some((first, last + 1))
}

fn header(request: &ImportRequest, task: &Task, tool: &str) -> Result<TrajectoryHeader, Error> {
    let object = &task.object.tree;
    let names = object.dof_joints().iter().map(|&j| object.joints()[j].name.clone());
    let source = request.input.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(TrajectoryHeader {
        task_toml: task.toml.clone(),
        task_dir: absolute(folder_of(&request.task))?.display().to_string(),
        task_name: task.file.name.clone(),
        scene_id: task.scene.name.clone(),
        object_id: task.object.name.clone(),
        robot_id: task.robot.name.clone(),
        base_kind: task.robot.file.base.kind,
        content_hashes: task.content_hashes.clone(),
        robot_joints: task.robot.trajectory_joint_names(),
        object_joints: names.collect(),
        active_joint: object.joints()[task.object.active_joint].name.clone(),
        contact_exceptions: Vec::new(),
        seed: task.file.seed,
        planner_config: json!({ "imported_from": source, "tool": tool }),
        backend: format!("imported from {tool}"),
        counts: std::collections::BTreeMap::new(),
    })
}

/// Judges every trajectory; returns how many are accepted.
fn judge(set: &mut TrajectorySet, task: &Task) -> Result<usize, Error> {
    let preparation = Preparation::new(task)?;
    let spheres: Vec<RobotSphere> = preparation
        .spheres
        .spheres
        .iter()
        .map(|s| RobotSphere { link: s.link, center: s.center, radius: s.radius })
        .collect();
    let judge = Judge::new(task, &spheres, &preparation.exceptions, JudgeConfig::default())?;
    set.header.contact_exceptions = preparation.exceptions.clone();
    for trajectory in &mut set.trajectories {
        trajectory.verdict = Some(judge.judge(trajectory));
    }
    let accepted = |t: &&Trajectory| t.verdict.as_ref().is_some_and(|v| v.accepted());
    Ok(set.trajectories.iter().filter(accepted).count())
}

impl ImportReport {
    /// One line for people.
    pub fn text(&self) -> String {
        let mut line = format!(
            "{}: {} trajectories from {}",
            self.output.display(),
            self.trajectories,
            self.tool
        );
        if let Some(accepted) = self.accepted {
            line += &format!(", {accepted} accepted by the judge");
        }
        if !self.skipped.is_empty() {
            line += &format!("; {} left out", self.skipped.len());
        }
        line
    }
}
