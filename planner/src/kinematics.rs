//! A kinematic tree compiled for one set of variables.
//!
//! Fixed and locked joints are folded into offsets, so that forward kinematics visits one *node* per
//! variable, and every link hangs rigidly from a node.

use akrobat_model::{JointKind, KinematicTree, Pose};
use nalgebra::{Matrix3, SVector, Vector3};

/// Largest number of variables of one problem: base 3, torso and arm up to 9, object 1, spare.
pub const MAX_VARIABLES: usize = 16;

/// A configuration of the compiled tree: one value (rad, m) for each variable.
pub type Variables = [f64];

/// A rigid transform as rotation matrix and translation: cheaper to apply than a quaternion.
#[derive(Debug, Clone, Copy)]
pub struct Frame {
    /// Rotation.
    pub rotation: Matrix3<f64>,
    /// Translation, metres.
    pub translation: Vector3<f64>,
}

impl Frame {
    /// The identity.
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    /// `self * point`.
    #[inline]
    pub fn transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// `inverse(self) * point`.
    #[inline]
    pub fn inverse_transform(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation.tr_mul(&(point - self.translation))
    }

    /// `self * other`.
    #[inline]
    pub fn compose(&self, other: &Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            translation: self.transform(&other.translation),
        }
    }
}

impl From<&Pose> for Frame {
    fn from(pose: &Pose) -> Self {
        Self {
            rotation: pose.rotation.to_rotation_matrix().into_inner(),
            translation: pose.translation.vector,
        }
    }
}

/// How a variable moves its node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    /// About the axis, radians.
    Turn,
    /// Along the axis, metres.
    Slide,
}

/// One variable joint.
#[derive(Debug, Clone)]
pub struct Node {
    /// The node it moves with; `None` for the root.
    pub parent: Option<usize>,
    /// Joint frame at zero, in the parent node's frame (or the world).
    pub parent_from_joint: Frame,
    /// Unit axis in the joint frame.
    pub axis: Vector3<f64>,
    /// How it moves.
    pub motion: Motion,
    /// Bit i is set where variable i moves this node (itself included).
    pub moved_by: u32,
}

/// Where a link hangs.
#[derive(Debug, Clone)]
pub struct Attachment {
    /// The node, or `None` where the link does not move at all.
    pub node: Option<usize>,
    /// The link in the node's frame (or in the world).
    pub node_from_link: Pose,
}

/// A compiled tree. Node i is moved by variable i and its ancestors.
#[derive(Debug, Clone)]
pub struct Kinematics {
    nodes: Vec<Node>,
    attachments: Vec<Attachment>,
    lower: Vec<f64>,
    upper: Vec<f64>,
}

/// World frames of all nodes, and their axes in the world.
#[derive(Debug, Clone)]
pub struct NodeFrames {
    /// `world_from_node` of each node; from [`Kinematics::world_node`] on, the world's own.
    pub frames: [Frame; MAX_VARIABLES + 1],
    /// World-frame axis of each node's joint.
    pub axes: [Vector3<f64>; MAX_VARIABLES],
}

impl Kinematics {
    /// Compiles `tree`, rooted at `world_from_root`. `variables` are the joints that move, in the order
    /// of the configuration, parents first; all others stay where `rest` (a configuration of the tree)
    /// has them.
    ///
    /// # Panics
    /// If a variable's ancestor comes after it, or there are more than [`MAX_VARIABLES`].
    pub fn compile(
        tree: &KinematicTree,
        world_from_root: &Pose,
        variables: &[usize],
        rest: &[f64],
    ) -> Self {
        assert!(variables.len() <= MAX_VARIABLES, "too many variables");
        let root = Attachment { node: None, node_from_link: *world_from_root };
        let mut attachments = vec![root; tree.links().len()];
        let mut nodes: Vec<Option<Node>> = vec![None; variables.len()];
        for &index in tree.order() {
            let joint = &tree.joints()[index];
            let parent = attachments[joint.parent].clone();
            attachments[joint.child] = match variables.iter().position(|&v| v == index) {
                None => Attachment {
                    node: parent.node,
                    node_from_link: parent.node_from_link
                        * joint.parent_from_child(tree.joint_position(index, rest)),
                },
                Some(variable) => {
                    let inherited = parent.node.map_or(0, |p| {
                        nodes[p].as_ref().map(|n| n.moved_by).expect("parents are compiled first")
                    });
                    nodes[variable] = Some(Node {
                        parent: parent.node,
                        parent_from_joint: Frame::from(
                            &(parent.node_from_link * joint.parent_from_joint),
                        ),
                        axis: joint.axis.into_inner(),
                        motion: match joint.kind {
                            JointKind::Prismatic => Motion::Slide,
                            _ => Motion::Turn,
                        },
                        moved_by: inherited | 1 << variable,
                    });
                    Attachment { node: Some(variable), node_from_link: Pose::identity() }
                }
            };
        }
        let limit =
            |side: usize| variables.iter().map(|&v| tree.joints()[v].limits[side]).collect();
        let nodes: Vec<Node> =
            nodes.into_iter().map(|n| n.expect("every variable is a joint")).collect();
        assert!(
            nodes.iter().enumerate().all(|(i, n)| n.parent.is_none_or(|p| p < i)),
            "parents come before children"
        );
        Self { nodes, attachments, lower: limit(0), upper: limit(1) }
    }

