//! Each kernel of the graphics processor and its twin on the CPU, by the same tests; and a third implementation that is
//! wrong, which the same tests must tell.
//!
//! They run on whatever adapter there is, real or software. A missing one is a failure, not a skip.

#![allow(clippy::unwrap_used)] // helpers of tests

mod common;

use std::sync::OnceLock;

use akrobat_gpu::{AdapterKind, adapters};
use akrobat_judge::{Judge, JudgeConfig, RobotSphere};
use akrobat_model::events::Silent;
use akrobat_model::task::Task;
use akrobat_planner::akr::{self, Akr};
use akrobat_planner::closure::Closure;
use akrobat_planner::collision::{MovingCheck, Penalty, RobotBody};
use akrobat_planner::gpu::{Gpu, Session};
use akrobat_planner::ik::{self, Tool};
use akrobat_planner::kernels::Config;
use akrobat_planner::kernels::ik::BatchIk;
use akrobat_planner::kinematics::{Frame, Kinematics, MAX_VARIABLES};
use akrobat_planner::trajopt::{Problem, Waypoints};
use akrobat_planner::world::World;
use akrobat_planner::{Backend, PlanOutcome, PlannerConfig, Preparation, plan, plan_on};
use common::{frame_apart, numbers};
use nalgebra::Vector3;
use rand::RngExt;

/// Distances beyond which clearances are not told apart, metres.
const CLEARANCE_REACH_M: f64 = 0.02;

/// The kernels, on one of the two.
trait Kernels {
    fn forward(&self, kinematics: &Kinematics, configurations: &[Config]) -> Vec<Vec<Frame>>;
    fn distances(&self, points: &[Vector3<f64>]) -> Vec<(f64, Vector3<f64>)>;
    fn clearances(&self, q: f64, configurations: &[Config]) -> Vec<f64>;
    fn penalties(&self, problem: &Problem<'_>, configurations: &Waypoints) -> Vec<Penalty>;
    /// Ends and whether they converged.
    fn reach(&self, target: &Frame, seeds: &[Config]) -> Vec<(Config, bool)>;
    fn optimise(&self, problems: &[&Problem<'_>], paths: &[Waypoints]) -> Vec<Waypoints>;
}

/// Summit-Franka in front of what it opens.
struct Bench {
    task: Task,
    preparation: Preparation,
    judge: Judge,
    config: PlannerConfig,
    world: World,
    /// Without what it holds.
    kinematics: Kinematics,
    body: RobotBody,
    tool: Tool,
    /// Planned on the CPU.
    outcome: PlanOutcome,
}

/// Opened once: software drivers take long to compile the shaders.
fn backend() -> &'static Backend {
    static BACKEND: OnceLock<Backend> = OnceLock::new();
    BACKEND.get_or_init(|| Backend::wgpu().unwrap_or_else(|error| panic!("{error}")))
}

fn gpu() -> &'static Gpu {
    match backend() {
        Backend::Wgpu(gpu) => gpu,
        Backend::Cpu => panic!("the CPU was opened"),
    }
}

/// What slides and what turns; nothing where the shared inputs are absent.
const TASKS: [&str; 2] = ["summit_drawer_kitchen", "summit_refrigerator_empty"];

fn benches() -> &'static [Bench] {
    static BENCHES: OnceLock<Vec<Bench>> = OnceLock::new();
    let build = |name: &&str| {
        let task = common::task(name)?;
        let preparation = Preparation::new(&task).unwrap();
        let config = PlannerConfig { limit: 10, ..PlannerConfig::default() };
        let world = World::build(&task, &config);
        let robot = &task.robot;
        let variables = [&robot.base_joints[..], &robot.arm_joints].concat();
        let kinematics =
            Kinematics::compile(&robot.tree, &robot.world_from_root, &variables, &robot.rest);
        let (spheres, pairs) = (&preparation.spheres, &preparation.self_pairs);
        let body = RobotBody::new(robot, spheres, pairs, &kinematics);
        let tool = Tool::new(robot, &kinematics).unwrap();
        let judged: Vec<RobotSphere> = spheres
            .spheres
            .iter()
            .map(|s| RobotSphere { link: s.link, center: s.center, radius: s.radius })
            .collect();
        let judge =
            Judge::new(&task, &judged, &preparation.exceptions, JudgeConfig::default()).unwrap();
        let outcome =
            plan(&task, &preparation, &world, &config, &Silent, &|t| judge.judge(t)).unwrap();
        Some(Bench { task, preparation, judge, config, world, kinematics, body, tool, outcome })
    };
    BENCHES.get_or_init(|| TASKS.iter().filter_map(build).collect())
}

