//! Whether a place is inside a body.

use std::sync::Arc;

use akrobat_model::TriMesh;
use nalgebra::{Point3, Vector3};

use crate::{FrameState, RenderBody, RenderScene};

/// Directions in which triangles are counted; none is parallel to an axis.
const DIRECTIONS: [[f32; 3]; 7] = [
    [0.61, 0.53, 0.59],
    [-0.73, 0.31, 0.61],
    [0.29, -0.83, 0.47],
    [0.37, 0.41, -0.83],
    [-0.47, -0.67, -0.57],
    [-0.19, 0.89, -0.41],
    [0.87, -0.23, -0.43],
];

/// Bodies that places can be inside of.
#[derive(Debug, Clone)]
pub struct Enclosures<'a> {
    scene: &'a RenderScene,
    /// Lowest and highest corner of each mesh of each body.
    bounds: Vec<Vec<[[f32; 3]; 2]>>,
}

impl<'a> Enclosures<'a> {
    /// The bodies of a scene.
    pub fn new(scene: &'a RenderScene) -> Self {
        let bounds = |mesh: &Arc<TriMesh>| {
            let low = mesh.positions.iter().fold([f32::INFINITY; 3], |low, p| min(low, *p));
            let high = mesh.positions.iter().fold([f32::NEG_INFINITY; 3], |high, p| max(high, *p));
            [low, high]
        };
        let of_body = |body: &RenderBody| body.meshes.iter().map(bounds).collect();
        Self { scene, bounds: scene.bodies.iter().map(of_body).collect() }
    }

    /// The body that a place (world frame, metres) is inside of: in every direction a ray from it meets the body's
    /// triangles an odd number of times. (Of walls with doors and windows, and of meshes with holes, some direction says
    /// otherwise: they have no inside.) A body that also encloses the robot's base or tool is a room, not an
    /// obstacle.
    pub fn body_around(&self, frame: &FrameState, place: &Point3<f64>) -> Option<&'a RenderBody> {
        let rooms = [frame.world_from_tool, frame.world_from_base];
        let inside = |index: usize, place: &Point3<f64>| {
            let place = frame.world_from_body[index].inverse_transform_point(place);
            is_inside(&self.scene.bodies[index], &self.bounds[index], &place)
        };
        let is_room =
            |index: usize| rooms.iter().any(|pose| inside(index, &pose.translation.vector.into()));
        (0..self.scene.bodies.len())
            .find(|&index| inside(index, place) && !is_room(index))
            .map(|index| &self.scene.bodies[index])
    }
}

fn is_inside(body: &RenderBody, bounds: &[[[f32; 3]; 2]], place: &Point3<f64>) -> bool {
    let place: Vector3<f32> = place.coords.cast();
    let mut odd = [false; DIRECTIONS.len()];
    for (mesh, [low, high]) in body.meshes.iter().zip(bounds) {
        if !(0..3).all(|i| low[i] <= place[i] && place[i] <= high[i]) {
            continue;
        }
        for triangle in &mesh.triangles {
            let corners = triangle.map(|v| Vector3::from(mesh.positions[v as usize]) - place);
            for (odd, direction) in odd.iter_mut().zip(DIRECTIONS) {
                *odd ^= meets(corners, Vector3::from(direction));
            }
        }
    }
    odd.iter().all(|&is_odd| is_odd)
}

/// Whether the ray from the origin meets a triangle (Möller and Trumbore, 1997).
fn meets(corners: [Vector3<f32>; 3], direction: Vector3<f32>) -> bool {
    let (e1, e2) = (corners[1] - corners[0], corners[2] - corners[0]);
    let p = direction.cross(&e2);
    let determinant = e1.dot(&p);
    if determinant == 0.0 {
        return false;
    }
    let s = -corners[0];
    let u = s.dot(&p) / determinant;
    let q = s.cross(&e1);
    let v = direction.dot(&q) / determinant;
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && e2.dot(&q) / determinant >= 0.0
}

fn min(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i].min(b[i]))
}

fn max(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i].max(b[i]))
}
