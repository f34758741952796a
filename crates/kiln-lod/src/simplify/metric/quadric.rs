//! The quadric metric: area-weighted squared distance to planes (Garland and Heckbert), kept about the point that owns it.
//!
//! A form is stored *relative to the position of its point*. All planes of a fresh point pass through it, so its linear and
//! constant parts start as exact zeros, and what is subtracted while evaluating is of the size of an edge and not of the
//! model: flat regions cost 0 and not noise.

use std::borrow::Cow;

use glam::{DMat3, DVec3, Vec3};
use kiln_asset::{Mesh, QuadricCoefficients};

use super::Metric;
use super::attributes::AttributeForms;
use crate::simplify::SimplifyOptions;
use crate::simplify::rest::{MetricRest, Rest};
use crate::simplify::sequence::{Collapse, CollapseSequence};
use crate::simplify::working::{Names, Working};
use crate::topology::{EdgeKind, Topology, is_degenerate};

/// Symmetric 4x4 error form about an origin, and the area that it stands for. Its unit is square distance times area.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub(crate) struct Quadric {
    xx: f64,
    xy: f64,
    xz: f64,
    yy: f64,
    yz: f64,
    zz: f64,
    x: f64,
    y: f64,
    z: f64,
    /// Value at the origin.
    pub(crate) one: f64,
    /// Area, square object units.
    pub(crate) weight: f64,
}

impl Quadric {
    /// `scale` times the square distance to the plane through the origin with unit normal `n`; stands for `weight`.
    pub(crate) fn plane(n: DVec3, scale: f64, weight: f64) -> Quadric {
        let m = n * scale;
        Quadric {
            xx: m.x * n.x,
            xy: m.x * n.y,
            xz: m.x * n.z,
            yy: m.y * n.y,
            yz: m.y * n.z,
            zz: m.z * n.z,
            weight,
            ..Default::default()
        }
    }

    /// Half the gradient at `d`.
    #[inline]
    fn slope(&self, d: DVec3) -> DVec3 {
        DVec3::new(
            self.xx * d.x + self.xy * d.y + self.xz * d.z + self.x,
            self.xy * d.x + self.yy * d.y + self.yz * d.z + self.y,
            self.xz * d.x + self.yz * d.y + self.zz * d.z + self.z,
        )
    }

    /// The value at `d` from the origin; rounding may leave it slightly below 0.
    #[inline]
    pub(crate) fn at(&self, d: DVec3) -> f64 {
        (self.slope(d) + DVec3::new(self.x, self.y, self.z)).dot(d) + self.one
    }

    /// Matrix (xx, xy, xz, yy, yz, zz) and minus half the gradient at `d`.
    pub(crate) fn pull(&self, d: DVec3) -> ([f64; 6], DVec3) {
        ([self.xx, self.xy, self.xz, self.yy, self.yz, self.zz], -self.slope(d))
    }

    /// Where the form plus `pull` times the square distance from the origin is least; `None` where that is not told.
    pub(crate) fn least(&self, pull: f64) -> Option<DVec3> {
        let matrix = DMat3::from_cols(
            DVec3::new(self.xx + pull, self.xy, self.xz),
            DVec3::new(self.xy, self.yy + pull, self.yz),
            DVec3::new(self.xz, self.yz, self.zz + pull),
        );
        let trace = self.xx + self.yy + self.zz + 3.0 * pull;
        // Singular to rounding: no place is better than another.
        if matrix.determinant() <= 1e-18 * trace * trace * trace {
            return None;
        }
        Some(-(matrix.inverse() * DVec3::new(self.x, self.y, self.z))).filter(|step| step.is_finite())
    }

    /// The same form about the place `d` from the origin.
    #[inline]
    pub(crate) fn about(&self, d: DVec3) -> Quadric {
        let slope = self.slope(d);
        Quadric { x: slope.x, y: slope.y, z: slope.z, one: self.at(d), ..*self }
    }

