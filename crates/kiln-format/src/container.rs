//! A checked container whose tables and arrays are lent from the caller's bytes.

use crate::codec;
use crate::content::{self, Tables};
use crate::envelope::{self, Envelope, State};
use crate::error::{CheckReport, FormatError};
use crate::kind::{Kind, Semantic, VertexFormat};
use crate::layout::{self, Layouts};
use crate::prelude::*;
use crate::provenance::Provenance;
use crate::record::*;
use crate::spread::{spread, threads};

/// A container whose tables are sound: every index in them is in range, every number finite, every section inside the file.
/// [`Container::open`] and [`Container::validate`] say the same of the payload. All accessors check bounds, so that payload that
/// nobody validated may hold wrong values but leads no reader astray.
pub struct Container<'a> {
    pub(crate) envelope: Envelope<'a>,
    pub(crate) tables: Tables<'a>,
    #[cfg(feature = "codecs")]
    decoded: codec::Decoded,
}

/// A section as the table tells it.
#[derive(Clone, Copy, Debug)]
pub struct Section<'a> {
    /// Its place in the table.
    pub number: u32,
    /// Its kind.
    pub kind: Kind,
    /// The entry.
    pub entry: &'a SectionEntry,
}

/// The indices of a level in the width that its vertex count asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Indices<'a> {
    /// Up to 65,535 vertices.
    U16(&'a [u16]),
    /// More.
    U32(&'a [u32]),
}

impl<'a> Indices<'a> {
    /// Number of indices: three a triangle.
    pub fn len(self) -> usize {
        match self {
            Indices::U16(indices) => indices.len(),
            Indices::U32(indices) => indices.len(),
        }
    }

    /// Whether there are none.
    pub fn is_empty(self) -> bool {
        self.len() == 0
    }

    /// Index number `i`.
    pub fn get(self, i: usize) -> Option<u32> {
        match self {
            Indices::U16(indices) => indices.get(i).map(|v| *v as u32),
            Indices::U32(indices) => indices.get(i).copied(),
        }
    }

    /// All indices, widened.
    pub fn iter(self) -> impl Iterator<Item = u32> + 'a {
        (0..self.len()).filter_map(move |i| self.get(i))
    }

    /// The bytes, to upload them.
    pub fn bytes(self) -> &'a [u8] {
        match self {
            Indices::U16(indices) => bytemuck::cast_slice(indices),
            Indices::U32(indices) => bytemuck::cast_slice(indices),
        }
    }
}

/// One level whose geometry is at hand.
#[derive(Clone, Copy)]
pub struct LevelView<'a> {
    /// Its record.
    pub record: &'a LevelRecord,
    /// `[submesh_count]`, what to draw for each submesh.
    pub ranges: &'a [DrawRange],
    arrays: &'a [ArrayRecord],
    vertices: &'a [u8],
    indices: &'a [u8],
}

impl<'a> LevelView<'a> {
    /// The bytes of an array and its format.
    pub fn array(&self, semantic: Semantic) -> Option<(VertexFormat, &'a [u8])> {
        let array = self.arrays.iter().find(|array| array.semantic == semantic.number())?;
        let start = usize::try_from(array.offset).ok()?;
        let end = start.checked_add(usize::try_from(array.length).ok()?)?;
        Some((VertexFormat::from_number(array.format)?, self.vertices.get(start..end)?))
    }

