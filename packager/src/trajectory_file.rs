//! Trajectory files: HDF5, one file for the trajectories of one task.
//!
//! | path | shape | type | unit |
//! |---|---|---|---|
//! | `id`, `grasp/link`, `verdict/rejection`, `verdict/detail` | `[N]` | text | |
//! | `seed` | `[N]` | u64 | |
//! | `start`, `goal` (active object joint) | `[N]` | f64 | rad or m |
//! | `grasp/id` | `[N]` | u32 | |
//! | `grasp/pose` (`link_from_tool`, `x y z qw qx qy qz`) | `[N, 7]` | f64 | m |
//! | `grasp/width` | `[N]` | f64 | m |
//! | `waypoints/robot`, `waypoints/object` | `[N, T, columns]` | f32 | rad or m |
//! | `waypoints/interval` | `[N]` | f64 | s |
//! | `regrasp/offset` (absent where no grasp changes) | `[N + 1]` | u64 | changes |
//! | `regrasp/first_waypoint`, `regrasp/dense_start` | `[R]` | u32 | |
//! | `regrasp/id`, `regrasp/link`, `regrasp/pose`, `regrasp/width` | as in `grasp/`, `[R]` | | |
//! | `waypoints/dense_start`, `waypoints/dense_substeps` | `[N]` | u32 | samples |
//! | `dense/offset` | `[N + 1]` | u64 | samples |
//! | `dense/times` | `[M]` | f64 | s |
//! | `dense/robot`, `dense/object` | `[M, columns]` | f32 | rad or m |
//! | `dense/phase` | `[M]` | u8 | |
//! | `verdict/judged` | `[N]` | u8 | |
//! | `verdict/anchor_translation_m`, … | `[N]` | f64 | in the name |
//! | `verdict/samples` | `[N]` | u32 | |
//!
//! Trajectory i owns the dense samples `offset[i] .. offset[i + 1]`; its waypoint k is sample
//! `offset[i] + dense_start[i] + k * dense_substeps[i]`. Where grasps change, trajectory i owns the changes
//! `regrasp/offset[i] .. regrasp/offset[i + 1]`; from the first waypoint w of a change on, waypoint k is
//! sample `offset[i] + regrasp/dense_start + (k - w) * dense_substeps[i]`. What the trajectories share stands in
//! attributes of the root; structured values are JSON text.

use std::ops::Range;
use std::path::Path;

use akrobat_model::robot::BaseKind;
use akrobat_model::trajectory::{DensePath, Grasp, Regrasp, TrajectoryHeader};
use akrobat_model::{JointPath, Phase, Pose, Rejection, Trajectory, TrajectorySet, Verdict};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use crate::error::{PackError, Result};
use crate::h5::{DIGEST_ATTRIBUTE, GroupWriter, H5Reader, H5Writer, digest, read_error};

/// Value of the root attribute `format`.
pub const FORMAT: &str = "akrobat.trajectories";

/// Value of the root attribute `format_version`; raised when older readers would misread a file.
pub const FORMAT_VERSION: u32 = 2;

/// Version of files in which no grasp changes: what readers of the first version understand.
const FORMAT_VERSION_ONE_GRASP: u32 = 1;

/// Writes `set` to `path`. The same set gives the same bytes.
///
/// # Errors
/// [`PackError::Unwritable`] where the file cannot be created, [`PackError::Io`] where the disk is
/// full or fails, [`PackError::Inconsistent`] where arrays and names disagree in number or the
/// trajectories differ in their number of waypoints. In all cases `path` is left as it was.
pub fn write(path: &Path, set: &TrajectorySet) -> Result<()> {
    let dimensions = Dimensions::of(path, set)?;
    let file = H5Writer::create(path)?;
    let root = file.root();
    let changes = set.trajectories.iter().any(|t| !t.regrasps.is_empty());
    root.attr_str("format", FORMAT)?;
    let version = if changes { FORMAT_VERSION } else { FORMAT_VERSION_ONE_GRASP };
    root.attr("format_version", version)?;
    write_header(&root, &set.header)?;
    write_identity(&root, &set.trajectories)?;
    let grasps: Vec<&Grasp> = set.trajectories.iter().map(|t| &t.grasp).collect();
    write_grasps(&root.group("grasp")?, &grasps)?;
    if changes {
        write_regrasps(&root.group("regrasp")?, &set.trajectories)?;
    }
    write_waypoints(&root.group("waypoints")?, &set.trajectories, &dimensions)?;
    write_dense(&root.group("dense")?, &set.trajectories, &dimensions)?;
    write_verdicts(&root.group("verdict")?, &set.trajectories)?;
    drop(root);
    file.seal()?;
    file.finish()
}

