//! Steps on the file system: the only place where the engine writes, so that tests can stop it after any step.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{PoisonError, RwLock, RwLockReadGuard};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::error::IoError;

/// Held for reading by whoever makes a file that a later step completes.
static WRITING: RwLock<()> = RwLock::new(());

/// Say so before a file is made that a later step completes: [`quiesce`] waits until the value is dropped. Not to be nested.
pub(crate) fn writing() -> RwLockReadGuard<'static, ()> {
    // There is nothing under the lock that a panic could leave half.
    WRITING.read().unwrap_or_else(PoisonError::into_inner)
}

/// Waits, for `patience` at most, until no build of this process is in the middle of a file, and lets none begin another: for a
/// process that ends while stages run that do not ask whether they are cancelled. Gives whether it came about.
pub fn quiesce(patience: Duration) -> bool {
    let start = Instant::now();
    loop {
        if let Ok(guard) = WRITING.try_write() {
            // Held until the process ends.
            std::mem::forget(guard);
            return true;
        }
        if start.elapsed() > patience {
            return false;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// What a file's stat says: equal stats stand for equal bytes, under the conditions of [`files`](crate::files).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Stat {
    /// Length, bytes.
    pub(crate) size: u64,
    /// Last change of the content, nanoseconds since 1970.
    pub(crate) mtime: i64,
    /// Last change of content or properties, nanoseconds since 1970; 0 where the system has none.
    pub(crate) ctime: i64,
    /// File number; 0 where the system has none.
    pub(crate) inode: u64,
    /// Device; 0 where the system has none.
    pub(crate) device: u64,
}

impl Stat {
    pub(crate) fn of(metadata: &Metadata) -> Stat {
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt;
            let nanoseconds = |seconds: i64, rest: i64| seconds.saturating_mul(1_000_000_000).saturating_add(rest);
            Stat {
                size: metadata.len(),
                mtime: nanoseconds(metadata.mtime(), metadata.mtime_nsec()),
                ctime: nanoseconds(metadata.ctime(), metadata.ctime_nsec()),
                inode: metadata.ino(),
                device: metadata.dev(),
            }
        }
        #[cfg(not(unix))]
        Stat { size: metadata.len(), mtime: mtime(metadata), ..Stat::default() }
    }

    /// The later of both times.
    pub(crate) fn latest(&self) -> i64 {
        self.mtime.max(self.ctime)
    }
}

/// Last change of the content, nanoseconds since 1970; 0 if unknown.
pub(crate) fn mtime(metadata: &Metadata) -> i64 {
    let since = |time: SystemTime| time.duration_since(UNIX_EPOCH).ok();
    metadata.modified().ok().and_then(since).and_then(|span| i64::try_from(span.as_nanos()).ok()).unwrap_or(0)
}

/// Whether an error says that there is no such file.
pub(crate) fn is_absent(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory)
}

/// Makes a folder and those above it.
pub(crate) fn create_folder(path: &Path) -> Result<(), IoError> {
    if path.is_dir() {
        return Ok(());
    }
    step();
    fs::create_dir_all(path).map_err(IoError::new("create the folder", path))
}

/// Writes a file from its start; `sync` waits until the device has it.
pub(crate) fn write(path: &Path, parts: &[&[u8]], sync: bool) -> Result<(), IoError> {
    let mut writer = Writer::create(path)?;
    for part in parts {
        writer.push(part)?;
    }
    writer.finish(sync)
}

/// A file that is written as its bytes arrive.
pub(crate) struct Writer {
    path: PathBuf,
    file: File,
}

impl Writer {
    /// A new file.
    pub(crate) fn create(path: &Path) -> Result<Writer, IoError> {
        step();
        let file = File::create(path).map_err(IoError::new("create", path))?;
        Ok(Writer { path: path.to_owned(), file })
    }

    /// Appends.
    pub(crate) fn push(&mut self, bytes: &[u8]) -> Result<(), IoError> {
        write_part(&mut self.file, bytes, &self.path).map_err(IoError::new("write", &self.path))
    }

