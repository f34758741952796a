//! `xtask long fuzz`: every cargo-fuzz target for its share of the time, and a table of what came of it.
//!
//! The target's program is built once by cargo-fuzz (nightly where there is one, else stable told to take nightly's options) and
//! run with libFuzzer's limits on time and memory. It starts from `fuzz/seeds/TARGET` and `fuzz/regressions/TARGET` and keeps
//! what it found in `fuzz/corpus/TARGET` (not committed), so that a second run goes on from there. An input that broke a promise
//! is copied to `fuzz/regressions/TARGET`, where the replay test meets it; the rest of that target's time goes unused. A time-out
//! counts only if the input alone, run again, is as slow: another program may have held the machine.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Instant;

use crate::long::stamp;

/// Limits on every single input.
const LIMITS: &[&str] =
    &["-timeout=1", "-rss_limit_mb=512", "-malloc_limit_mb=256", "-max_len=16384", "-len_control=20"];
/// The sanitiser keeps freed memory to catch late uses; little of it, so that the limit on memory means the target's own.
const SANITIZER: &str = "detect_odr_violation=0:quarantine_size_mb=16:allocator_may_return_null=1";

/// What one target's time gave.
#[derive(Default)]
struct Outcome {
    executions: u64,
    seconds: u64,
    coverage: String,
    corpus: String,
    peak_mb: u64,
    slowest_seconds: u64,
    /// Copied inputs and what libFuzzer said of them.
    broken: Vec<String>,
}

/// `xtask long fuzz [--minutes N] [--target NAME]`.
pub(crate) fn run(root: &Path, args: &[String]) -> Result<(), String> {
    let (mut minutes, mut only) = (60.0_f64, None);
    let mut args = args.iter();
    while let Some(arg) = args.next() {
        let mut value = || args.next().ok_or_else(|| format!("{arg} needs a value"));
        match arg.as_str() {
            "--minutes" => minutes = value()?.parse().map_err(|_| "--minutes takes a number")?,
            "--target" => only = Some(value()?.clone()),
            other => return Err(format!("unknown argument {other}")),
        }
    }
    let mut targets = targets(root)?;
    if let Some(only) = only {
        targets.retain(|target| *target == only);
        if targets.is_empty() {
            return Err(format!("there is no fuzz target {only}"));
        }
    }
    // The versions that are fuzzed are those that ship; cargo adds libFuzzer's own.
    fs::copy(root.join("Cargo.lock"), root.join("fuzz/Cargo.lock")).map_err(|e| format!("fuzz/Cargo.lock: {e}"))?;
    let share = (minutes * 60.0 / targets.len() as f64) as u64;
    let mut table = String::new();
    let mut broken = Vec::new();
    for target in &targets {
        let program = build(root, target)?;
        eprintln!("{target}: {share} s");
        let outcome = fuzz(root, target, &program, share)?;
        let _ = writeln!(
            table,
            "| {target} | {} | {} | {} | {} | {} | {} | {} | {} |",
            outcome.seconds,
            outcome.executions,
            outcome.executions.checked_div(outcome.seconds).unwrap_or(0),
            outcome.coverage,
            outcome.corpus,
            outcome.peak_mb,
            outcome.slowest_seconds,
            outcome.broken.len(),
        );
        broken.extend(outcome.broken);
    }
    let verdict = match broken.is_empty() {
        true => "No input panicked, hung, or went past a limit.".to_owned(),
        false => broken.iter().map(|line| format!("- {line}\n")).collect(),
    };
    let text = format!(
        "# Fuzzing\n\n{} {minutes} minutes in all; each input under {}; AddressSanitizer, debug assertions and overflow checks on; \
         C++ that dependencies bring is not instrumented.\n\n\
         | target | seconds | executions | executions/s | edges covered | corpus (inputs/bytes) | peak MB | slowest input, s | broken |\n\
         | --- | --: | --: | --: | --: | --- | --: | --: | --: |\n{table}\n{verdict}\n",
        stamp(root),
        LIMITS.join(" ")
    );
    eprintln!("{text}");
    fs::write(root.join("docs/results/fuzz.md"), text).map_err(|e| format!("docs/results/fuzz.md: {e}"))?;
    if broken.is_empty() { Ok(()) } else { Err(broken.join("\n")) }
}

/// Names of all targets: the files of `fuzz/fuzz_targets`.
fn targets(root: &Path) -> Result<Vec<String>, String> {
    let entries = fs::read_dir(root.join("fuzz/fuzz_targets")).map_err(|e| format!("fuzz/fuzz_targets: {e}"))?;
    let stem = |entry: fs::DirEntry| entry.path().file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let mut names: Vec<String> = entries.flatten().filter_map(stem).collect();
    names.sort();
    Ok(names)
}

/// Builds a target; gives its program.
fn build(root: &Path, target: &str) -> Result<PathBuf, String> {
    let said = |program: &str, args: &[&str]| {
        let output = Command::new(program).args(args).stderr(Stdio::null()).output().ok();
        output.map(|o| String::from_utf8_lossy(&o.stdout).into_owned()).unwrap_or_default()
    };
    let nightly = said("rustup", &["toolchain", "list"]).lines().any(|line| line.starts_with("nightly"));
    let host = said("rustc", &["-vV"]);
    let host = host.lines().find_map(|line| line.strip_prefix("host: ")).ok_or("rustc does not tell its host")?;
    let folder = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from).join("fuzz");
    let mut command = Command::new("cargo");
    // The run of xtask itself chose a toolchain for its children.
    command.env_remove("RUSTUP_TOOLCHAIN").env_remove("CARGO").env_remove("RUSTC").env_remove("RUSTDOC");
    match nightly {
        true => command.arg("+nightly"),
        false => command.env("RUSTC_BOOTSTRAP", "1"),
    };
    command.args(["fuzz", "build", target]).arg("--target-dir").arg(&folder).current_dir(root);
    if target == "pipeline" {
        command.args(["--features", "pipeline"]);
    }
    match command.status() {
        Ok(status) if status.success() => Ok(folder.join(host).join("release").join(target)),
        Ok(_) => Err(format!("{target} did not build; is cargo-fuzz there? `cargo install cargo-fuzz --locked`")),
        Err(e) => Err(format!("cargo: {e}")),
    }
}