    #[inline]
    pub(crate) fn add(&mut self, other: &Quadric) {
        self.xx += other.xx;
        self.xy += other.xy;
        self.xz += other.xz;
        self.yy += other.yy;
        self.yz += other.yz;
        self.zz += other.zz;
        self.x += other.x;
        self.y += other.y;
        self.z += other.z;
        self.one += other.one;
        self.weight += other.weight;
    }

    pub(crate) fn from_coefficients(c: &QuadricCoefficients) -> Quadric {
        let [xx, xy, xz, yy, yz, zz, x, y, z, one, weight] = *c;
        Quadric { xx, xy, xz, yy, yz, zz, x, y, z, one, weight }
    }

    pub(crate) fn coefficients(&self) -> QuadricCoefficients {
        let q = self;
        [q.xx, q.xy, q.xz, q.yy, q.yz, q.zz, q.x, q.y, q.z, q.one, q.weight]
    }
}

/// How strongly lines hold their shape, relative to surface: unitless factors on the square length of their edges.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineWeights {
    pub(crate) border: f64,
    pub(crate) boundary: f64,
    pub(crate) seam: f64,
}

/// Share of a seam's weight where attributes have a price: what hangs at the seam is priced with them, and a line that holds its
/// shape as well has levels spend their points on seams. Image error of the barrel, the truck and the portal at a quarter with 1, 0.1,
/// 0.01 and 0: 18.1, 14.1, 5.5; 17.8, 15.5, 4.5; 16.4, 13.8, 4.4; 16.3, 17.4, 4.5.
const PRICED_SEAM: f64 = 0.01;

/// The form of each point `[point_count]`, each about its own position: the planes of its faces, each with a third of the
/// face's area; and for each border, seam and boundary edge a plane through it perpendicular to its face.
///
/// `carried` (object space, empty or `[point_count]`) replaces the planes: it holds those of the finer faces that stood
/// here, and the borders and boundaries too, so only seams are added, which an atlas may have made since.
pub(crate) fn initial(
    topology: &Topology,
    positions: &[DVec3],
    carried: &[QuadricCoefficients],
    weights: LineWeights,
) -> Vec<Quadric> {
    let fresh = carried.is_empty();
    let mut quadrics = if fresh {
        vec![Quadric::default(); positions.len()]
    } else {
        let about_own = |(c, p): (&QuadricCoefficients, &DVec3)| Quadric::from_coefficients(c).about(*p);
        carried.iter().zip(positions).map(about_own).collect()
    };
    for (f, face) in topology.face_points.iter().enumerate().filter(|(_, face)| !is_degenerate(face)) {
        let [a, b, c] = face.map(|p| positions[p as usize]);
        let cross = (b - a).cross(c - a);
        let double_area = cross.length();
        if double_area <= 0.0 {
            continue;
        }
        let normal = cross / double_area;
        let area = double_area / 6.0;
        if fresh {
            let plane = Quadric::plane(normal, area, area);
            for p in face {
                quadrics[*p as usize].add(&plane);
            }
        }
        for k in 0..3 {
            let weight = match topology.edge_kinds[f][k] {
                EdgeKind::Border if fresh => weights.border,
                EdgeKind::Boundary if fresh => weights.boundary,
                EdgeKind::Seam => weights.seam,
                _ => continue,
            };
            let ends = [face[k], face[(k + 1) % 3]];
            let edge = positions[ends[1] as usize] - positions[ends[0] as usize];
            let across = edge.cross(normal).normalize_or_zero();
            let line = Quadric::plane(across, weight * edge.length_squared(), 0.0);
            for p in ends {
                quadrics[p as usize].add(&line);
            }
        }
    }
    quadrics
}

/// `[point_count]`: where each point lies.
pub(in crate::simplify) fn places(mesh: &Mesh) -> Vec<DVec3> {
    let mut positions = vec![DVec3::ZERO; mesh.point_count()];
    // A point's place is that of its lowest wedge; wedges of joined submeshes may lie a weld distance apart.
    for (v, p) in mesh.points.iter().enumerate().rev() {
        positions[p.index()] = mesh.positions[v].as_dvec3();
    }
    positions
}

