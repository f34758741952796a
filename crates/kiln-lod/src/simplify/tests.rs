use glam::Vec3;
use kiln_asset::{BlobError, RawMesh};
use proptest::prelude::*;

use super::*;
use crate::fixtures;
use crate::topology::{PointKind, Topology};

fn cut(mesh: &Mesh, budget: Budget) -> (Mesh, LevelReport) {
    let sequence = collapse(mesh, &[], None, &SimplifyOptions::default());
    let (mut set, mut report) =
        levels(mesh, &[], &sequence, mesh, &[budget], &LevelsOptions { samples: 20_000, ..LevelsOptions::default() });
    (set.levels.remove(0).mesh, report.levels.remove(0))
}

#[test]
fn a_subdivided_cube_collapses_back_to_twelve_faces_without_error() {
    let (level, report) = cut(&fixtures::hard_cube(8), Budget::Triangles(12));
    assert_eq!(level.face_count(), 12);
    assert_eq!(report.short, None);
    assert!(report.error < 1e-6 && report.metric_error < 1e-6, "{report:?}");
}

#[test]
fn a_closed_sphere_without_budget_ends_as_a_tetrahedron() {
    let mut options = SimplifyOptions { turn_cosine: -1.0, sliver: 0.0, ..Default::default() };
    options.length_weight = 1e-6;
    let mesh = fixtures::sphere(24, 16);
    let sequence = collapse(&mesh, &[], None, &options);
    assert_eq!(sequence.report().faces_left, 4, "{:?}", sequence.report());
}

#[test]
fn a_flat_grid_collapses_to_two_faces_and_keeps_its_border() {
    let (level, report) = cut(&fixtures::grid(12, 9), Budget::Triangles(2));
    assert_eq!(level.face_count(), 2, "{report:?}");
    assert!(report.error < 1e-6, "the rectangle is still the rectangle: {report:?}");
}

/// Mean distance of points spread over the level from the unit sphere.
fn mean_off_sphere(level: &Mesh) -> f64 {
    let samples = kiln_geom::sample::SurfaceSamples::new(&level.positions, &level.triangles, 20_000, 3);
    let off = |p: Vec3| (f64::from(p.length()) - 1.0).abs();
    samples.samples.iter().map(|s| off(s.position)).sum::<f64>() / samples.samples.len() as f64
}

#[test]
fn free_placement_brings_a_sphere_s_levels_nearer_to_it() {
    let mesh = fixtures::sphere(96, 64);
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    for faces in [3000, 600, 120] {
        let [half, free] = [Placement::HalfEdge, Placement::Free].map(|p| super::cut(&mesh, &[], &sequence, faces, p));
        assert_eq!((&half.points, half.face_count()), (&free.points, free.face_count()), "the log decides the points");
        let (half, free) = (mean_off_sphere(&half), mean_off_sphere(&free));
        assert!(free < 0.75 * half, "{faces} faces: {free:e} for {half:e}");
    }
}

#[test]
fn an_important_half_keeps_more_of_its_points() {
    let wavy = |x: f32, y: f32| (x * 0.7).sin() * 0.3 + (y * 0.9).cos() * 0.2;
    let plain = fixtures::field(40, 40, wavy);
    let mut raw = plain.clone().into_raw();
    raw.importance = Some(raw.positions.iter().map(|p| if p.x < 20.0 { 30.0 } else { 1.0 }).collect());
    let important = Mesh::new(raw).unwrap();
    for options in [SimplifyOptions::default(), memoryless()] {
        let left = |mesh: &Mesh| {
            let level = simplify(mesh, 400, Placement::Free, &options);
            level.positions.iter().filter(|p| p.x < 20.0).count() as f64 / level.vertex_count() as f64
        };
        let (before, after) = (left(&plain), left(&important));
        assert!((0.4..0.6).contains(&before) && after > 0.62, "{before} became {after}");
    }
}

