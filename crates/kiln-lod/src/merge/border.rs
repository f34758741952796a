//! Border edges and their joining.

use glam::{DVec3, Vec3};
use kiln_asset::{FaceId, Mesh, PointId, SubmeshId};

/// An edge with exactly one face within its submesh.
#[derive(Clone, Copy, Debug)]
pub(super) struct BorderEdge {
    /// Its vertices in the direction of its face.
    vertices: [u32; 2],
    submesh: SubmeshId,
}

/// All border edges of the faces `kept`, ordered by submesh and points.
pub(super) fn border_edges(mesh: &Mesh, kept: &[FaceId]) -> Vec<BorderEdge> {
    let mut half_edges: Vec<([u32; 3], BorderEdge)> = Vec::with_capacity(3 * kept.len());
    for f in kept {
        let submesh = mesh.face_submesh[f.index()];
        let [a, b, c] = mesh.triangles[f.index()];
        for vertices in [[a, b], [b, c], [c, a]] {
            let [p, q] = vertices.map(|v| mesh.points[v as usize].0);
            half_edges.push(([submesh.0, p.min(q), p.max(q)], BorderEdge { vertices, submesh }));
        }
    }
    half_edges.sort_unstable_by_key(|(key, edge)| (*key, edge.vertices));
    half_edges.chunk_by(|a, b| a.0 == b.0).filter(|run| run.len() == 1).map(|run| run[0].1).collect()
}

/// The points `[vertex_count]` after uniting the ends of border edges of different submeshes that lie pairwise within
/// `weld` (object units), numbered densely by lowest old point; and the number of edges that found a partner.
pub(super) fn join(mesh: &Mesh, edges: &[BorderEdge], weld: f32) -> (Vec<PointId>, u32) {
    let mut points = Union::new(mesh.point_count());
    let mut joined = vec![false; edges.len()];
    let grid = Grid::new(mesh, edges, weld);
    for (i, edge) in edges.iter().enumerate() {
        grid.in_reach(i, |j| {
            // Every pair is seen from both sides; once is enough.
            if j <= i || edges[j].submesh == edge.submesh {
                return;
            }
            let other = edges[j].vertices;
            // Two consistently wound parts run along their boundary in opposite directions: try that first.
            for ends in [[other[1], other[0]], other] {
                if (0..2).all(|k| within(mesh, edge.vertices[k], ends[k], weld)) {
                    for (own, end) in edge.vertices.iter().zip(ends) {
                        points.unite(mesh.points[*own as usize], mesh.points[end as usize]);
                    }
                    joined[i] = true;
                    joined[j] = true;
                    break;
                }
            }
        });
    }
    let dense = points.dense();
    (mesh.points.iter().map(|p| dense[p.index()]).collect(), joined.iter().filter(|j| **j).count() as u32)
}

fn within(mesh: &Mesh, a: u32, b: u32, weld: f32) -> bool {
    let [a, b] = [a, b].map(|v| mesh.positions[v as usize].as_dvec3());
    (a - b).length_squared() <= f64::from(weld) * f64::from(weld)
}

/// Edges by the cell in which their midpoint lies. Ends pairwise within a distance put the midpoints within it, too.
struct Grid {
    /// Least corner, object space.
    origin: DVec3,
    /// Width of a cell, object units: twice the reach, so that a reach touches at most eight cells, and at least a
    /// millionth of the diagonal, so that cells can be numbered in 21 bits.
    cell: f64,
    reach: f64,
    midpoints: Vec<DVec3>,
    /// `(cell, edge)`, ascending.
    entries: Vec<(u64, u32)>,
}

impl Grid {
    fn new(mesh: &Mesh, edges: &[BorderEdge], weld: f32) -> Grid {
        let (lo, hi) = mesh.bounds();
        let diagonal = (hi.as_dvec3() - lo.as_dvec3()).length();
        let position = |v: u32| -> Vec3 { mesh.positions[v as usize] };
        let midpoints: Vec<DVec3> = edges
            .iter()
            .map(|e| 0.5 * (position(e.vertices[0]).as_dvec3() + position(e.vertices[1]).as_dvec3()))
            .collect();
        let cell = (2.0 * f64::from(weld)).max(1e-6 * diagonal).max(f64::MIN_POSITIVE);
        // The slack covers the rounding of midpoints.
        let reach = f64::from(weld) + 1e-9 * diagonal;
        let mut grid = Grid { origin: lo.as_dvec3() - DVec3::splat(cell), cell, reach, midpoints, entries: Vec::new() };
        grid.entries = (0..edges.len()).map(|i| (grid.key(grid.cell_of(grid.midpoints[i])), i as u32)).collect();
        grid.entries.sort_unstable();
        grid
    }

    fn cell_of(&self, p: DVec3) -> [u64; 3] {
        ((p - self.origin) / self.cell).floor().to_array().map(|c| c as u64)
    }

    fn key(&self, [x, y, z]: [u64; 3]) -> u64 {
        x << 42 | y << 21 | z
    }

    /// Calls `visit` with every edge whose midpoint may lie within reach of that of edge `i`, in a fixed order.
    fn in_reach(&self, i: usize, mut visit: impl FnMut(usize)) {
        let lo = self.cell_of(self.midpoints[i] - DVec3::splat(self.reach));
        let hi = self.cell_of(self.midpoints[i] + DVec3::splat(self.reach));
        for x in lo[0]..=hi[0] {
            for y in lo[1]..=hi[1] {
                for z in lo[2]..=hi[2] {
                    let key = self.key([x, y, z]);
                    let start = self.entries.partition_point(|e| e.0 < key);
                    for (_, j) in self.entries[start..].iter().take_while(|e| e.0 == key) {
                        visit(*j as usize);
                    }
                }
            }
        }
    }
}

/// Disjoint sets of points; each set is named by its lowest member.
pub(super) struct Union(Vec<u32>);

impl Union {
    /// Each of `count` points alone.
    pub(super) fn new(count: usize) -> Union {
        Union((0..count as u32).collect())
    }

    /// The lowest member of the set of `p`.
    pub(super) fn find(&mut self, mut p: u32) -> u32 {
        while self.0[p as usize] != p {
            let up = self.0[self.0[p as usize] as usize];
            self.0[p as usize] = up;
            p = up;
        }
        p
    }

    pub(super) fn unite(&mut self, a: PointId, b: PointId) {
        let (a, b) = (self.find(a.0), self.find(b.0));
        self.0[a.max(b) as usize] = a.min(b);
    }

    /// The new point of each old one, numbered by lowest member.
    fn dense(mut self) -> Vec<PointId> {
        let mut dense = vec![PointId(0); self.0.len()];
        let mut next = 0;
        for p in 0..self.0.len() as u32 {
            let root = self.find(p);
            if root == p {
                dense[p as usize] = PointId(next);
                next += 1;
            } else {
                dense[p as usize] = dense[root as usize];
            }
        }
        dense
    }
}
