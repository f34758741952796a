//! The part of glTF 2.0's JSON that an export needs, in the order in which it is written.
//!
//! Own structs instead of a map: their key order is fixed, whatever features other crates switch on in the JSON library.

use std::collections::BTreeMap;

use serde::Serialize;

#[derive(Serialize, Default)]
#[serde(rename_all = "camelCase")]
pub(super) struct Root {
    pub(super) asset: AssetInfo,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) extensions_used: Vec<&'static str>,
    pub(super) scene: u32,
    pub(super) scenes: Vec<Scene>,
    pub(super) nodes: Vec<Node>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) meshes: Vec<Mesh>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) materials: Vec<Material>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) textures: Vec<Texture>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) samplers: Vec<Sampler>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) images: Vec<Image>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) accessors: Vec<Accessor>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) buffer_views: Vec<BufferView>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) buffers: Vec<Buffer>,
}

#[derive(Serialize)]
pub(super) struct AssetInfo {
    pub(super) version: &'static str,
    pub(super) generator: String,
}

impl Default for AssetInfo {
    fn default() -> Self {
        AssetInfo { version: "2.0", generator: concat!("kiln ", env!("CARGO_PKG_VERSION")).into() }
    }
}

#[derive(Serialize)]
pub(super) struct Scene {
    pub(super) nodes: Vec<u32>,
}

#[derive(Serialize)]
pub(super) struct Node {
    pub(super) name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) mesh: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) extensions: Option<NodeExtensions>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) extras: Option<NodeExtras>,
}

#[derive(Serialize)]
pub(super) struct NodeExtensions {
    #[serde(rename = "MSFT_lod")]
    pub(super) lod: Lod,
}

#[derive(Serialize)]
pub(super) struct Lod {
    pub(super) ids: Vec<u32>,
}

#[derive(Serialize)]
pub(super) struct NodeExtras {
    #[serde(rename = "MSFT_screencoverage")]
    pub(super) coverage: Vec<f64>,
}

#[derive(Serialize)]
pub(super) struct Mesh {
    pub(super) name: String,
    pub(super) primitives: Vec<Primitive>,
}

#[derive(Serialize)]
pub(super) struct Primitive {
    pub(super) attributes: BTreeMap<&'static str, u32>,
    pub(super) indices: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) material: Option<u32>,
    pub(super) extras: PrimitiveExtras,
}

/// The submesh's name, which glTF primitives have no place for.
#[derive(Serialize)]
pub(super) struct PrimitiveExtras {
    pub(super) submesh: String,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Material {
    #[serde(skip_serializing_if = "String::is_empty")]
    pub(super) name: String,
    pub(super) pbr_metallic_roughness: Pbr,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) normal_texture: Option<TextureUse>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) occlusion_texture: Option<TextureUse>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) emissive_texture: Option<TextureUse>,
    pub(super) emissive_factor: [f32; 3],
    pub(super) alpha_mode: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) alpha_cutoff: Option<f32>,
    pub(super) double_sided: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) extensions: Option<MaterialExtensions>,
}

#[derive(Serialize)]
pub(super) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_emissive_strength")]
    pub(super) emissive_strength: EmissiveStrength,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct EmissiveStrength {
    pub(super) emissive_strength: f32,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Pbr {
    pub(super) base_color_factor: [f32; 4],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) base_color_texture: Option<TextureUse>,
    pub(super) metallic_factor: f32,
    pub(super) roughness_factor: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) metallic_roughness_texture: Option<TextureUse>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct TextureUse {
    pub(super) index: u32,
    pub(super) tex_coord: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) scale: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) strength: Option<f32>,
}

#[derive(Serialize)]
pub(super) struct Texture {
    pub(super) sampler: u32,
    pub(super) source: u32,
}

#[derive(Serialize, PartialEq)]
#[serde(rename_all = "camelCase")]
pub(super) struct Sampler {
    pub(super) mag_filter: u32,
    pub(super) min_filter: u32,
    pub(super) wrap_s: u32,
    pub(super) wrap_t: u32,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Image {
    #[serde(skip_serializing_if = "String::is_empty")]
    pub(super) name: String,
    pub(super) buffer_view: u32,
    pub(super) mime_type: &'static str,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub(super) buffer_view: u32,
    pub(super) component_type: u32,
    pub(super) count: usize,
    #[serde(rename = "type")]
    pub(super) kind: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) min: Option<[f32; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) max: Option<[f32; 3]>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub(super) buffer: u32,
    pub(super) byte_offset: usize,
    pub(super) byte_length: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) target: Option<u32>,
}

#[derive(Serialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub(super) byte_length: usize,
}
