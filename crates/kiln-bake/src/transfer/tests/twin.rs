//! The hit pass on a device against its CPU twin, and both against brute force.
//!
//! Tolerance: ids differ on less than 2 % of the covered texels, coverage on less than 0.1 %; away from occlusion edges normals are
//! within 0.25 degrees in the mean and 2 at the 99th percentile. Away from occlusion edges: all texels of the 3 x 3 around it are
//! covered, and their heights are within a tenth of the reach.

use std::sync::OnceLock;

use glam::{DVec2, DVec3, Vec2, Vec3};
use kiln_asset::{ExtraMap, FaceId, Mesh, RawMesh};
use kiln_geom::Bvh;
use kiln_geom::math::{cos, sin};
use kiln_gpu::Gpu;

use super::models::*;
use super::*;
use crate::transfer::gpu::{HitPass, Portions};
use crate::transfer::low::Low;
use crate::transfer::search::{Scratch, Search};
use crate::transfer::sheet::Sheet;
use crate::transfer::{Backend, Depth, Picture, bake};

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

/// A pair of models.
struct Models {
    name: &'static str,
    high: Mesh,
    low: Mesh,
    /// In front for the outermost hit, and both ways for the nearest one.
    reach: [f32; 2],
    size: u32,
}

fn models() -> Vec<Models> {
    let pair = |name, high, low: RawMesh, reach| Models {
        name,
        high: valid(high),
        low: charted(&low),
        reach: [reach; 2],
        size: 256,
    };
    let block = |half| cube(Vec3::new(0.8, 0.2, 0.1), half);
    vec![
        pair("sphere", sphere(96, 48), sphere(12, 8), 0.2),
        // Not a power of two: places are rounded there.
        Models { size: 250, ..pair("bumpy torus", torus(120, 60, 0.04), torus(14, 8, 0.0), 0.2) },
        pair("cube and sphere", both(sphere(64, 32), block(0.5)), both(sphere(10, 6), block(0.52)), 0.3),
        fold(),
        pair("straddling", straddling(), dome(4), 0.4),
    ]
}

/// Columns of the low and of the high fold.
const FOLD: [u32; 2] = [72, 720];
/// Distance between the layers of the fold.
const GAP: f32 = 0.2;

/// Three layers of one sheet upon each other, as in an ear: its line is an S. The reach goes through the next layer, which looks the
/// other way; for nearest hits also through the one behind it.
fn fold() -> Models {
    let make = |columns: u32, rows: u32, bump: f32| {
        let place = |u: f32, v: f32| {
            let (place, normal) = along_the_fold(u);
            let lift = bump * sin(120.0 * u) * sin(9.0 * v);
            place + v * Vec3::Y + lift * normal
        };
        grid(columns, rows, |u, v| {
            let e = 2e-4;
            let (du, dv) = (place(u + e, v) - place(u - e, v), place(u, v + e) - place(u, v - e));
            (place(u, v), du.cross(dv).normalize())
        })
    };
    let (high, low) = (make(FOLD[1], 40, 0.015), make(FOLD[0], 2, 0.0));
    Models { name: "fold", high: valid(high), low: charted(&low), reach: [0.3, 0.5], size: 256 }
}

/// Place and normal of the fold's line at `u` from 0 to 1.
fn along_the_fold(u: f32) -> (Vec3, Vec3) {
    let turn = std::f32::consts::PI * GAP / 2.0;
    let mut s = u * (3.0 + 2.0 * turn);
    let at = |x: f32, z: f32| Vec3::new(x, 0.0, z);
    if s < 1.0 {
        return (at(s, 0.0), Vec3::Z);
    }
    s -= 1.0;
    if s < turn {
        let a = s / turn * std::f32::consts::PI;
        let normal = at(-sin(a), cos(a));
        return (at(1.0, GAP / 2.0) - GAP / 2.0 * normal, normal);
    }
    s -= turn;
    if s < 1.0 {
        return (at(1.0 - s, GAP), -Vec3::Z);
    }
    s -= 1.0;
    if s < turn {
        let a = s / turn * std::f32::consts::PI;
        let normal = at(-sin(a), -cos(a));
        return (at(0.0, 1.5 * GAP) + GAP / 2.0 * normal, normal);
    }
    (at(s - turn, 2.0 * GAP), Vec3::Z)
}

