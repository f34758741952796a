//! The fixed-size records as they lie in the file. Field order is byte order; every record is free of implicit padding, which
//! `Pod` proves. The specification's offset tables are these structs.

use bytemuck::{Pod, Zeroable};

#[cfg(target_endian = "big")]
compile_error!("containers are little-endian and lent in place; a big-endian target needs a swapping reader first");

/// First eight bytes. The high bit dies in 7-bit transfer, CR LF and LF in newline conversion, 0x1A stops a text listing.
pub const MAGIC: [u8; 8] = [0x89, b'K', b'L', b'N', 0x0D, 0x0A, 0x1A, 0x0A];
/// The endian marker as a number.
pub const ENDIAN: u32 = 0x0102_0304;
/// Major version: another one is refused.
pub const MAJOR: u16 = 1;
/// Newest minor version that this crate knows; newer ones are read. The writer states the oldest that holds the content.
pub const MINOR: u16 = 2;
/// Bytes of the header.
pub const HEADER_SIZE: usize = 96;
/// Bytes of the header that the header's hash covers.
pub const HASHED_HEADER: usize = 64;
/// Bytes of a section entry.
pub const ENTRY_SIZE: usize = 128;
/// Flag bit of a required section.
pub const FLAG_REQUIRED: u16 = 1;
/// An index that names nothing.
pub const NONE: u32 = u32::MAX;

/// Most sections of a file.
pub const MAX_SECTIONS: u32 = 1 << 20;
/// Most levels.
pub const MAX_LEVELS: u32 = 256;
/// Most submeshes.
pub const MAX_SUBMESHES: u32 = 1 << 20;
/// Most materials.
pub const MAX_MATERIALS: u32 = 1 << 16;
/// Most textures.
pub const MAX_TEXTURES: u32 = 1 << 16;
/// Most strings.
pub const MAX_STRINGS: u32 = 1 << 22;
/// Longest string, bytes.
pub const MAX_STRING: u32 = 65_535;
/// Greatest width or height of a texture, texels.
pub const MAX_TEXTURE_SIZE: u32 = 65_536;
/// Most vertices and most triangles of a level.
pub const MAX_ELEMENTS: u32 = u32::MAX / 3 - 1;
/// Most vertices for which indices take two bytes: index 65,535 is the restart value and stays unused.
pub const MAX_U16_VERTICES: u32 = 65_535;

/// The header, at offset 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Header {
    /// [`MAGIC`].
    pub magic: [u8; 8],
    /// [`ENDIAN`].
    pub endian: u32,
    /// [`MAJOR`].
    pub major: u16,
    /// [`MINOR`] or newer.
    pub minor: u16,
    /// Bytes of the whole file.
    pub file_length: u64,
    /// Offset of the section table: [`HEADER_SIZE`].
    pub table_offset: u64,
    /// Entries of the section table.
    pub section_count: u32,
    /// Zero.
    pub reserved0: u32,
    /// Zero.
    pub reserved1: [u8; 24],
    /// BLAKE3 of header bytes 0..64 followed by the section table.
    pub hash: [u8; 32],
}

/// One entry of the section table. Its place in the table is the section's number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct SectionEntry {
    /// [`crate::Kind`].
    pub kind: [u8; 4],
    /// Version of the section's layout, from 1.
    pub version: u16,
    /// [`FLAG_REQUIRED`].
    pub flags: u16,
    /// [`crate::kind::CODECS`].
    pub codec: u32,
    /// 16 or 256, bytes.
    pub alignment: u32,
    /// From the start of the file, bytes.
    pub offset: u64,
    /// Bytes in the file.
    pub stored_length: u64,
    /// Bytes after decoding.
    pub raw_length: u64,
    /// Zero.
    pub reserved0: [u8; 8],
    /// BLAKE3 of the bytes in the file.
    pub stored_hash: [u8; 32],
    /// BLAKE3 of the decoded bytes.
    pub raw_hash: [u8; 32],
    /// Zero.
    pub reserved1: [u8; 16],
}

