//! The content-addressed store: action records and blobs in files that many processes share without locks.
//!
//! ```text
//! CACHE/.gitignore, CACHEDIR.TAG
//! CACHE/v1/actions/<2 hex>/<fingerprint>      record of one run; created if new: the first writer wins
//! CACHE/v1/lists/<2 hex>/<declared>/<hash>    a list of files that an action found; several a declared fingerprint
//! CACHE/v1/blobs/<2 hex>/<hash>               {magic, type, codec version, raw length, hash} and the bytes
//! CACHE/v1/tmp/                               files being written; renamed or linked when whole
//! CACHE/v1/quarantine/                        what did not verify
//! CACHE/v1/locks/                             one lock an output, one a state file
//! CACHE/v1/state/                             build-state files, one a pipeline
//! ```
//!
//! Nothing in it is trusted: a record, list or blob that does not verify is moved aside and is a miss; one that vanishes is a
//! miss. Blobs are written before the record that names them, so a kill leaves at worst litter. Without `sync` a power cut may
//! leave damaged files; they are found by their hashes.

use std::fs::{self, File, OpenOptions};
use std::hash::{BuildHasher, RandomState};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Serialize, de::DeserializeOwned};

use crate::disk;
use crate::error::IoError;
use crate::hash::{ContentHash, Fingerprint};
use crate::report::Record;

/// Folder of this layout; another layout takes another folder and leaves this one alone.
const LAYOUT: &str = "v1";

/// Longest record or list, bytes: they hold names, hashes and a stage's report.
const RECORD_LIMIT: usize = 64 << 20;

/// Most lists that are tried for one declared fingerprint. More would mean an action whose files change names at every run.
const LIST_LIMIT: usize = 64;

/// A temporary file of this age belongs to a process that is gone, nanoseconds: one day.
const LITTER_AGE: i64 = 86_400 * 1_000_000_000;

const RECORD_MAGIC: &[u8; 8] = b"kilnrec1";
const BLOB_MAGIC: &[u8; 8] = b"kilnblob";
/// Blob type: an action's output.
const BLOB_TYPE: u32 = 0;
/// Codec: stored as it is.
const BLOB_CODEC: u32 = 0;
/// Magic, type, codec, raw length, hash.
const BLOB_HEADER: usize = 8 + 4 + 4 + 8 + 32;

pub(crate) struct Store {
    cache: PathBuf,
    root: PathBuf,
    /// Tells this process' temporary files from others', on whatever machine.
    nonce: u64,
    counter: AtomicU64,
    warnings: Mutex<Vec<String>>,
}

impl Store {
    pub(crate) fn new(cache: PathBuf) -> Store {
        let nonce = RandomState::new().hash_one(std::process::id());
        let root = cache.join(LAYOUT);
        Store { cache, root, nonce, counter: AtomicU64::new(0), warnings: Mutex::default() }
    }

    /// Makes the folders.
    pub(crate) fn prepare(&self) -> Result<(), IoError> {
        for folder in ["tmp", "state", "locks"] {
            disk::create_folder(&self.root.join(folder))?;
        }
        for (name, text) in [
            (".gitignore", "*\n"),
            (
                "CACHEDIR.TAG",
                "Signature: 8a477f597d28d172789f06886806bc55\n# This folder is kiln's cache; it may be deleted at any time.\n",
            ),
        ] {
            let path = self.cache.join(name);
            if !path.exists() {
                let temporary = self.write_temporary(&[text.as_bytes()], false)?;
                disk::rename_if_new(&temporary, &path)?;
            }
        }
        Ok(())
    }

    /// Where the state file of `name` lies.
    pub(crate) fn state_path(&self, name: &str) -> PathBuf {
        self.root.join("state").join(name)
    }

    fn lock_file(&self, name: &str) -> Result<(PathBuf, File), IoError> {
        let path = self.root.join("locks").join(ContentHash::of(name.as_bytes()).hex().split_at(16).0);
        let open = OpenOptions::new().write(true).create(true).truncate(false).open(&path);
        let file = open.map_err(IoError::new("open", &path))?;
        Ok((path, file))
    }

    /// Waits for the lock of an output; held until the file is dropped.
    pub(crate) fn lock(&self, output: &str) -> Result<File, IoError> {
        let (path, file) = self.lock_file(output)?;
        file.lock().map_err(IoError::new("lock", &path))?;
        Ok(file)
    }

