//! Rigid objects: picked up, carried through free space with the object in the hand, put down, let go.
//!
//! While it is held the object is a link of the robot; its virtual joints follow from the tool's pose. The
//! hand lifts it straight up and lowers it straight down, with free motion between.

use std::sync::OnceLock;

use akrobat_model::task::Task;
use akrobat_model::trajectory::Grasp;
use akrobat_model::{KinematicTree, Link, Part, Pose, Robot, free_object, pose};
use nalgebra::Vector3;

use super::timeline::Leg;
use super::{JudgeFn, Outcome, PlanError, PlanOutcome, Run, StepClock, Work, stage_seed};
use crate::akr;
use crate::approach::{Approach, ApproachPlanner, STEP_S, Timed};
use crate::cluster;
use crate::collision::{LinkPairs, MovingCheck, RobotBody};
use crate::grasp;
use crate::ik::{self, Effort, Tool};
use crate::kinematics::{Frame, Kinematics};
use crate::spheres::{self, Sphere, SphereModel};
use crate::trajopt::Waypoints;
use crate::world::{World, handle_center, outward};

/// Heights that the object is lifted by, metres: the lowest that is free.
const LIFTS_M: [f64; 3] = [0.06, 0.1, 0.16];
/// Steps of straight motions up and down.
const LIFT_STEPS: usize = 12;
/// Dense samples from one waypoint to the next, at least: arms swing far while they carry.
const LEAST_SUBSTEPS: usize = 10;
/// Configurations kept for each grasp at each end.
const ENDS: usize = 8;
/// A position of the first virtual joint at which the object is out of everyone's way, metres.
const AWAY: f64 = 1e4;
/// Edge of the voxels that the held object's spheres are fitted with, metres.
const HELD_VOXEL_M: f64 = 0.02;

/// One end of the way: the object there, and the fields around it.
struct Station {
    task: Task,
    world: World,
    world_from_body: Pose,
    /// Position of the first virtual joint.
    object_q: f64,
}

/// A grasp with its configurations at the start and at each goal.
struct RigidHold {
    grasp: Grasp,
    starts: Vec<Vec<f64>>,
    goals: Vec<Vec<Vec<f64>>>,
    approaches: Vec<OnceLock<Result<Approach, &'static str>>>,
    /// The robot with the object in its hand.
    holding: Robot,
    spheres: SphereModel,
    pairs: LinkPairs,
    /// The object's body in the tool frame.
    tool_from_body: Pose,
}

struct RigidPair {
    hold: usize,
    start: usize,
    goal_index: usize,
    goal: usize,
}

impl Station {
    /// The object at `world_from_body`. `world` was built with it at `start`.
    fn new(task: &Task, world: &World, start: &Pose, world_from_body: &Pose) -> Self {
        let mut moved = task.clone();
        let tree = &task.object.tree;
        let kind = task.file.object.kind;
        let positions = free_object::positions(kind, world_from_body);
        for (name, position) in free_object::joint_names(kind).iter().zip(positions) {
            if let Some(column) = tree.joint_index(name).ok().and_then(|j| tree.column(j)) {
                moved.object.start[column] = position;
            }
        }
        let mut world = world.clone();
        let column = tree.column(task.object.active_joint).unwrap_or(0);
        let (before, object_q) = (task.object.start[column], moved.object.start[column]);
        // The field was sampled around the first virtual joint's link at the start.
        let carried = world_from_body * start.inverse();
        let first = carried * Pose::translation(before, 0.0, 0.0);
        world.joint.world_from_joint =
            Frame::from(&(first * Pose::translation(-object_q, 0.0, 0.0)));
        moved.file.goal.start = object_q;
        Self { task: moved, world, world_from_body: *world_from_body, object_q }
    }
}

