//! OBJ and MTL: planted models, a sphere by three doors, malformed and hostile texts.

use proptest::prelude::*;

use super::*;

/// The model of several files; the first is the model itself.
fn import_files(files: &[(&str, &[u8])]) -> Outcome {
    let memory = Memory(files.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect());
    import(&memory, files[0].0, &ImportLimits::default())
}

fn import_obj(text: &str) -> Outcome {
    import_files(&[("model.obj", text.as_bytes())])
}

fn import_mtl(obj: &str, mtl: &str) -> Outcome {
    import_files(&[("model.obj", obj.as_bytes()), ("model.mtl", mtl.as_bytes())])
}

fn not_carried(report: &ImportReport, what: &str) -> u64 {
    report.not_carried.iter().find(|n| n.what == what).map_or(0, |n| n.count)
}

const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";

/// A sphere as every format may have it: positions by point, normals and UVs by vertex, a seam where U is 0 and 1.
pub(super) struct Sphere {
    pub(super) positions: Vec<Vec3>,
    pub(super) uvs: Vec<Vec2>,
    pub(super) triangles: Vec<[u32; 3]>,
}

pub(super) fn sphere(rings: u32) -> Sphere {
    let around = 2 * rings;
    let mut out = Sphere { positions: Vec::new(), uvs: Vec::new(), triangles: Vec::new() };
    for ring in 0..=rings {
        for step in 0..=around {
            let (u, v) = (f64::from(step) / f64::from(around), f64::from(ring) / f64::from(rings));
            // The seam's two sides lie at one place.
            let (turn, tilt) =
                (std::f64::consts::TAU * f64::from(step % around) / f64::from(around), std::f64::consts::PI * v);
            let place = [libm::sin(tilt) * libm::sin(turn), libm::cos(tilt), libm::sin(tilt) * libm::cos(turn)];
            out.positions.push(Vec3::from_array(place.map(|c| c as f32)));
            out.uvs.push(Vec2::new(u as f32, v as f32));
        }
    }
    for ring in 0..rings {
        for step in 0..around {
            let a = ring * (around + 1) + step;
            let b = a + around + 1;
            out.triangles.extend([[a, b, b + 1], [a, b + 1, a + 1]]);
        }
    }
    out
}

impl Sphere {
    pub(super) fn glb(&self) -> Vec<u8> {
        let mut model = Model::new();
        let spread = |list: &[Vec3]| floats(&list.iter().flat_map(|v| v.to_array()).collect::<Vec<_>>());
        let count = self.positions.len();
        let positions = model.accessor(&spread(&self.positions), 5126, "VEC3", count);
        let normals = model.accessor(&spread(&self.positions), 5126, "VEC3", count);
        let uvs: Vec<f32> = self.uvs.iter().flat_map(|v| v.to_array()).collect();
        let uvs = model.accessor(&floats(&uvs), 5126, "VEC2", count);
        let indices: Vec<u8> = self.triangles.as_flattened().iter().flat_map(|i| i.to_le_bytes()).collect();
        let indices = model.accessor(&indices, 5125, "SCALAR", 3 * self.triangles.len());
        model.place(json!({
            "attributes": { "POSITION": positions, "NORMAL": normals, "TEXCOORD_0": uvs }, "indices": indices
        }));
        model.glb()
    }

    fn obj(&self) -> String {
        let mut text = String::from("# a sphere\n");
        for [x, y, z] in self.positions.iter().map(|p| p.to_array()) {
            text += &format!("v {x} {y} {z}\nvn {x} {y} {z}\n");
        }
        self.uvs.iter().for_each(|uv| text += &format!("vt {} {}\n", uv.x, 1.0 - uv.y));
        for [a, b, c] in self.triangles.iter().map(|t| t.map(|v| v + 1)) {
            text += &format!("f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}\n");
        }
        text
    }
}

