//! Trajectory file -> verdicts of the judge, on the task's own files.

use std::path::PathBuf;

use akrobat_judge::{Judge, JudgeConfig, RobotSphere};
use akrobat_model::Verdict;
use akrobat_planner::Preparation;
use rayon::prelude::*;

use super::Context;
use super::planned::planned_task;
use crate::Error;

/// What to judge.
#[derive(Debug, Clone)]
pub struct JudgeRequest {
    /// Trajectory file.
    pub trajectories: PathBuf,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
}

/// A trajectory's identity and what the judge says about it now.
#[derive(Debug, Clone)]
pub struct Judged {
    /// Identity in the file.
    pub id: String,
    /// The new verdict; the one in the file is not looked at.
    pub verdict: Verdict,
}

/// Judges every trajectory of a file again.
///
/// # Errors
/// Where the file cannot be read, or robot, object or scene are absent or have changed.
pub fn judge(request: &JudgeRequest, context: &Context<'_>) -> Result<Vec<Judged>, Error> {
    let search = context.asset_search(&request.assets)?;
    let (set, task) = planned_task(&request.trajectories, &search)?;
    let preparation = Preparation::new(&task)?;
    let spheres: Vec<RobotSphere> = preparation
        .spheres
        .spheres
        .iter()
        .map(|s| RobotSphere { link: s.link, center: s.center, radius: s.radius })
        .collect();
    let judge = Judge::new(&task, &spheres, &preparation.exceptions, JudgeConfig::default())?;
    let judged = set
        .trajectories
        .par_iter()
        .map(|trajectory| Judged { id: trajectory.id.clone(), verdict: judge.judge(trajectory) });
    Ok(judged.collect())
}
