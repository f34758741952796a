//! When to leave a remote alone: failures and lost time of one build, counted.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::RemoteOptions;

/// Failures in a row after which a remote is left alone.
const MOST_IN_A_ROW: u32 = 3;
/// Failures in all after which a remote is left alone.
const MOST_IN_ALL: usize = 10;

/// What a remote did for a build.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemoteReport {
    /// Records that were taken with all their blobs.
    pub hits: usize,
    /// Requests for what the remote has not.
    pub misses: usize,
    /// Bytes that came, headers of the store's files included.
    pub bytes_received: u64,
    /// Records that were taken and recomputed, where that was asked for.
    #[serde(default)]
    pub checked: usize,
    /// Of those, records that claimed other bytes than running the stage gives.
    #[serde(default)]
    pub refuted: usize,
    /// Records that were sent with all their blobs.
    pub sent: usize,
    /// Bytes that were sent.
    pub bytes_sent: u64,
    /// Requests that failed after all attempts, or gave what does not verify.
    pub failures: usize,
    /// Whether it was left alone from some moment on.
    pub left_alone: bool,
}

impl RemoteReport {
    /// Adds what it did for another build.
    pub fn add(&mut self, other: &RemoteReport) {
        self.hits += other.hits;
        self.misses += other.misses;
        self.bytes_received += other.bytes_received;
        self.checked += other.checked;
        self.refuted += other.refuted;
        self.sent += other.sent;
        self.bytes_sent += other.bytes_sent;
        self.failures += other.failures;
        self.left_alone |= other.left_alone;
    }
}

#[derive(Default)]
pub(super) struct Ledger {
    pub(super) report: RemoteReport,
    in_a_row: u32,
    /// Time spent on failures, and on answers beyond what is fair.
    lost: Duration,
    last: String,
}

impl Ledger {
    /// How long the next request may take beside its transfer; `None` if there shall be none.
    pub(super) fn patience(&self, options: &RemoteOptions) -> Option<Duration> {
        if self.report.left_alone {
            return None;
        }
        Some(options.request_limit.min(options.lost_limit.saturating_sub(self.lost)))
    }

    pub(super) fn succeeded(&mut self, beyond_fair: Duration, options: &RemoteOptions) {
        self.in_a_row = 0;
        self.lose(beyond_fair, options, "it is too slow");
    }

    pub(super) fn failed(&mut self, why: String, taken: Duration, options: &RemoteOptions) {
        self.report.failures += 1;
        self.in_a_row += 1;
        self.report.left_alone |= self.in_a_row >= MOST_IN_A_ROW || self.report.failures >= MOST_IN_ALL;
        self.lose(taken, options, &why);
        self.last = why;
    }

    /// It says no: it will say so again.
    pub(super) fn refused(&mut self, why: String) {
        self.report.failures += 1;
        self.report.left_alone = true;
        self.last = why;
    }

    fn lose(&mut self, time: Duration, options: &RemoteOptions, why: &str) {
        self.lost += time;
        if self.lost >= options.lost_limit && !self.report.left_alone {
            self.report.left_alone = true;
            self.last = format!("{why}; {:.1} s were lost", self.lost.as_secs_f64());
        }
    }

    /// The one sentence about all trouble.
    pub(super) fn warning(&self, address: &str, verb: &str, comfort: &str) -> Option<String> {
        let last = &self.last;
        if self.report.left_alone {
            return Some(format!("remote cache {address} was no longer {verb}: {last}; {comfort}"));
        }
        let failures = self.report.failures;
        (failures > 0).then(|| format!("remote cache {address}: {failures} requests failed ({last}); {comfort}"))
    }
}
