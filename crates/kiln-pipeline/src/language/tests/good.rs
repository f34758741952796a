//! Pipelines that are read, and what is made of them.

use super::options::*;
use super::setting::Standard;
use super::*;

fn codes(loaded: &Loaded) -> Vec<&'static str> {
    loaded.diagnostics.iter().map(|one| one.code.as_str()).collect()
}

#[test]
fn the_example_of_the_design_is_read_in_full() {
    let text = EXAMPLE;
    let pipeline = good_text(text, &[]);

    let ids: Vec<&str> = pipeline.stages.iter().map(|stage| stage.id.as_str()).collect();
    assert_eq!(ids, ["whole", "base", "atlas", "lods", "bake", "pack"]);
    assert_eq!(pipeline.stages[0].input, StageInput::Asset);
    assert_eq!(pipeline.stages[3].input, StageInput::Stage(2));
    let StageSettings::Simplify(base) = &pipeline.stages[1].settings else { panic!() };
    let rule = |name: &str, level| SubmeshRule { name: name.to_owned(), level };
    let relative = RuleLevel::Relative { to: String::from("wheel*"), factor: 0.5 };
    assert_eq!(
        base.submesh.0,
        [rule("wheel*", RuleLevel::Keep(0.5)), rule("badge", RuleLevel::Keep(1.0)), rule("rim", relative)]
    );
    assert_eq!(&text[pipeline.stages[1].origin("submesh[2].relative-to").span.clone()], "\"wheel*\"");
    assert_eq!(base.texture_border, Some(TextureBorder::default()), "the example names the defaults");
    let StageSettings::Simplify(lods) = &pipeline.stages[3].settings else { panic!() };
    assert_eq!(
        lods.levels,
        [
            LevelBudget::Keep(0.25),
            LevelBudget::Keep(0.1),
            LevelBudget::Triangles(2000),
            LevelBudget::Error(Length::diag(0.01))
        ]
    );
    let bake = &pipeline.stages[4];
    assert_eq!(bake.high, Some(0));
    let StageSettings::Bake(options) = &bake.settings else { panic!() };
    assert_eq!(options.maps, [MapName::Normal, MapName::BaseColor, MapName::MetallicRoughness]);
    assert_eq!(&text[bake.origin("dilation").span.clone()], "8");
    assert_eq!(&text[bake.origin("maps[1]").span.clone()], "\"base-color\"");
    assert_eq!(&text[bake.origin("front").span.clone()], "[[stage]]", "a default points at the header");
    assert_eq!(pipeline.asset.input.relative_to, RelativeTo::File(String::from("p/x.toml")));

    let prop = pipeline.for_asset("props/chair.glb").unwrap();
    let StageSettings::Simplify(lods) = &prop.stages[3].settings else { panic!() };
    assert_eq!(lods.levels, [LevelBudget::Keep(0.1)]);
    assert_eq!(prop.overrides, [0]);
    let other = pipeline.for_asset("cars/truck.glb").unwrap();
    assert_eq!(other.stages, pipeline.stages);
}

#[test]
fn defaults_are_what_the_reference_says() {
    let pipeline = good_text(SMALL, &[]);
    for stage in &pipeline.stages {
        let values = stage.settings.values();
        for key in stage.kind().keys() {
            if let Standard::Value(standard) = &key.standard {
                let (_, value) = values.iter().find(|(name, _)| name == key.name).unwrap();
                assert_eq!(value, standard, "{} of {}", key.name, stage.id);
            }
        }
    }
}

#[test]
fn a_bake_without_a_size_takes_the_size_of_its_atlas() {
    let text = SMALL.replace(
        "[[stage]]\nkind = \"pack\"",
        "[[stage]]\nkind = \"atlas\"\nsize = 512\n\n[[stage]]\nkind = \"bake\"\nhigh = \"merge\"\n\n[[stage]]\nkind = \"pack\"",
    );
    let text = text.replace(", { keep = 0.1 }", "");
    let size = |sets: &[&str]| match &good_text(&text, sets).stage("bake").unwrap().settings {
        StageSettings::Bake(bake) => bake.size,
        _ => None,
    };
    assert_eq!(size(&[]), Some(512));
    assert_eq!(size(&["stage.atlas.size=1024"]), Some(1024));
    assert_eq!(size(&["stage.bake.size=64"]), Some(64));
}

