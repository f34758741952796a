//! Damage, versions and canonical bytes on containers small enough to try everything.

use crate::prelude::*;
mod damage;
mod layered;
mod model;
mod rules;
mod specification;
mod wide;

use crate::{Container, Content, check, write};
use model::{Model, tiny};

#[test]
fn the_bytes_of_a_tiny_container_are_what_they_were() {
    let bytes = write(&tiny().content()).expect("valid");
    assert_eq!(bytes.len(), 7172, "the layout changed: raise the version or undo");
    let hash = blake3::hash(&bytes).to_hex();
    assert_eq!(hash.as_str(), GOLDEN, "the bytes changed: raise the version or undo");
}

/// BLAKE3 of the tiny model's container, version 1.0.
const GOLDEN: &str = "55e1dac2521cf7281f6ae8eb0e133808a8fdfbb240eb30679f8ed483aabf4f3c";

#[test]
fn what_was_written_is_lent() {
    let model = tiny();
    let content = model.content();
    let bytes = crate::AlignedBytes::copy_of(&write(&content).expect("valid"));
    assert!(check(&bytes).is_sound());
    let container = Container::open(&bytes).expect("sound");
    assert_eq!(container.version(), (1, 0));
    assert_eq!(container.file_length(), bytes.len() as u64);
    for (lod, level) in model.levels.iter().enumerate() {
        let view = container.level(lod).expect("at hand");
        assert_eq!(view.positions(), &level.positions[..]);
        assert_eq!(view.uv0().expect("has UVs"), &level.uv0[..]);
        assert!(view.normals().is_none());
        assert_eq!(view.indices().iter().collect::<Vec<_>>(), level.indices);
        assert_eq!(view.record.error, level.error);
        // Every array on a multiple of 256 of the file, hence of a mapping.
        assert_eq!(view.positions().as_ptr() as usize % 256, 0);
        assert_eq!(view.uv0().expect("has UVs").as_ptr() as usize % 256, 0);
    }
    for (k, mip) in content.textures[0].mips.iter().enumerate() {
        assert_eq!(container.mip(0, k).expect("at hand"), &**mip);
    }
    assert_eq!(container.string(container.submeshes()[1].name), "lid");
    assert_eq!(container.provenance(), content.provenance.as_ref());
}

#[test]
fn two_runs_give_the_same_bytes() {
    let first = write(&tiny().content()).expect("valid");
    assert_eq!(first, write(&tiny().content()).expect("valid"));
}

#[test]
fn names_are_stored_in_normal_form_and_once() {
    let mut model = tiny();
    // e + combining acute; the submesh and the material share the name.
    model.names = ["caf\u{65}\u{301}".into(), "caf\u{e9}".into()];
    let bytes = crate::AlignedBytes::copy_of(&write(&model.content()).expect("valid"));
    let container = Container::open(&bytes).expect("sound");
    assert_eq!(container.submeshes()[0].name, container.submeshes()[1].name);
    assert_eq!(container.string(container.submeshes()[0].name), "caf\u{e9}");
}

#[test]
fn a_prefix_offers_coarse_levels_before_fine_ones() {
    let bytes = crate::AlignedBytes::copy_of(&write(&tiny().content()).expect("valid"));
    let whole = Container::open(&bytes).expect("sound");
    let end_of = |lod: usize| {
        let needs = whole.level_needs(lod);
        let ends =
            whole.sections().filter(|s| needs.contains(&s.number)).map(|s| s.entry.offset + s.entry.stored_length);
        ends.max().expect("needs sections") as usize
    };
    let (coarse, fine) = (end_of(1), end_of(0));
    assert!(coarse < fine && fine < bytes.len(), "{coarse} {fine} {}", bytes.len());
    for (length, offered) in [(coarse - 1, [false, false]), (coarse, [false, true]), (fine, [true, true])] {
        let prefix = crate::AlignedBytes::copy_of(&bytes[..length]);
        let container = Container::open_prefix(&prefix).expect("tables are whole");
        assert_eq!([0, 1].map(|lod| container.level(lod).is_some()), offered, "{length} bytes");
        assert_eq!(container.file_length(), bytes.len() as u64);
    }
    // At the coarse level's end its mip tail is there, the large mip is not.
    let prefix = crate::AlignedBytes::copy_of(&bytes[..coarse]);
    let container = Container::open_prefix(&prefix).expect("tables are whole");
    assert!(container.mip(0, 0).is_none() && container.mip(0, 1).is_some());
}

