//! Planted models with known answers, malformed and hostile ones, and the corpus.

mod corpus;
mod extensions;
mod hostile;
mod obj;
mod pictures;
mod ply;

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Instant;

use glam::{Vec2, Vec3, Vec4};
use serde_json::{Value, json};

use super::*;
use crate::material::{AlphaMode, Filter, ImageFormat, Wrap};

/// Files in memory.
#[derive(Default)]
struct Memory(BTreeMap<String, Vec<u8>>);

impl Files for Memory {
    fn read(&self, relative: &str) -> io::Result<Vec<u8>> {
        self.0.get(relative).cloned().ok_or_else(|| io::ErrorKind::NotFound.into())
    }
}

type Outcome = Result<(Asset, ImportReport), ImportError>;

fn import_bytes(main: &str, bytes: Vec<u8>) -> Outcome {
    import(&Memory(BTreeMap::from([(main.to_owned(), bytes)])), main, &ImportLimits::default())
}

fn import_json(document: &Value) -> Outcome {
    import_bytes("model.gltf", document.to_string().into_bytes())
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Encodes bytes as the data URI of a buffer.
fn data_uri(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = "data:application/octet-stream;base64,".to_owned();
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().enumerate().fold(0u32, |w, (i, b)| w | (*b as u32) << (16 - 8 * i));
        for i in 0..4 {
            let digit = DIGITS[(word >> (18 - 6 * i) & 63) as usize];
            text.push(if i <= chunk.len() { digit as char } else { '=' });
        }
    }
    text
}

/// A document under construction: one buffer, one view an accessor.
struct Model {
    document: Value,
    bytes: Vec<u8>,
}

impl Model {
    fn new() -> Model {
        let document = json!({
            "asset": { "version": "2.0" },
            "buffers": [{ "byteLength": 0 }],
            "bufferViews": [], "accessors": [], "meshes": [], "nodes": [],
            "scene": 0, "scenes": [{ "nodes": [] }]
        });
        Model { document, bytes: Vec::new() }
    }

    fn list(&mut self, key: &str) -> &mut Vec<Value> {
        let object = self.document.as_object_mut().unwrap();
        object.entry(key).or_insert_with(|| json!([])).as_array_mut().unwrap()
    }

    fn push(&mut self, key: &str, value: Value) -> usize {
        self.list(key).push(value);
        self.list(key).len() - 1
    }

    fn view(&mut self, bytes: &[u8], stride: Option<u64>) -> usize {
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        if let Some(stride) = stride {
            view["byteStride"] = json!(stride);
        }
        self.bytes.extend_from_slice(bytes);
        self.push("bufferViews", view)
    }

    fn accessor(&mut self, bytes: &[u8], component: u64, shape: &str, count: usize) -> usize {
        let view = self.view(bytes, None);
        let accessor = json!({ "bufferView": view, "componentType": component, "type": shape, "count": count });
        self.push("accessors", accessor)
    }

    /// A mesh of one primitive, and a root node for it.
    fn place(&mut self, primitive: Value) -> usize {
        let mesh = self.push("meshes", json!({ "primitives": [primitive] }));
        let node = self.push("nodes", json!({ "mesh": mesh }));
        self.document["scenes"][0]["nodes"].as_array_mut().unwrap().push(json!(node));
        node
    }

    fn close(&mut self) {
        self.document["buffers"][0]["byteLength"] = json!(self.bytes.len());
    }

    fn gltf(mut self) -> Value {
        self.close();
        self.document["buffers"][0]["uri"] = json!(data_uri(&self.bytes));
        self.document
    }

    fn glb(mut self) -> Vec<u8> {
        self.close();
        glb(&self.document, &self.bytes)
    }
}

