//! Continuous layouts from pipeline to engine: what the command packs, an engine picks, and the command shows.

use kiln_format::{AlignedBytes, Container};
use kiln_runtime::{Lods, View};
use serde_json::Value;

use crate::space::{Space, copied, ran};

/// The example's containers, and the report of their build.
fn built(pipeline: &str) -> (Space, Value) {
    let space = copied(pipeline);
    let path = format!("pipelines/{pipeline}");
    let report = space.run(["build", &path, "--backend", "cpu", "--json"]).expect(0).json();
    for asset in report["assets"].as_array().unwrap() {
        space.run(["check", &format!("pipelines/{}", asset["output"].as_str().unwrap())]).expect(0);
    }
    (space, report)
}

fn inspected(space: &Space, container: &str) -> Value {
    space.run(["inspect", container, "--json"]).expect(0).json()
}

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("no number: {value}"))
}

#[test]
fn a_sliding_window_holds_every_level_in_one_vertex_buffer_and_leaves_at_any_count() {
    let (space, _) = built("sliding-window.toml");
    let container = "pipelines/build/sliding-window/pot.kiln";
    let found = inspected(&space, container);
    assert_eq!(found["version"], "1.2");
    let count = |kind: &str| found["sections"].as_array().unwrap().iter().filter(|s| s["kind"] == kind).count();
    assert_eq!((count("VERT"), count("INDX"), count("WNDW")), (1, 3, 1), "{found:#}");
    let window = &found["layouts"][0];
    assert_eq!(window["name"], "sliding-window");

    // Each level is a checkpoint, with its own count and error.
    let checkpoints = window["checkpoints"].as_array().unwrap();
    for level in found["levels"].as_array().unwrap() {
        let named = checkpoints.iter().find(|c| c["level"] == level["lod"]).expect("a checkpoint for each level");
        assert_eq!(named["triangles"], level["triangles"]);
        assert!(named["error"].as_f64() >= level["error"].as_f64(), "{named} {level}");
    }
    assert!(checkpoints.len() >= 20, "{checkpoints:?}");

    // What the window draws at a level's count is the level.
    let triangles = number(&found["levels"][1]["triangles"]);
    let same = [&format!("{container}#1"), &format!("{container}#sliding-window:{triangles}")];
    let compared = space.run(["compare", same[0], same[1], "--views", "2", "--json"]).expect(0).json();
    let apart = compared["relative_distance"]["hausdorff"].as_f64().unwrap();
    assert!(apart < 1e-6 && compared["silhouette"]["xor"] == 0.0, "the same triangles: {compared:#}");

    // Any other count, too, to within what one collapse takes.
    space.run(["export", container, "--level", "sliding-window:12345", "-o", "pot.glb"]).expect(0);
    let compared = space.run(["compare", container, "pot.glb", "--views", "2", "--json"]).expect(0).json();
    let left = number(&compared["other"]["triangles"]);
    assert!((12_335..=12_345).contains(&left), "{left} triangles");
}

#[test]
fn an_engine_chooses_from_a_sliding_window_by_budget_error_and_view() {
    let (space, _) = built("sliding-window.toml");
    let bytes = AlignedBytes::copy_of(&space.read("pipelines/build/sliding-window/pot.kiln"));
    let lods = Lods::open(&bytes).unwrap();
    let window = lods.window().expect("the container has one");
    let [finest, coarsest] = [u64::MAX, 0].map(|budget| window.lod_for_triangles(budget).detail());
    assert_eq!((finest, coarsest), (0, window.collapses()));
    let view = |distance| View { distance, vertical_fov_radians: 0.8, viewport_height_px: 1080.0 };
    let [near, far] = [0.2, 50.0].map(|distance| window.lod_for_view(&view(distance), 1.0).detail());
    assert!(near < far, "nearer is finer: {near} {far}");
}

