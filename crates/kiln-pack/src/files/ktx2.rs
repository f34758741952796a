//! KTX 2.0 without supercompression: the container's mips as they lie, under a header that says what they are.
//!
//! ```text
//! identifier, header (9 u32), index (4 u32, 2 u64)
//! level index: offset, length, length again for each mip, largest first
//! data format descriptor, key "KTXwriter"
//! mips, smallest first, each on a multiple of its unit (a texel or a block)
//! ```
//! Sources: KTX File Format Specification 2.0, sections 3 and 4; Data Format Specification 1.3, section 5 (basic descriptor
//! block) with the colour models RGBSDA, BC5 and BC7; Vulkan's format numbers.

use kiln_format::{Container, TextureFormat};

const IDENTIFIER: [u8; 12] = [0xAB, b'K', b'T', b'X', b' ', b'2', b'0', 0xBB, 0x0D, 0x0A, 0x1A, 0x0A];
/// Bytes of identifier, header and index.
const HEADER: usize = 80;
/// Where the index starts.
const INDEX: usize = 48;
const LEVEL: usize = 24;

/// Colour models of the descriptor.
const RGBSDA: u8 = 1;
const BC5: u8 = 132;
const BC7: u8 = 134;
/// Qualifiers of a sample's channel.
const LINEAR: u8 = 0x10;
const SIGNED_FLOAT: u8 = 0xC0;
const ALPHA: u8 = 15;

/// What the header and the descriptor say of a format.
struct Row {
    vk_format: u32,
    /// Bytes of the type that a big-endian reader would swap.
    type_size: u32,
    model: u8,
    /// Bits of one sample; samples follow each other.
    sample_bits: u16,
    samples: &'static [u8],
    lower: u32,
    upper: u32,
}

fn row(format: TextureFormat) -> Row {
    const RGBA: &[u8] = &[0, 1, 2, ALPHA];
    const FLOAT: &[u8] = &[SIGNED_FLOAT, SIGNED_FLOAT | 1, SIGNED_FLOAT | 2, SIGNED_FLOAT | ALPHA];
    let plain = |vk_format, type_size, samples, upper| Row {
        vk_format,
        type_size,
        model: RGBSDA,
        sample_bits: 8 * type_size as u16,
        samples,
        lower: 0,
        upper,
    };
    let float = |vk_format, type_size| Row {
        // -1 and 1 as floats.
        lower: 0xBF80_0000,
        ..plain(vk_format, type_size, FLOAT, 0x3F80_0000)
    };
    let block =
        |vk_format, model, sample_bits, samples| Row { model, sample_bits, ..plain(vk_format, 1, samples, u32::MAX) };
    match format {
        TextureFormat::Rgba8Unorm => plain(37, 1, RGBA, 255),
        // Alpha has no curve.
        TextureFormat::Rgba8Srgb => plain(43, 1, &[0, 1, 2, LINEAR | ALPHA], 255),
        TextureFormat::Rgba16Unorm => plain(91, 2, RGBA, 65_535),
        TextureFormat::Rgba16Float => float(97, 2),
        TextureFormat::Rgba32Float => float(109, 4),
        TextureFormat::Bc5Unorm => block(141, BC5, 64, &[0, 1]),
        TextureFormat::Bc7Unorm => block(145, BC7, 128, &[0]),
        TextureFormat::Bc7Srgb => block(146, BC7, 128, &[0]),
    }
}

/// The data format descriptor with its length in front.
fn descriptor(format: TextureFormat) -> Vec<u8> {
    let row = row(format);
    let block_size = 24 + 16 * row.samples.len() as u32;
    let mut out = Vec::new();
    out.extend((4 + block_size).to_le_bytes());
    // Vendor Khronos, type basic; version 1.3 is number 2.
    out.extend(0u32.to_le_bytes());
    out.extend((block_size << 16 | 2).to_le_bytes());
    let transfer = if format.is_srgb() { 2 } else { 1 };
    // Primaries of BT.709, alpha straight.
    out.extend([row.model, 1, transfer, 0]);
    let side = if format.is_block() { 3 } else { 0 };
    out.extend([side, side, 0, 0]);
    out.extend([format.unit_size() as u8, 0, 0, 0, 0, 0, 0, 0]);
    for (number, channel) in row.samples.iter().enumerate() {
        out.extend((number as u16 * row.sample_bits).to_le_bytes());
        out.extend([(row.sample_bits - 1) as u8, *channel]);
        out.extend([0; 4]);
        out.extend(row.lower.to_le_bytes());
        out.extend(row.upper.to_le_bytes());
    }
    out
}

/// The one key of the file: who wrote it.
fn key_values() -> Vec<u8> {
    let entry = concat!("KTXwriter\0kiln ", env!("CARGO_PKG_VERSION"), "\0").as_bytes();
    let mut out = (entry.len() as u32).to_le_bytes().to_vec();
    out.extend(entry);
    out.resize(out.len().next_multiple_of(4), 0);
    out
}

/// The bytes of a KTX2 file with all mips of a texture.
pub(super) fn encode(container: &Container<'_>, texture: usize, format: TextureFormat) -> Result<Vec<u8>, String> {
    let mips: Option<Vec<&[u8]>> = (0..container.mips(texture).len()).map(|mip| container.mip(texture, mip)).collect();
    let (Some(mips), Some(record)) = (mips, container.textures().get(texture)) else {
        return Err("its mips are not at hand".into());
    };
    let row = row(format);
    let (dfd, kvd) = (descriptor(format), key_values());
    let mut out = vec![0u8; HEADER + LEVEL * mips.len()];
    out[..12].copy_from_slice(&IDENTIFIER);
    let words = [row.vk_format, row.type_size, record.width, record.height, 0, 0, 1, mips.len() as u32, 0];
    for (k, word) in words.iter().enumerate() {
        out[12 + 4 * k..16 + 4 * k].copy_from_slice(&word.to_le_bytes());
    }
    let parts = [out.len(), dfd.len(), out.len() + dfd.len(), kvd.len()];
    for (k, part) in parts.iter().enumerate() {
        out[INDEX + 4 * k..INDEX + 4 * k + 4].copy_from_slice(&(*part as u32).to_le_bytes());
    }
    out.extend(&dfd);
    out.extend(&kvd);
    for (mip, bytes) in mips.iter().enumerate().rev() {
        out.resize(out.len().next_multiple_of(format.unit_size() as usize), 0);
        let at = HEADER + LEVEL * mip;
        for (k, value) in [out.len(), bytes.len(), bytes.len()].iter().enumerate() {
            out[at + 8 * k..at + 8 * k + 8].copy_from_slice(&(*value as u64).to_le_bytes());
        }
        out.extend(*bytes);
    }
    Ok(out)
}
