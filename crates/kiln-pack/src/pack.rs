//! A level set to container bytes.
//!
//! **Problem.** Levels, materials and pictures come in; the bytes of one container go out, the same for the same values on
//! every machine and thread count. Geometry must not change in a bit.
//!
//! **Method.**
//! ```text
//! textures = every (image, how it is averaged) that a material uses, in that order; then the extra pictures (textures.rs)
//! decode each picture, build its mip chain, compress its mips if asked to
//! submeshes, materials and levels -> records; arrays are lent as they lie in the mesh
//! kiln_format::write places, hashes and checks
//! ```
//! Images that no material uses and that are no extra pictures are left out, and told.
//!
//! A level has the arrays its mesh has; which attributes a submesh really had in its source is kept beside its name.
//! Vertices and triangles stand in the mesh's order.
//!
//! **Limits.** Layout `discrete` only. Unquantised vertices. The points that join submeshes are not
//! stored: equal positions tell them.

use bytemuck::cast_slice;
use kiln_asset::{AlphaMode, AttributeSet, Filter, ImageId, LodSet, MapRole, MaterialSet, Mesh, Wrap};
use kiln_format::{
    Content, ErrorKind, LevelContent, MaterialRecord, Provenance, Semantic, SlotRecord, SubmeshContent, TextureContent,
    record::NONE,
};
use serde::{Deserialize, Serialize};

use crate::PackError;
use crate::picture::Picture;
use crate::textures::{self, Class, Want, class};

/// How levels are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// Each level its own arrays.
    Discrete,
}

/// Options of [`pack()`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", default)]
pub struct PackOptions {
    /// Layouts to write.
    pub layouts: Vec<Layout>,
    /// Whether textures get mips; off saves a quarter of their bytes and leaves minification to the engine.
    pub mips: bool,
    /// How texels of materials' 8-bit textures are stored.
    pub textures: Coding,
}

/// How texels are stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Coding {
    /// As they are: 4 bytes a texel.
    #[default]
    Raw,
    /// In blocks that GPUs read, 1 byte a texel: BC5 for tangent-space normals (z is the reader's to make), else BC7. Pictures of
    /// more than 8 bits and extras stay as they are; a normal map with normals that look inwards is BC7.
    Bc,
}

impl Default for PackOptions {
    fn default() -> Self {
        PackOptions { layouts: vec![Layout::Discrete], mips: true, textures: Coding::Raw }
    }
}

/// One level of a [`PackReport`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PackedLevel {
    /// Triangles.
    pub triangles: u32,
    /// Vertices.
    pub vertices: u32,
    /// Distance to the source surface, object units.
    pub error: f32,
    /// Bytes of its vertices and indices.
    pub bytes: u64,
}

/// What was packed.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PackReport {
    /// Finest first.
    pub levels: Vec<PackedLevel>,
    /// Textures stored.
    pub textures: usize,
    /// Bytes of all mips.
    pub texture_bytes: u64,
    /// Bytes of the container.
    pub bytes: u64,
    /// What was left out, in words.
    pub notes: Vec<String>,
}

/// Gives the decoded picture of an image, or says why it cannot.
pub type Images<'a> = dyn Fn(ImageId) -> Result<Picture, String> + 'a;

