//! What the bake is asked for, what it reports, how it fails.

use std::sync::Arc;

use kiln_asset::{DeepRaster, ExtraMap, ImageId, LodSet, MapRole, MaterialSet, Mesh, Raster};
use serde::{Deserialize, Serialize};

/// In which space normals are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NormalSpace {
    /// Against the low mesh's interpolated normal and MikkTSpace tangent, +Y up: what renderers expect.
    #[default]
    Tangent,
    /// Object space: for rigid parts and for measuring. glTF has no flag for it; the image's name says so.
    Object,
}

/// Along which directions the low surface looks for the high one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Directions {
    /// The mean normal of each point, mixed over the face: neighbours look the same way along their common edge, so nothing is
    /// missed or seen twice there, hard edges included.
    #[default]
    Smooth,
    /// The face's normal: straight onto flat parts; jumps at every edge.
    Face,
    /// The normal of each vertex: as `Smooth` within smooth parts, straight onto flat parts behind hard edges, where a gap
    /// opens.
    Mixed,
}

/// Which of several hits on a texel's line wins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HitRule {
    /// The outermost within reach: keeps parts that float above the surface; takes an overhang for the surface below it.
    #[default]
    Outermost,
    /// The one nearest to the low surface, in front or behind. Safe in folds; swallows parts that float close above.
    Nearest,
}

/// Which submeshes of the high mesh a submesh of the low one may show.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Matching {
    /// Where a line meets the one of its own name, no other is looked at: keeps a lens out of the eye behind it. Where it does
    /// not, any will do.
    #[default]
    Prefer,
    /// The one of its own name only.
    Name,
    /// Any.
    Any,
}

/// How a texel finds its place on the high mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Along its line: thesis section 6.3, mended.
    #[default]
    MirroredVertex,
    /// At its own texture coordinates, where both meshes share a layout without overlaps: section 6.2.
    Correspondence,
}

/// How finely maps are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Depth {
    /// 8 bits a channel in materials; extra maps have 16, and 32 where they hold lengths or numbers.
    #[default]
    Eight,
    /// 16 bits a channel, 32 for lengths and numbers.
    Sixteen,
    /// 32-bit floats.
    Float,
}

/// Where occlusion comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OcclusionSource {
    /// The source's maps.
    #[default]
    Source,
    /// Rays against the high mesh.
    Rays,
    /// Both, multiplied.
    Both,
}

/// How to bake. Every field has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case")]
pub struct BakeOptions {
    /// Which maps of materials to write; each once, in the order of [`MapRole::ALL`] whatever the order here. Occlusion and
    /// emission are left out where no material has any.
    pub maps: Vec<MapRole>,
    /// Which other maps to write.
    pub extras: Vec<ExtraMap>,
    /// How a texel finds its place.
    pub method: Method,
    /// Space of the normal map.
    pub space: NormalSpace,
    /// Width and height of the maps, texels, 1 to 16384.
    pub size: u32,
    /// Samples a texel has on each side: 1, 2, 4 or 8. More than one are weighted by a tent of one texel's radius.
    pub samples: u32,
    /// How finely maps are written.
    pub depth: Depth,
    /// Width of the filled band around charts, texels.
    pub dilation: u32,
    /// Where lines look.
    pub directions: Directions,
    /// Which hit wins.
    pub hit: HitRule,
    /// How far in front of the low surface the high one is looked for, object units. `None`: [`BakeOptions::REACH`] times the
    /// finest level's error, at least [`BakeOptions::REACH_SHARE`] of the high mesh's diagonal.
    pub front: Option<f32>,
    /// Likewise behind.
    pub back: Option<f32>,
    /// Take high faces that face away from the low triangle too; their normals are turned.
    pub back_faces: bool,
    /// Which submeshes go together.
    pub matching: Matching,
    /// Where the occlusion map comes from.
    pub occlusion: OcclusionSource,
    /// Rays for each texel's ambient occlusion and bent normal, 1 to 4096; at least one a sample.
    pub rays: u32,
    /// How far those rays go, object units. `None`: the high mesh's diagonal.
    pub ray_length: Option<f32>,
}

impl Default for BakeOptions {
    fn default() -> Self {
        BakeOptions {
            maps: vec![MapRole::BaseColor, MapRole::Normal],
            extras: Vec::new(),
            method: Method::default(),
            space: NormalSpace::Tangent,
            size: 2048,
            samples: 1,
            depth: Depth::default(),
            dilation: 8,
            directions: Directions::default(),
            hit: HitRule::default(),
            front: None,
            back: None,
            back_faces: false,
            matching: Matching::default(),
            occlusion: OcclusionSource::default(),
            rays: 64,
            ray_length: None,
        }
    }
}

impl BakeOptions {
    /// Greatest map, texels a side.
    pub const SIZE_MAX: u32 = 16384;

    /// Reach in units of the finest level's greatest distance from the source.
    pub const REACH: f32 = 1.5;

    /// Share of the high mesh's diagonal that the reach is at least, where none is given.
    pub const REACH_SHARE: f32 = 1e-3;
}

/// Who looks for hits.
#[derive(Clone, Copy, Debug)]
pub enum Backend<'a> {
    /// The CPU twin: the same bytes on every machine of a numeric class.
    Cpu,
    /// A graphics device: within the tolerance of the twin test.
    Gpu(&'a kiln_gpu::Gpu),
}

