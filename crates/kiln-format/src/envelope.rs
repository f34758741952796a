//! The envelope: header, section table, and how sections tile the file. Nothing here knows what is inside a section.

use crate::codec;
use crate::error::{CheckReport, Code, FormatError};
use crate::kind::{Kind, Occurs, PAYLOAD_ALIGNMENT, PAYLOAD_RANK, TABLE_ALIGNMENT, codec_name};
use crate::prelude::*;
use crate::record::*;

/// What became of a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    /// Inside, hash agrees, known: to be used.
    Sound,
    /// Payload inside whose bytes nobody has looked at yet: may be used, may be wrong.
    Unread,
    /// Optional and unknown (kind or version), bytes agree: lent as bytes, otherwise ignored.
    Skipped,
    /// A finding stands against it, or it lies behind the end of a prefix.
    Absent,
}

/// Header and table, checked.
pub(crate) struct Envelope<'a> {
    /// All bytes at hand.
    pub(crate) bytes: &'a [u8],
    /// Minor version of the file.
    pub(crate) minor: u16,
    /// The table.
    pub(crate) entries: &'a [SectionEntry],
    /// `[entries.len()]`.
    pub(crate) states: Vec<State>,
}

impl<'a> Envelope<'a> {
    /// The stored bytes of a section that is at hand.
    pub(crate) fn section(&self, number: usize) -> Option<&'a [u8]> {
        if *self.states.get(number)? == State::Absent {
            return None;
        }
        self.stored(number)
    }

    /// The bytes of a section whatever its state, if they lie inside.
    pub(crate) fn stored(&self, number: usize) -> Option<&'a [u8]> {
        let entry = self.entries.get(number)?;
        let start = usize::try_from(entry.offset).ok()?;
        let end = start.checked_add(usize::try_from(entry.stored_length).ok()?)?;
        self.bytes.get(start..end)
    }

    /// The number of the first section of a kind.
    pub(crate) fn find(&self, kind: Kind) -> Option<u32> {
        self.entries.iter().position(|entry| entry.kind == kind.0).map(|number| number as u32)
    }

    /// Whether reserved bytes must be zero.
    pub(crate) fn strict(&self) -> bool {
        is_known(self.minor)
    }
}

/// Whether all that a file of this minor version may hold is known here.
fn is_known(minor: u16) -> bool {
    (0..=MINOR).contains(&minor)
}

/// How a section is named in findings.
pub(crate) fn place(number: usize, entry: &SectionEntry) -> String {
    format!("section {number} ({})", Kind(entry.kind))
}

/// Offset and first nonzero byte of what must be zero.
pub(crate) fn first_nonzero(bytes: &[u8]) -> Option<(usize, u8)> {
    bytes.iter().position(|b| *b != 0).map(|i| (i, bytes[i]))
}

/// Checks header, table and tiling, and the hashes of tables; no byte of payload is read. Findings go to `report`; `None` if
/// they leave nothing to go on with.
///
/// With `whole`, the bytes must be the file; else they may be a prefix of it, and payload that is not inside is absent
/// without a finding.
pub(crate) fn read<'a>(bytes: &'a [u8], whole: bool, report: &mut CheckReport) -> Option<Envelope<'a>> {
    let header = read_header(bytes, whole, report)?;
    let before = report.count();
    let entries = read_table(bytes, &header, report)?;
    let mut envelope = Envelope { bytes, minor: header.minor, entries, states: vec![State::Absent; entries.len()] };
    check_tiling(&mut envelope, &header, whole, report);
    check_occurrence(&envelope, report);
    // A damaged table says nothing reliable about contents; damaged payload does not hurt the tables.
    let tables_ok = envelope.entries.iter().zip(&envelope.states).all(|(entry, state)| {
        *state != State::Absent || Kind(entry.kind).row().is_none_or(|row| row.rank >= PAYLOAD_RANK)
    });
    (report.count() == before || tables_ok).then_some(envelope)
}

