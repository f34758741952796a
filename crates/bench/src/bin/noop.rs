//! A build without work beside ninja's, on as many files, and what one change adds.
//!
//! `cargo build --release -p kiln && cargo run --release -p kiln-bench --bin noop -- FOLDER [ASSETS] [ROUNDS]`
//!
//! Makes ASSETS (10,000) models of 4 KiB in 100 folders under FOLDER, each with three stages (merge, simplify, pack; five actions
//! with the import and the collapse) for `kiln build` and one `cp` for ninja, so that both have as many inputs and outputs. Model 0
//! has a picture of its own, models 1, 101 and 201 share one. Builds both once, waits until the files are older than the clock's
//! granularity, and times ROUNDS (15) builds without work of each, one after the other, beside a loop that only stats the files.
//! Then models and pictures change, each right after a build without work that it is compared with, and the stages that run are
//! counted. `cargo xtask long noop` writes `docs/results/noop.md` with it.

#![allow(clippy::print_stdout, reason = "the table is this program's output")]

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};
use std::{env, fs};

type Result<T> = std::result::Result<T, Box<dyn std::error::Error>>;

const PIPELINE: &str = r#"kiln = 1
[asset]
input = "models/**/*.gltf"
output = "out/{path}.kiln"
[[stage]]
id = "whole"
kind = "merge"
[[stage]]
id = "lods"
kind = "simplify"
levels = [{ keep = 1.0 }, { keep = 0.5 }]
[[stage]]
kind = "pack"
"#;

/// What one asset's stages come to.
const ALL: [&str; 5] = ["import", "whole", "lods, collapse", "lods", "pack"];

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<()> {
    let mut args = env::args().skip(1);
    let root = PathBuf::from(args.next().ok_or("noop FOLDER [ASSETS] [ROUNDS]")?);
    let assets: usize = args.next().map_or(Ok(10_000), |n| n.parse())?;
    let rounds: usize = args.next().map_or(Ok(15), |n| n.parse())?;
    if root.join(".kiln").exists() {
        return Err("FOLDER has been built in: what changes would come out of its cache".into());
    }
    fs::create_dir_all(root.join("one"))?;
    let bench = Bench { kiln: env::current_exe()?.with_file_name("kiln"), root: root.canonicalize()?, assets };
    bench.make()?;
    let start = Instant::now();
    bench.kiln(&["--keep-going"])?;
    let first = start.elapsed().as_secs_f64();
    let ninja = bench.ninja().is_ok();
    let one = Bench { kiln: bench.kiln.clone(), root: bench.root.join("one"), assets: 1 };
    one.make()?;
    one.kiln(&[])?;
    // What the first builds wrote shall not be on its way to the disk while others wait for it.
    let _ = Command::new("sync").status();
    // Files must be older than the clock's granularity before their stats say anything.
    sleep(3000);
    for bench in [&bench, &one] {
        bench.kiln(&["--depfile", "all.d"])?;
        bench.kiln(&[])?;
    }
    println!("{assets} assets of 3 stages, {} files; first build {first:.0} s; load {}\n", 2 * assets, load());
    println!("| | median ms | least | greatest |");
    println!("| --- | --: | --: | --: |");
    let mut times: [Vec<f64>; 5] = Default::default();
    for _ in 0..rounds {
        times[0].push(bench.kiln(&[])?.0);
        if ninja {
            times[1].push(bench.ninja()?);
        }
        times[2].push(bench.kiln(&["--depfile", "all.d"])?.0);
        times[3].push(bench.stats()?);
        times[4].push(one.kiln(&[])?.0);
    }
    let [of_kiln, of_ninja, with_depfile, of_stats, of_one] = times;
    let kiln = row("kiln, nothing to do", of_kiln);
    let peer = if ninja { Some(row("ninja, nothing to do", of_ninja)) } else { None };
    row("kiln with `--depfile`, nothing to do", with_depfile);
    row("a stat of each file, one thread, no more", of_stats);
    row("kiln, nothing to do for a single asset", of_one);
    bench.changes(rounds, ninja)?;
    println!();
    if let Some(peer) = peer {
        println!("- Nothing to do: kiln's median is {:.2} times ninja's.", kiln / peer);
    }
    println!("- {}", bench.shared()?);
    println!("- Peak memory of a build without work: kiln {}.", bench.peak().unwrap_or_else(|_| "?".into()));
    let mut state = Vec::new();
    for file in fs::read_dir(bench.root.join(".kiln/v1/state"))? {
        state.push(file?.metadata()?.len() / 1000);
    }
    state.sort_unstable();
    println!("- Index and build state: {} kB; a build without work reads the first.", list(&state, " kB and "));
    println!("- Load at the end: {}.", load());
    Ok(())
}

