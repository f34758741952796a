//! From the checked container to the structs that C sees; safe code, `None` for numbers out of range.

use kiln_format::kind::CODECS;
use kiln_format::layout::{ClusterView, CompactTreeView, Layouts, TreeLeafView, WindowView};
use kiln_format::record::FLAG_REQUIRED;
use kiln_format::{Channel, Container, Extra, Semantic, TextureFormat, VertexFormat};

use crate::types::*;

impl Str {
    fn of(string: &str) -> Str {
        Str { data: string.as_ptr(), length: string.len() }
    }
}

/// A zero-terminated copy of the first bytes of `text`.
pub(crate) fn c_text<const N: usize>(text: &[u8]) -> [std::ffi::c_char; N] {
    let mut out = [0; N];
    for (slot, byte) in out.iter_mut().take(N - 1).zip(text) {
        *slot = *byte as std::ffi::c_char;
    }
    out
}

pub(crate) fn info(container: &Container<'_>) -> Info {
    let (major, minor) = container.version();
    let sheets = || container.level_records().first().map_or(1, |level| level.layout_sheets.max(1));
    Info {
        file_length: container.file_length(),
        major: major.into(),
        minor: minor.into(),
        source_triangles: container.level_header().source_triangles,
        sheets: if container.level_header().has_layout == 0 { 0 } else { sheets() },
        sections: container.sections().count() as u32,
        levels: container.level_records().len() as u32,
        submeshes: container.submeshes().len() as u32,
        materials: container.materials().len() as u32,
        textures: container.textures().len() as u32,
        has_provenance: container.provenance().is_some().into(),
    }
}

pub(crate) fn section(container: &Container<'_>, number: usize) -> Option<Section> {
    let section = container.sections().nth(number)?;
    let entry = section.entry;
    Some(Section {
        kind: c_text(&entry.kind),
        required: (entry.flags & FLAG_REQUIRED != 0).into(),
        version: entry.version,
        codec: entry.codec,
        codec_name: Str::of(CODECS.iter().find(|row| row.0 == entry.codec).map_or("", |row| row.1)),
        alignment: entry.alignment,
        offset: entry.offset,
        stored_length: entry.stored_length,
        raw_length: entry.raw_length,
        raw_hash: entry.raw_hash,
    })
}

/// Bytes in the file of all sections of these kinds that this reader knows.
fn stored_bytes(container: &Container<'_>, kinds: &[&[u8; 4]]) -> u64 {
    let of_kinds = container.sections().filter(|s| kinds.contains(&&s.kind.0));
    of_kinds.map(|s| s.entry.stored_length).sum()
}

pub(crate) fn level(container: &Container<'_>, lod: usize) -> Option<Level> {
    let record = container.level_records().get(lod)?;
    let view = container.level(lod);
    let entry = |number: u32| container.sections().nth(number as usize).map(|s| s.entry);
    let geometry = [record.vertex_section, record.index_section];
    let ends = container.level_needs(lod).iter().filter_map(|n| entry(*n)).map(|e| e.offset + e.stored_length);
    Some(Level {
        triangles: record.triangles,
        vertices: record.vertices,
        error: record.error,
        error_kind: record.error_kind,
        bounds_min: record.bounds_min,
        bounds_max: record.bounds_max,
        index_width: record.index_width,
        arrays: semantics(container, lod).count() as u32,
        indices: view.map_or(std::ptr::null(), |view| view.indices().bytes().as_ptr().cast()),
        // The structs lie alike (`types` asserts it).
        ranges: container.level_ranges(lod).as_ptr().cast(),
        stored_bytes: geometry.iter().filter_map(|n| entry(*n)).map(|e| e.stored_length).sum(),
        prefix_bytes: ends.max().unwrap_or(0),
    })
}

/// The arrays of a level that are at hand.
fn semantics<'a>(container: &'a Container<'_>, lod: usize) -> impl Iterator<Item = (Semantic, VertexFormat, &'a [u8])> {
    let view = container.level(lod);
    Semantic::ALL.iter().filter_map(move |semantic| {
        let (format, bytes) = view?.array(*semantic)?;
        Some((*semantic, format, bytes))
    })
}

pub(crate) fn array(container: &Container<'_>, lod: usize, number: usize) -> Option<Array> {
    let (semantic, format, bytes) = semantics(container, lod).nth(number)?;
    Some(Array {
        semantic: semantic.number(),
        format: format.number(),
        name: Str::of(semantic.name()),
        format_name: Str::of(format.name()),
        stride: format.size() as u32,
        count: (bytes.len() / format.size()) as u32,
        data: bytes.as_ptr().cast(),
    })
}

pub(crate) fn submesh(container: &Container<'_>, number: usize) -> Option<Submesh> {
    let record = container.submeshes().get(number)?;
    let name = Str::of(container.string(record.name));
    Some(Submesh { name, material: record.material, source_triangles: record.source_triangles })
}

pub(crate) fn material(container: &Container<'_>, number: usize) -> Option<Material> {
    let record = container.materials().get(number)?;
    let slot = |slot: &kiln_format::SlotRecord| Slot {
        texture: slot.texture,
        uv_set: slot.uv_set,
        wrap_u: slot.wrap_u,
        wrap_v: slot.wrap_v,
        mag: slot.mag,
        min: slot.min,
        mip: slot.mip.into(),
        uv_offset: slot.uv_offset,
        uv_scale: slot.uv_scale,
        uv_rotation: slot.uv_rotation,
    };
    Some(Material {
        name: Str::of(container.string(record.name)),
        alpha_mode: record.alpha_mode,
        alpha_cutoff: record.alpha_cutoff,
        double_sided: record.flags & 1,
        base_color_factor: record.base_color_factor,
        emissive_factor: record.emissive_factor,
        metallic_factor: record.metallic_factor,
        roughness_factor: record.roughness_factor,
        normal_scale: record.normal_scale,
        occlusion_strength: record.occlusion_strength,
        slots: std::array::from_fn(|k| slot(&record.slots[k])),
    })
}

