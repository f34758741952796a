//! The bake: what the high mesh looks like, written into the low mesh's sheet.
//!
//! Comes in: a high mesh with its materials and pictures, levels of a low mesh that share one atlas. Goes out: the levels
//! with that atlas as their only UVs, one material for each (alpha mode, sidedness) in use, and the maps. Positions,
//! triangles and normals of the levels do not change.
//!
//! ```text
//! sheet: each texel is owned by the low triangle of the finest level that covers its centre         (frame)
//! for each low triangle T, with the affine map A that sends its corners to their texels along its normal N:
//!     candidates = high triangles whose box meets T's prism and which face N's way                  (candidates)
//!     draw A(candidate) with depth |k|, k = signed distance from T's plane interpolated as it is; less wins;
//!     equal: the lower high face; T's own texels only                   (mirrored_vertex, on the CPU; gpu)
//! for each texel with a winner: meet its line with the winner's plane in double precision           (resolve)
//!     normal map: the normal there, bent by the source's normal map, in T's tangent frame            (maps)
//!     other maps: the source's textures averaged over the texel, times factors and vertex colour     (maps, texture)
//! fill what is left (dilation); write materials (materials)
//! ```
//!
//! Departures from the thesis. It mirrors vertices with k > 0 through the plane, which folds a triangle that straddles it, so
//! that its depth is no distance; depth = |k| per fragment is exact for all. Normals are not mirrored, nothing is clipped at
//! k = 0, facing is asked in space. Culling by prism and many low triangles in one draw are what it leaves as future work.
//! A graphics card only names winners; all values are computed on the CPU from ids, so backends share them.
//!
//! Limits: directions jump at low edges (per-face N), so a silhouette far from the low surface is cut where prisms part or
//! overlap; parts that float within reach in front of the surface lose to it; one sample a texel (textures are averaged over
//! the texel, geometry is not); a texel that no centre of a triangle covers is never baked, only dilated.
//!
//! Coarser levels use the finest level's maps with the normals and tangents that simplification carried along. Tangents are
//! those of the meshes given, if they belong to the atlas (`atlas` gives them); where a mesh has none, MikkTSpace computes
//! them for each level.
//!
//! Sources: C. González, thesis 2010, section 6.3 (mirrored vertices); M. Mikkelsen, Simulation of Wrinkled Surfaces
//! Revisited, MSc thesis, University of Copenhagen 2008 (tangent frames).

mod candidates;
pub mod check;
mod frame;
mod gpu;
mod maps;
mod materials;
mod mirrored_vertex;
mod options;
mod resolve;
mod texture;

use glam::{Vec2, Vec3};
use kiln_asset::{Level, LodSet, MapRole, Material, MaterialId, MaterialSet, Mesh, Raster};
use kiln_geom::colour::{linear_to_srgb, unorm8};
use rayon::prelude::*;

use crate::dilation::{self, TexelKind};
use crate::tangents::{self, UvSource};
use candidates::{Search, faces_along};
use frame::Sheet;
use maps::RoleSource;
use materials::{Groups, is_neutral, material_of};
use resolve::{Locator, TangentFrame};

pub use options::{Backend, BakeError, BakeOptions, BakeReport, HitRule, Images, NormalSpace};

