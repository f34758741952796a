//! Which stages run again, and that nothing else does.

use std::fs;

use serde_json::Value;

use crate::space::{Space, ran, small};

/// Builds once and makes the cache's stats old enough to be trusted.
fn built() -> Space {
    let space = small("cube.glb");
    let report = space.build();
    assert!(ran(&report).contains(&"bake".to_owned()), "the first build runs all: {report}");
    space
}

pub(crate) fn assert_ran(report: &Value, expected: &[&str]) {
    assert_eq!(ran(report), expected, "{report:#}");
}

#[test]
fn a_second_build_runs_nothing_and_writes_nothing() {
    let space = built();
    let before = space.files();
    let stamp = fs::metadata(space.path("out/model.kiln")).unwrap().modified().unwrap();
    let report = space.build();
    assert_ran(&report, &[]);
    assert_eq!(report["assets"][0]["state"], "unchanged");
    assert_eq!(fs::metadata(space.path("out/model.kiln")).unwrap().modified().unwrap(), stamp);
    assert_eq!(space.files(), before);
}

#[test]
fn a_comment_and_blanks_in_the_pipeline_run_nothing() {
    let space = built();
    let text = String::from_utf8(space.read("pipeline.toml")).unwrap();
    space.write("pipeline.toml", format!("# a comment\n\n{}", text.replace(" = ", "   =   ")));
    assert_ran(&space.build(), &[]);
}

#[test]
fn a_touched_model_runs_nothing() {
    let space = built();
    let bytes = space.read("model.glb");
    space.write("model.glb", bytes);
    assert_ran(&space.build(), &[]);
}

#[test]
fn a_moved_project_runs_nothing() {
    let space = built();
    let moved = Space::new();
    copy(&space.path(""), &moved.path(""));
    drop(space);
    assert_ran(&moved.build(), &[]);
}

#[test]
fn a_renamed_but_equal_model_runs_nothing() {
    let space = built();
    fs::rename(space.path("model.glb"), space.path("other.glb")).unwrap();
    let text = String::from_utf8(space.read("pipeline.toml")).unwrap();
    space.write("pipeline.toml", text.replace("model.glb", "other.glb"));
    assert_ran(&space.build(), &[]);
}

#[test]
fn a_renamed_but_equal_model_of_a_glob_runs_nothing_and_its_container_is_written() {
    let space = many();
    fs::rename(space.path("models/b.gltf"), space.path("models/bee.gltf")).unwrap();
    let report = space.build();
    assert_ran(&report, &[]);
    assert_eq!(touched(&report), ["models/bee.gltf"]);
    assert_eq!(space.read("out/bee.kiln"), space.read("out/b.kiln"));
}

#[test]
fn another_thread_count_runs_nothing() {
    let space = built();
    let args = ["build", "pipeline.toml", "--backend", "cpu", "--json", "--jobs"];
    for jobs in ["1", "3"] {
        assert_ran(&space.run(args.into_iter().chain([jobs])).expect(0).json(), &[]);
        let output = space.command(args.into_iter().chain([jobs])).env("RAYON_NUM_THREADS", jobs).output().unwrap();
        assert_ran(&serde_json::from_slice(&output.stdout).unwrap(), &[]);
        // The same where all is planned and every fingerprint is asked for.
        fs::remove_dir_all(space.path(".kiln/v1/state")).unwrap();
    }
}

#[test]
fn a_changed_level_replays_the_sequence_and_simplifies_nothing() {
    let space = built();
    let text = String::from_utf8(space.read("pipeline.toml")).unwrap();
    space.write("pipeline.toml", text.replace("{ keep = 0.1 }", "{ keep = 0.15 }"));
    assert_ran(&space.build(), &["lods", "bake", "pack"]);
}

#[test]
fn a_changed_dilation_runs_the_bake_and_what_follows() {
    let space = built();
    let text = String::from_utf8(space.read("pipeline.toml")).unwrap();
    space.write("pipeline.toml", text.replace("dilation = 2", "dilation = 1"));
    let report = space.build();
    let stages = ran(&report);
    assert!(stages.iter().all(|s| s == "bake" || s == "pack") && stages.contains(&"bake".to_owned()), "{stages:?}");
}

