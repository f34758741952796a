//! Every pipeline in `pipelines/` builds, and what it builds is sound.

use std::fs;

use crate::space::copied;

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

#[test]
fn least_error_builds_every_fixture() {
    let space = copied("least-error.toml");
    let report = space.run(["build", "pipelines/least-error.toml", "--backend", "cpu", "--json"]).expect(0).json();
    for asset in report["assets"].as_array().unwrap() {
        space.run(["check", &format!("pipelines/{}", asset["output"].as_str().unwrap())]).expect(0);
    }
}

#[test]
fn texture_border_builds_and_draws_its_borders_without_a_trace_in_the_cache() {
    let space = copied("texture-border.toml");
    let args = ["build", "pipelines/texture-border.toml", "--json"];
    let report = space.run(args).expect(0).json();
    let stages = report["assets"][0]["stages"].as_array().unwrap();
    let counts = |stage: &serde_json::Value| stage["report"]["texture_border"].clone();
    let counted = stages.iter().map(counts).find(|c| !c.is_null()).expect("the collapse counts its borders");
    let (edges, affected) = (counted["edges"].as_u64().unwrap(), counted["affected"].as_u64().unwrap());
    assert!(affected > 0 && affected < edges, "{counted:#}");

    // Everything is fresh, and the pictures come all the same.
    let container = space.read("pipelines/build/texture-border/pot.kiln");
    let drawn = space.run([&args[..], &["--debug-images", "borders"]].concat()).expect(0).json();
    assert_eq!(drawn["fresh"], true, "a debug flag makes nothing stale");
    let pictures = counted["pictures"].as_array().unwrap().len();
    let folder: Vec<_> = fs::read_dir(space.path("borders")).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(folder.len(), pictures, "{folder:?}");
    for path in folder {
        let picture = image::open(&path).unwrap().into_rgb8();
        for colour in [[255; 3], [40, 110, 230]] {
            assert!(picture.pixels().any(|p| p.0 == colour), "{}: no {colour:?}", path.display());
        }
    }
    assert_eq!(space.read("pipelines/build/texture-border/pot.kiln"), container);
    assert_eq!(space.run(args).expect(0).json()["fresh"], true);
}

#[test]
fn by_views_builds_and_draws_regions_and_views_without_a_trace_in_the_cache() {
    let space = copied("by-views.toml");
    let args = ["build", "pipelines/by-views.toml", "--json"];
    let report = space.run(args).expect(0).json();
    let stages = report["assets"][0]["stages"].as_array().unwrap();
    let counted = stages.iter().map(|s| s["report"]["regions"].clone()).find(|r| !r.is_null()).expect("regions");
    let pictures = counted["pictures"].as_array().unwrap();
    let sum: u64 = pictures.iter().map(|p| p["regions"].as_u64().unwrap()).sum();
    assert!(!pictures.is_empty() && sum >= pictures.len() as u64, "{counted:#}");
    // Materials without a picture have a region each.
    assert!(counted["regions"].as_u64().unwrap() >= sum, "{counted:#}");

    let container = space.read("pipelines/build/by-views/pot.kiln");
    let drawn = space.run([&args[..], &["--debug-images", "views"]].concat()).expect(0).json();
    assert_eq!(drawn["fresh"], true, "a debug flag makes nothing stale");
    let names: Vec<String> =
        fs::read_dir(space.path("views")).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    assert_eq!(names.iter().filter(|n| n.ends_with(".regions.png")).count(), pictures.len(), "{names:?}");
    let sheet = names.iter().find(|n| n.ends_with("lods.views.png")).unwrap_or_else(|| panic!("{names:?}"));
    // Twelve views of 128 pixels, four in a row.
    let sheet = image::open(space.path("views").join(sheet)).unwrap();
    assert_eq!((sheet.width(), sheet.height()), (4 * 136 + 8, 3 * 136 + 8));
    assert_eq!(space.read("pipelines/build/by-views/pot.kiln"), container);
    assert_eq!(space.run(args).expect(0).json()["fresh"], true);
}

#[test]
fn every_key_of_a_metric_of_views_makes_its_collapse_run_again_and_nothing_before_it() {
    let space = copied("by-views.toml");
    let build = |metric: &str| {
        let set = format!("stage.lods.metric={metric}");
        let report = space.run(["build", "pipelines/by-views.toml", "--json", "--set", &set]).expect(0).json();
        let stages = report["assets"][0]["stages"].as_array().unwrap().clone();
        stages
            .iter()
            .filter(|s| s["state"] != "fresh")
            .map(|s| s["stage"].as_str().unwrap().to_owned())
            .collect::<Vec<_>>()
    };
    let base = "kind = \"region-entropy\", views = 4, size = 32";
    build(&format!("{{ {base} }}"));
    assert_eq!(build(&format!("{{ {base}, alpha = 1.0 }}")), [""; 0], "a default that is named changes nothing");
    for key in [
        "alpha = 1.25",
        "update = \"published\"",
        "prepass = 0.9",
        "sigma = 1",
        "k = 200",
        "min-size = 9",
        "reach = 0",
        "side = 64",
    ] {
        let ran = build(&format!("{{ {base}, {key} }}"));
        assert!(ran.iter().any(|stage| stage == "lods, collapse"), "{key}: {ran:?}");
        assert!(!ran.iter().any(|stage| stage.starts_with("near") || stage == "import"), "{key}: {ran:?}");
    }
}

