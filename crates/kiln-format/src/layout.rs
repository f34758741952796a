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
