//! The mesh: wedges in flat arrays, triangles over them, a point for every wedge, a submesh for every face.
//!
//! A [`RawMesh`] is plain data that anybody may fill in. [`Mesh::new`] is the only door from it to a [`Mesh`]: it checks
//! every promise below, reports all that is broken, and welds points where none are given. Whoever holds a `Mesh` may index
//! its arrays without fear.
//!
//! Promises of a `Mesh`:
//! - every attribute that is present has one entry a vertex; positions and all other attributes are finite;
//! - every index is below the vertex count, every face's submesh exists, faces are ordered by submesh;
//! - a vertex is used by faces of one submesh only;
//! - `points` is dense: every value below [`Mesh::point_count`] occurs.
//!
//! Degenerate faces (two corners at one point) are legal here; `merge` drops and counts them.

use std::ops::Deref;

use glam::{Vec2, Vec3, Vec4};
use serde::{Deserialize, Serialize};

use crate::blob::{BlobError, BlobReader, BlobWriter};
use crate::ids::{FaceId, MaterialId, PointId, SubmeshId};

/// Which vertex attributes a submesh had in its source. Where some submeshes have an attribute and others have not, the mesh
/// carries it for all (neutral values for the others) and this set remembers who really had it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AttributeSet {
    /// Unit normals.
    pub normals: bool,
    /// Tangents with bitangent sign.
    pub tangents: bool,
    /// First UV set.
    pub uv0: bool,
    /// Second UV set.
    pub uv1: bool,
    /// Linear RGBA colours.
    pub colors: bool,
    /// Joint indices and weights.
    pub skin: bool,
    /// Importance to a simplifier.
    pub importance: bool,
}

/// An input part with one material: one glTF primitive in place.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Submesh {
    /// Name, unique in its mesh; what `[[stage.submesh]]` rules match.
    pub name: String,
    /// Its material, `None` for the glTF default material.
    pub material: Option<MaterialId>,
    /// The attributes its source had.
    pub attributes: AttributeSet,
    /// Triangles this submesh had in the source asset; budgets are shares of it.
    pub source_triangles: u32,
}

/// Mesh data before validation. All arrays are indexed by vertex (= wedge) unless they say otherwise. Object space: metre,
/// right-handed, Y up, +Z front, counter-clockwise front faces.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawMesh {
    /// `[vertex_count]`, object space.
    pub positions: Vec<Vec3>,
    /// `[vertex_count]`, unit length, object space.
    pub normals: Option<Vec<Vec3>>,
    /// `[vertex_count]`, xyz unit tangent in object space, w = +1 or -1; bitangent = w cross(n, t).
    pub tangents: Option<Vec<Vec4>>,
    /// `[vertex_count]`, first UV set, V downwards as in glTF.
    pub uv0: Option<Vec<Vec2>>,
    /// `[vertex_count]`, second UV set.
    pub uv1: Option<Vec<Vec2>>,
    /// `[vertex_count]`, UVs in the atlas that the bake will fill, inside `[0, 1]`; present between `atlas` and `bake`.
    pub atlas_uv: Option<Vec<Vec2>>,
    /// `[vertex_count]`, linear RGBA.
    pub colors: Option<Vec<Vec4>>,
    /// `[vertex_count] x 4` joint indices.
    pub joints: Option<Vec<[u16; 4]>>,
    /// `[vertex_count] x 4` joint weights.
    pub weights: Option<Vec<Vec4>>,
    /// `[vertex_count]`, 0 or more: by how much dearer than others a vertex is to a simplifier; 1 is like all others.
    pub importance: Option<Vec<f32>>,
    /// `[vertex_count]`, the point of each vertex. Empty: [`Mesh::new`] welds vertices of one submesh at bitwise equal
    /// positions. Only `merge` joins points of different submeshes.
    pub points: Vec<PointId>,
    /// `[face_count] x 3` vertex indices, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// `[face_count]`, ascending.
    pub face_submesh: Vec<SubmeshId>,
    /// `[submesh_count]`.
    pub submeshes: Vec<Submesh>,
}

