//! Regions and the joint log, on small meshes that are divided finely.

use kiln_asset::{Mesh, SubmeshId};
use proptest::prelude::*;

use super::metric::memoryless::MemorylessRest;
use super::metric::quadric::{Forms, QuadricRest};
use super::regions::{self, Grain};
use super::rest::Rest;
use super::*;
use crate::fixtures;
use crate::topology::Topology;

const FINE: Grain = Grain { whole: 200, region: 150 };
const ONE: Grain = Grain { whole: usize::MAX, region: usize::MAX };

fn divided(mesh: &Mesh, options: &SimplifyOptions, locked: &[bool], grain: Grain) -> CollapseSequence {
    let topology = Topology::new(mesh);
    let forms = Forms::new(mesh, &topology, &[], options);
    let mut rest = Rest::new(mesh, &topology, forms.positions(), options);
    rest.lock(locked);
    match options.metric {
        MetricKind::Quadric => {
            let metric = QuadricRest::new(forms.initial(), &mut rest);
            regions::collapse(rest, metric, options.floor, grain)
        }
        MetricKind::Memoryless => regions::collapse(rest, MemorylessRest::new(mesh), options.floor, grain),
    }
}

/// Two sheets with a boundary between them and an attribute of their own, under noise.
fn sheets(seed: u32, attributes: bool) -> Mesh {
    let mut raw = fixtures::merged_pair(24, 18).into_raw();
    let noise = |i: usize| (kiln_geom::sample::hash(i as u64 ^ u64::from(seed) << 32) % 1000) as f32 / 1000.0;
    for (v, place) in raw.positions.iter_mut().enumerate() {
        place.z += 0.4 * noise(raw.points[v].index());
    }
    raw.uv0 = attributes.then(|| raw.positions.iter().map(|p| glam::Vec2::new(p.x, p.y) / 50.0).collect());
    Mesh::new(raw).unwrap()
}

/// Performs the log on bare faces: each collapse must find an edge, and take exactly the faces at both its ends.
fn assert_sound(mesh: &Mesh, sequence: &CollapseSequence) {
    let mut faces: Vec<Option<[u32; 3]>> =
        mesh.triangles.iter().map(|t| Some(t.map(|v| mesh.points[v as usize].0))).collect();
    for (i, one) in sequence.collapses.iter().enumerate() {
        let both = |f: &Option<[u32; 3]>| f.is_some_and(|f| f.contains(&one.from) && f.contains(&one.to));
        let dying: Vec<u32> = (0..).zip(&faces).filter(|(_, f)| both(f)).map(|(f, _)| f).collect();
        let mut logged = sequence.faces[sequence.faces_of(i)].to_vec();
        logged.sort_unstable();
        assert_eq!(logged, dying, "collapse {i} of {one:?}");
        assert!(!dying.is_empty());
        dying.iter().for_each(|f| faces[*f as usize] = None);
        for face in faces.iter_mut().flatten() {
            face.iter_mut().filter(|p| **p == one.from).for_each(|p| *p = one.to);
            assert!(!crate::topology::is_degenerate(face), "collapse {i} folds a face");
        }
    }
    let left: Vec<[u32; 3]> = faces.into_iter().flatten().collect();
    assert_eq!(left.len() as u32, sequence.report().faces_left);
    let level = sequence.replay(mesh, sequence.collapses.len()).unwrap();
    let points = |p: u32| mesh.points.iter().position(|q| q.0 == p).map(|v| mesh.positions[v]);
    let places: Vec<_> = level.triangles.iter().map(|t| t.map(|v| Some(level.positions[v as usize]))).collect();
    // Wedges of one point of a joined pair may lie a weld apart, but not in these sheets.
    assert_eq!(places, left.iter().map(|f| f.map(points)).collect::<Vec<_>>(), "wedges go where their points go");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn the_joint_log_can_be_performed_in_its_order(seed in 0_u32..10_000, attributes in any::<bool>(), memoryless in any::<bool>()) {
        let mesh = sheets(seed, attributes);
        let metric = if memoryless { MetricKind::Memoryless } else { MetricKind::Quadric };
        let options = SimplifyOptions { metric, ..SimplifyOptions::default() };
        let sequence = divided(&mesh, &options, &[], FINE);
        assert_sound(&mesh, &sequence);
        prop_assert!(sequence.collapses.windows(2).all(|w| w[0].error <= w[1].error));
        prop_assert_eq!(sequence.places.len(), if memoryless { sequence.collapses.len() } else { 0 });
        let dependencies = Dependencies::new(&mesh, &sequence).unwrap();
        prop_assert!((0..sequence.collapses.len()).all(|i| dependencies.of(i).iter().all(|d| (*d as usize) < i)));
        prop_assert_eq!(crate::check::gaps(&mesh, &sequence.replay(&mesh, sequence.reach(300)).unwrap()), 0);
        // To the same end as one queue, nearly.
        let one = divided(&mesh, &options, &[], ONE);
        prop_assert!(sequence.report().faces_left <= one.report().faces_left + 30, "{:?} {:?}", sequence.report(), one.report());
    }
}

