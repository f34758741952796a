//! Benchmarks against peers and naive twins; heavy dependencies stay here.
//!
//! Each program in `src/bin` runs kiln and its peer on the same input in one run and prints a table, ratios last: machines are
//! noisy, ratios less so. `cargo run --release -p kiln-bench --bin simplify -- MODEL...`
//!
//! [`model`] and [`median`] are what all programs need; [`peer`] is meshoptimizer as its users call it, [`rows`] a page of results
//! for the terminal and a file, [`plot`] its curves, [`memory`] the process' own.

pub mod memory;
pub mod peer;
pub mod plot;
pub mod rows;

use std::path::Path;
use std::time::Instant;

use kiln_asset::import::{Folder, ImageLimits, ImportLimits, decode_image, import};
use kiln_asset::{Asset, MapRole, Mesh, Raster, RawMesh, Submesh, SubmeshId};

use glam::Vec3;

/// The model at `path`.
///
/// # Errors
/// It cannot be imported.
pub fn model(path: &Path) -> Result<Asset, String> {
    let folder = path.parent().unwrap_or(Path::new(".")).to_path_buf();
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    import(&Folder(folder), &name, &ImportLimits::default()).map(|(asset, _)| asset).map_err(|e| e.to_string())
}

/// The file's name without its extension.
pub fn name(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// `[images.len()]`: the base colours decoded, the others empty.
///
/// # Errors
/// A picture cannot be decoded.
pub fn base_colors(asset: &Asset) -> Result<Vec<Raster>, String> {
    let materials = &asset.materials;
    let mut wanted = vec![false; asset.images.len()];
    for material in &materials.materials {
        let texture = material.map(MapRole::BaseColor).and_then(|map| materials.textures.get(map.texture.index()));
        if let Some(wanted) = texture.and_then(|texture| wanted.get_mut(texture.image.index())) {
            *wanted = true;
        }
    }
    let images = materials.images.iter().zip(&asset.images).zip(wanted);
    images
        .map(|((info, bytes), wanted)| match wanted {
            true => decode_image(info.format, bytes, &ImageLimits::default()).map_err(|e| e.to_string()),
            false => Ok(Raster::default()),
        })
        .collect()
}

/// The mesh's points as vertices, in one submesh, without attributes.
///
/// # Errors
/// None for the points of a valid mesh.
pub fn positions_only(mesh: &Mesh) -> Result<Mesh, String> {
    let mut places = vec![Vec3::ZERO; mesh.point_count()];
    for (v, p) in mesh.points.iter().enumerate().rev() {
        places[p.index()] = mesh.positions[v];
    }
    plain(places, mesh.triangles.iter().map(|t| t.map(|v| mesh.points[v as usize].0)).collect())
}

/// A mesh of one submesh without attributes.
///
/// # Errors
/// An index leads nowhere, or a position is not finite.
pub fn plain(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Result<Mesh, String> {
    let submesh = Submesh { name: "all".into(), source_triangles: triangles.len() as u32, ..Submesh::default() };
    let face_submesh = vec![SubmeshId(0); triangles.len()];
    Mesh::new(RawMesh { positions, face_submesh, triangles, submeshes: vec![submesh], ..RawMesh::default() })
        .map_err(|e| e.to_string())
}

/// Result of the last of `runs` runs after one to warm up, and the median of their seconds.
///
/// # Panics
/// If `runs` is 0.
pub fn median<T>(runs: usize, mut work: impl FnMut() -> T) -> (T, f64) {
    let mut last = work();
    let mut seconds = Vec::with_capacity(runs);
    for _ in 0..runs {
        let start = Instant::now();
        last = work();
        seconds.push(start.elapsed().as_secs_f64());
    }
    (last, middle(seconds))
}

/// The result of `work` and its seconds.
pub fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let result = work();
    (result, start.elapsed().as_secs_f64())
}

/// The median.
///
/// # Panics
/// If there are none.
pub fn middle(mut seconds: Vec<f64>) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds[seconds.len() / 2]
}
