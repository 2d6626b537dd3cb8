//! `akrobat validate`: whether a file or dataset is whole.

use std::path::{Path, PathBuf};

use akrobat_packager::{dataset, trajectory_file};
use clap::Args;
use serde_json::json;

use super::Report;
use crate::{Error, ExitCode};

/// Read a trajectory file or a dataset completely and report what is wrong with it.
///
/// Examples:
///   akrobat validate drawer.h5
///   akrobat validate dataset --json
///
/// Exit code 0 where nothing is wrong, 3 where a dataset has problems, 2 where it cannot be read at all.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct ValidateArgs {
    /// Trajectory file or dataset folder.
    path: PathBuf,
}

/// Runs the verb.
pub fn run(args: &ValidateArgs) -> Result<Report, Error> {
    if args.path.is_dir() {
        validate_dataset(&args.path)
    } else {
        validate_trajectories(&args.path)
    }
}

fn validate_trajectories(path: &Path) -> Result<Report, Error> {
    let set = trajectory_file::read(path)?;
    let count = set.trajectories.len();
    let text = format!("{}: whole, {count} trajectories", path.display());
    Ok(Report::done(text, json!({ "trajectories": count, "problems": [] })))
}

fn validate_dataset(folder: &Path) -> Result<Report, Error> {
    let found = dataset::validate(folder)?;
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
