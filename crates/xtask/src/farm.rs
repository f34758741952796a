//! `xtask long farm`: 100 assets through a Slurm of two nodes on this machine, a node killed half-way, and what a stage costs there.
//! Writes `docs/results/farm.md`.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use crate::long::stamp;

/// Models of the run.
const ASSETS: usize = 100;
/// Stages of each.
const STAGES: usize = 5;

/// One build.
struct Built {
    seconds: f64,
    code: i32,
    said: String,
}

/// The machine that is measured on.
struct Farm {
    kiln: PathBuf,
    root: PathBuf,
    folder: PathBuf,
}

/// Ends Slurm whatever happens.
impl Drop for Farm {
    fn drop(&mut self) {
        let _ = self.loopback("stop", &[]);
    }
}

pub(crate) fn run(root: &Path) -> Result<(), String> {
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or(root.join("target"), PathBuf::from);
    call(Command::new("cargo").args(["build", "--release", "--locked", "-p", "kiln"]).current_dir(root))?;
    let kiln = target.join("release/kiln").canonicalize().map_err(|e| e.to_string())?;
    let folder = std::env::temp_dir().join(format!("kiln-farm-{}", std::process::id()));
    let farm = Farm { kiln, root: root.to_path_buf(), folder: folder.clone() };
    let text = farm.measure();
    drop(farm);
    let _ = fs::remove_dir_all(&folder);
    let bazel = bazel(root);
    let text = format!("# Stages on other machines\n\n{}\n\n{}\n## Bazel\n\n{bazel}\n", stamp(root), text?);
    fs::write(root.join("docs/results/farm.md"), text).map_err(|e| e.to_string())
}

fn call(command: &mut Command) -> Result<String, String> {
    let output = command.stdin(Stdio::null()).output().map_err(|e| format!("{command:?}: {e}"))?;
    if output.status.success() {
        return Ok(String::from_utf8_lossy(&output.stdout).into_owned());
    }
    Err(format!("{command:?}: {}", String::from_utf8_lossy(&output.stderr)))
}

/// The containers of a project, by name.
fn containers(project: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = fs::read_dir(project.join("out")).into_iter().flatten().flatten();
    entries.filter_map(|e| Some((e.file_name().to_string_lossy().into_owned(), fs::read(e.path()).ok()?))).collect()
}

impl Farm {
    fn loopback(&self, what: &str, more: &[&str]) -> Result<String, String> {
        let mut command = Command::new("sh");
        command.arg(self.root.join("tests/slurm/loopback.sh")).arg(what).arg(self.folder.join("slurm")).args(more);
        // The daemons keep what they are given: no pipe of ours.
        command.current_dir("/").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        match command.status() {
            Ok(status) if status.success() => Ok(String::new()),
            other => Err(format!("loopback.sh {what}: {other:?}")),
        }
    }

    /// A project of `ASSETS` models with a picture each.
    fn project(&self, name: &str) -> Result<PathBuf, String> {
        let project = self.folder.join(name);
        let assets = self.root.join("examples/assets");
        let io = |e: std::io::Error| e.to_string();
        fs::create_dir_all(project.join("models")).map_err(io)?;
        fs::copy(assets.join("assets.toml"), project.join("pipeline.toml")).map_err(io)?;
        fs::write(project.join("config.toml"), "").map_err(io)?;
        for number in 0..ASSETS {
            let side = ["left", "right"][number % 2];
            let model = fs::read_to_string(assets.join(format!("models/{side}.gltf"))).map_err(io)?;
            // A name in the model that differs: no two assets share a stage's result.
            let model = model.replace(&format!("{side}.png"), &format!("m{number}.png"));
            let model = model.replace(&format!("\"{side}\""), &format!("\"m{number}\""));
            fs::write(project.join(format!("models/m{number}.gltf")), model).map_err(io)?;
            let picture = fs::read(assets.join(format!("models/{side}.png"))).map_err(io)?;
            fs::write(project.join(format!("models/m{number}.png")), picture).map_err(io)?;
        }
        Ok(project)
    }

    fn command(&self, project: &Path, more: &[&str]) -> Command {
        let mut command = Command::new(&self.kiln);
        command.args(["build", "pipeline.toml", "--backend", "cpu"]).args(more).current_dir(project);
        command.env("SLURM_CONF", self.folder.join("slurm/slurm.conf")).env("KILN_CONFIG", project.join("config.toml"));
        command.stdin(Stdio::null());
        command
    }

