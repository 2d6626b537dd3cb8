//! Parts as triangles.

use std::f64::consts::{PI, TAU};

use super::placed;
use crate::{Part, Shape, TriMesh};

const CYLINDER_SIDES: usize = 32;
const SPHERE_SLICES: usize = 32;
const SPHERE_STACKS: usize = 16;

/// The triangles of a part in its link's frame; see [`Part::triangulate`].
pub fn part_meshes(part: &Part) -> Vec<TriMesh> {
    let mut meshes = match &part.shape {
        Shape::Mesh { meshes, .. } => placed(meshes, &part.link_from_part),
        Shape::Box { size } => placed(&[box_mesh(*size)], &part.link_from_part),
        Shape::Cylinder { radius, length } => {
            placed(&[cylinder_mesh(*radius, *length)], &part.link_from_part)
        }
        Shape::Sphere { radius } => placed(&[sphere_mesh(*radius)], &part.link_from_part),
    };
    if let Some(material) = &part.material {
        for mesh in &mut meshes {
            mesh.material = material.clone();
        }
    }
    meshes
}

/// A box centred on the origin; each face has its own vertices and the whole texture.
fn box_mesh(size: [f64; 3]) -> TriMesh {
    let mut mesh = TriMesh::default();
    let half = size.map(|s| (s / 2.0) as f32);
    for axis in 0..3 {
        for sign in [-1.0f32, 1.0] {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let first = mesh.positions.len() as u32;
            for [cu, cv] in [[-1.0f32, -1.0f32], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
                let mut position = [0.0; 3];
                position[axis] = sign * half[axis];
                position[u] = cu * half[u];
                position[v] = cv * half[v];
                let mut normal = [0.0; 3];
                normal[axis] = sign;
                mesh.positions.push(position);
                mesh.normals.push(normal);
                mesh.uvs.push([(1.0 + cu * sign) / 2.0, (1.0 - cv) / 2.0]);
            }
            let faces = if sign > 0.0 { [[0, 1, 2], [0, 2, 3]] } else { [[0, 2, 1], [0, 3, 2]] };
            mesh.triangles.extend(faces.map(|f: [u32; 3]| f.map(|i| first + i)));
        }
    }
    mesh
}

/// A closed cylinder along z; its sides and caps have separate vertices for their normals.
fn cylinder_mesh(radius: f64, length: f64) -> TriMesh {
    let mut mesh = TriMesh::default();
    let half = length / 2.0;
    for i in 0..=CYLINDER_SIDES {
        let [x, y] = on_circle(i, CYLINDER_SIDES);
        let u = i as f32 / CYLINDER_SIDES as f32;
        for (z, v) in [(-half, 1.0), (half, 0.0)] {
            mesh.positions.push([radius * x, radius * y, z].map(|c| c as f32));
            mesh.normals.push([x as f32, y as f32, 0.0]);
            mesh.uvs.push([u, v]);
        }
    }
    for i in 0..CYLINDER_SIDES as u32 {
        let low = 2 * i;
        mesh.triangles.extend([[low, low + 2, low + 3], [low, low + 3, low + 1]]);
    }
    for sign in [-1.0, 1.0] {
        let first = mesh.positions.len() as u32;
        for i in 0..CYLINDER_SIDES {
            let [x, y] = on_circle(i, CYLINDER_SIDES);
            mesh.positions.push([radius * x, radius * y, sign * half].map(|c| c as f32));
            mesh.normals.push([0.0, 0.0, sign as f32]);
            mesh.uvs.push([(0.5 + x / 2.0) as f32, (0.5 - y / 2.0) as f32]);
        }
        for i in 1..CYLINDER_SIDES as u32 - 1 {
            let fan = if sign > 0.0 { [0, i, i + 1] } else { [0, i + 1, i] };
            mesh.triangles.push(fan.map(|k| first + k));
        }
    }
    mesh
}

