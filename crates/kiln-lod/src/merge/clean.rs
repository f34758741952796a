//! Faces worth keeping, and the mesh that is left of them.

use kiln_asset::{FaceId, Mesh, PointId};

use super::MergeOptions;
use super::repair::{RepairKind, Repairs, place};

/// Those of the ascending `faces` that have three distinct points out of `points` `[vertex_count]` and, where `options` say so,
/// come first of those with the same points, winding and submesh.
pub(super) fn sound_faces(
    mesh: &Mesh,
    points: &[PointId],
    mut faces: Vec<FaceId>,
    options: &MergeOptions,
    repairs: &mut Repairs,
) -> Vec<FaceId> {
    let face_points = |f: FaceId| mesh.triangles[f.index()].map(|v| points[v as usize].0);
    let mut degenerate = Vec::new();
    faces.retain(|f| {
        let sound = !crate::topology::is_degenerate(&face_points(*f));
        if !sound {
            degenerate.push(*f);
        }
        sound
    });
    repairs.add(RepairKind::DegenerateFaces, degenerate.len(), || place(mesh, degenerate[0]));
    if !options.duplicate_faces {
        return faces;
    }

    // Equal faces become neighbours when sorted by their points, turned so that the lowest comes first.
    let mut keyed: Vec<([u32; 4], FaceId)> = faces
        .iter()
        .map(|f| {
            let [a, b, c] = face_points(*f);
            let [x, y, z] = if a < b && a < c {
                [a, b, c]
            } else if b < c {
                [b, c, a]
            } else {
                [c, a, b]
            };
            ([mesh.face_submesh[f.index()].0, x, y, z], *f)
        })
        .collect();
    keyed.sort_unstable();
    let mut duplicates: Vec<FaceId> =
        keyed.windows(2).filter(|pair| pair[0].0 == pair[1].0).map(|pair| pair[1].1).collect();
    duplicates.sort_unstable();
    repairs.add(RepairKind::DuplicateFaces, duplicates.len(), || place(mesh, duplicates[0]));
    let mut next = duplicates.into_iter().peekable();
    faces.retain(|f| next.next_if_eq(f).is_none());
    faces
}

/// The mesh of the `kept` faces with `points` `[vertex_count]` as its points; vertices out of use are dropped and counted.
pub(super) fn gather(mesh: &Mesh, points: Vec<PointId>, kept: &[FaceId], repairs: &mut Repairs) -> Mesh {
    let mut new_vertex = vec![u32::MAX; mesh.vertex_count()];
    for f in kept {
        for v in mesh.triangles[f.index()] {
            new_vertex[v as usize] = 0;
        }
    }
    let mut keep = Vec::with_capacity(mesh.vertex_count());
    for (v, new) in new_vertex.iter_mut().enumerate() {
        if *new == 0 {
            *new = keep.len() as u32;
            keep.push(v as u32);
        }
    }
    let unused = mesh.vertex_count() - keep.len();
    repairs.add(RepairKind::UnusedVertices, unused, || {
        // The first vertex that is not the one expected at its place.
        let first = keep.iter().zip(0..).find(|(v, i)| **v != *i).map_or(keep.len() as u32, |(_, i)| i);
        format!("vertex {first}")
    });
    let triangles = kept.iter().map(|f| mesh.triangles[f.index()].map(|v| new_vertex[v as usize])).collect();
    let face_submesh = kept.iter().map(|f| mesh.face_submesh[f.index()]).collect();

    let mut raw = (**mesh).clone();
    raw.points = points;
    Mesh::new(raw.gather(&keep, triangles, face_submesh))
        .expect("invariant: part of a valid mesh, points renumbered densely")
}
