//! The page of results: surfaces and pictures beside meshoptimizer, one after the other.
//!
//! `KILN_CORPUS=FOLDER cargo run --release -p kiln-bench --bin results -- [MODEL...] [--out FILE]`
//!
//! Runs `simplify` on the corpus' scans and FlightHelmet and on the models that are named (ball_1m, which the corpus' `make_large.py`
//! writes), then `images` on every corpus model with base colour textures, and writes both to `docs/results/simplify.md`.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

const SURFACES: [&str; 3] = ["scans/stanford-bunny.glb", "scans/armadillo.glb", "gltf/FlightHelmet/FlightHelmet.gltf"];
const PICTURES: [&str; 9] = [
    "gltf/Spot.glb",
    "gltf/Barrel.glb",
    "gltf/Avocado/Avocado.gltf",
    "gltf/FlightHelmet/FlightHelmet.gltf",
    "gltf/Fox.glb",
    "gltf/CesiumMilkTruck/CesiumMilkTruck.gltf",
    "gltf/ChessBoard.glb",
    "gltf/Ingenuity.glb",
    "gltf/PortalFrame.glb",
];

fn main() -> ExitCode {
    let (mut more, mut out) = (Vec::new(), PathBuf::from("docs/results/simplify.md"));
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--out" => out = args.next().map_or(out, PathBuf::from),
            _ => more.push(PathBuf::from(arg)),
        }
    }
    match run(more, &out) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(more: Vec<PathBuf>, out: &Path) -> Result<(), String> {
    let corpus =
        std::env::var_os("KILN_CORPUS").map(PathBuf::from).ok_or("KILN_CORPUS must name the corpus' folder")?;
    let in_corpus = |names: &[&str]| -> Vec<PathBuf> { names.iter().map(|name| corpus.join(name)).collect() };
    let mut surfaces = in_corpus(&SURFACES);
    surfaces.extend(more);
    let text = [program("simplify", &surfaces)?, program("images", &in_corpus(&PICTURES))?].join("\n");
    std::fs::write(out, text).map_err(|e| format!("{}: {e}", out.display()))
}

/// What a program of this package prints.
fn program(name: &str, models: &[PathBuf]) -> Result<String, String> {
    eprintln!("{name}, {} models", models.len());
    let output = Command::new("cargo")
        .args(["run", "--release", "--quiet", "-p", "kiln-bench", "--bin", name, "--"])
        .args(models)
        .output()
        .map_err(|e| e.to_string())?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    Err(format!("{name}: {}", String::from_utf8_lossy(&output.stderr)))
}
