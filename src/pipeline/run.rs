//! Jobs: trajectory files x rigs x lightings x sensors, from one file.
//!
//! Every combination becomes a dataset of its own, `OUTPUT/TRAJECTORIES/RIG-LIGHTING-SENSOR`. What is there
//! already is left as it is, so that running a job again continues it. Memory holds one trajectory file with its scene
//! and some 64 MB of images at a time, however many episodes there are.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use akrobat_cameras::Modality;
use akrobat_model::ModelError;
use akrobat_packager::{StorageConfig, trajectory_file};
use akrobat_renderer::pointcloud::CloudConfig;
use akrobat_renderer::{Backend, Detail, RenderScene, Supersampling};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::episodes::EpisodeFilter;
use super::production::files_below;
use super::render::{
    BackendChoice, DEFAULT_LIGHTING, Format, Job, Look, RenderReport, RenderRequest, Source,
    Variant, is_file, open_backend,
};
use super::sample::sample;
use super::{Context, folder_of, on_threads};
use crate::Error;

/// A job (TOML). Paths are relative to its file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JobFile {
    /// Name for reports.
    pub name: String,
    /// Trajectory files, and folders of them such as `akrobat produce` writes.
    pub trajectories: Vec<PathBuf>,
    /// Folder of the datasets.
    pub output: PathBuf,
    /// Folders where assets are looked up.
    #[serde(default)]
    pub assets: Vec<PathBuf>,
    /// Which trajectories of the files are rendered.
    #[serde(default)]
    pub filter: EpisodeFilter,
    /// Only this many of the trajectories that pass the filter, drawn from all files together.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sample: Option<usize>,
    /// Seed of the sample: the same one draws the same trajectories.
    #[serde(default)]
    pub sample_seed: u64,
    /// How they are rendered and stored.
    #[serde(default)]
    pub render: RenderSettings,
    /// What they are rendered with: every combination.
    #[serde(default)]
    pub variants: Variants,
}

/// What all datasets of a job share.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct RenderSettings {
    /// Which renderer draws.
    pub backend: BackendChoice,
    /// Which files hold the episodes.
    pub format: Format,
    /// Colour is the mean of this many samples along either edge of a pixel: 1, 3 or 5.
    #[schemars(with = "u32")]
    pub supersampling: Supersampling,
    /// How many triangles are drawn.
    pub detail: Detail,
    /// Images that are stored in HDF5 shards; colour, depth and segmentation where empty.
    pub modalities: Vec<Modality>,
    /// Fused clouds.
    pub cloud: CloudConfig,
    /// Seed of sensors and mounting errors.
    pub seed: u64,
    /// Render only the manipulation, without approach and grasp.
    pub manipulation_only: bool,
    /// Episodes in one HDF5 shard, 1 by default: an interruption loses at most that many.
    pub episodes_per_shard: Option<u32>,
}

/// The rigs, lightings and sensors of a job, each a preset's name or a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Variants {
    /// Rigs.
    pub rigs: Vec<String>,
    /// Lightings.
    pub lightings: Vec<String>,
    /// Sensors.
    pub sensors: Vec<String>,
}

impl Default for Variants {
    fn default() -> Self {
        let one = |name: &str| vec![name.to_owned()];
        Self { rigs: one("paper"), lightings: one(DEFAULT_LIGHTING), sensors: one("ideal") }
    }
}

/// Frames that a dry run renders for each combination, to know what one costs.
const SAMPLED_FRAMES: u32 = 4;

/// Which job is run.
#[derive(Debug, Clone, Default)]
pub struct RunRequest {
    /// Job file.
    pub job: PathBuf,
    /// Folder of the datasets, instead of the job's.
    pub output: Option<PathBuf>,
    /// Folders where assets are looked up, before the job's.
    pub assets: Vec<PathBuf>,
    /// Narrows down the job's own filter where something is given.
    pub filter: EpisodeFilter,
    /// Size of the sample, instead of the job's.
    pub sample: Option<usize>,
    /// Only tell what would be done.
    pub dry_run: bool,
    /// Number of threads; one for each core where absent. The result does not depend on it.
    pub threads: Option<usize>,
}

