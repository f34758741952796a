//! Layouts: more levels of detail over level 0's vertices and triangles. Records, and what is lent of each section.
//!
//! | section | layout | what it adds |
//! | --- | --- | --- |
//! | `WNDW` | sliding window | for each vertex the one it goes to; LOD `d` is a prefix of level 0's vertices and of each draw range |
//! | `TREE`, `LEAF` | tree and leaf buffers as printed | for each vertex a texel, for each node one a row of its columns |
//! | `CTRE` | compact tree | for each node one texel with its parent, for each vertex its terminal node |
//! | `CLUS` | cluster DAG | clusters of at most 128 triangles, groups that replace one another, errors |
//!
//! All are optional: a reader that does not know them draws the discrete levels. `formats/container-v1.md`, section 5, is the
//! specification.

use bytemuck::{Pod, Zeroable};

use crate::kind::{Kind, PAYLOAD_ALIGNMENT};
use crate::prelude::*;

/// Flag bit of a window that has `starts`.
pub const WINDOW_HAS_STARTS: u32 = 1;
/// Greatest width of a tree buffer, texels: what every graphics interface has.
pub const MAX_TREE_WIDTH: u32 = 8192;
/// Most texels of a tree buffer: pointers are exact integers in f32.
pub const MAX_TREE_TEXELS: u32 = 1 << 24;
/// Most rows of a tree buffer: the depth at which an octree stops to split.
pub const MAX_TREE_ROWS: u32 = 64;
/// Most triangles of a cluster.
pub const MAX_CLUSTER_TRIANGLES: u32 = 128;
/// Most vertices of a cluster.
pub const MAX_CLUSTER_VERTICES: u32 = 256;

/// One measured place on a layout's scale of detail; they stand finest first.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Checkpoint {
    /// Window: collapses done, ascending from 0. Trees: threshold rank, descending from the node count.
    pub detail: u32,
    /// Window: vertices alive. Trees: different picks of all vertices.
    pub vertices: u32,
    /// Triangles alive.
    pub triangles: u32,
    /// Distance to the source surface, object units, as a level's; not falling from one checkpoint to the next.
    pub error: f32,
    /// The level of the level table that it equals, or [`crate::record::NONE`].
    pub level: u32,
    /// Zero.
    pub reserved: [u32; 3],
}

/// Start of `WNDW`; behind it the checkpoints, then, each on a multiple of 256: `parents` `u32[vertices]`, and, if flagged,
/// `starts` `u32[ceil(vertices / 32)]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct WindowHeader {
    /// Level 0's vertices.
    pub vertices: u32,
    /// Level 0's triangles.
    pub triangles: u32,
    /// D, collapses: LOD `d` is `0..=D`.
    pub collapses: u32,
    /// Vertices that never go: those of LOD D.
    pub base_vertices: u32,
    /// Checkpoints, at least the first (0) and the last (D).
    pub checkpoints: u32,
    /// Bit 0: some point has several vertices, and `starts` is there.
    pub flags: u32,
    /// Zero.
    pub reserved: [u32; 10],
}

/// Start of `TREE` and `CTRE`; behind it the checkpoints, then `row_starts` `u32[rows + 1]`, then, each on a multiple of 256:
/// `face_counts` `u32[nodes + 1]`, and for `TREE` texels `f32x4[width * rows * ceil(columns / width)]`, for `CTRE` nodes
/// [`CompactNode`]`[nodes]` and `terminals` `u32[vertices]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct TreeHeader {
    /// N, internal nodes, ranked by r_level from 0 (the root).
    pub nodes: u32,
    /// Level 0's vertices.
    pub vertices: u32,
    /// R, rows: greatest i_level plus 1.
    pub rows: u32,
    /// `TREE`: columns, one a deepest node; `CTRE`: 0.
    pub columns: u32,
    /// `TREE`: texels of a row, at most [`MAX_TREE_WIDTH`]; column `c` is texel `c % width` of the rows of block `c / width`; `CTRE`: 0.
    pub width: u32,
    /// Checkpoints, at least the first (N) and the last (0).
    pub checkpoints: u32,
    /// Zero.
    pub reserved: [u32; 10],
}

/// One node of a compact tree; its place is its rank.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct CompactNode {
    /// Representative position, object units.
    pub position: [f32; 3],
    /// Rank of the parent, below its own; the root's is 0.
    pub parent: u32,
}

