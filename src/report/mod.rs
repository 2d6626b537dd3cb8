//! The page that shows what was planned: pictures, plots, tables, animations.

pub mod animation;
pub mod cloud;
pub mod picture;