/// Reads a trajectory file.
///
/// # Errors
/// [`PackError::Read`], [`PackError::Damaged`] or [`PackError::Content`]; the latter names dataset,
/// expectation and finding.
pub fn read(path: &Path) -> Result<TrajectorySet> {
    let file = H5Reader::open(path)?;
    let version = check_version(&file)?;
    let header = read_header(&file)?;
    let columns = Columns { robot: header.robot_joints.len(), object: header.object_joints.len() };
    let (seeds, shape) = file.array::<u64>("seed", &[None])?;
    let count = shape[0];
    let ids = file.strings("id", count)?;
    let starts = file.array::<f64>("start", &[Some(count)])?.0;
    let goals = file.array::<f64>("goal", &[Some(count)])?.0;
    let grasps = read_grasps(&file, "grasp", count)?;
    let regrasps = read_regrasps(&file, version, count)?;
    let waypoints = read_waypoints(&file, count, columns)?;
    let dense = read_dense(&file, count, columns)?;
    let verdicts = read_verdicts(&file, count)?;
    let parts = ids
        .into_iter()
        .zip(grasps.into_iter().zip(regrasps))
        .zip(waypoints)
        .zip(dense)
        .zip(verdicts);
    let trajectories = parts
        .enumerate()
        .map(|(i, ((((id, (grasp, regrasps)), waypoints), dense), verdict))| Trajectory {
            id,
            seed: seeds[i],
            grasp,
            start: starts[i],
            goal: goals[i],
            waypoints_robot: waypoints.robot,
            waypoints_object: waypoints.object,
            waypoint_interval_s: waypoints.interval_s,
            manipulation_start: waypoints.dense_start,
            substeps: waypoints.dense_substeps,
            regrasps,
            dense,
            verdict,
        })
        .collect();
    Ok(TrajectorySet { header, trajectories })
}

/// Reads a trajectory file and compares everything in it with its checksum.
///
/// # Errors
/// As [`read`], and [`PackError::Damaged`] where the checksum is another.
pub fn validate(path: &Path) -> Result<TrajectorySet> {
    let set = read(path)?;
    let file = H5Reader::open(path)?;
    let expected = file.attr_str(file.root(), DIGEST_ATTRIBUTE)?;
    let found = digest(file.root()).map_err(|e| read_error(path, "/", &e))?;
    if found == expected {
        return Ok(set);
    }
    Err(PackError::damaged(path, format!("the checksum is {found}, the file says {expected}")))
}

/// Numbers of columns of a row of joint positions.
#[derive(Debug, Clone, Copy)]
struct Columns {
    robot: usize,
    object: usize,
}

/// The sizes that all arrays of a file agree on.
#[derive(Debug)]
struct Dimensions {
    trajectories: usize,
    waypoints: usize,
    columns: Columns,
}

impl Dimensions {
    fn of(path: &Path, set: &TrajectorySet) -> Result<Self> {
        let columns = Columns {
            robot: set.header.robot_joints.len(),
            object: set.header.object_joints.len(),
        };
        let waypoints = set.trajectories.first().map_or(0, |t| t.waypoints_robot.rows());
        for (index, trajectory) in set.trajectories.iter().enumerate() {
            check_trajectory(path, index, trajectory, waypoints, columns)?;
        }
        Ok(Self { trajectories: set.trajectories.len(), waypoints, columns })
    }
}

