//! The canonical writer: the same content gives the same bytes.

use alloc::borrow::Cow;
use alloc::collections::BTreeMap;

use unicode_normalization::UnicodeNormalization;

use crate::aligned::AlignedBytes;
use crate::codec::{self, Packing};
use crate::container::Container;
use crate::content::{full_mip_count, payload::box_of};
use crate::error::{Code, FormatError};
use crate::kind::{
    Channel, ErrorKind, Extra, FIRST_LEVELS, FIRST_TEXTURES, Kind, PAYLOAD_ALIGNMENT, Role, SHARED_LEVELS, Semantic,
    TABLE_ALIGNMENT, TextureFormat, WIDE_TEXTURES,
};
use crate::layout::Layouts;
use crate::prelude::*;
use crate::provenance::{self, Provenance};
use crate::record::*;

/// Widest and highest mip that goes into the tail, texels. A tail of an RGBA8 texture then has at most 86 KiB, which is what
/// a coarse level costs to show with texture; larger tails delay the first picture, smaller ones blur it.
pub const TAIL_SIZE: u32 = 128;

/// Everything that a container holds.
#[derive(Clone, Debug, Default)]
pub struct Content<'a> {
    /// Triangles of the source asset.
    pub source_triangles: u32,
    /// Size (texels), padding (texels), chart count and sheet count of the UV layout in `uv0`.
    pub layout: Option<[u32; 4]>,
    /// Finest first, at least one.
    pub levels: Vec<LevelContent<'a>>,
    /// What ranges of levels refer to.
    pub submeshes: Vec<SubmeshContent>,
    /// What submeshes refer to; `name` of each record is set by the writer.
    pub materials: Vec<(String, MaterialRecord)>,
    /// What materials refer to.
    pub textures: Vec<TextureContent<'a>>,
    /// What made it.
    pub provenance: Option<Provenance>,
    /// More levels of detail over level 0.
    pub layouts: Layouts<'a>,
    /// How payload is stored. With [`Packing::Meshopt`] indices are written as [`crate::canonical_indices`] gives them.
    pub packing: Packing,
    /// Private sections, written last in the given order.
    pub private: Vec<PrivateSection<'a>>,
}

/// A level's arrays; all but positions may be absent, and all have one element a vertex.
#[derive(Clone, Debug)]
pub struct LevelContent<'a> {
    /// Distance to the source surface, object units.
    pub error: f32,
    /// How it was found.
    pub error_kind: ErrorKind,
    /// Raw bytes of each array by semantic, ascending, positions first.
    pub arrays: Vec<(Semantic, &'a [u8])>,
    /// Three a triangle, ordered by submesh.
    pub indices: &'a [u32],
    /// `[submesh_count]`, number of indices of each submesh.
    pub index_counts: Vec<u32>,
    /// Whether the arrays are the first elements of level 0's, as half-edge collapses leave them; they are stored once then.
    /// Nothing on level 0.
    pub shares_vertices: bool,
}

/// One submesh.
#[derive(Clone, Debug)]
pub struct SubmeshContent {
    /// Name.
    pub name: String,
    /// Material.
    pub material: Option<u32>,
    /// Attributes of its source: bit `n` is semantic number `n`.
    pub attributes: u32,
    /// Triangles it had in the source asset.
    pub source_triangles: u32,
}

/// One texture.
#[derive(Clone, Debug)]
pub struct TextureContent<'a> {
    /// Name.
    pub name: String,
    /// Format.
    pub format: TextureFormat,
    /// What R, G, B, A mean.
    pub channels: [Channel; 4],
    /// For a picture that no material uses: what it holds, and its sheet.
    pub extra: Option<(Extra, u32)>,
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Mip 0 and on, each [`TextureFormat::mip_length`] bytes, sizes halving and rounding down.
    pub mips: Vec<Cow<'a, [u8]>>,
}