#[test]
fn a_setting_is_verbatim_for_strings_and_toml_otherwise() {
    let sets = [
        "asset.input=other/x=1.glb",
        "asset.output={name}.kiln",
        "stage.merge.weld=0.5 mm",
        "stage.lods.levels=[{ triangles = 7 }]",
        "stage.lods.normal-angle=45",
        "stage.lods.metric={ kind = \"quadric\" }",
        "stage.lods.normals=rebuild",
        "stage.pack.layouts=[\"discrete\"]",
    ];
    let pipeline = good_text(SMALL, &sets);
    assert_eq!(pipeline.asset.input.text, "other/x=1.glb");
    assert_eq!(pipeline.asset.input.relative_to, RelativeTo::CurrentFolder);
    let StageSettings::Merge(merge) = &pipeline.stages[0].settings else { panic!() };
    assert_eq!(merge.weld, Length { value: 0.5, unit: Unit::Millimetre });
    let StageSettings::Simplify(lods) = &pipeline.stages[1].settings else { panic!() };
    assert_eq!(lods.levels, [LevelBudget::Triangles(7)]);
    assert_eq!((lods.normal_angle, lods.normals), (45.0, Normals::Rebuild));
    assert_eq!(pipeline.sources.0[4].text, sets[3]);
}

#[test]
fn a_later_setting_of_the_same_key_wins() {
    let pipeline = good_text(SMALL, &["stage.merge.weld=1 mm", "stage.merge.weld=2 mm"]);
    let StageSettings::Merge(merge) = &pipeline.stages[0].settings else { panic!() };
    assert_eq!(merge.weld, Length { value: 2.0, unit: Unit::Millimetre });
}

#[test]
fn a_child_is_laid_over_its_parents_by_id_and_replaces_lists() {
    let common = SMALL
        .replace("models/**/*.glb", "shared/*.glb")
        .replace("[[stage]]\nkind = \"merge\"", "[[stage]]\nkind = \"merge\"\nweld = \"3 mm\"");
    let middle = "kiln = 1\nbase = \"deep/common.toml\"\n[[stage]]\nid = \"lods\"\nlevels = [ { keep = 0.25 } ]\n";
    let text = "kiln = 1\nbase = \"../m/middle.toml\"\n\n[asset]\noutput = \"out/{name}.kiln\"\n\n[[stage]]\nid = \"lods\"\nnormals = \"rebuild\"\n\n[[stage]]\nid = \"more\"\nkind = \"simplify\"\nlevels = [ { keep = 0.125 } ]\n";
    let read = |path: &str| match path {
        "m/middle.toml" => Ok(middle.to_owned()),
        "m/deep/common.toml" => Ok(common.clone()),
        other => Err(io::Error::new(io::ErrorKind::NotFound, other.to_owned())),
    };
    let loaded = load("p/x.toml", text, &[], &read);
    assert!(loaded.diagnostics.is_empty(), "{:?}", loaded.diagnostics);
    let pipeline = loaded.pipeline.unwrap();
    let ids: Vec<&str> = pipeline.stages.iter().map(|stage| stage.id.as_str()).collect();
    assert_eq!(ids, ["merge", "lods", "more", "pack"], "a new stage stands after the one before it in the child");
    let StageSettings::Simplify(lods) = &pipeline.stages[1].settings else { panic!() };
    assert_eq!((lods.levels.as_slice(), lods.normals), ([LevelBudget::Keep(0.25)].as_slice(), Normals::Rebuild));
    assert_eq!(pipeline.asset.input.text, "shared/*.glb");
    assert_eq!(pipeline.asset.input.relative_to, RelativeTo::File(String::from("m/deep/common.toml")));
    assert_eq!(pipeline.asset.input.relative_to.join("shared"), "m/deep/shared");
    assert_eq!(pipeline.asset.output.relative_to, RelativeTo::File(String::from("p/x.toml")));
    let names: Vec<&str> = pipeline.sources.0.iter().map(|source| source.name.as_str()).collect();
    assert_eq!(names, ["p/x.toml", "m/middle.toml", "m/deep/common.toml"]);
}