/// A validated mesh; see the module page for what it promises. Read-only: change it by [`Mesh::into_raw`] and [`Mesh::new`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    raw: RawMesh,
    point_count: u32,
}

/// One broken promise of a mesh.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MeshDefect {
    /// Where: `normals[17]`, `triangles[3][2]`.
    pub path: String,
    /// What is wrong there.
    pub message: String,
}

/// All broken promises of a mesh (the first 100, then a count).
#[derive(Clone, Debug, thiserror::Error)]
#[error("invalid mesh: {}", .0.iter().map(|d| format!("{}: {}", d.path, d.message)).collect::<Vec<_>>().join("; "))]
pub struct MeshError(pub Vec<MeshDefect>);

const DEFECT_LIMIT: usize = 100;

struct Defects {
    list: Vec<MeshDefect>,
    more: usize,
}

impl Defects {
    fn push(&mut self, path: impl FnOnce() -> String, message: impl FnOnce() -> String) {
        if self.list.len() < DEFECT_LIMIT {
            self.list.push(MeshDefect { path: path(), message: message() });
        } else {
            self.more += 1;
        }
    }
}

impl Deref for Mesh {
    type Target = RawMesh;

    fn deref(&self) -> &RawMesh {
        &self.raw
    }
}

impl Mesh {
    /// The mesh, if `raw` keeps every promise of the module page; welds points where `raw.points` is empty.
    ///
    /// # Errors
    /// All defects, each with the path of the value.
    pub fn new(mut raw: RawMesh) -> Result<Mesh, MeshError> {
        let mut defects = Defects { list: Vec::new(), more: 0 };
        let vertex_count = raw.positions.len();
        if vertex_count >= u32::MAX as usize || raw.triangles.len() >= (u32::MAX / 3) as usize {
            defects.push(|| "positions".into(), || "more vertices or faces than a 32-bit id can name".into());
        }
        check_attributes(&raw, vertex_count, &mut defects);
        check_faces(&raw, vertex_count, &mut defects);
        if raw.points.is_empty() && defects.list.is_empty() {
            raw.points = weld_exact(&raw);
        }
        let point_count = check_points(&raw, vertex_count, &mut defects);
        if defects.list.is_empty() {
            return Ok(Mesh { raw, point_count });
        }
        if defects.more > 0 {
            let more = defects.more;
            defects.list.push(MeshDefect { path: "mesh".into(), message: format!("and {more} more") });
        }
        Err(MeshError(defects.list))
    }

    /// The data, to change it.
    pub fn into_raw(self) -> RawMesh {
        self.raw
    }

    /// Number of vertices (wedges).
    pub fn vertex_count(&self) -> usize {
        self.raw.positions.len()
    }

    /// Number of triangles.
    pub fn face_count(&self) -> usize {
        self.raw.triangles.len()
    }

    /// Number of points.
    pub fn point_count(&self) -> usize {
        self.point_count as usize
    }

    /// The faces of a submesh (faces are ordered by submesh).
    pub fn submesh_faces(&self, submesh: SubmeshId) -> std::ops::Range<usize> {
        let start = self.raw.face_submesh.partition_point(|s| *s < submesh);
        let end = self.raw.face_submesh.partition_point(|s| *s <= submesh);
        start..end
    }

    /// The three points of a face.
    pub fn face_points(&self, face: FaceId) -> [PointId; 3] {
        self.raw.triangles[face.index()].map(|v| self.raw.points[v as usize])
    }

    /// The three positions of a face, object space.
    #[inline]
    pub fn face_positions(&self, face: FaceId) -> [Vec3; 3] {
        self.raw.triangles[face.index()].map(|v| self.raw.positions[v as usize])
    }

