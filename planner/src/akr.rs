//! The augmented kinematic representation: robot, a virtual fixed joint at the grasp, and the object
//! re-rooted at the held link, as one tree (AutoMoMa, CVPR 2026, section on AKR construction).

use akrobat_model::task::ManipulatedObject;
use akrobat_model::trajectory::Grasp;
use akrobat_model::{Joint, JointKind, KinematicTree, Link, ModelError, Part, Pose, Robot};
use nalgebra::{Unit, Vector3};

/// Prefix of the object's links and joints inside an [`Akr`].
pub const OBJECT_PREFIX: &str = "object/";

/// A tree re-rooted at another link.
#[derive(Debug, Clone)]
pub struct Rerooted {
    /// The tree with the new root. Link and joint indices are those of the original.
    pub tree: KinematicTree,
    /// For each link, its old frame in its new one: a URDF joint moves the frame of its child, so links on
    /// the reversed path get new frames.
    pub new_from_old: Vec<Pose>,
}

/// Re-roots `tree` at `new_root`: the joints between are reversed, every transform is updated, and all
/// branches keep their geometry and their joints. Joint variables keep their meaning: the same
/// configuration gives the same relative poses of all links.
///
/// # Errors
/// Only if the result is not a tree, which would be a defect.
pub fn reroot(tree: &KinematicTree, new_root: usize) -> Result<Rerooted, ModelError> {
    let reversed = tree.chain_to(new_root);
    let mut new_from_old = vec![Pose::identity(); tree.links().len()];
    for &joint in &reversed {
        let joint = &tree.joints()[joint];
        new_from_old[joint.parent] = joint.parent_from_joint.inverse();
    }
    let links = tree.links().iter().zip(&new_from_old).map(|(l, shift)| shifted_link(l, shift));
    let joints = tree.joints().iter().enumerate().map(|(index, joint)| {
        if reversed.contains(&index) {
            reversed_joint(joint, &new_from_old[joint.child])
        } else {
            let mut joint = joint.clone();
            joint.parent_from_joint = new_from_old[joint.parent] * joint.parent_from_joint;
            joint
        }
    });
    let tree = KinematicTree::new(tree.name.clone(), links.collect(), joints.collect())?;
    Ok(Rerooted { tree, new_from_old })
}

/// The joint seen from its child: `child'_from_parent'(q) = child'_from_child * M(-q)`.
fn reversed_joint(joint: &Joint, new_from_old_child: &Pose) -> Joint {
    Joint {
        parent: joint.child,
        child: joint.parent,
        parent_from_joint: *new_from_old_child,
        axis: -joint.axis,
        ..joint.clone()
    }
}

fn shifted_link(link: &Link, new_from_old: &Pose) -> Link {
    let shift = |parts: &[Part]| {
        parts
            .iter()
            .map(|part| Part { link_from_part: new_from_old * part.link_from_part, ..part.clone() })
            .collect()
    };
    let mut inertial = link.inertial.clone();
    if let Some(inertial) = &mut inertial {
        inertial.link_from_inertia = new_from_old * inertial.link_from_inertia;
    }
    Link {
        name: link.name.clone(),
        visuals: shift(&link.visuals),
        collisions: shift(&link.collisions),
        inertial,
    }
}

/// Robot and held object as one tree.
#[derive(Debug, Clone)]
pub struct Akr {
    /// The tree; the robot's links and joints come first, with their own indices.
    pub tree: KinematicTree,
    /// Variables of the chain: base, arm, then the driven object joint.
    pub variables: Vec<usize>,
    /// Rest configuration: the robot's with fingers at the grasp's width, the object's start.
    pub rest: Vec<f64>,
    /// Link that stands for the object's root.
    pub object_root: usize,
    /// The object's own root frame in that link's frame.
    pub root_link_from_object: Pose,
}

/// Assembles the AKR of a robot that holds an object.
///
/// # Errors
/// [`ModelError`] where the grasp names an unknown link or the object's driven joint does not move it.
pub fn assemble(
    robot: &Robot,
    object: &ManipulatedObject,
    grasp: &Grasp,
) -> Result<Akr, ModelError> {
    let held = object.tree.link_index(&grasp.link)?;
    if !object.tree.chain_to(held).contains(&object.active_joint) {
        let joint = &object.tree.joints()[object.active_joint].name;
        let message = format!("held link \"{}\" is not moved by joint \"{joint}\"", grasp.link);
        return Err(ModelError::bad_value(&object.name, message));
    }
    let rerooted = reroot(&object.tree, held)?;
    let (robot_links, robot_joints) = (robot.tree.links().len(), robot.tree.joints().len());

    let mut links = robot.tree.links().to_vec();
    links.extend(
        rerooted
            .tree
            .links()
            .iter()
            .map(|link| Link { name: format!("{OBJECT_PREFIX}{}", link.name), ..link.clone() }),
    );
    let mut joints = robot.tree.joints().to_vec();
    joints.extend(rerooted.tree.joints().iter().map(|joint| {
        let mut joint = joint.clone();
        joint.name = format!("{OBJECT_PREFIX}{}", joint.name);
        joint.parent += robot_links;
        joint.child += robot_links;
        if let Some(mimic) = &mut joint.mimic {
            mimic.joint += robot_joints;
        }
        joint
    }));
    let held_from_tool = rerooted.new_from_old[held] * grasp.link_from_tool;
    joints.push(Joint {
        name: format!("{OBJECT_PREFIX}grasp"),
        kind: JointKind::Fixed,
        parent: robot.tool_link,
        child: robot_links + held,
        parent_from_joint: robot.link_from_tool * held_from_tool.inverse(),
        axis: Unit::new_unchecked(Vector3::z()),
        limits: [0.0, 0.0],
        velocity_limit: None,
        effort_limit: None,
        damping: 0.0,
        friction: 0.0,
        mimic: None,
    });
    let tree = KinematicTree::new(format!("{}+{}", robot.name, object.name), links, joints)?;

    let mut variables = [&robot.base_joints[..], &robot.arm_joints].concat();
    variables.push(robot_joints + object.active_joint);
    let mut robot_rest = robot.rest.clone();
    for (&joint, q) in robot.gripper_joints.iter().zip(robot.finger_positions(grasp.width_m)) {
        if let Some(column) = robot.tree.column(joint) {
            robot_rest[column] = q;
        }
    }
    let object_root = object.tree.root();
    Ok(Akr {
        tree,
        variables,
        rest: [robot_rest, object.start.clone()].concat(),
        object_root: robot_links + object_root,
        root_link_from_object: rerooted.new_from_old[object_root],
    })
}
