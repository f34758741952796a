//! Covered once: no gap and no overlap, and coordinates that say where a texel lies.

use std::collections::BTreeMap;

use glam::Vec2;
use proptest::prelude::*;

use super::*;

fn covered(corners: [Vec2; 3], width: u32, height: u32) -> BTreeMap<(u32, u32), [f32; 3]> {
    let mut texels = BTreeMap::new();
    rasterise(corners, width, height, |x, y, bary| {
        assert!(texels.insert((x, y), bary).is_none(), "({x}, {y}) visited twice");
    });
    texels
}

/// The plain definition, texel by texel.
fn by_definition(corners: [Vec2; 3], width: u32, height: u32) -> Vec<(u32, u32)> {
    let Some([a, b, c]) = snap(corners) else { return Vec::new() };
    let cross = |o: [i64; 2], p: [i64; 2], q: [i64; 2]| (p[0] - o[0]) * (q[1] - o[1]) - (p[1] - o[1]) * (q[0] - o[0]);
    let ring = if cross(a, b, c) < 0 { [a, c, b] } else { [a, b, c] };
    if cross(a, b, c) == 0 {
        return Vec::new();
    }
    let mut out = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let centre = [x as i64 * SUBTEXEL + 128, y as i64 * SUBTEXEL + 128];
            let inside = (0..3).all(|k| {
                let (from, to) = (ring[k], ring[(k + 1) % 3]);
                let owns = to[1] < from[1] || (to[1] == from[1] && to[0] > from[0]);
                let side = cross(from, to, centre);
                side > 0 || (side == 0 && owns)
            });
            if inside {
                out.push((x, y));
            }
        }
    }
    out
}

fn corner() -> impl Strategy<Value = Vec2> {
    prop_oneof![
        // Centres and texel corners: edges through centres are the hard case.
        (-6i32..40, -6i32..40).prop_map(|(x, y)| Vec2::new(x as f32 * 0.5, y as f32 * 0.5)),
        (-5.0f32..25.0, -5.0f32..25.0).prop_map(|(x, y)| Vec2::new(x, y)),
    ]
}

