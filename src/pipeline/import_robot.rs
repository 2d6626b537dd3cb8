//! URDF -> robot folder: description, spheres, mask and resting pose.

use std::path::{Path, PathBuf};

use akrobat_assets::import::layout::{write_folder, write_tree};
use akrobat_assets::import::robot::{self, Carrier, Mount, RobotOptions, URDF_NAME};
use akrobat_model::RobotFile;
use akrobat_model::events::Event;
use akrobat_model::load::{self, AssetSearch};
use akrobat_planner::mask::{self, MaskedPair, Reason};
use akrobat_planner::spheres::{self, SphereFit};
use akrobat_planner::{SphereModel, rest};
use serde::Serialize;

use super::Context;
use crate::Error;

/// Names of the files of a robot folder.
const ROBOT_FILE: &str = "robot.toml";
const SPHERES_FILE: &str = "spheres.yml";

/// What is to be imported.
#[derive(Debug, Clone)]
pub struct ImportRobotRequest {
    /// URDF of the robot, or of the arm.
    pub input: PathBuf,
    /// What carries it.
    pub carrier: Option<Carrier>,
    /// Where it stands there; several for several arms.
    pub mounts: Vec<Mount>,
    /// What the URDF does not say.
    pub options: RobotOptions,
    /// Number of collision spheres, at most.
    pub spheres: usize,
    /// Seed of what is sampled.
    pub seed: u64,
    /// Folder to write.
    pub output: PathBuf,
    /// Folders where assets are looked up.
    pub assets: Vec<PathBuf>,
}

/// What an import gave.
#[derive(Debug, Clone, Serialize)]
pub struct ImportRobotReport {
    /// The robot file.
    pub robot: PathBuf,
    /// The robot file's content.
    #[serde(flatten)]
    pub file: RobotFile,
    /// Number of collision spheres.
    pub sphere_count: usize,
    /// Fraction of the links' surfaces inside a sphere: the mean over links, by their number of spheres.
    pub coverage: f64,
    /// Largest distance by which a sphere reaches beyond its link's surface, metres.
    pub protrusion_m: f64,
    /// The spheres of each link.
    pub fits: Vec<SphereFit>,
    /// Link pairs that need not be compared.
    pub masked: Vec<MaskedPair>,
    /// Other links whose chains could have been planned for.
    pub alternatives: Vec<String>,
    /// What was repaired.
    pub repairs: Vec<String>,
    /// What could not be taken over.
    pub lost: Vec<String>,
}

