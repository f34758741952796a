//! Malformed and hostile models: each refused with the path of the value, fast, and never by a panic.

use super::*;

/// Sets the value at a JSON pointer, or removes it where `value` is `None`.
pub(super) fn edit(document: &mut Value, pointer: &str, value: Option<Value>) {
    let (parent, key) = pointer.rsplit_once('/').unwrap();
    let parent = document.pointer_mut(parent).unwrap_or_else(|| panic!("no {parent}"));
    match (parent, value) {
        (Value::Object(map), Some(value)) => drop(map.insert(key.to_owned(), value)),
        (Value::Object(map), None) => drop(map.remove(key).unwrap_or_else(|| panic!("no {pointer}"))),
        (Value::Array(list), Some(value)) => match key.parse::<usize>().unwrap() {
            i if i < list.len() => list[i] = value,
            _ => list.push(value),
        },
        _ => panic!("{pointer} cannot be edited"),
    }
}

/// A textured square with normals, two nodes, an image in a view: something of everything.
fn rich() -> Model {
    let mut model = with_attribute("NORMAL", &floats(&[0.0, 0.0, 1.0].repeat(4)), 5126, "VEC3", false);
    let uvs = model.accessor(&floats(&[0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0]), 5126, "VEC2", 4);
    model.document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(uvs);
    model.document["meshes"][0]["primitives"][0]["material"] = json!(0);
    let view = model.view(&png(2, 2, |x, y| [x as u8 * 255, y as u8 * 255, 0, 255]), None);
    model.document["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
    model.document["samplers"] = json!([{ "wrapS": 10497 }]);
    model.document["textures"] = json!([{ "source": 0, "sampler": 0 }]);
    model.document["materials"] = json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }]);
    model.document["nodes"] = json!([{ "mesh": 0 }, { "children": [0], "rotation": [0, 0, 0, 1] }]);
    model.document["scenes"][0]["nodes"] = json!([1]);
    model
}

