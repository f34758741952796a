//! Models of the corpus packed, unpacked and exported; exports judged by Khronos' validator.
//!
//! Needs `KILN_CORPUS` (folder of the models) and, for the validator, Node and `npm ci` in `tests/validator`. With
//! `KILN_REQUIRE_ALL=1` a skipped test fails.

use std::path::{Path, PathBuf};
use std::process::Command;

use glam::{Vec3, Vec4};
use kiln_asset::import::{Files, ImportLimits, decode_image, import};
use kiln_asset::{
    AlphaMode, Asset, Filter, ImageFormat, ImageId, ImageInfo, Level, LodSet, Material, MaterialId, MaterialSet, Mesh,
    Raster, RawMesh, Sampler, Submesh, SubmeshId, Texture, TextureId, TextureRef,
};
use kiln_pack::{Continuous, ExportLevels, PackOptions, Provenance, export_container_glb, export_glb, pack, unpack};

/// The value of a variable, or `None` with the reason printed.
fn needed(variable: &str) -> Option<PathBuf> {
    let value = std::env::var_os(variable).map(PathBuf::from);
    if value.is_none() {
        assert!(std::env::var_os("KILN_REQUIRE_ALL").is_none(), "skipped: needs {variable}");
        eprintln!("skipped: needs {variable}");
    }
    value
}

struct Folder(PathBuf);

impl Files for Folder {
    fn read(&self, relative: &str) -> std::io::Result<Vec<u8>> {
        std::fs::read(self.0.join(relative))
    }
}

/// The model `file` anywhere below `folder`, the first by path.
fn find(folder: &Path, file: &str) -> Option<PathBuf> {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder).ok()?.flatten().map(|entry| entry.path()).collect();
    entries.sort();
    let here = entries.iter().find(|path| path.is_file() && path.file_name().is_some_and(|name| name == file));
    here.cloned().or_else(|| entries.iter().filter(|path| path.is_dir()).find_map(|path| find(path, file)))
}

fn load(corpus: &Path, file: &str) -> Asset {
    let path = find(corpus, file).unwrap_or_else(|| panic!("{file} is not in the corpus"));
    let folder = Folder(path.parent().expect("a file has a folder").to_path_buf());
    import(&folder, file, &ImportLimits::default()).unwrap_or_else(|e| panic!("{file}: {e}")).0
}

/// The whole model as level 0, and every other triangle of it as level 1.
fn container(asset: &Asset) -> (Vec<u8>, LodSet) {
    let mut raw = asset.mesh.clone().into_raw();
    let keep = |k: &usize| k.is_multiple_of(2);
    raw.triangles = (0..raw.triangles.len()).filter(keep).map(|k| raw.triangles[k]).collect();
    raw.face_submesh = (0..raw.face_submesh.len()).filter(keep).map(|k| raw.face_submesh[k]).collect();
    let coarse = kiln_asset::Mesh::new(raw).expect("fewer faces");
    let level = |mesh, error| Level { mesh, error, quadrics: Vec::new() };
    let levels = vec![level(asset.mesh.clone(), 0.0), level(coarse, asset.mesh.diagonal() * 0.01)];
    let set = LodSet { levels, layout: None, source_triangles: asset.mesh.face_count() as u32 };
    let images = |image: ImageId| {
        let info = &asset.materials.images[image.index()];
        let decoded = decode_image(info.format, &asset.images[image.index()], &Default::default());
        decoded.map(Into::into).map_err(|e| e.to_string())
    };
    let packed =
        pack(&set, &asset.materials, &images, &Provenance::default(), &PackOptions::default(), &Continuous::default());
    (packed.expect("packs").0, set)
}

/// Textured with tangents, mirrored instances, several UV sets, a skeleton, no UVs at all.
const MODELS: [&str; 10] = [
    "CesiumMilkTruck.gltf",
    "FlightHelmet.gltf",
    "Barrel.glb",
    "Spot.glb",
    "Avocado.gltf",
    "robot-cell.glb",
    "Fox.glb",
    "ChessBoard.glb",
    "2CylinderEngine.glb",
    "stanford-bunny.glb",
];

