use kiln_asset::{Mesh, RawMesh, Submesh, SubmeshId};
use kiln_format::layout::{Checkpoint, WindowHeader};
use kiln_format::{DrawRange, Indices, WindowView, record::NONE};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{CollapseSequence, SimplifyOptions, collapse};
use kiln_lod::sliding_window::SlidingWindow;
use proptest::prelude::*;

use super::{Window, WindowLod};
use crate::View;

/// What a container lends of a window.
pub(crate) struct Held {
    pub(crate) positions: Vec<[f32; 3]>,
    header: WindowHeader,
    checkpoints: Vec<Checkpoint>,
    parents: Vec<u32>,
    starts: Vec<u32>,
    indices: Vec<u32>,
    ranges: Vec<DrawRange>,
}

fn range(first_index: u32, index_count: u32) -> DrawRange {
    DrawRange {
        first_index,
        index_count,
        first_vertex: 0,
        vertex_count: 0,
        bounds_min: [0.0; 3],
        bounds_max: [0.0; 3],
        reserved: [0; 2],
    }
}

fn checkpoint(detail: u32, error: f32) -> Checkpoint {
    Checkpoint { detail, vertices: 0, triangles: 0, error, level: NONE, reserved: [0; 3] }
}

impl Held {
    fn new(window: &SlidingWindow, level0: &Mesh) -> Held {
        let mut first = 0;
        let mut next = |faces: &u32| {
            let range = range(first, 3 * faces);
            first += 3 * faces;
            range
        };
        Held {
            positions: level0.positions.iter().map(|p| p.to_array()).collect(),
            header: WindowHeader {
                vertices: window.vertex_count() as u32,
                triangles: window.face_count() as u32,
                collapses: window.collapses(),
                base_vertices: window.base_vertices(),
                checkpoints: 0,
                flags: u32::from(!window.starts().is_empty()),
                reserved: [0; 10],
            },
            checkpoints: Vec::new(),
            parents: window.parents().to_vec(),
            starts: window.starts().to_vec(),
            indices: level0.triangles.iter().flatten().copied().collect(),
            ranges: window.submesh_faces().iter().map(&mut next).collect(),
        }
    }

    pub(crate) fn window(&self) -> Window<'_> {
        let Held { header, checkpoints, parents, starts, .. } = self;
        Window::new(
            WindowView { header: *header, checkpoints, parents, starts },
            Indices::U32(&self.indices),
            &self.ranges,
        )
    }
}

/// A wavy sheet of `columns x rows` quads in two merged submeshes; every `chart`-th column begins a chart with wedges of its own.
pub(crate) fn sheet(columns: u32, rows: u32, chart: u32, seed: u32) -> Mesh {
    let mut raw = RawMesh::default();
    let (mut uv, mut of) = (Vec::new(), std::collections::BTreeMap::new());
    for x in 0..columns {
        for y in 0..rows {
            let mut corner = |[dx, dy]: [u32; 2]| {
                let (x0, y0, side) = (x + dx, y + dy, u32::from(2 * x >= columns));
                *of.entry((x0, y0, x / chart, side)).or_insert_with(|| {
                    let noise = (x0 * 73 + y0 * 151 + seed).wrapping_mul(2_654_435_761) >> 24;
                    raw.positions.push([x0 as f32, y0 as f32, noise as f32 / 400.0].into());
                    uv.push([x0 as f32 + 100.0 * (x / chart) as f32, y0 as f32].into());
                    raw.positions.len() as u32 - 1
                })
            };
            let [a, b, c, d] = [[0, 0], [1, 0], [1, 1], [0, 1]].map(&mut corner);
            raw.triangles.extend([[a, b, c], [a, c, d]]);
            raw.face_submesh.extend([SubmeshId(u32::from(2 * x >= columns)); 2]);
        }
    }
    raw.uv0 = Some(uv);
    raw.submeshes = ["left", "right"].map(|name| Submesh { name: name.into(), ..Submesh::default() }).to_vec();
    merge(&Mesh::new(raw).unwrap(), &MergeOptions::default()).0
}

