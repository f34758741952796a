//! The tree against brute force, and lines aimed at edges and corners.

use glam::{DVec3, Vec3};
use proptest::prelude::*;

use super::*;
use crate::sample::{fibonacci_sphere, hash, unit};
use crate::triangle::closest_point;

/// A closed sphere of `2 * rings * segments` triangles, wound outwards, radius 1, jittered so that no two edges align.
fn sphere(rings: usize, segments: usize) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let mut positions = vec![Vec3::Y];
    for r in 1..=rings {
        for s in 0..segments {
            let jitter = 0.2 * unit(hash((r * segments + s) as u64));
            let polar = std::f64::consts::PI * r as f64 / (rings + 1) as f64;
            let around = std::f64::consts::TAU * (s as f64 + jitter) / segments as f64;
            let (ring, y) = (libm::sin(polar), libm::cos(polar));
            positions.push(Vec3::new((ring * libm::cos(around)) as f32, y as f32, (ring * libm::sin(around)) as f32));
        }
    }
    positions.push(-Vec3::Y);
    let at = |r: usize, s: usize| (1 + r * segments + s % segments) as u32;
    let bottom = positions.len() as u32 - 1;
    let mut triangles = Vec::new();
    for s in 0..segments {
        triangles.push([0, at(0, s + 1), at(0, s)]);
        for r in 0..rings - 1 {
            triangles.push([at(r, s), at(r, s + 1), at(r + 1, s)]);
            triangles.push([at(r, s + 1), at(r + 1, s + 1), at(r + 1, s)]);
        }
        triangles.push([bottom, at(rings - 1, s), at(rings - 1, s + 1)]);
    }
    (positions, triangles)
}

/// Triangles at random: soups with slivers, repeated corners and equal faces.
fn soup() -> impl Strategy<Value = (Vec<Vec3>, Vec<[u32; 3]>)> {
    let place = prop_oneof![
        (-3i32..4, -3i32..4, -3i32..4).prop_map(|(x, y, z)| Vec3::new(x as f32, y as f32, z as f32)),
        (-3.0f32..3.0, -3.0f32..3.0, -3.0f32..3.0).prop_map(|(x, y, z)| Vec3::new(x, y, z)),
    ];
    (1usize..40).prop_flat_map(move |count| {
        let index = 0..count as u32;
        let face = [index.clone(), index.clone(), index];
        (prop::collection::vec(place.clone(), count), prop::collection::vec(face, 0..60))
    })
}

fn direction() -> impl Strategy<Value = Vec3> {
    prop_oneof![
        (-2i32..3, -2i32..3, -2i32..3).prop_map(|(x, y, z)| Vec3::new(x as f32, y as f32, z as f32)),
        (-1.0f32..1.0, -1.0f32..1.0, -1.0f32..1.0).prop_map(|(x, y, z)| Vec3::new(x, y, z)),
    ]
}

/// The tree of one triangle has no boxes to lose it in.
fn alone(positions: &[Vec3], triangle: [u32; 3], origin: Vec3, direction: Vec3) -> Option<LineHit> {
    let mut found = None;
    Bvh::new(positions, &[triangle])
        .line_hits(origin, direction, f32::NEG_INFINITY, f32::INFINITY, |hit| found = Some(hit));
    found
}

