//! What lies in a cache, and whether it is whole.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use serde::Serialize;

use super::gc::files_in;
use super::record::{LONGEST_RECORD, decode, open_sealed};
use super::{Cache, Store};
use crate::error::IoError;
use crate::hash::{ContentHash, Fingerprint};
use crate::remote::claim::unsigned;
use crate::report::Record;

/// Files and their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// How many files.
    pub files: usize,
    /// Their bytes, headers included.
    pub bytes: u64,
}

/// What is known of one kind of stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct KindStats {
    /// The kind.
    pub kind: String,
    /// Runs on record.
    pub records: usize,
    /// Bytes of their outputs; an output that two runs gave counts twice.
    pub output_bytes: u64,
    /// Seconds that they took: what the cache may save.
    pub seconds: f64,
}

/// What lies in a cache.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CacheStats {
    /// Records of runs.
    pub records: Count,
    /// Lists of found files.
    pub lists: Count,
    /// Outputs.
    pub blobs: Count,
    /// Build states.
    pub states: Count,
    /// What did not verify.
    pub quarantine: Count,
    /// Files being written, or left by a killed build; those go after a day.
    pub temporary: Count,
    /// All of it, bytes.
    pub bytes: u64,
    /// Builds at work.
    pub leases: usize,
    /// By kind of stage, sorted.
    pub kinds: Vec<KindStats>,
}

/// What came of reading everything.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct VerifyReport {
    /// Whole records.
    pub records: usize,
    /// Whole lists.
    pub lists: usize,
    /// Whole blobs.
    pub blobs: usize,
    /// Bytes of the whole blobs.
    pub bytes: u64,
    /// Records of which an output is gone: the stage runs again if somebody reads that output.
    pub incomplete_records: usize,
    /// What was moved aside, in words.
    pub damaged: Vec<String>,
}

impl Cache {
    /// Counts what is there. Changes nothing but that it asks the file system's time if there is a cache.
    ///
    /// # Errors
    /// The cache folder cannot be used.
    pub fn stats(&self) -> Result<CacheStats, IoError> {
        let store = &self.store;
        if !self.exists() {
            return Ok(CacheStats::default());
        }
        let now = store.now()?;
        let count = |folder: &str| {
            let files = files_in(&store.root.join(folder));
            Count { files: files.len(), bytes: files.iter().map(|(_, bytes, _)| bytes).sum() }
        };
        let mut stats = CacheStats {
            records: count("actions"),
            lists: count("lists"),
            blobs: count("blobs"),
            states: count("state"),
            quarantine: count("quarantine"),
            temporary: count("tmp"),
            leases: store.oldest_lease(now).1,
            ..CacheStats::default()
        };
        let parts = [stats.records, stats.lists, stats.blobs, stats.states, stats.quarantine, stats.temporary];
        stats.bytes = parts.iter().map(|part| part.bytes).sum();
        let mut kinds: BTreeMap<String, KindStats> = BTreeMap::new();
        for (path, _, _) in files_in(&store.root.join("actions")) {
            let Some(record) = peek_record(&path) else { continue };
            let kind = kinds.entry(record.kind.clone()).or_default();
            kind.kind = record.kind;
            kind.records += 1;
            kind.output_bytes += record.outputs.iter().map(|output| output.length).sum::<u64>();
            kind.seconds += record.seconds;
        }
        stats.kinds = kinds.into_values().collect();
        Ok(stats)
    }

    /// Reads everything; moves aside what does not verify. Builders may be at work at the same time.
    ///
    /// # Errors
    /// The cache folder cannot be used.
    pub fn verify(&self) -> Result<VerifyReport, IoError> {
        let store = &self.store;
        let mut report = VerifyReport::default();
        if !self.exists() {
            return Ok(report);
        }
        store.prepare()?;
        store.take_warnings();
        for (path, _, _) in files_in(&store.root.join("blobs")) {
            match name_of::<ContentHash>(&path).filter(|hash| store.blob_path(hash) == path) {
                Some(hash) => {
                    if let Some(length) = store.verify_blob(&hash) {
                        report.blobs += 1;
                        report.bytes += length;
                    }
                }
                None => store.quarantine(&path, "file name"),
            }
        }
        for (path, _, _) in files_in(&store.root.join("actions")) {
            match name_of::<Fingerprint>(&path).filter(|fingerprint| store.record_path(fingerprint) == path) {
                Some(fingerprint) => {
                    if let Some(record) = store.local_record(&fingerprint) {
                        report.records += 1;
                        report.incomplete_records += usize::from(!store.has_all(&record));
                    }
                }
                None => store.quarantine(&path, "file name"),
            }
        }
        for (path, _, _) in files_in(&store.root.join("lists")) {
            report.lists += usize::from(store.read_sealed::<Vec<String>>(&path, "list").is_some());
        }
        report.damaged = store.take_warnings();
        Ok(report)
    }
}

impl Store {
    fn has_all(&self, record: &Record) -> bool {
        record.outputs.iter().all(|output| self.has_blob(&output.hash, output.length))
    }
}

fn name_of<T: std::str::FromStr>(path: &Path) -> Option<T> {
    path.file_name()?.to_str()?.parse().ok()
}

/// A record as it lies there; one that is damaged is left where it is.
pub(super) fn peek_record(path: &Path) -> Option<Record> {
    let short = fs::metadata(path).is_ok_and(|metadata| metadata.len() <= LONGEST_RECORD);
    let bytes = if short { fs::read(path).ok()? } else { return None };
    open_sealed(unsigned(&bytes)).and_then(decode)
}