#[test]
fn the_resolved_form_ignores_comments_blanks_and_key_order() {
    let shuffled = "# a comment\nkiln=1\n[[stage]]\nkind='merge' # more\nweld=\"0.00001 diag\"\n[[stage]]\nlevels=[{keep=5e-1},{keep=0.10}]\nkind=\"simplify\"\nid=\"lods\"\n[[stage]]\nfrom=\"lods\"\nkind=\"pack\"\n[asset]\noutput=\"elsewhere/{path}.kiln\"\ninput=\"models/**/*.glb\"\n";
    let (one, two) = (good_text(SMALL, &[]), good_text(shuffled, &[]));
    let resolved = |pipeline: &Pipeline| pipeline.for_asset("a.glb").unwrap();
    assert_eq!(resolved(&one).to_resolved_toml(), resolved(&two).to_resolved_toml());
    assert_eq!(resolved(&one).to_resolved_json(), resolved(&two).to_resolved_json());
    let three = good_text(SMALL, &["stage.merge.weld=2e-5 diag"]);
    assert_ne!(resolved(&one).to_resolved_toml(), resolved(&three).to_resolved_toml());
}

#[test]
fn the_resolved_form_reads_back_as_itself() {
    let text =
        format!("{SMALL}\n[[override]]\nmatch = \"a/*\"\nset = {{ \"stage.lods.levels\" = [ {{ keep = 1e-9 }} ] }}\n");
    let pipeline = good_text(&text, &[]);
    let resolved = pipeline.to_resolved_toml();
    assert_eq!(good_text(&resolved, &[]).to_resolved_toml(), resolved);
    let expected = "kiln = 1\n\n[asset]\ninput = \"models/**/*.glb\"\noutput = \"build/{path}.kiln\"\nallow-outside = false\nmax-file-size = 8192\nmax-triangles = 67108864\nmax-vertices = 67108864\nmax-submeshes = 1048576\nmax-node-depth = 4096\nmax-image-side = 16384\n\n[[stage]]\nid = \"merge\"\nkind = \"merge\"\nweld = \"1e-5 diag\"\nrepair = [\"duplicate-faces\", \"zero-normals\"]\n\n[[stage]]\nid = \"lods\"\nkind = \"simplify\"\nfrom = \"merge\"\nmetric = \"quadric\"\nattributes = true\nplacement = \"half-edge\"\nnormals = \"keep\"\nnormal-angle = 30.0\nlevels = [{ keep = 0.5 }, { keep = 0.1 }]\nboundary = \"along\"\nlock = []\nsubmesh = []\n\n[[stage]]\nid = \"pack\"\nkind = \"pack\"\nfrom = \"lods\"\nlayouts = [\"discrete\"]\ntextures = \"raw\"\nvertices = \"own\"\ncompression = \"none\"\nnodes = \"quadric\"\ncheckpoints = 24\n\n[[override]]\nmatch = \"a/*\"\nset = { \"stage.lods.levels\" = [{ keep = 1e-9 }] }\n";
    assert_eq!(resolved, expected);
    assert_eq!(
        good_text(SMALL, &[]).for_asset("a.glb").unwrap().to_resolved_json(),
        "{\"kiln\":1,\"stage\":[{\"id\":\"merge\",\"kind\":\"merge\",\"weld\":\"1e-5 diag\",\"repair\":[\"duplicate-faces\",\"zero-normals\"]},{\"id\":\"lods\",\"kind\":\"simplify\",\"from\":\"merge\",\"metric\":\"quadric\",\"attributes\":true,\"placement\":\"half-edge\",\"normals\":\"keep\",\"normal-angle\":30.0,\"levels\":[{\"keep\":0.5},{\"keep\":0.1}],\"boundary\":\"along\",\"lock\":[],\"submesh\":[]},{\"id\":\"pack\",\"kind\":\"pack\",\"from\":\"lods\",\"layouts\":[\"discrete\"],\"textures\":\"raw\",\"vertices\":\"own\",\"compression\":\"none\",\"nodes\":\"quadric\",\"checkpoints\":24}]}"
    );
}

