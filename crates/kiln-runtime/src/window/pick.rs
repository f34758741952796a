//! Picking: which vertex stands for which. Twin of `shaders/window_pick.wgsl` and of `shaders/window_draw.wgsl`.
//!
//! Output comes in pieces: `first` is the vertex (or triangle) of the piece's first element, its length says how many there are.
//! Pieces on any number of threads give the same as one piece. With threads, a LOD is
//! ```text
//! for each range of rounds(lod):          done | block <- picks, split there
//!     pieces of block, in parallel:       resolve(lod, done, first, piece)
//! pieces of the output, in parallel:      pick_elements(lod, their picks, first, source, piece)
//! ```
//! Why a table and not a fill along chains: random reads are all it costs. The table is the smallest thing to read at random, each
//! vertex reads it once, and the coarser the LOD, the smaller the part of the source that is read. A chain reads parents at
//! random as often as it is long, and each step waits for the one before. To fill pieces of the output between rounds was slower:
//! what is written drives the table out of the cache.

use core::ops::Range;

use super::{Window, WindowLod};

/// The pick of vertex `i` while the first `alive` are; the last vertex whose parent comes first, if a chain ends before.
#[inline]
fn walk(parents: &[u32], mut i: u32, alive: u32) -> u32 {
    while i >= alive {
        match parents.get(i as usize) {
            Some(parent) if *parent < i => i = *parent,
            _ => break,
        }
    }
    i
}