/// Start of `CLUS`; behind it, each on a multiple of 256: [`ClusterRecord`]`[clusters]`, [`GroupRecord`]`[groups]`, `references`
/// `u32[references]` (vertices of level 0), `corners` `u8[3 * triangles]` (places in the cluster's references).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct ClusterHeader {
    /// Clusters of all levels of the DAG, ordered by group.
    pub clusters: u32,
    /// Groups, finest first.
    pub groups: u32,
    /// Levels of the DAG.
    pub levels: u32,
    /// References of all clusters.
    pub references: u32,
    /// Triangles of all clusters.
    pub triangles: u32,
    /// Level 0's vertices.
    pub vertices: u32,
    /// Zero.
    pub reserved: [u32; 10],
}

/// One cluster.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct ClusterRecord {
    /// First of its references.
    pub first_reference: u32,
    /// Its vertices, 1 to [`MAX_CLUSTER_VERTICES`].
    pub vertex_count: u32,
    /// First of its triangles.
    pub first_triangle: u32,
    /// Its triangles, 1 to [`MAX_CLUSTER_TRIANGLES`].
    pub triangle_count: u32,
    /// Its submesh.
    pub submesh: u32,
    /// The group whose simplification replaces it; its group's error says from when on.
    pub group: u32,
    /// The group whose simplification made it, or [`crate::record::NONE`] for clusters of level 0's triangles.
    pub made_by: u32,
    /// Level of the DAG, 0 the finest.
    pub level: u32,
    /// Smallest known sphere over its vertices: centre and radius, object units.
    pub sphere: [f32; 4],
    /// Axis of its normals' cone, and the cosine of its half angle's complement (`meshopt`'s cutoff; 1: no cone).
    pub cone: [f32; 4],
}

/// One group of clusters that are simplified together.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GroupRecord {
    /// Holds the spheres of its clusters and of the groups that made them: centre and radius, object units.
    pub sphere: [f32; 4],
    /// Error of what replaces its clusters, object units; [`f32::MAX`] where nothing does (roots).
    pub error: f32,
    /// First of its clusters.
    pub first_cluster: u32,
    /// Its clusters, at least one.
    pub cluster_count: u32,
    /// Level of its clusters.
    pub level: u32,
}

/// A sliding window, lent or to be written.
#[derive(Clone, Copy, Debug)]
pub struct WindowView<'a> {
    /// Counts.
    pub header: WindowHeader,
    /// Finest first.
    pub checkpoints: &'a [Checkpoint],
    /// `[vertices]`: where each vertex goes, a vertex of an earlier point; itself below `base_vertices`.
    pub parents: &'a [u32],
    /// One bit a vertex, bit `v % 32` of word `v / 32`: it is the first of its point. Empty: every vertex is a point of its own.
    pub starts: &'a [u32],
}

/// Tree and leaf buffers as printed, lent or to be written.
#[derive(Clone, Copy, Debug)]
pub struct TreeLeafView<'a> {
    /// Counts.
    pub header: TreeHeader,
    /// Finest first.
    pub checkpoints: &'a [Checkpoint],
    /// `[rows + 1]`: rank of the first node of each i_level, then the node count.
    pub row_starts: &'a [u32],
    /// `[nodes + 1]`: triangles alive at each threshold rank; not falling.
    pub face_counts: &'a [u32],
    /// `[width * rows * blocks]`: x, y, z, q; the texel of column `c` and row `i` is number
    /// `((c / width) * rows + i) * width + c % width`.
    pub tree: &'a [[f32; 4]],
    /// `[vertices]`: x, y, z and the number of its terminal node's texel.
    pub leaf: &'a [[f32; 4]],
}

/// A compact tree, lent or to be written.
#[derive(Clone, Copy, Debug)]
pub struct CompactTreeView<'a> {
    /// Counts.
    pub header: TreeHeader,
    /// Finest first.
    pub checkpoints: &'a [Checkpoint],
    /// As in [`TreeLeafView`].
    pub row_starts: &'a [u32],
    /// As in [`TreeLeafView`].
    pub face_counts: &'a [u32],
    /// `[nodes]`, by rank.
    pub nodes: &'a [CompactNode],
    /// `[vertices]`: rank of each vertex' terminal node.
    pub terminals: &'a [u32],
}

