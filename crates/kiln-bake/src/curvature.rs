//! Mean curvature at the points of a mesh.
//!
//! Comes in: positions and triangles. Goes out: one number a vertex, 1 / object unit, positive where the surface is convex
//! (bulges towards the side from which faces wind counter-clockwise); vertices at one position have one number.
//!
//! ```text
//! weld vertices at equal positions to points
//! each face: cotangents of its angles, its share of the mixed Voronoi area of each corner, its angle-weighted normal
//! K(i) = 1 / (2 A(i)) sum over edges ij of (cot + cot) (x_i - x_j)          = 2 H n
//! H(i) = 1/2 K(i) . n(i)
//! ```
//!
//! All sums run over faces, so the number of faces at an edge does not matter: at a border an edge has one cotangent and the
//! point a part of its area, and what the missing faces would have balanced lies in the tangent plane, which the dot product
//! leaves out; a fan of three sheets has what they bend to together; sheets back to back cancel to 0. For spheres,
//! cylinders and saddles borders have the interior's value up to the sampling.
//!
//! Faces without area, or thinner than a ten-thousandth of their longest edge, count for nothing: their cotangents are noise.
//! A point of such faces alone has 0.
//!
//! Departures: Meyer et al. take the length of K, with a sign from the normal; the projection is the same where K is normal to the
//! surface, and ignores the noise of an uneven triangulation.
//!
//! Limits: the sum is exact on the average, not at every point: on a sphere of even valence whose points are moved by a tenth of an
//! edge it errs by some hundredths, and at points of valence 4 among others by tenths. A sharp edge has a curvature that grows with the fineness of the mesh beside it (an angle over a width), as it
//! must; nothing is smoothed.
//!
//! Source: M. Meyer, M. Desbrun, P. Schröder, A. Barr, Discrete Differential-Geometry Operators for Triangulated 2-Manifolds,
//! VisMath 2002 (2003), equations 7 and 8, figure 4 (mixed area), doi:10.1007/978-3-662-05105-4_2.

use glam::{DVec3, Vec3};
use kiln_geom::math;

/// Least height of a face that counts, in units of its longest edge.
const THIN: f64 = 1e-4;

/// `[vertex_count]` mean curvature at each vertex of `positions` (object units) in the mesh of `triangles` (`[face_count] x 3`),
/// in 1 / object unit, convex positive, finite; 0 for what no face with an area uses.
///
/// # Panics
/// If a triangle refers to no position.
///
/// # Source
/// Meyer et al. 2003, equation 8 with the mixed area of figure 4.
pub fn mean_curvature(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<f32> {
    let (point_of, count) = weld(positions);
    let mut points = vec![Sums::default(); count];
    for triangle in triangles {
        let corners = triangle.map(|v| positions[v as usize].as_dvec3());
        let Some(face) = Face::new(corners) else { continue };
        for k in 0..3 {
            let (i, j, l) = (k, (k + 1) % 3, (k + 2) % 3);
            let own = &mut points[point_of[triangle[i] as usize] as usize];
            // Each edge at the corner with the cotangent of the angle opposite to it.
            own.bend += face.cot[l] * (corners[i] - corners[j]) + face.cot[j] * (corners[i] - corners[l]);
            own.area += face.area[i];
            own.normal += face.angle[i] * face.normal;
        }
    }
    point_of.iter().map(|point| points[*point as usize].mean_curvature()).collect()
}

/// What the faces around a point add up to.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    /// Sum of cotangents times edges.
    bend: DVec3,
    /// Mixed area, square object units.
    area: f64,
    /// Normals weighted by angle.
    normal: DVec3,
}

impl Sums {
    fn mean_curvature(&self) -> f32 {
        let value = self.bend.dot(self.normal.normalize_or_zero()) / (4.0 * self.area);
        if value.is_finite() { value.clamp(f32::MIN.into(), f32::MAX.into()) as f32 } else { 0.0 }
    }
}

