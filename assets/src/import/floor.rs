//! Floors that are part of a larger body, such as a room in one piece.

use std::sync::Arc;

use akrobat_model::{Part, Pose, SceneBody, Shape, TriMesh};
use nalgebra::{Point3, Vector3};

use super::ImportedScene;

/// Level triangles within this height of z = 0 are floor, metres.
const NEAR_M: f64 = 0.03;
/// Least area of a floor, square metres.
const LEAST_AREA_M2: f64 = 1.0;
/// Cosine of the steepest slope of a floor.
const LEVEL: f64 = 0.95;

/// Makes the level triangles at z = 0 of a room in one piece a body of class `floor`, which bases may stand on. Scenes
/// with a floor of their own are left alone.
pub fn split_floor(scene: &mut ImportedScene) {
    if scene.bodies.iter().any(|body| ["floor", "ground"].contains(&body.class.as_str())) {
        return;
    }
    let areas: Vec<f64> = scene.bodies.iter().map(area_of).collect();
    // The undersides of furniture lie there as well.
    let least = areas.iter().copied().fold(0.0, f64::max) / 4.0;
    let mut floors = Vec::new();
    for (body, area) in scene.bodies.iter_mut().zip(areas) {
        if area < least.max(LEAST_AREA_M2) {
            continue;
        }
        let visuals = split(&mut body.visuals, &body.world_from_body);
        let collisions = split(&mut body.collisions, &body.world_from_body);
        let name = format!("{}.floor", body.name);
        let what = format!("the floor of \"{}\" is a body of its own, \"{name}\"", body.name);
        scene.ledger.repaired(what);
        floors.push(SceneBody {
            name,
            class: "floor".into(),
            world_from_body: body.world_from_body,
            visuals,
            collisions,
        });
    }
    scene.bodies.extend(floors);
    scene.bodies.retain(|body| !body.visuals.is_empty() || !body.collisions.is_empty());
}

fn area_of(body: &SceneBody) -> f64 {
    let parts = body.collision_parts().iter().filter(|part| is_mesh(part));
    let meshes = parts.flat_map(Part::triangulate);
    meshes
        .map(|mesh| {
            let floor = mesh
                .triangles
                .iter()
                .filter_map(|triangle| floor_area(&mesh, triangle, &body.world_from_body));
            floor.sum::<f64>()
        })
        .sum()
}

fn is_mesh(part: &Part) -> bool {
    matches!(part.shape, Shape::Mesh { .. })
}

/// The area of a triangle that is floor.
fn floor_area(mesh: &TriMesh, triangle: &[u32; 3], world_from_mesh: &Pose) -> Option<f64> {
    let corners = triangle.map(|index| {
        let position = mesh.positions[index as usize].map(f64::from);
        (world_from_mesh * Point3::from(position)).coords
    });
    if corners.iter().any(|corner: &Vector3<f64>| corner.z.abs() > NEAR_M) {
        return None;
    }
    let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
    (normal.z.abs() > LEVEL * normal.norm()).then(|| normal.norm() / 2.0)
}

/// Takes the floor out of parts; gives it as parts of its own.
fn split(parts: &mut Vec<Part>, world_from_body: &Pose) -> Vec<Part> {
    let mut floors = Vec::new();
    let mut rest = Vec::new();
    for part in parts.drain(..) {
        let Shape::Mesh { source, .. } = &part.shape else {
            rest.push(part);
            continue;
        };
        let source = source.clone();
        // In the body's frame, with the part's own material laid over.
        let (mut level, mut other) = (Vec::new(), Vec::new());
        for mesh in part.triangulate() {
            let is_floor = |t: &[u32; 3]| floor_area(&mesh, t, world_from_body).is_some();
            let (floor, remains) = mesh.triangles.iter().copied().partition(is_floor);
            for (list, triangles) in [(&mut level, floor), (&mut other, remains)] {
                let triangles: Vec<[u32; 3]> = triangles;
                if !triangles.is_empty() {
                    list.push(with_triangles(&mesh, &triangles));
                }
            }
        }
        for (list, meshes, ending) in [(&mut floors, level, "_floor"), (&mut rest, other, "")] {
            if !meshes.is_empty() {
                list.push(Part {
                    name: format!("{}{ending}", part.name),
                    link_from_part: Pose::identity(),
                    shape: Shape::Mesh { source: source.clone(), meshes: Arc::new(meshes) },
                    material: None,
                });
            }
        }
    }
    *parts = rest;
    floors
}

/// A mesh of some of the triangles, with the vertices that these need.
pub fn with_triangles(mesh: &TriMesh, triangles: &[[u32; 3]]) -> TriMesh {
    let mut new_index = vec![u32::MAX; mesh.positions.len()];
    let mut result = TriMesh { material: mesh.material.clone(), ..TriMesh::default() };
    for corners in triangles {
        let triangle = corners.map(|corner| {
            let old = corner as usize;
            if new_index[old] == u32::MAX {
                new_index[old] = result.positions.len() as u32;
                result.positions.push(mesh.positions[old]);
                result.normals.extend(mesh.normals.get(old));
                result.uvs.extend(mesh.uvs.get(old));
            }
            new_index[old]
        });
        result.triangles.push(triangle);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::{Ledger, Origin};

    /// A square of 4 m at a height, and a wall on its edge.
    fn room(height: f32) -> ImportedScene {
        let mesh = TriMesh {
            positions: vec![
                [-2.0, -2.0, height],
                [2.0, -2.0, height],
                [2.0, 2.0, height],
                [-2.0, 2.0, height],
                [-2.0, 2.0, 2.5],
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3], [0, 3, 4]],
            ..TriMesh::default()
        };
        let part = Part {
            name: "room".into(),
            link_from_part: Pose::identity(),
            shape: Shape::Mesh { source: "room.obj".into(), meshes: Arc::new(vec![mesh]) },
            material: None,
        };
        let body = SceneBody {
            name: "room".into(),
            class: "room".into(),
            world_from_body: Pose::identity(),
            visuals: vec![part],
            collisions: Vec::new(),
        };
        ImportedScene {
            name: "room".into(),
            bodies: vec![body],
            objects: Vec::new(),
            origin: Origin::default(),
            ledger: Ledger::default(),
        }
    }

    fn triangles(body: &SceneBody) -> usize {
        body.visuals.iter().flat_map(Part::triangulate).map(|mesh| mesh.triangles.len()).sum()
    }

    #[test]
    fn the_floor_of_a_room_becomes_a_body_and_no_triangle_is_lost() {
        let mut scene = room(0.0);
        split_floor(&mut scene);
        let counts: Vec<_> =
            scene.bodies.iter().map(|b| (b.class.as_str(), triangles(b))).collect();
        assert_eq!(counts, [("room", 1), ("floor", 2)]);
        assert_eq!(scene.ledger.repairs.len(), 1);
        let once = scene.bodies.len();
        split_floor(&mut scene);
        assert_eq!(scene.bodies.len(), once, "what has a floor is left alone");
    }

    #[test]
    fn what_is_not_at_the_height_of_the_floor_stays() {
        let mut scene = room(0.4);
        split_floor(&mut scene);
        assert_eq!(scene.bodies.len(), 1);
        assert_eq!(triangles(&scene.bodies[0]), 3);
    }
}
