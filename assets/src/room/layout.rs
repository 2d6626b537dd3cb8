//! Where walls and runs stand.

use std::f64::consts::{FRAC_PI_2, PI};

use akrobat_model::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::between;

/// Width of every unit, metres.
pub const UNIT_M: f64 = 0.6;
/// Depth that a run takes, metres: worktop.
pub const RUN_M: f64 = 0.6;
/// Edge of what fills a corner between two runs, metres: a handle of the one stays clear of the other's doors.
pub const CORNER_M: f64 = 0.68;
/// Room at the free ends of a run, for the handle of an opened door, metres.
const END_M: f64 = 0.12;

/// How the units of a kitchen stand.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Layout {
    /// Along one wall.
    Straight,
    /// Along two walls that face each other.
    Galley,
    /// Along two walls that meet.
    L,
    /// Along three walls.
    U,
    /// Along one wall, with an island before it.
    Island,
}

/// A run of units.
#[derive(Debug, Clone)]
pub struct Run {
    /// Its frame: x into the room, y along the run, from the start of the first unit.
    pub world_from_run: Pose,
    /// Number of units.
    pub units: usize,
    /// A corner is filled before its first unit, and after its last.
    pub corners: [bool; 2],
    /// The corner before its first unit, or after its last, is filled by another run.
    pub adjoins: [bool; 2],
    /// Stands at a wall.
    pub at_wall: bool,
}

/// Dimensions of a kitchen.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Arrangement.
    pub layout: Layout,
    /// Inner dimensions of the room, metres.
    pub room: [f64; 3],
    /// Width of the aisle, metres.
    pub aisle: f64,
    /// Its runs.
    pub runs: Vec<Run>,
    /// x of the middle of the aisle.
    pub aisle_x: f64,
    /// There is room for a table on the side of +x.
    pub dining: bool,
}

/// A pose on the floor.
pub fn on_floor(x: f64, y: f64, yaw: f64) -> Pose {
    Pose::from_parts(
        Translation3::new(x, y, 0.0),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
    )
}

/// A plan of this confinement.
pub fn plan(rng: &mut ChaCha8Rng, confinement: f64) -> Plan {
    const LAYOUTS: [Layout; 5] =
        [Layout::Straight, Layout::Galley, Layout::L, Layout::U, Layout::Island];
    let layout = LAYOUTS[rng.random_range(0..LAYOUTS.len())];
    let aisle = between(rng, -0.08, 0.08) + 2.6 + (1.33 - 2.6) * confinement;
    let height = between(rng, 2.4, 2.8);
    let dining =
        layout != Layout::Galley && layout != Layout::U && rng.random_bool(1.0 - 0.6 * confinement);
    let beyond = if dining { between(rng, 1.6, 2.2) } else { 0.0 };
    let long = rng.random_range(6..=8);
    let short = rng.random_range(3..=5);
    let (west, across, depth) = match layout {
        Layout::Straight => (long, 0, RUN_M + aisle + beyond),
        Layout::Island => (long, 0, RUN_M + aisle + RUN_M + 1.0f64.max(aisle * 0.8) + beyond),
        Layout::Galley => (short + 1, short + 1, RUN_M + aisle + RUN_M),
        Layout::L => {
            (short + 1, short, (RUN_M + aisle + beyond).max(CORNER_M + 0.6 * short as f64 + END_M))
        }
        Layout::U => {
            let between_corners = ((aisle + 2.0 * (RUN_M - CORNER_M)) / UNIT_M).floor().max(1.0);
            (short, between_corners as usize, 2.0 * CORNER_M + UNIT_M * between_corners)
        }
    };
    let corner = matches!(layout, Layout::L | Layout::U);
    let end = if corner { CORNER_M } else { END_M };
    // Room for a robot beyond the run's end.
    let spare = between(rng, 0.0, 0.4) + 0.8 * (1.0 - confinement);
    let width = END_M + UNIT_M * west as f64 + end + spare;
    let (hx, hy) = (depth / 2.0, width / 2.0);
    // The run in the west ends in the north, where the corner is.
    let start = hy - end - UNIT_M * west as f64;
    let run = |world_from_run, units, corners, adjoins| Run {
        world_from_run,
        units,
        corners,
        adjoins,
        at_wall: true,
    };
    let mut runs = vec![run(on_floor(-hx, start, 0.0), west, [false, corner], [false; 2])];
    match layout {
        Layout::Straight => {}
        Layout::Galley => {
            runs.push(run(on_floor(hx, hy - END_M, PI), across, [false; 2], [false; 2]))
        }
        Layout::L => {
            let north = on_floor(-hx + CORNER_M, hy, -FRAC_PI_2);
            runs.push(run(north, across, [false; 2], [true, false]));
        }
        Layout::U => {
            let north = on_floor(-hx + CORNER_M, hy, -FRAC_PI_2);
            runs.push(run(north, across, [false; 2], [true; 2]));
            runs.push(run(on_floor(hx, hy - CORNER_M, PI), west, [true, false], [false; 2]));
        }
        Layout::Island => {
            let units = rng.random_range(2..=3usize);
            let x = -hx + RUN_M + aisle + RUN_M;
            let y = start + UNIT_M * (west as f64 + units as f64) / 2.0;
            runs.push(Run {
                world_from_run: on_floor(x, y, PI),
                units,
                corners: [false; 2],
                adjoins: [false; 2],
                at_wall: false,
            });
        }
    }
    let aisle = if layout == Layout::U { depth - 2.0 * RUN_M } else { aisle };
    Plan {
        layout,
        room: [depth, width, height],
        aisle,
        runs,
        aisle_x: -hx + RUN_M + aisle / 2.0,
        dining,
    }
}
