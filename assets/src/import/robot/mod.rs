//! Robots from URDF: the planning group, the tool frame and the gripper are found in the tree.
//!
//! What a URDF does not say is inferred from its kinematics and shapes alone, never from link names of
//! known robots: fingers are what moves against each other at the end of the longest chain, and the tool
//! frame lies between their tips.

use akrobat_model::load::AssetSearch;
use akrobat_model::mesh_io::MeshCache;
use akrobat_model::robot::{ArmSection, BaseKind, BaseSection, GripperSection, SpheresSection};
use akrobat_model::{Joint, JointKind, KinematicTree, ModelError, Pose, RobotFile, urdf};
use nalgebra::Vector3;

use super::Ledger;

pub mod compose;
mod gripper;

pub use compose::{Carrier, Mount};
use gripper::Gripper;

/// Name of the URDF in a robot's folder.
pub const URDF_NAME: &str = "robot";
/// Arms with fewer joints cannot place a tool.
const FEWEST_ARM_JOINTS: usize = 4;
/// Most joints that one plan may move besides the base: what is further down the chain stands still.
const MOST_ARM_JOINTS: usize = 12;
/// How far continuous arm joints may turn: planning needs limits, radians.
const CONTINUOUS_REACH: f64 = std::f64::consts::TAU;
/// The gripper for robots that have none: two sliding fingers.
const PARALLEL_GRIPPER: &str = include_str!("../../../../configs/robots/parallel_gripper.urdf");

/// What the user says about a robot that its URDF does not.
#[derive(Debug, Clone, Default)]
pub struct RobotOptions {
    /// Name; the URDF's where absent.
    pub name: Option<String>,
    /// How the base moves; found in the tree where absent.
    pub base: Option<BaseKind>,
    /// Link that carries the gripper, where there is more than one or none.
    pub tool_link: Option<String>,
    /// SPDX expression of the robot's files.
    pub license: String,
    /// Where the robot's files come from.
    pub source: String,
}

/// A robot whose structure is known; its resting pose, spheres and mask are still to be found.
#[derive(Debug, Clone)]
pub struct ImportedRobot {
    /// The whole tree, base and gripper included.
    pub tree: KinematicTree,
    /// The robot file, with all joints of the arm resting in the middle of their ranges.
    pub file: RobotFile,
    /// What was repaired and lost.
    pub ledger: Ledger,
    /// Other chains that could have been the planning group, by the link that they carry.
    pub alternatives: Vec<String>,
}

/// Reads a robot, puts it on what carries it, and finds its structure.
///
/// # Errors
/// [`ModelError`] where a URDF does not load, or has no chain that could be an arm.
pub fn read(
    path: &std::path::Path,
    mounts: &[Mount],
    carrier: Option<&Carrier>,
    options: &RobotOptions,
    search: &AssetSearch,
) -> Result<ImportedRobot, ModelError> {
    let mut cache = MeshCache::default();
    let mut ledger = Ledger::default();
    let loaded = urdf::load(path, search, &mut cache)?;
    loaded.notes.into_iter().for_each(|note| ledger.repaired(note));
    let carried = loaded.tree;
    let tree = match carrier {
        None => carried,
        Some(carrier) => {
            compose::mounted(path, carried, carrier, mounts, search, &mut cache, &mut ledger)?
        }
    };
    describe(path, tree, options, ledger)
}

