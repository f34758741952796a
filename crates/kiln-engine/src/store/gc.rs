//! Garbage collection by size and age, beside builds at work.
//!
//! ```text
//! now, oldest lease alive := by the file server's clock
//! for each file of records, lists, blobs, quarantine:  used := its time, or that of a build state that names it, the later
//! spare what is pinned, what was used since the oldest lease began, what a record that was so used names, and while any lease is
//!     alive what a build state names
//! of the rest, longest unused first (quarantine before all):  remove what is older than `max_age`;
//!     then go on until the whole is at most `max_bytes`
//! just before a file is removed look again: one that was used meanwhile stays
//! ```
//! A record may outlive its blobs: it still tells that a stage need not run as long as nobody reads its output. A builder that
//! meets a missing blob runs the stage again. So a wrong choice costs time, and no lock is needed against builders.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;

use super::survey::peek_record;
use super::{Cache, Store};
use crate::disk;
use crate::error::IoError;
use crate::hash::ContentHash;
use crate::state::{Last, State};

/// What shall be left.
#[derive(Clone, Debug, Default)]
pub struct GcOptions {
    /// Bytes of all records, lists, blobs and quarantined files that may stay; `None`: any number.
    pub max_bytes: Option<u64>,
    /// What was not used for so long goes; `None`: never for its age.
    pub max_age: Option<Duration>,
    /// Outputs, as pipelines name them or with folders before that: whatever their last build read or made stays.
    pub pins: Vec<String>,
    /// Remove nothing, only say what would go.
    pub dry_run: bool,
}

/// What a garbage collection did, or would do.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct GcReport {
    /// Files before.
    pub files: usize,
    /// Bytes before.
    pub bytes: u64,
    /// Files removed.
    pub removed_files: usize,
    /// Bytes removed.
    pub removed_bytes: u64,
    /// Bytes that a build at work may use; spared.
    pub in_use_bytes: u64,
    /// Bytes pinned; spared.
    pub pinned_bytes: u64,
    /// Bytes above `max_bytes` that are left because they are in use or pinned.
    pub over_bytes: u64,
    /// Pins that no build state of this cache knows.
    pub unknown_pins: Vec<String>,
    /// Another collection is at work; this one did nothing.
    pub busy: bool,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Spared {
    No,
    InUse,
    Pinned,
}

struct Entry {
    path: PathBuf,
    bytes: u64,
    /// The file's own time, to be compared just before it is removed.
    time: i64,
    /// When it was last used.
    used: i64,
    quarantined: bool,
    spared: Spared,
}

/// What build states name: when they were last written, and whether a pin holds it.
type Named = BTreeMap<PathBuf, (i64, bool)>;

impl Cache {
    /// Removes what is unused. Builders may be at work at the same time.
    ///
    /// # Errors
    /// The cache folder cannot be used; a single file that cannot be removed is left.
    pub fn gc(&self, options: &GcOptions) -> Result<GcReport, IoError> {
        let store = &self.store;
        store.prepare()?;
        let Some(_lock) = store.try_lock_gc()? else {
            return Ok(GcReport { busy: true, ..GcReport::default() });
        };
        let now = store.now()?;
        let mut report = GcReport::default();
        let (oldest, _) = store.oldest_lease(now);
        let named = store.named_by_states(&options.pins, &mut report.unknown_pins);
        let mut entries = store.entries(oldest, &named);
        // Longest unused first; equal times by path, so that every collection chooses alike.
        entries.sort_by(|a, b| (!a.quarantined, a.used, &a.path).cmp(&(!b.quarantined, b.used, &b.path)));
        report.files = entries.len();
        report.bytes = entries.iter().map(|entry| entry.bytes).sum();
        let cutoff = options.max_age.map(|age| now.saturating_sub(i64::try_from(age.as_nanos()).unwrap_or(i64::MAX)));
        let mut left = report.bytes;
        for entry in &entries {
            let too_old = cutoff.is_some_and(|cutoff| entry.used < cutoff);
            let too_much = options.max_bytes.is_some_and(|most| left > most);
            match entry.spared {
                Spared::InUse => report.in_use_bytes += entry.bytes,
                Spared::Pinned => report.pinned_bytes += entry.bytes,
                Spared::No if (too_old || too_much) && (options.dry_run || still_unused(entry)) => {
                    if !options.dry_run && disk::remove(&entry.path).is_err() {
                        continue;
                    }
                    left -= entry.bytes;
                    report.removed_files += 1;
                    report.removed_bytes += entry.bytes;
                }
                Spared::No => {}
            }
        }
        report.over_bytes = options.max_bytes.map_or(0, |most| left.saturating_sub(most));
        Ok(report)
    }
}

