//! Topology: the corner table over points, the kind of every edge and of every point.
//!
//! A [`Topology`] is built once from a mesh and never changed. Corners are `3 * face + k`; the *half-edge* of a corner runs
//! from its point to that of the next corner of its face. Faces with two corners at one point are left out of it: they
//! have no half-edges, and their points are [`PointKind::Complex`].
//!
//! Everything is found in one pass over the star of each point with one scratch array over points: linear time, no hashing.

use kiln_asset::{Mesh, PointId};
use rayon::prelude::*;

/// No corner, no point.
pub const NONE: u32 = u32::MAX;

/// What an edge is. An edge that is several things is the last of them in this order.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum EdgeKind {
    /// Two faces, consistently wound, of one submesh and one chart: at both ends they use the same wedge, or wedges that differ in
    /// normal and tangent only (a crease: geometry prices it, nothing else holds it).
    #[default]
    Manifold,
    /// Two faces of one submesh whose wedges differ in UV or colour at one end or both.
    Seam,
    /// Two faces of different submeshes.
    Boundary,
    /// One face.
    Border,
    /// More than two faces, or two whose windings disagree.
    Complex,
}

/// What a point is: where a collapse may take it follows from this (`simplify::rules`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum PointKind {
    /// A closed fan of faces around it, all edges manifold.
    #[default]
    Manifold,
    /// An open fan: two border edges, all others manifold.
    Border,
    /// A closed fan with exactly two seam edges.
    Seam,
    /// A closed fan with exactly two boundary edges and no seam.
    Boundary,
    /// An edge of more than two faces, disagreeing windings, several fans (bow tie), or a degenerate face.
    Complex,
    /// Where lines meet or end: three seams, a seam that runs into a boundary, a seam's tip. Also points without a face.
    Locked,
}

/// Adjacency of a mesh's faces over its points.
#[derive(Clone, Debug, Default)]
pub struct Topology {
    /// `[face_count] x 3` points.
    pub face_points: Vec<[u32; 3]>,
    /// `[point_count + 1]`: where the corners of each point start in `corners`.
    pub first: Vec<u32>,
    /// The corners at each point, ascending.
    pub corners: Vec<u32>,
    /// `[face_count] x 3`: kind of the edge of each half-edge.
    pub edge_kinds: Vec<[EdgeKind; 3]>,
    /// `[point_count]`.
    pub kinds: Vec<PointKind>,
    /// `[point_count] x 2`: for border, seam and boundary points the two points next to it along that line, the lower
    /// first; [`NONE`] for all others.
    pub lines: Vec<[u32; 2]>,
}

/// The corner after `corner` in its face.
#[inline]
pub fn next(corner: u32) -> u32 {
    if corner % 3 == 2 { corner - 2 } else { corner + 1 }
}

/// The corner before `corner` in its face.
#[inline]
pub fn previous(corner: u32) -> u32 {
    if corner.is_multiple_of(3) { corner + 2 } else { corner - 1 }
}

/// What the star of a point holds about one of its neighbours.
#[derive(Clone, Copy)]
struct Spoke {
    point: u32,
    /// Faces with the half-edge from the centre to the neighbour, and one such half-edge's corner.
    out_count: u32,
    out_corner: u32,
    /// The same from the neighbour to the centre.
    in_count: u32,
    in_corner: u32,
}

/// Most faces of a fan that is judged by comparing all with all.
const SMALL_FAN: usize = 16;

/// Points that one thread judges at a time.
const BLOCK: usize = 4096;

/// What is said of a block of points.
#[derive(Default)]
struct Block {
    kinds: Vec<PointKind>,
    lines: Vec<[u32; 2]>,
    /// (corner of the half-edge, kind) of all that are not manifold.
    edges: Vec<(u32, EdgeKind)>,
}

