//! Vertex arrays, indices and mip tails: what the GPU reads, so that nothing in it can lead a reader astray.

use super::{Check, numbers, slice};
use crate::envelope::first_nonzero;
use crate::error::{CheckReport, Code, FormatError};
use crate::kind::{PAYLOAD_ALIGNMENT, Semantic, TextureFormat, VertexFormat};
use crate::prelude::*;
use crate::record::*;

impl Check<'_, '_> {
    /// Arrays, indices and boxes of a level whose sections are at hand.
    pub(super) fn geometry(&self, lod: usize, report: &mut CheckReport) {
        let t = self.tables;
        let level = &t.levels[lod];
        let (Some(vertices), Some(indices)) = (self.raw(level.vertex_section), self.raw(level.index_section)) else {
            return;
        };
        let before = report.count();
        if self.shares_vertices(lod) {
            self.shared_arrays(lod, report);
        } else {
            self.arrays(lod, vertices, report);
        }
        if report.count() != before {
            return;
        }
        let length = level.triangles as u64 * 3 * level.index_width as u64;
        if indices.len() as u64 != length {
            let at = format!("levels[{lod}].index_section");
            report.push(FormatError::new(Code::Arrays, at, format!("{length} bytes"), indices.len()));
            return;
        }
        let Some(positions) = vertices.get(..level.vertices as usize * 12) else { return };
        let positions: &[[f32; 3]] = bytemuck::try_cast_slice(positions).unwrap_or(&[]);
        let found = numbers::box_of(positions);
        if found != (level.bounds_min, level.bounds_max) {
            let expected = format!("{found:?}");
            let stated = format!("{:?}", (level.bounds_min, level.bounds_max));
            report.push(FormatError::new(Code::Box, format!("levels[{lod}].bounds"), expected, stated));
        }
        match level.index_width {
            2 => self.indices(lod, bytemuck::try_cast_slice::<u8, u16>(indices).unwrap_or(&[]), positions, report),
            _ => self.indices(lod, bytemuck::try_cast_slice::<u8, u32>(indices).unwrap_or(&[]), positions, report),
        }
    }

    /// Whether a level's arrays may be the first elements of level 0's.
    fn shares_vertices(&self, lod: usize) -> bool {
        let t = self.tables;
        lod > 0 && t.levels[lod].vertex_section == t.levels[0].vertex_section && self.shared_levels()
    }

    /// Level 0's arrays, cut off at the level's own vertex count. Their values and paddings are level 0's matter.
    fn shared_arrays(&self, lod: usize, report: &mut CheckReport) {
        let (level, finest) = (&self.tables.levels[lod], &self.tables.levels[0]);
        let (own, whole) = (self.tables.level_arrays(level), self.tables.level_arrays(finest));
        let fits = |own: &ArrayRecord, whole: &ArrayRecord| {
            // An array whose format is not known here has as many bytes an element as level 0's.
            let size = whole.length.checked_div(finest.vertices as u64).unwrap_or(0);
            let same = (own.semantic, own.format, own.offset) == (whole.semantic, whole.format, whole.offset);
            same && own.length == size * level.vertices as u64
        };
        let all = own.len() == whole.len() && own.iter().zip(whole).all(|(own, whole)| fits(own, whole));
        if !all || level.vertices > finest.vertices {
            let expected = format!("the first of level 0's {} vertices", finest.vertices);
            let found = format!("{} vertices in other arrays", level.vertices);
            report.push(FormatError::new(Code::Arrays, format!("levels[{lod}].arrays"), expected, found));
        }
        for (number, array) in own.iter().enumerate() {
            self.reserved(|| format!("levels[{lod}].arrays[{number}]"), array.reserved == [0; 2], report);
        }
    }

    fn arrays(&self, lod: usize, bytes: &[u8], report: &mut CheckReport) {
        let level = &self.tables.levels[lod];
        let (mut end, mut last, mut has_positions) = (0u64, 0, false);
        for (number, array) in self.tables.level_arrays(level).iter().enumerate() {
            let at = || format!("levels[{lod}].arrays[{number}]");
            let semantic = Semantic::from_number(array.semantic);
            has_positions |= number == 0 && semantic == Some(Semantic::Positions);
            let start = end.next_multiple_of(PAYLOAD_ALIGNMENT as u64);
            // A newer minor may add semantics and formats; their arrays are still tiled.
            let length = match (semantic, VertexFormat::from_number(array.format)) {
                (Some(semantic), Some(format)) if semantic.format() == format => {
                    level.vertices as u64 * format.size() as u64
                }
                (None, _) if !self.strict => array.length,
                _ => {
                    let found = format!("semantic {} in format {}", array.semantic, array.format);
                    report.push(FormatError::new(Code::Arrays, at(), "a registered pair", found));
                    return;
                }
            };
            let stop = start.checked_add(length).filter(|stop| *stop <= bytes.len() as u64);
            let (Some(stop), true) = (stop, array.offset == start && array.length == length && array.semantic > last)
            else {
                let expected = format!("{length} bytes at {start}, semantic above {last}");
                let found = format!("{} bytes at {}, semantic {}", array.length, array.offset, array.semantic);
                report.push(FormatError::new(Code::Arrays, at(), expected, found));
                return;
            };
            if let Some((i, byte)) = first_nonzero(&bytes[end as usize..start as usize]) {
                let found = format!("{byte:#04x} at byte {}", end + i as u64);
                report.push(FormatError::new(Code::Padding, at(), "zeros before it", found));
            }
            let values = &bytes[start as usize..stop as usize];
            if semantic.is_some_and(|semantic| semantic != Semantic::Joints) {
                let floats: &[f32] = bytemuck::try_cast_slice(values).unwrap_or(&[]);
                if let Some(i) = numbers::first_not_finite(floats) {
                    report.push(FormatError::new(Code::NotFinite, at(), "a finite number", floats[i]));
                }
            }
            self.reserved(at, array.reserved == [0; 2], report);
            (end, last) = (stop, array.semantic);
        }
        if end != bytes.len() as u64 || !has_positions {
            let at = format!("levels[{lod}].arrays");
            let expected = format!("positions first and {} bytes in all", bytes.len());
            report.push(FormatError::new(Code::Arrays, at, expected, format!("{end} bytes")));
        }
    }

