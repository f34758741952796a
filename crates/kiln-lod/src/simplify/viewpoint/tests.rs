//! Formulas by hand, fragments by hand, and every cost against drawing everything.

use glam::{DVec3, Vec2, Vec3};
use kiln_asset::{Mesh, RawMesh, Submesh, SubmeshId, Wrap};
use proptest::prelude::*;

use super::cameras::{Cameras, View, views};
use super::formula::{CostScratch, Histogram};
use super::order::Witness;
use super::screen::{DrawnFace, Fragment};
use super::*;
use crate::fixtures;
use crate::simplify::{Conditions, collapse_under};

mod gpu;

/// Looks along -Z at the square from (0, 0) to (1, 1), `size` pixels a side.
fn frontal(size: u32) -> View {
    View {
        right: DVec3::X,
        up: DVec3::Y,
        back: DVec3::Z,
        centre: DVec3::new(0.5, 0.5, 0.0),
        pixels_per_unit: f64::from(size),
        size,
        distance: None,
    }
}

/// One part of a test mesh: places, UVs, triangles; each becomes a submesh, so that nothing is welded between parts.
type Part = (Vec<Vec3>, Vec<Vec2>, Vec<[u32; 3]>);

fn parts(parts: &[Part]) -> Mesh {
    let mut raw = RawMesh::default();
    let mut uvs = Vec::new();
    for (s, (places, uv, triangles)) in parts.iter().enumerate() {
        let first = raw.positions.len() as u32;
        raw.positions.extend(places);
        uvs.extend(uv);
        raw.triangles.extend(triangles.iter().map(|t| t.map(|v| v + first)));
        raw.face_submesh.extend(triangles.iter().map(|_| SubmeshId(s as u32)));
        let mut submesh =
            Submesh { name: format!("{s}"), source_triangles: triangles.len() as u32, ..Submesh::default() };
        submesh.attributes.uv0 = true;
        raw.submeshes.push(submesh);
    }
    raw.uv0 = Some(uvs);
    Mesh::new(raw).unwrap()
}

