//! A cache that others share: what a remote does, in whatever state it is, changes what runs and never what comes out.

#[cfg(feature = "remote")]
mod http;
#[cfg(feature = "remote")]
mod s3;

use std::sync::atomic::{AtomicUsize, Ordering};

use proptest::prelude::*;

use super::*;
use crate::remote::claim::{list_object, open_list, open_record, record_object};
use crate::remote::place::{Fault, Place, Until};
use crate::store::{Store, sealed};

/// A folder that two machines share.
struct Share {
    folder: TempDir,
}

impl Share {
    fn new() -> Share {
        Share { folder: tempfile::tempdir().unwrap() }
    }

    fn options(&self, mode: RemoteMode) -> RemoteOptions {
        hasty(RemoteOptions { mode, ..RemoteOptions::new(self.folder.path().display().to_string()) })
    }

    fn files(&self, folder: &str) -> Vec<PathBuf> {
        files_under(&self.folder.path().join("v1").join(folder))
    }

    /// A share that CI has filled from the toy project.
    fn filled() -> Share {
        let share = Share::new();
        let (toy, report) = machine(share.options(RemoteMode::Write));
        assert_eq!(toy.ran(), ["import", "strip", "shout", "pack"]);
        assert_eq!((report.1.sent, report.1.failures), (4, 0), "{report:?}");
        share
    }
}

/// Little patience, for tests.
fn hasty(options: RemoteOptions) -> RemoteOptions {
    RemoteOptions {
        request_limit: Duration::from_millis(400),
        lost_limit: Duration::from_millis(1500),
        upload_limit: Duration::from_secs(20),
        attempts: 2,
        ..options
    }
}

impl Toy {
    fn ran(&self) -> Vec<&'static str> {
        std::mem::take(&mut *self.ran.lock().unwrap())
    }

    fn build_through(&self, options: RemoteOptions) -> (BuildReport, RemoteReport) {
        let mut engine = self.engine().with_remote(Remote::open(options).unwrap());
        let report = engine.build(&self.plan(), &self.options, &NoObserver).unwrap();
        (report, engine.remote_report().unwrap())
    }
}

/// Another machine: a clone of the project with an empty cache, built once; whatever the remote does, the build ends well.
#[track_caller]
fn machine(options: RemoteOptions) -> (Toy, (BuildReport, RemoteReport)) {
    let toy = Toy::new();
    let report = toy.build_through(options);
    assert!(report.0.succeeded(), "{report:#?}");
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
    assert!(files_under(&toy.path(".kiln/v1/tmp")).is_empty());
    (toy, report)
}

#[test]
fn a_second_machine_takes_everything_and_runs_nothing() {
    let share = Share::filled();
    let (toy, (report, remote)) = machine(share.options(RemoteMode::Read));
    assert!(toy.ran().is_empty());
    assert!(report.warnings.is_empty(), "{report:#?}");
    assert_eq!((remote.hits, remote.failures), (4, 0), "{remote:?}");
    assert!(toy.build().0.nothing_to_do(), "what came is our own from now on");
    let all = |folder| files_under(&toy.path(".kiln/v1").join(folder)).len();
    assert_eq!((all("actions"), all("lists")), (4, 1));
}

#[test]
fn a_reader_leaves_the_remote_as_it_is() {
    let share = Share::new();
    let (toy, (report, remote)) = machine(share.options(RemoteMode::Read));
    assert_eq!(toy.ran(), ["import", "strip", "shout", "pack"]);
    assert!(report.warnings.is_empty() && remote.misses > 0, "{report:#?} {remote:?}");
    assert!(files_under(share.folder.path()).is_empty());
}

#[test]
fn a_change_takes_from_the_remote_what_it_still_can() {
    let share = Share::filled();
    let mut toy = Toy::new();
    toy.recipe.factor = 2.0;
    let (_, remote) = toy.build_through(share.options(RemoteMode::Read));
    assert_eq!((toy.ran(), remote.hits), (vec!["shout", "pack"], 2));
}

