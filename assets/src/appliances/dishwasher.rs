//! A dishwasher with a drop-down door.

use crate::description::{Description, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::{HandleStyle, Orientation};

use super::Appliance;
use super::parts::{Carcass, DOOR_GOALS, DropDoor, REVEAL_M, check, mounted_handle};

/// A dishwasher for a 600 mm niche under a worktop (EN 1116): 598 mm wide and 815 mm high.
#[derive(Debug, Clone, PartialEq)]
pub struct Dishwasher {
    /// Outer width, metres.
    pub width_m: f64,
    /// Depth of the housing without the door, metres.
    pub depth_m: f64,
    /// Height, metres.
    pub height_m: f64,
    /// Height of the plinth, metres.
    pub plinth_m: f64,
    /// Handle, level near the door's upper edge.
    pub handle: HandleStyle,
}

impl Default for Dishwasher {
    fn default() -> Self {
        Self {
            width_m: 0.598,
            depth_m: 0.55,
            height_m: 0.815,
            plinth_m: 0.1,
            handle: HandleStyle::Bar { spacing_m: 0.320, diameter_m: 0.014, clearance_m: 0.038 },
        }
    }
}

impl Dishwasher {
    const WALL_M: f64 = 0.025;
    const DOOR_M: f64 = 0.03;

    /// Builds the dishwasher under the given name.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a dimension cannot be built.
    pub fn build(&self, name: &str, palette: &Palette) -> Result<Appliance, AssetError> {
        check("dishwasher width", self.width_m, 0.4..=0.7, "0.4 to 0.7 m")?;
        check("dishwasher depth", self.depth_m, 0.4..=0.7, "0.4 to 0.7 m")?;
        check("dishwasher plinth", self.plinth_m, 0.03..=0.25, "0.03 to 0.25 m")?;
        check("dishwasher height", self.height_m, 0.6..=1.0, "0.6 to 1.0 m")?;
        let half = self.width_m / 2.0;
        let z = [self.plinth_m, self.height_m];
        let mut body = LinkDescription::new("body", 34.0);
        body.add_box(
            "plinth",
            &palette.dark,
            [0.0, -half, 0.0],
            [self.depth_m - 0.06, half, self.plinth_m],
        );
        let tub = Carcass {
            depth: self.depth_m,
            width: self.width_m,
            z,
            wall: Self::WALL_M,
            finish: &palette.appliance,
        };
        tub.add_to(&mut body);
        let inner = half - Self::WALL_M - 0.01;
        for (name, share) in [("rack_lower", 0.12), ("rack_upper", 0.55)] {
            let low = z[0] + share * (z[1] - z[0]);
            body.add_box(
                name,
                &palette.handle,
                [0.03, -inner, low],
                [self.depth_m - 0.03, inner, low + 0.01],
            );
        }
        let door = DropDoor {
            width: self.width_m,
            z,
            carcass_depth: self.depth_m,
            thickness: Self::DOOR_M,
            finish: &palette.appliance,
            mass_kg: 6.0,
            upper: 1.55,
        };
        let (door_link, door_joint) = door.build();
        let (handle_link, handle_joint) = mounted_handle(
            "handle",
            "door",
            [0.0, 0.0, door.panel_height() - self.handle.edge_inset_m(0.06)],
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
            size: [self.depth_m + REVEAL_M + Self::DOOR_M, self.width_m, self.height_m],
            grasps: self.handle.grasps(Orientation::Horizontal),
        })
    }
}
