//! kiln inside other build systems: each example is run by its tool where that is installed.
//!
//! A second run does nothing, a changed picture builds its own asset alone, a deleted container comes back without a stage.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::space::{KILN, Space, needs, repository};

/// A copy of `examples/NAME` and the assets beside it.
struct Example {
    space: Space,
    name: &'static str,
}

impl Example {
    fn new(name: &'static str) -> Example {
        let space = Space::new();
        for folder in ["assets", name] {
            copy(&repository("examples").join(folder), &space.path(folder));
        }
        Example { space, name }
    }

    /// Runs a program in the example's folder with `kiln` on its path; all that it said.
    #[track_caller]
    fn run(&self, program: &str, args: &[&str]) -> String {
        let bin = Path::new(KILN).parent().unwrap();
        let path = std::env::join_paths(
            std::iter::once(bin.to_path_buf())
                .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap_or_default())),
        );
        let mut command = Command::new(program);
        command.args(args).current_dir(self.space.path(self.name)).env("PATH", path.unwrap());
        let output = command.output().unwrap();
        let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        assert!(output.status.success(), "{program} {args:?}:\n{said}");
        said
    }

    fn container(&self, name: &str) -> PathBuf {
        self.space.path(&format!("assets/out/{name}.kiln"))
    }

    /// Exchanges the pictures' colours.
    fn repaint(&self, name: &str) {
        self.tick();
        let other = if name == "left" { "right" } else { "left" };
        let picture = fs::read(repository(&format!("examples/assets/models/{other}.png"))).unwrap();
        fs::write(self.space.path(&format!("assets/models/{name}.png")), picture).unwrap();
    }

    /// Waits, without sleeping, until the file system's time has moved on: what changes within one tick of it has one time for tools
    /// that go by times.
    fn tick(&self) {
        let probe = self.space.path("probe");
        let time = || {
            fs::write(&probe, "now").unwrap();
            fs::metadata(&probe).unwrap().modified().unwrap()
        };
        let start = time();
        while time() <= start {}
        fs::remove_file(&probe).unwrap();
    }

    /// Expects the three promises of `build`, which runs the tool and gives what it and kiln said.
    fn keeps_its_promises(&self, build: &dyn Fn() -> String) {
        let both = || [fs::read(self.container("left")).unwrap(), fs::read(self.container("right")).unwrap()];
        let idle = |when: &str| {
            let said = build();
            assert!(!said.contains("stages"), "kiln was run {when}:\n{said}");
        };
        let said = build();
        assert!(said.contains("10 of 10 stages ran"), "{said}");
        let first = both();
        idle("by a second run");
        self.repaint("left");
        let said = build();
        assert!(said.contains("2 of 10 stages ran"), "import and pack of one asset:\n{said}");
        let second = both();
        assert!(first[0] != second[0] && first[1] == second[1]);
        idle("after the picture was built in");
        fs::remove_file(self.container("right")).unwrap();
        let said = build();
        assert!(said.contains("0 of 10 stages ran"), "{said}");
        assert_eq!(both(), second);
        idle("after the container came back");
    }

    /// Expects that a new match of the pipeline's glob is noticed, by the folder that it appears in.
    fn notices_a_new_model(&self, build: &dyn Fn() -> String) {
        self.tick();
        let model = self.space.path("assets/models/new.gltf");
        fs::copy(self.space.path("assets/models/left.gltf"), model).unwrap();
        let said = build();
        assert!(said.contains("of 15 stages ran"), "{said}");
    }
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        let built = ["out", "build", "target", ".kiln"].iter().any(|name| path.ends_with(name));
        if path.is_file() {
            fs::copy(&path, target).unwrap();
        } else if !built {
            copy(&path, &target);
        }
    }
}

/// The tool's name, if it runs here.
fn tool(name: &'static str) -> Option<&'static str> {
    let runs = Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success());
    needs(runs.then_some(name), name)
}

#[test]
fn ninja_rebuilds_what_changed_by_the_depfile() {
    let Some(ninja) = tool("ninja") else { return };
    let example = Example::new("ninja");
    // Ninja itself refuses a depfile with an output that `build.ninja` does not name: a new model needs its line there.
    example.keeps_its_promises(&|| example.run(ninja, &[]));
}

