//! Akrobat on the command line: one verb per job, composed from the stages' crates.
//!
//! [`run`] is the whole command line; the `akrobat` binary and the Python package both call it.

pub mod cancel;
pub mod cli;
pub mod error;
pub mod host;
pub mod jobs;
pub mod pipeline;
pub mod progress;
pub mod report;
pub mod resources;

pub use cancel::CancelToken;
pub use cli::run;
pub use error::{Error, ExitCode};
pub use host::{ConvertedStage, Host, SapienShaders};
