//! What came with version 1.1: deep and block-compressed textures, extra pictures, layouts of several sheets.

use crate::prelude::*;
use alloc::borrow::Cow;

use super::model::{Model, tiny};
use super::rules::{codes_of, edit, edit_entry, edit_header, rehash};
use crate::record::*;
use crate::{AlignedBytes, Code, Container, Content, Extra, Kind, Role, TextureContent, TextureFormat, check, write};

const ALL: [TextureFormat; 8] = [
    TextureFormat::Rgba8Unorm,
    TextureFormat::Rgba8Srgb,
    TextureFormat::Rgba16Unorm,
    TextureFormat::Rgba16Float,
    TextureFormat::Rgba32Float,
    TextureFormat::Bc5Unorm,
    TextureFormat::Bc7Unorm,
    TextureFormat::Bc7Srgb,
];

/// A picture of some finite bytes with all its mips, in a role or as an extra.
fn picture(format: TextureFormat, extra: Option<(Extra, u32)>) -> TextureContent<'static> {
    let (width, height) = (130u32, 7u32);
    let mips = (0..8).map(|k| {
        let length = format.mip_length((width >> k).max(1), (height >> k).max(1)) as usize;
        // Below 0x3C: no exponent is full.
        Cow::Owned((0..length).map(|i| ((i * 7 + k) % 60) as u8).collect())
    });
    let channels = extra.map_or(Role::Normal.channels(), |(extra, _)| extra.channels());
    TextureContent { name: format.name().into(), format, channels, extra, width, height, mips: mips.collect() }
}

/// The tiny model with two more textures: 1 is its normal map in `format`, 2 an extra.
fn wide(model: &Model, format: TextureFormat, role: Role) -> Content<'_> {
    let mut content = model.content();
    content.textures.push(picture(format, None));
    content.textures.push(picture(TextureFormat::Rgba32Float, Some((Extra::Position, 1))));
    let slots = &mut content.materials[0].1.slots;
    slots[role.number() as usize] = SlotRecord { texture: 1, ..slots[0] };
    content.layout = Some([64, 4, 3, 2]);
    content
}

fn container() -> Vec<u8> {
    write(&wide(&tiny(), TextureFormat::Bc5Unorm, Role::Normal)).expect("valid")
}

#[test]
fn blocks_cover_what_is_left_of_a_mip() {
    for (format, width, height, length) in [
        (TextureFormat::Bc7Srgb, 1, 1, 16),
        (TextureFormat::Bc7Unorm, 4, 4, 16),
        (TextureFormat::Bc5Unorm, 5, 4, 32),
        (TextureFormat::Bc5Unorm, 130, 7, 33 * 2 * 16),
        (TextureFormat::Rgba16Unorm, 5, 3, 120),
        (TextureFormat::Rgba16Float, 5, 3, 120),
        (TextureFormat::Rgba32Float, 5, 3, 240),
        (TextureFormat::Rgba8Srgb, 5, 3, 60),
        (TextureFormat::Rgba32Float, 65_536, 65_536, 1 << 36),
    ] {
        assert_eq!(format.mip_length(width, height), length, "{} {width} x {height}", format.name());
    }
}

#[test]
fn every_format_is_lent_in_the_roles_that_it_suits_and_refused_in_the_others() {
    let model = tiny();
    for format in ALL {
        for role in &Role::ALL[1..] {
            let written = write(&wide(&model, format, *role));
            if !role.formats().contains(&format) {
                let finding = written.expect_err("does not suit");
                assert_eq!(finding.code, Code::Role, "{} as {}", format.name(), role.name());
                continue;
            }
            let bytes = AlignedBytes::copy_of(&written.expect("valid"));
            let container = Container::open(&bytes).expect("sound");
            let content = wide(&model, format, *role);
            for (k, mip) in content.textures[1].mips.iter().enumerate() {
                assert_eq!(container.mip(1, k).expect("at hand"), &**mip, "{} mip {k}", format.name());
            }
        }
    }
}

#[test]
fn only_files_with_something_new_are_of_the_new_minor_version() {
    let version = |content: &Content<'_>| {
        let bytes = AlignedBytes::copy_of(&write(content).expect("valid"));
        let container = Container::open(&bytes).expect("sound");
        let table = container.sections().find(|s| s.kind == Kind::TEXTURES).expect("has one").entry.version;
        (container.version(), table, container.level_records()[1].layout_sheets)
    };
    let model = tiny();
    assert_eq!(version(&model.content()), ((1, 0), 1, 0));
    assert_eq!(version(&Content { layout: Some([64, 4, 3, 2]), ..model.content() }), ((1, 1), 1, 2));
    assert_eq!(version(&wide(&model, TextureFormat::Rgba8Unorm, Role::Normal)), ((1, 1), 2, 2));
}

