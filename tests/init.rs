//! `kiln init` and `kiln doctor`: from a model to a pipeline that builds, and what is said of sound and broken models.

use std::fs;

use crate::space::{Space, repository};

const CORNERS: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
const CLOSED: [[u16; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];

#[test]
fn every_fixture_gets_a_pipeline_that_builds() {
    for name in ["pot", "cube", "sphere", "triangle", "boundary-pair", "seam-plane"] {
        let space = Space::new();
        space.fixture(&format!("{name}.glb"));
        let said = space.run(["init", &format!("{name}.glb")]).expect(0);
        assert_eq!(said.stdout, "");
        assert!(said.stderr.contains(&format!("kiln build {name}.toml")), "the next command is named: {}", said.stderr);
        space.run(["build", &format!("{name}.toml"), "--backend", "cpu"]).expect(0);
        space.run(["check", &format!("build/{name}.kiln")]).expect(0);
    }
}

#[test]
fn a_pipeline_for_the_pot_names_its_submeshes_and_images() {
    let space = Space::new();
    space.fixture("pot.glb");
    let text = space.run(["init", "pot.glb", "-o", "-"]).expect(0).stdout;
    let seen = space.run(["doctor", "pot.glb", "--json"]).expect(0).json();
    for part in seen["parts"].as_array().unwrap() {
        let (name, triangles) = (&part["name"], &part["triangles"]);
        assert!(
            text.lines()
                .any(|l| l.starts_with('#') && l.contains(&name.to_string()) && l.contains(&triangles.to_string())),
            "{part}\n{text}"
        );
    }
    assert!(text.contains(&format!("{} triangles", seen["triangles"])), "{text}");
    assert!(!space.path("pot.toml").exists(), "standard output only");
}

#[test]
fn an_existing_file_is_never_replaced() {
    let space = Space::new();
    space.fixture("cube.glb");
    space.write("cube.toml", "mine");
    let said = space.run(["init", "cube.glb"]).expect(64).stderr;
    assert!(said.contains("cube.toml") && said.contains("-o"), "{said}");
    assert_eq!(space.read("cube.toml"), b"mine");
    space.run(["init", "cube.glb", "-o", "other.toml"]).expect(0);
    space.run(["init", "cube.glb", "-o", "other.toml"]).expect(64);
    space.run(["init", "cube.glb", "-o", "no/such/folder.toml"]).expect(2);
    space.run(["init"]).expect(64);
}

#[test]
fn a_model_in_another_folder_is_named_as_the_pipeline_sees_it() {
    let space = Space::new();
    let triangle = fs::read(repository("fixtures/triangle.glb")).unwrap();
    space.write("models/deep/triangle.glb", triangle);
    space.write("pipelines/keep", "");
    space.run(["init", "models/deep/triangle.glb", "-o", "pipelines/a.toml"]).expect(0);
    let text = String::from_utf8(space.read("pipelines/a.toml")).unwrap();
    assert!(text.contains("input = \"../models/deep/triangle.glb\""), "{text}");
    space.run(["build", "pipelines/a.toml", "--backend", "cpu"]).expect(0);
    assert!(space.path("pipelines/build/triangle.kiln").exists());
}

#[test]
fn names_that_globs_toml_and_shells_read_build_all_the_same() {
    for name in [
        "a [1]*?",
        "it's \"quoted\"",
        "back\\slash",
        "line\nbreak # = 2",
        "-dash",
        "{name} $x",
        ".hidden[a]",
        "ünïcode 🏺",
    ] {
        let space = Space::new();
        space.write(&format!("in [x]/{name}.glb"), fs::read(repository("fixtures/triangle.glb")).unwrap());
        // A neighbour that an unescaped glob would match as well.
        space.write("in [x]/a 1xy.glb", "no model");
        space.run(["init".into(), format!("in [x]/{name}.glb"), "-o".into(), "made here.toml".into()]).expect(0);
        let text = String::from_utf8(space.read("made here.toml")).unwrap();
        let built = space.run(["build", "made here.toml", "--backend", "cpu", "--json"]);
        assert_eq!(built.code, 0, "{}\n{text}", built.stderr);
        assert_eq!(built.json()["assets"][0]["input"], format!("in [x]/{name}.glb"));
    }
}

#[test]
fn a_submesh_with_a_hostile_name_stays_in_its_comment() {
    let space = Space::new();
    space.gltf("m", &CORNERS, None, &CLOSED);
    let model = String::from_utf8(space.read("m.gltf")).unwrap();
    space
        .write("m.gltf", model.replace("\"name\":\"m\"", "\"name\":\"lid\\n[asset]\\ninput = 1\\u0000\\u2028 \\\"#\""));
    space.run(["init", "m.gltf"]).expect(0);
    let text = String::from_utf8(space.read("m.toml")).unwrap();
    assert!(text.contains("# ") && text.contains("lid\\n[asset]"), "{text}");
    space.run(["build", "m.toml", "--backend", "cpu"]).expect(0);
}

#[test]
fn a_broken_model_gets_no_pipeline() {
    let space = Space::new();
    space.write("broken.glb", "no model");
    let said = space.run(["init", "broken.glb"]).expect(2).stderr;
    assert!(said.contains("invalid model"), "{said}");
    assert!(!space.path("broken.toml").exists());
    space.run(["init", "missing.glb"]).expect(2);
}

#[test]
fn doctor_counts_what_merge_would_change_and_what_the_surface_is_like() {
    let space = Space::new();
    // A tetrahedron with one face turned over, one doubled, and one with two corners at one point.
    let mut faces = CLOSED.to_vec();
    faces[1].swap(1, 2);
    faces.extend([[1, 2, 3], [1, 1, 2]]);
    space.gltf("broken", &CORNERS, None, &faces);
    let seen = space.run(["doctor", "broken.gltf", "--json"]).expect(0).json();
    let repairs: Vec<_> =
        seen["merge"]["repairs"].as_array().unwrap().iter().map(|r| (&r["kind"], &r["count"])).collect();
    assert_eq!(serde_json::json!(repairs), serde_json::json!([["degenerate-faces", 1], ["duplicate-faces", 1]]));
    let surface = &seen["surface"];
    for (key, count) in
        [("disagreeing_edges", 3), ("border_edges", 0), ("crowded_edges", 0), ("components", 1), ("turnable_faces", 1)]
    {
        assert_eq!(surface[key], count, "{key}: {surface:#}");
    }
    assert_eq!(seen["parts"], serde_json::json!([{ "name": "broken", "triangles": 6, "material": null }]));
    assert!((seen["bounds"]["diagonal"].as_f64().unwrap() - 3.0_f64.sqrt()).abs() < 1e-6);
    let said = space.run(["doctor", "broken.gltf"]).expect(0).stdout;
    for words in
        ["dropped (1 times", "3 between faces of opposite winding", "\"winding\"", "diagonal 1.732 m", "\"broken\""]
    {
        assert!(said.contains(words), "{words} is not in\n{said}");
    }
    space.gltf("sound", &CORNERS, None, &CLOSED);
    let said = space.run(["doctor", "sound.gltf"]).expect(0).stdout;
    assert!(!said.contains("merge changes") && said.contains("1 of 1 patches closed"), "{said}");
}

#[test]
fn doctor_names_every_defect_on_its_own_line_with_its_family() {
    let space = Space::new();
    space.gltf("m", &CORNERS, None, &CLOSED);
    let model = String::from_utf8(space.read("m.gltf")).unwrap();
    let broken =
        model.replace("\"componentType\":5126", "\"componentType\":17").replace("\"indices\":1", "\"indices\":9");
    space.write("m.gltf", broken);
    let ran = space.run(["doctor", "m.gltf", "--json"]).expect(2);
    let lines: Vec<&str> = ran.stderr.lines().filter(|l| l.starts_with("error: m.gltf: invalid model: ")).collect();
    assert!(lines.len() >= 2, "{}", ran.stderr);
    assert!(ran.stderr.contains("accessors[0].componentType") && ran.stderr.contains(".indices"), "{}", ran.stderr);
    let said = ran.json();
    assert_eq!(
        (said["family"].as_str(), said["defects"].as_array().unwrap().len()),
        (Some("invalid model"), lines.len())
    );
}

#[test]
fn the_page_on_import_has_every_rule_and_every_extension() {
    let page = fs::read_to_string(repository("docs/import.md")).unwrap();
    let words = page.split_whitespace().collect::<Vec<_>>().join(" ");
    for file in ["crates/kiln-asset/src/import/report.rs", "crates/kiln-lod/src/merge/repair.rs"] {
        let source = fs::read_to_string(repository(file)).unwrap();
        let sentences: Vec<&str> =
            source.lines().filter_map(|l| l.split_once(" => \"")?.1.strip_suffix("\",")).collect();
        assert!(sentences.len() >= 5, "{file}");
        for sentence in sentences {
            let (trouble, rule) = sentence.split_once(": ").unwrap();
            assert!(words.contains(&format!("| {trouble} | {rule} |")), "docs/import.md lacks: | {trouble} | {rule} |");
        }
    }
    for extension in kiln_asset::import::EXTENSIONS {
        assert!(page.contains(extension), "docs/import.md lacks {extension}");
    }
}