/// A sheet of `n x n` quads from (x, y) on, `side` wide; `z` and `uv` by place in the sheet.
fn sheet(n: u32, [x, y, side]: [f32; 3], z: impl Fn(u32, u32) -> f32, uv: impl Fn(f32, f32) -> Vec2) -> Part {
    let (mut places, mut uvs, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
    for j in 0..=n {
        for i in 0..=n {
            let (s, t) = (i as f32 / n as f32, j as f32 / n as f32);
            places.push(Vec3::new(x + s * side, y + t * side, z(i, j)));
            uvs.push(uv(s, t));
            if i < n && j < n {
                let a = j * (n + 1) + i;
                triangles.extend([[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]);
            }
        }
    }
    (places, uvs, triangles)
}

fn flat(n: u32, place: [f32; 3], z: f32) -> Part {
    sheet(n, place, |_, _| z, Vec2::new)
}

fn options(measure: Measure, alpha: f64) -> ViewpointOptions {
    ViewpointOptions { measure, alpha, update: Update::Exact }
}

/// The pixel counts of a mesh, `[region_count * views]`.
fn counted(mesh: &Mesh, views: &[View], regions: Option<&Regions>) -> Vec<u32> {
    let condition = ViewCondition::new(mesh, views, regions, ViewpointOptions::default()).unwrap();
    let faces = || {
        mesh.triangles.iter().enumerate().map(|(f, t)| DrawnFace {
            face: f as u32,
            points: t.map(|v| mesh.points[v as usize].0),
            wedges: *t,
        })
    };
    twin::counts(&condition.screens, faces)
}

fn picture(width: u32, ids: &[u32], wrap: Wrap) -> Regions {
    let height = ids.len() as u32 / width;
    let map = RegionMap::Picture { width, height, wrap: [wrap; 2], ids: ids.into(), set: 0 };
    Regions { count: 1 + ids.iter().max().copied().unwrap_or(0), maps: vec![map] }
}

fn near(a: f64, b: f64) {
    assert!((a - b).abs() < 1e-12, "{a} is not {b}");
}

/// Values of views with these counts by region.
fn valued(measure: Measure, alpha: f64, counts: &[&[u32]]) -> Vec<f64> {
    let pixels: u32 = counts.iter().map(|by_view| by_view[0]).sum();
    let formula = Formula::new(measure, alpha, pixels as usize, counts[0].len());
    formula.values(&Histogram::new(counts.concat(), counts[0].len(), &formula))
}

#[test]
fn entropies_by_hand() {
    let ln2 = 2f64.ln();
    // Halves: ln 2; a half and two quarters: 1.5 ln 2; one region: nothing.
    near(valued(Measure::Entropy, 1.0, &[&[8], &[8]])[0], ln2);
    near(valued(Measure::Entropy, 1.0, &[&[8], &[4], &[4]])[0], 1.5 * ln2);
    near(valued(Measure::Entropy, 1.0, &[&[16], &[0]])[0], 0.0);
    // Order 2: 1 - sum p^2; order 1/2: 2 (sum sqrt p - 1).
    near(valued(Measure::Entropy, 2.0, &[&[8], &[4], &[4]])[0], 1.0 - (0.25 + 2.0 / 16.0));
    near(valued(Measure::Entropy, 0.5, &[&[4], &[12]])[0], 2.0 * (0.5 + 0.75f64.sqrt() - 1.0));
}

#[test]
fn informations_by_hand() {
    let ln2 = 2f64.ln();
    // Two views that see different halves of the mean: each ln 2. Views that see the same: nothing.
    let apart: [&[u32]; 2] = [&[16, 0], &[0, 16]];
    let alike: [&[u32]; 2] = [&[4, 4], &[12, 12]];
    for view in 0..2 {
        near(valued(Measure::MutualInformation, 1.0, &apart)[view], ln2);
        near(valued(Measure::MutualInformation, 1.0, &alike)[view], 0.0);
        // Order 2: sum p^2 / q - 1 = 1 / (1/2) - 1.
        near(valued(Measure::MutualInformation, 2.0, &apart)[view], 1.0);
        near(valued(Measure::MutualInformation, 2.0, &alike)[view], 0.0);
    }
    // p = (3/4, 1/4) and (1/4, 3/4), q = 1/2: 3/4 ln 3/2 + 1/4 ln 1/2; order 2: (9/16 + 1/16) / (1/2) - 1 = 1/4.
    let mixed: [&[u32]; 2] = [&[12, 4], &[4, 12]];
    near(valued(Measure::MutualInformation, 1.0, &mixed)[0], 0.75 * 1.5f64.ln() - 0.25 * ln2);
    near(valued(Measure::MutualInformation, 2.0, &mixed)[1], 0.25);
    // Order 1/2: -2 sum p ((q / p)^(1/2) - 1) = 2 (1 - sum sqrt(p q)).
    let half = 2.0 * (1.0 - (0.75f64 * 0.5).sqrt() - (0.25f64 * 0.5).sqrt());
    near(valued(Measure::MutualInformation, 0.5, &mixed)[0], half);
}

#[test]
fn alpha_has_no_jump_at_one_and_equal_areas_have_the_most_entropy() {
    let counts: [&[u32]; 3] = [&[30, 2], &[1, 20], &[33, 42]];
    for measure in [Measure::Entropy, Measure::MutualInformation] {
        let at = valued(measure, 1.0, &counts)[0];
        for step in [1e-3, 1e-6, 1e-9, 1e-12, 1e-15] {
            for alpha in [1.0 - step, 1.0 + step] {
                let beside = valued(measure, alpha, &counts)[0];
                assert!((beside - at).abs() <= 20.0 * step + 1e-14, "{measure:?} {alpha}: {beside} beside {at}");
            }
        }
    }
    for alpha in [0.25, 0.75, 1.0, 1.25, 3.0] {
        let even = valued(Measure::Entropy, alpha, &[&[20], &[20], &[20]])[0];
        for (a, b) in [(19, 20), (21, 20), (40, 10), (60, 0), (1, 1)] {
            assert!(valued(Measure::Entropy, alpha, &[&[a], &[b], &[60 - a - b]])[0] < even);
        }
    }
}

#[test]
fn changes_cost_what_the_values_differ_by() {
    let counts = vec![10, 3, 8, 6, 13, 8];
    let after = vec![12, 3, 0, 7, 12, 14];
    for measure in [Measure::Entropy, Measure::MutualInformation] {
        for alpha in [0.5, 1.0, 1.25, 2.0] {
            let formula = Formula::new(measure, alpha, 24, 2);
            let [before, after] = [&counts, &after].map(|counts| Histogram::new(counts.clone(), 2, &formula));
            let mut deltas = twin::deltas(&before, &after);
            let drawn = twin::cost(&formula, &before, &after);
            assert!(drawn > 0.01);
            near(formula.cost(&before, &deltas, &mut CostScratch::default()), drawn);
            deltas.reverse();
            near(formula.cost(&before, &deltas, &mut CostScratch::default()), drawn);
        }
    }
}

#[test]
fn a_square_shows_its_picture_texel_by_texel() {
    let mesh = parts(&[flat(1, [0.0, 0.0, 1.0], 0.0)]);
    // Row 0 of the picture is at v = 0, the lower edge of the square here.
    let regions = picture(2, &[1, 2, 3, 4], Wrap::Repeat);
    assert_eq!(counted(&mesh, &[frontal(8)], Some(&regions)), [0, 16, 16, 16, 16]);
    assert_eq!(counted(&mesh, &[frontal(8)], None), [0, 36, 28], "the diagonal is a left edge of face 0");
    let small = parts(&[flat(1, [0.25, 0.25, 0.5], 0.0)]);
    assert_eq!(counted(&small, &[frontal(8)], Some(&regions)), [48, 4, 4, 4, 4]);
}

#[test]
fn wrap_modes_are_obeyed() {
    // u from -1 to 2 over three columns of a 2 x 1 picture: texels -2 ..= 3.
    let mesh = parts(&[sheet(1, [0.0, 0.0, 1.0], |_, _| 0.0, |s, t| Vec2::new(3.0 * s - 1.0, t))]);
    let count = |wrap| counted(&mesh, &[frontal(6)], Some(&picture(2, &[1, 2], wrap)));
    assert_eq!(count(Wrap::Repeat), [0, 18, 18]);
    assert_eq!(count(Wrap::ClampToEdge), [0, 18, 18]);
    // -2 -1 0 1 2 3 reads 1 0 0 1 1 0.
    assert_eq!(count(Wrap::MirroredRepeat), [0, 18, 18]);
    let beyond = parts(&[sheet(1, [0.0, 0.0, 1.0], |_, _| 0.0, |s, t| Vec2::new(3.0 * s, t))]);
    let count = |wrap| counted(&beyond, &[frontal(9)], Some(&picture(3, &[1, 2, 3], wrap)));
    assert_eq!(count(Wrap::Repeat), [0, 27, 27, 27]);
    assert_eq!(count(Wrap::ClampToEdge), [0, 9, 9, 63]);
    assert_eq!(count(Wrap::MirroredRepeat), [0, 27, 27, 27]);
}

#[test]
fn the_nearest_face_is_seen_and_of_equally_near_ones_the_lower() {
    let whole =
        |regions: &[u32]| Regions { count: 4, maps: regions.iter().map(|region| RegionMap::Whole(*region)).collect() };
    let (far, close) = (flat(1, [0.0, 0.0, 1.0], -1.0), flat(1, [0.0, 0.0, 0.5], 0.25));
    let mesh = parts(&[far.clone(), close.clone(), close]);
    assert_eq!(counted(&mesh, &[frontal(8)], Some(&whole(&[1, 2, 3]))), [0, 48, 16, 0]);
    // From behind, both sides are drawn.
    let behind = View { right: -DVec3::X, back: -DVec3::Z, ..frontal(8) };
    assert_eq!(counted(&mesh, &[behind], Some(&whole(&[1, 2, 3]))), [0, 64, 0, 0]);
}

#[test]
fn where_rays_meet_near_parts_are_larger_and_pictures_follow_perspective() {
    // The eye is 2 in front of the centre; a unit square 1 in front of it is twice as large as at the centre.
    let eye = View { distance: Some(2.0), pixels_per_unit: 8.0, ..frontal(16) };
    let count = |z: f32| {
        let mesh = parts(&[flat(1, [0.0, 0.0, 1.0], z)]);
        counted(&mesh, &[eye], Some(&Regions { count: 2, maps: vec![RegionMap::Whole(1)] }))[1]
    };
    assert_eq!((count(0.0), count(1.0), count(-2.0)), (64, 256, 16));
    // Nearer than a quarter of the distance, at the eye, and behind it: nothing.
    assert_eq!((count(1.6), count(2.0), count(3.0)), (0, 0, 0));
    // A floor from z = 1 to z = -6: the middle of its v is at z = -2.5, which stands at 0.5 + 8 * (-0.5) * 2 / 4.5 pixels from the
    // middle, not half way between its ends.
    let mut floor = flat(1, [0.0, 0.0, 1.0], 0.0);
    for (place, z) in floor.0.iter_mut().zip([1.0, 1.0, -6.0, -6.0]) {
        *place = Vec3::new(place.x, 0.0, z);
    }
    let wide = View { pixels_per_unit: 64.0, size: 128, ..eye };
    let counts = counted(&parts(&[floor]), &[wide], Some(&picture(1, &[1, 2], Wrap::ClampToEdge)));
    let (near_rows, far_rows) = (64.0 - 32.0 * 2.0 / 4.5, 32.0 * 2.0 / 4.5 - 32.0 * 0.25);
    let width = |z: f64| 64.0 * 2.0 / (2.0 - z);
    let area = |rows: f64, a: f64, b: f64| rows * 0.5 * (width(a) + width(b));
    let expected = [area(near_rows, 1.0, -2.5), area(far_rows, -2.5, -6.0)];
    for (count, expected) in counts[1..].iter().zip(expected) {
        assert!((f64::from(*count) - expected).abs() < 0.03 * expected + 16.0, "{counts:?}, {expected}");
    }
}

/// The fragments of a face written from each of its corners.
fn fragments(screens: &Screens<'_>, face: DrawnFace) -> [Vec<(usize, Fragment)>; 3] {
    [0, 1, 2].map(|turn| {
        let order = [turn, (turn + 1) % 3, (turn + 2) % 3];
        let turned = DrawnFace { points: order.map(|k| face.points[k]), wedges: order.map(|k| face.wedges[k]), ..face };
        let mut out = Vec::new();
        let shape = screens.shape(&turned, 0).unwrap();
        let paint = screens.paint(&shape);
        shape.fragments(screens.size, |pixel, depth, shares| {
            out.push((pixel, Fragment { depth, face: face.face, region: paint.region(shares) }));
        });
        out
    })
}

proptest! {
    #[test]
    fn a_face_gives_the_same_fragments_from_whatever_corner(
        places in prop::collection::vec((-0.5f32..1.5, -0.5f32..1.5, -1f32..1.0, -4f32..4.0, -4f32..4.0), 3),
        meets in any::<bool>(),
    ) {
        let part = (
            places.iter().map(|p| Vec3::new(p.0, p.1, p.2)).collect(),
            places.iter().map(|p| Vec2::new(p.3, p.4)).collect(),
            vec![[0, 1, 2]],
        );
        let mesh = parts(&[part]);
        let regions = picture(8, &(0..64).collect::<Vec<u32>>(), Wrap::MirroredRepeat);
        let view = View { distance: meets.then_some(4.0), ..frontal(24) };
        let condition = ViewCondition::new(&mesh, &[view], Some(&regions), ViewpointOptions::default()).unwrap();
        let [a, b, c] = fragments(&condition.screens, DrawnFace { face: 0, points: [0, 1, 2], wedges: [0, 1, 2] });
        prop_assert_eq!(&a, &b);
        prop_assert_eq!(&a, &c);
        // Depth is that of the plane, within rounding of corners to 1/256 pixel.
        let depths = [0, 1, 2].map(|p| condition.screens.place(p, 0)[2]);
        let (low, high) = (depths.into_iter().min().unwrap(), depths.into_iter().max().unwrap());
        prop_assert!(a.iter().all(|(_, fragment)| (low..=high).contains(&fragment.depth)));
    }
}

/// The sequence of a mesh, and what was known and drawn at every collapse.
fn witnessed(
    mesh: &Mesh,
    views: &[View],
    regions: Option<&Regions>,
    how: ViewpointOptions,
) -> (CollapseSequence, Vec<Witness>) {
    let condition = ViewCondition::new(mesh, views, regions, how).unwrap();
    let options = SimplifyOptions::default();
    let topology = Topology::new(mesh);
    let forms = Forms::new(mesh, &topology, &[], &options);
    let (work, metric) = prepared(mesh, (&topology, &forms), None, &options, &[]);
    let mut order = Order::new(mesh, work, metric, &options, &condition);
    order.witnesses = Some(Vec::new());
    let sequence = order.run();
    (sequence, order.witnesses.take().unwrap())
}

fn check(witnesses: &[Witness], exact: bool) {
    for (i, witness) in witnesses.iter().enumerate() {
        assert!(witness.counts, "collapse {i}: the histograms are not those of the mesh");
        if exact {
            assert_eq!(witness.known.1, witness.drawn.1, "collapse {i}, {:?}", witness.pair);
            let (known, drawn) = (witness.known.0, witness.drawn.0);
            assert!((known - drawn).abs() < 1e-11, "collapse {i}, {:?}: {known}, drawn {drawn}", witness.pair);
        }
    }
}

/// Sheets one behind the other, some of them in the same place, on a raster that meets pixel centres; views from three sides.
#[derive(Clone, Debug)]
struct Trouble {
    sheets: Vec<(u32, [i8; 3], Vec<i8>, bool)>,
    turn: f32,
    size: u32,
    meets: bool,
}

fn trouble() -> impl Strategy<Value = Trouble> {
    let one = (2u32..5, [-4i8..5, -4i8..5, -3i8..4], prop::collection::vec(-3i8..4, 25), any::<bool>());
    let sheets = prop::collection::vec(one, 2..5);
    (sheets, 0f32..1.5, 9u32..28, any::<bool>()).prop_map(|(sheets, turn, size, meets)| Trouble {
        sheets,
        turn,
        size,
        meets,
    })
}

impl Trouble {
    fn build(&self) -> (Mesh, Regions, Vec<View>) {
        let mut all = Vec::new();
        let mut maps = Vec::new();
        for (k, (n, [x, y, z], heights, twice)) in self.sheets.iter().enumerate() {
            let at = |i: u32, j: u32| f32::from(*z) + f32::from(heights[(j * 5 + i) as usize]) / 8.0;
            let place = [f32::from(*x) / 8.0, f32::from(*y) / 8.0, 1.0 + k as f32 / 4.0];
            let part = sheet(*n, place, at, |s, t| Vec2::new(2.5 * s - 0.5, t * self.turn));
            for copy in 0..=u32::from(*twice) {
                all.push(part.clone());
                let region = 2 * k as u32 + copy + 1;
                let wrap = [Wrap::Repeat, Wrap::MirroredRepeat, Wrap::ClampToEdge][k % 3];
                maps.push(match k % 2 {
                    0 => RegionMap::Picture {
                        width: 2,
                        height: 2,
                        wrap: [wrap; 2],
                        ids: vec![region, region + 1, 1, region].into(),
                        set: 0,
                    },
                    _ => RegionMap::Whole(region),
                });
            }
        }
        let mesh = parts(&all);
        let mut seen = views(Cameras::Fibonacci(2), self.size, &mesh);
        seen.push(View { distance: self.meets.then_some(3.0), pixels_per_unit: 8.0, ..frontal(self.size) });
        (mesh, Regions { count: 12, maps }, seen)
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, ..ProptestConfig::default() })]

    #[test]
    fn every_collapse_is_done_at_the_cost_of_drawing_everything(
        trouble in trouble(),
        alpha in prop_oneof![Just(1.0), 0.4f64..2.5],
    ) {
        let (mesh, regions, seen) = trouble.build();
        for measure in [Measure::Entropy, Measure::MutualInformation] {
            for regions in [Some(&regions), None] {
                let (sequence, witnesses) = witnessed(&mesh, &seen, regions, options(measure, alpha));
                prop_assert_eq!(sequence.collapses.len(), witnesses.len());
                check(&witnesses, true);
                prop_assert!(sequence.collapses.windows(2).all(|w| w[0].error <= w[1].error));
                prop_assert!(sequence.replay(&mesh, sequence.collapses.len()).is_ok());
            }
        }
        let published = ViewpointOptions { update: Update::Published, ..options(Measure::Entropy, alpha) };
        check(&witnessed(&mesh, &seen, Some(&regions), published).1, false);
    }
}

