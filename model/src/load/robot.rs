//! Robot files.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;

use super::{AssetSearch, check_position, joint_index, link_index, parse_toml, place};
use crate::mesh_io::MeshCache;
use crate::pose::from_xyz_wxyz;
use crate::robot::BaseKind;
use crate::{
    Joint, JointKind, KinematicTree, Link, ModelError, Pose, Robot, RobotFile, hash, urdf,
};

/// Names of the virtual base joints that are added where a robot has none.
const BASE_JOINTS: [&str; 3] = ["base_x", "base_y", "base_theta"];
/// Reach of added base joints along x and y, metres.
const BASE_REACH_M: f64 = 50.0;

/// A robot and what its identity rests on.
pub struct LoadedRobot {
    pub robot: Robot,
    text: String,
    mesh_files: BTreeMap<String, PathBuf>,
    gripper_urdf: Option<PathBuf>,
    platform_urdf: Option<PathBuf>,
}

impl LoadedRobot {
    /// Adds the hashes of the robot's files.
    pub fn add_hashes(&self, hashes: &mut BTreeMap<String, String>) -> Result<(), ModelError> {
        hashes.insert("robot".into(), hash::of_bytes(self.text.as_bytes()));
        hashes.insert("robot.urdf".into(), hash::of_file(&self.robot.urdf_path)?);
        hashes.insert("robot.meshes".into(), super::hashes::of_files(&self.mesh_files)?);
        for (name, file) in [
            ("robot.gripper", &self.gripper_urdf),
            ("robot.platform", &self.platform_urdf),
            ("robot.spheres", &self.robot.spheres_path),
        ] {
            if let Some(file) = file {
                hashes.insert(name.into(), hash::of_file(file)?);
            }
        }
        Ok(())
    }
}

/// Loads and checks a robot file.
pub fn load(path: &Path, search: &AssetSearch) -> Result<LoadedRobot, ModelError> {
    let (text, file): (String, RobotFile) = parse_toml(path)?;
    let urdf_path = search.find(&file.urdf, path)?;
    let mut cache = MeshCache::default();
    let urdf::UrdfFile { tree, mut notes, mut mesh_files } =
        urdf::load(&urdf_path, search, &mut cache)?;
    let (tree, gripper_urdf) = match &file.gripper.attach {
        None => (tree, None),
        Some(section) => {
            let gripper_urdf = search.find(&section.urdf, path)?;
            let gripper = urdf::load(&gripper_urdf, search, &mut cache)?;
            notes.extend(gripper.notes);
            mesh_files.extend(gripper.mesh_files);
            let at = ["gripper.attach", "link_from_gripper"];
            let mount = (&*section.link, section.link_from_gripper);
            (attached(path, at, tree, mount, gripper.tree)?, Some(gripper_urdf))
        }
    };
    let (tree, platform_urdf) = match &file.base.platform {
        None => (tree, None),
        Some(section) => {
            let platform_urdf = search.find(&section.urdf, path)?;
            let platform = urdf::load(&platform_urdf, search, &mut cache)?;
            notes.extend(platform.notes);
            mesh_files.extend(platform.mesh_files);
            let at = ["base.platform", "link_from_robot"];
            let mount = (&*section.link, section.link_from_robot);
            (attached(path, at, platform.tree, mount, tree)?, Some(platform_urdf))
        }
    };
    let adds_base = file.base.kind == BaseKind::Holonomic && file.base.joints.is_none();
    let tree = if adds_base { with_virtual_base(path, tree, &file)? } else { tree };

    let base_joints = base_joints(path, &tree, &file)?;
    let tool_link = link_index(&place(path, "gripper.tool_link"), &tree, &file.gripper.tool_link)?;
    let arm_joints = arm_joints(path, &tree, &file, tool_link)?;
    check_base_below_arm(path, &tree, &base_joints, tool_link, &arm_joints)?;
    let gripper_joints = gripper_joints(path, &tree, &file)?;
    check_planned_once(path, &tree, [&base_joints, &arm_joints, &gripper_joints])?;
    let finger_place = place(path, "gripper.finger_links");
    let finger_links = file.gripper.finger_links.iter();
    let finger_links: Vec<usize> =
        finger_links.map(|l| link_index(&finger_place, &tree, l)).collect::<Result<_, _>>()?;
    let link_from_tool = from_xyz_wxyz(file.gripper.link_from_tool).ok_or_else(|| {
        ModelError::bad_value(
            place(path, "gripper.link_from_tool"),
            "expected [x y z qw qx qy qz] with finite numbers and a quaternion that is not zero",
        )
    })?;
    check_numbers(path, &tree, &file)?;
    let rest = rest(path, &tree, &file, &arm_joints, &gripper_joints)?;
    let spheres_path = file.spheres.file.as_ref().map(|f| search.find(f, path)).transpose()?;
    let robot = Robot {
        name: file.name.clone(),
        base_joints,
        arm_joints,
        gripper_joints,
        tool_link,
        link_from_tool,
        finger_links,
        rest,
        world_from_root: Pose::identity(),
        urdf_path,
        spheres_path,
        notes,
        tree,
        file,
    };
    Ok(LoadedRobot { robot, text, mesh_files, gripper_urdf, platform_urdf })
}

