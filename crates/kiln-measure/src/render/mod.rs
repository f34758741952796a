//! The software renderer: pictures of a scene for measuring and for looking at.
//!
//! Comes in: a [`Scene`], a [`Camera`], [`RenderOptions`]. Goes out: a [`Picture`], the same bits on any thread count.
//!
//! ```text
//! project every vertex in f64; drop faces that reach behind the eye or show their back (unless two-sided)
//! cut the picture into bands of rows; note for each band the faces that reach into it, ascending
//! for each band, in parallel:
//!     for each face: rasterise at `supersample` x `supersample` samples a pixel (kiln-geom, exact coverage)
//!         at each sample: depth from the barycentric coordinates; keep the nearer, at equal depth the lower face
//!         where the material masks: look up alpha first
//!     shade every sample that is covered; pixel = mean of its samples
//! ```
//!
//! **Spaces of colour.** All modes but [`Mode::Shaded`] compute on sRGB codes (0..255) as they lie in the files, factor and
//! light multiplied onto the code: the convention of the image metrics in the literature. [`Mode::Shaded`] decodes to linear
//! light first and encodes the mean. So does [`Mode::Material`], which draws all five maps of a metallic-roughness material by the
//! formulas that engines get as `shaders/apply_maps.wgsl`, under lights fixed to the object ([`apply_maps::Lights::OBJECT`]).
//!
//! **Limits.** Blended materials are drawn opaque. No shadows, no reflections; metallic surfaces keep their base colour as
//! diffuse, but for [`Mode::Material`]. Mip levels are chosen by face, without anisotropy. The eye must lie outside the model.

pub mod apply_maps;
mod shade;
#[cfg(test)]
mod tests;
mod visible;

use glam::{DVec3, Vec3};
use kiln_asset::Raster;
use rayon::prelude::*;

use crate::camera::{Camera, Projected};
use crate::scene::Scene;

/// Rows of pixels in one band: small enough for two threads to share a picture evenly.
const BAND: u32 = 16;

/// What a pixel's colour says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// Base colour alone.
    #[default]
    Flat,
    /// Base colour under a light at the camera: Lambert with 0.15 ambient. For measuring untextured models.
    Lit,
    /// A key light, a fill light, sky and highlights in linear light. For looking at.
    Shaded,
    /// All maps of the material under one light and a sky that are fixed to the object, in linear light; faces without a material
    /// are matt grey. What an engine shows, and for measuring it.
    Material,
    /// Normals in object space: `255 (n + 1) / 2`.
    Normals,
    /// White where anything is.
    Silhouette,
}

/// Which mip level textures are read from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mip {
    /// The level whose texels are as large as the samples, face by face, mixed between levels.
    PerFace,
    /// One level for everything, so that two models are filtered alike ([`Scene::mean_mip`]).
    Fixed(u32),
}

/// How to render.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderOptions {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Samples a pixel along each side, at least 1.
    pub supersample: u32,
    /// Colour behind the model, sRGB codes; [`Mode::Silhouette`] has black.
    pub background: [u8; 3],
    /// What the colours say.
    pub mode: Mode,
    /// Whether normal maps bend normals (modes `Lit`, `Shaded`, `Material`, `Normals`).
    pub normal_map: bool,
    /// Draw the back of single-sided materials too.
    pub two_sided: bool,
    /// Texture filtering.
    pub mip: Mip,
}

impl Default for RenderOptions {
    fn default() -> Self {
        RenderOptions {
            width: 512,
            height: 512,
            supersample: 2,
            background: [128; 3],
            mode: Mode::Flat,
            normal_map: false,
            two_sided: false,
            mip: Mip::PerFace,
        }
    }
}

/// A rendered picture, before rounding.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// `[height * width]`, sRGB codes 0..255, not rounded, top row first.
    pub codes: Vec<Vec3>,
    /// `[height * width]`, share of each pixel's samples that the model covers.
    pub coverage: Vec<f32>,
}

impl Picture {
    /// The picture in bytes, opaque.
    pub fn to_raster(&self) -> Raster {
        let byte = |code: f32| (code + 0.5) as u8;
        let texels = self.codes.iter().map(|c| [byte(c.x), byte(c.y), byte(c.z), 255]).collect();
        Raster { width: self.width, height: self.height, texels }
    }
}

