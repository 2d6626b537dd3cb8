//! Throughput of planning on a frozen set of problems.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Instant;

use akrobat_assets::demo;
use akrobat_model::robot::BaseKind;
use akrobat_model::trajectory::Trajectory;
use akrobat_model::{ModelError, TrajectorySet};
use akrobat_planner::{Optimiser, Reuse};
use serde::{Deserialize, Serialize};

use super::plan::plan_reusing;
use super::{Context, PlanBackend, PlanRequest};
use crate::{Error, resources};

/// The frozen set and what it names, relative to one folder.
const FROZEN: [(&str, &str); 13] = [
    ("bench/problems.toml", include_str!("../../configs/bench/problems.toml")),
    ("bench/open_drawer.toml", include_str!("../../configs/bench/open_drawer.toml")),
    ("bench/open_door_right.toml", include_str!("../../configs/bench/open_door_right.toml")),
    ("bench/living_cabinet.toml", include_str!("../../configs/bench/living_cabinet.toml")),
    ("bench/living_drawer.toml", include_str!("../../configs/bench/living_drawer.toml")),
    ("bench/kitchen_oven.toml", include_str!("../../configs/bench/kitchen_oven.toml")),
    (
        "bench/kitchen_refrigerator.toml",
        include_str!("../../configs/bench/kitchen_refrigerator.toml"),
    ),
    ("bench/galley_microwave.toml", include_str!("../../configs/bench/galley_microwave.toml")),
    ("bench/galley_drawer.toml", include_str!("../../configs/bench/galley_drawer.toml")),
    (
        "bench/corridor_refrigerator.toml",
        include_str!("../../configs/bench/corridor_refrigerator.toml"),
    ),
    ("bench/closet_door_left.toml", include_str!("../../configs/bench/closet_door_left.toml")),
    (
        "bench/blocked_refrigerator.toml",
        include_str!("../../configs/bench/blocked_refrigerator.toml"),
    ),
    ("robots/summit_franka.toml", include_str!("../../configs/robots/summit_franka.toml")),
];
/// What tells that the real inputs are there.
const REAL_INPUT: &str = "robots/summit_xl_franka/summit_xl_franka.urdf";

/// Starts that are this much apart in base position (m) or in a joint (rad) count as different.
const DIFFERENT_BASE_M: f64 = 0.1;
const DIFFERENT_JOINT_RAD: f64 = 0.2;