#[test]
fn a_deleted_output_comes_back_from_the_cache_without_a_stage() {
    let space = built();
    let bytes = space.read("out/model.kiln");
    fs::remove_file(space.path("out/model.kiln")).unwrap();
    let report = space.build();
    assert_ran(&report, &[]);
    assert_eq!(report["assets"][0]["state"], "written");
    assert_eq!(space.read("out/model.kiln"), bytes);
}

#[test]
fn a_damaged_cache_entry_is_made_again() {
    let space = built();
    let bytes = space.read("out/model.kiln");
    fs::remove_file(space.path("out/model.kiln")).unwrap();
    let mut damaged = 0;
    for (path, mut content) in cache_files(&space) {
        if path.contains("blobs") && content.len() > 64 {
            let middle = content.len() / 2;
            content[middle] ^= 0x40;
            fs::write(&path, content).unwrap();
            damaged += 1;
        }
    }
    assert!(damaged > 0, "there are blobs to damage");
    space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(0);
    assert_eq!(space.read("out/model.kiln"), bytes);
}

#[test]
fn a_lost_cache_costs_time_only() {
    let space = built();
    let bytes = space.read("out/model.kiln");
    fs::remove_dir_all(space.path(".kiln")).unwrap();
    space.build();
    assert_eq!(space.read("out/model.kiln"), bytes);
}

#[test]
fn a_dry_run_says_what_would_run_and_runs_nothing() {
    let space = small("cube.glb");
    let report = space.run(["build", "pipeline.toml", "--dry-run", "--json", "--backend", "cpu"]).expect(0).json();
    assert_eq!(report["assets"][0]["stages"][0]["state"], "would-run", "{report:#}");
    assert!(!space.path("out/model.kiln").exists());
}

#[test]
fn a_changed_model_that_simplifies_to_the_same_stops_the_wave() {
    // The material's name reaches pack and bake, never the geometry.
    let space = Space::new();
    space.write("pipeline.toml", crate::space::SMALL.replace("model.glb", "model.gltf"));
    space.write("model.gltf", quad_gltf("first"));
    space.build();
    space.write("model.gltf", quad_gltf("second"));
    let stages = ran(&space.build());
    assert!(stages.contains(&"import".to_owned()), "{stages:?}");
    for geometry in ["whole", "base", "base, collapse", "atlas", "lods", "lods, collapse"] {
        assert!(!stages.contains(&geometry.to_owned()), "{geometry} ran: {stages:?}");
    }
}

/// A grid of 8 x 8 quads in one self-contained file, with a material of that name.
pub(crate) fn quad_gltf(material: &str) -> String {
    let side = 9_u16;
    let mut bytes = Vec::new();
    for y in 0..side {
        for x in 0..side {
            let height = if (x + y) % 3 == 0 { 0.05_f32 } else { 0.0 };
            for value in [f32::from(x), height, f32::from(y)] {
                bytes.extend(value.to_le_bytes());
            }
        }
    }
    let positions = bytes.len();
    for y in 0..side - 1 {
        for x in 0..side - 1 {
            let a = y * side + x;
            for index in [a, a + side, a + 1, a + 1, a + side, a + side + 1] {
                bytes.extend(index.to_le_bytes());
            }
        }
    }
    let (points, indices) = (u32::from(side) * u32::from(side), u32::from(side - 1) * u32::from(side - 1) * 6);
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"material":0}}]}}],"materials":[{{"name":"{material}"}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":{points},"type":"VEC3","min":[0,0,0],"max":[8,0.05,8]}},
{{"bufferView":1,"componentType":5123,"count":{indices},"type":"SCALAR"}}],
"bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":{positions}}},{{"buffer":0,"byteOffset":{positions},"byteLength":{}}}],
"buffers":[{{"byteLength":{},"uri":"data:application/octet-stream;base64,{}"}}]}}"#,
        bytes.len() - positions,
        bytes.len(),
        base64(&bytes)
    )
}

fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::new();
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().fold(0_u32, |word, byte| word << 8 | u32::from(*byte)) << (8 * (3 - chunk.len()));
        for k in 0..4 {
            let sextet = (word >> (18 - 6 * k)) & 63;
            out.push(if k <= chunk.len() { ALPHABET[sextet as usize] as char } else { '=' });
        }
    }
    out
}

fn copy(from: &std::path::Path, to: &std::path::Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// Every file of the cache with its bytes.
pub(crate) fn cache_files(space: &Space) -> Vec<(String, Vec<u8>)> {
    let mut found = Vec::new();
    let mut folders = vec![space.path(".kiln")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                found.push((path.to_string_lossy().into_owned(), fs::read(&path).unwrap()));
            }
        }
    }
    found.sort();
    found
}