#[test]
fn the_first_collapse_is_the_cheapest_of_all() {
    let mesh = fixtures::sphere(12, 8);
    let seen = views(Cameras::Icosahedron, 40, &mesh);
    for measure in [Measure::Entropy, Measure::MutualInformation] {
        let condition = ViewCondition::new(&mesh, &seen, None, options(measure, 1.0)).unwrap();
        let how = SimplifyOptions::default();
        let mut study = Study::new(&mesh, &how, &condition);
        let mut least = f64::INFINITY;
        for candidate in study.candidates() {
            assert!(study.read(candidate));
            let (cost, deltas) = study.price();
            let (cost, mut deltas) = (cost, deltas.to_vec());
            deltas.sort_unstable();
            let (drawn, expected) = study.draw();
            assert_eq!(deltas, expected);
            assert!((cost - drawn).abs() < 1e-12);
            least = least.min(drawn);
        }
        let (_, witnesses) = witnessed(&mesh, &seen, None, options(measure, 1.0));
        assert!((witnesses[0].drawn.0 - least).abs() < 1e-6, "{} beside {least}", witnesses[0].drawn.0);
    }
}

/// A sphere of radius 1 as a part, scaled.
fn ball(columns: u32, rows: u32, scale: f32) -> Part {
    let mesh = fixtures::sphere(columns, rows);
    let places: Vec<Vec3> = mesh.positions.iter().map(|p| *p * scale).collect();
    let uvs = mesh.positions.iter().map(|p| Vec2::new(p.x, p.y)).collect();
    (places, uvs, mesh.triangles.clone())
}

