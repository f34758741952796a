//! Bytes on an address that every record and array of a container may be lent from.

use crate::prelude::*;
use bytemuck::{Pod, Zeroable};

#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C, align(256))]
struct Chunk([u8; 256]);

/// A buffer whose first byte lies on a multiple of 256, as a mapped file's does.
#[derive(Clone, Default)]
pub struct AlignedBytes {
    chunks: Vec<Chunk>,
    length: usize,
}

impl AlignedBytes {
    /// `length` zero bytes.
    pub fn zeroed(length: usize) -> AlignedBytes {
        AlignedBytes { chunks: vec![Chunk::zeroed(); length.div_ceil(256)], length }
    }

    /// A copy of `bytes`.
    pub fn copy_of(bytes: &[u8]) -> AlignedBytes {
        let mut copy = AlignedBytes::zeroed(bytes.len());
        copy.as_mut_slice().copy_from_slice(bytes);
        copy
    }

    /// All bytes that `reader` gives.
    ///
    /// # Errors
    /// Those of `reader`.
    #[cfg(feature = "std")]
    pub fn read_from(reader: &mut impl std::io::Read) -> std::io::Result<AlignedBytes> {
        let mut bytes = Vec::new();
        reader.read_to_end(&mut bytes)?;
        Ok(AlignedBytes::copy_of(&bytes))
    }

    /// The bytes, to fill them.
    pub fn as_mut_slice(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut(&mut self.chunks)[..self.length]
    }
}

impl core::ops::Deref for AlignedBytes {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.chunks)[..self.length]
    }
}
