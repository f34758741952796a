//! The store beside its builders: garbage collection, leases, verification, a full disk, and processes killed in the middle.

use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};

use super::*;
use crate::disk::{ABORT_AT, ROOMS, STEPS, set_mtime};
use crate::store::Store;

const DAY: i64 = 86_400 * 1_000_000_000;

fn cache(toy: &Toy) -> Cache {
    Cache::open(toy.path(".kiln"))
}

/// Dates every file under a folder of the cache `days` back.
fn age(toy: &Toy, folder: &str, days: i64) {
    for path in files_under(&toy.path(".kiln/v1").join(folder)) {
        set_mtime(&path, mtime(&fs::metadata(&path).unwrap()) - days * DAY);
    }
}

fn days(days: u64) -> Option<Duration> {
    Some(Duration::from_secs(days * 86_400))
}

#[test]
fn collection_by_age_removes_what_no_build_used() {
    let toy = Toy::new();
    toy.build();
    for folder in ["actions", "lists", "blobs", "state"] {
        age(&toy, folder, 10);
    }
    let options = GcOptions { max_age: days(11), ..GcOptions::default() };
    assert_eq!(cache(&toy).gc(&options).unwrap().removed_files, 0);
    let options = GcOptions { max_age: days(9), dry_run: true, ..options };
    let told = cache(&toy).gc(&options).unwrap();
    assert_eq!((told.removed_files, told.removed_bytes), (told.files, told.bytes));
    assert!(!files_under(&toy.path(".kiln/v1/blobs")).is_empty(), "a dry run removes nothing");
    let done = cache(&toy).gc(&GcOptions { dry_run: false, ..options }).unwrap();
    assert_eq!(done, told);
    assert!(files_under(&toy.path(".kiln/v1/blobs")).is_empty());
    assert!(toy.build().0.nothing_to_do(), "what the outputs and the state hold needs no cache");
    fs::remove_file(toy.path("build/pot.out")).unwrap();
    assert!(toy.build().0.succeeded());
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
}

#[test]
fn a_young_build_state_keeps_what_it_names() {
    let toy = Toy::new();
    toy.build();
    for folder in ["actions", "lists", "blobs"] {
        age(&toy, folder, 10);
    }
    let done = cache(&toy).gc(&GcOptions { max_age: days(9), ..GcOptions::default() }).unwrap();
    assert_eq!(done.removed_files, 0, "the state was written now: its build used all of it");
}

#[test]
fn collection_by_size_removes_the_longest_unused_first() {
    let mut toy = Toy::new();
    toy.build();
    for folder in ["actions", "lists", "blobs"] {
        age(&toy, folder, 5);
    }
    toy.recipe.factor = 2.0;
    toy.build();
    fs::remove_dir_all(toy.path(".kiln/v1/state")).unwrap();
    let all = || {
        let stat = |path: PathBuf| fs::metadata(&path).map(|it| (mtime(&it), path, it.len())).unwrap();
        let folders = ["actions", "lists", "blobs"].map(|folder| toy.path(".kiln/v1").join(folder));
        let mut all: Vec<_> = folders.iter().flat_map(|folder| files_under(folder)).map(stat).collect();
        all.sort();
        all
    };
    let before = all();
    let old = before.iter().filter(|(time, ..)| *time < before[before.len() - 1].0 - DAY).count();
    // What the second build read of the first one's was dated anew.
    assert!(old > 4 && old < before.len() - 4, "{old} of {}", before.len());
    for gone in [1, old, before.len() - 1, before.len()] {
        let most = before[gone..].iter().map(|(_, _, bytes)| bytes).sum();
        cache(&toy).gc(&GcOptions { max_bytes: Some(most), ..GcOptions::default() }).unwrap();
        assert_eq!(all(), before[gone..], "of {} files the {gone} longest unused go", before.len());
    }
    fs::remove_file(toy.path("build/pot.out")).unwrap();
    assert!(toy.build().0.succeeded());
    assert_eq!(toy.read("build/pot.out"), "A POT\nUSE A.PNG\nUSE B.PNG\nA POT\nUSE A.PNG\nUSE B.PNG\n|apple|banana");
}

