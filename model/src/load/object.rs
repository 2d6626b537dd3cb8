//! Object sections of task files.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use nalgebra::{UnitQuaternion, Vector3};

use super::scene::{bounds, matching, parts_bounds};
use super::{AssetSearch, check_position, joint_index, link_index, place};
use crate::mesh_io::MeshCache;
use crate::pose::from_xyz_wxyz;
use crate::task::{
    ManipulatedObject, ObjectKind, ObjectSection, Replaces, TaskFile, matches_pattern,
};
use crate::{JointKind, KinematicTree, ModelError, Pose, Scene, free_object, hash, urdf};

/// An object and what its identity rests on.
pub struct LoadedObject {
    pub object: ManipulatedObject,
    urdf_path: PathBuf,
    mesh_files: BTreeMap<String, PathBuf>,
}

impl LoadedObject {
    /// Adds the hashes of the object's files.
    pub fn add_hashes(&self, hashes: &mut BTreeMap<String, String>) -> Result<(), ModelError> {
        hashes.insert("object.urdf".into(), hash::of_file(&self.urdf_path)?);
        hashes.insert("object.meshes".into(), super::hashes::of_files(&self.mesh_files)?);
        Ok(())
    }
}

/// Scales that some unit of length may call for; beyond them there is a mistake.
const SCALES: RangeInclusive<f64> = 1e-4..=1e4;

/// Loads, scales and places the object of the task at `task_path`; a body that it replaces is removed
/// from `scene`.
pub fn load(
    task_path: &Path,
    task: &TaskFile,
    search: &AssetSearch,
    scene: &mut Scene,
) -> Result<LoadedObject, ModelError> {
    let section = &task.object;
    if !SCALES.contains(&section.scale) {
        let (least, most) = (SCALES.start(), SCALES.end());
        let message = format!("expected a number from {least} to {most}, got {}", section.scale);
        return Err(ModelError::bad_value(place(task_path, "object.scale"), message));
    }
    let urdf_path = search.find(&section.urdf, task_path)?;
    let urdf::UrdfFile { tree, notes, mesh_files } =
        urdf::load(&urdf_path, search, &mut MeshCache::default())?;
    let tree = if section.scale == 1.0 { tree } else { tree.scaled(section.scale) };
    let (tree, world_from_root) = placed(task_path, task, tree, scene)?;
    if section.kind != ObjectKind::Articulated {
        let object = free_object(task_path, task, tree, &world_from_root, notes)?;
        return Ok(LoadedObject { object, urdf_path, mesh_files });
    }
    if !task.goal.poses.is_empty() {
        let message = "only rigid and planar objects have goal poses; set goal.positions";
        return Err(ModelError::bad_value(place(task_path, "goal.poses"), message));
    }
    let active_joint = active_joint(task_path, section, &tree)?;
    let start = start(task_path, task, &tree, active_joint)?;
    check_goals(task_path, task, &tree, active_joint)?;
    let (handle_link, handle_parts) = handle(task_path, section, &tree, active_joint)?;
    let object = ManipulatedObject {
        name: section.name.clone().unwrap_or_else(|| tree.name.clone()),
        handle_region: section.handle.as_ref().and_then(|h| h.region),
        tree,
        world_from_root,
        active_joint,
        handle_link,
        handle_parts,
        start,
        notes,
    };
    Ok(LoadedObject { object, urdf_path, mesh_files })
}

/// A rigid or planar object: its virtual joints are driven.
fn free_object(
    task_path: &Path,
    task: &TaskFile,
    tree: KinematicTree,
    world_from_object: &Pose,
    notes: Vec<String>,
) -> Result<ManipulatedObject, ModelError> {
    let section = &task.object;
    let kind = section.kind;
    let refuse =
        |key: &str, message: String| Err(ModelError::bad_value(place(task_path, key), message));
    if !section.joint.is_empty() {
        let message = "only an articulated object has a driven joint; leave it out".into();
        return refuse("object.joint", message);
    }
    if !task.goal.positions.is_empty() {
        let message = "rigid and planar objects have goal.poses; leave it out".into();
        return refuse("goal.positions", message);
    }
    if task.goal.poses.is_empty() {
        return refuse("goal.poses", "expected at least one pose, got none".into());
    }
    for pose in &task.goal.poses {
        let Some(goal) = from_xyz_wxyz(*pose) else {
            return refuse("goal.poses", format!("expected [x y z qw qx qy qz], got {pose:?}"));
        };
        let lifted = (goal.translation.z - world_from_object.translation.z).abs();
        let tilted = free_object::tilt(world_from_object, &goal);
        if kind == ObjectKind::Planar && (lifted > 1e-4 || tilted > 1e-3) {
            let message = format!(
                "{pose:?}: a planar object stays upright at its height; this one is {lifted:.4} m off and tilted by {tilted:.4} rad"
            );
            return refuse("goal.poses", message);
        }
        if kind == ObjectKind::Rigid && goal.rotation.euler_angles().1.abs() > 1.45 {
            let message = format!(
                "{pose:?}: pitch must stay within 1.45 rad, where yaw and roll can be told apart"
            );
            return refuse("goal.poses", message);
        }
    }
    let body = tree.root();
    let tree = free_object::with_virtual_joints(tree, kind, world_from_object)?;
    let active_joint = tree.joint_index(free_object::joint_names(kind)[0])?;
    let mut start = tree.neutral();
    let locked = place(task_path, "object.locked");
    for (name, &position) in &section.locked {
        let joint = joint_index(&locked, &tree, name)?;
        check_movable(&locked, &tree, joint)?;
        check_position(&locked, &tree.joints()[joint], position)?;
        if let Some(column) = tree.column(joint) {
            start[column] = position;
        }
    }
    let positions = free_object::positions(kind, world_from_object);
    for (name, position) in free_object::joint_names(kind).iter().zip(positions) {
        if let Some(column) = tree.column(tree.joint_index(name)?) {
            start[column] = position;
        }
    }
    let (handle_link, handle_parts) = match section.handle {
        Some(_) => handle(task_path, section, &tree, active_joint)?,
        None => (body, vec!["*".to_owned()]),
    };
    Ok(ManipulatedObject {
        name: section.name.clone().unwrap_or_else(|| tree.name.clone()),
        handle_region: section.handle.as_ref().and_then(|h| h.region),
        tree,
        world_from_root: Pose::identity(),
        active_joint,
        handle_link,
        handle_parts,
        start,
        notes,
    })
}