proptest! {
    #[test]
    fn the_spans_are_those_of_the_definition(a in corner(), b in corner(), c in corner()) {
        let found: Vec<_> = covered([a, b, c], 17, 16).into_keys().collect();
        let mut expected = by_definition([a, b, c], 17, 16);
        expected.sort_unstable();
        prop_assert_eq!(found, expected);
    }

    #[test]
    fn barycentric_coordinates_give_the_centre_back(a in corner(), b in corner(), c in corner()) {
        for ((x, y), bary) in covered([a, b, c], 20, 20) {
            let at = bary[0] * a + bary[1] * b + bary[2] * c;
            // Corners move by up to half of 1/256 in each coordinate.
            prop_assert!((at - Vec2::new(x as f32 + 0.5, y as f32 + 0.5)).abs().max_element() < 0.003);
            prop_assert!((bary.iter().sum::<f32>() - 1.0).abs() < 1e-6);
            prop_assert!(bary.iter().all(|w| (0.0..=1.0).contains(w)));
        }
    }

    #[test]
    fn the_winding_changes_nothing_but_the_order(a in corner(), b in corner(), c in corner()) {
        let one = covered([a, b, c], 20, 20);
        let other: BTreeMap<_, _> =
            covered([a, c, b], 20, 20).into_iter().map(|(at, [p, q, r])| (at, [p, r, q])).collect();
        prop_assert_eq!(one, other);
    }

    #[test]
    fn a_triangulated_square_with_a_point_anywhere_is_covered_once(p in corner()) {
        // A fan around an inner point; the square's sides lie on centres, so its own edges are on trial too.
        let p = p.clamp(Vec2::splat(1.0), Vec2::splat(15.0));
        let ring = [Vec2::new(0.5, 0.5), Vec2::new(16.5, 0.5), Vec2::new(16.5, 16.5), Vec2::new(0.5, 16.5)];
        let mut count = vec![0; 20 * 20];
        for k in 0..4 {
            rasterise([ring[k], ring[(k + 1) % 4], p], 20, 20, |x, y, _| count[(y * 20 + x) as usize] += 1);
        }
        for y in 0..20 {
            for x in 0..20 {
                // Top-left: the square from 0.5 to 16.5 owns centres 0.5 up to, not with, 16.5.
                prop_assert_eq!(count[y * 20 + x], i32::from(x < 16 && y < 16), "({}, {})", x, y);
            }
        }
    }

    #[test]
    fn a_random_mesh_of_the_plane_has_no_gap_and_no_double(
        shifts in prop::collection::vec((-0.45f32..0.45, -0.45f32..0.45, any::<bool>()), 36),
    ) {
        // A 5 x 5 grid of quads over 32 texels with shaken inner points and random diagonals.
        let at = |i: usize, j: usize| {
            let (sx, sy, _) = shifts[j * 6 + i];
            let inner = |k: usize, s: f32| if k == 0 || k == 5 { 0.0 } else { s };
            Vec2::new(i as f32 + inner(i, sx), j as f32 + inner(j, sy)) * 6.4
        };
        let mut count = vec![0; 32 * 32];
        for j in 0..5 {
            for i in 0..5 {
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                // Only a diagonal that keeps both triangles upright cuts the quad in two.
                let cross = |p: Vec2, q: Vec2, r: Vec2| (q - p).perp_dot(r - p);
                let ac = cross(a, b, c) > 0.01 && cross(a, c, d) > 0.01;
                let bd = cross(a, b, d) > 0.01 && cross(b, c, d) > 0.01;
                let pair = match (shifts[j * 6 + i].2 || !bd, ac, bd) {
                    (true, true, _) => [[a, b, c], [a, c, d]],
                    (_, _, true) => [[a, b, d], [b, c, d]],
                    _ => return Err(TestCaseError::reject("a quad that no diagonal cuts")),
                };
                for t in pair {
                    rasterise(t, 32, 32, |x, y, _| count[(y * 32 + x) as usize] += 1);
                }
            }
        }
        prop_assert!(count.iter().all(|c| *c == 1));
    }

    #[test]
    fn tiles_see_the_texels_of_the_whole_picture(a in corner(), b in corner(), c in corner()) {
        let whole = covered([a, b, c], 20, 20);
        let mut tiles = BTreeMap::new();
        for (x0, x1) in [(0, 7), (7, 8), (8, 20)] {
            for (y0, y1) in [(0, 11), (11, 20)] {
                rasterise_rect([a, b, c], Rect { x0, y0, x1, y1 }, |x, y, bary| {
                    tiles.insert((x, y), bary);
                });
            }
        }
        prop_assert_eq!(whole, tiles);
    }
}

#[test]
fn a_known_triangle_covers_known_texels() {
    let corners = [Vec2::new(0.0, 0.0), Vec2::new(4.0, 0.0), Vec2::new(0.0, 4.0)];
    let texels: Vec<_> = covered(corners, 8, 8).into_keys().collect();
    // The hypotenuse x + y = 4 passes through centres, is neither top nor left, and so owns none of them.
    assert_eq!(texels, [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 0)]);
    let mut exact = Vec::new();
    rasterise_exact(corners, Rect::whole(8, 8), |x, y, weights, area| exact.push((x, y, weights, area)));
    assert_eq!(exact[0], (0, 0, [1024 * 768, 1024 * 128, 1024 * 128], 1024 * 1024));
}

#[test]
fn degenerate_infinite_and_distant_triangles_do_no_harm() {
    let none = |corners: [Vec2; 3]| assert!(covered(corners, 4, 4).is_empty(), "{corners:?}");
    none([Vec2::ZERO, Vec2::splat(2.0), Vec2::splat(4.0)]);
    none([Vec2::ONE; 3]);
    none([Vec2::ZERO, Vec2::new(f32::NAN, 1.0), Vec2::ONE]);
    none([Vec2::splat(1e9), Vec2::new(2e9, 1e9), Vec2::new(1e9, 2e9)]);
    // Half the plane, right of the diagonal, which as a left edge owns the centres on it.
    let huge = [Vec2::new(-1e30, -1e30), Vec2::new(f32::INFINITY, -1e30), Vec2::new(1e30, f32::INFINITY)];
    assert!(covered(huge, 4, 4).into_keys().eq((0..4).flat_map(|x| (0..=x).map(move |y| (x, y)))));
}
