//! Stages as commands, and stages on other machines: `kiln stage run`, `kiln plan`, `kiln build --on slurm` with a stand-in for
//! Slurm, and with a real one on this machine where it is installed.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

use crate::space::{KILN, Ran, Space, needs, ran, repository, small};

/// `count` models with a picture each and the pipeline of the examples as `pipeline.toml`: import, merge, simplify, pack.
fn models(count: usize) -> Space {
    let space = Space::new();
    let asset = |name: &str| fs::read(repository("examples/assets").join(name)).unwrap();
    space.write("pipeline.toml", asset("assets.toml"));
    for number in 0..count {
        let side = ["left", "right"][number % 2];
        let model = String::from_utf8(asset(&format!("models/{side}.gltf"))).unwrap();
        // Its own name too: no two assets share a stage's result.
        let model = model.replace(&format!("{side}.png"), &format!("m{number}.png"));
        let model = model.replace(&format!("\"{side}\""), &format!("\"m{number}\""));
        space.write(&format!("models/m{number}.gltf"), model);
        space.write(&format!("models/m{number}.png"), asset(&format!("models/{side}.png")));
    }
    space
}

/// Every container below `out`, by name.
fn containers(space: &Space) -> BTreeMap<String, Vec<u8>> {
    let all = space.files().into_iter().filter(|(name, _)| name.ends_with(".kiln"));
    all.map(|(name, bytes)| (name.rsplit('/').next().unwrap().to_owned(), bytes)).collect()
}

/// What a plain build of the same files gives.
fn expected(count: usize) -> BTreeMap<String, Vec<u8>> {
    let space = models(count);
    space.build();
    containers(&space)
}

/// The graph of `pipeline.toml`.
fn graph(space: &Space) -> Value {
    space.run(["plan", "pipeline.toml", "--backend", "cpu", "--json", "--program", KILN]).expect(0).json()
}

fn words(value: &Value) -> Vec<String> {
    value.as_array().unwrap().iter().map(|word| word.as_str().unwrap().to_owned()).collect()
}

/// Runs a command of a graph.
fn run_argv(space: &Space, argv: &[String], more: &[&str]) -> Ran {
    assert_eq!(argv[0], KILN);
    space.run(argv[1..].iter().map(String::as_str).chain(more.iter().copied()))
}

// --- one stage ---

#[test]
fn every_stage_runs_alone_in_the_order_of_the_graph_and_the_build_finds_all() {
    let space = small("boundary-pair.glb");
    let graph = graph(&space);
    assert_eq!(graph["version"], 1);
    let asset = &graph["assets"][0];
    for stage in asset["stages"].as_array().unwrap() {
        let said = run_argv(&space, &words(&stage["command"]), &["--only"]).expect(0).stderr;
        assert!(said.contains(": ran in") && !said.contains("stages before"), "{said}");
        let again = run_argv(&space, &words(&stage["command"]), &[]).expect(0).stderr;
        assert!(again.contains(": fresh\n"), "{again}");
    }
    run_argv(&space, &words(&asset["command"]), &[]).expect(0);
    let whole = small("boundary-pair.glb");
    whole.build();
    assert_eq!(space.read("out/model.kiln"), whole.read("out/model.kiln"));
    assert_eq!(ran(&space.build()), Vec::<String>::new());
}

#[test]
fn what_is_lost_before_a_stage_is_made_again_unless_it_must_not_be() {
    let space = small("boundary-pair.glb");
    let run = ["stage", "run", "pipeline.toml", "--stage", "lods", "--backend", "cpu"];
    let refused = space.run(run.into_iter().chain(["--only"])).expect(2).stderr;
    assert!(refused.contains("neither the cache nor a folder of --with has its result"), "{refused}");
    let made = space.run(run).expect(0).stderr;
    assert!(made.contains("stages before it"), "{made}");
    for (args, code, word) in [
        (["--stage", "lod", "--asset", "model.glb"], 64, "it has import, whole, base/collapse"),
        (["--stage", "lods", "--asset", "modle.glb"], 64, "did you mean `model.glb`?"),
        (["--stage", "lods", "--expect", "0123456789abcdef"], 2, "run `kiln plan` again"),
    ] {
        let said = space.run(["stage", "run", "pipeline.toml"].into_iter().chain(args)).expect(code).stderr;
        assert!(said.contains(word), "{said}");
    }
}

