//! The planning run: composes the stages, deterministically for any number of threads.

use std::collections::BTreeMap;
use std::sync::OnceLock;
use std::time::Instant;

use akrobat_model::events::{Event, Observer};
use akrobat_model::robot::BaseKind;
use akrobat_model::task::Task;
use akrobat_model::trajectory::{
    ContactException, DensePath, Grasp, Phase, Trajectory, TrajectoryHeader, TrajectorySet,
};
use akrobat_model::{JointPath, ModelError, Verdict, hash};

use rayon::prelude::*;

use crate::akr::{self, Akr};
use crate::approach::{Approach, ApproachPlanner};
use crate::closure::Closure;
use crate::cluster;
use crate::collision::{self, LinkPairs, MovingCheck, RobotBody};
use crate::config::PlannerConfig;
use crate::dense::{self, Limits};
use crate::grasp;
use crate::ik::{self, SeedRegion, Tool};
use crate::kinematics::{Frame, Kinematics};
use crate::spheres::{self, SphereModel};
use crate::trajopt::{Problem, Waypoints, smooth};
use crate::world::{World, handle_center, is_handle_part, outward};

/// Pairs optimised between two looks at the limit: constant, so that results do not depend on threads.
const BATCH: usize = 32;
/// Grasps that are looked at for each one that is used, and seeds that tell whether one is within reach.
const SCREENED_PER_GRASP: usize = 12;
const SCREENING_SEEDS: usize = 100;
/// Solutions among them that suffice, and the number that stands for screening in seeds.
const SCREENING_SOLUTIONS: usize = 2;
const SCREENING_TARGET: usize = 0xffff;
/// Distance that plans keep from position limits, rad or m.
const LIMIT_MARGIN: f64 = 0.02;
/// Time step of sampled finger motion, seconds.
const FINGER_STEP_S: f64 = 0.03;

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
        let robot = &task.robot;
        if robot.file.base.kind == BaseKind::Differential {
            return Err(PlanError::DifferentialBase { robot: robot.name.clone() });
        }
        let spheres = spheres::of_robot(robot, robot.spheres_path.as_deref())?;
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
    /// Details of the first rejections, for people.
    pub notes: Vec<String>,
}

/// Judges one trajectory.
pub type JudgeFn<'a> = dyn Fn(&Trajectory) -> Verdict + Sync + 'a;

/// Plans a task until `config.limit` trajectories are accepted or all pairs are used up.
///
/// # Errors
/// [`PlanError`].
pub fn plan(
    task: &Task,
    preparation: &Preparation,
    config: &PlannerConfig,
    observer: &dyn Observer,
    judge: &JudgeFn<'_>,
) -> Result<PlanOutcome, PlanError> {
    let mut run = Run {
        task,
        preparation,
        config,
        observer,
        counts: BTreeMap::new(),
        stage_seconds: BTreeMap::new(),
    };
    let world = run.stage("distance field", |_| World::build(task, config));
    let grasps = run.stage("grasps", |run| run.grasps(&world))?;
    let holds = run.stage("inverse kinematics", |run| run.holds(&world, &grasps))?;
    let pairs = run.stage("pairing", |run| run.pairs(&world, &holds));
    run.count("pairs", pairs.len());
    let (trajectories, notes) =
        run.stage("trajectory optimisation", |run| run.optimise(&world, &holds, &pairs, judge))?;
    run.count("accepted", trajectories.len());
    let header = run.header();
    Ok(PlanOutcome {
        set: TrajectorySet { header, trajectories },
        counts: run.counts,
        stage_seconds: run.stage_seconds,
        notes,
    })
}

struct Run<'a> {
    task: &'a Task,
    preparation: &'a Preparation,
    config: &'a PlannerConfig,
    observer: &'a dyn Observer,
    counts: BTreeMap<String, u64>,
    stage_seconds: BTreeMap<String, f64>,
}

