//! `kiln init`: a commented pipeline for a model, with the choices that fit it.
//!
//! Rules. With a bake: at least one material in use has a texture, and the bake leaves fewer materials than there are (it keeps
//! one for each alpha mode and for one- and two-sided faces). Otherwise the levels keep the model's UVs and textures. Levels halve
//! the triangles, or quarter them where halving would not come down to a few hundred, and stop above [`FEWEST`]. A level that
//! seams and charts keep from its budget is reported by the build, as always.
//!
//! Whatever the model says about itself stands in comments, and leaves them under no name: control characters are escaped.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Component, Path, PathBuf};

use kiln_asset::import::ImportReport;
use kiln_asset::{Asset, MapRole, Material};
use kiln_pipeline::language::inputs::literal;
use kiln_pipeline::language::value::Value;
use kiln_pipeline::plan::folder_of;

use super::args::InitArgs;
use super::doctor::{open, part_rows, parts, printable, quoted, refuse};
use super::{complain, data};
use crate::exit::Exit;

/// No level is made with fewer triangles: coarser ones save nothing that a renderer would notice.
const FEWEST: f64 = 250.0;
/// Most levels of a pipeline.
const MOST_LEVELS: usize = 6;
/// Most levels over one baked layout: its charts hold their borders, and further levels often stop short of their budgets (the
/// fixture pot at a twentieth of its triangles).
const MOST_BAKED_LEVELS: usize = 3;
/// A bake starts from a base of at most so many triangles: what is finer goes into the normal map.
const BASE_TRIANGLES: f64 = 20_000.0;

/// Exit 0 and a new file; 2 for a broken model; 64 if the file is there already.
pub(super) fn run(args: &InitArgs) -> Exit {
    let model = &args.model;
    let to_stdout = args.output.as_deref() == Some(Path::new("-"));
    let output = match &args.output {
        Some(output) => output.clone(),
        None => PathBuf::from(model.file_stem().unwrap_or_default()).with_added_extension("toml"),
    };
    if !to_stdout && output.symlink_metadata().is_ok() {
        return exists(&output);
    }
    let (asset, report) = match open(model) {
        Ok(found) => found,
        Err(error) => return refuse(model, &error),
    };
    let folder = if to_stdout { PathBuf::from(".") } else { folder_of(&output) };
    let input = match relative(&folder, model) {
        Ok(input) => input,
        Err(message) => return complain(Exit::Failed, &message),
    };
    let text = pipeline(&input, &asset, &report);
    if to_stdout {
        return data(&text);
    }
    // `create_new`: a file that came up in the meantime is not replaced either.
    match fs::File::create_new(&output).and_then(|mut file| file.write_all(text.as_bytes())) {
        Ok(()) => {
            eprintln!(
                "{} is written; read its comments, then type:\n  kiln build {}",
                output.display(),
                shell(&output)
            );
            Exit::Done
        }
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => exists(&output),
        Err(error) => complain(Exit::Failed, &format!("cannot write {}: {error}", output.display())),
    }
}

fn exists(output: &Path) -> Exit {
    let message =
        format!("{} exists already; choose another file with -o PIPELINE, or -o - to see it", output.display());
    complain(Exit::Usage, &message)
}

/// A path as a shell takes it.
fn shell(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_alphanumeric() || "-_./".contains(c);
    if text.chars().all(plain) && !text.starts_with('-') { text } else { format!("'{}'", text.replace('\'', "'\\''")) }
}

/// The model as seen from `folder`, `/`-separated, links resolved.
fn relative(folder: &Path, model: &Path) -> Result<String, String> {
    let real = |path: &Path| path.canonicalize().map_err(|error| format!("cannot find {}: {error}", path.display()));
    let name = model.file_name().ok_or_else(|| format!("{} names no file", model.display()))?;
    let (from, to) = (real(folder)?, real(&folder_of(model))?);
    let common = from.components().zip(to.components()).take_while(|(a, b)| a == b).count();
    if common == 0 {
        return Err(format!("{} lies on another drive than the pipeline", model.display()));
    }
    let up = from.components().skip(common).map(|_| "..".into());
    let down = to.components().skip(common).map(Component::as_os_str).chain([name]);
    let down = down.map(|part| part.to_str().map(str::to_owned));
    let parts: Option<Vec<String>> = up.map(Some).chain(down).collect();
    parts
        .map(|parts| parts.join("/"))
        .ok_or_else(|| format!("{}: a name that is not UTF-8 cannot be written in a pipeline", model.display()))
}