#[test]
fn a_pin_keeps_what_the_last_build_of_an_output_made() {
    let toy = Toy::new();
    let mut plan = toy.plan();
    for action in &mut plan.actions {
        action.id = action.id.replace("pot#", "build/pot.out#");
    }
    toy.engine().build(&plan, &toy.options, &NoObserver).unwrap();
    for folder in ["actions", "lists", "blobs", "state"] {
        age(&toy, folder, 10);
    }
    let pins = vec!["./assets/build/pot.out".into(), "build/other.out".into()];
    let options = GcOptions { max_age: days(1), max_bytes: Some(0), pins, ..GcOptions::default() };
    let done = cache(&toy).gc(&options).unwrap();
    assert_eq!((done.removed_files, done.pinned_bytes, done.over_bytes), (0, done.bytes, done.bytes));
    assert_eq!(done.unknown_pins, ["build/other.out"]);
    assert!(cache(&toy).gc(&GcOptions { pins: vec!["xbuild/pot.out".into()], ..options }).unwrap().removed_files > 0);
}

#[test]
fn what_a_build_at_work_used_is_spared_and_a_dead_lease_spares_nothing() {
    let toy = Toy::new();
    toy.build();
    for folder in ["actions", "lists", "blobs", "state"] {
        age(&toy, folder, 10);
    }
    let all = GcOptions { max_bytes: Some(0), ..GcOptions::default() };
    let store = Store::new(toy.path(".kiln"));
    let blob = ContentHash::of(EXPECTED.as_bytes());
    fs::remove_dir_all(toy.path(".kiln/v1/state")).unwrap();
    store.prepare().unwrap();
    store.during(&Arc::default(), || {
        assert!(store.blob(&blob).is_some());
        assert_eq!(cache(&toy).stats().unwrap().leases, 1);
        let done = cache(&toy).gc(&all).unwrap();
        assert!(done.removed_files > 0 && done.in_use_bytes > 0, "{done:?}");
        assert!(store.blob(&blob).is_some(), "it was used under the lease");
        assert_eq!(files_under(&toy.path(".kiln/v1/blobs")).len(), 1);
        // A process that was killed an hour ago.
        age(&toy, "leases", 1);
        assert_eq!(cache(&toy).gc(&all).unwrap().removed_files, 1);
        assert!(store.blob(&blob).is_none(), "a miss, no error");
    });
    assert!(files_under(&toy.path(".kiln/v1/leases")).is_empty());
}

#[test]
fn outputs_of_a_record_that_a_build_at_work_found_are_spared() {
    let toy = Toy::new();
    toy.build();
    for folder in ["actions", "lists", "blobs"] {
        age(&toy, folder, 10);
    }
    fs::remove_dir_all(toy.path(".kiln/v1/state")).unwrap();
    let store = Store::new(toy.path(".kiln"));
    store.prepare().unwrap();
    store.during(&Arc::default(), || {
        // Every stage is fresh; nobody has read an output yet.
        for path in files_under(&toy.path(".kiln/v1/actions")) {
            assert!(store.record(&path.file_name().unwrap().to_str().unwrap().parse().unwrap()).is_some());
        }
        let done = cache(&toy).gc(&GcOptions { max_bytes: Some(0), ..GcOptions::default() }).unwrap();
        assert_eq!(done.removed_files, 1, "the list alone: {done:?}");
    });
}

#[test]
fn a_lease_spares_what_build_states_name() {
    let toy = Toy::new();
    toy.build();
    for folder in ["actions", "lists", "blobs", "state"] {
        age(&toy, folder, 10);
    }
    let store = Store::new(toy.path(".kiln"));
    store.during(&Arc::default(), || {
        let done = cache(&toy).gc(&GcOptions { max_bytes: Some(0), ..GcOptions::default() }).unwrap();
        assert_eq!((done.removed_files, done.in_use_bytes), (0, done.bytes));
    });
}