/// Panels that go up and down through z = 0, from -0.3 to 0.3, and a sheet at -0.1: large triangles on both sides of the low surface.
fn straddling() -> RawMesh {
    let panels = grid(4, 1, |u, v| {
        let z = if (u * 4.0).round() as i32 % 2 == 0 { -0.3 } else { 0.3 };
        (Vec3::new(u, v, z), Vec3::Z)
    });
    let sheet = grid(1, 1, |u, v| (Vec3::new(u, v, -0.1), Vec3::Z));
    both(panels, sheet)
}

/// A shallow dome over the unit square, so that smooth directions differ from the faces'.
fn dome(steps: u32) -> RawMesh {
    grid(steps, steps, |x, y| {
        let (dx, dy) = (x - 0.5, y - 0.5);
        (Vec3::new(x, y, 0.05 - 0.2 * (dx * dx + dy * dy)), Vec3::new(0.4 * dx, 0.4 * dy, 1.0).normalize())
    })
}

fn options_for(models: &Models, directions: Directions, hit: HitRule, samples: u32) -> BakeOptions {
    let reach = models.reach[usize::from(hit == HitRule::Nearest)];
    let options = BakeOptions { directions, hit, samples, ..normals_only(models.size, NormalSpace::Object) };
    within(reach, &options)
}

const DIRECTIONS: [Directions; 2] = [Directions::Smooth, Directions::Face];
const RULES: [HitRule; 2] = [HitRule::Outermost, HitRule::Nearest];

/// Heights, normals and coverage of a bake.
fn maps(models: &Models, options: &BakeOptions, backend: Backend<'_>) -> [Vec<[f32; 4]>; 3] {
    let extras = vec![ExtraMap::Height, ExtraMap::ObjectNormal, ExtraMap::Coverage];
    let options = BakeOptions { extras, depth: Depth::Float, dilation: 0, ..options.clone() };
    let (low, set) = (one_level(models.low.clone(), options.size, 8), MaterialSet::default());
    let input = BakeInput { high: &models.high, low: &low, materials: &set, images: &no_images, cage: None };
    let pictures = bake(&input, &options, backend).unwrap().pictures;
    let texels = |picture: &Picture| match picture {
        Picture::Deep(raster) => raster.texels.clone(),
        Picture::Plain(_) => panic!("8 bits"),
    };
    [1, 2, 3].map(|k| texels(&pictures[k]))
}

/// `[size * size]`: away from occlusion edges.
fn away(size: usize, [heights, _, coverage]: &[Vec<[f32; 4]>; 3], reach: f32) -> Vec<bool> {
    let calm = |texel: usize| {
        let (x, y) = (texel % size, texel / size);
        if x == 0 || y == 0 || x + 1 == size || y + 1 == size {
            return false;
        }
        let around = (0..9).map(|k| (y + k / 3 - 1) * size + x + k % 3 - 1);
        let (lo, hi) = around.clone().fold((f32::MAX, f32::MIN), |(lo, hi), t| {
            let h = heights[t][0];
            (lo.min(h), hi.max(h))
        });
        hi - lo < 0.1 * reach && around.clone().all(|t| coverage[t][0] > 0.0)
    };
    (0..size * size).map(calm).collect()
}

/// Mean, 99th percentile and number of the angles between normals of two bakes, degrees.
fn angles(models: &Models, options: &BakeOptions, gpu: &Gpu) -> (f64, f32, usize) {
    let cpu = maps(models, options, Backend::Cpu);
    let device = maps(models, options, Backend::Gpu(gpu));
    let reach = models.reach[usize::from(options.hit == HitRule::Nearest)];
    let calm = away(options.size as usize, &cpu, reach);
    let normal = |maps: &[Vec<[f32; 4]>; 3], t: usize| Vec3::from_slice(&maps[1][t][..3]);
    let mut angles: Vec<f32> = (0..calm.len())
        .filter(|t| calm[*t] && device[2][*t][0] > 0.0)
        .map(|t| degrees(normal(&cpu, t), normal(&device, t)))
        .collect();
    angles.sort_by(f32::total_cmp);
    let mean = angles.iter().map(|a| f64::from(*a)).sum::<f64>() / angles.len() as f64;
    (mean, angles[angles.len() * 99 / 100], angles.len())
}

