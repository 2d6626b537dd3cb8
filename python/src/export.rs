//! Writers of export formats that need a Python library: hands episodes to `akrobat.exporters` as arrays.

use std::path::{Path, PathBuf};

use akrobat::Error;
use akrobat_model::TrajectorySet;
use akrobat_packager::PackError;
use akrobat_packager::error::Result;
use akrobat_packager::export::{
    Depth, Episode, ExportFormat, ExportHeader, FrameBatch, Sink, Table,
};
use akrobat_packager::import::{Recording, Recordings};
use numpy::{
    Element, PyArray, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyImportError, PyOSError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A writer in Python.
pub struct PythonSink {
    writer: Py<PyAny>,
    folder: PathBuf,
}

impl PythonSink {
    /// Opens the writer of a format into an empty folder.
    ///
    /// # Errors
    /// Where a library is missing (the message says what to install), or files cannot be created.
    pub fn open(
        format: ExportFormat,
        folder: &Path,
        header: &ExportHeader,
    ) -> std::result::Result<Self, Error> {
        let header = serde_json::to_string(header)
            .map_err(|e| Error::Failed(format!("the export's header: {e}")))?;
        let writer = Python::attach(|py| {
            let module = py.import("akrobat.exporters")?;
            let writer = module.call_method1("open_writer", (format.name(), folder, header))?;
            Ok(writer.unbind())
        })
        .map_err(usage_error)?;
        Ok(Self { writer, folder: folder.to_path_buf() })
    }

    fn call<'py>(
        &self,
        py: Python<'py>,
        method: &str,
        arguments: impl pyo3::call::PyCallArgs<'py>,
    ) -> PyResult<()> {
        self.writer.bind(py).call_method1(method, arguments).map(drop)
    }

    fn error(&self, error: PyErr) -> PackError {
        pack_error(&self.folder, error)
    }
}

impl Sink for PythonSink {
    fn begin(&mut self, episode: &Episode) -> Result<()> {
        Python::attach(|py| {
            let attributes = serde_json::to_string(&episode.attributes).unwrap_or_default();
            self.call(py, "begin", (episode.index, attributes, arrays_of(py, episode)?))
        })
        .map_err(|e| self.error(e))
    }

    fn frames(&mut self, episode: &Episode, batch: &FrameBatch) -> Result<()> {
        Python::attach(|py| self.call(py, "frames", (batch.first, frames_of(py, episode, batch)?)))
            .map_err(|e| self.error(e))
    }

    fn end(&mut self, _: &Episode) -> Result<()> {
        Python::attach(|py| self.call(py, "end", ())).map_err(|e| self.error(e))
    }

    fn finish(&mut self) -> Result<()> {
        Python::attach(|py| self.call(py, "finish", ())).map_err(|e| self.error(e))
    }
}

/// Writes the waypoints of a trajectory file as AutoMoMa's `traj_data.pt`.
///
/// # Errors
/// Where the file cannot be written.
pub fn write_traj_data(file: &Path, set: &TrajectorySet) -> std::result::Result<(), Error> {
    let trajectories = &set.trajectories;
    let columns = set.header.object_joints.len().max(1);
    let joints = &set.header.object_joints;
    let active = joints.iter().position(|joint| *joint == set.header.active_joint).unwrap_or(0);
    let waypoints = trajectories.first().map_or(0, |t| t.waypoints_robot.rows());
    let robot: Vec<f32> =
        trajectories.iter().flat_map(|t| t.waypoints_robot.values()).copied().collect();
    let object: Vec<f32> = trajectories
        .iter()
        .flat_map(|t| t.waypoints_object.values().chunks(columns))
        .map(|row| row[active])
        .collect();
    let success: Vec<bool> =
        trajectories.iter().map(|t| t.verdict.as_ref().is_none_or(|v| v.accepted())).collect();
    let grasp_id: Vec<i64> = trajectories.iter().map(|t| i64::from(t.grasp.id)).collect();
    let pose = |t: &akrobat_model::Trajectory| {
        akrobat_model::pose::to_xyz_wxyz(&t.grasp.link_from_tool).map(|v| v as f32)
    };
    let grasp_pose: Vec<f32> = trajectories.iter().flat_map(pose).collect();
    let goals: Vec<f32> = trajectories.iter().map(|t| t.goal as f32).collect();
    let (count, columns) = (trajectories.len(), set.header.robot_joints.len());
    Python::attach(|py| {
        let arrays = PyDict::new(py);
        arrays.set_item("traj_robot", array(py, &robot, &[count, waypoints, columns])?)?;
        arrays.set_item("traj_obj", array(py, &object, &[count, waypoints, 1])?)?;
        arrays.set_item("traj_success", array(py, &success, &[count])?)?;
        arrays.set_item("grasp_id", array(py, &grasp_id, &[count])?)?;
        arrays.set_item("grasp_pose", array(py, &grasp_pose, &[count, 7])?)?;
        arrays.set_item("goal_angle", array(py, &goals, &[count])?)?;
        let names = (&set.header.scene_id, &set.header.object_id);
        let module = py.import("akrobat.exporters.traj_data")?;
        module.call_method1("write", (file, arrays, names.0, names.1)).map(drop)
    })
    .map_err(|e| Error::Pack(pack_error(file, e)))
}