/// The error form of each point, as it grows along a sequence.
pub(in crate::simplify) struct Forms {
    positions: Vec<DVec3>,
    /// Before any collapse.
    initial: Vec<Quadric>,
    quadrics: Vec<Quadric>,
    /// Whether a point has taken in another.
    grown: Vec<bool>,
    applied: usize,
}

impl Forms {
    pub(in crate::simplify) fn new(
        mesh: &Mesh,
        topology: &Topology,
        carried: &[QuadricCoefficients],
        options: &SimplifyOptions,
    ) -> Forms {
        let positions = places(mesh);
        let seam = options.line_weight * if options.attributes { PRICED_SEAM } else { 1.0 };
        let weights = LineWeights { border: options.border_weight, boundary: options.line_weight, seam };
        let quadrics = initial(topology, &positions, carried, weights);
        let grown = vec![false; quadrics.len()];
        Forms { positions, initial: quadrics.clone(), quadrics, grown, applied: 0 }
    }

    /// `[point_count]`.
    pub(in crate::simplify) fn positions(&self) -> &[DVec3] {
        &self.positions
    }

    /// Before any collapse, each about its own place.
    pub(in crate::simplify) fn initial(&self) -> &[Quadric] {
        &self.initial
    }

    /// Brings the forms to where they stand after the first `count` collapses; going back starts anew.
    pub(in crate::simplify) fn go_to(&mut self, sequence: &CollapseSequence, count: usize) {
        if count < self.applied {
            self.quadrics.copy_from_slice(&self.initial);
            self.grown.fill(false);
            self.applied = 0;
        }
        while self.applied < count {
            let Collapse { from, to, .. } = sequence.collapses[self.applied];
            let step = self.positions[to as usize] - self.positions[from as usize];
            let moved = self.quadrics[from as usize].about(step);
            self.quadrics[to as usize].add(&moved);
            self.grown[to as usize] = true;
            self.applied += 1;
        }
    }

    /// Brings the forms to where they stand after the collapses of a closed set alone.
    pub(in crate::simplify) fn apply(&mut self, sequence: &CollapseSequence, applied: &[bool]) {
        self.quadrics.copy_from_slice(&self.initial);
        self.grown.fill(false);
        // No prefix: whoever goes to one next starts anew.
        self.applied = usize::MAX;
        for Collapse { from, to, .. } in sequence.collapses.iter().zip(applied).filter(|c| *c.1).map(|c| c.0) {
            let step = self.positions[*to as usize] - self.positions[*from as usize];
            let moved = self.quadrics[*from as usize].about(step);
            self.quadrics[*to as usize].add(&moved);
            self.grown[*to as usize] = true;
        }
    }

    /// The form of a point about its own place.
    pub(in crate::simplify) fn form(&self, point: u32) -> Quadric {
        self.quadrics[point as usize]
    }

    /// The form of a point about its own place, if it has taken in another.
    pub(in crate::simplify) fn grown(&self, point: u32) -> Option<Quadric> {
        self.grown[point as usize].then(|| self.quadrics[point as usize])
    }

    /// The points that took others in, and by what their forms grew, object space.
    pub(in crate::simplify) fn gained(&self) -> Vec<(u32, QuadricCoefficients)> {
        let of = |p: usize| {
            let (now, first) = (self.quadrics[p].coefficients(), self.initial[p].coefficients());
            let gain = std::array::from_fn(|i| now[i] - first[i]);
            (p as u32, Quadric::from_coefficients(&gain).about(-self.positions[p]).coefficients())
        };
        (0..self.quadrics.len()).filter(|p| self.grown[*p]).map(of).collect()
    }

    /// Object-space forms of the points `points`.
    pub(in crate::simplify) fn object_space(&self, points: &[u32]) -> Vec<QuadricCoefficients> {
        points.iter().map(|p| self.quadrics[*p as usize].about(-self.positions[*p as usize]).coefficients()).collect()
    }
}

