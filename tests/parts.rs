//! Budgets for single submeshes, as a user writes them.

use std::fs;

use serde_json::Value;

use crate::space::{Space, ran, repository};

const POT: &str = r#"
kiln = 1
[asset]
input = "pot.glb"
output = "out/pot.kiln"
[[stage]]
id = "whole"
kind = "merge"
[[stage]]
id = "lods"
kind = "simplify"
levels = [{ keep = 0.4 }, { keep = 0.3 }]
[[stage.submesh]]
name = "lid"
keep = 1.0
[[stage.submesh]]
name = "handle-*"
keep = 0.25
[[stage.submesh]]
name = "rim"
relative-to = "handle-*"
factor = 0.5
[[stage]]
kind = "pack"
"#;

fn pot(pipeline: &str) -> Space {
    let space = Space::new();
    space.write("pipeline.toml", pipeline);
    space.fixture("pot.glb");
    space
}

/// The levels of stage `id` as its report has them.
fn levels(report: &Value, id: &str) -> Vec<Value> {
    let stages = report["assets"][0]["stages"].as_array().unwrap();
    let stage = stages.iter().find(|stage| stage["stage"] == id).unwrap();
    stage["report"]["levels"].as_array().unwrap().clone()
}

fn part<'a>(level: &'a Value, rule: &str) -> &'a Value {
    level["parts"].as_array().unwrap().iter().find(|part| part["rule"] == rule).unwrap()
}

#[test]
fn the_example_by_parts_builds_and_every_part_has_what_it_shall_have() {
    let space = Space::new();
    space.write("pipelines/by-parts.toml", fs::read(repository("pipelines/by-parts.toml")).unwrap());
    space.write("fixtures/pot.glb", fs::read(repository("fixtures/pot.glb")).unwrap());
    let args = ["build", "pipelines/by-parts.toml", "--backend", "cpu", "--json"];
    let report = space.run(args).expect(0).json();
    for (level, keep) in levels(&report, "lods").iter().zip([0.5, 0.3]) {
        assert!(level["triangles"].as_f64().unwrap() <= keep * 30704.0, "{level:#}");
        assert_eq!(level["gaps"], 0);
        for rule in ["lid", "handle-*", "rim"] {
            let (asked, reached) = (&part(level, rule)["asked"], &part(level, rule)["triangles"]);
            let (asked, reached) = (asked.as_u64().unwrap(), reached.as_u64().unwrap());
            assert!(reached <= asked && reached + 4 > asked, "{level:#}");
        }
        assert_eq!(part(level, "lid")["triangles"], 6048);
    }
    space.run(["check", "pipelines/build/by-parts/pot.kiln"]).expect(0);
    assert_eq!(space.run(args).expect(0).json()["fresh"], true);
}

#[test]
fn a_changed_rule_cuts_again_and_simplifies_nothing_and_why_says_so() {
    let space = pot(POT);
    let first = space.build();
    assert!(ran(&first).contains(&"lods, parts".to_owned()), "{first:#}");
    space.write("pipeline.toml", POT.replace("keep = 0.25", "keep = 0.5"));
    let why = space.run(["why", "out/pot.kiln", "--backend", "cpu"]).expect(0).stdout;
    assert!(why.contains("submesh") && why.contains("keep = 0.25") && why.contains("keep = 0.5"), "{why}");
    let second = space.build();
    assert_eq!(ran(&second), ["lods", "pack"], "{second:#}");
    let handles = |report: &Value| part(&levels(report, "lods")[0], "handle-*")["triangles"].as_u64().unwrap();
    assert!(handles(&second) > handles(&first));
    // Back again costs nothing at all.
    space.write("pipeline.toml", POT);
    assert_eq!(ran(&space.build()), Vec::<String>::new());
}

#[test]
fn a_rule_that_matches_nothing_ends_with_exit_code_one_and_the_nearest_name() {
    let space = pot(&POT.replace("name = \"lid\"", "name = \"lids\""));
    let ran = space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(1);
    assert!(ran.stderr.contains("rule \"lids\" matches no submesh; did you mean `lid`?"), "{}", ran.stderr);
    assert!(space.path("out/pot.kiln").exists(), "the rest was built");
}

#[test]
fn fixed_parts_beat_the_total_with_exit_code_one() {
    let space = pot(&POT.replace("{ keep = 0.3 }", "{ keep = 0.1 }"));
    let ran = space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(1);
    assert!(ran.stderr.contains("parts with rules of their own hold"), "{}", ran.stderr);
}

#[test]
fn rules_hold_for_later_simplify_stages() {
    let two = POT.replace(
        "[[stage]]\nkind = \"pack\"",
        "[[stage]]\nid = \"coarse\"\nkind = \"simplify\"\nlevels = [{ keep = 0.35 }]\n[[stage]]\nkind = \"pack\"",
    );
    let space = pot(&two.replace("levels = [{ keep = 0.4 }, { keep = 0.3 }]", "levels = [{ keep = 0.4 }]"));
    let report = space.build();
    let (base, coarse) = (&levels(&report, "lods")[0], &levels(&report, "coarse")[0]);
    for rule in ["lid", "handle-*", "rim"] {
        // A relative rule looks anew at what the other part came to, and a collapse takes two faces at once.
        let [base, coarse] = [base, coarse].map(|level| part(level, rule)["triangles"].as_u64().unwrap());
        assert!(base.abs_diff(coarse) <= 2, "{rule}: {base} and {coarse}");
    }
    assert!(coarse["triangles"].as_u64().unwrap() < base["triangles"].as_u64().unwrap());
}

#[test]
fn a_locked_material_stays_and_an_unknown_one_is_said() {
    let plain = POT[..POT.find("[[stage.submesh]]").unwrap()].to_owned() + "[[stage]]\nkind = \"pack\"\n";
    let locked = |lock: &str| plain.replace("levels = ", &format!("lock = [\"{lock}\"]\nlevels = "));
    let space = pot(&locked("rop?"));
    let report = space.build();
    for level in levels(&report, "lods") {
        assert_eq!((&level["submeshes"][4], &level["submeshes"][5]), (&1848.into(), &1848.into()), "{level:#}");
    }
    space.write("pipeline.toml", locked("rope2"));
    let said = space.run(["build", "pipeline.toml", "--backend", "cpu"]).expect(1).stderr;
    assert!(said.contains("lock \"rope2\" matches no material; did you mean `rope`?"), "{said}");
}
