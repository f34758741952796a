//! A level set to container bytes.
//!
//! **Problem.** Levels, materials and pictures come in; the bytes of one container go out, the same for the same values on
//! every machine and thread count. Geometry must not change in a bit.
//!
//! **Method.**
//! ```text
//! textures = every (image, how it is averaged) that a material uses, in that order; then the extra pictures (textures.rs)
//! decode each picture, build its mip chain, compress its mips if asked to
//! levels in the order that their layouts and codec ask for (order.rs), the layouts over it (layouts.rs)
//! submeshes, materials and levels -> records; arrays are lent as they lie in the mesh
//! kiln_format::write codes, places, hashes and checks
//! ```
//! Images that no material uses and that are no extra pictures are left out, and told.
//!
//! A level has the arrays its mesh has; which attributes a submesh really had in its source is kept beside its name.
//!
//! **Limits.** Unquantised vertices. The points that join submeshes are not stored: equal positions tell them.

use bytemuck::cast_slice;
use kiln_asset::{AlphaMode, AttributeSet, Filter, ImageId, LodSet, MapRole, MaterialSet, Mesh, Wrap};
use kiln_format::{
    Content, ErrorKind, LevelContent, MaterialRecord, Packing, Provenance, Semantic, SlotRecord, SubmeshContent,
    TextureContent, record::NONE,
};
use serde::{Deserialize, Serialize};

use crate::PackError;
use crate::inspect::{self, InspectLayout};
use crate::layouts::{self, Arrays, Continuous};
use crate::order::{self, Coarser, Packed};
use crate::picture::Picture;
use crate::textures::{self, Class, Want, class};

/// How levels are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// Each level its own indices; without it only the finest level is there beside the other layouts.
    Discrete,
    /// Vertices and triangles in collapse order.
    SlidingWindow,
    /// Octree in tree and leaf buffers.
    TreeLeaf,
    /// Octree with one texel a node.
    CompactTree,
    /// Cluster DAG.
    Clusters,
}

/// Whose vertices the levels use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Vertices {
    /// Each level its own.
    #[default]
    Own,
    /// The first of the finest one's; a sliding window asks for it whatever this says.
    Shared,
}

/// How payload is stored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compression {
    /// As it lies in memory.
    #[default]
    None,
    /// Geometry by the meshopt codecs, the rest by zstd.
    Meshopt,
    /// All by zstd.
    Zstd,
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
    /// Whose vertices the levels use.
    pub vertices: Vertices,
    /// How payload is stored.
    pub compression: Compression,
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
        PackOptions {
            layouts: vec![Layout::Discrete],
            mips: true,
            textures: Coding::Raw,
            vertices: Vertices::Own,
            compression: Compression::None,
        }
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
    /// Bytes of its vertices and indices, as they lie in memory; vertices that it shares count for the finest level alone.
    pub bytes: u64,
}

