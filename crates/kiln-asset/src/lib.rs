//! The asset and its words: meshes with points, wedges and submeshes, materials, images, level sets; validation and import.
//!
//! Reading order: [`mesh`] (what a mesh promises), [`material`], [`level`] (what travels between stages), [`raster`],
//! [`import`] (the door for files), [`blob`] (how values lie in the private cache).

pub mod blob;
pub mod ids;
pub mod import;
pub mod level;
pub mod material;
pub mod mesh;
pub mod raster;

use std::sync::Arc;

pub use blob::BlobError;
pub use ids::{CornerId, FaceId, ImageId, MaterialId, PointId, SubmeshId, TextureId, WedgeId};
pub use level::{Level, LodSet, QuadricCoefficients, UvLayout};
pub use material::{
    AlphaMode, ExtraImage, ExtraMap, Filter, ImageFormat, ImageInfo, MapRole, Material, MaterialSet, Sampler, Texture,
    TextureRef, Wrap,
};
pub use mesh::{AttributeSet, Mesh, MeshDefect, MeshError, RawMesh, Submesh};
pub use raster::{DeepRaster, Precision, Raster};

/// A model as imported: one mesh in object space, its materials, its images' bytes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Asset {
    /// All submeshes in place.
    pub mesh: Mesh,
    /// What the submeshes refer to.
    pub materials: MaterialSet,
    /// `[materials.images.len()]`, encoded bytes.
    pub images: Vec<Arc<[u8]>>,
}
