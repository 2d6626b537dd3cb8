//! Where a rig's cameras are, and what each of them sees of a trajectory.

use std::collections::BTreeMap;
use std::path::PathBuf;

use akrobat_cameras::{CameraFrame, CameraSpec, Rig, SegmentLabel};
use akrobat_model::pose;
use akrobat_packager::trajectory_file;
use akrobat_renderer::handle::{HandleVisibility, handle_visibility};
use akrobat_renderer::pointcloud::CloudConfig;
use akrobat_renderer::{Episode, EpisodeConfig, EpisodeRenderer};
use serde::Serialize;

use super::Context;
use super::render::{BackendChoice, Source, load_rig, open_backend};
use crate::Error;

/// Which rig is looked at.
#[derive(Debug, Clone, Default)]
pub struct SurveyRequest {
    /// A rig preset's name or a rig file.
    pub rig: String,
    /// Trajectory file that the rig is put into; only the rig itself is told of where absent.
    pub trajectories: Option<PathBuf>,
    /// Position in the trajectory file.
    pub episode: usize,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// Which renderer draws.
    pub backend: BackendChoice,
}

/// What is known of a rig.
#[derive(Debug, Clone, Serialize)]
pub struct Survey {
    /// The rig's name.
    pub rig: String,
    /// Identity of the trajectory, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<String>,
    /// Its cameras.
    pub cameras: Vec<CameraSurvey>,
}

/// What is known of a camera.
#[derive(Debug, Clone, Serialize)]
pub struct CameraSurvey {
    /// Name.
    pub name: String,
    /// Image width and height, pixels.
    pub size: [u32; 2],
    /// The matrix K, pixels.
    pub k: [[f64; 3]; 3],
    /// Horizontal and vertical field of view without distortion, radians.
    pub field_of_view_rad: [f64; 2],
    /// Model of the lens, and its coefficients in OpenCV's order.
    pub distortion_model: String,
    /// Coefficients of the lens in OpenCV's order.
    pub distortion: Vec<f64>,
    /// Where it is mounted.
    pub mount: String,
    /// What it sees of a trajectory.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view: Option<ViewSurvey>,
}

/// What a camera sees of a trajectory.
#[derive(Debug, Clone, Serialize)]
pub struct ViewSurvey {
    /// Pose at the first frame, `[x y z qw qx qy qz]`.
    pub world_from_camera_first: [f64; 7],
    /// Pose at the last frame.
    pub world_from_camera_last: [f64; 7],
    /// Distance to the handle at the first and the last frame, metres.
    pub handle_distance_m: [f64; 2],
    /// Share of the frames looked at in which the handle is visible, occluded and out of view.
    pub handle_visible: f64,
    /// Share in which something covers it.
    pub handle_occluded: f64,
    /// Share in which it is out of view.
    pub handle_out_of_view: f64,
    /// Share of the pixels with valid depth.
    pub valid_depth: f64,
    /// Nearest, median and farthest depth, metres; zeros where nothing is seen.
    pub depth_m: [f32; 3],
    /// Share of the pixels by what they show, largest first.
    pub sees: Vec<(String, f64)>,
    /// What is wrong with its place, if anything.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

/// Frames that are looked at.
const FRAMES: usize = 9;

/// What a camera sees is told down to this share of the pixels.
const LEAST_SHARE: f64 = 0.005;

/// Looks at a rig.
///
/// # Errors
/// Where the rig, the trajectories or the assets are wrong or do not fit each other, or a device fails.
pub fn survey(request: &SurveyRequest, context: &Context<'_>) -> Result<Survey, Error> {
    let rig = load_rig(&request.rig)?;
    let Some(file) = &request.trajectories else {
        let cameras = rig.cameras.iter().map(|camera| about(camera, None)).collect();
        return Ok(Survey { rig: rig.name, trajectory: None, cameras });
    };
    let set = trajectory_file::read(file)?;
    let count = set.trajectories.len();
    if request.episode >= count {
        let (file, wanted, last) = (file.display(), request.episode, count.saturating_sub(1));
        let message = format!("{file}: no episode {wanted}; valid choices: 0 to {last}");
        return Err(Error::Usage(message));
    }
    let source = Source::load(file, set, &request.assets, context)?;
    let mut backend = open_backend(request.backend, context)?;
    let trajectory = &source.set.trajectories[request.episode];
    let cloud = CloudConfig { points: 0, ..CloudConfig::default() };
    let config = EpisodeConfig { cloud, ..EpisodeConfig::default() };
    let renderer = EpisodeRenderer::new(&source.task, &source.scene, &rig, config);
    let episode = renderer.episode(trajectory)?;
    let last = episode.frame_count() - 1;
    let mut views = Views::new(&rig);
    for key in 0..FRAMES.min(last + 1) {
        let frame = key * last / (FRAMES - 1).max(1);
        let observation = episode.observe(frame, backend.as_mut())?;
        let handle = episode.handle().position(&episode.state(frame));
        views.add(&observation.cameras, handle_visibility(&observation.cameras, &handle));
    }
    let labels = source.scene.segment_labels();
    let cameras = rig
        .cameras
        .iter()
        .enumerate()
        .map(|(index, camera)| about(camera, Some(views.finish(index, &episode, &labels))));
    let cameras = cameras.collect();
    Ok(Survey { trajectory: Some(trajectory.id.clone()), cameras, rig: rig.name.clone() })
}

fn about(camera: &CameraSpec, view: Option<ViewSurvey>) -> CameraSurvey {
    let intrinsics = camera.intrinsics();
    CameraSurvey {
        name: camera.name.clone(),
        size: [camera.width, camera.height],
        k: intrinsics.matrix(),
        field_of_view_rad: intrinsics.field_of_view_rad(),
        distortion_model: camera.distortion.name().into(),
        distortion: camera.distortion.coefficients(),
        mount: camera.mount.describe(),
        view,
    }
}

/// What is collected while frames are looked at, by camera.
struct Views {
    seen: Vec<Seen>,
}

#[derive(Default)]
struct Seen {
    handle: Vec<HandleVisibility>,
    pixels: usize,
    depths_m: Vec<f32>,
    by_segment: BTreeMap<u16, usize>,
}

impl Views {
    fn new(rig: &Rig) -> Self {
        Self { seen: rig.cameras.iter().map(|_| Seen::default()).collect() }
    }

