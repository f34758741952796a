//! The quadric metric: area-weighted squared distance to planes (Garland and Heckbert), kept about the point that owns it.
//!
//! A form is stored *relative to the position of its point*. All planes of a fresh point pass through it, so its linear and
//! constant parts start as exact zeros, and what is subtracted while evaluating is of the size of an edge and not of the
//! model: flat regions cost 0 and not noise.

use glam::{DMat3, DVec3};
use kiln_asset::QuadricCoefficients;

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
    fn plane(n: DVec3, scale: f64, weight: f64) -> Quadric {
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
    pub(crate) inner: f64,
}

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
                EdgeKind::Boundary if fresh => weights.inner,
                EdgeKind::Seam => weights.inner,
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
