//! `akrobat import` of objects, scenes and grasps.

use std::path::{Path, PathBuf};

use akrobat_assets::import::grasps::Convention;
use akrobat_assets::import::partnet::Size;
use clap::{Args, ValueEnum};
use serde_json::json;

use crate::cli::Report;
use crate::pipeline::{self, AssetKind, AssetSource, Context, ImportAssetRequest};
use crate::{Error, ExitCode};

/// Where things come from and go to.
#[derive(Debug, Args)]
struct Paths {
    /// The file or folder to import.
    input: PathBuf,
    /// Folder to write: a URDF, meshes/, and object.json or scene.json; must be new or empty.
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// Folder where meshes and packages are looked up; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
    /// Robot file of the tasks that are written beside what opens (task.toml, tasks/); the built-in robot where absent.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
    /// Draw it as well: object.png, or scene.png.
    #[arg(long)]
    picture: bool,
}

/// Object or surroundings.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// A thing: one URDF.
    Object,
    /// Surroundings: what stands still, and objects with joints.
    Scene,
}

impl From<Kind> for AssetKind {
    fn from(kind: Kind) -> Self {
        match kind {
            Kind::Object => Self::Object,
            Kind::Scene => Self::Scene,
        }
    }
}

/// Import a PartNet-Mobility folder as downloaded.
///
/// Turns its front to +x, puts it on the floor in its class's usual size, completes missing or swapped limits
/// (from mobility_v2.json where it is there), bounds doors that turn without end, and merges the many OBJ parts
/// of a link by name. Exit code 3 where something had to be left out, such as a part whose mesh is missing.
///
/// Examples:
///   akrobat import partnet partnet/7128 -o microwave_7128
///   akrobat import partnet partnet/45612 --class cabinet --height 0.9 -o cabinet_45612
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct PartNetArgs {
    #[command(flatten)]
    paths: Paths,
    /// Class of the object; meta.json's where absent.
    #[arg(long)]
    class: Option<String>,
    /// Height, metres; the class's usual one where absent.
    #[arg(long, value_name = "METRES", conflicts_with = "scale")]
    height: Option<f64>,
    /// Factor from the file's size to the true one.
    #[arg(long)]
    scale: Option<f64>,
}

/// Import an Infinigen scene (GLB, glTF, OBJ, or USD with `pip install 'akrobat[usd]'`).
///
/// Brings the kitchen's floor to z = 0. With --objects, static placeholders of ovens, refrigerators and the like are
/// replaced by articulated objects of their class, scaled uniformly to their boxes.
///
/// Example:
///   akrobat import infinigen scene.glb --state solve_state.json --objects objects/ -o kitchen
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct InfinigenArgs {
    #[command(flatten)]
    paths: Paths,
    /// The layout solver's solve_state.json: which bodies are placeholders, and which way they face.
    #[arg(long, value_name = "FILE")]
    state: Option<PathBuf>,
    /// Folder of folders, each with an articulated object's URDF, named by class (`oven_1`).
    #[arg(long, value_name = "DIR")]
    objects: Option<PathBuf>,
}

/// Import an MJCF model (MuJoCo, robosuite, LIBERO, Franka kitchen).
///
/// Takes over bodies, hinge and slide joints, meshes and primitives, with includes, defaults and compiler
/// settings. Link frames are MuJoCo's body frames, joint positions its qpos.
///
/// Example:
///   akrobat import mjcf microwave.xml -o microwave
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct MjcfArgs {
    #[command(flatten)]
    paths: Paths,
    /// What it is; more than one body below the world make a scene where nothing is said.
    #[arg(long = "as", value_enum)]
    kind: Option<Kind>,
}

/// Import a URDF: an object, or a room.
///
/// Examples:
///   akrobat import urdf cabinet.urdf -o cabinet
///   akrobat import urdf room.urdf --as scene -o room
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct UrdfArgs {
    #[command(flatten)]
    paths: Paths,
    /// What it is.
    #[arg(long = "as", value_enum, default_value = "object")]
    kind: Kind,
}

/// Import an SDF world or model, or Drake's model directives.
///
/// Examples:
///   akrobat import sdf world.sdf -o world
///   akrobat import sdf furnished_living_room.dmd.yaml -o living_room
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct SdfArgs {
    #[command(flatten)]
    paths: Paths,
}

/// Import a USD stage (.usd, .usda, .usdc, .usdz): surroundings, or an object.
///
/// Meshes and primitive shapes, with colours of preview surfaces; rigid bodies and their revolute, prismatic and fixed
/// joints. Units become metres and z is up. Needs Python and `pip install 'akrobat[usd]'`.
///
/// Examples:
///   akrobat import usd kitchen.usda -o kitchen
///   akrobat import usd microwave.usd --as object -o microwave
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct UsdArgs {
    #[command(flatten)]
    paths: Paths,
    /// What it is.
    #[arg(long = "as", value_enum, default_value = "scene")]
    kind: Kind,
}

