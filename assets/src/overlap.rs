//! Whether boxes intersect.

use akrobat_model::Pose;
use nalgebra::Vector3;

use crate::description::CollisionBox;

/// A box in the world.
#[derive(Debug, Clone, Copy)]
pub struct WorldBox {
    /// Pose of its centre.
    pub world_from_box: Pose,
    /// Half its edge lengths, metres.
    pub half: Vector3<f64>,
}

impl WorldBox {
    /// The collision box of a link at a pose.
    pub fn new(world_from_link: &Pose, shape: &CollisionBox) -> Self {
        Self {
            world_from_box: world_from_link * shape.link_from_box,
            half: Vector3::from(shape.size) / 2.0,
        }
    }

    /// Smallest and largest corner of its axis-aligned bounds, metres.
    pub fn bounds(&self) -> [Vector3<f64>; 2] {
        let reach = self.world_from_box.rotation.to_rotation_matrix().matrix().abs() * self.half;
        let centre = self.world_from_box.translation.vector;
        [centre - reach, centre + reach]
    }

    /// How far two boxes would have to be moved to part them, metres; negative is a lower bound of the gap
    /// between them. Separating axes: Gottschalk, Lin and Manocha, *OBBTree*, SIGGRAPH 1996.
    pub fn penetration(&self, other: &Self) -> f64 {
        let (a, b) = (axes(self), axes(other));
        let between =
            other.world_from_box.translation.vector - self.world_from_box.translation.vector;
        let overlap = |axis: &Vector3<f64>| {
            let reach = |axes: &[Vector3<f64>; 3], half: &Vector3<f64>| -> f64 {
                (0..3).map(|i| (axes[i].dot(axis) * half[i]).abs()).sum()
            };
            reach(&a, &self.half) + reach(&b, &other.half) - between.dot(axis).abs()
        };
        let edges = a.iter().flat_map(|u| b.iter().map(move |v| u.cross(v)));
        let crossed = edges.filter_map(|axis| axis.try_normalize(1e-6));
        let faces = a.iter().chain(&b).copied();
        faces.chain(crossed).map(|axis| overlap(&axis)).fold(f64::INFINITY, f64::min)
    }
}

fn axes(shape: &WorldBox) -> [Vector3<f64>; 3] {
    let rotation = shape.world_from_box.rotation;
    [Vector3::x(), Vector3::y(), Vector3::z()].map(|axis| rotation * axis)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_4;

    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;

    fn cube(x: f64, y: f64, yaw: f64) -> WorldBox {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        WorldBox {
            world_from_box: Pose::from_parts(Translation3::new(x, y, 0.0), turn),
            half: Vector3::repeat(0.5),
        }
    }

    #[test]
    fn penetration_is_the_way_out() {
        let unit = cube(0.0, 0.0, 0.0);
        assert!((unit.penetration(&cube(0.9, 0.2, 0.0)) - 0.1).abs() < 1e-12);
        assert!((unit.penetration(&cube(1.2, 0.0, 0.0)) + 0.2).abs() < 1e-12);
        // A corner of the turned cube, half a diagonal from its middle.
        let corner = 0.5f64.sqrt();
        assert!((unit.penetration(&cube(1.2, 0.0, FRAC_PI_4)) - (corner - 0.7)).abs() < 1e-12);
        let [low, high] = cube(0.0, 0.0, FRAC_PI_4).bounds();
        assert!((high.x - corner).abs() < 1e-12 && (low.z + 0.5).abs() < 1e-12);
    }
}
