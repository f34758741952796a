//! Picking on a graphics device: the vertex buffer of a detail by each layout's compute pass, beside the CPU's pick of the same buffer.
//!
//! `cargo run --release -p kiln-bench --bin pick_gpu -- MODEL...`
//!
//! Takes the best adapter there is, software if there is no other. Details fall from all triangles to a thousandth, evenly in the logarithm;
//! a time is from the call until a word of the buffer has been read back, the median of five, and its spread over the details shows
//! whether the pass costs the same at all of them. One thread picks on the CPU.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kiln_bench::rows::{Page, stamp};
use kiln_bench::{median, model, name, positions_only};
use kiln_format::layout::{CompactNode, TreeHeader, WindowHeader};
use kiln_format::{CompactTreeView, Indices, TreeLeafView, WindowView};
use kiln_gpu::{Gpu, GpuError};
use kiln_lod::cluster_tree::{ClusterTree, TreeLeafBuffers, TreeOptions};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{SimplifyOptions, collapse};
use kiln_lod::sliding_window::SlidingWindow;
use kiln_runtime::gpu::tree::{Floats, Picks};
use kiln_runtime::gpu::window::{WindowBuffers, WindowPasses};
use kiln_runtime::{Compact, TreeLeaf, Window};

/// Shares of the triangles.
const SHARES: [f64; 5] = [1.0, 0.178, 0.0316, 0.00562, 0.001];
const RUNS: usize = 5;

fn main() -> ExitCode {
    let models: Vec<PathBuf> = std::env::args().skip(1).map(PathBuf::from).collect();
    if models.is_empty() {
        eprintln!("usage: pick_gpu MODEL...");
        return ExitCode::from(64);
    }
    match run(&models) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(models: &[PathBuf]) -> Result<(), String> {
    let gpu = Gpu::open(true).map_err(|e| e.to_string())?;
    let mut page = Page::new(None);
    page.line("# Picking on a graphics device");
    page.line("");
    page.line(&stamp("cargo run --release -p kiln-bench --bin pick_gpu -- MODEL..."));
    let software = if gpu.is_software() { ", played by the CPU" } else { "" };
    page.line(&format!("Device: {}{software}. Milliseconds at shares of the triangles.", gpu.class()));
    page.line("");
    page.head(&["model, layout", "where", ":100 %", ":17.8 %", ":3.16 %", ":0.56 %", ":0.1 %", ":most / least"]);
    for path in models {
        measure(path, &gpu, &mut page).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    Ok(())
}

fn row(page: &mut Page, what: &str, place: &str, times: &[f64]) {
    let fold = |start: f64, pick: fn(f64, f64) -> f64| times.iter().copied().fold(start, pick);
    let mut cells = vec![what.to_owned(), place.to_owned()];
    cells.extend(times.iter().map(|s| format!("{:.2}", 1e3 * s)));
    cells.push(format!("{:.2}", fold(0.0, f64::max) / fold(f64::INFINITY, f64::min)));
    page.row(&cells);
}

fn measure(path: &Path, gpu: &Gpu, page: &mut Page) -> Result<(), String> {
    let (merged, _) = merge(&model(path)?.mesh, &MergeOptions::default());
    let mesh = positions_only(&merged)?;
    let failed = |e: GpuError| e.to_string();
    let wanted = SHARES.map(|share| (share * mesh.face_count() as f64) as u32);

    let tree = ClusterTree::new(&mesh, &TreeOptions::default());
    let buffers = TreeLeafBuffers::new(&tree, &mesh).map_err(|e| e.to_string())?;
    let positions: &[[f32; 3]] = bytemuck::cast_slice(&mesh.positions);
    let header = TreeHeader {
        nodes: tree.node_count(),
        vertices: positions.len() as u32,
        rows: tree.rows(),
        columns: buffers.columns,
        width: buffers.width,
        checkpoints: 0,
        reserved: [0; 10],
    };
    let (row_starts, face_counts) = (tree.row_starts(), tree.face_counts());
    let printed =
        TreeLeafView { header, checkpoints: &[], row_starts, face_counts, tree: &buffers.tree, leaf: &buffers.leaf };
    let nodes: &[CompactNode] = bytemuck::cast_slice(tree.nodes());
    let terminals = tree.terminals();
    let compact = CompactTreeView { header, checkpoints: &[], row_starts, face_counts, nodes, terminals };
    let thresholds = wanted.map(|wanted| tree.threshold_for(wanted).threshold);
    let mut out = vec![[0.0f32; 3]; positions.len()];
    let picks = [
        ("tree and leaf", Picks::tree_leaf(gpu, &printed).map_err(failed)?),
        ("compact tree", Picks::compact(gpu, &compact, positions).map_err(failed)?),
    ];
    for (what, picks) in &picks {
        let buffer = picks.vertex_buffer(Floats::Three).map_err(failed)?;
        let mut times = Vec::new();
        for threshold in thresholds {
            let (done, seconds) = median(RUNS, || -> Result<u32, GpuError> {
                picks.fill(threshold, 0..positions.len() as u32, Floats::Three, &buffer)?;
                Ok(gpu.read::<u32>(&buffer, 4)?[0])
            });
            done.map_err(failed)?;
            times.push(seconds);
        }
        row(page, &format!("{}, {what}", name(path)), "device", &times);
        let of_cpu = thresholds.map(|threshold| {
            let all = 0..positions.len();
            let pick = || match *what {
                "compact tree" => Compact::new(compact, positions).pick(threshold, all.clone(), &mut out),
                _ => TreeLeaf::new(printed).pick_at(threshold, all.clone(), &mut out),
            };
            median(RUNS, pick).1
        });
        row(page, &format!("{}, {what}", name(path)), "CPU", &of_cpu);
    }

    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let made = SlidingWindow::new(&mesh, &sequence, 0).map_err(|e| e.to_string())?;
    let level = made.apply(&mesh).map_err(|e| e.to_string())?;
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
    let window = Window::new(view, Indices::U32(bytemuck::cast_slice(&level.triangles)), &[]);
    let source: &[[f32; 3]] = bytemuck::cast_slice(&level.positions);
    let passes = WindowPasses::new(gpu).map_err(failed)?;
    let on_device = WindowBuffers::new(gpu, &window).map_err(failed)?;
    let place = gpu.storage("positions", source).map_err(failed)?;
    let picked = gpu.output("picked", size_of_val(source) as u64).map_err(failed)?;
    let lods = wanted.map(|wanted| window.lod(made.lod_of_cut(sequence.reach(wanted))));
    let mut times = Vec::new();
    for lod in lods {
        let (done, seconds) = median(RUNS, || -> Result<u32, GpuError> {
            let mut encoder = gpu.device().create_command_encoder(&Default::default());
            passes.pick_elements(gpu, &mut encoder, &on_device, lod, 3, [&place, &picked])?;
            gpu.queue().submit([encoder.finish()]);
            Ok(gpu.read::<u32>(&picked, 4)?[0])
        });
        done.map_err(failed)?;
        times.push(seconds);
    }
    row(page, &format!("{}, sliding window", name(path)), "device", &times);
    let mut table = vec![0; source.len()];
    let of_cpu = lods.map(|lod| {
        let pick = || {
            window.picks(lod, &mut table);
            window.pick_elements(lod, &table, 0, source, &mut out);
        };
        median(RUNS, pick).1
    });
    row(page, &format!("{}, sliding window", name(path)), "CPU", &of_cpu);
    Ok(())
}
