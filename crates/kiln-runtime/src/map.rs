//! A container as a mapped file: no copy, and no memory but what the system's page cache has anyway.
//!
//! This is the one module of the crate with `unsafe` code. A mapping lends a file's bytes as if they were memory, and nobody
//! can promise that a file stays as it is; whoever calls [`MappedFile::open`] does. kiln replaces containers by renaming a
//! finished file over them, which leaves a mapping of the old one whole.
//!
//! Source: POSIX.1-2024, `mmap`: references beyond the end of the object raise SIGBUS; whether changes show is unspecified.

use std::fs::File;
use std::io;
use std::ops::Deref;
use std::path::Path;

/// A file's bytes, on a multiple of the system's page size: what [`crate::Lods::open`] and [`crate::Lods::open_tables`] take.
#[derive(Debug)]
pub struct MappedFile {
    /// `None`: an empty file, which cannot be mapped.
    map: Option<memmap2::Mmap>,
}

impl MappedFile {
    /// Maps a file for reading.
    ///
    /// # Safety
    /// As long as the value lives, no process may change the file's bytes (that is undefined behaviour: checked values would
    /// not be those that are used) or shorten it (the process is killed by a fault when it reads there). Replacing the file by
    /// renaming another over it, or removing it, is fine.
    ///
    /// # Errors
    /// Those of the system: the file cannot be opened or mapped.
    #[allow(unsafe_code, reason = "the crate's one exception: a mapping's bytes are the caller's promise")]
    pub unsafe fn open(path: impl AsRef<Path>) -> io::Result<MappedFile> {
        let file = File::open(path)?;
        if file.metadata()?.len() == 0 {
            return Ok(MappedFile { map: None });
        }
        // SAFETY: the caller promises that the file does not change, which is all that a mapping asks for.
        let map = unsafe { memmap2::Mmap::map(&file)? };
        Ok(MappedFile { map: Some(map) })
    }
}

impl Deref for MappedFile {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.map.as_deref().unwrap_or(&[])
    }
}