/// A section of somebody else's kind.
#[derive(Clone, Debug)]
pub struct PrivateSection<'a> {
    /// Kind that starts with a lower-case letter.
    pub kind: Kind,
    /// Version.
    pub version: u16,
    /// Whether readers that do not know it must refuse the file.
    pub required: bool,
    /// Whether it is aligned to 256 instead of 16.
    pub payload: bool,
    /// Its bytes.
    pub bytes: Cow<'a, [u8]>,
}

/// A section before it has a place.
struct Pending<'a> {
    kind: Kind,
    version: u16,
    flags: u16,
    alignment: u32,
    bytes: Cow<'a, [u8]>,
    coded: Option<Coded>,
}

/// Codec, and bytes in it, fewer than the raw ones.
type Coded = (u32, Vec<u8>);

/// Numbers strings in order of first use.
#[derive(Default)]
struct Strings {
    numbers: BTreeMap<String, u32>,
    bytes: Vec<u8>,
}

impl Strings {
    fn number(&mut self, string: &str) -> Result<u32, FormatError> {
        let normal: String = string.nfc().collect();
        if let Some(number) = self.numbers.get(&normal) {
            return Ok(*number);
        }
        provenance::put_string(&mut self.bytes, &normal)?;
        let number = self.numbers.len() as u32;
        self.numbers.insert(normal, number);
        Ok(number)
    }

    fn finish(self) -> Vec<u8> {
        let header = CountHeader { count: self.numbers.len() as u32, second_count: 0, reserved: [0; 2] };
        [bytemuck::bytes_of(&header), &self.bytes].concat()
    }
}

/// The bytes of a container with `content`, read back and checked once before they are returned.
///
/// # Errors
/// Content that no valid container can hold: the finding of the reader.
pub fn write(content: &Content<'_>) -> Result<Vec<u8>, FormatError> {
    let mut strings = Strings::default();
    let submeshes = submesh_table(content, &mut strings)?;
    let (materials, roles) = material_table(content, &mut strings)?;
    let names: Vec<u32> = content.textures.iter().map(|t| strings.number(&t.name)).collect::<Result<_, _>>()?;
    let mut tables: Vec<(Kind, Vec<u8>)> = vec![
        (Kind::STRINGS, strings.finish()),
        (Kind::LEVELS, Vec::new()),
        (Kind::SUBMESHES, submeshes),
        (Kind::MATERIALS, materials),
        (Kind::TEXTURES, Vec::new()),
    ];
    if let Some(provenance) = &content.provenance {
        tables.push((Kind::PROVENANCE, provenance::write(provenance)?));
    }
    let mut payload = Payload::new(content, tables.len() as u32);
    payload.place(content)?;
    tables[1].1 = level_table(content, &payload);
    tables[4].1 = texture_table(content, &payload, &names, &roles);

    let wide = content.textures.iter().any(|t| !t.format.is_first() || t.extra.is_some());
    let shared = content.levels.iter().skip(1).any(|level| level.shares_vertices);
    let coded = payload.sections.iter().any(|(_, _, coded)| coded.is_some());
    let minor = match () {
        () if shared || coded || !content.layouts.is_empty() => 2,
        () if wide || content.layout.is_some_and(|layout| layout[3] > 1) => 1,
        () => 0,
    };
    let mut sections: Vec<Pending<'_>> =
        tables.into_iter().map(|(kind, bytes)| pending(kind, bytes.into(), None)).collect();
    // Whoever cannot read the new formats must refuse them; everybody else goes on as before.
    sections[1].version = if shared { SHARED_LEVELS } else { FIRST_LEVELS };
    sections[4].version = if wide { WIDE_TEXTURES } else { FIRST_TEXTURES };
    sections.extend(payload.sections.into_iter().map(|(kind, bytes, coded)| pending(kind, bytes, coded)));
    for private in &content.private {
        sections.push(Pending {
            kind: private.kind,
            version: private.version,
            flags: if private.required { FLAG_REQUIRED } else { 0 },
            alignment: if private.payload { PAYLOAD_ALIGNMENT } else { TABLE_ALIGNMENT },
            bytes: Cow::Borrowed(&private.bytes),
            coded: None,
        });
    }
    let bytes = assemble(&sections, minor);
    let private_required = content.private.iter().any(|private| private.required);
    if private_required {
        // This reader rightly refuses the file; whoever wrote the section has the one that does not.
        return Ok(bytes);
    }
    Container::open(&AlignedBytes::copy_of(&bytes)).map(|_| bytes)
}

