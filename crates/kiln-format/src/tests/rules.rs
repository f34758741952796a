//! One crafted file a rule.

use crate::prelude::*;
use bytemuck::{Pod, bytes_of, pod_read_unaligned};

use super::model::tiny;
use crate::record::*;
use crate::write::seal;
use crate::{AlignedBytes, Code, Container, Kind, PrivateSection, check, write};

/// Sets every section hash that can be set, then the header's.
pub(super) fn rehash(bytes: &mut [u8]) {
    for number in 0..section_count(bytes) {
        let mut entry = entry(bytes, number);
        let end = entry.offset.checked_add(entry.stored_length).map(|end| end as usize);
        let Some(own) = end.and_then(|end| bytes.get(entry.offset as usize..end)) else { continue };
        entry.stored_hash = *blake3::hash(own).as_bytes();
        if entry.codec == 0 {
            entry.raw_hash = entry.stored_hash;
        }
        put(bytes, HEADER_SIZE + number * ENTRY_SIZE, &entry);
    }
    seal(bytes);
    rehash_coded(bytes);
}

/// Those of decoded bytes, where there are any.
fn rehash_coded(bytes: &mut [u8]) {
    let aligned = AlignedBytes::copy_of(bytes);
    let Ok(container) = Container::open_tables(&aligned) else { return };
    let coded: Vec<_> = container.sections().filter(|s| s.entry.codec != 0).collect();
    for section in &coded {
        let Some(raw) = container.raw_bytes(section.number) else { continue };
        let raw_hash = *blake3::hash(raw).as_bytes();
        put(bytes, HEADER_SIZE + section.number as usize * ENTRY_SIZE, &SectionEntry { raw_hash, ..*section.entry });
    }
    if !coded.is_empty() {
        seal(bytes);
    }
}

fn section_count(bytes: &[u8]) -> usize {
    let header: Header = pod_read_unaligned(&bytes[..HEADER_SIZE]);
    (header.section_count as usize).min((bytes.len() - HEADER_SIZE) / ENTRY_SIZE)
}

fn entry(bytes: &[u8], number: usize) -> SectionEntry {
    let at = HEADER_SIZE + number * ENTRY_SIZE;
    pod_read_unaligned(&bytes[at..at + ENTRY_SIZE])
}

fn put<T: Pod>(bytes: &mut [u8], at: usize, value: &T) {
    bytes[at..at + size_of::<T>()].copy_from_slice(bytes_of(value));
}

pub(super) fn offset_of(bytes: &[u8], kind: Kind) -> usize {
    (0..section_count(bytes)).map(|n| entry(bytes, n)).find(|e| e.kind == kind.0).expect("is there").offset as usize
}

/// The codes that `check` finds after `change`, every hash being right again.
fn codes_after(change: impl FnOnce(&mut Vec<u8>)) -> Vec<Code> {
    codes_of(write(&tiny().content()).expect("valid"), change)
}

/// As [`codes_after`], of other bytes.
pub(super) fn codes_of(mut bytes: Vec<u8>, change: impl FnOnce(&mut Vec<u8>)) -> Vec<Code> {
    change(&mut bytes);
    rehash(&mut bytes);
    let aligned = AlignedBytes::copy_of(&bytes);
    let report = check(&aligned);
    assert_eq!(Container::open(&aligned).err(), report.findings.first().cloned(), "open gives check's first finding");
    report.findings.iter().map(|finding| finding.code).collect()
}

pub(super) fn edit_header(bytes: &mut [u8], change: impl FnOnce(&mut Header)) {
    let mut header: Header = pod_read_unaligned(&bytes[..HEADER_SIZE]);
    change(&mut header);
    put(bytes, 0, &header);
}

pub(super) fn edit_entry(bytes: &mut [u8], number: usize, change: impl FnOnce(&mut SectionEntry)) {
    let mut changed = entry(bytes, number);
    change(&mut changed);
    put(bytes, HEADER_SIZE + number * ENTRY_SIZE, &changed);
}

pub(super) fn edit<T: Pod>(bytes: &mut [u8], kind: Kind, at: usize, change: impl FnOnce(&mut T)) {
    let at = offset_of(bytes, kind) + at;
    let mut value: T = pod_read_unaligned(&bytes[at..at + size_of::<T>()]);
    change(&mut value);
    put(bytes, at, &value);
}

fn private(name: &[u8; 4], required: bool) -> PrivateSection<'static> {
    PrivateSection { kind: Kind(*name), version: 3, required, payload: false, bytes: vec![1, 2, 3].into() }
}