#[test]
fn quarantine_goes_before_anything_else() {
    let toy = Toy::new();
    toy.build();
    let blob = files_under(&toy.path(".kiln/v1/blobs")).remove(0);
    fs::write(&blob, "damaged").unwrap();
    let found = cache(&toy).verify().unwrap();
    assert_eq!((found.damaged.len(), found.incomplete_records), (1, 1), "{found:?}");
    let bytes = cache(&toy).gc(&GcOptions::default()).unwrap().bytes;
    let done = cache(&toy).gc(&GcOptions { max_bytes: Some(bytes - 1), ..GcOptions::default() }).unwrap();
    assert_eq!((done.removed_files, done.removed_bytes), (1, 7));
    assert!(files_under(&toy.path(".kiln/v1/quarantine")).is_empty());
}

#[test]
fn verification_finds_every_damaged_and_every_stray_file() {
    let toy = Toy::new();
    toy.build();
    let sound = cache(&toy).verify().unwrap();
    assert_eq!((sound.records, sound.lists, sound.incomplete_records), (4, 1, 0));
    assert!(sound.damaged.is_empty(), "{sound:?}");
    let stats = cache(&toy).stats().unwrap();
    assert_eq!((stats.records.files, stats.blobs.files, stats.leases), (4, sound.blobs, 0));
    assert_eq!(
        stats.kinds.iter().map(|kind| kind.kind.as_str()).collect::<Vec<_>>(),
        ["import", "pack", "shout", "strip"]
    );

    let mut spoiled = 0;
    for folder in ["actions", "lists", "blobs"] {
        for path in files_under(&toy.path(".kiln/v1").join(folder)) {
            let mut bytes = fs::read(&path).unwrap();
            let at = bytes.len() / 2;
            bytes[at] ^= 4;
            fs::write(&path, bytes).unwrap();
            spoiled += 1;
        }
    }
    toy.write(".kiln/v1/blobs/notes.txt", "a stray");
    assert_eq!(cache(&toy).verify().unwrap().damaged.len(), spoiled + 1);
    let after = cache(&toy).verify().unwrap();
    assert_eq!((after.records, after.lists, after.blobs), (0, 0, 0));
    assert!(after.damaged.is_empty());
}

#[test]
fn a_record_that_is_absurdly_long_is_not_read() {
    let toy = Toy::new();
    toy.build();
    let record = files_under(&toy.path(".kiln/v1/actions")).remove(0);
    fs::File::options().write(true).open(&record).unwrap().set_len(1 << 40).unwrap();
    assert_eq!(cache(&toy).verify().unwrap().damaged.len(), 1);
}

#[test]
fn an_absent_cache_is_empty_and_stays_absent() {
    let toy = Toy::new();
    assert_eq!(cache(&toy).stats().unwrap(), CacheStats::default());
    assert_eq!(cache(&toy).verify().unwrap(), VerifyReport::default());
    assert!(!toy.path(".kiln").exists());
}

// --- a full disk ---

/// Builds with `room` bytes left under `folder`; the next build with room must be whole.
fn with_room(folder: &str, room: usize) -> bool {
    let toy = Toy::new();
    let path = toy.path(folder);
    ROOMS.lock().unwrap().push((path.clone(), room));
    let report = toy.engine().build(&toy.plan(), &toy.options, &NoObserver);
    let fitted = match report {
        Ok(report) if report.succeeded() => {
            assert_eq!(toy.read("build/pot.out"), EXPECTED);
            true
        }
        Ok(report) => {
            assert!(format!("{report:?}").contains("no space left"), "{room} bytes: {report:#?}");
            assert!(!toy.path("build/pot.out").exists(), "{room} bytes");
            false
        }
        Err(error) => {
            assert!(error.to_string().contains("no space left"), "{room} bytes: {error}");
            false
        }
    };
    assert!(
        files_under(&toy.path(".kiln/v1/tmp")).is_empty(),
        "{room} bytes: a full disk must not stay full of halves"
    );
    ROOMS.lock().unwrap().retain(|(folder, _)| *folder != path);
    let (report, _) = toy.build();
    assert!(report.succeeded(), "{room} bytes: {report:#?}");
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
    assert!(cache(&toy).verify().unwrap().damaged.is_empty(), "{room} bytes");
    fitted
}