impl Window<'_> {
    /// The vertex that vertex `i` picks, by its chain: what one vertex costs. All of them: [`Window::picks`].
    #[inline]
    pub fn pick(&self, lod: WindowLod, i: u32) -> u32 {
        walk(self.view.parents, i, lod.vertices)
    }

    /// The picks of all vertices (`[vertex_count]`, vertices; those behind the last vertex stay) in one pass on one thread.
    pub fn picks(&self, lod: WindowLod, out: &mut [u32]) {
        self.resolve(lod, &[], 0, out);
    }

    /// The same by threads: ranges to be resolved one after the other, each in as many pieces as there are threads. Ranges grow by a
    /// quarter: few parents lie in the range itself but outside of a piece, where a chain is walked, and the rounds are few.
    pub fn rounds(&self, lod: WindowLod) -> impl Iterator<Item = Range<u32>> + use<> {
        // Below that, waiting costs more than resolving.
        const LEAST: u32 = 1 << 14;
        let (count, alive) = (self.vertex_count(), lod.vertices.min(self.vertex_count()));
        let next = move |range: &Range<u32>| {
            let length = (range.end / 4).max(LEAST).min(count - range.end);
            (length > 0).then(|| range.end..range.end + length)
        };
        core::iter::successors((count > 0).then(|| 0..alive.max(LEAST.min(count))), next)
    }

    /// The picks of vertices `first..`, as many as `out` is long. `done`: those of all vertices before a place at or before `first`;
    /// the nearer that is to `first`, the faster.
    pub fn resolve(&self, lod: WindowLod, done: &[u32], first: u32, out: &mut [u32]) {
        let kept = self.kept(lod, first, out.len());
        out.iter_mut().take(kept).zip(first..).for_each(|(pick, v)| *pick = v);
        let from = lod.vertices.max(u32::try_from(done.len()).unwrap_or(u32::MAX));
        let parents = self.view.parents.get(first as usize..).unwrap_or(&[]);
        for (k, parent) in parents.iter().enumerate().take(out.len()).skip(kept) {
            let v = first + k as u32;
            let local = *parent >= first;
            // Where its parent stands resolved: in this piece or before it. A choice of slices costs less than a branch that nobody
            // can foresee; what is left to branches is rare.
            let earlier = if !local && *parent >= from { walk(self.view.parents, *parent, from) } else { *parent };
            let (resolved, at) = if local { (&*out, *parent - first) } else { (done, earlier) };
            let pick = resolved.get(at as usize).copied().unwrap_or(earlier);
            out[k] = if *parent < v { pick } else { v };
        }
    }

    /// What vertices `first..` pick of a vertex array: positions, normals, UVs.
    ///
    /// `picks`: `[n]`, theirs; `source`: `[vertex_count]`; `out`: `[n]`, elements behind the last vertex stay.
    pub fn pick_elements<T: Copy>(&self, lod: WindowLod, picks: &[u32], first: u32, source: &[T], out: &mut [T]) {
        let own = source.get(first as usize..).unwrap_or(&[]);
        let kept = self.kept(lod, first, out.len().min(own.len()));
        out[..kept].copy_from_slice(&own[..kept]);
        for ((out, own), pick) in out.iter_mut().zip(own).zip(picks).skip(kept) {
            *out = *source.get(*pick as usize).unwrap_or(own);
        }
    }

    /// How many of `count` vertices from `first` on pick themselves because they are alive.
    fn kept(&self, lod: WindowLod, first: u32, count: usize) -> usize {
        (lod.vertices.min(self.vertex_count()).saturating_sub(first) as usize).min(count)
    }

    /// Brings `picks`, those of all vertices at `from`, to `to`, and tells `changed` each vertex whose pick is another, with the new
    /// one, in ascending order: what an engine copies into its vertex buffer.
    pub fn update(&self, from: WindowLod, to: WindowLod, picks: &mut [u32], mut changed: impl FnMut(u32, u32)) {
        let first = from.vertices.min(to.vertices);
        for v in first..self.vertex_count().min(u32::try_from(picks.len()).unwrap_or(u32::MAX)) {
            let parent = self.view.parents[v as usize];
            let pick = if v < to.vertices || parent >= v { v } else { picks[parent as usize] };
            if picks[v as usize] != pick {
                picks[v as usize] = pick;
                changed(v, pick);
            }
        }
    }

    /// Indices of the triangles `first..` of a submesh, picked: with level 0's vertices they draw what is left of these triangles.
    /// `out`: `[3 n]`, written for triangles that the submesh has at LOD 0; the first [`Window::triangles`] of them are drawn.
    pub fn pick_indices(&self, lod: WindowLod, submesh: usize, first: u32, out: &mut [u32]) {
        self.each_index(submesh, first, out, |v| self.pick(lod, v));
    }

    /// The same by [`Window::picks`] of all vertices: faster where most triangles are alive.
    pub fn map_indices(&self, picks: &[u32], submesh: usize, first: u32, out: &mut [u32]) {
        self.each_index(submesh, first, out, |v| picks.get(v as usize).copied().unwrap_or(v));
    }

    #[inline(always)]
    fn each_index(&self, submesh: usize, first: u32, out: &mut [u32], of: impl Fn(u32) -> u32) {
        let Some(range) = self.ranges.get(submesh) else { return };
        let left = 3 * self.range_triangles(range).saturating_sub(first) as usize;
        let start = range.first_index as usize + 3 * first as usize;
        let count = left.min(out.len());
        match self.indices {
            kiln_format::Indices::U16(indices) => {
                let indices = indices.get(start..).unwrap_or(&[]);
                out[..count].iter_mut().zip(indices).for_each(|(out, v)| *out = of(u32::from(*v)));
            }
            kiln_format::Indices::U32(indices) => {
                let indices = indices.get(start..).unwrap_or(&[]);
                out[..count].iter_mut().zip(indices).for_each(|(out, v)| *out = of(*v));
            }
        }
    }

    /// Positions on the way from `fine` (factor 0) to `coarse` (factor 1, fewer vertices), for vertices `first..`; drawn with the
    /// triangles of `fine`, nothing pops. `positions`: `[vertex_count]`, `out`: `[n]`, object units; `factor`: unitless.
    pub fn morph_positions(
        &self,
        [fine, coarse]: [WindowLod; 2],
        factor: f32,
        first: u32,
        positions: &[[f32; 3]],
        out: &mut [[f32; 3]],
    ) {
        let count = positions.len().min(self.view.parents.len()).saturating_sub(first as usize);
        for (out, v) in out.iter_mut().take(count).zip(first..) {
            let near = self.pick(fine, v);
            let far = self.pick(coarse, near);
            let [a, b] = [near, far].map(|v| positions[v as usize]);
            // This form is exact at both ends.
            *out = core::array::from_fn(|k| if near == far { a[k] } else { a[k] * (1.0 - factor) + b[k] * factor });
        }
    }
}
