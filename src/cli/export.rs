//! `akrobat export` and `akrobat card`: datasets for trainers and tools, and what they are in words.

use std::path::PathBuf;

use akrobat_packager::export::{ExportConfig, ExportFormat};
use clap::Args;
use serde_json::json;

use super::Report;
use crate::Error;
use crate::pipeline::EpisodeList;
use crate::pipeline::{self, Context, ExportRequest};

/// Write a dataset in the layout that a trainer or tool reads.
///
/// Examples:
///   akrobat export dataset --to lerobot -o lerobot_dataset        LeRobotDataset v3.0, with depth and clouds
///   akrobat export dataset --to dp3 -o dp3 --points 1024          clouds, states and actions for DP3
///   akrobat export dataset --to robomimic -o demos                one HDF5 file with masks
///   akrobat export dataset --to act -o act --base local --jpeg    base actions in the base's own frame
///   akrobat export dataset --to dp3 -o dp3 --gripper opening      11 columns instead of 12
///   akrobat export drawer.h5 --to joint-trajectory -o ros2        trajectories alone, for a real robot
///
/// The output says of itself which colour order, depth unit, quaternion order and frames it has, and has a
/// dataset card (README.md). RLDS: export to LeRobot, whose own tools convert it.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct ExportArgs {
    /// Dataset folder, as `akrobat render` writes it with HDF5 shards; or a trajectory file (formats automoma
    /// and joint-trajectory).
    input: PathBuf,
    /// The format.
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: ExportFormat,
    /// Folder to write: new or empty.
    #[arg(long, short)]
    output: PathBuf,
    #[command(flatten)]
    config: ExportConfig,
    /// Positions among the stored episodes, such as `0,5-9`; all where absent.
    #[arg(long, value_name = "LIST")]
    episodes: Option<EpisodeList>,
    /// Export although the licence of an asset forbids commercial use.
    #[arg(long)]
    allow_non_commercial: bool,
    /// Folder where assets are looked up, as for `akrobat plan`; may be repeated. Only trajectory files need it.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &ExportArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = ExportRequest {
        input: args.input.clone(),
        format: args.to,
        output: args.output.clone(),
        config: args.config.clone(),
        episodes: args.episodes.clone().map(Vec::from),
        allow_non_commercial: args.allow_non_commercial,
        assets: args.assets.clone(),
    };
    let report = pipeline::export(&request, context)?;
    let mut text = format!(
        "{}: {} episodes, {} frames as {}, {:.1} MB in {:.1} s",
        report.output.display(),
        report.episodes,
        report.frames,
        report.format,
        report.bytes as f64 / 1e6,
        report.seconds
    );
    for (what, names) in [("action", &report.action_names), ("state", &report.state_names)] {
        if !names.is_empty() {
            text += &format!("\n  {what:<7} {:>3}  {}", names.len(), names.join(", "));
        }
    }
    Ok(Report::done(text, serde_json::to_value(&report).unwrap_or_default()))
}

/// Write the card of a dataset: README.md with contents, statistics, pictures, provenance and licences.
///
/// Examples:
///   akrobat card dataset        dataset/README.md and dataset/card/, ready for the Hugging Face hub
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct CardArgs {
    /// Dataset folder, as `akrobat render` writes it with HDF5 shards.
    dataset: PathBuf,
}

/// Runs the verb.
pub fn run_card(args: &CardArgs, context: &Context<'_>) -> Result<Report, Error> {
    let (file, pictures) = pipeline::card(&args.dataset, context)?;
    let text = format!("{}: written, with {pictures} pictures", file.display());
    Ok(Report::done(text, json!({ "file": file, "pictures": pictures })))
}