/// One dataset of a job.
#[derive(Debug, Clone, Serialize)]
pub struct RunOutput {
    /// Trajectory file.
    pub trajectories: PathBuf,
    /// The dataset's folder.
    pub output: PathBuf,
    /// Rig, lighting and sensor.
    pub rig: String,
    /// Name of the lighting.
    pub lighting: String,
    /// Name of the sensor.
    pub sensor: String,
    /// Episodes that are wanted.
    pub episodes: u64,
    /// Frames of these.
    pub frames: u64,
    /// Images of these.
    pub images: u64,
    /// Size that is expected, bytes; of a dry run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected_bytes: Option<u64>,
    /// Wall time that is expected on this machine, seconds; of a dry run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expected_seconds: Option<f64>,
    /// What rendering gave.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub report: Option<RenderReport>,
}

/// What a job gave.
#[derive(Debug, Clone, Serialize)]
pub struct RunReport {
    /// The job's name.
    pub name: String,
    /// Whether nothing was written.
    pub dry_run: bool,
    /// The datasets.
    pub outputs: Vec<RunOutput>,
    /// Wall time, seconds.
    pub seconds: f64,
}

impl RunReport {
    /// True where nothing that was asked for is missing.
    pub fn is_complete(&self) -> bool {
        self.outputs.iter().filter_map(|o| o.report.as_ref()).all(RenderReport::is_complete)
    }
}

/// A combination of rig, lighting and sensor.
struct Combination {
    names: [String; 3],
    request: RenderRequest,
    variant: Variant,
}

/// Runs a job, or tells what it would do.
///
/// # Errors
/// Where the job or a file that it names is wrong, before anything is rendered; then as rendering.
pub fn run(request: &RunRequest, context: &Context<'_>) -> Result<RunReport, Error> {
    let started = Instant::now();
    let job = JobFile::load(&request.job)?;
    let combinations = job.combinations(request)?;
    let files = job.sources(&request.job)?;
    let filter = job.filter.narrowed(&request.filter);
    let drawn = match request.sample.or(job.sample) {
        Some(count) => Some(sample(files.values(), &filter, count, job.sample_seed)?),
        None => None,
    };
    let backend = open_backend(job.render.backend, context)?;
    let mut backend = job.render.supersampling.over(backend);
    let mut outputs = Vec::new();
    on_threads(request.threads, || {
        for (name, file) in &files {
            if drawn.as_ref().is_some_and(|drawn| !drawn.contains_key(file)) {
                continue;
            }
            let set = trajectory_file::read(file)?;
            let selected = match &drawn {
                Some(drawn) => drawn[file].clone(),
                None => filter.select(file, &set)?,
            };
            if selected.is_empty() {
                continue;
            }
            let mut source = Source::load(file, set, &job.asset_folders(request), context)?;
            source.scene = job.render.detail.of(source.scene);
            for combination in &combinations {
                combination.variant.check_fits(&source)?;
            }
            for combination in &combinations {
                let folder =
                    combination.request.output.join(name).join(combination.names.join("-"));
                let output = combination.output(&source, &selected, file, &folder);
                let rig_has_fitted = outputs.iter().any(|done: &RunOutput| done.rig == output.rig);
                let (source, selected) = (&source, &selected[..]);
                let target = Target { source, selected, folder: &folder, rig_has_fitted };
                let backend = backend.as_mut();
                outputs.push(if request.dry_run {
                    combination.expect(&target, output, backend, context)?
                } else {
                    combination.render(&target, output, backend, context)?
                });
            }
        }
        Ok(())
    })?;
    if outputs.is_empty() {
        let files = request.job.display();
        return Err(Error::Usage(format!("{files}: no trajectory passes the filter {filter:?}")));
    }
    let seconds = started.elapsed().as_secs_f64();
    Ok(RunReport { name: job.name, dry_run: request.dry_run, outputs, seconds })
}