#[test]
fn texel_density_builds_and_gives_each_submesh_its_factor_and_a_time_limit_makes_nothing_stale() {
    let space = copied("texel-density.toml");
    let args = ["build", "pipelines/texel-density.toml", "--backend", "cpu", "--json"];
    let report = space.run(args).expect(0).json();
    space.run(["check", "pipelines/build/texel-density/pot.kiln"]).expect(0);
    let atlas = report["assets"][0]["stages"].as_array().unwrap().iter().find(|s| s["stage"] == "atlas").unwrap();
    let densities = atlas["report"]["densities"].as_array().unwrap();
    let got =
        |name: &str| densities.iter().find(|d| d["submesh"] == name).unwrap()["texels_per_unit"].as_f64().unwrap();
    let ratio = got("lid") / got("base");
    assert!((ratio / 4.0 - 1.0).abs() < 0.02, "{atlas:#}");
    assert_eq!((&atlas["report"]["clean_mip"], &atlas["report"]["clean_mip_bilinear"]), (&2.into(), &2.into()));

    let hasty = [&args[..], &["--set", "stage.atlas.time-limit=0"]].concat();
    assert_eq!(space.run(hasty).expect(0).json()["fresh"], true);
    let vain = [&args[..], &["--set", "stage.atlas.density=[{ name = \"lit\", factor = 2 }]"]].concat();
    let short = space.run(vain).expect(1).json();
    assert!(short["short"][0].as_str().unwrap().contains("\"lit\" matches no submesh"), "{short:#}");
}

#[test]
fn every_map_lies_in_the_container_and_leaves_as_files() {
    let space = copied("every-map.toml");
    let args = ["build", "pipelines/every-map.toml", "--backend", "cpu", "--json"];
    let report = space.run(args).expect(0).json();
    let bake = report["assets"][0]["stages"].as_array().unwrap().iter().find(|s| s["stage"] == "bake").unwrap();
    assert_eq!(bake["report"]["sheets"], 2, "{bake:#}");
    let count = |key: &str| bake["report"][key].as_u64().unwrap();
    assert!(count("owned") > 20_000 && count("missed") * 1000 < count("owned"), "{bake:#}");
    let container = "pipelines/build/every-map/pot.kiln";
    space.run(["check", container]).expect(0);
    let (_, materials, pictures) = kiln_pack::unpack_pictures(&space.read(container)).unwrap();
    // Two sheets of four maps of materials and ten others.
    assert_eq!((pictures.len(), materials.extras.len()), (28, 20));
    for kind in kiln_asset::ExtraMap::ALL {
        let sheets: Vec<u32> = materials.extras.iter().filter(|e| e.kind == kind).map(|e| e.sheet).collect();
        assert_eq!(sheets, [0, 1], "{}", kind.name());
    }
    space.run(["export", container, "--textures", "files"]).expect(0);
    let files = fs::read_dir(space.path("files")).unwrap().map(|e| e.unwrap().path());
    let (png, exr): (Vec<_>, Vec<_>) = files.partition(|f| f.extension().is_some_and(|e| e == "png"));
    // Heights, places, two kinds of numbers and curvature are floats.
    assert_eq!((png.len(), exr.len()), (18, 10));
    for format in ["exr", "ktx2"] {
        space.run(["export", container, "--textures", format, "--format", format]).expect(0);
        assert_eq!(fs::read_dir(space.path(format)).unwrap().count(), 28, "{format}");
    }
}

#[test]
fn a_shared_layout_is_baked_without_an_atlas() {
    let space = copied("shared-layout.toml");
    let args = ["build", "pipelines/shared-layout.toml", "--backend", "cpu", "--json"];
    let report = space.run(args).expect(0).json();
    let bake = report["assets"][0]["stages"].as_array().unwrap().iter().find(|s| s["stage"] == "bake").unwrap();
    assert!(bake["report"]["covered"].as_u64().unwrap() > 256 * 128, "{bake:#}");
    space.run(["check", "pipelines/build/shared-layout/seam-plane.kiln"]).expect(0);
}