fn check_trajectory(
    path: &Path,
    index: usize,
    trajectory: &Trajectory,
    waypoints: usize,
    columns: Columns,
) -> Result<()> {
    let dense = &trajectory.dense;
    let tables = [
        ("waypoints/robot", &trajectory.waypoints_robot, waypoints, columns.robot),
        ("waypoints/object", &trajectory.waypoints_object, waypoints, columns.object),
        ("dense/robot", &dense.robot, dense.len(), columns.robot),
        ("dense/object", &dense.object, dense.len(), columns.object),
    ];
    for (name, table, rows, columns) in tables {
        if table.columns() != columns || table.values().len() != rows * columns {
            return Err(PackError::inconsistent(
                path,
                format!("{name} of trajectory {index}"),
                format!("{rows} rows of {columns} columns"),
                format!("{} rows of {} columns", table.rows(), table.columns()),
            ));
        }
    }
    if dense.phase.len() != dense.len() {
        return Err(PackError::inconsistent(
            path,
            format!("dense/phase of trajectory {index}"),
            format!("{} values", dense.len()),
            format!("{} values", dense.phase.len()),
        ));
    }
    Ok(())
}

fn json<T: serde::Serialize>(value: &T) -> String {
    serde_json::to_string(value).expect("plain data with text keys has a JSON form")
}

fn write_header(root: &GroupWriter, header: &TrajectoryHeader) -> Result<()> {
    root.attr_str("quat_order", "wxyz")?;
    root.attr_str("length_unit", "m")?;
    root.attr_str("angle_unit", "rad")?;
    root.attr_str("time_unit", "s")?;
    root.attr_str("phase_names", &phase_names())?;
    root.attr_str("task_toml", &header.task_toml)?;
    root.attr_str("task_dir", &header.task_dir)?;
    root.attr_str("task_name", &header.task_name)?;
    root.attr_str("scene_id", &header.scene_id)?;
    root.attr_str("object_id", &header.object_id)?;
    root.attr_str("robot_id", &header.robot_id)?;
    root.attr_str("base_kind", &json(&header.base_kind))?;
    root.attr_str("content_hashes", &json(&header.content_hashes))?;
    root.attr_strings("robot_joints", &header.robot_joints)?;
    root.attr_strings("object_joints", &header.object_joints)?;
    root.attr_str("active_joint", &header.active_joint)?;
    root.attr_str("contact_exceptions", &json(&header.contact_exceptions))?;
    root.attr("seed", header.seed)?;
    root.attr_str("planner_config", &json(&header.planner_config))?;
    root.attr_str("backend", &header.backend)?;
    root.attr_str("counts", &json(&header.counts))
}

/// JSON list of the phase names, in the order of their numbers in `dense/phase`.
pub(crate) fn phase_names() -> String {
    json(&Phase::ALL)
}

fn read_header(file: &H5Reader) -> Result<TrajectoryHeader> {
    let root = file.root();
    Ok(TrajectoryHeader {
        task_toml: file.attr_str(root, "task_toml")?,
        task_dir: file.attr_str(root, "task_dir")?,
        task_name: file.attr_str(root, "task_name")?,
        scene_id: file.attr_str(root, "scene_id")?,
        object_id: file.attr_str(root, "object_id")?,
        robot_id: file.attr_str(root, "robot_id")?,
        base_kind: file.attr_json::<BaseKind>(root, "base_kind")?,
        content_hashes: file.attr_json(root, "content_hashes")?,
        robot_joints: file.attr_strings(root, "robot_joints")?,
        object_joints: file.attr_strings(root, "object_joints")?,
        active_joint: file.attr_str(root, "active_joint")?,
        contact_exceptions: file.attr_json(root, "contact_exceptions")?,
        seed: file.attr(root, "seed")?,
        planner_config: file.attr_json(root, "planner_config")?,
        backend: file.attr_str(root, "backend")?,
        counts: file.attr_json(root, "counts")?,
    })
}