#[test]
fn octrees_of_every_fixture_are_sound_and_leave_as_exr_and_as_glb() {
    let (space, report) = built("octree.toml");
    assert!(report["assets"].as_array().unwrap().len() >= 2);
    let container = "pipelines/build/octree/sphere.kiln";
    let found = inspected(&space, container);
    let names: Vec<&str> = found["layouts"].as_array().unwrap().iter().map(|l| l["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["tree-leaf", "compact-tree"]);
    assert_eq!(found["levels"].as_array().unwrap().len(), 1, "without layout `discrete` the finest level alone");
    assert_eq!(found["layouts"][0]["checkpoints"], found["layouts"][1]["checkpoints"]);

    // Both layouts draw the same.
    for layout in ["tree-leaf", "compact-tree"] {
        let file = format!("{layout}.glb");
        space.run(["export", container, "--level", &format!("{layout}:300"), "-o", &file]).expect(0);
    }
    assert_eq!(space.read("tree-leaf.glb"), space.read("compact-tree.glb"));

    space.run(["export", container, "--trees", "trees"]).expect(0);
    let [tree, leaf, counts] = ["tree", "leaf", "counts"].map(|name| space.read(&format!("trees/{name}.exr")));
    let bytes = AlignedBytes::copy_of(&space.read(container));
    let opened = Container::open(&bytes).unwrap();
    let (back, view) = (kiln_pack::trees::read(&tree, &leaf, &counts).unwrap(), opened.layouts().tree_leaf.unwrap());
    let bits = |texels: &[[f32; 4]]| texels.iter().map(|t| t.map(f32::to_bits)).collect::<Vec<_>>();
    assert_eq!((bits(&back.tree), bits(&back.leaf)), (bits(view.tree), bits(view.leaf)));
    assert_eq!((&back.row_starts[..], &back.face_counts[..]), (view.row_starts, view.face_counts));
    assert!(kiln_pack::trees::read(&leaf, &tree, &counts).is_err(), "exchanged files are refused");
}

#[test]
fn clusters_leave_at_any_count_without_their_numbers_growing() {
    let (space, _) = built("clusters.toml");
    let container = "pipelines/build/clusters/pot.kiln";
    let found = inspected(&space, container);
    assert_eq!(found["layouts"][0]["name"], "clusters");
    let all = number(&found["levels"][0]["triangles"]);
    let mut last = all;
    for wanted in [all, all / 2, all / 4, all / 8] {
        let name = format!("{container}#clusters:{wanted}");
        let compared = space.run(["compare", container, &name, "--views", "1", "--json"]).expect(0).json();
        let left = number(&compared["other"]["triangles"]);
        assert!(left <= wanted && left <= last, "{left} of at most {wanted}");
        last = left;
    }
    assert!(last > 0);
}

#[test]
fn small_files_hold_what_plain_ones_hold_in_less_than_half_the_bytes() {
    let (space, _) = built("small-files.toml");
    let small = space.read("pipelines/build/small-files/pot.kiln");
    let plain = ["--set", "stage.pack.vertices=own", "--set", "stage.pack.compression=none"];
    space.run([&["build", "pipelines/small-files.toml", "--backend", "cpu"][..], &plain].concat()).expect(0);
    let large = space.read("pipelines/build/small-files/pot.kiln");
    let levels = |bytes: &[u8]| {
        let aligned = AlignedBytes::copy_of(bytes);
        let container = Container::open(&aligned).unwrap();
        let entries: Vec<_> = container.sections().map(|s| (s.kind.to_string(), s.entry.stored_length)).collect();
        let geometry: u64 = entries.iter().filter(|e| ["VERT", "INDX"].contains(&&*e.0)).map(|e| e.1).sum();
        // By level the corners of all triangles with all that they have, whatever the order of triangles and vertices.
        let corners = (0..container.level_records().len()).map(|lod| {
            let level = container.level(lod).unwrap();
            let mut triangles: Vec<Vec<u32>> = Vec::new();
            for (number, range) in level.ranges.iter().enumerate() {
                for first in (range.first_index..range.first_index + range.index_count).step_by(3) {
                    let mut corners: Vec<Vec<u32>> = (0..3)
                        .map(|k| {
                            let v = level.indices().get((first + k) as usize).unwrap() as usize;
                            let uv = level.uv0().map_or([0.0; 2], |uv| uv[v]);
                            let normal = level.normals().map_or([0.0; 3], |n| n[v]);
                            let floats = level.positions()[v].into_iter().chain(normal).chain(uv);
                            floats.map(f32::to_bits).collect()
                        })
                        .collect();
                    // Rotated to a canonical first corner: the winding stays.
                    let least = (0..3).min_by_key(|k| corners[*k].clone()).unwrap();
                    corners.rotate_left(least);
                    triangles.push([vec![number as u32], corners.concat()].concat());
                }
            }
            triangles.sort_unstable();
            triangles
        });
        (corners.collect::<Vec<_>>(), geometry)
    };
    let (of_small, few) = levels(&small);
    let (of_large, many) = levels(&large);
    assert!(of_small == of_large, "the same triangles at every level");
    assert!(2 * few < many, "{few} bytes of geometry for {many}");
}

#[test]
fn the_coarsest_level_draws_from_a_prefix_of_a_shared_file() {
    let (space, _) = built("sliding-window.toml");
    let container = "pipelines/build/sliding-window/pot.kiln";
    let found = inspected(&space, container);
    let prefix = number(&found["levels"][2]["prefix_bytes"]) as usize;
    let bytes = space.read(container);
    let cut = AlignedBytes::copy_of(&bytes[..prefix]);
    let lods = Lods::open_prefix(&cut).unwrap();
    assert!(lods.level(2).is_some() && lods.level(0).is_none());
    assert_eq!(lods.level(2).unwrap().indices().len() as u64, 3 * number(&found["levels"][2]["triangles"]));
}

#[test]
fn a_changed_picture_or_codec_makes_no_layout_anew_and_a_changed_key_of_it_no_level() {
    let (space, report) = built("sliding-window.toml");
    assert!(ran(&report).contains(&"pack, window".to_owned()), "{report:#}");
    let again = |sets: &[&str]| {
        let mut args = vec!["build", "pipelines/sliding-window.toml", "--backend", "cpu", "--json"];
        sets.iter().for_each(|set| args.extend(["--set", set]));
        ran(&space.run(args).expect(0).json())
    };
    assert_eq!(again(&[]), Vec::<String>::new());
    assert_eq!(again(&["stage.pack.textures=bc"]), ["pack"]);
    assert_eq!(again(&["stage.pack.compression=zstd"]), ["pack"]);
    assert_eq!(again(&["stage.pack.checkpoints=5"]), ["pack, window", "pack"]);
    let all = r#"stage.pack.layouts=["discrete", "sliding-window", "compact-tree", "tree-leaf", "clusters"]"#;
    assert_eq!(again(&[all]), ["pack, tree", "pack, clusters", "pack"]);
    space.run(["check", "pipelines/build/sliding-window/pot.kiln"]).expect(0);
}
