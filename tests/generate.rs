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

fn json(arguments: &[&str]) -> (i32, serde_json::Value) {
    let output = akrobat().arg("--json").args(arguments).output().unwrap();
    let report = serde_json::from_slice(&output.stdout).unwrap_or_default();
    (output.status.code().unwrap(), report)
}

#[test]
fn variants_of_an_imported_scene_are_produced_beside_generated_ones_and_looked_through() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).display().to_string();
    generate(&folder.path().join("scenes"), "2");
    let kitchen = path("scenes/kitchen_0001/scene.urdf");
    json(&["import", "urdf", &kitchen, "--as", "scene", "-o", &path("imported")]);
    let vary = |output: &str, seed: &str| {
        let (imported, output) = (path("imported"), path(output));
        json(&["generate", "variants", &imported, "--count", "2", "--seed", seed, "-o", &output])
    };
    let (code, set) = vary("variants", "3");
    assert_eq!(code, 0, "{set:#}");
    assert!(set["scenes"][0]["tasks"].as_array().unwrap().len() > 2, "{set:#}");
    vary("same", "3");
    vary("other", "4");
    let [one, same, other] = ["variants", "same", "other"].map(|f| files(&folder.path().join(f)));
    assert!(one == same, "one seed, two sets of files");
    assert!(one != other, "two seeds, one set of files");

    let text = "name = \"both\"\nscenes = [\"scenes\", \"variants\"]\noutput = \"out\"\nclasses = [\"drawer_unit\"]\nobjects_per_class = 1\nlimit = 1\n";
    let job = path("job.toml");
    std::fs::write(&job, text).unwrap();
    let (_, report) = json(&["produce", &job, "--scenes", "1"]);
    assert_eq!(report["planned"], 2, "one of each folder: {report:#}");
    assert_eq!(report["by_confinement"]["imported"]["tasks"], 1, "{report:#}");
    let (_, report) = json(&["produce", &job, "--scenes", "1", "--objects-per-class", "2"]);
    assert_eq!(report["resumed"], 2, "{report:#}");
    assert!(report["planned"].as_u64().unwrap() >= 1, "more of the same: {report:#}");

    let (code, found) = json(&["inspect", &path("out"), "--report", &path("page"), "--show", "1"]);
    assert_eq!(code, 0, "{found:#}");
    for sum in ["tasks", "solved", "accepted"] {
        assert_eq!(found["total"][sum], report["total"][sum], "{found:#}");
    }
    assert_eq!(found["trajectories"], report["total"]["accepted"]);
    let base = &found["bases"]["pillar"];
    assert_eq!(base["trajectories"], found["trajectories"]);
    let page = std::fs::read_to_string(folder.path().join("page/production.html")).unwrap();
    assert!(page.contains("Where bases stood") && page.contains("data:image/jpeg"));

    let looks = path("looks.toml");
    let text_of_looks = "name = \"looks\"\ntrajectories = [\"out\"]\noutput = \"looks\"\n";
    std::fs::write(&looks, text_of_looks).unwrap();
    let drawn = |more: &[&str]| {
        let (code, report) = json(&[&["run", &looks, "--dry-run"], more].concat());
        assert_eq!(code, 0, "{report:#}");
        let outputs = report["outputs"].as_array().unwrap().clone();
        let episodes: u64 = outputs.iter().map(|o| o["episodes"].as_u64().unwrap()).sum();
        (episodes, outputs.iter().map(|o| o["trajectories"].to_string()).collect::<Vec<_>>())
    };
    let all = drawn(&[]);
    assert_eq!(serde_json::json!(all.0), found["trajectories"]);
    let (episodes, files) = drawn(&["--sample", "2"]);
    assert_eq!((episodes, files.len()), (2, 2), "one of each of two files");
    assert_eq!(files, drawn(&["--sample", "2"]).1);

    std::fs::write(&job, text.replace("\"variants\"", "\"scenes\"")).unwrap();
    let twice = akrobat().arg("produce").arg(&job).assert().code(2);
    twice.stderr(contains("two scenes are called \"kitchen_0001\""));
}