    fn add(&mut self, images: &[CameraFrame], handle: Vec<HandleVisibility>) {
        for ((seen, image), visibility) in self.seen.iter_mut().zip(images).zip(handle) {
            seen.handle.push(visibility);
            seen.pixels += image.depth_m.len();
            seen.depths_m.extend(image.depth_m.iter().filter(|&&depth| depth > 0.0));
            for &segment in &image.segmentation {
                *seen.by_segment.entry(segment).or_default() += 1;
            }
        }
    }

    fn finish(
        &mut self,
        camera: usize,
        episode: &Episode<'_>,
        labels: &[SegmentLabel],
    ) -> ViewSurvey {
        let seen = &mut self.seen[camera];
        seen.depths_m.sort_by(f32::total_cmp);
        let depth_m = match seen.depths_m.as_slice() {
            [] => [0.0; 3],
            depths => [depths[0], depths[depths.len() / 2], depths[depths.len() - 1]],
        };
        let ends = [0, episode.frame_count() - 1].map(|frame| {
            let state = episode.state(frame);
            let world_from_camera = episode.rig().at(&state)[camera].world_from_camera;
            let way =
                episode.handle().position(&state).coords - world_from_camera.translation.vector;
            (pose::to_xyz_wxyz(&world_from_camera), way.norm())
        });
        let share = |of: HandleVisibility| {
            let count = seen.handle.iter().filter(|&&visibility| visibility == of).count();
            count as f64 / seen.handle.len().max(1) as f64
        };
        let problem = episode.camera_inside(0).map(|refusal| refusal.to_string());
        let name = episode.rig().at(&episode.state(0))[camera].name.clone();
        ViewSurvey {
            world_from_camera_first: ends[0].0,
            world_from_camera_last: ends[1].0,
            handle_distance_m: ends.map(|end| end.1),
            handle_visible: share(HandleVisibility::Visible),
            handle_occluded: share(HandleVisibility::Occluded),
            handle_out_of_view: share(HandleVisibility::OutOfView),
            valid_depth: seen.depths_m.len() as f64 / seen.pixels.max(1) as f64,
            depth_m,
            sees: shares(&seen.by_segment, seen.pixels, labels),
            problem: problem.filter(|problem| problem.contains(&format!("camera {name} "))),
        }
    }
}

/// Shares of the pixels by robot, object link or class of scene body, largest first.
fn shares(
    by_segment: &BTreeMap<u16, usize>,
    pixels: usize,
    labels: &[SegmentLabel],
) -> Vec<(String, f64)> {
    let mut by_name: BTreeMap<String, usize> = BTreeMap::new();
    for (segment, count) in by_segment {
        let label = labels.iter().find(|label| label.id == *segment);
        let name = match label.map(|label| (label.group.as_str(), label)) {
            None => "background".to_owned(),
            Some(("robot", _)) => "robot".to_owned(),
            Some(("object", label)) => format!("object {}", label.name),
            Some((_, label)) => label.class.clone(),
        };
        *by_name.entry(name).or_default() += count;
    }
    let share = |count: usize| count as f64 / pixels.max(1) as f64;
    let mut shares: Vec<(String, f64)> =
        by_name.into_iter().map(|(name, count)| (name, share(count))).collect();
    shares.retain(|(_, share)| *share >= LEAST_SHARE);
    shares.sort_by(|a, b| b.1.total_cmp(&a.1));
    shares
}
