//! `xtask long remote`: what a shared cache gives and what one in trouble costs, by the command itself, on small models made here.
//!
//! ```text
//! CI builds from nothing and sends; another machine (another folder, an empty cache) takes; the same machine again
//! through a folder, and through S3 (moto)
//! then a machine with an empty cache and a server that is dead, silent, slow, wrong: seconds beyond a build without any
//! ```

use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use serde_json::Value;
use xtask::servers::{Moto, TROUBLES, troublesome};

use crate::long::stamp;

/// Models.
const ASSETS: usize = 50;

const PIPELINE: &str = r#"
kiln = 1
[asset]
input = "models/*.obj"
output = "out/{name}.kiln"
[[stage]]
id = "whole"
kind = "merge"
[[stage]]
id = "base"
kind = "simplify"
levels = [{ keep = 0.25 }]
[[stage]]
kind = "atlas"
size = 256
padding = 4
[[stage]]
id = "lods"
kind = "simplify"
levels = [{ keep = 0.25 }, { keep = 0.1 }]
[[stage]]
kind = "bake"
high = "whole"
maps = ["normal"]
size = 256
dilation = 2
[[stage]]
kind = "pack"
"#;

/// A bumpy ball of 1056 triangles as Wavefront OBJ; each number another one.
fn ball(number: usize) -> String {
    const RINGS: usize = 12;
    const SECTORS: usize = 48;
    let mut text = String::new();
    let bump = |latitude: f64, longitude: f64| {
        1.0 + 0.1 * (longitude * (3 + number % 5) as f64).sin() * (latitude * (2 + number / 5) as f64).cos()
    };
    for ring in 0..=RINGS {
        for sector in 0..SECTORS {
            let latitude = (ring as f64 / RINGS as f64 - 0.5) * TAU / 2.0;
            let longitude = sector as f64 / SECTORS as f64 * TAU;
            // The poles are points: all their vertices lie at one place.
            let r = if ring % RINGS == 0 { 1.0 } else { bump(latitude, longitude) };
            let (x, z) = (r * latitude.cos() * longitude.cos(), r * latitude.cos() * longitude.sin());
            let _ = writeln!(text, "v {x:.6} {:.6} {z:.6}", r * latitude.sin());
        }
    }
    let vertex = |ring: usize, sector: usize| ring * SECTORS + sector % SECTORS + 1;
    for ring in 0..RINGS {
        for sector in 0..SECTORS {
            let [a, b] = [vertex(ring, sector), vertex(ring, sector + 1)];
            let [c, d] = [vertex(ring + 1, sector), vertex(ring + 1, sector + 1)];
            if ring > 0 {
                let _ = writeln!(text, "f {a} {c} {b}");
            }
            if ring + 1 < RINGS {
                let _ = writeln!(text, "f {b} {c} {d}");
            }
        }
    }
    text
}

/// The command and the folder in which everything happens.
struct Bench {
    kiln: PathBuf,
    scratch: PathBuf,
}

/// What one build came to.
struct Built {
    seconds: f64,
    report: Value,
}

impl Built {
    fn of_remote(&self, key: &str) -> u64 {
        self.report["remote"][key].as_u64().unwrap_or(0)
    }

    fn ran(&self) -> usize {
        let assets = self.report["assets"].as_array().into_iter().flatten();
        assets.flat_map(|a| a["stages"].as_array().into_iter().flatten()).filter(|s| s["state"] == "ran").count()
    }

    fn row(&self, what: &str) -> String {
        let moved = (self.of_remote("bytes_received") + self.of_remote("bytes_sent")) as f64 / 1e6;
        let (seconds, hits, sent) = (self.seconds, self.of_remote("hits"), self.of_remote("sent"));
        format!("| {what} | {seconds:.2} | {} | {hits} | {sent} | {moved:.1} |\n", self.ran())
    }
}

impl Bench {
    /// A working copy of its own, with an empty cache.
    fn machine(&self, name: &str) -> Result<PathBuf, String> {
        let folder = self.scratch.join(name);
        let _ = fs::remove_dir_all(&folder);
        let said = |error: std::io::Error| format!("{}: {error}", folder.display());
        fs::create_dir_all(folder.join("models")).map_err(said)?;
        fs::write(folder.join("pipeline.toml"), PIPELINE).map_err(said)?;
        for number in 0..ASSETS {
            fs::write(folder.join(format!("models/ball-{number:02}.obj")), ball(number)).map_err(said)?;
        }
        Ok(folder)
    }

    fn build(&self, machine: &Path, config: &str, args: &[&str]) -> Result<Built, String> {
        fs::write(machine.join("config.toml"), config).map_err(|e| e.to_string())?;
        let start = Instant::now();
        let output = Command::new(&self.kiln)
            .args(["build", "pipeline.toml", "--backend", "cpu", "--json"])
            .args(args)
            .env("KILN_CONFIG", "config.toml")
            .current_dir(machine)
            .output()
            .map_err(|e| format!("{}: {e}", self.kiln.display()))?;
        let seconds = start.elapsed().as_secs_f64();
        // 1: some ball cannot be simplified as far as asked, which is nothing to a cache.
        if !matches!(output.status.code(), Some(0 | 1)) {
            return Err(format!("{args:?}: {}", String::from_utf8_lossy(&output.stderr)));
        }
        let report = serde_json::from_slice(&output.stdout).map_err(|e| e.to_string())?;
        Ok(Built { seconds, report })
    }

