//! Handles that a parallel gripper can hold: bars, arches, knobs, recessed bridges and levers.

use std::f64::consts::{FRAC_PI_2, PI};

use akrobat_model::Pose;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use crate::description::{CollisionBox, LinkDescription};
use crate::finish::Finish;
use crate::grasp;
use crate::solid::Solid;

/// Shape of a handle. Hole spacings are multiples of the 32 mm drilling pitch that furniture uses
/// ("System 32").
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HandleStyle {
    /// A round bar on two posts.
    Bar {
        /// Distance between the posts, metres.
        spacing_m: f64,
        /// Diameter of the bar, metres.
        diameter_m: f64,
        /// Free depth between front and bar, metres.
        clearance_m: f64,
    },
    /// A round rod bent to half an ellipse.
    Arch {
        /// Distance between the feet, metres.
        spacing_m: f64,
        /// Diameter of the rod, metres.
        diameter_m: f64,
        /// Height of the arch's middle line above the front, metres.
        rise_m: f64,
    },
    /// A turned knob on a neck.
    Knob {
        /// Diameter of the head, metres.
        diameter_m: f64,
        /// Depth from the front to the head's face, metres.
        depth_m: f64,
    },
    /// A shell with a bridge across it: fingers reach into the pockets on both sides of the bridge, which is
    /// flush with the shell's cheeks.
    Recess {
        /// Length of the bridge between the cheeks, metres.
        length_m: f64,
        /// Thickness of the bridge, metres.
        bridge_m: f64,
        /// Depth of the pockets, metres.
        depth_m: f64,
    },
    /// A lever on a round rose, which points to +y where it is horizontal.
    Lever {
        /// Length from the rose's middle, metres.
        length_m: f64,
        /// Diameter of the lever, metres.
        diameter_m: f64,
        /// Free depth between front and lever, metres.
        clearance_m: f64,
    },
}

impl HandleStyle {
    /// A bar of 160 mm, 12 mm thick, with 35 mm of room behind it.
    pub const BAR: Self = Self::Bar { spacing_m: 0.160, diameter_m: 0.012, clearance_m: 0.035 };
    /// An arch of 128 mm, 10 mm thick and 40 mm high.
    pub const ARCH: Self = Self::Arch { spacing_m: 0.128, diameter_m: 0.010, rise_m: 0.040 };
    /// A knob 32 mm across and 36 mm deep.
    pub const KNOB: Self = Self::Knob { diameter_m: 0.032, depth_m: 0.036 };

    /// A bridge of 80 mm, 12 mm thick, over pockets of 36 mm.
    pub const RECESS: Self = Self::Recess { length_m: 0.080, bridge_m: 0.012, depth_m: 0.036 };
    /// A lever of 120 mm, 18 mm thick, with 40 mm of room behind it.
    pub const LEVER: Self = Self::Lever { length_m: 0.120, diameter_m: 0.018, clearance_m: 0.040 };

    /// Width that a gripper's pads must span to hold the handle, metres.
    pub fn grip_width_m(&self) -> f64 {
        match *self {
            Self::Bar { diameter_m, .. }
            | Self::Arch { diameter_m, .. }
            | Self::Knob { diameter_m, .. }
            | Self::Lever { diameter_m, .. } => diameter_m,
            Self::Recess { bridge_m, .. } => bridge_m,
        }
    }

    /// How far the handle stands out from the front, metres.
    pub fn depth_m(&self) -> f64 {
        match *self {
            Self::Bar { diameter_m, clearance_m, .. }
            | Self::Lever { diameter_m, clearance_m, .. } => clearance_m + diameter_m,
            Self::Arch { diameter_m, rise_m, .. } => rise_m + diameter_m / 2.0,
            Self::Knob { depth_m, .. } | Self::Recess { depth_m, .. } => depth_m,
        }
    }

    /// Distance of the handle's middle from the edge of a front: the usual one, or more where the handle is wide
    /// across its long axis, metres.
    pub fn edge_inset_m(&self, usual_m: f64) -> f64 {
        match self {
            Self::Recess { .. } => usual_m.max(RECESS_CHEEK_M[1] + 0.006),
            _ => usual_m,
        }
    }

