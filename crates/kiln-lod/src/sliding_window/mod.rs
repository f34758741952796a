//! Sliding window: a continuous level of detail in which a level is a prefix of the vertex buffer and of each submesh's triangles.
//!
//! **Problem.** In: a mesh, its collapse sequence, and how many collapses are done in the finest level (level 0). Out: an order of
//! level 0's vertices and faces, and for each vertex the one that it turns into. Must not change: level 0's surface, the order of
//! its submeshes, and at every LOD `d` the triangles that the sequence has after `d` more collapses.
//!
//! **Method.** Ripolles et al. modify the vertices that fixed indices lead to. One parent a vertex stands for their chains:
//! ```text
//! points     <- those that never go, in the mesh's order; then the others, the first to go last
//! vertices   <- by point; the wedges of a point form one block, and go in one step
//! parents    <- the wedge that the collapse gives a wedge's corners to; itself if its point never goes
//! merge(a,b) <- two points: while a != b: the later of them becomes its parent; the last one that did so
//! death      <- of a face: the latest merge of two of its corners
//! faces      <- in each submesh by death; ties in the mesh's order
//! LOD d: v(d) = first vertex of the d-th point from the end;  pick(i): while i >= v(d): i = parents[i]
//!        a face is drawn while its corners pick three points: a prefix of its submesh, so its end is found by bisection
//! ```
//!
//! **Departures.** The paper numbers vertices the other way, so that its levels are suffixes; as prefixes they can be drawn before
//! the rest of a file is there. It stores chains (1.2 times indexed triangles); one parent a vertex is 1.11 times. It takes two
//! triangles a collapse, which holds inside closed manifolds only; here nothing is counted. A wedge without a partner at the kept
//! point would need a new ("fake") wedge there; rule `Partner` forbids such collapses, and partners are wedges of faces
//! that are still there, so they stand in level 0 already. What has no partner is a wedge that no living face uses: it goes to the
//! kept point's first.
//!
//! **Limits.** Half-edge collapses and prefixes of one sequence only: no free placement, no cuts by parts. The order of collapse
//! scatters neighbours over the buffer, which a vertex cache pays for.
//!
//! **Sources.** O. Ripolles, F. Ramos, M. Chover, "Sliding-Tris: a sliding window level-of-detail scheme". Wedges: C. Gonzalez, PhD
//! thesis, Universitat Jaume I 2010, 4.3.

mod blob;
mod levels;
mod order;
mod storage;
#[cfg(test)]
mod tests;

use kiln_asset::MeshError;

pub use storage::{Chains, Storage};

/// Why there is no window.
#[derive(Clone, Debug, thiserror::Error)]
pub enum WindowError {
    /// The sequence does not fit the mesh.
    #[error("the collapse sequence is of another mesh: {0}")]
    Sequence(String),
    /// It places points freely.
    #[error("collapse {collapse} moves the point that stays; a sliding window needs placement = \"half-edge\"")]
    Moves {
        /// The first such collapse.
        collapse: usize,
    },
    /// A face of the finest level has two corners at one point, so it would never be drawn.
    #[error("face {face} of the finest level has two corners at one point; merge drops such faces")]
    Degenerate {
        /// The first such face.
        face: u32,
    },
    /// A level that the window is not of.
    #[error("the window is of a level of {expected}, this one has {found}")]
    Counts {
        /// Vertices and faces of the window's level.
        expected: String,
        /// Vertices and faces of the one given.
        found: String,
    },
    /// A level whose faces die in another order.
    #[error("the window is of another level: its face {face} would vanish after one that stands behind it")]
    Order {
        /// The first such face.
        face: u32,
    },
    /// A level breaks a promise of a mesh.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

/// An order of a level's vertices and faces under which all coarser levels are prefixes, and each vertex' parent.
///
/// *Vertices* and *faces* are numbered in that order unless a sentence says otherwise.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SlidingWindow {
    order: Vec<u32>,
    faces: Vec<u32>,
    submesh_faces: Vec<u32>,
    parents: Vec<u32>,
    starts: Vec<u32>,
    base_vertices: u32,
    collapses: u32,
    done: u32,
}

impl SlidingWindow {
    /// `[vertex_count]`: the vertex of the level as it was, for each vertex.
    pub fn order(&self) -> &[u32] {
        &self.order
    }

    /// `[face_count]`: the face of the level as it was, for each face.
    pub fn faces(&self) -> &[u32] {
        &self.faces
    }

    /// `[submesh_count]`: faces of each submesh.
    pub fn submesh_faces(&self) -> &[u32] {
        &self.submesh_faces
    }

    /// `[vertex_count]`: the vertex that each turns into, of a strictly earlier point; itself below
    /// [`SlidingWindow::base_vertices`].
    pub fn parents(&self) -> &[u32] {
        &self.parents
    }

    /// Bit `v % 32` of word `v / 32`: vertex `v` is the first of its point. Empty where every vertex is a point of its own.
    pub fn starts(&self) -> &[u32] {
        &self.starts
    }

    /// Vertices that never go: those of the coarsest LOD.
    pub fn base_vertices(&self) -> u32 {
        self.base_vertices
    }

    /// D: LODs are 0 (the finest) to D.
    pub fn collapses(&self) -> u32 {
        self.collapses
    }

    /// Vertices of LOD 0.
    pub fn vertex_count(&self) -> usize {
        self.parents.len()
    }

    /// Faces of LOD 0.
    pub fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// The LOD that is the mesh after the first `count` collapses of the sequence; the nearest one that the window has.
    pub fn lod_of_cut(&self, count: usize) -> u32 {
        u32::try_from(count).unwrap_or(u32::MAX).saturating_sub(self.done).min(self.collapses)
    }

    /// v(d): vertices that are alive at LOD `lod`; those of the coarsest from there on.
    pub fn vertices_at(&self, lod: u32) -> u32 {
        let (count, lod) = (self.vertex_count() as u32, lod.min(self.collapses));
        if self.starts.is_empty() {
            return count - lod;
        }
        let mut left = lod;
        for (word, bits) in self.starts.iter().enumerate().rev() {
            let ones = bits.count_ones();
            if left > ones {
                left -= ones;
            } else if left > 0 {
                return 32 * word as u32 + highest(*bits, left);
            }
        }
        count
    }

    /// Whether vertex `v` is the first of its point.
    fn is_start(&self, v: u32) -> bool {
        self.starts.get(v as usize / 32).is_none_or(|word| word >> (v % 32) & 1 == 1)
    }

    /// `[vertex_count]`: first vertex of each vertex' point.
    fn point_starts(&self) -> Vec<u32> {
        let mut first = 0;
        let starts = (0..self.vertex_count() as u32).map(|v| {
            first = if self.is_start(v) { v } else { first };
            first
        });
        starts.collect()
    }
}

/// Place of the `n`-th highest one of `bits`, `n` from 1 to their number.
fn highest(mut bits: u32, n: u32) -> u32 {
    for _ in 1..n {
        bits &= !(1 << (31 - bits.leading_zeros()));
    }
    31 - bits.leading_zeros()
}
