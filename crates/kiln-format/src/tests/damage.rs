//! Every prefix, every flipped byte: found, refused, never a panic.

use super::layered::{layered, lent};
use super::model::tiny;
use crate::prelude::*;
use crate::{AlignedBytes, Code, Container, Kind, Packing, check, write};

#[test]
fn every_prefix_is_refused_and_found() {
    let bytes = AlignedBytes::copy_of(&write(&tiny().content()).expect("valid"));
    for end in 0..bytes.len() {
        assert!(Container::open(&bytes[..end]).is_err(), "prefix of {end} bytes was opened");
        assert!(!check(&bytes[..end]).is_sound(), "prefix of {end} bytes passed the check");
        if let Ok(container) = Container::open_prefix(&bytes[..end]) {
            // Whatever is offered can be read to its end.
            for lod in 0..2 {
                if let Some(view) = container.level(lod) {
                    assert!(view.indices().iter().all(|i| (i as usize) < view.positions().len()));
                }
            }
        }
    }
}

#[test]
fn every_flipped_byte_is_refused_and_found() {
    let mut bytes = AlignedBytes::copy_of(&write(&tiny().content()).expect("valid"));
    let sound = bytes.clone();
    let original = Container::open(&sound).expect("sound");
    for at in 0..bytes.len() {
        for mask in [1u8, 0x80, 0x24, 0xFF] {
            bytes.as_mut_slice()[at] ^= mask;
            assert!(Container::open(&bytes).is_err(), "byte {at} ^ {mask:#x} was opened");
            let report = check(&bytes);
            assert!(!report.is_sound(), "byte {at} ^ {mask:#x} passed the check");
            // A prefix reader may offer the rest, and nothing but what is undamaged.
            if let Ok(container) = Container::open_prefix(&bytes) {
                for lod in 0..2 {
                    let view = container.level(lod);
                    assert!(view.is_none_or(|v| v.positions() == original.level(lod).expect("whole").positions()));
                    assert!(view.is_none_or(|v| v.indices() == original.level(lod).expect("whole").indices()));
                }
                for mip in 0..8 {
                    assert!(container.mip(0, mip).is_none_or(|texels| Some(texels) == original.mip(0, mip)));
                }
            }
            bytes.as_mut_slice()[at] ^= mask;
        }
    }
    assert!(check(&bytes).is_sound());
}

/// Flips a byte and repairs all hashes over it, so that only the meaning is wrong; nothing may panic, and what opens must
/// be as safe as any container.
#[test]
fn every_flipped_byte_under_right_hashes_is_harmless() {
    let sound = write(&tiny().content()).expect("valid");
    let mut opened = 0;
    for at in 0..sound.len() {
        for mask in [1u8, 0x80, 0xFF] {
            let mut bytes = AlignedBytes::copy_of(&sound);
            bytes.as_mut_slice()[at] ^= mask;
            super::rules::rehash(bytes.as_mut_slice());
            check(&bytes);
            let _ = Container::open_prefix(&bytes);
            let Ok(container) = Container::open(&bytes) else { continue };
            opened += 1;
            for lod in 0..container.level_records().len() {
                let view = container.level(lod).expect("a whole file offers every level");
                for range in view.ranges {
                    let (first, count) = (range.first_index as usize, range.index_count as usize);
                    for i in first..first + count {
                        let vertex = view.indices().get(i).expect("in range") as usize;
                        assert!(view.positions()[vertex].iter().all(|x| x.is_finite()));
                    }
                }
            }
            for texture in 0..container.textures().len() {
                for mip in 0..container.mips(texture).len() {
                    assert_eq!(
                        container.mip(texture, mip).map(<[u8]>::len),
                        Some(container.mips(texture)[mip].length as usize)
                    );
                }
            }
        }
    }
    // Texels, UVs, names, factors: what they mean cannot be wrong.
    assert!(opened > 500, "only {opened} flips kept a sound container: the test has lost its object");
}

#[test]
fn a_text_mode_copy_is_told_as_such() {
    let bytes = write(&tiny().content()).expect("valid");
    let text: Vec<u8> = bytes.iter().copied().filter(|b| *b != b'\r').collect();
    let report = check(&text);
    assert_eq!(report.findings[0].code, Code::Magic);
    assert!(report.findings[0].to_string().contains("text-mode"), "{}", report.findings[0]);
}

#[test]
fn bytes_that_are_not_aligned_are_refused_by_open_and_copied_by_check() {
    let bytes = write(&tiny().content()).expect("valid");
    let mut shifted = AlignedBytes::zeroed(bytes.len() + 1);
    shifted.as_mut_slice()[1..].copy_from_slice(&bytes);
    assert_eq!(Container::open(&shifted[1..]).err().map(|e| e.code), Some(Code::Unaligned));
    assert!(check(&shifted[1..]).is_sound());
}

