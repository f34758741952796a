//! The command contract: exit codes, diagnostics, what goes where, and hostile input.

use std::fs;

use crate::space::{SMALL, Space, repository, small};

#[test]
fn help_names_every_command_and_the_exit_codes() {
    let help = Space::new().run(["--help"]).expect(0).stdout;
    for word in ["init", "build", "why", "inspect", "check", "export", "compare", "doctor", "stage", "64 bad usage"] {
        assert!(help.contains(word), "{word} is not in\n{help}");
    }
}

#[test]
fn bad_usage_ends_with_64() {
    let space = small("cube.glb");
    space.run(["bild"]).expect(64);
    space.run(["build"]).expect(64);
    let said = space.run(["build", "pipeline.toml", "--set", "stage.lods.levls=[]"]).expect(64).stderr;
    assert!(said.contains("levels"), "the nearest key is named: {said}");
}

#[test]
fn all_defects_of_a_pipeline_come_at_once_with_line_and_caret() {
    let space = small("cube.glb");
    let text = SMALL.replace("size = 256\npadding", "sise = 256\npadding").replace("kind = \"pack\"", "kind = \"pak\"");
    space.write("pipeline.toml", text);
    let said = space.run(["build", "pipeline.toml"]).expect(2).stderr;
    for word in ["pipeline.toml:", "`size`", "pack", "^"] {
        assert!(said.contains(word), "{word} is not in\n{said}");
    }
    assert!(!space.path("out").exists() && !space.path(".kiln").exists(), "nothing was left behind");
}

#[test]
fn a_missing_pipeline_and_a_missing_model_end_with_2() {
    let space = small("cube.glb");
    assert!(space.run(["build", "other.toml"]).expect(2).stderr.contains("other.toml"));
    fs::remove_file(space.path("model.glb")).unwrap();
    let said = space.run(["build", "pipeline.toml"]).expect(2).stderr;
    assert!(said.contains("model.glb"), "{said}");
}

#[test]
fn a_broken_model_ends_with_2_names_the_place_and_leaves_no_output() {
    let space = small("cube.glb");
    let bytes = space.read("model.glb");
    space.write("model.glb", &bytes[..bytes.len() / 2]);
    let said = space.run(["build", "pipeline.toml"]).expect(2).stderr;
    assert!(said.contains("model.glb"), "{said}");
    assert!(!space.path("out/model.kiln").exists());
}

#[test]
fn a_budget_out_of_reach_ends_with_1_and_says_why() {
    let space = Space::new();
    space.fixture("cube.glb");
    space.write(
        "pipeline.toml",
        r#"kiln = 1
[asset]
input = "cube.glb"
output = "out.kiln"
[[stage]]
kind = "merge"
[[stage]]
kind = "simplify"
levels = [{ triangles = 1 }]
[[stage]]
kind = "pack"
"#,
    );
    let said = space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(1).stderr;
    assert!(said.contains("short:"), "{said}");
    assert!(space.path("out.kiln").exists(), "the nearest result is kept");
}

/// The chain without a bake, for a `model.gltf`.
const LEVELS: &str = r#"kiln = 1
[asset]
input = "model.gltf"
output = "out.kiln"
[[stage]]
kind = "merge"
[[stage]]
kind = "simplify"
levels = [{ keep = 1.0 }]
[[stage]]
kind = "pack"
"#;

#[test]
fn repairs_of_import_and_of_merge_are_shown_and_denied_where_asked() {
    let place = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let faces = [[0, 1, 2], [0, 2, 3]];
    let up = [[0.0, 0.0, 1.0]; 4];
    let broken_normal = [[0.0, 0.0, 0.0], up[1], up[2], up[3]];
    let said = |normals: &[[f32; 3]], faces: &[[u16; 3]], set: &str, code: i32| {
        let space = Space::new();
        space.gltf("model", &place, Some(normals), faces);
        space.write("pipeline.toml", LEVELS);
        let args = ["build", "pipeline.toml", "--backend", "cpu", "--deny", "warnings", "--set", set];
        let first = space.run(args).expect(code).stderr;
        // What is fresh was repaired all the same.
        assert_eq!(space.run(args).code, code);
        space.run(&args[..4]).expect(0);
        first
    };
    let (without, with) = ("stage.merge.repair=[]", "stage.merge.repair=[\"duplicate-faces\", \"winding\"]");
    said(&up, &faces, with, 0);
    let import = said(&broken_normal, &faces, with, 1);
    assert!(import.contains("stage import: "), "{import}");
    let degenerate = said(&up, &[faces[0], [1, 1, 3], faces[1]], without, 1);
    assert!(degenerate.contains("stage merge: faces with two corners at one point: dropped (1 times"), "{degenerate}");
    let doubled = [faces[0], faces[1], faces[0]];
    let duplicate = said(&up, &doubled, with, 1);
    assert!(duplicate.contains("faces that their submesh has already: dropped (1 times"), "{duplicate}");
    said(&up, &doubled, without, 0);
    let flipped = [faces[0], [0, 3, 2]];
    said(&up, &flipped, without, 0);
    let winding = said(&up, &flipped, with, 1);
    assert!(winding.contains("faces wound the wrong way round: turned over (1 times"), "{winding}");
}

#[test]
fn set_changes_a_key_for_one_build() {
    let space = small("cube.glb");
    fs::rename(space.path("model.glb"), space.path("other.glb")).unwrap();
    let args = ["build", "pipeline.toml", "--backend", "cpu", "--set", "asset.input=other.glb", "--json"];
    let report = space.run(args).expect(0).json();
    assert_eq!(report["assets"][0]["input"], "other.glb");
}

#[test]
fn a_glob_builds_every_match() {
    let space = Space::new();
    for name in ["cube.glb", "triangle.glb"] {
        space.write(&format!("models/deep/{name}"), fs::read(repository("fixtures").join(name)).unwrap());
    }
    space.write(
        "pipeline.toml",
        r#"kiln = 1
[asset]
input = "models/**/*.glb"
output = "out/{path}.kiln"
[[stage]]
kind = "merge"
[[stage]]
kind = "simplify"
levels = [{ keep = 1.0 }]
[[stage]]
kind = "pack"
"#,
    );
    space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(0);
    assert!(space.path("out/deep/cube.kiln").exists() && space.path("out/deep/triangle.kiln").exists());
}

#[test]
fn doctor_tells_what_the_importer_sees() {
    let space = Space::new();
    space.fixture("pot.glb");
    let said = space.run(["doctor", "pot.glb"]).expect(0).stdout;
    assert!(said.contains("triangles") && said.contains("submeshes"), "{said}");
    space.run(["doctor"]).expect(0);
    space.run(["doctor", "missing.glb"]).expect(2);
}

#[test]
fn the_page_on_the_language_is_what_the_command_prints() {
    let printed = Space::new().run(["stage"]).expect(0).stdout;
    let page = fs::read_to_string(repository("docs/pipeline.md")).unwrap();
    let (_, reference) = page.split_once("\n\n## ").unwrap();
    assert_eq!(format!("## {reference}"), printed, "write it again: kiln stage");
}
