//! Readers in C, JavaScript and Kaitai Struct give the summary that `kiln inspect --json` gives, for every kind of container that
//! the tests build.
//!
//! Summaries are compared as parsed JSON: integers are equal, other numbers round to the same f32 (the readers print the shortest
//! decimal of each f32, `serde_json` another form of the same number).

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::LazyLock;

use kiln_format::layout::Checkpoint;
use kiln_format::record::NONE;
use kiln_format::{
    AlignedBytes, Container, Content, ErrorKind, Layouts, LevelContent, PrivateSection, Semantic, SubmeshContent, write,
};
use serde_json::Value;

use crate::space::copied;
use crate::space::{Space, needs, repository, small};

/// A container and what `kiln inspect --json` says about it.
struct Built {
    path: PathBuf,
    inspected: Value,
}

/// Every container, built once; they lie in cargo's folder for tests.
static CONTAINERS: LazyLock<Vec<Built>> = LazyLock::new(|| {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("readers");
    std::fs::create_dir_all(&folder).unwrap();
    let mut built = Vec::new();
    let mut keep = |name: &str, space: &Space, container: &str| {
        let mut inspected = space.run(["inspect", container, "--json"]).expect(0).json();
        let fields = inspected.as_object_mut().unwrap();
        fields.entry("layouts").or_insert_with(|| layouts_of(&space.read(container)));
        let path = folder.join(format!("{name}.kiln"));
        std::fs::copy(space.path(container), &path).unwrap();
        built.push(Built { path, inspected });
    };
    for fixture in ["boundary-pair", "cube", "sphere", "triangle"] {
        let space = small(&format!("{fixture}.glb"));
        // Some of these are too small for what is asked of them, which is said and ends with 1.
        let ran = space.run(["build", "pipeline.toml", "--backend", "cpu"]);
        if space.path("out/model.kiln").is_file() {
            keep(fixture, &space, "out/model.kiln");
        } else {
            assert_eq!(ran.code, 2, "{fixture}: {}", ran.stderr);
        }
    }
    let space = small("boundary-pair.glb");
    space.run(["build", "pipeline.toml", "--backend", "cpu", "--set", "stage.pack.textures=bc"]).expect(0);
    keep("blocks", &space, "out/model.kiln");
    for pipeline in ["own-uvs", "least-error", "every-map", "shared-layout"] {
        let space = copied(&format!("{pipeline}.toml"));
        let args = ["build", &format!("pipelines/{pipeline}.toml"), "--backend", "cpu", "--json"];
        let report = space.run(args).expect(0).json();
        for (number, asset) in report["assets"].as_array().unwrap().iter().enumerate() {
            let output = format!("pipelines/{}", asset["output"].as_str().unwrap());
            keep(&format!("{pipeline}-{number}"), &space, &output);
        }
    }
    let space = Space::new();
    space.write("hand.kiln", by_hand());
    keep("hand", &space, "hand.kiln");
    // Every layout, shared vertices, every codec.
    for seed in ["layered", "meshopt", "zstd"] {
        space.write(
            "seed.kiln",
            std::fs::read(repository("fuzz/seeds/container").join(format!("{seed}.kiln"))).unwrap(),
        );
        keep(seed, &space, "seed.kiln");
    }
    built
});

/// What no pipeline makes: names that JSON must escape, an empty level, a private section, no provenance.
fn by_hand() -> Vec<u8> {
    let positions: Vec<u8> =
        [0.1f32, -0.0, 1e-40, 3.0, 0.3, 16777216.0, 7.0, 1.0 / 3.0, 1e30].map(f32::to_le_bytes).concat();
    let level = |error: f32, error_kind, indices, count| LevelContent {
        error,
        error_kind,
        arrays: vec![(Semantic::Positions, positions.as_slice())],
        indices,
        index_counts: vec![0, count],
        shares_vertices: false,
    };
    let names = ["", "tab\t \"quoted\" \\ \u{1} é 漢 🙂 </script>"];
    let submesh =
        |name: &str| SubmeshContent { name: name.into(), material: None, attributes: 2, source_triangles: u32::MAX };
    let levels = vec![
        level(0.0, ErrorKind::Bound, &[0, 1, 2][..], 3),
        level(1.0 / 3.0, ErrorKind::Sampled, &[2, 1, 0][..], 3),
        level(f32::MAX, ErrorKind::Sampled, &[][..], 0),
    ];
    let bytes = std::borrow::Cow::Borrowed(&b"anything"[..]);
    let private =
        PrivateSection { kind: kiln_format::Kind(*b"test"), version: 7, required: false, payload: true, bytes };
    let content = Content {
        source_triangles: u32::MAX,
        levels,
        submeshes: names.map(submesh).into(),
        private: vec![private],
        ..Content::default()
    };
    write(&content).unwrap()
}

