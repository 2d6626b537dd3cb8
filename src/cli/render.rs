//! `akrobat render`: trajectory file -> dataset.

use std::path::PathBuf;

use akrobat_cameras::Modality;
use akrobat_renderer::Supersampling;
use akrobat_renderer::pointcloud::{CloudConfig, CloudFrame, CloudSampling};
use clap::{Args, ValueEnum};

use super::Report;
use crate::pipeline::{
    self, BackendChoice, Context, EpisodeFilter, EpisodeList, Format, RenderReport, RenderRequest,
    States,
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
    /// Episodes in one HDF5 shard. What is interrupted loses at most the shard that was being written.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    episodes_per_shard: Option<u32>,
    /// Continue what an interrupted run of the same command left.
    #[arg(long)]
    resume: bool,
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
        sensor: Some(args.sensor.clone()),
        modalities: args.modalities.clone(),
        cloud: args.cloud(),
        seed: args.seed,
        format: args.format,
        filter: EpisodeFilter { episodes: args.episodes.clone(), ..EpisodeFilter::default() },
        manipulation_only: args.phases == Phases::Manipulate,
        states: args.states,
        episodes_per_shard: args.episodes_per_shard,
        resume: args.resume,
        threads: args.threads,
    };
    let report = pipeline::render(&request, context)?;
    Ok(Report {
        text: text(&report),
        json: serde_json::to_value(&report).unwrap_or_default(),
        exit_code: if report.is_complete() { ExitCode::Done } else { ExitCode::Incomplete },
    })
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
