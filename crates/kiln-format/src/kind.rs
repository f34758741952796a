//! Registries: section kinds, codecs, vertex semantics and formats, texture formats, channels. Rows of these tables are the
//! rows of the specification.

use crate::error::Code;
use crate::prelude::*;

/// A section's kind: four ASCII letters or digits. Kinds that start with an upper-case letter are registered in the
/// specification; those that start with a lower-case letter are private and free for anybody's use.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Kind(pub [u8; 4]);

impl Kind {
    /// All names of the other tables.
    pub const STRINGS: Kind = Kind(*b"STRS");
    /// Levels, their arrays, their needed sections.
    pub const LEVELS: Kind = Kind(*b"LEVL");
    /// Submeshes and their draw ranges at every level.
    pub const SUBMESHES: Kind = Kind(*b"SUBM");
    /// Materials.
    pub const MATERIALS: Kind = Kind(*b"MATL");
    /// Textures and their mips.
    pub const TEXTURES: Kind = Kind(*b"TEXT");
    /// What made the file.
    pub const PROVENANCE: Kind = Kind(*b"PROV");
    /// Vertex arrays of a level.
    pub const VERTICES: Kind = Kind(*b"VERT");
    /// Indices of a level.
    pub const INDICES: Kind = Kind(*b"INDX");
    /// All small mips of one texture.
    pub const MIP_TAIL: Kind = Kind(*b"MIPT");
    /// One large mip of one texture.
    pub const MIP: Kind = Kind(*b"MIPL");
    /// Sliding window over level 0.
    pub const WINDOW: Kind = Kind(*b"WNDW");
    /// Tree buffer over level 0.
    pub const TREE: Kind = Kind(*b"TREE");
    /// Leaf buffer that goes with it.
    pub const LEAF: Kind = Kind(*b"LEAF");
    /// Compact tree over level 0.
    pub const COMPACT_TREE: Kind = Kind(*b"CTRE");
    /// Cluster DAG over level 0.
    pub const CLUSTERS: Kind = Kind(*b"CLUS");

    /// Sections of [`crate::Layouts`], in canonical order.
    pub const LAYOUTS: [Kind; 5] = [Kind::WINDOW, Kind::TREE, Kind::LEAF, Kind::COMPACT_TREE, Kind::CLUSTERS];

    /// Whether the four bytes form a name.
    pub fn is_well_formed(self) -> bool {
        self.0[0].is_ascii_alphabetic() && self.0.iter().all(u8::is_ascii_alphanumeric)
    }

    /// Whether it lies in the private range.
    pub fn is_private(self) -> bool {
        self.0[0].is_ascii_lowercase()
    }

    /// Its row of the registry.
    pub fn row(self) -> Option<&'static KindRow> {
        KINDS.iter().find(|row| row.kind == self)
    }
}

impl core::fmt::Display for Kind {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        self.0.escape_ascii().fmt(f)
    }
}

impl core::fmt::Debug for Kind {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Kind({self})")
    }
}

/// What the registry says about a section kind.
#[derive(Clone, Copy, Debug)]
pub struct KindRow {
    /// The kind.
    pub kind: Kind,
    /// Highest version that this reader knows; versions count from 1.
    pub version: u16,
    /// Whether a reader that does not know it must refuse the file.
    pub required: bool,
    /// Alignment of the section, bytes.
    pub alignment: u32,
    /// Place in the canonical order; equal ranks are ordered by what they belong to.
    pub rank: u32,
    /// How often it may occur.
    pub occurs: Occurs,
}

/// How often a section kind occurs in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Occurs {
    /// Exactly once.
    Once,
    /// Once or not at all.
    AtMostOnce,
    /// Any number of times.
    Many,
}

/// Alignment of tables, bytes.
pub const TABLE_ALIGNMENT: u32 = 16;
/// Alignment of GPU payload and of each array in it, bytes: the largest that common graphics interfaces ask for copies and
/// bindings.
pub const PAYLOAD_ALIGNMENT: u32 = 256;
/// Rank of the first payload kind: all kinds below are tables.
pub const PAYLOAD_RANK: u32 = 6;

