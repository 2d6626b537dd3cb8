//! Trajectories that hold an anchor between given starts and goals, one thread, as one JSON object on stdout.
//!
//!     constrained_bench QUERIES.json [ROUNDS]
//!
//! The file: `{"task": TASK.toml, "assets": [DIR …], "queries": [{"link": NAME, "link_from_tool": [x, y, z, qw, qx, qy, qz],
//! "width_m": W, "start": [q …], "goal": [q …]} …]}`; a start and a goal are configurations of the AKR (base, arm, the
//! object's joint). For each query: the samples of its dense path, or why there is none, and the mean CPU time of the rounds.
//! `benchmarks/planner/constrained.py` gives others the same.

use std::path::{Path, PathBuf};

use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::Task;
use akrobat_model::trajectory::Grasp;
use akrobat_model::{Pose, pose};
use akrobat_planner::akr;
use akrobat_planner::closure::Closure;
use akrobat_planner::collision::{MovingCheck, RobotBody};
use akrobat_planner::dense;
use akrobat_planner::kinematics::Kinematics;
use akrobat_planner::trajopt::{Problem, Waypoints};
use akrobat_planner::world::World;
use akrobat_planner::{PlannerConfig, Preparation};
use serde::Deserialize;
use serde_json::json;

#[path = "common/cpu_time.rs"]
mod cpu_time;
use cpu_time::cpu_seconds;

type Error = Box<dyn std::error::Error>;

#[derive(Deserialize)]
struct Input {
    task: PathBuf,
    assets: Vec<PathBuf>,
    queries: Vec<Query>,
}

#[derive(Deserialize)]
struct Query {
    link: String,
    link_from_tool: [f64; 7],
    width_m: f64,
    start: Vec<f64>,
    goal: Vec<f64>,
}

/// What all queries of a task share.
struct Bench {
    task: Task,
    preparation: Preparation,
    world: World,
    config: PlannerConfig,
}

/// What one grasp adds to that.
struct Held {
    kinematics: Kinematics,
    body: RobotBody,
    closure: Closure,
}

impl Bench {
    fn hold(&self, query: &Query) -> Result<Held, Error> {
        let link_from_tool: Pose =
            pose::from_xyz_wxyz(query.link_from_tool).ok_or("link_from_tool: expected a pose")?;
        let (link, width_m) = (query.link.clone(), query.width_m);
        let grasp = Grasp { id: 0, link, link_from_tool, width_m };
        let (robot, object) = (&self.task.robot, &self.task.object);
        let akr = akr::assemble(robot, object, &grasp)?;
        let kinematics =
            Kinematics::compile(&akr.tree, &robot.world_from_root, &akr.variables, &akr.rest);
        let Preparation { spheres, self_pairs, .. } = &self.preparation;
        let body = RobotBody::new(robot, spheres, self_pairs, &kinematics);
        let closure = Closure::new(&akr, &kinematics, &object.world_from_root)
            .ok_or("no variable moves the object's root")?;
        Ok(Held { kinematics, body, closure })
    }

    fn problem<'a>(&'a self, held: &'a Held) -> Problem<'a> {
        let (dof, base) = (held.kinematics.dof(), self.task.robot.base_joints.len());
        Problem {
            kinematics: &held.kinematics,
            closure: &held.closure,
            body: &held.body,
            world: &self.world,
            config: &self.config,
            velocity_weights: Problem::weights(self.config.velocity_weights, base, dof),
            acceleration_weights: Problem::weights(self.config.acceleration_weights, base, dof),
            mobility: vec![1.0; dof],
        }
    }

    /// The dense path of a query, or why there is none.
    fn solve(&self, problem: &Problem<'_>, query: &Query) -> Result<Waypoints, &'static str> {
        let mut ends = [query.start.clone(), query.goal.clone()];
        for end in &mut ends {
            let (kinematics, mobility) = (problem.kinematics, &problem.mobility);
            if !problem.closure.project(kinematics, end, mobility, true) {
                return Err("start or goal is off the constraint");
            }
        }
        let least = self.config.min_clearance_m;
        let is_free = |x: &Vec<f64>| {
            let frames = problem.kinematics.forward(x);
            let (q, moving) = (x[x.len() - 1], MovingCheck::NotTool);
            problem.body.clearance(&frames, problem.world, q, moving, least).distance_m >= least
        };
        if !ends.iter().all(is_free) {
            return Err("start or goal touches something");
        }
        let [start, goal] = &ends;
        let mut path = problem.straight(start, goal).ok_or("projection")?;
        problem.optimise(&mut path);
        let dense = dense::densify(problem, &path, self.config.substeps).ok_or("dense path")?;
        if dense.iter().all(is_free) { Ok(dense) } else { Err("collision") }
    }
}

fn main() -> Result<(), Error> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, rest @ ..] = &arguments[..] else {
        return Err("usage: constrained_bench QUERIES.json [ROUNDS]".into());
    };
    let rounds: usize = rest.first().map_or(Ok(1), |text| text.parse())?;
    let input: Input = serde_json::from_str(&std::fs::read_to_string(Path::new(file))?)?;
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global()?;
    let started = cpu_seconds();
    let task = load::task(&input.task, &AssetSearch { folders: input.assets })?;
    let config = PlannerConfig::default();
    let preparation = Preparation::new(&task)?;
    let world = World::build(&task, &config);
    let bench = Bench { task, preparation, world, config };
    let setup_s = cpu_seconds() - started;
    let mut answers = Vec::new();
    for query in &input.queries {
        let held = bench.hold(query)?;
        let problem = bench.problem(&held);
        let started = cpu_seconds();
        let mut found = Err("no round");
        for _ in 0..rounds {
            found = bench.solve(&problem, query);
        }
        let cpu_s = (cpu_seconds() - started) / rounds as f64;
        let reason = found.as_ref().err().copied();
        answers.push(json!({"path": found.ok(), "reason": reason, "cpu_s": cpu_s}));
    }
    println!("{}", json!({"setup_cpu_s": setup_s, "answers": answers}));
    Ok(())
}