#[test]
fn a_full_disk_is_a_diagnostic_and_no_damage() {
    for folder in [".kiln", "build"] {
        let mut fitted = Vec::new();
        for room in (0..6000).step_by(if folder == "build" { 7 } else { 61 }) {
            fitted.push(with_room(folder, room));
            if fitted.ends_with(&[true; 3]) {
                break;
            }
        }
        assert!(!fitted[0] && fitted.ends_with(&[true]), "{folder}: {fitted:?}");
    }
}

/// A small file system of its own; gone when dropped.
#[cfg(target_os = "linux")]
struct Tmpfs(PathBuf);

#[cfg(target_os = "linux")]
impl Tmpfs {
    fn mount(at: PathBuf, bytes: u32) -> Option<Tmpfs> {
        fs::create_dir_all(&at).unwrap();
        let size = format!("size={bytes}");
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "kiln-test"]).arg(&at).output();
        mount.is_ok_and(|done| done.status.success()).then_some(Tmpfs(at))
    }
}

#[cfg(target_os = "linux")]
impl Drop for Tmpfs {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_full_file_system_is_a_diagnostic_and_no_damage() {
    let toy = Toy::new();
    let Some(_mounted) = Tmpfs::mount(toy.path(".kiln"), 128 << 10) else {
        eprintln!("skipped: a tmpfs cannot be mounted here; the test above stands in");
        return;
    };
    toy.build_running(&["import", "strip", "shout", "pack"]);
    // Fill it to the last page, then ask for something new.
    let filler = toy.path(".kiln/filler");
    let mut length = 128 << 10;
    while length > 0 {
        let _ = fs::OpenOptions::new()
            .append(true)
            .create(true)
            .open(&filler)
            .map(|mut file| std::io::Write::write_all(&mut file, &vec![1; length]));
        length /= 2;
    }
    toy.write("models/pot.txt", "a jar\nuse a.png\n");
    let report = toy.engine().build(&toy.plan(), &toy.options, &NoObserver);
    let told = report.map_or_else(|error| error.to_string(), |report| format!("{report:?}"));
    assert!(told.contains("No space left"), "{told}");
    assert_eq!(toy.read("build/pot.out"), EXPECTED, "the old output stays");
    fs::remove_file(&filler).unwrap();
    assert!(toy.build().0.succeeded());
    assert_eq!(toy.read("build/pot.out"), "A JAR\nUSE A.PNG\n|apple");
    assert!(cache(&toy).verify().unwrap().damaged.is_empty());
}

// --- processes killed in the middle ---

const FOLDER: &str = "KILN_ENGINE_TEST_STORE";
const SEED: &str = "KILN_ENGINE_TEST_SEED";
/// Rounds in CI; `cargo xtask long` asks for more.
const ROUNDS: u64 = 20;
const KEYS: u64 = 24;

/// Numbers that are the same on every run (Knuth's MMIX constants).
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % end.max(1)
    }
}

fn key(number: u64) -> Fingerprint {
    Fingerprint(ContentHash::of(&number.to_le_bytes()).0)
}

/// What a run with key `number` gives: a few hundred to some thousand bytes.
fn content(number: u64) -> Vec<u8> {
    (0..300 + number * 331).map(|at| (at * (number + 3) % 251) as u8).collect()
}

fn record(number: u64) -> Record {
    let bytes = content(number);
    let output = |name: &str, bytes: &[u8]| OutputRecord {
        name: name.into(),
        hash: ContentHash::of(bytes),
        length: bytes.len() as u64,
    };
    Record {
        fingerprint: key(number),
        kind: "toy".into(),
        discovered: vec![],
        outputs: vec![output("a", &bytes), output("b", &bytes[..100])],
        report: vec![],
        seconds: 1.0,
    }
}

