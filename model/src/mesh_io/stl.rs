//! STL, binary and text. Vertices at the same position are shared; facet normals are dropped, since
//! they say nothing that the triangles do not.

use std::collections::HashMap;
use std::path::Path;

use super::MeshFile;
use crate::{ModelError, TriMesh};

const HEADER_BYTES: usize = 84;
const FACET_BYTES: usize = 50;

/// Reads an STL file's content.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<MeshFile, ModelError> {
    let corners = if looks_like_text(bytes) {
        text_corners(path, bytes)?
    } else {
        binary_corners(path, bytes)?
    };
    Ok(MeshFile { meshes: vec![weld(&corners)], notes: Vec::new() })
}

/// Some binary files start with `solid` too: only the size or a `facet` keyword can tell.
fn looks_like_text(bytes: &[u8]) -> bool {
    if facet_count(bytes).is_some_and(|n| bytes.len() == HEADER_BYTES + FACET_BYTES * n) {
        return false;
    }
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(1024)]).to_ascii_lowercase();
    head.trim_start().starts_with("solid") && (head.contains("facet") || head.contains("endsolid"))
}

fn facet_count(bytes: &[u8]) -> Option<usize> {
    let count = bytes.get(80..HEADER_BYTES)?.try_into().ok()?;
    Some(u32::from_le_bytes(count) as usize)
}

fn binary_corners(path: &Path, bytes: &[u8]) -> Result<Vec<[f32; 3]>, ModelError> {
    let Some(count) = facet_count(bytes) else {
        return Err(ModelError::invalid(
            path,
            format!("truncated STL: expected a header of 84 bytes, got {} bytes", bytes.len()),
        ));
    };
    let expected = HEADER_BYTES + FACET_BYTES * count;
    if bytes.len() < expected {
        return Err(ModelError::invalid(
            path,
            format!(
                "truncated STL: {count} facets need {expected} bytes, the file has {}",
                bytes.len()
            ),
        ));
    }
    let float =
        |at: usize| f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let corner = |index: usize| {
        let at = HEADER_BYTES + FACET_BYTES * (index / 3) + 12 * (1 + index % 3);
        [float(at), float(at + 4), float(at + 8)]
    };
    Ok((0..3 * count).map(corner).collect())
}

fn text_corners(path: &Path, bytes: &[u8]) -> Result<Vec<[f32; 3]>, ModelError> {
    let text = String::from_utf8_lossy(bytes);
    let mut corners = Vec::new();
    let mut ended = false;
    for (number, line) in text.lines().enumerate() {
        let mut words = line.split_whitespace();
        match words.next().map(str::to_ascii_lowercase).as_deref() {
            Some("vertex") => {
                let values: Vec<f32> = words.map_while(|w| w.parse().ok()).collect();
                let values = values.try_into().map_err(|_| {
                    ModelError::invalid(
                        path,
                        format!(
                            "line {}: expected \"vertex x y z\", got \"{}\"",
                            number + 1,
                            line.trim()
                        ),
                    )
                })?;
                corners.push(values);
            }
            Some("endsolid") => ended = true,
            _ => {}
        }
    }
    if !corners.len().is_multiple_of(3) || !ended {
        return Err(ModelError::invalid(
            path,
            format!("truncated STL: {} vertices, \"endsolid\" found: {ended}", corners.len()),
        ));
    }
    Ok(corners)
}

fn weld(corners: &[[f32; 3]]) -> TriMesh {
    let mut vertex_at = HashMap::new();
    let mut mesh = TriMesh::default();
    for triangle in corners.chunks_exact(3) {
        let vertices = [triangle[0], triangle[1], triangle[2]].map(|position| {
            // Adding zero makes -0.0 equal to 0.0.
            *vertex_at.entry(position.map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
                mesh.positions.push(position);
                mesh.positions.len() as u32 - 1
            })
        });
        mesh.triangles.push(vertices);
    }
    mesh
}
