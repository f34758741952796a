//! A stage that gives other bytes for the same inputs is named; those behind it are not.

use std::sync::atomic::{AtomicUsize, Ordering};

use super::*;

fn verify(toy: &Toy, plan: &Plan) -> Verification {
    toy.engine().verify(plan, &toy.options, &NoObserver, &|work| work()).unwrap()
}

#[test]
fn stages_that_keep_their_promise_are_found_consistent_and_nothing_stays() {
    let toy = Toy::new();
    let found = verify(&toy, &toy.plan());
    assert!(found.inconsistent.is_empty() && found.failed.is_empty() && !found.cancelled, "{found:?}");
    assert_eq!(found.compared, 4);
    assert_eq!(toy.ran.lock().unwrap().len(), 8);
    assert!(!toy.path("build/pot.out").exists() && files_under(&toy.path(".kiln/v1/tmp")).is_empty());
    assert!(fs::read_dir(toy.path(".kiln/v1/tmp")).unwrap().next().is_none());
}

#[test]
fn a_stage_whose_bytes_depend_on_something_undeclared_is_named_and_no_other() {
    let toy = Toy::new();
    let mut plan = toy.plan();
    let runs = AtomicUsize::new(0);
    plan.actions[SHOUT].run = Arc::new(move |context: &Context<'_>| {
        let mut text = context.input("text")?.to_vec();
        text.push(runs.fetch_add(1, Ordering::Relaxed) as u8);
        Ok(Outputs::new().with("same", b"same".to_vec()).with("text", text))
    });
    let found = verify(&toy, &plan);
    let named: Vec<_> =
        found.inconsistent.iter().map(|one| (one.label.as_str(), one.output.as_str(), one.cached)).collect();
    assert_eq!(named, [("pot#shout", "text", false)]);
    assert_ne!(found.inconsistent[0].first, found.inconsistent[0].other);
    assert_eq!(found.compared, 3, "pack was given other bytes: nobody can blame it");
}

#[test]
fn a_stage_whose_output_changed_without_its_version_is_found_by_the_cache() {
    let toy = Toy::new();
    toy.build();
    let mut plan = toy.plan();
    plan.actions[STRIP].run =
        Arc::new(|_: &Context<'_>| Ok(Outputs::new().with("text", b"another program's bytes".to_vec())));
    let found = verify(&toy, &plan);
    let named: Vec<_> = found.inconsistent.iter().map(|one| (one.label.as_str(), one.cached)).collect();
    assert_eq!(named, [("pot#strip", true)]);
    plan.actions[STRIP].version += 1;
    assert!(verify(&toy, &plan).inconsistent.is_empty(), "another version, another fingerprint");
}

#[test]
fn a_failing_stage_is_told_and_does_not_hide_the_others() {
    let mut toy = Toy::new();
    toy.recipe.broken = true;
    let found = verify(&toy, &toy.plan());
    assert_eq!(found.failed, [("pot#shout".to_owned(), "the voice broke".to_owned())]);
    assert_eq!(found.compared, 2);
}
