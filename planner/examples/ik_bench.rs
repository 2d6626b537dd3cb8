//! Batch inverse kinematics on targets from a JSON file, one thread, as one JSON object on stdout.
//!
//!     ik_bench TARGETS.json [ROUNDS]
//!
//! The file: `{"robot": ROBOT.toml, "assets": [DIR …], "seeds": N, "tolerance": [m, rad],
//! "targets": [[x, y, z, qw, qx, qy, qz] …], "starts": [[[q …] N] …]}`; targets are poses of the tool in the world, starts are
//! N configurations (base and arm) for each. A target counts as solved where one of its starts leads to the tolerance
//! within the limits; starts are taken in order until one does. Seconds are the mean of the rounds.
//! `benchmarks/planner/peers.py` gives others the same.

use std::path::{Path, PathBuf};

use akrobat_model::load::{self, AssetSearch};
use akrobat_model::pose::from_xyz_wxyz;
use akrobat_planner::ik::{self, Tool};
use akrobat_planner::kinematics::{Frame, Kinematics};
use serde::Deserialize;
use serde_json::json;

#[path = "common/cpu_time.rs"]
mod cpu_time;
use cpu_time::cpu_seconds;

#[derive(Deserialize)]
struct Input {
    robot: PathBuf,
    assets: Vec<PathBuf>,
    tolerance: [f64; 2],
    targets: Vec<[f64; 7]>,
    starts: Vec<Vec<Vec<f64>>>,
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, rest @ ..] = &arguments[..] else {
        return Err("usage: ik_bench TARGETS.json [ROUNDS]".into());
    };
    let rounds: usize = rest.first().map_or(Ok(1), |text| text.parse())?;
    let input: Input = serde_json::from_str(&std::fs::read_to_string(Path::new(file))?)?;
    let robot = load::robot(&input.robot, &AssetSearch { folders: input.assets.clone() })?;
    let variables = [&robot.base_joints[..], &robot.arm_joints].concat();
    let kinematics =
        Kinematics::compile(&robot.tree, &robot.world_from_root, &variables, &robot.rest);
    let tool = Tool::new(&robot, &kinematics).ok_or("no variable moves the tool")?;
    let targets: Vec<Frame> = input
        .targets
        .iter()
        .map(|values| from_xyz_wxyz(*values).map(|pose| Frame::from(&pose)).ok_or("bad pose"))
        .collect::<Result<_, _>>()?;
    let within = |x: &[f64], target: &Frame| {
        let error = ik::pose_error(&tool.frame(&kinematics.forward(x)), target);
        error.fixed_rows::<3>(0).norm() <= input.tolerance[0]
            && error.fixed_rows::<3>(3).norm() <= input.tolerance[1]
            && kinematics.within_limits(x, -1e-9)
    };
    let mut solutions: Vec<Option<Vec<f64>>> = Vec::new();
    let mut attempts = 0;
    let started = cpu_seconds();
    for _ in 0..rounds {
        solutions.clear();
        attempts = 0;
        for (target, starts) in targets.iter().zip(&input.starts) {
            let solution = starts.iter().find_map(|start| {
                attempts += 1;
                let mut x = start.clone();
                ik::solve(&kinematics, &tool, target, &mut x, 0);
                within(&x, target).then_some(x)
            });
            solutions.push(solution);
        }
    }
    let seconds = (cpu_seconds() - started) / rounds.max(1) as f64;
    let solved = solutions.iter().flatten().count();
    let report = json!({
        "name": "akrobat",
        "targets": targets.len(),
        "solved": solved,
        "attempts": attempts,
        "seconds": seconds,
        "solutions": solutions,
    });
    println!("{report}");
    Ok(())
}
