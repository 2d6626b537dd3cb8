//! Trajectories as streams of observations.

use std::collections::{BTreeMap, BTreeSet};

use akrobat_cameras::sensor::DepthSensor;
use akrobat_cameras::{
    CameraFrame, CameraModel, CameraSpec, Modality, Observation, Rig, SegmentTable, Sensor,
};
use akrobat_model::task::Task;
use akrobat_model::{Pose, Trajectory};
use nalgebra::Vector3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::backend::PlacedCamera;
use crate::enclosure::Enclosures;
use crate::gates::{self, Refusal};
use crate::handle::Handle;
use crate::layers::{self, Motion};
use crate::lens::LensMap;
use crate::placement::PlacedRig;
use crate::pointcloud::{CloudConfig, CloudPlace, fuse};
use crate::replay::{FRAME_RATE_HZ, Replay};
use crate::seed::Seed;
use crate::sensor::kinect::IdealDepth;
use crate::sensor::redwood::DistortionField;
use crate::sensor::{StereoPair, color, kinect, redwood, stereo};
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
    /// Images that are recorded.
    pub modalities: Vec<Modality>,
    /// What becomes of the ideal images.
    pub sensor: Sensor,
    /// Seed of sensors and mounting errors.
    pub seed: u64,
    /// Whether frames are refused that are unfit for a dataset (see [`crate::gates`]).
    pub check_frames: bool,
}

impl Default for EpisodeConfig {
    fn default() -> Self {
        Self {
            manipulation_only: false,
            rate_hz: FRAME_RATE_HZ,
            cloud: CloudConfig::default(),
            modalities: Modality::DEFAULT.to_vec(),
            sensor: Sensor::default(),
            seed: 0,
            check_frames: false,
        }
    }
}

impl EpisodeConfig {
    fn records(&self, modality: Modality) -> bool {
        self.modalities.contains(&modality)
    }

    fn needs_normals(&self) -> bool {
        let grazing = matches!(self.sensor.depth, DepthSensor::Kinect(_));
        self.records(Modality::Normals) || self.cloud.normals || grazing
    }
}

/// An instant, and what is rendered of it.
type Shot = (FrameState, Vec<PlacedCamera>);

/// Number of frames that decide where a camera which looks at the handle is placed.
const KEYFRAMES: usize = 9;

/// Renders trajectories of one task with one rig.
#[derive(Debug, Clone)]
pub struct EpisodeRenderer<'a> {
    task: &'a Task,
    scene: &'a RenderScene,
    rig: &'a Rig,
    config: EpisodeConfig,
    optics: Vec<Optics>,
    enclosures: Enclosures<'a>,
    segments: SegmentTable,
}

/// What follows from a camera's specification alone.
#[derive(Debug, Clone)]
struct Optics {
    spec: CameraSpec,
    model: CameraModel,
    lens: Option<LensMap>,
    /// Rays of all pixels, for the images that need them.
    rays: Vec<[f32; 2]>,
}

impl<'a> EpisodeRenderer<'a> {
    /// Renders `scene`, which was made from `task`.
    pub fn new(
        task: &'a Task,
        scene: &'a RenderScene,
        rig: &'a Rig,
        config: EpisodeConfig,
    ) -> Self {
        let optics = rig.cameras.iter().map(|spec| {
            let model = spec.model();
            let lens = LensMap::new(model);
            let needs_rays = lens.is_some()
                || config.needs_normals()
                || [Modality::Xyz, Modality::Flow, Modality::SceneFlow]
                    .iter()
                    .any(|&modality| config.records(modality));
            let rays = if needs_rays { layers::rays(&model) } else { Vec::new() };
            Optics { spec: spec.clone(), model, lens, rays }
        });
        let optics = optics.collect();
        let enclosures = Enclosures::new(scene);
        let segments = SegmentTable::new(&scene.segment_labels());
        Self { task, scene, rig, config, optics, enclosures, segments }
    }

    /// Prepares one trajectory: checks it and places the cameras.
    ///
    /// # Errors
    /// [`RenderError::Trajectory`] where the trajectory does not fit the task, [`RenderError::Rig`] where
    /// the rig does not fit the robot.
    pub fn episode<'b>(&'b self, trajectory: &'b Trajectory) -> Result<Episode<'b>, RenderError> {
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
        let seed = Seed::new(self.config.seed).name(&trajectory.id);
        let rig = PlacedRig::new(self.rig, self.task, self.scene, &handle, &keyframes)?;
        let rig = rig.jittered(seed);
        let fields = match self.config.sensor.depth {
            DepthSensor::Redwood(_) => {
                self.optics.iter().map(|o| distortion_field(o, seed)).collect()
            }
            _ => Vec::new(),
        };
        let gain = color::exposure_gain(&self.config.sensor.color, seed.name("exposure"));
        Ok(Episode { renderer: self, replay, trajectory, rig, handle, times_s, seed, fields, gain })
    }
}

