//! Builds that go on: `--watch`, and what Ctrl-C leaves.

#![cfg(unix)]

use std::fs;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use crate::inputs::{buffer, gltf};
use crate::rebuild::{many, quad_gltf};
use crate::space::{SMALL, Space, small};

#[test]
fn a_build_that_is_interrupted_leaves_nothing_half() {
    let clean = small("boundary-pair.glb");
    clean.build();
    let expected = clean.read("out/model.kiln");
    let mut interrupted = 0;
    for stage in ["import", "atlas", "bake"] {
        let space = small("boundary-pair.glb");
        let mut command = space.command(["build", "pipeline.toml", "--backend", "cpu", "--explain"]);
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(child.stderr.take().unwrap()).lines();
        let begins = format!("/ {stage}: runs");
        let began = said.by_ref().map_while(Result::ok).any(|line| line.contains(&begins));
        assert!(began, "{stage} never began");
        Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        let rest: Vec<String> = said.map_while(Result::ok).collect();
        let ended = child.wait().unwrap();
        interrupted += u32::from(ended.code() == Some(2));
        assert!(matches!(ended.code(), Some(0 | 2)), "{ended:?} {rest:?}");
        if space.path("out/model.kiln").exists() {
            assert_eq!(space.read("out/model.kiln"), expected, "whole or not there: {rest:?}");
        }
        let temporary: Vec<_> = fs::read_dir(space.path(".kiln/v1/tmp")).unwrap().collect();
        assert!(temporary.is_empty(), "{temporary:?}");
        space.build();
        assert_eq!(space.read("out/model.kiln"), expected);
    }
    assert!(interrupted > 0, "no interrupt met a running build: the test proved nothing");
}

#[test]
fn a_stage_that_takes_long_and_does_not_look_up_is_left() {
    let space = small("pot.glb");
    // The better part of a minute.
    let slow = SMALL.replace(
        "levels = [{ keep = 0.25 }]",
        "metric = { kind = \"viewpoint-entropy\", size = 512 }\nlevels = [{ keep = 0.25 }]",
    );
    space.write("pipeline.toml", slow);
    let mut command = space.command(["build", "pipeline.toml", "--backend", "cpu", "--explain"]);
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    let mut said = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert!(said.by_ref().any(|line| line.contains("/ base, collapse: runs")));
    Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let rest: Vec<String> = said.collect();
    assert_eq!(child.wait().unwrap().code(), Some(2), "{rest:#?}");
    assert!(rest.iter().any(|line| line.contains("what still ran was left")), "{rest:#?}");
    assert_eq!(fs::read_dir(space.path(".kiln/v1/tmp")).unwrap().count(), 0);
    assert!(!space.path("out").exists());
    // What was finished before is kept.
    let report = space.run(["build", "pipeline.toml", "--backend", "cpu", "--dry-run", "--json"]).expect(0).json();
    let states: Vec<_> = report["assets"][0]["stages"].as_array().unwrap().iter().map(|s| s["state"].clone()).collect();
    assert_eq!(states[..3], ["fresh", "fresh", "would-run"]);
}

/// A `kiln build --watch` that ends with the value.
struct Watching {
    child: Child,
    said: Receiver<String>,
}

impl Watching {
    fn start(space: &Space) -> Watching {
        let mut command = space.command(["build", "pipeline.toml", "--backend", "cpu", "--watch"]);
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        let (sender, said) = channel();
        std::thread::spawn(move || lines.for_each(|line| drop(sender.send(line))));
        Watching { child, said }
    }

    /// Waits until a line holds `text`; gives the lines up to it.
    #[track_caller]
    fn says(&self, text: &str) -> Vec<String> {
        let mut lines = Vec::new();
        loop {
            match self.said.recv_timeout(Duration::from_secs(60)) {
                Ok(line) => lines.push(line),
                Err(_) => panic!("`{text}` was never said: {lines:#?}"),
            }
            if lines.last().is_some_and(|line| line.contains(text)) {
                return lines;
            }
        }
    }

    /// Ctrl-C; gives the exit code.
    fn interrupt(mut self) -> Option<i32> {
        Command::new("kill").args(["-INT", &self.child.id().to_string()]).status().unwrap();
        self.child.wait().unwrap().code()
    }
}

impl Drop for Watching {
    fn drop(&mut self) {
        // It has ended already, or a check failed.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_watching_build_builds_what_changes_shows_errors_and_keeps_the_last_good_output() {
    let space = many();
    fs::remove_file(space.path("out/a.kiln")).unwrap();
    let watching = Watching::start(&space);
    watching.says("0 of 15 stages ran");
    space.write("models/b.gltf", quad_gltf("bee"));
    watching.says("2 of 15 stages ran");
    let good = space.read("out/b.kiln");
    // A model that is broken, and mended.
    space.write("models/b.gltf", "{}");
    watching.says("error: models/b.gltf");
    assert_eq!(space.read("out/b.kiln"), good);
    space.write("models/b.gltf", quad_gltf("wasp"));
    watching.says("2 of 15 stages ran");
    assert_ne!(space.read("out/b.kiln"), good);
    // A pipeline that is broken, and mended with another level.
    let pipeline = String::from_utf8(space.read("pipeline.toml")).unwrap();
    space.write("pipeline.toml", pipeline.replace("levels", "lewels"));
    watching.says("levels");
    // What nothing looks at starts nothing, such as a log beside the pipeline, nor is an error said again.
    space.write("build.log", "error");
    space.write("pipeline.toml", &pipeline);
    let lines = watching.says("nothing to do");
    assert!(!lines.iter().any(|line| line.contains("lewels")), "{lines:#?}");
    space.write("pipeline.toml", pipeline.replace("keep = 0.5", "keep = 0.4"));
    // All three have one geometry: it is simplified once.
    watching.says("4 of 15 stages ran");
    // Many events at once are one build.
    for round in 0..50 {
        for name in ["a", "b", "c"] {
            space.write(&format!("models/{name}.gltf"), quad_gltf(&format!("{name} {round}")));
        }
    }
    let lines = watching.says("stages ran");
    assert!(lines.last().unwrap().contains("6 of 15 stages ran"), "{lines:#?}");
    // A new model whose buffer is missing, with the folder that it would lie in; then both are there; then the model goes.
    space.write("models/d.gltf", gltf().to_string());
    watching.says("error: models/d.gltf");
    space.write("models/parts/data.bin", buffer(1.0));
    watching.says("of 20 stages ran");
    fs::remove_file(space.path("models/d.gltf")).unwrap();
    space.write("models/a.gltf", quad_gltf("last"));
    watching.says("2 of 15 stages ran");
    assert_eq!(watching.interrupt(), Some(0));
}
