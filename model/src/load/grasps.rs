//! Grasp files: a NumPy array or text.

use std::path::Path;

use crate::pose::from_xyz_wxyz;
use crate::{ModelError, Pose};

const NPY_MAGIC: &[u8] = b"\x93NUMPY";

/// The tool poses of a grasp file, `[x y z qw qx qy qz]` per row, in the frame the file has them in.
///
/// # Errors
/// Unreadable, truncated or malformed files, other shapes than `[N, 7]` and rows that are no pose.
pub fn read(path: &Path) -> Result<Vec<Pose>, ModelError> {
    let bytes = std::fs::read(path).map_err(|e| ModelError::read(path, e))?;
    let rows = if bytes.starts_with(NPY_MAGIC) { npy_rows(&bytes) } else { text_rows(&bytes) };
    let rows = rows.map_err(|reason| ModelError::invalid(path, reason))?;
    if rows.is_empty() {
        return Err(ModelError::invalid(path, "the file has no grasps"));
    }
    let to_pose = |(index, row): (usize, &[f64; 7])| {
        from_xyz_wxyz(*row).ok_or_else(|| {
            let message = format!("row {} is no pose x y z qw qx qy qz: {row:?}", index + 1);
            ModelError::invalid(path, message)
        })
    };
    rows.iter().enumerate().map(to_pose).collect()
}

fn text_rows(bytes: &[u8]) -> Result<Vec<[f64; 7]>, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "neither .npy nor text")?;
    let content = |line: &str| line.split('#').next().unwrap_or("").trim().to_owned();
    let rows = text.lines().map(content).enumerate().filter(|(_, line)| !line.is_empty());
    rows.map(|(index, line)| {
        let words = line.split([' ', ',', '\t']).filter(|w| !w.is_empty());
        let values: Option<Vec<f64>> = words.map(|w| w.parse().ok()).collect();
        values
            .and_then(|v| v.try_into().ok())
            .ok_or_else(|| format!("line {}: expected 7 numbers, got \"{line}\"", index + 1))
    })
    .collect()
}

/// NPY format versions 1 to 3 (NEP 1): magic, version, header length, a Python dict literal, data.
fn npy_rows(bytes: &[u8]) -> Result<Vec<[f64; 7]>, String> {
    let truncated = || "truncated .npy header".to_owned();
    let byte = |at: usize| bytes.get(at).copied().map(usize::from).ok_or_else(truncated);
    let (header_at, header_length) = match byte(6)? {
        1 => (10, byte(8)? | byte(9)? << 8),
        2 | 3 => (12, byte(8)? | byte(9)? << 8 | byte(10)? << 16 | byte(11)? << 24),
        version => return Err(format!("unknown .npy version {version}; valid choices: 1, 2, 3")),
    };
    let header = bytes.get(header_at..header_at + header_length).ok_or_else(truncated)?;
    let header = String::from_utf8_lossy(header);
    let item_bytes = match header_value(&header, "descr") {
        Some("'<f4'") => 4,
        Some("'<f8'") => 8,
        other => {
            let got = other.unwrap_or("nothing");
            return Err(format!("expected dtype '<f4' or '<f8', got {got}"));
        }
    };
    if header_value(&header, "fortran_order") != Some("False") {
        return Err("expected C order, got Fortran order".into());
    }
    let shape = header.split_once('(').and_then(|(_, rest)| rest.split_once(')'));
    let shape = shape.map_or("", |(shape, _)| shape);
    let sizes: Vec<usize> = shape.split(',').filter_map(|s| s.trim().parse().ok()).collect();
    let [count, 7] = sizes[..] else { return Err(format!("expected shape (N, 7), got ({shape})")) };
    let data = &bytes[header_at + header_length..];
    let expected = count.saturating_mul(7 * item_bytes);
    if data.len() < expected {
        return Err(format!("truncated: {count} rows need {expected} bytes, got {}", data.len()));
    }
    let item = |at: usize| -> f64 {
        let item = &data[at * item_bytes..(at + 1) * item_bytes];
        match item.try_into() {
            Ok(wide) => f64::from_le_bytes(wide),
            Err(_) => f64::from(f32::from_le_bytes([item[0], item[1], item[2], item[3]])),
        }
    };
    Ok((0..count).map(|row| std::array::from_fn(|column| item(7 * row + column))).collect())
}

/// The value of a key in a flat Python dict literal, up to the next comma.
fn header_value<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let (_, rest) = header.split_once(&format!("'{key}':"))?;
    Some(rest.split([',', '}']).next()?.trim())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header =
            format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let mut bytes = NPY_MAGIC.to_vec();
        bytes.extend([1, 0, header.len() as u8, 0]);
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn single_and_double_precision() {
        let row = [0.5f64, 1.0, 2.0, 1.0, 0.0, 0.0, 0.0];
        let double: Vec<u8> = row.iter().flat_map(|v| v.to_le_bytes()).collect();
        let single: Vec<u8> = row.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect();
        assert_eq!(npy_rows(&npy("<f8", "(1, 7)", &double)).unwrap(), [row]);
        assert_eq!(npy_rows(&npy("<f4", "(1, 7)", &single)).unwrap(), [row]);
    }

    #[test]
    fn wrong_files_say_why() {
        let error = |bytes: &[u8]| npy_rows(bytes).unwrap_err();
        assert!(error(&npy("<f8", "(2, 7)", &[0; 56])).contains("truncated"));
        assert!(error(&npy("<i8", "(1, 7)", &[0; 56])).contains("<i8"));
        assert!(error(&npy("<f8", "(7,)", &[0; 56])).contains("(N, 7)"));
        assert!(error(NPY_MAGIC).contains("truncated"));
        assert!(text_rows(b"1 2 3").unwrap_err().contains("line 1"));
    }

    #[test]
    fn text_allows_comments_and_commas() {
        let rows =
            text_rows(b"# x y z w x y z\n1, 2, 3, 1, 0, 0, 0\n\n4 5 6 1 0 0 0 # b\n").unwrap();
        assert_eq!(rows.len(), 2);
        assert_eq!(rows[1][0], 4.0);
    }
}
