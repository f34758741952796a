//! Trees, in both forms: what the columns of a tree buffer say is brought to the compact form, and that is checked.

use super::{Check, Findings, Finest, counted};
use crate::error::Code;
use crate::layout::{CompactTreeView, MAX_TREE_ROWS, MAX_TREE_TEXELS, MAX_TREE_WIDTH, TreeHeader, TreeLeafView};
use crate::prelude::*;
use crate::record::NONE;

impl Check<'_, '_> {
    pub(super) fn compact_tree(
        &self,
        view: &CompactTreeView<'_>,
        finest: &Finest<'_>,
        out: &mut Findings<'_>,
    ) -> Option<()> {
        self.tree_header(&view.header, view.row_starts, finest, out)?;
        out.count("columns", view.header.columns, 0)?;
        out.count("width", view.header.width, 0)?;
        self.checkpoints(view.checkpoints, view.header.nodes, 0, out)?;
        let rows = rows(view.row_starts);
        for (n, node) in view.nodes.iter().enumerate() {
            out.finite(&format!("nodes[{n}].position"), &node.position)?;
            let parent = node.parent as usize;
            let right = if n == 0 { parent == 0 } else { parent < n && rows[parent] < rows[n] };
            if !right {
                let expected = if n == 0 { "0 for the root" } else { "a rank in a row before its own" };
                out.fail(Code::TreeRows, format!("nodes[{n}].parent"), expected, parent)?;
            }
        }
        if let Some(v) = view.terminals.iter().position(|terminal| *terminal >= view.header.nodes) {
            let expected = format!("a node below {}", view.header.nodes);
            out.fail(Code::Terminals, format!("terminals[{v}]"), expected, view.terminals[v])?;
        }
        let parents: Vec<u32> = view.nodes.iter().map(|node| node.parent).collect();
        let tree = Tree { parents: &parents, terminals: view.terminals };
        tree.face_counts(view.face_counts, finest, out)?;
        let picks = tree.picks(finest);
        counted(view.checkpoints, |k| count_at(&picks, view.face_counts, view.checkpoints[k].detail), out)
    }

    pub(super) fn tree_leaf(&self, view: &TreeLeafView<'_>, finest: &Finest<'_>, out: &mut Findings<'_>) -> Option<()> {
        self.tree_header(&view.header, view.row_starts, finest, out)?;
        out.within("width", view.header.width, 1, MAX_TREE_WIDTH)?;
        out.within("columns", view.header.columns, 1, view.header.nodes)?;
        out.within("texels", u32::try_from(view.tree.len()).unwrap_or(NONE), 1, MAX_TREE_TEXELS)?;
        self.checkpoints(view.checkpoints, view.header.nodes, 0, out)?;
        out.finite("tree", bytemuck::cast_slice(view.tree))?;
        out.finite("leaf", bytemuck::cast_slice(view.leaf))?;
        let columns = Columns { view, places: vec![NONE; view.header.nodes as usize] }.resolved(out)?;
        let parents = columns.parents(out)?;
        let terminals = columns.terminals(finest, out)?;
        let tree = Tree { parents: &parents, terminals: &terminals };
        tree.face_counts(view.face_counts, finest, out)?;
        let picks = tree.picks(finest);
        counted(view.checkpoints, |k| count_at(&picks, view.face_counts, view.checkpoints[k].detail), out)
    }

    fn tree_header(
        &self,
        header: &TreeHeader,
        row_starts: &[u32],
        finest: &Finest<'_>,
        out: &mut Findings<'_>,
    ) -> Option<()> {
        out.count("vertices", header.vertices, finest.vertices())?;
        out.within("nodes", header.nodes, 1, header.vertices)?;
        out.within("rows", header.rows, 1, MAX_TREE_ROWS)?;
        if self.strict {
            out.zero("reserved", bytemuck::bytes_of(&header.reserved))?;
        }
        let ends = (row_starts.first(), row_starts.last());
        if !row_starts.is_sorted() || ends != (Some(&0), Some(&header.nodes)) {
            out.fail(
                Code::TreeRows,
                "row_starts",
                format!("rising from 0 to {}", header.nodes),
                format!("{row_starts:?}"),
            )?;
        }
        Some(())
    }
}

fn count_at(picks: &[u64], face_counts: &[u32], threshold: u32) -> (u64, u64) {
    (picks[threshold as usize], face_counts[threshold as usize] as u64)
}

/// The row of each node.
fn rows(row_starts: &[u32]) -> Vec<u8> {
    let mut rows = Vec::with_capacity(row_starts.last().map_or(0, |n| *n as usize));
    for (row, pair) in row_starts.windows(2).enumerate() {
        rows.resize(pair[1] as usize, row as u8);
    }
    rows
}

