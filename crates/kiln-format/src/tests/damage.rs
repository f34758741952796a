//! Every prefix, every flipped byte: found, refused, never a panic.

use super::model::tiny;
use crate::{AlignedBytes, Code, Container, check, write};

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
