//! What each map holds at a hit point: the high mesh's normal, and its materials' textures times their factors.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{Vec2, Vec3, Vec4};
use kiln_asset::{AlphaMode, ImageId, MapRole, Material, MaterialSet, Mesh, Sampler};

use super::materials::{Group, material_of};
use super::resolve::{HitPoint, TangentFrame, mix3, mix4};
use super::texture::Pyramid;
use super::{BakeError, Images};
use crate::tangents::{self, UvSource};

/// A material's texture in one role, ready to be read on the high mesh.
struct Source<'a> {
    pyramid: Arc<Pyramid>,
    sampler: Sampler,
    /// `[high vertex_count]`.
    uv: &'a [Vec2],
    /// Which UV set that is.
    uv_set: u32,
}

impl Source<'_> {
    fn sample(&self, high: &Mesh, hit: &HitPoint) -> [f32; 4] {
        let (uv, du, dv) = hit.uv(high, self.uv);
        self.pyramid.sample(uv, du, dv, &self.sampler)
    }
}

/// The high mesh's side of one map.
pub(crate) struct RoleSource<'a> {
    role: MapRole,
    high: &'a Mesh,
    /// `[high submesh_count]`.
    materials: Vec<Material>,
    /// `[high submesh_count]`, `None` where there is no texture (or no UVs to read it with).
    sources: Vec<Option<Source<'a>>>,
    /// `[high face_count] x 3` tangents for faces under a normal map; empty where no map needs them.
    tangents: Vec<[Vec4; 3]>,
}

impl<'a> RoleSource<'a> {
    /// Decodes what `role` needs, nothing else, each picture once.
    pub(crate) fn new(
        role: MapRole,
        high: &'a Mesh,
        set: &MaterialSet,
        images: &Images<'_>,
    ) -> Result<RoleSource<'a>, BakeError> {
        let materials: Vec<Material> = high.submeshes.iter().map(|s| material_of(set, s.material)).collect();
        let mut pyramids: BTreeMap<u32, Arc<Pyramid>> = BTreeMap::new();
        let mut sources = Vec::with_capacity(materials.len());
        for (material, submesh) in materials.iter().zip(&high.submeshes) {
            let reference = material.map(role).and_then(|r| set.textures.get(r.texture.index()).map(|t| (r, t)));
            let Some((reference, texture)) = reference else {
                sources.push(None);
                continue;
            };
            let (uv, real) = match reference.uv_set {
                0 => (high.uv0.as_deref(), submesh.attributes.uv0),
                _ => (high.uv1.as_deref(), submesh.attributes.uv1),
            };
            let Some(uv) = uv.filter(|_| real) else {
                sources.push(None);
                continue;
            };
            let pyramid = match pyramids.get(&texture.image.0) {
                Some(pyramid) => Arc::clone(pyramid),
                None => {
                    let picture = picture(images, texture.image)?;
                    let pyramid = Arc::new(Pyramid::new(picture, role.is_srgb()));
                    pyramids.insert(texture.image.0, Arc::clone(&pyramid));
                    pyramid
                }
            };
            sources.push(Some(Source { pyramid, sampler: texture.sampler, uv, uv_set: reference.uv_set }));
        }
        let tangents = if role == MapRole::Normal { face_tangents(high, &sources)? } else { Vec::new() };
        Ok(RoleSource { role, high, materials, sources, tangents })
    }

    /// Whether any submesh has a picture in this role.
    pub(crate) fn reads_pictures(&self) -> bool {
        self.sources.iter().any(Option::is_some)
    }

    /// The source's alpha at a hit; for [`MapRole::BaseColor`].
    pub(crate) fn opacity(&self, hit: &HitPoint) -> f32 {
        let submesh = self.high.face_submesh[hit.high].index();
        let texel = self.sources[submesh].as_ref().map_or(1.0, |s| s.sample(self.high, hit)[3]);
        texel * self.materials[submesh].base_color_factor[3] * self.color(hit, submesh)[3]
    }

    /// The high normal at a hit, object space, unit length, its normal map's detail included; turned for a hit from behind.
    #[inline]
    pub(crate) fn normal(&self, hit: &HitPoint, normals: &[Vec3]) -> Vec3 {
        let corners = self.high.triangles[hit.high].map(|v| normals[v as usize]);
        let submesh = self.high.face_submesh[hit.high].index();
        let smooth = mix3(corners, hit.high_bary);
        let detailed = self.sources[submesh].as_ref().and_then(|source| {
            let tangents = self.tangents.get(hit.high)?;
            let [x, y, z, _] = source.sample(self.high, hit).map(|c| 2.0 * c - 1.0);
            let scale = self.materials[submesh].normal_scale;
            let frame = TangentFrame::new(corners, *tangents, hit.high_bary);
            frame.decode(Vec3::new(x * scale, y * scale, z)).try_normalize()
        });
        let normal = detailed.unwrap_or_else(|| smooth.normalize_or_zero());
        if hit.turned { -normal } else { normal }
    }

    /// The role's value at a hit, linear RGBA; not for [`MapRole::Normal`]. `group` is the low submesh's new material.
    pub(crate) fn value(&self, hit: &HitPoint, group: Group) -> [f32; 4] {
        let submesh = self.high.face_submesh[hit.high].index();
        let material = &self.materials[submesh];
        let texel = self.sources[submesh].as_ref().map_or([1.0; 4], |s| s.sample(self.high, hit));
        match self.role {
            MapRole::BaseColor => {
                let color = self.color(hit, submesh);
                let [r, g, b, a]: [f32; 4] =
                    std::array::from_fn(|c| texel[c] * material.base_color_factor[c] * color[c]);
                [r, g, b, alpha(a, material, group)]
            }
            MapRole::MetallicRoughness => {
                [1.0, texel[1] * material.roughness_factor, texel[2] * material.metallic_factor, 1.0]
            }
            MapRole::Occlusion => {
                let open = 1.0 + material.occlusion_strength * (texel[0] - 1.0);
                [open, open, open, 1.0]
            }
            MapRole::Emissive => {
                let [r, g, b]: [f32; 3] = std::array::from_fn(|c| texel[c] * material.emissive_factor[c]);
                [r, g, b, 1.0]
            }
            MapRole::Normal => [0.0, 0.0, 1.0, 1.0],
        }
    }

    fn color(&self, hit: &HitPoint, submesh: usize) -> Vec4 {
        match &self.high.colors {
            Some(colors) if self.high.submeshes[submesh].attributes.colors => {
                mix4(self.high.triangles[hit.high].map(|v| colors[v as usize]), hit.high_bary)
            }
            _ => Vec4::ONE,
        }
    }
}

