//! Real models end to end, by the command itself: build, check, export, validate, and a table of what came out.
//!
//! The models lie outside the project; `KILN_CORPUS` names their folder. Each is built in a scratch folder from an empty cache
//! by `target/release/kiln` (built here first), on the CPU backend, one stage at a time so that each stage's peak memory is
//! its own.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::long::stamp;

/// The models of the table: name, path in the corpus, whether its textures are baked too.
const MODELS: &[(&str, &str, bool)] = &[
    ("FlightHelmet", "gltf/FlightHelmet/FlightHelmet.gltf", true),
    ("CesiumMilkTruck", "gltf/CesiumMilkTruck/CesiumMilkTruck.gltf", true),
    ("Barrel", "gltf/Barrel.glb", true),
    ("Spot", "gltf/Spot.glb", true),
    ("Avocado", "gltf/Avocado/Avocado.gltf", false),
    ("stanford-bunny", "scans/stanford-bunny.glb", false),
    ("armadillo", "scans/armadillo.glb", false),
    ("2CylinderEngine", "cad/2CylinderEngine.glb", false),
    ("robot-cell", "cad/robot-cell.glb", false),
];

const LEVELS: &str = r#"
kiln = 1
[asset]
input = "INPUT"
output = "levels.kiln"
[[stage]]
kind = "merge"
[[stage]]
kind = "simplify"
levels = [{ keep = 0.5 }, { keep = 0.1 }, { keep = 0.02 }]
[[stage]]
kind = "pack"
"#;

const BAKE: &str = r#"
kiln = 1
[asset]
input = "INPUT"
output = "baked.kiln"
[[stage]]
id = "whole"
kind = "merge"
[[stage]]
id = "base"
kind = "simplify"
levels = [{ keep = 0.1 }]
[[stage]]
kind = "atlas"
size = 2048
padding = 8
[[stage]]
id = "lods"
kind = "simplify"
levels = [{ keep = 0.1 }, { keep = 0.05 }]
[[stage]]
kind = "bake"
high = "whole"
maps = ["normal", "base-color", "metallic-roughness"]
size = 2048
dilation = 4
[[stage]]
kind = "pack"
"#;

/// `xtask corpus [NAME...] [--out FILE] [--keep DIR]`.
pub(crate) fn run(root: &Path, args: &[String]) -> Result<(), String> {
    let corpus = std::env::var_os("KILN_CORPUS").map(PathBuf::from).ok_or("xtask corpus needs KILN_CORPUS")?;
    let corpus = corpus.canonicalize().map_err(|e| format!("KILN_CORPUS: {e}"))?;
    let mut names = Vec::new();
    let (mut out, mut keep) = (None, None);
    let mut args = args.iter();
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--out" => out = args.next().map(PathBuf::from),
            "--keep" => keep = args.next().map(PathBuf::from),
            name if MODELS.iter().any(|m| m.0 == name) => names.push(name.to_owned()),
            other => return Err(format!("no model {other} in the table")),
        }
    }
    let build = Command::new("cargo").args(["build", "--release", "--locked"]).current_dir(root).status();
    if !build.is_ok_and(|s| s.success()) {
        return Err("the command did not build".into());
    }
    let kiln = root.join("target/release/kiln");
    let scratch = keep.unwrap_or_else(|| root.join("target/corpus"));
    let mut table = format!(
        "# Real models end to end\n\n{} CPU backend, one stage at a time, empty cache; errors are lengths in the model's units.\n\n\
         | model | chain | exit | stage | seconds | peak MB | triangles (error) | gaps | check | glTF validator |\n\
         | --- | --- | --: | --- | --: | --: | --- | --: | --- | --- |\n",
        stamp(root)
    );
    let mut failures = Vec::new();
    for (name, path, bakes) in MODELS {
        if !names.is_empty() && !names.iter().any(|n| n == name) {
            continue;
        }
        for (chain, text) in [("levels", LEVELS), ("baked", BAKE)] {
            if chain == "baked" && !bakes {
                continue;
            }
            let folder = scratch.join(name).join(chain);
            let _ = fs::remove_dir_all(&folder);
            fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
            let input = corpus.join(path);
            let text = text.replace("INPUT", &input.display().to_string());
            fs::write(folder.join("pipeline.toml"), text).map_err(|e| e.to_string())?;
            eprintln!("{name}, {chain}");
            match one(&kiln, root, &folder, chain) {
                Ok(rows) => {
                    for row in rows {
                        let _ = writeln!(table, "| {name} | {chain} {row}");
                    }
                }
                Err(message) => failures.push(format!("{name}, {chain}: {message}")),
            }
        }
    }
    eprintln!("{table}");
    if let Some(out) = out {
        if let Some(folder) = out.parent() {
            fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        }
        fs::write(&out, &table).map_err(|e| format!("{}: {e}", out.display()))?;
    }
    if failures.is_empty() { Ok(()) } else { Err(failures.join("\n")) }
}