#[test]
fn what_nobody_sees_goes_first() {
    let (outer, inner) = (ball(16, 10, 1.0), ball(10, 6, 0.5));
    let hidden = outer.0.len() as u32;
    let mesh = parts(&[outer, inner]);
    let seen = views(Cameras::Dodecahedron, 64, &mesh);
    for measure in [Measure::Entropy, Measure::MutualInformation] {
        let (sequence, witnesses) = witnessed(&mesh, &seen, None, options(measure, 1.0));
        check(&witnesses, true);
        let inside = sequence.collapses.iter().filter(|c| c.from >= hidden).count();
        assert!(inside > 40);
        assert!(
            sequence.collapses[..inside].iter().all(|c| c.from >= hidden),
            "all of the hidden ball before the seen one"
        );
    }
}

#[test]
fn a_flat_sheet_of_one_region_costs_nothing_until_its_outline_goes() {
    let mesh = parts(&[flat(6, [0.1, 0.1, 0.8], 0.0)]);
    let regions = Regions { count: 2, maps: vec![RegionMap::Whole(1)] };
    let (sequence, witnesses) = witnessed(&mesh, &[frontal(64)], Some(&regions), options(Measure::Entropy, 1.0));
    let free = witnesses.iter().take_while(|w| w.drawn.0 == 0.0).count();
    // 25 points inside, and 20 along the sides; the four corners stay.
    assert!(free >= 45, "{free}");
    assert!(sequence.faces_after(free) <= 2, "{}", sequence.faces_after(free));
}

