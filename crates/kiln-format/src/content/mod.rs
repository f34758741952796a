//! Tables and payload: what the sections say, checked against each other.

mod layouts;
pub(crate) mod numbers;
pub(crate) mod payload;

use bytemuck::Pod;

use crate::container::Container;
use crate::envelope::{self, Envelope, State, first_nonzero};
use crate::error::{CheckReport, Code, FormatError};
use crate::kind::{
    Channel, ErrorKind, Extra, Kind, PAYLOAD_ALIGNMENT, Role, SHARED_LEVELS, TextureFormat, WIDE_TEXTURES, unknown,
};
use crate::prelude::*;
use crate::provenance::{self, Provenance};
use crate::record::*;
use crate::spread::{spread, threads};

/// All tables, lent from the file.
pub(crate) struct Tables<'a> {
    pub(crate) strings: Vec<&'a str>,
    pub(crate) level_header: LevelHeader,
    pub(crate) levels: &'a [LevelRecord],
    pub(crate) arrays: &'a [ArrayRecord],
    pub(crate) needs: &'a [u32],
    pub(crate) submeshes: &'a [SubmeshRecord],
    pub(crate) ranges: &'a [DrawRange],
    pub(crate) materials: &'a [MaterialRecord],
    pub(crate) textures: &'a [TextureRecord],
    pub(crate) mips: &'a [MipRecord],
    pub(crate) provenance: Option<Provenance>,
    /// `[levels.len()]`: all needed sections are at hand and sound.
    pub(crate) offered: Vec<bool>,
}

/// Cuts records off the front of a table.
struct Cutter<'a> {
    name: &'static str,
    rest: &'a [u8],
}

impl<'a> Cutter<'a> {
    fn take<T: Pod>(&mut self, count: u32, report: &mut CheckReport) -> Option<&'a [T]> {
        let bytes = (count as usize).checked_mul(size_of::<T>());
        match bytes.and_then(|bytes| self.rest.split_at_checked(bytes)) {
            Some((head, tail)) => {
                self.rest = tail;
                bytemuck::try_cast_slice(head).ok()
            }
            None => {
                let expected = format!("{count} records of {} bytes", size_of::<T>());
                let found = format!("{} bytes", self.rest.len());
                report.push(FormatError::new(Code::TableLength, self.name, expected, found));
                None
            }
        }
    }

    fn one<T: Pod>(&mut self, report: &mut CheckReport) -> Option<T> {
        self.take::<T>(1, report).and_then(|records| records.first().copied())
    }

    fn finish(self, report: &mut CheckReport) -> Option<()> {
        if self.rest.is_empty() {
            return Some(());
        }
        let found = format!("{} bytes more", self.rest.len());
        report.push(FormatError::new(Code::TableLength, self.name, "the end", found));
        None
    }
}

fn count(name: &str, found: u32, most: u32, report: &mut CheckReport) -> Option<()> {
    if found <= most {
        return Some(());
    }
    report.push(FormatError::new(Code::Count, name, format!("at most {most}"), found));
    None
}

fn sum(counts: impl Iterator<Item = u32>) -> u64 {
    counts.map(u64::from).sum()
}

/// Checks all tables against each other; whether they are sound.
pub(crate) fn check_tables(container: &Container<'_>, report: &mut CheckReport) -> bool {
    let before = report.count();
    let check = Check::new(container, &container.envelope.states);
    check.levels(report);
    check.submeshes(report);
    check.materials(report);
    check.textures(report);
    if report.count() != before {
        return false;
    }
    check.needs(report);
    check.order(report);
    check.layout_sections(report);
    report.count() == before
}

/// What looking at every byte of the payload showed.
pub(crate) struct Examined {
    /// By section.
    pub(crate) states: Vec<State>,
    /// By level: all needed sections are at hand and sound.
    pub(crate) offered: Vec<bool>,
}