const fn row(kind: Kind, required: bool, alignment: u32, rank: u32, occurs: Occurs) -> KindRow {
    KindRow { kind, version: 1, required, alignment, rank, occurs }
}

/// Version of [`Kind::TEXTURES`] whose formats and roles are those of container 1.0; later ones came with 1.1.
pub const FIRST_TEXTURES: u16 = 1;
/// Version of [`Kind::TEXTURES`] with deep and block-compressed formats and extra pictures.
pub const WIDE_TEXTURES: u16 = 2;

/// Version of [`Kind::LEVELS`] in which each level has all elements of its vertex section.
pub const FIRST_LEVELS: u16 = 1;
/// Version of [`Kind::LEVELS`] in which a level may have the first elements of level 0's arrays; with 1.2.
pub const SHARED_LEVELS: u16 = 2;

/// Section kinds of container version 1.2.
pub const KINDS: [KindRow; 15] = [
    row(Kind::STRINGS, true, TABLE_ALIGNMENT, 0, Occurs::Once),
    KindRow { version: SHARED_LEVELS, ..row(Kind::LEVELS, true, TABLE_ALIGNMENT, 1, Occurs::Once) },
    row(Kind::SUBMESHES, true, TABLE_ALIGNMENT, 2, Occurs::Once),
    row(Kind::MATERIALS, true, TABLE_ALIGNMENT, 3, Occurs::Once),
    KindRow { version: WIDE_TEXTURES, ..row(Kind::TEXTURES, true, TABLE_ALIGNMENT, 4, Occurs::Once) },
    row(Kind::PROVENANCE, false, TABLE_ALIGNMENT, 5, Occurs::AtMostOnce),
    row(Kind::VERTICES, true, PAYLOAD_ALIGNMENT, 6, Occurs::Many),
    row(Kind::INDICES, true, PAYLOAD_ALIGNMENT, 6, Occurs::Many),
    row(Kind::MIP_TAIL, true, PAYLOAD_ALIGNMENT, 6, Occurs::Many),
    row(Kind::WINDOW, false, PAYLOAD_ALIGNMENT, 7, Occurs::AtMostOnce),
    row(Kind::TREE, false, PAYLOAD_ALIGNMENT, 8, Occurs::AtMostOnce),
    row(Kind::LEAF, false, PAYLOAD_ALIGNMENT, 9, Occurs::AtMostOnce),
    row(Kind::COMPACT_TREE, false, PAYLOAD_ALIGNMENT, 10, Occurs::AtMostOnce),
    row(Kind::CLUSTERS, false, PAYLOAD_ALIGNMENT, 11, Occurs::AtMostOnce),
    row(Kind::MIP, true, PAYLOAD_ALIGNMENT, 12, Occurs::Many),
];

/// Codecs by number: name, and whether it is in use; the others hold their number.
pub const CODECS: [(u32, &str, bool); 5] =
    [(0, "none", true), (1, "zstd", true), (2, "lz4", false), (3, "meshopt-vertex", true), (4, "meshopt-index", true)];

/// The codec's name, or its number.
pub fn codec_name(codec: u32) -> String {
    match CODECS.iter().find(|row| row.0 == codec) {
        Some(row) => row.1.to_string(),
        None => format!("codec {codec}"),
    }
}

/// Declares an enum of registered numbers with `from_number`, `number` and `name`.
macro_rules! registry {
    ($(#[$doc:meta])* $type:ident { $($(#[$vdoc:meta])* $variant:ident = $number:literal $name:literal),* $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum $type { $($(#[$vdoc])* $variant),* }

        impl $type {
            /// Every row, by number.
            pub const ALL: &'static [$type] = &[$($type::$variant),*];

            /// The row of a number, if it is assigned.
            pub fn from_number(number: u32) -> Option<$type> {
                match number { $($number => Some($type::$variant),)* _ => None }
            }

            /// The number in files.
            pub fn number(self) -> u32 {
                match self { $($type::$variant => $number),* }
            }

            /// The name in reports.
            pub fn name(self) -> &'static str {
                match self { $($type::$variant => $name),* }
            }
        }
    };
}