#[test]
fn every_malformed_document_names_the_place() {
    let huge = u64::MAX;
    // (JSON pointer, new value or removal, path of the one defect)
    let cases: Vec<(&str, Option<Value>, &str)> = vec![
        ("/asset", None, "asset"),
        ("/asset/version", None, "asset.version"),
        ("/asset/version", Some(json!(2.0)), "asset.version"),
        ("/buffers/0/byteLength", None, "buffers[0].byteLength"),
        ("/buffers/0/byteLength", Some(json!(-1)), "buffers[0].byteLength"),
        ("/buffers/0/byteLength", Some(json!(huge)), "buffers[0].byteLength"),
        ("/buffers/0/uri", Some(json!("data:;base64,AAAA")), "buffers[0].byteLength"),
        ("/buffers/0/uri", Some(json!("../secret.bin")), "buffers[0].uri"),
        ("/buffers/0/uri", Some(json!("%2e%2e/secret.bin")), "buffers[0].uri"),
        ("/buffers/0/uri", Some(json!("/etc/passwd")), "buffers[0].uri"),
        ("/buffers/0/uri", Some(json!("http://host/a.bin")), "buffers[0].uri"),
        ("/buffers/0/uri", Some(json!(7)), "buffers[0].uri"),
        ("/buffers/0/uri", None, "buffers[0]"),
        ("/bufferViews", Some(json!({})), "bufferViews"),
        ("/bufferViews/0/buffer", Some(json!(1)), "bufferViews[0].buffer"),
        ("/bufferViews/0/buffer", None, "bufferViews[0].buffer"),
        ("/bufferViews/0/byteLength", Some(json!(huge)), "bufferViews[0]"),
        ("/bufferViews/0/byteOffset", Some(json!(huge)), "bufferViews[0]"),
        ("/bufferViews/0/byteStride", Some(json!(4)), "accessors[0].bufferView"),
        ("/bufferViews/0/byteStride", Some(json!(16)), "accessors[0]"),
        ("/bufferViews/0/byteStride", Some(json!(0)), "bufferViews[0].byteStride"),
        ("/bufferViews/0/byteStride", Some(json!(huge)), "bufferViews[0].byteStride"),
        ("/accessors/0", Some(json!(3)), "accessors[0]"),
        ("/accessors/0/bufferView", Some(json!(99)), "accessors[0].bufferView"),
        ("/accessors/0/byteOffset", Some(json!(1)), "accessors[0]"),
        ("/accessors/0/byteOffset", Some(json!(huge)), "accessors[0]"),
        ("/accessors/0/componentType", Some(json!(5124)), "accessors[0].componentType"),
        ("/accessors/0/componentType", None, "accessors[0].componentType"),
        ("/accessors/0/componentType", Some(json!(5122)), "meshes[0].primitives[0].attributes.POSITION"),
        ("/accessors/0/type", Some(json!("VEC5")), "accessors[0].type"),
        ("/accessors/0/type", None, "accessors[0].type"),
        ("/accessors/0/type", Some(json!("SCALAR")), "meshes[0].primitives[0].attributes.POSITION"),
        ("/accessors/0/count", Some(json!(5)), "accessors[0]"),
        ("/accessors/0/count", Some(json!(0)), "accessors[0].count"),
        ("/accessors/0/count", Some(json!(3.5)), "accessors[0].count"),
        ("/accessors/0/count", Some(json!(huge)), "accessors[0].count"),
        ("/accessors/0/count", Some(json!(1e300)), "accessors[0].count"),
        ("/accessors/0/count", None, "accessors[0].count"),
        ("/accessors/0/normalized", Some(json!(true)), "meshes[0].primitives[0].attributes.POSITION"),
        ("/accessors/1/componentType", Some(json!(5126)), "accessors[1]"),
        ("/accessors/1/componentType", Some(json!(5120)), "meshes[0].primitives[0].indices"),
        ("/accessors/1/type", Some(json!("VEC3")), "accessors[1]"),
        ("/accessors/2/count", Some(json!(3)), "meshes[0].primitives[0].attributes.NORMAL"),
        ("/accessors/3/type", Some(json!("SCALAR")), "meshes[0].primitives[0].attributes.TEXCOORD_0"),
        ("/meshes/0/primitives", Some(json!([])), "meshes[0].primitives"),
        ("/meshes/0/primitives/0/attributes", None, "meshes[0].primitives[0].attributes"),
        ("/meshes/0/primitives/0/attributes/POSITION", None, "meshes[0].primitives[0].attributes.POSITION"),
        ("/meshes/0/primitives/0/attributes/POSITION", Some(json!(9)), "meshes[0].primitives[0].attributes.POSITION"),
        ("/meshes/0/primitives/0/attributes/JOINTS_0", Some(json!(0)), "meshes[0].primitives[0].attributes.JOINTS_0"),
        ("/meshes/0/primitives/0/attributes/_MINE", Some(json!(9)), "meshes[0].primitives[0].attributes._MINE"),
        ("/meshes/0/primitives/0/indices", Some(json!(9)), "meshes[0].primitives[0].indices"),
        ("/meshes/0/primitives/0/indices", Some(json!(0)), "meshes[0].primitives[0].indices"),
        ("/meshes/0/primitives/0/material", Some(json!(1)), "meshes[0].primitives[0].material"),
        ("/meshes/0/primitives/0/mode", Some(json!(7)), "meshes[0].primitives[0].mode"),
        ("/images/0/bufferView", None, "images[0]"),
        ("/images/0/bufferView", Some(json!(0)), "images[0]"),
        ("/images/0/uri", Some(json!("x.png")), "images[0]"),
        ("/samplers/0/wrapS", Some(json!(1)), "samplers[0].wrapS"),
        ("/samplers/0/minFilter", Some(json!(1)), "samplers[0].minFilter"),
        ("/textures/0/source", Some(json!(1)), "textures[0].source"),
        ("/textures/0/source", None, "textures[0].source"),
        ("/textures/0/sampler", Some(json!(1)), "textures[0].sampler"),
        (
            "/materials/0/pbrMetallicRoughness/baseColorTexture/index",
            Some(json!(1)),
            "materials[0].pbrMetallicRoughness.baseColorTexture.index",
        ),
        (
            "/materials/0/pbrMetallicRoughness/baseColorFactor",
            Some(json!([1, 1, 1])),
            "materials[0].pbrMetallicRoughness.baseColorFactor",
        ),
        ("/materials/0/alphaMode", Some(json!("GLOW")), "materials[0].alphaMode"),
        ("/materials/0/doubleSided", Some(json!(1)), "materials[0].doubleSided"),
        ("/nodes/0/mesh", Some(json!(1)), "nodes[0].mesh"),
        ("/nodes/0/children", Some(json!([0])), "nodes[0]"),
        ("/nodes/0/children", Some(json!([7])), "nodes[0].children[0]"),
        ("/nodes/1/children", Some(json!([0, 0])), "nodes[1].children[1]"),
        ("/nodes/1/rotation", Some(json!([0, 0, 0, 0])), "nodes[1].rotation"),
        ("/nodes/1/rotation", Some(json!([0, 0, 1])), "nodes[1].rotation"),
        ("/nodes/1/rotation", Some(json!([0, 0, "x", 1])), "nodes[1].rotation[2]"),
        ("/nodes/1/matrix", Some(json!([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])), "nodes[1].matrix"),
        ("/nodes/0/matrix", Some(json!([1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1])), "nodes[0].matrix"),
        ("/nodes/0/scale", Some(json!([1e39, 1, 1])), "nodes[0]"),
        ("/scene", Some(json!(1)), "scene"),
        ("/scenes/0/nodes", Some(json!([0])), "scenes[0].nodes[0]"),
        ("/scenes/0/nodes", Some(json!([1, 1])), "scenes[0].nodes[1]"),
        ("/scenes/0/nodes", Some(json!([])), "scenes"),
    ];
    let good = rich().gltf();
    import_json(&good).unwrap();
    for (pointer, value, path) in cases {
        let mut document = good.clone();
        edit(&mut document, pointer, value.clone());
        let started = Instant::now();
        match import_json(&document) {
            Err(ImportError::Invalid(defects)) => {
                let paths: Vec<_> = defects.iter().map(|d| d.path.as_str()).collect();
                assert!(paths.contains(&path), "{pointer} = {value:?}: {defects:?}");
            }
            other => panic!("{pointer} = {value:?}: {:?}", other.map(|(_, report)| report)),
        }
        assert!(started.elapsed().as_secs() < 5, "{pointer} = {value:?} took {:?}", started.elapsed());
    }
}