/// Hashes and checks all payload at hand. The container's tables are sound. Without `whole`, what lies behind the end of a
/// prefix or is damaged is no finding: it is not offered.
pub(crate) fn examine(container: &Container<'_>, whole: bool, report: &mut CheckReport) -> Examined {
    let envelope = &container.envelope;
    let tables = &container.tables;
    let mut states = hashes(container, whole, report);
    let mut offered = vec![false; tables.levels.len()];
    let lengths: Vec<u64> = tables.levels.iter().map(|level| u64::from(level.triangles)).collect();
    let looked_at = spread(threads(envelope.bytes.len()), &lengths, |lod| {
        let needs = tables.level_needs(&tables.levels[lod]);
        let at_hand = needs.iter().all(|s| states.get(*s as usize) == Some(&State::Sound));
        let mut own = CheckReport::default();
        if at_hand {
            Check::new(container, &states).geometry(lod, &mut own);
        }
        (at_hand, own)
    });
    for (lod, (at_hand, own)) in looked_at.into_iter().enumerate() {
        offered[lod] = at_hand && own.is_sound();
        if whole {
            own.findings.into_iter().for_each(|finding| report.push(finding));
        }
    }
    let check = Check::new(container, &states);
    let mut damaged = Vec::new();
    let mut damage = |section: u32, finding: FormatError| {
        damaged.push(section as usize);
        if whole {
            report.push(finding);
        }
    };
    for (number, texture) in tables.textures.iter().enumerate() {
        if let Some(finding) = check.tail_padding(texture) {
            damage(texture.tail_section, finding);
        }
        if let Some((section, finding)) = check.texels_not_finite(number, texture) {
            damage(section, finding);
        }
    }
    for kind in Kind::LAYOUTS {
        let Some(section) = envelope.find(kind).filter(|section| states[*section as usize] == State::Sound) else {
            continue;
        };
        // A layout is over level 0; without it nothing can be said, nor drawn.
        let mut own = CheckReport::default();
        if offered.first() == Some(&true) {
            check.layout(kind, &mut own);
        } else if !whole {
            damage(section, FormatError::new(Code::Reference, "layout", "level 0", "none"));
        }
        own.findings.into_iter().for_each(|finding| damage(section, finding));
    }
    for section in damaged {
        states[section] = State::Absent;
    }
    Examined { states, offered }
}

/// Padding, stored hashes and raw hashes of payload: the states of all sections.
fn hashes(container: &Container<'_>, whole: bool, report: &mut CheckReport) -> Vec<State> {
    let envelope = &container.envelope;
    let mut states = envelope.states.clone();
    let payload: Vec<usize> =
        (0..envelope.entries.len()).filter(|number| !envelope::is_table(&envelope.entries[*number])).collect();
    let lengths: Vec<u64> = payload.iter().map(|number| envelope.entries[*number].stored_length).collect();
    let hashed = spread(threads(envelope.bytes.len()), &lengths, |i| {
        let (number, entry) = (payload[i], &envelope.entries[payload[i]]);
        let stored = envelope.section(number)?;
        Some(envelope::wrong_hash(number, entry, stored).or_else(|| match envelope.states[number] {
            State::Skipped => None,
            _ => wrong_raw(container, number, entry),
        }))
    });
    for (number, hashed) in payload.into_iter().zip(hashed) {
        if let Some(finding) = envelope::wrong_padding(envelope.bytes, envelope.entries, number) {
            report.push(finding);
        }
        let Some(finding) = hashed else { continue };
        match (finding, states[number]) {
            (None, State::Skipped) => {}
            (None, _) => states[number] = State::Sound,
            (Some(finding), _) => {
                states[number] = State::Absent;
                if whole {
                    report.push(finding);
                }
            }
        }
    }
    states
}

/// What is found against the decoded bytes of a coded section.
fn wrong_raw(container: &Container<'_>, number: usize, entry: &SectionEntry) -> Option<FormatError> {
    if entry.codec == crate::codec::NONE {
        return None;
    }
    let place = envelope::place(number, entry);
    let Some(raw) = container.raw(number) else {
        let codec = crate::kind::codec_name(entry.codec);
        return Some(FormatError::new(Code::Decode, place, format!("{} bytes in {codec}", entry.raw_length), "others"));
    };
    let found = blake3::hash(raw);
    (found.as_bytes() != &entry.raw_hash).then(|| {
        let expected = blake3::Hash::from_bytes(entry.raw_hash);
        FormatError::new(Code::RawHash, format!("{place}.raw_hash"), expected.to_hex(), found.to_hex())
    })
}

