//! Images: size from the header alone, decoding within limits.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use basisu::{DecodeFlags, TargetFormat, Transcoder};

use super::error::ImportError;
use super::{ImageLimits, exr, has_extension, tiff};
use crate::material::ImageFormat;
use crate::raster::{DeepRaster, Raster};

const PNG_MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";
const KTX2_MAGIC: &[u8] = b"\xABKTX 20\xBB\r\n\x1A\n";
const JPEG_MAGIC: &[u8] = b"\xFF\xD8\xFF";

/// The format that the first bytes tell, if kiln reads it.
pub fn image_format(bytes: &[u8]) -> Option<ImageFormat> {
    if bytes.starts_with(PNG_MAGIC) {
        Some(ImageFormat::Png)
    } else if bytes.starts_with(JPEG_MAGIC) {
        Some(ImageFormat::Jpeg)
    } else if bytes.starts_with(b"RAST") {
        Some(ImageFormat::Raster)
    } else if bytes.starts_with(b"RIFF") && bytes.get(8..12) == Some(b"WEBP") {
        Some(ImageFormat::Webp)
    } else if bytes.starts_with(KTX2_MAGIC) {
        Some(ImageFormat::Ktx2)
    } else if bytes.starts_with(exr::MAGIC) {
        Some(ImageFormat::Exr)
    } else if tiff::MAGICS.iter().any(|magic| bytes.starts_with(magic)) {
        Some(ImageFormat::Tiff)
    } else {
        None
    }
}

/// The format that the first bytes tell, or for TGA, which has no mark, the file's name; last what OpenImageIO reads, where the
/// build has it.
pub fn image_format_of_file(name: &str, bytes: &[u8]) -> Option<ImageFormat> {
    let tga = || has_extension(name, "tga").then_some(ImageFormat::Tga);
    image_format(bytes).or_else(tga).or_else(|| kiln_oiio::size(bytes).is_ok().then_some(ImageFormat::System))
}

/// Width and height in texels, read from the header alone; `None` if there is no such header.
pub fn image_size(format: ImageFormat, bytes: &[u8]) -> Option<(u32, u32)> {
    match format {
        ImageFormat::Png => png_size(bytes),
        ImageFormat::Jpeg => jpeg_size(bytes),
        ImageFormat::Raster => raster_size(bytes),
        ImageFormat::Deep => DeepRaster::from_blob(bytes).ok().map(|deep| (deep.width, deep.height)),
        ImageFormat::Webp => webp_size(bytes),
        ImageFormat::Ktx2 => ktx2_size(bytes),
        ImageFormat::Tiff => tiff::size(bytes),
        ImageFormat::Tga => tga_size(bytes),
        ImageFormat::Exr | ImageFormat::ExrLinear => exr::size(bytes),
        ImageFormat::System => kiln_oiio::size(bytes).ok().map(|size| (size.width, size.height)),
    }
}

fn array<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at.checked_add(N)?)?.try_into().ok()
}

/// PNG: the IHDR chunk must come first.
fn png_size(bytes: &[u8]) -> Option<(u32, u32)> {
    if !bytes.starts_with(PNG_MAGIC) || bytes.get(12..16)? != b"IHDR" {
        return None;
    }
    Some((u32::from_be_bytes(array(bytes, 16)?), u32::from_be_bytes(array(bytes, 20)?)))
}

/// JPEG: segments up to the first start of frame (SOF0..SOF15 without the tables DHT, JPG, DAC).
fn jpeg_size(bytes: &[u8]) -> Option<(u32, u32)> {
    if !bytes.starts_with(JPEG_MAGIC) {
        return None;
    }
    let mut at = 2;
    loop {
        if *bytes.get(at)? != 0xFF {
            return None;
        }
        let marker = *bytes.get(at + 1)?;
        match marker {
            // Fill byte; then markers without a length.
            0xFF => at += 1,
            0x01 | 0xD0..=0xD8 => at += 2,
            0xC0..=0xCF if !matches!(marker, 0xC4 | 0xC8 | 0xCC) => {
                let height = u16::from_be_bytes(array(bytes, at + 5)?);
                let width = u16::from_be_bytes(array(bytes, at + 7)?);
                return Some((width as u32, height as u32));
            }
            // Start of scan or end of image before any frame.
            0xDA | 0xD9 => return None,
            _ => {
                let length = u16::from_be_bytes(array(bytes, at + 2)?) as usize;
                if length < 2 {
                    return None;
                }
                at += 2 + length;
            }
        }
    }
}

