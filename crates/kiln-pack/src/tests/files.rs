//! Textures as files, as independent readers see them: the crate `image` for PNG, the crate `ktx2` for KTX2. EXR is read back by
//! the crate that wrote it, and where the build has it (`--features kiln-oiio/oiio`) by OpenImageIO, as is PNG.

use kiln_asset::{DeepRaster, Precision};
use kiln_format::AlignedBytes;

use super::textures::{bumps, materials, packed};
use super::*;
use crate::files::{FileFormat, FloatLevel, texture_file, texture_files, texture_levels};

/// A container of five textures: halves, 16 bits, bytes, an extra of floats on R, an extra of bytes on R.
fn raw() -> AlignedBytes {
    let (set, pictures) = materials();
    AlignedBytes::copy_of(&packed(&set, &pictures, &PackOptions::default()).0)
}

/// The same with a base colour in BC7, normals in BC5, metallic-roughness in BC7.
fn blocks() -> AlignedBytes {
    let (mut set, mut pictures) = materials();
    (pictures[0], pictures[1]) = (picture(7, 130, 70).into(), bumps(100, 60).into());
    set.images.iter_mut().take(2).for_each(|info| info.format = ImageFormat::Raster);
    let options = PackOptions { textures: Coding::Bc, ..PackOptions::default() };
    AlignedBytes::copy_of(&packed(&set, &pictures, &options).0)
}

fn written(container: &Container<'_>, format: FileFormat, mips: bool) -> Vec<Vec<u8>> {
    let files = texture_files(container, Some(format)).expect("fits");
    files.iter().map(|file| texture_file(container, file, mips).expect("is written")).collect()
}

#[test]
fn names_tell_textures_and_formats_apart() {
    let bytes = raw();
    let container = Container::open(&bytes).expect("sound");
    let names: Vec<String> = texture_files(&container, None).expect("any fits").iter().map(|f| f.file_name()).collect();
    assert_eq!(names, ["light.exr", "fine.png", "orm.png", "height.exr", "ids.png"]);
    let error = texture_files(&container, Some(FileFormat::Png)).expect_err("floats").to_string();
    assert!(error.contains("\"light\", \"height\""), "{error}");
}

#[test]
fn png_holds_the_values_of_the_container() {
    let bytes = raw();
    let container = Container::open(&bytes).expect("sound");
    let (_, _, pictures) = unpack_pictures(&bytes).expect("sound");
    for file in texture_files(&container, None).expect("any fits").iter().filter(|f| f.format == FileFormat::Png) {
        let png = texture_file(&container, file, false).expect("is written");
        let read = image::load_from_memory_with_format(&png, image::ImageFormat::Png).expect("a PNG");
        match (&pictures[file.texture], file.stem.as_str()) {
            (Picture::Deep(deep), "fine") => {
                let image::DynamicImage::ImageRgb16(read) = read else { panic!("16-bit RGB: alpha means nothing") };
                let found: Vec<[u16; 3]> = read.pixels().map(|p| p.0).collect();
                let expected: Vec<[u16; 3]> =
                    deep.texels.iter().map(|t| [0, 1, 2].map(|k| (t[k] * 65_535.0).round() as u16)).collect();
                assert_eq!(found, expected);
            }
            (Picture::Plain(raster), "ids") => {
                let image::DynamicImage::ImageLuma8(read) = read else { panic!("one channel") };
                assert!(read.pixels().map(|p| p.0[0]).eq(raster.texels.iter().map(|t| t[0])));
            }
            (Picture::Plain(raster), "orm") => {
                let image::DynamicImage::ImageRgb8(read) = read else { panic!("three channels") };
                assert!(read.pixels().map(|p| p.0).eq(raster.texels.iter().map(|t| [t[0], t[1], t[2]])));
            }
            (_, other) => panic!("{other} is no PNG"),
        }
    }
}

