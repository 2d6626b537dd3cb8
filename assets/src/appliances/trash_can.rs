//! A trash can with a hinged lid.

use nalgebra::Vector3;

use crate::description::{Description, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::{HandleStyle, Orientation};

use super::Appliance;
use super::parts::{DOOR_GOALS, REVEAL_M, check, hinge, mounted_handle};

/// A rectangular bin whose lid is hinged at the rear and has its handle at the front. The default holds
/// some 40 litres, a common size of kitchen bins.
#[derive(Debug, Clone, PartialEq)]
pub struct TrashCan {
    /// Outer width, metres.
    pub width_m: f64,
    /// Depth of the bin, metres; the opened lid needs [`TrashCan::REAR_M`] behind it.
    pub depth_m: f64,
    /// Height with the lid, metres.
    pub height_m: f64,
    /// Handle, level at the lid's front.
    pub handle: HandleStyle,
}

impl Default for TrashCan {
    fn default() -> Self {
        Self {
            width_m: 0.34,
            depth_m: 0.28,
            height_m: 0.66,
            handle: HandleStyle::Bar { spacing_m: 0.128, diameter_m: 0.012, clearance_m: 0.035 },
        }
    }
}

impl TrashCan {
    const WALL_M: f64 = 0.006;
    const LID_M: f64 = 0.05;
    /// Room behind the bin for the lid, which turns about its rear lower edge, metres.
    pub const REAR_M: f64 = Self::LID_M + 0.004;

    /// Builds the bin under the given name.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a dimension cannot be built.
    pub fn build(&self, name: &str, palette: &Palette) -> Result<Appliance, AssetError> {
        check("trash can width", self.width_m, 0.2..=0.6, "0.2 to 0.6 m")?;
        check("trash can depth", self.depth_m, 0.18..=0.5, "0.18 to 0.5 m")?;
        check("trash can height", self.height_m, 0.3..=0.9, "0.3 to 0.9 m")?;
        let (half, wall) = (self.width_m / 2.0, Self::WALL_M);
        let (rear, front) = (Self::REAR_M, Self::REAR_M + self.depth_m);
        let rim = self.height_m - Self::LID_M - REVEAL_M;
        let mut body = LinkDescription::new("body", 3.5);
        let finish = &palette.appliance;
        let walls = [
            ("bottom", [rear, -half, 0.0], [front, half, wall]),
            ("rear", [rear, -half, wall], [rear + wall, half, rim]),
            ("front", [front - wall, -half, wall], [front, half, rim]),
            ("left", [rear + wall, half - wall, wall], [front - wall, half, rim]),
            ("right", [rear + wall, -half, wall], [front - wall, -half + wall, rim]),
        ];
        for (part, low, high) in walls {
            body.add_box(part, finish, low, high);
        }
        let mut lid = LinkDescription::new("door", 0.6);
        lid.add_box("panel", &palette.dark, [0.0, -half, 0.0], [self.depth_m, half, Self::LID_M]);
        // Short of upright, so that it falls shut.
        let origin = [rear, 0.0, rim + REVEAL_M];
        let joint = hinge("door_hinge", "door", origin, -Vector3::y(), 1.5);
        let (handle, mount) = mounted_handle(
            "handle",
            "door",
            [self.depth_m, 0.0, Self::LID_M / 2.0],
            self.handle,
            Orientation::Horizontal,
            &palette.handle,
        );
        Ok(Appliance {
            description: Description {
                name: name.into(),
                links: vec![body, lid, handle],
                joints: vec![joint, mount],
            },
            joint: "door_hinge".into(),
            handle_link: "handle".into(),
            goals: DOOR_GOALS.into(),
            size: [front, self.width_m, self.height_m],
            grasps: self.handle.grasps(Orientation::Horizontal),
        })
    }
}
