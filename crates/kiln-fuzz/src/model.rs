//! Models and images.

use std::io;

use kiln_asset::import::{
    Files, ImageLimits, ImportError, ImportLimits, decode_image, image_format_of_file, image_size, import,
};

/// Limits on images: a picture of 65,536 texels, 256 KiB as RGBA8.
pub const IMAGE_LIMITS: ImageLimits = ImageLimits { max_side: 4096, max_texels: 1 << 16 };

/// Limits on models, so small that no accepted input is slow: 65,536 vertices and triangles, 1 MiB of files.
pub const LIMITS: fn() -> ImportLimits = || ImportLimits {
    max_file_bytes: 1 << 20,
    max_json_bytes: 1 << 20,
    max_vertices: 1 << 16,
    max_triangles: 1 << 16,
    max_submeshes: 1 << 10,
    images: IMAGE_LIMITS,
    ..ImportLimits::default()
};

/// The files beside every fuzzed model: what a URI may name. `model.bin` is the buffer of the glTF seeds.
const SIBLINGS: &[(&str, &[u8])] = &[
    ("model.bin", include_bytes!("../../../fuzz/siblings/model.bin")),
    ("white.png", include_bytes!("../../../fuzz/siblings/white.png")),
    ("grey.jpg", include_bytes!("../../../fuzz/siblings/grey.jpg")),
    ("clear.webp", include_bytes!("../../../fuzz/siblings/clear.webp")),
    ("textures/odd name.png", include_bytes!("../../../fuzz/siblings/white.png")),
];

/// A model's folder: the fuzzed files, then the siblings.
struct Memory<'a>(&'a [(&'a str, &'a [u8])]);

impl Files for Memory<'_> {
    fn read(&self, relative: &str) -> io::Result<Vec<u8>> {
        // The importer promises never to ask for a path that leaves the folder.
        let leaves = relative.starts_with('/') || relative.split(['/', '\\']).any(|part| part == "..");
        assert!(!leaves, "asked for {relative:?}, which leaves the folder");
        let known = self.0.iter().chain(SIBLINGS).find(|(name, _)| *name == relative);
        known.map(|(_, bytes)| bytes.to_vec()).ok_or_else(|| io::ErrorKind::NotFound.into())
    }
}

/// Imports, and checks what holds for every model whatever; the error if it was refused.
fn model(main: &str, files: &[(&str, &[u8])]) -> Result<(), ImportError> {
    let limits = LIMITS();
    match import(&Memory(files), main, &limits) {
        Ok((asset, report)) => {
            let mesh = &asset.mesh;
            assert!(!mesh.triangles.is_empty() && mesh.triangles.len() as u64 <= limits.max_triangles);
            assert!(mesh.positions.len() as u64 <= limits.max_vertices);
            assert!(mesh.positions.iter().all(|p| p.is_finite()), "a position that is not finite was let through");
            assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < mesh.positions.len()));
            assert_eq!(asset.images.len(), asset.materials.images.len());
            assert_eq!(report.triangles, mesh.triangles.len() as u64);
            for (info, bytes) in asset.materials.images.iter().zip(&asset.images) {
                if let Err(error) = decode_image(info.format, bytes, &IMAGE_LIMITS) {
                    judge(&error);
                }
            }
            Ok(())
        }
        Err(error) => {
            judge(&error);
            Err(error)
        }
    }
}

/// An error tells at least one defect, each with its place, within reason.
fn judge(error: &ImportError) {
    let defects = error.defects();
    assert!(!defects.is_empty() && defects.len() <= 101, "{} defects", defects.len());
    for defect in defects {
        assert!(!defect.path.is_empty() && !defect.message.is_empty(), "{defect:?}");
    }
}

/// The bytes as the model of a target.
///
/// # Errors
/// Those of the importer.
///
/// # Panics
/// Where a promise is broken, or no target of models has this name.
pub fn imports(target: &str, bytes: &[u8]) -> Result<(), ImportError> {
    match target {
        "glb" => model("model.glb", &[("model.glb", bytes)]),
        "gltf" => model("model.gltf", &[("model.gltf", bytes)]),
        "obj" => {
            let [obj, mtl] = crate::split(bytes);
            model("model.obj", &[("model.obj", obj), ("model.mtl", mtl)])
        }
        "ply" => model("model.ply", &[("model.ply", bytes)]),
        other => panic!("{other} is no target of models"),
    }
}

/// The bytes as `model.glb`.
pub fn glb(bytes: &[u8]) {
    let _ = imports("glb", bytes);
}

/// The bytes as `model.gltf`.
pub fn gltf(bytes: &[u8]) {
    let _ = imports("gltf", bytes);
}

/// The first part as `model.obj`, the second as `model.mtl`.
pub fn obj(bytes: &[u8]) {
    let _ = imports("obj", bytes);
}

/// The bytes as `model.ply`.
pub fn ply(bytes: &[u8]) {
    let _ = imports("ply", bytes);
}

/// The bytes as an image of the format that they claim to have, or as TGA, which has no mark.
pub fn image(bytes: &[u8]) {
    let Some(format) = image_format_of_file("image.tga", bytes) else { return };
    let size = image_size(format, bytes);
    match decode_image(format, bytes, &IMAGE_LIMITS) {
        Ok(raster) => {
            assert_eq!(Some((raster.width, raster.height)), size, "the header lied and was believed");
            assert_eq!(raster.texels.len() as u64, raster.width as u64 * raster.height as u64);
            assert!(raster.width.max(raster.height) <= IMAGE_LIMITS.max_side);
            assert!(raster.texels.len() as u64 <= IMAGE_LIMITS.max_texels);
        }
        Err(error) => judge(&error),
    }
}
