//! The judge's tolerances.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::JudgeError;

/// Tolerances of the judge. Every value is finite and not negative.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct JudgeConfig {
    /// Largest distance between the tool and its place on the handle while held, metres.
    pub anchor_translation_m: f64,
    /// Largest angle between the tool and its place on the handle while held, radians.
    pub anchor_rotation_rad: f64,
    /// How much wider than the handle the pads may be apart while they hold it, and must be apart where the
    /// hand leaves it, metres.
    pub finger_width_m: f64,
    /// Largest distance of the driven joint from its start at the first waypoint, as a fraction of
    /// the travel from start to goal.
    pub start_tolerance: f64,
    /// Largest distance of the driven joint from its goal at the last waypoint, as a fraction of the
    /// travel from start to goal.
    pub goal_tolerance: f64,
    /// Largest distance of a rigid or planar object from its goal, metres.
    pub goal_translation_m: f64,
    /// Largest angle of a rigid or planar object to its goal, radians.
    pub goal_rotation_rad: f64,
    /// Largest height that the hand lifts or presses a planar object by, metres.
    pub plane_height_m: f64,
    /// Largest angle that the hand tilts a planar object by, radians.
    pub plane_tilt_rad: f64,
    /// Largest gap between a rigid or planar object at rest and what carries it, metres.
    pub support_gap_m: f64,
    /// How far an object joint that must stand still may be from where it stands, rad or m.
    pub standstill_tolerance: f64,
    /// How far a joint may be outside its position limits, rad or m.
    pub position_tolerance: f64,
    /// How far speeds and accelerations may exceed their limits, as a fraction of the limit.
    pub rate_tolerance: f64,
    /// Largest turn of the base away from its yaw at the first waypoint, radians.
    pub base_yaw_rad: f64,
    /// How deep a collision sphere may overlap something, metres.
    pub sphere_tolerance_m: f64,
    /// How deep a mesh may enter another, metres.
    pub penetration_m: f64,
    /// Configurations checked between two neighbouring samples of the dense path, evenly spaced on
    /// the straight line between them, which is what is rendered.
    pub configurations_between: u32,
}

impl Default for JudgeConfig {
    fn default() -> Self {
        Self {
            anchor_translation_m: 1e-3,
            anchor_rotation_rad: 0.01,
            finger_width_m: 3e-3,
            start_tolerance: 0.01,
            goal_tolerance: 0.01,
            goal_translation_m: 1e-3,
            goal_rotation_rad: 0.01,
            plane_height_m: 1e-3,
            plane_tilt_rad: 0.01,
            support_gap_m: 5e-3,
            standstill_tolerance: 1e-4,
            position_tolerance: 1e-4,
            rate_tolerance: 0.01,
            base_yaw_rad: 2.0,
            sphere_tolerance_m: 1e-3,
            penetration_m: 5e-3,
            configurations_between: 1,
        }
    }
}

impl JudgeConfig {
    /// Checks the values.
    ///
    /// # Errors
    /// [`JudgeError::Config`] names the first value that is negative or not finite.
    pub fn validate(&self) -> Result<(), JudgeError> {
        let values = [
            ("anchor_translation_m", self.anchor_translation_m),
            ("anchor_rotation_rad", self.anchor_rotation_rad),
            ("finger_width_m", self.finger_width_m),
            ("start_tolerance", self.start_tolerance),
            ("goal_tolerance", self.goal_tolerance),
            ("goal_translation_m", self.goal_translation_m),
            ("goal_rotation_rad", self.goal_rotation_rad),
            ("plane_height_m", self.plane_height_m),
            ("plane_tilt_rad", self.plane_tilt_rad),
            ("support_gap_m", self.support_gap_m),
            ("standstill_tolerance", self.standstill_tolerance),
            ("position_tolerance", self.position_tolerance),
            ("rate_tolerance", self.rate_tolerance),
            ("base_yaw_rad", self.base_yaw_rad),
            ("sphere_tolerance_m", self.sphere_tolerance_m),
            ("penetration_m", self.penetration_m),
        ];
        match values.into_iter().find(|(_, value)| !value.is_finite() || *value < 0.0) {
            Some((name, value)) => Err(JudgeError::Config { name, value }),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_and_impossible_values_are_errors() {
        assert!(toml::from_str::<JudgeConfig>("penetration_m = 0.004").is_ok());
        assert!(toml::from_str::<JudgeConfig>("penetration = 0.004").is_err());
        assert!(JudgeConfig::default().validate().is_ok());
        let negative = JudgeConfig { penetration_m: -1.0, ..JudgeConfig::default() };
        assert!(negative.validate().is_err());
        let undefined = JudgeConfig { rate_tolerance: f64::NAN, ..JudgeConfig::default() };
        assert!(undefined.validate().is_err());
    }
}