/// A form as costs read it: single precision, about the point's place, all by the diagonal to the fourth.
#[derive(Clone, Copy, Default)]
#[repr(C, align(16))]
struct Price {
    xx: f32,
    yy: f32,
    zz: f32,
    /// Twice the products.
    xy: f32,
    xz: f32,
    yz: f32,
    /// Twice the linear part.
    x: f32,
    y: f32,
    z: f32,
    one: f32,
    /// Share of the square length.
    length: f32,
}

impl Price {
    fn of(form: &Quadric, length_weight: f64, scale: f64) -> Price {
        let s = |value: f64| (value * scale) as f32;
        Price {
            xx: s(form.xx),
            yy: s(form.yy),
            zz: s(form.zz),
            xy: s(2.0 * form.xy),
            xz: s(2.0 * form.xz),
            yz: s(2.0 * form.yz),
            x: s(2.0 * form.x),
            y: s(2.0 * form.y),
            z: s(2.0 * form.z),
            one: s(form.one.max(0.0)),
            length: s(length_weight * form.weight),
        }
    }

    /// The cost of a step to a point of that own cost. The same operations in the same order wherever it is inlined.
    #[inline(always)]
    fn at(&self, [x, y, z]: [f32; 3], own: f32) -> f32 {
        let form = (self.xx * x + self.xy * y + self.xz * z + self.x) * x
            + (self.yy * y + self.yz * z + self.y) * y
            + (self.zz * z + self.z) * z
            + self.one;
        form.max(0.0) + own + self.length * (x * x + y * y + z * z)
    }
}

/// The metric between rounds.
pub(in crate::simplify) struct QuadricRest<'a> {
    /// `[point_count]`, each about its own place.
    quadrics: Cow<'a, [Quadric]>,
    attributes: Option<AttributeForms>,
    length_weight: f64,
    scale: f64,
}

impl<'a> QuadricRest<'a> {
    /// Gives the points of `rest` their own costs, too.
    pub(in crate::simplify) fn new(quadrics: &'a [Quadric], rest: &mut Rest<'_>) -> QuadricRest<'a> {
        let (mesh, options) = (rest.mesh, rest.options);
        let diagonal = f64::from(mesh.diagonal());
        let scale = if diagonal > 0.0 { diagonal.powi(-4) } else { 1.0 };
        for (point, form) in rest.points.iter_mut().zip(quadrics) {
            point.own = (form.one.max(0.0) * scale) as f32;
        }
        let attributes = if options.attributes { AttributeForms::new(mesh) } else { None };
        QuadricRest { quadrics: Cow::Borrowed(quadrics), attributes, length_weight: options.length_weight, scale }
    }
}

impl MetricRest for QuadricRest<'_> {
    type Part = QuadricMetric;

    fn part(&self, work: &Working<'_>) -> QuadricMetric {
        let quadrics: Vec<Quadric> = work.names.points.iter().map(|p| self.quadrics[*p as usize]).collect();
        QuadricMetric {
            prices: quadrics.iter().map(|form| Price::of(form, self.length_weight, self.scale)).collect(),
            quadrics,
            attributes: self.attributes.as_ref().map(|attributes| attributes.part(&work.names.wedges)),
            length_weight: self.length_weight,
            scale: self.scale,
        }
    }

    fn take_back(&mut self, part: &QuadricMetric, names: &Names) {
        let quadrics = self.quadrics.to_mut();
        for (p, form) in names.points.iter().zip(&part.quadrics) {
            quadrics[*p as usize] = *form;
        }
        if let (Some(attributes), Some(part)) = (&mut self.attributes, &part.attributes) {
            attributes.take_back(part, &names.wedges);
        }
    }
}

/// The metric of a part.
pub(in crate::simplify) struct QuadricMetric {
    /// `[point_count]`, each about its own place.
    quadrics: Vec<Quadric>,
    /// `[point_count]`.
    prices: Vec<Price>,
    attributes: Option<AttributeForms>,
    length_weight: f64,
    /// 1 / diagonal^4: single precision neither overflows nor vanishes.
    scale: f64,
}

