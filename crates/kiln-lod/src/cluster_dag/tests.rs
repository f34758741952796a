use std::collections::BTreeMap;

use glam::{DVec3, Vec3};
use kiln_asset::{Mesh, RawMesh, Submesh};
use proptest::prelude::*;

use super::*;
use crate::check::gaps;
use crate::fixtures;
use crate::simplify::{collapse_patch, surface_error};

fn dag(mesh: &Mesh) -> ClusterDag {
    let dag = ClusterDag::new(mesh, &ClusterDagOptions::default()).expect("a dag");
    dag.validate().expect("sound");
    dag
}

/// A sphere with bumps, so that no two groups have the same error.
fn bumpy(columns: u32, rows: u32) -> Mesh {
    let mut raw = fixtures::sphere(columns, rows).into_raw();
    for p in &mut raw.positions {
        *p *= 1.0 + 0.05 * (7.0 * p.x).sin() * (5.0 * p.y + 1.0).cos() + 0.02 * (19.0 * p.z).sin();
    }
    raw.points.clear();
    Mesh::new(raw).expect("sound")
}

/// The distinct errors of groups, ascending, and 0.
fn thresholds(dag: &ClusterDag) -> Vec<f32> {
    let mut all: Vec<f32> = dag.groups.iter().map(|g| g.error).filter(|e| *e < f32::MAX).chain([0.0]).collect();
    all.sort_by(f32::total_cmp);
    all.dedup();
    all
}

/// How often each half-edge between points occurs, degenerate triangles aside.
fn half_edges(mesh: &Mesh, dag: &ClusterDag, clusters: &[u32]) -> BTreeMap<(u32, u32), u32> {
    let mut count = BTreeMap::new();
    for triangle in clusters.iter().flat_map(|c| dag.triangles_of(*c)) {
        let [a, b, c] = triangle.map(|v| mesh.points[v as usize].0);
        for edge in [(a, b), (b, c), (c, a)] {
            *count.entry(edge).or_insert(0) += 1;
        }
    }
    count
}

/// Every half-edge once, and its twin, too.
fn is_closed(mesh: &Mesh, dag: &ClusterDag, clusters: &[u32]) -> bool {
    let edges = half_edges(mesh, dag, clusters);
    edges.iter().all(|((a, b), count)| *count == 1 && edges.get(&(*b, *a)) == Some(&1))
}

/// The clusters that a view of `eye` draws where `scale * error` object units of distance are allowed.
fn seen(dag: &ClusterDag, eye: Vec3, scale: f32) -> Vec<u32> {
    let is_above = |g: u32| {
        let group = &dag.groups[g as usize];
        let [x, y, z, radius] = group.sphere;
        let reach = scale * group.error + radius;
        group.error == f32::MAX || group.error > 0.0 && (eye - Vec3::new(x, y, z)).length_squared() < reach * reach
    };
    let drawn = |c: &Cluster| is_above(c.group) && (c.made_by == NONE || !is_above(c.made_by));
    (0..).zip(&dag.clusters).filter(|(_, c)| drawn(c)).map(|(c, _)| c).collect()
}

/// The triangles as a set, each from its least vertex on.
fn set(triangles: impl Iterator<Item = [u32; 3]>) -> Vec<[u32; 3]> {
    let turned = |mut t: [u32; 3]| {
        while t[0] != *t.iter().min().unwrap() {
            t.rotate_left(1);
        }
        t
    };
    let mut all: Vec<[u32; 3]> = triangles.map(turned).collect();
    all.sort_unstable();
    all
}

fn finest_is_the_mesh(mesh: &Mesh, dag: &ClusterDag) -> bool {
    let own = (0..).zip(&dag.clusters).filter(|(_, c)| c.made_by == NONE).map(|(c, _)| c);
    set(own.flat_map(|c| dag.triangles_of(c))) == set(mesh.triangles.iter().copied())
}