/// A face's part in its corners' sums.
struct Face {
    /// Cotangent of each corner's angle.
    cot: [f64; 3],
    /// Each corner's angle, radians.
    angle: [f64; 3],
    /// Each corner's share of the area: of its Voronoi region, or a half and two quarters where the face is obtuse.
    area: [f64; 3],
    /// Unit length.
    normal: DVec3,
}

impl Face {
    /// `None`: too thin, or no numbers.
    fn new(corners: [DVec3; 3]) -> Option<Face> {
        let [a, b, c] = corners;
        let cross = (b - a).cross(c - a);
        let twice = cross.length();
        // Squared lengths of the edges opposite to each corner.
        let opposite = [(c - b).length_squared(), (a - c).length_squared(), (b - a).length_squared()];
        let longest = opposite[0].max(opposite[1]).max(opposite[2]);
        // The negation catches NaN.
        if !(twice > THIN * longest && longest.is_finite()) {
            return None;
        }
        let dot: [f64; 3] = std::array::from_fn(|k| {
            let at = corners[k];
            (corners[(k + 1) % 3] - at).dot(corners[(k + 2) % 3] - at)
        });
        let cot = dot.map(|dot| dot / twice);
        let angle = dot.map(|dot| math::atan264(twice, dot));
        let obtuse = dot.iter().position(|dot| *dot < 0.0);
        let area = std::array::from_fn(|k| match obtuse {
            Some(corner) if corner == k => 0.25 * twice,
            Some(_) => 0.125 * twice,
            None => {
                let (j, l) = ((k + 1) % 3, (k + 2) % 3);
                0.125 * (opposite[j] * cot[j] + opposite[l] * cot[l])
            }
        });
        Some(Face { cot, angle, area, normal: cross / twice })
    }
}

/// `[vertex_count]` the number of each vertex's position among all different ones, and how many there are.
fn weld(positions: &[Vec3]) -> (Vec<u32>, usize) {
    // 0 and -0 are one place.
    let key = |v: &u32| positions[*v as usize].to_array().map(|c| (c + 0.0).to_bits());
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.sort_unstable_by_key(|v| (key(v), *v));
    let mut point_of = vec![0u32; positions.len()];
    let mut count = 0;
    for (k, v) in order.iter().enumerate() {
        if k > 0 && key(v) != key(&order[k - 1]) {
            count += 1;
        }
        point_of[*v as usize] = count;
    }
    (point_of, count as usize + 1)
}

#[cfg(test)]
mod tests {
    use kiln_geom::sample::{hash, unit};

    use super::*;

