//! Mip chains.
//!
//! **Problem.** A picture comes in, its chain down to 1x1 goes out; each mip must look like the picture seen from further away.
//!
//! **Method.**
//! ```text
//! decode mip 0 to floats (sRGB -> linear, normals -> [-1, 1], else n / 255)
//! until 1x1: size = max(1, size / 2) rounded down
//!     each texel = mean over its footprint in the mip above, which for odd sizes covers parts of texels (exact shares)
//!     encode; normals are renormalised for the bytes only, the float chain keeps their length
//! ```
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

use kiln_asset::Raster;
use kiln_geom::colour;

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
    /// Tangent-space normals in RGB.
    Normal,
}

/// The picture and its mips down to 1x1, each `4 * width * height` bytes, sizes halving and rounding down.
pub fn chain(raster: &Raster, meaning: Meaning) -> Vec<Cow<'_, [u8]>> {
    let mut mips = vec![Cow::Borrowed(bytemuck::cast_slice(&raster.texels))];
    let (mut width, mut height) = (raster.width as usize, raster.height as usize);
    let mut floats: Option<Vec<[f32; 4]>> = None;
    while width.max(height) > 1 {
        let (w, h) = ((width / 2).max(1), (height / 2).max(1));
        let smaller = match &floats {
            None => halve((width, height), (w, h), |i| decode(raster.texels[i], meaning)),
            Some(floats) => halve((width, height), (w, h), |i| floats[i]),
        };
        mips.push(Cow::Owned(smaller.iter().flat_map(|texel| encode(*texel, meaning)).collect()));
        floats = Some(smaller);
        (width, height) = (w, h);
    }
    mips
}

/// Byte texel to averageable floats. Weighted colours are multiplied by alpha.
fn decode(texel: [u8; 4], meaning: Meaning) -> [f32; 4] {
    let plain = texel.map(|c| c as f32 / 255.0);
    match meaning {
        Meaning::Data => plain,
        Meaning::Normal => [plain[0] * 2.0 - 1.0, plain[1] * 2.0 - 1.0, plain[2] * 2.0 - 1.0, plain[3]],
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
        Meaning::Data => texel.map(colour::unorm8),
        Meaning::Normal => {
            let length = (x * x + y * y + z * z).sqrt();
            // Opposite normals cancel: the flat one is as good as any.
            let unit = if length > 1e-6 { [x / length, y / length, z / length] } else { [0.0, 0.0, 1.0] };
            let [x, y, z] = unit.map(|c| colour::unorm8(c * 0.5 + 0.5));
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

/// Box-filtered picture of size `to`, from one of size `from` of at most three times that size, texels by `read`.
fn halve(from: (usize, usize), to: (usize, usize), read: impl Fn(usize) -> [f32; 4]) -> Vec<[f32; 4]> {
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

    #[test]
    fn every_texel_of_an_odd_picture_weighs_the_same() {
        // 3 -> 1: each of three texels counts a third.
        let picture = raster(3, 1, |x, _| [[30, 0, 0, 255], [60, 0, 0, 255], [90, 0, 0, 255]][x as usize]);
        assert_eq!(chain(&picture, Meaning::Data)[1][0], 60);
    }
}
