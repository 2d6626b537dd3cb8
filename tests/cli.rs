//! The command line as a process: exit codes, messages, machine-readable output.

use assert_cmd::Command;
use predicates::prelude::*;
use predicates::str::contains;

fn akrobat() -> Command {
    Command::cargo_bin("akrobat").unwrap()
}

#[test]
fn help_lists_the_verbs_and_the_exit_codes() {
    let help = akrobat().arg("--help").assert().success();
    help.stdout(contains("schema").and(contains("Exit codes")));
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