/// Nodes by rank, and which of them ends the way to each vertex. A parent's row is before its child's, so no way is longer
/// than there are rows.
struct Tree<'t> {
    parents: &'t [u32],
    terminals: &'t [u32],
}

impl Tree<'_> {
    /// Rank of the node where two ways part.
    fn meet(&self, mut a: u32, mut b: u32) -> u32 {
        while a != b {
            let greater = if a > b { &mut a } else { &mut b };
            *greater = self.parents[*greater as usize];
        }
        a
    }

    /// A triangle lives at the thresholds above the greatest rank at which two of its corners meet.
    fn face_counts(&self, stated: &[u32], finest: &Finest<'_>, out: &mut Findings<'_>) -> Option<()> {
        let mut born = vec![0u32; stated.len()];
        for t in 0..finest.triangle_count() as usize {
            let corners = finest.triangle(t);
            let ends = corners.map(|v| self.terminals[v as usize]);
            let places = corners.map(|v| finest.positions[v as usize]);
            let pairs = [(0, 1), (1, 2), (2, 0)];
            if pairs
                .iter()
                .any(|(a, b)| corners[*a] == corners[*b] || (ends[*a] == ends[*b] && places[*a] == places[*b]))
            {
                return out.fail(Code::FaceCounts, format!("triangle {t}"), "three different leaves", "fewer");
            }
            let meet = pairs.map(|(a, b)| self.meet(ends[a], ends[b]));
            born[meet[0].max(meet[1]).max(meet[2]) as usize + 1] += 1;
        }
        let mut alive = 0;
        for (t, (stated, born)) in stated.iter().zip(born).enumerate() {
            alive += born;
            if *stated != alive {
                return out.fail(Code::FaceCounts, format!("face_counts[{t}]"), alive, stated);
            }
        }
        Some(())
    }

    /// `[nodes + 1]`: different picks of all vertices at each threshold; leaves at one position of one node count once.
    fn picks(&self, finest: &Finest<'_>) -> Vec<u64> {
        let count = self.parents.len();
        let mut used = vec![false; count];
        let mut changes = vec![0i64; count + 2];
        // -0 + 0 is 0: equal numbers have equal bits.
        let key = |(p, terminal): (&[f32; 3], &u32)| (*terminal, p.map(|x| (x + 0.0).to_bits()));
        let mut leaves: Vec<(u32, [u32; 3])> = finest.positions.iter().zip(self.terminals).map(key).collect();
        leaves.sort_unstable();
        leaves.dedup();
        for (terminal, _) in leaves {
            used[terminal as usize] = true;
            changes[terminal as usize + 1] += 1;
        }
        for n in (1..count).rev() {
            if used[n] {
                // Picked where it is not split and its parent is.
                changes[self.parents[n] as usize + 1] += 1;
                changes[n + 1] -= 1;
                used[self.parents[n] as usize] = true;
            }
        }
        changes[0] += used[0] as i64;
        changes[1] -= used[0] as i64;
        let mut sum = 0;
        let sums = changes.iter().take(count + 1).map(|change| {
            sum += change;
            sum as u64
        });
        sums.collect()
    }
}

type Texel = [u32; 4];

/// A tree buffer whose texels are being told apart: nodes of their own row, and copies of the node below.
struct Columns<'v, 'a> {
    view: &'v TreeLeafView<'a>,
    /// By rank: number of a texel that is the node in its own row.
    places: Vec<u32>,
}

impl Columns<'_, '_> {
    fn number(&self, column: u32, row: u32) -> u32 {
        let (w, r) = (self.view.header.width, self.view.header.rows);
        ((column / w) * r + row) * w + column % w
    }

    fn texel(&self, number: u32) -> Texel {
        self.view.tree[number as usize].map(f32::to_bits)
    }

    /// The node of a row whose q a texel has.
    fn node(&self, row: u32, texel: Texel) -> Option<u32> {
        let [start, end] = [row, row + 1].map(|row| self.view.row_starts[row as usize]);
        let n = end - start;
        let q = f32::from_bits(texel[3]);
        // Counts are below 2^24, so that the quotient of two is the nearest number to the true one.
        let k = (q as f64 * n as f64 + 0.5) as u32;
        ((1..=n).contains(&k) && (k as f32 / n as f32).to_bits() == texel[3]).then(|| start + k - 1)
    }

    /// The node of a texel that is in its own row.
    fn own(&self, row: u32, texel: Texel) -> Option<u32> {
        let node = self.node(row, texel)?;
        let place = self.places[node as usize];
        (place != NONE && self.texel(place) == texel).then_some(node)
    }