/// Reads AutoMoMa's `traj_data.pt`.
///
/// # Errors
/// [`Error::Usage`] where the file is not of that kind.
pub fn read_traj_data(file: &Path) -> std::result::Result<Recordings, Error> {
    type Tables<'py> = (
        PyReadonlyArray3<'py, f32>,
        PyReadonlyArray3<'py, f32>,
        PyReadonlyArray1<'py, bool>,
        PyReadonlyArray1<'py, i64>,
    );
    Python::attach(|py| {
        let module = py.import("akrobat.exporters.traj_data")?;
        let tables: Tables<'_> = module.call_method1("read_motions", (file,))?.extract()?;
        let (robot, object, success, grasps) = &tables;
        let [_, rows, robot_columns] = *robot.shape() else { unreachable!("three axes") };
        let object_columns = object.shape()[2];
        let motions = success.as_slice()?.iter().zip(grasps.as_slice()?).enumerate();
        let motions = motions.map(|(index, (&success, &grasp_id))| {
            let part = |values: &[f32], columns: usize| {
                values[index * rows * columns..][..rows * columns].to_vec()
            };
            Ok(Recording {
                key: format!("trajectory {index}"),
                rows,
                robot: part(robot.as_slice()?, robot_columns),
                object: part(object.as_slice()?, object_columns),
                success,
                grasp_id: u32::try_from(grasp_id).unwrap_or(0),
                seed: 0,
            })
        });
        Ok(Recordings {
            tool: "automoma",
            robot_columns,
            object_columns,
            waypoints: true,
            motions: motions.collect::<PyResult<_>>()?,
        })
    })
    .map_err(usage_error)
}

/// The tables of an episode by name.
fn arrays_of<'py>(py: Python<'py>, episode: &Episode) -> PyResult<Bound<'py, PyDict>> {
    let frames = episode.frames();
    let arrays = PyDict::new(py);
    let table = |table: &Table| array(py, &table.values, &[frames, table.columns()]);
    arrays.set_item("action", table(&episode.action)?)?;
    arrays.set_item("state", table(&episode.state)?)?;
    arrays.set_item("time", array(py, &episode.time_s, &[frames])?)?;
    arrays.set_item("phase", array(py, &episode.phase, &[frames])?)?;
    arrays.set_item("eef_pose", array(py, &episode.eef, &[frames, 7])?)?;
    arrays.set_item("base_pose", array(py, &episode.base, &[frames, 7])?)?;
    for (name, articulation) in [("robot", &episode.robot), ("object", &episode.object)] {
        let shape = [frames, articulation.joints.len()];
        arrays.set_item(format!("{name}_position"), array(py, &articulation.position, &shape)?)?;
        arrays.set_item(format!("{name}_joints"), &articulation.joints)?;
    }
    arrays.set_item("object_pose", array(py, &episode.object.root_pose, &[frames, 7])?)?;
    for camera in &episode.cameras {
        let key = |kind: &str| format!("{}/{kind}", camera.name);
        arrays.set_item(key("intrinsics"), array(py, &camera.intrinsics, &[frames, 3, 3])?)?;
        let poses = array(py, &camera.world_from_camera, &[frames, 4, 4])?;
        arrays.set_item(key("world_from_camera"), poses)?;
    }
    Ok(arrays)
}

/// The images and clouds of a few frames by name; only what was read.
fn frames_of<'py>(
    py: Python<'py>,
    episode: &Episode,
    batch: &FrameBatch,
) -> PyResult<Bound<'py, PyDict>> {
    let arrays = PyDict::new(py);
    for (camera, images) in episode.cameras.iter().zip(&batch.cameras) {
        let shape = [batch.count, camera.height, camera.width];
        let key = |kind: &str| format!("{}/{kind}", camera.name);
        if !images.rgb.is_empty() {
            let shape = [shape[0], shape[1], shape[2], 3];
            arrays.set_item(key("rgb"), array(py, &images.rgb, &shape)?)?;
        }
        match &images.depth {
            Depth::Millimetres(values) if values.is_empty() => {}
            Depth::Millimetres(values) => {
                arrays.set_item(key("depth_mm"), array(py, values, &shape)?)?;
            }
            depth @ Depth::Metres(_) => {
                arrays.set_item(key("depth_mm"), array(py, &depth.millimetres(), &shape)?)?;
            }
        }
    }
    if !batch.cloud.is_empty() {
        let shape = [batch.count, episode.cloud_points, 6];
        arrays.set_item("point_cloud", array(py, &batch.cloud, &shape)?)?;
    }
    Ok(arrays)
}

fn array<'py, T: Element>(
    py: Python<'py>,
    values: &[T],
    shape: &[usize],
) -> PyResult<Bound<'py, numpy::PyArrayDyn<T>>> {
    PyArray::from_slice(py, values).reshape(shape.to_vec())
}

/// A missing library and a wrong request are the user's to mend.
pub fn usage_error(error: PyErr) -> Error {
    Python::attach(|py| {
        let message = error.value(py).to_string();
        if error.is_instance_of::<PyImportError>(py)
            || error.is_instance_of::<crate::errors::InputError>(py)
        {
            Error::Usage(message)
        } else {
            Error::Failed(message)
        }
    })
}

/// A failing disk is an I/O error, anything else what the library said.
pub fn pack_error(path: &Path, error: PyErr) -> PackError {
    Python::attach(|py| {
        let number = error.value(py).getattr("errno").and_then(|n| n.extract::<i32>());
        match number {
            Ok(code) if error.is_instance_of::<PyOSError>(py) => PackError::Io {
                path: path.to_path_buf(),
                source: std::io::Error::from_raw_os_error(code),
            },
            _ => PackError::Library {
                path: path.to_path_buf(),
                item: "the export".into(),
                message: error.to_string(),
            },
        }
    })
}
