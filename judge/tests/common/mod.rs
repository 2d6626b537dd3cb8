//! A small world in which every check of the judge can be made to fail: a base with a lifting and
//! swinging beam and two fingers opens the door of a cabinet.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_2;
use std::path::PathBuf;

use akrobat_judge::RobotSphere;
use akrobat_model::pose::{from_xyz_rpy, from_xyz_wxyz};
use akrobat_model::robot::Robot;
use akrobat_model::task::{ManipulatedObject, Task};
use akrobat_model::trajectory::{ContactException, DensePath, Grasp};
use akrobat_model::{
    Joint, JointKind, JointPath, KinematicTree, Link, Part, Phase, Pose, Scene, SceneBody, Shape,
    Trajectory,
};
use nalgebra::{Unit, Vector3};

/// Opening angles that the task asks for, radians.
pub const GOALS: [f64; 2] = [1.05, 2.2];
/// Width of the handle, metres.
pub const HANDLE_WIDTH_M: f64 = 0.02;
/// Columns of the robot in a trajectory.
pub const X: usize = 0;
/// Column of the lifting joint.
pub const LIFT: usize = 3;
/// Position of an open finger, metres.
pub const OPEN: f64 = 0.04;
/// Dense samples from one waypoint to the next.
pub const SUBSTEPS: u32 = 5;
const WAYPOINTS: u32 = 30;
/// Time from one waypoint to the next, seconds.
pub const WAYPOINT_INTERVAL_S: f64 = 119.0 / 30.0 / 29.0;

/// A box-shaped part.
pub fn block(name: &str, size: [f64; 3], center: [f64; 3]) -> Part {
    Part {
        name: name.into(),
        link_from_part: from_xyz_rpy(center, [0.0; 3]),
        shape: Shape::Box { size },
        material: None,
    }
}

/// A box-shaped scene body.
pub fn body(name: &str, size: [f64; 3], center: [f64; 3]) -> SceneBody {
    SceneBody {
        name: name.into(),
        class: name.into(),
        world_from_body: from_xyz_rpy(center, [0.0; 3]),
        visuals: vec![block(name, size, [0.0; 3])],
        collisions: Vec::new(),
    }
}

fn link(name: &str, collisions: Vec<Part>) -> Link {
    Link { name: name.into(), collisions, ..Link::default() }
}

struct JointSpec {
    name: &'static str,
    kind: JointKind,
    parent: usize,
    xyz: [f64; 3],
    axis: [f64; 3],
    limits: [f64; 2],
    velocity: f64,
}

/// Joint `i` carries link `i + 1`.
fn joint((index, spec): (usize, JointSpec)) -> Joint {
    Joint {
        name: spec.name.into(),
        kind: spec.kind,
        parent: spec.parent,
        child: index + 1,
        parent_from_joint: from_xyz_rpy(spec.xyz, [0.0; 3]),
        axis: Unit::new_normalize(Vector3::from(spec.axis)),
        limits: spec.limits,
        velocity_limit: Some(spec.velocity),
        effort_limit: None,
        damping: 0.0,
        friction: 0.0,
        mimic: None,
    }
}

const ROBOT_FILE: &str = r#"
name = "beam"
urdf = "beam.urdf"
[base]
kind = "holonomic"
[arm]
joints = ["lift", "swing"]
retract = [0.0, 0.0]
[gripper]
joints = ["left", "right"]
closed = [0.0, 0.0]
open = [0.04, 0.04]
open_width_m = 0.08
finger_links = ["left_finger", "right_finger"]
tool_link = "beam"
link_from_tool = [0.8, 0.0, 0.0, 0.7071067811865476, 0.0, 0.7071067811865476, 0.0]
"#;

