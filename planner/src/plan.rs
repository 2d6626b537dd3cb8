//! The planning run: composes the stages, deterministically for any number of threads.

mod explain;
mod pairing;
mod planar;
mod reach;
mod regrasp;
mod rigid;
mod timeline;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;
use std::time::Instant;

use akrobat_gpu::GpuError;
use akrobat_model::events::{Event, Observer};
use akrobat_model::robot::BaseKind;
use akrobat_model::task::{ObjectKind, Task};
use akrobat_model::trajectory::{ContactException, Grasp, Trajectory, TrajectorySet};
use akrobat_model::{ModelError, Verdict, hash};
use rayon::prelude::*;

use crate::approach::{self, Approach, ApproachPlanner, Transfer};
use crate::backend::Backend;
use crate::closure::Closure;
use crate::collision::{self, LinkPairs, MovingCheck, RobotBody};
use crate::config::{Optimiser, PlannerConfig};
use crate::dense;
use crate::gpu::Session;
use crate::ik::Tool;
use crate::kinematics::Kinematics;
use crate::reuse::Reuse;
use crate::spheres::{self, SphereModel};
use crate::trajopt::{Problem, Waypoints};
use crate::world::{World, handle_center, is_handle_part, outward};
pub use explain::{
    Blocker, Explanation, GraspFindings, ReachFindings, Violation, WayFindings, explain,
};
use regrasp::Chain;
use timeline::Leg;

/// Pairs optimised between two looks at the limit: constant, so that results do not depend on threads.
const BATCH: usize = 32;
/// Starts whose way is nearly free, for each trajectory wanted, that make others needless: nearly all of them come to
/// be trajectories, unless the hand cannot get there.
const PROMISING_PER_TRAJECTORY: usize = 2;
/// Distance that plans keep from position limits, rad or m.
const LIMIT_MARGIN: f64 = 0.02;

/// What stops a planning run.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// Something in the task does not fit.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The robot's base cannot be planned for.
    #[error(
        "robot \"{robot}\": a differential base cannot move sideways and is not planned for; valid base kinds: holonomic, fixed"
    )]
    DifferentialBase {
        /// The robot.
        robot: String,
    },
    /// The graphics processor failed.
    #[error(transparent)]
    Device(#[from] GpuError),
    /// The user asked to stop.
    #[error("stopped on request")]
    Cancelled,
}

/// What depends on the robot alone, or is needed by the judge as well.
#[derive(Debug, Clone)]
pub struct Preparation {
    /// Collision spheres.
    pub spheres: SphereModel,
    /// Link pairs that can collide.
    pub self_pairs: LinkPairs,
    /// Pairs that may touch: each finger with the handle.
    pub exceptions: Vec<ContactException>,
}

impl Preparation {
    /// Fits or imports spheres, and finds which link pairs can collide.
    ///
    /// # Errors
    /// [`PlanError::Model`] of the sphere file; [`PlanError::DifferentialBase`].
    pub fn new(task: &Task) -> Result<Self, PlanError> {
        Self::reusing(task, &Reuse::default())
    }

    /// [`Self::new`], with what is kept from other tasks.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn reusing(task: &Task, reuse: &Reuse) -> Result<Self, PlanError> {
        let robot = &task.robot;
        if robot.file.base.kind == BaseKind::Differential {
            return Err(PlanError::DifferentialBase { robot: robot.name.clone() });
        }
        let spheres = spheres::of_robot_reusing(robot, reuse)?;
        let self_pairs = collision::self_collision_pairs(robot, &spheres);
        Ok(Self { self_pairs, exceptions: contact_exceptions(task), spheres })
    }
}

/// Each finger link with each part of the held link that belongs to the handle.
fn contact_exceptions(task: &Task) -> Vec<ContactException> {
    let object = &task.object;
    let link = &object.tree.links()[object.handle_link];
    let mut parts: Vec<&str> =
        link.visuals.iter().chain(&link.collisions).map(|p| p.name.as_str()).collect();
    parts.retain(|name| is_handle_part(object, name));
    parts.sort_unstable();
    parts.dedup();
    let mut out = Vec::new();
    for &finger in &task.robot.finger_links {
        for part in &parts {
            out.push(ContactException {
                robot_link: task.robot.tree.links()[finger].name.clone(),
                object_link: link.name.clone(),
                object_part: (*part).into(),
            });
        }
    }
    out
}

