//! Trajectories as streams of observations.

use akrobat_cameras::{CameraFrame, Observation, Rig};
use akrobat_model::Trajectory;
use akrobat_model::task::Task;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::handle::Handle;
use crate::placement::PlacedRig;
use crate::pointcloud::{CloudConfig, fuse};
use crate::replay::{FRAME_RATE_HZ, Replay};
use crate::{Backend, FrameState, RenderError, RenderScene};

/// How episodes are rendered.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EpisodeConfig {
    /// Render only the manipulation, not the approach and the grasp.
    pub manipulation_only: bool,
    /// Frames per second.
    pub rate_hz: f64,
    /// Fused clouds.
    pub cloud: CloudConfig,
}

impl Default for EpisodeConfig {
    fn default() -> Self {
        Self { manipulation_only: false, rate_hz: FRAME_RATE_HZ, cloud: CloudConfig::default() }
    }
}

/// Number of frames that decide where a camera which looks at the handle is placed.
const KEYFRAMES: usize = 9;

/// Renders trajectories of one task with one rig.
#[derive(Debug, Clone)]
pub struct EpisodeRenderer<'a> {
    task: &'a Task,
    scene: &'a RenderScene,
    rig: &'a Rig,
    config: EpisodeConfig,
}

impl<'a> EpisodeRenderer<'a> {
    /// Renders `scene`, which was made from `task`.
    pub fn new(
        task: &'a Task,
        scene: &'a RenderScene,
        rig: &'a Rig,
        config: EpisodeConfig,
    ) -> Self {
        Self { task, scene, rig, config }
    }

    /// Prepares one trajectory: checks it and places the cameras.
    ///
    /// # Errors
    /// [`RenderError::Trajectory`] where the trajectory does not fit the task, [`RenderError::Rig`] where
    /// the rig does not fit the robot.
    pub fn episode(&self, trajectory: &'a Trajectory) -> Result<Episode<'a>, RenderError> {
        let replay = Replay::new(self.task, self.scene);
        replay.check(trajectory)?;
        let times_s = trajectory.frame_times(self.config.rate_hz, self.config.manipulation_only);
        let handle = Handle::new(self.task, &trajectory.grasp)?;
        let keyframes: Vec<FrameState> = (0..KEYFRAMES)
            .map(|key| {
                let frame = key * (times_s.len() - 1) / (KEYFRAMES - 1);
                replay.at_time(trajectory, frame as u32, times_s[frame])
            })
            .collect();
        let rig = PlacedRig::new(self.rig, self.task, self.scene, &handle, &keyframes)?;
        let (scene, cloud) = (self.scene, self.config.cloud.clone());
        Ok(Episode { replay, scene, trajectory, rig, handle, times_s, cloud })
    }
}

/// One trajectory, ready to be rendered frame by frame.
#[derive(Debug, Clone)]
pub struct Episode<'a> {
    replay: Replay<'a>,
    scene: &'a RenderScene,
    trajectory: &'a Trajectory,
    rig: PlacedRig,
    handle: Handle,
    times_s: Vec<f64>,
    cloud: CloudConfig,
}

impl Episode<'_> {
    /// Number of frames.
    pub fn frame_count(&self) -> usize {
        self.times_s.len()
    }

    /// The handle that the trajectory's grasp holds.
    pub fn handle(&self) -> &Handle {
        &self.handle
    }

    /// The cameras.
    pub fn rig(&self) -> &PlacedRig {
        &self.rig
    }

    /// Where everything is at a frame.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn state(&self, frame: usize) -> FrameState {
        self.replay.at_time(self.trajectory, frame as u32, self.times_s[frame])
    }

    /// Renders one frame.
    ///
    /// # Errors
    /// Those of the backend.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn observe(
        &self,
        frame: usize,
        backend: &mut dyn Backend,
    ) -> Result<Observation, RenderError> {
        let state = self.state(frame);
        let cameras = backend.render(self.scene, &state, &self.rig.at(&state))?;
        Ok(self.observation(state, cameras))
    }

    /// Renders consecutive frames in one call of the backend.
    ///
    /// # Errors
    /// Those of the backend.
    ///
    /// # Panics
    /// If there are no such frames.
    pub fn observe_batch(
        &self,
        frames: std::ops::Range<usize>,
        backend: &mut dyn Backend,
    ) -> Result<Vec<Observation>, RenderError> {
        let placed = |state: FrameState| {
            let cameras = self.rig.at(&state);
            (state, cameras)
        };
        let states: Vec<_> = frames.map(|frame| placed(self.state(frame))).collect();
        let images = backend.render_batch(self.scene, &states)?;
        let pairs = states.into_iter().zip(images);
        Ok(pairs.map(|((state, _), cameras)| self.observation(state, cameras)).collect())
    }

    fn observation(&self, state: FrameState, cameras: Vec<CameraFrame>) -> Observation {
        let cloud = fuse(&cameras, &self.handle.position(&state), &self.cloud);
        Observation {
            frame: state.frame,
            time_s: state.time_s,
            phase: state.phase,
            cameras,
            cloud,
            cloud_normals: Vec::new(),
            robot: state.robot,
            object: state.object,
            world_from_tool: state.world_from_tool,
            world_from_base: state.world_from_base,
            world_from_object: state.world_from_object,
        }
    }

    /// Renders all frames in order, one at a time.
    pub fn observations<'b>(
        &'b self,
        backend: &'b mut dyn Backend,
    ) -> impl Iterator<Item = Result<Observation, RenderError>> + 'b {
        (0..self.frame_count()).map(move |frame| self.observe(frame, backend))
    }
}
