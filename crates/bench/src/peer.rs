//! meshoptimizer (the crate `meshopt`) as its users call it: one call for the whole model, no locks, no limit on the error.
//!
//! All submeshes go in together, as one index buffer over wedges that no two submeshes share. So the peer spends the budget
//! where it costs least, opens no crack between submeshes, and hits the total; one call a submesh, with the same share each,
//! would take that freedom from it. Wedges are welded by what the metric weighs: position and UV, and the normal where its
//! weight is not 0, so that a crease that does not count holds nothing.
//!
//! Attributes go in as they are, UVs as in the file and normals of unit length; the weights are the setting (meshoptimizer
//! scales positions to the unit cube itself).

use glam::{Vec2, Vec3};
use kiln_asset::{Mesh, SubmeshId};
use kiln_measure::scene::shading_normals;
use meshopt::{SimplifyOptions, VertexDataAdapter, typed_to_bytes};

use crate::timed;

/// More than any error.
const NO_LIMIT: f32 = 1e9;

/// Which call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call {
    /// `simplify`: positions alone, at places of the source.
    Simplify,
    /// `simplify_with_attributes`: at places of the source.
    WithAttributes,
    /// `simplify_with_update`: places and attributes are moved.
    WithUpdate,
}

/// A call and its weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setting {
    /// Which call.
    pub call: Call,
    /// Weight of both UV coordinates, unitless; 0 leaves them out.
    pub uv: f32,
    /// Weight of the three coordinates of the normal, unitless; 0 leaves them out.
    pub normal: f32,
}

impl Setting {
    /// The twelve settings that textured models are tried with.
    pub fn textured() -> Vec<Setting> {
        let mut all = Vec::new();
        for call in [Call::WithAttributes, Call::WithUpdate] {
            for uv in [1.0, 10.0, 100.0] {
                for normal in [0.0, 0.5] {
                    all.push(Setting { call, uv, normal });
                }
            }
        }
        all
    }

    /// Its name in a table.
    pub fn name(&self) -> String {
        match self.call {
            Call::Simplify => "meshopt simplify".into(),
            Call::WithAttributes if self.uv > 0.0 => {
                format!("meshopt with_attributes, UV {}, normals {}", self.uv, self.normal)
            }
            Call::WithUpdate if self.uv > 0.0 => {
                format!("meshopt with_update, UV {}, normals {}", self.uv, self.normal)
            }
            Call::WithAttributes => format!("meshopt with_attributes, normals {}", self.normal),
            Call::WithUpdate => format!("meshopt with_update, normals {}", self.normal),
        }
    }
}

/// A mesh ready for one setting.
#[derive(Clone, Debug)]
pub struct Input {
    mesh: Mesh,
    setting: Setting,
    /// `[vertex_count]`
    vertex_submesh: Vec<SubmeshId>,
    indices: Vec<u32>,
    places: Vec<[f32; 3]>,
    /// `[vertex_count] x weights.len()`
    attributes: Vec<f32>,
    weights: Vec<f32>,
}

/// What a call gave.
#[derive(Clone, Debug)]
pub struct Output {
    indices: Vec<u32>,
    places: Vec<[f32; 3]>,
    attributes: Vec<f32>,
}

impl Input {
    /// `mesh` welded for `setting`.
    ///
    /// # Errors
    /// None for a valid mesh.
    pub fn new(mesh: &Mesh, setting: Setting) -> Result<Input, String> {
        let normals = if setting.normal > 0.0 { shading_normals(mesh) } else { Vec::new() };
        let uvs: Vec<Vec2> = match &mesh.uv0 {
            Some(uvs) if setting.uv > 0.0 => uvs.clone(),
            _ => Vec::new(),
        };
        let vertex_submesh = vertex_submeshes(&mesh.triangles, &mesh.face_submesh, mesh.vertex_count());
        let (keep, triangles) = welded(mesh, &vertex_submesh, &uvs, &normals);
        let mut raw = mesh.gather(&keep, triangles, mesh.face_submesh.clone());
        // Points anew: what kiln's merge joined across submeshes means nothing to the peer.
        raw.points = Vec::new();
        let welded = Mesh::new(raw).map_err(|e| e.to_string())?;
        let (mut attributes, mut weights) = (Vec::new(), Vec::new());
        if !uvs.is_empty() {
            weights.extend([setting.uv; 2]);
        }
        if !normals.is_empty() {
            weights.extend([setting.normal; 3]);
        }
        for v in &keep {
            if let Some(uv) = uvs.get(*v as usize) {
                attributes.extend(uv.to_array());
            }
            if let Some(normal) = normals.get(*v as usize) {
                attributes.extend(normal.to_array());
            }
        }
        Ok(Input {
            indices: welded.triangles.as_flattened().to_vec(),
            places: welded.positions.iter().map(|p| p.to_array()).collect(),
            vertex_submesh: keep.iter().map(|v| vertex_submesh[*v as usize]).collect(),
            mesh: welded,
            setting,
            attributes,
            weights,
        })
    }

