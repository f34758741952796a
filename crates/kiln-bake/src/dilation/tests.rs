//! Planted answers, a naive twin, and what mips see of other charts.

use glam::{Vec3, Vec4};
use kiln_asset::{DeepRaster, Precision, Raster};
use proptest::prelude::*;

use super::code::{Held, Linear, Normal};
use super::*;

/// Fills every texel of `raster` that is not covered, as if all charts were one.
fn dilate(raster: &mut Raster, covered: &[bool], inside: &[bool], rounds: u32, kind: TexelKind) -> DilationReport {
    let charts: Vec<u32> = inside.iter().map(|inside| u32::from(*inside)).collect();
    let fill = Fill::plan(raster.width, raster.height, covered, &charts, rounds);
    fill.apply(raster, kind);
    fill.report()
}

fn point(size: u32, at: usize, texel: [u8; 4]) -> (Raster, Vec<bool>) {
    let mut raster = Raster::filled(size, size, [9, 9, 9, 9]);
    raster.texels[at] = texel;
    let covered = (0..raster.texels.len()).map(|t| t == at).collect();
    (raster, covered)
}

#[test]
fn a_single_texel_grows_by_one_ring_a_round() {
    let red = [200, 10, 20, 255];
    for rounds in 0..4 {
        let (mut raster, covered) = point(9, 40, red);
        let report = dilate(&mut raster, &covered, &covered, rounds, TexelKind::Linear);
        let side = 2 * rounds as u64 + 1;
        assert_eq!(report.dilated, side * side - 1);
        assert_eq!(report.background, 81 - side * side);
        // One colour in, the same colour everywhere: as the mean and from the pyramid.
        assert!(raster.texels.iter().all(|t| *t == red));
    }
}

#[test]
fn covered_texels_never_change() {
    let mut raster = Raster::filled(8, 1, [0; 4]);
    for x in 0..8 {
        raster.texels[x] = [x as u8 * 30, 255 - x as u8, 7, x as u8];
    }
    let before = raster.clone();
    let covered: Vec<bool> = (0..8).map(|x| x % 3 == 0).collect();
    dilate(&mut raster, &covered, &[false; 8], 2, TexelKind::Srgb);
    for (x, covered) in covered.iter().enumerate() {
        assert_eq!(raster.texels[x] == before.texels[x], *covered, "texel {x}");
    }
}

#[test]
fn a_hole_inside_a_chart_is_filled_however_deep_it_is() {
    let mut raster = Raster::filled(21, 21, [50, 60, 70, 255]);
    let covered: Vec<bool> = (0..441).map(|t| [0, 20].contains(&(t % 21)) || [0, 20].contains(&(t / 21))).collect();
    for (texel, covered) in raster.texels.iter_mut().zip(&covered) {
        if !covered {
            *texel = [0; 4];
        }
    }
    let report = dilate(&mut raster, &covered, &[true; 441], 1, TexelKind::Linear);
    assert_eq!(report, DilationReport { dilated: 19 * 19, background: 0 });
    assert!(raster.texels.iter().all(|t| *t == [50, 60, 70, 255]));
}

#[test]
fn colour_is_averaged_in_linear_light_and_normals_are_normalised() {
    let mut raster = Raster::filled(3, 1, [0; 4]);
    raster.texels[0] = [0, 0, 0, 255];
    raster.texels[2] = [255, 255, 255, 255];
    dilate(&mut raster, &[true, false, true], &[true; 3], 1, TexelKind::Srgb);
    assert_eq!(raster.texels[1], [188, 188, 188, 255], "half the light, not half the code");

    let mut raster = Raster::filled(3, 1, [0; 4]);
    raster.texels[0] = [255, 128, 128, 255];
    raster.texels[2] = [128, 128, 255, 255];
    dilate(&mut raster, &[true, false, true], &[true; 3], 1, TexelKind::Normal);
    let n = Held::<[u8; 4], Normal>::decode(raster.texels[1]).truncate();
    assert!((n.length() - 1.0).abs() < 0.01 && (n.x - n.z).abs() < 0.01, "{n:?}");
}

