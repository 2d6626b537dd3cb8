//! Planner settings.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of the planner: the `[planner]` table of a task file, or command-line options.
/// Defaults are the paper's where it states one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PlannerConfig {
    /// Stop once this many trajectories are accepted.
    pub limit: usize,
    /// Number of waypoints of the manipulation.
    pub waypoints: usize,
    /// Duration of the manipulation: 120 frames at 30 Hz by default, seconds. Stretched where limits forbid it.
    pub duration_s: f64,
    /// Dense samples from one waypoint to the next; the judge demands at least 5.
    pub substeps: usize,
    /// Edge of a voxel of the distance field, metres.
    pub voxel_size_m: f64,
    /// Edge lengths of the distance field around the object, metres.
    pub workspace_m: [f64; 3],
    /// Random seeds of inverse kinematics for each grasp and joint position.
    pub ik_seeds: usize,
    /// Solutions kept for each grasp and joint position after clustering.
    pub ik_clusters: usize,
    /// Optimised start and goal pairs for each grasp and goal, at most.
    pub pairs_per_grasp: usize,
    /// Iterations of trajectory optimisation.
    pub iterations: usize,
    /// Clearance that optimisation aims at between spheres and everything else, metres.
    pub clearance_m: f64,
    /// Clearance below which a configuration counts as colliding, metres.
    pub min_clearance_m: f64,
    /// Largest change of base yaw between start and goal, radians.
    pub max_base_yaw_rad: f64,
    /// Weights of squared waypoint steps: base translation, base yaw, arm joints, object joint.
    pub velocity_weights: [f64; 4],
    /// Weights of squared second differences, as `velocity_weights`.
    pub acceleration_weights: [f64; 4],
    /// Distance of the pre-grasp pose from the grasp along the approach direction, metres.
    pub approach_distance_m: f64,
    /// Plan the approach before the manipulation.
    pub approach: bool,
    /// Iterations of the free-space planner, for each approach.
    pub ptp_iterations: usize,
}

impl Default for PlannerConfig {
    fn default() -> Self {
        Self {
            limit: 100,
            waypoints: 30,
            duration_s: 119.0 / 30.0,
            substeps: 5,
            voxel_size_m: 0.02,
            workspace_m: [5.0, 5.0, 5.0],
            ik_seeds: 1000,
            ik_clusters: 30,
            pairs_per_grasp: 60,
            iterations: 25,
            clearance_m: 0.015,
            min_clearance_m: 0.004,
            max_base_yaw_rad: 2.0,
            velocity_weights: [4.0, 2.0, 1.0, 1.0],
            acceleration_weights: [20.0, 10.0, 5.0, 5.0],
            approach_distance_m: 0.1,
            approach: true,
            ptp_iterations: 4000,
        }
    }
}
