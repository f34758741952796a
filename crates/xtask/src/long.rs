//! `xtask long`: what CI has no time for. Tables and logs go to `docs/results/`, with date and commit.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::{continuous, corpus, farm, fuzz};

const HELP: &str = "\
cargo xtask long [PART]; all parts without one

  corpus [NAME...]                     real models end to end (needs KILN_CORPUS)
  continuous                           layouts: counts, bytes, distances, picking, loading (needs KILN_CORPUS, numpy)
  kills                                builds killed at seeded moments
  farm                                 100 assets through Slurm on this machine, a node killed; Bazel (needs root, slurm-wlm, munge)
  fuzz [--minutes N] [--target NAME]   each fuzz target for its share of N minutes, 60 unless told (needs cargo-fuzz)";

/// Runs a part, or all of them.
pub(crate) fn run(root: &Path, args: &[String]) -> Result<(), String> {
    match args.split_first() {
        None => {
            let parts = [models(root, &[]), continuous::run(root), kills(root), farm::run(root), fuzz::run(root, &[])];
            let failed: Vec<String> = parts.into_iter().filter_map(Result::err).collect();
            if failed.is_empty() { Ok(()) } else { Err(failed.join("\n")) }
        }
        Some((part, rest)) => match part.as_str() {
            "corpus" => models(root, rest),
            "continuous" => continuous::run(root),
            "kills" => kills(root),
            "farm" => farm::run(root),
            "fuzz" => fuzz::run(root, rest),
            _ => Err(HELP.into()),
        },
    }
}

fn models(root: &Path, names: &[String]) -> Result<(), String> {
    let mut args: Vec<String> = names.to_vec();
    args.extend(["--out".into(), root.join("docs/results/corpus.md").display().to_string()]);
    corpus::run(root, &args)
}

fn kills(root: &Path) -> Result<(), String> {
    // Three kills a round.
    let rounds = 17;
    let output = Command::new("cargo")
        .args(["test", "--release", "--locked", "-p", "kiln", "--test", "kiln-tests", "crash"])
        .env("KILN_CRASH_ROUNDS", rounds.to_string())
        .current_dir(root)
        .output()
        .map_err(|e| e.to_string())?;
    let said = String::from_utf8_lossy(&output.stdout);
    let result = said.lines().find(|line| line.starts_with("test result")).unwrap_or("no test ran");
    let text = format!(
        "# Kills\n\n{}\n\n{rounds} rounds, each three builds of the common chain killed (SIGKILL) at seeded moments and a last one whose bytes \
         must equal a clean build's:\n\n```\n{result}\n```\n",
        stamp(root)
    );
    fs::write(root.join("docs/results/crash.md"), text).map_err(|e| e.to_string())?;
    if output.status.success() { Ok(()) } else { Err(format!("crash: {said}")) }
}

/// Date and commit of a result.
pub(crate) fn stamp(root: &Path) -> String {
    let said = |program: &str, args: &[&str]| {
        let output = Command::new(program).args(args).current_dir(root).output().ok();
        output.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned()).unwrap_or_default()
    };
    let changed =
        if said("git", &["status", "--porcelain", "--untracked-files=no"]).is_empty() { "" } else { " with changes" };
    format!(
        "By `cargo xtask long` on {} at commit {}{changed}.",
        said("date", &["-I"]),
        said("git", &["rev-parse", "--short", "HEAD"])
    )
}
