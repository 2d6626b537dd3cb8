//! `akrobat plan`: task file -> trajectory file.

use std::collections::BTreeMap;
use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use akrobat_planner::plan::Explanation;

use super::Report;
use crate::pipeline::{self, Context, PlanBackend, PlanReport, PlanRequest};
use crate::{Error, ExitCode};

/// Plan trajectories for a task and write those that the independent judge accepts.
///
/// Examples:
///   akrobat plan drawer.toml -o drawer.h5                    up to 100 trajectories
///   akrobat plan drawer.toml -o drawer.h5 --limit 10         ten of them
///   akrobat plan drawer.toml -o drawer.h5 --assets ~/models  where meshes and URDFs are
///   akrobat plan drawer.toml -o drawer.h5 --explain          why there are none, or few
///   akrobat plan drawer.toml -o drawer.h5 --backend wgpu     inverse kinematics and optimisation on the GPU
///
/// The same task and seed give the same bytes, whatever the number of threads, as long as the backend (and with wgpu the
/// adapter) is the same. Schema of task files: `akrobat schema task`.
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
    /// Say what stops each stage: which grasps fit, what is out of reach or collides with what, how far the
    /// joint can be followed, and which constraint is closest to being met.
    #[arg(long)]
    explain: bool,
    /// Where inverse kinematics and trajectory optimisation of doors, drawers and planar objects are computed. `auto` never
    /// takes a software Vulkan driver, which is slower than the CPU's own kernels; `wgpu` does.
    #[arg(long, value_enum, default_value_t)]
    backend: PlanBackend,
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
        explain: args.explain,
        backend: args.backend,
        optimiser: None,
    };
    let report = pipeline::plan(&request, context)?;
    let accepted = report.set.trajectories.len();
    Ok(Report {
        text: text(args, &report),
        json: json!({
            "output": (accepted > 0).then_some(&args.output),
            "accepted": accepted,
            "backend": report.backend,
            "counts": report.counts,
            "stage_seconds": report.stage_seconds,
            "sphere_fits": report.sphere_fits,
            "notes": report.notes,
            "explanation": report.explanation,
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
    lines.push(format!("backend: {}", report.backend));
    lines.push("counts".into());
    lines.extend(report.counts.iter().map(|(what, count)| format!("  {count:>9}  {what}")));
    lines.push("seconds".into());
    lines.extend(seconds(&report.stage_seconds));
    if let Some(explanation) = &report.explanation {
        lines.extend(explained(explanation));
    }
    if accepted == 0 {
        lines.push("notes".into());
        lines.extend(report.notes.iter().map(|note| format!("  {note}")));
    }
    lines.join("\n")
}

/// An explanation, for people.
fn explained(explanation: &Explanation) -> Vec<String> {
    let grasps = &explanation.grasps;
    let mut lines = vec![
        "explanation".into(),
        format!("  grasps: {} of {} candidates fit", grasps.fitting, grasps.candidates),
    ];
    lines.extend(grasps.misfits.iter().map(|(what, count)| format!("  {count:>9}  {what}")));
    for at in &explanation.reach {
        lines.push(format!(
            "  joint at {:.3}: {} of {} seeds reach the grasp, {} of them are free",
            at.position, at.reached, at.seeds, at.free
        ));
        if let Some([distance, angle]) = at.closest_miss {
            let miss = format!("{:.0} mm and {angle:.2} rad", 1e3 * distance);
            let joints: Vec<String> =
                at.at_limit.iter().map(|(joint, count)| format!("{joint} ({count})")).collect();
            let joints = if joints.is_empty() { "none".into() } else { joints.join(", ") };
            lines.push(format!("             closest miss: {miss}; joints at limits: {joints}"));
        }
        lines.extend(at.blocked_by.iter().take(8).map(|b| {
            let lack = 1e3 * b.least_m;
            format!(
                "  {:>9}  \"{}\" too close to {}, by {lack:.1} mm or more",
                b.count, b.link, b.obstacle
            )
        }));
    }
    for way in &explanation.ways {
        let farthest = way.farthest.map_or("nowhere".into(), |q| format!("to {q:.3}"));
        lines.push(format!(
            "  way to {:.3}: {} starts followed, at most {farthest}; stopped by",
            way.goal, way.followed
        ));
        lines.extend(way.stopped_by.iter().map(|(what, count)| format!("  {count:>9}  {what}")));
    }
    lines.push("  closest to feasible".into());
    match &explanation.closest[..] {
        [] => lines.push("             every position of the joint is reached somehow".into()),
        closest => {
            lines.extend(closest.iter().map(|v| format!("             {}: {}", v.stage, v.text)));
        }
    }
    lines
}

fn seconds(stages: &BTreeMap<String, f64>) -> impl Iterator<Item = String> + '_ {
    stages.iter().map(|(stage, seconds)| format!("  {seconds:>9.2}  {stage}"))
}
