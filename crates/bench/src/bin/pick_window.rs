//! Picking from a sliding window beside a plain copy of the same bytes and a walk along each vertex' chain; and what windows cost.
//!
//! `cargo run --release -p kiln-bench --bin pick_window -- MODEL... [--lods N] [--runs N] [--threads N] [--storage] [--out FILE]`
//!
//! For each model its collapse sequence to exhaustion (half-edge, as a stage does it), the window over all of it, and N (20) LODs
//! whose vertices fall geometrically from all to those that never go. Milliseconds are the least of the runs (9): on a shared
//! machine the others measure its other users, the longer the more. All threads (2) work on each, in as many pieces as threads; all
//! outputs are made before. Columns:
//! - copy: positions (12 bytes a vertex) copied as they are: what any fill of that buffer costs;
//! - pick: the same buffer by `Window::resolve` and `Window::pick_elements`; table: the first of them alone; 32 bytes: elements of
//!   position, normal and UV;
//! - chains: each vertex walks its parents, then copies;
//! - update: `Window::update` of picks from the LOD before, one thread; indices: an index buffer of the LOD by `Window::pick_indices`.
//!
//! `--storage` prints bytes instead: models welded, positions alone, as the paper's table 1 counts.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kiln_asset::Mesh;
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{middle, model, name, positions_only, timed};
use kiln_format::layout::WindowHeader;
use kiln_format::{DrawRange, Indices, WindowView};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{SimplifyOptions, collapse};
use kiln_lod::sliding_window::SlidingWindow;
use kiln_runtime::window::{Window, WindowLod};
use rayon::prelude::*;

struct Ask {
    lods: u32,
    runs: usize,
    threads: usize,
    storage: bool,
    out: Option<PathBuf>,
}

fn main() -> ExitCode {
    let mut ask = Ask { lods: 20, runs: 9, threads: 2, storage: false, out: None };
    let mut models = Vec::new();
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut number = || args.next().and_then(|v| v.parse::<usize>().ok()).unwrap_or(1).max(1);
        match arg.as_str() {
            "--lods" => ask.lods = number() as u32,
            "--runs" => ask.runs = number(),
            "--threads" => ask.threads = number(),
            "--storage" => ask.storage = true,
            "--out" => ask.out = args.next().map(PathBuf::from),
            _ => models.push(PathBuf::from(arg)),
        }
    }
    if models.is_empty() {
        eprintln!("usage: pick_window MODEL... [--lods N] [--runs N] [--threads N] [--storage] [--out FILE]");
        return ExitCode::from(64);
    }
    match run(&models, &ask) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(models: &[PathBuf], ask: &Ask) -> Result<(), String> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(ask.threads).build().map_err(|e| e.to_string())?;
    let mut page = Page::new(ask.out.clone());
    page.line(&stamp(&format!("pick_window, {} threads", ask.threads)));
    page.line("");
    if ask.storage {
        page.head(&[
            "model",
            ":vertices",
            ":triangles",
            ":indexed B/tri",
            ":chains B/tri",
            ":ratio",
            ":window B/tri",
            ":ratio",
            ":longest chain",
            ":mean",
            ":window s",
        ]);
    }
    for path in models {
        let mesh = merge(&model(path)?.mesh, &MergeOptions::default()).0;
        let done = pool.install(|| match ask.storage {
            true => storage(&name(path), &positions_only(&mesh)?, &mut page),
            false => speed(path, &mesh, ask, &mut page),
        });
        done.map_err(|e| format!("{}: {e}", path.display()))?;
    }
    page.finish()
}

/// The window of the whole sequence, with the seconds that it took.
fn window_of(mesh: &Mesh) -> Result<(SlidingWindow, f64), String> {
    let sequence = collapse(mesh, &[], None, &SimplifyOptions::default());
    let (window, seconds) = timed(|| SlidingWindow::new(mesh, &sequence, 0));
    Ok((window.map_err(|e| e.to_string())?, seconds))
}

