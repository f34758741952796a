//! The library as C sees it: C11 without warnings, against the static library that this test's own build made.

#![allow(clippy::unwrap_used, reason = "tests")]
#![allow(missing_docs, reason = "tests")]

use std::path::{Path, PathBuf};
use std::process::Command;

use kiln_format::{Content, ErrorKind, LevelContent, Provenance, Semantic, SubmeshContent, write};

/// The static library beside the test's program: cargo builds every kind of the package's library before its tests.
fn library() -> PathBuf {
    let program = std::env::current_exe().unwrap();
    let library = program.parent().unwrap().join("libkiln_capi.a");
    assert!(library.is_file(), "{} was not built", library.display());
    library
}

/// Compiles a C file of this package; `None`, said, without a C compiler.
fn compiled(source: &str, folder: &Path) -> Option<PathBuf> {
    if Command::new("cc").arg("--version").output().is_err() {
        assert!(std::env::var_os("KILN_REQUIRE_ALL").is_none(), "this test needs a C compiler");
        eprintln!("skipped: needs a C compiler");
        return None;
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let program = folder.join("program");
    let output = Command::new("cc")
        .args(["-std=c11", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-O1", "-I"])
        .arg(root.join("include"))
        .arg(root.join(source))
        .arg(library())
        .args(["-lpthread", "-ldl", "-lm", "-lstdc++", "-o"])
        .arg(&program)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(program)
}

/// Two levels, a submesh without triangles in the coarse one, names that need care in JSON.
fn container() -> Vec<u8> {
    let positions: Vec<u8> = (0..12).flat_map(|i| (i as f32 * 0.1).to_le_bytes()).collect();
    let level = |error, indices: &'static [u32], counts: [u32; 2]| LevelContent {
        error,
        error_kind: ErrorKind::Sampled,
        arrays: vec![(Semantic::Positions, positions.as_slice())],
        indices,
        index_counts: counts.to_vec(),
        shares_vertices: false,
    };
    let submesh = |name: &str| SubmeshContent { name: name.into(), material: None, attributes: 2, source_triangles: 5 };
    let content = Content {
        source_triangles: 10,
        levels: vec![level(0.0, &[0, 1, 2, 1, 2, 3], [3, 3]), level(0.25, &[0, 1, 3], [3, 0])],
        submeshes: vec![submesh("a \"b\"\\\n"), submesh("Öl")],
        provenance: Some(Provenance {
            tool: "test".into(),
            inputs: vec![("a".into(), [7; 32])],
            ..Provenance::default()
        }),
        ..Content::default()
    };
    write(&content).unwrap()
}

#[test]
fn damaged_containers_and_null_pointers_are_answered_with_errors() {
    let folder = tempfile::tempdir().unwrap();
    let Some(program) = compiled("tests/damage.c", folder.path()) else { return };
    let path = folder.path().join("small.kiln");
    std::fs::write(&path, container()).unwrap();
    let output = Command::new(program).arg(path).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && said.is_empty(), "{:?}: {said}", output.status);
}

#[test]
fn the_summary_of_a_damaged_file_is_words_and_status_2() {
    let folder = tempfile::tempdir().unwrap();
    let Some(program) = compiled("examples/summary.c", folder.path()) else { return };
    let path = folder.path().join("small.kiln");
    let mut bytes = container();
    std::fs::write(&path, &bytes).unwrap();
    let output = Command::new(&program).arg(&path).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains(r#""name":"a \"b\"\\\u000a""#) && text.contains(r#""name":"Öl""#), "{text}");
    assert!(text.contains(r#""bounds_max":[0.90000004,1,1.1]"#), "floats are the shortest that round to them: {text}");
    bytes[200] ^= 1;
    std::fs::write(&path, &bytes).unwrap();
    let output = Command::new(&program).arg(&path).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("K109"), "{output:?}");
}