#[test]
fn found_files_that_differ_are_noticed_and_both_lists_are_kept() {
    let share = Share::filled();
    let other = |mode| {
        let toy = Toy::new();
        toy.write("models/a.png", "apricot");
        let report = toy.build_through(share.options(mode));
        assert!(report.0.succeeded());
        assert_eq!(toy.read("build/pot.out"), EXPECTED.replace("apple", "apricot"));
        (toy.ran(), report.1.hits)
    };
    assert_eq!(other(RemoteMode::Write), (vec!["import", "pack"], 2));
    assert_eq!(share.files("lists").len(), 1, "the same names: one list");
    assert_eq!(other(RemoteMode::Read), (vec![], 4));
}

#[test]
fn a_share_that_is_not_there_is_one_warning() {
    let share = Share::filled();
    let url = share.folder.path().join("unmounted").display().to_string();
    for mode in [RemoteMode::Read, RemoteMode::Write] {
        let (toy, (report, remote)) = machine(hasty(RemoteOptions { mode, ..RemoteOptions::new(&url) }));
        assert_eq!(toy.ran().len(), 4);
        assert!(remote.left_alone && report.warnings[0].contains("there is no such folder"), "{report:#?}");
        assert_eq!(report.warnings.len(), 1, "{report:#?}");
    }
    assert!(!Path::new(&url).exists(), "kiln does not make the folder");
}

#[test]
fn every_flipped_byte_of_the_remote_is_a_miss_or_harmless() {
    let share = Share::filled();
    let files = files_under(share.folder.path());
    for path in files {
        let whole = fs::read(&path).unwrap();
        for at in (0..whole.len()).step_by(3) {
            let mut spoiled = whole.clone();
            spoiled[at] ^= 0x10;
            fs::write(&path, &spoiled).unwrap();
            let (toy, (report, remote)) = machine(share.options(RemoteMode::Read));
            assert!(!toy.ran().is_empty() && remote.failures > 0, "{} byte {at}", path.display());
            assert_eq!(report.warnings.len(), 1, "{report:#?}");
            assert!(cache_is_whole(&toy));
        }
        fs::write(&path, &whole).unwrap();
    }
}

#[test]
fn every_cut_of_the_remote_is_a_miss_and_a_writer_mends_it() {
    let share = Share::filled();
    for path in files_under(share.folder.path()) {
        let whole = fs::read(&path).unwrap();
        for length in (0..whole.len()).step_by(13) {
            fs::write(&path, &whole[..length]).unwrap();
            let (toy, _) = machine(share.options(RemoteMode::Read));
            assert!(!toy.ran().is_empty() && cache_is_whole(&toy));
        }
        machine(share.options(RemoteMode::Write));
        let (toy, _) = machine(share.options(RemoteMode::Read));
        assert!(toy.ran().is_empty(), "{} was not mended", path.display());
    }
}

fn cache_is_whole(toy: &Toy) -> bool {
    Cache::open(toy.path(".kiln")).verify().unwrap().damaged.is_empty()
}

#[test]
fn a_blob_that_the_local_cache_lost_comes_from_the_remote() {
    let share = Share::filled();
    let (toy, _) = machine(share.options(RemoteMode::Read));
    for blob in files_under(&toy.path(".kiln/v1/blobs")) {
        fs::remove_file(blob).unwrap();
    }
    fs::remove_file(toy.path("build/pot.out")).unwrap();
    assert!(toy.build_through(share.options(RemoteMode::Read)).0.succeeded());
    assert!(toy.ran().is_empty());
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
}

#[test]
fn a_blob_that_the_remote_lost_makes_its_record_a_miss() {
    let share = Share::filled();
    let blob = ContentHash::of(EXPECTED.as_bytes()).hex();
    fs::remove_file(share.folder.path().join("v1/blobs").join(&blob[..2]).join(&blob)).unwrap();
    let (toy, (_, remote)) = machine(share.options(RemoteMode::Read));
    assert_eq!((toy.ran(), remote.hits), (vec!["pack"], 3));
    // A writer that has to make it sends it again.
    machine(share.options(RemoteMode::Write));
    assert!(machine(share.options(RemoteMode::Read)).0.ran().is_empty());
}

#[test]
fn a_dry_run_and_why_ask_nobody() {
    let share = Share::filled();
    let mut toy = Toy::new();
    toy.options.dry_run = true;
    let (report, remote) = toy.build_through(share.options(RemoteMode::Read));
    assert!(matches!(report.actions[IMPORT].state, ActionState::WouldRun { .. }));
    assert_eq!(remote, RemoteReport::default());
    assert!(!toy.path(".kiln").exists());
}