/// What is served is right, or it is not served.
fn look(store: &Store, number: u64) {
    if let Some(served) = store.record(&key(number)) {
        assert_eq!(served, record(number), "a record that is not what was written");
    }
    let expected = content(number);
    for bytes in [&expected[..], &expected[..100]] {
        if let Some(served) = store.blob(&ContentHash::of(bytes)) {
            assert_eq!(served[..], *bytes);
        }
    }
}

fn store_at(folder: &Path) -> Store {
    let options =
        RemoteOptions { mode: RemoteMode::Write, ..RemoteOptions::new(folder.join("remote").display().to_string()) };
    Store::new(folder.join("cache")).with_remote(Remote::open(options).unwrap())
}

/// Works on the store until the step at which it is to end.
fn work_on(folder: &Path, seed: u64) {
    let mut random = Random(seed);
    STEPS.store(0, Ordering::SeqCst);
    ABORT_AT.store(random.below(400) + 1, Ordering::SeqCst);
    let store = store_at(folder);
    store.prepare().unwrap();
    store.during(&Arc::new(AtomicBool::new(false)), || {
        for _ in 0..200 {
            let number = random.below(KEYS);
            match random.below(10) {
                0..4 => {
                    let bytes = content(number);
                    for part in [&bytes[..], &bytes[..100]] {
                        store.put_blob(&ContentHash::of(part), part, false).unwrap();
                    }
                    store.put_record(&record(number), false, false).unwrap();
                }
                4..8 => look(&store, number),
                8 => {
                    let options = GcOptions { max_bytes: Some(random.below(60_000)), ..GcOptions::default() };
                    Cache::open(folder.join("cache")).gc(&options).unwrap();
                }
                _ => drop(Cache::open(folder.join("cache")).verify().unwrap()),
            }
        }
    });
}

fn worker(folder: &Path, seed: u64) -> Child {
    Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "tests::store::killed_writers_and_collectors_leave_nothing_that_is_served_wrong"])
        .env(FOLDER, folder)
        .env(SEED, seed.to_string())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

/// Flips a byte of, or cuts, some of the files under a folder.
fn spoil(folder: &Path, random: &mut Random) -> usize {
    let mut spoiled = 0;
    for path in files_under(folder) {
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
        spoiled += 1;
    }
    spoiled
}

#[test]
fn killed_writers_and_collectors_leave_nothing_that_is_served_wrong() {
    if let Ok(folder) = std::env::var(FOLDER) {
        work_on(Path::new(&folder), std::env::var(SEED).unwrap().parse().unwrap());
        return;
    }
    let rounds = std::env::var("KILN_CRASH_ROUNDS").ok().and_then(|n| n.parse().ok()).unwrap_or(ROUNDS);
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("remote")).unwrap();
    let mut random = Random(20_261_130);
    let (mut killed, mut spoiled, mut served) = (0, 0, 0);
    for round in 0..rounds {
        let workers = [round * 2, round * 2 + 1].map(|seed| worker(folder.path(), seed + 7));
        for worker in workers {
            let ended = worker.wait_with_output().unwrap();
            let told = String::from_utf8_lossy(&ended.stderr);
            assert_ne!(ended.status.code(), Some(101), "round {round}: a worker failed: {told}");
            killed += usize::from(!ended.status.success());
        }
        let store = store_at(folder.path());
        store.prepare().unwrap();
        store.during(&Arc::default(), || {
            for number in 0..KEYS {
                look(&store, number);
                served += usize::from(store.record(&key(number)).is_some());
            }
        });
        for part in ["cache/v1/actions", "cache/v1/blobs", "remote"] {
            spoiled += spoil(&folder.path().join(part), &mut random);
        }
    }
    // Without spoiled files and killed workers, and without anything served, this would prove nothing.
    assert!(
        killed as u64 >= rounds && spoiled as u64 >= rounds && served as u64 >= rounds,
        "{killed} {spoiled} {served}"
    );
    let store = store_at(folder.path());
    store.during(&Arc::default(), || {
        for number in 0..KEYS {
            look(&store, number);
        }
    });
}
