//! Trajectory file -> replay -> images -> dataset.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use akrobat_cameras::Rig;
use akrobat_model::events::{Event, Observer};
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::Task;
use akrobat_model::{ModelError, Rejection, Trajectory, TrajectorySet};
use akrobat_packager::dataset::{Container, DatasetConfig, DatasetWriter, Licence, Status};
use akrobat_packager::{Attachment, EpisodeInfo, trajectory_file};
use akrobat_renderer::raster::WgpuBackend;
use akrobat_renderer::replay::Replay;
use akrobat_renderer::{
    Appearance, Backend, EpisodeConfig, EpisodeRenderer, Lighting, RenderError, RenderScene,
    SoftBackend, Supersampling, Variation,
};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::{Context, folder_of, on_threads, simulated};
use crate::Error;

/// Frames that a backend is handed at once, and that are held in memory: 3 cameras of 320 x 240
/// take 60 MB.
const BATCH_FRAMES: usize = 32;

/// Name of the progress stage.
const STAGE: &str = "rendering";

/// Which renderer draws.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
pub enum BackendChoice {
    /// `wgpu` where there is a graphics processor, else `soft`.
    #[default]
    Auto,
    /// The rasteriser on the CPU.
    Soft,
    /// The graphics processor, or a software Vulkan driver.
    Wgpu,
    /// SAPIEN (needs the Python package).
    Sapien,
}

/// Which files hold the episodes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
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
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
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
    /// Which files hold the episodes.
    pub format: Format,
    /// Positions in the trajectory file; all where absent.
    pub episodes: Option<Vec<usize>>,
    /// Render only the manipulation, without approach and grasp.
    pub manipulation_only: bool,
    /// Whether what was planned is shown, or what the robot did in physics.
    pub states: States,
    /// Episodes in one HDF5 shard; the packager's default where absent. What is interrupted loses at most
    /// the shard that was being written.
    pub episodes_per_shard: Option<u32>,
    /// Continue what an interrupted run left in the output.
    pub resume: bool,
    /// Number of threads; one for each core where absent. The result does not depend on it.
    pub threads: Option<usize>,
}

/// What rendering gave.
#[derive(Debug, Clone, Serialize)]
pub struct RenderReport {
    /// Dataset folders, one for each container.
    pub datasets: Vec<PathBuf>,
    /// Name of the renderer that drew.
    pub backend: String,
    /// Episodes written by this run.
    pub episodes: u64,
    /// Episodes that an earlier run had written.
    pub resumed: u64,
    /// Episodes left out because the judge had refused them.
    pub filtered: u64,
    /// Frames written by this run.
    pub frames: u64,
    /// Images drawn by this run.
    pub images: u64,
    /// Wall time, seconds.
    pub seconds: f64,
}

/// Replays a trajectory file, renders it and writes a dataset.
///
/// # Errors
/// Where the trajectories, the rig or the assets are wrong, a device or the disk fails, or the user
/// asked to stop; whole shards are kept then.
pub fn render(request: &RenderRequest, context: &Context<'_>) -> Result<RenderReport, Error> {
    let mut set = trajectory_file::read(&request.trajectories)?;
    let episodes = request.episodes.as_deref();
    let selected = super::selection(&request.trajectories, episodes, set.trajectories.len())?;
    let rig = load_rig(request.rig.as_deref().unwrap_or("paper"))?;
    let search = context.asset_search(&request.assets)?;
    let task_path = task_path(&request.trajectories, &set);
    let task = load::task_from_text(set.header.task_toml.clone(), &task_path, &search)?;
    check_unchanged(&request.trajectories, &set, &task)?;
    let unfit = match request.states {
        States::Planned => BTreeMap::new(),
        States::Simulated => simulated::replace_paths(&request.trajectories, &mut set)?,
    };
    let links = task.robot.tree.links().iter().map(|link| link.name.as_str());
    rig.validate_links(links).map_err(|error| Error::Render(error.into()))?;
    let backend = open_backend(request.backend, context)?;
    let lighting = Lighting::named(request.lighting.as_deref().unwrap_or("even"))?;
    let look = Look::new(request)?;
    let backend = request.supersampling.over(backend);
    let scene = RenderScene::from_task(&task)?.lit_by(&lighting);
    let provenance = provenance(&set, &scene, backend.name(), request);
    let attachments = attachments(&task, &task_path, &search)?;
    let job = Job {
        request,
        set: &set,
        task: &task,
        scene: &scene,
        rig: &rig,
        unfit,
        look,
        provenance,
        attachments,
        observer: context.observer,
    };
    on_threads(request.threads, || job.run(&selected, backend))
}

