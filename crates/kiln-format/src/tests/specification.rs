//! The specification and the code name the same checks, kinds, codecs and sizes.

use crate::Code;
use crate::kind::{CODECS, KINDS};
use crate::prelude::*;
use crate::{Extra, TextureFormat};

fn page() -> String {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../formats/container-v1.md");
    std::fs::read_to_string(path).expect("the specification lies in formats/")
}

#[test]
fn every_check_stands_in_the_specification_and_no_other() {
    let page = page();
    let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| K")).collect();
    let expected: Vec<String> =
        Code::ALL.iter().map(|c| format!("| {} | `{}` | {} |", c.number(), c.name(), c.sentence())).collect();
    assert_eq!(rows, expected);
}

#[test]
fn every_section_kind_and_codec_stands_in_the_specification() {
    let page = page();
    for row in &KINDS {
        let need = if row.required { "required" } else { "optional" };
        let line = format!("| `{}` | {} | {need} | {} |", row.kind, row.version, row.alignment);
        assert!(page.contains(&line), "no line {line:?}");
    }
    for (number, name, in_use) in CODECS {
        let line = format!("| {number} | `{name}` | {} |", if in_use { "in use" } else { "reserved" });
        assert!(page.contains(&line), "no line {line:?}");
    }
}

#[test]
fn every_texture_format_and_extra_stands_in_the_specification() {
    let page = page();
    for format in TextureFormat::ALL {
        let unit = if format.is_block() { "block of 4 x 4 texels" } else { "texel" };
        let line = format!("| {} | `{}` | {unit}, {} bytes |", format.number(), format.name(), format.unit_size());
        assert!(page.contains(&line), "no line {line:?}");
    }
    for extra in Extra::ALL {
        let line = format!("| {} | `{}`", extra.number(), extra.name());
        assert!(page.contains(&line), "no line {line:?}");
    }
}

#[test]
fn numbers_and_names_of_checks_are_used_once() {
    let mut numbers: Vec<&str> = Code::ALL.iter().map(|code| code.number()).collect();
    let mut names: Vec<&str> = Code::ALL.iter().map(|code| code.name()).collect();
    assert!(numbers.is_sorted(), "the table is in the order of its numbers");
    numbers.dedup();
    names.sort_unstable();
    names.dedup();
    assert_eq!((numbers.len(), names.len()), (Code::ALL.len(), Code::ALL.len()));
}
