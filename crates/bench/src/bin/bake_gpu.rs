//! The bake's hit pass on a graphics device by number of low triangles, beside the thesis' milliseconds.
//!
//! `cargo run --release -p kiln-bench --bin bake_gpu -- [--out FILE] [--size N] [--runs N] CORPUS`: CORPUS holds
//! `scans/stanford-bunny.glb`, the thesis' high model of 69,451 triangles. Low meshes are kiln's own: quadric metric, free placement,
//! the built-in atlas. Directions, hit rule and reach are the defaults. Takes the best adapter there is, software if there is no other.
//!
//! The whole pass is owners, candidates and winners of all texels, from meshes in memory to ids in memory; the device's part is what
//! the CPU waits for: bytes there, draws, bytes back. Median of the runs after one to warm up. The thesis' figures (C. González, 2010,
//! section 6.3) are a GeForce 9800 GTX+ with one draw of the high model for each low triangle.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kiln_asset::{ImageId, LodSet, MaterialSet};
use kiln_bake::atlas::{AtlasOptions, Uvunwrap, unwrap};
use kiln_bake::transfer::{Backend, BakeInput, BakeOptions, HitBuffer, find_hits};
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{middle, model, timed};
use kiln_gpu::Gpu;
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::normals;
use kiln_lod::simplify::{Budget, LevelsOptions, Placement, SimplifyOptions, collapse, levels};

/// Low triangles and the thesis' milliseconds.
const PUBLISHED: [(u32, u32); 6] = [(3000, 849), (2500, 683), (2000, 559), (1000, 277), (500, 147), (250, 77)];

/// Faces that meet at more are a hard edge, degrees.
const NORMAL_ANGLE: f32 = 30.0;

fn main() -> ExitCode {
    let (mut corpus, mut out, mut size, mut runs) = (None, None, 1024, 5);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--out" => out = arguments.next().map(PathBuf::from),
            "--size" => size = arguments.next().and_then(|v| v.parse().ok()).unwrap_or(size),
            "--runs" => runs = arguments.next().and_then(|v| v.parse().ok()).unwrap_or(runs).max(1),
            _ => corpus = Some(PathBuf::from(argument)),
        }
    }
    let Some(corpus) = corpus else {
        eprintln!("usage: bake_gpu [--out FILE] [--size N] [--runs N] CORPUS");
        return ExitCode::from(64);
    };
    match run(&corpus, out, size, runs) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(corpus: &Path, out: Option<PathBuf>, size: u32, runs: usize) -> Result<(), String> {
    let gpu = Gpu::open(true).map_err(|e| e.to_string())?;
    let asset = model(&corpus.join("scans/stanford-bunny.glb"))?;
    let high = normals::rebuild(&merge(&asset.mesh, &MergeOptions::default()).0, NORMAL_ANGLE);
    let sequence = collapse(&high, &[], None, &SimplifyOptions::default());
    let budgets = PUBLISHED.map(|(faces, _)| Budget::Triangles(faces));
    let options = LevelsOptions { placement: Placement::Free, ..LevelsOptions::default() };
    let (set, _) = levels(&high, &[], &sequence, &high, &budgets, &options);
    let mut page = Page::new(out);
    page.line("# The bake's hit pass on a graphics device");
    page.line("");
    page.line(&stamp("cargo run --release -p kiln-bench --bin bake_gpu -- CORPUS"));
    let software = if gpu.is_software() { ", played by the CPU: no figure of a graphics card" } else { "" };
    page.line(&format!("Device: {}{software}. {} threads.", gpu.class(), rayon::current_num_threads()));
    page.line(&format!(
        "High: {} triangles. Maps: {size} x {size}, 1 sample a texel. Median of {runs}.",
        high.face_count()
    ));
    page.line("");
    page.head(&[
        ":low triangles",
        ":texels",
        ":reach, % of diagonal",
        ":pairs",
        ":whole pass, ms",
        ":device's part, ms",
        ":thesis, ms",
        ":CPU twin, ms",
        ":ids that differ",
    ]);
    let mut rows = Vec::new();
    for (mut level, (_, published)) in set.levels.into_iter().zip(PUBLISHED).rev() {
        level.mesh = normals::rebuild(&level.mesh, NORMAL_ANGLE);
        let atlas = AtlasOptions { size, padding: 8, ..AtlasOptions::default() };
        let (level, layout, _) = unwrap(&level, &atlas, &Uvunwrap::STANDARD).map_err(|e| e.to_string())?;
        let low = LodSet { source_triangles: high.face_count() as u32, layout: Some(layout), levels: vec![level] };
        let (materials, options) = (MaterialSet::default(), BakeOptions { size, ..BakeOptions::default() });
        let images = |image: ImageId| Err(format!("nobody has image {image}"));
        let input = BakeInput { high: &high, low: &low, materials: &materials, images: &images, cage: None };
        let (hits, whole, device) = measured(&input, &options, Backend::Gpu(&gpu), runs)?;
        let (twin, cpu, _) = measured(&input, &options, Backend::Cpu, runs)?;
        let differ = hits.high_faces.iter().zip(&twin.high_faces).filter(|(a, b)| a != b).count();
        page.row(&[
            low.levels[0].mesh.face_count().to_string(),
            hits.report.covered.to_string(),
            format!("{:.2}", 100.0 * hits.report.front / high.diagonal()),
            hits.report.pairs.to_string(),
            format!("{whole:.0}"),
            format!("{device:.0}"),
            published.to_string(),
            format!("{cpu:.0}"),
            differ.to_string(),
        ]);
        rows.push([whole, device, f64::from(published), cpu]);
    }
    if let (Some(least), Some(most)) = (rows.first(), rows.last()) {
        let [whole, device, published, cpu] = [0, 1, 2, 3].map(|k| most[k] / least[k]);
        page.line("");
        page.line(&format!(
            "From 250 to 3,000 low triangles the whole pass takes {whole:.2} times as long, the device's part {device:.2}, the CPU twin \
             {cpu:.2}; the thesis' {published:.1}."
        ));
    }
    page.finish()
}

/// The hits, and the medians of the whole pass's and the device's milliseconds.
fn measured<'a>(
    input: &BakeInput<'a>,
    options: &'a BakeOptions,
    backend: Backend<'a>,
    runs: usize,
) -> Result<(HitBuffer<'a>, f64, f64), String> {
    let find = || find_hits(input, options, backend).map_err(|e| e.to_string());
    let mut last = find()?;
    let (mut whole, mut device) = (Vec::new(), Vec::new());
    for _ in 0..runs {
        let (found, seconds) = timed(find);
        last = found?;
        whole.push(1e3 * seconds);
        device.push(1e3 * last.device.as_secs_f64());
    }
    Ok((last, middle(whole), middle(device)))
}
