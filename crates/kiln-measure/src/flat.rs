//! The flat pictures of one reference against those of many meshes: what a benchmark needs of [`crate::compare()`], and no more.
//!
//! The reference is drawn once and its pictures are filtered once, so that a mesh costs its own views alone. The meshes share
//! the reference's materials and are read from the same mip level; the figures are those of [`crate::compare()`] in mode `flat`
//! wherever that picks the same level for both.

use kiln_asset::{MapRole, MaterialSet, Mesh, Raster};

use crate::MeasureError;
use crate::camera::{Camera, bounding_sphere};
use crate::compare::CompareOptions;
use crate::image_error::{ImageError, ImageErrorSums};
use crate::render::{Mip, Picture, RenderOptions, render};
use crate::scene::Scene;
use crate::texture;

/// A model to compare others with by their base colour.
pub struct FlatReference<'a> {
    materials: &'a MaterialSet,
    /// Base colours at the reference's mip level; the others empty.
    images: Vec<Raster>,
    cameras: Vec<Camera>,
    options: RenderOptions,
    /// `[view_count]`
    pictures: Vec<Picture>,
}

impl<'a> FlatReference<'a> {
    /// The reference drawn from the views of `options`.
    pub fn new(reference: &Scene<'a>, options: &CompareOptions) -> FlatReference<'a> {
        let sphere = bounding_sphere(&reference.mesh.positions);
        let level = reference.mean_mip(sphere, options.size * options.supersample);
        let mut images = vec![Raster::default(); reference.images.len()];
        for material in &reference.materials.materials {
            let Some(texture) = material.map(MapRole::BaseColor).map(|map| map.texture.index()) else { continue };
            let Some(image) = reference.materials.textures.get(texture).map(|texture| texture.image.index()) else {
                continue;
            };
            if let Some(picture) = reference.images.get(image) {
                images[image] = texture::mip(picture, level).into_owned();
            }
        }
        let draw = RenderOptions {
            width: options.size,
            height: options.size,
            supersample: options.supersample,
            two_sided: true,
            mip: Mip::Fixed(0),
            ..RenderOptions::default()
        };
        let cameras = Camera::views(options.views, sphere);
        let mut own =
            FlatReference { materials: reference.materials, images, cameras, options: draw, pictures: Vec::new() };
        own.pictures = (0..own.cameras.len()).map(|view| own.draw(reference.mesh, view)).collect();
        own
    }

    fn draw(&self, mesh: &Mesh, view: usize) -> Picture {
        let scene = Scene { mesh, materials: self.materials, images: &self.images };
        render(&scene, &self.cameras[view], &self.options)
    }

    /// How far the pictures of `mesh`, whose submeshes refer to the reference's materials, are from the reference's.
    ///
    /// # Errors
    /// None in practice: all pictures have one size.
    pub fn compare(&self, mesh: &Mesh) -> Result<ImageError, MeasureError> {
        let mut sums = ImageErrorSums::default();
        for (view, reference) in self.pictures.iter().enumerate() {
            sums.add(reference, &self.draw(mesh, view))?;
        }
        Ok(sums.finish())
    }
}
