//! The short way through a build without work.

use std::fs;

use super::*;

fn key() -> ContentHash {
    ContentHash::of(b"kiln 1, no settings")
}

/// Builds as the pipeline layer does; gives the note if the short way was open, else whether it is from now on.
fn build(toy: &Toy) -> Result<Vec<u8>, bool> {
    let mut engine = toy.engine();
    if let Some(note) = engine.fast_noop_check(toy.root(), &key()) {
        return Ok(note);
    }
    let plan = toy.plan();
    let report = engine.build(&plan, &toy.options, &NoObserver).unwrap();
    let noop =
        Noop { key: key(), files: vec!["toy.toml".into()], folders: vec!["models".into()], note: b"all fresh".into() };
    Err(engine.remember_noop(&plan, &report, &noop).unwrap())
}

fn ready() -> Toy {
    let toy = Toy::new().trusting_stats();
    toy.write("toy.toml", "factor = 1");
    toy.settle("toy.toml");
    assert_eq!(build(&toy), Err(false), "the output is too young");
    toy.settle("build/pot.out");
    assert_eq!(build(&toy), Err(true));
    assert_eq!(build(&toy), Ok(b"all fresh".to_vec()));
    toy.ran.lock().unwrap().clear();
    toy
}

#[test]
fn an_untouched_project_is_found_fresh_by_stats_alone() {
    let toy = ready();
    let before = files_under(toy.root());
    assert!(build(&toy).is_ok());
    assert_eq!(files_under(toy.root()), before);
    assert!(
        toy.engine().fast_noop_check(toy.root(), &ContentHash::of(b"kiln 2")).is_none(),
        "another key, another plan"
    );
}

#[test]
fn anything_that_was_looked_at_closes_the_short_way() {
    for path in ["toy.toml", "models/pot.txt", "models/a.png", "build/pot.out", "models/new.txt"] {
        let toy = ready();
        toy.write(path, "something else");
        assert!(build(&toy).is_err(), "{path} was written");
    }
    for path in ["toy.toml", "models/b.png", "build/pot.out"] {
        let toy = ready();
        fs::remove_file(toy.path(path)).unwrap();
        assert!(toy.engine().fast_noop_check(toy.root(), &key()).is_none(), "{path} was removed");
    }
}

#[test]
fn a_file_that_was_looked_for_in_vain_closes_the_short_way_when_it_appears() {
    let toy = Toy::new();
    fs::remove_file(toy.path("models/b.png")).unwrap();
    let toy = Toy { options: BuildOptions { clock_granularity: Duration::ZERO, ..toy.options.clone() }, ..toy };
    let open = |toy: &Toy| {
        let mut engine = toy.engine();
        engine.fast_noop_check(toy.root(), &key()).ok_or_else(|| {
            let plan = toy.plan();
            let report = engine.build(&plan, &toy.options, &NoObserver).unwrap();
            let noop = Noop { key: key(), files: vec![], folders: vec![], note: vec![] };
            engine.remember_noop(&plan, &report, &noop).unwrap()
        })
    };
    toy.settle("models/pot.txt");
    open(&toy).unwrap_err();
    toy.settle("build/pot.out");
    open(&toy).unwrap_err();
    assert_eq!(open(&toy), Ok(vec![]));
    toy.write("models/b.png", "banana");
    assert!(open(&toy).is_err());
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
}

#[test]
fn a_failed_build_opens_no_short_way() {
    let mut toy = ready();
    toy.recipe.broken = true;
    toy.write("toy.toml", "broken = true");
    toy.settle("toy.toml");
    assert_eq!(build(&toy), Err(false));
    assert_eq!(build(&toy), Err(false));
}