fn storage(name: &str, mesh: &Mesh, page: &mut Page) -> Result<(), String> {
    let (window, seconds) = window_of(mesh)?;
    let (bytes, chains) = (window.storage(12), window.chains());
    let a_triangle = |bytes: u64| format!("{:.2}", bytes as f64 / mesh.face_count() as f64);
    let ratio = |b: u64| format!("{:.3}", b as f64 / bytes.indexed as f64);
    page.row(&[
        name.to_owned(),
        mesh.vertex_count().to_string(),
        mesh.face_count().to_string(),
        a_triangle(bytes.indexed),
        a_triangle(bytes.chains),
        ratio(bytes.chains),
        a_triangle(bytes.window),
        ratio(bytes.window),
        chains.longest.to_string(),
        format!("{:.2}", chains.mean),
        format!("{seconds:.2}"),
    ]);
    Ok(())
}

/// `out` filled on all threads, one piece each.
fn fill<T: Copy + Send>(out: &mut [T], piece: impl Fn(u32, &mut [T]) + Sync) {
    let length = out.len().div_ceil(rayon::current_num_threads()).max(1);
    out.par_chunks_mut(length).enumerate().for_each(|(i, out)| piece((i * length) as u32, out));
}

/// Each vertex by a walk of its own.
fn by_chains<T: Copy>(parents: &[u32], alive: u32, first: u32, source: &[T], out: &mut [T]) {
    for (slot, v) in out.iter_mut().zip(first..) {
        let mut pick = v;
        while pick >= alive {
            pick = parents[pick as usize];
        }
        *slot = source[pick as usize];
    }
}

/// The table of picks, round by round.
fn resolve(window: &Window<'_>, lod: WindowLod, picks: &mut [u32]) {
    for range in window.rounds(lod) {
        let (done, rest) = picks.split_at_mut(range.start as usize);
        let block = &mut rest[..range.len()];
        fill(block, |first, out| window.resolve(lod, done, range.start + first, out));
    }
}

/// The same, and what is picked of `source`.
fn pick_all<T: Copy + Send + Sync>(
    window: &Window<'_>,
    lod: WindowLod,
    picks: &mut [u32],
    source: &[T],
    out: &mut [T],
) {
    resolve(window, lod, picks);
    fill(out, |first, out| window.pick_elements(lod, &picks[first as usize..], first, source, out));
}

/// Least seconds of `runs` runs after one to warm up.
fn best(runs: usize, mut work: impl FnMut()) -> f64 {
    work();
    (0..runs).map(|_| timed(&mut work).1).fold(f64::INFINITY, f64::min)
}

/// Milliseconds of one LOD.
struct Times {
    copy: f64,
    pick: f64,
    table: f64,
    chains: f64,
    copy_32: f64,
    pick_32: f64,
    update: f64,
    indices: f64,
}

fn speed(path: &Path, mesh: &Mesh, ask: &Ask, page: &mut Page) -> Result<(), String> {
    let (made, seconds) = window_of(mesh)?;
    let level0 = made.apply(mesh).map_err(|e| e.to_string())?;
    let indices: Vec<u32> = level0.triangles.iter().flatten().copied().collect();
    let mut first = 0;
    let mut range = |faces: &u32| {
        let (first_index, index_count) = (first, 3 * faces);
        first += index_count;
        let (bounds_min, bounds_max) = ([0.0; 3], [0.0; 3]);
        DrawRange {
            first_index,
            index_count,
            first_vertex: 0,
            vertex_count: 0,
            bounds_min,
            bounds_max,
            reserved: [0; 2],
        }
    };
    let ranges: Vec<DrawRange> = made.submesh_faces().iter().map(&mut range).collect();
    let header = WindowHeader {
        vertices: made.vertex_count() as u32,
        triangles: made.face_count() as u32,
        collapses: made.collapses(),
        base_vertices: made.base_vertices(),
        checkpoints: 0,
        flags: 0,
        reserved: [0; 10],
    };
    let view = WindowView { header, checkpoints: &[], parents: made.parents(), starts: made.starts() };
    let window = Window::new(view, Indices::U32(&indices), &ranges);
    let (vertices, base) = (f64::from(header.vertices), f64::from(header.base_vertices.max(1)));
    page.line(&format!(
        "\n{}: {vertices} vertices, {} triangles; window in {seconds:.2} s\n",
        name(path),
        made.face_count()
    ));
    page.head(&[
        ":LOD",
        ":alive",
        ":triangles",
        ":copy ms",
        ":pick ms",
        ":pick / copy",
        ":chains ms",
        ":chains / pick",
        ":table ms",
        ":copy 32 ms",
        ":pick 32 ms",
        ":pick / copy",
        ":update ms",
        ":indices ms",
    ]);
    let lod_at = |k: u32| {
        let share = f64::from(k) / f64::from(ask.lods.max(2) - 1);
        window.lod_of_vertices((vertices * (base / vertices).powf(share)).round() as u32)
    };
    let mut all: Vec<Times> = Vec::new();
    let mut before = window.lod(0);
    for k in 0..ask.lods {
        let lod = lod_at(k);
        let times = times(&window, &level0, [before, lod], ask.runs);
        before = lod;
        let start =
            [u64::from(lod.detail()), u64::from(lod.vertices()), window.triangle_count(lod)].map(|n| n.to_string());
        page.row(&[&start[..], &cells(&times)].concat());
        all.push(times);
    }
    let of = |get: &dyn Fn(&Times) -> f64| middle(all.iter().map(get).collect());
    let medians = Times {
        copy: of(&|t| t.copy),
        pick: of(&|t| t.pick),
        table: of(&|t| t.table),
        chains: of(&|t| t.chains),
        copy_32: of(&|t| t.copy_32),
        pick_32: of(&|t| t.pick_32),
        update: of(&|t| t.update),
        indices: of(&|t| t.indices),
    };
    page.row(&[&["median".to_owned(), String::new(), String::new()][..], &cells(&medians)].concat());
    Ok(())
}