fn robot() -> Robot {
    use JointKind::{Prismatic, Revolute};
    let links = vec![
        link("world", vec![]),
        link("x", vec![]),
        link("y", vec![]),
        link("chassis", vec![block("chassis", [0.5, 0.4, 0.301], [0.0, 0.0, 0.1495])]),
        link("mast", vec![block("mast", [0.06, 0.06, 0.2], [0.0, 0.0, 0.0])]),
        link("beam", vec![block("beam", [0.7, 0.06, 0.06], [0.35, 0.0, 0.0])]),
        link("left_finger", vec![block("finger", [0.08, 0.01, 0.02], [-0.03, 0.005, 0.0])]),
        link("right_finger", vec![block("finger", [0.08, 0.01, 0.02], [-0.03, -0.005, 0.0])]),
    ];
    let spec = |name, kind, parent, xyz, axis, limits, velocity| JointSpec {
        name,
        kind,
        parent,
        xyz,
        axis,
        limits,
        velocity,
    };
    let joints = [
        spec("base_x", Prismatic, 0, [0.0; 3], [1.0, 0.0, 0.0], [-5.0, 5.0], 1.0),
        spec("base_y", Prismatic, 1, [0.0; 3], [0.0, 1.0, 0.0], [-5.0, 5.0], 1.0),
        spec("base_yaw", Revolute, 2, [0.0; 3], [0.0, 0.0, 1.0], [-6.3, 6.3], 1.5),
        spec("lift", Prismatic, 3, [0.0, 0.0, 0.5], [0.0, 0.0, 1.0], [-0.3, 0.3], 1.0),
        spec("swing", Revolute, 4, [0.0; 3], [0.0, 0.0, 1.0], [-2.0, 2.0], 1.5),
        spec("left", Prismatic, 5, [0.8, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.04], 0.2),
        spec("right", Prismatic, 5, [0.8, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.04], 0.2),
    ];
    let joints = joints.into_iter().enumerate().map(joint).collect();
    let tree = KinematicTree::new("beam".into(), links, joints).unwrap();
    let file: akrobat_model::RobotFile = toml::from_str(ROBOT_FILE).unwrap();
    Robot {
        name: "beam".into(),
        link_from_tool: from_xyz_wxyz(file.gripper.link_from_tool).unwrap(),
        file,
        urdf_path: PathBuf::new(),
        base_joints: vec![0, 1, 2],
        arm_joints: vec![3, 4],
        gripper_joints: vec![5, 6],
        tool_link: 5,
        finger_links: vec![6, 7],
        rest: vec![0.0, 0.0, 0.0, 0.0, 0.0, OPEN, OPEN],
        spheres_path: None,
        notes: Vec::new(),
        world_from_root: Pose::identity(),
        tree,
    }
}

/// A cabinet of 0.6 x 0.6 x 0.8 m behind the plane x = 0, with a door on its front.
fn cabinet() -> ManipulatedObject {
    let door = vec![
        block("panel", [0.02, 0.58, 0.78], [-0.011, -0.3, 0.4]),
        block("handle", [0.02, HANDLE_WIDTH_M, 0.15], [-0.06, -0.5, 0.5]),
    ];
    let links = vec![
        link("body", vec![block("body", [0.6, 0.6, 0.8], [0.3, 0.0, 0.4])]),
        link("door", door),
        link("flap", vec![block("flap", [0.01, 0.1, 0.1], [0.61, 0.0, 0.4])]),
    ];
    let spec = |name, xyz| JointSpec {
        name,
        kind: JointKind::Revolute,
        parent: 0,
        xyz,
        axis: [0.0, 0.0, -1.0],
        limits: [0.0, 2.5],
        velocity: 0.1,
    };
    let joints = [spec("hinge", [0.0, 0.3, 0.0]), spec("flap hinge", [0.1, 0.0, 0.0])];
    let joints = joints.into_iter().enumerate().map(joint).collect();
    ManipulatedObject {
        name: "cabinet".into(),
        tree: KinematicTree::new("cabinet".into(), links, joints).unwrap(),
        world_from_root: Pose::identity(),
        active_joint: 0,
        handle_link: 1,
        handle_parts: vec!["handle".into()],
        handle_region: None,
        start: vec![0.0, 0.0],
        notes: Vec::new(),
    }
}

/// The task: floor, wall, cabinet, robot.
pub fn task() -> Task {
    let toml = format!(
        "name = \"door\"\n[robot]\nfile = \"beam.toml\"\n[object]\nurdf = \"cabinet.urdf\"\njoint = \"hinge\"\n[goal]\npositions = {GOALS:?}\n"
    );
    Task {
        file: toml::from_str(&toml).unwrap(),
        toml,
        dir: PathBuf::new(),
        robot: robot(),
        object: cabinet(),
        scene: Scene {
            name: "room".into(),
            bodies: vec![
                body("floor", [8.0, 8.0, 0.1], [0.0, 0.0, -0.05]),
                body("wall", [0.1, 8.0, 2.5], [1.0, 0.0, 1.25]),
            ],
            notes: Vec::new(),
        },
        grasp_poses: Vec::new(),
        content_hashes: BTreeMap::new(),
    }
}

/// Spheres of the chassis (one reaches below the floor) and of the beam.
pub fn spheres() -> Vec<RobotSphere> {
    let sphere = |link, center, radius| RobotSphere { link, center, radius };
    let mut spheres = vec![sphere(3, [0.0, 0.0, 0.15], 0.16), sphere(3, [0.2, 0.1, 0.05], 0.06)];
    spheres.extend((1..=7).map(|k| sphere(5, [0.1 * f64::from(k) - 0.02, 0.0, 0.0], 0.04)));
    spheres
}

/// Fingers may touch the handle.
pub fn exceptions() -> Vec<ContactException> {
    ["left_finger", "right_finger"]
        .map(|finger| ContactException {
            robot_link: finger.into(),
            object_link: "door".into(),
            object_part: "handle".into(),
        })
        .to_vec()
}

