//! Fisheye distortion (J. Kannala and S. Brandt, *A Generic Camera Model and Calibration Method for
//! Conventional, Wide-Angle, and Fish-Eye Lenses*, PAMI 28(8), 2006), in OpenCV's form: the angle
//! `t` off the axis is mapped to the radius `t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8)`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Coefficients as in `cv2.fisheye`; what is not given is 0, which is the equidistant fisheye.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct KannalaBrandt {
    /// Of the angle's third power.
    pub k1: f64,
    /// Of the angle's fifth power.
    pub k2: f64,
    /// Of the angle's seventh power.
    pub k3: f64,
    /// Of the angle's ninth power.
    pub k4: f64,
}

const STEPS: usize = 50;

impl KannalaBrandt {
    pub(super) fn coefficients(&self) -> [f64; 4] {
        [self.k1, self.k2, self.k3, self.k4]
    }

    /// Radius at an angle, and its derivative.
    fn radius(&self, angle: f64) -> (f64, f64) {
        let a2 = angle * angle;
        let [k1, k2, k3, k4] = self.coefficients();
        (
            angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4)))),
            1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4))),
        )
    }

    pub(super) fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r = x.hypot(y);
        if r < 1e-12 {
            return [x, y];
        }
        let scale = self.radius(r.atan()).0 / r;
        [x * scale, y * scale]
    }

    pub(super) fn undistort(&self, [x, y]: [f64; 2]) -> Option<[f64; 2]> {
        let target = x.hypot(y);
        if target < 1e-12 {
            return Some([x, y]);
        }
        let mut angle = target;
        for _ in 0..STEPS {
            let (radius, slope) = self.radius(angle);
            if slope.is_nan() || slope <= 0.0 {
                return None;
            }
            let step = (radius - target) / slope;
            angle -= step;
            if step.abs() < 1e-15 {
                break;
            }
        }
        let exact = (self.radius(angle).0 - target).abs() < 1e-11;
        if !exact || !(0.0..std::f64::consts::FRAC_PI_2 - 1e-3).contains(&angle) {
            return None;
        }
        let scale = angle.tan() / target;
        Some([x * scale, y * scale])
    }
}