    fn typed<T: bytemuck::Pod>(&self, semantic: Semantic) -> Option<&'a [T]> {
        bytemuck::try_cast_slice(self.array(semantic)?.1).ok()
    }

    /// `[vertex_count]`, object space, metres.
    pub fn positions(&self) -> &'a [[f32; 3]] {
        self.typed(Semantic::Positions).unwrap_or(&[])
    }

    /// `[vertex_count]`, unit length, object space.
    pub fn normals(&self) -> Option<&'a [[f32; 3]]> {
        self.typed(Semantic::Normals)
    }

    /// `[vertex_count]`, xyz unit tangent in object space, w = +1 or -1; bitangent = w cross(n, t).
    pub fn tangents(&self) -> Option<&'a [[f32; 4]]> {
        self.typed(Semantic::Tangents)
    }

    /// `[vertex_count]`, first UV set, V downwards.
    pub fn uv0(&self) -> Option<&'a [[f32; 2]]> {
        self.typed(Semantic::Uv0)
    }

    /// `[vertex_count]`, second UV set.
    pub fn uv1(&self) -> Option<&'a [[f32; 2]]> {
        self.typed(Semantic::Uv1)
    }

    /// `[vertex_count]`, linear RGBA.
    pub fn colors(&self) -> Option<&'a [[f32; 4]]> {
        self.typed(Semantic::Colors)
    }

    /// `[vertex_count] x 4` joint indices.
    pub fn joints(&self) -> Option<&'a [[u16; 4]]> {
        self.typed(Semantic::Joints)
    }

    /// `[vertex_count] x 4` joint weights.
    pub fn weights(&self) -> Option<&'a [[f32; 4]]> {
        self.typed(Semantic::Weights)
    }

    /// `[triangle_count * 3]`, counter-clockwise front faces; base vertex is 0.
    pub fn indices(&self) -> Indices<'a> {
        match self.record.index_width {
            2 => Indices::U16(bytemuck::try_cast_slice(self.indices).unwrap_or(&[])),
            _ => Indices::U32(bytemuck::try_cast_slice(self.indices).unwrap_or(&[])),
        }
    }
}

