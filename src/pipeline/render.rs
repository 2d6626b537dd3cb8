//! Trajectory file -> replay -> images -> dataset.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use akrobat_cameras::{Modality, Rig, Sensor};
use akrobat_model::events::{Event, Observer};
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::Task;
use akrobat_model::{ModelError, Rejection, Trajectory, TrajectorySet, pose};
use akrobat_packager::dataset::{Container, DatasetConfig, DatasetWriter, Licence, Status};
use akrobat_packager::{Attachment, CloudLayout, EpisodeInfo, StorageConfig, trajectory_file};
use akrobat_renderer::pointcloud::CloudConfig;
use akrobat_renderer::raster::WgpuBackend;
use akrobat_renderer::replay::Replay;
use akrobat_renderer::{
    Appearance, Backend, Detail, Episode, EpisodeConfig, EpisodeRenderer, Lighting, RenderError,
    RenderScene, SoftBackend, Supersampling, Variation,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::episodes::EpisodeFilter;
use super::{Context, folder_of, on_threads, share, simulated};
use crate::Error;
use crate::host::SapienShaders;

/// The light of scenes for which nothing is said.
pub(super) const DEFAULT_LIGHTING: &str = "even";

/// Name of the progress stage.
const STAGE: &str = "rendering";

/// Which renderer draws.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum BackendChoice {
    /// `wgpu` where there is a graphics processor, else `soft`.
    #[default]
    Auto,
    /// The rasteriser on the CPU.
    Soft,
    /// The graphics processor, or a software Vulkan driver.
    Wgpu,
    /// SAPIEN's fastest shaders (needs the Python package).
    Sapien,
    /// SAPIEN's deferred shaders, those of ManiSkill's pictures.
    SapienDefault,
    /// SAPIEN's path tracer, 32 samples a pixel: light from surface to surface; minutes an image without a
    /// graphics card that traces rays.
    SapienRt,
}

/// Which files hold the episodes.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// HDF5 shards.
    #[default]
    Hdf5,
    /// One MCAP log per episode.
    Mcap,
    /// Both, in the folders `hdf5` and `mcap` of the output.
    Both,
}

/// Which states of robot and object are rendered.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, clap::ValueEnum,
)]
#[serde(rename_all = "snake_case")]
pub enum States {
    /// Those of the plan.
    #[default]
    Planned,
    /// What they did in physics, from the audit that `akrobat replay` wrote beside the trajectories.
    Simulated,
}

/// What is to be rendered.
#[derive(Debug, Clone, Default)]
pub struct RenderRequest {
    /// Trajectory file.
    pub trajectories: PathBuf,
    /// Dataset folder to write.
    pub output: PathBuf,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// Which renderer draws.
    pub backend: BackendChoice,
    /// A rig preset's name or a rig file; `paper` where absent.
    pub rig: Option<String>,
    /// A lighting preset's name or a lighting file; `even` where absent.
    pub lighting: Option<String>,
    /// What is drawn at random for each episode: a variation preset's name or a file; nothing where absent.
    pub variation: Option<String>,
    /// Seed of what is drawn.
    pub variation_seed: u64,
    /// The recorded appearance (JSON) that all episodes get.
    pub appearance: Option<PathBuf>,
    /// Colour is the mean of this many samples along either edge of a pixel: 1, 3 or 5.
    pub supersampling: Supersampling,
    /// How many triangles are drawn.
    pub detail: Detail,
    /// A sensor preset's name or a sensor file; `ideal` where absent.
    pub sensor: Option<String>,
    /// Images that are stored in HDF5 shards; colour, depth and segmentation where empty.
    pub modalities: Vec<Modality>,
    /// Fused clouds.
    pub cloud: CloudConfig,
    /// Seed of sensors and mounting errors.
    pub seed: u64,
    /// Which files hold the episodes.
    pub format: Format,
    /// Which trajectories are rendered.
    pub filter: EpisodeFilter,
    /// Render only the manipulation, without approach and grasp.
    pub manipulation_only: bool,
    /// Whether what was planned is shown, or what the robot did in physics.
    pub states: States,
    /// How the dataset is stored.
    pub storage: StorageConfig,
    /// Continue what an interrupted run left in the output.
    pub resume: bool,
    /// Number of threads; one for each core where absent. The result does not depend on it.
    pub threads: Option<usize>,
    /// Whether other processes work on the same dataset.
    pub sharing: Sharing,
}

