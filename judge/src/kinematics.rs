//! Forward kinematics of the judge: rotation matrices by Rodrigues' formula, each link resolved from
//! its own joint upwards. It shares no code with the tree's own forward kinematics, so that the two
//! can disagree.

use akrobat_model::{JointKind, KinematicTree, Pose};
use parry3d_f64::math::{Matrix, Vector};

/// A rigid transform: `a_from_b.point(p_in_b) = p_in_a`, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Rotation matrix.
    pub rotation: Matrix,
    /// Translation, metres.
    pub translation: Vector,
}

impl Frame {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self { rotation: Matrix::IDENTITY, translation: Vector::ZERO };

    /// The transform of a pose.
    pub fn from_pose(pose: &Pose) -> Self {
        let q = &pose.rotation;
        let (w, x, y, z) = (q.w, q.i, q.j, q.k);
        let rotation = Matrix::from_cols(
            Vector::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
            Vector::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
            Vector::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
        );
        let t = &pose.translation;
        Self { rotation, translation: Vector::new(t.x, t.y, t.z) }
    }

    /// `a_from_b.then(b_from_c) = a_from_c`.
    pub fn then(&self, other: &Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            translation: self.rotation * other.translation + self.translation,
        }
    }

    /// `b_from_a` for `a_from_b`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.transpose();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// A point of the inner frame in the outer one.
    pub fn point(&self, point: Vector) -> Vector {
        self.rotation * point + self.translation
    }

    /// Angle of the rotation, radians in `0..=pi`. Unlike the arc cosine of the trace it is exact for
    /// small angles.
    pub fn angle(&self) -> f64 {
        let m = &self.rotation;
        let twice_sine =
            Vector::new(m.y_axis.z - m.z_axis.y, m.z_axis.x - m.x_axis.z, m.x_axis.y - m.y_axis.x)
                .length();
        twice_sine.atan2(m.x_axis.x + m.y_axis.y + m.z_axis.z - 1.0)
    }
}

/// Rotation by `angle` radians about the unit vector `axis` (Rodrigues).
fn rodrigues(axis: Vector, angle: f64) -> Matrix {
    let k = Matrix::from_cols(
        Vector::new(0.0, axis.z, -axis.y),
        Vector::new(-axis.z, 0.0, axis.x),
        Vector::new(axis.y, -axis.x, 0.0),
    );
    Matrix::IDENTITY + k * angle.sin() + k * k * (1.0 - angle.cos())
}

/// Where a joint takes its position from: `multiplier * q[column] + offset`.
#[derive(Debug, Clone, Copy)]
struct Drive {
    column: usize,
    multiplier: f64,
    offset: f64,
}

#[derive(Debug, Clone)]
struct Mount {
    parent: usize,
    parent_from_joint: Frame,
    axis: Vector,
    slides: bool,
    drive: Option<Drive>,
}

/// A tree prepared for forward kinematics.
#[derive(Debug, Clone)]
pub struct Kinematics {
    /// For each link, how it hangs on its parent; `None` for the root.
    mounts: Vec<Option<Mount>>,
    world_from_root: Frame,
}

impl Kinematics {
    /// Reads the joints of `tree`, whose root stands at `world_from_root`.
    pub fn new(tree: &KinematicTree, world_from_root: &Pose) -> Self {
        let mut mounts: Vec<Option<Mount>> = vec![None; tree.links().len()];
        for (index, joint) in tree.joints().iter().enumerate() {
            let axis = joint.axis.into_inner();
            mounts[joint.child] = Some(Mount {
                parent: joint.parent,
                parent_from_joint: Frame::from_pose(&joint.parent_from_joint),
                axis: Vector::new(axis.x, axis.y, axis.z),
                slides: joint.kind == JointKind::Prismatic,
                drive: drive(tree, index),
            });
        }
        Self { mounts, world_from_root: Frame::from_pose(world_from_root) }
    }

    /// World frame of every link at configuration `q` (rad, m).
    pub fn link_frames(&self, q: &[f64]) -> Vec<Frame> {
        let mut known = vec![None; self.mounts.len()];
        (0..self.mounts.len()).map(|link| self.resolve(link, q, &mut known)).collect()
    }

    fn resolve(&self, link: usize, q: &[f64], known: &mut [Option<Frame>]) -> Frame {
        if let Some(frame) = known[link] {
            return frame;
        }
        let frame = match &self.mounts[link] {
            None => self.world_from_root,
            Some(mount) => {
                let position = mount.drive.map_or(0.0, |d| d.multiplier * q[d.column] + d.offset);
                let motion = match (&mount.drive, mount.slides) {
                    (None, _) => Frame::IDENTITY,
                    (Some(_), true) => {
                        Frame { rotation: Matrix::IDENTITY, translation: mount.axis * position }
                    }
                    (Some(_), false) => Frame {
                        rotation: rodrigues(mount.axis, position),
                        translation: Vector::ZERO,
                    },
                };
                let parent = self.resolve(mount.parent, q, known);
                parent.then(&mount.parent_from_joint).then(&motion)
            }
        };
        known[link] = Some(frame);
        frame
    }
}

