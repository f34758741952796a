//! `kiln inspect`, `kiln check`, `kiln export`.

use std::fmt::Write as _;
use std::path::Path;

use kiln_format::{AlignedBytes, Container};
use kiln_pack::{
    ExportLevels, InspectReport, PackError, export_container_glb, export_glb, inspect as inspect_bytes, unpack_detail,
};
use serde_json::json;

use super::args::{CheckArgs, ExportArgs, InspectArgs};
use super::{complain, data, read, write};
use crate::exit::Exit;
use crate::summary;

/// Shows what is in a container.
pub(super) fn inspect(args: &InspectArgs) -> Exit {
    let bytes = match read(&args.file) {
        Ok(bytes) => bytes,
        Err(exit) => return exit,
    };
    match inspect_bytes(&bytes) {
        Ok(report) if args.json => {
            data(&serde_json::to_string_pretty(&report).expect("invariant: a report is plain data"))
        }
        Ok(report) => data(&text(&args.file, &report)),
        Err(error) => complain(Exit::Failed, &format!("{}: {error}", args.file.display())),
    }
}

fn text(file: &Path, report: &InspectReport) -> String {
    let mut out = String::new();
    let size = summary::bytes(report.file_length);
    let _ = writeln!(
        out,
        "{}: container {}, {size}, {} source triangles",
        file.display(),
        report.version,
        report.source_triangles
    );
    // Where there are fewer vertex sections than levels, all levels use the finest one's.
    let of_vertices: Vec<u64> = report.sections.iter().filter(|s| s.kind == "VERT").map(|s| s.stored_length).collect();
    let shared = (of_vertices.len() < report.levels.len()).then(|| of_vertices.first().copied().unwrap_or(0));
    for level in &report.levels {
        let shared = shared.filter(|_| level.lod > 0);
        let own = level.bytes - shared.unwrap_or(0).min(level.bytes);
        let share = 100.0 * f64::from(level.triangles) / f64::from(report.source_triangles.max(1));
        let _ = writeln!(
            out,
            "  level {}: {} triangles ({share:.1} %), {} vertices, error {:.3e} m ({}), {} ({:.1} bytes a triangle), with {}",
            level.lod,
            level.triangles,
            level.vertices,
            level.error,
            level.error_kind,
            summary::bytes(own),
            own as f64 / f64::from(level.triangles.max(1)),
            match shared {
                Some(_) => "vertices of level 0".into(),
                None => level.arrays.join(", "),
            },
        );
    }
    for layout in &report.layouts {
        let share = layout.bytes as f64 / f64::from(layout.triangles.max(1));
        let what = match layout.name {
            "sliding-window" => "collapses",
            "clusters" => "clusters",
            _ => "nodes",
        };
        let range = match (layout.checkpoints.first(), layout.checkpoints.last()) {
            (Some(first), Some(last)) => format!(
                ", {} checkpoints from {} triangles at {:.3e} m to {} at {:.3e} m",
                layout.checkpoints.len(),
                first.triangles,
                first.error,
                last.triangles,
                last.error
            ),
            _ => String::new(),
        };
        let (details, size) = (layout.details, summary::bytes(layout.bytes));
        let _ = writeln!(out, "  {}: {details} {what}, {size} ({share:.1} bytes a triangle){range}", layout.name);
    }
    for (number, submesh) in report.submeshes.iter().enumerate() {
        let of_levels: Vec<String> = report.levels.iter().map(|l| l.submesh_triangles[number].to_string()).collect();
        let material = submesh.material.and_then(|m| report.materials.get(m as usize)).map_or("-", |m| m.name.as_str());
        let _ = writeln!(
            out,
            "  submesh {}: {} source triangles, in levels {}, material {material}",
            submesh.name,
            submesh.source_triangles,
            of_levels.join(" ")
        );
    }
    for texture in &report.textures {
        let _ = writeln!(
            out,
            "  {} {}: {} x {}, {}, {} mips, {}, {}",
            if texture.extra.is_some() { "extra" } else { "texture" },
            texture.name,
            texture.width,
            texture.height,
            texture.format,
            texture.mips,
            summary::bytes(texture.bytes),
            match texture.extra {
                Some(extra) => format!("{extra}, sheet {}", texture.sheet),
                None => texture.roles.join(", "),
            }
        );
    }
    if let Some(made) = &report.provenance {
        let _ = writeln!(
            out,
            "  made by {}, numeric class {}, device {}",
            made.tool,
            made.numeric_class,
            or_none(&made.device_class)
        );
        for (stage, version) in &made.stages {
            let _ = writeln!(out, "    stage {stage}: {version}");
        }
        for (input, hash) in &made.inputs {
            let _ = writeln!(out, "    input {input}: {hash}");
        }
    }
    out
}