/// The result of a planning run.
#[derive(Debug, Clone)]
pub struct PlanOutcome {
    /// The accepted trajectories, judged.
    pub set: TrajectorySet,
    /// Counts by stage, and by reason of failure or rejection (`rejected/…`).
    pub counts: BTreeMap<String, u64>,
    /// Wall time by stage, seconds.
    pub stage_seconds: BTreeMap<String, f64>,
    /// Durations of each step of each pair that was tried, seconds of one thread.
    pub step_seconds: BTreeMap<String, Vec<f64>>,
    /// Details of the first rejections, for people.
    pub notes: Vec<String>,
}

/// Judges one trajectory.
pub type JudgeFn<'a> = dyn Fn(&Trajectory) -> Verdict + Sync + 'a;

/// Plans a task in its `world` until `config.limit` trajectories are accepted or all pairs are used up, on the CPU.
///
/// # Errors
/// [`PlanError`].
pub fn plan(
    task: &Task,
    preparation: &Preparation,
    world: &World,
    config: &PlannerConfig,
    observer: &dyn Observer,
    judge: &JudgeFn<'_>,
) -> Result<PlanOutcome, PlanError> {
    plan_on(&Backend::Cpu, task, preparation, world, config, observer, judge)
}

/// As [`plan`], with batches computed on `backend`. Rigid objects are planned on the CPU in any case.
///
/// # Errors
/// [`PlanError`].
pub fn plan_on(
    backend: &Backend,
    task: &Task,
    preparation: &Preparation,
    world: &World,
    config: &PlannerConfig,
    observer: &dyn Observer,
    judge: &JudgeFn<'_>,
) -> Result<PlanOutcome, PlanError> {
    match task.file.object.kind {
        ObjectKind::Articulated => {
            plan_driven(backend, task, preparation, world, config, observer, judge)
        }
        ObjectKind::Planar => {
            planar::plan_planar(backend, task, preparation, config, observer, judge)
        }
        ObjectKind::Rigid => {
            if matches!(backend, Backend::Wgpu(_)) {
                let message = "rigid objects are planned on the CPU";
                observer.event(&Event::Warning { message });
            }
            rigid::plan_rigid(Run::new(task, preparation, config, observer), world, judge)
        }
    }
}

/// Plans a task whose object has a joint that is driven.
fn plan_driven(
    backend: &Backend,
    task: &Task,
    preparation: &Preparation,
    world: &World,
    config: &PlannerConfig,
    observer: &dyn Observer,
    judge: &JudgeFn<'_>,
) -> Result<PlanOutcome, PlanError> {
    let session = match backend {
        Backend::Cpu => None,
        Backend::Wgpu(_) if config.optimiser != Optimiser::Manifold => None,
        Backend::Wgpu(gpu) => Some(gpu.session(world)?),
    };
    let mut run = Run::new(task, preparation, config, observer);
    run.device = session.as_ref();
    let grasps = run.stage("grasps", |run| run.grasps(world))?;
    let mut holds = run.stage("inverse kinematics", |run| run.holds(world, &grasps))?;
    let mut followed = run.followed_pairs(world, &holds, Starts::Clustered);
    run.count("pairs", followed.len());
    let regrasps = task.file.goal.regrasps > 0;
    let mut limit = config.limit;
    if regrasps {
        run.stage("goals", |run| run.find_goals(world, &mut holds))?;
        limit -= run.reserved(&holds, &followed);
    }
    let (mut trajectories, mut notes) = (Vec::new(), Vec::new());
    let mut found = Found { trajectories: &mut trajectories, notes: &mut notes };
    let optimisation = "trajectory optimisation";
    let of_clusters = followed.clone();
    let mut reached = BTreeSet::new();
    let mut suffice = pairing::promising_starts(&followed) >= PROMISING_PER_TRAJECTORY * limit;
    let mut others = Some(Starts::Others);
    while found.trajectories.len() < limit {
        if let Some(others) = others.take_if(|_| !suffice) {
            let more = run.followed_pairs(world, &holds, others);
            run.count("pairs", more.len());
            followed.extend(more);
            run.in_turn(&mut followed);
        }
        let round = pairing::next_round(&mut followed, &reached);
        if round.is_empty() && others.is_none() {
            break;
        }
        let accepted =
            run.collect_pairs(optimisation, world, &holds, &round, limit, &mut found, judge)?;
        reached.extend(accepted.into_iter().map(|pair| (round[pair].hold, round[pair].start)));
        suffice = false;
    }
    // Goal configurations are a second choice: where followed paths are enough, they are not looked for.
    if found.trajectories.len() < limit {
        if !regrasps {
            run.stage("goals", |run| run.find_goals(world, &mut holds))?;
        }
        let pairs = run.goal_pairs(&holds, &of_clusters);
        run.count("pairs", pairs.len());
        run.collect_pairs(optimisation, world, &holds, &pairs, limit, &mut found, judge)?;
    }
    let missing = run.missing_goals(found.trajectories);
    if regrasps && !missing.is_empty() && found.trajectories.len() < config.limit {
        let chains = run.stage("changes of grasp", |run| run.chains(world, &holds, &missing))?;
        let connect =
            |run: &Run<'_>, chain: &Chain, _: Option<&Waypoints>, steps: &mut StepClock| {
                run.connect_chain(world, &holds, chain, judge, steps)
            };
        let work = Work::one_by_one(&connect);
        run.collect("re-grasped trajectories", &chains, config.limit, &mut found, &work)?;
    }
    Ok(run.outcome(trajectories, notes))
}

