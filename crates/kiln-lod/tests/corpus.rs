//! Merge and simplify on real models. The folder of the models is taken from `KILN_CORPUS`.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::PathBuf;

use kiln_asset::import::{Folder, ImportLimits, import};
use kiln_asset::{Mesh, SubmeshId};
use kiln_lod::check;
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{Budget, LevelsOptions, SimplifyOptions, SimplifyReport, collapse, levels};

/// The model, merged; `None` (said, and an error where nothing may be skipped) without the corpus.
fn model(path: &str) -> Option<Mesh> {
    let Some(corpus) = std::env::var_os("KILN_CORPUS") else {
        assert!(std::env::var_os("KILN_REQUIRE_ALL").is_none(), "nothing may be skipped: set KILN_CORPUS");
        eprintln!("skipped: needs KILN_CORPUS");
        return None;
    };
    let path = PathBuf::from(corpus).join(path);
    let files = Folder(path.parent().unwrap().to_path_buf());
    let (asset, _) = import(&files, path.file_name().unwrap().to_str().unwrap(), &ImportLimits::default()).unwrap();
    Some(merge(&asset.mesh, &MergeOptions { weld: 1e-5 * asset.mesh.diagonal(), ..Default::default() }).0)
}

/// Levels of those shares; checks what must hold for every level of every model.
fn simplify(mesh: &Mesh, shares: &[f64]) -> SimplifyReport {
    let sequence = collapse(mesh, &[], None, &SimplifyOptions::default());
    let budgets: Vec<Budget> = shares.iter().map(|share| Budget::Keep(*share)).collect();
    let (set, report) =
        levels(mesh, &[], &sequence, mesh, &budgets, &LevelsOptions { samples: 20_000, ..LevelsOptions::default() });
    for ((level, reached), share) in set.levels.iter().zip(&report.levels).zip(shares) {
        assert_eq!(check::gaps(mesh, &level.mesh), 0, "{}: no crack", reached.budget);
        assert_eq!(check::degenerate_faces(&level.mesh), 0);
        assert_eq!(level.mesh.submeshes, mesh.submeshes);
        let asked = (share * f64::from(set.source_triangles)).floor() as u32;
        assert!(reached.triangles <= asked || reached.short.is_some(), "{reached:?}");
        // A collapse takes two faces at most, so a budget that is met is met to a triangle or two.
        assert!(reached.triangles + 2 > asked.min(mesh.face_count() as u32), "{reached:?}");
    }
    assert!(report.levels.windows(2).all(|w| w[0].error <= w[1].error));
    report
}

#[test]
fn six_submeshes_of_a_helmet_stay_joined_at_every_level() {
    let Some(mesh) = model("gltf/FlightHelmet/FlightHelmet.gltf") else { return };
    assert_eq!(mesh.submeshes.len(), 6);
    let report = simplify(&mesh, &[0.5, 0.1, 0.05]);
    assert!(report.levels.iter().all(|level| level.short.is_none() && level.submeshes.iter().all(|n| *n > 0)));
}

#[test]
fn parts_of_a_truck_that_touch_stay_joined() {
    let Some(mesh) = model("gltf/CesiumMilkTruck/CesiumMilkTruck.gltf") else { return };
    let open = |mesh: &Mesh| check::gaps(&Mesh::default(), mesh);
    let mut apart = mesh.clone().into_raw();
    apart.points.clear();
    assert!(open(&Mesh::new(apart).unwrap()) > open(&mesh), "merge joined borders");
    simplify(&mesh, &[0.5, 0.25, 0.1]);
}

#[test]
fn a_scan_keeps_its_shape_within_a_thousandth_of_its_size_at_a_tenth_of_its_triangles() {
    for path in ["scans/stanford-bunny.glb", "scans/armadillo.glb"] {
        let Some(mesh) = model(path) else { return };
        let report = simplify(&mesh, &[0.5, 0.1]);
        let relative = report.levels.iter().map(|level| level.error / mesh.diagonal()).collect::<Vec<_>>();
        assert!(relative[0] < 1.5e-3 && relative[1] < 6e-3, "{path}: {relative:?}");
        assert!(report.levels.iter().all(|level| level.short.is_none()));
    }
}

#[test]
fn a_closed_scan_without_budget_keeps_the_topology_of_a_sphere() {
    let Some(mesh) = model("scans/armadillo.glb") else { return };
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let level = sequence.replay(&mesh, sequence.collapses.len()).unwrap();
    let euler = level.point_count() as i64 - level.face_count() as i64 / 2;
    assert_eq!(euler, mesh.point_count() as i64 - mesh.face_count() as i64 / 2, "points - edges + faces is kept");
    assert!(level.face_count() < 40, "{} faces are left", level.face_count());
}

#[test]
fn an_engine_of_many_parts_opens_nowhere() {
    let Some(mesh) = model("cad/2CylinderEngine.glb") else { return };
    let report = simplify(&mesh, &[0.5, 0.1]);
    assert_eq!(report.levels[0].submeshes.len(), mesh.submeshes.len());
    let untouched =
        (0..mesh.submeshes.len() as u32).map(SubmeshId).filter(|s| mesh.submesh_faces(*s).is_empty()).count();
    assert_eq!(untouched, 0, "every part has faces");
}
