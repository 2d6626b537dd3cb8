//! Forward kinematics of eight configurations at once.

use nalgebra::{Matrix3, Vector3};

use super::obstacles::Points;
use crate::kinematics::{Frame, Kinematics, MAX_VARIABLES, Motion};
use akrobat_simd::{Lanes, Row, sin_cos, xyz};

/// A configuration in single precision; entries beyond the robot's variables are zero.
pub type Config = [f32; MAX_VARIABLES];

/// A joint whose axis has been turned to z.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CompiledJoint {
    /// Slot of the parent's frame.
    pub(crate) parent: usize,
    /// `parent_from_joint`: columns of the rotation, then the translation.
    pub(crate) columns: [[f32; 3]; 4],
    pub(crate) motion: Motion,
}

/// World frames of eight configurations: columns x, y, z and translation.
pub(super) type FrameRows = [[Row; 3]; 4];

/// Compiles the joints of a tree, and tells by which rotation the axes of each node's frame have been turned.
pub(crate) fn compile(kinematics: &Kinematics) -> (Vec<CompiledJoint>, Vec<Matrix3<f64>>) {
    let turned: Vec<Matrix3<f64>> =
        kinematics.nodes().iter().map(|node| turn_z_to(&node.axis)).collect();
    let joints = kinematics.nodes().iter().zip(&turned).map(|(node, turn)| {
        let own = Frame { rotation: *turn, translation: Vector3::zeros() };
        let mut frame = node.parent_from_joint.compose(&own);
        if let Some(parent) = node.parent {
            let back = turned[parent].transpose();
            let back = Frame { rotation: back, translation: Vector3::zeros() };
            frame = back.compose(&frame);
        }
        let column = |v: Vector3<f64>| [v.x as f32, v.y as f32, v.z as f32];
        let rotation = |i: usize| column(frame.rotation.column(i).into_owned());
        CompiledJoint {
            parent: node.parent.unwrap_or(kinematics.dof()),
            columns: [rotation(0), rotation(1), rotation(2), column(frame.translation)],
            motion: node.motion,
        }
    });
    (joints.collect(), turned)
}

impl CompiledJoint {
    /// Moves the joint's frame to `q` and writes it to `out`.
    #[inline(always)]
    pub(super) fn place<L: Lanes>(&self, parent: &FrameRows, q: L, out: &mut FrameRows) {
        let x = turned::<L>(parent, &self.columns[0]);
        let y = turned::<L>(parent, &self.columns[1]);
        let z = turned::<L>(parent, &self.columns[2]);
        let at = place::<L>(parent, &self.columns[3]);
        store(z, &mut out[2]);
        match self.motion {
            Motion::Turn => {
                let (sin, cos) = sin_cos(q);
                store(xyz!(i => x[i] * cos + y[i] * sin), &mut out[0]);
                store(xyz!(i => y[i] * cos - x[i] * sin), &mut out[1]);
                store(at, &mut out[3]);
            }
            Motion::Slide => {
                store(x, &mut out[0]);
                store(y, &mut out[1]);
                store(xyz!(i => at[i] + z[i] * q), &mut out[3]);
            }
        }
    }
}

#[inline(always)]
pub(super) fn load<L: Lanes>(rows: &[Row; 3]) -> Points<L> {
    xyz!(i => L::load(&rows[i]))
}

#[inline(always)]
pub(super) fn store<L: Lanes>(points: Points<L>, rows: &mut [Row; 3]) {
    points[0].store(&mut rows[0]);
    points[1].store(&mut rows[1]);
    points[2].store(&mut rows[2]);
}

/// World components of a direction of a frame.
#[inline(always)]
pub(super) fn turned<L: Lanes>(frame: &FrameRows, direction: &[f32; 3]) -> Points<L> {
    xyz!(i => L::load(&frame[0][i]) * L::splat(direction[0])
        + L::load(&frame[1][i]) * L::splat(direction[1])
        + L::load(&frame[2][i]) * L::splat(direction[2]))
}

/// World places of a point of a frame.
#[inline(always)]
pub(super) fn place<L: Lanes>(frame: &FrameRows, point: &[f32; 3]) -> Points<L> {
    let offset = turned::<L>(frame, point);
    xyz!(i => L::load(&frame[3][i]) + offset[i])
}

/// A rotation whose z axis is `axis`.
fn turn_z_to(axis: &Vector3<f64>) -> Matrix3<f64> {
    let helper = if axis.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
    let x = (helper - axis * axis.dot(&helper)).normalize();
    Matrix3::from_columns(&[x, axis.cross(&x), *axis])
}