fn distortion_field(optics: &Optics, episode: Seed) -> DistortionField {
    let i = optics.model.intrinsics;
    let seed = episode.name(&optics.spec.name).name("distortion");
    DistortionField::new(i.width as usize, i.height as usize, seed)
}

/// One trajectory, ready to be rendered frame by frame.
#[derive(Debug, Clone)]
pub struct Episode<'a> {
    renderer: &'a EpisodeRenderer<'a>,
    replay: Replay<'a>,
    trajectory: &'a Trajectory,
    rig: PlacedRig,
    handle: Handle,
    times_s: Vec<f64>,
    seed: Seed,
    /// Depth distortion of each camera, where the sensor has one.
    fields: Vec<DistortionField>,
    /// Exposure of the episode.
    gain: f64,
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

    /// Factor of the light by which this episode is exposed.
    pub fn exposure_gain(&self) -> f64 {
        self.gain
    }

    /// Where everything is at a frame.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn state(&self, frame: usize) -> FrameState {
        self.replay.at_time(self.trajectory, frame as u32, self.times_s[frame])
    }

    /// The first camera that is inside a body at a frame.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn camera_inside(&self, frame: usize) -> Option<Refusal> {
        let state = self.state(frame);
        gates::camera_inside(&self.renderer.enclosures, &state, &self.rig.at(&state))
    }

    /// Renders one frame.
    ///
    /// # Errors
    /// Those of the backend; [`RenderError::Refused`] where frames are checked.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn observe(
        &self,
        frame: usize,
        backend: &mut dyn Backend,
    ) -> Result<Observation, RenderError> {
        let mut batch = self.observe_batch(frame..frame + 1, backend)?;
        Ok(batch.remove(0))
    }

    /// Renders consecutive frames in one call of the backend.
    ///
    /// # Errors
    /// As [`Episode::observe`].
    ///
    /// # Panics
    /// If there are no such frames.
    pub fn observe_batch(
        &self,
        frames: std::ops::Range<usize>,
        backend: &mut dyn Backend,
    ) -> Result<Vec<Observation>, RenderError> {
        let cameras = self.renderer.optics.len();
        let captured = |frame: usize| (0..cameras).map(move |camera| self.captured(camera, frame));
        let needed: BTreeSet<usize> =
            frames.clone().chain(frames.clone().flat_map(captured)).collect();
        let mut taken = self.take(&needed, backend)?;
        let observe = |frame: usize| {
            let images = captured(frame).zip(0..).map(|(at, camera): (usize, usize)| {
                let is_shown_again =
                    frames.end > frame + 1 && self.captured(camera, frame + 1) == at;
                let image = taken.get_mut(&at).map(|images| &mut images[camera]);
                let image = image.expect("all frames needed were taken");
                if is_shown_again {
                    image.clone()
                } else {
                    std::mem::replace(
                        image,
                        CameraFrame::new("", image.intrinsics, Pose::identity()),
                    )
                }
            });
            (frame, images.collect::<Vec<_>>())
        };
        let images: Vec<_> = frames.clone().map(observe).collect();
        let observations =
            images.into_par_iter().map(|(frame, images)| self.observation(frame, images));
        observations.collect()
    }

    /// Renders all frames in order, one at a time.
    pub fn observations<'b>(
        &'b self,
        backend: &'b mut dyn Backend,
    ) -> impl Iterator<Item = Result<Observation, RenderError>> + 'b {
        (0..self.frame_count()).map(move |frame| self.observe(frame, backend))
    }

    /// The frame whose image a camera shows at `frame`: an earlier one, where it is slower than the episode.
    fn captured(&self, camera: usize, frame: usize) -> usize {
        const ROUNDING: f64 = 1e-9;
        let rate_hz = self.renderer.config.rate_hz;
        match self.renderer.optics[camera].spec.rate_hz {
            Some(camera_hz) if camera_hz < rate_hz => {
                let tick = (frame as f64 * camera_hz / rate_hz + ROUNDING).floor();
                (tick * rate_hz / camera_hz - ROUNDING).ceil() as usize
            }
            _ => frame,
        }
    }

    /// The next frame at which a camera takes an image; the last frame where there is none.
    fn next_captured(&self, camera: usize, frame: usize) -> usize {
        let last = self.frame_count() - 1;
        (frame + 1..=last).find(|&next| self.captured(camera, next) == next).unwrap_or(last)
    }

    /// What is rendered of one instant: a pinhole for each camera, and the second eyes of stereo cameras.
    fn views(&self, state: &FrameState) -> Vec<PlacedCamera> {
        let renderer = self.renderer;
        let mut views = self.rig.at(state);
        for (view, optics) in views.iter_mut().zip(&renderer.optics) {
            view.normals = renderer.config.needs_normals();
            if let Some(lens) = &optics.lens {
                view.intrinsics = lens.pinhole();
            }
        }
        if let DepthSensor::Stereo(sensor) = &renderer.config.sensor.depth {
            let right = |view: &PlacedCamera| PlacedCamera {
                name: format!("{} right", view.name),
                world_from_camera: view.world_from_camera
                    * Pose::translation(sensor.baseline_m, 0.0, 0.0),
                normals: false,
                ..view.clone()
            };
            let rights: Vec<_> = views.iter().map(right).collect();
            views.extend(rights);
        }
        views
    }

    /// Takes all cameras' images at some frames.
    fn take(
        &self,
        frames: &BTreeSet<usize>,
        backend: &mut dyn Backend,
    ) -> Result<BTreeMap<usize, Vec<CameraFrame>>, RenderError> {
        let offsets_s = match &self.renderer.config.sensor.color.motion_blur {
            Some(blur) => color::blur_offsets_s(blur),
            None => Vec::new(),
        };
        let mut shots = Vec::new();
        for &frame in frames {
            let state = self.state(frame);
            for offset_s in &offsets_s {
                let time_s = self.times_s[frame] + offset_s;
                let state = self.replay.at_time(self.trajectory, frame as u32, time_s);
                let views = self.views(&state);
                shots.push((state, views));
            }
            let views = self.views(&state);
            shots.push((state, views));
        }
        let mut rendered = backend.render_batch(self.renderer.scene, &shots)?;
        let per_frame = offsets_s.len() + 1;
        let work: Vec<_> = frames
            .iter()
            .zip(shots.chunks_exact(per_frame))
            .zip(rendered.chunks_exact_mut(per_frame))
            .collect();
        let develop = |((&frame, shots), images): ((&usize, &[Shot]), &mut [Vec<CameraFrame>])| {
            let (state, views) = &shots[per_frame - 1];
            if self.renderer.config.check_frames {
                self.check(frame, state, views, &images[per_frame - 1])?;
            }
            let developed = (0..self.renderer.optics.len())
                .map(|camera| self.develop(frame, state, camera, images));
            Ok((frame, developed.collect()))
        };
        work.into_par_iter().map(develop).collect()
    }

    fn check(
        &self,
        frame: usize,
        state: &FrameState,
        views: &[PlacedCamera],
        images: &[CameraFrame],
    ) -> Result<(), RenderError> {
        let cameras = self.renderer.optics.len();
        let views = &views[..cameras];
        let refusal = gates::camera_inside(&self.renderer.enclosures, state, views)
            .or_else(|| gates::pose_differs(self.renderer.scene, state, &images[..cameras], views));
        refusal.map_or(Ok(()), |refusal| Err(self.refused(frame, refusal)))
    }

    fn refused(&self, frame: usize, refusal: Refusal) -> RenderError {
        RenderError::Refused { id: self.trajectory.id.clone(), frame: frame as u32, refusal }
    }

    /// A camera's image as its lens and sensor give it, from the ideal views of one frame: those during the exposure,
    /// then that of the frame's time.
    fn develop(
        &self,
        frame: usize,
        state: &FrameState,
        camera: usize,
        views: &[Vec<CameraFrame>],
    ) -> CameraFrame {
        let EpisodeRenderer { config, optics, .. } = self.renderer;
        let optics = &optics[camera];
        let (ideal, blurred) = views.split_last().expect("one view is that of the frame's time");
        let seed = self.seed.name(&optics.spec.name).number(frame as u64);
        let stereo_depth_m = match &config.sensor.depth {
            DepthSensor::Stereo(sensor) => {
                let right = &ideal[self.renderer.optics.len() + camera];
                let pair = StereoPair { left: &ideal[camera], right };
                Some(stereo::measure(&pair, sensor, seed.name("depth")))
            }
            _ => None,
        };
        let through_lens = |view: &CameraFrame| match &optics.lens {
            Some(lens) => lens.resample(view),
            None => view.clone(),
        };
        let mut image = through_lens(&ideal[camera]);
        image.captured_frame = frame as u32;
        if !blurred.is_empty() {
            let during: Vec<CameraFrame> =
                blurred.iter().map(|views| through_lens(&views[camera])).collect();
            let colors: Vec<&[u8]> = during.iter().map(|image| image.rgb.as_slice()).collect();
            image.rgb = color::average(&colors);
        }
        self.add_layers(&mut image, frame, state, camera);
        image.depth_m = match (&config.sensor.depth, stereo_depth_m) {
            (_, Some(depth_m)) => match &optics.lens {
                Some(lens) => lens.resample_depth(&depth_m, &ideal[camera].segmentation),
                None => depth_m,
            },
            (DepthSensor::Kinect(sensor), None) => {
                let facing = facing(&image, &optics.rays);
                let ideal = IdealDepth {
                    width: image.intrinsics.width as usize,
                    focal_px: image.intrinsics.fx,
                    depth_m: &image.depth_m,
                    facing: &facing,
                };
                kinect::measure(&ideal, sensor, seed.name("depth"))
            }
            (DepthSensor::Redwood(sensor), None) => {
                let width = image.intrinsics.width as usize;
                let field = &self.fields[camera];
                redwood::measure(&image.depth_m, width, sensor, field, seed.name("depth"))
            }
            (DepthSensor::Ideal | DepthSensor::Stereo(_), None) => image.depth_m,
        };
        if config.records(Modality::Xyz) || (optics.lens.is_some() && config.cloud.points > 0) {
            image.xyz = layers::positions(&image.depth_m, &optics.rays, &image.world_from_camera);
        }
        let size = [image.intrinsics.width, image.intrinsics.height];
        image.rgb =
            color::take(&image.rgb, size, &config.sensor.color, self.gain, seed.name("color"));
        image
    }

    /// Adds what follows from the ideal depth.
    fn add_layers(&self, image: &mut CameraFrame, frame: usize, state: &FrameState, camera: usize) {
        let EpisodeRenderer { config, optics, segments, scene, .. } = self.renderer;
        let rays = &optics[camera].rays;
        if config.needs_normals() && image.normals.is_empty() {
            image.normals = layers::normals_from_depth(image, rays);
        }
        if config.records(Modality::Instance) {
            image.instance = layers::instances(&image.segmentation, segments);
        }
        if config.records(Modality::Semantic) {
            image.semantic = layers::classes(&image.segmentation, segments);
        }
        let (flow, scene_flow) =
            (config.records(Modality::Flow), config.records(Modality::SceneFlow));
        if flow || scene_flow {
            let next = self.state(self.next_captured(camera, frame));
            let world_from_next_camera = self.rig.at(&next)[camera].world_from_camera;
            let motion = Motion { now: state, next: &next, world_from_next_camera };
            let body = |segment: u16| {
                usize::from(segment).checked_sub(1).filter(|&body| body < scene.bodies.len())
            };
            let (in_world, in_image) = motion.flows(image, rays, body);
            image.scene_flow = if scene_flow { in_world } else { Vec::new() };
            image.flow = if flow { in_image } else { Vec::new() };
        }
    }

    fn observation(
        &self,
        frame: usize,
        mut cameras: Vec<CameraFrame>,
    ) -> Result<Observation, RenderError> {
        let config = &self.renderer.config;
        let state = self.state(frame);
        let place = CloudPlace {
            handle: self.handle.position(&state),
            world_from_base: state.world_from_base,
        };
        let cloud = fuse(&cameras, &place, &config.cloud);
        for camera in &mut cameras {
            // What only the cloud or the sensor needed.
            if !config.records(Modality::Normals) {
                camera.normals = Vec::new();
            }
            if !config.records(Modality::Xyz) {
                camera.xyz = Vec::new();
            }
        }
        let observation = Observation {
            frame: state.frame,
            time_s: state.time_s,
            phase: state.phase,
            cameras,
            cloud: cloud.points,
            cloud_normals: cloud.normals,
            robot: state.robot,
            object: state.object,
            world_from_tool: state.world_from_tool,
            world_from_base: state.world_from_base,
            world_from_object: state.world_from_object,
        };
        match gates::unusable(&observation).filter(|_| config.check_frames) {
            Some(refusal) => Err(self.refused(frame, refusal)),
            None => Ok(observation),
        }
    }
}

/// Cosine of the angle between each pixel's surface normal and its line of sight.
fn facing(image: &CameraFrame, rays: &[[f32; 2]]) -> Vec<f32> {
    let camera_from_world = image.world_from_camera.rotation.inverse().cast::<f32>();
    let cosine = |(&normal, &[x, y]): (&[f32; 3], &[f32; 2])| {
        let ray = Vector3::new(x, y, 1.0);
        (camera_from_world * Vector3::from(normal)).dot(&ray).abs() / ray.norm()
    };
    image.normals.iter().zip(rays).map(cosine).collect()
}
