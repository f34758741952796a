//! Two assets against each other: every measure of this crate in one report.
//!
//! Comes in: a reference and another scene. Goes out: a [`Comparison`], the same bits on any thread count; on request a contact
//! sheet of the views where they differ most, middlingly and least.
//!
//! ```text
//! points over both surfaces, distances both ways; border lengths
//! frame the reference's bounding sphere; `views` parallel views on a Fibonacci lattice
//! for each view, for each of base colour, lit, normals, material:
//!     draw both, two-sided, at `supersample` x `supersample` samples a pixel
//!     add squares, structural similarity and FLIP; from the first also the coverage, which is the silhouette
//! ```
//! **Fair filtering.** Textures are read from one mip level for the whole run, by the reference's mean texel density. Another
//! atlas than the reference's has its texels at another density: its level is shifted by the two densities' ratio, rounded to
//! whole levels, so that both are read at the same fineness, and a simplified mesh with the reference's own textures at the same level.
//!
//! **On the surface.** An outline that moves by half a pixel exchanges model and background, which outweighs what changed on the model.
//! `rmse_both` is over the pixels that both cover wholly, and the outlines' difference stands beside it. `material` draws what a
//! player would see: all maps under lights that stand still beside the object while the views go around it.
//!
//! **Limits.** The views see no inside. Distances are sampled: the greatest is a lower bound. One view is in memory at a time.
//!
//! Source: P. Lindstrom, G. Turk, Image-driven simplification, ACM TOG 19(3), 2000, doi:10.1145/353981.353995, for judging by
//! pictures from many sides; the rest stands with each measure.

mod pictures;
#[cfg(test)]
mod tests;

use serde::Serialize;

use crate::MeasureError;
use crate::border::Border;
use crate::camera::{Camera, bounding_sphere};
use crate::distance::{Distances, SurfaceReference};
use crate::flip::{PIXELS_PER_DEGREE, flip};
use crate::image_error::{ImageError, ImageErrorSums};
use crate::pool::{PixelMeans, PixelSums};
use crate::render::{Mode, Picture};
use crate::scene::Scene;
use crate::ssim::ssim;
use pictures::Pair;
pub use pictures::contact_sheet;

/// How to compare.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CompareOptions {
    /// Views around the reference.
    pub views: usize,
    /// Width and height of each picture, pixels.
    pub size: u32,
    /// Samples a pixel along each side.
    pub supersample: u32,
    /// Points spread over each surface.
    pub samples: usize,
    /// Whether normal maps bend the normals of lit pictures and pictures of normals.
    pub normal_maps: bool,
    /// Pixels in a degree of the viewer's field, for FLIP.
    pub pixels_per_degree: f64,
}

impl Default for CompareOptions {
    fn default() -> Self {
        CompareOptions {
            views: 24,
            size: 512,
            supersample: 2,
            samples: 500_000,
            normal_maps: true,
            pixels_per_degree: PIXELS_PER_DEGREE,
        }
    }
}

/// How far two assets are apart.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// With what it was measured.
    pub options: CompareOptions,
    /// What the reference is made of.
    pub reference: Size,
    /// What the other is made of.
    pub other: Size,
    /// Base colour alone.
    pub flat: ModeError,
    /// Under a light at the camera.
    pub lit: ModeError,
    /// Normals as colours.
    pub normals: ModeError,
    /// All maps under lights fixed to the object.
    pub material: ModeError,
    /// Outlines.
    pub silhouette: SilhouetteError,
    /// Between the surfaces, object units.
    pub distance: Distances,
    /// The same in diagonals of the reference's bounding box.
    pub relative_distance: Distances,
    /// Mean distance between neighbouring points on the reference, diagonals: the root of its area over their number.
    pub relative_spacing: f64,
    /// Share of the reference's border length that the other has; `None` (null) for a closed reference.
    pub border_kept: Option<f64>,
}

/// What a mesh is made of.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Size {
    /// Its triangles.
    pub triangles: usize,
    /// Its vertices.
    pub vertices: usize,
    /// Its submeshes.
    pub submeshes: usize,
    /// Its edges without two faces.
    pub border: Border,
}

/// How far pictures in one mode are apart, over all views.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModeError {
    /// Root of the mean square over all pixels and channels, codes 0..255.
    pub rmse: f64,
    /// The same over the pixels that either model covers.
    pub rmse_object: f64,
    /// The same over the pixels that both models cover wholly.
    pub rmse_both: f64,
    /// RMSE of the worst view.
    pub rmse_worst: f64,
    /// Mean of the views' RMSE.
    pub rmse_mean: f64,
    /// Peak signal-to-noise ratio of `rmse`, dB; infinite for equal pictures (null in JSON).
    pub psnr: f64,
    /// Structural similarity, at most 1.
    pub ssim: PixelMeans,
    /// Visible difference, 0 to 1.
    pub flip: PixelMeans,
    /// RMSE of each view.
    pub per_view: Vec<f64>,
    /// RMSE of each view over the pixels that both models cover wholly.
    pub per_view_both: Vec<f64>,
}

