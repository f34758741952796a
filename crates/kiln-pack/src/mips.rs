//! Mip chains.
//!
//! **Problem.** A picture comes in, its chain down to 1x1 goes out; each mip must look like the picture seen from further away.
//!
//! **Method.**
//! ```text
//! decode mip 0 to floats (sRGB -> linear, normals -> [-1, 1], else n / 255); deep pictures are floats, colours linear
//! until 1x1: size = max(1, size / 2) rounded down
//!     each texel = mean over its footprint in the mip above, which for odd sizes covers parts of texels (exact shares)
//!     encode; normals are renormalised for the bytes only, the float chain keeps their length
//! ```
//! Numbers of things have no mean: they are picked, from the texel at the footprint's middle. Mips of deep pictures are made of the
//! texels as they are stored, so that a reader makes the same ones.
//!
//! Colours under partial alpha are weighted by alpha where alpha means coverage, so that what is hidden does not tint the
//! visible; alpha itself is a plain mean.
//!
//! **Limits.** Under alpha mode *mask* the visible share of a mip differs from that of the picture, because a cutoff does not
//! commute with a mean: cut-outs such as foliage thin out with distance. Nothing compensates for it yet. Wrapping is not
//! looked at: the box never reaches beyond the picture.
//!
//! Source: the box filter of Williams, "Pyramidal parametrics", SIGGRAPH 1983, doi:10.1145/964967.801126, with footprints for
//! sizes that are no power of two.

use std::borrow::Cow;

use kiln_asset::{DeepRaster, Precision, Raster};
use kiln_geom::colour;

use crate::picture;

/// What the texels mean, hence how they are averaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Meaning {
    /// sRGB colour; alpha, where it is used, is linear.
    Colour {
        /// Weight colours by alpha.
        alpha_weighted: bool,
    },
    /// Four independent linear channels.
    Data,
    /// Unit vectors in RGB as `(v + 1) / 2`.
    Normal,
    /// Unit vectors in RGB as they are, which 8 bits cannot hold.
    Vector,
    /// Numbers of things.
    Number,
}

/// The picture and its mips down to 1x1, each `4 * width * height` bytes, sizes halving and rounding down.
pub fn chain(raster: &Raster, meaning: Meaning) -> Vec<Cow<'_, [u8]>> {
    let mut mips = vec![Cow::Borrowed(bytemuck::cast_slice(&raster.texels))];
    let (mut width, mut height) = (raster.width as usize, raster.height as usize);
    let mut floats: Option<Vec<[f32; 4]>> = None;
    while width.max(height) > 1 {
        let (w, h) = ((width / 2).max(1), (height / 2).max(1));
        let smaller = match &floats {
            None => halve((width, height), (w, h), meaning, |i| decode(raster.texels[i], meaning)),
            Some(floats) => halve((width, height), (w, h), meaning, |i| floats[i]),
        };
        mips.push(Cow::Owned(smaller.iter().flat_map(|texel| encode(*texel, meaning)).collect()));
        floats = Some(smaller);
        (width, height) = (w, h);
    }
    mips
}

/// The picture and its mips down to 1x1 as `precision` stores them ([`kiln_format::TextureFormat::mip_length`] bytes each).
/// `all` off: the picture alone.
pub fn deep_chain(deep: &DeepRaster, meaning: Meaning, all: bool) -> Vec<Vec<u8>> {
    let precision = deep.precision;
    let mut mips = vec![picture::encode(&deep.texels, precision)];
    let (mut width, mut height) = (deep.width as usize, deep.height as usize);
    let mut floats: Option<Vec<[f32; 4]>> = None;
    while all && width.max(height) > 1 {
        let (w, h) = ((width / 2).max(1), (height / 2).max(1));
        let read = |i: usize| decode_deep(picture::rounded(deep.texels[i], precision), meaning);
        let smaller = match &floats {
            None => halve((width, height), (w, h), meaning, read),
            Some(floats) => halve((width, height), (w, h), meaning, |i| floats[i]),
        };
        let texels: Vec<[f32; 4]> = smaller.iter().map(|texel| encode_deep(*texel, meaning, precision)).collect();
        mips.push(picture::encode(&texels, precision));
        floats = Some(smaller);
        (width, height) = (w, h);
    }
    mips
}

/// Deep texel to averageable floats. Weighted colours are multiplied by alpha.
fn decode_deep(texel: [f32; 4], meaning: Meaning) -> [f32; 4] {
    let [x, y, z, w] = texel;
    match meaning {
        Meaning::Data | Meaning::Number | Meaning::Vector => texel,
        Meaning::Normal => [x * 2.0 - 1.0, y * 2.0 - 1.0, z * 2.0 - 1.0, w],
        Meaning::Colour { alpha_weighted } => {
            let weight = if alpha_weighted { w } else { 1.0 };
            [x * weight, y * weight, z * weight, w]
        }
    }
}

