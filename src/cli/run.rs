//! `akrobat run`: a whole re-rendering job from one file.

use std::path::PathBuf;

use clap::Args;

use super::Report;
use crate::pipeline::{
    self, Context, EpisodeFilter, EpisodeList, RunOutput, RunReport, RunRequest,
};
use crate::{Error, ExitCode};

/// Render trajectory files with every combination of some rigs, lightings and sensors.
///
/// Each combination becomes a dataset, OUTPUT/TRAJECTORIES/RIG-LIGHTING-SENSOR. Run again, a job goes on where it was
/// interrupted and leaves alone what is there.
///
/// Examples:
///   akrobat run relight.toml --dry-run          frames, bytes and time to expect
///   akrobat run relight.toml                    all of it
///   akrobat run relight.toml --episodes 0,5-9   some of the trajectories
///   akrobat run looks.toml --sample 200         some of a production: trajectories = ["trajectories"]
///   akrobat schema job                          what a job file may say
///
/// A job file:
///   name = "relight"
///   trajectories = ["drawer.h5", "door.h5"]
///   output = "relit"
///   filter = { success = true }
///   render = { modalities = ["rgb", "depth"], cloud = { points = 1024 } }
///   variants = { rigs = ["paper", "ring"], sensors = ["ideal", "kinect"] }
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct RunArgs {
    /// Job file (TOML).
    job: PathBuf,
    /// Folder of the datasets, instead of the job's.
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Tell what would be rendered, how large it will be and how long it will take; write nothing.
    #[arg(long)]
    dry_run: bool,
    /// Positions in the trajectory files, such as `0,5-9`.
    #[arg(long, value_name = "LIST")]
    episodes: Option<EpisodeList>,
    /// Only trajectories of this object; may be repeated.
    #[arg(long, value_name = "NAME")]
    object: Vec<String>,
    /// Only trajectories in this scene; may be repeated.
    #[arg(long, value_name = "NAME")]
    scene: Vec<String>,
    /// Only trajectories that the judge accepted (true), or only the others (false).
    #[arg(long, value_name = "BOOL")]
    success: Option<bool>,
    /// Only this many of them, drawn from all files together; instead of the job's.
    #[arg(long, value_name = "N")]
    sample: Option<usize>,
    /// Number of threads; one for each core where absent.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Folder where assets are looked up, before those of the job; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &RunArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = RunRequest {
        job: args.job.clone(),
        output: args.output.clone(),
        assets: args.assets.clone(),
        filter: EpisodeFilter {
            episodes: args.episodes.clone(),
            objects: args.object.clone(),
            scenes: args.scene.clone(),
            success: args.success,
        },
        sample: args.sample,
        dry_run: args.dry_run,
        threads: args.threads,
    };
    let report = pipeline::run(&request, context)?;
    Ok(Report {
        text: text(&report),
        json: serde_json::to_value(&report).unwrap_or_default(),
        exit_code: if report.is_complete() { ExitCode::Done } else { ExitCode::Incomplete },
    })
}

fn text(report: &RunReport) -> String {
    let mut lines: Vec<String> = report.outputs.iter().map(line).collect();
    let sum = |of: fn(&RunOutput) -> f64| report.outputs.iter().map(of).sum::<f64>();
    let (datasets, frames) = (report.outputs.len(), sum(|o| o.frames as f64));
    lines.push(if report.dry_run {
        format!(
            "{}: {datasets} datasets, {frames} frames, about {} and {:.0} s; nothing was written",
            report.name,
            bytes(sum(|o| o.expected_bytes.unwrap_or(0) as f64)),
            sum(|o| o.expected_seconds.unwrap_or(0.0))
        )
    } else {
        let episodes = sum(|o| o.report.as_ref().map_or(0.0, |r| r.episodes as f64));
        let per_hour = episodes * 3600.0 / report.seconds.max(1e-9);
        format!(
            "{}: {datasets} datasets in {:.1} s; {episodes} episodes rendered, {per_hour:.0} an hour",
            report.name, report.seconds
        )
    });
    lines.join("\n")
}

fn line(output: &RunOutput) -> String {
    let folder = output.output.display();
    let wanted = format!("{folder}: {} episodes, {} frames", output.episodes, output.frames);
    match (&output.report, output.expected_bytes, output.expected_seconds) {
        (Some(report), ..) => format!(
            "{wanted}; {} rendered in {:.1} s, {} were there already, {} refused by the judge, {} unfit",
            report.episodes,
            report.seconds,
            report.resumed,
            report.filtered,
            report.quarantined.len()
        ),
        (None, Some(size), Some(seconds)) => {
            format!("{wanted}, about {} and {seconds:.0} s", bytes(size as f64))
        }
        _ => wanted,
    }
}

/// A size for people.
fn bytes(count: f64) -> String {
    match count {
        c if c >= 1e9 => format!("{:.1} GB", c / 1e9),
        c => format!("{:.1} MB", c / 1e6),
    }
}