    /// A grid of `n` by `n` quads over `[0, 1]^2`, jittered inside by shares of a quad; where on the surface, with counter-clockwise
    /// faces as seen from the side to which `place`'s u x v points.
    fn patch(n: u32, jitter: f64, place: impl Fn(f64, f64) -> DVec3) -> (Vec<Vec3>, Vec<[u32; 3]>, Vec<bool>) {
        let (mut positions, mut triangles, mut interior) = (Vec::new(), Vec::new(), Vec::new());
        for j in 0..=n {
            for i in 0..=n {
                let inside = (1..n).contains(&i) && (1..n).contains(&j);
                let off =
                    |salt: u64| if inside { jitter * (unit(hash((j * 1000 + i) as u64 + salt)) - 0.5) } else { 0.0 };
                positions
                    .push(place((i as f64 + off(1 << 40)) / n as f64, (j as f64 + off(2 << 40)) / n as f64).as_vec3());
                interior.push(inside);
            }
        }
        let at = |i: u32, j: u32| j * (n + 1) + i;
        for j in 0..n {
            for i in 0..n {
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        (positions, triangles, interior)
    }

    /// Mean over a patch's interior of the distance to `expected`, and the greatest one, both in units of `scale`.
    fn apart(mesh: &(Vec<Vec3>, Vec<[u32; 3]>, Vec<bool>), expected: f64, scale: f64) -> (f64, f64) {
        let got = mean_curvature(&mesh.0, &mesh.1);
        let inner: Vec<f64> = got
            .iter()
            .zip(&mesh.2)
            .filter(|(_, inside)| **inside)
            .map(|(h, _)| (*h as f64 - expected).abs() / scale)
            .collect();
        (inner.iter().sum::<f64>() / inner.len() as f64, inner.iter().fold(0.0, |most: f64, e| most.max(*e)))
    }

    fn on_sphere(u: f64, v: f64, radius: f64) -> DVec3 {
        let (around, polar) = (1.5 * (u - 0.5), 1.5 * (v - 0.5));
        radius
            * DVec3::new(
                math::sin64(around) * math::cos64(polar),
                math::sin64(polar),
                math::cos64(around) * math::cos64(polar),
            )
    }

    fn on_cylinder(u: f64, v: f64, radius: f64) -> DVec3 {
        DVec3::new(radius * math::sin64(2.0 * u), v * radius, radius * math::cos64(2.0 * u))
    }

    #[test]
    fn a_sphere_has_one_over_its_radius_and_a_hollow_one_less_than_nothing() {
        for radius in [0.02, 1.0, 350.0] {
            let (mean, most) = apart(&patch(40, 0.0, |u, v| on_sphere(u, v, radius)), 1.0 / radius, 1.0 / radius);
            // The sum's own error at cells of 0.0375 radians.
            assert!(mean < 5e-3 && most < 1e-2, "even: {mean} {most}");
            let (mean, most) = apart(&patch(40, 0.2, |u, v| on_sphere(u, v, radius)), 1.0 / radius, 1.0 / radius);
            assert!(mean < 0.02 && most < 0.15, "uneven: {mean} {most}");
            let (mean, _) = apart(&patch(40, 0.0, |u, v| on_sphere(v, u, radius)), -1.0 / radius, 1.0 / radius);
            assert!(mean < 5e-3, "seen from within: {mean}");
        }
    }

    #[test]
    fn a_cylinder_has_half_of_that_at_its_border_too() {
        let radius = 3.0;
        let mesh = patch(40, 0.0, |u, v| on_cylinder(u, v, radius));
        let (mean, most) = apart(&mesh, 0.5 / radius, 0.5 / radius);
        assert!(mean < 1e-3 && most < 2e-3, "{mean} {most}");
        // Rims and sides, corners left out.
        let got = mean_curvature(&mesh.0, &mesh.1);
        for k in 2..39 {
            for vertex in [k, 40 * 41 + k] {
                assert!((got[vertex] as f64 - 0.5 / radius).abs() < 0.02 * 0.5 / radius, "{} on the rim", got[vertex]);
            }
        }
        assert!(got.iter().all(|h| (-0.01..0.5 / radius as f32 * 1.6).contains(h)));
    }

    #[test]
    fn a_plane_has_none_and_a_saddle_hardly_any() {
        let plane = patch(20, 0.4, |u, v| DVec3::new(u, v, 0.25 * u - 0.5 * v));
        let most = mean_curvature(&plane.0, &plane.1).iter().fold(0.0f32, |most, h| most.max(h.abs()));
        // Roundings of 6e-8 in cells of 0.05 and less.
        assert!(most < 1e-3, "{most}");
        // z = (x^2 - y^2) / 2: principal curvatures 1 and -1 in its middle, a little else further out.
        let place = |t: usize| (0.4 * ((t % 41) as f64 / 40.0 - 0.5), 0.4 * ((t / 41) as f64 / 40.0 - 0.5));
        let saddle = patch(40, 0.0, |u, v| {
            let (x, y) = (0.4 * (u - 0.5), 0.4 * (v - 0.5));
            DVec3::new(x, y, 0.5 * (x * x - y * y))
        });
        let got = mean_curvature(&saddle.0, &saddle.1);
        for t in (0..got.len()).filter(|t| saddle.2[*t]) {
            let (x, y) = place(t);
            let expected = (x * x - y * y) / (2.0 * (1.0 + x * x + y * y).powf(1.5));
            assert!((got[t] as f64 - expected).abs() < 2e-3, "{} for {expected} at {x} {y}", got[t]);
        }
    }

    #[test]
    fn a_ridge_has_its_angle_over_the_width_of_its_cells_and_a_valley_the_same_below_zero() {
        // Two planes at right angles along y, cells of width w: H = angle / (2 w) at the edge's points, nothing beside it.
        let w = 0.05f64;
        let fold = |turn: f64| {
            patch(20, 0.0, move |u, v| {
                let x = u - 0.5;
                DVec3::new(x, v, turn * x.abs())
            })
        };
        let (ridge, valley) = (fold(-1.0), fold(1.0));
        let (high, low) = (mean_curvature(&ridge.0, &ridge.1), mean_curvature(&valley.0, &valley.1));
        let middle = 10 * 21 + 10;
        // Cotangent form: 2 sin(angle / 2) instead of the angle, over cells of width w sqrt 2.
        let expected = (std::f64::consts::FRAC_PI_4.sin() / (w * 2f64.sqrt())) as f32;
        assert!((high[middle] - expected).abs() < 0.02 * expected, "{} for {expected}", high[middle]);
        assert!((low[middle] + high[middle]).abs() < 1e-3 * expected);
        assert!(high[middle + 3].abs() < 1e-3 * expected);
    }

    #[test]
    fn split_vertices_count_as_one_point() {
        let (positions, triangles, _) = patch(10, 0.3, |u, v| on_sphere(u, v, 2.0));
        let whole = mean_curvature(&positions, &triangles);
        let soup: Vec<Vec3> = triangles.iter().flatten().map(|v| positions[*v as usize]).collect();
        let faces: Vec<[u32; 3]> = (0..triangles.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        for (corner, h) in mean_curvature(&soup, &faces).iter().enumerate() {
            assert_eq!(*h, whole[triangles[corner / 3][corner % 3] as usize]);
        }
    }

    #[test]
    fn whatever_is_broken_gives_a_number() {
        // A fan of three sheets at one edge, a sheet and its back, a needle, a point, a face of no numbers.
        let [o, y] = [Vec3::ZERO, Vec3::Y];
        let tips = [Vec3::X, Vec3::new(-0.5, 0.0, 0.8), Vec3::new(-0.5, 0.0, -0.8)];
        let positions = [
            o,
            y,
            tips[0],
            tips[1],
            tips[2],
            Vec3::new(1e-9, 0.5, 0.0),
            Vec3::NAN,
            Vec3::splat(f32::MAX),
            -Vec3::splat(f32::MAX),
        ];
        let fan = [[0, 2, 1], [0, 3, 1], [0, 4, 1]];
        let broken = [[0, 1, 2], [0, 2, 1], [0, 1, 5], [0, 0, 0], [0, 1, 6], [7, 8, 2], [7, 0, 1]];
        for h in mean_curvature(&positions, &fan).iter().chain(&mean_curvature(&positions, &broken)) {
            assert!(h.is_finite());
        }
        let back_to_back = mean_curvature(&positions, &[[0, 1, 2], [0, 2, 1]]);
        assert!(back_to_back.iter().all(|h| *h == 0.0));
        // What counts for nothing changes nothing.
        let (mut around, mut faces, _) = patch(10, 0.3, |u, v| on_sphere(u, v, 1.0));
        let before = mean_curvature(&around, &faces);
        around.push(around[60].lerp(around[61], 0.5));
        faces.extend([[60, 61, 121], [60, 60, 61]]);
        let after = mean_curvature(&around, &faces);
        assert_eq!(before[..], after[..121]);
        assert_eq!((mean_curvature(&[], &[]).len(), after[121]), (0, 0.0));
    }
}