/// The version of a trajectory file, if this reader knows it.
fn check_version(file: &H5Reader) -> Result<u32> {
    check_format(file, FORMAT, &[FORMAT_VERSION_ONE_GRASP, FORMAT_VERSION])
}

/// The version of a file. Refuses files of another kind and of versions this reader does not know.
pub(crate) fn check_format(file: &H5Reader, format: &str, versions: &[u32]) -> Result<u32> {
    let got = file.attr_str(file.root(), "format")?;
    if got != format {
        return Err(PackError::content(file.path(), "/ attribute format", format, got));
    }
    let got = file.attr::<u32>(file.root(), "format_version")?;
    if !versions.contains(&got) {
        let known = versions.iter().map(u32::to_string).collect::<Vec<_>>().join(" or ");
        let item = "/ attribute format_version";
        return Err(PackError::content(file.path(), item, known, got.to_string()));
    }
    Ok(got)
}

fn write_identity(root: &GroupWriter, trajectories: &[Trajectory]) -> Result<()> {
    let count = [trajectories.len()];
    root.strings("id", &trajectories.iter().map(|t| &t.id).collect::<Vec<_>>())?;
    root.array("seed", &count, &each(trajectories, |t| t.seed))?;
    root.array("start", &count, &each(trajectories, |t| t.start))?;
    root.array("goal", &count, &each(trajectories, |t| t.goal))?;
    Ok(())
}

fn each<T>(trajectories: &[Trajectory], value: impl Fn(&Trajectory) -> T) -> Vec<T> {
    trajectories.iter().map(value).collect()
}

fn write_grasps(group: &GroupWriter, grasps: &[&Grasp]) -> Result<()> {
    let count = grasps.len();
    let poses: Vec<f64> = grasps.iter().flat_map(|g| pose_row(&g.link_from_tool)).collect();
    group.array("id", &[count], &grasps.iter().map(|g| g.id).collect::<Vec<_>>())?;
    group.strings("link", &grasps.iter().map(|g| &g.link).collect::<Vec<_>>())?;
    let pose = group.array("pose", &[count, 7], &poses)?;
    group.dataset_attr_str(&pose, "frame", "link_from_tool")?;
    group.dataset_attr_str(&pose, "columns", "x y z qw qx qy qz")?;
    let widths: Vec<f64> = grasps.iter().map(|g| g.width_m).collect();
    let width = group.array("width", &[count], &widths)?;
    group.dataset_attr_str(&width, "unit", "m")
}

fn write_regrasps(group: &GroupWriter, trajectories: &[Trajectory]) -> Result<()> {
    let mut offset = vec![0u64];
    for trajectory in trajectories {
        offset.push(offset.last().unwrap_or(&0) + trajectory.regrasps.len() as u64);
    }
    let changes: Vec<&Regrasp> = trajectories.iter().flat_map(|t| &t.regrasps).collect();
    let numbers = |of: fn(&Regrasp) -> u32| changes.iter().map(|r| of(r)).collect::<Vec<_>>();
    group.array("offset", &[offset.len()], &offset)?;
    group.array("first_waypoint", &[changes.len()], &numbers(|r| r.first_waypoint))?;
    group.array("dense_start", &[changes.len()], &numbers(|r| r.dense_start))?;
    write_grasps(group, &changes.iter().map(|r| &r.grasp).collect::<Vec<_>>())
}

/// The changes of grasp of each trajectory.
fn read_regrasps(file: &H5Reader, version: u32, count: usize) -> Result<Vec<Vec<Regrasp>>> {
    if version == FORMAT_VERSION_ONE_GRASP {
        return Ok(vec![Vec::new(); count]);
    }
    let (offset, _) = file.array::<u64>("regrasp/offset", &[count.checked_add(1)])?;
    let (first_waypoint, shape) = file.array::<u32>("regrasp/first_waypoint", &[None])?;
    let dense_start = file.array::<u32>("regrasp/dense_start", &[Some(shape[0])])?.0;
    let grasps = read_grasps(file, "regrasp", shape[0])?;
    let ranges = ranges(&offset, shape[0]).ok_or_else(|| {
        let expected = format!("non-decreasing numbers from 0 to {}", shape[0]);
        PackError::content(file.path(), "regrasp/offset", expected, "others")
    })?;
    let change = |i: usize| Regrasp {
        first_waypoint: first_waypoint[i],
        dense_start: dense_start[i],
        grasp: grasps[i].clone(),
    };
    Ok(ranges.into_iter().map(|range| range.map(change).collect()).collect())
}

