//! Objects that no joint holds: are they where they should be, upright where they slide, and carried where
//! they rest?

use akrobat_model::task::{ObjectKind, Task};
use akrobat_model::{Rejection, Trajectory, free_object, pose};
use parry3d_f64::math::Vector;

use crate::JudgeConfig;
use crate::finding::{Finding, Worst};
use crate::judge::{Geometry, Scenery};
use crate::kinematics::Frame;
use crate::motion::{Motion, rest_sample};
use crate::path::Place;

/// The object starts where the task says, rests while nobody holds it, and ends at a goal of the task.
/// `last` is the world frame of its body at the last waypoint.
pub fn object_motion(
    trajectory: &Trajectory,
    task: &Task,
    last: &Frame,
    config: &JudgeConfig,
) -> Result<(), String> {
    let object = &task.object;
    let segments = trajectory.segments();
    let name = |column: usize| &object.tree.joints()[object.tree.dof_joints()[column]].name;
    let first = *segments[0].samples.start();
    for sample in 0..trajectory.dense.len() {
        let Some(rest) = rest_sample(&segments, sample).or((sample == first).then_some(first))
        else {
            continue;
        };
        for (column, &position) in trajectory.dense.object.row(sample).iter().enumerate() {
            let expected = if rest == first {
                object.start[column]
            } else {
                f64::from(trajectory.dense.object.row(rest)[column])
            };
            let off = (f64::from(position) - expected).abs();
            if off > config.standstill_tolerance {
                return Err(format!(
                    "sample {sample}: the object should rest and is off by {off:.5} in \"{}\"",
                    name(column)
                ));
            }
        }
    }
    let goals = task.file.goal.poses.iter().filter_map(|goal| pose::from_xyz_wxyz(*goal));
    let offs = goals.map(|goal| {
        let goal_from_last = Frame::from_pose(&goal).inverse().then(last);
        (goal_from_last.translation.length(), goal_from_last.angle())
    });
    let nearest = offs.min_by(|a, b| (a.0 + a.1).total_cmp(&(b.0 + b.1)));
    match nearest {
        Some((translation, rotation))
            if translation <= config.goal_translation_m && rotation <= config.goal_rotation_rad =>
        {
            Ok(())
        }
        Some((translation, rotation)) => Err(format!(
            "the object ends {:.2} mm and {rotation:.4} rad away from the nearest goal",
            translation * 1e3
        )),
        None => Err("the task has no goal poses".into()),
    }
}

/// Where the hand has a planar object, by the tool and the grasp alone.
pub struct Carried {
    /// Where on the path.
    pub place: Place,
    /// World frame of the object's body as the tool has it.
    pub world_from_body: Frame,
}

impl Motion {
    /// The hand neither lifts nor tilts a planar object.
    pub fn check_plane(
        &mut self,
        carried: impl Iterator<Item = Carried>,
        start: &Frame,
        config: &JudgeConfig,
    ) {
        let (mut height, mut tilt) = (Worst::default(), Worst::default());
        let up = Vector::new(0.0, 0.0, 1.0);
        let standing = start.inverse();
        // The direction in the body that points up at the start.
        let body_up = standing.point(up) - standing.point(Vector::ZERO);
        for Carried { place, world_from_body } in carried {
            height.see((world_from_body.translation.z - start.translation.z).abs(), place);
            let now = world_from_body.point(body_up) - world_from_body.point(Vector::ZERO);
            tilt.see(now.z.clamp(-1.0, 1.0).acos(), place);
        }
        if let Some(place) = height.above(config.plane_height_m) {
            let detail = format!(
                "{place}: the hand has the object {:.2} mm off the height it slides at",
                height.value * 1e3
            );
            self.findings.push(Finding::new(Rejection::LeftPlane, detail));
        }
        if let Some(place) = tilt.above(config.plane_tilt_rad) {
            let detail = format!("{place}: the hand tilts the object by {:.4} rad", tilt.value);
            self.findings.push(Finding::new(Rejection::LeftPlane, detail));
        }
    }
}

/// Something carries the object where it rests: below its middle, a surface of the scene or the floor z = 0
/// is as high as its lowest point.
pub fn support(geometry: &Geometry, scenery: &Scenery, gap_m: f64) -> Option<Finding> {
    let links = scenery.object.iter().zip(&geometry.obstacles[1..]);
    let corners = || {
        links.clone().flat_map(|(frame, link)| {
            link.triangles.iter().flatten().map(move |corner| frame.point(*corner))
        })
    };
    let low = corners().fold(Vector::splat(f64::INFINITY), |a, c| a.min(c));
    let high = corners().fold(Vector::splat(f64::NEG_INFINITY), |a, c| a.max(c));
    let middle = (low + high) / 2.0;
    let heights = geometry.obstacles[0].triangles.iter().filter_map(|t| height_at(t, middle));
    let below = heights.chain([0.0]).filter(|height| *height <= low.z + gap_m);
    let surface = below.fold(f64::NEG_INFINITY, f64::max);
    let gap = low.z - surface;
    (gap.is_nan() || gap.abs() > gap_m).then(|| {
        let detail = format!(
            "{}: the object's lowest point is {:.1} mm above what is below its middle",
            scenery.place,
            gap * 1e3
        );
        Finding::new(Rejection::Unsupported, detail)
    })
}

/// Height at which the vertical line through `point` crosses a triangle.
fn height_at([a, b, c]: &[Vector; 3], point: Vector) -> Option<f64> {
    let area =
        |p: Vector, q: Vector, r: Vector| (q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x);
    let whole = area(*a, *b, *c);
    if whole.abs() < 1e-12 {
        return None;
    }
    let (u, v) = (area(point, *b, *c) / whole, area(*a, point, *c) / whole);
    let w = 1.0 - u - v;
    (u >= 0.0 && v >= 0.0 && w >= 0.0).then_some(u * a.z + v * b.z + w * c.z)
}

/// True for objects that no joint holds.
pub fn is_free(task: &Task) -> bool {
    task.file.object.kind != ObjectKind::Articulated
}

/// The link that is the root of the object's own description.
pub fn body_link(task: &Task) -> usize {
    free_object::body_link(&task.object.tree)
}
