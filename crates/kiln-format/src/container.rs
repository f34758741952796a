//! A checked container whose tables and arrays are lent from the caller's bytes.

use crate::content::{self, Tables};
use crate::envelope::{self, Envelope};
use crate::error::{CheckReport, FormatError};
use crate::kind::{Kind, Semantic, VertexFormat};
use crate::provenance::Provenance;
use crate::record::*;

/// A container, validated: every index in its tables is in range, every number finite, every byte accounted for.
pub struct Container<'a> {
    envelope: Envelope<'a>,
    tables: Tables<'a>,
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
    /// Everything is checked, all hashes included; nothing is copied but table of strings and provenance.
    ///
    /// # Errors
    /// The first finding of [`check`].
    pub fn open(bytes: &'a [u8]) -> Result<Container<'a>, FormatError> {
        read(bytes, true)
    }

    /// The container whose first bytes are `bytes`. Header, section table and tables must be whole; levels and mips whose
    /// sections do not lie inside, or are damaged, are not offered.
    ///
    /// # Errors
    /// A finding against header, section table or tables.
    pub fn open_prefix(bytes: &'a [u8]) -> Result<Container<'a>, FormatError> {
        read(bytes, false)
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

    /// A level, if its geometry and mip tails are at hand.
    pub fn level(&self, lod: usize) -> Option<LevelView<'a>> {
        if !*self.tables.offered.get(lod)? {
            return None;
        }
        let record = self.tables.levels.get(lod)?;
        Some(LevelView {
            record,
            ranges: self.tables.level_ranges(lod),
            arrays: self.tables.level_arrays(record),
            vertices: self.envelope.section(record.vertex_section as usize)?,
            indices: self.envelope.section(record.index_section as usize)?,
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
    pub fn mip(&self, texture: usize, mip: usize) -> Option<&'a [u8]> {
        let record = self.mips(texture).get(mip)?;
        let start = usize::try_from(record.offset).ok()?;
        let end = start.checked_add(usize::try_from(record.length).ok()?)?;
        self.envelope.section(record.section as usize)?.get(start..end)
    }

    /// What made the file, if it says so.
    pub fn provenance(&self) -> Option<&Provenance> {
        self.tables.provenance.as_ref()
    }
}

fn read(bytes: &[u8], whole: bool) -> Result<Container<'_>, FormatError> {
    let mut report = CheckReport::default();
    let mut container = None;
    if let Some(mut envelope) = envelope::read(bytes, whole, &mut report)
        && report.is_sound()
    {
        let tables = content::read(&mut envelope, whole, &mut report);
        container = tables.map(|tables| Container { envelope, tables });
    }
    match report.findings.into_iter().next() {
        Some(finding) => Err(finding),
        None => container.ok_or_else(|| FormatError::new(crate::Code::Missing, "tables", "all tables", "none")),
    }
}

/// Every failed check of the file in `bytes`, whatever its place in memory.
pub fn check(bytes: &[u8]) -> CheckReport {
    if !(bytes.as_ptr() as usize).is_multiple_of(crate::kind::TABLE_ALIGNMENT as usize) {
        return check(&crate::AlignedBytes::copy_of(bytes));
    }
    let mut report = CheckReport::default();
    if let Some(mut envelope) = envelope::read(bytes, true, &mut report) {
        content::read(&mut envelope, true, &mut report);
    }
    report
}
