//! Plans a task and prints what came of it: `probe TASK.toml [ASSET_FOLDER …]`.

use std::path::{Path, PathBuf};

use akrobat_judge::{Judge, JudgeConfig, RobotSphere};
use akrobat_model::events::Silent;
use akrobat_model::load::{self, AssetSearch};
use akrobat_planner::world::World;
use akrobat_planner::{PlannerConfig, Preparation, plan};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let search = AssetSearch { folders: arguments[1..].iter().map(PathBuf::from).collect() };
    let started = std::time::Instant::now();
    let task = load::task(Path::new(&arguments[0]), &search)?;
    println!("load {:.2} s", started.elapsed().as_secs_f64());
    let config: PlannerConfig = task.file.planner.clone().try_into()?;
    let preparation = Preparation::new(&task)?;
    let spheres: Vec<RobotSphere> = preparation
        .spheres
        .spheres
        .iter()
        .map(|s| RobotSphere { link: s.link, center: s.center, radius: s.radius })
        .collect();
    for fit in &preparation.spheres.fits {
        println!(
            "{:24} {:3} spheres, coverage {:.3}, protrusion {:.1} mm",
            fit.link,
            fit.count,
            fit.coverage,
            1e3 * fit.protrusion_m
        );
    }
    println!(
        "{} self pairs; prepare {:.2} s",
        preparation.self_pairs.len(),
        started.elapsed().as_secs_f64()
    );
    let judge = Judge::new(&task, &spheres, &preparation.exceptions, JudgeConfig::default())?;
    println!("judge ready {:.2} s", started.elapsed().as_secs_f64());
    let judging = std::sync::atomic::AtomicU64::new(0);
    let world = World::build(&task, &config);
    println!("distance field {:.2} s", started.elapsed().as_secs_f64());
    let outcome = plan(&task, &preparation, &world, &config, &Silent, &|trajectory| {
        let begin = std::time::Instant::now();
        let verdict = judge.judge(trajectory);
        judging.fetch_add(begin.elapsed().as_micros() as u64, std::sync::atomic::Ordering::Relaxed);
        verdict
    })?;
    println!("judging took {:.2} CPU s", judging.into_inner() as f64 * 1e-6);
    for (name, count) in &outcome.counts {
        println!("{name:36} {count}");
    }
    for (name, seconds) in &outcome.stage_seconds {
        println!("{name:36} {seconds:.2} s");
    }
    for note in outcome.notes.iter().take(25) {
        println!("  {note}");
    }
    let starts: Vec<Vec<f64>> =
        outcome.set.trajectories.iter().map(|t| t.waypoints_robot.row_f64(0)).collect();
    let mut distinct: Vec<&Vec<f64>> = Vec::new();
    for s in &starts {
        let same = |o: &&Vec<f64>| {
            (s[0] - o[0]).hypot(s[1] - o[1]) <= 0.1
                && s[2..].iter().zip(&o[2..]).all(|(a, b)| (a - b).abs() <= 0.2)
        };
        if !distinct.iter().any(same) {
            distinct.push(s);
        }
    }
    let mut grasps: Vec<u32> = outcome.set.trajectories.iter().map(|t| t.grasp.id).collect();
    grasps.sort_unstable();
    grasps.dedup();
    println!(
        "{} accepted, {} distinct starts, {} grasps, {:.1} s in all",
        starts.len(),
        distinct.len(),
        grasps.len(),
        started.elapsed().as_secs_f64()
    );
    if let Some(t) = outcome.set.trajectories.first() {
        println!("{:?}", t.verdict);
        println!("duration {:.2} s, interval {:.4} s", t.dense.duration_s(), t.waypoint_interval_s);
    }
    Ok(())
}
