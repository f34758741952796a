//! Tree and leaf buffers, compact tree: choosing a threshold, picking, and what to draw.
//!
//! A threshold t says how fine: the tree's nodes of rank below t are split, and each vertex stands where its shallowest node that is
//! not split does, or, if all over it are split, where it is itself. Four ways to pick, one result, bit for bit:
//!
//! | way | over | a vertex costs | good for |
//! | --- | --- | --- | --- |
//! | [`TreeLeaf::pick`] | tree and leaf buffers | at most three reads | shaders; any part of the vertices |
//! | [`Compact::pick`] | compact tree | a walk from its terminal node | shaders; small memory |
//! | [`Resolved::pick`] | compact tree | one read, after a pass over the nodes | any order of vertices |
//! | [`Runs::pick`] | compact tree, prepared | a copy | vertices in the tree's order |
//!
//! ```text
//! t    <- most triangles:  the last of face_counts that is not more
//!         or an error:     the checkpoint with the greatest error that is allowed
//! pick <- one of the above, a range of vertices at a time: the caller deals ranges to threads
//! draw <- triangles whose death (the node at which two corners meet, computed once) has a rank below t
//! ```
//! On a device, vertex shaders pick while they draw (`shaders/tree_draw.wgsl`) or a pass fills a vertex buffer (`kiln_runtime::gpu::tree`).
//!
//! **Limits.** Views may be bytes from anywhere: wrong numbers give wrong positions, never a panic, and walks end because a parent's
//! rank must be below its child's. Between checkpoints no error is known, so by error the next finer checkpoint is taken.
//!
//! Source: T. Kanaya et al., "A Method for Storing Clustering Information of Model Simplification in GPUs", WSCG 2011, section 2.5;
//! `formats/container-v1.md`, sections 5.2 and 5.3.

mod compact;
mod draw_list;
mod runs;
#[cfg(test)]
pub(crate) mod tests;
mod tree_leaf;

pub use compact::{Compact, Resolved};
pub use draw_list::{alive_count, draw_list};
pub use runs::Runs;
pub use tree_leaf::TreeLeaf;

use kiln_format::layout::Checkpoint;

use crate::View;

/// A place to write: three or four floats a vertex; the fourth is 1.
pub trait Place: Copy {
    /// x, y, z, object units.
    fn at(position: [f32; 3]) -> Self;
}

impl Place for [f32; 3] {
    #[inline(always)]
    fn at(position: [f32; 3]) -> Self {
        position
    }
}

impl Place for [f32; 4] {
    #[inline(always)]
    fn at([x, y, z]: [f32; 3]) -> Self {
        [x, y, z, 1.0]
    }
}

/// A wanted r as a pick takes it: `row + fraction`, the fraction in `[0, 1)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RLevel {
    /// Integer part.
    pub row: u32,
    /// `k / n`, as texels hold it; unitless.
    pub fraction: f32,
}

/// What both layouts say of their scale.
#[derive(Clone, Copy, Debug)]
pub struct Scale<'a> {
    /// Finest first.
    pub checkpoints: &'a [Checkpoint],
    /// `[rows + 1]`.
    pub row_starts: &'a [u32],
    /// `[nodes + 1]`.
    pub face_counts: &'a [u32],
}

impl Scale<'_> {
    /// N: the threshold of full detail.
    pub fn finest(&self) -> u32 {
        self.face_counts.len().saturating_sub(1) as u32
    }

    /// Triangles alive at `threshold`; beyond N, all.
    pub fn triangles(&self, threshold: u32) -> u32 {
        self.face_counts.get(threshold as usize).or(self.face_counts.last()).copied().unwrap_or(0)
    }

    /// The greatest threshold with at most `budget` triangles alive.
    pub fn within_triangles(&self, budget: u32) -> u32 {
        self.face_counts.partition_point(|count| *count <= budget).saturating_sub(1) as u32
    }

    /// The threshold of the coarsest checkpoint whose error, object units, is at most `error`; N if there is none.
    pub fn within_error(&self, error: f32) -> u32 {
        let fine_enough = self.checkpoints.iter().rfind(|checkpoint| checkpoint.error <= error);
        fine_enough.map_or(self.finest(), |checkpoint| checkpoint.detail.min(self.finest()))
    }

    /// The threshold of the coarsest checkpoint whose error covers at most `max_error_px` pixels in `view`; N if there is none.
    pub fn within_pixels(&self, view: &View, max_error_px: f32) -> u32 {
        let scale = view.pixels_per_unit();
        let fine_enough = self.checkpoints.iter().rfind(|checkpoint| checkpoint.error * scale <= max_error_px);
        fine_enough.map_or(self.finest(), |checkpoint| checkpoint.detail.min(self.finest()))
    }

    /// The r at which the nodes of rank below `threshold` are split: the r_level of node `threshold - 1`; 0 for 0.
    pub fn r_of(&self, threshold: u32) -> RLevel {
        let Some(rank) = threshold.min(self.finest()).checked_sub(1) else { return RLevel::default() };
        let row = self.row_starts.partition_point(|start| *start <= rank).saturating_sub(1);
        let (start, end) = self.row(row);
        let (k, n) = (rank.saturating_sub(start).saturating_add(1), end.saturating_sub(start));
        match k < n {
            true => RLevel { row: row as u32, fraction: k as f32 / n as f32 },
            false => RLevel { row: row as u32 + 1, fraction: 0.0 },
        }
    }

    /// The threshold that `r` stands for: how many nodes have an r_level of at most r.
    pub fn threshold_of(&self, r: RLevel) -> u32 {
        if r.row as usize + 1 >= self.row_starts.len() {
            return self.finest();
        }
        let (start, end) = self.row(r.row as usize);
        let n = end.saturating_sub(start);
        // The greatest k whose quotient, rounded as in the texels, is not above.
        let (mut low, mut high) = (0, n);
        while low < high {
            let k = low + (high - low).div_ceil(2);
            if k as f32 / n as f32 <= r.fraction { low = k } else { high = k - 1 }
        }
        start.saturating_add(low).min(self.finest())
    }

    /// Where a row starts and ends, by rank.
    fn row(&self, row: usize) -> (u32, u32) {
        let at = |i: usize| self.row_starts.get(i).copied().unwrap_or(self.finest());
        (at(row), at(row + 1))
    }
}
