//! The memoryless metric (Lindstrom and Turk): volume and border of the mesh as it is now, and no memory of the source.
//!
//! **Method.** A collapse replaces the faces at both ends by faces around a new place `v`. With `n` the cross product of a face's
//! edges and `p` a corner of it, `n.(v - p)` is six times the volume between the face and `v`:
//! ```text
//! volume preserved     sum n.(v - p) = 0
//! volume optimised     sum (n.(v - p))^2 least                    cost, square volume
//! border optimised     sum |e x (v - p)|^2 least over border edges   times the square length of the edge, the same unit
//! shape optimised      sum |v - q|^2 least over the points q around, where the rest says nothing
//! ```
//! solved together: the least of the sum of the last three under the first as a constraint. Points on a border meet its term only,
//! so it keeps its course and its area. Where the table of kinds lets a point go to a line or a junction, `v` is that point.
//!
//! **Departures.** Lindstrom and Turk add their constraints one after the other, each as far as those before leave it free; one
//! weighted system is as good where all are well conditioned and needs no thresholds. Costs are brought up to date when they come to the
//! front of the queue (a lazy queue), so a cost that fell waits until then.
//!
//! **Limits.** A place is judged by the mesh, not by the source, so errors can add up unseen where many collapses follow each
//! other; the fit after the cut takes back most of it.
//!
//! **Sources.** P. Lindstrom, G. Turk, "Fast and memory efficient polygonal simplification", IEEE Visualization 1998,
//! doi:10.1109/VISUAL.1998.745314, and "Evaluation of memoryless simplification", TVCG 1999, doi:10.1109/2945.773803.

use glam::DVec3;
use kiln_asset::Mesh;

use super::Metric;
use crate::simplify::rest::MetricRest;
use crate::simplify::working::{Names, Working};
use crate::topology::{NONE, PointKind};

/// Share of the shape term: decides flat places and no others.
const SHAPE: f64 = 1e-5;
/// What the border term counts beside the volume term.
const BORDER: f64 = 72.0;
/// Faces at a point above which they are sorted to be found.
const HUB: usize = 16;
/// Brings costs by the diagonal^6 into the middle of what single precision holds.
const UNIT: f64 = 1e18;

/// The metric between rounds.
pub(in crate::simplify) struct MemorylessRest {
    scale: f64,
    unit: f32,
    /// `[point_count]`.
    errors: Vec<f32>,
}

/// The metric of a part.
pub(in crate::simplify) struct Memoryless {
    /// [`UNIT`] / diagonal^6.
    scale: f64,
    /// What brings a cost to the unit of the quadric metric.
    unit: f32,
    /// `[point_count]`.
    stars: Vec<Star>,
    /// `[point_count]`: how far the mesh at the point may be off its source, object units.
    errors: Vec<f32>,
}

/// The sums over the faces at a point, places relative to it: all planes go through it, so nothing linear is left.
#[derive(Clone, Copy, Default)]
struct Star {
    /// Of `n n'`: xx, xy, xz, yy, yz, zz.
    matrix: [f64; 6],
    /// Of `n`.
    normal: DVec3,
    /// Of the points that follow it in its faces, and how many these are.
    around: DVec3,
    count: f64,
}

impl Star {
    fn of(work: &Working<'_>, p: u32) -> Star {
        let origin = work.points[p as usize].position;
        let mut star = Star::default();
        for corner in work.corners(p) {
            let [a, b] = work.others(*corner).map(|q| (work.points[q as usize].position - origin).as_dvec3());
            let n = a.cross(b);
            add_square(&mut star.matrix, n, 1.0);
            star.normal += n;
            star.around += a;
            star.count += 1.0;
        }
        star
    }
}

#[inline]
fn add_square(matrix: &mut [f64; 6], n: DVec3, weight: f64) {
    let m = n * weight;
    let products = [m.x * n.x, m.x * n.y, m.x * n.z, m.y * n.y, m.y * n.z, m.z * n.z];
    for (sum, product) in matrix.iter_mut().zip(products) {
        *sum += product;
    }
}

#[inline]
fn times([xx, xy, xz, yy, yz, zz]: &[f64; 6], v: DVec3) -> DVec3 {
    DVec3::new(xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z, xz * v.x + yz * v.y + zz * v.z)
}

/// The terms of an edge, places relative to the point that goes.
struct System {
    /// Volume and border terms: matrix, half gradient, value at 0.
    matrix: [f64; 6],
    slope: DVec3,
    at_zero: f64,
    /// `normal . v = volume` preserves the volume.
    normal: DVec3,
    volume: f64,
    /// Sum of square normals.
    square: f64,
    /// The points around.
    around: DVec3,
    count: f64,
}

