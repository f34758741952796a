//! Cluster DAGs: kiln's beside meshoptimizer's `clusterlod`, and levels simplified as a whole.
//!
//! `cargo run --release -p kiln-bench --bin clusters -- MODEL... [--group N] [--attributes] [--out FILE]`
//!
//! Both build over the same vertices: the model's points, merged, without attributes; `--attributes` lets kiln build over the model as
//! it is, and leaves the peer out. Thresholds are found by bisection, so each row is the finest cut within its budget. Errors are
//! distances of 200,000 samples a side to the model, both ways, in 1e-5 of the diagonal; *said* is the threshold of the cut.

use std::path::PathBuf;
use std::process::ExitCode;

use kiln_asset::Mesh;
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{model, name, plain, positions_only, timed};
use kiln_lod::cluster_dag::{ClusterDag, ClusterDagOptions};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{Placement, SimplifyOptions, collapse, cut};
use kiln_measure::SurfaceReference;
use meshopt::{ClodMesh, VertexDataAdapter, clod_build, clod_default_config, typed_to_bytes};

const SAMPLES: usize = 200_000;
const SHARES: [f64; 5] = [0.5, 0.25, 0.1, 0.03, 0.01];

fn main() -> ExitCode {
    let (mut models, mut out, mut attributes) = (Vec::new(), None, false);
    let mut options = ClusterDagOptions::default();
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--group" => {
                options.group_size = args.next().and_then(|v| v.parse().ok()).unwrap_or(options.group_size);
            }
            "--attributes" => attributes = true,
            "--out" => out = args.next().map(PathBuf::from),
            _ => models.push(PathBuf::from(arg)),
        }
    }
    if models.is_empty() {
        eprintln!("usage: clusters MODEL... [--group N] [--attributes] [--out FILE]");
        return ExitCode::from(64);
    }
    let mut page = Page::new(out);
    page.line("# Cluster DAGs");
    page.line("");
    page.line(&stamp("cargo run --release -p kiln-bench --bin clusters -- MODEL..."));
    for path in &models {
        let done = model(path).and_then(|asset| {
            let (mesh, _) = merge(&asset.mesh, &MergeOptions::default());
            let mesh = if attributes { mesh } else { positions_only(&mesh)? };
            compare(&name(path), &mesh, &options, !attributes, &mut page)
        });
        if let Err(message) = done {
            eprintln!("{}: {message}", path.display());
            return ExitCode::FAILURE;
        }
    }
    match page.finish() {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

/// The peer's DAG.
#[derive(Default)]
struct Peer {
    /// Error of what replaces each group, object units.
    errors: Vec<f32>,
    /// Group, the group that made it or -1, where its indices start.
    clusters: Vec<(usize, i32, usize)>,
    indices: Vec<u32>,
    references: usize,
    levels: i32,
}

impl Peer {
    fn new(mesh: &Mesh) -> Result<Peer, String> {
        let places: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.to_array()).collect();
        let adapter = VertexDataAdapter::new(typed_to_bytes(&places), 12, 0).map_err(|e| e.to_string())?;
        let mut out = Peer::default();
        clod_build(
            clod_default_config(128),
            &ClodMesh::new(mesh.triangles.as_flattened(), &adapter),
            |group, clusters| {
                for cluster in clusters {
                    out.clusters.push((out.errors.len(), cluster.refined, out.indices.len()));
                    out.indices.extend_from_slice(cluster.indices);
                    out.references += cluster.vertex_count;
                }
                out.errors.push(group.simplified.error);
                out.levels = out.levels.max(group.depth + 1);
                out.errors.len() as i32 - 1
            },
        );
        Ok(out)
    }

    fn triangles(&self, threshold: f32) -> Vec<[u32; 3]> {
        let is_above = |group: usize| self.errors[group] > threshold;
        let mut out = Vec::new();
        for (c, (group, made_by, first)) in self.clusters.iter().enumerate() {
            if is_above(*group) && (*made_by < 0 || !is_above(*made_by as usize)) {
                let end = self.clusters.get(c + 1).map_or(self.indices.len(), |next| next.2);
                out.extend(self.indices[*first..end].chunks_exact(3).map(|t| [t[0], t[1], t[2]]));
            }
        }
        out
    }

    fn threshold_for(&self, triangles: usize) -> f32 {
        let (mut low, mut high) = (0, f32::MAX.to_bits() - 1);
        while low < high {
            let middle = low + (high - low) / 2;
            let few = self.triangles(f32::from_bits(middle)).len() <= triangles;
            if few { high = middle } else { low = middle + 1 }
        }
        f32::from_bits(low)
    }
}

