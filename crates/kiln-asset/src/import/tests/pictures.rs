//! TIFF, TGA and EXR as textures: values, limits, damage, and what EXR means in which slot.

use std::io::Cursor;

use ::exr::prelude::*;
use ::image::{DynamicImage, ImageBuffer, Luma, Rgb, RgbaImage};
use proptest::prelude::{ProptestConfig, any, prop_assert_eq, proptest};

use super::*;

fn rgba() -> RgbaImage {
    RgbaImage::from_fn(5, 3, |x, y| ::image::Rgba([x as u8 * 40, y as u8 * 60, 7, 200 + x as u8]))
}

fn encoded(picture: &DynamicImage, format: ::image::ImageFormat) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    picture.write_to(&mut out, format).unwrap();
    out.into_inner()
}

fn tiff() -> Vec<u8> {
    encoded(&rgba().into(), ::image::ImageFormat::Tiff)
}

fn tga() -> Vec<u8> {
    encoded(&rgba().into(), ::image::ImageFormat::Tga)
}

/// Channels by name, 4 x 2 texels, channel `k` of texel `i` by `value(k, i)`.
fn exr_of(names: &[&str], half: bool, tiles: bool, value: impl Fn(usize, usize) -> f32) -> Vec<u8> {
    let channel = |(k, name): (usize, &&str)| {
        let values = (0..8).map(|i| value(k, i));
        let samples = match half {
            true => FlatSamples::F16(values.map(f16::from_f32).collect()),
            false => FlatSamples::F32(values.collect()),
        };
        AnyChannel::new(*name, samples)
    };
    let channels: SmallVec<[AnyChannel<FlatSamples>; 4]> = names.iter().enumerate().map(channel).collect();
    let blocks = if tiles { Blocks::Tiles(Vec2(3, 3)) } else { Blocks::ScanLines };
    let encoding = Encoding { compression: Compression::ZIP1, blocks, line_order: LineOrder::Increasing };
    let layer = Layer::new((4, 2), LayerAttributes::default(), encoding, AnyChannels::sort(channels));
    let attributes = ::exr::meta::header::ImageAttributes::new(IntegerBounds::from_dimensions((4, 2)));
    let mut out = Cursor::new(Vec::new());
    Image::empty(attributes).with_layer(layer).write().non_parallel().to_buffered(&mut out).unwrap();
    out.into_inner()
}

/// Light of codes 0, 36, .. of each channel, plus values past both ends.
fn light() -> Vec<u8> {
    exr_of(&["R", "G", "B", "A"], true, false, |k, i| [i as f32 / 8.0, 0.5, i as f32 * 20.0 - 60.0, 0.25][k])
}

#[test]
fn tiff_and_tga_hold_what_their_writers_put_in() {
    let limits = ImageLimits::default();
    let texels: Vec<[u8; 4]> = rgba().pixels().map(|p| p.0).collect();
    for (name, bytes, format) in [("a.tif", tiff(), ImageFormat::Tiff), ("b.TGA", tga(), ImageFormat::Tga)] {
        assert_eq!(image_format_of_file(name, &bytes), Some(format));
        assert_eq!(image_size(format, &bytes), Some((5, 3)), "{name}");
        assert_eq!(decode_image(format, &bytes, &limits).unwrap().texels, texels, "{name}");
    }
    assert_eq!(image_format(&tga()), None);
    let deep: ImageBuffer<Rgb<u16>, Vec<u16>> =
        ImageBuffer::from_fn(3, 2, |x, y| Rgb([x as u16 * 257, 65_535, y as u16 * 514]));
    let deep = encoded(&deep.into(), ::image::ImageFormat::Tiff);
    assert_eq!(decode_image(ImageFormat::Tiff, &deep, &limits).unwrap().texels[5], [2, 255, 2, 255]);
    let grey: ImageBuffer<Luma<u8>, Vec<u8>> = ImageBuffer::from_fn(2, 1, |x, _| Luma([9 + x as u8]));
    let grey = encoded(&grey.into(), ::image::ImageFormat::Tga);
    assert_eq!(decode_image(ImageFormat::Tga, &grey, &limits).unwrap().texels, [[9, 9, 9, 255], [10, 10, 10, 255]]);
}

