//! What baked levels look like: real models to a tenth of their triangles, all maps into one sheet, compared with the source.
//!
//! The models lie outside the project; `KILN_CORPUS` names their folder. Everything runs through the command itself.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::long::stamp;

/// Name and path in the corpus. The first one's sheet becomes the page's picture.
const MODELS: [(&str, &str); 4] = [
    ("FlightHelmet", "gltf/FlightHelmet/FlightHelmet.gltf"),
    ("CesiumMilkTruck", "gltf/CesiumMilkTruck/CesiumMilkTruck.gltf"),
    ("Barrel", "gltf/Barrel.glb"),
    ("Spot", "gltf/Spot.glb"),
];

const PIPELINE: &str = r#"
kiln = 1
[asset]
input = "INPUT"
output = "baked.kiln"
allow-outside = true
[[stage]]
id = "whole"
kind = "merge"
[[stage]]
id = "base"
kind = "simplify"
placement = "free"
levels = [{ keep = 0.1 }]
[[stage]]
kind = "atlas"
size = 2048
[[stage]]
id = "lods"
kind = "simplify"
levels = [{ keep = 0.1 }]
[[stage]]
kind = "bake"
high = "whole"
maps = ["normal", "base-color", "metallic-roughness", "occlusion", "emissive"]
[[stage]]
kind = "pack"
"#;

/// `xtask baked`: writes `docs/results/bake.md` and its picture.
pub(crate) fn run(root: &Path) -> Result<(), String> {
    let corpus = std::env::var_os("KILN_CORPUS").map(PathBuf::from).ok_or("xtask baked needs KILN_CORPUS")?;
    let corpus = corpus.canonicalize().map_err(|e| format!("KILN_CORPUS: {e}"))?;
    let build = Command::new("cargo").args(["build", "--release", "--locked"]).current_dir(root).status();
    if !build.is_ok_and(|s| s.success()) {
        return Err("the command did not build".into());
    }
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or(root.join("target"), PathBuf::from);
    let (kiln, scratch) = (target.join("release/kiln"), target.join("baked"));
    let mut page = format!(
        "# What baked levels look like\n\n{} A tenth of the triangles, the five maps of all materials in one sheet of 2048 x 2048, bake and \
         compare with their defaults but free placement, CPU. *Surface*: renders with all maps lit, RMSE of full range over the pixels that \
         both cover, 24 views; *outlines*: share of the picture that only one covers.\n\n![FlightHelmet](../images/bake-helmet.png)\n\n\
         | model | triangles | materials | bake s | texels missed | surface | worst view | outlines |\n\
         | --- | --: | --: | --: | --: | --: | --: | --: |\n",
        stamp(root).replace("xtask long", "xtask baked")
    );
    for (k, (name, path)) in MODELS.iter().enumerate() {
        eprintln!("{name}");
        let folder = scratch.join(name);
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        let input = corpus.join(path).display().to_string();
        fs::write(folder.join("pipeline.toml"), PIPELINE.replace("INPUT", &input)).map_err(|e| e.to_string())?;
        let json = |args: &[&str]| {
            let output = Command::new(&kiln).args(args).current_dir(&folder).output().map_err(|e| e.to_string())?;
            serde_json::from_slice::<Value>(&output.stdout)
                .map_err(|e| format!("{name}: {e}: {}", String::from_utf8_lossy(&output.stderr)))
        };
        let built = json(&["build", "pipeline.toml", "--backend", "cpu", "--json"])?;
        let stages = built["assets"][0]["stages"].as_array().cloned().unwrap_or_default();
        let bake = stages.iter().find(|s| s["stage"] == "bake").cloned().unwrap_or_default();
        let sheet = root.join("docs/images/bake-helmet.png").display().to_string();
        let mut args = vec!["compare", &input, "baked.kiln#0", "--json"];
        if k == 0 {
            args.extend(["--sheet", &sheet]);
        }
        let compared = json(&args)?;
        let inspected = json(&["inspect", "baked.kiln", "--json"])?;
        let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
        let material = &compared["material"];
        let both = material["per_view_both"].as_array().cloned().unwrap_or_default();
        let worst = both.iter().map(number).fold(0.0, f64::max);
        let _ = writeln!(
            page,
            "| {name} | {} to {} | {} | {:.2} | {:.2} % | {:.2} % | {:.2} % | {:.2} % |",
            compared["reference"]["triangles"],
            compared["other"]["triangles"],
            inspected["materials"].as_array().map_or(0, Vec::len),
            number(&bake["seconds"]),
            100.0 * number(&bake["report"]["missed"]) / number(&bake["report"]["owned"]),
            number(&material["rmse_both"]) / 2.55,
            worst / 2.55,
            100.0 * number(&compared["silhouette"]["xor"]),
        );
    }
    fs::write(root.join("docs/results/bake.md"), page).map_err(|e| e.to_string())
}
