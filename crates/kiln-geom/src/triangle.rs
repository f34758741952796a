//! One triangle: its nearest point to a place, and its area.

use glam::{DVec3, Vec3};

/// The point of a triangle that is nearest to a place, double precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// The point, in the triangle's space.
    pub point: DVec3,
    /// Its barycentric coordinates, all in `[0, 1]`, sum 1.
    pub bary: [f64; 3],
    /// Square of its distance, square object units.
    pub distance_squared: f64,
}

/// The point of triangle `abc` nearest to `p` (any common space). Degenerate triangles count as their edges, or their point:
/// the result is always on the triangle, finite for finite input.
///
/// # Source
/// Ericson, Real-Time Collision Detection, 2005, section 5.1.5 (Voronoi regions), with a fallback to the three edges where
/// the area vanishes.
pub fn closest_point(p: DVec3, a: DVec3, b: DVec3, c: DVec3) -> Closest {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let normal = ab.cross(ac);
    // Twice the area against the longest edges: below this the interior's barycentric coordinates are noise.
    if normal.length_squared() <= 1e-24 * ab.length_squared() * ac.length_squared() {
        return closest_on_edges(p, [a, b, c]);
    }
    let at = |bary: [f64; 3], point: DVec3| Closest { point, bary, distance_squared: (p - point).length_squared() };

    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return at([1.0, 0.0, 0.0], a);
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return at([0.0, 1.0, 0.0], b);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let v = d1 / (d1 - d3);
        return at([1.0 - v, v, 0.0], a + v * ab);
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return at([0.0, 0.0, 1.0], c);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let w = d2 / (d2 - d6);
        return at([1.0 - w, 0.0, w], a + w * ac);
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return at([0.0, 1.0 - w, w], b + w * (c - b));
    }
    let sum = va + vb + vc;
    if !(va >= 0.0 && vb >= 0.0 && vc >= 0.0 && sum > 0.0) {
        // Rounding put the place in no region: it lies near an edge of a sliver.
        return closest_on_edges(p, [a, b, c]);
    }
    let (v, w) = (vb / sum, vc / sum);
    at([1.0 - v - w, v, w], a + v * ab + w * ac)
}

/// The nearest point among the three edges; ties: the earlier edge.
fn closest_on_edges(p: DVec3, corners: [DVec3; 3]) -> Closest {
    let mut best = Closest { point: corners[0], bary: [1.0, 0.0, 0.0], distance_squared: f64::INFINITY };
    for (i, j) in [(0, 1), (0, 2), (1, 2)] {
        let edge = corners[j] - corners[i];
        let length_squared = edge.length_squared();
        let s = if length_squared > 0.0 { (edge.dot(p - corners[i]) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
        let point = corners[i] + s * edge;
        let distance_squared = (p - point).length_squared();
        if distance_squared < best.distance_squared {
            let mut bary = [0.0; 3];
            bary[i] = 1.0 - s;
            bary[j] = s;
            best = Closest { point, bary, distance_squared };
        }
    }
    best
}

/// Area of a triangle, square object units, computed in double precision.
pub fn area(corners: [Vec3; 3]) -> f64 {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    0.5 * (b - a).cross(c - a).length()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Nearest by dense search: within a grid step of the optimum.
    fn by_search(p: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
        const N: usize = 60;
        let mut best = f64::INFINITY;
        for i in 0..=N {
            for j in 0..=N - i {
                let (v, w) = (i as f64 / N as f64, j as f64 / N as f64);
                best = best.min((p - (a + v * (b - a) + w * (c - a))).length_squared());
            }
        }
        best.sqrt()
    }

    fn place() -> impl Strategy<Value = DVec3> {
        // A coarse lattice makes equal corners, collinear triangles and places on edges common.
        prop_oneof![
            (-4i32..5, -4i32..5, -4i32..5).prop_map(|(x, y, z)| DVec3::new(x as f64, y as f64, z as f64)),
            (-4.0..4.0, -4.0..4.0, -4.0..4.0).prop_map(|(x, y, z)| DVec3::new(x, y, z)),
        ]
    }

    proptest! {
        #[test]
        fn no_grid_point_is_nearer(p in place(), a in place(), b in place(), c in place()) {
            let found = closest_point(p, a, b, c);
            let on = found.bary[0] * a + found.bary[1] * b + found.bary[2] * c;
            prop_assert!((on - found.point).length() < 1e-9);
            prop_assert!(found.bary.iter().all(|w| (-1e-12..=1.0 + 1e-12).contains(w)));
            prop_assert!((found.bary.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            prop_assert!(found.distance_squared.sqrt() <= by_search(p, [a, b, c]) + 1e-9);
        }

        #[test]
        fn a_sliver_gives_a_point_on_itself(p in place(), a in place(), b in place(), s in -0.5..1.5f64, e in 0.0..1e-7f64) {
            let c = a + s * (b - a) + DVec3::new(e, -e, e);
            let found = closest_point(p, a, b, c);
            prop_assert!(found.point.is_finite());
            prop_assert!(found.distance_squared.sqrt() <= by_search(p, [a, b, c]) + 1e-6);
        }
    }

    #[test]
    fn each_region_has_its_point() {
        let [a, b, c] = [DVec3::ZERO, DVec3::X * 2.0, DVec3::Y * 2.0];
        let cases = [
            (DVec3::new(0.5, 0.5, 3.0), DVec3::new(0.5, 0.5, 0.0)),
            (DVec3::new(-1.0, -1.0, 0.0), a),
            (DVec3::new(5.0, -1.0, 0.0), b),
            (DVec3::new(-1.0, 5.0, 0.0), c),
            (DVec3::new(1.0, -1.0, 1.0), DVec3::X),
            (DVec3::new(-1.0, 1.0, 1.0), DVec3::Y),
            (DVec3::new(2.0, 2.0, 0.0), DVec3::new(1.0, 1.0, 0.0)),
        ];
        for (p, expected) in cases {
            assert!((closest_point(p, a, b, c).point - expected).length() < 1e-12, "{p}");
        }
    }
}
