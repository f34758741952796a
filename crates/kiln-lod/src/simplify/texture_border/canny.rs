//! Borders in a picture: Canny's detector on one plane of values.
//!
//! ```text
//! values    <- a weighted sum of the picture's codes, halved until no side is longer than asked
//! smooth    <- Gaussian of sigma texels, rows, then columns
//! gradient  <- Sobel's operator, codes a texel
//! ridges    <- texels whose gradient is the greatest along its own direction, between neighbours linearly; of two equal ones the darker
//! high      <- the quantile of the ridges' gradients that `high` names; low <- `low` times that
//! borders   <- ridges of at least `high`, and those of at least `low` that hang on one, eight neighbours a texel
//! ```
//! Beyond its edges the picture goes on as the sampler says, so a tile has no border where it meets itself.
//!
//! Source: J. Canny, A computational approach to edge detection, IEEE PAMI 8(6), 1986, doi:10.1109/TPAMI.1986.4767851.

use kiln_asset::Wrap;
use rayon::prelude::*;

use crate::simplify::plane::Plane;

/// A gradient below this is that of rounding and counts as none: codes a texel.
const NO_GRADIENT: f32 = 1.0 / 64.0;

/// Two gradients closer than this share of them differ by rounding.
const ROUNDING: f32 = 1e-4;

/// How the detector decides. Unitless but for sigma.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Thresholds {
    /// Of the Gaussian, texels; 0 smooths nothing.
    pub(super) sigma: f64,
    /// Share of the high threshold.
    pub(super) low: f64,
    /// Quantile of the ridges' gradients.
    pub(super) high: f64,
}

/// One bit a texel, top row first: whether a texture border runs through it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct BorderImage {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// `[height] x ceil(width / 64)`; bit x % 64 of word x / 64.
    words: Vec<u64>,
    count: u64,
}

impl BorderImage {
    pub(super) fn new(width: u32, height: u32) -> BorderImage {
        BorderImage { width, height, words: vec![0; width.div_ceil(64) as usize * height as usize], count: 0 }
    }

    fn row(&self, y: u32) -> &[u64] {
        let stride = self.width.div_ceil(64) as usize;
        &self.words[y as usize * stride..][..stride]
    }

    pub(super) fn set(&mut self, x: u32, y: u32) {
        let word = &mut self.words[y as usize * self.width.div_ceil(64) as usize + x as usize / 64];
        self.count += *word >> (x % 64) & 1 ^ 1;
        *word |= 1 << (x % 64);
    }

    /// Whether a border runs through texel `(x, y)`.
    ///
    /// # Panics
    /// If there is no such texel.
    pub fn get(&self, x: u32, y: u32) -> bool {
        self.row(y)[x as usize / 64] >> (x % 64) & 1 == 1
    }

    /// Texels that a border runs through.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Whether one of the texels from `first` to `last` of a row is set.
    #[inline]
    pub(super) fn any(&self, y: u32, first: u32, last: u32) -> bool {
        let row = self.row(y);
        let (begin, end) = (first as usize / 64, last as usize / 64);
        let (head, tail) = (u64::MAX << (first % 64), u64::MAX >> (63 - last % 64));
        if begin == end {
            return row[begin] & head & tail != 0;
        }
        row[begin] & head != 0 || row[end] & tail != 0 || row[begin + 1..end].iter().any(|word| *word != 0)
    }
}

impl Plane {
    /// Codes a texel, x and y.
    fn gradient(&self, x: usize, y: usize, wrap: [Wrap; 2]) -> [f32; 2] {
        let at = |dx: i64, dy: i64| self.at(x as i64 + dx, y as i64 + dy, wrap);
        let [nw, n, ne] = [at(-1, -1), at(0, -1), at(1, -1)];
        let [w, e] = [at(-1, 0), at(1, 0)];
        let [sw, s, se] = [at(-1, 1), at(0, 1), at(1, 1)];
        [((ne - nw) + 2.0 * (e - w) + (se - sw)) / 8.0, ((sw - nw) + 2.0 * (s - n) + (se - ne)) / 8.0]
    }