struct Run<'a> {
    task: &'a Task,
    preparation: &'a Preparation,
    config: &'a PlannerConfig,
    observer: &'a dyn Observer,
    /// The world on the device, where there is one.
    device: Option<&'a Session<'a>>,
    counts: BTreeMap<String, u64>,
    stage_seconds: BTreeMap<String, f64>,
    step_seconds: BTreeMap<String, Vec<f64>>,
}

/// One grasp with its AKR and the configurations found for it.
struct Hold {
    grasp: Grasp,
    kinematics: Kinematics,
    body: RobotBody,
    closure: Closure,
    /// Configurations of the AKR at the start, those that stand for clusters first.
    starts: Vec<Vec<f64>>,
    /// How many stand for clusters.
    clustered_starts: usize,
    /// The approach to each start, planned when it is first needed.
    approaches: Vec<OnceLock<Result<Approach, &'static str>>>,
    /// Clustered configurations at each goal.
    goals: Vec<Vec<Vec<f64>>>,
}

/// Which of a grasp's starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Starts {
    /// Those that stand for clusters.
    Clustered,
    /// The others.
    Others,
}

impl Hold {
    fn starts(&self, which: Starts) -> std::ops::Range<usize> {
        match which {
            Starts::Clustered => 0..self.clustered_starts,
            Starts::Others => self.clustered_starts..self.starts.len(),
        }
    }
}

/// A start and a goal to be connected.
#[derive(Debug, Clone)]
struct Pair {
    hold: usize,
    start: usize,
    goal_index: usize,
    goal: Vec<f64>,
    /// Rank of this goal among those of its start: the end that following leads to, then near ones.
    rank: usize,
    /// How free the way there is when the joint is merely followed.
    promise: Promise,
}

/// Durations of the steps of one pair.
struct StepClock {
    began: Instant,
    laps: Vec<(&'static str, f64)>,
}

impl StepClock {
    fn start() -> Self {
        Self { began: Instant::now(), laps: Vec::new() }
    }

    /// Ends a step and begins the next.
    fn lap(&mut self, step: &'static str) {
        self.laps.push((step, self.began.elapsed().as_secs_f64()));
        self.began = Instant::now();
    }
}

/// How likely a way is to become free of collisions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Promise {
    Good,
    Fair,
    Poor,
}

/// What a run has found so far.
struct Found<'a> {
    trajectories: &'a mut Vec<Trajectory>,
    /// Details of the first rejections.
    notes: &'a mut Vec<String>,
}

/// Plans one of several things of a kind, along the path that was optimised for it where there is one.
type Connect<'a, T> =
    dyn Fn(&Run<'_>, &T, Option<&Waypoints>, &mut StepClock) -> Outcome + Sync + 'a;
/// Optimises the paths of several things together, of those for which that can be.
type Ahead<'a, T> = dyn Fn(&Run<'_>, &[T]) -> Result<Vec<Option<Waypoints>>, PlanError> + 'a;

