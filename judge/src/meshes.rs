//! The robot's solids against the scene's and the object's meshes and against each other.

use akrobat_model::Rejection;

use crate::contacts::{Contact, LinkPairs};
use crate::convex::{Deepest, DepthProbe};
use crate::finding::Finding;
use crate::judge::{Geometry, Scenery};
use crate::kinematics::Frame;
use crate::near::{Intrusions, Near, SolidPair, solids_in_each_other};
use crate::path::Place;
use crate::travel::{RelativeWay, Travel};

/// Shallower contacts are not told apart from none, metres.
const TOUCH_M: f64 = 1e-4;

/// The deepest penetration of a trajectory.
#[derive(Debug, Clone, Default)]
pub struct Penetration {
    /// Metres.
    pub depth_m: f64,
    /// What it is.
    pub detail: String,
}

/// A box in the held link's frame, metres.
pub type Region = [f64; 6];

struct RobotIntrusions<'a> {
    geometry: &'a Geometry,
    contacts: &'a [Contact],
    link: usize,
    obstacle: usize,
    place: Place,
    worst: &'a mut Penetration,
}

impl Intrusions for RobotIntrusions<'_> {
    fn wanted(&self, owner: u32) -> bool {
        self.contacts[owner as usize] != Contact::Allowed
    }

    fn floor_m(&self, _owner: u32) -> f64 {
        self.worst.depth_m.max(TOUCH_M)
    }

    fn found(&mut self, owner: u32, deepest: Deepest) {
        let excepted = self.contacts[owner as usize] == Contact::AllowedInRegion
            && self.geometry.handle_region.is_some_and(|region| inside(&region, deepest));
        if !excepted {
            let link = &self.geometry.link_names[self.link];
            let other = &self.geometry.obstacles[self.obstacle].owners[owner as usize].label;
            self.worst.depth_m = deepest.depth_m;
            self.worst.detail = format!(
                "{}: link \"{link}\" and {other} are {:.1} mm inside each other",
                self.place,
                deepest.depth_m * 1e3
            );
        }
    }
}

fn inside(region: &Region, deepest: Deepest) -> bool {
    let point = deepest.point.to_array();
    (0..3).all(|axis| (region[axis]..=region[axis + 3]).contains(&point[axis]))
}

/// The deepest penetration over all configurations.
pub fn deepest(geometry: &Geometry, sceneries: &[Scenery]) -> Penetration {
    let mut worst = Penetration::default();
    let mut probe = DepthProbe::default();
    let obstacles = geometry.obstacles.len();
    let mut near: Vec<(RelativeWay, Option<Near>)> = Vec::new();
    near.resize_with(geometry.robot_solids.len() * obstacles, Default::default);
    let mut pairs = vec![SolidPair::default(); geometry.solid_pairs.len()];
    for scenery in sceneries {
        for (index, (link, solid)) in geometry.robot_solids.iter().enumerate() {
            for (o, obstacle) in geometry.obstacles.iter().enumerate() {
                let travel = scenery.robot_travel[*link] + scenery.obstacle_travel[o];
                let mut intrusions = RobotIntrusions {
                    geometry,
                    contacts: &geometry.contacts[*link][o],
                    link: *link,
                    obstacle: o,
                    place: scenery.place,
                    worst: &mut worst,
                };
                let memory = &mut near[index * obstacles + o];
                Near::visit(
                    memory,
                    &mut probe,
                    solid,
                    obstacle,
                    || scenery.obstacle_from_world[o].then(&scenery.robot[*link]),
                    travel,
                    &mut intrusions,
                );
            }
        }
        for (&(a, b), pair) in geometry.solid_pairs.iter().zip(&mut pairs) {
            let floor_m = worst.depth_m.max(TOUCH_M);
            let [link_a, link_b] = [a, b].map(|s| geometry.robot_solids[s].0);
            let travel = scenery.robot_travel[link_a] + scenery.robot_travel[link_b];
            let found =
                pair_depth(geometry, &mut probe, &scenery.robot, [a, b], travel, pair, floor_m);
            if let Some(depth_m) = found {
                let [link_a, link_b] = [link_a, link_b].map(|link| &geometry.link_names[link]);
                let place = scenery.place;
                worst = Penetration {
                    depth_m,
                    detail: format!(
                        "{place}: links \"{link_a}\" and \"{link_b}\" are {:.1} mm inside each other",
                        depth_m * 1e3
                    ),
                };
            }
        }
    }
    worst
}

/// The finding for a penetration beyond the tolerance.
pub fn finding(worst: &Penetration, tolerance_m: f64) -> Option<Finding> {
    (worst.depth_m > tolerance_m)
        .then(|| Finding::new(Rejection::MeshPenetration, worst.detail.clone()))
}

/// Pairs of robot solids on links that must not touch.
pub fn pairs(solid_links: impl Iterator<Item = usize>, links: &LinkPairs) -> Vec<(usize, usize)> {
    let solid_links: Vec<usize> = solid_links.collect();
    let ordered = (0..solid_links.len()).flat_map(|b| (0..b).map(move |a| (a, b)));
    ordered.filter(|&(a, b)| links.checked(solid_links[a], solid_links[b])).collect()
}

/// Link pairs whose solids are more than `tolerance_m` inside each other.
pub fn penetrating_links(
    geometry: &Geometry,
    robot: &[Frame],
    tolerance_m: f64,
) -> Vec<[usize; 2]> {
    let mut probe = DepthProbe::default();
    let penetrating = geometry.solid_pairs.iter().filter(|&&(a, b)| {
        let pair = &mut SolidPair::default();
        pair_depth(geometry, &mut probe, robot, [a, b], 0.0, pair, tolerance_m).is_some()
    });
    penetrating.map(|&(a, b)| [geometry.robot_solids[a].0, geometry.robot_solids[b].0]).collect()
}

fn pair_depth(
    geometry: &Geometry,
    probe: &mut DepthProbe,
    robot: &[Frame],
    [a, b]: [usize; 2],
    travel: Travel,
    pair: &mut SolidPair,
    floor_m: f64,
) -> Option<f64> {
    let (link_a, solid_a) = &geometry.robot_solids[a];
    let (link_b, solid_b) = &geometry.robot_solids[b];
    let b_from_a = || robot[*link_b].inverse().then(&robot[*link_a]);
    let found = solids_in_each_other(probe, solid_a, solid_b, b_from_a, travel, pair, floor_m);
    found.map(|deepest| deepest.depth_m)
}
