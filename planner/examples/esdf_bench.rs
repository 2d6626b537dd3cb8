//! Times the distance fields of a task: `esdf_bench TASK.toml ASSET_FOLDER`.
//!
//! Prints the size of the grid and how long it takes to fill, three times.

use std::path::{Path, PathBuf};
use std::time::Instant;

use akrobat_model::load::{self, AssetSearch};
use akrobat_planner::PlannerConfig;
use akrobat_planner::world::World;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [task, assets] = &arguments[..] else {
        return Err("usage: esdf_bench TASK.toml ASSET_FOLDER".into());
    };
    let search = AssetSearch { folders: vec![PathBuf::from(assets)] };
    let task = load::task(Path::new(task), &search)?;
    let config = PlannerConfig::default();
    let triangles: usize = task
        .scene
        .bodies
        .iter()
        .flat_map(|body| body.collision_parts())
        .flat_map(|part| part.triangulate())
        .map(|mesh| mesh.triangles.len())
        .sum();
    let voxels = config.workspace_m.map(|length| (length / config.voxel_size_m).round());
    for _ in 0..3 {
        let (began, before) = (Instant::now(), cpu_seconds());
        let world = World::build(&task, &config);
        println!(
            "{voxels:?} voxels of {} m, {triangles} triangles: {:.2} s of wall time, {:.2} s of CPU time, handle at {:.3} m",
            config.voxel_size_m,
            began.elapsed().as_secs_f64(),
            cpu_seconds() - before,
            world.fixed.distance(&akrobat_planner::world::handle_center(&task.object)),
        );
    }
    Ok(())
}

/// CPU time of this process (Linux), seconds; clock ticks are hundredths.
fn cpu_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or("").split_whitespace().collect();
    [11, 12].iter().filter_map(|&i| fields.get(i)?.parse::<f64>().ok()).sum::<f64>() / 100.0
}