/// A pipeline over all models of `models/`, without atlas and bake.
pub(crate) const MANY: &str = r#"
kiln = 1
[asset]
input = "models/*.gltf"
output = "out/{name}.kiln"
[[stage]]
id = "whole"
kind = "merge"
[[stage]]
id = "lods"
kind = "simplify"
levels = [{ keep = 1.0 }, { keep = 0.5 }]
[[stage]]
kind = "pack"
"#;

pub(crate) fn many() -> Space {
    let space = Space::new();
    space.write("pipeline.toml", MANY);
    for name in ["a", "b", "c"] {
        space.write(&format!("models/{name}.gltf"), quad_gltf(name));
    }
    space.build();
    // What makes the plan was too young to be known; it is now.
    assert_ran(&space.build(), &[]);
    assert_ran(&space.build(), &[]);
    space
}

/// The assets of which a stage ran or the output was written.
pub(crate) fn touched(report: &Value) -> Vec<&str> {
    let assets = report["assets"].as_array().unwrap().iter();
    let done = |asset: &&Value| {
        asset["state"] == "written" || asset["stages"].as_array().unwrap().iter().any(|stage| stage["state"] == "ran")
    };
    assets.filter(done).map(|asset| asset["input"].as_str().unwrap()).collect()
}

#[test]
fn one_changed_model_of_several_runs_its_own_stages_and_the_others_are_still_told_of() {
    let space = many();
    space.write("models/b.gltf", quad_gltf("bee"));
    let report = space.build();
    assert_eq!(touched(&report), ["models/b.gltf"]);
    assert_ran(&report, &["import", "pack"]);
    let named: Vec<_> = report["assets"].as_array().unwrap().iter().map(|a| a["input"].as_str().unwrap()).collect();
    assert_eq!(named, ["models/a.gltf", "models/b.gltf", "models/c.gltf"]);
    assert_eq!(report["assets"][0]["stages"].as_array().unwrap().len(), 5, "{report:#}");
    let said = space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(0).stderr;
    assert!(said.contains("nothing to do, 3 assets and 15 stages are fresh"), "{said}");
    space.write("models/c.gltf", quad_gltf("sea"));
    let said = space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(0).stderr;
    assert!(said.contains("2 of 15 stages ran") && !said.contains("a.gltf"), "{said}");
}

#[test]
fn a_new_and_a_removed_model_are_noticed_by_the_listing() {
    let space = many();
    space.write("models/d.gltf", quad_gltf("d"));
    assert_eq!(touched(&space.build()), ["models/d.gltf"]);
    fs::remove_file(space.path("models/a.gltf")).unwrap();
    let report = space.build();
    assert!(touched(&report).is_empty());
    assert_eq!(report["assets"].as_array().unwrap().len(), 3);
}

#[test]
fn a_changed_parent_pipeline_reaches_what_it_changes() {
    let space = Space::new();
    space.write("common.toml", MANY);
    space.write("pipeline.toml", "kiln = 1\nbase = \"common.toml\"\n");
    space.write("models/a.gltf", quad_gltf("a"));
    space.build();
    space.build();
    assert_ran(&space.build(), &[]);
    space.write("common.toml", format!("# a comment\n{MANY}"));
    assert_ran(&space.build(), &[]);
    space.write("common.toml", MANY.replace("keep = 0.5", "keep = 0.4"));
    assert_ran(&space.build(), &["lods", "pack"]);
}

#[test]
fn an_override_reaches_the_models_that_it_matches_and_no_other() {
    let space = many();
    let over = |keep: &str| {
        let text = format!(
            "{MANY}[[override]]\nmatch = \"b.gltf\"\nset = {{ \"stage.lods.levels\" = [{{ keep = {keep} }}] }}\n"
        );
        space.write("pipeline.toml", text);
        let report = space.build();
        assert_ran(&report, &["lods", "pack"]);
        assert_eq!(touched(&report), ["models/b.gltf"]);
        assert_ran(&space.build(), &[]);
    };
    over("0.3");
    over("0.2");
    // Without it b is as it was: its stages come out of the cache.
    space.write("pipeline.toml", MANY);
    let report = space.build();
    assert_ran(&report, &[]);
    assert_eq!(touched(&report), ["models/b.gltf"]);
}

