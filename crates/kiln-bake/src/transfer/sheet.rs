//! The sheet in bins: small squares of texels that are baked one after another, so that what is known of their samples stays in the
//! cache; and which low face owns each sample.
//!
//! A bin's samples reach half a texel beyond its texels where the filter does. Where charts overlap the lower face owns.

use glam::Vec2;
use kiln_geom::raster::{Rect, rasterise_spans, snap};
use rayon::prelude::*;

use super::low::Low;

/// Samples a bin has on each side, its border aside: owners, winners and keys of one bin are a quarter of a megabyte.
const BIN_SAMPLES: u32 = 128;

/// Greatest side of a bin, texels.
const BIN_TEXELS: u32 = 128;

/// Which faces lie in which bin of one sheet.
pub(crate) struct Sheet {
    /// Texels across and down.
    pub(crate) size: u32,
    /// Samples a texel has on each side.
    pub(crate) samples: u32,
    /// Side of a bin, texels.
    pub(crate) side: u32,
    /// Bins across and down.
    pub(crate) across: u32,
    /// Samples by which the filter reaches beyond a texel.
    border: u32,
    bins: Bins,
}

/// Lists of faces by bin.
#[derive(Debug, Default)]
pub(crate) struct Bins {
    /// Bins across and down.
    across: u32,
    /// `[across * across + 1]` where a bin's faces begin.
    starts: Vec<u32>,
    /// Faces of each bin, ascending.
    faces: Vec<u32>,
}

impl Bins {
    /// `places`: `[face_count]` the bins of each face, if any.
    pub(crate) fn new(across: u32, places: &[Option<Rect>]) -> Bins {
        let mut starts = vec![0u32; across as usize * across as usize + 1];
        let each = |rect: &Rect, visit: &mut dyn FnMut(usize)| {
            for y in rect.y0..rect.y1 {
                for x in rect.x0..rect.x1 {
                    visit(y as usize * across as usize + x as usize);
                }
            }
        };
        for rect in places.iter().flatten() {
            each(rect, &mut |bin| starts[bin + 1] += 1);
        }
        for bin in 1..starts.len() {
            starts[bin] += starts[bin - 1];
        }
        let mut next = starts.clone();
        let mut faces = vec![0; starts.last().map_or(0, |last| *last as usize)];
        for (face, rect) in places.iter().enumerate() {
            let Some(rect) = rect else { continue };
            each(rect, &mut |bin| {
                faces[next[bin] as usize] = face as u32;
                next[bin] += 1;
            });
        }
        Bins { across, starts, faces }
    }

    /// Faces of a bin, ascending.
    pub(crate) fn faces(&self, x: u32, y: u32) -> &[u32] {
        let bin = y as usize * self.across as usize + x as usize;
        &self.faces[self.starts[bin] as usize..self.starts[bin + 1] as usize]
    }
}

impl Sheet {
    pub(crate) fn new(low: &Low<'_>) -> Sheet {
        let (size, samples) = (low.size, low.samples);
        let side = (BIN_SAMPLES / samples).clamp(1, BIN_TEXELS);
        let across = size.div_ceil(side);
        let border = if samples > 1 { samples / 2 } else { 0 };
        let mut sheet = Sheet { size, samples, side, across, border, bins: Bins::default() };
        let places: Vec<Option<Rect>> =
            (0..low.mesh.face_count()).into_par_iter().map(|face| sheet.bins_of(low, face)).collect();
        sheet.bins = Bins::new(across, &places);
        sheet
    }

    /// The bins that a face may have samples in, in units of bins.
    fn bins_of(&self, low: &Low<'_>, face: usize) -> Option<Rect> {
        if !low.holds(face) {
            return None;
        }
        let [a, b, c] = low.texels(face);
        let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
        if !(lo.is_finite() && hi.is_finite()) {
            return None;
        }
        let reach = self.border as f32 / self.samples as f32 + 1.0;
        // Casts saturate: what lies left of the sheet begins in the first bin.
        let first = |c: f32| (((c - reach) as u32) / self.side).min(self.across - 1);
        let last = |c: f32| (((c + reach).max(0.0) as u32) / self.side).min(self.across - 1);
        let whole = Vec2::splat(self.size as f32);
        if hi.cmplt(Vec2::ZERO).any() || lo.cmpgt(whole).any() {
            return None;
        }
        Some(Rect { x0: first(lo.x), y0: first(lo.y), x1: last(hi.x) + 1, y1: last(hi.y) + 1 })
    }

    /// Faces of a bin, ascending.
    pub(crate) fn faces(&self, x: u32, y: u32) -> &[u32] {
        self.bins.faces(x, y)
    }

    /// Texels of a bin.
    pub(crate) fn texels(&self, x: u32, y: u32) -> Rect {
        let end = |c: u32| ((c + 1) * self.side).min(self.size);
        Rect { x0: x * self.side, y0: y * self.side, x1: end(x), y1: end(y) }
    }

    /// Samples of a bin, the filter's border included.
    pub(crate) fn samples(&self, x: u32, y: u32) -> Rect {
        let Rect { x0, y0, x1, y1 } = self.texels(x, y);
        let whole = self.size * self.samples;
        let first = |c: u32| (c * self.samples).saturating_sub(self.border);
        let end = |c: u32| (c * self.samples + self.border).min(whole);
        Rect { x0: first(x0), y0: first(y0), x1: end(x1), y1: end(y1) }
    }

    /// `owners` becomes `[rows x columns]` of `rect` (samples): low face + 1 that owns the sample, 0 = none. `bin`: whose samples they are.
    /// How often another face covers one of the bin's own samples too; those of the filter's border are its neighbours' to count.
    pub(crate) fn own(&self, low: &Low<'_>, bin: [u32; 2], rect: Rect, owners: &mut Vec<u32>) -> u64 {
        let faces = self.faces(bin[0], bin[1]);
        let inner = self.texels(bin[0], bin[1]);
        let columns = inner.x0 * self.samples..inner.x1 * self.samples;
        let rows = inner.y0 * self.samples..inner.y1 * self.samples;
        let width = (rect.x1 - rect.x0) as usize;
        owners.clear();
        owners.resize(width * (rect.y1 - rect.y0) as usize, 0);
        let mut overlaps = 0;
        for face in faces {
            let corners = low.texels(*face as usize).map(|t| t * self.samples as f32);
            let Some(corners) = snap(corners) else { continue };
            rasterise_spans(corners, rect, |span| {
                let row = (span.y - rect.y0) as usize * width;
                let run = row + (span.x0 - rect.x0) as usize..row + (span.x1 - rect.x0) as usize;
                for (x, owner) in (span.x0..).zip(&mut owners[run]) {
                    if *owner == 0 {
                        *owner = face + 1;
                    } else {
                        overlaps += u64::from(columns.contains(&x) && rows.contains(&span.y));
                    }
                }
            });
        }
        overlaps
    }
}
