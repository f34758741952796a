//! One group as a mesh of its own: simplified, measured, split again.

use kiln_asset::{Mesh, MeshError, PointId, QuadricCoefficients, RawMesh, Submesh, SubmeshId};

use super::meshlets::{Part, Pieces, Unit};
use super::round::Round;
use super::{DagError, STUCK};
use crate::simplify::{SimplifyOptions, collapse_patch, surface_error};

/// What became of a group.
pub(super) struct Outcome {
    /// Distance to what replaces it, object units; `None`: nothing does.
    pub(super) error: Option<f32>,
    /// The clusters that replace it.
    pub(super) made: Option<Pieces>,
    /// Whether these have the triangles that it had.
    pub(super) passed_on: bool,
    /// Triangles of what replaces it, or its own.
    pub(super) triangles: usize,
    /// By what the forms of points grew, object space.
    pub(super) gained: Vec<(u32, QuadricCoefficients)>,
}

impl Outcome {
    /// Of a group that nothing replaces.
    pub(super) fn root() -> Outcome {
        Outcome { error: None, made: None, passed_on: false, triangles: 0, gained: Vec::new() }
    }
}

/// A group's faces over vertices, points and submeshes of their own.
pub(super) struct Patch {
    mesh: Mesh,
    /// The mesh's ids, ascending.
    vertices: Vec<u32>,
    points: Vec<u32>,
    submeshes: Vec<u32>,
}

impl Patch {
    /// `members`: clusters by submesh.
    pub(super) fn new(mesh: &Mesh, pieces: &Pieces, members: &[u32]) -> Result<Patch, MeshError> {
        let mut vertices: Vec<u32> = members.iter().flat_map(|c| pieces.references_of(*c)).copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        let mut points: Vec<u32> = vertices.iter().map(|v| mesh.points[*v as usize].0).collect();
        points.sort_unstable();
        points.dedup();
        let (mut triangles, mut face_submesh, mut submeshes) = (Vec::new(), Vec::new(), Vec::new());
        let mut names: Vec<u32> = Vec::new();
        for c in members {
            let submesh = pieces.clusters[*c as usize].submesh;
            if submeshes.last() != Some(&submesh) {
                submeshes.push(submesh);
            }
            names.clear();
            names.extend(pieces.references_of(*c).iter().map(|v| vertices.partition_point(|w| w < v) as u32));
            for t in pieces.corners_of(*c).chunks_exact(3) {
                triangles.push([t[0], t[1], t[2]].map(|place| names[place as usize]));
                face_submesh.push(SubmeshId(submeshes.len() as u32 - 1));
            }
        }
        let local = |v: &u32| PointId(points.partition_point(|q| *q < mesh.points[*v as usize].0) as u32);
        let raw = RawMesh {
            points: vertices.iter().map(local).collect(),
            triangles,
            face_submesh,
            submeshes: vec![Submesh::default(); submeshes.len()],
            ..attributes(mesh, &vertices)
        };
        Ok(Patch { mesh: Mesh::new(raw)?, vertices, points, submeshes })
    }

    /// The group with half of its triangles, in clusters; with all of them where it is stuck.
    pub(super) fn halve(
        self,
        mesh: &Mesh,
        unit: &Unit,
        round: &Round,
        forms: &[QuadricCoefficients],
        options: &SimplifyOptions,
        samples: u32,
    ) -> Result<Outcome, DagError> {
        let fixed: Vec<bool> = self.points.iter().map(|p| round.is_fixed(*p)).collect();
        let carried: Vec<QuadricCoefficients> = self.points.iter().map(|p| forms[*p as usize]).collect();
        let (sequence, gained) = collapse_patch(&self.mesh, &carried, options, &fixed);
        let count = self.mesh.face_count();
        let most = (STUCK * count as f64) as usize;
        let left = sequence.faces_after(sequence.collapses.len()) as usize;
        if left == 0 || left > most {
            return Ok(self.passed_on(mesh, unit));
        }
        // A partner may go later: from the last pair backwards, its own end is known already.
        let mut stands: Vec<u32> = (0..self.vertices.len() as u32).collect();
        for [wedge, partner] in sequence.pairs.iter().rev() {
            stands[*wedge as usize] = stands[*partner as usize];
        }
        let mut stays = vec![true; count];
        sequence.faces.iter().for_each(|f| stays[*f as usize] = false);
        let faces = || (0..count).filter(|f| stays[*f]);
        let triangles: Vec<[u32; 3]> = faces().map(|f| self.mesh.triangles[f].map(|v| stands[v as usize])).collect();
        let face_submesh: Vec<SubmeshId> = faces().map(|f| self.mesh.face_submesh[f]).collect();
        let simplified = Mesh::new(RawMesh {
            positions: self.mesh.positions.clone(),
            points: self.mesh.points.clone(),
            triangles,
            face_submesh,
            submeshes: self.mesh.submeshes.clone(),
            ..RawMesh::default()
        })?;
        let error = surface_error(&self.mesh, &simplified, samples);
        if !error.is_finite() {
            return Ok(self.passed_on(mesh, unit));
        }
        Ok(Outcome {
            error: Some(error),
            made: Some(self.split(mesh, unit, &simplified)),
            passed_on: false,
            triangles: left,
            gained: gained.into_iter().map(|(p, gain)| (self.points[p as usize], gain)).collect(),
        })
    }

    /// The same triangles in new clusters.
    fn passed_on(&self, mesh: &Mesh, unit: &Unit) -> Outcome {
        let made = Some(self.split(mesh, unit, &self.mesh));
        Outcome { error: Some(0.0), made, passed_on: true, triangles: self.mesh.face_count(), gained: Vec::new() }
    }

    fn split(&self, mesh: &Mesh, unit: &Unit, level: &Mesh) -> Pieces {
        let mut out = Pieces::default();
        for (s, submesh) in (0..).zip(&self.submeshes) {
            let triangles = &level.triangles[level.submesh_faces(SubmeshId(s))];
            // Vertices that are left, in the mesh's order.
            let mut vertices: Vec<u32> = triangles.iter().flatten().copied().collect();
            vertices.sort_unstable();
            vertices.dedup();
            let local = |v: u32| vertices.partition_point(|w| *w < v) as u32;
            let triangles: Vec<[u32; 3]> = triangles.iter().map(|t| t.map(local)).collect();
            let vertices: Vec<u32> = vertices.iter().map(|v| self.vertices[*v as usize]).collect();
            out.split(mesh, unit, &Part { submesh: *submesh, triangles: &triangles, vertices: &vertices });
        }
        out
    }
}

/// The attributes of `vertices` by which collapses go.
fn attributes(mesh: &Mesh, vertices: &[u32]) -> RawMesh {
    fn pick<T: Copy>(from: &[T], vertices: &[u32]) -> Vec<T> {
        vertices.iter().map(|v| from[*v as usize]).collect()
    }
    fn some<T: Copy>(from: &Option<Vec<T>>, vertices: &[u32]) -> Option<Vec<T>> {
        from.as_ref().map(|from| pick(from, vertices))
    }
    RawMesh {
        positions: pick(&mesh.positions, vertices),
        normals: some(&mesh.normals, vertices),
        uv0: some(&mesh.uv0, vertices),
        uv1: some(&mesh.uv1, vertices),
        atlas_uv: some(&mesh.atlas_uv, vertices),
        colors: some(&mesh.colors, vertices),
        joints: some(&mesh.joints, vertices),
        weights: some(&mesh.weights, vertices),
        importance: some(&mesh.importance, vertices),
        ..RawMesh::default()
    }
}