/// `[x y z qw qx qy qz]`, with the sign of the quaternion as it is, so that reading gives back the
/// very same numbers.
fn pose_row(pose: &Pose) -> [f64; 7] {
    let (t, q) = (pose.translation.vector, pose.rotation.into_inner());
    [t.x, t.y, t.z, q.w, q.i, q.j, q.k]
}

fn pose_from_row(row: &[f64]) -> Option<Pose> {
    let &[x, y, z, w, i, j, k] = row else { return None };
    let quaternion = Quaternion::new(w, i, j, k);
    let unit = (quaternion.norm() - 1.0).abs() < 1e-6;
    (unit && x.is_finite() && y.is_finite() && z.is_finite()).then(|| {
        let rotation = UnitQuaternion::new_unchecked(quaternion);
        Pose::from_parts(Translation3::new(x, y, z), rotation)
    })
}

fn read_grasps(file: &H5Reader, group: &str, count: usize) -> Result<Vec<Grasp>> {
    let ids = file.array::<u32>(&format!("{group}/id"), &[Some(count)])?.0;
    let links = file.strings(&format!("{group}/link"), count)?;
    let poses = file.array::<f64>(&format!("{group}/pose"), &[Some(count), Some(7)])?.0;
    let widths = file.array::<f64>(&format!("{group}/width"), &[Some(count)])?.0;
    let grasp = |(index, link): (usize, String)| {
        let row = &poses[index * 7..][..7];
        let link_from_tool = pose_from_row(row).ok_or_else(|| {
            let item = format!("{group}/pose row {index}");
            PackError::content(
                file.path(),
                item,
                "a position and a unit quaternion",
                format!("{row:?}"),
            )
        })?;
        Ok(Grasp { id: ids[index], link, link_from_tool, width_m: widths[index] })
    };
    links.into_iter().enumerate().map(grasp).collect()
}

fn write_waypoints(
    group: &GroupWriter,
    trajectories: &[Trajectory],
    dimensions: &Dimensions,
) -> Result<()> {
    let Dimensions { trajectories: count, waypoints, columns } = *dimensions;
    let robot = concatenated(trajectories, |t| &t.waypoints_robot);
    let object = concatenated(trajectories, |t| &t.waypoints_object);
    group.array("robot", &[count, waypoints, columns.robot], &robot)?;
    group.array("object", &[count, waypoints, columns.object], &object)?;
    let interval =
        group.array("interval", &[count], &each(trajectories, |t| t.waypoint_interval_s))?;
    group.dataset_attr_str(&interval, "unit", "s")?;
    group.array("dense_start", &[count], &each(trajectories, |t| t.manipulation_start))?;
    group.array("dense_substeps", &[count], &each(trajectories, |t| t.substeps))?;
    Ok(())
}

fn concatenated(
    trajectories: &[Trajectory],
    table: impl Fn(&Trajectory) -> &JointPath,
) -> Vec<f32> {
    trajectories.iter().flat_map(|t| table(t).values()).copied().collect()
}

/// The part of a trajectory that `waypoints/` holds.
struct Waypoints {
    robot: JointPath,
    object: JointPath,
    interval_s: f64,
    dense_start: u32,
    dense_substeps: u32,
}

