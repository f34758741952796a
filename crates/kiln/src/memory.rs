//! The process' peak memory, where the system tells it.

use std::fs;

/// Sets the peak back to what is in use now, so that the next reading is of what came after. Linux only; elsewhere nothing.
pub fn reset_peak() {
    // 5: reset the peak resident set size (proc(5), clear_refs). A refusal leaves the old peak: a reading too high, never too low.
    let _ = fs::write("/proc/self/clear_refs", "5");
}

/// Peak resident memory since the start or the last [`reset_peak`], bytes; `None` where the system does not tell.
pub fn peak() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kibibytes * 1024)
}

#[cfg(test)]
mod tests {
    #[test]
    #[cfg(target_os = "linux")]
    fn a_large_allocation_raises_the_peak() {
        let before = super::peak().expect("Linux tells");
        let block = vec![1u8; 256 << 20];
        assert!(block.iter().step_by(4096).map(|b| u64::from(*b)).sum::<u64>() > 0);
        assert!(super::peak().expect("Linux tells") >= before.max(256 << 20));
    }
}
