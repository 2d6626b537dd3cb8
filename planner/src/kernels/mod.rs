//! Inner loops in lanes of eight numbers.

pub(crate) mod chain;
pub mod ik;
pub mod obstacles;
pub mod validity;

pub use chain::Config;
