//! The map of base positions, seen from above.

use akrobat_model::task::Task;
use akrobat_model::{Pose, TrajectorySet, TriMesh};
use akrobat_renderer::replay::{Replay, base_link};
use akrobat_renderer::{BodyGroup, FrameState, RenderScene};
use maud::{Markup, html};
use nalgebra::{Point2, Point3};

use super::chart::{points, px};
use super::trajectory_color;

/// Pixels of the drawing per metre.
const SCALE: f64 = 130.0;
/// What is shown around bases and object, metres.
const MARGIN_M: f64 = 0.9;
/// Height at which the scene is cut for its outlines: above floors and rugs, and below table tops.
const FLOOR_CUT_M: f64 = 0.12;
/// Height at which what hangs over the floor is cut.
const COUNTER_CUT_M: f64 = 0.8;

/// A base at one instant.
struct Stance {
    position: Point2<f64>,
    yaw: f64,
}

/// The bases of one trajectory.
struct Track {
    color: String,
    name: String,
    shown: bool,
    start: Stance,
    goal: Stance,
    way: Vec<Point2<f64>>,
}

/// Draws the scene at floor level, the object closed and open, and where the base stands during each
/// manipulation; the bases of `shown` trajectories with their outline.
pub fn draw(task: &Task, scene: &RenderScene, set: &TrajectorySet, shown: &[usize]) -> Markup {
    let replay = Replay::new(task, scene);
    let tracks: Vec<Track> = (0..set.trajectories.len())
        .map(|index| track(&replay, set, index, shown.contains(&index)))
        .collect();
    let rest = replay.at_rest();
    let closed = object_outlines(scene, &rest);
    let open = object_outlines(scene, &open_state(task, &replay, set));
    let base = base_outline(task, scene, &rest);
    let seen = tracks
        .iter()
        .flat_map(|track| [track.start.position, track.goal.position])
        .chain(closed.iter().chain(&open).flatten().copied());
    let map = Map::around(seen);
    let [floor, counter] = [FLOOR_CUT_M, COUNTER_CUT_M].map(|z| map.cut(scene, &rest, z));
    html! {
        svg.map viewBox=(format!("0 0 {} {}", px(map.width()), px(map.height()))) role="img"
            aria-label="Base positions seen from above" {
            path.counter d=(counter) {}
            path.floor d=(floor) {}
            @for hull in &open { polygon.object-open points=(map.points(hull)) {} }
            @for hull in &closed { polygon.object points=(map.points(hull)) {} }
            @for track in &tracks { (map.track(track, &base)) }
            (map.ruler())
        }
    }
}

fn track(replay: &Replay<'_>, set: &TrajectorySet, index: usize, shown: bool) -> Track {
    let trajectory = &set.trajectories[index];
    let samples = trajectory.manipulation_samples();
    let stance = |sample: usize| {
        let state = replay.at_time(trajectory, 0, trajectory.dense.times_s[sample]);
        let pose = state.world_from_base;
        Stance {
            position: Point2::new(pose.translation.x, pose.translation.y),
            yaw: pose.rotation.euler_angles().2,
        }
    };
    Track {
        color: trajectory_color(index),
        name: format!("trajectory {index}"),
        shown,
        start: stance(*samples.start()),
        goal: stance(*samples.end()),
        way: samples
            .clone()
            .step_by(5)
            .chain([*samples.end()])
            .map(|s| stance(s).position)
            .collect(),
    }
}

/// The object opened as far as any trajectory opens it.
fn open_state(task: &Task, replay: &Replay<'_>, set: &TrajectorySet) -> FrameState {
    let travel = |goal: &f64| (goal - task.file.goal.start).abs();
    let goals = set.trajectories.iter().map(|trajectory| trajectory.goal);
    let widest = goals.max_by(|a, b| travel(a).total_cmp(&travel(b))).unwrap_or_default();
    let (robot, rest) = (&task.robot, replay.at_rest());
    let columns = robot.trajectory_joints().into_iter();
    replay.at_sample(
        0,
        0.0,
        akrobat_model::trajectory::PathSample {
            robot: columns.map(|joint| robot.tree.joint_position(joint, &robot.rest)).collect(),
            object: task.object.configuration(widest),
            phase: rest.phase,
        },
    )
}

