//! Decoded pictures of either depth, and texels as the container's formats lay them.

use std::sync::Arc;

use half::f16;
use kiln_asset::{DeepRaster, Precision, Raster};
use kiln_format::{Channel, TextureFormat};
use kiln_geom::colour;

use crate::bc;

/// A decoded picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Picture {
    /// 8 bits a channel.
    Plain(Arc<Raster>),
    /// More.
    Deep(Arc<DeepRaster>),
}

impl From<Raster> for Picture {
    fn from(raster: Raster) -> Picture {
        Picture::Plain(Arc::new(raster))
    }
}

impl From<DeepRaster> for Picture {
    fn from(raster: DeepRaster) -> Picture {
        Picture::Deep(Arc::new(raster))
    }
}

impl Picture {
    /// Width and height, texels.
    pub fn size(&self) -> (u32, u32) {
        match self {
            Picture::Plain(raster) => (raster.width, raster.height),
            Picture::Deep(raster) => (raster.width, raster.height),
        }
    }

    /// Number of texels that are there.
    pub(crate) fn texel_count(&self) -> usize {
        match self {
            Picture::Plain(raster) => raster.texels.len(),
            Picture::Deep(raster) => raster.texels.len(),
        }
    }

    /// The picture in 8 bits a channel, rounded and clamped to [0, 1]; linear RGB becomes sRGB where `colour`.
    pub fn to_raster(&self, colour: bool) -> Arc<Raster> {
        match self {
            Picture::Plain(raster) => Arc::clone(raster),
            Picture::Deep(deep) => {
                let encode = |t: &[f32; 4]| {
                    if colour {
                        let [r, g, b] = [t[0], t[1], t[2]].map(colour::linear_to_srgb);
                        [r, g, b, colour::unorm8(t[3])]
                    } else {
                        t.map(colour::unorm8)
                    }
                };
                let texels = deep.texels.iter().map(encode).collect();
                Arc::new(Raster { width: deep.width, height: deep.height, texels })
            }
        }
    }
}

/// The container's format of a deep picture.
pub(crate) fn format_of(precision: Precision) -> TextureFormat {
    match precision {
        Precision::Unorm16 => TextureFormat::Rgba16Unorm,
        Precision::Half => TextureFormat::Rgba16Float,
        Precision::Float => TextureFormat::Rgba32Float,
    }
}

/// Nearest 16-bit number of a value in `[0, 1]`; clamped, NaN gives 0.
fn unorm16(value: f32) -> u16 {
    (f64::from(value) * 65_535.0 + 0.5) as u16
}

/// Nearest half; beyond the greatest finite one, that one.
fn half_of(value: f32) -> f16 {
    f16::from_f32(value.clamp(f16::MIN.to_f32(), f16::MAX.to_f32()))
}

/// Texels as `precision` stores them, little-endian.
pub(crate) fn encode(texels: &[[f32; 4]], precision: Precision) -> Vec<u8> {
    let values = texels.iter().flatten();
    match precision {
        Precision::Unorm16 => values.flat_map(|v| unorm16(*v).to_le_bytes()).collect(),
        Precision::Half => values.flat_map(|v| half_of(*v).to_le_bytes()).collect(),
        Precision::Float => values.flat_map(|v| v.to_le_bytes()).collect(),
    }
}

/// What a reader of [`encode`]'s bytes gets.
pub(crate) fn rounded(texel: [f32; 4], precision: Precision) -> [f32; 4] {
    match precision {
        Precision::Unorm16 => texel.map(|v| f32::from(unorm16(v)) / 65_535.0),
        Precision::Half => texel.map(|v| half_of(v).to_f32()),
        Precision::Float => texel,
    }
}

/// A mip of a container's texture as a picture: bytes of 8-bit formats as they lie, blocks decoded, with z of two-channel
/// normals put in. `bytes` has the length that `format` asks for (extra bytes are ignored, missing ones are texels of zeros).
pub(crate) fn decode(
    format: TextureFormat,
    channels: [Channel; 4],
    (width, height): (u32, u32),
    bytes: &[u8],
) -> Picture {
    let count = width as usize * height as usize;
    let deep = |precision, mut texels: Vec<[f32; 4]>| {
        texels.resize(count, [0.0; 4]);
        Picture::from(DeepRaster { width, height, precision, texels })
    };
    match format {
        TextureFormat::Rgba8Unorm | TextureFormat::Rgba8Srgb => {
            let mut texels: Vec<[u8; 4]> = bytes.as_chunks::<4>().0.to_vec();
            texels.resize(count, [0; 4]);
            Raster { width, height, texels }.into()
        }
        TextureFormat::Bc5Unorm | TextureFormat::Bc7Unorm | TextureFormat::Bc7Srgb => {
            let normal = channels[0] == Channel::NormalX && channels[2] != Channel::NormalZ;
            bc::decode(format, normal, width, height, bytes).into()
        }
        TextureFormat::Rgba16Unorm => {
            let texel = |t: &[u8; 8]| std::array::from_fn(|k| u16::from_le_bytes([t[2 * k], t[2 * k + 1]]));
            let texels = bytes.as_chunks::<8>().0.iter().map(texel);
            deep(Precision::Unorm16, texels.map(|t| t.map(|n: u16| f32::from(n) / 65_535.0)).collect())
        }
        TextureFormat::Rgba16Float => {
            let texel = |t: &[u8; 8]| std::array::from_fn(|k| f16::from_le_bytes([t[2 * k], t[2 * k + 1]]).to_f32());
            deep(Precision::Half, bytes.as_chunks::<8>().0.iter().map(texel).collect())
        }
        TextureFormat::Rgba32Float => {
            let value = |t: &[u8; 16], k: usize| f32::from_le_bytes([t[k], t[k + 1], t[k + 2], t[k + 3]]);
            let texel = |t: &[u8; 16]| [0, 4, 8, 12].map(|k| value(t, k));
            deep(Precision::Float, bytes.as_chunks::<16>().0.iter().map(texel).collect())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_texels_come_back_as_rounded_and_stay_where_they_are() {
        let texels: Vec<[f32; 4]> = (0..5000)
            .map(|i| {
                let x = i as f32 * 0.001 - 2.0;
                [x, x * x, 1.0 - x, x * 1e5]
            })
            .collect();
        for precision in [Precision::Unorm16, Precision::Half, Precision::Float] {
            let bytes = encode(&texels, precision);
            let channels = [Channel::Unused; 4];
            let Picture::Deep(deep) = decode(format_of(precision), channels, (100, 50), &bytes) else {
                panic!("{precision:?} is not deep");
            };
            assert_eq!(deep.precision, precision);
            for (got, texel) in deep.texels.iter().zip(&texels) {
                assert_eq!(*got, rounded(*texel, precision));
                assert_eq!(rounded(*got, precision), *got, "{precision:?}");
                assert!(got.iter().all(|c| c.is_finite()));
            }
            assert_eq!(encode(&deep.texels, precision), bytes);
        }
    }

    #[test]
    fn eight_bits_of_linear_light_are_srgb() {
        let deep = Picture::from(DeepRaster::filled(1, 1, Precision::Half, [0.5, 2.0, -1.0, 0.5]));
        assert_eq!(deep.to_raster(true).texels, [[188, 255, 0, 128]]);
        assert_eq!(deep.to_raster(false).texels, [[128, 255, 0, 128]]);
    }
}