proptest! {
    #[test]
    fn the_tree_finds_what_testing_every_triangle_finds(
        (positions, triangles) in soup(),
        origin in direction(),
        direction in direction(),
        t_min in prop_oneof![Just(0.0f32), Just(-5.0), Just(f32::NEG_INFINITY)],
        t_max in prop_oneof![Just(1.0f32), Just(5.0), Just(f32::INFINITY)],
    ) {
        let bvh = Bvh::new(&positions, &triangles);
        let mut expected: Vec<LineHit> = (0..triangles.len())
            .filter_map(|f| alone(&positions, triangles[f], origin, direction).map(|hit| LineHit { face: f as u32, ..hit }))
            .filter(|hit| (t_min..=t_max).contains(&hit.t))
            .collect();
        let mut found = Vec::new();
        bvh.line_hits(origin, direction, t_min, t_max, |hit| found.push(hit));
        found.sort_by_key(|hit| hit.face);
        prop_assert_eq!(&found, &expected);
        expected.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.face.cmp(&b.face)));
        let closest = bvh.closest_hit(origin, direction, t_min, t_max);
        // -0 and 0 are one distance.
        let least = expected.first().map(|hit| hit.t);
        prop_assert_eq!(closest.map(|hit| hit.t), least);
        prop_assert_eq!(
            closest.map(|hit| hit.face),
            expected.iter().filter(|hit| Some(hit.t) == least).map(|hit| hit.face).min()
        );
    }

    #[test]
    fn a_line_is_occluded_where_it_has_a_closest_hit(
        (positions, triangles) in soup(),
        origin in direction(),
        direction in direction(),
        (t_min, length) in (-2.0f32..2.0, 0.0f32..3.0),
    ) {
        let bvh = Bvh::new(&positions, &triangles);
        let closest = bvh.closest_hit(origin, direction, t_min, t_min + length);
        prop_assert_eq!(bvh.occluded(origin, direction, t_min, t_min + length), closest.is_some());
        // Up to the hit itself, and up to just before it.
        if let Some(hit) = bvh.closest_hit(origin, direction, t_min, f32::INFINITY) {
            prop_assert!(bvh.occluded(origin, direction, t_min, hit.t));
            let before = if hit.t > 0.0 { hit.t.next_down() } else { hit.t.next_up() };
            if before >= t_min && before < hit.t {
                prop_assert!(!bvh.occluded(origin, direction, t_min, before));
            }
        }
    }

    #[test]
    fn a_hit_lies_on_the_line_and_on_the_triangle(
        (positions, triangles) in soup(), origin in direction(), direction in direction(),
    ) {
        Bvh::new(&positions, &triangles).line_hits(origin, direction, -100.0, 100.0, |hit| {
            let [a, b, c] = triangles[hit.face as usize].map(|v| positions[v as usize]);
            let on_triangle = hit.bary[0] * a + hit.bary[1] * b + hit.bary[2] * c;
            let on_line = origin + hit.t * direction;
            assert!((on_triangle - on_line).length() < 1e-3 * (1.0 + on_line.length()), "{hit:?}");
            assert!(hit.bary.iter().all(|w| (0.0..=1.0).contains(w)), "{hit:?}");
        });
    }

    #[test]
    fn the_nearest_point_is_the_nearest_of_all_triangles((positions, triangles) in soup(), p in direction()) {
        let found = Bvh::new(&positions, &triangles).nearest_point(p * 4.0);
        let mut best: Option<(f64, u32)> = None;
        for (f, t) in triangles.iter().enumerate() {
            let [a, b, c] = t.map(|v| positions[v as usize].as_dvec3());
            let d = closest_point((p * 4.0).as_dvec3(), a, b, c).distance_squared;
            if best.is_none_or(|(least, _)| d < least) {
                best = Some((d, f as u32));
            }
        }
        prop_assert_eq!(found.map(|n| n.face), best.map(|(_, face)| face));
        prop_assert_eq!(found.map(|n| n.distance), best.map(|(d, _)| d.sqrt() as f32));
    }

    #[test]
    fn a_limit_keeps_what_lies_within_and_nothing_else(
        (positions, triangles) in soup(), p in direction(), limit in 0.0f32..4.0,
    ) {
        let bvh = Bvh::new(&positions, &triangles);
        let whole = bvh.nearest_point(p);
        let within = bvh.nearest_point_within(p, limit);
        if whole.is_some_and(|n| (n.distance - limit).abs() > 1e-6) {
            prop_assert_eq!(within, whole.filter(|n| n.distance <= limit));
        }
    }

    #[test]
    fn a_hint_changes_no_answer((positions, triangles) in soup(), walk in prop::collection::vec(direction(), 1..20)) {
        let bvh = Bvh::new(&positions, &triangles);
        let (mut near, mut beyond) = (Hint::default(), Hint::default());
        for p in walk {
            let whole = bvh.nearest_point(p * 3.0);
            prop_assert_eq!(bvh.nearest_point_from(p * 3.0, &mut near), whole);
            let distance = whole.map(|n| n.distance);
            for limit in [0.0, 0.5, distance.unwrap_or(1.0), 2.0, f32::INFINITY] {
                let expected = distance.filter(|d| *d > limit);
                // At the distance itself its rounding decides.
                if distance != Some(limit) {
                    let within = distance.is_some_and(|d| d < limit);
                    prop_assert_eq!(bvh.is_within(p * 3.0, limit, &mut beyond), within);
                }
                for centre in [p * 3.0, Vec3::splat(9.0)] {
                    let mut nearby = Nearby::default();
                    bvh.gather(centre - 0.5, centre + 0.5, limit, &mut nearby);
                    prop_assert_eq!(bvh.distance_beyond(p * 3.0, limit, &mut nearby, &mut beyond), expected);
                }
            }
        }
    }

    #[test]
    fn all_that_is_near_a_box_is_gathered(
        (positions, triangles) in soup(), a in direction(), b in direction(), limit in 0.0f32..1.0,
    ) {
        let bvh = Bvh::new(&positions, &triangles);
        let (lo, hi) = (a.min(b), a.max(b));
        let mut nearby = Nearby::default();
        bvh.gather(lo, hi, limit, &mut nearby);
        let gathered = bvh.gathered(&nearby);
        for corner in [lo, hi, 0.5 * (lo + hi), Vec3::new(lo.x, hi.y, lo.z)] {
            let Some(near) = bvh.nearest_point_within(corner, limit) else { continue };
            let least = gathered
                .iter()
                .map(|f| triangles[*f as usize].map(|v| positions[v as usize].as_dvec3()))
                .map(|[a, b, c]| closest_point(corner.as_dvec3(), a, b, c).distance_squared.sqrt() as f32)
                .fold(f32::INFINITY, f32::min);
            prop_assert!(least == near.distance, "{least} of those gathered, {} of all", near.distance);
        }
    }

    #[test]
    fn boxes_that_meet_are_all_found((positions, triangles) in soup(), a in direction(), b in direction()) {
        let (lo, hi) = (a.min(b) * 3.0, a.max(b) * 3.0);
        let mut found = Vec::new();
        Bvh::new(&positions, &triangles).overlapping(lo, hi, |face| found.push(face));
        found.sort_unstable();
        let expected: Vec<u32> = (0..triangles.len() as u32)
            .filter(|f| {
                let [a, b, c] = triangles[*f as usize].map(|v| positions[v as usize]);
                a.min(b).min(c).cmple(hi).all() && a.max(b).max(c).cmpge(lo).all()
            })
            .collect();
        prop_assert_eq!(found, expected);
    }

    #[test]
    fn a_triangle_with_a_point_in_the_prism_is_found(
        (positions, triangles) in soup(),
        corners in [direction(), direction(), direction()],
        below in 0.0f32..2.0,
        above in 0.0f32..2.0,
    ) {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        prop_assume!(normal != Vec3::ZERO);
        let mut found = Vec::new();
        Bvh::new(&positions, &triangles).overlapping_prism(corners, normal, below, above, &mut found);
        prop_assert!(found.is_sorted());
        let inside = |p: DVec3| {
            let [a, b, c] = corners.map(Vec3::as_dvec3);
            let n = normal.as_dvec3();
            let k = (p - a).dot(n);
            let on_side = |from: DVec3, to: DVec3| (to - from).cross(p - from).dot(n) >= 0.0;
            k >= -below as f64 && k <= above as f64 && on_side(a, b) && on_side(b, c) && on_side(c, a)
        };
        for (f, t) in triangles.iter().enumerate() {
            let [a, b, c] = t.map(|v| positions[v as usize].as_dvec3());
            let meets = (0..=8).any(|i| (0..=8 - i).any(|j| {
                inside(a + (b - a) * (i as f64 / 8.0) + (c - a) * (j as f64 / 8.0))
            }));
            prop_assert!(!meets || found.contains(&(f as u32)), "face {f} has a point in the prism");
        }
    }
}

