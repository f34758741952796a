//! What outputs depend on, as build systems read it: a depfile, and Cargo's lines.
//!
//! ```text
//! OUTPUTS: pipeline, its parents, listed folders       a new model is no file yet: its folder changes
//! OUTPUT: files read for it                            once for each asset
//! FILE:                                                so that Make goes on where a file is gone
//! ```
//! Paths are relative to the current folder where the pipeline's own path is. A file that was looked for in vain cannot stand
//! there, since build systems take an absent file for stale: its folder stands for it.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use kiln_engine::Dependencies;
use kiln_pipeline::language::normal;

/// Names paths as a build system knows them.
struct Names<'a> {
    root: &'a Path,
    /// `--set asset.output=PATH` names places from the current folder: so does a build system, where the root is relative.
    current: Option<PathBuf>,
}

impl Names<'_> {
    fn of(root: &Path) -> Names<'_> {
        Names { root, current: std::env::current_dir().ok().filter(|_| root.is_relative()) }
    }

    /// A path below the root: without `.`, and without `..` where a name stands before it.
    fn name(&self, path: &str) -> String {
        let full = self.root.join(path);
        let current = self.current.as_ref().filter(|_| full.is_absolute());
        let full = current.and_then(|current| full.strip_prefix(current).ok()).unwrap_or(&full).to_string_lossy();
        let name = normal(&full);
        if name.is_empty() { ".".into() } else { name }
    }
}

/// One path below `root` as a build system knows it.
pub(crate) fn place(root: &Path, path: &str) -> String {
    Names::of(root).name(path)
}

/// The folder of a path below the root.
pub(crate) fn folder_of(path: &str) -> &str {
    path.rsplit_once('/').map_or(".", |(folder, _)| folder)
}

/// What all outputs depend on.
fn common(dependencies: &Dependencies, names: &Names<'_>) -> BTreeSet<String> {
    let absent = dependencies.assets.iter().flat_map(|asset| &asset.absent).map(|path| folder_of(path));
    let own = dependencies.files.iter().chain(&dependencies.folders).map(String::as_str);
    own.chain(absent).map(|path| names.name(path)).collect()
}

/// A depfile as GCC writes it with `-MP`, for Ninja (`deps = gcc`), Make and CMake.
///
/// `root`: the folder that the dependencies are relative to, the pipeline's. A path with a line break cannot be written and is
/// left out.
pub fn depfile(dependencies: &Dependencies, root: &Path) -> String {
    let names = Names::of(root);
    let mut text = String::new();
    let mut inputs = common(dependencies, &names);
    let outputs = dependencies.assets.iter().flat_map(|asset| &asset.outputs).map(|path| names.name(path));
    rule(&mut text, outputs, inputs.iter().cloned());
    for asset in &dependencies.assets {
        let own: Vec<String> = asset.inputs.iter().map(|path| names.name(path)).collect();
        rule(&mut text, asset.outputs.iter().map(|path| names.name(path)), own.iter().cloned());
        inputs.extend(own);
    }
    for input in inputs {
        rule(&mut text, std::iter::once(input), std::iter::empty());
    }
    text
}

pub(crate) fn rule(text: &mut String, outputs: impl Iterator<Item = String>, inputs: impl Iterator<Item = String>) {
    let writable = |path: &String| !path.contains(['\n', '\r']);
    let outputs: Vec<String> = outputs.filter(writable).map(|path| escaped(&path)).collect();
    if outputs.is_empty() {
        return;
    }
    text.push_str(&outputs.join(" "));
    text.push(':');
    for input in inputs.filter(writable) {
        text.push_str(" \\\n  ");
        text.push_str(&escaped(&input));
    }
    text.push('\n');
}

/// Blanks, `#`, `$`, and backslashes before them as GCC and Make have them.
fn escaped(path: &str) -> String {
    let mut out = String::with_capacity(path.len());
    let mut backslashes = 0;
    for letter in path.chars() {
        match letter {
            ' ' | '\t' | '#' => {
                // Those before are doubled, so that this one is not taken for theirs.
                out.extend(std::iter::repeat_n('\\', if letter == '#' { 0 } else { backslashes }));
                out.push('\\');
            }
            '$' => out.push('$'),
            _ => {}
        }
        backslashes = if letter == '\\' { backslashes + 1 } else { 0 };
        out.push(letter);
    }
    out
}

/// The lines that a Cargo build script prints so that it runs again when, and only when, something changed that was read.
///
/// Folders among them are looked at by Cargo with all that lies in them: outputs belong elsewhere, such as into `OUT_DIR`.
pub fn cargo_lines(dependencies: &Dependencies, root: &Path) -> Vec<String> {
    let names = Names::of(root);
    let mut paths = common(dependencies, &names);
    paths.extend(dependencies.assets.iter().flat_map(|asset| &asset.inputs).map(|path| names.name(path)));
    paths.into_iter().map(|path| format!("cargo:rerun-if-changed={path}")).collect()
}

#[cfg(test)]
mod tests {
    use kiln_engine::AssetFiles;

    use super::*;

    fn example() -> Dependencies {
        let asset = |name: &str, inputs: &[&str], absent: &[&str]| AssetFiles {
            name: name.into(),
            outputs: vec![format!("out/{name}.kiln")],
            inputs: inputs.iter().map(|&path| path.into()).collect(),
            absent: absent.iter().map(|&path| path.into()).collect(),
        };
        Dependencies {
            files: vec!["a.toml".into(), "../common.toml".into()],
            folders: vec!["../models".into()],
            assets: vec![
                asset("pot", &["../models/pot.glb", "../models/a #1 $.png"], &[]),
                asset("jar", &["../models/jar.glb"], &["../models/tex/none.png"]),
            ],
        }
    }

    #[test]
    fn a_depfile_names_every_output_input_and_folder_and_escapes_them() {
        let expected = "proj/out/pot.kiln proj/out/jar.kiln: \\
  common.toml \\
  models \\
  models/tex \\
  proj/a.toml
proj/out/pot.kiln: \\
  models/pot.glb \\
  models/a\\ \\#1\\ $$.png
proj/out/jar.kiln: \\
  models/jar.glb
common.toml:
models:
models/a\\ \\#1\\ $$.png:
models/jar.glb:
models/pot.glb:
models/tex:
proj/a.toml:
";
        assert_eq!(depfile(&example(), Path::new("proj")), expected);
    }

    #[test]
    fn backslashes_before_a_blank_are_doubled_and_line_breaks_are_left_out() {
        assert_eq!(escaped(r"a\\ b\c"), r"a\\\\\ b\c");
        let mut one = example();
        one.assets[0].inputs = vec!["a\nb".into()];
        assert!(!depfile(&one, Path::new(".")).contains("a\nb"));
    }

    #[test]
    fn cargo_is_told_of_every_input() {
        let lines = cargo_lines(&example(), Path::new("."));
        let all = [
            "../common.toml",
            "../models",
            "../models/a #1 $.png",
            "../models/jar.glb",
            "../models/pot.glb",
            "../models/tex",
            "a.toml",
        ];
        assert_eq!(lines, all.map(|path| format!("cargo:rerun-if-changed={path}")));
    }
}
