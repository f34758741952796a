//! Simplification beside the `meshopt` crate: seconds, input triangles a second, surface distance, normals, border.
//!
//! `cargo run --release -p kiln-bench --bin simplify -- MODEL... [--keep SHARE]... [--runs N] [--quick] [--save FOLDER] [--out FILE]`
//!
//! Positions only: one vertex a point, no attributes, one submesh; where a peer weighs normals, area-weighted ones. Only the
//! call is timed: kiln's is the collapse sequence down to the share and the level cut from it, meshoptimizer's the one call; the
//! row "whole sequence" is the sequence to exhaustion, from which further levels cost a cut each. The timed runs of all tools take
//! turns, so that what else the machine does hits all alike; the median of the runs counts. kiln runs on one thread and on
//! two, meshoptimizer has one.
//!
//! Distances are those of kiln-measure: exact nearest points of 500,000 samples a side. `--quick` leaves them out. `--save`
//! writes source and levels as OBJ files, for other tools to measure.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kiln_asset::Mesh;
use kiln_bench::peer::{Call, Input, Output, Setting};
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{middle, model, name, positions_only, timed};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{MetricKind, Placement, SimplifyOptions, collapse};
use kiln_measure::{Border, SurfaceReference};
use rayon::ThreadPool;

/// Sample points a side for the distances.
const SAMPLES: usize = 500_000;
/// The shares that are tried where none is named.
const SHARES: [f64; 4] = [0.5, 0.25, 0.1, 0.01];
/// The peer whose speed all others are set against.
const PEER: Setting = Setting { call: Call::WithUpdate, uv: 0.0, normal: 0.0 };

/// A way to simplify a mesh to a number of triangles.
type Tool = (&'static str, fn(&Mesh, u32) -> Mesh);

/// kiln's ways; another metric is another line.
const TOOLS: &[Tool] = &[
    ("quadric, half-edge", |mesh, budget| quadric(mesh, budget, Placement::HalfEdge)),
    ("quadric, free", |mesh, budget| quadric(mesh, budget, Placement::Free)),
    ("memoryless", |mesh, budget| {
        let options = SimplifyOptions { metric: MetricKind::Memoryless, ..SimplifyOptions::default() };
        kiln_lod::simplify::simplify(mesh, budget, Placement::Free, &options)
    }),
];

fn quadric(mesh: &Mesh, budget: u32, placement: Placement) -> Mesh {
    kiln_lod::simplify::simplify(mesh, budget, placement, &SimplifyOptions::default())
}

struct Arguments {
    models: Vec<PathBuf>,
    shares: Vec<f64>,
    runs: usize,
    quick: bool,
    save: Option<PathBuf>,
    out: Option<PathBuf>,
}

fn main() -> ExitCode {
    let mut given = Arguments { models: Vec::new(), shares: Vec::new(), runs: 5, quick: false, save: None, out: None };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--keep" => given.shares.extend(args.next().and_then(|v| v.parse::<f64>().ok())),
            "--runs" => given.runs = args.next().and_then(|v| v.parse().ok()).unwrap_or(given.runs).max(1),
            "--quick" => given.quick = true,
            "--save" => given.save = args.next().map(PathBuf::from),
            "--out" => given.out = args.next().map(PathBuf::from),
            _ => given.models.push(PathBuf::from(arg)),
        }
    }
    if given.models.is_empty() {
        eprintln!("usage: simplify MODEL... [--keep SHARE]... [--runs N] [--quick] [--save FOLDER] [--out FILE]");
        return ExitCode::from(64);
    }
    if given.shares.is_empty() {
        given.shares.extend(SHARES);
    }
    match run(given) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(given: Arguments) -> Result<(), String> {
    let pools = [pool(1)?, pool(2)?];
    let mut page = Page::new(given.out.clone());
    page.line("# Simplification beside meshoptimizer");
    page.line("");
    page.line(&stamp("cargo run --release -p kiln-bench --bin simplify -- MODEL..."));
    page.line("");
    page.line(&format!(
        "Positions only; median of {} runs in which the tools take turns. Speed: input triangles a second, and as a share of \
         meshoptimizer's with_update at normal weight 0 in the same row group. Mean and greatest distance in 1e-5 of the diagonal, \
         {SAMPLES} samples a side; mean angle between true normals in degrees; share of the border's length kept.",
        given.runs
    ));
    for path in &given.models {
        let failed = |e: String| format!("{}: {e}", path.display());
        let (merged, _) = merge(&model(path).map_err(failed)?.mesh, &MergeOptions::default());
        let mesh = positions_only(&merged).map_err(failed)?;
        page.line("");
        page.line(&format!("## {}, {} triangles", name(path), mesh.face_count()));
        page.line("");
        page.head(&[
            ":keep",
            "tool",
            ":threads",
            ":triangles",
            ":seconds",
            ":Mtri/s",
            ":speed",
            ":mean",
            ":greatest",
            ":normals",
            ":border",
        ]);
        compare(&name(path), &mesh, &pools, &given, &mut page).map_err(failed)?;
    }
    page.finish()
}

