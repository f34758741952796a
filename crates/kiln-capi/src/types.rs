//! What C sees: plain structs of numbers and of pointers that live as long as their handle.

use kiln_format::layout::{Checkpoint, ClusterRecord, CompactNode, GroupRecord};

/// What a function came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub enum Status {
    /// Done.
    Ok = 0,
    /// A pointer that is needed is NULL.
    Null = 1,
    /// A number is not below its count, or what was asked for is not in this container.
    None = 2,
    /// The bytes are no sound container; the error's message starts with the code of the failed check, such as `K109`.
    Invalid = 3,
    /// The file cannot be read.
    Io = 4,
    /// A defect of this library; the handle may be closed.
    Internal = 5,
}

/// What went wrong: filled in by functions that open, where the caller passes one.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Error {
    /// As returned.
    pub status: Status,
    /// UTF-8, ended by a zero, cut where it is longer.
    pub message: [std::ffi::c_char; 508],
}

/// UTF-8 without a terminator; `data` is never NULL after a function that came to `KILN_STATUS_OK`.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Str {
    /// First byte.
    pub data: *const u8,
    /// Bytes.
    pub length: usize,
}

/// Bytes.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Bytes {
    /// First byte; NULL where the section is not at hand.
    pub data: *const u8,
    /// Number of bytes.
    pub length: usize,
}

/// Counts and facts that hold for the whole container.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub struct Info {
    /// Bytes of the file.
    pub file_length: u64,
    /// Major version.
    pub major: u32,
    /// Minor version.
    pub minor: u32,
    /// Triangles of the source asset.
    pub source_triangles: u32,
    /// Sheets of the UV layout, 0 without one.
    pub sheets: u32,
    /// Sections.
    pub sections: u32,
    /// Levels, at least one.
    pub levels: u32,
    /// Submeshes; every level has one draw range for each.
    pub submeshes: u32,
    /// Materials.
    pub materials: u32,
    /// Textures.
    pub textures: u32,
    /// 1 if the container says what made it.
    pub has_provenance: u32,
}

/// One section of the file.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Section {
    /// Four letters and a zero.
    pub kind: [std::ffi::c_char; 5],
    /// 1 if readers that do not know it must refuse the file.
    pub required: u8,
    /// Version of its layout.
    pub version: u16,
    /// Codec number, 0 for none.
    pub codec: u32,
    /// Its name; empty where the number is not registered.
    pub codec_name: Str,
    /// Bytes.
    pub alignment: u32,
    /// From the start of the file, bytes.
    pub offset: u64,
    /// Bytes in the file.
    pub stored_length: u64,
    /// Bytes after decoding.
    pub raw_length: u64,
    /// BLAKE3 of the decoded bytes.
    pub raw_hash: [u8; 32],
}

/// What to draw of one submesh at one level.
#[derive(Clone, Copy, Debug, PartialEq)]
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
    /// Least corner of the box over the vertices in use, object units.
    pub bounds_min: [f32; 3],
    /// Greatest corner.
    pub bounds_max: [f32; 3],
    /// Zero.
    pub reserved: [u32; 2],
}

/// One level.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Level {
    /// Triangles.
    pub triangles: u32,
    /// Vertices.
    pub vertices: u32,
    /// Distance to the source surface, object units.
    pub error: f32,
    /// 1: greatest over samples; 2: nowhere exceeded.
    pub error_kind: u32,
    /// Least corner of the box over all vertices, object units.
    pub bounds_min: [f32; 3],
    /// Greatest corner.
    pub bounds_max: [f32; 3],
    /// Bytes of an index, 2 or 4.
    pub index_width: u32,
    /// Vertex arrays.
    pub arrays: u32,
    /// `3 * triangles` indices, counter-clockwise front faces; NULL where the level is not at hand.
    pub indices: *const std::ffi::c_void,
    /// `[submeshes]`.
    pub ranges: *const DrawRange,
    /// Bytes of its vertices and indices in the file.
    pub stored_bytes: u64,
    /// Bytes of the file's prefix that has this level and its mip tails.
    pub prefix_bytes: u64,
}

