//! What cameras see of robot and object in any state, for environments.

use std::sync::{Arc, Mutex, PoisonError};

use akrobat::pipeline;
use akrobat_cameras::Rig;
use akrobat_model::pose;
use akrobat_model::task::Task;
use akrobat_model::trajectory::{Grasp, PathSample, Phase};
use akrobat_renderer::handle::Handle;
use akrobat_renderer::placement::PlacedRig;
use akrobat_renderer::pointcloud::{CloudConfig, CloudPlace, fuse};
use akrobat_renderer::replay::Replay;
use akrobat_renderer::{Backend, FrameState, RenderError, RenderScene, SoftBackend};
use numpy::{PyArray, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::errors::{InputError, to_python};
use crate::sapien;
use crate::task::PyTask;

/// Renders single states of a task on the CPU.
#[pyclass(name = "Observer", module = "akrobat", frozen)]
pub struct PyObserver {
    task: Arc<Task>,
    scene: RenderScene,
    rig: PlacedRig,
    handle: Handle,
    cloud: CloudConfig,
    backend: Mutex<SoftBackend>,
}

#[pymethods]
impl PyObserver {
    /// Mounts a rig. Cameras that look at the handle are placed for a robot that stands at `robot` while the
    /// driven joint moves to `goal`; `link_from_handle` is the middle of the handle. `cloud` is the
    /// configuration of clouds (JSON); `rig` is a preset's name, a rig file or a rig as JSON.
    #[new]
    fn new(
        task: &PyTask,
        rig: &str,
        cloud: &str,
        robot: Vec<f64>,
        goal: f64,
        link_from_handle: [f64; 7],
    ) -> PyResult<Self> {
        let task = Arc::clone(task.inner());
        let object = &task.object;
        let link = object.tree.links()[object.handle_link].name.clone();
        let link_from_tool = pose::from_xyz_wxyz(link_from_handle)
            .ok_or_else(|| InputError::new_err("link_from_handle: expected x y z qw qx qy qz"))?;
        let scene = RenderScene::from_task(&task).map_err(render_error)?;
        let rig = open_rig(rig)?;
        let handle = Handle::new(&task, &Grasp { id: 0, link, link_from_tool, width_m: 0.0 })
            .map_err(|error| to_python(error.into()))?;
        check_row(&task, &robot)?;
        let start = object.tree.joint_position(object.active_joint, &object.start);
        let keyframes: Vec<FrameState> = (0..=8u32)
            .map(|key| {
                let position = start + (goal - start) * f64::from(key) / 8.0;
                let object = task.object.configuration(position);
                let sample = PathSample { robot: robot.clone(), object, phase: Phase::Manipulate };
                Replay::new(&task, &scene).at_sample(key, 0.0, sample)
            })
            .collect();
        let rig = PlacedRig::new(&rig, &task, &scene, &handle, &keyframes).map_err(render_error)?;
        let wrong = |message: String| InputError::new_err(format!("cloud: {message}"));
        let cloud: CloudConfig = serde_json::from_str(cloud).map_err(|e| wrong(e.to_string()))?;
        cloud.check().map_err(wrong)?;
        Ok(Self { task, scene, rig, handle, cloud, backend: Mutex::new(SoftBackend::new()) })
    }

    /// What is seen with the robot at `robot` (a trajectory's columns) and the object's joints at `object`:
    /// `cameras` by name, each with `rgb`, `depth_m`, `segmentation`, `K` and `world_from_camera`; and `cloud` `[N, 6]`.
    fn observe<'py>(
        &self,
        py: Python<'py>,
        robot: Vec<f64>,
        object: Vec<f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let sample = self.sample(robot, object)?;
        let seen = py.detach(|| {
            let state = Replay::new(&self.task, &self.scene).at_sample(0, 0.0, sample);
            let mut backend = self.backend.lock().unwrap_or_else(PoisonError::into_inner);
            let frames = backend.render(&self.scene, &state, &self.rig.at(&state))?;
            let place = CloudPlace {
                handle: self.handle.position(&state),
                world_from_base: state.world_from_base,
            };
            let cloud = fuse(&frames, &place, &self.cloud).points;
            Ok((frames, cloud))
        });
        let (frames, cloud) = seen.map_err(render_error)?;
        let cameras = PyDict::new(py);
        for frame in &frames {
            let (width, height) =
                (frame.intrinsics.width as usize, frame.intrinsics.height as usize);
            let entry = PyDict::new(py);
            let rgb = PyArray::from_slice(py, &frame.rgb).reshape([height, width, 3])?;
            entry.set_item("rgb", rgb)?;
            let depth = PyArray::from_slice(py, &frame.depth_m).reshape([height, width])?;
            entry.set_item("depth_m", depth)?;
            let segments = PyArray::from_slice(py, &frame.segmentation);
            entry.set_item("segmentation", segments.reshape([height, width])?)?;
            entry.set_item("K", frame.intrinsics.matrix())?;
            entry.set_item("world_from_camera", pose::to_matrix(&frame.world_from_camera))?;
            cameras.set_item(&frame.name, entry)?;
        }
        let seen = PyDict::new(py);
        seen.set_item("cameras", cameras)?;
        let points = PyArray::from_slice(py, cloud.as_flattened()).reshape([cloud.len(), 6])?;
        seen.set_item("cloud", points)?;
        Ok(seen)
    }

    /// What there is to draw, for other renderers: a list of `akrobat.sapien_backend.Body`.
    fn bodies<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        sapien::body_list(py, &self.scene)
    }

    /// The light, as an `akrobat.sapien_backend.Lighting`.
    fn lighting<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        sapien::lighting_values(py, &self.scene)
    }

    /// Where everything is with the robot at `robot` and the object's joints at `object`: `world_from_body`
    /// `[bodies, 7]`, and `cameras` by name, each with `width`, `height`, `K`, `near_m`, `far_m` and
    /// `world_from_camera` `[7]` (poses `x y z qw qx qy qz`).
    fn place<'py>(
        &self,
        py: Python<'py>,
        robot: Vec<f64>,
        object: Vec<f64>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let sample = self.sample(robot, object)?;
        let state = Replay::new(&self.task, &self.scene).at_sample(0, 0.0, sample);
        let cameras = PyDict::new(py);
        for camera in &self.rig.at(&state) {
            let entry = PyDict::new(py);
            entry.set_item("width", camera.intrinsics.width)?;
            entry.set_item("height", camera.intrinsics.height)?;
            entry.set_item("K", camera.intrinsics.matrix())?;
            entry.set_item("near_m", camera.near_m)?;
            entry.set_item("far_m", camera.far_m)?;
            entry.set_item("world_from_camera", pose::to_xyz_wxyz(&camera.world_from_camera))?;
            cameras.set_item(&camera.name, entry)?;
        }
        let placed = PyDict::new(py);
        let bodies: Vec<f64> = state.world_from_body.iter().flat_map(pose::to_xyz_wxyz).collect();
        let rows = bodies.len() / 7;
        placed.set_item("world_from_body", PyArray::from_vec(py, bodies).reshape([rows, 7])?)?;
        placed.set_item("cameras", cameras)?;
        Ok(placed)
    }
}

