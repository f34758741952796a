//! Layouts against level 0: every promise of the specification's chapter 5.
//!
//! ```text
//! each:      as long as its counts say; counts are level 0's; paddings and reserved bytes zero; numbers finite
//! window:    points and their parents -> forest; a triangle dies where two of its corners' points meet; order, counts
//! trees:     nodes and their parents -> tree; a triangle lives above the greatest rank where two corners meet; counts
//! clusters:  ranges tile; groups replace one another; errors and spheres grow; level 0 holds level 0's triangles
//! ```
//! **Limits.** All steps are linear but three sorts (leaf positions, the triangles of clusters) and the meeting places in a
//! window, which take the logarithm of its depth. Cones are only checked to be finite.

mod clusters;
mod forest;
mod tree;
mod window;

use super::{Check, first_nonzero, slice};
use crate::container::Indices;
use crate::error::{CheckReport, Code, FormatError};
use crate::kind::Kind;
use crate::layout::{self, Checkpoint};
use crate::prelude::*;
use crate::record::{DrawRange, NONE};

/// Findings of one layout; a check goes on while it returns `Some`.
pub(super) struct Findings<'r> {
    kind: Kind,
    report: &'r mut CheckReport,
}

impl Findings<'_> {
    /// One finding against a place in the section; `None`, to leave with `?`.
    fn fail(
        &mut self,
        code: Code,
        place: impl AsRef<str>,
        expected: impl ToString,
        found: impl ToString,
    ) -> Option<()> {
        let at = format!("{}.{}", self.kind, place.as_ref());
        self.report.push(FormatError::new(code, at, expected, found));
        None
    }

    fn finite(&mut self, place: &str, values: &[f32]) -> Option<()> {
        match super::numbers::first_not_finite(values) {
            Some(i) => self.fail(Code::NotFinite, format!("{place}[{i}]"), "a finite number", values[i]),
            None => Some(()),
        }
    }

    fn zero(&mut self, place: &str, bytes: &[u8]) -> Option<()> {
        match first_nonzero(bytes) {
            Some((i, byte)) => self.fail(Code::Reserved, place, "zero", format!("{byte:#04x} at byte {i}")),
            None => Some(()),
        }
    }

    fn count(&mut self, place: &str, found: u32, expected: u32) -> Option<()> {
        if found == expected { Some(()) } else { self.fail(Code::LayoutCount, place, expected, found) }
    }

    fn within(&mut self, place: &str, found: u32, least: u32, most: u32) -> Option<()> {
        if (least..=most).contains(&found) {
            return Some(());
        }
        self.fail(Code::LayoutCount, place, format!("{least} to {most}"), found)
    }
}

/// Level 0 as layouts see it.
pub(super) struct Finest<'e> {
    pub(super) positions: &'e [[f32; 3]],
    pub(super) indices: Indices<'e>,
    pub(super) ranges: &'e [DrawRange],
}

impl Finest<'_> {
    fn vertices(&self) -> u32 {
        self.positions.len() as u32
    }

    fn triangle_count(&self) -> u32 {
        (self.indices.len() / 3) as u32
    }

    /// Triangle number `t`; indices are below the vertex count.
    fn triangle(&self, t: usize) -> [u32; 3] {
        match self.indices {
            Indices::U16(indices) => {
                indices[3 * t..3 * t + 3].try_into().map_or([0; 3], |t: [u16; 3]| t.map(u32::from))
            }
            Indices::U32(indices) => indices[3 * t..3 * t + 3].try_into().unwrap_or([0; 3]),
        }
    }
}

