//! Uniform scaling of kinematic trees.

use std::collections::HashMap;
use std::sync::Arc;

use super::{Inertial, Joint, JointKind, KinematicTree, Link, Mimic};
use crate::{Part, Pose, Shape, TriMesh, mesh_io};

impl KinematicTree {
    /// The tree at `factor` times its size, of the same material: lengths grow with the factor, masses
    /// with its third and moments of inertia with its fifth power. Joint origins, the positions and
    /// speeds of prismatic joints and all geometry are lengths; efforts, damping and friction stay.
    pub fn scaled(&self, factor: f64) -> Self {
        let mut scaled = self.clone();
        let mut meshes = ScaledMeshes { factor, scaled: HashMap::new() };
        for link in &mut scaled.links {
            scale_link(link, factor, &mut meshes);
        }
        for (joint, original) in scaled.joints.iter_mut().zip(&self.joints) {
            let followed = original.mimic.as_ref().map(|mimic| self.joints[mimic.joint].kind);
            scale_joint(joint, factor, followed);
        }
        scaled
    }
}

/// Meshes that several parts share are scaled once.
struct ScaledMeshes {
    factor: f64,
    scaled: HashMap<*const Vec<TriMesh>, Arc<Vec<TriMesh>>>,
}

impl ScaledMeshes {
    fn get(&mut self, meshes: &Arc<Vec<TriMesh>>) -> Arc<Vec<TriMesh>> {
        let scale = [self.factor; 3];
        let entry = self.scaled.entry(Arc::as_ptr(meshes));
        entry.or_insert_with(|| Arc::new(mesh_io::scaled(meshes, scale))).clone()
    }
}

fn scale_link(link: &mut Link, factor: f64, meshes: &mut ScaledMeshes) {
    for part in link.visuals.iter_mut().chain(&mut link.collisions) {
        scale_part(part, factor, meshes);
    }
    if let Some(Inertial { mass, link_from_inertia, inertia }) = &mut link.inertial {
        *mass *= factor.powi(3);
        scale_pose(link_from_inertia, factor);
        inertia.iter_mut().for_each(|moment| *moment *= factor.powi(5));
    }
}

fn scale_part(part: &mut Part, factor: f64, cache: &mut ScaledMeshes) {
    scale_pose(&mut part.link_from_part, factor);
    match &mut part.shape {
        Shape::Box { size } => size.iter_mut().for_each(|edge| *edge *= factor),
        Shape::Cylinder { radius, length } => {
            *radius *= factor;
            *length *= factor;
        }
        Shape::Sphere { radius } => *radius *= factor,
        Shape::Mesh { meshes, .. } => *meshes = cache.get(meshes),
    }
}

/// `followed` is the kind of the joint that a mimic joint follows.
fn scale_joint(joint: &mut Joint, factor: f64, followed: Option<JointKind>) {
    scale_pose(&mut joint.parent_from_joint, factor);
    let slides = |kind| kind == JointKind::Prismatic;
    let own = if slides(joint.kind) { factor } else { 1.0 };
    joint.limits = joint.limits.map(|limit| limit * own);
    joint.velocity_limit = joint.velocity_limit.map(|speed| speed * own);
    if let (Some(Mimic { multiplier, offset, .. }), Some(followed)) = (&mut joint.mimic, followed) {
        *multiplier *= own / if slides(followed) { factor } else { 1.0 };
        *offset *= own;
    }
}

fn scale_pose(pose: &mut Pose, factor: f64) {
    pose.translation.vector *= factor;
}
