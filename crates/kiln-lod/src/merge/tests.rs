use super::*;
use crate::fixtures;
use kiln_asset::{RawMesh, Submesh, SubmeshId};

#[test]
fn touching_borders_of_two_submeshes_share_their_points() {
    let pair = fixtures::pair(4, 3);
    let (merged, report) = merge(&pair, &MergeOptions::default());
    assert_eq!(merged.point_count(), pair.point_count() - 4);
    assert_eq!((report.joined_points, report.joined_edges), (4, 6), "three edges, seen from both sides");
    assert_eq!(merged.positions, pair.positions, "no wedge moved");
    assert_eq!(merged.triangles, pair.triangles);
}

#[test]
fn borders_apart_by_less_than_the_weld_are_joined_and_keep_their_places() {
    let mut raw = fixtures::pair(4, 3).into_raw();
    let half = raw.positions.len() / 2;
    for p in &mut raw.positions[half..] {
        p.x += 0.001;
    }
    let apart = Mesh::new(RawMesh { points: Vec::new(), ..raw }).unwrap();
    assert_eq!(merge(&apart, &MergeOptions { weld: 0.0005 }).1.joined_points, 0);
    let (merged, report) = merge(&apart, &MergeOptions { weld: 0.002 });
    assert_eq!(report.joined_points, 4);
    assert_eq!(merged.positions, apart.positions);
}

#[test]
fn closed_parts_that_touch_are_not_welded() {
    let sphere = fixtures::sphere(8, 6);
    let mut raw = sphere.clone().into_raw();
    let (vertices, faces) = (raw.positions.len() as u32, raw.triangles.len());
    raw.positions.extend_from_within(..);
    for f in 0..faces {
        raw.triangles.push(raw.triangles[f].map(|v| v + vertices));
    }
    raw.face_submesh.extend(vec![SubmeshId(1); faces]);
    raw.submeshes.push(Submesh { name: "other".into(), ..Default::default() });
    raw.points.clear();
    let two = Mesh::new(raw).unwrap();
    let (merged, report) = merge(&two, &MergeOptions { weld: 0.01 });
    assert_eq!(report.joined_points, 0);
    assert_eq!(merged.point_count(), 2 * sphere.point_count());
}

#[test]
fn degenerate_and_duplicate_faces_and_unused_vertices_go_and_are_counted() {
    let mesh = fixtures::soup(&[[0, 1, 2], [1, 2, 0], [0, 0, 3], [2, 1, 0]]);
    let (merged, report) = merge(&mesh, &MergeOptions::default());
    assert_eq!((report.degenerate_faces, report.duplicate_faces, report.unused_vertices), (1, 1, 1));
    assert_eq!(merged.face_count(), 2, "the face that looks the other way stays");
}

#[test]
fn merging_twice_changes_nothing_more() {
    let (once, _) = merge(&fixtures::pair(5, 4), &MergeOptions { weld: 1e-4 });
    let (twice, report) = merge(&once, &MergeOptions { weld: 1e-4 });
    assert_eq!(twice, once);
    assert_eq!(report.joined_points, 0);
}