/// How a dataset's episodes are shared between processes. The result does not depend on it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub enum Sharing {
    /// This process renders them all.
    #[default]
    Alone,
    /// This process takes shards as long as there are any, beside others of the same command.
    Join,
    /// This process makes these shards; which are made where, another program decides.
    Only(Vec<usize>),
}

/// What rendering gave.
#[derive(Debug, Clone, Default, Serialize)]
pub struct RenderReport {
    /// Dataset folders, one for each container.
    pub datasets: Vec<PathBuf>,
    /// Name of the renderer that drew.
    pub backend: String,
    /// Episodes written by this run.
    pub episodes: u64,
    /// Episodes that an earlier run had written.
    pub resumed: u64,
    /// Episodes left out because the judge had refused them, or physics failed.
    pub filtered: u64,
    /// Episodes left out because a frame was unfit, and why.
    pub quarantined: Vec<String>,
    /// Frames written by this run.
    pub frames: u64,
    /// Images drawn by this run.
    pub images: u64,
    /// Wall time, seconds.
    pub seconds: f64,
}

impl RenderReport {
    /// True where nothing that was asked for is missing.
    pub fn is_complete(&self) -> bool {
        self.filtered == 0 && self.quarantined.is_empty()
    }
}

/// Replays a trajectory file, renders it and writes a dataset.
///
/// # Errors
/// Where the trajectories, the rig or the assets are wrong, a device or the disk fails, or the user
/// asked to stop; whole shards are kept then.
pub fn render(request: &RenderRequest, context: &Context<'_>) -> Result<RenderReport, Error> {
    with_job(request, context, |job, selected, mut backend| match &request.sharing {
        Sharing::Alone => job.run(selected, backend.as_mut()),
        Sharing::Join => share::join(job, selected, backend.as_mut()),
        Sharing::Only(parts) => share::make(job, selected, parts, backend.as_mut()),
    })
}

/// Counts what a request would render, without rendering it.
///
/// # Errors
/// As [`render`].
pub fn dry_run(request: &RenderRequest, context: &Context<'_>) -> Result<DryRun, Error> {
    with_job(request, context, |job, selected, _| {
        let parts = share::parts(job, selected);
        let episodes = selected.iter().filter(|&&index| job.refusal(index).is_none()).count();
        Ok(DryRun {
            episodes,
            filtered: selected.len() - episodes,
            frames: job.frames(selected),
            shards: parts.len(),
        })
    })
}

/// What a request would render.
#[derive(Debug, Clone, Serialize)]
pub struct DryRun {
    /// Episodes.
    pub episodes: usize,
    /// Episodes that the judge has refused.
    pub filtered: usize,
    /// Frames of all episodes.
    pub frames: u64,
    /// Shards, which may be made by different processes.
    pub shards: usize,
}