/// A bumpy sheet whose UVs and colours follow x and y, so that every wrong attribute shows.
fn painted_field() -> Mesh {
    let mut raw = fixtures::field(48, 48, |x, y| (x * 0.3).sin() * (y * 0.2).cos()).into_raw();
    let uv = |p: &Vec3| glam::Vec2::new(p.x, p.y) / 48.0;
    raw.uv0 = Some(raw.positions.iter().map(uv).collect());
    raw.colors = Some(raw.positions.iter().map(|p| glam::Vec4::new(p.x / 48.0, p.y / 48.0, 0.5, 1.0)).collect());
    Mesh::new(raw).unwrap()
}

#[test]
fn free_placement_takes_attributes_along_and_flips_nothing() {
    let mesh = painted_field();
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let free = super::cut(&mesh, &[], &sequence, 300, Placement::Free);
    let half = super::cut(&mesh, &[], &sequence, 300, Placement::HalfEdge);
    let moved = free.positions.iter().zip(&half.positions).filter(|(a, b)| a != b).count();
    assert!(moved > free.vertex_count() / 2, "{moved} of {} points moved", free.vertex_count());
    for (p, (uv, color)) in
        free.positions.iter().zip(free.uv0.as_ref().unwrap().iter().zip(free.colors.as_ref().unwrap()))
    {
        let expected = glam::Vec2::new(p.x, p.y) / 48.0;
        // A point that moves off its faces takes the nearest place on them: a hundredth of the sheet is half a coarse face.
        let inside = uv.max(glam::Vec2::ZERO);
        assert!(
            uv.distance(expected) < 0.01 && color.truncate().truncate().distance(inside) < 1e-5,
            "{p}: {uv}, {color}"
        );
    }
    let uvs = free.uv0.as_ref().unwrap();
    for triangle in &free.triangles {
        let [a, b, c] = triangle.map(|v| free.positions[v as usize]);
        assert!((b - a).cross(c - a).z > 0.0, "a face turned over");
        let [a, b, c] = triangle.map(|v| uvs[v as usize]);
        assert!((b - a).perp_dot(c - a) > 0.0, "a face turned over in the UV plane");
    }
}

#[test]
fn free_placement_splits_no_point_and_holds_the_course_of_boundaries() {
    let mesh = fixtures::merged_pair(24, 20);
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    assert_eq!(super::cut(&mesh, &[], &sequence, mesh.face_count() as u32, Placement::Free), mesh);
    let free = super::cut(&mesh, &[], &sequence, 200, Placement::Free);
    let half = super::cut(&mesh, &[], &sequence, 200, Placement::HalfEdge);
    assert_eq!((&free.points, free.face_count()), (&half.points, half.face_count()), "no point is split");
    for (p, first) in free.points.iter().zip(0..) {
        let joined = free.points.iter().position(|q| q == p).unwrap();
        let apart = free.positions[joined].distance(free.positions[first]);
        assert!(apart < 1e-6, "wedges of one point stand {apart} apart");
    }
    let on_boundary = |mesh: &Mesh| -> Vec<Vec3> {
        let kinds = Topology::new(mesh).kinds;
        let boundary = |v: &usize| kinds[mesh.points[*v].index()] == PointKind::Boundary;
        (0..mesh.vertex_count()).filter(boundary).map(|v| mesh.positions[v]).collect()
    };
    // It lies in a plane, and waves in that: the fit may follow the waves, but not leave the plane.
    let source = on_boundary(&mesh);
    assert!(source.iter().all(|p| p.x == source[0].x));
    for p in on_boundary(&free) {
        assert!((p.x - source[0].x).abs() < 0.01, "{p} has left the boundary");
        let wave = (p.x * 0.7).sin() * 0.3 + (p.y * 0.9).cos() * 0.2;
        assert!((p.z - wave).abs() < 0.2, "{p} has left the boundary's wave");
    }
}

