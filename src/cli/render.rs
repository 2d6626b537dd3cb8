//! `akrobat render`: trajectory file -> dataset.

use std::path::PathBuf;

use akrobat_renderer::Supersampling;
use clap::{Args, ValueEnum};

use super::Report;
use crate::pipeline::{self, BackendChoice, Context, Format, RenderReport, RenderRequest, States};
use crate::{Error, ExitCode};

/// Replay trajectories, render what cameras see, and write a dataset.
///
/// Examples:
///   akrobat render drawer.h5 -o dataset                      three RGB-D cameras, HDF5 shards
///   akrobat render drawer.h5 -o dataset --episodes 0,5-9     some of the trajectories
///   akrobat render drawer.h5 -o dataset --rig my_rig.toml    other cameras (`akrobat schema rig`)
///   akrobat render drawer.h5 -o dataset --lighting studio    other light, with shadows
///   akrobat render drawer.h5 -o dataset --variation wild     another look for every episode
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
    /// Which files hold the episodes.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
    /// Positions in the trajectory file, such as `0,5-9`; all where absent.
    #[arg(long, value_name = "LIST", value_parser = parse_episodes)]
    episodes: Option<Episodes>,
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

/// Positions in a trajectory file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Episodes(pub Vec<usize>);

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
        format: args.format,
        episodes: args.episodes.clone().map(|Episodes(list)| list),
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
        exit_code: if report.filtered == 0 { ExitCode::Done } else { ExitCode::Incomplete },
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
    line
}

/// Reads `0,5-9` as 0, 5, 6, 7, 8, 9.
pub fn parse_episodes(text: &str) -> Result<Episodes, String> {
    let number = |text: &str| {
        text.trim()
            .parse::<usize>()
            .map_err(|_| format!("expected numbers and ranges such as 0,5-9, got \"{text}\""))
    };
    let mut episodes = Vec::new();
    for item in text.split(',') {
        let (first, last) = item.split_once('-').unwrap_or((item, item));
        let (first, last) = (number(first)?, number(last)?);
        if first > last {
            return Err(format!("the range {item} is empty: its end comes first"));
        }
        episodes.extend(first..=last);
    }
    episodes.sort_unstable();
    episodes.dedup();
    Ok(Episodes(episodes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn episode_lists_are_sorted_sets() {
        assert_eq!(parse_episodes("7, 0,5-7").unwrap().0, [0, 5, 6, 7]);
        for wrong in ["", "a", "1-", "3-1", "-2"] {
            assert!(parse_episodes(wrong).is_err(), "{wrong}");
        }
    }
}