fn with_job<T: Send>(
    request: &RenderRequest,
    context: &Context<'_>,
    work: impl FnOnce(&Job<'_>, &[usize], Box<dyn Backend>) -> Result<T, Error> + Send,
) -> Result<T, Error> {
    let mut set = trajectory_file::read(&request.trajectories)?;
    let selected = request.filter.select(&request.trajectories, &set)?;
    let unfit = match request.states {
        States::Planned => BTreeMap::new(),
        States::Simulated => simulated::replace_paths(&request.trajectories, &mut set)?,
    };
    let variant = Variant::load(request)?;
    let mut source = Source::load(&request.trajectories, set, &request.assets, context)?;
    source.scene = request.detail.of(source.scene);
    variant.check_fits(&source)?;
    let backend = open_backend(request.backend, context)?;
    let backend = request.supersampling.over(backend);
    let scene = variant.lit(&source.scene);
    let job = Job {
        request,
        source: &source,
        scene: &scene,
        variant: &variant,
        unfit: &unfit,
        look: Look::new(request)?,
        rig_has_fitted: false,
        backend: backend.name().to_owned(),
        observer: context.observer,
    };
    on_threads(request.threads, || work(&job, &selected, backend))
}

/// A trajectory file and what it was planned with.
pub(super) struct Source {
    pub set: TrajectorySet,
    pub task: Task,
    pub scene: RenderScene,
    attachments: Vec<Attachment>,
}

impl Source {
    /// Loads what a trajectory file was planned with.
    pub fn load(
        path: &Path,
        set: TrajectorySet,
        assets: &[PathBuf],
        context: &Context<'_>,
    ) -> Result<Self, Error> {
        let search = context.asset_search(assets)?;
        let task_path = task_path(path, &set);
        let task = load::task_from_text(set.header.task_toml.clone(), &task_path, &search)?;
        check_unchanged(path, &set, &task)?;
        let scene = RenderScene::from_task(&task)?;
        let attachments = attachments(&task, &task_path, &search)?;
        Ok(Self { set, task, scene, attachments })
    }
}

/// How a trajectory file is rendered, apart from the file.
#[derive(Debug, Clone)]
pub(super) struct Variant {
    pub rig: Rig,
    pub lighting: Lighting,
    pub config: EpisodeConfig,
}

impl Variant {
    /// Reads and checks the files that a request names.
    pub fn load(request: &RenderRequest) -> Result<Self, Error> {
        request.cloud.check().map_err(|message| Error::Usage(format!("cloud: {message}")))?;
        let modalities = match request.modalities.as_slice() {
            [] => Modality::DEFAULT.to_vec(),
            given => given.to_vec(),
        };
        let config = EpisodeConfig {
            manipulation_only: request.manipulation_only,
            cloud: request.cloud.clone(),
            modalities,
            sensor: load_sensor(request.sensor.as_deref().unwrap_or("ideal"))?,
            seed: request.seed,
            check_frames: true,
            ..EpisodeConfig::default()
        };
        let lighting = Lighting::named(request.lighting.as_deref().unwrap_or(DEFAULT_LIGHTING))?;
        let rig = load_rig(request.rig.as_deref().unwrap_or("paper"))?;
        Ok(Self { rig, lighting, config })
    }

    /// A scene in the variant's light.
    pub fn lit(&self, scene: &RenderScene) -> RenderScene {
        scene.lit_by(&self.lighting)
    }

    /// Whether the rig fits the robot.
    pub fn check_fits(&self, source: &Source) -> Result<(), Error> {
        let links = source.task.robot.tree.links().iter().map(|link| link.name.as_str());
        self.rig.validate_links(links).map_err(|error| Error::Render(error.into()))
    }

    /// Frames that are handed to a backend at once: as many as take some 64 MB of images.
    fn batch_frames(&self) -> usize {
        const BATCH_BYTES: usize = 64 << 20;
        // Colour, depth and segment, and twice that while lenses and sensors work on them.
        const BASE_BYTES: usize = 3 * (3 + 4 + 2);
        let layers: usize = self.config.modalities.iter().map(|m| 4 * m.channels()).sum();
        let exposures = match &self.config.sensor.color.motion_blur {
            Some(blur) => blur.samples as usize,
            None => 1,
        };
        let pixels: usize = self.rig.cameras.iter().map(|c| c.intrinsics().pixels()).sum();
        let frame_bytes = pixels * (BASE_BYTES * exposures + layers);
        (BATCH_BYTES / frame_bytes.max(1)).clamp(1, 32)
    }

    /// Refuses rigs that no trajectory could be rendered with: a camera that is inside a body from the
    /// first frame on.
    pub fn check_placement(&self, source: &Source, index: usize) -> Result<(), Error> {
        let renderer =
            EpisodeRenderer::new(&source.task, &source.scene, &self.rig, self.config.clone());
        let episode = renderer.episode(&source.set.trajectories[index])?;
        match episode.camera_inside(0) {
            None => Ok(()),
            Some(refusal) => Err(Error::Usage(format!(
                "rig \"{}\": {refusal} at frame 0 of episode {index}; move it, or see where it is with \
                 `akrobat inspect --rig`",
                self.rig.name
            ))),
        }
    }
}

pub(super) struct Job<'a> {
    pub request: &'a RenderRequest,
    pub source: &'a Source,
    /// The source's scene, in the variant's light.
    pub scene: &'a RenderScene,
    pub variant: &'a Variant,
    /// Why episodes are left out, by position.
    pub unfit: &'a BTreeMap<usize, String>,
    pub look: Look,
    /// Whether the rig has fitted other trajectories: where it does not fit, episodes are left out and the rig is not
    /// refused.
    pub rig_has_fitted: bool,
    /// Name of the renderer that draws.
    pub backend: String,
    pub observer: &'a dyn Observer,
}

