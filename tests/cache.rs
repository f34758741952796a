//! `kiln cache`, and a cache that two machines share, by the command.

use std::fs;
use std::path::Path;

use crate::space::{Space, ran, small};

/// Builds through the shared folder, with a cache of its own.
fn build_through(space: &Space, share: &Path, mode: &str) -> serde_json::Value {
    let share = share.display().to_string();
    let args = ["build", "pipeline.toml", "--backend", "cpu", "--json", "--remote", &share, "--remote-mode", mode];
    space.run(args).expect(0).json()
}

#[test]
fn a_second_machine_takes_every_stage_from_the_shared_folder() {
    let share = tempfile::tempdir().unwrap();
    let ci = small("boundary-pair.glb");
    let sent = build_through(&ci, share.path(), "write");
    let stages = ran(&sent).len();
    assert!(stages > 4 && sent["remote"]["sent"] == stages, "{}", sent["remote"]);

    let person = small("boundary-pair.glb");
    let taken = build_through(&person, share.path(), "read");
    assert_eq!(ran(&taken), Vec::<String>::new());
    assert!(taken["remote"]["hits"] == stages && taken["remote"]["failures"] == 0, "{}", taken["remote"]);
    assert_eq!(person.read("out/model.kiln"), ci.read("out/model.kiln"));
    assert_eq!(ran(&person.build()), Vec::<String>::new(), "without the remote it is fresh too");
}

#[test]
fn a_remote_that_is_not_there_is_a_warning_and_a_wrong_one_is_bad_usage() {
    let space = small("boundary-pair.glb");
    let absent = space.path("absent").display().to_string();
    let report = space.run(["build", "pipeline.toml", "--backend", "cpu", "--remote", &absent]).expect(0);
    assert!(report.stderr.contains("there is no such folder"), "{}", report.stderr);
    space.run(["build", "pipeline.toml", "--remote", "ftp://host/x", "--set", "stage.bake.dilation=3"]).expect(64);
    let wrong =
        space.command(["build", "pipeline.toml"]).env("KILN_REMOTE_MODE", "rw").env("KILN_REMOTE", "x").output();
    assert_eq!(wrong.unwrap().status.code(), Some(64));
    space.write("config.toml", "[remote]\nulr = 'x'\n");
    let wrong = space.command(["build", "pipeline.toml"]).env("KILN_CONFIG", "config.toml").output().unwrap();
    assert_eq!(wrong.status.code(), Some(64));
    assert!(String::from_utf8_lossy(&wrong.stderr).contains("ulr"));
}

#[test]
fn stats_gc_and_verify_say_what_they_find() {
    let space = small("boundary-pair.glb");
    space.run(["cache", "stats"]).expect(2);
    space.build();
    let stats = space.run(["cache", "stats", "--json"]).expect(0).json();
    assert!(stats["records"]["files"].as_u64().unwrap() > 4 && stats["leases"] == 0, "{stats}");
    assert!(space.run(["cache", "stats"]).expect(0).stdout.contains("simplify"));
    space.run(["cache", "verify"]).expect(0);

    space.run(["cache", "gc"]).expect(64);
    space.run(["cache", "gc", "--max-size", "many"]).expect(64);
    let young = space.run(["cache", "gc", "--max-age", "1d", "--json"]).expect(0).json();
    assert_eq!(young["removed_files"], 0);
    let pinned = ["cache", "gc", "--max-size", "0", "--pin", "out/model.kiln", "--json"];
    let pinned = space.run(pinned).expect(1).json();
    assert!(pinned["removed_files"] == 0 && pinned["over_bytes"] == pinned["bytes"], "{pinned}");
    space.write("pins.txt", "# what we ship\n\nout/model.kiln\n");
    space.run(["cache", "gc", "--max-size", "0", "--pins", "pins.txt", "--dry-run"]).expect(1);

    let blobs = space.path(".kiln/v1/blobs");
    let shard = fs::read_dir(blobs).unwrap().next().unwrap().unwrap().path();
    let blob = fs::read_dir(shard).unwrap().next().unwrap().unwrap().path();
    fs::write(blob, "damaged").unwrap();
    assert!(space.run(["cache", "verify"]).expect(1).stderr.contains("damaged blob"));

    let expected = space.read("out/model.kiln");
    let all = space.run(["cache", "gc", "--max-size", "0", "--json"]).expect(0).json();
    assert_eq!(all["removed_files"], all["files"]);
    fs::remove_file(space.path("out/model.kiln")).unwrap();
    assert!(!ran(&space.build()).is_empty());
    assert_eq!(space.read("out/model.kiln"), expected);
}
