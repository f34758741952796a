//! First prices of views on a graphics device beside the CPU: candidates a second on Spot, 20 views of 256 x 256.
//!
//! `cargo run --release -p kiln-bench --bin viewpoint_gpu -- [--out FILE] CORPUS`: CORPUS holds `gltf/Spot.glb`. Takes the best adapter there is,
//! software if there is no other. All legal candidates of the whole model, by their stars, are priced on one thread, on all threads, and
//! on the device; the device's time holds what it reads and gives back, not the scene that goes there once, which has a column of its own.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kiln_bench::rows::{Page, stamp};
use kiln_bench::{model, timed};
use kiln_gpu::Gpu;
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::SimplifyOptions;
use kiln_lod::simplify::viewpoint::cameras::{Cameras, views};
use kiln_lod::simplify::viewpoint::{Measure, SIZE, Study, ViewCondition, ViewpointOptions};

fn main() -> ExitCode {
    let (mut corpus, mut out) = (None, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--out" => out = arguments.next().map(PathBuf::from),
            _ => corpus = Some(PathBuf::from(argument)),
        }
    }
    let Some(corpus) = corpus else {
        eprintln!("usage: viewpoint_gpu [--out FILE] CORPUS");
        return ExitCode::from(64);
    };
    match run(&corpus, out) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(corpus: &Path, out: Option<PathBuf>) -> Result<(), String> {
    let gpu = Gpu::open(true).map_err(|e| e.to_string())?;
    let asset = model(&corpus.join("gltf/Spot.glb"))?;
    let mesh = merge(&asset.mesh, &MergeOptions::default()).0;
    let seen = views(Cameras::default(), SIZE, &mesh);
    let mut page = Page::new(out);
    page.line("# Viewpoint-driven simplification: first prices on a graphics device");
    page.line("");
    page.line(&stamp("cargo run --release -p kiln-bench --bin viewpoint_gpu -- CORPUS"));
    let software = if gpu.is_software() { ", played by the CPU" } else { "" };
    page.line(&format!("Device: {}{software}. {} threads.", gpu.class(), rayon::current_num_threads()));
    page.line("");
    page.head(&[
        "metric",
        ":candidates",
        ":one thread, /s",
        ":all threads, /s",
        ":device, /s",
        ":scene there, ms",
        ":left to the CPU",
        "equal counts",
        ":cost apart at most",
    ]);
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|e| e.to_string())?;
    for (name, measure) in
        [("viewpoint-entropy", Measure::Entropy), ("viewpoint-mutual-information", Measure::MutualInformation)]
    {
        let options = ViewpointOptions { measure, ..ViewpointOptions::default() };
        let condition = ViewCondition::new(&mesh, &seen, None, options).map_err(|e| e.to_string())?;
        let how = SimplifyOptions::default();
        let mut study = Study::new(&mesh, &how, &condition);
        let candidates = study.candidates();
        let stars = study.stars(&candidates);
        let (device, there) = timed(|| study.on(&gpu));
        let device = device.map_err(|e| e.to_string())?;
        // The first rounds warm up.
        one.install(|| study.price_batch(&stars));
        device.price_batch(&stars).map_err(|e| e.to_string())?;
        let (_, alone) = timed(|| one.install(|| study.price_batch(&stars)));
        let (cpu, together) = timed(|| study.price_batch(&stars));
        let (prices, on_device) = timed(|| device.price_batch(&stars));
        let prices = prices.map_err(|e| e.to_string())?;
        let (mut left, mut equal, mut apart) = (0, cpu.len() == prices.len(), 0.0_f64);
        for ((cost, deltas), price) in cpu.iter().zip(&prices) {
            match &price.deltas {
                None => left += 1,
                Some(counted) => equal &= counted == deltas,
            }
            if let Some(near) = price.cost {
                apart = apart.max((f64::from(near) - cost).abs());
            }
        }
        let rate = |seconds: f64| format!("{:.0}", candidates.len() as f64 / seconds);
        page.row(&[
            name,
            &candidates.len().to_string(),
            &rate(alone),
            &rate(together),
            &rate(on_device),
            &format!("{:.0}", 1e3 * there),
            &left.to_string(),
            if equal { "yes" } else { "NO" },
            &format!("{apart:.1e}"),
        ]);
    }
    page.finish()
}
