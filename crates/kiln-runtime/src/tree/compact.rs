//! Picking in a compact tree; CPU twin of `shaders/tree_compact_pick.wgsl`.

use alloc::vec::Vec;
use core::ops::Range;

use kiln_format::layout::{CompactNode, CompactTreeView};

use super::{Place, Scale};

/// No node: a vertex that picks itself.
pub(super) const ITSELF: u32 = u32::MAX;

/// A compact tree over level 0's positions, ready to pick from.
#[derive(Clone, Copy, Debug)]
pub struct Compact<'a> {
    pub(super) view: CompactTreeView<'a>,
    /// `[vertices]`, object units.
    pub(super) positions: &'a [[f32; 3]],
}

impl<'a> Compact<'a> {
    /// Wraps a view and level 0's positions, `[vertices]`, object units.
    pub fn new(view: CompactTreeView<'a>, positions: &'a [[f32; 3]]) -> Compact<'a> {
        Compact { view, positions }
    }

    /// Checkpoints and counts.
    pub fn scale(&self) -> Scale<'a> {
        let view = &self.view;
        Scale { checkpoints: view.checkpoints, row_starts: view.row_starts, face_counts: view.face_counts }
    }

    /// Vertices.
    pub fn vertex_count(&self) -> usize {
        self.view.terminals.len().min(self.positions.len())
    }

    /// Writes the picks of the vertices `range` at `threshold`, each by a walk from its terminal node: `out[i]` for vertex
    /// `range.start + i`, as far as both reach.
    pub fn pick<P: Place>(&self, threshold: u32, range: Range<usize>, out: &mut [P]) {
        let range = range.start..range.end.min(self.vertex_count());
        let terminals = self.view.terminals.get(range.clone()).unwrap_or(&[]);
        let positions = self.positions.get(range).unwrap_or(&[]);
        for ((terminal, position), out) in terminals.iter().zip(positions).zip(out) {
            *out = P::at(self.walk(*terminal, threshold).map_or(*position, |node| node.position));
        }
    }

    /// The shallowest node of rank `threshold` or more over a terminal node.
    #[inline(always)]
    fn walk(&self, terminal: u32, threshold: u32) -> Option<&'a CompactNode> {
        let nodes = self.view.nodes;
        if terminal < threshold {
            return None;
        }
        let mut rank = terminal;
        let mut node = nodes.get(rank as usize)?;
        // Ranks fall at every step, and the first parent that does not end the walk is the root's own.
        while node.parent >= threshold && node.parent < rank {
            rank = node.parent;
            node = &nodes[rank as usize];
        }
        Some(node)
    }

    /// `deaths[i]` for triangle i of `triangles`: rank of the node at which two corners of it first share their pick; a triangle with
    /// an index out of range never lives. Deaths do not change with the threshold: compute them once.
    pub fn deaths(&self, triangles: &[[u32; 3]], deaths: &mut [u32]) {
        let terminal = |vertex: u32| self.view.terminals.get(vertex as usize).copied();
        for (triangle, death) in triangles.iter().zip(deaths) {
            *death = match triangle.map(terminal) {
                [Some(a), Some(b), Some(c)] => self.meet(a, b).max(self.meet(b, c)).max(self.meet(c, a)),
                _ => u32::MAX,
            };
        }
    }

    /// The deepest node over both.
    #[inline]
    fn meet(&self, mut a: u32, mut b: u32) -> u32 {
        while a != b {
            let higher = a.max(b);
            match self.view.nodes.get(higher as usize) {
                Some(node) if node.parent < higher => (a, b) = (a.min(b), node.parent),
                _ => return u32::MAX,
            }
        }
        a
    }
}

/// What each node's vertices pick at one threshold: the outcome of one pass over the nodes.
#[derive(Clone, Debug, Default)]
pub struct Resolved {
    /// `[nodes]`: rank of the pick, or [`ITSELF`].
    picks: Vec<u32>,
}

impl Resolved {
    /// An empty one, to be kept for [`Resolved::resolve`] from frame to frame.
    pub fn new() -> Resolved {
        Resolved::default()
    }

    /// Resolves all nodes at `threshold`. Parents come before their children, so one pass does. Allocates the first time only.
    pub fn resolve(&mut self, tree: &Compact<'_>, threshold: u32) {
        let nodes = tree.view.nodes;
        self.picks.resize(nodes.len(), ITSELF);
        let split = (threshold as usize).min(nodes.len());
        self.picks[..split].fill(ITSELF);
        for (rank, node) in nodes.iter().enumerate().skip(split) {
            let parent = node.parent;
            let inherits = parent >= threshold && (parent as usize) < rank;
            self.picks[rank] = if inherits { self.picks[parent as usize] } else { rank as u32 };
        }
    }

    /// Writes the picks of the vertices `range` at the threshold that was resolved: `out[i]` for vertex `range.start + i`, as far as
    /// both reach.
    pub fn pick<P: Place>(&self, tree: &Compact<'_>, range: Range<usize>, out: &mut [P]) {
        let range = range.start..range.end.min(tree.vertex_count());
        let terminals = tree.view.terminals.get(range.clone()).unwrap_or(&[]);
        let positions = tree.positions.get(range).unwrap_or(&[]);
        for ((terminal, position), out) in terminals.iter().zip(positions).zip(out) {
            let pick = self.picks.get(*terminal as usize).copied().unwrap_or(ITSELF);
            *out = P::at(tree.view.nodes.get(pick as usize).map_or(*position, |node| node.position));
        }
    }
}
