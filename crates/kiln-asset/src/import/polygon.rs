//! Polygons into triangles.
//!
//! **Problem.** A polygon of `n` corners in space, perhaps concave, perhaps not quite plane, becomes `n - 2` triangles of the same
//! winding over the same corners.
//!
//! **Method.**
//! ```text
//! normal      of Newell's sum; project along its greatest axis
//! fan         from corner 0, if none of its triangles turns over: linear, takes all convex polygons and many others
//! ears        else, up to MOST_EAR_CORNERS corners: cut the first corner that bulges out and whose triangle holds no other
//!             corner that bulges in; look anew at its two neighbours only
//! ```
//! **Limits.** A polygon that crosses itself has no such triangles; what is left of it when no ear is found becomes a fan, and the
//! caller is told; one that winds around several times, like a pentagram, may pass as a fan. Larger concave polygons are refused:
//! ears cost the square of the corners.
//!
//! **Sources.** G. H. Meisters, "Polygons have ears", American Mathematical Monthly 82 (1975). M. E. Newell's normal: I. E.
//! Sutherland, R. F. Sproull, R. A. Schumacker, "A characterization of ten hidden-surface algorithms", Computing Surveys 6 (1974).

use glam::{DVec2, DVec3, Vec3};

/// Most corners of a polygon that is cut by ears.
pub(super) const MOST_EAR_CORNERS: usize = 256;

/// How a polygon fared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cut {
    /// Into triangles that cover it once.
    Whole,
    /// It crosses itself: a fan for what was left.
    Crossed,
    /// Concave with too many corners: nothing was given out.
    TooLarge,
}

/// Gives `corners.len() - 2` triangles (indices into `corners`) to `out`; at least 3 corners.
pub(super) fn triangulate(corners: &[Vec3], mut out: impl FnMut([u32; 3])) -> Cut {
    let count = corners.len() as u32;
    if count == 3 {
        out([0, 1, 2]);
        return Cut::Whole;
    }
    let flat = project(corners);
    let area = |[a, b, c]: [u32; 3]| {
        let [a, b, c] = [a, b, c].map(|k| flat[k as usize]);
        (b - a).perp_dot(c - a)
    };
    let fan = |hub: u32| (1..count - 1).map(move |k| [hub, (hub + k) % count, (hub + k + 1) % count]);
    let whole: f64 = fan(0).map(area).sum();
    // Corners on one line in 32-bit floats turn either way by rounding.
    let slack = 1e-6 * whole.abs();
    let fits = |hub: u32| fan(hub).all(|triangle| area(triangle) >= -slack);
    // A quad has two fans, and a concave one only one that is right.
    let hub = if fits(0) { Some(0) } else { (count == 4 && fits(1)).then_some(1) };
    match hub {
        Some(hub) => fan(hub).for_each(out),
        None if corners.len() > MOST_EAR_CORNERS => return Cut::TooLarge,
        None => return cut_ears(&flat, slack, area, out),
    }
    Cut::Whole
}

/// The corners in the plane along the greatest axis of the polygon's normal, counter-clockwise.
fn project(corners: &[Vec3]) -> Vec<DVec2> {
    let origin = corners[0].as_dvec3();
    let mut normal = DVec3::ZERO;
    let mut last = corners[corners.len() - 1].as_dvec3() - origin;
    for corner in corners {
        let corner = corner.as_dvec3() - origin;
        normal += last.cross(corner);
        last = corner;
    }
    let size = normal.abs();
    let axis = if size.x > size.y && size.x > size.z { 0 } else { 2 - (size.y > size.z) as usize };
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let turned = normal[axis] < 0.0;
    let place = |corner: &Vec3| {
        let p = corner.as_dvec3() - origin;
        if turned { DVec2::new(p[v], p[u]) } else { DVec2::new(p[u], p[v]) }
    };
    corners.iter().map(place).collect()
}

