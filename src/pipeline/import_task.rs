//! Tasks for what was imported, so that it can be planned with at once.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use akrobat_assets::import::layout::{self, tree_bounds};
use akrobat_assets::import::twin::{FURNISHED_FILE, twin_name};
use akrobat_assets::import::{ImportedObject, ImportedScene, PlacedObject};
use akrobat_assets::robot::DemoRobot;
use akrobat_model::pose::to_xyz_wxyz;
use akrobat_model::{Joint, JointKind, KinematicTree, ModelError, Pose};

use crate::Error;

/// Doors are opened by at most this, radians.
const MOST_RAD: f64 = 1.45;
/// Shares of the way that a task asks for.
const SHARES: [f64; 3] = [0.6, 0.7, 0.8];
/// What is lower stands on a table of this height, metres.
const LOW_M: f64 = 0.5;
const TABLE_M: f64 = 0.75;
/// Half the edge of the room that an object alone stands in, metres.
const HALF_ROOM_M: f64 = 4.0;

/// Writes `task.toml` beside an imported object; none where nothing of it moves.
///
/// # Errors
/// Where the robot file is not there or a file cannot be written.
pub fn for_object(
    folder: &Path,
    object: &ImportedObject,
    robot: Option<&Path>,
) -> Result<Option<PathBuf>, Error> {
    let Some(bounds) = tree_bounds(&object.tree) else { return Ok(None) };
    let (low, high) = bounds;
    let stands_m = if high.z - low.z < LOW_M { TABLE_M } else { 0.0 };
    // Its back at the wall, its front to the room.
    let pose =
        Pose::translation(-HALF_ROOM_M + 0.01 - low.x, -(low.y + high.y) / 2.0, stands_m - low.z);
    let Some(tables) = object_tables(object, ".", &pose) else { return Ok(None) };
    let table = if stands_m > 0.0 {
        let [x, y] = [high.x - low.x + 0.03, high.y - low.y + 0.4];
        format!(
            "\n[[scene.box]]\nname = \"table\"\nsize = [{x:.4}, {y:.4}, {stands_m:.4}]\npose = [{:.4}, 0.0, {:.4}, 1.0, 0.0, 0.0, 0.0]\n",
            -HALF_ROOM_M + 0.01 + x / 2.0,
            stands_m / 2.0
        )
    } else {
        String::new()
    };
    let edge = 2.0 * HALF_ROOM_M;
    let scene = format!("[scene]\nroom = [{edge:.1}, {edge:.1}, 3.0]\n{table}");
    let robot = robot_file(folder, "", robot)?;
    let text = format!("name = \"{}\"\n\n{robot}\n{scene}\n{tables}", object.name);
    write(&folder.join("task.toml"), &text).map(Some)
}

/// Writes `tasks/<object>.toml` for everything with joints in an imported scene; gives the files.
///
/// # Errors
/// Where the robot file is not there or a file cannot be written.
pub fn for_scene(
    folder: &Path,
    scene: &ImportedScene,
    robot: Option<&Path>,
) -> Result<Vec<PathBuf>, Error> {
    let tasks = folder.join("tasks");
    let mut files = Vec::new();
    for PlacedObject { object, world_from_root, .. } in &scene.objects {
        let place = format!("../objects/{}", object.name);
        let Some(tables) = object_tables(object, &place, world_from_root) else { continue };
        std::fs::create_dir_all(&tasks).map_err(|e| Error::write(&tasks, &e))?;
        let name = layout::file_name(&scene.name);
        let robot = robot_file(folder, "../", robot)?;
        let text = format!(
            "name = \"{name}_{}\"\n\n{robot}\n[scene]\nname = \"{name}\"\nfile = \"../{FURNISHED_FILE}\"\n# The static twin of the object.\nremove = [{:?}]\n\n{tables}",
            object.name,
            twin_name(scene, &object.name),
        );
        files.push(write(&tasks.join(format!("{}.toml", object.name)), &text)?);
    }
    Ok(files)
}