/// Bakes `high` onto the finest level of `low`: the levels in their new UVs and materials, those materials, the pictures
/// that they refer to (`[images.len()]`, in order), and the report.
///
/// `high` and every level need normals, every level needs `atlas_uv`. `materials` holds the materials of both meshes'
/// submeshes, `images` decodes its pictures.
///
/// # Errors
/// See [`BakeError`]; nothing is made by halves.
pub fn bake(
    high: &Mesh,
    low: &LodSet,
    materials: &MaterialSet,
    images: &Images<'_>,
    options: &BakeOptions,
    backend: Backend<'_>,
) -> Result<(LodSet, MaterialSet, Vec<Raster>, BakeReport), BakeError> {
    let meshes = dressed(low, options)?;
    let finest = meshes.first().ok_or(BakeError::NoLevels)?;
    let cage = options.cage.unwrap_or_else(|| default_cage(high, low.levels[0].error));
    let hits = find_hits(high, finest, cage, options, backend)?;
    let used: Vec<Material> = finest.submeshes.iter().map(|s| material_of(materials, s.material)).collect();
    let (asked, neutral): (Vec<MapRole>, Vec<MapRole>) =
        MapRole::ALL.iter().filter(|r| options.maps.contains(r)).partition(|r| !is_neutral(**r, &used));
    let mut report = hits.report.clone();
    report.lost_maps = MapRole::ALL
        .iter()
        .copied()
        .filter(|r| !asked.contains(r) && used.iter().any(|m| m.map(*r).is_some()))
        .collect();
    report.short_padding = short_padding(low, options);
    report.neutral_maps = neutral;
    report.maps.clone_from(&asked);

    let groups = Groups::new(finest, materials);
    let (covered, inside) = (hits.covered(), hits.inside());
    let mut maps = Vec::new();
    for role in asked {
        // One role after another: only its pictures are in memory.
        let source = RoleSource::new(role, high, materials, images)?;
        let mut raster = hits.picture(role, &source, &groups, options)?;
        let object = role == MapRole::Normal && options.space == NormalSpace::Object;
        if role == MapRole::Normal && !object {
            let texels = raster.texels.iter().zip(&covered);
            report.behind = texels.filter(|(t, covered)| **covered && t[2] < 127).count() as u64;
        }
        let filled = dilation::dilate(&mut raster, &covered, &inside, options.dilation, kind_of(role));
        report.dilated = filled.dilated;
        let name = if object { "normal (object space)" } else { role.name() };
        maps.push((role, name.to_owned(), raster));
    }
    let set = materials::new_set(finest, materials, &groups, &maps);
    let drop_colors = options.maps.contains(&MapRole::BaseColor);
    let mut levels = Vec::with_capacity(meshes.len());
    for (level, mesh) in meshes.into_iter().enumerate() {
        let mesh = redress(mesh, &groups, drop_colors).map_err(|message| BakeError::Mesh { level, message })?;
        let Level { error, quadrics, .. } = &low.levels[level];
        levels.push(Level { mesh, error: *error, quadrics: quadrics.clone() });
    }
    let set_of = LodSet { levels, layout: low.layout, source_triangles: low.source_triangles };
    let pictures = maps.into_iter().map(|m| m.2).collect();
    Ok((set_of, set, pictures, report))
}

/// Which high face each texel of the sheet shows: the result of the hit pass, before anything is sampled.
pub struct HitBuffer<'a> {
    high: &'a Mesh,
    low: &'a Mesh,
    atlas_uv: &'a [Vec2],
    size: u32,
    /// `[size * size]` low face + 1 that owns the texel, 0 = none.
    pub low_faces: Vec<u32>,
    /// `[size * size]` high face + 1 that is nearest to the owner's plane, 0 = none within reach.
    pub high_faces: Vec<u32>,
    /// Everything known so far.
    pub report: BakeReport,
}

