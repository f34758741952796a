//! How far two assets are apart: renders, surface distance, contact sheets.
//!
//! Reading order: [`scene`] (what is drawn), [`camera`] (from where), [mod@render] (the software renderer over `kiln-geom`'s
//! rasteriser); pictures against pictures: [mod@image_error] (squares and silhouettes), [mod@ssim] (structure), [mod@flip] (what
//! an eye sees); surfaces against surfaces: [`distance`], [`border`]; [mod@compare] (all of it for two assets), [`heat`]
//! (differences as colours with their scale), [mod@sheet] (pictures beside pictures, with captions); [`flat`] (the flat pictures
//! alone, of many meshes against one reference). [`texture`] reads texels.
//!
//! No measure here is used by any metric that simplifies, so that figures judge and do not mirror. All results are the same
//! on any thread count.

pub mod border;
pub mod camera;
pub mod compare;
pub mod distance;
mod filter;
pub mod flat;
pub mod flip;
mod font;
pub mod heat;
pub mod image_error;
pub mod pool;
pub mod render;
pub mod scene;
pub mod sheet;
pub mod ssim;
pub mod texture;

pub use border::Border;
pub use camera::{Camera, Sphere, bounding_sphere};
pub use compare::{CompareOptions, Comparison, compare, contact_sheet};
pub use distance::{Distances, SurfaceReference, surface_distance};
pub use flat::FlatReference;
pub use flip::flip;
pub use image_error::{ImageError, image_error};
pub use pool::{PixelMeans, PixelSums};
pub use render::{Mip, Mode, Picture, RenderOptions, render};
pub use scene::Scene;
pub use sheet::{Tile, encode_png, sheet};
pub use ssim::ssim;

/// Why something cannot be measured.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum MeasureError {
    /// Two lists of pictures do not pair up.
    #[error("{reference} reference pictures against {other}: every view needs one of each")]
    ViewCount {
        /// Pictures of the reference.
        reference: usize,
        /// Pictures of the other.
        other: usize,
    },
    /// Two pictures of one view differ in size.
    #[error("view {view}: {reference_width}x{reference_height} against {width}x{height} pixels")]
    PictureSize {
        /// Which view.
        view: usize,
        /// Width of the reference, pixels.
        reference_width: u32,
        /// Height of the reference, pixels.
        reference_height: u32,
        /// Width of the other, pixels.
        width: u32,
        /// Height of the other, pixels.
        height: u32,
    },
    /// There is no surface to measure.
    #[error("the {0} has no triangle with an area: there is nothing to compare")]
    NoSurface(&'static str),
    /// A picture could not be encoded.
    #[error("cannot encode the picture: {0}")]
    Encode(String),
}