#[test]
fn seams_of_an_atlas_stay_and_untouched_points_too() {
    let mut raw = fixtures::slit_grid().into_raw();
    raw.atlas_uv = raw.uv0.clone();
    let mesh = Mesh::new(raw).unwrap();
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let faces = mesh.face_count() as u32 / 2;
    let free = super::cut(&mesh, &[], &sequence, faces, Placement::Free);
    let half = super::cut(&mesh, &[], &sequence, faces, Placement::HalfEdge);
    let kinds = Topology::new(&half).kinds;
    let mut seen = 0;
    for v in 0..half.vertex_count() {
        if matches!(kinds[half.points[v].index()], PointKind::Seam | PointKind::Locked) {
            assert_eq!(free.positions[v].to_array().map(f32::to_bits), half.positions[v].to_array().map(f32::to_bits));
            seen += 1;
        }
    }
    assert!(seen > 2, "{seen} seam vertices");
}

#[test]
fn an_error_budget_holds_for_placed_levels_too() {
    let mesh = painted_field();
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let options = LevelsOptions { placement: Placement::Free, samples: 20_000, ..LevelsOptions::default() };
    let (set, report) = levels(&mesh, &[], &sequence, &mesh, &[Budget::Error(0.05), Budget::Error(0.2)], &options);
    for (level, asked) in set.levels.iter().zip([0.05, 0.2]) {
        assert!(level.error <= asked && surface_error(&mesh, &level.mesh, 20_000) <= asked, "{report:?}");
    }
    let (again, _) = levels(&mesh, &[], &sequence, &mesh, &[Budget::Error(0.05), Budget::Error(0.2)], &options);
    assert_eq!(set, again);
}

#[test]
fn nothing_asked_gives_the_mesh_back_bit_for_bit() {
    let mesh = fixtures::merged_pair(6, 5);
    let (level, report) = cut(&mesh, Budget::Keep(1.0));
    assert_eq!(level, mesh);
    assert_eq!(report.error, 0.0);
}

#[test]
fn budgets_are_met_and_never_exceeded() {
    let mesh = fixtures::sphere(40, 30);
    for asked in [1000, 517, 100, 40] {
        let (level, report) = cut(&mesh, Budget::Triangles(asked));
        let reached = level.face_count() as u32;
        assert!(reached <= asked && reached + 2 > asked, "{reached} for {asked}: {report:?}");
    }
}

#[test]
fn an_error_budget_holds_when_it_is_measured() {
    let mesh = fixtures::field(40, 40, |x, y| (x * 0.3).sin() * (y * 0.2).cos());
    let (level, report) = cut(&mesh, Budget::Error(0.05));
    assert!(report.error <= 0.05, "{report:?}");
    assert!(level.face_count() < mesh.face_count() / 2, "and something was gained: {report:?}");
    assert!(surface_error(&mesh, &level, 50_000) <= 0.055, "other sample points agree");
}

#[test]
fn boundaries_stay_joined_and_every_level_keeps_both_submeshes() {
    let mesh = fixtures::merged_pair(24, 18);
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let budgets = [Budget::Keep(0.5), Budget::Keep(0.1), Budget::Keep(0.03)];
    let (set, report) = levels(&mesh, &[], &sequence, &mesh, &budgets, &LevelsOptions::default());
    for (level, report) in set.levels.iter().zip(&report.levels) {
        assert_eq!(report.gaps, 0);
        assert_eq!(crate::check::gaps(&mesh, &level.mesh), 0);
        assert_eq!(level.mesh.submeshes, mesh.submeshes);
        assert!(report.submeshes.iter().all(|n| *n > 0), "{report:?}");
        assert_eq!(level.quadrics.len(), level.mesh.point_count());
    }
    assert!(report.levels.windows(2).all(|w| w[0].error <= w[1].error));
}

#[test]
fn an_opened_boundary_is_found_as_a_gap() {
    let mesh = fixtures::merged_pair(6, 5);
    let mut raw = mesh.clone().into_raw();
    raw.points.clear();
    let apart = Mesh::new(raw).unwrap();
    assert!(crate::check::gaps(&mesh, &apart) > 0, "the check can fail");
}

