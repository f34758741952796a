//! Round trips, determinism, and exports as another reader sees them.

use glam::{Vec2, Vec3, Vec4};
use kiln_asset::{
    AlphaMode, AttributeSet, ImageFormat, ImageId, ImageInfo, Level, LodSet, MapRole, Material, MaterialId,
    MaterialSet, Mesh, Raster, RawMesh, Submesh, SubmeshId, Texture, TextureId, TextureRef, UvLayout,
};
use kiln_format::{Container, Provenance, check};

use super::*;

mod files;
mod textures;

/// A bumpy grid of `n x n` quads in two submeshes, with every attribute.
fn grid(n: u32) -> Mesh {
    let mut raw = RawMesh::default();
    let (mut normals, mut tangents, mut uv0, mut uv1, mut colors) = (vec![], vec![], vec![], vec![], vec![]);
    let (mut joints, mut weights) = (vec![], vec![]);
    for submesh in 0..2 {
        let first = raw.positions.len() as u32;
        for y in 0..=n {
            for x in 0..=n {
                let (u, v) = (x as f32 / n as f32, y as f32 / n as f32);
                raw.positions.push(Vec3::new(u + submesh as f32, v, (x * 7 + y * 3) as f32 % 5.0 * 0.01));
                normals.push(Vec3::new(u - 0.5, v - 0.5, 1.0).normalize());
                tangents.push(Vec4::new(1.0, 0.0, 0.0, if submesh == 0 { 1.0 } else { -1.0 }));
                uv0.push(Vec2::new(u, v));
                uv1.push(Vec2::new(v, u));
                colors.push(Vec4::new(u, v, 0.5, 1.0));
                joints.push([x as u16, 1, 2, 3]);
                weights.push(Vec4::new(0.25, 0.25, 0.25, 0.25));
            }
        }
        for y in 0..n {
            for x in 0..n {
                let a = first + y * (n + 1) + x;
                raw.triangles.push([a, a + 1, a + n + 2]);
                raw.triangles.push([a, a + n + 2, a + n + 1]);
                raw.face_submesh.extend([SubmeshId(submesh); 2]);
            }
        }
    }
    let attributes = AttributeSet {
        normals: true,
        tangents: true,
        uv0: true,
        uv1: true,
        colors: true,
        skin: true,
        importance: false,
    };
    let submesh =
        |name: &str, material| Submesh { name: name.into(), material, attributes, source_triangles: 2 * n * n };
    raw.submeshes = vec![submesh("left", Some(MaterialId(0))), submesh("right", Some(MaterialId(1)))];
    (raw.normals, raw.tangents, raw.uv0, raw.uv1) = (Some(normals), Some(tangents), Some(uv0), Some(uv1));
    (raw.colors, raw.joints, raw.weights) = (Some(colors), Some(joints), Some(weights));
    Mesh::new(raw).expect("valid")
}

/// The mesh without the faces of submesh 1, which keeps its place.
fn without_second(mesh: &Mesh) -> Mesh {
    let mut raw = mesh.clone().into_raw();
    let kept = raw.face_submesh.partition_point(|s| s.0 == 0);
    raw.triangles.truncate(kept);
    raw.face_submesh.truncate(kept);
    Mesh::new(raw).expect("valid")
}

fn levels() -> LodSet {
    let coarse = grid(2);
    let meshes = [grid(6), coarse.clone(), without_second(&coarse)];
    let level = |(mesh, error)| {
        let mut raw = Mesh::into_raw(mesh);
        raw.submeshes.iter_mut().for_each(|s| s.source_triangles = 72);
        raw.points.clear();
        Level { mesh: Mesh::new(raw).expect("valid"), error, quadrics: Vec::new() }
    };
    let levels = meshes.into_iter().zip([0.0, 0.01, 0.25]).map(level).collect();
    LodSet {
        levels,
        layout: Some(UvLayout { size: 256, padding: 4, chart_count: 2, sheets: 1 }),
        source_triangles: 144,
    }
}