/// Start of the level table; behind it `level_count` [`LevelRecord`]s, `array_count` [`ArrayRecord`]s, `need_count` u32.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct LevelHeader {
    /// Levels, at least one.
    pub level_count: u32,
    /// Arrays of all levels.
    pub array_count: u32,
    /// Needed sections of all levels.
    pub need_count: u32,
    /// Triangles of the source asset.
    pub source_triangles: u32,
    /// 1 if the next three fields tell the UV layout of `uv0`, else 0.
    pub has_layout: u32,
    /// Width and height of the sheet for which the charts were packed, texels.
    pub layout_size: u32,
    /// Least empty space between charts, texels.
    pub layout_padding: u32,
    /// Number of charts.
    pub layout_charts: u32,
}

/// One level; number 0 is the finest.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LevelRecord {
    /// Triangles.
    pub triangles: u32,
    /// Vertices: elements of each array.
    pub vertices: u32,
    /// Distance to the source surface, object units.
    pub error: f32,
    /// [`crate::ErrorKind`].
    pub error_kind: u32,
    /// Least corner of the box over all vertices, object units; zeros without vertices.
    pub bounds_min: [f32; 3],
    /// Greatest corner.
    pub bounds_max: [f32; 3],
    /// Section number of the vertex arrays.
    pub vertex_section: u32,
    /// Section number of the indices.
    pub index_section: u32,
    /// Bytes of an index: 2 or 4.
    pub index_width: u32,
    /// First of its array records.
    pub first_array: u32,
    /// Number of its array records.
    pub array_count: u32,
    /// First of its needed sections.
    pub first_need: u32,
    /// Number of its needed sections.
    pub need_count: u32,
    /// Sheets of the UV layout if more than one (side by side in u), else 0; the same at every level. Since 1.1.
    pub layout_sheets: u32,
    /// Zero.
    pub reserved: [u32; 6],
}

/// One array of a level's vertex section.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct ArrayRecord {
    /// [`crate::Semantic`].
    pub semantic: u32,
    /// [`crate::VertexFormat`].
    pub format: u32,
    /// From the start of the raw section, bytes; a multiple of 256.
    pub offset: u64,
    /// Bytes: vertices times element size.
    pub length: u64,
    /// Zero.
    pub reserved: [u32; 2],
}

/// Start of the submesh table; behind it `submesh_count` [`SubmeshRecord`]s, then `level_count * submesh_count`
/// [`DrawRange`]s, level by level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct SubmeshHeader {
    /// Submeshes.
    pub submesh_count: u32,
    /// Levels, as in the level table.
    pub level_count: u32,
    /// Zero.
    pub reserved: [u32; 2],
}

/// One submesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct SubmeshRecord {
    /// String.
    pub name: u32,
    /// Material, or [`NONE`] for glTF's default material.
    pub material: u32,
    /// Attributes that its source had: bit `n` is [`crate::Semantic`] number `n` (bit 7 and 8 together).
    pub attributes: u32,
    /// Triangles it had in the source asset.
    pub source_triangles: u32,
    /// Zero.
    pub reserved: [u32; 4],
}

/// What to draw for one submesh at one level.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct DrawRange {
    /// First index, counted in indices.
    pub first_index: u32,
    /// Number of indices, a multiple of 3; 0 where nothing of the submesh is left.
    pub index_count: u32,
    /// Least index value in the range.
    pub first_vertex: u32,
    /// Greatest index value minus the least plus one; 0 for an empty range.
    pub vertex_count: u32,
    /// Least corner of the box over the vertices in use, object units; zeros for an empty range.
    pub bounds_min: [f32; 3],
    /// Greatest corner.
    pub bounds_max: [f32; 3],
    /// Zero.
    pub reserved: [u32; 2],
}

/// Start of the material table and of the string table: a count; `texture_count` and `mip_count` for the texture table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct CountHeader {
    /// Records.
    pub count: u32,
    /// Records of the second kind (mips in the texture table), else zero.
    pub second_count: u32,
    /// Zero.
    pub reserved: [u32; 2],
}

