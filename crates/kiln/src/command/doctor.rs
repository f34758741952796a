//! `kiln doctor`: what the importer sees in a model, or what this machine offers.

use std::path::Path;

use kiln_asset::import::{Folder, ImportLimits, ImportReport, import};
use kiln_pipeline::plan::folder_of;

use super::args::DoctorArgs;
use super::data;
use crate::exit::Exit;
use crate::worker;

/// With a model: exit 0 for a sound one, 2 with every defect for a broken one.
pub(super) fn run(args: &DoctorArgs) -> Exit {
    let Some(model) = &args.model else { return data(&machine()) };
    let name = model.file_name().unwrap_or_default().to_string_lossy().into_owned();
    match import(&Folder(folder_of(model)), &name, &ImportLimits::default()) {
        Ok((_, report)) if args.json => {
            data(&serde_json::to_string_pretty(&report).expect("invariant: a report is plain data"))
        }
        Ok((_, report)) => data(&text(model, &report)),
        Err(error) => {
            let family = error.to_string();
            let family = family.split(':').next().unwrap_or_default().to_owned();
            for defect in error.defects() {
                eprintln!("error: {}: {family}: {defect}", model.display());
            }
            Exit::Failed
        }
    }
}

fn text(model: &Path, report: &ImportReport) -> String {
    let mut lines = vec![
        format!("{}: {:?}, made by {}", model.display(), report.format, or_unknown(&report.generator)),
        format!(
            "  {} triangles ({} degenerate), {} vertices, {} submeshes of {} materials",
            report.triangles, report.degenerate_triangles, report.vertices, report.submeshes, report.materials
        ),
        format!(
            "  {} nodes, {} meshes with {} primitives, in place {} times ({} mirrored)",
            report.nodes, report.meshes, report.primitives, report.instances, report.mirrored_instances
        ),
    ];
    for image in &report.images {
        lines.push(format!(
            "  image {}: {} {} x {}, {} bytes",
            or_unknown(&image.name),
            image.format,
            image.width,
            image.height,
            image.bytes
        ));
    }
    if !report.extensions_ignored.is_empty() {
        lines.push(format!("  extensions not read: {}", report.extensions_ignored.join(", ")));
    }
    for left in &report.not_carried {
        lines.push(format!("  not carried: {} ({})", left.what, left.count));
    }
    for repair in &report.repairs {
        lines.push(format!(
            "  would change: {} ({} times, first {})",
            repair.kind.sentence(),
            repair.count,
            repair.first
        ));
    }
    lines.join("\n")
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
