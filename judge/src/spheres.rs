//! Collision spheres against the scene, the object and each other.

use akrobat_model::Rejection;
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::Triangle;

use crate::bodies::Obstacle;
use crate::contacts::{Contact, LinkPairs};
use crate::finding::Finding;
use crate::judge::{Geometry, Scenery};
use crate::kinematics::Frame;

/// Distances are measured up to this far from a sphere's surface, metres.
const REACH_M: f64 = 0.06;

/// A collision sphere of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotSphere {
    /// Index of the link that carries it.
    pub link: usize,
    /// Centre in the link's frame, metres.
    pub center: [f64; 3],
    /// Radius, metres.
    pub radius: f64,
}

/// The first overlap of a sphere with something it must not touch.
pub fn check(geometry: &Geometry, sceneries: &[Scenery], tolerance_m: f64) -> Option<Finding> {
    let spheres = &geometry.spheres;
    let obstacles = geometry.obstacles.len();
    // Where each sphere was last measured against each obstacle, and the free distance found there.
    let mut measured: Vec<Option<(Vector, f64)>> = vec![None; spheres.len() * obstacles];
    for scenery in sceneries {
        let centers = centers(spheres, &scenery.robot);
        for (index, (sphere, &center)) in spheres.iter().zip(&centers).enumerate() {
            for (o, obstacle) in geometry.obstacles.iter().enumerate() {
                let local = scenery.obstacle_from_world[o].point(center);
                let memory = &mut measured[index * obstacles + o];
                if memory.is_some_and(|(at, free)| local.distance(at) < free + tolerance_m) {
                    continue;
                }
                let contacts = &geometry.contacts[sphere.link][o];
                let (distance, owner) =
                    clearance(obstacle, contacts, local, sphere.radius + REACH_M);
                let free = distance - sphere.radius;
                *memory = Some((local, free));
                if free < -tolerance_m {
                    let owner = owner.map_or("", |owner| &obstacle.owners[owner as usize].label);
                    let link = &geometry.link_names[sphere.link];
                    return Some(Finding::new(
                        Rejection::SphereCollision,
                        format!(
                            "{}: a sphere of link \"{link}\" (radius {:.3} m) is {:.1} mm inside {owner}",
                            scenery.place,
                            sphere.radius,
                            -free * 1e3
                        ),
                    ));
                }
            }
        }
        for &(a, b) in &geometry.sphere_pairs {
            let overlap = spheres[a].radius + spheres[b].radius - centers[a].distance(centers[b]);
            if overlap > tolerance_m {
                let [link_a, link_b] = [a, b].map(|s| &geometry.link_names[spheres[s].link]);
                return Some(Finding::new(
                    Rejection::SphereCollision,
                    format!(
                        "{}: spheres of links \"{link_a}\" and \"{link_b}\" overlap by {:.1} mm",
                        scenery.place,
                        overlap * 1e3
                    ),
                ));
            }
        }
    }
    None
}

/// Pairs of spheres on links that must not touch.
pub fn pairs(spheres: &[RobotSphere], links: &LinkPairs) -> Vec<(usize, usize)> {
    let ordered = (0..spheres.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    ordered.filter(|&(a, b)| links.checked(spheres[a].link, spheres[b].link)).collect()
}

/// Link pairs whose spheres overlap.
pub fn overlapping_links(
    spheres: &[RobotSphere],
    pairs: &[(usize, usize)],
    robot: &[Frame],
) -> Vec<[usize; 2]> {
    let centers = centers(spheres, robot);
    let overlapping = pairs
        .iter()
        .filter(|&&(a, b)| centers[a].distance(centers[b]) < spheres[a].radius + spheres[b].radius);
    overlapping.map(|&(a, b)| [spheres[a].link, spheres[b].link]).collect()
}

fn centers(spheres: &[RobotSphere], robot: &[Frame]) -> Vec<Vector> {
    spheres.iter().map(|s| robot[s.link].point(Vector::from(s.center))).collect()
}

/// Distance of a point to the nearest surface that must not be touched, negative inside a solid, and
/// its owner; `reach_m` where there is none nearer.
fn clearance(
    obstacle: &Obstacle,
    contacts: &[Contact],
    point: Vector,
    reach_m: f64,
) -> (f64, Option<u32>) {
    let mut nearest = (reach_m, None);
    let checked = |owner: u32| contacts[owner as usize] == Contact::Forbidden;
    let around = Aabb::from_half_extents(point, Vector::splat(reach_m));
    for index in obstacle.triangle_bvh.intersect_aabb(&around) {
        let owner = obstacle.triangle_owners[index as usize];
        if checked(owner) {
            let [a, b, c] = obstacle.triangles[index as usize];
            let distance = Triangle::new(a, b, c).distance_to_local_point(point, true);
            if distance < nearest.0 {
                nearest = (distance, Some(owner));
            }
        }
    }
    let here = Aabb::new(point, point);
    for index in obstacle.solid_bvh.intersect_aabb(&here) {
        let owner = obstacle.solid_owners[index as usize];
        let distance = obstacle.solids[index as usize].distance(point);
        if checked(owner) && distance < nearest.0.min(0.0) {
            nearest = (distance, Some(owner));
        }
    }
    nearest
}