#[test]
fn a_line_from_inside_a_closed_mesh_never_slips_out() {
    let (positions, triangles) = sphere(23, 40);
    let bvh = Bvh::new(&positions, &triangles);
    let origins = [Vec3::ZERO, Vec3::new(0.31, -0.2, 0.47), Vec3::new(0.0, 0.5, 0.0)];
    let mut lines = 0;
    for origin in origins {
        let mut check = |target: Vec3| {
            lines += 1;
            assert!(bvh.closest_hit(origin, target - origin, 0.0, f32::INFINITY).is_some(), "{origin} to {target}");
        };
        positions.iter().copied().for_each(&mut check);
        for t in &triangles {
            for k in 0..3 {
                let (a, b) = (positions[t[k] as usize], positions[t[(k + 1) % 3] as usize]);
                [0.5, 0.25, 0.1, 1.0 / 3.0, 0.77].into_iter().for_each(|s| check(a + s * (b - a)));
            }
        }
        fibonacci_sphere(5000).into_iter().for_each(|d| check(origin + d));
    }
    assert!(lines > 80_000, "{lines}");
}

#[test]
fn a_line_from_far_away_through_a_closed_mesh_meets_it_twice() {
    let (positions, triangles) = sphere(23, 40);
    let bvh = Bvh::new(&positions, &triangles);
    // At a distance of 10,000 radii one rounding of the origin is 1e-3: the aim is what f32 makes of it, but never between
    // two triangles.
    for (k, direction) in fibonacci_sphere(400).into_iter().enumerate() {
        let origin = direction * [3.0, 100.0, 10_000.0][k % 3];
        for target in positions.iter().filter(|p| p.dot(direction).abs() < 0.5).step_by(37) {
            // Half the way to the middle, so that the line passes well inside the silhouette.
            let target = *target * 0.5;
            let mut sides = [false; 2];
            bvh.line_hits(origin, target - origin, 0.0, 10.0, |hit| sides[usize::from(hit.t > 1.0)] = true);
            assert_eq!(sides, [true; 2], "{origin} to {target}");
        }
    }
}

