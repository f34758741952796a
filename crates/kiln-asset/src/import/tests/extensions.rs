//! Extensions: what was compressed, quantised or transformed comes in as the plain model does.

use draco_core::{
    DataType, EncoderBuffer, EncoderOptions, FaceIndex, GeometryAttributeType, MeshEncoder, PointAttribute,
};

use super::*;

const SIDE: usize = 24;

/// A bumpy sheet of `SIDE` x `SIDE` vertices.
struct Sheet {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    uvs: Vec<[f32; 2]>,
    indices: Vec<u32>,
}

fn sheet() -> Sheet {
    let at = |i: usize| [(i % SIDE) as f32 / (SIDE - 1) as f32, (i / SIDE) as f32 / (SIDE - 1) as f32];
    let height = |[x, y]: [f32; 2]| 0.2 * libm::sinf(5.0 * x) * libm::cosf(4.0 * y);
    let normal = |[x, y]: [f32; 2]| {
        let slope = [libm::cosf(5.0 * x) * libm::cosf(4.0 * y), -0.8 * libm::sinf(5.0 * x) * libm::sinf(4.0 * y)];
        Vec3::new(-slope[0], -slope[1], 1.0).normalize().to_array()
    };
    let mut indices = Vec::new();
    for i in (0..SIDE * (SIDE - 1)).filter(|i| i % SIDE + 1 < SIDE) {
        let [a, b, c, d] = [i, i + 1, i + SIDE + 1, i + SIDE].map(|v| v as u32);
        indices.extend([a, b, c, a, c, d]);
    }
    let places = || (0..SIDE * SIDE).map(at);
    Sheet {
        positions: places().map(|p| [p[0], p[1], height(p)]).collect(),
        normals: places().map(normal).collect(),
        uvs: places().collect(),
        indices,
    }
}

