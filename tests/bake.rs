//! The GPU and its CPU twin bake the same maps, end to end.

use std::f64::consts::PI;
use std::path::Path;

use kiln_asset::{MapRole, Raster};

use crate::space::{SMALL, Space, corpus, needs, repository};

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
