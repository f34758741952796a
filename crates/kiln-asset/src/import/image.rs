//! Images: size from the header alone, decoding within limits.

use std::io::Cursor;

use super::ImageLimits;
use super::error::ImportError;
use crate::material::ImageFormat;
use crate::raster::Raster;

const PNG_MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";
const JPEG_MAGIC: &[u8] = b"\xFF\xD8\xFF";

/// The format that the first bytes tell, if kiln reads it.
pub fn image_format(bytes: &[u8]) -> Option<ImageFormat> {
    if bytes.starts_with(PNG_MAGIC) {
        Some(ImageFormat::Png)
    } else if bytes.starts_with(JPEG_MAGIC) {
        Some(ImageFormat::Jpeg)
    } else if bytes.starts_with(b"RAST") {
        Some(ImageFormat::Raster)
    } else {
        None
    }
}

/// Width and height in texels, read from the header alone; `None` if there is no such header.
pub fn image_size(format: ImageFormat, bytes: &[u8]) -> Option<(u32, u32)> {
    match format {
        ImageFormat::Png => png_size(bytes),
        ImageFormat::Jpeg => jpeg_size(bytes),
        ImageFormat::Raster => raster_size(bytes),
    }
}

fn big_endian<const N: usize>(bytes: &[u8], at: usize) -> Option<[u8; N]> {
    bytes.get(at..at.checked_add(N)?)?.try_into().ok()
}

/// PNG: the IHDR chunk must come first.
fn png_size(bytes: &[u8]) -> Option<(u32, u32)> {
    if !bytes.starts_with(PNG_MAGIC) || bytes.get(12..16)? != b"IHDR" {
        return None;
    }
    Some((u32::from_be_bytes(big_endian(bytes, 16)?), u32::from_be_bytes(big_endian(bytes, 20)?)))
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
                let height = u16::from_be_bytes(big_endian(bytes, at + 5)?);
                let width = u16::from_be_bytes(big_endian(bytes, at + 7)?);
                return Some((width as u32, height as u32));
            }
            // Start of scan or end of image before any frame.
            0xDA | 0xD9 => return None,
            _ => {
                let length = u16::from_be_bytes(big_endian(bytes, at + 2)?) as usize;
                if length < 2 {
                    return None;
                }
                at += 2 + length;
            }
        }
    }
}

/// Raster blob: tag, version, array of two sizes.
fn raster_size(bytes: &[u8]) -> Option<(u32, u32)> {
    if !bytes.starts_with(b"RAST") {
        return None;
    }
    let word = |at| Some(u32::from_le_bytes(big_endian(bytes, at)?));
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
/// 255 where there is none. No colour space is changed, no orientation tag followed, as glTF asks.
///
/// # Errors
/// *Invalid* where the header is broken or past the limits (checked before anything is decoded), or the data is broken.
pub fn decode_image(format: ImageFormat, bytes: &[u8], limits: &ImageLimits) -> Result<Raster, ImportError> {
    let invalid = |message: String| ImportError::invalid("image", message);
    let (width, height) = check_size("image", format, bytes, limits)?;
    let codec = match format {
        ImageFormat::Png => image::ImageFormat::Png,
        ImageFormat::Jpeg => image::ImageFormat::Jpeg,
        ImageFormat::Raster => return Raster::from_blob(bytes).map_err(|e| invalid(e.to_string())),
    };
    let mut reader = image::ImageReader::with_format(Cursor::new(bytes), codec);
    let mut allowed = image::Limits::default();
    allowed.max_image_width = Some(limits.max_side);
    allowed.max_image_height = Some(limits.max_side);
    // 16 bits x 4 channels is the widest decoded texel; a decoder keeps about one more copy.
    allowed.max_alloc = Some((width as u64 * height as u64).saturating_mul(16).saturating_add(1 << 20));
    reader.limits(allowed);
    let picture = reader.decode().map_err(|e| invalid(format!("cannot be decoded: {e}")))?.into_rgba8();
    if picture.dimensions() != (width, height) {
        return Err(invalid(format!("header says {width} x {height}, the data {:?}", picture.dimensions())));
    }
    Ok(Raster { width, height, texels: bytemuck::pod_collect_to_vec(picture.as_raw()) })
}