#[test]
fn two_writers_at_once_agree() {
    let share = Share::new();
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| machine(share.options(RemoteMode::Write)));
        }
    });
    assert!(machine(share.options(RemoteMode::Read)).0.ran().is_empty());
    assert!(files_under(&share.folder.path().join("tmp")).is_empty());
}

// --- claims ---

/// A record that a remote may hold.
fn claim() -> Record {
    let output = |name: &str| OutputRecord { name: name.into(), hash: ContentHash::of(b"x"), length: 1 };
    Record {
        fingerprint: Fingerprint([7; 32]),
        kind: "toy".into(),
        discovered: vec![("a.png".into(), None), ("b.png".into(), Some(ContentHash::of(b"b")))],
        outputs: vec![output("one"), output("two")],
        report: br#"{"lines":4}"#.to_vec(),
        seconds: 1.5,
    }
}

fn open(bytes: &[u8]) -> Result<Record, &'static str> {
    open_record(bytes, &Fingerprint([7; 32]), &[], 1000)
}

#[test]
fn a_claim_is_taken_only_as_it_was_made() {
    let bytes = record_object(&claim(), None);
    assert_eq!(open(&bytes), Ok(claim()));
    for length in 0..bytes.len() {
        assert!(open(&bytes[..length]).is_err(), "cut at {length}");
    }
    for at in 0..bytes.len() * 8 {
        let mut flipped = bytes.clone();
        flipped[at / 8] ^= 1 << (at % 8);
        assert!(open(&flipped).is_err(), "bit {at}");
    }
    assert!(open(&[&bytes[..], b"more"].concat()).is_err());
}