/// Cuts all tables; `None` if one is broken so that nothing can be lent.
pub(crate) fn read_tables<'a>(envelope: &Envelope<'a>, report: &mut CheckReport) -> Option<Tables<'a>> {
    let cutter = |kind: Kind, name| {
        let number = envelope.entries.iter().position(|entry| entry.kind == kind.0)?;
        (envelope.states[number] == State::Sound).then_some(())?;
        Some(Cutter { name, rest: envelope.section(number)? })
    };
    let strings = read_strings(cutter(Kind::STRINGS, "STRS")?, envelope.strict(), report);

    let mut table = cutter(Kind::LEVELS, "LEVL")?;
    let level_header: LevelHeader = table.one(report)?;
    count("LEVL.level_count", level_header.level_count, MAX_LEVELS, report)?;
    if level_header.level_count == 0 {
        report.push(FormatError::new(Code::Count, "LEVL.level_count", "at least 1", 0));
        return None;
    }
    let levels = table.take::<LevelRecord>(level_header.level_count, report)?;
    let arrays = table.take::<ArrayRecord>(level_header.array_count, report)?;
    let needs = table.take::<u32>(level_header.need_count, report)?;
    table.finish(report)?;

    let mut table = cutter(Kind::SUBMESHES, "SUBM")?;
    let header: SubmeshHeader = table.one(report)?;
    count("SUBM.submesh_count", header.submesh_count, MAX_SUBMESHES, report)?;
    if header.level_count != level_header.level_count {
        let expected = level_header.level_count;
        report.push(FormatError::new(Code::Count, "SUBM.level_count", expected, header.level_count));
        return None;
    }
    let submeshes = table.take::<SubmeshRecord>(header.submesh_count, report)?;
    let ranges = table.take::<DrawRange>(header.submesh_count.saturating_mul(header.level_count), report)?;
    table.finish(report)?;
    let mut reserved = vec![("SUBM.reserved", header.reserved)];

    let mut table = cutter(Kind::MATERIALS, "MATL")?;
    let header: CountHeader = table.one(report)?;
    count("MATL.count", header.count, MAX_MATERIALS, report)?;
    let materials = table.take::<MaterialRecord>(header.count, report)?;
    table.finish(report)?;
    reserved.push(("MATL.reserved", [header.reserved[0] | header.second_count, header.reserved[1]]));

    let mut table = cutter(Kind::TEXTURES, "TEXT")?;
    let header: CountHeader = table.one(report)?;
    count("TEXT.count", header.count, MAX_TEXTURES, report)?;
    let textures = table.take::<TextureRecord>(header.count, report)?;
    let mips = table.take::<MipRecord>(header.second_count, report)?;
    table.finish(report)?;
    reserved.push(("TEXT.reserved", header.reserved));
    for (place, reserved) in reserved {
        if envelope.strict() && reserved != [0; 2] {
            report.push(FormatError::new(Code::Reserved, place, "zero", "another value"));
        }
    }

    let provenance = match cutter(Kind::PROVENANCE, "PROV") {
        Some(table) => match provenance::read(table.rest, envelope.strict()) {
            Ok(provenance) => Some(provenance),
            Err(finding) => {
                report.push(finding);
                return None;
            }
        },
        None => None,
    };
    let inside = |section: &u32| envelope.states.get(*section as usize).is_some_and(|state| *state != State::Absent);
    let own = |level: &LevelRecord| slice(needs, level.first_need, level.need_count).iter().all(inside);
    let offered = levels.iter().map(own).collect();
    let strings = strings?;
    Some(Tables {
        strings,
        level_header,
        levels,
        arrays,
        needs,
        submeshes,
        ranges,
        materials,
        textures,
        mips,
        provenance,
        offered,
    })
}

fn read_strings<'a>(mut table: Cutter<'a>, strict: bool, report: &mut CheckReport) -> Option<Vec<&'a str>> {
    let header: CountHeader = table.one(report)?;
    // Every string takes at least the 4 bytes of its length.
    count("STRS.count", header.count, MAX_STRINGS.min((table.rest.len() / 4) as u32), report)?;
    if strict && (header.second_count != 0 || header.reserved != [0; 2]) {
        report.push(FormatError::new(Code::Reserved, "STRS.reserved", "zero", "another value"));
    }
    let mut strings = Vec::with_capacity(header.count as usize);
    for number in 0..header.count {
        match provenance::cut_string(&mut table.rest, &format!("strings[{number}]")) {
            Ok(string) => strings.push(string),
            Err(finding) => {
                report.push(finding);
                return None;
            }
        }
    }
    table.finish(report)?;
    Some(strings)
}