/// Finds the structure of a tree.
fn describe(
    path: &std::path::Path,
    tree: KinematicTree,
    options: &RobotOptions,
    mut ledger: Ledger,
) -> Result<ImportedRobot, ModelError> {
    let (tree, gripper, alternatives) = with_gripper(path, tree, options, &mut ledger)?;
    let chain: Vec<usize> =
        tree.chain_to(gripper.palm).into_iter().filter(|&j| is_driven(&tree.joints()[j])).collect();
    let base = virtual_base(&tree, &chain);
    let arm = &chain[base.as_ref().map_or(0, |_| 3)..];
    let skipped = arm.len().saturating_sub(MOST_ARM_JOINTS);
    for &joint in &arm[..skipped] {
        let name = &tree.joints()[joint].name;
        ledger.repaired(format!(
            "joint \"{name}\" stands still: one plan moves {MOST_ARM_JOINTS} joints at most"
        ));
    }
    let arm = arm[skipped..].to_vec();
    if arm.len() < FEWEST_ARM_JOINTS {
        return Err(ModelError::invalid(
            path,
            format!(
                "found no arm: the longest chain, to link \"{}\", has {} driven joints; expected at least {FEWEST_ARM_JOINTS}",
                tree.links()[gripper.palm].name,
                arm.len()
            ),
        ));
    }
    let tree = with_limits(tree, &arm, &mut ledger)?;
    let kind = match options.base {
        Some(kind) => kind,
        None if base.is_some() || has_wheels(&tree) => BaseKind::Holonomic,
        None => BaseKind::Fixed,
    };
    let name = |joint: &usize| tree.joints()[*joint].name.clone();
    let file = RobotFile {
        name: options.name.clone().unwrap_or_else(|| tree.name.clone()),
        urdf: format!("{URDF_NAME}.urdf").into(),
        license: options.license.clone(),
        source: options.source.clone(),
        base: BaseSection {
            kind,
            joints: match kind {
                BaseKind::Fixed => None,
                _ => base.map(|joints| joints.map(|joint| name(&joint))),
            },
            velocity_limits: [1.0; 3],
            platform: None,
        },
        arm: ArmSection {
            joints: arm.iter().map(name).collect(),
            retract: arm.iter().map(|&joint| middle(&tree.joints()[joint])).collect(),
        },
        gripper: gripper_section(&tree, &gripper),
        locked: Default::default(),
        acceleration_limit: 15.0,
        acceleration_limits: arm
            .iter()
            .filter(|&&joint| tree.joints()[joint].kind == JointKind::Prismatic)
            .map(|joint| (name(joint), 0.5))
            .collect(),
        spheres: SpheresSection::default(),
        self_collision_ignore: Vec::new(),
    };
    Ok(ImportedRobot { tree, file, ledger, alternatives })
}

fn gripper_section(tree: &KinematicTree, gripper: &Gripper) -> GripperSection {
    let name = |link: &usize| tree.links()[*link].name.clone();
    GripperSection {
        joints: gripper.joints.iter().map(|&j| tree.joints()[j].name.clone()).collect(),
        closed: gripper.closed.clone(),
        open: gripper.open.clone(),
        open_width_m: gripper.open_width_m,
        finger_links: gripper.finger_links.iter().map(name).collect(),
        tool_link: name(&gripper.palm),
        link_from_tool: akrobat_model::pose::to_xyz_wxyz(&gripper.palm_from_tool).map(tidy),
        attach: None,
    }
}

/// A number without the digits that sampled surfaces do not determine.
fn tidy(value: f64) -> f64 {
    // Adding zero turns -0 into 0.
    (value * 1e6).round() / 1e6 + 0.0
}

/// The tree with a gripper, the one to plan with, and the other links that could have been it.
fn with_gripper(
    path: &std::path::Path,
    tree: KinematicTree,
    options: &RobotOptions,
    ledger: &mut Ledger,
) -> Result<(KinematicTree, Gripper, Vec<String>), ModelError> {
    let wanted = options.tool_link.as_ref().map(|link| tree.link_index(link)).transpose()?;
    let mut found = gripper::find(&tree);
    // The longest chain first; of equals, the one that the file has first.
    found.sort_by_key(|g| std::cmp::Reverse(arm_length(&tree, g.palm)));
    found.retain(|g| arm_length(&tree, g.palm) >= FEWEST_ARM_JOINTS);
    let matching = |g: &Gripper| {
        wanted.is_none_or(|link| {
            link == g.palm
                || tree.chain_to(g.palm).iter().any(|&j| {
                    tree.joints()[j].child == link
                        && arm_length(&tree, link) == arm_length(&tree, g.palm)
                })
        })
    };
    if let Some(position) = found.iter().position(matching) {
        let chosen = found.remove(position);
        let others = found.iter().map(|g| tree.links()[g.palm].name.clone()).collect();
        return Ok((tree, chosen, others));
    }
    let flange = match wanted {
        Some(link) => link,
        None => flange(&tree).ok_or_else(|| {
            ModelError::invalid(path, "found no arm: no chain of joints ends in a link of its own")
        })?,
    };
    attach_gripper(path, tree, flange, ledger)
}

