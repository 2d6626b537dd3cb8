//! `akrobat generate`: procedural objects and scenes.

use std::path::PathBuf;

use akrobat_assets::appliances::HingeSide;
use akrobat_assets::object::{HandleKind, ObjectClass, ObjectRequest};
use clap::{Args, Subcommand, ValueEnum};

use super::Report;
use crate::Error;
use crate::pipeline::{
    self, Context, GenerateObjectRequest, GenerateScenesRequest, GenerateVariantsRequest, SceneSet,
};

/// Make objects to manipulate and scenes to do it in, without downloads: the same seed gives the same files.
#[derive(Debug, Args)]
pub struct GenerateArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Object(ObjectArgs),
    Scene(SceneArgs),
    Variants(VariantsArgs),
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
    /// Draw it as well, closed, opened and with its grasps: object.png.
    #[arg(long)]
    picture: bool,
    /// Robot file of the task; the built-in robot's where absent.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
}

/// Make furnished kitchens: walls with a window and a door, runs of units with appliances, worktops, table,
/// chairs, clutter. Each scene comes as glTF, URDF and USD with a manifest (scene.json), its articulated objects,
/// and a task file for each object and robot.
///
/// Every scene is checked: no two bodies intersect by more than 1 mm; refrigerator, sink and oven form a work
/// triangle; what is to be opened has room to open; and a robot can stand in reach of each handle, closed and
/// opened, at places that a free way connects. No two scenes of a set are the same.
///
/// Examples:
///   akrobat generate scene -o scenes                                    one kitchen
///   akrobat generate scene --count 300 --density open..confined -o scenes --pictures
///   akrobat generate scene --count 20 --density 0.8 --robot configs/robots/tiago.toml -o scenes
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
struct SceneArgs {
    /// Folder to write: empty or new.
    #[arg(long, short)]
    output: PathBuf,
    /// Number of scenes.
    #[arg(long, value_name = "N", default_value_t = 1)]
    count: usize,
    /// open, medium, confined or a number from 0 to 1; or a range of two, such as `open..confined`.
    #[arg(long, value_name = "DENSITY", default_value = "medium")]
    density: String,
    /// Seed of the first scene; the others follow.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Robot file that tasks are written for, instead of the built-in robot; may be repeated.
    #[arg(long, value_name = "FILE")]
    robot: Vec<PathBuf>,
    /// Draw the scenes: contact_sheet.png.
    #[arg(long)]
    pictures: bool,
    /// Number of threads; one for each core where absent.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
}

/// Make variants of imported scenes: the articulated objects of each are exchanged for generated ones of their
/// classes, in the same places but with other dimensions, handles and finishes, and drawer units, cabinets,
/// appliances and a microwave are put on free stretches of its floor. A task file for each object and robot.
///
/// The folder is laid out like that of `akrobat generate scene`, so that `akrobat produce` takes both.
///
/// Example:
///   akrobat import infinigen scene.glb --state solve_state.json --objects objects/ -o flat
///   akrobat import sdf furnished_living_room.dmd.yaml -o living_room
///   akrobat generate variants flat living_room --count 30 -o variants --robot configs/robots/tiago.toml
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
struct VariantsArgs {
    /// Folders that `akrobat import` has written; they are used in turn.
    #[arg(required = true, value_name = "SCENE")]
    scenes: Vec<PathBuf>,
    /// Folder to write: empty or new.
    #[arg(long, short)]
    output: PathBuf,
    /// Number of variants in all.
    #[arg(long, value_name = "N", default_value_t = 1)]
    count: usize,
    /// Pieces of furniture on free floor, at most.
    #[arg(long, value_name = "N", default_value_t = 4)]
    furniture: usize,
    /// Seed of the first variant; the others follow.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Robot file that tasks are written for, instead of the built-in robot; may be repeated.
    #[arg(long, value_name = "FILE")]
    robot: Vec<PathBuf>,
    /// Draw the variants: contact_sheet.png.
    #[arg(long)]
    pictures: bool,
    /// Number of threads; one for each core where absent.
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
}

/// Confinement at both ends of a range.
fn confinement(density: &str) -> Result<[f64; 2], Error> {
    let one = |word: &str| match word {
        "open" => Some(0.0),
        "medium" => Some(0.5),
        "confined" => Some(1.0),
        number => number.parse().ok().filter(|share| (0.0..=1.0).contains(share)),
    };
    let (from, to) = density.split_once("..").unwrap_or((density, density));
    match (one(from), one(to)) {
        (Some(from), Some(to)) => Ok([from, to]),
        _ => Err(Error::Usage(format!(
            "--density: expected open, medium, confined or a number from 0 to 1, or a range such as open..confined, got \"{density}\""
        ))),
    }
}

fn scene(args: &SceneArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = GenerateScenesRequest {
        count: args.count,
        confinement: confinement(&args.density)?,
        seed: args.seed,
        robots: args.robot.clone(),
        pictures: args.pictures,
        threads: args.threads,
        output: args.output.clone(),
    };
    Ok(set_report(&pipeline::generate_scenes(&request, context)?))
}

fn variants(args: &VariantsArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = GenerateVariantsRequest {
        scenes: args.scenes.clone(),
        count: args.count,
        furniture: args.furniture,
        seed: args.seed,
        robots: args.robot.clone(),
        pictures: args.pictures,
        threads: args.threads,
        output: args.output.clone(),
    };
    Ok(set_report(&pipeline::generate_variants(&request, context)?))
}

fn set_report(set: &SceneSet) -> Report {
    let mut json = serde_json::to_value(set).unwrap_or_default();
    json["output"] = serde_json::json!(set.output);
    json["seconds"] = serde_json::json!(set.seconds);
    Report::done(scene_text(set), json)
}

fn scene_text(set: &SceneSet) -> String {
    let counts = |counts: &std::collections::BTreeMap<String, usize>| {
        let words = counts.iter().map(|(name, count)| format!("{count} {name}"));
        words.collect::<Vec<_>>().join(", ")
    };
    let attempts: u64 = set.scenes.iter().map(|scene| scene.attempts).sum();
    format!(
        "{}: {} scenes in {:.1} s, {:.2} attempts each\nlayouts: {}\ntasks by object: {}\ntasks by robot: {}\nfree floor: {:.0}% in the more open half, {:.0}% in the more confined one",
        set.output.display(),
        set.scenes.len(),
        set.seconds,
        attempts as f64 / set.scenes.len().max(1) as f64,
        counts(&set.layouts),
        counts(&set.classes),
        counts(&set.robots),
        100.0 * set.free_floor[0],
        100.0 * set.free_floor[1],
    )
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
pub fn run(args: &GenerateArgs, context: &Context<'_>) -> Result<Report, Error> {
    match &args.what {
        What::Object(args) => object(args),
        What::Scene(args) => scene(args, context),
        What::Variants(args) => variants(args, context),
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
        picture: args.picture,
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