    /// The gradient where it is greatest along its own direction, 0 elsewhere: codes a texel.
    fn ridges(&self, wrap: [Wrap; 2]) -> Plane {
        let (width, height) = (self.width, self.height);
        let each = |of: &(dyn Fn(usize, usize) -> f32 + Sync)| {
            let mut values = vec![0.0; width * height];
            values.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
                for (x, value) in row.iter_mut().enumerate() {
                    *value = of(x, y);
                }
            });
            Plane { width, height, values }
        };
        let strength = each(&|x, y| {
            let [gx, gy] = self.gradient(x, y, wrap);
            (gx * gx + gy * gy).sqrt()
        });
        each(&|x, y| {
            let own = strength.values[y * width + x];
            if own < NO_GRADIENT {
                return 0.0;
            }
            let [gx, gy] = self.gradient(x, y, wrap);
            let step = |v: f32| if v < 0.0 { -1 } else { 1 };
            let (sx, sy) = (step(gx), step(gy));
            let (axis, across) = if gx.abs() >= gy.abs() { ([sx, 0], gy / gx) } else { ([0, sy], gx / gy) };
            let beside = |sign: i64| {
                let (x, y) = (x as i64, y as i64);
                let straight = strength.at(x + sign * axis[0], y + sign * axis[1], wrap);
                let oblique = strength.at(x + sign * sx, y + sign * sy, wrap);
                straight + (oblique - straight) * across.abs()
            };
            let margin = ROUNDING * own;
            if own >= beside(1) - margin && own > beside(-1) + margin { own } else { 0.0 }
        })
    }
}

