//! Leases: a file a build at work, rewritten as a heartbeat. Process ids would mean nothing on a folder that machines share.
//!
//! ```text
//! begin    stamp a file; its time, by the file server's clock, is the start; name it leases/<start>-<nonce>
//! every 30 s    write the file again: the server stamps it
//! end      remove it
//! gc       a lease whose stamp is younger than 10 minutes is alive; what was used since the oldest start of those is spared
//! ```
//! A killed build's lease holds gc up for ten minutes and is removed after a day. A build that was suspended for longer than
//! ten minutes may lose entries: each is a miss.

use std::fs;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::{Store, lock};
use crate::disk;
use crate::error::IoError;

/// Time between heartbeats.
const BEAT: Duration = Duration::from_secs(30);

/// A lease without heartbeat for this long is dead, nanoseconds: ten minutes.
pub(super) const LEASE_LIFE: i64 = 600 * 1_000_000_000;

/// This process' lease.
pub(super) struct Lease {
    path: PathBuf,
    /// When it began, by the file server's clock, nanoseconds since 1970.
    pub(super) start: i64,
    began: Instant,
}

impl Lease {
    /// The file server's time, as far as this machine's monotonic clock can carry it on.
    pub(super) fn now(&self) -> i64 {
        self.start.saturating_add(i64::try_from(self.began.elapsed().as_nanos()).unwrap_or(i64::MAX))
    }
}

/// Says that the work is over, also if it panicked.
struct Over<'a>(&'a Mutex<bool>, &'a Condvar);

impl Drop for Over<'_> {
    fn drop(&mut self) {
        *lock(self.0) = true;
        self.1.notify_all();
    }
}

impl Store {
    /// Does `work` under a lease, with the remote at hand; `cancel` ends what waits for the remote. Uploads that `work` leaves
    /// are finished, or given up within the remote's bound.
    pub(crate) fn during<R>(&self, cancel: &Arc<AtomicBool>, work: impl FnOnce() -> R) -> R {
        match self.take_lease() {
            Ok(lease) => *lock(&self.lease) = Some(lease),
            Err(error) => self.warn(format!("{error}; a garbage collection may cost this build time")),
        }
        lock(&self.claims).clear();
        lock(&self.guesses).clear();
        let (over, changed) = (Mutex::new(false), Condvar::new());
        let result = std::thread::scope(|scope| {
            let _over = Over(&over, &changed);
            scope.spawn(|| self.keep_beating(&over, &changed));
            self.with_uploads(cancel, work)
        });
        if let Some(lease) = lock(&self.lease).take() {
            // It would die by itself.
            let _ = disk::remove(&lease.path);
        }
        result
    }

    fn take_lease(&self) -> Result<Lease, IoError> {
        let temporary = self.write_temporary(&[b"kiln\n"], false)?;
        let began = Instant::now();
        let metadata = fs::metadata(&temporary).map_err(IoError::new("look at", &temporary))?;
        let start = disk::mtime(&metadata);
        let path = self.root.join("leases").join(format!("{start}-{:016x}", self.nonce));
        disk::create_folder(&self.root.join("leases"))?;
        disk::rename(&temporary, &path)?;
        Ok(Lease { path, start, began })
    }

    fn keep_beating(&self, over: &Mutex<bool>, changed: &Condvar) {
        let mut now = lock(over);
        while !*now {
            let waited = changed.wait_timeout(now, BEAT).unwrap_or_else(PoisonError::into_inner);
            now = waited.0;
            if waited.1.timed_out()
                && !*now
                && let Some(lease) = &*lock(&self.lease)
            {
                // A heartbeat that fails is as one that is late.
                let _ = disk::write(&lease.path, &[b"kiln\n"], false);
            }
        }
    }

    /// Start of the oldest lease that is alive at `now`, and how many are.
    pub(super) fn oldest_lease(&self, now: i64) -> (Option<i64>, usize) {
        let Ok(entries) = fs::read_dir(self.root.join("leases")) else { return (None, 0) };
        let mut starts = Vec::new();
        for entry in entries.flatten() {
            let Ok(metadata) = entry.metadata() else { continue };
            if disk::mtime(&metadata) < now.saturating_sub(LEASE_LIFE) {
                continue;
            }
            let name = entry.file_name().to_string_lossy().into_owned();
            let start = name.split('-').next().and_then(|start| start.parse().ok());
            // A name of somebody else's making: as old as can be.
            starts.push(start.unwrap_or(i64::MIN));
        }
        (starts.iter().min().copied(), starts.len())
    }
}
