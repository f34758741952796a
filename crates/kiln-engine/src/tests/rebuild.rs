//! What runs after which change.

use std::fs;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Barrier, Mutex};
use std::time::Duration;

use super::*;

#[test]
fn a_first_build_runs_everything_and_writes_the_target() {
    let toy = Toy::new();
    let report = toy.build_running(&["import", "strip", "shout", "pack"]);
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
    assert_eq!(*reason(&report, IMPORT), StaleReason::NoRecord);
    assert!(matches!(&report.targets[0].state, TargetState::Written { reason: StaleReason::OutputMissing { .. } }));
}

#[test]
fn a_second_build_runs_nothing_writes_nothing_and_still_shows_the_reports() {
    let toy = Toy::new();
    toy.build_running(&["import", "strip", "shout", "pack"]);
    let before: Vec<_> =
        files_under(toy.root()).iter().map(|path| fs::metadata(path).unwrap().modified().unwrap()).collect();
    let report = toy.build_running(&[]);
    assert!(report.nothing_to_do());
    assert_eq!(report.actions[IMPORT].record.as_ref().unwrap().report, br#"{"lines":4}"#);
    let after: Vec<_> =
        files_under(toy.root()).iter().map(|path| fs::metadata(path).unwrap().modified().unwrap()).collect();
    assert_eq!(before, after);
}

#[test]
fn a_changed_comment_stops_at_the_stage_that_drops_it() {
    let toy = Toy::new();
    toy.build();
    toy.write("models/pot.txt", "# another comment\na pot\nuse a.png\nuse b.png\n");
    let report = toy.build_running(&["import", "strip"]);
    assert!(matches!(report.targets[0].state, TargetState::Unchanged));
}

#[test]
fn a_changed_image_leaves_the_stages_fresh_that_it_does_not_reach() {
    let toy = Toy::new();
    toy.build();
    toy.write("models/b.png", "berry");
    let report = toy.build_running(&["import", "pack"]);
    assert_eq!(toy.read("build/pot.out"), "A POT\nUSE A.PNG\nUSE B.PNG\n|apple|berry");
    assert!(matches!(&report.targets[0].state, TargetState::Written { reason: StaleReason::OutputDiffers { .. } }));
}

#[test]
fn a_parameter_put_back_is_fresh_from_the_cache() {
    let mut toy = Toy::new();
    toy.build();
    toy.recipe.factor = 2.0;
    toy.build_running(&["shout", "pack"]);
    toy.recipe.factor = 1.0;
    toy.build_running(&[]);
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
}

#[test]
fn a_moved_project_runs_nothing() {
    let toy = Toy::new();
    toy.build();
    let elsewhere = tempfile::tempdir().unwrap();
    let moved = elsewhere.path().join("moved");
    fs::rename(toy.root(), &moved).unwrap();
    let ran = Arc::default();
    let plan = plan(&moved, &toy.recipe, &ran);
    let report = Engine::open(moved.join(".kiln"), "toy.toml").build(&plan, &toy.options, &NoObserver).unwrap();
    assert!(report.nothing_to_do(), "{report:#?}");
}

#[test]
fn a_touched_file_is_read_again_and_nothing_runs() {
    let toy = Toy::new().trusting_stats();
    toy.build();
    let report = toy.build_running(&[]);
    assert_eq!(report.files_hashed, 1, "the output alone: it was too young when it was written");
    toy.settle("build/pot.out");
    toy.build_running(&[]);
    assert_eq!(toy.build_running(&[]).files_hashed, 0, "stats are enough");
    let file = fs::File::options().append(true).open(toy.path("models/a.png")).unwrap();
    file.set_modified(std::time::UNIX_EPOCH + Duration::from_secs(1_000_000_000)).unwrap();
    assert_eq!(toy.build_running(&[]).files_hashed, 1);
}

#[test]
fn a_file_changed_within_the_clocks_granularity_is_noticed_though_its_stat_could_be_the_same() {
    let toy = Toy::new();
    toy.build();
    let report = toy.build_running(&[]);
    assert_eq!(report.files_hashed, 4, "no stat of a file younger than two seconds is trusted");
}

#[test]
fn a_renamed_but_equal_input_runs_nothing() {
    let toy = Toy::new();
    toy.build();
    fs::rename(toy.path("models/pot.txt"), toy.path("models/jar.txt")).unwrap();
    let mut plan = toy.plan();
    plan.actions[IMPORT].inputs[0].source = Source::file("models/jar.txt");
    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    assert!(report.nothing_to_do(), "{report:#?}");
}

#[test]
fn the_number_of_threads_and_the_order_of_parameters_change_nothing() {
    let mut toy = Toy::new();
    toy.build();
    toy.options.jobs = 1;
    toy.build_running(&[]);
    let mut plan = toy.plan();
    plan.actions[SHOUT].params.reverse();
    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    assert!(report.nothing_to_do(), "{report:#?}");
}

#[test]
fn a_deleted_output_comes_back_without_running_a_stage() {
    let toy = Toy::new();
    toy.build();
    fs::remove_file(toy.path("build/pot.out")).unwrap();
    let report = toy.build_running(&[]);
    assert!(matches!(&report.targets[0].state, TargetState::Written { reason: StaleReason::OutputMissing { .. } }));
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
}

#[test]
fn an_edited_output_is_put_right_without_running_a_stage() {
    let toy = Toy::new();
    toy.build();
    toy.write("build/pot.out", &EXPECTED.replace('O', "0"));
    let report = toy.build_running(&[]);
    assert!(matches!(&report.targets[0].state, TargetState::Written { reason: StaleReason::OutputDiffers { .. } }));
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
}

#[test]
fn a_failed_action_leaves_nothing_and_the_old_output_stays() {
    let mut toy = Toy::new();
    toy.build();
    let cached = files_under(&toy.path(".kiln/v1/actions")).len();
    toy.recipe.broken = true;
    let (report, ran) = toy.build();
    assert_eq!(ran, ["shout"]);
    assert!(
        matches!(&report.actions[SHOUT].state, ActionState::Failed(error) if error.to_string() == "the voice broke")
    );
    assert!(matches!(report.actions[PACK].state, ActionState::Skipped { .. }));
    assert!(matches!(report.targets[0].state, TargetState::Skipped));
    assert!(!report.succeeded());
    assert_eq!(files_under(&toy.path(".kiln/v1/actions")).len(), cached);
    assert!(files_under(&toy.path(".kiln/v1/tmp")).is_empty());
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
    let (_, ran) = toy.build();
    assert_eq!(ran, ["shout"], "a failure is not remembered");
}

/// Two assets of one action and one target each; the first fails.
fn two_assets(root: &Path) -> Plan {
    let fail = Action::new("a", "toy", 1, |_: &Context<'_>| Err(ActionError::failed("no")));
    let after = Action::new("a2", "toy", 1, |_: &Context<'_>| Ok(Outputs::new())).input("x", Source::output(0, "x"));
    let good = Action::new("b", "toy", 1, |_: &Context<'_>| Ok(Outputs::new().with("x", b"good".to_vec())));
    let target = |path: &str, action| Target { path: path.into(), action, output: "x".into() };
    Plan {
        root: root.to_owned(),
        actions: vec![fail, after, good],
        targets: vec![target("a.out", 0), target("b.out", 2)],
    }
}

#[test]
fn keep_going_builds_what_does_not_depend_on_the_failure() {
    let toy = Toy::new();
    let plan = two_assets(toy.root());
    let options = BuildOptions { jobs: 1, ..toy.options.clone() };
    let report = toy.engine().build(&plan, &options, &NoObserver).unwrap();
    assert!(matches!(report.actions[2].state, ActionState::Skipped { because: None }), "without it the build stops");
    assert!(!toy.path("b.out").exists());

    let options = BuildOptions { keep_going: true, ..options };
    let report = toy.engine().build(&plan, &options, &NoObserver).unwrap();
    assert!(matches!(report.actions[1].state, ActionState::Skipped { because: Some(0) }));
    assert!(matches!(report.actions[2].state, ActionState::Ran { .. }));
    assert_eq!(toy.read("b.out"), "good");
    assert!(!report.succeeded());
}

#[test]
fn a_cancelled_build_keeps_what_is_whole_and_nothing_half() {
    let toy = Toy::new();
    let mut plan = toy.plan();
    let cancel = toy.options.cancel.clone();
    plan.actions[STRIP].run = Arc::new(move |context: &Context<'_>| {
        cancel.store(true, Ordering::Relaxed);
        // An action that gives half of its outputs because it was asked to end: they must not be kept.
        assert!(context.is_cancelled());
        Ok(Outputs::new().with("text", b"half".to_vec()))
    });
    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    assert!(report.cancelled && !report.succeeded());
    assert!(matches!(report.actions[STRIP].state, ActionState::Failed(ActionError::Cancelled)));
    assert!(!toy.path("build/pot.out").exists());
    toy.ran.lock().unwrap().clear();
    toy.options.cancel.store(false, Ordering::Relaxed);
    toy.build_running(&["strip", "shout", "pack"]);
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
}

#[test]
fn a_panicking_action_fails_and_the_build_ends_well() {
    let toy = Toy::new();
    let mut plan = toy.plan();
    plan.actions[STRIP].run = Arc::new(|_: &Context<'_>| panic!("index out of bounds"));
    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    let ActionState::Failed(error) = &report.actions[STRIP].state else { panic!("{report:#?}") };
    assert_eq!(error.to_string(), "the stage panicked: index out of bounds");
}

#[test]
fn a_missing_declared_file_is_an_error_that_names_it() {
    let toy = Toy::new();
    fs::remove_file(toy.path("models/pot.txt")).unwrap();
    let (report, ran) = toy.build();
    assert!(ran.is_empty());
    let ActionState::Failed(error) = &report.actions[IMPORT].state else { panic!("{report:#?}") };
    assert!(error.to_string().contains("pot.txt"), "{error}");
}

#[test]
fn a_file_that_changes_while_the_action_starts_is_read_anew() {
    let toy = Toy::new();
    let mut plan = toy.plan();
    let run = plan.actions[IMPORT].run.clone();
    let model = toy.path("models/pot.txt");
    let attempts = Arc::new(AtomicUsize::new(0));
    let counted = attempts.clone();
    plan.actions[IMPORT].run = Arc::new(move |context: &Context<'_>| {
        if counted.fetch_add(1, Ordering::Relaxed) == 0 {
            fs::write(&model, "a jar\n").unwrap();
        }
        run(context)
    });
    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    assert!(report.succeeded(), "{report:#?}");
    assert_eq!(attempts.load(Ordering::Relaxed), 2);
    assert_eq!(toy.read("build/pot.out"), "A JAR\n");
    toy.ran.lock().unwrap().clear();
    toy.build_running(&[]);
}

#[test]
fn an_action_may_not_read_outside_its_folder_nor_without_one() {
    let toy = Toy::new();
    toy.write("secret.txt", "secret");
    let kinds = Arc::new(Mutex::new(Vec::new()));
    let noted = kinds.clone();
    let read = move |context: &Context<'_>| {
        for path in ["../secret.txt", "/etc/hostname", "a/../../secret.txt", "", "a\\b"] {
            noted.lock().unwrap().push(context.read_file(path).unwrap_err().kind());
        }
        Ok(Outputs::new())
    };
    let mut inside = Action::new("inside", "toy", 1, read.clone());
    inside.discovers = Some("models".into());
    let plan = Plan {
        root: toy.root().to_owned(),
        actions: vec![inside, Action::new("none", "toy", 1, read)],
        targets: vec![],
    };
    let options = BuildOptions { jobs: 1, ..toy.options.clone() };
    toy.engine().build(&plan, &options, &NoObserver).unwrap();
    let expected = [[std::io::ErrorKind::InvalidInput; 5], [std::io::ErrorKind::PermissionDenied; 5]].concat();
    assert_eq!(*kinds.lock().unwrap(), expected);
}

#[test]
fn an_unreadable_found_file_spoils_the_action_even_if_it_goes_on() {
    let toy = Toy::new();
    fs::remove_file(toy.path("models/a.png")).unwrap();
    fs::create_dir(toy.path("models/a.png")).unwrap();
    let mut plan = toy.plan();
    plan.actions[IMPORT].run = Arc::new(|context: &Context<'_>| {
        assert!(context.read_file("a.png").is_err());
        Ok(Outputs::new().with("text", b"without".to_vec()))
    });
    let report = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    let ActionState::Failed(error) = &report.actions[IMPORT].state else { panic!("{report:#?}") };
    assert!(error.to_string().contains("a.png"), "{error}");
}

#[test]
fn unusable_folders_are_errors_that_name_them() {
    let toy = Toy::new();
    toy.write("build", "a file where the folder should be");
    let (report, _) = toy.build();
    let TargetState::Failed(error) = &report.targets[0].state else { panic!("{report:#?}") };
    assert!(error.to_string().contains(&toy.path("build").display().to_string()), "{error}");

    let toy = Toy::new();
    toy.write(".kiln", "a file where the cache should be");
    let error = toy.engine().build(&toy.plan(), &toy.options, &NoObserver).unwrap_err();
    assert!(error.to_string().contains(&toy.path(".kiln").display().to_string()), "{error}");
}

#[test]
fn a_dry_run_says_what_would_run_and_does_nothing() {
    let mut toy = Toy::new();
    toy.options.dry_run = true;
    let (report, ran) = toy.build();
    assert!(ran.is_empty() && !toy.path(".kiln").exists() && !toy.path("build").exists());
    assert!(matches!(report.actions[IMPORT].state, ActionState::WouldRun { reason: StaleReason::NoRecord }));
    assert!(matches!(report.actions[PACK].state, ActionState::DependsOn { .. }));
    assert!(matches!(report.targets[0].state, TargetState::DependsOn { on: PACK }));

    toy.options.dry_run = false;
    toy.build();
    toy.options.dry_run = true;
    assert!(toy.build().0.nothing_to_do());
    toy.recipe.factor = 2.0;
    let (report, ran) = toy.build();
    assert!(ran.is_empty());
    assert!(matches!(report.actions[STRIP].state, ActionState::Fresh));
    assert!(matches!(report.actions[SHOUT].state, ActionState::WouldRun { .. }));
    assert!(matches!(report.actions[PACK].state, ActionState::DependsOn { on: SHOUT }));
}

#[test]
fn two_equal_actions_run_once() {
    let toy = Toy::new();
    let count = Arc::new(AtomicUsize::new(0));
    let equal = |id: &str| {
        let count = count.clone();
        Action::new(id, "toy", 1, move |_: &Context<'_>| {
            count.fetch_add(1, Ordering::Relaxed);
            Ok(Outputs::new().with("x", b"same".to_vec()))
        })
    };
    let actions = (0..8).map(|index| equal(&index.to_string())).collect();
    let plan = Plan { root: toy.root().to_owned(), actions, targets: vec![] };
    let options = BuildOptions { jobs: 4, ..toy.options.clone() };
    assert!(toy.engine().build(&plan, &options, &NoObserver).unwrap().succeeded());
    assert_eq!(count.load(Ordering::Relaxed), 1);
}