/// Both meshes have the same corners in the same order: positions and normals in every bit, UVs within 1e-6.
pub(super) fn assert_same_surface(a: &Mesh, b: &Mesh) {
    assert_eq!(
        (a.face_count(), a.vertex_count(), a.point_count()),
        (b.face_count(), b.vertex_count(), b.point_count())
    );
    let bits = |v: Vec3| v.to_array().map(f32::to_bits);
    for (f, (s, t)) in a.triangles.iter().zip(&b.triangles).enumerate() {
        for (v, w) in s.iter().zip(t).map(|(v, w)| (*v as usize, *w as usize)) {
            assert_eq!(bits(a.positions[v]), bits(b.positions[w]), "position of face {f}");
            assert_eq!(
                a.normals.as_ref().map(|n| bits(n[v])),
                b.normals.as_ref().map(|n| bits(n[w])),
                "normal of face {f}"
            );
            let apart = a.uv0.as_ref().unwrap()[v].distance(b.uv0.as_ref().unwrap()[w]);
            assert!(apart < 1e-6, "UV of face {f}: {apart} apart");
        }
    }
}

// Planted answers.

#[test]
fn a_sphere_comes_in_as_from_gltf() {
    let sphere = sphere(24);
    let (expected, _) = import_bytes("model.glb", sphere.glb()).unwrap();
    let (found, report) = import_obj(&sphere.obj()).unwrap();
    assert_same_surface(&found.mesh, &expected.mesh);
    assert_eq!(found.mesh.submeshes, expected.mesh.submeshes);
    assert_eq!((report.format, report.generator.as_str()), (ModelFormat::Obj, "a sphere"));
    assert_eq!(report.repairs, []);
}

#[test]
fn every_spelling_of_a_corner_is_read() {
    let pools = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.25 0.25\nvt 1 0\nvt 0 1 7\nvn 0 0 1\n";
    for (corners, uvs, normals) in [
        ("1 2 3", false, false),
        ("1/1 2/2 3/3", true, false),
        ("1//1 2//1 3//-1", false, true),
        ("-3/-3/-1 -2/2/1 3/-1/+1", true, true),
        ("1/ 2// 3", false, false),
        ("1/1/1 2/2/1 \\\n 3/3/1 # the last one", true, true),
    ] {
        let (asset, _) = import_obj(&format!("{pools}f {corners}\n")).unwrap();
        let mesh = asset.mesh;
        assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X, Vec3::Y], "{corners}");
        assert_eq!(mesh.triangles, [[0, 1, 2]]);
        let uv0 = uvs.then(|| vec![Vec2::new(0.25, 0.75), Vec2::new(1.0, 1.0), Vec2::new(0.0, 0.0)]);
        assert_eq!((mesh.uv0.clone(), mesh.normals.clone()), (uv0, normals.then(|| vec![Vec3::Z; 3])), "{corners}");
    }
}

#[test]
fn the_same_text_with_other_line_ends_is_the_same_model() {
    let text = format!("\u{feff}# x\n{TRIANGLE}usemtl a\nf 1 2 3\n");
    let (expected, _) = import_obj(&text).unwrap();
    for end in ["\r\n", "\r"] {
        assert_eq!(import_obj(&text.replace('\n', end)).unwrap().0, expected, "{end:?}");
    }
}

#[test]
fn negative_indices_count_from_where_they_stand_and_positive_ones_may_point_ahead() {
    let (asset, report) = import_obj("f 1 2 3\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\n").unwrap();
    assert_eq!(asset.mesh.triangles, [[0, 1, 2], [0, 1, 2]]);
    assert_eq!(repair_count(&report, RepairKind::VerticesUnused), 1);
}