#[test]
fn rules_for_submeshes_are_taken_from_a_table_from_a_list_and_from_the_command_line() {
    let rules = |pipeline: &Pipeline| {
        let StageSettings::Simplify(options) = &pipeline.stages[1].settings else { panic!() };
        options.submesh.0.clone()
    };
    let set = "stage.lods.submesh=[{ name = \"rim\", level = 1 }, { name = \"*\", relative-to = \"rim\", factor = 2 }]";
    let pipeline = good_text(SMALL, &[set]);
    let relative = RuleLevel::Relative { to: String::from("rim"), factor: 2.0 };
    let expected = [
        SubmeshRule { name: String::from("rim"), level: RuleLevel::Level(1) },
        SubmeshRule { name: String::from("*"), level: relative },
    ];
    assert_eq!(rules(&pipeline), expected);
    let resolved = pipeline.to_resolved_toml();
    assert_eq!(rules(&good_text(&resolved, &[])), expected, "{resolved}");
}

#[test]
fn lengths_resolve_against_the_diagonal() {
    let resolve = |text: &str, diagonal: f64| Length::parse(text).unwrap().resolve(diagonal);
    assert_eq!(resolve("0.1 mm", 5.0), 0.0001);
    assert_eq!(resolve("2cm", 5.0), 0.02);
    assert_eq!(resolve("1 m", 5.0), 1.0);
    assert_eq!(resolve("250 um", 5.0), 0.00025);
    assert_eq!(resolve("2e-3 km", 5.0), 2.0);
    assert_eq!(resolve("1e-5 diag", 5.0), 5e-5);
    assert_eq!(resolve("  .5   diag ", 4.0), 2.0);
    assert_eq!(Length::parse("-0 m").unwrap().value.to_bits(), 0.0_f64.to_bits());
    for bad in ["", "mm", "1", "1 furlong", "-1 mm", "1e999 m", "nan m", "1 m m", "e5 m"] {
        assert!(Length::parse(bad).is_err(), "{bad}");
    }
}

#[test]
fn a_pipeline_of_the_smallest_size_has_every_default() {
    let pipeline = good_text(SMALL, &[]);
    let StageSettings::Merge(merge) = &pipeline.stages[0].settings else { panic!() };
    assert_eq!(*merge, MergeOptions::default());
    let StageSettings::Pack(pack) = &pipeline.stages[2].settings else { panic!() };
    assert_eq!(*pack, PackOptions::default());
}

#[test]
fn the_first_level_may_equal_what_comes_in() {
    let text = SMALL.replace(
        "[[stage]]\nid = \"lods\"",
        "[[stage]]\nid = \"base\"\nkind = \"simplify\"\nlevels = [ { keep = 0.5 } ]\n\n[[stage]]\nid = \"lods\"",
    );
    good_text(&text, &[]);
    let above = load_text(&text, &["stage.base.levels=[{ keep = 0.49 }]"]);
    assert_eq!(codes(&above), ["level.above"]);
    // A count cannot be compared with a share before the asset is there.
    good_text(&text, &["stage.base.levels=[{ triangles = 10 }]"]);
}

#[test]
fn a_branch_takes_the_stage_that_it_names() {
    let text = SMALL.replace("[[stage]]\nkind = \"pack\"", "[[stage]]\nkind = \"pack\"\nfrom = \"lods\"");
    assert_eq!(good_text(&text, &[]).stages[2].input, StageInput::Stage(1));
    let loaded = load_text(&text, &["stage.pack.from=merge"]);
    assert_eq!(codes(&loaded), ["chain.unused", "chain.input"]);
    assert!(loaded.diagnostics[1].usage, "the command line's fault");
}

