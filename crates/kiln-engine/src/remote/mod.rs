//! A cache that others share: a folder, S3, GCS, Azure or HTTP behind the local store.
//!
//! # Problem
//! In: keys of records, lists and blobs that the local store lacks. Out: their bytes, verified, or a miss. Must not matter: that
//! the other side is absent, slow, cut off in the middle, wrong, or hostile. It may cost time, within a bound, and nothing else.
//!
//! # Method
//! ```text
//! record wanted, not here:  get v1/actions/<2 hex>/<fingerprint>, at most 16 MiB
//!     open it as a claim: seal, shape, names, lengths, and a trusted signature if the user trusts keys only
//!     for each blob it names that is not here and whole: get it into a temporary file, header and hash checked on the way
//!     all there: keep the record as our own; anything else: a miss
//! each request: 5 s, and longer only while bytes come at 1 MiB/s (all requests at once together); few attempts
//! failures, and what answers take beyond a quarter of a second and that rate, count as lost time
//! three failures in a row, ten in all, or 15 s lost: the remote is left alone for this build, with one warning
//! writing (CI): what ran is queued; two threads send blobs, then the record; at the end they have a minute
//! ```
//!
//! # Trust
//! A blob proves itself by its hash. A record says which blobs an action gives: only running it again would prove that. So who
//! may write to the remote is trusted with what is built from it: let only CI write, or let records be signed ([`SigningKey`])
//! and name the keys you trust. [`Engine::check_claims`](crate::Engine::check_claims) recomputes a sample.
//!
//! # Bound
//! What the other side does costs each thread of a build at most the 15 s that may be lost, the request then under way (5 s), a
//! quarter of a second a request that is answered in time, and the transfer of what it sends, never slower than 1 MiB/s nor longer
//! than 4 GiB; a build that writes waits a minute more. Only a network file system that hangs in the system itself, which nobody
//! can interrupt, is not bounded.
//!
//! # Limits
//! A record is taken only with all its blobs, so a hit downloads what the build may not need. Blobs are sent whole, in memory.
//! Only what ran is sent: what a local cache knew before is not.
//! Readers of S3 need leave to list the bucket: without it an absent key answers "forbidden", and kiln gives up.
//! HTTP has no "create if new" here: two writers at one moment may replace a record by an equal claim.
//!
//! Parts: `options`, `place` (what a remote must do), `folder`, `objects` (feature `remote`), `claim` (bytes to records),
//! `sign`, `ledger` (when to leave it alone). The store's side is `store/through.rs`.

pub(crate) mod claim;
mod folder;
mod ledger;
#[cfg(feature = "remote")]
mod objects;
mod options;
pub(crate) mod place;
mod sign;

use std::collections::{BTreeSet, VecDeque};
use std::hash::{BuildHasher, RandomState};
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::hash::Fingerprint;
use ledger::Ledger;
pub use ledger::RemoteReport;
pub use options::{RemoteError, RemoteMode, RemoteOptions};
use place::{Fault, Pace, Place, Sink, Until};
pub use sign::{PublicKey, SigningKey};

/// A request without bytes may take this long before it counts as slow.
const FAIR: Duration = Duration::from_millis(250);

/// Pause before the second attempt; four times as long before each further one.
const PAUSE: Duration = Duration::from_millis(100);

/// What is to be sent.
pub(crate) enum Offer {
    /// The record of this fingerprint, and its blobs; `replace` if the one there is known to be dead.
    Record { fingerprint: Fingerprint, replace: bool },
    /// A list of found files.
    List { declared: Fingerprint, list: Vec<String> },
}

#[derive(Default)]
struct Queue {
    offers: VecDeque<Offer>,
    /// Offers that a thread is at.
    at_work: usize,
    closed: bool,
}

/// A remote that is open; asked only while a build is at work.
pub struct Remote {
    options: RemoteOptions,
    check_seed: u64,
    place: Box<dyn Place>,
    reads: Mutex<Ledger>,
    writes: Mutex<Ledger>,
    /// The build's wish to stop; `None` while none is at work.
    cancel: Mutex<Option<Arc<AtomicBool>>>,
    /// Uploads are given up.
    give_up: Arc<AtomicBool>,
    queue: Mutex<Queue>,
    changed: Condvar,
    /// Keys of which the bytes did not verify: to be written over.
    damaged: Mutex<BTreeSet<String>>,
    /// Requests under way.
    at_once: AtomicUsize,
}

/// A request is over, whichever way.
struct Done<'a>(&'a AtomicUsize);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Remote {
    /// Opens what `options` name; asks it nothing yet.
    ///
    /// # Errors
    /// The address or a setting makes no sense, or this build of kiln lacks the feature for it.
    pub fn open(options: RemoteOptions) -> Result<Remote, RemoteError> {
        let place = options.place()?;
        Ok(Remote::at(options, place))
    }