    /// The call down to at most `budget` triangles, and its seconds; copies for calls that write into their input are made
    /// outside the clock.
    ///
    /// # Errors
    /// The crate refuses the buffers.
    pub fn run(&self, budget: u32) -> Result<(Output, f64), String> {
        let target = budget as usize * 3;
        let stride = 4 * self.weights.len();
        let (mut indices, mut places, mut attributes) = (Vec::new(), self.places.clone(), self.attributes.clone());
        let adapter = VertexDataAdapter::new(typed_to_bytes(&self.places), 12, 0).map_err(|e| e.to_string())?;
        let seconds = match self.setting.call {
            Call::Simplify => {
                let run = || meshopt::simplify(&self.indices, &adapter, target, NO_LIMIT, SimplifyOptions::None, None);
                let (out, seconds) = timed(run);
                indices = out;
                seconds
            }
            Call::WithAttributes => {
                let locks = vec![false; places.len()];
                let (out, seconds) = timed(|| {
                    meshopt::simplify_with_attributes_and_locks(
                        &self.indices,
                        &adapter,
                        &self.attributes,
                        &self.weights,
                        stride,
                        &locks,
                        target,
                        NO_LIMIT,
                        SimplifyOptions::None,
                        None,
                    )
                });
                indices = out;
                seconds
            }
            Call::WithUpdate => {
                indices.clone_from(&self.indices);
                let (count, seconds) = timed(|| {
                    meshopt::simplify_with_update(
                        &mut indices,
                        &mut places,
                        &mut attributes,
                        &self.weights,
                        stride,
                        None,
                        target,
                        NO_LIMIT,
                        SimplifyOptions::None,
                        None,
                    )
                });
                indices.truncate(count);
                seconds
            }
        };
        Ok((Output { indices, places, attributes }, seconds))
    }

    /// The result as a mesh, with moved places and UVs where the call moves them.
    ///
    /// # Errors
    /// The result is no valid mesh.
    pub fn level(&self, output: &Output) -> Result<Mesh, String> {
        let mut moved = self.mesh.clone().into_raw();
        moved.positions = output.places.iter().map(|p| Vec3::from_array(*p)).collect();
        if let (Some(uvs), true) = (&mut moved.uv0, self.setting.uv > 0.0) {
            for (uv, attributes) in uvs.iter_mut().zip(output.attributes.chunks_exact(self.weights.len())) {
                *uv = Vec2::new(attributes[0], attributes[1]);
            }
        }
        let mut faces: Vec<[u32; 3]> = output.indices.as_chunks().0.to_vec();
        faces.sort_by_key(|face| self.vertex_submesh[face[0] as usize]);
        let face_submesh = faces.iter().map(|face| self.vertex_submesh[face[0] as usize]).collect();
        let mut place = vec![u32::MAX; moved.positions.len()];
        faces.iter().flatten().for_each(|v| place[*v as usize] = 0);
        let used: Vec<u32> = (0..place.len() as u32).filter(|v| place[*v as usize] == 0).collect();
        used.iter().enumerate().for_each(|(i, v)| place[*v as usize] = i as u32);
        let triangles = faces.iter().map(|face| face.map(|v| place[v as usize])).collect();
        let mut level = moved.gather(&used, triangles, face_submesh);
        level.points = Vec::new();
        Mesh::new(level).map_err(|e| e.to_string())
    }
}

