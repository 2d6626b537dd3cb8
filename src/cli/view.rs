//! `akrobat view`: a trajectory or an episode in three dimensions.

use std::path::PathBuf;

use clap::Args;

use super::Report;
use crate::Error;
use crate::pipeline::{self, Context, ViewRequest};

/// Look at a trajectory or at an episode of a dataset with Rerun.
///
/// Examples:
///   akrobat view drawer.h5                          robot, object and scene in motion, and their joints
///   akrobat view dataset --episode 3                the same, with cameras, images, depth and cloud
///   akrobat view dataset --save episode.rrd         into a file: `rerun episode.rrd`, or https://app.rerun.io
///   akrobat view dataset --every 5 --save small.rrd     one image of five
///
/// Needs `pip install 'akrobat[viewer]'`. Textures are shown as their mean colours, and surfaces thinned. An
/// episode whose robot and object files are not found is shown without them.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct ViewArgs {
    /// Trajectory file, or dataset folder, as `akrobat render` writes it with HDF5 shards.
    input: PathBuf,
    /// Position among the trajectories, or among the stored episodes.
    #[arg(long, value_name = "N", default_value_t = 0)]
    episode: usize,
    /// Write a file for Rerun instead of opening a window.
    #[arg(long, value_name = "FILE.rrd")]
    save: Option<PathBuf>,
    /// Show one of N images and clouds.
    #[arg(long, value_name = "N", default_value_t = 1)]
    every: usize,
    /// Folder where assets are looked up, as for `akrobat plan`; may be repeated. Of a dataset, name the folder of the
    /// task's file, too.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &ViewArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = ViewRequest {
        input: args.input.clone(),
        episode: args.episode,
        save: args.save.clone(),
        every: args.every,
        assets: args.assets.clone(),
    };
    let report = pipeline::view(&request, context)?;
    let place = match &report.file {
        Some(file) => format!("{}: written", file.display()),
        None => format!("{}: shown in a window", args.input.display()),
    };
    let (bodies, frames) = (report.bodies, report.frames);
    let mut text = format!("{place}, {bodies} bodies, {frames} instants");
    if !report.cameras.is_empty() {
        text += &format!(", cameras {}", report.cameras.join(", "));
    }
    Ok(Report::done(text, serde_json::to_value(&report).unwrap_or_default()))
}
