//! `akrobat replay`: trajectory file -> physics -> audit.

use std::path::PathBuf;

use clap::Args;

use super::Report;
use crate::pipeline::{self, Context, EpisodeList, PhysicsConfig, ReplayReport, ReplayRequest};
use crate::{Error, ExitCode};

/// Drive trajectories through physics and audit what happens.
///
/// The robot's joints follow the plan by position drives with limited effort, the gripper closes by force, and nothing but
/// contact moves the object. The audit (NAME.audit.h5 beside NAME.h5) holds traces, findings, and success or the reason of failure:
/// success is 80% of a door's angle or 90% of a drawer's travel within 10 s, with the gripper within 0.1 m of the handle at the
/// end.
///
/// Examples:
///   akrobat replay drawer.h5                              all trajectories
///   akrobat replay drawer.h5 --episodes 0-9 --page a.html with plots
///   akrobat replay drawer.h5 --gains stiff.toml           other gains, friction, speed (`akrobat schema physics`)
///   akrobat render drawer.h5 -o data --states simulated   then renders what the robot really did
///
/// Exit code 0 where at least one episode succeeds, 3 where none does.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct ReplayArgs {
    /// Trajectory file, as `akrobat plan` writes it.
    trajectories: PathBuf,
    /// Audit file to write; NAME.audit.h5 beside the trajectory file where absent.
    #[arg(long, short)]
    output: Option<PathBuf>,
    /// Page with plots of every episode to write (HTML).
    #[arg(long, value_name = "FILE")]
    page: Option<PathBuf>,
    /// Positions in the trajectory file, such as `0,5-9`; all where absent.
    #[arg(long, value_name = "LIST")]
    episodes: Option<EpisodeList>,
    /// Controller gains and contact properties (TOML).
    #[arg(long, value_name = "FILE")]
    gains: Option<PathBuf>,
    /// Number of processes. The result does not depend on it.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..))]
    workers: u16,
    /// Folder where assets are looked up, as for `akrobat plan`; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &ReplayArgs, context: &Context<'_>) -> Result<Report, Error> {
    let config = args.gains.as_deref().map_or(Ok(PhysicsConfig::default()), PhysicsConfig::load)?;
    let request = ReplayRequest {
        trajectories: args.trajectories.clone(),
        output: args.output.clone(),
        page: args.page.clone(),
        assets: args.assets.clone(),
        episodes: args.episodes.clone().map(Vec::from),
        config,
        workers: usize::from(args.workers),
    };
    let report = pipeline::replay(&request, context)?;
    Ok(Report {
        text: text(&report),
        json: serde_json::to_value(&report).unwrap_or_default(),
        exit_code: if report.succeeded > 0 { ExitCode::Done } else { ExitCode::Incomplete },
    })
}

fn text(report: &ReplayReport) -> String {
    let mut line = format!(
        "{}: {} of {} episodes succeed ({} cleanly) in {:.1} s",
        report.output.display(),
        report.succeeded,
        report.episodes,
        report.clean,
        report.seconds
    );
    let reasons: Vec<String> =
        report.reasons.iter().map(|(reason, count)| format!("{count} {reason}")).collect();
    if !reasons.is_empty() {
        line += &format!("; failed: {}", reasons.join(", "));
    }
    line
}
