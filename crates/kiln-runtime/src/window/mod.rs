//! Sliding window: any number of triangles out of level 0's buffers.
//!
//! **Problem.** In: a window section ([`WindowView`]), level 0's indices and draw ranges. Out, for any LOD `d` (`d` collapses done):
//! which vertex each vertex picks, how many triangles of each draw range are alive, vertex or index buffers to draw, and which LOD
//! a budget or a view wants. Nothing is allocated; whoever has threads splits ranges over them.
//!
//! **Method.**
//! ```text
//! v(d)     first vertex of the d-th point from the end: the vertices before it are alive       (bits counted from the end)
//! pick     of vertex i: while i >= v(d): i = parents[i]
//! all      parents come first, so one pass resolves all: pick[i] = i < v(d) ? i : pick[parents[i]]; then out[i] = source[pick[i]]
//! update   from one LOD to another: the same pass from the lesser v(d) on, and a word for each pick that differs
//! drawn    of a range: its triangles whose corners pick three points; they stand first, so their number is found by bisection
//! choose   by triangles: bisection over d; by error: checkpoints, and between two of them in proportion
//! ```
//! Draw either the picked vertices with level 0's indices, or level 0's vertices with picked indices: the first `triangles` of each
//! range both times. GPU forms: `shaders/window_pick.wgsl` (`pick.rs` is its twin) and `shaders/window_draw.wgsl`.
//!
//! **Departures** from the paper's figure 3: numbers run the other way; its loop stops at the new LOD, so that refining leaves
//! vertices behind that must come back, and copies `Original[i]` where it means the i-th of the chain.
//!
//! **Limits.** Views need not be validated: numbers out of range give short or empty results, a parent that does not come first
//! ends a chain. What is drawn then is nonsense within bounds.
//!
//! **Sources.** O. Ripolles, F. Ramos, M. Chover, "Sliding-Tris: a sliding window level-of-detail scheme".

mod choose;
mod pick;
#[cfg(test)]
pub(crate) mod tests;

use kiln_format::{DrawRange, Indices, LevelView, WindowView};

/// A window over level 0.
#[derive(Clone, Copy)]
pub struct Window<'a> {
    view: WindowView<'a>,
    indices: Indices<'a>,
    ranges: &'a [DrawRange],
}

/// A level of detail of a window: [`Window::lod`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowLod {
    detail: u32,
    vertices: u32,
}

impl WindowLod {
    /// d: collapses done, 0 the finest.
    pub fn detail(self) -> u32 {
        self.detail
    }

    /// v(d): vertices that are alive; they are the first ones.
    pub fn vertices(self) -> u32 {
        self.vertices
    }
}

impl<'a> Window<'a> {
    /// `indices` and `ranges`: level 0's.
    pub fn new(view: WindowView<'a>, indices: Indices<'a>, ranges: &'a [DrawRange]) -> Window<'a> {
        Window { view, indices, ranges }
    }

    /// The same out of level 0.
    pub fn of_level(view: WindowView<'a>, level0: &LevelView<'a>) -> Window<'a> {
        Window::new(view, level0.indices(), level0.ranges)
    }

