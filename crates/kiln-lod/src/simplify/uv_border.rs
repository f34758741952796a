//! Keeps chart borders of a shared UV layout in place: a coarser level's texels must be those that the finest level's bake filled.

use glam::Vec2;
use kiln_asset::{Mesh, UvLayout};

/// How far each wedge's chart border has already left the finest level's, a bound that accumulates, texels.
pub(super) struct UvBorder {
    /// By wedge.
    uv: Vec<Vec2>,
    size: f32,
    limit: f32,
    deviation: Vec<f32>,
}

impl UvBorder {
    /// For the atlas of `mesh`, or its first UV set where the atlas has become that; `wedges`: the mesh's vertices that are asked for.
    pub(super) fn new(mesh: &Mesh, layout: &UvLayout, wedges: &[u32]) -> UvBorder {
        let uv = mesh.atlas_uv.as_deref().or(mesh.uv0.as_deref());
        let uv: Vec<Vec2> = uv.map_or(Vec::new(), |uv| wedges.iter().map(|w| uv[*w as usize]).collect());
        let (size, limit) = (layout.size as f32, layout.padding as f32 / 2.0);
        UvBorder { deviation: vec![0.0; uv.len()], uv, size, limit }
    }

    fn moved(&self, from: u32, to: u32, other: u32) -> f32 {
        let [p, a, b] = [from, to, other].map(|w| self.uv[w as usize] * self.size);
        let along = b - a;
        let t = if along.length_squared() > 0.0 {
            ((p - a).dot(along) / along.length_squared()).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let known = [from, to, other].map(|w| self.deviation[w as usize]).into_iter().fold(0.0, f32::max);
        known + (a + along * t - p).length()
    }

    /// Whether every chart border through the wedges of `map` (from, to) stays within half the padding; `other` gives the
    /// border's next wedge on the far side of a wedge.
    pub(super) fn allows(&self, map: &[[u32; 2]], other: impl Fn(u32) -> Option<u32>) -> bool {
        self.uv.is_empty()
            || map.iter().all(|[from, to]| other(*from).is_none_or(|o| self.moved(*from, *to, o) <= self.limit))
    }

    /// Notes that the wedges went where `map` says.
    pub(super) fn applied(&mut self, map: &[[u32; 2]], other: impl Fn(u32) -> Option<u32>) {
        for [from, to] in map {
            if let (false, Some(o)) = (self.uv.is_empty(), other(*from)) {
                let moved = self.moved(*from, *to, o);
                for w in [*to, o] {
                    let slot = &mut self.deviation[w as usize];
                    *slot = slot.max(moved);
                }
            }
        }
    }
}
