//! Kitchens by seed and confinement: room, runs of units, island, table, clutter; checked before they count.
//!
//! The room is centred on the origin with its floor at z = 0. Runs of units stand along walls, each in a frame
//! of its own: x into the room, y along the wall, z up. Work aisles are 1.25 to 2.6 m wide (the NKBA's
//! guidelines ask for 42 inches; robots are wider than people), and refrigerator, sink and oven form a work
//! triangle whose sides sum to at most 7.9 m (26 feet), none shorter than 1.2 m (4 feet).

mod check;
mod furnish;
mod gltf;
mod layout;
mod usd;
mod write;

use akrobat_model::Pose;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::description::LinkDescription;
use crate::error::AssetError;
use crate::finish::Palette;
use crate::object::GeneratedObject;

pub use check::{REACHERS, Reacher};
pub use layout::Layout;
pub use write::TaskRobot;

/// Attempts at a seed, each with other random numbers, before it is given up.
const ATTEMPTS: u64 = 40;

/// A body of a scene.
#[derive(Debug, Clone)]
pub struct PlacedBody {
    /// Unique name, `<class>_<number>`.
    pub name: String,
    /// Semantic class.
    pub class: String,
    /// Pose.
    pub world_from_body: Pose,
    /// Shape.
    pub link: LinkDescription,
}

/// Something in a scene that can be opened; a body of the scene is its static twin.
#[derive(Debug, Clone)]
pub struct PlacedObject {
    /// The object; its name is that of its static twin.
    pub object: GeneratedObject,
    /// Pose of its root.
    pub world_from_root: Pose,
    /// Robots of [`REACHERS`] that can stand where they reach its handle, closed and opened.
    pub reached_by: Vec<&'static str>,
}

/// A generated scene.
#[derive(Debug, Clone)]
pub struct GeneratedScene {
    /// Seed.
    pub seed: u64,
    /// 0 for open .. 1 for confined.
    pub confinement: f64,
    /// How the units stand.
    pub layout: Layout,
    /// Inner dimensions, metres.
    pub room_m: [f64; 3],
    /// Width of the aisle in front of the units, metres.
    pub aisle_m: f64,
    /// Everything that is seen.
    pub bodies: Vec<PlacedBody>,
    /// What can be opened.
    pub objects: Vec<PlacedObject>,
    /// Attempts that it took.
    pub attempts: u64,
    /// Share of the floor on which a disc of 0.4 m radius can stand.
    pub free_floor: f64,
}

/// Why an attempt does not count.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Fault {
    /// Two bodies intersect.
    Intersection(String, String),
    /// Nobody reaches what is to be opened.
    Unreachable(String),
    /// The work triangle is too wide or too narrow.
    WorkTriangle,
}

/// The kitchen of a seed and a confinement of 0 to 1.
///
/// # Errors
/// Where no attempt passes the checks.
pub fn generate(seed: u64, confinement: f64) -> Result<GeneratedScene, AssetError> {
    let mut last = None;
    for attempt in 0..ATTEMPTS {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(attempt);
        let palette = Palette::sample(&mut rng);
        let mut scene = furnish::furnished(&mut rng, seed, confinement, &palette)?;
        scene.attempts = attempt + 1;
        match check::check(&mut scene)? {
            None => return Ok(scene),
            Some(fault) => last = Some(fault),
        }
    }
    Err(AssetError::Scene { seed, reason: format!("{last:?}") })
}

/// Number between two, whole centimetres.
fn between(rng: &mut ChaCha8Rng, low: f64, high: f64) -> f64 {
    (rng.random_range(low..=high) * 100.0).round() / 100.0
}
