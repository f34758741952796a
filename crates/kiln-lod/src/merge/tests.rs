use super::*;
use crate::fixtures;
use glam::Vec3;
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
    assert_eq!(merge(&apart, &MergeOptions { weld: 0.0005, ..Default::default() }).1.joined_points, 0);
    let (merged, report) = merge(&apart, &MergeOptions { weld: 0.002, ..Default::default() });
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
    let (merged, report) = merge(&two, &MergeOptions { weld: 0.01, ..Default::default() });
    assert_eq!(report.joined_points, 0);
    assert_eq!(merged.point_count(), 2 * sphere.point_count());
}

#[test]
fn degenerate_and_duplicate_faces_and_unused_vertices_go_and_are_counted() {
    let mesh = fixtures::soup(&[[0, 1, 2], [1, 2, 0], [0, 0, 3], [2, 1, 0]]);
    let (merged, report) = merge(&mesh, &MergeOptions::default());
    let counts = [RepairKind::DegenerateFaces, RepairKind::DuplicateFaces, RepairKind::UnusedVertices];
    assert_eq!(counts.map(|kind| report.count(kind)), [1, 1, 1]);
    let first: Vec<&str> = report.repairs.iter().map(|repair| repair.first.as_str()).collect();
    assert_eq!(first, ["submesh \"part\", face 2", "submesh \"part\", face 1", "vertex 3"]);
    assert_eq!(merged.face_count(), 2, "the face that looks the other way stays");
}

#[test]
fn merging_twice_changes_nothing_more() {
    let (once, _) = merge(&fixtures::pair(5, 4), &MergeOptions { weld: 1e-4, ..Default::default() });
    let (twice, report) = merge(&once, &MergeOptions { weld: 1e-4, ..Default::default() });
    assert_eq!(twice, once);
    assert_eq!(report.joined_points, 0);
}

const WINDING: MergeOptions = MergeOptions { weld: 0.0, duplicate_faces: true, zero_normals: true, winding: true };

/// `mesh` with some faces turned over and nothing else.
fn with_flips(mesh: &Mesh, flipped: impl Fn(usize) -> bool) -> Mesh {
    let mut raw = mesh.clone().into_raw();
    for (f, triangle) in raw.triangles.iter_mut().enumerate() {
        if flipped(f) {
            triangle.swap(1, 2);
        }
    }
    Mesh::new(raw).unwrap()
}

/// Both as one mesh of one submesh, without a point in common.
fn beside(a: &Mesh, b: &Mesh) -> Mesh {
    let (mut raw, other) = (a.clone().into_raw(), b.clone().into_raw());
    let vertices = raw.positions.len() as u32;
    raw.positions.extend(other.positions.iter().map(|p| *p + Vec3::splat(10.0)));
    raw.normals = raw.normals.zip(other.normals).map(|(a, b)| [a, b].concat());
    raw.uv0 = raw.uv0.zip(other.uv0).map(|(a, b)| [a, b].concat());
    raw.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + vertices)));
    raw.face_submesh.resize(raw.triangles.len(), SubmeshId(0));
    raw.points.clear();
    Mesh::new(raw).unwrap()
}

fn volume(mesh: &Mesh) -> f32 {
    let six = |f| mesh.face_positions(FaceId(f)).map(|p| p - mesh.positions[0]);
    (0..mesh.face_count() as u32).map(six).map(|[a, b, c]| a.dot(b.cross(c)) / 6.0).sum()
}

#[test]
fn flipped_faces_of_a_cube_come_back_and_their_right_normals_stay() {
    let cube = fixtures::hard_cube(3);
    let broken = with_flips(&cube, |f| f % 4 == 1);
    let (left, report) = merge(&broken, &MergeOptions::default());
    assert_eq!((left.triangles.clone(), report.repairs), (broken.triangles.clone(), vec![]), "left unless asked for");
    assert!(survey(&broken).disagreeing_edges > 0);
    let (merged, report) = merge(&broken, &WINDING);
    assert_eq!(
        report.count(RepairKind::Winding) as usize,
        cube.face_count() / 4 + usize::from(cube.face_count() % 4 > 1)
    );
    assert_eq!((&merged.triangles, &merged.normals), (&cube.triangles, &cube.normals));
    assert_eq!(survey(&merged).disagreeing_edges, 0);
    assert_eq!(merge(&merged, &WINDING), (merged, MergeReport::default()), "nothing is left to do");
}