#[test]
fn an_empty_level_is_a_level() {
    let mut model = tiny();
    model.levels[1] = model::level(&[], &[], [0, 0], 0.5);
    let bytes = crate::AlignedBytes::copy_of(&write(&model.content()).expect("valid"));
    let container = Container::open(&bytes).expect("sound");
    let view = container.level(1).expect("at hand");
    assert!(view.positions().is_empty() && view.indices().is_empty());
}

#[test]
fn indices_take_four_bytes_from_65536_vertices_on() {
    for (vertices, width) in [(65_535u32, 2), (65_536, 4)] {
        let positions: Vec<[f32; 3]> = (0..vertices).map(|v| [v as f32, 0.0, 0.0]).collect();
        let mut model = tiny();
        model.levels[0] = model::level(&positions, &[0, 1, vertices - 1], [3, 0], 0.0);
        let bytes = crate::AlignedBytes::copy_of(&write(&model.content()).expect("valid"));
        let container = Container::open(&bytes).expect("sound");
        let view = container.level(0).expect("at hand");
        assert_eq!(view.record.index_width, width);
        assert_eq!(view.indices().iter().collect::<Vec<_>>(), [0, 1, vertices - 1]);
    }
}

#[test]
fn content_that_no_container_may_hold_is_refused_by_the_writer() {
    let refused = |change: &dyn Fn(&mut Model)| {
        let mut model = tiny();
        change(&mut model);
        write(&model.content()).expect_err("invalid").code.name()
    };
    assert_eq!(refused(&|m| m.levels[0].positions[1][2] = f32::NAN), "not-finite");
    assert_eq!(refused(&|m| m.levels[0].uv0[0][0] = f32::INFINITY), "not-finite");
    assert_eq!(refused(&|m| m.levels[0].error = f32::NAN), "not-finite");
    assert_eq!(refused(&|m| m.levels[0].error = 1.0), "level-error");
    assert_eq!(refused(&|m| m.levels[0].error = -1.0), "level-error");
    assert_eq!(refused(&|m| m.levels[0].indices[0] = 900), "index-range");
    assert_eq!(refused(&|m| m.levels[0].counts[0] += 3), "ranges");
    assert_eq!(refused(&|m| m.levels[0].uv0.truncate(4)), "arrays");
    assert_eq!(refused(&|m| m.submesh_material = 7), "reference");
    assert_eq!(refused(&|m| m.mips[0].push(0)), "mips");
    assert_eq!(refused(&|m| m.levels.clear()), "count");
    assert_eq!(refused(&|m| m.names[0] = "x".repeat(70_000)), "text");
    assert_eq!(refused(&|m| m.roughness = f32::NEG_INFINITY), "not-finite");
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig::with_cases(64))]

    #[test]
    fn any_geometry_comes_back_bit_for_bit(
        positions in proptest::collection::vec(proptest::array::uniform3(proptest::num::f32::NORMAL | proptest::num::f32::ZERO | proptest::num::f32::SUBNORMAL), 1..300),
        corners in proptest::collection::vec(0usize..10_000, 0..200),
        split in 0usize..1000,
    ) {
        let mut indices: Vec<u32> = corners.iter().map(|c| (c % positions.len()) as u32).collect();
        indices.truncate(indices.len() / 3 * 3);
        let first = (split % (indices.len() / 3 + 1)) * 3;
        let mut model = tiny();
        model.levels[0] = model::level(&positions, &indices, [first as u32, (indices.len() - first) as u32], 0.0);
        let content: Content<'_> = model.content();
        let bytes = crate::AlignedBytes::copy_of(&write(&content).expect("valid"));
        let container = Container::open(&bytes).expect("sound");
        let view = container.level(0).expect("at hand");
        let bits = |p: &[[f32; 3]]| p.iter().map(|p| p.map(f32::to_bits)).collect::<Vec<_>>();
        proptest::prop_assert_eq!(bits(view.positions()), bits(&positions));
        proptest::prop_assert_eq!(view.indices().iter().collect::<Vec<_>>(), indices);
        proptest::prop_assert_eq!(view.ranges[1].first_index as usize, first);
    }
}