#[test]
fn a_later_stage_goes_on_from_the_forms_of_the_earlier() {
    let mesh = fixtures::field(30, 30, |x, y| (x * 0.3).sin() * (y * 0.2).cos());
    let options = SimplifyOptions::default();
    let sequence = collapse(&mesh, &[], None, &options);
    let budgets = [Budget::Triangles(600), Budget::Triangles(100)];
    let (direct, _) = levels(&mesh, &[], &sequence, &mesh, &budgets, &LevelsOptions::default());
    let half = &direct.levels[0];
    let onward = collapse(&half.mesh, &half.quadrics, None, &options);
    let (second, _) =
        levels(&half.mesh, &half.quadrics, &onward, &mesh, &[Budget::Triangles(100)], &LevelsOptions::default());
    let (one, two) = (direct.levels[1].error, second.levels[0].error);
    assert!(two <= 1.5 * one, "in two stages {two}, in one {one}");
}

#[test]
fn one_thread_and_four_give_the_same_levels() {
    let mesh = fixtures::field(40, 30, |x, y| (x * 0.5).sin() + (y * 0.3).cos());
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
            let (set, report) = levels(&mesh, &[], &sequence, &mesh, &[Budget::Keep(0.2)], &LevelsOptions::default());
            (sequence.to_blob(), set.to_blob(), report)
        })
    };
    assert_eq!(run(1), run(4));
}

#[test]
fn a_sequence_blob_comes_back_and_no_prefix_or_flip_panics() {
    let mesh = fixtures::sphere(8, 6);
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let blob = sequence.to_blob();
    assert_eq!(CollapseSequence::from_blob(&blob).unwrap(), sequence);
    for end in 0..blob.len() {
        assert!(CollapseSequence::from_blob(&blob[..end]).is_err());
    }
    for at in 0..blob.len() {
        let mut flipped = blob.clone();
        flipped[at] ^= 0x81;
        let read: Result<CollapseSequence, BlobError> = CollapseSequence::from_blob(&flipped);
        if let Ok(read) = read {
            // A flip that keeps every promise of the blob may still be another mesh's sequence: an error, never a panic.
            let _ = read.replay(&mesh, read.collapses.len());
        }
    }
}

#[test]
fn chart_borders_stay_within_half_the_padding() {
    let mut raw = fixtures::hard_cube(12).into_raw();
    raw.atlas_uv = raw.uv0.as_ref().map(|uv| uv.iter().map(|t| *t / 6.0).collect());
    let mesh = Mesh::new(raw).unwrap();
    let layout = UvLayout { size: 256, padding: 4, chart_count: 6, sheets: 1 };
    let sequence = collapse(&mesh, &[], Some(&layout), &SimplifyOptions::default());
    assert_eq!(sequence.report().faces_left, 12, "straight chart borders may go: {:?}", sequence.report());
    // Bend the borders in the layout by more than half the padding: now their points have to stay.
    let mut raw = mesh.into_raw();
    if let Some(uv) = &mut raw.atlas_uv {
        for (i, t) in uv.iter_mut().enumerate() {
            t.y += if i % 2 == 0 { 6.0 / 256.0 } else { 0.0 };
        }
    }
    let bent = Mesh::new(raw).unwrap();
    let sequence = collapse(&bent, &[], Some(&layout), &SimplifyOptions::default());
    assert!(sequence.report().faces_left > 100, "{:?}", sequence.report());
}