fn drive(tree: &KinematicTree, joint: usize) -> Option<Drive> {
    let description = &tree.joints()[joint];
    if description.kind == JointKind::Fixed {
        return None;
    }
    let (source, multiplier, offset) = match &description.mimic {
        Some(mimic) => (mimic.joint, mimic.multiplier, mimic.offset),
        None => (joint, 1.0, 0.0),
    };
    let column = tree.dof_joints().iter().position(|&j| j == source)?;
    Some(Drive { column, multiplier, offset })
}

#[cfg(test)]
mod tests {
    use akrobat_model::tree::Mimic;
    use akrobat_model::{Joint, Link, pose};
    use nalgebra::{Unit, Vector3};
    use proptest::prelude::*;

    use super::*;

    /// A branched tree with every kind of joint, a mimic and oblique axes.
    fn tree() -> KinematicTree {
        let link = |name: &str| Link { name: name.into(), ..Link::default() };
        let joint = |name: &str, kind, parent, child, xyz, rpy, axis: [f64; 3]| Joint {
            name: name.into(),
            kind,
            parent,
            child,
            parent_from_joint: pose::from_xyz_rpy(xyz, rpy),
            axis: Unit::new_normalize(Vector3::from(axis)),
            limits: [-3.0, 3.0],
            velocity_limit: None,
            effort_limit: None,
            damping: 0.0,
            friction: 0.0,
            mimic: None,
        };
        let mut joints = vec![
            // The parent is listed after the child: the order of the file must not matter.
            joint(
                "c",
                JointKind::Revolute,
                2,
                3,
                [0.1, 0.2, 0.3],
                [0.3, -0.2, 1.0],
                [1.0, 2.0, 3.0],
            ),
            joint(
                "a",
                JointKind::Prismatic,
                0,
                1,
                [0.0, 0.1, 0.0],
                [0.0, 0.5, 0.0],
                [0.0, 1.0, 1.0],
            ),
            joint(
                "b",
                JointKind::Continuous,
                1,
                2,
                [0.4, 0.0, 0.0],
                [1.0, 0.0, 0.0],
                [0.0, 0.0, 1.0],
            ),
            joint(
                "fixed",
                JointKind::Fixed,
                2,
                4,
                [0.0, 0.0, 0.5],
                [0.0, 0.0, 2.0],
                [1.0, 0.0, 0.0],
            ),
            joint(
                "m",
                JointKind::Prismatic,
                4,
                5,
                [0.0, 0.3, 0.0],
                [0.1, 0.1, 0.1],
                [1.0, 0.0, 0.0],
            ),
        ];
        joints[4].mimic = Some(Mimic { joint: 0, multiplier: -0.5, offset: 0.2 });
        let links = ["l0", "l1", "l2", "l3", "l4", "l5"].map(link).to_vec();
        KinematicTree::new("tree".into(), links, joints).unwrap()
    }

    fn largest_difference(frames: &[Frame], poses: &[Pose]) -> f64 {
        let differences = frames.iter().zip(poses).map(|(frame, pose)| {
            let off = frame.inverse().then(&Frame::from_pose(pose));
            off.translation.length().max(off.angle())
        });
        differences.fold(0.0, f64::max)
    }

    proptest! {
        #[test]
        fn agrees_with_the_trees_own_forward_kinematics(q in prop::array::uniform3(-3.0..3.0f64)) {
            let tree = tree();
            let world_from_root = pose::from_xyz_rpy([1.0, -2.0, 0.5], [0.2, 0.4, -1.0]);
            let frames = Kinematics::new(&tree, &world_from_root).link_frames(&q);
            prop_assert!(largest_difference(&frames, &tree.link_poses(&world_from_root, &q)) < 1e-9);
            // Negative control: a configuration that differs by a hundredth is noticed.
            let other = [q[0], q[1], q[2] + 0.01];
            prop_assert!(largest_difference(&frames, &tree.link_poses(&world_from_root, &other)) > 1e-3);
        }

        #[test]
        fn angle_of_a_rotation(angle in 1e-7..3.1f64, axis in prop::array::uniform3(0.1..1.0f64)) {
            let rotation = rodrigues(Vector::from(axis).normalize(), angle);
            let frame = Frame { rotation, translation: Vector::ZERO };
            prop_assert!((frame.angle() - angle).abs() < 1e-9);
        }
    }
}
