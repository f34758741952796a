//! Tree buffer and leaf buffer: the paper's layout, with which a pick is at most three reads.
//!
//! ```text
//! a column a deepest node (one without internal nodes below it), numbered as vertices first use them
//! tree buffer, column c, row i <- x, y, z, q = k / n of the shallowest node of row >= i on the column's path from the root
//! leaf buffer, vertex v        <- x, y, z and the number of a texel that holds v's terminal node, in the row of its i_level
//! pick for r = (row, f):  leaf, if its terminal row is above `row`; in it, the terminal node if q > f, else the leaf;
//!                         below it, of the column's texels in rows `row` and `row + 1` the first with (its row) + q > r
//! ```
//! A row that a path skips holds the node below it, so that the second texel is right where the first is not. Columns stand side by
//! side, in blocks of at most [`MAX_WIDTH`], so that a level reads two rows of each block.
//!
//! **Price.** Ancestors are stored once a column: six times the compact tree's bytes on scans and terrain (36 a triangle against 6). Texel numbers are exact in 32-bit
//! floats up to 2^24; a tree with more texels is refused.
//!
//! Source: Kanaya et al. 2011, section 2.4; figures 2, 3, 4 and 6.

use kiln_asset::Mesh;

use super::ClusterTree;

/// Greatest width, texels: what every graphics interface has.
pub const MAX_WIDTH: u32 = 8192;
/// Most texels: their numbers are exact integers in 32-bit floats.
pub const MAX_TEXELS: u64 = 1 << 24;

/// Why there are no buffers of a tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TreeBufferError {
    /// More texels than a 32-bit float can name.
    #[error(
        "the tree buffer needs {texels} texels ({columns} columns of {rows} rows), but pointers in 32-bit floats name at most \
         {MAX_TEXELS}; use the compact tree, which has no such limit"
    )]
    TooManyTexels {
        /// Texels that it needs.
        texels: u64,
        /// Its columns.
        columns: u32,
        /// Its rows.
        rows: u32,
    },
}

/// Tree buffer and leaf buffer of a tree.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TreeLeafBuffers {
    /// Texels of a row of a block, at most [`MAX_WIDTH`].
    pub width: u32,
    /// Rows of a block: those of the tree.
    pub rows: u32,
    /// Columns, one a deepest node.
    pub columns: u32,
    /// `[width * rows * ceil(columns / width)]`: x, y, z (object units), q; the texel of column `c` and row `i` is number
    /// `((c / width) * rows + i) * width + c % width`. Zeros behind a path's deepest node and behind the last column.
    pub tree: Vec<[f32; 4]>,
    /// `[vertex_count]`: x, y, z (object units) and the number of a texel of its terminal node.
    pub leaf: Vec<[f32; 4]>,
}

impl TreeLeafBuffers {
    /// The buffers of `tree`, which is of `mesh`.
    ///
    /// # Errors
    /// More texels than pointers can name.
    ///
    /// # Panics
    /// If the tree is of another mesh.
    pub fn new(tree: &ClusterTree, mesh: &Mesh) -> Result<TreeLeafBuffers, TreeBufferError> {
        assert_eq!(mesh.vertex_count(), tree.terminals().len(), "the tree is of another mesh");
        let (column_of, deepest) = columns(tree);
        let (columns, rows) = (deepest.len() as u32, tree.rows());
        let blocks = columns.div_ceil(MAX_WIDTH);
        let width = columns.div_ceil(blocks.max(1));
        let texels = u64::from(width) * u64::from(rows) * u64::from(blocks);
        if texels > MAX_TEXELS {
            return Err(TreeBufferError::TooManyTexels { texels, columns, rows });
        }
        let mut buffers = TreeLeafBuffers { width, rows, columns, ..Default::default() };
        buffers.tree = vec![[0.0; 4]; texels as usize];
        let row_of = rows_of(tree);
        for (column, node) in deepest.iter().enumerate() {
            let mut node = *node;
            loop {
                let parent = tree.nodes()[node as usize].parent;
                let top = if node == 0 { 0 } else { row_of[parent as usize] + 1 };
                for row in top..=row_of[node as usize] {
                    let place = buffers.texel(column as u32, row);
                    buffers.tree[place as usize] = texel(tree, node, row_of[node as usize]);
                }
                if node == 0 {
                    break;
                }
                node = parent;
            }
        }
        let leaf = |(terminal, place): (&u32, &glam::Vec3)| {
            let pointer = buffers.texel(column_of[*terminal as usize], row_of[*terminal as usize]);
            [place.x, place.y, place.z, pointer as f32]
        };
        buffers.leaf = tree.terminals().iter().zip(&mesh.positions).map(leaf).collect();
        Ok(buffers)
    }

    /// Number of the texel of `column` in `row`.
    fn texel(&self, column: u32, row: u32) -> u32 {
        (column / self.width * self.rows + row) * self.width + column % self.width
    }
}

fn rows_of(tree: &ClusterTree) -> Vec<u32> {
    let counts = tree.row_starts().windows(2).map(|row| row[1] - row[0]);
    (0..).zip(counts).flat_map(|(row, count)| std::iter::repeat_n(row, count as usize)).collect()
}

/// Position and q of a node.
fn texel(tree: &ClusterTree, rank: u32, row: u32) -> [f32; 4] {
    let [x, y, z] = tree.nodes()[rank as usize].position;
    let [start, end] = [tree.row_starts()[row as usize], tree.row_starts()[row as usize + 1]];
    // Both exact, and different ones for different k, up to 2^24.
    [x, y, z, (rank - start + 1) as f32 / (end - start) as f32]
}

/// `[node_count]`: a column through each node; and the deepest node of each column.
fn columns(tree: &ClusterTree) -> (Vec<u32>, Vec<u32>) {
    const NONE: u32 = u32::MAX;
    let mut inner = vec![false; tree.nodes().len()];
    tree.nodes().iter().skip(1).for_each(|node| inner[node.parent as usize] = true);
    let (mut column_of, mut deepest) = (vec![NONE; tree.nodes().len()], Vec::new());
    for terminal in tree.terminals() {
        let slot = &mut column_of[*terminal as usize];
        if *slot == NONE && !inner[*terminal as usize] {
            *slot = deepest.len() as u32;
            deepest.push(*terminal);
        }
    }
    for rank in (1..column_of.len()).rev() {
        let below = column_of[rank];
        let slot = &mut column_of[tree.nodes()[rank].parent as usize];
        *slot = below.min(*slot);
    }
    (column_of, deepest)
}
