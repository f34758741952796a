//! The GPU and its CPU twin bake the same maps, end to end.

use std::f64::consts::PI;
use std::path::Path;

use kiln_asset::{MapRole, Raster};

use crate::space::{SMALL, Space, corpus, needs, repository, small};

/// The object-space normal map of a pipeline's container.
fn normal_map(model: &Path, backend: &str) -> Raster {
    let space = Space::new();
    let text = SMALL.replace("model.glb", &model.display().to_string());
    let text = text.replace("dilation = 2", "dilation = 0\nspace = \"object\"").replace("256", "512");
    space.write("pipeline.toml", text);
    let ran = space.run(["build", "pipeline.toml", "--backend", backend]);
    assert!(ran.code < 2, "{ran:?}");
    let (_, materials, rasters) = kiln_pack::unpack(&space.read("out/model.kiln")).unwrap();
    let texture = materials.materials.iter().find_map(|m| m.map(MapRole::Normal)).unwrap();
    rasters[materials.textures[texture.texture.index()].image.index()].clone()
}

fn direction(texel: [u8; 4]) -> [f64; 3] {
    [0, 1, 2].map(|k| f64::from(texel[k]) / 127.5 - 1.0)
}

/// Angles in degrees between the texels of two maps.
fn angles(a: &Raster, b: &Raster) -> Vec<f64> {
    assert_eq!((a.width, a.height), (b.width, b.height));
    let angle = |a: [f64; 3], b: [f64; 3]| {
        let dot: f64 = (0..3).map(|k| a[k] * b[k]).sum();
        let lengths = [a, b].map(|v| v.iter().map(|c| c * c).sum::<f64>().sqrt());
        (dot / (lengths[0] * lengths[1])).clamp(-1.0, 1.0).acos() * 180.0 / PI
    };
    let mut angles: Vec<f64> =
        a.texels.iter().zip(&b.texels).map(|(a, b)| angle(direction(*a), direction(*b))).collect();
    angles.sort_by(f64::total_cmp);
    angles
}

fn agree(model: &Path) {
    let (cpu, gpu) = (normal_map(model, "cpu"), normal_map(model, "gpu"));
    let angles = angles(&cpu, &gpu);
    let mean = angles.iter().sum::<f64>() / angles.len() as f64;
    let p99 = angles[angles.len() * 99 / 100];
    eprintln!("{}: CPU against GPU, mean {mean:.4} degrees, 99th percentile {p99:.3}", model.display());
    assert!(mean < 0.5 && p99 < 3.0, "{}: mean {mean}, 99th percentile {p99} degrees", model.display());
}

fn has_vulkan() -> bool {
    needs(kiln_gpu::Gpu::open(true).ok(), "a Vulkan adapter").is_some()
}

#[test]
fn gpu_and_cpu_agree_on_the_pot() {
    if has_vulkan() {
        agree(&repository("fixtures/pot.glb").canonicalize().unwrap());
    }
}

#[test]
fn gpu_and_cpu_agree_on_the_sphere() {
    if has_vulkan() {
        agree(&repository("fixtures/sphere.glb").canonicalize().unwrap());
    }
}

#[test]
fn gpu_and_cpu_agree_on_spot() {
    if let (true, Some(model)) = (has_vulkan(), corpus("gltf/Spot.glb")) {
        agree(&model);
    }
}

/// Every chart of the cube has one colour, its side's normal in object space; `coverage` says where charts lie.
#[test]
fn no_mip_down_to_an_eighth_shows_a_foreign_charts_colour() {
    let space = small("cube.glb");
    let maps = "space = \"object\"\nmaps = [\"normal\", \"coverage\"]\ndilation = 8";
    let text =
        SMALL.replace("dilation = 2", maps).replace("padding = 4", "padding = 16").replace("size = 256", "size = 512");
    space.write("pipeline.toml", text.replace("keep = 0.25", "keep = 1.0").replace(", { keep = 0.1 }", ""));
    space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(0);
    let bytes = kiln_format::AlignedBytes::copy_of(&space.read("out/model.kiln"));
    let container = kiln_format::Container::open(&bytes).unwrap();
    let (_, _, pictures) = kiln_pack::unpack_pictures(&bytes).unwrap();
    let size = 512;
    let mip = |k: usize| -> Vec<[u8; 4]> {
        container.mip(0, k).unwrap().chunks_exact(4).map(|t| [t[0], t[1], t[2], t[3]]).collect()
    };
    let colours = mip(0);
    let kiln_pack::Picture::Deep(coverage) = &pictures[1] else { panic!("shares have 16 bits") };
    let inside: Vec<bool> = coverage.texels.iter().map(|t| t[0] > 0.0).collect();
    let mut kinds: Vec<[u8; 4]> = (0..size * size).filter(|t| inside[*t]).map(|t| colours[t]).collect();
    kinds.sort_unstable();
    kinds.dedup();
    assert_eq!(kinds.len(), 6, "{kinds:?}");
    for level in 1..=3 {
        let (block, side) = (1 << level, size >> level);
        let texels = mip(level);
        let mut seen = 0;
        for (index, texel) in texels.iter().enumerate() {
            let (x, y) = (index % side * block, index / side * block);
            let places = (0..block * block).map(|k| (y + k / block) * size + x + k % block);
            for place in places.filter(|place| inside[*place]) {
                let off = (0..3).map(|c| texel[c].abs_diff(colours[place][c])).max().unwrap();
                assert!(off <= 1, "mip {level}: {texel:?} where the chart has {:?}", colours[place]);
                seen += 1;
            }
        }
        assert!(seen > size * size / 4, "{seen} texels looked at");
    }
}

#[test]
fn a_cage_is_a_model_of_its_own_that_only_the_bake_depends_on() {
    let space = small("cube.glb");
    space.write("cages/model.glb", std::fs::read(repository("fixtures/sphere.glb")).unwrap());
    let with = SMALL.replace("dilation = 2", "dilation = 2\ncage = \"cages/{name}.glb\"");
    space.write("pipeline.toml", &with);
    let args = ["build", "pipeline.toml", "--backend", "cpu", "--json"];
    let ran = |space: &Space| -> Vec<String> {
        let report = space.run(args).expect(0).json();
        let stages = report["assets"][0]["stages"].as_array().unwrap().iter();
        let ran = stages.filter(|s| s["state"] == "ran").map(|s| s["stage"].as_str().unwrap().to_owned());
        ran.collect()
    };
    assert!(ran(&space).contains(&"bake, cage".to_owned()));
    space.write("cages/model.glb", std::fs::read(repository("fixtures/cube.glb")).unwrap());
    let again = ran(&space);
    // The cube was imported before, as the model: that is not done again. Nothing else looks at the cage, and the same bake follows.
    assert!(again.contains(&"bake".to_owned()), "{again:?}");
    assert!(again.iter().all(|s| ["bake", "pack"].contains(&s.as_str())), "{again:?}");
    // A cage that is not there is named, and the last good container stays.
    let container = space.read("out/model.kiln");
    std::fs::remove_file(space.path("cages/model.glb")).unwrap();
    let failed = space.run(args);
    assert!(failed.code != 0 && format!("{failed:?}").contains("cages/model.glb"), "{failed:?}");
    assert_eq!(space.read("out/model.kiln"), container);
}
