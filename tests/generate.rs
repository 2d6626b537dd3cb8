//! Generated scenes, production in them and imported robots, as processes.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use assert_cmd::Command;
use predicates::str::contains;

fn akrobat() -> Command {
    Command::cargo_bin("akrobat").unwrap()
}

fn generate(folder: &Path, threads: &str) {
    akrobat()
        .args(["--quiet", "generate", "scene", "--count", "2", "--density", "open..confined"])
        .args(["--seed", "5", "--threads", threads, "-o"])
        .arg(folder)
        .assert()
        .success();
}

/// All files below a folder, by their path in it, with their contents.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(next) = folders.pop() {
        for path in std::fs::read_dir(next).unwrap().map(|entry| entry.unwrap().path()) {
            if path.is_dir() {
                folders.push(path);
            } else {
                let bytes = std::fs::read(&path).unwrap();
                found.insert(path.strip_prefix(folder).unwrap().to_owned(), bytes);
            }
        }
    }
    found
}

#[test]
fn one_seed_gives_one_set_of_scenes_whatever_the_threads() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    generate(&one, "1");
    generate(&two, "2");
    let (one, two) = (files(&one), files(&two));
    assert!(one.keys().any(|name| name.ends_with("scene.glb")));
    assert!(one == two, "files differ");
}

#[test]
fn a_production_is_resumed_and_its_budget_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    generate(&folder.path().join("scenes"), "2");
    let job = folder.path().join("job.toml");
    let text = |class: &str| {
        format!(
            "name = \"small\"\nscenes = \"scenes\"\noutput = \"out\"\nclasses = [\"{class}\"]\nlimit = 1\n"
        )
    };
    std::fs::write(&job, text("refrigerator")).unwrap();
    let run = |more: &[&str]| {
        let output = akrobat().args(["--json", "produce"]).arg(&job).args(more).output().unwrap();
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        (output.status.code().unwrap(), report)
    };
    let (code, report) = run(&["--time-budget", "0"]);
    assert_eq!((code, &report["left"]), (3, &serde_json::json!(2)), "{report:#}");
    let (code, report) = run(&["--scenes", "1"]);
    assert_eq!((code, &report["planned"]), (0, &serde_json::json!(1)), "{report:#}");
    let (code, report) = run(&[]);
    assert_eq!(code, 0);
    assert_eq!([&report["planned"], &report["resumed"]], [&serde_json::json!(1); 2]);
    assert_eq!(report["total"]["accepted"], 2);

    std::fs::write(&job, text("spaceship")).unwrap();
    let known = contains("unknown \"spaceship\"; valid choices: base_cabinet");
    akrobat().arg("produce").arg(&job).assert().code(2).stderr(known);
}

#[test]
fn wrong_scenes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("scenes");
    let scene = |more: &[&str]| {
        let mut command = akrobat();
        command.args(["generate", "scene", "-o"]).arg(&output).args(more);
        command.assert().code(2)
    };
    scene(&["--density", "crowded"]).stderr(contains("expected open, medium, confined"));
    scene(&["--count", "0"]).stderr(contains("expected at least 1"));
    assert!(!output.exists());
}

#[test]
fn a_robot_is_imported_and_found_again() {
    let folder = tempfile::tempdir().unwrap();
    generate(&folder.path().join("scenes"), "2");
    let urdf = folder.path().join("scenes/robots/pillar.urdf");
    let output = folder.path().join("robot");
    let run = akrobat()
        .args(["--json", "import", "robot"])
        .arg(&urdf)
        .arg("-o")
        .arg(&output)
        .output()
        .unwrap();
    let report: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    assert_eq!(run.status.code(), Some(0), "{report:#}");
    assert!(report["sphere_count"].as_u64().unwrap() <= 120, "{report:#}");
    assert!(report["coverage"].as_f64().unwrap() > 0.9, "{report:#}");
    assert!(output.join("robot.toml").exists());

    std::fs::write(folder.path().join("broken.urdf"), "<robot").unwrap();
    let broken = akrobat()
        .args(["import", "robot"])
        .arg(folder.path().join("broken.urdf"))
        .arg("-o")
        .arg(folder.path().join("none"))
        .assert()
        .code(2);
    broken.stderr(contains("broken.urdf"));
    assert!(!folder.path().join("none").exists());
}
