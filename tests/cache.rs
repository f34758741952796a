//! `kiln cache`, and a cache that two machines share, by the command.

use std::path::{Path, PathBuf};
use std::{env, fs};

use kiln_engine::ContentHash;
use serde_json::json;
use xtask::servers::{Moto, TROUBLES, troublesome};

use crate::space::{Ran, Space, files_under, finished, ran, small};

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

// --- who may be believed ---

/// Builds with a configuration of its own; `args` after `build pipeline.toml`.
fn build_with(space: &Space, config: &str, args: &[&str]) -> Ran {
    space.write("config.toml", config);
    let all = [&["build", "pipeline.toml", "--backend", "cpu", "--json"][..], args].concat();
    finished(space.command(all).env("KILN_CONFIG", "config.toml"))
}

/// A share into which CI has sent the small pipeline in two variants; and what the first is, and how many stages it has.
fn filled_share(config: &str) -> (tempfile::TempDir, Vec<u8>, usize) {
    let share = tempfile::tempdir().unwrap();
    let to = share.path().display().to_string();
    let ci = small("boundary-pair.glb");
    let args = ["--remote", &to, "--remote-mode", "write"];
    let stages = ran(&build_with(&ci, config, &args).expect(0).json()).len();
    let expected = ci.read("out/model.kiln");
    build_with(&ci, config, &[&args[..], &["--set", "stage.bake.dilation=3"]].concat()).expect(0);
    assert_ne!(ci.read("out/model.kiln"), expected);
    (share, expected, stages)
}

/// Makes the record of the run that gave `truth` claim the other container of the share.
fn forge(share: &Path, truth: &[u8]) {
    let (hash, length) = (ContentHash::of(truth), truth.len() as u64);
    let container = |path: &PathBuf| fs::read(path).unwrap()[56..].starts_with(&truth[..8]);
    let other = files_under(&share.join("v1/blobs"));
    let other = other.into_iter().find(|path| container(path) && !path.ends_with(hash.hex())).unwrap();
    let bytes = fs::read(other).unwrap();
    let lie = [&ContentHash::of(&bytes[56..]).0[..], &(bytes.len() as u64 - 56).to_le_bytes()].concat();
    let said = [&hash.0[..], &length.to_le_bytes()].concat();
    let mut forged = 0;
    for record in files_under(&share.join("v1/actions")) {
        let mut bytes = fs::read(&record).unwrap();
        if let Some(at) = bytes.windows(said.len()).position(|part| part == said) {
            bytes[at..at + lie.len()].copy_from_slice(&lie);
            let seal = ContentHash::of(&bytes[40..]);
            bytes[8..40].copy_from_slice(&seal.0);
            fs::write(record, bytes).unwrap();
            forged += 1;
        }
    }
    assert_eq!(forged, 1);
}

#[test]
fn a_record_that_lies_is_named_by_verify_and_what_rests_on_it_is_built_again() {
    let (share, expected, stages) = filled_share("");
    let remote = share.path().display().to_string();
    let honest = small("boundary-pair.glb");
    let report = build_with(&honest, "[remote]\ncheck = 1.0\n", &["--remote", &remote, "--verify"]).expect(0);
    assert!(
        report.stderr.contains(&format!("{stages} of {stages} records of the remote were recomputed, 0 of them lied"))
    );
    assert!(report.json()["remote"]["checked"] == stages && ran(&report.json()).is_empty());

    forge(share.path(), &expected);
    let victim = small("boundary-pair.glb");
    build_with(&victim, "", &["--remote", &remote]).expect(0);
    assert!(victim.read("out/model.kiln") != expected, "nothing but running the stage could tell");

    let careful = small("boundary-pair.glb");
    let report = build_with(&careful, "[remote]\ncheck = 1.0\n", &["--remote", &remote, "--verify"]).expect(2);
    let line = report.stderr.lines().find(|line| line.starts_with("error:")).unwrap();
    assert!(line.contains("model.glb") && line.contains("pack") && line.contains("the remote's record says"), "{line}");
    assert_eq!(report.json()["remote"]["refuted"], 1);
    assert!(careful.read("out/model.kiln") == expected, "what rested on the lie was built again");
    assert_eq!(ran(&careful.build()), Vec::<String>::new(), "the truth is kept here");
    fs::remove_file(careful.path("out/model.kiln")).unwrap();
    careful.build();
    assert!(careful.read("out/model.kiln") == expected);

    // A share of none looks at none; whoever may write puts the remote right.
    let careless = small("boundary-pair.glb");
    let report = build_with(&careless, "[remote]\ncheck = 0.0\n", &["--remote", &remote, "--verify"]).expect(0);
    assert_eq!(report.json()["remote"]["checked"], 0);
    let ci = small("boundary-pair.glb");
    let args = ["--remote", &remote, "--remote-mode", "write", "--verify"];
    build_with(&ci, "[remote]\ncheck = 1.0\n", &args).expect(2);
    let person = small("boundary-pair.glb");
    build_with(&person, "", &["--remote", &remote]).expect(0);
    assert!(person.read("out/model.kiln") == expected);
}

