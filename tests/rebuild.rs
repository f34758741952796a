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

fn assert_ran(report: &Value, expected: &[&str]) {
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
fn another_thread_count_runs_nothing() {
    let space = built();
    let report = space.run(["build", "pipeline.toml", "--backend", "cpu", "--jobs", "1", "--json"]).expect(0).json();
    assert_ran(&report, &[]);
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
