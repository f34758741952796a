//! Flips: an edge that bridges a valley, or cuts a ridge, gives way to the other diagonal of its two faces.
//!
//! A collapse order knows nothing of the faces that it leaves; now and then two of them are hinged across the shape instead of along
//! it, and no place of their corners mends that.
//! ```text
//! off(edge) <- the farthest that its places lie from the source, and that the samples on its two faces lie from these
//! m         <- mean square of all ties
//! for each edge inside a chart with off^2 > FAR * m, worst first:
//!     the other diagonal is no edge yet, has off < GAIN * off, no face turns or thins (in space and in UV), and every point keeps
//!     three neighbours: flip it
//! ```
//! A face takes part in one flip. Source: H. Hoppe et al., "Mesh optimization", SIGGRAPH 1993, doi:10.1145/166117.166119 (edge
//! swap).

use glam::{DVec2, DVec3, Vec2};
use kiln_asset::{PointId, RawMesh};
use kiln_geom::triangle::closest_point;

use super::back::{ByFace, SHARES};
use super::{Fit, Tie};
use crate::topology::{EdgeKind, NONE, PointKind, next, previous};

/// How far off an edge must be, in mean squares.
const FAR: f64 = 9.0;
/// What must be left at most.
const GAIN: f64 = 0.9;
/// Least `2 area / longest edge squared` of a new face, if the old ones were not thinner.
const THIN: f64 = 0.1;

/// Four points around an edge: (a, b, c) and (b, a, d) are its faces, (a, d, c) and (d, b, c) the flipped ones.
struct Quad {
    twin: u32,
    faces: [u32; 2],
    points: [u32; 4],
    vertices: [u32; 4],
}

impl Quad {
    fn old<T: Copy>([a, b, c, d]: [T; 4]) -> [[T; 3]; 2] {
        [[a, b, c], [b, a, d]]
    }

    fn flipped<T: Copy>([a, b, c, d]: [T; 4]) -> [[T; 3]; 2] {
        [[a, d, c], [d, b, c]]
    }
}