/// Runs a target for `seconds`, or until an input broke a promise.
fn fuzz(root: &Path, target: &str, program: &Path, seconds: u64) -> Result<Outcome, String> {
    let folder = |name: &str| {
        let path = root.join("fuzz").join(name).join(target);
        fs::create_dir_all(&path).map_err(|e| format!("fuzz/{name}/{target}: {e}")).map(|()| path)
    };
    let (corpus, seeds, artifacts) = (folder("corpus")?, folder("seeds")?, folder("artifacts")?);
    let regressions = root.join("fuzz/regressions").join(target);
    let mut outcome = Outcome::default();
    let start = Instant::now();
    loop {
        let left = seconds.saturating_sub(start.elapsed().as_secs());
        if left == 0 {
            break;
        }
        let mut command = Command::new(program);
        command.arg(&corpus).arg(&seeds);
        if regressions.is_dir() {
            command.arg(&regressions);
        }
        let output = command
            .args(LIMITS)
            .args([format!("-max_total_time={left}"), format!("-artifact_prefix={}/", artifacts.display())])
            .arg(format!("-dict={}", root.join(format!("fuzz/dictionaries/{target}.dict")).display()))
            .args(["-print_final_stats=1", "-report_slow_units=1"])
            .env("ASAN_OPTIONS", SANITIZER)
            .stdin(Stdio::null())
            .output()
            .map_err(|e| format!("{}: {e}", program.display()))?;
        let log = String::from_utf8_lossy(&output.stderr);
        outcome.read(&log);
        let artifact = log.lines().find_map(|line| line.split("Test unit written to ").nth(1)).map(PathBuf::from);
        let why = log
            .lines()
            .find(|line| line.contains("panicked at") || line.contains("ERROR:"))
            .unwrap_or("no reason told");
        match artifact {
            _ if output.status.success() => {}
            Some(artifact) if repeats(program, &artifact) => {
                let name = artifact.file_name().unwrap_or_default().to_string_lossy().into_owned();
                fs::create_dir_all(&regressions).map_err(|e| format!("fuzz/regressions/{target}: {e}"))?;
                fs::copy(&artifact, regressions.join(&name)).map_err(|e| format!("{}: {e}", artifact.display()))?;
                outcome.broken.push(format!("`fuzz/regressions/{target}/{name}`: {}", why.trim()));
                break;
            }
            Some(artifact) => eprintln!("{target}: {} does not repeat: {why}", artifact.display()),
            None => return Err(format!("{target}: {log}")),
        }
    }
    outcome.seconds = start.elapsed().as_secs();
    Ok(outcome)
}

/// Whether the input alone breaks a promise, in each of three runs.
fn repeats(program: &Path, artifact: &Path) -> bool {
    (0..3).all(|_| {
        let mut command = Command::new(program);
        command.arg(artifact).args(LIMITS).env("ASAN_OPTIONS", SANITIZER).stdin(Stdio::null()).stderr(Stdio::null());
        !command.status().is_ok_and(|status| status.success())
    })
}

impl Outcome {
    /// Adds what libFuzzer's log tells: its last line of progress and its final statistics.
    fn read(&mut self, log: &str) {
        let word = |line: &str, key: &str| {
            let mut words = line.split_whitespace().skip_while(|word| *word != key);
            words.nth(1).map(str::to_owned)
        };
        for line in log.lines() {
            if let Some(edges) = word(line, "cov:") {
                self.coverage = edges;
                self.corpus = word(line, "corp:").unwrap_or_default();
            }
            let Some((key, value)) = line.strip_prefix("stat::").and_then(|stat| stat.split_once(':')) else {
                continue;
            };
            let value = value.trim().parse().unwrap_or(0);
            match key {
                "number_of_executed_units" => self.executions += value,
                "peak_rss_mb" => self.peak_mb = self.peak_mb.max(value),
                "slowest_unit_time_sec" => self.slowest_seconds = self.slowest_seconds.max(value),
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_figures_of_a_log_of_libfuzzer_are_read() {
        let log = "#2\tINITED cov: 10 ft: 11 corp: 1/3b exec/s: 0 rss: 40Mb\n\
                   #99\tREDUCE cov: 123 ft: 456 corp: 17/2048b lim: 4 exec/s: 50 rss: 44Mb L: 3/4 MS: 1 EraseBytes-\n\
                   stat::number_of_executed_units: 1000\nstat::slowest_unit_time_sec: 0\nstat::peak_rss_mb: 64\n";
        let mut outcome = Outcome::default();
        outcome.read(log);
        outcome.read(log);
        assert_eq!((outcome.executions, outcome.peak_mb, outcome.slowest_seconds), (2000, 64, 0));
        assert_eq!((outcome.coverage.as_str(), outcome.corpus.as_str()), ("123", "17/2048b"));
    }
}
