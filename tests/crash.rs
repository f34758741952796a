//! Killing kiln at any moment loses nothing, damage to the cache costs time only, and a full disk is a diagnostic: the next build
//! gives the bytes that a clean build gives.
//!
//! ```text
//! two working copies, one cache; each round, from a seed:
//!     a variant of the pipeline for each copy (the same or another one, in a file of the same or another name)
//!     three volleys: both build at the same time, sometimes a collection beside them; each is killed at some moment
//!     some files of the cache are cut, or a byte of them is flipped: records, blobs, lists, states, indexes, leases, halves
//!     both build to their end: outputs are a clean build's; `cache verify` moves aside what is damaged and then finds nothing
//! ```

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use std::{env, fs, thread};

use crate::space::{Ran, SMALL, Space, files_under, ran, small};

/// Rounds in CI; `cargo xtask long kills` asks for more by `KILN_CRASH_ROUNDS`.
const ROUNDS: u64 = 20;

/// Numbers that are the same on every run (Knuth's MMIX constants).
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % end.max(1)
    }
}

/// A working copy with two pipelines that differ by name only; the cache is the other copy's too.
fn copy() -> Space {
    let space = small("boundary-pair.glb");
    space.write("other.toml", SMALL);
    space
}

/// A build of `pipeline` in a variant that no other number has; everything after the merge depends on it.
fn arguments(pipeline: &str, variant: u64, cache: &Path) -> Vec<String> {
    let set = format!("stage.base.levels=[{{keep = 0.{}}}]", 26 + variant);
    let cache = cache.display().to_string();
    ["build", pipeline, "--backend", "cpu", "--json", "--set", &set, "--cache", &cache].map(str::to_owned).to_vec()
}

