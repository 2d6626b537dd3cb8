//! What this process has used of the machine.

/// Processor time of all threads so far, user and system, seconds; `None` where the system does not tell.
pub fn cpu_seconds() -> Option<f64> {
    #[cfg(unix)]
    {
        use nix::sys::resource::{UsageWho, getrusage};
        use nix::sys::time::TimeValLike;
        let usage = getrusage(UsageWho::RUSAGE_SELF).ok()?;
        let microseconds =
            usage.user_time().num_microseconds() + usage.system_time().num_microseconds();
        Some(microseconds as f64 * 1e-6)
    }
    #[cfg(not(unix))]
    None
}

/// Largest resident memory so far, bytes; `None` where the system does not tell.
pub fn peak_memory_bytes() -> Option<u64> {
    #[cfg(unix)]
    {
        use nix::sys::resource::{UsageWho, getrusage};
        let kept = u64::try_from(getrusage(UsageWho::RUSAGE_SELF).ok()?.max_rss()).ok()?;
        // Apple counts bytes, the others kibibytes.
        Some(if cfg!(target_vendor = "apple") { kept } else { kept * 1024 })
    }
    #[cfg(not(unix))]
    None
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn work_takes_processor_time_and_memory() {
        let (cpu, memory) = (cpu_seconds().unwrap(), peak_memory_bytes().unwrap());
        let block = vec![1u8; 64 << 20];
        let mut sum = 0u64;
        loop {
            sum += block.iter().step_by(4096).map(|b| u64::from(*b)).sum::<u64>();
            if cpu_seconds().unwrap() > cpu + 0.02 {
                break;
            }
        }
        assert!(sum > 0 && memory > 1 << 20);
        assert!(peak_memory_bytes().unwrap() >= 64 << 20);
    }
}