impl PyObserver {
    fn sample(&self, robot: Vec<f64>, object: Vec<f64>) -> PyResult<PathSample> {
        check_row(&self.task, &robot)?;
        if object.len() != self.task.object.tree.dof() {
            let wanted = self.task.object.tree.dof();
            let message = format!("object: expected {wanted} positions, got {}", object.len());
            return Err(InputError::new_err(message));
        }
        Ok(PathSample { robot, object, phase: Phase::Manipulate })
    }
}

fn open_rig(rig: &str) -> PyResult<Rig> {
    if !rig.trim_start().starts_with('{') {
        return pipeline::load_rig(rig).map_err(to_python);
    }
    let rig: Rig =
        serde_json::from_str(rig).map_err(|e| InputError::new_err(format!("rig: {e}")))?;
    rig.validate("rig").map_err(|e| InputError::new_err(e.to_string()))?;
    Ok(rig)
}

fn check_row(task: &Task, robot: &[f64]) -> PyResult<()> {
    let wanted = task.robot.trajectory_joints().len();
    if robot.len() == wanted {
        return Ok(());
    }
    let message = format!("robot: expected {wanted} positions, got {}", robot.len());
    Err(InputError::new_err(message))
}

fn render_error(error: RenderError) -> PyErr {
    to_python(error.into())
}
