//! Real models: the counts that the corpus' own manifest states.

use super::*;

/// The corpus folder, or `None` with a word about it.
fn corpus() -> Option<PathBuf> {
    match std::env::var_os("KILN_CORPUS") {
        Some(folder) => Some(folder.into()),
        None => {
            let required = std::env::var_os("KILN_REQUIRE_ALL").is_some_and(|v| v == "1");
            assert!(!required, "KILN_REQUIRE_ALL is set, but KILN_CORPUS is not");
            eprintln!("skipped: needs KILN_CORPUS");
            None
        }
    }
}

/// One row of the manifest's table of counts.
struct Row {
    file: String,
    vertices: u64,
    triangles: u64,
    meshes: u64,
    primitives: u64,
    instances: u64,
    nodes: u64,
    materials: u64,
}

fn rows(manifest: &str) -> Vec<Row> {
    let number = |text: &str| text.replace(',', "").trim().parse::<u64>().ok();
    let row = |line: &str| {
        let cells: Vec<_> = line.split('|').map(str::trim).collect();
        let file = cells.get(1)?.to_string();
        if !is_supported_path(&file) {
            return None;
        }
        let mut sizes = cells.get(5)?.split('/').map(number);
        Some(Row {
            file,
            vertices: number(cells.get(3)?)?,
            triangles: number(cells.get(4)?)?,
            meshes: sizes.next()??,
            primitives: sizes.next()??,
            instances: sizes.next()??,
            nodes: number(cells.get(6)?)?,
            materials: number(cells.get(7)?)?,
        })
    };
    manifest.lines().filter_map(row).collect()
}

#[test]
fn every_corpus_model_has_the_counts_of_its_manifest() {
    let Some(corpus) = corpus() else { return };
    let manifest = std::fs::read_to_string(corpus.join("MANIFEST.md")).unwrap();
    let rows = rows(&manifest);
    assert!(rows.len() >= 16, "only {} rows in the manifest", rows.len());
    for row in rows {
        let path = corpus.join(&row.file);
        let folder = Folder(path.parent().unwrap().to_owned());
        let main = path.file_name().unwrap().to_str().unwrap();
        let started = Instant::now();
        let (asset, report) =
            import(&folder, main, &ImportLimits::default()).unwrap_or_else(|e| panic!("{}: {e}", row.file));
        eprintln!("{}: {:.2} s, {report:?}", row.file, started.elapsed().as_secs_f64());
        assert_eq!(report.stored_vertices, row.vertices, "{}", row.file);
        assert_eq!(report.stored_triangles, row.triangles, "{}", row.file);
        assert_eq!(report.meshes, row.meshes, "{}", row.file);
        assert_eq!(report.primitives, row.primitives, "{}", row.file);
        // The manifest counts placed primitives.
        assert_eq!(report.submeshes, row.instances, "{}", row.file);
        assert_eq!(report.nodes, row.nodes, "{}", row.file);
        assert_eq!(report.materials, row.materials, "{}", row.file);
        assert_eq!(asset.mesh.submeshes.iter().map(|s| s.source_triangles as u64).sum::<u64>(), report.triangles);
        let names: std::collections::BTreeSet<_> = asset.mesh.submeshes.iter().map(|s| &s.name).collect();
        assert_eq!(names.len(), asset.mesh.submeshes.len(), "{}: names repeat", row.file);
        for (info, bytes) in asset.materials.images.iter().zip(&asset.images) {
            let raster = decode_image(info.format, bytes, &ImageLimits::default()).unwrap();
            assert_eq!(
                Some((raster.width, raster.height)),
                image_size(info.format, bytes),
                "{}: {}",
                row.file,
                info.name
            );
        }
    }
}
