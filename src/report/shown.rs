//! One trajectory rendered for the page.

use akrobat_cameras::{Observation, SegmentLabel};
use akrobat_model::events::Observer;
use akrobat_model::task::Task;
use akrobat_model::{Phase, Trajectory};
use akrobat_renderer::pointcloud::{CloudConfig, CloudPlace, fuse};
use akrobat_renderer::replay::{FRAME_RATE_HZ, Replay};
use akrobat_renderer::{
    Backend, BodyGroup, Episode, EpisodeConfig, EpisodeRenderer, FrameState, RenderScene,
};
use image::RgbImage;
use nalgebra::Vector3;

use super::{ReportInput, ReportOptions, animation, cloud, glb, near, picture};
use crate::Error;

/// Frames per second of the animated picture.
const GIF_RATE_HZ: f64 = 10.0;
/// Pixels between the cameras' pictures.
const GUTTER: u32 = 4;
/// Share of the depths of a camera that are nearer than the dark end of its colours.
const DEPTH_SHARE: f64 = 0.97;

/// What the page shows of one trajectory.
pub struct Shown {
    /// Place in the set.
    pub index: usize,
    /// File name and content of the animated picture.
    pub gif_name: String,
    /// Content.
    pub gif: Vec<u8>,
    /// File name and content of the animated model.
    pub glb_name: String,
    /// Content.
    pub glb: Vec<u8>,
    /// Instants of the contact sheet.
    pub instants: Vec<Instant>,
    /// The contact sheet by camera.
    pub cameras: Vec<CameraSheet>,
    /// Clouds at the start and at the end of the manipulation.
    pub clouds: Vec<CloudSheet>,
}

/// A column of the contact sheet.
pub struct Instant {
    /// Time on the path, seconds.
    pub time_s: f64,
    /// Phase.
    pub phase: Phase,
}

/// Pictures of one camera, by instant.
pub struct CameraSheet {
    /// Camera name.
    pub name: String,
    /// Colour images, as addresses.
    pub color: Vec<String>,
    /// Depth maps.
    pub depth: Vec<String>,
    /// Segmentations.
    pub segmentation: Vec<String>,
    /// Depths at the ends of the colour map, metres.
    pub depth_range_m: [f32; 2],
    /// Width over height.
    pub aspect: f64,
}

/// Pictures of one cloud.
pub struct CloudSheet {
    /// Time on the path, seconds.
    pub time_s: f64,
    /// Number of points.
    pub points: usize,
    /// Name of the view, and picture as an address.
    pub views: Vec<(&'static str, String)>,
}

/// Renders trajectory `index` of the set.
///
/// # Errors
/// Those of the backend; [`Error::Interrupted`].
pub fn render(
    input: &ReportInput<'_>,
    scene: &RenderScene,
    index: usize,
    options: &ReportOptions,
    backend: &mut dyn Backend,
    observer: &dyn Observer,
) -> Result<Shown, Error> {
    let trajectory = &input.set.trajectories[index];
    // Clouds cost more than images, and are shown twice only.
    let cloud = CloudConfig { points: 0, ..CloudConfig::default() };
    let config = EpisodeConfig { rate_hz: GIF_RATE_HZ, cloud, ..EpisodeConfig::default() };
    let renderer = EpisodeRenderer::new(input.task, scene, input.rig, config);
    let episode = renderer.episode(trajectory)?;
    let keyframes = keyframes(trajectory, episode.frame_count());
    let mut strips = Vec::with_capacity(episode.frame_count());
    let mut kept = Vec::new();
    for frame in 0..episode.frame_count() {
        if observer.cancelled() {
            return Err(Error::Interrupted("no report was written".into()));
        }
        let observation = episode.observe(frame, backend)?;
        strips.push(strip(&observation));
        if keyframes.contains(&frame) {
            kept.push(observation);
        }
    }
    Ok(Shown {
        index,
        gif_name: format!("trajectory_{index}.gif"),
        gif: animation::encode(&strips, 1.0 / GIF_RATE_HZ, options.gif_bytes)?,
        glb_name: format!("trajectory_{index}.glb"),
        glb: model(input.task, scene, trajectory, options.glb_mesh_bytes),
        instants: kept.iter().map(|o| Instant { time_s: o.time_s, phase: o.phase }).collect(),
        cameras: camera_sheets(&kept, &scene.segment_labels())?,
        clouds: cloud_sheets(&kept, &episode)?,
    })
}

/// Frames of the contact sheet: the beginning, and four from closed to open.
fn keyframes(trajectory: &Trajectory, frames: usize) -> Vec<usize> {
    let (first, last) = trajectory.manipulation_samples().into_inner();
    let times = &trajectory.dense.times_s;
    let (from, to) = (times[first], times[last]);
    let held = (0..4).map(|k| from + (to - from) * f64::from(k) / 3.0);
    let nearest = |time_s: f64| ((time_s * GIF_RATE_HZ).round() as usize).min(frames - 1);
    let mut frames: Vec<usize> = std::iter::once(0.0).chain(held).map(nearest).collect();
    frames.dedup();
    frames
}

/// The cameras' colour images side by side.
fn strip(observation: &Observation) -> RgbImage {
    let sizes = observation.cameras.iter().map(|camera| camera.intrinsics);
    let width: u32 = sizes.clone().map(|i| i.width + GUTTER).sum::<u32>().saturating_sub(GUTTER);
    let height = sizes.map(|i| i.height).max().unwrap_or(1);
    let mut strip = RgbImage::from_pixel(width.max(1), height, image::Rgb([24, 26, 30]));
    let mut left = 0;
    for camera in &observation.cameras {
        image::imageops::replace(&mut strip, &picture::color(camera), left, 0);
        left += i64::from(camera.intrinsics.width + GUTTER);
    }
    strip
}

fn camera_sheets(kept: &[Observation], labels: &[SegmentLabel]) -> Result<Vec<CameraSheet>, Error> {
    let Some(first) = kept.first() else { return Ok(Vec::new()) };
    let sheet = |camera: usize| -> Result<CameraSheet, Error> {
        let frames = || kept.iter().map(move |observation| &observation.cameras[camera]);
        let depth_range_m = depth_range(frames().flat_map(|frame| &frame.depth_m));
        let encoded = |pictures: &mut dyn Iterator<Item = RgbImage>| {
            pictures.map(|picture| picture::jpeg_uri(&picture)).collect::<Result<Vec<_>, _>>()
        };
        let i = &first.cameras[camera].intrinsics;
        Ok(CameraSheet {
            name: first.cameras[camera].name.clone(),
            color: encoded(&mut frames().map(picture::color))?,
            depth: encoded(&mut frames().map(|frame| picture::depth(frame, depth_range_m)))?,
            segmentation: encoded(&mut frames().map(|f| picture::segmentation(f, labels)))?,
            depth_range_m,
            aspect: f64::from(i.width) / f64::from(i.height),
        })
    };
    (0..first.cameras.len()).map(sheet).collect()
}

fn depth_range<'a>(depths: impl Iterator<Item = &'a f32>) -> [f32; 2] {
    let mut seen: Vec<f32> = depths.copied().filter(|&depth| depth > 0.0).collect();
    seen.sort_by(f32::total_cmp);
    let Some(&nearest) = seen.first() else { return [0.1, 1.0] };
    [nearest, seen[(DEPTH_SHARE * (seen.len() - 1) as f64) as usize]]
}

