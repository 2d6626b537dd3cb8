//! What the robot may not touch: distance fields of everything that rests and of what the driven
//! joint moves.

use std::sync::Arc;

use akrobat_model::task::{ManipulatedObject, Task};
use akrobat_model::{JointKind, Part, Pose};
use nalgebra::Vector3;

use crate::config::PlannerConfig;
use crate::esdf::{Esdf, Triangles, collect_triangles};
use crate::kinematics::{Frame, Motion};
use crate::reuse::Reuse;

/// Scene classes the base stands on: kept out of the field, replaced by the plane z = 0.
const FLOOR_CLASSES: [&str; 2] = ["floor", "ground"];
/// Voxel and margin of the field that moves with the driven joint, metres.
const MOVING_VOXEL_M: f64 = 0.01;
const MOVING_MARGIN_M: f64 = 0.25;

/// The driven joint of an object, placed in the world.
#[derive(Debug, Clone)]
pub struct DrivenJoint {
    /// Joint frame at zero, in the world.
    pub world_from_joint: Frame,
    /// Unit axis in the joint frame.
    pub axis: Vector3<f64>,
    /// How it moves.
    pub motion: Motion,
}

impl DrivenJoint {
    fn new(object: &ManipulatedObject) -> Self {
        let joint = &object.tree.joints()[object.active_joint];
        let poses = object.tree.link_poses(&object.world_from_root, &object.start);
        Self {
            world_from_joint: Frame::from(&(poses[joint.parent] * joint.parent_from_joint)),
            axis: joint.axis.into_inner(),
            motion: match joint.kind {
                JointKind::Prismatic => Motion::Slide,
                _ => Motion::Turn,
            },
        }
    }

    /// World frame of the moved link at joint position `q` (rad, m).
    pub fn world_from_moved(&self, q: f64) -> Frame {
        match self.motion {
            Motion::Turn => {
                let axis = nalgebra::Unit::new_unchecked(self.axis);
                let turn = nalgebra::Rotation3::from_axis_angle(&axis, q);
                Frame {
                    rotation: self.world_from_joint.rotation * turn.matrix(),
                    translation: self.world_from_joint.translation,
                }
            }
            Motion::Slide => Frame {
                rotation: self.world_from_joint.rotation,
                translation: self.world_from_joint.transform(&(self.axis * q)),
            },
        }
    }

    /// Velocity of a world point of the moved link per unit of the joint.
    pub fn point_velocity(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let axis = self.world_from_joint.rotation * self.axis;
        match self.motion {
            Motion::Turn => axis.cross(&(point - self.world_from_joint.translation)),
            Motion::Slide => axis,
        }
    }
}

/// Distance fields of one task.
#[derive(Debug, Clone)]
pub struct World {
    /// Scene, and the object's links that the driven joint does not move. World frame.
    pub fixed: Arc<Esdf>,
    /// The object's links that the driven joint moves, in the frame of the joint's child.
    pub moving: Arc<Esdf>,
    /// The driven joint.
    pub joint: DrivenJoint,
    /// Height of the floor the base stands on.
    pub floor_z: f64,
}

impl World {
    /// Builds the fields of a task around the object's handle.
    pub fn build(task: &Task, config: &PlannerConfig) -> Self {
        Self::reusing(task, config, &Reuse::default())
    }

    /// [`Self::build`], with what is kept from other tasks.
    pub fn reusing(task: &Task, config: &PlannerConfig, reuse: &Reuse) -> Self {
        let object = &task.object;
        let start = object.tree.link_poses(&object.world_from_root, &object.start);
        let moved = moved_links(object);
        let child = object.tree.joints()[object.active_joint].child;

        let mut resting = Triangles::new();
        for body in &task.scene.bodies {
            if !FLOOR_CLASSES.contains(&body.class.as_str()) {
                for part in body.collision_parts() {
                    collect_triangles(&part.triangulate(), &body.world_from_body, &mut resting);
                }
            }
        }
        let mut moving = Triangles::new();
        for (index, link) in object.tree.links().iter().enumerate() {
            let parts = if link.collisions.is_empty() { &link.visuals } else { &link.collisions };
            let (frame, out) = if moved[index] {
                (start[child].inverse() * start[index], &mut moving)
            } else {
                (start[index], &mut resting)
            };
            for part in parts {
                collect_triangles(&part.triangulate(), &frame, out);
            }
        }

        let handle = handle_center(object);
        let half = Vector3::from(config.workspace_m) / 2.0;
        let mut low = handle - half;
        low.z = 0.0;
        let high = Vector3::new(handle.x + half.x, handle.y + half.y, 2.0 * half.z);
        let seeds = free_seeds(object, &handle, high.z);
        let world_from_child = Frame::from(&start[child]);
        Self {
            fixed: reuse.field(&resting, [low, high], config.voxel_size_m, &seeds),
            moving: moving_field(&moving, &world_from_child.inverse_transform(&handle), reuse),
            joint: DrivenJoint::new(object),
            floor_z: 0.0,
        }
    }
}