/// Imports a robot.
///
/// # Errors
/// Where a description is wrong or has no arm, or the folder cannot be written.
pub fn import_robot(
    request: &ImportRobotRequest,
    context: &Context<'_>,
) -> Result<ImportRobotReport, Error> {
    let search = context.asset_search(&request.assets)?;
    let stage = |stage: &str| context.observer.event(&Event::StageStarted { stage, total: None });
    stage("reading the description");
    let carrier = request.carrier.as_ref();
    let mut imported =
        robot::read(&request.input, &request.mounts, carrier, &request.options, &search)?;
    let mut outcome = None;
    write_folder(&request.output, |folder| {
        write_tree(folder, URDF_NAME, &imported.tree)?;
        write_robot_file(folder, &imported.file)?;
        let robot_path = folder.join(ROBOT_FILE);
        let mut robot = load::robot(&robot_path, &AssetSearch::default())?;
        stage("fitting spheres");
        let moves = |&link: &usize| {
            robot.tree.chain_to(link).iter().any(|joint| robot.arm_joints.contains(joint))
        };
        let arm: Vec<usize> = (0..robot.tree.links().len()).filter(moves).collect();
        let model = spheres::fit_within(&robot.tree, request.spheres, &arm, &robot.finger_links);
        stage("sampling self-collisions");
        let masked = mask::derive(&robot, &model, request.seed);
        let (overstated, apart): (Vec<_>, Vec<_>) =
            masked.iter().partition(|pair| pair.reason == Reason::Overstated);
        let links = |pairs: Vec<&MaskedPair>| pairs.iter().map(|pair| pair.links.clone()).collect();
        robot.file.self_collision_ignore = links(apart);
        robot.file.spheres.overstated = links(overstated);
        stage("looking for a resting pose");
        let retract = rest::find(&robot, &model, request.seed);
        match retract {
            Some(retract) => robot.file.arm.retract = retract,
            None => imported.ledger.lost(
                "no free resting pose found: the arm rests in the middle of its ranges, where links touch",
            ),
        }
        let yaml = spheres::to_curobo_yaml(&robot.tree, &model);
        std::fs::write(folder.join(SPHERES_FILE), yaml)
            .map_err(|e| Error::write(&request.output, &e))?;
        robot.file.spheres.file = Some(SPHERES_FILE.into());
        write_robot_file(folder, &robot.file)?;
        load::robot(&robot_path, &AssetSearch::default())?;
        outcome = Some((robot, model, masked));
        Ok::<(), Error>(())
    })?;
    let Some((robot, model, masked)) = outcome else {
        return Err(Error::Failed("the robot folder was not filled".into()));
    };
    let robot::ImportedRobot { ledger, alternatives, .. } = imported;
    let (coverage, protrusion_m) = fit_of(&model);
    Ok(ImportRobotReport {
        robot: request.output.join(ROBOT_FILE),
        sphere_count: model.spheres.len(),
        coverage,
        protrusion_m,
        fits: model.fits,
        masked,
        alternatives,
        repairs: ledger.repairs,
        lost: ledger.lost,
        file: robot.file,
    })
}

/// Mean coverage by number of spheres, and the largest protrusion.
fn fit_of(model: &SphereModel) -> (f64, f64) {
    let count = model.spheres.len().max(1) as f64;
    let covered = model.fits.iter().map(|fit| fit.coverage * fit.count as f64).sum::<f64>();
    let protrusion_m = model.fits.iter().map(|fit| fit.protrusion_m).fold(0.0, f64::max);
    (covered / count, protrusion_m)
}

fn write_robot_file(folder: &Path, file: &RobotFile) -> Result<(), Error> {
    let path = folder.join(ROBOT_FILE);
    let toml = toml::to_string(file).map_err(|e| {
        Error::Failed(format!("{}: cannot be written as TOML: {e}", path.display()))
    })?;
    std::fs::write(&path, toml).map_err(|e| Error::write(&path, &e))
}

impl ImportRobotReport {
    /// For people.
    pub fn text(&self) -> String {
        let file = &self.file;
        let gripper = &file.gripper;
        let mut lines = vec![
            format!("{}: robot \"{}\", {:?} base", self.robot.display(), file.name, file.base.kind),
            format!("  arm      {}", file.arm.joints.join(", ")),
            format!("  resting  {:?}", file.arm.retract),
            format!(
                "  gripper  {} on {}, {:.1} mm wide; tool frame {:?}",
                gripper.joints.join(", "),
                gripper.tool_link,
                1e3 * gripper.open_width_m,
                gripper.link_from_tool
            ),
            format!(
                "  spheres  {}: {:.1}% of the surfaces inside, {:.1} cm beyond them at most",
                self.sphere_count,
                100.0 * self.coverage,
                100.0 * self.protrusion_m
            ),
            format!("  mask     {} link pairs besides adjacent ones", self.masked.len()),
        ];
        if !self.alternatives.is_empty() {
            let others = self.alternatives.join(", ");
            lines.push(format!("  instead  --tool-link {others} plans with another arm"));
        }
        lines.extend(self.repairs.iter().map(|repair| format!("  repaired {repair}")));
        lines.extend(self.lost.iter().map(|lost| format!("  lost     {lost}")));
        lines.join("\n")
    }
}
