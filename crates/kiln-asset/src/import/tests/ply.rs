//! PLY in its three encodings: planted models, a sphere by all doors, malformed and hostile files.

use proptest::prelude::*;

use super::obj::{Sphere, assert_same_surface, check_outcome, sphere};
use super::*;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Encoding {
    Text,
    Little,
    Big,
}

const ENCODINGS: [(Encoding, &str); 3] =
    [(Encoding::Text, "ascii"), (Encoding::Little, "binary_little_endian"), (Encoding::Big, "binary_big_endian")];

/// A file under construction: declarations, and rows in one encoding.
struct File {
    encoding: Encoding,
    header: String,
    body: Vec<u8>,
}

impl File {
    fn new((encoding, name): (Encoding, &str), declarations: &str) -> File {
        let header = format!("ply\nformat {name} 1.0\ncomment made by a test\n{declarations}end_header\n");
        File { encoding, header, body: Vec::new() }
    }

    /// Adds a value of a type by its first letter and size: `f4`, `u1`, `i4`.
    fn put(&mut self, kind: &str, value: f64) {
        let little: Vec<u8> = match kind {
            "f4" => (value as f32).to_le_bytes().into(),
            "f8" => value.to_le_bytes().into(),
            "u1" => (value as u8).to_le_bytes().into(),
            "i1" => (value as i8).to_le_bytes().into(),
            "u2" => (value as u16).to_le_bytes().into(),
            "i2" => (value as i16).to_le_bytes().into(),
            "u4" => (value as u32).to_le_bytes().into(),
            "i4" => (value as i32).to_le_bytes().into(),
            other => panic!("{other}"),
        };
        match self.encoding {
            Encoding::Text if kind == "f4" => self.body.extend(format!("{} ", value as f32).bytes()),
            Encoding::Text => self.body.extend(format!("{value} ").bytes()),
            Encoding::Little => self.body.extend(little),
            Encoding::Big => self.body.extend(little.iter().rev()),
        }
    }

    fn all(&mut self, kind: &str, values: impl IntoIterator<Item = f64>) {
        values.into_iter().for_each(|value| self.put(kind, value));
    }

    fn end_row(&mut self) {
        if self.encoding == Encoding::Text {
            self.body.push(b'\n');
        }
    }

    fn bytes(&self) -> Vec<u8> {
        [self.header.as_bytes(), &self.body].concat()
    }

    fn import(&self) -> Outcome {
        import_bytes("model.ply", self.bytes())
    }
}

fn import_text(text: &str) -> Outcome {
    import_bytes("model.ply", text.as_bytes().to_vec())
}

fn sphere_file(sphere: &Sphere, encoding: (Encoding, &str)) -> File {
    let mut file = File::new(
        encoding,
        &format!(
            "element vertex {}\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\n\
             property float nz\nproperty float s\nproperty float t\nelement face {}\nproperty list uchar int vertex_indices\n",
            sphere.positions.len(),
            sphere.triangles.len()
        ),
    );
    for (position, uv) in sphere.positions.iter().zip(&sphere.uvs) {
        for _ in 0..2 {
            file.all("f4", position.to_array().map(f64::from));
        }
        file.all("f4", [f64::from(uv.x), f64::from(1.0 - uv.y)]);
        file.end_row();
    }
    for triangle in &sphere.triangles {
        file.put("u1", 3.0);
        file.all("i4", triangle.map(f64::from));
        file.end_row();
    }
    file
}

// Planted answers.

#[test]
fn a_sphere_comes_in_as_from_gltf_in_every_encoding() {
    let sphere = sphere(24);
    let (expected, _) = import_bytes("model.glb", sphere.glb()).unwrap();
    for encoding in ENCODINGS {
        let (found, report) = sphere_file(&sphere, encoding).import().unwrap();
        assert_same_surface(&found.mesh, &expected.mesh);
        assert_eq!(found.mesh.submeshes, expected.mesh.submeshes);
        assert_eq!((report.format, report.generator.as_str()), (ModelFormat::Ply, "made by a test"));
        assert_eq!((report.repairs, report.not_carried), (vec![], vec![]), "{encoding:?}");
    }
}

