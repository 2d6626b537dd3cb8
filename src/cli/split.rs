//! `akrobat split`: deals episodes to training and evaluation.

use std::path::PathBuf;

use akrobat_packager::dataset::split::{self, SplitBy, SplitConfig};
use clap::Args;
use serde_json::json;

use super::Report;
use crate::Error;

/// Deal the episodes of a dataset to train, valid and test, and note it in the manifest.
///
/// Examples:
///   akrobat split dataset                          80, 10, 10 %; unseen start states in valid and test
///   akrobat split dataset --by scene               unseen scenes in valid and test
///   akrobat split dataset --seen 0.1               test_seen: of start states that are trained on
///   akrobat filter dataset -o train --split train  a dataset of one part
///
/// The same seed deals the same episodes alike, whatever their order.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct SplitArgs {
    /// Dataset folder.
    dataset: PathBuf,
    /// What is kept together in one part.
    #[arg(long, value_enum, default_value_t)]
    by: SplitBy,
    /// Fraction of the episodes for training.
    #[arg(long, value_name = "FRACTION", default_value_t = 0.8)]
    train: f64,
    /// Fraction of the episodes for choosing between models.
    #[arg(long, value_name = "FRACTION", default_value_t = 0.1)]
    valid: f64,
    /// Fraction of the episodes for evaluation.
    #[arg(long, value_name = "FRACTION", default_value_t = 0.1)]
    test: f64,
    /// Fraction of the episodes that is taken from training for evaluation on seen start states.
    #[arg(long, value_name = "FRACTION", default_value_t = 0.0)]
    seen: f64,
    /// Seed of the dealing.
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
}

/// Runs the verb.
pub fn run(args: &SplitArgs) -> Result<Report, Error> {
    let config = SplitConfig {
        by: args.by,
        fractions: [args.train, args.valid, args.test],
        seen: args.seen,
        seed: args.seed,
    };
    let counts = split::split(&args.dataset, &config)?;
    let parts: Vec<String> = counts.iter().map(|(part, count)| format!("{part} {count}")).collect();
    let text = format!("{}: {}", args.dataset.display(), parts.join(", "));
    Ok(Report::done(text, json!({ "episodes": counts })))
}
