//! Records of runs and lists of found files: small, sealed by the hash of their bytes.

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Serialize, de::DeserializeOwned};

use super::Store;
use crate::disk;
use crate::error::IoError;
use crate::hash::{ContentHash, Fingerprint};
use crate::remote::claim::unsigned;
use crate::report::Record;

/// Longest record or list, bytes: they hold names, hashes and a stage's report.
const RECORD_LIMIT: usize = 64 << 20;

/// Most lists that are tried for one declared fingerprint. More would mean an action whose files change names at every run.
const LIST_LIMIT: usize = 64;

const RECORD_MAGIC: &[u8; 8] = b"kilnrec1";
/// Magic and seal.
const SEALED: usize = 8 + 32;
/// Longest file of a record or list, bytes.
pub(super) const LONGEST_RECORD: u64 = (RECORD_LIMIT + SEALED) as u64;

impl Store {
    pub(super) fn record_path(&self, fingerprint: &Fingerprint) -> PathBuf {
        self.sharded("actions", &fingerprint.hex())
    }

    /// The record of a run with this fingerprint; one that is neither here nor in a layer is asked of the remote.
    pub(crate) fn record(&self, fingerprint: &Fingerprint) -> Option<Record> {
        let near = std::iter::once(self).chain(&self.layers).find_map(|store| store.local_record(fingerprint));
        near.or_else(|| self.claimed_record(fingerprint))
    }

    pub(super) fn local_record(&self, fingerprint: &Fingerprint) -> Option<Record> {
        let path = self.record_path(fingerprint);
        let record: Record = self.read_sealed(&path, "record")?;
        if record.fingerprint != *fingerprint {
            self.quarantine(&path, "record");
            return None;
        }
        Some(record)
    }

    /// Keeps a record; `replace` only if the one there is known to be dead. Returns whether it is ours.
    pub(crate) fn put_record(&self, record: &Record, replace: bool, sync: bool) -> Result<bool, IoError> {
        let ours = self.put_local_record(record, replace, sync)?;
        if ours {
            self.offer_record(record.fingerprint, replace);
        }
        Ok(ours)
    }

    pub(super) fn put_local_record(&self, record: &Record, replace: bool, sync: bool) -> Result<bool, IoError> {
        self.write_sealed(&self.record_path(&record.fingerprint), record, replace, sync)
    }

    pub(super) fn list_folder(&self, declared: &Fingerprint) -> PathBuf {
        self.sharded("lists", &declared.hex())
    }

    /// The lists of files that actions with this declared fingerprint found, in order of their hashes.
    pub(super) fn local_lists(&self, declared: &Fingerprint) -> Vec<Vec<String>> {
        let Ok(entries) = fs::read_dir(self.list_folder(declared)) else { return Vec::new() };
        let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        paths.sort();
        paths.truncate(LIST_LIMIT);
        paths.iter().filter_map(|path| self.read_sealed(path, "list")).collect()
    }

    /// Local lists, then the layers', then, if those are used up, the remote's.
    pub(crate) fn lists(&self, declared: &Fingerprint) -> impl Iterator<Item = Vec<String>> {
        let declared = *declared;
        self.local_lists(&declared)
            .into_iter()
            .chain(self.layers.iter().flat_map(move |layer| layer.local_lists(&declared)))
            .chain(self.claimed_lists(declared))
    }

    /// Keeps a list of files.
    pub(crate) fn put_list(&self, declared: &Fingerprint, list: &[String], sync: bool) -> Result<(), IoError> {
        if self.put_local_list(declared, list, sync)? {
            self.offer_list(*declared, list);
        }
        Ok(())
    }

    pub(super) fn put_local_list(&self, declared: &Fingerprint, list: &[String], sync: bool) -> Result<bool, IoError> {
        let name = ContentHash::of(list.join("\n").as_bytes()).hex();
        let path = self.list_folder(declared).join(name);
        match fs::metadata(&path) {
            Ok(metadata) => {
                self.used(&path, &metadata);
                Ok(false)
            }
            Err(_) => self.write_sealed(&path, &list.to_vec(), false, sync),
        }
    }

    fn write_sealed<T: Serialize>(&self, path: &Path, value: &T, replace: bool, sync: bool) -> Result<bool, IoError> {
        if let Some(folder) = path.parent() {
            disk::create_folder(folder)?;
        }
        let temporary = self.write_temporary(&[&sealed(value)], sync)?;
        let named =
            if replace { disk::rename(&temporary, path).map(|()| true) } else { disk::rename_if_new(&temporary, path) };
        if named.is_err() {
            let _ = disk::remove(&temporary);
        }
        named
    }

    pub(super) fn read_sealed<T: DeserializeOwned>(&self, path: &Path, what: &str) -> Option<T> {
        let metadata = fs::metadata(path).ok()?;
        let short = metadata.is_file() && metadata.len() <= LONGEST_RECORD;
        let bytes = if short { fs::read(path).ok()? } else { Vec::new() };
        let value = open_sealed(unsigned(&bytes)).and_then(decode);
        match value {
            Some(_) => self.used(path, &metadata),
            None => self.quarantine(path, what),
        }
        value
    }
}

/// Magic, the hash of the payload, the payload.
pub(crate) fn sealed<T: Serialize>(value: &T) -> Vec<u8> {
    let payload = encode(value);
    [&RECORD_MAGIC[..], &ContentHash::of(&payload).0, &payload].concat()
}

/// The payload of sealed bytes.
pub(crate) fn open_sealed(bytes: &[u8]) -> Option<&[u8]> {
    let rest = bytes.strip_prefix(RECORD_MAGIC)?;
    let (seal, payload) = rest.split_at_checked(32)?;
    (ContentHash::of(payload).0[..] == *seal).then_some(payload)
}

/// Encodes a small record.
pub(crate) fn encode<T: Serialize>(value: &T) -> Vec<u8> {
    bincode::serde::encode_to_vec(value, bincode::config::legacy())
        .expect("invariant: plain records in memory always encode")
}

/// Decodes a small record; `None` if the bytes are not exactly one.
///
/// What the decoder may allocate is bounded by a multiple of what there is to decode, whatever lengths the bytes claim.
pub(crate) fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    match bytes.len() {
        0..=0x1000 => decode_within::<T, 0x2000>(bytes),
        0x1001..=0x2_0000 => decode_within::<T, 0x4_0000>(bytes),
        _ => decode_within::<T, RECORD_LIMIT>(bytes),
    }
}

fn decode_within<T: DeserializeOwned, const LIMIT: usize>(bytes: &[u8]) -> Option<T> {
    let config = bincode::config::legacy().with_limit::<LIMIT>();
    let (value, used) = bincode::serde::decode_from_slice(bytes, config).ok()?;
    (used == bytes.len()).then_some(value)
}
