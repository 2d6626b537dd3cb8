//! Procedural kitchens, appliances and a primitive-shaped robot: inputs that need no download.
//!
//! [`appliances`] builds articulated things, [`kitchen`] their static surroundings; both are
//! [`Description`]s that write themselves as URDF, OBJ, MTL and PNG. [`demo::write`] writes a whole
//! demonstration: kitchen, objects, robots and task files. The same seed gives the same bytes.

pub mod appliances;
pub mod demo;
pub mod description;
pub mod error;
pub mod finish;
pub mod handle;
pub mod kitchen;
pub mod robot;
pub mod solid;
pub mod texture;

pub use description::Description;
pub use error::AssetError;
pub use finish::{Finish, Palette};