fn pending(kind: Kind, bytes: Cow<'_, [u8]>, coded: Option<Coded>) -> Pending<'_> {
    let row = kind.row().expect("invariant: only registered kinds come here");
    let flags = if row.required { FLAG_REQUIRED } else { 0 };
    Pending { kind, version: row.version, flags, alignment: row.alignment, bytes, coded }
}

/// Payload first, header last.
fn assemble(sections: &[Pending<'_>], minor: u16) -> Vec<u8> {
    let table_end = HEADER_SIZE + sections.len() * ENTRY_SIZE;
    let stored = |s: &Pending<'_>| s.coded.as_ref().map_or(s.bytes.len(), |(_, bytes)| bytes.len());
    let total: usize = sections.iter().map(|s| stored(s) + s.alignment as usize).sum();
    let mut out = Vec::with_capacity(table_end + total);
    out.resize(table_end, 0);
    let mut entries = Vec::with_capacity(sections.len());
    for section in sections {
        out.resize(out.len().next_multiple_of(section.alignment as usize), 0);
        let raw_hash = *blake3::hash(&section.bytes).as_bytes();
        let (codec, bytes, stored_hash) = match &section.coded {
            Some((codec, bytes)) => (*codec, &bytes[..], *blake3::hash(bytes).as_bytes()),
            None => (codec::NONE, &*section.bytes, raw_hash),
        };
        entries.push(SectionEntry {
            kind: section.kind.0,
            version: section.version,
            flags: section.flags,
            codec,
            alignment: section.alignment,
            offset: out.len() as u64,
            stored_length: bytes.len() as u64,
            raw_length: section.bytes.len() as u64,
            reserved0: [0; 8],
            stored_hash,
            raw_hash,
            reserved1: [0; 16],
        });
        out.extend_from_slice(bytes);
    }
    let header = Header {
        magic: MAGIC,
        endian: ENDIAN,
        major: MAJOR,
        minor,
        file_length: out.len() as u64,
        table_offset: HEADER_SIZE as u64,
        section_count: sections.len() as u32,
        reserved0: 0,
        reserved1: [0; 24],
        hash: [0; 32],
    };
    out[HEADER_SIZE..table_end].copy_from_slice(bytemuck::cast_slice(&entries));
    out[..HEADER_SIZE].copy_from_slice(bytemuck::bytes_of(&header));
    seal(&mut out);
    out
}

/// Sets the header's hash over header and table. Tools that change a table on purpose call it last.
///
/// Nothing happens to bytes that are no container's.
pub fn seal(bytes: &mut [u8]) {
    let Some(header) = bytes.get(..HEADER_SIZE) else { return };
    let header: Header = bytemuck::pod_read_unaligned(header);
    let Some(table) = bytes.get(HEADER_SIZE..HEADER_SIZE + header.section_count as usize * ENTRY_SIZE) else { return };
    let mut hasher = blake3::Hasher::new();
    hasher.update(&bytes[..HASHED_HEADER]);
    hasher.update(table);
    let hash = *hasher.finalize().as_bytes();
    bytes[HASHED_HEADER..HEADER_SIZE].copy_from_slice(&hash);
}

/// Payload sections in canonical order, and where each thing went.
struct Payload<'a> {
    first_number: u32,
    packing: Packing,
    sections: Vec<(Kind, Cow<'a, [u8]>, Option<Coded>)>,
    /// By level: vertex and index section.
    geometry: Vec<[u32; 2]>,
    /// By level.
    arrays: Vec<Vec<ArrayRecord>>,
    /// By level: tails needed.
    tails: Vec<Vec<u32>>,
    /// By texture: tail section.
    tail_sections: Vec<u32>,
    /// By texture and mip.
    mips: Vec<Vec<MipRecord>>,
}

impl<'a> Payload<'a> {
    fn new(content: &Content<'_>, first_number: u32) -> Payload<'a> {
        Payload {
            first_number,
            packing: content.packing,
            sections: Vec::new(),
            geometry: vec![[NONE; 2]; content.levels.len()],
            arrays: vec![Vec::new(); content.levels.len()],
            tails: vec![Vec::new(); content.levels.len()],
            tail_sections: vec![NONE; content.textures.len()],
            mips: vec![Vec::new(); content.textures.len()],
        }
    }

    /// A section in the packing's general codec, if that is smaller.
    fn push(&mut self, kind: Kind, bytes: Cow<'a, [u8]>) -> u32 {
        let coded = (self.packing != Packing::Raw).then(|| codec::encode_zstd(&bytes)).flatten();
        self.push_coded(kind, bytes, codec::ZSTD, coded)
    }

    fn push_coded(&mut self, kind: Kind, bytes: Cow<'a, [u8]>, codec: u32, coded: Option<Vec<u8>>) -> u32 {
        let raw = bytes.len() as u64;
        let worth = |coded: &Vec<u8>| (coded.len() as u64) < raw && raw <= codec::most_raw(codec, coded.len() as u64);
        self.sections.push((kind, bytes, coded.filter(worth).map(|coded| (codec, coded))));
        self.first_number + self.sections.len() as u32 - 1
    }

    /// Coarse to fine geometry with tails, left-over tails, layouts, large mips by size.
    fn place(&mut self, content: &'a Content<'_>) -> Result<(), FormatError> {
        for (lod, level) in content.levels.iter().enumerate().rev() {
            let vertices = match lod > 0 && level.shares_vertices {
                true => self.shared_vertices(content, lod)?,
                false => self.vertices(level, lod),
            };
            self.geometry[lod] = [vertices, self.indices(level)];
            for texture in textures_of(content, level) {
                let tail = self.tail(content, texture)?;
                self.tails[lod].push(tail);
            }
        }
        for texture in 0..content.textures.len() {
            self.tail(content, texture)?;
        }
        for (kind, bytes) in content.layouts.sections() {
            self.push(kind, bytes.into());
        }
        let mut large = Vec::new();
        for (number, texture) in content.textures.iter().enumerate() {
            for (k, mip) in texture.mips[..tail_first(texture)].iter().enumerate() {
                large.push((mip.len(), number, k));
            }
        }
        large.sort_unstable();
        for (_, texture, k) in large {
            let bytes = Cow::Borrowed(&*content.textures[texture].mips[k]);
            self.mips[texture][k].section = self.push(Kind::MIP, bytes);
        }
        Ok(())
    }

    /// The section number of a level's vertices, written on first use.
    fn vertices(&mut self, level: &LevelContent<'_>, lod: usize) -> u32 {
        if self.geometry[lod][0] == NONE {
            let (bytes, arrays) = vertex_bytes(level);
            self.geometry[lod][0] = match self.packing {
                Packing::Meshopt => {
                    let coded = codec::encode_vertices(&bytes, &arrays);
                    self.push_coded(Kind::VERTICES, bytes.into(), codec::VERTEX, coded)
                }
                _ => self.push(Kind::VERTICES, bytes.into()),
            };
            self.arrays[lod] = arrays;
        }
        self.geometry[lod][0]
    }

    /// That of level 0's, of which the level has the first elements.
    fn shared_vertices(&mut self, content: &Content<'_>, lod: usize) -> Result<u32, FormatError> {
        let (level, finest) = (&content.levels[lod], &content.levels[0]);
        let section = self.vertices(finest, 0);
        let mut pairs = level.arrays.iter().zip(&finest.arrays);
        let starts = pairs.all(|((own, bytes), (semantic, all))| own == semantic && all.starts_with(bytes));
        if level.arrays.len() != finest.arrays.len() || !starts {
            let expected = "the first elements of each of level 0's arrays";
            return Err(FormatError::new(Code::Arrays, format!("levels[{lod}].arrays"), expected, "others"));
        }
        let records = self.arrays[0].iter().zip(&level.arrays);
        self.arrays[lod] =
            records.map(|(record, (_, bytes))| ArrayRecord { length: bytes.len() as u64, ..*record }).collect();
        Ok(section)
    }

    /// The section number of a level's indices, in its width; those of the codec as decoding gives them.
    fn indices(&mut self, level: &'a LevelContent<'_>) -> u32 {
        let vertices = level.vertex_count() as u32;
        let coded = match self.packing {
            Packing::Meshopt => codec::encode_indices(level.indices, vertices),
            _ => None,
        };
        let (stream, indices) = match coded {
            Some((stream, indices)) => (Some(stream), Cow::Owned(indices)),
            None => (None, Cow::Borrowed(level.indices)),
        };
        let bytes = match indices {
            indices if vertices <= MAX_U16_VERTICES => {
                let narrow: Vec<u16> = indices.iter().map(|i| *i as u16).collect();
                Cow::Owned(bytemuck::cast_slice(&narrow).to_vec())
            }
            Cow::Owned(indices) => Cow::Owned(bytemuck::cast_slice(&indices).to_vec()),
            Cow::Borrowed(indices) => Cow::Borrowed(bytemuck::cast_slice(indices)),
        };
        match stream {
            Some(stream) => match codec::encode_zstd(&stream).filter(|frame| {
                let most = codec::most_raw(codec::INDEX_ZSTD, frame.len() as u64);
                frame.len() < stream.len() && bytes.len() as u64 <= most
            }) {
                Some(frame) => self.push_coded(Kind::INDICES, bytes, codec::INDEX_ZSTD, Some(frame)),
                None => self.push_coded(Kind::INDICES, bytes, codec::INDEX, Some(stream)),
            },
            None => self.push(Kind::INDICES, bytes),
        }
    }

    /// The section number of a texture's tail, written on first use.
    fn tail(&mut self, content: &Content<'_>, number: usize) -> Result<u32, FormatError> {
        if self.tail_sections[number] != NONE {
            return Ok(self.tail_sections[number]);
        }
        let texture = &content.textures[number];
        let at = format!("textures[{number}]");
        if texture.mips.is_empty() || texture.mips.len() > full_mip_count(texture.width, texture.height) as usize {
            let expected = format!("1 to {} mips", full_mip_count(texture.width, texture.height));
            return Err(FormatError::new(Code::Mips, at, expected, texture.mips.len()));
        }
        let mut bytes = Vec::new();
        for (k, mip) in texture.mips.iter().enumerate() {
            let mut record = MipRecord {
                width: (texture.width >> k).max(1),
                height: (texture.height >> k).max(1),
                section: NONE,
                reserved: 0,
                offset: 0,
                length: mip.len() as u64,
            };
            if k >= tail_first(texture) {
                bytes.resize(bytes.len().next_multiple_of(PAYLOAD_ALIGNMENT as usize), 0);
                record.offset = bytes.len() as u64;
                bytes.extend_from_slice(mip);
            }
            self.mips[number].push(record);
        }
        let section = self.push(Kind::MIP_TAIL, bytes.into());
        self.tail_sections[number] = section;
        self.mips[number].iter_mut().skip(tail_first(texture)).for_each(|mip| mip.section = section);
        Ok(section)
    }
}

/// The first mip that goes into the tail; the last mip always does.
fn tail_first(texture: &TextureContent<'_>) -> usize {
    let small = |k: &usize| (texture.width >> k).max(texture.height >> k) <= TAIL_SIZE;
    (0..texture.mips.len()).find(small).unwrap_or(texture.mips.len().saturating_sub(1))
}

/// Textures that the drawn submeshes of a level show, ascending.
fn textures_of(content: &Content<'_>, level: &LevelContent<'_>) -> Vec<usize> {
    let mut textures = Vec::new();
    for (submesh, count) in content.submeshes.iter().zip(&level.index_counts) {
        let material = submesh.material.filter(|_| *count > 0).and_then(|m| content.materials.get(m as usize));
        for slot in material.iter().flat_map(|(_, record)| &record.slots) {
            if (slot.texture as usize) < content.textures.len() {
                textures.push(slot.texture as usize);
            }
        }
    }
    textures.sort_unstable();
    textures.dedup();
    textures
}

impl LevelContent<'_> {
    fn vertex_count(&self) -> usize {
        self.arrays.first().map_or(0, |(semantic, bytes)| bytes.len() / semantic.format().size())
    }
}

fn vertex_bytes(level: &LevelContent<'_>) -> (Vec<u8>, Vec<ArrayRecord>) {
    let (mut bytes, mut arrays) = (Vec::new(), Vec::new());
    for (semantic, values) in &level.arrays {
        bytes.resize(bytes.len().next_multiple_of(PAYLOAD_ALIGNMENT as usize), 0);
        arrays.push(ArrayRecord {
            semantic: semantic.number(),
            format: semantic.format().number(),
            offset: bytes.len() as u64,
            length: values.len() as u64,
            reserved: [0; 2],
        });
        bytes.extend_from_slice(values);
    }
    (bytes, arrays)
}

fn level_positions<'l>(level: &'l LevelContent<'_>) -> Cow<'l, [[f32; 3]]> {
    let bytes = level.arrays.first().map_or(&[][..], |(_, bytes)| bytes);
    let bytes = &bytes[..bytes.len() / 12 * 12];
    match bytemuck::try_cast_slice(bytes) {
        Ok(positions) => Cow::Borrowed(positions),
        Err(_) => Cow::Owned(bytes.chunks_exact(12).map(bytemuck::pod_read_unaligned).collect()),
    }
}

fn level_table(content: &Content<'_>, payload: &Payload<'_>) -> Vec<u8> {
    let (mut levels, mut arrays, mut needs) = (Vec::new(), Vec::<ArrayRecord>::new(), Vec::<u32>::new());
    for (lod, level) in content.levels.iter().enumerate() {
        let (bounds_min, bounds_max) = box_of(level_positions(level).iter());
        let [vertex_section, index_section] = payload.geometry[lod];
        let mut own = vec![vertex_section, index_section];
        own.extend(&payload.tails[lod]);
        own.sort_unstable();
        let vertices = level.vertex_count() as u32;
        levels.push(LevelRecord {
            triangles: (level.indices.len() / 3) as u32,
            vertices,
            error: level.error,
            error_kind: level.error_kind.number(),
            bounds_min,
            bounds_max,
            vertex_section,
            index_section,
            index_width: if vertices <= MAX_U16_VERTICES { 2 } else { 4 },
            first_array: arrays.len() as u32,
            array_count: payload.arrays[lod].len() as u32,
            first_need: needs.len() as u32,
            need_count: own.len() as u32,
            layout_sheets: content.layout.map_or(0, |layout| if layout[3] > 1 { layout[3] } else { 0 }),
            reserved: [0; 6],
        });
        arrays.extend(&payload.arrays[lod]);
        needs.extend(own);
    }
    let layout = content.layout.unwrap_or_default();
    let header = LevelHeader {
        level_count: levels.len() as u32,
        array_count: arrays.len() as u32,
        need_count: needs.len() as u32,
        source_triangles: content.source_triangles,
        has_layout: content.layout.is_some() as u32,
        layout_size: layout[0],
        layout_padding: layout[1],
        layout_charts: layout[2],
    };
    let parts: [&[u8]; 4] = [
        bytemuck::bytes_of(&header),
        bytemuck::cast_slice(&levels),
        bytemuck::cast_slice(&arrays),
        bytemuck::cast_slice(&needs),
    ];
    parts.concat()
}

fn submesh_table(content: &Content<'_>, strings: &mut Strings) -> Result<Vec<u8>, FormatError> {
    let header = SubmeshHeader {
        submesh_count: content.submeshes.len() as u32,
        level_count: content.levels.len() as u32,
        reserved: [0; 2],
    };
    let mut out = bytemuck::bytes_of(&header).to_vec();
    for submesh in &content.submeshes {
        out.extend(bytemuck::bytes_of(&SubmeshRecord {
            name: strings.number(&submesh.name)?,
            material: submesh.material.unwrap_or(NONE),
            attributes: submesh.attributes,
            source_triangles: submesh.source_triangles,
            reserved: [0; 4],
        }));
    }
    for (lod, level) in content.levels.iter().enumerate() {
        let total: u64 = level.index_counts.iter().map(|count| *count as u64).sum();
        if level.index_counts.len() != content.submeshes.len() || total != level.indices.len() as u64 {
            let expected = format!("{} indices in {} ranges", level.indices.len(), content.submeshes.len());
            let found = format!("{total} in {}", level.index_counts.len());
            return Err(FormatError::new(Code::Ranges, format!("levels[{lod}]"), expected, found));
        }
        let positions = level_positions(level);
        let mut first = 0usize;
        for count in &level.index_counts {
            let own = &level.indices[first..first + *count as usize];
            if let Some(index) = own.iter().find(|i| **i as usize >= positions.len()) {
                let expected = format!("indices below {}", positions.len());
                return Err(FormatError::new(Code::IndexRange, format!("levels[{lod}]"), expected, index));
            }
            let least = own.iter().min().copied().unwrap_or(0);
            let (bounds_min, bounds_max) = box_of(own.iter().map(|i| &positions[*i as usize]));
            out.extend(bytemuck::bytes_of(&DrawRange {
                first_index: first as u32,
                index_count: *count,
                first_vertex: least,
                vertex_count: own.iter().max().map_or(0, |greatest| greatest - least + 1),
                bounds_min,
                bounds_max,
                reserved: [0; 2],
            }));
            first += *count as usize;
        }
    }
    Ok(out)
}

/// The table, and the set of roles of each texture.
fn material_table(content: &Content<'_>, strings: &mut Strings) -> Result<(Vec<u8>, Vec<u32>), FormatError> {
    let mut roles = vec![0; content.textures.len()];
    let header = CountHeader { count: content.materials.len() as u32, second_count: 0, reserved: [0; 2] };
    let mut out = bytemuck::bytes_of(&header).to_vec();
    for (name, record) in &content.materials {
        out.extend(bytemuck::bytes_of(&MaterialRecord { name: strings.number(name)?, ..*record }));
        for (role, slot) in Role::ALL.iter().zip(&record.slots) {
            if let Some(roles) = roles.get_mut(slot.texture as usize) {
                *roles |= 1 << role.number();
            }
        }
    }
    Ok((out, roles))
}

fn texture_table(content: &Content<'_>, payload: &Payload<'_>, names: &[u32], roles: &[u32]) -> Vec<u8> {
    let (mut textures, mut mips) = (Vec::new(), Vec::<MipRecord>::new());
    for (number, texture) in content.textures.iter().enumerate() {
        textures.push(TextureRecord {
            name: names[number],
            format: texture.format.number(),
            roles: roles[number] | texture.extra.map_or(0, |(extra, _)| 1 << extra.number()),
            channels: texture.channels.map(|channel| channel.number() as u8),
            width: texture.width,
            height: texture.height,
            mip_count: texture.mips.len() as u32,
            first_mip: mips.len() as u32,
            tail_first: tail_first(texture) as u32,
            tail_section: payload.tail_sections[number],
            sheet: texture.extra.map_or(0, |(_, sheet)| sheet),
            reserved: [0; 5],
        });
        mips.extend(&payload.mips[number]);
    }
    let header = CountHeader { count: textures.len() as u32, second_count: mips.len() as u32, reserved: [0; 2] };
    let parts: [&[u8]; 3] = [bytemuck::bytes_of(&header), bytemuck::cast_slice(&textures), bytemuck::cast_slice(&mips)];
    parts.concat()
}