fn object_outlines(scene: &RenderScene, state: &FrameState) -> Vec<Vec<Point2<f64>>> {
    let bodies = scene.bodies.iter().zip(&state.world_from_body);
    bodies
        .filter(|(body, _)| body.group == BodyGroup::Object)
        .map(|(body, pose)| hull(body.meshes.iter().flat_map(|mesh| seen_from_above(mesh, *pose))))
        .collect()
}

/// Hull, in the base's frame, of everything that the arm does not move.
fn base_outline(task: &Task, scene: &RenderScene, rest: &FrameState) -> Vec<Point2<f64>> {
    let (robot, tree) = (&task.robot, &task.robot.tree);
    let carried = |link: usize| {
        let chain = tree.chain_to(link);
        chain.iter().any(|j| robot.arm_joints.contains(j) || robot.gripper_joints.contains(j))
    };
    let base_from_world = rest.world_from_robot_link[base_link(task)].inverse();
    let bodies = scene.bodies.iter().zip(&rest.world_from_body);
    hull(
        bodies
            .filter(|(body, _)| body.group == BodyGroup::Robot && !carried(body.index))
            .flat_map(|(body, pose)| body.meshes.iter().map(move |mesh| (mesh, *pose)))
            .flat_map(|(mesh, pose)| seen_from_above(mesh, base_from_world * pose)),
    )
}

fn seen_from_above(mesh: &TriMesh, pose: Pose) -> impl Iterator<Item = Point2<f64>> + '_ {
    mesh.positions.iter().map(move |&p| (pose * Point3::from(p.map(f64::from))).xy())
}

/// Convex hull, counter-clockwise (Andrew's monotone chain).
fn hull(points: impl Iterator<Item = Point2<f64>>) -> Vec<Point2<f64>> {
    let mut sorted: Vec<Point2<f64>> = points.collect();
    sorted.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    sorted.dedup();
    let turns_left = |a: Point2<f64>, b: Point2<f64>, c: Point2<f64>| (b - a).perp(&(c - a)) > 0.0;
    let chain = |points: &mut dyn Iterator<Item = Point2<f64>>| {
        let mut chain: Vec<Point2<f64>> = Vec::new();
        for point in points {
            while let [.., a, b] = chain[..]
                && !turns_left(a, b, point)
            {
                chain.pop();
            }
            chain.push(point);
        }
        chain.pop();
        chain
    };
    let mut hull = chain(&mut sorted.iter().copied());
    hull.extend(chain(&mut sorted.iter().rev().copied()));
    hull
}

/// From the world's plane to the drawing: x right, y up.
struct Map {
    low: Point2<f64>,
    high: Point2<f64>,
}

impl Map {
    fn around(points: impl Iterator<Item = Point2<f64>>) -> Self {
        let empty = [
            Point2::new(f64::INFINITY, f64::INFINITY),
            Point2::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
        ];
        let [low, high] = points.fold(empty, |[low, high], p| [low.inf(&p), high.sup(&p)]);
        if low.x > high.x {
            return Self { low: Point2::new(-1.0, -1.0), high: Point2::new(1.0, 1.0) };
        }
        let margin = nalgebra::Vector2::repeat(MARGIN_M);
        Self { low: low - margin, high: high + margin }
    }

    fn width(&self) -> f64 {
        (self.high.x - self.low.x) * SCALE
    }

    fn height(&self) -> f64 {
        (self.high.y - self.low.y) * SCALE
    }

    fn at(&self, p: &Point2<f64>) -> [f64; 2] {
        [(p.x - self.low.x) * SCALE, (self.high.y - p.y) * SCALE]
    }

    fn points(&self, polygon: &[Point2<f64>]) -> String {
        points(polygon.iter().map(|p| self.at(p)))
    }