#[test]
fn tasks_that_could_not_be_loaded_are_tried_again() {
    let folder = tempfile::tempdir().unwrap();
    generate(&folder.path().join("scenes"), "2");
    let job = folder.path().join("job.toml");
    let text = "name = \"small\"\nscenes = \"scenes\"\noutput = \"out\"\nclasses = [\"refrigerator\"]\nlimit = 1\n";
    std::fs::write(&job, text).unwrap();
    let job = job.display().to_string();
    let robot = folder.path().join("scenes/robots/pillar.urdf");
    let moved = robot.with_extension("moved");
    std::fs::rename(&robot, &moved).unwrap();
    akrobat().args(["produce", &job]).assert().code(2).stderr(contains("pillar.urdf"));
    assert!(
        !folder.path().join("out").exists(),
        "nothing is recorded of a robot that is not there"
    );
    std::fs::rename(&moved, &robot).unwrap();

    let object = folder.path().join("scenes/kitchen_0002/objects/refrigerator_1");
    let moved = object.with_extension("moved");
    std::fs::rename(&object, &moved).unwrap();
    let (code, report) = json(&["produce", &job]);
    assert_eq!((code, &report["reasons"]["task could not be planned"]), (0, &serde_json::json!(1)));
    std::fs::rename(&moved, &object).unwrap();
    let (_, report) = json(&["produce", &job]);
    assert_eq!([&report["planned"], &report["resumed"]], [&serde_json::json!(1); 2]);
    assert_eq!(report["total"]["solved"], 2, "{report:#}");
}

#[test]
fn a_single_scene_says_how_much_floor_is_free() {
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("scenes").display().to_string();
    let (_, set) = json(&["generate", "scene", "--count", "1", "-o", &output]);
    let free = set["scenes"][0]["free_floor"].as_f64().unwrap();
    assert!(free > 0.1, "{set:#}");
    assert_eq!(set["free_floor"], serde_json::json!([free, free]));
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

#[test]
fn what_replaces_a_placeholder_is_opened_among_the_others() {
    let Some(assets) = akrobat_model::fixtures::shared_assets() else { return };
    let flat = assets.join("scenes/infinigen_kitchen_1");
    let folder = tempfile::tempdir().unwrap();
    let home = folder.path().join("home");
    let at = |path: PathBuf| path.display().to_string();
    let (glb, state) = (at(flat.join("scene.glb")), at(flat.join("solve_state.json")));
    let (objects, output) = (at(assets.join("objects")), at(home.clone()));
    let (code, report) = json(&[
        "import",
        "infinigen",
        &glb,
        "--state",
        &state,
        "--objects",
        &objects,
        "-o",
        &output,
    ]);
    assert_eq!(code, 0, "{report:#}");
    let task =
        |name: &str| std::fs::read_to_string(home.join(format!("tasks/{name}.toml"))).unwrap();
    // Its racks come first in its description, and are behind its door.
    assert!(task("dishwasher_dishwasher").contains("joint = \"door_joint_0\""));
    let oven = task("oven_oven");
    assert!(oven.contains("remove = [\"oven_oven\"]"), "{oven}");
    let furnished = std::fs::read_to_string(home.join("furnished.urdf")).unwrap();
    let alone = std::fs::read_to_string(home.join("scene.urdf")).unwrap();
    for twin in ["oven_oven", "dishwasher_dishwasher", "refrigerator_refrigerator"] {
        let link = format!("<link name=\"{twin}\"");
        assert!(furnished.contains(&link) && !alone.contains(&link), "{twin}");
    }
    let (file, result) = (at(home.join("tasks/oven_oven.toml")), at(folder.path().join("t.h5")));
    let (_, planned) = json(&["--quiet", "plan", &file, "-o", &result, "--limit", "1"]);
    assert_eq!(planned["counts"]["accepted"], 1, "{planned:#}");
}
