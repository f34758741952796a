//! The materials after the bake: one for each (sheet, alpha mode, sidedness) in use.

use kiln_asset::{
    AlphaMode, ExtraImage, Filter, ImageFormat, ImageId, ImageInfo, MapRole, Material, MaterialId, MaterialSet, Mesh,
    Sampler, Submesh, SubmeshId, Texture, TextureId, TextureRef, UvLayout, Wrap,
};

use super::evaluate::{Planned, What};
use super::options::{BakeOptions, NormalSpace, Picture};

/// What a new material stands for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Group {
    /// The atlas sheet its submeshes lie on.
    pub(crate) sheet: u32,
    pub(crate) alpha_mode: AlphaMode,
    pub(crate) double_sided: bool,
    pub(crate) alpha_cutoff: f32,
}

/// Which new material each submesh of the low mesh gets.
pub(crate) struct Groups {
    /// Ascending by sheet, alpha mode, sidedness.
    pub(crate) materials: Vec<Group>,
    /// `[low submesh_count]` index into `materials`.
    pub(crate) of_submesh: Vec<usize>,
}

/// The material of a submesh; glTF's default where it has none.
pub(crate) fn material_of(set: &MaterialSet, id: Option<MaterialId>) -> Material {
    id.and_then(|id| set.materials.get(id.index())).cloned().unwrap_or_default()
}

impl Groups {
    /// `low` with `atlas_uv`, whose sheets lie side by side.
    pub(crate) fn new(low: &Mesh, set: &MaterialSet) -> Groups {
        let key = |(s, submesh): (usize, &Submesh)| {
            let material = material_of(set, submesh.material);
            let key = (sheet_of(low, s), material.alpha_mode, material.double_sided);
            (key, material.alpha_cutoff)
        };
        let used: Vec<_> = low.submeshes.iter().enumerate().map(key).collect();
        let mut keys: Vec<_> = used.iter().map(|u| u.0).collect();
        keys.sort_unstable();
        keys.dedup();
        let group = |key: &(u32, AlphaMode, bool)| {
            let mut of_key = used.iter().filter(|u| u.0 == *key).map(|u| u.1);
            let first = of_key.next().unwrap_or(0.5);
            // Masks with different cutoffs meet at 0.5; their alpha is rescaled in the bake.
            let alpha_cutoff = if first > 0.0 && first < 1.0 && of_key.all(|c| c == first) { first } else { 0.5 };
            Group { sheet: key.0, alpha_mode: key.1, double_sided: key.2, alpha_cutoff }
        };
        let materials = keys.iter().map(group).collect();
        let of_submesh = used.iter().map(|u| keys.binary_search(&u.0).unwrap_or(0)).collect();
        Groups { materials, of_submesh }
    }
}

/// The sheet that a submesh lies on; 0 where it has no face.
fn sheet_of(low: &Mesh, submesh: usize) -> u32 {
    let face = low.submesh_faces(SubmeshId(submesh as u32)).next();
    match (face, &low.atlas_uv) {
        (Some(face), Some(uv)) => UvLayout::sheet_of(low.triangles[face].map(|v| uv[v as usize])),
        _ => 0,
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

/// The new set: its images are `pictures` (`[sheets][planned]`), one texture each, clamped at the edge and mip-mapped. A factor whose
/// map was baked is neutral; another one stays where all materials of the group agree and is neutral where they do not.
pub(crate) fn new_set(
    low: &Mesh,
    old: &MaterialSet,
    groups: &Groups,
    planned: &[Planned<'_>],
    pictures: &[Picture],
    options: &BakeOptions,
) -> MaterialSet {
    let clamped = Sampler {
        wrap_u: Wrap::ClampToEdge,
        wrap_v: Wrap::ClampToEdge,
        mag: Filter::Linear,
        min: Filter::Linear,
        mip: Some(Filter::Linear),
    };
    let several = pictures.len() > planned.len();
    let mut set = MaterialSet::default();
    for (i, picture) in pictures.iter().enumerate() {
        let (sheet, map) = ((i / planned.len()) as u32, &planned[i % planned.len()]);
        let name = match map.what {
            What::Role(MapRole::Normal) if options.space == NormalSpace::Object => "normal (object space)",
            What::Role(role) => role.name(),
            What::Extra(extra) => extra.name(),
        };
        let name = if several { format!("{name} {}", 1001 + sheet) } else { name.to_owned() };
        let hash = picture.blob_hash();
        let format = match picture {
            Picture::Plain(_) => ImageFormat::Raster,
            Picture::Deep(_) => ImageFormat::Deep,
        };
        let image = ImageId(i as u32);
        set.images.push(ImageInfo { name, format, hash });
        set.textures.push(Texture { image, sampler: clamped });
        if let What::Extra(kind) = map.what {
            set.extras.push(ExtraImage { kind, sheet, image });
        }
    }
    let baked = |role: MapRole| planned.iter().any(|m| m.what == What::Role(role));
    for (g, group) in groups.materials.iter().enumerate() {
        let members = || {
            let of_group = low.submeshes.iter().zip(&groups.of_submesh).filter(move |(_, of)| **of == g);
            of_group.map(|(s, _)| material_of(old, s.material))
        };
        let mut material = Material {
            name: name_of(group, several),
            alpha_mode: group.alpha_mode,
            alpha_cutoff: group.alpha_cutoff,
            double_sided: group.double_sided,
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
        for (i, map) in planned.iter().enumerate() {
            let texture = TextureId(group.sheet * planned.len() as u32 + i as u32);
            if let What::Role(role) = map.what {
                *material.map_mut(role) = Some(TextureRef { texture, uv_set: 0 });
            }
        }
        set.materials.push(material);
    }
    set
}

fn name_of(group: &Group, several: bool) -> String {
    let alpha = match group.alpha_mode {
        AlphaMode::Opaque => "opaque",
        AlphaMode::Mask => "mask",
        AlphaMode::Blend => "blend",
    };
    let sides = if group.double_sided { " double-sided" } else { "" };
    let sheet = if several { format!(" {}", 1001 + group.sheet) } else { String::new() };
    format!("baked {alpha}{sides}{sheet}")
}