/// A cluster DAG, lent or to be written.
#[derive(Clone, Copy, Debug)]
pub struct ClusterView<'a> {
    /// Counts.
    pub header: ClusterHeader,
    /// `[clusters]`, ordered by group.
    pub clusters: &'a [ClusterRecord],
    /// `[groups]`, ordered by level.
    pub groups: &'a [GroupRecord],
    /// Vertices of level 0, by cluster.
    pub references: &'a [u32],
    /// Three a triangle, by cluster.
    pub corners: &'a [u8],
}

/// The layouts of a container beside its discrete levels.
#[derive(Clone, Copy, Debug, Default)]
pub struct Layouts<'a> {
    /// `WNDW`.
    pub window: Option<WindowView<'a>>,
    /// `TREE` and `LEAF`.
    pub tree_leaf: Option<TreeLeafView<'a>>,
    /// `CTRE`.
    pub compact_tree: Option<CompactTreeView<'a>>,
    /// `CLUS`.
    pub clusters: Option<ClusterView<'a>>,
}

const _: () = {
    assert!(size_of::<Checkpoint>() == 32);
    assert!(size_of::<WindowHeader>() == 64);
    assert!(size_of::<TreeHeader>() == 64);
    assert!(size_of::<CompactNode>() == 16);
    assert!(size_of::<ClusterHeader>() == 64);
    assert!(size_of::<ClusterRecord>() == 64);
    assert!(size_of::<GroupRecord>() == 32);
};

/// Cuts arrays off the front of a layout section.
struct Cutter<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Paddings so far are zero.
    zero: bool,
}

impl<'a> Cutter<'a> {
    fn new(bytes: &'a [u8]) -> Cutter<'a> {
        Cutter { bytes, at: 0, zero: true }
    }

    /// `count` records behind the ones before.
    fn take<T: Pod>(&mut self, count: u64) -> Option<&'a [T]> {
        let length = usize::try_from(count).ok()?.checked_mul(size_of::<T>())?;
        let own = self.bytes.get(self.at..self.at.checked_add(length)?)?;
        self.at += length;
        bytemuck::try_cast_slice(own).ok()
    }

    /// `count` records on the next multiple of 256.
    fn take_aligned<T: Pod>(&mut self, count: u64) -> Option<&'a [T]> {
        let start = self.at.checked_next_multiple_of(PAYLOAD_ALIGNMENT as usize)?;
        self.zero &= self.bytes.get(self.at..start)?.iter().all(|byte| *byte == 0);
        self.at = start;
        self.take(count)
    }

    fn header<T: Pod>(&mut self) -> Option<T> {
        self.take::<T>(1)?.first().copied()
    }

    /// Whether all paddings were zero; nothing if bytes are left.
    fn finish(self) -> Option<bool> {
        (self.at == self.bytes.len()).then_some(self.zero)
    }
}

/// What a section holds, and whether its paddings are zero; nothing if it is not as long as its counts say.
pub(crate) fn cut_window(bytes: &[u8]) -> Option<(WindowView<'_>, bool)> {
    let mut cutter = Cutter::new(bytes);
    let header: WindowHeader = cutter.header()?;
    let checkpoints = cutter.take(header.checkpoints as u64)?;
    let parents = cutter.take_aligned(header.vertices as u64)?;
    let flagged = header.flags & WINDOW_HAS_STARTS != 0;
    let starts = if flagged { cutter.take_aligned(header.vertices.div_ceil(32) as u64)? } else { &[] };
    Some((WindowView { header, checkpoints, parents, starts }, cutter.finish()?))
}

/// As [`cut_window`], of TREE and LEAF.
pub(crate) fn cut_tree<'a>(tree: &'a [u8], leaf: &'a [u8]) -> Option<(TreeLeafView<'a>, bool)> {
    let mut cutter = Cutter::new(tree);
    let header: TreeHeader = cutter.header()?;
    let (checkpoints, row_starts, face_counts) = cut_tree_start(&header, &mut cutter)?;
    let blocks = header.columns.checked_div(header.width).unwrap_or(0) as u64
        + (header.width != 0 && !header.columns.is_multiple_of(header.width)) as u64;
    let texels = (header.width as u64 * header.rows as u64).checked_mul(blocks)?;
    let tree = cutter.take_aligned(texels)?;
    let mut leaves = Cutter::new(leaf);
    let leaf = leaves.take(header.vertices as u64)?;
    leaves.finish()?;
    Some((TreeLeafView { header, checkpoints, row_starts, face_counts, tree, leaf }, cutter.finish()?))
}

