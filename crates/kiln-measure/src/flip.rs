//! FLIP: how visible the difference of two pictures is to someone who flips between them.
//!
//! Comes in: two pictures of one size and how many pixels a degree of the viewer's field holds. Goes out: for each pixel an error
//! in `[0, 1]`, 0 for equal pictures.
//!
//! ```text
//! colour:   codes -> linear -> YCxCz; blur each channel by the eye's contrast sensitivity; clamp to displayable
//!           -> CIELAB, a and b scaled by 0.01 L (Hunt); distance = |dL| + |(da, db)|, to the power 0.7
//!           -> [0, 1]: linear to 0.95 at 0.4 of the greatest (green against blue), linear from there to 1
//! features: first and second derivatives of a Gaussian over the unblurred lightness = edges and points
//!           difference = the greater change of either's strength / sqrt 2, to the power 0.5
//! error = colour difference ^ (1 - feature difference)
//! ```
//! **Choices.** LDR-FLIP at [`PIXELS_PER_DEGREE`] = 67, as in the authors' code: a 0.7 m wide screen of 3840 pixels at 0.7 m. The
//! codes are not rounded. All filters are separable; the sum of two Gaussians for the yellow-blue channel is two passes.
//! Beyond the picture lies its edge.
//!
//! **Limits.** Single precision: the last digits differ from the authors' code, by less than 1e-4 of the mean.
//!
//! Source: P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström, M. D. Fairchild, FLIP: A Difference Evaluator for
//! Alternating Images, PACMCGIT 3(2), 2020, doi:10.1145/3406183; constants of the filters by the authors' code.

use std::f64::consts::PI;

use glam::{Vec2, Vec3};
use kiln_geom::colour::srgb_to_linear_f32;
use kiln_geom::math::{cbrt, pow};
use rayon::prelude::*;

use crate::MeasureError;
use crate::filter::{Plane, gaussian, scaled};
use crate::image_error::same_size;
use crate::pool::{PixelSums, on_object};
use crate::render::Picture;

/// The usual viewer's.
pub const PIXELS_PER_DEGREE: f64 = 67.0;

/// Least and greatest pixels a degree that are computed with: outside, the filters have no width, or the picture's.
const PIXELS_PER_DEGREE_RANGE: [f64; 2] = [4.0, 500.0];

/// A contrast sensitivity: the sum over `(a, b)` of `a sqrt(pi / b) exp(-pi^2 z / b)`, z in square degrees.
type Sensitivity = &'static [(f64, f64)];
const LIGHTNESS: Sensitivity = &[(1.0, 0.0047)];
const RED_GREEN: Sensitivity = &[(1.0, 0.0053)];
const YELLOW_BLUE: Sensitivity = &[(34.1, 0.04), (13.5, 0.025)];
/// The widest of them decides the size of all.
const WIDEST: f64 = 0.04;

/// Exponent of the colour distance.
const COLOUR_POWER: f32 = 0.7;
/// Up to this share of the greatest colour distance ...
const KNEE: f32 = 0.4;
/// ... the error grows linearly to this.
const KNEE_ERROR: f32 = 0.95;
/// Width of a feature, degrees.
const FEATURE_WIDTH: f64 = 0.082;

/// Errors of all pixels of two pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct FlipMap {
    /// `[height * width]`, in `[0, 1]`, top row first.
    pub errors: Vec<f32>,
    /// Their sums.
    pub sums: PixelSums,
}

/// The visible difference of two pictures, for a viewer with `pixels_per_degree`; symmetric.
///
/// # Errors
/// The pictures differ in size.
pub fn flip(reference: &Picture, other: &Picture, pixels_per_degree: f64) -> Result<FlipMap, MeasureError> {
    same_size(0, reference, other)?;
    let [least, greatest] = PIXELS_PER_DEGREE_RANGE;
    let filters = Filters::new(pixels_per_degree.clamp(least, greatest));
    let (seen, other_seen) = (filters.see(reference), filters.see(other));
    let greatest = pow(distance(hunt(Vec3::Y), hunt(Vec3::Z)), COLOUR_POWER);
    let errors: Vec<f32> = (0..reference.codes.len())
        .into_par_iter()
        .map(|k| {
            let colour = colour_error(seen.colours[k], other_seen.colours[k], greatest);
            let change = (seen.features[k] - other_seen.features[k]).abs().max_element();
            let feature = (change * std::f32::consts::FRAC_1_SQRT_2).clamp(0.0, 1.0).sqrt();
            // Most pixels: no power needed.
            if colour == 0.0 && feature < 1.0 { 0.0 } else { pow(colour, 1.0 - feature) }
        })
        .collect();
    let mut sums = PixelSums::default();
    for (k, error) in errors.iter().enumerate() {
        sums.add(*error as f64, on_object(reference, other, k));
    }
    Ok(FlipMap { errors, sums })
}

