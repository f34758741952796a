//! A folder as remote: a share that all machines mount.
//!
//! Its files lie as in a cache, so that `kiln cache stats | gc | verify --cache FOLDER` look after it; readers do not date what they
//! take, so gc goes by when things were sent.

use std::fs::{self, File};
use std::hash::{BuildHasher, RandomState};
use std::io::{self, Read};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::place::{Fault, Place, Until};
use crate::disk;
use crate::store::LAYOUT;

const CHUNK: usize = 1 << 18;

pub(super) struct Folder {
    root: PathBuf,
    /// Tells our temporary files from those of other machines.
    nonce: u64,
    counter: AtomicU64,
}

impl Folder {
    pub(super) fn new(root: PathBuf) -> Folder {
        let nonce = RandomState::new().hash_one(&root);
        Folder { root, nonce, counter: AtomicU64::new(0) }
    }

    /// A share that is not mounted must be noticed, and not be written to the disk under it: kiln does not make the folder.
    fn there(&self) -> Result<(), Fault> {
        if self.root.is_dir() { Ok(()) } else { Err(Fault::Refused("there is no such folder".into())) }
    }
}

fn fault(error: &io::Error) -> Fault {
    match error.kind() {
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => Fault::Refused(error.to_string()),
        _ => Fault::Transient(error.to_string()),
    }
}

impl Place for Folder {
    fn get(
        &self,
        key: &str,
        limit: u64,
        until: &Until<'_>,
        push: &mut dyn FnMut(&[u8]) -> Result<(), Fault>,
    ) -> Result<bool, Fault> {
        let path = self.root.join(key);
        // Looked at before it is opened: opening a pipe would wait for whoever writes to it.
        let metadata = match fs::metadata(&path) {
            Ok(metadata) => metadata,
            Err(error) if disk::is_absent(&error) => return self.there().map(|()| false),
            Err(error) => return Err(fault(&error)),
        };
        if !metadata.is_file() || metadata.len() > limit {
            return Err(Fault::Damaged(format!("{key} has {} bytes; at most {limit} are expected", metadata.len())));
        }
        let mut file = File::open(&path).map_err(|error| fault(&error))?;
        let mut chunk = vec![0; CHUNK.min(limit as usize + 1)];
        loop {
            until.left()?;
            match file.read(&mut chunk).map_err(|error| fault(&error))? {
                0 => return Ok(true),
                count => push(&chunk[..count])?,
            }
        }
    }

    fn has(&self, key: &str, until: &Until<'_>) -> Result<bool, Fault> {
        until.left()?;
        self.there()?;
        Ok(self.root.join(key).is_file())
    }

    fn put(&self, key: &str, bytes: &Arc<[u8]>, create: bool, until: &Until<'_>) -> Result<bool, Fault> {
        self.there()?;
        let path = self.root.join(key);
        let count = self.counter.fetch_add(1, Ordering::Relaxed);
        let temporary = self.root.join(LAYOUT).join("tmp").join(format!("{:016x}-{count}", self.nonce));
        let put = || {
            for folder in [temporary.parent(), path.parent()].into_iter().flatten() {
                disk::create_folder(folder).map_err(|error| fault(&error.source))?;
            }
            let mut writer = disk::Writer::create(&temporary).map_err(|error| fault(&error.source))?;
            for part in bytes.chunks(CHUNK) {
                until.left()?;
                writer.push(part).map_err(|error| fault(&error.source))?;
            }
            writer.finish(false).map_err(|error| fault(&error.source))?;
            if create {
                disk::rename_if_new(&temporary, &path).map_err(|error| fault(&error.source))
            } else {
                disk::rename(&temporary, &path).map(|()| true).map_err(|error| fault(&error.source))
            }
        };
        let put = put();
        if put.is_err() {
            let _ = fs::remove_file(&temporary);
        }
        put
    }
}
