//! What a remote must be able to do.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::error::IoError;

/// How often a wait looks whether the build was cancelled.
pub(crate) const POLL: Duration = Duration::from_millis(50);

/// Why a request gave nothing.
#[derive(Debug)]
pub(crate) enum Fault {
    /// May work another time: no connection, cut off, too late, a server's error.
    Transient(String),
    /// Will not work another time: no leave, no such bucket.
    Refused(String),
    /// Bytes came and are not what they should be.
    Damaged(String),
    /// Our own disk.
    Local(IoError),
    /// The build was cancelled, or uploads were given up.
    Cancelled,
    /// Not asked any more.
    LeftAlone,
}

impl From<IoError> for Fault {
    fn from(error: IoError) -> Fault {
        Fault::Local(error)
    }
}

/// How long a request may go on: for a while, and for as long as bytes come at the least rate that is expected.
pub(crate) struct Until<'a> {
    pub(crate) begun: Instant,
    pub(crate) patience: Duration,
    pub(crate) pace: Pace<'a>,
    pub(crate) cancel: &'a AtomicBool,
}

/// Bytes moved by a request, and what that excuses.
pub(crate) struct Pace<'a> {
    /// Bytes.
    pub(crate) moved: AtomicU64,
    /// Requests that share the line now.
    pub(crate) at_once: &'a AtomicUsize,
    /// Bytes a second that the line is expected to carry at least.
    pub(crate) rate: f64,
}

impl Pace<'_> {
    /// The time that the bytes moved so far may have taken.
    pub(crate) fn excused(&self) -> Duration {
        let share = self.rate.max(1.0) / self.at_once.load(Ordering::Relaxed).max(1) as f64;
        Duration::try_from_secs_f64(self.moved.load(Ordering::Relaxed) as f64 / share).unwrap_or(Duration::MAX)
    }
}

impl Until<'_> {
    /// The time that is left.
    pub(crate) fn left(&self) -> Result<Duration, Fault> {
        if self.cancel.load(Ordering::Relaxed) {
            return Err(Fault::Cancelled);
        }
        let left = self.patience.saturating_add(self.pace.excused()).saturating_sub(self.begun.elapsed());
        if left.is_zero() { Err(Fault::Transient("no answer in time".into())) } else { Ok(left) }
    }

    /// Waits; `false` if there is no time for it.
    pub(crate) fn pause(&self, time: Duration) -> bool {
        let end = Instant::now() + time;
        while Instant::now() < end {
            match self.left() {
                Ok(left) if left > end.saturating_duration_since(Instant::now()) => std::thread::sleep(POLL.min(time)),
                _ => return false,
            }
        }
        true
    }
}

/// Where bytes go as they come.
pub(crate) trait Sink {
    /// Forgets what came: another attempt begins.
    fn restart(&mut self) -> Result<(), Fault>;
    /// More bytes.
    fn push(&mut self, bytes: &[u8]) -> Result<(), Fault>;
    /// All bytes are there: verifies them.
    fn finish(&mut self) -> Result<(), Fault>;
}

impl Sink for Vec<u8> {
    fn restart(&mut self) -> Result<(), Fault> {
        self.clear();
        Ok(())
    }

    fn push(&mut self, bytes: &[u8]) -> Result<(), Fault> {
        self.extend_from_slice(bytes);
        Ok(())
    }

    fn finish(&mut self) -> Result<(), Fault> {
        Ok(())
    }
}

/// Keys and bytes. Every call ends by its deadline, as far as the system lets it; none is tried twice here.
pub(crate) trait Place: Send + Sync {
    /// Pushes the bytes under `key`; `false` if there are none. Announced lengths above `limit` are refused at once.
    fn get(
        &self,
        key: &str,
        limit: u64,
        until: &Until<'_>,
        push: &mut dyn FnMut(&[u8]) -> Result<(), Fault>,
    ) -> Result<bool, Fault>;

    /// Whether there is something under `key`.
    fn has(&self, key: &str, until: &Until<'_>) -> Result<bool, Fault>;

    /// Puts `bytes` under `key`, whole or not at all; with `create` only if there is nothing. Whether it was put.
    fn put(&self, key: &str, bytes: &Arc<[u8]>, create: bool, until: &Until<'_>) -> Result<bool, Fault>;
}
