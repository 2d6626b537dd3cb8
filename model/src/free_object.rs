//! Objects that no joint holds: virtual joints give them their place in the world.
//!
//! A rigid object gets six (x, y, z, yaw, pitch, roll), one that slides on the floor three (x, y, yaw). They
//! are columns of trajectories like any other joint of an object.

use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::task::ObjectKind;
use crate::{Joint, JointKind, KinematicTree, Link, ModelError, Pose};

/// Names of the virtual joints of a rigid object.
pub const RIGID_JOINTS: [&str; 6] =
    ["object_x", "object_y", "object_z", "object_yaw", "object_pitch", "object_roll"];
/// Names of the virtual joints of an object that moves in the plane.
pub const PLANAR_JOINTS: [&str; 3] = ["object_x", "object_y", "object_yaw"];
/// Reach of the virtual slides, metres.
const REACH_M: f64 = 50.0;

/// Names of the virtual joints of a kind of object; none where its own joint is driven.
pub fn joint_names(kind: ObjectKind) -> &'static [&'static str] {
    match kind {
        ObjectKind::Articulated => &[],
        ObjectKind::Rigid => &RIGID_JOINTS,
        ObjectKind::Planar => &PLANAR_JOINTS,
    }
}

/// Positions of the virtual joints that put an object's root at `pose` (m, rad).
pub fn positions(kind: ObjectKind, pose: &Pose) -> Vec<f64> {
    let t = pose.translation.vector;
    let (roll, pitch, yaw) = pose.rotation.euler_angles();
    match kind {
        ObjectKind::Articulated => Vec::new(),
        ObjectKind::Rigid => vec![t.x, t.y, t.z, yaw, pitch, roll],
        ObjectKind::Planar => vec![t.x, t.y, yaw],
    }
}

/// The link that is the root of the object's own description, in a tree with virtual joints.
pub fn body_link(tree: &KinematicTree) -> usize {
    let last = ["object_body", "object_roll"];
    let joint = last.iter().find_map(|name| tree.joint_index(name).ok());
    joint.map_or(tree.root(), |joint| tree.joints()[joint].child)
}

/// The height and tilt that planar motion keeps: the pose of an object's root without x, y and yaw.
pub fn upright(pose: &Pose) -> Pose {
    let (_, _, yaw) = pose.rotation.euler_angles();
    let back = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -yaw);
    let height = Translation3::new(0.0, 0.0, pose.translation.z);
    Pose::from_parts(height, back * pose.rotation)
}

/// Puts an object's tree, whose root is at `pose`, below the virtual joints of its kind. Links and joints
/// keep their indices.
///
/// # Errors
/// Where the tree has a joint of such a name.
pub fn with_virtual_joints(
    tree: KinematicTree,
    kind: ObjectKind,
    pose: &Pose,
) -> Result<KinematicTree, ModelError> {
    let names = joint_names(kind);
    let root = tree.root();
    let (mut links, mut joints) = (tree.links().to_vec(), tree.joints().to_vec());
    let first = links.len();
    // Below the world one link for each joint; the last joint carries the object itself.
    let carriers = if kind == ObjectKind::Planar { names.len() } else { names.len() - 1 };
    links.push(Link { name: "object_world".into(), ..Link::default() });
    links.extend(
        names[..carriers]
            .iter()
            .map(|name| Link { name: format!("{name}_link"), ..Link::default() }),
    );
    let child = |index: usize| if index < carriers { first + 1 + index } else { root };
    let added = names.iter().enumerate().map(|(index, &name)| {
        let (kind, axis, reach) = match name {
            "object_x" => (JointKind::Prismatic, Vector3::x_axis(), REACH_M),
            "object_y" => (JointKind::Prismatic, Vector3::y_axis(), REACH_M),
            "object_z" => (JointKind::Prismatic, Vector3::z_axis(), REACH_M),
            "object_pitch" => (JointKind::Revolute, Vector3::y_axis(), std::f64::consts::PI),
            "object_roll" => (JointKind::Revolute, Vector3::x_axis(), std::f64::consts::TAU),
            _ => (JointKind::Revolute, Vector3::z_axis(), 2.0 * std::f64::consts::TAU),
        };
        let parent = first + index;
        virtual_joint(name, kind, [parent, child(index)], Pose::identity(), axis, reach)
    });
    joints.extend(added);
    if kind == ObjectKind::Planar {
        let ends = [first + carriers, root];
        let axis = Vector3::z_axis();
        joints.push(virtual_joint("object_body", JointKind::Fixed, ends, upright(pose), axis, 0.0));
    }
    KinematicTree::new(tree.name, links, joints)
}

fn virtual_joint(
    name: &str,
    kind: JointKind,
    [parent, child]: [usize; 2],
    parent_from_joint: Pose,
    axis: nalgebra::Unit<Vector3<f64>>,
    reach: f64,
) -> Joint {
    Joint {
        name: name.into(),
        kind,
        parent,
        child,
        parent_from_joint,
        axis,
        limits: [-reach, reach],
        velocity_limit: None,
        effort_limit: None,
        damping: 0.0,
        friction: 0.0,
        mimic: None,
    }
}

/// Angle by which `b` is turned against `a`, with the axis of `up` (in `a`'s object frame) as the only one
/// that does not count: how far a standing object has been tilted, radians.
pub fn tilt(a: &Pose, b: &Pose) -> f64 {
    let up = a.rotation.inverse() * Vector3::z();
    let turned: Vector3<f64> = Rotation3::from(b.rotation) * up;
    turned.z.clamp(-1.0, 1.0).acos()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::from_xyz_rpy;

    fn lone_link() -> KinematicTree {
        let link = Link { name: "mug".into(), ..Link::default() };
        KinematicTree::new("mug".into(), vec![link], Vec::new()).unwrap()
    }

    #[test]
    fn virtual_joints_put_the_object_where_its_pose_says() {
        for kind in [ObjectKind::Rigid, ObjectKind::Planar] {
            let tilt = if kind == ObjectKind::Rigid { 0.7 } else { 0.0 };
            let start = from_xyz_rpy([1.0, -2.0, 0.4], [1.2, tilt, -2.0]);
            let goal = from_xyz_rpy([0.5, 3.0, 0.4], [1.2, tilt, 2.5]);
            let tree = with_virtual_joints(lone_link(), kind, &start).unwrap();
            for pose in [start, goal] {
                let q = positions(kind, &pose);
                let body = tree.link_poses(&Pose::identity(), &q)[body_link(&tree)];
                assert!((body.inv_mul(&pose)).translation.vector.norm() < 1e-12, "{kind:?}");
                assert!((body.inv_mul(&pose)).rotation.angle() < 1e-7, "{kind:?}");
            }
        }
    }

    #[test]
    fn turning_about_the_vertical_is_no_tilt() {
        let a = from_xyz_rpy([0.0; 3], [1.2, 0.1, 0.3]);
        let turned = from_xyz_rpy([0.0; 3], [0.0, 0.0, 1.0]) * a;
        let tipped = from_xyz_rpy([0.0; 3], [0.2, 0.0, 0.0]) * a;
        assert!(tilt(&a, &turned) < 1e-7);
        assert!((tilt(&a, &tipped) - 0.2).abs() < 1e-9);
    }
}
