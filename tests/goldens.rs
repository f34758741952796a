//! A stage whose output changes without a new version fails here.
//!
//! `goldens/stages.txt` has a line for each action of two fixtures and some examples: kind, version, fingerprint, and a digest of its outputs. Equal
//! fingerprint and another digest means that the stage gives other bytes for the same inputs, parameters and version: raise its
//! `VERSION`. After a rightful change, `KILN_BLESS=1 cargo test goldens` writes the file anew; it refuses the case above.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use kiln_engine::{BuildOptions, ContentHash, Engine, NoObserver};
use kiln_pipeline::plan::{PlanOptions, plan};

use crate::space::{copied, repository, small};

/// Examples with continuous layouts and with budgets for submeshes.
const EXAMPLES: [&str; 4] = ["by-parts.toml", "clusters.toml", "octree.toml", "sliding-window.toml"];

/// Where a kind of stage says its version, below `crates/kiln-pipeline/src/stages`.
const VERSIONS: [(&str, &str); 11] = [
    ("import", "VERSION in import.rs"),
    ("merge", "VERSION in merge.rs"),
    ("simplify", "COLLAPSE_VERSION in simplify.rs"),
    ("parts", "PARTS_VERSION in simplify.rs"),
    ("levels", "LEVELS_VERSION in simplify.rs"),
    ("atlas", "VERSION in atlas.rs"),
    ("bake", "VERSION in bake.rs"),
    ("window", "WINDOW_VERSION in continuous.rs"),
    ("tree", "TREE_VERSION in continuous.rs"),
    ("clusters", "CLUSTERS_VERSION in continuous.rs"),
    ("pack", "VERSION in pack.rs"),
];

/// Key (fixture, stage, kind, version) to (fingerprint, digest of outputs).
fn measured() -> BTreeMap<String, (String, String)> {
    let mut lines = BTreeMap::new();
    for fixture in ["cube.glb", "boundary-pair.glb"] {
        measure(fixture, &small(fixture).path("pipeline.toml"), &mut lines);
    }
    // The kinds that the common chain has not.
    for pipeline in EXAMPLES {
        let space = copied(pipeline);
        measure(pipeline, &space.path(&format!("pipelines/{pipeline}")), &mut lines);
    }
    lines
}

fn measure(name: &str, pipeline: &Path, lines: &mut BTreeMap<String, (String, String)>) {
    let options = PlanOptions { backend: kiln::Backend::Cpu, ..PlanOptions::default() };
    let planned = plan(pipeline, &options).unwrap();
    let mut engine = Engine::open(pipeline.with_file_name(".kiln"), "pipeline.toml");
    let report = engine.build(&planned.plan, &BuildOptions::default(), &NoObserver).unwrap();
    assert!(report.succeeded(), "{report:?}");
    for (index, stage) in &planned.assets[0].actions {
        let (action, done) = (&planned.plan.actions[*index], &report.actions[*index]);
        let record = done.record.as_ref().unwrap();
        let outputs: String = record.outputs.iter().map(|o| format!("{} {}\n", o.name, o.hash.hex())).collect();
        let key = format!("{name} | {stage} | {} v{}", action.kind, action.version);
        let fingerprint = ContentHash(record.fingerprint.0).short();
        lines.insert(key, (fingerprint, ContentHash::of(outputs.as_bytes()).short()));
    }
}

/// The kind in `fixture | stage | kind vN`.
fn kind_of(key: &str) -> &str {
    key.rsplit(" | ").next().and_then(|kind| kind.split(" v").next()).unwrap_or_default()
}

/// What to do about stages that give other bytes without a new version. What comes after one was given other inputs, and is none.
fn advice(broken: &[&String]) -> String {
    let mut text = String::from("stages that give other bytes for the same inputs, parameters and version:\n");
    for key in broken {
        let place = VERSIONS.iter().find(|(known, _)| *known == kind_of(key)).map_or("its VERSION", |(_, place)| place);
        writeln!(text, "  {key}: raise {place}").unwrap();
    }
    text.push_str(
        "(below crates/kiln-pipeline/src/stages). Caches that people share hold the old bytes under this version: without a new number\n\
         they are served for ever. If the change was not meant, undo it. Then: KILN_BLESS=1 cargo test --release -p kiln goldens",
    );
    text
}

#[test]
fn no_stage_gives_other_bytes_without_a_new_version() {
    let path = repository("tests/goldens/stages.txt");
    let text = fs::read_to_string(&path).unwrap_or_default();
    let golden: BTreeMap<String, (String, String)> = text
        .lines()
        .filter_map(|line| {
            let (key, rest) = line.rsplit_once(" : ")?;
            let (fingerprint, digest) = rest.split_once(" -> ")?;
            Some((key.to_owned(), (fingerprint.to_owned(), digest.to_owned())))
        })
        .collect();
    let now = measured();
    let covered: BTreeSet<&str> = now.keys().map(|key| kind_of(key)).collect();
    assert_eq!(
        covered,
        VERSIONS.iter().map(|(kind, _)| *kind).collect(),
        "a kind of stage without a golden, or without a place"
    );
    let same_inputs = |(key, (fingerprint, digest)): &(&String, &(String, String))| {
        golden.get(*key).is_some_and(|(old, given)| old == fingerprint && given != digest)
    };
    let broken: Vec<&String> = now.iter().filter(same_inputs).map(|(key, _)| key).collect();
    assert!(broken.is_empty(), "{}", advice(&broken));
    if now != golden {
        assert!(
            std::env::var_os("KILN_BLESS").is_some(),
            "outputs changed, each with a changed fingerprint; look at the difference and run with KILN_BLESS=1:\n{now:#?}"
        );
        let mut out = String::new();
        for (key, (fingerprint, digest)) in &now {
            writeln!(out, "{key} : {fingerprint} -> {digest}").unwrap();
        }
        fs::write(path, out).unwrap();
    }
}
