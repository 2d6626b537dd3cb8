//! `akrobat inspect`: what is in a file.

mod dataset;
mod production;
mod rig;

use std::path::{Path, PathBuf};

use akrobat_model::{Trajectory, TrajectorySet, Verdict};
use akrobat_packager::trajectory_file;
use clap::Args;
use serde_json::{Value, json};

use super::Report;
use crate::Error;
use crate::pipeline::{
    self, BackendChoice, Context, ProductionRequest, ReportRequest, SurveyRequest,
};
use crate::report::ReportOptions;

/// Tell what is in a trajectory file or a dataset, and show it.
///
/// Examples:
///   akrobat inspect drawer.h5                  counts, goals, worst values the judge found
///   akrobat inspect drawer.h5 --json           the same, and every trajectory, for machines
///   akrobat inspect drawer.h5 --report look/   a page with pictures and plots: look/report.html
///   akrobat inspect dataset                    arrays, sizes, compression, ranges of the joints
///   akrobat inspect dataset --report look/     the same as a page: look/dataset.html
///   akrobat inspect trajectories --report look/    a production: yields, heat maps of bases: look/production.html
///   akrobat inspect --rig my_rig.toml          the cameras of a rig
///   akrobat inspect --rig ring drawer.h5       where they are and what each sees of a trajectory
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct InspectArgs {
    /// Trajectory file, as `akrobat plan` writes it, folder of such files, as `akrobat produce` does, or dataset folder.
    #[arg(required_unless_present = "rig")]
    file: Option<PathBuf>,
    /// Folder where a page is written, with animated pictures and models of some trajectories.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Trajectories with pictures, spread over the file.
    #[arg(long, value_name = "N", requires = "report", default_value_t = ReportOptions::default().shown)]
    show: usize,
    /// A rig, a preset's name or a file: tell where its cameras are and what each sees. Pictures of the report
    /// are taken with it (with `paper` where absent).
    #[arg(long, value_name = "NAME|FILE")]
    rig: Option<String>,
    /// The trajectory that the rig's cameras look at: its position in the file.
    #[arg(long, value_name = "N", requires = "rig", default_value_t = 0)]
    episode: usize,
    /// Which renderer draws the pictures.
    #[arg(long, value_enum, default_value_t)]
    backend: BackendChoice,
    /// Folder where assets are looked up, besides the task's own; may be repeated. Then come the folders
    /// in $AKROBAT_ASSET_PATH (separated by colons).
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &InspectArgs, context: &Context<'_>) -> Result<Report, Error> {
    if let Some(folder) = args.file.as_deref().filter(|file| file.is_dir()) {
        if args.rig.is_some() && !pipeline::is_production(folder) {
            let folder = folder.display();
            let message = format!("{folder}: --rig needs a trajectory file, got a dataset");
            return Err(Error::Usage(message));
        }
        if pipeline::is_production(folder) {
            let (text, json) = production::inspect(
                &production_request(args, folder),
                args.report.as_deref(),
                context,
            )?;
            return Ok(Report::done(text, json));
        }
        let (text, json) = dataset::inspect(folder, args.report.as_deref())?;
        return Ok(Report::done(text, json));
    }
    let (mut text, mut json) = match &args.file {
        Some(file) => {
            let set = trajectory_file::read(file)?;
            (text(file, &set), json(&set))
        }
        None => (String::new(), json!({})),
    };
    if let Some(rig) = &args.rig {
        let survey = pipeline::survey(&survey_request(args, rig), context)?;
        text += if text.is_empty() { "" } else { "\n" };
        text += &rig::text(&survey);
        json["rig"] = serde_json::to_value(&survey).unwrap_or_default();
    }
    if let (Some(file), Some(folder)) = (&args.file, &args.report) {
        let files = pipeline::report(&report_request(args, file, folder), context)?;
        text += &format!("\n  page    {}", files[0].display());
        json["report"] = json!(files);
    }
    Ok(Report::done(text, json))
}

fn production_request(args: &InspectArgs, folder: &Path) -> ProductionRequest {
    ProductionRequest {
        folder: folder.to_path_buf(),
        pictures: if args.report.is_some() { args.show } else { 0 },
        rig: args.rig.clone(),
        backend: args.backend,
        assets: args.assets.clone(),
    }
}