#[test]
fn a_part_turned_inside_out_is_turned_back_with_its_normals_only_where_asked() {
    let good = fixtures::hard_cube(2);
    let mut raw = with_flips(&good, |_| true).into_raw();
    raw.normals.iter_mut().flatten().for_each(|n| *n = -*n);
    raw.tangents = Some(vec![glam::Vec4::new(1.0, 0.0, 0.0, -1.0); raw.positions.len()]);
    let inside_out = Mesh::new(raw).unwrap();
    assert_eq!(survey(&inside_out).inside_out_patches, 1);
    let (left, report) = merge(&inside_out, &MergeOptions::default());
    assert!(volume(&left) < 0.0 && report.repairs.is_empty(), "left unless asked for");
    let (merged, report) = merge(&inside_out, &WINDING);
    assert_eq!(report.count(RepairKind::Winding) as usize, good.face_count());
    assert_eq!((&merged.triangles, &merged.normals), (&good.triangles, &good.normals));
    assert!(
        merged.tangents.as_ref().unwrap().iter().all(|t| t.w == 1.0 && t.x == 1.0),
        "the bitangent stays where it was"
    );

    let (merged, report) = merge(&beside(&good, &left), &WINDING);
    assert_eq!(report.count(RepairKind::Winding) as usize, good.face_count(), "one of two parts");
    assert!((volume(&merged) - 2.0 * volume(&good)).abs() < 1e-3);
}

#[test]
fn an_open_patch_keeps_the_winding_of_most_of_its_area() {
    let grid = fixtures::grid(4, 4);
    for flipped in [0..10, 0..22] {
        let (merged, report) = merge(&with_flips(&grid, |f| flipped.contains(&f)), &WINDING);
        let more = flipped.len() > grid.face_count() / 2;
        assert_eq!(report.count(RepairKind::Winding) as usize, if more { 32 - flipped.len() } else { flipped.len() });
        assert_eq!(merged.triangles, with_flips(&grid, |_| more).triangles);
    }
    let (_, report) = merge(&with_flips(&grid, |_| true), &WINDING);
    assert_eq!(report.repairs, [], "an open patch has no inside");
}

#[test]
fn windings_are_made_equal_across_a_boundary() {
    let pair = fixtures::pair(4, 3);
    let half = pair.face_count() / 2;
    let (merged, report) = merge(&with_flips(&pair, |f| f > half), &WINDING);
    assert_eq!(report.count(RepairKind::Winding) as usize, half - 1);
    assert_eq!(survey(&merged).disagreeing_edges, 0);
}

#[test]
fn a_moebius_strip_is_left_and_named() {
    // Seven quads; the last one meets the first with its ends exchanged.
    let n = 7;
    let at = |i: u32, side: u32| if i < n { 2 * i + side } else { 1 - side };
    let quad = |i| [[at(i, 0), at(i + 1, 0), at(i, 1)], [at(i + 1, 0), at(i + 1, 1), at(i, 1)]];
    let strip = fixtures::soup(&(0..n).flat_map(quad).collect::<Vec<_>>());
    let (merged, report) = merge(&strip, &WINDING);
    assert_eq!(merged.triangles, strip.triangles);
    assert_eq!(report.repairs, []);
    assert_eq!(report.unorientable, ["submesh \"part\", face 0"]);
    let counts = survey(&strip);
    assert_eq!((counts.unorientable_patches, counts.patches, counts.components), (1, 1, 1));
    assert_eq!(merge(&strip, &MergeOptions::default()).1.unorientable, [""; 0], "nobody asked");
}