#[test]
fn deep_vectors_come_out_at_unit_length_in_either_encoding() {
    let fill = Fill::plan(3, 1, &[true, false, true], &[1; 3], 0);
    let deep = |a: Vec3, b: Vec3| DeepRaster {
        texels: vec![a.extend(1.0).to_array(), [0.0; 4], b.extend(0.5).to_array()],
        ..DeepRaster::filled(3, 1, Precision::Float, [0.0; 4])
    };
    let diagonal = Vec3::new(0.5f32.sqrt(), 0.5f32.sqrt(), 0.0);
    let mut raw = deep(Vec3::X, Vec3::Y);
    fill.apply(&mut raw, TexelKind::Vector);
    assert!((Vec4::from(raw.texels[1]) - diagonal.extend(0.75)).length() < 1e-6, "{:?}", raw.texels[1]);
    let mut coded = deep(0.5 * Vec3::X + 0.5, 0.5 * Vec3::Y + 0.5);
    fill.apply(&mut coded, TexelKind::Normal);
    assert!((Vec4::from(coded.texels[1]) - (0.5 * diagonal + 0.5).extend(0.75)).length() < 1e-6);
    let mut opposed = deep(Vec3::X, -Vec3::X);
    fill.apply(&mut opposed, TexelKind::Vector);
    assert_eq!(opposed.texels[1], [0.0, 0.0, 1.0, 0.75], "straight up where vectors cancel");
    let mut plain = deep(Vec3::new(2.0, -3.0, 0.0), Vec3::ZERO);
    fill.apply(&mut plain, TexelKind::Srgb);
    assert_eq!(plain.texels[1], [1.0, -1.5, 0.0, 0.75], "deep colours are linear already");
}

#[test]
fn a_picture_without_a_covered_texel_is_up_or_black_or_zero() {
    for (kind, expected) in [
        (TexelKind::Normal, [128, 128, 255, 255]),
        (TexelKind::Srgb, [0, 0, 0, 255]),
        (TexelKind::Linear, [0, 0, 0, 255]),
        (TexelKind::Nearest, [0; 4]),
    ] {
        let mut raster = Raster::filled(70, 4, [7; 4]);
        dilate(&mut raster, &[false; 280], &[false; 280], 3, kind);
        assert!(raster.texels.iter().all(|t| *t == expected), "{kind:?}");
    }
    Fill::plan(0, 0, &[], &[], 8).apply(&mut Raster::default(), TexelKind::Srgb);
}

#[test]
fn a_gap_between_charts_is_split_in_its_middle_and_its_middle_texel_goes_to_the_lower_chart() {
    // Charts 5 and 3 with 5 texels between them.
    let charts: Vec<u32> = [vec![5; 4], vec![0; 5], vec![3; 4]].concat();
    let covered: Vec<bool> = charts.iter().map(|c| *c != 0).collect();
    let mut raster = Raster::filled(13, 1, [0; 4]);
    for (texel, chart) in raster.texels.iter_mut().zip(&charts) {
        *texel = [40 * *chart as u8; 4];
    }
    Fill::plan(13, 1, &covered, &charts, 8).apply(&mut raster, TexelKind::Linear);
    let owners: Vec<u8> = raster.texels.iter().map(|t| t[0] / 40).collect();
    assert_eq!(owners, [5, 5, 5, 5, 5, 5, 3, 3, 3, 3, 3, 3, 3]);
}

#[test]
fn a_chart_takes_nothing_from_a_chart_beside_it() {
    // Two charts that touch; the right one is covered in its last column alone, a third not at all.
    let charts: Vec<u32> =
        (0..8).flat_map(|y| (0..8).map(move |x| if y == 7 { 3 } else { 1 + u32::from(x > 3) })).collect();
    let covered: Vec<bool> = (0..64).map(|t| t / 8 < 7 && (t % 8 < 4 || t % 8 == 7)).collect();
    let mut raster = Raster::filled(8, 8, [0; 4]);
    for t in (0..64).filter(|t| covered[*t]) {
        raster.texels[t] = if t % 8 < 4 { [255, 0, 0, 255] } else { [0, 255, 0, 255] };
    }
    let fill = Fill::plan(8, 8, &covered, &charts, 8);
    fill.apply(&mut raster, TexelKind::Srgb);
    for t in 0..56 {
        let expected = if t % 8 < 4 { [255, 0, 0, 255] } else { [0, 255, 0, 255] };
        assert_eq!(raster.texels[t], expected, "texel {t}");
    }
    // The third chart has nothing of its own: the pyramid's means of the cells above it.
    assert_eq!(fill.report(), DilationReport { dilated: 21, background: 8 });
    assert_eq!((raster.texels[56], raster.texels[63]), ([255, 0, 0, 255], [0, 255, 0, 255]));
}