/// WebP: the first chunk is a lossy frame, a lossless one, or a header for several.
fn webp_size(bytes: &[u8]) -> Option<(u32, u32)> {
    let word = |at| Some(u16::from_le_bytes(array(bytes, at)?) as u32);
    match bytes.get(12..16)? {
        // Key frame's start code, then 14 bits a side.
        b"VP8 " if bytes.get(23..26)? == [0x9D, 0x01, 0x2A] => Some((word(26)? & 0x3FFF, word(28)? & 0x3FFF)),
        b"VP8L" if *bytes.get(20)? == 0x2F => {
            let bits = u32::from_le_bytes(array(bytes, 21)?);
            Some(((bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1))
        }
        b"VP8X" => {
            let side = |at: usize| Some(word(at)? | (*bytes.get(at + 2)? as u32) << 16);
            Some((side(24)? + 1, side(27)? + 1))
        }
        _ => None,
    }
}

/// KTX2: a fixed header; one picture, that is no depth, no layers, one face.
fn ktx2_size(bytes: &[u8]) -> Option<(u32, u32)> {
    let word = |at| Some(u32::from_le_bytes(array(bytes, at)?));
    let (depth, layers, faces) = (word(28)?, word(32)?, word(36)?);
    (bytes.starts_with(KTX2_MAGIC) && depth == 0 && layers <= 1 && faces == 1).then_some((word(20)?, word(24)?))
}

/// TGA: a fixed header without a mark, so every field with few values is looked at.
fn tga_size(bytes: &[u8]) -> Option<(u32, u32)> {
    let word = |at| Some(u32::from(u16::from_le_bytes(array(bytes, at)?)));
    let (map, kind, depth) = (*bytes.get(1)?, *bytes.get(2)?, *bytes.get(16)?);
    let known = map <= 1 && matches!(kind, 1..=3 | 9..=11) && matches!(depth, 8 | 15 | 16 | 24 | 32);
    known.then_some((word(12)?, word(14)?))
}

/// Raster blob: tag, version, array of two sizes.
fn raster_size(bytes: &[u8]) -> Option<(u32, u32)> {
    if !bytes.starts_with(b"RAST") {
        return None;
    }
    let word = |at| Some(u32::from_le_bytes(array(bytes, at)?));
    Some((word(16)?, word(20)?))
}

/// Checks an image's size against the limits by its header; gives the size.
pub(super) fn check_size(
    path: &str,
    format: ImageFormat,
    bytes: &[u8],
    limits: &ImageLimits,
) -> Result<(u32, u32), ImportError> {
    let Some((width, height)) = image_size(format, bytes) else {
        return Err(ImportError::invalid(path, "its header is broken or cut off"));
    };
    if width == 0 || height == 0 {
        return Err(ImportError::invalid(path, format!("size {width} x {height}")));
    }
    if width > limits.max_side || height > limits.max_side {
        let message = format!("size {width} x {height}, the limit is {} a side", limits.max_side);
        return Err(ImportError::invalid(path, message));
    }
    if width as u64 * height as u64 > limits.max_texels {
        let message = format!("size {width} x {height}, the limit is {} texels", limits.max_texels);
        return Err(ImportError::invalid(path, message));
    }
    Ok((width, height))
}

/// The picture in `bytes` as RGBA8 texels: grey is spread over RGB, palettes are looked up, 16 bits are rounded to 8, alpha is
/// 255 where there is none. No colour space is changed, no orientation tag followed, as glTF asks; but for EXR as colour, whose light
/// is encoded as sRGB.
///
/// # Errors
/// *Invalid* where the header is broken or past the limits (checked before anything is decoded), or the data is broken.
pub fn decode_image(format: ImageFormat, bytes: &[u8], limits: &ImageLimits) -> Result<Raster, ImportError> {
    let invalid = |message: String| ImportError::invalid("image", message);
    let (width, height) = check_size("image", format, bytes, limits)?;
    let codec = match format {
        ImageFormat::Png => image::ImageFormat::Png,
        ImageFormat::Jpeg => image::ImageFormat::Jpeg,
        ImageFormat::Webp => image::ImageFormat::WebP,
        ImageFormat::Raster => return Raster::from_blob(bytes).map_err(|e| invalid(e.to_string())),
        ImageFormat::Deep => return Err(invalid("a deep picture does not fit 8 bits".into())),
        ImageFormat::Ktx2 => return transcode(bytes, width, height).map_err(invalid),
        ImageFormat::Tiff => image::ImageFormat::Tiff,
        ImageFormat::Tga => image::ImageFormat::Tga,
        ImageFormat::Exr => return guarded(|| exr::decode(bytes, true, limits)).map_err(invalid),
        ImageFormat::ExrLinear => return guarded(|| exr::decode(bytes, false, limits)).map_err(invalid),
        ImageFormat::System => return by_system(bytes, limits).map_err(invalid),
    };
    let mut reader = image::ImageReader::with_format(Cursor::new(bytes), codec);
    let mut allowed = image::Limits::default();
    allowed.max_image_width = Some(limits.max_side);
    allowed.max_image_height = Some(limits.max_side);
    // 16 bits x 4 channels is the widest decoded texel; a decoder keeps about one more copy.
    allowed.max_alloc = Some((width as u64 * height as u64).saturating_mul(16).saturating_add(1 << 20));
    reader.limits(allowed);
    let decoded = guarded(|| reader.decode().map_err(|e| format!("cannot be decoded: {e}"))).map_err(invalid)?;
    let picture = decoded.into_rgba8();
    if picture.dimensions() != (width, height) {
        return Err(invalid(format!("header says {width} x {height}, the data {:?}", picture.dimensions())));
    }
    Ok(Raster { width, height, texels: bytemuck::pod_collect_to_vec(picture.as_raw()) })
}

/// What a foreign decoder gives; should it panic, that is this picture's end and not the build's.
fn guarded<T>(decode: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(decode)).unwrap_or_else(|_| Err("cannot be decoded: the decoder failed".into()))
}