#[test]
fn a_painted_part_outlasts_a_plain_one() {
    // Two flat sheets side by side, one of one region, the other with a checkerboard.
    let mut board = sheet(6, [0.5, 0.0, 0.5], |_, _| 0.0, Vec2::new);
    // Its UVs do not follow the surface evenly, so that moving a point shifts the picture.
    board.1.iter_mut().enumerate().for_each(|(i, uv)| *uv += Vec2::splat((i * 7 % 5) as f32 * 0.03));
    let mesh = parts(&[flat(6, [0.0, 0.0, 0.5], 0.0), board]);
    let ids = (0..64).map(|t| 2 + (t / 8 + t % 8) % 2).collect();
    let checker = RegionMap::Picture { width: 8, height: 8, wrap: [Wrap::Repeat; 2], ids, set: 0 };
    let regions = Regions { count: 4, maps: vec![RegionMap::Whole(1), checker] };
    let (sequence, _) = witnessed(&mesh, &[frontal(96)], Some(&regions), options(Measure::Entropy, 1.0));
    let plain = |c: &crate::simplify::Collapse| c.from < 49;
    let half = &sequence.collapses[..sequence.collapses.len() / 2];
    assert!(half.iter().filter(|c| plain(c)).count() > half.len() * 2 / 3);
}

