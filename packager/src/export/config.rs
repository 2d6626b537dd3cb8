//! What an export writes: which actions, which state, which cameras.

use clap::{Args, ValueEnum};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What an action commands, arm and base alike. Fingers are always commanded by position.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum ActionKind {
    /// Joint positions of the next frame (rad, m).
    #[default]
    JointPosition,
    /// Joint velocities that reach the next frame (rad/s, m/s); 0 in the last row.
    JointVelocity,
    /// The tool's pose at the next frame: position and quaternion.
    EefPose,
    /// The tool's motion to the next frame: translation and rotation vector.
    EefDelta,
}

/// How the base's part of an action is expressed.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum BaseActions {
    /// x, y, yaw in the world.
    #[default]
    Absolute,
    /// Change of x, y, yaw along the world's axes (AutoMoMa's `mobile_base_relative`).
    Relative,
    /// Displacement and turn in the base's own frame before the motion.
    Local,
}

/// How many columns the gripper has.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum GripperColumns {
    /// One per finger joint: 12 columns for a base, 7 arm joints and 2 fingers.
    #[default]
    Joints,
    /// One: the mean position of the finger joints (11 columns).
    Opening,
}

/// What the state vector holds. The base is always in the world.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum StateKind {
    /// Joint positions.
    #[default]
    Joints,
    /// Joint positions, then joint velocities.
    JointsVelocities,
    /// Base joints, the tool's pose, fingers.
    EefPose,
    /// Joint positions, joint velocities, the tool's pose.
    All,
}

/// Frame of tool poses in actions and states.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum EefFrame {
    /// The robot's base link at the same instant.
    #[default]
    Base,
    /// The world.
    World,
}

/// Order of quaternions in actions and states.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum QuatOrder {
    /// Scalar first.
    #[default]
    Wxyz,
    /// Scalar last.
    Xyzw,
}

impl QuatOrder {
    /// The order as text.
    pub fn name(self) -> &'static str {
        match self {
            Self::Wxyz => "wxyz",
            Self::Xyzw => "xyzw",
        }
    }
}

/// Message types of MCAP logs.
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema,
)]
#[serde(rename_all = "kebab-case")]
pub enum McapProfile {
    /// ROS 2 interfaces in CDR.
    #[default]
    Ros2,
    /// Foxglove's schemas in protobuf.
    Foxglove,
}

/// Settings of an export. Formats ignore what they have no place for.
#[derive(Debug, Clone, PartialEq, Args, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ExportConfig {
    /// What an action commands.
    #[arg(long, value_enum, default_value_t)]
    pub actions: ActionKind,
    /// How the base's part of an action is expressed.
    #[arg(long, value_enum, default_value_t)]
    pub base: BaseActions,
    /// How many columns the gripper has.
    #[arg(long, value_enum, default_value_t)]
    pub gripper: GripperColumns,
    /// What the state vector holds.
    #[arg(long, value_enum, default_value_t)]
    pub state: StateKind,
    /// Frame of tool poses in actions and states.
    #[arg(long, value_enum, default_value_t)]
    pub eef_frame: EefFrame,
    /// Order of quaternions in actions and states.
    #[arg(long, value_enum, default_value_t)]
    pub quat: QuatOrder,
    /// Cameras to export, separated by commas; all where absent.
    #[arg(long, value_delimiter = ',', value_name = "NAMES")]
    pub cameras: Vec<String>,
    /// Points of each cloud; all where absent. Any head of a stored cloud is a coarser cloud.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub points: Option<u32>,
    /// Export only episodes of this robot.
    #[arg(long, value_name = "NAME")]
    pub robot: Option<String>,
    /// Instruction in words; made from the object's name where absent.
    #[arg(long, value_name = "TEXT")]
    pub instruction: Option<String>,
    /// Share of the episodes that is marked for validation, chosen by their identity.
    #[arg(long, value_name = "SHARE", default_value_t = DEFAULT_VALIDATION)]
    pub validation: f64,
    /// Store colour as JPEG (format `act`).
    #[arg(long)]
    pub jpeg: bool,
    /// Message types (format `mcap`).
    #[arg(long, value_enum, default_value_t)]
    pub profile: McapProfile,
}

const DEFAULT_VALIDATION: f64 = 0.1;

impl Default for ExportConfig {
    fn default() -> Self {
        Self {
            actions: ActionKind::default(),
            base: BaseActions::default(),
            gripper: GripperColumns::default(),
            state: StateKind::default(),
            eef_frame: EefFrame::default(),
            quat: QuatOrder::default(),
            cameras: Vec::new(),
            points: None,
            robot: None,
            instruction: None,
            validation: DEFAULT_VALIDATION,
            jpeg: false,
            profile: McapProfile::default(),
        }
    }
}

/// Formats that datasets are exported to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ExportFormat {
    /// LeRobotDataset v3.0: parquet and mp4, depth with a validity mask (needs the Python package).
    Lerobot,
    /// 3D Diffusion Policy: zarr with clouds, states and actions (needs the Python package).
    Dp3,
    /// Diffusion Policy: zarr with images, states and actions (needs the Python package).
    DiffusionPolicy,
    /// ACT: one `episode_i.hdf5` each, images plain or as JPEG.
    Act,
    /// robomimic: one HDF5 file, actions scaled to [-1, 1], train and valid masks.
    Robomimic,
    /// ManiSkill: `trajectory.h5` and `trajectory.json`.
    Maniskill,
    /// AutoMoMa: the authors' recorder HDF5; from a trajectory file their `traj_data.pt`.
    Automoma,
    /// One MCAP log each: ROS 2 interfaces, or Foxglove's schemas (those need the Python package).
    Mcap,
    /// ROS 2 `trajectory_msgs/JointTrajectory` as YAML and in MCAP, for real robots.
    JointTrajectory,
}

impl ExportFormat {
    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lerobot => "lerobot",
            Self::Dp3 => "dp3",
            Self::DiffusionPolicy => "diffusion-policy",
            Self::Act => "act",
            Self::Robomimic => "robomimic",
            Self::Maniskill => "maniskill",
            Self::Automoma => "automoma",
            Self::Mcap => "mcap",
            Self::JointTrajectory => "joint-trajectory",
        }
    }

    /// What of each frame the format has a place for.
    pub fn needs(self) -> Needs {
        let none = Needs { rgb: false, depth: false, segmentation: false, cloud: false };
        match self {
            Self::Lerobot | Self::Automoma | Self::Mcap => {
                Needs { rgb: true, depth: true, cloud: true, ..none }
            }
            Self::DiffusionPolicy | Self::Robomimic => Needs { rgb: true, depth: true, ..none },
            Self::Dp3 => Needs { cloud: true, ..none },
            Self::Act => Needs { rgb: true, ..none },
            Self::Maniskill => Needs { rgb: true, depth: true, segmentation: true, cloud: true },
            Self::JointTrajectory => none,
        }
    }
}

/// What is read of each frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Needs {
    /// Colours.
    pub rgb: bool,
    /// Depth.
    pub depth: bool,
    /// Segment ids.
    pub segmentation: bool,
    /// Clouds.
    pub cloud: bool,
}

impl Needs {
    /// True where anything of a frame is needed.
    pub fn any(self) -> bool {
        self.rgb || self.depth || self.segmentation || self.cloud
    }
}
