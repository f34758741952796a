//! `xtask long`: what CI has no time for. Tables and logs go to `docs/results/`, with date and commit.

use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

use crate::{continuous, corpus, farm, fuzz, remote};

const HELP: &str = "\
cargo xtask long [PART]; all parts without one

  corpus [NAME...]                     real models end to end (needs KILN_CORPUS)
  continuous                           layouts: counts, bytes, distances, picking, loading (needs KILN_CORPUS, numpy)
  kills [--rounds N]                   builds killed at seeded moments on a damaged cache, 200 rounds unless told
  noop                                 builds without work and of one change, 10,000 assets, beside ninja (needs ninja)
  remote                               what a shared cache gives, and what one in trouble costs (S3 needs moto_server)
  farm                                 100 assets through Slurm on this machine, a node killed; Bazel (needs root, slurm-wlm, munge)
  fuzz [--minutes N] [--target NAME]   each fuzz target for its share of N minutes, 60 unless told (needs cargo-fuzz)";

/// Runs a part, or all of them.
pub(crate) fn run(root: &Path, args: &[String]) -> Result<(), String> {
    match args.split_first() {
        None => {
            let parts = [
                models(root, &[]),
                continuous::run(root),
                kills(root, &[]),
                noop(root),
                remote::run(root),
                farm::run(root),
                fuzz::run(root, &[]),
            ];
            let failed: Vec<String> = parts.into_iter().filter_map(Result::err).collect();
            if failed.is_empty() { Ok(()) } else { Err(failed.join("\n")) }
        }
        Some((part, rest)) => match part.as_str() {
            "corpus" => models(root, rest),
            "continuous" => continuous::run(root),
            "kills" => kills(root, rest),
            "noop" => noop(root),
            "remote" => remote::run(root),
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

fn kills(root: &Path, args: &[String]) -> Result<(), String> {
    let rounds = match args {
        [] => 200,
        [flag, count] if flag == "--rounds" => count.parse::<u64>().map_err(|e| format!("--rounds {count}: {e}"))?,
        _ => return Err(HELP.into()),
    };
    let output = Command::new("cargo")
        .args(["test", "--release", "--locked", "-p", "kiln", "--test", "kiln-tests", "crash", "--", "--nocapture"])
        .env("KILN_CRASH_ROUNDS", rounds.to_string())
        .env("KILN_REQUIRE_TMPFS", "1")
        .current_dir(root)
        .output()
        .map_err(|e| e.to_string())?;
    let said = format!("{}{}", String::from_utf8_lossy(&output.stderr), String::from_utf8_lossy(&output.stdout));
    if !output.status.success() {
        return Err(format!("crash: {said}"));
    }
    let line = |start: &str| said.lines().find_map(|line| line.find(start).map(|at| &line[at..]));
    let counts = line("crash: ").ok_or("the crash test said nothing")?;
    let result = line("test result").unwrap_or_default();
    let text = format!(
        "# Kills\n\n{}\n\nTwo builders at a time (two working copies, the same pipeline or two variants) on one cache, sometimes a garbage \
         collection beside them, each killed (SIGKILL) at a seeded moment, three times a round; then files of the cache are cut or a bit of them \
         is flipped; then both build to their end. Every output was a clean build's, byte for byte; every `kiln cache verify` moved \
         aside what was damaged and then found nothing. The same run fills file systems up, under the cache and under the output.\n\n\
         ```\n{counts}\n{result}\n```\n",
        stamp(root)
    );
    fs::write(root.join("docs/results/crash.md"), text).map_err(|e| e.to_string())
}

fn noop(root: &Path) -> Result<(), String> {
    let folder = std::env::temp_dir().join(format!("kiln-noop-{}", std::process::id()));
    let cargo = |args: &[&str]| {
        Command::new("cargo").args(args).current_dir(root).stderr(Stdio::inherit()).output().map_err(|e| e.to_string())
    };
    let built = cargo(&["build", "--release", "--locked", "-p", "kiln"])?;
    if !built.status.success() {
        return Err("kiln does not build".into());
    }
    let place = folder.to_string_lossy();
    let ran = cargo(&["run", "--release", "--locked", "-p", "kiln-bench", "--bin", "noop", "--", &place]);
    // What cannot be removed stays in the system's folder for such things.
    let _ = fs::remove_dir_all(&folder);
    let ran = ran?;
    let text = format!(
        "# Builds without work\n\n{}\n\nEach model is a file of 4 KiB with the stages merge, simplify and pack (five actions with the \
         import and the collapse); ninja copies each, so that both look at as many inputs and outputs. Whole processes, from start to \
         end, taken in turns on a warm page cache; ninja with `-j2`. What a change adds is each build less its stages and less the \
         build without work right before it; it holds the waiting for the disk to have the container.\n\n{}",
        stamp(root),
        String::from_utf8_lossy(&ran.stdout)
    );
    if !ran.status.success() {
        return Err("the benchmark `noop` failed".into());
    }
    fs::write(root.join("docs/results/noop.md"), text).map_err(|e| e.to_string())
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