    /// The section.
    pub fn view(&self) -> &WindowView<'a> {
        &self.view
    }

    /// Level 0's indices.
    pub fn indices(&self) -> Indices<'a> {
        self.indices
    }

    /// Level 0's draw ranges, one a submesh.
    pub fn ranges(&self) -> &'a [DrawRange] {
        self.ranges
    }

    /// Vertices of LOD 0.
    pub fn vertex_count(&self) -> u32 {
        u32::try_from(self.view.parents.len()).unwrap_or(u32::MAX)
    }

    /// D: the coarsest LOD.
    pub fn collapses(&self) -> u32 {
        self.view.header.collapses.min(self.vertex_count())
    }

    /// LOD `detail`; the coarsest from there on.
    pub fn lod(&self, detail: u32) -> WindowLod {
        let detail = detail.min(self.collapses());
        let base = self.view.header.base_vertices.min(self.vertex_count());
        WindowLod { detail, vertices: self.start_from_end(detail).max(base) }
    }

    /// The finest LOD with at most `vertices` alive; the coarsest if none has so few.
    pub fn lod_of_vertices(&self, vertices: u32) -> WindowLod {
        let lod = self.lod(self.starts_from(vertices));
        // It may lie within a point.
        if lod.vertices > vertices { self.lod(lod.detail.saturating_add(1)) } else { lod }
    }

    /// Start of the `n`-th point from the end, the vertex count for 0.
    fn start_from_end(&self, n: u32) -> u32 {
        let count = self.vertex_count();
        if self.view.starts.is_empty() || n == 0 {
            return count - n.min(count);
        }
        let mut left = n;
        for (word, bits) in self.view.starts.iter().enumerate().rev() {
            let ones = bits.count_ones();
            if left <= ones {
                return (32 * word as u32 + nth_highest(*bits, left)).min(count);
            }
            left -= ones;
        }
        0
    }

    /// Points that start at vertex `v` or behind it.
    fn starts_from(&self, v: u32) -> u32 {
        let count = self.vertex_count();
        if self.view.starts.is_empty() || v >= count {
            return count.saturating_sub(v);
        }
        let words = &self.view.starts.get(v as usize / 32..).unwrap_or(&[]);
        let behind: u32 = words.iter().skip(1).map(|word| word.count_ones()).sum();
        behind + words.first().map_or(0, |word| (word >> (v % 32)).count_ones())
    }

    /// Whether two vertices are of one point.
    fn is_one_point(&self, a: u32, b: u32) -> bool {
        let (low, high) = (a.min(b), a.max(b));
        if low == high || self.view.starts.is_empty() {
            return low == high;
        }
        // No point starts behind the first and up to the second.
        let (first, last) = (low as usize + 1, high as usize);
        let masked = |word: usize| {
            let bits = self.view.starts.get(word).copied().unwrap_or(0);
            let from = if word == first / 32 { u32::MAX << (first % 32) } else { u32::MAX };
            let to = if word == last / 32 { u32::MAX >> (31 - last % 32) } else { u32::MAX };
            bits & from & to
        };
        (first / 32..=(last / 32).min(self.view.starts.len())).all(|word| masked(word) == 0)
    }

    /// Corners of a triangle, by its number in its range.
    fn triangle(&self, range: &DrawRange, number: u32) -> Option<[u32; 3]> {
        let first = (range.first_index as usize).checked_add(3 * number as usize)?;
        Some([self.indices.get(first)?, self.indices.get(first + 1)?, self.indices.get(first + 2)?])
    }

    /// Triangles of a range at LOD 0, as far as there are indices.
    fn range_triangles(&self, range: &DrawRange) -> u32 {
        let behind = self.indices.len().saturating_sub(range.first_index as usize);
        u32::try_from(behind).unwrap_or(u32::MAX).min(range.index_count) / 3
    }

    /// Triangles of a submesh that are drawn at `lod`: the first ones of its range.
    pub fn triangles(&self, lod: WindowLod, submesh: usize) -> u32 {
        let Some(range) = self.ranges.get(submesh) else { return 0 };
        let (mut low, mut high) = (0, self.range_triangles(range));
        while low < high {
            let middle = low + (high - low) / 2;
            let alive = self.triangle(range, middle).is_some_and(|triangle| self.is_drawn(triangle, lod));
            if alive { low = middle + 1 } else { high = middle }
        }
        low
    }

    /// Triangles of all submeshes that are drawn at `lod`.
    pub fn triangle_count(&self, lod: WindowLod) -> u64 {
        (0..self.ranges.len()).map(|submesh| u64::from(self.triangles(lod, submesh))).sum()
    }

    fn is_drawn(&self, triangle: [u32; 3], lod: WindowLod) -> bool {
        let [a, b, c] = triangle.map(|v| self.pick(lod, v));
        !self.is_one_point(a, b) && !self.is_one_point(b, c) && !self.is_one_point(c, a)
    }
}

/// Place of the `n`-th highest one of `bits`, `n` from 1 to their number.
fn nth_highest(mut bits: u32, n: u32) -> u32 {
    for _ in 1..n {
        bits &= !(1 << (31 - bits.leading_zeros()));
    }
    31 - bits.leading_zeros()
}