    /// The lock of a state file, if nobody has it.
    pub(crate) fn try_lock(&self, state: &Path) -> Result<Option<File>, IoError> {
        let name = state.file_name().unwrap_or_default().to_string_lossy();
        let (_, file) = self.lock_file(&format!("state {name}"))?;
        Ok(file.try_lock().is_ok().then_some(file))
    }

    /// What the file system of the cache takes for now, nanoseconds since 1970: the time of a file just written.
    ///
    /// The engine asks no clock: a file server's may differ, and it is the server that stamps files.
    pub(crate) fn now(&self) -> Result<i64, IoError> {
        let path = self.write_temporary(&[b"now"], false)?;
        let metadata = fs::metadata(&path).map_err(IoError::new("look at", &path))?;
        disk::remove(&path)?;
        let now = disk::mtime(&metadata);
        self.sweep(now);
        Ok(now)
    }

    /// Removes temporary files that a killed process left a day ago.
    fn sweep(&self, now: i64) {
        let Ok(entries) = fs::read_dir(self.root.join("tmp")) else { return };
        for entry in entries.flatten() {
            let old = entry.metadata().is_ok_and(|metadata| disk::mtime(&metadata) < now - LITTER_AGE);
            if old {
                let _ = fs::remove_file(entry.path());
            }
        }
    }

    /// Something to say in the report.
    pub(crate) fn warn(&self, message: String) {
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).push(message);
    }

    /// Warnings since the last call.
    pub(crate) fn take_warnings(&self) -> Vec<String> {
        std::mem::take(&mut *self.warnings.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn temporary(&self) -> PathBuf {
        let count = self.counter.fetch_add(1, Ordering::Relaxed);
        self.root.join("tmp").join(format!("{:016x}-{count}", self.nonce))
    }

    pub(crate) fn write_temporary(&self, parts: &[&[u8]], sync: bool) -> Result<PathBuf, IoError> {
        let path = self.temporary();
        match disk::write(&path, parts, sync) {
            Ok(()) => Ok(path),
            Err(error) => {
                // A full disk must not stay full of halves.
                let _ = disk::remove(&path);
                Err(error)
            }
        }
    }

    /// Moves a file aside that did not verify.
    fn quarantine(&self, path: &Path, what: &str) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let count = self.counter.fetch_add(1, Ordering::Relaxed);
        let aside = self.root.join("quarantine").join(format!("{name}-{:016x}-{count}", self.nonce));
        let moved = disk::create_folder(&self.root.join("quarantine")).and_then(|()| disk::rename(path, &aside));
        if moved.is_err() {
            // Another process was faster, or the folder is read-only: a miss all the same.
            let _ = disk::remove(path);
        }
        self.warn(format!("cache: damaged {what} {name} moved aside; it will be made again"));
    }

    fn sharded(&self, folder: &str, hex: &str) -> PathBuf {
        self.root.join(folder).join(hex.split_at(2).0).join(hex)
    }

    // --- records and lists ---

    fn record_path(&self, fingerprint: &Fingerprint) -> PathBuf {
        self.sharded("actions", &fingerprint.hex())
    }

    /// The record of a run with this fingerprint.
    pub(crate) fn record(&self, fingerprint: &Fingerprint) -> Option<Record> {
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
        let path = self.record_path(&record.fingerprint);
        self.write_sealed(&path, record, replace, sync)
    }

    /// The lists of files that actions with this declared fingerprint found, in order of their hashes.
    pub(crate) fn lists(&self, declared: &Fingerprint) -> Vec<Vec<String>> {
        let folder = self.sharded("lists", &declared.hex());
        let Ok(entries) = fs::read_dir(&folder) else { return Vec::new() };
        let mut paths: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        paths.sort();
        paths.truncate(LIST_LIMIT);
        paths.iter().filter_map(|path| self.read_sealed(path, "list")).collect()
    }

    /// Keeps a list of files.
    pub(crate) fn put_list(&self, declared: &Fingerprint, list: &[String], sync: bool) -> Result<(), IoError> {
        let name = ContentHash::of(list.join("\n").as_bytes()).hex();
        let path = self.sharded("lists", &declared.hex()).join(name);
        if !path.exists() {
            self.write_sealed(&path, &list.to_vec(), false, sync)?;
        }
        Ok(())
    }

    fn write_sealed<T: Serialize>(&self, path: &Path, value: &T, replace: bool, sync: bool) -> Result<bool, IoError> {
        let payload = encode(value);
        let seal = ContentHash::of(&payload);
        if let Some(folder) = path.parent() {
            disk::create_folder(folder)?;
        }
        let temporary = self.write_temporary(&[RECORD_MAGIC, &seal.0, &payload], sync)?;
        if replace { disk::rename(&temporary, path).map(|()| true) } else { disk::rename_if_new(&temporary, path) }
    }

    fn read_sealed<T: DeserializeOwned>(&self, path: &Path, what: &str) -> Option<T> {
        let bytes = fs::read(path).ok()?;
        let value = open_sealed(&bytes).and_then(decode);
        if value.is_none() {
            self.quarantine(path, what);
        }
        value
    }

    // --- blobs ---

    fn blob_path(&self, hash: &ContentHash) -> PathBuf {
        self.sharded("blobs", &hash.hex())
    }

    /// Whether a blob seems to be there; only reading it tells.
    pub(crate) fn has_blob(&self, hash: &ContentHash, length: u64) -> bool {
        fs::metadata(self.blob_path(hash)).is_ok_and(|metadata| metadata.len() == length + BLOB_HEADER as u64)
    }

    /// Keeps `bytes`, whose digest is `hash`.
    pub(crate) fn put_blob(&self, hash: &ContentHash, bytes: &[u8], sync: bool) -> Result<(), IoError> {
        if self.has_blob(hash, bytes.len() as u64) {
            return Ok(());
        }
        let path = self.blob_path(hash);
        if let Some(folder) = path.parent() {
            disk::create_folder(folder)?;
        }
        let temporary = self.write_temporary(&[&blob_header(hash, bytes.len() as u64), bytes], sync)?;
        disk::rename(&temporary, &path)
    }

    /// The bytes whose digest is `hash`, or `None` for a miss.
    pub(crate) fn blob(&self, hash: &ContentHash) -> Option<Arc<[u8]>> {
        let path = self.blob_path(hash);
        let mut file = File::open(&path).ok()?;
        let bytes = read_blob(&mut file, hash);
        if bytes.is_none() {
            self.quarantine(&path, "blob");
        }
        bytes
    }
}

