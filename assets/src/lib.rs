//! Procedural kitchens, appliances and a primitive-shaped robot: inputs that need no download.
//!
//! [`appliances`] builds articulated things, [`kitchen`] their static surroundings; both are
//! [`Description`]s that write themselves as URDF, OBJ, MTL and PNG. [`object`] draws the parameters of a class by a seed. [`demo::write`] writes a whole
//! demonstration: kitchen, objects, robots and task files. The same seed gives the same bytes.

pub mod appliances;
pub mod demo;
pub mod description;
pub mod error;
pub mod finish;
pub mod grasp;
pub mod handle;
pub mod import;
pub mod kitchen;
pub mod loose;
pub mod object;
pub mod overlap;
pub mod robot;
pub mod room;
pub mod solid;
pub mod texture;

pub use description::Description;
pub use error::AssetError;
pub use finish::{Finish, Palette};
