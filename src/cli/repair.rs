//! `akrobat repair`: a dataset's index from its shards.

use std::path::PathBuf;

use akrobat_packager::dataset::repair;
use clap::Args;
use serde_json::json;

use super::Report;
use crate::pipeline::Context;
use crate::{Error, ExitCode};

/// Rebuild dataset.json and manifest.jsonl from the shards that are whole.
///
/// Examples:
///   akrobat repair dataset
///   akrobat repair dataset --json       what was recovered and what is lost
///
/// Shards that are not whole are moved to DATASET/damaged. To go on with an interrupted run, use
/// `akrobat render --resume` instead: it loses nothing. Exit code 3 where something is lost.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct RepairArgs {
    /// Dataset folder.
    dataset: PathBuf,
}

/// Runs the verb.
pub fn run(args: &RepairArgs, context: &Context<'_>) -> Result<Report, Error> {
    let repaired = repair::repair(&args.dataset, context.observer)?;
    let mut lines = vec![format!(
        "{}: {} episodes, {} of them recovered, {} losses",
        args.dataset.display(),
        repaired.episodes,
        repaired.recovered,
        repaired.lost.len()
    )];
    lines.extend(repaired.lost.iter().map(|p| format!("  {}: {}", p.place, p.message)));
    let exit_code = if repaired.lost.is_empty() { ExitCode::Done } else { ExitCode::Incomplete };
    Ok(Report { text: lines.join("\n"), json: json!(repaired), exit_code })
}
