use glam::{Vec2, Vec3};
use kiln_asset::{BlobError, Mesh, PointId, SubmeshId};
use proptest::prelude::*;

use super::*;
use crate::fixtures;
use crate::simplify::error::Surface;
use crate::simplify::{Collapse, CollapseSequence, SimplifyOptions, collapse};

/// The section of figures 1, 2 and 4, as far as the paper's text gives it (its pictures are lost): vertices 4 and 0 inside a ring,
/// vertex 4 goes to 0 and takes triangles 6 and 2 along, then 0 goes to what becomes the paper's vertex 5. A third collapse
/// along the border takes one triangle only.
fn section() -> (Mesh, CollapseSequence) {
    let triangles = [[0, 1, 2], [0, 2, 3], [0, 4, 1], [0, 3, 5], [4, 5, 6], [4, 6, 7], [0, 5, 4], [4, 7, 1]];
    let mesh = fixtures::soup(&triangles);
    let mut sequence = CollapseSequence::new(8, 8);
    let steps: [(u32, u32, &[u32]); 3] = [(4, 0, &[6, 2]), (0, 5, &[3, 4]), (2, 1, &[0])];
    for (from, to, faces) in steps {
        let (first_face, first_pair) = (sequence.faces.len() as u32, sequence.pairs.len() as u32);
        sequence.collapses.push(Collapse { from, to, first_face, first_pair, error: 0.0 });
        sequence.faces.extend(faces);
        sequence.pairs.push([from, to]);
    }
    (mesh, sequence)
}

/// The paper counts from the first to go, kiln from the last: number k of one is number n - 1 - k of the other.
fn printed(v: u32) -> u32 {
    7 - v
}

#[test]
fn the_paper_s_order_of_vertices_and_triangles() {
    let (mesh, sequence) = section();
    let window = SlidingWindow::new(&mesh, &sequence, 0).unwrap();
    // Figure 2: "vertex 4 is now vertex 0 and vertex 0 is now vertex 1".
    let by_print: Vec<u32> = (0..8).map(|k| window.order()[printed(k) as usize]).collect();
    assert_eq!(by_print[..3], [4, 0, 2]);
    // "Triangles 6 and 2 are now the last ones."
    assert_eq!(window.faces(), [1, 5, 7, 0, 3, 4, 2, 6]);
    assert_eq!((window.collapses(), window.base_vertices()), (3, 5));
    assert!(window.starts().is_empty());
}