#[test]
fn files_outside_the_folder_are_read_only_where_that_is_allowed() {
    let mut model = square();
    model.close();
    model.document["buffers"][0]["uri"] = json!("a/../%2e%2e/shared/b.bin");
    let files = Memory(BTreeMap::from([
        ("m.gltf".to_owned(), model.document.to_string().into_bytes()),
        ("../shared/b.bin".to_owned(), model.bytes.clone()),
        ("m.obj".to_owned(), b"mtllib ..\\shared\\m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n".to_vec()),
        ("../shared/m.mtl".to_owned(), b"newmtl red\nKd 1 0 0\n".to_vec()),
    ]));
    let allowed = ImportLimits { allow_outside: true, ..ImportLimits::default() };
    for (main, place) in [("m.gltf", "buffers[0].uri"), ("m.obj", "m.obj:1")] {
        assert_eq!(defect_paths(import(&files, main, &ImportLimits::default())), [place]);
        let (asset, _) = import(&files, main, &allowed).unwrap();
        assert!(asset.mesh.face_count() > 0);
    }
    let (asset, _) = import(&files, "m.obj", &allowed).unwrap();
    assert_eq!(asset.materials.materials[0].base_color_factor[..3], [1.0, 0.0, 0.0]);
}

#[test]
fn what_is_not_read_is_refused_by_name() {
    let cases: Vec<(&str, Value, &str, &str)> = vec![
        ("/asset/version", json!("1.0"), "asset.version", "1.0"),
        ("/asset/minVersion", json!("2.1"), "asset.minVersion", "2.1"),
        ("/extensionsRequired", json!(["EXT_of_tomorrow"]), "extensionsRequired[0]", "EXT_of_tomorrow"),
        ("/meshes/0/primitives/0/mode", json!(1), "meshes[0].primitives[0].mode", "LINES"),
        (
            "/textures/0",
            json!({ "extensions": { "MSFT_texture_dds": { "source": 0 } } }),
            "textures[0].extensions.MSFT_texture_dds",
            "PNG",
        ),
        ("/images/0/mimeType", json!("image/avif"), "images[0].mimeType", "image/avif"),
    ];
    for (pointer, value, path, word) in cases {
        let mut document = rich().gltf();
        edit(&mut document, pointer, Some(value));
        match import_json(&document) {
            Err(ImportError::Unsupported(defects)) => {
                let defect =
                    defects.iter().find(|d| d.path == path).unwrap_or_else(|| panic!("{pointer}: {defects:?}"));
                assert!(defect.message.contains(word), "{pointer}: {defect}");
            }
            other => panic!("{pointer}: {:?}", other.map(|(_, report)| report)),
        }
    }
    assert!(matches!(import_bytes("a.fbx", Vec::new()), Err(ImportError::Unsupported(_))));
}

