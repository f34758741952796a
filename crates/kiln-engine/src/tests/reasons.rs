//! One test a `StaleReason`: the build gives it, `why` gives it beforehand, and its JSON form is pinned.

use std::fs;

use proptest::prelude::*;

use super::*;

/// Expects that `why` and then the build give this reason for `action`, and that its JSON and text are these.
#[track_caller]
fn expect(toy: &Toy, action: usize, expected: &StaleReason, json: &str, shown: &str) {
    let why = toy.why();
    assert_eq!(why.actions[action], (action, Verdict::Stale(expected.clone())));
    for (later, verdict) in &why.actions[action + 1..] {
        let waits = matches!(verdict, Verdict::DependsOn { on } if (action..*later).contains(on));
        assert!(waits || *verdict == Verdict::Fresh, "{why:#?}");
    }
    assert_eq!(serde_json::to_string(expected).unwrap(), json);
    assert_eq!(serde_json::from_str::<StaleReason>(json).unwrap(), *expected);
    assert_eq!(expected.to_string(), shown);
    let (report, _) = toy.build();
    assert!(report.succeeded(), "{report:#?}");
    assert_eq!(reason(&report, action), expected);
    assert!(toy.build().0.nothing_to_do());
    assert!(toy.why().actions.iter().all(|(_, verdict)| *verdict == Verdict::Fresh));
}

