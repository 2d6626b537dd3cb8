//! `akrobat bench plan`: trajectories per second on the frozen problem set.

use std::path::PathBuf;

use akrobat_planner::Optimiser;
use clap::{Args, ValueEnum};
use serde_json::json;

use crate::cli::Report;
use crate::pipeline::{self, Context, PlanBenchReport, PlanBenchRequest};
use crate::{Error, ExitCode};

/// Plan the frozen problem set and print judged trajectories per second.
///
/// Everything counts: loading, spheres, distance fields, grasps, inverse kinematics, clustering, optimisation,
/// approach, judging and writing. `valid_per_s` counts trajectories whose start differs by more than 10 cm in base position or
/// 0.2 rad in a joint from all that are counted before; `accepted_per_s` all that the judge accepts.
///
/// Examples:
///   akrobat bench plan --assets ASSETS             at most a minute
///   akrobat bench plan --assets ASSETS --limit 12 --seconds 600 --recipe curobo
///   akrobat bench plan --assets ASSETS --limit 400 --seconds 600 --threads 1 --json
///
/// The real robots and objects that the set names are looked up in `--assets`, `$AKROBAT_ASSET_PATH` and `../shared/assets`
/// beside the checkout; where they are not found, the built-in kitchen and robot are planned instead, which is another set.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct PlanBenchArgs {
    /// Problem set (TOML) instead of the frozen one.
    #[arg(long, value_name = "FILE")]
    problems: Option<PathBuf>,
    /// Trajectories wanted for each problem.
    #[arg(long, value_name = "N", default_value_t = 120)]
    limit: usize,
    /// Begin no further problem after this many seconds.
    #[arg(long, value_name = "S", default_value_t = 44.0)]
    seconds: f64,
    /// Number of threads; one for each core where absent.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Folder where assets are looked up; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
    /// How trajectories are optimised: `manifold`, as planning does, or `curobo`, cuRobo's recipe (12 seeds, 100 iterations
    /// of L-BFGS, 4 points in each line search, filter afterwards) with the same kernels, samples and judge.
    #[arg(long, value_enum, default_value_t)]
    recipe: Recipe,
    /// Keep the trajectory file of each problem in this folder.
    #[arg(long, value_name = "DIR")]
    keep: Option<PathBuf>,
}

/// How trajectories are optimised.
#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum Recipe {
    /// Gauss-Newton steps along the constraint.
    #[default]
    Manifold,
    /// Penalties, many seeds, a filter.
    Curobo,
}

impl From<Recipe> for Optimiser {
    fn from(recipe: Recipe) -> Self {
        match recipe {
            Recipe::Manifold => Self::Manifold,
            Recipe::Curobo => Self::Curobo,
        }
    }
}

/// Runs the verb.
pub fn run(args: &PlanBenchArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = PlanBenchRequest {
        problems: args.problems.clone(),
        limit: args.limit,
        seconds: args.seconds,
        threads: args.threads,
        assets: args.assets.clone(),
        optimiser: args.recipe.into(),
        keep: args.keep.clone(),
    };
    let report = pipeline::bench_plan(&request, context)?;
    let mut json = serde_json::to_value(&report).unwrap_or_default();
    for (key, value) in [
        ("valid_per_s", json!(report.valid_per_s())),
        ("accepted_per_s", json!(report.accepted_per_s())),
    ] {
        json[key] = value;
    }
    Ok(Report {
        text: text(&report),
        json,
        exit_code: if report.left_out.is_empty() { ExitCode::Done } else { ExitCode::Incomplete },
    })
}

fn text(report: &PlanBenchReport) -> String {
    let mut lines = vec![
        format!("problem set {} ({} threads)", report.problem_set, report.threads),
        format!(
            "{:26} {:18} {:>6} {:>8} {:>8} {:>8}  {:>6} {:>6}  mostly",
            "problem", "scene", "valid", "accepted", "seconds", "CPU s", "base m", "arm rad"
        ),
    ];
    for row in &report.problems {
        let slowest = row.stage_seconds.iter().max_by(|a, b| a.1.total_cmp(b.1));
        let slowest = slowest.map_or(String::new(), |(stage, s)| format!("{stage} {s:.1} s"));
        lines.push(format!(
            "{:26} {:18} {:>6} {:>8} {:>8.2} {:>8.2}  {:>6.2} {:>6.2}  {slowest}",
            row.task,
            row.scene,
            row.valid,
            row.accepted,
            row.seconds,
            row.cpu_seconds.unwrap_or(f64::NAN),
            row.base_travel_m,
            row.arm_rotation_rad
        ));
    }
    for (step, spread) in &report.step_ms {
        lines.push(format!(
            "{step:26} p50 {:.2} ms, p95 {:.2} ms, p99 {:.2} ms",
            spread.p50, spread.p95, spread.p99
        ));
    }
    if !report.left_out.is_empty() {
        lines.push(format!("left out for want of time: {}", report.left_out.join(", ")));
    }
    lines.push(format!(
        "{} valid of {} accepted in {:.1} s ({:.1} CPU s): {:.2} valid/s, {:.2} accepted/s",
        report.valid,
        report.accepted,
        report.seconds,
        report.cpu_seconds.unwrap_or(f64::NAN),
        report.valid_per_s(),
        report.accepted_per_s()
    ));
    lines.join("\n")
}
