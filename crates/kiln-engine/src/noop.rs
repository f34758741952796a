//! The short way through a build: which assets does anything that changed belong to?
//!
//! The caller gives a *key*: a digest of all that makes the plan and is no file (the program's version, command-line settings,
//! numeric class). Files that make the plan (the pipeline, its parents) and folders whose listings it used (globs) are looked
//! at like inputs.
//!
//! ```text
//! index := what the last build left                       none, or of another key: look closer at all
//! for each entry, on 2 threads: stat it                   absent or of the same stat as then: as it was
//! for each other entry: hash its bytes (a folder: its listing)
//! an entry that makes the plan has another content        look closer at all
//! else the assets of entries with other contents, and those that were not finished: only these are planned and built
//! ```
//! So the work is a stat for each file and what the change itself asks for. A stat stands for a content only where the conditions
//! of [`files`](crate::files) hold; where they do not, the content is looked at, now and in the next build.

use std::fs;
use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::disk::{Stat, is_absent};
use crate::hash::ContentHash;
use crate::index::{Content, Entry, Index};

/// Entries that one thread takes at a time; fewer than this in all are stated by one thread.
const SHARE: usize = 1024;
/// Threads beyond this wait for the kernel's own locks.
const MOST_THREADS: usize = 4;

/// What [`Engine::look`](crate::Engine::look) found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Look {
    /// Everything is as it was at the end of the last build: there is nothing to do.
    Fresh,
    /// Only these assets can have anything to do, by the names that [`Group::name`] gave: a plan of them alone will do.
    Changed(Vec<String>),
    /// All has to be planned.
    Unknown,
}

/// What [`Engine::remember`](crate::Engine::remember) keeps beside what the build itself saw.
#[derive(Clone, Debug)]
pub struct Memory {
    /// Digest of all that makes the plan and is no file.
    pub key: ContentHash,
    /// Files read to make the plan, relative to its root.
    pub files: Vec<String>,
    /// Folders listed to make the plan, relative to its root.
    pub folders: Vec<String>,
    /// The plan's assets: every action and target belongs to one of them.
    pub groups: Vec<Group>,
}

/// The actions and targets of one asset.
#[derive(Clone, Debug)]
pub struct Group {
    /// Names it, the same in every build; unique.
    pub name: String,
    /// Indices of its actions in the plan.
    pub actions: Vec<usize>,
    /// Indices of its targets in the plan.
    pub targets: Vec<usize>,
    /// A short text, at hand after every look, such as counts.
    pub brief: String,
    /// Bytes handed back by [`Engine::note`](crate::Engine::note), such as the asset's summary.
    pub note: Vec<u8>,
}

/// Stat and content of an entry that was looked at closer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    pub(crate) entry: usize,
    /// The same before and after it was read.
    pub(crate) stat: Option<Stat>,
    pub(crate) content: Content,
}

/// Stat of the file at `path`; `None` if it is absent, an error if that cannot be told.
pub(crate) fn stat(path: &Path) -> Result<Option<Stat>, io::Error> {
    match fs::metadata(path) {
        Ok(metadata) => Ok(Some(Stat::of(&metadata))),
        Err(error) if is_absent(&error) => Ok(None),
        Err(error) => Err(error),
    }
}

/// Entries whose stat does not say that they are as they were, ascending.
pub(crate) fn moved(index: &Index, root: &Path) -> Vec<usize> {
    let folders = index.folder_count();
    let next = AtomicUsize::new(0);
    let found = Mutex::new(Vec::new());
    // A share is a run of folders: a folder's path is made once, and threads seldom meet in one.
    let share = (folders * SHARE / index.entries.len().max(1)).clamp(1, folders.max(1));
    let work = || {
        let mut mine = Vec::new();
        let mut path = String::new();
        loop {
            let start = next.fetch_add(share, Ordering::Relaxed);
            if start >= folders {
                break;
            }
            for folder in start..(start + share).min(folders) {
                moved_in(index, root, folder, &mut path, &mut mine);
            }
        }
        found.lock().unwrap_or_else(PoisonError::into_inner).append(&mut mine);
    };
    on_threads(index.entries.len().div_ceil(SHARE), &work);
    let mut found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    found.sort_unstable();
    found
}