    pub(crate) fn at(options: RemoteOptions, place: Box<dyn Place>) -> Remote {
        Remote {
            check_seed: options.check_seed.unwrap_or_else(|| RandomState::new().hash_one(&options.url)),
            options,
            place,
            reads: Mutex::default(),
            writes: Mutex::default(),
            cancel: Mutex::default(),
            give_up: Arc::default(),
            queue: Mutex::default(),
            changed: Condvar::new(),
            damaged: Mutex::default(),
            at_once: AtomicUsize::new(0),
        }
    }

    /// How it was opened.
    pub fn options(&self) -> &RemoteOptions {
        &self.options
    }

    /// What happened during the last build.
    pub fn report(&self) -> RemoteReport {
        let mut report = lock(&self.reads).report.clone();
        let writes = lock(&self.writes);
        report.sent = writes.report.sent;
        report.bytes_sent = writes.report.bytes_sent;
        report.failures += writes.report.failures;
        report.left_alone |= writes.report.left_alone;
        report
    }

    // --- a build's frame ---

    pub(crate) fn begin(&self, cancel: &Arc<AtomicBool>) {
        *lock(&self.reads) = Ledger::default();
        *lock(&self.writes) = Ledger::default();
        *lock(&self.queue) = Queue::default();
        self.give_up.store(false, Ordering::Relaxed);
        *lock(&self.cancel) = Some(Arc::clone(cancel));
    }

    /// Ends the build's use of it; gives what there is to say.
    pub(crate) fn end(&self) -> Vec<String> {
        *lock(&self.cancel) = None;
        let address = self.options.shown_url();
        let reads = lock(&self.reads).warning(&address, "asked", "the build went on locally");
        if reads.is_some() && lock(&self.reads).report.left_alone {
            return reads.into_iter().collect();
        }
        let unsent = lock(&self.queue).offers.len();
        let mut writes = lock(&self.writes).warning(&address, "written to", "others will build what was not sent");
        if writes.is_none() && unsent > 0 {
            writes = Some(format!("remote cache {address}: {unsent} results were not sent in time"));
        }
        reads.into_iter().chain(writes).collect()
    }

    pub(crate) fn writes(&self) -> bool {
        self.options.mode == RemoteMode::Write
    }

    /// What cannot be read from is not written to either, and the other way round.
    fn is_left_alone(&self) -> bool {
        lock(&self.reads).report.left_alone || lock(&self.writes).report.left_alone
    }

    /// What the sample of [`Engine::check_claims`](crate::Engine::check_claims) is drawn by.
    pub(crate) fn check_seed(&self) -> u64 {
        self.check_seed
    }

    /// Counts a record that was taken.
    pub(crate) fn count_hit(&self) {
        lock(&self.reads).report.hits += 1;
    }

    // --- reading ---

    /// Fetches `key`, of at most `limit` bytes, into `sink`; whether it is there, whole and verified.
    pub(crate) fn fetch(&self, key: &str, limit: u64, sink: &mut dyn Sink) -> Result<bool, Fault> {
        let Some(cancel) = lock(&self.cancel).clone() else { return Ok(false) };
        let mut received = 0;
        let result = self.request(&self.reads, &cancel, 0, |until| {
            received = 0;
            sink.restart()?;
            let mut push = |bytes: &[u8]| {
                received += bytes.len() as u64;
                until.pace.moved.fetch_add(bytes.len() as u64, Ordering::Relaxed);
                if received > limit {
                    return Err(Fault::Damaged(format!("{key} is longer than {limit} bytes")));
                }
                sink.push(bytes)
            };
            match self.place.get(key, limit, until, &mut push)? {
                true => sink.finish().map(|()| true),
                false => Ok(false),
            }
        });
        let mut ledger = lock(&self.reads);
        ledger.report.bytes_received += received;
        if let Ok(false) = result {
            ledger.report.misses += 1;
        }
        if let Err(Fault::Damaged(_)) = result {
            lock(&self.damaged).insert(key.to_owned());
        }
        result
    }

    /// Notes that the bytes under `key` came whole and are not what they should be.
    pub(crate) fn blame(&self, key: &str, why: &str) {
        lock(&self.damaged).insert(key.to_owned());
        lock(&self.reads).failed(format!("{key}: {why}"), Duration::ZERO, &self.options);
    }

    /// Notes that what lies under `key` is to be written over, if we write at all.
    pub(crate) fn disown(&self, key: String) {
        lock(&self.damaged).insert(key);
    }

    // --- writing ---

    /// Queues something to be sent.
    pub(crate) fn offer(&self, offer: Offer) {
        if self.writes() && lock(&self.cancel).is_some() {
            lock(&self.queue).offers.push_back(offer);
            self.changed.notify_all();
        }
    }