registry! {
    /// What a vertex array holds.
    Semantic {
        /// Object space, metres.
        Positions = 1 "positions",
        /// Unit normals, object space.
        Normals = 2 "normals",
        /// xyz unit tangent, w = +1 or -1.
        Tangents = 3 "tangents",
        /// First UV set.
        Uv0 = 4 "uv0",
        /// Second UV set.
        Uv1 = 5 "uv1",
        /// Linear RGBA.
        Colors = 6 "colors",
        /// Four joint indices.
        Joints = 7 "joints",
        /// Four joint weights.
        Weights = 8 "weights",
    }
}

registry! {
    /// How one element of a vertex array lies in memory.
    VertexFormat {
        /// Two 32-bit floats, 8 bytes.
        F32x2 = 1 "f32x2",
        /// Three 32-bit floats, 12 bytes.
        F32x3 = 2 "f32x3",
        /// Four 32-bit floats, 16 bytes.
        F32x4 = 3 "f32x4",
        /// Four 16-bit unsigned integers, 8 bytes.
        U16x4 = 4 "u16x4",
    }
}

registry! {
    /// How texels lie in memory; those from 3 on need version 2 of the texture table.
    TextureFormat {
        /// Four bytes, each n/255.
        Rgba8Unorm = 1 "rgba8-unorm",
        /// Four bytes; R, G and B are sRGB-encoded, A is n/255.
        Rgba8Srgb = 2 "rgba8-srgb",
        /// Four 16-bit unsigned integers, each n/65535.
        Rgba16Unorm = 3 "rgba16-unorm",
        /// Four 16-bit floats.
        Rgba16Float = 4 "rgba16-float",
        /// Four 32-bit floats.
        Rgba32Float = 5 "rgba32-float",
        /// Two channels in blocks of 4 x 4 texels of 16 bytes (BC5, RGTC2).
        Bc5Unorm = 6 "bc5-unorm",
        /// Four channels in blocks of 4 x 4 texels of 16 bytes (BC7, BPTC).
        Bc7Unorm = 7 "bc7-unorm",
        /// As `bc7-unorm`; R, G and B are sRGB-encoded.
        Bc7Srgb = 8 "bc7-srgb",
    }
}

registry! {
    /// How a level's error was found.
    ErrorKind {
        /// Greatest distance over sample points of both surfaces: the true one may be larger between samples.
        Sampled = 1 "sampled",
        /// Nowhere exceeded.
        Bound = 2 "bound",
    }
}

registry! {
    /// What a texture channel means.
    Channel {
        /// Nothing: readers ignore it.
        Unused = 0 "unused",
        /// Red of a colour.
        Red = 1 "red",
        /// Green of a colour.
        Green = 2 "green",
        /// Blue of a colour.
        Blue = 3 "blue",
        /// Alpha.
        Alpha = 4 "alpha",
        /// x of a tangent-space normal, `2c - 1`.
        NormalX = 5 "normal-x",
        /// y of a tangent-space normal, up.
        NormalY = 6 "normal-y",
        /// z of a tangent-space normal.
        NormalZ = 7 "normal-z",
        /// Perceptual roughness.
        Roughness = 8 "roughness",
        /// Metalness.
        Metallic = 9 "metallic",
        /// Ambient occlusion, 1 = open.
        Occlusion = 10 "occlusion",
        /// Signed distance of the source's surface along the texel's direction, object units, outwards positive.
        Height = 11 "height",
        /// x of a place on the source's surface, object space.
        PositionX = 12 "position-x",
        /// y of it.
        PositionY = 13 "position-y",
        /// z of it.
        PositionZ = 14 "position-z",
        /// x of a unit normal of the source's surface, axes of the asset.
        ObjectNormalX = 15 "object-normal-x",
        /// y of it.
        ObjectNormalY = 16 "object-normal-y",
        /// z of it.
        ObjectNormalZ = 17 "object-normal-z",
        /// Number of the source's submesh.
        ObjectId = 18 "object-id",
        /// Number of the source's material, -1: none.
        MaterialId = 19 "material-id",
        /// Mean curvature of the source's surface, 1 / object unit, convex positive.
        Curvature = 20 "curvature",
        /// x of the mean open direction, unit length, axes of the asset.
        BentNormalX = 21 "bent-normal-x",
        /// y of it.
        BentNormalY = 22 "bent-normal-y",
        /// z of it.
        BentNormalZ = 23 "bent-normal-z",
        /// Alpha of the source.
        Opacity = 24 "opacity",
        /// Share of the texel's samples that met the source's surface.
        Coverage = 25 "coverage",
    }
}

