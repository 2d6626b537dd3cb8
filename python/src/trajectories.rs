//! Trajectory files as Python objects with NumPy arrays.

use std::path::PathBuf;
use std::sync::Arc;

use akrobat_model::trajectory::Phase;
use akrobat_model::{JointPath, Trajectory, TrajectorySet, pose};
use akrobat_packager::trajectory_file;
use numpy::{PyArray, PyArray1, PyArray2, PyArrayMethods};
use pyo3::exceptions::PyIndexError;
use pyo3::prelude::*;

use crate::errors::to_python;

/// Trajectories of one task: a sequence.
#[pyclass(name = "Trajectories", module = "akrobat", frozen, sequence)]
pub struct PyTrajectories {
    set: Arc<TrajectorySet>,
}

impl PyTrajectories {
    /// Wraps a set.
    pub fn new(set: TrajectorySet) -> Self {
        Self { set: Arc::new(set) }
    }
}

#[pymethods]
impl PyTrajectories {
    /// Reads a trajectory file.
    #[staticmethod]
    fn read(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        let set = py.detach(|| trajectory_file::read(&path));
        let mut set = set.map_err(|error| to_python(error.into()))?;
        // Without its file, a set knows its task's folder only by the whole path.
        let folder = std::path::absolute(&path)?;
        let folder = folder.parent().unwrap_or(&path).join(&set.header.task_dir);
        set.header.task_dir = folder.display().to_string();
        Ok(Self::new(set))
    }

    /// Writes a trajectory file.
    fn write(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let written = py.detach(|| trajectory_file::write(&path, &self.set));
        written.map_err(|error| to_python(error.into()))
    }

    /// What the trajectories share, as plain Python values.
    #[getter]
    fn header<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        plain(py, &self.set.header)
    }

    /// Names of the robot columns.
    #[getter]
    fn robot_joints(&self) -> Vec<String> {
        self.set.header.robot_joints.clone()
    }

    /// Names of the object columns.
    #[getter]
    fn object_joints(&self) -> Vec<String> {
        self.set.header.object_joints.clone()
    }

    fn __len__(&self) -> usize {
        self.set.trajectories.len()
    }

    fn __getitem__(&self, index: isize) -> PyResult<PyTrajectory> {
        let count = self.__len__();
        let from_start = if index < 0 { index + count as isize } else { index };
        let index = usize::try_from(from_start).ok().filter(|&i| i < count);
        let index = index.ok_or_else(|| PyIndexError::new_err("trajectory index out of range"))?;
        Ok(PyTrajectory { set: Arc::clone(&self.set), index })
    }

    fn __repr__(&self) -> String {
        let header = &self.set.header;
        let count = self.set.trajectories.len();
        format!("<{count} trajectories of {}: {}>", header.robot_id, header.task_name)
    }
}

/// One trajectory.
#[pyclass(name = "Trajectory", module = "akrobat", frozen)]
pub struct PyTrajectory {
    set: Arc<TrajectorySet>,
    index: usize,
}

impl PyTrajectory {
    fn inner(&self) -> &Trajectory {
        &self.set.trajectories[self.index]
    }
}

#[pymethods]
impl PyTrajectory {
    /// Identity: a hash of scene, object, grasp, seed and configuration.
    #[getter]
    fn id(&self) -> &str {
        &self.inner().id
    }

    /// The seed of its own random numbers.
    #[getter]
    fn seed(&self) -> u64 {
        self.inner().seed
    }

    /// Position of the driven object joint at the first waypoint, rad or m.
    #[getter]
    fn start(&self) -> f64 {
        self.inner().start
    }

    /// Position of the driven object joint that the last waypoint reaches, rad or m.
    #[getter]
    fn goal(&self) -> f64 {
        self.inner().goal
    }

    /// Number of the grasp within the task.
    #[getter]
    fn grasp_id(&self) -> u32 {
        self.inner().grasp.id
    }

    /// Tool frame in the held link's frame, `x y z qw qx qy qz`.
    #[getter]
    fn link_from_tool<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray::from_slice(py, &pose::to_xyz_wxyz(&self.inner().grasp.link_from_tool))
    }

    /// Robot waypoints of the manipulation `[T, columns]`, rad or m.
    #[getter]
    fn waypoints_robot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        path_array(py, &self.inner().waypoints_robot)
    }

    /// Object waypoints of the manipulation `[T, columns]`, rad or m.
    #[getter]
    fn waypoints_object<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        path_array(py, &self.inner().waypoints_object)
    }

    /// Time between waypoints, seconds.
    #[getter]
    fn waypoint_interval_s(&self) -> f64 {
        self.inner().waypoint_interval_s
    }

    /// Times of the dense path `[N]`, seconds.
    #[getter]
    fn times_s<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray::from_slice(py, &self.inner().dense.times_s)
    }

    /// Robot joint positions of the dense path `[N, columns]`, rad or m.
    #[getter]
    fn robot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        path_array(py, &self.inner().dense.robot)
    }

    /// Object joint positions of the dense path `[N, columns]`, rad or m.
    #[getter]
    fn object<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        path_array(py, &self.inner().dense.object)
    }

    /// Phase of each dense sample `[N]`: 0 approach, 1 reach, 2 grasp, 3 manipulate, 4 regrasp, 5 release.
    #[getter]
    fn phase<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u8>> {
        let number = |phase: &Phase| *phase as u8;
        PyArray::from_iter(py, self.inner().dense.phase.iter().map(number))
    }

    /// The judge's findings, or `None` where it was not judged.
    #[getter]
    fn verdict<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        self.inner().verdict.as_ref().map(|verdict| plain(py, verdict)).transpose()
    }

    /// Configuration at a time on the dense path, linear between samples: robot and object positions.
    fn sample<'py>(
        &self,
        py: Python<'py>,
        time_s: f64,
    ) -> (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>) {
        let sample = self.inner().dense.sample(time_s);
        (PyArray::from_vec(py, sample.robot), PyArray::from_vec(py, sample.object))
    }

    fn __repr__(&self) -> String {
        let Trajectory { id, start, goal, dense, .. } = self.inner();
        format!("<trajectory {id}: {start} -> {goal} in {:.2} s>", dense.duration_s())
    }
}

fn path_array<'py>(py: Python<'py>, path: &JointPath) -> PyResult<Bound<'py, PyArray2<f32>>> {
    PyArray::from_slice(py, path.values()).reshape([path.rows(), path.columns()])
}

/// A serialisable value as dictionaries, lists and numbers.
pub fn plain<'py>(py: Python<'py>, value: &impl serde::Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value)
        .map_err(|error| pyo3::exceptions::PyValueError::new_err(error.to_string()))?;
    py.import("json")?.call_method1("loads", (text,))
}