/// The borders in `plane`, which goes on beyond its edges by `wrap`, in u and in v.
pub(super) fn detect(plane: &Plane, thresholds: &Thresholds, wrap: [Wrap; 2]) -> BorderImage {
    let mut borders = BorderImage::new(plane.width as u32, plane.height as u32);
    if plane.values.is_empty() {
        return borders;
    }
    let ridges = plane.smoothed(thresholds.sigma, wrap).ridges(wrap);
    let mut strengths: Vec<f32> = ridges.values.iter().copied().filter(|g| *g > 0.0).collect();
    if strengths.is_empty() {
        return borders;
    }
    let at = (thresholds.high.clamp(0.0, 1.0) * (strengths.len() - 1) as f64) as usize;
    let high = *strengths.select_nth_unstable_by(at, f32::total_cmp).1 * (1.0 - ROUNDING);
    let low = high * thresholds.low as f32;
    drop(strengths);

    let (width, height) = (plane.width, plane.height);
    let mut stack: Vec<[u32; 2]> = Vec::new();
    for (i, strength) in ridges.values.iter().enumerate() {
        let [x, y] = [i % width, i / width].map(|c| c as u32);
        if *strength >= high && !borders.get(x, y) {
            borders.set(x, y);
            stack.push([x, y]);
        }
        while let Some([x, y]) = stack.pop() {
            for (dx, dy) in [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)] {
                let x = wrap[0].texel(i64::from(x) + dx, width);
                let y = wrap[1].texel(i64::from(y) + dy, height);
                let strength = ridges.values[y * width + x];
                let [x, y] = [x, y].map(|c| c as u32);
                if strength > 0.0 && strength >= low && !borders.get(x, y) {
                    borders.set(x, y);
                    stack.push([x, y]);
                }
            }
        }
    }
    borders
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLAMP: [Wrap; 2] = [Wrap::ClampToEdge; 2];
    const REPEAT: [Wrap; 2] = [Wrap::Repeat; 2];
    const PUBLISHED: Thresholds = Thresholds { sigma: 0.75, low: 0.5, high: 0.6 };

    fn plane(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Plane {
        let values = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Plane { width, height, values }
    }

    fn texels(image: &BorderImage) -> Vec<(u32, u32)> {
        (0..image.height)
            .flat_map(|y| (0..image.width).map(move |x| (x, y)))
            .filter(|(x, y)| image.get(*x, *y))
            .collect()
    }

    #[test]
    fn a_step_is_found_one_texel_thin_on_its_darker_side() {
        for sigma in [0.0, 0.75, 2.0] {
            let how = Thresholds { sigma, ..PUBLISHED };
            let upright = detect(&plane(70, 20, |x, _| if x < 65 { 10.0 } else { 200.0 }), &how, CLAMP);
            assert_eq!(texels(&upright), (0..20).map(|y| (64, y)).collect::<Vec<_>>(), "sigma {sigma}");
            let lying = detect(&plane(20, 70, |_, y| if y < 65 { 200.0 } else { 10.0 }), &how, CLAMP);
            assert_eq!(texels(&lying), (0..20).map(|x| (x, 65)).collect::<Vec<_>>(), "sigma {sigma}");
        }
    }

    #[test]
    fn a_diagonal_step_is_a_chain_of_texels() {
        let found = detect(&plane(40, 40, |x, y| if x > y { 200.0 } else { 10.0 }), &PUBLISHED, CLAMP);
        for y in 3..37 {
            let row: Vec<u32> = (0..40).filter(|x| found.get(*x, y)).collect();
            // At 45 degrees the texels on both sides are maxima along the gradient.
            assert_eq!(row, [y, y + 1], "row {y}");
        }
    }

    #[test]
    fn a_flat_picture_has_no_border() {
        for wrap in [CLAMP, REPEAT, [Wrap::MirroredRepeat; 2]] {
            for sigma in [0.0, 0.75, 3.3] {
                let how = Thresholds { sigma, ..PUBLISHED };
                assert_eq!(detect(&plane(33, 17, |_, _| 77.7), &how, wrap).count(), 0);
            }
        }
        assert_eq!(detect(&plane(0, 0, |_, _| 0.0), &PUBLISHED, CLAMP).count(), 0);
        assert_eq!(detect(&plane(1, 1, |_, _| 9.0), &PUBLISHED, REPEAT).count(), 0);
    }

    #[test]
    fn a_tile_has_no_border_where_it_meets_itself() {
        // One dark band in a bright tile: two borders inside. A ramp: one, where it falls back.
        let band = plane(32, 8, |x, _| if (10..20).contains(&x) { 10.0 } else { 200.0 });
        let columns = |image: &BorderImage| texels(image).iter().filter(|t| t.1 == 0).map(|t| t.0).collect::<Vec<_>>();
        assert_eq!(columns(&detect(&band, &PUBLISHED, REPEAT)), [10, 19]);
        let ramp = plane(32, 8, |x, _| 5.0 * x as f32);
        let how = Thresholds { high: 1.0, ..PUBLISHED };
        assert_eq!(columns(&detect(&ramp, &how, REPEAT)), [0]);
        assert!(columns(&detect(&ramp, &how, CLAMP)).iter().all(|x| (1..31).contains(x)));
    }

    #[test]
    fn noise_beside_a_step_is_left_out_by_the_thresholds_and_by_sigma() {
        let noise = |x: usize, y: usize| (kiln_geom::sample::hash((y * 64 + x) as u64) % 8) as f32;
        let noisy = plane(64, 64, |x, y| noise(x, y) + if x < 32 { 40.0 } else { 200.0 });
        let off = |image: &BorderImage| texels(image).iter().filter(|t| t.0.abs_diff(31) > 1).count();
        let strict = detect(&noisy, &Thresholds { sigma: 1.0, low: 0.5, high: 0.97 }, CLAMP);
        assert_eq!(off(&strict), 0);
        assert!((0..64).all(|y| (30..=32).any(|x| strict.get(x, y))), "the step is whole");
        let [fine, coarse] = [0.75, 3.0].map(|sigma| off(&detect(&noisy, &Thresholds { sigma, ..PUBLISHED }, CLAMP)));
        assert!(2 * coarse < fine, "a wide Gaussian leaves less of the noise: {coarse} of {fine}");
    }

    #[test]
    fn a_weak_stretch_of_a_border_is_kept_where_it_hangs_on_a_strong_one() {
        // The step fades from 100 codes to 30 downwards.
        let picture = plane(32, 40, |x, y| if x < 16 { 0.0 } else { 100.0 - 1.8 * y as f32 });
        let found = detect(&picture, &Thresholds { sigma: 0.0, low: 0.2, high: 0.9 }, CLAMP);
        let at = |image: &BorderImage, y: u32| image.get(15, y) || image.get(16, y);
        assert!((2..38).all(|y| at(&found, y)), "hangs on the strong part");
        let alone = detect(&picture, &Thresholds { sigma: 0.0, low: 0.9, high: 0.9 }, CLAMP);
        assert!(at(&alone, 2) && !at(&alone, 35), "too weak");
        let apart = plane(64, 40, |x, _| {
            if x < 16 {
                0.0
            } else if x < 48 {
                100.0
            } else {
                130.0
            }
        });
        let found = detect(&apart, &Thresholds { sigma: 0.0, low: 0.2, high: 0.6 }, CLAMP);
        assert!(found.get(15, 5) && !found.get(47, 5), "weak and alone");
    }
}