#[test]
fn corpus_models_come_back_bit_for_bit_and_their_exports_pass_the_validator() {
    let Some(corpus) = needed("KILN_CORPUS") else { return };
    let out = tempfile::tempdir().expect("a temporary folder");
    let mut files = Vec::new();
    for file in MODELS {
        let asset = load(&corpus, file);
        let (bytes, before) = container(&asset);
        assert!(kiln_format::check(&bytes).is_sound(), "{file}");
        let (after, ..) = unpack(&bytes).expect("sound");
        for (old, new) in before.levels.iter().zip(&after.levels) {
            assert!(old.mesh.positions == new.mesh.positions && old.mesh.triangles == new.mesh.triangles, "{file}");
            assert!(old.mesh.normals == new.mesh.normals && old.mesh.uv0 == new.mesh.uv0, "{file}");
            assert!(old.mesh.submeshes == new.mesh.submeshes, "{file}");
        }
        for (which, name) in [(ExportLevels::One(1), "one"), (ExportLevels::All, "all")] {
            let (glb, _) = export_container_glb(&bytes, which).expect("exports");
            let path = out.path().join(format!("{name}-{file}")).with_extension("glb");
            std::fs::write(&path, glb).expect("writes");
            files.push(path);
        }
    }
    validate(&files);
}

/// Values that glTF forbids, a material that reads UV sets the mesh lacks, an empty submesh, an empty level.
#[test]
fn an_export_of_spoilt_values_passes_the_validator() {
    let out = tempfile::tempdir().expect("a temporary folder");
    let mut raw = RawMesh {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::ONE],
        normals: Some(vec![Vec3::ZERO, Vec3::splat(1e-30), Vec3::splat(1e30), Vec3::new(0.0, 0.0, 0.9)]),
        tangents: Some(vec![Vec4::ZERO, Vec4::splat(3.0), Vec4::new(0.0, 0.0, 0.0, -2.0), Vec4::X]),
        colors: Some(vec![Vec4::splat(7.0), Vec4::splat(-1.0), Vec4::ONE, Vec4::ZERO]),
        joints: Some(vec![[9; 4]; 4]),
        weights: Some(vec![Vec4::ZERO; 4]),
        triangles: vec![[0, 1, 2], [2, 1, 3], [3, 3, 3]],
        face_submesh: vec![SubmeshId(0); 3],
        submeshes: vec![Submesh { name: "spoilt".into(), material: Some(MaterialId(0)), ..Default::default() }],
        ..RawMesh::default()
    };
    raw.submeshes.push(Submesh { name: "empty".into(), ..Default::default() });
    let mut empty = raw.clone();
    (empty.triangles, empty.face_submesh) = (Vec::new(), Vec::new());
    let level = |raw, error| Level { mesh: Mesh::new(raw).expect("valid"), error, quadrics: Vec::new() };
    let levels = LodSet { levels: vec![level(raw, 0.0), level(empty, 9.0)], ..LodSet::default() };
    let texture = |image, mip| Texture { image: ImageId(image), sampler: Sampler { mip, ..Sampler::default() } };
    let used = |texture, uv_set| Some(TextureRef { texture: TextureId(texture), uv_set });
    let material = Material {
        base_color_factor: [2.0, -1.0, 0.5, 1.0],
        metallic_factor: 3.0,
        emissive_factor: [40.0, 1.0, 0.0],
        occlusion_strength: 1.5,
        base_color: used(0, 0),
        normal: used(1, 1),
        alpha_mode: AlphaMode::Mask,
        ..Material::default()
    };
    let info = |name: &str| ImageInfo { name: name.into(), format: ImageFormat::Raster, hash: [0; 32] };
    let set = MaterialSet {
        materials: vec![material],
        textures: vec![texture(0, None), texture(1, Some(Filter::Nearest))],
        images: vec![info("grey"), info("")],
        extras: Vec::new(),
    };
    let pictures = [Raster::filled(1, 1, [9; 4]), Raster::filled(3, 5, [128, 128, 255, 255])];
    let pictures: Vec<&Raster> = pictures.iter().collect();
    let mut files = Vec::new();
    for which in [ExportLevels::All, ExportLevels::One(0), ExportLevels::One(1)] {
        let (glb, _) = export_glb(&levels, &set, &pictures, which).expect("exports");
        let path = out.path().join(format!("spoilt-{}.glb", files.len()));
        std::fs::write(&path, glb).expect("writes");
        files.push(path);
    }
    validate(&files);
}

fn validate(files: &[PathBuf]) {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/validator"));
    let node = Command::new("node").arg("--version").output().is_ok();
    if !node || !folder.join("node_modules").is_dir() {
        let what = "Node and `npm ci` in tests/validator";
        assert!(std::env::var_os("KILN_REQUIRE_ALL").is_none(), "this test needs {what}");
        eprintln!("skipped: needs {what}");
        return;
    }
    let output = Command::new("node").arg("validate.mjs").args(files).current_dir(folder).output().expect("Node runs");
    let (report, trouble) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    eprintln!("{report}");
    assert!(output.status.success(), "{report}{trouble}");
}