/// The pipeline's text. `input`: the model, relative to the pipeline.
fn pipeline(input: &str, asset: &Asset, report: &ImportReport) -> String {
    let mut out = String::new();
    let file = input.rsplit('/').next().unwrap_or(input);
    comment(&mut out, &format!("{} as `kiln init` found it. Every key: `kiln stage`.", quoted(file)));
    comment(&mut out, "");
    describe(&mut out, asset, report);

    let _ = writeln!(out, "\nkiln = 1\n\n[asset]\ninput = {}", Value::Text(literal(input)).to_toml());
    if literal(input) != input {
        comment(&mut out, "input is a glob: [*] stands for the character * itself, and so on");
    }
    out.push_str("output = \"build/{name}.kiln\"\n");
    comment(&mut out, "for hundreds of models: input = \"models/**/*.glb\" and output = \"build/{path}.kiln\"");

    out.push_str("\n[[stage]]\nid = \"whole\"\nkind = \"merge\"\n");
    comment(&mut out, "one mesh; where borders of submeshes touch they share points, so that no crack opens");
    comment(&mut out, "add \"winding\" if faces are missing or dark: wrongly wound ones are turned over");
    out.push_str("repair = [\"duplicate-faces\", \"zero-normals\"]\n\n");

    let used = used_materials(asset);
    let groups: BTreeSet<_> = used.iter().map(|m| (m.alpha_mode, m.double_sided)).collect();
    let textured = used.iter().filter(|m| MapRole::ALL.iter().any(|role| m.map(*role).is_some())).count();
    let counts = format!("{} in use, {textured} of them with textures", plural(used.len(), "material"));
    let triangles = report.triangles as f64;
    if textured > 0 && groups.len() < used.len() {
        comment(&mut out, &format!("{counts}: a bake makes {} of them, with", plural(groups.len(), "material")));
        comment(
            &mut out,
            "one set of textures, and carries lost detail into a normal map. To keep the model's own UVs and",
        );
        comment(&mut out, "textures instead, delete the stages base, atlas and bake.");
        out.push('\n');
        bake_chain(&mut out, triangles, report, &used);
    } else {
        comment(&mut out, &format!("{counts}: a bake would make no fewer, so the levels keep the"));
        comment(
            &mut out,
            "model's own UVs and textures. For baked maps see pipelines/quickstart.toml and `kiln stage bake`.",
        );
        out.push('\n');
        levels(&mut out, &ladder(1.0, triangles), triangles);
    }
    out.push_str("\n[[stage]]\nkind = \"pack\"\n");
    out
}

/// What the importer saw.
fn describe(out: &mut String, asset: &Asset, report: &ImportReport) {
    let (lo, hi) = asset.mesh.bounds();
    let size = (hi - lo).to_array();
    comment(
        out,
        &format!(
            "{} in {}, {}; {:.4} x {:.4} x {:.4} m",
            plural(report.triangles as usize, "triangle"),
            plural(report.submeshes as usize, "submesh"),
            plural(report.materials as usize, "material"),
            size[0],
            size[1],
            size[2]
        ),
    );
    for row in part_rows(&parts(asset)) {
        comment(out, &format!("  submesh {row}"));
    }
    const SHOWN_IMAGES: usize = 40;
    for image in report.images.iter().take(SHOWN_IMAGES) {
        comment(out, &format!("  image {}: {} {} x {}", quoted(&image.name), image.format, image.width, image.height));
    }
    if report.images.len() > SHOWN_IMAGES {
        comment(out, &format!("  and {} more images", report.images.len() - SHOWN_IMAGES));
    }
    for repair in &report.repairs {
        comment(
            out,
            &format!("  import repairs {} ({} times, first {})", repair.kind.sentence(), repair.count, repair.first),
        );
    }
    for left in &report.not_carried {
        comment(out, &format!("  not carried: {} ({})", left.what, left.count));
    }
    comment(out, "`kiln doctor MODEL` tells more.");
}

/// The materials that submeshes refer to, each once.
fn used_materials(asset: &Asset) -> Vec<Material> {
    let ids: BTreeSet<_> = asset.mesh.submeshes.iter().map(|submesh| submesh.material).collect();
    let material = |id: kiln_asset::MaterialId| asset.materials.materials.get(id.index()).cloned();
    ids.into_iter().map(|id| id.and_then(material).unwrap_or_default()).collect()
}

/// Shares of the model's triangles from `first` down: each a half of the one before, or a quarter where that needs too many.
fn ladder(first: f64, triangles: f64) -> Vec<f64> {
    let by_halves = FEWEST * f64::from(1 << MOST_LEVELS);
    let step = if first * triangles < by_halves { 0.5 } else { 0.25 };
    let next = |share: &f64| Some(share * step).filter(|share| share * triangles >= FEWEST);
    std::iter::successors(Some(first), next).take(MOST_LEVELS).collect()
}

/// A simplify stage `lods`.
fn levels(out: &mut String, shares: &[f64], triangles: f64) {
    out.push_str("[[stage]]\nid = \"lods\"\nkind = \"simplify\"\n");
    comment(out, "finest first; each with keep (a share of the model), triangles or error (\"0.01 diag\", \"2 mm\")");
    out.push_str("levels = [\n");
    for share in shares {
        let keep = Value::Number(*share).to_toml();
        let _ = writeln!(
            out,
            "  {{ keep = {keep} }},{} # {:.0} triangles",
            " ".repeat(12_usize.saturating_sub(keep.len())),
            share * triangles
        );
    }
    out.push_str("]\n");
}