#[test]
fn exr_is_encoded_as_colours_are_or_taken_as_it_is() {
    let limits = ImageLimits::default();
    let bytes = light();
    assert_eq!(image_format(&bytes), Some(ImageFormat::Exr));
    assert_eq!(image_size(ImageFormat::Exr, &bytes), Some((4, 2)));
    let colour = decode_image(ImageFormat::Exr, &bytes, &limits).unwrap().texels;
    let data = decode_image(ImageFormat::ExrLinear, &bytes, &limits).unwrap().texels;
    // Light of one half is code 188 on the curve of sRGB, 128 without it; alpha has no curve; the ends are clamped.
    assert_eq!((colour[4][..2].to_vec(), data[4][..2].to_vec()), (vec![188, 188], vec![128, 128]));
    assert_eq!((colour[0], data[0]), ([0, 188, 0, 64], [0, 128, 0, 64]));
    assert_eq!((colour[7][2], data[7][2]), (255, 255));
    // Floats in tiles give the same picture as halves in lines.
    let tiles =
        exr_of(&["R", "G", "B", "A"], false, true, |k, i| [i as f32 / 8.0, 0.5, i as f32 * 20.0 - 60.0, 0.25][k]);
    assert_eq!(decode_image(ImageFormat::Exr, &tiles, &limits).unwrap().texels, colour);
    let grey = exr_of(&["Y"], false, false, |_, i| i as f32 / 7.0);
    let grey = decode_image(ImageFormat::ExrLinear, &grey, &limits).unwrap().texels;
    assert_eq!((grey[0], grey[7]), ([0, 0, 0, 255], [255; 4]));
    let nan = exr_of(&["R", "G", "B"], false, false, |k, _| [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][k]);
    assert_eq!(decode_image(ImageFormat::Exr, &nan, &limits).unwrap().texels[0], [0, 255, 0, 255]);
    let odd = exr_of(&["depth"], false, false, |_, _| 1.0);
    let error = decode_image(ImageFormat::Exr, &odd, &limits).unwrap_err().to_string();
    assert!(error.contains("neither channels R, G and B nor Y"), "{error}");
}

#[test]
fn declared_sizes_are_held_against_the_limits_before_decoding() {
    let limits = ImageLimits { max_side: 100, max_texels: 20 };
    let mut wide = tga();
    wide[12..14].copy_from_slice(&5000u16.to_le_bytes());
    let error = decode_image(ImageFormat::Tga, &wide, &limits).unwrap_err().to_string();
    assert!(error.contains("5000 x 3"), "{error}");
    // Twelve channels of 8 texels are more than four of 20.
    let names = ["A", "B", "C", "D", "E", "F", "G", "H", "I", "J", "K", "L"];
    let many = exr_of(&names, true, false, |_, _| 0.0);
    let error = decode_image(ImageFormat::Exr, &many, &limits).unwrap_err().to_string();
    assert!(error.contains("12 channels of 4 x 2"), "{error}");
    // Every place that holds a 4 or a 2 is one that may claim a monster: none may cost memory or a panic.
    for (format, bytes) in [(ImageFormat::Exr, light()), (ImageFormat::Tiff, tiff()), (ImageFormat::Tga, tga())] {
        for at in 0..bytes.len() - 4 {
            for value in [u32::MAX, 0x7FFF_FFFF, 0x0100_0000, 0] {
                let mut broken = bytes.clone();
                broken[at..at + 4].copy_from_slice(&value.to_le_bytes());
                let _ = decode_image(format, &broken, &limits);
            }
        }
    }
}

