//! Planes of numbers and separable filters over them.

use rayon::prelude::*;

/// One number a pixel.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Plane {
    pub(crate) width: usize,
    /// `[height * width]`, top row first.
    pub(crate) values: Vec<f32>,
}

impl Plane {
    pub(crate) fn new(width: u32, values: Vec<f32>) -> Plane {
        Plane { width: width as usize, values }
    }

    /// `across` along the rows, then `down` along the columns; both of odd length. Beyond the edge lies the edge's value.
    pub(crate) fn filtered(&self, across: &[f32], down: &[f32]) -> Plane {
        self.along_rows(across).along_columns(down)
    }

    pub(crate) fn along_rows(&self, kernel: &[f32]) -> Plane {
        let (width, radius) = (self.width, kernel.len() / 2);
        let mut values = vec![0.0; self.values.len()];
        let pairs = values.par_chunks_mut(width.max(1)).zip(self.values.par_chunks(width.max(1)));
        pairs.for_each(|(out, row)| {
            let mut padded = vec![row[0]; width + 2 * radius];
            padded[radius..radius + width].copy_from_slice(row);
            padded[radius + width..].fill(row[width - 1]);
            for (k, weight) in kernel.iter().enumerate() {
                out.iter_mut().zip(&padded[k..]).for_each(|(out, value)| *out += weight * value);
            }
        });
        Plane { width, values }
    }

    pub(crate) fn along_columns(&self, kernel: &[f32]) -> Plane {
        let (width, radius) = (self.width.max(1), kernel.len() / 2);
        let height = self.values.len() / width;
        let mut values = vec![0.0; self.values.len()];
        values.par_chunks_mut(width).enumerate().for_each(|(y, out)| {
            for (k, weight) in kernel.iter().enumerate() {
                let from = (y + k).saturating_sub(radius).min(height - 1) * width;
                out.iter_mut().zip(&self.values[from..from + width]).for_each(|(out, value)| *out += weight * value);
            }
        });
        Plane { width, values }
    }

    /// The same plane with every value changed.
    pub(crate) fn map(&self, change: impl Fn(f32) -> f32) -> Plane {
        Plane { width: self.width, values: self.values.iter().map(|v| change(*v)).collect() }
    }

    /// Two planes of one size, value by value.
    pub(crate) fn with(&self, other: &Plane, mix: impl Fn(f32, f32) -> f32) -> Plane {
        let values = self.values.iter().zip(&other.values).map(|(a, b)| mix(*a, *b)).collect();
        Plane { width: self.width, values }
    }
}

/// `exp(-x^2 / (2 sigma^2))` for x in `-radius..=radius`, not normalised.
pub(crate) fn gaussian(radius: usize, sigma: f64) -> Vec<f64> {
    let at = |k: usize| k as f64 - radius as f64;
    (0..=2 * radius).map(|k| kiln_geom::math::exp64(-0.5 * at(k) * at(k) / (sigma * sigma))).collect()
}

/// Weights times `factor`, rounded once.
pub(crate) fn scaled(weights: &[f64], factor: f64) -> Vec<f32> {
    weights.iter().map(|w| (w * factor) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_filter_weighs_its_neighbours_and_repeats_the_edge() {
        let plane = Plane::new(3, vec![1.0, 2.0, 4.0, 8.0, 16.0, 32.0]);
        let shift = [0.0, 0.0, 1.0];
        assert_eq!(plane.along_rows(&shift).values, [2.0, 4.0, 4.0, 16.0, 32.0, 32.0]);
        assert_eq!(plane.along_columns(&shift).values, [8.0, 16.0, 32.0, 8.0, 16.0, 32.0]);
        assert_eq!(plane.filtered(&[1.0, 0.0, 0.0], &[1.0]).values, [1.0, 1.0, 2.0, 8.0, 8.0, 16.0]);
        assert_eq!(plane.filtered(&[0.5, 1.0, 0.5], &[1.0]).values[1], 4.5);
    }

    #[test]
    fn a_kernel_longer_than_the_picture_is_no_trouble() {
        let plane = Plane::new(1, vec![3.0]);
        assert_eq!(plane.filtered(&[0.25; 9], &[0.25; 9]).values, [3.0 * 9.0 * 0.25 * 9.0 * 0.25]);
        assert_eq!(Plane::new(0, Vec::new()).filtered(&[1.0], &[1.0]).values, [0.0; 0]);
    }
}
