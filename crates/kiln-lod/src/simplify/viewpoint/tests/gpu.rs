//! The passes on a device against their CPU twins. Tolerance: pixel counts none, not even in the order of regions; costs 2^-18 of
//! the sum of what all terms change by, in magnitude.

use std::sync::OnceLock;

use kiln_gpu::Gpu;

use super::*;
use crate::simplify::viewpoint::gpu::DevicePrice;

/// A device, software allowed; `None` (said on standard error) where there is none, unless skipping is forbidden.
fn gpu() -> Option<&'static Gpu> {
    static GPU: OnceLock<Option<Gpu>> = OnceLock::new();
    let open = || match Gpu::open(true) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            let required = std::env::var_os("KILN_REQUIRE_ALL").is_some_and(|v| v == "1");
            assert!(!required, "needs a Vulkan adapter: {error}");
            eprintln!("skipped: needs a Vulkan adapter ({error})");
            None
        }
    };
    GPU.get_or_init(open).as_ref()
}

/// What the terms of all regions in all views change by, each as the sum of the two magnitudes that the device adds.
fn magnitude(how: ViewpointOptions, histogram: &Histogram, pixels: usize, deltas: &[Delta]) -> f64 {
    let views = histogram.views;
    let order = how.alpha - 1.0;
    let power = |log: f64| if order == 0.0 { log } else { (order * log).exp_m1() / order };
    let mut totals = vec![0; histogram.totals.len()];
    let mut changes = vec![0; histogram.counts.len()];
    for delta in deltas {
        totals[delta.region as usize] += delta.count;
        changes[delta.region as usize * views + delta.view as usize] += delta.count;
    }
    let mut sum = 0.0;
    for (at, (n, change)) in histogram.counts.iter().zip(changes).enumerate() {
        let region = at / views;
        let (n0, n1) = (f64::from(*n), f64::from(*n) + f64::from(change));
        let t = f64::from(histogram.totals[region]);
        let (scale, t0, t1) = match how.measure {
            Measure::Entropy => (1.0, pixels as f64, pixels as f64),
            Measure::MutualInformation => (views as f64, t, t + f64::from(totals[region])),
        };
        let level = |n: f64, t: f64| if n == 0.0 { 0.0 } else { power((n * scale / t).ln()) };
        let (l0, l1) = (level(n0, t0), level(n1, t1));
        sum += ((n1 - n0) * l1).abs() + (n0 * (l1 - l0)).abs();
    }
    sum / pixels as f64
}

/// Prices all candidates on both, with the share of those that the device left to the CPU; asserts that they agree.
fn agree(gpu: &Gpu, mesh: &Mesh, views: &[View], regions: Option<&Regions>, how: ViewpointOptions) -> (usize, usize) {
    let condition = ViewCondition::new(mesh, views, regions, how).unwrap();
    let options = SimplifyOptions::default();
    let mut study = Study::new(mesh, &options, &condition);
    let candidates = study.candidates();
    let stars = study.stars(&candidates);
    let cpu = study.price_batch(&stars);
    let device = study.on(gpu).unwrap().price_batch(&stars).unwrap();
    assert_eq!((cpu.len(), device.len()), (candidates.len(), candidates.len()));
    let mut left = 0;
    for ((candidate, (cost, deltas)), DevicePrice { cost: near_cost, deltas: counted }) in
        candidates.iter().zip(cpu).zip(device)
    {
        let Some(counted) = counted else {
            left += 1;
            continue;
        };
        assert_eq!(counted, deltas, "{candidate:?}");
        let magnitude = magnitude(how, &study.scene.histogram, condition.screens.pixels(), &deltas);
        let near_cost = f64::from(near_cost.expect("a cost where there are counts"));
        let bound = magnitude / f64::from(1 << 18);
        assert!((near_cost - cost).abs() <= bound, "{candidate:?}: {cost}, device {near_cost}, bound {bound}");
    }
    (candidates.len(), left)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    #[test]
    fn a_device_counts_the_same_pixels_and_comes_to_the_same_cost(
        trouble in trouble(),
        alpha in prop_oneof![Just(1.0), 0.4f64..2.5],
    ) {
        let Some(gpu) = gpu() else { return Ok(()) };
        let (mesh, regions, seen) = trouble.build();
        for measure in [Measure::Entropy, Measure::MutualInformation] {
            for regions in [Some(&regions), None] {
                let (_, left) = agree(gpu, &mesh, &seen, regions, options(measure, alpha));
                prop_assert_eq!(left, 0);
            }
        }
    }
}