fn sleep(ms: u64) {
    std::thread::sleep(Duration::from_millis(ms));
}

/// The machine's load averages, where it tells.
fn load() -> String {
    let text = fs::read_to_string("/proc/loadavg").unwrap_or_default();
    let words: Vec<&str> = text.split(' ').take(3).collect();
    if words.len() == 3 { words.join(", ") } else { "unknown".into() }
}

fn list(numbers: &[u64], between: &str) -> String {
    numbers.iter().map(u64::to_string).collect::<Vec<_>>().join(between)
}

fn median(times: &mut [f64]) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Prints a row; gives its median.
fn row(what: &str, mut times: Vec<f64>) -> f64 {
    let median = median(&mut times);
    println!("| {what} | {median:.1} | {:.1} | {:.1} |", times[0], times[times.len() - 1]);
    median
}

/// Milliseconds, an element a round.
#[derive(Default)]
struct Changes {
    before: Vec<f64>,
    all: Vec<f64>,
    stages: Vec<f64>,
    added: Vec<f64>,
}

struct Bench {
    kiln: PathBuf,
    root: PathBuf,
    assets: usize,
}

fn model(asset: usize) -> String {
    format!("models/{:02}/{asset}.gltf", asset % 100)
}

impl Bench {
    fn make(&self) -> Result<()> {
        let mut ninja = String::from("rule cp\n  command = cp $in $out\n");
        for asset in 0..self.assets {
            let path = self.root.join(model(asset));
            fs::create_dir_all(path.parent().unwrap_or(Path::new(".")))?;
            let picture = match asset {
                0 => Some("0.png"),
                1 | 101 | 201 => Some("shared.png"),
                _ => None,
            };
            fs::write(path, gltf(asset, "new", picture))?;
            ninja.push_str(&format!("build copies/{:02}/{asset}.gltf: cp {}\n", asset % 100, model(asset)));
        }
        fs::write(self.root.join("models/00/0.png"), png(0))?;
        if self.assets > 1 {
            fs::write(self.root.join("models/01/shared.png"), png(0))?;
        }
        fs::write(self.root.join("build.ninja"), ninja)?;
        Ok(fs::write(self.root.join("pipeline.toml"), PIPELINE)?)
    }

    fn command(&self, more: &[&str]) -> Command {
        let mut command = Command::new(&self.kiln);
        command.args(["build", "pipeline.toml", "--backend", "cpu"]).args(more).current_dir(&self.root);
        command
    }

    /// A build's milliseconds and what it said.
    fn kiln(&self, more: &[&str]) -> Result<(f64, String)> {
        let mut command = self.command(more);
        let start = Instant::now();
        let output = command.output().map_err(|error| format!("{}: {error}", self.kiln.display()))?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        if output.status.success() { Ok((ms, said)) } else { Err(said.into()) }
    }

    fn ninja(&self) -> Result<f64> {
        let mut command = Command::new("ninja");
        command.args(["-j2", "--quiet"]).current_dir(&self.root).stdout(Stdio::null());
        let start = Instant::now();
        let ended = command.status()?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        if ended.success() { Ok(ms) } else { Err("ninja failed".into()) }
    }

