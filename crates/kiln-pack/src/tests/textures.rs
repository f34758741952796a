//! Deep pictures, extras and blocks through a container and back.

use kiln_asset::{DeepRaster, ExtraImage, ExtraMap, Precision};
use kiln_format::TextureFormat;

use super::*;

/// A smooth picture with values beyond [0, 1] where `wide`.
pub(super) fn deep(width: u32, height: u32, precision: Precision, wide: bool) -> DeepRaster {
    let scale = if wide { 40.0 } else { 1.0 };
    let texel = |i: u32| {
        let (x, y) = ((i % width) as f32 / width as f32, (i / width) as f32 / height as f32);
        [(x - 0.2 * wide as u32 as f32) * scale, y, x * y * scale, 1.0]
    };
    DeepRaster { width, height, precision, texels: (0..width * height).map(texel).collect() }
}

/// Normals around +Z as `(n + 1) / 2`.
pub(super) fn bumps(width: u32, height: u32) -> Raster {
    let texel = |i: u32| {
        let (x, y) = ((i % width) as f32 * 0.21, (i / width) as f32 * 0.17);
        let n = Vec3::new(0.5 * x.sin(), 0.5 * y.cos(), 1.0).normalize() * 0.5 + 0.5;
        [n.x, n.y, n.z, 1.0].map(|c| (c * 255.0 + 0.5) as u8)
    };
    Raster { width, height, texels: (0..width * height).map(texel).collect() }
}

/// Base colour in half floats, normals in 16 bits, metallic-roughness in bytes, and two extras on two sheets.
pub(super) fn materials() -> (MaterialSet, Vec<Picture>) {
    let info = |name: &str, format| ImageInfo { name: name.into(), format, hash: [0; 32] };
    let textures = (0..3).map(|image| Texture { image: ImageId(image), sampler: Default::default() }).collect();
    let used = |texture| Some(TextureRef { texture: TextureId(texture), uv_set: 0 });
    let material = |name: &str| Material {
        name: name.into(),
        base_color: used(0),
        normal: used(1),
        metallic_roughness: used(2),
        ..Material::default()
    };
    let set = MaterialSet {
        materials: vec![material("a"), material("b")],
        textures,
        images: vec![
            info("light", ImageFormat::Deep),
            info("fine", ImageFormat::Deep),
            info("orm", ImageFormat::Raster),
            info("height", ImageFormat::Deep),
            info("ids", ImageFormat::Raster),
        ],
        extras: vec![
            ExtraImage { kind: ExtraMap::Height, sheet: 0, image: ImageId(3) },
            ExtraImage { kind: ExtraMap::ObjectId, sheet: 1, image: ImageId(4) },
        ],
    };
    let pictures = vec![
        deep(70, 33, Precision::Half, true).into(),
        deep(40, 40, Precision::Unorm16, false).into(),
        picture(3, 20, 20).into(),
        deep(31, 9, Precision::Float, true).into(),
        picture(5, 16, 8).into(),
    ];
    (set, pictures)
}

pub(super) fn packed(set: &MaterialSet, pictures: &[Picture], options: &PackOptions) -> (Vec<u8>, PackReport) {
    let mut levels = levels();
    levels.layout = Some(UvLayout { size: 256, padding: 4, chart_count: 2, sheets: 2 });
    let images = |image: ImageId| Ok(pictures[image.index()].clone());
    pack(&levels, set, &images, &Provenance::default(), options, &Continuous::default()).expect("packs")
}

#[test]
fn deep_pictures_and_extras_come_back_as_their_precision_holds_them() {
    let (set, pictures) = materials();
    let (bytes, report) = packed(&set, &pictures, &PackOptions::default());
    assert!(check(&bytes).is_sound());
    assert!(report.notes.is_empty(), "{:?}", report.notes);
    let (levels, back, found) = unpack_pictures(&bytes).expect("sound");
    assert_eq!(levels.layout.expect("has one").sheets, 2);
    let kinds: Vec<_> = back.extras.iter().map(|extra| (extra.kind, extra.sheet)).collect();
    assert_eq!(kinds, [(ExtraMap::Height, 0), (ExtraMap::ObjectId, 1)]);
    for (a, b) in found.iter().zip(&pictures) {
        match (a, b) {
            (Picture::Plain(a), Picture::Plain(b)) => assert_eq!(a, b),
            (Picture::Deep(a), Picture::Deep(b)) => {
                assert_eq!((a.width, a.height, a.precision), (b.width, b.height, b.precision));
                let expected: Vec<_> = b.texels.iter().map(|t| crate::picture::rounded(*t, b.precision)).collect();
                assert_eq!(a.texels, expected);
            }
            _ => panic!("depth changed"),
        }
    }
    let formats: Vec<_> = inspect(&bytes).expect("sound").textures.iter().map(|t| (t.format, t.extra)).collect();
    let expected = [
        ("rgba16-float", None),
        ("rgba16-unorm", None),
        ("rgba8-unorm", None),
        ("rgba32-float", Some("height")),
        ("rgba8-unorm", Some("object-id")),
    ];
    assert_eq!(formats, expected);
}

