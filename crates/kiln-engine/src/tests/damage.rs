//! Damage to the cache costs time, never truth: whatever is cut, flipped or removed, the next build gives clean bytes.

use std::fs;

use super::*;

/// Rewrites a file, removes the output, and expects that a build still gives clean bytes.
#[track_caller]
fn survives(toy: &Toy, path: &Path, bytes: &[u8]) -> BuildReport {
    fs::write(path, bytes).unwrap();
    let _ = fs::remove_file(toy.path("build/pot.out"));
    let (report, _) = toy.build();
    assert!(report.succeeded(), "{}: {report:#?}", path.display());
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
    report
}

fn blob_of(toy: &Toy, content: &str) -> PathBuf {
    let hash = ContentHash::of(content.as_bytes()).hex();
    toy.path(".kiln/v1/blobs").join(&hash[..2]).join(hash)
}

fn state_file(toy: &Toy) -> PathBuf {
    files_under(&toy.path(".kiln/v1/state"))
        .into_iter()
        .find(|path| path.extension() != Some("index".as_ref()))
        .unwrap()
}

fn index_file(toy: &Toy) -> PathBuf {
    files_under(&toy.path(".kiln/v1/state"))
        .into_iter()
        .find(|path| path.extension() == Some("index".as_ref()))
        .unwrap()
}

#[test]
fn a_blob_with_a_flipped_byte_is_moved_aside_and_made_again() {
    let toy = Toy::new();
    toy.build();
    let blob = blob_of(&toy, EXPECTED);
    let whole = fs::read(&blob).unwrap();
    for at in 0..whole.len() {
        let mut flipped = whole.clone();
        flipped[at] ^= 0x20;
        let report = survives(&toy, &blob, &flipped);
        assert_eq!(*reason(&report, PACK), StaleReason::BlobLost { what: "container".into() }, "byte {at}");
        assert!(report.warnings.iter().any(|warning| warning.contains("damaged blob")), "{report:#?}");
        assert_eq!(fs::read(&blob).unwrap(), whole);
    }
    assert_eq!(files_under(&toy.path(".kiln/v1/quarantine")).len(), whole.len());
}

#[test]
fn a_blob_cut_anywhere_is_made_again() {
    let toy = Toy::new();
    toy.build();
    let blob = blob_of(&toy, EXPECTED);
    let whole = fs::read(&blob).unwrap();
    for length in 0..whole.len() {
        survives(&toy, &blob, &whole[..length]);
    }
    survives(&toy, &blob, &[&whole[..], b"more"].concat());
}

#[test]
fn lost_blobs_of_a_whole_chain_are_made_again() {
    let toy = Toy::new();
    toy.build();
    for blob in files_under(&toy.path(".kiln/v1/blobs")) {
        fs::remove_file(blob).unwrap();
    }
    fs::remove_file(toy.path("build/pot.out")).unwrap();
    let report = toy.build_running(&["pack", "shout", "strip", "import"]);
    assert!((IMPORT..=PACK).all(|action| matches!(reason(&report, action), StaleReason::BlobLost { .. })));
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
}

#[test]
fn damaged_records_and_lists_are_misses() {
    let toy = Toy::new();
    toy.build();
    let damaged = [files_under(&toy.path(".kiln/v1/actions")), files_under(&toy.path(".kiln/v1/lists"))].concat();
    assert_eq!(damaged.len(), 5);
    for path in damaged {
        let whole = fs::read(&path).unwrap();
        let mut flipped = whole.clone();
        flipped[whole.len() / 2] ^= 1;
        for bytes in [&whole[..whole.len() - 1], &whole[..7], &flipped] {
            fs::remove_file(state_file(&toy)).unwrap();
            survives(&toy, &path, bytes);
            assert!(fs::read(&path).is_ok(), "it was written again");
        }
    }
}

#[test]
fn a_record_under_another_fingerprint_is_refused() {
    let toy = Toy::new();
    toy.build();
    let records = files_under(&toy.path(".kiln/v1/actions"));
    let other = fs::read(&records[1]).unwrap();
    fs::remove_file(state_file(&toy)).unwrap();
    survives(&toy, &records[0], &other);
}

