//! Structural similarity of two pictures.
//!
//! Comes in: two pictures of one size. Goes out: the mean over pixels of an index of at most 1, which equal pictures alone have.
//!
//! ```text
//! y = 0.299 R + 0.587 G + 0.114 B of the sRGB codes, for each picture
//! window = 11 x 11 Gaussian, sigma 1.5, sum 1
//! for each pixel whose window lies in the picture:
//!     means, variances and covariance of both y under the window
//!     index = (2 mx my + C1) (2 cov + C2) / ((mx^2 + my^2 + C1) (vx + vy + C2)),  C1 = (0.01 * 255)^2,  C2 = (0.03 * 255)^2
//! ```
//! **Choices.** Luma of the codes and not luminance, whole windows only, variances not corrected for the sample's size: all as in
//! the authors' own code. Codes are not rounded. No reduction of large pictures before. Two means are given: over all pixels with
//! a whole window, and over those of them that either model covers, since an empty background counts as perfect.
//!
//! **Limits.** Blind to hue at equal luma. A picture smaller than the window has no index and counts as 1.
//!
//! Source: Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, Image Quality Assessment: From Error Visibility to Structural
//! Similarity, IEEE TIP 13(4), 2004, doi:10.1109/TIP.2003.819861, equation 13.

use crate::MeasureError;
use crate::filter::{Plane, gaussian, scaled};
use crate::image_error::same_size;
use crate::pool::{PixelSums, on_object};
use crate::render::Picture;

/// Pixels from the middle of the window to its edge.
const RADIUS: usize = 5;
const SIGMA: f64 = 1.5;
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

/// Taken off before squaring: the variance does not change, and 24 bits of mantissa are enough for it.
const MIDDLE: f32 = 128.0;

/// The index of two pictures, summed over their pixels; symmetric.
///
/// # Errors
/// The pictures differ in size.
pub fn ssim(reference: &Picture, other: &Picture) -> Result<PixelSums, MeasureError> {
    same_size(0, reference, other)?;
    let (x, y) = (luma(reference), luma(other));
    let weights = gaussian(RADIUS, SIGMA);
    let kernel = scaled(&weights, 1.0 / weights.iter().sum::<f64>());
    let under_window = |plane: Plane| plane.filtered(&kernel, &kernel).values;
    let mean_xx = under_window(x.map(|v| v * v));
    let mean_yy = under_window(y.map(|v| v * v));
    let mean_xy = under_window(x.with(&y, |a, b| a * b));
    let (mean_x, mean_y) = (under_window(x), under_window(y));

    let (width, height) = (reference.width as usize, reference.height as usize);
    let mut sums = PixelSums::default();
    for row in RADIUS..height.saturating_sub(RADIUS) {
        for column in RADIUS..width.saturating_sub(RADIUS) {
            let k = row * width + column;
            let (mx, my) = (mean_x[k] as f64, mean_y[k] as f64);
            let (vx, vy) = ((mean_xx[k] as f64 - mx * mx).max(0.0), (mean_yy[k] as f64 - my * my).max(0.0));
            let covariance = mean_xy[k] as f64 - mx * my;
            // From equal planes the covariance may fall below 0 by rounding, where the variances were cut off.
            let covariance = if vx == 0.0 && vy == 0.0 { covariance.max(0.0) } else { covariance };
            let (mx, my) = (mx + MIDDLE as f64, my + MIDDLE as f64);
            let above = (2.0 * mx * my + C1) * (2.0 * covariance + C2);
            let below = (mx * mx + my * my + C1) * (vx + vy + C2);
            sums.add((above / below).min(1.0), on_object(reference, other, k));
        }
    }
    Ok(sums)
}

/// Luma of the codes less [`MIDDLE`].
fn luma(picture: &Picture) -> Plane {
    let values = picture.codes.iter().map(|c| 0.299 * c.x + 0.587 * c.y + 0.114 * c.z - MIDDLE).collect();
    Plane::new(picture.width, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    /// A picture of greys, its left half on the object.
    fn grey(size: u32, code: impl Fn(u32, u32) -> f32) -> Picture {
        let places = (0..size * size).map(|k| (k % size, k / size));
        Picture {
            width: size,
            height: size,
            codes: places.clone().map(|(x, y)| Vec3::splat(code(x, y))).collect(),
            coverage: places.map(|(x, _)| if x < size / 2 { 1.0 } else { 0.0 }).collect(),
        }
    }

    /// A pattern without symmetries.
    fn pattern(x: u32, y: u32) -> f32 {
        ((x * 37 + y * 91 + x * y * 7) % 256) as f32
    }

    #[test]
    fn equal_pictures_are_exactly_1_alike() {
        for picture in [grey(32, pattern), grey(32, |_, _| 77.3), grey(32, |x, _| x as f32 * 7.9)] {
            let means = ssim(&picture, &picture).expect("one size").means(f64::NAN);
            assert_eq!((means.all, means.object), (1.0, 1.0));
        }
    }

    #[test]
    fn flat_greys_differ_by_the_luminance_term_alone() {
        let means = ssim(&grey(16, |_, _| 100.0), &grey(16, |_, _| 150.0)).expect("one size").means(f64::NAN);
        let expected = (2.0 * 100.0 * 150.0 + C1) / (100.0f64.powi(2) + 150.0f64.powi(2) + C1);
        assert!((means.all - expected).abs() < 1e-5, "{means:?}");
    }

    #[test]
    fn the_negative_of_a_pattern_is_less_than_0_alike() {
        let means = ssim(&grey(32, pattern), &grey(32, |x, y| 255.0 - pattern(x, y))).expect("one size").means(1.0);
        assert!(means.all < -0.9, "{means:?}");
    }

    #[test]
    fn the_order_of_the_pictures_does_not_matter() {
        let (a, b) = (grey(32, pattern), grey(32, |x, y| 0.8 * pattern(y, x) + 9.0));
        assert_eq!(ssim(&a, &b), ssim(&b, &a));
        assert!(ssim(&a, &b).expect("one size").means(1.0).all < 0.9);
    }

    #[test]
    fn a_change_off_the_object_leaves_the_objects_mean() {
        let (a, b) = (grey(48, pattern), grey(48, |x, y| if x < 30 { pattern(x, y) } else { 0.0 }));
        let means = ssim(&a, &b).expect("one size").means(1.0);
        assert_eq!(means.object, 1.0);
        assert!(means.all < 0.9);
    }

    /// The value that scikit-image 0.26 gives for these two pictures (Gaussian weights, sigma 1.5, population covariance, range 255).
    #[test]
    fn an_independent_implementation_gives_the_same_figure() {
        let (a, b) = (grey(64, pattern), grey(64, |x, y| 0.7 * pattern(x, y) + 0.3 * pattern(y, x + 5)));
        let means = ssim(&a, &b).expect("one size").means(1.0);
        assert!((means.all - SKIMAGE).abs() < 1e-5, "{}", means.all);
    }
    const SKIMAGE: f64 = 0.888_006_5;

    #[test]
    fn small_and_unequal_pictures_are_no_trouble() {
        let small = grey(10, pattern);
        assert_eq!(ssim(&small, &grey(10, |_, _| 0.0)).expect("one size").means(1.0).all, 1.0);
        assert!(matches!(ssim(&small, &grey(12, pattern)), Err(MeasureError::PictureSize { .. })));
    }
}
