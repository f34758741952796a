//! What is in a container, as a value that serialises: `kiln inspect` prints it.

use kiln_format::kind::codec_name;
use kiln_format::layout::Checkpoint;
use kiln_format::record::{FLAG_REQUIRED, NONE};
use kiln_format::{
    AlignedBytes, Channel, Container, ErrorKind, Extra, Kind, Role, Semantic, TextureFormat, VertexFormat,
};
use serde::Serialize;

use crate::PackError;

/// Everything but the payload.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectReport {
    /// `major.minor`.
    pub version: String,
    /// Bytes of the file.
    pub file_length: u64,
    /// Triangles of the source asset.
    pub source_triangles: u32,
    /// Sheets of the UV layout, 0 without one.
    pub sheets: u32,
    /// In file order.
    pub sections: Vec<InspectSection>,
    /// Finest first.
    pub levels: Vec<InspectLevel>,
    /// Layouts beside the levels.
    pub layouts: Vec<InspectLayout>,
    /// By number.
    pub submeshes: Vec<InspectSubmesh>,
    /// By number.
    pub materials: Vec<InspectMaterial>,
    /// By number.
    pub textures: Vec<InspectTexture>,
    /// What made the file.
    pub provenance: Option<InspectProvenance>,
}

/// One section.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectSection {
    /// Number.
    pub number: u32,
    /// Kind.
    pub kind: String,
    /// Version.
    pub version: u16,
    /// Whether readers that do not know it must refuse the file.
    pub required: bool,
    /// Codec.
    pub codec: String,
    /// Alignment, bytes.
    pub alignment: u32,
    /// Offset, bytes.
    pub offset: u64,
    /// Bytes in the file.
    pub stored_length: u64,
    /// Bytes after decoding.
    pub raw_length: u64,
    /// BLAKE3 of the decoded bytes.
    pub raw_hash: String,
}

/// One level.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectLevel {
    /// 0 is the finest.
    pub lod: usize,
    /// Triangles.
    pub triangles: u32,
    /// Vertices.
    pub vertices: u32,
    /// Distance to the source surface, object units (metres in glTF).
    pub error: f32,
    /// `sampled` or `bound`.
    pub error_kind: &'static str,
    /// Bytes of vertices and indices.
    pub bytes: u64,
    /// Those bytes over triangles; `None` for an empty level.
    pub bytes_per_triangle: Option<f64>,
    /// Bytes of the file's prefix that has this level and its mip tails.
    pub prefix_bytes: u64,
    /// Bytes of an index.
    pub index_width: u32,
    /// Arrays with their formats: `positions f32x3`.
    pub arrays: Vec<String>,
    /// Least corner of the box, object units.
    pub bounds_min: [f32; 3],
    /// Greatest corner.
    pub bounds_max: [f32; 3],
    /// `[submesh_count]`, triangles of each submesh.
    pub submesh_triangles: Vec<u32>,
}

/// One layout beside the levels.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectLayout {
    /// `sliding-window`, `tree-leaf`, `compact-tree` or `clusters`.
    pub name: &'static str,
    /// Bytes of its sections in the file.
    pub bytes: u64,
    /// Collapses of a window, nodes of a tree, clusters of a DAG.
    pub details: u32,
    /// Triangles of the finest detail; all clusters' of a DAG.
    pub triangles: u32,
    /// Finest first; a DAG has none.
    pub checkpoints: Vec<InspectCheckpoint>,
}

/// A place on a layout's scale of detail whose error is known.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectCheckpoint {
    /// Collapses of a window, threshold of a tree.
    pub detail: u32,
    /// Vertices of a window, different picks of a tree.
    pub vertices: u32,
    /// Triangles.
    pub triangles: u32,
    /// Distance to the source surface, object units.
    pub error: f32,
    /// The level that it equals.
    pub level: Option<u32>,
}

/// One submesh.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectSubmesh {
    /// Name.
    pub name: String,
    /// Material number.
    pub material: Option<u32>,
    /// Triangles it had in the source asset.
    pub source_triangles: u32,
}

/// One material.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectMaterial {
    /// Name.
    pub name: String,
    /// `opaque`, `mask` or `blend`.
    pub alpha_mode: &'static str,
    /// Whether back faces are drawn.
    pub double_sided: bool,
    /// Role and texture number of each slot in use.
    pub textures: Vec<(&'static str, u32)>,
}

