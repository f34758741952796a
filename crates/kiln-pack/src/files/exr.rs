//! OpenEXR, lossless: one level in lines, or all levels in tiles.

use std::io::Cursor;

use exr::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, Levels};
use exr::math::RoundingMode;
use exr::meta::attribute::{IntegerBounds, LineOrder};
use exr::meta::header::{ImageAttributes, LayerAttributes};
use exr::prelude::{Blocks, Compression, SmallVec, Vec2, WritableImage};
use half::f16;

use super::{FloatLevel, Planes};

/// Width and height of a tile, texels: what renderers cache.
const TILE: usize = 64;

/// The bytes of an EXR. `levels`: mip 0 and, for a mip-mapped file, all others, halving and rounding down; a chain that is not
/// whole leaves as its first level.
pub(super) fn encode(levels: &[FloatLevel], planes: Planes, tiled: bool) -> Result<Vec<u8>, String> {
    let Some(first) = levels.first() else { return Err("it has no mip".into()) };
    let size = Vec2(first.width as usize, first.height as usize);
    let whole = tiled && levels.len() == kiln_format::full_mip_count(first.width, first.height) as usize;
    let names: &[(&str, usize)] = match planes {
        Planes::One => &[("Y", 0)],
        Planes::Three => &[("R", 0), ("G", 1), ("B", 2)],
        Planes::Four => &[("R", 0), ("G", 1), ("B", 2), ("A", 3)],
    };
    let channel = |(name, plane): &(&str, usize)| {
        let data = if whole {
            let level_data = levels.iter().map(|level| samples(level, *plane)).collect();
            Levels::Mip { rounding_mode: RoundingMode::Down, level_data }
        } else {
            Levels::Singular(samples(first, *plane))
        };
        AnyChannel::new(*name, data)
    };
    let channels: SmallVec<[_; 4]> = names.iter().map(channel).collect();
    let blocks = if tiled { Blocks::Tiles(Vec2(TILE, TILE)) } else { Blocks::ScanLines };
    let encoding = Encoding { compression: Compression::ZIP16, blocks, line_order: LineOrder::Increasing };
    let layer = Layer::new(size, LayerAttributes::default(), encoding, AnyChannels::sort(channels));
    let image = Image::empty(ImageAttributes::new(IntegerBounds::from_dimensions(size))).with_layer(layer);
    let mut out = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut out).map_err(|e| e.to_string())?;
    Ok(out.into_inner())
}

fn samples(level: &FloatLevel, plane: usize) -> FlatSamples {
    let values = level.texels.iter().map(|texel| texel[plane]);
    if level.full { FlatSamples::F32(values.collect()) } else { FlatSamples::F16(values.map(f16::from_f32).collect()) }
}