/// Every corner of a level keeps the chart that its face had: a plane whose left and right halves lie in far UVs.
#[test]
fn uvs_never_cross_a_chart() {
    let mut raw = fixtures::field(20, 20, |x, y| (x * 0.4).sin() * (y * 0.5).cos()).into_raw();
    let old = raw.positions.len();
    // Split x = 10 into two wedges a point.
    let mut right_of = vec![u32::MAX; old];
    for (v, right) in right_of.iter_mut().enumerate() {
        if raw.positions[v].x == 10.0 {
            *right = raw.positions.len() as u32;
            raw.positions.push(raw.positions[v]);
        }
    }
    for t in &mut raw.triangles {
        if t.iter().any(|v| raw.positions[*v as usize].x > 10.0) {
            for v in t.iter_mut().filter(|v| right_of.get(**v as usize).is_some_and(|r| *r != u32::MAX)) {
                *v = right_of[*v as usize];
            }
        }
    }
    let side = |v: usize, p: glam::Vec3| if p.x > 10.0 || v >= old { 100.0 } else { 0.0 };
    raw.uv0 = Some(raw.positions.iter().enumerate().map(|(v, p)| glam::Vec2::new(p.x + side(v, *p), p.y)).collect());
    raw.points.clear();
    let mesh = Mesh::new(raw).unwrap();
    assert!(Topology::new(&mesh).kinds.contains(&PointKind::Seam));
    let (level, _) = cut(&mesh, Budget::Triangles(60));
    let uv = level.uv0.as_ref().unwrap();
    for t in &level.triangles {
        let sides = t.map(|v| uv[v as usize].x > 60.0);
        assert!(sides[0] == sides[1] && sides[1] == sides[2], "a face has corners in two charts");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// Random soups over few points: fans, bow ties, duplicates, degenerate faces, both windings.
    #[test]
    fn soups_never_panic_and_every_cut_is_sound(
        faces in prop::collection::vec((0_u32..14, 0_u32..14, 0_u32..14), 1..60),
        keep in 0.0_f64..1.0,
    ) {
        let triangles: Vec<[u32; 3]> = faces.iter().map(|(a, b, c)| [*a, *b, *c]).collect();
        let mesh = fixtures::soup(&triangles);
        let (mesh, _) = crate::merge::merge(&mesh, &Default::default());
        if mesh.face_count() > 0 {
            let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
            let count = (keep * sequence.collapses.len() as f64) as usize;
            let level = sequence.replay(&mesh, count).unwrap();
            prop_assert_eq!(level.face_count() as u32, sequence.faces_after(count));
            for f in 0..level.face_count() as u32 {
                let [a, b, c] = level.face_points(kiln_asset::FaceId(f));
                prop_assert!(a != b && b != c && c != a);
            }
        }
    }

    /// No face that stays turns farther in one collapse than the turn limit.
    #[test]
    fn no_face_turns_farther_than_the_limit(seed in 0_u32..1000) {
        let noise = move |x: f32, y: f32| {
            let word = (x as u32).wrapping_mul(73_856_093) ^ (y as u32).wrapping_mul(19_349_663) ^ seed.wrapping_mul(83_492_791);
            (word.wrapping_mul(2_654_435_761) >> 20) as f32 / 4096.0 * 0.6
        };
        let mesh = fixtures::field(6, 6, noise);
        let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
        let normals = |count: usize| -> Vec<Option<glam::Vec3>> {
            let level = sequence.replay(&mesh, count).unwrap();
            let end = sequence.collapses.get(count).map_or(sequence.faces.len(), |c| c.first_face as usize);
            let mut of_level = (0..level.face_count() as u32).map(|f| {
                let [a, b, c] = level.face_positions(kiln_asset::FaceId(f));
                (b - a).cross(c - a).normalize()
            });
            let gone = &sequence.faces[..end];
            (0..mesh.face_count() as u32).map(|f| if gone.contains(&f) { None } else { of_level.next() }).collect()
        };
        let mut before = normals(0);
        for count in 1..=sequence.collapses.len() {
            let after = normals(count);
            for (f, (old, new)) in before.iter().zip(&after).enumerate() {
                if let (Some(old), Some(new)) = (old, new) {
                    prop_assert!(old.dot(*new) > 0.249, "face {} turned in collapse {}", f, count);
                }
            }
            before = after;
        }
    }
}

/// A strip of quads closed with a twist has one side: windings must disagree somewhere.
#[test]
fn a_moebius_strip_is_simplified_without_a_panic() {
    let n = 40_u32;
    let mut raw = RawMesh { submeshes: vec![Default::default()], ..Default::default() };
    for i in 0..n {
        let turn = i as f32 / n as f32 * std::f32::consts::TAU;
        let across =
            glam::Vec3::new((turn / 2.0).cos() * turn.cos(), (turn / 2.0).sin(), (turn / 2.0).cos() * turn.sin());
        let centre = glam::Vec3::new(turn.cos(), 0.0, turn.sin()) * 3.0;
        raw.positions.extend([centre - across, centre + across]);
    }
    for i in 0..n {
        let (a, b) = (2 * i, 2 * i + 1);
        let (c, d) = if i + 1 == n { (1, 0) } else { (a + 2, b + 2) };
        raw.triangles.extend([[a, b, c], [b, d, c]]);
    }
    raw.face_submesh = vec![kiln_asset::SubmeshId(0); raw.triangles.len()];
    raw.submeshes[0].source_triangles = raw.triangles.len() as u32;
    let mesh = Mesh::new(raw).unwrap();
    let (level, report) = cut(&mesh, Budget::Triangles(20));
    assert!(level.face_count() <= 20 || report.short.is_some(), "{report:?}");
}

fn memoryless() -> SimplifyOptions {
    SimplifyOptions { metric: MetricKind::Memoryless, ..SimplifyOptions::default() }
}

/// Mean distance of the level's points from the unit sphere, with its sign.
fn bias(level: &Mesh) -> f32 {
    let centers = level.triangles.iter().map(|t| t.map(|v| level.positions[v as usize]).iter().sum::<Vec3>() / 3.0);
    let all: Vec<f32> = centers.chain(level.positions.iter().copied()).map(|p| p.length() - 1.0).collect();
    all.iter().sum::<f32>() / all.len() as f32
}

#[test]
fn a_fitted_level_lies_on_both_sides_of_its_source_and_a_half_edge_one_inside() {
    let mesh = fixtures::sphere(48, 32);
    let faces = mesh.face_count() as u32 / 10;
    let half = simplify(&mesh, faces, Placement::HalfEdge, &SimplifyOptions::default());
    let free = simplify(&mesh, faces, Placement::Free, &SimplifyOptions::default());
    let memoryless = simplify(&mesh, faces, Placement::Free, &memoryless());
    let [half, free, memoryless] = [half, free, memoryless].map(|level| bias(&level));
    assert!(half < -0.01, "{half}");
    assert!(free.abs() < 0.3 * half.abs() && memoryless.abs() < 0.3 * half.abs(), "{half}, {free}, {memoryless}");
}

#[test]
fn memoryless_keeps_volumes_borders_and_planes() {
    let sphere = fixtures::sphere(32, 24);
    let volume = |mesh: &Mesh| -> f64 {
        let six = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize].as_dvec3());
            a.dot(b.cross(c))
        };
        mesh.triangles.iter().map(six).sum::<f64>() / 6.0
    };
    let sequence = collapse(&sphere, &[], None, &memoryless());
    assert_eq!(sequence.places.len(), sequence.collapses.len());
    let level = simplify(&sphere, sphere.face_count() as u32 / 8, Placement::Free, &memoryless());
    let lost = 1.0 - volume(&level) / volume(&sphere);
    assert!(lost.abs() < 0.01, "{lost} of the volume is lost");
    // A flat sheet stays flat and keeps its outline at any level.
    let sheet = fixtures::grid(16, 12);
    let level = simplify(&sheet, 20, Placement::Free, &memoryless());
    assert!(level.face_count() <= 20, "{}", level.face_count());
    let error = surface_error(&sheet, &level, 20_000);
    assert!(error < 1e-3, "{error}");
}

