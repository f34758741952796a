//! From the level back to its source: an edge of the level may bridge a valley where no vertex of the source lies near it.
//!
//! Places along the inner edges of the level are tied to the nearest point of the source. It is found without a search, too: of the
//! samples on the two faces beside the edge one is near, and from there a walk over the source's faces is short.

use glam::DVec3;
use rayon::prelude::*;

use super::stars::Stars;
use super::{Fit, Tie};
use crate::topology::NONE;

/// Where on an edge. Two or three places (0.3 and 0.7; 0.2, 0.5 and 0.8) lower the mean distance by less than 1 % and cost a walk each.
pub(super) const SHARES: [f64; 1] = [0.5];
/// What all places on an edge count, beside a third of its faces' area. More lowers the greatest distance of scans by a few percent,
/// but bends coarse textured models: the portal's image error at a tenth is 15.8 with 0.25 and 19.0 with 1.
const WEIGHT: f64 = 0.25;

/// The ties by the face that they lie on.
pub(super) struct ByFace {
    /// `[face_count + 1]`.
    first: Vec<u32>,
    /// The source's vertices.
    samples: Vec<u32>,
}

impl ByFace {
    pub(super) fn new(ties: &[Tie], face_count: usize) -> ByFace {
        let mut first = vec![0u32; face_count + 2];
        for tie in ties {
            first[tie.face as usize + 2] += 1;
        }
        for i in 2..first.len() {
            first[i] += first[i - 1];
        }
        let mut samples = vec![0; ties.len()];
        for tie in ties {
            let slot = &mut first[tie.face as usize + 1];
            samples[*slot as usize] = tie.sample;
            *slot += 1;
        }
        first.pop();
        ByFace { first, samples }
    }

    /// The samples on a face.
    pub(super) fn on(&self, face: u32) -> &[u32] {
        &self.samples[self.first[face as usize] as usize..self.first[face as usize + 1] as usize]
    }
}

/// A point of the source.
pub(super) struct OnSource {
    pub(super) point: DVec3,
    /// Away from the surface: of the face where it lies inside one, else the way there.
    pub(super) direction: DVec3,
    pub(super) square: f64,
}

impl Fit<'_> {
    /// The nearest point of the source to `x`, which lies on one of `faces`, as far as the samples there lead; `None` if there are none.
    pub(super) fn on_source(&self, x: DVec3, faces: [u32; 2], samples: &ByFace) -> Option<OnSource> {
        let mut nearest = (f64::INFINITY, NONE);
        for v in faces.iter().flat_map(|f| samples.on(*f)) {
            let square = self.place_of_sample(*v).distance_squared(x);
            if square < nearest.0 {
                nearest = (square, *v);
            }
        }
        if nearest.1 == NONE {
            return None;
        }
        let topology = self.samples.topology;
        let stars = Stars::of_points(topology, &[]);
        let place = stars.walk(&self.samples.at, self.source.points[self.vertex_at(nearest.1) as usize].0, x);
        if place.face == NONE {
            return None;
        }
        let [a, b, c] = topology.face_points[place.face as usize].map(|p| self.samples.at[p as usize]);
        let [wa, wb, wc] = place.bary.map(f64::from);
        let point = a * wa + b * wb + c * wc;
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let inside = place.bary.iter().all(|b| *b > 0.0);
        let direction = if inside { normal } else { (x - point).normalize_or(normal) };
        Some(OnSource { point, direction, square: place.distance })
    }

    /// Ties of the edges of the faces `of` to the source; an edge is that of the lower of its faces.
    pub(super) fn ties_back(&self, at: &[DVec3], samples: &ByFace, of: impl Fn(u32) -> bool + Sync) -> Vec<Tie> {
        let faces = &self.topology.face_points;
        let area = |f: u32| {
            let [a, b, c] = faces[f as usize].map(|p| at[p as usize]);
            (b - a).cross(c - a).length() / 2.0
        };
        let of_face = |f: usize| {
            (0..3).flat_map(move |k| SHARES.map(|share| (k, share))).filter_map(move |(k, share)| {
                let twin = self.topology.twin((3 * f + k) as u32);
                if twin == NONE || twin as usize / 3 <= f {
                    return None;
                }
                let beside = [f as u32, twin / 3];
                let next = (k + 1) % 3;
                let x = at[faces[f][k] as usize].lerp(at[faces[f][next] as usize], share);
                let found = self.on_source(x, beside, samples)?;
                let mut bary = [0.0; 3];
                (bary[k], bary[next]) = (1.0 - share, share);
                Some(Tie {
                    sample: NONE,
                    face: f as u32,
                    points: faces[f],
                    bary,
                    direction: found.direction,
                    along: found.direction.dot(found.point),
                    weight: WEIGHT * (area(beside[0]) + area(beside[1])) / (3 * SHARES.len()) as f64,
                })
            })
        };
        let chosen = (0..faces.len()).into_par_iter().filter(|f| of(*f as u32));
        chosen.flat_map_iter(of_face).collect()
    }
}
