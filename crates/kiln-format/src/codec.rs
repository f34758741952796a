//! Sections whose stored bytes are smaller than what they hold.
//!
//! | codec | for | stored |
//! | --- | --- | --- |
//! | `none` | all | the bytes |
//! | `zstd` | payload | one frame (RFC 8878), no dictionary |
//! | `meshopt-vertex` | VERT | for each array of the section: u32 length, a vertex stream of meshoptimizer with the element's size as stride |
//! | `meshopt-index` | INDX | one index stream of meshoptimizer, decoded to the level's index width |
//! | `meshopt-index-zstd` | INDX | such a stream in a frame of zstd: triangles in the order of strips halve once more |
//!
//! Tables have codec `none`: they are read before anything is decoded. **Hostile bytes:** a section is refused before anything
//! is allocated for it if its raw length is beyond what its codec can reach from its stored length (`most_raw`); streams are
//! cut out by checked lengths, each is decoded into a buffer of exactly its array's size, and what comes out counts only if the
//! raw hash agrees and the checks of contents pass. The meshoptimizer decoders promise memory safety on any stream for a
//! destination of the stated size; zstd's likewise.
//!
//! **Limits.** meshoptimizer's index codec keeps the order of triangles but may rotate their corners; the writer replaces
//! indices by what decoding gives ([`canonical_indices`]), so that the raw hash is of those. A frame that zstd makes more than
//! 1,024 times smaller is not used.
//!
//! Sources: Kapoulkine, meshoptimizer 1.x (vertex codec version 1, index codec version 1); Collet, Kucherawy, RFC 8878, 2021.

use crate::kind::{CODECS, Kind};
use crate::prelude::*;
use crate::record::ArrayRecord;
#[cfg(feature = "codecs")]
use crate::{AlignedBytes, VertexFormat};

/// Number of codec `none`.
pub(crate) const NONE: u32 = 0;
/// Number of codec `zstd`.
pub(crate) const ZSTD: u32 = 1;
/// Number of codec `meshopt-vertex`.
pub(crate) const VERTEX: u32 = 3;
/// Number of codec `meshopt-index`.
pub(crate) const INDEX: u32 = 4;
/// Number of codec `meshopt-index-zstd`.
pub(crate) const INDEX_ZSTD: u32 = 5;

/// Most raw bytes that a stored byte may stand for, zstd and meshopt-vertex. The latter's cheapest block states 256 elements
/// with two bits for each byte of one, which is 1,024; a constant picture beyond it is stored as it is.
pub const MOST_EXPANSION: u64 = 1024;

/// How payload is stored; a section stays raw where coded bytes are not smaller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Packing {
    /// As the GPU reads it: a mapped file needs no decoding.
    #[default]
    Raw,
    /// Geometry by meshoptimizer's codecs, layouts and mips by zstd.
    Meshopt,
    /// All payload by zstd.
    Zstd,
}

/// Whether this crate has a codec and a section of this kind may be in it.
pub(crate) fn is_for(codec: u32, kind: Kind) -> bool {
    let payload = kind.row().is_some_and(|row| row.rank >= crate::kind::PAYLOAD_RANK);
    match codec {
        NONE => true,
        ZSTD => cfg!(feature = "codecs") && payload,
        VERTEX => cfg!(feature = "codecs") && kind == Kind::VERTICES,
        INDEX | INDEX_ZSTD => cfg!(feature = "codecs") && kind == Kind::INDICES,
        _ => false,
    }
}

/// The codecs that [`is_for`] allows, by name.
pub(crate) fn names(kind: Kind) -> String {
    let names: Vec<&str> = CODECS.iter().filter(|row| is_for(row.0, kind)).map(|row| row.1).collect();
    names.join(" or ")
}

