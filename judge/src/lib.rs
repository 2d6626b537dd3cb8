//! The independent judge.
//!
//! It decides whether a trajectory may be kept, and shares nothing with the planner that proposed it:
//! neither code nor the augmented kinematic chain. It evaluates the *original* robot and object trees
//! with its own forward kinematics, and their meshes against the scene's.
//!
//! [`Judge::judge`] looks at every sample of the dense path and at points between the samples, because
//! the renderer interpolates linearly there. A mesh is inside another by the largest distance of a
//! surface point of one to the nearest face of a closed convex solid of the other. That maximum is
//! taken over whole triangles, not over surface samples.

mod bodies;
mod config;
mod contacts;
mod convex;
mod error;
mod finding;
mod free;
mod grip;
mod judge;
mod kinematics;
mod meshes;
mod motion;
mod near;
mod object;
mod path;
#[cfg(test)]
mod real_inputs;
mod shapes;
mod spheres;
mod structure;
mod travel;

pub use config::JudgeConfig;
pub use error::JudgeError;
pub use judge::Judge;
pub use spheres::RobotSphere;