fn picture(seed: u8, width: u32, height: u32) -> Raster {
    let texels = (0..width * height).map(|i| [i as u8 ^ seed, (i / 3) as u8, 128, 200 + (i % 56) as u8]).collect();
    Raster { width, height, texels }
}

/// Two materials that share image 0 as colour and as data; image 2 is unused.
fn materials() -> (MaterialSet, Vec<Raster>) {
    let info = |name: &str| ImageInfo { name: name.into(), format: ImageFormat::Raster, hash: [0; 32] };
    let textures = (0..2).map(|image| Texture { image: ImageId(image), sampler: Default::default() }).collect();
    let used = |texture, uv_set| Some(TextureRef { texture: TextureId(texture), uv_set });
    let first = Material {
        name: "first".into(),
        base_color: used(0, 0),
        metallic_roughness: used(0, 0),
        occlusion: used(0, 1),
        normal: used(1, 0),
        ..Material::default()
    };
    let second = Material {
        name: "second".into(),
        emissive: used(1, 1),
        emissive_factor: [2.0, 1.0, 0.5],
        alpha_mode: AlphaMode::Mask,
        double_sided: true,
        ..Material::default()
    };
    let set = MaterialSet {
        materials: vec![first, second],
        textures,
        images: vec![info("shared"), info("bumps"), info("unused")],
        extras: Vec::new(),
    };
    (set, vec![picture(0, 300, 200), picture(9, 17, 5), picture(1, 1, 1)])
}

fn packed(levels: &LodSet) -> (Vec<u8>, PackReport) {
    let (set, rasters) = materials();
    let images = |image: ImageId| Ok(Picture::from(rasters[image.index()].clone()));
    let provenance = Provenance { tool: "kiln test".into(), ..Provenance::default() };
    pack(levels, &set, &images, &provenance, &PackOptions::default(), &Continuous::default()).expect("packs")
}

#[test]
fn geometry_comes_back_bit_for_bit() {
    let before = levels();
    let (bytes, report) = packed(&before);
    assert!(check(&bytes).is_sound());
    let (after, _, _) = unpack(&bytes).expect("sound");
    assert_eq!(after, before);
    assert_eq!(report.levels.iter().map(|l| l.triangles).collect::<Vec<_>>(), [144, 16, 8]);
    assert_eq!(report.bytes, bytes.len() as u64);
}

#[test]
fn packing_what_was_unpacked_gives_the_same_bytes() {
    let (bytes, _) = packed(&levels());
    let (levels, set, rasters) = unpack(&bytes).expect("sound");
    let images = |image: ImageId| Ok(Picture::from(rasters[image.index()].clone()));
    let provenance = Provenance { tool: "kiln test".into(), ..Provenance::default() };
    let (again, _) =
        pack(&levels, &set, &images, &provenance, &PackOptions::default(), &Continuous::default()).expect("packs");
    assert!(bytes == again, "{} and {} bytes differ", bytes.len(), again.len());
}

#[test]
fn two_runs_give_the_same_bytes() {
    assert!(packed(&levels()).0 == packed(&levels()).0);
}

#[test]
fn an_image_is_stored_once_for_each_way_of_averaging_it() {
    let (bytes, report) = packed(&levels());
    let report = (report, inspect(&bytes).expect("sound"));
    let roles: Vec<_> = report.1.textures.iter().map(|t| (t.name.as_str(), t.roles.clone(), t.format)).collect();
    assert_eq!(
        roles,
        [
            ("shared", vec!["base-color"], "rgba8-srgb"),
            ("shared", vec!["metallic-roughness", "occlusion"], "rgba8-unorm"),
            ("bumps", vec!["emissive"], "rgba8-srgb"),
            ("bumps", vec!["normal"], "rgba8-unorm"),
        ]
    );
    assert_eq!(report.1.textures[1].channels, ["occlusion", "roughness", "metallic", "unused"]);
    assert_eq!(report.0.notes, ["1 images that no material uses were left out"]);
    // The chain of a 300 x 200 picture: 300, 150, 75, 37, 18, 9, 4, 2, 1.
    assert_eq!(report.1.textures[0].mips, 9);
}

