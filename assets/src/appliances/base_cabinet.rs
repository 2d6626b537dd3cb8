//! A kitchen base cabinet with one side-hinged door.

use crate::description::{Description, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::{HandleStyle, Orientation};

use super::Appliance;
use super::parts::{Carcass, DOOR_GOALS, HingeSide, SideDoor, check, mounted_handle};

/// A base cabinet: carcass on a plinth, one shelf, one door. With a 38 mm worktop on top, the default
/// height makes the 900 mm of EN 1116.
#[derive(Debug, Clone, PartialEq)]
pub struct BaseCabinet {
    /// Outer width, metres.
    pub width_m: f64,
    /// Depth of the carcass without the door, metres.
    pub depth_m: f64,
    /// Height with the plinth, without a worktop, metres.
    pub height_m: f64,
    /// Height of the plinth, metres.
    pub plinth_m: f64,
    /// Side of the hinges.
    pub hinge_side: HingeSide,
    /// Handle.
    pub handle: HandleStyle,
}

impl Default for BaseCabinet {
    fn default() -> Self {
        Self {
            width_m: 0.6,
            depth_m: 0.56,
            height_m: 0.862,
            plinth_m: 0.1,
            hinge_side: HingeSide::Left,
            handle: HandleStyle::BAR,
        }
    }
}

impl BaseCabinet {
    /// Thickness of boards and door: 18 mm melamine-faced board.
    const BOARD_M: f64 = 0.018;

    /// Builds the cabinet under the given name.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a dimension cannot be built.
    pub fn build(&self, name: &str, palette: &Palette) -> Result<Appliance, AssetError> {
        check("base cabinet width", self.width_m, 0.2..=1.0, "0.2 to 1.0 m")?;
        check("base cabinet depth", self.depth_m, 0.2..=0.8, "0.2 to 0.8 m")?;
        check("base cabinet plinth", self.plinth_m, 0.03..=0.3, "0.03 to 0.3 m")?;
        check(
            "base cabinet height",
            self.height_m,
            self.plinth_m + 0.3..=2.4,
            "plinth + 0.3 to 2.4 m",
        )?;
        let board = Self::BOARD_M;
        let z = [self.plinth_m, self.height_m];
        let half = self.width_m / 2.0;
        let mut body = LinkDescription::new("body", 28.0);
        // The toe-kick: the plinth stands back from the front.
        body.add_box(
            "plinth",
            &palette.dark,
            [0.0, -half, 0.0],
            [self.depth_m - 0.06, half, self.plinth_m],
        );
        let carcass = Carcass {
            depth: self.depth_m,
            width: self.width_m,
            z,
            wall: board,
            finish: &palette.carcass,
        };
        carcass.add_to(&mut body);
        let middle = (z[0] + z[1]) / 2.0;
        body.add_box(
            "shelf",
            &palette.carcass,
            [0.02, -half + board, middle],
            [self.depth_m - 0.05, half - board, middle + board],
        );
        let door = SideDoor {
            side: self.hinge_side,
            width: self.width_m,
            middle_y: 0.0,
            z,
            carcass_depth: self.depth_m,
            thickness: board,
            finish: &palette.front,
            mass_kg: 5.0,
            upper: 1.9,
        };
        let (door_link, door_joint) = door.build();
        let foot = [0.0, door.inward_y(door.panel_width() - 0.05), door.panel_height() - 0.16];
        let (handle_link, handle_joint) = mounted_handle(
            "handle",
            "door",
            foot,
            self.handle,
            Orientation::Vertical,
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
            size: [door.front_x(), self.width_m, self.height_m],
        })
    }
}