/// As [`cut_window`], of CTRE.
pub(crate) fn cut_compact_tree(bytes: &[u8]) -> Option<(CompactTreeView<'_>, bool)> {
    let mut cutter = Cutter::new(bytes);
    let header: TreeHeader = cutter.header()?;
    let (checkpoints, row_starts, face_counts) = cut_tree_start(&header, &mut cutter)?;
    let nodes = cutter.take_aligned(header.nodes as u64)?;
    let terminals = cutter.take_aligned(header.vertices as u64)?;
    Some((CompactTreeView { header, checkpoints, row_starts, face_counts, nodes, terminals }, cutter.finish()?))
}

/// Checkpoints, row starts and face counts.
type TreeStart<'a> = (&'a [Checkpoint], &'a [u32], &'a [u32]);

fn cut_tree_start<'a>(header: &TreeHeader, cutter: &mut Cutter<'a>) -> Option<TreeStart<'a>> {
    let checkpoints = cutter.take(header.checkpoints as u64)?;
    let row_starts = cutter.take(header.rows as u64 + 1)?;
    Some((checkpoints, row_starts, cutter.take_aligned(header.nodes as u64 + 1)?))
}

/// As [`cut_window`], of CLUS.
pub(crate) fn cut_clusters(bytes: &[u8]) -> Option<(ClusterView<'_>, bool)> {
    let mut cutter = Cutter::new(bytes);
    let header: ClusterHeader = cutter.header()?;
    let clusters = cutter.take_aligned(header.clusters as u64)?;
    let groups = cutter.take_aligned(header.groups as u64)?;
    let references = cutter.take_aligned(header.references as u64)?;
    let corners = cutter.take_aligned(header.triangles as u64 * 3)?;
    Some((ClusterView { header, clusters, groups, references, corners }, cutter.finish()?))
}

/// Appends arrays as [`Cutter`] cuts them.
fn join(start: &[&[u8]], aligned: &[&[u8]]) -> Vec<u8> {
    let mut out = start.concat();
    for bytes in aligned {
        out.resize(out.len().next_multiple_of(PAYLOAD_ALIGNMENT as usize), 0);
        out.extend_from_slice(bytes);
    }
    out
}

impl Layouts<'_> {
    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.window.is_none() && self.tree_leaf.is_none() && self.compact_tree.is_none() && self.clusters.is_none()
    }

    /// The sections in canonical order.
    pub(crate) fn sections(&self) -> Vec<(Kind, Vec<u8>)> {
        use bytemuck::{bytes_of, cast_slice};
        let mut out = Vec::new();
        if let Some(w) = &self.window {
            let start: [&[u8]; 2] = [bytes_of(&w.header), cast_slice(w.checkpoints)];
            let arrays: [&[u8]; 2] = [cast_slice(w.parents), cast_slice(w.starts)];
            let count = if w.header.flags & WINDOW_HAS_STARTS != 0 { 2 } else { 1 };
            out.push((Kind::WINDOW, join(&start, &arrays[..count])));
        }
        if let Some(t) = &self.tree_leaf {
            let start: [&[u8]; 3] = [bytes_of(&t.header), cast_slice(t.checkpoints), cast_slice(t.row_starts)];
            out.push((Kind::TREE, join(&start, &[cast_slice(t.face_counts), cast_slice(t.tree)])));
            out.push((Kind::LEAF, cast_slice(t.leaf).to_vec()));
        }
        if let Some(t) = &self.compact_tree {
            let start: [&[u8]; 3] = [bytes_of(&t.header), cast_slice(t.checkpoints), cast_slice(t.row_starts)];
            let arrays: [&[u8]; 3] = [cast_slice(t.face_counts), cast_slice(t.nodes), cast_slice(t.terminals)];
            out.push((Kind::COMPACT_TREE, join(&start, &arrays)));
        }
        if let Some(c) = &self.clusters {
            let arrays: [&[u8]; 4] =
                [cast_slice(c.clusters), cast_slice(c.groups), cast_slice(c.references), cast_slice(c.corners)];
            out.push((Kind::CLUSTERS, join(&[bytes_of(&c.header)], &arrays)));
        }
        out
    }
}