/// One grasp with its AKR and the configurations found for it.
struct Hold {
    grasp: Grasp,
    kinematics: Kinematics,
    body: RobotBody,
    closure: Closure,
    /// Clustered configurations of the AKR at the start.
    starts: Vec<Vec<f64>>,
    /// The approach to each start, planned when it is first needed.
    approaches: Vec<OnceLock<Result<Approach, &'static str>>>,
    /// Clustered configurations at each goal.
    goals: Vec<Vec<Vec<f64>>>,
}

/// A start and a goal to be connected.
#[derive(Debug, Clone)]
struct Pair {
    hold: usize,
    start: usize,
    goal_index: usize,
    goal: Vec<f64>,
    /// Rank of this goal among those of its start: near ones first.
    rank: usize,
}

/// What became of a pair.
enum Outcome {
    Failed(&'static str, String),
    Judged(Box<Trajectory>, Verdict),
}

impl Run<'_> {
    fn stage<T>(&mut self, name: &str, work: impl FnOnce(&mut Self) -> T) -> T {
        let started = Instant::now();
        self.observer.event(&Event::StageStarted { stage: name, total: None });
        let result = work(self);
        let seconds = started.elapsed().as_secs_f64();
        self.observer.event(&Event::StageFinished { stage: name, seconds });
        self.stage_seconds.insert(name.into(), seconds);
        result
    }

    fn count(&mut self, name: &str, by: usize) {
        *self.counts.entry(name.into()).or_default() += by as u64;
    }

    fn base(&self) -> usize {
        self.task.robot.base_joints.len()
    }

    /// The grasps that are used: the first, in order of diversity, that fit and are within reach at both
    /// ends of the motion.
    fn grasps(&mut self, world: &World) -> Result<Vec<Grasp>, PlanError> {
        let task = self.task;
        let wanted = task.file.grasps.count;
        let (fitting, tried) = grasp::grasps(
            task,
            &self.preparation.spheres,
            stage_seed(task, "grasps", 0),
            wanted * SCREENED_PER_GRASP,
        );
        self.count("grasps/candidates", tried);
        self.count("grasps/fitting", fitting.len());
        let mut chosen = Vec::new();
        for grasp in fitting {
            if self.observer.cancelled() {
                return Err(PlanError::Cancelled);
            }
            if chosen.len() == wanted {
                break;
            }
            if self.is_within_reach(world, &grasp)? {
                chosen.push(Grasp { id: chosen.len() as u32, ..grasp });
            }
        }
        self.count("grasps/used", chosen.len());
        Ok(chosen)
    }

