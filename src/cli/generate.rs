//! `akrobat generate`: procedural objects.

use std::path::PathBuf;

use akrobat_assets::appliances::HingeSide;
use akrobat_assets::object::{HandleKind, ObjectClass, ObjectRequest};
use clap::{Args, Subcommand, ValueEnum};

use super::Report;
use crate::Error;
use crate::pipeline::{self, Context, GenerateObjectRequest};

/// Make objects to manipulate, without downloads: the same seed gives the same files.
#[derive(Debug, Args)]
pub struct GenerateArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Object(ObjectArgs),
}

/// Make an appliance, a piece of furniture or a thing to pick up: URDF, meshes with materials, grasps, a
/// manifest (object.json), and a task file to plan with at once.
///
/// Dimensions that are not given are drawn by the seed among those of published standards (EN 1116,
/// DIN 18101, manufacturers' sizes). Every handle can be held by a parallel gripper that opens 8 cm.
///
/// Examples:
///   akrobat generate object microwave -o mw && akrobat plan mw/task.toml -o mw.h5 --limit 5
///   akrobat generate object base-cabinet --doors 2 --hinge right --handle knob -o cabinet
///   akrobat generate object refrigerator --height 1.85 --seed 7 -o fridge --robot configs/robots/tiago.toml
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
struct ObjectArgs {
    /// What to make.
    #[arg(value_enum)]
    class: Class,
    /// Folder to write: empty or new.
    #[arg(long, short)]
    output: PathBuf,
    /// Name of the object and of its URDF; the class's where absent.
    #[arg(long)]
    name: Option<String>,
    /// Outer width, metres (of a door: the leaf's; of mugs and bowls: the diameter).
    #[arg(long, value_name = "M")]
    width: Option<f64>,
    /// Depth without fronts and handles, metres.
    #[arg(long, value_name = "M")]
    depth: Option<f64>,
    /// Height, metres.
    #[arg(long, value_name = "M")]
    height: Option<f64>,
    /// Number of doors of a cabinet: 1 or 2.
    #[arg(long, value_name = "N")]
    doors: Option<usize>,
    /// Side of the hinges, seen from the front; of two doors, the one that the task opens.
    #[arg(long, value_enum)]
    hinge: Option<Hinge>,
    /// Style of the handles.
    #[arg(long, value_enum)]
    handle: Option<Handle>,
    /// Seed of everything that is not given.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Robot file of the task; the built-in robot's where absent.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Class {
    Microwave,
    Oven,
    Dishwasher,
    Refrigerator,
    #[value(alias = "wall_cabinet")]
    WallCabinet,
    #[value(alias = "base_cabinet")]
    BaseCabinet,
    #[value(alias = "drawer_unit")]
    DrawerUnit,
    #[value(alias = "trash_can")]
    TrashCan,
    Door,
    Chair,
    Box,
    Mug,
    Bowl,
}

impl From<Class> for ObjectClass {
    fn from(class: Class) -> Self {
        match class {
            Class::Microwave => Self::Microwave,
            Class::Oven => Self::Oven,
            Class::Dishwasher => Self::Dishwasher,
            Class::Refrigerator => Self::Refrigerator,
            Class::WallCabinet => Self::WallCabinet,
            Class::BaseCabinet => Self::BaseCabinet,
            Class::DrawerUnit => Self::DrawerUnit,
            Class::TrashCan => Self::TrashCan,
            Class::Door => Self::Door,
            Class::Chair => Self::Chair,
            Class::Box => Self::Box,
            Class::Mug => Self::Mug,
            Class::Bowl => Self::Bowl,
        }
    }
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Hinge {
    Left,
    Right,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Handle {
    Bar,
    Arch,
    Knob,
    Recess,
    Lever,
}

/// Runs the verb.
pub fn run(args: &GenerateArgs, _context: &Context<'_>) -> Result<Report, Error> {
    match &args.what {
        What::Object(args) => object(args),
    }
}

fn object(args: &ObjectArgs) -> Result<Report, Error> {
    let request = GenerateObjectRequest {
        class: args.class.into(),
        name: args.name.clone(),
        parameters: ObjectRequest {
            width_m: args.width,
            depth_m: args.depth,
            height_m: args.height,
            hinge_side: args.hinge.map(|side| match side {
                Hinge::Left => HingeSide::Left,
                Hinge::Right => HingeSide::Right,
            }),
            doors: args.doors,
            handle: args.handle.map(|kind| match kind {
                Handle::Bar => HandleKind::Bar,
                Handle::Arch => HandleKind::Arch,
                Handle::Knob => HandleKind::Knob,
                Handle::Recess => HandleKind::Recess,
                Handle::Lever => HandleKind::Lever,
            }),
            seed: args.seed,
        },
        robot: args.robot.clone(),
        output: args.output.clone(),
    };
    let report = pipeline::generate_object(&request)?;
    let [depth, width, height] = report.size_m;
    let text = format!(
        "{}: {width:.3} x {depth:.3} x {height:.3} m, {} grasps\nplan with it: akrobat plan {} -o trajectories.h5",
        report.output.display(),
        report.grasps,
        report.task.display()
    );
    Ok(Report::done(text, serde_json::to_value(&report).unwrap_or_default()))
}
