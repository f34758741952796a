//! Containers: the checked reader and what engines do with an accepted file.

use kiln_format::record::{ENTRY_SIZE, HEADER_SIZE, Header, MAGIC, SectionEntry};
use kiln_format::write::seal;
use kiln_format::{AlignedBytes, Container, Role, check};
use kiln_runtime::{Lods, View};

/// The bytes as they are, and with right hashes, so that a changed byte reaches the checks behind them.
pub fn container(bytes: &[u8]) {
    attempt(bytes);
    if let Some(right) = rehashed(bytes) {
        attempt(&right);
    }
}

fn attempt(bytes: &[u8]) {
    let bytes = AlignedBytes::copy_of(bytes);
    let report = check(&bytes);
    let whole = Lods::open(&bytes);
    if let Ok(lods) = Lods::open_tables(&bytes) {
        // Nobody looked at the payload: what is lent may be wrong, but it ends where it says.
        unchecked(&lods);
        assert_eq!(lods.validate().is_ok(), whole.is_ok(), "open_tables and validate differ from open");
    } else {
        assert!(whole.is_err(), "open_tables refuses what open reads");
    }
    assert_eq!(report.is_sound(), whole.is_ok(), "check and open differ: {:?}", report.findings.first());
    if let Ok(lods) = &whole {
        for lod in 0..lods.level_count() {
            assert!(lods.level(lod).is_some(), "level {lod} of a whole file is not offered");
        }
    }
    for lods in [whole, Lods::open_prefix(&bytes), Lods::open_prefix(&bytes[..bytes.len() / 2])].iter().flatten() {
        look(lods);
    }
}

/// Everything that a container lends, without trust in what it says.
fn unchecked(lods: &Lods<'_>) {
    for level in (0..lods.level_count()).filter_map(|lod| lods.level(lod)) {
        let _ = level.indices().iter().map(u64::from).sum::<u64>();
        let _ = level.positions().iter().flatten().sum::<f32>();
    }
    for texture in 0..lods.texture_count() {
        let _ = lods.finest_mip(texture).map(|(_, mip)| mip.texels.iter().map(|byte| *byte as u64).sum::<u64>());
    }
    let layouts = lods.layouts();
    let _ = layouts.window.map(|w| (w.parents.iter().max(), w.starts.iter().max(), w.checkpoints.len()));
    let _ = layouts.tree_leaf.map(|t| (t.tree.len(), t.leaf.len(), t.row_starts.len(), t.face_counts.iter().max()));
    let _ = layouts.compact_tree.map(|t| (t.nodes.len(), t.terminals.iter().max()));
    let _ =
        layouts.clusters.map(|c| (c.clusters.len(), c.groups.len(), c.references.iter().max(), c.corners.iter().max()));
    lods.decode(2);
    for section in lods.container().sections() {
        let raw = lods.container().raw_bytes(section.number);
        assert!(raw.is_none_or(|raw| raw.len() as u64 == section.entry.raw_length), "another length than the entry's");
    }
}

/// What a validated container promises about layouts: with these, drawing code needs no checks of its own.
fn layouts(lods: &Lods<'_>) {
    let (Some(level), layouts) = (lods.level(0), lods.layouts()) else { return };
    let vertices = level.positions().len();
    if let Some(window) = layouts.window {
        assert!(window.parents.len() == vertices && window.checkpoints.first().is_some_and(|c| c.detail == 0));
        for (v, parent) in window.parents.iter().enumerate() {
            assert!((*parent as usize) < v || (v < window.header.base_vertices as usize && *parent as usize == v));
        }
    }
    if let Some(tree) = layouts.tree_leaf {
        assert!(tree.leaf.iter().all(|leaf| (leaf[3] as usize) < tree.tree.len()));
        assert!(tree.face_counts.is_sorted() && tree.row_starts.is_sorted());
    }
    if let Some(tree) = layouts.compact_tree {
        let parents = tree.nodes.iter().enumerate();
        assert!(parents.skip(1).all(|(n, node)| (node.parent as usize) < n));
        assert!(tree.terminals.len() == vertices && tree.terminals.iter().all(|n| (*n as usize) < tree.nodes.len()));
    }
    if let Some(dag) = layouts.clusters {
        for cluster in dag.clusters {
            let first = cluster.first_reference as usize;
            let own = dag.references.get(first..first + cluster.vertex_count as usize);
            assert!(own.is_some_and(|own| own.iter().all(|v| (*v as usize) < vertices)));
            let first = cluster.first_triangle as usize * 3;
            let corners = dag.corners.get(first..first + cluster.triangle_count as usize * 3);
            assert!(corners.is_some_and(|own| own.iter().all(|corner| (*corner as u32) < cluster.vertex_count)));
            assert!((cluster.group as usize) < dag.groups.len() && (cluster.submesh as usize) < lods.submesh_count());
        }
    }
}