registry! {
    /// The five maps of a metallic-roughness material, in slot order; bit `n` of a texture's role set is role `n`.
    Role {
        /// Base colour and alpha, sRGB.
        BaseColor = 0 "base-color",
        /// Roughness in green, metalness in blue.
        MetallicRoughness = 1 "metallic-roughness",
        /// Tangent-space normals, +Y up.
        Normal = 2 "normal",
        /// Occlusion in red.
        Occlusion = 3 "occlusion",
        /// Emission, sRGB.
        Emissive = 4 "emissive",
    }
}

registry! {
    /// What an extra picture holds, one that no material uses; bit `n` of a texture's role set is extra `n`.
    Extra {
        /// Signed distance to the source's surface.
        Height = 5 "height",
        /// Place on the source's surface.
        Position = 6 "position",
        /// Normal of the source's surface, axes of the asset.
        ObjectNormal = 7 "object-normal",
        /// Number of the source's submesh.
        ObjectId = 8 "object-id",
        /// Number of the source's material.
        MaterialId = 9 "material-id",
        /// Mean curvature of the source's surface.
        Curvature = 10 "curvature",
        /// Open share of the hemisphere.
        AmbientOcclusion = 11 "ambient-occlusion",
        /// Mean open direction.
        BentNormal = 12 "bent-normal",
        /// Alpha of the source.
        Opacity = 13 "opacity",
        /// Share of samples that met the source's surface.
        Coverage = 14 "coverage",
    }
}

impl Semantic {
    /// The only format that version 1.0 has for it.
    pub fn format(self) -> VertexFormat {
        match self {
            Semantic::Positions | Semantic::Normals => VertexFormat::F32x3,
            Semantic::Tangents | Semantic::Colors | Semantic::Weights => VertexFormat::F32x4,
            Semantic::Uv0 | Semantic::Uv1 => VertexFormat::F32x2,
            Semantic::Joints => VertexFormat::U16x4,
        }
    }
}

impl VertexFormat {
    /// Bytes of one element.
    pub fn size(self) -> usize {
        match self {
            VertexFormat::F32x2 | VertexFormat::U16x4 => 8,
            VertexFormat::F32x3 => 12,
            VertexFormat::F32x4 => 16,
        }
    }
}

impl TextureFormat {
    /// Bytes of one texel, or of one block where [`TextureFormat::is_block`].
    pub fn unit_size(self) -> u64 {
        match self {
            TextureFormat::Rgba8Unorm | TextureFormat::Rgba8Srgb => 4,
            TextureFormat::Rgba16Unorm | TextureFormat::Rgba16Float => 8,
            TextureFormat::Rgba32Float | TextureFormat::Bc5Unorm | TextureFormat::Bc7Unorm | TextureFormat::Bc7Srgb => {
                16
            }
        }
    }