#[test]
fn every_type_colour_and_extra_column_is_read_or_counted() {
    for encoding in ENCODINGS {
        let mut file = File::new(
            encoding,
            "obj_info x\nelement camera 1\nproperty list uchar float view\nelement vertex 4\nproperty uchar red\n\
             property uchar green\nproperty uchar blue\nproperty double x\nproperty short quality\nproperty int y\n\
             property uchar alpha\nproperty char z\nelement face 2\nproperty uint flags\n\
             property list ushort uint vertex_index\nelement edge 1\nproperty int vertex1\nproperty int vertex2\n",
        );
        file.put("u1", 2.0);
        file.all("f4", [1.5, 2.5]);
        file.end_row();
        for (x, y) in [(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)] {
            file.all("u1", [255.0, 0.0, 188.0]);
            file.put("f8", x);
            file.put("i2", -3.0);
            file.put("i4", y);
            file.put("u1", 51.0);
            file.put("i1", -1.0);
            file.end_row();
        }
        for list in [&[0.0, 1.0, 2.0, 3.0][..], &[2.0, 1.0, 0.0]] {
            file.put("u4", 4_000_000_000.0);
            file.put("u2", list.len() as f64);
            file.all("u4", list.iter().copied());
            file.end_row();
        }
        file.all("i4", [0.0, 1.0]);
        file.end_row();
        let (asset, report) = file.import().unwrap();
        let mesh = &asset.mesh;
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [2, 1, 0]], "{encoding:?}");
        assert_eq!(mesh.positions[2], Vec3::new(2.0, 2.0, -1.0));
        let color = mesh.colors.as_ref().unwrap()[0];
        // ((188/255 + 0.055) / 1.055)^2.4
        assert!((color - Vec4::new(1.0, 0.0, 0.502_886_5, 0.2)).length() < 1e-6, "{color}");
        let counts: Vec<(&str, u64)> = report.not_carried.iter().map(|n| (n.what.as_str(), n.count)).collect();
        assert_eq!(
            counts,
            [
                ("element `camera`", 1),
                ("element `edge`", 1),
                ("property `flags` of `face`", 2),
                ("property `quality` of `vertex`", 4),
            ]
        );
    }
}

#[test]
fn floating_colours_are_linear_and_faces_may_stand_first() {
    let text = "ply\r\nformat ascii 1.0\r\nelement face 1\r\nproperty list uchar int vertex_indices\r\nelement vertex 3\r\n\
                property float x\r\nproperty float y\r\nproperty float z\r\nproperty float red\r\nproperty float green\r\n\
                property float blue\r\nend_header\r\n3 0 1 2\r\n\r\n0 0 0 .5 1. 0\r\n1 0 0 nan 1 0\r\n0 1 0 0 0 2\r\n";
    let (asset, report) = import_text(text).unwrap();
    let colors = asset.mesh.colors.as_ref().unwrap();
    assert_eq!(colors[..], [Vec4::new(0.5, 1.0, 0.0, 1.0), Vec4::ONE, Vec4::new(0.0, 0.0, 2.0, 1.0)]);
    assert_eq!(repair_count(&report, RepairKind::ColorNotFinite), 1);
}

/// Two squares of corner UVs, each with a picture of its own.
fn textured(encoding: (Encoding, &str)) -> File {
    let mut file = File::new(
        encoding,
        "comment TextureFile tex\\one.png\ncomment TextureFile two 2.png\nelement vertex 4\nproperty float x\n\
         property float y\nproperty float z\nelement face 3\nproperty list uchar int vertex_indices\n\
         property list uchar float texcoord\nproperty int texnumber\n",
    );
    for [x, y, z] in CORNERS.as_chunks::<3>().0 {
        file.all("f4", [x, y, z].map(|c| f64::from(*c)));
        file.end_row();
    }
    for (corners, shift, number) in
        [([0.0, 1.0, 2.0], 0.0, 1.0), ([0.0, 2.0, 3.0], 0.0, 1.0), ([2.0, 1.0, 0.0], 0.5, 0.0)]
    {
        file.put("u1", 3.0);
        file.all("i4", corners);
        file.put("u1", 6.0);
        for corner in corners {
            let [x, y, _] = CORNERS.as_chunks::<3>().0[corner as usize];
            file.all("f4", [f64::from(x) + shift, f64::from(y)]);
        }
        file.put("i4", number);
        file.end_row();
    }
    file
}

#[test]
fn meshlabs_pictures_and_corner_uvs_are_read() {
    let picture = png(2, 2, |_, _| [9, 9, 9, 255]);
    for encoding in ENCODINGS {
        let files = Memory(BTreeMap::from([
            ("model.ply".to_owned(), textured(encoding).bytes()),
            ("two 2.png".to_owned(), picture.clone()),
        ]));
        let (asset, report) = import(&files, "model.ply", &ImportLimits::default()).unwrap();
        let mesh = &asset.mesh;
        let names: Vec<(&str, u32)> = mesh.submeshes.iter().map(|s| (s.name.as_str(), s.material.unwrap().0)).collect();
        assert_eq!(names, [("mesh0/two 2", 0), ("mesh0/one", 1)]);
        // The square's diagonal is shared, the other face has other UVs.
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [4, 5, 6]]);
        assert_eq!(mesh.uv0.as_ref().unwrap()[2], Vec2::new(1.0, 0.0));
        assert_eq!(mesh.uv0.as_ref().unwrap()[6], Vec2::new(0.5, 1.0));
        assert!(asset.materials.materials[0].base_color.is_some() && asset.materials.materials[1].base_color.is_none());
        assert_eq!(repair_count(&report, RepairKind::ImageMissing), 1);
        assert_eq!(repair_count(&report, RepairKind::BackslashPath), 1);
    }
}

