//! `akrobat import robot`.

use std::path::PathBuf;

use akrobat_assets::import::robot::{Carrier, Mount, RobotOptions};
use akrobat_model::pose::from_xyz_rpy;
use akrobat_model::robot::BaseKind;
use clap::{Args, ValueEnum};

use crate::cli::Report;
use crate::pipeline::{self, Context, ImportRobotRequest};
use crate::{Error, ExitCode};

/// Turn a URDF into a robot that plans can use.
///
/// Finds the planning group, the gripper and the tool frame in the description, fits collision spheres, derives
/// the self-collision mask and a resting pose by sampling, and writes a folder: robot.toml, robot.urdf, meshes/,
/// spheres.yml. An arm without a gripper gets a generic parallel one.
///
/// Examples:
///   akrobat import robot summit_xl_franka.urdf -o summit
///   akrobat import robot panda.urdf --mount-on summit_xl.urdf --mount-link top --mount-xyz 0.2,0,0.05 -o summit_panda
///   akrobat import robot ur5.urdf --mount-on ridgeback.urdf --mount-xyz 0.3,0.2,0.3 --mount-xyz 0.3,-0.2,0.3 \
///       --mount-prefix left_ --mount-prefix right_ -o ridgeback_ur5s
///   akrobat import robot ur5.urdf --mount-on box:0.5,0.5,0.6 -o ur5_on_box
///
/// Plan with it by `file = "summit/robot.toml"` under [robot] of a task. Every value in robot.toml may be edited.
#[derive(Debug, Args)]
#[command(verbatim_doc_comment)]
pub struct RobotArgs {
    /// URDF of the robot, or of the arm that is mounted.
    urdf: PathBuf,
    /// Folder to write; must be new or empty.
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// Name of the robot; the URDF's where absent.
    #[arg(long)]
    name: Option<String>,
    /// What carries the arm: a URDF, or `box:X,Y,Z` with edge lengths in metres.
    #[arg(long, value_name = "URDF|box:X,Y,Z")]
    mount_on: Option<String>,
    /// Link of the carrier that holds the arm, its root where absent; once, or once for each arm.
    #[arg(long, value_name = "LINK", requires = "mount_on")]
    mount_link: Vec<String>,
    /// Origin of the arm's root in that link, metres; repeat it to mount the arm several times.
    #[arg(long, value_name = "X,Y,Z", value_parser = triple, requires = "mount_on", allow_hyphen_values = true)]
    mount_xyz: Vec<[f64; 3]>,
    /// Roll, pitch, yaw of the arm's root in that link, radians; once, or once for each arm.
    #[arg(long, value_name = "R,P,Y", value_parser = triple, requires = "mount_on", allow_hyphen_values = true)]
    mount_rpy: Vec<[f64; 3]>,
    /// Start of the names of the mounted arm's links and joints; once for each arm.
    #[arg(long, value_name = "PREFIX", requires = "mount_on")]
    mount_prefix: Vec<String>,
    /// How the base moves; found in the description where absent.
    #[arg(long, value_enum)]
    base: Option<Base>,
    /// Link that carries the gripper, where there are several or the wrong one was found.
    #[arg(long, value_name = "LINK")]
    tool_link: Option<String>,
    /// Number of collision spheres, at most.
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(10..=1000))]
    spheres: u32,
    /// Licence of the robot's files, an SPDX expression: it goes into every dataset made with the robot.
    #[arg(long, value_name = "SPDX", default_value = "")]
    license: String,
    /// Seed of what is sampled.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Folder where meshes and packages are looked up; may be repeated.
    #[arg(long, value_name = "DIR")]
    assets: Vec<PathBuf>,
}

/// [`BaseKind`] on the command line.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum Base {
    /// Moves freely in the plane.
    Holonomic,
    /// Stands still.
    Fixed,
}

fn triple(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let numbers = numbers.and_then(|n| <[f64; 3]>::try_from(n).ok());
    numbers
        .filter(|n| n.iter().all(|v| v.is_finite()))
        .ok_or_else(|| format!("expected three numbers X,Y,Z, got \"{text}\""))
}

/// Runs the verb.
pub fn run(args: &RobotArgs, context: &Context<'_>) -> Result<Report, Error> {
    let request = ImportRobotRequest {
        input: args.urdf.clone(),
        carrier: args.mount_on.as_deref().map(carrier).transpose()?,
        mounts: mounts(args)?,
        options: RobotOptions {
            name: args.name.clone(),
            base: args.base.map(|base| match base {
                Base::Holonomic => BaseKind::Holonomic,
                Base::Fixed => BaseKind::Fixed,
            }),
            tool_link: args.tool_link.clone(),
            license: args.license.clone(),
            source: args.urdf.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        },
        spheres: args.spheres as usize,
        seed: args.seed,
        output: args.output.clone(),
        assets: args.assets.clone(),
    };
    let report = pipeline::import_robot(&request, context)?;
    Ok(Report {
        text: report.text(),
        json: serde_json::to_value(&report).unwrap_or_default(),
        exit_code: if report.lost.is_empty() { ExitCode::Done } else { ExitCode::Incomplete },
    })
}

fn carrier(text: &str) -> Result<Carrier, Error> {
    match text.strip_prefix("box:") {
        Some(size) => {
            triple(size).map(Carrier::Box).map_err(|e| Error::Usage(format!("--mount-on box: {e}")))
        }
        None => Ok(Carrier::Urdf(text.into())),
    }
}

/// One mount for each `--mount-xyz`; links and turns may be given once for all.
fn mounts(args: &RobotArgs) -> Result<Vec<Mount>, Error> {
    if args.mount_on.is_none() {
        return Ok(Vec::new());
    }
    let count = args.mount_xyz.len().max(1);
    let counts = [("--mount-link", args.mount_link.len()), ("--mount-rpy", args.mount_rpy.len())];
    if let Some((flag, got)) = counts.into_iter().find(|&(_, n)| n > 1 && n != count) {
        return Err(Error::Usage(format!("{flag}: expected 1 or {count} of them, got {got}")));
    }
    if ![0, count].contains(&args.mount_prefix.len()) || (count > 1 && args.mount_prefix.is_empty())
    {
        let got = args.mount_prefix.len();
        return Err(Error::Usage(format!(
            "--mount-prefix: {count} arms need {count} different prefixes, got {got}"
        )));
    }
    fn nth<T>(values: &[T], index: usize) -> Option<&T> {
        values.get(index).or(values.first())
    }
    let mount = |index: usize| {
        let xyz = args.mount_xyz.get(index).copied().unwrap_or_default();
        let rpy = nth(&args.mount_rpy, index).copied().unwrap_or_default();
        Mount {
            link: nth(&args.mount_link, index).cloned(),
            link_from_arm: from_xyz_rpy(xyz, rpy),
            prefix: args.mount_prefix.get(index).cloned().unwrap_or_default(),
        }
    };
    Ok((0..count).map(mount).collect())
}