#[test]
fn importance_of_a_vertex_multiplies_what_views_lose() {
    let wavy = |i: u32, j: u32| ((i * 7 + j * 5) % 4) as f32 * 0.03;
    let plain = parts(&[sheet(12, [0.0, 0.0, 1.0], wavy, Vec2::new)]);
    let seen = views(Cameras::Icosahedron, 48, &plain);
    let weighed = |importance: &dyn Fn(f32) -> f32| {
        let mut raw = plain.clone().into_raw();
        raw.importance = Some(raw.positions.iter().map(|p| importance(p.x)).collect());
        let mesh = Mesh::new(raw).unwrap();
        [Measure::Entropy, Measure::MutualInformation].map(|measure| {
            let (sequence, witnesses) = witnessed(&mesh, &seen, None, options(measure, 1.0));
            check(&witnesses, true);
            sequence
        })
    };
    // A common factor leaves the order, and a power of two every bit of it.
    let even = weighed(&|_| 1.0);
    assert_eq!(even, weighed(&|_| 4.0));
    let gone_of_left = |sequence: &CollapseSequence| {
        let half = &sequence.collapses[..sequence.collapses.len() / 2];
        half.iter().filter(|c| plain.positions[c.from as usize].x < 0.5).count() as f64 / half.len() as f64
    };
    for (even, left) in even.iter().zip(&weighed(&|x| if x < 0.5 { 30.0 } else { 1.0 })) {
        let (even, left) = (gone_of_left(even), gone_of_left(left));
        assert!((0.35..0.65).contains(&even) && left < 0.3, "{even} became {left}");
    }
    // What counts nothing, of either sign, goes before anything else.
    for sequence in weighed(&|x| if x < 0.5 { -0.0 } else { 1.0 }) {
        let first = sequence.collapses.iter().position(|c| plain.positions[c.from as usize].x >= 0.5).unwrap();
        assert!(first > 50, "{first}");
    }
}

/// The sequence as users get it, on so many threads.
fn on_threads(threads: usize, mesh: &Mesh, condition: &ViewCondition<'_>) -> CollapseSequence {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let conditions = Conditions { views: Some(condition), ..Conditions::default() };
    pool.install(|| collapse_under(mesh, &[], None, &SimplifyOptions::default(), &conditions))
}

#[test]
fn any_number_of_threads_gives_the_same_log() {
    let mesh = parts(&[ball(16, 12, 1.0), flat(8, [-1.0, -0.5, 2.0], 0.3)]);
    let ids = (0..64).map(|t| 1 + t % 5).collect::<Vec<u32>>();
    let map = |wrap| RegionMap::Picture { width: 8, height: 8, wrap: [wrap; 2], ids: ids.clone().into(), set: 0 };
    let regions = Regions { count: 6, maps: vec![map(Wrap::Repeat), map(Wrap::MirroredRepeat)] };
    let seen = views(Cameras::Dodecahedron, 48, &mesh);
    for measure in [Measure::Entropy, Measure::MutualInformation] {
        for update in [Update::Exact, Update::Published] {
            let how = ViewpointOptions { measure, update, ..ViewpointOptions::default() };
            let condition = ViewCondition::new(&mesh, &seen, Some(&regions), how).unwrap();
            let one = on_threads(1, &mesh, &condition);
            assert!(one.collapses.len() > 100);
            assert_eq!(one, on_threads(2, &mesh, &condition));
            assert_eq!(one, on_threads(3, &mesh, &condition));
            assert_eq!(CollapseSequence::from_blob(&one.to_blob()).unwrap(), one);
        }
    }
}

