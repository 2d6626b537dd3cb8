//! Where everything is at each frame of a trajectory.

use akrobat_model::task::Task;
use akrobat_model::trajectory::PathSample;
use akrobat_model::{Phase, Pose, Trajectory};

use crate::{BodyGroup, RenderError, RenderScene};

/// Frames per second of rendered episodes.
pub const FRAME_RATE_HZ: f64 = 30.0;

/// Where everything is at one instant.
#[derive(Debug, Clone)]
pub struct FrameState {
    /// Frame number within the episode, from 0.
    pub frame: u32,
    /// Time on the dense path, seconds.
    pub time_s: f64,
    /// Phase of the trajectory.
    pub phase: Phase,
    /// Pose of each body, in the order of [`RenderScene::bodies`].
    pub world_from_body: Vec<Pose>,
    /// Pose of each link of the robot's tree.
    pub world_from_robot_link: Vec<Pose>,
    /// Pose of each link of the object's tree.
    pub world_from_object_link: Vec<Pose>,
    /// Robot joint positions in the trajectory's columns (rad, m).
    pub robot: Vec<f64>,
    /// Positions of all object joints (rad, m).
    pub object: Vec<f64>,
    /// Pose of the tool frame.
    pub world_from_tool: Pose,
    /// Pose of the robot's base link: the child of the yaw joint, or the root of a fixed-base robot.
    pub world_from_base: Pose,
    /// Pose of the object's root.
    pub world_from_object: Pose,
}

impl FrameState {
    /// Bodies at rest that belong to no robot and no object: all that a renderer looks at.
    pub fn of_bodies(world_from_body: Vec<Pose>) -> Self {
        Self {
            frame: 0,
            time_s: 0.0,
            phase: Phase::Manipulate,
            world_from_body,
            world_from_robot_link: Vec::new(),
            world_from_object_link: Vec::new(),
            robot: Vec::new(),
            object: Vec::new(),
            world_from_tool: Pose::identity(),
            world_from_base: Pose::identity(),
            world_from_object: Pose::identity(),
        }
    }
}

/// Forward kinematics of a task's robot and object, arranged by body.
#[derive(Debug, Clone, Copy)]
pub struct Replay<'a> {
    task: &'a Task,
    scene: &'a RenderScene,
}

impl<'a> Replay<'a> {
    /// Replays on `task`, for the bodies of `scene`, which was made from it.
    pub fn new(task: &'a Task, scene: &'a RenderScene) -> Self {
        Self { task, scene }
    }

    /// Checks that a trajectory's columns are those of the task and that it has a path.
    ///
    /// # Errors
    /// [`RenderError::Trajectory`].
    pub fn check(&self, trajectory: &Trajectory) -> Result<(), RenderError> {
        let dense = &trajectory.dense;
        let robot_columns = self.task.robot.trajectory_joints().len();
        let object_columns = self.task.object.tree.dof();
        let fail =
            |message: String| Err(RenderError::Trajectory { id: trajectory.id.clone(), message });
        if dense.is_empty() {
            return fail("expected a dense path, found none".into());
        }
        for (what, path, columns) in
            [("robot", &dense.robot, robot_columns), ("object", &dense.object, object_columns)]
        {
            if path.columns() != columns || path.rows() != dense.len() {
                return fail(format!(
                    "expected {} x {columns} {what} joint positions, found {} x {}",
                    dense.len(),
                    path.rows(),
                    path.columns()
                ));
            }
            if let Some(at) = path.values().iter().position(|value| !value.is_finite()) {
                return fail(format!(
                    "{what} joint position {} of sample {} is not a number",
                    at % columns,
                    at / columns
                ));
            }
        }
        if *trajectory.manipulation_samples().end() >= dense.len() {
            return fail(format!(
                "the manipulation ends at sample {}, beyond the dense path's {}",
                trajectory.manipulation_samples().end(),
                dense.len()
            ));
        }
        Ok(())
    }

    /// Where everything is at `time_s` on the trajectory's dense path.
    ///
    /// # Panics
    /// On a trajectory that [`Replay::check`] refuses.
    pub fn at_time(&self, trajectory: &Trajectory, frame: u32, time_s: f64) -> FrameState {
        self.at_sample(frame, time_s, trajectory.dense.sample(time_s))
    }

    /// Where everything is with the robot at rest and the object at its start.
    pub fn at_rest(&self) -> FrameState {
        let robot = &self.task.robot;
        let columns = robot.trajectory_joints().into_iter();
        let row = columns.map(|joint| robot.tree.joint_position(joint, &robot.rest)).collect();
        let object = self.task.object.start.clone();
        self.at_sample(0, 0.0, PathSample { robot: row, object, phase: Phase::Approach })
    }

    /// Where everything is in a given state.
    ///
    /// # Panics
    /// If the state's lengths are not those of the task.
    pub fn at_sample(&self, frame: u32, time_s: f64, sample: PathSample) -> FrameState {
        let Task { robot, object, .. } = self.task;
        let robot_links =
            robot.tree.link_poses(&robot.world_from_root, &robot.configuration(&sample.robot));
        let object_links = object.tree.link_poses(&object.world_from_root, &sample.object);
        let world_from_body = |body: &crate::RenderBody| match body.group {
            BodyGroup::Robot => robot_links[body.index],
            BodyGroup::Object => object_links[body.index],
            BodyGroup::Scene => self.task.scene.bodies[body.index].world_from_body,
            BodyGroup::Clutter => self.scene.world_from_clutter[body.index],
        };
        FrameState {
            frame,
            time_s,
            phase: sample.phase,
            world_from_body: self.scene.bodies.iter().map(world_from_body).collect(),
            world_from_tool: robot_links[robot.tool_link] * robot.link_from_tool,
            world_from_base: robot_links[base_link(self.task)],
            world_from_object: object.world_from_root,
            world_from_robot_link: robot_links,
            world_from_object_link: object_links,
            robot: sample.robot,
            object: sample.object,
        }
    }
}

/// The robot's base link: the child of the yaw joint, or the root of a fixed-base robot.
pub fn base_link(task: &Task) -> usize {
    let tree = &task.robot.tree;
    task.robot.base_joints.last().map_or(tree.root(), |&yaw| tree.joints()[yaw].child)
}
