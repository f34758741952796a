//! Simplification by parts on models of many parts: what was asked and reached, what stayed untouched, and what it costs.
//!
//! `cargo run --release -p kiln-bench --bin parts -- MODEL... [--out FILE] [--runs N]`
//!
//! Levels of 50, 30 and 10 % of all triangles. Of the parts with at most 5 % of the triangles the largest is held at 100 %, the second
//! at 25 %, the third at half of what the second reached. Times are medians of runs with and without these rules in turn: the whole
//! stage, levels measured, and of that the dependencies, which a build makes once, and the cut, which a changed rule costs beside the
//! measuring of its levels.

#![allow(clippy::print_stdout, reason = "the table is this program's output")]

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use glam::{Vec2, Vec3};
use kiln_asset::{LodSet, Mesh, SubmeshId};
use kiln_bench::model;
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::parts::{PartLevel, PartRule};
use kiln_lod::simplify::{
    Budget, CollapseSequence, Dependencies, LevelsOptions, Parts, SimplifyOptions, SimplifyReport, collapse,
    levels_by_parts,
};

const SHARES: [f64; 3] = [0.5, 0.3, 0.1];

fn main() -> ExitCode {
    let (mut out, mut runs) = (None, 9);
    let mut models = Vec::new();
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--out" => out = args.next(),
            "--runs" => runs = args.next().and_then(|v| v.parse().ok()).unwrap_or(runs).max(1),
            _ => models.push(PathBuf::from(arg)),
        }
    }
    if models.is_empty() {
        eprintln!("usage: parts MODEL... [--out FILE] [--runs N]");
        return ExitCode::from(64);
    }
    let mut found = Vec::new();
    for path in &models {
        match try_model(path, runs) {
            Ok(one) => found.push(one),
            Err(message) => {
                eprintln!("{}: {message}", path.display());
                return ExitCode::FAILURE;
            }
        }
    }
    let text = page(&found);
    print!("{text}");
    if let Some(out) = out
        && let Err(error) = std::fs::write(&out, text)
    {
        eprintln!("{out}: {error}");
        return ExitCode::FAILURE;
    }
    ExitCode::SUCCESS
}

/// What one model gave.
struct Found {
    name: String,
    triangles: usize,
    parts: usize,
    joined: u32,
    levels: Vec<Row>,
    seconds: Times,
    dependencies: usize,
    collapses: usize,
    runs: usize,
}

/// One level: asked, reached, the three parts in words, untouched, gaps, continued collapses, why short.
type Row = (u32, u32, String, bool, u32, u32, Option<String>);

/// Medians, seconds.
struct Times {
    without: f64,
    with: f64,
    collapse: f64,
    dependencies: f64,
    cut: f64,
    plain_cut: f64,
}

fn try_model(path: &Path, runs: usize) -> Result<Found, String> {
    let weld = 1e-5;
    let asset = model(path)?;
    let weld = weld * asset.mesh.diagonal();
    let (mesh, report) = merge(&asset.mesh, &MergeOptions { weld, ..MergeOptions::default() });
    let rules = rules(&mesh)?;
    let options = LevelsOptions::default();
    // A model of a million takes its time, and its noise is small.
    let runs = match mesh.face_count() {
        0..200_000 => runs,
        200_000..1_000_000 => runs.min(5),
        _ => 1,
    };
    let unmeasured = LevelsOptions { samples: 0, ..options };
    let mut times: [Vec<f64>; 6] = Default::default();
    let mut last = None;
    for _ in 0..=runs {
        let start = Instant::now();
        let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
        let collapsed = start.elapsed().as_secs_f64();
        let plain = cut(&mesh, &sequence, &options, &Parts::default());
        let without = start.elapsed().as_secs_f64();
        drop(plain);

        let start = Instant::now();
        let dependencies = Dependencies::for_cuts(&mesh, &sequence).map_err(|e| e.to_string())?;
        let rested = start.elapsed().as_secs_f64();
        let parts = Parts { rules: &rules, dependencies: Some(&dependencies), ..Parts::default() };
        let made = cut(&mesh, &sequence, &options, &parts);
        let with = collapsed + start.elapsed().as_secs_f64();

        // Without the measuring of errors.
        let start = Instant::now();
        drop(cut(&mesh, &sequence, &unmeasured, &parts));
        let cut_alone = start.elapsed().as_secs_f64();
        let start = Instant::now();
        drop(cut(&mesh, &sequence, &unmeasured, &Parts::default()));
        let plain_alone = start.elapsed().as_secs_f64();
        let row = [without, with, collapsed, rested, cut_alone, plain_alone];
        times.iter_mut().zip(row).for_each(|(times, t)| times.push(t));
        last = Some((made, sequence, dependencies));
    }
    let Some(((set, levels), sequence, dependencies)) = last else { return Err("no run".into()) };
    // The first run warms up.
    let [without, with, collapse, rested, cut, plain_cut] = times.map(|mut times| {
        times.remove(0);
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    });
    let governed: Vec<usize> =
        rules.iter().filter_map(|rule| mesh.submeshes.iter().position(|s| s.name == rule.name)).collect();
    let described = |level: &Mesh| {
        let of = |s: usize| (level.submesh_faces(SubmeshId(s as u32)).len(), mesh.submeshes[s].source_triangles);
        governed.iter().map(|s| format!("{} of {}", of(*s).0, of(*s).1)).collect::<Vec<_>>().join(", ")
    };
    let source: u32 = mesh.submeshes.iter().map(|s| s.source_triangles).sum();
    let rows = set.levels.iter().zip(&levels.levels).zip(SHARES).map(|((level, report), share)| {
        let untouched = same(&mesh, &level.mesh, governed[0] as u32);
        let asked = (share * f64::from(source)) as u32;
        let parts = described(&level.mesh);
        (asked, report.triangles, parts, untouched, report.gaps, report.continued, report.short.clone())
    });
    Ok(Found {
        name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
        triangles: mesh.face_count(),
        parts: mesh.submeshes.len(),
        joined: report.joined_edges,
        levels: rows.collect(),
        seconds: Times { without, with, collapse, dependencies: rested, cut, plain_cut },
        dependencies: dependencies.byte_size(),
        collapses: sequence.collapses.len(),
        runs,
    })
}

