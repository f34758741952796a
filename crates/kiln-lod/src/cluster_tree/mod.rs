//! Cluster tree: vertex clustering in an octree of tight cells, as a scale of detail from no triangle to all of them.
//!
//! Vertices come in; out goes a tree whose internal nodes are **ranked**, coarse first. A **threshold** t splits the nodes of rank
//! below t; every vertex then **picks** one position. Points, attributes and the order of vertices and triangles stay as they are.
//! ```text
//! cell <- tight cuboid of all points                                         the root, always an internal node
//! a cell of several places: split in eight at its middle; shrink each child to the tight cuboid of its points
//! i_level <- the greatest q with L_root >= 2^q L, but more than the parent's;  L = longest edge
//! position of an internal node <- mean of its points, or where their faces' planes are nearest
//! rank internal nodes by i_level, then by L, longest first, then by lowest point:  r_level = i_level + k / n, k = 1..n of its row
//! pick(vertex, t) <- its shallowest ancestor of rank >= t, else the vertex itself
//! face_counts[t] <- faces of which no two corners pick one node:  a face dies at the lowest node over two of its corners
//! ```
//! **Departures from the paper.** A leaf stands for a place, not a vertex: wedges of a point and points at one place share a terminal
//! node. The level is compared exactly instead of taking a logarithm. Faces are counted for every threshold, so that a wanted count
//! gets the best one there is; the paper's linear estimate ([`ClusterTree::paper_estimate`]) is there to be compared with. A dead
//! face is one whose corners pick the same node, not one without a normal. `k / n` is stored in the texel, not a fractional part,
//! which is 0 for `k = n`; the details of the buffers stand in [`buffers`].
//!
//! **Limits.** Clustering knows nothing of topology: sheets closer together than a cell are glued, thin parts become flat or lose all
//! faces, and at equal counts it is farther from the source than a collapse sequence. Cells below row 63 share their parent's node.
//!
//! Sources: T. Kanaya, T. Taniguchi, Y. Teshima, K. Nishio, K. Kobori, "A Method for Storing Clustering Information of Model
//! Simplification in GPUs", WSCG 2011; D. Luebke, C. Erikson, "View-dependent simplification of arbitrary polygonal environments",
//! SIGGRAPH 1997 (tight octree); P. Lindstrom, "Out-of-core simplification of large polygonal models", SIGGRAPH 2000 (planes).

mod blob;
pub mod buffers;
mod choice;
mod level;
mod octree;
mod place;
#[cfg(test)]
mod tests;

pub use buffers::{TreeBufferError, TreeLeafBuffers};
pub use choice::{RLevel, ThresholdChoice};

use bytemuck::{Pod, Zeroable};
use kiln_asset::Mesh;
use rayon::prelude::*;

/// Most rows: the depth at which the octree stops to split. The container's too.
pub const MAX_ROWS: u32 = 64;

/// Where an internal node's position comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Representative {
    /// The mean of its points.
    Mean,
    /// Where the planes of the faces at its points are nearest, inside its cell; the mean where they do not tell.
    #[default]
    Quadric,
}

/// How the tree is built.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TreeOptions {
    /// Positions of internal nodes.
    pub representative: Representative,
}

/// An internal node; in memory as a container's `CompactNode`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct TreeNode {
    /// Representative position inside the node's cell, object units.
    pub position: [f32; 3],
    /// Rank of the parent, below its own; the root's is 0.
    pub parent: u32,
}

/// The octree over a mesh's points; internal nodes by rank.
#[derive(Clone, Debug, PartialEq)]
pub struct ClusterTree {
    nodes: Vec<TreeNode>,
    row_starts: Vec<u32>,
    terminals: Vec<u32>,
    face_counts: Vec<u32>,
}