#[test]
fn submeshes_follow_objects_groups_and_materials() {
    let face = "f 1 2 3\n";
    let text = format!(
        "{TRIANGLE}{face}o Pot\nusemtl clay\n{face}usemtl glaze\n{face}usemtl clay\n{face}g handle\n{face}g\n\
         usemtl\n{face}o Lid\n{face}o Empty\ng Group\n{face}o Pot\nusemtl glaze\n{face}"
    );
    let (asset, report) = import_obj(&text).unwrap();
    let list: Vec<(&str, Option<u32>, u32)> =
        asset.mesh.submeshes.iter().map(|s| (s.name.as_str(), s.material.map(|m| m.0), s.source_triangles)).collect();
    assert_eq!(
        list,
        [
            ("mesh0", None, 1),
            ("Pot/clay", Some(0), 2),
            ("Pot/glaze", Some(1), 2),
            ("Pot/handle", Some(0), 1),
            ("Pot/4", None, 1),
            ("Lid", None, 1),
            ("Empty/Group", None, 1),
        ]
    );
    assert_eq!((report.meshes, report.primitives, report.materials), (5, 7, 2));
    assert_eq!(repair_count(&report, RepairKind::MaterialUndefined), 2);
}

#[test]
fn attributes_of_some_submeshes_are_neutral_on_the_others() {
    let text = format!(
        "{TRIANGLE}vt 0.5 0.5\nvn 0 2 0\no a\nf 1 2 3\no b\nf 1/1 2/1 3/1\no c\nf 1//1 2//1 3//1\no d\nf 1/1 2 3/1\n"
    );
    let (asset, report) = import_obj(&text).unwrap();
    let mesh = asset.mesh;
    let has: Vec<(bool, bool)> = mesh.submeshes.iter().map(|s| (s.attributes.uv0, s.attributes.normals)).collect();
    assert_eq!(has, [(false, false), (true, false), (false, true), (true, false)]);
    assert_eq!(mesh.normals.as_ref().unwrap()[..3], [Vec3::Z; 3]);
    assert_eq!(mesh.normals.as_ref().unwrap()[6..9], [Vec3::Y; 3]);
    assert_eq!(mesh.uv0.as_ref().unwrap()[9..], [Vec2::splat(0.5), Vec2::ZERO, Vec2::splat(0.5)]);
    assert_eq!(repair_count(&report, RepairKind::CornerUvAbsent), 1);
    assert_eq!(repair_count(&report, RepairKind::NormalScaled), 3);
}

#[test]
fn colours_are_srgb_and_weights_have_no_influence() {
    let text = "v 0 0 0 1 0 0\nv 1 0 0 0.5\nv 0 1 0 0.5 0.5 2 0.25\nf 1 2 3\n";
    let (asset, report) = import_obj(text).unwrap();
    let colors = asset.mesh.colors.as_ref().unwrap();
    assert_eq!(colors[..2], [Vec4::new(1.0, 0.0, 0.0, 1.0), Vec4::ONE]);
    // ((0.5 + 0.055) / 1.055)^2.4
    assert!((colors[2] - Vec4::new(0.214_041_14, 0.214_041_14, 1.0, 0.25)).length() < 1e-7, "{}", colors[2]);
    assert_eq!(repair_count(&report, RepairKind::ColorClamped), 1);
    assert_eq!(asset.mesh.positions[1], Vec3::X);
}

#[test]
fn polygons_are_cut_and_crossed_ones_told() {
    let (asset, report) = import_obj("v 0 0 0\nv 2 0 0\nv 0.25 0.25 0\nv 0 2 0\nf 2 3 4 1\nf 4 1 2 3\n").unwrap();
    assert_eq!(report.triangles, 4);
    (0..4).for_each(|f| assert!(face_normal(&asset.mesh, f).z > 0.0, "triangle {f} turns over"));
    assert_eq!(report.repairs, []);
    let (_, report) = import_obj("v 0 0 0\nv 3 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3 4\n").unwrap();
    assert_eq!(repair_count(&report, RepairKind::PolygonCrossed), 1);
    assert_eq!(report.repairs[0].first, "line 5");
}

#[test]
fn what_is_not_carried_is_counted_by_name() {
    let text = format!("{TRIANGLE}s 1\nl 1 2\np 1\np 2\ncurv 0 1\nfrobnicate\nf 1 2 3\n");
    let (_, report) = import_obj(&text).unwrap();
    for (what, count) in
        [("lines", 1), ("points", 2), ("statements of free-form geometry", 1), ("statement `frobnicate`", 1)]
    {
        assert_eq!(not_carried(&report, what), count, "{what}");
    }
    let many: String = (0..1000).map(|k| format!("x{k}\n")).collect();
    let (_, report) = import_obj(&format!("{TRIANGLE}f 1 2 3\n{many}")).unwrap();
    assert_eq!((report.not_carried.len(), not_carried(&report, "other statements")), (33, 968));
}