impl<'a> Tables<'a> {
    /// The array records of a level; empty where the record points outside.
    pub(crate) fn level_arrays(&self, level: &LevelRecord) -> &'a [ArrayRecord] {
        slice(self.arrays, level.first_array, level.array_count)
    }

    /// The needed sections of a level.
    pub(crate) fn level_needs(&self, level: &LevelRecord) -> &'a [u32] {
        slice(self.needs, level.first_need, level.need_count)
    }

    /// The draw ranges of a level, by submesh.
    pub(crate) fn level_ranges(&self, lod: usize) -> &'a [DrawRange] {
        let count = self.submeshes.len();
        self.ranges.get(lod * count..(lod + 1) * count).unwrap_or(&[])
    }

    /// The mips of a texture.
    pub(crate) fn texture_mips(&self, texture: &TextureRecord) -> &'a [MipRecord] {
        slice(self.mips, texture.first_mip, texture.mip_count)
    }
}

fn slice<T>(all: &[T], first: u32, count: u32) -> &[T] {
    let first = first as usize;
    all.get(first..first.saturating_add(count as usize)).unwrap_or(&[])
}

/// Number of mips of a full chain, down to 1x1.
pub fn full_mip_count(width: u32, height: u32) -> u32 {
    32 - width.max(height).max(1).leading_zeros()
}

pub(crate) struct Check<'e, 'a> {
    container: &'e Container<'a>,
    envelope: &'e Envelope<'a>,
    tables: &'e Tables<'a>,
    states: &'e [State],
    strict: bool,
}

impl<'e, 'a> Check<'e, 'a> {
    fn new(container: &'e Container<'a>, states: &'e [State]) -> Check<'e, 'a> {
        let (envelope, tables) = (&container.envelope, &container.tables);
        Check { container, envelope, tables, states, strict: envelope.strict() }
    }

