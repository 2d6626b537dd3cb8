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
use crate::near::Corners;

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
    let mut gaps: Vec<Measured> = vec![None; geometry.sphere_pairs.len()];
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
        for (pair, memory) in geometry.sphere_pairs.iter().zip(&mut gaps) {
            let overlap = -pair.gap(spheres, &centers, &scenery.robot, tolerance_m, memory);
            if overlap > tolerance_m {
                let [link_a, link_b] = pair.links.map(|link| &geometry.link_names[link]);
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

/// Two links whose spheres must not overlap.
#[derive(Debug, Clone)]
pub struct SpherePair {
    /// The links.
    pub links: [usize; 2],
    /// Spheres of each link.
    spheres: [Vec<usize>; 2],
    /// Box around the centres of the second link's spheres, in that link's frame.
    bounds: Aabb,
}

/// The gap between two links' spheres when it was last measured, and where they were.
type Measured = Option<(Corners, f64)>;

impl SpherePair {
    /// Smallest free distance between spheres of the two links, negative where they overlap; infinite
    /// where the links have moved too little since the last measurement to have come together.
    fn gap(
        &self,
        spheres: &[RobotSphere],
        centers: &[Vector],
        robot: &[Frame],
        tolerance_m: f64,
        memory: &mut Measured,
    ) -> f64 {
        let [link_a, link_b] = self.links;
        let corners = Corners::of(&self.bounds, &robot[link_a].inverse().then(&robot[link_b]));
        if let Some((earlier, gap)) = memory
            && corners.moved_since(earlier) < *gap + tolerance_m
        {
            return f64::INFINITY;
        }
        let [of_a, of_b] = &self.spheres;
        let pairs = of_a.iter().flat_map(|&a| of_b.iter().map(move |&b| (a, b)));
        let gap = pairs
            .map(|(a, b)| centers[a].distance(centers[b]) - spheres[a].radius - spheres[b].radius)
            .fold(f64::INFINITY, f64::min);
        *memory = Some((corners, gap));
        gap
    }
}

/// Pairs of links that carry spheres and must not touch.
pub fn pairs(spheres: &[RobotSphere], links: &LinkPairs) -> Vec<SpherePair> {
    let mut carriers: Vec<usize> = spheres.iter().map(|sphere| sphere.link).collect();
    carriers.sort_unstable();
    carriers.dedup();
    let of_link = |link: usize| (0..spheres.len()).filter(move |&s| spheres[s].link == link);
    let ordered = carriers.iter().flat_map(|&b| carriers.iter().map(move |&a| (a, b)));
    ordered
        .filter(|&(a, b)| a < b && links.checked(a, b))
        .map(|(a, b)| SpherePair {
            links: [a, b],
            spheres: [a, b].map(|link| of_link(link).collect()),
            bounds: Aabb::from_points(of_link(b).map(|s| Vector::from(spheres[s].center))),
        })
        .collect()
}

/// Link pairs whose spheres overlap.
pub fn overlapping_links(
    spheres: &[RobotSphere],
    pairs: &[SpherePair],
    robot: &[Frame],
) -> Vec<[usize; 2]> {
    let centers = centers(spheres, robot);
    let overlaps = |pair: &&SpherePair| pair.gap(spheres, &centers, robot, 0.0, &mut None) < 0.0;
    pairs.iter().filter(overlaps).map(|pair| pair.links).collect()
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