    /// Number of variables.
    pub fn dof(&self) -> usize {
        self.nodes.len()
    }

    /// The node that stands for the world: what hangs from it rests.
    pub fn world_node(&self) -> usize {
        self.nodes.len()
    }

    /// Bit i is set where variable i moves a node.
    pub fn moved_by(&self, node: usize) -> u32 {
        self.nodes.get(node).map_or(0, |n| n.moved_by)
    }

    /// The nodes.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Where each link of the tree hangs.
    pub fn attachment(&self, link: usize) -> &Attachment {
        &self.attachments[link]
    }

    /// Lower position limits.
    pub fn lower(&self) -> &[f64] {
        &self.lower
    }

    /// Upper position limits.
    pub fn upper(&self) -> &[f64] {
        &self.upper
    }

    /// Draws the position limits of the first `count` variables in by `margin` (rad, m), so that what is
    /// interpolated between configurations within them stays within the true ones.
    pub fn draw_in_limits(&mut self, count: usize, margin: f64) {
        for i in 0..count {
            if self.upper[i] - self.lower[i] > 4.0 * margin {
                self.lower[i] += margin;
                self.upper[i] -= margin;
            }
        }
    }

    /// Brings every variable within its limits.
    pub fn clamp(&self, x: &mut Variables) {
        for (value, (low, high)) in x.iter_mut().zip(self.lower.iter().zip(&self.upper)) {
            *value = value.clamp(*low, *high);
        }
    }

    /// True where every variable is within its limits, `margin` (rad, m) inside them.
    pub fn within_limits(&self, x: &Variables, margin: f64) -> bool {
        let limits = self.lower.iter().zip(&self.upper);
        x.iter().zip(limits).all(|(v, (low, high))| *v >= low + margin && *v <= high - margin)
    }

    /// World frames of all nodes at `x`.
    pub fn forward(&self, x: &Variables) -> NodeFrames {
        let mut out = NodeFrames {
            frames: [Frame::identity(); MAX_VARIABLES + 1],
            axes: [Vector3::zeros(); MAX_VARIABLES],
        };
        for (index, node) in self.nodes.iter().enumerate() {
            let joint = match node.parent {
                Some(parent) => out.frames[parent].compose(&node.parent_from_joint),
                None => node.parent_from_joint,
            };
            let axis = joint.rotation * node.axis;
            out.axes[index] = axis;
            out.frames[index] = match node.motion {
                Motion::Turn => Frame {
                    rotation: joint.rotation * rotation_about(&node.axis, x[index]),
                    translation: joint.translation,
                },
                Motion::Slide => Frame {
                    rotation: joint.rotation,
                    translation: joint.translation + axis * x[index],
                },
            };
        }
        out
    }

    /// World frame of a link.
    pub fn link_frame(&self, frames: &NodeFrames, link: usize) -> Frame {
        let attachment = &self.attachments[link];
        let offset = Frame::from(&attachment.node_from_link);
        attachment.node.map_or(offset, |node| frames.frames[node].compose(&offset))
    }

    /// Column of the geometric Jacobian of a world point that moves with `node`, for one variable:
    /// linear velocity per unit of the variable.
    #[inline]
    pub fn point_column(
        &self,
        frames: &NodeFrames,
        variable: usize,
        point: &Vector3<f64>,
    ) -> Vector3<f64> {
        match self.nodes[variable].motion {
            Motion::Turn => {
                frames.axes[variable].cross(&(point - frames.frames[variable].translation))
            }
            Motion::Slide => frames.axes[variable],
        }
    }

