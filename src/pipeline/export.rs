//! Dataset or trajectory file -> the layout of a trainer or tool.

use std::path::{Path, PathBuf};

use akrobat_model::events::Event;
use akrobat_model::load;
use akrobat_packager::export::{
    self, ExportConfig, ExportFormat, ExportHeader, Sink, Source, non_commercial,
};
use akrobat_packager::{DatasetReader, StagingFolder, trajectory_file};
use serde::Serialize;

use super::Context;
use super::render::{check_unchanged, task_path};
use crate::{Error, Host};

/// Frames that are read and handed on at once: 3 cameras of 320 x 240 take 16 MB.
const BATCH_FRAMES: usize = 16;

/// Names of the progress stages.
const SCAN: &str = "reading episodes";
const WRITE: &str = "exporting";

/// What is to be exported.
#[derive(Debug, Clone)]
pub struct ExportRequest {
    /// Dataset folder, or trajectory file.
    pub input: PathBuf,
    /// The format.
    pub format: ExportFormat,
    /// Folder to write: new or empty.
    pub output: PathBuf,
    /// Settings.
    pub config: ExportConfig,
    /// Positions among the stored episodes; all where absent.
    pub episodes: Option<Vec<usize>>,
    /// Export although a licence forbids commercial use.
    pub allow_non_commercial: bool,
    /// Folders where assets are looked up (trajectory files only).
    pub assets: Vec<PathBuf>,
}

/// What an export gave.
#[derive(Debug, Clone, Serialize)]
pub struct ExportReport {
    /// The folder.
    pub output: PathBuf,
    /// Name of the format.
    pub format: &'static str,
    /// Episodes, or trajectories, written.
    pub episodes: u64,
    /// Frames, or samples, written.
    pub frames: u64,
    /// Names of the action columns; none for trajectory files.
    pub action_names: Vec<String>,
    /// Names of the state columns; none for trajectory files.
    pub state_names: Vec<String>,
    /// Bytes of all files.
    pub bytes: u64,
    /// Wall time, seconds.
    pub seconds: f64,
}

/// Exports a dataset or a trajectory file. The output appears only when it is whole.
///
/// # Errors
/// Where the input or the settings are wrong, a licence forbids it, the output stands already, a library
/// is missing, the disk fails, or the user asked to stop.
pub fn export(request: &ExportRequest, context: &Context<'_>) -> Result<ExportReport, Error> {
    check_config(&request.config)?;
    let started = std::time::Instant::now();
    let mut report = if request.input.is_dir() {
        export_dataset(request, context)?
    } else {
        export_trajectories(request, context)?
    };
    report.bytes = bytes_below(&request.output);
    report.seconds = started.elapsed().as_secs_f64();
    Ok(report)
}

/// Writes the card of a dataset into its own folder. Returns the number of pictures.
///
/// # Errors
/// As [`export`].
pub fn card(dataset: &Path, context: &Context<'_>) -> Result<(PathBuf, usize), Error> {
    let config = ExportConfig::default();
    let source = Source::open(DatasetReader::open(dataset)?, None, &config)?;
    let header = scan(&source, &config, context, dataset)?;
    let pictures = export::write_card(dataset, &source, &header, None)?;
    Ok((dataset.join("README.md"), pictures))
}

fn check_config(config: &ExportConfig) -> Result<(), Error> {
    if (0.0..=1.0).contains(&config.validation) {
        return Ok(());
    }
    Err(Error::Usage(format!("--validation: expected 0 to 1, got {}", config.validation)))
}

fn export_dataset(request: &ExportRequest, context: &Context<'_>) -> Result<ExportReport, Error> {
    let ExportRequest { format, config, .. } = request;
    let dataset = DatasetReader::open(&request.input)?;
    check_licences(request, &dataset)?;
    if !dataset.is_complete() {
        let message = format!(
            "{}: the run that wrote it has not come to its end; what is there is exported",
            request.input.display()
        );
        context.observer.event(&Event::Warning { message: &message });
    }
    let source = Source::open(dataset, request.episodes.as_deref(), config)?;
    let staging = StagingFolder::create(&request.output)?;
    let header = scan(&source, config, context, &request.output)?;
    let mut sink = open_sink(*format, staging.path(), &header, context)?;
    write(&source, *format, &header, sink.as_mut(), context, &request.output)?;
    drop(sink);
    export::write_card(staging.path(), &source, &header, Some(*format))?;
    staging.commit()?;
    Ok(ExportReport {
        output: request.output.clone(),
        format: format.name(),
        episodes: header.episodes,
        frames: header.frames,
        action_names: header.action_names,
        state_names: header.state_names,
        bytes: 0,
        seconds: 0.0,
    })
}

fn check_licences(request: &ExportRequest, dataset: &DatasetReader) -> Result<(), Error> {
    let bound = non_commercial(&dataset.config().licences);
    if request.allow_non_commercial || bound.is_empty() {
        return Ok(());
    }
    let named: Vec<String> =
        bound.iter().map(|licence| format!("{} ({})", licence.asset, licence.license)).collect();
    Err(Error::Usage(format!(
        "{}: these licences forbid commercial use: {}; --allow-non-commercial exports all the same, and the \
         dataset card says so",
        request.input.display(),
        named.join(", ")
    )))
}