    /// The next offer, for a sending thread; `None` when there will be none.
    pub(crate) fn next_offer(&self) -> Option<Offer> {
        let mut queue = lock(&self.queue);
        loop {
            if self.give_up.load(Ordering::Relaxed) || self.is_left_alone() {
                return None;
            }
            if let Some(offer) = queue.offers.pop_front() {
                queue.at_work += 1;
                return Some(offer);
            }
            if queue.closed {
                return None;
            }
            queue = self.changed.wait(queue).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// The offer that a thread was at is sent, or is not to be.
    pub(crate) fn done_offer(&self) {
        lock(&self.queue).at_work -= 1;
        self.changed.notify_all();
    }

    /// Nothing more will be offered: waits until all is sent, at most for the options' bound, and not at all if the build was
    /// cancelled.
    pub(crate) fn finish_sending(&self) {
        let end = Instant::now() + self.options.upload_limit;
        let cancel = lock(&self.cancel).clone();
        let mut queue = lock(&self.queue);
        queue.closed = true;
        self.changed.notify_all();
        while !(queue.offers.is_empty() && queue.at_work == 0) {
            let cancelled = cancel.as_ref().is_some_and(|cancel| cancel.load(Ordering::Relaxed));
            let left = end.saturating_duration_since(Instant::now());
            if cancelled || left.is_zero() || self.is_left_alone() {
                break;
            }
            let wait = left.min(place::POLL);
            queue = self.changed.wait_timeout(queue, wait).unwrap_or_else(PoisonError::into_inner).0;
        }
        self.give_up.store(true, Ordering::Relaxed);
        self.changed.notify_all();
    }

    /// Whether `key` is there, and did not show itself damaged.
    pub(crate) fn has(&self, key: &str) -> Result<bool, Fault> {
        if lock(&self.damaged).contains(key) {
            return Ok(false);
        }
        self.request(&self.writes, &self.give_up, 0, |until| self.place.has(key, until))
    }

    /// Sends `bytes`; with `create` only if there is nothing. Whether what is there now is ours.
    pub(crate) fn send(&self, key: &str, bytes: &Arc<[u8]>, create: bool) -> Result<bool, Fault> {
        let create = create && !lock(&self.damaged).contains(key);
        let length = bytes.len() as u64;
        let ours =
            self.request(&self.writes, &self.give_up, length, |until| self.place.put(key, bytes, create, until))?;
        let mut ledger = lock(&self.writes);
        ledger.report.bytes_sent += if ours { length } else { 0 };
        Ok(ours)
    }

    /// Reads a small thing back while sending.
    pub(crate) fn peek(&self, key: &str, limit: u64) -> Result<Option<Vec<u8>>, Fault> {
        self.request(&self.writes, &self.give_up, 0, |until| {
            let mut bytes = Vec::new();
            let mut push = |part: &[u8]| {
                if bytes.len() as u64 + part.len() as u64 > limit {
                    return Err(Fault::Damaged(format!("{key} is longer than {limit} bytes")));
                }
                bytes.extend_from_slice(part);
                Ok(())
            };
            Ok(self.place.get(key, limit, until, &mut push)?.then_some(bytes))
        })
    }

    /// Counts a record that was sent with all its blobs.
    pub(crate) fn count_sent(&self) {
        lock(&self.writes).report.sent += 1;
    }

    // --- patience ---

    /// One request, tried a few times within its time limit, and entered in the ledger.
    fn request<T>(
        &self,
        ledger: &Mutex<Ledger>,
        cancel: &AtomicBool,
        sends: u64,
        mut attempt: impl FnMut(&Until<'_>) -> Result<T, Fault>,
    ) -> Result<T, Fault> {
        if self.is_left_alone() {
            return Err(Fault::LeftAlone);
        }
        let Some(patience) = lock(ledger).patience(&self.options) else { return Err(Fault::LeftAlone) };
        let begun = Instant::now();
        self.at_once.fetch_add(1, Ordering::Relaxed);
        let _done = Done(&self.at_once);
        // How far an upload is cannot be seen: it is excused in advance.
        let pace = Pace { moved: AtomicU64::new(sends), at_once: &self.at_once, rate: self.options.min_rate };
        let until = Until { begun, patience, pace, cancel };
        let mut pause = PAUSE;
        let mut tried = 0;
        let result = loop {
            tried += 1;
            match attempt(&until) {
                Err(Fault::Transient(_)) if tried < self.options.attempts && until.pause(pause) => pause *= 4,
                result => break result,
            }
        };
        let taken = begun.elapsed();
        let mut ledger = lock(ledger);
        match &result {
            Ok(_) => ledger.succeeded(taken.saturating_sub(FAIR.saturating_add(until.pace.excused())), &self.options),
            Err(Fault::Transient(why) | Fault::Damaged(why)) => ledger.failed(why.clone(), taken, &self.options),
            Err(Fault::Refused(why)) => ledger.refused(why.clone()),
            Err(Fault::Local(_) | Fault::Cancelled | Fault::LeftAlone) => {}
        }
        result
    }
}
