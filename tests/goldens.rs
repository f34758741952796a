//! A stage whose output changes without a new version fails here.
//!
//! `goldens/stages.txt` has a line for each action of two fixtures: kind, version, fingerprint, and a digest of its outputs. Equal
//! fingerprint and another digest means that the stage gives other bytes for the same inputs, parameters and version: raise its
//! `VERSION`. After a rightful change, `KILN_BLESS=1 cargo test goldens` writes the file anew; it refuses the case above.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;

use kiln_engine::{BuildOptions, ContentHash, Engine, NoObserver};
use kiln_pipeline::plan::{PlanOptions, plan};

use crate::space::{repository, small};

/// Key (fixture, stage, kind, version) to (fingerprint, digest of outputs).
fn measured() -> BTreeMap<String, (String, String)> {
    let mut lines = BTreeMap::new();
    for fixture in ["cube.glb", "boundary-pair.glb"] {
        let space = small(fixture);
        let options = PlanOptions { backend: kiln::Backend::Cpu, ..PlanOptions::default() };
        let planned = plan(&space.path("pipeline.toml"), &options).unwrap();
        let mut engine = Engine::open(space.path(".kiln"), "pipeline.toml");
        let report = engine.build(&planned.plan, &BuildOptions::default(), &NoObserver).unwrap();
        assert!(report.succeeded(), "{report:?}");
        for (index, stage) in &planned.assets[0].actions {
            let (action, done) = (&planned.plan.actions[*index], &report.actions[*index]);
            let record = done.record.as_ref().unwrap();
            let outputs: String = record.outputs.iter().map(|o| format!("{} {}\n", o.name, o.hash.hex())).collect();
            let key = format!("{fixture} | {stage} | {} v{}", action.kind, action.version);
            let fingerprint = ContentHash(record.fingerprint.0).short();
            lines.insert(key, (fingerprint, ContentHash::of(outputs.as_bytes()).short()));
        }
    }
    lines
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
    for (key, (fingerprint, digest)) in &now {
        if let Some((old_fingerprint, old_digest)) = golden.get(key) {
            assert!(
                fingerprint != old_fingerprint || digest == old_digest,
                "{key}: other output for the same inputs, parameters and version. Raise the stage's VERSION."
            );
        }
    }
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