#[test]
fn normals_that_point_down_have_green_turned_and_nothing_else() {
    let bytes = raw();
    let container = Container::open(&bytes).expect("sound");
    for format in [FileFormat::Png, FileFormat::Exr] {
        for mut file in texture_files(&container, None).expect("any fits") {
            file.format = if file.format == FileFormat::Exr { FileFormat::Exr } else { format };
            let up = texture_file(&container, &file, false).expect("is written");
            file.normals_down = true;
            let down = texture_file(&container, &file, false).expect("is written");
            // "fine" is the normal map, of 16 bits.
            assert_eq!(up != down, file.stem == "fine", "{}", file.file_name());
            if file.stem == "fine" && format == FileFormat::Png {
                let rgb = |png: &[u8]| image::load_from_memory(png).expect("a PNG").into_rgb16();
                for (a, b) in rgb(&up).pixels().zip(rgb(&down).pixels()) {
                    assert_eq!([a.0[0], 65_535 - a.0[1], a.0[2]], b.0);
                }
            }
        }
    }
}

#[test]
fn png_of_blocks_is_what_the_blocks_decode_to() {
    let bytes = blocks();
    let container = Container::open(&bytes).expect("sound");
    let (_, _, pictures) = unpack_pictures(&bytes).expect("sound");
    let file = &texture_files(&container, None).expect("any fits")[1];
    let read = image::load_from_memory(&texture_file(&container, file, false).expect("is written")).expect("a PNG");
    let Picture::Plain(normal) = &pictures[1] else { panic!("blocks are plain") };
    // z is put in, so that the file is a normal map for everybody.
    assert!(read.to_rgb8().pixels().map(|p| p.0).eq(normal.texels.iter().map(|t| [t[0], t[1], t[2]])));
    assert!(normal.texels.iter().all(|t| t[2] > 128));
}

#[test]
fn ktx2_holds_every_mip_of_every_format_as_it_lies() {
    for bytes in [raw(), blocks()] {
        let container = Container::open(&bytes).expect("sound");
        for (number, file) in written(&container, FileFormat::Ktx2, false).iter().enumerate() {
            let reader = ktx2::Reader::new(file).expect("a KTX2 file");
            let record = &container.textures()[number];
            let format = kiln_format::TextureFormat::from_number(record.format).expect("registered");
            let header = reader.header();
            let vulkan = match format {
                kiln_format::TextureFormat::Rgba8Unorm => ktx2::Format::R8G8B8A8_UNORM,
                kiln_format::TextureFormat::Rgba8Srgb => ktx2::Format::R8G8B8A8_SRGB,
                kiln_format::TextureFormat::Rgba16Unorm => ktx2::Format::R16G16B16A16_UNORM,
                kiln_format::TextureFormat::Rgba16Float => ktx2::Format::R16G16B16A16_SFLOAT,
                kiln_format::TextureFormat::Rgba32Float => ktx2::Format::R32G32B32A32_SFLOAT,
                kiln_format::TextureFormat::Bc5Unorm => ktx2::Format::BC5_UNORM_BLOCK,
                kiln_format::TextureFormat::Bc7Unorm => ktx2::Format::BC7_UNORM_BLOCK,
                kiln_format::TextureFormat::Bc7Srgb => ktx2::Format::BC7_SRGB_BLOCK,
            };
            assert_eq!(header.format, Some(vulkan));
            assert_eq!((header.pixel_width, header.pixel_height), (record.width, record.height));
            assert_eq!((header.pixel_depth, header.layer_count, header.face_count), (0, 0, 1));
            assert_eq!(header.supercompression_scheme, None);
            assert_eq!(reader.levels().len(), container.mips(number).len());
            for (mip, level) in reader.levels().enumerate() {
                assert_eq!(Some(level.data), container.mip(number, mip), "texture {number} mip {mip}");
            }
            let curve = if format.is_srgb() { ktx2::TransferFunction::SRGB } else { ktx2::TransferFunction::Linear };
            assert_eq!(reader.transfer_function(), Some(curve));
            let basic = reader.basic_dfd().expect("has a descriptor");
            let bits: usize = basic.sample_information.iter().map(|s| s.bit_length.get() as usize).sum();
            assert_eq!(bits as u64, 8 * format.unit_size());
            assert_eq!(u64::from(basic.bytes_planes[0]), format.unit_size());
            assert!(reader.writer().is_some_and(|writer| writer.starts_with("kiln ")));
        }
    }
}