// Malformed and hostile.

const HEAD: &str = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n\
                    element face 1\nproperty list uchar int vertex_indices\nend_header\n";
const ROWS: &str = "0 0 0\n1 0 0\n0 1 0\n";

#[test]
fn every_malformed_header_names_its_line() {
    let body = format!("{ROWS}3 0 1 2\n");
    assert!(import_text(&format!("{HEAD}{body}")).is_ok());
    for (from, to, path) in [
        ("ply\n", "plz\n", "model.ply:1"),
        ("format ascii 1.0", "format ascii 2.0", "model.ply:2"),
        ("format ascii 1.0", "format utf8 1.0", "model.ply:2"),
        ("format ascii 1.0\n", "", "model.ply"),
        ("vertex 3", "vertex", "model.ply:3"),
        ("vertex 3", "vertex -3", "model.ply:3"),
        ("vertex 3", "vertex 99999999999999999999", "model.ply:3"),
        ("vertex 3", "vertex 18446744073709551615", "model.ply:3"),
        ("vertex 3", "vertex 300", "model.ply:3"),
        ("face 1", "face 18446744073709551615", "model.ply:7"),
        ("element vertex 3\n", "", "model.ply:3"),
        ("property float y", "property float x", "model.ply:5"),
        ("property float y", "property float", "model.ply:5"),
        ("property float y", "property half y", "model.ply:5"),
        ("property float y", "property float w", "element vertex"),
        ("element face 1", "element vertex 1", "model.ply:7"),
        ("list uchar int", "list float int", "model.ply:8"),
        ("list uchar int", "list uchar float", "element face"),
        ("list uchar int", "list uchar", "model.ply:8"),
        ("vertex_indices", "corners", "element face"),
        ("end_header\n", "", "model.ply:9"),
        ("element face", "colour red\nelement face", "model.ply:7"),
    ] {
        let text = format!("{}{body}", HEAD.replacen(from, to, 1));
        let paths = defect_paths(import_text(&text));
        assert_eq!(paths.first().map(String::as_str), Some(path), "{to}: {paths:?}");
    }
    for (from, to) in [("face 1", "face 0"), ("element face", "element tristrips")] {
        let error = import_text(&format!("{}{body}", HEAD.replacen(from, to, 1))).expect_err(to);
        assert!(matches!(error, ImportError::Unsupported(_)), "{to}: {error}");
    }
}

#[test]
fn every_malformed_row_names_its_property() {
    for (rows, paths) in [
        ("0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n", vec!["element face[0].vertex_indices"]),
        ("0 0 0\n1 0 0\n0 1 0\n3 0 1 -1\n", vec!["element face[0].vertex_indices"]),
        ("0 0 0\n1 0 0\n0 1 0\n3 0 1 1.5\n", vec!["element face[0].vertex_indices"]),
        ("0 0 0\n1 0 0\n0 1 0\n2 0 1\n", vec!["element face[0].vertex_indices"]),
        ("0 0 0\n1 0 0\n0 1 0\n256 0 1 2\n", vec!["element face[0].vertex_indices"]),
        ("0 0 0\n1 0 0\n0 1 0\n4 0 1 2\n", vec!["element face[0].vertex_indices"]),
        ("0 0 0\n1 0 0\n0 1 0\n3 0 1 2 2\n", vec!["element face[0]"]),
        ("0 0 0\n1 0 0\n0 1 0        \n", vec!["element face[0]"]),
        (
            "0 0 x\n1 nan 0\n0 1\n3 0 1 9\n",
            vec!["element vertex[0].z", "element vertex[1]", "element vertex[2].z", "element face[0].vertex_indices"],
        ),
    ] {
        assert_eq!(defect_paths(import_text(&format!("{HEAD}{rows}"))), paths, "{rows:?}");
    }
}

