//! The judge on real robots, appliances and kitchens.

use std::path::{Path, PathBuf};

use akrobat_model::load::{self, AssetSearch};
use akrobat_model::task::Task;
use akrobat_model::{Phase, fixtures};

use crate::judge::{Judge, Scenery};
use crate::kinematics::{Frame, Kinematics};
use crate::path::Place;
use crate::{JudgeConfig, object};

/// The real pairs whose task files have this ending.
fn tasks(ending: &str) -> Vec<(PathBuf, Task)> {
    let Some(shared) = fixtures::shared_assets() else { return Vec::new() };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/tasks");
    let search = AssetSearch { folders: vec![shared] };
    let mut files: Vec<PathBuf> =
        folder.read_dir().unwrap().map(|entry| entry.unwrap().path()).collect();
    let name = |file: &PathBuf| file.file_name().unwrap().to_string_lossy().into_owned();
    files.retain(|file| name(file).starts_with("summit") && name(file).ends_with(ending));
    files.sort();
    assert!(!files.is_empty());
    files.into_iter().map(|file| (file.clone(), load::task(&file, &search).unwrap())).collect()
}

/// Deterministic numbers in 0..1.
fn numbers() -> impl Iterator<Item = f64> {
    std::iter::successors(Some(12345u64), |x| {
        Some(x.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407))
    })
    .map(|x| (x >> 11) as f64 / (1u64 << 53) as f64)
}

#[test]
fn real_objects_may_open_all_the_way() {
    for (file, task) in tasks(".toml") {
        let judge = Judge::new(&task, &[], &[], JudgeConfig::default()).unwrap();
        let kinematics = Kinematics::new(&task.object.tree, &task.object.world_from_root);
        let last = task
            .file
            .goal
            .positions
            .iter()
            .copied()
            .fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
        let sceneries: Vec<Scenery> = (0..=100u32)
            .map(|k| {
                let q = task.object.configuration(last * f64::from(k) / 100.0);
                let place = Place { sample: f64::from(k), time_s: 0.0, phase: Phase::Manipulate };
                Scenery::new(place, Vec::new(), kinematics.link_frames(&q))
            })
            .collect();
        let finding = object::check(judge.geometry(), &sceneries, judge.config().penetration_m);
        assert_eq!(finding, None, "{}", file.display());
    }
}

#[test]
fn forward_kinematics_of_real_trees() {
    let mut numbers = numbers();
    for (file, task) in tasks("_empty.toml") {
        for (tree, world_from_root) in [
            (&task.robot.tree, &task.robot.world_from_root),
            (&task.object.tree, &task.object.world_from_root),
        ] {
            let kinematics = Kinematics::new(tree, world_from_root);
            for _ in 0..20 {
                let q: Vec<f64> =
                    (0..tree.dof()).map(|_| 4.0 * numbers.next().unwrap() - 2.0).collect();
                let poses = tree.link_poses(world_from_root, &q);
                for (frame, pose) in kinematics.link_frames(&q).iter().zip(&poses) {
                    let off = frame.inverse().then(&Frame::from_pose(pose));
                    assert!(
                        off.translation.length() < 1e-9 && off.angle() < 1e-9,
                        "{}",
                        file.display()
                    );
                }
            }
        }
    }
}