impl Job<'_> {
    /// Renders the trajectories at these positions in this process alone.
    pub fn run(
        &self,
        selected: &[usize],
        backend: &mut dyn Backend,
    ) -> Result<RenderReport, Error> {
        self.check_placement(selected)?;
        let mut tally = Tally::new(self, self.frames(selected));
        let mut writers = self.open_writers()?;
        self.render_episodes(selected, &mut writers, backend, &mut tally, &mut || Ok(()))?;
        for writer in writers {
            writer.close()?;
        }
        Ok(tally.finish())
    }

    /// Refuses rigs that do not even fit the first of the trajectories at these positions.
    pub fn check_placement(&self, selected: &[usize]) -> Result<(), Error> {
        match selected.first() {
            Some(&first) if !self.rig_has_fitted => {
                self.variant.check_placement(self.source, first)
            }
            _ => Ok(()),
        }
    }

    /// Renders the trajectories at these positions into writers that stay open. `on_batch` is called after
    /// every few frames.
    pub fn render_episodes(
        &self,
        positions: &[usize],
        writers: &mut [DatasetWriter],
        backend: &mut dyn Backend,
        tally: &mut Tally<'_>,
        on_batch: &mut dyn FnMut() -> Result<(), Error>,
    ) -> Result<(), Error> {
        for &index in positions {
            let trajectory = &self.source.set.trajectories[index];
            let mut open: Vec<&mut DatasetWriter> =
                writers.iter_mut().filter(|w| !w.contains(&trajectory.id)).collect();
            if open.is_empty() {
                tally.report.resumed += 1;
                continue;
            }
            if let Some(reason) = self.refusal(index) {
                for writer in open {
                    writer.skip_episode(&trajectory.id, Status::Filtered, reason)?;
                }
                tally.report.filtered += 1;
                continue;
            }
            let (scene, appearance) = self.look.of(self, trajectory)?;
            let renderer = self.renderer(&scene);
            let episode = renderer.episode(trajectory)?;
            let mut info = self.info(index, &episode);
            info.labels = scene.segment_labels();
            if let Some(appearance) = appearance {
                info.provenance["renderer"]["lighting"] = json!(appearance.lighting);
                info.provenance["renderer"]["appearance"] = json!(appearance);
            }
            for writer in &mut open {
                writer.begin_episode(info.clone())?;
            }
            match self.render_frames(&episode, &mut open, backend, tally, on_batch)? {
                None => {
                    open.iter_mut().try_for_each(|writer| writer.finish_episode())?;
                    tally.report.episodes += 1;
                }
                Some(reason) => {
                    open.iter_mut().try_for_each(|writer| writer.quarantine_episode(&reason))?;
                    tally.leave_out(&trajectory.id, &reason);
                }
            }
        }
        Ok(())
    }

    /// Frames of the trajectories at these positions.
    pub fn frames(&self, positions: &[usize]) -> u64 {
        let EpisodeConfig { rate_hz, manipulation_only, .. } = self.variant.config;
        let trajectories = positions.iter().map(|&index| &self.source.set.trajectories[index]);
        trajectories.map(|t| t.frame_times(rate_hz, manipulation_only).len() as u64).sum()
    }

    /// Why the trajectory at a position is left out, if it is: the judge refused it, or it failed in physics.
    pub fn refusal(&self, index: usize) -> Option<&str> {
        let verdict = self.source.set.trajectories[index].verdict.as_ref();
        let rejection = verdict.and_then(|verdict| verdict.rejection).map(Rejection::name);
        rejection.or(self.unfit.get(&index).map(String::as_str))
    }

    /// Identities of the trajectories at these positions.
    pub fn ids<'s>(&'s self, positions: &'s [usize]) -> impl Iterator<Item = &'s str> {
        positions.iter().map(|&index| self.source.set.trajectories[index].id.as_str())
    }

    fn renderer<'b>(&'b self, scene: &'b RenderScene) -> EpisodeRenderer<'b> {
        let config = self.variant.config.clone();
        EpisodeRenderer::new(&self.source.task, scene, &self.variant.rig, config)
    }

    /// Renders an episode. Returns why it cannot be used, if so.
    fn render_frames(
        &self,
        episode: &Episode<'_>,
        open: &mut [&mut DatasetWriter],
        backend: &mut dyn Backend,
        tally: &mut Tally<'_>,
        on_batch: &mut dyn FnMut() -> Result<(), Error>,
    ) -> Result<Option<String>, Error> {
        let batch_frames = self.variant.batch_frames();
        for first in (0..episode.frame_count()).step_by(batch_frames) {
            if self.observer.cancelled() {
                return Err(interrupted(&self.request.output));
            }
            let batch = first..(first + batch_frames).min(episode.frame_count());
            let observations = match episode.observe_batch(batch, backend) {
                Ok(observations) => observations,
                Err(RenderError::Refused { frame, refusal, .. }) => {
                    return Ok(Some(format!("frame {frame}: {refusal}")));
                }
                Err(error) => return Err(error.into()),
            };
            for observation in observations {
                tally.report.images += observation.cameras.len() as u64;
                if let Some(defect) = akrobat_packager::defect(&observation) {
                    return Ok(Some(defect));
                }
                let (last, others) = open.split_last_mut().expect("there is a writer");
                for writer in others {
                    writer.push(observation.clone())?;
                }
                last.push(observation)?;
                tally.report.frames += 1;
            }
            tally.show();
            on_batch()?;
        }
        Ok(None)
    }

    /// Renders some frames, spread over a trajectory, and stores them as a small dataset: what a frame costs.
    pub fn sample(
        &self,
        index: usize,
        frames: u32,
        folder: &Path,
        backend: &mut dyn Backend,
    ) -> Result<u32, Error> {
        let renderer = self.renderer(self.scene);
        let episode = renderer.episode(&self.source.set.trajectories[index])?;
        let count = frames.min(episode.frame_count() as u32);
        let mut info = self.info(index, &episode);
        info.frames = count;
        let mut writer = DatasetWriter::create(folder, self.dataset_config(Container::Hdf5))?;
        writer.begin_episode(info)?;
        for frame in 0..count {
            let place = frame as usize * episode.frame_count() / count as usize;
            let mut observation = episode.observe(place, backend)?;
            observation.frame = frame;
            writer.push(observation)?;
        }
        writer.finish_episode()?;
        writer.close()?;
        Ok(count)
    }

    /// The dataset folders below `output`, and what each of them is.
    pub fn datasets(&self, output: &Path) -> Vec<(PathBuf, DatasetConfig)> {
        let places = match self.request.format {
            Format::Hdf5 => vec![(output.to_path_buf(), Container::Hdf5)],
            Format::Mcap => vec![(output.to_path_buf(), Container::Mcap)],
            Format::Both => {
                vec![(output.join("hdf5"), Container::Hdf5), (output.join("mcap"), Container::Mcap)]
            }
        };
        let config = |container| self.dataset_config(container);
        places.into_iter().map(|(folder, container)| (folder, config(container))).collect()
    }

    fn open_writers(&self) -> Result<Vec<DatasetWriter>, Error> {
        let open = if self.request.resume { DatasetWriter::resume } else { DatasetWriter::create };
        let datasets = self.datasets(&self.request.output);
        datasets.into_iter().map(|(folder, config)| Ok(open(&folder, config)?)).collect()
    }

    fn dataset_config(&self, container: Container) -> DatasetConfig {
        let task = &self.source.task;
        let (file, robot) = (&task.file, &task.robot);
        let licences = vec![
            Licence {
                asset: robot.name.clone(),
                license: robot.file.license.clone(),
                source: robot.file.source.clone(),
            },
            Licence {
                asset: task.object.name.clone(),
                license: file.object.license.clone(),
                source: String::new(),
            },
        ];
        let name = &self.source.set.header.task_name;
        let defaults = DatasetConfig::new(name, self.variant.rig.clone());
        DatasetConfig {
            container,
            licences,
            provenance: self.provenance(),
            storage: self.request.storage.clone(),
            ..defaults
        }
    }

    fn provenance(&self) -> serde_json::Value {
        let header = &self.source.set.header;
        let config = &self.variant.config;
        json!({
            "akrobat": env!("CARGO_PKG_VERSION"),
            "content_hashes": header.content_hashes,
            "planner": { "backend": header.backend, "config": header.planner_config, "seed": header.seed },
            "renderer": {
                "backend": self.backend,
                "lighting": self.scene.lighting,
                "supersampling": self.request.supersampling,
                "detail": self.request.detail,
            },
            "states": self.request.states,
            "modalities": config.modalities,
            "sensor": config.sensor,
            "cloud": config.cloud,
            "render_seed": config.seed,
            "phases": if config.manipulation_only { "manipulate" } else { "all" },
        })
    }

    fn info(&self, index: usize, episode: &Episode<'_>) -> EpisodeInfo {
        let Source { set, task, attachments, .. } = self.source;
        let (header, trajectory) = (&set.header, &set.trajectories[index]);
        let Variant { rig, config, .. } = self.variant;
        let mut provenance = self.provenance();
        provenance["drawn"] = drawn(episode);
        EpisodeInfo {
            id: trajectory.id.clone(),
            success: trajectory.verdict.as_ref().is_some_and(|verdict| verdict.accepted()),
            seed: trajectory.seed,
            traj_index: index as u32,
            frames: episode.frame_count() as u32,
            frame_rate_hz: config.rate_hz,
            grasp_id: trajectory.grasp.id,
            grasp_link: trajectory.grasp.link.clone(),
            link_from_tool: trajectory.grasp.link_from_tool,
            start: trajectory.start,
            goal: trajectory.goal,
            scene_id: header.scene_id.clone(),
            object_id: header.object_id.clone(),
            robot_id: header.robot_id.clone(),
            base_kind: header.base_kind,
            robot_joints: header.robot_joints.clone(),
            finger_joints: task.robot.gripper_joints.len(),
            object_joints: header.object_joints.clone(),
            active_joint: header.active_joint.clone(),
            world_from_robot_root: task.robot.world_from_root,
            rig: rig.clone(),
            modalities: config.modalities.clone(),
            cloud_points: config.cloud.points,
            cloud: CloudLayout {
                frame: config.cloud.frame.name().into(),
                sampling: config.cloud.sampling.name().into(),
                color: config.cloud.color,
                normals: config.cloud.normals,
            },
            labels: self.scene.segment_labels(),
            task_toml: header.task_toml.clone(),
            provenance,
            attachments: attachments.clone(),
        }
    }
}