/// Width, height and values of a level's channel.
type ExrLevel = (usize, usize, Vec<f32>);

/// Channels by name, of each level.
fn read_exr(bytes: &[u8]) -> Vec<(String, Vec<ExrLevel>)> {
    use exr::prelude::*;
    let image = read().no_deep_data().all_resolution_levels().all_channels().all_layers().all_attributes();
    let image = image.non_parallel().from_buffered(std::io::Cursor::new(bytes)).expect("an EXR");
    let layer = &image.layer_data[0];
    let levels = |data: &Levels<FlatSamples>| {
        let all: Vec<&FlatSamples> = match data {
            Levels::Singular(one) => vec![one],
            Levels::Mip { level_data, .. } => level_data.iter().collect(),
            Levels::Rip { .. } => panic!("no ripmaps"),
        };
        let size = |k: usize| ((layer.size.0 >> k).max(1), (layer.size.1 >> k).max(1));
        all.iter().enumerate().map(|(k, s)| (size(k).0, size(k).1, s.values_as_f32().collect())).collect()
    };
    layer.channel_data.list.iter().map(|c| (c.name.to_string(), levels(&c.sample_data))).collect()
}

#[test]
fn exr_holds_the_values_of_the_container_and_all_mips_where_asked() {
    for bytes in [raw(), blocks()] {
        let container = Container::open(&bytes).expect("sound");
        for mips in [false, true] {
            for (number, file) in written(&container, FileFormat::Exr, mips).iter().enumerate() {
                let expected: Vec<FloatLevel> = texture_levels(&container, number, mips).expect("at hand");
                for (name, levels) in read_exr(file) {
                    let plane = ["R", "G", "B", "A"].iter().position(|n| *n == name).unwrap_or(0);
                    assert_eq!(levels.len(), expected.len(), "texture {number} {name}");
                    for ((width, height, found), level) in levels.iter().zip(&expected) {
                        assert_eq!((*width, *height), (level.width as usize, level.height as usize));
                        let held = |v: f32| if level.full { v } else { half::f16::from_f32(v).to_f32() };
                        assert!(
                            found.iter().copied().eq(level.texels.iter().map(|t| held(t[plane]))),
                            "{number} {name}"
                        );
                    }
                }
            }
        }
    }
}

#[test]
fn eight_bits_survive_halves() {
    let picture: Picture = Raster { width: 256, height: 1, texels: (0..=255).map(|n| [n, n, n, n]).collect() }.into();
    let (mut set, mut pictures) = materials();
    (pictures[0], pictures[2]) = (picture.clone(), picture);
    set.extras.clear();
    let bytes = AlignedBytes::copy_of(&packed(&set, &pictures, &PackOptions::default()).0);
    let container = Container::open(&bytes).expect("sound");
    let files = written(&container, FileFormat::Exr, false);
    let codes = |file: &[u8], code: fn(f32) -> u8| {
        let red = read_exr(file).into_iter().find(|(name, _)| name == "R").expect("has R").1;
        red[0].2.iter().map(|v| code(*v)).collect::<Vec<u8>>()
    };
    let all: Vec<u8> = (0..=255).collect();
    assert_eq!(codes(&files[0], kiln_geom::colour::linear_to_srgb), all);
    assert_eq!(codes(&files[2], kiln_geom::colour::unorm8), all);
}