fn pool(threads: usize) -> Result<ThreadPool, String> {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(|e| e.to_string())
}

/// What a tool left of its last run.
enum Left {
    Nothing,
    Level(Box<Mesh>),
    Buffers(Output),
}

/// A row: a tool on a number of threads.
struct Row<'a> {
    tool: String,
    threads: usize,
    run: Box<dyn Fn() -> Result<(Left, f64), String> + 'a>,
    input: Option<&'a Input>,
    seconds: Vec<f64>,
    left: Left,
}

fn compare(model: &str, mesh: &Mesh, pools: &[ThreadPool], given: &Arguments, page: &mut Page) -> Result<(), String> {
    let Arguments { shares, runs, quick, save, .. } = given;
    let settings = [
        PEER,
        Setting { call: Call::WithUpdate, uv: 0.0, normal: 0.5 },
        Setting { call: Call::WithAttributes, uv: 0.0, normal: 0.5 },
        Setting { call: Call::Simplify, uv: 0.0, normal: 0.0 },
    ];
    let inputs: Vec<Input> = settings.iter().map(|setting| Input::new(mesh, *setting)).collect::<Result<_, _>>()?;
    if let Some(folder) = save {
        obj(&folder.join(format!("{model}.obj")), mesh)?;
    }
    let surface = match quick {
        true => None,
        false => Some(SurfaceReference::new(mesh, SAMPLES).ok_or("a surface without area")?),
    };
    let border = Border::of(mesh);
    for share in shares {
        let budget = (share * mesh.face_count() as f64) as u32;
        let mut rows: Vec<Row<'_>> = Vec::new();
        for (tool, run) in TOOLS {
            for pool in pools {
                rows.push(Row::new(format!("kiln {tool}"), pool.current_num_threads(), None, move || {
                    let (level, seconds) = timed(|| pool.install(|| run(mesh, budget)));
                    Ok((Left::Level(Box::new(level)), seconds))
                }));
            }
        }
        for (setting, input) in settings.iter().zip(&inputs) {
            rows.push(Row::new(setting.name(), 1, Some(input), move || {
                input.run(budget).map(|(output, seconds)| (Left::Buffers(output), seconds))
            }));
        }
        take_turns(&mut rows, *runs)?;
        let peer = rows.iter().find(|row| row.tool == PEER.name()).map_or(f64::NAN, Row::median);
        // The same level on any thread count: measured once.
        let mut measured: Option<(String, [String; 5])> = None;
        for row in &rows {
            let figures = match measured.take() {
                Some((tool, figures)) if tool == row.tool => figures,
                _ => {
                    let level = row.level()?;
                    if let Some(folder) = save {
                        obj(&folder.join(format!("{model}, {share}, {}.obj", row.tool)), &level)?;
                    }
                    figures(&level, surface.as_ref(), &border)?
                }
            };
            let [triangles, mean, greatest, normals, kept] = &figures;
            let seconds = row.median();
            let cells = [
                &format!("{} %", share * 100.0),
                &row.tool,
                &row.threads.to_string(),
                triangles,
                &format!("{seconds:.4}"),
                &format!("{:.2}", mesh.face_count() as f64 / seconds / 1e6),
                &format!("{:.2}", peer / seconds),
                mean,
                greatest,
                normals,
                kept,
            ];
            page.row(&cells);
            measured = Some((row.tool.clone(), figures));
        }
    }
    whole_sequence(mesh, pools, *runs, page)
}