fn read_header(bytes: &[u8], whole: bool, report: &mut CheckReport) -> Option<Header> {
    let mut fail = |code, field: &str, expected: String, found: String| {
        report.push(FormatError::new(code, format!("header.{field}"), expected, found));
    };
    if !(bytes.as_ptr() as usize).is_multiple_of(TABLE_ALIGNMENT as usize) {
        fail(Code::Unaligned, "address", "a multiple of 16 (copy into AlignedBytes)".into(), "another".into());
        return None;
    }
    // The magic is looked at first, so that a foreign short file is called foreign.
    let length = bytes.len();
    let shown = &bytes[..length.min(8)];
    if shown != &MAGIC[..shown.len()] {
        let hint = if bytes.starts_with(&[0x89]) || bytes.starts_with(&[0x09]) || bytes.starts_with(b"KLN") {
            " (damaged by a text-mode copy?)"
        } else {
            ""
        };
        fail(Code::Magic, "magic", MAGIC.escape_ascii().to_string(), format!("{}{hint}", shown.escape_ascii()));
        return None;
    }
    let Some(header) = bytes.get(..HEADER_SIZE) else {
        fail(Code::TooShort, "length", format!("at least {HEADER_SIZE} bytes"), length.to_string());
        return None;
    };
    let header: Header = bytemuck::pod_read_unaligned(header);
    if header.endian != ENDIAN {
        fail(Code::Endian, "endian", format!("{ENDIAN:#010x}"), format!("{:#010x}", header.endian));
        return None;
    }
    if header.major != MAJOR {
        let expected = format!("version {MAJOR}.x (this reader is {MAJOR}.{MINOR})");
        fail(Code::Major, "major", expected, format!("version {}.{}", header.major, header.minor));
        return None;
    }
    let fits = if whole { header.file_length == length as u64 } else { header.file_length >= length as u64 };
    if !fits {
        fail(Code::FileLength, "file_length", format!("{} bytes", header.file_length), format!("{length} bytes"));
        if header.file_length < length as u64 {
            return None;
        }
    }
    if header.table_offset != HEADER_SIZE as u64 {
        fail(Code::TableOffset, "table_offset", HEADER_SIZE.to_string(), header.table_offset.to_string());
        return None;
    }
    let room = (header.file_length.saturating_sub(HEADER_SIZE as u64) / ENTRY_SIZE as u64).min(MAX_SECTIONS as u64);
    if header.section_count as u64 > room {
        fail(Code::SectionCount, "section_count", format!("at most {room}"), header.section_count.to_string());
        return None;
    }
    if is_known(header.minor) && (header.reserved0 != 0 || header.reserved1 != [0; 24]) {
        fail(Code::Reserved, "reserved", "zero".into(), "another value".into());
    }
    Some(header)
}

fn read_table<'a>(bytes: &'a [u8], header: &Header, report: &mut CheckReport) -> Option<&'a [SectionEntry]> {
    let end = HEADER_SIZE + header.section_count as usize * ENTRY_SIZE;
    let Some(table) = bytes.get(HEADER_SIZE..end) else {
        let found = format!("{} bytes", bytes.len());
        report.push(FormatError::new(Code::TooShort, "table", format!("at least {end} bytes"), found));
        return None;
    };
    let mut hasher = blake3::Hasher::new();
    hasher.update(&bytes[..HASHED_HEADER]);
    hasher.update(table);
    let found = hasher.finalize();
    if found.as_bytes() != &header.hash {
        let expected = blake3::Hash::from_bytes(header.hash);
        report.push(FormatError::new(Code::HeaderHash, "header.hash", expected.to_hex(), found.to_hex()));
        return None;
    }
    match bytemuck::try_cast_slice(table) {
        Ok(entries) => Some(entries),
        Err(_) => {
            report.push(FormatError::new(Code::Unaligned, "table", "a multiple of 16", "another"));
            None
        }
    }
}