/// The grasp of the handle's middle.
pub fn grasp() -> Grasp {
    Grasp {
        id: 0,
        link: "door".into(),
        link_from_tool: from_xyz_rpy([-0.06, -0.5, 0.5], [0.0, FRAC_PI_2, 0.0]),
        width_m: HANDLE_WIDTH_M,
    }
}

/// Position along a motion that starts and ends at rest: 10 s^3 - 15 s^4 + 6 s^5.
pub fn minimum_jerk(s: f64) -> f64 {
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

/// The base pose (x, y, yaw) that has the tool on the handle of a door opened by `angle`.
pub fn base_at(angle: f64) -> [f64; 3] {
    // The handle in the hinge's frame, turned by -angle about the hinge at (0, 0.3).
    let (sin, cos) = angle.sin_cos();
    let handle = [-0.06 * cos - 0.5 * sin, 0.06 * sin - 0.5 * cos + 0.3];
    [handle[0] - 0.8 * cos, handle[1] + 0.8 * sin, -angle]
}

/// Approach from 0.3 m behind, close the fingers to `finger`, open the door to `reached` while
/// claiming `goal`.
pub fn trajectory_with(goal: f64, reached: f64, finger: f64) -> Trajectory {
    let mut dense =
        DensePath { robot: JointPath::new(7), object: JointPath::new(2), ..DensePath::default() };
    let [x, y, yaw] = base_at(0.0);
    let step_s = WAYPOINT_INTERVAL_S / f64::from(SUBSTEPS);
    let mut time_s = 0.0;
    for k in 0..=80u32 {
        let back = 0.3 * (1.0 - minimum_jerk(f64::from(k) / 80.0));
        dense.push(time_s, [x - back, y, yaw, 0.0, 0.0, OPEN, OPEN], [0.0, 0.0], Phase::Approach);
        time_s += 0.025;
    }
    for k in 1..=20u32 {
        let opening = OPEN + (finger - OPEN) * minimum_jerk(f64::from(k) / 20.0);
        dense.push(time_s, [x, y, yaw, 0.0, 0.0, opening, opening], [0.0, 0.0], Phase::Grasp);
        time_s += 0.025;
    }
    time_s -= 0.025;
    let manipulation_start = dense.len() as u32 - 1;
    let steps = (WAYPOINTS - 1) * SUBSTEPS;
    for k in 1..=steps {
        time_s += step_s;
        let angle = reached * minimum_jerk(f64::from(k) / f64::from(steps));
        let [x, y, yaw] = base_at(angle);
        dense.push(time_s, [x, y, yaw, 0.0, 0.0, finger, finger], [angle, 0.0], Phase::Manipulate);
    }
    let (mut waypoints_robot, mut waypoints_object) = (JointPath::new(7), JointPath::new(2));
    for waypoint in 0..WAYPOINTS {
        let sample = (manipulation_start + waypoint * SUBSTEPS) as usize;
        waypoints_robot.push(dense.robot.row_f64(sample));
        waypoints_object.push(dense.object.row_f64(sample));
    }
    Trajectory {
        id: "test".into(),
        seed: 0,
        grasp: grasp(),
        start: 0.0,
        goal,
        waypoints_robot,
        waypoints_object,
        waypoint_interval_s: WAYPOINT_INTERVAL_S,
        manipulation_start,
        substeps: SUBSTEPS,
        regrasps: Vec::new(),
        dense,
        verdict: None,
    }
}

/// A trajectory in which nothing is wrong.
pub fn trajectory() -> Trajectory {
    trajectory_with(GOALS[0], GOALS[0], HANDLE_WIDTH_M / 2.0)
}

/// Changes the robot's row at a dense sample, and at the waypoint if it is one.
pub fn edit_robot(trajectory: &mut Trajectory, sample: usize, edit: impl Fn(&mut [f32])) {
    edit(&mut trajectory.dense.robot.values_mut()[sample * 7..][..7]);
    let offset = sample.checked_sub(trajectory.manipulation_start as usize);
    let substeps = trajectory.substeps as usize;
    if let Some(offset) = offset.filter(|offset| {
        offset % substeps == 0 && sample <= *trajectory.manipulation_samples().end()
    }) {
        edit(&mut trajectory.waypoints_robot.values_mut()[offset / substeps * 7..][..7]);
    }
}

/// Adds a smooth bump of `height` to a column over the whole approach.
pub fn bump_approach(trajectory: &mut Trajectory, column: usize, height: f64) {
    for k in 0..=80usize {
        let sin = (std::f64::consts::PI * k as f64 / 80.0).sin();
        trajectory.dense.robot.values_mut()[k * 7 + column] += (height * sin * sin * sin) as f32;
    }
}