fn compare(model: &str, mesh: &Mesh, options: &ClusterDagOptions, peer: bool, page: &mut Page) -> Result<(), String> {
    let faces = mesh.face_count();
    let build = || ClusterDag::new(mesh, options).map_err(|e| e.to_string());
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|e| e.to_string())?;
    let (dag, seconds) = timed(build);
    let dag = dag?;
    let (alone, seconds_alone) = timed(|| one.install(build));
    drop(alone);
    let report = dag.report();
    page.line("");
    page.line(&format!("## {model}, {faces} triangles, {} submeshes", mesh.submeshes.len()));
    page.line("");
    page.head(&[
        "tool",
        ":s",
        ":s, 1 thread",
        ":clusters",
        ":triangles a cluster",
        ":levels",
        ":groups",
        ":roots",
        ":passed on",
        ":coarsest",
        ":bytes a triangle",
    ]);
    page.row(&[
        "kiln".to_owned(),
        format!("{seconds:.2}"),
        format!("{seconds_alone:.2}"),
        report.clusters.to_string(),
        format!("{:.1}", 128.0 * report.fill),
        report.levels.to_string(),
        report.groups.to_string(),
        report.roots.to_string(),
        report.passed_on.to_string(),
        report.root_triangles.to_string(),
        format!("{:.1}", report.bytes as f64 / faces as f64),
    ]);
    let mut other = None;
    if peer {
        let (built, seconds) = timed(|| Peer::new(mesh));
        let built = built?;
        let bytes = 64 * built.clusters.len() + 32 * built.errors.len() + 4 * built.references + built.indices.len();
        page.row(&[
            "clusterlod, its defaults".to_owned(),
            String::new(),
            format!("{seconds:.2}"),
            built.clusters.len().to_string(),
            format!("{:.1}", built.indices.len() as f64 / 3.0 / built.clusters.len() as f64),
            built.levels.to_string(),
            built.errors.len().to_string(),
            built.errors.iter().filter(|e| **e == f32::MAX).count().to_string(),
            "-".to_owned(),
            built.triangles(f32::MAX.next_down()).len().to_string(),
            format!("{:.1}", bytes as f64 / faces as f64),
        ]);
        other = Some(built);
    }
    let surface = SurfaceReference::new(mesh, SAMPLES).ok_or("a surface without area")?;
    let sequence = collapse(mesh, &[], None, &SimplifyOptions::default());
    page.line("");
    page.head(&["keep", "tool", ":triangles", ":mean", ":greatest", ":said"]);
    for share in SHARES {
        let budget = (share * faces as f64) as u64;
        let mut row = |tool: &str, level: &Mesh, said: Option<f32>| -> Result<(), String> {
            let distance = surface.compare(level).ok_or("a level without area")?.in_diagonals();
            let said = said.map_or("-".into(), |said| format!("{:.0}", 1e5 * said / mesh.diagonal()));
            page.row(&[
                format!("{} %", share * 100.0),
                tool.to_owned(),
                level.face_count().to_string(),
                format!("{:.2}", distance.mean * 1e5),
                format!("{:.0}", distance.hausdorff * 1e5),
                said,
            ]);
            Ok(())
        };
        let threshold = dag.threshold_for(budget);
        row("kiln", &dag.level(mesh, threshold).map_err(|e| e.to_string())?, Some(threshold))?;
        if let Some(other) = &other {
            let threshold = other.threshold_for(budget as usize);
            row("clusterlod", &plain(mesh.positions.clone(), other.triangles(threshold))?, Some(threshold))?;
        }
        row("kiln, as a whole", &cut(mesh, &[], &sequence, budget as u32, Placement::HalfEdge), None)?;
    }
    Ok(())
}