    /// Tool poses in the frame of the handle's link, the best first: see [`crate::grasp`].
    pub fn grasps(&self, orientation: Orientation) -> Vec<Pose> {
        let poses = match *self {
            Self::Bar { spacing_m, diameter_m, clearance_m } => {
                let reach = 0.3 * spacing_m;
                grasp::on_bar(clearance_m + diameter_m / 2.0, &[0.0, reach, -reach], 0.5)
            }
            Self::Arch { rise_m, spacing_m, .. } => {
                let reach = 0.12 * spacing_m;
                grasp::on_bar(rise_m, &[0.0, reach, -reach], 0.5)
            }
            Self::Recess { depth_m, .. } => {
                grasp::on_bar(depth_m - 0.010, &[0.0, 0.012, -0.012], 0.2)
            }
            Self::Lever { length_m, diameter_m, clearance_m } => {
                let at = [0.65 * length_m, 0.5 * length_m, 0.8 * length_m];
                grasp::on_bar(clearance_m + diameter_m / 2.0, &at, 0.5)
            }
            Self::Knob { depth_m, .. } => grasp::on_knob(depth_m * (1.0 - KNOB_HEAD / 2.0)),
        };
        let turn = orientation.turn();
        poses.into_iter().map(|pose| turn * pose).collect()
    }
}

/// Thickness of a recess's cheeks, and half their width: as far out as the open fingers of an 8 cm gripper
/// stand from the bridge, metres.
const RECESS_CHEEK_M: [f64; 2] = [0.010, 0.060];

/// Share of a knob's depth that is its head.
const KNOB_HEAD: f64 = 0.45;

/// Direction of a handle's long axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Orientation {
    /// Along y: drawers and drop-down doors.
    Horizontal,
    /// Along y, turned about x: the lever of a door that is hinged at the left, which points to -y.
    HorizontalReversed,
    /// Along z: side-hinged doors.
    Vertical,
}

impl Orientation {
    /// Takes a horizontal handle to this orientation: a turn about x.
    fn turn(self) -> Pose {
        let angle = match self {
            Self::Horizontal => 0.0,
            Self::HorizontalReversed => PI,
            Self::Vertical => FRAC_PI_2,
        };
        Pose::from_parts(
            Translation3::identity(),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle),
        )
    }
}

/// How far posts and feet reach into the front, so that no gap shows, metres.
const EMBEDDING_M: f64 = 0.004;

/// A link named `name` with the handle. Its frame has the origin in the middle of the handle's foot on the front, x
/// pointing out of the front and z up.
pub fn handle_link(
    name: &str,
    style: HandleStyle,
    orientation: Orientation,
    finish: &Finish,
) -> LinkDescription {
    let mut link = LinkDescription::new(name, 0.15);
    let turn = orientation.turn();
    let (solids, boxes) = match style {
        HandleStyle::Bar { spacing_m, diameter_m, clearance_m } => {
            bar(spacing_m, diameter_m, clearance_m)
        }
        HandleStyle::Arch { spacing_m, diameter_m, rise_m } => arch(spacing_m, diameter_m, rise_m),
        HandleStyle::Knob { diameter_m, depth_m } => knob(diameter_m, depth_m),
        HandleStyle::Recess { length_m, bridge_m, depth_m } => recess(length_m, bridge_m, depth_m),
        HandleStyle::Lever { length_m, diameter_m, clearance_m } => {
            lever(length_m, diameter_m, clearance_m)
        }
    };
    link.add_visual("grip", finish, solids.into_iter().map(|s| s.moved(&turn)).collect());
    // Named as the pieces of the visual part "grip", so that reports and contact rules can tell.
    link.collisions = boxes
        .into_iter()
        .enumerate()
        .map(|(index, piece)| CollisionBox {
            name: format!("grip_col{index}"),
            link_from_box: turn * piece.link_from_box,
            ..piece
        })
        .collect();
    link
}

fn recess(length: f64, bridge: f64, depth: f64) -> (Vec<Solid>, Vec<CollisionBox>) {
    const SHELL_M: f64 = 0.003;
    let (half, [cheek, wide]) = (length / 2.0, RECESS_CHEEK_M);
    let pieces = [
        ([SHELL_M, -half - cheek, -wide], [depth, -half, wide]),
        ([SHELL_M, half, -wide], [depth, half + cheek, wide]),
        ([depth - 0.024, -half, -bridge / 2.0], [depth, half, bridge / 2.0]),
        ([-EMBEDDING_M, -half - cheek, -wide], [SHELL_M, half + cheek, wide]),
    ];
    let solids = pieces.iter().map(|&(low, high)| Solid::cuboid(low, high)).collect();
    let boxes = pieces
        .iter()
        .map(|&([x, y, z], high)| CollisionBox::between("recess", [x.max(0.0), y, z], high));
    (solids, boxes.collect())
}

