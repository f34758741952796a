//! The cache's encoding of stage values: a type tag and codec version, small records by bincode, bulk arrays raw little-endian.
//!
//! Private to the cache: the container has its own layout (`kiln-format`). Blobs are read as bytes from outside: nothing is
//! allocated that the blob's own length does not justify, and nothing panics.

use bytemuck::Pod;
use serde::{Serialize, de::DeserializeOwned};

#[cfg(target_endian = "big")]
compile_error!("kiln's cache blobs are little-endian; a big-endian target needs a swapping codec first");

/// Longest record that bincode may decode, bytes. Records hold names and factors; arrays go beside them.
const META_LIMIT: usize = 16 << 20;

/// Why bytes are no such blob.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BlobError {
    /// It is another type of blob, or none.
    #[error("blob is no {expected:?}")]
    WrongType {
        /// The tag that was asked for.
        expected: String,
    },
    /// Another codec version wrote it.
    #[error("blob codec version {found}, expected {expected}")]
    WrongVersion {
        /// The version this build reads.
        expected: u32,
        /// The version in the blob.
        found: u32,
    },
    /// It ends early or late.
    #[error("blob is truncated or has trailing bytes")]
    Length,
    /// A value in it breaks a promise.
    #[error("blob content: {0}")]
    Content(String),
}

/// Writes one blob.
pub struct BlobWriter(Vec<u8>);

impl BlobWriter {
    /// A blob of type `tag` in codec version `version`.
    pub fn new(tag: [u8; 4], version: u32) -> BlobWriter {
        let mut bytes = tag.to_vec();
        bytes.extend(version.to_le_bytes());
        BlobWriter(bytes)
    }

    /// Appends a small record.
    ///
    /// # Panics
    /// If the record is longer than 16 MiB: such data belongs in arrays.
    pub fn meta<T: Serialize>(&mut self, record: &T) {
        let bytes = bincode::serde::encode_to_vec(record, bincode::config::legacy())
            .expect("invariant: plain records in memory always encode");
        assert!(bytes.len() <= META_LIMIT, "record of {} bytes", bytes.len());
        self.array(&bytes);
    }

    /// Appends an array: u64 count, then the elements as they lie in memory.
    pub fn array<T: Pod>(&mut self, values: &[T]) {
        self.0.extend((values.len() as u64).to_le_bytes());
        self.0.extend_from_slice(bytemuck::cast_slice(values));
    }

    /// BLAKE3 of the blob with one more array, without a copy of it.
    pub fn hash_with<T: Pod>(mut self, values: &[T]) -> [u8; 32] {
        self.0.extend((values.len() as u64).to_le_bytes());
        *blake3::Hasher::new().update(&self.0).update(bytemuck::cast_slice(values)).finalize().as_bytes()
    }

    /// Appends an array that may be absent.
    pub fn optional<T: Pod>(&mut self, values: Option<&[T]>) {
        self.0.push(values.is_some() as u8);
        if let Some(values) = values {
            self.array(values);
        }
    }

    /// The bytes.
    pub fn finish(self) -> Vec<u8> {
        self.0
    }
}

/// Reads one blob in the order in which it was written.
pub struct BlobReader<'a>(&'a [u8]);

impl<'a> BlobReader<'a> {
    /// A reader behind the header.
    ///
    /// # Errors
    /// Another type or version.
    pub fn open(bytes: &'a [u8], tag: [u8; 4], version: u32) -> Result<BlobReader<'a>, BlobError> {
        let mut reader = BlobReader(bytes);
        let expected = || BlobError::WrongType { expected: String::from_utf8_lossy(&tag).into_owned() };
        if reader.take(4).map_err(|_| expected())? != tag {
            return Err(expected());
        }
        let found = u32::from_le_bytes(reader.word()?);
        if found != version {
            return Err(BlobError::WrongVersion { expected: version, found });
        }
        Ok(reader)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], BlobError> {
        let (head, tail) = self.0.split_at_checked(count).ok_or(BlobError::Length)?;
        self.0 = tail;
        Ok(head)
    }

    fn word<const N: usize>(&mut self) -> Result<[u8; N], BlobError> {
        self.take(N)?.try_into().map_err(|_| BlobError::Length)
    }

    /// The next small record.
    ///
    /// # Errors
    /// The bytes are no such record.
    pub fn meta<T: DeserializeOwned>(&mut self) -> Result<T, BlobError> {
        let bytes: Vec<u8> = self.array()?;
        let config = bincode::config::legacy().with_limit::<META_LIMIT>();
        let (record, used) =
            bincode::serde::decode_from_slice(&bytes, config).map_err(|e| BlobError::Content(e.to_string()))?;
        if used != bytes.len() { Err(BlobError::Length) } else { Ok(record) }
    }

    /// The next array.
    ///
    /// # Errors
    /// The blob ends before the array does.
    pub fn array<T: Pod>(&mut self) -> Result<Vec<T>, BlobError> {
        let count = u64::from_le_bytes(self.word()?);
        let bytes =
            usize::try_from(count).ok().and_then(|count| count.checked_mul(size_of::<T>())).ok_or(BlobError::Length)?;
        Ok(bytemuck::pod_collect_to_vec(self.take(bytes)?))
    }

    /// The next optional array.
    ///
    /// # Errors
    /// As for [`BlobReader::array`].
    pub fn optional<T: Pod>(&mut self) -> Result<Option<Vec<T>>, BlobError> {
        match self.word::<1>()? {
            [0] => Ok(None),
            [1] => self.array().map(Some),
            _ => Err(BlobError::Content("presence flag is neither 0 nor 1".into())),
        }
    }

    /// The end.
    ///
    /// # Errors
    /// Bytes are left.
    pub fn finish(self) -> Result<(), BlobError> {
        if self.0.is_empty() { Ok(()) } else { Err(BlobError::Length) }
    }
}
