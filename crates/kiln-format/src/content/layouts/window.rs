//! Sliding windows.

use super::{Check, Findings, Finest, counted, forest::Forest};
use crate::error::Code;
use crate::layout::{WINDOW_HAS_STARTS, WindowView};
use crate::prelude::*;

/// Runs of vertices that vanish together, by number.
struct Points<'a> {
    /// Bit `v % 32` of word `v / 32`; empty: every vertex is one.
    starts: &'a [u32],
    /// `[words]`: points that start before each word.
    before: Vec<u32>,
    count: u32,
}

impl<'a> Points<'a> {
    fn new(starts: &'a [u32], vertices: u32) -> Points<'a> {
        let mut count = 0;
        let before = starts.iter().map(|word| {
            count += word.count_ones();
            count - word.count_ones()
        });
        let before = before.collect();
        Points { starts, before, count: if starts.is_empty() { vertices } else { count } }
    }

    /// The point of a vertex. The first bit is set, so there is one.
    fn of(&self, vertex: u32) -> u32 {
        let Some(word) = self.starts.get(vertex as usize / 32) else { return vertex };
        let upto = word & (u32::MAX >> (31 - vertex % 32));
        self.before[vertex as usize / 32] + upto.count_ones() - 1
    }

    fn is_start(&self, vertex: u32) -> bool {
        self.starts.get(vertex as usize / 32).is_none_or(|word| word >> (vertex % 32) & 1 == 1)
    }
}

impl Check<'_, '_> {
    pub(super) fn window(&self, view: &WindowView<'_>, finest: &Finest<'_>, out: &mut Findings<'_>) -> Option<()> {
        let header = &view.header;
        out.count("vertices", header.vertices, finest.vertices())?;
        out.count("triangles", header.triangles, finest.triangle_count())?;
        out.within("collapses", header.collapses, 0, header.vertices)?;
        out.within("base_vertices", header.base_vertices, 0, header.vertices)?;
        if self.strict {
            out.zero("reserved", bytemuck::bytes_of(&header.reserved))?;
            out.zero("flags", &(header.flags & !WINDOW_HAS_STARTS).to_le_bytes())?;
        }
        self.checkpoints(view.checkpoints, 0, header.collapses, out)?;
        let points = points(view, out)?;
        let forest = forest(view, &points, out)?;
        self.vanishing(view, &points, &forest, finest, out)
    }

    /// Each triangle's death, their order in each range, and the checkpoints' counts.
    fn vanishing(
        &self,
        view: &WindowView<'_>,
        points: &Points<'_>,
        forest: &Forest,
        finest: &Finest<'_>,
        out: &mut Findings<'_>,
    ) -> Option<()> {
        // `dying[k]`: triangles that are alive at checkpoint k - 1 and not at k.
        let mut dying = vec![0u64; view.checkpoints.len() + 1];
        for (number, range) in finest.ranges.iter().enumerate() {
            let first = range.first_index as usize / 3;
            let mut before = u32::MAX;
            for t in first..first + range.index_count as usize / 3 {
                let [a, b, c] = finest.triangle(t).map(|v| points.of(v));
                if a == b || b == c || c == a {
                    return out.fail(Code::Vanishing, format!("triangle {t}"), "three points at LOD 0", "fewer");
                }
                // The last point vanishes first, with collapse 1.
                let meet = |a, b| forest.last_step(a, b).map_or(u32::MAX, |point| points.count - point);
                let death = meet(a, b).min(meet(b, c)).min(meet(c, a));
                if death > before {
                    let expected = format!("a triangle of range {number} that vanishes at LOD {before} or before");
                    return out.fail(Code::Vanishing, format!("triangle {t}"), expected, death);
                }
                before = death;
                dying[view.checkpoints.partition_point(|c| c.detail < death)] += 1;
            }
        }
        // Alive at checkpoint k: those that die later than it.
        let mut alive: Vec<u64> =
            dying.iter().rev().scan(0, |sum, dying| Some(core::mem::replace(sum, *sum + dying))).collect();
        alive.reverse();
        let triangles = |k: usize| alive[k];
        let ends = ends(view, points);
        counted(view.checkpoints, |k| (ends[k] as u64, triangles(k)), out)
    }
}

/// Bits of starts, and how many lie behind the base.
fn points<'a>(view: &WindowView<'a>, out: &mut Findings<'_>) -> Option<Points<'a>> {
    let header = &view.header;
    let points = Points::new(view.starts, header.vertices);
    if let Some(last) = view.starts.last() {
        let behind = header.vertices % 32;
        if behind != 0 && last >> behind != 0 {
            out.fail(Code::Points, "starts", "zeros behind the last vertex", "another value")?;
        }
        if view.starts[0] & 1 == 0 {
            out.fail(Code::Points, "starts", "the first vertex starts a point", "it does not")?;
        }
    }
    let base = header.base_vertices;
    let below = if base == header.vertices { points.count } else { points.of(base) };
    if base < header.vertices && !points.is_start(base) {
        out.fail(Code::Points, "base_vertices", "the start of a point", base)?;
    }
    let behind = points.count - below;
    if behind != header.collapses {
        out.fail(Code::Points, "collapses", format!("{behind} points behind the base"), header.collapses)?;
    }
    Some(points)
}

/// The points' parents, proved to stand before them and to be the same for all their vertices.
fn forest(view: &WindowView<'_>, points: &Points<'_>, out: &mut Findings<'_>) -> Option<Forest> {
    let mut forest = Forest::with_capacity(points.count as usize);
    let (mut start, mut point, mut to) = (0, 0, 0);
    for (v, parent) in view.parents.iter().enumerate() {
        let v = v as u32;
        let first = points.is_start(v);
        if first {
            (start, point) = (v, points.of(v));
        }
        let base = v < view.header.base_vertices;
        let right = if base { *parent == v } else { *parent < start };
        if !right {
            let expected = if base { format!("{v}") } else { format!("a vertex before {start}") };
            out.fail(Code::Parents, format!("parents[{v}]"), expected, parent)?;
        }
        let own = points.of(*parent);
        if first {
            to = own;
            forest.push(if base { point } else { to });
        } else if own != to {
            out.fail(
                Code::Parents,
                format!("parents[{v}]"),
                format!("a vertex of point {to}"),
                format!("of point {own}"),
            )?;
        }
    }
    Some(forest)
}

/// Vertices alive at each checkpoint: the first one of the earliest point that is gone.
fn ends(view: &WindowView<'_>, points: &Points<'_>) -> Vec<u32> {
    let mut ends = vec![view.header.vertices; view.checkpoints.len()];
    // Checkpoints from the coarsest: their first gone points ascend.
    let mut wanted = (0..ends.len()).rev().peekable();
    for v in (0..view.header.vertices).filter(|v| points.is_start(*v)) {
        let point = points.of(v);
        while let Some(k) = wanted.next_if(|k| points.count - view.checkpoints[*k].detail == point) {
            ends[k] = v;
        }
    }
    ends
}