#[test]
fn hubs_are_priced_and_do_not_take_the_square_of_their_faces() {
    // A cone of 300 faces under a flat cap of as many.
    let n = 300;
    let mut places = vec![Vec3::Y, -Vec3::Y];
    places.extend((0..n).map(|i| {
        let turn = std::f32::consts::TAU * i as f32 / n as f32;
        Vec3::new(turn.cos(), 0.0, turn.sin())
    }));
    let at = |i: u32| 2 + i % n;
    let triangles = (0..n).flat_map(|i| [[0, at(i + 1), at(i)], [1, at(i), at(i + 1)]]).collect();
    let mesh = parts(&[(places.clone(), vec![Vec2::ZERO; places.len()], triangles)]);
    let seen = views(Cameras::Icosahedron, 32, &mesh);
    for measure in [Measure::Entropy, Measure::MutualInformation] {
        let (sequence, witnesses) = witnessed(&mesh, &seen, None, options(measure, 1.0));
        check(&witnesses, true);
        assert!(sequence.report().faces_left < 20, "{}", sequence.report().faces_left);
    }
}

#[test]
fn degenerate_distant_and_empty_meshes_do_no_harm() {
    let line = (vec![Vec3::ZERO, Vec3::X, Vec3::X * 2.0], vec![Vec2::ZERO; 3], vec![[0, 1, 2], [0, 1, 1]]);
    let place = (vec![Vec3::ONE; 3], vec![Vec2::ZERO; 3], vec![[0, 1, 2]]);
    let mut huge = flat(4, [0.0, 0.0, 1.0], 0.0);
    huge.0.iter_mut().for_each(|p| *p = (*p - Vec3::splat(0.5)) * 3e38);
    huge.1.iter_mut().for_each(|uv| *uv *= 1e38);
    let mut far = flat(4, [0.0, 0.0, 1.0], 0.0);
    far.0.iter_mut().for_each(|p| *p += Vec3::splat(1e30));
    let none = (Vec::new(), Vec::new(), Vec::new());
    let ball = ball(8, 5, 1.0);
    for list in
        [vec![line.clone()], vec![place], vec![huge.clone()], vec![far, ball.clone()], vec![none], vec![ball, huge]]
    {
        let mesh = parts(&list);
        let maps =
            vec![
                RegionMap::Picture { width: 2, height: 1, wrap: [Wrap::Repeat; 2], ids: vec![1, 2].into(), set: 0 };
                mesh.submeshes.len()
            ];
        let regions = Regions { count: 3, maps };
        let mut seen = views(Cameras::Icosahedron, 16, &mesh);
        // Eyes inside the model, views beside it, and views of nothing.
        seen.push(View { distance: Some(0.3), centre: DVec3::ZERO, ..frontal(16) });
        seen.push(View { centre: DVec3::splat(1e20), ..frontal(16) });
        seen.push(View { pixels_per_unit: f64::INFINITY, ..frontal(16) });
        seen.push(View { pixels_per_unit: f64::NAN, distance: Some(f64::NAN), ..frontal(16) });
        for measure in [Measure::Entropy, Measure::MutualInformation] {
            for regions in [Some(&regions), None] {
                let (sequence, witnesses) = witnessed(&mesh, &seen, regions, options(measure, 0.75));
                check(&witnesses, true);
                assert!(witnesses.iter().all(|w| w.known.0.is_finite()));
                assert!(sequence.collapses.iter().all(|c| !c.error.is_nan()));
            }
        }
    }
}

#[test]
fn what_cannot_be_used_is_said() {
    let mesh = parts(&[flat(2, [0.0, 0.0, 1.0], 0.0)]);
    let said = |views: &[View], regions: Option<&Regions>, alpha: f64| {
        ViewCondition::new(&mesh, views, regions, options(Measure::Entropy, alpha)).err()
    };
    let one = [frontal(16)];
    assert_eq!(said(&one, None, 1.0), None);
    assert_eq!(said(&one, None, 0.0), Some(ViewpointError::Alpha(0.0)));
    assert!(said(&one, None, f64::NAN).is_some());
    assert_eq!(said(&[], None, 1.0), Some(ViewpointError::Views(0)));
    assert_eq!(said(&[frontal(16), frontal(17)], None, 1.0), Some(ViewpointError::Size(17)));
    assert_eq!(said(&[frontal(0)], None, 1.0), Some(ViewpointError::Size(0)));
    assert_eq!(said(&[frontal(5000)], None, 1.0), Some(ViewpointError::Size(5000)));
    let with = |maps: Vec<RegionMap>| said(&one, Some(&Regions { count: 2, maps }), 1.0);
    let cut = RegionMap::Picture { width: 2, height: 2, wrap: [Wrap::Repeat; 2], ids: vec![1; 3].into(), set: 0 };
    let strange = RegionMap::Picture { width: 1, height: 1, wrap: [Wrap::Repeat; 2], ids: vec![2].into(), set: 0 };
    for maps in [vec![], vec![RegionMap::Whole(2)], vec![cut], vec![strange]] {
        assert!(matches!(with(maps), Some(ViewpointError::Regions(0, _))));
    }
    // A stack of 2^21 squares over 64 pixels is more than memory should be asked for.
    let deep = ViewpointError::Fragments(FRAGMENT_LIMIT + 1).to_string();
    assert!(deep.contains("simplify first"), "{deep}");
}

