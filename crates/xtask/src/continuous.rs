//! `xtask long continuous`: what continuous layouts cost and buy, on real models and on two large ones that the corpus' script makes.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Real models by their place in the corpus.
const MODELS: [&str; 3] = ["scans/stanford-bunny.glb", "scans/cow.glb", "scans/armadillo.glb"];
/// Large ones by the name that `make_large.py` knows.
const LARGE: [&str; 2] = ["ball_1m", "terrain_3m7"];

/// The head of the page on picking.
const PICKING: &str = "\
# Picking from layouts

By `cargo xtask long continuous`. Octrees: the vertex buffer of a detail (12 bytes a vertex) on two threads, median over 20 values of r, beside
a plain copy of as many bytes, a walk from each vertex up to its pick, and a descent from the root; vertices in the octree's order unless it says
otherwise.

";

/// Writes `docs/results/continuous.md`, `picking.md` and `load.md`.
pub(crate) fn run(root: &Path) -> Result<(), String> {
    let corpus = std::env::var_os("KILN_CORPUS").map(PathBuf::from).ok_or("the continuous layouts need KILN_CORPUS")?;
    let corpus = corpus.canonicalize().map_err(|e| format!("KILN_CORPUS: {e}"))?;
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or(root.join("target"), PathBuf::from);
    let folder = target.join("large-models");
    let large = make(&corpus, &folder)?;
    let real: Vec<PathBuf> = MODELS.iter().map(|name| corpus.join(name)).collect();
    let all: Vec<PathBuf> = real.iter().chain(&large).cloned().collect();
    let results = root.join("docs/results");
    let plot = root.join("docs/images/continuous-counts.svg");
    let picture = root.join("docs/images/continuous.png");
    let out = results.join("continuous.md");
    let args = ["--plot".into(), plot, "--picture".into(), picture, "--out".into(), out];
    bench(root, "continuous", &all, &args)?;
    let pages = ["pick_tree", "pick_window", "pick_gpu", "clusters"].map(|name| bench(root, name, &large, &[]));
    let pages: Vec<String> = pages.into_iter().collect::<Result<_, _>>()?;
    let text = format!("{PICKING}{}", pages.join("\n"));
    fs::write(results.join("picking.md"), text).map_err(|e| e.to_string())?;
    let gltfpack = root.join("tests/validator/node_modules/gltfpack/cli.js");
    let chains = [real[0].clone(), large[0].clone()];
    let mut args: Vec<PathBuf> = vec!["--folder".into(), folder];
    if gltfpack.is_file() {
        args.extend(["--gltfpack".into(), gltfpack]);
    }
    let pages = [bench(root, "load", &chains, &args)?, bench(root, "container", &[], &[])?];
    fs::write(results.join("load.md"), pages.join("\n")).map_err(|e| e.to_string())
}

/// The large models, made where they are not there yet.
fn make(corpus: &Path, folder: &Path) -> Result<Vec<PathBuf>, String> {
    fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let files: Vec<PathBuf> = LARGE.iter().map(|name| folder.join(format!("{name}.glb"))).collect();
    if files.iter().any(|file| !file.is_file()) {
        let said = Command::new("python3")
            .arg(corpus.join("make_large.py"))
            .arg(folder)
            .arg("--only")
            .args(LARGE)
            .output()
            .map_err(|e| format!("python3: {e}"))?;
        if !said.status.success() {
            return Err(format!("make_large.py: {}", String::from_utf8_lossy(&said.stderr)));
        }
    }
    Ok(files)
}

/// What a program of the benchmarks prints about `models`.
fn bench(root: &Path, name: &str, models: &[PathBuf], more: &[PathBuf]) -> Result<String, String> {
    eprintln!("{name}, {} models", models.len());
    let output = Command::new("cargo")
        .args(["run", "--release", "--locked", "--quiet", "-p", "kiln-bench", "--bin", name, "--"])
        .args(models)
        .args(more)
        .current_dir(root)
        .output()
        .map_err(|e| e.to_string())?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    Err(format!("{name}: {}", String::from_utf8_lossy(&output.stderr)))
}
