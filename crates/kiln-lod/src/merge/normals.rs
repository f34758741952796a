//! Normals that point nowhere.

use glam::{DVec3, Vec3};
use kiln_asset::{FaceId, Mesh, PointId};

use super::repair::{RepairKind, Repairs, place};
use super::winding::face_sums;

/// Below this length a normal has no direction: quantised ones are off by 1e-2 at most, so nothing real comes near.
const SHORTEST: f32 = 1e-6;

/// `mesh` with new normals where those of vertices of the `kept` faces have no direction: the area-weighted mean of the normals
/// of the faces of the vertex, else of its point out of `points` `[vertex_count]`, else +Y. `None` if all have one. Submeshes that
/// brought no normals are none of this.
pub(super) fn rebuild_zero(mesh: &Mesh, points: &[PointId], kept: &[FaceId], repairs: &mut Repairs) -> Option<Mesh> {
    let normals = mesh.normals.as_ref()?;
    let mut empty = vec![false; mesh.vertex_count()];
    let (mut count, mut first) = (0, None);
    for f in kept.iter().filter(|f| mesh.submeshes[mesh.face_submesh[f.index()].index()].attributes.normals) {
        for v in mesh.triangles[f.index()] {
            if normals[v as usize].length() < SHORTEST && !empty[v as usize] {
                empty[v as usize] = true;
                count += 1;
                first.get_or_insert(*f);
            }
        }
    }
    let first = first?;
    repairs.add(RepairKind::ZeroNormals, count, || place(mesh, first));

    let sums = face_sums(&mesh.triangles, &mesh.positions, kept);
    let mut point_sums = vec![DVec3::ZERO; mesh.vertex_count()];
    for (sum, point) in sums.iter().zip(points) {
        point_sums[point.index()] += *sum;
    }
    let mut raw = (**mesh).clone();
    let rebuilt = raw.normals.iter_mut().flatten().enumerate().filter(|(v, _)| empty[*v]);
    for (v, normal) in rebuilt {
        let direction = sums[v].try_normalize().or_else(|| point_sums[points[v].index()].try_normalize());
        *normal = direction.map_or(Vec3::Y, DVec3::as_vec3);
    }
    Some(Mesh::new(raw).expect("invariant: only normals changed, to finite ones"))
}
