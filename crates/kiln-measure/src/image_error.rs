//! Pictures against pictures.
//!
//! Source: P. Lindstrom, G. Turk, Image-driven simplification, ACM TOG 19(3), 2000, doi:10.1145/353981.353995 (the RMS over
//! all pixels of all views), here over RGB on the 0..255 scale.

use serde::Serialize;

use crate::MeasureError;
use crate::pool::on_object;
use crate::render::Picture;

/// How far pictures of two models, view by view, are apart.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ImageError {
    /// Root of the mean square over all pixels and channels of all views, codes 0..255.
    pub rmse: f64,
    /// Mean over the views of each view's RMSE.
    pub rmse_mean: f64,
    /// RMSE of the worst view.
    pub rmse_worst: f64,
    /// RMSE over the pixels that either model covers: the figure to compare between models.
    pub rmse_object: f64,
    /// RMSE over the pixels that both models cover wholly: what differs on the surface, whatever the outlines do; 0 where there
    /// is no such pixel.
    pub rmse_both: f64,
    /// Peak signal-to-noise ratio of `rmse`, dB; infinite for equal pictures (null in JSON).
    pub psnr: f64,
    /// Coverage that differs, as a share of the reference's coverage.
    pub silhouette_xor: f64,
    /// Coverage in common over coverage of either; 1 where neither covers anything.
    pub silhouette_iou: f64,
    /// RMSE of each view.
    pub per_view: Vec<f64>,
    /// RMSE of each view over the pixels that both models cover wholly.
    pub per_view_both: Vec<f64>,
    /// Coverage that differs in each view, as a share of the reference's coverage there.
    pub per_view_xor: Vec<f64>,
}

/// Compares the pictures of `other` with those of `reference`, pair by pair.
///
/// # Errors
/// The lists differ in length or a pair in size.
pub fn image_error(reference: &[Picture], other: &[Picture]) -> Result<ImageError, MeasureError> {
    if reference.len() != other.len() {
        return Err(MeasureError::ViewCount { reference: reference.len(), other: other.len() });
    }
    let mut sums = ImageErrorSums::default();
    for (r, o) in reference.iter().zip(other) {
        sums.add(r, o)?;
    }
    Ok(sums.finish())
}

/// Share of a pixel's samples above which it counts as covered wholly: all, but for rounding.
const WHOLE: f64 = 0.999;

/// [`image_error`] of pictures that come one pair at a time.
#[derive(Clone, Debug, Default)]
pub struct ImageErrorSums {
    per_view: Vec<f64>,
    per_view_both: Vec<f64>,
    per_view_xor: Vec<f64>,
    /// Squares and channels.
    all: (f64, u64),
    object: (f64, u64),
    both: (f64, u64),
    /// Coverage, in pixels.
    differing: f64,
    of_reference: f64,
    common: f64,
    either: f64,
}

impl ImageErrorSums {
    /// Adds the next view.
    ///
    /// # Errors
    /// The pair differs in size.
    pub fn add(&mut self, reference: &Picture, other: &Picture) -> Result<(), MeasureError> {
        same_size(self.per_view.len(), reference, other)?;
        let (mut sum, mut both) = (0.0, (0.0, 0));
        let (mut differing, mut of_reference) = (0.0, 0.0);
        for (k, (a, b)) in reference.codes.iter().zip(&other.codes).enumerate() {
            let square = (*a - *b).as_dvec3().length_squared();
            sum += square;
            let (ca, cb) = (reference.coverage[k] as f64, other.coverage[k] as f64);
            if on_object(reference, other, k) {
                self.object = (self.object.0 + square, self.object.1 + 3);
            }
            // Coverage is a sum of equal shares.
            if ca.min(cb) > WHOLE {
                both = (both.0 + square, both.1 + 3);
            }
            differing += (ca - cb).abs();
            of_reference += ca;
            self.common += ca.min(cb);
            self.either += ca.max(cb);
        }
        let count = 3 * reference.codes.len() as u64;
        self.per_view.push((sum / count.max(1) as f64).sqrt());
        self.all = (self.all.0 + sum, self.all.1 + count);
        self.per_view_both.push(root_mean(both));
        self.both = (self.both.0 + both.0, self.both.1 + both.1);
        self.per_view_xor.push(differing / of_reference.max(1e-9));
        self.differing += differing;
        self.of_reference += of_reference;
        Ok(())
    }

