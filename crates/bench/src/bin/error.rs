//! Measuring a level's error beside its plain twin: seconds, and whether both give the same bits.
//!
//! `cargo run --release -p kiln-bench --bin error -- MODEL... [--keep SHARE]... [--runs N]`
//!
//! The twin finds the nearest point of every sample and takes the maximum. Columns: seconds for one level against a source that is
//! ready, as the stage does it, and the parts that both have in common (the level's samples and its tree).

use std::path::PathBuf;
use std::process::ExitCode;

use glam::Vec3;
use kiln_asset::Mesh;
use kiln_bench::rows::Page;
use kiln_bench::{middle, model, name, timed};
use kiln_geom::Bvh;
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::error::{Surface, sample_points};
use kiln_lod::simplify::{LevelsOptions, Placement, SimplifyOptions, collapse, cut};
use rayon::prelude::*;

fn main() -> ExitCode {
    let (mut shares, mut models, mut runs) = (Vec::new(), Vec::new(), 5usize);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--keep" => shares.extend(args.next().and_then(|v| v.parse::<f64>().ok())),
            "--runs" => runs = args.next().and_then(|v| v.parse().ok()).unwrap_or(runs).max(1),
            _ => models.push(PathBuf::from(arg)),
        }
    }
    if models.is_empty() {
        eprintln!("usage: error MODEL... [--keep SHARE]... [--runs N]");
        return ExitCode::from(64);
    }
    if shares.is_empty() {
        shares.extend([0.5, 0.25, 0.1, 0.01]);
    }
    let mut page = Page::new(None);
    page.head(&["model, keep", ":error", ":plain s", ":s", ":plain / now", ":samples s", ":tree s", ":collapse s"]);
    for path in &models {
        if let Err(message) = compare(path, &shares, runs, &mut page) {
            eprintln!("{}: {message}", path.display());
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}

/// The source ready for the twin.
struct Plain {
    bvh: Bvh,
    samples: Vec<Vec3>,
}

impl Plain {
    fn distance(&self, level: &Mesh, limit: u32) -> f32 {
        let farthest = |points: &[Vec3], surface: &Bvh| {
            let distances = points.par_iter().map(|p| surface.nearest_point(*p).map_or(0.0, |near| near.distance));
            distances.reduce(|| 0.0, f32::max)
        };
        let other = Bvh::new(&level.positions, &level.triangles);
        farthest(&self.samples, &other).max(farthest(&sample_points(level, limit), &self.bvh))
    }
}

fn compare(path: &std::path::Path, shares: &[f64], runs: usize, page: &mut Page) -> Result<(), String> {
    let limit = LevelsOptions::default().samples;
    let (mesh, _) = merge(&model(path)?.mesh, &MergeOptions::default());
    let surface = Surface::new(&mesh, limit);
    let plain = Plain { bvh: Bvh::new(&mesh.positions, &mesh.triangles), samples: sample_points(&mesh, limit) };
    let (sequence, collapsing) = timed(|| collapse(&mesh, &[], None, &SimplifyOptions::default()));
    for share in shares {
        let budget = (share * mesh.face_count() as f64) as u32;
        let level = cut(&mesh, &[], &sequence, budget, Placement::Free);
        let mut seconds: [Vec<f64>; 4] = Default::default();
        let mut errors = [0.0; 2];
        for _ in 0..runs {
            let (error, slow) = timed(|| plain.distance(&level, limit));
            let (own, fast) = timed(|| surface.distance(&level));
            let (_, sampling) = timed(|| sample_points(&level, limit));
            let (_, tree) = timed(|| Bvh::new(&level.positions, &level.triangles));
            errors = [error, own];
            seconds.iter_mut().zip([slow, fast, sampling, tree]).for_each(|(all, one)| all.push(one));
        }
        if errors[0].to_bits() != errors[1].to_bits() {
            return Err(format!("the plain error is {:e}, this one {:e}", errors[0], errors[1]));
        }
        let [slow, fast, sampling, tree] = seconds.map(middle);
        page.row(&[
            format!("{}, {} %", name(path), share * 100.0),
            format!("{:.3e}", errors[1]),
            format!("{slow:.4}"),
            format!("{fast:.4}"),
            format!("{:.1}", slow / fast),
            format!("{sampling:.4}"),
            format!("{tree:.4}"),
            format!("{collapsing:.3}"),
        ]);
    }
    Ok(())
}