    fn indices<I: numbers::Index>(&self, lod: usize, indices: &[I], positions: &[[f32; 3]], report: &mut CheckReport) {
        for (number, range) in self.tables.level_ranges(lod).iter().enumerate() {
            let at = |field: &str| format!("levels[{lod}].ranges[{number}].{field}");
            let own = slice(indices, range.first_index, range.index_count);
            let stated = (range.bounds_min, range.bounds_max);
            if numbers::is_range(
                stated,
                range.first_vertex,
                slice(positions, range.first_vertex, range.vertex_count),
                own,
            ) {
                continue;
            }
            let (least, count) = numbers::span(own);
            if least as u64 + count > positions.len() as u64 {
                let expected = format!("indices below {}", positions.len());
                report.push(FormatError::new(Code::IndexRange, at("indices"), expected, least as u64 + count - 1));
                continue;
            }
            if (range.first_vertex, range.vertex_count as u64) != (least, count) {
                let found = format!("{} from {}", range.vertex_count, range.first_vertex);
                let expected = format!("{count} from {least}");
                report.push(FormatError::new(Code::IndexRange, at("first_vertex"), expected, found));
            }
            let found = box_of(own.iter().map(|i| &positions[(*i).into() as usize]));
            if found != stated {
                report.push(FormatError::new(Code::Box, at("bounds"), format!("{found:?}"), format!("{stated:?}")));
            }
        }
    }

    /// The first mip at hand of a float texture that holds a NaN or an infinity, by its section.
    pub(super) fn texels_not_finite(&self, number: usize, texture: &TextureRecord) -> Option<(u32, FormatError)> {
        let finite: fn(&[u8]) -> bool = match TextureFormat::from_number(texture.format)? {
            TextureFormat::Rgba32Float => {
                |texels| texels.as_chunks::<4>().0.iter().all(|bytes| f32::from_le_bytes(*bytes).is_finite())
            }
            // All five bits of the exponent set: no number.
            TextureFormat::Rgba16Float => |texels| texels.as_chunks::<2>().0.iter().all(|b| b[1] & 0x7C != 0x7C),
            _ => return None,
        };
        for (k, mip) in self.tables.texture_mips(texture).iter().enumerate() {
            let Some(section) = self.raw(mip.section) else { continue };
            let (start, end) = (mip.offset as usize, (mip.offset + mip.length) as usize);
            if section.get(start..end).is_some_and(|texels| !finite(texels)) {
                let at = format!("textures[{number}].mips[{k}]");
                return Some((mip.section, FormatError::new(Code::NotFinite, at, "finite texels", "another")));
            }
        }
        None
    }

    pub(super) fn tail_padding(&self, texture: &TextureRecord) -> Option<FormatError> {
        let bytes = self.raw(texture.tail_section)?;
        let mut end = 0;
        for mip in &self.tables.texture_mips(texture)[texture.tail_first as usize..] {
            let start = mip.offset as usize;
            if let Some((i, byte)) = first_nonzero(bytes.get(end..start)?) {
                let at = format!("section {}", texture.tail_section);
                let found = format!("{byte:#04x} at byte {}", end + i);
                return Some(FormatError::new(Code::Padding, at, "zeros between mips", found));
            }
            end = start + mip.length as usize;
        }
        None
    }
}

/// The smallest box over positions; zeros for none.
pub(crate) fn box_of<'p>(mut positions: impl Iterator<Item = &'p [f32; 3]>) -> ([f32; 3], [f32; 3]) {
    let Some(first) = positions.next() else { return ([0.0; 3], [0.0; 3]) };
    positions.fold((*first, *first), |(lo, hi), p| {
        (core::array::from_fn(|k| lo[k].min(p[k])), core::array::from_fn(|k| hi[k].max(p[k])))
    })
}