/// Everything that a container lends.
fn look(lods: &Lods<'_>) {
    for lod in 0..lods.level_count() {
        let Some(level) = lods.level(lod) else { continue };
        assert!(level.positions().iter().flatten().all(|x| x.is_finite()));
        for range in level.ranges {
            for i in range.first_index..range.first_index + range.index_count {
                let vertex = level.indices().get(i as usize);
                assert!(vertex.is_some_and(|v| (v as usize) < level.positions().len()), "index {i} of level {lod}");
            }
        }
    }
    layouts(lods);
    let view = View { distance: 12.0, vertical_fov_radians: 0.9, viewport_height_px: 1080.0 };
    let chosen = lods.choose_level(&view, 1.0);
    assert!(chosen < lods.level_count().max(1));
    assert!(lods.choose_by_error(0.1) < lods.level_count() && lods.choose_by_triangles(100) < lods.level_count());
    for submesh in (0..lods.submesh_count()).filter_map(|number| lods.submesh(number)) {
        assert!(submesh.material.is_none_or(|material| material < lods.material_count()));
    }
    for material in (0..lods.material_count()).filter_map(|number| lods.material(number)) {
        let _ = material.texture(Role::BaseColor);
    }
    for texture in 0..lods.texture_count() {
        let _ = lods.texture(texture);
        if let Some((_, mip)) = lods.finest_mip(texture) {
            assert!(!mip.texels.is_empty());
        }
    }
    let _ = lods.container().provenance();
}

/// The bytes with the hashes that their header and sections should have; `None` where no table can be found.
fn rehashed(bytes: &[u8]) -> Option<Vec<u8>> {
    let header: Header = bytemuck::pod_read_unaligned(bytes.get(..HEADER_SIZE)?);
    let table = (header.section_count as usize).checked_mul(ENTRY_SIZE)?;
    let end = HEADER_SIZE.checked_add(table).filter(|end| *end <= bytes.len() && header.magic == MAGIC)?;
    let mut right = bytes.to_vec();
    for at in (HEADER_SIZE..end).step_by(ENTRY_SIZE) {
        let mut entry: SectionEntry = bytemuck::pod_read_unaligned(&bytes[at..at + ENTRY_SIZE]);
        let start = usize::try_from(entry.offset).ok();
        let range = start.and_then(|start| Some(start..start.checked_add(usize::try_from(entry.stored_length).ok()?)?));
        // A section over the table would change what is hashed here.
        if let Some(stored) = range.filter(|range| range.start >= end).and_then(|range| bytes.get(range)) {
            let same = entry.raw_hash == entry.stored_hash;
            entry.stored_hash = *blake3::hash(stored).as_bytes();
            entry.raw_hash = if same { entry.stored_hash } else { entry.raw_hash };
            right[at..at + ENTRY_SIZE].copy_from_slice(bytemuck::bytes_of(&entry));
        }
    }
    seal(&mut right);
    raw_hashes(&mut right);
    (right != bytes).then_some(right)
}

/// Those of coded sections, where they decode.
fn raw_hashes(right: &mut [u8]) {
    let aligned = AlignedBytes::copy_of(right);
    let Ok(container) = Container::open_tables(&aligned) else { return };
    for section in container.sections().filter(|section| section.entry.codec != 0) {
        let Some(raw) = container.raw_bytes(section.number) else { continue };
        let entry = SectionEntry { raw_hash: *blake3::hash(raw).as_bytes(), ..*section.entry };
        let at = HEADER_SIZE + section.number as usize * ENTRY_SIZE;
        right[at..at + ENTRY_SIZE].copy_from_slice(bytemuck::bytes_of(&entry));
    }
    seal(right);
}