/// The tree, scaled to fit where asked, and its pose.
fn placed(
    task_path: &Path,
    task: &TaskFile,
    tree: KinematicTree,
    scene: &mut Scene,
) -> Result<(KinematicTree, Pose), ModelError> {
    let section = &task.object;
    match (&section.pose, &section.replaces) {
        (Some(pose), None) => {
            let pose = from_xyz_wxyz(*pose).ok_or_else(|| {
                let message = format!("expected [x y z qw qx qy qz], got {pose:?}");
                ModelError::bad_value(place(task_path, "object.pose"), message)
            })?;
            Ok((tree, pose))
        }
        (None, Some(replaces)) => in_place_of(task_path, task, replaces, tree, scene),
        (Some(_), Some(_)) | (None, None) => {
            let got = if section.pose.is_some() { "both" } else { "neither" };
            Err(ModelError::bad_value(
                place(task_path, "object"),
                format!("expected exactly one of \"pose\" and \"replaces\", got {got}"),
            ))
        }
    }
}

/// Puts the object where a body stood: bottoms level, backs (-x in the object's frame) flush, centred
/// sideways, all in the object's turned frame.
fn in_place_of(
    task_path: &Path,
    task: &TaskFile,
    replaces: &Replaces,
    tree: KinematicTree,
    scene: &mut Scene,
) -> Result<(KinematicTree, Pose), ModelError> {
    let found = matching(task_path, "object.replaces.body", &scene.bodies, &replaces.body)?;
    let place = place(task_path, "object.replaces");
    let [body] = found[..] else {
        let names: Vec<&str> = found.iter().map(|b| b.name.as_str()).collect();
        let message = format!(
            "\"{}\" matches {} bodies, expected one: {}",
            replaces.body,
            names.len(),
            names.join(", ")
        );
        return Err(ModelError::bad_value(place, message));
    };
    if !replaces.yaw.is_finite() {
        let message = format!("yaw: expected a finite number, got {}", replaces.yaw);
        return Err(ModelError::bad_value(place, message));
    }
    let world_from_turned = Pose::from_parts(
        Vector3::zeros().into(),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), replaces.yaw),
    );
    let no_geometry =
        |what: &str| ModelError::bad_value(place.clone(), format!("{what} has no geometry"));
    let (body_low, body_high) =
        bounds(body, &world_from_turned.inverse()).ok_or_else(|| no_geometry(&body.name))?;
    let name = body.name.clone();

    let object_bounds = |tree: &KinematicTree| {
        // The driven joint's start is in scaled units, which a fit changes: it is set where it is known
        // by name, and checked later.
        let q = start_or_neutral(tree, task);
        let poses = tree.link_poses(&Pose::identity(), &q);
        let visuals = tree.links().iter().zip(poses);
        parts_bounds(visuals.flat_map(|(link, pose)| {
            let parts = if link.visuals.is_empty() { &link.collisions } else { &link.visuals };
            parts.iter().map(move |part| (pose, part))
        }))
        .ok_or_else(|| no_geometry("the object"))
    };
    let (low, high) = object_bounds(&tree)?;
    let (tree, low, high) = if replaces.fit {
        let ratios = (body_high - body_low).component_div(&(high - low));
        let ratio = ratios.min();
        if !(ratio.is_finite() && ratio > 0.0) {
            let message = format!("\"{name}\" is flat: an object cannot be fitted to it");
            return Err(ModelError::bad_value(place, message));
        }
        let tree = tree.scaled(ratio);
        let (low, high) = object_bounds(&tree)?;
        (tree, low, high)
    } else {
        (tree, low, high)
    };
    let turned_from_root = Vector3::new(
        body_low.x - low.x,
        (body_low.y + body_high.y - low.y - high.y) / 2.0,
        body_low.z - low.z,
    );
    scene.bodies.retain(|b| b.name != name);
    let offset = Pose::translation(turned_from_root.x, turned_from_root.y, turned_from_root.z);
    Ok((tree, world_from_turned * offset))
}