#[test]
fn a_newer_minor_is_read_and_its_reserved_bytes_ignored() {
    let mut bytes = write(&tiny().content()).expect("valid");
    edit_header(&mut bytes, |header| {
        header.minor = 7;
        header.reserved0 = 5;
    });
    edit::<SubmeshRecord>(&mut bytes, Kind::SUBMESHES, 16, |record| record.reserved = [1; 4]);
    rehash(&mut bytes);
    let aligned = AlignedBytes::copy_of(&bytes);
    let container = Container::open(&aligned).expect("readable");
    assert_eq!(container.version(), (1, 7));
    assert_eq!(container.level(1).expect("at hand").positions().len(), 3);
    // Under its own minor the same bytes are a finding.
    edit_header(&mut bytes, |header| header.minor = 0);
    rehash(&mut bytes);
    let codes: Vec<Code> = check(&bytes).findings.iter().map(|f| f.code).collect();
    assert_eq!(codes, [Code::Reserved, Code::Reserved]);
}

#[test]
fn a_newer_major_is_refused_with_both_numbers() {
    let mut bytes = write(&tiny().content()).expect("valid");
    edit_header(&mut bytes, |header| (header.major, header.minor) = (2, 3));
    rehash(&mut bytes);
    let finding = Container::open(&AlignedBytes::copy_of(&bytes)).err().expect("refused");
    assert_eq!(finding.code, Code::Major);
    assert!(finding.to_string().contains("1.2") && finding.to_string().contains("2.3"), "{finding}");
}

#[test]
fn an_unknown_optional_section_is_skipped_and_lent() {
    let mut model = tiny();
    model.private.push(private(b"abcd", false));
    let bytes = AlignedBytes::copy_of(&write(&model.content()).expect("valid"));
    assert_eq!(check(&bytes).skipped, ["abcd version 3"]);
    let container = Container::open(&bytes).expect("sound");
    let section = container.sections().find(|s| s.kind.is_private()).expect("listed");
    assert_eq!(container.section_bytes(section.number), Some(&[1, 2, 3][..]));
}

#[test]
fn an_unknown_required_section_is_refused_by_name() {
    let mut model = tiny();
    model.private.push(private(b"zeta", true));
    let bytes = AlignedBytes::copy_of(&write(&model.content()).expect("valid"));
    let finding = Container::open(&bytes).err().expect("refused");
    assert_eq!(finding.code, Code::UnknownRequired);
    assert!(finding.to_string().contains("zeta"), "{finding}");
}

#[test]
fn a_newer_version_of_a_required_section_is_refused_and_of_an_optional_one_skipped() {
    assert_eq!(codes_after(|b| edit_entry(b, 1, |e| e.version = 3)), [Code::SectionVersion]);
    // A table that claims to be optional is still one that cannot be skipped.
    assert_eq!(codes_after(|b| edit_entry(b, 4, |e| (e.version, e.flags) = (3, 0))), [Code::SectionVersion]);
    let mut bytes = write(&tiny().content()).expect("valid");
    edit_entry(&mut bytes, 5, |e| e.version = 2);
    rehash(&mut bytes);
    let aligned = AlignedBytes::copy_of(&bytes);
    let container = Container::open(&aligned).expect("provenance is optional");
    assert!(container.provenance().is_none());
}

#[test]
fn header_rules() {
    assert_eq!(codes_after(|b| b[0] = 0x09), [Code::Magic]);
    assert_eq!(codes_after(|b| b[8..12].reverse()), [Code::Endian]);
    assert_eq!(codes_after(|b| edit_header(b, |h| h.table_offset = 112)), [Code::TableOffset]);
    assert_eq!(codes_after(|b| edit_header(b, |h| h.section_count = u32::MAX)), [Code::SectionCount]);
    assert_eq!(codes_after(|b| edit_header(b, |h| h.reserved1[3] = 1)), [Code::Reserved]);
    assert_eq!(codes_after(|b| edit_header(b, |h| h.file_length -= 1))[0], Code::FileLength);
    let mut bytes = write(&tiny().content()).expect("valid");
    edit_entry(&mut bytes, 2, |e| e.codec = 1);
    assert_eq!(check(&bytes).findings[0].code, Code::HeaderHash);
}