/// The `[object]` and `[goal]` tables.
fn object_tables(object: &ImportedObject, place: &str, pose: &Pose) -> Option<String> {
    let tree = &object.tree;
    let joint = joint_to_open(tree)?;
    let goals: Vec<String> =
        SHARES.map(|share| format!("{:.4}", share * way(joint))).into_iter().collect();
    let pose = to_xyz_wxyz(pose).map(|value| format!("{value:.6}")).join(", ");
    let license = match object.origin.license.as_str() {
        "" => String::new(),
        license => format!("license = {license:?}\n"),
    };
    Some(format!(
        "[object]\nname = {:?}\nurdf = \"{place}/{}.urdf\"\n{license}pose = [{pose}]\njoint = {:?}\n\n[object.handle]\nlink = {:?}\n\n[goal]\npositions = [{}]\n",
        object.name,
        object.name,
        joint.name,
        handle_link(tree, joint, object),
        goals.join(", ")
    ))
}

/// The joint with the largest face to the front, +x: a dishwasher's door, not the racks that it hides.
fn joint_to_open(tree: &KinematicTree) -> Option<&Joint> {
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let face_m2 = |joint: &Joint| {
        let link = &tree.links()[joint.child];
        let parts = if link.visuals.is_empty() { &link.collisions } else { &link.visuals };
        let bounds = layout::parts_bounds(parts.iter().map(|part| (poses[joint.child], part)));
        bounds.map_or(0.0, |(low, high)| (high.y - low.y) * (high.z - low.z))
    };
    let candidates = tree.joints().iter().filter(|joint| opens(joint));
    let faces = candidates.map(|joint| (joint, face_m2(joint)));
    // Of equal ones the first.
    let largest = faces.reduce(|best, next| if next.1 > best.1 { next } else { best });
    largest.map(|(joint, _)| joint)
}

fn opens(joint: &Joint) -> bool {
    matches!(joint.kind, JointKind::Revolute | JointKind::Prismatic)
        && joint.mimic.is_none()
        && way(joint).abs() > 0.05
}

/// How far a joint goes from its zero, to the side on which it goes farther.
fn way(joint: &Joint) -> f64 {
    let [low, high] = joint.limits;
    let far = if high.abs() >= low.abs() { high } else { low };
    match joint.kind {
        JointKind::Revolute => far.clamp(-MOST_RAD / SHARES[2], MOST_RAD / SHARES[2]),
        _ => far,
    }
}

/// The link that the source calls a handle, or has named so, among those that the joint moves; else the moved one.
fn handle_link<'a>(tree: &'a KinematicTree, joint: &Joint, object: &ImportedObject) -> &'a str {
    let moves =
        |link: &usize| tree.chain_to(*link).iter().any(|&j| tree.joints()[j].name == joint.name);
    let called = |link: &usize| {
        let name = &tree.links()[*link].name;
        let said = object.semantics.iter().any(|s| s.link == *name && s.label.contains("handle"));
        said || name.to_lowercase().contains("handle")
    };
    let has_shape = |link: &usize| {
        !tree.links()[*link].visuals.is_empty() || !tree.links()[*link].collisions.is_empty()
    };
    let handle = (0..tree.links().len()).filter(moves).filter(called).find(has_shape);
    &tree.links()[handle.unwrap_or(joint.child)].name
}

/// The `[robot]` table; without a robot, the built-in one is written beside the task.
fn robot_file(folder: &Path, up: &str, robot: Option<&Path>) -> Result<String, Error> {
    let file = match robot {
        Some(file) => {
            let whole = file.canonicalize().map_err(|e| ModelError::read(file, e))?;
            whole.display().to_string()
        }
        None => {
            DemoRobot::Pillar.write(&folder.join("robots"))?;
            format!("{up}robots/pillar.toml")
        }
    };
    Ok(format!("[robot]\nfile = {file:?}\n"))
}

fn write(path: &Path, text: &str) -> Result<PathBuf, Error> {
    let written = tempfile::Builder::new()
        .prefix(".akrobat-")
        .make_in(super::folder_of(path), |path| std::fs::File::create_new(path))
        .and_then(|mut file| {
            file.write_all(text.as_bytes())?;
            file.as_file().sync_all()?;
            file.persist(path).map_err(|e| e.error)
        });
    written.map(|_| path.to_path_buf()).map_err(|e| Error::write(path, &e))
}