impl Topology {
    /// The topology of `mesh`.
    pub fn new(mesh: &Mesh) -> Topology {
        let point_count = mesh.point_count();
        let face_points: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| mesh.points[v as usize].0)).collect();
        let (first, corners) = corners_at_points(&face_points, point_count);
        let face_count = face_points.len();
        let mut topology = Topology {
            face_points,
            first,
            corners,
            edge_kinds: vec![[EdgeKind::Manifold; 3]; face_count],
            kinds: vec![PointKind::Locked; point_count],
            lines: vec![[NONE; 2]; point_count],
        };
        // Edges between points of one vertex each part no attributes.
        let mut vertices = vec![0_u8; point_count];
        for p in &mesh.points {
            let count = &mut vertices[p.index()];
            *count = count.saturating_add(1);
        }
        let whole: Vec<bool> = vertices.iter().map(|count| *count == 1).collect();
        // Points are judged by themselves, in blocks; what they say is written afterwards, in order.
        let blocks: Vec<Block> = (0..point_count.div_ceil(BLOCK))
            .into_par_iter()
            .map_init(
                || (Vec::new(), Vec::new()),
                |(spokes, spoke_of), block| {
                    let points = block * BLOCK..((block + 1) * BLOCK).min(point_count);
                    let mut said = Block::default();
                    for p in points {
                        if topology.plain_fan(&whole, p as u32) {
                            said.kinds.push(PointKind::Manifold);
                            said.lines.push([NONE; 2]);
                            continue;
                        }
                        spoke_of.resize(point_count, NONE);
                        topology.gather_spokes(p as u32, spokes, spoke_of);
                        topology.judge(mesh, &whole, p as u32, spokes, spoke_of, &mut said);
                        for spoke in &*spokes {
                            spoke_of[spoke.point as usize] = NONE;
                        }
                    }
                    said
                },
            )
            .collect();
        for (block, said) in blocks.iter().enumerate() {
            let start = block * BLOCK;
            topology.kinds[start..start + said.kinds.len()].copy_from_slice(&said.kinds);
            topology.lines[start..start + said.lines.len()].copy_from_slice(&said.lines);
            for (corner, kind) in &said.edges {
                topology.edge_kinds[*corner as usize / 3][*corner as usize % 3] = *kind;
            }
        }
        // Both points of a degenerate face stay where they are.
        for face in topology.face_points.iter().filter(|f| is_degenerate(f)) {
            for p in face {
                topology.kinds[*p as usize] = PointKind::Complex;
                topology.lines[*p as usize] = [NONE; 2];
            }
        }
        topology
    }

    /// Turns the edge between `corner`'s half-edge and its `twin` to the other diagonal of its two faces: out of (a, b, c) and (b, a, d),
    /// the edge from a to b, come (a, d, c) and (d, b, c), in the same two places. The corners at points do not follow; see
    /// [`Topology::sort_corners`].
    pub(crate) fn flip(&mut self, corner: u32, twin: u32) {
        let (f, g) = (corner as usize / 3, twin as usize / 3);
        let at = |c: u32| (c as usize / 3, c as usize % 3);
        let point = |c: u32| self.face_points[at(c).0][at(c).1];
        let kind = |c: u32| self.edge_kinds[at(c).0][at(c).1];
        let [a, b, c, d] = [corner, next(corner), previous(corner), previous(twin)].map(point);
        let [ad, ca, db, bc] = [next(twin), previous(corner), previous(twin), next(corner)].map(kind);
        (self.face_points[f], self.face_points[g]) = ([a, d, c], [d, b, c]);
        self.edge_kinds[f] = [ad, EdgeKind::Manifold, ca];
        self.edge_kinds[g] = [db, bc, EdgeKind::Manifold];
    }

    /// Finds the corners at each point anew, after faces changed; nothing else follows.
    pub(crate) fn sort_corners(&mut self) {
        (self.first, self.corners) = corners_at_points(&self.face_points, self.kinds.len());
    }

    /// The corners at a point, ascending.
    #[inline]
    pub fn star(&self, point: PointId) -> &[u32] {
        let p = point.index();
        &self.corners[self.first[p] as usize..self.first[p + 1] as usize]
    }

    /// The half-edge that runs the other way along that of `corner`; [`NONE`] at border and complex edges.
    pub fn twin(&self, corner: u32) -> u32 {
        let face = &self.face_points[corner as usize / 3];
        let k = corner as usize % 3;
        if self.edge_kinds[corner as usize / 3][k] >= EdgeKind::Border || is_degenerate(face) {
            return NONE;
        }
        let (from, to) = (face[k], face[(k + 1) % 3]);
        let point = |c: u32| self.face_points[c as usize / 3][c as usize % 3];
        // Of the two stars the smaller: a hub's faces are not asked for each of its spokes.
        let (here, there) = (self.star(PointId(from)), self.star(PointId(to)));
        let found = match here.len() <= there.len() {
            true => here.iter().map(|c| previous(*c)).find(|c| point(*c) == to),
            false => there.iter().copied().find(|c| point(next(*c)) == from),
        };
        found.unwrap_or(NONE)
    }

    /// Number of points of each kind, in the order of [`PointKind`].
    pub fn kind_counts(&self) -> [u32; 6] {
        let mut counts = [0; 6];
        for kind in &self.kinds {
            counts[*kind as usize] += 1;
        }
        counts
    }

    /// Whether the faces at `p` are one closed fan and all points there have one vertex each: nearly all points of most meshes, told
    /// without spokes.
    fn plain_fan(&self, whole: &[bool], p: u32) -> bool {
        let star = self.star(PointId(p));
        let count = star.len();
        if count == 0 || count > SMALL_FAN || !whole[p as usize] {
            return false;
        }
        let (mut out, mut into) = ([NONE; SMALL_FAN], [NONE; SMALL_FAN]);
        for (i, corner) in star.iter().enumerate() {
            let face = &self.face_points[*corner as usize / 3];
            (out[i], into[i]) = (face[next(*corner) as usize % 3], face[previous(*corner) as usize % 3]);
            if !whole[out[i] as usize] {
                return false;
            }
        }
        // From face to face: if it comes back after all of them and no sooner, it has seen each once, and no edge is crowded.
        let mut at = 0;
        for step in 1..=count {
            match out[..count].iter().position(|point| *point == into[at]) {
                Some(next) if (next == 0) == (step == count) => at = next,
                _ => return false,
            }
        }
        true
    }

    /// The neighbours of `p` in the order in which its corners name them, and where each stands in that list.
    fn gather_spokes(&self, p: u32, spokes: &mut Vec<Spoke>, spoke_of: &mut [u32]) {
        spokes.clear();
        for corner in self.star(PointId(p)) {
            let (f, k) = (*corner / 3, *corner % 3);
            let face = &self.face_points[f as usize];
            let (onward, back) = ([1, 2, 0][k as usize], [2, 0, 1][k as usize]);
            let mut spoke = |point: u32| -> usize {
                let slot = &mut spoke_of[point as usize];
                if *slot == NONE {
                    *slot = spokes.len() as u32;
                    spokes.push(Spoke { point, out_count: 0, out_corner: NONE, in_count: 0, in_corner: NONE });
                }
                *slot as usize
            };
            let (out, into) = (spoke(face[onward]), spoke(face[back]));
            spokes[out].out_count += 1;
            spokes[out].out_corner = *corner;
            spokes[into].in_count += 1;
            spokes[into].in_corner = 3 * f + back as u32;
        }
    }

    /// Kinds of the half-edges that leave `p`, and the kind and line of `p`.
    fn judge(&self, mesh: &Mesh, whole: &[bool], p: u32, spokes: &[Spoke], spoke_of: &[u32], said: &mut Block) {
        let mut counts = [0u32; 5];
        let mut line = [[NONE; 2]; 5];
        for spoke in spokes {
            let plain = spoke.out_count == 1 && spoke.in_count == 1 && whole[p as usize] && whole[spoke.point as usize];
            // A vertex belongs to one submesh.
            let kind = if plain { EdgeKind::Manifold } else { edge_kind(mesh, spoke) };
            let seen = &mut counts[kind as usize];
            if let Some(slot) = line[kind as usize].get_mut(*seen as usize) {
                *slot = spoke.point;
            }
            *seen += 1;
            if spoke.out_count == 1 && kind != EdgeKind::Manifold {
                said.edges.push((spoke.out_corner, kind));
            }
        }
        if counts[EdgeKind::Complex as usize] > 0 {
            // Half-edges of crowded edges are not named by their spokes one by one.
            for i in self.first[p as usize]..self.first[p as usize + 1] {
                let corner = self.corners[i as usize];
                let to = self.face_points[corner as usize / 3][next(corner) as usize % 3];
                let spoke = &spokes[spoke_of[to as usize] as usize];
                if spoke.out_count > 1 {
                    said.edges.push((corner, EdgeKind::Complex));
                }
            }
        }
        let [_, seam, boundary, border, complex] = counts;
        let (kind, along) = match (seam, boundary, border, complex) {
            _ if spokes.is_empty() => (PointKind::Locked, None),
            (_, _, _, 1..) => (PointKind::Complex, None),
            _ if !self.one_fan(p, spokes, spoke_of) => (PointKind::Complex, None),
            (0, 0, 0, 0) => (PointKind::Manifold, None),
            (0, 0, 2, 0) => (PointKind::Border, Some(EdgeKind::Border)),
            (2, 0, 0, 0) => (PointKind::Seam, Some(EdgeKind::Seam)),
            (0, 2, 0, 0) => (PointKind::Boundary, Some(EdgeKind::Boundary)),
            _ => (PointKind::Locked, None),
        };
        said.kinds.push(kind);
        said.lines.push(along.map_or([NONE; 2], |along| {
            let [a, b] = line[along as usize];
            [a.min(b), a.max(b)]
        }));
    }

    /// Whether the faces at `p`, which has no complex edge, hang together through shared edges.
    fn one_fan(&self, p: u32, spokes: &[Spoke], spoke_of: &[u32]) -> bool {
        let start = spokes.iter().find(|s| s.in_count == 0).unwrap_or(&spokes[0]).out_corner;
        let (mut corner, mut faces) = (start, 0);
        loop {
            faces += 1;
            let (f, k) = (corner / 3, corner % 3);
            let onward = self.face_points[f as usize][[2, 0, 1][k as usize]];
            corner = spokes[spoke_of[onward as usize] as usize].out_corner;
            if corner == NONE || corner == start {
                return faces == self.star(PointId(p)).len();
            }
        }
    }
}