    /// Path of the lines in which the scene's triangles meet a horizontal plane.
    fn cut(&self, scene: &RenderScene, state: &FrameState, z: f64) -> String {
        let mut path = String::new();
        for (body, pose) in scene.bodies.iter().zip(&state.world_from_body) {
            if body.group != BodyGroup::Scene {
                continue;
            }
            for mesh in &body.meshes {
                let world: Vec<Point3<f64>> =
                    mesh.positions.iter().map(|&p| pose * Point3::from(p.map(f64::from))).collect();
                for triangle in &mesh.triangles {
                    let corners = triangle.map(|vertex| world[vertex as usize]);
                    if let Some([a, b]) = section(&corners, z).filter(|ends| self.shows(ends)) {
                        let [[ax, ay], [bx, by]] = [self.at(&a), self.at(&b)].map(|p| p.map(px));
                        path += &format!("M{ax} {ay}L{bx} {by}");
                    }
                }
            }
        }
        path
    }

    /// True unless a line lies to one side of the drawing.
    fn shows(&self, [a, b]: &[Point2<f64>; 2]) -> bool {
        let (low, high) = (a.inf(b), a.sup(b));
        (0..2).all(|i| low[i] <= self.high[i] && high[i] >= self.low[i])
    }

    fn track(&self, track: &Track, base: &[Point2<f64>]) -> Markup {
        let style = format!("--c:{}", track.color);
        let outline = |stance: &Stance| {
            let turn = nalgebra::Rotation2::new(stance.yaw);
            let corners: Vec<Point2<f64>> =
                base.iter().map(|p| turn * p + stance.position.coords).collect();
            self.points(&corners)
        };
        html! {
            g.track style=(style) {
                title { (track.name) }
                @if track.shown && base.len() > 2 {
                    polygon.stance points=(outline(&track.start)) {}
                    polygon.stance.goal points=(outline(&track.goal)) {}
                }
                polyline.way points=(self.points(&track.way)) {}
                (self.marker(&track.start, "start"))
                (self.marker(&track.goal, "goal"))
            }
        }
    }

    /// A dot with a stroke that points where the base does.
    fn marker(&self, stance: &Stance, class: &str) -> Markup {
        let [x, y] = self.at(&stance.position);
        let tip =
            stance.position + 0.16 * nalgebra::Vector2::new(stance.yaw.cos(), stance.yaw.sin());
        let [tip_x, tip_y] = self.at(&tip);
        html! {
            line.heading x1=(px(x)) y1=(px(y)) x2=(px(tip_x)) y2=(px(tip_y)) {}
            circle class=(class) cx=(px(x)) cy=(px(y)) r="5" {}
        }
    }

    fn ruler(&self) -> Markup {
        let (x, y) = (16.0, self.height() - 16.0);
        html! {
            rect.ruler-ground x=(px(x - 8.0)) y=(px(y - 24.0)) width=(px(SCALE + 16.0)) height="32" rx="4" {}
            line.ruler x1=(px(x)) x2=(px(x + SCALE)) y1=(px(y)) y2=(px(y)) {}
            text.ruler-name x=(px(x + SCALE / 2.0)) y=(px(y - 7.0)) text-anchor="middle" { "1 m" }
        }
    }
}

/// Where a triangle meets a horizontal plane.
fn section(corners: &[Point3<f64>; 3], z: f64) -> Option<[Point2<f64>; 2]> {
    let mut ends = [(0, 1), (1, 2), (2, 0)].into_iter().filter_map(|(i, j)| {
        let (a, b) = (&corners[i], &corners[j]);
        ((a.z < z) != (b.z < z)).then(|| (a + (b - a) * ((z - a.z) / (b.z - a.z))).xy())
    });
    Some([ends.next()?, ends.next()?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hulls_leave_inner_points_out() {
        let points = [[0.0, 0.0], [2.0, 0.0], [1.0, 0.5], [2.0, 2.0], [0.0, 2.0], [1.0, 0.0]];
        let corners = hull(points.into_iter().map(Point2::from));
        let expected = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]].map(Point2::from);
        assert_eq!(corners, expected);
    }

    #[test]
    fn sections_lie_in_the_plane_of_the_cut() {
        let triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 2.0], [0.0, 1.0, 2.0]].map(Point3::from);
        let ends = section(&triangle, 1.0).unwrap();
        assert_eq!(ends, [[0.5, 0.0], [0.0, 0.5]].map(Point2::from));
        assert!(section(&triangle, 3.0).is_none());
    }
}