fn moving_field(triangles: &Triangles, handle: &Vector3<f64>, reuse: &Reuse) -> Arc<Esdf> {
    let corners = || triangles.iter().flatten();
    if triangles.is_empty() {
        return Arc::new(Esdf::empty(1.0));
    }
    let low = corners().fold(*handle, |a, c| a.inf(c)) - Vector3::repeat(MOVING_MARGIN_M);
    let high = corners().fold(*handle, |a, c| a.sup(c)) + Vector3::repeat(MOVING_MARGIN_M);
    reuse.field(triangles, [low, high], MOVING_VOXEL_M, &[low])
}

/// For each link of the object, whether the driven joint moves it.
pub fn moved_links(object: &ManipulatedObject) -> Vec<bool> {
    let links = 0..object.tree.links().len();
    links.map(|link| object.tree.chain_to(link).contains(&object.active_joint)).collect()
}

/// The parts that make up the handle, placed in the held link's frame: those of its visuals whose
/// names match the handle's patterns.
pub fn handle_parts(object: &ManipulatedObject) -> Vec<&Part> {
    let link = &object.tree.links()[object.handle_link];
    let parts = if link.visuals.is_empty() { &link.collisions } else { &link.visuals };
    let listed = |part: &&Part| is_handle_part(object, &part.name);
    let chosen: Vec<&Part> = parts.iter().filter(listed).collect();
    if chosen.is_empty() { parts.iter().collect() } else { chosen }
}

/// True where a part of the held link belongs to the handle: its name matches a pattern, or it is a
/// collision piece of such a part (`<part>_col<N>`).
pub fn is_handle_part(object: &ManipulatedObject, name: &str) -> bool {
    object.handle_parts.is_empty()
        || object.handle_parts.iter().any(|pattern| {
            akrobat_model::task::matches_pattern(pattern, name)
                || akrobat_model::task::matches_pattern(&format!("{pattern}_col*"), name)
        })
}

/// Centre of the handle in the world, at the object's start.
pub fn handle_center(object: &ManipulatedObject) -> Vector3<f64> {
    let poses = object.tree.link_poses(&object.world_from_root, &object.start);
    let points = handle_triangles(object);
    let corners = || points.iter().flatten();
    if points.is_empty() {
        return poses[object.handle_link].translation.vector;
    }
    let low = corners().fold(Vector3::repeat(f64::INFINITY), |a, c| a.inf(c));
    let high = corners().fold(Vector3::repeat(f64::NEG_INFINITY), |a, c| a.sup(c));
    Frame::from(&poses[object.handle_link]).transform(&((low + high) / 2.0))
}

/// Triangles of the handle in the held link's frame; only those with a corner in the handle's region.
pub fn handle_triangles(object: &ManipulatedObject) -> Triangles {
    let mut triangles = Triangles::new();
    for part in handle_parts(object) {
        collect_triangles(&part.triangulate(), &Pose::identity(), &mut triangles);
    }
    if let Some(region) = object.handle_region {
        let inside = |c: &Vector3<f64>| (0..3).all(|i| c[i] >= region[i] && c[i] <= region[i + 3]);
        triangles.retain(|t| t.iter().any(inside));
    }
    triangles
}

/// Points that are surely free: in front of the handle, in directions away from the object.
fn free_seeds(object: &ManipulatedObject, handle: &Vector3<f64>, top: f64) -> Vec<Vector3<f64>> {
    let out = outward(object, handle);
    let mut seeds: Vec<_> = [0.25, 0.4, 0.6].iter().map(|d| handle + out * *d).collect();
    seeds.iter_mut().for_each(|s| s.z = s.z.clamp(0.1, top - 0.1));
    seeds
}

/// Horizontal unit direction in which the handle moves first when the joint opens, or, where that is
/// vertical, from the object's middle to the handle.
pub fn outward(object: &ManipulatedObject, handle: &Vector3<f64>) -> Vector3<f64> {
    let joint = DrivenJoint::new(object);
    let limits = object.tree.joints()[object.active_joint].limits;
    let column = object.tree.column(object.active_joint);
    let start = column.map_or(0.0, |c| object.start[c]);
    let sign = if limits[1] - start >= start - limits[0] { 1.0 } else { -1.0 };
    let mut direction = joint.point_velocity(handle) * sign;
    direction.z = 0.0;
    if direction.norm() < 0.3 * joint.point_velocity(handle).norm() {
        direction = handle - object.world_from_root.translation.vector;
        direction.z = 0.0;
    }
    direction.try_normalize(1e-6).unwrap_or_else(Vector3::x)
}