/// From the base level to the bake.
fn bake_chain(out: &mut String, triangles: f64, report: &ImportReport, used: &[Material]) {
    let quarter = |share: &f64| Some(share * 0.25).filter(|_| share * triangles > BASE_TRIANGLES);
    let base = std::iter::successors(Some(1.0), quarter).last().unwrap_or(1.0);
    let side = report.images.iter().map(|image| image.width.max(image.height)).max().unwrap_or(512);
    // Several materials share it, so it is wider than any of their images.
    let size = (2 * side.min(2048)).max(256).next_power_of_two();
    let (padding, dilation) = ((size / 128).clamp(2, 16), (size / 256).clamp(1, 8));
    let keep = Value::Number(base).to_toml();
    out.push_str("[[stage]]\nid = \"base\"\nkind = \"simplify\"\n");
    comment(out, &format!("the finest level that will be drawn: {:.0} triangles", base * triangles));
    let _ = writeln!(out, "levels = [{{ keep = {keep} }}]\n\n[[stage]]\nkind = \"atlas\"");
    comment(out, "a new UV layout for all materials: twice as wide as the largest image, between 256 and 4096 texels");
    let _ = writeln!(out, "size = {size}\npadding = {padding}\n");
    let ladder = ladder(base, triangles);
    levels(out, &ladder[..ladder.len().min(MOST_BAKED_LEVELS)], triangles);

    let has = |role| used.iter().any(|material| material.map(role).is_some());
    let mut maps = vec!["normal", "base-color", "metallic-roughness"];
    if has(MapRole::Occlusion) {
        maps.push("occlusion");
    }
    if has(MapRole::Emissive) || used.iter().any(|material| material.emissive_factor != [0.0; 3]) {
        maps.push("emissive");
    }
    let maps = Value::List(maps.into_iter().map(|map| Value::Text(map.to_owned())).collect()).to_toml();
    let _ = writeln!(out, "\n[[stage]]\nkind = \"bake\"\nhigh = \"whole\"\nmaps = {maps}\ndilation = {dilation}");
}

fn plural(count: usize, what: &str) -> String {
    let ending = match what {
        _ if count == 1 => "",
        "submesh" => "es",
        _ => "s",
    };
    format!("{count} {what}{ending}")
}

/// A comment line; nothing in `text` can end it.
fn comment(out: &mut String, text: &str) {
    out.push_str(if text.is_empty() { "#" } else { "# " });
    out.push_str(&printable(text));
    out.push('\n');
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn levels_halve_or_quarter_down_to_a_few_hundred_triangles() {
        assert_eq!(ladder(1.0, 1.0), [1.0]);
        assert_eq!(ladder(1.0, 768.0), [1.0, 0.5]);
        assert_eq!(ladder(1.0, 1000.0), [1.0, 0.5, 0.25]);
        assert_eq!(ladder(1.0, 1e6), [1.0, 0.25, 0.0625, 0.015625, 0.00390625, 0.0009765625]);
        assert_eq!(ladder(0.25, 1e4), [0.25, 0.125, 0.0625, 0.03125]);
    }

    #[test]
    fn no_text_of_a_model_leaves_its_comment() {
        let mut out = String::new();
        comment(&mut out, "a\nkiln = 2\r\u{0}\u{7f}\u{85}\u{2028}b\tc \u{202e}d");
        assert_eq!(out.lines().count(), 1);
        assert_eq!(out, "# a\\u{a}kiln = 2\\u{d}\\u{0}\\u{7f}\\u{85}\\u{2028}b\\u{9}c \\u{202e}d\n");
    }

    #[test]
    fn any_name_of_a_submesh_and_of_a_file_gives_a_pipeline_that_the_parser_takes() {
        let mesh = |name: &str| {
            kiln_asset::Mesh::new(kiln_asset::RawMesh {
                positions: vec![Default::default(); 3],
                triangles: vec![[0, 1, 2]],
                face_submesh: vec![kiln_asset::SubmeshId(0)],
                submeshes: vec![kiln_asset::Submesh { name: name.into(), ..Default::default() }],
                ..Default::default()
            })
            .unwrap()
        };
        for name in [
            "",
            "a\nb = 1",
            "\"quoted\" 'x' \\ back",
            "[x]*?",
            "tab\tnull\u{0}",
            "{name}",
            "\u{1f3fa} #\r\n]]",
            "\"\"\"\n'''",
        ] {
            let asset = Asset { mesh: mesh(name), ..Default::default() };
            let report = ImportReport { triangles: 1, submeshes: 1, ..Default::default() };
            let input = format!("models/{}.glb", name.replace('/', ""));
            let text = pipeline(&input, &asset, &report);
            let none = |_: &str| Err(io::ErrorKind::NotFound.into());
            let loaded = kiln_pipeline::language::load("x.toml", &text, &[], &none);
            let read = loaded.pipeline.unwrap_or_else(|| panic!("{:?}\n{text}", loaded.diagnostics));
            assert_eq!(read.stages.len(), 3, "{text}");
            assert!(loaded.diagnostics.is_empty(), "{:?}", loaded.diagnostics);
        }
    }
}