#[test]
fn every_cut_of_a_sphere_is_a_closed_manifold_and_they_shrink() {
    let mesh = bumpy(80, 50);
    let dag = dag(&mesh);
    assert!(finest_is_the_mesh(&mesh, &dag));
    let mut last = u64::MAX;
    for threshold in thresholds(&dag) {
        let cut = dag.cut(threshold);
        assert!(is_closed(&mesh, &dag, &cut), "at {threshold}");
        let triangles = dag.triangles_at(threshold);
        assert!(triangles <= last, "{triangles} after {last}");
        last = triangles;
    }
    let report = dag.report();
    assert_eq!(last, u64::from(report.root_triangles));
    assert!(report.levels >= 6 && report.root_triangles < 100, "{report:?}");
    assert_eq!(report.mesh_triangles as usize, mesh.face_count());
    assert!(report.fill > 0.5, "{report:?}");
    // No error is negative, so nothing is allowed below 0: that is the mesh.
    assert_eq!(set(dag.cut(-1.0).into_iter().flat_map(|c| dag.triangles_of(c))), set(mesh.triangles.iter().copied()));
    let roots: Vec<u32> =
        (0..).zip(&dag.clusters).filter(|(_, c)| dag.groups[c.group as usize].error == f32::MAX).map(|r| r.0).collect();
    assert_eq!(dag.cut(f32::MAX.next_down()), roots);
    assert_eq!(dag.cut(f32::MAX), roots);
}

#[test]
fn small_groups_with_much_border_leave_a_closed_manifold_too() {
    let mesh = bumpy(60, 40);
    for group_size in [2, 3, 5] {
        let dag = ClusterDag::new(&mesh, &ClusterDagOptions { group_size, ..Default::default() }).expect("a dag");
        for threshold in thresholds(&dag) {
            assert!(is_closed(&mesh, &dag, &dag.cut(threshold)), "groups of {group_size} at {threshold}");
        }
        for view in 0..100_u32 {
            let turn = |k: u32| ((view * k) as f32 * 0.618_034).fract() * 2.0 - 1.0;
            let eye = Vec3::new(turn(1), turn(3), turn(7)) * 2.0;
            assert!(is_closed(&mesh, &dag, &seen(&dag, eye, 10.0_f32.powf(3.0 * turn(11)))));
        }
    }
}

#[test]
fn no_edge_comes_between_two_points_that_faces_beyond_the_patch_hang_on() {
    // A flat hexagon about point 0: nothing is cheaper than to take the middle to a corner.
    let corner = |i: u32| {
        let turn = std::f32::consts::TAU * i as f32 / 6.0;
        Vec3::new(turn.cos(), turn.sin(), 0.0)
    };
    let raw = RawMesh {
        positions: std::iter::once(Vec3::ZERO).chain((0..6).map(corner)).collect(),
        triangles: (0..6).map(|i| [0, 1 + i, 1 + (i + 1) % 6]).collect(),
        face_submesh: vec![SubmeshId(0); 6],
        submeshes: vec![Submesh::default()],
        ..RawMesh::default()
    };
    let mesh = Mesh::new(raw).expect("sound");
    let options = SimplifyOptions::default();
    let collapses = |fixed: [bool; 7]| collapse_patch(&mesh, &[], &options, &fixed).0.collapses;
    // The diagonals of the hexagon may be edges of what lies beyond.
    assert_eq!(collapses([false, true, true, true, true, true, true]), []);
    let free = collapses([false, true, false, true, false, false, false]);
    assert!(free[0].from == 0 && ![1, 3].contains(&free[0].to), "{:?}", free[0]);
}