/// Walks the sections in table order, which is file order.
fn check_tiling(envelope: &mut Envelope<'_>, header: &Header, whole: bool, report: &mut CheckReport) {
    let mut end = (HEADER_SIZE + envelope.entries.len() * ENTRY_SIZE) as u64;
    for number in 0..envelope.entries.len() {
        let entry = &envelope.entries[number];
        let before = report.count();
        let mut skip = false;
        check_entry(number, entry, envelope.strict(), &mut skip, report);
        check_place(number, entry, &mut end, envelope, header, report);
        let is_table = is_table(entry);
        if report.count() != before {
            continue;
        }
        let Some(stored) = envelope.stored(number) else {
            if whole || is_table {
                let found = format!("{} bytes at hand", envelope.bytes.len());
                report.push(FormatError::new(Code::Bounds, place(number, entry), "bytes inside", found));
            }
            continue;
        };
        if is_table && let Some(finding) = wrong_hash(number, entry, stored) {
            report.push(finding);
            continue;
        }
        envelope.states[number] = match (skip, is_table) {
            (true, _) => State::Skipped,
            (false, true) => State::Sound,
            (false, false) => State::Unread,
        };
        if skip {
            report.skipped.push(format!("{} version {}", Kind(entry.kind), entry.version));
        }
    }
    if end != header.file_length {
        let found = format!("{} bytes", header.file_length);
        report.push(FormatError::new(Code::Trailing, "header.file_length", format!("{end} bytes"), found));
    }
}

pub(crate) fn is_table(entry: &SectionEntry) -> bool {
    Kind(entry.kind).row().is_some_and(|row| row.rank < PAYLOAD_RANK)
}

/// What is found against the stored bytes of a section.
pub(crate) fn wrong_hash(number: usize, entry: &SectionEntry, stored: &[u8]) -> Option<FormatError> {
    let found = blake3::hash(stored);
    (found.as_bytes() != &entry.stored_hash).then(|| {
        let at = format!("{}.stored_hash", place(number, entry));
        let expected = blake3::Hash::from_bytes(entry.stored_hash);
        FormatError::new(Code::StoredHash, at, expected.to_hex(), found.to_hex())
    })
}

/// What is found against the bytes between a section and the one before it.
pub(crate) fn wrong_padding(bytes: &[u8], entries: &[SectionEntry], number: usize) -> Option<FormatError> {
    let end = match number.checked_sub(1) {
        Some(before) => entries[before].offset.checked_add(entries[before].stored_length)?,
        None => (HEADER_SIZE + entries.len() * ENTRY_SIZE) as u64,
    };
    let start = entries[number].offset.min(bytes.len() as u64);
    let gap = bytes.get(usize::try_from(end).ok()?..usize::try_from(start).ok()?)?;
    let (i, byte) = first_nonzero(gap)?;
    let found = format!("{byte:#04x} at offset {}", end + i as u64);
    Some(FormatError::new(Code::Padding, format!("before {}", place(number, &entries[number])), "zero", found))
}

/// The entry's own fields. `skip` is set where an optional section is of unknown kind or version.
fn check_entry(number: usize, entry: &SectionEntry, strict: bool, skip: &mut bool, report: &mut CheckReport) {
    let kind = Kind(entry.kind);
    let mut fail = |code, field: &str, expected: String, found: String| {
        report.push(FormatError::new(code, format!("{}.{field}", place(number, entry)), expected, found));
    };
    if !kind.is_well_formed() {
        fail(Code::Kind, "kind", "four ASCII letters or digits".into(), kind.to_string());
    }
    if entry.flags & !FLAG_REQUIRED != 0 {
        fail(Code::Flags, "flags", "bit 0 only".into(), format!("{:#06x}", entry.flags));
    }
    let required = entry.flags & FLAG_REQUIRED != 0;
    match kind.row() {
        Some(row) => {
            if (1..=row.version).contains(&entry.version) {
                if required != row.required {
                    fail(Code::Flags, "flags", format!("required = {}", row.required), required.to_string());
                }
                if entry.alignment != row.alignment {
                    fail(Code::Alignment, "alignment", row.alignment.to_string(), entry.alignment.to_string());
                }
            } else if required || row.required {
                // Whatever its flag says: this reader cannot do without the kind.
                let known = format!("version 1 to {} of {kind}", row.version);
                fail(Code::SectionVersion, "version", known, entry.version.to_string());
            } else {
                *skip = true;
            }
        }
        None if required => {
            let found = format!("required section {kind} version {}", entry.version);
            fail(Code::UnknownRequired, "kind", "a kind that this reader knows".into(), found);
        }
        None => *skip = true,
    }
    if ![TABLE_ALIGNMENT, PAYLOAD_ALIGNMENT].contains(&entry.alignment) {
        fail(Code::Alignment, "alignment", "16 or 256".into(), entry.alignment.to_string());
    }
    // A skipped section may have any codec: nobody decodes it.
    if !*skip && !codec::is_for(entry.codec, kind) {
        fail(Code::Codec, "codec", codec::names(kind), codec_name(entry.codec));
    }
    if !*skip && entry.raw_length > codec::most_raw(entry.codec, entry.stored_length) {
        let most = format!("at most {}", codec::most_raw(entry.codec, entry.stored_length));
        fail(Code::RawLength, "raw_length", most, entry.raw_length.to_string());
    } else if entry.codec == 0 {
        if entry.raw_length != entry.stored_length {
            fail(Code::RawLength, "raw_length", entry.stored_length.to_string(), entry.raw_length.to_string());
        }
        if entry.raw_hash != entry.stored_hash {
            fail(Code::RawHash, "raw_hash", "the stored hash".into(), "another".into());
        }
    }
    if strict && (entry.reserved0 != [0; 8] || entry.reserved1 != [0; 16]) {
        fail(Code::Reserved, "reserved", "zero".into(), "another value".into());
    }
}

