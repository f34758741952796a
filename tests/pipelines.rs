//! Every pipeline in `pipelines/` builds, and what it builds is sound.

use std::fs;

use crate::space::{Space, repository};

/// A copy of `pipelines/` and `fixtures/`, so that nothing is written into the project.
fn copied(pipeline: &str) -> Space {
    let space = Space::new();
    space.write(&format!("pipelines/{pipeline}"), fs::read(repository("pipelines").join(pipeline)).unwrap());
    for entry in fs::read_dir(repository("fixtures")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "glb") {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            space.write(&format!("fixtures/{name}"), fs::read(&path).unwrap());
        }
    }
    space
}

#[test]
fn quickstart_builds_bakes_and_the_second_build_does_nothing() {
    let space = copied("quickstart.toml");
    let args = ["build", "pipelines/quickstart.toml", "--backend", "cpu", "--json"];
    let report = space.run(args).expect(0).json();
    let bake = report["assets"][0]["stages"].as_array().unwrap().iter().find(|s| s["stage"] == "bake").unwrap();
    assert!(bake["report"]["covered"].as_u64().unwrap() > 100_000, "most texels found their place: {bake:#}");
    space.run(["check", "pipelines/build/pot.kiln"]).expect(0);
    let inspected = space.run(["inspect", "pipelines/build/pot.kiln", "--json"]).expect(0).json();
    assert_eq!(inspected["levels"].as_array().unwrap().len(), 3, "{inspected:#}");
    assert!(inspected["textures"].as_array().is_some_and(|t| t.len() >= 3), "{inspected:#}");

    // What an engine does with it.
    let bytes = kiln_format::AlignedBytes::copy_of(&space.read("pipelines/build/pot.kiln"));
    let lods = kiln_runtime::Lods::open(&bytes).unwrap();
    let view = |distance| kiln_runtime::View { distance, vertical_fov_radians: 0.8, viewport_height_px: 1080.0 };
    assert_eq!(lods.choose_level(&view(0.5), 1.0), 0, "near: the finest");
    assert_eq!(lods.choose_level(&view(100.0), 1.0), 2, "far: the coarsest");
    let again = space.run(args).expect(0).json();
    assert_eq!(again["fresh"], true);
}

#[test]
fn own_uvs_builds_every_fixture_and_keeps_its_textures() {
    let space = copied("own-uvs.toml");
    let report = space.run(["build", "pipelines/own-uvs.toml", "--backend", "cpu", "--json"]).expect(0).json();
    for asset in report["assets"].as_array().unwrap() {
        let output = format!("pipelines/{}", asset["output"].as_str().unwrap());
        space.run(["check", &output]).expect(0);
    }
    let inspected = space.run(["inspect", "pipelines/build/own-uvs/pot.kiln", "--json"]).expect(0).json();
    assert!(inspected["textures"].as_array().is_some_and(|t| !t.is_empty()), "{inspected:#}");
}
