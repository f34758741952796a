//! Picking by runs: where vertices stand in the tree's order, what picks one node is one run of them.
//!
//! ```text
//! prepare: vertex by vertex, keep the path from the root to its terminal node open;
//!          a node that is entered starts an entry (rank, first vertex, position); one that is left knows where its entry ends
//! pick:    entry of rank >= t: fill its vertices with its position, go to the entry behind its subtree
//!          else:               copy the vertices up to the next entry, go there
//! ```
//! Reads and writes are sequential, and a coarse level reads few entries. In another order of vertices nodes are entered again and
//! again: beyond four entries a vertex there are no runs, and [`super::Resolved`] is the better pick.

use alloc::vec::Vec;
use core::ops::Range;

use super::{Compact, Place};

/// One visit of a node.
#[derive(Clone, Copy, Debug, Default)]
struct Entry {
    /// Rank of the node.
    rank: u32,
    /// First of its vertices.
    first: u32,
    /// The entry behind its subtree.
    skip: u32,
    position: [f32; 3],
}

/// A compact tree over vertices in the tree's order, prepared for picking.
#[derive(Clone, Debug)]
pub struct Runs {
    /// In the order of vertices; the last one stands behind the last vertex.
    entries: Vec<Entry>,
}

impl Runs {
    /// The runs of `tree`; `None` where its vertices are in an order that has too many, or where it is no tree.
    pub fn new(tree: &Compact<'_>) -> Option<Runs> {
        let (nodes, vertices) = (tree.view.nodes, tree.vertex_count());
        let limit = 4 * vertices + nodes.len().min(4 * vertices) + 1;
        let mut entries: Vec<Entry> = Vec::new();
        // The path from the root: node and its entry.
        let mut open: Vec<(u32, u32)> = Vec::new();
        let mut path: Vec<u32> = Vec::new();
        for (vertex, terminal) in (0..).zip(&tree.view.terminals[..vertices]) {
            if open.last().is_some_and(|(node, _)| node == terminal) {
                continue;
            }
            // Up from the terminal node to what is open; what is not over it is left.
            path.clear();
            let mut node = *terminal;
            loop {
                while open.last().is_some_and(|(top, _)| *top > node) {
                    let (_, entry) = open.pop()?;
                    entries[entry as usize].skip = entries.len() as u32;
                }
                if open.last().is_some_and(|(top, _)| *top == node) {
                    break;
                }
                path.push(node);
                let parent = nodes.get(node as usize)?.parent;
                if node == 0 {
                    break;
                }
                if parent >= node {
                    return None;
                }
                node = parent;
            }
            if path.is_empty() {
                // Back in an open node: its vertices go on behind those of a child.
                path.push(*terminal);
            }
            if entries.len() + path.len() > limit {
                return None;
            }
            for node in path.iter().rev() {
                open.push((*node, entries.len() as u32));
                let position = nodes.get(*node as usize)?.position;
                entries.push(Entry { rank: *node, first: vertex, skip: 0, position });
            }
        }
        let end = entries.len() as u32;
        open.iter().for_each(|(_, entry)| entries[*entry as usize].skip = end);
        entries.push(Entry { rank: u32::MAX, first: vertices as u32, skip: end, position: [0.0; 3] });
        Some(Runs { entries })
    }

    /// Bytes in memory.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.entries[..])
    }

    /// Writes the picks of the vertices `range` at `threshold`: `out[i]` for vertex `range.start + i`, as far as both reach.
    /// `positions`: level 0's, those that the runs were made with.
    pub fn pick<P: Place>(&self, positions: &[[f32; 3]], threshold: u32, range: Range<usize>, out: &mut [P]) {
        let Some(last) = self.entries.len().checked_sub(1) else { return };
        let end = range.end.min(positions.len()).min(range.start.saturating_add(out.len()));
        let (start, end) = (range.start, end.min(self.entries[last].first as usize));
        let mut at = self.first_of(threshold, start, last);
        let mut entry = self.entries[at];
        let mut from = start;
        while at < last && from < end {
            let whole = entry.rank >= threshold;
            let next = if whole { entry.skip as usize } else { at + 1 };
            let behind = self.entries[next];
            let to = (behind.first as usize).clamp(from, end);
            let out = &mut out[from - start..to - start];
            if whole {
                let place = P::at(entry.position);
                out.iter_mut().for_each(|out| *out = place);
            } else {
                out.iter_mut().zip(&positions[from..to]).for_each(|(out, position)| *out = P::at(*position));
            }
            (at, entry, from) = (next, behind, to);
        }
    }

    /// The entry that decides about the vertex `start`.
    fn first_of(&self, threshold: u32, start: usize, last: usize) -> usize {
        let mut at = 0;
        while at < last {
            let entry = &self.entries[at];
            let behind = entry.skip as usize;
            if self.entries[behind].first as usize <= start {
                at = behind;
            } else if entry.rank >= threshold || self.entries[at + 1].first as usize > start {
                return at;
            } else {
                at += 1;
            }
        }
        last
    }
}
