//! `akrobat plan`: task file -> trajectory file.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use super::Report;
use crate::pipeline::{self, Context, PlanReport, PlanRequest};
use crate::{Error, ExitCode};

/// Plan trajectories for a task and write those that the independent judge accepts.
///
/// Examples:
///   akrobat plan drawer.toml -o drawer.h5                    up to 100 trajectories
///   akrobat plan drawer.toml -o drawer.h5 --limit 10         ten of them
///   akrobat plan drawer.toml -o drawer.h5 --assets ~/models  where meshes and URDFs are
///
/// The same task and seed give the same bytes, whatever the number of threads. Schema of task files:
/// `akrobat schema task`.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct PlanArgs {
    /// Task file (TOML).
    task: PathBuf,
    /// Trajectory file to write (HDF5).
    #[arg(long, short)]
    output: PathBuf,
    /// Stop once this many trajectories are accepted; instead of the task's own limit.
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
    /// Seed of everything random; instead of the task's own.
    #[arg(long)]
    seed: Option<u64>,
    /// Number of threads; one for each core where absent.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Folder where assets are looked up, besides the task's own; may be repeated. Then come the folders
    /// in $AKROBAT_ASSET_PATH (separated by colons).
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &PlanArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = PlanRequest {
        task: args.task.clone(),
        output: Some(args.output.clone()),
        assets: args.assets.clone(),
        seed: args.seed,
        limit: args.limit,
        threads: args.threads,
    };
    let report = pipeline::plan(&request, context)?;
    let accepted = report.set.trajectories.len();
    Ok(Report {
        text: text(args, &report),
        json: json!({
            "output": (accepted > 0).then_some(&args.output),
            "accepted": accepted,
            "counts": report.counts,
            "stage_seconds": report.stage_seconds,
            "sphere_fits": report.sphere_fits,
            "notes": report.notes,
        }),
        exit_code: if accepted > 0 { ExitCode::Done } else { ExitCode::Incomplete },
    })
}

fn text(args: &PlanArgs, report: &PlanReport) -> String {
    let accepted = report.set.trajectories.len();
    let mut lines = vec![match accepted {
        0 => format!("no trajectory was accepted; {} is not written", args.output.display()),
        _ => format!("{}: {accepted} accepted trajectories", args.output.display()),
    }];
    lines.push("counts".into());
    lines.extend(report.counts.iter().map(|(what, count)| format!("  {count:>9}  {what}")));
    lines.push("seconds".into());
    lines.extend(seconds(&report.stage_seconds));
    if accepted == 0 {
        lines.push("notes".into());
        lines.extend(report.notes.iter().map(|note| format!("  {note}")));
    }
    lines.join("\n")
}

fn seconds(stages: &BTreeMap<String, f64>) -> impl Iterator<Item = String> + '_ {
    stages.iter().map(|(stage, seconds)| format!("  {seconds:>9.2}  {stage}"))
}