fn encode_deep(texel: [f32; 4], meaning: Meaning, precision: Precision) -> [f32; 4] {
    let [x, y, z, w] = texel;
    let out = match meaning {
        Meaning::Data | Meaning::Number => texel,
        Meaning::Normal | Meaning::Vector => {
            let [x, y, z] = unit([x, y, z]);
            let [a, b] = if meaning == Meaning::Normal { [0.5; 2] } else { [1.0, 0.0] };
            [x * a + b, y * a + b, z * a + b, w]
        }
        Meaning::Colour { alpha_weighted } => {
            let scale = if alpha_weighted && w > 0.0 { 1.0 / w } else { 1.0 };
            [x * scale, y * scale, z * scale, w]
        }
    };
    // A tiny alpha may drive a float out of range; the format wants finite ones.
    if precision == Precision::Float { out.map(|c| c.clamp(f32::MIN, f32::MAX)) } else { out }
}

/// A vector's direction. Opposite ones cancel: +Z is as good as any.
fn unit([x, y, z]: [f32; 3]) -> [f32; 3] {
    let length = (x * x + y * y + z * z).sqrt();
    if length > 1e-6 { [x / length, y / length, z / length] } else { [0.0, 0.0, 1.0] }
}

/// Byte texel to averageable floats. Weighted colours are multiplied by alpha.
fn decode(texel: [u8; 4], meaning: Meaning) -> [f32; 4] {
    let plain = texel.map(|c| c as f32 / 255.0);
    match meaning {
        Meaning::Data | Meaning::Number => plain,
        Meaning::Normal | Meaning::Vector => {
            [plain[0] * 2.0 - 1.0, plain[1] * 2.0 - 1.0, plain[2] * 2.0 - 1.0, plain[3]]
        }
        Meaning::Colour { alpha_weighted } => {
            let weight = if alpha_weighted { plain[3] } else { 1.0 };
            let light = |c: u8| colour::srgb_to_linear(c) * weight;
            [light(texel[0]), light(texel[1]), light(texel[2]), plain[3]]
        }
    }
}

fn encode(texel: [f32; 4], meaning: Meaning) -> [u8; 4] {
    let [x, y, z, w] = texel;
    match meaning {
        Meaning::Data | Meaning::Number => texel.map(colour::unorm8),
        Meaning::Normal | Meaning::Vector => {
            let [x, y, z] = unit([x, y, z]).map(|c| colour::unorm8(c * 0.5 + 0.5));
            [x, y, z, colour::unorm8(w)]
        }
        Meaning::Colour { alpha_weighted } => {
            let scale = if alpha_weighted && w > 0.0 { 1.0 / w } else { 1.0 };
            let [r, g, b] = [x, y, z].map(|c| colour::linear_to_srgb(c * scale));
            [r, g, b, colour::unorm8(w)]
        }
    }
}

/// Footprint of a texel along one side: the texels above it, each with its share (shares sum to 1).
fn footprint(from: usize, to: usize, at: usize) -> ([usize; 3], [f32; 3]) {
    // In units of 1 / to of a texel above: the footprint is [at * from, (at + 1) * from).
    let (start, end) = (at * from, (at + 1) * from);
    let (mut texels, mut shares) = ([0; 3], [0.0; 3]);
    for k in 0..3 {
        let texel = start / to + k;
        let (lo, hi) = ((texel * to).max(start), ((texel + 1) * to).min(end));
        texels[k] = texel.min(from - 1);
        shares[k] = hi.saturating_sub(lo) as f32 / from as f32;
    }
    (texels, shares)
}