impl JobFile {
    /// Reads and checks a job file.
    ///
    /// # Errors
    /// [`Error::Input`] where it cannot be read or is not a job, [`Error::Usage`] where a list is empty.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|e| ModelError::read(path, e))?;
        let job: Self =
            toml::from_str(&text).map_err(|e| ModelError::invalid(path, e.to_string()))?;
        let lists = [
            ("trajectories", job.trajectories.len()),
            ("variants.rigs", job.variants.rigs.len()),
            ("variants.lightings", job.variants.lightings.len()),
            ("variants.sensors", job.variants.sensors.len()),
        ];
        match lists.iter().find(|(_, length)| *length == 0) {
            Some((name, _)) => {
                let path = path.display();
                Err(Error::Usage(format!("{path}: {name}: expected at least one, got none")))
            }
            None => Ok(job),
        }
    }

    /// The trajectory files, with names for their folders.
    fn sources(&self, job: &Path) -> Result<BTreeMap<String, PathBuf>, Error> {
        let mut sources = BTreeMap::new();
        let mut add = |name: String, path: PathBuf| {
            if sources.insert(name.clone(), path).is_none() {
                return Ok(());
            }
            let job = job.display();
            Err(Error::Usage(format!("{job}: two trajectory files are called {name}")))
        };
        for given in &self.trajectories {
            let path = folder_of(job).join(given);
            if path.is_dir() {
                for file in files_below(&path)? {
                    let below = file.strip_prefix(&path).unwrap_or(&file).with_extension("");
                    add(below.to_string_lossy().into_owned(), file)?;
                }
            } else if path.is_file() {
                add(stem(&given.to_string_lossy()), path)?;
            } else {
                let (job, path) = (job.display(), path.display());
                let message = format!("{job}: no trajectory file or folder of them {path}");
                return Err(Error::Usage(message));
            }
        }
        Ok(sources)
    }

    fn asset_folders(&self, request: &RunRequest) -> Vec<PathBuf> {
        let own = self.assets.iter().map(|folder| folder_of(&request.job).join(folder));
        request.assets.iter().cloned().chain(own).collect()
    }

    fn combinations(&self, request: &RunRequest) -> Result<Vec<Combination>, Error> {
        let base = folder_of(&request.job);
        let place = |name: &String| match is_file(name) {
            true => base.join(name).display().to_string(),
            false => name.clone(),
        };
        let output = request.output.clone().unwrap_or_else(|| base.join(&self.output));
        let mut combinations: Vec<Combination> = Vec::new();
        for rig in &self.variants.rigs {
            for lighting in &self.variants.lightings {
                for sensor in &self.variants.sensors {
                    let names = [rig, lighting, sensor].map(|name| stem(name));
                    if combinations.iter().any(|known| known.names == names) {
                        let job = request.job.display();
                        let message = format!("{job}: two variants are called {}", names.join("-"));
                        return Err(Error::Usage(message));
                    }
                    let request = RenderRequest {
                        output: output.clone(),
                        rig: Some(place(rig)),
                        lighting: Some(place(lighting)),
                        supersampling: self.render.supersampling,
                        detail: self.render.detail,
                        sensor: Some(place(sensor)),
                        format: self.render.format,
                        modalities: self.render.modalities.clone(),
                        cloud: self.render.cloud.clone(),
                        seed: self.render.seed,
                        manipulation_only: self.render.manipulation_only,
                        storage: StorageConfig {
                            episodes_per_shard: self.render.episodes_per_shard.unwrap_or(1),
                            ..StorageConfig::default()
                        },
                        resume: true,
                        ..RenderRequest::default()
                    };
                    let variant = Variant::load(&request)?;
                    combinations.push(Combination { names, request, variant });
                }
            }
        }
        Ok(combinations)
    }
}

/// A preset's name, or that of a file without folder and ending.
fn stem(name: &str) -> String {
    let stem = Path::new(name).file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

/// What a combination is applied to.
struct Target<'a> {
    source: &'a Source,
    selected: &'a [usize],
    folder: &'a Path,
    /// Whether a file before was rendered with the same rig.
    rig_has_fitted: bool,
}

