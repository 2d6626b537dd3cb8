//! `akrobat validate`: whether a file or dataset is whole.

use std::path::{Path, PathBuf};

use akrobat_packager::{dataset, trajectory_file};
use clap::Args;
use serde_json::json;

use super::Report;
use crate::pipeline::{self, Context, JudgeRequest};
use crate::{Error, ExitCode};

/// Read a trajectory file or a dataset completely and report what is wrong with it.
///
/// Examples:
///   akrobat validate drawer.h5
///   akrobat validate drawer.h5 --judge       judge every trajectory again, on the task's files
///   akrobat validate dataset --json
///
/// Of a dataset, every byte is read: checksums, numbers of frames, values in range, black images, gaps in
/// time, NaN, clouds, and images in MCAP logs. Exit code 0 where nothing is wrong, 3 where a dataset has
/// problems or a trajectory is refused, 2 where it cannot be read at all.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct ValidateArgs {
    /// Trajectory file or dataset folder.
    path: PathBuf,
    /// Judge the trajectories again, whatever the file says about them.
    #[arg(long)]
    judge: bool,
    /// Folder where assets are looked up for --judge, as for `akrobat plan`; may be repeated.
    #[arg(long, value_name = "DIR", requires = "judge")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &ValidateArgs, context: &Context<'_>) -> Result<Report, Error> {
    match (args.path.is_dir(), args.judge) {
        (true, true) => Err(Error::Usage(format!(
            "{}: --judge expected a trajectory file, got a dataset",
            args.path.display()
        ))),
        (true, false) => validate_dataset(&args.path, context),
        (false, true) => judge_trajectories(args, context),
        (false, false) => validate_trajectories(&args.path),
    }
}

fn judge_trajectories(args: &ValidateArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = JudgeRequest { trajectories: args.path.clone(), assets: args.assets.clone() };
    let judged = pipeline::judge(&request, context)?;
    let refused: Vec<_> = judged.iter().filter(|j| !j.verdict.accepted()).collect();
    let (count, good) = (judged.len(), judged.len() - refused.len());
    let mut lines = vec![format!("{}: {good} of {count} trajectories pass", args.path.display())];
    lines.extend(refused.iter().map(|j| {
        let reason = j.verdict.rejection.map_or("", |r| r.name());
        format!("  {}: {reason}: {}", j.id, j.verdict.detail)
    }));
    let exit_code = if refused.is_empty() { ExitCode::Done } else { ExitCode::Incomplete };
    let verdicts: Vec<_> =
        judged.iter().map(|j| json!({ "id": j.id, "verdict": j.verdict })).collect();
    let json = json!({ "trajectories": count, "accepted": good, "verdicts": verdicts });
    Ok(Report { text: lines.join("\n"), json, exit_code })
}

fn validate_trajectories(path: &Path) -> Result<Report, Error> {
    let set = trajectory_file::validate(path)?;
    let count = set.trajectories.len();
    let text = format!("{}: whole, {count} trajectories", path.display());
    Ok(Report::done(text, json!({ "trajectories": count, "problems": [] })))
}

fn validate_dataset(folder: &Path, context: &Context<'_>) -> Result<Report, Error> {
    let found = dataset::validate(folder, context.observer)?;
    let mut lines = vec![format!(
        "{}: {} episodes, {} frames, {:.1} MB, {} problems",
        folder.display(),
        found.episodes,
        found.frames,
        found.bytes as f64 / 1e6,
        found.problems.len()
    )];
    lines.extend(found.problems.iter().map(|p| format!("  {}: {}", p.place, p.message)));
    let exit_code = if found.problems.is_empty() { ExitCode::Done } else { ExitCode::Incomplete };
    Ok(Report { text: lines.join("\n"), json: json!(found), exit_code })
}
