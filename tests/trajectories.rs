//! Trajectory files from end to end: planned by the command, read, judged again, damaged.

#![allow(clippy::unwrap_used)] // helpers of tests

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use akrobat_judge::{Judge, JudgeConfig, RobotSphere};
use akrobat_model::load::{self, AssetSearch};
use akrobat_model::{Rejection, TrajectorySet, fixtures};
use akrobat_packager::trajectory_file;
use akrobat_planner::Preparation;
use assert_cmd::Command;
use predicates::str::contains;

fn akrobat() -> Command {
    Command::cargo_bin("akrobat").unwrap()
}

/// A small real task, planned twice: on one thread and on two.
struct Files {
    folder: tempfile::TempDir,
    assets: PathBuf,
}

impl Files {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn set(&self) -> TrajectorySet {
        trajectory_file::read(&self.path("one.h5")).unwrap()
    }

    fn plan(&self, output: &str, threads: &str) {
        let mut plan = akrobat();
        plan.arg("plan").arg(self.path("task.toml")).arg("-o").arg(self.path(output));
        plan.args(["--limit", "2", "--threads", threads]).arg("--assets").arg(&self.assets);
        plan.assert().success();
    }
}

fn files() -> Option<&'static Files> {
    static FILES: OnceLock<Option<Files>> = OnceLock::new();
    let plan = || {
        let assets = fixtures::shared_assets()?;
        let configs = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
        let text = std::fs::read_to_string(configs.join("tasks/summit_drawer_empty.toml")).unwrap();
        let robot = configs.join("robots/summit_franka.toml").display().to_string();
        let text = text.replace("../robots/summit_franka.toml", &robot)
            + "\n[grasps]\ncount = 2\n\n[planner]\nik_seeds = 150\n";
        let files = Files { folder: tempfile::tempdir().unwrap(), assets };
        std::fs::write(files.path("task.toml"), text).unwrap();
        files.plan("one.h5", "1");
        files.plan("two.h5", "2");
        Some(files)
    };
    FILES.get_or_init(plan).as_ref()
}

/// A judge of the task that a trajectory file carries in itself.
fn judge(files: &Files, set: &TrajectorySet) -> Judge {
    let header = &set.header;
    let search = AssetSearch { folders: vec![files.assets.clone()] };
    let path = files.path("task.toml");
    let task = load::task_from_text(header.task_toml.clone(), &path, &search).unwrap();
    assert_eq!(task.content_hashes, header.content_hashes);
    let spheres = Preparation::new(&task).unwrap().spheres.spheres;
    let spheres: Vec<RobotSphere> = spheres
        .iter()
        .map(|s| RobotSphere { link: s.link, center: s.center, radius: s.radius })
        .collect();
    Judge::new(&task, &spheres, &header.contact_exceptions, JudgeConfig::default()).unwrap()
}

#[test]
fn the_number_of_threads_does_not_change_a_byte() {
    let Some(files) = files() else { return };
    let bytes = |name| std::fs::read(files.path(name)).unwrap();
    assert!(bytes("one.h5") == bytes("two.h5"));
}

#[test]
fn a_planned_file_is_whole_and_says_what_is_in_it() {
    let Some(files) = files() else { return };
    let output = akrobat().arg("validate").arg(files.path("one.h5")).arg("--json").output();
    let report: serde_json::Value = serde_json::from_slice(&output.unwrap().stdout).unwrap();
    assert_eq!(report["trajectories"], 2);
    akrobat()
        .arg("inspect")
        .arg(files.path("one.h5"))
        .assert()
        .success()
        .stdout(contains("2 trajectories of task \"summit_drawer_empty\""))
        .stdout(contains("drawer_slider_0"));
}

#[test]
fn what_was_saved_is_accepted_again() {
    let Some(files) = files() else { return };
    let set = files.set();
    let judge = judge(files, &set);
    assert_eq!(set.trajectories.len(), 2);
    assert_eq!(set.header.robot_joints.len(), 12);
    for trajectory in &set.trajectories {
        assert_eq!(trajectory.waypoints_robot.rows(), 30);
        assert_eq!(trajectory.verdict.as_ref(), Some(&judge.judge(trajectory)));
        assert!(trajectory.verdict.as_ref().unwrap().accepted());
    }
}

#[test]
fn files_of_damaged_trajectories_are_read_and_refused_by_the_judge() {
    let Some(files) = files() else { return };
    let set = files.set();
    let judge = judge(files, &set);
    let mut damaged = set.clone();
    for trajectory in &mut damaged.trajectories {
        // The columns of two arm joints are exchanged, as by a wrong joint order.
        for path in [&mut trajectory.waypoints_robot, &mut trajectory.dense.robot] {
            path.values_mut().chunks_mut(12).for_each(|row| row.swap(4, 6));
        }
    }
    let path = files.path("damaged.h5");
    trajectory_file::write(&path, &damaged).unwrap();
    let read = trajectory_file::read(&path).unwrap();
    assert_eq!(read, damaged);
    for trajectory in &read.trajectories {
        let verdict = judge.judge(trajectory);
        assert_eq!(verdict.rejection, Some(Rejection::AnchorTranslation), "{}", verdict.detail);
    }
}

#[test]
fn a_truncated_file_is_bad_input() {
    let Some(files) = files() else { return };
    let bytes = std::fs::read(files.path("one.h5")).unwrap();
    for (name, kept) in
        [("half.h5", bytes.len() / 2), ("empty.h5", 0), ("short.h5", bytes.len() - 9)]
    {
        std::fs::write(files.path(name), &bytes[..kept]).unwrap();
        for verb in ["validate", "inspect"] {
            let asked = akrobat().arg(verb).arg(files.path(name)).assert();
            asked.code(2).stderr(contains(name));
        }
    }
}
