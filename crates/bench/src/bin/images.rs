//! Pictures of simplified textured models beside the `meshopt` crate's: image error and mean distance at equal triangle count.
//!
//! `cargo run --release -p kiln-bench --bin images -- MODEL... [--keep SHARE]... [--settings] [--out FILE]`
//!
//! RMSE over object pixels (either picture's), codes 0..255, 24 views at 512x512, flat base colour; the mean of both mean
//! distances in 1e-5 of the reference's diagonal. kiln runs without any setting for the model; of meshoptimizer the best of
//! twelve counts, model by model and share by share (`peer` says how it is called). A setting that does not come down to the
//! budget (within 1 %) has more triangles to draw with and counts only where none comes down. `--settings` prints them all.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kiln_asset::{Asset, Mesh};
use kiln_bench::peer::{Input, Setting};
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{base_colors, model, name};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{Placement, SimplifyOptions, simplify};
use kiln_measure::{CompareOptions, FlatReference, Scene, SurfaceReference};

/// Sample points a side for the distances.
const SAMPLES: usize = 100_000;
/// The shares that are tried where none is named.
const SHARES: [f64; 2] = [0.25, 0.1];

/// A way to simplify a merged mesh to a number of triangles.
type Tool = (&'static str, fn(&Mesh, u32) -> Mesh);

/// kiln's ways; another metric is another line.
const TOOLS: &[Tool] = &[
    ("quadric, half-edge", |mesh, budget| simplify(mesh, budget, Placement::HalfEdge, &SimplifyOptions::default())),
    ("quadric, free", |mesh, budget| simplify(mesh, budget, Placement::Free, &SimplifyOptions::default())),
];

/// One level and how far it is off.
struct Score {
    tool: String,
    triangles: usize,
    rmse: f64,
    /// 1e-5 of the diagonal.
    mean: f64,
}

/// All levels of one model at one share.
struct Contest {
    model: String,
    share: f64,
    budget: u32,
    /// `[TOOLS.len()]`
    kiln: Vec<Score>,
    peers: Vec<Score>,
}

fn main() -> ExitCode {
    let (mut shares, mut models, mut out, mut settings) = (Vec::new(), Vec::new(), None, false);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--keep" => shares.extend(args.next().and_then(|v| v.parse::<f64>().ok())),
            "--out" => out = args.next().map(PathBuf::from),
            "--settings" => settings = true,
            _ => models.push(PathBuf::from(arg)),
        }
    }
    if models.is_empty() {
        eprintln!("usage: images MODEL... [--keep SHARE]... [--settings] [--out FILE]");
        return ExitCode::from(64);
    }
    if shares.is_empty() {
        shares.extend(SHARES);
    }
    match run(&models, &shares, settings, out) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(models: &[PathBuf], shares: &[f64], settings: bool, out: Option<PathBuf>) -> Result<(), String> {
    let mut page = Page::new(out);
    page.line("# Pictures of simplified models");
    page.line("");
    page.line(&stamp("cargo run --release -p kiln-bench --bin images -- MODEL..."));
    page.line("");
    page.line("RMSE over object pixels (24 views, 512x512, flat base colour, codes 0..255) and mean surface distance (1e-5 of the");
    page.line("diagonal) at equal triangle count. kiln has one setting for all; of meshoptimizer the best of twelve counts in each row");
    page.line("(with_attributes and with_update, UV weight 1, 10, 100, normal weight 0, 0.5; all submeshes in one call, no locks).");
    page.line("");
    let mut contests = Vec::new();
    if settings {
        page.head(&["model, share", "tool", ":triangles", ":RMSE", ":mean"]);
    }
    for path in models {
        let asset = model(path)?;
        let found = contest(path, &asset, shares).map_err(|e| format!("{}: {e}", path.display()))?;
        for contest in found {
            if settings {
                for score in contest.kiln.iter().chain(&contest.peers) {
                    let label = format!("{}, {} %", contest.model, contest.share * 100.0);
                    let (triangles, rmse, mean) = (score.triangles.to_string(), two(score.rmse), one(score.mean));
                    page.row(&[&label, &score.tool, &triangles, &rmse, &mean]);
                }
            } else {
                eprintln!("{}, {} %", contest.model, contest.share * 100.0);
            }
            contests.push(contest);
        }
    }
    if settings {
        page.line("");
    }
    summary(&mut page, &contests);
    page.finish()
}