/// How things of a kind are planned.
struct Work<'a, T> {
    ahead: Option<&'a Ahead<'a, T>>,
    connect: &'a Connect<'a, T>,
}

impl<'a, T> Work<'a, T> {
    /// Nothing is done for several of them together.
    fn one_by_one(connect: &'a Connect<'a, T>) -> Self {
        Self { ahead: None, connect }
    }
}

/// What became of a pair.
enum Outcome {
    Failed(&'static str, String),
    Judged(Box<Trajectory>, Verdict),
}

impl<'a> Run<'a> {
    fn new(
        task: &'a Task,
        preparation: &'a Preparation,
        config: &'a PlannerConfig,
        observer: &'a dyn Observer,
    ) -> Self {
        let (counts, stage_seconds, step_seconds) = Default::default();
        let device = None;
        Self { task, preparation, config, observer, device, counts, stage_seconds, step_seconds }
    }

    /// Adds the counts and times of a run for a part of the task.
    fn absorb(&mut self, part: &PlanOutcome) {
        for (name, count) in part.counts.iter().filter(|(name, _)| *name != "accepted") {
            *self.counts.entry(name.clone()).or_default() += count;
        }
        for (name, seconds) in &part.stage_seconds {
            *self.stage_seconds.entry(name.clone()).or_default() += seconds;
        }
        for (name, seconds) in &part.step_seconds {
            self.step_seconds.entry(name.clone()).or_default().extend(seconds);
        }
    }

    fn outcome(mut self, trajectories: Vec<Trajectory>, notes: Vec<String>) -> PlanOutcome {
        self.count("accepted", trajectories.len());
        let header = self.header();
        PlanOutcome {
            set: TrajectorySet { header, trajectories },
            counts: self.counts,
            stage_seconds: self.stage_seconds,
            step_seconds: self.step_seconds,
            notes,
        }
    }
}

impl Run<'_> {
    fn stage<T>(&mut self, name: &str, work: impl FnOnce(&mut Self) -> T) -> T {
        let started = Instant::now();
        self.observer.event(&Event::StageStarted { stage: name, total: None });
        let result = work(self);
        let seconds = started.elapsed().as_secs_f64();
        self.observer.event(&Event::StageFinished { stage: name, seconds });
        *self.stage_seconds.entry(name.into()).or_default() += seconds;
        result
    }

    fn count(&mut self, name: &str, by: usize) {
        *self.counts.entry(name.into()).or_default() += by as u64;
    }

    fn base(&self) -> usize {
        self.task.robot.base_joints.len()
    }

    /// How many of the trajectories wanted are kept for goals that no pair reaches.
    fn reserved(&self, holds: &[Hold], followed: &[Pair]) -> usize {
        let goals = self.task.file.goal.positions.len();
        let reachable = |goal: usize| {
            followed.iter().any(|p| p.goal_index == goal)
                || holds.iter().any(|h| !h.starts.is_empty() && !h.goals[goal].is_empty())
        };
        let hopeless = (0..goals).filter(|&goal| !reachable(goal)).count();
        self.config.limit * hopeless / goals
    }

    /// Goals that no trajectory reaches.
    fn missing_goals(&self, trajectories: &[Trajectory]) -> Vec<usize> {
        let reached = |goal: f64| trajectories.iter().any(|t| t.goal == goal);
        let goals = self.task.file.goal.positions.iter().enumerate();
        goals.filter(|&(_, &goal)| !reached(goal)).map(|(index, _)| index).collect()
    }

    /// Connects `items` until `limit` trajectories are accepted. Gives the indices of the items they are of.
    fn collect<T: Sync>(
        &mut self,
        stage: &str,
        items: &[T],
        limit: usize,
        found: &mut Found<'_>,
        work: &Work<'_, T>,
    ) -> Result<Vec<usize>, PlanError> {
        self.stage(stage, |run| run.collect_in_batches(stage, items, limit, found, work))
    }

