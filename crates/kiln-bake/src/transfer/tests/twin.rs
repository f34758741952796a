//! The hit pass on a device against its CPU twin. Tolerance: ids differ on less than 0.5 % of the covered texels (corners
//! that snap to another 1/256 texel), coverage on less than 0.1 %, normals by less than 0.5 degrees in the mean and 3 at
//! the 99th percentile.

use glam::Vec3;
use kiln_gpu::Gpu;

use super::models::*;
use super::*;
use crate::transfer::{Backend, find_hits};

/// A device, software allowed; `None` (said on standard error) where there is none, unless skipping is forbidden.
fn gpu() -> Option<Gpu> {
    match Gpu::open(true) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let required = std::env::var_os("KILN_REQUIRE_ALL").is_some_and(|v| v == "1");
            assert!(!required, "needs a Vulkan adapter: {error}");
            eprintln!("skipped: needs a Vulkan adapter ({error})");
            None
        }
    }
}

#[test]
fn the_device_finds_what_the_cpu_finds_on_three_models() {
    let Some(gpu) = gpu() else { return };
    let models = [
        ("sphere", sphere(96, 48), sphere(12, 8), 0.2),
        ("bumpy torus", torus(120, 60, 0.04), torus(14, 8, 0.0), 0.2),
        (
            "cube and sphere",
            both(sphere(64, 32), cube(Vec3::new(0.8, 0.2, 0.1), 0.5)),
            both(sphere(10, 6), cube(Vec3::new(0.8, 0.2, 0.1), 0.52)),
            0.3,
        ),
    ];
    for (name, high, low, cage) in models {
        let (high, low) = (valid(high), charted(&low));
        // Not a power of two for one of them: texel positions are rounded there.
        let size = if name == "bumpy torus" { 500 } else { 512 };
        let options = normals_only(size, NormalSpace::Object);
        let cpu = find_hits(&high, &low, cage, &options, Backend::Cpu).unwrap();
        let device = find_hits(&high, &low, cage, &options, Backend::Gpu(&gpu)).unwrap();
        assert_eq!(cpu.low_faces, device.low_faces, "{name}: owners");
        assert_eq!(cpu.report.pairs, device.report.pairs, "{name}: pairs");
        let covered = cpu.report.covered as f64;
        assert!(covered > 50_000.0, "{name}: {covered} texels");
        let texels = || cpu.high_faces.iter().zip(&device.high_faces);
        let ids = texels().filter(|(a, b)| a != b).count() as f64;
        let coverage = texels().filter(|(a, b)| (**a == 0) != (**b == 0)).count() as f64;
        let (cpu_normals, device_normals) = (cpu.object_normals(), device.object_normals());
        let mut angles: Vec<f32> = cpu_normals
            .iter()
            .zip(&device_normals)
            .filter(|(a, b)| **a != Vec3::ZERO && **b != Vec3::ZERO)
            .map(|(a, b)| degrees(*a, *b))
            .collect();
        angles.sort_by(f32::total_cmp);
        let mean = angles.iter().map(|a| *a as f64).sum::<f64>() / angles.len() as f64;
        let p99 = angles[angles.len() * 99 / 100];
        eprintln!(
            "{name}: {covered} texels, {} pairs; ids differ on {:.4} %, coverage on {:.4} %; mean {mean:.5}, p99 {p99:.5} degrees",
            cpu.report.pairs,
            100.0 * ids / covered,
            100.0 * coverage / covered,
        );
        assert!(ids < 0.005 * covered, "{name}: {ids} ids of {covered} differ");
        assert!(coverage < 0.001 * covered, "{name}: coverage differs on {coverage} texels");
        assert!(mean < 0.5 && p99 < 3.0, "{name}: mean {mean}, p99 {p99} degrees");
    }
}

#[test]
fn on_a_device_too_the_lower_face_wins_at_equal_distance() {
    let Some(gpu) = gpu() else { return };
    let low = plane(0.0, upright);
    let sheet = || {
        let mut raw = plane(0.1, upright).into_raw();
        (raw.uv0, raw.atlas_uv, raw.tangents) = (None, None, None);
        raw
    };
    let high = valid(both(sheet(), sheet()));
    let hits = find_hits(&high, &low, 0.5, &normals_only(64, NormalSpace::Object), Backend::Gpu(&gpu)).unwrap();
    assert!(hits.high_faces.iter().all(|f| (1..=2).contains(f)), "faces 2 and 3 lie in the same place");
}

#[test]
fn many_small_draws_give_what_one_draw_gives() {
    let Some(gpu) = gpu() else { return };
    let (high, low) = (valid(torus(60, 30, 0.04)), charted(&torus(14, 8, 0.0)));
    let sheet = crate::transfer::frame::Sheet::new(&low, low.atlas_uv.as_ref().unwrap(), 256);
    let search = crate::transfer::candidates::Search::new(&high, &low, 0.2, false, true);
    let draws_of = |most| crate::transfer::gpu::hits_in_draws_of(most, &gpu, &sheet, &search).unwrap();
    let (ids, pairs) = draws_of(1 << 20);
    assert!(pairs > 3000, "{pairs}");
    assert!((ids, pairs) == draws_of(777));
}
