//! Contents of files, by reading them or by a memo of their stats.
//!
//! A memo entry `(path, stat) -> content` spares reading a file whose stat is the same again. It is made only if
//! - the stats before and after the file was read agree, and
//! - both its times are older than the clock's granularity, so that no later write can leave the stat as it is.
//!
//! The granularity is taken as 2 s: FAT stamps files in steps of 2 s, HFS+ and ext3 of 1 s, others finer. "Now" is the file
//! system's own ([`Store::now`](crate::store::Store::now)), of a moment before the first file of a build is read. A file written just before a build is thus
//! read again by the next build: that costs time, never truth.

use std::collections::HashMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::disk::{Stat, is_absent};
use crate::error::IoError;
use crate::hash::ContentHash;
use crate::index::{self, Index, Line};

/// Default granularity of file times, nanoseconds; see above.
pub(crate) const GRANULARITY: i64 = 2_000_000_000;

/// What this build found of one file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Seen {
    /// Its content; `None` if it is absent.
    pub(crate) hash: Option<ContentHash>,
    /// Its stat, if that may stand for its content from now on.
    pub(crate) stat: Option<Stat>,
}

impl Seen {
    /// The same as a line of the index.
    pub(crate) fn line(&self, path: &str) -> Line {
        let content = self.hash.map_or(index::Content::Absent, index::Content::Hash);
        let path = path.to_owned();
        Line { path, stat: self.stat, content, plan: false, folder: false, output: false, owners: Vec::new() }
    }
}

/// A file's bytes and their digest; `None` if it is absent.
pub(crate) type Content = Option<(Arc<[u8]>, ContentHash)>;

/// Whether reading ends: it does not of a pipe or of a device.
fn is_plain(metadata: &fs::Metadata) -> io::Result<()> {
    // What a folder is, the system says itself.
    if metadata.is_file() || metadata.is_dir() { Ok(()) } else { Err(io::Error::other("it is no regular file")) }
}

/// The files of one build; each is looked at once, so that one build sees one content.
pub(crate) struct Files<'a> {
    root: &'a Path,
    memo: Option<&'a Index>,
    /// Stats with times before this may be kept, nanoseconds since 1970 in the file system's time.
    settled_before: i64,
    seen: Mutex<HashMap<String, Seen>>,
    hashed: AtomicUsize,
}

impl<'a> Files<'a> {
    /// `now`: the file system's time before any file was read; where it is not known no stat is kept.
    pub(crate) fn new(root: &'a Path, memo: Option<&'a Index>, now: Option<i64>, granularity: i64) -> Files<'a> {
        let settled_before = now.map_or(i64::MIN, |now| now.saturating_sub(granularity));
        Files { root, memo, settled_before, seen: Mutex::default(), hashed: AtomicUsize::new(0) }
    }

    /// Number of files that were read to be hashed.
    pub(crate) fn hashed(&self) -> usize {
        self.hashed.load(Ordering::Relaxed)
    }

    /// All files looked at, sorted by path.
    pub(crate) fn into_seen(self) -> Vec<(String, Seen)> {
        let mut seen: Vec<_> = self.seen.into_inner().unwrap_or_else(PoisonError::into_inner).into_iter().collect();
        seen.sort_by(|a, b| a.0.cmp(&b.0));
        seen
    }

    fn remember(&self, path: &str, seen: Seen) {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).insert(path.to_owned(), seen);
    }

    /// The file now holds `hash`: this build wrote it. No stat is kept, since its times are of this moment.
    pub(crate) fn wrote(&self, path: &str, hash: ContentHash) {
        self.remember(path, Seen { hash: Some(hash), stat: None });
    }

    fn full(&self, path: &str) -> PathBuf {
        self.root.join(path)
    }

    fn settled(&self, before: Stat, after: Stat) -> Option<Stat> {
        (before == after && after.latest() < self.settled_before).then_some(after)
    }

    /// The content of the file at `path` (relative to the root), `None` if there is no such file.
    pub(crate) fn hash(&self, path: &str) -> Result<Option<ContentHash>, IoError> {
        if let Some(seen) = self.seen.lock().unwrap_or_else(PoisonError::into_inner).get(path) {
            return Ok(seen.hash);
        }
        let full = self.full(path);
        let seen = match fs::metadata(&full) {
            Err(error) if is_absent(&error) => Seen { hash: None, stat: None },
            Err(error) => return Err(IoError::new("look at", full)(error)),
            Ok(metadata) => {
                is_plain(&metadata).map_err(IoError::new("read", &full))?;
                let stat = Stat::of(&metadata);
                match self.memo.and_then(|memo| memo.memo(path)) {
                    Some((known, hash)) if known == stat => Seen { hash: Some(hash), stat: Some(stat) },
                    _ => self.read_and_hash(&full)?,
                }
            }
        };
        self.remember(path, seen);
        Ok(seen.hash)
    }

    fn read_and_hash(&self, full: &Path) -> Result<Seen, IoError> {
        let fail = |error| IoError::new("read", full)(error);
        let mut file = match File::open(full) {
            Err(error) if is_absent(&error) => return Ok(Seen { hash: None, stat: None }),
            other => other.map_err(fail)?,
        };
        let before = Stat::of(&file.metadata().map_err(fail)?);
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(&mut file).map_err(fail)?;
        let after = Stat::of(&file.metadata().map_err(fail)?);
        self.hashed.fetch_add(1, Ordering::Relaxed);
        let hash = ContentHash(*hasher.finalize().as_bytes());
        Ok(Seen { hash: Some(hash), stat: self.settled(before, after) })
    }

    /// The bytes of the file at `path`, hashed as they are, `None` if there is no such file.
    pub(crate) fn read(&self, path: &str) -> Result<Content, IoError> {
        let full = self.full(path);
        let read = || -> io::Result<(Vec<u8>, Stat, Stat)> {
            is_plain(&fs::metadata(&full)?)?;
            let mut file = File::open(&full)?;
            let before = Stat::of(&file.metadata()?);
            let mut bytes = Vec::new();
            io::Read::read_to_end(&mut file, &mut bytes)?;
            Ok((bytes, before, Stat::of(&file.metadata()?)))
        };
        match read() {
            Ok((bytes, before, after)) => {
                let hash = ContentHash::of(&bytes);
                self.remember(path, Seen { hash: Some(hash), stat: self.settled(before, after) });
                Ok(Some((bytes.into(), hash)))
            }
            Err(error) if is_absent(&error) => {
                self.remember(path, Seen { hash: None, stat: None });
                Ok(None)
            }
            Err(error) => Err(IoError::new("read", full)(error)),
        }
    }
}