impl Fit<'_> {
    /// Flips what is better flipped, in `raw` and in the topology; `[face_count]`: whether a face was. `back`: ties of the edges to the
    /// source.
    pub(super) fn flip(
        &mut self,
        raw: &mut RawMesh,
        at: &[DVec3],
        [ties, back]: [&[Tie]; 2],
        samples: &ByFace,
        loose: impl Fn(u32) -> bool,
    ) -> Vec<bool> {
        let square = |tie: &Tie| {
            let on: DVec3 = (0..3).map(|k| at[tie.points[k] as usize] * tie.bary[k]).sum();
            (tie.along - tie.direction.dot(on)).powi(2)
        };
        let mut sum = [0.0; 2];
        for tie in ties.iter().chain(back) {
            sum[0] += tie.weight * square(tie);
            sum[1] += tie.weight;
        }
        let far = FAR * sum[0] / sum[1];
        // By edge, the lower of its half-edges' corners.
        let mut edges: Vec<(f64, u32)> = Vec::new();
        for tie in back.iter().filter(|tie| square(tie) > far) {
            let k = if tie.bary[2] == 0.0 { 0 } else { if tie.bary[0] == 0.0 { 1 } else { 2 } };
            edges.push((square(tie), 3 * tie.face + k));
        }
        edges.sort_unstable_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        let mut touched = vec![false; raw.triangles.len()];
        let mut new_ends = vec![false; at.len()];
        let mut lost = vec![0_u32; at.len()];
        for (_, corner) in edges {
            if touched[corner as usize / 3] {
                continue;
            }
            let Some(quad) = self.quad(raw, corner) else { continue };
            let [a, b, c, d] = quad.points;
            if touched[quad.faces[1] as usize]
                || !quad.points.iter().any(|p| loose(*p))
                || (new_ends[c as usize] && new_ends[d as usize])
                || [a, b].iter().any(|p| !self.may_lose(*p, lost[*p as usize]))
                || self.joined(c, d)
                || !keeps_shape(&quad, raw, at)
            {
                continue;
            }
            let places = quad.points.map(|p| at[p as usize]);
            let now = self.off(&quad, [places[0], places[1]], Quad::old(places), samples);
            let then = self.off(&quad, [places[2], places[3]], Quad::flipped(places), samples);
            if then >= GAIN * GAIN * now {
                continue;
            }
            let [first, second] = Quad::flipped(quad.vertices);
            (raw.triangles[quad.faces[0] as usize], raw.triangles[quad.faces[1] as usize]) = (first, second);
            self.topology.flip(corner, quad.twin);
            quad.faces.iter().for_each(|f| touched[*f as usize] = true);
            [c, d].iter().for_each(|p| new_ends[*p as usize] = true);
            [a, b].iter().for_each(|p| lost[*p as usize] += 1);
        }
        if touched.contains(&true) {
            self.topology.sort_corners();
        }
        touched
    }

    /// The square of the farthest that a diagonal and two faces lie from the source.
    fn off(&self, quad: &Quad, [a, b]: [DVec3; 2], faces: [[DVec3; 3]; 2], samples: &ByFace) -> f64 {
        let edge =
            SHARES.map(|share| self.on_source(a.lerp(b, share), quad.faces, samples).map_or(0.0, |on| on.square));
        let sample = |v: &u32| {
            let x = self.place_of_sample(*v);
            faces.iter().map(|[p, q, r]| closest_point(x, *p, *q, *r).distance_squared).fold(f64::INFINITY, f64::min)
        };
        quad.faces.iter().flat_map(|f| samples.on(*f)).map(sample).chain(edge).fold(0.0, f64::max)
    }

    /// The faces at `corner`'s edge, if it lies inside a chart.
    fn quad(&self, raw: &RawMesh, corner: u32) -> Option<Quad> {
        let at = |c: u32| (c as usize / 3, c as usize % 3);
        let (f, k) = at(corner);
        let twin = self.topology.twin(corner);
        if twin == NONE || self.topology.edge_kinds[f][k] != EdgeKind::Manifold {
            return None;
        }
        let point = |c: u32| self.topology.face_points[at(c).0][at(c).1];
        let vertex = |c: u32| raw.triangles[at(c).0][at(c).1];
        // The stars are those before this pass.
        if point(next(twin)) != point(corner) || point(twin) != point(next(corner)) {
            return None;
        }
        // A crease stays.
        if vertex(corner) != vertex(next(twin)) || vertex(next(corner)) != vertex(twin) {
            return None;
        }
        let around = [corner, next(corner), previous(corner), previous(twin)];
        Some(Quad { twin, faces: [corner / 3, twin / 3], points: around.map(point), vertices: around.map(vertex) })
    }

    /// Whether a point that has lost so many neighbours can lose another.
    fn may_lose(&self, p: u32, lost: u32) -> bool {
        let faces = self.topology.first[p as usize + 1] - self.topology.first[p as usize];
        let least = if self.topology.kinds[p as usize] == PointKind::Manifold { 3 } else { 1 };
        faces.saturating_sub(lost) > least
    }

    /// Whether two points have an edge.
    fn joined(&self, c: u32, d: u32) -> bool {
        let (of_c, of_d) = (self.topology.star(PointId(c)), self.topology.star(PointId(d)));
        let (fewer, other) = if of_c.len() <= of_d.len() { (of_c, d) } else { (of_d, c) };
        fewer.iter().any(|corner| self.topology.face_points[*corner as usize / 3].contains(&other))
    }
}

/// Whether the flipped faces look the way of the old ones, are no slivers, and keep their hand in every UV set.
fn keeps_shape(quad: &Quad, raw: &RawMesh, at: &[DVec3]) -> bool {
    let places = quad.points.map(|p| at[p as usize]);
    let normal = |[p, q, r]: [DVec3; 3]| (q - p).cross(r - p);
    let fatness = |face: [DVec3; 3]| {
        let [p, q, r] = face;
        let longest = p.distance_squared(q).max(q.distance_squared(r)).max(r.distance_squared(p));
        if longest > 0.0 { normal(face).length() / longest } else { 0.0 }
    };
    let old = Quad::old(places);
    let way: DVec3 = old.iter().map(|face| normal(*face).normalize_or_zero()).sum();
    let thinnest = old.iter().map(|face| fatness(*face)).fold(THIN, f64::min);
    let sound = |face: [DVec3; 3]| normal(face).normalize_or_zero().dot(way) > 0.2 && fatness(face) >= thinnest;
    if !Quad::flipped(places).into_iter().all(sound) {
        return false;
    }
    let keeps_hand = |uv: &Vec<Vec2>| {
        let corners = quad.vertices.map(|v| uv[v as usize].as_dvec2());
        let area = |[p, q, r]: [DVec2; 3]| (q - p).perp_dot(r - p);
        let (old, new) = (Quad::old(corners).map(area), Quad::flipped(corners).map(area));
        old == [0.0; 2] || new.iter().all(|new| old.iter().all(|old| new * old > 0.0))
    };
    [&raw.uv0, &raw.uv1, &raw.atlas_uv].into_iter().flatten().all(keeps_hand)
}