impl QuadricMetric {
    fn slide(&self, attributes: &AttributeForms, work: &Working<'_>, [from, to, corner]: [u32; 3], step: Vec3) -> f32 {
        let pairs = work.pairs_beside(from, to, corner).into_iter().flatten();
        pairs.map(|[wedge, partner]| attributes.cost(wedge, partner, step)).sum()
    }
}

impl Metric for QuadricMetric {
    const FALLS: bool = false;

    #[inline]
    fn cost(&self, work: &Working<'_>, from: u32, to: u32, corner: u32) -> f32 {
        let to_point = &work.points[to as usize];
        let step = to_point.position - work.points[from as usize].position;
        let cost = self.prices[from as usize].at(step.to_array(), to_point.own);
        match &self.attributes {
            None => cost,
            Some(attributes) => cost + self.slide(attributes, work, [from, to, corner], step),
        }
    }

    #[inline]
    fn costs(&self, work: &Working<'_>, from: u32, mut out: impl FnMut(f32, u32)) {
        let price = &self.prices[from as usize];
        let origin = work.points[from as usize].position;
        for corner in work.corners(from) {
            let to = work.others(*corner)[0];
            let point = &work.points[to as usize];
            let step = point.position - origin;
            let cost = price.at(step.to_array(), point.own);
            let slide = self.attributes.as_ref().map(|a| self.slide(a, work, [from, to, *corner], step));
            out(slide.map_or(cost, |slide| cost + slide), to);
        }
    }

    fn merge(&mut self, work: &mut Working<'_>, from: u32, to: u32, _place: Option<DVec3>) -> f64 {
        let step = work.points[to as usize].position - work.points[from as usize].position;
        let moved = self.quadrics[from as usize].about(step.as_dvec3());
        let form = &mut self.quadrics[to as usize];
        form.add(&moved);
        self.prices[to as usize] = Price::of(form, self.length_weight, self.scale);
        let own = &mut work.points[to as usize].own;
        *own += (moved.one.max(0.0) * self.scale) as f32;
        if let Some(attributes) = &mut self.attributes {
            for [wedge, partner] in &work.map {
                *own += attributes.cost(*wedge, *partner, step);
                attributes.merge(*wedge, *partner, step);
            }
        }
        if form.weight > 0.0 { (form.one.max(0.0) / form.weight).sqrt() } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_form_gives_square_distance_times_weight_wherever_it_is_kept() {
        let n = DVec3::new(2.0, -1.0, 2.0) / 3.0;
        let form = Quadric::plane(n, 3.0, 3.0);
        let place = DVec3::new(0.3, 0.1, -0.7);
        let direct = 3.0 * n.dot(place).powi(2);
        assert!((form.at(place) - direct).abs() < 1e-15);
        let moved = form.about(DVec3::new(-1.0, 2.0, 0.5));
        assert!((moved.at(place - DVec3::new(-1.0, 2.0, 0.5)) - direct).abs() < 1e-14);
    }

    #[test]
    fn three_planes_are_least_where_they_meet() {
        let corner = DVec3::new(0.3, -0.2, 0.9);
        let mut form = Quadric::default();
        for n in [DVec3::X, DVec3::Y, DVec3::new(0.6, 0.0, 0.8)] {
            form.add(&Quadric::plane(n, 2.0, 2.0).about(-corner));
        }
        assert!(form.at(corner).abs() < 1e-14);
        assert!(form.least(0.0).is_some_and(|found| found.distance(corner) < 1e-12));
        let flat = Quadric::plane(DVec3::Z, 1.0, 1.0).about(DVec3::new(5.0, 6.0, -0.5));
        assert_eq!(flat.least(0.0), None, "a plane has no least place");
        let pulled = flat.least(1e-6).expect("the pull tells");
        assert!(pulled.distance(DVec3::new(0.0, 0.0, 0.5)) < 1e-5, "{pulled}");
    }

    #[test]
    fn coefficients_come_back_as_they_went() {
        let form = Quadric::plane(DVec3::X, 2.0, 5.0).about(DVec3::ONE);
        assert_eq!(Quadric::from_coefficients(&form.coefficients()), form);
    }
}
