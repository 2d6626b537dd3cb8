//! Rigid poses and their on-disk form.

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// A rigid pose, metres. `a_from_b * point_in_b = point_in_a`.
pub type Pose = Isometry3<f64>;

/// Pose from a URDF `<origin>`: translation in metres and fixed-axis roll, pitch, yaw in radians.
pub fn from_xyz_rpy(xyz: [f64; 3], rpy: [f64; 3]) -> Pose {
    Pose::from_parts(
        Translation3::from(Vector3::from(xyz)),
        UnitQuaternion::from_euler_angles(rpy[0], rpy[1], rpy[2]),
    )
}

/// Pose from `[x y z qw qx qy qz]`. The quaternion is normalised; `None` if it has no direction
/// or any number is not finite.
pub fn from_xyz_wxyz(values: [f64; 7]) -> Option<Pose> {
    let [x, y, z, qw, qx, qy, qz] = values;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    if !values.iter().all(|v| v.is_finite()) || quaternion.norm() < 1e-6 {
        return None;
    }
    Some(Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion)))
}

/// `[x y z qw qx qy qz]`, with the sign chosen so that `qw >= 0`.
pub fn to_xyz_wxyz(pose: &Pose) -> [f64; 7] {
    let t = pose.translation.vector;
    let q = pose.rotation.into_inner();
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    [t.x, t.y, t.z, sign * q.w, sign * q.i, sign * q.j, sign * q.k]
}

/// Row-major 4 x 4 matrix.
pub fn to_matrix(pose: &Pose) -> [[f64; 4]; 4] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn file_form_round_trips(xyz in prop::array::uniform3(-5.0..5.0f64), rpy in prop::array::uniform3(-3.0..3.0f64)) {
            let pose = from_xyz_rpy(xyz, rpy);
            let back = from_xyz_wxyz(to_xyz_wxyz(&pose)).unwrap();
            prop_assert!((back.translation.vector - pose.translation.vector).norm() < 1e-12);
            prop_assert!(back.rotation.angle_to(&pose.rotation) < 1e-7);
        }
    }

    #[test]
    fn degenerate_quaternions_are_refused() {
        assert!(from_xyz_wxyz([0.0; 7]).is_none());
        assert!(from_xyz_wxyz([f64::NAN, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]).is_none());
    }
}
