//! What every scene must pass: nothing intersects, everything that opens has room to and is reached by a robot.

use std::collections::VecDeque;

use akrobat_model::Pose;
use nalgebra::{Point3, Vector3};

use super::{Fault, GeneratedScene, PlacedBody, PlacedObject};
use crate::error::AssetError;
use crate::object::ObjectClass;
use crate::overlap::WorldBox;

/// Depth to which bodies may touch, metres.
const TOLERANCE_M: f64 = 0.001;
/// Cell of the grid of places where a base can stand, metres.
const CELL_M: f64 = 0.05;
/// What lies between these heights is in a base's way, metres.
const BASE_M: [f64; 2] = [0.02, 1.1];

/// A robot as the check of reach sees it: a disc that stands, and a shoulder over its middle that reaches.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reacher {
    /// Name of the robot.
    pub name: &'static str,
    /// Radius of the largest disc inside its base, metres.
    pub base_radius_m: f64,
    /// Height of its shoulder, metres.
    pub shoulder_m: f64,
    /// Distance from shoulder to tool, at most, metres.
    pub reach_m: f64,
}

/// The robots that scenes are checked for. The check is necessary, not sufficient: planning decides.
pub const REACHERS: [Reacher; 3] = [
    Reacher { name: "pillar", base_radius_m: 0.25, shoulder_m: 0.85, reach_m: 0.85 },
    Reacher { name: "summit_franka", base_radius_m: 0.33, shoulder_m: 0.85, reach_m: 0.95 },
    Reacher { name: "tiago", base_radius_m: 0.27, shoulder_m: 0.80, reach_m: 0.85 },
];

/// Checks a scene, notes who reaches what, and keeps the objects that have room to open.
pub fn check(scene: &mut GeneratedScene) -> Result<Option<Fault>, AssetError> {
    if let Some((a, b)) = intersection(&scene.bodies) {
        return Ok(Some(Fault::Intersection(a, b)));
    }
    if !work_triangle(&scene.bodies) {
        return Ok(Some(Fault::WorkTriangle));
    }
    let floors: Vec<Floor> = REACHERS.iter().map(|r| Floor::new(scene, r.base_radius_m)).collect();
    scene.free_floor = Floor::new(scene, 0.4).free_share();
    let mut objects = Vec::new();
    for mut placed in std::mem::take(&mut scene.objects) {
        let others: Vec<WorldBox> = boxes(
            scene
                .bodies
                .iter()
                .filter(|b| b.name != placed.object.description.name && b.class != "floor"),
        );
        if !opens(&placed, &others)? {
            continue;
        }
        for (reacher, floor) in REACHERS.iter().zip(&floors) {
            if reached(&placed, reacher, floor)? {
                placed.reached_by.push(reacher.name);
            }
        }
        if !placed.reached_by.is_empty() {
            objects.push(placed);
        }
    }
    scene.objects = objects;
    let missing = [ObjectClass::Refrigerator, ObjectClass::DrawerUnit, ObjectClass::BaseCabinet]
        .into_iter()
        .find(|class| !scene.objects.iter().any(|o| o.object.class == *class));
    Ok(missing.map(|class| Fault::Unreachable(class.name().into())))
}

fn boxes<'a>(bodies: impl Iterator<Item = &'a PlacedBody>) -> Vec<WorldBox> {
    bodies
        .flat_map(|body| {
            body.link.collisions.iter().map(|shape| WorldBox::new(&body.world_from_body, shape))
        })
        .collect()
}

fn apart(a: &[Vector3<f64>; 2], b: &[Vector3<f64>; 2]) -> bool {
    (0..3).any(|i| a[1][i] < b[0][i] || b[1][i] < a[0][i])
}

