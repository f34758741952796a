//! Which face each sample sees.

use glam::Vec2;
use kiln_geom::raster::{Rect, rasterise_exact};

use super::Frame;

/// No face.
const NONE: u32 = u32::MAX;

/// The samples of a run of rows.
pub(super) struct Samples {
    width: u32,
    first_row: u32,
    seen: Vec<Seen>,
}

#[derive(Clone, Copy)]
struct Seen {
    depth: f64,
    face: u32,
    bary: [f32; 3],
}

impl Samples {
    /// Resolves rows `[first_row, end_row)` of samples against `faces`, ascending.
    pub(super) fn resolve(frame: &Frame<'_>, faces: &[u32], first_row: u32, end_row: u32) -> Samples {
        let [width, _] = frame.size;
        let nothing = Seen { depth: f64::INFINITY, face: NONE, bary: [0.0; 3] };
        let mut seen = vec![nothing; width as usize * (end_row - first_row) as usize];
        let rect = Rect { x0: 0, y0: first_row, x1: width, y1: end_row };
        for &face in faces {
            let Some(corners) = frame.corners(face) else { continue };
            let masked = frame.surface.is_masked(face);
            rasterise_exact(corners.map(|p| Vec2::new(p.x as f32, p.y as f32)), rect, |x, y, weights, area| {
                let flat = weights.map(|w| w as f64 / area as f64);
                let depth = flat[0] * corners[0].depth + flat[1] * corners[1].depth + flat[2] * corners[2].depth;
                let slot = &mut seen[(y - first_row) as usize * width as usize + x as usize];
                // Faces come in ascending order, so `<` leaves equal depths to the lower one.
                if depth < slot.depth {
                    let w = [0, 1, 2].map(|k: usize| flat[k] * corners[k].inverse_w);
                    let sum = w[0] + w[1] + w[2];
                    let bary = w.map(|w| (w / sum) as f32);
                    if !masked || frame.surface.is_opaque_at(frame, face, bary) {
                        *slot = Seen { depth, face, bary };
                    }
                }
            });
        }
        Samples { width, first_row, seen }
    }

    /// The face at a sample, with perspective-correct barycentric coordinates.
    pub(super) fn at(&self, x: u32, y: u32) -> Option<(u32, [f32; 3])> {
        let seen = &self.seen[(y - self.first_row) as usize * self.width as usize + x as usize];
        (seen.face != NONE).then_some((seen.face, seen.bary))
    }
}