    /// True where a few seeds give free configurations at the start and at a goal.
    fn is_within_reach(&self, world: &World, grasp: &Grasp) -> Result<bool, PlanError> {
        let akr = akr::assemble(&self.task.robot, &self.task.object, grasp)?;
        let goal = &self.task.file.goal;
        let reaches = |q: f64| -> Result<bool, PlanError> {
            let found = self.solve(world, &akr, grasp, q, SCREENING_TARGET, SCREENING_SEEDS)?.0;
            Ok(found.len() >= SCREENING_SOLUTIONS)
        };
        if !reaches(goal.start)? {
            return Ok(false);
        }
        for &q in &goal.positions {
            if reaches(q)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Inverse kinematics at the start and at every goal, for every grasp; clustered.
    fn holds(&mut self, world: &World, grasps: &[Grasp]) -> Result<Vec<Hold>, PlanError> {
        let stage = "inverse kinematics";
        self.observer.event(&Event::StageStarted { stage, total: Some(grasps.len() as u64) });
        let mut holds = Vec::new();
        for (grasp, done) in grasps.iter().zip(1..) {
            if self.observer.cancelled() {
                return Err(PlanError::Cancelled);
            }
            if let Some(hold) = self.hold(world, grasp)? {
                holds.push(hold);
            }
            self.observer.event(&Event::Progress { stage, done });
        }
        Ok(holds)
    }

    fn hold(&mut self, world: &World, grasp: &Grasp) -> Result<Option<Hold>, PlanError> {
        let task = self.task;
        let akr = akr::assemble(&task.robot, &task.object, grasp)?;
        let mut kinematics =
            Kinematics::compile(&akr.tree, &task.robot.world_from_root, &akr.variables, &akr.rest);
        kinematics.draw_in_limits(akr.variables.len() - 1, LIMIT_MARGIN);
        let body = RobotBody::new(
            &task.robot,
            &self.preparation.spheres,
            &self.preparation.self_pairs,
            &kinematics,
        );
        let Some(closure) = Closure::new(&akr, &kinematics, &task.object.world_from_root) else {
            return Ok(None);
        };
        let mut hold = Hold {
            grasp: grasp.clone(),
            kinematics,
            body,
            closure,
            starts: Vec::new(),
            approaches: Vec::new(),
            goals: Vec::new(),
        };
        hold.starts = self.configurations(world, &akr, &hold, task.file.goal.start, 0)?;
        hold.approaches = hold.starts.iter().map(|_| OnceLock::new()).collect();
        if hold.starts.is_empty() {
            self.count("grasps/without_start", 1);
            return Ok(None);
        }
        for (index, &goal) in task.file.goal.positions.iter().enumerate() {
            let found = self.configurations(world, &akr, &hold, goal, index + 1)?;
            hold.goals.push(found);
        }
        Ok(Some(hold))
    }

    /// Clustered, collision-free configurations with the object's joint at `q`.
    fn configurations(
        &mut self,
        world: &World,
        akr: &Akr,
        hold: &Hold,
        q: f64,
        target_index: usize,
    ) -> Result<Vec<Vec<f64>>, PlanError> {
        let seeds = self.config.ik_seeds;
        let (mut found, solved) = self.solve(world, akr, &hold.grasp, q, target_index, seeds)?;
        self.count("ik/seeds", seeds);
        self.count("ik/solved", solved);
        self.count("ik/free", found.len());
        let weights = vec![1.0; hold.kinematics.dof() - 1];
        let seed = ik_seed(self.task, &hold.grasp, target_index);
        let chosen =
            cluster::representatives(&found, &weights, 10, self.config.ik_clusters, 500, seed);
        Ok(chosen
            .into_iter()
            .map(|i| {
                let mut x = std::mem::take(&mut found[i]);
                x.push(q);
                x
            })
            .collect())
    }

    /// Collision-free base and arm configurations that hold the object with its joint at `q`, and how many
    /// seeds converged at all.
    fn solve(
        &self,
        world: &World,
        akr: &Akr,
        grasp: &Grasp,
        q: f64,
        target_index: usize,
        seeds: usize,
    ) -> Result<(Vec<Vec<f64>>, usize), PlanError> {
        let robot = &self.task.robot;
        let variables = &akr.variables[..akr.variables.len() - 1];
        let mut kinematics =
            Kinematics::compile(&akr.tree, &robot.world_from_root, variables, &akr.rest);
        kinematics.draw_in_limits(variables.len(), LIMIT_MARGIN);
        let Some(tool) = Tool::new(robot, &kinematics) else { return Ok((Vec::new(), 0)) };
        let body = RobotBody::new(
            robot,
            &self.preparation.spheres,
            &self.preparation.self_pairs,
            &kinematics,
        );
        // Half way to what optimisation aims at: a path that leaves here has room on all sides.
        let least = f64::midpoint(self.config.min_clearance_m, self.config.clearance_m);
        let prefilter = |x: &[f64]| {
            self.base() == 0 || body.base_clearance(&kinematics.forward(x), world) > -0.05
        };
        let accept = |x: &[f64]| {
            let frames = kinematics.forward(x);
            let clearance = body.clearance(&frames, world, q, MovingCheck::NotTool, least);
            clearance.distance_m >= least
        };
        Ok(ik::solve_batch(
            &kinematics,
            &tool,
            &self.tool_target(grasp, q)?,
            &self.seed_region(),
            ik_seed(self.task, grasp, target_index),
            seeds,
            &prefilter,
            &accept,
        ))
    }

    /// World frame of the tool that holds the object with its joint at `q`.
    fn tool_target(&self, grasp: &Grasp, q: f64) -> Result<Frame, ModelError> {
        let object = &self.task.object;
        let poses = object.tree.link_poses(&object.world_from_root, &object.configuration(q));
        let link = object.tree.link_index(&grasp.link)?;
        Ok(Frame::from(&(poses[link] * grasp.link_from_tool)))
    }

    fn seed_region(&self) -> SeedRegion {
        let robot = &self.task.robot;
        let base = self.base();
        let poses = robot.tree.link_poses(&robot.world_from_root, &robot.rest);
        let mount =
            robot.arm_joints.first().map_or(robot.tree.root(), |&j| robot.tree.joints()[j].parent);
        let mut offset = [0.0, 0.0];
        if base == 3 {
            let foot = robot.tree.joints()[robot.base_joints[2]].child;
            let relative = poses[foot].inverse() * poses[mount];
            offset = [relative.translation.x, relative.translation.y];
        }
        let handle = handle_center(&self.task.object);
        SeedRegion {
            base,
            mount: offset,
            outward: outward(&self.task.object, &handle),
            distance_m: [0.3, 0.85],
            half_angle: 2.0,
        }
    }

    fn problem<'b>(&'b self, world: &'b World, hold: &'b Hold) -> Problem<'b> {
        let dof = hold.kinematics.dof();
        Problem {
            kinematics: &hold.kinematics,
            closure: &hold.closure,
            body: &hold.body,
            world,
            config: self.config,
            velocity_weights: Problem::weights(self.config.velocity_weights, self.base(), dof),
            acceleration_weights: Problem::weights(
                self.config.acceleration_weights,
                self.base(),
                dof,
            ),
            mobility: vec![1.0; dof],
        }
    }

