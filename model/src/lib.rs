//! Plain data that every Akrobat stage shares.
//!
//! Units are SI, angles are radians, world and robot frames are Z up. A variable `a_from_b` is the
//! pose of frame `b` in frame `a`: it takes coordinates in `b` to coordinates in `a`.

pub mod error;
pub mod events;
#[doc(hidden)]
pub mod fixtures;
pub mod free_object;
pub mod geometry;
pub mod hash;
pub mod load;
pub mod mesh;
pub mod mesh_io;
pub mod pose;
pub mod robot;
pub mod scene;
pub mod task;
pub mod trajectory;
pub mod tree;
pub mod urdf;
pub mod verdict;

pub use error::ModelError;
pub use geometry::{Part, Shape};
pub use mesh::{Material, TriMesh};
pub use pose::Pose;
pub use robot::{Robot, RobotFile};
pub use scene::{Scene, SceneBody};
pub use task::TaskFile;
pub use trajectory::{JointPath, Phase, Trajectory, TrajectorySet};
pub use tree::{Joint, JointKind, KinematicTree, Link};
pub use verdict::{Rejection, Verdict};
