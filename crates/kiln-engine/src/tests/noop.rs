//! The short way through a build: what is looked at, which assets are planned, and what is remembered of the others.

use std::collections::BTreeSet;
use std::fs;

use super::*;
use crate::index::{Asset, Content, Frame, Index, Line};

fn key() -> ContentHash {
    ContentHash::of(b"kiln 1, no settings")
}

const ALL: [&str; 3] = ["a", "b", "c"];

/// Assets `a`, `b` and `c`: each a model in `in/`, which may name one picture in `in/`, and three actions.
struct Project {
    folder: TempDir,
    ran: Arc<Mutex<Vec<String>>>,
    options: BuildOptions,
    /// An asset of which the second action fails.
    broken: Option<&'static str>,
    /// Something was damaged: notes may be lost.
    damaged: bool,
}

impl Project {
    fn new() -> Project {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("in")).unwrap();
        let options = BuildOptions {
            jobs: 2,
            durability: Durability::Never,
            keep_going: true,
            clock_granularity: Duration::ZERO,
            ..BuildOptions::default()
        };
        let project = Project { folder, ran: Arc::default(), options, broken: None, damaged: false };
        for name in ALL {
            project.write(&format!("in/{name}.txt"), &format!("model {name}\npicture.png"));
        }
        project.write("in/picture.png", "one picture for all");
        project.write("pipeline.toml", "three stages");
        project
    }

    fn write(&self, path: &str, text: &str) {
        fs::write(self.folder.path().join(path), text).unwrap();
        self.settle();
    }

    /// Waits, without sleeping, until the file system's time has moved on.
    fn settle(&self) {
        let probe = self.folder.path().join("probe");
        let time = || {
            fs::write(&probe, "now").unwrap();
            mtime(&fs::metadata(&probe).unwrap())
        };
        let start = time();
        while time() <= start {}
        fs::remove_file(&probe).unwrap();
    }

    fn plan(&self, names: &[&str]) -> (Plan, Memory) {
        let mut plan = Plan { root: self.folder.path().to_owned(), ..Plan::default() };
        let mut groups = Vec::new();
        for name in names {
            let first = plan.actions.len();
            for (stage, number) in ["import", "simplify", "pack"].into_iter().zip(0..) {
                let (log, id) = (Arc::clone(&self.ran), format!("{name}#{stage}"));
                let broken = self.broken == Some(*name) && stage == "simplify";
                let action = Action::new(id.clone(), stage, 1, move |context: &Context<'_>| {
                    log.lock().unwrap().push(id.clone());
                    if broken {
                        return Err(ActionError::failed("broken"));
                    }
                    let mut bytes = context.input("x")?.to_vec();
                    if number == 0 {
                        let picture = text(&bytes)?.lines().nth(1).map(str::to_owned);
                        if let Some(Ok(picture)) = picture.map(|name| context.read_file(&name)) {
                            bytes.extend_from_slice(&picture);
                        }
                    }
                    Ok(Outputs::new().with("x", bytes))
                });
                let source = match number {
                    0 => Source::file(format!("in/{name}.txt")),
                    _ => Source::output(first + number - 1, "x"),
                };
                let mut action = action.input("x", source).param("broken", broken);
                action.discovers = (number == 0).then(|| "in".to_owned());
                plan.actions.push(action);
            }
            let target = plan.targets.len();
            plan.targets.push(Target { path: format!("out/{name}.out"), action: first + 2, output: "x".into() });
            groups.push(Group {
                name: (*name).into(),
                actions: (first..first + 3).collect(),
                targets: vec![target],
                brief: format!("{name} has 3"),
                note: format!("note of {name}").into_bytes(),
            });
        }
        (plan, Memory { key: key(), files: vec!["pipeline.toml".into()], folders: vec!["in".into()], groups })
    }

    /// Looks and builds as the pipeline layer does. Gives what the look found and the ids of what ran.
    fn build(&self) -> (Look, BTreeSet<String>) {
        self.ran.lock().unwrap().clear();
        let mut engine = Engine::open(self.folder.path().join(".kiln"), "project");
        let look = engine.look(self.folder.path(), &key(), &self.options);
        let (plan, memory) = match &look {
            Look::Fresh => return (look, BTreeSet::new()),
            Look::Changed(names) => self.plan(&names.iter().map(String::as_str).collect::<Vec<_>>()),
            Look::Unknown => self.plan(&ALL),
        };
        let report = engine.build(&plan, &self.options, &NoObserver).unwrap();
        assert_eq!(report.succeeded(), self.broken.is_none(), "{report:#?}");
        engine.remember(&plan, &report, &memory).unwrap();
        let names: Vec<_> = engine.briefs().map(|(name, brief)| (name.to_owned(), brief.to_owned())).collect();
        assert_eq!(names, ALL.map(|name| (name.to_owned(), format!("{name} has 3"))));
        for (group, name) in ALL.iter().enumerate() {
            let note = engine.note(group);
            let lost = note.is_none() && self.damaged;
            assert!(lost || note == Some(format!("note of {name}").into_bytes()), "{note:?}");
        }
        self.settle();
        let ran = self.ran.lock().unwrap().iter().cloned().collect();
        (look, ran)
    }

    /// A project that is found fresh by stats alone.
    fn ready() -> Project {
        let project = Project::new();
        assert_eq!(project.build().0, Look::Unknown);
        assert_eq!(project.build(), (Look::Fresh, BTreeSet::new()), "contents are compared where stats are young");
        assert_eq!(project.build(), (Look::Fresh, BTreeSet::new()));
        project
    }
}

