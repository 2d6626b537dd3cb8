//! Moving and scaling meshes.

use nalgebra::{Matrix3, Matrix4, Point3, Vector3};

use crate::{Pose, TriMesh};

/// A copy of the meshes under an affine map. A mirroring map flips the winding, so that front faces
/// stay front faces.
pub fn mapped(meshes: &[TriMesh], map: &Matrix4<f64>) -> Vec<TriMesh> {
    let linear: Matrix3<f64> = map.fixed_view::<3, 3>(0, 0).into_owned();
    let mirrors = linear.determinant() < 0.0;
    let normal_map = linear.try_inverse().map(|inverse| inverse.transpose());
    let move_point = |p: &[f32; 3]| {
        let moved = map.transform_point(&Point3::from(p.map(f64::from)));
        [moved.x as f32, moved.y as f32, moved.z as f32]
    };
    let turn_normal = |m: &Matrix3<f64>, n: &[f32; 3]| {
        let turned = m * Vector3::from(n.map(f64::from));
        let turned = turned.try_normalize(1e-300).unwrap_or(turned);
        [turned.x as f32, turned.y as f32, turned.z as f32]
    };
    let convert = |mesh: &TriMesh| TriMesh {
        positions: mesh.positions.iter().map(move_point).collect(),
        normals: normal_map
            .map_or_else(Vec::new, |m| mesh.normals.iter().map(|n| turn_normal(&m, n)).collect()),
        uvs: mesh.uvs.clone(),
        triangles: if mirrors {
            mesh.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect()
        } else {
            mesh.triangles.clone()
        },
        material: mesh.material.clone(),
    };
    meshes.iter().map(convert).collect()
}

/// A copy of the meshes, scaled along each axis; a mirroring scale flips the winding.
pub fn scaled(meshes: &[TriMesh], scale: [f64; 3]) -> Vec<TriMesh> {
    mapped(meshes, &Matrix4::new_nonuniform_scaling(&Vector3::from(scale)))
}

/// A copy of the meshes at a pose.
pub fn placed(meshes: &[TriMesh], pose: &Pose) -> Vec<TriMesh> {
    mapped(meshes, &pose.to_homogeneous())
}