fn glb(document: &Value, binary: &[u8]) -> Vec<u8> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut binary = binary.to_vec();
    binary.resize(binary.len().next_multiple_of(4), 0);
    let mut out = b"glTF".to_vec();
    let total = 12 + 8 + json.len() + 8 + binary.len();
    for word in [2, total as u32, json.len() as u32] {
        out.extend(word.to_le_bytes());
    }
    out.extend(b"JSON");
    out.extend(&json);
    out.extend((binary.len() as u32).to_le_bytes());
    out.extend(b"BIN\0");
    out.extend(&binary);
    out
}

const CORNERS: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];

/// Two triangles in a square of side 1 in the XY plane, facing +Z, u8 indices.
fn square() -> Model {
    let mut model = Model::new();
    let positions = model.accessor(&floats(&CORNERS), 5126, "VEC3", 4);
    let indices = model.accessor(&[0, 1, 2, 0, 2, 3], 5121, "SCALAR", 6);
    model.place(json!({ "attributes": { "POSITION": positions }, "indices": indices }));
    model
}

fn with_attribute(name: &str, bytes: &[u8], component: u64, shape: &str, normalized: bool) -> Model {
    let mut model = square();
    let index = model.accessor(bytes, component, shape, 4);
    model.document["accessors"][index]["normalized"] = json!(normalized);
    model.document["meshes"][0]["primitives"][0]["attributes"][name] = json!(index);
    model
}