#[test]
fn the_reference_has_every_key_that_the_parser_takes_and_no_other() {
    let text = reference::reference();
    for kind in Kind::ALL {
        for key in kind.keys() {
            assert!(text.contains(&format!("| `{}` |", key.name)), "{}", key.name);
            assert!(!key.sentence.is_empty() && key.sentence.ends_with('.'), "{} lacks a sentence", key.name);
        }
        // A key of the reference is never unknown to the parser: it is read, or refused as planned.
        for key in kind.keys() {
            let stage =
                format!("\n[[stage]]\nid = \"probe\"\nkind = \"{}\"\n{} = 1979-05-27\n", kind.as_str(), key.name);
            let loaded = load_text(&format!("{SMALL}{stage}"), &[]);
            let wanted = if key.is_ready() { Code::ValueType } else { Code::KeyUnsupported };
            let at = |one: &Diagnostic| one.source == 0 && one.span.start > SMALL.len();
            assert!(
                loaded.diagnostics.iter().any(|one| at(one) && one.code == wanted),
                "{} {}",
                kind.as_str(),
                key.name
            );
            assert!(loaded.diagnostics.iter().all(|one| one.code != Code::KeyUnknown), "{}", key.name);
        }
        let help = reference::help(kind.as_str()).unwrap();
        assert_eq!(help.lines().count(), kind.keys().len() + 1);
    }
    assert!(reference::help("blend").is_none());
    for choices in [Metric::CHOICES, Placement::CHOICES, MapName::CHOICES, PackLayout::CHOICES] {
        for choice in choices {
            assert!(text.contains(&format!("`{}`", choice.name)), "{}", choice.name);
        }
    }
}

#[test]
fn every_planned_name_is_refused_by_name_and_no_ready_one_is() {
    let keys: [(&str, &[setting::Choice]); 3] =
        [("lods.metric", Metric::CHOICES), ("lods.placement", Placement::CHOICES), ("lods.normals", Normals::CHOICES)];
    for (key, choices) in keys {
        for choice in choices {
            let free = if choice.name == "memoryless" { "free" } else { "half-edge" };
            let placed = [format!("stage.lods.placement={free}"), format!("stage.{key}={}", choice.name)];
            let loaded = load_text(SMALL, &placed.each_ref().map(String::as_str));
            match choice.ready {
                true => assert!(loaded.diagnostics.is_empty(), "{}", choice.name),
                false => {
                    assert_eq!(codes(&loaded), ["value.unsupported"]);
                    assert!(loaded.diagnostics[0].message.contains(choice.name));
                }
            }
        }
    }
}

#[test]
fn inputs_are_found_sorted_and_named() {
    let pipeline = good_text(SMALL, &[]);
    let files =
        ["models/z.glb", "models/a/b.tar.glb", "models/a/.hidden.glb", "models/.git/x.glb", "models/a/c.png", "q.glb"];
    let expansion = expand_inputs(&pipeline, &tree(&files));
    assert!(expansion.diagnostics.is_empty());
    let rows: Vec<[&str; 5]> = expansion
        .builds
        .iter()
        .map(|one| [&one.input, &one.relative, &one.path, &one.name, &one.output].map(String::as_str))
        .collect();
    assert_eq!(
        rows,
        [
            ["models/a/b.tar.glb", "a/b.tar.glb", "a/b.tar", "b.tar", "build/a/b.tar.kiln"],
            ["models/z.glb", "z.glb", "z", "z", "build/z.kiln"],
        ]
    );
    assert_eq!(expansion.listed, ["models", "models/a"]);
}

