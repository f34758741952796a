//! PNG of 8 or 16 bits a channel.

use std::io::Cursor;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use super::Planes;
use crate::picture::Picture;

/// The bytes of a PNG. Deep pictures are of 16 bits; the caller has sorted out floats.
pub(super) fn encode(picture: &Picture, planes: Planes) -> Result<Vec<u8>, String> {
    let (width, height) = picture.size();
    let count = planes.count();
    let (samples, colour): (Vec<u8>, _) = match picture {
        Picture::Plain(raster) => {
            let colour = [ExtendedColorType::L8, ExtendedColorType::Rgb8, ExtendedColorType::Rgba8];
            (raster.texels.iter().flat_map(|t| t[..count].iter().copied()).collect(), colour)
        }
        Picture::Deep(deep) => {
            let sample = |c: &f32| ((f64::from(*c) * 65_535.0 + 0.5) as u16).to_ne_bytes();
            let colour = [ExtendedColorType::L16, ExtendedColorType::Rgb16, ExtendedColorType::Rgba16];
            (deep.texels.iter().flat_map(|t| t[..count].iter().flat_map(sample)).collect(), colour)
        }
    };
    let mut out = Vec::new();
    let encoder = PngEncoder::new_with_quality(Cursor::new(&mut out), CompressionType::Default, FilterType::Adaptive);
    let colour = colour[planes as usize];
    encoder.write_image(&samples, width, height, colour).map_err(|e| e.to_string())?;
    Ok(out)
}
