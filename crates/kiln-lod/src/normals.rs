//! Normals for meshes that come without.
//!
//! At each point the faces are grouped: two faces that share an edge at the point belong together if their normals differ by
//! less than the angle. A group's normal is the mean of its faces' normals weighted by the angle that each has at the point; a
//! wedge that lies in several groups is split (hard edge). Submeshes that brought normals keep theirs.
//!
//! Source: C. Gonzalez, PhD thesis 2010, section 3.4 (threshold); angle weights: G. Thürmer, C. Wüthrich, "Computing vertex
//! normals from polygonal facets", JGT 1998, doi:10.1080/10867651.1998.10487487.

use glam::{DVec3, Vec3, Vec4};
use kiln_asset::{Mesh, PointId, RawMesh};

use crate::topology::{NONE, Topology, is_degenerate};

/// `mesh` with normals in every submesh that had none; hard edges where faces meet at more than `angle` degrees. Points, faces
/// and their order stay; wedges are split and follow the old ones.
pub fn rebuild(mesh: &Mesh, angle: f32) -> Mesh {
    let wanted: Vec<bool> = mesh.submeshes.iter().map(|s| !(s.attributes.normals && mesh.normals.is_some())).collect();
    rebuild_where(mesh, angle, &wanted)
}

/// The same for every submesh, whatever it has.
pub fn rebuild_all(mesh: &Mesh, angle: f32) -> Mesh {
    rebuild_where(mesh, angle, &vec![true; mesh.submeshes.len()])
}

/// The same for every submesh that is not in `kept`, `[submesh_count]`.
pub fn rebuild_but(mesh: &Mesh, angle: f32, kept: &[bool]) -> Mesh {
    let wanted: Vec<bool> = kept.iter().map(|kept| !kept).collect();
    rebuild_where(mesh, angle, &wanted)
}

/// `mesh` with normals in every submesh that had none, without a hard edge: each vertex has the mean of the normals of its point's
/// faces in such submeshes, weighted by the angle that each has there. No wedge is split, so a collapse sequence of `mesh` is one of
/// the result, too.
pub fn smooth(mesh: &Mesh) -> Mesh {
    let wanted: Vec<bool> = mesh.submeshes.iter().map(|s| !(s.attributes.normals && mesh.normals.is_some())).collect();
    if !wanted.contains(&true) {
        return mesh.clone();
    }
    let mut sums = vec![DVec3::ZERO; mesh.point_count()];
    let mut asked = vec![false; mesh.vertex_count()];
    for (triangle, _) in mesh.triangles.iter().zip(&mesh.face_submesh).filter(|(_, s)| wanted[s.index()]) {
        let corners = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        for k in 0..3 {
            sums[mesh.points[triangle[k] as usize].index()] += normal * angle_at(&corners, k);
            asked[triangle[k] as usize] = true;
        }
    }
    let mut raw: RawMesh = mesh.clone().into_raw();
    let mut normals = raw.normals.take().unwrap_or_else(|| vec![Vec3::Y; mesh.vertex_count()]);
    for (v, normal) in normals.iter_mut().enumerate().filter(|(v, _)| asked[*v]) {
        *normal = sums[mesh.points[v].index()].try_normalize().unwrap_or(DVec3::Y).as_vec3();
    }
    raw.normals = Some(normals);
    for (submesh, _) in raw.submeshes.iter_mut().zip(&wanted).filter(|(_, wanted)| **wanted) {
        (submesh.attributes.normals, submesh.attributes.tangents) = (true, false);
    }
    if raw.submeshes.iter().all(|s| !s.attributes.tangents) {
        raw.tangents = None;
    }
    Mesh::new(raw).expect("invariant: only normals and tangents changed")
}

/// The angle at corner `k`, radians; 0 where an edge has no length.
fn angle_at(corners: &[DVec3; 3], k: usize) -> f64 {
    let (a, b) = (corners[(k + 1) % 3] - corners[k], corners[(k + 2) % 3] - corners[k]);
    let lengths = a.length() * b.length();
    if lengths > 0.0 { libm::acos((a.dot(b) / lengths).clamp(-1.0, 1.0)) } else { 0.0 }
}