impl<'a> Container<'a> {
    /// The container in `bytes`, which must be the whole file and lie on a multiple of 16 (see [`crate::AlignedBytes`]).
    /// Everything is checked, all hashes included; nothing is copied but table of strings and provenance, and coded sections,
    /// which are decoded on up to two threads.
    ///
    /// # Errors
    /// The first finding of [`check`].
    pub fn open(bytes: &'a [u8]) -> Result<Container<'a>, FormatError> {
        let container = Container::open_tables(bytes)?;
        container.validate()?;
        Ok(container)
    }

    /// As [`Container::open`], without a look at the payload: time and memory are those of header and tables, which are
    /// checked and hashed. [`Container::validate`] does the rest.
    ///
    /// # Errors
    /// The first finding against header, section table or tables.
    pub fn open_tables(bytes: &'a [u8]) -> Result<Container<'a>, FormatError> {
        let mut report = CheckReport::default();
        let container = read(bytes, true, &mut report);
        first(report, container)
    }

    /// Whether all payload is what its hashes say, and what the format promises. Coded sections are decoded, on up to two
    /// threads, and kept.
    ///
    /// # Errors
    /// The first finding of [`check`] against payload.
    pub fn validate(&self) -> Result<(), FormatError> {
        let mut report = CheckReport::default();
        self.decode(threads(self.envelope.bytes.len()));
        content::examine(self, true, &mut report);
        first(report, Some(()))
    }

    /// The container whose first bytes are `bytes`. Header, section table and tables must be whole; levels, layouts and mips
    /// whose sections do not lie inside, or are damaged, are not offered.
    ///
    /// # Errors
    /// A finding against header, section table or tables.
    pub fn open_prefix(bytes: &'a [u8]) -> Result<Container<'a>, FormatError> {
        let mut report = CheckReport::default();
        let container = read(bytes, false, &mut report);
        let container = container.filter(|_| report.is_sound()).map(|mut container| {
            let examined = content::examine(&container, false, &mut report);
            container.envelope.states = examined.states;
            container.tables.offered = examined.offered;
            container
        });
        first(report, container)
    }

    /// Decodes all coded sections at hand that are not decoded yet, on up to `threads` threads. Otherwise each is decoded when
    /// it is first asked for. The result does not depend on it.
    pub fn decode(&self, threads: usize) {
        let coded = |(_, entry): &(usize, &SectionEntry)| entry.codec != codec::NONE;
        let sections: Vec<(usize, u64)> =
            self.envelope.entries.iter().enumerate().filter(coded).map(|(n, entry)| (n, entry.raw_length)).collect();
        let lengths: Vec<u64> = sections.iter().map(|(_, length)| *length).collect();
        spread(threads, &lengths, |i| self.raw(sections[i].0).is_some());
    }

    /// The decoded bytes of a section that is at hand; nothing for skipped ones, whose meaning is not known, unless they have
    /// codec `none`.
    pub(crate) fn raw(&self, number: usize) -> Option<&[u8]> {
        let entry = self.envelope.entries.get(number)?;
        let stored = self.envelope.section(number)?;
        if entry.codec == codec::NONE {
            return Some(stored);
        }
        #[cfg(feature = "codecs")]
        if self.envelope.states[number] != State::Skipped {
            return self.decoded.get(number, || {
                let user =
                    |level: &&LevelRecord| [level.vertex_section, level.index_section].contains(&(number as u32));
                // The finest level has all elements of a shared section.
                let level = self.tables.levels.iter().find(user);
                let arrays = level.map_or(&[][..], |level| self.tables.level_arrays(level));
                let width = level.map_or(0, |level| level.index_width);
                codec::decode(entry.codec, stored, entry.raw_length, arrays, width)
            });
        }
        None
    }

    /// Major and minor version of the file.
    pub fn version(&self) -> (u16, u16) {
        (MAJOR, self.envelope.minor)
    }

    /// Bytes of the whole file, also where only a prefix is at hand.
    pub fn file_length(&self) -> u64 {
        let last = self.envelope.entries.last();
        last.map_or(HEADER_SIZE as u64, |entry| entry.offset + entry.stored_length)
    }

    /// Every section, in file order.
    pub fn sections(&self) -> impl Iterator<Item = Section<'a>> {
        let entries = self.envelope.entries;
        entries.iter().enumerate().map(|(number, entry)| Section {
            number: number as u32,
            kind: Kind(entry.kind),
            entry,
        })
    }

    /// The stored bytes of a section, if it is at hand; private sections are lent like any other.
    pub fn section_bytes(&self, number: u32) -> Option<&'a [u8]> {
        self.envelope.section(number as usize)
    }

    /// The bytes that a section holds, decoded if it is coded; nothing for coded sections of a kind that is not known here.
    pub fn raw_bytes(&self, number: u32) -> Option<&[u8]> {
        self.raw(number as usize)
    }

    /// The layouts beside the discrete levels, as far as they are at hand.
    pub fn layouts(&self) -> Layouts<'_> {
        let raw = |kind| {
            let number = self.envelope.find(kind)? as usize;
            (self.envelope.states[number] != State::Skipped).then_some(())?;
            self.raw(number)
        };
        Layouts {
            window: raw(Kind::WINDOW).and_then(layout::cut_window).map(|cut| cut.0),
            tree_leaf: raw(Kind::TREE).zip(raw(Kind::LEAF)).and_then(|(t, l)| layout::cut_tree(t, l)).map(|cut| cut.0),
            compact_tree: raw(Kind::COMPACT_TREE).and_then(layout::cut_compact_tree).map(|cut| cut.0),
            clusters: raw(Kind::CLUSTERS).and_then(layout::cut_clusters).map(|cut| cut.0),
        }
    }

