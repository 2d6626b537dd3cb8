//! Grasps that follow from a handle's shape.
//!
//! The tool frame is that of all grasp files: z approaches, y is the way the fingers close, the origin lies
//! between the pads. Handles are given in the frame of their link: x out of the front, the long axis along y.

use std::f64::consts::{FRAC_PI_4, PI};

use akrobat_model::Pose;
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::description::Description;
use crate::error::AssetError;
use crate::overlap::WorldBox;

/// Opening of the gripper that every handle is made for, metres.
pub const OPENING_M: f64 = 0.08;
/// The fingers that grasps are checked with: thickness along y, width along x, reach beyond the tool's origin
/// and behind it, metres. They are those of common parallel hands.
const FINGER_M: [f64; 4] = [0.012, 0.020, 0.010, 0.045];
/// The palm behind the fingers: its extent along x and y, and its depth, metres.
const PALM_M: [f64; 3] = [0.06, 0.20, 0.06];

/// A tool pose at a point, from the approach direction and the way the fingers close (perpendicular unit
/// vectors).
pub fn tool_pose(at: Point3<f64>, approach: Vector3<f64>, closing: Vector3<f64>) -> Pose {
    let axes = Matrix3::from_columns(&[closing.cross(&approach), closing, approach]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Pose::from_parts(Translation3::from(at.coords), rotation)
}

/// Grasps of a bar along y at a distance from the front: at these places, tilted about the bar by up to
/// `tilt` rad, and swung along it; both ways round.
pub fn on_bar(x: f64, places: &[f64], tilt: f64) -> Vec<Pose> {
    let mut poses = Vec::new();
    let mut add = |y: f64, tilt: f64, swing: f64| {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt)
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), swing);
        for side in [1.0, -1.0] {
            let (approach, closing) = (turn * -Vector3::x(), turn * Vector3::z() * side);
            poses.push(tool_pose(Point3::new(x, y, 0.0), approach, closing));
        }
    };
    for tilt in [0.0, tilt, -tilt] {
        for &y in places {
            add(y, tilt, 0.0);
        }
    }
    for swing in [0.35, -0.35] {
        add(places[0], 0.0, swing);
    }
    poses
}

/// Grasps of a knob whose head's middle is at a distance from the front: from all sides around it.
pub fn on_knob(x: f64) -> Vec<Pose> {
    let around = |k: usize, tilt: f64| {
        let roll = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), k as f64 * FRAC_PI_4);
        let tilted = roll * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), tilt);
        tool_pose(Point3::new(x, 0.0, 0.0), tilted * -Vector3::x(), roll * Vector3::z())
    };
    let straight = (0..8).map(|k| around(k, 0.0));
    straight.chain((0..8).map(|k| around(k, 0.35))).collect()
}

/// Grasps of a wall of revolution about z, from above: its middle radius and the height of its rim, and how
/// far below the rim the tool is, metres.
pub fn on_rim(radius: f64, rim_z: f64, below: f64) -> Vec<Pose> {
    const AROUND: usize = 8;
    let at = |k: usize| {
        let angle = 2.0 * PI * k as f64 / AROUND as f64;
        let radial = Vector3::new(angle.cos(), angle.sin(), 0.0);
        let point = Point3::from(radial * radius + Vector3::z() * (rim_z - below));
        [1.0, -1.0].map(|side| tool_pose(point, -Vector3::z(), radial * side))
    };
    (0..AROUND).flat_map(at).collect()
}

/// Grasps of a board that stands along y, from above: places on it, and its tilt towards -x and +x.
pub fn on_board(x: f64, z: f64, places: &[f64]) -> Vec<Pose> {
    let mut poses = Vec::new();
    for tilt in [0.0, -0.3, 0.3] {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), tilt);
        for &y in places {
            for side in [1.0, -1.0] {
                let (approach, closing) = (turn * -Vector3::z(), turn * Vector3::x() * side);
                poses.push(tool_pose(Point3::new(x, y, z), approach, closing));
            }
        }
    }
    poses
}

/// The open gripper's fingers and palm in the tool frame.
fn gripper() -> [WorldBox; 3] {
    let [thickness, width, beyond, behind] = FINGER_M;
    let finger = |side: f64| WorldBox {
        world_from_box: Pose::translation(
            0.0,
            side * (OPENING_M + thickness) / 2.0,
            (beyond - behind) / 2.0,
        ),
        half: Vector3::new(width, thickness, beyond + behind) / 2.0,
    };
    let palm = WorldBox {
        world_from_box: Pose::translation(0.0, 0.0, -behind - PALM_M[2] / 2.0),
        half: Vector3::from(PALM_M) / 2.0,
    };
    [finger(1.0), finger(-1.0), palm]
}

/// The grasps at which the open gripper touches nothing of the object at rest; poses in the frame of the link
/// of this name.
///
/// # Errors
/// Where the description is no tree or has no such link.
pub fn fitting(
    description: &Description,
    link: &str,
    grasps: &[Pose],
) -> Result<Vec<Pose>, AssetError> {
    let tree = description.tree()?;
    let poses = tree.link_poses(&Pose::identity(), &tree.neutral());
    let held = poses[tree.link_index(link)?];
    let obstacles: Vec<WorldBox> = description
        .links
        .iter()
        .zip(&poses)
        .flat_map(|(link, pose)| link.collisions.iter().map(|shape| WorldBox::new(pose, shape)))
        .collect();
    let fits = |grasp: &&Pose| {
        let tool = held * **grasp;
        gripper().iter().all(|part| {
            let placed = WorldBox { world_from_box: tool * part.world_from_box, ..*part };
            obstacles.iter().all(|obstacle| obstacle.penetration(&placed) < 0.0)
        })
    };
    Ok(grasps.iter().filter(fits).copied().collect())
}
