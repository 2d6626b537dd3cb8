//! The command line, as Python's entry point calls it.

use akrobat::CancelToken;
use pyo3::prelude::*;

use crate::host::PythonHost;
use crate::interruptible::run_interruptibly;

/// Runs the command line `argv` (the program's name first) and returns its exit code.
#[pyfunction]
pub fn run(py: Python<'_>, argv: Vec<std::ffi::OsString>) -> PyResult<i32> {
    let cancel = CancelToken::default();
    run_interruptibly(py, &cancel, || akrobat::run(argv, Some(&PythonHost), &cancel))
}