/// What the summary says of a container's layouts, from the reference reader.
fn layouts_of(bytes: &[u8]) -> Value {
    let aligned = AlignedBytes::copy_of(bytes);
    let container = Container::open(&aligned).unwrap();
    let Layouts { window, tree_leaf, compact_tree, clusters } = container.layouts();
    let stored = |kinds: &[&str]| -> u64 {
        container.sections().filter(|s| kinds.contains(&&*s.kind.to_string())).map(|s| s.entry.stored_length).sum()
    };
    let points = |checkpoints: &[Checkpoint]| -> Vec<Value> {
        let level = |level: u32| (level != NONE).then_some(level);
        let point = |c: &Checkpoint| {
            serde_json::json!({
                "detail": c.detail, "vertices": c.vertices, "triangles": c.triangles, "error": c.error,
                "level": level(c.level),
            })
        };
        checkpoints.iter().map(point).collect()
    };
    let entry = |name: &str, kinds: &[&str], details: u32, triangles: u32, checkpoints: &[Checkpoint]| {
        serde_json::json!({
            "name": name, "bytes": stored(kinds), "details": details, "triangles": triangles,
            "checkpoints": points(checkpoints),
        })
    };
    let last = |counts: &[u32]| *counts.last().unwrap();
    let entries = [
        window.map(|w| entry("sliding-window", &["WNDW"], w.header.collapses, w.header.triangles, w.checkpoints)),
        tree_leaf.map(|t| entry("tree-leaf", &["TREE", "LEAF"], t.header.nodes, last(t.face_counts), t.checkpoints)),
        compact_tree.map(|t| entry("compact-tree", &["CTRE"], t.header.nodes, last(t.face_counts), t.checkpoints)),
        clusters.map(|c| entry("clusters", &["CLUS"], c.header.clusters, c.header.triangles, &[])),
    ];
    Value::Array(entries.into_iter().flatten().collect())
}

/// Where two summaries differ.
fn difference(at: &str, expected: &Value, found: &Value) -> Option<String> {
    let differs = || Some(format!("{at}: expected {expected}, found {found}"));
    match (expected, found) {
        (Value::Object(a), Value::Object(b)) => {
            let keys =
                |map: &serde_json::Map<String, Value>| map.keys().cloned().collect::<std::collections::BTreeSet<_>>();
            if keys(a) != keys(b) {
                return Some(format!("{at}: expected fields {:?}, found {:?}", keys(a), keys(b)));
            }
            a.iter().find_map(|(key, value)| difference(&format!("{at}.{key}"), value, &b[key]))
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            a.iter().zip(b).enumerate().find_map(|(i, (a, b))| difference(&format!("{at}[{i}]"), a, b))
        }
        (Value::Number(a), Value::Number(b)) => {
            let is_same = match (a.as_u64(), b.as_u64()) {
                (Some(a), Some(b)) => a == b,
                _ => a.as_f64().map(|x| x as f32) == b.as_f64().map(|x| x as f32),
            };
            if is_same { None } else { differs() }
        }
        _ if expected == found => None,
        _ => differs(),
    }
}

/// What a program printed, which must have gone well.
#[track_caller]
fn printed(output: Output) -> String {
    let (stdout, stderr) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{}\n{stdout}\n{stderr}", output.status);
    stdout.into_owned()
}

/// A line for each container must be its summary.
#[track_caller]
fn compare(lines: &str) {
    let lines: Vec<&str> = lines.lines().collect();
    assert_eq!(lines.len(), CONTAINERS.len());
    for (built, line) in CONTAINERS.iter().zip(lines) {
        let found: Value =
            serde_json::from_str(line).unwrap_or_else(|e| panic!("{}: {e}: {line}", built.path.display()));
        let difference = difference("", &built.inspected, &found);
        assert!(difference.is_none(), "{}{}", built.path.display(), difference.unwrap_or_default());
    }
}

fn node(arguments: &[&str], folder: &str) -> Option<Command> {
    let is_there = Command::new("node").arg("--version").output().is_ok();
    needs(is_there.then_some(()), "Node")?;
    let mut command = Command::new("node");
    command.args(arguments).current_dir(repository(folder));
    Some(command)
}

/// The packages of `tests/readers`.
fn packages() -> Option<()> {
    needs(repository("tests/readers/node_modules").is_dir().then_some(()), "`npm ci` in tests/readers")
}

#[test]
fn javascript_gives_the_summary_of_every_container() {
    let arguments = ["summary.mjs", "--decoders", "../../tests/readers/decoders.mjs"];
    let (Some(mut node), Some(())) = (node(&arguments, "formats/js"), packages()) else { return };
    compare(&printed(node.args(CONTAINERS.iter().map(|built| &built.path)).output().unwrap()));
}

#[test]
fn a_parser_generated_by_kaitai_struct_gives_the_summary_of_every_container() {
    let (Some(mut node), Some(())) = (node(&["kaitai.mjs"], "tests/readers"), packages()) else { return };
    compare(&printed(node.args(CONTAINERS.iter().map(|built| &built.path)).output().unwrap()));
}

#[test]
fn c_gives_the_summary_of_every_container() {
    let has_compiler = Command::new("cc").arg("--version").output().is_ok();
    if needs(has_compiler.then_some(()), "a C compiler").is_none() {
        return;
    }
    // Cargo builds the static library beside the Rust one, where this program's own parts lie.
    let library = std::env::current_exe().unwrap().with_file_name("libkiln_capi.a");
    let space = Space::new();
    let program = space.path("summary");
    let compiled = Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O1", "-I"])
        .arg(repository("crates/kiln-capi/include"))
        .arg(repository("crates/kiln-capi/examples/summary.c"))
        .arg(&library)
        .args(["-lpthread", "-ldl", "-lm", "-lstdc++", "-o"])
        .arg(&program)
        .output();
    printed(compiled.unwrap());
    let summary = |built: &Built| printed(Command::new(&program).arg(&built.path).output().unwrap());
    compare(&CONTAINERS.iter().map(summary).collect::<String>());
}

#[test]
fn the_javascript_reader_passes_its_own_tests() {
    let tests = ["blake3.test.mjs", "kiln.test.mjs", "layouts.test.mjs"];
    let Some(mut node) = node(&["--test"], "formats/js") else { return };
    printed(node.args(tests).output().unwrap());
}

#[test]
fn the_generated_parser_passes_its_own_tests() {
    let (Some(mut node), Some(())) = (node(&["--test", "kaitai.test.mjs"], "tests/readers"), packages()) else {
        return;
    };
    printed(node.output().unwrap());
}
