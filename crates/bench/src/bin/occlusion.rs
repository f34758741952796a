//! Ambient occlusion beside its plain twin: rays a second on one thread, and whether both say the same.
//!
//! `cargo run --release -p kiln-bench --bin occlusion -- MODEL... [--points N] [--rays N] [--runs N]`
//!
//! Rays ask whether anything is met; the twin looks for the first hit, over the same directions. Points lie on the faces, evenly by area;
//! rays go as far as the diagonal. The last column is the whole of the bake's ambient occlusion at those points.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use glam::Vec3;
use kiln_asset::{FaceId, Mesh};
use kiln_bake::occlusion::Occluder;
use kiln_bench::rows::Page;
use kiln_bench::{middle, model, name, timed};
use kiln_geom::Bvh;
use kiln_geom::sample::fibonacci_sphere;
use kiln_lod::merge::{MergeOptions, merge};

fn main() -> ExitCode {
    let (mut models, mut points, mut rays, mut runs) = (Vec::new(), 20_000usize, 64u32, 3usize);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut number = || args.next().and_then(|v| v.parse::<usize>().ok()).unwrap_or(1).max(1);
        match arg.as_str() {
            "--points" => points = number(),
            "--rays" => rays = number() as u32,
            "--runs" => runs = number(),
            _ => models.push(PathBuf::from(arg)),
        }
    }
    if models.is_empty() {
        eprintln!("usage: occlusion MODEL... [--points N] [--rays N] [--runs N]");
        return ExitCode::from(64);
    }
    let mut page = Page::new(None);
    page.head(&[
        "model",
        ":triangles",
        ":any hit, Mrays/s",
        ":first hit, Mrays/s",
        ":times faster",
        ":rays that differ",
        ":occlusion, Mrays/s",
    ]);
    for path in &models {
        if let Err(message) = compare(path, points, rays, runs, &mut page) {
            eprintln!("{}: {message}", path.display());
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

fn compare(path: &Path, points: usize, rays: u32, runs: usize, page: &mut Page) -> Result<(), String> {
    let (mesh, _) = merge(&model(path)?.mesh, &MergeOptions::default());
    let bvh = Bvh::new(&mesh.positions, &mesh.triangles);
    let reach = mesh.diagonal();
    let occluder = Occluder::new(&bvh, &mesh.positions, &mesh.triangles, rays, reach);
    let places = places(&mesh, points);
    // Every ray starts a little off its face.
    let sphere = fibonacci_sphere(rays as usize);
    let lift = 1e-5 * reach;
    let each = |met: &dyn Fn(Vec3, Vec3) -> bool| {
        let mut found = Vec::with_capacity(places.len() * sphere.len());
        for (p, n, _) in &places {
            let origin = *p + lift * *n;
            found.extend(sphere.iter().map(|d| met(origin, if d.dot(*n) < 0.0 { -*d } else { *d })));
        }
        found
    };
    let (mut any, mut first, mut whole) = (Vec::new(), Vec::new(), Vec::new());
    let mut differ = 0;
    for _ in 0..runs {
        let (own, seconds) = timed(|| each(&|o, d| bvh.occluded(o, d, 0.0, reach)));
        any.push(seconds);
        let (twin, seconds) = timed(|| each(&|o, d| bvh.closest_hit(o, d, 0.0, reach).is_some()));
        first.push(seconds);
        differ = own.iter().zip(&twin).filter(|(a, b)| a != b).count();
        let (shares, seconds) = timed(|| places.iter().map(|(p, n, f)| occluder.at(*p, *n, *f, 0).share).sum::<f32>());
        if !shares.is_finite() {
            return Err("a share is no number".into());
        }
        whole.push(seconds);
    }
    let asked = places.len() as f64 * f64::from(rays) / 1e6;
    let (any, first, whole) = (middle(any), middle(first), middle(whole));
    page.row(&[
        name(path),
        mesh.face_count().to_string(),
        format!("{:.2}", asked / any),
        format!("{:.2}", asked / first),
        format!("{:.2}", first / any),
        differ.to_string(),
        format!("{:.2}", asked / whole),
    ]);
    Ok(())
}

/// About `count` places on the mesh with their faces' normals, evenly by area.
fn places(mesh: &Mesh, count: usize) -> Vec<(Vec3, Vec3, u32)> {
    let cross = |face: u32| {
        let [a, b, c] = mesh.face_positions(FaceId(face));
        (b - a).cross(c - a)
    };
    let faces = 0..mesh.face_count() as u32;
    let whole: f64 = faces.clone().map(|f| f64::from(cross(f).length())).sum();
    let (mut places, mut owed) = (Vec::new(), 0.0);
    for face in faces {
        let normal = cross(face);
        owed += f64::from(normal.length()) / whole * count as f64;
        let Some(normal) = normal.try_normalize() else { continue };
        while owed >= 1.0 {
            owed -= 1.0;
            // Golden steps over the triangle, folded back into it.
            let k = places.len() as f32;
            let (mut u, mut v) = ((k * 0.754_877_7).fract(), (k * 0.569_840_3).fract());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let [a, b, c] = mesh.face_positions(FaceId(face));
            places.push((a + u * (b - a) + v * (c - a), normal, face));
        }
    }
    places
}