    fn stats(&self) -> Result<f64> {
        let mut paths = Vec::new();
        for asset in 0..self.assets {
            paths.push(self.root.join(model(asset)));
            paths.push(self.root.join(format!("out/{:02}/{asset}.kiln", asset % 100)));
        }
        let start = Instant::now();
        for path in &paths {
            fs::metadata(path)?;
        }
        Ok(start.elapsed().as_secs_f64() * 1e3)
    }

    /// What a changed model and a changed picture add to a build without work.
    fn changes(&self, rounds: usize, ninja: bool) -> Result<()> {
        let mut of_model = Changes::default();
        let mut of_picture = Changes::default();
        let mut of_ninja = Vec::new();
        for round in 0..rounds {
            // Another asset each time, so that the one before has time to age.
            let number = 2 + round;
            let text = gltf(1_000_000 + round, "changed", None);
            self.changed(&mut of_model, &model(number), &model(number), &text, &ALL)?;
            if ninja {
                of_ninja.push(self.ninja()?);
            }
            let picture = png(round as u8 + 1);
            self.changed(&mut of_picture, "models/00/0.png", &model(0), &picture, &[ALL[0], ALL[4]])?;
            sleep(2500);
            self.kiln(&[])?;
        }
        for (what, changes) in [("one model changed", of_model), ("one picture changed", of_picture)] {
            let before = row(&format!("{what}: the build without work before it"), changes.before);
            row(&format!("{what}: the build, all included"), changes.all);
            row(&format!("{what}: its stages alone"), changes.stages);
            let added = row(&format!("{what}: added beside its stages"), changes.added);
            println!("| {what}: the same, of the build without work | {:.0} % | | |", added / before * 100.0);
        }
        if ninja {
            row("ninja, one input changed (copies it)", of_ninja);
        }
        Ok(())
    }

    /// A build without work, and one after the file at `path` changed, which must run `stages` of `model` and no other.
    fn changed(&self, into: &mut Changes, path: &str, model: &str, bytes: &[u8], stages: &[&str]) -> Result<()> {
        let (before, _) = self.kiln(&[])?;
        fs::write(self.root.join(path), bytes)?;
        let (all, said) = self.kiln(&[])?;
        self.expect(&said, stages.len())?;
        let report = self.command(&["--json"]).output()?;
        let report = String::from_utf8(report.stdout)?;
        let asset = report.split_once(&format!("\"{model}\"")).ok_or("the report does not name the model")?.1;
        let seconds = |stage: &&str| {
            let after = asset.split_once(&format!("\"stage\": \"{stage}\""))?.1.split_once("\"seconds\": ")?.1;
            after.split_once(',')?.0.parse::<f64>().ok()
        };
        let own = stages.iter().filter_map(seconds).sum::<f64>() * 1e3;
        into.before.push(before);
        into.all.push(all);
        into.stages.push(own);
        into.added.push(all - own - before);
        Ok(())
    }

    fn expect(&self, said: &str, stages: usize) -> Result<()> {
        let expected = format!("{stages} of {} stages ran", ALL.len() * self.assets);
        if said.contains(&expected) { Ok(()) } else { Err(format!("expected: {expected}; kiln said: {said}").into()) }
    }

    /// A picture that three models read changes.
    fn shared(&self) -> Result<String> {
        fs::write(self.root.join("models/01/shared.png"), png(200))?;
        let (_, said) = self.kiln(&[])?;
        self.expect(&said, 6)?;
        let total = ALL.len() * self.assets;
        Ok(format!("A changed picture that three models read runs 6 of {total} stages: `import` and `pack` of each."))
    }

    fn peak(&self) -> Result<String> {
        const SCRIPT: &str = "import resource, subprocess, sys\n\
            subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)\n\
            print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)";
        let of = |command: &[&str]| -> Result<String> {
            let output = Command::new("python3").args(["-c", SCRIPT]).args(command).current_dir(&self.root).output()?;
            Ok(String::from_utf8(output.stdout)?.trim().to_owned())
        };
        self.kiln(&[])?;
        let own = self.kiln.to_string_lossy();
        let kiln = of(&[&own, "build", "pipeline.toml", "--backend", "cpu"])?;
        let ninja = of(&["ninja", "--quiet"]).unwrap_or_else(|_| "?".into());
        Ok(format!("{kiln} kB, ninja {ninja} kB"))
    }
}

