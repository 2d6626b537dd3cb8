//! `akrobat._core`: registers with Python what the Rust crates do. No logic of its own.

mod api;
mod cameras;
mod command_line;
mod errors;
mod export;
mod host;
mod interruptible;
mod observer;
mod physics;
mod sapien;
mod task;
mod trajectories;
mod viewer;

use pyo3::prelude::*;

/// The compiled half of the `akrobat` package.
#[pymodule]
mod _core {
    #[pymodule_export]
    use crate::api::{decode_color, plan, render};
    #[pymodule_export]
    use crate::cameras::{farthest_points, fuse, project, unproject};
    #[pymodule_export]
    use crate::command_line::run;
    #[pymodule_export]
    use crate::errors::{AkrobatError, InputError, RunError};
    #[pymodule_export]
    use crate::observer::PyObserver;
    #[pymodule_export]
    use crate::physics::physics_config;
    #[pymodule_export]
    use crate::task::PyTask;
    #[pymodule_export]
    use crate::trajectories::{PyTrajectories, PyTrajectory};
}
