//! `kiln doctor`: what the importer sees in a model, what merge would change, or what this machine offers.

use std::path::Path;

use kiln_asset::Asset;
use kiln_asset::import::{Defect, Folder, ImportError, ImportLimits, ImportReport, import};
use kiln_pipeline::plan::folder_of;
use kiln_pipeline::stages::{MergeSummary, MeshSurvey, preview_merge};
use serde::Serialize;

use super::args::DoctorArgs;
use super::data;
use crate::exit::Exit;
use crate::worker;

/// All that is told of a sound model.
#[derive(Serialize)]
struct Findings {
    /// The model as it was named.
    model: String,
    /// What import counted and repaired.
    #[serde(flatten)]
    import: ImportReport,
    /// In the order of the mesh.
    parts: Vec<Part>,
    /// Box around all vertices, metres.
    bounds: Bounds,
    /// What a merge with default options does.
    merge: MergeSummary,
    /// The surface as merge leaves it.
    surface: MeshSurvey,
}

/// A submesh.
#[derive(Serialize)]
pub(super) struct Part {
    pub(super) name: String,
    pub(super) triangles: usize,
    /// The material's name, or its number where it has none.
    pub(super) material: Option<String>,
}

#[derive(Serialize)]
struct Bounds {
    least: [f32; 3],
    greatest: [f32; 3],
    diagonal: f32,
}

/// All that is told of a broken one.
#[derive(Serialize)]
struct Broken<'a> {
    model: String,
    family: &'a str,
    defects: &'a [Defect],
}

/// With a model: exit 0 for a sound one, 2 with every defect for a broken one.
pub(super) fn run(args: &DoctorArgs) -> Exit {
    let Some(model) = &args.model else { return data(&machine()) };
    let (asset, report) = match open(model) {
        Ok(found) => found,
        Err(error) => {
            if args.json {
                let broken =
                    Broken { model: model.display().to_string(), family: family(&error), defects: error.defects() };
                data(&serde_json::to_string_pretty(&broken).expect("invariant: defects are plain data"));
            }
            return refuse(model, &error);
        }
    };
    let (merge, surface) = preview_merge(&asset.mesh);
    let (least, greatest) = asset.mesh.bounds();
    let bounds = Bounds { least: least.into(), greatest: greatest.into(), diagonal: asset.mesh.diagonal() };
    let parts = parts(&asset);
    let findings = Findings { model: model.display().to_string(), import: report, parts, bounds, merge, surface };
    data(&if args.json {
        serde_json::to_string_pretty(&findings).expect("invariant: findings are plain data")
    } else {
        text(&findings)
    })
}

/// The model with its folder's files, under the default limits.
pub(super) fn open(model: &Path) -> Result<(Asset, ImportReport), ImportError> {
    let name = model.file_name().unwrap_or_default().to_string_lossy();
    import(&Folder(folder_of(model)), &name, &ImportLimits::default())
}

/// Every defect on a line of its own, behind its family.
pub(super) fn refuse(model: &Path, error: &ImportError) -> Exit {
    for defect in error.defects() {
        eprintln!("{}", printable(&format!("error: {}: {}: {defect}", model.display(), family(error))));
    }
    Exit::Failed
}

fn family(error: &ImportError) -> &'static str {
    match error {
        ImportError::Invalid(_) => "invalid model",
        ImportError::Unsupported(_) => "unsupported",
        ImportError::Io(_) => "cannot read",
    }
}

/// The submeshes.
pub(super) fn parts(asset: &Asset) -> Vec<Part> {
    let material = |id: kiln_asset::MaterialId| {
        let name = asset.materials.materials.get(id.index()).map(|m| m.name.clone()).unwrap_or_default();
        if name.is_empty() { format!("material {id}") } else { name }
    };
    let ids = (0..asset.mesh.submeshes.len() as u32).map(kiln_asset::SubmeshId);
    ids.map(|id| {
        let submesh = &asset.mesh.submeshes[id.index()];
        Part {
            name: submesh.name.clone(),
            triangles: asset.mesh.submesh_faces(id).len(),
            material: submesh.material.map(material),
        }
    })
    .collect()
}

/// Most submeshes of the table for people; `--json` has all.
pub(super) const SHOWN_PARTS: usize = 40;

/// A row for each of the first submeshes: name, triangles, material; names quoted, as they would stand in a pipeline.
pub(super) fn part_rows(parts: &[Part]) -> Vec<String> {
    let shown = &parts[..parts.len().min(SHOWN_PARTS)];
    let names: Vec<String> = shown.iter().map(|part| quoted(&part.name)).collect();
    let name_width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
    let count_width = shown.iter().map(|part| part.triangles.to_string().len()).max().unwrap_or(0);
    let rows = shown.iter().zip(&names).map(|(part, name)| {
        let material = part.material.as_deref().map_or_else(|| "the default material".to_owned(), quoted);
        format!("{name:<name_width$}  {:>count_width$} triangles  {material}", part.triangles)
    });
    let more = parts.len().saturating_sub(SHOWN_PARTS);
    rows.chain((more > 0).then(|| format!("and {more} more"))).collect()
}