    fn collect_in_batches<T: Sync>(
        &mut self,
        stage: &str,
        items: &[T],
        limit: usize,
        found: &mut Found<'_>,
        work: &Work<'_, T>,
    ) -> Result<Vec<usize>, PlanError> {
        self.observer.event(&Event::StageStarted { stage, total: Some(limit as u64) });
        let Found { trajectories: accepted, notes } = found;
        let mut indices = Vec::new();
        for (batch, first) in items.chunks(BATCH).zip((0..).step_by(BATCH)) {
            if self.observer.cancelled() {
                return Err(PlanError::Cancelled);
            }
            if accepted.len() >= limit {
                break;
            }
            let paths = match work.ahead {
                Some(ahead) => ahead(self, batch)?,
                None => vec![None; batch.len()],
            };
            let clocked = |(item, path): (&T, &Option<Waypoints>)| {
                let mut steps = StepClock::start();
                ((work.connect)(self, item, path.as_ref(), &mut steps), steps)
            };
            let outcomes: Vec<(Outcome, StepClock)> =
                batch.par_iter().zip(&paths).map(clocked).collect();
            for ((outcome, steps), index) in outcomes.into_iter().zip(first..) {
                self.count("pairs/tried", 1);
                for (step, seconds) in steps.laps {
                    self.step_seconds.entry(step.into()).or_default().push(seconds);
                }
                match outcome {
                    Outcome::Failed(reason, detail) => {
                        self.count(&format!("failed/{reason}"), 1);
                        if notes.len() < 40 && !detail.is_empty() {
                            notes.push(format!("{reason}: {detail}"));
                        }
                    }
                    Outcome::Judged(mut trajectory, verdict) => match verdict.rejection {
                        Some(reason) => {
                            self.count(&format!("rejected/{}", reason.name()), 1);
                            if notes.len() < 40 {
                                notes.push(format!("{}: {}", reason.name(), verdict.detail));
                            }
                        }
                        None if accepted.len() < limit => {
                            trajectory.verdict = Some(verdict);
                            accepted.push(*trajectory);
                            indices.push(index);
                        }
                        None => {}
                    },
                }
            }
            self.observer.event(&Event::Progress { stage, done: accepted.len() as u64 });
        }
        Ok(indices)
    }

    /// Connects pairs, optimised in batches where there is a device.
    #[allow(clippy::too_many_arguments)] // what is collected, and what with
    fn collect_pairs(
        &mut self,
        stage: &str,
        world: &World,
        holds: &[Hold],
        pairs: &[Pair],
        limit: usize,
        found: &mut Found<'_>,
        judge: &JudgeFn<'_>,
    ) -> Result<Vec<usize>, PlanError> {
        let connect =
            |run: &Run<'_>, pair: &Pair, path: Option<&Waypoints>, steps: &mut StepClock| {
                run.connect(world, holds, pair, path, judge, steps)
            };
        let ahead = self.device.map(|device| {
            move |run: &Run<'_>, batch: &[Pair]| run.optimised_on(device, world, holds, batch)
        });
        let ahead = ahead.as_ref().map(|ahead| ahead as &Ahead<'_, Pair>);
        let work = Work { ahead, connect: &connect };
        self.collect(stage, pairs, limit, found, &work)
    }

    /// The optimised paths of the pairs that have an approach and a path to begin with.
    fn optimised_on(
        &self,
        device: &Session<'_>,
        world: &World,
        holds: &[Hold],
        pairs: &[Pair],
    ) -> Result<Vec<Option<Waypoints>>, PlanError> {
        let problems: Vec<Problem<'_>> =
            pairs.iter().map(|pair| self.problem(world, &holds[pair.hold], self.config)).collect();
        let straight = |(pair, problem): (&Pair, &Problem<'_>)| {
            let hold = &holds[pair.hold];
            if self.config.approach {
                self.approach_to(world, hold, pair.hold, pair.start).ok()?;
            }
            problem.straight(&hold.starts[pair.start], &pair.goal)
        };
        let begun: Vec<Option<Waypoints>> = pairs.par_iter().zip(&problems).map(straight).collect();
        let begun: Vec<(usize, Waypoints)> = begun
            .into_iter()
            .enumerate()
            .filter_map(|(index, path)| Some((index, path?)))
            .collect();
        let (indices, paths): (Vec<usize>, Vec<Waypoints>) = begun.into_iter().unzip();
        let chosen: Vec<&Problem<'_>> = indices.iter().map(|&index| &problems[index]).collect();
        let optimised = device.optimise(&chosen, &paths)?;
        let settled: Vec<Option<Waypoints>> = optimised
            .into_par_iter()
            .zip(chosen)
            .map(|(mut path, problem)| problem.settle(&mut path).then_some(path))
            .collect();
        let mut out = vec![None; pairs.len()];
        indices.into_iter().zip(settled).for_each(|(index, path)| out[index] = path);
        Ok(out)
    }

