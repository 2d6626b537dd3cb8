//! The command line: one file per verb.

mod bench;
mod demo;
mod eval;
mod export;
mod filter;
mod generate;
mod import;
mod inspect;
mod merge;
mod plan;
mod produce;
mod render;
mod repair;
mod replay;
mod run;
mod schema;
mod split;
mod validate;
mod view;
mod workers;

use std::ffi::OsString;
use std::io::Write;

use clap::{Parser, Subcommand};

use crate::pipeline::Context;
use crate::progress::{Progress, Verbosity};
use crate::{CancelToken, Error, ExitCode, Host};

/// Makes robot-learning datasets of whole-body mobile manipulation: plans trajectories for a task,
/// renders them with any cameras, and writes dataset files.
#[derive(Debug, Parser)]
#[command(name = "akrobat", version, arg_required_else_help = true, propagate_version = true)]
#[command(
    after_help = "Exit codes: 0 done, 1 failed, 2 wrong usage or input, 3 finished but something was lost."
)]
struct Cli {
    /// Print one JSON document on stdout instead of text.
    #[arg(long, global = true)]
    json: bool,
    /// No progress bars, no warnings.
    #[arg(long, short, global = true)]
    quiet: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Bench(bench::BenchArgs),
    Demo(demo::DemoArgs),
    Generate(generate::GenerateArgs),
    Plan(plan::PlanArgs),
    Produce(produce::ProduceArgs),
    Render(Box<render::RenderArgs>),
    Replay(replay::ReplayArgs),
    Eval(eval::EvalArgs),
    Export(export::ExportArgs),
    Card(export::CardArgs),
    Import(import::ImportArgs),
    Run(run::RunArgs),
    Inspect(inspect::InspectArgs),
    Validate(validate::ValidateArgs),
    View(view::ViewArgs),
    Merge(merge::MergeArgs),
    Split(split::SplitArgs),
    Filter(filter::FilterArgs),
    Repair(repair::RepairArgs),
    Schema(schema::SchemaArgs),
}

/// What a verb has to say at its end.
#[derive(Debug)]
pub struct Report {
    /// For people.
    pub text: String,
    /// For machines (`--json`).
    pub json: serde_json::Value,
    /// How it ended.
    pub exit_code: ExitCode,
}

impl Report {
    /// A report of success.
    pub fn done(text: impl Into<String>, json: serde_json::Value) -> Self {
        Self { text: text.into(), json, exit_code: ExitCode::Done }
    }
}

/// Runs the command line `argv` (the program's name first) and returns its exit code. `host` does
/// what needs Python; once `cancel` is set, the stages stop and leave only whole files.
pub fn run<A: Into<OsString> + Clone>(
    argv: impl IntoIterator<Item = A>,
    host: Option<&dyn Host>,
    cancel: &CancelToken,
) -> i32 {
    let cli = match Cli::try_parse_from(argv) {
        Ok(cli) => cli,
        Err(error) => {
            // Fails only where the terminal is gone, and then there is nobody to tell.
            let _ = error.print();
            return error.exit_code();
        }
    };
    let verbosity = match (cli.quiet, cli.json) {
        (true, _) => Verbosity::Quiet,
        (false, true) => Verbosity::WarningsOnly,
        (false, false) => Verbosity::Normal,
    };
    let observer = Progress::new(cancel.clone(), verbosity);
    let outcome = dispatch(&cli.command, &Context { host, observer: &observer });
    finish(outcome, cli.json) as i32
}

fn dispatch(command: &Command, context: &Context<'_>) -> Result<Report, Error> {
    match command {
        Command::Bench(args) => bench::run(args, context),
        Command::Demo(args) => demo::run(args, context),
        Command::Generate(args) => generate::run(args, context),
        Command::Plan(args) => plan::run(args, context),
        Command::Produce(args) => produce::run(args, context),
        Command::Render(args) => render::run(args, context),
        Command::Replay(args) => replay::run(args, context),
        Command::Eval(args) => eval::run(args, context),
        Command::Export(args) => export::run(args, context),
        Command::Card(args) => export::run_card(args, context),
        Command::Import(args) => import::run(args, context),
        Command::Run(args) => run::run(args, context),
        Command::Validate(args) => validate::run(args, context),
        Command::View(args) => view::run(args, context),
        Command::Merge(args) => merge::run(args),
        Command::Split(args) => split::run(args),
        Command::Filter(args) => filter::run(args),
        Command::Repair(args) => repair::run(args, context),
        Command::Inspect(args) => inspect::run(args, context),
        Command::Schema(args) => schema::run(args),
    }
}

fn finish(outcome: Result<Report, Error>, json: bool) -> ExitCode {
    let report = outcome.unwrap_or_else(|error| {
        eprintln!("error: {error}");
        let exit_code = error.exit_code();
        let json = serde_json::json!({ "error": error.to_string(), "exit_code": exit_code as i32 });
        Report { text: String::new(), json, exit_code }
    });
    let text = if json { format!("{:#}", report.json) } else { report.text };
    if !text.is_empty() {
        // Whoever reads the pipe may have left, which is no failure of ours.
        let _ = writeln!(std::io::stdout(), "{text}");
    }
    report.exit_code
}
