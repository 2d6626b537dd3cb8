//! Parametric appliances in metric sizes.
//!
//! Every appliance stands in its own frame: origin on the floor in the middle of its back, x out of its
//! front, y to the left (seen from behind), z up. Its links are named by what they are: `body`, `door` or
//! `drawer_<n>`, and `handle`. Closed fronts are flush; a reveal of 1.5 mm stays around each.
//!
//! Sizes follow the co-ordinating sizes of kitchen furniture (EN 1116, ISO 3055: widths in steps of
//! 100 mm, depth 600 mm, worktop at 900 mm) and the housings that fit them. Doors between rooms follow
//! DIN 18101 (leaf 860 x 1985 mm, lever at 1050 mm).

mod cabinet;
mod dishwasher;
mod drawer_unit;
mod microwave;
mod oven;
mod parts;
mod refrigerator;
mod room_door;
mod trash_can;

pub use cabinet::Cabinet;
pub use dishwasher::Dishwasher;
pub use drawer_unit::DrawerUnit;
pub use microwave::Microwave;
pub use oven::Oven;
pub use parts::HingeSide;
pub(crate) use parts::check;
pub use refrigerator::Refrigerator;
pub use room_door::RoomDoor;
pub use trash_can::TrashCan;

use akrobat_model::Pose;

use crate::description::Description;

/// An appliance and what a task needs to know about it.
#[derive(Debug, Clone)]
pub struct Appliance {
    /// Links and joints.
    pub description: Description,
    /// Name of the joint that opens it.
    pub joint: String,
    /// Name of the link to hold.
    pub handle_link: String,
    /// Opening positions to ask for, rad or m: doors beyond 60 degrees, drawers beyond 70% of travel.
    pub goals: Vec<f64>,
    /// Depth (without handles), width and height, metres.
    pub size: [f64; 3],
    /// Tool poses in the handle link's frame, the best first; see [`crate::grasp`].
    pub grasps: Vec<Pose>,
}
