//! Mesh simplification by vertex clustering (Rossignac and Borrel 1993), kept apart by orientation so
//! that edges stay sharp.

use std::collections::HashMap;

use akrobat_model::TriMesh;
use nalgebra::Vector3;

/// Vertices that fall together: position in cells (or exactly, as bits), and rough direction of the normal.
type Key = ([i64; 3], [i8; 3]);

/// A mesh with unit normals in which vertices of the same cell and about the same normal are merged
/// into their mean, and triangles that vanish by that are left out. A cell of 0 merges equal vertices only.
pub fn simplified(mesh: &TriMesh, cell_m: f32) -> TriMesh {
    let mut clusters: HashMap<Key, u32> = HashMap::new();
    let mut sums: Vec<(Vector3<f64>, Vector3<f64>, f64)> = Vec::new();
    let mut triangles = Vec::new();
    for index in 0..mesh.triangles.len() {
        let corners = mesh.corners(index).map(Vector3::from);
        let [a, b, c] = corners;
        let Some(flat) = (b - a).cross(&(c - a)).try_normalize(0.0) else { continue };
        let merged: [u32; 3] = std::array::from_fn(|corner| {
            let vertex = mesh.triangles[index][corner] as usize;
            let normal = mesh.normals.get(vertex).map_or(flat, |&normal| Vector3::from(normal));
            let position = corners[corner];
            let next = sums.len() as u32;
            let cluster = *clusters.entry(key(&position, &normal, cell_m)).or_insert(next);
            if cluster == next {
                sums.push(Default::default());
            }
            let sum = &mut sums[cluster as usize];
            sum.0 += position.cast::<f64>();
            sum.1 += normal.cast::<f64>();
            sum.2 += 1.0;
            cluster
        });
        let [a, b, c] = merged;
        if a != b && b != c && c != a {
            triangles.push(merged);
        }
    }
    let means = sums.iter().map(|(position, normal, count)| {
        let normal = normal.try_normalize(1e-9).unwrap_or_else(Vector3::z);
        ((position / *count).cast::<f32>(), normal.cast::<f32>())
    });
    let means = means.map(|(p, n)| (<[f32; 3]>::from(p), <[f32; 3]>::from(n)));
    let (positions, normals) = means.unzip();
    compact(TriMesh { positions, normals, triangles, ..TriMesh::default() })
}

fn key(position: &Vector3<f32>, normal: &Vector3<f32>, cell_m: f32) -> Key {
    let place = |v: f32| match cell_m > 0.0 {
        true => (v / cell_m).floor() as i64,
        // -0 and 0 are the same place.
        false => i64::from((v + 0.0).to_bits()),
    };
    // Finer where nothing is merged but equal vertices.
    let steps = if cell_m > 0.0 { 1.0 } else { 60.0 };
    let direction = |v: f32| (v * steps).round() as i8;
    ([position.x, position.y, position.z].map(place), [normal.x, normal.y, normal.z].map(direction))
}

/// Leaves out vertices that no triangle uses.
fn compact(mesh: TriMesh) -> TriMesh {
    let mut numbers = vec![None; mesh.positions.len()];
    let mut out = TriMesh::default();
    for triangle in &mesh.triangles {
        out.triangles.push(triangle.map(|vertex| {
            *numbers[vertex as usize].get_or_insert_with(|| {
                out.positions.push(mesh.positions[vertex as usize]);
                out.normals.push(mesh.normals[vertex as usize]);
                out.positions.len() as u32 - 1
            })
        }));
    }
    out
}
