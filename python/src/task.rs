//! Loaded tasks as plain Python values: what a physics engine needs to build robot, object and scene.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use akrobat::pipeline;
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::{Task, matches_pattern};
use akrobat_model::{JointKind, KinematicTree, Part, Pose, Shape, pose};
use numpy::{PyArray, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::errors::{InputError, to_python};
use crate::trajectories::plain;

/// A task with everything it names loaded, repaired and checked.
#[pyclass(name = "Task", module = "akrobat", frozen)]
pub struct PyTask {
    task: Arc<Task>,
}

impl PyTask {
    /// Wraps a task.
    pub fn new(task: Arc<Task>) -> Self {
        Self { task }
    }

    /// The task.
    pub fn inner(&self) -> &Arc<Task> {
        &self.task
    }
}

#[pymethods]
impl PyTask {
    /// Loads a task file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf, assets: Vec<PathBuf>) -> PyResult<Self> {
        let search = search(&assets)?;
        let task = py.detach(|| load::task(&path, &search));
        Ok(Self::new(Arc::new(task.map_err(|error| to_python(error.into()))?)))
    }

    /// Loads the task that a trajectory file was planned for, from the same inputs.
    #[staticmethod]
    fn of_trajectories(py: Python<'_>, path: PathBuf, assets: Vec<PathBuf>) -> PyResult<Self> {
        let search = search(&assets)?;
        let loaded = py.detach(|| pipeline::planned_task(&path, &search));
        let (_, task) = loaded.map_err(to_python)?;
        Ok(Self::new(Arc::new(task)))
    }

    /// The task's name.
    #[getter]
    fn name(&self) -> &str {
        &self.task.file.name
    }

    /// The task's seed.
    #[getter]
    fn seed(&self) -> u64 {
        self.task.file.seed
    }

    /// Positions of the driven joint to reach, rad or m.
    #[getter]
    fn goals(&self) -> Vec<f64> {
        self.task.file.goal.positions.clone()
    }

    /// The robot: its tree, its planned joints and its gripper.
    fn robot<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let robot = &self.task.robot;
        let entry = tree(py, &robot.tree, &|_, _| false)?;
        let joint_names = |joints: &[usize]| -> Vec<&str> {
            joints.iter().map(|&j| robot.tree.joints()[j].name.as_str()).collect()
        };
        let links = robot.tree.links();
        entry.set_item("name", &robot.name)?;
        entry.set_item("world_from_root", pose::to_xyz_wxyz(&robot.world_from_root))?;
        entry.set_item("base_joints", joint_names(&robot.base_joints))?;
        entry.set_item("arm_joints", joint_names(&robot.arm_joints))?;
        entry.set_item("gripper_joints", joint_names(&robot.gripper_joints))?;
        entry.set_item("gripper_closed", &robot.file.gripper.closed)?;
        entry.set_item("gripper_open", &robot.file.gripper.open)?;
        entry.set_item("open_width_m", robot.file.gripper.open_width_m)?;
        let fingers: Vec<&str> =
            robot.finger_links.iter().map(|&l| links[l].name.as_str()).collect();
        entry.set_item("finger_links", fingers)?;
        entry.set_item("tool_link", &links[robot.tool_link].name)?;
        entry.set_item("link_from_tool", pose::to_xyz_wxyz(&robot.link_from_tool))?;
        entry.set_item("rest", &robot.rest)?;
        entry.set_item("self_collision_ignore", &robot.file.self_collision_ignore)?;
        Ok(entry)
    }

    /// The object: its tree, the driven joint and the handle. Parts of the handle say so.
    fn object<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let object = &self.task.object;
        let in_handle = |link: usize, part: &Part| {
            let listed = || object.handle_parts.iter().any(|p| matches_pattern(p, &part.name));
            link == object.handle_link && (object.handle_parts.is_empty() || listed())
        };
        let entry = tree(py, &object.tree, &in_handle)?;
        entry.set_item("name", &object.name)?;
        entry.set_item("kind", plain(py, &self.task.file.object.kind)?)?;
        entry.set_item("world_from_root", pose::to_xyz_wxyz(&object.world_from_root))?;
        entry.set_item("active_joint", &object.tree.joints()[object.active_joint].name)?;
        entry.set_item("handle_link", &object.tree.links()[object.handle_link].name)?;
        entry.set_item("handle_region", object.handle_region)?;
        entry.set_item("start", &object.start)?;
        Ok(entry)
    }

    /// World poses of all links of the robot and of the object, by name; joints that are not named rest.
    #[pyo3(signature = (robot, object))]
    fn link_poses<'py>(
        &self,
        py: Python<'py>,
        robot: BTreeMap<String, f64>,
        object: BTreeMap<String, f64>,
    ) -> PyResult<(Bound<'py, PyDict>, Bound<'py, PyDict>)> {
        let own = &self.task.robot;
        let robot = link_poses(py, &own.tree, &own.world_from_root, &own.rest, &robot)?;
        let own = &self.task.object;
        let object = link_poses(py, &own.tree, &own.world_from_root, &own.start, &object)?;
        Ok((robot, object))
    }

    /// The static surroundings: a list of bodies with their parts.
    fn scene<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyList>> {
        let bodies = PyList::empty(py);
        for body in &self.task.scene.bodies {
            let entry = PyDict::new(py);
            entry.set_item("name", &body.name)?;
            entry.set_item("world_from_body", pose::to_xyz_wxyz(&body.world_from_body))?;
            entry.set_item("collisions", parts(py, body.collision_parts(), &|_| false)?)?;
            bodies.append(entry)?;
        }
        Ok(bodies)
    }
}