/// The same in one submesh and one chart: every vertex is a point.
pub(crate) fn one_submesh(columns: u32, rows: u32, seed: u32) -> Mesh {
    let mesh = sheet(columns, rows, columns, seed);
    let place = |v: &u32| mesh.points[*v as usize].0;
    let mut raw = RawMesh { submeshes: vec![mesh.submeshes[0].clone()], ..RawMesh::default() };
    raw.positions = vec![mesh.positions[0]; mesh.point_count()];
    mesh.points.iter().zip(&mesh.positions).for_each(|(point, place)| raw.positions[point.index()] = *place);
    raw.triangles = mesh.triangles.iter().map(|t| [place(&t[0]), place(&t[1]), place(&t[2])]).collect();
    raw.face_submesh = vec![SubmeshId(0); raw.triangles.len()];
    Mesh::new(raw).unwrap()
}

pub(crate) fn made(mesh: &Mesh) -> (CollapseSequence, SlidingWindow, Mesh, Held) {
    let sequence =
        collapse(mesh, &[], None, &SimplifyOptions { turn_cosine: -0.5, attributes: false, ..Default::default() });
    let window = SlidingWindow::new(mesh, &sequence, 0).unwrap();
    let level0 = window.apply(mesh).unwrap();
    let held = Held::new(&window, &level0);
    (sequence, window, level0, held)
}

fn sheets() -> impl Strategy<Value = Mesh> {
    (2..10_u32, 2..8_u32, 1..12_u32, 0..1000_u32)
        .prop_map(|(columns, rows, chart, seed)| sheet(columns, rows, chart, seed))
}

fn all_picks(window: &Window<'_>, lod: WindowLod) -> Vec<u32> {
    let mut picks = vec![0; window.vertex_count() as usize];
    window.picks(lod, &mut picks);
    picks
}

