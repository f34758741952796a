//! The bake: what the high mesh looks like, written into the low mesh's sheets.
//!
//! Comes in: a high mesh with its materials and pictures, levels of a low mesh that share one atlas. Goes out: the levels with that
//! atlas as their only UVs, one material for each (sheet, alpha mode, sidedness) in use, and the maps. Positions, triangles and
//! normals of the levels do not change.
//!
//! ```text
//! each face of the finest level: a bundle of lines, linear in the place on the sheet                 (low)
//! each sheet, each bin of its texels, rows of bins in parallel:                                      (pass)
//!     each sample is owned by the lowest face that covers its centre                                 (sheet)
//!     high triangles that lines of a face can reach, from one tree; where each line meets them;
//!     the outermost, or the nearest, stays                           (search; gpu; correspondence instead of both)
//!     for each sample with a winner: the place on it, in double precision                            (resolve)
//!     every map's value there: normals, textures averaged over the sample, heights, ids, ...         (maps, texture, evaluate)
//!     samples of a texel's chart, weighted by a tent                                                 (evaluate)
//! fill what is left (dilation); write materials (materials)
//! ```
//!
//! Departures from the thesis. It mirrors vertices with k > 0 through the plane, which folds a triangle that straddles it, so that its
//! depth is no distance; here every line meets the triangle itself, in front or behind. Its directions are the faces' normals
//! (`directions = "face"`); with smooth ones a projection of vertices is wrong between them, so the image of an edge is taken for
//! what it is, a conic. Normals are not mirrored, nothing is clipped at the plane, facing is asked in space. Culling by a tree and
//! many low triangles at once are what it leaves as future work. A graphics card only names winners; all values are computed on the
//! CPU from ids, so backends share them.
//!
//! Hit rules. `outermost` is what bakers do today: the first surface that faces the line's way from `front` inwards. It shows parts that
//! float within `front`, and an overhang that comes within it; hence a reach of 1.5 times the level's measured distance and no
//! more. `nearest` is the thesis's.
//!
//! Limits: lines of a concave corner cross; they are cut there (counted). Samples of one texel that lie in two charts count for the
//! heavier one. Coarser levels use the finest level's maps with the normals and tangents that simplification carried along. Tangents
//! are those of the meshes given, if they belong to the atlas (`atlas` gives them); where a mesh has none, MikkTSpace computes them.
//!
//! Sources: C. González, thesis 2010, sections 6.2 (correspondence), 6.3 (mirrored vertices), 7.1 (other values); J. Plücker's
//! coordinates as in N. Platis, T. Theoharis, Fast Ray-Tetrahedron Intersection Using Plücker Coordinates, JGT 8(4), 2003; M.
//! Mikkelsen, Simulation of Wrinkled Surfaces Revisited, MSc thesis, University of Copenhagen 2008 (tangent frames).

mod charts;
pub mod check;
mod correspondence;
mod evaluate;
mod gpu;
mod hit_buffer;
mod low;
mod maps;
mod materials;
mod options;
mod pass;
mod resolve;
mod search;
mod sheet;
mod texture;

use kiln_asset::{ExtraMap, Level, LodSet, MapRole, Material, MaterialId, Mesh};

use crate::tangents::{self, UvSource};
use evaluate::{Planned, What};
use maps::RoleSource;
use materials::{Groups, is_neutral, material_of};
use pass::{Pass, Tree};

pub use hit_buffer::{HitBuffer, find_hits};
pub use options::{
    Backend, BakeError, BakeInput, BakeOptions, BakeReport, Baked, Depth, Directions, HitRule, Images, Matching,
    Method, NormalSpace, OcclusionSource, Picture,
};

/// Bakes the high mesh onto the finest of the levels.
///
/// # Errors
/// See [`BakeError`]; nothing is made by halves.
pub fn bake(input: &BakeInput<'_>, options: &BakeOptions, backend: Backend<'_>) -> Result<Baked, BakeError> {
    let BakeInput { high, low, materials, images, .. } = *input;
    let meshes = dressed(low, options)?;
    let finest = meshes.first().ok_or(BakeError::NoLevels)?;
    let sheets = low.layout.map_or(1, |layout| layout.sheets.max(1));
    let reach = reach(high, low.levels[0].error, options);
    let used: Vec<Material> = finest.submeshes.iter().map(|s| material_of(materials, s.material)).collect();
    let (asked, neutral): (Vec<MapRole>, Vec<MapRole>) = MapRole::ALL
        .iter()
        .filter(|r| options.maps.contains(r))
        .partition(|r| !is_neutral(**r, &used) || What::Role(**r).looks_out(options));
    let groups = Groups::new(finest, materials);
    let mut planned = Vec::new();
    for role in &asked {
        let source = Some(RoleSource::new(*role, high, materials, images)?);
        planned.push(Planned { what: What::Role(*role), source });
    }
    for extra in ExtraMap::ALL.iter().filter(|e| options.extras.contains(e)) {
        let source = match extra {
            ExtraMap::Opacity => Some(RoleSource::new(MapRole::BaseColor, high, materials, images)?),
            _ => None,
        };
        planned.push(Planned { what: What::Extra(*extra), source });
    }
    let mut report = BakeReport {
        size: options.size,
        front: reach[0],
        back: reach[1],
        sheets,
        short_padding: short_padding(low, options),
        lost_maps: lost_maps(&asked, &used),
        neutral_maps: neutral,
        maps: asked.clone(),
        extras: ExtraMap::ALL.iter().copied().filter(|e| options.extras.contains(e)).collect(),
        ..BakeReport::default()
    };
    let tree = Tree::of(high);
    let mut pictures = Vec::new();
    for sheet in 0..sheets {
        let pass = Pass::new(input, &tree, finest, sheet, options, reach, backend)?;
        pictures.extend(pass.bake(&groups, &planned, &mut report)?);
    }
    let set = materials::new_set(finest, materials, &groups, &planned, &pictures, options);
    let drop_colors = options.maps.contains(&MapRole::BaseColor);
    let mut levels = Vec::with_capacity(meshes.len());
    for (level, mesh) in meshes.into_iter().enumerate() {
        let mesh = redress(mesh, &groups, drop_colors).map_err(|message| BakeError::Mesh { level, message })?;
        let Level { error, quadrics, .. } = &low.levels[level];
        levels.push(Level { mesh, error: *error, quadrics: quadrics.clone() });
    }
    let levels = LodSet { levels, layout: low.layout, source_triangles: low.source_triangles };
    Ok(Baked { levels, materials: set, pictures, report })
}