fn read_waypoints(file: &H5Reader, count: usize, columns: Columns) -> Result<Vec<Waypoints>> {
    let robot_shape = [Some(count), None, Some(columns.robot)];
    let (robot, shape) = file.array::<f32>("waypoints/robot", &robot_shape)?;
    let rows = shape[1];
    let object_shape = [Some(count), Some(rows), Some(columns.object)];
    let object = file.array::<f32>("waypoints/object", &object_shape)?.0;
    let interval_s = file.array::<f64>("waypoints/interval", &[Some(count)])?.0;
    let dense_start = file.array::<u32>("waypoints/dense_start", &[Some(count)])?.0;
    let dense_substeps = file.array::<u32>("waypoints/dense_substeps", &[Some(count)])?.0;
    let waypoints = (0..count).map(|i| Waypoints {
        robot: table(&robot, i * rows..(i + 1) * rows, columns.robot),
        object: table(&object, i * rows..(i + 1) * rows, columns.object),
        interval_s: interval_s[i],
        dense_start: dense_start[i],
        dense_substeps: dense_substeps[i],
    });
    Ok(waypoints.collect())
}

/// Rows of an array whose shape was checked.
fn table(values: &[f32], rows: Range<usize>, columns: usize) -> JointPath {
    let values = values[rows.start * columns..rows.end * columns].to_vec();
    JointPath::from_values(columns, values).expect("whole rows were taken")
}

fn write_dense(
    group: &GroupWriter,
    trajectories: &[Trajectory],
    dimensions: &Dimensions,
) -> Result<()> {
    let mut offset = vec![0u64];
    for trajectory in trajectories {
        offset.push(offset.last().unwrap_or(&0) + trajectory.dense.len() as u64);
    }
    let times: Vec<f64> =
        trajectories.iter().flat_map(|t| t.dense.times_s.iter().copied()).collect();
    let phase: Vec<u8> =
        trajectories.iter().flat_map(|t| t.dense.phase.iter().map(|&p| p as u8)).collect();
    let (samples, columns) = (times.len(), dimensions.columns);
    group.array("offset", &[offset.len()], &offset)?;
    let times = group.array("times", &[samples], &times)?;
    group.dataset_attr_str(&times, "unit", "s")?;
    let robot = concatenated(trajectories, |t| &t.dense.robot);
    group.array("robot", &[samples, columns.robot], &robot)?;
    let object = concatenated(trajectories, |t| &t.dense.object);
    group.array("object", &[samples, columns.object], &object)?;
    let phase = group.array("phase", &[samples], &phase)?;
    group.dataset_attr_str(&phase, "names", &phase_names())
}

fn read_dense(file: &H5Reader, count: usize, columns: Columns) -> Result<Vec<DensePath>> {
    let expected = count.checked_add(1);
    let (offset, _) = file.array::<u64>("dense/offset", &[expected])?;
    let (times_s, shape) = file.array::<f64>("dense/times", &[None])?;
    let samples = shape[0];
    let robot = file.array::<f32>("dense/robot", &[Some(samples), Some(columns.robot)])?.0;
    let object = file.array::<f32>("dense/object", &[Some(samples), Some(columns.object)])?.0;
    let phase = file.array::<u8>("dense/phase", &[Some(samples)])?.0;
    let phase = phase.into_iter().map(|n| phase_of(file, n)).collect::<Result<Vec<_>>>()?;
    let ranges = ranges(&offset, samples).ok_or_else(|| {
        let expected = format!("non-decreasing numbers from 0 to {samples}");
        PackError::content(file.path(), "dense/offset", expected, "others")
    })?;
    let path = |rows: Range<usize>| DensePath {
        times_s: times_s[rows.clone()].to_vec(),
        robot: table(&robot, rows.clone(), columns.robot),
        object: table(&object, rows.clone(), columns.object),
        phase: phase[rows].to_vec(),
    };
    Ok(ranges.into_iter().map(path).collect())
}

fn phase_of(file: &H5Reader, number: u8) -> Result<Phase> {
    Phase::ALL.get(usize::from(number)).copied().ok_or_else(|| {
        let expected = format!("numbers below {}", Phase::ALL.len());
        PackError::content(file.path(), "dense/phase", expected, number.to_string())
    })
}