/// What all vertices pick of their positions.
pub(crate) fn picked(window: &Window<'_>, lod: WindowLod, source: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let mut out = source.to_vec();
    window.pick_elements(lod, &all_picks(window, lod), 0, source, &mut out);
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn every_lod_is_the_chain_s_and_the_sequence_s(mesh in sheets(), piece in 1_usize..40) {
        let (sequence, made, level0, held) = made(&mesh);
        let window = held.window();
        for detail in 0..=made.collapses() {
            let lod = window.lod(detail);
            prop_assert_eq!((lod.detail(), lod.vertices()), (detail, made.vertices_at(detail)));
            prop_assert_eq!(window.lod_of_vertices(lod.vertices()), lod);
            let chain = |v: u32| std::iter::once(v).chain(made.chain(v)).find(|v| *v < lod.vertices()).unwrap();
            let picks = all_picks(&window, lod);
            prop_assert_eq!(&picks, &(0..window.vertex_count()).map(chain).collect::<Vec<u32>>());

            let mut positions = vec![[0.0; 3]; picks.len()];
            for (i, out) in positions.chunks_mut(piece).enumerate() {
                window.pick_elements(lod, &picks[i * piece..], (i * piece) as u32, &held.positions, out);
            }
            // In rounds of any length, each in pieces.
            let mut by_rounds = vec![0; picks.len()];
            for start in (0..picks.len()).step_by(3 * piece) {
                let (done, rest) = by_rounds.split_at_mut(start);
                for (i, out) in rest[..(3 * piece).min(picks.len() - start)].chunks_mut(piece).enumerate() {
                    window.resolve(lod, done, (start + i * piece) as u32, out);
                }
            }
            prop_assert_eq!(&by_rounds, &picks);
            let gathered: Vec<[f32; 3]> = picks.iter().map(|v| held.positions[*v as usize]).collect();
            prop_assert_eq!(&positions, &gathered);

            let replayed = sequence.replay(&mesh, detail as usize).unwrap();
            let mut total = 0;
            for (submesh, count) in made.triangles_at(&level0, detail).unwrap().into_iter().enumerate() {
                prop_assert_eq!(window.triangles(lod, submesh), count);
                total += u64::from(count);
                let mut indices = vec![u32::MAX; 3 * count as usize];
                for (i, out) in indices.chunks_mut(3 * piece).enumerate() {
                    window.pick_indices(lod, submesh, (i * piece) as u32, out);
                }
                let mut mapped = indices.clone();
                window.map_indices(&picks, submesh, 0, &mut mapped);
                prop_assert_eq!(&mapped, &indices);
                // Picked indices over level 0's vertices, and level 0's indices over picked vertices, are the sequence's level.
                let first = window.ranges()[submesh].first_index as usize;
                let place = |p: [f32; 3]| p.map(f32::to_bits);
                let mut ways = [
                    indices.chunks(3).map(|t| [0, 1, 2].map(|k| place(held.positions[t[k] as usize]))).collect::<Vec<_>>(),
                    held.indices[first..first + indices.len()]
                        .chunks(3)
                        .map(|t| [0, 1, 2].map(|k| place(positions[t[k] as usize])))
                        .collect(),
                    replayed.triangles[replayed.submesh_faces(SubmeshId(submesh as u32))]
                        .iter()
                        .map(|t| t.map(|v| place(replayed.positions[v as usize].to_array())))
                        .collect(),
                ];
                ways.iter_mut().for_each(|way| way.sort_unstable());
                prop_assert_eq!(&ways[0], &ways[2]);
                prop_assert_eq!(&ways[1], &ways[2]);
            }
            prop_assert_eq!(window.triangle_count(lod), total);
        }
    }

    #[test]
    fn an_update_between_any_two_lods_gives_fresh_picks(mesh in sheets(), hops in prop::collection::vec(0.0..1.0_f64, 1..12)) {
        let (.., held) = made(&mesh);
        let window = held.window();
        let mut lod = window.lod(0);
        let mut picks = all_picks(&window, lod);
        for hop in hops {
            let next = window.lod((hop * f64::from(window.collapses() + 1)) as u32);
            let (before, fresh) = (picks.clone(), all_picks(&window, next));
            let mut changes = Vec::new();
            window.update(lod, next, &mut picks, |v, pick| changes.push((v, pick)));
            prop_assert_eq!(&picks, &fresh);
            let differ = (0..).zip(before.iter().zip(&fresh)).filter(|(_, (a, b))| a != b).map(|(v, (_, b))| (v, *b));
            prop_assert_eq!(changes, differ.collect::<Vec<(u32, u32)>>());
            lod = next;
        }
    }

    #[test]
    fn a_triangle_budget_gets_the_finest_lod_that_meets_it(mesh in sheets(), share in 0.0..1.1_f64) {
        let (.., held) = made(&mesh);
        let window = held.window();
        let budget = (share * f64::from(held.header.triangles)) as u64;
        let meets = |d: &u32| window.triangle_count(window.lod(*d)) <= budget;
        let expected = (0..=window.collapses()).find(meets).unwrap_or(window.collapses());
        prop_assert_eq!(window.lod_for_triangles(budget).detail(), expected);
    }

    #[test]
    fn a_morph_begins_at_the_finer_and_ends_at_the_coarser_lod(mesh in sheets(), a in 0.0..1.0_f64, b in 0.0..1.0_f64) {
        let (.., held) = made(&mesh);
        let window = held.window();
        let lod = |share: f64| window.lod((share * f64::from(window.collapses())) as u32);
        let lods = [lod(a.min(b)), lod(a.max(b))];
        let morphed = |factor: f32| {
            let mut out = vec![[f32::NAN; 3]; held.positions.len()];
            let (front, back) = out.split_at_mut(held.positions.len() / 3);
            window.morph_positions(lods, factor, 0, &held.positions, front);
            window.morph_positions(lods, factor, front.len() as u32, &held.positions, back);
            out
        };
        let [fine, coarse] = lods.map(|lod| picked(&window, lod, &held.positions));
        prop_assert_eq!(morphed(0.0), fine.clone());
        prop_assert_eq!(morphed(1.0), coarse.clone());
        for (at, (a, b)) in morphed(0.25).iter().zip(fine.iter().zip(&coarse)) {
            (0..3).for_each(|k| assert!((at[k] - (0.75 * a[k] + 0.25 * b[k])).abs() < 1e-5));
        }
    }
}