/// Whether nobody used it since it was looked at.
fn still_unused(entry: &Entry) -> bool {
    fs::metadata(&entry.path).is_ok_and(|metadata| disk::mtime(&metadata) == entry.time)
}

/// Whether a pin means this output: the same path, or the same with folders before it.
fn pins(pin: &str, output: &str) -> bool {
    let pin = pin.replace('\\', "/");
    let pin = pin.strip_prefix("./").unwrap_or(&pin);
    pin == output || pin.strip_suffix(output).is_some_and(|before| before.ends_with('/'))
}

impl Store {
    /// Every file that the build states name.
    fn named_by_states(&self, wanted: &[String], unknown: &mut Vec<String>) -> Named {
        let mut named = Named::new();
        let mut met = BTreeSet::new();
        for (path, _, time) in files_in(&self.root.join("state")) {
            let mut state = State::new(path);
            state.load();
            for (id, last) in state.lasts() {
                let output = id.split('#').next().unwrap_or_default();
                let by: Vec<&str> = wanted.iter().map(String::as_str).filter(|pin| pins(pin, output)).collect();
                let pinned = !by.is_empty();
                met.extend(by);
                for path in self.paths_of(last) {
                    let known = named.entry(path).or_insert((time, pinned));
                    *known = (known.0.max(time), known.1 || pinned);
                }
            }
        }
        unknown.extend(wanted.iter().filter(|pin| !met.contains(pin.as_str())).cloned());
        named
    }

    /// The files that hold what is known of an action's last run.
    fn paths_of(&self, last: &Last) -> Vec<PathBuf> {
        let declared = last.manifest.with_discovered(&[]).fingerprint();
        let list: Vec<&str> = last.record.discovered.iter().map(|(path, _)| path.as_str()).collect();
        let list = ContentHash::of(list.join("\n").as_bytes()).hex();
        let mut paths = vec![self.record_path(&last.record.fingerprint), self.list_folder(&declared).join(list)];
        paths.extend(last.record.outputs.iter().map(|output| self.blob_path(&output.hash)));
        paths
    }

    fn entries(&self, oldest: Option<i64>, named: &Named) -> Vec<Entry> {
        let mut entries = Vec::new();
        // Outputs of records that a build at work found: it may read them next.
        let mut wanted = BTreeSet::new();
        for folder in ["actions", "lists", "blobs", "quarantine"] {
            for (path, bytes, time) in files_in(&self.root.join(folder)) {
                let by_state = named.get(&path);
                let used = by_state.map_or(time, |(at, _)| time.max(*at));
                let young = oldest.is_some_and(|start| time >= start);
                if young && folder == "actions" {
                    let outputs = peek_record(&path).map(|record| record.outputs).unwrap_or_default();
                    wanted.extend(outputs.iter().map(|output| self.blob_path(&output.hash)));
                }
                let in_use = young || wanted.contains(&path) || oldest.is_some() && by_state.is_some();
                let spared = match by_state {
                    Some((_, true)) => Spared::Pinned,
                    _ if in_use && folder != "quarantine" => Spared::InUse,
                    _ => Spared::No,
                };
                entries.push(Entry { path, bytes, time, used, quarantined: folder == "quarantine", spared });
            }
        }
        entries
    }
}

/// All files under a folder: path, length in bytes, time. What vanishes meanwhile is left out.
pub(super) fn files_in(folder: &Path) -> Vec<(PathBuf, u64, i64)> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            let Ok(metadata) = entry.metadata() else { continue };
            if metadata.is_dir() {
                open.push(entry.path());
            } else {
                found.push((entry.path(), metadata.len(), disk::mtime(&metadata)));
            }
        }
    }
    found.sort();
    found
}
