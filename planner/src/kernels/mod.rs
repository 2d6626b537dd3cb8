//! Inner loops in lanes of eight numbers.

pub mod lanes;
pub mod obstacles;
pub mod validity;