/// Most raw bytes of a section with `stored` bytes.
pub(crate) fn most_raw(codec: u32, stored: u64) -> u64 {
    match codec {
        ZSTD | VERTEX | INDEX_ZSTD => stored.saturating_mul(MOST_EXPANSION),
        // A byte a triangle at least.
        INDEX => stored.saturating_mul(12),
        _ => u64::MAX,
    }
}

/// What decoding the codec `meshopt-index` gives for `indices` (`[3 * triangle_count]`, each below `vertex_count`): the same
/// triangles in the same order, some rotated. Other content that depends on the order of corners is to be made from these.
///
/// Given its own result it changes at most the rotation of triangles that have a corner twice. Without feature `codecs`, and
/// for indices that are no whole triangles or out of range, it is the identity.
pub fn canonical_indices(indices: &[u32], vertex_count: u32) -> Vec<u32> {
    encode_indices(indices, vertex_count).map_or_else(|| indices.to_vec(), |(_, decoded)| decoded)
}

/// Streams as written, and what decoding gives for them.
#[cfg(feature = "codecs")]
pub(crate) fn encode_indices(indices: &[u32], vertex_count: u32) -> Option<(Vec<u8>, Vec<u32>)> {
    // The encoder sizes its buffer by the vertex count.
    if indices.is_empty() || !indices.len().is_multiple_of(3) || indices.iter().any(|i| *i >= vertex_count) {
        return None;
    }
    let stream = meshopt::encode_index_buffer(indices, vertex_count as usize).ok()?;
    let decoded = meshopt::decode_index_buffer::<u32>(&stream, indices.len()).ok()?;
    Some((stream, decoded))
}

#[cfg(not(feature = "codecs"))]
pub(crate) fn encode_indices(_: &[u32], _: u32) -> Option<(Vec<u8>, Vec<u32>)> {
    None
}

/// zstd's level: higher ones take several times as long for a few percent on geometry.
#[cfg(feature = "codecs")]
const LEVEL: i32 = 9;

/// One frame.
#[cfg(feature = "codecs")]
pub(crate) fn encode_zstd(raw: &[u8]) -> Option<Vec<u8>> {
    zstd::bulk::compress(raw, LEVEL).ok()
}

#[cfg(not(feature = "codecs"))]
pub(crate) fn encode_zstd(_: &[u8]) -> Option<Vec<u8>> {
    None
}

/// Length and stream of each array.
#[cfg(feature = "codecs")]
pub(crate) fn encode_vertices(raw: &[u8], arrays: &[ArrayRecord]) -> Option<Vec<u8>> {
    fn stream<T: bytemuck::AnyBitPattern>(bytes: &[u8]) -> Option<Vec<u8>> {
        let values: Vec<T> = bytes.chunks_exact(size_of::<T>()).map(bytemuck::pod_read_unaligned).collect();
        meshopt::encode_vertex_buffer_level(&values, 2, Some(1)).ok()
    }
    let mut out = Vec::new();
    for array in arrays {
        let bytes = raw.get(array.offset as usize..(array.offset + array.length) as usize)?;
        let own = match VertexFormat::from_number(array.format)?.size() {
            8 => stream::<[u32; 2]>(bytes)?,
            12 => stream::<[u32; 3]>(bytes)?,
            _ => stream::<[u32; 4]>(bytes)?,
        };
        out.extend(u32::try_from(own.len()).ok()?.to_le_bytes());
        out.extend(own);
    }
    Some(out)
}

#[cfg(not(feature = "codecs"))]
pub(crate) fn encode_vertices(_: &[u8], _: &[ArrayRecord]) -> Option<Vec<u8>> {
    None
}