fn tree_of(mesh: &Mesh) -> Arc<Bvh> {
    Arc::new(Bvh::new(&mesh.positions, &mesh.triangles))
}

#[test]
fn the_device_finds_what_the_cpu_finds_on_five_models() {
    let Some(gpu) = gpu() else { return };
    for models in &models() {
        for (directions, hit) in DIRECTIONS.iter().flat_map(|d| RULES.map(|r| (*d, r))) {
            let options = options_for(models, directions, hit, 1);
            let cpu = find(&models.high, &models.low, &options, Backend::Cpu).unwrap();
            let device = find(&models.high, &models.low, &options, Backend::Gpu(gpu)).unwrap();
            let name = format!("{}, {directions:?}, {hit:?}", models.name);
            assert_eq!(cpu.low_faces, device.low_faces, "{name}: owners");
            assert_eq!((cpu.report.pairs, cpu.report.overlapping), (device.report.pairs, device.report.overlapping));
            let covered = cpu.report.covered as f64;
            assert!(covered > 10_000.0, "{name}: {covered} texels");
            let texels = || cpu.high_faces.iter().zip(&device.high_faces);
            let ids = texels().filter(|(a, b)| a != b).count() as f64;
            let coverage = texels().filter(|(a, b)| (**a == 0) != (**b == 0)).count() as f64;
            let (mean, p99, calm) = angles(models, &options, gpu);
            eprintln!(
                "{name}: {covered} texels, {} pairs; ids differ on {ids} ({:.4} %), coverage on {coverage}; {calm} away from edges: \
                 mean {mean:.5}, p99 {p99:.5} degrees",
                cpu.report.pairs,
                100.0 * ids / covered,
            );
            assert!(ids < 0.02 * covered, "{name}: {ids} ids of {covered} differ");
            assert!(coverage < 0.001 * covered, "{name}: coverage differs on {coverage} texels");
            assert!(calm as f64 > 0.25 * covered, "{name}: {calm} of {covered} are away from edges");
            assert!(mean < 0.25 && p99 < 2.0, "{name}: mean {mean}, p99 {p99} degrees");
        }
    }
}

#[test]
fn the_device_bakes_what_the_cpu_bakes_with_several_samples_a_texel() {
    let Some(gpu) = gpu() else { return };
    for models in &models() {
        let (directions, hit) = if models.size == 250 { (DIRECTIONS[1], RULES[1]) } else { (DIRECTIONS[0], RULES[0]) };
        let options = options_for(models, directions, hit, 2);
        let (mean, p99, calm) = angles(models, &options, gpu);
        eprintln!(
            "{}, 2 x 2 samples: {calm} texels away from edges: mean {mean:.5}, p99 {p99:.5} degrees",
            models.name
        );
        assert!(calm > 10_000, "{}: {calm}", models.name);
        assert!(mean < 0.25 && p99 < 2.0, "{}: mean {mean}, p99 {p99} degrees", models.name);
    }
}

/// Both backends where there is a device, else the CPU.
fn backends() -> Vec<Backend<'static>> {
    [Some(Backend::Cpu), gpu().map(Backend::Gpu)].into_iter().flatten().collect()
}

#[test]
fn in_a_fold_no_other_layer_wins() {
    let models = fold();
    for backend in backends() {
        for (directions, hit) in DIRECTIONS.iter().flat_map(|d| RULES.map(|r| (*d, r))) {
            let hits = find(&models.high, &models.low, &options_for(&models, directions, hit, 1), backend).unwrap();
            let place = |face: u32, columns: u32| ((face - 1) / 2 % columns) as f32 / columns as f32;
            let (mut covered, mut wrong) = (0u64, 0u64);
            for (low, high) in hits.low_faces.iter().zip(&hits.high_faces).filter(|(_, high)| **high != 0) {
                covered += 1;
                // Places along the line of the fold; a layer is 0.28 long.
                wrong += u64::from((place(*low, FOLD[0]) - place(*high, FOLD[1])).abs() > 0.04);
            }
            assert_eq!(wrong, 0, "{directions:?}, {hit:?}, {}", hits.report.backend);
            assert!(covered * 100 > hits.report.owned * 99, "{covered} of {}", hits.report.owned);
        }
    }
}

