//! The independent judge.
//!
//! It decides whether a trajectory may be kept, and shares nothing with the planner that proposed it:
//! neither code nor the augmented kinematic chain. It evaluates the *original* robot and object trees
//! with its own forward kinematics, and their meshes against the scene's.

mod bodies;
mod config;
mod convex;
mod error;
mod kinematics;
mod shapes;

pub use config::JudgeConfig;
pub use error::JudgeError;