/// One vertex array of a level.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Array {
    /// 1 positions, 2 normals, 3 tangents, 4 uv0, 5 uv1, 6 colors, 7 joints, 8 weights.
    pub semantic: u32,
    /// 1 f32x2, 2 f32x3, 3 f32x4, 4 u16x4.
    pub format: u32,
    /// The semantic's name.
    pub name: Str,
    /// The format's name.
    pub format_name: Str,
    /// Bytes of one element.
    pub stride: u32,
    /// Elements: the level's vertices.
    pub count: u32,
    /// Elements, without gap; NULL where the level is not at hand.
    pub data: *const std::ffi::c_void,
}

/// One submesh.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Submesh {
    /// Name, unique in its asset.
    pub name: Str,
    /// Material number, or `KILN_NONE` for glTF's default material.
    pub material: u32,
    /// Triangles it had in the source asset.
    pub source_triangles: u32,
}

/// A texture in use by a material.
#[derive(Clone, Copy, Default)]
#[repr(C)]
pub struct Slot {
    /// Texture number, or `KILN_NONE`: then the rest is zero.
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
    pub mip: u32,
    /// Added to the UV after scale and rotation.
    pub uv_offset: [f32; 2],
    /// Factor on the UV.
    pub uv_scale: [f32; 2],
    /// Rotation of the UV, radians.
    pub uv_rotation: f32,
}

/// glTF 2.0's metallic-roughness core.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Material {
    /// Name, may be empty or repeated.
    pub name: Str,
    /// 0 opaque, 1 mask, 2 blend.
    pub alpha_mode: u32,
    /// Cutoff of mode mask.
    pub alpha_cutoff: f32,
    /// 1 if back faces are drawn too.
    pub double_sided: u32,
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
    /// Base colour, metallic-roughness, normal, occlusion, emissive.
    pub slots: [Slot; 5],
}

/// One texture.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Texture {
    /// Name, may be empty or repeated.
    pub name: Str,
    /// Format number of the page's table.
    pub format: u32,
    /// Its name.
    pub format_name: Str,
    /// Bit n: used in slot n of materials; or the bit of one extra.
    pub roles: u32,
    /// What an extra picture holds, empty for textures of materials.
    pub extra: Str,
    /// Sheet on which an extra lies.
    pub sheet: u32,
    /// Meaning of R, G, B, A: numbers of the page's table.
    pub channels: [u8; 4],
    /// Their names.
    pub channel_names: [Str; 4],
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Mips, at least one.
    pub mips: u32,
    /// First mip that lies in the tail.
    pub tail_first: u32,
}

/// One mip of a texture.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Mip {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Bytes of its texels or blocks, whether at hand or not.
    pub length: u64,
    /// Top row first, rows without gap.
    pub texels: Bytes,
}

/// What made the file.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Provenance {
    /// BLAKE3 of the pipeline.
    pub pipeline: [u8; 32],
    /// Tool and version.
    pub tool: Str,
    /// Which machines give the same bytes.
    pub numeric_class: Str,
    /// Device class of GPU stages, or empty.
    pub device_class: Str,
    /// Inputs.
    pub inputs: u32,
    /// Stages.
    pub stages: u32,
}

/// An input of the build.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Input {
    /// Relative name.
    pub name: Str,
    /// BLAKE3 of its bytes.
    pub hash: [u8; 32],
}

/// A stage of the build.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Stage {
    /// Id or kind.
    pub name: Str,
    /// Semantic version.
    pub version: Str,
}

/// A view through a perspective camera.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct View {
    /// From the eye to the nearest point of the object's box, object units.
    pub distance: f32,
    /// Full vertical angle of view, radians.
    pub vertical_fov_radians: f32,
    /// Height of the viewport, pixels.
    pub viewport_height_px: f32,
}

