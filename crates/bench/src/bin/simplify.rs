//! Simplification beside the `meshopt` crate: seconds, input triangles a second, mean and greatest surface distance.
//!
//! `cargo run --release -p kiln-bench --bin simplify -- MODEL... [--keep SHARE]`
//!
//! Positions only, one thread each; only the call is timed, error sampling is outside. kiln's time is its whole sequence, to
//! exhaustion, with one cut: a further level costs the cut alone, and meshopt starts anew for each.

#![allow(clippy::print_stdout, reason = "the table is this program's output")]

use std::path::PathBuf;
use std::process::ExitCode;

use glam::Vec3;
use kiln_asset::{Mesh, RawMesh, Submesh, SubmeshId};
use kiln_bench::{median, model};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{Placement, SimplifyOptions, collapse, cut};
use kiln_measure::surface_distance;
use meshopt::{SimplifyOptions as Meshopt, VertexDataAdapter, typed_to_bytes};

/// Sample points a side for the distances.
const SAMPLES: usize = 200_000;
/// Timed runs; the median counts.
const RUNS: usize = 1;

fn main() -> ExitCode {
    let mut keep = 0.1;
    let mut models = Vec::new();
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        if arg == "--keep" {
            keep = args.next().and_then(|v| v.parse().ok()).unwrap_or(keep);
        } else {
            models.push(PathBuf::from(arg));
        }
    }
    if models.is_empty() {
        eprintln!("usage: simplify MODEL... [--keep SHARE]");
        return ExitCode::from(64);
    }
    println!(
        "| model | tool | triangles | seconds | Mtri/s | mean, 1e-5 diagonal | greatest, 1e-5 diagonal | time by kiln's |"
    );
    println!("| --- | --- | --: | --: | --: | --: | --: | --: |");
    for path in models {
        if let Err(message) = compare(&path, keep) {
            eprintln!("{}: {message}", path.display());
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

fn compare(path: &std::path::Path, keep: f64) -> Result<(), String> {
    let (merged, _) = merge(&model(path)?.mesh, &MergeOptions::default());
    let mesh = positions_only(&merged)?;
    let budget = (keep * mesh.face_count() as f64) as u32;
    let options = SimplifyOptions::default();
    let (level, seconds) = median(RUNS, || {
        let sequence = collapse(&mesh, &[], None, &options);
        sequence.replay(&mesh, sequence.reach(budget))
    });
    let mut rows = vec![("kiln quadric, half-edge", level.map_err(|e| e.to_string())?, seconds)];
    let (level, seconds) = median(RUNS, || {
        let sequence = collapse(&mesh, &[], None, &options);
        cut(&mesh, &[], &sequence, budget, Placement::Free)
    });
    rows.push(("kiln quadric, free", level, seconds));

    let indices: Vec<u32> = mesh.triangles.as_flattened().to_vec();
    let places: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.to_array()).collect();
    let target = budget as usize * 3;
    let adapter = VertexDataAdapter::new(typed_to_bytes(&places), 12, 0).map_err(|e| e.to_string())?;
    let (out, seconds) = median(RUNS, || meshopt::simplify(&indices, &adapter, target, 1e9, Meshopt::None, None));
    rows.push(("meshopt simplify", rebuilt(&mesh, &out, &places)?, seconds));
    let ((out, moved), seconds) = median(RUNS, || {
        let (mut indices, mut places) = (indices.clone(), places.clone());
        let count = meshopt::simplify_with_update(
            &mut indices,
            &mut places,
            &mut [],
            &[],
            0,
            None,
            target,
            1e9,
            Meshopt::None,
            None,
        );
        indices.truncate(count);
        (indices, places)
    });
    rows.push(("meshopt with_update, no attributes", rebuilt(&mesh, &out, &moved)?, seconds));

    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let own = rows[0].2;
    for (tool, level, seconds) in &rows {
        let distance = surface_distance(&mesh, level, SAMPLES).ok_or("a surface without area")?.in_diagonals();
        println!(
            "| {name}, {} | {tool} | {} | {seconds:.3} | {:.2} | {:.1} | {:.0} | {:.2} |",
            mesh.face_count(),
            level.face_count(),
            mesh.face_count() as f64 / seconds / 1e6,
            distance.mean * 1e5,
            distance.hausdorff * 1e5,
            seconds / own,
        );
    }
    Ok(())
}

/// The mesh's points as vertices, in one submesh, without attributes.
fn positions_only(mesh: &Mesh) -> Result<Mesh, String> {
    let mut places = vec![Vec3::ZERO; mesh.point_count()];
    for (v, p) in mesh.points.iter().enumerate().rev() {
        places[p.index()] = mesh.positions[v];
    }
    let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| mesh.points[v as usize].0)).collect();
    of(places, triangles)
}

fn rebuilt(mesh: &Mesh, indices: &[u32], places: &[[f32; 3]]) -> Result<Mesh, String> {
    debug_assert_eq!(mesh.vertex_count(), places.len());
    of(
        places.iter().map(|p| Vec3::from_array(*p)).collect(),
        indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
    )
}

fn of(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Result<Mesh, String> {
    let submesh = Submesh { name: "all".into(), source_triangles: triangles.len() as u32, ..Submesh::default() };
    Mesh::new(RawMesh {
        positions,
        face_submesh: vec![SubmeshId(0); triangles.len()],
        triangles,
        submeshes: vec![submesh],
        ..RawMesh::default()
    })
    .map_err(|e| e.to_string())
}
