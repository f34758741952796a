//! Generated model files through the command: each malformed one is refused at its place, soon, in little memory, and leaves
//! nothing; each awkward but legal one builds. The generator is `xtask::fixtures::families`.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::process::{Child, ExitStatus};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use xtask::fixtures::families::{self, Expected, Sample};

use crate::space::Space;

/// The level's budget is an error: a square of two triangles cannot always be halved, but it always keeps within an error.
const PIPELINE: &str = r#"
kiln = 1
[asset]
input = "model.glb"
output = "out/model.kiln"
[[stage]]
kind = "merge"
[[stage]]
kind = "simplify"
levels = [{ error = "0.01 diag" }]
[[stage]]
kind = "pack"
"#;

/// Processor time that a refusal may take, whatever else the machine does.
const MOST_SECONDS: f64 = 1.0;
/// Resident memory that a refusal may take, bytes.
const MOST_BYTES: u64 = 300_000_000;
/// After so long a build counts as hanging and is killed, however loaded the machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// What a build came to.
struct Ran {
    code: Option<i32>,
    stderr: String,
    cost: Cost,
    /// All files afterwards but for the cache and what the test itself wrote.
    left: BTreeSet<String>,
}

/// What a process took. `None` where the system does not tell.
#[derive(Clone, Copy, Default)]
struct Cost {
    /// User and system time, seconds, to a hundredth.
    seconds: Option<f64>,
    /// Greatest resident memory seen, bytes.
    bytes: Option<u64>,
}

/// Waits for a process while it looks at what it takes; kills it when patience is at an end.
fn watch(child: &mut Child) -> (ExitStatus, Cost) {
    let start = Instant::now();
    let mut cost = Cost::default();
    loop {
        look(child.id(), &mut cost);
        // Whoever has ended is looked at once more before it is waited for: until then its times can be read.
        if has_ended(child.id()).unwrap_or(true)
            && let Some(status) = child.try_wait().unwrap()
        {
            return (status, cost);
        }
        if start.elapsed() > PATIENCE {
            child.kill().unwrap();
            return (child.wait().unwrap(), cost);
        }
        thread::sleep(Duration::from_millis(1));
    }
}

/// The fields of `/proc/PID/stat` from the state on (proc(5)): the name before them may hold anything.
fn fields(pid: u32) -> Option<Vec<String>> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    Some(stat.rsplit_once(')')?.1.split_whitespace().map(str::to_owned).collect())
}

/// Whether a process waits to be waited for; `None` where the system does not tell.
fn has_ended(pid: u32) -> Option<bool> {
    Some(fields(pid)?.first()? == "Z")
}

/// Raises `cost` to what a process has taken so far. The command resets its peak between stages, hence the maximum of all looks.
fn look(pid: u32, cost: &mut Cost) {
    /// Linux counts processor time for programs in hundredths of a second, on every architecture that Rust has.
    const TICKS: f64 = 100.0;
    if let Some(fields) = fields(pid) {
        let ticks = |at: usize| fields.get(at)?.parse::<f64>().ok();
        let seconds = ticks(11).zip(ticks(12)).map(|(user, system)| (user + system) / TICKS);
        cost.seconds = greater(cost.seconds, seconds);
    }
    if let Ok(status) = fs::read_to_string(format!("/proc/{pid}/status")) {
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        let bytes = line.and_then(|l| l.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()).map(|k| k * 1024);
        cost.bytes = cost.bytes.max(bytes);
    }
}

/// The greater of two readings; one that is absent is the least.
fn greater<T: PartialOrd>(a: T, b: T) -> T {
    if b > a { b } else { a }
}

/// Builds a sample in a folder of its own.
fn build(sample: &Sample) -> Ran {
    let space = Space::new();
    sample.write(&space.path("")).unwrap();
    space.write("pipeline.toml", PIPELINE);
    let before: BTreeSet<String> = space.files().into_iter().map(|(name, _)| name).collect();
    let log = Space::new();
    let (out, err) = (log.path("out"), log.path("err"));
    // What it says goes to files: a full pipe would stop it while it is being watched.
    let input = format!("asset.input={}", sample.main);
    let mut child = (space.command(["build", "pipeline.toml", "--backend", "cpu", "--set", &input]))
        .stdout(File::create(&out).unwrap())
        .stderr(File::create(&err).unwrap())
        .spawn()
        .unwrap();
    let (status, cost) = watch(&mut child);
    let stderr = String::from_utf8_lossy(&fs::read(err).unwrap()).into_owned();
    let mut left: BTreeSet<String> = space.files().into_iter().map(|(name, _)| name).collect();
    left.retain(|name| !before.contains(name));
    let unfinished = fs::read_dir(space.path(".kiln/v1/tmp")).into_iter().flatten().flatten();
    left.extend(unfinished.map(|entry| entry.path().to_string_lossy().into_owned()));
    Ran { code: status.code(), stderr, cost, left }
}

