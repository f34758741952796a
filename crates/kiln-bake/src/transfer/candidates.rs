//! Which high triangles may cover a texel of a low triangle: those that meet its prism and face its way.

use glam::{Vec2, Vec3};
use kiln_asset::{FaceId, Mesh, SubmeshId};
use kiln_geom::Bvh;

use super::frame::LowFace;

/// Marks a pair of different submeshes, in the top bit of its low face; `FALLBACK` in `shaders/mirrored_vertex.wgsl`.
pub(crate) const FALLBACK: u32 = 1 << 31;

/// A high triangle in the texel space of one low triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    /// The high face.
    pub(crate) high: u32,
    /// It belongs to another submesh and counts only where the low face's own submesh offers nothing.
    pub(crate) fallback: bool,
    /// Its corners, texels from the low face's rectangle.
    pub(crate) corners: [Vec2; 3],
    /// Its corners' signed distance from the low face's plane, object units.
    pub(crate) heights: [f32; 3],
}

/// The high mesh, ready to be searched.
pub(crate) struct Search<'a> {
    high: &'a Mesh,
    low: &'a Mesh,
    bvh: Bvh,
    /// Greatest distance from a low triangle's plane, object units.
    pub(crate) cage: f32,
    back_faces: bool,
    /// `[low submesh_count]`: the high submesh of the same name; `None`: any will do.
    same: Vec<Option<SubmeshId>>,
}

impl<'a> Search<'a> {
    pub(crate) fn new(high: &'a Mesh, low: &'a Mesh, cage: f32, back_faces: bool, prefer_same: bool) -> Search<'a> {
        let same = low
            .submeshes
            .iter()
            .map(|l| high.submeshes.iter().position(|h| prefer_same && h.name == l.name))
            .map(|found| found.map(|s| SubmeshId(s as u32)))
            .collect();
        Search { high, low, bvh: Bvh::new(&high.positions, &high.triangles), cage, back_faces, same }
    }

    /// The high mesh.
    pub(crate) fn high(&self) -> &'a Mesh {
        self.high
    }

    /// The candidates of low face `face`, ascending by high face. `faces` is scratch space.
    pub(crate) fn gather(&self, face: usize, low: &LowFace, faces: &mut Vec<u32>, out: &mut Vec<Candidate>) {
        out.clear();
        let Some(frame) = &low.frame else { return };
        if low.rect.x0 == low.rect.x1 {
            return;
        }
        let extent = Vec2::new((low.rect.x1 - low.rect.x0) as f32, (low.rect.y1 - low.rect.y0) as f32);
        let normal = frame.normal();
        let same = self.same[self.low.face_submesh[face].index()];
        self.bvh.overlapping_prism(self.low.face_positions(FaceId(face as u32)), normal, self.cage, self.cage, faces);
        for high in faces.iter().copied() {
            let positions = self.high.face_positions(FaceId(high));
            if !self.back_faces && !faces_along(positions, normal) {
                continue;
            }
            let projected = positions.map(|p| frame.project(p));
            let (corners, heights) = (projected.map(|c| c.0), projected.map(|c| c.1));
            let [a, b, c] = corners;
            let (lo, hi) = (a.min(b).min(c), a.max(b).max(c));
            let outside = hi.cmplt(Vec2::ZERO).any() || lo.cmpgt(extent).any();
            if outside || heights.iter().all(|k| *k > self.cage) || heights.iter().all(|k| *k < -self.cage) {
                continue;
            }
            let fallback = same.is_some_and(|s| s != self.high.face_submesh[high as usize]);
            out.push(Candidate { high, fallback, corners, heights });
        }
    }
}

/// Whether a triangle's own normal lies within 90 degrees of `direction`. In space, never by screen winding: mirrored charts
/// flip that.
pub(crate) fn faces_along(positions: [Vec3; 3], direction: Vec3) -> bool {
    let [a, b, c] = positions.map(|p| p.as_dvec3());
    (b - a).cross(c - a).dot(direction.as_dvec3()) > 0.0
}