/// The hit pass alone. `low` needs `atlas_uv`; `cage` in object units.
///
/// # Errors
/// Options out of range, missing attributes, a failing device.
pub fn find_hits<'a>(
    high: &'a Mesh,
    low: &'a Mesh,
    cage: f32,
    options: &BakeOptions,
    backend: Backend<'_>,
) -> Result<HitBuffer<'a>, BakeError> {
    let size = options.size;
    let out_of_range =
        |name, found: String, expected: &str| BakeError::Option { name, found, expected: expected.into() };
    if size == 0 || size > BakeOptions::SIZE_MAX {
        return Err(out_of_range("size", size.to_string(), &format!("1 to {} texels", BakeOptions::SIZE_MAX)));
    }
    // The negation catches NaN.
    if !(cage > 0.0 && cage.is_finite()) {
        return Err(out_of_range("cage", cage.to_string(), "a positive length"));
    }
    let atlas_uv = low.atlas_uv.as_deref().ok_or(BakeError::NoAtlas { level: 0 })?;
    if low.normals.is_none() {
        return Err(BakeError::NoNormals { mesh: "low" });
    }
    if high.normals.is_none() {
        return Err(BakeError::NoNormals { mesh: "high" });
    }
    let sheet = Sheet::new(low, atlas_uv, size);
    let search = Search::new(high, low, cage, options.back_faces, options.prefer_same_submesh);
    let (high_faces, pairs) = match backend {
        Backend::Cpu => mirrored_vertex::hits(&sheet, &search),
        Backend::Gpu(gpu) => gpu::hits(gpu, &sheet, &search)?,
    };
    let count = |texels: &[u32]| texels.iter().filter(|t| **t != 0).count() as u64;
    let (owned, covered) = (count(&sheet.owners), count(&high_faces));
    let report = BakeReport {
        backend: match backend {
            Backend::Cpu => "cpu".into(),
            Backend::Gpu(gpu) => gpu.class().to_string(),
        },
        size,
        cage,
        owned,
        covered,
        missed: owned - covered.min(owned),
        overlapping: sheet.overlaps,
        sliver_faces: sheet.faces.iter().filter(|f| f.frame.is_none()).count() as u64,
        pairs,
        ..BakeReport::default()
    };
    Ok(HitBuffer { high, low, atlas_uv, size, low_faces: sheet.owners, high_faces, report })
}

impl HitBuffer<'_> {
    /// `[size * size]`: the texel has a hit.
    pub fn covered(&self) -> Vec<bool> {
        self.high_faces.iter().map(|h| *h != 0).collect()
    }

    /// `[size * size]`: the texel's centre lies in a low triangle.
    pub fn inside(&self) -> Vec<bool> {
        self.low_faces.iter().map(|l| *l != 0).collect()
    }

    /// `[size * size]` normals of the high mesh at the hits, object space, unit length, without its normal maps; zero where
    /// nothing is hit. For measuring: full precision.
    pub fn object_normals(&self) -> Vec<Vec3> {
        let Some(normals) = self.high.normals.as_deref() else { return Vec::new() };
        let mut out = vec![Vec3::ZERO; self.high_faces.len()];
        self.each_texel(&mut out, |hit, slot| {
            let corners = self.high.triangles[hit.high].map(|v| normals[v as usize]);
            let turn = if self.faces_away(hit) { -1.0 } else { 1.0 };
            *slot = turn * resolve::mix3(corners, hit.high_bary).normalize_or_zero();
        });
        out
    }

    /// `[size * size]` hit points, object space; `None` where nothing is hit.
    pub fn positions(&self) -> Vec<Option<Vec3>> {
        let mut out = vec![None; self.high_faces.len()];
        self.each_texel(&mut out, |hit, slot| {
            let corners = self.high.face_positions(kiln_asset::FaceId(hit.high as u32));
            *slot = Some(resolve::mix3(corners, hit.high_bary));
        });
        out
    }

    fn faces_away(&self, hit: &resolve::HitPoint) -> bool {
        let [a, b, c] = self.low.face_positions(kiln_asset::FaceId(hit.low as u32));
        !faces_along(self.high.face_positions(kiln_asset::FaceId(hit.high as u32)), (b - a).cross(c - a))
    }

    /// Calls `visit` for every texel with a hit, rows in parallel.
    fn each_texel<T: Send>(&self, out: &mut [T], visit: impl Fn(&resolve::HitPoint, &mut T) + Sync) {
        let width = self.size as usize;
        let locator = || Locator::new(self.low, self.high, self.atlas_uv, self.size);
        out.par_chunks_mut(width).enumerate().for_each_init(locator, |locator, (y, row)| {
            for (x, slot) in row.iter_mut().enumerate() {
                let (low, high) = (self.low_faces[y * width + x], self.high_faces[y * width + x]);
                if low == 0 || high == 0 {
                    continue;
                }
                if let Some(hit) = locator.at(x as u32, y as u32, low as usize - 1, high as usize - 1) {
                    visit(&hit, slot);
                }
            }
        });
    }

    /// One baked map; texels without a hit are zero.
    fn picture(
        &self,
        role: MapRole,
        source: &RoleSource<'_>,
        groups: &Groups,
        options: &BakeOptions,
    ) -> Result<Raster, BakeError> {
        let mut raster = Raster::filled(self.size, self.size, [0; 4]);
        if role != MapRole::Normal {
            self.each_texel(&mut raster.texels, |hit, texel| {
                let submesh = self.low.face_submesh[hit.low].index();
                *texel = encode(source.value(hit, groups.materials[groups.of_submesh[submesh]]), role);
            });
            return Ok(raster);
        }
        let high_normals = self.high.normals.as_deref().ok_or(BakeError::NoNormals { mesh: "high" })?;
        let low_normals = self.low.normals.as_deref().ok_or(BakeError::NoNormals { mesh: "low" })?;
        let object = options.space == NormalSpace::Object;
        let low_tangents = match self.low.tangents.as_deref() {
            None if !object => return Err(BakeError::StaleTangents { level: 0 }),
            tangents => tangents.unwrap_or_default(),
        };
        self.each_texel(&mut raster.texels, |hit, texel| {
            let normal = source.normal(hit, high_normals, self.faces_away(hit));
            let written = if object {
                normal
            } else {
                let corners = self.low.triangles[hit.low].map(|v| v as usize);
                TangentFrame::new(corners.map(|v| low_normals[v]), corners.map(|v| low_tangents[v]), hit.low_bary)
                    .encode(normal)
            };
            let [r, g, b] = written.to_array().map(|c| unorm8(0.5 * c + 0.5));
            *texel = [r, g, b, 255];
        });
        Ok(raster)
    }
}