    /// Whether texels come in blocks of 4 x 4, those of the right and lower edge filled up.
    pub fn is_block(self) -> bool {
        matches!(self, TextureFormat::Bc5Unorm | TextureFormat::Bc7Unorm | TextureFormat::Bc7Srgb)
    }

    /// Whether R, G and B are sRGB-encoded.
    pub fn is_srgb(self) -> bool {
        matches!(self, TextureFormat::Rgba8Srgb | TextureFormat::Bc7Srgb)
    }

    /// Bytes of a mip of `width` x `height` texels (each at most [`crate::record::MAX_TEXTURE_SIZE`]).
    pub fn mip_length(self, width: u32, height: u32) -> u64 {
        let units = |side: u32| if self.is_block() { side.div_ceil(4) as u64 } else { side as u64 };
        units(width) * units(height) * self.unit_size()
    }

    /// Whether version 1 of the texture table has it.
    pub fn is_first(self) -> bool {
        matches!(self, TextureFormat::Rgba8Unorm | TextureFormat::Rgba8Srgb)
    }
}

impl Role {
    /// The formats of a texture in this role, 8-bit first.
    pub fn formats(self) -> &'static [TextureFormat] {
        use TextureFormat::*;
        match self {
            Role::BaseColor | Role::Emissive => &[Rgba8Srgb, Rgba16Unorm, Rgba16Float, Rgba32Float, Bc7Srgb],
            Role::Normal => &[Rgba8Unorm, Rgba16Unorm, Rgba16Float, Rgba32Float, Bc5Unorm, Bc7Unorm],
            Role::MetallicRoughness | Role::Occlusion => &[Rgba8Unorm, Rgba16Unorm, Rgba16Float, Rgba32Float, Bc7Unorm],
        }
    }

    /// What the four channels mean in this role.
    pub fn channels(self) -> [Channel; 4] {
        use Channel::*;
        match self {
            Role::BaseColor => [Red, Green, Blue, Alpha],
            Role::MetallicRoughness => [Unused, Roughness, Metallic, Unused],
            Role::Normal => [NormalX, NormalY, NormalZ, Unused],
            Role::Occlusion => [Occlusion, Unused, Unused, Unused],
            Role::Emissive => [Red, Green, Blue, Unused],
        }
    }
}

impl Extra {
    /// The formats of a texture that holds it.
    pub const FORMATS: [TextureFormat; 4] =
        [TextureFormat::Rgba8Unorm, TextureFormat::Rgba16Unorm, TextureFormat::Rgba16Float, TextureFormat::Rgba32Float];

    /// What the four channels mean.
    pub fn channels(self) -> [Channel; 4] {
        use Channel::*;
        match self {
            Extra::Height => [Height, Unused, Unused, Unused],
            Extra::Position => [PositionX, PositionY, PositionZ, Unused],
            Extra::ObjectNormal => [ObjectNormalX, ObjectNormalY, ObjectNormalZ, Unused],
            Extra::ObjectId => [ObjectId, Unused, Unused, Unused],
            Extra::MaterialId => [MaterialId, Unused, Unused, Unused],
            Extra::Curvature => [Curvature, Unused, Unused, Unused],
            Extra::AmbientOcclusion => [Occlusion, Unused, Unused, Unused],
            Extra::BentNormal => [BentNormalX, BentNormalY, BentNormalZ, Unused],
            Extra::Opacity => [Opacity, Unused, Unused, Unused],
            Extra::Coverage => [Coverage, Unused, Unused, Unused],
        }
    }

    /// The extra of a role set, if it holds exactly one and no role of a material.
    pub fn from_roles(roles: u32) -> Option<Extra> {
        if roles.count_ones() == 1 { Extra::from_number(roles.trailing_zeros()) } else { None }
    }
}

/// The registered meaning of a number, or a finding's words for it.
pub(crate) fn unknown(place: String, what: &str, found: u32) -> crate::FormatError {
    crate::FormatError::new(Code::Value, place, format!("a registered {what}"), found)
}