#[test]
fn materials_and_pictures_come_back() {
    let (bytes, _) = packed(&levels());
    let (_, set, rasters) = unpack(&bytes).expect("sound");
    let (before, pictures) = materials();
    for (material, old) in set.materials.iter().zip(&before.materials) {
        for role in MapRole::ALL {
            let new = material.map(role).map(|t| (&rasters[set.textures[t.texture.index()].image.index()], t.uv_set));
            let old = old.map(role).map(|t| (&pictures[before.textures[t.texture.index()].image.index()], t.uv_set));
            assert_eq!(new, old, "{}", role.name());
        }
        let mut material = material.clone();
        MapRole::ALL.iter().for_each(|role| *material.map_mut(*role) = old.map(*role));
        assert_eq!(material, *old);
    }
}

#[test]
fn the_coarsest_level_needs_the_least_of_the_file() {
    let (bytes, _) = packed(&levels());
    let report = inspect(&bytes).expect("sound");
    let prefixes: Vec<u64> = report.levels.iter().map(|level| level.prefix_bytes).collect();
    assert!(prefixes[2] < prefixes[1] && prefixes[1] < prefixes[0], "{prefixes:?}");
    // The second material's submesh is gone at level 2, so its texture's tail is not needed there.
    let aligned = kiln_format::AlignedBytes::copy_of(&bytes[..prefixes[2] as usize]);
    let container = Container::open_prefix(&aligned).expect("tables are whole");
    assert_eq!([0, 1, 2].map(|lod| container.level(lod).is_some()), [false, false, true]);
    assert_eq!(
        [0, 1, 2, 3].map(|t| container.mip(t, container.mips(t).len() - 1).is_some()),
        [true, true, false, true]
    );
}

#[test]
fn what_cannot_be_packed_is_refused_with_its_place() {
    let (set, rasters) = materials();
    let images = |image: ImageId| Ok(Picture::from(rasters[image.index()].clone()));
    let refused = |levels: &LodSet, set: &MaterialSet| {
        let done = pack(levels, set, &images, &Provenance::default(), &PackOptions::default(), &Continuous::default());
        done.expect_err("invalid").to_string()
    };
    let mut bad = set.clone();
    bad.materials[1].emissive = Some(TextureRef { texture: TextureId(9), uv_set: 0 });
    assert_eq!(refused(&levels(), &bad), "materials[1].emissive: expected an index below 2, found 9");
    let mut bad = set.clone();
    bad.materials.pop();
    assert_eq!(refused(&levels(), &bad), "submeshes[1].material: expected an index below 1, found 1");
    assert!(refused(&LodSet::default(), &set).contains("no level"));
    let mut bad = set.clone();
    bad.materials[0].roughness_factor = f32::NAN;
    assert!(refused(&levels(), &bad).contains("materials[0].factors"));
    let failing = |_: ImageId| Err("the file is gone".to_string());
    let done = pack(&levels(), &set, &failing, &Provenance::default(), &PackOptions::default(), &Continuous::default());
    assert_eq!(done.expect_err("no picture").to_string(), "image 0 (\"shared\"): the file is gone");
}

/// The JSON chunk of a GLB whose lengths are right.
fn glb_json(glb: &[u8]) -> serde_json::Value {
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().expect("4 bytes")) as usize;
    assert_eq!((&glb[..4], word(4), word(8)), (&b"glTF"[..], 2, glb.len()));
    let json = word(12);
    assert_eq!(word(20 + json) + 28 + json, glb.len());
    serde_json::from_slice(&glb[20..20 + json]).expect("JSON")
}