    /// Least and greatest corner of the bounding box over all vertices, object units; zeros for an empty mesh.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        let Some(first) = self.raw.positions.first() else { return (Vec3::ZERO, Vec3::ZERO) };
        self.raw.positions.iter().fold((*first, *first), |(lo, hi), p| (lo.min(*p), hi.max(*p)))
    }

    /// Length of the bounding box's diagonal, object units.
    pub fn diagonal(&self) -> f32 {
        let (lo, hi) = self.bounds();
        (hi - lo).length()
    }

    /// The mesh as bytes for the private cache.
    pub fn to_blob(&self) -> Vec<u8> {
        let mut blob = BlobWriter::new(*b"MESH", 2);
        self.write(&mut blob);
        blob.finish()
    }

    /// The mesh out of [`Mesh::to_blob`] bytes, validated again: a cache is bytes from outside.
    ///
    /// # Errors
    /// Wrong type, version, length or content.
    pub fn from_blob(bytes: &[u8]) -> Result<Mesh, BlobError> {
        let mut blob = BlobReader::open(bytes, *b"MESH", 2)?;
        let mesh = Mesh::read(&mut blob)?;
        blob.finish()?;
        Ok(mesh)
    }

    pub(crate) fn write(&self, blob: &mut BlobWriter) {
        let m = &self.raw;
        blob.meta(&m.submeshes);
        blob.array(&m.positions);
        blob.optional(m.normals.as_deref());
        blob.optional(m.tangents.as_deref());
        blob.optional(m.uv0.as_deref());
        blob.optional(m.uv1.as_deref());
        blob.optional(m.atlas_uv.as_deref());
        blob.optional(m.colors.as_deref());
        blob.optional(m.joints.as_deref());
        blob.optional(m.weights.as_deref());
        blob.optional(m.importance.as_deref());
        blob.array(&m.points);
        blob.array(&m.triangles);
        blob.array(&m.face_submesh);
    }

    pub(crate) fn read(blob: &mut BlobReader<'_>) -> Result<Mesh, BlobError> {
        let submeshes = blob.meta()?;
        let raw = RawMesh {
            positions: blob.array()?,
            normals: blob.optional()?,
            tangents: blob.optional()?,
            uv0: blob.optional()?,
            uv1: blob.optional()?,
            atlas_uv: blob.optional()?,
            colors: blob.optional()?,
            joints: blob.optional()?,
            weights: blob.optional()?,
            importance: blob.optional()?,
            points: blob.array()?,
            triangles: blob.array()?,
            face_submesh: blob.array()?,
            submeshes,
        };
        Mesh::new(raw).map_err(|e| BlobError::Content(e.to_string()))
    }
}

impl RawMesh {
    /// The vertices `keep[i]` in that order, and `triangles` and `face_submesh` as given (already in the new numbering);
    /// all attributes follow. Points are renumbered densely in order of first use.
    ///
    /// # Panics
    /// If an entry of `keep` is no vertex of `self`.
    pub fn gather(&self, keep: &[u32], triangles: Vec<[u32; 3]>, face_submesh: Vec<SubmeshId>) -> RawMesh {
        fn pick<T: Copy>(from: &[T], keep: &[u32]) -> Vec<T> {
            keep.iter().map(|v| from[*v as usize]).collect()
        }
        fn pick_some<T: Copy>(from: &Option<Vec<T>>, keep: &[u32]) -> Option<Vec<T>> {
            from.as_ref().map(|from| pick(from, keep))
        }
        let mut points = pick(&self.points, keep);
        let mut renumbered = vec![u32::MAX; points.iter().map(|p| p.index() + 1).max().unwrap_or(0)];
        let mut next = 0;
        for point in &mut points {
            let slot = &mut renumbered[point.index()];
            if *slot == u32::MAX {
                *slot = next;
                next += 1;
            }
            *point = PointId(*slot);
        }
        RawMesh {
            positions: pick(&self.positions, keep),
            normals: pick_some(&self.normals, keep),
            tangents: pick_some(&self.tangents, keep),
            uv0: pick_some(&self.uv0, keep),
            uv1: pick_some(&self.uv1, keep),
            atlas_uv: pick_some(&self.atlas_uv, keep),
            colors: pick_some(&self.colors, keep),
            joints: pick_some(&self.joints, keep),
            weights: pick_some(&self.weights, keep),
            importance: pick_some(&self.importance, keep),
            points,
            triangles,
            face_submesh,
            submeshes: self.submeshes.clone(),
        }
    }
}

