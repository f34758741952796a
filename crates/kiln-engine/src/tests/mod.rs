//! Rebuilds of a toy pipeline: which actions ran, and why.
//!
//! ```text
//! models/pot.txt ─ import ─ text ─ strip ─ text ─ shout ─ text ─ pack ─ container ─ build/pot.out
//!   (names of further files)  └──── image/0, image/1, ... ──────────┘
//! ```
//! `import` reads the files that lines `use NAME` name; `strip` drops lines that begin with `#`; `shout` writes capitals
//! `factor` times; `pack` puts all together.

#![allow(clippy::unwrap_used, reason = "tests")]

mod crash;
mod damage;
mod noop;
mod part;
mod reasons;
mod rebuild;
mod remote;
mod store;
mod verify;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tempfile::TempDir;

use crate::disk::{Stat, mtime};
use crate::*;

/// What the toy pipeline is made of, so that tests can change one thing.
#[derive(Clone)]
struct Recipe {
    factor: f64,
    shout_version: u32,
    foreign: String,
    numeric_class: String,
    device_class: String,
    /// Makes `shout` fail.
    broken: bool,
}

impl Default for Recipe {
    fn default() -> Recipe {
        Recipe {
            factor: 1.0,
            shout_version: 1,
            foreign: "loud@1.0.0+all".into(),
            numeric_class: "x86-64".into(),
            device_class: "cpu".into(),
            broken: false,
        }
    }
}

/// A project folder, its recipe, and a log of what ran.
struct Toy {
    folder: TempDir,
    recipe: Recipe,
    ran: Arc<Mutex<Vec<&'static str>>>,
    options: BuildOptions,
}

const IMPORT: usize = 0;
const STRIP: usize = 1;
const SHOUT: usize = 2;
const PACK: usize = 3;

/// What a clean build of the fresh project gives.
const EXPECTED: &str = "A POT\nUSE A.PNG\nUSE B.PNG\n|apple|banana";

impl Toy {
    fn new() -> Toy {
        let toy = Toy {
            folder: tempfile::tempdir().expect("a temporary folder"),
            recipe: Recipe::default(),
            ran: Arc::default(),
            options: BuildOptions { jobs: 2, durability: Durability::Never, ..BuildOptions::default() },
        };
        write_project(toy.folder.path());
        toy
    }

    fn root(&self) -> &Path {
        self.folder.path()
    }

    fn path(&self, relative: &str) -> PathBuf {
        self.root().join(relative)
    }

    fn write(&self, relative: &str, text: &str) {
        fs::write(self.path(relative), text).expect("a writable folder");
    }

    fn read(&self, relative: &str) -> String {
        fs::read_to_string(self.path(relative)).expect("a text file")
    }

    fn engine(&self) -> Engine {
        Engine::open(self.path(".kiln"), "toy.toml")
    }

    fn plan(&self) -> Plan {
        plan(self.root(), &self.recipe, &self.ran)
    }

    /// Builds with a fresh engine, as another process would; gives the report and the actions that ran, in order.
    fn build(&self) -> (BuildReport, Vec<&'static str>) {
        let report = self.engine().build(&self.plan(), &self.options, &NoObserver).expect("a sound plan");
        (report, std::mem::take(&mut *self.ran.lock().expect("no panic under the lock")))
    }

    /// Builds, and expects that all goes well and exactly these actions run.
    #[track_caller]
    fn build_running(&self, expected: &[&str]) -> BuildReport {
        let (report, ran) = self.build();
        assert!(report.succeeded(), "{report:#?}");
        assert_eq!(ran, expected);
        report
    }

    fn why(&self) -> Why {
        self.engine().why(&self.plan(), 0).expect("a sound plan")
    }

    /// Waits, without sleeping, until the file system's time is past the file's: its stat may stand for it then.
    fn settle(&self, relative: &str) {
        let stat = Stat::of(&fs::metadata(self.path(relative)).expect("the file is there"));
        let probe = self.path("probe");
        loop {
            fs::write(&probe, "now").expect("a writable folder");
            if mtime(&fs::metadata(&probe).expect("just written")) > stat.latest() {
                return;
            }
        }
    }

