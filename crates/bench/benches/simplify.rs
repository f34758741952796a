//! Simplify beside `meshopt` in one run, on one thread: `KILN_CORPUS=... cargo bench -p kiln-bench --bench simplify [MODEL]...`
//!
//! Prints, for each model and share of triangles kept, the seconds of the simplifier (median of 5 after one warm-up), input
//! triangles a second, and the distance to the input: mean and greatest of 100,000 samples a side, in 1e-5 of the diagonal.
//! kiln's seconds are those of the whole collapse sequence to exhaustion and one cut out of it; meshopt's those of one call.
//! Positions only: every model is welded by position first, so that both simplify the same points.

use std::io::Write;
use std::path::Path;
use std::time::Instant;

use glam::Vec3;
use kiln_asset::import::{Folder, ImportLimits, import};
use kiln_asset::{Mesh, RawMesh, Submesh, SubmeshId};
use kiln_geom::Bvh;
use kiln_geom::sample::SurfaceSamples;
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{SimplifyOptions, collapse};
use rayon::prelude::*;

const MODELS: [&str; 4] = [
    "scans/stanford-bunny.glb",
    "scans/armadillo.glb",
    "gltf/FlightHelmet/FlightHelmet.gltf",
    "cad/2CylinderEngine.glb",
];
const KEPT: [f64; 4] = [0.5, 0.25, 0.1, 0.01];
const SAMPLES: usize = 100_000;

fn main() {
    let Some(corpus) = std::env::var_os("KILN_CORPUS") else {
        say("skipped: needs KILN_CORPUS, the folder of the real models");
        return;
    };
    let named: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let models: Vec<&str> = if named.is_empty() { MODELS.to_vec() } else { named.iter().map(String::as_str).collect() };
    for model in models {
        match load(Path::new(&corpus), model) {
            Ok(mesh) => compare(model, &mesh),
            Err(message) => say(&format!("{model}: {message}")),
        }
    }
}

fn say(line: &str) {
    // A closed pipe ends the talk, nothing else.
    let _ = writeln!(std::io::stdout(), "{line}");
}

/// The model's triangles over its points, one submesh, no attributes.
fn load(corpus: &Path, model: &str) -> Result<Mesh, String> {
    let path = corpus.join(model);
    let (folder, name) = (path.parent().unwrap_or(corpus), path.file_name().and_then(|n| n.to_str()).unwrap_or(""));
    let (asset, _) =
        import(&Folder(folder.to_path_buf()), name, &ImportLimits::default()).map_err(|error| error.to_string())?;
    let (mesh, _) = merge(&asset.mesh, &MergeOptions { weld: 1e-5 * asset.mesh.diagonal() });
    let mut positions = vec![Vec3::ZERO; mesh.point_count()];
    for (v, p) in mesh.points.iter().enumerate().rev() {
        positions[p.index()] = mesh.positions[v];
    }
    let triangles: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| mesh.points[v as usize].0)).collect();
    let raw = RawMesh {
        positions,
        face_submesh: vec![SubmeshId(0); triangles.len()],
        submeshes: vec![Submesh { source_triangles: triangles.len() as u32, ..Default::default() }],
        triangles,
        ..Default::default()
    };
    Mesh::new(raw).map(|mesh| merge(&mesh, &MergeOptions::default()).0).map_err(|error| error.to_string())
}

/// Median seconds of five runs after one, and the result.
fn timed<T>(mut run: impl FnMut() -> T) -> (f64, T) {
    let mut result = run();
    let mut seconds: Vec<f64> = (0..5)
        .map(|_| {
            let start = Instant::now();
            result = run();
            start.elapsed().as_secs_f64()
        })
        .collect();
    seconds.sort_by(f64::total_cmp);
    (seconds[2], result)
}