/// Bolts our gripper on a flange, along the axis that the last joint turns the flange about.
fn attach_gripper(
    path: &std::path::Path,
    tree: KinematicTree,
    flange: usize,
    ledger: &mut Ledger,
) -> Result<(KinematicTree, Gripper, Vec<String>), ModelError> {
    let folder = tempfile::tempdir().map_err(|e| ModelError::read(path, e))?;
    let file = folder.path().join("parallel_gripper.urdf");
    std::fs::write(&file, PARALLEL_GRIPPER).map_err(|e| ModelError::read(&file, e))?;
    let (gripper, _) = urdf::read(&file, &AssetSearch::default())?;
    let carried_by = tree.links()[flange].name.clone();
    let approach = flange_axis(&tree, flange);
    let flange_from_gripper = Pose::from_parts(
        Vector3::zeros().into(),
        nalgebra::UnitQuaternion::rotation_between(&Vector3::z(), &approach).unwrap_or_else(|| {
            nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        }),
    );
    let tree = tree.attach(flange, flange_from_gripper, gripper)?;
    ledger.repaired(format!(
        "no parallel gripper found: a generic one, 9 cm wide, is bolted on link \"{carried_by}\""
    ));
    let mut found = gripper::find(&tree);
    found.sort_by_key(|g| std::cmp::Reverse(arm_length(&tree, g.palm)));
    let is_ours =
        |g: &Gripper| tree.chain_to(g.palm).iter().any(|&j| tree.joints()[j].parent == flange);
    let position = found.iter().position(is_ours).ok_or_else(|| {
        ModelError::invalid(path, format!("a gripper on link \"{carried_by}\" is not recognised"))
    })?;
    let gripper = found.remove(position);
    Ok((tree, gripper, Vec::new()))
}

/// The direction out of a flange in its frame: the last joint's axis, pointing away from the arm.
fn flange_axis(tree: &KinematicTree, flange: usize) -> Vector3<f64> {
    let chain = tree.chain_to(flange);
    let Some(&last) = chain.iter().rfind(|&&j| is_driven(&tree.joints()[j])) else {
        return Vector3::z();
    };
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let joint = &tree.joints()[last];
    let world_axis = poses[joint.child].rotation * joint.axis.into_inner();
    let along = |from: usize, to: usize| {
        (poses[to].translation.vector - poses[from].translation.vector).dot(&world_axis)
    };
    // Where the flange does not tell, the way of the last link does, then the joint's own axis.
    let signs = [along(joint.child, flange), along(joint.parent, joint.child)];
    let sign = signs.into_iter().find(|s| s.abs() > 5e-3).map_or(1.0, f64::signum);
    let axis = poses[flange].rotation.inverse() * (world_axis * sign);
    snapped(axis)
}

/// A direction along a coordinate axis where it is nearly that.
fn snapped(direction: Vector3<f64>) -> Vector3<f64> {
    let along = direction.iamax();
    if direction[along].abs() < 0.99 {
        return direction;
    }
    let mut axis = Vector3::zeros();
    axis[along] = direction[along].signum();
    axis
}