    /// Optimises one pair, where `path` is not its optimised path already, and has the result judged.
    fn connect(
        &self,
        world: &World,
        holds: &[Hold],
        pair: &Pair,
        path: Option<&Waypoints>,
        judge: &JudgeFn<'_>,
        steps: &mut StepClock,
    ) -> Outcome {
        let hold = &holds[pair.hold];
        let start = &hold.starts[pair.start];
        let approach = match self.config.approach {
            false => None,
            true => {
                let planned = self.approach_to(world, hold, pair.hold, pair.start);
                steps.lap("approach");
                match planned {
                    Ok(approach) => Some(approach),
                    Err(reason) => return Outcome::Failed(reason, String::new()),
                }
            }
        };
        let leg = match path {
            Some(path) => self.leg_along(world, hold, self.config, path.clone(), steps),
            None => self.leg(world, hold, self.config, start, &pair.goal, steps),
        };
        let mut leg = match leg {
            Ok(leg) => leg,
            Err((reason, detail)) => return Outcome::Failed(reason, detail),
        };
        if let Err(reason) = self.let_go(world, Some(&mut leg)) {
            return Outcome::Failed(reason, String::new());
        }
        let number = self.pair_number(pair);
        let seed = stage_seed(self.task, "pair", number);
        let goal = self.task.file.goal.positions[pair.goal_index];
        let trajectory = self.trajectory(&number.to_string(), seed, goal, vec![leg], approach);
        let verdict = judge(&trajectory);
        steps.lap("judge");
        Outcome::Judged(Box::new(trajectory), verdict)
    }