fn lever(length: f64, diameter: f64, clearance: f64) -> (Vec<Solid>, Vec<CollisionBox>) {
    const ROSE_M: [f64; 2] = [0.026, 0.008];
    let (radius, neck) = (diameter / 2.0, diameter * 0.4);
    let axis_x = clearance + radius;
    let along_y = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2);
    let [rose, rose_depth] = ROSE_M;
    let foot = Pose::from_parts(Translation3::new(-EMBEDDING_M, 0.0, 0.0), outwards());
    let solids = vec![
        Solid::rod(radius, length + radius, 24)
            .moved(&Pose::from_parts(Translation3::new(axis_x, -radius, 0.0), along_y)),
        Solid::rod(neck, EMBEDDING_M + axis_x, 16).moved(&foot),
        Solid::rod(rose, EMBEDDING_M + rose_depth, 32).moved(&foot),
    ];
    let boxes = vec![
        CollisionBox::between(
            "lever",
            [clearance, -radius, -radius],
            [clearance + diameter, length, radius],
        ),
        CollisionBox::between("neck", [rose_depth, -neck, -neck], [clearance, neck, neck]),
        // The square of equal area.
        CollisionBox::between("rose", [0.0, -0.023, -0.023], [rose_depth, 0.023, 0.023]),
    ];
    (solids, boxes)
}

/// Takes z to x: rods and knobs are made upright.
fn outwards() -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::y_axis(), FRAC_PI_2)
}

fn bar(spacing: f64, diameter: f64, clearance: f64) -> (Vec<Solid>, Vec<CollisionBox>) {
    let (radius, post_radius) = (diameter / 2.0, diameter * 0.4);
    let overhang = 1.5 * diameter;
    let length = spacing + 2.0 * overhang;
    let axis_x = clearance + radius;
    let along_y = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -FRAC_PI_2);
    let grip = Solid::rod(radius, length, 24)
        .moved(&Pose::from_parts(Translation3::new(axis_x, -length / 2.0, 0.0), along_y));
    let mut solids = vec![grip];
    let mut boxes = vec![CollisionBox::between(
        "grip",
        [clearance, -length / 2.0, -radius],
        [clearance + diameter, length / 2.0, radius],
    )];
    for side in [-0.5, 0.5] {
        let y = side * spacing;
        let foot = Translation3::new(-EMBEDDING_M, y, 0.0);
        let post = Solid::rod(post_radius, EMBEDDING_M + axis_x, 16);
        solids.push(post.moved(&Pose::from_parts(foot, outwards())));
        boxes.push(CollisionBox::between(
            "post",
            [0.0, y - post_radius, -post_radius],
            [clearance, y + post_radius, post_radius],
        ));
    }
    (solids, boxes)
}

fn arch(spacing: f64, diameter: f64, rise: f64) -> (Vec<Solid>, Vec<CollisionBox>) {
    const SEGMENTS: usize = 24;
    const BOXES: usize = 6;
    let half = spacing / 2.0;
    let on_ellipse = |angle: f64| Point3::new(rise * angle.sin(), -half * angle.cos(), 0.0);
    let mut path = vec![Point3::new(-EMBEDDING_M, -half, 0.0)];
    path.extend((0..=SEGMENTS).map(|k| on_ellipse(PI * k as f64 / SEGMENTS as f64)));
    path.push(Point3::new(-EMBEDDING_M, half, 0.0));
    let rod = Solid::bent_rod(&path, Vector3::z(), diameter / 2.0, 16);
    let boxes = (0..BOXES).map(|k| {
        let angle = |end: usize| PI * (k + end) as f64 / BOXES as f64;
        let (start, end) = (on_ellipse(angle(0)), on_ellipse(angle(1)));
        let chord = end - start;
        let yaw = chord.y.atan2(chord.x);
        let centre = nalgebra::center(&start, &end);
        CollisionBox {
            name: "arch".into(),
            link_from_box: Pose::from_parts(
                Translation3::from(centre.coords),
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
            ),
            size: [chord.norm(), diameter, diameter],
        }
    });
    (vec![rod], boxes.collect())
}

fn knob(diameter: f64, depth: f64) -> (Vec<Solid>, Vec<CollisionBox>) {
    let (radius, neck) = (diameter / 2.0, diameter * 0.22);
    let head = depth * KNOB_HEAD;
    let profile = [
        [0.0, -EMBEDDING_M],
        [neck, -EMBEDDING_M],
        [neck, depth - head],
        [radius * 0.85, depth - head * 0.85],
        [radius, depth - head * 0.55],
        [radius * 0.95, depth - head * 0.15],
        [radius * 0.7, depth],
        [0.0, depth],
    ];
    let solid =
        Solid::lathe(&profile, 32).moved(&Pose::from_parts(Translation3::identity(), outwards()));
    let square = |name: &str, x: [f64; 2], half: f64| {
        CollisionBox::between(name, [x[0], -half, -half], [x[1], half, half])
    };
    // The head's box is the square of equal area, so that it neither swells nor thins what is held.
    let equal_area = radius * PI.sqrt() / 2.0;
    let boxes = vec![
        square("neck", [0.0, depth - head], neck),
        square("head", [depth - head, depth], equal_area),
    ];
    (vec![solid], boxes)
}