fn spawn(space: &Space, args: &[String]) -> Child {
    space.command(args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Kills `child` if it is still at work; whether it was. SIGKILL on unix: no handler runs.
fn kill(mut child: Child) -> bool {
    let running = child.try_wait().unwrap().is_none();
    child.kill().unwrap();
    child.wait().unwrap();
    running
}

/// Cuts, or flips a bit of, some files of every folder of the cache; counts them by folder.
fn damage(cache: &Path, random: &mut Random, counts: &mut BTreeMap<String, u64>) {
    for folder in ["actions", "blobs", "lists", "state", "leases", "locks", "tmp"] {
        for path in files_under(&cache.join("v1").join(folder)) {
            if random.below(6) > 0 {
                continue;
            }
            let Ok(mut bytes) = fs::read(&path) else { continue };
            if bytes.is_empty() {
                continue;
            }
            let at = random.below(bytes.len() as u64) as usize;
            if random.below(3) == 0 {
                bytes.truncate(at);
            } else {
                bytes[at] ^= 1 << random.below(8);
            }
            fs::write(&path, bytes).unwrap();
            let what = if path.extension().is_some_and(|e| e == "index") { "index" } else { folder };
            *counts.entry(what.into()).or_default() += 1;
        }
    }
}

fn verify(cache: &Path) -> Ran {
    Space::new().run(["cache", "verify", "--json", "--cache", &cache.display().to_string()])
}

fn damaged(verified: &Ran) -> u64 {
    verified.json()["damaged"].as_array().unwrap().len() as u64
}

/// What clean builds of the variants give, each made once.
#[derive(Default)]
struct Clean(BTreeMap<u64, Vec<u8>>);

impl Clean {
    fn bytes(&mut self, variant: u64) -> &[u8] {
        self.0.entry(variant).or_insert_with(|| {
            let space = copy();
            space.run(arguments("pipeline.toml", variant, &space.path(".kiln"))).expect(0);
            space.read("out/model.kiln")
        })
    }
}

#[test]
fn builders_killed_on_a_damaged_cache_leave_what_gives_clean_bytes() {
    let rounds = env::var("KILN_CRASH_ROUNDS").ok().and_then(|n| n.parse().ok()).unwrap_or(ROUNDS);
    let home = Space::new();
    let cache = home.path("cache");
    let copies = [copy(), copy()];
    let mut clean = Clean::default();
    // The quickest of a few: a moment after the end of a build proves nothing.
    let timed = |variant| {
        let start = Instant::now();
        clean.bytes(variant);
        start.elapsed().as_micros() as u64
    };
    let whole = (0..4).map(timed).min().unwrap();
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    let (mut kills, mut met, mut quarantined, mut stages) = (0_u64, 0_u64, 0_u64, 0_u64);
    let mut spoiled = BTreeMap::new();
    for round in 0..rounds {
        let shared = random.below(2) == 0;
        let first = random.below(70);
        let plans = [first, if shared { first } else { random.below(70) }].map(|variant| {
            let pipeline = if random.below(2) == 0 { "pipeline.toml" } else { "other.toml" };
            (variant, arguments(pipeline, variant, &cache))
        });
        for volley in 1..=3 {
            let mut children: Vec<(u64, Child)> = Vec::new();
            for (space, (_, args)) in copies.iter().zip(&plans) {
                // What one volley made is there for the next, which has less to do.
                children.push((random.below(whole / volley), spawn(space, args)));
            }
            if random.below(3) == 0 {
                let gc =
                    ["cache", "gc", "--max-size", "100kB", "--cache", &cache.display().to_string()].map(str::to_owned);
                children.push((random.below(whole / 4), spawn(&home, &gc)));
            }
            children.sort_by_key(|(moment, _)| *moment);
            let begun = Instant::now();
            for (moment, child) in children {
                thread::sleep(Duration::from_micros(moment).saturating_sub(begun.elapsed()));
                kills += 1;
                met += u64::from(kill(child));
            }
        }
        for (space, (variant, _)) in copies.iter().zip(&plans) {
            // Whole, if it is there: of this round or of an earlier one.
            if let Ok(bytes) = fs::read(space.path("out/model.kiln")) {
                let known = bytes == clean.bytes(*variant) || clean.0.values().any(|known| *known == bytes);
                assert!(known, "round {round}: a kill left a half-written output");
            }
        }
        damage(&cache, &mut random, &mut spoiled);
        let ends: Vec<Ran> = thread::scope(|scope| {
            let builds = copies.iter().zip(&plans).map(|(space, (_, args))| scope.spawn(move || space.run(args)));
            builds.collect::<Vec<_>>().into_iter().map(|build| build.join().unwrap()).collect()
        });
        for ((space, (variant, _)), end) in copies.iter().zip(&plans).zip(ends) {
            let report = end.expect(0).json();
            assert!(
                space.read("out/model.kiln") == clean.bytes(*variant),
                "round {round}: not what a clean build gives"
            );
            stages += ran(&report).len() as u64;
            let warnings = report["warnings"].as_array().unwrap();
            quarantined += warnings.iter().filter(|w| w.as_str().unwrap().contains("moved aside")).count() as u64;
            let files: Vec<String> = space.files().into_iter().map(|(name, _)| name).collect();
            assert_eq!(files, ["model.glb", "other.toml", "out/model.kiln", "pipeline.toml"], "round {round}");
        }
        quarantined += damaged(&verify(&cache));
        assert_eq!(damaged(&verify(&cache).expect(0)), 0, "round {round}");
    }
    let total: u64 = spoiled.values().sum();
    eprintln!(
        "crash: {rounds} rounds, {kills} kills of which {met} met a running process, {total} files damaged ({}), {quarantined} moved \
         aside, {stages} stages run by the last builds",
        spoiled.iter().map(|(folder, count)| format!("{folder} {count}")).collect::<Vec<_>>().join(", ")
    );
    assert!(met >= rounds && total >= rounds && quarantined >= rounds, "the test proved nothing");
}

#[test]
fn a_builder_and_a_collector_in_loops_never_fail() {
    let home = Space::new();
    let cache = home.path("cache");
    let copies = [copy(), copy()];
    let mut clean = Clean::default();
    for variant in 0..3 {
        clean.bytes(variant);
    }
    let over = std::sync::atomic::AtomicBool::new(false);
    thread::scope(|scope| {
        let (over, cache, home) = (&over, &cache, &home);
        let collector = scope.spawn(move || {
            let mut removed = 0;
            while !over.load(std::sync::atomic::Ordering::Relaxed) {
                for most in ["0", "60kB", "400kB"] {
                    let ran = home.run([
                        "cache",
                        "gc",
                        "--max-size",
                        most,
                        "--json",
                        "--cache",
                        &cache.display().to_string(),
                    ]);
                    // 2 and "there is no cache" before the first build; 1 if what is in use is more than may stay.
                    assert!(ran.code <= 1 || !cache.exists() || ran.stderr.contains("no cache"), "{}", ran.stderr);
                    if ran.code <= 1 {
                        removed += ran.json()["removed_files"].as_u64().unwrap();
                    }
                }
            }
            removed
        });
        let builders: Vec<_> = copies
            .iter()
            .map(|space| {
                let clean = &clean;
                scope.spawn(move || {
                    for round in 0..12 {
                        let variant = round % 3;
                        let _ = fs::remove_file(space.path("out/model.kiln"));
                        let report = space.run(arguments("pipeline.toml", variant, cache)).expect(0).json();
                        assert!(space.read("out/model.kiln") == clean.0[&variant], "round {round}");
                        assert_eq!(report["warnings"], serde_json::json!([]), "round {round}");
                    }
                })
            })
            .collect();
        for builder in builders {
            builder.join().unwrap();
        }
        over.store(true, std::sync::atomic::Ordering::Relaxed);
        assert!(collector.join().unwrap() > 0, "nothing was ever removed: the test proved nothing");
    });
    assert_eq!(damaged(&verify(&cache).expect(0)), 0);
}

// --- a full disk ---

/// A small file system of its own; gone when dropped.
struct Tmpfs(PathBuf);

impl Tmpfs {
    /// `None`, and a word, where nothing may be mounted; `KILN_REQUIRE_TMPFS=1` makes that a failure.
    fn mount(at: PathBuf, bytes: u64) -> Option<Tmpfs> {
        fs::create_dir_all(&at).unwrap();
        let size = format!("size={bytes}");
        let said = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "kiln-test"]).arg(&at).output();
        let why = match said {
            Ok(output) if output.status.success() => return Some(Tmpfs(at)),
            Ok(output) => String::from_utf8_lossy(&output.stderr).trim().to_owned(),
            Err(error) => error.to_string(),
        };
        assert!(env::var_os("KILN_REQUIRE_TMPFS").is_none(), "a tmpfs cannot be mounted: {why}");
        eprintln!("skipped: a tmpfs cannot be mounted here: {why}");
        None
    }

    fn resize(&self, bytes: u64) {
        let size = format!("remount,size={bytes}");
        assert!(Command::new("mount").args(["-o", &size]).arg(&self.0).status().unwrap().success());
    }
}