/// A text from the model as a quoted string of TOML, cut where it is long.
pub(super) fn quoted(text: &str) -> String {
    const LONGEST: usize = 80;
    let cut: String = text.chars().take(LONGEST).collect();
    let more = if cut.len() < text.len() { "..." } else { "" };
    kiln_pipeline::language::value::Value::Text(format!("{cut}{more}")).to_toml()
}

/// One line on a terminal or in a comment: characters that would end it, drive the terminal or turn the direction of writing stand
/// as their numbers.
pub(super) fn printable(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        let turns =
            matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}');
        if c.is_control() || turns {
            out.extend(c.escape_unicode());
        } else {
            out.push(c);
        }
    }
    out
}

fn text(found: &Findings) -> String {
    let report = &found.import;
    let mut lines = vec![
        format!("{}: {:?}, made by {}", found.model, report.format, or_unknown(&report.generator)),
        format!(
            "  {} triangles ({} degenerate), {} vertices, {} submeshes of {} materials",
            report.triangles, report.degenerate_triangles, report.vertices, report.submeshes, report.materials
        ),
        format!(
            "  {} nodes, {} meshes with {} primitives, in place {} times ({} mirrored)",
            report.nodes, report.meshes, report.primitives, report.instances, report.mirrored_instances
        ),
        bounds_line(&found.bounds),
    ];
    lines.extend(part_rows(&found.parts).into_iter().map(|row| format!("  submesh {row}")));
    for image in &report.images {
        let (name, format) = (or_unknown(&image.name), &image.format);
        lines.push(format!("  image {name}: {format} {} x {}, {} bytes", image.width, image.height, image.bytes));
    }
    if !report.extensions_ignored.is_empty() {
        lines.push(format!("  extensions not read: {}", report.extensions_ignored.join(", ")));
    }
    for left in &report.not_carried {
        lines.push(format!("  not carried: {} ({})", left.what, left.count));
    }
    for repair in &report.repairs {
        lines.push(format!(
            "  import changes: {} ({} times, first {})",
            repair.kind.sentence(),
            repair.count,
            repair.first
        ));
    }
    for repaired in &found.merge.repairs {
        let repair = &repaired.repair;
        lines.push(format!("  merge changes: {} ({} times, first {})", repaired.sentence, repair.count, repair.first));
    }
    lines.extend(surface_lines(&found.merge, &found.surface));
    lines.iter().map(|line| printable(line)).collect::<Vec<_>>().join("\n")
}

fn bounds_line(bounds: &Bounds) -> String {
    let size: Vec<String> = (0..3).map(|k| metres(bounds.greatest[k] - bounds.least[k])).collect();
    let corner = |corner: [f32; 3]| corner.map(metres).join(", ");
    format!(
        "  {} m, diagonal {} m, from ({}) to ({})",
        size.join(" x "),
        metres(bounds.diagonal),
        corner(bounds.least),
        corner(bounds.greatest)
    )
}

/// Four significant digits: enough to see a model in millimetres.
fn metres(length: f32) -> String {
    let digits = if length == 0.0 { 0 } else { (3 - f64::from(length.abs()).log10().floor() as i32).clamp(0, 9) };
    format!("{length:.*}", digits as usize)
}

/// What the merged surface is like, and what to do about it.
fn surface_lines(merge: &MergeSummary, surface: &MeshSurvey) -> Vec<String> {
    let mut lines = vec![
        format!(
            "  merged: {} triangles in {} parts without a common point, {} of {} patches closed",
            merge.triangles, surface.components, surface.closed_patches, surface.patches
        ),
        format!(
            "  edges: {} border, {} with more than two faces, {} between faces of opposite winding",
            surface.border_edges, surface.crowded_edges, surface.disagreeing_edges
        ),
    ];
    if merge.joined_edges > 0 {
        lines.push(format!("  submeshes meet along {} of {} border edges", merge.joined_edges, merge.border_edges));
    }
    if surface.turnable_faces > 0 {
        lines.push(format!(
            "  {} faces are wound against their neighbours or inwards ({} closed patches as a whole): merge turns them over \
             with repair = [\"duplicate-faces\", \"zero-normals\", \"winding\"]",
            surface.turnable_faces, surface.inside_out_patches
        ));
    }
    if surface.unorientable_patches > 0 {
        lines.push(format!("  {} patches cannot be wound consistently", surface.unorientable_patches));
    }
    lines
}

fn or_unknown(text: &str) -> &str {
    if text.is_empty() { "unknown" } else { text }
}

/// What this machine offers.
fn machine() -> String {
    let gpu = match kiln_gpu::Gpu::open(true) {
        Ok(gpu) if gpu.is_software() => format!("{} (software: used only with --backend gpu)", gpu.class()),
        Ok(gpu) => gpu.class().to_string(),
        Err(error) => error.to_string(),
    };
    let xatlas = worker::find().map_or_else(
        || {
            "not found; build it with `cargo build --release -p kiln-xatlas --features xatlas` (needs libclang)"
                .to_owned()
        },
        |path| path.display().to_string(),
    );
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    format!("kiln {}\n  cores: {cores}\n  GPU: {gpu}\n  xatlas worker: {xatlas}", env!("CARGO_PKG_VERSION"),)
}