fn check_attributes(raw: &RawMesh, vertex_count: usize, defects: &mut Defects) {
    fn check<T>(name: &str, values: Option<&[T]>, count: usize, finite: impl Fn(&T) -> bool, defects: &mut Defects) {
        let Some(values) = values else { return };
        if values.len() != count {
            defects.push(|| name.into(), || format!("{} entries for {count} vertices", values.len()));
        }
        for (i, value) in values.iter().enumerate() {
            if !finite(value) {
                defects.push(|| format!("{name}[{i}]"), || "not a finite number".into());
            }
        }
    }
    check("positions", Some(&raw.positions), vertex_count, |v| v.is_finite(), defects);
    check("normals", raw.normals.as_deref(), vertex_count, |v| v.is_finite(), defects);
    check("tangents", raw.tangents.as_deref(), vertex_count, |v| v.is_finite(), defects);
    check("uv0", raw.uv0.as_deref(), vertex_count, |v| v.is_finite(), defects);
    check("uv1", raw.uv1.as_deref(), vertex_count, |v| v.is_finite(), defects);
    check("atlas_uv", raw.atlas_uv.as_deref(), vertex_count, |v| v.is_finite(), defects);
    check("colors", raw.colors.as_deref(), vertex_count, |v| v.is_finite(), defects);
    check("joints", raw.joints.as_deref(), vertex_count, |_| true, defects);
    check("weights", raw.weights.as_deref(), vertex_count, |v| v.is_finite(), defects);
    check("importance", raw.importance.as_deref(), vertex_count, |v| v.is_finite() && *v >= 0.0, defects);
}

fn check_faces(raw: &RawMesh, vertex_count: usize, defects: &mut Defects) {
    if raw.face_submesh.len() != raw.triangles.len() {
        defects.push(
            || "face_submesh".into(),
            || format!("{} entries for {} faces", raw.face_submesh.len(), raw.triangles.len()),
        );
    }
    let mut vertex_submesh = vec![u32::MAX; vertex_count];
    let mut last = SubmeshId(0);
    for (f, (triangle, submesh)) in raw.triangles.iter().zip(&raw.face_submesh).enumerate() {
        if submesh.index() >= raw.submeshes.len() {
            let count = raw.submeshes.len();
            defects.push(|| format!("face_submesh[{f}]"), || format!("submesh {submesh} of {count}"));
        }
        if *submesh < last {
            defects.push(|| format!("face_submesh[{f}]"), || "faces are not ordered by submesh".into());
        }
        last = *submesh;
        for (k, v) in triangle.iter().enumerate() {
            match vertex_submesh.get_mut(*v as usize) {
                None => defects.push(|| format!("triangles[{f}][{k}]"), || format!("vertex {v} of {vertex_count}")),
                Some(owner) if *owner == u32::MAX => *owner = submesh.0,
                Some(owner) if *owner != submesh.0 => {
                    let owner = *owner;
                    defects.push(
                        || format!("triangles[{f}][{k}]"),
                        || format!("vertex {v} is used by submeshes {owner} and {submesh}"),
                    );
                }
                Some(_) => {}
            }
        }
    }
}

fn check_points(raw: &RawMesh, vertex_count: usize, defects: &mut Defects) -> u32 {
    if !defects.list.is_empty() {
        return 0;
    }
    if raw.points.len() != vertex_count {
        defects.push(|| "points".into(), || format!("{} entries for {vertex_count} vertices", raw.points.len()));
        return 0;
    }
    let mut used = vec![false; vertex_count];
    for (v, point) in raw.points.iter().enumerate() {
        match used.get_mut(point.index()) {
            Some(slot) => *slot = true,
            None => defects.push(|| format!("points[{v}]"), || format!("point {point} of at most {vertex_count}")),
        }
    }
    let count = used.iter().take_while(|u| **u).count();
    if used.iter().skip(count).any(|u| *u) {
        defects.push(|| "points".into(), || format!("not dense: point {count} is used by no vertex"));
    }
    count as u32
}