fn reach(high: &Mesh, error: f32, options: &BakeOptions) -> [f32; 2] {
    // A mesh without extent has nothing to hit, but a reach must be positive.
    let own = (BakeOptions::REACH * error).max(BakeOptions::REACH_SHARE * high.diagonal()).max(f32::MIN_POSITIVE);
    [options.front.unwrap_or(own), options.back.unwrap_or(own)]
}

/// Maps that materials in use have and nobody asked for.
fn lost_maps(asked: &[MapRole], used: &[Material]) -> Vec<MapRole> {
    let lost = |r: &MapRole| !asked.contains(r) && used.iter().any(|m| m.map(*r).is_some());
    MapRole::ALL.iter().copied().filter(lost).collect()
}

/// The layout's padding at the maps' size, texels, where it is less than the dilation.
fn short_padding(low: &LodSet, options: &BakeOptions) -> Option<u32> {
    let layout = low.layout?;
    let padding = (layout.padding as u64 * options.size as u64 / layout.size.max(1) as u64) as u32;
    (padding < options.dilation).then_some(padding)
}

/// The levels' meshes with the layout to bake into as `atlas_uv`, and tangents that belong to it where the bake needs any.
fn dressed(low: &LodSet, options: &BakeOptions) -> Result<Vec<Mesh>, BakeError> {
    let needs_tangents = options.maps.contains(&MapRole::Normal) && options.space == NormalSpace::Tangent;
    let mut meshes = Vec::with_capacity(low.levels.len());
    for (level, Level { mesh, .. }) in low.levels.iter().enumerate() {
        let mut mesh = mesh.clone();
        if mesh.atlas_uv.is_none() && options.method == Method::Correspondence && mesh.uv0.is_some() {
            let mut raw = mesh.into_raw();
            raw.atlas_uv = raw.uv0.take();
            mesh = Mesh::new(raw).map_err(|e| BakeError::Mesh { level, message: e.to_string() })?;
        }
        if mesh.atlas_uv.is_none() {
            return Err(BakeError::NoAtlas { level });
        }
        if mesh.normals.is_none() {
            return Err(BakeError::NoNormals { mesh: "low" });
        }
        meshes.push(match &mesh.tangents {
            _ if !needs_tangents => mesh,
            None => tangents::mikktspace(&mesh, UvSource::AtlasUv).map_err(|e| BakeError::Tangents(e.to_string()))?,
            Some(_) if check::tangents_follow_atlas(&mesh) => mesh,
            Some(_) => return Err(BakeError::StaleTangents { level }),
        });
    }
    Ok(meshes)
}

/// A level after the bake: the atlas is its only UV set, submeshes refer to the new materials.
fn redress(mesh: Mesh, groups: &Groups, drop_colors: bool) -> Result<Mesh, String> {
    let mut raw = mesh.into_raw();
    raw.uv0 = raw.atlas_uv.take();
    raw.uv1 = None;
    if let Some(uv) = &mut raw.uv0 {
        // Sheets lay side by side; from here on each is a texture of its own.
        let mut shift = vec![0.0; uv.len()];
        for (triangle, submesh) in raw.triangles.iter().zip(&raw.face_submesh) {
            let sheet = groups.materials[groups.of_submesh[submesh.index()]].sheet;
            triangle.iter().for_each(|v| shift[*v as usize] = sheet as f32);
        }
        uv.iter_mut().zip(shift).for_each(|(uv, shift)| uv.x -= shift);
    }
    if drop_colors {
        raw.colors = None;
    }
    let has_tangents = raw.tangents.is_some();
    for (submesh, group) in raw.submeshes.iter_mut().zip(&groups.of_submesh) {
        submesh.material = Some(MaterialId(*group as u32));
        submesh.attributes.uv0 = true;
        submesh.attributes.uv1 = false;
        submesh.attributes.tangents = has_tangents;
        submesh.attributes.normals = true;
        submesh.attributes.colors &= !drop_colors;
    }
    Mesh::new(raw).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests;