#[test]
fn every_view_of_a_sphere_draws_a_closed_manifold_finer_near_the_eye() {
    let mesh = bumpy(80, 50);
    let dag = dag(&mesh);
    for view in 0..200_u32 {
        let turn = |k: u32| ((view * k) as f32 * 0.618_034).fract() * 2.0 - 1.0;
        let eye = Vec3::new(turn(1), turn(3), turn(7)) * 3.0;
        let scale = 10.0_f32.powf(4.0 * turn(11));
        let cut = seen(&dag, eye, scale);
        assert!(is_closed(&mesh, &dag, &cut), "from {eye} at {scale}");
    }
    let cut = seen(&dag, Vec3::new(0.0, 0.0, 1.1), 30.0);
    let levels = cut.iter().map(|c| dag.clusters[*c as usize].level);
    assert!(levels.clone().max() > levels.min());
}

#[test]
fn seams_boundaries_and_borders_get_no_gap_in_any_cut() {
    let wave = |x: f32, y: f32| (x * 0.5).sin() + (y * 0.7).cos();
    let meshes = [
        fixtures::hard_cube(20),
        fixtures::merged_pair(40, 30),
        fixtures::quilt(3, 3, 14, wave),
        fixtures::slit_grid(),
        fixtures::field(60, 40, wave),
    ];
    for mesh in &meshes {
        let dag = dag(mesh);
        assert!(finest_is_the_mesh(mesh, &dag));
        for threshold in thresholds(&dag) {
            let level = dag.level(mesh, threshold).expect("a level");
            assert_eq!(gaps(mesh, &level), 0, "at {threshold}");
        }
        for view in 0..30 {
            let eye = Vec3::new(view as f32, 10.0 - view as f32, (view % 7) as f32);
            let level = dag.mesh_of(mesh, &seen(&dag, eye, 1.2_f32.powi(view))).expect("a level");
            assert_eq!(gaps(mesh, &level), 0);
        }
    }
}

#[test]
fn submeshes_stay_and_small_neighbours_shrink_together() {
    let mesh = fixtures::quilt(4, 4, 10, |x, y| 0.01 * x * y);
    let dag = dag(&mesh);
    let coarsest = dag.level(&mesh, f32::MAX).expect("a level");
    assert_eq!(coarsest.submeshes, mesh.submeshes);
    for s in 0..16 {
        assert!(!coarsest.submesh_faces(SubmeshId(s)).is_empty());
    }
    // 16 parts of 200 triangles each would stay as they are, were each a group by itself with its border held.
    assert!(coarsest.face_count() < 800, "{}", coarsest.face_count());
    for cluster in &dag.clusters {
        let of = |v: u32| mesh.triangles.iter().position(|t| t.contains(&v)).map(|f| mesh.face_submesh[f].0);
        let first = dag.references[cluster.first_reference as usize];
        assert_eq!(of(first), Some(cluster.submesh));
    }
}

#[test]
fn no_cut_is_farther_from_the_mesh_than_its_threshold() {
    let mesh = bumpy(60, 40);
    let dag = dag(&mesh);
    for threshold in thresholds(&dag).into_iter().step_by(9).skip(1) {
        let level = dag.level(&mesh, threshold).expect("a level");
        let error = surface_error(&mesh, &level, 40_000);
        assert!(error <= 1.05 * threshold + 1e-6, "{error} where {threshold} was allowed");
    }
}

#[test]
fn spheres_and_errors_hold_those_below() {
    let mesh = bumpy(60, 40);
    let dag = dag(&mesh);
    let part = |s: &[f32; 4]| (DVec3::new(s[0].into(), s[1].into(), s[2].into()), f64::from(s[3]));
    let holds = |a: &[f32; 4], b: &[f32; 4]| (part(a).0 - part(b).0).length() + part(b).1 < part(a).1 * (1.0 - 1e-7);
    for (c, cluster) in (0..).zip(&dag.clusters) {
        let group = &dag.groups[cluster.group as usize];
        assert!(holds(&group.sphere, &cluster.sphere));
        if cluster.made_by != NONE {
            let maker = &dag.groups[cluster.made_by as usize];
            assert!(holds(&group.sphere, &maker.sphere));
            assert!(group.error > maker.error || maker.error == 0.0);
        }
        let [ax, ay, az, cutoff] = cluster.cone;
        for triangle in dag.triangles_of(c) {
            let [a, b, d] = triangle.map(|v| mesh.positions[v as usize]);
            for p in [a, b, d] {
                let (centre, radius) = part(&cluster.sphere);
                assert!((p.as_dvec3() - centre).length() <= radius);
            }
            let normal = (b - a).cross(d - a).normalize_or_zero();
            // Cutoff is the sine of the half angle.
            let least = (1.0 - cutoff * cutoff).max(0.0).sqrt();
            assert!(cutoff >= 1.0 || normal.dot(Vec3::new(ax, ay, az)) >= least - 0.02);
        }
    }
}