/// A picture as the eye sees it.
struct Seen {
    /// `[height * width]`, Hunt-adjusted CIELAB after the blur.
    colours: Vec<Vec3>,
    /// `[height * width]`, strengths of edge and point.
    features: Vec<Vec2>,
}

/// The kernels for one number of pixels a degree.
struct Filters {
    /// For each of Y, Cx, Cz its Gaussians; what each is along one axis, and along the other with its weight.
    blur: [Vec<(Vec<f32>, Vec<f32>)>; 3],
    /// The Gaussian of the features, sum 1, and its first and second derivative, the positive and the negative weights of each
    /// summing to 1 and -1.
    smooth: Vec<f32>,
    edge: Vec<f32>,
    point: Vec<f32>,
}

impl Filters {
    fn new(pixels_per_degree: f64) -> Filters {
        let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * pixels_per_degree).ceil() as usize;
        let blur = [LIGHTNESS, RED_GREEN, YELLOW_BLUE].map(|sensitivity| {
            let one = |&(a, b): &(f64, f64)| {
                let along = gaussian(radius, (b / (2.0 * PI * PI)).sqrt() * pixels_per_degree);
                let volume = a * (PI / b).sqrt() * along.iter().sum::<f64>().powi(2);
                (along, a * (PI / b).sqrt(), volume)
            };
            let parts: Vec<_> = sensitivity.iter().map(one).collect();
            let whole: f64 = parts.iter().map(|(.., volume)| volume).sum();
            parts.iter().map(|(along, a, _)| (scaled(along, 1.0), scaled(along, a / whole))).collect()
        });

        let sigma = 0.5 * FEATURE_WIDTH * pixels_per_degree;
        let radius = (3.0 * sigma).ceil() as usize;
        let weights = gaussian(radius, sigma);
        let at = |k: usize| k as f64 - radius as f64;
        let derived = |factor: &dyn Fn(f64) -> f64| {
            let weights: Vec<f64> = weights.iter().enumerate().map(|(k, w)| factor(at(k)) * w).collect();
            let sum = |keep: fn(&f64) -> bool| weights.iter().copied().filter(keep).sum::<f64>().abs();
            let (positive, negative) = (sum(|w| *w > 0.0), sum(|w| *w < 0.0));
            weights.iter().map(|w| (if *w < 0.0 { w / negative } else { w / positive }) as f32).collect::<Vec<f32>>()
        };
        Filters {
            blur,
            smooth: scaled(&weights, 1.0 / weights.iter().sum::<f64>()),
            edge: derived(&|x| -x),
            point: derived(&|x| x * x / (sigma * sigma) - 1.0),
        }
    }

    fn see(&self, picture: &Picture) -> Seen {
        let opponent = converted(&picture.codes, |code| {
            opponent_of_linear(Vec3::from((code / 255.0).to_array().map(srgb_to_linear_f32)))
        });
        let plane = |axis: usize| Plane::new(picture.width, opponent.iter().map(|c| c[axis]).collect());
        let [y, cx, cz] = [0, 1, 2].map(|axis| {
            let plane = plane(axis);
            let mut parts = self.blur[axis].iter().map(|(across, down)| plane.filtered(across, down));
            let first = parts.next().expect("invariant: every sensitivity has a Gaussian");
            parts.fold(first, |sum, part| sum.with(&part, |a, b| a + b)).values
        });
        let blurred: Vec<Vec3> = (0..y.len()).map(|k| Vec3::new(y[k], cx[k], cz[k])).collect();
        let colours = converted(&blurred, |c| hunt(linear_of_opponent(c).clamp(Vec3::ZERO, Vec3::ONE)));

        let lightness = plane(0).map(|y| (y + 16.0) / 116.0);
        let smooth = lightness.along_rows(&self.smooth);
        let strength = |derivative: &[f32]| {
            let across = lightness.along_rows(derivative).along_columns(&self.smooth);
            let down = smooth.along_columns(derivative);
            across.with(&down, |a, b| (a * a + b * b).sqrt()).values
        };
        let (edges, points) = (strength(&self.edge), strength(&self.point));
        Seen { colours, features: edges.into_iter().zip(points).map(|(e, p)| Vec2::new(e, p)).collect() }
    }
}