#[test]
fn a_wedge_between_right_and_wrong_faces_gets_the_side_of_its_faces_afterwards() {
    // All wedges of a smooth sphere are shared. Where the normals look outward they stay, where inward they turn.
    let mut raw = fixtures::sphere(8, 6).into_raw();
    raw.normals = Some(raw.positions.clone());
    raw.submeshes[0].attributes.normals = true;
    let sphere = Mesh::new(raw.clone()).unwrap();
    let broken = with_flips(&sphere, |f| f % 3 == 0);
    let (merged, _) = merge(&broken, &WINDING);
    assert_eq!((&merged.triangles, &merged.normals), (&sphere.triangles, &sphere.normals));
    raw.normals.iter_mut().flatten().for_each(|n| *n = -*n);
    let inward = with_flips(&Mesh::new(raw).unwrap(), |f| f % 3 == 0);
    let touched: Vec<bool> = {
        let mut touched = vec![false; inward.vertex_count()];
        inward.triangles.iter().step_by(3).flatten().for_each(|v| touched[*v as usize] = true);
        touched
    };
    let (merged, _) = merge(&inward, &WINDING);
    for (v, n) in merged.normals.as_ref().unwrap().iter().enumerate().filter(|(v, _)| touched[*v]) {
        assert_eq!(*n, sphere.positions[v], "vertex {v}");
    }
}

#[test]
fn normals_without_direction_come_from_their_faces() {
    let mut raw = fixtures::hard_cube(2).into_raw();
    let right = raw.normals.clone().unwrap();
    for v in [0, 5, 13] {
        raw.normals.as_mut().unwrap()[v] = Vec3::splat(1e-9);
    }
    let mesh = Mesh::new(raw).unwrap();
    let (merged, report) = merge(&mesh, &MergeOptions::default());
    assert_eq!(report.count(RepairKind::ZeroNormals), 3);
    for (n, right) in merged.normals.as_ref().unwrap().iter().zip(&right) {
        assert!((*n - *right).length() < 1e-6, "{n} {right}");
    }
    let (left, report) = merge(&mesh, &MergeOptions { zero_normals: false, ..Default::default() });
    assert_eq!((&left.normals, report.repairs), (&mesh.normals, vec![]));
}

#[test]
fn duplicate_faces_stay_where_asked_and_later_stages_take_them() {
    let mesh = fixtures::soup(&[[0, 1, 2], [1, 2, 0], [2, 1, 3], [0, 1, 2]]);
    let (merged, report) = merge(&mesh, &MergeOptions { duplicate_faces: false, ..Default::default() });
    assert_eq!((merged.face_count(), report.repairs), (4, vec![]));
    let topology = crate::topology::Topology::new(&merged);
    assert_eq!(topology.kinds[0], crate::topology::PointKind::Complex);
    assert_eq!(survey(&merged).crowded_edges, 3);
}

proptest::proptest! {
    #[test]
    fn any_flips_of_a_closed_mesh_are_undone(columns in 3_u32..9, rows in 3_u32..7, seed in proptest::num::u64::ANY) {
        let sphere = fixtures::sphere(columns, rows);
        let broken = with_flips(&sphere, |f| (seed.rotate_left(f as u32 * 7) ^ seed >> (f % 31)) & 1 == 1);
        let (merged, report) = merge(&broken, &WINDING);
        proptest::prop_assert_eq!(&merged.triangles, &sphere.triangles);
        let flipped = sphere.triangles.iter().zip(&broken.triangles).filter(|(a, b)| a != b).count();
        proptest::prop_assert_eq!(report.count(RepairKind::Winding) as usize, flipped);
    }

    #[test]
    fn random_soups_are_wound_as_well_as_they_can_be(
        triangles in proptest::collection::vec(proptest::array::uniform3(0_u32..7), 1..24),
    ) {
        let mesh = fixtures::soup(&triangles);
        let (merged, report) = merge(&mesh, &WINDING);
        let counts = survey(&merged);
        proptest::prop_assert_eq!(counts.disagreeing_edges > 0, !report.unorientable.is_empty() && counts.unorientable_patches > 0);
        let _ = crate::topology::Topology::new(&merged);
    }
}
