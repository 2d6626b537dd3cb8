//! `akrobat merge`: several datasets into one.

use std::path::PathBuf;

use akrobat_packager::dataset::select;
use clap::Args;
use serde_json::json;

use super::Report;
use crate::Error;

/// Copy all episodes of several datasets into a new one.
///
/// Examples:
///   akrobat merge monday tuesday -o week
///   akrobat merge monday again -o week --skip-duplicates      episodes of both are taken once
///
/// The datasets must have the same rig, the same kind of files and the same encodings of colour and depth.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct MergeArgs {
    /// Dataset folders, in the order of the new dataset.
    #[arg(required = true)]
    datasets: Vec<PathBuf>,
    /// Folder of the new dataset: empty or new.
    #[arg(long, short)]
    output: PathBuf,
    /// Take episodes that several datasets have from the first.
    #[arg(long)]
    skip_duplicates: bool,
}

/// Runs the verb.
pub fn run(args: &MergeArgs) -> Result<Report, Error> {
    let merged = select::merge(&args.datasets, &args.output, args.skip_duplicates)?;
    let mut text = format!("{}: {} episodes", args.output.display(), merged.episodes);
    if merged.duplicates > 0 {
        text += &format!("; {} lines were there already", merged.duplicates);
    }
    Ok(Report::done(text, json!(merged)))
}