// Materials.

const TEXTURED: &str = "mtllib model.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n";

#[test]
fn a_material_is_read_with_its_pictures() {
    let red = png(2, 2, |_, _| [255, 0, 0, 255]);
    let bump = png(4, 2, |_, _| [128, 128, 255, 255]);
    let mtl = "newmtl unused\nKd 1 1 1\nnewmtl a\nKd 0.5 0.25 1\nKe 0.1\nNs 30\nd 0.75\nPm 0.5\nillum 2\nKs 1 1 1\n\
               map_Kd -clamp on -bm 1 -s 1 1 1 textures\\a b.png\nnorm -bm 0.5 ./bump.png\nmap_bump height.png\n\
               map_Ke gone.png\n";
    let files: [(&str, &[u8]); 4] = [
        ("model.obj", TEXTURED.as_bytes()),
        ("model.mtl", mtl.as_bytes()),
        ("textures/a b.png", &red),
        ("bump.png", &bump),
    ];
    let (asset, report) = import_files(&files).unwrap();
    let [material] = &asset.materials.materials[..] else { panic!("{:?}", asset.materials.materials) };
    assert_eq!(material.name, "a");
    assert_eq!(material.base_color_factor, [0.5, 0.25, 1.0, 0.75]);
    assert_eq!((material.emissive_factor, material.emissive), ([0.1; 3], None));
    assert_eq!((material.roughness_factor, material.metallic_factor), (0.5, 0.5));
    assert_eq!((material.alpha_mode, material.normal_scale), (AlphaMode::Blend, 0.5));
    let texture = |map: Option<crate::material::TextureRef>| &asset.materials.textures[map.unwrap().texture.index()];
    assert_eq!(texture(material.base_color).sampler.wrap_u, Wrap::ClampToEdge);
    assert_eq!(texture(material.normal).sampler.wrap_v, Wrap::Repeat);
    assert_eq!(asset.images[texture(material.base_color).image.index()][..], red[..]);
    let images: Vec<(&str, u32, u32)> = report.images.iter().map(|i| (i.name.as_str(), i.width, i.height)).collect();
    assert_eq!(images, [("a b", 2, 2), ("bump", 4, 2)]);
    assert_eq!(repair_count(&report, RepairKind::BackslashPath), 1);
    assert_eq!(repair_count(&report, RepairKind::ImageMissing), 1);
    for what in ["materials that no polygon uses", "MTL statement `map_bump`", "MTL statement `Ks`"] {
        assert_eq!(not_carried(&report, what), 1, "{what}");
    }
}

#[test]
fn a_picture_of_alpha_blends_and_one_of_emission_shines() {
    let picture = png(1, 1, |_, _| [1, 2, 3, 4]);
    let mtl = "newmtl a\nTr 0\nPr 2\nmap_Kd p.png\nmap_d p.png\nmap_Ke p.png\n";
    let files: [(&str, &[u8]); 3] =
        [("model.obj", TEXTURED.as_bytes()), ("model.mtl", mtl.as_bytes()), ("p.png", &picture)];
    let (asset, report) = import_files(&files).unwrap();
    let material = &asset.materials.materials[0];
    assert_eq!((material.alpha_mode, material.emissive_factor), (AlphaMode::Blend, [1.0; 3]));
    assert_eq!((material.roughness_factor, material.base_color), (1.0, material.emissive));
    assert_eq!(repair_count(&report, RepairKind::FactorClamped), 1);
    assert_eq!(asset.images.len(), 1);
}

