//! `akrobat schema`: JSON Schemas of the configuration files.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use schemars::Schema;
use serde_json::json;

use super::Report;
use crate::Error;

/// Print the JSON Schema of a configuration file, for editors that complete and check TOML.
///
/// Examples:
///   akrobat schema task                 the schema of task files
///   akrobat schema --write schema/      all schemas, as files
///   akrobat schema --check schema/      fails where the files there are out of date
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct SchemaArgs {
    /// Kind of file; all of them where absent.
    kind: Option<Kind>,
    /// Write `KIND.schema.json` files into this folder.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["check", "kind"])]
    write: Option<PathBuf>,
    /// Compare the `KIND.schema.json` files of this folder with what would be written.
    #[arg(long, value_name = "DIR", conflicts_with = "kind")]
    check: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    /// Task files: what is opened or moved, where, and by which robot.
    Task,
    /// Robot files: what a URDF does not say.
    Robot,
    /// Camera rigs.
    Rig,
    /// Sensors: what becomes of ideal images.
    Sensor,
    /// Light and background.
    Lighting,
    /// What is drawn at random for each episode.
    Variation,
    /// Jobs of `akrobat run`.
    Job,
    /// Jobs of `akrobat produce`.
    Production,
    /// The `[planner]` table of task files.
    Planner,
    /// The judge's tolerances.
    Judge,
    /// Controller gains and contact properties of `akrobat replay --gains`.
    Physics,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Task => "task",
            Self::Robot => "robot",
            Self::Rig => "rig",
            Self::Sensor => "sensor",
            Self::Lighting => "lighting",
            Self::Variation => "variation",
            Self::Job => "job",
            Self::Production => "production",
            Self::Planner => "planner",
            Self::Judge => "judge",
            Self::Physics => "physics",
        }
    }

    fn schema(self) -> Schema {
        match self {
            Self::Task => task_schema(),
            Self::Robot => schemars::schema_for!(akrobat_model::RobotFile),
            Self::Rig => schemars::schema_for!(akrobat_cameras::Rig),
            Self::Sensor => schemars::schema_for!(akrobat_cameras::Sensor),
            Self::Lighting => schemars::schema_for!(akrobat_renderer::Lighting),
            Self::Variation => schemars::schema_for!(akrobat_renderer::Variation),
            Self::Job => schemars::schema_for!(crate::pipeline::JobFile),
            Self::Production => schemars::schema_for!(crate::pipeline::ProductionFile),
            Self::Planner => schemars::schema_for!(akrobat_planner::PlannerConfig),
            Self::Judge => schemars::schema_for!(akrobat_judge::JudgeConfig),
            Self::Physics => schemars::schema_for!(crate::pipeline::PhysicsConfig),
        }
    }

    fn file_in(self, folder: &Path) -> PathBuf {
        folder.join(format!("{}.schema.json", self.name()))
    }

    fn file_text(self) -> String {
        format!("{:#}\n", self.schema().to_value())
    }
}

/// Task files with the planner's own schema for `[planner]`, which the task's type does not know.
fn task_schema() -> Schema {
    let mut task = schemars::schema_for!(akrobat_model::TaskFile);
    let planner = schemars::schema_for!(akrobat_planner::PlannerConfig);
    if let Some(properties) = task.get_mut("properties").and_then(|p| p.as_object_mut()) {
        let mut planner = planner.to_value();
        if let Some(schema) = planner.as_object_mut() {
            schema.remove("$schema");
        }
        properties.insert("planner".into(), planner);
    }
    task
}

/// Runs the verb.
pub fn run(args: &SchemaArgs) -> Result<Report, Error> {
    match (&args.write, &args.check, args.kind) {
        (Some(folder), ..) => write(folder),
        (_, Some(folder), _) => check(folder),
        (.., Some(kind)) => Ok(print(kind.schema().to_value())),
        (.., None) => {
            let all = Kind::value_variants().iter();
            Ok(print(all.map(|k| (k.name().to_owned(), k.schema().to_value())).collect()))
        }
    }
}

fn print(schema: serde_json::Value) -> Report {
    Report::done(format!("{schema:#}"), schema)
}

fn write(folder: &Path) -> Result<Report, Error> {
    std::fs::create_dir_all(folder).map_err(|e| Error::write(folder, &e))?;
    let files: Vec<PathBuf> = Kind::value_variants().iter().map(|k| k.file_in(folder)).collect();
    for (kind, file) in Kind::value_variants().iter().zip(&files) {
        std::fs::write(file, kind.file_text()).map_err(|e| Error::write(file, &e))?;
    }
    Ok(Report::done(
        format!("wrote {} schemas into {}", files.len(), folder.display()),
        json!(files),
    ))
}

fn check(folder: &Path) -> Result<Report, Error> {
    let stale: Vec<&str> = Kind::value_variants()
        .iter()
        .filter(|k| std::fs::read_to_string(k.file_in(folder)).ok() != Some(k.file_text()))
        .map(|k| k.name())
        .collect();
    if stale.is_empty() {
        return Ok(Report::done("the schemas are up to date", json!({ "stale": stale })));
    }
    let folder = folder.display();
    Err(Error::Usage(format!(
        "{folder}: out of date: {}; run `akrobat schema --write {folder}`",
        stale.join(", ")
    )))
}