fn survey_request(args: &InspectArgs, rig: &str) -> SurveyRequest {
    SurveyRequest {
        rig: rig.to_owned(),
        trajectories: args.file.clone(),
        episode: args.episode,
        assets: args.assets.clone(),
        backend: args.backend,
    }
}

fn report_request(args: &InspectArgs, file: &Path, folder: &Path) -> ReportRequest {
    ReportRequest {
        trajectories: file.to_path_buf(),
        output: folder.to_path_buf(),
        assets: args.assets.clone(),
        backend: args.backend,
        rig: args.rig.clone(),
        options: ReportOptions { shown: args.show, ..ReportOptions::default() },
        run: None,
    }
}

fn text(file: &Path, set: &TrajectorySet) -> String {
    let header = &set.header;
    let trajectories = &set.trajectories;
    let mut lines = vec![
        format!(
            "{}: {} trajectories of task \"{}\"",
            file.display(),
            trajectories.len(),
            header.task_name
        ),
        format!("  robot   {} ({:?} base)", header.robot_id, header.base_kind).to_lowercase(),
        format!("  object  {}, driven joint \"{}\"", header.object_id, header.active_joint),
        format!("  scene   {}", header.scene_id),
        format!("  seed    {}, planned on {}", header.seed, header.backend),
    ];
    for ([start, goal], count) in count_by(trajectories, |t| [t.start, t.goal].map(round_to_mil)) {
        lines.push(format!("  goal    {start} -> {goal}: {count} trajectories"));
    }
    let grasps = count_by(trajectories, |t| t.grasp.id).len();
    lines.push(format!("  grasps  {grasps}"));
    if let Some([shortest, longest]) = range(trajectories.iter().map(|t| t.dense.duration_s())) {
        lines.push(format!("  length  {shortest:.2} to {longest:.2} s"));
    }
    lines.extend(verdict_lines(trajectories));
    lines.extend(header.counts.iter().map(|(what, count)| format!("  {count:>8}  {what}")));
    lines.join("\n")
}

fn verdict_lines(trajectories: &[Trajectory]) -> Vec<String> {
    let verdicts: Vec<&Verdict> = trajectories.iter().filter_map(|t| t.verdict.as_ref()).collect();
    let accepted = verdicts.iter().filter(|v| v.accepted()).count();
    let worst = |of: fn(&Verdict) -> f64| verdicts.iter().map(|v| of(v)).fold(0.0, f64::max);
    let mut lines = vec![format!("  judge   {accepted} accepted, {} judged", verdicts.len())];
    if !verdicts.is_empty() {
        lines.push(format!(
            "  worst   anchor {:.3} mm, {:.5} rad; speed {:.0} %, acceleration {:.0} % of the limit; penetration {:.2} mm",
            worst(|v| v.anchor_translation_m) * 1e3,
            worst(|v| v.anchor_rotation_rad),
            worst(|v| v.velocity_fraction) * 1e2,
            worst(|v| v.acceleration_fraction) * 1e2,
            worst(|v| v.penetration_m) * 1e3,
        ));
    }
    lines
}

fn json(set: &TrajectorySet) -> Value {
    let trajectory = |t: &Trajectory| {
        json!({
            "id": t.id,
            "seed": t.seed,
            "grasp": t.grasp.id,
            "start": t.start,
            "goal": t.goal,
            "waypoints": t.waypoints_robot.rows(),
            "dense_samples": t.dense.len(),
            "duration_s": t.dense.duration_s(),
            "verdict": t.verdict,
        })
    };
    json!({
        "format": trajectory_file::FORMAT,
        "header": set.header,
        "trajectories": set.trajectories.iter().map(trajectory).collect::<Vec<_>>(),
    })
}

/// How often each key occurs, in the order of first appearance.
fn count_by<K: PartialEq>(
    trajectories: &[Trajectory],
    key: impl Fn(&Trajectory) -> K,
) -> Vec<(K, usize)> {
    let mut counts: Vec<(K, usize)> = Vec::new();
    for trajectory in trajectories {
        let key = key(trajectory);
        match counts.iter_mut().find(|(known, _)| *known == key) {
            Some((_, count)) => *count += 1,
            None => counts.push((key, 1)),
        }
    }
    counts
}

fn range(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    values.fold(None, |range, value| {
        let [low, high] = range.unwrap_or([value; 2]);
        Some([low.min(value), high.max(value)])
    })
}

fn round_to_mil(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