impl Bench {
    /// The robot near what it opens, its arm anywhere.
    fn configurations(&self, count: usize, seed: u64) -> Vec<Vec<f64>> {
        let mut rng = numbers(seed);
        // Columns after the planned ones are the fingers'.
        let mut start = self.outcome.set.trajectories[0].waypoints_robot.row_f64(0);
        start.truncate(self.kinematics.dof());
        let near = |_| {
            let mut x: Vec<f64> = start.iter().map(|v| v + rng.random_range(-0.4..=0.4)).collect();
            self.kinematics.clamp(&mut x);
            x
        };
        (0..count).map(near).collect()
    }
}

fn single(x: &[f64]) -> Config {
    let mut out = [0.0; MAX_VARIABLES];
    out.iter_mut().zip(x).for_each(|(out, x)| *out = *x as f32);
    out
}

fn double(x: &Config, count: usize) -> Vec<f64> {
    x[..count].iter().map(|&v| f64::from(v)).collect()
}

struct Cpu(&'static Bench);

impl Kernels for Cpu {
    fn forward(&self, kinematics: &Kinematics, configurations: &[Config]) -> Vec<Vec<Frame>> {
        let dof = kinematics.dof();
        let frames = |x: &Config| kinematics.forward(&double(x, dof)).frames[..dof].to_vec();
        configurations.iter().map(frames).collect()
    }

    fn distances(&self, points: &[Vector3<f64>]) -> Vec<(f64, Vector3<f64>)> {
        points.iter().map(|p| self.0.world.fixed.distance_and_gradient(p)).collect()
    }

    fn clearances(&self, q: f64, configurations: &[Config]) -> Vec<f64> {
        let Bench { kinematics, body, world, .. } = self.0;
        let clearance = |x: &Config| {
            let frames = kinematics.forward(&double(x, kinematics.dof()));
            body.clearance(&frames, world, q, MovingCheck::NotTool, f64::NEG_INFINITY).distance_m
        };
        configurations.iter().map(clearance).collect()
    }

    fn penalties(&self, problem: &Problem<'_>, configurations: &Waypoints) -> Vec<Penalty> {
        let penalty = |x: &Vec<f64>| {
            let mut out = Penalty::zero();
            let frames = problem.kinematics.forward(x);
            let (object, margin) = (x.len() - 1, problem.config.clearance_m);
            let (body, world) = (problem.body, problem.world);
            body.penalty(problem.kinematics, &frames, world, x, object, margin, &mut out);
            out
        };
        configurations.iter().map(penalty).collect()
    }

    fn reach(&self, target: &Frame, seeds: &[Config]) -> Vec<(Config, bool)> {
        let kernel = BatchIk::new(&self.0.kinematics, &self.0.tool);
        kernel.solve(target, seeds).iter().map(|s| (s.x, s.converged)).collect()
    }

    fn optimise(&self, problems: &[&Problem<'_>], paths: &[Waypoints]) -> Vec<Waypoints> {
        let mut paths = paths.to_vec();
        problems.iter().zip(&mut paths).for_each(|(problem, path)| problem.optimise(path));
        paths
    }
}

struct Device(&'static Bench, Session<'static>);

impl Kernels for Device {
    fn forward(&self, kinematics: &Kinematics, configurations: &[Config]) -> Vec<Vec<Frame>> {
        self.1.forward(kinematics, configurations).unwrap()
    }

    fn distances(&self, points: &[Vector3<f64>]) -> Vec<(f64, Vector3<f64>)> {
        self.1.distances(&self.0.kinematics, points).unwrap()
    }

    fn clearances(&self, q: f64, configurations: &[Config]) -> Vec<f64> {
        self.1.clearances(&self.0.kinematics, &self.0.body, q, configurations).unwrap()
    }

    fn penalties(&self, problem: &Problem<'_>, configurations: &Waypoints) -> Vec<Penalty> {
        self.1.penalties(problem, configurations).unwrap()
    }

    fn reach(&self, target: &Frame, seeds: &[Config]) -> Vec<(Config, bool)> {
        let Bench { kinematics, body, tool, .. } = self.0;
        let found = self.1.solve_ik(kinematics, body, tool, target, 0.0, seeds).unwrap();
        found.iter().map(|r| (r.solved.x, r.solved.converged)).collect()
    }

    fn optimise(&self, problems: &[&Problem<'_>], paths: &[Waypoints]) -> Vec<Waypoints> {
        let mut paths = self.1.optimise(problems, paths).unwrap();
        for (problem, path) in problems.iter().zip(&mut paths) {
            // In single precision, the constraint is held to this much already.
            let left = path.iter().skip(1).map(|x| residual(problem, x)).fold(0.0, f64::max);
            assert!(left < 5e-5, "{left}");
            assert!(problem.settle(path));
        }
        paths
    }
}

/// The CPU with small errors.
struct Spoiled(Cpu);

impl Kernels for Spoiled {
    fn forward(&self, kinematics: &Kinematics, configurations: &[Config]) -> Vec<Vec<Frame>> {
        let mut all = self.0.forward(kinematics, configurations);
        all.last_mut().unwrap().last_mut().unwrap().translation.x += 1e-4;
        all
    }

    fn distances(&self, points: &[Vector3<f64>]) -> Vec<(f64, Vector3<f64>)> {
        let mut all = self.0.distances(points);
        all.last_mut().unwrap().1 *= 0.9;
        all
    }

    fn clearances(&self, q: f64, configurations: &[Config]) -> Vec<f64> {
        self.0.clearances(q, configurations).iter().map(|d| d + 1e-4).collect()
    }

    fn penalties(&self, problem: &Problem<'_>, configurations: &Waypoints) -> Vec<Penalty> {
        let mut all = self.0.penalties(problem, configurations);
        all.iter_mut().for_each(|p| p.gradient[1] *= 1.02);
        all
    }

    fn reach(&self, target: &Frame, seeds: &[Config]) -> Vec<(Config, bool)> {
        let mut all = self.0.reach(target, seeds);
        all.iter_mut().find(|(_, converged)| *converged).unwrap().0[4] += 1e-3;
        all
    }

    fn optimise(&self, _: &[&Problem<'_>], paths: &[Waypoints]) -> Vec<Waypoints> {
        paths.to_vec()
    }
}

/// Runs a test on the twins, and on what must fail it.
fn on_each(test: impl Fn(&'static Bench, &dyn Kernels) -> Result<(), String>) {
    for bench in benches() {
        let name = &bench.task.file.name;
        let device = Device(bench, gpu().session(&bench.world).unwrap());
        test(bench, &Cpu(bench)).unwrap_or_else(|what| panic!("{name}, CPU: {what}"));
        test(bench, &device).unwrap_or_else(|what| panic!("{name}, device: {what}"));
        test(bench, &Spoiled(Cpu(bench))).expect_err("what is wrong was not told");
    }
}

fn ensure(holds: bool, otherwise: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(otherwise()) }
}

#[test]
fn every_shader_has_a_twin() {
    let crate_folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut shaders = 0;
    for shader in crate_folder.join("shaders").read_dir().unwrap() {
        let twin = shader.unwrap().path().with_extension("rs");
        let name = twin.file_name().unwrap();
        let source = crate_folder.join("src");
        let places = [source.join(name), source.join("kernels").join(name)];
        assert!(places.iter().any(|place| place.is_file()), "{name:?} is missing");
        shaders += 1;
    }
    assert!(shaders >= 5);
}

#[test]
fn a_software_adapter_is_taken_on_request_only() {
    let hardware = adapters().iter().any(|a| a.kind != AdapterKind::Software);
    assert_eq!(matches!(Backend::auto().unwrap(), Backend::Wgpu(_)), hardware);
    assert!(backend().to_string().starts_with("wgpu: "));
}

#[test]
fn forward_kinematics_agrees_with_the_model() {
    on_each(|bench, kernels| {
        let robot = &bench.task.robot;
        let all = bench.configurations(200, 1);
        let configurations: Vec<Config> = all.iter().map(|x| single(x)).collect();
        let found = kernels.forward(&bench.kinematics, &configurations);
        for (x, frames) in configurations.iter().zip(&found) {
            let q = robot.configuration(&double(x, bench.kinematics.dof()));
            let poses = robot.tree.link_poses(&robot.world_from_root, &q);
            for (link, pose) in poses.iter().enumerate() {
                let attachment = bench.kinematics.attachment(link);
                let Some(node) = attachment.node else { continue };
                let frame = frames[node].compose(&Frame::from(&attachment.node_from_link));
                let gap = frame_apart(&frame, pose);
                ensure(gap < 1e-5, || format!("link {link}: {gap}"))?;
            }
        }
        Ok(())
    });
}

#[test]
fn distances_are_trilinear() {
    on_each(|bench, kernels| {
        let field = &bench.world.fixed;
        let [nx, ny, _] = field.size();
        let mut rng = numbers(2);
        let size = Vector3::from(field.size().map(|n| n as f64));
        // In voxels: some beyond the grid.
        let draw = |_| size.map(|n| rng.random_range(-0.05 * n..1.05 * n));
        let places: Vec<Vector3<f64>> = (0..2000).map(draw).collect();
        // The weighted sum over eight corners, and its derivatives.
        let value = |u: &Vector3<f64>| {
            let u = u.zip_map(&size, |u, n| u.clamp(0.0, n - 1.0 - 1e-9));
            let base = u.map(f64::floor);
            (0..8).fold(0.0, |sum, corner| {
                let bit = |axis: usize| corner >> axis & 1;
                let weight: f64 = (0..3)
                    .map(|a| if bit(a) == 1 { u[a] - base[a] } else { 1.0 - (u[a] - base[a]) })
                    .product();
                let at = |axis: usize| base[axis] as usize + bit(axis);
                sum + weight * f64::from(field.values()[(at(2) * ny + at(1)) * nx + at(0)])
            })
        };
        let points: Vec<Vector3<f64>> =
            places.iter().map(|u| field.low() + u * field.voxel_m()).collect();
        let found = kernels.distances(&points);
        for (u, (distance, gradient)) in places.iter().zip(&found) {
            ensure((distance - value(u)).abs() < 1e-5, || format!("{u}: {distance}"))?;
            for axis in 0..3 {
                let h = 1e-3;
                let (mut low, mut high) = (*u, *u);
                low[axis] -= h;
                high[axis] += h;
                if low[axis].floor() != high[axis].floor() {
                    continue;
                }
                let slope = (value(&high) - value(&low)) / (2.0 * h * field.voxel_m());
                let got = gradient[axis];
                ensure((got - slope).abs() < 2e-3, || format!("{u} {axis}: {got} {slope}"))?;
            }
        }
        Ok(())
    });
}

#[test]
fn clearances_agree() {
    on_each(|bench, kernels| {
        let configurations: Vec<Config> =
            bench.configurations(400, 3).iter().map(|x| single(x)).collect();
        let expected = Cpu(bench).clearances(0.1, &configurations);
        let found = kernels.clearances(0.1, &configurations);
        let mut told = [0, 0];
        for (index, (expected, found)) in expected.iter().zip(&found).enumerate() {
            let (expected, found) = (expected.min(CLEARANCE_REACH_M), found.min(CLEARANCE_REACH_M));
            let gap = (expected - found).abs();
            ensure(gap < 1e-5, || format!("{index}: {found} instead of {expected}"))?;
            told[usize::from(expected < CLEARANCE_REACH_M)] += 1;
        }
        ensure(told.iter().all(|&n| n > 5), || format!("{told:?}"))
    });
}

/// What is needed to solve problems of one planned trajectory.
struct Held {
    akr: Akr,
    kinematics: Kinematics,
    body: RobotBody,
    closure: Closure,
    start: Vec<f64>,
    goal: Vec<f64>,
}

fn held(bench: &Bench, index: usize) -> Held {
    let (task, trajectory) = (&bench.task, &bench.outcome.set.trajectories[index]);
    let akr = akr::assemble(&task.robot, &task.object, &trajectory.grasp).unwrap();
    let root = &task.robot.world_from_root;
    let kinematics = Kinematics::compile(&akr.tree, root, &akr.variables, &akr.rest);
    let (spheres, pairs) = (&bench.preparation.spheres, &bench.preparation.self_pairs);
    let body = RobotBody::new(&task.robot, spheres, pairs, &kinematics);
    let closure = Closure::new(&akr, &kinematics, &task.object.world_from_root).unwrap();
    let end = |row: usize| {
        let object = trajectory.waypoints_object.row_f64(row);
        let column = task.object.tree.column(task.object.active_joint).unwrap();
        let mut x = trajectory.waypoints_robot.row_f64(row);
        x.truncate(bench.kinematics.dof());
        x.push(object[column]);
        assert!(closure.project(&kinematics, &mut x, &vec![1.0; kinematics.dof()], true));
        x
    };
    let (start, goal) = (end(0), end(trajectory.waypoints_robot.rows() - 1));
    Held { akr, kinematics, body, closure, start, goal }
}

impl Held {
    fn problem<'a>(&'a self, bench: &'a Bench) -> Problem<'a> {
        let dof = self.kinematics.dof();
        assert_eq!(dof, self.akr.variables.len());
        Problem {
            kinematics: &self.kinematics,
            closure: &self.closure,
            body: &self.body,
            world: &bench.world,
            config: &bench.config,
            velocity_weights: Problem::weights(bench.config.velocity_weights, 3, dof),
            acceleration_weights: Problem::weights(bench.config.acceleration_weights, 3, dof),
            mobility: vec![1.0; dof],
        }
    }
}

/// How far (m, rad) the object's root is from its place.
fn residual(problem: &Problem<'_>, x: &[f64]) -> f64 {
    problem.closure.error(&problem.kinematics.forward(x)).amax()
}

#[test]
fn penalties_agree() {
    on_each(|bench, kernels| {
        let held = held(bench, 0);
        let problem = held.problem(bench);
        let configurations: Waypoints = bench
            .configurations(100, 4)
            .into_iter()
            .map(|mut x| {
                x.push(0.1);
                double(&single(&x), held.kinematics.dof())
            })
            .collect();
        let expected = Cpu(bench).penalties(&problem, &configurations);
        let found = kernels.penalties(&problem, &configurations);
        for (expected, found) in expected.iter().zip(&found) {
            let close = |a: f64, b: f64, scale: f64| (a - b).abs() < 1e-4 + 1e-3 * scale;
            let worst = (expected.gradient - found.gradient).amax();
            let holds = close(expected.cost, found.cost, expected.cost)
                && (expected.largest - found.largest).abs() < 1e-5
                && close(worst, 0.0, expected.gradient.amax())
                && close((expected.hessian - found.hessian).amax(), 0.0, expected.hessian.amax());
            ensure(holds, || format!("{} {} gradient off by {worst}", expected.cost, found.cost))?;
        }
        let touching = expected.iter().filter(|p| p.cost > 0.0).count();
        ensure(touching > 20, || format!("{touching} of {}", expected.len()))
    });
}

#[test]
fn what_converged_is_at_the_target() {
    on_each(|bench, kernels| {
        let Bench { kinematics, tool, .. } = bench;
        let (mut converged, mut by_scalar) = (0, 0);
        for (index, goal) in bench.configurations(4, 5).iter().enumerate() {
            let target = tool.frame(&kinematics.forward(goal));
            let seeds: Vec<Config> =
                bench.configurations(60, 10 + index as u64).iter().map(|x| single(x)).collect();
            for seed in &seeds {
                let mut x = double(seed, kinematics.dof());
                by_scalar += usize::from(ik::solve(kinematics, tool, &target, &mut x, 0));
            }
            for (x, _) in kernels.reach(&target, &seeds).iter().filter(|(_, converged)| *converged)
            {
                let x = double(x, kinematics.dof());
                let error = ik::pose_error(&tool.frame(&kinematics.forward(&x)), &target).amax();
                ensure(error < 2e-4, || format!("{error}"))?;
                ensure(kinematics.within_limits(&x, -1e-6), || format!("{x:?}"))?;
                converged += 1;
            }
        }
        ensure(10 * converged > 9 * by_scalar, || format!("{converged} of {by_scalar}"))
    });
}

#[test]
fn optimised_paths_are_as_good() {
    on_each(|bench, kernels| {
        let helds: Vec<Held> = (0..6).map(|index| held(bench, index)).collect();
        let problems: Vec<Problem<'_>> = helds.iter().map(|h| h.problem(bench)).collect();
        let problems: Vec<&Problem<'_>> = problems.iter().collect();
        let begun: Vec<Waypoints> = problems
            .iter()
            .zip(&helds)
            .map(|(problem, held)| problem.straight(&held.start, &held.goal).unwrap())
            .collect();
        let expected = Cpu(bench).optimise(&problems, &begun);
        let found = kernels.optimise(&problems, &begun);
        for (index, problem) in problems.iter().enumerate() {
            ensure(found[index][0] == begun[index][0], || "the start has moved".into())?;
            let last = begun[index].len() - 1;
            let object = found[index][last].len() - 1;
            let moved = (found[index][last][object] - begun[index][last][object]).abs();
            ensure(moved < 1e-6, || format!("the goal has moved by {moved}"))?;
            for x in &found[index] {
                let left = residual(problem, x);
                ensure(left < 1e-6, || format!("residual {left}"))?;
            }
            let [(cost, hinge), (least, deepest)] =
                [&found, &expected].map(|paths| problem.cost(&paths[index]));
            ensure(cost < 1.05 * least + 0.01, || format!("{index}: cost {cost} after {least}"))?;
            ensure(hinge < deepest + 1e-3, || format!("{index}: hinge {hinge} after {deepest}"))?;
        }
        Ok(())
    });
}

#[test]
fn a_plan_on_the_device_is_as_good_as_one_on_the_cpu() {
    for (index, bench) in benches().iter().enumerate() {
        let Bench { task, preparation, world, config, judge, outcome, .. } = bench;
        let judge_one = |t: &_| judge.judge(t);
        let planned =
            || plan_on(backend(), task, preparation, world, config, &Silent, &judge_one).unwrap();
        let found = planned();
        let wanted = &outcome.set.trajectories;
        let trajectories = &found.set.trajectories;
        assert_eq!(trajectories.len(), wanted.len(), "{:?}", found.counts);
        for trajectory in trajectories {
            let verdict = judge.judge(trajectory);
            assert!(verdict.accepted(), "{}: {}", trajectory.id, verdict.detail);
        }
        // Nearly all are of the same pairs of start and goal.
        let shared = trajectories.iter().filter(|t| wanted.iter().any(|w| w.id == t.id)).count();
        assert!(10 * shared >= 8 * wanted.len(), "{shared} of {}", wanted.len());
        if index == 0 {
            assert_eq!(planned().set, found.set, "the same seed gave other bytes");
        }
    }
}
