//! Block compression: BC5 for the two channels of a normal map, BC7 for the rest.
//!
//! **Problem.** RGBA8 texels come in, blocks of 4 x 4 texels of 16 bytes go out, as near to the texels as the format allows in
//! reasonable time, the same on any number of threads.
//!
//! **Method.**
//! ```text
//! for each row of blocks, in parallel:
//!     gather 4 x 4 texels; beyond the picture's edge its last row and column go on
//!     BC7: the encoder bc7f of Basis Universal
//!     BC5: two single-channel blocks (bc5.rs)
//! ```
//! A block depends on its own texels alone, so rows in any order give the same bytes.
//!
//! **Limits.** No rate-distortion optimisation: blocks are not made to compress further. Normals in BC5 lose the sign of z and
//! their length, so [`two_channels_suffice`] has to hold.
//!
//! Sources: the BC5 and BC7 chapters of the Khronos Data Format Specification 1.3 (RGTC, BPTC); bc7f by Binomial LLC, in the
//! crate `ctt-bc7f`.

mod bc5;

use kiln_asset::Raster;
use kiln_format::TextureFormat;
use rayon::prelude::*;

/// Which of bc7f's searches runs: the one that tries every candidate, which on two base colours and a normal map of the corpus gains
/// 1 to 3 dB over the analytical ones, for ten times their time (half a second for 2048 x 2048 on one thread).
const BC7_FLAGS: u32 = ctt_bc7f::bindings::cPackBC7FlagDefaultNonAnalytical;

/// Blocks of a picture of `width` x `height` RGBA8 texels. `format`: one of the block formats (others give no blocks).
pub(crate) fn encode(format: TextureFormat, texels: &[[u8; 4]], width: u32, height: u32) -> Vec<u8> {
    let (across, down) = (width.div_ceil(4) as usize, height.div_ceil(4) as usize);
    let mut out = vec![0u8; across * down * 16];
    out.par_chunks_exact_mut(across * 16).enumerate().for_each(|(row, blocks)| {
        let gathered = gather(texels, width as usize, height as usize, row, across);
        match format {
            TextureFormat::Bc5Unorm => {
                for (block, texels) in blocks.as_chunks_mut::<16>().0.iter_mut().zip(&gathered) {
                    let [x, y] = [0, 1].map(|channel| texels.map(|t| t[channel]));
                    block[..8].copy_from_slice(&bc5::encode_channel(&x));
                    block[8..].copy_from_slice(&bc5::encode_channel(&y));
                }
            }
            TextureFormat::Bc7Unorm | TextureFormat::Bc7Srgb => {
                ctt_bc7f::compress_blocks_into(bytemuck::cast_slice(&gathered), blocks, BC7_FLAGS);
            }
            _ => {}
        }
    });
    out
}

/// The texels of a row of blocks, block by block.
fn gather(texels: &[[u8; 4]], width: usize, height: usize, row: usize, across: usize) -> Vec<[[u8; 4]; 16]> {
    let block = |block: usize| {
        std::array::from_fn(|k| {
            let (x, y) = ((4 * block + k % 4).min(width - 1), (4 * row + k / 4).min(height - 1));
            texels[y * width + x]
        })
    };
    (0..across).map(block).collect()
}

/// The texels of a block-compressed picture. `normal`: BC5 holds x and y of unit normals, so z is put in.
pub(crate) fn decode(format: TextureFormat, normal: bool, width: u32, height: u32, blocks: &[u8]) -> Raster {
    let (across, w) = (width.div_ceil(4) as usize, width as usize);
    let mut raster = Raster::filled(width, height, [0, 0, 0, 255]);
    raster.texels.par_chunks_mut(4 * w).enumerate().for_each(|(row, lines)| {
        let mut texels = [[0u8; 4]; 16];
        for (number, block) in blocks.as_chunks::<16>().0.iter().skip(row * across).take(across).enumerate() {
            decode_block(format, normal, block, &mut texels);
            for (y, line) in lines.chunks_mut(w).enumerate() {
                let from = 4 * number;
                let count = (w - from).min(4);
                line[from..from + count].copy_from_slice(&texels[4 * y..4 * y + count]);
            }
        }
    });
    raster
}

fn decode_block(format: TextureFormat, normal: bool, block: &[u8; 16], out: &mut [[u8; 4]; 16]) {
    if format != TextureFormat::Bc5Unorm {
        bcdec_rs::bc7(block, bytemuck::cast_slice_mut(out), 16);
        return;
    }
    let mut pairs = [[0u8; 2]; 16];
    bcdec_rs::bc5(block, bytemuck::cast_slice_mut(&mut pairs), 8, false);
    for (texel, [x, y]) in out.iter_mut().zip(pairs) {
        *texel = [x, y, if normal { third(x, y) } else { 0 }, 255];
    }
}

/// z of a unit normal that does not look inwards, of 8-bit x and y.
fn third(x: u8, y: u8) -> u8 {
    let [x, y] = [x, y].map(|c| f32::from(c) / 127.5 - 1.0);
    kiln_geom::colour::unorm8((1.0 - x * x - y * y).max(0.0).sqrt() * 0.5 + 0.5)
}