impl Combination {
    fn output(&self, source: &Source, selected: &[usize], file: &Path, folder: &Path) -> RunOutput {
        let config = &self.variant.config;
        let frames: usize = selected
            .iter()
            .map(|&index| &source.set.trajectories[index])
            .map(|t| t.frame_times(config.rate_hz, config.manipulation_only).len())
            .sum();
        let [rig, lighting, sensor] = self.names.clone();
        RunOutput {
            trajectories: file.to_path_buf(),
            output: folder.to_path_buf(),
            rig,
            lighting,
            sensor,
            episodes: selected.len() as u64,
            frames: frames as u64,
            images: (frames * self.variant.rig.cameras.len()) as u64,
            expected_bytes: None,
            expected_seconds: None,
            report: None,
        }
    }

    fn job<'a>(
        &'a self,
        request: &'a RenderRequest,
        target: &Target<'a>,
        scene: &'a RenderScene,
        unfit: &'a BTreeMap<usize, String>,
        backend: &dyn Backend,
        context: &Context<'a>,
    ) -> Result<Job<'a>, Error> {
        Ok(Job {
            request,
            source: target.source,
            scene,
            variant: &self.variant,
            unfit,
            look: Look::new(request)?,
            rig_has_fitted: target.rig_has_fitted,
            backend: backend.name().to_owned(),
            observer: context.observer,
        })
    }

    fn render(
        &self,
        target: &Target<'_>,
        output: RunOutput,
        backend: &mut dyn Backend,
        context: &Context<'_>,
    ) -> Result<RunOutput, Error> {
        let request = RenderRequest { output: target.folder.to_path_buf(), ..self.request.clone() };
        let scene = self.variant.lit(&target.source.scene);
        let unfit = BTreeMap::new();
        let job = self.job(&request, target, &scene, &unfit, backend, context)?;
        let report = job.run(target.selected, backend)?;
        Ok(RunOutput { report: Some(report), ..output })
    }

    /// Renders and stores some frames in a temporary folder, for their time and size.
    fn expect(
        &self,
        target: &Target<'_>,
        output: RunOutput,
        backend: &mut dyn Backend,
        context: &Context<'_>,
    ) -> Result<RunOutput, Error> {
        let scene = self.variant.lit(&target.source.scene);
        let unfit = BTreeMap::new();
        let job = self.job(&self.request, target, &scene, &unfit, backend, context)?;
        if let Err(refused) = self.variant.check_placement(target.source, target.selected[0]) {
            // Its episodes will be left out.
            return if target.rig_has_fitted { Ok(output) } else { Err(refused) };
        }
        let temporary = tempfile::tempdir()
            .map_err(|e| Error::Failed(format!("cannot make a temporary folder: {e}")))?;
        // The first time, meshes are cut into clusters and buffers grow.
        let first = temporary.path().join("first");
        let few = job.sample(target.selected[0], 1, &first, backend)?;
        let folder = temporary.path().join("sample");
        let started = Instant::now();
        let frames = job.sample(target.selected[0], SAMPLED_FRAMES, &folder, backend)?;
        let share = output.frames as f64 / f64::from(frames);
        // Tables and manifests take their bytes once, whatever the number of frames.
        let [smaller, larger] = [folder_bytes(&first)? as f64, folder_bytes(&folder)? as f64];
        let per_frame = match frames > few {
            true => (larger - smaller).max(0.0) / f64::from(frames - few),
            false => larger / f64::from(frames),
        };
        let further = output.frames as f64 - f64::from(frames);
        Ok(RunOutput {
            expected_bytes: Some((larger + per_frame * further).max(0.0) as u64),
            expected_seconds: Some(started.elapsed().as_secs_f64() * share),
            ..output
        })
    }
}

/// Bytes of all files below a folder.
fn folder_bytes(folder: &Path) -> Result<u64, Error> {
    let failed = |e: std::io::Error| Error::Failed(format!("{}: {e}", folder.display()));
    let mut bytes = 0;
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let about = entry.metadata().map_err(failed)?;
        bytes += if about.is_dir() { folder_bytes(&entry.path())? } else { about.len() };
    }
    Ok(bytes)
}
