//! `akrobat eval`: closed-loop trials of a policy.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::Report;
use crate::Error;
use crate::pipeline::{self, Context, EvalJob};

/// Try a policy in closed loop, in physics, and write what came of it.
///
/// Writes trials.csv (one row per trial), summary.json, summary.svg and, with --videos, recordings of successes and failures. A trial
/// succeeds where, within 300 steps of 1/30 s, the joint reaches 80% (doors) or 90% (drawers) of its goal and the gripper is within
/// 0.1 m of the handle at the end.
///
/// Examples:
///   akrobat eval drawer.toml --trajectories drawer.h5 --policy replay -o out    what the plan itself scores
///   akrobat eval drawer.toml --policy random -o out                             what chance scores
///   akrobat eval drawer.toml --policy my_policy:make --rig paper -o out         your own: make(env) -> action(observation)
///   akrobat eval drawer.toml --policy policy_50 --trajectories drawer.h5 -o out  what `python -m akrobat.policy train` wrote
///   akrobat eval drawer.toml --policy lerobot:FOLDER --rig paper -o out         a checkpoint of LeRobot (ACT, Diffusion Policy)
///   akrobat eval drawer.toml --policy dp3:my_policy:make --rig paper --cloud-points 1024 -o out
///                                                                               a policy with the interface of DP3
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct EvalArgs {
    /// Task files (TOML); trials take turns.
    #[arg(required = true)]
    tasks: Vec<PathBuf>,
    /// `replay`, `random`, `hold`; `module:attribute`, which is called with the environment and returns a function from observation to
    /// action; the folder of a policy that was trained here, whose cameras and cloud are then the default; `lerobot:FOLDER`, a
    /// checkpoint of LeRobot; `dp3:module:attribute`, which returns a policy with the interface of DP3.
    #[arg(long)]
    policy: String,
    /// Folder to write: empty or new.
    #[arg(long, short)]
    output: PathBuf,
    /// Trajectory file of one of the tasks, whose starts are the seen ones; may be repeated.
    #[arg(long, value_name = "FILE")]
    trajectories: Vec<PathBuf>,
    /// Number of trials.
    #[arg(long, value_name = "N", default_value_t = 50, value_parser = clap::value_parser!(u32).range(1..))]
    trials: u32,
    /// Where trials start: as in the trajectory files, drawn anew, or in turns. Without trajectory files: drawn anew.
    #[arg(long, value_enum)]
    split: Option<Split>,
    /// Seed of starts, objects and goals.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Cameras that the policy sees through: the name of a preset or a rig file.
    #[arg(long, value_name = "PRESET|FILE")]
    rig: Option<String>,
    /// Points of the cloud that the policy sees; needs --rig.
    #[arg(long, value_name = "N", default_value_t = 0)]
    cloud_points: u32,
    /// Videos of the first successes and failures, of each as many.
    #[arg(long, value_name = "N", default_value_t = 0)]
    videos: u32,
    /// Folder where assets are looked up, as for `akrobat plan`; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Split {
    /// Starts of the trajectory files.
    Seen,
    /// Starts drawn anew.
    Unseen,
    /// In turns.
    Both,
}

/// Runs the verb.
pub fn run(args: &EvalArgs, context: &Context<'_>) -> Result<Report, Error> {
    let planned = !args.trajectories.is_empty();
    let split = args.split.unwrap_or(if planned { Split::Seen } else { Split::Unseen });
    if !planned && split != Split::Unseen {
        return Err(Error::Usage("--split: seen starts need --trajectories".into()));
    }
    if args.cloud_points > 0 && args.rig.is_none() {
        return Err(Error::Usage("--cloud-points: a cloud needs cameras: --rig".into()));
    }
    let job = EvalJob {
        tasks: args.tasks.clone(),
        trajectories: args.trajectories.clone(),
        policy: args.policy.clone(),
        trials: args.trials,
        seed: args.seed,
        split: match split {
            Split::Seen => "seen",
            Split::Unseen => "unseen",
            Split::Both => "both",
        }
        .into(),
        rig: args.rig.clone(),
        cloud_points: args.cloud_points,
        videos: args.videos,
        output: args.output.clone(),
        assets: args.assets.clone(),
    };
    let summary = pipeline::evaluate(&job, context)?;
    let number = |name: &str| summary.get(name).and_then(serde_json::Value::as_f64).unwrap_or(0.0);
    let text = format!(
        "{}: {} of {} trials succeed ({:.0}%)",
        args.output.display(),
        number("succeeded"),
        number("trials"),
        100.0 * number("success_rate")
    );
    Ok(Report::done(text, summary))
}