/// Gives a decoded picture of the materials' images, or says why not. Called once for an image and role, and only for
/// images that a baked map reads.
pub type Images<'a> = dyn Fn(ImageId) -> Result<Arc<Raster>, String> + 'a;

/// What is baked from what.
#[derive(Clone, Copy)]
pub struct BakeInput<'a> {
    /// The mesh that is carried over; needs normals.
    pub high: &'a Mesh,
    /// The levels that get maps, finest first; each needs normals and `atlas_uv` (for correspondence `uv0` will do).
    pub low: &'a LodSet,
    /// Materials of both.
    pub materials: &'a MaterialSet,
    /// Their pictures.
    pub images: &'a (dyn Fn(ImageId) -> Result<Arc<Raster>, String> + 'a),
    /// A surface around the low mesh: how far in front of each point is looked, instead of [`BakeOptions::front`].
    pub cage: Option<&'a Mesh>,
}

/// What a bake made.
#[derive(Clone, Debug, Default)]
pub struct Baked {
    /// The levels in their new UVs and materials.
    pub levels: LodSet,
    /// Those materials.
    pub materials: MaterialSet,
    /// `[materials.images.len()]`.
    pub pictures: Vec<Picture>,
    /// What happened.
    pub report: BakeReport,
}

/// A baked picture.
#[derive(Clone, Debug, PartialEq)]
pub enum Picture {
    /// 8 bits a channel.
    Plain(Raster),
    /// More.
    Deep(DeepRaster),
}

impl Picture {
    /// Its bytes for the private cache.
    pub fn to_blob(&self) -> Vec<u8> {
        match self {
            Picture::Plain(raster) => raster.to_blob(),
            Picture::Deep(raster) => raster.to_blob(),
        }
    }

    /// BLAKE3 of those bytes.
    pub fn blob_hash(&self) -> [u8; 32] {
        match self {
            Picture::Plain(raster) => raster.blob_hash(),
            Picture::Deep(raster) => raster.blob_hash(),
        }
    }
}

/// What the bake did.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BakeReport {
    /// `cpu`, or the device class.
    pub backend: String,
    /// Width and height of the maps, texels.
    pub size: u32,
    /// How far in front of the low surface was looked, object units.
    pub front: f32,
    /// How far behind.
    pub back: f32,
    /// Sheets of the atlas.
    pub sheets: u32,
    /// Texels whose centre lies in a low triangle.
    pub owned: u64,
    /// Texels with a hit.
    pub covered: u64,
    /// Texels of charts without a hit: filled from their neighbours.
    pub missed: u64,
    /// Texel centres that more than one low triangle covers: 0 unless the layout overlaps.
    pub overlapping: u64,
    /// Low faces too thin for a normal; their texels are missed.
    pub sliver_faces: u64,
    /// Low faces without area on the sheet: nothing can be baked for them.
    pub flat_faces: u64,
    /// Low faces that went by their own normal, since a point's normal lies across them.
    pub steep_faces: u64,
    /// Low faces whose lines cross within reach: looked at up to there only.
    pub crossing_faces: u64,
    /// Pairs of a low and a high face that were looked at.
    pub pairs: u64,
    /// Texels of a tangent-space normal map whose normal lies behind the low mesh's shading normal: right only where the
    /// reader keeps a negative z; many of them say that the low mesh's normals are poor.
    pub behind: u64,
    /// Maps written.
    pub maps: Vec<MapRole>,
    /// Other maps written.
    pub extras: Vec<ExtraMap>,
    /// Maps asked for that no material says anything in.
    pub neutral_maps: Vec<MapRole>,
    /// Maps that materials in use have and nobody asked for: they are gone, since the old layout is.
    pub lost_maps: Vec<MapRole>,
    /// Texels filled by dilation, in each map.
    pub dilated: u64,
    /// The layout's padding in texels of these maps, where it is less than the dilation: bands of two charts meet.
    pub short_padding: Option<u32>,
}

/// Why a bake is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BakeError {
    /// An option is out of range.
    #[error("bake option {name} is {found}; it must be {expected}")]
    Option {
        /// The option.
        name: &'static str,
        /// Its value.
        found: String,
        /// What it may be.
        expected: String,
    },
    /// There is nothing to bake onto.
    #[error("the low model has no levels")]
    NoLevels,
    /// A level was not unwrapped.
    #[error("level {level} has no atlas UVs; put an atlas stage before the bake")]
    NoAtlas {
        /// The level.
        level: usize,
    },
    /// A mesh has no normals.
    #[error("the {mesh} mesh has no normals; rebuild them before the bake")]
    NoNormals {
        /// `high`, or `low`.
        mesh: &'static str,
    },
    /// Tangents are missing or belong to other UVs.
    #[error("level {level}: tangents belong to another UV layout than the atlas; compute them right after the atlas")]
    StaleTangents {
        /// The level.
        level: usize,
    },
    /// The layouts of the two meshes do not correspond.
    #[error("correspondence: {0}")]
    Layouts(String),
    /// MikkTSpace failed.
    #[error("tangents: {0}")]
    Tangents(String),
    /// A texture of the source cannot be read.
    #[error("image {image}: {message}")]
    Image {
        /// The image.
        image: ImageId,
        /// Why.
        message: String,
    },
    /// The device failed.
    #[error(transparent)]
    Gpu(#[from] kiln_gpu::GpuError),
    /// A level that the bake made breaks a promise: a defect of kiln.
    #[error("baked level {level}: {message}")]
    Mesh {
        /// The level.
        level: usize,
        /// What is wrong with it.
        message: String,
    },
}