/// What was drawn at random for an episode: exposure and errors of the mountings.
fn drawn(episode: &Episode<'_>) -> serde_json::Value {
    let mountings: serde_json::Map<String, serde_json::Value> = episode
        .rig()
        .jitter()
        .filter(|(spec, _)| spec.jitter.is_some())
        .map(|(spec, jitter)| (spec.name.clone(), json!(pose::to_xyz_wxyz(jitter))))
        .collect();
    json!({ "exposure_gain": episode.exposure_gain(), "mount_from_camera": mountings })
}

/// What episodes look like.
pub(super) enum Look {
    /// As the scene says.
    Plain,
    /// As drawn for each.
    Varied(Variation, u64),
    /// As recorded.
    Recorded(Box<Appearance>),
}

/// Frames of an episode that clutter keeps clear of.
const KEYFRAMES: usize = 9;

impl Look {
    pub fn new(request: &RenderRequest) -> Result<Self, Error> {
        match (&request.variation, &request.appearance) {
            (Some(_), Some(_)) => {
                Err(Error::Usage("a variation and a recorded appearance exclude each other".into()))
            }
            (Some(name), None) => Ok(Self::Varied(Variation::named(name)?, request.variation_seed)),
            (None, Some(path)) => Ok(Self::Recorded(Box::new(Appearance::load(path)?))),
            (None, None) => Ok(Self::Plain),
        }
    }

