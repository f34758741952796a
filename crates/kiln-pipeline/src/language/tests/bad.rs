//! Bad pipelines: `bad/*.toml` with what each must print in the `.txt` beside it.
//!
//! Lines `#set KEY=VALUE` in a case are `--set` arguments, a line `#models PATH...` says which files exist and has the
//! inputs expanded too. `KILN_BLESS=1` writes what is printed now; the result is reviewed as a diff.

use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

use super::*;

fn folder() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/src/language/tests/bad"))
}

fn cases() -> Vec<PathBuf> {
    let mut cases: Vec<PathBuf> = fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
        .collect();
    cases.sort();
    cases
}

/// What the case prints, and its diagnostics.
fn run(case: &PathBuf) -> (String, Vec<Diagnostic>) {
    let name = case.file_name().unwrap().to_str().unwrap();
    let text = fs::read_to_string(case).unwrap();
    let sets: Vec<String> = text.lines().filter_map(|line| line.strip_prefix("#set ")).map(str::to_owned).collect();
    let read_base = |path: &str| fs::read_to_string(folder().join(path));
    let loaded = load(name, &text, &sets, &read_base);
    assert_eq!(loaded.pipeline.is_none(), has_errors(&loaded.diagnostics), "{name}");
    let mut diagnostics = loaded.diagnostics.clone();
    if let Some(models) = text.lines().find_map(|line| line.strip_prefix("#models ")) {
        let files: Vec<&str> = models.split(' ').collect();
        let expansion = expand_inputs(loaded.pipeline.as_ref().unwrap(), &tree(&files));
        diagnostics.extend(expansion.diagnostics);
    }
    let printed: Vec<String> = diagnostics
        .iter()
        .map(|one| format!("{}{}", loaded.sources.render(one), if one.usage { " (bad usage)\n" } else { "" }))
        .collect();
    (printed.join("\n"), diagnostics)
}

#[test]
fn every_bad_pipeline_prints_its_diagnostics() {
    let bless = std::env::var_os("KILN_BLESS").is_some();
    let mut wrong = Vec::new();
    let cases = cases();
    for case in &cases {
        let (printed, diagnostics) = run(case);
        assert!(!diagnostics.is_empty(), "{} has no defect", case.display());
        let golden = case.with_extension("txt");
        if bless {
            fs::write(&golden, &printed).unwrap();
        } else if fs::read_to_string(&golden).ok().as_deref() != Some(printed.as_str()) {
            wrong.push(format!("{}:\n{printed}", case.display()));
        }
    }
    assert!(wrong.is_empty(), "{} of {} differ:\n\n{}", wrong.len(), cases.len(), wrong.join("\n\n"));
    assert!(cases.len() >= 30);
}

#[test]
fn every_code_has_a_case() {
    let mut seen = BTreeSet::new();
    for case in cases() {
        seen.extend(run(&case).1.into_iter().map(|one| one.code));
    }
    // A folder that cannot be listed needs a listing that fails: `good.rs`.
    seen.insert(Code::InputUnreadable);
    let missing: Vec<&str> = Code::ALL.iter().filter(|code| !seen.contains(code)).map(|code| code.as_str()).collect();
    assert!(missing.is_empty(), "no case for {missing:?}");
}

#[test]
fn every_span_lies_in_its_text_and_on_character_boundaries() {
    for case in cases() {
        let text = fs::read_to_string(&case).unwrap();
        for one in run(&case).1.iter().filter(|one| one.source == 0) {
            assert!(text.get(one.span.clone()).is_some(), "{}: {one:?}", case.display());
        }
    }
}
