//! Radial and tangential distortion (D. C. Brown, *Close-Range Camera Calibration*, Photogrammetric
//! Engineering 37(8), 1971), with the rational radial factor of OpenCV's `calib3d` documentation.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Coefficients as in `cv2.projectPoints`; what is not given is 0.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BrownConrady {
    /// Radial, numerator, second order.
    pub k1: f64,
    /// Radial, numerator, fourth order.
    pub k2: f64,
    /// Radial, numerator, sixth order.
    pub k3: f64,
    /// Radial, denominator, second order.
    pub k4: f64,
    /// Radial, denominator, fourth order.
    pub k5: f64,
    /// Radial, denominator, sixth order.
    pub k6: f64,
    /// Tangential, along y.
    pub p1: f64,
    /// Tangential, along x.
    pub p2: f64,
}

/// Newton steps; from the distorted point, a handful suffice for real lenses.
const STEPS: usize = 30;

impl BrownConrady {
    pub(super) fn coefficients(&self) -> [f64; 8] {
        [self.k1, self.k2, self.p1, self.p2, self.k3, self.k4, self.k5, self.k6]
    }

    /// Radial factor and its derivative by r^2.
    fn radial(&self, r2: f64) -> (f64, f64) {
        let numerator = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let denominator = 1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6));
        let d_numerator = self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3);
        let d_denominator = self.k4 + r2 * (2.0 * self.k5 + r2 * 3.0 * self.k6);
        let factor = numerator / denominator;
        (factor, (d_numerator - factor * d_denominator) / denominator)
    }

    pub(super) fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        let (radial, _) = self.radial(r2);
        [
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        ]
    }

    /// Rows of the derivative of [`BrownConrady::distort`].
    fn jacobian(&self, [x, y]: [f64; 2]) -> [[f64; 2]; 2] {
        let (radial, slope) = self.radial(x * x + y * y);
        let (p1, p2) = (self.p1, self.p2);
        let mixed = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        [
            [radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x, mixed],
            [mixed, radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x],
        ]
    }

    pub(super) fn undistort(&self, target: [f64; 2]) -> Option<[f64; 2]> {
        let mut point = target;
        for _ in 0..STEPS {
            let found = self.distort(point);
            let error = [found[0] - target[0], found[1] - target[1]];
            let [[a, b], [c, d]] = self.jacobian(point);
            let determinant = a * d - b * c;
            // On the near side of the fold, the map keeps its orientation.
            if !(determinant > 0.0 && a + d > 0.0) {
                return None;
            }
            if error[0].abs().max(error[1].abs()) < 1e-13 {
                return Some(point);
            }
            point[0] -= (d * error[0] - b * error[1]) / determinant;
            point[1] -= (a * error[1] - c * error[0]) / determinant;
        }
        let found = self.distort(point);
        ((found[0] - target[0]).hypot(found[1] - target[1]) < 1e-10).then_some(point)
    }
}
