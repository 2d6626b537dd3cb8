//! The chain constraint of the AKR: the object's base stays where the environment holds it.

use nalgebra::{Matrix6, SMatrix, SVector, Vector6};

use crate::akr::Akr;
use crate::ik::pose_error;
use crate::kinematics::{Frame, Kinematics, MAX_VARIABLES, NodeFrames, Variables};

/// Residual (m, rad) below which the constraint counts as held.
pub const TOLERANCE: f64 = 1e-7;
/// Newton steps of a projection.
pub(crate) const MAX_STEPS: usize = 12;

/// The constraint, on a compiled AKR whose last variable is the object's joint.
#[derive(Debug, Clone)]
pub struct Closure {
    node: usize,
    node_from_object: Frame,
    world_from_object: Frame,
}

/// `[translation; rotation]` residual and its Jacobian.
pub struct Residual {
    /// Residual, world axes (m, rad).
    pub error: Vector6<f64>,
    /// Derivative with respect to the variables.
    pub jacobian: SMatrix<f64, 6, MAX_VARIABLES>,
}

impl Closure {
    /// The constraint that `akr` keeps the object's root at `world_from_object`; `None` if nothing moves it.
    pub fn new(
        akr: &Akr,
        kinematics: &Kinematics,
        world_from_object: &akrobat_model::Pose,
    ) -> Option<Self> {
        let attachment = kinematics.attachment(akr.object_root);
        let node_from_object = attachment.node_from_link * akr.root_link_from_object;
        Some(Self {
            node: attachment.node?,
            node_from_object: Frame::from(&node_from_object),
            world_from_object: Frame::from(world_from_object),
        })
    }

    /// The node that the object's root hangs from.
    pub(crate) fn node(&self) -> usize {
        self.node
    }

    /// The object's root in that node's frame.
    pub(crate) fn node_from_object(&self) -> &Frame {
        &self.node_from_object
    }

    /// Where the object's root belongs.
    pub(crate) fn world_from_object(&self) -> &Frame {
        &self.world_from_object
    }

    /// Residual at a configuration.
    pub fn error(&self, frames: &NodeFrames) -> Vector6<f64> {
        pose_error(
            &frames.frames[self.node].compose(&self.node_from_object),
            &self.world_from_object,
        )
    }

    /// Residual and Jacobian. The rotation rows are exact to first order in the residual.
    pub fn linearise(&self, kinematics: &Kinematics, frames: &NodeFrames) -> Residual {
        let object = frames.frames[self.node].compose(&self.node_from_object);
        Residual {
            error: pose_error(&object, &self.world_from_object),
            jacobian: kinematics.jacobian(frames, self.node, &object.translation),
        }
    }

    /// Brings `x` onto the constraint by Newton steps of least weighted norm, with the object's joint held
    /// (`hold_object`) or free. `mobility` scales each variable's share: 1 moves freely, 0 not at all.
    /// False where it does not converge within limits.
    pub fn project(
        &self,
        kinematics: &Kinematics,
        x: &mut Variables,
        mobility: &Variables,
        hold_object: bool,
    ) -> bool {
        let object = kinematics.dof() - 1;
        let mut scale = SVector::<f64, MAX_VARIABLES>::zeros();
        scale.rows_mut(0, mobility.len()).copy_from_slice(mobility);
        if hold_object {
            scale[object] = 0.0;
        }
        for _ in 0..MAX_STEPS {
            let frames = kinematics.forward(x);
            let Residual { error, mut jacobian } = self.linearise(kinematics, &frames);
            let size = error.amax();
            if size < TOLERANCE {
                return true;
            }
            if !size.is_finite() || size > 5.0 {
                return false;
            }
            let Some(step) = self.least_step(kinematics, x, &mut jacobian, &error, &scale) else {
                return false;
            };
            let longest = step.amax().max(1e-12);
            let shrink = (0.6 / longest).min(1.0);
            for (i, value) in x.iter_mut().enumerate() {
                *value -= scale[i] * step[i] * shrink;
            }
            kinematics.clamp(x);
        }
        self.error(&kinematics.forward(x)).amax() < TOLERANCE
    }
    /// The step of least norm, in scaled variables, that takes the residual away to first order. A variable that is at a
    /// limit and would be pushed beyond it leaves its share to the others: clamped alone, it would stall the iteration.
    fn least_step(
        &self,
        kinematics: &Kinematics,
        x: &Variables,
        jacobian: &mut SMatrix<f64, 6, MAX_VARIABLES>,
        error: &Vector6<f64>,
        scale: &SVector<f64, MAX_VARIABLES>,
    ) -> Option<SVector<f64, MAX_VARIABLES>> {
        for (i, s) in scale.iter().enumerate() {
            jacobian.column_mut(i).scale_mut(*s);
        }
        loop {
            let normal = *jacobian * jacobian.transpose() + Matrix6::identity() * 1e-12;
            let step = jacobian.transpose() * normal.cholesky()?.solve(error);
            let mut held = false;
            for (i, value) in x.iter().enumerate() {
                let wanted = value - scale[i] * step[i];
                let stuck = wanted < *value && *value <= kinematics.lower()[i]
                    || wanted > *value && *value >= kinematics.upper()[i];
                if stuck {
                    jacobian.column_mut(i).fill(0.0);
                    held = true;
                }
            }
            if !held {
                return Some(step);
            }
        }
    }
}