fn or_none(text: &str) -> &str {
    if text.is_empty() { "none" } else { text }
}

/// Checks a container: exit 0 or 2, each finding with its code.
pub(super) fn check(args: &CheckArgs) -> Exit {
    let bytes = match read(&args.file) {
        Ok(bytes) => bytes,
        Err(exit) => return exit,
    };
    let report = kiln_format::check(&bytes);
    let exit = if report.is_sound() { Exit::Done } else { Exit::Failed };
    if args.json {
        let findings: Vec<_> = report
            .findings
            .iter()
            .map(|f| json!({ "code": f.code.name(), "path": f.place, "message": f.to_string() }))
            .collect();
        let value =
            json!({ "file": args.file.display().to_string(), "sound": findings.is_empty(), "findings": findings });
        return exit.max(data(&format!("{value:#}")));
    }
    for finding in &report.findings {
        eprintln!("error: {}: {finding}", args.file.display());
    }
    if exit == Exit::Done {
        eprintln!("{}: sound, {} bytes", args.file.display(), bytes.len());
    }
    exit
}

/// Writes a level, or all, as GLB, and textures as files.
pub(super) fn export(args: &ExportArgs) -> Exit {
    let bytes = match read(&args.file) {
        Ok(bytes) => bytes,
        Err(exit) => return exit,
    };
    let textures = args.textures.as_ref().map(|folder| super::textures::export(args, folder, &bytes));
    let trees = args.trees.as_ref().map(|folder| export_trees(args, folder, &bytes));
    let levels = args.output.as_ref().map(|output| export_levels(args, output, &bytes));
    [textures, trees, levels].into_iter().flatten().max().unwrap_or(Exit::Done)
}

/// Writes tree and leaf buffers as OpenEXR.
fn export_trees(args: &ExportArgs, folder: &Path, bytes: &[u8]) -> Exit {
    let fail = |error: PackError| complain(Exit::Failed, &format!("{}: {error}", args.file.display()));
    let aligned = AlignedBytes::copy_of(bytes);
    let opened = Container::open(&aligned).map_err(PackError::from);
    let files = match opened.and_then(|container| kiln_pack::trees::write(&container)) {
        Ok(files) => files,
        Err(error) => return fail(error),
    };
    if let Err(error) = std::fs::create_dir_all(folder) {
        return complain(Exit::Failed, &format!("cannot make {}: {error}", folder.display()));
    }
    for (name, bytes) in files {
        let path = folder.join(name);
        if let Err(exit) = write(&path, &bytes) {
            return exit;
        }
        eprintln!("{}: {}", path.display(), summary::bytes(bytes.len() as u64));
    }
    Exit::Done
}

fn export_levels(args: &ExportArgs, output: &Path, bytes: &[u8]) -> Exit {
    let exported = match args.all {
        true => export_container_glb(bytes, ExportLevels::All),
        false => unpack_detail(bytes, args.level).and_then(|(levels, materials, rasters)| {
            let pictures: Vec<_> = rasters.iter().collect();
            export_glb(&levels, &materials, &pictures, ExportLevels::One(0))
        }),
    };
    let (glb, report) = match exported {
        Ok(result) => result,
        Err(error) => return complain(Exit::Failed, &format!("{}: {error}", args.file.display())),
    };
    for note in &report.notes {
        eprintln!("note: {note}");
    }
    if let Err(exit) = write(output, &glb) {
        return exit;
    }
    eprintln!("{}: {}", output.display(), summary::bytes(glb.len() as u64));
    Exit::Done
}