impl ClusterTree {
    /// The tree over the points of `mesh`; a point lies where its first vertex does. Of an empty mesh: no nodes.
    pub fn new(mesh: &Mesh, options: &TreeOptions) -> ClusterTree {
        let sites = octree::sites(mesh);
        let (cells, sites) = octree::grow(sites);
        let of_point = octree::terminals(&cells, &sites);
        let ranked = octree::ranked(&cells);
        let mut rank_of = vec![0u32; cells.len()];
        ranked.iter().zip(0..).for_each(|(cell, rank)| rank_of[*cell as usize] = rank);
        let terminals: Vec<u32> = mesh.points.iter().map(|p| rank_of[of_point[p.index()] as usize]).collect();
        let nodes: Vec<TreeNode> = ranked
            .iter()
            .map(|cell| {
                let cell = &cells[*cell as usize];
                let parent = cell.parent.map_or(0, |parent| rank_of[parent as usize]);
                TreeNode { position: cell.mean, parent }
            })
            .collect();
        let rows = ranked.last().map_or(0, |cell| cells[*cell as usize].row + 1);
        let row_starts =
            (0..=rows).map(|row| ranked.partition_point(|c| cells[*c as usize].row < row) as u32).collect();
        let mut tree = ClusterTree { nodes, row_starts, terminals, face_counts: Vec::new() };
        if options.representative == Representative::Quadric {
            let boxes: Vec<place::Cuboid> = ranked.iter().map(|cell| cells[*cell as usize].cuboid()).collect();
            place::improve(&mut tree, mesh, &boxes);
        }
        tree.face_counts = tree.counts(&tree.face_deaths(mesh));
        tree
    }

    /// `[node_count]`, by rank.
    pub fn nodes(&self) -> &[TreeNode] {
        &self.nodes
    }

    /// N, internal nodes; thresholds are `0..=N`.
    pub fn node_count(&self) -> u32 {
        self.nodes.len() as u32
    }

    /// Rows: the greatest i_level plus 1, at most [`MAX_ROWS`]; 0 without nodes.
    pub fn rows(&self) -> u32 {
        self.row_starts.len() as u32 - 1
    }

    /// `[rows + 1]`: rank of the first node of each i_level, not falling (levels may be empty); then N.
    pub fn row_starts(&self) -> &[u32] {
        &self.row_starts
    }

    /// `[vertex_count]`: rank of the deepest internal node over each vertex.
    pub fn terminals(&self) -> &[u32] {
        &self.terminals
    }

    /// `[node_count + 1]`: faces alive at each threshold, not falling; 0 at 0, all at N. A face with two corners at one point counts
    /// as alive where that point is not clustered, so that threshold N is the mesh itself.
    pub fn face_counts(&self) -> &[u32] {
        &self.face_counts
    }

    /// i_level of a node.
    ///
    /// # Panics
    /// If `rank` is no node's.
    pub fn row_of(&self, rank: u32) -> u32 {
        assert!(rank < self.node_count(), "rank {rank} of {} nodes", self.node_count());
        self.row_starts.partition_point(|start| *start <= rank) as u32 - 1
    }

    /// What vertex `vertex` picks at `threshold`: a node's rank, or `None`, itself.
    ///
    /// # Panics
    /// If there is no such vertex.
    pub fn pick(&self, vertex: u32, threshold: u32) -> Option<u32> {
        let mut node = self.terminals[vertex as usize];
        if node < threshold {
            return None;
        }
        while node > 0 && self.nodes[node as usize].parent >= threshold {
            node = self.nodes[node as usize].parent;
        }
        Some(node)
    }

    /// `[face_count]`: the node at which two corners of each face first share their pick; a face is alive at the thresholds above
    /// its rank.
    ///
    /// # Panics
    /// If the tree is of another mesh.
    pub fn face_deaths(&self, mesh: &Mesh) -> Vec<u32> {
        assert_eq!(mesh.vertex_count(), self.terminals.len(), "the tree is of another mesh");
        let meet = |mut a: u32, mut b: u32| {
            // Parents have lower ranks: the higher of two nodes is not over the other.
            while a != b {
                if a > b { a = self.nodes[a as usize].parent } else { b = self.nodes[b as usize].parent }
            }
            a
        };
        let death = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|v| self.terminals[v as usize]);
            meet(a, b).max(meet(b, c)).max(meet(c, a))
        };
        mesh.triangles.par_iter().map(death).collect()
    }

    /// Running counts of [`ClusterTree::face_deaths`].
    fn counts(&self, deaths: &[u32]) -> Vec<u32> {
        let mut counts = vec![0u32; self.nodes.len() + 1];
        deaths.iter().for_each(|death| counts[*death as usize + 1] += 1);
        for t in 1..counts.len() {
            counts[t] += counts[t - 1];
        }
        counts
    }
}