#[test]
fn a_list_that_claims_more_than_the_file_holds_is_refused_at_once() {
    for encoding in &ENCODINGS[1..] {
        let declarations = "element vertex 1\nproperty char x\nproperty char y\nproperty char z\nelement face 1\n\
                            property list uint double texcoord\nproperty list uint int vertex_indices\n";
        let mut file = File::new(*encoding, declarations);
        file.all("i1", [0.0; 3]);
        file.put("u4", 4_294_967_295.0);
        file.all("i4", [0.0; 4]);
        assert_eq!(defect_paths(file.import()), ["element face[0].texcoord"], "{encoding:?}");
    }
}

#[test]
fn limits_hold() {
    let bytes = sphere_file(&sphere(4), ENCODINGS[1]).bytes();
    let import = |limits: ImportLimits| {
        import(&Memory(BTreeMap::from([("model.ply".to_owned(), bytes.clone())])), "model.ply", &limits)
    };
    let limits = ImportLimits { max_vertices: 45, max_triangles: 64, max_submeshes: 1, ..Default::default() };
    assert!(import(limits).is_ok());
    for (less, path) in [
        (ImportLimits { max_vertices: 44, ..limits }, "element vertex"),
        (ImportLimits { max_triangles: 63, ..limits }, "model.ply"),
        (ImportLimits { max_submeshes: 0, ..limits }, "model.ply"),
        (ImportLimits { max_file_bytes: bytes.len() as u64 - 1, ..limits }, "model.ply"),
    ] {
        assert_eq!(defect_paths(import(less)), [path], "{less:?}");
    }
}

#[test]
fn every_prefix_and_every_changed_byte_is_taken_or_refused_with_a_place() {
    let picture = png(1, 1, |_, _| [1, 2, 3, 255]);
    for encoding in ENCODINGS {
        let whole = textured(encoding).bytes();
        let run = |bytes: Vec<u8>, case: (usize, u8)| {
            let files =
                Memory(BTreeMap::from([("m.ply".to_owned(), bytes), ("two 2.png".to_owned(), picture.clone())]));
            let outcome = import(&files, "m.ply", &ImportLimits::default());
            let refused = outcome.is_err();
            check_outcome(outcome, case);
            refused
        };
        assert!(!run(whole.clone(), (0, 0)));
        for end in 0..whole.len() {
            let refused = run(whole[..end].to_vec(), (end, 0));
            // A text may lack blanks and its last line's end; `1 ` is all that `10` needs to be another number.
            assert!(
                refused || (encoding.0 == Encoding::Text && end + 3 > whole.len()),
                "{encoding:?}: {end} bytes were taken"
            );
        }
        for at in 0..whole.len() {
            for byte in [0, 1, 0x7F, 0x80, 0xFF, b'\n', b' ', b'9', whole[at] ^ 1, whole[at] ^ 0x10] {
                let mut changed = whole.clone();
                changed[at] = byte;
                run(changed, (at, byte));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_soup_of_words_panics(
        header in prop::collection::vec(
            prop::sample::select(vec![
                "element vertex 3\n", "element face 1\n", "element edge 2\n", "property float x\n", "property double y\n",
                "property char z\n", "property list uchar int vertex_indices\n", "property list int float texcoord\n",
                "property int texnumber\n", "property uchar red\n", "comment TextureFile a\n", "obj_info\n", "property float nx\n",
                "element face 4294967296\n", "element vertex 0\n", "property list uint double q\n", "\n", "property\n",
            ]),
            0..16,
        ),
        format in prop::sample::select(vec!["ascii", "binary_little_endian", "binary_big_endian"]),
        sound in any::<bool>(),
        body in prop::collection::vec(prop::sample::select(vec![0u8, 1, 2, 3, 4, 32, 32, 48, 49, 50, 51, 10, 45, 46, 128, 255]), 0..120),
    ) {
        let start = "element vertex 3\nproperty char x\nproperty char y\nproperty char z\nelement face 1\n\
                     property list uchar uchar vertex_indices\n";
        let declarations = format!("{}{}", if sound { start } else { "" }, header.concat());
        let mut bytes = format!("ply\nformat {format} 1.0\n{declarations}end_header\n").into_bytes();
        bytes.extend(body);
        check_outcome(import_bytes("model.ply", bytes), declarations);
    }
}

#[test]
fn a_model_of_70_000_triangles_is_read_fast() {
    for encoding in ENCODINGS {
        let bytes = sphere_file(&sphere(132), encoding).bytes();
        let length = bytes.len();
        let before = Instant::now();
        let (_, report) = import_bytes("model.ply", bytes).unwrap();
        let took = before.elapsed();
        eprintln!("{} triangles of PLY ({}), {length} bytes, in {took:?}", report.triangles, encoding.1);
        assert!(report.triangles == 69_696 && took.as_secs() < 5, "{took:?}");
    }
}