#[test]
fn a_device_counts_the_same_pixels_on_the_largest_screen_and_far_beyond_it() {
    let Some(gpu) = gpu() else { return };
    let ids: Vec<u32> = (0..64).map(|t| 1 + t % 5).collect();
    let map = |wrap| RegionMap::Picture { width: 16, height: 4, wrap: [wrap; 2], ids: ids.clone().into(), set: 0 };
    let regions = Regions { count: 6, maps: vec![map(Wrap::MirroredRepeat), map(Wrap::Repeat)] };
    let tall = |i: u32, j: u32| ((i * 7 + j * 3) % 5) as f32 * 0.01;
    let sheets = |x: f32, y: f32, side: f32| {
        let front = sheet(3, [x, y, side], tall, |s, t| Vec2::new(9.0 * s, -7.0 * t));
        [front, flat(4, [x + 0.2 * side, y + 0.3 * side, 0.7 * side], 0.02)]
    };
    // The far corner of the largest screen; less than a pixel in all; from a part of a screen to so many that points are drawn in to the
    // limit; a single pixel.
    for (scale, size, [x, y, side]) in [
        (1.0, 1024, [0.9, 0.02, 0.12]),
        (0.001, 1024, [0.0, 0.0, 1.0]),
        (1.0, 64, [-0.2, -0.1, 1.3]),
        (16.0, 64, [-0.2, -0.1, 1.3]),
        (5000.0, 64, [-0.2, -0.1, 1.3]),
        (3.0, 1, [-0.2, -0.1, 1.3]),
    ] {
        let grown = |part: Part| (part.0.iter().map(|p| *p * scale).collect(), part.1, part.2);
        let mesh = parts(&sheets(x, y, side).map(grown));
        let eye = View { distance: Some(2.5 * f64::from(scale)), ..frontal(size) };
        let views = [frontal(size), eye];
        for measure in [Measure::Entropy, Measure::MutualInformation] {
            let (count, left) = agree(gpu, &mesh, &views, Some(&regions), options(measure, 1.0));
            assert!(count > 20 && left == 0, "{count} candidates, {left} left to the CPU");
        }
    }
}

/// The sequence from a device's first prices; that it was not given up.
fn on_device(gpu: &Gpu, mesh: &Mesh, views: &[View], regions: Option<&Regions>, how: ViewpointOptions) {
    let plain = ViewCondition::new(mesh, views, regions, how).unwrap();
    let helped = ViewCondition::new(mesh, views, regions, how).unwrap().on(gpu);
    let (plain, device) = (on_threads(2, mesh, &plain), on_threads(2, mesh, &helped));
    assert_eq!(helped.trouble(), None);
    assert!(plain.collapses.len() > 20);
    assert!(plain.to_blob() == device.to_blob(), "{:?}, {how:?}", regions.is_some());
}

#[test]
fn a_sequence_has_the_same_bytes_with_a_device() {
    let Some(gpu) = gpu() else { return };
    let mesh = parts(&[ball(16, 12, 1.0), flat(8, [-1.0, -0.5, 2.0], 0.3)]);
    let ids = (0..64).map(|t| 1 + t % 5).collect::<Vec<u32>>();
    let map = |wrap| RegionMap::Picture { width: 8, height: 8, wrap: [wrap; 2], ids: ids.clone().into(), set: 0 };
    let regions = Regions { count: 6, maps: vec![map(Wrap::Repeat), map(Wrap::MirroredRepeat)] };
    let seen = views(Cameras::Dodecahedron, 48, &mesh);
    for measure in [Measure::Entropy, Measure::MutualInformation] {
        for update in [Update::Exact, Update::Published] {
            for regions in [Some(&regions), None] {
                on_device(gpu, &mesh, &seen, regions, ViewpointOptions { measure, update, alpha: 1.5 });
            }
        }
    }
}

#[test]
fn what_a_device_has_no_room_for_the_cpu_does() {
    let Some(gpu) = gpu() else { return };
    // A coarse sheet in front of one of 800 faces, each a region: what it uncovers are hundreds of them.
    let front = sheet(3, [0.0, 0.0, 1.0], |i, j| 0.5 + 0.05 * ((i + 2 * j) % 3) as f32, Vec2::new);
    let mesh = parts(&[front, flat(20, [0.0, 0.0, 1.0], 0.0)]);
    let view = [frontal(128)];
    let (count, left) = agree(gpu, &mesh, &view, None, options(Measure::Entropy, 1.0));
    assert!(left > 0 && left < count, "{left} of {count}");
    on_device(gpu, &mesh, &view, None, options(Measure::Entropy, 1.0));
    // A fan of more faces than a workgroup has room for.
    let mut fan: Part = (vec![Vec3::new(0.5, 0.5, 0.0)], vec![Vec2::ZERO], Vec::new());
    for i in 0..70u32 {
        let angle = std::f32::consts::TAU * i as f32 / 70.0;
        fan.0.push(Vec3::new(0.5 + 0.4 * angle.cos(), 0.5 + 0.4 * angle.sin(), 0.0));
        fan.1.push(Vec2::ZERO);
        fan.2.push([0, 1 + i, 1 + (i + 1) % 70]);
    }
    let mesh = parts(&[fan]);
    let (count, left) = agree(gpu, &mesh, &view, None, options(Measure::Entropy, 1.0));
    assert!(left > 0 && left < count, "{left} of {count}");
    on_device(gpu, &mesh, &view, None, options(Measure::MutualInformation, 1.0));
    // A star over the whole of the largest screen.
    let mesh = parts(&[sheet(2, [0.0, 0.0, 1.0], |i, j| 0.1 * ((i + j) % 3) as f32, Vec2::new)]);
    let (_, left) = agree(gpu, &mesh, &[frontal(1024)], None, options(Measure::Entropy, 1.0));
    assert!(left > 0);
}
