//! `akrobat produce`: plans in many generated scenes.

use std::path::PathBuf;

use clap::Args;

use super::Report;
use crate::pipeline::{self, Context, ProduceReport, ProduceRequest};
use crate::{Error, ExitCode};

/// Plan trajectories for every object of many generated scenes, by every robot, and tell the yield.
///
/// One trajectory file for each scene, object and robot. Run again, a job goes on where it was stopped: tasks
/// that were planned are not planned again; those that could not be loaded are. Exit code 3 where the time budget left some.
///
/// Examples:
///   akrobat generate scene --count 20 --density open..confined -o scenes
///   akrobat produce production.toml                      all of it
///   akrobat produce production.toml --time-budget 3600   what an hour allows; then once more
///   akrobat produce production.toml --scenes 20          a small one first
///
/// A job file:
///   name = "kitchens"
///   scenes = ["scenes", "variants"]
///   output = "trajectories"
///   classes = ["microwave", "drawer_unit", "refrigerator"]
///   objects_per_class = 1
///   limit = 10
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct ProduceArgs {
    /// Job file (TOML).
    job: PathBuf,
    /// Folder of the trajectory files, instead of the job's.
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Number of scenes of each folder, spread over it, instead of the job's.
    #[arg(long, value_name = "N")]
    scenes: Option<usize>,
    /// Objects of each class, scene and robot, instead of the job's.
    #[arg(long, value_name = "N")]
    objects_per_class: Option<usize>,
    /// Begin no task after this many seconds.
    #[arg(long, value_name = "S")]
    time_budget: Option<f64>,
    /// Number of threads; one for each core where absent.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Folder where assets are looked up, as for `akrobat plan`; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &ProduceArgs, context: &Context<'_>) -> Result<Report, Error> {
    if let Some(budget) = args.time_budget.filter(|s| !(s.is_finite() && *s >= 0.0)) {
        return Err(Error::Usage(format!("--time-budget: expected seconds, got {budget}")));
    }
    let request = ProduceRequest {
        job: args.job.clone(),
        output: args.output.clone(),
        scene_count: args.scenes,
        objects_per_class: args.objects_per_class,
        time_budget_s: args.time_budget,
        assets: args.assets.clone(),
        threads: args.threads,
    };
    let report = pipeline::produce(&request, context)?;
    let whole = report.is_complete() && report.yields.total.accepted > 0;
    Ok(Report {
        text: text(&report),
        json: serde_json::to_value(&report).unwrap_or_default(),
        exit_code: if whole { ExitCode::Done } else { ExitCode::Incomplete },
    })
}

fn text(report: &ProduceReport) -> String {
    let mut lines = vec![format!(
        "{}: {} tasks planned, {} planned before, {} left; in {}",
        report.name,
        report.planned,
        report.resumed,
        report.left,
        report.output.display()
    )];
    lines.extend(report.yields.table());
    lines.extend(report.yields.reasons_table());
    lines.join("\n")
}