#[test]
fn globs_match_part_by_part() {
    let files = ["m/a/x.glb", "m/ab/x.glb", "m/a/b/x.glb", "x.glb", "{name}.glb", "../up/x.glb"];
    let found = |input: &str, output: &str| {
        let pipeline = good_text(SMALL, &[&format!("asset.input={input}"), &format!("asset.output={output}")]);
        let expansion = expand_inputs(&pipeline, &tree(&files));
        assert!(expansion.diagnostics.is_empty(), "{input}: {:?}", expansion.diagnostics);
        expansion.builds.into_iter().map(|one| one.output).collect::<Vec<_>>()
    };
    assert_eq!(found("m/*/x.glb", "{path}"), ["a/x", "ab/x"]);
    assert_eq!(found("m/a?/*.glb", "{path}"), ["ab/x"]);
    assert_eq!(found("m/**/b/**/x.glb", "o/{path}.kiln"), ["o/a/b/x.kiln"]);
    assert_eq!(found("./m//a/x.glb", "o/{path}.kiln"), ["o/x.kiln"]);
    assert_eq!(found("[x].glb", "{name}/{path}"), ["x/x"]);
    assert_eq!(found("../up/*.glb", "{path}"), ["x"]);
    // A model's name is never taken for a template.
    assert_eq!(found("{name}.glb", "{name}/{path}.kiln"), ["{name}/{name}.kiln"]);
    assert_eq!(found("m/**", "{path}"), ["a/b/x", "a/x", "ab/x"]);
}

#[test]
fn a_folder_that_cannot_be_listed_is_named() {
    let pipeline = good_text(SMALL, &[]);
    let list = |folder: &str| match folder {
        "models" => Ok(vec![DirEntry { name: String::from("a"), is_dir: true }]),
        _ => Err(io::Error::new(io::ErrorKind::PermissionDenied, "not allowed")),
    };
    let expansion = expand_inputs(&pipeline, &list);
    assert_eq!(expansion.diagnostics.len(), 1);
    assert_eq!(expansion.diagnostics[0].code, Code::InputUnreadable);
    assert!(expansion.diagnostics[0].message.contains("models/a"));
    assert_eq!(&SMALL[expansion.diagnostics[0].span.clone()], "\"models/**/*.glb\"");
}

#[test]
fn a_folder_linked_into_itself_ends() {
    let pipeline = good_text(SMALL, &[]);
    let list = |_: &str| {
        Ok(vec![
            DirEntry { name: String::from("loop"), is_dir: true },
            DirEntry { name: String::from("x.glb"), is_dir: false },
        ])
    };
    let expansion = expand_inputs(&pipeline, &list);
    assert!(!expansion.builds.is_empty() && expansion.builds.len() < 100);
}

#[test]
fn a_later_override_wins_and_both_are_named() {
    let text = format!(
        "{SMALL}\n[[override]]\nmatch = \"**\"\nset = {{ \"stage.merge.weld\" = \"1 mm\", \"stage.lods.levels\" = [ {{ keep = 0.2 }} ] }}\n\n[[override]]\nmatch = \"a/*.glb\"\nset = {{ stage.lods.levels = [ {{ keep = 0.3 }} ] }}\n"
    );
    let pipeline = good_text(&text, &[]);
    let resolved = pipeline.for_asset("a/x.glb").unwrap();
    let StageSettings::Simplify(lods) = &resolved.stages[1].settings else { panic!() };
    let StageSettings::Merge(merge) = &resolved.stages[0].settings else { panic!() };
    assert_eq!(lods.levels, [LevelBudget::Keep(0.3)]);
    assert_eq!(merge.weld, Length { value: 1.0, unit: Unit::Millimetre });
    assert_eq!(resolved.overrides, [0, 1]);
    assert_eq!(pipeline.for_asset("a/b/x.glb").unwrap().overrides, [0], "`*` does not cross a `/`");
}

#[test]
fn overrides_that_only_break_the_chain_together_are_found_for_the_asset() {
    let text = SMALL.replace(
        "[[stage]]\nid = \"lods\"",
        "[[stage]]\nid = \"base\"\nkind = \"simplify\"\nlevels = [ { keep = 0.5 } ]\n\n[[stage]]\nid = \"lods\"",
    ) + "\n[[override]]\nmatch = \"*\"\nset = { \"stage.base.levels\" = [ { triangles = 100 } ] }\n\n[[override]]\nmatch = \"a*\"\nset = { \"stage.lods.levels\" = [ { triangles = 200 } ] }\n";
    let pipeline = good_text(&text, &[]);
    assert!(pipeline.for_asset("b.glb").is_ok());
    let broken = pipeline.for_asset("a.glb").unwrap_err();
    assert_eq!(broken.len(), 1);
    assert_eq!(broken[0].code, Code::LevelAbove);
}