#[test]
fn a_stage_leaves_the_state_of_the_whole_pipeline_alone() {
    let space = models(2);
    space.build();
    let state = || {
        let files = fs::read_dir(space.path(".kiln/v1/state")).unwrap().map(|entry| entry.unwrap().path());
        files.map(|path| (path.clone(), fs::read(path).unwrap())).collect::<BTreeMap<_, _>>()
    };
    let before = state();
    space.run(["stage", "run", "pipeline.toml", "--stage", "lods", "--asset", "models/m1.gltf"]).expect(0);
    space.run(["build", "pipeline.toml", "--asset", "models/m1.gltf", "--backend", "cpu"]).expect(0);
    assert_eq!(state(), before);
}

/// A stage's fragment with the fragments of what is before it, in folders `frag/STAGE`.
fn fragment(space: &Space, stage: &str, before: &[String], folder: &str) -> Ran {
    let mut args: Vec<String> =
        ["stage", "run", "pipeline.toml", "--backend", "cpu", "--stage", stage].map(str::to_owned).to_vec();
    for before in before {
        args.extend(["--with".into(), format!("frag/{}", before.replace('/', "."))]);
    }
    args.extend(["--fragment".into(), format!("{folder}/{}", stage.replace('/', "."))]);
    space.run(args)
}

#[test]
fn fragments_carry_an_asset_from_stage_to_stage_without_a_shared_cache() {
    let space = small("boundary-pair.glb");
    let stages: Vec<String> = graph(&space)["assets"][0]["stages"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s["id"].as_str().unwrap().into())
        .collect();
    let first = fragment(&space, &stages[1], &[], "frag").expect(2).stderr;
    assert!(first.contains("--with"), "{first}");
    for (number, stage) in stages.iter().enumerate() {
        let said = fragment(&space, stage, &stages[..number], "frag").expect(0).stderr;
        assert!(said.contains(": ran in"), "{said}");
        // Its own record alone, and the same bytes on every run: no times, no state, no locks.
        let name = stage.replace('/', ".");
        let records =
            space.files().iter().filter(|(path, _)| path.starts_with(&format!("frag/{name}/v1/actions"))).count();
        assert_eq!(records, 1, "{stage}");
        fragment(&space, stage, &stages[..number], "again").expect(0);
        let of = |top: &str| {
            let prefix = format!("{top}/{name}/");
            let files = space.files().into_iter();
            files.filter_map(|(path, bytes)| Some((path.strip_prefix(&prefix)?.to_owned(), bytes))).collect::<Vec<_>>()
        };
        assert_eq!(of("frag"), of("again"), "{stage}");
    }
    let mut build = vec!["build", "pipeline.toml", "--backend", "cpu", "--json", "--cache", "scratch"];
    let folders: Vec<String> = stages.iter().map(|stage| format!("frag/{}", stage.replace('/', "."))).collect();
    build.extend(folders.iter().flat_map(|folder| ["--with", folder]));
    let report = space.run(&build).expect(0).json();
    assert_eq!(ran(&report), Vec::<String>::new());
    let whole = small("boundary-pair.glb");
    whole.build();
    assert_eq!(space.read("out/model.kiln"), whole.read("out/model.kiln"));
    // A damaged fragment is a miss, and stays as it is.
    let (path, _) = space.files().into_iter().find(|(path, _)| path.starts_with("frag/import/v1/blobs")).unwrap();
    let (whole_bytes, length) = (space.read(&path), space.read(&path).len());
    space.write(&path, &whole_bytes[..length - 1]);
    let said = fragment(&space, &stages[1], &stages[..1], "again");
    let damaged = said.code == 2 || said.stderr.contains(": ran in");
    assert!(damaged && space.read(&path).len() == length - 1, "{}", said.stderr);
    space.write("full/notes.txt", "mine");
    let refused = space.run(["stage", "run", "pipeline.toml", "--stage", "import", "--fragment", "full"]).expect(2);
    assert!(refused.stderr.contains("something else than a fragment") && space.read("full/notes.txt") == b"mine");
}