pub(crate) fn texture(container: &Container<'_>, number: usize) -> Option<Texture> {
    let record = container.textures().get(number)?;
    let channel = |c: u8| Channel::from_number(c.into()).map_or("unknown", Channel::name);
    let format = TextureFormat::from_number(record.format).map_or("unknown", TextureFormat::name);
    Some(Texture {
        name: Str::of(container.string(record.name)),
        format: record.format,
        format_name: Str::of(format),
        roles: record.roles,
        extra: Str::of(Extra::from_roles(record.roles).map_or("", Extra::name)),
        sheet: record.sheet,
        channels: record.channels,
        channel_names: record.channels.map(|c| Str::of(channel(c))),
        width: record.width,
        height: record.height,
        mips: record.mip_count,
        tail_first: record.tail_first,
    })
}

pub(crate) fn mip(container: &Container<'_>, texture: usize, number: usize) -> Option<Mip> {
    let record = container.mips(texture).get(number)?;
    let texels = match container.mip(texture, number) {
        Some(texels) => Bytes { data: texels.as_ptr(), length: texels.len() },
        None => Bytes { data: std::ptr::null(), length: 0 },
    };
    Some(Mip { width: record.width, height: record.height, length: record.length, texels })
}

pub(crate) fn provenance(container: &Container<'_>) -> Option<Provenance> {
    let provenance = container.provenance()?;
    Some(Provenance {
        pipeline: provenance.pipeline,
        tool: Str::of(&provenance.tool),
        numeric_class: Str::of(&provenance.numeric_class),
        device_class: Str::of(&provenance.device_class),
        inputs: provenance.inputs.len() as u32,
        stages: provenance.stages.len() as u32,
    })
}

pub(crate) fn input(container: &Container<'_>, number: usize) -> Option<Input> {
    let (name, hash) = container.provenance()?.inputs.get(number)?;
    Some(Input { name: Str::of(name), hash: *hash })
}

pub(crate) fn stage(container: &Container<'_>, number: usize) -> Option<Stage> {
    let (name, version) = container.provenance()?.stages.get(number)?;
    Some(Stage { name: Str::of(name), version: Str::of(version) })
}

/// The layouts that the container has.
fn layouts<'a>(container: &'a Container<'_>) -> Layouts<'a> {
    container.layouts()
}

pub(crate) fn window(container: &Container<'_>) -> Option<Window> {
    let WindowView { header, checkpoints, parents, starts } = layouts(container).window?;
    Some(Window {
        vertices: header.vertices,
        triangles: header.triangles,
        collapses: header.collapses,
        base_vertices: header.base_vertices,
        stored_bytes: stored_bytes(container, &[b"WNDW"]),
        checkpoints: checkpoints.as_ptr(),
        checkpoint_count: checkpoints.len(),
        parents: parents.as_ptr(),
        starts: if starts.is_empty() { std::ptr::null() } else { starts.as_ptr() },
    })
}

pub(crate) fn tree_leaf(container: &Container<'_>) -> Option<TreeLeaf> {
    let TreeLeafView { header, checkpoints, row_starts, face_counts, tree, leaf } = layouts(container).tree_leaf?;
    Some(TreeLeaf {
        nodes: header.nodes,
        vertices: header.vertices,
        rows: header.rows,
        columns: header.columns,
        width: header.width,
        texels: tree.len() as u32,
        stored_bytes: stored_bytes(container, &[b"TREE", b"LEAF"]),
        checkpoints: checkpoints.as_ptr(),
        checkpoint_count: checkpoints.len(),
        row_starts: row_starts.as_ptr(),
        face_counts: face_counts.as_ptr(),
        tree: tree.as_ptr().cast(),
        leaf: leaf.as_ptr().cast(),
    })
}

pub(crate) fn compact_tree(container: &Container<'_>) -> Option<CompactTree> {
    let view: CompactTreeView<'_> = layouts(container).compact_tree?;
    Some(CompactTree {
        node_count: view.header.nodes,
        vertices: view.header.vertices,
        rows: view.header.rows,
        stored_bytes: stored_bytes(container, &[b"CTRE"]),
        checkpoints: view.checkpoints.as_ptr(),
        checkpoint_count: view.checkpoints.len(),
        row_starts: view.row_starts.as_ptr(),
        face_counts: view.face_counts.as_ptr(),
        nodes: view.nodes.as_ptr(),
        terminals: view.terminals.as_ptr(),
    })
}

pub(crate) fn clusters(container: &Container<'_>) -> Option<Clusters> {
    let ClusterView { header, clusters, groups, references, corners } = layouts(container).clusters?;
    Some(Clusters {
        cluster_count: header.clusters,
        group_count: header.groups,
        levels: header.levels,
        reference_count: header.references,
        triangles: header.triangles,
        vertices: header.vertices,
        stored_bytes: stored_bytes(container, &[b"CLUS"]),
        clusters: clusters.as_ptr(),
        groups: groups.as_ptr(),
        references: references.as_ptr(),
        corners: corners.as_ptr(),
    })
}