#[test]
fn entry_rules() {
    let has = |code, change: &dyn Fn(&mut SectionEntry), number| {
        let codes = codes_after(|b| edit_entry(b, number, change));
        assert!(codes.contains(&code), "{code:?} is not in {codes:?}");
    };
    has(Code::Kind, &|e| e.kind = *b"\0\0\0\0", 6);
    has(Code::Flags, &|e| e.flags = 0, 6);
    has(Code::Flags, &|e| e.flags = 3, 6);
    has(Code::Codec, &|e| e.codec = 2, 6);
    has(Code::Codec, &|e| e.codec = 4, 6);
    has(Code::Codec, &|e| e.codec = 1, 2);
    has(Code::Decode, &|e| e.codec = 1, 6);
    has(Code::RawLength, &|e| (e.codec, e.raw_length) = (1, e.stored_length * 1024 + 1), 6);
    has(Code::Alignment, &|e| e.alignment = 16, 6);
    has(Code::Alignment, &|e| e.alignment = 4096, 6);
    has(Code::Misaligned, &|e| e.offset += 1, 6);
    has(Code::Bounds, &|e| e.stored_length = u64::MAX, 6);
    has(Code::Bounds, &|e| e.offset = u64::MAX - 255, 6);
    has(Code::Overlap, &|e| e.offset -= 256, 7);
    has(Code::Hole, &|e| e.offset += 256, 7);
    has(Code::RawLength, &|e| e.raw_length += 1, 6);
    has(Code::Reserved, &|e| e.reserved1[15] = 1, 6);
    has(Code::Reserved, &|e| e.reserved0[0] = 1, 6);
    has(Code::UnknownRequired, &|e| e.kind = *b"VERX", 6);
    has(Code::Duplicate, &|e| e.kind = *b"LEVL", 0);
    has(Code::Missing, &|e| e.kind = *b"LEVL", 0);
    has(Code::Order, &|e| e.kind = *b"STRS", 6);
}

#[test]
fn tiling_rules() {
    let trailing = codes_after(|b| {
        b.extend([0; 16]);
        let length = b.len() as u64;
        edit_header(b, |h| h.file_length = length);
    });
    assert_eq!(trailing, [Code::Trailing]);
    // The byte before the first payload section is padding.
    let padding = codes_after(|b| {
        let at = offset_of(b, Kind::VERTICES) - 1;
        b[at] = 1;
    });
    assert_eq!(padding, [Code::Padding]);
    let mut bytes = write(&tiny().content()).expect("valid");
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    assert_eq!(check(&bytes).findings[0].code, Code::StoredHash);
    edit_entry(&mut bytes, 6, |e| e.raw_hash[0] ^= 1);
    seal(&mut bytes);
    assert_eq!(check(&bytes).findings[0].code, Code::RawHash);
}

#[test]
fn table_rules() {
    use Kind as K;
    let level = |change: &dyn Fn(&mut LevelRecord)| codes_after(|b| edit(b, K::LEVELS, 32, change));
    assert_eq!(level(&|l| l.error = f32::NAN), [Code::NotFinite]);
    assert_eq!(level(&|l| l.error = 0.25), [Code::LevelError]);
    assert_eq!(level(&|l| l.error_kind = 9), [Code::Value]);
    assert_eq!(level(&|l| l.vertex_section = 0), [Code::Reference]);
    assert_eq!(level(&|l| l.index_width = 4), [Code::IndexWidth]);
    assert_eq!(level(&|l| l.first_array = 1), [Code::Reference]);
    assert_eq!(level(&|l| l.triangles = 1), [Code::Ranges]);
    assert_eq!(level(&|l| l.vertices += 1), [Code::Arrays]);
    assert_eq!(level(&|l| l.bounds_max[0] += 1.0), [Code::Box]);
    assert_eq!(level(&|l| l.reserved[5] = 1), [Code::Reserved]);
    let header = |change: &dyn Fn(&mut LevelHeader)| codes_after(|b| edit(b, K::LEVELS, 0, change));
    assert_eq!(header(&|h| h.level_count = 300), [Code::Count]);
    assert_eq!(header(&|h| h.need_count = u32::MAX), [Code::TableLength]);
    assert_eq!(header(&|h| h.need_count -= 1), [Code::TableLength]);
    assert_eq!(header(&|h| h.has_layout = 0), [Code::Value]);
    let array = |change: &dyn Fn(&mut ArrayRecord)| codes_after(|b| edit(b, K::LEVELS, 32 + 2 * 96 + 32, change));
    assert_eq!(array(&|a| a.semantic = 99), [Code::Arrays]);
    assert_eq!(array(&|a| a.offset = u64::MAX), [Code::Arrays]);
    let need = |value: u32| codes_after(|b| edit::<u32>(b, K::LEVELS, 32 + 2 * 96 + 4 * 32, |n| *n = value));
    assert_eq!(need(u32::MAX), [Code::Needs]);
    let submesh = |change: &dyn Fn(&mut SubmeshRecord)| codes_after(|b| edit(b, K::SUBMESHES, 16, change));
    assert_eq!(submesh(&|s| s.name = 99), [Code::Reference]);
    assert_eq!(submesh(&|s| s.material = 1), [Code::Reference]);
    assert_eq!(submesh(&|s| s.attributes = 1), [Code::Value]);
    let range = |change: &dyn Fn(&mut DrawRange)| codes_after(|b| edit(b, K::SUBMESHES, 16 + 2 * 32, change));
    assert_eq!(range(&|r| r.index_count = 4), [Code::Ranges, Code::Ranges, Code::Ranges]);
    assert_eq!(range(&|r| r.vertex_count = 2), [Code::IndexRange]);
    assert_eq!(range(&|r| r.bounds_min[1] = -1.0), [Code::Box]);
    let material = |change: &dyn Fn(&mut MaterialRecord)| codes_after(|b| edit(b, K::MATERIALS, 16, change));
    assert_eq!(material(&|m| m.alpha_mode = 3), [Code::Value]);
    assert_eq!(material(&|m| m.metallic_factor = f32::NAN), [Code::NotFinite]);
    assert_eq!(material(&|m| m.slots[1] = m.slots[0]), [Code::Role, Code::Role]);
    assert_eq!(material(&|m| m.slots[1].uv_set = 1), [Code::Value]);
    assert_eq!(material(&|m| m.slots[0].wrap_u = 3), [Code::Value]);
    assert_eq!(material(&|m| m.slots[0].texture = 1), [Code::Reference, Code::Role]);
    let texture = |change: &dyn Fn(&mut TextureRecord)| codes_after(|b| edit(b, K::TEXTURES, 16, change));
    assert_eq!(texture(&|t| t.roles = 3), [Code::Role]);
    assert_eq!(texture(&|t| t.channels[0] = 200), [Code::Value]);
    assert!(texture(&|t| t.width = 0).contains(&Code::Count));
    assert!(texture(&|t| t.mip_count = 33).contains(&Code::Mips));
    assert!(texture(&|t| t.width += 2).contains(&Code::Mips));
}