impl System {
    /// Both stars, the second `stays` away; faces on the edge count once.
    fn of(goes: &Star, at_stay: &Star, stays: DVec3) -> System {
        let mut matrix = goes.matrix;
        matrix.iter_mut().zip(at_stay.matrix).for_each(|(sum, own)| *sum += own);
        let slope = times(&at_stay.matrix, stays);
        System {
            matrix,
            slope,
            at_zero: slope.dot(stays),
            normal: goes.normal + at_stay.normal,
            volume: at_stay.normal.dot(stays),
            square: 0.0,
            around: goes.around + at_stay.around + stays * at_stay.count,
            count: goes.count + at_stay.count,
        }
    }

    /// Takes out a face on the edge, which both stars had; its plane goes through both ends.
    fn drop_face(&mut self, n: DVec3) {
        add_square(&mut self.matrix, n, -1.0);
        self.normal -= n;
    }

    /// A border edge: the square area that `v` spans with it.
    fn add_border(&mut self, a: DVec3, b: DVec3, weight: f64) {
        let Some(along) = (b - a).try_normalize() else { return };
        for n in <[DVec3; 2]>::from(along.any_orthonormal_pair()) {
            let (weight, offset) = (weight * (b - a).length_squared(), n.dot(a));
            add_square(&mut self.matrix, n, weight);
            self.slope += n * (weight * offset);
            self.at_zero += weight * offset * offset;
        }
    }

    fn cost(&self, v: DVec3) -> f64 {
        ((times(&self.matrix, v) - self.slope * 2.0).dot(v) + self.at_zero).max(0.0)
    }

    /// The best place; `None` where the faces have no area.
    fn solve(&self) -> Option<DVec3> {
        let [xx, xy, xz, yy, yz, zz] = self.matrix;
        let hold = SHAPE * (xx + yy + zz) / self.count.max(1.0);
        if hold.is_nan() || hold <= 0.0 {
            return None;
        }
        let more = hold * self.count;
        let adjugate = adjugate(&[xx + more, xy, xz, yy + more, yz, zz + more]);
        let determinant = (xx + more) * adjugate[0] + xy * adjugate[1] + xz * adjugate[2];
        let free = times(&adjugate, self.slope + self.around * hold) / determinant;
        // Onto the plane that preserves the volume, by the shortest way that the terms know; the determinant falls out.
        let way = times(&adjugate, self.normal);
        let along = self.normal.dot(way);
        // Faces that look in all directions enclose next to nothing: no plane.
        let told = self.normal.length_squared() > 1e-6 * self.square;
        let v = if told && along > 0.0 { free + way * ((self.volume - self.normal.dot(free)) / along) } else { free };
        v.is_finite().then_some(v)
    }
}

