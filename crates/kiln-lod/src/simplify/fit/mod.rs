//! Fit: free placement. After a cut, points and attributes of the level go to where the level lies nearest to its source.
//!
//! **Problem.** A half-edge level stands on points of its source with all its faces inside, one with points where their forms are
//! least has them outside: either way the error has one sign. The best level cuts through its source, half of it on each
//! side. And an attribute that was taken at one old place is wrong over the faces that its vertex carries now.
//!
//! **Method.** The log knows for each vertex of the source which vertex of the level it went to, its *heir*; so its place on
//! the level is a short walk away from its heir, without a search. Then least squares:
//! ```text
//! p_i <- least of its form, if that is near
//! ROUNDS times:
//!     sample: a vertex x of the source, weighted by w, a third of its faces' area
//!     place(sample) <- nearest point on the level: face, barycentrics b, direction n of the way there
//!     SWEEPS times, for all points i at once:
//!         A_i <- sum of w b_i n n' + FORM * matrix of its form
//!         r_i <- sum of w b_i n (n . (x - place)) - FORM * half the gradient of its form
//!         p_i <- p_i + (A_i + HOLD trace A_i)^-1 r_i
//!     points of faces that turned go back
//!     in the last round the level looks back, too: middles of its edges pull towards the source (back), and edges for which no
//!     place helps flip (flips)
//! attributes: the same with n n' replaced by 1, so that b interpolates at each sample what the source has there
//! ```
//! Since the b_i of a place sum to 1, the `A_i` bound the true normal matrix from above: no sweep makes the sum of squares
//! larger. The form keeps edges of the shape sharp and speaks where samples are few; along the surface nothing pulls. Samples of
//! borders, seams and boundaries pull across these lines' edges only, so lines keep course and length. The order of collapses hardly
//! depends on places, so a metric's log may stay free of them, and one log serves both placements; where a metric logged places, the
//! fit starts from those.
//!
//! Points that took in none stay, bit for bit, and so do junctions of submeshes, and seams of a mesh with an atlas: levels share its
//! maps. A place for an attribute is sought only on faces that hang together by vertices, so nothing is read across a seam.
//!
//! **Departures.** Garland and Heckbert solve for the least of the form at every collapse. Hoppe finds places by a search and
//! alternates with changes of connectivity; here the log gives them, and of connectivity only some diagonals change.
//!
//! **Limits.** The greatest distance is not what is minimised: where a valley has too few points left, no place of theirs and no flip
//! brings an edge down into it.
//!
//! **Sources.** H. Hoppe et al., "Mesh optimization", SIGGRAPH 1993, doi:10.1145/166117.166119. M. Garland, P. Heckbert,
//! SIGGRAPH 1997, doi:10.1145/258734.258849. The use of the log is ours.

mod attributes;
mod back;
mod flips;
mod stars;

use glam::{DMat3, DVec3, Vec3};
use kiln_asset::{Mesh, RawMesh};
use rayon::prelude::*;

use back::ByFace;
use stars::{Place, Stars, frames};

use super::metric::quadric::Quadric;
use super::sequence::Replayed;
use crate::topology::{EdgeKind, NONE, PointKind, Topology};

/// How often samples look for their place anew; six rounds gain 1 % over two.
const ROUNDS: usize = 2;
/// Sweeps between.
const SWEEPS: usize = 3;
/// What the form counts beside the samples. Mean distance on bunny, armadillo, FlightHelmet at a tenth with 0, 0.3 and 1:
/// 16.1, 21.8, 24.7; 15.6, 21.6, 20.4; 16.4, 23.3, 21.0.
const FORM: f64 = 0.3;
/// Share of a point's matrix that holds it where nothing else does.
const HOLD: f64 = 1e-5;
/// What a sample on a line counts, by the square of half its edges. The bunny's border at a hundredth keeps 0.925 of its length
/// with 1 and 0.938 with 8.
const LINE: f64 = 8.0;
/// Where the source has fewer faces than this many a face of the level, the middles of its faces are samples, too: with a quarter of
/// the weight on the corners the sums are then exact for squares.
const SCARCE: usize = 8;
/// The farthest that a point may go, in its shortest edges.
const REACH: f64 = 0.5;
/// A sample whose place lies on the rim of all faces that the walk saw belongs elsewhere if it is farther than this many mean
/// squares.
const STRAY: f64 = 9.0;