#[test]
fn a_piece_of_a_chart_that_no_round_reaches_takes_the_charts_mean() {
    // Chart 1 at both ends, its right end not covered; 20 empty texels and chart 2 between.
    let charts: Vec<u32> = [vec![1; 2], vec![0; 10], vec![2; 2], vec![0; 10], vec![1; 2]].concat();
    let covered: Vec<bool> = (0..26).map(|t| t < 2 || t == 12 || t == 13).collect();
    let mut raster = Raster::filled(26, 1, [0; 4]);
    (raster.texels[0], raster.texels[1]) = ([10; 4], [30; 4]);
    (raster.texels[12], raster.texels[13]) = ([200; 4], [200; 4]);
    let fill = Fill::plan(26, 1, &covered, &charts, 2);
    let mut ids = raster.clone();
    fill.apply(&mut raster, TexelKind::Linear);
    assert_eq!(raster.texels[24..], [[20; 4]; 2]);
    fill.apply(&mut ids, TexelKind::Nearest);
    assert_eq!(ids.texels[24..], [[10; 4]; 2]);
}

#[test]
fn box_mips_of_a_filled_picture_are_the_means_of_what_was_baked() {
    // One white and one black texel in a corner of nothing: every mip above them is half as light.
    let mut raster = Raster::filled(256, 256, [0; 4]);
    let mut covered = vec![false; 256 * 256];
    (raster.texels[0], raster.texels[1]) = ([255; 4], [0, 0, 0, 255]);
    (covered[0], covered[1]) = (true, true);
    let charts: Vec<u32> = covered.iter().map(|c| u32::from(*c)).collect();
    Fill::plan(256, 256, &covered, &charts, 0).apply(&mut raster, TexelKind::Srgb);
    assert!(raster.texels[2..256].iter().all(|t| *t == [188, 188, 188, 255]));
    assert!(raster.texels[256 * 200..].iter().all(|t| *t == [188, 188, 188, 255]));
}