fn link_poses<'py>(
    py: Python<'py>,
    tree: &KinematicTree,
    world_from_root: &Pose,
    rest: &[f64],
    positions: &BTreeMap<String, f64>,
) -> PyResult<Bound<'py, PyDict>> {
    let mut q = rest.to_vec();
    for (name, &position) in positions {
        let joint = tree.joint_index(name).map_err(|error| to_python(error.into()))?;
        let column = tree.column(joint).ok_or_else(|| {
            let valid = tree.dof_joints().iter().map(|&j| tree.joints()[j].name.as_str());
            let valid = valid.collect::<Vec<_>>().join(", ");
            InputError::new_err(format!(
                "{}: joint \"{name}\" does not move of its own; valid joints: {valid}",
                tree.name
            ))
        })?;
        q[column] = position;
    }
    let found = PyDict::new(py);
    for (link, world_from_link) in tree.links().iter().zip(tree.link_poses(world_from_root, &q)) {
        let values = PyArray::from_slice(py, &pose::to_xyz_wxyz(&world_from_link));
        found.set_item(&link.name, values)?;
    }
    Ok(found)
}

fn search(assets: &[PathBuf]) -> PyResult<AssetSearch> {
    pipeline::asset_search(assets, Some(&crate::host::PythonHost)).map_err(to_python)
}

fn tree<'py>(
    py: Python<'py>,
    tree: &KinematicTree,
    in_handle: &dyn Fn(usize, &Part) -> bool,
) -> PyResult<Bound<'py, PyDict>> {
    let links = PyList::empty(py);
    for (index, link) in tree.links().iter().enumerate() {
        let entry = PyDict::new(py);
        let handle = |part: &Part| in_handle(index, part);
        entry.set_item("name", &link.name)?;
        entry.set_item("collisions", parts(py, &link.collisions, &handle)?)?;
        entry.set_item("visuals", parts(py, &link.visuals, &handle)?)?;
        match &link.inertial {
            None => entry.set_item("inertial", py.None())?,
            Some(inertial) => {
                let values = PyDict::new(py);
                values.set_item("mass_kg", inertial.mass)?;
                let frame = pose::to_xyz_wxyz(&inertial.link_from_inertia);
                values.set_item("link_from_inertia", frame)?;
                values.set_item("inertia_kg_m2", inertial.inertia)?;
                entry.set_item("inertial", values)?;
            }
        }
        links.append(entry)?;
    }
    let joints = PyList::empty(py);
    for &index in tree.order() {
        joints.append(joint(py, tree, index)?)?;
    }
    let dof: Vec<&str> =
        tree.dof_joints().iter().map(|&j| tree.joints()[j].name.as_str()).collect();
    let entry = PyDict::new(py);
    entry.set_item("root", &tree.links()[tree.root()].name)?;
    entry.set_item("links", links)?;
    entry.set_item("joints", joints)?;
    entry.set_item("dof_joints", dof)?;
    Ok(entry)
}