#[test]
fn the_same_container_gives_the_same_files() {
    let bytes = raw();
    let container = Container::open(&bytes).expect("sound");
    for format in [FileFormat::Exr, FileFormat::Ktx2] {
        assert!(written(&container, format, true) == written(&container, format, true));
    }
}

#[test]
fn one_float_texture_without_mips_is_one_level_in_tiles() {
    let (mut set, mut pictures) = materials();
    pictures[3] = DeepRaster::filled(100, 70, Precision::Float, [0.25, 0.0, 0.0, 0.0]).into();
    set.extras.truncate(1);
    let options = PackOptions { mips: false, ..PackOptions::default() };
    let bytes = AlignedBytes::copy_of(&packed(&set, &pictures, &options).0);
    let container = Container::open(&bytes).expect("sound");
    let exr = &written(&container, FileFormat::Exr, true)[3];
    let channels = read_exr(exr);
    assert_eq!((channels.len(), channels[0].0.as_str(), channels[0].1.len()), (1, "Y", 1));
    assert!(channels[0].1[0].2.iter().all(|v| *v == 0.25));
}

/// The independent reader of EXR. Values are compared as floats, halves and 16 bits, tiles and every mip.
#[test]
fn openimageio_reads_the_values_of_the_container() {
    if kiln_oiio::version().is_none() {
        eprintln!("skipped: this build is without OpenImageIO");
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    for bytes in [raw(), blocks()] {
        let container = Container::open(&bytes).expect("sound");
        for mips in [false, true] {
            let files = texture_files(&container, Some(FileFormat::Exr)).expect("fits");
            for file in &files {
                let path = folder.path().join(file.file_name());
                std::fs::write(&path, texture_file(&container, file, mips).expect("is written")).expect("writes");
                let levels = texture_levels(&container, file.texture, mips).expect("at hand");
                for (k, level) in levels.iter().enumerate() {
                    let found = kiln_oiio::read_level(&path, k as u32, 4 * level.texels.len()).expect("is read");
                    let channels = found.size.channels as usize;
                    assert_eq!((found.size.width, found.size.height), (level.width, level.height));
                    assert_eq!(found.tile, if mips { 64 } else { 0 });
                    let held = |v: f32| if level.full { v } else { half::f16::from_f32(v).to_f32() };
                    let same = |(values, texel): (&[f32], &[f32; 4])| {
                        values.iter().zip(texel).all(|(found, value)| *found == held(*value))
                    };
                    assert!(found.values.chunks(channels).zip(&level.texels).all(same), "{} {k}", file.stem);
                }
                assert!(kiln_oiio::read_level(&path, levels.len() as u32, 1 << 16).is_err(), "a mip too many");
            }
        }
        let files = texture_files(&container, None).expect("any fits");
        for file in files.iter().filter(|file| file.format == FileFormat::Png) {
            let path = folder.path().join(file.file_name());
            std::fs::write(&path, texture_file(&container, file, false).expect("is written")).expect("writes");
            let (picture, planes) = crate::files::texture_picture(&container, file.texture).expect("at hand");
            let (width, height) = picture.size();
            let found = kiln_oiio::read_level(&path, 0, (width * height * 4) as usize).expect("is read");
            assert_eq!(found.size.channels as usize, planes.count());
            let expected: Vec<f32> = match &picture {
                Picture::Plain(r) => {
                    r.texels.iter().flat_map(|t| &t[..planes.count()]).map(|c| *c as f32 / 255.0).collect()
                }
                Picture::Deep(d) => d.texels.iter().flat_map(|t| &t[..planes.count()]).copied().collect(),
            };
            let near = |(a, b): (&f32, &f32)| (a - b).abs() < 1e-6;
            assert!(
                found.values.len() == expected.len() && found.values.iter().zip(&expected).all(near),
                "{}",
                file.stem
            );
        }
    }
}