#[test]
fn a_receipt_is_written_only_if_it_differs_and_the_depfile_names_the_picture() {
    let space = models(1);
    let args =
        ["stage", "run", "pipeline.toml", "--stage", "import", "--receipt", "r/import", "--depfile", "r/import.d"];
    space.run(args).expect(0);
    let receipt = String::from_utf8(space.read("r/import")).unwrap();
    assert!(receipt.starts_with("kiln receipt 1\n") && receipt.contains(" mesh\n"), "{receipt}");
    assert!(!receipt.contains("models"), "no path: {receipt}");
    let depfile = String::from_utf8(space.read("r/import.d")).unwrap();
    assert!(depfile.starts_with("r/import:") && depfile.contains("models/m0.png"), "{depfile}");
    let written = |path: &str| fs::metadata(space.path(path)).unwrap().modified().unwrap();
    let (before, d) = (written("r/import"), written("r/import.d"));
    space.run(args).expect(0);
    assert_eq!((written("r/import"), written("r/import.d")), (before, d));
    fs::copy(repository("examples/assets/models/right.png"), space.path("models/m0.png")).unwrap();
    space.run(args).expect(0);
    assert_ne!(String::from_utf8(space.read("r/import")).unwrap(), receipt);
}

// --- the graph ---

#[test]
fn the_graph_is_a_table_for_people() {
    let space = models(2);
    let table = space.run(["plan", "pipeline.toml", "--backend", "cpu"]).expect(0).stdout;
    let row = table.lines().find(|line| line.contains("m0.gltf") && line.contains("lods/collapse")).unwrap();
    assert!(row.contains("cpu") && row.contains("sequence"), "{table}");
    assert!(table.ends_with("2 assets, 10 stages\n"), "{table}");
    let one = space.run(["plan", "pipeline.toml", "--asset", "models/m1.gltf"]).expect(0).stdout;
    assert!(one.ends_with("1 assets, 5 stages\n"), "{one}");
}

#[test]
fn ninja_runs_the_exported_graph_and_only_what_changed() {
    let runs = Command::new("ninja").arg("--version").output().is_ok();
    if needs(runs.then_some(()), "ninja").is_none() {
        return;
    }
    let space = models(3);
    // A name that Ninja and the shell would take apart.
    fs::rename(space.path("models/m2.gltf"), space.path("models/m $2: its.gltf")).unwrap();
    let plan = ["plan", "pipeline.toml", "--backend", "cpu", "--ninja", "-o", "build/build.ninja", "--program", KILN];
    space.run(plan).expect(0);
    let ninja = || {
        let mut command = Command::new("ninja");
        let output = command.args(["-f", "build/build.ninja", "-v"]).current_dir(space.path("")).output().unwrap();
        let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
        assert!(output.status.success(), "{said}");
        said
    };
    let ran = |said: &str| said.matches(": ran in").count();
    let first = ninja();
    assert_eq!(ran(&first), 15, "{first}");
    let again = ninja();
    assert!(again.contains("no work to do"), "{again}");
    let whole = models(3);
    fs::rename(whole.path("models/m2.gltf"), whole.path("models/m $2: its.gltf")).unwrap();
    whole.build();
    assert_eq!(containers(&space), containers(&whole));

    // A picture: import and pack of one asset run; what reads the mesh alone finds itself fresh.
    fs::copy(repository("examples/assets/models/right.png"), space.path("models/m0.png")).unwrap();
    let said = ninja();
    assert_eq!(ran(&said), 2, "{said}");
    assert!(!said.contains("m1.gltf / "), "{said}");
    assert!(ninja().contains("no work to do"));
    // A comment: the graph is made again, and nothing else.
    let text = String::from_utf8(space.read("pipeline.toml")).unwrap();
    space.write("pipeline.toml", format!("{text}\n# a comment\n"));
    let said = ninja();
    assert_eq!(said.matches(" / ").count(), 0, "{said}");
    // A level: `lods` and `pack` of each.
    space.write("pipeline.toml", text.replace("keep = 0.5", "keep = 0.4"));
    let said = ninja();
    assert_eq!(ran(&said), 6, "{said}");
    // A container that is gone comes back without a stage.
    fs::remove_file(space.path("out/m1.kiln")).unwrap();
    let said = ninja();
    assert_eq!(said.matches(" / ").count(), said.matches("m1.gltf / ").count(), "{said}");
    assert_eq!(ran(&said), 0, "{said}");
    assert!(space.path("out/m1.kiln").is_file());
}

