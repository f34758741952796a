//! The hit pass on the CPU; twin of `shaders/mirrored_vertex.wgsl`.
//!
//! Low faces are independent (a texel has one owner), so they run in parallel and each writes only its own texels.

use std::sync::atomic::{AtomicU32, Ordering};

use kiln_geom::raster::{Rect, rasterise_exact};
use rayon::prelude::*;

use super::candidates::{Candidate, Search};
use super::frame::{LowFace, Sheet};

/// What one thread keeps between low faces.
#[derive(Default)]
struct Scratch {
    faces: Vec<u32>,
    candidates: Vec<Candidate>,
    /// `[rect]` least depth so far and its high face + 1.
    nearest: Vec<(f32, u32)>,
}

/// `[size * size]` high face + 1 that is nearest to the owner's plane along its normal, 0 = no hit. With it the number of
/// (low, high) pairs looked at.
pub(crate) fn hits(sheet: &Sheet, search: &Search<'_>) -> (Vec<u32>, u64) {
    let hits: Vec<AtomicU32> = (0..sheet.owners.len()).map(|_| AtomicU32::new(0)).collect();
    let pairs = sheet
        .faces
        .par_iter()
        .enumerate()
        .map_init(Scratch::default, |scratch, (face, low)| one_face(face, low, sheet, search, scratch, &hits))
        .sum();
    (hits.into_iter().map(AtomicU32::into_inner).collect(), pairs)
}

fn one_face(
    face: usize,
    low: &LowFace,
    sheet: &Sheet,
    search: &Search<'_>,
    scratch: &mut Scratch,
    hits: &[AtomicU32],
) -> u64 {
    let Scratch { faces, candidates, nearest } = scratch;
    search.gather(face, low, faces, candidates);
    if candidates.is_empty() {
        return 0;
    }
    let Rect { x0, y0, x1, y1 } = low.rect;
    let (width, height) = (x1 - x0, y1 - y0);
    nearest.clear();
    nearest.resize(width as usize * height as usize, (1.0, 0));
    for candidate in candidates.iter() {
        let [k0, k1, k2] = candidate.heights.map(f64::from);
        rasterise_exact(candidate.corners, Rect::whole(width, height), |x, y, [w0, w1, w2], area| {
            let k = (w0 as f64 * k0 + w1 as f64 * k1 + w2 as f64 * k2) / area as f64;
            let distance = (k as f32).abs();
            if distance > search.cage {
                return;
            }
            let slot = &mut nearest[y as usize * width as usize + x as usize];
            let depth = depth(distance, search.cage, candidate.fallback);
            // Candidates ascend, so at equal depth the lower high face stays.
            if depth < slot.0 {
                *slot = (depth, candidate.high + 1);
            }
        });
    }
    for (row, y) in nearest.chunks_exact(width as usize).zip(y0..) {
        let start = y as usize * sheet.size as usize + x0 as usize;
        for (slot, texel) in row.iter().zip(start..) {
            if slot.1 != 0 && sheet.owners[texel] == face as u32 + 1 {
                hits[texel].store(slot.1, Ordering::Relaxed);
            }
        }
    }
    candidates.len() as u64
}

/// The depth that the test compares, in `[0, 1)`: half of distance / cage, behind all of the own submesh for a fallback.
#[inline]
fn depth(distance: f32, cage: f32, fallback: bool) -> f32 {
    let half = 0.499 * (distance / cage);
    if fallback { 0.5 + half } else { half }
}