/// Plans a rigid task.
pub(super) fn plan_rigid(
    mut run: Run<'_>,
    world: &World,
    judge: &JudgeFn<'_>,
) -> Result<PlanOutcome, PlanError> {
    let (task, config) = (run.task, run.config);
    let tree = &task.object.tree;
    let body = free_object::body_link(tree);
    let start_pose = tree.link_poses(&task.object.world_from_root, &task.object.start)[body];
    let start = Station::new(task, world, &start_pose, &start_pose);
    let poses = task.file.goal.poses.iter().filter_map(|goal| pose::from_xyz_wxyz(*goal));
    let goals: Vec<Station> =
        poses.map(|goal| Station::new(task, world, &start_pose, &goal)).collect();
    let holds = run.stage("grasps", |run| rigid_holds(run, &start, &goals))?;
    run.count("grasps/used", holds.len());
    let pairs = pairs(&holds, goals.len(), config.pairs_per_grasp);
    run.count("pairs", pairs.len());
    let (mut trajectories, mut notes) = (Vec::new(), Vec::new());
    let mut found = super::Found { trajectories: &mut trajectories, notes: &mut notes };
    let connect =
        |run: &Run<'_>, pair: &RigidPair, _: Option<&Waypoints>, steps: &mut StepClock| {
            let hold = &holds[pair.hold];
            connect(run, &start, &goals[pair.goal_index], hold, pair, judge, steps)
        };
    run.collect("carrying", &pairs, config.limit, &mut found, &Work::one_by_one(&connect))?;
    Ok(run.outcome(trajectories, notes))
}

/// Grasps within reach at the start and at a goal, with their configurations.
fn rigid_holds(
    run: &mut Run<'_>,
    start: &Station,
    goals: &[Station],
) -> Result<Vec<RigidHold>, PlanError> {
    let task = run.task;
    let wanted = task.file.grasps.count;
    let seed = stage_seed(task, "grasps", 0);
    let spheres = &run.preparation.spheres;
    let (fitting, tried) = grasp::grasps(task, spheres, seed, 6 * wanted);
    run.count("grasps/candidates", tried);
    run.count("grasps/fitting", fitting.len());
    let held = held_link(task);
    let mut holds = Vec::new();
    for grasp in fitting {
        if run.observer.cancelled() {
            return Err(PlanError::Cancelled);
        }
        if holds.len() == wanted {
            break;
        }
        let starts = configurations(run, start, &grasp, 0)?;
        if starts.is_empty() {
            run.count("grasps/without_start", 1);
            continue;
        }
        let mut ends = Vec::new();
        for (index, goal) in goals.iter().enumerate() {
            ends.push(configurations(run, goal, &grasp, index + 1)?);
        }
        if ends.iter().all(Vec::is_empty) {
            run.count("grasps/without_goal", 1);
            continue;
        }
        let id = holds.len() as u32;
        holds.push(RigidHold::new(run, &held, Grasp { id, ..grasp }, starts, ends)?);
    }
    Ok(holds)
}

/// Clustered free configurations that hold the object at a station.
fn configurations(
    run: &mut Run<'_>,
    station: &Station,
    grasp: &Grasp,
    index: usize,
) -> Result<Vec<Vec<f64>>, PlanError> {
    let seeds = run.config.ik_seeds;
    let batch = {
        let there = Run::new(&station.task, run.preparation, run.config, run.observer);
        let akr = akr::assemble(&station.task.robot, &station.task.object, grasp)?;
        let effort = Effort { seeds, enough: 4 * ENDS };
        there.solve(&station.world, &akr, grasp, station.object_q, index, effort)?
    };
    run.count("ik/seeds", batch.seeds);
    run.count("ik/solved", batch.solved);
    run.count("ik/free", batch.accepted.len());
    let found = batch.accepted;
    let Some(first) = found.first() else { return Ok(Vec::new()) };
    let weights = vec![1.0; first.len()];
    let seed = stage_seed(run.task, "ik", u64::from(grasp.id) << 16 | index as u64);
    let chosen = cluster::representatives(&found, &weights, ENDS.min(5), ENDS, 200, seed);
    Ok(chosen.into_iter().map(|i| found[i].clone()).collect())
}

