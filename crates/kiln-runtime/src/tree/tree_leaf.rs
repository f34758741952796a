//! Picking in tree and leaf buffers; CPU twin of `shaders/tree_leaf_pick.wgsl`.

use core::ops::Range;

use kiln_format::layout::TreeLeafView;

use super::{Place, RLevel, Scale};

/// Tree and leaf buffers, ready to pick from.
#[derive(Clone, Copy, Debug)]
pub struct TreeLeaf<'a> {
    view: TreeLeafView<'a>,
}

/// Numbers of a pass, the same for all vertices.
#[derive(Clone, Copy)]
struct Pass {
    /// Texels of a row and of a block, and their inverses.
    width: f64,
    block: f64,
    per_width: f64,
    per_block: f64,
    row: f64,
    fraction: f32,
}

/// What lies behind the buffer.
const NOTHING: [f32; 4] = [0.0; 4];

impl<'a> TreeLeaf<'a> {
    /// Wraps a view.
    pub fn new(view: TreeLeafView<'a>) -> TreeLeaf<'a> {
        TreeLeaf { view }
    }

    /// Checkpoints and counts.
    pub fn scale(&self) -> Scale<'a> {
        let view = &self.view;
        Scale { checkpoints: view.checkpoints, row_starts: view.row_starts, face_counts: view.face_counts }
    }

    /// Vertices.
    pub fn vertex_count(&self) -> usize {
        self.view.leaf.len()
    }

    /// Writes the picks of the vertices `range` at `r`: `out[i]` for vertex `range.start + i`, as far as both reach.
    ///
    /// # Source
    /// Kanaya et al. 2011, pass 2, cases as they must be (the print has the second one's branches swapped).
    pub fn pick<P: Place>(&self, r: RLevel, range: Range<usize>, out: &mut [P]) {
        let end = range.end.min(self.view.leaf.len());
        let leaves = self.view.leaf.get(range.start..end).unwrap_or(&[]);
        let (pass, tree) = (self.pass(r), self.view.tree);
        for (leaf, out) in leaves.iter().zip(out) {
            *out = P::at(pass.pick(leaf, |texel| tree.get(texel as usize).unwrap_or(&NOTHING)));
        }
    }

    /// [`TreeLeaf::pick`] at `threshold`.
    pub fn pick_at<P: Place>(&self, threshold: u32, range: Range<usize>, out: &mut [P]) {
        self.pick(self.scale().r_of(threshold), range, out);
    }

    fn pass(&self, r: RLevel) -> Pass {
        let header = &self.view.header;
        let width = f64::from(header.width.max(1));
        let block = width * f64::from(header.rows.max(1));
        let (per_width, per_block) = (1.0 / width, 1.0 / block);
        Pass { width, block, per_width, per_block, row: f64::from(r.row), fraction: r.fraction }
    }

    /// [`TreeLeaf::pick`] of one vertex, with the number of texels that were read.
    #[cfg(test)]
    pub(crate) fn counted(&self, r: RLevel, vertex: usize) -> ([f32; 3], u32) {
        let count = std::cell::Cell::new(1);
        let pick = self.pass(r).pick(&self.view.leaf[vertex], |texel| {
            count.set(count.get() + 1);
            &self.view.tree[texel as usize]
        });
        (pick, count.get())
    }

    /// `deaths[i]` for triangle i of `triangles`: rank of the node at which two corners of it first share their pick; a triangle with an
    /// index out of range never lives.
    ///
    /// Columns are equal from the root down to where they part, so their last equal row is found by bisection; cells of one row
    /// are disjoint and hold their positions, so texels at equal places are one node's.
    pub fn deaths(&self, triangles: &[[u32; 3]], deaths: &mut [u32]) {
        for (triangle, death) in triangles.iter().zip(deaths) {
            let [a, b, c] = *triangle;
            let meets = [(a, b), (b, c), (c, a)].map(|(a, b)| self.meet(a, b));
            *death = meets.into_iter().max().unwrap_or(u32::MAX);
        }
    }

    /// Rank of the deepest node over both vertices.
    fn meet(&self, a: u32, b: u32) -> u32 {
        let (Some(a), Some(b)) = (self.column(a), self.column(b)) else { return u32::MAX };
        let texel = |(base, _): (u32, u32), row: u32| {
            let texel = u64::from(base) + u64::from(row) * u64::from(self.view.header.width);
            self.view.tree.get(texel as usize).copied().unwrap_or(NOTHING)
        };
        let same = |row: u32| {
            let ([ax, ay, az, _], [bx, by, bz, _]) = (texel(a, row), texel(b, row));
            [ax, ay, az] == [bx, by, bz]
        };
        let (mut low, mut high) = (0, a.1.min(b.1));
        while low < high {
            let row = low + (high - low).div_ceil(2);
            if same(row) { low = row } else { high = row - 1 }
        }
        let (start, end) = self.scale().row(low as usize);
        let k = libm::roundf(texel(a, low)[3] * end.saturating_sub(start) as f32) as u32;
        start.saturating_add(k.saturating_sub(1))
    }

    /// Number of the first texel of a vertex' column, and its terminal node's row.
    fn column(&self, vertex: u32) -> Option<(u32, u32)> {
        let pointer = self.view.leaf.get(vertex as usize)?[3] as u32;
        let (width, rows) = (self.view.header.width.max(1), self.view.header.rows.max(1));
        let row = pointer / width % rows;
        Some((pointer - row * width, row))
    }
}

/// 1.5 times 2^52: around it doubles are whole numbers, the lowest bits their distance from it.
const WHOLE: f64 = (3u64 << 51) as f64;

/// The whole number nearest to `x`, which is between -2^32 and 2^32: the sum rounds.
#[inline(always)]
fn nearest(x: f64) -> f64 {
    (x + WHOLE) - WHOLE
}

/// A whole number from 0 to 2^32 - 1, as one; anything else gives some other one. `as` would check for those.
#[inline(always)]
fn whole(x: f64) -> u32 {
    (x + WHOLE).to_bits() as u32
}

impl Pass {
    /// The position that a leaf picks, without a branch that depends on it: a second read that is not needed repeats the first.
    ///
    /// `a / b` of whole numbers below 2^24 is the whole number nearest to `(a + 0.5) / b - 0.5`, which is never half-way between two.
    #[inline(always)]
    fn pick<'t>(&self, leaf: &'t [f32; 4], read: impl Fn(u32) -> &'t [f32; 4]) -> [f32; 3] {
        // Hostile pointers: what is no number or too large is caught where texels are read.
        let pointer = f64::from(leaf[3]).clamp(0.0, 16_777_215.0);
        let block = nearest((pointer + 0.5) * self.per_block - 0.5);
        let inside = pointer - block * self.block;
        let terminal_row = nearest((inside + 0.5) * self.per_width - 0.5);
        // d = above + 1 - fraction: d <= 0, 0 < d <= 1 and d > 1 are above < 0, 0 and more.
        let above = terminal_row - self.row;
        let texel = pointer - above.max(0.0) * self.width;
        let below = if above >= 1.0 { texel + self.width } else { texel };
        let hit = read(whole(texel))[3] > self.fraction;
        let node = read(whole(if hit { texel } else { below }));
        let is_node = above >= 1.0 || (above >= 0.0 && hit);
        let [x, y, z, _] = *if is_node { node } else { leaf };
        [x, y, z]
    }
}