impl<'a> Row<'a> {
    fn new(
        tool: String,
        threads: usize,
        input: Option<&'a Input>,
        run: impl Fn() -> Result<(Left, f64), String> + 'a,
    ) -> Row<'a> {
        Row { tool, threads, run: Box::new(run), input, seconds: Vec::new(), left: Left::Nothing }
    }

    fn median(&self) -> f64 {
        middle(self.seconds.clone())
    }

    fn level(&self) -> Result<Mesh, String> {
        match (&self.left, self.input) {
            (Left::Level(level), _) => Ok((**level).clone()),
            (Left::Buffers(output), Some(input)) => input.level(output),
            _ => Err("a tool gave no level".into()),
        }
    }
}

/// One round to warm up, then `runs` rounds; in each all tools run once, in order.
fn take_turns(rows: &mut [Row<'_>], runs: usize) -> Result<(), String> {
    for round in 0..=runs {
        for row in rows.iter_mut() {
            let (left, seconds) = (row.run)()?;
            if round > 0 {
                row.seconds.push(seconds);
            }
            row.left = left;
        }
    }
    Ok(())
}

/// Triangles, mean, greatest, normals, border kept; empty where not measured.
fn figures(level: &Mesh, surface: Option<&SurfaceReference<'_>>, border: &Border) -> Result<[String; 5], String> {
    let kept = border.kept(&Border::of(level)).map_or("closed".into(), |share| format!("{share:.3}"));
    let mut cells = [level.face_count().to_string(), String::new(), String::new(), String::new(), kept];
    if let Some(surface) = surface {
        let distance = surface.compare(level).ok_or("a level without area")?.in_diagonals();
        cells[1] = format!("{:.1}", distance.mean * 1e5);
        cells[2] = format!("{:.0}", distance.hausdorff * 1e5);
        cells[3] = format!("{:.2}", distance.normal_degrees);
    }
    Ok(cells)
}

/// Writes the positions and triangles.
fn obj(path: &Path, mesh: &Mesh) -> Result<(), String> {
    let mut text = String::new();
    for p in &mesh.positions {
        text.push_str(&format!("v {} {} {}\n", p.x, p.y, p.z));
    }
    for [a, b, c] in &mesh.triangles {
        text.push_str(&format!("f {} {} {}\n", a + 1, b + 1, c + 1));
    }
    std::fs::write(path, text).map_err(|e| format!("{}: {e}", path.display()))
}

/// kiln's sequence to exhaustion.
fn whole_sequence(mesh: &Mesh, pools: &[ThreadPool], runs: usize, page: &mut Page) -> Result<(), String> {
    for pool in pools {
        let mut seconds = Vec::new();
        let mut left = 0;
        for _ in 0..runs {
            let (sequence, one) = timed(|| pool.install(|| collapse(mesh, &[], None, &SimplifyOptions::default())));
            seconds.push(one);
            left = sequence.report().faces_left;
        }
        let seconds = middle(seconds);
        let cells = [
            "all".to_owned(),
            "kiln quadric, whole sequence".into(),
            pool.current_num_threads().to_string(),
            left.to_string(),
            format!("{seconds:.4}"),
            format!("{:.2}", mesh.face_count() as f64 / seconds / 1e6),
        ];
        page.row(&[&cells[..], &vec![String::new(); 5]].concat());
    }
    Ok(())
}
