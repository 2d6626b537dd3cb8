//! Robots: a URDF plus what it does not say (base kind, planning group, gripper, limits).

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{KinematicTree, Pose};

/// How the base moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BaseKind {
    /// Moves freely in the plane: prismatic x, prismatic y, revolute yaw (the paper's virtual base).
    Holonomic,
    /// Does not move.
    Fixed,
    /// Cannot move sideways. Described for completeness; the planner refuses it.
    Differential,
}

/// A robot file (TOML).
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RobotFile {
    /// Name for identities and reports.
    pub name: String,
    /// URDF file, relative to this file or found on the asset search path.
    pub urdf: PathBuf,
    /// Licence of the robot's files, as an SPDX expression.
    #[serde(default)]
    pub license: String,
    /// Where the robot's files come from.
    #[serde(default)]
    pub source: String,
    /// The mobile base.
    pub base: BaseSection,
    /// The planning group above the base: arm joints, with a lifting torso first where there is one.
    pub arm: ArmSection,
    /// The gripper and the tool frame.
    pub gripper: GripperSection,
    /// Positions (rad, m) of joints that are not planned; all others not named rest at their neutral position.
    #[serde(default)]
    pub locked: BTreeMap<String, f64>,
    /// Largest joint acceleration, rad/s^2 or m/s^2, of every planned joint (URDF has none).
    #[serde(default = "default_acceleration")]
    pub acceleration_limit: f64,
    /// Acceleration limits of single joints that differ from `acceleration_limit`.
    #[serde(default)]
    pub acceleration_limits: BTreeMap<String, f64>,
    /// Collision spheres.
    #[serde(default)]
    pub spheres: SpheresSection,
    /// Link pairs that may touch besides adjacent ones, to planner and judge; pairs that always touch are found by
    /// sampling.
    #[serde(default)]
    pub self_collision_ignore: Vec<[String; 2]>,
}

fn default_acceleration() -> f64 {
    15.0
}

/// The mobile base of a [`RobotFile`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BaseSection {
    /// How the base moves.
    pub kind: BaseKind,
    /// Names of the URDF's own virtual joints (x, y, yaw). Where absent, three joints named `base_x`,
    /// `base_y`, `base_theta` are added above the URDF's root (holonomic bases only).
    #[serde(default)]
    pub joints: Option<[String; 3]>,
    /// Speed limits of added joints: m/s, m/s, rad/s.
    #[serde(default = "default_base_velocity")]
    pub velocity_limits: [f64; 3],
    /// What the robot stands on, described in a URDF of its own: a pedestal or a mobile platform.
    #[serde(default)]
    pub platform: Option<PlatformSection>,
}

/// A pedestal or mobile platform that carries the robot and moves with the base.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlatformSection {
    /// URDF of the platform, relative to the robot file or on the asset search path.
    pub urdf: PathBuf,
    /// Link of the platform that carries the robot.
    pub link: String,
    /// Root frame of the robot's URDF in that link: `[x y z qw qx qy qz]`.
    pub link_from_robot: [f64; 7],
}

fn default_base_velocity() -> [f64; 3] {
    [1.0, 1.0, 1.0]
}

/// The planning group of a [`RobotFile`].
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ArmSection {
    /// Joint names from base to tool, all on the chain to the tool link.
    pub joints: Vec<String>,
    /// Resting configuration, rad or m, one per joint.
    pub retract: Vec<f64>,
}

/// The gripper of a [`RobotFile`]. The *tool frame* has its origin between the finger tips' pads, z
/// along the approach direction (out of the palm) and y along the closing direction.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct GripperSection {
    /// Actuated finger joints.
    pub joints: Vec<String>,
    /// Their positions when fully closed (rad or m).
    pub closed: Vec<f64>,
    /// Their positions when fully open (rad or m).
    pub open: Vec<f64>,
    /// Free width between the pads when fully open, metres.
    pub open_width_m: f64,
    /// Links that touch the handle.
    pub finger_links: Vec<String>,
    /// Link that carries the tool frame.
    pub tool_link: String,
    /// Tool frame in that link: `[x y z qw qx qy qz]`.
    pub link_from_tool: [f64; 7],
    /// A gripper of its own URDF to mount on the robot's, where the robot's has none. The names
    /// above may then be either URDF's.
    #[serde(default)]
    pub attach: Option<AttachSection>,
}