fn changed(names: &[&str]) -> Look {
    Look::Changed(names.iter().map(|&name| name.to_owned()).collect())
}

fn ids(names: &[&str]) -> BTreeSet<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}

#[test]
fn an_untouched_project_is_found_fresh_by_stats_alone_and_nothing_is_written() {
    let project = Project::ready();
    let stamps = |project: &Project| -> Vec<_> {
        let files = files_under(project.folder.path());
        files.into_iter().map(|path| (fs::metadata(&path).unwrap().modified().unwrap(), path)).collect()
    };
    let before = stamps(&project);
    assert_eq!(project.build().0, Look::Fresh);
    assert_eq!(stamps(&project), before);
    let mut engine = Engine::open(project.folder.path().join(".kiln"), "project");
    let other = ContentHash::of(b"kiln 2");
    assert_eq!(
        engine.look(project.folder.path(), &other, &project.options),
        Look::Unknown,
        "another key, another plan"
    );
}

#[test]
fn a_changed_model_plans_and_runs_its_own_asset_alone() {
    let project = Project::ready();
    project.write("in/b.txt", "model b, changed");
    assert_eq!(project.build(), (changed(&["b"]), ids(&["b#import", "b#simplify", "b#pack"])));
    assert_eq!(fs::read_to_string(project.folder.path().join("out/b.out")).unwrap(), "model b, changed");
    // Its list of files is another one now: all was laid out anew, and still holds.
    assert_eq!(project.build().0, Look::Fresh);
    project.write("in/picture.png", "another picture");
    assert_eq!(project.build().0, changed(&["a", "c"]), "b reads it no more");
    assert_eq!(project.build().0, Look::Fresh);
}

#[test]
fn a_picture_that_several_assets_read_concerns_all_of_them() {
    let project = Project::ready();
    project.write("in/picture.png", "another picture");
    let (look, ran) = project.build();
    assert_eq!((look, ran.len()), (changed(&["a", "b", "c"]), 9));
    assert_eq!(project.build().0, Look::Fresh);
}

#[test]
fn touched_files_and_folders_change_nothing() {
    let project = Project::ready();
    for path in ["pipeline.toml", "in/a.txt", "in/picture.png", "out/c.out"] {
        let path = project.folder.path().join(path);
        fs::write(&path, fs::read(&path).unwrap()).unwrap();
    }
    // The folder's time moves, its names do not.
    project.write("in/new.txt", "comes and goes");
    fs::remove_file(project.folder.path().join("in/new.txt")).unwrap();
    project.settle();
    assert_eq!(project.build().0, Look::Fresh);
}

#[test]
fn another_pipeline_or_another_listing_asks_for_a_whole_plan() {
    let project = Project::ready();
    project.write("pipeline.toml", "four stages");
    assert_eq!(project.build().0, Look::Unknown);
    assert_eq!(project.build().0, Look::Fresh);
    project.write("in/new.txt", "a new model");
    assert_eq!(project.build().0, Look::Unknown);
    assert_eq!(project.build().0, Look::Fresh);
}

