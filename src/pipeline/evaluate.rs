//! Policy -> closed-loop trials -> table, videos, summary.

use std::path::PathBuf;

use akrobat_model::events::Event;
use serde::Serialize;

use super::Context;
use crate::Error;

/// Name of the progress stage.
const STAGE: &str = "trials";

/// Trials of a policy.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EvalJob {
    /// Task files that trials are drawn from.
    pub tasks: Vec<PathBuf>,
    /// Trajectory files whose starts count as seen; a scripted replay follows them.
    pub trajectories: Vec<PathBuf>,
    /// `replay`, `random`, `hold`, or what makes a policy: `module:attribute`.
    pub policy: String,
    /// Number of trials.
    pub trials: u32,
    /// Seed of starts, objects and goals.
    pub seed: u64,
    /// Where trials start: `seen`, `unseen` or `both`.
    pub split: String,
    /// A rig preset's name or a rig file; none where the policy takes the state alone.
    pub rig: Option<String>,
    /// Points of the cloud that the policy sees; 0 for none.
    pub cloud_points: u32,
    /// Videos of the first successes and failures, of each as many.
    pub videos: u32,
    /// Folder to write: empty or new.
    pub output: PathBuf,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
}

/// Runs the trials and returns the summary.
///
/// # Errors
/// Where inputs or the policy are wrong, no host can do physics, the output cannot be written, or the
/// user asked to stop.
pub fn evaluate(job: &EvalJob, context: &Context<'_>) -> Result<serde_json::Value, Error> {
    let started = std::time::Instant::now();
    let host = context.host.ok_or_else(|| {
        Error::Usage(
            "trials need the Python package: pip install 'akrobat[physics]', \
             then the same command with its `akrobat`"
                .into(),
        )
    })?;
    // Says at once which folder is missing.
    context.asset_search(&job.assets)?;
    let observer = context.observer;
    let total = Some(u64::from(job.trials));
    observer.event(&Event::StageStarted { stage: STAGE, total });
    let mut done = 0;
    let summary = host.evaluate(job, &mut |_| {
        done += 1;
        observer.event(&Event::Progress { stage: STAGE, done });
        !observer.cancelled()
    })?;
    if observer.cancelled() {
        let output = job.output.display();
        return Err(Error::Interrupted(format!("{output} holds no summary")));
    }
    let seconds = started.elapsed().as_secs_f64();
    observer.event(&Event::StageFinished { stage: STAGE, seconds });
    Ok(summary)
}
