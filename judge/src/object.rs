//! The moving part of the object against the scene and against the rest of the object.
//!
//! Appliances stand embedded in counters and doors rest in frames: what is inside something else
//! when the object is at its start may stay that deep; only going deeper counts.

use std::collections::HashMap;

use akrobat_model::Rejection;
use akrobat_model::task::ManipulatedObject;

use crate::convex::{Deepest, DepthProbe};
use crate::finding::Finding;
use crate::judge::{Geometry, Scenery};
use crate::near::{Intrusions, Near};
use crate::travel::RelativeWay;

/// Depth at the start by moving solid, obstacle and the obstacle's owner, metres.
pub type StartDepths = HashMap<(usize, usize, u32), f64>;

/// The object's links that the driven joint moves.
pub fn moving_links(object: &ManipulatedObject) -> Vec<bool> {
    let tree = &object.tree;
    (0..tree.links().len()).map(|link| tree.chain_to(link).contains(&object.active_joint)).collect()
}

struct Recorder<'a> {
    depths: &'a mut StartDepths,
    solid: usize,
    obstacle: usize,
}

impl Intrusions for Recorder<'_> {
    fn wanted(&self, _owner: u32) -> bool {
        true
    }

    fn floor_m(&self, owner: u32) -> f64 {
        self.depths.get(&(self.solid, self.obstacle, owner)).copied().unwrap_or(0.0)
    }

    fn found(&mut self, owner: u32, deepest: Deepest) {
        self.depths.insert((self.solid, self.obstacle, owner), deepest.depth_m);
    }
}

/// How deep the moving solids are in everything else at the start.
pub fn start_depths(geometry: &Geometry, start: &Scenery) -> StartDepths {
    let mut depths = StartDepths::new();
    let mut probe = DepthProbe::default();
    for (solid, (link, piece)) in geometry.moving_solids.iter().enumerate() {
        for (o, obstacle) in geometry.obstacles.iter().enumerate() {
            if geometry.is_moving_obstacle(o) {
                continue;
            }
            let frame = || start.obstacle_from_world[o].then(&start.object[*link]);
            let mut recorder = Recorder { depths: &mut depths, solid, obstacle: o };
            Near::visit(
                &mut Default::default(),
                &mut probe,
                piece,
                obstacle,
                frame,
                0.0,
                &mut recorder,
            );
        }
    }
    depths
}

struct DeeperThanAtStart<'a> {
    depths: &'a StartDepths,
    solid: usize,
    obstacle: usize,
    tolerance_m: f64,
    found: Option<(u32, f64)>,
}

impl Intrusions for DeeperThanAtStart<'_> {
    fn wanted(&self, _owner: u32) -> bool {
        true
    }

    fn floor_m(&self, owner: u32) -> f64 {
        let at_start = self.depths.get(&(self.solid, self.obstacle, owner)).copied().unwrap_or(0.0);
        at_start + self.tolerance_m
    }

    fn found(&mut self, owner: u32, deepest: Deepest) {
        self.found = Some((owner, deepest.depth_m));
    }
}

/// The first configuration in which the moving part enters something deeper than at the start.
pub fn check(geometry: &Geometry, sceneries: &[Scenery], tolerance_m: f64) -> Option<Finding> {
    let mut probe = DepthProbe::default();
    let obstacles = geometry.obstacles.len();
    let mut near: Vec<(RelativeWay, Option<Near>)> = Vec::new();
    near.resize_with(geometry.moving_solids.len() * obstacles, Default::default);
    let mut before: Option<&Scenery> = None;
    for scenery in sceneries {
        if before.is_some_and(|before| before.object == scenery.object) {
            continue;
        }
        before = Some(scenery);
        for (solid, (link, piece)) in geometry.moving_solids.iter().enumerate() {
            for (o, obstacle) in geometry.obstacles.iter().enumerate() {
                if geometry.is_moving_obstacle(o) {
                    continue;
                }
                let frame = || scenery.obstacle_from_world[o].then(&scenery.object[*link]);
                let travel = scenery.obstacle_travel[1 + link] + scenery.obstacle_travel[o];
                let mut deeper = DeeperThanAtStart {
                    depths: &geometry.start_depths,
                    solid,
                    obstacle: o,
                    tolerance_m,
                    found: None,
                };
                let memory = &mut near[solid * obstacles + o];
                Near::visit(memory, &mut probe, piece, obstacle, frame, travel, &mut deeper);
                if let Some((owner, depth_m)) = deeper.found {
                    let name = &geometry.object_link_names[*link];
                    let other = &obstacle.owners[owner as usize].label;
                    return Some(Finding::new(
                        Rejection::ObjectCollision,
                        format!(
                            "{}: object link \"{name}\" is {:.1} mm inside {other}",
                            scenery.place,
                            depth_m * 1e3
                        ),
                    ));
                }
            }
        }
    }
    None
}