/// Every value converted; runs of equal ones, as a background has, once.
fn converted(values: &[Vec3], convert: impl Fn(Vec3) -> Vec3 + Sync) -> Vec<Vec3> {
    /// Values to a task, so that a run is not cut often.
    const CHUNK: usize = 4096;
    let mut out = vec![Vec3::ZERO; values.len()];
    out.par_chunks_mut(CHUNK).zip(values.par_chunks(CHUNK)).for_each(|(out, values)| {
        let mut last = (Vec3::NAN, Vec3::NAN);
        for (out, value) in out.iter_mut().zip(values) {
            if *value != last.0 {
                last = (*value, convert(*value));
            }
            *out = last.1;
        }
    });
    out
}

/// A colour distance in `[0, 1]`.
fn colour_error(a: Vec3, b: Vec3, greatest: f32) -> f32 {
    if a == b {
        return 0.0;
    }
    let (distance, knee) = (pow(distance(a, b), COLOUR_POWER), KNEE * greatest);
    let error = if distance < knee {
        distance * KNEE_ERROR / knee
    } else {
        KNEE_ERROR + (distance - knee) / (greatest - knee) * (1.0 - KNEE_ERROR)
    };
    error.clamp(0.0, 1.0)
}

/// HyAB: lightness apart from chroma.
fn distance(a: Vec3, b: Vec3) -> f32 {
    let d = a - b;
    d.x.abs() + (d.y * d.y + d.z * d.z).sqrt()
}

/// Rows of the matrix from linear sRGB to XYZ, as the authors have them.
const XYZ: [Vec3; 3] = [
    Vec3::new(10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0),
    Vec3::new(2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0),
    Vec3::new(1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0),
];

/// Rows of its inverse.
const LINEAR: [Vec3; 3] = [
    Vec3::new(3.241_003_3, -1.537_399, -0.498_615_9),
    Vec3::new(-0.969_224_3, 1.875_93, 0.041_554_226),
    Vec3::new(0.055_639_42, -0.204_011_2, 1.057_149),
];

/// XYZ over the white's.
fn relative_xyz(linear: Vec3) -> Vec3 {
    let white = Vec3::from(XYZ.map(|row| row.element_sum()));
    Vec3::from(XYZ.map(|row| row.dot(linear))) / white
}

/// YCxCz of linear light.
fn opponent_of_linear(linear: Vec3) -> Vec3 {
    let p = relative_xyz(linear);
    Vec3::new(116.0 * p.y - 16.0, 500.0 * (p.x - p.y), 200.0 * (p.y - p.z))
}

fn linear_of_opponent(c: Vec3) -> Vec3 {
    let y = (c.x + 16.0) / 116.0;
    let white = Vec3::from(XYZ.map(|row| row.element_sum()));
    let xyz = Vec3::new(y + c.y / 500.0, y, y - c.z / 200.0) * white;
    Vec3::from(LINEAR.map(|row| row.dot(xyz)))
}