/// Whether two corners of a face lie at one point.
#[inline]
pub fn is_degenerate(face: &[u32; 3]) -> bool {
    face[0] == face[1] || face[1] == face[2] || face[2] == face[0]
}

/// `(first [point_count + 1], corners)`: the corners of sound faces at each point, ascending.
fn corners_at_points(face_points: &[[u32; 3]], point_count: usize) -> (Vec<u32>, Vec<u32>) {
    let mut first = vec![0u32; point_count + 2];
    for face in face_points.iter().filter(|f| !is_degenerate(f)) {
        for p in face {
            first[*p as usize + 2] += 1;
        }
    }
    for i in 2..first.len() {
        first[i] += first[i - 1];
    }
    let mut corners = vec![0u32; first[point_count + 1] as usize];
    for (f, face) in face_points.iter().enumerate().filter(|(_, f)| !is_degenerate(f)) {
        for (k, p) in face.iter().enumerate() {
            let slot = &mut first[*p as usize + 1];
            corners[*slot as usize] = (3 * f + k) as u32;
            *slot += 1;
        }
    }
    first.pop();
    (first, corners)
}

/// Whether two wedges at one point differ in nothing but normal and tangent: bitwise equal UVs and colours.
pub(crate) fn same_chart(mesh: &Mesh, a: u32, b: u32) -> bool {
    fn equal<T: PartialEq>(values: &Option<Vec<T>>, a: u32, b: u32) -> bool {
        values.as_ref().is_none_or(|values| values[a as usize] == values[b as usize])
    }
    a == b
        || equal(&mesh.uv0, a, b)
            && equal(&mesh.uv1, a, b)
            && equal(&mesh.atlas_uv, a, b)
            && equal(&mesh.colors, a, b)
            && equal(&mesh.joints, a, b)
            && equal(&mesh.weights, a, b)
}