#[test]
fn claims_that_make_no_sense_are_refused_though_their_seal_is_right() {
    type Spoil = fn(&mut Record);
    let spoils: [(&str, Spoil); 15] = [
        ("something else", |record| record.fingerprint = Fingerprint([8; 32])),
        ("output name", |record| record.outputs[1].name = "one".into()),
        ("output name", |record| record.outputs[1].name = String::new()),
        ("output name", |record| record.outputs[1].name = "a\nb".into()),
        ("too long", |record| record.outputs[1].length = 1001),
        ("too long", |record| record.outputs[1].length = u64::MAX),
        ("list of files", |record| record.discovered.reverse()),
        ("list of files", |record| record.discovered[0].0 = "/etc/passwd".into()),
        ("list of files", |record| record.discovered[0].0 = "C:\\x".into()),
        ("kind or time", |record| record.seconds = f64::NAN),
        ("kind or time", |record| record.kind = String::new()),
        ("report", |record| record.report = vec![0xff]),
        ("control characters", |record| record.report = b"{\"warnings\":[\"\x1b[2J\"]}".to_vec()),
        ("control characters", |record| record.report = br#"{"warnings":["\\\u001b[2J"]}"#.to_vec()),
        ("control characters", |record| record.report = br#"{"warnings":["gone\b\b"]}"#.to_vec()),
    ];
    for (expected, spoil) in spoils {
        let mut record = claim();
        spoil(&mut record);
        let told = open(&record_object(&record, None)).unwrap_err();
        assert!(told.contains(expected), "{told} instead of {expected}");
    }
}

#[test]
fn lists_name_sorted_relative_paths() {
    let list = |paths: &[&str]| open_list(&list_object(&paths.iter().map(|p| (*p).to_owned()).collect::<Vec<_>>()));
    assert!(list(&[]).is_ok() && list(&["a", "b/c", "../d"]).is_err() && list(&["../d", "a"]).is_ok());
    for bad in [&["b", "a"][..], &["a", "a"], &["/etc/passwd"], &["a\0b"], &[""]] {
        assert!(list(bad).is_err(), "{bad:?}");
    }
}

#[test]
fn a_list_that_leads_out_of_the_models_folder_is_not_followed() {
    let share = Share::filled();
    let path = share.files("lists").remove(0);
    fs::write(&path, list_object(&["../../../dev/zero".to_owned()])).unwrap();
    let (toy, _) = machine(share.options(RemoteMode::Read));
    assert_eq!(toy.ran(), ["import"], "its record was not found; what comes after it was");
}

#[test]
fn a_list_that_names_what_is_no_file_is_passed_by() {
    let share = Share::filled();
    let honest = share.files("lists").remove(0);
    let list = fs::read(&honest).unwrap();
    // In a slot before the honest one: a folder, and what would be read for ever.
    for outside in [false, true] {
        for path in ["sub", "../../../../../../../../../../../../dev/zero"] {
            fs::write(&honest, list_object(&[path.to_owned()])).unwrap();
            fs::write(honest.with_file_name("1"), &list).unwrap();
            let toy = Toy::new();
            fs::create_dir(toy.path("models/sub")).unwrap();
            let mut plan = toy.plan();
            plan.actions[IMPORT].outside = outside;
            let mut engine = toy.engine().with_remote(Remote::open(share.options(RemoteMode::Read)).unwrap());
            let report = engine.build(&plan, &toy.options, &NoObserver).unwrap();
            assert!(report.succeeded() && toy.ran().is_empty(), "{path}: {report:#?}");
            let kept = files_under(&toy.path(".kiln/v1/lists"));
            assert_eq!(kept.len(), 1, "{path}: only what a record was found by is kept");
        }
    }
}

#[test]
fn claims_that_lie_are_found_by_running_the_stage_and_put_right() {
    let share = Share::filled();
    let mut lies = 0;
    for path in share.files("actions") {
        let name = path.file_name().unwrap().to_str().unwrap().parse().unwrap();
        let mut record = open_record(&fs::read(&path).unwrap(), &name, &[], 1000).unwrap();
        if ["shout", "pack"].contains(&record.kind.as_str()) {
            (record.outputs[0].hash, record.outputs[0].length) = (ContentHash::of(b"apple"), 5);
            fs::write(&path, record_object(&record, None)).unwrap();
            lies += 1;
        }
    }
    assert_eq!(lies, 2);
    let toy = Toy::new();
    let options = RemoteOptions { check_share: 1.0, ..share.options(RemoteMode::Write) };
    let mut engine = toy.engine().with_remote(Remote::open(options).unwrap());
    let mut found = Vec::new();
    let mut claims = Vec::new();
    loop {
        let report = engine.build(&toy.plan(), &toy.options, &NoObserver).unwrap();
        assert!(report.succeeded(), "{report:#?}");
        let check = engine.check_claims(&toy.plan(), &report, &toy.options).unwrap();
        assert!(check.failed.is_empty() && check.inconsistent.is_empty() && check.checked == check.claims, "{check:?}");
        claims.push(check.claims);
        if check.lies.is_empty() {
            break;
        }
        found.extend(check.lies.into_iter().map(|lie| (lie.label, lie.other)));
    }
    // The container of the lie of `shout` had no record; the lie about `pack` came when `shout` was put right.
    let apple = Some(ContentHash::of(b"apple"));
    assert_eq!(found, [("pot#shout".to_owned(), apple), ("pot#pack".to_owned(), apple)]);
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
    assert!(toy.engine().build(&toy.plan(), &toy.options, &NoObserver).unwrap().nothing_to_do());
    assert!(fs::read_dir(toy.path(".kiln/v1/tmp")).unwrap().next().is_none());
    assert!(machine(share.options(RemoteMode::Read)).0.ran().is_empty(), "the remote was put right");
}

#[test]
#[cfg(unix)]
fn a_pipe_on_the_share_is_not_waited_for() {
    let share = Share::filled();
    let blob = share.files("blobs").remove(0);
    fs::remove_file(&blob).unwrap();
    assert!(std::process::Command::new("mkfifo").arg(&blob).status().unwrap().success());
    let (toy, (report, _)) = machine(share.options(RemoteMode::Read));
    assert!(!toy.ran().is_empty() && report.warnings.len() == 1, "{report:#?}");
}

#[test]
fn a_claim_of_absurd_lengths_allocates_nothing() {
    // A sealed payload that says that its kind has 2^62 bytes.
    let payload = [&[7; 32][..], &(1_u64 << 62).to_le_bytes()].concat();
    let object = [b"kilnrec1", &ContentHash::of(&payload).0[..], &payload].concat();
    assert_eq!(open(&object), Err("is no record"));
    assert!(open_list(&object).is_err());
    assert!(open_list(&sealed(&(u64::MAX, 1_u8))).is_err());
}

proptest! {
    #[test]
    fn no_bytes_make_the_reader_of_claims_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        let _ = open(&bytes);
        let sealed = [b"kilnrec1", &ContentHash::of(&bytes).0[..], &bytes].concat();
        prop_assert!(open(&sealed).is_err());
        let _ = open_list(&sealed);
    }
}

#[test]
fn a_lying_claim_is_found_by_recomputing_it_and_is_put_right() {
    let share = Share::filled();
    let shout = share
        .files("actions")
        .into_iter()
        .find(|path| {
            let name = path.file_name().unwrap().to_str().unwrap().parse().unwrap();
            open_record(&fs::read(path).unwrap(), &name, &[], 1000).unwrap().kind == "shout"
        })
        .unwrap();
    let fingerprint: Fingerprint = shout.file_name().unwrap().to_str().unwrap().parse().unwrap();
    let honest = open_record(&fs::read(&shout).unwrap(), &fingerprint, &[], 1000).unwrap();
    // The liar may write: it claims the wrong blob, which is there.
    let mut lie = honest.clone();
    let other = ContentHash::of(b"apple");
    lie.outputs[0].hash = other;
    lie.outputs[0].length = 5;
    fs::write(&shout, record_object(&lie, None)).unwrap();

    let toy = Toy::new();
    let options = RemoteOptions { check_share: 1.0, ..share.options(RemoteMode::Write) };
    let store = Store::new(toy.path(".kiln")).with_remote(Remote::open(options).unwrap());
    store.prepare().unwrap();
    store.during(&Arc::default(), || {
        assert_eq!(store.record(&fingerprint), Some(lie.clone()), "nothing but running the stage could tell");
        assert!(store.wants_check(&fingerprint) && store.is_claim(&fingerprint));
        store.put_blob(&honest.outputs[0].hash, &b"A POT\nUSE A.PNG\nUSE B.PNG\n"[..], false).unwrap();
        store.refute(&honest, false).unwrap();
        assert!(!store.wants_check(&fingerprint));
        assert_eq!(store.record(&fingerprint), Some(honest.clone()));
    });
    assert!(machine(share.options(RemoteMode::Read)).0.ran().is_empty(), "the remote was put right");
}

#[test]
fn the_share_that_is_recomputed_is_as_large_as_asked_and_always_the_same() {
    let toy = Toy::new();
    let share = Share::new();
    let writer = Store::new(toy.path("ci")).with_remote(Remote::open(share.options(RemoteMode::Write)).unwrap());
    writer.prepare().unwrap();
    let keys: Vec<Fingerprint> = (0..200_u32).map(|n| Fingerprint(ContentHash::of(&n.to_le_bytes()).0)).collect();
    writer.during(&Arc::default(), || {
        for &fingerprint in &keys {
            writer.put_record(&Record { fingerprint, outputs: vec![], ..claim() }, false, false).unwrap();
        }
    });
    let chosen = |check_share| {
        let toy = Toy::new();
        let options = RemoteOptions { check_share, check_seed: Some(7), ..share.options(RemoteMode::Read) };
        let store = Store::new(toy.path(".kiln")).with_remote(Remote::open(options).unwrap());
        store.prepare().unwrap();
        store.during(&Arc::default(), || {
            keys.iter().filter(|key| store.record(key).is_some() && store.wants_check(key)).copied().collect::<Vec<_>>()
        })
    };
    assert_eq!((chosen(0.0).len(), chosen(1.0).len()), (0, 200));
    let quarter = chosen(0.25);
    assert!((30..70).contains(&quarter.len()), "{}", quarter.len());
    assert_eq!(chosen(0.25), quarter);
}

// --- signatures ---

#[cfg(feature = "remote")]
#[test]
fn who_trusts_keys_takes_only_what_they_signed() {
    let secret = |digit: &str| digit.repeat(64).parse::<SigningKey>().unwrap();
    let (ci, stranger) = (secret("1"), secret("2"));
    let share = Share::new();
    machine(RemoteOptions { sign_with: Some(ci.clone()), ..share.options(RemoteMode::Write) });
    let read = |trusted_keys: Vec<PublicKey>| {
        let (toy, (report, _)) = machine(RemoteOptions { trusted_keys, ..share.options(RemoteMode::Read) });
        (toy.ran().len(), report.warnings.first().cloned().unwrap_or_default())
    };
    assert_eq!(read(vec![stranger.public(), ci.public()]), (0, String::new()));
    assert_eq!(read(vec![]), (0, String::new()), "who trusts the remote needs no signature");
    let (ran, told) = read(vec![stranger.public()]);
    assert!(ran == 4 && told.contains("a key that is not trusted"), "{told}");

    let record = share.files("actions").remove(0);
    let signed = fs::read(&record).unwrap();
    let mut forged = signed.clone();
    *forged.last_mut().unwrap() ^= 1;
    for (bytes, why) in [(&forged[..], "wrong signature"), (&signed[..signed.len() - 104], "is not signed")] {
        fs::write(&record, bytes).unwrap();
        let (ran, told) = read(vec![ci.public()]);
        assert!(ran > 0 && told.contains(why), "{told}");
    }
}

/// RFC 8032, section 7.1, test 1: the key pair.
#[cfg(feature = "remote")]
#[test]
fn keys_are_those_of_rfc_8032() {
    let secret: SigningKey = "9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60".parse().unwrap();
    assert_eq!(secret.public().to_string(), "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a");
    assert_eq!(format!("{secret:?}"), "SigningKey(secret)");
}

// --- patience, with a place of our own making ---

/// A remote that counts requests and answers each after a while, or never.
struct Moody {
    asked: Arc<AtomicUsize>,
    /// What it does until when, and whether it is written to.
    mood: fn(&Until<'_>, bool) -> Result<bool, Fault>,
}

impl Place for Moody {
    fn get(
        &self,
        _: &str,
        _: u64,
        until: &Until<'_>,
        _: &mut dyn FnMut(&[u8]) -> Result<(), Fault>,
    ) -> Result<bool, Fault> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        (self.mood)(until, false)
    }

    fn has(&self, _: &str, until: &Until<'_>) -> Result<bool, Fault> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        (self.mood)(until, true)
    }

    fn put(&self, _: &str, _: &Arc<[u8]>, _: bool, until: &Until<'_>) -> Result<bool, Fault> {
        self.asked.fetch_add(1, Ordering::Relaxed);
        (self.mood)(until, true)
    }
}

/// Builds the toy through a moody remote; gives how often it was asked, and the warnings.
fn through_moody(options: RemoteOptions, mood: fn(&Until<'_>, bool) -> Result<bool, Fault>) -> (usize, BuildReport) {
    let asked = Arc::new(AtomicUsize::new(0));
    let toy = Toy::new();
    let remote = Remote::at(options, Box::new(Moody { asked: asked.clone(), mood }));
    let report = toy.engine().with_remote(remote).build(&toy.plan(), &toy.options, &NoObserver).unwrap();
    assert!(report.succeeded());
    assert_eq!(toy.read("build/pot.out"), EXPECTED);
    (asked.load(Ordering::Relaxed), report)
}

/// Waits until the deadline or the wish to stop.
fn hang(until: &Until<'_>, _writing: bool) -> Result<bool, Fault> {
    loop {
        until.left()?;
        std::thread::park_timeout(Duration::from_millis(1));
    }
}

#[test]
fn a_remote_that_fails_is_left_alone_after_three_requests() {
    let options = RemoteOptions { attempts: 2, ..RemoteOptions::new("moody") };
    let (asked, report) = through_moody(options.clone(), |_, _| Err(Fault::Transient("no route".into())));
    assert_eq!(asked, 6, "three requests of two attempts");
    assert!(report.warnings.len() == 1 && report.warnings[0].contains("no route"), "{report:#?}");
    let (asked, report) = through_moody(options, |_, _| Err(Fault::Refused("forbidden".into())));
    assert_eq!(asked, 1, "who says no is not asked again");
    assert!(report.warnings.len() == 1 && report.warnings[0].contains("forbidden"), "{report:#?}");
}

#[test]
fn a_remote_that_never_answers_costs_no_more_than_the_bound() {
    let options = hasty(RemoteOptions { lost_limit: Duration::from_millis(500), ..RemoteOptions::new("moody") });
    let (asked, report) = through_moody(options, hang);
    // 400 ms, then what is left of the 500.
    assert!(asked <= 3, "{asked}");
    assert!(report.warnings.len() == 1 && report.warnings[0].contains("no answer in time"), "{report:#?}");
}

/// Gives bytes for ever, slower than anybody needs.
struct Dripping(u64);

impl Place for Dripping {
    fn get(
        &self,
        _: &str,
        limit: u64,
        until: &Until<'_>,
        push: &mut dyn FnMut(&[u8]) -> Result<(), Fault>,
    ) -> Result<bool, Fault> {
        for _ in 0..limit {
            until.left()?;
            push(&[7])?;
            std::thread::park_timeout(Duration::from_millis(self.0));
        }
        Ok(true)
    }

    fn has(&self, _: &str, _: &Until<'_>) -> Result<bool, Fault> {
        Ok(false)
    }

    fn put(&self, _: &str, _: &Arc<[u8]>, _: bool, _: &Until<'_>) -> Result<bool, Fault> {
        Ok(false)
    }
}

#[test]
fn a_transfer_that_drips_is_given_up_whatever_length_it_claims() {
    // 16 MiB at one byte in 5 ms would take a day.
    let toy = Toy::new();
    let options = hasty(RemoteOptions::new("drip"));
    let remote = Remote::at(options, Box::new(Dripping(5)));
    let mut engine = toy.engine().with_remote(remote);
    assert!(engine.build(&toy.plan(), &toy.options, &NoObserver).unwrap().succeeded());
    let report = engine.remote_report().unwrap();
    assert!(report.left_alone && report.bytes_received < 2000, "{report:?}");
}

#[test]
fn a_remote_that_is_slow_to_say_no_is_left_alone() {
    let options = RemoteOptions { lost_limit: Duration::from_millis(100), ..RemoteOptions::new("moody") };
    // Answers late in its time: each answer beyond a quarter of a second counts.
    let options = RemoteOptions { request_limit: Duration::from_secs(5), ..options };
    let (asked, report) = through_moody(options, |until, writing| match hang(until, writing) {
        Err(Fault::Cancelled) => Err(Fault::Cancelled),
        _ => Ok(false),
    });
    assert!(asked <= 4, "{asked}");
    assert!(report.warnings.len() <= 1, "{report:#?}");
}

#[test]
fn uploads_that_hang_end_with_the_build() {
    let options = RemoteOptions {
        mode: RemoteMode::Write,
        upload_limit: Duration::from_millis(50),
        request_limit: Duration::from_secs(600),
        lost_limit: Duration::from_secs(600),
        ..RemoteOptions::new("moody")
    };
    let (_, report) = through_moody(options, |until, writing| if writing { hang(until, true) } else { Ok(false) });
    assert!(report.warnings.iter().any(|warning| warning.contains("not sent in time")), "{report:#?}");
}

#[test]
fn a_cancelled_build_does_not_wait_for_the_remote() {
    let toy = Toy::new();
    let options = RemoteOptions {
        request_limit: Duration::from_secs(600),
        lost_limit: Duration::from_secs(600),
        ..RemoteOptions::new("moody")
    };
    let asked = Arc::new(AtomicUsize::new(0));
    let remote = Remote::at(options, Box::new(Moody { asked: asked.clone(), mood: hang }));
    let cancel = toy.options.cancel.clone();
    let report = std::thread::scope(|scope| {
        scope.spawn(|| {
            while asked.load(Ordering::Relaxed) == 0 {
                std::thread::park_timeout(Duration::from_millis(1));
            }
            cancel.store(true, Ordering::Relaxed);
        });
        toy.engine().with_remote(remote).build(&toy.plan(), &toy.options, &NoObserver).unwrap()
    });
    assert!(report.cancelled && toy.ran().is_empty());
}

#[test]
fn addresses_are_shown_without_secrets_and_wrong_ones_are_refused() {
    let shown = |url: &str| RemoteOptions::new(url).shown_url();
    assert_eq!(shown("https://ci:secret@host:9000/cache?token=x"), "https://host:9000/cache");
    assert_eq!(shown("s3://bucket/prefix"), "s3://bucket/prefix");
    for url in ["ftp://host/x", ""] {
        assert!(matches!(Remote::open(RemoteOptions::new(url)), Err(RemoteError::UnknownScheme { .. })), "{url}");
    }
}