/// What a mesh says to all levels that are cut from it, by vertex.
pub(super) struct Samples<'a> {
    topology: &'a Topology,
    /// `[point_count]`.
    at: Vec<DVec3>,
    /// A third of the area of its faces.
    area: Vec<f64>,
    /// [`LINE`] times the square of half the length of the border, seam and boundary edges at it; 0 inside.
    line: Vec<f64>,
}

impl<'a> Samples<'a> {
    pub(super) fn new(mesh: &Mesh, topology: &'a Topology) -> Samples<'a> {
        let mut area = vec![0.0; mesh.vertex_count()];
        let mut line = vec![0.0; mesh.vertex_count()];
        let mut at = vec![DVec3::ZERO; mesh.point_count()];
        for (position, p) in mesh.positions.iter().zip(&mesh.points).rev() {
            at[p.index()] = position.as_dvec3();
        }
        for (triangle, kinds) in mesh.triangles.iter().zip(&topology.edge_kinds) {
            let corners = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
            let third = (corners[1] - corners[0]).cross(corners[2] - corners[0]).length() / 6.0;
            for (k, v) in triangle.iter().enumerate() {
                area[*v as usize] += third;
                if !matches!(kinds[k], EdgeKind::Manifold | EdgeKind::Complex) {
                    let next = (k + 1) % 3;
                    let half = 0.5 * corners[k].distance(corners[next]);
                    line[*v as usize] += half;
                    line[triangle[next] as usize] += half;
                }
            }
        }
        line.iter_mut().for_each(|length| *length = LINE * length.powi(2));
        Samples { topology, at, area, line }
    }
}

/// The level of `cut` with its points and attributes fitted to `source`. `forms`: `[point_count]` of the level, each about its point's
/// place; `None` where nothing fell to the point, and it stays. `turn_cosine`: of the most that a face may turn.
pub(super) fn fit(
    source: &Mesh,
    samples: &Samples<'_>,
    cut: Replayed,
    forms: &[Option<Quadric>],
    turn_cosine: f64,
) -> Mesh {
    let Replayed { level, heirs, places, .. } = cut;
    let topology = Topology::new(&level);
    let shared_maps = level.atlas_uv.is_some();
    let mut submesh = vec![None; forms.len()];
    let mut joint = vec![false; forms.len()];
    for (points, own) in topology.face_points.iter().zip(&level.face_submesh) {
        for p in points {
            joint[*p as usize] |= submesh[*p as usize].replace(*own).is_some_and(|other| other != *own);
        }
    }
    let may_move = |p: usize| match topology.kinds[p] {
        PointKind::Complex => false,
        PointKind::Seam => !shared_maps,
        PointKind::Locked => !shared_maps && !joint[p],
        _ => true,
    };
    let forms: Vec<Option<Quadric>> = forms.iter().enumerate().map(|(p, form)| form.filter(|_| may_move(p))).collect();
    let point_of: Vec<u32> = level.points.iter().map(|p| p.0).collect();
    let mut raw = level.into_raw();
    let chosen = Chosen::new(source, samples, &heirs, raw.triangles.len());
    let mut fit = Fit { source, samples, heirs: &heirs, topology, point_of: &point_of, chosen };
    let at = fit.positions(&mut raw, &forms, &places, turn_cosine);
    for (position, p) in raw.positions.iter_mut().zip(&point_of) {
        if let Some(at) = at[*p as usize] {
            *position = at;
        }
    }
    fit.attributes(&mut raw, &forms);
    Mesh::new(raw).expect("invariant: the same indices, finite attributes")
}

struct Fit<'a> {
    source: &'a Mesh,
    samples: &'a Samples<'a>,
    heirs: &'a [u32],
    topology: Topology,
    /// Of the level's vertices.
    point_of: &'a [u32],
    chosen: Chosen,
}

/// The samples: a vertex of the source by its number, the middle of a face by its number after those.
struct Chosen {
    /// Those that have an heir, and what each counts.
    samples: Vec<u32>,
    weights: Vec<f64>,
    /// How many of them are vertices.
    vertices: usize,
}

