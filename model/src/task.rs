//! Tasks: what is opened or moved, where, and by which robot.

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{KinematicTree, Pose, Robot, Scene};

/// A task file (TOML). Paths are relative to the task file, or found on the asset search path.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TaskFile {
    /// Name for identities and reports.
    pub name: String,
    /// Seed of everything random in this task.
    #[serde(default)]
    pub seed: u64,
    /// Who acts.
    pub robot: RobotSection,
    /// What is manipulated.
    pub object: ObjectSection,
    /// The static surroundings.
    #[serde(default)]
    pub scene: SceneSection,
    /// How the object is held.
    #[serde(default)]
    pub grasps: GraspSection,
    /// Where its joint must get to.
    pub goal: GoalSection,
    /// Planner settings; see the planner's schema.
    #[serde(default)]
    #[schemars(with = "BTreeMap<String, serde_json::Value>")]
    pub planner: toml::Table,
}

/// The robot of a task.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotSection {
    /// Robot file.
    pub file: PathBuf,
    /// Where a fixed base stands: `[x y z qw qx qy qz]`.
    #[serde(default)]
    pub pose: Option<[f64; 7]>,
    /// Position limits in this task of joints that are planned, `{ panda_joint1 = [-1.0, 1.0] }`: rad or m, within those of
    /// the robot's own files. They keep an arm to one side, or to one of several ways of reaching a pose.
    #[serde(default)]
    pub limits: BTreeMap<String, [f64; 2]>,
}

/// The manipulated object of a task.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ObjectSection {
    /// Name for identities; the URDF's robot name where absent.
    #[serde(default)]
    pub name: Option<String>,
    /// URDF file.
    pub urdf: PathBuf,
    /// Uniform scale.
    #[serde(default = "one")]
    pub scale: f64,
    /// Pose of the URDF's root frame in the world, `[x y z qw qx qy qz]`; or use `replaces`.
    #[serde(default)]
    pub pose: Option<[f64; 7]>,
    /// A scene body whose place the object takes.
    #[serde(default)]
    pub replaces: Option<Replaces>,
    /// What it is: something with a joint, a rigid thing, or one that slides on the floor.
    #[serde(default)]
    pub kind: ObjectKind,
    /// The joint that is driven to the goal. Rigid and planar objects have none.
    #[serde(default)]
    pub joint: String,
    /// Positions of the object's other joints (rad, m); those not named rest at their neutral position.
    #[serde(default)]
    pub locked: BTreeMap<String, f64>,
    /// Where it is held. Where absent, the link below `joint` is.
    #[serde(default)]
    pub handle: Option<HandleSection>,
    /// Licence of the object's files, as an SPDX expression.
    #[serde(default)]
    pub license: String,
}

/// How an object moves.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ObjectKind {
    /// One of its joints is driven; the rest of it stays where it is.
    #[default]
    Articulated,
    /// It is picked up and put down somewhere else.
    Rigid,
    /// It is too heavy to lift and slides on the floor, upright.
    Planar,
}

fn one() -> f64 {
    1.0
}

/// Puts the object where a scene body stands.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Replaces {
    /// Pattern (with `*`) that matches one body of the scene, which is removed.
    pub body: String,
    /// Rotation of the object about the vertical, radians.
    pub yaw: f64,
    /// Scale the object uniformly to the body's box (to the smallest of the three ratios).
    #[serde(default)]
    pub fit: bool,
}

/// The part of the object that is held.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HandleSection {
    /// Link that carries the handle: below the driven joint.
    pub link: String,
    /// Parts of that link, as patterns with `*`; all where empty.
    #[serde(default)]
    pub parts: Vec<String>,
    /// Only what lies inside this box counts: `[xmin ymin zmin xmax ymax zmax]` in the link's frame, metres.
    #[serde(default)]
    pub region: Option<[f64; 6]>,
}

/// The surroundings of a task.
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneSection {
    /// Name for identities; the file's stem, or `empty_room`, where absent.
    #[serde(default)]
    pub name: Option<String>,
    /// glTF, GLB, URDF, OBJ, STL or DAE file.
    #[serde(default)]
    pub file: Option<PathBuf>,
    /// Axis of the file that points up. glTF is always Y up; others are Z up where nothing is said.
    #[serde(default)]
    pub up: Option<UpAxis>,
    /// Moves the scene along z so that its floor (a body whose name matches) lies at z = 0.
    #[serde(default)]
    pub floor: Option<String>,
    /// Shifts the scene in the plane: metres.
    #[serde(default)]
    pub offset: [f64; 2],
    /// Bodies to leave out, as patterns with `*`.
    #[serde(default)]
    pub remove: Vec<String>,
    /// Primitive boxes to add.
    #[serde(default, rename = "box")]
    pub boxes: Vec<BoxSection>,
    /// Adds a floor and four walls of these inner dimensions (x, y, z in metres), centred on the origin.
    #[serde(default)]
    pub room: Option<[f64; 3]>,
}