fn encode([r, g, b, a]: [f32; 4], role: MapRole) -> [u8; 4] {
    let [r, g, b] = [r, g, b].map(|c| if role.is_srgb() { linear_to_srgb(c) } else { unorm8(c) });
    [r, g, b, unorm8(a)]
}

fn kind_of(role: MapRole) -> TexelKind {
    match role {
        MapRole::Normal => TexelKind::Normal,
        _ if role.is_srgb() => TexelKind::Srgb,
        _ => TexelKind::Linear,
    }
}

fn default_cage(high: &Mesh, error: f32) -> f32 {
    // A mesh without extent has nothing to hit, but a cage must be positive.
    (BakeOptions::CAGE_SHARE * high.diagonal()).max(2.0 * error).max(f32::MIN_POSITIVE)
}

/// The layout's padding at the maps' size, texels, where it is less than the dilation.
fn short_padding(low: &LodSet, options: &BakeOptions) -> Option<u32> {
    let layout = low.layout?;
    let padding = (layout.padding as u64 * options.size as u64 / layout.size.max(1) as u64) as u32;
    (padding < options.dilation).then_some(padding)
}

/// The levels' meshes with tangents that belong to `atlas_uv`, where the bake needs any.
fn dressed(low: &LodSet, options: &BakeOptions) -> Result<Vec<Mesh>, BakeError> {
    let needs_tangents = options.maps.contains(&MapRole::Normal) && options.space == NormalSpace::Tangent;
    let mut meshes = Vec::with_capacity(low.levels.len());
    for (level, Level { mesh, .. }) in low.levels.iter().enumerate() {
        if mesh.atlas_uv.is_none() {
            return Err(BakeError::NoAtlas { level });
        }
        if mesh.normals.is_none() {
            return Err(BakeError::NoNormals { mesh: "low" });
        }
        meshes.push(match &mesh.tangents {
            _ if !needs_tangents => mesh.clone(),
            None => tangents::mikktspace(mesh, UvSource::AtlasUv).map_err(|e| BakeError::Tangents(e.to_string()))?,
            Some(_) if check::tangents_follow_atlas(mesh) => mesh.clone(),
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