    /// The scene of an episode, and what was drawn for it.
    fn of(
        &self,
        job: &Job<'_>,
        trajectory: &Trajectory,
    ) -> Result<(RenderScene, Option<Appearance>), Error> {
        let appearance = match self {
            Self::Plain => return Ok((job.scene.clone(), None)),
            Self::Recorded(appearance) => appearance.as_ref().clone(),
            Self::Varied(variation, seed) => {
                let replay = Replay::new(&job.source.task, job.scene);
                replay.check(trajectory)?;
                let duration_s = trajectory.dense.duration_s();
                let times = (0..KEYFRAMES).map(|k| k as f64 / (KEYFRAMES - 1) as f64 * duration_s);
                let frames: Vec<_> = times.map(|t| replay.at_time(trajectory, 0, t)).collect();
                variation.draw(job.scene, &frames, *seed, &trajectory.id)
            }
        };
        Ok((appearance.apply(job.scene)?, Some(appearance)))
    }
}

/// What was done so far, and who is told.
pub(super) struct Tally<'a> {
    pub report: RenderReport,
    observer: &'a dyn Observer,
    started: std::time::Instant,
}

impl<'a> Tally<'a> {
    /// Nothing yet, of `frames` frames.
    pub fn new(job: &Job<'a>, frames: u64) -> Self {
        job.observer.event(&Event::StageStarted { stage: STAGE, total: Some(frames) });
        let datasets = job.datasets(&job.request.output);
        let report = RenderReport {
            datasets: datasets.into_iter().map(|(folder, _)| folder).collect(),
            backend: job.backend.clone(),
            ..RenderReport::default()
        };
        Self { report, observer: job.observer, started: std::time::Instant::now() }
    }