#[test]
fn the_threshold_for_a_budget_is_the_least_that_meets_it() {
    let dag = dag(&bumpy(60, 40));
    for budget in [4600, 2000, 500, 90] {
        let threshold = dag.threshold_for(budget);
        assert!(dag.triangles_at(threshold) <= budget);
        assert!(threshold == 0.0 || dag.triangles_at(threshold.next_down()) > budget);
    }
    assert_eq!(dag.triangles_at(dag.threshold_for(0)), u64::from(dag.report().root_triangles));
}

#[test]
fn separate_triangles_are_roots_at_once() {
    let mesh = fixtures::soup(&[[0, 1, 2], [3, 4, 5], [6, 7, 8]]);
    let dag = dag(&mesh);
    assert_eq!((dag.levels, dag.groups.len(), dag.clusters.len()), (1, 1, 1));
    assert_eq!(dag.groups[0].error, f32::MAX);
    assert!(dag.level(&fixtures::grid(3, 3), 0.0).is_err());
    let empty = self::dag(&Mesh::default());
    assert_eq!((empty.levels, empty.clusters.len(), empty.cut(0.0).len()), (0, 0, 0));
}

#[test]
fn a_coordinate_out_of_reach_is_refused() {
    let mut raw = fixtures::grid(2, 2).into_raw();
    raw.positions[3].y = 1e30;
    raw.points.clear();
    let error = ClusterDag::new(&Mesh::new(raw).unwrap(), &ClusterDagOptions::default()).unwrap_err();
    assert!(matches!(error, DagError::TooLarge { vertex: 3, .. }), "{error}");
}

#[test]
fn a_far_and_tiny_object_has_the_same_triangles() {
    let mesh = fixtures::field(40, 40, |x, y| (x * 0.4).sin() + (y * 0.3).cos());
    let mut raw = mesh.clone().into_raw();
    for p in &mut raw.positions {
        *p *= 1.0 / 1024.0;
    }
    let small = dag(&Mesh::new(raw).unwrap());
    let large = dag(&mesh);
    assert_eq!((small.references, small.corners), (large.references, large.corners));
    assert!(
        small
            .groups
            .iter()
            .zip(&large.groups)
            .all(|(s, l)| l.error == f32::MAX || (s.error * 1024.0 - l.error).abs() <= 1e-5 * l.error)
    );
}

#[test]
fn the_same_bytes_come_out_on_any_number_of_threads() {
    let mesh = bumpy(60, 40);
    let of = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| dag(&mesh)).to_blob()
    };
    assert!(of(1) == of(3));
}

#[test]
fn blobs_come_back_and_damaged_ones_do_not() {
    let mesh = fixtures::quilt(2, 1, 9, |x, y| (x * y * 0.1).sin());
    let dag = dag(&mesh);
    let blob = dag.to_blob();
    assert_eq!(ClusterDag::from_blob(&blob).unwrap(), dag);
    for length in 0..blob.len() {
        assert!(ClusterDag::from_blob(&blob[..length]).is_err());
    }
    for at in 0..blob.len() {
        for bit in [0, 6, 7] {
            let mut damaged = blob.clone();
            damaged[at] ^= 1 << bit;
            if let Ok(dag) = ClusterDag::from_blob(&damaged) {
                // What is left must be usable.
                let cut = dag.cut(0.01);
                assert!(cut.iter().flat_map(|c| dag.triangles_of(*c)).flatten().all(|v| v < dag.vertices));
            }
        }
    }
}

