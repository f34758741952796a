//! The process' memory, where the system tells it (Linux).

use std::fs;

/// Sets the peak back to what is in use now.
pub fn reset_peak() {
    // 5: reset the peak resident set size (proc(5), clear_refs). A refusal leaves the old peak: too high, never too low.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Peak resident memory since [`reset_peak`], bytes; 0 where the system does not tell.
pub fn peak() -> u64 {
    read("VmHWM:")
}

/// Resident memory now, bytes; 0 where the system does not tell.
pub fn now() -> u64 {
    read("VmRSS:")
}

fn read(field: &str) -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix(field)).unwrap_or("0");
    line.trim().trim_end_matches("kB").trim().parse::<u64>().unwrap_or(0) * 1024
}
