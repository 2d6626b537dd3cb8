//! A kitchen cabinet with side-hinged doors, on a plinth or hung on the wall.

use crate::description::{Description, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::{HandleStyle, Orientation};

use super::Appliance;
use super::parts::{Carcass, DOOR_GOALS, HingeSide, SideDoor, check, mounted_handle};

/// A cabinet: carcass, one shelf, one or two doors. With a 38 mm worktop on top, the default height makes
/// the 900 mm of EN 1116.
#[derive(Debug, Clone, PartialEq)]
pub struct Cabinet {
    /// Outer width, metres.
    pub width_m: f64,
    /// Depth of the carcass without the door, metres.
    pub depth_m: f64,
    /// Height with the plinth, without a worktop, metres.
    pub height_m: f64,
    /// Height of the plinth, metres; 0 for a cabinet that hangs on the wall.
    pub plinth_m: f64,
    /// 1 or 2; of two doors each is hinged at its own side.
    pub doors: usize,
    /// Side of the hinges; of two doors, the one that tasks open.
    pub hinge_side: HingeSide,
    /// Handle of every door.
    pub handle: HandleStyle,
}

impl Default for Cabinet {
    fn default() -> Self {
        Self {
            width_m: 0.6,
            depth_m: 0.56,
            height_m: 0.862,
            plinth_m: 0.1,
            doors: 1,
            hinge_side: HingeSide::Left,
            handle: HandleStyle::BAR,
        }
    }
}

impl Cabinet {
    /// Thickness of boards and doors: 18 mm melamine-faced board.
    const BOARD_M: f64 = 0.018;
    /// Distance of a handle's middle from the door's free edge and from its upper (or, hung, lower) edge.
    const HANDLE_INSET_M: [f64; 2] = [0.05, 0.16];

    /// A cabinet that hangs on the wall: 320 mm deep, 720 mm high.
    pub fn wall() -> Self {
        Self { depth_m: 0.32, height_m: 0.72, plinth_m: 0.0, ..Self::default() }
    }

    /// Builds the cabinet under the given name.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a dimension cannot be built.
    pub fn build(&self, name: &str, palette: &Palette) -> Result<Appliance, AssetError> {
        check("cabinet width", self.width_m, 0.2..=1.2, "0.2 to 1.2 m")?;
        check("cabinet depth", self.depth_m, 0.2..=0.8, "0.2 to 0.8 m")?;
        if self.plinth_m != 0.0 {
            check("cabinet plinth", self.plinth_m, 0.03..=0.3, "0, or 0.03 to 0.3 m")?;
        }
        let lowest = self.plinth_m + 0.3;
        check("cabinet height", self.height_m, lowest..=2.4, "plinth + 0.3 to 2.4 m")?;
        check("cabinet doors", self.doors as f64, 1.0..=2.0, "1 or 2")?;
        let door_width = self.width_m / self.doors as f64;
        check("width of a cabinet's door", door_width, 0.2..=0.7, "0.2 to 0.7 m")?;
        let mut links = vec![self.body(palette)];
        let mut joints = Vec::new();
        let doors: &[(&str, &str, HingeSide, f64)] = match self.doors {
            1 => &[("door", "handle", self.hinge_side, 0.0)],
            _ => &[
                ("door_left", "handle_left", HingeSide::Left, -0.25),
                ("door_right", "handle_right", HingeSide::Right, 0.25),
            ],
        };
        let mut opened = ("door_hinge".to_owned(), "handle".to_owned());
        for &(door_name, handle_name, side, middle) in doors {
            let door = SideDoor {
                name: door_name,
                side,
                width: door_width,
                middle_y: middle * self.width_m,
                z: [self.plinth_m, self.height_m],
                carcass_depth: self.depth_m,
                thickness: Self::BOARD_M,
                finish: &palette.front,
                mass_kg: 5.0 * door_width / 0.6,
                upper: 1.9,
            };
            let (door_link, door_joint) = door.build();
            let [beside, beyond] = Self::HANDLE_INSET_M;
            let beside = self.handle.edge_inset_m(beside);
            let z = if self.plinth_m == 0.0 { beyond } else { door.panel_height() - beyond };
            let (handle_link, handle_joint) = mounted_handle(
                handle_name,
                door_name,
                [0.0, door.inward_y(door.panel_width() - beside), z],
                self.handle,
                Orientation::Vertical,
                &palette.handle,
            );
            if side == self.hinge_side {
                opened = (door_joint.name.clone(), handle_name.to_owned());
            }
            links.extend([door_link, handle_link]);
            joints.extend([door_joint, handle_joint]);
        }
        Ok(Appliance {
            description: Description { name: name.into(), links, joints },
            joint: opened.0,
            handle_link: opened.1,
            goals: DOOR_GOALS.into(),
            size: [
                self.depth_m + super::parts::REVEAL_M + Self::BOARD_M,
                self.width_m,
                self.height_m,
            ],
            grasps: self.handle.grasps(Orientation::Vertical),
        })
    }

    fn body(&self, palette: &Palette) -> LinkDescription {
        let (board, half) = (Self::BOARD_M, self.width_m / 2.0);
        let z = [self.plinth_m, self.height_m];
        let volume = self.width_m * self.depth_m * self.height_m;
        // 28 kg for the default, as flat-pack makers state; in proportion for others.
        let mut body = LinkDescription::new("body", 28.0 * volume / (0.6 * 0.56 * 0.862));
        if self.plinth_m > 0.0 {
            // The toe-kick: the plinth stands back from the front.
            let high = [self.depth_m - 0.06, half, self.plinth_m];
            body.add_box("plinth", &palette.dark, [0.0, -half, 0.0], high);
        }
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
        body
    }
}