/// A sphere of slices (longitude) and stacks (latitude), poles on z.
fn sphere_mesh(radius: f64) -> TriMesh {
    let mut mesh = TriMesh::default();
    for stack in 0..=SPHERE_STACKS {
        let (sin, cos) = (PI * stack as f64 / SPHERE_STACKS as f64).sin_cos();
        for slice in 0..=SPHERE_SLICES {
            let [x, y] = on_circle(slice, SPHERE_SLICES);
            let normal = [sin * x, sin * y, cos];
            mesh.positions.push(normal.map(|n| (radius * n) as f32));
            mesh.normals.push(normal.map(|n| n as f32));
            mesh.uvs
                .push([slice as f32 / SPHERE_SLICES as f32, stack as f32 / SPHERE_STACKS as f32]);
        }
    }
    let row = SPHERE_SLICES as u32 + 1;
    for stack in 0..SPHERE_STACKS as u32 {
        for slice in 0..SPHERE_SLICES as u32 {
            let upper = stack * row + slice;
            let lower = upper + row;
            if stack > 0 {
                mesh.triangles.push([upper, lower, upper + 1]);
            }
            if stack + 1 < SPHERE_STACKS as u32 {
                mesh.triangles.push([upper + 1, lower, lower + 1]);
            }
        }
    }
    mesh
}

fn on_circle(index: usize, count: usize) -> [f64; 2] {
    // The seam's two vertices are bitwise the same point.
    let (sin, cos) = (TAU * (index % count) as f64 / count as f64).sin_cos();
    [cos, sin]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Material, Pose};

    /// Volume by the divergence theorem: positive only where faces wind outwards.
    fn volume(meshes: &[TriMesh]) -> f64 {
        let tetrahedron = |[a, b, c]: [[f32; 3]; 3]| {
            let [a, b, c] = [a, b, c].map(|p| nalgebra::Vector3::from(p.map(f64::from)));
            a.dot(&b.cross(&c)) / 6.0
        };
        meshes.iter().flat_map(|m| (0..m.triangles.len()).map(|t| tetrahedron(m.corners(t)))).sum()
    }

    fn part(shape: Shape) -> Part {
        Part {
            name: "p".into(),
            link_from_part: Pose::translation(1.0, 2.0, 3.0),
            shape,
            material: None,
        }
    }

    #[test]
    fn primitives_are_closed_and_wind_outwards() {
        let boxed = part(Shape::Box { size: [1.0, 2.0, 3.0] }).triangulate();
        assert!((volume(&boxed) - 6.0).abs() < 1e-5);
        let cylinder = part(Shape::Cylinder { radius: 1.0, length: 2.0 }).triangulate();
        let polygon_area = 16.0 * (TAU / 32.0).sin();
        assert!((volume(&cylinder) - 2.0 * polygon_area).abs() < 1e-4);
        let sphere = part(Shape::Sphere { radius: 1.0 }).triangulate();
        let ratio = volume(&sphere) / (4.0 / 3.0 * PI);
        assert!((0.97..1.0).contains(&ratio), "{ratio}");
    }

    #[test]
    fn mirrored_meshes_keep_their_outside() {
        let mesh = box_mesh([1.0, 2.0, 3.0]);
        let mirrored = super::super::scaled(&[mesh], [-1.0, 1.0, 1.0]);
        assert!((volume(&mirrored) - 6.0).abs() < 1e-5);
        assert!(
            mirrored[0]
                .normals
                .iter()
                .zip(&mirrored[0].positions)
                .all(|(n, p)| { (0..3).map(|k| n[k] * p[k]).sum::<f32>() > 0.0 })
        );
    }

    #[test]
    fn a_part_material_overrides_the_mesh() {
        let mut part = part(Shape::Sphere { radius: 1.0 });
        part.material = Some(Material { name: "red".into(), ..Material::default() });
        assert_eq!(part.triangulate()[0].material.name, "red");
    }
}