/// Where a sample's line starts, and its direction; from the low mesh's corners, without the chapter's own lines.
fn line(low: &Mesh, face: u32, texel: usize, size: u32, directions: Directions) -> (DVec3, DVec3) {
    let p = low.face_positions(FaceId(face)).map(|p| p.as_dvec3());
    let corners = low.triangles[face as usize].map(|v| v as usize);
    let uv = low.atlas_uv.as_ref().unwrap();
    let [t0, t1, t2] = corners.map(|v| (uv[v] * size as f32).as_dvec2());
    let at = DVec2::new((texel as u32 % size) as f64 + 0.5, (texel as u32 / size) as f64 + 0.5);
    let area = (t1 - t0).perp_dot(t2 - t0);
    let (b1, b2) = ((at - t0).perp_dot(t2 - t0) / area, (t1 - t0).perp_dot(at - t0) / area);
    let mix = |v: [DVec3; 3]| v[0] * (1.0 - b1 - b2) + v[1] * b1 + v[2] * b2;
    let normals = low.normals.as_ref().unwrap();
    let direction = match directions {
        Directions::Face => (p[1] - p[0]).cross(p[2] - p[0]),
        _ => mix(corners.map(|v| normals[v].as_dvec3().normalize())),
    };
    (mix(p), direction.normalize())
}

/// Distance along a line to a triangle that looks along it, by Cramer's rule; `slack` opens the triangle.
fn meet(o: DVec3, d: DVec3, [a, b, c]: [DVec3; 3], slack: f64) -> Option<f64> {
    let (e, f) = (b - a, c - a);
    let facing = e.cross(f).dot(d);
    if facing <= 1e-9 {
        return None;
    }
    let r = o - a;
    let (u, v) = (r.cross(f).dot(d) / facing, e.cross(r).dot(d) / facing);
    (u >= -slack && v >= -slack && u + v <= 1.0 + slack).then(|| -r.dot(e.cross(f)) / facing)
}

#[test]
fn hits_on_straddling_triangles_are_those_of_brute_force() {
    let high = valid(straddling());
    let reach = 0.4f32;
    for (low, backend) in
        [charted(&dome(4)), plane(0.0, upright)].iter().flat_map(|low| backends().into_iter().map(move |b| (low, b)))
    {
        for (directions, hit) in DIRECTIONS.iter().flat_map(|d| RULES.map(|r| (*d, r))) {
            let size = 128;
            let options = BakeOptions { directions, hit, ..normals_only(size, NormalSpace::Object) };
            let hits = find(&high, low, &within(reach, &options), backend).unwrap();
            let mut compared = 0;
            for (texel, (owner, winner)) in hits.low_faces.iter().zip(&hits.high_faces).enumerate() {
                if *owner == 0 {
                    continue;
                }
                let (o, d) = line(low, owner - 1, texel, size, directions);
                let corners = |face: u32| high.face_positions(FaceId(face)).map(|p| p.as_dvec3());
                let key = |t: f64| if hit == HitRule::Nearest { t.abs() } else { -t };
                let best = (0..high.face_count() as u32)
                    .filter_map(|face| meet(o, d, corners(face), 0.0))
                    .filter(|t| t.abs() <= f64::from(reach))
                    .map(key)
                    .min_by(f64::total_cmp);
                let found = winner.checked_sub(1).map(|face| key(meet(o, d, corners(face), 1e-4).unwrap()));
                let same = match (best, found) {
                    (Some(best), Some(found)) => (best - found).abs() < 1e-5,
                    (best, found) => best.is_none() && found.is_none(),
                };
                assert!(
                    same,
                    "texel {texel}: {found:?} for {best:?} ({directions:?}, {hit:?}, {})",
                    hits.report.backend
                );
                compared += 1;
            }
            assert!(compared > 8000, "{compared}");
        }
    }
}