fn rebuild_where(mesh: &Mesh, angle: f32, wanted: &[bool]) -> Mesh {
    if !wanted.contains(&true) {
        return mesh.clone();
    }
    let topology = Topology::new(mesh);
    let face_normals: Vec<DVec3> = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize].as_dvec3());
            (b - a).cross(c - a).normalize_or_zero()
        })
        .collect();
    let cosine = libm::cos(f64::from(angle).to_radians());
    let soft = |f: usize, g: usize| face_normals[f].dot(face_normals[g]) > cosine;

    // Corner to group leader: the lowest corner of its group at its point.
    let mut leader: Vec<u32> = (0..3 * mesh.face_count() as u32).collect();
    for p in 0..mesh.point_count() as u32 {
        for corner in topology.star(PointId(p)) {
            // Across the edge that leaves the point at this corner lies the corner behind the twin.
            let twin = topology.twin(*corner);
            if twin != NONE {
                let beside = crate::topology::next(twin);
                if soft(*corner as usize / 3, beside as usize / 3) {
                    unite(&mut leader, *corner, beside);
                }
            }
        }
    }
    let mut sums = vec![DVec3::ZERO; leader.len()];
    for (f, triangle) in mesh.triangles.iter().enumerate() {
        let corners = triangle.map(|v| mesh.positions[v as usize].as_dvec3());
        for k in 0..3 {
            let group = find(&mut leader, (3 * f + k) as u32);
            sums[group as usize] += face_normals[f] * angle_at(&corners, k);
        }
    }

    let mut raw: RawMesh = mesh.clone().into_raw();
    let mut normals = raw.normals.take().unwrap_or_else(|| vec![Vec3::Z; mesh.vertex_count()]);
    // For each old wedge the copies made so far, one a group: (group, vertex), chained through `more`.
    let mut first: Vec<u32> = vec![NONE; mesh.vertex_count()];
    let mut copies: Vec<(u32, u32, u32)> = Vec::new();
    let mut keep: Vec<u32> = (0..mesh.vertex_count() as u32).collect();
    let mut triangles = raw.triangles.clone();
    for f in 0..mesh.face_count() {
        if !wanted[mesh.face_submesh[f].index()] {
            continue;
        }
        for (k, wedge) in mesh.triangles[f].into_iter().enumerate() {
            let group = find(&mut leader, (3 * f + k) as u32);
            let mut at = first[wedge as usize];
            while at != NONE && copies[at as usize].0 != group {
                at = copies[at as usize].2;
            }
            let vertex = if at != NONE {
                copies[at as usize].1
            } else {
                let vertex = if first[wedge as usize] == NONE {
                    wedge
                } else {
                    keep.push(wedge);
                    normals.push(Vec3::Z);
                    keep.len() as u32 - 1
                };
                let fallback = if is_degenerate(&topology.face_points[f]) { DVec3::Y } else { face_normals[f] };
                let normal = sums[group as usize].try_normalize().or(fallback.try_normalize()).unwrap_or(DVec3::Y);
                normals[vertex as usize] = normal.as_vec3();
                copies.push((group, vertex, first[wedge as usize]));
                first[wedge as usize] = copies.len() as u32 - 1;
                vertex
            };
            triangles[f][k] = vertex;
        }
    }
    let points: Vec<PointId> = keep.iter().map(|v| mesh.points[*v as usize]).collect();
    let mut out = raw.gather(&keep, triangles, raw.face_submesh.clone());
    out.points = points;
    out.normals = Some(normals);
    for (submesh, wanted) in out.submeshes.iter_mut().zip(wanted) {
        submesh.attributes.normals |= *wanted;
        // Tangents belong to the normals they were made with.
        submesh.attributes.tangents &= !*wanted;
    }
    if out.submeshes.iter().all(|s| !s.attributes.tangents) {
        out.tangents = None::<Vec<Vec4>>;
    }
    Mesh::new(out).expect("invariant: wedges were split within their submesh and point, nothing else changed")
}

fn find(leader: &mut [u32], mut corner: u32) -> u32 {
    while leader[corner as usize] != corner {
        leader[corner as usize] = leader[leader[corner as usize] as usize];
        corner = leader[corner as usize];
    }
    corner
}

fn unite(leader: &mut [u32], a: u32, b: u32) {
    let (a, b) = (find(leader, a), find(leader, b));
    leader[a.max(b) as usize] = a.min(b);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    #[test]
    fn a_cube_gets_hard_edges_and_a_sphere_a_smooth_surface() {
        let mut raw = fixtures::hard_cube(4).into_raw();
        raw.normals = None;
        raw.submeshes[0].attributes.normals = false;
        let cube = rebuild(&Mesh::new(raw).unwrap(), 30.0);
        for (f, t) in cube.triangles.iter().enumerate() {
            let [a, b, c] = cube.face_positions(kiln_asset::FaceId(f as u32));
            let flat = (b - a).cross(c - a).normalize();
            for v in t {
                assert!((cube.normals.as_ref().unwrap()[*v as usize] - flat).length() < 1e-5);
            }
        }
        let sphere = rebuild(&fixtures::sphere(48, 32), 30.0);
        assert_eq!(sphere.vertex_count(), sphere.point_count(), "no wedge was split");
        for (p, n) in sphere.positions.iter().zip(sphere.normals.as_ref().unwrap()) {
            assert!(p.normalize().dot(*n) > 0.999, "{p} {n}");
        }
    }

    #[test]
    fn smooth_normals_split_nothing_and_are_those_of_a_sphere() {
        let sphere = fixtures::sphere(48, 32);
        let smoothed = smooth(&sphere);
        assert_eq!((&smoothed.positions, &smoothed.triangles), (&sphere.positions, &sphere.triangles));
        for (p, n) in sphere.positions.iter().zip(smoothed.normals.as_ref().unwrap()) {
            assert!(p.normalize().dot(*n) > 0.999, "{p} {n}");
        }
        let cube = fixtures::hard_cube(3);
        assert_eq!(smooth(&cube), cube, "normals that are there stay");
    }

    #[test]
    fn points_and_faces_stay_and_normals_that_are_there_too() {
        let cube = fixtures::hard_cube(3);
        assert_eq!(rebuild(&cube, 30.0), cube);
        let again = rebuild_all(&cube, 30.0);
        assert_eq!(again.point_count(), cube.point_count());
        assert_eq!(again.face_count(), cube.face_count());
        let soft = rebuild(&fixtures::sphere(6, 4), 10.0);
        assert!(soft.vertex_count() > soft.point_count(), "facets of a coarse sphere are hard at 10 degrees");
    }
}
