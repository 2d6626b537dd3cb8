//! Things that no joint holds: a chair that is pulled, and boxes, mugs and bowls that are picked up.
//!
//! Their frame has the origin on the floor (or table) below the middle, z up; a chair faces +x.

use std::f64::consts::{PI, TAU};

use akrobat_model::Pose;
use akrobat_model::task::ObjectKind;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use crate::description::{CollisionBox, Description, LinkDescription};
use crate::error::AssetError;
use crate::finish::{Finish, Palette};
use crate::grasp;
use crate::solid::Solid;

use crate::appliances::check;

/// A rigid thing of one link and what a task needs to know about it.
#[derive(Debug, Clone)]
pub struct Loose {
    /// Its one link.
    pub description: Description,
    /// Whether it is picked up or pulled.
    pub kind: ObjectKind,
    /// Patterns of the parts that are held; all where empty.
    pub held_parts: Vec<String>,
    /// Depth, width and height, metres.
    pub size: [f64; 3],
    /// Tool poses in its frame, the best first; see [`crate::grasp`].
    pub grasps: Vec<Pose>,
}

fn loose(name: &str, link: LinkDescription, size: [f64; 3], grasps: Vec<Pose>) -> Loose {
    Loose {
        description: Description { name: name.into(), links: vec![link], joints: Vec::new() },
        kind: ObjectKind::Rigid,
        held_parts: Vec::new(),
        size,
        grasps,
    }
}

/// A chair with a top rail to pull it by. `size`: depth, width and height, metres; the seat lies at 450 mm
/// (EN 1729 and manufacturers' dining chairs: 430 to 460 mm).
///
/// # Errors
/// [`AssetError::Dimension`] where a dimension cannot be built.
pub fn chair(name: &str, size: [f64; 3], palette: &Palette) -> Result<Loose, AssetError> {
    let [depth, width, height] = size;
    check("chair depth", depth, 0.3..=0.6, "0.3 to 0.6 m")?;
    check("chair width", width, 0.3..=0.6, "0.3 to 0.6 m")?;
    check("chair height", height, 0.7..=1.2, "0.7 to 1.2 m")?;
    const SEAT_M: [f64; 2] = [0.425, 0.45];
    const LEG_M: f64 = 0.034;
    const RAIL_M: [f64; 2] = [0.022, 0.09];
    let (x, y) = (depth / 2.0, width / 2.0);
    let wood = &palette.worktop;
    let mut link = LinkDescription::new("chair", 5.0);
    link.add_box("seat", wood, [-x, -y, SEAT_M[0]], [x, y, SEAT_M[1]]);
    for side in [-y, y - LEG_M] {
        link.add_box("legs", wood, [x - LEG_M, side, 0.0], [x, side + LEG_M, SEAT_M[0]]);
        link.add_box("legs", wood, [-x, side, 0.0], [-x + LEG_M, side + LEG_M, SEAT_M[0]]);
        let top = height - RAIL_M[1];
        link.add_box("posts", wood, [-x, side, SEAT_M[1]], [-x + LEG_M, side + LEG_M, top]);
    }
    let slat = SEAT_M[1] + 0.4 * (height - SEAT_M[1]);
    link.add_box(
        "slat",
        wood,
        [-x + 0.008, -y + LEG_M, slat - 0.03],
        [-x + 0.026, y - LEG_M, slat + 0.03],
    );
    let low = [-x + 0.006, -y, height - RAIL_M[1]];
    link.add_box("top_rail", wood, low, [-x + 0.006 + RAIL_M[0], y, height]);
    let rail_x = -x + 0.006 + RAIL_M[0] / 2.0;
    let reach = 0.3 * width;
    let grasps = grasp::on_board(rail_x, height - 0.02, &[0.0, reach, -reach, reach / 2.0]);
    let held_parts = vec!["top_rail".into()];
    Ok(Loose { kind: ObjectKind::Planar, held_parts, ..loose(name, link, size, grasps) })
}

/// A packet or tin of straight edges, held across its depth.
///
/// # Errors
/// [`AssetError::Dimension`] where a dimension cannot be built, or the gripper could not span it.
pub fn packet(name: &str, size: [f64; 3], finish: &Finish) -> Result<Loose, AssetError> {
    let [depth, width, height] = size;
    check("box depth", depth, 0.02..=0.07, "0.02 to 0.07 m, what a gripper spans")?;
    check("box width", width, 0.02..=0.4, "0.02 to 0.4 m")?;
    check("box height", height, 0.04..=0.4, "0.04 to 0.4 m")?;
    let mut link = LinkDescription::new("box", (300.0 * depth * width * height).clamp(0.05, 1.5));
    let (x, y) = (depth / 2.0, width / 2.0);
    link.add_box("box", finish, [-x, -y, 0.0], [x, y, height]);
    let reach = 0.25 * width;
    let grasps = grasp::on_board(0.0, height - 0.02, &[0.0, reach, -reach]);
    Ok(loose(name, link, size, grasps))
}