/// `tree` with `other` bolted on a link of it at a pose. `section` and `key` name both in errors.
fn attached(
    path: &Path,
    [section, key]: [&str; 2],
    tree: KinematicTree,
    (link, pose): (&str, [f64; 7]),
    other: KinematicTree,
) -> Result<KinematicTree, ModelError> {
    let place = place(path, section);
    let link = link_index(&place, &tree, link)?;
    let link_from_other = from_xyz_wxyz(pose).ok_or_else(|| {
        let message = format!("{key}: expected [x y z qw qx qy qz], got {pose:?}");
        ModelError::bad_value(place.clone(), message)
    })?;
    tree.attach(link, link_from_other, other).map_err(|e| match e {
        ModelError::BadValue { context, message } => {
            ModelError::bad_value(place, format!("{context}: {message}"))
        }
        other => other,
    })
}

/// The tree under three new joints: x, y and yaw in the world.
fn with_virtual_base(
    path: &Path,
    tree: KinematicTree,
    file: &RobotFile,
) -> Result<KinematicTree, ModelError> {
    if let Some(taken) = BASE_JOINTS.iter().find(|name| tree.joint_index(name).is_ok()) {
        return Err(ModelError::bad_value(
            place(path, "base.joints"),
            format!(
                "the URDF already has a joint \"{taken}\": name its three virtual joints (x, y, yaw) in base.joints"
            ),
        ));
    }
    let root = tree.root();
    let (mut links, mut joints) = (tree.links().to_vec(), tree.joints().to_vec());
    let first = links.len();
    for wanted in ["world", "base_link_x", "base_link_y"] {
        let name = free_name(wanted, &links);
        links.push(Link { name, ..Link::default() });
    }
    let turn = std::f64::consts::TAU;
    let steps = [
        (JointKind::Prismatic, Vector3::x_axis(), BASE_REACH_M, first, first + 1),
        (JointKind::Prismatic, Vector3::y_axis(), BASE_REACH_M, first + 1, first + 2),
        (JointKind::Revolute, Vector3::z_axis(), turn, first + 2, root),
    ];
    let added =
        steps.into_iter().enumerate().map(|(i, (kind, axis, reach, parent, child))| Joint {
            name: BASE_JOINTS[i].to_owned(),
            kind,
            parent,
            child,
            parent_from_joint: Pose::identity(),
            axis,
            limits: [-reach, reach],
            velocity_limit: Some(file.base.velocity_limits[i]),
            effort_limit: None,
            damping: 0.0,
            friction: 0.0,
            mimic: None,
        });
    joints.extend(added);
    KinematicTree::new(tree.name, links, joints)
}

fn free_name(wanted: &str, links: &[Link]) -> String {
    let taken = |name: &str| links.iter().any(|l| l.name == name);
    if !taken(wanted) {
        return wanted.to_owned();
    }
    (2..)
        .map(|n| format!("{wanted}_{n}"))
        .find(|name| !taken(name))
        .expect("finitely many links cannot take infinitely many names")
}