    /// The rows of one kind of remote; every machine must end with the same containers.
    fn rows(&self, kind: &str, config: &str, url: &str, expected: &[Vec<u8>]) -> Result<String, String> {
        let remote = ["--remote", url];
        let ci = self.machine("ci")?;
        let sent = self.build(&ci, config, &[&remote[..], &["--remote-mode", "write"]].concat())?;
        let person = self.machine("elsewhere/person")?;
        let taken = self.build(&person, config, &remote)?;
        same(kind, &person, expected)?;
        if taken.ran() > 0 || taken.of_remote("failures") > 0 {
            return Err(format!("{kind}: the second machine ran {} stages: {}", taken.ran(), taken.report["remote"]));
        }
        let _ = fs::remove_dir_all(person.join("out"));
        let again = self.build(&person, config, &remote)?;
        let nothing = self.build(&person, config, &remote)?;
        Ok([
            sent.row(&format!("{kind}: CI, empty everything, sends")),
            taken.row(&format!("{kind}: another machine, empty cache")),
            again.row(&format!("{kind}: the same machine, outputs deleted")),
            nothing.row(&format!("{kind}: the same machine, nothing to do")),
        ]
        .concat())
    }
}

fn containers(machine: &Path) -> Result<Vec<Vec<u8>>, String> {
    let path = |number: usize| machine.join(format!("out/ball-{number:02}.kiln"));
    (0..ASSETS).map(|number| fs::read(path(number)).map_err(|e| format!("{}: {e}", path(number).display()))).collect()
}

fn same(what: &str, machine: &Path, expected: &[Vec<u8>]) -> Result<(), String> {
    if containers(machine)? == expected {
        Ok(())
    } else {
        Err(format!("{what}: other bytes than a build without a remote"))
    }
}

/// Writes `docs/results/remote.md`.
pub(crate) fn run(root: &Path) -> Result<(), String> {
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or(root.join("target"), PathBuf::from);
    let build = Command::new("cargo").args(["build", "--release", "--locked", "-p", "kiln"]).current_dir(root).status();
    if !build.is_ok_and(|status| status.success()) {
        return Err("the command did not build".into());
    }
    let bench = Bench { kiln: target.join("release/kiln"), scratch: target.join("long-remote") };
    let alone = bench.machine("alone")?;
    let mut cold: Vec<Built> = Vec::new();
    for _ in 0..3 {
        let _ = (fs::remove_dir_all(alone.join(".kiln")), fs::remove_dir_all(alone.join("out")));
        cold.push(bench.build(&alone, "", &["--remote", "off"])?);
    }
    cold.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let without = cold[1].seconds;
    let expected = containers(&alone)?;
    let stages = cold[1].ran();
    let mut text = format!(
        "# A cache that others share\n\n{} {ASSETS} bumpy balls of 1056 triangles, {stages} stages, CPU backend, on a machine that other work shares: \
         seconds are of one run (the first row: the median of three), a few of them noise.\n\n\
         | build | seconds | stages run | records taken | records sent | MB moved |\n| --- | --: | --: | --: | --: | --: |\n",
        stamp(root)
    );
    text.push_str(&cold[1].row("no remote, empty cache"));
    let share = bench.scratch.join("share");
    let _ = fs::remove_dir_all(&share);
    fs::create_dir_all(&share).map_err(|e| e.to_string())?;
    text.push_str(&bench.rows("folder", "", &share.display().to_string(), &expected)?);
    match Moto::start() {
        Some(moto) => {
            let config = format!(
                "[remote]\nsettings = {{ endpoint = 'http://127.0.0.1:{}', allow_http = 'true', region = 'us-east-1', access_key_id = 'kiln', \
                 secret_access_key = 'kiln' }}\n",
                moto.port()
            );
            text.push_str(&bench.rows("S3 (moto)", &config, "s3://kiln/studio/cache", &expected)?);
        }
        None => text.push_str("\nS3: moto_server is not installed here.\n"),
    }
    text.push_str(
        "\nEvery machine's containers are equal, byte for byte.\n\n## Servers in trouble\n\nThe same build from an empty cache with a server that does this to every \
         request, default patience (15 s lost at most, 5 s a request). Each ended as the build without one does, with one warning more, and the same bytes.\n\n\
         | server | seconds | beyond the build without one | failed requests |\n| --- | --: | --: | --: |\n",
    );
    let dead = std::net::TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr());
    let dead = format!("http://127.0.0.1:{}/cache", dead.map_err(|e| e.to_string())?.port());
    let mut servers = vec![("nobody listens", dead)];
    for (name, trouble) in TROUBLES {
        servers.push((name, troublesome(trouble).map_err(|e| e.to_string())?));
    }
    for (name, url) in servers {
        let machine = bench.machine("victim")?;
        let built = bench.build(&machine, "", &["--remote", &url])?;
        same(name, &machine, &expected)?;
        let warnings = built.report["warnings"].as_array().into_iter().flatten();
        let warnings =
            warnings.filter(|warning| warning.as_str().is_some_and(|text| text.starts_with("remote cache"))).count();
        if warnings != 1 || built.of_remote("hits") > 0 {
            return Err(format!("{name}: {warnings} warnings: {}", built.report["warnings"]));
        }
        let (seconds, failures) = (built.seconds, built.of_remote("failures"));
        let _ = writeln!(text, "| {name} | {seconds:.2} | {:.2} | {failures} |", seconds - without);
    }
    eprintln!("{text}");
    fs::write(root.join("docs/results/remote.md"), text).map_err(|e| e.to_string())
}
