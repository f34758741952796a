//! Continuous layouts: what `kiln-lod` made of the finest level, as the records of the container.
//!
//! A layout is made of the level's own vertices and triangles; the packed level may have them in another order (`order.rs`), so
//! everything that names a vertex is renumbered here. Positions, ranks, parents and counts stay.

use std::borrow::Cow;

use kiln_asset::Mesh;
use kiln_format::layout::{
    Checkpoint, ClusterHeader, ClusterRecord, ClusterView, CompactNode, CompactTreeView, GroupRecord, Layouts,
    TreeHeader, TreeLeafView, WindowHeader, WindowView,
};
use kiln_format::record::NONE;
use kiln_lod::cluster_dag::ClusterDag;
use kiln_lod::cluster_tree::{ClusterTree, TreeLeafBuffers};
use kiln_lod::sliding_window::SlidingWindow;

use crate::PackError;
use crate::order::{self, Coarser, Packed};
use crate::pack::{Layout, PackOptions};

/// The continuous layouts of the finest level of a set, in its own order of vertices and triangles.
#[derive(Clone, Debug, Default)]
pub struct Continuous {
    /// For [`Layout::SlidingWindow`].
    pub window: Option<WindowLayout>,
    /// For [`Layout::TreeLeaf`] and [`Layout::CompactTree`].
    pub tree: Option<TreeLayout>,
    /// For [`Layout::Clusters`].
    pub clusters: Option<ClusterDag>,
}

/// A sliding window over the finest level.
#[derive(Clone, Debug)]
pub struct WindowLayout {
    /// The window.
    pub window: SlidingWindow,
    /// Finest first.
    pub checkpoints: Vec<kiln_lod::Checkpoint>,
    /// `[level_count]`: how many collapses lead from the finest level to each.
    pub cuts: Vec<u32>,
}

/// An octree over the finest level.
#[derive(Clone, Debug)]
pub struct TreeLayout {
    /// The tree.
    pub tree: ClusterTree,
    /// Finest first.
    pub checkpoints: Vec<kiln_lod::Checkpoint>,
}

/// The levels in the window's order; coarser ones use the first of the finest one's vertices.
pub(crate) fn by_window<'a>(meshes: &[&'a Mesh], layout: &WindowLayout) -> Result<Packed<'a>, PackError> {
    let window = &layout.window;
    let wrong = |level: usize, message: String| PackError::Levels { level, message };
    let finest = window.apply(meshes[0]).map_err(|e| wrong(0, e.to_string()))?;
    let mut coarser = Vec::new();
    for (level, detail) in layout.cuts.iter().enumerate().take(meshes.len()).skip(1) {
        let drawn = window.level(&finest, *detail).map_err(|e| wrong(level, e.to_string()))?;
        if drawn.face_count() != meshes[level].face_count() {
            let (found, here) = (meshes[level].face_count(), drawn.face_count());
            return Err(wrong(level, format!("it has {found} triangles, the sliding window {here} there")));
        }
        let counts = order::submesh_counts(&drawn);
        let vertices = drawn.vertex_count();
        coarser.push(Coarser::Shared { vertices, triangles: drawn.into_raw().triangles, counts });
    }
    Ok(Packed { finest: Cow::Owned(finest), order: window.order().to_vec(), coarser })
}

/// The arrays of all layouts that were asked for.
#[derive(Default)]
pub(crate) struct Arrays<'a> {
    window: Option<(WindowHeader, Vec<Checkpoint>, &'a SlidingWindow)>,
    tree: Option<Tree<'a>>,
    tree_leaf: Option<TreeLeafArrays>,
    compact: Option<(TreeHeader, Vec<u32>)>,
    clusters: Option<(ClusterHeader, Vec<u32>, &'a ClusterDag)>,
}

/// Header, tree buffer, leaf buffer.
type TreeLeafArrays = (TreeHeader, Vec<[f32; 4]>, Vec<[f32; 4]>);

struct Tree<'a> {
    tree: &'a ClusterTree,
    checkpoints: Vec<Checkpoint>,
}

