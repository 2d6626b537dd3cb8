//! A kitchen base cabinet with drawers.

use crate::description::{Description, JointDescription, LinkDescription};
use crate::error::AssetError;
use crate::finish::Palette;
use crate::handle::{HandleStyle, Orientation};

use super::Appliance;
use super::parts::{Carcass, REVEAL_M, check, mounted_handle, runner};

/// A drawer unit: carcass on a plinth and drawers on full-extension runners, the topmost first.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawerUnit {
    /// Outer width, metres.
    pub width_m: f64,
    /// Depth of the carcass without the fronts, metres.
    pub depth_m: f64,
    /// Height with the plinth, without a worktop, metres.
    pub height_m: f64,
    /// Height of the plinth, metres.
    pub plinth_m: f64,
    /// Heights of the fronts from the top, as shares of the height above the plinth.
    pub front_shares: Vec<f64>,
    /// Index of the drawer that tasks open, 0 at the top.
    pub opened: usize,
    /// Handle of every drawer.
    pub handle: HandleStyle,
}

impl Default for DrawerUnit {
    fn default() -> Self {
        Self {
            width_m: 0.6,
            depth_m: 0.56,
            height_m: 0.862,
            plinth_m: 0.1,
            front_shares: vec![0.26, 0.37, 0.37],
            opened: 0,
            handle: HandleStyle::BAR,
        }
    }
}

impl DrawerUnit {
    const BOARD_M: f64 = 0.018;
    /// Thickness of the drawers' sides and bottoms.
    const DRAWER_BOARD_M: f64 = 0.012;
    /// Room beside a drawer for its runner: half an inch, what side-mounted runners need.
    const RUNNER_M: f64 = 0.0127;
    /// How much shorter than the carcass a drawer is.
    const BEHIND_M: f64 = 0.05;
    /// Share of the drawer's length that it slides out.
    const EXTENSION: f64 = 0.88;

    /// Builds the unit under the given name.
    ///
    /// # Errors
    /// [`AssetError::Dimension`] where a dimension cannot be built.
    pub fn build(&self, name: &str, palette: &Palette) -> Result<Appliance, AssetError> {
        check("drawer unit width", self.width_m, 0.2..=1.2, "0.2 to 1.2 m")?;
        check("drawer unit depth", self.depth_m, 0.25..=0.8, "0.25 to 0.8 m")?;
        check("drawer unit plinth", self.plinth_m, 0.03..=0.3, "0.03 to 0.3 m")?;
        check(
            "drawer unit height",
            self.height_m,
            self.plinth_m + 0.3..=1.6,
            "plinth + 0.3 to 1.6 m",
        )?;
        let shares: f64 = self.front_shares.iter().sum();
        check("drawer unit front shares in total", shares, 0.999..=1.001, "1")?;
        let last = self.front_shares.len() as f64 - 1.0;
        check(
            "drawer unit opened drawer",
            self.opened as f64,
            0.0..=last,
            "the index of a drawer",
        )?;
        let half = self.width_m / 2.0;
        let mut body = LinkDescription::new("body", 26.0);
        body.add_box(
            "plinth",
            &palette.dark,
            [0.0, -half, 0.0],
            [self.depth_m - 0.06, half, self.plinth_m],
        );
        let z = [self.plinth_m, self.height_m];
        let carcass = Carcass {
            depth: self.depth_m,
            width: self.width_m,
            z,
            wall: Self::BOARD_M,
            finish: &palette.carcass,
        };
        carcass.add_to(&mut body);
        let mut links = vec![body];
        let mut joints = Vec::new();
        let mut top = self.height_m;
        for (index, share) in self.front_shares.iter().enumerate() {
            let bottom = top - share * (self.height_m - self.plinth_m);
            self.add_drawer(index, [bottom, top], palette, &mut links, &mut joints);
            top = bottom;
        }
        let travel = self.travel_m();
        Ok(Appliance {
            description: Description { name: name.into(), links, joints },
            joint: format!("drawer_{}_runner", self.opened),
            handle_link: format!("handle_{}", self.opened),
            goals: [0.72, 0.8, 0.9, 0.98].iter().map(|share| share * travel).collect(),
            size: [self.depth_m + REVEAL_M + Self::BOARD_M, self.width_m, self.height_m],
            grasps: self.handle.grasps(Orientation::Horizontal),
        })
    }

    /// How far the drawers slide out, metres.
    pub fn travel_m(&self) -> f64 {
        (self.depth_m - Self::BEHIND_M) * Self::EXTENSION
    }

    /// The drawer's frame: middle of its lower edge on the back of its front.
    fn add_drawer(
        &self,
        index: usize,
        z: [f64; 2],
        palette: &Palette,
        links: &mut Vec<LinkDescription>,
        joints: &mut Vec<JointDescription>,
    ) {
        let name = format!("drawer_{index}");
        let height = z[1] - z[0] - 2.0 * REVEAL_M;
        let half = self.width_m / 2.0;
        let mut drawer = LinkDescription::new(&name, 4.0);
        drawer.add_box(
            "front",
            &palette.front,
            [0.0, -half + REVEAL_M, 0.0],
            [Self::BOARD_M, half - REVEAL_M, height],
        );
        self.add_tray(&mut drawer, height, palette);
        links.push(drawer);
        let origin = [self.depth_m + REVEAL_M, 0.0, z[0] + REVEAL_M];
        joints.push(runner(&format!("{name}_runner"), &name, origin, self.travel_m()));
        let foot = [Self::BOARD_M, 0.0, height / 2.0];
        let (handle, mount) = mounted_handle(
            &format!("handle_{index}"),
            &name,
            foot,
            self.handle,
            Orientation::Horizontal,
            &palette.handle,
        );
        links.push(handle);
        joints.push(mount);
    }

    fn add_tray(&self, drawer: &mut LinkDescription, front_height: f64, palette: &Palette) {
        let board = Self::DRAWER_BOARD_M;
        let half = self.width_m / 2.0 - Self::BOARD_M - Self::RUNNER_M;
        let length = self.depth_m - Self::BEHIND_M;
        // Above the carcass's bottom board and below its top one.
        let (low, high) = (Self::BOARD_M + 0.012, front_height - Self::BOARD_M - 0.03);
        let boards = [
            ("tray_bottom", [-length, -half, low], [0.0, half, low + board]),
            ("tray_left", [-length, half - board, low + board], [0.0, half, high]),
            ("tray_right", [-length, -half, low + board], [0.0, -half + board, high]),
            (
                "tray_back",
                [-length, -half + board, low + board],
                [-length + board, half - board, high],
            ),
        ];
        for (name, low, high) in boards {
            drawer.add_box(name, &palette.carcass, low, high);
        }
    }
}
