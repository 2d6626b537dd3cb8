//! `akrobat render`: trajectory file -> dataset.

use std::path::{Path, PathBuf};

use akrobat_cameras::Modality;
use akrobat_packager::{DatasetReader, StorageConfig};
use akrobat_renderer::pointcloud::{CloudConfig, CloudFrame, CloudSampling};
use akrobat_renderer::{Detail, Supersampling};
use clap::{Args, ValueEnum};

use super::{Report, workers};
use crate::jobs::{JobFolder, slurm};
use crate::pipeline::{
    self, BackendChoice, Context, EpisodeFilter, EpisodeList, Format, RenderReport, RenderRequest,
    Sharing, States,
};
use crate::{Error, ExitCode};

/// Replay trajectories, render what cameras see, and write a dataset.
///
/// Examples:
///   akrobat render drawer.h5 -o dataset                      three RGB-D cameras, HDF5 shards
///   akrobat render drawer.h5 -o dataset --episodes 0,5-9     some of the trajectories
///   akrobat render drawer.h5 -o dataset --rig my_rig.toml    other cameras (`akrobat schema rig`)
///   akrobat render drawer.h5 -o dataset --lighting studio    other light, with shadows
///   akrobat render drawer.h5 -o dataset --variation wild     another look for every episode
///   akrobat render drawer.h5 -o dataset --sensor kinect      ... and a sensor's errors (`akrobat schema sensor`)
///   akrobat render drawer.h5 -o dataset --modalities rgb,depth,normals,flow
///   akrobat render drawer.h5 -o dataset --cloud-points 1024 --cloud-frame base
///   akrobat render drawer.h5 -o dataset --format mcap        one MCAP log per episode
///   akrobat render drawer.h5 -o dataset --resume             go on after an interruption
///   akrobat render drawer.h5 -o dataset --codec zstd         smaller files, for readers with hdf5plugin
///   akrobat render drawer.h5 -o dataset --workers 8          eight processes; any of them may die
///   akrobat render drawer.h5 -o /shared/dataset --join       ... started by hand, on several machines
///   akrobat render drawer.h5 -o /shared/dataset --slurm job.sh    a script for sbatch
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct RenderArgs {
    /// Trajectory file, as `akrobat plan` writes it.
    trajectories: PathBuf,
    /// Dataset folder to write: empty or new, unless --resume is given.
    #[arg(long, short)]
    output: PathBuf,
    /// Which renderer draws.
    #[arg(long, value_enum, default_value_t)]
    backend: BackendChoice,
    /// Cameras: the name of a preset or a rig file.
    #[arg(long, value_name = "PRESET|FILE", default_value = "paper")]
    rig: String,
    /// Light: the name of a preset (even, ceiling, sun, studio, evening, flat) or a lighting file (`akrobat schema
    /// lighting`).
    #[arg(long, value_name = "PRESET|FILE", default_value = "even")]
    lighting: String,
    /// Draw each episode's light, colours, textures, background and clutter at random: the name of a preset (mild, wild) or a
    /// file (`akrobat schema variation`). Everything drawn is recorded in the episode's provenance.
    #[arg(long, value_name = "PRESET|FILE")]
    variation: Option<String>,
    /// Seed of what is drawn; with the same one, an episode always looks the same.
    #[arg(long, value_name = "N", default_value_t = 0)]
    variation_seed: u64,
    /// Make episodes look as `renderer.appearance` of an episode's provenance says (JSON file).
    #[arg(long, value_name = "FILE", conflicts_with = "variation")]
    appearance: Option<PathBuf>,
    /// Smooth colours: the mean of N x N samples of each pixel. Depth and segmentation stay those of the pixel's centre.
    #[arg(long, value_name = "1|3|5", default_value_t)]
    supersampling: Supersampling,
    /// Triangles that are drawn: all (full), or as many as hold every surface within a millimetre (auto), which takes less
    /// time where meshes are finer than pixels.
    #[arg(long, value_name = "full|auto", default_value_t)]
    detail: Detail,
    /// What becomes of ideal images: the name of a preset (ideal, kinect, redwood, stereo, color) or a sensor
    /// file.
    #[arg(long, value_name = "PRESET|FILE", default_value = "ideal")]
    sensor: String,
    /// Images in HDF5 shards, of rgb, depth, segmentation, instance, semantic, normals, xyz, flow, scene_flow.
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = parse_modality)]
    #[arg(default_value = "rgb,depth,segmentation")]
    modalities: Vec<Modality>,
    /// Points of every fused cloud; 0 for none.
    #[arg(long, value_name = "N", default_value_t = CloudConfig::default().points)]
    cloud_points: usize,
    /// How the points are chosen.
    #[arg(long, value_enum, default_value_t)]
    cloud_sampling: Sampling,
    /// Frame of the points; `camera` is the rig's first.
    #[arg(long, value_enum, default_value_t)]
    cloud_frame: Frame,
    /// Only points in this box of that frame, metres: xmin,ymin,zmin,xmax,ymax,zmax.
    #[arg(long, value_name = "BOX", value_parser = parse_region, allow_hyphen_values = true)]
    cloud_region: Option<Region>,
    /// Only points within this distance of the handle, metres.
    #[arg(long, value_name = "METRES")]
    cloud_radius: Option<f64>,
    /// Points without colours.
    #[arg(long)]
    cloud_without_color: bool,
    /// Points with surface normals.
    #[arg(long)]
    cloud_normals: bool,
    /// Seed of sensors and mounting errors.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Which files hold the episodes.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    /// Positions in the trajectory file, such as `0,5-9`; all where absent.
    #[arg(long, value_name = "LIST")]
    episodes: Option<EpisodeList>,
    /// Which phases are rendered.
    #[arg(long, value_enum, default_value_t)]
    phases: Phases,
    /// What is shown: the plan, or what the robot did in physics (needs the audit of `akrobat replay`; failed episodes are left
    /// out).
    #[arg(long, value_enum, default_value_t)]
    states: States,
    #[command(flatten)]
    storage: StorageConfig,
    /// Continue what an interrupted run of the same command left.
    #[arg(long)]
    resume: bool,
    /// Start this many processes that share the work. A process that dies is replaced; the result is the same.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    workers: Option<u32>,
    /// Work on the same dataset as other processes of this command, which may come and go: each takes a
    /// shard at a time. They need a shared folder with file locks.
    #[arg(long, conflicts_with = "workers")]
    join: bool,
    /// Make these shards alone, such as `0,5-9`, and leave it to others to put them together with --join:
    /// for schedulers that decide themselves who makes what.
    #[arg(long, value_name = "LIST", conflicts_with_all = ["workers", "join"])]
    only_shards: Option<EpisodeList>,
    /// Render nothing; tell how many episodes, frames and shards there would be.
    #[arg(long)]
    dry_run: bool,
    /// Render nothing; write a script that makes the dataset as an array job of Slurm.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["workers", "join", "only_shards"])]
    slurm: Option<PathBuf>,
    /// Number of threads; one for each core where absent.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Folder where assets are looked up, as for `akrobat plan`; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Phases {
    /// Approach, grasp and manipulation.
    #[default]
    All,
    /// The manipulation alone.
    Manipulate,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Sampling {
    /// Each point is the one farthest from all before it.
    #[default]
    Farthest,
    /// One point per voxel.
    Voxel,
}

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum)]
enum Frame {
    /// The world.
    #[default]
    World,
    /// The robot's base link.
    Base,
    /// The rig's first camera.
    Camera,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Region([f64; 6]);

impl RenderArgs {
    fn cloud(&self) -> CloudConfig {
        CloudConfig {
            points: self.cloud_points,
            sampling: match self.cloud_sampling {
                Sampling::Farthest => CloudSampling::Farthest,
                Sampling::Voxel => CloudSampling::Voxel,
            },
            frame: match self.cloud_frame {
                Frame::World => CloudFrame::World,
                Frame::Base => CloudFrame::Base,
                Frame::Camera => CloudFrame::Camera,
            },
            region: self.cloud_region.map(|region| region.0),
            radius_m: self.cloud_radius,
            color: !self.cloud_without_color,
            normals: self.cloud_normals,
            ..CloudConfig::default()
        }
    }
}

/// Runs the verb.
pub fn run(args: &RenderArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = RenderRequest {
        trajectories: args.trajectories.clone(),
        output: args.output.clone(),
        assets: args.assets.clone(),
        backend: args.backend,
        rig: Some(args.rig.clone()),
        lighting: Some(args.lighting.clone()),
        variation: args.variation.clone(),
        variation_seed: args.variation_seed,
        appearance: args.appearance.clone(),
        supersampling: args.supersampling,
        detail: args.detail,
        sensor: Some(args.sensor.clone()),
        modalities: args.modalities.clone(),
        cloud: args.cloud(),
        seed: args.seed,
        format: args.format,
        filter: EpisodeFilter { episodes: args.episodes.clone(), ..EpisodeFilter::default() },
        manipulation_only: args.phases == Phases::Manipulate,
        states: args.states,
        storage: args.storage.clone(),
        resume: args.resume,
        threads: args.threads,
        sharing: match &args.only_shards {
            Some(list) => Sharing::Only(list.clone().into()),
            None if args.join => Sharing::Join,
            None => Sharing::Alone,
        },
    };
    if args.dry_run {
        return dry_run(&request, context);
    }
    if let Some(script) = &args.slurm {
        return write_slurm_script(script, &request, context);
    }
    if let Some(count) = args.workers {
        let parts = pipeline::dry_run(&request, context)?.shards as u64;
        let folder = JobFolder::of(&args.output);
        let done = || (0..parts as usize).filter(|&part| folder.part(part).is_dir()).count() as u64;
        let replaced = workers::run(count, args.threads, done, parts, context)?;
        // Whatever the workers have left is done here, and the last of it is to put the parts together.
        let request = RenderRequest { sharing: Sharing::Join, ..request };
        return Ok(shared_report(&pipeline::render(&request, context)?, Some(replaced)));
    }
    let report = pipeline::render(&request, context)?;
    if args.join {
        return Ok(shared_report(&report, None));
    }
    Ok(Report {
        text: text(&report),
        json: serde_json::to_value(&report).unwrap_or_default(),
        exit_code: exit_code(report.is_complete()),
    })
}

fn exit_code(complete: bool) -> ExitCode {
    if complete { ExitCode::Done } else { ExitCode::Incomplete }
}

fn dry_run(request: &RenderRequest, context: &Context<'_>) -> Result<Report, Error> {
    let counts = pipeline::dry_run(request, context)?;
    let text = format!(
        "{} episodes with {} frames in {} shards; {} left out, which the judge had refused",
        counts.episodes, counts.frames, counts.shards, counts.filtered
    );
    Ok(Report::done(text, serde_json::json!(counts)))
}

fn write_slurm_script(
    file: &Path,
    request: &RenderRequest,
    context: &Context<'_>,
) -> Result<Report, Error> {
    let parts = pipeline::dry_run(request, context)?.shards;
    let command = workers::own_command(&["--slurm", "--threads"])?;
    let script = slurm::script(&command, parts);
    std::fs::write(file, script).map_err(|e| Error::write(file, &e))?;
    let text = format!("{}: an array of {parts} tasks; submit it with sbatch", file.display());
    Ok(Report::done(text, serde_json::json!({ "script": file, "tasks": parts })))
}

/// What a dataset holds that several processes have made: what one of them did says little.
fn shared_report(report: &RenderReport, replaced: Option<u32>) -> Report {
    let mut counts = [0u64; 3];
    // Both containers hold the same episodes.
    let dataset = report.datasets.first().map(|folder| DatasetReader::open(folder));
    for entry in dataset.iter().flatten().flat_map(DatasetReader::entries) {
        counts[entry.status as usize] += 1;
    }
    let [episodes, filtered, quarantined] = counts;
    let folders: Vec<String> = report.datasets.iter().map(|d| d.display().to_string()).collect();
    let mut line = format!(
        "{}: {episodes} episodes in all, {} of them by this process; {filtered} refused by the judge, \
         {quarantined} given up",
        folders.join(", "),
        report.episodes
    );
    if let Some(replaced) = replaced.filter(|&count| count > 0) {
        line += &format!("; {replaced} workers died and were replaced");
    }
    let json = serde_json::json!({
        "datasets": report.datasets,
        "backend": report.backend,
        "episodes": episodes,
        "filtered": filtered,
        "quarantined": quarantined,
        "by_this_process": report.episodes,
        "workers_replaced": replaced,
        "seconds": report.seconds,
    });
    Report { text: line, json, exit_code: exit_code(filtered + quarantined == 0) }
}

fn text(report: &RenderReport) -> String {
    let folders: Vec<String> = report.datasets.iter().map(|d| d.display().to_string()).collect();
    let mut line = format!(
        "{}: {} episodes, {} frames, {} images by {} in {:.1} s",
        folders.join(", "),
        report.episodes,
        report.frames,
        report.images,
        report.backend,
        report.seconds
    );
    if report.resumed > 0 {
        line += &format!("; {} episodes were there already", report.resumed);
    }
    if report.filtered > 0 {
        line += &format!(
            "; {} left out, which the judge had refused or physics failed",
            report.filtered
        );
    }
    for reason in &report.quarantined {
        line += &format!("\n  unfit: {reason}");
    }
    line
}

/// Reads `rgb,depth`.
fn parse_modality(name: &str) -> Result<Modality, String> {
    Modality::from_name(name).ok_or_else(|| {
        let choices = Modality::ALL.map(Modality::name).join(", ");
        format!("unknown modality \"{name}\"; valid choices: {choices}")
    })
}

/// Reads `xmin,ymin,zmin,xmax,ymax,zmax`.
fn parse_region(text: &str) -> Result<Region, String> {
    let values: Result<Vec<f64>, _> = text.split(',').map(|v| v.trim().parse::<f64>()).collect();
    let region: Option<[f64; 6]> = values.ok().and_then(|values| values.try_into().ok());
    region.map(Region).ok_or_else(|| format!("expected six numbers in metres, got \"{text}\""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_are_six_numbers() {
        assert_eq!(parse_region("0, -1,0,1,1,2.5").unwrap().0, [0.0, -1.0, 0.0, 1.0, 1.0, 2.5]);
        for wrong in ["", "1,2,3", "a,b,c,d,e,f"] {
            assert!(parse_region(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn unknown_modalities_list_the_choices() {
        assert_eq!(parse_modality("scene_flow").unwrap(), Modality::SceneFlow);
        let message = parse_modality("rgbd").unwrap_err();
        assert!(message.contains("rgbd") && message.contains("normals"), "{message}");
    }
}