fn cut_ears(flat: &[DVec2], slack: f64, area: impl Fn([u32; 3]) -> f64, mut out: impl FnMut([u32; 3])) -> Cut {
    let count = flat.len();
    let mut next: Vec<u32> = (1..=count as u32).map(|k| k % count as u32).collect();
    let mut previous: Vec<u32> = (0..count as u32).map(|k| (k + count as u32 - 1) % count as u32).collect();
    let is_ear = |k: u32, next: &[u32], previous: &[u32]| {
        let triangle = [previous[k as usize], k, next[k as usize]];
        if area(triangle) <= slack {
            return false;
        }
        let [a, b, c] = triangle.map(|k| flat[k as usize]);
        let mut at = next[triangle[2] as usize];
        while at != triangle[0] {
            let p = flat[at as usize];
            let inside =
                (b - a).perp_dot(p - a) >= 0.0 && (c - b).perp_dot(p - b) >= 0.0 && (a - c).perp_dot(p - c) >= 0.0;
            let bulges_in = || area([previous[at as usize], at, next[at as usize]]) <= 0.0;
            // A corner at the place of one of the three may be the other side of a slit.
            if inside && p != a && p != b && p != c && bulges_in() {
                return false;
            }
            at = next[at as usize];
        }
        true
    };
    let mut ears: Vec<bool> = (0..count as u32).map(|k| is_ear(k, &next, &previous)).collect();
    let (mut at, mut left, mut looked) = (0u32, count, 0);
    while left > 3 && looked < left {
        if !ears[at as usize] {
            at = next[at as usize];
            looked += 1;
            continue;
        }
        let (before, after) = (previous[at as usize], next[at as usize]);
        out([before, at, after]);
        next[before as usize] = after;
        previous[after as usize] = before;
        for k in [before, after] {
            ears[k as usize] = is_ear(k, &next, &previous);
        }
        (at, left, looked) = (after, left - 1, 0);
    }
    let hub = at;
    let mut crossed = false;
    let mut side = next[hub as usize];
    for _ in 2..left {
        let triangle = [hub, side, next[side as usize]];
        crossed |= area(triangle) < -slack;
        out(triangle);
        side = triangle[2];
    }
    if crossed { Cut::Crossed } else { Cut::Whole }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    /// The triangles, the sum of their areas, and the least.
    fn cut(outline: &[[f32; 2]], turn: DQuat) -> (Cut, usize, f64, f64) {
        let corners: Vec<Vec3> =
            outline.iter().map(|[x, y]| (turn * DVec3::new(*x as f64, *y as f64, 0.5)).as_vec3()).collect();
        let normal = turn * DVec3::Z;
        let (mut count, mut sum, mut least) = (0, 0.0, f64::MAX);
        let state = triangulate(&corners, |triangle| {
            let [a, b, c] = triangle.map(|k| corners[k as usize].as_dvec3());
            let area = 0.5 * (b - a).cross(c - a).dot(normal);
            (count, sum, least) = (count + 1, sum + area, least.min(area));
        });
        (state, count, sum, least)
    }

    fn check(outline: &[[f32; 2]], area: f64) {
        for turn in [
            DQuat::IDENTITY,
            DQuat::from_xyzw(1.0, 0.0, 0.0, 0.0),
            DQuat::from_xyzw(0.5, 0.5, 0.5, 0.5),
            DQuat::from_xyzw(0.1, -0.7, 0.3, 0.4).normalize(),
        ] {
            for start in 0..outline.len() {
                let mut turned = outline.to_vec();
                turned.rotate_left(start);
                let (state, count, sum, least) = cut(&turned, turn);
                assert_eq!((state, count), (Cut::Whole, outline.len() - 2), "{turned:?}");
                assert!((sum - area).abs() < 1e-5 * area && least > -1e-5 * area, "{turned:?}: {sum}, {least}");
            }
        }
    }

    #[test]
    fn concave_polygons_are_covered_once_from_every_first_corner() {
        check(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], 1.0);
        // A dart, an L, a comb with two slots, corners on edges, a U.
        check(&[[0.0, 0.0], [2.0, 0.0], [0.25, 0.25], [0.0, 2.0]], 0.5);
        check(&[[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]], 3.0);
        let comb = [
            [0.0, 0.0],
            [5.0, 0.0],
            [5.0, 3.0],
            [4.0, 3.0],
            [4.0, 1.0],
            [3.0, 1.0],
            [3.0, 3.0],
            [2.0, 3.0],
            [2.0, 1.0],
            [1.0, 1.0],
            [1.0, 3.0],
            [0.0, 3.0],
        ];
        check(&comb, 11.0);
        check(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 2.0], [1.0, 1.0], [0.0, 2.0], [0.0, 1.0]], 3.0);
    }

    #[test]
    fn a_slit_to_a_hole_is_cut() {
        // A square ring, entered and left along one edge.
        let ring = [
            [0.0, 0.0],
            [3.0, 0.0],
            [3.0, 3.0],
            [0.0, 3.0],
            [0.0, 0.0],
            [1.0, 1.0],
            [1.0, 2.0],
            [2.0, 2.0],
            [2.0, 1.0],
            [1.0, 1.0],
        ];
        let (state, count, sum, least) = cut(&ring, DQuat::IDENTITY);
        assert_eq!((state, count), (Cut::Whole, 8));
        assert!((sum - 8.0).abs() < 1e-9 && least >= 0.0, "{sum}, {least}");
    }

    #[test]
    fn a_polygon_that_crosses_itself_is_told() {
        let star: Vec<[f32; 2]> = (0..5)
            .map(|k| k as f64 * 2.0 * 2.0 * std::f64::consts::TAU / 10.0)
            .map(|a| [libm::cos(a) as f32, libm::sin(a) as f32])
            .collect();
        assert_eq!(cut(&[[0.0, 0.0], [3.0, 0.0], [0.0, 1.0], [1.0, 1.0]], DQuat::IDENTITY).0, Cut::Crossed);
        assert_eq!(cut(&star, DQuat::IDENTITY).1, 3);
    }

    #[test]
    fn a_large_polygon_is_taken_if_convex_and_refused_if_not() {
        let circle = |count: usize| -> Vec<[f32; 2]> {
            let angle = |k: usize| std::f64::consts::TAU * k as f64 / count as f64;
            (0..count).map(|k| [libm::cos(angle(k)) as f32, libm::sin(angle(k)) as f32]).collect()
        };
        let (state, count, ..) = cut(&circle(100_000), DQuat::IDENTITY);
        assert_eq!((state, count), (Cut::Whole, 99_998));
        let mut dented = circle(1000);
        dented[300] = [0.0, 0.0];
        dented[700] = [0.0, 0.1];
        assert_eq!(cut(&dented, DQuat::IDENTITY), (Cut::TooLarge, 0, 0.0, f64::MAX));
    }

    #[test]
    fn a_polygon_without_area_is_cut_all_the_same() {
        assert_eq!(cut(&[[0.0, 0.0]; 6], DQuat::IDENTITY).1, 4);
        assert_eq!(cut(&[[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]], DQuat::IDENTITY).1, 2);
    }
}