fn edge_kind(mesh: &Mesh, spoke: &Spoke) -> EdgeKind {
    match (spoke.out_count, spoke.in_count) {
        (1, 0) | (0, 1) => EdgeKind::Border,
        (1, 1) => {
            let wedge = |corner: u32| mesh.triangles[corner as usize / 3][corner as usize % 3];
            let (out, into) = (spoke.out_corner, spoke.in_corner);
            if mesh.face_submesh[out as usize / 3] != mesh.face_submesh[into as usize / 3] {
                EdgeKind::Boundary
            } else if wedge(out) == wedge(next(into)) && wedge(next(out)) == wedge(into) {
                EdgeKind::Manifold
            } else if !same_chart(mesh, wedge(out), wedge(next(into)))
                || !same_chart(mesh, wedge(next(out)), wedge(into))
            {
                EdgeKind::Seam
            } else {
                EdgeKind::Manifold
            }
        }
        _ => EdgeKind::Complex,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn a_closed_sphere_has_manifold_points_only() {
        let topology = Topology::new(&fixtures::sphere(8, 6));
        assert!(topology.kinds.iter().all(|k| *k == PointKind::Manifold));
        assert!((0..3 * topology.face_points.len() as u32).all(|corner| topology.twin(corner) != NONE));
    }

    #[test]
    fn twins_name_each_other_and_run_the_other_way() {
        let topology = Topology::new(&fixtures::grid(4, 3));
        let point = |c: u32| topology.face_points[c as usize / 3][c as usize % 3];
        for corner in 0..3 * topology.face_points.len() as u32 {
            let twin = topology.twin(corner);
            if twin != NONE {
                assert_eq!(topology.twin(twin), corner);
                assert_eq!((point(corner), point(next(corner))), (point(next(twin)), point(twin)));
            }
        }
    }

    #[test]
    fn an_open_grid_has_a_border_all_around() {
        let topology = Topology::new(&fixtures::grid(4, 3));
        assert_eq!(topology.kind_counts(), [3 * 2, 14, 0, 0, 0, 0]);
        for (p, kind) in topology.kinds.iter().enumerate() {
            assert_eq!(*kind == PointKind::Border, topology.lines[p] != [NONE; 2]);
        }
    }

    #[test]
    fn a_hard_cube_has_locked_corners_and_seams_along_its_edges() {
        // 3x3 quads a side: 8 corners, 12 edges of 2 inner points, 6 sides of 4 inner points.
        let topology = Topology::new(&fixtures::hard_cube(3));
        assert_eq!(topology.kind_counts(), [24, 0, 24, 0, 0, 8]);
    }

    #[test]
    fn two_joined_halves_have_boundary_points_between_them() {
        // Two 4x3 grids side by side: their 4 common points are two ends (where the border runs on) and two inner ones.
        let topology = Topology::new(&fixtures::merged_pair(4, 3));
        let counts = topology.kind_counts();
        assert_eq!(counts[PointKind::Boundary as usize], 2);
        assert_eq!(counts[PointKind::Locked as usize], 2);
        assert_eq!(counts[PointKind::Complex as usize], 0);
    }

    #[test]
    fn a_bow_tie_a_third_face_and_a_flipped_face_are_complex() {
        let bow_tie = fixtures::soup(&[[0, 1, 2], [0, 3, 4]]);
        assert_eq!(Topology::new(&bow_tie).kinds[0], PointKind::Complex);
        let book = fixtures::soup(&[[0, 1, 2], [1, 0, 3], [0, 1, 4]]);
        assert_eq!(Topology::new(&book).kinds[..2], [PointKind::Complex; 2]);
        assert_eq!(Topology::new(&book).edge_kinds[2][0], EdgeKind::Complex);
        let flipped = fixtures::soup(&[[0, 1, 2], [0, 1, 3]]);
        assert_eq!(Topology::new(&flipped).kinds[..2], [PointKind::Complex; 2]);
    }

    #[test]
    fn a_degenerate_face_pins_its_points() {
        let mesh = fixtures::soup(&[[0, 1, 2], [0, 0, 1]]);
        let topology = Topology::new(&mesh);
        assert_eq!(topology.kinds, [PointKind::Complex, PointKind::Complex, PointKind::Border]);
        assert_eq!(topology.star(PointId(0)).len(), 1);
    }

    #[test]
    fn a_seam_that_ends_within_the_surface_has_a_locked_tip() {
        // A slit of wedges along one edge chain from the border into a grid.
        let topology = Topology::new(&fixtures::slit_grid());
        assert_eq!(topology.kind_counts()[PointKind::Locked as usize], 2);
        assert_eq!(topology.kind_counts()[PointKind::Seam as usize], 1);
    }
}