/// The bytes of a container with all levels, materials and the textures they use.
///
/// # Errors
/// A picture that `images` cannot give, a reference out of range, levels of different submeshes, or content that the format
/// cannot hold (a factor that is no finite number).
pub fn pack(
    levels: &LodSet,
    materials: &MaterialSet,
    images: &Images<'_>,
    provenance: &Provenance,
    options: &PackOptions,
) -> Result<(Vec<u8>, PackReport), PackError> {
    if options.layouts != [Layout::Discrete] {
        return Err(PackError::Unsupported("layouts other than [\"discrete\"]".into()));
    }
    let mut report = PackReport::default();
    let wanted = textures::wanted(materials)?;
    let pictures =
        wanted.iter().map(|want| textures::picture(want, materials, images)).collect::<Result<Vec<_>, _>>()?;
    let stored = wanted.iter().zip(&pictures);
    let textures: Vec<TextureContent<'_>> =
        stored.map(|(want, picture)| textures::content(want, picture, materials, options, &mut report)).collect();
    let content = Content {
        source_triangles: levels.source_triangles,
        layout: levels.layout.map(|layout| [layout.size, layout.padding, layout.chart_count, layout.sheets]),
        levels: levels.levels.iter().map(|level| level_content(&level.mesh, level.error)).collect(),
        submeshes: submeshes(levels, materials)?,
        materials: material_records(materials, &wanted),
        textures,
        provenance: Some(provenance.clone()),
        ..Content::default()
    };
    let bytes = kiln_format::write(&content)?;
    for (level, content) in levels.levels.iter().zip(&content.levels) {
        let vertices = level.mesh.vertex_count() as u32;
        let width = if vertices <= kiln_format::record::MAX_U16_VERTICES { 2 } else { 4 };
        let arrays: usize = content.arrays.iter().map(|(_, bytes)| bytes.len()).sum();
        report.levels.push(PackedLevel {
            triangles: level.mesh.face_count() as u32,
            vertices,
            error: level.error,
            bytes: (arrays + content.indices.len() * width) as u64,
        });
    }
    report.textures = content.textures.len();
    report.texture_bytes = content.textures.iter().flat_map(|t| &t.mips).map(|mip| mip.len() as u64).sum();
    report.bytes = bytes.len() as u64;
    let used: Vec<ImageId> = wanted.iter().map(|want| want.image).collect();
    let unused = (0..materials.images.len()).filter(|i| !used.contains(&ImageId(*i as u32))).count();
    if unused > 0 {
        report.notes.push(format!("{unused} images that no material uses were left out"));
    }
    if levels.levels.iter().any(|level| level.mesh.atlas_uv.is_some()) {
        report.notes.push("atlas UVs were left out: nothing was baked into them".into());
    }
    Ok((bytes, report))
}

/// The arrays of a mesh as the format names them, positions first.
fn level_content(mesh: &Mesh, error: f32) -> LevelContent<'_> {
    let mut arrays: Vec<(Semantic, &[u8])> = vec![(Semantic::Positions, cast_slice(&mesh.positions))];
    let mut optional = |semantic, bytes: Option<_>| arrays.extend(bytes.map(|bytes| (semantic, bytes)));
    optional(Semantic::Normals, mesh.normals.as_deref().map(cast_slice));
    optional(Semantic::Tangents, mesh.tangents.as_deref().map(cast_slice));
    optional(Semantic::Uv0, mesh.uv0.as_deref().map(cast_slice));
    optional(Semantic::Uv1, mesh.uv1.as_deref().map(cast_slice));
    optional(Semantic::Colors, mesh.colors.as_deref().map(cast_slice));
    optional(Semantic::Joints, mesh.joints.as_deref().map(cast_slice));
    optional(Semantic::Weights, mesh.weights.as_deref().map(cast_slice));
    let count = |submesh: usize| mesh.submesh_faces(kiln_asset::SubmeshId(submesh as u32)).len() as u32 * 3;
    LevelContent {
        error,
        error_kind: ErrorKind::Sampled,
        arrays,
        indices: cast_slice(&mesh.triangles),
        index_counts: (0..mesh.submeshes.len()).map(count).collect(),
        shares_vertices: false,
    }
}

/// The submeshes, the same at every level.
fn submeshes(levels: &LodSet, materials: &MaterialSet) -> Result<Vec<SubmeshContent>, PackError> {
    let Some(finest) = levels.levels.first() else {
        return Err(PackError::Levels { level: 0, message: "there is no level to pack".into() });
    };
    for (level, other) in levels.levels.iter().enumerate() {
        if other.mesh.submeshes != finest.mesh.submeshes {
            let message = "its submeshes are not those of level 0".into();
            return Err(PackError::Levels { level, message });
        }
    }
    let mut out = Vec::new();
    for (number, submesh) in finest.mesh.submeshes.iter().enumerate() {
        if let Some(material) = submesh.material
            && material.index() >= materials.materials.len()
        {
            return Err(PackError::Reference {
                path: format!("submeshes[{number}].material"),
                expected: materials.materials.len(),
                found: material.0,
            });
        }
        out.push(SubmeshContent {
            name: submesh.name.clone(),
            material: submesh.material.map(|material| material.0),
            attributes: attribute_bits(submesh.attributes),
            source_triangles: submesh.source_triangles,
        });
    }
    Ok(out)
}

