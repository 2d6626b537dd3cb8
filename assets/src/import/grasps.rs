//! Grasps that other tools made, as the text files that tasks name: `x y z qw qx qy qz` in each line.

use std::path::Path;

use akrobat_model::pose::to_xyz_wxyz;
use akrobat_model::{ModelError, Pose};
use nalgebra::{Matrix3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::Value;

use super::{Ledger, read_text};

/// Where a grasp stands for what.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convention {
    /// Our tool frame (origin between the pads, z along the approach, y along the closing direction) in the
    /// frame that the source's poses are of.
    pub source_from_tool: Pose,
}

impl Convention {
    /// The frame of a Franka hand: its pads are 10.34 cm in front of it. AO-Grasp and the paper's authors
    /// state poses of it.
    pub fn panda_hand() -> Self {
        Self { source_from_tool: Pose::translation(0.0, 0.0, 0.1034) }
    }

    /// Our own tool frame.
    pub fn tool() -> Self {
        Self { source_from_tool: Pose::identity() }
    }
}

/// Grasps in the object's frame, the best first where the source ranks them.
#[derive(Debug, Clone)]
pub struct ImportedGrasps {
    /// Tool poses, with the source's score where it has one.
    pub poses: Vec<(Pose, Option<f64>)>,
    /// What was repaired and lost.
    pub ledger: Ledger,
}

/// Reads AO-Grasp results (JSON, or one NPY for positions and one for quaternions, see [`ao_grasp_npy`]), or an
/// NPY of 4 x 4 matrices or of rows `x y z qw qx qy qz`.
///
/// # Errors
/// [`ModelError`] naming the file.
pub fn read(path: &Path, convention: Convention) -> Result<ImportedGrasps, ModelError> {
    let is_json = path.extension().is_some_and(|e| e == "json");
    let mut ledger = Ledger::default();
    let found = if is_json { ao_grasp(path, &mut ledger)? } else { npy(path, &mut ledger)? };
    if found.is_empty() {
        return Err(ModelError::invalid(path, "the file has no usable grasps"));
    }
    let mut poses: Vec<(Pose, Option<f64>)> = found
        .into_iter()
        .map(|(pose, score)| (pose * convention.source_from_tool, score))
        .collect();
    if poses.iter().any(|(_, score)| score.is_some()) {
        let score = |s: Option<f64>| s.unwrap_or(f64::NEG_INFINITY);
        poses.sort_by(|a, b| score(b.1).total_cmp(&score(a.1)));
    }
    Ok(ImportedGrasps { poses, ledger })
}

/// Text of a grasp file.
pub fn to_text(grasps: &ImportedGrasps, source: &str) -> String {
    let mut text = format!(
        "# Tool poses x y z qw qx qy qz in the object's frame, from {source}, best first.\n"
    );
    for (pose, score) in &grasps.poses {
        let numbers = to_xyz_wxyz(pose).map(|v| format!("{v:.9}")).join(" ");
        let score = score.map_or(String::new(), |s| format!(" # score {s:.4}"));
        text += &format!("{numbers}{score}\n");
    }
    text
}

/// `{"pos_wf": [[x, y, z], …], "quat_wf": [[x, y, z, w], …], "scores": […]}`, or a list of such single grasps.
fn ao_grasp(path: &Path, ledger: &mut Ledger) -> Result<Vec<(Pose, Option<f64>)>, ModelError> {
    let value: Value = serde_json::from_str(&read_text(path)?)
        .map_err(|e| ModelError::invalid(path, format!("malformed JSON: {e}")))?;
    let one = |position: &Value, quaternion: &Value, score: &Value| {
        let position: [f64; 3] = numbers(position)?;
        let [x, y, z, w] = numbers(quaternion)?;
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)?;
        Some((
            Pose::from_parts(Translation3::from(Vector3::from(position)), rotation),
            score.as_f64(),
        ))
    };
    let rows: Vec<Option<(Pose, Option<f64>)>> = match (&value, value["pos_wf"].as_array()) {
        (Value::Array(grasps), _) => {
            grasps.iter().map(|g| one(&g["pos_wf"], &g["quat_wf"], &g["score"])).collect()
        }
        (_, Some(positions)) => positions
            .iter()
            .enumerate()
            .map(|(i, position)| one(position, &value["quat_wf"][i], &value["scores"][i]))
            .collect(),
        _ => {
            let message = "expected AO-Grasp results with \"pos_wf\" and \"quat_wf\" (xyzw)";
            return Err(ModelError::invalid(path, message));
        }
    };
    Ok(usable(rows, ledger))
}