/// A model of 4 KiB: 8 x 8 quads in one file, made different by `name`, filled up with blanks; `picture` is its texture's file.
fn gltf(asset: usize, name: &str, picture: Option<&str>) -> Vec<u8> {
    let side = 9_u16;
    let mut bytes = Vec::new();
    for y in 0..side {
        for x in 0..side {
            let height = f32::from((x * 7 + y * 3) % 5) * 0.01 + asset as f32 * 1e-6;
            for value in [f32::from(x), height, f32::from(y)] {
                bytes.extend(value.to_le_bytes());
            }
        }
    }
    for y in 0..side - 1 {
        for x in 0..side - 1 {
            let a = y * side + x;
            for index in [a, a + side, a + 1, a + 1, a + side, a + side + 1] {
                bytes.extend(index.to_le_bytes());
            }
        }
    }
    let (points, positions) = (usize::from(side * side), usize::from(side * side) * 12);
    let (images, texture) = match picture {
        None => (String::new(), ""),
        Some(file) => (
            format!(r#""images":[{{"uri":"{file}"}}],"textures":[{{"source":0}}],"#),
            r#","pbrMetallicRoughness":{"baseColorTexture":{"index":0}}"#,
        ),
    };
    let material = format!(r#"{{"name":"{asset} {name}"{texture}}}"#);
    let mut text = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],{images}
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"material":0}}]}}],"materials":[{material}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":{points},"type":"VEC3","min":[0,0,0],"max":[8,0.05,8]}},
{{"bufferView":1,"componentType":5123,"count":{},"type":"SCALAR"}}],
"bufferViews":[{{"buffer":0,"byteLength":{positions}}},{{"buffer":0,"byteOffset":{positions},"byteLength":{}}}],
"buffers":[{{"byteLength":{},"uri":"data:application/octet-stream;base64,{}"}}]}}"#,
        (bytes.len() - positions) / 2,
        bytes.len() - positions,
        bytes.len(),
        base64(&bytes)
    );
    let missing = 4096_usize.saturating_sub(text.len());
    text.push_str(&" ".repeat(missing));
    text.into_bytes()
}

fn base64(bytes: &[u8]) -> String {
    const ALPHABET: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::new();
    for chunk in bytes.chunks(3) {
        let word = chunk.iter().fold(0_u32, |word, byte| word << 8 | u32::from(*byte)) << (8 * (3 - chunk.len()));
        for k in 0..4 {
            let sextet = (word >> (18 - 6 * k)) & 63;
            out.push(if k <= chunk.len() { ALPHABET[sextet as usize] as char } else { '=' });
        }
    }
    out
}

/// A grey picture of one pixel: an 8-bit PNG with one stored block.
fn png(grey: u8) -> Vec<u8> {
    let row = [0, grey];
    let adler = |bytes: &[u8]| {
        let (a, b) = bytes.iter().fold((1_u32, 0_u32), |(a, b), &byte| {
            let a = (a + u32::from(byte)) % 65521;
            (a, (b + a) % 65521)
        });
        b << 16 | a
    };
    let mut data = vec![0x78, 0x01, 0x01, 2, 0, 0xfd, 0xff, row[0], row[1]];
    data.extend(adler(&row).to_be_bytes());
    let mut out = b"\x89PNG\r\n\x1a\n".to_vec();
    for (kind, bytes) in [(b"IHDR", &[0, 0, 0, 1, 0, 0, 0, 1, 8, 0, 0, 0, 0][..]), (b"IDAT", &data), (b"IEND", &[])] {
        let mut chunk = kind.to_vec();
        chunk.extend_from_slice(bytes);
        out.extend((bytes.len() as u32).to_be_bytes());
        let crc = chunk.iter().fold(!0_u32, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| if crc & 1 == 1 { crc >> 1 ^ 0xedb8_8320 } else { crc >> 1 })
        });
        out.extend(chunk);
        out.extend((!crc).to_be_bytes());
    }
    out
}