#[test]
fn where_mirroring_vertices_is_wrong_both_backends_are_right() {
    let (high, low, size, reach) = (valid(straddling()), plane(0.0, upright), 128u32, 0.4f32);
    let options = normals_only(size, NormalSpace::Object);
    for backend in backends() {
        let hits = find(&high, &low, &within(reach, &options), backend).unwrap();
        let [mut wrong_winner, mut wrong_depth] = [0; 2];
        for (texel, winner) in hits.high_faces.iter().enumerate() {
            let at = Vec2::new((texel as u32 % size) as f32 + 0.5, (texel as u32 / size) as f32 + 0.5) / size as f32;
            let o = DVec3::new(f64::from(at.x), f64::from(1.0 - at.y), 0.0);
            // Least depth with the corners' k mirrored and interpolated, and with what is there: (depth, face).
            let (mut mirrored, mut exact) = ((f64::MAX, 0), (f64::MAX, 0));
            for face in 0..high.face_count() as u32 {
                let corners = high.face_positions(FaceId(face)).map(|p| p.as_dvec3());
                let Some(t) = meet(o, DVec3::Z, corners, 0.0) else { continue };
                let folded = corners.map(|p| p - 2.0 * p.z.max(0.0) * DVec3::Z);
                let depth = meet(o, DVec3::Z, folded, 1e-6).unwrap().abs();
                mirrored = if depth < mirrored.0 { (depth, face) } else { mirrored };
                exact = if t.abs() < exact.0 { (t.abs(), face) } else { exact };
            }
            let sheet = |face: u32| face >= 8;
            wrong_depth += usize::from((mirrored.0 - exact.0).abs() > 0.01);
            if sheet(mirrored.1) != sheet(exact.1) {
                wrong_winner += 1;
                let kiln = winner - 1;
                let tie = (exact.0 - 0.1).abs() < 1e-5;
                assert!(sheet(kiln) == sheet(exact.1) || tie, "texel {texel}: {kiln} for {exact:?}");
            }
        }
        eprintln!("mirrored vertices: {wrong_winner} of {} winners wrong, {wrong_depth} depths", size * size);
        // The panels lie within 0.1 of the plane on a third of the way; there all depths are wrong, and the sheet wins.
        assert!(wrong_winner * 4 > (size * size) as usize && wrong_depth * 4 > (size * size) as usize);
    }
}

#[test]
fn on_a_device_too_the_lower_face_wins_at_equal_distance() {
    let Some(gpu) = gpu() else { return };
    let low = plane(0.0, upright);
    let sheet = |z| {
        let mut raw = plane(z, upright).into_raw();
        (raw.uv0, raw.atlas_uv, raw.tangents) = (None, None, None);
        raw
    };
    for (heights, directions, hit) in [
        ([0.1, 0.1], Directions::Face, HitRule::Nearest),
        ([0.1, 0.1], Directions::Smooth, HitRule::Outermost),
        ([-0.1, 0.1], Directions::Face, HitRule::Nearest),
        ([0.1, -0.1], Directions::Smooth, HitRule::Nearest),
    ] {
        let high = valid(both(sheet(heights[0]), sheet(heights[1])));
        let options = BakeOptions { directions, hit, ..normals_only(64, NormalSpace::Object) };
        let hits = find(&high, &low, &within(0.5, &options), Backend::Gpu(gpu)).unwrap();
        assert!(hits.high_faces.iter().all(|f| (1..=2).contains(f)), "faces 2 and 3 lie as far away: {heights:?}");
    }
}

