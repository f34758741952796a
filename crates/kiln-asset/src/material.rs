//! Materials as glTF's metallic-roughness core has them, textures, samplers, and images as bytes.

use serde::{Deserialize, Serialize};

use crate::ids::{ImageId, TextureId};

/// How coverage is taken from base colour's alpha.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// Below the cutoff: hole; else opaque.
    Mask,
    /// Alpha blends.
    Blend,
}

/// What happens outside `[0, 1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Wrap {
    /// The picture repeats.
    #[default]
    Repeat,
    /// Every other repetition is mirrored.
    MirroredRepeat,
    /// The edge texel goes on.
    ClampToEdge,
}

impl Wrap {
    /// The texel in `[0, size)` that a texel index anywhere means, on an axis of `size` texels (at least 1).
    #[inline]
    pub fn texel(self, index: i64, size: usize) -> usize {
        let size = size.max(1) as i64;
        // Nearly all, and the divisions below are slow.
        if (0..size).contains(&index) {
            return index as usize;
        }
        let inside = match self {
            Wrap::Repeat => index.rem_euclid(size),
            Wrap::ClampToEdge => index.clamp(0, size - 1),
            Wrap::MirroredRepeat => {
                let twice = index.rem_euclid(2 * size);
                twice.min(2 * size - 1 - twice)
            }
        };
        inside as usize
    }
}

/// Texel filter of a sampler.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Filter {
    /// Linear between texels.
    #[default]
    Linear,
    /// Nearest texel.
    Nearest,
}

/// How a texture is read. Minification adds mip levels unless `mip` is `None`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sampler {
    /// Wrap in u.
    pub wrap_u: Wrap,
    /// Wrap in v.
    pub wrap_v: Wrap,
    /// Magnification filter.
    pub mag: Filter,
    /// Minification filter inside one mip level.
    pub min: Filter,
    /// Filter between mip levels, `None`: level 0 only.
    pub mip: Option<Filter>,
}

impl Default for Sampler {
    fn default() -> Self {
        Sampler {
            wrap_u: Wrap::Repeat,
            wrap_v: Wrap::Repeat,
            mag: Filter::Linear,
            min: Filter::Linear,
            mip: Some(Filter::Linear),
        }
    }
}

/// An image with a sampler.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Texture {
    /// Its picture.
    pub image: ImageId,
    /// How it is read.
    pub sampler: Sampler,
}

/// A texture in use by a material.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TextureRef {
    /// The texture.
    pub texture: TextureId,
    /// Which UV set of the mesh it reads: 0 or 1.
    pub uv_set: u32,
}

/// glTF 2.0's metallic-roughness core.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// Name, may be empty or repeated.
    pub name: String,
    /// Linear RGBA factor.
    pub base_color_factor: [f32; 4],
    /// sRGB colour with linear alpha.
    pub base_color: Option<TextureRef>,
    /// Factor on the blue channel.
    pub metallic_factor: f32,
    /// Factor on the green channel.
    pub roughness_factor: f32,
    /// Green roughness, blue metallic, linear.
    pub metallic_roughness: Option<TextureRef>,
    /// Tangent-space normals, +Y up.
    pub normal: Option<TextureRef>,
    /// Scale of the normal map's x and y.
    pub normal_scale: f32,
    /// Red channel, linear.
    pub occlusion: Option<TextureRef>,
    /// Strength of the occlusion, `[0, 1]`.
    pub occlusion_strength: f32,
    /// Linear RGB factor.
    pub emissive_factor: [f32; 3],
    /// sRGB emission.
    pub emissive: Option<TextureRef>,
    /// Alpha mode.
    pub alpha_mode: AlphaMode,
    /// Cutoff of [`AlphaMode::Mask`].
    pub alpha_cutoff: f32,
    /// Back faces are drawn too.
    pub double_sided: bool,
}