/// One vertex for each set of equal submesh, position, UV and normal, lowest first, and the triangles over those.
fn welded(mesh: &Mesh, vertex_submesh: &[SubmeshId], uvs: &[Vec2], normals: &[Vec3]) -> (Vec<u32>, Vec<[u32; 3]>) {
    // 0 and -0 are one.
    let bits = |value: f32| (value + 0.0).to_bits();
    let key = |v: u32| {
        let v = v as usize;
        let place = mesh.positions[v].to_array().map(bits);
        let uv = uvs.get(v).map_or([0; 2], |uv| uv.to_array().map(bits));
        let normal = normals.get(v).map_or([0; 3], |normal| normal.to_array().map(bits));
        (vertex_submesh[v], place, uv, normal)
    };
    let mut order: Vec<u32> = (0..mesh.vertex_count() as u32).collect();
    order.sort_by_key(|v| key(*v));
    let mut first = vec![0; order.len()];
    for same in order.chunk_by(|a, b| key(*a) == key(*b)) {
        same.iter().for_each(|v| first[*v as usize] = same[0]);
    }
    let keep: Vec<u32> = (0..first.len() as u32).filter(|v| first[*v as usize] == *v).collect();
    let mut place = vec![0; first.len()];
    keep.iter().enumerate().for_each(|(i, v)| place[*v as usize] = i as u32);
    (keep, mesh.triangles.iter().map(|t| t.map(|v| place[first[v as usize] as usize])).collect())
}

/// `[vertex_count]`: the submesh whose faces use each vertex.
fn vertex_submeshes(triangles: &[[u32; 3]], face_submesh: &[SubmeshId], vertex_count: usize) -> Vec<SubmeshId> {
    let mut of = vec![SubmeshId(0); vertex_count];
    for (triangle, submesh) in triangles.iter().zip(face_submesh) {
        triangle.iter().for_each(|v| of[*v as usize] = *submesh);
    }
    of
}

#[cfg(test)]
mod tests {
    use super::*;
    use kiln_asset::{RawMesh, Submesh};

    /// Two quads side by side, `n` by `n` each, a submesh each, every face with vertices of its own.
    fn quads(n: u32) -> Mesh {
        let mut raw = RawMesh { submeshes: vec![Submesh::default(); 2], uv0: Some(Vec::new()), ..Default::default() };
        for part in 0..2 {
            for cell in 0..n * n {
                let (i, j) = (cell % n, cell / n);
                for corners in [[(0, 0), (1, 0), (1, 1)], [(0, 0), (1, 1), (0, 1)]] {
                    let v = raw.positions.len() as u32;
                    for (di, dj) in corners {
                        let at = Vec2::new((i + di) as f32, (j + dj) as f32);
                        raw.positions.push(Vec3::new(at.x + (part * n) as f32, at.y, 0.0));
                        raw.uv0.as_mut().expect("set above").push(at);
                    }
                    raw.triangles.push([v, v + 1, v + 2]);
                    raw.face_submesh.push(SubmeshId(part));
                }
            }
        }
        Mesh::new(raw).expect("valid")
    }

    #[test]
    fn wedges_are_welded_within_their_submesh_and_every_call_keeps_the_parts() {
        let mesh = quads(8);
        for setting in Setting::textured().into_iter().chain([Setting { call: Call::Simplify, uv: 0.0, normal: 0.0 }]) {
            let input = Input::new(&mesh, setting).expect("valid");
            assert_eq!(input.places.len(), 2 * 81, "{}", setting.name());
            let (output, _) = input.run(40).expect("buffers");
            let level = input.level(&output).expect("valid");
            assert!(level.face_count() <= 40 && level.face_count() >= 4, "{}: {}", setting.name(), level.face_count());
            for part in 0..2 {
                let area = |mesh: &Mesh| -> f64 {
                    let faces = mesh.submesh_faces(SubmeshId(part));
                    let corners = mesh.triangles[faces].iter().map(|t| t.map(|v| mesh.positions[v as usize]));
                    corners.map(kiln_geom::triangle::area).sum()
                };
                assert!((area(&level) - area(&mesh)).abs() < 1e-3, "{}: {}", setting.name(), area(&level));
            }
        }
    }
}