#[test]
fn libraries_are_found_with_spaces_in_folders_and_in_order() {
    let obj = "mtllib my lib.mtl\nmtllib sub\\one.mtl gone.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 2 3\n";
    let picture = png(1, 1, |_, _| [1, 2, 3, 255]);
    let files: [(&str, &[u8]); 4] = [
        ("model.obj", obj.as_bytes()),
        ("my lib.mtl", b"newmtl a\nKd 0.25\n"),
        ("sub/one.mtl", b"newmtl a\nKd 1 1 1\nnewmtl b\nmap_Kd ../p.png\n"),
        ("p.png", &picture),
    ];
    let (asset, report) = import_files(&files).unwrap();
    assert_eq!(asset.materials.materials[0].base_color_factor, [0.25, 0.25, 0.25, 1.0]);
    assert!(asset.materials.materials[1].base_color.is_some());
    assert_eq!(repair_count(&report, RepairKind::LibraryMissing), 1);
    assert_eq!(not_carried(&report, "materials defined again"), 1);
}

#[test]
fn broken_libraries_are_refused_with_their_line() {
    let cases: [(&str, &str); 10] = [
        ("newmtl a\nKd 1 2", "model.mtl:2"),
        ("newmtl a\nKd x", "model.mtl:2"),
        ("newmtl a\nKd", "model.mtl:2"),
        ("newmtl a\n\nd nan", "model.mtl:3"),
        ("newmtl a\nmap_Kd ../secret.png", "model.mtl:2"),
        ("newmtl a\nmap_Kd C:\\secret.png", "model.mtl:2"),
        ("newmtl a\nmap_Kd /etc/passwd", "model.mtl:2"),
        ("newmtl a\nmap_Kd -clamp on", "model.mtl:2"),
        ("newmtl a\nmap_Kd -s 2 2 1 p.png", "model.mtl:2"),
        ("newmtl a\nmap_Kd model.mtl", "model.mtl:2"),
    ];
    for (mtl, path) in cases {
        assert_eq!(defect_paths(import_mtl(TEXTURED, mtl)), [path], "{mtl:?}");
    }
    assert_eq!(defect_paths(import_obj("mtllib ../a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")), ["model.obj:1"]);
}

// Malformed and hostile.

#[test]
fn every_malformed_line_is_named() {
    let cases: Vec<(String, &[&str])> = vec![
        ("f 0 1 2\n".into(), &["model.obj:4"]),
        ("f 1 2\n".into(), &["model.obj:4"]),
        ("f\n".into(), &["model.obj:4"]),
        ("f 1 2 4\n".into(), &["model.obj:4"]),
        ("f 1 2 -4\n".into(), &["model.obj:4"]),
        ("f 1 2 3/1\n".into(), &["model.obj:4"]),
        ("f 1 2 3//1\n".into(), &["model.obj:4"]),
        ("f 1 2 3/0\n".into(), &["model.obj:4"]),
        ("f 1 2 /1\n".into(), &["model.obj:4"]),
        ("f 1 2 3/1/1/1\n".into(), &["model.obj:4"]),
        ("f 1 2 x\n".into(), &["model.obj:4"]),
        ("f 1 2 1.5\n".into(), &["model.obj:4"]),
        ("f 1 2 4294967296\n".into(), &["model.obj:4"]),
        ("f 1 2 99999999999999999999\n".into(), &["model.obj:4"]),
        ("f 1 2 -9223372036854775808\n".into(), &["model.obj:4"]),
        ("v 1 2\n".into(), &["model.obj:4"]),
        ("v 1 2 x\n".into(), &["model.obj:4"]),
        ("v 1 2 nan\n".into(), &["model.obj:4"]),
        ("v 1e99 0 0\n".into(), &["model.obj:4"]),
        ("v 1 2 3 4 5\n".into(), &["model.obj:4"]),
        ("v 1 2 3 4 5 6 7 8 9\n".into(), &["model.obj:4"]),
        ("vt\n".into(), &["model.obj:4"]),
        ("vn 1 2\n".into(), &["model.obj:4"]),
        ("vn 1 2 3 4\n".into(), &["model.obj:4"]),
        ("mtllib\nf 1 2 3\n".into(), &["model.obj:4"]),
        ("f 1 2 3\nf 9 9 9\n\nv x y z\n".into(), &["model.obj:7", "model.obj:5", "model.obj:5", "model.obj:5"]),
        (String::new(), &["model.obj"]),
    ];
    for (text, paths) in cases {
        assert_eq!(defect_paths(import_obj(&format!("{TRIANGLE}{text}"))), paths, "{text:?}");
    }
}

