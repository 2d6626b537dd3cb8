//! `akrobat bench`: throughput on this machine.

mod plan;
mod render;

use clap::{Args, Subcommand};

use super::Report;
use crate::Error;
use crate::pipeline::Context;

/// Measure throughput on this machine.
#[derive(Debug, Args)]
pub struct BenchArgs {
    #[command(subcommand)]
    stage: Stage,
}

#[derive(Debug, Subcommand)]
enum Stage {
    Plan(plan::PlanBenchArgs),
    Render(render::BenchRenderArgs),
}

/// Runs the verb.
pub fn run(args: &BenchArgs, context: &Context<'_>) -> Result<Report, Error> {
    match &args.stage {
        Stage::Plan(args) => plan::run(args, context),
        Stage::Render(args) => render::run(args, context),
    }
}
