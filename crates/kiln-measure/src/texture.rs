//! Texels: mip chains by box filter, bilinear and trilinear reads with wrap modes.

use std::borrow::Cow;

use glam::{Vec2, Vec4};
use kiln_asset::{Filter, Raster, Sampler};

/// A picture and smaller versions of it, each half as wide and high.
#[derive(Clone, Debug)]
pub struct MipChain<'a> {
    levels: Vec<Cow<'a, Raster>>,
}

impl<'a> MipChain<'a> {
    /// The chain down to one texel.
    pub fn whole(picture: &'a Raster) -> MipChain<'a> {
        let mut levels = vec![Cow::Borrowed(picture)];
        while let Some(last) = levels.last()
            && last.width.max(last.height) > 1
        {
            let next = halved(last);
            levels.push(Cow::Owned(next));
        }
        MipChain { levels }
    }

    /// Level `level` alone, or the smallest there is: the chain for reading everything at one level.
    pub fn only(picture: &'a Raster, level: u32) -> MipChain<'a> {
        MipChain { levels: vec![mip(picture, level)] }
    }

    /// Width times height of the largest level, texels.
    pub fn texel_count(&self) -> f32 {
        self.levels[0].width as f32 * self.levels[0].height as f32
    }

    /// The texture at `uv` (v down) and level of detail `lod` (0: the chain's first level), with texels decoded by `decode`
    /// before they are mixed. A picture without texels gives `decode([255; 4])`.
    pub fn sample(&self, sampler: &Sampler, uv: Vec2, lod: f32, decode: impl Fn([u8; 4]) -> Vec4) -> Vec4 {
        let last = (self.levels.len() - 1) as f32;
        let lod = if sampler.mip.is_none() { 0.0 } else { lod.clamp(0.0, last) };
        let filter = if lod > 0.0 { sampler.min } else { sampler.mag };
        let lod = if sampler.mip == Some(Filter::Nearest) { (lod + 0.5).floor().min(last) } else { lod };
        let (low, part) = (lod.floor(), lod - lod.floor());
        let read = |level: f32| read(&self.levels[level as usize], sampler, filter, uv, &decode);
        if part == 0.0 { read(low) } else { read(low).lerp(read(low + 1.0), part) }
    }
}

/// Level `level` of a picture's mips (0: itself), or the smallest there is.
pub fn mip(picture: &Raster, level: u32) -> Cow<'_, Raster> {
    let mut own = Cow::Borrowed(picture);
    for _ in 0..level {
        if own.width.max(own.height) <= 1 {
            break;
        }
        own = Cow::Owned(halved(&own));
    }
    own
}

/// Half the size by 2x2 means, rounded; an odd last row or column is dropped, a single one stays.
fn halved(from: &Raster) -> Raster {
    let (width, height) = ((from.width / 2).max(1), (from.height / 2).max(1));
    let mut texels = Vec::with_capacity(width as usize * height as usize);
    for y in 0..height {
        for x in 0..width {
            let at = |dx: u32, dy: u32| {
                let (x, y) = ((2 * x + dx).min(from.width - 1), (2 * y + dy).min(from.height - 1));
                from.texels[y as usize * from.width as usize + x as usize]
            };
            let four = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
            texels.push(std::array::from_fn(|c| ((four.iter().map(|t| t[c] as u32).sum::<u32>() + 2) / 4) as u8));
        }
    }
    Raster { width, height, texels }
}

#[inline]
fn read(level: &Raster, sampler: &Sampler, filter: Filter, uv: Vec2, decode: &impl Fn([u8; 4]) -> Vec4) -> Vec4 {
    if level.texels.is_empty() {
        return decode([255; 4]);
    }
    let (x, y) = (uv.x * level.width as f32, uv.y * level.height as f32);
    let (column, row) =
        (|i| sampler.wrap_u.texel(i, level.width as usize), |j| sampler.wrap_v.texel(j, level.height as usize));
    let texel = |i: usize, j: usize| decode(level.texels[j * level.width as usize + i]);
    match filter {
        Filter::Nearest => texel(column(x.floor() as i64), row(y.floor() as i64)),
        Filter::Linear => {
            let (x, y) = (x - 0.5, y - 0.5);
            let (fx, fy) = (x - x.floor(), y - y.floor());
            let (i, j) = (x.floor() as i64, y.floor() as i64);
            let (right, down) = (column(i.saturating_add(1)), row(j.saturating_add(1)));
            let (i, j) = (column(i), row(j));
            let top = texel(i, j).lerp(texel(right, j), fx);
            top.lerp(texel(i, down).lerp(texel(right, down), fx), fy)
        }
    }
}

#[cfg(test)]
mod tests {
    use kiln_asset::Wrap;

