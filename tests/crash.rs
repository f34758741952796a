//! Killing kiln at any moment loses nothing: the next build gives the bytes that a clean build gives.

use std::thread;
use std::time::Duration;

use crate::space::{Space, small};

/// Rounds in CI; `cargo xtask long` asks for more by `KILN_CRASH_ROUNDS`.
const ROUNDS: u64 = 3;

/// Kills a build `millis` after its start; whether it was still running.
fn kill_after(space: &Space, millis: u64) -> bool {
    let mut child = space.command(["build", "pipeline.toml", "--backend", "cpu"]).spawn().unwrap();
    thread::sleep(Duration::from_millis(millis));
    let running = child.try_wait().unwrap().is_none();
    // SIGKILL on unix: no handler runs.
    child.kill().unwrap();
    child.wait().unwrap();
    running
}

#[test]
fn a_killed_build_leaves_a_cache_from_which_the_next_build_gives_clean_bytes() {
    let rounds = std::env::var("KILN_CRASH_ROUNDS").ok().and_then(|n| n.parse().ok()).unwrap_or(ROUNDS);
    let clean = small("boundary-pair.glb");
    let start = std::time::Instant::now();
    clean.build();
    let whole = start.elapsed().as_millis() as u64;
    let expected = clean.read("out/model.kiln");
    let mut killed = 0;
    let mut seed = 0x9e37_79b9_7f4a_7c15_u64;
    for _ in 0..rounds {
        let space = small("boundary-pair.glb");
        for _ in 0..3 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            killed += u32::from(kill_after(&space, (seed >> 33) % whole.max(2)));
        }
        if space.path("out/model.kiln").exists() {
            assert_eq!(space.read("out/model.kiln"), expected, "a kill left a half-written output");
        }
        space.build();
        assert_eq!(space.read("out/model.kiln"), expected);
        let leftovers: Vec<_> = space.files().into_iter().map(|(name, _)| name).filter(|n| n.contains("tmp")).collect();
        assert!(leftovers.is_empty(), "{leftovers:?}");
    }
    assert!(killed > 0, "no kill met a running build: the test proved nothing");
}