/// What is to be measured.
#[derive(Debug, Clone)]
pub struct PlanBenchRequest {
    /// A problem set instead of the frozen one.
    pub problems: Option<PathBuf>,
    /// Trajectories wanted for each problem.
    pub limit: usize,
    /// No further problem begins after this many seconds.
    pub seconds: f64,
    /// Number of threads; one for each core where absent.
    pub threads: Option<usize>,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
    /// How trajectories are optimised.
    pub optimiser: Optimiser,
    /// Folder that keeps each problem's trajectory file.
    pub keep: Option<PathBuf>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ProblemSet {
    name: String,
    #[serde(rename = "problem")]
    problems: Vec<Problem>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Problem {
    /// Task file beside the set.
    task: PathBuf,
    scene: String,
    /// Whether trajectories are expected.
    #[serde(default = "yes")]
    feasible: bool,
}

fn yes() -> bool {
    true
}

/// What one problem gave.
#[derive(Debug, Clone, Serialize)]
pub struct ProblemResult {
    /// Task name.
    pub task: String,
    /// Scene it belongs to.
    pub scene: String,
    /// Whether trajectories are expected.
    pub feasible: bool,
    /// Accepted trajectories with different starts.
    pub valid: usize,
    /// Accepted trajectories.
    pub accepted: usize,
    /// Wall time from loading to the written file, seconds.
    pub seconds: f64,
    /// Processor time of all threads, seconds.
    pub cpu_seconds: Option<f64>,
    /// Median length of the base's way during manipulation, metres.
    pub base_travel_m: f64,
    /// Median of the sum of the arm joints' ways during manipulation, rad.
    pub arm_rotation_rad: f64,
    /// Wall time by stage, seconds.
    pub stage_seconds: BTreeMap<String, f64>,
    /// Counts by stage and by reason of failure.
    pub counts: BTreeMap<String, u64>,
    #[serde(skip)]
    step_seconds: BTreeMap<String, Vec<f64>>,
}

/// Quantiles of a duration, milliseconds.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Spread {
    /// Median.
    pub p50: f64,
    /// 95th percentile.
    pub p95: f64,
    /// 99th percentile.
    pub p99: f64,
}

/// What the set gave.
#[derive(Debug, Clone, Serialize)]
pub struct PlanBenchReport {
    /// Name of the set.
    pub problem_set: String,
    /// Number of threads.
    pub threads: usize,
    /// Accepted trajectories with different starts.
    pub valid: usize,
    /// Accepted trajectories.
    pub accepted: usize,
    /// Wall time of everything, seconds.
    pub seconds: f64,
    /// Processor time of everything, seconds.
    pub cpu_seconds: Option<f64>,
    /// Largest memory of the process, bytes.
    pub peak_memory_bytes: Option<u64>,
    /// Share of each scene in the valid trajectories.
    pub scene_shares: BTreeMap<String, f64>,
    /// Durations of the steps of one pair of start and goal, milliseconds of one thread.
    pub step_ms: BTreeMap<String, Spread>,
    /// Each problem.
    pub problems: Vec<ProblemResult>,
    /// Problems that were not begun in time.
    pub left_out: Vec<String>,
}

impl PlanBenchReport {
    /// Trajectories with different starts per second of wall time.
    pub fn valid_per_s(&self) -> f64 {
        self.valid as f64 / self.seconds.max(1e-9)
    }