#[test]
fn a_placed_sequence_comes_back_from_its_blob_and_cuts_alike_on_any_thread_count() {
    let mesh = painted_field();
    let sequence = collapse(&mesh, &[], None, &memoryless());
    assert_eq!(CollapseSequence::from_blob(&sequence.to_blob()).unwrap(), sequence);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let again = one.install(|| collapse(&mesh, &[], None, &memoryless()));
    assert_eq!(again, sequence);
    let cut_on = |pool: &rayon::ThreadPool| pool.install(|| super::cut(&mesh, &[], &sequence, 300, Placement::Free));
    let three = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    assert_eq!(cut_on(&one), cut_on(&three));
}

#[test]
fn a_model_of_any_size_is_collapsed_alike() {
    let mesh = painted_field();
    let order = |scale: f32, options: &SimplifyOptions| -> Vec<[u32; 2]> {
        let mut raw = mesh.clone().into_raw();
        raw.positions.iter_mut().for_each(|p| *p *= scale);
        let sequence = collapse(&Mesh::new(raw).unwrap(), &[], None, options);
        sequence.collapses.iter().map(|c| [c.from, c.to]).collect()
    };
    for options in [SimplifyOptions::default(), memoryless()] {
        let own = order(1.0, &options);
        // Powers of two round alike.
        for exponent in [-40, 40] {
            assert!(order(2.0_f32.powi(exponent), &options) == own, "2^{exponent}, {:?}", options.metric);
        }
    }
}