    /// Optimises what one grasp does between two configurations: the reason and its details where it fails.
    fn leg<'h>(
        &self,
        world: &World,
        hold: &'h Hold,
        config: &PlannerConfig,
        start: &[f64],
        goal: &[f64],
        steps: &mut StepClock,
    ) -> Result<Leg<'h>, (&'static str, String)> {
        let fail = |reason| (reason, String::new());
        let problem = self.problem(world, hold, config);
        let optimised = match config.optimiser {
            Optimiser::Manifold => problem.straight(start, goal).ok_or("projection").map(|path| {
                let mut path = path;
                problem.optimise(&mut path);
                path
            }),
            Optimiser::Curobo => problem.optimise_by_penalties(start, goal).ok_or("no_seed_holds"),
        };
        steps.lap("optimise");
        self.leg_along(world, hold, config, optimised.map_err(fail)?, steps)
    }

    /// What one grasp does along optimised waypoints: sampled densely, and checked.
    fn leg_along<'h>(
        &self,
        world: &World,
        hold: &'h Hold,
        config: &PlannerConfig,
        waypoints: Waypoints,
        steps: &mut StepClock,
    ) -> Result<Leg<'h>, (&'static str, String)> {
        let fail = |reason| (reason, String::new());
        let problem = self.problem(world, hold, config);
        let samples =
            dense::densify(&problem, &waypoints, config.substeps).ok_or(fail("dense_path"))?;
        let colliding = self.first_collision(&problem, &samples);
        steps.lap("densify and check");
        if let Some((step, clearance)) = colliding {
            let link = |l: usize| self.task.robot.tree.links()[l].name.as_str();
            let to = match clearance.to {
                collision::Obstacle::Link(other) => link(other).to_string(),
                other => format!("{other:?}").to_lowercase(),
            };
            let detail = format!(
                "grasp {} sample {step} of {}: {} to {to}, {:.1} mm",
                hold.grasp.id,
                samples.len(),
                link(clearance.link),
                1e3 * clearance.distance_m
            );
            return Err(("collision", detail));
        }
        if self.base() == 3 {
            let yaw = samples.iter().map(|x| (x[2] - samples[0][2]).abs()).fold(0.0, f64::max);
            if yaw > self.config.max_base_yaw_rad {
                return Err(fail("base_yaw"));
            }
        }
        let planned = hold.kinematics.dof() - 1;
        let objects = samples.iter().map(|x| self.task.object.configuration(x[planned])).collect();
        let (transfer, release) = (None, None);
        Ok(Leg { grasp: &hold.grasp, transfer, waypoints, samples, objects, release })
    }

    fn first_collision(
        &self,
        problem: &Problem<'_>,
        samples: &Waypoints,
    ) -> Option<(usize, collision::Clearance)> {
        let least = self.config.min_clearance_m;
        samples.iter().enumerate().find_map(|(step, x)| {
            let frames = problem.kinematics.forward(x);
            let q = x[x.len() - 1];
            let found =
                problem.body.clearance(&frames, problem.world, q, MovingCheck::NotTool, least);
            (found.distance_m < least).then_some((step, found))
        })
    }

    /// The approach to a start, planned when it is first asked for.
    fn approach_to<'h>(
        &self,
        world: &World,
        hold: &'h Hold,
        hold_index: usize,
        start: usize,
    ) -> Result<&'h Approach, &'static str> {
        let plan = || {
            let x = &hold.starts[start];
            let seed = stage_seed(self.task, "approach", (hold_index << 16 | start) as u64);
            let (grasp, object_q) = x.split_at(x.len() - 1);
            self.with_open_hand(world, object_q[0], |planner| planner.plan(grasp, seed))
        };
        hold.approaches[start].get_or_init(plan).as_ref().map_err(|reason| *reason)
    }

    /// Plans how the hand leaves an object that stands where it was brought; a door or drawer stays in it.
    fn let_go(&self, world: &World, last: Option<&mut Leg<'_>>) -> Result<(), &'static str> {
        let standing = self.task.file.object.kind != ObjectKind::Articulated;
        if let Some(leg) = last.filter(|_| standing)
            && let Some((object_q, grasp)) = leg.samples.last().and_then(|x| x.split_last())
        {
            let release = self.with_open_hand(world, *object_q, |planner| planner.retreat(grasp));
            leg.release = Some(release.map_err(|_| "retreat")?);
        }
        Ok(())
    }

    /// The way of the open hand from one hold (base, arm, object's joint) to another.
    fn transfer(
        &self,
        world: &World,
        from: &[f64],
        to: &[f64],
        seed: u64,
    ) -> Result<Transfer, &'static str> {
        let (to, object_q) = to.split_at(to.len() - 1);
        let from = &from[..to.len()];
        self.with_open_hand(world, object_q[0], |planner| planner.transfer(from, to, seed))
    }

    /// Plans free motion with open fingers and the object's joint at `object_q`.
    fn with_open_hand<T>(
        &self,
        world: &World,
        object_q: f64,
        plan: impl FnOnce(&ApproachPlanner<'_>) -> Result<T, approach::Failure>,
    ) -> Result<T, &'static str> {
        let robot = &self.task.robot;
        let variables = [&robot.base_joints[..], &robot.arm_joints].concat();
        let kinematics =
            Kinematics::compile(&robot.tree, &robot.world_from_root, &variables, &robot.rest);
        let body = RobotBody::new(
            robot,
            &self.preparation.spheres,
            &self.preparation.self_pairs,
            &kinematics,
        );
        let tool = Tool::new(robot, &kinematics).ok_or("approach_reach")?;
        let handle = handle_center(&self.task.object);
        let planner = ApproachPlanner {
            robot,
            kinematics: &kinematics,
            body: &body,
            tool: &tool,
            world,
            config: self.config,
            object_q,
            outward: outward(&self.task.object, &handle),
        };
        plan(&planner).map_err(|f| f.name())
    }
}

/// A seed for one stage of a task: independent streams from one number.
fn stage_seed(task: &Task, stage: &str, index: u64) -> u64 {
    let text = format!("{}|{}|{stage}|{index}", task.file.seed, task.file.name);
    let digest = hash::of_bytes(text.as_bytes());
    u64::from_str_radix(&digest[..16], 16).unwrap_or(0)
}
