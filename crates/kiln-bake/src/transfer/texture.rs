//! Reading the source's pictures: wrap, bilinear, and a mip pyramid so that a baked texel averages the area it stands for.

use std::sync::Arc;

use glam::Vec2;
use kiln_asset::{Filter, Raster, Sampler};
use kiln_geom::colour::{linear_to_srgb, srgb_to_linear, unorm8};
use kiln_geom::math;

/// A picture with its halvings, encoded as the picture is (a quarter of 8-bit texels a level).
pub(crate) struct Pyramid {
    levels: Vec<Arc<Raster>>,
    srgb: bool,
}

impl Pyramid {
    /// The pyramid of a picture whose RGB is sRGB or linear. Each halving is the mean of 2 x 2 texels in linear light; the
    /// last column or row of an odd level stands alone in none of them, which moves its detail by less than a texel.
    pub(crate) fn new(picture: Arc<Raster>, srgb: bool) -> Pyramid {
        let mut levels = vec![picture];
        while let Some(finer) = levels.last().filter(|l| l.width > 1 || l.height > 1) {
            let halved = halve(finer, srgb);
            levels.push(Arc::new(halved));
        }
        Pyramid { levels, srgb }
    }

    /// RGBA in linear light at `uv`, averaged over a parallelogram of the sides `du`, `dv` (UV units).
    pub(crate) fn sample(&self, uv: Vec2, du: Vec2, dv: Vec2, sampler: &Sampler) -> [f32; 4] {
        let Some(finest) = self.levels.first() else { return [1.0; 4] };
        // Texels of the finest level that one baked texel stands for. By area: a stretched footprint blurs no more than a
        // round one of its size.
        let area = du.perp_dot(dv).abs() * finest.width as f32 * finest.height as f32;
        let level = if area > 1.0 { 0.5 * math::log2(area) } else { 0.0 };
        if level <= 0.0 {
            return match sampler.mag {
                Filter::Linear => self.bilinear(0, uv, sampler),
                Filter::Nearest => self.nearest(uv, sampler),
            };
        }
        let level = level.min((self.levels.len() - 1) as f32);
        let base = level as usize;
        let fine = self.bilinear(base, uv, sampler);
        if base + 1 >= self.levels.len() {
            return fine;
        }
        let coarse = self.bilinear(base + 1, uv, sampler);
        lerp(fine, coarse, level - base as f32)
    }

    fn nearest(&self, uv: Vec2, sampler: &Sampler) -> [f32; 4] {
        let level = &self.levels[0];
        let at = |c: f32, size: u32| (c as f64 * size as f64).floor() as i64;
        self.texel(0, at(uv.x, level.width), at(uv.y, level.height), sampler)
    }

    fn bilinear(&self, level: usize, uv: Vec2, sampler: &Sampler) -> [f32; 4] {
        let raster = &self.levels[level];
        let split = |c: f32, size: u32| {
            let at = c as f64 * size as f64 - 0.5;
            (at.floor() as i64, (at - at.floor()) as f32)
        };
        let (x, fx) = split(uv.x, raster.width);
        let (y, fy) = split(uv.y, raster.height);
        let row =
            |y: i64| lerp(self.texel(level, x, y, sampler), self.texel(level, x.saturating_add(1), y, sampler), fx);
        lerp(row(y), row(y.saturating_add(1)), fy)
    }

    fn texel(&self, level: usize, x: i64, y: i64, sampler: &Sampler) -> [f32; 4] {
        let raster = &self.levels[level];
        let (x, y) = (sampler.wrap_u.texel(x, raster.width as usize), sampler.wrap_v.texel(y, raster.height as usize));
        let texel = raster.texels.get(y * raster.width as usize + x).copied().unwrap_or([255; 4]);
        decode(texel, self.srgb)
    }
}

fn decode(texel: [u8; 4], srgb: bool) -> [f32; 4] {
    let linear = |c: u8| c as f32 / 255.0;
    let [r, g, b] = [texel[0], texel[1], texel[2]].map(|c| if srgb { srgb_to_linear(c) } else { linear(c) });
    [r, g, b, linear(texel[3])]
}

fn lerp(a: [f32; 4], b: [f32; 4], t: f32) -> [f32; 4] {
    std::array::from_fn(|i| a[i] + (b[i] - a[i]) * t)
}

