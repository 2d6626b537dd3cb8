//! Plans whole-body mobile manipulation: task in, judged trajectories out.
//!
//! The stages are those of AutoMoMa (CVPR 2026): collision spheres and distance fields, grasps, the
//! augmented kinematic representation for each grasp, batch inverse kinematics at the start and the
//! goals, clustering, trajectory optimisation on the constraint manifold, a dense path on the
//! constraint, and the approach before it.

pub mod akr;
pub mod approach;
pub mod backend;
pub mod closure;
pub mod cluster;
pub mod collision;
pub mod config;
pub mod dense;
pub mod esdf;
pub mod gpu;
pub mod grasp;
pub mod ik;
pub mod kernels;
pub mod kinematics;
pub mod lbfgs;
pub mod mask;
pub mod penalty;
pub mod plan;
pub mod ptp;
mod reduced;
pub mod rest;
pub mod reuse;
pub mod spheres;
pub mod trajopt;
pub mod world;

pub use backend::Backend;
pub use config::{Optimiser, PlannerConfig};
pub use plan::{PlanError, PlanOutcome, Preparation, plan, plan_on};
pub use reuse::Reuse;
pub use spheres::{Sphere, SphereModel};
