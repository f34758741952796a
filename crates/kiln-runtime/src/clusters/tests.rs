use std::collections::BTreeMap;

use kiln_asset::{Mesh, RawMesh, Submesh, SubmeshId};
use kiln_format::layout::ClusterHeader;
use kiln_lod::cluster_dag::{ClusterDag, ClusterDagOptions};
use proptest::prelude::*;

use super::*;

/// A closed, bumpy sphere.
pub(crate) fn mesh(columns: u32, rows: u32) -> Mesh {
    let place = |r: u32, c: u32| {
        let (polar, turn) =
            (std::f32::consts::PI * r as f32 / rows as f32, std::f32::consts::TAU * c as f32 / columns as f32);
        let p: [f32; 3] = [polar.sin() * turn.cos(), polar.cos(), polar.sin() * turn.sin()];
        let bump: f32 = 1.0 + 0.06 * (9.0 * p[0]).sin() * (6.0 * p[1] + 1.0).cos();
        p.map(|c| c * bump).into()
    };
    let mut raw = RawMesh { submeshes: vec![Submesh::default()], ..RawMesh::default() };
    raw.positions.push(place(0, 0));
    raw.positions.extend((1..rows).flat_map(|r| (0..columns).map(move |c| place(r, c))));
    raw.positions.push(place(rows, 0));
    let last = raw.positions.len() as u32 - 1;
    let at = |r: u32, c: u32| 1 + (r - 1) * columns + c % columns;
    for c in 0..columns {
        raw.triangles.push([0, at(1, c + 1), at(1, c)]);
        for r in 1..rows - 1 {
            raw.triangles.push([at(r, c), at(r, c + 1), at(r + 1, c)]);
            raw.triangles.push([at(r, c + 1), at(r + 1, c + 1), at(r + 1, c)]);
        }
        raw.triangles.push([last, at(rows - 1, c), at(rows - 1, c + 1)]);
    }
    raw.face_submesh = vec![SubmeshId(0); raw.triangles.len()];
    Mesh::new(raw).expect("sound")
}

pub(crate) fn dag(mesh: &Mesh) -> ClusterDag {
    ClusterDag::new(mesh, &ClusterDagOptions::default()).expect("a dag")
}

/// A DAG as a container lends it.
pub(crate) fn view(dag: &ClusterDag) -> ClusterView<'_> {
    ClusterView {
        header: ClusterHeader {
            clusters: dag.clusters.len() as u32,
            groups: dag.groups.len() as u32,
            levels: dag.levels,
            references: dag.references.len() as u32,
            triangles: (dag.corners.len() / 3) as u32,
            vertices: dag.vertices,
            reserved: [0; 10],
        },
        clusters: bytemuck::cast_slice(&dag.clusters),
        groups: bytemuck::cast_slice(&dag.groups),
        references: &dag.references,
        corners: &dag.corners,
    }
}

/// Views all around and inside, from far below a pixel to far above.
pub(crate) fn views(count: u32) -> impl Iterator<Item = Detail> {
    (0..count).map(|i| {
        let turn = |k: u32| (((i + 1) * k) as f32 * 0.618_034).fract() * 2.0 - 1.0;
        Detail::View {
            eye: [1, 3, 7].map(|k| 4.0 * turn(k)),
            scale: 10.0_f32.powf(4.0 * turn(11)),
            near: 0.1 * (i % 2) as f32,
        }
    })
}

fn is_closed(indices: &[u32]) -> bool {
    let mut edges: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for t in indices.chunks_exact(3) {
        for k in 0..3 {
            *edges.entry((t[k], t[(k + 1) % 3])).or_insert(0) += 1;
        }
    }
    edges.iter().all(|((a, b), count)| *count == 1 && edges.get(&(*b, *a)) == Some(&1))
}

#[test]
fn an_error_selects_what_the_builder_cuts() {
    let mesh = mesh(70, 40);
    let dag = dag(&mesh);
    let view = view(&dag);
    let mut out = Vec::new();
    for group in dag.groups.iter().step_by(3) {
        for threshold in [group.error, group.error * 0.999] {
            select(&view, Detail::Error(threshold), &mut out);
            assert_eq!(out, dag.cut(threshold));
            assert_eq!(triangle_count(&view, Detail::Error(threshold)), dag.triangles_at(threshold));
        }
    }
    select(&view, Detail::Error(-1.0), &mut out);
    let mut finest = Vec::new();
    indices(&view, &out, &mut finest);
    assert_eq!(finest.len(), 3 * mesh.face_count());
}

#[test]
fn every_view_draws_each_part_once() {
    let dag = dag(&mesh(70, 40));
    let view = view(&dag);
    let (mut clusters, mut buffer, mut counts) = (Vec::new(), Vec::new(), Vec::new());
    for detail in views(300) {
        select(&view, detail, &mut clusters);
        indices(&view, &clusters, &mut buffer);
        assert!(is_closed(&buffer), "{detail:?}");
        assert_eq!(buffer.len() as u64, 3 * triangle_count(&view, detail));
        counts.push(clusters.len());
    }
    counts.sort_unstable();
    counts.dedup();
    assert!(counts.len() > 10, "the views do not differ: {counts:?}");
}