/// Names of two bodies that intersect.
pub fn intersection(bodies: &[PlacedBody]) -> Option<(String, String)> {
    let placed: Vec<Vec<(WorldBox, [Vector3<f64>; 2])>> = bodies
        .iter()
        .map(|body| {
            let shapes = boxes(std::iter::once(body)).into_iter();
            shapes.map(|shape| (shape, shape.bounds())).collect()
        })
        .collect();
    for (index, first) in placed.iter().enumerate() {
        for (other, second) in placed.iter().enumerate().skip(index + 1) {
            let meets = first.iter().any(|(a, a_bounds)| {
                second.iter().any(|(b, b_bounds)| {
                    !apart(a_bounds, b_bounds) && a.penetration(b) > TOLERANCE_M
                })
            });
            if meets {
                return Some((bodies[index].name.clone(), bodies[other].name.clone()));
            }
        }
    }
    None
}

/// Sides of 1.2 m at least and 7.9 m in all (NKBA), between the fronts' middles.
fn work_triangle(bodies: &[PlacedBody]) -> bool {
    let place = |class: &str| {
        let body = bodies.iter().find(|body| body.class == class)?;
        Some((body.world_from_body * Point3::new(0.3, 0.0, 0.0)).xy())
    };
    let corners = [place("refrigerator"), place("sink"), place("oven")];
    let [Some(refrigerator), Some(sink), Some(oven)] = corners else { return false };
    let sides = [refrigerator - sink, sink - oven, oven - refrigerator].map(|side| side.norm());
    sides.iter().all(|side| *side > 1.15) && sides.iter().sum::<f64>() < 7.9
}

/// The object's moving boxes, and its handle, with its joint at a position.
fn moving(placed: &PlacedObject, position: f64) -> Result<(Vec<WorldBox>, Pose), AssetError> {
    let tree = placed.object.description.tree()?;
    let mut q = tree.neutral();
    let mut moved = Vec::new();
    let handle = tree.link_index(&placed.object.handle_link)?;
    if let Some(articulation) = &placed.object.articulation {
        let joint = tree.joint_index(&articulation.joint)?;
        if let Some(column) = tree.column(joint) {
            q[column] = position;
        }
        let poses = tree.link_poses(&placed.world_from_root, &q);
        for (link, pose) in poses.iter().enumerate() {
            if tree.chain_to(link).contains(&joint) {
                let shapes = &placed.object.description.links[link].collisions;
                moved.extend(shapes.iter().map(|shape| WorldBox::new(pose, shape)));
            }
        }
    }
    let poses = tree.link_poses(&placed.world_from_root, &q);
    Ok((moved, poses[handle]))
}

/// True where nothing is in the way of the joint up to the last goal.
fn opens(placed: &PlacedObject, others: &[WorldBox]) -> Result<bool, AssetError> {
    let Some(articulation) = &placed.object.articulation else { return Ok(false) };
    let last = articulation.goals.iter().copied().fold(0.0, f64::max);
    let bounds: Vec<_> = others.iter().map(WorldBox::bounds).collect();
    for step in 1..=8 {
        let (moved, _) = moving(placed, last * f64::from(step) / 8.0)?;
        let blocked = moved.iter().any(|shape| {
            let own = shape.bounds();
            let mut near = others.iter().zip(&bounds).filter(|(_, b)| !apart(&own, b));
            near.any(|(other, _)| shape.penetration(other) > TOLERANCE_M)
        });
        if blocked {
            return Ok(false);
        }
    }
    Ok(true)
}

/// True where the base stands in reach of the handle of the closed and of the opened object, at places that a
/// free way connects.
fn reached(placed: &PlacedObject, reacher: &Reacher, floor: &Floor) -> Result<bool, AssetError> {
    let Some(articulation) = &placed.object.articulation else { return Ok(false) };
    let first = articulation.goals.first().copied().unwrap_or(0.0);
    let places = |position: f64| -> Result<Vec<usize>, AssetError> {
        let (moved, handle) = moving(placed, position)?;
        Ok(floor.standing(handle.translation.vector, reacher, &moved))
    };
    let (closed, opened) = (places(0.0)?, places(first)?);
    Ok(closed.iter().any(|component| opened.contains(component)))
}