    /// Accepted trajectories per second of wall time.
    pub fn accepted_per_s(&self) -> f64 {
        self.accepted as f64 / self.seconds.max(1e-9)
    }
}

/// Plans every problem of the set, one after the other.
///
/// # Errors
/// Where the set cannot be read, one of its tasks cannot be planned, or the user asked to stop.
pub fn bench_plan(
    request: &PlanBenchRequest,
    context: &Context<'_>,
) -> Result<PlanBenchReport, Error> {
    let folder =
        tempfile::tempdir().map_err(|e| Error::write(Path::new("temporary folder"), &e))?;
    let assets = assets(&request.assets, context)?;
    let (set, beside) = problem_set(request, &assets, folder.path())?;
    if let Some(keep) = &request.keep {
        std::fs::create_dir_all(keep).map_err(|e| Error::write(keep, &e))?;
    }
    let (began, cpu_before) = (Instant::now(), resources::cpu_seconds());
    let reuse = Reuse::default();
    let (mut problems, mut left_out) = (Vec::new(), Vec::new());
    for problem in &set.problems {
        if began.elapsed().as_secs_f64() > request.seconds {
            left_out.push(problem.task.display().to_string());
            continue;
        }
        let task = beside.join(&problem.task);
        let output = match &request.keep {
            Some(keep) => keep.join(file_name(&problem.task)).with_extension("h5"),
            None => folder.path().join("trajectories.h5"),
        };
        problems.push(run_problem(request, problem, task, output, &assets, context, &reuse)?);
    }
    let seconds = began.elapsed().as_secs_f64();
    let valid = problems.iter().map(|p| p.valid).sum();
    Ok(PlanBenchReport {
        problem_set: set.name,
        threads: request.threads.unwrap_or_else(rayon::current_num_threads),
        valid,
        accepted: problems.iter().map(|p| p.accepted).sum(),
        seconds,
        cpu_seconds: difference(cpu_before),
        peak_memory_bytes: resources::peak_memory_bytes(),
        scene_shares: scene_shares(&problems, valid),
        step_ms: step_spreads(&problems),
        problems,
        left_out,
    })
}

fn file_name(path: &Path) -> &Path {
    path.file_name().map_or(path, Path::new)
}

/// Folders given, and that of the shared inputs beside the checkout.
fn assets(given: &[PathBuf], context: &Context<'_>) -> Result<Vec<PathBuf>, Error> {
    let mut folders = context.asset_search(given)?.folders;
    if !folders.iter().any(|folder| folder.join(REAL_INPUT).is_file()) {
        folders.extend(akrobat_model::fixtures::shared_assets());
    }
    Ok(folders)
}

/// The set and the folder its tasks are in.
fn problem_set(
    request: &PlanBenchRequest,
    assets: &[PathBuf],
    folder: &Path,
) -> Result<(ProblemSet, PathBuf), Error> {
    let real = assets.iter().any(|folder| folder.join(REAL_INPUT).is_file());
    let path = match &request.problems {
        Some(path) => path.clone(),
        None if real => write_frozen(folder).map_err(|e| Error::write(folder, &e))?,
        None => return built_in(folder),
    };
    let text = std::fs::read_to_string(&path).map_err(|e| ModelError::read(&path, e))?;
    let set: ProblemSet =
        toml::from_str(&text).map_err(|e| ModelError::invalid(&path, e.message()))?;
    Ok((set, super::folder_of(&path).to_path_buf()))
}

fn write_frozen(folder: &Path) -> std::io::Result<PathBuf> {
    for (name, text) in FROZEN {
        let path = folder.join(name);
        std::fs::create_dir_all(super::folder_of(&path))?;
        std::fs::write(path, text)?;
    }
    Ok(folder.join(FROZEN[0].0))
}

/// The demo's tasks for the robot that needs no files of others.
fn built_in(folder: &Path) -> Result<(ProblemSet, PathBuf), Error> {
    let paths = demo::write(&folder.join("built_in"), 1, None)?;
    let problem = |task| Problem { task, scene: "generated_kitchen".into(), feasible: true };
    let problems = paths.tasks.into_iter().map(problem).collect();
    Ok((ProblemSet { name: "built-in".into(), problems }, PathBuf::new()))
}

fn run_problem(
    request: &PlanBenchRequest,
    problem: &Problem,
    task: PathBuf,
    output: PathBuf,
    assets: &[PathBuf],
    context: &Context<'_>,
    reuse: &Reuse,
) -> Result<ProblemResult, Error> {
    let name = task.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let (began, cpu_before) = (Instant::now(), resources::cpu_seconds());
    let planned = plan_reusing(
        &PlanRequest {
            task,
            output: Some(output),
            assets: assets.to_vec(),
            seed: None,
            limit: Some(request.limit),
            threads: request.threads,
            explain: false,
            backend: PlanBackend::Cpu,
            optimiser: Some(request.optimiser),
        },
        context,
        reuse,
    )?;
    let set = &planned.set;
    Ok(ProblemResult {
        task: name,
        scene: problem.scene.clone(),
        feasible: problem.feasible,
        valid: different_starts(set),
        accepted: set.trajectories.len(),
        seconds: began.elapsed().as_secs_f64(),
        cpu_seconds: difference(cpu_before),
        base_travel_m: median(set.trajectories.iter().map(|t| base_travel(set, t)).collect()),
        arm_rotation_rad: median(set.trajectories.iter().map(|t| arm_rotation(set, t)).collect()),
        stage_seconds: planned.stage_seconds,
        counts: planned.counts,
        step_seconds: planned.step_seconds,
    })
}

fn difference(before: Option<f64>) -> Option<f64> {
    Some(resources::cpu_seconds()? - before?)
}

/// Number of base columns of the waypoints, which come first.
fn base_dof(set: &TrajectorySet) -> usize {
    if set.header.base_kind == BaseKind::Fixed { 0 } else { 3 }
}

/// Number of trajectories whose start differs from those of all counted before.
fn different_starts(set: &TrajectorySet) -> usize {
    let base = base_dof(set).min(2);
    let mut kept: Vec<Vec<f64>> = Vec::new();
    for trajectory in &set.trajectories {
        let start = trajectory.waypoints_robot.row_f64(0);
        let same = |other: &Vec<f64>| {
            let moved: f64 = (0..base).map(|i| (start[i] - other[i]).powi(2)).sum::<f64>().sqrt();
            let turned = start[base..].iter().zip(&other[base..]).map(|(a, b)| (a - b).abs());
            moved <= DIFFERENT_BASE_M && turned.fold(0.0, f64::max) <= DIFFERENT_JOINT_RAD
        };
        if !kept.iter().any(same) {
            kept.push(start);
        }
    }
    kept.len()
}

fn steps(trajectory: &Trajectory) -> impl Iterator<Item = (Vec<f64>, Vec<f64>)> + '_ {
    let rows = &trajectory.waypoints_robot;
    (1..rows.rows()).map(|t| (rows.row_f64(t - 1), rows.row_f64(t)))
}