#[test]
fn a_texture_that_slides_has_a_price_and_one_that_does_not_has_none() {
    // A flat sheet: no collapse costs the surface anything, so only the texture tells the order.
    let mut raw = fixtures::grid(24, 24).into_raw();
    let bent = |p: &Vec3| glam::Vec2::new(if p.x < 12.0 { p.x } else { 12.0 + (p.x - 12.0).powi(2) }, p.y) / 160.0;
    raw.uv0 = Some(raw.positions.iter().map(bent).collect());
    let mesh = Mesh::new(raw).unwrap();
    let level = simplify(&mesh, 300, Placement::HalfEdge, &SimplifyOptions::default());
    let [straight, curved] =
        [0.0, 12.0].map(|low| level.positions.iter().filter(|p| p.x > low && p.x < low + 12.0).count());
    assert!(2 * curved > 3 * straight, "{straight} points where the texture is straight, {curved} where it bends");
    let blind = SimplifyOptions { attributes: false, ..SimplifyOptions::default() };
    let level = simplify(&mesh, 300, Placement::HalfEdge, &blind);
    let [straight, curved] =
        [0.0, 12.0].map(|low| level.positions.iter().filter(|p| p.x > low && p.x < low + 12.0).count());
    assert!(2 * curved < 3 * straight, "{straight}, {curved} without attributes");
}

#[test]
fn coordinates_at_the_end_of_single_precision_are_survived() {
    for options in [SimplifyOptions::default(), memoryless()] {
        for size in [3e38, 1e30, 2e19, 1e18, 1e-18, 1e-30, f32::MIN_POSITIVE] {
            let mut raw = painted_field().into_raw();
            raw.positions.iter_mut().for_each(|p| *p = *p / 48.0 * size);
            raw.uv0.as_mut().unwrap().iter_mut().for_each(|uv| *uv *= size);
            let mesh = Mesh::new(raw).unwrap();
            simplify(&mesh, 300, Placement::Free, &options);
        }
    }
}

#[test]
fn a_hub_costs_no_more_than_the_square_of_its_faces() {
    // A disc of one fan with a wedge for every face at its centre: the cube of its faces would take a quarter of an hour.
    let count = 8000_u32;
    let rim = |i: u32| {
        let angle = f64::from(i % count) / f64::from(count) * std::f64::consts::TAU;
        Vec3::new(libm::cos(angle) as f32, libm::sin(angle) as f32, 0.0)
    };
    let positions = (0..count).flat_map(|i| [rim(i), rim(i + 1), Vec3::Z * 0.1]).collect();
    let triangles: Vec<[u32; 3]> = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let normals = Some((0..count).flat_map(|i| [rim(i); 3]).collect());
    let submeshes = vec![kiln_asset::Submesh { name: "disc".into(), source_triangles: count, ..Default::default() }];
    let face_submesh = vec![kiln_asset::SubmeshId(0); triangles.len()];
    let raw = kiln_asset::RawMesh { positions, normals, triangles, face_submesh, submeshes, ..Default::default() };
    let mesh = Mesh::new(raw).unwrap();
    for options in [SimplifyOptions::default(), memoryless()] {
        let level = simplify(&mesh, count / 10, Placement::Free, &options);
        assert!(level.face_count() as u32 <= count / 10, "{} faces", level.face_count());
    }
}