    /// The decoded bytes of a section that is at hand.
    fn raw(&self, section: u32) -> Option<&'e [u8]> {
        (*self.states.get(section as usize)? != State::Absent).then_some(())?;
        self.container.raw(section as usize)
    }

    fn is_kind(&self, section: u32, kind: Kind) -> bool {
        self.envelope.entries.get(section as usize).is_some_and(|entry| entry.kind == kind.0)
    }

    fn section(&self, at: String, section: u32, kind: Kind, report: &mut CheckReport) {
        if !self.is_kind(section, kind) {
            report.push(FormatError::new(Code::Reference, at, format!("the number of a {kind} section"), section));
        }
    }

    fn string(&self, at: String, string: u32, report: &mut CheckReport) {
        let count = self.tables.strings.len();
        if string as usize >= count {
            report.push(FormatError::new(Code::Reference, at, format!("a string below {count}"), string));
        }
    }

    fn reserved(&self, at: impl Fn() -> String, zero: bool, report: &mut CheckReport) {
        if self.strict && !zero {
            report.push(FormatError::new(Code::Reserved, format!("{}.reserved", at()), "zero", "another value"));
        }
    }

    fn finite(&self, at: impl Fn() -> String, values: &[f32], report: &mut CheckReport) {
        if let Some(value) = values.iter().find(|value| !value.is_finite()) {
            report.push(FormatError::new(Code::NotFinite, at(), "a finite number", value));
        }
    }

    fn levels(&self, report: &mut CheckReport) {
        let t = self.tables;
        let h = &t.level_header;
        let layout = [h.layout_size, h.layout_padding, h.layout_charts];
        if h.has_layout > 1 || (h.has_layout == 0 && layout != [0; 3]) {
            report.push(FormatError::new(Code::Value, "LEVL.has_layout", "0 with zeros behind it, or 1", h.has_layout));
        }
        let (mut first_array, mut first_need, mut last_error) = (0u64, 0u64, 0.0f32);
        for (lod, level) in t.levels.iter().enumerate() {
            let at = |field: &str| format!("levels[{lod}].{field}");
            self.finite(|| at("error"), &[level.error], report);
            self.finite(|| at("bounds"), &[level.bounds_min, level.bounds_max].concat(), report);
            if level.error < last_error {
                report.push(FormatError::new(
                    Code::LevelError,
                    at("error"),
                    format!("at least {last_error}"),
                    level.error,
                ));
            }
            last_error = last_error.max(level.error);
            if ErrorKind::from_number(level.error_kind).is_none() {
                report.push(unknown(at("error_kind"), "error kind", level.error_kind));
            }
            count(&at("triangles"), level.triangles, MAX_ELEMENTS, report);
            count(&at("vertices"), level.vertices, MAX_ELEMENTS, report);
            self.section(at("vertex_section"), level.vertex_section, Kind::VERTICES, report);
            self.section(at("index_section"), level.index_section, Kind::INDICES, report);
            let width = if level.vertices <= MAX_U16_VERTICES { 2 } else { 4 };
            if level.index_width != width {
                report.push(FormatError::new(Code::IndexWidth, at("index_width"), width, level.index_width));
            }
            if level.first_array as u64 != first_array || level.first_need as u64 != first_need {
                let expected = format!("array {first_array} and need {first_need}");
                let found = format!("array {} and need {}", level.first_array, level.first_need);
                report.push(FormatError::new(Code::Reference, at("first_array"), expected, found));
            }
            first_array += level.array_count as u64;
            first_need += level.need_count as u64;
            if level.layout_sheets != t.levels[0].layout_sheets
                || level.layout_sheets == 1
                || (level.layout_sheets != 0 && h.has_layout == 0)
            {
                let expected = "0 or, with a layout, the same number above 1 at every level";
                report.push(FormatError::new(Code::Value, at("layout_sheets"), expected, level.layout_sheets));
            }
            let sheets_ok = level.layout_sheets == 0 || self.envelope.minor > 0;
            self.reserved(|| format!("levels[{lod}]"), sheets_ok && level.reserved == [0; 6], report);
        }
        if first_array != t.arrays.len() as u64 || first_need != t.needs.len() as u64 {
            let expected = format!("{first_array} arrays and {first_need} needs in all");
            let found = format!("{} and {}", t.arrays.len(), t.needs.len());
            report.push(FormatError::new(Code::Reference, "LEVL", expected, found));
        }
    }

    fn submeshes(&self, report: &mut CheckReport) {
        let t = self.tables;
        for (number, submesh) in t.submeshes.iter().enumerate() {
            let at = |field: &str| format!("submeshes[{number}].{field}");
            self.string(at("name"), submesh.name, report);
            if submesh.material != NONE && submesh.material as usize >= t.materials.len() {
                let expected = format!("a material below {}", t.materials.len());
                report.push(FormatError::new(Code::Reference, at("material"), expected, submesh.material));
            }
            if submesh.attributes & !crate::ATTRIBUTE_BITS != 0 {
                let found = format!("{:#x}", submesh.attributes);
                report.push(FormatError::new(Code::Value, at("attributes"), "registered bits", found));
            }
            self.reserved(|| format!("submeshes[{number}]"), submesh.reserved == [0; 4], report);
        }
        for (lod, level) in t.levels.iter().enumerate() {
            let mut next = 0u64;
            for (number, range) in t.level_ranges(lod).iter().enumerate() {
                let at = |field: &str| format!("levels[{lod}].ranges[{number}].{field}");
                if range.first_index as u64 != next || range.index_count % 3 != 0 {
                    let expected = format!("whole triangles from index {next}");
                    let found = format!("{} from {}", range.index_count, range.first_index);
                    report.push(FormatError::new(Code::Ranges, at("first_index"), expected, found));
                }
                next += range.index_count as u64;
                self.finite(|| at("bounds"), &[range.bounds_min, range.bounds_max].concat(), report);
                self.reserved(|| format!("levels[{lod}].ranges[{number}]"), range.reserved == [0; 2], report);
            }
            if next != level.triangles as u64 * 3 {
                let expected = format!("{} indices in all", level.triangles as u64 * 3);
                report.push(FormatError::new(Code::Ranges, format!("levels[{lod}].ranges"), expected, next));
            }
        }
    }

    fn materials(&self, report: &mut CheckReport) {
        let t = self.tables;
        let mut roles = vec![0u32; t.textures.len()];
        for (number, m) in t.materials.iter().enumerate() {
            let at = |field: &str| format!("materials[{number}].{field}");
            let mut domain = |ok: bool, field: &str, expected: &str, found: f32| {
                if !ok {
                    report.push(FormatError::new(Code::Value, at(field), expected, found));
                }
            };
            domain(m.alpha_mode <= 2, "alpha_mode", "0, 1 or 2", m.alpha_mode as f32);
            domain(m.flags <= 1, "flags", "bit 0 only", m.flags as f32);
            domain(m.alpha_cutoff >= 0.0 || m.alpha_cutoff.is_nan(), "alpha_cutoff", "0 or more", m.alpha_cutoff);
            self.string(at("name"), m.name, report);
            self.finite(|| at("base_color_factor"), &m.base_color_factor, report);
            self.finite(|| at("emissive_factor"), &m.emissive_factor, report);
            let factors = [m.alpha_cutoff, m.metallic_factor, m.roughness_factor, m.normal_scale, m.occlusion_strength];
            self.finite(|| at("factors"), &factors, report);
            self.reserved(|| format!("materials[{number}]"), m.reserved == 0, report);
            for (role, slot) in Role::ALL.iter().zip(&m.slots) {
                self.slot(format!("materials[{number}].{}", role.name()), *role, slot, &mut roles, report);
            }
        }
        for (number, (texture, used)) in t.textures.iter().zip(&roles).enumerate() {
            let extra = Extra::from_roles(texture.roles).filter(|_| *used == 0 && self.wide_textures());
            if texture.roles != *used && extra.is_none() {
                let at = format!("textures[{number}].roles");
                report.push(FormatError::new(Code::Role, at, format!("{used:#x}"), format!("{:#x}", texture.roles)));
            }
            let format = TextureFormat::from_number(texture.format);
            if extra.is_some() && format.is_some_and(|format| !Extra::FORMATS.contains(&format)) {
                let found = format.map_or("another", TextureFormat::name);
                let at = format!("textures[{number}].format");
                report.push(FormatError::new(Code::Role, at, "a texture in linear texels, not in blocks", found));
            }
        }
    }

    fn slot(&self, at: String, role: Role, slot: &SlotRecord, roles: &mut [u32], report: &mut CheckReport) {
        if slot.texture == NONE {
            let rest = &bytemuck::bytes_of(slot)[4..];
            if let Some((_, byte)) = first_nonzero(rest) {
                report.push(FormatError::new(Code::Value, at, "zeros in an empty slot", byte));
            }
            return;
        }
        self.finite(|| format!("{at}.uv"), &[slot.uv_offset, slot.uv_scale, [slot.uv_rotation, 0.0]].concat(), report);
        let sampler_ok = slot.wrap_u <= 2 && slot.wrap_v <= 2 && slot.mag <= 1 && slot.min <= 1 && slot.mip <= 2;
        if slot.uv_set > 1 || !sampler_ok {
            report.push(FormatError::new(Code::Value, &*at, "registered UV set and sampler values", "another"));
        }
        self.reserved(|| at.clone(), slot.reserved0 == [0; 3] && slot.reserved1 == [0; 3], report);
        let textures = self.tables.textures;
        let Some(texture) = textures.get(slot.texture as usize) else {
            let expected = format!("a texture below {}", textures.len());
            report.push(FormatError::new(Code::Reference, at, expected, slot.texture));
            return;
        };
        roles[slot.texture as usize] |= 1 << role.number();
        let format = TextureFormat::from_number(texture.format);
        if !format.is_some_and(|format| role.formats().contains(&format)) {
            let names: Vec<&str> = role.formats().iter().map(|format| format.name()).collect();
            let found = format.map_or("another", TextureFormat::name);
            report.push(FormatError::new(Code::Role, at, format!("a texture in {}", names.join(" or ")), found));
        }
    }

    /// Whether levels may have the first elements of level 0's arrays.
    fn shared_levels(&self) -> bool {
        self.envelope.entries.iter().any(|e| e.kind == Kind::LEVELS.0 && e.version >= SHARED_LEVELS)
    }

    /// Whether the texture table is of the version with deep and compressed formats and extras.
    fn wide_textures(&self) -> bool {
        self.envelope.entries.iter().any(|e| e.kind == Kind::TEXTURES.0 && e.version >= WIDE_TEXTURES)
    }

    fn textures(&self, report: &mut CheckReport) {
        let t = self.tables;
        let wide = self.wide_textures();
        let mut first_mip = 0u64;
        for (number, texture) in t.textures.iter().enumerate() {
            let at = |field: &str| format!("textures[{number}].{field}");
            self.string(at("name"), texture.name, report);
            let Some(format) = TextureFormat::from_number(texture.format).filter(|f| wide || f.is_first()) else {
                report.push(unknown(at("format"), "texture format", texture.format));
                first_mip += texture.mip_count as u64;
                continue;
            };
            for channel in texture.channels {
                if Channel::from_number(channel as u32).is_none_or(|c| !wide && c > Channel::Occlusion) {
                    report.push(unknown(at("channels"), "channel", channel as u32));
                }
            }
            let size_ok = |size: u32| (1..=MAX_TEXTURE_SIZE).contains(&size);
            if !size_ok(texture.width) || !size_ok(texture.height) {
                let found = format!("{} x {}", texture.width, texture.height);
                report.push(FormatError::new(Code::Count, at("width"), format!("1 to {MAX_TEXTURE_SIZE}"), found));
                continue;
            }
            let most = full_mip_count(texture.width, texture.height);
            let counts_ok = (1..=most).contains(&texture.mip_count) && texture.tail_first < texture.mip_count;
            if !counts_ok || texture.first_mip as u64 != first_mip {
                let expected = format!("1 to {most} mips from {first_mip} with a tail");
                let found = format!("{} from {}, tail at {}", texture.mip_count, texture.first_mip, texture.tail_first);
                report.push(FormatError::new(Code::Mips, at("mip_count"), expected, found));
                continue;
            }
            first_mip += texture.mip_count as u64;
            self.section(at("tail_section"), texture.tail_section, Kind::MIP_TAIL, report);
            let sheet_ok = texture.sheet == 0 || (wide && Extra::from_roles(texture.roles).is_some());
            self.reserved(|| format!("textures[{number}]"), sheet_ok && texture.reserved == [0; 5], report);
            self.mips(number, texture, format, report);
        }
        if first_mip != t.mips.len() as u64 && sum(t.textures.iter().map(|x| x.mip_count)) != t.mips.len() as u64 {
            report.push(FormatError::new(Code::Mips, "TEXT", format!("{first_mip} mips in all"), t.mips.len()));
        }
    }

    fn mips(&self, number: usize, texture: &TextureRecord, format: TextureFormat, report: &mut CheckReport) {
        let mut tail_end = 0u64;
        for (k, mip) in self.tables.texture_mips(texture).iter().enumerate() {
            let at = format!("textures[{number}].mips[{k}]");
            let size = ((texture.width >> k).max(1), (texture.height >> k).max(1));
            let length = format.mip_length(size.0, size.1);
            let in_tail = k as u32 >= texture.tail_first;
            let kind = if in_tail { Kind::MIP_TAIL } else { Kind::MIP };
            self.section(format!("{at}.section"), mip.section, kind, report);
            self.reserved(|| at.clone(), mip.reserved == 0, report);
            let offset = if in_tail { tail_end.next_multiple_of(PAYLOAD_ALIGNMENT as u64) } else { 0 };
            if (mip.width, mip.height, mip.length, mip.offset) != (size.0, size.1, length, offset)
                || (in_tail && mip.section != texture.tail_section)
            {
                let expected = format!("{} x {}, {length} bytes at {offset}", size.0, size.1);
                let found = format!("{} x {}, {} bytes at {}", mip.width, mip.height, mip.length, mip.offset);
                report.push(FormatError::new(Code::Mips, &*at, expected, found));
            }
            if in_tail {
                tail_end = offset + length;
            } else {
                self.section_length(&at, mip.section, length, report);
            }
        }
        self.section_length(&format!("textures[{number}].tail_section"), texture.tail_section, tail_end, report);
    }

    fn section_length(&self, at: &str, section: u32, length: u64, report: &mut CheckReport) {
        if let Some(entry) = self.envelope.entries.get(section as usize)
            && entry.raw_length != length
        {
            let found = format!("{} bytes", entry.raw_length);
            report.push(FormatError::new(Code::Mips, at, format!("a section of {length} bytes"), found));
        }
    }

    /// The sections a level needs, ascending: geometry, and the tails of the textures of its drawn submeshes.
    fn needed(&self, lod: usize) -> Vec<u32> {
        let t = self.tables;
        let level = &t.levels[lod];
        let mut needs = vec![level.vertex_section, level.index_section];
        for (submesh, range) in t.submeshes.iter().zip(t.level_ranges(lod)) {
            let material = (range.index_count > 0).then(|| t.materials.get(submesh.material as usize)).flatten();
            for slot in material.iter().flat_map(|m| &m.slots) {
                needs.extend(t.textures.get(slot.texture as usize).map(|texture| texture.tail_section));
            }
        }
        needs.sort_unstable();
        needs.dedup();
        needs
    }

    fn needs(&self, report: &mut CheckReport) {
        for (lod, level) in self.tables.levels.iter().enumerate() {
            let expected = self.needed(lod);
            let found = self.tables.level_needs(level);
            if expected != found {
                let at = format!("levels[{lod}].needs");
                report.push(FormatError::new(Code::Needs, at, format!("{expected:?}"), format!("{found:?}")));
            }
        }
    }

    /// Payload stands in canonical order, every section of it used, no mip section twice.
    fn order(&self, report: &mut CheckReport) {
        let t = self.tables;
        let mut seen = vec![false; self.envelope.entries.len()];
        let mut order = Vec::new();
        let mut list = |section: u32, once: bool, report: &mut CheckReport| match seen.get_mut(section as usize) {
            Some(seen) if !*seen => {
                *seen = true;
                order.push(section);
            }
            _ if once => {
                let at = format!("section {section}");
                report.push(FormatError::new(Code::Reference, at, "a section of one texture's mip", "two uses"));
            }
            _ => {}
        };
        for (lod, level) in t.levels.iter().enumerate().rev() {
            list(level.vertex_section, false, report);
            list(level.index_section, false, report);
            for submesh_tail in t.textures.iter().map(|texture| texture.tail_section) {
                if t.level_needs(&t.levels[lod]).binary_search(&submesh_tail).is_ok() {
                    list(submesh_tail, false, report);
                }
            }
        }
        t.textures.iter().for_each(|texture| list(texture.tail_section, false, report));
        Kind::LAYOUTS.iter().filter_map(|kind| self.envelope.find(*kind)).for_each(|s| list(s, false, report));
        let mut large: Vec<(u64, usize, u32)> = Vec::new();
        for (number, texture) in t.textures.iter().enumerate() {
            let mips = t.texture_mips(texture);
            large.extend(mips[..texture.tail_first as usize].iter().map(|mip| (mip.length, number, mip.section)));
        }
        large.sort_unstable();
        large.iter().for_each(|(_, _, section)| list(*section, true, report));
        let mut tails: Vec<u32> = t.textures.iter().map(|texture| texture.tail_section).collect();
        tails.sort_unstable();
        if let Some(pair) = tails.windows(2).find(|pair| pair[0] == pair[1]) {
            let at = format!("section {}", pair[0]);
            report.push(FormatError::new(Code::Reference, at, "the tail of one texture", "two uses"));
        }
        if let Some(pair) = order.windows(2).find(|pair| pair[0] >= pair[1]) {
            let expected = format!("behind section {}", pair[0]);
            report.push(FormatError::new(Code::Order, format!("section {}", pair[1]), expected, "before it"));
        }
        for (number, entry) in self.envelope.entries.iter().enumerate() {
            let payload = Kind(entry.kind).row().is_some_and(|row| row.rank >= crate::kind::PAYLOAD_RANK);
            if payload && !seen[number] {
                let at = crate::envelope::place(number, entry);
                report.push(FormatError::new(Code::Unreferenced, at, "a table that uses it", "none"));
            }
        }
    }
}
