//! Killed at any step, a build leaves nothing that the next one trips over; many builders may share a cache.
//!
//! A test starts its own binary again as a child, which ends itself by an abort at the n-th step on the file system; writes are
//! split in two so that torn files occur too.

use std::fs;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;

use super::*;
use crate::disk::{ABORT_AT, STEPS};

const FOLDER: &str = "KILN_ENGINE_TEST_FOLDER";
const ABORT: &str = "KILN_ENGINE_TEST_ABORT_AT";

/// Whether this process is the child of the test `name`; then it has built the toy project in the given folder.
fn is_child() -> bool {
    let Ok(folder) = std::env::var(FOLDER) else { return false };
    let abort: u64 = std::env::var(ABORT).unwrap().parse().unwrap();
    STEPS.store(0, Ordering::SeqCst);
    ABORT_AT.store(abort, Ordering::SeqCst);
    let options = BuildOptions { jobs: 1, durability: Durability::Never, ..BuildOptions::default() };
    let recipe = Recipe { factor: 2.0, ..Recipe::default() };
    let plan = plan(Path::new(&folder), &recipe, &Arc::default());
    let report =
        Engine::open(Path::new(&folder).join(".kiln"), "toy.toml").build(&plan, &options, &NoObserver).unwrap();
    assert!(report.succeeded(), "{report:#?}");
    true
}

fn child(test: &str, folder: &Path, abort: u64) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", test])
        .env(FOLDER, folder)
        .env(ABORT, abort.to_string())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// What a clean build of the child's recipe gives.
fn clean() -> String {
    let toy = Toy { recipe: Recipe { factor: 2.0, ..Recipe::default() }, ..Toy::new() };
    toy.build();
    toy.read("build/pot.out")
}

/// Kills the child at every step of its build in `toy()`; the next build must give clean bytes and leave no litter beside them.
fn killed_at_every_step(test: &str, toy: impl Fn() -> Toy) {
    let clean = clean();
    let mut steps = 0;
    for abort in 1.. {
        let mut toy = toy();
        let ended = child(test, toy.root(), abort).wait().unwrap();
        assert_ne!(ended.code(), Some(101), "the child must be killed or succeed, not fail");
        toy.recipe.factor = 2.0;
        let (report, _) = toy.build();
        assert!(report.succeeded() && report.warnings.is_empty(), "killed at step {abort}: {report:#?}");
        assert_eq!(toy.read("build/pot.out"), clean, "killed at step {abort}");
        assert_eq!(files_under(&toy.path("build")), [toy.path("build/pot.out")], "killed at step {abort}");
        assert!(toy.build().0.nothing_to_do(), "killed at step {abort}");
        if ended.success() {
            break;
        }
        steps = abort;
    }
    assert!(steps > 20, "the child was killed at {steps} steps only");
}

#[test]
fn a_first_build_killed_at_any_step_is_completed_by_the_next() {
    if !is_child() {
        killed_at_every_step("tests::crash::a_first_build_killed_at_any_step_is_completed_by_the_next", Toy::new);
    }
}

#[test]
fn a_rebuild_killed_at_any_step_is_completed_by_the_next() {
    if !is_child() {
        killed_at_every_step("tests::crash::a_rebuild_killed_at_any_step_is_completed_by_the_next", || {
            let toy = Toy::new();
            toy.build();
            toy.write("models/pot.txt", "# a longer comment than before\na pot\nuse a.png\nuse b.png\n");
            toy
        });
    }
}

#[test]
fn builders_in_several_processes_share_a_cache_and_an_output() {
    if is_child() {
        return;
    }
    let clean = clean();
    for _ in 0..3 {
        let mut toy = Toy::new();
        let test = "tests::crash::builders_in_several_processes_share_a_cache_and_an_output";
        let children: Vec<Child> = (0..3).map(|_| child(test, toy.root(), 0)).collect();
        for mut child in children {
            assert!(child.wait().unwrap().success());
        }
        assert_eq!(toy.read("build/pot.out"), clean);
        toy.recipe.factor = 2.0;
        assert!(toy.build().0.nothing_to_do());
    }
}

#[test]
fn builders_in_several_threads_share_a_cache_while_one_of_them_damages_it() {
    let toy = Toy::new();
    toy.build();
    std::thread::scope(|scope| {
        for builder in 0..3_u32 {
            let toy = &toy;
            scope.spawn(move || {
                for round in 0..20 {
                    let recipe = Recipe { factor: f64::from((builder + round) % 3), ..Recipe::default() };
                    let mut plan = plan(toy.root(), &recipe, &Arc::default());
                    plan.targets[0].path = format!("build/{builder}.out");
                    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
                    assert!(report.succeeded(), "{report:#?}");
                    let shout = "A POT\nUSE A.PNG\nUSE B.PNG\n".repeat(recipe.factor as usize);
                    assert_eq!(toy.read(&format!("build/{builder}.out")), format!("{shout}|apple|banana"));
                    let blobs = files_under(&toy.path(".kiln/v1/blobs"));
                    if let Some(blob) = blobs.get(round as usize % blobs.len().max(1)) {
                        // Another builder may have moved it aside already.
                        let _ = fs::write(blob, "damaged");
                    }
                }
            });
        }
    });
}

#[test]
fn what_a_killed_build_left_beside_an_output_goes_away_though_the_output_is_right() {
    let toy = Toy::new();
    toy.build();
    toy.write("build/.pot.out.kiln-tmp", "half");
    assert!(toy.build().0.nothing_to_do());
    assert_eq!(files_under(&toy.path("build")), [toy.path("build/pot.out")]);
}
