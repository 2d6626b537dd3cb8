//! Poses as users write them.

use akrobat_model::Pose;
use akrobat_model::pose::from_xyz_wxyz;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A rigid pose, metres: a position with a unit quaternion, or a matrix.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(
    untagged,
    expecting = "expected a pose: `[x y z qw qx qy qz]` or a 4 x 4 matrix as four rows"
)]
pub enum PoseValues {
    /// `[x y z qw qx qy qz]`.
    Quaternion([f64; 7]),
    /// Homogeneous 4 x 4 matrix, row by row.
    Matrix([[f64; 4]; 4]),
}

/// How far a quaternion's norm may be from 1, and a rotation matrix from orthonormal.
const TOLERANCE: f64 = 1e-3;

impl From<[f64; 7]> for PoseValues {
    fn from(values: [f64; 7]) -> Self {
        Self::Quaternion(values)
    }
}

impl PoseValues {
    /// The pose.
    ///
    /// # Errors
    /// What was expected and what was found.
    pub fn to_pose(&self) -> Result<Pose, String> {
        match self {
            Self::Quaternion(values) => quaternion_pose(values),
            Self::Matrix(rows) => matrix_pose(rows),
        }
    }
}

fn quaternion_pose(values: &[f64; 7]) -> Result<Pose, String> {
    let norm = values[3..].iter().map(|v| v * v).sum::<f64>().sqrt();
    let is_unit = (norm - 1.0).abs() <= TOLERANCE;
    from_xyz_wxyz(*values).filter(|_| is_unit).ok_or_else(|| {
        format!(
            "expected a pose `[x y z qw qx qy qz]` of finite numbers with a quaternion of length \
             1, got {values:?}"
        )
    })
}

fn matrix_pose(rows: &[[f64; 4]; 4]) -> Result<Pose, String> {
    let fail = |what: &str| Err(format!("expected a rigid 4 x 4 pose, {what}, got {rows:?}"));
    if !rows.as_flattened().iter().all(|v| v.is_finite()) {
        return fail("of finite numbers");
    }
    if rows[3] != [0.0, 0.0, 0.0, 1.0] {
        return fail("its last row 0 0 0 1");
    }
    let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
    let deviation = (matrix * matrix.transpose() - Matrix3::identity()).amax();
    if deviation > TOLERANCE || matrix.determinant() < 0.0 {
        return fail("its rotation right-handed and orthonormal");
    }
    let rotation = Rotation3::from_matrix_eps(&matrix, 1e-15, 100, Rotation3::identity());
    Ok(Pose::from_parts(
        Translation3::new(rows[0][3], rows[1][3], rows[2][3]),
        UnitQuaternion::from_rotation_matrix(&rotation),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_give_the_same_pose() {
        let half = 0.5f64.sqrt();
        let quaternion = PoseValues::Quaternion([1.0, 2.0, 3.0, half, 0.0, 0.0, half]);
        let matrix = PoseValues::Matrix([
            [0.0, -1.0, 0.0, 1.0],
            [1.0, 0.0, 0.0, 2.0],
            [0.0, 0.0, 1.0, 3.0],
            [0.0, 0.0, 0.0, 1.0],
        ]);
        let (a, b) = (quaternion.to_pose().unwrap(), matrix.to_pose().unwrap());
        assert!((a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-12);
    }

    #[test]
    fn what_is_not_rigid_is_refused() {
        let scaled = [[2.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], LAST];
        let mirrored = [[-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], LAST];
        for rows in [scaled, mirrored] {
            let message = PoseValues::Matrix(rows).to_pose().unwrap_err();
            assert!(message.contains("orthonormal"), "{message}");
        }
        for values in [[0.0; 7], [0.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0]] {
            assert!(PoseValues::from(values).to_pose().unwrap_err().contains("quaternion"));
        }
    }

    const LAST: [f64; 4] = [0.0, 0.0, 0.0, 1.0];
}