fn compare(model: &str, mesh: &Mesh) {
    let reference = Surface::new(&mesh.positions, &mesh.triangles);
    let indices: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    say(&format!("{model}: {} triangles, {} points", mesh.face_count(), mesh.point_count()));
    say("  simplifier                 kept      seconds  Mtri/s  triangles     mean  hausdorff");
    for kept in KEPT {
        let faces = (kept * mesh.face_count() as f64) as usize;
        let row = |name: &str, seconds: f64, positions: &[Vec3], triangles: &[[u32; 3]]| {
            let [mean, greatest] =
                reference.distance(&Surface::new(positions, triangles)).map(|d| d / reference.diagonal * 1e5);
            let speed = mesh.face_count() as f64 / seconds / 1e6;
            let count = triangles.len();
            say(&format!("  {name:25} {kept:5}  {seconds:11.4}  {speed:6.2}  {count:9}  {mean:7.1}  {greatest:9.0}"));
        };

        let (seconds, level) = timed(|| {
            let sequence = collapse(mesh, &[], None, &SimplifyOptions::default());
            sequence.replay(mesh, sequence.reach(faces as u32))
        });
        match level {
            Ok(level) => row("kiln quadric, half-edge", seconds, &level.positions, &level.triangles),
            Err(error) => say(&format!("  kiln: {error}")),
        }

        let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|p| p.to_array()).collect();
        let (seconds, simplified) = timed(|| {
            let options = meshopt::SimplifyOptions::None;
            meshopt::simplify_decoder(&indices, &positions, 3 * faces, f32::MAX, options, None)
        });
        row("meshopt simplify", seconds, &mesh.positions, &threes(&simplified));

        let (seconds, (updated, moved)) = timed(|| {
            let (mut triangles, mut moved) = (indices.clone(), positions.clone());
            let mut normals = vec![0.0_f32; 3 * moved.len()];
            let options = meshopt::SimplifyOptions::None;
            let weights = [0.0_f32; 3];
            let length = meshopt::simplify_with_update(
                &mut triangles,
                &mut moved,
                &mut normals,
                &weights,
                12,
                None,
                3 * faces,
                f32::MAX,
                options,
                None,
            );
            triangles.truncate(length);
            (triangles, moved)
        });
        let moved: Vec<Vec3> = moved.into_iter().map(Vec3::from_array).collect();
        row("meshopt with_update, nw 0", seconds, &moved, &threes(&updated));
    }
}

fn threes(indices: &[u32]) -> Vec<[u32; 3]> {
    indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect()
}

/// A surface to measure from and to.
struct Surface {
    bvh: Bvh,
    samples: Vec<Vec3>,
    diagonal: f64,
}

impl Surface {
    fn new(positions: &[Vec3], triangles: &[[u32; 3]]) -> Surface {
        let samples = SurfaceSamples::new(positions, triangles, SAMPLES, 1);
        let diagonal = samples
            .samples
            .iter()
            .fold([Vec3::INFINITY, -Vec3::INFINITY], |[lo, hi], s| [lo.min(s.position), hi.max(s.position)]);
        Surface {
            bvh: Bvh::new(positions, triangles),
            samples: samples.samples.iter().map(|s| s.position).collect(),
            diagonal: f64::from((diagonal[1] - diagonal[0]).length()),
        }
    }

    /// Mean (of both sides' means) and greatest distance.
    fn distance(&self, other: &Surface) -> [f64; 2] {
        let side = |from: &Surface, to: &Surface| -> [f64; 2] {
            let distances: Vec<f64> = from
                .samples
                .par_iter()
                .map(|p| to.bvh.nearest_point(*p).map_or(f64::INFINITY, |near| f64::from(near.distance)))
                .collect();
            [
                distances.iter().sum::<f64>() / distances.len().max(1) as f64,
                distances.iter().copied().fold(0.0, f64::max),
            ]
        };
        let (a, b) = (side(self, other), side(other, self));
        [0.5 * (a[0] + b[0]), a[1].max(b[1])]
    }
}
