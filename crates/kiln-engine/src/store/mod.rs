//! The content-addressed store: action records and blobs in files that many processes share without locks.
//!
//! ```text
//! CACHE/.gitignore, CACHEDIR.TAG
//! CACHE/v1/actions/<2 hex>/<fingerprint>      record of one run; created if new: the first writer wins
//! CACHE/v1/lists/<2 hex>/<declared>/<hash>    a list of files that an action found; several a declared fingerprint
//! CACHE/v1/blobs/<2 hex>/<hash>               {magic, type, codec version, raw length, hash} and the bytes
//! CACHE/v1/tmp/                               files being written; renamed or linked when whole
//! CACHE/v1/quarantine/                        what did not verify
//! CACHE/v1/locks/                             one lock an output, one a state file, one for gc
//! CACHE/v1/state/                             build-state files, one a pipeline
//! CACHE/v1/leases/                            heartbeats of builds that are at work
//! ```
//!
//! Nothing in it is trusted: a record, list or blob that does not verify is moved aside and is a miss; one that vanishes is a
//! miss. Blobs are written before the record that names them, so a kill leaves at worst litter. Without `sync` a power cut may
//! leave damaged files; they are found by their hashes. Outputs are copied out, never linked: an edited output cannot reach back.
//!
//! A file's time is when it was last used: a build dates what it reads, once. [`gc`](Cache::gc) goes by that.
//!
//! Parts: `record` (records and lists), `blob`, `lease` (who is at work), `through` (misses are asked of the [remote](crate::remote)),
//! `gc`, `survey` (`stats` and `verify`).
//!
//! # Limits
//! Records and blobs are one file each, not packed: a cache of a million blobs asks for a file system that likes them.
//! `sync` waits for a file's bytes, not for its folder's entry: a power cut may lose the newest names, which costs time.

mod blob;
mod gc;
mod lease;
mod record;
mod survey;
mod through;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, Metadata, OpenOptions, TryLockError};
use std::hash::{BuildHasher, RandomState};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::disk;
use crate::error::IoError;
use crate::hash::{ContentHash, Fingerprint};
use crate::remote::Remote;

pub(crate) use blob::{BLOB_HEADER, blob_header};
pub use gc::{GcOptions, GcReport};
use lease::Lease;
pub(crate) use record::{decode, encode, open_sealed, sealed};
pub use survey::{CacheStats, Count, KindStats, VerifyReport};

/// Folder of this layout; another layout takes another folder and leaves this one alone.
pub(crate) const LAYOUT: &str = "v1";

/// A temporary file of this age belongs to a process that is gone, nanoseconds: one day.
const LITTER_AGE: i64 = 86_400 * 1_000_000_000;

