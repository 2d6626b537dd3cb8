//! The one place where Rust errors become Python exceptions.

use akrobat::{Error, ExitCode};
use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt};

create_exception!(akrobat, AkrobatError, PyException, "Any failure of an Akrobat function.");
create_exception!(akrobat, InputError, AkrobatError, "A file or an argument is wrong.");
create_exception!(akrobat, RunError, AkrobatError, "The machine failed: full disk, lost device.");

/// The exception of a command's error.
pub fn to_python(error: Error) -> PyErr {
    let message = error.to_string();
    match (&error, error.exit_code()) {
        (Error::Interrupted(_), _) => PyKeyboardInterrupt::new_err(message),
        (_, ExitCode::BadInput) => InputError::new_err(message),
        _ => RunError::new_err(message),
    }
}