#[test]
fn soft_trouble_is_repaired_and_reported() {
    let text = format!("{TRIANGLE}vt nan 0\nvn -nan(ind) 0 0\nvn 0 0 0\nf 1/1/1 2/1/2 3/1/1\n");
    let (asset, report) = import_obj(&text).unwrap();
    assert_eq!(asset.mesh.normals.as_ref().unwrap()[..], [Vec3::Z; 3]);
    assert_eq!(asset.mesh.uv0.as_ref().unwrap()[..], [Vec2::ZERO; 3]);
    assert_eq!(repair_count(&report, RepairKind::NormalRebuilt), 3);
    assert_eq!(repair_count(&report, RepairKind::UvNotFinite), 3);
}

#[test]
fn limits_hold() {
    let text = format!("{TRIANGLE}o a\nf 1 2 3\no b\nf 1 2 3\n");
    let import = |limits: ImportLimits| {
        let memory = Memory(BTreeMap::from([("model.obj".to_owned(), text.clone().into_bytes())]));
        import(&memory, "model.obj", &limits)
    };
    let limits = ImportLimits { max_vertices: 6, max_triangles: 2, max_submeshes: 2, ..Default::default() };
    assert!(import(limits).is_ok());
    for less in [
        ImportLimits { max_vertices: 5, ..limits },
        ImportLimits { max_triangles: 1, ..limits },
        ImportLimits { max_submeshes: 1, ..limits },
        ImportLimits { max_file_bytes: text.len() as u64 - 1, ..limits },
    ] {
        assert_eq!(defect_paths(import(less)), ["model.obj"], "{less:?}");
    }
}

#[test]
fn a_hundred_thousand_corners_are_cut_if_convex_and_refused_if_not() {
    let count = 100_000;
    let mut text = String::new();
    for k in 0..count {
        let angle = std::f64::consts::TAU * f64::from(k) / f64::from(count);
        text += &format!("v {} {} 0\n", libm::cos(angle), libm::sin(angle));
    }
    let face = |list: &mut dyn Iterator<Item = u32>| list.map(|k| format!(" {}", k + 1)).collect::<String>();
    let convex = format!("{text}f{}\n", face(&mut (0..count)));
    let (_, report) = import_obj(&convex).unwrap();
    assert_eq!(report.triangles, u64::from(count) - 2);
    // Every other corner at two places in turn.
    let ragged =
        format!("{text}f{}\n", face(&mut (0..count).map(|k| if k % 2 == 0 { k } else { (k + count / 2) % count })));
    let error = import_obj(&ragged).expect_err("is not convex");
    assert!(matches!(error, ImportError::Unsupported(_)), "{error}");
    assert_eq!(error.defects()[0].path, "model.obj:100001");
}

#[test]
fn many_switches_of_material_do_not_cost_their_square() {
    let mut text = TRIANGLE.to_owned();
    (0..100_000).for_each(|k| text += &format!("usemtl m{}\nf 1 2 3\n", k % 5000));
    let (asset, _) = import_obj(&text).unwrap();
    assert_eq!(asset.mesh.submeshes.len(), 5000);
    assert!(asset.mesh.submeshes.iter().all(|s| s.source_triangles == 20));
}

#[test]
fn the_worst_polygons_cost_bounded_time() {
    let mut text = String::new();
    for k in 0..256u32 {
        let angle = f64::from(k * 97 % 256) * 0.7;
        text += &format!("v {} {} 0\n", angle * libm::cos(angle), angle * libm::sin(angle));
    }
    let polygon: String = (1..=256).map(|k| format!(" {k}")).collect();
    (0..250).for_each(|_| text += &format!("f{polygon}\n"));
    let before = Instant::now();
    let (_, report) = import_obj(&text).unwrap();
    let took = before.elapsed();
    eprintln!("250 crossed polygons of 256 corners, {} bytes, in {took:?}", text.len());
    assert_eq!((report.triangles, repair_count(&report, RepairKind::PolygonCrossed)), (250 * 254, 250));
    assert!(took.as_secs() < 5, "{took:?}");
}