    /// A string of the table, empty for a number out of range.
    pub fn string(&self, number: u32) -> &'a str {
        self.tables.strings.get(number as usize).copied().unwrap_or("")
    }

    /// Facts that hold for all levels.
    pub fn level_header(&self) -> &LevelHeader {
        &self.tables.level_header
    }

    /// `[level_count]`, finest first, also those that are not at hand.
    pub fn level_records(&self) -> &'a [LevelRecord] {
        self.tables.levels
    }

    /// Whether the geometry and mip tails of a level are at hand; nothing is decoded to tell.
    pub fn is_at_hand(&self, lod: usize) -> bool {
        self.tables.offered.get(lod) == Some(&true)
    }

    /// A level, if its geometry and mip tails are at hand. Coded geometry is decoded on first use.
    pub fn level(&self, lod: usize) -> Option<LevelView<'_>> {
        if !*self.tables.offered.get(lod)? {
            return None;
        }
        let record = self.tables.levels.get(lod)?;
        Some(LevelView {
            record,
            ranges: self.tables.level_ranges(lod),
            arrays: self.tables.level_arrays(record),
            vertices: self.raw(record.vertex_section as usize)?,
            indices: self.raw(record.index_section as usize)?,
        })
    }

    /// The numbers of the sections that a level needs, ascending.
    pub fn level_needs(&self, lod: usize) -> &'a [u32] {
        self.tables.levels.get(lod).map_or(&[], |record| self.tables.level_needs(record))
    }

    /// `[submesh_count]`.
    pub fn submeshes(&self) -> &'a [SubmeshRecord] {
        self.tables.submeshes
    }

    /// `[submesh_count]`, what to draw at a level; known also where the level is not at hand.
    pub fn level_ranges(&self, lod: usize) -> &'a [DrawRange] {
        self.tables.level_ranges(lod)
    }

    /// `[material_count]`.
    pub fn materials(&self) -> &'a [MaterialRecord] {
        self.tables.materials
    }

    /// `[texture_count]`.
    pub fn textures(&self) -> &'a [TextureRecord] {
        self.tables.textures
    }

    /// The mip records of a texture, largest first.
    pub fn mips(&self, texture: usize) -> &'a [MipRecord] {
        self.tables.textures.get(texture).map_or(&[], |record| self.tables.texture_mips(record))
    }

    /// The texels of a mip, rows without gap, if its section is at hand.
    pub fn mip(&self, texture: usize, mip: usize) -> Option<&[u8]> {
        let record = self.mips(texture).get(mip)?;
        let start = usize::try_from(record.offset).ok()?;
        let end = start.checked_add(usize::try_from(record.length).ok()?)?;
        self.raw(record.section as usize)?.get(start..end)
    }

    /// What made the file, if it says so.
    pub fn provenance(&self) -> Option<&Provenance> {
        self.tables.provenance.as_ref()
    }
}

/// Threads to decode on: two if the machine has them. More would take what its owner runs beside.
/// Header, section table and tables.
fn read<'a>(bytes: &'a [u8], whole: bool, report: &mut CheckReport) -> Option<Container<'a>> {
    let envelope = envelope::read(bytes, whole, report)?;
    let tables = content::read_tables(&envelope, report)?;
    #[cfg(feature = "codecs")]
    let decoded = codec::Decoded::new(envelope.entries.len());
    let container = Container {
        envelope,
        tables,
        #[cfg(feature = "codecs")]
        decoded,
    };
    content::check_tables(&container, report).then_some(container)
}

fn first<T>(report: CheckReport, value: Option<T>) -> Result<T, FormatError> {
    match report.findings.into_iter().next() {
        Some(finding) => Err(finding),
        None => value.ok_or_else(|| FormatError::new(crate::Code::Missing, "tables", "all tables", "none")),
    }
}

/// Every failed check of the file in `bytes`, whatever its place in memory.
pub fn check(bytes: &[u8]) -> CheckReport {
    if !(bytes.as_ptr() as usize).is_multiple_of(crate::kind::TABLE_ALIGNMENT as usize) {
        return check(&crate::AlignedBytes::copy_of(bytes));
    }
    let mut report = CheckReport::default();
    if let Some(container) = read(bytes, true, &mut report) {
        container.decode(threads(bytes.len()));
        content::examine(&container, true, &mut report);
    }
    report
}
