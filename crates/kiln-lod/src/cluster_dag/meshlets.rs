//! Triangles into clusters, and clusters before they are grouped.

use glam::Vec3;
use kiln_asset::{Mesh, SubmeshId};
use meshopt::{VertexDataAdapter, build_meshlets_flex, compute_cluster_bounds, extract_meshlet_indices};
use rayon::prelude::*;

use super::{Cluster, MAX_TRIANGLES, MAX_VERTICES, bounds};
use crate::topology::NONE;

/// Fewest triangles before a cluster may end for its shape: more gives fuller clusters, fewer rounder ones. With this, clusters of all
/// levels have 123.5 triangles in the mean on bunny, 123.8 on armadillo, 124.6 on a ball of a million; others were not tried.
const MIN_TRIANGLES: usize = 96;
/// By how much larger than expected a cluster may be before it ends for its shape.
const SPLIT: f32 = 2.0;

/// The mesh's vertices moved and scaled into a cube of side 1: what meshlets are made of, whatever the object's size and place.
pub(super) struct Unit {
    /// `[vertex_count]`.
    pub(super) positions: Vec<[f32; 3]>,
}

impl Unit {
    pub(super) fn new(mesh: &Mesh) -> Unit {
        let (low, high) = mesh.bounds();
        let (low, extent) = (low.as_dvec3(), (high.as_dvec3() - low.as_dvec3()).max_element());
        let scale = if extent > 0.0 { 1.0 / extent } else { 0.0 };
        Unit { positions: mesh.positions.iter().map(|p| ((p.as_dvec3() - low) * scale).as_vec3().to_array()).collect() }
    }
}

/// The clusters of a level before they are grouped: places in the DAG, group and level are not known yet.
#[derive(Default)]
pub(super) struct Pieces {
    pub(super) clusters: Vec<Cluster>,
    /// `[clusters]`: how many levels in a row nothing became of it.
    pub(super) idle: Vec<u8>,
    references: Vec<u32>,
    corners: Vec<u8>,
}

/// Triangles of one submesh over vertices of their own, and the mesh's ids of these.
pub(super) struct Part<'a> {
    pub(super) submesh: u32,
    pub(super) triangles: &'a [[u32; 3]],
    /// `[vertices of the part]`.
    pub(super) vertices: &'a [u32],
}

impl Pieces {
    /// The mesh's own triangles, submesh by submesh.
    pub(super) fn of_mesh(mesh: &Mesh, unit: &Unit) -> Pieces {
        // A vertex is of one submesh, so one array serves all.
        let mut local = vec![NONE; mesh.vertex_count()];
        let mut parts: Vec<(u32, Vec<[u32; 3]>, Vec<u32>)> = Vec::new();
        let mut face = 0;
        while face < mesh.face_count() {
            let submesh: SubmeshId = mesh.face_submesh[face];
            let faces = mesh.submesh_faces(submesh);
            face = faces.end;
            let mut vertices = Vec::new();
            let mut name = |v: u32| {
                let slot = &mut local[v as usize];
                if *slot == NONE {
                    *slot = vertices.len() as u32;
                    vertices.push(v);
                }
                *slot
            };
            let triangles = mesh.triangles[faces].iter().map(|t| t.map(&mut name)).collect();
            parts.push((submesh.0, triangles, vertices));
        }
        let split: Vec<Pieces> = parts
            .par_iter()
            .map(|(submesh, triangles, vertices)| {
                let mut out = Pieces::default();
                out.split(mesh, unit, &Part { submesh: *submesh, triangles, vertices });
                out
            })
            .collect();
        let mut out = Pieces::default();
        split.iter().for_each(|pieces| out.append(pieces, NONE, false));
        out
    }