#[test]
fn a_missing_or_edited_output_concerns_its_asset_and_no_stage_runs() {
    let project = Project::ready();
    let out = project.folder.path().join("out/a.out");
    let bytes = fs::read(&out).unwrap();
    fs::remove_file(&out).unwrap();
    assert_eq!(project.build(), (changed(&["a"]), ids(&[])));
    assert_eq!(fs::read(&out).unwrap(), bytes);
    project.write("out/a.out", "mine");
    assert_eq!(project.build(), (changed(&["a"]), ids(&[])));
    assert_eq!(fs::read(&out).unwrap(), bytes);
    assert_eq!(project.build().0, Look::Fresh);
}

#[test]
fn a_file_that_was_looked_for_in_vain_concerns_its_assets_when_it_appears() {
    let project = Project::new();
    fs::remove_file(project.folder.path().join("in/picture.png")).unwrap();
    project.settle();
    project.build();
    assert_eq!(project.build().0, Look::Fresh);
    let mut engine = Engine::open(project.folder.path().join(".kiln"), "project");
    engine.look(project.folder.path(), &key(), &project.options);
    assert_eq!(engine.dependencies().assets[1].absent, ["in/picture.png"]);
    // The listing tells first here; where no listing is watched the file itself does.
    project.write("in/picture.png", "there");
    let (look, ran) = project.build();
    assert_eq!((look, ran.len()), (Look::Unknown, 9));
}

#[test]
fn an_asset_that_failed_is_built_again_and_no_other() {
    let mut project = Project::ready();
    project.broken = Some("b");
    project.write("in/b.txt", "model b, broken");
    assert_eq!(project.build(), (changed(&["b"]), ids(&["b#import", "b#simplify"])));
    assert_eq!(project.build(), (changed(&["b"]), ids(&["b#simplify"])), "nothing changed, but it is not finished");
    project.broken = None;
    assert_eq!(project.build(), (changed(&["b"]), ids(&["b#simplify", "b#pack"])));
    assert_eq!(project.build().0, Look::Fresh);
}

#[test]
fn a_young_file_is_looked_at_again_though_its_stat_is_the_same() {
    let mut project = Project::ready();
    project.write("in/b.txt", "model b, changed");
    project.options.clock_granularity = Duration::from_secs(1_000_000);
    project.build();
    // Nothing is older than the granularity: contents alone decide, each time.
    let path = project.folder.path().join("in/b.txt");
    let stamp = fs::metadata(&path).unwrap().modified().unwrap();
    fs::write(&path, "model b, Changed").unwrap();
    fs::File::options().append(true).open(&path).unwrap().set_modified(stamp).unwrap();
    assert_eq!(project.build().0, changed(&["b"]));
    assert_eq!(project.build().0, Look::Fresh);
}

#[test]
fn a_damaged_state_or_index_asks_for_a_whole_plan_and_runs_nothing() {
    let project = Project { damaged: true, ..Project::ready() };
    for file in files_under(&project.folder.path().join(".kiln/v1/state")) {
        let whole = fs::read(&file).unwrap();
        for at in (0..whole.len()).step_by(37) {
            let mut flipped = whole.clone();
            flipped[at] ^= 0x11;
            for bytes in [&flipped, &whole[..at]] {
                fs::write(&file, bytes).unwrap();
                fs::remove_file(project.folder.path().join("out/a.out")).unwrap();
                let (_, ran) = project.build();
                assert!(ran.is_empty(), "{} byte {at}: {ran:?}", file.display());
                assert_eq!(project.build().0, Look::Fresh);
            }
        }
    }
}

#[test]
fn a_state_file_that_grew_with_each_change_is_tidied() {
    let project = Project::ready();
    let length = || {
        let files = files_under(&project.folder.path().join(".kiln/v1/state"));
        files.iter().map(|path| fs::metadata(path).unwrap().len()).sum::<u64>()
    };
    let (first, mut whole) = (length(), 0);
    for round in 0..150 {
        project.write("in/a.txt", &format!("{round} {}", "x".repeat(500)));
        whole += usize::from(project.build().0 == Look::Unknown);
        assert!(length() < 4 * first + (300 << 10), "round {round}: {} bytes", length());
    }
    assert!(whole < 20, "{whole} whole plans");
}