    fn leave_out(&mut self, id: &str, reason: &str) {
        let message = format!("episode {id} is left out: {reason}");
        self.observer.event(&Event::Warning { message: &message });
        self.report.quarantined.push(format!("{id}: {reason}"));
    }

    fn show(&self) {
        self.observer.event(&Event::Progress { stage: STAGE, done: self.report.frames });
    }

    /// The report, once all is done.
    pub fn finish(mut self) -> RenderReport {
        self.report.seconds = self.started.elapsed().as_secs_f64();
        let seconds = self.report.seconds;
        self.observer.event(&Event::StageFinished { stage: STAGE, seconds });
        self.report
    }
}

pub(super) fn interrupted(output: &Path) -> Error {
    let output = output.display();
    Error::Interrupted(format!("{output} holds only whole shards; --resume continues"))
}

/// Where the task file stood: the trajectory file carries its text, and its folder relative to itself.
pub(super) fn task_path(trajectories: &Path, set: &TrajectorySet) -> PathBuf {
    let file = format!("{}.toml", set.header.task_name);
    folder_of(trajectories).join(&set.header.task_dir).join(file)
}

/// Replaying on other files than were planned with would show what was never judged.
pub(super) fn check_unchanged(
    trajectories: &Path,
    set: &TrajectorySet,
    task: &Task,
) -> Result<(), Error> {
    let planned = &set.header.content_hashes;
    let changed: Vec<&str> = planned
        .iter()
        .filter(|(name, hash)| task.content_hashes.get(*name) != Some(hash))
        .map(|(name, _)| name.as_str())
        .collect();
    if changed.is_empty() {
        return Ok(());
    }
    Err(ModelError::invalid(
        trajectories,
        format!("these inputs are not those that were planned with: {}", changed.join(", ")),
    )
    .into())
}

