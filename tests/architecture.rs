//! The arrows between crates point only where `ARCHITECTURE.md` says.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Each crate and the project's crates that it may depend on.
const ALLOWED: &[(&str, &[&str])] = &[
    ("akrobat-simd", &[]),
    ("akrobat-model", &[]),
    ("akrobat-gpu", &[]),
    ("akrobat-cameras", &["akrobat-model"]),
    ("akrobat-planner", &["akrobat-model", "akrobat-gpu", "akrobat-simd"]),
    ("akrobat-judge", &["akrobat-model"]),
    ("akrobat-assets", &["akrobat-model"]),
    ("akrobat-renderer", &["akrobat-model", "akrobat-cameras", "akrobat-gpu", "akrobat-simd"]),
    ("akrobat-packager", &["akrobat-model", "akrobat-cameras"]),
];

/// The project's crates and those of them that each depends on, development aside.
fn arrows() -> BTreeMap<String, BTreeSet<String>> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--no-deps", "--offline", "--format-version", "1"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_owned();
    let packages = metadata["packages"].as_array().unwrap().iter();
    packages
        .map(|package| {
            let dependencies = package["dependencies"].as_array().unwrap().iter();
            let own = dependencies.filter(|d| d["kind"].is_null()).map(|d| text(&d["name"]));
            (text(&package["name"]), own.filter(|name| name.starts_with("akrobat")).collect())
        })
        .collect()
}

/// Arrows that nobody allowed.
fn forbidden(arrows: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let mut found = Vec::new();
    for (name, allowed) in ALLOWED {
        let allowed: BTreeSet<String> = allowed.iter().map(|&n| n.to_owned()).collect();
        let surplus = arrows[*name].difference(&allowed);
        found.extend(surplus.map(|dependency| format!("{name} -> {dependency}")));
    }
    found
}

#[test]
fn crates_depend_only_downwards() {
    assert_eq!(forbidden(&arrows()), Vec::<String>::new());
}

#[test]
fn every_crate_has_its_place() {
    let listed: BTreeSet<&str> = ALLOWED.iter().map(|(name, _)| *name).collect();
    let arrows = arrows();
    let stages = arrows.keys().filter(|name| !["akrobat", "akrobat-python"].contains(&&***name));
    assert_eq!(stages.map(String::as_str).collect::<BTreeSet<_>>(), listed);
}

#[test]
fn a_judge_that_uses_the_planner_is_noticed() {
    let mut arrows = arrows();
    arrows.get_mut("akrobat-judge").unwrap().insert("akrobat-planner".into());
    assert_eq!(forbidden(&arrows), ["akrobat-judge -> akrobat-planner"]);
}
