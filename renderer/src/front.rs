//! Where the front of the manipulated object is.

use akrobat_model::Pose;
use akrobat_model::task::{Task, matches_pattern};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector2, Vector3};

/// The frame on the floor (z = 0) below the middle of the object, z up, whose x axis points out of its front: the one of
/// the object's own four horizontal directions along which the handle stands out most.
pub(crate) fn world_from_front(task: &Task) -> Pose {
    let object = &task.object;
    let poses = object.tree.link_poses(&object.world_from_root, &object.start);
    let points = |link: usize, handle_only: bool| -> Vec<Point3<f64>> {
        let is_handle = |name: &str| object.handle_parts.iter().any(|p| matches_pattern(p, name));
        let parts = object.tree.links()[link].visuals.iter();
        parts
            .filter(|part| !handle_only || is_handle(&part.name))
            .flat_map(|part| part.triangulate())
            .flat_map(|mesh| mesh.positions)
            .map(|p| poses[link] * Point3::from(p).cast::<f64>())
            .collect()
    };
    let everything: Vec<_> =
        (0..object.tree.links().len()).flat_map(|link| points(link, false)).collect();
    let Some(center) = middle(&everything) else { return Pose::identity() };
    let handle = middle(&points(object.handle_link, true))
        .or_else(|| middle(&points(object.handle_link, false)))
        .unwrap_or(center);
    let out = (handle - center).xy();
    let along = object.world_from_root.rotation * Vector3::x();
    let along = along.xy().try_normalize(1e-6).unwrap_or_else(Vector2::x);
    let axes = [along, -along, Vector2::new(-along.y, along.x), Vector2::new(along.y, -along.x)];
    let front = axes.into_iter().max_by(|a, b| a.dot(&out).total_cmp(&b.dot(&out)));
    let front = front.unwrap_or(along);
    Pose::from_parts(
        Translation3::new(center.x, center.y, 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), front.y.atan2(front.x)),
    )
}

/// Centre of the bounding box.
fn middle(points: &[Point3<f64>]) -> Option<Point3<f64>> {
    let first = *points.first()?;
    let (low, high) =
        points.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    Some(nalgebra::center(&low, &high))
}
