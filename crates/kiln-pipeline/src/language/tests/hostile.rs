//! Texts that nobody meant: no panic, spans within the text, a pipeline exactly where no error was found.

use proptest::prelude::*;

use super::*;

/// Loads, and checks what holds for every text whatever.
fn survives(text: &str, sets: &[String]) {
    let read = |path: &str| if path.len() < 20 { Ok(text.to_owned()) } else { no_base(path) };
    let loaded = load("x.toml", text, sets, &read);
    assert_eq!(loaded.pipeline.is_none(), has_errors(&loaded.diagnostics));
    for one in &loaded.diagnostics {
        let source = loaded.sources.of(one).unwrap();
        assert!(source.text.get(one.span.clone()).is_some(), "{one:?} in {:?}", source.text);
        assert!(!one.message.contains('\n') && !one.message.is_empty());
        loaded.sources.render(one);
    }
    if let Some(pipeline) = loaded.pipeline {
        let resolved = pipeline.to_resolved_toml();
        let again = load("x.toml", &resolved, &[], &no_base);
        assert_eq!(again.pipeline.map(|pipeline| pipeline.to_resolved_toml()), Some(resolved));
        let _ = pipeline.for_asset("props/x.glb");
        expand_inputs(&pipeline, &tree(&["models/x.glb", "models/props/y.glb"]));
    }
}

/// The example with everything that this version can do, so that mutations reach the chain.
fn able() -> String {
    EXAMPLE.lines().filter(|line| !line.starts_with("placement")).map(|line| format!("{line}\n")).collect()
}

#[test]
fn every_prefix_of_the_example_is_survived() {
    for text in [EXAMPLE, &able()] {
        for end in (0..=text.len()).filter(|end| text.is_char_boundary(*end)) {
            survives(&text[..end], &[]);
        }
    }
}

#[test]
fn every_example_without_one_line_is_survived() {
    let text = able();
    let lines: Vec<&str> = text.lines().collect();
    for gone in 0..lines.len() {
        let kept: Vec<&str> = lines.iter().enumerate().filter(|(at, _)| *at != gone).map(|(_, line)| *line).collect();
        survives(&kept.join("\n"), &[]);
    }
}

#[test]
fn deep_nesting_is_refused_and_not_followed() {
    let text = format!("kiln = 1\nx = {}", "[".repeat(100_000));
    survives(&text, &[format!("stage.a.b={}", "{a=".repeat(50_000)), format!("asset.input={}", "[".repeat(50_000))]);
    survives(&able(), &[format!("stage.lods.levels={}", "[".repeat(50_000))]);
}

/// Pieces that mean something to the language.
const PIECES: &[&str] = &[
    "[[stage]]",
    "[asset]",
    "[[override]]",
    "[[stage.submesh]]",
    "kind = \"bake\"",
    "kind = \"pack\"",
    "from = \"lods\"",
    "id = \"base\"",
    "levels = [ { keep = 0.5 } ]",
    "levels = []",
    "high = \"whole\"",
    "\"",
    "'''",
    "\u{1F980}",
    "\0",
    "]",
    "{",
    "= =",
    "base = \"x.toml\"",
    "kiln = 2",
    "1e400",
    "-0.0",
    "nan",
    "\"1 diag\"",
    "\n",
    "\r",
    "set = { a.b.c = 1 }",
    "match = \"[\"",
    "input = \"**\"",
    "output = \"{\"",
    "stage = 3",
    "asset = []",
];

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn mutations_of_the_example_are_survived(
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0_usize..12, prop::sample::select(PIECES)), 1..6),
        lines in any::<bool>(),
    ) {
        let mut text = able();
        for (place, length, piece) in edits {
            let mut start = place.index(text.len().max(1));
            if lines {
                start = text[..floor(&text, start)].rfind('\n').map_or(0, |at| at + 1);
            }
            let start = floor(&text, start);
            let end = floor(&text, (start + length).min(text.len())).max(start);
            text.replace_range(start..end, piece);
            if lines {
                text.insert(start + piece.len(), '\n');
            }
        }
        survives(&text, &[]);
    }

    #[test]
    fn any_setting_is_survived(
        key in "(asset|stage|sage)(\\.(lods|base|bake|input|output|x)?){0,2}(\\.(levels|metric|from|high|maps|weld|kind))?",
        value in "(\\[|\\{|\\]|\\}|keep|=| |0\\.5|\"|kind|quadric|lods|1 mm|\\*){0,8}",
    ) {
        survives(&able(), &[format!("{key}={value}"), key]);
    }

    #[test]
    fn any_text_is_survived(text in "(?s).{0,60}") {
        survives(&text, std::slice::from_ref(&text));
        let _ = Length::parse(&text);
    }
}

fn floor(text: &str, at: usize) -> usize {
    (0..=at.min(text.len())).rev().find(|at| text.is_char_boundary(*at)).unwrap_or(0)
}