/// A gripper described in a URDF of its own, and where it is bolted on.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AttachSection {
    /// URDF of the gripper, relative to the robot file or on the asset search path.
    pub urdf: PathBuf,
    /// Link of the robot that carries it.
    pub link: String,
    /// Root frame of the gripper in that link: `[x y z qw qx qy qz]`.
    pub link_from_gripper: [f64; 7],
}

/// Collision spheres of a [`RobotFile`].
#[derive(Debug, Clone, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SpheresSection {
    /// A cuRobo sphere YAML to use instead of fitting, relative to the robot file or on the search path.
    #[serde(default)]
    pub file: Option<PathBuf>,
    /// Links that the YAML's links stand for, where they differ (`summit_base = "base_footprint"`).
    #[serde(default)]
    pub rename: BTreeMap<String, String>,
    /// Edge of the fitting voxels in metres; spheres have about this diameter.
    #[serde(default)]
    pub voxel_m: Option<f64>,
    /// Link pairs whose spheres touch far more often than the links do: the planner does not compare them, the judge
    /// compares their meshes.
    #[serde(default)]
    pub overstated: Vec<[String; 2]>,
}

/// A robot, loaded and checked.
#[derive(Debug, Clone)]
pub struct Robot {
    /// Name from the robot file.
    pub name: String,
    /// The URDF's tree, below the virtual base joints.
    pub tree: KinematicTree,
    /// The file it came from.
    pub file: RobotFile,
    /// Resolved path of the URDF.
    pub urdf_path: PathBuf,
    /// Resolved path of the collision sphere file, if the robot file names one.
    pub spheres_path: Option<PathBuf>,
    /// Repairs made while loading, in the user's words.
    pub notes: Vec<String>,
    /// Indices of the base joints x, y, yaw; empty for a fixed base.
    pub base_joints: Vec<usize>,
    /// Indices of the arm joints.
    pub arm_joints: Vec<usize>,
    /// Indices of the finger joints.
    pub gripper_joints: Vec<usize>,
    /// Index of the link that carries the tool frame.
    pub tool_link: usize,
    /// Tool frame in that link.
    pub link_from_tool: Pose,
    /// Indices of the links that touch the handle.
    pub finger_links: Vec<usize>,
    /// Full configuration of the tree with the retract pose, open fingers and locked joints.
    pub rest: Vec<f64>,
    /// Pose of the tree's root in the world: identity for mobile bases, the mounting for fixed ones.
    pub world_from_root: Pose,
}

impl Robot {
    /// Joint indices of a trajectory's columns: base, arm, fingers.
    pub fn trajectory_joints(&self) -> Vec<usize> {
        [&self.base_joints[..], &self.arm_joints, &self.gripper_joints].concat()
    }

    /// Names of a trajectory's columns.
    pub fn trajectory_joint_names(&self) -> Vec<String> {
        self.trajectory_joints().iter().map(|&j| self.tree.joints()[j].name.clone()).collect()
    }

    /// Full configuration of the tree for one row of a trajectory (rad, m).
    pub fn configuration(&self, row: &[f64]) -> Vec<f64> {
        let mut q = self.rest.clone();
        for (joint, &value) in self.trajectory_joints().into_iter().zip(row) {
            if let Some(column) = self.tree.column(joint) {
                q[column] = value;
            }
        }
        q
    }

    /// Finger joint positions for a free width between the pads, metres (clamped to what the gripper can do).
    pub fn finger_positions(&self, width_m: f64) -> Vec<f64> {
        let gripper = &self.file.gripper;
        let fraction = (width_m / gripper.open_width_m).clamp(0.0, 1.0);
        gripper.closed.iter().zip(&gripper.open).map(|(c, o)| c + (o - c) * fraction).collect()
    }

    /// Acceleration limit of a joint, rad/s^2 or m/s^2.
    pub fn acceleration_limit(&self, joint: usize) -> f64 {
        let name = &self.tree.joints()[joint].name;
        self.file.acceleration_limits.get(name).copied().unwrap_or(self.file.acceleration_limit)
    }
}