impl Default for Material {
    fn default() -> Self {
        Material {
            name: String::new(),
            base_color_factor: [1.0; 4],
            base_color: None,
            metallic_factor: 1.0,
            roughness_factor: 1.0,
            metallic_roughness: None,
            normal: None,
            normal_scale: 1.0,
            occlusion: None,
            occlusion_strength: 1.0,
            emissive_factor: [0.0; 3],
            emissive: None,
            alpha_mode: AlphaMode::Opaque,
            alpha_cutoff: 0.5,
            double_sided: false,
        }
    }
}

/// The five maps of a metallic-roughness material.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MapRole {
    /// Base colour (sRGB) and alpha.
    BaseColor,
    /// Roughness in green, metallic in blue.
    MetallicRoughness,
    /// Tangent-space normals, +Y up.
    Normal,
    /// Occlusion in red.
    Occlusion,
    /// Emission (sRGB).
    Emissive,
}

impl MapRole {
    /// Every role, in the order in which maps are written.
    pub const ALL: [MapRole; 5] =
        [MapRole::BaseColor, MapRole::MetallicRoughness, MapRole::Normal, MapRole::Occlusion, MapRole::Emissive];

    /// The name in pipelines and files: `base-color`.
    pub fn name(self) -> &'static str {
        match self {
            MapRole::BaseColor => "base-color",
            MapRole::MetallicRoughness => "metallic-roughness",
            MapRole::Normal => "normal",
            MapRole::Occlusion => "occlusion",
            MapRole::Emissive => "emissive",
        }
    }

    /// Whether RGB is sRGB-encoded (alpha never is).
    pub fn is_srgb(self) -> bool {
        matches!(self, MapRole::BaseColor | MapRole::Emissive)
    }
}

impl Material {
    /// The texture in a role.
    pub fn map(&self, role: MapRole) -> Option<TextureRef> {
        match role {
            MapRole::BaseColor => self.base_color,
            MapRole::MetallicRoughness => self.metallic_roughness,
            MapRole::Normal => self.normal,
            MapRole::Occlusion => self.occlusion,
            MapRole::Emissive => self.emissive,
        }
    }

    /// The slot of a role.
    pub fn map_mut(&mut self, role: MapRole) -> &mut Option<TextureRef> {
        match role {
            MapRole::BaseColor => &mut self.base_color,
            MapRole::MetallicRoughness => &mut self.metallic_roughness,
            MapRole::Normal => &mut self.normal,
            MapRole::Occlusion => &mut self.occlusion,
            MapRole::Emissive => &mut self.emissive,
        }
    }
}

/// A baked picture that no material slot holds: for tools, shaders of one's own, and the next program in the chain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ExtraMap {
    /// Signed distance of the high surface from the low one along the texel's direction, object units, outwards positive; in R.
    Height,
    /// Place on the high surface, object space; RGB.
    Position,
    /// Normal of the high surface, axes of the asset, unit length; RGB.
    ObjectNormal,
    /// Number of the high submesh, in R.
    ObjectId,
    /// Number of the source's material, in R; -1: none.
    MaterialId,
    /// Mean curvature of the high surface, 1 / object unit, convex positive; in R.
    Curvature,
    /// Share of the hemisphere above the high surface that is open, weighted by the cosine, `[0, 1]`; in R.
    AmbientOcclusion,
    /// Mean direction of that open share, axes of the asset, unit length; RGB.
    BentNormal,
    /// Alpha of the source, `[0, 1]`; in R.
    Opacity,
    /// Share of the texel's samples that met the high surface, `[0, 1]`; in R. Nothing is filled in.
    Coverage,
}

impl ExtraMap {
    /// Every kind, in the order in which maps are written.
    pub const ALL: [ExtraMap; 10] = [
        ExtraMap::Height,
        ExtraMap::Position,
        ExtraMap::ObjectNormal,
        ExtraMap::ObjectId,
        ExtraMap::MaterialId,
        ExtraMap::Curvature,
        ExtraMap::AmbientOcclusion,
        ExtraMap::BentNormal,
        ExtraMap::Opacity,
        ExtraMap::Coverage,
    ];