#[test]
fn the_digests_of_a_plan_change_for_the_stages_that_a_changed_level_reaches_by_itself() {
    let space = models(1);
    let digests = || {
        let plan = space.run(["plan", "pipeline.toml", "--backend", "cpu", "--json"]).expect(0).json();
        let stages = plan["assets"][0]["stages"].as_array().unwrap().clone();
        stages.into_iter().map(|stage| (stage["id"].to_string(), stage["digest"].to_string())).collect::<Vec<_>>()
    };
    let before = digests();
    let text = String::from_utf8(space.read("pipeline.toml")).unwrap();
    space.write("pipeline.toml", text.replace("keep = 0.5", "keep = 0.4"));
    let changed: Vec<String> = digests().into_iter().filter(|now| !before.contains(now)).map(|(id, _)| id).collect();
    // The container tells the pipeline's hash, so it is another one even where the levels come out the same.
    assert_eq!(changed, ["\"lods\"", "\"pack\""]);
}

// --- the stand-in for Slurm ---

/// A space whose command finds the stand-in and nothing else of Slurm.
struct Farm {
    space: Space,
    fake: PathBuf,
}

impl Farm {
    fn new(space: Space) -> Farm {
        fs::create_dir_all(space.path("fake/jobs")).unwrap();
        let fake = space.path("fake");
        Farm { space, fake }
    }

    fn command(&self, more: &[&str]) -> Command {
        let backend: &[&str] = if more.contains(&"--backend") { &[] } else { &["--backend", "cpu"] };
        let mut command = self.space.command([&["build", "pipeline.toml", "--on", "slurm"][..], backend].concat());
        let old = std::env::var_os("PATH").unwrap_or_default();
        let path = std::iter::once(repository("tests/slurm/fake").canonicalize().unwrap());
        let path = std::env::join_paths(path.chain(std::env::split_paths(&old))).unwrap();
        command
            .args(more)
            .env("PATH", path)
            .env("FAKE_SLURM", &self.fake)
            .env("KILN_CONFIG", self.space.path("config.toml"));
        command
    }

    fn build(&self, config: &str, more: &[&str]) -> Ran {
        self.space.write("config.toml", config);
        let output = self.command(more).output().unwrap();
        Ran {
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8_lossy(&output.stderr).into_owned(),
        }
    }

    /// The calls of sbatch.
    fn submitted(&self) -> Vec<String> {
        let calls = fs::read_to_string(self.fake.join("calls")).unwrap_or_default();
        calls.lines().filter(|line| line.starts_with("sbatch")).map(str::to_owned).collect()
    }
}

#[test]
fn a_farm_gives_the_bytes_of_a_local_build_and_the_build_runs_nothing_itself() {
    for (config, arrays, last) in [("", 5, "--array=0-3 "), ("[slurm]\nbatch = 2\nlimit = 7", 5, "--array=0-1%7 ")] {
        let farm = Farm::new(models(4));
        let report = farm.build(config, &["--json"]).expect(0);
        assert_eq!(ran(&report.json()), Vec::<String>::new(), "{}", report.stderr);
        assert_eq!(containers(&farm.space), expected(4));
        let submitted = farm.submitted();
        assert_eq!(submitted.len(), arrays, "{submitted:?}");
        assert!(submitted.iter().all(|call| call.contains(last) && call.contains("--requeue")), "{submitted:?}");
        assert!(!submitted[0].contains("--dependency"));
        assert!(submitted[1].contains("--dependency=aftercorr:1 ") && submitted[4].contains("aftercorr:4 "));
        // Nothing is left to hand in; and without Slurm all is fresh too.
        farm.build(config, &[]).expect(0);
        assert_eq!(farm.submitted().len(), arrays);
        assert_eq!(ran(&farm.space.build()), Vec::<String>::new());
    }
}

