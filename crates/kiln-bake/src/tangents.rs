//! MikkTSpace tangents on the triangles that are written.
//!
//! A normal map is right only if whoever reads it builds the same frame as whoever baked it. Engines build MikkTSpace's, so
//! the bake does too, on the final triangles, and writes the frame it used: glTF's tangent of a vertex is its direction of
//! growing u in xyz, and in w the sign with which `bitangent = w cross(normal, tangent)` points *up in the picture*.
//!
//! glTF's V points down, MikkTSpace's bitangent along growing V: it is fed `1 - v`, so that its sign is glTF's. A chart that
//! is not mirrored has w = +1.
//!
//! MikkTSpace gives a tangent to each corner; a vertex whose corners disagree (mirrored neighbours, fans that only touch) is
//! split. Corners without a tangent (faces without area in UV and without a neighbour that has one) get a direction
//! perpendicular to the normal and w = +1: nothing can be read from a map there anyway.
//!
//! Source: M. S. Mikkelsen, "Simulation of Wrinkled Surfaces Revisited", master's thesis, University of Copenhagen, 2008; the
//! crate `bevy_mikktspace` reproduces his code's results, here with the arc cosine of `libm`, equal on all machines.

use bevy_mikktspace::{Geometry, Ops, TangentSpace, generate_tangents};
use glam::{Vec2, Vec3, Vec4};
use kiln_asset::Mesh;

use crate::atlas::wedges::split_wedges;

/// Largest cosine between a normal and a tangent that counts as rounding; beyond it the tangent is made perpendicular.
const SKEW: f32 = 1e-4;

/// The UV set along which tangents run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum UvSource {
    /// The mesh's first UV set.
    Uv0,
    /// The mesh's second UV set.
    Uv1,
    /// The atlas.
    AtlasUv,
}

/// Why a mesh got no tangents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TangentError {
    /// The UV set is not there.
    #[error("the mesh has no UVs to take tangents from ({0:?})")]
    NoUvs(UvSource),
    /// Tangents are perpendicular to normals, and there are none.
    #[error("the mesh has no normals; rebuild them before tangents")]
    NoNormals,
}

/// `mesh` with tangents along `source`, old ones replaced: triangles in the same order, points the same, vertices split where
/// corners disagree. Every tangent is a unit vector perpendicular to its normal, w is +1 or -1.
///
/// # Errors
/// The mesh has no normals or not that UV set.
pub fn mikktspace(mesh: &Mesh, source: UvSource) -> Result<Mesh, TangentError> {
    let uvs = match source {
        UvSource::Uv0 => &mesh.uv0,
        UvSource::Uv1 => &mesh.uv1,
        UvSource::AtlasUv => &mesh.atlas_uv,
    };
    let uvs = uvs.as_deref().ok_or(TangentError::NoUvs(source))?;
    let normals = mesh.normals.as_deref().ok_or(TangentError::NoNormals)?;
    let mut corners = Corners { mesh, normals, uvs, tangents: vec![[None; 3]; mesh.face_count()] };
    generate_tangents(&mut corners).expect("invariant: the crate's error has no values");
    let Corners { tangents: found, .. } = corners;
    let tangent = |v: u32, found: Option<[f32; 4]>| perpendicular(normals[v as usize], found);
    let tangents: Vec<[Vec4; 3]> = mesh
        .triangles
        .iter()
        .zip(&found)
        .map(|(t, found)| [tangent(t[0], found[0]), tangent(t[1], found[1]), tangent(t[2], found[2])])
        .collect();
    let (mut raw, tangents) = split_wedges(mesh, &tangents, Vec3::X.extend(1.0));
    raw.tangents = Some(tangents);
    Ok(Mesh::new(raw).expect("invariant: wedges copied from a valid mesh, tangents finite by `perpendicular`"))
}

/// `found` as it is, if it is a unit vector perpendicular to the normal; made so if it is not; any such if there is none.
fn perpendicular(normal: Vec3, found: Option<[f32; 4]>) -> Vec4 {
    let normal = normal.normalize_or(Vec3::Z);
    let [x, y, z, w] = found.unwrap_or([0.0, 0.0, 0.0, 1.0]);
    let tangent = Vec3::new(x, y, z);
    if tangent.is_normalized() && tangent.dot(normal).abs() <= SKEW {
        return tangent.extend(w);
    }
    let flat = (tangent - normal * tangent.dot(normal)).normalize_or_zero();
    if flat == Vec3::ZERO { normal.any_orthonormal_vector().extend(w) } else { flat.extend(w) }
}

struct Corners<'a> {
    mesh: &'a Mesh,
    normals: &'a [Vec3],
    uvs: &'a [Vec2],
    /// `[face_count] x 3`
    tangents: Vec<[Option<[f32; 4]>; 3]>,
}

impl Corners<'_> {
    fn vertex(&self, face: usize, k: usize) -> usize {
        self.mesh.triangles[face][k] as usize
    }
}

/// MikkTSpace's two functions that differ between machines.
struct SameBits;