/// Which axis of a file points up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum UpAxis {
    /// Y up.
    Y,
    /// Z up.
    Z,
}

/// A primitive box of a scene.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BoxSection {
    /// Body name.
    pub name: String,
    /// Edge lengths, metres.
    pub size: [f64; 3],
    /// Pose of its centre, `[x y z qw qx qy qz]`.
    pub pose: [f64; 7],
    /// Linear RGB in 0..1.
    #[serde(default = "grey")]
    pub color: [f32; 3],
}

fn grey() -> [f32; 3] {
    [0.6, 0.6, 0.6]
}

/// The grasps of a task.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GraspSection {
    /// A NumPy `.npy` of `[N, 7]`, or a text file of N lines, of tool poses `x y z qw qx qy qz`.
    #[serde(default)]
    pub file: Option<PathBuf>,
    /// Frame of the file's poses.
    #[serde(default)]
    pub frame: GraspFrame,
    /// Number of grasps to use, sampled on the handle where there is no file.
    #[serde(default = "twenty")]
    pub count: usize,
}

impl Default for GraspSection {
    fn default() -> Self {
        Self { file: None, frame: GraspFrame::default(), count: twenty() }
    }
}

fn twenty() -> usize {
    20
}

/// Frame of the poses in a grasp file.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GraspFrame {
    /// The object's root frame, with all joints at their start.
    #[default]
    Object,
    /// The held link's frame.
    Link,
}

/// The goal of a task.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GoalSection {
    /// Position of the driven joint at the start, rad or m.
    #[serde(default)]
    pub start: f64,
    /// Positions to reach, rad or m; every one is planned for.
    #[serde(default)]
    pub positions: Vec<f64>,
    /// Poses that a rigid or planar object is brought to, `[x y z qw qx qy qz]` of its root in the world;
    /// every one is planned for.
    #[serde(default)]
    pub poses: Vec<[f64; 7]>,
    /// How often the grasp may be changed on the way, at most: for goals that no single grasp reaches.
    #[serde(default)]
    pub regrasps: usize,
}

/// The manipulated object, loaded, scaled and placed.
#[derive(Debug, Clone)]
pub struct ManipulatedObject {
    /// Name for identities.
    pub name: String,
    /// Its tree, scaled.
    pub tree: KinematicTree,
    /// Pose of the tree's root in the world.
    pub world_from_root: Pose,
    /// Index of the driven joint.
    pub active_joint: usize,
    /// Index of the held link, at or below the driven joint's child.
    pub handle_link: usize,
    /// Patterns of the held link's parts that make up the handle; `*` for all.
    pub handle_parts: Vec<String>,
    /// Box in the held link's frame that bounds the handle, metres.
    pub handle_region: Option<[f64; 6]>,
    /// Full configuration at the start.
    pub start: Vec<f64>,
    /// Repairs made while loading, in the user's words.
    pub notes: Vec<String>,
}

impl ManipulatedObject {
    /// Full configuration with the driven joint at `position` (rad or m).
    pub fn configuration(&self, position: f64) -> Vec<f64> {
        let mut q = self.start.clone();
        if let Some(column) = self.tree.column(self.active_joint) {
            q[column] = position;
        }
        q
    }
}

/// A task with everything it names loaded and checked.
#[derive(Debug, Clone)]
pub struct Task {
    /// The file.
    pub file: TaskFile,
    /// The file's text.
    pub toml: String,
    /// Folder of the file.
    pub dir: PathBuf,
    /// The robot.
    pub robot: Robot,
    /// The object.
    pub object: ManipulatedObject,
    /// The surroundings, without what the object replaces.
    pub scene: Scene,
    /// Grasp poses from the task's file, as link-frame tool poses; empty where they are to be sampled.
    pub grasp_poses: Vec<Pose>,
    /// SHA-256 of every input file, by its name in the task.
    pub content_hashes: BTreeMap<String, String>,
}

/// True where `pattern`, with `*` for any run of characters, matches the whole of `name`.
pub fn matches_pattern(pattern: &str, name: &str) -> bool {
    let Some((head, tail)) = pattern.split_once('*') else { return pattern == name };
    let Some(rest) = name.strip_prefix(head) else { return false };
    (0..=rest.len())
        .filter(|&at| rest.is_char_boundary(at))
        .any(|at| matches_pattern(tail, &rest[at..]))
}

#[cfg(test)]
mod tests {
    use super::matches_pattern;

    #[test]
    fn patterns_match_whole_names() {
        assert!(matches_pattern("Oven*", "OvenFactory(12)"));
        assert!(matches_pattern("*Factory*", "OvenFactory(12)"));
        assert!(matches_pattern("*", ""));
        assert!(!matches_pattern("Oven", "OvenFactory"));
        assert!(!matches_pattern("*Oven", "OvenFactory"));
    }
}