#[test]
fn the_configuration_reaches_sbatch_and_long_arrays_are_split() {
    let farm = Farm::new(models(3));
    let config = "[slurm]\npartition = 'render'\naccount = 'assets'\ntime = '1:00'\nmem = '2G'\ncpus = 3\nmax_array = 2\nsbatch = ['--qos=low']";
    farm.build(config, &[]).expect(0);
    let submitted = farm.submitted();
    assert_eq!(submitted.len(), 10, "two chunks of five levels");
    for word in ["--partition=render", "--account=assets", "--time=1:00", "--mem=2G", "--cpus-per-task=3", "--qos=low"]
    {
        assert!(submitted.iter().all(|call| call.contains(word)), "{word}: {submitted:?}");
    }
    assert!(!submitted.iter().any(|call| call.contains("--gres")), "no stage here needs a GPU");
    assert!(submitted[0].contains("--array=0-1 ") && submitted[5].contains("--array=0-0 "), "{submitted:?}");
    assert!(!submitted[5].contains("--dependency"), "chunks do not wait for each other");
    assert_eq!(containers(&farm.space), expected(3));
}

#[test]
fn stages_that_need_a_gpu_ask_for_one_and_no_other_does() {
    if needs(kiln_gpu::Gpu::open(true).ok(), "a Vulkan adapter").is_none() {
        return;
    }
    let whole = small("boundary-pair.glb");
    whole.run(["build", "pipeline.toml", "--backend", "gpu"]).expect(0);
    let farm = Farm::new(small("boundary-pair.glb"));
    let report = farm.build("[slurm]\ngres = 'gpu:any:1'", &["--backend", "gpu", "--json"]).expect(0);
    assert_eq!(ran(&report.json()), Vec::<String>::new(), "{}", report.stderr);
    let submitted = farm.submitted();
    let asking: Vec<&String> = submitted.iter().filter(|call| call.contains("--gres=gpu:any:1 ")).collect();
    assert!(submitted.len() > 2 && asking.len() == 1, "the bake alone: {submitted:?}");
    assert_eq!(containers(&farm.space), containers(&whole));
}

#[test]
fn a_model_that_fails_is_named_with_its_log_and_the_others_are_written() {
    let farm = Farm::new(models(4));
    farm.space.write("models/m1.gltf", "{}");
    for batch in ["1", "4"] {
        let said = farm.build("", &["--batch", batch]).expect(2).stderr;
        let errors: Vec<&str> = said.lines().filter(|line| line.starts_with("error:")).collect();
        assert_eq!(errors.len(), 1, "what waits for it says nothing new: {said}");
        assert!(errors[0].contains("models/m1.gltf, stage import") && errors[0].contains("exit code 2"), "{said}");
        assert!(said.contains("| error: m1.gltf / import:") && said.contains("log: "), "{said}");
        let log = said.split("log: ").nth(1).unwrap().lines().next().unwrap();
        assert!(Path::new(log).is_file(), "{log}");
        let mut all = expected(4);
        all.remove("m1.kiln");
        assert_eq!(containers(&farm.space), all);
    }
}

#[test]
fn an_element_that_dies_for_good_costs_its_own_assets_only() {
    let farm = Farm::new(models(4));
    // The first array's third element: import of the third model.
    fs::write(farm.fake.join("lose"), "0-2").unwrap();
    let said = farm.build("", &[]).expect(2).stderr;
    assert!(said.contains("models/m2.gltf, stage import") && said.contains("ended without a word"), "{said}");
    assert!(said.contains("| slurmstepd: error: node failed"), "{said}");
    assert_eq!(said.lines().filter(|line| line.starts_with("error:")).count(), 1, "{said}");
    let mut all = expected(4);
    all.remove("m2.kiln");
    assert_eq!(containers(&farm.space), all);
    fs::remove_file(farm.fake.join("lose")).unwrap();
    farm.build("", &[]).expect(0);
    assert_eq!(containers(&farm.space), expected(4));
}