impl<'e> Check<'e, '_> {
    /// LEAF is there if and only if TREE is.
    pub(super) fn layout_sections(&self, report: &mut CheckReport) {
        let has = |kind| self.envelope.find(kind).is_some();
        if has(Kind::TREE) != has(Kind::LEAF) {
            report.push(FormatError::new(Code::LayoutLength, "TREE", "TREE and LEAF, or none of them", "one of them"));
        }
    }

    fn finest(&self) -> Option<Finest<'e>> {
        let level = self.tables.levels.first()?;
        let positions = self.raw(level.vertex_section)?.get(..level.vertices as usize * 12)?;
        let indices = self.raw(level.index_section)?;
        Some(Finest {
            positions: bytemuck::try_cast_slice(positions).ok()?,
            indices: match level.index_width {
                2 => Indices::U16(bytemuck::try_cast_slice(indices).ok()?),
                _ => Indices::U32(bytemuck::try_cast_slice(indices).ok()?),
            },
            ranges: self.tables.level_ranges(0),
        })
    }

    fn layout_bytes(&self, kind: Kind) -> Option<&'e [u8]> {
        self.raw(self.envelope.find(kind)?)
    }

    /// The layout of a section that is sound as bytes; level 0 is sound.
    pub(super) fn layout(&self, kind: Kind, report: &mut CheckReport) {
        let Some(finest) = self.finest() else { return };
        let Some(bytes) = self.layout_bytes(kind) else { return };
        let mut findings = Findings { kind, report };
        let out = &mut findings;
        let length = |out: &mut Findings<'_>| {
            out.fail(Code::LayoutLength, "length", "as many bytes as its counts say", bytes.len());
        };
        let padding = |zero: bool, out: &mut Findings<'_>| {
            if !zero {
                out.fail(Code::Padding, "arrays", "zeros between them", "another value");
            }
        };
        match kind {
            Kind::WINDOW => match layout::cut_window(bytes) {
                Some((view, zero)) => {
                    padding(zero, out);
                    self.window(&view, &finest, out);
                }
                None => length(out),
            },
            Kind::TREE => match self.layout_bytes(Kind::LEAF).and_then(|leaf| layout::cut_tree(bytes, leaf)) {
                Some((view, zero)) => {
                    padding(zero, out);
                    self.tree_leaf(&view, &finest, out);
                }
                // Without its leaves in a prefix: not offered. A whole file with a damaged LEAF has a finding already.
                None => length(out),
            },
            Kind::COMPACT_TREE => match layout::cut_compact_tree(bytes) {
                Some((view, zero)) => {
                    padding(zero, out);
                    self.compact_tree(&view, &finest, out);
                }
                None => length(out),
            },
            Kind::CLUSTERS => match layout::cut_clusters(bytes) {
                Some((view, zero)) => {
                    padding(zero, out);
                    self.clusters(&view, &finest, out);
                }
                None => length(out),
            },
            // LEAF is looked at with TREE.
            _ => {}
        }
    }

    /// Order and levels of checkpoints; `first` and `last` are the finest and the coarsest detail.
    fn checkpoints(&self, all: &[Checkpoint], first: u32, last: u32, out: &mut Findings<'_>) -> Option<()> {
        let ends = all.first().zip(all.last()).map(|(a, b)| (a.detail, b.detail));
        if ends != Some((first, last)) {
            return out.fail(
                Code::Checkpoints,
                "checkpoints",
                format!("{first} first, {last} last"),
                format!("{ends:?}"),
            );
        }
        let mut last_level = None;
        for (i, c) in all.iter().enumerate() {
            let at = |field: &str| format!("checkpoints[{i}].{field}");
            if !c.error.is_finite() {
                return out.fail(Code::NotFinite, at("error"), "a finite number", c.error);
            }
            if self.strict {
                out.zero(&at("reserved"), bytemuck::bytes_of(&c.reserved))?;
            }
            let before = i.checked_sub(1).map(|before| all[before]);
            let on = before.is_none_or(|b| if first < last { b.detail < c.detail } else { b.detail > c.detail });
            let grows = before.is_none_or(|b| b.triangles >= c.triangles && b.error <= c.error);
            if !on || !grows || c.error < 0.0 {
                let expected = "coarser than the one before, with no more triangles and no less error";
                return out.fail(Code::Checkpoints, at("detail"), expected, format!("{c:?}"));
            }
            if c.level == NONE {
                continue;
            }
            let level = self.tables.levels.get(c.level as usize);
            if level.is_none_or(|level| level.triangles != c.triangles) || last_level.is_some_and(|l| l >= c.level) {
                let expected = format!("a level of {} triangles, coarser than those named before", c.triangles);
                return out.fail(Code::Checkpoints, at("level"), expected, c.level);
            }
            last_level = Some(c.level);
        }
        Some(())
    }
}

/// Compares what checkpoints state with what was counted.
fn counted(all: &[Checkpoint], counts: impl Fn(usize) -> (u64, u64), out: &mut Findings<'_>) -> Option<()> {
    for (i, c) in all.iter().enumerate() {
        let (vertices, triangles) = counts(i);
        if (c.vertices as u64, c.triangles as u64) != (vertices, triangles) {
            let expected = format!("{vertices} vertices and {triangles} triangles");
            let found = format!("{} and {}", c.vertices, c.triangles);
            return out.fail(Code::Checkpoints, format!("checkpoints[{i}]"), expected, found);
        }
    }
    Some(())
}