/// The section's place behind `end`, the end of the one before; moves `end` to its own.
fn check_place(
    number: usize,
    entry: &SectionEntry,
    end: &mut u64,
    envelope: &Envelope<'_>,
    header: &Header,
    report: &mut CheckReport,
) {
    let at = format!("{}.offset", place(number, entry));
    let alignment = if entry.alignment == PAYLOAD_ALIGNMENT { PAYLOAD_ALIGNMENT } else { TABLE_ALIGNMENT } as u64;
    if !entry.offset.is_multiple_of(alignment) {
        report.push(FormatError::new(Code::Misaligned, &*at, format!("a multiple of {alignment}"), entry.offset));
    }
    let first = end.checked_next_multiple_of(alignment).unwrap_or(u64::MAX);
    if entry.offset < *end {
        report.push(FormatError::new(Code::Overlap, &*at, format!("{end} or more"), entry.offset));
    } else if entry.offset > first {
        report.push(FormatError::new(Code::Hole, &*at, first, entry.offset));
    } else if is_table(entry)
        && let Some(finding) = wrong_padding(envelope.bytes, envelope.entries, number)
    {
        report.push(finding);
    }
    match entry.offset.checked_add(entry.stored_length) {
        Some(own) if own <= header.file_length => *end = own.max(*end),
        _ => {
            let found = format!("offset {} + {} bytes", entry.offset, entry.stored_length);
            let expected = format!("within {} bytes", header.file_length);
            report.push(FormatError::new(Code::Bounds, at, expected, found));
        }
    }
}

/// How often each registered kind occurs, and that tables stand before all else in registry order.
fn check_occurrence(envelope: &Envelope<'_>, report: &mut CheckReport) {
    for row in &crate::kind::KINDS {
        let count = envelope.entries.iter().filter(|entry| entry.kind == row.kind.0).count();
        if count == 0 && row.occurs == Occurs::Once {
            report.push(FormatError::new(Code::Missing, format!("{}", row.kind), "one section", "none"));
        }
        if count > 1 && row.occurs != Occurs::Many {
            report.push(FormatError::new(Code::Duplicate, format!("{}", row.kind), "one section", count));
        }
    }
    let mut highest = 0;
    for (number, entry) in envelope.entries.iter().enumerate() {
        // Sections of unknown kind may stand anywhere behind the tables.
        let rank = Kind(entry.kind).row().map_or(PAYLOAD_RANK, |row| row.rank);
        if rank < highest.min(PAYLOAD_RANK) {
            let expected = "tables first, in the registry's order";
            report.push(FormatError::new(Code::Order, place(number, entry), expected, "a later place"));
        }
        highest = highest.max(rank);
    }
}