fn cut(
    mesh: &Mesh,
    sequence: &CollapseSequence,
    options: &LevelsOptions,
    parts: &Parts<'_>,
) -> (LodSet, SimplifyReport) {
    levels_by_parts(mesh, &[], sequence, mesh, &SHARES.map(Budget::Keep), options, parts)
}

/// The three largest parts with at most a twentieth of the triangles.
fn rules(mesh: &Mesh) -> Result<Vec<PartRule>, String> {
    let most = mesh.face_count() as u32 / 20;
    let mut order: Vec<usize> =
        (0..mesh.submeshes.len()).filter(|s| mesh.submeshes[*s].source_triangles <= most).collect();
    order.sort_by_key(|s| (std::cmp::Reverse(mesh.submeshes[*s].source_triangles), *s));
    let [a, b, c, ..] = order[..] else { return Err("fewer than three parts of at most 5 %".into()) };
    let rule = |s: usize, level| PartRule { name: mesh.submeshes[s].name.clone(), level };
    Ok(vec![
        rule(a, PartLevel::Keep(1.0)),
        rule(b, PartLevel::Keep(0.25)),
        rule(c, PartLevel::Relative { to: 1, factor: 0.5 }),
    ])
}

/// Whether a submesh is the same bit for bit: positions, all attributes, order of faces and of its own vertices.
fn same(before: &Mesh, after: &Mesh, s: u32) -> bool {
    let of = |mesh: &Mesh| {
        let faces = mesh.submesh_faces(SubmeshId(s));
        let base = mesh.triangles[faces.clone()].iter().flatten().min().copied().unwrap_or(0);
        let corners: Vec<u32> = mesh.triangles[faces].iter().flatten().copied().collect();
        let place = |v: u32| mesh.positions[v as usize].to_array().map(f32::to_bits);
        let normal = |v: u32| mesh.normals.as_ref().map(|n: &Vec<Vec3>| n[v as usize].to_array().map(f32::to_bits));
        let uv = |v: u32| mesh.uv0.as_ref().map(|t: &Vec<Vec2>| t[v as usize].to_array().map(f32::to_bits));
        let color = |v: u32| mesh.colors.as_ref().map(|c| c[v as usize].to_array().map(f32::to_bits));
        corners.into_iter().map(|v| (v - base, place(v), normal(v), uv(v), color(v))).collect::<Vec<_>>()
    };
    of(before) == of(after)
}

fn page(found: &[Found]) -> String {
    let mut out = String::from(
        "# Simplification by parts\n\n\
         Made by `cargo run --release -p kiln-bench --bin parts -- MODEL... --out docs/results/parts.md`: levels of 50, 30 and 10 % of\n\
         all triangles, one part held at 100 %, one at 25 %, one at half of what that one reached. Half-edge placement, quadric metric.\n\n\
         | model | triangles | parts | joined edges | asked | reached | held at 100 %, 25 %, half of that | untouched | gaps | continued |\n\
         | --- | --: | --: | --: | --: | --: | --- | --- | --: | --: |\n",
    );
    let mut short = String::new();
    for one in found {
        for (asked, reached, parts, untouched, gaps, continued, why) in &one.levels {
            let untouched = if *untouched { "yes" } else { "NO" };
            let _ = writeln!(
                out,
                "| {} | {} | {} | {} | {asked} | {reached} | {parts} | {untouched} | {gaps} | {continued} |",
                one.name, one.triangles, one.parts, one.joined
            );
            if let Some(why) = why {
                let _ = writeln!(short, "- {}, {asked} triangles asked: {why}.", one.name);
            }
        }
    }
    let missed = if short.is_empty() { String::from("Every total and every rule was met.\n") } else { short };
    let _ = write!(
        out,
        "\n{missed}\n\
         Seconds, medians on 2 shared cores with other work on them, so only ratios count. A stage is collapse, dependencies, cut and the measuring of three levels' errors; the cuts stand\n\
         without that measuring:\n\n\
         | model | collapses | runs | without rules | with rules | ratio | collapse | dependencies | of the collapse | cut | cut without rules | part logic of the stage | cut of the first build | dependencies, bytes a triangle |\n\
         | --- | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: |\n",
    );
    for one in found {
        let t = &one.seconds;
        let _ = writeln!(
            out,
            "| {} | {} | {} | {:.3} | {:.3} | {:.3} | {:.3} | {:.3} | {:.1} % | {:.3} | {:.3} | {:.1} % | {:.1} % | {:.1} |",
            one.name,
            one.collapses,
            one.runs,
            t.without,
            t.with,
            t.with / t.without,
            t.collapse,
            t.dependencies,
            100.0 * t.dependencies / t.collapse,
            t.cut,
            t.plain_cut,
            100.0 * (t.dependencies + t.cut - t.plain_cut).max(0.0) / t.without,
            100.0 * t.cut / t.with,
            one.dependencies as f64 / one.triangles as f64,
        );
    }
    out
}