/// Cells on which a disc can stand, and which of them a way connects.
struct Floor {
    radius: f64,
    low: [f64; 2],
    counts: [usize; 2],
    /// 0 where something is in the way, else the number of the connected part.
    component: Vec<usize>,
}

impl Floor {
    fn new(scene: &GeneratedScene, radius: f64) -> Self {
        let low = [-scene.room_m[0] / 2.0, -scene.room_m[1] / 2.0];
        let counts = [0, 1].map(|axis| (scene.room_m[axis] / CELL_M).ceil() as usize);
        let obstacles = boxes(scene.bodies.iter().filter(|body| body.class != "floor"));
        let bounds: Vec<_> = obstacles.iter().map(WorldBox::bounds).filter(in_the_way).collect();
        let mut floor = Self { radius, low, counts, component: vec![0; counts[0] * counts[1]] };
        let free: Vec<bool> =
            (0..floor.component.len()).map(|cell| floor.stands(cell, &bounds)).collect();
        let mut number = 0;
        for start in 0..free.len() {
            if free[start] && floor.component[start] == 0 {
                number += 1;
                floor.fill(start, number, &free);
            }
        }
        floor
    }

    fn fill(&mut self, start: usize, number: usize, free: &[bool]) {
        self.component[start] = number;
        let mut open = VecDeque::from([start]);
        while let Some(cell) = open.pop_front() {
            let (i, j) = (cell % self.counts[0], cell / self.counts[0]);
            let mut neighbours = Vec::with_capacity(4);
            if i > 0 {
                neighbours.push(cell - 1);
            }
            if i + 1 < self.counts[0] {
                neighbours.push(cell + 1);
            }
            if j > 0 {
                neighbours.push(cell - self.counts[0]);
            }
            if j + 1 < self.counts[1] {
                neighbours.push(cell + self.counts[0]);
            }
            for next in neighbours {
                if free[next] && self.component[next] == 0 {
                    self.component[next] = number;
                    open.push_back(next);
                }
            }
        }
    }

    fn middle(&self, cell: usize) -> [f64; 2] {
        let index = [cell % self.counts[0], cell / self.counts[0]];
        [0, 1].map(|axis| self.low[axis] + CELL_M * (index[axis] as f64 + 0.5))
    }

    fn stands(&self, cell: usize, bounds: &[[Vector3<f64>; 2]]) -> bool {
        let at = self.middle(cell);
        bounds.iter().all(|[low, high]| {
            let gap = |i: usize| (low[i] - at[i]).max(at[i] - high[i]).max(0.0);
            gap(0).hypot(gap(1)) >= self.radius
        })
    }

    /// The connected parts from which a shoulder reaches a point, the moved boxes being in the way as well.
    fn standing(&self, handle: Vector3<f64>, reacher: &Reacher, moved: &[WorldBox]) -> Vec<usize> {
        let rise = handle.z - reacher.shoulder_m;
        let level = reacher.reach_m * reacher.reach_m - rise * rise;
        if level <= 0.0 {
            return Vec::new();
        }
        let bounds: Vec<_> = moved.iter().map(WorldBox::bounds).filter(in_the_way).collect();
        let mut parts: Vec<usize> = (0..self.component.len())
            .filter(|&cell| self.component[cell] > 0)
            .filter(|&cell| {
                let [x, y] = self.middle(cell);
                (x - handle.x).hypot(y - handle.y) < level.sqrt() && self.stands(cell, &bounds)
            })
            .map(|cell| self.component[cell])
            .collect();
        parts.sort_unstable();
        parts.dedup();
        parts
    }

    fn free_share(&self) -> f64 {
        let free = self.component.iter().filter(|&&number| number > 0).count();
        free as f64 / self.component.len().max(1) as f64
    }
}

fn in_the_way([low, high]: &[Vector3<f64>; 2]) -> bool {
    low.z < BASE_M[1] && high.z > BASE_M[0]
}