/// The start as far as its names and limits are right.
fn start_or_neutral(tree: &KinematicTree, task: &TaskFile) -> Vec<f64> {
    let mut q = tree.neutral();
    let stated = task.object.locked.iter().map(|(name, &position)| (name, position));
    for (name, position) in stated.chain([(&task.object.joint, task.goal.start)]) {
        let Ok(joint) = tree.joint_index(name) else { continue };
        let [lower, upper] = tree.joints()[joint].limits;
        if let Some(column) = tree.column(joint)
            && position.is_finite()
        {
            q[column] = position.clamp(lower, upper);
        }
    }
    q
}

fn active_joint(
    task_path: &Path,
    section: &ObjectSection,
    tree: &KinematicTree,
) -> Result<usize, ModelError> {
    let place = place(task_path, "object.joint");
    let index = joint_index(&place, tree, &section.joint)?;
    check_movable(&place, tree, index)?;
    Ok(index)
}

fn check_movable(place: &str, tree: &KinematicTree, joint: usize) -> Result<(), ModelError> {
    let joint = &tree.joints()[joint];
    if joint.kind != JointKind::Fixed && joint.mimic.is_none() {
        return Ok(());
    }
    let why = if joint.mimic.is_some() { "follows another joint" } else { "is fixed" };
    let movable = tree.dof_joints().iter().map(|&j| tree.joints()[j].name.as_str());
    let choices: Vec<&str> = movable.collect();
    let message = format!("joint \"{}\" {why}; valid choices: {}", joint.name, choices.join(", "));
    Err(ModelError::bad_value(place, message))
}

fn start(
    task_path: &Path,
    task: &TaskFile,
    tree: &KinematicTree,
    active_joint: usize,
) -> Result<Vec<f64>, ModelError> {
    let mut start = tree.neutral();
    let locked = place(task_path, "object.locked");
    for (name, &position) in &task.object.locked {
        let joint = joint_index(&locked, tree, name)?;
        check_movable(&locked, tree, joint)?;
        check_position(&locked, &tree.joints()[joint], position)?;
        if joint == active_joint {
            let message = format!("joint \"{name}\" is the driven one; set goal.start instead");
            return Err(ModelError::bad_value(locked, message));
        }
        if let Some(column) = tree.column(joint) {
            start[column] = position;
        }
    }
    let position = task.goal.start;
    check_position(&place(task_path, "goal.start"), &tree.joints()[active_joint], position)?;
    if let Some(column) = tree.column(active_joint) {
        start[column] = position;
    }
    Ok(start)
}

fn check_goals(
    task_path: &Path,
    task: &TaskFile,
    tree: &KinematicTree,
    active_joint: usize,
) -> Result<(), ModelError> {
    let place = place(task_path, "goal.positions");
    if task.goal.positions.is_empty() {
        return Err(ModelError::bad_value(place, "expected at least one position, got none"));
    }
    let joint = &tree.joints()[active_joint];
    task.goal.positions.iter().try_for_each(|&goal| check_position(&place, joint, goal))
}

/// The held link and the patterns of its handle parts.
fn handle(
    task_path: &Path,
    section: &ObjectSection,
    tree: &KinematicTree,
    active_joint: usize,
) -> Result<(usize, Vec<String>), ModelError> {
    let all = || vec!["*".to_owned()];
    let Some(handle) = &section.handle else {
        return Ok((tree.joints()[active_joint].child, all()));
    };
    let link = link_index(&place(task_path, "object.handle.link"), tree, &handle.link)?;
    if !tree.chain_to(link).contains(&active_joint) {
        let below = (0..tree.links().len()).filter(|&l| tree.chain_to(l).contains(&active_joint));
        return Err(ModelError::unknown(
            format!(
                "{}: object.handle.link must be moved by joint \"{}\"",
                task_path.display(),
                section.joint
            ),
            "link",
            &handle.link,
            below.map(|l| tree.links()[l].name.clone()),
        ));
    }
    let parts = || tree.links()[link].visuals.iter().chain(&tree.links()[link].collisions);
    for pattern in &handle.parts {
        if !parts().any(|part| matches_pattern(pattern, &part.name)) {
            let names = parts().map(|part| part.name.clone());
            return Err(ModelError::unknown(
                place(task_path, "object.handle.parts"),
                "part",
                pattern,
                names,
            ));
        }
    }
    if let Some(region) = handle.region
        && !(region.iter().all(|v| v.is_finite()) && (0..3).all(|i| region[i] < region[i + 3]))
    {
        return Err(ModelError::bad_value(
            place(task_path, "object.handle.region"),
            format!(
                "expected [xmin ymin zmin xmax ymax zmax] with each min below its max, got {region:?}"
            ),
        ));
    }
    Ok((link, if handle.parts.is_empty() { all() } else { handle.parts.clone() }))
}
