//! Parts of a plan, caches that are only read, and the tasks of a dry run.

use super::*;

/// The part that `action` needs, and what of it ran in the cache `cache` with these layers.
fn build_part(toy: &Toy, action: usize, cache: &str, layers: &[&str]) -> (BuildReport, Vec<&'static str>) {
    let (part, _) = toy.plan().upto(action);
    let layers = layers.iter().map(|layer| toy.path(layer)).collect();
    let mut engine = Engine::stateless(toy.path(cache)).with_layers(layers);
    let options = BuildOptions { timed: false, ..toy.options.clone() };
    let report = engine.build(&part, &options, &NoObserver).unwrap();
    let last = report.actions.last().unwrap().record.clone().unwrap();
    assert!(engine.adopt(&last).unwrap() && last.seconds == 0.0);
    (report, std::mem::take(&mut *toy.ran.lock().unwrap()))
}

/// Files of a cache below records, lists and blobs.
fn files(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    let mut open = ["actions", "lists", "blobs"].map(|name| folder.join("v1").join(name)).to_vec();
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
            if entry.path().is_dir() {
                open.push(entry.path())
            } else {
                found.push((entry.path(), fs::read(entry.path()).unwrap()))
            }
        }
    }
    found.sort();
    found
}

#[test]
fn a_part_keeps_what_an_action_needs_and_renumbers_it() {
    let toy = Toy::new();
    let plan = toy.plan();
    let (part, kept) = plan.upto(SHOUT);
    assert_eq!(kept, [IMPORT, STRIP, SHOUT]);
    assert!(part.defects().is_empty() && part.targets.is_empty());
    let (part, kept) = plan.upto(IMPORT);
    assert_eq!((kept, part.actions.len()), (vec![IMPORT], 1));
}

#[test]
fn what_a_layer_has_is_used_in_place_and_the_own_cache_holds_the_last_action_alone() {
    let toy = Toy::new();
    assert_eq!(build_part(&toy, IMPORT, "a", &[]).1, ["import"]);
    assert_eq!(build_part(&toy, STRIP, "b", &["a"]).1, ["strip"]);
    let before = (files(&toy.path("a")), files(&toy.path("b")));
    assert_eq!(build_part(&toy, SHOUT, "c", &["a", "b"]).1, ["shout"]);
    assert_eq!((files(&toy.path("a")), files(&toy.path("b"))), before, "layers stay as they are");
    let records = files(&toy.path("c")).iter().filter(|(path, _)| path.starts_with(toy.path("c/v1/actions"))).count();
    assert_eq!(records, 1);
    // Without times equal runs leave equal bytes; what only a layer has is copied when it is adopted.
    let own = |cache: &str| {
        let all = files(&toy.path(cache)).into_iter();
        all.map(|(path, bytes)| (path.strip_prefix(toy.path(cache)).unwrap().to_owned(), bytes)).collect::<Vec<_>>()
    };
    assert_eq!(build_part(&toy, SHOUT, "d", &["a", "b"]).1, ["shout"]);
    assert_eq!(build_part(&toy, SHOUT, "e", &["a", "b", "c"]).1, Vec::<&str>::new());
    assert_eq!(own("c"), own("d"));
    assert_eq!(own("c"), own("e"));
    // Nothing of it is a state of the whole.
    assert!(fs::read_dir(toy.path("c/v1/state")).unwrap().next().is_none());
}

#[test]
fn a_damaged_layer_is_a_miss_and_a_warning() {
    let toy = Toy::new();
    build_part(&toy, IMPORT, "a", &[]);
    for (path, bytes) in files(&toy.path("a")) {
        fs::write(path, &bytes[..bytes.len() - 1]).unwrap();
    }
    let before = files(&toy.path("a"));
    let (report, ran) = build_part(&toy, STRIP, "b", &["a"]);
    assert_eq!(ran, ["import", "strip"]);
    assert!(report.warnings.iter().any(|warning| warning.contains("is not used")), "{:?}", report.warnings);
    assert_eq!(files(&toy.path("a")), before);
}

#[test]
fn tasks_are_what_would_run_on_levels() {
    let toy = Toy::new();
    let dry = BuildOptions { dry_run: true, ..toy.options.clone() };
    let levels = |toy: &Toy| {
        let plan = toy.plan();
        let report = toy.engine().build(&plan, &dry, &NoObserver).unwrap();
        tasks(&plan, &report).iter().map(|task| (task.action, task.level, task.upstream.clone())).collect::<Vec<_>>()
    };
    let all = [(IMPORT, 0, vec![]), (STRIP, 1, vec![0]), (SHOUT, 2, vec![1]), (PACK, 3, vec![0, 2])];
    assert_eq!(levels(&toy), all);
    toy.build_running(&["import", "strip", "shout", "pack"]);
    assert!(levels(&toy).is_empty());
    let changed = Toy { recipe: Recipe { factor: 2.0, ..Recipe::default() }, ..toy };
    assert_eq!(levels(&changed), [(SHOUT, 0, vec![]), (PACK, 1, vec![0])]);
}

#[test]
fn a_failed_task_fails_with_its_message_and_runs_nothing() {
    let toy = Toy::new();
    let mut plan = toy.plan();
    let dry = BuildOptions { dry_run: true, ..toy.options.clone() };
    let tasks = tasks(&plan, &toy.engine().build(&plan, &dry, &NoObserver).unwrap());
    let failures = vec![Failure { task: 1, message: "the node died".into() }];
    settle(&mut plan, &tasks, &Executed { failures, cancelled: false });
    let options = BuildOptions { keep_going: true, ..toy.options.clone() };
    let report = toy.engine().build(&plan, &options, &NoObserver).unwrap();
    assert_eq!(*toy.ran.lock().unwrap(), ["import"]);
    assert!(matches!(&report.actions[STRIP].state, ActionState::Failed(error) if error.to_string() == "the node died"));
    assert!(matches!(report.actions[SHOUT].state, ActionState::Skipped { because: Some(STRIP) }));
}