/// The paper's example as far as its text gives it, in kiln's numbers (n - 1 - k for the paper's k): 0 goes to 1, 1 to 5, 2 to 7.
fn section(parents: &[u32]) -> Window<'_> {
    let header = WindowHeader {
        vertices: 8,
        triangles: 0,
        collapses: 3,
        base_vertices: 5,
        checkpoints: 0,
        flags: 0,
        reserved: [0; 10],
    };
    Window::new(WindowView { header, checkpoints: &[], parents, starts: &[] }, Indices::U32(&[]), &[])
}

#[test]
fn figure_3_mended_gives_what_an_update_gives() {
    let window = section(&[0, 1, 2, 3, 4, 0, 2, 6]);
    // Each vertex' chain in the paper's numbers, itself first.
    let evolution: [&[u32]; 8] = [&[0, 1, 5], &[1, 5], &[2, 7], &[3], &[4], &[5], &[6], &[7]];
    let printed = |current: &mut [u32], to: u32, end: u32| {
        for v in 0..end as usize {
            let at = evolution[v].iter().find(|e| **e >= to).expect("the last never goes");
            current[v] = *at;
        }
    };
    let mirrored = |picks: &[u32]| picks.iter().rev().map(|p| 7 - p).collect::<Vec<u32>>();
    let mut stale = false;
    for (from, to) in (0..4).flat_map(|a| (0..4).map(move |b| (a, b))) {
        let mut current: Vec<u32> = mirrored(&all_picks(&window, window.lod(from)));
        let mut as_printed = current.clone();
        let mut picks = all_picks(&window, window.lod(from));
        window.update(window.lod(from), window.lod(to), &mut picks, |_, _| ());
        printed(&mut current, to, from.max(to));
        assert_eq!(current, mirrored(&picks), "from {from} to {to}");
        // The printed loop stops at the new LOD, and leaves vertices behind that must come back.
        printed(&mut as_printed, to, to);
        stale |= as_printed != current;
        assert!(to < from || as_printed == current);
    }
    assert!(stale);
    assert_eq!(mirrored(&all_picks(&window, window.lod(1))), [1, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(mirrored(&all_picks(&window, window.lod(2))), [5, 5, 2, 3, 4, 5, 6, 7]);
}

#[test]
fn rounds_follow_each_other_to_the_end() {
    let parents: Vec<u32> = (0..1_000_000).map(|v: u32| v / 2).collect();
    let header =
        WindowHeader { vertices: 1_000_000, collapses: 999_999, base_vertices: 1, ..section(&[]).view().header };
    let window =
        Window::new(WindowView { header, checkpoints: &[], parents: &parents, starts: &[] }, Indices::U32(&[]), &[]);
    for detail in [0, 10, 500_000, 999_000, 999_999] {
        let lod = window.lod(detail);
        let (mut next, mut count) = (0, 0);
        for range in window.rounds(lod) {
            assert!(range.start == next && range.end > next);
            (next, count) = (range.end, count + 1);
        }
        assert_eq!(next, 1_000_000);
        assert!(count <= 25, "{count} rounds");
    }
}

#[test]
fn errors_choose_between_checkpoints() {
    let (.., mut held) = made(&sheet(9, 9, 20, 3));
    let last = held.window().collapses();
    held.checkpoints = vec![checkpoint(0, 0.0), checkpoint(10, 0.1), checkpoint(30, 0.1), checkpoint(last, 0.5)];
    let window = held.window();
    let detail = |error: f32| window.lod_for_error(error).detail();
    assert_eq!([0.0, 0.05, 0.1, 0.3, 0.5, 9.0, f32::INFINITY].map(detail)[..3], [0, 5, 30]);
    assert_eq!([0.5, 9.0, f32::INFINITY].map(detail), [last; 3]);
    assert!((30..last).contains(&detail(0.3)) && detail(0.3) - 30 == (last - 30) / 2, "{} of {last}", detail(0.3));
    assert_eq!([-1.0, f32::NAN].map(detail), [0; 2]);
    let measured = |error: f32| window.checkpoint_for_error(error).map(|c| c.detail);
    assert_eq!([0.05, 0.1, 0.4, 0.5, -1.0].map(measured), [0, 30, 30, last, 0].map(Some));
    // One unit is 100 pixels at distance 1.
    let view =
        |distance: f32| View { distance, vertical_fov_radians: std::f32::consts::FRAC_PI_2, viewport_height_px: 200.0 };
    assert_eq!(window.lod_for_view(&view(5.0), 1.0).detail(), detail(0.05 * 1.0001));
    assert_eq!(window.lod_for_view(&view(1000.0), 1.0).detail(), last);
    assert_eq!([0.0, f32::NAN].map(|d| window.lod_for_view(&view(d), 1.0).detail()), [0; 2]);
}

proptest! {
    #[test]
    fn hostile_views_end_within_bounds(
        parents in prop::collection::vec(prop_oneof![0..40_u32, any::<u32>()], 0..40),
        starts in prop::collection::vec(any::<u32>(), 0..4),
        numbers in prop::array::uniform4(prop_oneof![0..50_u32, any::<u32>()]),
        indices in prop::collection::vec(prop_oneof![0..40_u32, any::<u32>()], 0..60),
        spans in prop::collection::vec((prop_oneof![0..70_u32, any::<u32>()], prop_oneof![0..70_u32, any::<u32>()]), 0..4),
        errors in prop::collection::vec((any::<u32>(), any::<f32>()), 0..4),
        first in prop_oneof![0..50_u32, any::<u32>()],
    ) {
        let [vertices, collapses, base_vertices, triangles] = numbers;
        let header =
            WindowHeader { vertices, triangles, collapses, base_vertices, checkpoints: 9, flags: 1, reserved: [7; 10] };
        let checkpoints: Vec<Checkpoint> = errors.iter().map(|(detail, error)| checkpoint(*detail, *error)).collect();
        let ranges: Vec<DrawRange> = spans.iter().map(|(first, count)| range(*first, *count)).collect();
        let view = WindowView { header, checkpoints: &checkpoints, parents: &parents, starts: &starts };
        let window = Window::new(view, Indices::U32(&indices), &ranges);
        let lods = [0, 1, 5, u32::MAX].map(|d| window.lod(d));
        let source: Vec<[f32; 3]> = (0..parents.len()).map(|v| [v as f32; 3]).collect();
        for lod in lods {
            let picks = all_picks(&window, lod);
            let walked: Vec<u32> = (0..picks.len() as u32).map(|v| window.pick(lod, v)).collect();
            prop_assert_eq!(&picks, &walked);
            prop_assert!(picks.iter().all(|v| (*v as usize) < parents.len()));
            window.resolve(lod, &[], first, &mut [0; 9]);
            window.resolve(lod, &parents, first, &mut [0; 9]);
            window.resolve(lod, &picks[..picks.len() / 2], picks.len() as u32 / 2, &mut [0; 99]);
            window.pick_elements(lod, &picks, first, &source, &mut [[0.0; 3]; 9]);
            window.pick_elements(lod, &indices, 0, &source[..source.len() / 2], &mut [[0.0; 3]; 50]);
            window.pick_elements(lod, &picks, 0, &source, &mut [[0.0; 3]; 3]);
            prop_assert_eq!(window.rounds(lod).last().map_or(0, |r| r.end as usize), parents.len());
            window.morph_positions([lod, lods[2]], 0.5, first, &source, &mut [[0.0; 3]; 9]);
            let mut table = vec![u32::MAX; 50];
            window.update(lods[1], lod, &mut table, |_, _| ());
            window.update(lod, lods[1], &mut table[..3], |_, _| ());
            for submesh in 0..5 {
                prop_assert!(window.triangles(lod, submesh) as usize <= indices.len() / 3);
                window.pick_indices(lod, submesh, first, &mut [0; 9]);
                window.map_indices(&table, submesh, 0, &mut [0; 9]);
            }
            window.lod_of_vertices(first);
            window.lod_for_triangles(u64::from(first));
        }
        for error in [0.0, 1.0, f32::NAN, f32::INFINITY] {
            window.lod_for_error(error);
            window.checkpoint_for_error(error);
        }
    }
}