/// The ranges between neighbouring offsets; `None` unless they cover `0..total` in order.
fn ranges(offset: &[u64], total: usize) -> Option<Vec<Range<usize>>> {
    let covers = offset.first() == Some(&0) && offset.last() == Some(&(total as u64));
    (covers && offset.is_sorted())
        .then(|| offset.windows(2).map(|w| w[0] as usize..w[1] as usize).collect())
}

/// Where a verdict keeps one of its numbers.
type VerdictValue = fn(&mut Verdict) -> &mut f64;

/// The numbers of a verdict with their names in the file.
const VERDICT_VALUES: [(&str, VerdictValue); 6] = [
    ("anchor_translation_m", |v| &mut v.anchor_translation_m),
    ("anchor_rotation_rad", |v| &mut v.anchor_rotation_rad),
    ("velocity_fraction", |v| &mut v.velocity_fraction),
    ("acceleration_fraction", |v| &mut v.acceleration_fraction),
    ("base_yaw_rad", |v| &mut v.base_yaw_rad),
    ("penetration_m", |v| &mut v.penetration_m),
];

/// Stands in the file for trajectories that were not judged.
fn no_verdict() -> Verdict {
    Verdict {
        rejection: None,
        detail: String::new(),
        anchor_translation_m: f64::NAN,
        anchor_rotation_rad: f64::NAN,
        velocity_fraction: f64::NAN,
        acceleration_fraction: f64::NAN,
        base_yaw_rad: f64::NAN,
        penetration_m: f64::NAN,
        samples: 0,
    }
}

fn write_verdicts(group: &GroupWriter, trajectories: &[Trajectory]) -> Result<()> {
    let count = [trajectories.len()];
    let mut verdicts = each(trajectories, |t| t.verdict.clone().unwrap_or_else(no_verdict));
    group.array("judged", &count, &each(trajectories, |t| u8::from(t.verdict.is_some())))?;
    let rejections: Vec<&str> =
        verdicts.iter().map(|v| v.rejection.map_or("", Rejection::name)).collect();
    group.strings("rejection", &rejections)?;
    let details: Vec<&str> = verdicts.iter().map(|v| v.detail.as_str()).collect();
    group.strings("detail", &details)?;
    let samples: Vec<u32> = verdicts.iter().map(|v| v.samples).collect();
    group.array("samples", &count, &samples)?;
    for (name, value) in VERDICT_VALUES {
        let values: Vec<f64> = verdicts.iter_mut().map(|v| *value(v)).collect();
        group.array(name, &count, &values)?;
    }
    Ok(())
}

fn read_verdicts(file: &H5Reader, count: usize) -> Result<Vec<Option<Verdict>>> {
    let judged = file.array::<u8>("verdict/judged", &[Some(count)])?.0;
    let rejections = file.strings("verdict/rejection", count)?;
    let details = file.strings("verdict/detail", count)?;
    let samples = file.array::<u32>("verdict/samples", &[Some(count)])?.0;
    let mut verdicts = vec![no_verdict(); count];
    for (name, value) in VERDICT_VALUES {
        let values = file.array::<f64>(&format!("verdict/{name}"), &[Some(count)])?.0;
        verdicts.iter_mut().zip(values).for_each(|(verdict, v)| *value(verdict) = v);
    }
    let texts = rejections.into_iter().zip(details).zip(samples);
    for (verdict, ((rejection, detail), samples)) in verdicts.iter_mut().zip(texts) {
        verdict.rejection = rejection_of(file, &rejection)?;
        verdict.detail = detail;
        verdict.samples = samples;
    }
    Ok(judged.into_iter().zip(verdicts).map(|(j, v)| (j != 0).then_some(v)).collect())
}

fn rejection_of(file: &H5Reader, name: &str) -> Result<Option<Rejection>> {
    if name.is_empty() {
        return Ok(None);
    }
    let found = Rejection::ALL.into_iter().find(|r| r.name() == name);
    found.map(Some).ok_or_else(|| {
        let names = Rejection::ALL.map(Rejection::name).join(", ");
        PackError::content(
            file.path(),
            "verdict/rejection",
            format!("nothing or one of {names}"),
            name,
        )
    })
}