#[test]
fn the_caret_stands_under_its_text_behind_tabs_and_wide_characters() {
    let text = "kiln = 1 # \u{e4}\n[asset]\n\tinput = \"\u{3c0}.glb\"\n\toutput = 5\n[[stage]]\nkind = \"merge\"\n[[stage]]\nkind=\"simplify\"\nlevels=[{keep=1}]\n[[stage]]\nkind=\"pack\"\r\n";
    let loaded = load_text(text, &[]);
    assert_eq!(
        loaded.sources.render(&loaded.diagnostics[0]),
        "p/x.toml:4:11: error[value.type]: expected a string, found a whole number\n   |\n 4 | \toutput = 5\n   | \t         ^ a whole number\n"
    );
}

#[test]
fn a_texture_border_takes_one_map_or_several_and_is_written_out_in_full() {
    let with = |table: &str| {
        let text = SMALL.replace("kind = \"simplify\"\n", &format!("kind = \"simplify\"\ntexture-border = {table}\n"));
        let pipeline = good_text(&text, &[]);
        let StageSettings::Simplify(options) = &pipeline.stages[1].settings else { panic!() };
        (options.texture_border.clone().unwrap(), pipeline.to_resolved_toml())
    };
    let (standard, resolved) = with("{}");
    assert_eq!(standard, TextureBorder::default());
    assert!(resolved.contains("texture-border = { map = [\"base-color\"], sigma = 0.75"), "{resolved}");
    assert_eq!(with("{ map = \"normal\" }").0.maps.0, [MaterialMap::Normal]);
    assert_eq!(with("{ map = [\"normal\", \"emissive\"] }").0.maps.0, [MaterialMap::Normal, MaterialMap::Emissive]);
    assert_eq!(
        with("{ weight = 2, side = 64 }").0,
        TextureBorder { weight: 2.0, side: 64, ..TextureBorder::default() }
    );
    assert!(!good_text(SMALL, &[]).to_resolved_toml().contains("texture-border"));
}

#[test]
fn a_metric_of_views_takes_its_name_or_a_table_and_is_written_out_in_full() {
    let with = |metric: &str| {
        let text = SMALL.replace("kind = \"simplify\"\n", &format!("kind = \"simplify\"\nmetric = {metric}\n"));
        let pipeline = good_text(&text, &[]);
        let StageSettings::Simplify(options) = &pipeline.stages[1].settings else { panic!() };
        (options.metric.clone(), pipeline.to_resolved_toml())
    };
    let (standard, resolved) = with("\"region-entropy\"");
    assert_eq!(standard, MetricChoice { metric: Metric::RegionEntropy, views: Some(ViewMetric::default()) });
    let full = "metric = { kind = \"region-entropy\", alpha = 1.0, views = \"dodecahedron\", size = 256, \
                update = \"exact\", sigma = 0.8, k = 300.0, min-size = 50, reach = 2, side = 512 }";
    assert!(resolved.contains(full), "{resolved}");
    assert_eq!(with("{ kind = \"region-entropy\" }").0, standard);
    let (faces, resolved) =
        with("{ kind = \"viewpoint-mutual-information\", views = 24, prepass = 0.25, alpha = 0.75 }");
    let views = faces.views.expect("a metric of views");
    assert_eq!((views.views, views.prepass, views.alpha), (ViewSet::Count(24), Some(0.25), 0.75));
    assert!(resolved.contains("views = 24, size = 256, update = \"exact\", prepass = 0.25 }"), "{resolved}");
    assert_eq!(with("\"memoryless\"\nplacement = \"free\"").0, MetricChoice::from(Metric::Memoryless));
    assert_eq!(
        with("{ kind = \"region-entropy\", views = \"icosahedron\", update = \"published\" }")
            .0
            .views
            .map(|v| (v.views.count(), v.update)),
        Some((12, ViewUpdate::Published))
    );
}