/// One texture.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectTexture {
    /// Name.
    pub name: String,
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Format.
    pub format: &'static str,
    /// Roles in which materials use it.
    pub roles: Vec<&'static str>,
    /// What it holds if it is an extra picture that no material uses.
    pub extra: Option<&'static str>,
    /// The sheet on which an extra lies.
    pub sheet: u32,
    /// Meaning of R, G, B, A.
    pub channels: [&'static str; 4],
    /// Mips.
    pub mips: u32,
    /// Bytes of all mips.
    pub bytes: u64,
    /// Bytes of the mips in the tail.
    pub tail_bytes: u64,
}

/// What made the file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct InspectProvenance {
    /// BLAKE3 of the pipeline.
    pub pipeline: String,
    /// Tool and version.
    pub tool: String,
    /// Which machines give the same bytes.
    pub numeric_class: String,
    /// Device class of GPU stages, or empty.
    pub device_class: String,
    /// Relative name and BLAKE3.
    pub inputs: Vec<(String, String)>,
    /// Stage and semantic version.
    pub stages: Vec<(String, String)>,
}

/// What is in the container `bytes`.
///
/// # Errors
/// Bytes that are no sound container: the first finding. `kiln_format::check` lists all.
pub fn inspect(bytes: &[u8]) -> Result<InspectReport, PackError> {
    let aligned = AlignedBytes::copy_of(bytes);
    let container = Container::open(&aligned)?;
    let (major, minor) = container.version();
    Ok(InspectReport {
        version: format!("{major}.{minor}"),
        file_length: bytes.len() as u64,
        source_triangles: container.level_header().source_triangles,
        sheets: match container.level_header().has_layout {
            0 => 0,
            _ => container.level_records().first().map_or(1, |level| level.layout_sheets.max(1)),
        },
        sections: sections(&container),
        levels: (0..container.level_records().len()).map(|lod| level(&container, lod)).collect(),
        layouts: layouts(&container),
        submeshes: submeshes(&container),
        materials: materials(&container),
        textures: (0..container.textures().len()).map(|number| texture(&container, number)).collect(),
        provenance: container.provenance().map(|p| InspectProvenance {
            pipeline: hex(&p.pipeline),
            tool: p.tool.clone(),
            numeric_class: p.numeric_class.clone(),
            device_class: p.device_class.clone(),
            inputs: p.inputs.iter().map(|(name, hash)| (name.clone(), hex(hash))).collect(),
            stages: p.stages.clone(),
        }),
    })
}

fn hex(hash: &[u8; 32]) -> String {
    blake3::Hash::from_bytes(*hash).to_hex().to_string()
}

fn sections(container: &Container<'_>) -> Vec<InspectSection> {
    let section = |s: kiln_format::Section<'_>| InspectSection {
        number: s.number,
        kind: s.kind.to_string(),
        version: s.entry.version,
        required: s.entry.flags & FLAG_REQUIRED != 0,
        codec: codec_name(s.entry.codec),
        alignment: s.entry.alignment,
        offset: s.entry.offset,
        stored_length: s.entry.stored_length,
        raw_length: s.entry.raw_length,
        raw_hash: hex(&s.entry.raw_hash),
    };
    container.sections().map(section).collect()
}

fn level(container: &Container<'_>, lod: usize) -> InspectLevel {
    let record = &container.level_records()[lod];
    let entries: Vec<_> = container.sections().map(|s| *s.entry).collect();
    let bytes: u64 =
        [record.vertex_section, record.index_section].iter().map(|s| entries[*s as usize].stored_length).sum();
    let ends = container.level_needs(lod).iter().map(|s| &entries[*s as usize]).map(|e| e.offset + e.stored_length);
    let name = |semantic: &Semantic| {
        let (format, _): (VertexFormat, _) = container.level(lod)?.array(*semantic)?;
        Some(format!("{} {}", semantic.name(), format.name()))
    };
    InspectLevel {
        lod,
        triangles: record.triangles,
        vertices: record.vertices,
        error: record.error,
        error_kind: ErrorKind::from_number(record.error_kind).map_or("unknown", ErrorKind::name),
        bytes,
        bytes_per_triangle: (record.triangles > 0).then(|| bytes as f64 / record.triangles as f64),
        prefix_bytes: ends.max().unwrap_or(0),
        index_width: record.index_width,
        arrays: Semantic::ALL.iter().filter_map(name).collect(),
        bounds_min: record.bounds_min,
        bounds_max: record.bounds_max,
        submesh_triangles: container.level_ranges(lod).iter().map(|range| range.index_count / 3).collect(),
    }
}

