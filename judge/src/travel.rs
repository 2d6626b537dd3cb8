//! How far bodies have moved along a path: neighbouring configurations differ little, so a distance that was
//! measured once tells for how long there is nothing to look at.
//!
//! Two measures: the way of each body in the world, one number for each link and configuration, tells most pairs apart
//! without a look; where it does not, the way of one body in the frame of the other does, which hardly grows while
//! one holds the other.

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

/// The way of a body in the frame of another, as far as it was followed.
#[derive(Debug, Clone, Default)]
pub struct RelativeWay {
    /// Where it was last, in the other's frame.
    last: Option<Frame>,
    /// Upper bound of the way of each of its points, metres.
    length_m: f64,
    /// The pair needs no look before the sum of their ways in the world is this.
    skip_until: Option<Travel>,
}

impl RelativeWay {
    /// True where the pair needs no look at all.
    pub fn skips(&self, travel: Travel) -> bool {
        self.skip_until.is_some_and(|until| travel < until)
    }

    /// Follows the body, bounded by `bounds` in its own frame, to `frame`. Gives the length of its way, metres.
    pub fn follow(&mut self, bounds: &Aabb, frame: &Frame) -> f64 {
        if let Some(last) = &self.last {
            self.length_m += farthest(bounds, last, frame);
        }
        self.last = Some(*frame);
        self.length_m
    }

    /// Notes that nothing can happen before the way is `free_until` long.
    pub fn skip(&mut self, free_until: f64, travel: Travel) {
        self.skip_until = Some(travel + free_until - self.length_m);
    }
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

    #[test]
    fn what_moves_together_has_no_relative_way() {
        let bounds = ball(Vector::new(0.1, 0.0, 0.0), 0.2);
        let mut way = RelativeWay::default();
        let at = |x: f64| Frame { translation: Vector::new(x, 0.0, 0.0), ..Frame::IDENTITY };
        assert_eq!(way.follow(&bounds, &at(0.5)), 0.0, "nothing is known before the first look");
        assert_eq!(way.follow(&bounds, &at(0.5)), 0.0);
        assert!(!way.skips(10.0));
        assert!((way.follow(&bounds, &at(0.2)) - 0.3).abs() < 1e-12);
        way.skip(0.4, 10.0);
        assert!(way.skips(10.09) && !way.skips(10.11));
    }

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