    /// Starts with goals: for each start the end that following the joint leads to, and the nearest of the
    /// goal configurations; ordered so that grasps, starts and goals take turns.
    fn pairs(&mut self, world: &World, holds: &[Hold]) -> Vec<Pair> {
        let yaw = (self.base() == 3).then_some(2);
        let mut pairs: Vec<Pair> = holds
            .par_iter()
            .enumerate()
            .flat_map_iter(|(hold_index, hold)| {
                let problem = self.problem(world, hold);
                let mut own = Vec::new();
                for (start_index, start) in hold.starts.iter().enumerate() {
                    for (goal_index, goals) in hold.goals.iter().enumerate() {
                        let q = self.task.file.goal.positions[goal_index];
                        let followed = problem.follow(start, q);
                        let mut ends: Vec<Vec<f64>> = goals.clone();
                        ends.retain(|g| {
                            yaw.is_none_or(|y| {
                                (g[y] - start[y]).abs() <= self.config.max_base_yaw_rad
                            })
                        });
                        let distance = |g: &Vec<f64>| -> f64 {
                            g.iter().zip(start).map(|(a, b)| (a - b) * (a - b)).sum()
                        };
                        ends.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
                        ends.truncate(3);
                        let ends = followed.into_iter().chain(ends);
                        own.extend(ends.enumerate().map(|(rank, goal)| Pair {
                            hold: hold_index,
                            start: start_index,
                            goal_index,
                            goal,
                            rank,
                        }));
                    }
                }
                own
            })
            .collect();
        pairs.sort_by_key(|p| (p.rank, p.start, p.goal_index, p.hold));
        let mut per_hold = vec![0usize; holds.len()];
        let most = self.config.pairs_per_grasp * self.task.file.goal.positions.len();
        pairs.retain(|p| {
            per_hold[p.hold] += 1;
            per_hold[p.hold] <= most
        });
        pairs
    }