/// Bit `n` of the format's set is semantic number `n`.
const ATTRIBUTES: [Semantic; 7] = [
    Semantic::Normals,
    Semantic::Tangents,
    Semantic::Uv0,
    Semantic::Uv1,
    Semantic::Colors,
    Semantic::Joints,
    Semantic::Weights,
];

fn attribute_bits(set: AttributeSet) -> u32 {
    let flags = [set.normals, set.tangents, set.uv0, set.uv1, set.colors, set.skin, set.skin];
    // Positions are always there.
    ATTRIBUTES.iter().zip(flags).fold(2, |bits, (semantic, flag)| bits | (flag as u32) << semantic.number())
}

/// The inverse of `attribute_bits`.
pub(crate) fn attribute_set(bits: u32) -> AttributeSet {
    let has = |semantic: Semantic| bits >> semantic.number() & 1 == 1;
    AttributeSet {
        normals: has(Semantic::Normals),
        tangents: has(Semantic::Tangents),
        uv0: has(Semantic::Uv0),
        uv1: has(Semantic::Uv1),
        colors: has(Semantic::Colors),
        skin: has(Semantic::Joints),
        // Levels are cut; it has done its work.
        importance: false,
    }
}

fn material_records(materials: &MaterialSet, wanted: &[Want]) -> Vec<(String, MaterialRecord)> {
    let texture_of = |image: ImageId, class: Class| {
        // Extras stand behind all textures of materials.
        let of_materials = &wanted[..wanted.partition_point(|want| want.extra.is_none())];
        let number = of_materials.binary_search_by_key(&(image, class), |want| (want.image, want.class));
        number.map_or(NONE, |number| number as u32)
    };
    let mut out = Vec::new();
    for material in &materials.materials {
        let slots = MapRole::ALL.map(|role| match material.map(role) {
            None => SlotRecord { texture: NONE, ..bytemuck::Zeroable::zeroed() },
            Some(used) => {
                let texture = &materials.textures[used.texture.index()];
                let sampler = texture.sampler;
                SlotRecord {
                    texture: texture_of(texture.image, class(role)),
                    uv_set: used.uv_set,
                    wrap_u: wrap_number(sampler.wrap_u),
                    wrap_v: wrap_number(sampler.wrap_v),
                    mag: (sampler.mag == Filter::Linear) as u8,
                    min: (sampler.min == Filter::Linear) as u8,
                    mip: sampler.mip.map_or(0, |mip| 1 + (mip == Filter::Linear) as u8),
                    uv_scale: [1.0; 2],
                    ..bytemuck::Zeroable::zeroed()
                }
            }
        });
        let record = MaterialRecord {
            name: 0,
            alpha_mode: match material.alpha_mode {
                AlphaMode::Opaque => 0,
                AlphaMode::Mask => 1,
                AlphaMode::Blend => 2,
            },
            alpha_cutoff: material.alpha_cutoff,
            flags: material.double_sided as u32,
            base_color_factor: material.base_color_factor,
            emissive_factor: material.emissive_factor,
            metallic_factor: material.metallic_factor,
            roughness_factor: material.roughness_factor,
            normal_scale: material.normal_scale,
            occlusion_strength: material.occlusion_strength,
            reserved: 0,
            slots,
        };
        out.push((material.name.clone(), record));
    }
    out
}

fn wrap_number(wrap: Wrap) -> u8 {
    match wrap {
        Wrap::Repeat => 0,
        Wrap::MirroredRepeat => 1,
        Wrap::ClampToEdge => 2,
    }
}
