//! Poses as MJCF writes them: `pos` with `quat`, `euler`, `axisangle`, `xyaxes` or `zaxis`.

use std::collections::BTreeMap;
use std::path::Path;

use akrobat_model::{ModelError, Pose};
use nalgebra::{Matrix3, Quaternion, Rotation3, Unit, UnitQuaternion, Vector3};
use roxmltree::Node;

use super::Compiler;
use crate::import::xml::{error, numbers};

/// The pose that an element's own attributes state.
pub fn pose(path: &Path, node: Node, compiler: &Compiler) -> Result<Pose, ModelError> {
    let attributes: BTreeMap<String, String> =
        node.attributes().map(|a| (a.name().to_owned(), a.value().to_owned())).collect();
    pose_of(&attributes, compiler).map_err(|message| error(path, node, message))
}

/// The pose that attributes state.
///
/// # Errors
/// What was expected and what was got.
pub fn pose_of(attributes: &BTreeMap<String, String>, compiler: &Compiler) -> Result<Pose, String> {
    let position = list::<3>(attributes, "pos")?.map_or_else(Vector3::zeros, Vector3::from);
    Ok(Pose::from_parts(position.into(), rotation(attributes, compiler)?))
}

fn rotation(
    attributes: &BTreeMap<String, String>,
    compiler: &Compiler,
) -> Result<UnitQuaternion<f64>, String> {
    if let Some([w, x, y, z]) = list(attributes, "quat")? {
        return UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9)
            .ok_or_else(|| "quat: expected a quaternion that is not zero".into());
    }
    if let Some([x, y, z, angle]) = list(attributes, "axisangle")? {
        let axis = direction(Vector3::new(x, y, z), "axisangle")?;
        return Ok(UnitQuaternion::from_axis_angle(&axis, angle * compiler.angle));
    }
    if let Some(angles) = list::<3>(attributes, "euler")? {
        return euler(angles.map(|a| a * compiler.angle), &compiler.euler_sequence);
    }
    if let Some([a, b, c, d, e, f]) = list(attributes, "xyaxes")? {
        let x = direction(Vector3::new(a, b, c), "xyaxes")?;
        let y = Vector3::new(d, e, f);
        let y = direction(y - x.into_inner() * y.dot(&x), "xyaxes")?;
        let columns = [x.into_inner(), y.into_inner(), x.cross(&y)];
        let matrix = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&columns));
        return Ok(UnitQuaternion::from_rotation_matrix(&matrix));
    }
    if let Some(z) = list::<3>(attributes, "zaxis")? {
        let z = direction(Vector3::from(z), "zaxis")?;
        return Ok(UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), &z).unwrap_or_else(
            || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
        ));
    }
    Ok(UnitQuaternion::identity())
}

/// Rotations about the axes of a sequence: lower case letters turn with the frame, upper case ones do not.
fn euler(angles: [f64; 3], sequence: &str) -> Result<UnitQuaternion<f64>, String> {
    let mut rotation = UnitQuaternion::identity();
    for (angle, letter) in angles.into_iter().zip(sequence.chars()) {
        let axis = match letter.to_ascii_lowercase() {
            'x' => Vector3::x_axis(),
            'y' => Vector3::y_axis(),
            'z' => Vector3::z_axis(),
            other => return Err(format!("eulerseq: expected x, y or z, got \"{other}\"")),
        };
        let turn = UnitQuaternion::from_axis_angle(&axis, angle);
        rotation = if letter.is_ascii_lowercase() { rotation * turn } else { turn * rotation };
    }
    Ok(rotation)
}

fn direction(vector: Vector3<f64>, name: &str) -> Result<Unit<Vector3<f64>>, String> {
    Unit::try_new(vector, 1e-9).ok_or_else(|| format!("{name}: no direction"))
}

/// Exactly `N` numbers of an attribute.
pub fn list<const N: usize>(
    attributes: &BTreeMap<String, String>,
    name: &str,
) -> Result<Option<[f64; N]>, String> {
    let Some(text) = attributes.get(name) else { return Ok(None) };
    let values = numbers(text).map_err(|e| format!("{name}: {e}"))?;
    values.try_into().map(Some).map_err(|_| format!("{name}: expected {N} numbers, got \"{text}\""))
}
