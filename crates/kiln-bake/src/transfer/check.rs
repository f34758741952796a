//! What must hold before and after a bake.

use kiln_asset::{FaceId, LodSet, MaterialSet, Mesh};

/// Whether the mesh's tangents point where `atlas_uv` grows in u, on most of its faces: tangents that an earlier stage made
/// for another layout point anywhere. Meshes without tangents or atlas do not pass.
pub fn tangents_follow_atlas(mesh: &Mesh) -> bool {
    let (Some(tangents), Some(uv)) = (&mesh.tangents, &mesh.atlas_uv) else { return false };
    let (mut with, mut against) = (0.0f64, 0.0f64);
    for (face, triangle) in mesh.triangles.iter().enumerate() {
        let [p0, p1, p2] = mesh.face_positions(FaceId(face as u32));
        let [t0, t1, t2] = triangle.map(|v| uv[v as usize]);
        let (d1, d2) = (t1 - t0, t2 - t0);
        // dP/du times the UV area, whose sign keeps mirrored faces right.
        let area = d1.perp_dot(d2);
        let along_u = ((p1 - p0) * d2.y - (p2 - p0) * d1.y) * area.signum();
        let weight = (p1 - p0).cross(p2 - p0).length() as f64;
        let agreement: f32 = triangle.iter().map(|v| tangents[*v as usize].truncate().dot(along_u)).sum();
        if agreement > 0.0 {
            with += weight;
        } else if agreement < 0.0 {
            against += weight;
        }
    }
    with > 0.0 && with >= 4.0 * against
}

/// Everything a baked set promises; the first broken promise by name.
pub fn check(before: &LodSet, after: &LodSet, set: &MaterialSet, pictures: usize) -> Result<(), String> {
    if before.levels.len() != after.levels.len() || set.images.len() != pictures {
        return Err("levels or pictures differ in number".into());
    }
    for (level, (a, b)) in before.levels.iter().zip(&after.levels).enumerate() {
        if b.mesh.uv0.is_none() || b.mesh.atlas_uv.is_some() || b.mesh.uv1.is_some() {
            return Err(format!("level {level}: the atlas is not its only UV set"));
        }
        if a.mesh.face_count() != b.mesh.face_count() || a.error != b.error {
            return Err(format!("level {level}: triangles or error changed"));
        }
        for face in 0..a.mesh.face_count() as u32 {
            if a.mesh.face_positions(FaceId(face)) != b.mesh.face_positions(FaceId(face)) {
                return Err(format!("level {level}: face {face} moved"));
            }
        }
        for submesh in &b.mesh.submeshes {
            if submesh.material.is_none_or(|m| m.index() >= set.materials.len()) {
                return Err(format!("level {level}: submesh {} has no new material", submesh.name));
            }
        }
    }
    Ok(())
}