/// Whether x and y tell the normals of a map: no unit normal looks inwards. Texels that are no unit normals, such as a black
/// background, are not asked.
pub(crate) fn two_channels_suffice(texels: &[[u8; 4]]) -> bool {
    texels.iter().all(|texel| {
        let [x, y, z] = [texel[0], texel[1], texel[2]].map(|c| f32::from(c) / 127.5 - 1.0);
        let is_unit = (0.9..1.1).contains(&(x * x + y * y + z * z));
        z > -0.02 || !is_unit
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, height: u32, texel: impl Fn(f32, f32) -> [f32; 4]) -> Vec<[u8; 4]> {
        let place = |i: u32| ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
        (0..width * height).map(place).map(|(x, y)| texel(x, y).map(kiln_geom::colour::unorm8)).collect()
    }

    /// Smooth shades with grain and a hard edge.
    fn colours(width: u32, height: u32) -> Vec<[u8; 4]> {
        picture(width, height, |x, y| {
            let grain = ((x * 913.0 + y * 577.0).sin() * 43_758.547).fract().abs() * 0.06;
            let edge = if x + 0.3 * y > 0.6 { 0.3 } else { 0.0 };
            [0.5 * x + grain + edge, 0.6 * y + grain, 0.4 + 0.3 * (9.0 * x).sin() + grain, 1.0 - 0.5 * x * y]
        })
    }

    fn normals(width: u32, height: u32) -> Vec<[u8; 4]> {
        picture(width, height, |x, y| {
            let n = glam::Vec3::new(0.7 * (21.0 * x).sin(), 0.7 * (17.0 * y + 3.0 * x).cos(), 1.0).normalize();
            let [x, y, z] = n.to_array().map(|c| c * 0.5 + 0.5);
            [x, y, z, 1.0]
        })
    }

    /// Over the channels given, of 8-bit values.
    fn psnr(a: &[[u8; 4]], b: &[[u8; 4]], channels: usize) -> f64 {
        let squares = a.iter().zip(b).flat_map(|(a, b)| (0..channels).map(|k| a[k].abs_diff(b[k]) as u64));
        let sum: u64 = squares.map(|d| d * d).sum();
        10.0 * (255.0 * 255.0 * (a.len() * channels) as f64 / sum.max(1) as f64).log10()
    }

    #[test]
    fn what_an_independent_decoder_reads_is_near_what_went_in() {
        // Floors 1 dB under what was measured, in dB: BC7 over RGBA, BC5 over x and y, and with z.
        for (width, height, floors) in [(256, 128, [45.4, 50.7, 51.2]), (61, 39, [37.5, 41.1, 42.2])] {
            let texels = colours(width, height);
            let blocks = encode(TextureFormat::Bc7Srgb, &texels, width, height);
            assert_eq!(blocks.len() as u64, TextureFormat::Bc7Srgb.mip_length(width, height));
            let found = decode(TextureFormat::Bc7Srgb, false, width, height, &blocks);
            let bc7 = psnr(&texels, &found.texels, 4);
            let texels = normals(width, height);
            let blocks = encode(TextureFormat::Bc5Unorm, &texels, width, height);
            let found = decode(TextureFormat::Bc5Unorm, true, width, height, &blocks);
            let quality = [bc7, psnr(&texels, &found.texels, 2), psnr(&texels, &found.texels, 3)];
            assert!(quality.iter().zip(floors).all(|(q, f)| *q > f), "{width} x {height}: {quality:.1?} dB");
        }
    }

    #[test]
    fn an_opaque_picture_stays_opaque_but_for_shared_low_bits() {
        let texels: Vec<[u8; 4]> = colours(64, 64).into_iter().map(|[r, g, b, _]| [r, g, b, 255]).collect();
        let found = decode(TextureFormat::Bc7Srgb, false, 64, 64, &encode(TextureFormat::Bc7Srgb, &texels, 64, 64));
        let least = found.texels.iter().map(|texel| texel[3]).min();
        assert!(least >= Some(254), "{least:?}");
    }

    #[test]
    fn one_colour_stays_itself_up_to_the_format_s_least_step() {
        for texel in [[0, 0, 0, 255], [255; 4], [17, 203, 99, 255], [128, 128, 255, 255]] {
            let texels = vec![texel; 35];
            let blocks = encode(TextureFormat::Bc5Unorm, &texels, 7, 5);
            let found = decode(TextureFormat::Bc5Unorm, false, 7, 5, &blocks);
            assert!(found.texels.iter().all(|t| t[..2] == texel[..2]), "{texel:?}");
            let blocks = encode(TextureFormat::Bc7Unorm, &texels, 7, 5);
            let found = decode(TextureFormat::Bc7Unorm, false, 7, 5, &blocks);
            assert!(found.texels.iter().flatten().zip(texels.iter().flatten()).all(|(a, b)| a.abs_diff(*b) <= 1));
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_blocks() {
        let texels = colours(200, 96);
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a pool");
            pool.install(|| {
                [TextureFormat::Bc5Unorm, TextureFormat::Bc7Srgb].map(|format| encode(format, &texels, 200, 96))
            })
        };
        let one = with(1);
        assert!(one == with(2) && one == with(5));
    }

    #[test]
    fn normals_that_look_inwards_need_three_channels() {
        assert!(two_channels_suffice(&normals(64, 64)));
        assert!(two_channels_suffice(&[[0, 0, 0, 255], [128, 128, 128, 255], [255, 128, 128, 255]]));
        assert!(!two_channels_suffice(&[[128, 128, 255, 255], [128, 128, 0, 255]]));
    }
}
