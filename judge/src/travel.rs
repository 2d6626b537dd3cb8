//! How far bodies have moved along a path: neighbouring configurations differ little, so a distance that was
//! measured once tells for how long there is nothing to look at.

use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;

use crate::kinematics::Frame;

/// An upper bound of the way of every point of a body since the path's first configuration, metres. Two bodies come
/// nearer to each other by at most what their ways have grown since.
pub type Travel = f64;

/// The ways of bodies that are bounded by `bounds`, each in its own frame, `None` where there is nothing of it.
/// `before` holds their world frames and ways in the configuration before.
pub fn after(
    bounds: &[Option<Aabb>],
    before: Option<(&[Frame], &[Travel])>,
    frames: &[Frame],
) -> Vec<Travel> {
    let Some((frames_before, travel_before)) = before else { return vec![0.0; frames.len()] };
    bounds
        .iter()
        .enumerate()
        .map(|(body, bounds)| {
            let way = bounds.map_or(0.0, |b| farthest(&b, &frames_before[body], &frames[body]));
            travel_before[body] + way
        })
        .collect()
}

/// How far the farthest point of a box moves between two frames: one of its corners, since displacement is affine.
fn farthest(bounds: &Aabb, from: &Frame, to: &Frame) -> f64 {
    if from == to {
        return 0.0;
    }
    let squares =
        bounds.vertices().map(|corner| from.point(corner).distance_squared(to.point(corner)));
    squares.into_iter().fold(0.0, f64::max).sqrt()
}

/// The box around all points and boxes; `None` without any.
pub fn around(points: impl Iterator<Item = Aabb>) -> Option<Aabb> {
    points.reduce(|a, b| Aabb::new(a.mins.min(b.mins), a.maxs.max(b.maxs)))
}

/// A box around a ball.
pub fn ball(center: Vector, radius: f64) -> Aabb {
    Aabb::from_half_extents(center, Vector::splat(radius))
}

#[cfg(test)]
mod tests {
    use super::*;
    use parry3d_f64::math::Matrix;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn no_point_of_a_box_moves_farther(
            turn in -1.0..1.0f64,
            shift in prop::array::uniform3(-0.5..0.5f64),
            at in prop::array::uniform3(0.0..1.0f64),
        ) {
            let bounds = Aabb::new(Vector::new(-0.2, -0.1, 0.3), Vector::new(0.4, 0.1, 0.9));
            let to = Frame {
                rotation: Matrix::from_rotation_x(turn),
                translation: Vector::from(shift),
            };
            let point = bounds.mins + bounds.extents() * Vector::from(at);
            let way = after(&[Some(bounds)], Some((&[Frame::IDENTITY], &[1.0])), &[to])[0];
            prop_assert!(to.point(point).distance(point) <= way - 1.0 + 1e-12);
            prop_assert!(way - 1.0 <= 2.0, "and the bound is no larger than a corner's way");
        }
    }
}