const SMALL: &str = "# small\nmtllib model.mtl\no a\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 1\nvn 0 0 1\ns off\n\
                     usemtl m\nf 1/1/1 2/1/1 3/1/-1 \\\n -1/1/1\nl 1 2\n";
const SMALL_MTL: &str = "newmtl m\nKd 0.5 0.5 1\nNs 10\nd 0.5\nmap_Kd -s 1 1 -clamp on t.png\n";

/// Neither a panic nor an error without a place.
pub(super) fn check_outcome(outcome: Outcome, case: impl std::fmt::Debug) {
    match outcome {
        Ok((asset, _)) => assert!(asset.mesh.face_count() > 0),
        Err(error) => {
            assert!(
                !error.defects().is_empty() && error.defects().iter().all(|d| !d.path.is_empty()),
                "{case:?}: {error}"
            );
        }
    }
}

#[test]
fn every_prefix_and_every_changed_byte_is_taken_or_refused_with_a_place() {
    let picture = png(1, 1, |_, _| [1, 2, 3, 255]);
    let run = |obj: &[u8], mtl: &[u8], case: (usize, u8)| {
        check_outcome(import_files(&[("model.obj", obj), ("model.mtl", mtl), ("t.png", &picture)]), case);
    };
    assert!(
        import_files(&[("m.obj", SMALL.as_bytes()), ("model.mtl", SMALL_MTL.as_bytes()), ("t.png", &picture)]).is_ok()
    );
    let (obj, mtl) = (SMALL.as_bytes(), SMALL_MTL.as_bytes());
    for end in 0..obj.len().max(mtl.len()) {
        run(&obj[..end.min(obj.len())], mtl, (end, 0));
        run(obj, &mtl[..end.min(mtl.len())], (end, 1));
    }
    for at in 0..obj.len().max(mtl.len()) {
        for byte in [0, b'\n', b'\r', b' ', b'-', b'/', b'0', b'9', b'#', b'\\', b'e', 0x80, 0xFF] {
            let put = |text: &[u8]| {
                let mut changed = text.to_vec();
                changed[at % text.len()] = byte;
                changed
            };
            run(&put(obj), mtl, (at, byte));
            run(obj, &put(mtl), (at, byte));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_soup_of_words_panics(
        words in prop::collection::vec(
            prop::sample::select(vec![
                "v", "vt", "vn", "f", "o", "g", "usemtl", "mtllib", "newmtl", "Kd", "map_Kd", "-s", "-clamp", "norm", "l", "p",
                "\n", "\n", "\n", "\n", "\r", "\\\n", "#", "1", "2", "3", "-1", "0", "1/2/3", "1//1", "/", "-9", "1e30", "-1e30",
                "nan", "inf", "0.5", "model.mtl", "x.png", "..\\y", "\"", "\u{e4}", "4294967296", "-9223372036854775808",
            ]),
            0..200,
        ),
        tail in prop::collection::vec(prop::sample::select(vec!["1", "2", "3", "-1", "-2"]), 0..12),
    ) {
        let text = words.join(" ");
        let obj = format!("v 0 0 0\nv 1 0 0\nv 0 1e-3 0\nvt 0 0\nvn 0 1 0\nmtllib model.mtl\n{text}\nf {}\n", tail.join(" "));
        check_outcome(import_mtl(&obj, &format!("newmtl 1\n{text}\n")), obj);
    }
}

#[test]
fn a_model_of_70_000_triangles_is_read_fast() {
    let text = sphere(132).obj();
    let before = Instant::now();
    let (_, report) = import_obj(&text).unwrap();
    let took = before.elapsed();
    assert_eq!(report.triangles, 69_696);
    eprintln!("{} triangles of OBJ, {} bytes, in {took:?}", report.triangles, text.len());
    assert!(took.as_secs() < 5, "{took:?}");
}