/// Builds all samples, two at a time, and judges each; all that is wrong is told at once.
fn judge(samples: &[Sample], verdict: impl Fn(&Sample, &Ran) -> Vec<String> + Sync) {
    let next = AtomicUsize::new(0);
    let found = Mutex::new(Vec::new());
    let work = || {
        while let Some(sample) = samples.get(next.fetch_add(1, Ordering::Relaxed)) {
            let ran = build(sample);
            let wrong = verdict(sample, &ran);
            found.lock().unwrap_or_else(PoisonError::into_inner).push((sample.name.as_str(), ran.cost, wrong));
        }
    };
    thread::scope(|scope| (0..2).for_each(|_| drop(scope.spawn(work))));
    let mut found = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    assert_eq!(found.len(), samples.len());
    let most = found.iter().fold(Cost::default(), |most, (_, cost, _)| Cost {
        seconds: greater(most.seconds, cost.seconds),
        bytes: greater(most.bytes, cost.bytes),
    });
    eprintln!("{} samples; the costliest took {:?} s and {:?} bytes", samples.len(), most.seconds, most.bytes);
    found.retain(|(.., wrong)| !wrong.is_empty());
    found.sort_by_key(|(name, ..)| *name);
    let lines: Vec<String> = found.iter().map(|(name, _, wrong)| format!("{name}: {}", wrong.join("; "))).collect();
    assert!(lines.is_empty(), "{} of {} went wrong\n{}", lines.len(), samples.len(), lines.join("\n"));
}

fn head(text: &str) -> String {
    text.chars().take(300).collect()
}

#[test]
fn every_malformed_model_is_refused_at_its_place_and_leaves_nothing() {
    let samples = families::malformed().unwrap();
    assert!(samples.len() >= 100, "the family has {} samples", samples.len());
    judge(&samples, |sample, ran| {
        let Expected::Refused(refusal, place) = &sample.expected else { return vec!["is no malformed one".into()] };
        let mut wrong = Vec::new();
        if ran.code != Some(2) {
            wrong.push(format!("ended with {:?}: {}", ran.code, head(&ran.stderr)));
        } else if !ran.stderr.contains(refusal.words()) || !ran.stderr.contains(place.as_str()) {
            wrong.push(format!("`{}` at `{place}` is not in {}", refusal.words(), head(&ran.stderr)));
        }
        if ran.stderr.contains("panicked") {
            wrong.push("a panic".into());
        }
        if let Some(seconds) = ran.cost.seconds.filter(|s| *s > MOST_SECONDS) {
            wrong.push(format!("{seconds} s of processor time"));
        }
        if let Some(bytes) = ran.cost.bytes.filter(|b| *b > MOST_BYTES) {
            wrong.push(format!("{bytes} bytes of memory"));
        }
        if !ran.left.is_empty() {
            wrong.push(format!("left behind {:?}", ran.left));
        }
        wrong
    });
}

#[test]
fn every_awkward_but_legal_model_builds() {
    let samples = families::awkward().unwrap();
    assert!(samples.len() >= 40, "the family has {} samples", samples.len());
    judge(&samples, |_, ran| {
        let mut wrong = Vec::new();
        if ran.code != Some(0) {
            wrong.push(format!("ended with {:?}: {}", ran.code, head(&ran.stderr)));
        }
        if !ran.left.iter().eq(["out/model.kiln"]) {
            wrong.push(format!("left {:?}", ran.left));
        }
        wrong
    });
}

#[test]
#[cfg(target_os = "linux")]
fn what_a_process_takes_is_seen() {
    let space = crate::space::small("pot.glb");
    let log = File::create(space.path("log")).unwrap();
    let mut child = space.command(["build", "pipeline.toml", "--backend", "cpu"]).stderr(log).spawn().unwrap();
    let (status, cost) = watch(&mut child);
    assert!(status.success());
    assert!(cost.seconds.is_some_and(|s| s >= 0.05), "{:?} s for a build of thirty thousand triangles", cost.seconds);
    assert!(cost.bytes.is_some_and(|b| b > 10_000_000), "{:?} bytes", cost.bytes);
}