    /// Gradient of a scalar whose world gradient at a point moving with `node` is `gradient`, added
    /// to `out`.
    #[inline]
    pub fn add_point_gradient(
        &self,
        frames: &NodeFrames,
        node: usize,
        point: &Vector3<f64>,
        gradient: &Vector3<f64>,
        out: &mut SVector<f64, MAX_VARIABLES>,
    ) {
        let mut moved_by = self.moved_by(node);
        while moved_by != 0 {
            let variable = moved_by.trailing_zeros() as usize;
            moved_by &= moved_by - 1;
            out[variable] += gradient.dot(&self.point_column(frames, variable, point));
        }
    }

    /// Geometric Jacobian `[linear; angular]` (world axes) of a frame with origin `point` moving with
    /// `node`; columns beyond [`Kinematics::dof`] are zero.
    pub fn jacobian(
        &self,
        frames: &NodeFrames,
        node: usize,
        point: &Vector3<f64>,
    ) -> nalgebra::SMatrix<f64, 6, MAX_VARIABLES> {
        let mut out = nalgebra::SMatrix::<f64, 6, MAX_VARIABLES>::zeros();
        for variable in 0..self.dof() {
            if self.nodes[node].moved_by & (1 << variable) == 0 {
                continue;
            }
            let linear = self.point_column(frames, variable, point);
            out.fixed_view_mut::<3, 1>(0, variable).copy_from(&linear);
            if self.nodes[variable].motion == Motion::Turn {
                out.fixed_view_mut::<3, 1>(3, variable).copy_from(&frames.axes[variable]);
            }
        }
        out
    }
}

/// Rodrigues' formula (Murray, Li, Sastry, *A Mathematical Introduction to Robotic Manipulation*,
/// 1994, eq. 2.14).
#[inline]
fn rotation_about(axis: &Vector3<f64>, angle: f64) -> Matrix3<f64> {
    let (sin, cos) = angle.sin_cos();
    let k = 1.0 - cos;
    let (x, y, z) = (axis.x, axis.y, axis.z);
    Matrix3::new(
        cos + x * x * k,
        x * y * k - z * sin,
        x * z * k + y * sin,
        y * x * k + z * sin,
        cos + y * y * k,
        y * z * k - x * sin,
        z * x * k - y * sin,
        z * y * k + x * sin,
        cos + z * z * k,
    )
}

/// Rotation vector (axis times angle) of a rotation matrix, well conditioned up to pi.
pub fn rotation_log(rotation: &Matrix3<f64>) -> Vector3<f64> {
    let vee = Vector3::new(
        rotation[(2, 1)] - rotation[(1, 2)],
        rotation[(0, 2)] - rotation[(2, 0)],
        rotation[(1, 0)] - rotation[(0, 1)],
    );
    let sin2 = vee.norm();
    let angle = f64::atan2(sin2, rotation.trace() - 1.0);
    if sin2 > 1e-9 {
        return vee * (angle / sin2);
    }
    if angle < 1.0 {
        return vee * 0.5;
    }
    // A half turn: the axis is the column of (R + I) with the largest diagonal.
    let symmetric = rotation + Matrix3::identity();
    let column =
        (0..3).max_by(|&a, &b| symmetric[(a, a)].total_cmp(&symmetric[(b, b)])).unwrap_or(0);
    symmetric.column(column).normalize() * angle
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, UnitQuaternion};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn log_inverts_the_exponential(v in prop::array::uniform3(-1.7..1.7f64)) {
            let v = Vector3::from(v);
            let back = rotation_log(Rotation3::new(v).matrix());
            prop_assert!((back - v).norm() < 1e-8, "{v} {back}");
        }

        #[test]
        fn rodrigues_agrees_with_quaternions(v in prop::array::uniform3(-1.0..1.0f64), angle in -7.0..7.0f64) {
            let Some(axis) = nalgebra::Unit::try_new(Vector3::from(v), 1e-3) else { return Ok(()) };
            let ours = rotation_about(&axis, angle);
            let theirs = UnitQuaternion::from_axis_angle(&axis, angle).to_rotation_matrix();
            prop_assert!((ours - theirs.matrix()).norm() < 1e-12);
        }
    }
}