struct Job<'a> {
    request: &'a RenderRequest,
    set: &'a TrajectorySet,
    task: &'a Task,
    scene: &'a RenderScene,
    rig: &'a Rig,
    /// Why episodes are left out, by position.
    unfit: BTreeMap<usize, String>,
    look: Look,
    provenance: serde_json::Value,
    attachments: Vec<Attachment>,
    observer: &'a dyn Observer,
}

impl Job<'_> {
    fn run(
        &self,
        selected: &[usize],
        mut backend: Box<dyn Backend>,
    ) -> Result<RenderReport, Error> {
        let started = std::time::Instant::now();
        let config = EpisodeConfig {
            manipulation_only: self.request.manipulation_only,
            ..EpisodeConfig::default()
        };
        let trajectories = || selected.iter().map(|&index| (index, &self.set.trajectories[index]));
        let frames: usize = trajectories()
            .map(|(_, t)| t.frame_times(config.rate_hz, config.manipulation_only).len())
            .sum();
        let (datasets, mut writers) = self.open_writers()?;
        let mut report = RenderReport {
            datasets,
            backend: backend.name().to_owned(),
            episodes: 0,
            resumed: 0,
            filtered: 0,
            frames: 0,
            images: 0,
            seconds: 0.0,
        };
        self.observer.event(&Event::StageStarted { stage: STAGE, total: Some(frames as u64) });
        for (index, trajectory) in trajectories() {
            if writers.iter().all(|writer| writer.contains(&trajectory.id)) {
                report.resumed += 1;
                continue;
            }
            let rejection = trajectory.verdict.as_ref().and_then(|v| v.rejection);
            let unfit = self.unfit.get(&index).map(String::as_str);
            if let Some(reason) = rejection.map(Rejection::name).or(unfit) {
                for writer in writers.iter_mut().filter(|w| !w.contains(&trajectory.id)) {
                    writer.skip_episode(&trajectory.id, Status::Filtered, reason)?;
                }
                report.filtered += 1;
                continue;
            }
            let (scene, provenance) = self.look.of(self, trajectory)?;
            let renderer = EpisodeRenderer::new(self.task, &scene, self.rig, config.clone());
            let episode = renderer.episode(trajectory)?;
            let frames = episode.frame_count();
            let info = EpisodeInfo {
                labels: scene.segment_labels(),
                provenance,
                ..self.info(index, trajectory, frames, &config)
            };
            let mut open: Vec<&mut DatasetWriter> =
                writers.iter_mut().filter(|w| !w.contains(&trajectory.id)).collect();
            for writer in &mut open {
                writer.begin_episode(info.clone())?;
            }
            for first in (0..episode.frame_count()).step_by(BATCH_FRAMES) {
                if self.observer.cancelled() {
                    return Err(interrupted(&self.request.output));
                }
                let batch = first..(first + BATCH_FRAMES).min(episode.frame_count());
                for observation in episode.observe_batch(batch, backend.as_mut())? {
                    report.images += observation.cameras.len() as u64;
                    for writer in &mut open {
                        writer.push(observation.clone())?;
                    }
                    report.frames += 1;
                }
                self.observer.event(&Event::Progress { stage: STAGE, done: report.frames });
            }
            for writer in &mut open {
                writer.finish_episode()?;
            }
            report.episodes += 1;
        }
        for writer in writers {
            writer.close()?;
        }
        report.seconds = started.elapsed().as_secs_f64();
        self.observer.event(&Event::StageFinished { stage: STAGE, seconds: report.seconds });
        Ok(report)
    }

    /// One writer for each container, with its folder.
    fn open_writers(&self) -> Result<(Vec<PathBuf>, Vec<DatasetWriter>), Error> {
        let output = &self.request.output;
        let places = match self.request.format {
            Format::Hdf5 => vec![(output.clone(), Container::Hdf5)],
            Format::Mcap => vec![(output.clone(), Container::Mcap)],
            Format::Both => {
                vec![(output.join("hdf5"), Container::Hdf5), (output.join("mcap"), Container::Mcap)]
            }
        };
        let mut writers = Vec::new();
        for (folder, container) in &places {
            let config = self.dataset_config(*container);
            let open =
                if self.request.resume { DatasetWriter::resume } else { DatasetWriter::create };
            writers.push(open(folder, config)?);
        }
        Ok((places.into_iter().map(|(folder, _)| folder).collect(), writers))
    }

    fn dataset_config(&self, container: Container) -> DatasetConfig {
        let file = &self.task.file;
        let robot = &self.task.robot;
        let licences = vec![
            Licence {
                asset: robot.name.clone(),
                license: robot.file.license.clone(),
                source: robot.file.source.clone(),
            },
            Licence {
                asset: self.task.object.name.clone(),
                license: file.object.license.clone(),
                source: String::new(),
            },
        ];
        let defaults = DatasetConfig::new(&self.set.header.task_name, self.rig.clone());
        DatasetConfig {
            container,
            licences,
            provenance: self.provenance.clone(),
            episodes_per_shard: self
                .request
                .episodes_per_shard
                .unwrap_or(defaults.episodes_per_shard),
            ..defaults
        }
    }

    fn info(
        &self,
        index: usize,
        trajectory: &Trajectory,
        frames: usize,
        config: &EpisodeConfig,
    ) -> EpisodeInfo {
        let header = &self.set.header;
        EpisodeInfo {
            id: trajectory.id.clone(),
            success: trajectory.verdict.as_ref().is_some_and(|verdict| verdict.accepted()),
            seed: trajectory.seed,
            traj_index: index as u32,
            frames: frames as u32,
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
            finger_joints: self.task.robot.gripper_joints.len(),
            object_joints: header.object_joints.clone(),
            active_joint: header.active_joint.clone(),
            world_from_robot_root: self.task.robot.world_from_root,
            rig: self.rig.clone(),
            cloud_points: config.cloud.points,
            labels: self.scene.segment_labels(),
            task_toml: header.task_toml.clone(),
            provenance: self.provenance.clone(),
            attachments: self.attachments.clone(),
        }
    }
}

