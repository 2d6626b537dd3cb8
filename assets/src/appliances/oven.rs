//! A free-standing oven with a drop-down door.

use crate::description::{Description, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::{HandleStyle, Orientation};
use crate::solid::Solid;

use super::Appliance;
use super::parts::{Carcass, DOOR_GOALS, DropDoor, REVEAL_M, check, mounted_handle};

/// An oven: storage below, a drop-down door with a window, controls above. 600 mm wide, as the niches of
/// EN 1116 are.
#[derive(Debug, Clone, PartialEq)]
pub struct Oven {
    /// Outer width, metres.
    pub width_m: f64,
    /// Depth of the housing without the door, metres.
    pub depth_m: f64,
    /// Height, metres.
    pub height_m: f64,
    /// Lower and upper edge of the door, metres.
    pub door_z_m: [f64; 2],
    /// Handle, level near the door's upper edge.
    pub handle: HandleStyle,
}

impl Default for Oven {
    fn default() -> Self {
        Self {
            width_m: 0.6,
            depth_m: 0.56,
            height_m: 0.862,
            door_z_m: [0.27, 0.73],
            handle: HandleStyle::Bar { spacing_m: 0.384, diameter_m: 0.016, clearance_m: 0.04 },
        }
    }
}

impl Oven {
    const WALL_M: f64 = 0.03;
    const DOOR_M: f64 = 0.035;

    /// Builds the oven under the given name.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a dimension cannot be built.
    pub fn build(&self, name: &str, palette: &Palette) -> Result<Appliance, AssetError> {
        let [door_low, door_high] = self.door_z_m;
        check("oven width", self.width_m, 0.4..=0.9, "0.4 to 0.9 m")?;
        check("oven depth", self.depth_m, 0.3..=0.8, "0.3 to 0.8 m")?;
        check("oven door's lower edge", door_low, 0.05..=1.2, "0.05 to 1.2 m")?;
        check(
            "oven door's upper edge",
            door_high,
            door_low + 0.25..=1.8,
            "lower edge + 0.25 to 1.8 m",
        )?;
        check("oven height", self.height_m, door_high + 0.05..=2.2, "door + 0.05 to 2.2 m")?;
        let half = self.width_m / 2.0;
        let front = self.depth_m + REVEAL_M + Self::DOOR_M;
        let mut body = LinkDescription::new("body", 32.0);
        body.add_box("base", &palette.appliance, [0.0, -half, 0.0], [front, half, door_low]);
        body.add_box(
            "controls",
            &palette.appliance,
            [0.0, -half, door_high],
            [front, half, self.height_m],
        );
        let cavity = Carcass {
            depth: self.depth_m,
            width: self.width_m,
            z: self.door_z_m,
            wall: Self::WALL_M,
            finish: &palette.dark,
        };
        cavity.add_to(&mut body);
        let middle = (door_low + door_high) / 2.0;
        let inner = half - Self::WALL_M;
        body.add_box(
            "rack",
            &palette.handle,
            [0.02, -inner, middle],
            [self.depth_m - 0.03, inner, middle + 0.008],
        );
        let panel = Solid::cuboid(
            [front - 0.002, -0.1, door_high + 0.03],
            [front + 0.0005, 0.1, self.height_m - 0.03],
        );
        body.add_visual("display", &palette.glass, vec![panel]);
        let door = DropDoor {
            width: self.width_m,
            z: self.door_z_m,
            carcass_depth: self.depth_m,
            thickness: Self::DOOR_M,
            finish: &palette.appliance,
            mass_kg: 5.0,
            upper: 1.55,
        };
        let (mut door_link, door_joint) = door.build();
        let window_half = door.panel_half_width() - 0.07;
        let window = Solid::cuboid(
            [-0.002, -window_half, 0.06],
            [0.0005, window_half, door.panel_height() - 0.11],
        );
        door_link.add_visual("window", &palette.glass, vec![window]);
        let (handle_link, handle_joint) = mounted_handle(
            "handle",
            "door",
            [0.0, 0.0, door.panel_height() - self.handle.edge_inset_m(0.055)],
            self.handle,
            Orientation::Horizontal,
            &palette.handle,
        );
        Ok(Appliance {
            description: Description {
                name: name.into(),
                links: vec![body, door_link, handle_link],
                joints: vec![door_joint, handle_joint],
            },
            joint: "door_hinge".into(),
            handle_link: "handle".into(),
            goals: DOOR_GOALS.into(),
            size: [front, self.width_m, self.height_m],
            grasps: self.handle.grasps(Orientation::Horizontal),
        })
    }
}