#[test]
fn all_defects_come_in_one_go() {
    let mut document = rich().gltf();
    edit(&mut document, "/accessors/0/count", Some(json!(99)));
    edit(&mut document, "/materials/0/alphaMode", Some(json!("GLOW")));
    edit(&mut document, "/nodes/0/mesh", Some(json!(5)));
    edit(&mut document, "/bufferViews/9", Some(json!({ "buffer": 0, "byteLength": 1, "byteOffset": "x" })));
    let paths = defect_paths(import_json(&document));
    assert_eq!(paths, ["bufferViews[5].byteOffset", "accessors[0]", "materials[0].alphaMode", "nodes[0].mesh"]);
}

#[test]
fn contents_out_of_range_are_refused_with_their_primitive() {
    for (index, reason) in [(4u8, "there are 4 vertices"), (255, "restart value")] {
        let mut model = square();
        let indices = model.accessor(&[0, 1, index], 5121, "SCALAR", 3);
        model.document["meshes"][0]["primitives"][0]["indices"] = json!(indices);
        let error = import_json(&model.gltf()).unwrap_err();
        assert_eq!(error.defects()[0].path, "meshes[0].primitives[0].indices");
        assert!(error.to_string().contains(reason), "{error}");
    }
    for bad in [f32::NAN, f32::INFINITY] {
        let mut positions = CORNERS;
        positions[7] = bad;
        let mut model = square();
        let index = model.accessor(&floats(&positions), 5126, "VEC3", 4);
        model.document["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(index);
        let error = import_json(&model.gltf()).unwrap_err();
        assert_eq!(error.defects()[0].path, "meshes[0].primitives[0].attributes.POSITION");
        assert!(error.to_string().contains("vertex 2"), "{error}");
    }
    for (indices, reason) in [([3u8, 1], "ascend"), ([1, 1], "ascend"), ([1, 4], "element 4 of 4")] {
        let mut model = square();
        let indices = model.view(&indices, None);
        let values = model.view(&floats(&[0.0; 6]), None);
        model.document["accessors"][0]["sparse"] = json!({
            "count": 2,
            "indices": { "bufferView": indices, "componentType": 5121 },
            "values": { "bufferView": values }
        });
        let error = import_json(&model.gltf()).unwrap_err();
        assert_eq!(error.defects()[0].path, "accessors[0].sparse.indices[1]");
        assert!(error.to_string().contains(reason), "{error}");
    }
}

#[test]
fn missing_buffers_are_the_systems_fault_and_named() {
    let mut document = square().gltf();
    edit(&mut document, "/buffers/0/uri", Some(json!("gone.bin")));
    let error = import_json(&document).unwrap_err();
    assert!(matches!(&error, ImportError::Io(_)) && error.to_string().contains("gone.bin"), "{error}");
    let error = import(&Memory::default(), "gone.glb", &ImportLimits::default()).unwrap_err();
    assert!(matches!(&error, ImportError::Io(_)) && error.to_string().contains("gone.glb"), "{error}");
}

/// Time that no refusal may take; honest refusals take milliseconds, so that a busy machine does not matter.
const SOON_SECONDS: u64 = 10;

#[test]
fn graphs_with_two_to_the_forty_paths_are_refused_fast() {
    let mut model = square();
    let nodes: Vec<Value> =
        (0..40).map(|i| json!({ "children": [i + 1, i + 1] })).chain([json!({ "mesh": 0 })]).collect();
    model.document["nodes"] = Value::Array(nodes);
    let started = Instant::now();
    let paths = defect_paths(import_json(&model.gltf()));
    assert_eq!(paths.len(), 40);
    assert_eq!(paths[0], "nodes[0].children[1]");
    assert!(started.elapsed().as_secs() < SOON_SECONDS);
}

#[test]
fn long_chains_and_rings_are_refused_without_recursion() {
    for (end, expected) in [(json!({ "mesh": 0 }), "nodes[4096]"), (json!({ "children": [0] }), "nodes[0]")] {
        let mut model = square();
        let chain = (1..20_000).map(|i| json!({ "children": [i] })).chain([end]);
        model.document["nodes"] = Value::Array(chain.collect());
        let started = Instant::now();
        let paths = defect_paths(import_json(&model.gltf()));
        assert!(paths.iter().any(|p| p == expected), "{paths:?}");
        assert!(started.elapsed().as_secs() < SOON_SECONDS);
    }
}

#[test]
fn instances_beyond_the_limits_are_refused_before_they_are_made() {
    let limits = ImportLimits { max_triangles: 99, max_vertices: 199, max_submeshes: 49, ..Default::default() };
    let mut model = square();
    model.document["nodes"] = Value::Array(vec![json!({ "mesh": 0 }); 50]);
    model.document["scenes"][0]["nodes"] = json!((0..50).collect::<Vec<_>>());
    let files = Memory(BTreeMap::from([("m.glb".to_owned(), model.glb())]));
    let defects = import(&files, "m.glb", &limits).unwrap_err();
    let text = defects.to_string();
    for part in ["200 vertices", "100 triangles", "50 submeshes"] {
        assert!(text.contains(part), "{text}");
    }
    assert!(import(&files, "m.glb", &ImportLimits::default()).is_ok());
}

#[test]
fn a_small_file_cannot_claim_millions_of_zeros() {
    let mut model = square();
    let indices = model.view(&[0], None);
    let values = model.view(&floats(&[0.0; 3]), None);
    model.document["accessors"][0] = json!({
        "componentType": 5126, "type": "VEC3", "count": 60_000_000,
        "sparse": {
            "count": 1,
            "indices": { "bufferView": indices, "componentType": 5121 },
            "values": { "bufferView": values }
        }
    });
    assert_eq!(defect_paths(import_json(&model.gltf())), ["accessors[0].count"]);
}

#[test]
fn replaced_elements_count_at_every_use() {
    let mut model = square();
    let indices = model.view(&[1, 3], None);
    let values = model.view(&floats(&[0.0; 6]), None);
    model.document["accessors"][0]["sparse"] = json!({
        "count": 2,
        "indices": { "bufferView": indices, "componentType": 5121 },
        "values": { "bufferView": values }
    });
    let primitive = model.document["meshes"][0]["primitives"][0].clone();
    model.document["meshes"][0]["primitives"] = Value::Array(vec![primitive; 5]);
    let files = Memory(BTreeMap::from([("m.glb".to_owned(), model.glb())]));
    let limits = |most| ImportLimits { max_vertices: most, ..Default::default() };
    let error = import(&files, "m.glb", &limits(9)).unwrap_err();
    assert!(error.to_string().contains("10 replaced elements"), "{error}");
    assert!(import(&files, "m.glb", &limits(20)).is_ok());
}

#[test]
fn files_beyond_the_limits_are_refused() {
    let bytes = square().glb();
    let files = Memory(BTreeMap::from([("m.glb".to_owned(), bytes.clone())]));
    for limits in [
        ImportLimits { max_file_bytes: bytes.len() as u64 - 1, ..Default::default() },
        ImportLimits { max_json_bytes: 100, ..Default::default() },
    ] {
        assert!(matches!(import(&files, "m.glb", &limits), Err(ImportError::Invalid(_))));
    }
    let limits = ImportLimits { max_file_bytes: bytes.len() as u64, ..Default::default() };
    assert!(import(&files, "m.glb", &limits).is_ok());
}

#[test]
fn deeply_nested_json_is_refused() {
    let text = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    assert!(matches!(import_bytes("m.gltf", text.into_bytes()), Err(ImportError::Invalid(_))));
}

#[test]
fn no_prefix_of_a_glb_is_taken() {
    let bytes = rich().glb();
    import_bytes("m.glb", bytes.clone()).unwrap();
    for end in 0..bytes.len() {
        assert!(import_bytes("m.glb", bytes[..end].to_vec()).is_err(), "prefix of {end} bytes was taken");
    }
}

#[test]
fn flipped_bytes_give_a_mesh_or_an_error() {
    let bytes = rich().glb();
    let mut refused = 0;
    for at in 0..bytes.len() {
        for flip in [0x01, 0x10, 0x80, 0xFF] {
            let mut changed = bytes.clone();
            changed[at] ^= flip;
            match import_bytes("m.glb", changed) {
                Ok((asset, _)) => assert!(asset.mesh.positions.iter().all(|p| p.is_finite())),
                Err(error) => {
                    refused += 1;
                    assert!(!error.defects().is_empty());
                }
            }
        }
    }
    assert!(refused > bytes.len(), "only {refused} changes were refused");
}