    fn build(&self, project: &Path, more: &[&str]) -> Result<Built, String> {
        let start = Instant::now();
        let child = self.command(project, more).stderr(Stdio::piped()).spawn().map_err(|e| e.to_string())?;
        end(child, start)
    }

    fn measure(&self) -> Result<String, String> {
        let load = fs::read_to_string("/proc/loadavg").unwrap_or_default();
        let mut text =
            format!("Load of the machine when it began: {}.\n\n", load.split(' ').next().unwrap_or_default());
        let all = ASSETS * STAGES;
        fs::create_dir_all(&self.folder).map_err(|e| e.to_string())?;
        // One core a node: as many stages at a time as the local build has.
        self.loopback("start", &["1"])?;
        let local = self.project("local")?;
        let alone = self.build(&local, &["--jobs", "2"])?;
        let expected = containers(&local);
        let command = self.one_command(&local)?;
        let _ = write!(
            text,
            "{ASSETS} assets of {STAGES} stages (models of a few triangles with a picture each, so that nearly all is overhead), two \
             nodes of one core on one machine of {} cores; Slurm {}.\n\n\
             | build | exit | wall s | ms a stage | bytes equal | s from the first result to the last |\n| --- | --: | --: | --: | --- | --: |\n\
             | local, 2 jobs | {} | {:.2} | {:.1} | - | - |\n",
            std::thread::available_parallelism().map_or(0, usize::from),
            call(Command::new("sbatch").arg("--version").env("SLURM_CONF", self.folder.join("slurm/slurm.conf")))?
                .trim()
                .trim_start_matches("slurm-wlm "),
            alone.code,
            alone.seconds,
            1e3 * alone.seconds / all as f64,
        );
        for batch in ["1", "8"] {
            eprintln!("farm: --batch {batch}");
            let project = self.project(&format!("batch{batch}"))?;
            let built = self.build(&project, &["--on", "slurm", "--batch", batch])?;
            let equal = if containers(&project) == expected { "yes" } else { "NO" };
            let _ = writeln!(
                text,
                "| `--on slurm --batch {batch}` | {} | {:.1} | {:.0} | {equal} | {:.1} |",
                built.code,
                built.seconds,
                1e3 * built.seconds / all as f64,
                written_span(&project)
            );
            if equal == "NO" {
                return Err(format!("batch {batch}: other bytes\n{}", built.said));
            }
        }
        let (submit, element) = self.of_slurm_itself()?;
        let _ = write!(
            text,
            "\nOne `kiln stage run` of a stage that is fresh: {command:.1} ms (mean of 50). `sbatch` of an array of {ASSETS}: {submit:.0} ms \
             (mean of 10). An array of {ASSETS} elements that run `true`, to its end: {:.1} s, {:.0} ms an element.\n\n## A node dies\n\n{}",
            element,
            1e3 * element / ASSETS as f64,
            self.kill(&expected)?
        );
        Ok(text)
    }

    /// Milliseconds of a stage's command that finds nothing to do.
    fn one_command(&self, project: &Path) -> Result<f64, String> {
        let start = Instant::now();
        for _ in 0..50 {
            let mut command = Command::new(&self.kiln);
            command.args([
                "stage",
                "run",
                "pipeline.toml",
                "--backend",
                "cpu",
                "--asset",
                "models/m7.gltf",
                "--stage",
                "pack",
            ]);
            call(command.current_dir(project))?;
        }
        Ok(start.elapsed().as_secs_f64() * 1e3 / 50.0)
    }

    /// Milliseconds of an `sbatch`, and seconds of an array that does nothing.
    fn of_slurm_itself(&self) -> Result<(f64, f64), String> {
        let conf = self.folder.join("slurm/slurm.conf");
        let script = self.folder.join("true.sh");
        fs::write(&script, "#!/bin/sh\ntrue\n").map_err(|e| e.to_string())?;
        let array = format!("--array=0-{}", ASSETS - 1);
        let sbatch = |more: &[&str]| {
            let mut command = Command::new("sbatch");
            command.args(["--parsable", "--output=/dev/null", &array]).args(more).arg(&script).env("SLURM_CONF", &conf);
            call(&mut command)
        };
        let start = Instant::now();
        for _ in 0..10 {
            let job = sbatch(&["--hold"])?;
            call(Command::new("scancel").arg(job.trim()).env("SLURM_CONF", &conf))?;
        }
        let submit = start.elapsed().as_secs_f64() * 1e3 / 10.0;
        let start = Instant::now();
        sbatch(&["--wait"])?;
        Ok((submit, start.elapsed().as_secs_f64()))
    }

