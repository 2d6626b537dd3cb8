//! What a ray meets first (Möller and Trumbore, *Fast, Minimum Storage Ray/Triangle Intersection*, 1997).

use akrobat_model::Pose;
use nalgebra::{Point3, Vector3};

use crate::RenderScene;
use crate::clusters::{ClusteredMesh, Sphere};

/// A half-line in single precision.
struct Ray {
    origin: Vector3<f32>,
    /// Unit length.
    direction: Vector3<f32>,
}

impl Ray {
    /// True where the first `reach` metres come near the sphere.
    fn may_hit(&self, sphere: &Sphere, reach: f32) -> bool {
        let to_center = Vector3::from(sphere.center) - self.origin;
        let along = to_center.dot(&self.direction).clamp(0.0, reach);
        (to_center - self.direction * along).norm_squared() <= sphere.radius * sphere.radius
    }

    /// Distance to a triangle, from either side.
    fn hit(&self, corners: [Vector3<f32>; 3]) -> Option<f32> {
        let (e1, e2) = (corners[1] - corners[0], corners[2] - corners[0]);
        let p = self.direction.cross(&e2);
        let determinant = e1.dot(&p);
        if determinant == 0.0 {
            return None;
        }
        let s = self.origin - corners[0];
        let u = s.dot(&p) / determinant;
        let q = s.cross(&e1);
        let v = self.direction.dot(&q) / determinant;
        let distance = e2.dot(&q) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance >= 0.0).then_some(distance)
    }

    fn hit_mesh(&self, mesh: &ClusteredMesh, mut reach: f32) -> Option<f32> {
        let mut nearest = None;
        if !self.may_hit(&mesh.sphere, reach) {
            return None;
        }
        let [x, y, z] = &mesh.positions;
        for cluster in &mesh.clusters {
            if !self.may_hit(&cluster.sphere, reach) {
                continue;
            }
            for triangle in &mesh.triangles[cluster.triangles.clone()] {
                let corners = triangle.corners.map(|corner| {
                    let vertex = cluster.vertices.start + usize::from(corner);
                    Vector3::new(x[vertex], y[vertex], z[vertex])
                });
                if let Some(distance) = self.hit(corners).filter(|&d| d <= reach) {
                    reach = distance;
                    nearest = Some(distance);
                }
            }
        }
        nearest
    }
}

/// Distance (metres) from `from` towards `to` at which the scene's bodies are met first; `None` where the way
/// is free.
pub(crate) fn first_hit(
    scene: &RenderScene,
    world_from_body: &[Pose],
    from: &Point3<f64>,
    to: &Point3<f64>,
) -> Option<f64> {
    let way = to - from;
    let mut reach = way.norm() as f32;
    let direction = way.try_normalize(1e-9)?;
    let mut nearest = None;
    for instance in &scene.clusters().instances {
        let body_from_world = world_from_body[instance.body].inverse();
        let ray = Ray {
            origin: (body_from_world * from).coords.cast(),
            direction: (body_from_world * direction).cast(),
        };
        if let Some(distance) = ray.hit_mesh(&instance.mesh, reach) {
            reach = distance;
            nearest = Some(f64::from(distance));
        }
    }
    nearest
}