#[test]
fn a_state_file_cut_anywhere_costs_no_run() {
    let toy = Toy::new().trusting_stats();
    toy.build();
    let state = state_file(&toy);
    let whole = fs::read(&state).unwrap();
    assert!(whole.len() > 1000);
    for length in 0..whole.len() {
        fs::write(&state, &whole[..length]).unwrap();
        let (report, ran) = toy.build();
        assert!(report.nothing_to_do() && report.warnings.is_empty(), "cut at {length}: {report:#?}");
        assert!(ran.is_empty());
    }
}

#[test]
fn an_index_cut_or_flipped_anywhere_costs_no_run() {
    let toy = Toy::new().trusting_stats();
    toy.build();
    let index = index_file(&toy);
    let whole = fs::read(&index).unwrap();
    assert!(whole.len() > 300);
    for at in 0..whole.len() {
        let mut flipped = whole.clone();
        flipped[at] ^= 0x11;
        for bytes in [&whole[..at], &flipped] {
            fs::write(&index, bytes).unwrap();
            let (report, ran) = toy.build();
            assert!(report.nothing_to_do() && report.warnings.is_empty() && ran.is_empty(), "byte {at}: {report:#?}");
            assert_eq!(report.files_hashed, 4, "what it knew is known no more");
        }
    }
}

#[test]
fn a_state_file_with_a_flipped_byte_costs_no_run() {
    let toy = Toy::new().trusting_stats();
    toy.build();
    let state = state_file(&toy);
    let whole = fs::read(&state).unwrap();
    for at in 0..whole.len() {
        let mut flipped = whole.clone();
        flipped[at] ^= 0x11;
        fs::write(&state, &flipped).unwrap();
        let (report, ran) = toy.build();
        assert!(report.nothing_to_do() && ran.is_empty(), "byte {at}: {report:#?}");
    }
}

#[test]
fn the_state_file_is_rewritten_when_most_of_it_is_dead() {
    let mut toy = Toy::new();
    let mut longest = 0;
    for round in 0..200 {
        toy.recipe.factor = f64::from(round % 2);
        toy.build();
        longest = longest.max(fs::metadata(state_file(&toy)).unwrap().len());
    }
    let last = fs::metadata(state_file(&toy)).unwrap().len();
    assert!(last < longest && longest < 64_000, "longest {longest}, last {last} bytes");
    assert!(toy.build().0.nothing_to_do());
}

#[test]
fn a_state_file_that_is_a_folder_is_a_warning() {
    let toy = Toy::new();
    toy.build();
    let state = state_file(&toy);
    fs::remove_file(&state).unwrap();
    fs::create_dir(&state).unwrap();
    let (report, _) = toy.build();
    assert!(report.nothing_to_do());
    assert!(report.warnings[0].contains("the next build will look closer"), "{:?}", report.warnings);
}

#[test]
fn an_action_that_gives_other_bytes_each_time_is_reported_when_its_blob_is_lost() {
    let toy = Toy::new();
    let mut plan = toy.plan();
    let count = Arc::new(Mutex::new(0));
    plan.actions[SHOUT].run = Arc::new(move |_: &Context<'_>| {
        let mut count = count.lock().unwrap();
        *count += 1;
        Ok(Outputs::new().with("text", format!("try {count}").into_bytes()))
    });
    let build = || toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    assert!(build().succeeded());
    for blob in files_under(&toy.path(".kiln/v1/blobs")) {
        fs::remove_file(blob).unwrap();
    }
    fs::remove_file(toy.path("build/pot.out")).unwrap();
    let report = build();
    assert!(format!("{report:?}").contains("NotDeterministic"), "{report:#?}");
    assert!(build().succeeded(), "the new bytes are the truth from now on");
}

#[test]
fn a_memo_that_lies_is_found_out_when_the_file_is_read() {
    let toy = Toy::new();
    let stat = Stat::of(&fs::metadata(toy.path("models/pot.txt")).unwrap());
    let mut engine = toy.engine();
    engine.lie("models/pot.txt", stat, ContentHash::of(b"something else"));
    let report = toy.build_running(&["import", "import", "strip", "shout", "pack"]);
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
    assert_eq!(report.actions[IMPORT].record.as_ref().unwrap().outputs[0].name, "text");
    toy.build_running(&[]);
}