impl Chosen {
    fn new(source: &Mesh, samples: &Samples<'_>, heirs: &[u32], faces: usize) -> Chosen {
        let has_heir = |v: &u32| heirs[*v as usize] != NONE && samples.area[*v as usize] > 0.0;
        let mut chosen: Vec<u32> = (0..heirs.len() as u32).filter(has_heir).collect();
        let mut weights: Vec<f64> = chosen.iter().map(|v| samples.area[*v as usize]).collect();
        let vertices = chosen.len();
        if source.face_count() < SCARCE * faces {
            weights.iter_mut().for_each(|w| *w *= 0.25);
            for (f, triangle) in source.triangles.iter().enumerate() {
                let [a, b, c] = triangle.map(|v| source.positions[v as usize].as_dvec3());
                let area = (b - a).cross(c - a).length() / 2.0;
                if area > 0.0 && heirs[triangle[0] as usize] != NONE {
                    chosen.push((heirs.len() + f) as u32);
                    weights.push(0.75 * area);
                }
            }
        }
        Chosen { samples: chosen, weights, vertices }
    }
}

/// A sample as the sweeps want it.
#[derive(Clone, Copy)]
struct Tie {
    /// The source's vertex or face (as in [`Chosen`]); [`NONE`] for a place on an edge that looks back.
    sample: u32,
    /// The level's face that it lies on.
    face: u32,
    points: [u32; 3],
    bary: [f64; 3],
    direction: DVec3,
    /// `direction . x`.
    along: f64,
    weight: f64,
}