impl Ops for SameBits {
    fn sqrt(x: f32) -> f32 {
        x.sqrt()
    }

    fn acos(x: f32) -> f32 {
        kiln_geom::math::acos64(f64::from(x)) as f32
    }
}

impl Geometry<SameBits> for Corners<'_> {
    fn num_faces(&self) -> usize {
        self.mesh.face_count()
    }

    fn num_vertices_of_face(&self, _face: usize) -> usize {
        3
    }

    fn position(&self, face: usize, k: usize) -> [f32; 3] {
        self.mesh.positions[self.vertex(face, k)].to_array()
    }

    fn normal(&self, face: usize, k: usize) -> [f32; 3] {
        self.normals[self.vertex(face, k)].normalize_or(Vec3::Z).to_array()
    }

    fn tex_coord(&self, face: usize, k: usize) -> [f32; 2] {
        let uv = self.uvs[self.vertex(face, k)];
        [uv.x, 1.0 - uv.y]
    }

    fn set_tangent(&mut self, tangent: Option<TangentSpace>, face: usize, k: usize) {
        self.tangents[face][k] = tangent.map(|t| t.tangent_encoded());
    }
}

#[cfg(test)]
mod tests {
    use kiln_asset::{RawMesh, SubmeshId};

    use super::*;

    /// Two triangles in the XY plane facing +Z; u runs along +X, v (downwards as in glTF) along -Y.
    fn plane() -> RawMesh {
        RawMesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            normals: Some(vec![Vec3::Z; 4]),
            uv0: Some(vec![Vec2::new(0.0, 1.0), Vec2::new(1.0, 1.0), Vec2::new(1.0, 0.0), Vec2::new(0.0, 0.0)]),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            face_submesh: vec![SubmeshId(0); 2],
            submeshes: vec![Default::default()],
            ..Default::default()
        }
    }

    fn tangents(raw: RawMesh) -> (Mesh, Vec<Vec4>) {
        let mesh = mikktspace(&Mesh::new(raw).expect("valid"), UvSource::Uv0).expect("has UVs and normals");
        let tangents = mesh.tangents.clone().expect("made");
        (mesh, tangents)
    }

    #[test]
    fn on_a_plane_with_v_downwards_the_tangent_is_right_and_the_bitangent_is_up_in_the_picture() {
        let (mesh, tangents) = tangents(plane());
        assert_eq!(mesh.vertex_count(), 4, "nothing to split");
        for t in tangents {
            assert_eq!(t, Vec4::new(1.0, 0.0, 0.0, 1.0));
            assert_eq!(t.w * Vec3::Z.cross(t.truncate()), Vec3::Y);
        }
    }

    #[test]
    fn on_a_mirrored_plane_the_sign_is_minus_one_and_the_bitangent_still_up_in_the_picture() {
        let mut raw = plane();
        raw.uv0.as_mut().expect("set").iter_mut().for_each(|uv| uv.x = 1.0 - uv.x);
        for t in tangents(raw).1 {
            assert_eq!(t, Vec4::new(-1.0, 0.0, 0.0, -1.0));
            assert_eq!(t.w * Vec3::Z.cross(t.truncate()), Vec3::Y);
        }
    }

    #[test]
    fn a_vertex_between_mirrored_halves_is_split_and_keeps_its_point() {
        // The second triangle's UVs are the mirror image of the first's across the shared edge 0-2.
        let mut raw = plane();
        raw.uv0.as_mut().expect("set")[3] = Vec2::new(1.0, 1.0);
        let (mesh, tangents) = tangents(raw);
        assert_eq!((mesh.vertex_count(), mesh.point_count()), (6, 4));
        for (triangle, sign) in mesh.triangles.iter().zip([1.0, -1.0]) {
            assert!(triangle.iter().all(|v| tangents[*v as usize].w == sign), "{triangle:?} of {tangents:?}");
        }
    }

    #[test]
    fn faces_without_area_in_uv_get_unit_tangents_perpendicular_to_the_normal() {
        let mut raw = plane();
        raw.uv0 = Some(vec![Vec2::splat(0.5); 4]);
        raw.normals = Some(vec![Vec3::X, Vec3::Y, Vec3::Z, Vec3::splat(1.0).normalize()]);
        let (mesh, tangents) = tangents(raw);
        for (t, n) in tangents.iter().zip(mesh.normals.as_deref().expect("kept")) {
            assert!(t.truncate().is_normalized() && t.w.abs() == 1.0);
            assert!(t.truncate().dot(*n).abs() < 1e-6, "{t} against {n}");
        }
    }

    #[test]
    fn without_normals_or_uvs_there_is_an_error_and_no_guess() {
        let raw = RawMesh { normals: None, ..plane() };
        assert_eq!(mikktspace(&Mesh::new(raw).expect("valid"), UvSource::Uv0), Err(TangentError::NoNormals));
        let mesh = Mesh::new(plane()).expect("valid");
        assert_eq!(mikktspace(&mesh, UvSource::AtlasUv), Err(TangentError::NoUvs(UvSource::AtlasUv)));
    }
}
