//! `akrobat demo`: everything once, on built-in inputs.

use std::path::PathBuf;

use clap::Args;

use super::Report;
use crate::Error;
use crate::pipeline::{self, BackendChoice, Context, DemoReport, DemoRequest, DemoRobotChoice};

/// Do everything once on built-in inputs: generate a kitchen, plan, render, package, and leave a page to
/// look at.
///
/// Examples:
///   akrobat demo                         microwave, cabinet and drawer; open akrobat-demo/index.html
///   akrobat demo -o tour --limit 50      more trajectories for each task
///   akrobat demo --robot pillar          the built-in robot, which needs nothing installed
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct DemoArgs {
    /// Folder to write: empty or new.
    #[arg(long, short, default_value = "akrobat-demo")]
    output: PathBuf,
    /// Who acts.
    #[arg(long, value_enum, default_value_t)]
    robot: DemoRobotChoice,
    /// Trajectories planned for each task.
    #[arg(long, value_name = "N", default_value_t = 12)]
    limit: usize,
    /// Episodes rendered for each task.
    #[arg(long, value_name = "N", default_value_t = 1)]
    episodes: usize,
    /// Seed of the kitchen and of the plans.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Which renderer draws.
    #[arg(long, value_enum, default_value_t)]
    backend: BackendChoice,
    /// Folder where assets are looked up, as for `akrobat plan`; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &DemoArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = DemoRequest {
        output: args.output.clone(),
        robot: args.robot,
        limit: args.limit,
        episodes: args.episodes,
        seed: args.seed,
        backend: args.backend,
        assets: args.assets.clone(),
    };
    let report = pipeline::demo(&request, context)?;
    Ok(Report::done(text(&report), serde_json::to_value(&report).unwrap_or_default()))
}

fn text(report: &DemoReport) -> String {
    let mut lines: Vec<String> = report
        .tasks
        .iter()
        .map(|task| {
            format!(
                "{}: {} trajectories accepted in {:.1} s, {} images by {} in {:.1} s",
                task.name,
                task.accepted,
                task.plan_seconds,
                task.rendered.images,
                task.rendered.backend,
                task.rendered.seconds
            )
        })
        .collect();
    lines.push(format!("open {}", report.page.display()));
    lines.join("\n")
}