impl<'a> Arrays<'a> {
    /// Those that `options` asks for, over the vertices of `packed`; `finest` is the same level as it came.
    pub(crate) fn new(
        continuous: &'a Continuous,
        finest: &Mesh,
        packed: &Packed<'_>,
        options: &PackOptions,
    ) -> Result<Arrays<'a>, PackError> {
        let wanted = |layout| options.layouts.contains(&layout);
        let missing = |what: &str| PackError::Unsupported(format!("{what} that was not made"));
        let (vertices, triangles) = (packed.finest.vertex_count() as u32, packed.finest.face_count() as u32);
        let mut arrays = Arrays::default();
        if wanted(Layout::SlidingWindow) {
            let layout = continuous.window.as_ref().ok_or_else(|| missing("a sliding window"))?;
            let window = &layout.window;
            let levels = if wanted(Layout::Discrete) { &layout.cuts[..] } else { &[] };
            let checkpoints = checkpoints(&layout.checkpoints, levels);
            let header = WindowHeader {
                vertices,
                triangles,
                collapses: window.collapses(),
                base_vertices: window.base_vertices(),
                checkpoints: checkpoints.len() as u32,
                flags: !window.starts().is_empty() as u32,
                reserved: [0; 10],
            };
            arrays.window = Some((header, checkpoints, window));
        }
        if wanted(Layout::TreeLeaf) || wanted(Layout::CompactTree) {
            let layout = continuous.tree.as_ref().ok_or_else(|| missing("an octree"))?;
            let tree = &layout.tree;
            if tree.terminals().len() != vertices as usize {
                let message = "it has not the vertices that the octree was made of".into();
                return Err(PackError::Levels { level: 0, message });
            }
            let checkpoints = checkpoints(&layout.checkpoints, &[]);
            let header = TreeHeader {
                nodes: tree.nodes().len() as u32,
                vertices,
                rows: tree.row_starts().len() as u32 - 1,
                columns: 0,
                width: 0,
                checkpoints: checkpoints.len() as u32,
                reserved: [0; 10],
            };
            if wanted(Layout::TreeLeaf) {
                let buffers = TreeLeafBuffers::new(tree, finest).map_err(|e| PackError::Unsupported(e.to_string()))?;
                let header = TreeHeader { columns: buffers.columns, width: buffers.width, ..header };
                arrays.tree_leaf = Some((header, buffers.tree, renumbered(&buffers.leaf, &packed.order)));
            }
            if wanted(Layout::CompactTree) {
                arrays.compact = Some((header, renumbered(tree.terminals(), &packed.order)));
            }
            arrays.tree = Some(Tree { tree, checkpoints });
        }
        if wanted(Layout::Clusters) {
            let dag = continuous.clusters.as_ref().ok_or_else(|| missing("a cluster DAG"))?;
            let places = order::places(&packed.order);
            let place = |v: &u32| if places.is_empty() { *v } else { places[*v as usize] };
            if dag.vertices != vertices {
                let message = "it has not the vertices that the cluster DAG was made of".into();
                return Err(PackError::Levels { level: 0, message });
            }
            let header = ClusterHeader {
                clusters: dag.clusters.len() as u32,
                groups: dag.groups.len() as u32,
                levels: dag.levels,
                references: dag.references.len() as u32,
                triangles: dag.corners.len() as u32 / 3,
                vertices,
                reserved: [0; 10],
            };
            arrays.clusters = Some((header, dag.references.iter().map(place).collect(), dag));
        }
        Ok(arrays)
    }

    /// What is written.
    pub(crate) fn layouts(&self) -> Layouts<'_> {
        let window = self.window.as_ref().map(|(header, checkpoints, window)| WindowView {
            header: *header,
            checkpoints,
            parents: window.parents(),
            starts: window.starts(),
        });
        let tree = self.tree.as_ref();
        let tree_leaf = self.tree_leaf.as_ref().zip(tree).map(|((header, texels, leaf), tree)| TreeLeafView {
            header: *header,
            checkpoints: &tree.checkpoints,
            row_starts: tree.tree.row_starts(),
            face_counts: tree.tree.face_counts(),
            tree: texels,
            leaf,
        });
        let compact_tree = self.compact.as_ref().zip(tree).map(|((header, terminals), tree)| CompactTreeView {
            header: *header,
            checkpoints: &tree.checkpoints,
            row_starts: tree.tree.row_starts(),
            face_counts: tree.tree.face_counts(),
            nodes: bytemuck::cast_slice::<_, CompactNode>(tree.tree.nodes()),
            terminals,
        });
        let clusters = self.clusters.as_ref().map(|(header, references, dag)| ClusterView {
            header: *header,
            clusters: bytemuck::cast_slice::<_, ClusterRecord>(&dag.clusters),
            groups: bytemuck::cast_slice::<_, GroupRecord>(&dag.groups),
            references,
            corners: &dag.corners,
        });
        Layouts { window, tree_leaf, compact_tree, clusters }
    }
}

/// `values` of vertices, in a new order (new vertex to old; empty: the same).
fn renumbered<T: Copy>(values: &[T], order: &[u32]) -> Vec<T> {
    if order.is_empty() { values.to_vec() } else { order.iter().map(|v| values[*v as usize]).collect() }
}

/// Checkpoints as records; those at the details of `levels` name their level.
fn checkpoints(found: &[kiln_lod::Checkpoint], levels: &[u32]) -> Vec<Checkpoint> {
    let record = |c: &kiln_lod::Checkpoint| Checkpoint {
        detail: c.detail,
        vertices: c.vertices,
        triangles: c.triangles,
        error: c.error,
        level: levels.iter().position(|detail| *detail == c.detail).map_or(NONE, |level| level as u32),
        reserved: [0; 3],
    };
    found.iter().map(record).collect()
}