#[test]
fn extras_carry_their_kind_and_sheet() {
    let bytes = AlignedBytes::copy_of(&container());
    let container = Container::open(&bytes).expect("sound");
    let record = &container.textures()[2];
    assert_eq!((Extra::from_roles(record.roles), record.sheet), (Some(Extra::Position), 1));
    for extra in Extra::ALL {
        assert_eq!(Extra::from_roles(1 << extra.number()), Some(*extra));
    }
    assert_eq!([0, 1, 1 << 5 | 1, 3 << 5, 1 << 15].map(Extra::from_roles), [None; 5]);
}

#[test]
fn rules_of_the_new_tables() {
    let after = |change: &dyn Fn(&mut Vec<u8>)| codes_of(container(), |bytes| change(bytes));
    let texture = |number: usize, change: &dyn Fn(&mut TextureRecord)| {
        after(&|b| edit(b, Kind::TEXTURES, 16 + 64 * number, change))
    };
    // A texture of a material is no extra; an extra is one kind.
    assert_eq!(texture(1, &|t| t.roles = 1 << 5), [Code::Role]);
    assert_eq!(texture(1, &|t| t.roles |= 1 << 5), [Code::Role]);
    assert_eq!(texture(2, &|t| t.roles |= 1 << 5), [Code::Role, Code::Reserved]);
    assert_eq!(texture(2, &|t| t.roles = 1 << 20), [Code::Role, Code::Reserved]);
    assert_eq!(texture(2, &|t| t.roles = 0), [Code::Reserved]);
    assert_eq!(texture(1, &|t| t.sheet = 1), [Code::Reserved]);
    assert_eq!(texture(1, &|t| t.format = 9), [Code::Role, Code::Value]);
    // BC7 of the same size: only the role tells.
    assert_eq!(texture(1, &|t| t.format = TextureFormat::Bc7Srgb.number()), [Code::Role]);
    assert!(texture(1, &|t| t.format = TextureFormat::Rgba8Unorm.number()).contains(&Code::Mips));
    assert_eq!(texture(2, &|t| t.channels[0] = 26), [Code::Value]);
    let level = |change: &dyn Fn(&mut LevelRecord)| after(&|b| edit(b, Kind::LEVELS, 32 + 96, change));
    assert_eq!(level(&|l| l.layout_sheets = 1), [Code::Value]);
    assert_eq!(level(&|l| l.layout_sheets = 3), [Code::Value]);
    // Under an old version the new things are reserved or unknown.
    assert!(after(&|b| edit_header(b, |h| h.minor = 0)).contains(&Code::Reserved));
    let old = after(&|b| edit_entry(b, 4, |e| e.version = 1));
    assert!(old.contains(&Code::Value) && old.contains(&Code::Role), "{old:?}");
}

#[test]
fn texels_that_are_no_numbers_are_found() {
    for (format, bad) in [
        (TextureFormat::Rgba32Float, f32::NAN.to_le_bytes().to_vec()),
        (TextureFormat::Rgba32Float, f32::NEG_INFINITY.to_le_bytes().to_vec()),
        (TextureFormat::Rgba16Float, vec![0, 0x7C]),
        (TextureFormat::Rgba16Float, vec![1, 0xFC]),
    ] {
        let model = tiny();
        for k in [0, 3] {
            let mut content = wide(&model, format, Role::Normal);
            content.textures[1].mips[k].to_mut()[..bad.len()].copy_from_slice(&bad);
            assert_eq!(write(&content).expect_err("no number").code, Code::NotFinite, "{} mip {k}", format.name());
        }
    }
}

/// Flips a byte under right hashes: nothing may panic, and what opens lends every mip at its full length.
#[test]
fn every_flipped_byte_of_a_wide_container_is_harmless() {
    let sound = container();
    let tables = sound.len().min(6000);
    let mut opened = 0;
    for at in 0..tables {
        for mask in [1u8, 0x80] {
            let mut bytes = AlignedBytes::copy_of(&sound);
            bytes.as_mut_slice()[at] ^= mask;
            rehash(bytes.as_mut_slice());
            check(&bytes);
            let _ = Container::open_prefix(&bytes);
            let Ok(container) = Container::open(&bytes) else { continue };
            opened += 1;
            for (number, record) in container.textures().iter().enumerate() {
                let format = TextureFormat::from_number(record.format).expect("registered");
                for (k, mip) in container.mips(number).iter().enumerate() {
                    let length = container.mip(number, k).expect("at hand").len() as u64;
                    assert_eq!(length, format.mip_length(mip.width, mip.height));
                }
            }
        }
    }
    assert!(opened > 500, "only {opened} flips kept a sound container");
}