#[test]
fn each_broken_promise_is_found() {
    let sound = dag(&bumpy(30, 20));
    let breaks: [&dyn Fn(&mut ClusterDag); 12] = [
        &|d| d.levels += 1,
        &|d| d.vertices = 3,
        &|d| d.clusters[1].first_reference += 1,
        &|d| d.clusters[1].triangle_count = 0,
        &|d| d.clusters[0].made_by = 0,
        &|d| d.clusters.last_mut().unwrap().made_by = NONE,
        &|d| d.clusters.last_mut().unwrap().level = 1,
        &|d| d.groups[0].error = f32::NAN,
        &|d| d.groups[0].error = f32::MAX,
        &|d| d.groups[1].sphere[3] = -1.0,
        &|d| d.groups[1].first_cluster = u32::MAX,
        &|d| d.corners[0] = 255,
    ];
    for (i, damage) in breaks.iter().enumerate() {
        let mut broken = sound.clone();
        damage(&mut broken);
        assert!(broken.validate().is_err(), "number {i}");
    }
}

fn random_mesh() -> impl Strategy<Value = Mesh> {
    let triangles = prop::collection::vec(prop::array::uniform3(0..30_u32), 1..400);
    (triangles, 1..4_u32).prop_map(|(triangles, parts)| {
        let place = |i: u32| Vec3::new((i % 5) as f32, (i / 5 % 3) as f32, (i * i % 11) as f32 * 0.3);
        let mut raw = RawMesh { submeshes: vec![Submesh::default(); parts as usize], ..RawMesh::default() };
        raw.positions = (0..30 * parts).map(|i| place(i % 30)).collect();
        raw.points = (0..30 * parts).map(|i| kiln_asset::PointId(i % 30)).collect();
        for (i, t) in triangles.iter().enumerate() {
            let part = i as u32 * parts / triangles.len() as u32;
            raw.triangles.push(t.map(|v| v + 30 * part));
            raw.face_submesh.push(SubmeshId(part));
        }
        Mesh::new(raw).expect("sound")
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_mesh_gives_a_sound_dag(mesh in random_mesh()) {
        let dag = dag(&mesh);
        prop_assert!(finest_is_the_mesh(&mesh, &dag));
        let mut last = u64::MAX;
        for threshold in thresholds(&dag) {
            let triangles = dag.triangles_at(threshold);
            prop_assert!(triangles <= last);
            last = triangles;
            prop_assert_eq!(gaps(&mesh, &dag.level(&mesh, threshold).unwrap()), 0);
        }
        prop_assert_eq!(ClusterDag::from_blob(&dag.to_blob()).unwrap(), dag);
    }

    #[test]
    fn any_view_of_any_field_is_without_cracks(
        size in 8..40_u32, steep in 0.0f32..2.0, eye in prop::array::uniform3(-50.0f32..50.0), scale in -2.0f32..5.0,
        group_size in 2..20_u32,
    ) {
        let mesh = fixtures::field(size, 30, |x, y| steep * (x * 0.9).sin() * (y * 1.3).cos());
        let options = ClusterDagOptions { group_size, ..Default::default() };
        let dag = ClusterDag::new(&mesh, &options).unwrap();
        dag.validate().unwrap();
        let cut = seen(&dag, Vec3::from_array(eye), 10.0_f32.powf(scale));
        prop_assert_eq!(gaps(&mesh, &dag.mesh_of(&mesh, &cut).unwrap()), 0);
        prop_assert!(half_edges(&mesh, &dag, &cut).values().all(|count| *count == 1));
    }
}