/// The inverse of a symmetric matrix times its determinant, which is positive in the terms that are solved here.
#[inline]
fn adjugate([xx, xy, xz, yy, yz, zz]: &[f64; 6]) -> [f64; 6] {
    [yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy, xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy]
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

impl MemorylessRest {
    pub(in crate::simplify) fn new(mesh: &Mesh) -> MemorylessRest {
        let diagonal = f64::from(mesh.diagonal());
        let scale = if diagonal > 0.0 { UNIT * diagonal.powi(-6) } else { 1.0 };
        // A square volume is a square distance times an area times four times the area of a face, in the mean.
        let area: f64 = mesh.triangles.iter().map(|t| t.map(|v| mesh.positions[v as usize].as_dvec3())).map(area).sum();
        let unit = (diagonal * diagonal * mesh.face_count() as f64 / (4.0 * UNIT * area)) as f32;
        let unit = if unit.is_finite() { unit } else { 0.0 };
        MemorylessRest { scale, unit, errors: vec![0.0; mesh.point_count()] }
    }
}

impl MetricRest for MemorylessRest {
    type Part = Memoryless;

    fn part(&self, work: &Working<'_>) -> Memoryless {
        Memoryless {
            scale: self.scale,
            unit: self.unit,
            stars: (0..work.points.len() as u32).map(|p| Star::of(work, p)).collect(),
            errors: work.names.points.iter().map(|p| self.errors[*p as usize]).collect(),
        }
    }

    fn take_back(&mut self, part: &Memoryless, names: &Names) {
        for (p, error) in names.points.iter().zip(&part.errors) {
            self.errors[*p as usize] = *error;
        }
    }
}

impl Memoryless {
    /// The system of the edge, and the place of the point that stays: both relative to the one that goes.
    fn system(&self, work: &Working<'_>, from: u32, to: u32) -> (System, DVec3) {
        let origin = work.points[from as usize].position;
        let place = |p: u32| (work.points[p as usize].position - origin).as_dvec3();
        let stays = place(to);
        let mut system = System::of(&self.stars[from as usize], &self.stars[to as usize], stays);
        let edge = stays.length_squared();
        for corner in work.corners(from) {
            let others = work.others(*corner);
            if others.contains(&to) {
                let [a, b] = others.map(place);
                system.drop_face(a.cross(b));
            }
        }
        let [xx, _, _, yy, _, zz] = system.matrix;
        system.square = xx + yy + zz;
        if work.points[from as usize].kind == PointKind::Border {
            let [line, onward] = [from, to].map(|p| work.points[p as usize].line);
            let weight = BORDER * edge;
            system.add_border(DVec3::ZERO, stays, weight);
            for q in line.into_iter().filter(|q| *q != to && *q != NONE) {
                system.add_border(place(q), DVec3::ZERO, weight);
            }
            for q in onward.into_iter().filter(|q| *q != from && *q != NONE) {
                system.add_border(stays, place(q), weight);
            }
        }
        (system, stays)
    }

    /// Whether the point that stays may be moved.
    fn moves(work: &Working<'_>, from: u32, to: u32) -> bool {
        let [from, to] = [from, to].map(|p| work.points[p as usize].kind);
        from == to && matches!(from, PointKind::Manifold | PointKind::Border)
    }
}

impl Metric for Memoryless {
    const FALLS: bool = false;
    const PLACES: bool = true;

    fn cost(&self, work: &Working<'_>, from: u32, to: u32, _corner: u32) -> f32 {
        let (system, stays) = self.system(work, from, to);
        let v = if Memoryless::moves(work, from, to) { system.solve().unwrap_or(stays) } else { stays };
        (system.cost(v) * self.scale) as f32
    }

    fn quadric_unit(&self) -> f32 {
        self.unit
    }

    fn offers(&self, work: &Working<'_>, from: u32, to: u32) -> bool {
        from < to || work.points[to as usize].kind != PointKind::Manifold
    }

    fn costs(&self, work: &Working<'_>, from: u32, mut out: impl FnMut(f32, u32)) {
        let origin = work.points[from as usize].position;
        let place = |p: u32| (work.points[p as usize].position - origin).as_dvec3();
        let own = &self.stars[from as usize];
        let corners = work.corners(from);
        let mut sides: Vec<[u32; 2]> = Vec::new();
        if corners.len() > HUB {
            sides.extend(corners.iter().map(|c| work.others(*c)).map(|[before, to]| [to, before]));
            sides.sort_unstable();
        }
        // The point before `to` around `from`.
        let before = |to: u32| {
            if corners.len() > HUB {
                let at = sides.partition_point(|side| side[0] < to);
                return sides.get(at).filter(|side| side[0] == to).map(|side| side[1]);
            }
            corners.iter().map(|c| work.others(*c)).find(|others| others[1] == to).map(|others| others[0])
        };
        for corner in corners {
            let [to, after] = work.others(*corner);
            if !self.offers(work, from, to) {
                continue;
            }
            let stays = place(to);
            let mut system = System::of(own, &self.stars[to as usize], stays);
            system.drop_face(stays.cross(place(after)));
            if let Some(before) = before(to) {
                system.drop_face(place(before).cross(stays));
            }
            let v = if Memoryless::moves(work, from, to) { system.solve().unwrap_or(stays) } else { stays };
            out((system.cost(v) * self.scale) as f32, to);
        }
    }

    fn place(&self, work: &Working<'_>, from: u32, to: u32) -> Option<DVec3> {
        if !Memoryless::moves(work, from, to) {
            return None;
        }
        let (system, _) = self.system(work, from, to);
        let place = system.solve().map(|v| work.points[from as usize].position.as_dvec3() + v);
        place.filter(|place| place.as_vec3().is_finite())
    }

    fn star_changed(&mut self, work: &Working<'_>, p: u32) {
        self.stars[p as usize] = Star::of(work, p);
    }

    fn merge(&mut self, work: &mut Working<'_>, from: u32, to: u32, place: Option<DVec3>) -> f64 {
        let (system, stays) = self.system(work, from, to);
        let v = place.map_or(stays, |place| place - work.points[from as usize].position.as_dvec3());
        // The mean height of the new place over the old faces, added to what these were off by.
        let height = if system.square > 0.0 { (system.cost(v) / system.square).sqrt() } else { 0.0 };
        let error = self.errors[from as usize].max(self.errors[to as usize]) + height as f32;
        self.errors[to as usize] = error;
        f64::from(error)
    }
}
