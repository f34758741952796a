//! The materials after the bake: one for each (alpha mode, sidedness) in use, all on the same sheets.

use kiln_asset::{
    AlphaMode, Filter, ImageFormat, ImageId, ImageInfo, MapRole, Material, MaterialId, MaterialSet, Mesh, Raster,
    Sampler, Texture, TextureId, TextureRef, Wrap,
};

/// Which new material each submesh of the low mesh gets.
pub(crate) struct Groups {
    /// Alpha mode, double-sided, cutoff; ascending by the first two.
    pub(crate) materials: Vec<(AlphaMode, bool, f32)>,
    /// `[low submesh_count]` index into `materials`.
    pub(crate) of_submesh: Vec<usize>,
}

/// The material of a submesh; glTF's default where it has none.
pub(crate) fn material_of(set: &MaterialSet, id: Option<MaterialId>) -> Material {
    id.and_then(|id| set.materials.get(id.index())).cloned().unwrap_or_default()
}

impl Groups {
    pub(crate) fn new(low: &Mesh, set: &MaterialSet) -> Groups {
        let used: Vec<Material> = low.submeshes.iter().map(|s| material_of(set, s.material)).collect();
        let mut keys: Vec<(AlphaMode, bool)> = used.iter().map(|m| (m.alpha_mode, m.double_sided)).collect();
        keys.sort_unstable();
        keys.dedup();
        let cutoff = |key: (AlphaMode, bool)| {
            let mut of_key = used.iter().filter(|m| (m.alpha_mode, m.double_sided) == key).map(|m| m.alpha_cutoff);
            let first = of_key.next().unwrap_or(0.5);
            // Masks with different cutoffs meet at 0.5; their alpha is rescaled in the bake.
            if first > 0.0 && first < 1.0 && of_key.all(|c| c == first) { first } else { 0.5 }
        };
        let materials = keys.iter().map(|key| (key.0, key.1, cutoff(*key))).collect();
        let position = |m: &Material| keys.iter().position(|k| *k == (m.alpha_mode, m.double_sided)).unwrap_or(0);
        Groups { materials, of_submesh: used.iter().map(position).collect() }
    }
}

/// Whether a role says nothing in any of these materials, so that a map of it would be one neutral colour.
pub(crate) fn is_neutral(role: MapRole, used: &[Material]) -> bool {
    match role {
        MapRole::Occlusion => used.iter().all(|m| m.occlusion.is_none()),
        MapRole::Emissive => used.iter().all(|m| m.emissive_factor == [0.0; 3]),
        MapRole::BaseColor | MapRole::MetallicRoughness | MapRole::Normal => false,
    }
}

/// The value that all materials agree on.
fn common<T: PartialEq>(mut values: impl Iterator<Item = T>) -> Option<T> {
    let first = values.next()?;
    values.all(|v| v == first).then_some(first)
}

/// The new set: `maps` are its images, one texture each, clamped at the edge and mip-mapped. A factor whose map was baked is
/// neutral; another one stays where all materials of the group agree and is neutral where they do not.
pub(crate) fn new_set(
    low: &Mesh,
    old: &MaterialSet,
    groups: &Groups,
    maps: &[(MapRole, String, Raster)],
) -> MaterialSet {
    let clamped = Sampler {
        wrap_u: Wrap::ClampToEdge,
        wrap_v: Wrap::ClampToEdge,
        mag: Filter::Linear,
        min: Filter::Linear,
        mip: Some(Filter::Linear),
    };
    let mut set = MaterialSet::default();
    for (i, (_, name, raster)) in maps.iter().enumerate() {
        let hash = *blake3::hash(&raster.to_blob()).as_bytes();
        set.images.push(ImageInfo { name: name.clone(), format: ImageFormat::Raster, hash });
        set.textures.push(Texture { image: ImageId(i as u32), sampler: clamped });
    }
    let baked = |role: MapRole| maps.iter().any(|m| m.0 == role);
    for (g, (alpha_mode, double_sided, alpha_cutoff)) in groups.materials.iter().copied().enumerate() {
        let members = || {
            let of_group = low.submeshes.iter().zip(&groups.of_submesh).filter(move |(_, of)| **of == g);
            of_group.map(|(s, _)| material_of(old, s.material))
        };
        let mut material = Material {
            name: name_of(alpha_mode, double_sided),
            alpha_mode,
            alpha_cutoff,
            double_sided,
            ..Material::default()
        };
        if !baked(MapRole::BaseColor) {
            material.base_color_factor = common(members().map(|m| m.base_color_factor)).unwrap_or([1.0; 4]);
        }
        if !baked(MapRole::MetallicRoughness) {
            material.metallic_factor = common(members().map(|m| m.metallic_factor)).unwrap_or(1.0);
            material.roughness_factor = common(members().map(|m| m.roughness_factor)).unwrap_or(1.0);
        }
        material.emissive_factor = match baked(MapRole::Emissive) {
            true => [1.0; 3],
            // Emission that came through a map which is gone would light the whole part: off instead.
            false => common(members().map(|m| if m.emissive.is_some() { [0.0; 3] } else { m.emissive_factor }))
                .unwrap_or([0.0; 3]),
        };
        for (i, (role, _, _)) in maps.iter().enumerate() {
            *material.map_mut(*role) = Some(TextureRef { texture: TextureId(i as u32), uv_set: 0 });
        }
        set.materials.push(material);
    }
    set
}

fn name_of(alpha_mode: AlphaMode, double_sided: bool) -> String {
    let alpha = match alpha_mode {
        AlphaMode::Opaque => "opaque",
        AlphaMode::Mask => "mask",
        AlphaMode::Blend => "blend",
    };
    if double_sided { format!("baked {alpha} double-sided") } else { format!("baked {alpha}") }
}
