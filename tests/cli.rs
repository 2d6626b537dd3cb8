//! The command line as a process: exit codes, messages, machine-readable output.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use assert_cmd::Command;
use predicates::prelude::PredicateBooleanExt;
use predicates::str::contains;

fn akrobat() -> Command {
    Command::cargo_bin("akrobat").unwrap()
}

#[test]
fn help_lists_the_verbs_and_the_exit_codes() {
    let help = akrobat().arg("--help").assert().success();
    let verbs = ["plan", "render", "inspect", "validate", "schema", "Exit codes"];
    let output = String::from_utf8(help.get_output().stdout.clone()).unwrap();
    for verb in verbs {
        assert!(output.contains(verb), "{verb} is not in\n{output}");
    }
}

#[test]
fn version_is_the_crates() {
    akrobat().arg("--version").assert().success().stdout(contains(env!("CARGO_PKG_VERSION")));
}

#[test]
fn an_unknown_verb_is_wrong_usage() {
    akrobat().arg("juggle").assert().code(2).stderr(contains("unrecognized subcommand 'juggle'"));
}

#[test]
fn schemas_are_json_schemas() {
    let output = akrobat().args(["schema", "task"]).assert().success().get_output().clone();
    let schema: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(schema["title"], "TaskFile");
    assert_eq!(schema["additionalProperties"], false);
}

#[test]
fn committed_schemas_are_up_to_date() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/schema");
    akrobat().args(["schema", "--check", folder]).assert().success();
}

#[test]
fn stale_schemas_are_noticed() {
    let folder = tempfile::tempdir().unwrap();
    akrobat().args(["schema", "--write"]).arg(folder.path()).assert().success();
    akrobat().args(["schema", "--check"]).arg(folder.path()).assert().success();
    std::fs::write(folder.path().join("rig.schema.json"), "{}").unwrap();
    let check = akrobat().args(["schema", "--check"]).arg(folder.path()).assert();
    check.code(2).stderr(contains("out of date: rig;"));
}

#[test]
fn errors_are_json_on_request() {
    let output = akrobat().args(["--json", "schema", "--check", "/nonexistent"]).assert().code(2);
    let report: serde_json::Value = serde_json::from_slice(&output.get_output().stdout).unwrap();
    assert_eq!(report["exit_code"], 2);
    assert!(report["error"].as_str().unwrap().contains("/nonexistent"));
}

#[test]
fn an_unwritable_place_is_bad_input() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let below_a_file = file.path().join("schemas");
    let write = akrobat().args(["schema", "--write"]).arg(&below_a_file).assert();
    write.code(2).stderr(contains("cannot write"));
}

#[test]
fn the_schema_of_tasks_knows_the_planners_settings() {
    let output = akrobat().args(["schema", "task"]).assert().success().get_output().clone();
    let schema: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let planner = &schema["properties"]["planner"];
    assert_eq!(planner["additionalProperties"], false);
    assert!(planner["properties"]["limit"].is_object());
}

/// A task file in a folder of its own.
fn task(text: &str) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("task.toml");
    std::fs::write(&file, text).unwrap();
    (folder, file)
}

const TASK: &str = r#"
name = "test"
[robot]
file = "robot.toml"
[object]
urdf = "object.urdf"
pose = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
joint = "hinge"
[goal]
positions = [1.0]
"#;

/// Plans a task that is wrong: exit 2, this in the message, nothing written.
fn assert_bad_task(text: &str, message: &str) {
    let (folder, file) = task(text);
    let output = folder.path().join("trajectories.h5");
    let plan = akrobat().arg("plan").arg(&file).arg("-o").arg(&output).assert();
    plan.code(2).stderr(contains(message).and(contains("task.toml")));
    let left: Vec<_> = folder.path().read_dir().unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left, ["task.toml"]);
}

#[test]
fn a_task_that_names_a_missing_robot_is_bad_input() {
    assert_bad_task(TASK, "robot.toml");
}

#[test]
fn an_unknown_key_is_bad_input_and_the_valid_ones_are_listed() {
    assert_bad_task(&TASK.replace("joint =", "joints ="), "expected one of");
}

#[test]
fn broken_toml_is_bad_input() {
    assert_bad_task("name = ", "TOML parse error");
}

#[test]
fn a_missing_task_is_bad_input() {
    let plan = akrobat().args(["plan", "/nonexistent/task.toml", "-o", "out.h5"]).assert();
    plan.code(2).stderr(contains("/nonexistent/task.toml"));
}

#[test]
fn an_output_in_a_missing_folder_is_noticed_before_planning() {
    let (_folder, file) = task(TASK);
    let plan = akrobat().arg("plan").arg(file).args(["-o", "/nonexistent/out.h5"]).assert();
    plan.code(2).stderr(contains("/nonexistent/out.h5: cannot write"));
}

#[test]
fn a_missing_adapter_is_a_failure_that_says_what_to_install() {
    let Some(assets) = akrobat_model::fixtures::shared_assets() else { return };
    let folder = tempfile::tempdir().unwrap();
    let output = folder.path().join("trajectories.h5");
    let mut plan = akrobat();
    plan.args(["plan", "configs/tasks/summit_drawer_empty.toml", "--backend", "wgpu", "-o"]);
    plan.arg(&output).arg("--assets").arg(assets);
    plan.env("VK_DRIVER_FILES", "/nonexistent.json").env("VK_ICD_FILENAMES", "/nonexistent.json");
    let message = contains("no usable GPU adapter").and(contains("mesa-vulkan-drivers"));
    plan.assert().code(1).stderr(message.and(contains("--backend cpu")));
    assert!(!output.exists());
}

#[test]
fn an_asset_folder_must_exist() {
    let (folder, file) = task(TASK);
    let output = folder.path().join("out.h5");
    let mut plan = akrobat();
    plan.arg("plan").arg(file).arg("-o").arg(output).args(["--assets", "/nonexistent"]);
    plan.assert().code(2).stderr(contains("asset folder /nonexistent does not exist"));
}

#[test]
fn files_of_another_kind_are_bad_input() {
    let (folder, file) = task(TASK);
    for verb in ["inspect", "validate"] {
        akrobat().arg(verb).arg(&file).assert().code(2).stderr(contains("task.toml"));
    }
    akrobat().arg("validate").arg(folder.path()).assert().code(2);
    let dataset = folder.path().join("dataset");
    let render = akrobat().arg("render").arg(&file).arg("-o").arg(&dataset).assert();
    render.code(2).stderr(contains("task.toml"));
    assert!(!dataset.exists());
}

#[test]
fn episode_lists_are_checked() {
    let render = akrobat().args(["render", "t.h5", "-o", "d", "--episodes", "5-3"]).assert();
    render.code(2).stderr(contains("5-3"));
}
