//! A refrigerator with one side-hinged door.

use crate::description::{Description, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::{HandleStyle, Orientation};

use super::Appliance;
use super::parts::{Carcass, DOOR_GOALS, HingeSide, SideDoor, check, mounted_handle};

/// A refrigerator: insulated housing, shelves, one door. 600 mm wide, as tall units of EN 1116 are.
#[derive(Debug, Clone, PartialEq)]
pub struct Refrigerator {
    /// Outer width, metres.
    pub width_m: f64,
    /// Depth of the housing without the door, metres.
    pub depth_m: f64,
    /// Height, metres.
    pub height_m: f64,
    /// Side of the hinges.
    pub hinge_side: HingeSide,
    /// Handle, upright at the door's free edge.
    pub handle: HandleStyle,
}

impl Default for Refrigerator {
    fn default() -> Self {
        Self {
            width_m: 0.6,
            depth_m: 0.58,
            height_m: 1.6,
            hinge_side: HingeSide::Right,
            handle: HandleStyle::Bar { spacing_m: 0.320, diameter_m: 0.018, clearance_m: 0.042 },
        }
    }
}

impl Refrigerator {
    const WALL_M: f64 = 0.045;
    const DOOR_M: f64 = 0.06;
    const FOOT_M: f64 = 0.04;

    /// Builds the refrigerator under the given name.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a dimension cannot be built.
    pub fn build(&self, name: &str, palette: &Palette) -> Result<Appliance, AssetError> {
        check("refrigerator width", self.width_m, 0.4..=1.0, "0.4 to 1.0 m")?;
        check("refrigerator depth", self.depth_m, 0.4..=0.8, "0.4 to 0.8 m")?;
        check("refrigerator height", self.height_m, 0.7..=2.1, "0.7 to 2.1 m")?;
        let half = self.width_m / 2.0;
        let z = [Self::FOOT_M, self.height_m];
        let mut body = LinkDescription::new("body", 50.0);
        body.add_box(
            "foot",
            &palette.dark,
            [0.0, -half + 0.02, 0.0],
            [self.depth_m - 0.03, half - 0.02, Self::FOOT_M],
        );
        let housing = Carcass {
            depth: self.depth_m,
            width: self.width_m,
            z,
            wall: Self::WALL_M,
            finish: &palette.appliance,
        };
        housing.add_to(&mut body);
        let inner = half - Self::WALL_M;
        for share in [0.25, 0.5, 0.75] {
            let low = z[0] + share * (z[1] - z[0]);
            body.add_box(
                "shelves",
                &palette.accents[2],
                [0.02, -inner, low],
                [self.depth_m - 0.06, inner, low + 0.006],
            );
        }
        let door = SideDoor {
            name: "door",
            side: self.hinge_side,
            width: self.width_m,
            middle_y: 0.0,
            z,
            carcass_depth: self.depth_m,
            thickness: Self::DOOR_M,
            finish: &palette.appliance,
            mass_kg: 12.0,
            upper: 2.0,
        };
        let (door_link, door_joint) = door.build();
        // A hand's height: 0.95 m above the floor where the door is tall enough.
        let grip_z = (0.95 - Self::FOOT_M).min(door.panel_height() - 0.25);
        let (handle_link, handle_joint) = mounted_handle(
            "handle",
            "door",
            [0.0, door.inward_y(door.panel_width() - self.handle.edge_inset_m(0.05)), grip_z],
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
            grasps: self.handle.grasps(Orientation::Vertical),
        })
    }
}