impl Fit<'_> {
    fn place_of_sample(&self, sample: u32) -> DVec3 {
        match self.source.positions.get(sample as usize) {
            Some(position) => position.as_dvec3(),
            None => {
                let corners = self.source.triangles[sample as usize - self.source.positions.len()];
                corners.iter().map(|v| self.source.positions[*v as usize].as_dvec3()).sum::<DVec3>() / 3.0
            }
        }
    }

    /// A vertex of the source at or beside a sample.
    fn vertex_at(&self, sample: u32) -> u32 {
        let count = self.source.positions.len();
        if (sample as usize) < count { sample } else { self.source.triangles[sample as usize - count][0] }
    }

    /// `[point_count]`: the new place of each point that moves.
    fn positions(
        &mut self,
        raw: &mut RawMesh,
        forms: &[Option<Quadric>],
        places: &[Option<Vec3>],
        turn_cosine: f64,
    ) -> Vec<Option<Vec3>> {
        // What the forms are about.
        let mut home = vec![DVec3::ZERO; forms.len()];
        for (v, p) in self.point_of.iter().enumerate().rev() {
            home[*p as usize] = raw.positions[v].as_dvec3();
        }
        let mut start = home.clone();
        for (p, place) in places.iter().enumerate() {
            if let (Some(place), Some(_)) = (place, &forms[p]) {
                start[p] = place.as_dvec3();
            }
        }
        let reach: Vec<f64> =
            shortest_edges(&self.topology.face_points, &start).iter().map(|edge| edge * REACH).collect();
        let mut at = start.clone();
        for (p, form) in forms.iter().enumerate().filter(|_| places.is_empty()) {
            let least = form.and_then(|form| form.least(form.weight * HOLD));
            if let Some(step) = least.filter(|step| step.length_squared() <= 4.0 * reach[p] * reach[p]) {
                at[p] += step;
            }
        }
        undo_turned(&self.topology.face_points, &start, &mut at, turn_cosine);
        let middle = at.clone();

        let mut pulls = vec![Pull::default(); at.len()];
        for round in 0..ROUNDS {
            let mut ties = self.ties(&at);
            if round + 1 == ROUNDS {
                self.look_back(raw, &at, &mut ties, |p| forms[p as usize].is_some());
            }
            for _ in 0..SWEEPS {
                pulls.fill(Pull::default());
                for tie in &ties {
                    let on: DVec3 = (0..3).map(|k| at[tie.points[k] as usize] * tie.bary[k]).sum();
                    let left = tie.along - tie.direction.dot(on);
                    for k in 0..3 {
                        if tie.bary[k] > 0.0 {
                            pulls[tie.points[k] as usize].add(tie.direction, tie.weight * tie.bary[k], left);
                        }
                    }
                }
                self.pull_lines(&at, &mut pulls);
                for (p, form) in forms.iter().enumerate() {
                    if let Some(step) = form.and_then(|form| pulls[p].with(&form, at[p] - home[p]).step()) {
                        at[p] = middle[p] + (at[p] + step - middle[p]).clamp_length_max(reach[p]);
                    }
                }
            }
            undo_turned(&self.topology.face_points, &start, &mut at, turn_cosine);
        }
        // As they will be stored.
        let rounded =
            |(at, home): (&DVec3, &DVec3)| (at != home).then(|| at.as_vec3()).filter(|place| place.is_finite());
        at.iter().zip(&home).map(rounded).collect()
    }

    /// The samples at their places on the level.
    fn ties(&self, at: &[DVec3]) -> Vec<Tie> {
        let frames = frames(&self.topology.face_points, at);
        let stars = Stars::of_points(&self.topology, &frames);
        let find = |(sample, weight): (&u32, &f64)| {
            let x = self.place_of_sample(*sample);
            let heir = self.heirs[self.vertex_at(*sample) as usize];
            let place = stars.nearest(at, self.point_of[heir as usize], x);
            (place.face != NONE).then(|| (self.tie(*sample, *weight, &place, at), place.distance))
        };
        let found: Vec<Option<(Tie, f64)>> =
            (self.chosen.samples.par_iter().zip(&self.chosen.weights)).map(find).collect();
        let mut sum = [0.0; 2];
        for (tie, distance) in found.iter().flatten() {
            sum[0] += tie.weight * distance;
            sum[1] += tie.weight;
        }
        let limit = STRAY * sum[0] / sum[1];
        let is_near = |(tie, distance): &(Tie, f64)| *distance <= limit || tie.bary.iter().all(|b| *b > 0.0);
        found.into_iter().flatten().filter(is_near).map(|(tie, _)| tie).collect()
    }

    /// The tie of a sample to its place.
    fn tie(&self, sample: u32, weight: f64, place: &Place, at: &[DVec3]) -> Tie {
        let x = self.place_of_sample(sample);
        let points = self.topology.face_points[place.face as usize];
        let [a, b, c] = points.map(|p| at[p as usize]);
        let bary = place.bary.map(f64::from);
        let mut direction = (b - a).cross(c - a).normalize_or_zero();
        if bary.iter().any(|b| *b <= 0.0) {
            direction = (x - (a * bary[0] + b * bary[1] + c * bary[2])).normalize_or(direction);
        }
        Tie { sample, face: place.face, points, bary, direction, along: direction.dot(x), weight }
    }

    /// Adds the ties of the level's edges to the source, and flips edges for which no place helps.
    fn look_back(&mut self, raw: &mut RawMesh, at: &[DVec3], ties: &mut Vec<Tie>, loose: impl Fn(u32) -> bool) {
        let samples = ByFace::new(ties, raw.triangles.len());
        let mut back = self.ties_back(at, &samples, |_| true);
        let flipped = self.flip(raw, at, [ties, &back], &samples, loose);
        if flipped.contains(&true) {
            for tie in ties.iter_mut().filter(|tie| flipped[tie.face as usize]) {
                self.tie_anew(tie, at);
            }
            back.retain(|tie| !flipped[tie.face as usize]);
            back.extend(self.ties_back(at, &samples, |f| flipped[f as usize]));
        }
        ties.append(&mut back);
    }

    /// Finds the place of a tie on faces that were flipped.
    fn tie_anew(&self, tie: &mut Tie, at: &[DVec3]) {
        let x = self.place_of_sample(tie.sample);
        let mut best = Place { face: NONE, bary: [0.0; 3], distance: f64::INFINITY };
        for p in tie.points {
            best = Stars::of_points(&self.topology, &[]).around(at, p, x, best);
        }
        if best.face != NONE {
            *tie = self.tie(tie.sample, tie.weight, &best, at);
        }
    }

    /// Samples on lines pull the nearer of the line's edges at their heir towards them, across it.
    fn pull_lines(&self, at: &[DVec3], pulls: &mut [Pull]) {
        for v in &self.chosen.samples[..self.chosen.vertices] {
            let weight = self.samples.line[*v as usize];
            let p = self.point_of[self.heirs[*v as usize] as usize];
            let line = self.topology.lines[p as usize];
            if weight <= 0.0 || line == [NONE; 2] {
                continue;
            }
            let (x, a) = (self.place_of_sample(*v), at[p as usize]);
            let mut best: Option<(f64, u32, f64)> = None;
            for q in line {
                let along = at[q as usize] - a;
                let square = along.length_squared();
                let t = if square > 0.0 { ((x - a).dot(along) / square).clamp(0.0, 1.0) } else { 0.0 };
                let distance = (a + along * t).distance_squared(x);
                if best.is_none_or(|best| distance < best.0) {
                    best = Some((distance, q, t));
                }
            }
            let Some((_, q, t)) = best else { continue };
            let Some(along) = (at[q as usize] - a).try_normalize() else { continue };
            let left = x - a.lerp(at[q as usize], t);
            for n in <[DVec3; 2]>::from(along.any_orthonormal_pair()) {
                pulls[p as usize].add(n, weight * (1.0 - t), n.dot(left));
                pulls[q as usize].add(n, weight * t, n.dot(left));
            }
        }
    }
}