/// CIELAB of linear light, with a and b scaled by lightness.
fn hunt(linear: Vec3) -> Vec3 {
    const DELTA: f32 = 6.0 / 29.0;
    let root = |t: f32| if t > DELTA * DELTA * DELTA { cbrt(t) } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 };
    let f = Vec3::from(relative_xyz(linear).to_array().map(root));
    let l = 116.0 * f.y - 16.0;
    Vec3::new(l, 0.01 * l * 500.0 * (f.x - f.y), 0.01 * l * 200.0 * (f.y - f.z))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: u32 = 48;

    /// Colours 0..1 of [`SIZE`] by [`SIZE`] pixels, the left half on the object.
    fn picture(colour: impl Fn(u32, u32) -> [f32; 3]) -> Picture {
        let places = (0..SIZE * SIZE).map(|k| (k % SIZE, k / SIZE));
        Picture {
            width: SIZE,
            height: SIZE,
            codes: places.clone().map(|(x, y)| 255.0 * Vec3::from(colour(x, y))).collect(),
            coverage: places.map(|(x, _)| if x < SIZE / 2 { 1.0 } else { 0.0 }).collect(),
        }
    }

    fn plain(colour: [f32; 3]) -> Picture {
        picture(|_, _| colour)
    }

    fn mean(a: &Picture, b: &Picture) -> f64 {
        flip(a, b, PIXELS_PER_DEGREE).expect("one size").sums.means(f64::NAN).all
    }

    fn pattern(x: u32, y: u32) -> f32 {
        ((x * 37 + y * 91 + x * y * 7) % 256) as f32
    }

    fn ramp(x: u32, y: u32) -> [f32; 3] {
        [x as f32 * 5.0 / 255.0, y as f32 * 5.0 / 255.0, 128.0 / 255.0]
    }

    fn ramp_with_square(x: u32, y: u32) -> [f32; 3] {
        if (12..40).contains(&x) && (10..30).contains(&y) { [0.9, 0.2, 0.1] } else { ramp(x, y) }
    }

    #[test]
    fn the_matrices_are_each_others_inverse() {
        for axis in [Vec3::X, Vec3::Y, Vec3::Z, Vec3::new(0.2, 0.5, 0.3)] {
            assert!((linear_of_opponent(opponent_of_linear(axis)) - axis).length() < 2e-6);
        }
    }

    #[test]
    fn equal_pictures_have_no_error() {
        let map = flip(&picture(ramp), &picture(ramp), PIXELS_PER_DEGREE).expect("one size");
        assert!(map.errors.iter().all(|e| *e == 0.0));
        assert_eq!(map.sums.means(f64::NAN).object, 0.0);
    }

    /// Means by the authors' own program (flip-evaluator 1.7, LDR, 67 pixels a degree).
    #[test]
    fn the_means_are_those_of_the_authors_program() {
        let noise = picture(|x, y| [pattern(x, y), pattern(y, x), pattern(x + 3, y)].map(|c| c / 255.0));
        let changed =
            picture(|x, y| [0.8 * pattern(x, y), 0.5 * pattern(y, x) + 40.0, pattern(x + 3, y)].map(|c| c / 255.0));
        for (what, a, b, expected) in [
            ("black against white", plain([0.0; 3]), plain([1.0; 3]), BLACK_WHITE),
            ("green against blue", plain([0.0, 1.0, 0.0]), plain([0.0, 0.0, 1.0]), 1.0),
            ("red against green", plain([1.0, 0.0, 0.0]), plain([0.0, 1.0, 0.0]), RED_GREEN_MEAN),
            ("near greys", plain([0.5; 3]), plain([0.55; 3]), GREYS),
            ("noise", noise, changed, NOISE),
            ("a square on a ramp", picture(ramp), picture(ramp_with_square), SQUARE),
        ] {
            let mean = mean(&a, &b);
            assert!((mean - expected).abs() < 1e-4 * expected, "{what}: {mean}, expected {expected}");
        }
    }
    const BLACK_WHITE: f64 = 0.967_392;
    const RED_GREEN_MEAN: f64 = 0.986_676;
    const GREYS: f64 = 0.176_490;
    const NOISE: f64 = 0.605_530;
    const SQUARE: f64 = 0.250_404;

    #[test]
    fn the_order_of_the_pictures_does_not_matter() {
        let (a, b) = (picture(ramp), picture(ramp_with_square));
        assert_eq!(flip(&a, &b, 67.0), flip(&b, &a, 67.0));
    }

    #[test]
    fn fine_noise_is_less_visible_from_afar() {
        let noise = picture(|x, y| [0.4 + 0.2 * pattern(x, y) / 255.0; 3]);
        let errors = [15.0, 67.0, 300.0]
            .map(|ppd| flip(&plain([0.5; 3]), &noise, ppd).expect("one size").sums.means(f64::NAN).all);
        assert!(errors[0] > errors[1] && errors[1] > errors[2] && errors[2] > 0.0, "{errors:?}");
    }

    #[test]
    fn unequal_sizes_are_refused() {
        let small = Picture { width: 1, height: 1, codes: vec![Vec3::ONE], coverage: vec![1.0] };
        assert!(matches!(flip(&plain([0.0; 3]), &small, 67.0), Err(MeasureError::PictureSize { .. })));
        assert!(flip(&small, &small, 67.0).expect("one size").errors == [0.0]);
    }
}