#[test]
fn make_rebuilds_what_changed_by_the_depfile() {
    let Some(make) = tool("make") else { return };
    let example = Example::new("make");
    example.keeps_its_promises(&|| example.run(make, &[]));
    example.notices_a_new_model(&|| example.run(make, &[]));
    // A model that is gone is kiln's to judge, not Make's.
    example.tick();
    fs::remove_file(example.space.path("assets/models/new.gltf")).unwrap();
    assert!(example.run(make, &[]).contains("10 stages"));
}

#[test]
fn cmake_builds_through_its_module_with_make_and_with_ninja() {
    let Some(cmake) = tool("cmake") else { return };
    for (generator, program) in [("Unix Makefiles", "make"), ("Ninja", "ninja")] {
        if tool(program).is_none() {
            continue;
        }
        let example = Example::new("cmake");
        example.run(cmake, &["-G", generator, "-B", "build"]);
        example.keeps_its_promises(&|| example.run(cmake, &["--build", "build"]));
    }
}

/// Whether tests that take minutes are asked for.
fn long() -> bool {
    let asked = std::env::var_os("KILN_LONG").is_some();
    if !asked {
        eprintln!("skipped: takes minutes; KILN_LONG=1 runs it");
    }
    asked
}

#[test]
fn cargo_runs_the_build_script_again_only_for_what_was_read() {
    if !long() {
        return;
    }
    let example = Example::new("cargo");
    let manifest = example.space.path("cargo/Cargo.toml");
    let text = fs::read_to_string(&manifest).unwrap();
    let here = repository("crates/kiln").canonicalize().unwrap();
    fs::write(&manifest, text.replace("../../crates/kiln", &here.to_string_lossy())).unwrap();
    fs::copy(repository("Cargo.lock"), example.space.path("cargo/Cargo.lock")).unwrap();
    let build = || example.run("cargo", &["run", "--release", "--verbose", "--offline"]);
    let ran = |said: &str| said.lines().any(|line| line.contains("Running") && line.contains("build-script-build"));
    let first = build();
    assert!(ran(&first), "{first}");
    let second = build();
    assert!(!ran(&second), "{second}");
    example.repaint("left");
    let third = build();
    assert!(ran(&third), "{third}");
    assert!(!ran(&build()));
}

#[test]
fn bazel_runs_every_stage_in_a_sandbox_and_reruns_the_changed_asset_alone() {
    // Bazel comes from npm: @bazel/bazel-linux_x64.
    let named = std::env::var("KILN_BAZEL").ok();
    let found = || Command::new("bazel").arg("--version").output().is_ok().then(|| "bazel".to_owned());
    let Some(bazel) = named.or_else(found) else {
        eprintln!("skipped: needs a bazel, on PATH or by KILN_BAZEL");
        return;
    };
    let example = Example::new("bazel");
    copy(&example.space.path("assets"), &example.space.path("bazel/assets"));
    fs::copy(KILN, example.space.path("bazel/kiln")).unwrap();
    let root = format!("--output_user_root={}", example.space.path("bazel-root").display());
    let build = || example.run(&bazel, &[&root, "build", "--curses=no", "--color=no", "//:assets"]);
    // Such as "12 processes: 12 linux-sandbox."
    let processes = |said: &str| {
        let line = said.lines().find(|line| line.contains(" process")).unwrap_or_default();
        line.trim_start_matches("INFO: ").trim_end_matches('.').to_owned()
    };
    let left = || fs::read(example.space.path("bazel/bazel-bin/left.kiln")).unwrap();
    let first = processes(&build());
    assert!(first.starts_with("12 processes") && first.contains("sandbox"), "two assets of five stages: {first}");
    let before = left();
    let second = processes(&build());
    assert!(second.starts_with("0 processes"), "{second}");
    let picture = fs::read(repository("examples/assets/models/right.png")).unwrap();
    fs::write(example.space.path("bazel/assets/models/left.png"), picture).unwrap();
    let third = processes(&build());
    assert!(third.starts_with("6 processes"), "five stages and the container of one asset: {third}");
    assert_ne!(left(), before);
    eprintln!("bazel: first {first}; second {second}; a changed picture {third}");
    example.run(&bazel, &[&root, "shutdown"]);
}