fn moved_in(index: &Index, root: &Path, folder: usize, path: &mut String, moved: &mut Vec<usize>) {
    let (name, range) = index.folder(folder);
    path.clear();
    // A root that is no UTF-8 cannot be written into a text: such paths are made one by one.
    let plain = root.to_str();
    if let Some(root) = plain.filter(|_| !name.starts_with('/')) {
        path.push_str(root);
        path.push('/');
    }
    path.push_str(name);
    if !name.is_empty() {
        path.push('/');
    }
    let stem = path.len();
    for number in range {
        let entry = &index.entries[number];
        let found = match plain {
            Some(_) if !index.name(number).starts_with('/') => {
                path.truncate(stem);
                path.push_str(index.name(number));
                stat(Path::new(path.as_str()))
            }
            _ => stat(&root.join(index.path(number))),
        };
        if !is_same(entry, found) {
            moved.push(number);
        }
    }
}

fn is_same(entry: &Entry, found: io::Result<Option<Stat>>) -> bool {
    match (found, entry.content) {
        (Ok(None), Content::Absent) => true,
        (Ok(Some(found)), Content::Hash(_)) => entry.stat == Some(found),
        _ => false,
    }
}

/// Looks at the contents of entries.
pub(crate) fn look_closer(index: &Index, root: &Path, entries: &[usize]) -> Vec<Found> {
    let next = AtomicUsize::new(0);
    let found = Mutex::new(Vec::with_capacity(entries.len()));
    let work = || {
        while let Some(&entry) = entries.get(next.fetch_add(1, Ordering::Relaxed)) {
            let path = root.join(index.path(entry));
            let (stat, content) = read(&path, index.entries[entry].folder);
            found.lock().unwrap_or_else(PoisonError::into_inner).push(Found { entry, stat, content });
        }
    };
    on_threads(entries.len().div_ceil(16), &work);
    let mut found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    found.sort_unstable_by_key(|found| found.entry);
    found
}

/// Stat and content of a file, or of a folder; the stat only if it is the same before and after.
pub(crate) fn read(path: &Path, folder: bool) -> (Option<Stat>, Content) {
    let before = stat(path);
    let content = match (&before, folder) {
        (Ok(None), _) => return (None, Content::Absent),
        (Err(_), _) => None,
        (Ok(Some(_)), true) => listing(path).ok(),
        (Ok(Some(_)), false) => digest(path).ok(),
    };
    let Some(hash) = content else { return (None, Content::Unknown) };
    let after = stat(path);
    match (before, after) {
        (Ok(before), Ok(after)) if before == after => (after, Content::Hash(hash)),
        _ => (None, Content::Unknown),
    }
}

fn digest(path: &Path) -> io::Result<ContentHash> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(fs::File::open(path)?)?;
    Ok(ContentHash(*hasher.finalize().as_bytes()))
}

/// The digest of a folder's names and of which of them are folders, but for files that kiln is just writing.
fn listing(path: &Path) -> io::Result<ContentHash> {
    let mut names = Vec::new();
    for entry in fs::read_dir(path)? {
        let entry = entry?;
        let kind = entry.file_type()?;
        let is_folder = kind.is_dir() || kind.is_symlink() && entry.path().is_dir();
        let name = entry.file_name();
        if !name.as_encoded_bytes().ends_with(b".kiln-tmp") {
            names.push((name, is_folder));
        }
    }
    names.sort();
    let mut hasher = blake3::Hasher::new();
    for (name, is_folder) in &names {
        // No name holds a zero.
        hasher.update(name.as_encoded_bytes()).update(&[0, *is_folder as u8]);
    }
    Ok(ContentHash(*hasher.finalize().as_bytes()))
}

/// Runs `work` on up to `most` threads, of which one is this.
fn on_threads(most: usize, work: &(dyn Fn() + Sync)) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = most.clamp(1, cores.min(MOST_THREADS));
    std::thread::scope(|scope| {
        for _ in 1..threads {
            // Where no thread can be had this one does it all.
            let _ = std::thread::Builder::new().spawn_scoped(scope, work);
        }
        work();
    });
}