impl Sheet {
    fn plain(&self) -> Mesh {
        let mut model = Model::new();
        let count = self.positions.len();
        let positions = model.accessor(bytemuck::cast_slice(&self.positions), 5126, "VEC3", count);
        let normals = model.accessor(bytemuck::cast_slice(&self.normals), 5126, "VEC3", count);
        let uvs = model.accessor(bytemuck::cast_slice(&self.uvs), 5126, "VEC2", count);
        let indices = model.accessor(bytemuck::cast_slice(&self.indices), 5125, "SCALAR", self.indices.len());
        let attributes = json!({ "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs });
        model.place(json!({ "attributes": attributes, "indices": indices }));
        import_json(&model.gltf()).unwrap().0.mesh
    }
}

/// A view over compressed bytes, and an accessor over it.
fn compressed(model: &mut Model, name: &str, bytes: &[u8], extension: Value, accessor: Value) -> usize {
    let encoded = model.view(bytes, None);
    let mut extension = extension;
    let place = model.document["bufferViews"].as_array_mut().unwrap().pop().unwrap();
    assert_eq!(encoded, model.document["bufferViews"].as_array().unwrap().len());
    for key in ["buffer", "byteOffset", "byteLength"] {
        extension[key] = place[key].clone();
    }
    let length = extension["count"].as_u64().unwrap() * extension["byteStride"].as_u64().unwrap();
    let mut view = json!({ "buffer": 1, "byteLength": length, "extensions": { name: extension } });
    if view["extensions"][name]["mode"] == "ATTRIBUTES" {
        view["byteStride"] = view["extensions"][name]["byteStride"].clone();
    }
    let view = model.push("bufferViews", view);
    let mut accessor = accessor;
    accessor["bufferView"] = json!(view);
    model.push("accessors", accessor)
}

/// The sheet, with every kind of stream that meshoptimizer has.
fn meshopt_sheet(sheet: &Sheet, name: &str, version: i32) -> Model {
    let mut model = Model::new();
    let placeholder = json!({ "byteLength": 1 << 20, "extensions": { name: { "fallback": true } } });
    model.document["buffers"].as_array_mut().unwrap().push(placeholder);
    model.document["extensionsUsed"] = json!([name, "KHR_mesh_quantization"]);
    model.document["extensionsRequired"] = json!([name, "KHR_mesh_quantization"]);
    let count = sheet.positions.len();
    let exponents = ::meshopt::encode_filter_exp(&sheet.positions, 18, ::meshopt::EncodeExpMode::Separate);
    let bytes = ::meshopt::encode_vertex_buffer_level(&exponents, 2, Some(version)).unwrap();
    let extension = json!({ "byteStride": 12, "count": count, "mode": "ATTRIBUTES", "filter": "EXPONENTIAL" });
    let accessor = json!({ "componentType": 5126, "type": "VEC3", "count": count });
    let positions = compressed(&mut model, name, &bytes, extension, accessor);

    let wide: Vec<[f32; 4]> = sheet.normals.iter().map(|n| [n[0], n[1], n[2], 0.0]).collect();
    let octahedral: Vec<[i8; 4]> = ::meshopt::encode_filter_oct(&wide, 8);
    let bytes = ::meshopt::encode_vertex_buffer_level(&octahedral, 2, Some(version)).unwrap();
    let extension = json!({ "byteStride": 4, "count": count, "mode": "ATTRIBUTES", "filter": "OCTAHEDRAL" });
    let accessor = json!({ "componentType": 5120, "normalized": true, "type": "VEC3", "count": count });
    let normals = compressed(&mut model, name, &bytes, extension, accessor);

    let uvs: Vec<[u16; 2]> = sheet.uvs.iter().map(|uv| uv.map(|c| (c * 65_535.0).round() as u16)).collect();
    let bytes = ::meshopt::encode_vertex_buffer_level(&uvs, 2, Some(version)).unwrap();
    let extension = json!({ "byteStride": 4, "count": count, "mode": "ATTRIBUTES" });
    let accessor = json!({ "componentType": 5123, "normalized": true, "type": "VEC2", "count": count });
    let uvs = compressed(&mut model, name, &bytes, extension, accessor);

    // Half as triangles of 16-bit indices, half as a sequence of 32-bit ones.
    let (first, second) = sheet.indices.split_at(sheet.indices.len() / 6 * 3);
    let bytes = ::meshopt::encode_index_buffer(first, count).unwrap();
    let extension = json!({ "byteStride": 2, "count": first.len(), "mode": "TRIANGLES" });
    let accessor = json!({ "componentType": 5123, "type": "SCALAR", "count": first.len() });
    let first = compressed(&mut model, name, &bytes, extension, accessor);
    let bytes = ::meshopt::encode_index_sequence(second, count).unwrap();
    let extension = json!({ "byteStride": 4, "count": second.len(), "mode": "INDICES" });
    let accessor = json!({ "componentType": 5125, "type": "SCALAR", "count": second.len() });
    let second = compressed(&mut model, name, &bytes, extension, accessor);
    let attributes = json!({ "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs });
    for indices in [first, second] {
        model.place(json!({ "attributes": attributes, "indices": indices }));
    }
    model
}

/// All corners of a mesh in order, each (position, normal, UV).
fn corners(mesh: &Mesh) -> Vec<(Vec3, Vec3, Vec2)> {
    let (normals, uvs) = (mesh.normals.as_ref().unwrap(), mesh.uv0.as_ref().unwrap());
    let corner = |v: &u32| (mesh.positions[*v as usize], normals[*v as usize], uvs[*v as usize]);
    mesh.triangles.iter().flatten().map(corner).collect()
}

fn assert_near(found: &Mesh, expected: &Mesh, bars: [f32; 3]) {
    let (found, expected) = (corners(found), corners(expected));
    assert_eq!(found.len(), expected.len());
    for (i, (f, e)) in found.iter().zip(&expected).enumerate() {
        let apart = [f.0.distance(e.0), f.1.distance(e.1), f.2.distance(e.2)];
        assert!(apart.iter().zip(bars).all(|(a, bar)| *a <= bar), "corner {i}: {f:?} for {e:?}, bars {bars:?}");
    }
}

/// Each triangle by the places of its corners in the grid, turned until the least comes first, sorted: what the order of an
/// encoder cannot change.
fn by_place(mesh: &Mesh) -> Vec<[u32; 3]> {
    let cell = |c: f32| (c * (SIDE - 1) as f32).round() as u32;
    let key = |v: u32| cell(mesh.positions[v as usize].y) * SIDE as u32 + cell(mesh.positions[v as usize].x);
    let turned = |triangle: &[u32; 3]| {
        let mut keys = triangle.map(key);
        let least = (0..3).min_by_key(|k| keys[*k]).unwrap();
        keys.rotate_left(least);
        keys
    };
    let mut out: Vec<_> = mesh.triangles.iter().map(turned).collect();
    out.sort_unstable();
    out
}

#[test]
fn every_meshopt_stream_under_both_names_comes_in_as_the_plain_sheet() {
    let sheet = sheet();
    let plain = sheet.plain();
    for (name, version) in [("EXT_meshopt_compression", 0), ("KHR_meshopt_compression", 1)] {
        let model = meshopt_sheet(&sheet, name, version);
        let size = model.bytes.len();
        let (asset, report) = import_json(&model.gltf()).unwrap();
        // Bits of an exponent of 18, of an octahedral normal of 8, of a UV of 16.
        let half = plain.face_count() / 2;
        let raw = asset.mesh;
        assert_eq!(raw.submesh_faces(crate::SubmeshId(0)).len(), half, "two submeshes of half the triangles");
        assert!(by_place(&raw) == by_place(&plain), "other triangles");
        let second = corners(&raw)[3 * half..].to_vec();
        for ((f, e), i) in second.iter().zip(&corners(&plain)[3 * half..]).zip(0..) {
            assert!(f.0.distance(e.0) < 1e-5, "{name} corner {i}: {f:?} for {e:?}");
            assert!(f.1.dot(e.1) > 0.9995 && f.2.distance(e.2) < 2e-5, "{name} corner {i}: {f:?} for {e:?}");
        }
        assert!(report.repairs.iter().all(|r| r.kind == RepairKind::VerticesUnused), "{:?}", report.repairs);
        assert!(report.extensions_ignored.is_empty(), "{:?}", report.extensions_ignored);
        assert!(size < 9_000, "{name}: {size} bytes are not compressed");
    }
}

#[test]
fn what_is_wrong_with_a_compressed_view_is_named() {
    let whole = meshopt_sheet(&sheet(), "EXT_meshopt_compression", 0).gltf();
    let at = |key: &str| format!("/bufferViews/0/extensions/EXT_meshopt_compression/{key}");
    let place = |key: &str| match key {
        "" => "bufferViews[0]".to_owned(),
        key => format!("bufferViews[0].extensions.EXT_meshopt_compression.{key}"),
    };
    let huge = json!(u64::MAX);
    for (key, value, path) in [
        ("buffer", json!(7), "buffer"),
        ("byteOffset", huge.clone(), ""),
        ("byteLength", huge.clone(), ""),
        ("byteLength", json!(40), ""),
        ("byteStride", json!(13), "byteStride"),
        ("byteStride", json!(260), "byteStride"),
        ("byteStride", json!(0), "byteStride"),
        ("byteStride", huge.clone(), "byteStride"),
        ("count", json!(0), "count"),
        ("count", json!(1u64 << 40), "count"),
        ("count", huge.clone(), "count"),
        ("count", json!(575), ""),
        ("mode", json!("LINES"), "mode"),
        ("mode", json!("TRIANGLES"), "byteStride"),
        ("mode", json!(3), "mode"),
        ("filter", json!("BLUR"), "filter"),
        ("filter", json!("QUATERNION"), "filter"),
    ] {
        let mut document = whole.clone();
        hostile::edit(&mut document, &at(key), Some(value.clone()));
        let paths = defect_paths(import_json(&document));
        let expected = place(path);
        assert!(paths.iter().any(|p| p.starts_with(&expected)), "{key} = {value}: {paths:?}, not {expected}");
    }
}

#[test]
fn many_views_over_the_same_compressed_bytes_are_refused() {
    let mut document = meshopt_sheet(&sheet(), "EXT_meshopt_compression", 0).gltf();
    let view = document["bufferViews"][0].clone();
    let views = document["bufferViews"].as_array_mut().unwrap();
    views.extend(std::iter::repeat_n(view, 1000));
    assert_eq!(defect_paths(import_json(&document)), ["bufferViews"]);
}

#[test]
fn broken_compressed_bytes_never_panic() {
    let whole = meshopt_sheet(&sheet(), "KHR_meshopt_compression", 1);
    let mut state = 7u32;
    for _ in 0..400 {
        let mut model = Model { document: whole.document.clone(), bytes: whole.bytes.clone() };
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let at = (state >> 8) as usize % model.bytes.len();
        model.bytes[at] ^= 1 << (state & 7);
        // Damaged values may be values still; damaged structure is told.
        if let Err(error) = import_json(&model.gltf()) {
            assert!(!error.defects().is_empty());
        }
    }
}

#[test]
fn quantised_attributes_are_their_numbers_in_the_space_that_the_node_gives() {
    let sheet = sheet();
    let plain = sheet.plain();
    let count = sheet.positions.len();
    let mut model = Model::new();
    model.document["extensionsUsed"] = json!(["KHR_mesh_quantization"]);
    model.document["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
    // Positions as unsigned 16-bit numbers, padded to a stride of 8; heights moved by 0.25 so that they are positive.
    let grid = |p: &[f32; 3]| [p[0], p[1], p[2] + 0.25].map(|c| (c * 60_000.0).round() as u16);
    let positions: Vec<[u16; 4]> = sheet
        .positions
        .iter()
        .map(|p| {
            let [x, y, z] = grid(p);
            [x, y, z, 0]
        })
        .collect();
    let view = model.view(bytemuck::cast_slice(&positions), Some(8));
    let accessor = json!({ "bufferView": view, "componentType": 5123, "type": "VEC3", "count": count });
    let positions = model.push("accessors", accessor);
    let normals: Vec<[i8; 4]> =
        (sheet.normals.iter()).map(|n| [n[0], n[1], n[2], 0.0].map(|c| (c * 127.0).round() as i8)).collect();
    let view = model.view(bytemuck::cast_slice(&normals), Some(4));
    let accessor =
        json!({ "bufferView": view, "componentType": 5120, "normalized": true, "type": "VEC3", "count": count });
    let normals = model.push("accessors", accessor);
    let uvs: Vec<[i16; 2]> = sheet.uvs.iter().map(|uv| uv.map(|c| (c * 4096.0).round() as i16)).collect();
    let view = model.view(bytemuck::cast_slice(&uvs), Some(4));
    let accessor = json!({ "bufferView": view, "componentType": 5122, "type": "VEC2", "count": count });
    let uvs = model.push("accessors", accessor);
    let indices = model.accessor(bytemuck::cast_slice(&sheet.indices), 5125, "SCALAR", sheet.indices.len());
    let attributes = json!({ "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs });
    let node = model.place(json!({ "attributes": attributes, "indices": indices, "material": 0 }));
    model.document["nodes"][node]["scale"] = json!([1.0 / 60_000.0, 1.0 / 60_000.0, 1.0 / 60_000.0]);
    model.document["nodes"][node]["translation"] = json!([0, 0, -0.25]);
    let picture = model.view(&png(1, 1, |_, _| [9; 4]), None);
    model.document["images"] = json!([{ "bufferView": picture, "mimeType": "image/png" }]);
    model.document["textures"] = json!([{ "source": 0 }]);
    let transform = json!({ "KHR_texture_transform": { "scale": [1.0 / 4096.0, 1.0 / 4096.0] } });
    model.document["materials"] =
        json!([{ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0, "extensions": transform } } }]);
    let document = model.gltf();
    let (asset, _) = import_json(&document).unwrap();
    assert_near(&asset.mesh, &plain, [2e-5, 1e-2, 2e-4]);

    // The same numbers in a file that does not say that it uses the extension.
    let mut silent = document;
    silent.as_object_mut().unwrap().remove("extensionsUsed");
    silent.as_object_mut().unwrap().remove("extensionsRequired");
    let paths = defect_paths(import_json(&silent));
    assert_eq!(paths.len(), 3, "{paths:?}");
    assert!(paths[0].ends_with("attributes.POSITION"), "{paths:?}");
}

#[test]
fn a_draco_primitive_comes_in_as_the_plain_sheet() {
    let sheet = sheet();
    let count = sheet.positions.len();
    let mut mesh = draco_core::Mesh::new();
    let mut attribute = |kind, lanes: usize, values: &[u8]| {
        let mut attribute = PointAttribute::new();
        attribute.init(kind, lanes as u8, DataType::Float32, false, count);
        attribute.buffer_mut().write(0, values);
        mesh.add_attribute(attribute)
    };
    attribute(GeometryAttributeType::Position, 3, bytemuck::cast_slice(&sheet.positions));
    attribute(GeometryAttributeType::Normal, 3, bytemuck::cast_slice(&sheet.normals));
    attribute(GeometryAttributeType::TexCoord, 2, bytemuck::cast_slice(&sheet.uvs));
    mesh.set_num_faces(sheet.indices.len() / 3);
    for (f, t) in sheet.indices.chunks(3).enumerate() {
        mesh.set_face(FaceIndex(f as u32), [t[0].into(), t[1].into(), t[2].into()]);
    }
    for level in [0, 5, 10] {
        let mut options = EncoderOptions::new();
        options.set_compression_level(level);
        for (attribute, bits) in [(0, 16), (1, 12), (2, 14)] {
            options.set_attribute_quantization(attribute, bits);
        }
        let mut encoder = MeshEncoder::new();
        encoder.set_mesh(mesh.clone());
        let mut encoded = EncoderBuffer::new();
        encoder.encode(&options, &mut encoded).unwrap();

        let mut model = Model::new();
        let view = model.view(encoded.data(), None);
        let mut accessor = |component: u64, shape: &str, count: usize| {
            model.push("accessors", json!({ "componentType": component, "type": shape, "count": count }))
        };
        let [position, normal, uv] =
            [accessor(5126, "VEC3", count), accessor(5126, "VEC3", count), accessor(5126, "VEC2", count)];
        let indices = accessor(5123, "SCALAR", sheet.indices.len());
        let draco = json!({ "bufferView": view, "attributes": { "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2 } });
        model.place(json!({
            "attributes": { "POSITION": position, "NORMAL": normal, "TEXCOORD_0": uv },
            "indices": indices,
            "extensions": { "KHR_draco_mesh_compression": draco }
        }));
        model.document["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
        let document = model.gltf();
        let (asset, report) = import_json(&document).unwrap();
        let plain = sheet.plain();
        assert!(by_place(&asset.mesh) == by_place(&plain), "level {level}: other triangles");
        assert!(report.repairs.is_empty(), "{:?}", report.repairs);
        // UVs are the positions' x and y, which tells whether attributes stayed together.
        for (place, normal, uv) in corners(&asset.mesh) {
            assert!(place.truncate().distance(uv) < 1e-3, "level {level}: {place} with {uv}");
            assert!(normal.z > 0.3, "level {level}: {normal}");
        }

        for (pointer, value) in [
            ("/accessors/0/count", json!(count + 1)),
            ("/accessors/3/count", json!(sheet.indices.len() - 3)),
            ("/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression/attributes/NORMAL", json!(2)),
            ("/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression/attributes/NORMAL", json!(99)),
            ("/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression/bufferView", json!(9)),
            ("/bufferViews/0/byteLength", json!(60)),
        ] {
            let mut wrong = document.clone();
            hostile::edit(&mut wrong, pointer, Some(value));
            let paths = defect_paths(import_json(&wrong));
            assert!(paths[0].starts_with("meshes[0].primitives[0]"), "{pointer}: {paths:?}");
        }
    }
}

/// The UVs of [`square`]'s four vertices with the given material, where `TEXCOORD_n` is `n + position`.
fn uvs_of(material: Value) -> Result<[Option<Vec<Vec2>>; 2], ImportError> {
    let mut model = square();
    for set in 0..4 {
        let uvs: Vec<f32> = CORNERS.chunks(3).flat_map(|c| [c[0] + set as f32, c[1]]).collect();
        let index = model.accessor(&floats(&uvs), 5126, "VEC2", 4);
        model.document["meshes"][0]["primitives"][0]["attributes"][format!("TEXCOORD_{set}")] = json!(index);
    }
    model.document["meshes"][0]["primitives"][0]["material"] = json!(0);
    let view = model.view(&png(1, 1, |_, _| [9; 4]), None);
    model.document["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
    model.document["textures"] = json!([{ "source": 0 }]);
    model.document["materials"] = json!([material]);
    let (asset, _) = import_json(&model.gltf())?;
    let raw = asset.mesh.into_raw();
    Ok([raw.uv0, raw.uv1])
}

fn transformed(transform: Value) -> Value {
    json!({ "index": 0, "extensions": { "KHR_texture_transform": transform } })
}

#[test]
fn uvs_are_scaled_then_turned_then_moved() {
    let quarter = std::f64::consts::FRAC_PI_2;
    let texture = transformed(json!({ "offset": [0.5, 0.25], "rotation": quarter, "scale": [2, 3] }));
    let [uv0, _] = uvs_of(json!({ "pbrMetallicRoughness": { "baseColorTexture": texture } })).unwrap();
    // Counter-clockwise where V points down: (1, 0) goes to (0, -1), (0, 1) to (1, 0).
    let expected = [[0.5, 0.25], [0.5, -1.75], [3.5, -1.75], [3.5, 0.25]].map(Vec2::from_array);
    for (found, expected) in uv0.unwrap().iter().zip(expected) {
        assert!(found.distance(expected) < 1e-6, "{found} for {expected}");
    }
}

#[test]
fn two_different_uvs_fit_one_material_and_three_do_not() {
    let first = |uvs: &Option<Vec<Vec2>>| uvs.as_ref().unwrap()[0];
    // A further set, and one that the transform names instead.
    let [uv0, uv1] = uvs_of(json!({
        "normalTexture": { "index": 0, "texCoord": 3 },
        "emissiveTexture": transformed(json!({ "texCoord": 2, "offset": [0, 9] }))
    }))
    .unwrap();
    assert_eq!((first(&uv0), first(&uv1)), (Vec2::new(3.0, 0.0), Vec2::new(2.0, 9.0)));
    // What is plain keeps its number where it can.
    let [uv0, uv1] = uvs_of(json!({
        "normalTexture": transformed(json!({ "offset": [0, 9] })),
        "emissiveTexture": { "index": 0 }
    }))
    .unwrap();
    assert_eq!((first(&uv0), first(&uv1)), (Vec2::ZERO, Vec2::new(0.0, 9.0)));
    let error = uvs_of(json!({
        "normalTexture": { "index": 0 },
        "emissiveTexture": { "index": 0, "texCoord": 1 },
        "occlusionTexture": { "index": 0, "texCoord": 2 }
    }))
    .unwrap_err();
    assert!(matches!(error, ImportError::Unsupported(_)), "{error}");
    assert_eq!(error.defects()[0].path, "materials[0]");
}

/// A KTX2 file of one 4 x 4 block of UASTC in one colour (mode 8).
fn ktx2(color: [u8; 4]) -> Vec<u8> {
    let mut out = b"\xABKTX 20\xBB\r\n\x1A\n".to_vec();
    for word in [0u32, 1, 4, 4, 0, 0, 1, 1, 0, 104, 44, 0, 0] {
        out.extend(word.to_le_bytes());
    }
    for long in [0u64, 0, 148, 16, 16] {
        out.extend(long.to_le_bytes());
    }
    // Data format descriptor: UASTC, sRGB, blocks of 4 x 4 in 16 bytes, one sample of RGBA.
    for word in [44u32, 0, 2 | 40 << 16, 166 | 1 << 8 | 2 << 16, 3 | 3 << 8, 16, 0, 127 << 16 | 3 << 24, 0, 0, u32::MAX]
    {
        out.extend(word.to_le_bytes());
    }
    assert_eq!(out.len(), 148);
    let block = color.iter().rev().fold(0u128, |bits, c| bits << 8 | *c as u128) << 5 | 0x17;
    out.extend(block.to_le_bytes());
    out
}

#[test]
fn webp_and_basis_textures_are_decoded() {
    let limits = ImageLimits::default();
    let color = [200, 100, 50, 255];
    let raster = decode_image(ImageFormat::Ktx2, &ktx2(color), &limits).unwrap();
    assert_eq!((raster.width, raster.height), (4, 4));
    assert!(raster.texels.iter().all(|t| *t == color), "{:?}", raster.texels[0]);
    let picture = ::image::RgbaImage::from_fn(5, 3, |x, y| ::image::Rgba([x as u8 * 40, y as u8 * 60, 7, 200]));
    let mut webp = io::Cursor::new(Vec::new());
    picture.write_to(&mut webp, ::image::ImageFormat::WebP).unwrap();
    let webp = webp.into_inner();
    assert_eq!((image_format(&webp), image_size(ImageFormat::Webp, &webp)), (Some(ImageFormat::Webp), Some((5, 3))));
    let raster = decode_image(ImageFormat::Webp, &webp, &limits).unwrap();
    assert_eq!(raster.texels[6], [40, 60, 7, 200]);

    for (name, mime, bytes, format) in [
        ("EXT_texture_webp", "image/webp", webp.clone(), ImageFormat::Webp),
        ("KHR_texture_basisu", "image/ktx2", ktx2(color), ImageFormat::Ktx2),
    ] {
        let mut model = with_attribute("TEXCOORD_0", &floats(&[0.0; 8]), 5126, "VEC2", false);
        let views = [bytes, png(2, 2, |_, _| [1; 4])].map(|bytes| model.view(&bytes, None));
        model.document["meshes"][0]["primitives"][0]["material"] = json!(0);
        model.document["images"] = json!([
            { "bufferView": views[0], "mimeType": mime }, { "bufferView": views[1], "mimeType": "image/png" }
        ]);
        model.document["extensionsRequired"] = json!([name]);
        model.document["textures"] = json!([{ "extensions": { name: { "source": 0 } } }]);
        model.document["materials"] = json!([{ "emissiveTexture": { "index": 0 } }]);
        let mut both = Model { document: model.document.clone(), bytes: model.bytes.clone() };
        let (asset, report) = import_json(&model.gltf()).unwrap();
        assert_eq!(asset.materials.images[0].format, format);
        assert_eq!(report.images[0].format, format.name());
        assert!(report.not_carried.is_empty(), "{:?}", report.not_carried);
        // A plain source beside it comes first.
        both.document["textures"][0]["source"] = json!(1);
        let (asset, _) = import_json(&both.gltf()).unwrap();
        assert_eq!(asset.materials.images[0].format, ImageFormat::Png);
    }
}

#[test]
fn cut_and_oversized_webp_and_basis_headers_are_refused() {
    let limits = ImageLimits::default();
    let mut wide = ktx2([1, 2, 3, 4]);
    wide[20..24].copy_from_slice(&200_000u32.to_le_bytes());
    let error = decode_image(ImageFormat::Ktx2, &wide, &limits).unwrap_err();
    assert!(error.to_string().contains("200000 x 4"), "{error}");
    let whole = ktx2([1, 2, 3, 4]);
    for end in 0..whole.len() {
        assert!(decode_image(ImageFormat::Ktx2, &whole[..end], &limits).is_err(), "{end} bytes were taken");
    }
    let mut state = 1u32;
    for _ in 0..2000 {
        let mut broken = whole.clone();
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let at = (state >> 8) as usize % broken.len();
        broken[at] = state as u8;
        let _ = decode_image(ImageFormat::Ktx2, &broken, &limits);
    }
}

#[test]
fn emissive_strength_and_specular_glossiness_reach_the_material() {
    let mut model = square();
    model.document["meshes"][0]["primitives"][0]["material"] = json!(0);
    model.document["materials"] = json!([
        {
            "emissiveFactor": [1, 0.5, 0],
            "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 4 } }
        },
        {
            "extensions": { "KHR_materials_pbrSpecularGlossiness": {
                "diffuseFactor": [0.1, 0.2, 0.3, 0.4], "glossinessFactor": 0.75, "specularGlossinessTexture": { "index": 0 }
            } }
        }
    ]);
    let (asset, report) = import_json(&model.gltf()).unwrap();
    assert_eq!(asset.materials.materials[0].emissive_factor, [4.0, 2.0, 0.0]);
    let old = &asset.materials.materials[1];
    assert_eq!((old.base_color_factor, old.metallic_factor, old.roughness_factor), ([0.1, 0.2, 0.3, 0.4], 0.0, 0.25));
    assert!(report.not_carried.iter().any(|n| n.what == "specular-glossiness textures"), "{:?}", report.not_carried);
}

/// [`square`] placed three times by one node: moved, turned by a quarter about Z, mirrored.
fn instanced() -> Model {
    let mut model = square();
    let translations = model.accessor(&floats(&[0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]), 5126, "VEC3", 3);
    let half = (32_767.0 * std::f64::consts::FRAC_1_SQRT_2) as i16;
    let turns: Vec<u8> =
        [0, 0, 0, 32_767, 0, 0, half, half, 0, 0, 0, 32_767].iter().flat_map(|c: &i16| c.to_le_bytes()).collect();
    let rotations = model.accessor(&turns, 5122, "VEC4", 3);
    model.document["accessors"][rotations]["normalized"] = json!(true);
    let scales = model.accessor(&floats(&[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -1.0, 1.0, 1.0]), 5126, "VEC3", 3);
    let attributes = json!({ "TRANSLATION": translations, "ROTATION": rotations, "SCALE": scales, "_TINT": scales });
    model.document["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    model.document["nodes"][0]["translation"] = json!([10, 0, 0]);
    model.document["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    model
}

#[test]
fn instances_of_one_node_are_submeshes_in_place() {
    let (asset, report) = import_json(&instanced().gltf()).unwrap();
    let corner = |submesh: usize| asset.mesh.positions[4 * submesh + 1];
    assert_eq!(asset.mesh.submeshes.len(), 3);
    assert_eq!(corner(0), Vec3::new(11.0, 0.0, 5.0));
    assert!(corner(1).distance(Vec3::new(10.0, 1.0, 0.0)) < 1e-4, "{}", corner(1));
    assert_eq!(corner(2), Vec3::new(9.0, 0.0, 0.0));
    assert!((0..6).all(|face| face_normal(&asset.mesh, face).z > 0.0), "a mirror keeps its winding outward");
    assert_eq!((report.instances, report.mirrored_instances), (3, 1));
    assert_eq!(report.not_carried, [NotCarried { what: "instance attribute _TINT".into(), count: 1 }]);
}

#[test]
fn broken_instances_are_named() {
    let whole = instanced().gltf();
    let at = "nodes[0].extensions.EXT_mesh_gpu_instancing.attributes";
    let base = "/nodes/0/extensions/EXT_mesh_gpu_instancing/attributes";
    for (key, value, path) in [
        ("/ROTATION", json!(99), format!("{at}.ROTATION")),
        ("/ROTATION", json!(0), format!("{at}.ROTATION")),
        ("/TRANSLATION", json!(0), format!("{at}.ROTATION")),
        ("", json!({}), at.to_owned()),
    ] {
        let mut wrong = whole.clone();
        hostile::edit(&mut wrong, &format!("{base}{key}"), Some(value));
        assert_eq!(defect_paths(import_json(&wrong)), [path], "{key}");
    }
}