/// The whole object as one link, in its body's frame.
fn held_link(task: &Task) -> Link {
    let object = &task.object;
    let poses = object.tree.link_poses(&object.world_from_root, &object.start);
    let body = poses[free_object::body_link(&object.tree)].inverse();
    let parts = object.tree.links().iter().zip(&poses).flat_map(|(link, world_from_link)| {
        let parts = if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
        parts.iter().map(move |part| Part {
            link_from_part: body * world_from_link * part.link_from_part,
            ..part.clone()
        })
    });
    Link { name: "held object".into(), collisions: parts.collect(), ..Link::default() }
}

impl RigidHold {
    fn new(
        run: &Run<'_>,
        held: &Link,
        grasp: Grasp,
        starts: Vec<Vec<f64>>,
        goals: Vec<Vec<Vec<f64>>>,
    ) -> Result<Self, PlanError> {
        let task = run.task;
        let (robot, object) = (&task.robot, &task.object);
        let poses = object.tree.link_poses(&object.world_from_root, &object.start);
        let body_from_link = poses[free_object::body_link(&object.tree)].inverse()
            * poses[object.tree.link_index(&grasp.link)?];
        let tool_from_body = (body_from_link * grasp.link_from_tool).inverse();
        let lone = KinematicTree::new("held".into(), vec![held.clone()], Vec::new())?;
        let mut model = run.preparation.spheres.clone();
        let link = robot.tree.links().len();
        let fitted = spheres::fit(&lone, Some(HELD_VOXEL_M)).spheres;
        model.spheres.extend(fitted.into_iter().map(|sphere| Sphere { link, ..sphere }));
        let mut holding = robot.clone();
        let place = robot.link_from_tool * tool_from_body;
        holding.tree = robot.tree.clone().attach(robot.tool_link, place, lone)?;
        for (&joint, q) in robot.gripper_joints.iter().zip(robot.finger_positions(grasp.width_m)) {
            if let Some(column) = robot.tree.column(joint) {
                holding.rest[column] = q;
            }
        }
        // What is rigid with the hand touches the object as the grasp has it.
        let rigid = |l: usize| {
            let moving = |joint: &usize| {
                robot.arm_joints.contains(joint) || robot.base_joints.contains(joint)
            };
            let chain = |l: usize| -> Vec<usize> {
                robot.tree.chain_to(l).into_iter().filter(moving).collect()
            };
            chain(l) == chain(robot.tool_link)
        };
        let mut pairs = run.preparation.self_pairs.clone();
        pairs.extend((0..link).filter(|&l| !rigid(l)).map(|l| (l, link)));
        Ok(Self {
            approaches: starts.iter().map(|_| OnceLock::new()).collect(),
            grasp,
            starts,
            goals,
            holding,
            spheres: model,
            pairs,
            tool_from_body,
        })
    }
}

/// Pairs of start and goal configurations, near ones first, so that grasps and goals take turns.
fn pairs(holds: &[RigidHold], goals: usize, most: usize) -> Vec<RigidPair> {
    let mut ranked: Vec<(usize, usize, RigidPair)> = Vec::new();
    for (hold_index, hold) in holds.iter().enumerate() {
        for goal_index in 0..goals {
            let mut own: Vec<(f64, usize, usize)> = Vec::new();
            for (start, x) in hold.starts.iter().enumerate() {
                for (goal, y) in hold.goals[goal_index].iter().enumerate() {
                    let distance = x.iter().zip(y).map(|(a, b)| (a - b) * (a - b)).sum();
                    own.push((distance, start, goal));
                }
            }
            own.sort_by(|a, b| a.0.total_cmp(&b.0));
            own.truncate(most);
            ranked.extend(own.into_iter().enumerate().map(|(rank, (_, start, goal))| {
                (rank, goal_index, RigidPair { hold: hold_index, start, goal_index, goal })
            }));
        }
    }
    ranked.sort_by_key(|(rank, goal_index, pair)| (*rank, *goal_index, pair.hold));
    ranked.into_iter().map(|(_, _, pair)| pair).collect()
}

