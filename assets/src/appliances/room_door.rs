//! A door between rooms, with a lever.

use akrobat_model::JointKind;
use nalgebra::Vector3;

use crate::description::{Description, LinkDescription, Motion};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::{HandleStyle, Orientation};

use super::Appliance;
use super::parts::{DOOR_GOALS, HingeSide, REVEAL_M, SideDoor, check, mounted_handle};

/// A leaf in its frame, which opens towards +x. The default leaf is 860 x 1985 mm (DIN 18101).
#[derive(Debug, Clone, PartialEq)]
pub struct RoomDoor {
    /// Width of the leaf, metres.
    pub width_m: f64,
    /// Depth of the frame, metres.
    pub depth_m: f64,
    /// Height of the leaf, metres.
    pub height_m: f64,
    /// Side of the hinges.
    pub hinge_side: HingeSide,
    /// Lever, or a handle of another style, which then is upright and fixed.
    pub handle: HandleStyle,
}

impl Default for RoomDoor {
    fn default() -> Self {
        Self {
            width_m: 0.86,
            depth_m: 0.12,
            height_m: 1.985,
            hinge_side: HingeSide::Left,
            handle: HandleStyle::LEVER,
        }
    }
}

impl RoomDoor {
    const LEAF_M: f64 = 0.04;
    const JAMB_M: f64 = 0.07;
    /// Height of the handle above the floor (DIN 18101) and its distance from the leaf's free edge.
    const LEVER_M: [f64; 2] = [1.05, 0.065];
    /// The leaf hangs above the floor.
    const FLOOR_GAP_M: f64 = 0.007;

    /// Builds the door under the given name.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a dimension cannot be built.
    pub fn build(&self, name: &str, palette: &Palette) -> Result<Appliance, AssetError> {
        check("door width", self.width_m, 0.5..=1.2, "0.5 to 1.2 m")?;
        check("depth of a door's frame", self.depth_m, 0.06..=0.4, "0.06 to 0.4 m")?;
        check("door height", self.height_m, 1.8..=2.4, "1.8 to 2.4 m")?;
        let opening = self.width_m + 2.0 * REVEAL_M;
        let (half, jamb) = (opening / 2.0, Self::JAMB_M);
        let top = self.height_m + Self::FLOOR_GAP_M + 2.0 * REVEAL_M;
        let mut body = LinkDescription::new("body", 30.0);
        for (part, low, high) in [
            ("jamb_left", [0.0, half, 0.0], [self.depth_m, half + jamb, top + jamb]),
            ("jamb_right", [0.0, -half - jamb, 0.0], [self.depth_m, -half, top + jamb]),
            ("head", [0.0, -half, top], [self.depth_m, half, top + jamb]),
        ] {
            body.add_box(part, &palette.accents[2], low, high);
        }
        let leaf = SideDoor {
            name: "door",
            side: self.hinge_side,
            width: opening,
            middle_y: 0.0,
            z: [Self::FLOOR_GAP_M, top],
            carcass_depth: self.depth_m - REVEAL_M - Self::LEAF_M,
            thickness: Self::LEAF_M,
            finish: &palette.front,
            mass_kg: 18.0,
            upper: 1.6,
        };
        let (door, door_joint) = leaf.build();
        let [height, beside] = Self::LEVER_M;
        let beside = self.handle.edge_inset_m(beside);
        let foot = [0.0, leaf.inward_y(leaf.panel_width() - beside), height - Self::FLOOR_GAP_M];
        let (is_lever, orientation) = match self.handle {
            // A lever points away from the free edge.
            HandleStyle::Lever { .. } if self.hinge_side == HingeSide::Right => {
                (true, Orientation::Horizontal)
            }
            HandleStyle::Lever { .. } => (true, Orientation::HorizontalReversed),
            _ => (false, Orientation::Vertical),
        };
        let (handle, mut mount) =
            mounted_handle("handle", "door", foot, self.handle, orientation, &palette.handle);
        if is_lever {
            mount.name = "lever".into();
            mount.motion = Some(Motion {
                kind: JointKind::Revolute,
                axis: Vector3::x() * -self.hinge_side.sign(),
                limits: [0.0, 0.6],
                velocity: 4.0,
                damping: 0.05,
                // Stands for the spring, which carries the lever's weight.
                friction: 0.6,
            });
        }
        Ok(Appliance {
            description: Description {
                name: name.into(),
                links: vec![body, door, handle],
                joints: vec![door_joint, mount],
            },
            joint: "door_hinge".into(),
            handle_link: "handle".into(),
            goals: DOOR_GOALS.into(),
            size: [self.depth_m, opening + 2.0 * jamb, top + jamb],
            grasps: self.handle.grasps(orientation),
        })
    }
}