/// A picture that OpenImageIO reads, values as they are: of one or two channels grey (and alpha), else the first four.
fn by_system(bytes: &[u8], limits: &ImageLimits) -> Result<Raster, String> {
    let size = kiln_oiio::size(bytes).map_err(|e| e.to_string())?;
    if size.values() > limits.max_texels.saturating_mul(4) {
        return Err(format!("{} channels of {} x {} texels, past the limit", size.channels, size.width, size.height));
    }
    let values = kiln_oiio::read(bytes, size).map_err(|e| e.to_string())?;
    let byte = |value: f32| (value * 255.0 + 0.5) as u8;
    let texel = |t: &[f32]| match *t {
        [y] => [byte(y), byte(y), byte(y), 255],
        [y, a] => [byte(y), byte(y), byte(y), byte(a)],
        [r, g, b] => [byte(r), byte(g), byte(b), 255],
        [r, g, b, a, ..] => [byte(r), byte(g), byte(b), byte(a)],
        [] => [0; 4],
    };
    let texels = values.chunks_exact(size.channels.max(1) as usize).map(texel).collect();
    Ok(Raster { width: size.width, height: size.height, texels })
}

/// The finest level of a KTX2 file with Basis Universal texels.
fn transcode(bytes: &[u8], width: u32, height: u32) -> Result<Raster, String> {
    let texels = guarded(|| {
        let whole = Transcoder::new(bytes).and_then(|t| t.transcode(0, TargetFormat::Rgba32, DecodeFlags::NONE));
        whole.map_err(|error| format!("cannot be transcoded: {error:?}"))
    })?;
    if texels.len() as u64 != 4 * width as u64 * height as u64 {
        return Err(format!("header says {width} x {height}, but there are {} bytes of texels", texels.len()));
    }
    Ok(Raster { width, height, texels: bytemuck::pod_collect_to_vec(&texels) })
}