/// Alpha for the low side's material: 1 where either side is opaque, and moved so that the high material's cutoff falls on
/// the low one's.
fn alpha(alpha: f32, high: &Material, Group { alpha_mode: mode, alpha_cutoff: cutoff, .. }: Group) -> f32 {
    if mode == AlphaMode::Opaque || high.alpha_mode == AlphaMode::Opaque {
        return 1.0;
    }
    if high.alpha_mode == AlphaMode::Mask && mode == AlphaMode::Mask && high.alpha_cutoff != cutoff {
        return if high.alpha_cutoff <= 0.0 { 1.0 } else { (alpha * cutoff / high.alpha_cutoff).min(1.0) };
    }
    alpha
}

fn picture(images: &Images<'_>, image: ImageId) -> Result<Arc<kiln_asset::Raster>, BakeError> {
    let picture = images(image).map_err(|message| BakeError::Image { image, message })?;
    let texels = picture.width as u64 * picture.height as u64;
    if texels == 0 || texels != picture.texels.len() as u64 {
        let message = format!("{} texels for {} x {}", picture.texels.len(), picture.width, picture.height);
        return Err(BakeError::Image { image, message });
    }
    Ok(picture)
}

/// `high` with tangents along its UV set 0 or 1.
fn tangents_of_set(high: &Mesh, set: usize) -> Result<Mesh, String> {
    let along = |mesh: &Mesh| tangents::mikktspace(mesh, UvSource::Uv0).map_err(|e| e.to_string());
    if set == 0 {
        return along(high);
    }
    let mut raw = high.clone().into_raw();
    raw.uv0 = raw.uv1.take();
    along(&Mesh::new(raw).map_err(|e| e.to_string())?)
}

/// Tangents for the faces that a normal map lies on: the source's where it has them, MikkTSpace of the map's UV set where
/// not. Empty if there is no normal map.
fn face_tangents(high: &Mesh, sources: &[Option<Source<'_>>]) -> Result<Vec<[Vec4; 3]>, BakeError> {
    if sources.iter().all(Option::is_none) {
        return Ok(Vec::new());
    }
    let own = |submesh: usize| high.tangents.is_some() && high.submeshes[submesh].attributes.tangents;
    let mut computed: [Option<Mesh>; 2] = [None, None];
    for (submesh, source) in sources.iter().enumerate() {
        let Some(source) = source.as_ref().filter(|_| !own(submesh)) else { continue };
        let set = source.uv_set.min(1) as usize;
        if computed[set].is_none() {
            computed[set] = Some(tangents_of_set(high, set).map_err(BakeError::Tangents)?);
        }
    }
    let neutral = [Vec4::new(0.0, 0.0, 0.0, 1.0); 3];
    let of_face = |(face, submesh): (usize, &kiln_asset::SubmeshId)| {
        let Some(source) = &sources[submesh.index()] else { return neutral };
        let mesh = if own(submesh.index()) { Some(high) } else { computed[source.uv_set.min(1) as usize].as_ref() };
        // Splitting wedges keeps faces and their corners in order.
        let read = |mesh: &Mesh| {
            let tangents = mesh.tangents.as_ref()?;
            Some(mesh.triangles.get(face)?.map(|v| tangents[v as usize]))
        };
        mesh.and_then(read).unwrap_or(neutral)
    };
    Ok(high.face_submesh.iter().enumerate().map(of_face).collect())
}