impl Drop for Tmpfs {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

/// Builds an older variant with room and a newer one in file systems of every size for `folder`, until one fits.
fn fills(folder: &str) {
    let mut clean = Clean::default();
    let whole = clean.bytes(1).len() as u64;
    let mut refused = 0;
    for step in 0..40 {
        let space = copy();
        let Some(mounted) = Tmpfs::mount(space.path(folder), 64 << 20) else { return };
        let build = |variant| space.run(arguments("pipeline.toml", variant, &space.path(".kiln")));
        build(0).expect(0);
        // A tmpfs counts in pages.
        let pages = |path: &PathBuf| fs::metadata(path).unwrap().len().next_multiple_of(4096);
        let used: u64 = files_under(&space.path(folder)).iter().map(pages).sum();
        mounted.resize((used + step * whole / 4).next_multiple_of(4096) + (16 << 10));
        let ran = build(1);
        let halves = files_under(&space.path(".kiln/v1/tmp"));
        assert!(halves.is_empty(), "{folder}, step {step}: {halves:?}");
        assert!(!space.path("out/.model.kiln.kiln-tmp").exists(), "{folder}, step {step}");
        let fits = ran.code == 0;
        if fits {
            assert!(space.read("out/model.kiln") == clean.bytes(1));
        } else {
            let named = format!("{folder}/");
            let line = ran.stderr.lines().find(|line| line.contains("No space left on device"));
            assert!(
                ran.code == 2 && line.is_some_and(|line| line.contains(&named)),
                "{folder}, step {step}: {}",
                ran.stderr
            );
            assert!(space.read("out/model.kiln") == clean.bytes(0), "{folder}, step {step}: the old output stays");
            refused += 1;
        }
        mounted.resize(64 << 20);
        build(1).expect(0);
        assert!(space.read("out/model.kiln") == clean.bytes(1), "{folder}, step {step}");
        space.run(["cache", "verify"]).expect(0);
        if fits {
            break;
        }
        assert!(step < 39, "{folder}: it never fitted");
    }
    assert!(refused > 0, "{folder} was never full: the test proved nothing");
}

#[test]
#[cfg(target_os = "linux")]
fn a_cache_on_a_full_disk_is_a_diagnostic_and_no_damage() {
    fills(".kiln");
}

#[test]
#[cfg(target_os = "linux")]
fn an_output_on_a_full_disk_is_a_diagnostic_and_the_old_one_stays() {
    fills("out");
}