pub(crate) struct Store {
    cache: PathBuf,
    root: PathBuf,
    /// Tells this process' temporary files from others', on whatever machine.
    nonce: u64,
    counter: AtomicU64,
    warnings: Mutex<Vec<String>>,
    /// Held while a build is at work.
    lease: Mutex<Option<Lease>>,
    remote: Option<Remote>,
    /// Records that came from the remote during the last build.
    claims: Mutex<BTreeSet<Fingerprint>>,
    /// Lists that came from the remote, with what they were asked for.
    guesses: Mutex<BTreeMap<Vec<String>, Fingerprint>>,
    /// Caches that are read where this one lacks something, in order, and never written.
    layers: Vec<Store>,
    read_only: bool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Nothing under these locks can be left half by a panic.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Store {
    pub(crate) fn new(cache: PathBuf) -> Store {
        let nonce = RandomState::new().hash_one(std::process::id());
        let root = cache.join(LAYOUT);
        Store {
            cache,
            root,
            nonce,
            counter: AtomicU64::new(0),
            warnings: Mutex::default(),
            lease: Mutex::default(),
            remote: None,
            claims: Mutex::default(),
            guesses: Mutex::default(),
            layers: Vec::new(),
            read_only: false,
        }
    }

    /// Reads these cache folders too, and writes nothing into them.
    pub(crate) fn with_layers(mut self, folders: Vec<PathBuf>) -> Store {
        let layer = |folder| Store { read_only: true, ..Store::new(folder) };
        self.layers = folders.into_iter().map(layer).collect();
        self
    }

    /// Asks `remote` for what is not here, while a build is at work.
    pub(crate) fn with_remote(mut self, remote: Remote) -> Store {
        self.remote = Some(remote);
        self
    }

    /// Makes the folders.
    pub(crate) fn prepare(&self) -> Result<(), IoError> {
        for folder in ["tmp", "state", "locks", "leases"] {
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
        let (path, file) = self.lock_file(&format!("state {name}"))?;
        taken(&path, file)
    }

    /// The lock of garbage collection, if nobody has it.
    fn try_lock_gc(&self) -> Result<Option<File>, IoError> {
        let (path, file) = self.lock_file("gc")?;
        taken(&path, file)
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

    /// Removes temporary files and leases that a killed process left a day ago, and scratch caches that it left a week ago.
    fn sweep(&self, now: i64) {
        for folder in ["tmp", "leases"] {
            let Ok(entries) = fs::read_dir(self.root.join(folder)) else { continue };
            for entry in entries.flatten() {
                let Ok(metadata) = entry.metadata() else { continue };
                let age = now.saturating_sub(disk::mtime(&metadata));
                // What cannot be removed is litter, not damage.
                let _ = match metadata.is_dir() {
                    true if age > 7 * LITTER_AGE => fs::remove_dir_all(entry.path()),
                    false if age > LITTER_AGE => fs::remove_file(entry.path()),
                    _ => Ok(()),
                };
            }
        }
    }

    /// Something to say in the report.
    pub(crate) fn warn(&self, message: String) {
        lock(&self.warnings).push(message);
    }

    /// Warnings since the last call.
    pub(crate) fn take_warnings(&self) -> Vec<String> {
        let mut warnings = std::mem::take(&mut *lock(&self.warnings));
        warnings.extend(self.layers.iter().flat_map(Store::take_warnings));
        warnings
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
        if self.read_only {
            self.warn(format!("{}: damaged {what} {name} is not used", self.cache.display()));
            return;
        }
        let count = self.counter.fetch_add(1, Ordering::Relaxed);
        let aside = self.root.join("quarantine").join(format!("{name}-{:016x}-{count}", self.nonce));
        let moved = disk::create_folder(&self.root.join("quarantine")).and_then(|()| disk::rename(path, &aside));
        if moved.is_err() {
            // Another process was faster, or the folder is read-only: a miss all the same.
            let _ = disk::remove(path);
        }
        self.warn(format!("cache: damaged {what} {name} moved aside; it will be made again"));
    }

    /// Dates a file that this build uses, so that gc spares it: at most once a build.
    fn used(&self, path: &Path, metadata: &Metadata) {
        if let Some(lease) = &*lock(&self.lease)
            && disk::mtime(metadata) < lease.start
        {
            disk::set_mtime(path, lease.now());
        }
    }

    fn sharded(&self, folder: &str, hex: &str) -> PathBuf {
        self.root.join(folder).join(hex.split_at(2).0).join(hex)
    }
}

/// The file if its lock could be had; `None` if another has it.
fn taken(path: &Path, file: File) -> Result<Option<File>, IoError> {
    match file.try_lock() {
        Ok(()) => Ok(Some(file)),
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(error)) => Err(IoError::new("lock", path)(error)),
    }
}

/// A cache folder, for those who look after it: the same files that an [`Engine`](crate::Engine) works on, at the same time.
pub struct Cache {
    store: Store,
}

impl Cache {
    /// The cache in `folder`, such as `.kiln`. Reads and writes nothing yet.
    pub fn open(folder: impl Into<PathBuf>) -> Cache {
        Cache { store: Store::new(folder.into()) }
    }

    /// Whether a cache of this layout is there.
    pub fn exists(&self) -> bool {
        self.store.root.is_dir()
    }
}
