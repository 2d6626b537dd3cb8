//! CPU time, for benchmarks on machines that others use as well.

use std::sync::OnceLock;
use std::time::Instant;

/// CPU time of this thread, seconds, in the kernel's steps of some milliseconds; wall time where the kernel does
/// not tell.
pub fn cpu_seconds() -> f64 {
    static START: OnceLock<Instant> = OnceLock::new();
    let wall = START.get_or_init(Instant::now).elapsed().as_secs_f64();
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let spent = text.and_then(|t| t.split(' ').next().and_then(|ns| ns.parse::<f64>().ok()));
    spent.map_or(wall, |ns| ns * 1e-9)
}