    /// The figures over all views so far.
    pub fn finish(self) -> ImageError {
        let rmse = root_mean(self.all);
        ImageError {
            rmse,
            rmse_mean: self.per_view.iter().sum::<f64>() / self.per_view.len().max(1) as f64,
            rmse_worst: self.per_view.iter().fold(0.0, |worst: f64, e| worst.max(*e)),
            rmse_object: root_mean(self.object),
            rmse_both: root_mean(self.both),
            psnr: 20.0 * kiln_geom::math::ln64(255.0 / rmse) / std::f64::consts::LN_10,
            silhouette_xor: self.differing / self.of_reference.max(1e-9),
            silhouette_iou: if self.either > 0.0 { self.common / self.either } else { 1.0 },
            per_view: self.per_view,
            per_view_both: self.per_view_both,
            per_view_xor: self.per_view_xor,
        }
    }
}

/// The root of a sum over a count.
fn root_mean((sum, count): (f64, u64)) -> f64 {
    (sum / count.max(1) as f64).sqrt()
}

/// # Errors
/// The pictures differ in size; `view` is for the message.
pub(crate) fn same_size(view: usize, reference: &Picture, other: &Picture) -> Result<(), MeasureError> {
    if (reference.width, reference.height) == (other.width, other.height) {
        return Ok(());
    }
    Err(MeasureError::PictureSize {
        view,
        reference_width: reference.width,
        reference_height: reference.height,
        width: other.width,
        height: other.height,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn picture(codes: [f32; 4], coverage: [f32; 4]) -> Picture {
        Picture { width: 2, height: 2, codes: codes.map(Vec3::splat).to_vec(), coverage: coverage.to_vec() }
    }

    #[test]
    fn known_differences_give_known_errors() {
        let a = picture([10.0, 20.0, 30.0, 40.0], [1.0, 1.0, 0.0, 0.0]);
        let b = picture([10.0, 24.0, 30.0, 40.0], [1.0, 0.5, 0.0, 0.25]);
        let error = image_error(&[a.clone(), a.clone()], &[b, a]).expect("pairs");
        assert_eq!(error.per_view, [2.0, 0.0]);
        assert_eq!(error.rmse, 2f64.sqrt());
        assert_eq!((error.rmse_mean, error.rmse_worst), (1.0, 2.0));
        // 16 x 3 over (3 + 2) pixels x 3 channels.
        assert_eq!(error.rmse_object, 3.2f64.sqrt());
        // One pixel in the first pair, two in the second, all equal.
        assert_eq!((error.rmse_both, &error.per_view_both[..]), (0.0, &[0.0; 2][..]));
        assert_eq!(error.per_view_xor, [0.75 / 2.0, 0.0]);
        assert_eq!(error.silhouette_xor, 0.75 / 4.0);
        assert_eq!(error.silhouette_iou, 3.5 / 4.25);
        assert!((error.psnr - 20.0 * (255.0 / 2f64.sqrt()).log10()).abs() < 1e-9);
    }

    #[test]
    fn only_pixels_that_both_cover_wholly_are_shared() {
        let a = picture([10.0, 20.0, 30.0, 40.0], [1.0, 1.0, 0.5, 0.0]);
        let b = picture([16.0, 99.0, 99.0, 40.0], [1.0, 0.75, 1.0, 0.0]);
        let error = image_error(&[a.clone(), a.clone()], &[b, a]).expect("pairs");
        // 36 x 3 in the first view's one pixel; the second view has two without a difference.
        assert_eq!(error.per_view_both, [6.0, 0.0]);
        assert_eq!(error.rmse_both, 12f64.sqrt());
    }

    #[test]
    fn equal_pictures_are_infinitely_good() {
        let a = picture([1.0, 2.0, 3.0, 4.0], [1.0; 4]);
        let error = image_error(std::slice::from_ref(&a), std::slice::from_ref(&a)).expect("pairs");
        assert_eq!((error.rmse, error.rmse_object, error.silhouette_xor, error.silhouette_iou), (0.0, 0.0, 0.0, 1.0));
        assert_eq!(error.psnr, f64::INFINITY);
    }

    #[test]
    fn pictures_that_do_not_pair_are_refused() {
        let a = picture([0.0; 4], [0.0; 4]);
        let wide = Picture { width: 4, height: 1, ..a.clone() };
        assert_eq!(image_error(std::slice::from_ref(&a), &[]), Err(MeasureError::ViewCount { reference: 1, other: 0 }));
        let error = image_error(&[a], &[wide]).expect_err("sizes differ");
        assert_eq!(error.to_string(), "view 0: 2x2 against 4x1 pixels");
    }
}