fn base_joints(
    path: &Path,
    tree: &KinematicTree,
    file: &RobotFile,
) -> Result<Vec<usize>, ModelError> {
    let place = place(path, "base.joints");
    let names: Vec<&str> = match (&file.base.joints, file.base.kind) {
        (Some(_), BaseKind::Fixed) => {
            return Err(ModelError::bad_value(place, "a fixed base has no joints; leave them out"));
        }
        (Some(names), _) => names.iter().map(String::as_str).collect(),
        (None, BaseKind::Holonomic) => BASE_JOINTS.to_vec(),
        (None, _) => return Ok(Vec::new()),
    };
    let joints: Vec<usize> =
        names.iter().map(|n| joint_index(&place, tree, n)).collect::<Result<_, _>>()?;
    for (slot, &index) in joints.iter().enumerate() {
        let joint = &tree.joints()[index];
        let slides = joint.kind == JointKind::Prismatic;
        let turns = matches!(joint.kind, JointKind::Revolute | JointKind::Continuous);
        if (slot < 2 && !slides) || (slot == 2 && !turns) {
            return Err(ModelError::bad_value(
                place,
                format!(
                    "expected two prismatic joints (x, y) and a revolute one (yaw); number {} is \"{}\", a {:?} joint",
                    slot + 1,
                    joint.name,
                    joint.kind
                ),
            ));
        }
    }
    Ok(joints)
}

fn arm_joints(
    path: &Path,
    tree: &KinematicTree,
    file: &RobotFile,
    tool_link: usize,
) -> Result<Vec<usize>, ModelError> {
    let place = place(path, "arm.joints");
    if file.arm.joints.is_empty() {
        return Err(ModelError::bad_value(place, "expected at least one joint"));
    }
    let names = file.arm.joints.iter();
    let joints: Vec<usize> =
        names.map(|n| joint_index(&place, tree, n)).collect::<Result<_, _>>()?;
    let chain = tree.chain_to(tool_link);
    let mut last = None;
    for &joint in &joints {
        let name = &tree.joints()[joint].name;
        let Some(position) = chain.iter().position(|&j| j == joint) else {
            let on_chain = chain
                .iter()
                .map(|&j| &tree.joints()[j])
                .filter(|j| j.kind != JointKind::Fixed)
                .map(|j| j.name.clone());
            return Err(ModelError::unknown(
                format!("{place}: not on the chain to tool link \"{}\"", file.gripper.tool_link),
                "joint",
                name,
                on_chain,
            ));
        };
        if last.is_some_and(|last| position <= last) {
            return Err(ModelError::bad_value(
                place,
                format!(
                    "joints must be listed once, from base to tool; \"{name}\" is out of order"
                ),
            ));
        }
        last = Some(position);
        check_actuated(&place, &tree.joints()[joint])?;
    }
    Ok(joints)
}

fn check_actuated(place: &str, joint: &Joint) -> Result<(), ModelError> {
    if joint.kind != JointKind::Fixed && joint.mimic.is_none() {
        return Ok(());
    }
    let why = if joint.mimic.is_some() { "follows another joint" } else { "is fixed" };
    Err(ModelError::bad_value(
        place,
        format!("joint \"{}\" {why} and cannot be planned", joint.name),
    ))
}

fn check_base_below_arm(
    path: &Path,
    tree: &KinematicTree,
    base_joints: &[usize],
    tool_link: usize,
    arm_joints: &[usize],
) -> Result<(), ModelError> {
    let chain = tree.chain_to(tool_link);
    let order = |joint: &usize| chain.iter().position(|j| j == joint);
    let positions: Vec<Option<usize>> =
        base_joints.iter().chain(&arm_joints[..1]).map(order).collect();
    if positions.iter().all(Option::is_some) && positions.is_sorted() {
        return Ok(());
    }
    Err(ModelError::bad_value(
        place(path, "base.joints"),
        "the base joints must lie on the chain to the tool, in the order x, y, yaw, before the arm",
    ))
}

