//! The stage graph as a `build.ninja`.
//!
//! ```text
//! a stage      an edge to its receipt; the receipts of the stages that it reads are its inputs, its own files stand in its depfile
//! a container  an edge from the receipt of the stage that gives it
//! ```
//! Receipts are left alone where nothing changed: `restat` then keeps what depends on them from running. They lie in the cache, so
//! that whoever deletes it deletes them. The parameters of a stage are in its command by their digest, so a changed pipeline runs
//! the stages that it changes, and Ninja does the rest.
//!
//! # Limits
//! A receipt covers all that a stage gives: a stage that reads another part of it is started, and finds itself fresh.
//! Ninja cannot read some names out of a depfile, those with an apostrophe among them: the import of such a model is started every
//! time, and finds itself fresh.

use std::fmt::Write as _;
use std::path::Path;

use kiln_engine::ContentHash;

use super::args::GraphArgs;
use crate::graph::{AssetNode, Graph};

/// The text of a file that builds `graph`.
pub(super) fn file(graph: &Graph, args: &GraphArgs, cache: &Path) -> String {
    let mut out = format!(
        "# By `kiln plan --ninja` of kiln {}; to be run in the folder where that ran.\n\
         ninja_required_version = 1.7\n\n\
         pool gpu\n  depth = {}\n\n\
         rule stage\n  command = $argv --receipt $out --depfile $out.d\n  depfile = $out.d\n  deps = gcc\n  restat = 1\n  \
         description = $label\n\n\
         rule container\n  command = $argv\n  restat = 1\n  description = $out\n\n",
        graph.kiln, args.gpus
    );
    for asset in &graph.assets {
        edges(&mut out, asset, cache);
    }
    if let Some(output) = &args.output {
        let own = output.to_string_lossy();
        let argv: Vec<String> = std::env::args().skip(1).collect();
        let argv: Vec<&str> = std::iter::once(args.program.as_str()).chain(argv.iter().map(String::as_str)).collect();
        let inputs: Vec<String> = graph.files.iter().chain(&graph.folders).map(|file| path(file)).collect();
        let _ = write!(
            out,
            "rule plan\n  command = {}\n  generator = 1\n  restat = 1\n  description = kiln plan\n\nbuild {}: plan {}\n",
            command(&argv),
            path(&own),
            inputs.join(" ")
        );
        let containers: Vec<String> = graph.assets.iter().map(|asset| path(&asset.output)).collect();
        let _ = writeln!(out, "\ndefault {}", containers.join(" "));
    }
    out
}

fn edges(out: &mut String, asset: &AssetNode, cache: &Path) {
    let receipt = |stage: &str| path(&receipt(asset, stage, cache));
    for stage in &asset.stages {
        let before: Vec<String> = stage.upstream.iter().map(|before| receipt(before)).collect();
        let files: Vec<String> = stage.inputs.iter().map(|file| path(file)).collect();
        let _ = write!(out, "build {}: stage {}", receipt(&stage.id), before.join(" "));
        if !files.is_empty() {
            let _ = write!(out, " | {}", files.join(" "));
        }
        let argv: Vec<&str> = stage.command.iter().map(String::as_str).collect();
        let _ = write!(out, "\n  argv = {}\n  label = {}\n", command(&argv), value(&stage.label));
        if stage.class == "gpu" {
            out.push_str("  pool = gpu\n");
        }
    }
    let argv: Vec<&str> = asset.command.iter().map(String::as_str).collect();
    let _ = write!(
        out,
        "build {}: container {}\n  argv = {}\n\n",
        path(&asset.output),
        receipt(&asset.after),
        command(&argv)
    );
}

/// Where a stage's receipt lies.
fn receipt(asset: &AssetNode, stage: &str, cache: &Path) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let readable: String = asset.input.rsplit('/').next().unwrap_or_default().chars().map(plain).collect();
    let digest = ContentHash::of(asset.output.as_bytes()).short();
    let cache = crate::dependencies::place(cache, "");
    format!("{cache}/receipts/{readable}-{digest}/{}", stage.replace('/', "."))
}

/// A command line: quoted for the shell, then for Ninja.
fn command(argv: &[&str]) -> String {
    let quoted = |argument: &&str| {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
        if !argument.is_empty() && argument.chars().all(plain) {
            return (*argument).to_owned();
        }
        format!("'{}'", argument.replace('\'', r"'\''"))
    };
    value(&argv.iter().map(quoted).collect::<Vec<_>>().join(" "))
}

/// The value of a variable. A line break cannot be written.
fn value(text: &str) -> String {
    text.replace('$', "$$").replace(['\n', '\r'], " ")
}

/// A path in a build line.
fn path(text: &str) -> String {
    value(text).replace(':', "$:").replace(' ', "$ ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_and_commands_are_escaped_for_ninja_and_for_the_shell() {
        assert_eq!(path("a b:c$d"), "a$ b$:c$$d");
        assert_eq!(command(&["kiln", "it's", "$x", "", "a=b"]), r"kiln 'it'\''s' '$$x' '' a=b");
    }
}
