//! Lens distortion: what happens to the point `(x / z, y / z)` of an ideal pinhole camera before it
//! is scaled by the intrinsics. Models and coefficients are OpenCV's.

mod brown_conrady;
mod kannala_brandt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use brown_conrady::BrownConrady;
pub use kannala_brandt::KannalaBrandt;

/// How a lens departs from a pinhole.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "model", deny_unknown_fields)]
pub enum Distortion {
    /// Not at all.
    #[default]
    Pinhole,
    /// Radial (polynomial or rational) and tangential: `cv2.projectPoints`.
    BrownConrady(BrownConrady),
    /// Fisheye: `cv2.fisheye`.
    KannalaBrandt(KannalaBrandt),
}

impl Distortion {
    /// Name of the model, as in rig files.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Pinhole => "pinhole",
            Self::BrownConrady(_) => "brown_conrady",
            Self::KannalaBrandt(_) => "kannala_brandt",
        }
    }

    /// True where nothing is distorted.
    pub fn is_pinhole(&self) -> bool {
        match self {
            Self::Pinhole => true,
            Self::BrownConrady(lens) => *lens == BrownConrady::default(),
            Self::KannalaBrandt(_) => false,
        }
    }

    /// Where the lens puts the point that a pinhole puts at `point`; both on the plane z = 1.
    pub fn distort(&self, point: [f64; 2]) -> [f64; 2] {
        match self {
            Self::Pinhole => point,
            Self::BrownConrady(lens) => lens.distort(point),
            Self::KannalaBrandt(lens) => lens.distort(point),
        }
    }

    /// The inverse of [`Distortion::distort`]; `None` outside the lens' field, where the model folds
    /// back or no pinhole sees.
    pub fn undistort(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        match self {
            Self::Pinhole => Some(point),
            Self::BrownConrady(lens) => lens.undistort(point),
            Self::KannalaBrandt(lens) => lens.undistort(point),
        }
    }

    /// The coefficients in OpenCV's order: none, `k1 k2 p1 p2 k3 k4 k5 k6` or `k1 k2 k3 k4`.
    pub fn coefficients(&self) -> Vec<f64> {
        match self {
            Self::Pinhole => Vec::new(),
            Self::BrownConrady(lens) => lens.coefficients().to_vec(),
            Self::KannalaBrandt(lens) => lens.coefficients().to_vec(),
        }
    }

    pub(crate) fn check(&self) -> Result<(), String> {
        let coefficients = self.coefficients();
        if coefficients.iter().all(|c| c.is_finite()) {
            return Ok(());
        }
        Err(format!("distortion: expected finite coefficients, got {coefficients:?}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A published calibration of Azure Kinect's colour camera (see `presets/azure_kinect.toml`).
    fn azure_kinect() -> Distortion {
        Distortion::BrownConrady(BrownConrady {
            k1: 0.344_175,
            k2: -2.860_457,
            k3: 1.803_521,
            k4: 0.216_973,
            k5: -2.649_01,
            k6: 1.705_652,
            p1: 4.7437e-4,
            p2: -4.4146e-5,
        })
    }

    fn fisheye() -> Distortion {
        Distortion::KannalaBrandt(KannalaBrandt { k1: -0.02, k2: 0.004, k3: -0.002, k4: 0.0002 })
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]
        #[test]
        fn undistorting_undoes_distorting(x in -0.9..0.9, y in -0.7..0.7) {
            for lens in [Distortion::Pinhole, azure_kinect(), fisheye()] {
                let found = lens.undistort(lens.distort([x, y])).unwrap();
                prop_assert!((found[0] - x).hypot(found[1] - y) < 1e-9, "{lens:?}: {found:?}");
            }
        }
    }

    #[test]
    fn beyond_the_fold_nothing_is_seen() {
        // r (1 - 0.5 r^2) is at most 0.5443, at r = 0.8165.
        let lens = Distortion::BrownConrady(BrownConrady { k1: -0.5, ..BrownConrady::default() });
        assert!(lens.undistort([0.54, 0.0]).is_some());
        assert_eq!(lens.undistort([0.56, 0.0]), None);
        // A right angle off the axis, which no pinhole sees.
        assert_eq!(fisheye().undistort([1.7, 0.0]), None);
    }
}