fn cloud_sheets(kept: &[Observation], episode: &Episode<'_>) -> Result<Vec<CloudSheet>, Error> {
    // The first frame shows the approach; the second is where the manipulation starts.
    let (Some(start), Some(end)) = (kept.get(1).or(kept.first()), kept.last()) else {
        return Ok(Vec::new());
    };
    let sheet = |observation: &Observation| -> Result<CloudSheet, Error> {
        let state = episode.state(observation.frame as usize);
        let handle = episode.handle();
        let center = handle.position(&state);
        let place = CloudPlace { handle: center, world_from_base: state.world_from_base };
        let points = fuse(&observation.cameras, &place, &CloudConfig::default()).points;
        // The tool's z axis points into the object.
        let inward = handle.world_from_grasp(&state) * Vector3::z();
        let outward_rad = (-inward.y).atan2(-inward.x);
        let view = |view: &cloud::View| -> Result<(&'static str, String), Error> {
            Ok((view.name, picture::png_uri(&cloud::draw(&points, view, outward_rad, &center))?))
        };
        Ok(CloudSheet {
            time_s: observation.time_s,
            points: points.len(),
            views: cloud::VIEWS.iter().map(view).collect::<Result<_, _>>()?,
        })
    };
    [start, end].into_iter().map(sheet).collect()
}

/// Robot, object and what of the scene is near, as an animated GLB.
pub(super) fn model(
    task: &Task,
    scene: &RenderScene,
    trajectory: &Trajectory,
    mesh_bytes: usize,
) -> Vec<u8> {
    let replay = Replay::new(task, scene);
    let times_s = trajectory.frame_times(FRAME_RATE_HZ, false);
    let states: Vec<FrameState> =
        times_s.iter().map(|&time_s| replay.at_time(trajectory, 0, time_s)).collect();
    let near = near::bodies(scene, &states, near::GLB_TRIANGLES);
    let bodies: Vec<glb::Body> = scene
        .bodies
        .iter()
        .enumerate()
        .filter(|(place, body)| body.group != BodyGroup::Scene || near.contains(place))
        .map(|(place, body)| glb::Body {
            name: format!("{}/{}", body.group.name(), body.name),
            meshes: body.meshes.clone(),
            world_from_body: match body.group {
                BodyGroup::Scene => vec![states[0].world_from_body[place]],
                _ => states.iter().map(|state| state.world_from_body[place]).collect(),
            },
        })
        .collect();
    glb::encode(&bodies, &times_s, mesh_bytes)
}