#[test]
fn actions_of_two_assets_run_at_the_same_time() {
    let toy = Toy::new();
    // Each waits for the other: one after the other they would never end.
    let meeting = Arc::new(Barrier::new(2));
    let actions = ["a", "b"].map(|id| {
        let meeting = meeting.clone();
        Action::new(id, "toy", 1, move |_: &Context<'_>| {
            meeting.wait();
            Ok(Outputs::new())
        })
        .param("id", id)
    });
    let plan = Plan { root: toy.root().to_owned(), actions: actions.into(), targets: vec![] };
    assert!(toy.engine().build(&plan, &toy.options, &NoObserver).unwrap().succeeded());
}

#[test]
fn a_plan_that_contradicts_itself_is_refused_with_all_defects() {
    let toy = Toy::new();
    let mut plan = toy.plan();
    plan.actions[STRIP].id = "pot#import".into();
    plan.actions[STRIP].inputs[0].source = Source::output(PACK, "text");
    plan.actions[SHOUT].params.push(("factor".into(), 3.0.into()));
    plan.targets.push(plan.targets[0].clone());
    plan.targets.push(Target { path: "models/pot.txt".into(), action: 9, output: "x".into() });
    let error = toy.engine().build(&plan, &toy.options, &NoObserver).unwrap_err();
    let EngineError::InvalidPlan(defects) = error else { panic!("{error}") };
    assert_eq!(defects.len(), 6, "{defects:#?}");
}