/// A mug with an ear. `size`: its depth with the ear, its diameter and its height, metres.
///
/// # Errors
/// [`AssetError::Dimension`] where a dimension cannot be built.
pub fn mug(name: &str, diameter: f64, height: f64, finish: &Finish) -> Result<Loose, AssetError> {
    check("mug width", diameter, 0.06..=0.12, "0.06 to 0.12 m")?;
    check("mug height", height, 0.06..=0.16, "0.06 to 0.16 m")?;
    const WALL_M: f64 = 0.005;
    const EAR_M: [f64; 2] = [0.036, 0.010];
    let (radius, [ear, thick]) = (diameter / 2.0, EAR_M);
    let mut link = LinkDescription::new("mug", 0.3);
    let inner = radius - WALL_M;
    let profile = [
        [0.0, 0.0],
        [radius * 0.94, 0.0],
        [radius, 0.006],
        [radius, height],
        [inner, height],
        [inner, 0.010],
        [0.0, 0.006],
    ];
    let rise = 0.32 * height;
    let on_ear = |angle: f64| {
        Point3::new(
            radius - WALL_M / 2.0 + ear * angle.sin(),
            0.0,
            0.55 * height - rise * angle.cos(),
        )
    };
    let path: Vec<_> = (0..=20).map(|k| on_ear(PI * f64::from(k) / 20.0)).collect();
    let rod = Solid::bent_rod(&path, -Vector3::y(), thick / 2.0, 12);
    link.add_visual("wall", finish, vec![Solid::lathe(&profile, 40), rod]);
    let inscribed = radius * std::f64::consts::FRAC_1_SQRT_2;
    let bottom = [[-inscribed, -inscribed, 0.0], [inscribed, inscribed, 0.008]];
    link.collisions.push(CollisionBox::between("bottom", bottom[0], bottom[1]));
    link.collisions.extend(ring(16, [radius, 0.0], [radius, height], WALL_M));
    link.collisions.extend((0..4).map(|k| {
        let ends = [0, 1].map(|end| on_ear(PI * f64::from(k + end) / 4.0));
        strut("ear", ends, thick)
    }));
    let mut grasps = grasp::on_rim(radius - WALL_M / 2.0, height, 0.016);
    // The rim where the ear is leaves no room for a finger.
    grasps.retain(|pose| pose.translation.x < 0.5 * radius);
    let size = [diameter + ear + thick / 2.0, diameter, height];
    Ok(loose(name, link, size, grasps))
}

/// A bowl.
///
/// # Errors
/// [`AssetError::Dimension`] where a dimension cannot be built.
pub fn bowl(name: &str, diameter: f64, height: f64, finish: &Finish) -> Result<Loose, AssetError> {
    check("bowl width", diameter, 0.10..=0.32, "0.10 to 0.32 m")?;
    check("bowl height", height, 0.04..=0.15, "0.04 to 0.15 m")?;
    const WALL_M: f64 = 0.005;
    let (radius, foot) = (diameter / 2.0, 0.24 * diameter);
    let knee = [0.40 * diameter, 0.40 * height];
    let rim = [radius - WALL_M, height];
    let profile = [
        [0.0, 0.0],
        [foot, 0.0],
        [knee[0], knee[1] - WALL_M],
        [radius, height],
        [rim[0], height],
        [knee[0] - WALL_M, knee[1]],
        [foot - WALL_M, WALL_M + 0.001],
        [0.0, WALL_M],
    ];
    let mut link = LinkDescription::new("bowl", 0.35);
    link.add_visual("wall", finish, vec![Solid::lathe(&profile, 48)]);
    let inscribed = foot * std::f64::consts::FRAC_1_SQRT_2;
    let bottom = [[-inscribed, -inscribed, 0.0], [inscribed, inscribed, WALL_M]];
    link.collisions.push(CollisionBox::between("bottom", bottom[0], bottom[1]));
    link.collisions.extend(ring(20, [foot, 0.0], knee, WALL_M));
    link.collisions.extend(ring(20, knee, [radius, height], WALL_M));
    let grasps = grasp::on_rim(radius - 0.012, height, 0.012);
    Ok(loose(name, link, [diameter, diameter, height], grasps))
}

/// Boxes around z that stand for a wall between two `(radius, z)` points of its outside.
fn ring(count: usize, low: [f64; 2], high: [f64; 2], wall: f64) -> Vec<CollisionBox> {
    let along = Vector3::new(high[0] - low[0], 0.0, high[1] - low[1]);
    let lean = along.x.atan2(along.z);
    let widest = low[0].max(high[0]);
    let size = [wall, 2.0 * widest * (PI / count as f64).tan(), along.norm()];
    let middle = Vector3::new((low[0] + high[0]) / 2.0, 0.0, (low[1] + high[1]) / 2.0);
    let tilt = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), lean);
    let inwards = tilt * Vector3::new(-wall / 2.0, 0.0, 0.0);
    (0..count)
        .map(|k| {
            let angle = TAU * (k as f64 + 0.5) / count as f64;
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
            let centre = Translation3::from(turn * (middle + inwards));
            CollisionBox {
                name: "wall".into(),
                link_from_box: Pose::from_parts(centre, turn * tilt),
                size,
            }
        })
        .collect()
}

/// A square strut between two points of the plane y = 0.
fn strut(name: &str, [start, end]: [Point3<f64>; 2], thick: f64) -> CollisionBox {
    let along = end - start;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), along.x.atan2(along.z));
    let centre = Translation3::from(nalgebra::center(&start, &end).coords);
    CollisionBox {
        name: name.into(),
        link_from_box: Pose::from_parts(centre, turn),
        size: [thick, thick, along.norm()],
    }
}