/// The end of the longest chain of driven joints; of equals, the first. Its last fixed link, where the
/// way to it does not branch, else the last one with the chain.
fn flange(tree: &KinematicTree) -> Option<usize> {
    let ends = (0..tree.links().len()).filter(|&l| {
        tree.parent_joint(l).is_some_and(|j| is_driven(&tree.joints()[j]) && !is_wheel(tree, j))
    });
    let mut best: Option<usize> = None;
    for link in ends {
        if best.is_none_or(|b| arm_length(tree, link) > arm_length(tree, b)) {
            best = Some(link);
        }
    }
    let mut link = best?;
    const TOOL_NAMES: [&str; 5] = ["tool0", "tool", "flange", "ee", "hand"];
    loop {
        let fixed: Vec<usize> = tree
            .joints()
            .iter()
            .filter(|j| j.parent == link && j.kind == JointKind::Fixed)
            .map(|j| j.child)
            .collect();
        let name = |l: usize| tree.links()[l].name.to_lowercase();
        let named = TOOL_NAMES
            .iter()
            .find_map(|tool| fixed.iter().find(|&&l| name(l).contains(tool)).copied());
        match (named, &fixed[..]) {
            (Some(next), _) => link = next,
            (None, [only]) => link = *only,
            (None, _) => return Some(link),
        }
    }
}

/// Joints that a plan can move.
fn is_driven(joint: &Joint) -> bool {
    joint.kind != JointKind::Fixed && joint.mimic.is_none()
}

/// Number of driven joints above a link.
fn arm_length(tree: &KinematicTree, link: usize) -> usize {
    tree.chain_to(link).iter().filter(|&&j| is_driven(&tree.joints()[j])).count()
}

/// Turns without limits about a level axis and carries nothing that moves further.
fn is_wheel(tree: &KinematicTree, joint: usize) -> bool {
    let candidate = &tree.joints()[joint];
    if candidate.kind != JointKind::Continuous || candidate.mimic.is_some() {
        return false;
    }
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let axis = poses[candidate.child].rotation * candidate.axis.into_inner();
    let carries = |l: usize| tree.chain_to(l).contains(&joint) && l != candidate.child;
    let moves_more = (0..tree.links().len())
        .filter(|&l| carries(l))
        .any(|l| tree.parent_joint(l).is_some_and(|j| tree.joints()[j].kind != JointKind::Fixed));
    axis.z.abs() < 0.2 && !moves_more && arm_length(tree, candidate.child) <= 4
}

fn has_wheels(tree: &KinematicTree) -> bool {
    (0..tree.joints().len()).filter(|&j| is_wheel(tree, j)).count() >= 2
}

/// The first three joints of a chain, where they are x, y and yaw.
fn virtual_base(tree: &KinematicTree, chain: &[usize]) -> Option<[usize; 3]> {
    let &[x, y, yaw, ..] = chain else { return None };
    let joint = |j: usize| &tree.joints()[j];
    let slides = |j: usize| joint(j).kind == JointKind::Prismatic && joint(j).axis.z.abs() < 0.01;
    let turns = matches!(joint(yaw).kind, JointKind::Revolute | JointKind::Continuous)
        && joint(yaw).axis.z.abs() > 0.99;
    (slides(x) && slides(y) && turns).then_some([x, y, yaw])
}

/// The tree with limits on the arm's continuous joints.
fn with_limits(
    tree: KinematicTree,
    arm: &[usize],
    ledger: &mut Ledger,
) -> Result<KinematicTree, ModelError> {
    let mut joints = tree.joints().to_vec();
    for &index in arm {
        let joint = &mut joints[index];
        if joint.kind == JointKind::Continuous {
            joint.kind = JointKind::Revolute;
            joint.limits = [-CONTINUOUS_REACH, CONTINUOUS_REACH];
            ledger.repaired(format!(
                "continuous joint \"{}\" is limited to one turn either way",
                joint.name
            ));
        }
    }
    KinematicTree::new(tree.name.clone(), tree.links().to_vec(), joints)
}

/// The middle of a joint's range, or zero where that is well inside it.
fn middle(joint: &Joint) -> f64 {
    let [lower, upper] = joint.limits;
    let margin = 0.1 * (upper - lower);
    if (lower + margin..=upper - margin).contains(&0.0) { 0.0 } else { (lower + upper) / 2.0 }
}