/// Carries the object from one configuration to another and has the result judged.
fn connect(
    run: &Run<'_>,
    start: &Station,
    goal: &Station,
    hold: &RigidHold,
    pair: &RigidPair,
    judge: &JudgeFn<'_>,
    steps: &mut StepClock,
) -> Outcome {
    let key = format!("rigid {} {} {} {}", pair.hold, pair.start, pair.goal_index, pair.goal);
    let seed = stage_seed(run.task, &key, 0);
    let (from, to) = (&hold.starts[pair.start], &hold.goals[pair.goal_index][pair.goal]);
    let failed = |reason| Outcome::Failed(reason, String::new());
    let plan =
        || run.with_open_hand(&start.world, start.object_q, |planner| planner.plan(from, seed));
    let approach = match hold.approaches[pair.start].get_or_init(plan) {
        Ok(approach) => Some(approach),
        Err(reason) => return failed(reason),
    };
    let release = run.with_open_hand(&goal.world, goal.object_q, |planner| planner.retreat(to));
    steps.lap("approach");
    let release = match release {
        Ok(release) => release,
        Err(_) => return failed("retreat"),
    };
    let knots = match carry(run, &start.world, hold, from, to, seed) {
        Ok(knots) => knots,
        Err(reason) => return failed(reason),
    };
    steps.lap("carry");
    let samples = sampled(run, from, &knots);
    let leg = leg(run, hold, goal, samples, release);
    let goal_x = goal.world_from_body.translation.x;
    let trajectory =
        run.trajectory(&key, seed, goal_x, vec![leg], approach.filter(|_| run.config.approach));
    let verdict = judge(&trajectory);
    steps.lap("judge");
    Outcome::Judged(Box::new(trajectory), verdict)
}

/// Timed samples from one hold to another with the object in the hand: up, across, down.
fn carry(
    run: &Run<'_>,
    world: &World,
    hold: &RigidHold,
    from: &[f64],
    to: &[f64],
    seed: u64,
) -> Result<Timed, &'static str> {
    let robot = &hold.holding;
    let variables = [&robot.base_joints[..], &robot.arm_joints].concat();
    let kinematics =
        Kinematics::compile(&robot.tree, &robot.world_from_root, &variables, &robot.rest);
    let body = RobotBody::new(robot, &hold.spheres, &hold.pairs, &kinematics);
    let tool = Tool::new(robot, &kinematics).ok_or("lift")?;
    let handle = handle_center(&run.task.object);
    let planner = ApproachPlanner {
        robot,
        kinematics: &kinematics,
        body: &body,
        tool: &tool,
        world,
        config: run.config,
        object_q: AWAY,
        outward: outward(&run.task.object, &handle),
    };
    let free = |x: &[f64]| {
        let least = run.config.min_clearance_m;
        let frames = kinematics.forward(x);
        body.clearance(&frames, world, AWAY, MovingCheck::All, least).distance_m >= least
    };
    let lift = |x: &[f64]| {
        LIFTS_M.iter().find_map(|&height| {
            let path = straight_up(&kinematics, &tool, x, height, robot.base_joints.len())?;
            path.last().is_some_and(|top| free(top)).then_some(path)
        })
    };
    let up = lift(from).ok_or("lift")?;
    let mut down = lift(to).ok_or("lower")?;
    down.reverse();
    let across = planner.across(&up[up.len() - 1], &down[0], seed).map_err(|_| "carry_path")?;
    Ok([planner.timed(&up), across, planner.timed(&down)].concat())
}

