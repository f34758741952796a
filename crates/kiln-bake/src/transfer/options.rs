//! What the bake is asked for, what it reports, how it fails.

use std::sync::Arc;

use kiln_asset::{ImageId, MapRole, Raster};
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

/// Which of several hits on a texel's line wins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum HitRule {
    /// The one nearest to the low triangle's plane, in front or behind; equally near: the lower high face. Safe in folds;
    /// swallows parts that float close above.
    #[default]
    Nearest,
}

/// How to bake. Every field has a default.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, rename_all = "kebab-case")]
pub struct BakeOptions {
    /// Which maps to write; each once, in the order of [`MapRole::ALL`] whatever the order here. Occlusion and emission
    /// are left out where no material has any.
    pub maps: Vec<MapRole>,
    /// Space of the normal map.
    pub space: NormalSpace,
    /// Width and height of the maps, texels, 1 to 16384.
    pub size: u32,
    /// Width of the filled band around charts, texels.
    pub dilation: u32,
    /// Cage distance: how far from a low triangle's plane the high mesh is looked for, object units. `None`: 2 % of the
    /// high mesh's diagonal or twice the finest level's error, whichever is more. Nearest hits make a generous distance
    /// cheap in quality; it costs candidates.
    pub cage: Option<f32>,
    /// Which hit wins.
    pub hit: HitRule,
    /// Take high faces that face away from the low triangle too; their normals are turned.
    pub back_faces: bool,
    /// Where a line meets the high submesh of the low submesh's name, other submeshes are not looked at: keeps a lens out
    /// of the eye behind it. Where it does not, any submesh will do.
    pub prefer_same_submesh: bool,
}

impl Default for BakeOptions {
    fn default() -> Self {
        BakeOptions {
            maps: vec![MapRole::BaseColor, MapRole::Normal],
            space: NormalSpace::Tangent,
            size: 2048,
            dilation: 8,
            cage: None,
            hit: HitRule::Nearest,
            back_faces: false,
            prefer_same_submesh: true,
        }
    }
}

impl BakeOptions {
    /// Greatest map, texels a side.
    pub const SIZE_MAX: u32 = 16384;

    /// Share of the high mesh's diagonal that the cage distance is at least, where none is given.
    pub const CAGE_SHARE: f32 = 0.02;
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

/// What the bake did.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BakeReport {
    /// `cpu`, or the device class.
    pub backend: String,
    /// Width and height of the maps, texels.
    pub size: u32,
    /// Cage distance used, object units.
    pub cage: f32,
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
    /// Pairs of a low and a high face that were looked at.
    pub pairs: u64,
    /// Texels of a tangent-space normal map whose normal lies behind the low mesh's shading normal: right only where the
    /// reader keeps a negative z; many of them say that the low mesh's normals are poor.
    pub behind: u64,
    /// Maps written.
    pub maps: Vec<MapRole>,
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