fn blob_header(hash: &ContentHash, length: u64) -> Vec<u8> {
    let mut header = BLOB_MAGIC.to_vec();
    header.extend(BLOB_TYPE.to_le_bytes());
    header.extend(BLOB_CODEC.to_le_bytes());
    header.extend(length.to_le_bytes());
    header.extend(hash.0);
    header
}

/// Reads and verifies a blob file; allocates what the file's own length justifies.
fn read_blob(file: &mut File, hash: &ContentHash) -> Option<Arc<[u8]>> {
    let length = file.metadata().ok()?.len().checked_sub(BLOB_HEADER as u64)?;
    let mut header = [0; BLOB_HEADER];
    file.read_exact(&mut header).ok()?;
    if header[..] != blob_header(hash, length)[..] {
        return None;
    }
    // Collecting zeros fills the shared slice in place: a blob of hundreds of megabytes is not copied once more.
    let mut bytes: Arc<[u8]> = std::iter::repeat_n(0, usize::try_from(length).ok()?).collect();
    file.read_exact(Arc::get_mut(&mut bytes)?).ok()?;
    (ContentHash::of(&bytes) == *hash).then_some(bytes)
}

/// Encodes a small record.
pub(crate) fn encode<T: Serialize>(value: &T) -> Vec<u8> {
    bincode::serde::encode_to_vec(value, bincode::config::legacy())
        .expect("invariant: plain records in memory always encode")
}

/// Decodes a small record; `None` if the bytes are not exactly one.
pub(crate) fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let config = bincode::config::legacy().with_limit::<RECORD_LIMIT>();
    let (value, used) = bincode::serde::decode_from_slice(bytes, config).ok()?;
    (used == bytes.len()).then_some(value)
}

fn open_sealed(bytes: &[u8]) -> Option<&[u8]> {
    let rest = bytes.strip_prefix(RECORD_MAGIC)?;
    let (seal, payload) = rest.split_at_checked(32)?;
    (ContentHash::of(payload).0[..] == *seal).then_some(payload)
}