/// Builds, checks, exports and validates one pipeline; the table's rows behind model and chain.
fn one(kiln: &Path, root: &Path, folder: &Path, chain: &str) -> Result<Vec<String>, String> {
    let output = Command::new(kiln)
        .args(["build", "pipeline.toml", "--backend", "cpu", "--jobs", "1", "--json"])
        .current_dir(folder)
        .stderr(Stdio::piped())
        .output()
        .map_err(|e| e.to_string())?;
    let exit = output.status.code().unwrap_or(-1);
    if exit != 0 && exit != 1 {
        return Err(format!("exit {exit}: {}", String::from_utf8_lossy(&output.stderr)));
    }
    let report: Value = serde_json::from_slice(&output.stdout).map_err(|e| format!("report: {e}"))?;
    let container = folder.join(format!("{chain}.kiln"));
    let check = Command::new(kiln).arg("check").arg(&container).output().map_err(|e| e.to_string())?;
    if !check.status.success() {
        return Err(format!("check: {}", String::from_utf8_lossy(&check.stderr)));
    }
    let glb = folder.join(format!("{chain}.glb"));
    let export = Command::new(kiln).args(["export", "--all"]).arg(&container).arg("-o").arg(&glb).output();
    if !export.as_ref().is_ok_and(|o| o.status.success()) {
        return Err(format!("export: {export:?}"));
    }
    let validator = match validate(root, &glb) {
        Some(Ok(line)) => line,
        Some(Err(message)) => return Err(format!("glTF validator: {message}")),
        None => "skipped: needs Node and npm ci in tests/validator".into(),
    };
    let mut rows = Vec::new();
    for asset in report["assets"].as_array().into_iter().flatten() {
        for stage in asset["stages"].as_array().into_iter().flatten() {
            let levels: Vec<String> = stage["report"]["levels"]
                .as_array()
                .into_iter()
                .flatten()
                .map(|l| format!("{} ({:.2e})", l["triangles"], l["error"].as_f64().unwrap_or(f64::NAN)))
                .collect();
            let gaps = stage["report"]["levels"]
                .as_array()
                .map(|l| l.iter().filter_map(|l| l["gaps"].as_u64()).sum::<u64>().to_string())
                .unwrap_or_default();
            rows.push(format!(
                "| {exit} | {} | {:.2} | {:.0} | {} | {gaps} | ok | {validator} |",
                stage["stage"].as_str().unwrap_or("?"),
                stage["seconds"].as_f64().unwrap_or(f64::NAN),
                stage["peak_bytes"].as_f64().unwrap_or(f64::NAN) / 1e6,
                levels.join(", "),
            ));
        }
    }
    Ok(rows)
}

/// Khronos' validator on a GLB: `None` where Node or the package is missing.
fn validate(root: &Path, glb: &Path) -> Option<Result<String, String>> {
    let folder = root.join("tests/validator");
    if !folder.join("node_modules").is_dir() {
        return None;
    }
    let output = Command::new("node").arg("validate.mjs").arg(glb).current_dir(folder).output().ok()?;
    let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
    Some(if output.status.success() { Ok(text.lines().next().unwrap_or_default().into()) } else { Err(text) })
}
