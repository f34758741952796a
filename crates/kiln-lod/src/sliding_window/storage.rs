//! What a window costs, counted as the paper counts (table 1).

use super::SlidingWindow;

/// Lengths of the chains of vertices that a window's go through ([`SlidingWindow::chain`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Chains {
    /// Elements of all chains.
    pub elements: u64,
    /// Elements of the longest.
    pub longest: u32,
    /// Elements of one, on average over all vertices.
    pub mean: f64,
}

/// Bytes of a model, uncompressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Storage {
    /// Vertices and three 4-byte indices a triangle: what the others are compared with.
    pub indexed: u64,
    /// The same and the chains, 4 bytes an element: Sliding-Tris as printed.
    pub chains: u64,
    /// The same as `indexed`, one parent of 4 bytes a vertex, and a bit a vertex where points have several.
    pub window: u64,
}

impl SlidingWindow {
    /// Chain lengths; chains are derived, not stored.
    pub fn chains(&self) -> Chains {
        // Parents come first.
        let mut lengths = vec![0_u32; self.vertex_count()];
        for v in self.base_vertices as usize..lengths.len() {
            lengths[v] = lengths[self.parents[v] as usize] + 1;
        }
        let elements: u64 = lengths.iter().map(|n| u64::from(*n)).sum();
        let longest = lengths.iter().copied().max().unwrap_or(0);
        Chains { elements, longest, mean: elements as f64 / lengths.len().max(1) as f64 }
    }

    /// Bytes of the model with this many a vertex (12 for positions alone).
    pub fn storage(&self, vertex_bytes: u32) -> Storage {
        let (vertices, faces) = (self.vertex_count() as u64, self.face_count() as u64);
        let indexed = vertices * u64::from(vertex_bytes) + 12 * faces;
        let chains = indexed + 4 * self.chains().elements;
        let window = indexed + 4 * vertices + 4 * self.starts.len() as u64;
        Storage { indexed, chains, window }
    }
}