fn scan(
    source: &Source,
    config: &ExportConfig,
    context: &Context<'_>,
    output: &Path,
) -> Result<ExportHeader, Error> {
    let observer = context.observer;
    observer.event(&Event::StageStarted { stage: SCAN, total: Some(source.len() as u64) });
    let started = std::time::Instant::now();
    let header = ExportHeader::scan(source, config, || observer.cancelled())?;
    let seconds = started.elapsed().as_secs_f64();
    observer.event(&Event::StageFinished { stage: SCAN, seconds });
    header.ok_or_else(|| interrupted(output))
}

fn interrupted(output: &Path) -> Error {
    Error::Interrupted(format!("{} was not written", output.display()))
}

/// The writer: our own, or the host's where a Python library writes the format.
fn open_sink(
    format: ExportFormat,
    folder: &Path,
    header: &ExportHeader,
    context: &Context<'_>,
) -> Result<Box<dyn Sink>, Error> {
    if let Some(sink) = export::native_sink(format, folder, header)? {
        return Ok(sink);
    }
    let what = format!("the format {}", format.name());
    host_for(context, &what, "export")?.export_sink(format, folder, header)
}

pub(super) fn host_for<'a>(
    context: &Context<'a>,
    what: &str,
    extra: &str,
) -> Result<&'a dyn Host, Error> {
    context.host.ok_or_else(|| {
        Error::Usage(format!(
            "{what} needs the Python package: pip install 'akrobat[{extra}]', then the same command with \
             its `akrobat`"
        ))
    })
}

fn write(
    source: &Source,
    format: ExportFormat,
    header: &ExportHeader,
    sink: &mut dyn Sink,
    context: &Context<'_>,
    output: &Path,
) -> Result<(), Error> {
    let observer = context.observer;
    let started = std::time::Instant::now();
    observer.event(&Event::StageStarted { stage: WRITE, total: Some(header.frames) });
    let mut done = 0;
    for index in 0..source.len() {
        let (episode, frames) = source.episode(index)?;
        sink.begin(&episode)?;
        for first in (0..episode.frames()).step_by(BATCH_FRAMES) {
            if observer.cancelled() {
                return Err(interrupted(output));
            }
            if format.needs().any() {
                let batch = frames.batch(first, BATCH_FRAMES, format.needs())?;
                sink.frames(&episode, &batch)?;
            }
            done += BATCH_FRAMES.min(episode.frames() - first) as u64;
            observer.event(&Event::Progress { stage: WRITE, done });
        }
        sink.end(&episode)?;
    }
    sink.finish()?;
    let seconds = started.elapsed().as_secs_f64();
    observer.event(&Event::StageFinished { stage: WRITE, seconds });
    Ok(())
}

fn export_trajectories(
    request: &ExportRequest,
    context: &Context<'_>,
) -> Result<ExportReport, Error> {
    let set = trajectory_file::read(&request.input)?;
    let staging = match request.format {
        ExportFormat::Automoma => {
            let host = host_for(context, "traj_data.pt", "export")?;
            let staging = StagingFolder::create(&request.output)?;
            host.write_traj_data(&staging.path().join("traj_data.pt"), &set)?;
            staging
        }
        ExportFormat::JointTrajectory => {
            let search = context.asset_search(&request.assets)?;
            let path = task_path(&request.input, &set);
            let task = load::task_from_text(set.header.task_toml.clone(), &path, &search)?;
            check_unchanged(&request.input, &set, &task)?;
            let staging = StagingFolder::create(&request.output)?;
            let fingers = task.robot.gripper_joints.len();
            export::write_joint_trajectories(staging.path(), &set, fingers)?;
            staging
        }
        other => {
            return Err(Error::Usage(format!(
                "{}: is a trajectory file, which has no images; {} is exported from a dataset that \
                 `akrobat render` wrote; from trajectories: automoma, joint-trajectory",
                request.input.display(),
                other.name()
            )));
        }
    };
    staging.commit()?;
    Ok(ExportReport {
        output: request.output.clone(),
        format: request.format.name(),
        episodes: set.trajectories.len() as u64,
        frames: set.trajectories.iter().map(|t| t.dense.len() as u64).sum(),
        action_names: Vec::new(),
        state_names: Vec::new(),
        bytes: 0,
        seconds: 0.0,
    })
}

/// Bytes of all files below a folder that was just written.
fn bytes_below(folder: &Path) -> u64 {
    let Ok(entries) = folder.read_dir() else { return 0 };
    entries
        .flatten()
        .map(|entry| match entry.metadata() {
            Ok(found) if found.is_dir() => bytes_below(&entry.path()),
            Ok(found) => found.len(),
            Err(_) => 0,
        })
        .sum()
}