fn base_travel(set: &TrajectorySet, trajectory: &Trajectory) -> f64 {
    if base_dof(set) < 2 {
        return 0.0;
    }
    steps(trajectory).map(|(a, b)| (b[0] - a[0]).hypot(b[1] - a[1])).sum()
}

fn arm_rotation(set: &TrajectorySet, trajectory: &Trajectory) -> f64 {
    let base = base_dof(set);
    steps(trajectory)
        .map(|(a, b)| a[base..].iter().zip(&b[base..]).map(|(a, b)| (b - a).abs()).sum::<f64>())
        .sum()
}

/// The value below which `share` of them lie; zero of none.
fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1);
    values.get((share * last as f64).round() as usize).copied().unwrap_or(0.0)
}

fn median(mut values: Vec<f64>) -> f64 {
    quantile(&mut values, 0.5)
}

fn scene_shares(problems: &[ProblemResult], valid: usize) -> BTreeMap<String, f64> {
    let mut shares = BTreeMap::new();
    for problem in problems {
        *shares.entry(problem.scene.clone()).or_default() +=
            problem.valid as f64 / valid.max(1) as f64;
    }
    shares
}

fn step_spreads(problems: &[ProblemResult]) -> BTreeMap<String, Spread> {
    let mut all: BTreeMap<String, Vec<f64>> = BTreeMap::new();
    for (step, seconds) in problems.iter().flat_map(|p| &p.step_seconds) {
        all.entry(step.clone()).or_default().extend(seconds);
    }
    all.into_iter()
        .map(|(step, mut seconds)| {
            let mut at = |share| 1e3 * quantile(&mut seconds, share);
            (step, Spread { p50: at(0.5), p95: at(0.95), p99: at(0.99) })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The set is frozen: where this fails, undo the change, or give the new set a new name.
    #[test]
    fn the_frozen_set_is_as_it_was() {
        let mut text = String::new();
        for (name, content) in FROZEN.iter().filter(|(name, _)| name.starts_with("bench/")) {
            text += &format!("{name}\n{content}\n");
        }
        assert_eq!(akrobat_model::hash::of_bytes(text.as_bytes()), FROZEN_HASH);
    }

    const FROZEN_HASH: &str = "cc9211038422e520220f35995d6d131fa59129cfb3f7756e36086e915f737261";

    #[test]
    fn no_scene_gives_more_than_a_quarter() {
        let set: ProblemSet = toml::from_str(FROZEN[0].1).unwrap();
        let feasible: Vec<_> = set.problems.iter().filter(|p| p.feasible).collect();
        for problem in &feasible {
            let own = feasible.iter().filter(|p| p.scene == problem.scene).count();
            assert!(4 * own <= feasible.len(), "{}", problem.scene);
        }
        assert!(feasible.len() < set.problems.len(), "one is infeasible");
    }
}