    /// Row of a column's deepest node.
    fn deepest(&self, column: u32) -> Option<u32> {
        (0..self.view.header.rows).rev().find(|row| self.texel(self.number(column, *row)) != [0; 4])
    }

    /// Finds every node's texel. A texel that differs from the one below it is a node of its row; an equal one is too if its q
    /// is one of its row and no other texel has that node's place.
    fn resolved(mut self, out: &mut Findings<'_>) -> Option<Self> {
        let header = self.view.header;
        let blocks = header.columns.div_ceil(header.width);
        for column in header.columns..blocks * header.width {
            if self.deepest(column).is_some() {
                out.fail(
                    Code::TreeTexels,
                    format!("column {column}"),
                    "zeros behind the last column",
                    "another value",
                )?;
            }
        }
        for pass in 0..2 {
            for column in 0..header.columns {
                let Some(deepest) = self.deepest(column) else {
                    return out.fail(Code::TreeTexels, format!("column {column}"), "a path", "zeros").map(|()| self);
                };
                for row in 0..=deepest {
                    let number = self.number(column, row);
                    let texel = self.texel(number);
                    let differs = row == deepest || self.texel(self.number(column, row + 1)) != texel;
                    let node = self.node(row, texel);
                    if pass == 1 && !differs {
                        if let Some(node) = node.filter(|node| self.places[*node as usize] == NONE) {
                            self.places[node as usize] = number;
                        }
                    } else if pass == 0 && differs {
                        let place = node.map(|node| (node, self.places[node as usize]));
                        match place {
                            Some((node, NONE)) => self.places[node as usize] = number,
                            Some((_, place)) if self.texel(place) == texel => {}
                            _ => {
                                let at = format!("column {column}, row {row}");
                                let expected = "a node of that row, the same in every column";
                                out.fail(
                                    Code::TreeTexels,
                                    at,
                                    expected,
                                    format!("{:?}", self.view.tree[number as usize]),
                                )?;
                            }
                        }
                    }
                }
            }
        }
        if let Some(node) = self.places.iter().position(|place| *place == NONE) {
            out.fail(Code::TreeTexels, format!("node {node}"), "a column through every node", "none")?;
        }
        Some(self)
    }

    /// By rank: the node before it in its columns.
    fn parents(&self, out: &mut Findings<'_>) -> Option<Vec<u32>> {
        let mut parents = vec![NONE; self.places.len()];
        for column in 0..self.view.header.columns {
            let mut before = None;
            for row in 0..=self.deepest(column)? {
                let texel = self.texel(self.number(column, row));
                let Some(node) = self.own(row, texel) else {
                    if row == 0 {
                        out.fail(Code::TreeTexels, format!("column {column}"), "the root in row 0", "another node")?;
                    }
                    continue;
                };
                let parent = before.unwrap_or(0);
                let known = &mut parents[node as usize];
                if *known != NONE && *known != parent {
                    let at = format!("column {column}, row {row}");
                    out.fail(Code::TreeTexels, at, format!("node {node} below node {known}"), parent)?;
                }
                *known = parent;
                before = Some(node);
            }
        }
        // Every way starts with the one node of row 0.
        if self.view.row_starts[1] != 1 {
            out.fail(Code::TreeRows, "row_starts[1]", 1, self.view.row_starts[1])?;
        }
        Some(parents)
    }

    /// The leaves' nodes.
    fn terminals(&self, finest: &Finest<'_>, out: &mut Findings<'_>) -> Option<Vec<u32>> {
        let (header, texels) = (self.view.header, self.view.tree.len() as f32);
        let mut terminals = Vec::with_capacity(self.view.leaf.len());
        for (v, (leaf, position)) in self.view.leaf.iter().zip(finest.positions).enumerate() {
            let [x, y, z, pointer] = *leaf;
            if [x, y, z].map(f32::to_bits) != position.map(f32::to_bits) {
                out.fail(Code::Terminals, format!("leaf[{v}]"), format!("{position:?}"), format!("{leaf:?}"))?;
            }
            let number = pointer as u32;
            let whole = (0.0..texels).contains(&pointer) && number as f32 == pointer;
            let row = number / header.width % header.rows;
            let column = number / header.width / header.rows * header.width + number % header.width;
            let inside = whole && column < header.columns;
            let node = if inside { self.own(row, self.texel(number)) } else { None };
            match node {
                Some(node) => terminals.push(node),
                None => {
                    out.fail(Code::Terminals, format!("leaf[{v}]"), "the texel of a node in its own row", pointer)?
                }
            }
        }
        Some(terminals)
    }
}
