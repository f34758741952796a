//! The short way through a build without work: stats of everything it would look at, compared before anything is planned.
//!
//! The caller gives a *key*: a digest of all that makes the plan and is no file (the program's version, command-line settings,
//! numeric and device class). Files that make the plan (the pipeline, its parents) and folders whose listings it used (globs)
//! are stated like inputs. If the key and every stat are as they were at the end of a build without failure, then a build
//! would find all fresh: it would make the same plan, and memo every file.

use std::path::Path;

use crate::disk::{Stat, is_absent};
use crate::hash::ContentHash;

/// More files than this a thread are stated in parallel: a stat takes about 1 us, a thread 20.
const FILES_PER_THREAD: usize = 512;
/// Threads gain nothing beyond the kernel's own locks.
const MOST_THREADS: usize = 8;

/// What [`Engine::remember_noop`](crate::Engine::remember_noop) keeps beside the inputs and outputs of the plan.
#[derive(Clone, Debug)]
pub struct Noop {
    /// Digest of all that makes the plan and is no file.
    pub key: ContentHash,
    /// Files read to make the plan, relative to its root.
    pub files: Vec<String>,
    /// Folders listed to make the plan, relative to its root.
    pub folders: Vec<String>,
    /// Handed back by [`Engine::fast_noop_check`](crate::Engine::fast_noop_check), such as the summary to print.
    pub note: Vec<u8>,
}

/// One file and its stat; `None` if it was looked for and is absent.
pub(crate) type Watched = (String, Option<Stat>);

/// Stat of the file at `path`; `None` if it is absent, an error if that cannot be told.
pub(crate) fn stat(path: &Path) -> Result<Option<Stat>, std::io::Error> {
    match std::fs::metadata(path) {
        Ok(metadata) => Ok(Some(Stat::of(&metadata))),
        Err(error) if is_absent(&error) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The frame: key, note, then per file {path, present, stat}, all numbers little-endian.
pub(crate) fn to_bytes(key: &ContentHash, note: &[u8], watched: &[Watched]) -> Vec<u8> {
    let mut bytes = key.0.to_vec();
    push_bytes(&mut bytes, note);
    for (path, stat) in watched {
        push_bytes(&mut bytes, path.as_bytes());
        bytes.push(stat.is_some() as u8);
        let stat = stat.unwrap_or_default();
        for number in [stat.size, stat.mtime as u64, stat.ctime as u64, stat.inode, stat.device] {
            bytes.extend(number.to_le_bytes());
        }
    }
    bytes
}

fn push_bytes(bytes: &mut Vec<u8>, part: &[u8]) {
    bytes.extend((part.len() as u64).to_le_bytes());
    bytes.extend_from_slice(part);
}

/// The note, if the frame has this key and every file is as it was.
pub(crate) fn check(frame: &[u8], key: &ContentHash, root: &Path) -> Option<Vec<u8>> {
    let mut reader = Reader(frame);
    if reader.take(32)? != key.0 {
        return None;
    }
    let note = reader.part()?;
    let mut watched = Vec::new();
    while !reader.0.is_empty() {
        let path = std::str::from_utf8(reader.part()?).ok()?;
        let present = reader.take(1)? == [1];
        let mut number = || reader.number();
        let stat = Stat {
            size: number()?,
            mtime: number()? as i64,
            ctime: number()? as i64,
            inode: number()?,
            device: number()?,
        };
        watched.push((path, present.then_some(stat)));
    }
    all_same(&watched, root).then(|| note.to_vec())
}

fn all_same(watched: &[(&str, Option<Stat>)], root: &Path) -> bool {
    let same = |part: &[(&str, Option<Stat>)]| {
        part.iter().all(|(path, expected)| stat(&root.join(path)).is_ok_and(|found| found == *expected))
    };
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = watched.len().div_ceil(FILES_PER_THREAD).clamp(1, cores.min(MOST_THREADS));
    if threads == 1 {
        return same(watched);
    }
    std::thread::scope(|scope| {
        let parts = watched.chunks(watched.len().div_ceil(threads));
        let workers: Vec<_> = parts.map(|part| scope.spawn(move || same(part))).collect();
        workers.into_iter().all(|worker| worker.join().unwrap_or(false))
    })
}

struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (head, tail) = self.0.split_at_checked(count)?;
        self.0 = tail;
        Some(head)
    }

    fn number(&mut self) -> Option<u64> {
        self.take(8)?.try_into().ok().map(u64::from_le_bytes)
    }

    fn part(&mut self) -> Option<&'a [u8]> {
        let count = usize::try_from(self.number()?).ok()?;
        self.take(count)
    }
}
