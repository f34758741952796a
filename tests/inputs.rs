//! Every file that is really read is an input, and so is one that was looked for in vain; nothing else is.
//!
//! Each case is one project of three models: `subject`, which reads the file in question, and two bystanders, of which one lies
//! beside it. The file changes, and only what reads it runs: counted by stages.

use std::fs;

use serde_json::{Value, json};

use crate::rebuild::{MANY, quad_gltf, touched};
use crate::space::{Space, ran};

/// What happens to a file.
#[derive(Clone, Copy)]
enum Change {
    /// It has other bytes.
    Other,
    /// It is new: it was looked for in vain.
    Appears,
    /// It is gone, and its reader does without it.
    Goes,
}

/// A file that `models/subject.*` reads.
struct Case {
    file: &'static str,
    change: Change,
    /// The stages of the subject that run.
    runs: &'static [&'static str],
    subject: Subject,
}

/// A model and the files that it names.
#[derive(Clone, Copy)]
enum Subject {
    /// glTF with a buffer and a picture of their own.
    Gltf,
    /// OBJ with a material library of one picture.
    Obj,
}

const CASES: &[Case] = &[
    // Geometry in a file of its own: everything reads it.
    Case { file: "parts/data.bin", change: Change::Other, runs: &ALL, subject: Subject::Gltf },
    // A picture reaches the container, never the geometry: merge and simplify stay fresh.
    Case { file: "parts/paint.png", change: Change::Other, runs: &["import", "pack"], subject: Subject::Gltf },
    Case { file: "parts/paint.png", change: Change::Appears, runs: &["import", "pack"], subject: Subject::Gltf },
    Case { file: "parts/paint.png", change: Change::Goes, runs: &["import", "pack"], subject: Subject::Gltf },
    Case { file: "subject.mtl", change: Change::Other, runs: &["import", "pack"], subject: Subject::Obj },
    Case { file: "subject.mtl", change: Change::Appears, runs: &["import", "pack"], subject: Subject::Obj },
    Case { file: "parts/paint.png", change: Change::Other, runs: &["import", "pack"], subject: Subject::Obj },
    Case { file: "parts/paint.png", change: Change::Appears, runs: &["import", "pack"], subject: Subject::Obj },
    // `mtllib my subject.mtl` is one name if there is such a file, else two.
    Case { file: "my subject.mtl", change: Change::Appears, runs: &["import", "pack"], subject: Subject::Obj },
];

const ALL: [&str; 5] = ["import", "whole", "lods, collapse", "lods", "pack"];

#[test]
fn a_file_that_was_read_or_looked_for_in_vain_runs_what_reads_it_and_nothing_else() {
    // Two at a time: each case is a few builds of milliseconds.
    let (first, second) = CASES.split_at(CASES.len() / 2);
    std::thread::scope(|scope| {
        for cases in [first, second] {
            scope.spawn(move || cases.iter().for_each(check));
        }
    });
}

fn check(case: &Case) {
    let space = Space::new();
    space.write("pipeline.toml", pipeline("*.[og]*"));
    for name in ["aside", "other"] {
        space.write(&format!("models/{name}.gltf"), quad_gltf(name));
    }
    for (name, bytes) in files(case.subject) {
        let absent = matches!(case.change, Change::Appears) && name == case.file;
        if !absent {
            space.write(&format!("models/{name}"), bytes);
        }
    }
    let subject = match case.subject {
        Subject::Gltf => "models/subject.gltf",
        Subject::Obj => "models/subject.obj",
    };
    let path = format!("models/{}", case.file);
    let what = format!("{subject}, {path}");
    build(&space);
    build(&space);
    assert!(touched(&build(&space)).is_empty(), "{what}");
    match case.change {
        Change::Goes => fs::remove_file(space.path(&path)).unwrap(),
        Change::Other | Change::Appears => drop(space.write(&path, other(case.file))),
    }
    let report = build(&space);
    assert_eq!(touched(&report), [subject], "{what}");
    assert_eq!(ran(&report), case.runs, "{what}");
    assert!(touched(&build(&space)).is_empty(), "{what}, again");
}

