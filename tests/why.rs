//! `kiln why` names the first thing that changed.

use std::fs;

use crate::inputs::png;
use crate::rebuild::cache_files;
use crate::space::{SMALL, Space, repository, small};

fn why(space: &Space) -> String {
    space.run(["why", "out/model.kiln", "--backend", "cpu"]).expect(0).stdout
}

#[test]
fn why_says_that_a_fresh_output_would_run_nothing() {
    let space = small("cube.glb");
    space.build();
    let text = why(&space);
    assert!(text.contains("is fresh"), "{text}");
}

#[test]
fn why_names_a_changed_parameter_with_old_and_new_value() {
    let space = small("cube.glb");
    space.build();
    space.write("pipeline.toml", SMALL.replace("padding = 4", "padding = 6"));
    let text = why(&space);
    assert!(text.contains("atlas") && text.contains("padding: 4 -> 6"), "{text}");
}

#[test]
fn why_names_the_changed_image_file() {
    let space = Space::new();
    space.write("pipeline.toml", SMALL.replace("model.glb", "model.gltf"));
    let with_image = crate::rebuild::quad_gltf("painted").replace(
        r#""materials":[{"name":"painted"}]"#,
        r#""materials":[{"name":"painted","pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}],
"textures":[{"source":0}],"images":[{"uri":"paint.png"}]"#,
    );
    space.write("model.gltf", with_image);
    space.write("paint.png", png([200, 10, 10]));
    space.build();
    space.write("paint.png", png([10, 200, 10]));
    let text = why(&space);
    let [old, new] = [[200, 10, 10], [10, 200, 10]].map(|rgb| kiln_engine::ContentHash::of(&png(rgb)).short());
    assert!(text.contains(&format!("paint.png changed: {old} -> {new}")), "{text}");
}

#[test]
fn why_names_a_changed_stage_version() {
    // The version is a constant of the program; an engine of the same cache with another one stands for another program.
    let space = small("cube.glb");
    space.build();
    let options = kiln_pipeline::plan::PlanOptions { backend: kiln::Backend::Cpu, ..Default::default() };
    let mut planned = kiln_pipeline::plan::plan(&space.path("pipeline.toml"), &options).unwrap();
    let atlas = planned.plan.actions.iter_mut().find(|a| a.kind == "atlas").unwrap();
    let version = atlas.version;
    atlas.version += 1;
    let mut engine = kiln_engine::Engine::open(space.path(".kiln"), "pipeline.toml");
    let answer = engine.why(&planned.plan, 0).unwrap();
    let reasons: Vec<String> = answer
        .actions
        .iter()
        .filter_map(|(_, verdict)| match verdict {
            kiln_engine::Verdict::Stale(reason) => Some(reason.to_string()),
            _ => None,
        })
        .collect();
    assert_eq!(reasons, [format!("stage version {version} -> {}", version + 1)]);
}

#[test]
fn why_names_a_missing_output() {
    let space = small("cube.glb");
    space.build();
    fs::remove_file(space.path("out/model.kiln")).unwrap();
    let text = why(&space);
    assert!(text.contains("out/model.kiln is missing"), "{text}");
}

#[test]
fn why_names_a_lost_cache_entry() {
    let space = small("cube.glb");
    space.build();
    for (path, _) in cache_files(&space) {
        if path.contains("blobs") {
            fs::remove_file(path).unwrap();
        }
    }
    fs::remove_file(space.path("out/model.kiln")).unwrap();
    let text = why(&space);
    assert!(text.contains("missing") || text.contains("lost"), "{text}");
}

#[test]
fn why_of_an_unknown_output_says_what_to_do() {
    let space = Space::new();
    space.write("model.glb", fs::read(repository("fixtures/cube.glb")).unwrap());
    let said = space.run(["why", "out/nothing.kiln"]).expect(2).stderr;
    assert!(said.contains("--pipeline"), "{said}");
}

#[test]
fn why_of_an_output_of_a_broken_pipeline_shows_what_is_broken() {
    let space = small("cube.glb");
    space.build();
    space.write("pipeline.toml", SMALL.replace("padding", "pading"));
    let said = space.run(["why", "out/model.kiln"]).expect(2).stderr;
    assert!(said.contains("pading") && said.contains("what is broken above"), "{said}");
}

#[test]
fn explain_says_of_each_stage_what_differs_first() {
    let space = small("cube.glb");
    space.build();
    space.write("pipeline.toml", SMALL.replace("padding = 4", "padding = 6"));
    let said = space.run(["build", "pipeline.toml", "--backend", "cpu", "--explain"]).expect(0).stderr;
    let runs: Vec<_> = said.lines().filter_map(|line| line.split_once(": runs, ")).collect();
    let expected = [
        ("model.glb / atlas", "padding: 4 -> 6"),
        ("model.glb / lods, collapse", "input `in` from atlas changed: "),
        ("model.glb / lods", "input `in` from atlas changed: "),
        ("model.glb / bake", "input `low` from lods changed: "),
        // Not the pipeline's hash, which the container tells and any change changes.
        ("model.glb / pack", "input `levels` from bake changed: "),
    ];
    assert_eq!(runs.len(), expected.len(), "{said}");
    for (run, (stage, reason)) in runs.iter().zip(expected) {
        assert!(
            run.0 == stage && run.1.starts_with(reason) && run.1.contains(" -> "),
            "{run:?}, not {stage}: {reason}"
        );
    }
}