/// Layouts, shared vertices and codecs.
fn newest() -> Vec<AlignedBytes> {
    let model = layered();
    // The layered model's geometry is too small for a codec to be worth it.
    let mut all = vec![model.bytes(Packing::Raw), model.bytes(Packing::Zstd)];
    #[cfg(feature = "codecs")]
    all.push(super::layered::codecs::packed(8, Packing::Meshopt).0);
    all.iter().map(|bytes| AlignedBytes::copy_of(bytes)).collect()
}

#[test]
fn every_prefix_of_the_newest_containers_is_refused_and_what_it_offers_is_right() {
    for bytes in newest() {
        let sound = Container::open(&bytes).expect("sound");
        let all = lent(&sound);
        let tables = sound.sections().find(|s| s.kind == Kind::VERTICES).expect("there").entry.offset as usize;
        for end in (0..bytes.len()).filter(|end| *end > tables || end % 7 == 0) {
            assert!(Container::open(&bytes[..end]).is_err(), "prefix of {end} bytes was opened");
            assert!(Container::open_tables(&bytes[..end]).is_err(), "prefix of {end} bytes was opened");
            if let Ok(container) = Container::open_prefix(&bytes[..end]) {
                assert!(
                    lent(&container).iter().all(|own| all.contains(own)),
                    "prefix of {end} bytes offers something else"
                );
            }
        }
    }
}

#[test]
fn every_flipped_byte_of_the_newest_containers_is_refused_and_found() {
    for mut bytes in newest() {
        for at in 0..bytes.len() {
            let mask = [1, 0x80, 0x24, 0xFF][at % 4];
            bytes.as_mut_slice()[at] ^= mask;
            assert!(Container::open(&bytes).is_err(), "byte {at} ^ {mask:#x} was opened");
            // Nobody looked at the payload: wrong, perhaps, but nothing falls over.
            if let Ok(container) = Container::open_tables(&bytes) {
                lent(&container);
                assert!(container.validate().is_err(), "byte {at} ^ {mask:#x} was found valid");
            }
            bytes.as_mut_slice()[at] ^= mask;
        }
        assert!(check(&bytes).is_sound());
    }
}

#[test]
fn every_flipped_byte_of_the_newest_containers_under_right_hashes_is_harmless() {
    for sound in newest() {
        let mut opened = 0;
        for at in (0..sound.len()).filter(|at| *at >= 96) {
            let mut bytes = sound.clone();
            bytes.as_mut_slice()[at] ^= [1, 0x80, 0xFF][at % 3];
            super::rules::rehash(bytes.as_mut_slice());
            let report = check(&bytes);
            let open = Container::open(&bytes);
            assert_eq!(report.is_sound(), open.is_ok());
            if let Ok(container) = Container::open_prefix(&bytes) {
                lent(&container);
            }
            let Ok(container) = open else { continue };
            opened += 1;
            lent(&container);
            promises(&container);
        }
        assert!(opened > 20, "only {opened} flips kept a sound container: the test has lost its object");
    }
}

/// What drawing code relies on.
fn promises(container: &Container<'_>) {
    let layouts = container.layouts();
    let Some(level) = container.level(0) else { return };
    let vertices = level.positions().len();
    if let Some(window) = layouts.window {
        assert_eq!(window.parents.len(), vertices);
        assert!(window.parents.iter().enumerate().all(|(v, parent)| *parent as usize <= v));
    }
    if let Some(tree) = layouts.tree_leaf {
        assert!(tree.leaf.iter().all(|leaf| (leaf[3] as usize) < tree.tree.len()));
    }
    if let Some(tree) = layouts.compact_tree {
        assert!(tree.terminals.iter().all(|n| (*n as usize) < tree.nodes.len()));
        assert!(tree.nodes.iter().enumerate().all(|(n, node)| n == 0 || (node.parent as usize) < n));
    }
    if let Some(dag) = layouts.clusters {
        for cluster in dag.clusters {
            let first = cluster.first_reference as usize;
            let own = &dag.references[first..first + cluster.vertex_count as usize];
            assert!(own.iter().all(|v| (*v as usize) < vertices));
            let first = cluster.first_triangle as usize * 3;
            let corners = &dag.corners[first..first + cluster.triangle_count as usize * 3];
            assert!(corners.iter().all(|corner| (*corner as usize) < own.len()));
        }
    }
}
