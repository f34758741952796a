//! The hit pass alone, for measuring.

use std::time::Duration;

use glam::Vec3;
use rayon::prelude::*;

use super::options::{Backend, BakeError, BakeInput, BakeOptions, BakeReport};
use super::pass::{Counts, Pass, Tree};
use super::reach;
use super::resolve::{self, Needs};

/// Which high face each texel of a sheet shows: the hit pass alone, before anything is sampled; for measuring.
pub struct HitBuffer<'a> {
    pass: Pass<'a>,
    /// `[size * size]` low face + 1 that owns the texel's centre, 0 = none.
    pub low_faces: Vec<u32>,
    /// `[size * size]` high face + 1 that won, 0 = none within reach.
    pub high_faces: Vec<u32>,
    /// Everything known so far.
    pub report: BakeReport,
    /// What a device took of the time, its uploads and read-backs included, as far as the CPU waited for it.
    pub device: Duration,
}

/// The hit pass of the first sheet alone, one sample a texel. The finest level needs `atlas_uv`.
///
/// # Errors
/// Options out of range, missing attributes, a failing device.
pub fn find_hits<'a>(
    input: &BakeInput<'a>,
    options: &'a BakeOptions,
    backend: Backend<'a>,
) -> Result<HitBuffer<'a>, BakeError> {
    let finest = &input.low.levels.first().ok_or(BakeError::NoLevels)?.mesh;
    if options.samples != 1 {
        let (found, expected) = (options.samples.to_string(), "1 for the hit pass alone".into());
        return Err(BakeError::Option { name: "samples", found, expected });
    }
    let reach = reach(input.high, input.low.levels[0].error, options);
    let pass = Pass::new(input, &Tree::of(input.high), finest, 0, options, reach, backend)?;
    let size = pass.sheet.size as usize;
    let (mut low_faces, mut high_faces) = (vec![0u32; size * size], vec![0u32; size * size]);
    let rows = pass.sheet.side as usize * size;
    let bands = low_faces.chunks_mut(rows).zip(high_faces.chunks_mut(rows)).collect();
    let counts = pass.each_row(bands, |y, (low, high), stripe, bench| {
        let mut counts = Counts::default();
        for x in 0..pass.sheet.across {
            let rect = pass.sheet.samples(x, y);
            counts = counts + pass.hits(x, y, stripe, bench);
            let width = (rect.x1 - rect.x0) as usize;
            for (row, from) in bench.owners.chunks_exact(width).zip(bench.winners.chunks_exact(width)).enumerate() {
                let start = row * size + rect.x0 as usize;
                low[start..start + width].copy_from_slice(from.0);
                high[start..start + width].copy_from_slice(from.1);
            }
        }
        counts
    })?;
    let count = |texels: &[u32]| texels.iter().filter(|t| **t != 0).count() as u64;
    let counts = Counts { owned: count(&low_faces), covered: count(&high_faces), ..counts };
    let mut report =
        BakeReport { size: options.size, front: reach[0], back: reach[1], sheets: 1, ..BakeReport::default() };
    pass.account(counts, &mut report);
    Ok(HitBuffer { pass, low_faces, high_faces, report, device: counts.device })
}

impl HitBuffer<'_> {
    /// `[size * size]` normals of the high mesh at the hits, object space, unit length, without its normal maps; zero where
    /// nothing is hit. For measuring: full precision.
    pub fn object_normals(&self) -> Vec<Vec3> {
        let Some(normals) = self.pass.high.normals.as_deref() else { return Vec::new() };
        self.each(Vec3::ZERO, |hit| {
            let corners = self.pass.high.triangles[hit.high].map(|v| normals[v as usize]);
            let turn = if hit.turned { -1.0 } else { 1.0 };
            turn * resolve::mix3(corners, hit.high_bary).normalize_or_zero()
        })
    }

    /// `[size * size]` hit points, object space; `None` where nothing is hit.
    pub fn positions(&self) -> Vec<Option<Vec3>> {
        self.each(None, |hit| {
            let corners = self.pass.high.face_positions(kiln_asset::FaceId(hit.high as u32));
            Some(resolve::mix3(corners, hit.high_bary))
        })
    }

    fn each<T: Clone + Send + Sync>(&self, nothing: T, visit: impl Fn(&resolve::HitPoint) -> T + Sync) -> Vec<T> {
        let size = self.pass.sheet.size as usize;
        let mut out = vec![nothing; size * size];
        out.par_chunks_mut(size).enumerate().for_each_init(
            || self.pass.locator(),
            |locator, (y, row)| {
                for (x, slot) in row.iter_mut().enumerate() {
                    let (low, high) = (self.low_faces[y * size + x], self.high_faces[y * size + x]);
                    if high == 0 {
                        continue;
                    }
                    let sample = [x as u32, y as u32];
                    if let Some(hit) = locator.at(sample, low as usize - 1, high as usize - 1, Needs::default()) {
                        *slot = visit(&hit);
                    }
                }
            },
        );
        out
    }
}
