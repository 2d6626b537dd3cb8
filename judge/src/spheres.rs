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
use crate::travel::{RelativeWay, Travel};

/// Distances are measured up to this far from a sphere's surface, metres.
const REACH_M: f64 = 0.3;

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

/// The spheres of one link.
struct Carried {
    link: usize,
    spheres: Vec<usize>,
}

/// When a link's spheres can have come to an obstacle at the earliest.
#[derive(Clone)]
struct Free {
    way: RelativeWay,
    /// Lengths of the link's way in the obstacle's frame, metres.
    until: Vec<f64>,
}

/// The first overlap of a sphere with something it must not touch.
pub fn check(geometry: &Geometry, sceneries: &[Scenery], tolerance_m: f64) -> Option<Finding> {
    let carried = carried(&geometry.spheres);
    let mut free: Vec<Vec<Free>> = carried
        .iter()
        .map(|c| {
            let until = vec![f64::NEG_INFINITY; c.spheres.len()];
            vec![Free { way: RelativeWay::default(), until }; geometry.obstacles.len()]
        })
        .collect();
    let mut apart = vec![(RelativeWay::default(), f64::NEG_INFINITY); geometry.sphere_pairs.len()];
    for scenery in sceneries {
        for (carried, free) in carried.iter().zip(&mut free) {
            for (o, free) in free.iter_mut().enumerate() {
                let travel = scenery.robot_travel[carried.link] + scenery.obstacle_travel[o];
                if !free.way.skips(travel)
                    && let Some(finding) =
                        against_obstacle(geometry, scenery, carried, o, travel, tolerance_m, free)
                {
                    return Some(finding);
                }
            }
        }
        for (pair, (way, apart_until)) in geometry.sphere_pairs.iter().zip(&mut apart) {
            let [a, b] = pair.links;
            let travel = scenery.robot_travel[a] + scenery.robot_travel[b];
            let Some(bounds) = geometry.link_bounds[a].filter(|_| !way.skips(travel)) else {
                continue;
            };
            let b_from_a = scenery.robot[b].inverse().then(&scenery.robot[a]);
            let length = way.follow(&bounds, &b_from_a);
            if length < *apart_until {
                way.skip(*apart_until, travel);
                continue;
            }
            let gap = pair.gap(&geometry.spheres, &b_from_a);
            *apart_until = length + gap + tolerance_m;
            way.skip(*apart_until, travel);
            if gap < -tolerance_m {
                let [link_a, link_b] = pair.links.map(|link| &geometry.link_names[link]);
                return Some(Finding::new(
                    Rejection::SphereCollision,
                    format!(
                        "{}: spheres of links \"{link_a}\" and \"{link_b}\" overlap by {:.1} mm",
                        scenery.place,
                        -gap * 1e3
                    ),
                ));
            }
        }
    }
    None
}

fn carried(spheres: &[RobotSphere]) -> Vec<Carried> {
    let mut out: Vec<Carried> = Vec::new();
    for (index, sphere) in spheres.iter().enumerate() {
        match out.iter_mut().find(|c| c.link == sphere.link) {
            Some(carried) => carried.spheres.push(index),
            None => out.push(Carried { link: sphere.link, spheres: vec![index] }),
        }
    }
    out
}

/// Measures those of a link's spheres that can have come to an obstacle.
fn against_obstacle(
    geometry: &Geometry,
    scenery: &Scenery,
    carried: &Carried,
    o: usize,
    travel: Travel,
    tolerance_m: f64,
    free: &mut Free,
) -> Option<Finding> {
    let bounds = geometry.link_bounds[carried.link]?;
    let obstacle = &geometry.obstacles[o];
    let contacts = &geometry.contacts[carried.link][o];
    let obstacle_from_link = scenery.obstacle_from_world[o].then(&scenery.robot[carried.link]);
    let length = free.way.follow(&bounds, &obstacle_from_link);
    for (&index, free_until) in carried.spheres.iter().zip(&mut free.until) {
        if length < *free_until {
            continue;
        }
        let sphere = &geometry.spheres[index];
        let center = obstacle_from_link.point(Vector::from(sphere.center));
        let (distance, owner) = clearance(obstacle, contacts, center, sphere.radius + REACH_M);
        let gap = distance - sphere.radius;
        *free_until = length + gap + tolerance_m;
        if gap < -tolerance_m {
            let owner = owner.map_or("", |owner| &obstacle.owners[owner as usize].label);
            let link = &geometry.link_names[carried.link];
            return Some(Finding::new(
                Rejection::SphereCollision,
                format!(
                    "{}: a sphere of link \"{link}\" (radius {:.3} m) is {:.1} mm inside {owner}",
                    scenery.place,
                    sphere.radius,
                    -gap * 1e3
                ),
            ));
        }
    }
    free.way.skip(free.until.iter().copied().fold(f64::INFINITY, f64::min), travel);
    None
}

/// Two links whose spheres must not overlap.
#[derive(Debug, Clone)]
pub struct SpherePair {
    /// The links.
    pub links: [usize; 2],
    /// Spheres of each link.
    spheres: [Vec<usize>; 2],
}

impl SpherePair {
    /// Smallest free distance between spheres of the two links, metres; negative where they overlap.
    fn gap(&self, spheres: &[RobotSphere], b_from_a: &Frame) -> f64 {
        let [of_a, of_b] = &self.spheres;
        let mut gap = f64::INFINITY;
        for &a in of_a {
            let center = b_from_a.point(Vector::from(spheres[a].center));
            for &b in of_b {
                let distance = center.distance(Vector::from(spheres[b].center));
                gap = gap.min(distance - spheres[a].radius - spheres[b].radius);
            }
        }
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
        })
        .collect()
}

/// Link pairs whose spheres overlap.
pub fn overlapping_links(
    spheres: &[RobotSphere],
    pairs: &[SpherePair],
    robot: &[Frame],
) -> Vec<[usize; 2]> {
    let overlaps = |pair: &&SpherePair| {
        let [a, b] = pair.links;
        pair.gap(spheres, &robot[b].inverse().then(&robot[a])) < 0.0
    };
    pairs.iter().filter(overlaps).map(|pair| pair.links).collect()
}

/// Distance of a point to the nearest surface that must not be touched, negative inside a solid, and
/// its owner; `reach_m` where there is none nearer.
fn clearance(
    obstacle: &Obstacle,
    contacts: &[Contact],
    point: Vector,
    reach_m: f64,
) -> (f64, Option<u32>) {
    let checked = |owner: u32| contacts[owner as usize] == Contact::Forbidden;
    let surface = obstacle.triangle_bvh.find_best(
        reach_m,
        |node, _| node.aabb().distance_to_local_point(point, true),
        |index, _| {
            let [a, b, c] = obstacle.triangles[index as usize];
            checked(obstacle.triangle_owners[index as usize])
                .then(|| Triangle::new(a, b, c).distance_to_local_point(point, true))
        },
    );
    let mut nearest = match surface {
        Some((index, distance)) => (distance, Some(obstacle.triangle_owners[index as usize])),
        None => (reach_m, None),
    };
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