/// A sliding window over level 0.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Window {
    /// Level 0's vertices.
    pub vertices: u32,
    /// Level 0's triangles.
    pub triangles: u32,
    /// D: LOD d is 0 to D.
    pub collapses: u32,
    /// Vertices that never go.
    pub base_vertices: u32,
    /// Bytes of its section in the file.
    pub stored_bytes: u64,
    /// Finest first.
    pub checkpoints: *const Checkpoint,
    /// Number of them.
    pub checkpoint_count: usize,
    /// `[vertices]`.
    pub parents: *const u32,
    /// `[ceil(vertices / 32)]`, or NULL: every vertex is a point.
    pub starts: *const u32,
}

/// Tree and leaf buffers over level 0.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct TreeLeaf {
    /// N.
    pub nodes: u32,
    /// Level 0's vertices.
    pub vertices: u32,
    /// R.
    pub rows: u32,
    /// C.
    pub columns: u32,
    /// W, texels.
    pub width: u32,
    /// Number of texels.
    pub texels: u32,
    /// Bytes of its two sections in the file.
    pub stored_bytes: u64,
    /// Finest first.
    pub checkpoints: *const Checkpoint,
    /// Number of them.
    pub checkpoint_count: usize,
    /// `[rows + 1]`.
    pub row_starts: *const u32,
    /// `[nodes + 1]`.
    pub face_counts: *const u32,
    /// `[texels] x 4`: x, y, z, q.
    pub tree: *const f32,
    /// `[vertices] x 4`: x, y, z, number of the terminal node's texel.
    pub leaf: *const f32,
}

/// A compact tree over level 0.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct CompactTree {
    /// N.
    pub node_count: u32,
    /// Level 0's vertices.
    pub vertices: u32,
    /// R.
    pub rows: u32,
    /// Bytes of its section in the file.
    pub stored_bytes: u64,
    /// Finest first.
    pub checkpoints: *const Checkpoint,
    /// Number of them.
    pub checkpoint_count: usize,
    /// `[rows + 1]`.
    pub row_starts: *const u32,
    /// `[node_count + 1]`.
    pub face_counts: *const u32,
    /// `[node_count]`.
    pub nodes: *const CompactNode,
    /// `[vertices]`.
    pub terminals: *const u32,
}

/// A cluster DAG over level 0.
#[derive(Clone, Copy)]
#[repr(C)]
pub struct Clusters {
    /// K.
    pub cluster_count: u32,
    /// G.
    pub group_count: u32,
    /// Levels of the DAG.
    pub levels: u32,
    /// Number of references.
    pub reference_count: u32,
    /// Triangles of all clusters.
    pub triangles: u32,
    /// Level 0's vertices.
    pub vertices: u32,
    /// Bytes of its section in the file.
    pub stored_bytes: u64,
    /// `[cluster_count]`.
    pub clusters: *const ClusterRecord,
    /// `[group_count]`.
    pub groups: *const GroupRecord,
    /// `[reference_count]`: vertices of level 0, cluster by cluster.
    pub references: *const u32,
    /// `[triangles] x 3`: places in the cluster's references.
    pub corners: *const u8,
}

/// An index that names nothing.
pub const NONE: u32 = 0xFFFF_FFFF;

const _: () = {
    use kiln_format::record;
    assert!(NONE == record::NONE);
    assert!(size_of::<DrawRange>() == size_of::<record::DrawRange>());
    assert!(align_of::<DrawRange>() == align_of::<record::DrawRange>());
    assert!(std::mem::offset_of!(DrawRange, bounds_min) == std::mem::offset_of!(record::DrawRange, bounds_min));
    assert!(std::mem::offset_of!(DrawRange, bounds_max) == std::mem::offset_of!(record::DrawRange, bounds_max));
};
