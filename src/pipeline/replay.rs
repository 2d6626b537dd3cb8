//! Trajectory file -> physics -> audit file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use akrobat_model::events::Event;
use akrobat_model::{ModelError, hash};
use akrobat_packager::audit_file::{self, AuditFile, EpisodeAudit};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Context, check_writable, planned_task};
use crate::Error;
use crate::report::audit_page;

/// Name of the progress stage.
const STAGE: &str = "physics";

/// Gains of one joint's drive, `effort = clamp(stiffness * (target - q) + damping * (target speed - speed))`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct JointGains {
    /// N m/rad or N/m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// N m s/rad or N s/m.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping: Option<f64>,
    /// N m or N.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub effort_limit: Option<f64>,
}

/// How trajectories are driven through physics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PhysicsConfig {
    /// Time step, seconds.
    pub timestep_s: f64,
    /// Time steps between two samples of the audit.
    pub audit_interval_steps: u32,
    /// Factor on all planned times: 2 drives at half the speed.
    pub time_stretch: f64,
    /// Pause after the fingers have closed, in which they press, seconds.
    pub squeeze_s: f64,
    /// Pause at the end, before success is measured, seconds.
    pub settle_s: f64,
    /// Error (rad, m) at which a joint's drive asks for the joint's whole effort, which gives its stiffness.
    pub saturation_error: f64,
    /// A drive's damping in terms of its stiffness, seconds.
    pub damping_time_s: f64,
    /// Gains of single joints, by name, instead of those that follow from the above.
    pub joint_gains: BTreeMap<String, JointGains>,
    /// Force of each finger, N; the URDF's effort limit where absent.
    pub grip_force_n: Option<f64>,
    /// Friction coefficient between the fingers and anything.
    pub pad_friction: f64,
    /// Friction coefficient between everything else.
    pub surface_friction: f64,
    /// Object joints whose stated friction and damping need more than this force at the handle, when it is moved at 0.25 m/s
    /// or 0.5 rad/s, are calibrated instead: the smallest friction that keeps the joint still. N.
    pub handle_force_limit_n: f64,
    /// Least dry friction of calibrated joints, as a force at the handle, N.
    pub handle_force_floor_n: f64,
    /// The robot stops for good where it is told to move faster than a joint's speed limit by more than 5%, as arms'
    /// own controllers do. Otherwise the limits only hold the joints back.
    pub protective_stop: bool,
    /// A trial: the fingers never close.
    pub keep_gripper_open: bool,
    /// A trial: the object stands this far from where it was planned, metres.
    pub object_offset_m: [f64; 3],
}

impl Default for PhysicsConfig {
    fn default() -> Self {
        Self {
            timestep_s: 1.0 / 240.0,
            audit_interval_steps: 4,
            time_stretch: 1.0,
            squeeze_s: 0.3,
            settle_s: 0.3,
            saturation_error: 0.01,
            damping_time_s: 0.04,
            joint_gains: BTreeMap::new(),
            grip_force_n: None,
            pad_friction: 1.0,
            surface_friction: 0.5,
            handle_force_limit_n: 80.0,
            handle_force_floor_n: 1.0,
            protective_stop: true,
            keep_gripper_open: false,
            object_offset_m: [0.0; 3],
        }
    }
}

impl PhysicsConfig {
    /// Reads a TOML file.
    ///
    /// # Errors
    /// Where it cannot be read, has unknown keys or impossible values.
    pub fn load(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|e| ModelError::read(path, e))?;
        let config: Self = toml::from_str(&text)
            .map_err(|e| ModelError::invalid(path, e.to_string().trim_end()))?;
        config.check().map_err(|message| ModelError::invalid(path, message))?;
        Ok(config)
    }

    /// Checks that every value is possible.
    ///
    /// # Errors
    /// The whole message.
    pub fn check(&self) -> Result<(), String> {
        let ranges = [
            ("timestep_s", self.timestep_s, 1e-4, 0.02),
            ("time_stretch", self.time_stretch, 0.01, 100.0),
            ("squeeze_s", self.squeeze_s, 0.0, 10.0),
            ("settle_s", self.settle_s, 0.0, 10.0),
            ("saturation_error", self.saturation_error, 1e-5, 1.0),
            ("damping_time_s", self.damping_time_s, 0.0, 10.0),
            ("grip_force_n", self.grip_force_n.unwrap_or(1.0), 0.0, 1e4),
            ("pad_friction", self.pad_friction, 0.0, 10.0),
            ("surface_friction", self.surface_friction, 0.0, 2.0 * self.pad_friction),
            ("handle_force_limit_n", self.handle_force_limit_n, 0.0, 1e6),
            ("handle_force_floor_n", self.handle_force_floor_n, 0.0, 1e4),
            ("audit_interval_steps", f64::from(self.audit_interval_steps), 1.0, 1000.0),
        ];
        for (name, value, least, most) in ranges {
            if !(least..=most).contains(&value) {
                return Err(format!(
                    "{name}: expected a number from {least} to {most}, got {value}"
                ));
            }
        }
        if let Some(offset) = self.object_offset_m.iter().find(|v| v.is_nan() || v.abs() > 100.0) {
            return Err(format!("object_offset_m: expected metres up to 100, got {offset}"));
        }
        Ok(())
    }
}