/// The rules of the opening page, a texel at a time.
fn naive(width: usize, covered: &[bool], charts: &[u32], rounds: u32, copies: bool, values: &mut [Vec4]) {
    let height = covered.len() / width;
    let around = |t: usize| -> Vec<usize> {
        let (x, y) = ((t % width) as i32, (t / width) as i32);
        let mut near: Vec<(i32, usize)> = (-1..=1)
            .flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)))
            .filter(|(dx, dy)| (*dx, *dy) != (0, 0))
            .filter(|(dx, dy)| x + dx >= 0 && x + dx < width as i32 && y + dy >= 0 && y + dy < height as i32)
            .map(|(dx, dy)| (dx * dx + dy * dy, (y + dy) as usize * width + (x + dx) as usize))
            .collect();
        near.sort_unstable();
        near.into_iter().map(|(_, t)| t).collect()
    };
    let mean = |from: &[Vec4]| if copies { from[0] } else { from.iter().sum::<Vec4>() / from.len() as f32 };
    let mut owner: Vec<u32> = (0..covered.len())
        .map(|t| match (covered[t], charts[t]) {
            (false, _) => 0,
            (true, 0) => {
                let least = |only_covered: bool| {
                    let own = around(t).into_iter().filter(|n| covered[*n] || !only_covered);
                    own.map(|n| charts[n]).filter(|c| *c != 0).min()
                };
                least(true).or(least(false)).unwrap_or(u32::MAX)
            }
            (true, chart) => chart,
        })
        .collect();
    let round = |owner: &mut Vec<u32>, values: &mut [Vec4], holes: bool| {
        let before = owner.clone();
        for t in (0..covered.len()).filter(|t| before[*t] == 0 && (charts[*t] != 0) == holes) {
            let near: Vec<usize> = around(t).into_iter().filter(|n| before[*n] != 0).collect();
            let own = if holes { Some(charts[t]) } else { near.iter().map(|n| before[*n]).min() };
            let from: Vec<Vec4> = near.iter().filter(|n| Some(before[**n]) == own).map(|n| values[*n]).collect();
            if !from.is_empty() {
                owner[t] = own.expect("there are some");
                values[t] = mean(&from);
            }
        }
        *owner != before
    };
    while round(&mut owner, values, true) {}
    for _ in 0..rounds {
        round(&mut owner, values, false);
    }
    while rounds > 0 && round(&mut owner, values, true) {}
    for t in (0..covered.len()).filter(|t| owner[*t] == 0 && charts[*t] != 0).collect::<Vec<_>>() {
        let own = |n: &usize| covered[*n] && charts[*n] == charts[t];
        let from: Vec<Vec4> = (0..covered.len()).filter(own).map(|n| values[n]).collect();
        if !from.is_empty() {
            owner[t] = charts[t];
            values[t] = mean(&from);
        }
    }
    fn cell(level: u32, x: usize, y: usize, at: &dyn Fn(usize, usize) -> Option<Vec4>, copies: bool) -> Option<Vec4> {
        if level == 0 {
            return at(x, y);
        }
        let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
        let own: Vec<Vec4> =
            four.iter().filter_map(|(dx, dy)| cell(level - 1, 2 * x + dx, 2 * y + dy, at, copies)).collect();
        let first = *own.first()?;
        Some(if copies { first } else { own.iter().sum::<Vec4>() / own.len() as f32 })
    }
    let before = values.to_vec();
    let at = |x: usize, y: usize| (x < width && y < height && owner[y * width + x] != 0).then(|| before[y * width + x]);
    for t in (0..covered.len()).filter(|t| owner[*t] == 0) {
        let found = (1..12).find_map(|k| cell(k, (t % width) >> k, (t / width) >> k, &at, copies));
        values[t] = found.unwrap_or(if copies { Vec4::ZERO } else { Vec4::W });
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    #[test]
    fn the_plan_does_what_the_rules_say(
        (width, height) in (1usize..20, 1usize..20),
        seed in any::<u64>(),
        (cell, share) in (1usize..7, 1u64..10),
        rounds in 0u32..5,
        copies in any::<bool>(),
    ) {
        let count = width * height;
        let random = |k: usize, salt: u64| kiln_geom::sample::hash(seed ^ salt ^ kiln_geom::sample::hash(k as u64));
        // Charts in blocks, so that they have neighbours of their own; every other block is none.
        let charts: Vec<u32> = (0..count)
            .map(|t| (random((t / width / cell) * 64 + t % width / cell, 1) % 8).saturating_sub(4) as u32)
            .collect();
        let covered: Vec<bool> = (0..count).map(|t| random(t, 2) % 10 < share && (charts[t] != 0 || random(t, 3) % 8 == 0)).collect();
        let mut values: Vec<Vec4> = (0..count).map(|t| Vec4::from([0u64, 8, 16, 24].map(|s| (random(t, 4) >> s & 255) as f32))).collect();
        let mut deep = DeepRaster { texels: values.iter().map(|v| v.to_array()).collect(), ..DeepRaster::filled(width as u32, height as u32, Precision::Float, [0.0; 4]) };
        naive(width, &covered, &charts, rounds, copies, &mut values);
        let kind = if copies { TexelKind::Nearest } else { TexelKind::Linear };
        Fill::plan(width as u32, height as u32, &covered, &charts, rounds).apply(&mut deep, kind);
        for (t, (got, expected)) in deep.texels.iter().zip(&values).enumerate() {
            prop_assert!((Vec4::from(*got) - *expected).length() < 1e-3, "texel {}: {:?} for {}", t, got, expected);
        }
    }
}

/// Charts of saturated colours on a sheet of `size`, `padding` texels apart and of many shapes: `(charts, colours)`.
fn patchwork(size: usize, padding: usize) -> (Vec<u32>, Vec<[u8; 4]>) {
    let mut charts = vec![0u32; size * size];
    let (pitch, mut next) = (37 + padding, 1);
    for top in (3..size).step_by(pitch) {
        for left in (5 + top % 7..size).step_by(pitch) {
            for y in top..(top + 37).min(size) {
                for x in left..(left + 37).min(size) {
                    let (dx, dy) = (x as i32 - left as i32 - 18, y as i32 - top as i32 - 18);
                    let inside = match next % 3 {
                        0 => true,
                        1 => dx * dx + dy * dy <= 18 * 18,
                        _ => dx.abs() + dy.abs() <= 18,
                    };
                    charts[y * size + x] = if inside { next } else { 0 };
                }
            }
            next += 1;
        }
    }
    const COLOURS: [[u8; 4]; 6] = [
        [255, 0, 0, 255],
        [0, 255, 0, 255],
        [0, 0, 255, 255],
        [255, 255, 0, 255],
        [0, 255, 255, 255],
        [255, 0, 255, 255],
    ];
    (charts, (0..next).map(|chart| COLOURS[chart as usize % 6]).collect())
}