/// `[size * samples]^2` winners by the device, worked at in these portions.
fn winners(gpu: &Gpu, models: &Models, options: &BakeOptions, portions: Portions) -> (Vec<u32>, u64) {
    let reach = models.reach[0];
    let low = Low::new(&models.low, models.low.atlas_uv.as_ref().unwrap(), 0, options, [reach; 2]);
    let (sheet, search) = (Sheet::new(&low), Search::new(&models.high, tree_of(&models.high), &models.low, options));
    let device = HitPass::new(gpu, &search, portions).unwrap();
    let whole = (sheet.size * sheet.samples) as usize;
    let (mut all, mut pairs) = (vec![0; whole * whole], 0);
    let (mut owners, mut winners) = (Vec::new(), Vec::new());
    let (mut twins, mut scratch, mut differ) = (Vec::new(), Scratch::default(), 0);
    let rows = device.rows(&sheet);
    for first in (0..sheet.across).step_by(rows as usize) {
        let rows = first..(first + rows).min(sheet.across);
        let stripe = device.stripe(&low, &sheet, &search, rows.clone()).unwrap();
        pairs += stripe.pairs;
        for (x, y) in rows.flat_map(|y| (0..sheet.across).map(move |x| (x, y))) {
            let rect = sheet.samples(x, y);
            stripe.copy(x, rect, &mut owners, &mut winners);
            let mut own = Vec::new();
            sheet.own(&low, [x, y], rect, &mut own);
            assert!(own == owners, "owners of bin {x}, {y}");
            search.find(&low, sheet.faces(x, y), rect, &own, &mut twins, &mut scratch);
            differ += twins.iter().zip(&winners).filter(|(a, b)| a != b).count();
            let width = (rect.x1 - rect.x0) as usize;
            for (row, from) in winners.chunks_exact(width).enumerate() {
                let start = (rect.y0 as usize + row) * whole + rect.x0 as usize;
                all[start..start + width].copy_from_slice(from);
            }
        }
    }
    assert!(differ * 500 < all.len(), "{differ} of {} samples differ from the twin's", all.len());
    (all, pairs)
}

#[test]
fn small_draws_and_stripes_and_pieces_give_what_one_draw_gives() {
    let Some(gpu) = gpu() else { return };
    let models = Models { size: 200, ..models().swap_remove(1) };
    for samples in [1, 2, 4] {
        let options = BakeOptions { samples, ..options_for(&models, Directions::Smooth, HitRule::Outermost, 1) };
        let of = |portions| winners(gpu, &models, &options, portions);
        let whole = Portions::default();
        let (ids, pairs) = of(whole);
        assert!(pairs > 3000 && ids.iter().filter(|id| **id != 0).count() > 10_000, "{pairs}");
        for (name, portions) in [
            ("draws of few pairs", Portions { pairs: 777, ..whole }),
            ("draws of few low faces", Portions { lines: 5, ..whole }),
            ("draws of few fragments", Portions { fragments: 3000, ..whole }),
            ("stripes of one row of bins", Portions { samples: 1, ..whole }),
            ("stripes of two rows of bins", Portions { samples: 60_000 * u64::from(samples), ..whole }),
            ("pieces of two small bins", Portions { side: 140, ..whole }),
            ("pieces of two bins", Portions { side: 270, ..whole }),
            ("pieces of one bin", Portions { side: 1, pairs: 50, ..whole }),
        ] {
            let (others, _) = of(portions);
            assert!(ids == others, "{name} at {samples} x {samples} samples");
        }
    }
}

#[test]
fn stripes_hold_as_much_as_they_may_and_at_least_a_row_of_bins() {
    let Some(gpu) = gpu() else { return };
    let models = models().swap_remove(0);
    let options = options_for(&models, Directions::Smooth, HitRule::Outermost, 1);
    let search = Search::new(&models.high, tree_of(&models.high), &models.low, &options);
    let device = HitPass::new(gpu, &search, Portions::default()).unwrap();
    let rows = |size, samples| {
        let options = BakeOptions { size, samples, ..options.clone() };
        let sheet = Sheet::new(&Low::new(&models.low, models.low.atlas_uv.as_ref().unwrap(), 0, &options, [0.1; 2]));
        (device.rows(&sheet), sheet.across)
    };
    assert_eq!(rows(1024, 1), (32, 8));
    assert_eq!(rows(4096, 1), (8, 32));
    // 2^17 samples a side, more than a picture of any device is wide.
    assert_eq!(rows(16384, 8), (1, 1024));
}