#[test]
fn an_error_is_allowed_from_its_distance_on() {
    // One cluster, replaced by one of a group with error 0.5 and radius 1 about the origin.
    let group = |error, first_cluster| GroupRecord {
        sphere: [0.0, 0.0, 0.0, 1.0],
        error,
        first_cluster,
        cluster_count: 1,
        level: first_cluster,
    };
    let cluster = |group, made_by| ClusterRecord {
        triangle_count: 1 + 9 * u32::from(made_by == NONE),
        group,
        made_by,
        ..bytemuck::Zeroable::zeroed()
    };
    let (groups, clusters) = ([group(0.5, 0), group(f32::MAX, 1)], [cluster(0, NONE), cluster(1, 0)]);
    let header = bytemuck::Zeroable::zeroed();
    let view = ClusterView { header, clusters: &clusters, groups: &groups, references: &[], corners: &[] };
    // A tenth of a turn over 1000 pixels: at distance 1 a unit covers 1000 / (2 tan 18 degrees) pixels.
    let of = |distance: f32, px: f32| {
        let detail = Detail::of_view([distance, 0.0, 0.0], 0.2 * std::f32::consts::PI, 1000.0, px);
        selected(&view, detail).collect::<Vec<_>>()
    };
    let covers = 1000.0 / (2.0 * (0.1 * std::f32::consts::PI).tan());
    let far = 1.0 + 0.5 * covers / 2.0;
    assert_eq!((of(far * 0.999, 2.0), of(far * 1.001, 2.0)), (vec![0], vec![1]));
    assert_eq!((of(far * 1.001, 1.9), of(far * 0.999, 2.1)), (vec![0], vec![1]));
    // Inside the sphere, and for what is no view, all there is.
    assert_eq!((of(0.5, 1e9), of(1e9, 0.0), of(1.0, f32::NAN)), (vec![0], vec![0], vec![0]));
    let budget = within_budget(&view, Detail::Error(0.0), 5);
    assert_eq!(budget, Detail::Error(0.5));
}

#[test]
fn budgets_are_met_by_the_most_detail_that_meets_them() {
    let dag = dag(&mesh(70, 40));
    let view = view(&dag);
    for budget in [5000, 1500, 400, 60] {
        let Detail::Error(threshold) = within_budget(&view, Detail::Error(0.0), budget) else { panic!("another kind") };
        assert_eq!(threshold, dag.threshold_for(budget));
        // Within the spheres of large groups, so that the least detail hangs on `near`.
        let (eye, near) = ([0.3, 1.2, 0.2], 0.05);
        let detail = within_budget(&view, Detail::View { eye, scale: f32::INFINITY, near }, budget);
        let Detail::View { scale, .. } = detail else { panic!("another kind") };
        assert!(triangle_count(&view, detail) <= budget);
        assert!(triangle_count(&view, Detail::View { eye, scale: scale.next_up(), near }) > budget);
    }
    // What fits stays as it was; what cannot fit is the least there is.
    assert_eq!(within_budget(&view, Detail::Error(0.01), 1 << 40), Detail::Error(0.01));
    let least = within_budget(&view, Detail::Error(0.0), 0);
    assert_eq!(triangle_count(&view, least), triangle_count(&view, Detail::Error(f32::MAX)));
}

#[test]
fn the_number_is_told_where_there_is_no_room() {
    let dag = dag(&mesh(40, 30));
    let view = view(&dag);
    let all: Vec<u32> = selected(&view, Detail::Error(0.0)).collect();
    let mut room = [u32::MAX; 3];
    assert_eq!(select_into(&view, Detail::Error(0.0), &mut room), all.len());
    assert_eq!(room, all[..3]);
}

#[test]
fn a_cluster_that_faces_away_has_no_face_that_does_not() {
    let mesh = mesh(70, 40);
    let dag = dag(&mesh);
    let view = view(&dag);
    let mut away = 0;
    for detail in views(100) {
        let Detail::View { eye, .. } = detail else { continue };
        for (c, _) in (0..).zip(view.clusters).filter(|(_, cluster)| faces_away(cluster, eye)) {
            away += 1;
            for triangle in triangles(&view, c) {
                // Six times the volume of the tetrahedron with the eye.
                let [a, b, d] = triangle.map(|v| mesh.positions[v as usize].to_array().map(f64::from));
                let from_a = |p: [f64; 3]| [p[0] - a[0], p[1] - a[1], p[2] - a[2]];
                let [b, d, e] = [b, d, eye.map(f64::from)].map(from_a);
                let normal = [b[1] * d[2] - b[2] * d[1], b[2] * d[0] - b[0] * d[2], b[0] * d[1] - b[1] * d[0]];
                assert!(normal[0] * e[0] + normal[1] * e[1] + normal[2] * e[2] <= 1e-6);
            }
        }
    }
    assert!(away > 100, "{away}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn whatever_the_records_say_nothing_panics(
        words in prop::collection::vec(prop_oneof![0..6_u32, any::<u32>(), Just(NONE)], 0..200),
        corners in prop::collection::vec(any::<u8>(), 0..40), eye in prop::array::uniform3(any::<f32>()), x in any::<f32>(),
    ) {
        let records = |size: usize| &words[..words.len() / size * size];
        let header = bytemuck::Zeroable::zeroed();
        let view = ClusterView {
            header,
            clusters: bytemuck::cast_slice(records(16)),
            groups: bytemuck::cast_slice(records(8)),
            references: &words,
            corners: &corners,
        };
        let (mut clusters, mut buffer) = (Vec::new(), Vec::new());
        for detail in [Detail::Error(x), Detail::View { eye, scale: x, near: eye[0] }] {
            select(&view, detail, &mut clusters);
            indices(&view, &clusters, &mut buffer);
            prop_assert!(buffer.len() <= 3 * 128 * clusters.len());
            let _ = (within_budget(&view, detail, 3), select_into(&view, detail, &mut [0; 2]));
        }
        view.clusters.iter().for_each(|cluster| { faces_away(cluster, eye); });
        prop_assert_eq!(triangles(&view, u32::MAX).count(), 0);
    }
}