/// A preset by its name, else a file.
///
/// # Errors
/// Where the rig is unknown or wrong.
pub fn load_rig(name: &str) -> Result<Rig, Error> {
    let rig = if is_file(name) { Rig::load(Path::new(name)) } else { Rig::preset(name) };
    rig.map_err(|error| Error::Render(error.into()))
}

/// A preset by its name, else a file.
pub(super) fn load_sensor(name: &str) -> Result<Sensor, Error> {
    let sensor = if is_file(name) { Sensor::load(Path::new(name)) } else { Sensor::preset(name) };
    sensor.map_err(|error| Error::Render(error.into()))
}

/// Whether a name is that of a file rather than of a preset.
pub(super) fn is_file(name: &str) -> bool {
    name.ends_with(".toml") || Path::new(name).components().count() > 1
}

pub(super) fn open_backend(
    choice: BackendChoice,
    context: &Context<'_>,
) -> Result<Box<dyn Backend>, Error> {
    use akrobat_gpu::AdapterChoice;
    match choice {
        BackendChoice::Soft => Ok(Box::new(SoftBackend::new())),
        BackendChoice::Wgpu => Ok(Box::new(WgpuBackend::open(&AdapterChoice::Any)?)),
        BackendChoice::Auto => match WgpuBackend::open(&AdapterChoice::Auto) {
            Ok(backend) => Ok(Box::new(backend)),
            // Without a graphics processor, the CPU draws faster than a software driver.
            Err(RenderError::Device { .. }) => Ok(Box::new(SoftBackend::new())),
            Err(error) => Err(error.into()),
        },
        BackendChoice::Sapien => open_sapien(SapienShaders::Minimal, context),
        BackendChoice::SapienDefault => open_sapien(SapienShaders::Default, context),
        BackendChoice::SapienRt => open_sapien(SapienShaders::Rt, context),
    }
}

fn open_sapien(shaders: SapienShaders, context: &Context<'_>) -> Result<Box<dyn Backend>, Error> {
    let host = context.host.ok_or_else(|| {
        Error::Usage(
            "the sapien backends need the Python package: \
             pip install 'akrobat[sapien]', then the same command with its `akrobat`"
                .into(),
        )
    })?;
    Ok(host.sapien_backend(shaders)?)
}

/// The URDFs, which MCAP logs carry along.
fn attachments(
    task: &Task,
    task_path: &Path,
    search: &AssetSearch,
) -> Result<Vec<Attachment>, Error> {
    let object = search.find(&task.file.object.urdf, task_path)?;
    let files = [("robot.urdf", &task.robot.urdf_path), ("object.urdf", &object)];
    let attach = |(name, path): (&str, &PathBuf)| {
        let content = std::fs::read(path).map_err(|e| ModelError::read(path, e))?;
        Ok(Attachment { name: name.into(), media_type: "application/xml".into(), content })
    };
    files.into_iter().map(attach).collect()
}