    /// Trusts stats at once, as if the clock had no granularity.
    fn trusting_stats(mut self) -> Toy {
        self.options.clock_granularity = Duration::ZERO;
        for file in ["models/pot.txt", "models/a.png", "models/b.png"] {
            self.settle(file);
        }
        self
    }
}

fn write_project(root: &Path) {
    fs::create_dir_all(root.join("models")).expect("a writable folder");
    for (name, text) in
        [("pot.txt", "# a comment\na pot\nuse a.png\nuse b.png\n"), ("a.png", "apple"), ("b.png", "banana")]
    {
        fs::write(root.join("models").join(name), text).expect("a writable folder");
    }
}

fn text(bytes: &[u8]) -> Result<&str, ActionError> {
    std::str::from_utf8(bytes).map_err(ActionError::failed)
}

fn plan(root: &Path, recipe: &Recipe, ran: &Arc<Mutex<Vec<&'static str>>>) -> Plan {
    let log = |name: &'static str| {
        let ran = ran.clone();
        move || ran.lock().expect("no panic under the lock").push(name)
    };
    let logged = log("import");
    let mut import = Action::new("pot#import", "import", 1, move |context: &Context<'_>| {
        logged();
        let model = context.input("model")?;
        let mut outputs = Outputs::new().with("text", model.to_vec());
        for (index, name) in text(&model)?.lines().filter_map(|line| line.strip_prefix("use ")).enumerate() {
            let image = match context.read_file(name) {
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => b"(none)".to_vec(),
                other => other.map_err(ActionError::failed)?.to_vec(),
            };
            outputs = outputs.with(format!("image/{index}"), image);
        }
        Ok(outputs.report(br#"{"lines":4}"#.to_vec()))
    })
    .input("model", Source::file("models/pot.txt"));
    import.discovers = Some("models".into());

    let logged = log("strip");
    let strip = Action::new("pot#strip", "strip", 1, move |context: &Context<'_>| {
        logged();
        let input = context.input("text")?;
        let kept: Vec<String> =
            text(&input)?.lines().filter(|line| !line.starts_with('#')).map(|line| format!("{line}\n")).collect();
        Ok(Outputs::new().with("text", kept.concat().into_bytes()))
    })
    .input("text", Source::output(IMPORT, "text"));

    let logged = log("shout");
    let (factor, broken) = (recipe.factor, recipe.broken);
    let mut shout = Action::new("pot#shout", "shout", recipe.shout_version, move |context: &Context<'_>| {
        logged();
        if broken {
            return Err(ActionError::failed("the voice broke"));
        }
        let loud = text(&context.input("text")?)?.to_uppercase();
        Ok(Outputs::new().with("text", loud.repeat(factor as usize).into_bytes()))
    })
    .input("text", Source::output(STRIP, "text"))
    .param("factor", factor)
    .param("broken", broken);
    shout.foreign = vec![recipe.foreign.clone()];
    shout.numeric_class = Some(recipe.numeric_class.clone());
    shout.device_class = Some(recipe.device_class.clone());

    let logged = log("pack");
    let pack = Action::new("pot#pack", "pack", 1, move |context: &Context<'_>| {
        logged();
        let mut packed = context.input("text")?.to_vec();
        for name in context.inputs().filter(|name| name.starts_with("images/")) {
            packed.push(b'|');
            packed.extend_from_slice(&context.input(name)?);
        }
        Ok(Outputs::new().with("container", packed))
    })
    .input("text", Source::output(SHOUT, "text"))
    .input("images", Source::outputs(IMPORT, "image/"));

    Plan {
        root: root.to_owned(),
        actions: vec![import, strip, shout, pack],
        targets: vec![Target { path: "build/pot.out".into(), action: PACK, output: "container".into() }],
    }
}

/// Why an action ran.
#[track_caller]
fn reason(report: &BuildReport, action: usize) -> &StaleReason {
    match &report.actions[action].state {
        ActionState::Ran { reason, .. } => reason,
        other => panic!("action {action} did not run: {other:?}"),
    }
}

/// All files under a folder, sorted.
fn files_under(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(&folder).into_iter().flatten().flatten() {
            if entry.path().is_dir() { open.push(entry.path()) } else { found.push(entry.path()) }
        }
    }
    found.sort();
    found
}
