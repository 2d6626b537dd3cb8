//! Task files.

use std::collections::BTreeMap;
use std::path::Path;

use super::{AssetSearch, grasps, joint_index, object, parse_toml_text, place, robot, scene};
use crate::pose::from_xyz_wxyz;
use crate::robot::BaseKind;
use crate::task::{GraspFrame, ManipulatedObject, ObjectKind, Task, TaskFile};
use crate::{ModelError, Pose, Robot, hash};

/// Loads a task file and everything it names.
pub fn load(path: &Path, search: &AssetSearch) -> Result<Task, ModelError> {
    from_text(std::fs::read_to_string(path).map_err(|e| ModelError::read(path, e))?, path, search)
}

/// Loads what the text of a task file names, as if it stood at `path`.
pub fn from_text(text: String, path: &Path, search: &AssetSearch) -> Result<Task, ModelError> {
    let mut file: TaskFile = parse_toml_text(path, &text)?;
    let mut content_hashes = BTreeMap::from([("task".to_owned(), hash::of_bytes(text.as_bytes()))]);

    let mut loaded_robot = robot::load(&search.find(&file.robot.file, path)?, search)?;
    place_robot(path, &file, &mut loaded_robot.robot)?;
    limit_robot(path, &file, &mut loaded_robot.robot)?;
    loaded_robot.add_hashes(&mut content_hashes)?;

    let mut loaded_scene = scene::load(path, &file.scene, search)?;
    loaded_scene.add_hashes(&mut content_hashes)?;

    let loaded_object = object::load(path, &file, search, &mut loaded_scene.scene)?;
    loaded_object.add_hashes(&mut content_hashes)?;

    if file.object.kind != ObjectKind::Articulated {
        drive_first_virtual_joint(&mut file, &loaded_object.object);
    }

    let grasp_poses = grasp_poses(path, &file, search, &loaded_object.object, &mut content_hashes)?;
    let dir = path.parent().unwrap_or(Path::new("")).to_path_buf();
    Ok(Task {
        toml: text,
        dir,
        robot: loaded_robot.robot,
        object: loaded_object.object,
        scene: loaded_scene.scene,
        grasp_poses,
        content_hashes,
        file,
    })
}

/// States start and goals of a rigid or planar object by its first virtual joint as well, so that whoever
/// only wants one number per trajectory has one.
fn drive_first_virtual_joint(file: &mut TaskFile, object: &ManipulatedObject) {
    file.object.joint = object.tree.joints()[object.active_joint].name.clone();
    file.goal.start = object.tree.column(object.active_joint).map_or(0.0, |c| object.start[c]);
    file.goal.positions = file.goal.poses.iter().map(|pose| pose[0]).collect();
}

/// Puts a robot with a fixed base where the task says.
fn place_robot(path: &Path, file: &TaskFile, robot: &mut Robot) -> Result<(), ModelError> {
    let Some(pose) = file.robot.pose else { return Ok(()) };
    let place = place(path, "robot.pose");
    if robot.file.base.kind != BaseKind::Fixed {
        let message = "only a robot with a fixed base is placed; leave it out for a mobile one";
        return Err(ModelError::bad_value(place, message));
    }
    robot.world_from_root = from_xyz_wxyz(pose).ok_or_else(|| {
        ModelError::bad_value(place, format!("expected [x y z qw qx qy qz], got {pose:?}"))
    })?;
    Ok(())
}

/// Narrows the limits of the robot's joints as the task says.
fn limit_robot(path: &Path, file: &TaskFile, robot: &mut Robot) -> Result<(), ModelError> {
    let place = place(path, "robot.limits");
    for (name, &[low, high]) in &file.robot.limits {
        let joint = joint_index(&place, &robot.tree, name)?;
        if ![&robot.base_joints, &robot.arm_joints].iter().any(|group| group.contains(&joint)) {
            let planned = [&robot.base_joints[..], &robot.arm_joints].concat();
            let names = planned.iter().map(|&j| robot.tree.joints()[j].name.clone());
            return Err(ModelError::unknown(&place, "planned joint", name, names));
        }
        let [least, most] = robot.tree.joints()[joint].limits;
        let at_rest = robot.tree.column(joint).map_or(low, |column| robot.rest[column]);
        let inside = least <= low && low < high && high <= most;
        if !inside || !(low..=high).contains(&at_rest) {
            let message = format!(
                "{name}: expected [low, high] within [{least}, {most}] and around the rest position {at_rest}, \
                 got [{low}, {high}]"
            );
            return Err(ModelError::bad_value(place, message));
        }
        robot.tree.set_limits(joint, [low, high]);
    }
    Ok(())
}

/// Tool poses of the grasp file in the held link's frame; none where there is no file.
fn grasp_poses(
    path: &Path,
    file: &TaskFile,
    search: &AssetSearch,
    object: &ManipulatedObject,
    content_hashes: &mut BTreeMap<String, String>,
) -> Result<Vec<Pose>, ModelError> {
    if file.grasps.count == 0 {
        let message = "expected at least 1 grasp, got 0";
        return Err(ModelError::bad_value(place(path, "grasps.count"), message));
    }
    let Some(named) = &file.grasps.file else { return Ok(Vec::new()) };
    let grasp_path = search.find(named, path)?;
    content_hashes.insert("grasps".into(), hash::of_file(&grasp_path)?);
    let poses = grasps::read(&grasp_path)?;
    let link_from_frame = match file.grasps.frame {
        GraspFrame::Link => Pose::identity(),
        GraspFrame::Object => {
            let root_from_link =
                object.tree.link_poses(&Pose::identity(), &object.start)[object.handle_link];
            root_from_link.inverse()
        }
    };
    Ok(poses.iter().map(|frame_from_tool| link_from_frame * frame_from_tool).collect())
}