    /// Kills the second node's daemon and what it runs when two fifths of the elements are done.
    fn kill(&self, expected: &BTreeMap<String, Vec<u8>>) -> Result<String, String> {
        eprintln!("farm: a node dies");
        let project = self.project("killed")?;
        let start = Instant::now();
        let mut child =
            self.command(&project, &["--on", "slurm"]).stderr(Stdio::piped()).spawn().map_err(|e| e.to_string())?;
        let done = || count(&project.join(".kiln/v1/slurm/0001/status"));
        while done() < ASSETS * STAGES * 2 / 5 {
            if let Some(status) = child.try_wait().map_err(|e| e.to_string())? {
                return Err(format!("the build ended before a node could be killed: {status}"));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let at = done();
        self.loopback("kill", &["node2"])?;
        let built = end(child, start)?;
        let made = containers(&project);
        let wrong = made.iter().filter(|(name, bytes)| expected.get(*name) != Some(bytes)).count();
        let missing = expected.len() - made.len();
        let named = built.said.lines().filter(|line| line.starts_with("error:")).count();
        if wrong > 0 || missing > named {
            return Err(format!("{wrong} wrong containers, {missing} missing, {named} named\n{}", built.said));
        }
        Ok(format!(
            "The daemon of the second node and all that it ran were killed (SIGKILL) when {at} of {} elements were done. Slurm took its \
             elements up again on the other node after `SlurmdTimeout` (10 s). The build ended after {:.1} s with exit code {}: {} of \
             {ASSETS} containers written, {wrong} of them with other bytes than the local build's, {missing} missing, {named} named.\n",
            ASSETS * STAGES,
            built.seconds,
            built.code,
            made.len(),
        ))
    }
}

fn end(child: Child, start: Instant) -> Result<Built, String> {
    let output = child.wait_with_output().map_err(|e| e.to_string())?;
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    Ok(Built { seconds: start.elapsed().as_secs_f64(), code: output.status.code().unwrap_or(-1), said })
}

/// Status files that are whole.
fn count(status: &Path) -> usize {
    let arrays = fs::read_dir(status).into_iter().flatten().flatten();
    let files = arrays.flat_map(|array| fs::read_dir(array.path()).into_iter().flatten().flatten());
    files.filter(|file| file.path().extension().is_none()).count()
}

/// Seconds between the first and the last status file.
fn written_span(project: &Path) -> f64 {
    let arrays = fs::read_dir(project.join(".kiln/v1/slurm/0001/status")).into_iter().flatten().flatten();
    let files = arrays.flat_map(|array| fs::read_dir(array.path()).into_iter().flatten().flatten());
    let times: Vec<_> = files.filter_map(|file| file.metadata().ok()?.modified().ok()).collect();
    match (times.iter().min(), times.iter().max()) {
        (Some(first), Some(last)) => last.duration_since(*first).unwrap_or_default().as_secs_f64(),
        _ => 0.0,
    }
}

/// What the example's test says of Bazel.
fn bazel(root: &Path) -> String {
    let mut command = Command::new("cargo");
    command.args(["test", "--release", "--locked", "-p", "kiln", "--test", "kiln-tests", "bazel", "--", "--nocapture"]);
    let output = match command.current_dir(root).output() {
        Ok(output) => output,
        Err(error) => return format!("Not run: {error}."),
    };
    let said = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    let line = said.lines().find(|line| line.starts_with("bazel: ") || line.starts_with("skipped: "));
    match line {
        Some(line) if output.status.success() => {
            let line = line.trim_start_matches("bazel: ");
            format!("`examples/bazel`, two assets of five stages and a container each: {line}.")
        }
        _ => format!("The test failed:\n\n```\n{said}\n```"),
    }
}