#[test]
fn an_export_of_all_levels_binds_them_with_msft_lod() {
    let (bytes, _) = packed(&levels());
    let (glb, report) = export_container_glb(&bytes, ExportLevels::All).expect("exports");
    let json = glb_json(&glb);
    assert_eq!(json["nodes"][0]["extensions"]["MSFT_lod"]["ids"], serde_json::json!([1, 2]));
    let coverage: Vec<f64> =
        serde_json::from_value(json["nodes"][0]["extras"]["MSFT_screencoverage"].clone()).expect("numbers");
    assert!(coverage.len() == 3 && coverage.is_sorted_by(|a, b| a >= b) && coverage[2] == 0.0, "{coverage:?}");
    assert_eq!(json["scenes"][0]["nodes"], serde_json::json!([0]));
    // Level 2 has lost a submesh: one primitive less.
    let primitives: Vec<usize> =
        (0..3).map(|lod| json["meshes"][lod]["primitives"].as_array().expect("list").len()).collect();
    assert_eq!((primitives, report.empty_submeshes), (vec![2, 2, 1], 1));
    assert_eq!(json["images"].as_array().expect("list").len(), 4);
}

#[test]
fn an_export_repairs_what_gltf_forbids() {
    let mut raw = grid(2).into_raw();
    raw.normals.as_mut().expect("has")[0] = Vec3::ZERO;
    raw.normals.as_mut().expect("has")[1] = Vec3::new(0.0, 0.0, 1e-30);
    raw.tangents.as_mut().expect("has")[0] = Vec4::new(0.0, 0.0, 0.0, 0.5);
    raw.colors.as_mut().expect("has")[2] = Vec4::new(3.0, -1.0, 0.0, 1.0);
    let set = LodSet {
        levels: vec![Level { mesh: Mesh::new(raw).expect("valid"), ..Level::default() }],
        ..LodSet::default()
    };
    let (materials, rasters) = materials();
    let (_, report) =
        export_glb(&set, &materials, &rasters.iter().collect::<Vec<_>>(), ExportLevels::One(0)).expect("exports");
    assert_eq!((report.replaced_normals, report.replaced_tangents, report.clamped), (1, 1, 1));
    assert_eq!(report.notes, ["joints and weights were left out: there is no skeleton"]);
}

#[test]
fn a_level_that_is_not_there_is_refused() {
    let (bytes, _) = packed(&levels());
    let error = export_container_glb(&bytes, ExportLevels::One(3)).expect_err("there are three");
    assert_eq!(error.to_string(), "no level 3: there are 3, numbered from 0 (finest)");
}

#[test]
fn damaged_bytes_are_refused_everywhere() {
    let (mut bytes, _) = packed(&levels());
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    assert!(matches!(unpack(&bytes), Err(PackError::Format(_))));
    assert!(matches!(inspect(&bytes), Err(PackError::Format(_))));
    assert!(matches!(export_container_glb(&bytes, ExportLevels::All), Err(PackError::Format(_))));
}

/// An export read back by the importer has the same triangles and positions, submesh by submesh.
#[test]
fn an_export_is_read_back_by_the_importer() {
    struct One(Vec<u8>);
    impl kiln_asset::import::Files for One {
        fn read(&self, _: &str) -> std::io::Result<Vec<u8>> {
            Ok(self.0.clone())
        }
    }
    let (bytes, _) = packed(&levels());
    let (before, ..) = unpack(&bytes).expect("sound");
    for lod in 0..3 {
        let (glb, _) = export_container_glb(&bytes, ExportLevels::One(lod)).expect("exports");
        let limits = kiln_asset::import::ImportLimits::default();
        let (asset, _) = kiln_asset::import::import(&One(glb), "level.glb", &limits).expect("imports");
        let corners = |mesh: &Mesh| -> Vec<[Vec3; 3]> {
            (0..mesh.face_count()).map(|f| mesh.face_positions(kiln_asset::FaceId(f as u32))).collect()
        };
        assert_eq!(corners(&asset.mesh), corners(&before.levels[lod].mesh), "level {lod}");
    }
}