/// The raw bytes of a section, `None` where they cannot be had. `arrays` are those of a VERT, `index_width` that of an INDX.
#[cfg(feature = "codecs")]
pub(crate) fn decode(
    codec: u32,
    stored: &[u8],
    raw_length: u64,
    arrays: &[ArrayRecord],
    index_width: u32,
) -> Option<AlignedBytes> {
    if raw_length > most_raw(codec, stored.len() as u64) {
        return None;
    }
    let length = usize::try_from(raw_length).ok()?;
    match codec {
        ZSTD => decode_zstd(stored, length),
        VERTEX => decode_vertices(stored, length, arrays),
        INDEX => decode_indices(stored, length, index_width),
        // A stream is never longer than what it stands for, but for a few bytes at its ends.
        INDEX_ZSTD => decode_indices(&zstd::bulk::decompress(stored, length + 64).ok()?, length, index_width),
        _ => None,
    }
}

#[cfg(feature = "codecs")]
fn decode_zstd(stored: &[u8], length: usize) -> Option<AlignedBytes> {
    // One frame and nothing behind it.
    if zstd::zstd_safe::find_frame_compressed_size(stored).ok()? != stored.len() {
        return None;
    }
    let mut out = AlignedBytes::zeroed(length);
    let written = zstd::bulk::decompress_to_buffer(stored, out.as_mut_slice()).ok()?;
    (written == length).then_some(out)
}

#[cfg(feature = "codecs")]
fn decode_vertices(stored: &[u8], length: usize, arrays: &[ArrayRecord]) -> Option<AlignedBytes> {
    fn fill<T: bytemuck::Pod + Default>(stream: &[u8], out: &mut [u8]) -> Option<()> {
        let values = meshopt::decode_vertex_buffer::<T>(stream, out.len() / size_of::<T>()).ok()?;
        out.copy_from_slice(bytemuck::cast_slice(&values));
        Some(())
    }
    let mut out = AlignedBytes::zeroed(length);
    let mut rest = stored;
    for array in arrays {
        let (head, tail) = rest.split_first_chunk::<4>()?;
        let (stream, tail) = tail.split_at_checked(u32::from_le_bytes(*head) as usize)?;
        rest = tail;
        let start = usize::try_from(array.offset).ok()?;
        let end = start.checked_add(usize::try_from(array.length).ok()?)?;
        let place = out.as_mut_slice().get_mut(start..end)?;
        let size = VertexFormat::from_number(array.format)?.size();
        // Bounds what all arrays of a section may take together, whatever the records say.
        let most = most_raw(VERTEX, stream.len() as u64);
        if !place.len().is_multiple_of(size) || place.len() as u64 > most {
            return None;
        }
        match size {
            8 => fill::<[u32; 2]>(stream, place)?,
            12 => fill::<[u32; 3]>(stream, place)?,
            _ => fill::<[u32; 4]>(stream, place)?,
        }
    }
    rest.is_empty().then_some(out)
}

#[cfg(feature = "codecs")]
fn decode_indices(stream: &[u8], length: usize, width: u32) -> Option<AlignedBytes> {
    fn of<T: bytemuck::Pod + Default>(stream: &[u8], length: usize) -> Option<AlignedBytes> {
        if !length.is_multiple_of(3 * size_of::<T>()) {
            return None;
        }
        let indices = meshopt::decode_index_buffer::<T>(stream, length / size_of::<T>()).ok()?;
        Some(AlignedBytes::copy_of(bytemuck::cast_slice(&indices)))
    }
    if width == 2 { of::<u16>(stream, length) } else { of::<u32>(stream, length) }
}

/// One cell a section for its decoded bytes, filled on first use.
#[cfg(feature = "codecs")]
pub(crate) struct Decoded {
    cells: Vec<std::sync::OnceLock<Option<AlignedBytes>>>,
}

#[cfg(feature = "codecs")]
impl Decoded {
    pub(crate) fn new(count: usize) -> Decoded {
        Decoded { cells: (0..count).map(|_| std::sync::OnceLock::new()).collect() }
    }

    pub(crate) fn get(&self, number: usize, decode: impl FnOnce() -> Option<AlignedBytes>) -> Option<&[u8]> {
        self.cells.get(number)?.get_or_init(decode).as_deref()
    }
}