#[cfg(test)]
mod tests {
    use kiln_asset::Mesh;

    use super::super::{Chosen, Samples};
    use super::*;
    use crate::fixtures;
    use crate::topology::Topology;

    /// A strip `field` over `[0, 64] x [0, 8]` as eight squares of two faces, parted from (8, 0) to (0, 8) and so on: what becomes of
    /// their faces.
    fn flipped(field: impl Fn(f32, f32) -> f32) -> [Vec<[u32; 3]>; 2] {
        let source = fixtures::field(64, 8, &field);
        let topology = Topology::new(&source);
        let samples = Samples::new(&source, &topology);
        let mut raw = fixtures::grid(8, 1).into_raw();
        raw.positions.iter_mut().for_each(|p| *p = (8.0 * p.truncate()).extend(field(8.0 * p.x, 8.0 * p.y)));
        let level = Mesh::new(raw.clone()).expect("sound");
        let nearest = |v: usize| {
            let off = |c: &u32| source.positions[v].truncate().distance(raw.positions[*c as usize].truncate());
            (0..18).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap()
        };
        let heirs: Vec<u32> = (0..source.vertex_count()).map(nearest).collect();
        let point_of: Vec<u32> = level.points.iter().map(|p| p.0).collect();
        let chosen = Chosen::new(&source, &samples, &heirs, 16);
        let at: Vec<DVec3> = level.positions.iter().map(|p| p.as_dvec3()).collect();
        let mut fit = Fit {
            source: &source,
            samples: &samples,
            heirs: &heirs,
            topology: Topology::new(&level),
            point_of: &point_of,
            chosen,
        };
        let ties = fit.ties(&at);
        let by_face = ByFace::new(&ties, 16);
        let back = fit.ties_back(&at, &by_face, |_| true);
        let flipped = fit.flip(&mut raw, &at, [&ties, &back], &by_face, |_| true);
        assert_eq!(flipped.contains(&true), raw.triangles != level.triangles);
        assert_eq!(fit.topology.face_points, raw.triangles);
        [level.triangles.clone(), raw.triangles]
    }

    #[test]
    fn the_diagonal_across_a_roof_gives_way_to_the_one_along_it() {
        // A ridge from (0, 0) to (8, 8), then the same slope for ever.
        let roof = |x: f32, y: f32| -(x.min(8.0) - y).abs() * 0.3;
        let [before, after] = flipped(roof);
        assert!(after[..2].iter().all(|t| t.contains(&0) && t.contains(&10)), "{after:?}");
        assert_eq!(before[2..], after[2..]);
    }

    #[test]
    fn what_lies_along_or_flat_is_left_alone() {
        for valley in [|x: f32, y: f32| -(x.min(8.0) + y - 8.0).abs() * 0.3, |_, _| 0.0] {
            let [before, after] = flipped(valley);
            assert_eq!(before, after);
        }
    }

    #[test]
    fn a_flipped_edge_leaves_the_topology_that_the_flipped_faces_have() {
        let mesh = fixtures::grid(4, 3);
        let mut tried = 0;
        for corner in 0..3 * mesh.face_count() as u32 {
            let mut topology = Topology::new(&mesh);
            let twin = topology.twin(corner);
            if twin == NONE {
                continue;
            }
            topology.flip(corner, twin);
            topology.sort_corners();
            let mut raw = mesh.clone().into_raw();
            raw.triangles.clone_from(&topology.face_points);
            let fresh = Topology::new(&Mesh::new(raw).expect("sound"));
            assert_eq!(topology.edge_kinds, fresh.edge_kinds);
            assert_eq!((topology.first, topology.corners), (fresh.first, fresh.corners));
            tried += 1;
        }
        assert!(tried > 20);
    }
}