/// The point of each vertex `[vertex_count]`: vertices of one submesh at bitwise equal positions (-0 equals 0) share one;
/// numbered by first vertex.
fn weld_exact(raw: &RawMesh) -> Vec<PointId> {
    let mut submesh = vec![0u32; raw.positions.len()];
    for (triangle, s) in raw.triangles.iter().zip(&raw.face_submesh) {
        for v in triangle {
            submesh[*v as usize] = s.0;
        }
    }
    let key = |v: u32| {
        let bits = raw.positions[v as usize].to_array().map(|c| (c + 0.0).to_bits());
        (submesh[v as usize], bits)
    };
    let mut order: Vec<u32> = (0..raw.positions.len() as u32).collect();
    order.sort_unstable_by_key(|v| (key(*v), *v));
    // The first vertex of each run of equal keys stands for the run.
    let mut leader = vec![0u32; order.len()];
    let mut start = 0;
    for i in 0..order.len() {
        if key(order[i]) != key(order[start]) {
            start = i;
        }
        leader[order[i] as usize] = order[start];
    }
    let mut points = vec![PointId(0); order.len()];
    let mut next = 0;
    for v in 0..order.len() {
        if leader[v] as usize == v {
            points[v] = PointId(next);
            next += 1;
        } else {
            points[v] = points[leader[v] as usize];
        }
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad() -> RawMesh {
        RawMesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::X, Vec3::ONE, Vec3::Y],
            triangles: vec![[0, 1, 2], [3, 4, 5]],
            face_submesh: vec![SubmeshId(0); 2],
            submeshes: vec![Submesh { name: "quad".into(), ..Default::default() }],
            ..Default::default()
        }
    }

    #[test]
    fn equal_positions_of_one_submesh_share_a_point() {
        let mesh = Mesh::new(quad()).expect("valid");
        assert_eq!(mesh.point_count(), 4);
        assert_eq!(mesh.points[1], mesh.points[3]);
        assert_eq!(mesh.points[2], mesh.points[5]);
    }

    #[test]
    fn equal_positions_of_two_submeshes_stay_two_points() {
        let mut raw = quad();
        raw.submeshes.push(Submesh { name: "other".into(), ..Default::default() });
        raw.face_submesh[1] = SubmeshId(1);
        assert_eq!(Mesh::new(raw).expect("valid").point_count(), 6);
    }

    #[test]
    fn minus_zero_and_zero_are_one_place() {
        let mut raw = quad();
        raw.positions[3] = Vec3::new(1.0, -0.0, 0.0);
        assert_eq!(Mesh::new(raw).expect("valid").point_count(), 4);
    }

    #[test]
    fn every_defect_is_reported_with_its_path() {
        let mut raw = quad();
        raw.positions[1].x = f32::NAN;
        raw.triangles[1][2] = 6;
        raw.uv0 = Some(vec![Vec2::ZERO; 5]);
        let MeshError(defects) = Mesh::new(raw).expect_err("three defects");
        let paths: Vec<_> = defects.iter().map(|d| d.path.as_str()).collect();
        assert_eq!(paths, ["positions[1]", "uv0", "triangles[1][2]"]);
    }

    #[test]
    fn a_blob_gives_the_same_mesh_back_and_every_prefix_is_refused() {
        let mesh = Mesh::new(quad()).expect("valid");
        let blob = mesh.to_blob();
        assert_eq!(Mesh::from_blob(&blob).expect("whole"), mesh);
        for end in 0..blob.len() {
            assert!(Mesh::from_blob(&blob[..end]).is_err(), "prefix of {end} bytes was taken");
        }
    }
}