/// A row for each contest: every kiln tool and the best peer; then how often each kiln tool is level or ahead.
fn summary(page: &mut Page, contests: &[Contest]) {
    let mut columns =
        vec!["model, share (triangles)".to_owned(), "best meshoptimizer: RMSE, mean".into(), "setting".into()];
    columns.extend(TOOLS.iter().map(|(tool, _)| format!(":kiln {tool}: RMSE, mean, ratio of RMSE")));
    page.head(&columns.iter().map(String::as_str).collect::<Vec<_>>());
    let figures = |score: &Score, budget: u32| {
        let over = match score.triangles as u32 > budget + budget / 100 {
            true => format!(" ({} triangles)", score.triangles),
            false => String::new(),
        };
        format!("{}, {}{over}", two(score.rmse), one(score.mean))
    };
    for contest in contests {
        let Some(best) = contest.best_peer() else { continue };
        let mut cells = vec![
            format!("{}, {} % ({})", contest.model, contest.share * 100.0, contest.budget),
            figures(best, contest.budget),
            best.tool.trim_start_matches("meshopt ").to_owned(),
        ];
        for score in &contest.kiln {
            cells.push(format!("{}, {}", figures(score, contest.budget), two(score.rmse / best.rmse)));
        }
        page.row(&cells);
    }
    page.line("");
    for (k, (tool, _)) in TOOLS.iter().enumerate() {
        let ratios: Vec<f64> = contests
            .iter()
            .filter_map(|c| Some(c.kiln[k].rmse / c.best_peer()?.rmse))
            .filter(|r| r.is_finite())
            .collect();
        let level = ratios.iter().filter(|ratio| **ratio <= 1.0).count();
        let worst = ratios.iter().fold(0.0f64, |worst, ratio| worst.max(*ratio));
        let logs: f64 = ratios.iter().map(|r| r.ln()).sum();
        let mean = (logs / ratios.len().max(1) as f64).exp();
        page.line(&format!(
            "- kiln {tool}: at or below the best meshoptimizer in {level} of {}, geometric mean of the ratios {}, worst {}",
            ratios.len(),
            two(mean),
            two(worst)
        ));
    }
}

impl Contest {
    /// The peer with the least RMSE among those that came down to the budget; among all, if none did.
    fn best_peer(&self) -> Option<&Score> {
        let reached = |score: &&Score| score.triangles as u32 <= self.budget + self.budget / 100;
        let least = |a: &&Score, b: &&Score| a.rmse.total_cmp(&b.rmse);
        self.peers.iter().filter(reached).min_by(least).or_else(|| self.peers.iter().min_by(least))
    }
}

fn contest(path: &Path, asset: &Asset, shares: &[f64]) -> Result<Vec<Contest>, String> {
    let images = base_colors(asset)?;
    let scene = Scene { mesh: &asset.mesh, materials: &asset.materials, images: &images };
    let pictures = FlatReference::new(&scene, &CompareOptions::default());
    let surface = SurfaceReference::new(&asset.mesh, SAMPLES).ok_or("a surface without area")?;
    let score = |tool: String, level: &Mesh| -> Result<Score, String> {
        let distance = surface.compare(level).ok_or("a level without area")?;
        let rmse = pictures.compare(level).map_err(|e| e.to_string())?.rmse_object;
        Ok(Score { tool, triangles: level.face_count(), rmse, mean: distance.in_diagonals().mean * 1e5 })
    };
    let (merged, _) = merge(&asset.mesh, &MergeOptions::default());
    let settings: Vec<(String, Input)> = Setting::textured()
        .into_iter()
        .map(|setting| Ok((setting.name(), Input::new(&merged, setting)?)))
        .collect::<Result<_, String>>()?;
    shares
        .iter()
        .map(|share| {
            let budget = (share * asset.mesh.face_count() as f64) as u32;
            let kiln = TOOLS.iter().map(|(tool, run)| score(format!("kiln {tool}"), &run(&merged, budget)));
            let peers = settings.iter().map(|(tool, input)| score(tool.clone(), &input.level(&input.run(budget)?.0)?));
            Ok(Contest {
                model: name(path),
                share: *share,
                budget,
                kiln: kiln.collect::<Result<_, String>>()?,
                peers: peers.collect::<Result<_, String>>()?,
            })
        })
        .collect()
}

fn one(value: f64) -> String {
    format!("{value:.1}")
}

fn two(value: f64) -> String {
    format!("{value:.2}")
}
