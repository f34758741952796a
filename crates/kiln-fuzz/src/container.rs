//! Containers: the checked reader and what engines do with an accepted file.

use kiln_format::record::{ENTRY_SIZE, HASHED_HEADER, HEADER_SIZE, Header, MAGIC, SectionEntry};
use kiln_format::{AlignedBytes, Role, check};
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
    let view = View { distance: 12.0, vertical_fov_radians: 0.9, viewport_height_px: 1080.0 };
    let chosen = lods.choose_level(&view, 1.0);
    assert!(chosen < lods.level_count().max(1));
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
    let mut hasher = blake3::Hasher::new();
    hasher.update(&right[..HASHED_HEADER]).update(&right[HEADER_SIZE..end]);
    right[HASHED_HEADER..HEADER_SIZE].copy_from_slice(hasher.finalize().as_bytes());
    (right != bytes).then_some(right)
}