fn cells(t: &Times) -> [String; 11] {
    let ms = |v: f64| format!("{v:.2}");
    [
        ms(t.copy),
        ms(t.pick),
        ms(t.pick / t.copy),
        ms(t.chains),
        ms(t.chains / t.pick),
        ms(t.table),
        ms(t.copy_32),
        ms(t.pick_32),
        ms(t.pick_32 / t.copy_32),
        ms(t.update),
        ms(t.indices),
    ]
}

fn times(window: &Window<'_>, level0: &Mesh, [before, lod]: [WindowLod; 2], runs: usize) -> Times {
    let parents = window.view().parents;
    let positions: Vec<[f32; 3]> = level0.positions.iter().map(|p| p.to_array()).collect();
    let wide: Vec<[f32; 8]> = positions.iter().map(|p| [p[0], p[1], p[2], 0.0, 1.0, 0.0, p[0], p[1]]).collect();
    let (mut out, mut out_wide) = (positions.clone(), wide.clone());
    let ms = |seconds: f64| 1e3 * seconds;
    let copy = best(runs, || {
        fill(&mut out, |first, out| out.copy_from_slice(&positions[first as usize..first as usize + out.len()]));
    });
    let chains = best(runs, || {
        fill(&mut out, |first, out| by_chains(parents, lod.vertices(), first, &positions, out));
    });
    let expected = out.clone();
    let mut picks = vec![0; parents.len()];
    let pick = best(runs, || pick_all(window, lod, &mut picks, &positions, &mut out));
    assert!(out == expected, "picks differ from chains");
    let table = best(runs, || resolve(window, lod, &mut picks));
    let copy_32 = best(runs, || {
        fill(&mut out_wide, |first, out| out.copy_from_slice(&wide[first as usize..first as usize + out.len()]));
    });
    let pick_32 = best(runs, || pick_all(window, lod, &mut picks, &wide, &mut out_wide));
    let mut updates = Vec::new();
    for _ in 0..runs.div_ceil(3) {
        window.picks(before, &mut picks);
        let mut changes = 0_u32;
        updates.push(timed(|| window.update(before, lod, &mut picks, |_, _| changes += 1)).1);
        assert!(changes > 0 || before == lod);
    }
    let counts: Vec<u32> = (0..window.ranges().len()).map(|submesh| window.triangles(lod, submesh)).collect();
    let mut indices = vec![0; 3 * counts.iter().copied().max().unwrap_or(0) as usize];
    let index = best(runs.div_ceil(3), || {
        for (submesh, count) in counts.iter().enumerate() {
            let length = count.div_ceil(rayon::current_num_threads() as u32).max(1);
            let out = indices[..3 * *count as usize].par_chunks_mut(3 * length as usize);
            out.enumerate().for_each(|(i, out)| window.pick_indices(lod, submesh, i as u32 * length, out));
        }
    });
    Times {
        copy: ms(copy),
        pick: ms(pick),
        table: ms(table),
        chains: ms(chains),
        copy_32: ms(copy_32),
        pick_32: ms(pick_32),
        update: ms(updates.into_iter().fold(f64::INFINITY, f64::min)),
        indices: ms(index),
    }
}