#[test]
fn texture_borders_on_top_add_their_share_of_the_area() {
    use crate::simplify::metric::bordered::Bordered;
    use crate::simplify::{BorderCost, TextureBorderOptions, TextureBorders};
    use kiln_asset::{
        ImageFormat, ImageId, ImageInfo, Material, MaterialId, MaterialSet, Raster, Sampler, Texture, TextureId,
        TextureRef,
    };
    use std::sync::Arc;

    let mut raw = parts(&[flat(4, [0.0, 0.0, 1.0], 0.0)]).into_raw();
    raw.submeshes[0].material = Some(MaterialId(0));
    let mesh = Mesh::new(raw).unwrap();
    let base_color = Some(TextureRef { texture: TextureId(0), uv_set: 0 });
    let materials = MaterialSet {
        materials: vec![Material { base_color, ..Material::default() }],
        textures: vec![Texture { image: ImageId(0), sampler: Sampler::default() }],
        images: vec![ImageInfo { name: "halves".into(), format: ImageFormat::Png, hash: [0; 32] }],
        ..MaterialSet::default()
    };
    // Dark on the left, light on the right of u = 0.3.
    let texels = (0..64 * 64).map(|t| if t % 64 < 20 { [0, 0, 0, 255] } else { [255; 4] }).collect();
    let picture = Arc::new(Raster { width: 64, height: 64, texels });
    let how = TextureBorderOptions { cost: BorderCost::Area, weight: 2.0, ..TextureBorderOptions::default() };
    let borders = TextureBorders::new(&mesh, &materials, &|_| Ok(Arc::clone(&picture)), &how).unwrap();
    let options = SimplifyOptions::default();
    let topology = Topology::new(&mesh);
    let forms = Forms::new(&mesh, &topology, &[], &options);
    let (work, metric) = prepared(&mesh, (&topology, &forms), None, &options, &[]);
    let metric = Bordered::new(metric, &mesh, &borders, &work);
    // Points stand in rows of 5; the edge from (1, 1) to (2, 1) crosses u = 0.3 and lies on 2 of 32 triangles; that to (1, 2) does not cross.
    let local = |point: u32| work.names.points.iter().position(|p| *p == point).unwrap() as u32;
    let surcharge = |from, to| crate::simplify::metric::Metric::surcharge(&metric, &work, local(from), local(to));
    near(surcharge(6, 7), 2.0 * 2.0 / 32.0);
    near(surcharge(6, 11), 0.0);
    near(surcharge(18, 17), 0.0);

    // The views see one region, so borders alone order the points inside.
    let regions = Regions { count: 2, maps: vec![RegionMap::Whole(1)] };
    let condition = ViewCondition::new(&mesh, &[frontal(32)], Some(&regions), ViewpointOptions::default()).unwrap();
    let conditions = Conditions { views: Some(&condition), borders: Some(&borders), ..Conditions::default() };
    let sequence = collapse_under(&mesh, &[], None, &options, &conditions);
    let first = sequence.collapses[0];
    assert!(surcharge(first.from, first.to) == 0.0);
    assert!(sequence.report().faces_left < 32);
}

#[test]
fn a_hair_in_front_or_behind_decides() {
    // Sheets that fill the screen; the second lies less than a thousandth of a pixel behind the first but for a few points in front of it.
    let hair = |i: u32, j: u32| if (i * 5 + j * 3).is_multiple_of(4) { 1e-5 } else { -1e-5 };
    let mesh = parts(&[flat(3, [-0.5, -0.5, 2.0], 0.0), sheet(8, [-0.5, -0.5, 2.0], hair, Vec2::new)]);
    let regions = Regions { count: 3, maps: vec![RegionMap::Whole(1), RegionMap::Whole(2)] };
    let seen = [frontal(32), View { distance: Some(3.0), ..frontal(32) }];
    for regions in [Some(&regions), None] {
        let (sequence, witnesses) = witnessed(&mesh, &seen, regions, options(Measure::Entropy, 1.0));
        check(&witnesses, true);
        assert!(sequence.collapses.len() > 50);
        assert!(witnesses.iter().any(|witness| witness.drawn.0 > 0.0));
    }
}
