//! Registries: section kinds, codecs, vertex semantics and formats, texture formats, channels. Rows of these tables are the
//! rows of the specification.

use crate::error::Code;

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

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.escape_ascii().fmt(f)
    }
}

impl std::fmt::Debug for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
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

/// Section kinds of container version 1.0.
pub const KINDS: [KindRow; 10] = [
    row(Kind::STRINGS, true, TABLE_ALIGNMENT, 0, Occurs::Once),
    row(Kind::LEVELS, true, TABLE_ALIGNMENT, 1, Occurs::Once),
    row(Kind::SUBMESHES, true, TABLE_ALIGNMENT, 2, Occurs::Once),
    row(Kind::MATERIALS, true, TABLE_ALIGNMENT, 3, Occurs::Once),
    row(Kind::TEXTURES, true, TABLE_ALIGNMENT, 4, Occurs::Once),
    row(Kind::PROVENANCE, false, TABLE_ALIGNMENT, 5, Occurs::AtMostOnce),
    row(Kind::VERTICES, true, PAYLOAD_ALIGNMENT, 6, Occurs::Many),
    row(Kind::INDICES, true, PAYLOAD_ALIGNMENT, 6, Occurs::Many),
    row(Kind::MIP_TAIL, true, PAYLOAD_ALIGNMENT, 6, Occurs::Many),
    row(Kind::MIP, true, PAYLOAD_ALIGNMENT, 7, Occurs::Many),
];

/// Codecs by number: name, and whether version 1.0 has it. Only `none` is in use; the others hold their number.
pub const CODECS: [(u32, &str, bool); 5] = [
    (0, "none", true),
    (1, "zstd", false),
    (2, "lz4", false),
    (3, "meshopt-vertex", false),
    (4, "meshopt-index", false),
];

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
    /// How a texel lies in memory.
    TextureFormat {
        /// Four bytes, each n/255.
        Rgba8Unorm = 1 "rgba8-unorm",
        /// Four bytes; R, G and B are sRGB-encoded, A is n/255.
        Rgba8Srgb = 2 "rgba8-srgb",
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

impl Role {
    /// The format of a texture in this role.
    pub fn format(self) -> TextureFormat {
        match self {
            Role::BaseColor | Role::Emissive => TextureFormat::Rgba8Srgb,
            _ => TextureFormat::Rgba8Unorm,
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

/// The registered meaning of a number, or a finding's words for it.
pub(crate) fn unknown(place: String, what: &str, found: u32) -> crate::FormatError {
    crate::FormatError::new(Code::Value, place, format!("a registered {what}"), found)
}