fn joint<'py>(py: Python<'py>, tree: &KinematicTree, index: usize) -> PyResult<Bound<'py, PyDict>> {
    let joint = &tree.joints()[index];
    let kind = match joint.kind {
        JointKind::Fixed => "fixed",
        JointKind::Revolute => "revolute",
        JointKind::Continuous => "continuous",
        JointKind::Prismatic => "prismatic",
    };
    let entry = PyDict::new(py);
    entry.set_item("name", &joint.name)?;
    entry.set_item("kind", kind)?;
    entry.set_item("parent", &tree.links()[joint.parent].name)?;
    entry.set_item("child", &tree.links()[joint.child].name)?;
    entry.set_item("parent_from_joint", pose::to_xyz_wxyz(&joint.parent_from_joint))?;
    entry.set_item("axis", <[f64; 3]>::from(joint.axis.into_inner()))?;
    entry.set_item("limits", joint.limits)?;
    entry.set_item("velocity_limit", joint.velocity_limit)?;
    entry.set_item("effort_limit", joint.effort_limit)?;
    entry.set_item("damping", joint.damping)?;
    entry.set_item("friction", joint.friction)?;
    let mimic = joint.mimic.as_ref().map(|mimic| {
        let followed = tree.joints()[mimic.joint].name.as_str();
        (followed, mimic.multiplier, mimic.offset)
    });
    entry.set_item("mimic", mimic)?;
    Ok(entry)
}

fn parts<'py>(
    py: Python<'py>,
    parts: &[Part],
    in_handle: &dyn Fn(&Part) -> bool,
) -> PyResult<Bound<'py, PyList>> {
    let list = PyList::empty(py);
    for part in parts {
        let entry = PyDict::new(py);
        entry.set_item("name", &part.name)?;
        entry.set_item("handle", in_handle(part))?;
        entry.set_item("link_from_part", pose::to_xyz_wxyz(&part.link_from_part))?;
        match &part.shape {
            Shape::Box { size } => {
                entry.set_item("kind", "box")?;
                entry.set_item("size", size)?;
            }
            Shape::Cylinder { radius, length } => {
                entry.set_item("kind", "cylinder")?;
                entry.set_item("size", [*radius, *length])?;
            }
            Shape::Sphere { radius } => {
                entry.set_item("kind", "sphere")?;
                entry.set_item("size", [*radius])?;
            }
            Shape::Mesh { .. } => {
                entry.set_item("kind", "mesh")?;
                entry.set_item("size", Vec::<f64>::new())?;
            }
        }
        let (positions, triangles) = soup(py, part)?;
        entry.set_item("positions", positions)?;
        entry.set_item("triangles", triangles)?;
        list.append(entry)?;
    }
    Ok(list)
}

/// The surface of a part in its own frame, all materials together.
#[expect(clippy::type_complexity, reason = "two NumPy arrays")]
fn soup<'py>(
    py: Python<'py>,
    part: &Part,
) -> PyResult<(Bound<'py, PyArray2<f32>>, Bound<'py, PyArray2<u32>>)> {
    let part = Part { link_from_part: Pose::identity(), ..part.clone() };
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for mesh in part.triangulate() {
        let first = positions.len() as u32;
        positions.extend(mesh.positions);
        triangles.extend(mesh.triangles.iter().map(|t| t.map(|vertex| vertex + first)));
    }
    Ok((
        PyArray::from_slice(py, positions.as_flattened()).reshape([positions.len(), 3])?,
        PyArray::from_slice(py, triangles.as_flattened()).reshape([triangles.len(), 3])?,
    ))
}