    fn optimise(
        &mut self,
        world: &World,
        holds: &[Hold],
        pairs: &[Pair],
        judge: &JudgeFn<'_>,
    ) -> Result<(Vec<Trajectory>, Vec<String>), PlanError> {
        let stage = "trajectory optimisation";
        let total = Some(self.config.limit as u64);
        self.observer.event(&Event::StageStarted { stage, total });
        let (mut accepted, mut notes) = (Vec::new(), Vec::new());
        for batch in pairs.chunks(BATCH) {
            if self.observer.cancelled() {
                return Err(PlanError::Cancelled);
            }
            if accepted.len() >= self.config.limit {
                break;
            }
            let outcomes: Vec<Outcome> =
                batch.par_iter().map(|pair| self.connect(world, holds, pair, judge)).collect();
            for outcome in outcomes {
                self.count("pairs/tried", 1);
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
                        None if accepted.len() < self.config.limit => {
                            trajectory.verdict = Some(verdict);
                            accepted.push(*trajectory);
                        }
                        None => {}
                    },
                }
            }
            self.observer.event(&Event::Progress { stage, done: accepted.len() as u64 });
        }
        Ok((accepted, notes))
    }

    /// Optimises one pair and has the result judged.
    fn connect(&self, world: &World, holds: &[Hold], pair: &Pair, judge: &JudgeFn<'_>) -> Outcome {
        let hold = &holds[pair.hold];
        let problem = self.problem(world, hold);
        let start = &hold.starts[pair.start];
        let fail = |reason| Outcome::Failed(reason, String::new());
        let approach = match self.config.approach {
            false => None,
            true => {
                let plan = || self.approach(world, hold, pair);
                match hold.approaches[pair.start].get_or_init(plan) {
                    Ok(approach) => Some(approach),
                    Err(reason) => return fail(reason),
                }
            }
        };
        let Some(mut waypoints) = problem.straight(start, &pair.goal) else {
            return fail("projection");
        };
        problem.optimise(&mut waypoints);
        let Some(samples) = dense::densify(&problem, &waypoints, self.config.substeps) else {
            return fail("dense_path");
        };
        if let Some((step, clearance)) = self.first_collision(&problem, &samples) {
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
            return Outcome::Failed("collision", detail);
        }
        if self.base() == 3 {
            let yaw = samples.iter().map(|x| (x[2] - samples[0][2]).abs()).fold(0.0, f64::max);
            if yaw > self.config.max_base_yaw_rad {
                return fail("base_yaw");
            }
        }
        let seed = stage_seed(self.task, "pair", self.pair_number(pair));
        let trajectory = self.trajectory(hold, pair, seed, &waypoints, &samples, approach);
        let verdict = judge(&trajectory);
        Outcome::Judged(Box::new(trajectory), verdict)
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

    fn approach(&self, world: &World, hold: &Hold, pair: &Pair) -> Result<Approach, &'static str> {
        let first = &hold.starts[pair.start];
        let seed = stage_seed(self.task, "approach", (pair.hold << 16 | pair.start) as u64);
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
            object_q: hold.starts[0][hold.kinematics.dof() - 1],
            outward: outward(&self.task.object, &handle),
        };
        planner.plan(&first[..first.len() - 1], seed).map_err(|f| f.name())
    }

    /// Lays the phases out in time.
    fn trajectory(
        &self,
        hold: &Hold,
        pair: &Pair,
        seed: u64,
        waypoints: &Waypoints,
        samples: &Waypoints,
        approach: Option<&Approach>,
    ) -> Trajectory {
        let (robot, object) = (&self.task.robot, &self.task.object);
        let columns = robot.trajectory_joints();
        let planned = columns.len() - robot.gripper_joints.len();
        let start_q = samples[0][planned];
        let open = robot.finger_positions(robot.file.gripper.open_width_m);
        let closed = robot.finger_positions(hold.grasp.width_m);
        let mut dense = DensePath {
            robot: JointPath::new(columns.len()),
            object: JointPath::new(object.tree.dof()),
            ..DensePath::default()
        };
        let mut time = 0.0;
        let row = |x: &[f64], fingers: &[f64]| [&x[..planned], fingers].concat();
        if let Some(approach) = approach {
            let rest = object.configuration(start_q);
            dense.push(time, row(&approach.home, &open), rest.clone(), Phase::Approach);
            for (phase, samples) in
                [(Phase::Approach, &approach.free), (Phase::Reach, &approach.reach)]
            {
                for (dt, x) in samples {
                    time += dt;
                    dense.push(time, row(x, &open), rest.clone(), phase);
                }
            }
            let limits = Limits::of(robot, &robot.gripper_joints);
            let delta: Vec<f64> = closed.iter().zip(&open).map(|(c, o)| c - o).collect();
            let duration = limits.rest_to_rest(&delta).max(0.2);
            let count = (duration / FINGER_STEP_S).ceil().max(4.0) as usize;
            let step = duration / count as f64 * 1.02;
            for i in 1..=count {
                let s = smooth(i as f64 / count as f64);
                let fingers: Vec<f64> = open.iter().zip(&delta).map(|(o, d)| o + d * s).collect();
                time += step;
                dense.push(time, row(&samples[0], &fingers), rest.clone(), Phase::Grasp);
            }
        } else {
            let phase = Phase::Grasp;
            dense.push(time, row(&samples[0], &closed), object.configuration(start_q), phase);
        }
        let manipulation_start = dense.len() as u32 - 1;
        let limits = Limits::of(robot, &columns[..planned]);
        let intervals = (self.config.waypoints - 1) as f64;
        let substeps = self.config.substeps as f64;
        let even = self.config.duration_s / intervals;
        let interval = even * limits.stretch(samples, even / substeps).max(1.0);
        let manipulation_begin = time;
        for (k, x) in samples.iter().enumerate().skip(1) {
            let time = manipulation_begin + interval * k as f64 / substeps;
            dense.push(time, row(x, &closed), object.configuration(x[planned]), Phase::Manipulate);
        }
        let mut waypoints_robot = JointPath::new(columns.len());
        let mut waypoints_object = JointPath::new(object.tree.dof());
        for x in waypoints {
            waypoints_robot.push(row(x, &closed));
            waypoints_object.push(object.configuration(x[planned]));
        }
        Trajectory {
            id: self.identity(pair),
            seed,
            grasp: hold.grasp.clone(),
            start: start_q,
            goal: self.task.file.goal.positions[pair.goal_index],
            waypoints_robot,
            waypoints_object,
            waypoint_interval_s: interval,
            manipulation_start,
            substeps: self.config.substeps as u32,
            dense,
            verdict: None,
        }
    }

    fn pair_number(&self, pair: &Pair) -> u64 {
        let fields = [pair.hold, pair.start, pair.goal_index, pair.rank];
        fields.iter().fold(0, |number, &field| number << 16 | field as u64)
    }

    fn identity(&self, pair: &Pair) -> String {
        let config = serde_json::to_string(self.config).unwrap_or_default();
        let text = format!(
            "{:?}|{}|{}|{}|{config}",
            self.task.content_hashes,
            self.task.toml,
            self.task.file.seed,
            self.pair_number(pair)
        );
        hash::of_bytes(text.as_bytes())[..16].to_string()
    }

    fn header(&self) -> TrajectoryHeader {
        let task = self.task;
        let object = &task.object;
        let joint = |j: usize| object.tree.joints()[j].name.clone();
        TrajectoryHeader {
            task_toml: task.toml.clone(),
            task_dir: task.dir.display().to_string(),
            task_name: task.file.name.clone(),
            scene_id: task.scene.name.clone(),
            object_id: object.name.clone(),
            robot_id: task.robot.name.clone(),
            base_kind: task.robot.file.base.kind,
            content_hashes: task.content_hashes.clone(),
            robot_joints: task.robot.trajectory_joint_names(),
            object_joints: object.tree.dof_joints().iter().map(|&j| joint(j)).collect(),
            active_joint: joint(object.active_joint),
            contact_exceptions: self.preparation.exceptions.clone(),
            seed: task.file.seed,
            planner_config: serde_json::to_value(self.config).unwrap_or_default(),
            backend: "cpu".into(),
            counts: self.counts.clone(),
        }
    }
}

fn ik_seed(task: &Task, grasp: &Grasp, target_index: usize) -> u64 {
    stage_seed(task, "ik", u64::from(grasp.id) << 16 | target_index as u64)
}

/// A seed for one stage of a task: independent streams from one number.
fn stage_seed(task: &Task, stage: &str, index: u64) -> u64 {
    let text = format!("{}|{}|{stage}|{index}", task.file.seed, task.file.name);
    let digest = hash::of_bytes(text.as_bytes());
    u64::from_str_radix(&digest[..16], 16).unwrap_or(0)
}