/// Import a ProcTHOR or AI2-THOR house (JSON).
///
/// Walls get their holes, doors become leaves on hinges, objects become boxes of their asset's size, where a
/// database states it, else of their kind's usual one.
///
/// Example:
///   akrobat import procthor house.json --database asset-database.json -o house
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct ProcThorArgs {
    #[command(flatten)]
    paths: Paths,
    /// Sizes of assets: {"ASSET_ID": {"boundingBox": {"x", "y", "z"}}}.
    #[arg(long, value_name = "FILE")]
    database: Option<PathBuf>,
}

/// Import grasps: AO-Grasp results (JSON with pos_wf and quat_wf, xyzw), or NPY of 4 x 4 matrices or of rows
/// x y z qw qx qy qz, in the object's frame.
///
/// Example:
///   akrobat import grasps grasps.npy -o grasps.txt      then `file = "grasps.txt"` under [grasps] of a task
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct GraspsArgs {
    /// The file to import.
    input: PathBuf,
    /// Text file to write.
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
    /// Frame that the file's poses are of.
    #[arg(long, value_enum, default_value = "panda-hand")]
    frame: GraspedFrame,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum GraspedFrame {
    /// The Franka hand's: its pads are 10.34 cm in front of it.
    PandaHand,
    /// Ours: origin between the pads, z along the approach, y along the closing direction.
    Tool,
}

/// Runs `import partnet`.
pub fn run_partnet(args: &PartNetArgs, context: &Context<'_>) -> Result<Report, Error> {
    let size = match (args.height, args.scale) {
        (Some(height), _) => Size::Height(positive("--height", height)?),
        (_, Some(scale)) => Size::Scale(positive("--scale", scale)?),
        _ => Size::OfClass,
    };
    run(&args.paths, AssetSource::PartNet { class: args.class.clone(), size }, context)
}

fn positive(flag: &str, value: f64) -> Result<f64, Error> {
    if value.is_finite() && value > 0.0 {
        return Ok(value);
    }
    Err(Error::Usage(format!("{flag}: expected a number above 0, got {value}")))
}

/// Runs `import infinigen`.
pub fn run_infinigen(args: &InfinigenArgs, context: &Context<'_>) -> Result<Report, Error> {
    let source =
        AssetSource::Infinigen { state: args.state.clone(), objects: args.objects.clone() };
    run(&args.paths, source, context)
}

/// Runs `import mjcf`.
pub fn run_mjcf(args: &MjcfArgs, context: &Context<'_>) -> Result<Report, Error> {
    run(&args.paths, AssetSource::Mjcf(args.kind.map(Into::into)), context)
}

/// Runs `import urdf`.
pub fn run_urdf(args: &UrdfArgs, context: &Context<'_>) -> Result<Report, Error> {
    run(&args.paths, AssetSource::Urdf(args.kind.into()), context)
}

/// Runs `import sdf`.
pub fn run_sdf(args: &SdfArgs, context: &Context<'_>) -> Result<Report, Error> {
    run(&args.paths, AssetSource::Sdf, context)
}

/// Runs `import usd`.
pub fn run_usd(args: &UsdArgs, context: &Context<'_>) -> Result<Report, Error> {
    run(&args.paths, AssetSource::Usd(args.kind.into()), context)
}

/// Runs `import procthor`.
pub fn run_procthor(args: &ProcThorArgs, context: &Context<'_>) -> Result<Report, Error> {
    run(&args.paths, AssetSource::ProcThor { database: args.database.clone() }, context)
}

fn run(paths: &Paths, source: AssetSource, context: &Context<'_>) -> Result<Report, Error> {
    let request = ImportAssetRequest {
        input: paths.input.clone(),
        source,
        output: paths.output.clone(),
        assets: paths.assets.clone(),
        robot: paths.robot.clone(),
        picture: paths.picture,
    };
    let report = pipeline::import_asset(&request, context)?;
    Ok(Report {
        text: report.text(),
        json: serde_json::to_value(&report).unwrap_or_default(),
        exit_code: exit_code(report.lost.is_empty()),
    })
}

fn exit_code(whole: bool) -> ExitCode {
    if whole { ExitCode::Done } else { ExitCode::Incomplete }
}

/// Runs `import grasps`.
pub fn run_grasps(args: &GraspsArgs) -> Result<Report, Error> {
    let convention = match args.frame {
        GraspedFrame::PandaHand => Convention::panda_hand(),
        GraspedFrame::Tool => Convention::tool(),
    };
    let output: &Path = &args.output;
    let (count, ledger) = pipeline::import_grasps(&args.input, convention, output)?;
    let lost = ledger.lost.iter().map(|lost| format!("\n  lost     {lost}"));
    Ok(Report {
        text: format!("{}: {count} grasps{}", output.display(), lost.collect::<String>()),
        json: json!({ "output": output, "grasps": count, "repairs": ledger.repairs, "lost": ledger.lost }),
        exit_code: exit_code(ledger.lost.is_empty()),
    })
}