/// Configurations that lift the tool straight up by `height`, the base at rest.
fn straight_up(
    kinematics: &Kinematics,
    tool: &Tool,
    x: &[f64],
    height: f64,
    base: usize,
) -> Option<Vec<Vec<f64>>> {
    let at = tool.frame(&kinematics.forward(x));
    let mut path = vec![x.to_vec()];
    for step in 1..=LIFT_STEPS {
        let up = Vector3::z() * (height * step as f64 / LIFT_STEPS as f64);
        let target = Frame { translation: at.translation + up, ..at };
        let mut next = path[step - 1].clone();
        ik::solve(kinematics, tool, &target, &mut next, base).then_some(())?;
        let jump = next.iter().zip(&path[step - 1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        (jump < 0.3).then_some(())?;
        path.push(next);
    }
    Some(path)
}

/// The motion at equal times: as many samples as waypoints and substeps ask for.
fn sampled(run: &Run<'_>, from: &[f64], motion: &Timed) -> Vec<Vec<f64>> {
    let count = (run.config.waypoints - 1) * run.config.substeps.max(LEAST_SUBSTEPS);
    let mut times = vec![0.0];
    let mut configurations = vec![from];
    for (dt, x) in motion {
        times.push(times[times.len() - 1] + dt);
        configurations.push(x);
    }
    let duration = times[times.len() - 1];
    let at = |k: usize| -> Vec<f64> {
        let time = duration * k as f64 / count as f64;
        let after = times.partition_point(|&t| t < time).clamp(1, times.len() - 1);
        let s = ((time - times[after - 1]) / (times[after] - times[after - 1])).clamp(0.0, 1.0);
        let pair = configurations[after - 1].iter().zip(configurations[after]);
        pair.map(|(a, b)| a + (b - a) * s).collect()
    };
    let mut samples: Vec<Vec<f64>> = (0..=count).map(at).collect();
    // Linear pieces have corners: a moving average rounds them off and keeps both ends.
    let window = (duration / count as f64 / STEP_S).recip().ceil().clamp(1.0, 4.0) as usize;
    for _ in 0..2 {
        samples = smoothed(&samples, window);
    }
    samples
}

/// Each sample replaced by the mean of those up to `reach` away on both sides, as far as the ends allow.
fn smoothed(samples: &[Vec<f64>], reach: usize) -> Vec<Vec<f64>> {
    let last = samples.len() - 1;
    let mean = |k: usize| -> Vec<f64> {
        let reach = reach.min(k).min(last - k);
        let near = &samples[k - reach..=k + reach];
        (0..samples[k].len())
            .map(|i| near.iter().map(|x| x[i]).sum::<f64>() / near.len() as f64)
            .collect()
    };
    (0..=last).map(mean).collect()
}

/// The samples with the object where the tool has it.
fn leg<'h>(
    run: &Run<'_>,
    hold: &'h RigidHold,
    goal: &Station,
    samples: Vec<Vec<f64>>,
    release: Timed,
) -> Leg<'h> {
    let task = run.task;
    let (robot, object) = (&task.robot, &task.object);
    let kind = task.file.object.kind;
    let columns: Vec<Option<usize>> = free_object::joint_names(kind)
        .iter()
        .map(|name| object.tree.joint_index(name).ok().and_then(|j| object.tree.column(j)))
        .collect();
    let mut before = object.start.clone();
    let mut objects = Vec::with_capacity(samples.len());
    for (k, x) in samples.iter().enumerate() {
        let fingers = robot.finger_positions(hold.grasp.width_m);
        let q = robot.configuration(&[&x[..], &fingers].concat());
        let links = robot.tree.link_poses(&robot.world_from_root, &q);
        let world_from_tool = links[robot.tool_link] * robot.link_from_tool;
        let mut row = before.clone();
        if k > 0 {
            let body = world_from_tool * hold.tool_from_body;
            let body = if k + 1 == samples.len() { goal.world_from_body } else { body };
            for (column, position) in columns.iter().zip(free_object::positions(kind, &body)) {
                let Some(column) = *column else { continue };
                let turns = ((before[column] - position) / std::f64::consts::TAU).round();
                let angle = column_turns(object, column);
                row[column] =
                    if angle { position + turns * std::f64::consts::TAU } else { position };
            }
        }
        before.clone_from(&row);
        objects.push(row);
    }
    let substeps = run.config.substeps.max(LEAST_SUBSTEPS);
    Leg {
        grasp: &hold.grasp,
        transfer: None,
        waypoints: samples.iter().step_by(substeps).cloned().collect(),
        samples,
        objects,
        release: Some(release),
    }
}

/// True where a column of the object is an angle.
fn column_turns(object: &akrobat_model::task::ManipulatedObject, column: usize) -> bool {
    let joint = object.tree.dof_joints()[column];
    object.tree.joints()[joint].kind != akrobat_model::JointKind::Prismatic
}