    /// Ends the file; `sync` waits until the device has it.
    pub(crate) fn finish(self, sync: bool) -> Result<(), IoError> {
        if sync {
            step();
            self.file.sync_all().map_err(IoError::new("write", &self.path))?;
        }
        Ok(())
    }
}

/// Dates a file: nanoseconds since 1970. What cannot be dated looks unused, which costs time only.
pub(crate) fn set_mtime(path: &Path, time: i64) {
    let Ok(file) = File::open(path) else { return };
    if let Ok(since) = u64::try_from(time) {
        let _ = file.set_modified(UNIX_EPOCH + Duration::from_nanos(since));
    }
}

/// Appends to a file that exists.
pub(crate) fn append(path: &Path, bytes: &[u8]) -> Result<(), IoError> {
    step();
    let mut file = OpenOptions::new().append(true).open(path).map_err(IoError::new("open", path))?;
    write_part(&mut file, bytes, path).map_err(IoError::new("append to", path))
}

/// Cuts a file.
pub(crate) fn truncate(path: &Path, length: u64) -> Result<(), IoError> {
    step();
    let file = OpenOptions::new().write(true).open(path).map_err(IoError::new("open", path))?;
    file.set_len(length).map_err(IoError::new("cut", path))
}

fn write_part(file: &mut File, bytes: &[u8], path: &Path) -> io::Result<()> {
    room_for(bytes.len(), path)?;
    // Two halves in tests, with a step between: a kill may leave any part of a write.
    let half = if cfg!(test) { bytes.len() / 2 } else { 0 };
    if half > 0 {
        file.write_all(&bytes[..half])?;
        step();
    }
    file.write_all(&bytes[half..])
}

/// Renames, replacing what is there.
pub(crate) fn rename(from: &Path, to: &Path) -> Result<(), IoError> {
    step();
    fs::rename(from, to).map_err(IoError::new("rename to", to))
}

/// Gives `from` the name `to` unless that exists; `from` is gone afterwards. Returns whether `to` is ours.
///
/// Where the file system has no hard links, a rename that may replace an equal file stands in.
pub(crate) fn rename_if_new(from: &Path, to: &Path) -> Result<bool, IoError> {
    step();
    let ours = match fs::hard_link(from, to) {
        Ok(()) => true,
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => false,
        Err(_) if to.exists() => false,
        Err(_) => return rename(from, to).map(|()| true),
    };
    step();
    // A temporary file that stays behind is litter, not damage.
    let _ = fs::remove_file(from);
    Ok(ours)
}

/// Removes a file if it is there.
pub(crate) fn remove(path: &Path) -> Result<(), IoError> {
    step();
    match fs::remove_file(path) {
        Err(error) if !is_absent(&error) => Err(IoError::new("remove", path)(error)),
        _ => Ok(()),
    }
}

#[cfg(not(test))]
fn step() {}

/// Ends the process at the step that a test asked for, as a kill would: no destructor runs, no buffer is flushed.
#[cfg(test)]
fn step() {
    use std::sync::atomic::Ordering::SeqCst;
    let taken = STEPS.fetch_add(1, SeqCst) + 1;
    if taken == ABORT_AT.load(SeqCst) {
        std::process::abort();
    }
}

#[cfg(not(test))]
fn room_for(_length: usize, _path: &Path) -> io::Result<()> {
    Ok(())
}

/// Refuses a write under a folder that a test filled up.
#[cfg(test)]
fn room_for(length: usize, path: &Path) -> io::Result<()> {
    let mut rooms = ROOMS.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    for (folder, room) in rooms.iter_mut().filter(|(folder, _)| path.starts_with(folder)) {
        if length > *room {
            let name = folder.display();
            return Err(io::Error::new(io::ErrorKind::StorageFull, format!("no space left under {name} (a test)")));
        }
        *room -= length;
    }
    Ok(())
}

/// Folders with the bytes that may still be written under each.
#[cfg(test)]
pub(crate) static ROOMS: std::sync::Mutex<Vec<(PathBuf, usize)>> = std::sync::Mutex::new(Vec::new());

/// Steps taken so far in this process.
#[cfg(test)]
pub(crate) static STEPS: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);

/// The step at which the process ends; 0 for never.
#[cfg(test)]
pub(crate) static ABORT_AT: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);
