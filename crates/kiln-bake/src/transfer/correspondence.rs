//! The hit pass of thesis section 6.2: the high mesh drawn in its own layout; a sample shows what lies at its texture coordinates.
//!
//! Right only where both meshes share one layout, and that has no overlaps: samples that several high faces cover are counted.

use glam::Vec2;
use kiln_asset::Mesh;
use kiln_geom::raster::{Rect, rasterise_spans, snap};
use rayon::prelude::*;

use super::sheet::Bins;

/// The high mesh in its layout.
pub(crate) struct Layout<'a> {
    high: &'a Mesh,
    /// `[high vertex_count]`.
    pub(crate) uv: &'a [Vec2],
    bins: Bins,
    /// Side of a bin, samples.
    side: u32,
    /// Samples across and down.
    scale: f32,
}

impl<'a> Layout<'a> {
    /// `whole`: samples across and down.
    pub(crate) fn new(high: &'a Mesh, uv: &'a [Vec2], whole: u32) -> Layout<'a> {
        let side = 128;
        let across = whole.div_ceil(side);
        let scale = whole as f32;
        let place = |face: usize| {
            let [a, b, c] = high.triangles[face].map(|v| uv[v as usize] * scale);
            let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
            let bin = |c: f32| ((c.max(0.0) as u32) / side).min(across - 1);
            let seen =
                lo.is_finite() && hi.is_finite() && hi.cmpge(Vec2::ZERO).all() && lo.cmple(Vec2::splat(scale)).all();
            let [x0, y0, x1, y1] = [bin(lo.x - 1.0), bin(lo.y - 1.0), bin(hi.x + 1.0), bin(hi.y + 1.0)];
            seen.then_some(Rect { x0, y0, x1: x1 + 1, y1: y1 + 1 })
        };
        let places: Vec<Option<Rect>> = (0..high.face_count()).into_par_iter().map(place).collect();
        Layout { high, uv, bins: Bins::new(across, &places), side, scale }
    }

    /// `winners` becomes `[rows x columns]` of `rect` (samples): high face + 1 that covers an owned sample, the lowest of several; 0 = none.
    /// Faces looked at, and owned samples that more than one covers.
    pub(crate) fn find(&self, rect: Rect, owners: &[u32], winners: &mut Vec<u32>) -> (u64, u64) {
        winners.clear();
        winners.resize(owners.len(), 0);
        let width = (rect.x1 - rect.x0) as usize;
        let bins = |lo: u32, hi: u32| lo / self.side..=(hi.max(1) - 1) / self.side;
        let mut faces: Vec<u32> = Vec::new();
        for y in bins(rect.y0, rect.y1) {
            for x in bins(rect.x0, rect.x1) {
                faces.extend(self.bins.faces(x, y));
            }
        }
        faces.sort_unstable();
        faces.dedup();
        let mut overlaps = 0;
        for face in &faces {
            let corners = self.high.triangles[*face as usize].map(|v| self.uv[v as usize] * self.scale);
            let Some(corners) = snap(corners) else { continue };
            rasterise_spans(corners, rect, |span| {
                let row = (span.y - rect.y0) as usize * width;
                for index in row + (span.x0 - rect.x0) as usize..row + (span.x1 - rect.x0) as usize {
                    if owners[index] == 0 {
                        continue;
                    }
                    if winners[index] == 0 {
                        winners[index] = face + 1;
                    } else {
                        overlaps += 1;
                    }
                }
            });
        }
        (faces.len() as u64, overlaps)
    }
}