/// A symmetric matrix and a vector, summed over the samples around a point.
#[derive(Clone, Copy, Default)]
struct Pull {
    /// xx, xy, xz, yy, yz, zz.
    matrix: [f64; 6],
    to: DVec3,
}

impl Pull {
    /// A pull of `amount` along `n`.
    #[inline]
    fn add(&mut self, n: DVec3, weight: f64, amount: f64) {
        let m = n * weight;
        let products = [m.x * n.x, m.x * n.y, m.x * n.z, m.y * n.y, m.y * n.z, m.z * n.z];
        for (sum, product) in self.matrix.iter_mut().zip(products) {
            *sum += product;
        }
        self.to += m * amount;
    }

    /// With the form's share, `d` away from the form's origin.
    fn with(mut self, form: &Quadric, d: DVec3) -> Pull {
        let (matrix, to) = form.pull(d);
        for (sum, own) in self.matrix.iter_mut().zip(matrix) {
            *sum += FORM * own;
        }
        self.to += to * FORM;
        self
    }

    fn step(&self) -> Option<DVec3> {
        let [xx, xy, xz, yy, yz, zz] = self.matrix;
        let hold = HOLD * (xx + yy + zz);
        if hold <= 0.0 {
            return None;
        }
        let matrix = DMat3::from_cols(
            DVec3::new(xx + hold, xy, xz),
            DVec3::new(xy, yy + hold, yz),
            DVec3::new(xz, yz, zz + hold),
        );
        Some(matrix.inverse() * self.to).filter(|step| step.is_finite())
    }
}

/// `[point_count]`: the shortest edge at each point; 0 without one.
fn shortest_edges(faces: &[[u32; 3]], at: &[DVec3]) -> Vec<f64> {
    let mut shortest = vec![f64::INFINITY; at.len()];
    for face in faces {
        for k in 0..3 {
            let ends = [face[k] as usize, face[(k + 1) % 3] as usize];
            let length = at[ends[0]].distance(at[ends[1]]);
            for p in ends {
                shortest[p] = shortest[p].min(length);
            }
        }
    }
    shortest.iter_mut().filter(|edge| !edge.is_finite()).for_each(|edge| *edge = 0.0);
    shortest
}

/// Puts the points of faces that turned, or vanish, back to `start`, until none is left.
fn undo_turned(faces: &[[u32; 3]], start: &[DVec3], at: &mut [DVec3], turn_cosine: f64) {
    let normal = |face: &[u32; 3], at: &[DVec3]| {
        // As they will be stored.
        let [a, b, c] = face.map(|p| at[p as usize].as_vec3().as_dvec3());
        (b - a).cross(c - a)
    };
    loop {
        let mut back: Vec<u32> = Vec::new();
        for face in faces {
            if face.iter().all(|p| at[*p as usize] == start[*p as usize]) {
                continue;
            }
            let (before, after) = (normal(face, start), normal(face, at));
            if before.dot(after) <= turn_cosine * (before.length_squared() * after.length_squared()).sqrt() {
                back.extend(face);
            }
        }
        if back.is_empty() {
            return;
        }
        for p in back {
            at[p as usize] = start[p as usize];
        }
    }
}