/// One use of a texture by a material.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SlotRecord {
    /// Texture, or [`NONE`]: then the rest of the slot is zero.
    pub texture: u32,
    /// UV set: 0 or 1.
    pub uv_set: u32,
    /// 0 repeat, 1 mirrored repeat, 2 clamp to edge.
    pub wrap_u: u8,
    /// As `wrap_u`.
    pub wrap_v: u8,
    /// Magnification: 0 nearest, 1 linear.
    pub mag: u8,
    /// Minification inside one mip: 0 nearest, 1 linear.
    pub min: u8,
    /// Between mips: 0 mip 0 only, 1 nearest mip, 2 linear.
    pub mip: u8,
    /// Zero.
    pub reserved0: [u8; 3],
    /// Added to the UV after scale and rotation.
    pub uv_offset: [f32; 2],
    /// Factor on the UV.
    pub uv_scale: [f32; 2],
    /// Rotation of the UV, radians, counter-clockwise, as in `KHR_texture_transform`.
    pub uv_rotation: f32,
    /// Zero.
    pub reserved1: [u32; 3],
}

/// One material.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct MaterialRecord {
    /// String.
    pub name: u32,
    /// 0 opaque, 1 mask, 2 blend.
    pub alpha_mode: u32,
    /// Cutoff of mode mask.
    pub alpha_cutoff: f32,
    /// Bit 0: double-sided.
    pub flags: u32,
    /// Linear RGBA.
    pub base_color_factor: [f32; 4],
    /// Linear RGB.
    pub emissive_factor: [f32; 3],
    /// Factor on metalness.
    pub metallic_factor: f32,
    /// Factor on roughness.
    pub roughness_factor: f32,
    /// Factor on x and y of the normal map.
    pub normal_scale: f32,
    /// Strength of the occlusion.
    pub occlusion_strength: f32,
    /// Zero.
    pub reserved: u32,
    /// By [`crate::Role`] number.
    pub slots: [SlotRecord; 5],
}

/// One texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TextureRecord {
    /// String.
    pub name: u32,
    /// [`crate::TextureFormat`].
    pub format: u32,
    /// Set of [`crate::Role`]s in which materials use it, bit `n` being role `n`; or the one [`crate::Extra`] that it holds.
    pub roles: u32,
    /// [`crate::Channel`] of R, G, B, A.
    pub channels: [u8; 4],
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Mips, at least one; mip 0 is the picture itself.
    pub mip_count: u32,
    /// First of its mip records.
    pub first_mip: u32,
    /// First mip that lies in the tail; those before have a section each.
    pub tail_first: u32,
    /// Section number of the tail.
    pub tail_section: u32,
    /// Sheet of an extra picture, else 0. Since version 2 of the table.
    pub sheet: u32,
    /// Zero.
    pub reserved: [u32; 5],
}

/// One mip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct MipRecord {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Section number.
    pub section: u32,
    /// Zero.
    pub reserved: u32,
    /// From the start of the raw section, bytes; a multiple of 256.
    pub offset: u64,
    /// Bytes: [`crate::TextureFormat::mip_length`]; rows of texels or blocks follow each other without gap, top row first.
    pub length: u64,
}

/// Start of the provenance section; behind it strings and hashes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct ProvenanceHeader {
    /// BLAKE3 of the pipeline that made the file.
    pub pipeline: [u8; 32],
    /// Inputs.
    pub input_count: u32,
    /// Stages.
    pub stage_count: u32,
    /// Zero.
    pub reserved: [u32; 6],
}

const _: () = {
    assert!(size_of::<Header>() == HEADER_SIZE);
    assert!(size_of::<SectionEntry>() == ENTRY_SIZE);
    assert!(size_of::<LevelHeader>() == 32);
    assert!(size_of::<LevelRecord>() == 96);
    assert!(size_of::<ArrayRecord>() == 32);
    assert!(size_of::<SubmeshRecord>() == 32);
    assert!(size_of::<DrawRange>() == 48);
    assert!(size_of::<SlotRecord>() == 48);
    assert!(size_of::<MaterialRecord>() == 304);
    assert!(size_of::<TextureRecord>() == 64);
    assert!(size_of::<MipRecord>() == 32);
    assert!(size_of::<ProvenanceHeader>() == 64);
};
