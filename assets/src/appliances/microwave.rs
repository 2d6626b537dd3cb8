//! A countertop microwave oven with a side-hinged door.

use akrobat_model::Pose;

use crate::description::{CollisionBox, Description, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::{HandleStyle, Orientation};
use crate::solid::Solid;

use super::Appliance;
use super::parts::{DOOR_GOALS, HingeSide, REVEAL_M, SideDoor, check, mounted_handle};

/// A microwave oven: housing with a cavity and turntable, controls beside the door. The
/// default is a common 23 litre size.
#[derive(Debug, Clone, PartialEq)]
pub struct Microwave {
    /// Outer width, metres.
    pub width_m: f64,
    /// Depth without the handle, metres.
    pub depth_m: f64,
    /// Height with the feet, metres.
    pub height_m: f64,
    /// Width of the control panel, metres.
    pub controls_m: f64,
    /// Side of the hinges; the controls are on the other.
    pub hinge_side: HingeSide,
    /// Handle, upright at the door's free edge.
    pub handle: HandleStyle,
}

impl Default for Microwave {
    fn default() -> Self {
        Self {
            width_m: 0.49,
            depth_m: 0.38,
            height_m: 0.285,
            controls_m: 0.11,
            hinge_side: HingeSide::Left,
            handle: HandleStyle::BAR,
        }
    }
}

impl Microwave {
    const WALL_M: f64 = 0.02;
    const DOOR_M: f64 = 0.03;
    const FOOT_M: f64 = 0.012;

    /// Builds the oven under the given name.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a dimension cannot be built.
    pub fn build(&self, name: &str, palette: &Palette) -> Result<Appliance, AssetError> {
        check("microwave width", self.width_m, 0.4..=0.7, "0.4 to 0.7 m")?;
        check("microwave depth", self.depth_m, 0.28..=0.6, "0.28 to 0.6 m")?;
        check("microwave height", self.height_m, 0.22..=0.45, "0.22 to 0.45 m")?;
        check("microwave control panel", self.controls_m, 0.06..=0.2, "0.06 to 0.2 m")?;
        let door_width = self.width_m - self.controls_m;
        let door = SideDoor {
            name: "door",
            side: self.hinge_side,
            width: door_width,
            middle_y: self.hinge_side.sign() * self.controls_m / 2.0,
            z: [Self::FOOT_M, self.height_m],
            carcass_depth: self.depth_m - REVEAL_M - Self::DOOR_M,
            thickness: Self::DOOR_M,
            finish: &palette.appliance,
            mass_kg: 1.4,
            upper: 1.9,
        };
        let (mut door_link, door_joint) = door.build();
        let across = [door.inward_y(0.05), door.inward_y(door.panel_width() - 0.09)];
        // Visual only, half a millimetre proud: printed glass.
        let window = Solid::cuboid(
            [-0.002, across[0].min(across[1]), 0.045],
            [0.0005, across[0].max(across[1]), door.panel_height() - 0.045],
        );
        door_link.add_visual("window", &palette.glass, vec![window]);
        let foot = [
            0.0,
            door.inward_y(door.panel_width() - self.handle.edge_inset_m(0.04)),
            door.panel_height() / 2.0,
        ];
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
                links: vec![self.body(palette), door_link, handle_link],
                joints: vec![door_joint, handle_joint],
            },
            joint: "door_hinge".into(),
            handle_link: "handle".into(),
            goals: DOOR_GOALS.into(),
            size: [self.depth_m, self.width_m, self.height_m],
            grasps: self.handle.grasps(Orientation::Vertical),
        })
    }

    fn body(&self, palette: &Palette) -> LinkDescription {
        let mut body = LinkDescription::new("body", 11.0);
        let (half, wall) = (self.width_m / 2.0, Self::WALL_M);
        let depth = self.depth_m - REVEAL_M - Self::DOOR_M;
        let (low, high) = (Self::FOOT_M, self.height_m);
        let cavity_right = half - self.controls_m - REVEAL_M;
        let boxes = [
            ("bottom", [0.0, -half, low], [depth, cavity_right, low + wall]),
            ("top", [0.0, -half, high - wall], [depth, cavity_right, high]),
            ("side", [0.0, -half, low + wall], [depth, -half + wall, high - wall]),
            ("back", [0.0, -half + wall, low + wall], [wall, cavity_right, high - wall]),
            // Electronics fill the space behind the controls; its front is flush with the door's.
            ("controls", [0.0, cavity_right, low], [self.depth_m, half, high]),
        ];
        for (name, low, high) in boxes {
            let [low, high] = self.mirrored(low, high);
            body.add_box(name, &palette.appliance, low, high);
        }
        let [panel_low, panel_high] = self.mirrored(
            [self.depth_m - 0.002, cavity_right + 0.012, low + 0.02],
            [self.depth_m + 0.0005, half - 0.012, high - 0.02],
        );
        let panel = Solid::cuboid(panel_low, panel_high);
        body.add_visual("panel", &palette.glass, vec![panel]);
        self.add_feet(&mut body, palette);
        self.add_turntable(&mut body, palette);
        body
    }

    /// Corners of a box of an oven with its hinges on the left, on this one.
    fn mirrored(&self, low: [f64; 3], high: [f64; 3]) -> [[f64; 3]; 2] {
        match self.hinge_side {
            HingeSide::Left => [low, high],
            HingeSide::Right => [[low[0], -high[1], low[2]], [high[0], -low[1], high[2]]],
        }
    }

    fn add_feet(&self, body: &mut LinkDescription, palette: &Palette) {
        let (half, radius) = (self.width_m / 2.0, 0.015);
        for x in [0.04, self.depth_m - 0.08] {
            for y in [-half + 0.04, half - 0.04] {
                let foot =
                    Solid::rod(radius, Self::FOOT_M, 16).moved(&Pose::translation(x, y, 0.0));
                body.add_visual("feet", &palette.dark, vec![foot]);
                let low = [x - radius, y - radius, 0.0];
                let high = [x + radius, y + radius, Self::FOOT_M];
                body.collisions.push(CollisionBox::between("foot", low, high));
            }
        }
    }

    fn add_turntable(&self, body: &mut LinkDescription, palette: &Palette) {
        let x = (Self::WALL_M + self.depth_m - Self::DOOR_M) / 2.0;
        let cavity_right = self.width_m / 2.0 - self.controls_m;
        let y = (-self.width_m / 2.0 + Self::WALL_M + cavity_right) / 2.0;
        let y = -self.hinge_side.sign() * y;
        let z = Self::FOOT_M + Self::WALL_M;
        let radius = 0.12f64.min(x - Self::WALL_M - 0.01);
        let plate = Solid::rod(radius, 0.008, 32).moved(&Pose::translation(x, y, z));
        body.add_visual("turntable", &palette.glass, vec![plate]);
        let low = [x - radius, y - radius, z];
        let high = [x + radius, y + radius, z + 0.008];
        body.collisions.push(CollisionBox::between("turntable", low, high));
    }
}