fn usable(rows: Vec<Option<(Pose, Option<f64>)>>, ledger: &mut Ledger) -> Vec<(Pose, Option<f64>)> {
    for (index, _) in rows.iter().enumerate().filter(|(_, row)| row.is_none()) {
        ledger.lost(format!("grasp {index} is not a pose"));
    }
    rows.into_iter().flatten().collect()
}

fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let list: Option<Vec<f64>> = value.as_array()?.iter().map(Value::as_f64).collect();
    list?.try_into().ok()
}

/// `[4, 4]`, `[N, 4, 4]` or `[N, 7]`.
fn npy(path: &Path, ledger: &mut Ledger) -> Result<Vec<(Pose, Option<f64>)>, ModelError> {
    let bytes = std::fs::read(path).map_err(|e| ModelError::read(path, e))?;
    let array = npy_array(&bytes).map_err(|e| ModelError::invalid(path, e))?;
    let rows: Vec<Option<Pose>> = match array.shape[..] {
        [4, 4] => vec![matrix_pose(&array.values)],
        [_, 4, 4] => array.values.chunks_exact(16).map(matrix_pose).collect(),
        [_, 7] => array
            .values
            .chunks_exact(7)
            .map(|row| akrobat_model::pose::from_xyz_wxyz(row.try_into().ok()?))
            .collect(),
        _ => {
            let message =
                format!("expected shape (N, 4, 4), (4, 4) or (N, 7), got {:?}", array.shape);
            return Err(ModelError::invalid(path, message));
        }
    };
    Ok(usable(rows.into_iter().map(|pose| Some((pose?, None))).collect(), ledger))
}

/// The pose of a row-major 4 x 4 matrix whose rotation is one to a thousandth.
fn matrix_pose(values: &[f64]) -> Option<Pose> {
    if !values.iter().all(|v| v.is_finite()) {
        return None;
    }
    let rotation = Matrix3::from_fn(|r, c| values[4 * r + c]);
    let is_rotation = (rotation.transpose() * rotation - Matrix3::identity()).norm() < 1e-3
        && rotation.determinant() > 0.0;
    let last_row = [0.0, 0.0, 0.0, 1.0];
    if !is_rotation || (0..4).any(|c| (values[12 + c] - last_row[c]).abs() > 1e-6) {
        return None;
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix(&rotation));
    Some(Pose::from_parts(Translation3::new(values[3], values[7], values[11]), rotation))
}

struct Array {
    shape: Vec<usize>,
    values: Vec<f64>,
}

/// NPY format versions 1 to 3 (NEP 1), of little-endian floating-point numbers in C order.
fn npy_array(bytes: &[u8]) -> Result<Array, String> {
    if !bytes.starts_with(b"\x93NUMPY") {
        return Err("expected AO-Grasp's .json or a NumPy .npy file".into());
    }
    let truncated = || "truncated .npy header".to_owned();
    let byte = |at: usize| bytes.get(at).copied().map(usize::from).ok_or_else(truncated);
    let (at, length) = match byte(6)? {
        1 => (10, byte(8)? | byte(9)? << 8),
        2 | 3 => (12, byte(8)? | byte(9)? << 8 | byte(10)? << 16 | byte(11)? << 24),
        version => return Err(format!("unknown .npy version {version}; valid choices: 1, 2, 3")),
    };
    let header = bytes.get(at..at + length).ok_or_else(truncated)?;
    let header = String::from_utf8_lossy(header);
    let item_bytes = match () {
        () if header.contains("'<f4'") => 4,
        () if header.contains("'<f8'") => 8,
        () => return Err("expected dtype '<f4' or '<f8'".into()),
    };
    if header.contains("'fortran_order': True") {
        return Err("expected C order, got Fortran order".into());
    }
    let shape = header.split_once('(').and_then(|(_, rest)| rest.split_once(')'));
    let shape: Vec<usize> =
        shape.map_or("", |(s, _)| s).split(',').filter_map(|s| s.trim().parse().ok()).collect();
    let count = shape.iter().try_fold(1usize, |product, &n| product.checked_mul(n));
    let data = &bytes[at + length..];
    let count = count
        .filter(|&count| count.checked_mul(item_bytes).is_some_and(|needed| needed <= data.len()))
        .ok_or_else(|| {
            format!("truncated: shape {shape:?} needs more than {} bytes", data.len())
        })?;
    let item = |item: &[u8]| match <[u8; 8]>::try_from(item) {
        Ok(wide) => f64::from_le_bytes(wide),
        Err(_) => f64::from(f32::from_le_bytes([item[0], item[1], item[2], item[3]])),
    };
    let values = data.chunks_exact(item_bytes).take(count).map(item).collect();
    Ok(Array { shape, values })
}