/// What was packed.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PackReport {
    /// Finest first.
    pub levels: Vec<PackedLevel>,
    /// The layouts beside the levels.
    pub layouts: Vec<InspectLayout>,
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
/// A picture that `images` cannot give, a reference out of range, levels of different submeshes, a layout that `continuous` has not or
/// that was made of other levels, or content that the format cannot hold (a factor that is no finite number).
pub fn pack(
    levels: &LodSet,
    materials: &MaterialSet,
    images: &Images<'_>,
    provenance: &Provenance,
    options: &PackOptions,
    continuous: &Continuous,
) -> Result<(Vec<u8>, PackReport), PackError> {
    let mut report = PackReport::default();
    let wanted = textures::wanted(materials)?;
    let pictures =
        wanted.iter().map(|want| textures::picture(want, materials, images)).collect::<Result<Vec<_>, _>>()?;
    let stored = wanted.iter().zip(&pictures);
    let textures: Vec<TextureContent<'_>> =
        stored.map(|(want, picture)| textures::content(want, picture, materials, options, &mut report)).collect();
    let submeshes = submeshes(levels, materials)?;
    let packed = ordered(levels, options, continuous)?;
    let finest = levels.levels.first().ok_or_else(no_levels)?;
    let arrays = Arrays::new(continuous, &finest.mesh, &packed, options)?;
    let content = Content {
        source_triangles: levels.source_triangles,
        layout: levels.layout.map(|layout| [layout.size, layout.padding, layout.chart_count, layout.sheets]),
        levels: level_contents(levels, &packed),
        submeshes,
        materials: material_records(materials, &wanted),
        textures,
        provenance: Some(provenance.clone()),
        private: Vec::new(),
        layouts: arrays.layouts(),
        packing: match options.compression {
            Compression::None => Packing::Raw,
            Compression::Meshopt => Packing::Meshopt,
            Compression::Zstd => Packing::Zstd,
        },
    };
    let bytes = kiln_format::write(&content)?;
    for content in &content.levels {
        let vertices = content.arrays.first().map_or(0, |(_, bytes)| bytes.len() / 12) as u32;
        let width = if vertices <= kiln_format::record::MAX_U16_VERTICES { 2 } else { 4 };
        let own = content.arrays.iter().filter(|_| !content.shares_vertices);
        let arrays: usize = own.map(|(_, bytes)| bytes.len()).sum();
        report.levels.push(PackedLevel {
            triangles: content.indices.len() as u32 / 3,
            vertices,
            error: content.error,
            bytes: (arrays + content.indices.len() * width) as u64,
        });
    }
    report.layouts = inspect::layouts(&kiln_format::Container::open_tables(&bytes)?);
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

/// The levels in the order that layouts and codec ask for; only the finest without layout `discrete`.
fn ordered<'a>(levels: &'a LodSet, options: &PackOptions, continuous: &Continuous) -> Result<Packed<'a>, PackError> {
    let wanted = |layout| options.layouts.contains(&layout);
    let count = if wanted(Layout::Discrete) { levels.levels.len() } else { 1 };
    let meshes: Vec<&Mesh> = levels.levels.iter().take(count).map(|level| &level.mesh).collect();
    match (&continuous.window, &continuous.tree) {
        (Some(window), _) if wanted(Layout::SlidingWindow) => layouts::by_window(&meshes, window),
        _ if options.vertices == Vertices::Shared && count > 1 => {
            let codec = options.compression == Compression::Meshopt;
            order::shared(&meshes, if codec { order::For::Codec } else { order::For::Cache })
        }
        // A tree of another mesh is refused where its arrays are made.
        (_, Some(layout))
            if (wanted(Layout::TreeLeaf) || wanted(Layout::CompactTree))
                && layout.tree.terminals().len() == meshes[0].vertex_count() =>
        {
            Ok(order::by_leaves(&meshes, layout.tree.vertex_order(meshes[0])))
        }
        _ if options.compression == Compression::Meshopt => Ok(order::for_codec(&meshes)),
        _ => Ok(order::as_they_are(&meshes)),
    }
}

fn level_contents<'a>(levels: &LodSet, packed: &'a Packed<'_>) -> Vec<LevelContent<'a>> {
    let errors = levels.levels.iter().map(|level| level.error);
    let finest = level_content(&packed.finest, 0.0);
    let mut contents = vec![finest];
    for level in &packed.coarser {
        contents.push(match level {
            Coarser::Own(mesh) => level_content(mesh, 0.0),
            Coarser::Shared { vertices, triangles, counts } => {
                let of = |(semantic, bytes): &(Semantic, &'a [u8])| {
                    (*semantic, &bytes[..vertices * semantic.format().size()])
                };
                LevelContent {
                    arrays: contents[0].arrays.iter().map(of).collect(),
                    indices: cast_slice(triangles),
                    index_counts: counts.iter().map(|count| 3 * count).collect(),
                    shares_vertices: true,
                    ..level_content(&packed.finest, 0.0)
                }
            }
        });
    }
    contents.iter_mut().zip(errors).for_each(|(content, error)| content.error = error);
    contents
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
    LevelContent {
        error,
        error_kind: ErrorKind::Sampled,
        arrays,
        indices: cast_slice(&mesh.triangles),
        index_counts: order::submesh_counts(mesh).iter().map(|count| 3 * count).collect(),
        shares_vertices: false,
    }
}

fn no_levels() -> PackError {
    PackError::Levels { level: 0, message: "there is no level to pack".into() }
}

/// The submeshes, the same at every level.
fn submeshes(levels: &LodSet, materials: &MaterialSet) -> Result<Vec<SubmeshContent>, PackError> {
    let Some(finest) = levels.levels.first() else {
        return Err(no_levels());
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