    /// Appends the clusters of a part.
    pub(super) fn split(&mut self, mesh: &Mesh, unit: &Unit, part: &Part<'_>) {
        let positions: Vec<[f32; 3]> = part.vertices.iter().map(|v| unit.positions[*v as usize]).collect();
        let Ok(adapter) = VertexDataAdapter::new(bytemuck::cast_slice(&positions), size_of::<[f32; 3]>(), 0) else {
            return;
        };
        let indices: &[u32] = part.triangles.as_flattened();
        // A few triangles are one cluster, wherever they lie.
        if part.triangles.len() <= MAX_TRIANGLES as usize && part.vertices.len() <= MAX_VERTICES as usize {
            if !indices.is_empty() {
                let (vertices, corners) = extract_meshlet_indices(indices);
                self.push(mesh, part, &adapter, &vertices, &corners);
            }
            return;
        }
        let made = build_meshlets_flex(
            indices,
            &adapter,
            MAX_VERTICES as usize,
            MIN_TRIANGLES,
            MAX_TRIANGLES as usize,
            0.0,
            SPLIT,
        );
        for meshlet in made.iter() {
            self.push(mesh, part, &adapter, meshlet.vertices, meshlet.triangles);
        }
    }

    fn push(&mut self, mesh: &Mesh, part: &Part<'_>, unit: &VertexDataAdapter<'_>, vertices: &[u32], corners: &[u8]) {
        let indices: Vec<u32> = corners.iter().map(|place| vertices[*place as usize]).collect();
        let cone = compute_cluster_bounds(&indices, unit);
        // Without a triangle that has an area, all is 0.
        let has_axis = cone.cone_axis != [0.0; 3] && cone.cone_cutoff.is_finite();
        let [x, y, z] = cone.cone_axis;
        let references = vertices.iter().map(|v| part.vertices[*v as usize]);
        let place = |v: u32| -> [f32; 4] {
            let p: Vec3 = mesh.positions[v as usize];
            [p.x, p.y, p.z, 0.0]
        };
        let spheres: Vec<[f32; 4]> = references.clone().map(place).collect();
        self.clusters.push(Cluster {
            first_reference: self.references.len() as u32,
            vertex_count: vertices.len() as u32,
            first_triangle: (self.corners.len() / 3) as u32,
            triangle_count: (corners.len() / 3) as u32,
            submesh: part.submesh,
            group: NONE,
            made_by: NONE,
            level: 0,
            sphere: bounds::around(&spheres),
            cone: if has_axis { [x, y, z, cone.cone_cutoff] } else { [0.0, 0.0, 0.0, 1.0] },
        });
        self.idle.push(0);
        self.references.extend(references);
        self.corners.extend_from_slice(corners);
    }

    /// Appends clusters that group `made_by` made; `passed_on`: out of the triangles that it had.
    pub(super) fn append(&mut self, other: &Pieces, made_by: u32, passed_on: bool) {
        let (references, triangles) = (self.references.len() as u32, (self.corners.len() / 3) as u32);
        self.clusters.extend(other.clusters.iter().map(|cluster| Cluster {
            first_reference: cluster.first_reference + references,
            first_triangle: cluster.first_triangle + triangles,
            made_by,
            ..*cluster
        }));
        self.idle.extend(other.idle.iter().map(|idle| if passed_on { idle + 1 } else { 0 }));
        self.references.extend_from_slice(&other.references);
        self.corners.extend_from_slice(&other.corners);
    }

    /// Sets how often nothing became of these clusters so far.
    pub(super) fn rest(&mut self, idle: u8) {
        self.idle.fill(idle);
    }

    /// A cluster's vertices.
    pub(super) fn references_of(&self, cluster: u32) -> &[u32] {
        let cluster = &self.clusters[cluster as usize];
        &self.references[cluster.first_reference as usize..][..cluster.vertex_count as usize]
    }

    /// Three a triangle: places in a cluster's references.
    pub(super) fn corners_of(&self, cluster: u32) -> &[u8] {
        let cluster = &self.clusters[cluster as usize];
        &self.corners[3 * cluster.first_triangle as usize..][..3 * cluster.triangle_count as usize]
    }

    /// Triangles of these clusters.
    pub(super) fn triangles(&self, members: &[u32]) -> usize {
        members.iter().map(|c| self.clusters[*c as usize].triangle_count as usize).sum()
    }
}