#[test]
fn the_paper_s_evolutions_and_levels() {
    let (mesh, sequence) = section();
    let window = SlidingWindow::new(&mesh, &sequence, 0).unwrap();
    let evolution = |k: u32| window.chain(printed(k)).map(printed).collect::<Vec<u32>>();
    assert_eq!([0, 1, 2, 5].map(evolution), [vec![1, 5], vec![5], vec![7], vec![]]);
    // Figure 4: at LOD 1 "we would only modify vertex 0" to vertex 1; at LOD 2 both change "for vertex 5".
    let contents =
        |lod: u32| -> Vec<u32> { (0..8).map(|k| printed(window.pick(printed(k), window.vertices_at(lod)))).collect() };
    assert_eq!(contents(0), [0, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(contents(1), [1, 1, 2, 3, 4, 5, 6, 7]);
    assert_eq!(contents(2), [5, 5, 2, 3, 4, 5, 6, 7]);
    assert_eq!(contents(3), [5, 5, 7, 3, 4, 5, 6, 7]);
    // "Decrease the triangle count by two", inside; at the border by one.
    let level0 = window.apply(&mesh).unwrap();
    let counts = [0, 1, 2, 3].map(|lod| window.triangles_at(&level0, lod).unwrap()[0]);
    assert_eq!(counts, [8, 6, 4, 3]);
    let chains = window.chains();
    assert_eq!((chains.elements, chains.longest, chains.mean), (4, 2, 0.5));
    let Storage { indexed, chains, window } = window.storage(12);
    assert_eq!((indexed, chains, window), (192, 208, 224));
}

/// Each face's chart gets wedges of its own, its UVs ten units from the next chart's.
fn charted(mesh: &Mesh, chart: impl Fn(usize) -> u32) -> Mesh {
    let mut raw = mesh.clone().into_raw();
    let mut wedges: Vec<(u32, u32)> = Vec::new();
    for (f, triangle) in raw.triangles.iter_mut().enumerate() {
        for v in triangle {
            let wedge = (*v, chart(f));
            let known = wedges.iter().position(|w| *w == wedge);
            *v = known.unwrap_or_else(|| {
                wedges.push(wedge);
                wedges.len() - 1
            }) as u32;
        }
    }
    let (triangles, face_submesh) = (raw.triangles.clone(), raw.face_submesh.clone());
    let keep: Vec<u32> = wedges.iter().map(|w| w.0).collect();
    let mut raw = raw.gather(&keep, triangles, face_submesh);
    raw.uv0 = Some(
        wedges
            .iter()
            .zip(&raw.positions)
            .map(|((_, chart), p)| p.truncate() * 0.1 + Vec2::X * 10.0 * *chart as f32)
            .collect(),
    );
    Mesh::new(raw).unwrap()
}

/// Meshes with borders, boundaries between submeshes, seams, creases, and some closed.
fn meshes() -> impl Strategy<Value = Mesh> {
    (0..6_u32, 2..5_u32, 2..5_u32, 0..1000_u32).prop_map(|(kind, a, b, seed)| {
        let noise = move |x: f32, y: f32| {
            let cell = (x as u32).wrapping_mul(73).wrapping_add((y as u32).wrapping_mul(151)).wrapping_add(seed);
            (cell.wrapping_mul(2_654_435_761) >> 20) as f32 / 4096.0
        };
        match kind {
            0 => fixtures::field(2 * a, 3 * b, noise),
            1 => fixtures::hard_cube(a + b),
            2 => fixtures::quilt(a - 1, 2, 2 * b, noise),
            3 => charted(&fixtures::quilt(2, 1, 2 * b, noise), |f| (f as u32 / 7 + seed) % a),
            4 => charted(&fixtures::sphere(4 + 2 * a, 3 + b), |f| u32::from(f as u32 % 40 < 20 + seed % 10)),
            _ => fixtures::merged_pair(a, 2 * b),
        }
    })
}

/// `[submesh_count]`: the triangles, each as its corners' attributes.
fn drawn(mesh: &Mesh) -> Vec<Vec<[[u32; 8]; 3]>> {
    let corner = |v: u32| {
        let v = v as usize;
        let p = mesh.positions[v].to_array();
        let n = mesh.normals.as_ref().map_or(Vec3::ZERO, |n| n[v]).to_array();
        let uv = mesh.uv0.as_ref().map_or(Vec2::ZERO, |uv| uv[v]).to_array();
        [p[0], p[1], p[2], n[0], n[1], n[2], uv[0], uv[1]].map(f32::to_bits)
    };
    let of_submesh = |s: u32| {
        let range = mesh.submesh_faces(SubmeshId(s));
        let mut triangles: Vec<_> = mesh.triangles[range].iter().map(|t| t.map(corner)).collect();
        triangles.sort_unstable();
        triangles
    };
    (0..mesh.submeshes.len() as u32).map(of_submesh).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn every_lod_draws_what_the_sequence_has_there(mesh in meshes(), done in 0.0..0.6_f64, attributes: bool) {
        let options = SimplifyOptions { attributes, turn_cosine: -0.5, ..Default::default() };
        let sequence = collapse(&mesh, &[], None, &options);
        let done = (done * sequence.collapses.len() as f64) as usize;
        let window = SlidingWindow::new(&mesh, &sequence, done).unwrap();
        let level0 = window.apply(&sequence.replay(&mesh, done).unwrap()).unwrap();
        prop_assert_eq!(window.collapses() as usize, sequence.collapses.len() - done);
        prop_assert_eq!(window.vertices_at(0) as usize, level0.vertex_count());
        prop_assert_eq!(window.vertices_at(window.collapses()), window.base_vertices());
        for lod in 0..=window.collapses() {
            let level = window.level(&level0, lod).unwrap();
            let replayed = sequence.replay(&mesh, done + lod as usize).unwrap();
            prop_assert_eq!(drawn(&level), drawn(&replayed), "LOD {} of {}", lod, window.collapses());
            prop_assert_eq!(window.lod_of_cut(done + lod as usize), lod);
        }
        prop_assert_eq!(SlidingWindow::from_blob(&window.to_blob()).unwrap(), window);
    }

    #[test]
    fn damaged_blobs_are_refused_or_sound(at in 0_usize..4096, bit in 0_u32..8) {
        let mesh = fixtures::hard_cube(4);
        let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
        let mut bytes = SlidingWindow::new(&mesh, &sequence, 0).unwrap().to_blob();
        let at = at % bytes.len();
        bytes[at] ^= 1 << bit;
        // What is taken is walked to its end.
        if let Ok(window) = SlidingWindow::from_blob(&bytes) {
            for lod in [0, 1, window.collapses() / 2, u32::MAX] {
                let alive = window.vertices_at(lod);
                (0..window.vertex_count() as u32).for_each(|i| assert!(window.pick(i, alive) < alive));
            }
            window.chains();
            let _ = window.apply(&mesh);
        }
    }
}

#[test]
fn every_prefix_of_a_blob_is_refused() {
    let mesh = fixtures::hard_cube(2);
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let window = SlidingWindow::new(&mesh, &sequence, 0).unwrap();
    assert!(!window.starts().is_empty());
    let blob = window.to_blob();
    for end in 0..blob.len() {
        assert!(SlidingWindow::from_blob(&blob[..end]).is_err(), "prefix of {end} bytes was taken");
    }
    let content = |change: &dyn Fn(&mut SlidingWindow)| {
        let mut broken = window.clone();
        change(&mut broken);
        matches!(SlidingWindow::from_blob(&broken.to_blob()), Err(BlobError::Content(_)))
    };
    let last = window.vertex_count() - 1;
    let changes: [&dyn Fn(&mut SlidingWindow); 9] = [
        &|w| w.parents[last] = last as u32,
        &|w| w.parents[last] = w.parents[last - 1] + 1000,
        &|w| w.parents[0] = 1,
        &|w| w.order[0] = w.order[1],
        &|w| w.faces[0] = w.faces[1],
        &|w| w.submesh_faces[0] += 1,
        &|w| w.starts[0] &= !1,
        &|w| w.collapses += 1,
        &|w| w.base_vertices += 1,
    ];
    for (i, change) in changes.iter().enumerate() {
        assert!(content(change), "change {i} was taken");
    }
}

#[test]
fn wedges_of_a_point_go_in_one_step() {
    let mesh = fixtures::hard_cube(6);
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let window = SlidingWindow::new(&mesh, &sequence, 0).unwrap();
    let level0 = window.apply(&mesh).unwrap();
    for lod in 0..window.collapses() {
        let gone = window.vertices_at(lod + 1) as usize..window.vertices_at(lod) as usize;
        let points: Vec<PointId> = level0.points[gone.clone()].to_vec();
        assert!(!points.is_empty() && points.iter().all(|p| *p == points[0]));
        let outside = (0..level0.vertex_count()).filter(|v| !gone.contains(v));
        assert!(outside.into_iter().all(|v| level0.points[v] != points[0]));
    }
}

#[test]
fn sequences_and_levels_that_do_not_fit_are_refused() {
    let (mesh, sequence) = section();
    let made = |sequence: &CollapseSequence| SlidingWindow::new(&mesh, sequence, 0);
    let other = fixtures::grid(3, 3);
    assert!(matches!(SlidingWindow::new(&other, &sequence, 0), Err(WindowError::Sequence(_))));
    assert!(matches!(SlidingWindow::new(&mesh, &sequence, 4), Err(WindowError::Sequence(_))));

    let stay = |c: &Collapse| mesh.positions[c.to as usize].to_array();
    let mut placed = sequence.clone();
    placed.places = sequence.collapses.iter().map(stay).collect();
    assert!(made(&placed).is_ok());
    placed.places[1][2] += 0.5;
    let error = made(&placed).unwrap_err();
    assert!(matches!(error, WindowError::Moves { collapse: 1 }), "{error}");

    for change in [
        |s: &mut CollapseSequence| s.collapses[1].from = 4,
        |s: &mut CollapseSequence| s.collapses[1].to = 4,
        |s: &mut CollapseSequence| s.collapses[1].to = 99,
        |s: &mut CollapseSequence| s.collapses[2].to = 2,
        |s: &mut CollapseSequence| s.pairs[0] = [4, 1],
        |s: &mut CollapseSequence| s.pairs[0] = [1, 0],
        |s: &mut CollapseSequence| s.faces[0] = 5,
        |s: &mut CollapseSequence| s.collapses[2].first_face = 5,
    ] {
        let mut broken = sequence.clone();
        change(&mut broken);
        assert!(matches!(made(&broken), Err(WindowError::Sequence(_))));
    }
    let mut raw = mesh.clone().into_raw();
    raw.triangles[7] = [4, 7, 4];
    let degenerate = SlidingWindow::new(&Mesh::new(raw).unwrap(), &sequence, 0);
    assert!(matches!(degenerate, Err(WindowError::Degenerate { face: 7 })), "{degenerate:?}");

    let window = made(&sequence).unwrap();
    assert!(matches!(window.apply(&other), Err(WindowError::Counts { .. })));
    assert!(matches!(window.level(&other, 0), Err(WindowError::Counts { .. })));
    let mut raw = mesh.clone().into_raw();
    raw.triangles.swap(1, 6);
    assert!(matches!(window.apply(&Mesh::new(raw).unwrap()), Err(WindowError::Order { .. })));
}

#[test]
fn checkpoints_rise_from_the_finest_to_the_coarsest_and_hold_what_was_asked_for() {
    let mesh = fixtures::quilt(2, 1, 12, |x, y| (x * 0.5).sin() * (y * 0.7).cos());
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let window = SlidingWindow::new(&mesh, &sequence, 0).unwrap();
    let level0 = window.apply(&mesh).unwrap();
    let surface = Surface::new(&mesh, 5_000);
    let asked = [7, window.lod_of_cut(sequence.reach(100)), u32::MAX];
    let checkpoints = window.checkpoints(&level0, &surface, 26, &asked).unwrap();
    let [first, .., last] = &checkpoints[..] else { panic!("two at least") };
    assert_eq!((first.detail, first.error, first.triangles), (0, 0.0, mesh.face_count() as u32));
    assert_eq!((last.detail, last.vertices), (window.collapses(), window.base_vertices()));
    assert!((20..=28).contains(&checkpoints.len()), "{}", checkpoints.len());
    for pair in checkpoints.windows(2) {
        assert!(pair[0].detail < pair[1].detail && pair[0].error <= pair[1].error);
        assert!(pair[0].triangles >= pair[1].triangles && pair[0].vertices > pair[1].vertices);
    }
    let at = |lod: u32| checkpoints.iter().find(|c| c.detail == lod).expect("asked for");
    let level = sequence.replay(&mesh, asked[1] as usize).unwrap();
    assert_eq!(at(asked[1]).triangles, level.face_count() as u32);
    assert_eq!(at(asked[1]).error, surface.distance(&level));
    at(7);
    // Levels are measured in the order that the discrete ones have.
    for lod in [0, 1, 40, window.collapses()] {
        let (level, replayed) =
            (window.level_as_it_was(&level0, lod).unwrap(), sequence.replay(&mesh, lod as usize).unwrap());
        assert_eq!((&level.positions, &level.triangles), (&replayed.positions, &replayed.triangles));
        assert_eq!(level.face_submesh, replayed.face_submesh);
    }
}

#[test]
fn a_mesh_without_faces_has_one_lod() {
    let mesh = Mesh::default();
    let window = SlidingWindow::new(&mesh, &CollapseSequence::default(), 0).unwrap();
    assert_eq!((window.collapses(), window.vertices_at(0)), (0, 0));
    assert_eq!(SlidingWindow::from_blob(&window.to_blob()).unwrap(), window);
    assert_eq!(window.level(&window.apply(&mesh).unwrap(), 0).unwrap(), mesh);
}