#[test]
fn payload_rules() {
    // The coarse level's first index is the first of the file's index sections.
    let index = codes_after(|b| edit::<u16>(b, Kind::INDICES, 0, |i| *i = 3));
    assert_eq!(index, [Code::IndexRange]);
    let restart = codes_after(|b| edit::<u16>(b, Kind::INDICES, 2, |i| *i = 0xFFFF));
    assert_eq!(restart, [Code::IndexRange]);
    let nan = codes_after(|b| edit::<f32>(b, Kind::VERTICES, 256, |x| *x = f32::NAN));
    assert_eq!(nan, [Code::NotFinite]);
    let padding = codes_after(|b| edit::<u8>(b, Kind::VERTICES, 255, |x| *x = 1));
    assert_eq!(padding, [Code::Padding]);
    // Mip 1 of 64 texels fills 256 bytes; mip 2 of 32 is followed by padding.
    let tail = codes_after(|b| edit::<u8>(b, Kind::MIP_TAIL, 256 + 128, |x| *x = 1));
    assert_eq!(tail, [Code::Padding]);
}

#[test]
fn string_rules() {
    let first = |change: &dyn Fn(&mut [u8])| codes_after(|b| edit::<[u8; 8]>(b, Kind::STRINGS, 16, |s| change(s)));
    // The first string is "pot": length 3, three letters, one zero.
    assert_eq!(first(&|s| s[4] = 0xFF), [Code::Text]);
    assert_eq!(first(&|s| s[7] = 1), [Code::Padding]);
    assert_eq!(first(&|s| s[2] = 1), [Code::Text]);
    // U+0344 is never in normal form.
    assert_eq!(first(&|s| s[4..7].copy_from_slice(&[b'a', 0xCD, 0x84])), [Code::Text]);
}

#[test]
fn payload_out_of_canonical_order_is_found() {
    let codes = codes_after(|b| {
        // The coarse and the fine level trade their geometry's section numbers: same kinds, wrong order.
        let mut sections = [[0u32; 2]; 2];
        for (lod, own) in sections.iter_mut().enumerate() {
            edit::<LevelRecord>(b, Kind::LEVELS, 32 + lod * 96, |l| *own = [l.vertex_section, l.index_section]);
        }
        for lod in 0..2 {
            edit::<LevelRecord>(b, Kind::LEVELS, 32 + lod * 96, |l| {
                [l.vertex_section, l.index_section] = sections[1 - lod];
            });
        }
    });
    assert!(codes.contains(&Code::Order), "{codes:?}");
}