/// How far outlines are apart, over all views.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SilhouetteError {
    /// RMSE over all pixels, white on black, codes 0..255.
    pub rmse: f64,
    /// Coverage that differs, as a share of the reference's.
    pub xor: f64,
    /// Coverage in common over coverage of either.
    pub iou: f64,
    /// `xor` of each view.
    pub per_view_xor: Vec<f64>,
}

/// The modes whose pictures are compared.
const MODES: [Mode; 4] = [Mode::Flat, Mode::Lit, Mode::Normals, Mode::Material];

/// How far `other` is from `reference`. `progress` hears the share that is done, in `[0, 1]`, and what is being done.
///
/// # Errors
/// One of them has no surface.
pub fn compare(
    reference: &Scene<'_>,
    other: &Scene<'_>,
    options: &CompareOptions,
    progress: &dyn Fn(f64, &str),
) -> Result<Comparison, MeasureError> {
    progress(0.0, "distances");
    let (distance, area) = distances(reference, other, options.samples)?;
    let (size, other_size) = (Size::of(reference), Size::of(other));

    let sphere = bounding_sphere(&reference.mesh.positions);
    let pair = Pair::new(reference, other, sphere, options);
    let mut sums: [ModeSums; 4] = Default::default();
    let mut outlines = ImageErrorSums::default();
    for (view, camera) in Camera::views(options.views, sphere).iter().enumerate() {
        progress(0.1 + 0.9 * view as f64 / options.views as f64, "views");
        for (mode, sums) in MODES.into_iter().zip(&mut sums) {
            let (seen, other_seen) = pair.draw(camera, mode);
            sums.add(&seen, &other_seen, options)?;
            if mode == MODES[0] {
                outlines.add(&outline(&seen), &outline(&other_seen))?;
            }
        }
    }
    progress(1.0, "views");
    let [flat, lit, normals, material] = sums.map(ModeSums::finish);
    let outlines = outlines.finish();
    let diagonal = distance.diagonal.max(f64::MIN_POSITIVE);
    Ok(Comparison {
        options: *options,
        reference: size,
        other: other_size,
        flat,
        lit,
        normals,
        material,
        silhouette: SilhouetteError {
            rmse: outlines.rmse,
            xor: outlines.silhouette_xor,
            iou: outlines.silhouette_iou,
            per_view_xor: outlines.per_view_xor,
        },
        distance,
        relative_distance: distance.in_diagonals(),
        relative_spacing: (area / options.samples.max(1) as f64).sqrt() / diagonal,
        border_kept: size.border.kept(&other_size.border),
    })
}

/// The distances, and the reference's area, square object units.
fn distances(reference: &Scene<'_>, other: &Scene<'_>, samples: usize) -> Result<(Distances, f64), MeasureError> {
    let surface = SurfaceReference::new(reference.mesh, samples).ok_or(MeasureError::NoSurface("reference"))?;
    let distance = surface.compare(other.mesh).ok_or(MeasureError::NoSurface("other"))?;
    let mesh = reference.mesh;
    let area = mesh.triangles.iter().map(|t| kiln_geom::triangle::area(t.map(|v| mesh.positions[v as usize]))).sum();
    Ok((distance, area))
}

/// White where the picture shows its model: what [`Mode::Silhouette`] would draw.
fn outline(picture: &Picture) -> Picture {
    let codes = picture.coverage.iter().map(|share| glam::Vec3::splat(255.0 * share)).collect();
    Picture { codes, ..picture.clone() }
}

#[derive(Default)]
struct ModeSums {
    squares: ImageErrorSums,
    ssim: PixelSums,
    flip: PixelSums,
}

impl ModeSums {
    fn add(&mut self, reference: &Picture, other: &Picture, options: &CompareOptions) -> Result<(), MeasureError> {
        self.squares.add(reference, other)?;
        self.ssim.merge(ssim(reference, other)?);
        self.flip.merge(flip(reference, other, options.pixels_per_degree)?.sums);
        Ok(())
    }

    fn finish(self) -> ModeError {
        let squares = self.squares.finish();
        let ImageError { rmse, rmse_mean, rmse_worst, rmse_object, rmse_both, psnr, .. } = squares;
        let (ssim, flip) = (self.ssim.means(1.0), self.flip.means(0.0));
        let (per_view, per_view_both) = (squares.per_view, squares.per_view_both);
        ModeError { rmse, rmse_object, rmse_both, rmse_worst, rmse_mean, psnr, ssim, flip, per_view, per_view_both }
    }
}

impl Size {
    fn of(scene: &Scene<'_>) -> Size {
        let mesh = scene.mesh;
        Size {
            triangles: mesh.face_count(),
            vertices: mesh.vertex_count(),
            submeshes: mesh.submeshes.len(),
            border: Border::of(mesh),
        }
    }
}