fn gripper_joints(
    path: &Path,
    tree: &KinematicTree,
    file: &RobotFile,
) -> Result<Vec<usize>, ModelError> {
    let gripper = &file.gripper;
    let place = place(path, "gripper.joints");
    for (what, values) in [("closed", &gripper.closed), ("open", &gripper.open)] {
        if values.len() != gripper.joints.len() {
            return Err(ModelError::bad_value(
                format!("{}: gripper.{what}", path.display()),
                format!(
                    "expected {} values, one per joint, got {}",
                    gripper.joints.len(),
                    values.len()
                ),
            ));
        }
    }
    let mut joints = Vec::new();
    for (index, name) in gripper.joints.iter().enumerate() {
        let joint = joint_index(&place, tree, name)?;
        check_actuated(&place, &tree.joints()[joint])?;
        check_position(&place, &tree.joints()[joint], gripper.closed[index])?;
        check_position(&place, &tree.joints()[joint], gripper.open[index])?;
        joints.push(joint);
    }
    Ok(joints)
}

fn check_planned_once(
    path: &Path,
    tree: &KinematicTree,
    groups: [&Vec<usize>; 3],
) -> Result<(), ModelError> {
    let mut seen = std::collections::HashSet::new();
    match groups.into_iter().flatten().find(|&&joint| !seen.insert(joint)) {
        None => Ok(()),
        Some(&joint) => Err(ModelError::invalid(
            path,
            format!(
                "joint \"{}\" is listed twice in base, arm and gripper",
                tree.joints()[joint].name
            ),
        )),
    }
}

/// Limits, widths and speeds that must be positive, and the names they go by.
fn check_numbers(path: &Path, tree: &KinematicTree, file: &RobotFile) -> Result<(), ModelError> {
    let positive = |section: &str, value: f64| {
        if value.is_finite() && value > 0.0 {
            return Ok(());
        }
        let message = format!("expected a number above 0, got {value}");
        Err(ModelError::bad_value(place(path, section), message))
    };
    positive("acceleration_limit", file.acceleration_limit)?;
    positive("gripper.open_width_m", file.gripper.open_width_m)?;
    file.base.velocity_limits.iter().try_for_each(|&v| positive("base.velocity_limits", v))?;
    file.spheres.voxel_m.map_or(Ok(()), |v| positive("spheres.voxel_m", v))?;
    for (name, &limit) in &file.acceleration_limits {
        joint_index(&place(path, "acceleration_limits"), tree, name)?;
        positive("acceleration_limits", limit)?;
    }
    for (key, pairs) in [
        ("self_collision_ignore", &file.self_collision_ignore),
        ("spheres.overstated", &file.spheres.overstated),
    ] {
        let listed = place(path, key);
        pairs.iter().flatten().try_for_each(|link| link_index(&listed, tree, link).map(|_| ()))?;
    }
    let renamed = place(path, "spheres.rename");
    file.spheres.rename.values().try_for_each(|link| link_index(&renamed, tree, link).map(|_| ()))
}

/// Full configuration: retracted arm, open fingers, locked joints, all others neutral.
fn rest(
    path: &Path,
    tree: &KinematicTree,
    file: &RobotFile,
    arm_joints: &[usize],
    gripper_joints: &[usize],
) -> Result<Vec<f64>, ModelError> {
    if file.arm.retract.len() != arm_joints.len() {
        return Err(ModelError::bad_value(
            place(path, "arm.retract"),
            format!(
                "expected {} values, one per joint, got {}",
                arm_joints.len(),
                file.arm.retract.len()
            ),
        ));
    }
    let mut rest = tree.neutral();
    let mut set = |place: &str, joint: usize, position: f64| {
        check_position(place, &tree.joints()[joint], position)?;
        if let Some(column) = tree.column(joint) {
            rest[column] = position;
        }
        Ok::<(), ModelError>(())
    };
    for (&joint, &position) in arm_joints.iter().zip(&file.arm.retract) {
        set(&place(path, "arm.retract"), joint, position)?;
    }
    for (&joint, &position) in gripper_joints.iter().zip(&file.gripper.open) {
        set(&place(path, "gripper.open"), joint, position)?;
    }
    let locked = place(path, "locked");
    for (name, &position) in &file.locked {
        let joint = joint_index(&locked, tree, name)?;
        check_actuated(&locked, &tree.joints()[joint])?;
        if arm_joints.contains(&joint) || gripper_joints.contains(&joint) {
            let message = format!("joint \"{name}\" is planned and cannot be locked as well");
            return Err(ModelError::bad_value(locked, message));
        }
        set(&locked, joint, position)?;
    }
    Ok(rest)
}
