//! `akrobat filter`: a subset of a dataset.

use std::path::PathBuf;

use akrobat_packager::dataset::select::{self, Selection};
use clap::{Args, ValueEnum};
use serde_json::json;

use super::Report;
use crate::Error;

/// Copy the episodes of a dataset that fit into a new one.
///
/// Examples:
///   akrobat filter dataset -o ovens --object oven_1001           one object
///   akrobat filter dataset -o train --split train                what `akrobat split` dealt to training
///   akrobat filter dataset -o small --count 800 --maximise unique-start
///
/// Options add up: an episode is taken where all of them fit. Images are copied as they are stored.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct FilterArgs {
    /// Dataset folder.
    dataset: PathBuf,
    /// Folder of the new dataset: empty or new.
    #[arg(long, short)]
    output: PathBuf,
    /// Objects, separated by commas.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    object: Vec<String>,
    /// Scenes, separated by commas.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    scene: Vec<String>,
    /// Robots, separated by commas.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    robot: Vec<String>,
    /// Parts that `akrobat split` dealt: train, valid, test, test_seen.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    split: Vec<String>,
    /// Only episodes that succeeded (true) or failed (false).
    #[arg(long, value_name = "BOOL")]
    success: Option<bool>,
    /// At most this many episodes.
    #[arg(long, value_name = "N")]
    count: Option<usize>,
    /// What the choice of --count episodes is to have as much of as possible; the first where absent.
    #[arg(long, value_enum, requires = "count")]
    maximise: Option<Maximise>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Maximise {
    /// Different joint positions at the start.
    UniqueStart,
}

/// Runs the verb.
pub fn run(args: &FilterArgs) -> Result<Report, Error> {
    let selection = Selection {
        objects: args.object.clone(),
        scenes: args.scene.clone(),
        robots: args.robot.clone(),
        splits: args.split.clone(),
        success: args.success,
        count: args.count,
        maximise_unique_starts: args.maximise == Some(Maximise::UniqueStart),
    };
    let taken = select::filter(&args.dataset, &args.output, &selection)?;
    let text = format!(
        "{}: {} of {} episodes, with {} of {} start states",
        args.output.display(),
        taken.episodes,
        taken.of,
        taken.unique_starts,
        taken.unique_starts_available
    );
    Ok(Report::done(text, json!(taken)))
}