fn halve(finer: &Raster, srgb: bool) -> Raster {
    let (width, height) = ((finer.width / 2).max(1), (finer.height / 2).max(1));
    let at = |x: u32, y: u32| {
        let (x, y) = (x.min(finer.width - 1), y.min(finer.height - 1));
        decode(finer.texels[y as usize * finer.width as usize + x as usize], srgb)
    };
    let mut texels = Vec::with_capacity(width as usize * height as usize);
    for y in 0..height {
        for x in 0..width {
            let four = [at(2 * x, 2 * y), at(2 * x + 1, 2 * y), at(2 * x, 2 * y + 1), at(2 * x + 1, 2 * y + 1)];
            let mean: [f32; 4] = std::array::from_fn(|c| (four[0][c] + four[1][c] + four[2][c] + four[3][c]) * 0.25);
            let [r, g, b, a] = mean;
            let [r, g, b] = [r, g, b].map(|c| if srgb { linear_to_srgb(c) } else { unorm8(c) });
            texels.push([r, g, b, unorm8(a)]);
        }
    }
    Raster { width, height, texels }
}

#[cfg(test)]
mod tests {
    use kiln_asset::Wrap;

    use super::*;

    fn ramp() -> Arc<Raster> {
        let texels = (0..16).map(|i| [i * 10, 0, 0, 255]).collect();
        Arc::new(Raster { width: 4, height: 4, texels })
    }

    fn red(p: &Pyramid, u: f32, v: f32, wrap: Wrap) -> f32 {
        let sampler = Sampler { wrap_u: wrap, wrap_v: wrap, ..Sampler::default() };
        p.sample(Vec2::new(u, v), Vec2::ZERO, Vec2::ZERO, &sampler)[0] * 255.0
    }

    #[test]
    fn texel_centres_give_texels_and_halfway_gives_the_mean() {
        let p = Pyramid::new(ramp(), false);
        assert!((red(&p, 0.375, 0.625, Wrap::Repeat) - 90.0).abs() < 1e-3);
        assert!((red(&p, 0.5, 0.625, Wrap::Repeat) - 95.0).abs() < 1e-3);
        assert!((red(&p, 0.375, 0.75, Wrap::Repeat) - 110.0).abs() < 1e-3);
    }

    #[test]
    fn the_three_wraps_differ_at_the_edge_as_they_should() {
        let p = Pyramid::new(ramp(), false);
        // At u = 0 the neighbours are texel 0 and what lies left of it.
        assert!((red(&p, 0.0, 0.125, Wrap::Repeat) - 15.0).abs() < 1e-3);
        assert!((red(&p, 0.0, 0.125, Wrap::ClampToEdge) - 0.0).abs() < 1e-3);
        assert!((red(&p, 1.375, 0.125, Wrap::Repeat) - 10.0).abs() < 1e-3);
        assert!((red(&p, 1.375, 0.125, Wrap::MirroredRepeat) - 20.0).abs() < 1e-3);
        assert!((red(&p, -0.375, 0.125, Wrap::MirroredRepeat) - 10.0).abs() < 1e-3);
        assert!((red(&p, 7.0, 0.125, Wrap::ClampToEdge) - 30.0).abs() < 1e-3);
    }

    #[test]
    fn a_wide_footprint_gives_the_mean_of_the_picture_in_linear_light() {
        let mut picture = Raster::filled(4, 4, [0, 0, 0, 255]);
        for (i, texel) in picture.texels.iter_mut().enumerate() {
            if (i + i / 4) % 2 == 0 {
                *texel = [255; 4];
            }
        }
        let p = Pyramid::new(Arc::new(picture), true);
        let mean = p.sample(Vec2::splat(0.3), Vec2::X, Vec2::Y, &Sampler::default());
        assert!((mean[0] - 0.5).abs() < 0.01, "{mean:?}");
    }

    #[test]
    fn a_nearest_sampler_magnifies_without_blending() {
        let p = Pyramid::new(ramp(), false);
        let sampler = Sampler { mag: Filter::Nearest, ..Sampler::default() };
        let value = p.sample(Vec2::new(0.49, 0.1), Vec2::ZERO, Vec2::ZERO, &sampler)[0] * 255.0;
        assert!((value - 10.0).abs() < 1e-3);
    }
}