/// Box-filtered picture of size `to`, from one of size `from` of at most three times that size, texels by `read`; numbers are
/// picked.
fn halve(
    from: (usize, usize),
    to: (usize, usize),
    meaning: Meaning,
    read: impl Fn(usize) -> [f32; 4],
) -> Vec<[f32; 4]> {
    if meaning == Meaning::Number {
        let middle = |at: usize, from: usize, to: usize| (2 * at + 1) * from / (2 * to);
        let place = |i: usize| middle(i / to.0, from.1, to.1) * from.0 + middle(i % to.0, from.0, to.0);
        return (0..to.0 * to.1).map(|i| read(place(i))).collect();
    }
    let columns: Vec<_> = (0..to.0).map(|x| footprint(from.0, to.0, x)).collect();
    let mut out = Vec::with_capacity(to.0 * to.1);
    for y in 0..to.1 {
        let (rows, row_shares) = footprint(from.1, to.1, y);
        for (texels, shares) in &columns {
            let mut sum = [0.0f32; 4];
            for (row, row_share) in rows.iter().zip(row_shares) {
                for (texel, share) in texels.iter().zip(shares) {
                    let weight = row_share * share;
                    if weight > 0.0 {
                        let value = read(row * from.0 + texel);
                        for k in 0..4 {
                            sum[k] += value[k] * weight;
                        }
                    }
                }
            }
            out.push(sum);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raster(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Raster {
        let texels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| texel(x, y)).collect();
        Raster { width, height, texels }
    }

    #[test]
    fn black_and_white_average_in_linear_light() {
        let picture = raster(2, 1, |x, _| if x == 0 { [0, 0, 0, 255] } else { [255; 4] });
        let mips = chain(&picture, Meaning::Colour { alpha_weighted: false });
        // Half the light is code 188, not 128.
        assert_eq!(*mips[1], [188, 188, 188, 255]);
        assert_eq!(*chain(&picture, Meaning::Data)[1], [128, 128, 128, 255]);
    }

    #[test]
    fn hidden_colour_does_not_tint_the_visible() {
        let picture = raster(2, 2, |x, _| if x == 0 { [255, 0, 0, 255] } else { [0, 255, 0, 0] });
        assert_eq!(*chain(&picture, Meaning::Colour { alpha_weighted: true })[1], [255, 0, 0, 128]);
    }

    #[test]
    fn a_constant_picture_stays_constant_at_odd_sizes() {
        for (width, height) in [(7, 5), (1, 9), (13, 1), (3, 3), (255, 2)] {
            let picture = raster(width, height, |_, _| [10, 120, 250, 77]);
            for meaning in [Meaning::Data, Meaning::Colour { alpha_weighted: false }] {
                let mips = chain(&picture, meaning);
                assert_eq!(mips.len() as u32, kiln_format::full_mip_count(width, height));
                for mip in &mips {
                    assert!(mip.chunks(4).all(|texel| texel == [10, 120, 250, 77]), "{width} x {height}");
                }
            }
        }
    }

    #[test]
    fn tilted_normals_average_to_a_unit_normal_between_them() {
        let picture = raster(2, 1, |x, _| if x == 0 { [218, 128, 218, 255] } else { [37, 128, 218, 255] });
        assert_eq!(*chain(&picture, Meaning::Normal)[1], [128, 128, 255, 255]);
    }

    fn values(bytes: &[u8]) -> Vec<f32> {
        bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect()
    }

    #[test]
    fn deep_pictures_average_in_their_own_terms() {
        let of = |a: [f32; 4], b: [f32; 4], meaning| {
            let deep = DeepRaster { width: 2, height: 1, precision: Precision::Float, texels: vec![a, b] };
            values(&deep_chain(&deep, meaning, true)[1])
        };
        let colour = Meaning::Colour { alpha_weighted: true };
        assert_eq!(of([8.0, 0.0, 0.0, 1.0], [0.0, 9.0, 0.0, 0.0], colour), [8.0, 0.0, 0.0, 0.5]);
        assert_eq!(of([-1.0, 2.0, 0.0, 1.0], [3.0, 2.0, 1.0, 0.0], Meaning::Data), [1.0, 2.0, 0.5, 0.5]);
        assert_eq!(of([1.0, 0.0, 0.0, 1.0], [-1.0, 0.0, 0.0, 1.0], Meaning::Vector)[..3], [0.0, 0.0, 1.0]);
        let slant = of([1.0, 0.5, 0.5, 1.0], [0.5, 0.5, 1.0, 1.0], Meaning::Normal);
        assert!((slant[0] - 0.853_553_4).abs() < 1e-6 && (slant[2] - 0.853_553_4).abs() < 1e-6, "{slant:?}");
        // Submesh 3 beside submesh 8 is never 5.5.
        assert_eq!(of([3.0, 0.0, 0.0, 1.0], [8.0, 0.0, 0.0, 1.0], Meaning::Number)[0], 8.0);
    }

    #[test]
    fn mips_of_what_was_stored_are_the_stored_mips() {
        let texels: Vec<[f32; 4]> = (0..35).map(|i| [i as f32 * 0.028, 1.0 - i as f32 * 0.02, 0.3, 0.77]).collect();
        for precision in [Precision::Unorm16, Precision::Half, Precision::Float] {
            let deep = DeepRaster { width: 7, height: 5, precision, texels: texels.clone() };
            let mips = deep_chain(&deep, Meaning::Normal, true);
            let back =
                picture::decode(picture::format_of(precision), [kiln_format::Channel::Unused; 4], (7, 5), &mips[0]);
            let picture::Picture::Deep(back) = back else { panic!("not deep") };
            assert_eq!(deep_chain(&back, Meaning::Normal, true), mips, "{precision:?}");
            for (k, mip) in mips.iter().enumerate() {
                let length = picture::format_of(precision).mip_length((7 >> k).max(1), (5 >> k).max(1));
                assert_eq!(mip.len() as u64, length);
            }
        }
    }

    #[test]
    fn every_texel_of_an_odd_picture_weighs_the_same() {
        // 3 -> 1: each of three texels counts a third.
        let picture = raster(3, 1, |x, _| [[30, 0, 0, 255], [60, 0, 0, 255], [90, 0, 0, 255]][x as usize]);
        assert_eq!(chain(&picture, Meaning::Data)[1][0], 60);
    }
}