/// Everything that the bands share.
pub(crate) struct Frame<'a> {
    scene: Scene<'a>,
    camera: &'a Camera,
    options: &'a RenderOptions,
    /// Samples across and down.
    size: [u32; 2],
    /// `[vertex_count]`; `None` behind the eye.
    projected: Vec<Option<Projected>>,
    surface: shade::Surface<'a>,
}

/// The scene as the camera sees it.
pub fn render(scene: &Scene<'_>, camera: &Camera, options: &RenderOptions) -> Picture {
    let options = RenderOptions { supersample: options.supersample.clamp(1, 16), ..*options };
    let size = [options.width * options.supersample, options.height * options.supersample];
    let mesh = scene.mesh;
    let projected =
        mesh.positions.par_iter().map(|p| camera.project(p.as_dvec3(), size[0] as f64, size[1] as f64)).collect();
    let surface = shade::Surface::new(scene, &options);
    let frame = Frame { scene: *scene, camera, options: &options, size, projected, surface };

    let bands: Vec<(Vec<Vec3>, Vec<f32>)> = frame
        .faces_by_band()
        .into_par_iter()
        .enumerate()
        .map(|(band, faces)| frame.band(band as u32 * BAND, &faces))
        .collect();
    let (codes, coverage): (Vec<Vec<Vec3>>, Vec<Vec<f32>>) = bands.into_iter().unzip();
    Picture { width: options.width, height: options.height, codes: codes.concat(), coverage: coverage.concat() }
}

impl Frame<'_> {
    /// For each band the faces that may reach into it, ascending; faces that cannot be seen are in none.
    fn faces_by_band(&self) -> Vec<Vec<u32>> {
        let mut bands = vec![Vec::new(); self.options.height.div_ceil(BAND) as usize];
        let band_samples = (BAND * self.options.supersample) as f64;
        for face in 0..self.scene.mesh.face_count() as u32 {
            let Some(corners) = self.corners(face) else { continue };
            if !self.options.two_sided && !self.surface.is_double_sided(face) && !is_front(&corners) {
                continue;
            }
            let [a, b, c] = corners.map(|p| p.y);
            // One sample more on each side: the rasteriser snaps.
            let first = ((a.min(b).min(c) - 1.0) / band_samples).max(0.0) as usize;
            let last = (a.max(b).max(c) + 1.0) / band_samples;
            if last >= 0.0 {
                let end = (last as usize + 1).min(bands.len());
                bands[first.min(end)..end].iter_mut().for_each(|faces| faces.push(face));
            }
        }
        bands
    }

    fn corners(&self, face: u32) -> Option<[Projected; 3]> {
        let [a, b, c] = self.scene.mesh.triangles[face as usize].map(|v| self.projected[v as usize]);
        Some([a?, b?, c?])
    }

    /// Colours and coverage of up to [`BAND`] rows of pixels from row `top` on.
    fn band(&self, top: u32, faces: &[u32]) -> (Vec<Vec3>, Vec<f32>) {
        let RenderOptions { width, height, supersample, .. } = *self.options;
        let bottom = (top + BAND).min(height);
        let samples = visible::Samples::resolve(self, faces, top * supersample, bottom * supersample);
        let background = self.surface.background();
        let (mut codes, mut coverage) = (Vec::new(), Vec::new());
        let share = 1.0 / (supersample * supersample) as f32;
        for y in top..bottom {
            for x in 0..width {
                let (mut sum, mut covered) = (Vec3::ZERO, 0);
                for dy in 0..supersample {
                    for dx in 0..supersample {
                        match samples.at(x * supersample + dx, y * supersample + dy) {
                            Some((face, bary)) => {
                                sum += self.surface.colour(self, face, bary);
                                covered += 1;
                            }
                            None => sum += background,
                        }
                    }
                }
                codes.push(self.surface.encode(sum * share));
                coverage.push(covered as f32 * share);
            }
        }
        (codes, coverage)
    }
}

/// Whether a face shows its front: counter-clockwise with y up.
fn is_front(corners: &[Projected; 3]) -> bool {
    let [a, b, c] = corners;
    (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x) < 0.0
}

/// Bytes as codes.
fn codes(texel: [u8; 3]) -> Vec3 {
    Vec3::from(texel.map(f32::from))
}

/// The barycentric mean of three places.
fn mix(bary: [f32; 3], [a, b, c]: [Vec3; 3]) -> DVec3 {
    bary[0] as f64 * a.as_dvec3() + bary[1] as f64 * b.as_dvec3() + bary[2] as f64 * c.as_dvec3()
}