#[test]
fn the_first_build() {
    expect(&Toy::new(), IMPORT, &StaleReason::NoRecord, r#"{"reason":"no-record"}"#, "first build");
}

#[test]
fn a_raised_stage_version() {
    let mut toy = Toy::new();
    toy.build();
    toy.recipe.shout_version = 2;
    // A version outranks the parameter that changes with it.
    toy.recipe.factor = 2.0;
    let expected = StaleReason::StageVersionChanged { old: 1, new: 2 };
    let json = r#"{"reason":"stage-version-changed","old":1,"new":2}"#;
    expect(&toy, SHOUT, &expected, json, "stage version 1 -> 2");
}

#[test]
fn another_version_of_a_foreign_library() {
    let mut toy = Toy::new();
    toy.build();
    toy.recipe.foreign = "loud@1.0.1+all".into();
    let (old, new) = (Some("loud@1.0.0+all".into()), Some("loud@1.0.1+all".into()));
    let json = r#"{"reason":"foreign-version-changed","old":"loud@1.0.0+all","new":"loud@1.0.1+all"}"#;
    let expected = StaleReason::ForeignVersionChanged { old, new };
    expect(&toy, SHOUT, &expected, json, "library loud@1.0.0+all -> loud@1.0.1+all");
}

#[test]
fn another_numeric_class() {
    let mut toy = Toy::new();
    toy.build();
    toy.recipe.numeric_class = "aarch64".into();
    let expected = StaleReason::NumericClassChanged { old: Some("x86-64".into()), new: Some("aarch64".into()) };
    let json = r#"{"reason":"numeric-class-changed","old":"x86-64","new":"aarch64"}"#;
    expect(&toy, SHOUT, &expected, json, "numeric class x86-64 -> aarch64");
}

#[test]
fn another_device_class() {
    let mut toy = Toy::new();
    toy.build();
    toy.recipe.device_class = "vulkan".into();
    let expected = StaleReason::DeviceClassChanged { old: Some("cpu".into()), new: Some("vulkan".into()) };
    let json = r#"{"reason":"device-class-changed","old":"cpu","new":"vulkan"}"#;
    expect(&toy, SHOUT, &expected, json, "device cpu -> vulkan");
}

#[test]
fn a_changed_parameter() {
    let mut toy = Toy::new();
    toy.build();
    toy.recipe.factor = 2.5;
    let (old, new) = (Some("1".into()), Some("2.5".into()));
    let expected = StaleReason::ParameterChanged { name: "factor".into(), old, new };
    let json = r#"{"reason":"parameter-changed","name":"factor","old":"1","new":"2.5"}"#;
    expect(&toy, SHOUT, &expected, json, "factor: 1 -> 2.5");
}

#[test]
fn a_new_parameter() {
    let toy = Toy::new();
    toy.build();
    let mut plan = toy.plan();
    plan.actions[SHOUT] = plan.actions[SHOUT].clone().param("pitch", 3u32);
    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    let expected = StaleReason::ParameterChanged { name: "pitch".into(), old: None, new: Some("3".into()) };
    assert_eq!(*reason(&report, SHOUT), expected);
}

#[test]
fn a_parameter_whose_float_differs_in_its_sign_of_zero_alone() {
    let mut toy = Toy::new();
    toy.recipe.factor = 0.0;
    toy.build();
    toy.recipe.factor = -0.0;
    let (report, _) = toy.build();
    assert_eq!(reason(&report, SHOUT).to_string(), "factor: 0 -> -0");
}

#[test]
fn a_changed_declared_file() {
    let toy = Toy::new();
    toy.build();
    let old = ContentHash::of(toy.read("models/pot.txt").as_bytes());
    toy.write("models/pot.txt", "a jar\n");
    let new = ContentHash::of(b"a jar\n");
    let expected = StaleReason::InputFileChanged { path: "models/pot.txt".into(), old, new };
    let json = format!(r#"{{"reason":"input-file-changed","path":"models/pot.txt","old":"{old}","new":"{new}"}}"#);
    let shown = format!("models/pot.txt changed: {} -> {}", old.short(), new.short());
    expect(&toy, IMPORT, &expected, &json, &shown);
}

#[test]
fn a_changed_found_file() {
    let toy = Toy::new();
    toy.build();
    toy.write("models/b.png", "berry");
    let (old, new) = (ContentHash::of(b"banana"), ContentHash::of(b"berry"));
    let expected = StaleReason::InputFileChanged { path: "b.png".into(), old, new };
    let json = format!(r#"{{"reason":"input-file-changed","path":"b.png","old":"{old}","new":"{new}"}}"#);
    expect(&toy, IMPORT, &expected, &json, &format!("b.png changed: {} -> {}", old.short(), new.short()));
}

#[test]
fn a_found_file_that_is_gone() {
    let toy = Toy::new();
    toy.build();
    fs::remove_file(toy.path("models/b.png")).unwrap();
    let expected = StaleReason::InputFileMissing { path: "b.png".into() };
    expect(&toy, IMPORT, &expected, r#"{"reason":"input-file-missing","path":"b.png"}"#, "b.png is gone");
    assert_eq!(toy.read("build/pot.out"), "A POT\nUSE A.PNG\nUSE B.PNG\n|apple|(none)");
}

#[test]
fn a_declared_file_that_is_gone() {
    let toy = Toy::new();
    toy.build();
    fs::remove_file(toy.path("models/pot.txt")).unwrap();
    let expected = StaleReason::InputFileMissing { path: "models/pot.txt".into() };
    assert_eq!(toy.why().actions[IMPORT].1, Verdict::Stale(expected));
}

#[test]
fn a_file_that_was_looked_for_in_vain_and_is_there_now() {
    let toy = Toy::new();
    fs::remove_file(toy.path("models/b.png")).unwrap();
    toy.build();
    toy.write("models/b.png", "banana");
    let expected = StaleReason::InputFileAdded { path: "b.png".into() };
    expect(&toy, IMPORT, &expected, r#"{"reason":"input-file-added","path":"b.png"}"#, "b.png is new");
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
}

#[test]
fn an_upstream_output_that_changed() {
    let toy = Toy::new();
    toy.build();
    toy.write("models/pot.txt", "a jar\n");
    let (report, _) = toy.build();
    let (old, new) = (ContentHash::of(b"a pot\nuse a.png\nuse b.png\n"), ContentHash::of(b"a jar\n"));
    let (input, action) = ("text".to_owned(), "pot#strip".to_owned());
    let expected = StaleReason::UpstreamOutputChanged { input, action, old: Some(old), new: Some(new) };
    assert_eq!(*reason(&report, SHOUT), expected);
    let json = format!(
        r#"{{"reason":"upstream-output-changed","input":"text","action":"pot#strip","old":"{old}","new":"{new}"}}"#
    );
    assert_eq!(serde_json::to_string(&expected).unwrap(), json);
    let shown = format!("input `text` from strip changed: {} -> {}", old.short(), new.short());
    assert_eq!(expected.to_string(), shown);
}

#[test]
fn an_input_that_is_new() {
    let toy = Toy::new();
    toy.build();
    let mut plan = toy.plan();
    plan.actions[SHOUT] = plan.actions[SHOUT].clone().input("more", Source::output(STRIP, "text"));
    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    let text = ContentHash::of(b"a pot\nuse a.png\nuse b.png\n");
    let shown = format!("input `more` from strip changed: (none) -> {}", text.short());
    assert_eq!(reason(&report, SHOUT).to_string(), shown);
}

#[test]
fn another_kind_of_stage_under_the_same_id() {
    let toy = Toy::new();
    toy.build();
    let mut plan = toy.plan();
    plan.actions[SHOUT].kind = "whisper";
    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    let expected = StaleReason::StageKindChanged { old: "shout".into(), new: "whisper".into() };
    assert_eq!(*reason(&report, SHOUT), expected);
    let json = r#"{"reason":"stage-kind-changed","old":"shout","new":"whisper"}"#;
    assert_eq!(serde_json::to_string(&expected).unwrap(), json);
    assert_eq!(expected.to_string(), "kind of stage shout -> whisper");
}

#[test]
fn a_missing_output() {
    let toy = Toy::new();
    toy.build();
    fs::remove_file(toy.path("build/pot.out")).unwrap();
    let why = toy.why();
    assert!(why.actions.iter().all(|(_, verdict)| *verdict == Verdict::Fresh));
    let expected = StaleReason::OutputMissing { path: "build/pot.out".into() };
    assert_eq!(why.target, Verdict::Stale(expected.clone()));
    let json = r#"{"reason":"output-missing","path":"build/pot.out"}"#;
    assert_eq!(serde_json::to_string(&expected).unwrap(), json);
    assert_eq!(expected.to_string(), "build/pot.out is missing");
}

#[test]
fn an_output_that_differs() {
    let toy = Toy::new();
    toy.build();
    toy.write("build/pot.out", "mine");
    let expected = StaleReason::OutputDiffers { path: "build/pot.out".into() };
    assert_eq!(toy.why().target, Verdict::Stale(expected.clone()));
    let json = r#"{"reason":"output-differs","path":"build/pot.out"}"#;
    assert_eq!(serde_json::to_string(&expected).unwrap(), json);
    assert_eq!(expected.to_string(), "build/pot.out differs from what the build gives");
}

#[test]
fn a_lost_blob_that_is_needed() {
    let mut toy = Toy::new();
    toy.build();
    let text = ContentHash::of(b"a pot\nuse a.png\nuse b.png\n");
    let blob = files_under(&toy.path(".kiln/v1/blobs")).into_iter().find(|path| path.ends_with(text.hex())).unwrap();
    fs::remove_file(&blob).unwrap();
    assert!(toy.build().0.nothing_to_do(), "nobody reads it: it is not missed");
    toy.recipe.factor = 2.0;
    let expected = StaleReason::BlobLost { what: "text".into() };
    assert_eq!(toy.why().actions[STRIP].1, Verdict::Stale(expected.clone()));
    let report = toy.build_running(&["shout", "strip", "pack"]);
    assert_eq!(*reason(&report, STRIP), expected);
    assert!(blob.exists());
    assert_eq!(serde_json::to_string(&expected).unwrap(), r#"{"reason":"blob-lost","what":"text"}"#);
    assert_eq!(expected.to_string(), "cache entry lost: text");
}

#[test]
fn every_cause_is_expected_by_a_test_here() {
    let source = include_str!("../reason.rs").split_once("pub enum StaleReason {").unwrap().1;
    let variants = source.lines().take_while(|line| *line != "}").filter_map(|line| {
        let name = line.strip_prefix("    ")?;
        name.starts_with(char::is_uppercase).then(|| name.trim_end_matches([',', ' ', '{']))
    });
    let here = include_str!("reasons.rs");
    let untested: Vec<_> = variants.filter(|name| !here.contains(&format!("StaleReason::{name}"))).collect();
    assert!(untested.is_empty(), "{untested:?}");
}

/// Manifests over so few names and values that equal ones, and ones that differ in one field, are common.
fn manifests() -> impl Strategy<Value = Manifest> {
    let topic = prop_oneof![Just(Topic::Version), Just(Topic::Parameter)];
    let value = prop_oneof![
        Just(crate::Value::from("1")),
        Just(crate::Value::from(1u32)),
        Just(crate::Value::from(1f64)),
        Just(crate::Value::from(1f32)),
        Just(crate::Value::from(true)),
    ];
    let head = prop::collection::btree_map((topic, "[ab]{0,2}"), value, 0..3);
    let hash = prop_oneof![Just(None), Just(Some(ContentHash::of(b"x"))), Just(Some(ContentHash::of(b"y")))];
    let inputs = prop::collection::btree_map("[ab]{1,2}", (any::<bool>(), hash), 0..3);
    (head, inputs).prop_map(|(head, inputs)| {
        let head = head.into_iter().map(|((topic, name), value)| Field { topic, name, value }).collect();
        let input = |(name, (found, hash)): (String, (bool, Option<ContentHash>))| {
            let path = name.clone();
            let origin = if found { Origin::Discovered { path } } else { Origin::File { path } };
            InputField { name, hash, origin }
        };
        Manifest::new(head, inputs.into_iter().map(input).collect())
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn two_manifests_have_one_fingerprint_exactly_if_no_field_differs(a in manifests(), b in manifests()) {
        prop_assert_eq!(a.fingerprint() == b.fingerprint(), a.first_difference(&b).is_none());
        prop_assert_eq!(a.first_difference(&b).is_none(), b.first_difference(&a).is_none());
        prop_assert!(a.first_difference(&a.clone()).is_none());
    }
}