#[test]
fn packing_deep_pictures_that_were_unpacked_gives_the_same_bytes() {
    let (set, pictures) = materials();
    let (bytes, _) = packed(&set, &pictures, &PackOptions::default());
    let (_, set, pictures) = unpack_pictures(&bytes).expect("sound");
    assert!(packed(&set, &pictures, &PackOptions::default()).0 == bytes);
}

#[test]
fn what_is_drawn_is_in_eight_bits_and_without_extras() {
    let (set, pictures) = materials();
    let (bytes, _) = packed(&set, &pictures, &PackOptions::default());
    let (_, back, rasters) = unpack(&bytes).expect("sound");
    assert_eq!((back.extras.len(), rasters.len(), back.images.len()), (0, 3, 3));
    let image = |role| back.textures[back.materials[0].map(role).expect("used").texture.index()].image.index();
    let Picture::Deep(light) = &pictures[0] else { panic!("deep") };
    let texel = light.texels[35];
    let srgb = [texel[0], texel[1], texel[2]].map(kiln_geom::colour::linear_to_srgb);
    let found = rasters[image(MapRole::BaseColor)].texels[35];
    assert!(found[..3].iter().zip(srgb).all(|(a, b)| a.abs_diff(b) <= 1), "{found:?} {srgb:?}");
    let (glb, _) = export_container_glb(&bytes, ExportLevels::One(0)).expect("exports");
    assert_eq!(glb_json(&glb)["images"].as_array().expect("list").len(), 3);
}

#[test]
fn block_compression_is_asked_for_and_leaves_deep_pictures_and_extras_alone() {
    let (mut set, mut pictures) = materials();
    pictures[0] = picture(7, 130, 70).into();
    pictures[1] = bumps(100, 60).into();
    set.images[0].format = ImageFormat::Raster;
    set.images[1].format = ImageFormat::Raster;
    let options = PackOptions { textures: Coding::Bc, ..PackOptions::default() };
    let (bytes, report) = packed(&set, &pictures, &options);
    assert!(check(&bytes).is_sound());
    let (raw, _) = packed(&set, &pictures, &PackOptions::default());
    assert!(bytes.len() < raw.len(), "{} and {}", bytes.len(), raw.len());
    let inspected = inspect(&bytes).expect("sound");
    let formats: Vec<_> = inspected.textures.iter().map(|t| t.format).collect();
    assert_eq!(formats, ["bc7-srgb", "bc5-unorm", "bc7-unorm", "rgba32-float", "rgba8-unorm"]);
    assert_eq!(inspected.textures[1].channels, ["normal-x", "normal-y", "unused", "unused"]);
    assert_eq!(report.notes, [] as [&str; 0]);
    // What comes back is near: 3/255 on the average is far above what blocks of this picture lose.
    let (_, back, rasters) = unpack(&bytes).expect("sound");
    let Picture::Plain(before) = &pictures[1] else { panic!("plain") };
    let normal = back.textures[back.materials[0].normal.expect("used").texture.index()].image.index();
    let off: u64 = rasters[normal]
        .texels
        .iter()
        .zip(&before.texels)
        .flat_map(|(a, b)| (0..3).map(|k| a[k].abs_diff(b[k]) as u64))
        .sum();
    assert!(off < 3 * 3 * 6000, "{off}");
    // Inside out: BC5 cannot say it.
    pictures[1] = Raster::filled(8, 8, [128, 128, 0, 255]).into();
    let (bytes, report) = packed(&set, &pictures, &options);
    assert_eq!(inspect(&bytes).expect("sound").textures[1].format, TextureFormat::Bc7Unorm.name());
    assert_eq!(report.notes.len(), 1);
}

#[test]
fn an_extra_without_an_image_is_refused_with_its_place() {
    let (mut set, pictures) = materials();
    set.extras[1].image = ImageId(17);
    let images = |image: ImageId| Ok(pictures[image.index()].clone());
    let error = pack(&levels(), &set, &images, &Provenance::default(), &PackOptions::default(), &Continuous::default())
        .expect_err("invalid");
    assert_eq!(error.to_string(), "extras[1].image: expected an index below 5, found 17");
}
