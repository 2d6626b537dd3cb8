//! The one place where Rust errors become Python exceptions.

use akrobat::Error;
use pyo3::PyErr;
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt};

create_exception!(akrobat, AkrobatError, PyException, "Any failure of an Akrobat function.");
create_exception!(akrobat, InputError, AkrobatError, "A file or an argument is wrong.");
create_exception!(akrobat, RunError, AkrobatError, "The machine failed: full disk, lost device.");

/// The exception of a command's error.
pub fn to_python(error: Error) -> PyErr {
    let message = error.to_string();
    match error {
        Error::Input(_) | Error::Usage(_) => InputError::new_err(message),
        Error::Failed(_) => RunError::new_err(message),
        Error::Interrupted(_) => PyKeyboardInterrupt::new_err(message),
    }
}