#[test]
fn lines_along_the_axes_meet_faces_of_a_cube_at_edges_and_corners() {
    let corner = |k: u32| Vec3::new((k & 1) as f32, (k >> 1 & 1) as f32, (k >> 2 & 1) as f32);
    let positions: Vec<Vec3> = (0..8).map(corner).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    let bvh = Bvh::new(&positions, &triangles);
    for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
        for sign in [1.0, -1.0] {
            for (s, t) in [(0.5, 0.5), (0.0, 0.0), (1.0, 1.0), (0.0, 0.5), (0.25, 0.25), (1.0, 0.3)] {
                let (u, v) = (Vec3::new(axis.y, axis.z, axis.x), Vec3::new(axis.z, axis.x, axis.y));
                let origin = axis * (0.5 - 3.0 * sign) + u * s + v * t;
                let hit = bvh.closest_hit(origin, axis * sign, 0.0, f32::INFINITY).expect("the cube is in the way");
                assert_eq!(hit.t, 2.5, "{origin} along {axis}");
            }
        }
    }
}

#[test]
fn equal_hits_go_to_the_lower_face() {
    let positions = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let bvh = Bvh::new(&positions, &[[0, 1, 2]; 20]);
    let hit = bvh.closest_hit(Vec3::new(0.2, 0.2, 1.0), -Vec3::Z, 0.0, 2.0).expect("hit");
    assert_eq!((hit.face, hit.t), (0, 1.0));
    assert_eq!(bvh.nearest_point(Vec3::ONE).expect("near").face, 0);
}