#[test]
fn with_trusted_keys_only_what_they_signed_is_taken() {
    let keys = Space::new();
    let key = |name: &str, digit: &str| {
        let path = keys.write(name, digit.repeat(64)).display().to_string();
        let public = keys.run(["cache", "key", &path]).expect(0).stdout.trim().to_owned();
        (format!("[remote]\nsign_with = '{path}'\n"), format!("[remote]\ntrusted_keys = ['{public}']\n"))
    };
    let ((signs, trusts), (_, trusts_another)) = (key("ci", "1"), key("stranger", "2"));
    let ran_by = |share: &Path, config: &str| {
        let person = small("boundary-pair.glb");
        let report = build_with(&person, config, &["--remote", &share.display().to_string()]).expect(0).json();
        (ran(&report).len(), report["warnings"][0].as_str().unwrap_or_default().to_owned())
    };
    let (signed, _, stages) = filled_share(&signs);
    assert_eq!(ran_by(signed.path(), &trusts), (0, String::new()));
    let (all, told) = ran_by(signed.path(), &trusts_another);
    assert!(all == stages && told.contains("a key that is not trusted"), "{told}");
    let (unsigned, ..) = filled_share("");
    let (all, told) = ran_by(unsigned.path(), &trusts);
    assert!(all == stages && told.contains("is not signed"), "{told}");
    assert_eq!(ran_by(unsigned.path(), "").0, 0);
    // Whoever looks after the folder needs no key.
    let verified = keys.run(["cache", "verify", "--cache", &signed.path().display().to_string()]).expect(0);
    assert!(verified.stdout.contains("nothing is damaged"), "{}", verified.stdout);
}

// --- servers ---

/// moto's S3; `None`, said, where it is not installed, and a failure where it is asked for.
fn moto() -> Option<Moto> {
    let moto = Moto::start();
    if moto.is_none() {
        assert!(env::var_os("KILN_REQUIRE_S3").is_none(), "moto_server is asked for and does not start");
        eprintln!("skipped: needs moto_server");
    }
    moto
}

/// The configuration of a machine that reaches S3 at `port`.
fn s3(port: u16) -> String {
    format!(
        "[remote]\npatience = '2s'\nsettings = {{ endpoint = 'http://127.0.0.1:{port}', allow_http = 'true', region = 'us-east-1', \
         access_key_id = 'kiln', secret_access_key = 'kiln' }}\n"
    )
}

#[test]
fn a_second_machine_takes_every_stage_from_s3_and_survives_the_server() {
    let Some(moto) = moto() else { return };
    let remote = ["--remote", "s3://kiln/studio/cache"];
    let ci = small("boundary-pair.glb");
    let sent = build_with(&ci, &s3(moto.port()), &[&remote[..], &["--remote-mode", "write"]].concat()).expect(0).json();
    let stages = ran(&sent).len();
    assert!(stages > 4 && sent["remote"]["sent"] == stages, "{}", sent["remote"]);

    let person = small("boundary-pair.glb");
    let taken = build_with(&person, &s3(moto.port()), &remote).expect(0).json();
    assert!(ran(&taken).is_empty() && taken["warnings"] == json!([]), "{taken}");
    assert!(taken["remote"]["hits"] == stages && taken["remote"]["failures"] == 0, "{}", taken["remote"]);
    assert!(person.read("out/model.kiln") == ci.read("out/model.kiln"));

    let nobody = small("boundary-pair.glb");
    let absent = build_with(&nobody, &s3(moto.port()), &["--remote", "s3://absent/cache"]).expect(0).json();
    let told = absent["warnings"][0].as_str().unwrap_or_default();
    assert!(told.contains("there is no such bucket"), "{absent}");

    let half = taken["remote"]["bytes_received"].as_u64().unwrap() as usize / 2;
    let port = moto.dying_after(half).unwrap();
    let unlucky = small("boundary-pair.glb");
    let report = build_with(&unlucky, &s3(port), &[&remote[..], &["--jobs", "1"]].concat()).expect(0).json();
    let (hits, again) = (report["remote"]["hits"].as_u64().unwrap() as usize, ran(&report).len());
    assert!(hits > 0 && again > 0 && hits + again == stages, "{hits} taken, {again} run");
    assert_eq!(report["warnings"].as_array().unwrap().len(), 1, "{}", report["warnings"]);
    assert!(unlucky.read("out/model.kiln") == ci.read("out/model.kiln"));
    unlucky.run(["cache", "verify"]).expect(0);
}

#[test]
fn a_server_in_trouble_costs_a_warning_and_time() {
    let clean = small("boundary-pair.glb");
    clean.build();
    for (name, trouble) in TROUBLES {
        let url = troublesome(trouble).unwrap();
        let space = small("boundary-pair.glb");
        let report = build_with(&space, "[remote]\npatience = '1s'\n", &["--remote", &url]).expect(0).json();
        assert!(
            report["remote"]["left_alone"] == true && report["remote"]["hits"] == 0,
            "{name}: {}",
            report["remote"]
        );
        assert_eq!(report["warnings"].as_array().unwrap().len(), 1, "{name}: {}", report["warnings"]);
        assert!(space.read("out/model.kiln") == clean.read("out/model.kiln"), "{name}");
    }
}

#[test]
fn wrong_blobs_on_the_share_are_not_taken() {
    let (share, expected, stages) = filled_share("");
    for blob in files_under(&share.path().join("v1/blobs")) {
        let mut bytes = fs::read(&blob).unwrap();
        let last = bytes.len() - 1;
        bytes[last] ^= 1;
        fs::write(blob, bytes).unwrap();
    }
    let person = small("boundary-pair.glb");
    let report = build_through(&person, share.path(), "read");
    assert!(ran(&report).len() == stages && report["remote"]["hits"] == 0, "{}", report["remote"]);
    assert_eq!(report["warnings"].as_array().unwrap().len(), 1, "{}", report["warnings"]);
    assert!(person.read("out/model.kiln") == expected);
}
