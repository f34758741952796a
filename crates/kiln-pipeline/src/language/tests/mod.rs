//! Tests of the language: pipelines that are read, and pipelines paired with the diagnostics that they must print.

#![allow(clippy::unwrap_used, reason = "tests")]

mod bad;
mod good;
mod hostile;

use std::io;

use super::*;

/// The example of the design, every chapter of the language in one file.
const EXAMPLE: &str = include_str!("example.toml");

/// The smallest pipeline.
const SMALL: &str = r#"kiln = 1

[asset]
input = "models/**/*.glb"
output = "build/{path}.kiln"

[[stage]]
kind = "merge"

[[stage]]
id = "lods"
kind = "simplify"
levels = [ { keep = 0.5 }, { keep = 0.1 } ]

[[stage]]
kind = "pack"
"#;

fn no_base(path: &str) -> io::Result<String> {
    Err(io::Error::new(io::ErrorKind::NotFound, format!("no {path}")))
}

fn load_text(text: &str, sets: &[&str]) -> Loaded {
    let sets: Vec<String> = sets.iter().map(|set| (*set).to_owned()).collect();
    load("p/x.toml", text, &sets, &no_base)
}

/// The pipeline, or its diagnostics as a panic.
fn good_text(text: &str, sets: &[&str]) -> Pipeline {
    let loaded = load_text(text, sets);
    let said: Vec<String> = loaded.diagnostics.iter().map(|one| loaded.sources.render(one)).collect();
    assert!(said.is_empty(), "unexpected diagnostics:\n{}", said.join("\n"));
    loaded.pipeline.unwrap()
}

/// A listing closure over a set of file paths.
fn tree<'a>(files: &'a [&'a str]) -> impl Fn(&str) -> io::Result<Vec<DirEntry>> + 'a {
    move |folder: &str| {
        let start = if folder == "." { String::new() } else { format!("{folder}/") };
        let mut entries: Vec<DirEntry> = Vec::new();
        for rest in files.iter().filter_map(|file| file.strip_prefix(&start)) {
            let (name, is_dir) = rest.split_once('/').map_or((rest, false), |(name, _)| (name, true));
            let entry = DirEntry { name: name.to_owned(), is_dir };
            if !entries.contains(&entry) {
                entries.push(entry);
            }
        }
        if entries.is_empty() && folder != "." {
            return Err(io::Error::new(io::ErrorKind::NotFound, "no such folder"));
        }
        Ok(entries)
    }
}
