//! Blobs: bytes named by their hash, verified whenever they are read.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::Store;
use crate::disk;
use crate::error::IoError;
use crate::hash::ContentHash;
use crate::report::OutputRecord;

const BLOB_MAGIC: &[u8; 8] = b"kilnblob";
/// Blob type: an action's output.
const BLOB_TYPE: u32 = 0;
/// Codec: stored as it is.
const BLOB_CODEC: u32 = 0;
/// Magic, type, codec, raw length, hash.
pub(crate) const BLOB_HEADER: usize = 8 + 4 + 4 + 8 + 32;

/// How much is hashed at a time where the bytes are not wanted.
const CHUNK: usize = 1 << 18;

impl Store {
    pub(super) fn blob_path(&self, hash: &ContentHash) -> PathBuf {
        self.sharded("blobs", &hash.hex())
    }

    /// Whether a blob seems to be there; only reading it tells.
    pub(crate) fn has_blob(&self, hash: &ContentHash, length: u64) -> bool {
        let here =
            |store: &Store| fs::metadata(store.blob_path(hash)).is_ok_and(|metadata| is_length_of(&metadata, length));
        here(self) || self.layers.iter().any(here)
    }

    /// Keeps `bytes`, whose digest is `hash`.
    pub(crate) fn put_blob(&self, hash: &ContentHash, bytes: &[u8], sync: bool) -> Result<(), IoError> {
        let path = self.blob_path(hash);
        if let Ok(metadata) = fs::metadata(&path)
            && is_length_of(&metadata, bytes.len() as u64)
        {
            self.used(&path, &metadata);
            return Ok(());
        }
        let temporary = self.write_temporary(&[&blob_header(hash, bytes.len() as u64), bytes], sync)?;
        self.name_blob(&temporary, hash)
    }

    /// Gives a whole file its name.
    pub(super) fn name_blob(&self, temporary: &Path, hash: &ContentHash) -> Result<(), IoError> {
        let path = self.blob_path(hash);
        let folder = path.parent().map_or(Ok(()), disk::create_folder);
        let named = folder.and_then(|()| disk::rename(temporary, &path));
        if named.is_err() {
            let _ = disk::remove(temporary);
        }
        named
    }

    /// The bytes whose digest is `hash`, if they are here or in a layer.
    pub(crate) fn blob(&self, hash: &ContentHash) -> Option<Arc<[u8]>> {
        std::iter::once(self).chain(&self.layers).find_map(|store| store.local_blob(hash))
    }

    /// The bytes of an output, or `None` for a miss; what is neither here nor in a layer is asked of the remote.
    pub(crate) fn blob_of(&self, output: &OutputRecord) -> Option<Arc<[u8]>> {
        self.blob(&output.hash).or_else(|| {
            self.claimed_blob(&output.hash, output.length).ok()?;
            self.local_blob(&output.hash)
        })
    }

    pub(super) fn local_blob(&self, hash: &ContentHash) -> Option<Arc<[u8]>> {
        let path = self.blob_path(hash);
        let mut file = File::open(&path).ok()?;
        let metadata = file.metadata().ok()?;
        let bytes = read_blob(&mut file, hash);
        match bytes {
            Some(_) => self.used(&path, &metadata),
            None => self.quarantine(&path, "blob"),
        }
        bytes
    }

    /// Whether a blob is there and is what it should be; one that is not is moved aside.
    pub(super) fn verify_blob(&self, hash: &ContentHash) -> Option<u64> {
        let path = self.blob_path(hash);
        let mut file = File::open(&path).ok()?;
        let metadata = file.metadata().ok()?;
        let length = verified_length(&mut file, hash);
        match length {
            Some(_) => self.used(&path, &metadata),
            None => self.quarantine(&path, "blob"),
        }
        length
    }
}

fn is_length_of(metadata: &fs::Metadata, length: u64) -> bool {
    metadata.len() == length.saturating_add(BLOB_HEADER as u64)
}

/// What stands before the bytes of a blob.
pub(crate) fn blob_header(hash: &ContentHash, length: u64) -> [u8; BLOB_HEADER] {
    let mut header = [0; BLOB_HEADER];
    header[..8].copy_from_slice(BLOB_MAGIC);
    header[8..12].copy_from_slice(&BLOB_TYPE.to_le_bytes());
    header[12..16].copy_from_slice(&BLOB_CODEC.to_le_bytes());
    header[16..24].copy_from_slice(&length.to_le_bytes());
    header[24..].copy_from_slice(&hash.0);
    header
}

/// The header's length, if the file begins as a blob of `hash` and is as long as it says.
fn read_header(file: &mut File, hash: &ContentHash) -> Option<u64> {
    let length = file.metadata().ok()?.len().checked_sub(BLOB_HEADER as u64)?;
    let mut header = [0; BLOB_HEADER];
    file.read_exact(&mut header).ok()?;
    (header == blob_header(hash, length)).then_some(length)
}

/// Reads and verifies a blob file; allocates what the file's own length justifies.
fn read_blob(file: &mut File, hash: &ContentHash) -> Option<Arc<[u8]>> {
    let length = read_header(file, hash)?;
    // Collecting zeros fills the shared slice in place: a blob of hundreds of megabytes is not copied once more.
    let mut bytes: Arc<[u8]> = std::iter::repeat_n(0, usize::try_from(length).ok()?).collect();
    file.read_exact(Arc::get_mut(&mut bytes)?).ok()?;
    (ContentHash::of(&bytes) == *hash).then_some(bytes)
}

/// Verifies a blob file in constant memory; gives its raw length.
fn verified_length(file: &mut File, hash: &ContentHash) -> Option<u64> {
    let length = read_header(file, hash)?;
    let mut hasher = blake3::Hasher::new();
    let mut chunk = vec![0; CHUNK];
    loop {
        let count = file.read(&mut chunk).ok()?;
        if count == 0 {
            break;
        }
        hasher.update(&chunk[..count]);
    }
    (ContentHash(*hasher.finalize().as_bytes()) == *hash).then_some(length)
}
