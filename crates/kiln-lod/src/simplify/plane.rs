//! One value a texel: how simplify's chapters read pictures. Weighted sums of codes, halving, Gaussian, wrapping.

use kiln_asset::{Raster, Wrap};
use rayon::prelude::*;

/// One value a texel, top row first.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plane {
    pub(super) width: usize,
    pub(super) height: usize,
    /// `[height * width]`, codes in `[0, 255]`.
    pub(super) values: Vec<f32>,
}

impl Plane {
    /// The sum of a picture's red, green and blue codes weighted by `weights`, and faded by alpha if that is what is seen;
    /// halved by means until no side is longer than `side`.
    pub(super) fn of(picture: &Raster, weights: [f32; 3], alpha: bool, side: u32) -> Plane {
        let value = |t: &[u8; 4]| {
            let [r, g, b] = [0, 1, 2].map(|c| f32::from(t[c]) * weights[c]);
            (r + g + b) * if alpha { f32::from(t[3]) / 255.0 } else { 1.0 }
        };
        let values = picture.texels.par_iter().map(value).collect();
        let mut plane = Plane { width: picture.width as usize, height: picture.height as usize, values };
        while plane.width.max(plane.height) > side.max(1) as usize {
            plane = plane.halved();
        }
        plane
    }

    /// Half the size by means of two by two; an odd last row or column is dropped, a single one stays.
    fn halved(&self) -> Plane {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut values = vec![0.0; width * height];
        values.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            let [above, below] = [2 * y, (2 * y + 1).min(self.height - 1)].map(|y| &self.values[y * self.width..]);
            for (x, value) in row.iter_mut().enumerate() {
                let (left, right) = (2 * x, (2 * x + 1).min(self.width - 1));
                *value = 0.25 * (above[left] + above[right] + below[left] + below[right]);
            }
        });
        Plane { width, height, values }
    }

    /// The value at a texel anywhere, beyond the edges by `wrap`, in u and in v.
    pub(super) fn at(&self, x: i64, y: i64, wrap: [Wrap; 2]) -> f32 {
        self.values[wrap[1].texel(y, self.height) * self.width + wrap[0].texel(x, self.width)]
    }

    /// Smoothed by a Gaussian of `sigma` texels, rows, then columns; beyond its edges the picture goes on by `wrap`.
    pub(super) fn smoothed(&self, sigma: f64, wrap: [Wrap; 2]) -> Plane {
        let kernel = gaussian(sigma);
        let reach = kernel.len() as i64 / 2;
        let (width, height) = (self.width, self.height);
        let mut rows = vec![0.0; self.values.len()];
        rows.par_chunks_mut(width).zip(self.values.par_chunks(width)).for_each(|(out, row)| {
            let padded: Vec<f32> = (-reach..width as i64 + reach).map(|x| row[wrap[0].texel(x, width)]).collect();
            for (value, window) in out.iter_mut().zip(padded.windows(kernel.len())) {
                *value = window.iter().zip(&kernel).map(|(v, k)| v * k).sum();
            }
        });
        let mut values = vec![0.0; rows.len()];
        values.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
            for (k, factor) in kernel.iter().enumerate() {
                let from = wrap[1].texel(y as i64 + k as i64 - reach, height) * width;
                for (value, v) in out.iter_mut().zip(&rows[from..from + width]) {
                    *value += v * factor;
                }
            }
        });
        Plane { width, height, values }
    }
}

/// Weights of a Gaussian out to three sigmas; their sum is 1.
fn gaussian(sigma: f64) -> Vec<f32> {
    if sigma <= 0.0 {
        return vec![1.0];
    }
    let reach = (3.0 * sigma).ceil() as i64;
    let raw: Vec<f64> = (-reach..=reach).map(|i| libm::exp(-0.5 * (i as f64 / sigma).powi(2))).collect();
    let sum: f64 = raw.iter().sum();
    raw.iter().map(|w| (w / sum) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_is_halved_until_it_fits_and_its_codes_are_weighted() {
        let mut picture = Raster::filled(64, 16, [10, 20, 30, 255]);
        picture.texels[1] = [30, 20, 30, 0];
        let plane = Plane::of(&picture, [1.0, 0.5, 0.0], false, 1000);
        assert_eq!((plane.width, plane.height, plane.values[0], plane.values[1]), (64, 16, 20.0, 40.0));
        assert_eq!(Plane::of(&picture, [1.0, 0.5, 0.0], true, 1000).values[1], 0.0);
        let half = Plane::of(&picture, [1.0, 0.5, 0.0], false, 32);
        assert_eq!((half.width, half.height, half.values[0], half.values[1]), (32, 8, 25.0, 20.0));
        let least = Plane::of(&picture, [1.0, 0.5, 0.0], false, 1);
        assert_eq!((least.width, least.height), (1, 1));
    }
}
