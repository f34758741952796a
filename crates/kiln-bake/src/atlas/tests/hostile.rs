//! Meshes that nobody would model: each gets a sound atlas or an error value, in seconds.

use super::*;

/// Numbers in `[0, 1)`, the same each time.
fn noise(seed: u32) -> impl FnMut() -> f32 {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(12345);
    move || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        (state >> 8) as f32 / (1u32 << 24) as f32
    }
}

fn loose_triangles(count: u32) -> Shape {
    let mut next = noise(1);
    let mut shape = Shape::default();
    for i in 0..count {
        let middle = Vec3::new(next(), next(), next()) * 20.0;
        shape.positions.extend((0..3).map(|_| middle + Vec3::new(next(), next(), next()) - 0.5));
        shape.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    shape
}

/// A Menger sponge of `depth` steps out of whole cubes, walls between neighbours twice, all places welded.
fn menger(depth: u32) -> Shape {
    let side = 3u32.pow(depth);
    let hole = |x: u32, y: u32, z: u32| {
        (0..depth).any(|d| {
            let middle = |c: u32| u32::from(c / 3u32.pow(d) % 3 == 1);
            middle(x) + middle(y) + middle(z) >= 2
        })
    };
    let mut shape = Shape::default();
    let mut number = std::collections::BTreeMap::new();
    for cell in 0..side.pow(3) {
        let (x, y, z) = (cell % side, cell / side % side, cell / side / side);
        if hole(x, y, z) {
            continue;
        }
        let cube = Shape::cube();
        let vertex = |v: u32| {
            let at = cube.positions[v as usize] + Vec3::new(x as f32, y as f32, z as f32);
            let (positions, number) = (&mut shape.positions, &mut number);
            *number.entry(at.to_array().map(|c| c as u32)).or_insert_with(|| {
                positions.push(at);
                positions.len() as u32 - 1
            })
        };
        let corners: Vec<u32> = (0..8).map(vertex).collect();
        shape.triangles.extend(cube.triangles.iter().map(|t| t.map(|v| corners[v as usize])));
    }
    shape
}

/// `spokes` triangles around one point; `wave` lifts every other rim point.
fn hub(spokes: u32, wave: f32) -> Shape {
    let rim = (0..spokes).map(|i| Shape::circle(i as f32 / spokes as f32).extend(wave * (i % 2) as f32));
    let mut shape = Shape { positions: vec![Vec3::ZERO], triangles: Vec::new() };
    shape.positions.extend(rim);
    shape.triangles.extend((0..spokes).map(|i| [0, 1 + i, 1 + (i + 1) % spokes]));
    shape
}

/// A sound atlas, or an error value that says something.
fn survives(name: &str, level: &Level, options: &AtlasOptions) -> Option<AtlasReport> {
    match unwrap(level, options, &Uvunwrap::STANDARD) {
        Ok((new, layout, report)) => {
            assert_untouched(level, &new);
            check(&new.mesh, &layout).unwrap_or_else(|defects| panic!("{name}: {defects:?}"));
            Some(report)
        }
        Err(error) => {
            assert!(!error.to_string().is_empty(), "{name}");
            None
        }
    }
}

#[test]
fn ten_thousand_loose_triangles_get_a_chart_each() {
    let report = survives("loose", &loose_triangles(10_000).level(), &options(1024, 0)).expect("fits");
    assert!(report.charts > 9_900, "{report:?}");
}

#[test]
fn a_menger_sponge_of_whole_cubes_is_laid_out() {
    // 400 cubes, whose inner walls have four faces at an edge and lie back to back.
    let report = survives("menger", &menger(2).level(), &options(2048, 2)).expect("fits");
    assert!(report.charts >= 100, "{report:?}");
}

#[test]
fn a_hub_of_fifty_thousand_spokes_is_laid_out_flat_or_waved() {
    let flat = survives("flat hub", &hub(50_000, 0.0).level(), &options(1024, 2)).expect("fits");
    assert_eq!(flat.charts, 50_000 / 16, "{flat:?}");
    survives("waved hub", &hub(10_000, 0.2).level(), &options(1024, 2)).expect("fits");
    let small = survives("small hub", &hub(2_000, 0.0).level(), &options(1024, 2)).expect("fits");
    assert_eq!(small.charts, 1);
}

#[test]
fn an_edge_of_eight_thousand_faces_gets_a_chart_for_each() {
    let report = survives("book", &Shape::book(8_000).level(), &options(2048, 0)).expect("fits");
    assert_eq!(report.charts, 8_000);
}

#[test]
fn a_statue_on_a_plain_of_a_million_units_is_laid_out() {
    // 12,800 faces on a thousandth of the extent: all of them in one cell of any even grid.
    let plain = Shape::grid(8, 8, |u, v| Vec3::new(u, v, 0.0) * (1 << 20) as f32);
    let statue = Shape::sphere(80, 80).scaled(1024.0, Vec3::new(5e5, 5e5, 2e3));
    survives("plain", &plain.and(statue).level(), &options(1024, 4)).expect("fits");
    // Smaller still: below what any texel can show, faces count as degenerate.
    let speck = Shape::sphere(16, 8).scaled(0.01, Vec3::ZERO);
    let plain = Shape::grid(8, 8, |u, v| Vec3::new(u, v, 0.0) * (1 << 20) as f32);
    let report = survives("speck", &plain.and(speck).level(), &options(1024, 4)).expect("fits");
    assert!(report.degenerate_faces > 0, "{report:?}");
}

#[test]
fn needles_are_laid_out() {
    let mut next = noise(5);
    let mut shape = Shape::default();
    for i in 0..500u32 {
        let from = Vec3::new(next(), next(), next()) * 10.0;
        let along = Vec3::new(next() - 0.5, next() - 0.5, next() - 0.5) * 10.0;
        let width = 10f32.powf(-5.0 * next());
        shape.positions.extend([from, from + along, from + along.any_orthogonal_vector().normalize() * width]);
        shape.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    survives("needles", &shape.level(), &options(2048, 2)).expect("fits");
}

#[test]
fn fans_that_no_surface_has_are_laid_out() {
    // Every three of twenty points: each edge has hundreds of faces, each pair of faces of a point lies anyhow.
    let mut next = noise(9);
    let positions: Vec<Vec3> = (0..20).map(|_| Vec3::new(next(), next(), next())).collect();
    let mut triangles = Vec::new();
    for a in 0..20u32 {
        for b in 0..a {
            triangles.extend((0..b).map(|c| if (a + b + c) % 2 == 0 { [a, b, c] } else { [a, c, b] }));
        }
    }
    survives("all of twenty", &Shape { positions, triangles }.level(), &options(2048, 2)).expect("fits");
    // Both sides of a strip with one side, and a book whose pages are Möbius strips' neighbours.
    let strip = Shape::moebius();
    let back = Shape { triangles: strip.triangles.iter().map(|[a, b, c]| [*a, *c, *b]).collect(), ..strip.clone() };
    survives("two-sided Möbius", &strip.and(back).and(Shape::book(65)).level(), &options(1024, 2)).expect("fits");
}

#[test]
fn the_models_own_uvs_are_not_looked_at() {
    let mut raw = Shape::sphere(16, 8).raw();
    raw.uv0 = Some(vec![Vec2::ZERO; raw.positions.len()]);
    let without = unwrapped(&Shape::sphere(16, 8).level(), &options(256, 4)).1;
    let report = survives("uvs", &level(Mesh::new(raw).expect("valid")), &options(256, 4)).expect("fits");
    assert_eq!(report, without);
}

#[test]
fn faces_that_lie_ten_times_on_each_other_are_laid_apart() {
    let mut shape = Shape::default();
    for _ in 0..10 {
        shape = shape.and(Shape::grid(10, 10, |u, v| Vec3::new(u, v, 0.0)));
    }
    let report = survives("stack", &shape.level(), &options(512, 2)).expect("fits");
    assert!(report.coverage > 0.3, "{report:?}");
}

#[test]
fn noise_of_every_kind_gives_a_value() {
    for seed in 0..12 {
        let mut next = noise(100 + seed);
        let points = 30 + seed * 40;
        let scale = [1.0, 1e-20, 1e20, 1e-3][seed as usize % 4];
        let positions: Vec<Vec3> =
            (0..points).map(|_| (Vec3::new(next(), next(), next()) * 8.0).round() / 8.0 * scale).collect();
        let mut pick = || (next() * points as f32) as u32 % points;
        let triangles: Vec<[u32; 3]> = (0..300).map(|_| [pick(), pick(), pick()]).collect();
        let parts =
            [Shape { positions: positions.clone(), triangles: triangles.clone() }, Shape { positions, triangles }];
        let level = Shape::submeshes(&parts);
        for (sheets, densities) in [(1, vec![]), (2, vec![1.0, 4.0])] {
            survives("noise", &level, &AtlasOptions { sheets, densities, ..options(512, 2) });
        }
    }
}