#[test]
fn every_prefix_is_refused_or_a_picture() {
    let limits = ImageLimits::default();
    for (format, bytes) in [(ImageFormat::Exr, light()), (ImageFormat::Tiff, tiff()), (ImageFormat::Tga, tga())] {
        for end in 0..bytes.len() {
            if let Ok(raster) = decode_image(format, &bytes[..end], &limits) {
                assert_eq!(raster.texels.len() as u64, u64::from(raster.width) * u64::from(raster.height));
            }
        }
        assert!(decode_image(format, &bytes[..bytes.len() / 3], &limits).is_err(), "{}", format.name());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn changed_bytes_give_an_error_or_a_picture_of_the_declared_size(
        which in 0usize..3,
        places in proptest::collection::vec((any::<u16>(), any::<u8>()), 1..6),
    ) {
        let (format, mut bytes) =
            [(ImageFormat::Exr, light()), (ImageFormat::Tiff, tiff()), (ImageFormat::Tga, tga())][which].clone();
        for (at, byte) in places {
            let at = at as usize % bytes.len();
            bytes[at] = byte;
        }
        let limits = ImageLimits { max_side: 4096, max_texels: 1 << 16 };
        if let Ok(raster) = decode_image(format, &bytes, &limits) {
            prop_assert_eq!(Some((raster.width, raster.height)), image_size(format, &bytes));
            prop_assert_eq!(raster.texels.len() as u64, u64::from(raster.width) * u64::from(raster.height));
        }
    }
}

/// A square with five slots; each names one of three EXR files.
fn slots(base_color: usize, metallic_roughness: usize, normal: usize, emissive: usize) -> Asset {
    let mut model = with_attribute("TEXCOORD_0", &floats(&[0.0; 8]), 5126, "VEC2", false);
    model.document["meshes"][0]["primitives"][0]["material"] = json!(0);
    model.document["images"] = json!([{ "uri": "0.exr" }, { "uri": "1.exr" }, { "uri": "2.tga" }]);
    model.document["textures"] = json!([{ "source": 0 }, { "source": 1 }, { "source": 2 }]);
    model.document["materials"] = json!([{
        "pbrMetallicRoughness": {
            "baseColorTexture": { "index": base_color }, "metallicRoughnessTexture": { "index": metallic_roughness }
        },
        "normalTexture": { "index": normal }, "emissiveTexture": { "index": emissive }, "emissiveFactor": [1, 1, 1]
    }]);
    let files = Memory(BTreeMap::from([
        ("m.gltf".to_owned(), model.gltf().to_string().into_bytes()),
        ("0.exr".to_owned(), light()),
        ("1.exr".to_owned(), exr_of(&["Y"], true, true, |_, _| 0.5)),
        ("2.tga".to_owned(), tga()),
    ]));
    import(&files, "m.gltf", &ImportLimits::default()).unwrap().0
}

#[test]
fn an_exr_means_what_its_slot_says_and_two_things_if_it_must() {
    use crate::material::MapRole;
    let format = |asset: &Asset, role| {
        let texture = asset.materials.materials[0].map(role).unwrap().texture;
        let image = asset.materials.textures[texture.index()].image.index();
        (asset.materials.images[image].format, asset.images[image].clone())
    };
    let asset = slots(0, 1, 2, 0);
    assert_eq!(asset.images.len(), 3);
    assert_eq!(format(&asset, MapRole::BaseColor).0, ImageFormat::Exr);
    assert_eq!(format(&asset, MapRole::MetallicRoughness).0, ImageFormat::ExrLinear);
    assert_eq!(format(&asset, MapRole::Normal).0, ImageFormat::Tga);
    let asset = slots(0, 0, 0, 1);
    assert_eq!((asset.images.len(), asset.materials.images.len()), (3, 3));
    let [colour, data] = [MapRole::BaseColor, MapRole::Normal].map(|role| format(&asset, role));
    assert_eq!((colour.0, data.0), (ImageFormat::Exr, ImageFormat::ExrLinear));
    assert_eq!(colour.1, data.1);
    assert_eq!(format(&asset, MapRole::MetallicRoughness), data);
    assert_eq!(format(&asset, MapRole::Emissive).0, ImageFormat::Exr);
    // The set is one that the cache reads back.
    crate::MaterialSet::from_blob(&asset.materials.to_blob()).unwrap();
}

#[test]
fn an_obj_names_tiff_tga_and_exr_too() {
    let obj = "mtllib model.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n";
    let mtl = "newmtl a\nmap_Kd wood.tga\nmap_Ke glow.exr\nnorm bump.tif\nmap_Pr glow.exr\n";
    let files = Memory(BTreeMap::from([
        ("m.obj".to_owned(), obj.as_bytes().to_vec()),
        ("model.mtl".to_owned(), mtl.as_bytes().to_vec()),
        ("wood.tga".to_owned(), tga()),
        ("glow.exr".to_owned(), light()),
        ("bump.tif".to_owned(), tiff()),
    ]));
    let (asset, report) = import(&files, "m.obj", &ImportLimits::default()).unwrap();
    let formats: Vec<&str> = asset.materials.images.iter().map(|i| i.format.name()).collect();
    assert!(formats.contains(&"tga") && formats.contains(&"exr") && formats.contains(&"tiff"), "{formats:?}");
    assert!(report.images.iter().any(|i| i.format == "tga" && (i.width, i.height) == (5, 3)));
    let broken = Memory(BTreeMap::from([
        ("m.obj".to_owned(), obj.as_bytes().to_vec()),
        ("model.mtl".to_owned(), b"newmtl a\nmap_Kd wood.tga\n".to_vec()),
        ("wood.tga".to_owned(), b"no picture at all, but long enough".to_vec()),
    ]));
    assert_eq!(defect_paths(import(&broken, "m.obj", &ImportLimits::default())), ["model.mtl:2"]);
}

/// A Photoshop file of 3 x 2 texels, RGB in planes: one of the formats that only OpenImageIO reads.
fn psd() -> Vec<u8> {
    let mut out = b"8BPS\0\x01\0\0\0\0\0\0\0\x03\0\0\0\x02\0\0\0\x03\0\x08\0\x03".to_vec();
    out.extend([0; 14]);
    out.extend((0..18).map(|i| i * 10));
    out
}

#[test]
fn a_psd_is_a_texture_where_the_build_has_openimageio_and_else_refused() {
    let mut model = with_attribute("TEXCOORD_0", &floats(&[0.0; 8]), 5126, "VEC2", false);
    model.document["meshes"][0]["primitives"][0]["material"] = json!(0);
    model.document["images"] = json!([{ "uri": "paint.psd" }]);
    model.document["textures"] = json!([{ "source": 0 }]);
    model.document["materials"] = json!([{ "emissiveTexture": { "index": 0 } }]);
    let files = Memory(BTreeMap::from([
        ("m.gltf".to_owned(), model.gltf().to_string().into_bytes()),
        ("paint.psd".to_owned(), psd()),
    ]));
    let outcome = import(&files, "m.gltf", &ImportLimits::default());
    if kiln_oiio::version().is_none() {
        assert_eq!(defect_paths(outcome), ["images[0]"]);
        return;
    }
    let asset = outcome.unwrap().0;
    assert_eq!(asset.materials.images[0].format, ImageFormat::System);
    let raster = decode_image(ImageFormat::System, &asset.images[0], &ImageLimits::default()).unwrap();
    assert_eq!((raster.width, raster.height, raster.texels[1]), (3, 2, [10, 70, 130, 255]));
    let small = ImageLimits { max_side: 2, ..ImageLimits::default() };
    assert!(decode_image(ImageFormat::System, &asset.images[0], &small).is_err());
}