#[test]
fn what_is_locked_stays_in_every_round() {
    let mesh = sheets(7, true);
    let locked = points_of(&mesh, &[true, false]);
    let sequence = divided(&mesh, &SimplifyOptions::default(), &locked, FINE);
    assert!(sequence.collapses.iter().all(|c| !locked[c.from as usize]));
    let level = sequence.replay(&mesh, sequence.collapses.len()).unwrap();
    assert_eq!(level.submesh_faces(SubmeshId(0)).len(), mesh.submesh_faces(SubmeshId(0)).len());
    assert!(level.submesh_faces(SubmeshId(1)).len() < mesh.submesh_faces(SubmeshId(1)).len() / 4);
}

#[test]
fn levels_of_regions_are_as_near_as_those_of_one_queue() {
    let mesh = fixtures::field(90, 80, |x, y| 4.0 * (x * 0.11).sin() * (y * 0.07).cos() + (x * 0.05 + y * 0.2).sin());
    let off = |level: &Mesh| {
        let samples = kiln_geom::sample::SurfaceSamples::new(&level.positions, &level.triangles, 40_000, 3).samples;
        let height = |x: f32, y: f32| 4.0 * (x * 0.11).sin() * (y * 0.07).cos() + (x * 0.05 + y * 0.2).sin();
        samples.iter().map(|s| f64::from((s.position.z - height(s.position.x, s.position.y)).abs())).sum::<f64>()
    };
    let grain = Grain { whole: 4000, region: 4000 };
    let options = SimplifyOptions::default();
    let [regions, one] = [grain, ONE].map(|grain| divided(&mesh, &options, &[], grain));
    assert_ne!(regions.collapses, one.collapses, "the mesh was divided");
    for (share, worse) in [(2, 1.06), (4, 1.03), (10, 1.03), (100, 1.1)] {
        let faces = (mesh.face_count() / share) as u32;
        let [regions, one] = [&regions, &one].map(|log| off(&log.replay(&mesh, log.reach(faces)).unwrap()));
        assert!(regions < worse * one, "1/{share}: {regions} for {one}");
    }
}

#[test]
fn a_floor_is_met_and_hardly_passed_and_threads_do_not_show() {
    let mesh = fixtures::field(60, 50, |x, y| (x * 0.3).sin() * (y * 0.2).cos());
    for floor in [0.6, 0.3, 0.05, 0.0] {
        let options = SimplifyOptions { floor, ..SimplifyOptions::default() };
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| divided(&mesh, &options, &[], FINE))
        };
        let sequence = on(1);
        assert_eq!(on(4), sequence);
        let asked = (floor * mesh.face_count() as f64) as u32;
        let report = sequence.report();
        assert!(floor == 0.0 || report.at_floor, "{report:?}");
        assert!(report.faces_left + mesh.face_count() as u32 / 20 >= asked, "{floor}: {report:?}");
    }
}