#[test]
fn a_depfile_names_external_buffers_and_material_libraries() {
    let space = Space::new();
    space.write("pipeline.toml", MANY.replace(", { keep = 0.5 }", "").replace("*.gltf", "*.*"));
    let triangle = |height: f32| [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, height, 0.0]];
    space.gltf("models/b", &triangle(1.0), None, &[[0, 1, 2]]);
    // The buffer lies beside the pipeline, as the helper writes it.
    let text = String::from_utf8(space.read("models/b.gltf")).unwrap();
    space.write("models/b.gltf", text.replace("data.bin", "parts/data.bin"));
    space.write("models/parts/data.bin", space.read("data.bin"));
    space.write("models/o.obj", "mtllib parts/o.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n");
    space.write("models/parts/o.mtl", "newmtl red\nKd 1 0 0\n");
    space.build();
    space.build();
    assert!(touched(&space.build()).is_empty());
    space.gltf("models/b", &triangle(2.0), None, &[[0, 1, 2]]);
    space.write("models/b.gltf", text.replace("data.bin", "parts/data.bin"));
    space.write("models/parts/data.bin", space.read("data.bin"));
    assert_eq!(touched(&space.build()), ["models/b.gltf"]);
    space.write("models/parts/o.mtl", "newmtl red\nKd 1 1 0\n");
    assert_eq!(touched(&space.build()), ["models/o.obj"]);
    let depfile = space.path("all.d");
    space.run(["build", "pipeline.toml", "--backend", "cpu", "--depfile", "all.d"]).expect(0);
    let text = fs::read_to_string(&depfile).unwrap();
    for path in
        ["pipeline.toml", "models", "models/b.gltf", "models/parts/data.bin", "models/o.obj", "models/parts/o.mtl"]
    {
        assert!(text.lines().any(|line| line.trim_start().trim_end_matches(" \\") == path), "{path} is not in\n{text}");
    }
    let stamp = fs::metadata(&depfile).unwrap().modified().unwrap();
    space.run(["build", "pipeline.toml", "--backend", "cpu", "--depfile", "all.d"]).expect(0);
    assert_eq!(fs::metadata(&depfile).unwrap().modified().unwrap(), stamp, "written only if it differs");
    fs::remove_file(&depfile).unwrap();
    space.run(["build", "pipeline.toml", "--backend", "cpu", "--depfile", "all.d"]).expect(0);
    assert_eq!(fs::read_to_string(&depfile).unwrap(), text, "a build without work writes it too");
}

#[test]
fn a_dry_run_as_json_prints_the_pipeline_with_all_defaults_for_each_model() {
    let space = Space::new();
    space.write("common.toml", MANY);
    let over = "[[override]]\nmatch = \"b.gltf\"\nset = { \"stage.lods.levels\" = [{ keep = 0.3 }] }\n";
    space.write("pipeline.toml", format!("kiln = 1\nbase = \"common.toml\"\n{over}"));
    for name in ["a", "b"] {
        space.write(&format!("models/{name}.gltf"), quad_gltf(name));
    }
    let report = space.run(["build", "pipeline.toml", "--dry-run", "--json", "--backend", "cpu"]).expect(0).json();
    let resolved = |asset: usize| report["assets"][asset]["resolved"].as_str().unwrap();
    assert!(resolved(0).contains("placement") && resolved(0).contains("0.5"), "{}", resolved(0));
    assert!(resolved(1).contains("0.3") && !resolved(1).contains("0.5 }"), "{}", resolved(1));
}

#[test]
fn a_failed_model_fails_each_build_and_keeps_no_other_from_being_fresh() {
    let space = many();
    space.write("models/b.gltf", "{}");
    for _ in 0..2 {
        let ran = space.run(["build", "pipeline.toml", "--backend", "cpu", "--keep-going"]).expect(2);
        assert!(ran.stderr.contains("b.gltf"), "{}", ran.stderr);
    }
    space.write("models/b.gltf", quad_gltf("b"));
    space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(0);
    assert_ran(&space.build(), &[]);
}

#[test]
fn verify_finds_the_stages_consistent_and_writes_nothing() {
    let space = small("cube.glb");
    let said = space.run(["build", "pipeline.toml", "--backend", "cpu", "--verify"]).expect(0).stderr;
    assert!(said.contains("9 stages ran twice, 0 of them gave other bytes"), "{said}");
    assert!(!space.path("out/model.kiln").exists());
}
