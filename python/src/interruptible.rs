//! Long work beside the interpreter: the lock is released, Ctrl-C is heeded, panics do not cross.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use akrobat::CancelToken;
use pyo3::prelude::*;

use crate::errors::RunError;

/// How often Python's signal handlers get their turn.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Exit status of a process ended by Ctrl-C.
const INTERRUPTED_STATUS: i32 = 130;

/// Runs `work` on a thread of its own until it ends. A signal whose Python handler raises sets
/// `cancel`, upon which `work` is expected to return soon; a second one ends the process.
///
/// # Errors
/// `RunError` where `work` panicked.
pub fn run_interruptibly<T: Send>(
    py: Python<'_>,
    cancel: &CancelToken,
    work: impl FnOnce() -> T + Send,
) -> PyResult<T> {
    let outcome = std::thread::scope(|scope| {
        let poller = std::thread::current();
        let worker = scope.spawn(move || {
            let outcome = catch_unwind(AssertUnwindSafe(work));
            poller.unpark();
            outcome
        });
        while !worker.is_finished() {
            py.detach(|| std::thread::park_timeout(POLL_INTERVAL));
            if py.check_signals().is_err() && cancel.cancel() {
                std::process::exit(INTERRUPTED_STATUS);
            }
        }
        py.detach(|| worker.join())
    });
    outcome.and_then(|caught| caught).map_err(|panic| {
        RunError::new_err(format!("internal error, please report it: {}", panic_message(&*panic)))
    })
}

fn panic_message(panic: &(dyn std::any::Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message")
}