/// One level: a triangle or two have no second.
fn pipeline(models: &str) -> String {
    MANY.replace("*.gltf", models).replace(", { keep = 0.5 }", "")
}

/// A build that may warn of a missing picture.
fn build(space: &Space) -> Value {
    space.run(["build", "pipeline.toml", "--backend", "cpu", "--json"]).expect(0).json()
}

/// The subject and what it names, relative to its folder.
fn files(subject: Subject) -> Vec<(&'static str, Vec<u8>)> {
    match subject {
        Subject::Gltf => vec![
            ("subject.gltf", gltf().to_string().into_bytes()),
            ("parts/data.bin", buffer(1.0)),
            ("parts/paint.png", png([200, 10, 10])),
        ],
        Subject::Obj => vec![
            (
                "subject.obj",
                b"mtllib my subject.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl red\nf 1/1 2/2 3/3\n"
                    .to_vec(),
            ),
            ("subject.mtl", b"newmtl red\nKd 1 0 0\nmap_Kd parts/paint.png\n".to_vec()),
            ("parts/paint.png", png([200, 10, 10])),
        ],
    }
}

/// What a file holds after its change.
fn other(file: &str) -> Vec<u8> {
    match file {
        "parts/data.bin" => buffer(2.0),
        "parts/paint.png" => png([10, 200, 10]),
        _ => b"newmtl red\nKd 1 1 0\nmap_Kd parts/paint.png\n".to_vec(),
    }
}

/// Two triangles with texture coordinates: the buffer of [`gltf`].
pub(crate) fn buffer(height: f32) -> Vec<u8> {
    let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, height, 0.0], [1.0, height, 1.0]];
    let uvs = [[0.0_f32, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
    let floats = positions.iter().flatten().chain(uvs.iter().flatten());
    let mut bytes: Vec<u8> = floats.flat_map(|value| value.to_le_bytes()).collect();
    bytes.extend([0_u16, 1, 2, 1, 3, 2].iter().flat_map(|index| index.to_le_bytes()));
    bytes
}

/// Two triangles whose buffer and picture lie in `parts/`.
pub(crate) fn gltf() -> Value {
    json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 2, "material": 0 }] }],
        "materials": [{ "name": "red", "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }],
        "textures": [{ "source": 0 }], "images": [{ "uri": "parts/paint.png" }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 2, 1] },
            { "bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2" },
            { "bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR" }
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 32 },
            { "buffer": 0, "byteOffset": 80, "byteLength": 12 }
        ],
        "buffers": [{ "uri": "parts/data.bin", "byteLength": 92 }]
    })
}

/// A small picture of one colour.
pub(crate) fn png(rgb: [u8; 3]) -> Vec<u8> {
    let picture = image::RgbImage::from_pixel(4, 4, image::Rgb(rgb));
    let mut bytes = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
    bytes.into_inner()
}

#[test]
fn an_external_buffer_that_is_missing_fails_until_it_appears() {
    let space = Space::new();
    space.write("pipeline.toml", pipeline("*.gltf"));
    space.write("models/a.gltf", quad_gltf("a"));
    space.write("models/b.gltf", gltf().to_string());
    let args = ["build", "pipeline.toml", "--backend", "cpu", "--keep-going"];
    for _ in 0..2 {
        let said = space.run(args).expect(2).stderr;
        assert!(said.contains("parts/data.bin"), "{said}");
    }
    assert!(space.path("out/a.kiln").exists(), "--keep-going builds the others");
    space.write("models/parts/data.bin", buffer(1.0));
    assert_eq!(touched(&build(&space)), ["models/b.gltf"]);
    assert!(touched(&build(&space)).is_empty());
}

#[test]
fn a_file_that_nothing_reads_is_no_input() {
    let space = Space::new();
    space.write("pipeline.toml", pipeline("*.gltf"));
    space.write("models/a.gltf", quad_gltf("a"));
    space.write("models/parts/notes.txt", "one");
    build(&space);
    build(&space);
    space.write("models/parts/notes.txt", "two");
    space.write("readme.txt", "new");
    let said = space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(0).stderr;
    assert!(said.contains("nothing to do"), "{said}");
}
