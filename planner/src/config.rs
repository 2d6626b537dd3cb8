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
    /// Random seeds of inverse kinematics for each grasp and joint position, at most: once there are four free
    /// solutions for each cluster, no more are tried.
    pub ik_seeds: usize,
    /// Clusters of solutions for each grasp and joint position: what stands for them is tried before other solutions.
    pub ik_clusters: usize,
    /// Optimised start and goal pairs for each grasp and goal, at most.
    pub pairs_per_grasp: usize,
    /// How trajectories are optimised.
    pub optimiser: Optimiser,
    /// Iterations of trajectory optimisation on the constraint.
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

/// How trajectories are optimised.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Optimiser {
    /// Gauss-Newton steps along the constraint, which every iterate holds.
    #[default]
    Manifold,
    /// cuRobo's recipe, for comparison: L-BFGS from 12 seeds with the constraint as a penalty; what does not hold it is
    /// dropped afterwards.
    Curobo,
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
            optimiser: Optimiser::default(),
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

/// Most voxels that a distance field may have: 600 along each edge take 860 MB.
const MOST_VOXELS: f64 = 2.16e8;

impl PlannerConfig {
    /// Checks that every number is one that planning can work with.
    ///
    /// # Errors
    /// The first setting that is not, with what was expected.
    pub fn check(&self) -> Result<(), String> {
        let counts = [
            ("limit", self.limit, 1),
            ("waypoints", self.waypoints, 2),
            ("substeps", self.substeps, 1),
            ("ik_seeds", self.ik_seeds, 1),
            ("ik_clusters", self.ik_clusters, 1),
            ("pairs_per_grasp", self.pairs_per_grasp, 1),
        ];
        for (name, count, least) in counts {
            if count < least {
                return Err(format!("{name}: expected at least {least}, got {count}"));
            }
        }
        let [width, depth, height] = self.workspace_m;
        let lengths = [
            ("duration_s", self.duration_s),
            ("voxel_size_m", self.voxel_size_m),
            ("workspace_m", width.min(depth).min(height)),
            ("max_base_yaw_rad", self.max_base_yaw_rad),
        ];
        for (name, value) in lengths {
            if !(value.is_finite() && value > 0.0) {
                return Err(format!("{name}: expected a finite number above 0, got {value}"));
            }
        }
        let voxels = width * depth * height / self.voxel_size_m.powi(3);
        if voxels.is_nan() || voxels > MOST_VOXELS {
            return Err(format!(
                "voxel_size_m {} makes {voxels:.1e} voxels of workspace_m {:?}; expected at most {MOST_VOXELS:.1e}",
                self.voxel_size_m, self.workspace_m
            ));
        }
        let weights = self.velocity_weights.iter().chain(&self.acceleration_weights);
        let at_least_zero = [
            ("clearance_m", self.clearance_m),
            ("min_clearance_m", self.min_clearance_m),
            ("approach_distance_m", self.approach_distance_m),
        ];
        let weights = weights.map(|&weight| ("velocity_weights and acceleration_weights", weight));
        for (name, value) in at_least_zero.into_iter().chain(weights) {
            if !(value.is_finite() && value >= 0.0) {
                return Err(format!("{name}: expected finite numbers of at least 0, got {value}"));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_that_cannot_work_are_refused() {
        PlannerConfig::default().check().unwrap();
        let base = PlannerConfig::default;
        let wrong = [
            ("limit", PlannerConfig { limit: 0, ..base() }),
            ("waypoints", PlannerConfig { waypoints: 1, ..base() }),
            ("voxel_size_m", PlannerConfig { voxel_size_m: -0.02, ..base() }),
            ("voxel_size_m", PlannerConfig { voxel_size_m: 1e-6, ..base() }),
            ("workspace_m", PlannerConfig { workspace_m: [5.0, 0.0, 5.0], ..base() }),
            ("workspace_m", PlannerConfig { workspace_m: [5.0, f64::NAN, 5.0], ..base() }),
            ("clearance_m", PlannerConfig { clearance_m: f64::NAN, ..base() }),
            ("velocity_weights", PlannerConfig { velocity_weights: [-1.0; 4], ..base() }),
        ];
        for (name, config) in wrong {
            assert!(config.check().unwrap_err().contains(name), "{name}");
        }
    }
}