#[test]
fn corners_that_are_no_numbers_are_left_out_and_no_triangle_is_no_answer() {
    let empty = Bvh::new(&[], &[]);
    assert_eq!(empty.closest_hit(Vec3::ZERO, Vec3::X, 0.0, 1.0), None);
    assert_eq!(empty.nearest_point(Vec3::ZERO), None);
    assert_eq!(empty.nearest_point_from(Vec3::ZERO, &mut Hint::default()), None);
    assert!(!empty.is_within(Vec3::ZERO, 9.0, &mut Hint::default()));
    assert_eq!(empty.distance_beyond(Vec3::ZERO, 0.0, &mut Nearby::default(), &mut Hint::default()), None);
    assert_eq!(empty.bounds(), None);
    let positions = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::NAN, Vec3::INFINITY];
    let bvh = Bvh::new(&positions, &[[0, 1, 3], [0, 1, 2], [4, 1, 2]]);
    assert_eq!(bvh.face_count(), 1);
    assert_eq!(bvh.nearest_point(Vec3::Z).map(|n| n.face), Some(1));
    for bad in [Vec3::ZERO, Vec3::NAN, Vec3::INFINITY] {
        assert_eq!(bvh.closest_hit(Vec3::Z, bad, 0.0, 1.0), None);
    }
    assert_eq!(bvh.nearest_point(Vec3::NAN), None);
    assert_eq!(bvh.nearest_point_from(Vec3::NAN, &mut Hint::default()), None);
    assert!(!bvh.is_within(Vec3::NAN, 9.0, &mut Hint::default()));
    assert_eq!(bvh.distance_beyond(Vec3::NAN, 0.0, &mut Nearby::default(), &mut Hint::default()), None);
}

#[test]
fn coordinates_of_any_size_build_and_answer() {
    for scale in [1e-18f32, 1e-6, 1.0, 1e6, 1e17] {
        let (mut positions, triangles) = sphere(7, 9);
        positions.iter_mut().for_each(|p| *p *= scale);
        let bvh = Bvh::new(&positions, &triangles);
        for d in fibonacci_sphere(200) {
            let hit = bvh.closest_hit(Vec3::ZERO, d, 0.0, f32::INFINITY).expect("closed");
            assert!((hit.t / scale - 0.95).abs() < 0.1, "{} at {scale}", hit.t / scale);
            let near = bvh.nearest_point(d * 2.0 * scale).expect("near");
            assert!((near.distance / scale - 1.0).abs() < 0.1);
        }
    }
}

#[test]
fn flat_and_single_point_meshes_build() {
    let flat: Vec<Vec3> = (0..100).map(|k| Vec3::new((k % 10) as f32, 0.0, (k / 10) as f32)).collect();
    let triangles: Vec<[u32; 3]> = (0..89u32).map(|k| [k, k + 1, k + 10]).collect();
    assert!(Bvh::new(&flat, &triangles).closest_hit(Vec3::new(0.2, 1.0, 0.2), -Vec3::Y, 0.0, 2.0).is_some());
    let point = [Vec3::ONE];
    assert_eq!(Bvh::new(&point, &[[0; 3]; 50]).nearest_point(Vec3::ZERO).map(|n| n.face), Some(0));
}

#[test]
fn the_tree_is_the_same_on_any_thread_count() {
    let (positions, triangles) = sphere(60, 80);
    let build = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        pool.install(|| Bvh::new(&positions, &triangles))
    };
    let (one, four) = (build(1), build(4));
    assert_eq!(one.nodes, four.nodes);
    assert_eq!(one.faces, four.faces);
    assert_eq!(one.corners, four.corners);
}

#[test]
fn every_triangle_lies_in_one_leaf_and_in_all_boxes_above() {
    let (positions, triangles) = sphere(20, 30);
    let bvh = Bvh::new(&positions, &triangles);
    let mut faces = bvh.faces.clone();
    faces.sort_unstable();
    assert!(faces.iter().copied().eq(0..triangles.len() as u32));
    for (k, node) in bvh.nodes.iter().enumerate() {
        if node.count == 0 {
            for child in &bvh.nodes[node.first as usize..node.first as usize + 2] {
                assert!(child.lo.cmpge(node.lo).all() && child.hi.cmple(node.hi).all(), "node {k}");
            }
        }
    }
}