/// Half the size by 2x2 means in linear light.
fn halved(size: usize, light: &[Vec4]) -> Vec<Vec4> {
    let at = |x: usize, y: usize| light[y * size + x];
    let half = size / 2;
    let mean = |x: usize, y: usize| 0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1));
    (0..half * half).map(|t| mean(t % half * 2, t / half * 2)).collect()
}

#[test]
fn no_mip_down_to_an_eighth_shows_a_chart_another_charts_colour() {
    let size = 256;
    // (padding, dilation, coarsest mip that is clean texel by texel, coarsest that is under bilinear reads)
    for (padding, dilation, boxes, bilinear) in [(16, 8, 3, 2), (24, 12, 3, 3), (8, 4, 2, 1)] {
        let (charts, colours) = patchwork(size, padding);
        let covered: Vec<bool> = charts.iter().map(|c| *c != 0).collect();
        let mut raster = Raster::filled(size as u32, size as u32, [0; 4]);
        for (texel, chart) in raster.texels.iter_mut().zip(&charts).filter(|(_, chart)| **chart != 0) {
            *texel = colours[*chart as usize];
        }
        Fill::plan(size as u32, size as u32, &covered, &charts, dilation).apply(&mut raster, TexelKind::Srgb);
        let mut light: Vec<Vec4> = raster.texels.iter().map(|t| Vec4::from(t.map(|c| c as f32 / 255.0))).collect();
        for mip in 0..=boxes {
            let (side, texel) = (size >> mip, 1usize << mip);
            let mut worst = [0.0f32; 2];
            for t in (0..size * size).filter(|t| covered[*t]) {
                let own = Vec4::from(colours[charts[t] as usize].map(|c| c as f32 / 255.0));
                let (x, y) = (t % size, t / size);
                let off = |x: usize, y: usize| (light[y.min(side - 1) * side + x.min(side - 1)] - own).length();
                worst[0] = worst[0].max(off(x / texel, y / texel));
                // The four texels of a bilinear read at the texel's centre.
                let first = |c: usize| ((c as f32 + 0.5) / texel as f32 - 0.5).max(0.0) as usize;
                for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    worst[1] = worst[1].max(off(first(x) + dx, first(y) + dy));
                }
            }
            assert!(worst[0] < 1e-6, "padding {padding}, mip {mip}: {worst:?}");
            assert!(mip > bilinear || worst[1] < 1e-6, "padding {padding}, mip {mip}: {worst:?}");
            light = halved(side, &light);
        }
    }
}

#[test]
fn the_bytes_are_the_same_on_any_thread_count() {
    let (charts, _) = patchwork(256, 16);
    let covered: Vec<bool> = charts.iter().enumerate().map(|(t, c)| *c != 0 && t % 11 != 0).collect();
    let mut raster = Raster::filled(256, 256, [0; 4]);
    for (t, texel) in raster.texels.iter_mut().enumerate() {
        *texel = (kiln_geom::sample::hash(t as u64) as u32).to_le_bytes();
    }
    let on = |threads: usize, kind: TexelKind| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        pool.install(|| {
            let mut own = raster.clone();
            Fill::plan(256, 256, &covered, &charts, 12).apply(&mut own, kind);
            own
        })
    };
    for kind in [TexelKind::Srgb, TexelKind::Normal, TexelKind::Nearest] {
        assert_eq!(on(1, kind), on(3, kind));
    }
}

#[test]
fn equal_values_stay_what_they_are() {
    // Means of equal values are those values, in bytes exactly: a flat chart has no seam to its band.
    for code in 0..=255u8 {
        let texel = [code, 255 - code, code / 2, code];
        for count in 1..=8 {
            let decoded = vec![Held::<[u8; 4], Linear>::decode(texel); count];
            assert_eq!(Held::<[u8; 4], Linear>::encode(code::mean::<Held<[u8; 4], Linear>>(decoded)), texel);
            let decoded = vec![<Raster as Texels>::Srgb::decode(texel); count];
            assert_eq!(<Raster as Texels>::Srgb::encode(code::mean::<<Raster as Texels>::Srgb>(decoded)), texel);
        }
    }
}