/// What is to be replayed.
#[derive(Debug, Clone)]
pub struct ReplayRequest {
    /// Trajectory file.
    pub trajectories: PathBuf,
    /// Audit file to write; `NAME.audit.h5` beside the trajectory file where absent.
    pub output: Option<PathBuf>,
    /// Page with plots to write.
    pub page: Option<PathBuf>,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// Positions in the trajectory file; all where absent.
    pub episodes: Option<Vec<usize>>,
    /// Settings.
    pub config: PhysicsConfig,
    /// Number of processes.
    pub workers: usize,
}

/// What a host is asked to drive through physics.
#[derive(Debug, Clone)]
pub struct ReplayJob<'a> {
    /// Trajectory file.
    pub trajectories: &'a Path,
    /// Folders where assets are looked up.
    pub assets: &'a [PathBuf],
    /// Positions in the trajectory file.
    pub episodes: &'a [usize],
    /// Settings.
    pub config: &'a PhysicsConfig,
    /// Number of processes.
    pub workers: usize,
}

/// What a replay gave.
#[derive(Debug, Clone, Serialize)]
pub struct ReplayReport {
    /// The audit file.
    pub output: PathBuf,
    /// The page, where one was asked for.
    pub page: Option<PathBuf>,
    /// Episodes driven.
    pub episodes: usize,
    /// Episodes that succeeded.
    pub succeeded: usize,
    /// Those of them in which nothing but the fingers touched anything, and they held throughout.
    pub clean: usize,
    /// Failures by reason.
    pub reasons: BTreeMap<String, usize>,
    /// Findings by episode.
    pub findings: Vec<serde_json::Value>,
    /// Gains, resistance of the object's joints, error of the collision shapes.
    pub world: serde_json::Value,
    /// Wall time, seconds.
    pub seconds: f64,
}

/// Where the audit of a trajectory file stands unless another place is said.
pub fn audit_path(trajectories: &Path) -> PathBuf {
    trajectories.with_extension("audit.h5")
}

/// Drives trajectories through physics and writes what came of it.
///
/// # Errors
/// Where the trajectories, the settings or the assets are wrong, no host can do physics, the output cannot be written, or the
/// user asked to stop; nothing is written then.
pub fn replay(request: &ReplayRequest, context: &Context<'_>) -> Result<ReplayReport, Error> {
    let started = std::time::Instant::now();
    let host = context.host.ok_or_else(|| {
        Error::Usage(
            "physics needs the Python package: pip install 'akrobat[physics]', \
             then the same command with its `akrobat`"
                .into(),
        )
    })?;
    request.config.check().map_err(Error::Usage)?;
    let output = request.output.clone().unwrap_or_else(|| audit_path(&request.trajectories));
    check_writable(&output)?;
    let search = context.asset_search(&request.assets)?;
    let (set, _) = planned_task(&request.trajectories, &search)?;
    let path = &request.trajectories;
    let episodes = super::selection(path, request.episodes.as_deref(), set.trajectories.len())?;
    let job = ReplayJob {
        trajectories: path,
        assets: &request.assets,
        episodes: &episodes,
        config: &request.config,
        workers: request.workers.max(1),
    };
    let observer = context.observer;
    observer.event(&Event::StageStarted { stage: STAGE, total: Some(episodes.len() as u64) });
    let mut audits: Vec<EpisodeAudit> = Vec::with_capacity(episodes.len());
    let world = host.replay(&job, &mut |audit| {
        audits.push(audit);
        observer.event(&Event::Progress { stage: STAGE, done: audits.len() as u64 });
        !observer.cancelled()
    })?;
    if observer.cancelled() {
        return Err(Error::Interrupted("nothing was written".into()));
    }
    audits.sort_by_key(|audit| audit.episode);
    let audit = AuditFile {
        trajectories_sha256: hash::of_file(path)?,
        config: serde_json::to_value(&request.config).unwrap_or_default(),
        world,
        episodes: audits,
    };
    audit_file::write(&output, &audit)?;
    if let Some(page) = &request.page {
        audit_page::write(page, &set.header, &audit)?;
    }
    let seconds = started.elapsed().as_secs_f64();
    observer.event(&Event::StageFinished { stage: STAGE, seconds });
    Ok(report(output, request.page.clone(), audit, seconds))
}

fn report(output: PathBuf, page: Option<PathBuf>, audit: AuditFile, seconds: f64) -> ReplayReport {
    let mut reasons = BTreeMap::new();
    for failed in audit.episodes.iter().filter(|episode| !episode.success) {
        *reasons.entry(failed.reason.clone()).or_insert(0) += 1;
    }
    let finding = |episode: &EpisodeAudit| {
        serde_json::json!({
            "episode": episode.episode,
            "id": episode.id,
            "success": episode.success,
            "reason": episode.reason,
            "findings": episode.findings,
        })
    };
    ReplayReport {
        output,
        page,
        episodes: audit.episodes.len(),
        succeeded: audit.episodes.iter().filter(|episode| episode.success).count(),
        clean: audit.episodes.iter().filter(|episode| episode.findings["clean"] == true).count(),
        reasons,
        findings: audit.episodes.iter().map(finding).collect(),
        world: audit.world,
        seconds,
    }
}