fn png(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> Vec<u8> {
    let picture = ::image::RgbaImage::from_fn(width, height, |x, y| ::image::Rgba(texel(x, y)));
    let mut out = io::Cursor::new(Vec::new());
    picture.write_to(&mut out, ::image::ImageFormat::Png).unwrap();
    out.into_inner()
}

fn repair_count(report: &ImportReport, kind: RepairKind) -> u64 {
    report.repairs.iter().find(|r| r.kind == kind).map_or(0, |r| r.count)
}

fn defect_paths(outcome: Outcome) -> Vec<String> {
    outcome.expect_err("must be refused").defects().iter().map(|d| d.path.clone()).collect()
}

/// Area-weighted normal of a face, object space.
fn face_normal(mesh: &Mesh, face: usize) -> Vec3 {
    let [a, b, c] = mesh.triangles[face].map(|v| mesh.positions[v as usize]);
    (b - a).cross(c - a)
}

// Planted answers.

#[test]
fn a_square_comes_in_as_it_stands_from_both_shells() {
    let (from_json, _) = import_json(&square().gltf()).unwrap();
    let (from_glb, report) = import_bytes("MODEL.GLB", square().glb()).unwrap();
    assert_eq!(from_json, from_glb);
    assert_eq!(from_glb.mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(from_glb.mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
    assert_eq!(from_glb.mesh.submeshes[0].name, "mesh0");
    assert!(from_glb.mesh.normals.is_none() && from_glb.mesh.uv0.is_none());
    assert_eq!((report.vertices, report.triangles, report.instances), (4, 2, 1));
    assert!(report.repairs.is_empty(), "{:?}", report.repairs);
}

#[test]
fn index_widths_and_absent_indices_give_the_same_triangles() {
    let corners = [0u32, 1, 2, 0, 2, 3];
    let widths: [(u64, Vec<u8>); 3] = [
        (5121, corners.iter().map(|i| *i as u8).collect()),
        (5123, corners.iter().flat_map(|i| (*i as u16).to_le_bytes()).collect()),
        (5125, corners.iter().flat_map(|i| i.to_le_bytes()).collect()),
    ];
    let reference = import_json(&square().gltf()).unwrap().0;
    for (component, bytes) in widths {
        let mut model = square();
        let index = model.accessor(&bytes, component, "SCALAR", 6);
        model.document["meshes"][0]["primitives"][0]["indices"] = json!(index);
        assert_eq!(import_json(&model.gltf()).unwrap().0, reference, "component type {component}");
    }
    let mut model = Model::new();
    let spread: Vec<f32> = corners.iter().flat_map(|i| CORNERS[*i as usize * 3..][..3].to_vec()).collect();
    let positions = model.accessor(&floats(&spread), 5126, "VEC3", 6);
    model.place(json!({ "attributes": { "POSITION": positions } }));
    let (loose, _) = import_json(&model.gltf()).unwrap();
    assert_eq!(loose.mesh.triangles, [[0, 1, 2], [3, 4, 5]]);
    assert_eq!(loose.mesh.point_count(), 4);
}

#[test]
fn interleaved_views_are_read_at_their_stride() {
    let mut model = Model::new();
    let mut bytes = Vec::new();
    for v in 0..4usize {
        bytes.extend(floats(&CORNERS[v * 3..][..3]));
        bytes.extend(floats(&[0.0, 0.0, 1.0]));
        bytes.extend([(v * 60) as u8, 255, 0, 0]);
    }
    let view = model.view(&bytes, Some(28));
    let attribute = |offset: u64, component: u64, shape: &str, normalized: bool| {
        json!({ "bufferView": view, "byteOffset": offset, "componentType": component, "type": shape,
                "normalized": normalized, "count": 4 })
    };
    let positions = model.push("accessors", attribute(0, 5126, "VEC3", false));
    let normals = model.push("accessors", attribute(12, 5126, "VEC3", false));
    let uvs = model.push("accessors", attribute(24, 5121, "VEC2", true));
    let indices = model.accessor(&[0, 1, 2, 0, 2, 3], 5121, "SCALAR", 6);
    model.place(json!({
        "attributes": { "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs }, "indices": indices
    }));
    let (asset, report) = import_json(&model.gltf()).unwrap();
    let plain = import_json(&square().gltf()).unwrap().0;
    assert_eq!(asset.mesh.positions, plain.mesh.positions);
    assert_eq!(asset.mesh.normals.as_ref().unwrap(), &[Vec3::Z; 4]);
    assert_eq!(asset.mesh.uv0.as_ref().unwrap()[3], Vec2::new(180.0 / 255.0, 1.0));
    assert!(report.repairs.is_empty());
}

#[test]
fn a_mirrored_transform_flips_the_winding_and_the_tangent_sign() {
    let mut model = with_attribute("NORMAL", &floats(&[0.0, 0.0, 1.0].repeat(4)), 5126, "VEC3", false);
    let tangents = model.accessor(&floats(&[1.0, 0.0, 0.0, 1.0].repeat(4)), 5126, "VEC4", 4);
    model.document["meshes"][0]["primitives"][0]["attributes"]["TANGENT"] = json!(tangents);
    model.document["nodes"][0]["scale"] = json!([-2, 1, 1]);
    let (asset, report) = import_json(&model.gltf()).unwrap();
    let mesh = &asset.mesh;
    assert_eq!(report.mirrored_instances, 1);
    assert_eq!(mesh.triangles, [[0, 2, 1], [0, 3, 2]]);
    assert_eq!(mesh.positions[1], Vec3::new(-2.0, 0.0, 0.0));
    assert_eq!(mesh.normals.as_ref().unwrap()[0], Vec3::Z);
    assert!(face_normal(mesh, 0).z > 0.0, "still faces +Z");
    assert_eq!(mesh.tangents.as_ref().unwrap()[0], Vec4::new(-1.0, 0.0, 0.0, -1.0));
}

#[test]
fn nested_transforms_apply_from_the_leaf_up_and_a_matrix_counts_like_its_parts() {
    let mut model = square();
    // Turned by 90 degrees about Y (x -> -z), then moved.
    let turn = json!([0.0, 0.5f64.sqrt(), 0.0, 0.5f64.sqrt()]);
    model.document["nodes"] = json!([
        { "mesh": 0, "scale": [2, 1, 1] },
        { "children": [0], "rotation": turn },
        { "children": [1], "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 10,20,30,1] },
    ]);
    model.document["scenes"][0]["nodes"] = json!([2]);
    let (asset, _) = import_json(&model.gltf()).unwrap();
    let found = asset.mesh.positions[1];
    assert!((found - Vec3::new(10.0, 20.0, 28.0)).length() < 1e-5, "{found}");
}

#[test]
fn instances_are_submeshes_of_their_own_with_unique_names() {
    let mut model = square();
    model.push("materials", json!({ "name": "steel" }));
    let mut second = model.document["meshes"][0]["primitives"][0].clone();
    second["material"] = json!(0);
    model.document["meshes"][0]["name"] = json!("axle");
    model.document["meshes"][0]["primitives"].as_array_mut().unwrap().push(second);
    model.document["nodes"] = json!([
        { "mesh": 0, "name": "wheel" },
        { "mesh": 0, "name": "wheel", "translation": [5, 0, 0] },
        { "mesh": 0 },
        { "mesh": 0, "name": "not in the scene" },
    ]);
    model.document["scenes"][0]["nodes"] = json!([0, 1, 2]);
    let (asset, report) = import_json(&model.gltf()).unwrap();
    let names: Vec<_> = asset.mesh.submeshes.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["wheel/0", "wheel/steel", "wheel/0#2", "wheel/steel#2", "axle/0", "axle/steel"]);
    assert_eq!((report.instances, report.submeshes, report.triangles, report.stored_triangles), (3, 6, 12, 4));
    assert_eq!(asset.mesh.positions[8], Vec3::new(5.0, 0.0, 0.0));
}

#[test]
fn without_a_scene_all_roots_count_and_the_default_scene_wins_over_the_first() {
    let mut model = square();
    model.document["nodes"] = json!([{ "children": [1] }, { "mesh": 0 }, { "mesh": 0 }]);
    model.document.as_object_mut().unwrap().remove("scene");
    model.document.as_object_mut().unwrap().remove("scenes");
    assert_eq!(import_json(&model.gltf()).unwrap().1.instances, 2);
    let mut model = square();
    model.document["scenes"] = json!([{ "nodes": [] }, { "nodes": [0] }]);
    model.document["scene"] = json!(1);
    assert_eq!(import_json(&model.gltf()).unwrap().1.instances, 1);
}

#[test]
fn strips_and_fans_keep_the_winding_of_their_first_triangle() {
    for (mode, corners) in [(5u64, [0u8, 1, 3, 2]), (6, [0, 1, 2, 3])] {
        let mut model = square();
        let indices = model.accessor(&corners, 5121, "SCALAR", 4);
        let primitive = &mut model.document["meshes"][0]["primitives"][0];
        primitive["indices"] = json!(indices);
        primitive["mode"] = json!(mode);
        let (asset, _) = import_json(&model.gltf()).unwrap();
        assert_eq!(asset.mesh.face_count(), 2, "mode {mode}");
        for face in 0..2 {
            assert_eq!(face_normal(&asset.mesh, face), Vec3::Z, "mode {mode}, face {face}");
        }
    }
}

#[test]
fn sparse_accessors_replace_elements_of_a_base_and_of_zeros() {
    let mut model = square();
    let indices = model.view(&[1, 3], None);
    let values = model.view(&floats(&[7.0, 8.0, 9.0, -1.0, -2.0, -3.0]), None);
    let sparse = json!({
        "count": 2,
        "indices": { "bufferView": indices, "componentType": 5121 },
        "values": { "bufferView": values }
    });
    model.document["accessors"][0]["sparse"] = sparse;
    let mut zeros = Model { document: model.document.clone(), bytes: model.bytes.clone() };
    let positions = import_json(&model.gltf()).unwrap().0.mesh.into_raw().positions;
    assert_eq!(positions[1], Vec3::new(7.0, 8.0, 9.0));
    assert_eq!(positions[2], Vec3::new(1.0, 1.0, 0.0));
    assert_eq!(positions[3], Vec3::new(-1.0, -2.0, -3.0));
    zeros.document["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    let positions = import_json(&zeros.gltf()).unwrap().0.mesh.into_raw().positions;
    assert_eq!(positions[2], Vec3::ZERO);
    assert_eq!(positions[3], Vec3::new(-1.0, -2.0, -3.0));
}

#[test]
fn colours_weights_and_joints_are_carried_and_absent_ones_are_neutral() {
    let mut model = with_attribute("COLOR_0", &[255, 0, 51, 9, 0, 0, 0, 9].repeat(2), 5121, "VEC4", true);
    let primitive = model.document["meshes"][0]["primitives"][0].clone();
    let joints = model.accessor(&[1, 2, 3, 4].repeat(4), 5121, "VEC4", 4);
    let half = [32_768u16, 0, 0, 65_535].iter().flat_map(|w| w.to_le_bytes()).collect::<Vec<_>>().repeat(4);
    let weights = model.accessor(&half, 5123, "VEC4", 4);
    model.document["accessors"][weights]["normalized"] = json!(true);
    model.document["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(joints);
    model.document["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(weights);
    let mut plain = primitive;
    plain["attributes"].as_object_mut().unwrap().remove("COLOR_0");
    model.place(plain);
    let (asset, _) = import_json(&model.gltf()).unwrap();
    let mesh = &asset.mesh;
    assert_eq!(mesh.colors.as_ref().unwrap()[0], Vec4::new(1.0, 0.0, 0.2, 9.0 / 255.0));
    assert_eq!(mesh.colors.as_ref().unwrap()[4], Vec4::ONE);
    assert_eq!(mesh.joints.as_ref().unwrap()[0], [1, 2, 3, 4]);
    assert_eq!(mesh.weights.as_ref().unwrap()[0], Vec4::new(32_768.0 / 65_535.0, 0.0, 0.0, 1.0));
    assert_eq!(mesh.weights.as_ref().unwrap()[4], Vec4::ZERO);
    assert!(mesh.submeshes[0].attributes.colors && mesh.submeshes[0].attributes.skin);
    assert!(!mesh.submeshes[1].attributes.colors && !mesh.submeshes[1].attributes.skin);
}

#[test]
fn a_colour_without_alpha_is_opaque() {
    let model = with_attribute("COLOR_0", &floats(&[0.25; 12]), 5126, "VEC3", false);
    let (asset, _) = import_json(&model.gltf()).unwrap();
    assert_eq!(asset.mesh.colors.as_ref().unwrap()[0], Vec4::new(0.25, 0.25, 0.25, 1.0));
}

#[test]
fn a_skinned_node_keeps_the_bind_pose_and_skins_are_reported() {
    let mut model = square();
    model.document["skins"] = json!([{ "joints": [0] }]);
    model.document["nodes"][0]["skin"] = json!(0);
    model.document["nodes"][0]["translation"] = json!([9, 9, 9]);
    let (asset, report) = import_json(&model.gltf()).unwrap();
    assert_eq!(asset.mesh.positions[0], Vec3::ZERO);
    assert_eq!(report.not_carried, [NotCarried { what: "skins".into(), count: 1 }]);
}

#[test]
fn vertices_without_a_triangle_and_left_over_indices_are_left_out_and_said() {
    let mut model = square();
    let indices = model.accessor(&[1, 2, 3, 1], 5121, "SCALAR", 4);
    model.document["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    let (asset, report) = import_json(&model.gltf()).unwrap();
    assert_eq!(asset.mesh.triangles, [[0, 1, 2]]);
    assert_eq!(asset.mesh.positions[0], Vec3::X);
    assert_eq!(repair_count(&report, RepairKind::VerticesUnused), 1);
    assert_eq!(repair_count(&report, RepairKind::IndicesLeftOver), 1);
}

#[test]
fn many_primitives_may_share_one_large_vertex_buffer() {
    let mut triangles = vec![[90_000u32, 5, 70_000], [5, 90_000, 12]];
    // A table and a sorted list must agree.
    let used = primitive::compact(&mut triangles, 100_000);
    assert_eq!(used, [5, 12, 70_000, 90_000]);
    assert_eq!(triangles, [[3, 0, 2], [0, 3, 1]]);
    let mut small = vec![[9u32, 5, 7], [5, 9, 6]];
    assert_eq!(primitive::compact(&mut small, 10), [5, 6, 7, 9]);
    assert_eq!(small, [[3, 0, 2], [0, 3, 1]]);
}

#[test]
fn an_importance_arrives_and_what_is_none_counts_one() {
    let model = with_attribute("_KILN_WEIGHT", &floats(&[2.0, 0.0, -1.0, f32::NAN]), 5126, "SCALAR", false);
    let (asset, report) = import_json(&model.gltf()).unwrap();
    assert_eq!(asset.mesh.importance, Some(vec![2.0, 0.0, 1.0, 1.0]));
    assert!(asset.mesh.submeshes[0].attributes.importance);
    assert_eq!(repair_count(&report, RepairKind::ImportanceNotFinite), 2);
}

// Materials and images.

#[test]
fn a_material_with_all_five_textures_arrives_whole() {
    let picture = png(2, 3, |x, y| [x as u8 * 200, y as u8 * 100, 7, 255]);
    let mut model = with_attribute("TEXCOORD_1", &floats(&[0.0; 8]), 5126, "VEC2", false);
    let uv0 = model.accessor(&floats(&[0.5; 8]), 5126, "VEC2", 4);
    model.document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(uv0);
    model.document["meshes"][0]["primitives"][0]["material"] = json!(0);
    let view = model.view(&picture, None);
    model.document["images"] = json!([
        { "bufferView": view, "mimeType": "image/png", "name": "first" },
        { "uri": "maps/second%20one.png" },
        { "uri": "maps/./second%20one.png", "name": "the same file" },
        { "uri": "unused.png" }
    ]);
    model.document["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33648, "magFilter": 9728, "minFilter": 9985 }]);
    model.document["textures"] = json!([
        { "source": 0, "sampler": 0 }, { "source": 1 }, { "source": 2 }, { "source": 3 }
    ]);
    model.document["materials"] = json!([{
        "name": "glaze",
        "pbrMetallicRoughness": {
            "baseColorFactor": [0.1, 0.2, 0.3, 0.4], "metallicFactor": 0.25, "roughnessFactor": 0.75,
            "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 1 }
        },
        "normalTexture": { "index": 1, "scale": 0.5 },
        "occlusionTexture": { "index": 1, "strength": 0.125, "texCoord": 1 },
        "emissiveTexture": { "index": 2 }, "emissiveFactor": [1, 0.5, 0],
        "alphaMode": "MASK", "alphaCutoff": 0.3, "doubleSided": true,
        "extensions": { "KHR_materials_clearcoat": {} }
    }]);
    model.document["extensionsUsed"] = json!(["KHR_materials_clearcoat"]);
    let document = model.gltf();
    let files = Memory(BTreeMap::from([
        ("m.gltf".to_owned(), document.to_string().into_bytes()),
        ("maps/second one.png".to_owned(), png(5, 4, |_, _| [128, 128, 255, 255])),
    ]));
    let (asset, report) = import(&files, "m.gltf", &ImportLimits::default()).unwrap();
    let set = &asset.materials;
    let material = &set.materials[0];
    assert_eq!(material.base_color_factor, [0.1, 0.2, 0.3, 0.4]);
    assert_eq!((material.metallic_factor, material.roughness_factor), (0.25, 0.75));
    assert_eq!((material.normal_scale, material.occlusion_strength), (0.5, 0.125));
    assert_eq!(material.emissive_factor, [1.0, 0.5, 0.0]);
    assert_eq!((material.alpha_mode, material.alpha_cutoff, material.double_sided), (AlphaMode::Mask, 0.3, true));
    assert_eq!(material.occlusion.unwrap().uv_set, 1);
    assert_eq!(set.images.len(), 2, "one file is one image, and unused ones are not carried");
    let base = &set.textures[material.base_color.unwrap().texture.index()];
    assert_eq!((base.sampler.wrap_u, base.sampler.wrap_v), (Wrap::ClampToEdge, Wrap::MirroredRepeat));
    assert_eq!(
        (base.sampler.mag, base.sampler.min, base.sampler.mip),
        (Filter::Nearest, Filter::Linear, Some(Filter::Nearest))
    );
    assert_eq!(set.images[base.image.index()].name, "first");
    assert_eq!(*asset.images[base.image.index()], *picture);
    assert_eq!(set.images[base.image.index()].hash, *blake3::hash(&picture).as_bytes());
    let emissive = &set.textures[material.emissive.unwrap().texture.index()];
    assert_eq!(set.images[emissive.image.index()].name, "second one");
    let sizes: Vec<_> = report.images.iter().map(|i| (i.width, i.height)).collect();
    assert_eq!(sizes, [(2, 3), (5, 4)]);
    assert_eq!(report.extensions_ignored, ["KHR_materials_clearcoat"]);
    assert_eq!(report.not_carried[0].what, "extension KHR_materials_clearcoat");
    assert!(report.repairs.is_empty(), "{:?}", report.repairs);
}

#[test]
fn soft_trouble_is_repaired_by_rule_and_counted() {
    let nan = f32::NAN;
    let normals = [0.0, 0.0, 0.0, nan, 0.0, 1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 1.0];
    let mut model = with_attribute("NORMAL", &floats(&normals), 5126, "VEC3", false);
    let uvs = model.accessor(&floats(&[nan, 0.0, 1.0, f32::INFINITY, 0.5, 0.5, 0.0, 0.0]), 5126, "VEC2", 4);
    let tangents = model.accessor(
        &floats(&[0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 3.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0, -0.5]),
        5126,
        "VEC4",
        4,
    );
    let primitive = &mut model.document["meshes"][0]["primitives"][0];
    primitive["attributes"]["TEXCOORD_0"] = json!(uvs);
    primitive["attributes"]["TANGENT"] = json!(tangents);
    primitive["material"] = json!(0);
    model.document["images"] = json!([{ "uri": "gone.png" }]);
    model.document["textures"] = json!([{ "source": 0 }]);
    model.document["materials"] = json!([{
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "roughnessFactor": 1.5 },
    }]);
    model.document["nodes"][0]["rotation"] = json!([0, 0, 0, 2]);
    let (asset, report) = import_json(&model.gltf()).unwrap();
    let mesh = &asset.mesh;
    assert_eq!(mesh.normals.as_ref().unwrap(), &[Vec3::Z; 4]);
    assert_eq!(mesh.uv0.as_ref().unwrap()[..2], [Vec2::ZERO; 2]);
    let tangents = mesh.tangents.as_ref().unwrap();
    assert!(tangents[0].truncate().dot(Vec3::Z).abs() < 1e-6 && tangents[0].truncate().is_normalized());
    assert_eq!(tangents.iter().map(|t| t.w).collect::<Vec<_>>(), [1.0, 1.0, -1.0, -1.0]);
    assert_eq!(asset.materials.materials[0].roughness_factor, 1.0);
    assert_eq!(asset.materials.materials[0].base_color, None);
    for (kind, count) in [
        (RepairKind::NormalRebuilt, 2),
        (RepairKind::NormalScaled, 1),
        (RepairKind::TangentRebuilt, 1),
        (RepairKind::TangentSign, 2),
        (RepairKind::UvNotFinite, 2),
        (RepairKind::ImageMissing, 1),
        (RepairKind::FactorClamped, 1),
        (RepairKind::RotationScaled, 1),
    ] {
        assert_eq!(repair_count(&report, kind), count, "{kind:?}");
    }
    let first = &report.repairs.iter().find(|r| r.kind == RepairKind::UvNotFinite).unwrap().first;
    assert_eq!(first, "meshes[0].primitives[0].attributes.TEXCOORD_0");
}

#[test]
fn an_identity_uv_transform_is_harmless() {
    let mut model = with_attribute("TEXCOORD_0", &floats(&[0.0; 8]), 5126, "VEC2", false);
    let view = model.view(&png(1, 1, |_, _| [255; 4]), None);
    model.document["images"] = json!([{ "bufferView": view, "mimeType": "image/jpeg" }]);
    model.document["textures"] = json!([{ "source": 0 }]);
    let identity = json!({ "KHR_texture_transform": { "offset": [0, 0], "scale": [1, 1] } });
    model.document["materials"] = json!([{
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0, "extensions": identity } }
    }]);
    let (asset, report) = import_json(&model.gltf()).unwrap();
    assert!(asset.materials.materials[0].base_color.is_some());
    assert_eq!(repair_count(&report, RepairKind::MimeTypeWrong), 1);
    assert_eq!(asset.materials.images[0].format, ImageFormat::Png);
}

#[test]
fn images_of_every_depth_become_rgba8() {
    let limits = ImageLimits::default();
    let encode = |picture: ::image::DynamicImage| {
        let mut out = io::Cursor::new(Vec::new());
        picture.write_to(&mut out, ::image::ImageFormat::Png).unwrap();
        out.into_inner()
    };
    let grey16 = ::image::ImageBuffer::from_fn(3, 2, |x, _| ::image::Luma([x as u16 * 257 * 100]));
    let raster = decode_image(ImageFormat::Png, &encode(grey16.into()), &limits).unwrap();
    assert_eq!((raster.width, raster.height), (3, 2));
    assert_eq!(raster.texels[..3], [[0, 0, 0, 255], [100, 100, 100, 255], [200, 200, 200, 255]]);
    let rgba = png(2, 2, |x, y| [x as u8, y as u8, 3, 4]);
    assert_eq!(decode_image(ImageFormat::Png, &rgba, &limits).unwrap().texels[3], [1, 1, 3, 4]);
    let grey = ::image::DynamicImage::ImageLuma8(::image::ImageBuffer::from_pixel(16, 8, ::image::Luma([90])));
    let mut jpeg = io::Cursor::new(Vec::new());
    grey.write_to(&mut jpeg, ::image::ImageFormat::Jpeg).unwrap();
    let jpeg = jpeg.into_inner();
    assert_eq!(image_size(ImageFormat::Jpeg, &jpeg), Some((16, 8)));
    let raster = decode_image(ImageFormat::Jpeg, &jpeg, &limits).unwrap();
    assert!(raster.texels.iter().all(|t| t[0].abs_diff(90) < 3 && t[0] == t[1] && t[3] == 255));
    let blob = raster.to_blob();
    assert_eq!(image_size(ImageFormat::Raster, &blob), Some((16, 8)));
    assert_eq!(decode_image(ImageFormat::Raster, &blob, &limits).unwrap(), raster);
    for bytes in [&rgba, &jpeg, &blob] {
        let format = image_format(bytes).unwrap();
        // Headers and the start of the data; a picture that lacks only its end marker may be taken.
        for end in 0..40 {
            assert!(decode_image(format, &bytes[..end], &limits).is_err(), "{format:?} of {end} bytes was taken");
        }
    }
}

#[test]
fn an_oversized_header_is_refused_before_decoding() {
    let mut picture = png(1, 1, |_, _| [0; 4]);
    picture[16..20].copy_from_slice(&200_000u32.to_be_bytes());
    picture[20..24].copy_from_slice(&200_000u32.to_be_bytes());
    let error = decode_image(ImageFormat::Png, &picture, &ImageLimits::default()).unwrap_err();
    assert!(error.to_string().contains("200000 x 200000"), "{error}");
    let mut model = with_attribute("TEXCOORD_0", &floats(&[0.0; 8]), 5126, "VEC2", false);
    let view = model.view(&picture, None);
    model.document["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
    model.document["textures"] = json!([{ "source": 0 }]);
    model.document["materials"] = json!([{ "emissiveTexture": { "index": 0 } }]);
    assert_eq!(defect_paths(import_json(&model.gltf())), ["images[0]"]);
}