#[test]
fn events_tell_the_course_of_a_build() {
    struct Log(Mutex<Vec<String>>);
    impl Observer for Log {
        fn event(&self, event: &Event<'_>) {
            let line = match event {
                Event::Planned { actions, targets } => format!("planned {actions} {targets}"),
                Event::Started { action, reason, .. } => format!("started {action} ({reason})"),
                Event::Progress { action, fraction, label } => format!("progress {action} {fraction} {label}"),
                Event::Finished { action, bytes, .. } => format!("finished {action} {bytes}"),
                Event::TargetFinished { target, .. } => format!("target {target}"),
                Event::Elsewhere(progress) => format!("elsewhere {progress:?}"),
                Event::Warning { action, message } => format!("warning {action:?} {message}"),
            };
            self.0.lock().unwrap().push(line);
        }
    }
    let toy = Toy::new();
    let action = Action::new("a", "toy", 1, |context: &Context<'_>| {
        context.progress(0.5, "half");
        context.warn("small");
        Ok(Outputs::new().with("x", b"four".to_vec()))
    });
    let target = Target { path: "a.out".into(), action: 0, output: "x".into() };
    let plan = Plan { root: toy.root().to_owned(), actions: vec![action], targets: vec![target] };
    let log = Log(Mutex::default());
    let report = toy.engine().build(&plan, &toy.options, &log).unwrap();
    assert_eq!(report.actions[0].warnings, ["small"]);
    let expected = [
        "planned 1 1",
        "started 0 (first build)",
        "progress 0 0.5 half",
        "warning Some(0) small",
        "finished 0 4",
        "target 0",
    ];
    assert_eq!(*log.0.lock().unwrap(), expected);
}