/// What each layout's header and checkpoints say.
pub(crate) fn layouts(container: &Container<'_>) -> Vec<InspectLayout> {
    let found = container.layouts();
    let bytes = |kinds: &[Kind]| {
        let sections = container.sections().filter(|s| kinds.contains(&s.kind));
        sections.map(|s| s.entry.stored_length).sum()
    };
    let list = |checkpoints: &[Checkpoint]| {
        let of = |c: &Checkpoint| InspectCheckpoint {
            detail: c.detail,
            vertices: c.vertices,
            triangles: c.triangles,
            error: c.error,
            level: (c.level != NONE).then_some(c.level),
        };
        checkpoints.iter().map(of).collect()
    };
    let layout = |name, kinds: &[Kind], details, triangles, checkpoints: &[Checkpoint]| InspectLayout {
        name,
        bytes: bytes(kinds),
        details,
        triangles,
        checkpoints: list(checkpoints),
    };
    let mut out = Vec::new();
    if let Some(v) = found.window {
        out.push(layout("sliding-window", &[Kind::WINDOW], v.header.collapses, v.header.triangles, v.checkpoints));
    }
    if let Some(v) = found.tree_leaf {
        let triangles = v.face_counts.last().copied().unwrap_or(0);
        out.push(layout("tree-leaf", &[Kind::TREE, Kind::LEAF], v.header.nodes, triangles, v.checkpoints));
    }
    if let Some(v) = found.compact_tree {
        let triangles = v.face_counts.last().copied().unwrap_or(0);
        out.push(layout("compact-tree", &[Kind::COMPACT_TREE], v.header.nodes, triangles, v.checkpoints));
    }
    if let Some(v) = found.clusters {
        out.push(layout("clusters", &[Kind::CLUSTERS], v.header.clusters, v.header.triangles, &[]));
    }
    out
}

fn submeshes(container: &Container<'_>) -> Vec<InspectSubmesh> {
    let submesh = |record: &kiln_format::SubmeshRecord| InspectSubmesh {
        name: container.string(record.name).to_string(),
        material: (record.material != NONE).then_some(record.material),
        source_triangles: record.source_triangles,
    };
    container.submeshes().iter().map(submesh).collect()
}

fn materials(container: &Container<'_>) -> Vec<InspectMaterial> {
    let material = |record: &kiln_format::MaterialRecord| InspectMaterial {
        name: container.string(record.name).to_string(),
        alpha_mode: ["opaque", "mask", "blend"][record.alpha_mode.min(2) as usize],
        double_sided: record.flags & 1 == 1,
        textures: Role::ALL
            .iter()
            .zip(&record.slots)
            .filter(|(_, slot)| slot.texture != NONE)
            .map(|(role, slot)| (role.name(), slot.texture))
            .collect(),
    };
    container.materials().iter().map(material).collect()
}

fn texture(container: &Container<'_>, number: usize) -> InspectTexture {
    let record = &container.textures()[number];
    let mips = container.mips(number);
    InspectTexture {
        name: container.string(record.name).to_string(),
        width: record.width,
        height: record.height,
        format: TextureFormat::from_number(record.format).map_or("unknown", TextureFormat::name),
        roles: Role::ALL.iter().filter(|role| record.roles >> role.number() & 1 == 1).map(|role| role.name()).collect(),
        extra: Extra::from_roles(record.roles).map(Extra::name),
        sheet: record.sheet,
        channels: record.channels.map(|c| Channel::from_number(c as u32).map_or("unknown", Channel::name)),
        mips: record.mip_count,
        bytes: mips.iter().map(|mip| mip.length).sum(),
        tail_bytes: mips[record.tail_first as usize..].iter().map(|mip| mip.length).sum(),
    }
}