    /// The name in pipelines and files: `object-normal`.
    pub fn name(self) -> &'static str {
        match self {
            ExtraMap::Height => "height",
            ExtraMap::Position => "position",
            ExtraMap::ObjectNormal => "object-normal",
            ExtraMap::ObjectId => "object-id",
            ExtraMap::MaterialId => "material-id",
            ExtraMap::Curvature => "curvature",
            ExtraMap::AmbientOcclusion => "ambient-occlusion",
            ExtraMap::BentNormal => "bent-normal",
            ExtraMap::Opacity => "opacity",
            ExtraMap::Coverage => "coverage",
        }
    }
}

/// A picture of a set that belongs to no material: its image holds what `kind` says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExtraImage {
    /// What its texels mean.
    pub kind: ExtraMap,
    /// The atlas sheet it lies on, from 0.
    pub sheet: u32,
    /// Its picture.
    pub image: ImageId,
}

/// Encoding of an image's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ImageFormat {
    /// PNG.
    Png,
    /// JPEG.
    Jpeg,
    /// [`crate::Raster::to_blob`] bytes: what a bake makes.
    Raster,
    /// WebP.
    Webp,
    /// KTX2 with Basis Universal texels.
    Ktx2,
    /// [`crate::DeepRaster::to_blob`] bytes: what a bake makes where 8 bits are too few.
    Deep,
    /// TIFF.
    Tiff,
    /// Truevision TGA.
    Tga,
    /// OpenEXR whose light is encoded as sRGB: what materials use as colour.
    Exr,
    /// OpenEXR whose values are taken as they are.
    ExrLinear,
    /// What OpenImageIO reads and kiln does not, where the build has it (`kiln-oiio`).
    System,
}

impl ImageFormat {
    /// The name in reports: `png`.
    pub fn name(self) -> &'static str {
        match self {
            ImageFormat::Png => "png",
            ImageFormat::Jpeg => "jpeg",
            ImageFormat::Raster => "raster",
            ImageFormat::Webp => "webp",
            ImageFormat::Ktx2 => "ktx2",
            ImageFormat::Deep => "deep",
            ImageFormat::Tiff => "tiff",
            ImageFormat::Tga => "tga",
            ImageFormat::Exr | ImageFormat::ExrLinear => "exr",
            ImageFormat::System => "oiio",
        }
    }
}

/// An image by name and content; its bytes travel beside ([`crate::Asset::images`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ImageInfo {
    /// Name, or the stem of its file.
    pub name: String,
    /// Encoding of the bytes.
    pub format: ImageFormat,
    /// BLAKE3 of the bytes.
    pub hash: [u8; 32],
}

/// Materials with all they refer to, but for the images' bytes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MaterialSet {
    /// What submeshes refer to.
    pub materials: Vec<Material>,
    /// What materials refer to.
    pub textures: Vec<Texture>,
    /// What textures and extras refer to.
    pub images: Vec<ImageInfo>,
    /// Baked pictures outside of materials, by sheet, then by kind.
    pub extras: Vec<ExtraImage>,
}

impl MaterialSet {
    /// The set as bytes for the private cache.
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = crate::blob::BlobWriter::new(*b"MATL", 2);
        blob.meta(self);
        blob.finish()
    }

    /// The set out of [`MaterialSet::to_blob`] bytes; every reference in it is in range.
    ///
    /// # Errors
    /// Wrong type, version, length, or a reference out of range.
    pub fn from_blob(bytes: &[u8]) -> Result<MaterialSet, crate::BlobError> {
        let mut blob = crate::blob::BlobReader::open(bytes, *b"MATL", 2)?;
        let set: MaterialSet = blob.meta()?;
        blob.finish()?;
        let texture_ok =
            |t: Option<TextureRef>| t.is_none_or(|t| t.texture.index() < set.textures.len() && t.uv_set < 2);
        let ok = set.materials.iter().all(|m| MapRole::ALL.iter().all(|r| texture_ok(m.map(*r))))
            && set.textures.iter().all(|t| t.image.index() < set.images.len())
            && set.extras.iter().all(|e| e.image.index() < set.images.len());
        if ok { Ok(set) } else { Err(crate::BlobError::Content("a reference is out of range".into())) }
    }
}