    use super::*;

    fn grey(value: u8) -> [u8; 4] {
        [value, value, value, 255]
    }

    fn picture() -> Raster {
        Raster { width: 4, height: 2, texels: [0, 40, 80, 120, 8, 48, 88, 128].map(grey).to_vec() }
    }

    fn red(chain: &MipChain<'_>, sampler: &Sampler, u: f32, v: f32, lod: f32) -> f32 {
        chain.sample(sampler, Vec2::new(u, v), lod, |t| Vec4::from(t.map(f32::from))).x
    }

    #[test]
    fn centres_give_texels_and_the_middle_between_gives_the_mean() {
        let picture = picture();
        let chain = MipChain::whole(&picture);
        let sampler = Sampler::default();
        assert_eq!(red(&chain, &sampler, 0.125, 0.25, 0.0), 0.0);
        assert_eq!(red(&chain, &sampler, 0.375, 0.75, 0.0), 48.0);
        assert_eq!(red(&chain, &sampler, 0.25, 0.25, 0.0), 20.0);
        assert_eq!(red(&chain, &sampler, 0.25, 0.5, 0.0), 24.0);
    }

    #[test]
    fn v_runs_down() {
        let picture = picture();
        let chain = MipChain::whole(&picture);
        assert!(red(&chain, &Sampler::default(), 0.125, 0.9, 0.0) > red(&chain, &Sampler::default(), 0.125, 0.3, 0.0));
    }

    #[test]
    fn wrap_modes_differ_outside() {
        let read = |wrap: Wrap, index| wrap.texel(index, 4);
        let row = |wrap| (-5..9).map(|i| read(wrap, i)).collect::<Vec<_>>();
        assert_eq!(row(Wrap::Repeat), [3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0]);
        assert_eq!(row(Wrap::ClampToEdge), [0, 0, 0, 0, 0, 0, 1, 2, 3, 3, 3, 3, 3, 3]);
        assert_eq!(row(Wrap::MirroredRepeat), [3, 3, 2, 1, 0, 0, 1, 2, 3, 3, 2, 1, 0, 0]);
        let picture = picture();
        for wrap_u in [Wrap::Repeat, Wrap::ClampToEdge, Wrap::MirroredRepeat] {
            let sampler = Sampler { wrap_u, ..Sampler::default() };
            assert!(red(&MipChain::whole(&picture), &sampler, 1e30, -1e30, 0.0).is_finite());
        }
    }

    #[test]
    fn mips_are_means_and_levels_mix() {
        let picture = picture();
        let chain = MipChain::whole(&picture);
        assert_eq!(chain.levels.iter().map(|l| (l.width, l.height)).collect::<Vec<_>>(), [(4, 2), (2, 1), (1, 1)]);
        assert_eq!(chain.levels[1].texels, [24, 104].map(grey));
        assert_eq!(chain.levels[2].texels, [grey(64)]);
        let sampler = Sampler::default();
        assert_eq!(red(&chain, &sampler, 0.25, 0.5, 1.0), 24.0);
        assert_eq!(red(&chain, &sampler, 0.25, 0.5, 1.5), 44.0);
        assert_eq!(red(&chain, &sampler, 0.25, 0.5, 99.0), 64.0);
        assert_eq!(red(&MipChain::only(&picture, 1), &sampler, 0.25, 0.5, 0.0), 24.0);
        let flat = Sampler { mip: None, ..sampler };
        assert_eq!(red(&chain, &flat, 0.375, 0.75, 5.0), 48.0);
    }

    #[test]
    fn the_nearest_filter_mixes_nothing() {
        let picture = picture();
        let sampler = Sampler { mag: Filter::Nearest, ..Sampler::default() };
        assert_eq!(red(&MipChain::whole(&picture), &sampler, 0.26, 0.25, 0.0), 40.0);
    }
}