#[test]
fn what_an_index_says_is_what_was_written() {
    let hash = ContentHash::of(b"x");
    let stat = Some(Stat { size: 1, mtime: -2, ctime: 3, inode: 4, device: 5 });
    let line = |path: &str, stat, content, owners: &[u32]| Line {
        path: path.into(),
        stat,
        content,
        plan: owners.is_empty(),
        folder: path == "in",
        output: path.starts_with("out"),
        owners: owners.into(),
    };
    let lines = vec![
        line("out/b", stat, Content::Hash(hash), &[1]),
        line("in/a", stat, Content::Hash(hash), &[0]),
        line("in/a", stat, Content::Hash(hash), &[1]),
        line("in", None, Content::Unknown, &[]),
        line("/top", None, Content::Absent, &[0]),
    ];
    let frames = vec![Frame { offset: 40, length: 7 }, Frame::default()];
    let asset = |name: &str, frames| Asset {
        name: name.into(),
        brief: "3".into(),
        frames,
        open: name == "b",
        ..Asset::default()
    };
    let mut index = Index::new(Some(hash), lines, &[asset("a", frames), asset("b", vec![])]);
    index.state.length = 9;
    let bytes = index.to_bytes();
    let read = Index::of_bytes(&bytes).unwrap();
    assert_eq!(read, index);
    assert_eq!((read.find("in/b"), read.find("in"), read.find("/top").is_some()), (None, Some(1), true));
    let found = read.find("in/a").unwrap();
    assert_eq!((read.path(found).as_str(), read.owners(found)), ("in/a", &[0, 1][..]));
    assert_eq!(Index::new(read.key, read.lines(), &read.assets()).entries, index.entries);
    // A patch changes what it names; a torn one, or one of another base, is as if it were not.
    let mut later = read.clone();
    later.entries[found].content = Content::Unknown;
    (later.groups[1].open, later.state.generation) = (false, 7);
    let folder = tempfile::tempdir().unwrap();
    let (path, store) = (folder.path().join("index"), crate::store::Store::new(folder.path().join("cache")));
    store.prepare().unwrap();
    let mut base = read.clone();
    base.write(&path, &store).unwrap();
    let mut patched = Index::read(&path).unwrap();
    patched.entries.clone_from(&later.entries);
    patched.groups.clone_from(&later.groups);
    patched.state = later.state;
    // So short an index is never patched by `update`: by hand, then.
    let whole = fs::read(&path).unwrap();
    fs::write(&path, [&whole[..], &patched.patch(&[found], &[1])].concat()).unwrap();
    assert_eq!(Index::read(&path).unwrap(), later);
    let with_patch = fs::read(&path).unwrap();
    for at in whole.len()..with_patch.len() {
        let mut flipped = with_patch.clone();
        flipped[at] ^= 1;
        assert_eq!(Index::of_bytes(&flipped).unwrap(), read, "byte {at}");
        assert_eq!(Index::of_bytes(&with_patch[..at]).unwrap(), read, "cut at {at}");
    }
    for at in 0..bytes.len() {
        let mut flipped = bytes.clone();
        flipped[at] ^= 1;
        assert!(Index::of_bytes(&flipped).is_none() && Index::of_bytes(&bytes[..at]).is_none(), "byte {at}");
    }
}

#[test]
fn a_long_index_is_patched_until_patches_are_a_quarter_of_it() {
    let line = |number: usize| Line {
        path: format!("in/{number}"),
        stat: None,
        content: Content::Absent,
        plan: false,
        folder: false,
        output: false,
        owners: vec![0],
    };
    let asset = Asset { name: "a".into(), frames: vec![Frame::default()], ..Asset::default() };
    let folder = tempfile::tempdir().unwrap();
    let (path, store) = (folder.path().join("index"), crate::store::Store::new(folder.path().join("cache")));
    store.prepare().unwrap();
    let mut index = Index::new(None, (0..100).map(line).collect(), &[asset]);
    index.write(&path, &store).unwrap();
    let whole = fs::metadata(&path).unwrap().len();
    let (mut longest, mut replaced) = (whole, 0);
    for round in 0..100_u8 {
        index.entries[usize::from(round)].content = Content::Hash(ContentHash([round; 32]));
        index.groups[0].open = round % 2 == 0;
        index.update(&path, &store, &[round.into()], &[0]).unwrap();
        let length = fs::metadata(&path).unwrap().len();
        replaced += u32::from(length == whole);
        longest = longest.max(length);
        assert_eq!(Index::read(&path).unwrap(), index, "round {round}");
        if round == 50 {
            // Another builder's patch, or a torn one: the file is not the one that is known.
            fs::write(&path, [fs::read(&path).unwrap(), vec![1, 2, 3]].concat()).unwrap();
        }
    }
    assert!(
        longest > whole && longest <= whole + whole / 4 && (2..30).contains(&replaced),
        "{whole} {longest} {replaced}"
    );
}
