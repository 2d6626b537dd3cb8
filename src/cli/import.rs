//! `akrobat import`: what other tools made, as files of ours.

mod assets;
mod robot;

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::Report;
use crate::pipeline::{self, Context, ImportRequest};
use crate::{Error, ExitCode};

/// Take over what other tools made.
#[derive(Debug, Args)]
pub struct ImportArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Trajectories(TrajectoriesArgs),
    Robot(robot::RobotArgs),
    #[command(name = "partnet")]
    PartNet(assets::PartNetArgs),
    Infinigen(assets::InfinigenArgs),
    Mjcf(assets::MjcfArgs),
    Urdf(assets::UrdfArgs),
    Sdf(assets::SdfArgs),
    Usd(assets::UsdArgs),
    #[command(name = "procthor")]
    ProcThor(assets::ProcThorArgs),
    Grasps(assets::GraspsArgs),
}

/// Turn recordings into a trajectory file, to render them with any cameras.
///
/// Reads AutoMoMa's traj_data.pt and recorder HDF5, ManiSkill's trajectory.h5, and exports of ours in these
/// formats. Robot columns must be in the order base x, y, yaw, arm, fingers, as `akrobat inspect` names them.
///
/// Examples:
///   akrobat import trajectories traj_data.pt --task task.toml -o drawer.h5
///   akrobat import trajectories recording.hdf5 --task task.toml -o drawer.h5 --judge
///   akrobat render drawer.h5 -o dataset --rig my_rig.toml
///
/// Exit code 3 where motions were left out: failures, and those in which the object never moves.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
struct TrajectoriesArgs {
    /// The recording.
    input: PathBuf,
    /// Task file: robot, object, where it stands, and the joint that is driven.
    #[arg(long)]
    task: PathBuf,
    /// Trajectory file to write.
    #[arg(long, short)]
    output: PathBuf,
    /// Seconds between rows; 1/30 for recordings and 119/870 for traj_data.pt where absent.
    #[arg(long, value_name = "SECONDS")]
    interval: Option<f64>,
    /// Factor of the object's positions: -1 where the recorder counts the other way round.
    #[arg(long, value_name = "1|-1", default_value_t = 1.0, allow_negative_numbers = true)]
    object_sign: f64,
    /// Keep motions that the recorder did not call a success.
    #[arg(long)]
    keep_failures: bool,
    /// Judge the motions as planned ones are; what is refused is not rendered.
    #[arg(long)]
    judge: bool,
    /// Number of threads; one for each core where absent.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
    /// Folder where assets are looked up, as for `akrobat plan`; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// Runs the verb.
pub fn run(args: &ImportArgs, context: &Context<'_>) -> Result<Report, Error> {
    match &args.what {
        What::Trajectories(args) => trajectories(args, context),
        What::Robot(args) => robot::run(args, context),
        What::PartNet(args) => assets::run_partnet(args, context),
        What::Infinigen(args) => assets::run_infinigen(args, context),
        What::Mjcf(args) => assets::run_mjcf(args, context),
        What::Urdf(args) => assets::run_urdf(args, context),
        What::Sdf(args) => assets::run_sdf(args, context),
        What::Usd(args) => assets::run_usd(args, context),
        What::ProcThor(args) => assets::run_procthor(args, context),
        What::Grasps(args) => assets::run_grasps(args),
    }
}

fn trajectories(args: &TrajectoriesArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = ImportRequest {
        input: args.input.clone(),
        task: args.task.clone(),
        output: args.output.clone(),
        interval_s: args.interval,
        object_sign: args.object_sign,
        keep_failures: args.keep_failures,
        judge: args.judge,
        assets: args.assets.clone(),
        threads: args.threads,
    };
    let report = pipeline::import(&request, context)?;
    let lost = !report.skipped.is_empty();
    Ok(Report {
        text: report.text(),
        json: serde_json::to_value(&report).unwrap_or_default(),
        exit_code: if lost { ExitCode::Incomplete } else { ExitCode::Done },
    })
}