/// What episodes look like.
enum Look {
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
    fn new(request: &RenderRequest) -> Result<Self, Error> {
        match (&request.variation, &request.appearance) {
            (Some(_), Some(_)) => {
                Err(Error::Usage("a variation and a recorded appearance exclude each other".into()))
            }
            (Some(name), None) => Ok(Self::Varied(Variation::named(name)?, request.variation_seed)),
            (None, Some(path)) => Ok(Self::Recorded(Box::new(Appearance::load(path)?))),
            (None, None) => Ok(Self::Plain),
        }
    }

    /// The scene of an episode, and its provenance, which holds all that was drawn.
    fn of(
        &self,
        job: &Job<'_>,
        trajectory: &Trajectory,
    ) -> Result<(RenderScene, serde_json::Value), Error> {
        let drawn;
        let appearance: &Appearance = match self {
            Self::Plain => return Ok((job.scene.clone(), job.provenance.clone())),
            Self::Recorded(appearance) => appearance,
            Self::Varied(variation, seed) => {
                let replay = Replay::new(job.task, job.scene);
                replay.check(trajectory)?;
                let duration_s = trajectory.dense.duration_s();
                let times = (0..KEYFRAMES).map(|k| k as f64 / (KEYFRAMES - 1) as f64 * duration_s);
                let frames: Vec<_> = times.map(|t| replay.at_time(trajectory, 0, t)).collect();
                drawn = variation.draw(job.scene, &frames, *seed, &trajectory.id);
                &drawn
            }
        };
        let mut provenance = job.provenance.clone();
        provenance["renderer"]["lighting"] = json!(appearance.lighting);
        provenance["renderer"]["appearance"] = json!(appearance);
        Ok((appearance.apply(job.scene)?, provenance))
    }
}

fn interrupted(output: &Path) -> Error {
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
    let is_file = name.ends_with(".toml") || Path::new(name).components().count() > 1;
    let rig = if is_file { Rig::load(Path::new(name)) } else { Rig::preset(name) };
    rig.map_err(|error| Error::Render(error.into()))
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
        BackendChoice::Sapien => {
            let host = context.host.ok_or_else(|| {
                Error::Usage(
                    "the sapien backend needs the Python package: \
                     pip install 'akrobat[sapien]', then the same command with its `akrobat`"
                        .into(),
                )
            })?;
            Ok(host.sapien_backend()?)
        }
    }
}

fn provenance(
    set: &TrajectorySet,
    scene: &RenderScene,
    backend: &str,
    request: &RenderRequest,
) -> serde_json::Value {
    let header = &set.header;
    json!({
        "akrobat": env!("CARGO_PKG_VERSION"),
        "content_hashes": header.content_hashes,
        "planner": { "backend": header.backend, "config": header.planner_config, "seed": header.seed },
        "renderer": {
            "backend": backend,
            "lighting": scene.lighting,
            "supersampling": request.supersampling,
        },
        "phases": if request.manipulation_only { "manipulate" } else { "all" },
        "states": request.states,
    })
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