#[test]
fn a_full_queue_is_waited_for_and_a_refusal_from_the_start_is_told() {
    let farm = Farm::new(models(2));
    fs::write(farm.fake.join("refuse"), "1 1").unwrap();
    let said = farm.build("", &[]).expect(2).stderr;
    assert!(said.contains("sbatch: sbatch: error: Batch job submission failed: Job violates"), "{said}");
    let farm = Farm::new(models(2));
    fs::write(farm.fake.join("refuse"), "3 5").unwrap();
    farm.build("", &["--asset", "models/m0.gltf"]).expect(0);
    assert_eq!(farm.submitted().len(), 8, "of one asset, and three refusals");
    farm.build("[slurm]\nbatch = 0", &[]).expect(64);
}

#[test]
fn without_slurm_the_build_says_so_before_anything_runs() {
    let space = models(1);
    let command = ["build", "pipeline.toml", "--backend", "cpu", "--on", "slurm"];
    let output = space.command(command).env("PATH", space.path("none")).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("`sbatch` cannot be run") && said.contains("--on local"), "{said}");
    assert!(!space.path("out").exists());
}

#[test]
#[cfg(unix)]
fn an_interrupt_takes_the_jobs_out_of_the_queue() {
    let farm = Farm::new(models(2));
    // Jobs that never begin.
    fs::write(farm.fake.join("lose"), "none").unwrap();
    fs::create_dir_all(farm.fake.join("jobs/0")).unwrap();
    farm.space.write("config.toml", "[slurm]\nsbatch = ['--dependency=aftercorr:0']");
    let child = farm.command(&[]).stderr(std::process::Stdio::piped()).spawn().unwrap();
    let calls = || fs::read_to_string(farm.fake.join("calls")).unwrap_or_default();
    while !calls().contains("squeue --noheader") {
        std::thread::yield_now();
    }
    let killed = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(calls().contains("scancel --name=kiln-"), "{}", calls());
    assert!(!farm.space.path("out").exists());
}

// --- the real one ---

/// Slurm on this machine, while the value lives.
struct Loopback {
    folder: tempfile::TempDir,
}

impl Loopback {
    /// `None`, and a word, where it cannot be started: it needs packages, root, and ports that a machine may not give.
    /// `KILN_REQUIRE_SLURM=1` makes that a failure.
    fn start() -> Option<Loopback> {
        let there = |name: &str| {
            let folders = ["/usr/sbin", "/usr/bin", "/usr/local/sbin", "/usr/local/bin"];
            folders.iter().any(|folder| Path::new(folder).join(name).exists())
        };
        let root = Command::new("id").arg("-u").output().is_ok_and(|output| output.stdout == b"0\n");
        let all = root && ["slurmctld", "slurmd", "munged", "sbatch"].iter().all(|name| there(name));
        let start =
            || Some(Loopback { folder: tempfile::tempdir().unwrap() }).filter(|loopback| loopback.script("start"));
        let loopback = if all { start() } else { None };
        if loopback.is_none() {
            assert!(std::env::var_os("KILN_REQUIRE_SLURM").is_none(), "Slurm does not start");
            eprintln!("skipped: needs slurm-wlm and munge, root to start them, and ports for two nodes");
        }
        loopback
    }

    fn script(&self, what: &str) -> bool {
        let mut command = Command::new("sh");
        command.arg(repository("tests/slurm/loopback.sh").canonicalize().unwrap()).arg(what).arg(self.folder.path());
        command.current_dir("/").stdin(std::process::Stdio::null()).stdout(std::process::Stdio::null());
        command.status().unwrap().success()
    }
}

impl Drop for Loopback {
    fn drop(&mut self) {
        self.script("stop");
    }
}

#[test]
fn slurm_itself_builds_four_assets_on_two_nodes() {
    let Some(loopback) = Loopback::start() else { return };
    let space = models(4);
    space.write("models/m3.gltf", "{}");
    space.write("config.toml", "");
    let mut command = space.command(["build", "pipeline.toml", "--backend", "cpu", "--on", "slurm"]);
    command.env("SLURM_CONF", loopback.folder.path().join("slurm.conf")).env("KILN_CONFIG", space.path("config.toml"));
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("0 of 20 stages ran"), "all ran on the nodes: {said}");
    assert!(said.contains("models/m3.gltf, stage import") && said.contains("| error: m3.gltf / import:"), "{said}");
    let mut all = expected(4);
    all.remove("m3.kiln");
    assert_eq!(containers(&space), all);
}
