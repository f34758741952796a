//! A build without work beside ninja's, on as many files, and what one change adds.
//!
//! `cargo build --release -p kiln && cargo run --release -p kiln-bench --bin noop -- FOLDER [ASSETS] [ROUNDS]`
//!
//! Makes ASSETS (10,000) models of 4 KiB in 100 folders under FOLDER, each with three stages (merge, simplify, pack; five actions with the
//! import and the collapse) for `kiln build` and one `cp` for ninja, so that both have as many inputs and outputs; model 0 has a picture of its own. Builds both once, waits
//! until the files are older than the clock's granularity, and times ROUNDS (9) builds without work of each, alternating, beside a
//! loop that only stats the files. Then a model and a picture change, and the stages that run are counted.

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
    let rounds: usize = args.next().map_or(Ok(9), |n| n.parse())?;
    if root.join(".kiln").exists() {
        return Err("FOLDER has been built in: what changes would come out of its cache".into());
    }
    fs::create_dir_all(&root)?;
    let bench = Bench { kiln: env::current_exe()?.with_file_name("kiln"), root: root.canonicalize()?, assets };
    bench.make()?;
    let start = Instant::now();
    bench.kiln(&["--keep-going"])?;
    eprintln!("kiln, first build: {:.1} s", start.elapsed().as_secs_f64());
    let ninja = bench.ninja().is_ok();
    // What the first builds wrote shall not be on its way to the disk while others wait for it.
    let _ = Command::new("sync").status();
    // Files must be older than the clock's granularity before their stats say anything.
    std::thread::sleep(Duration::from_secs(3));
    for _ in 0..2 {
        bench.kiln(&[])?;
    }
    println!("| {assets} assets, 3 stages each, {} files | median ms | range |", 2 * assets);
    println!("| --- | --: | --: |");
    let (mut of_kiln, mut of_ninja, mut of_stat) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..rounds {
        of_kiln.push(bench.kiln(&[])?.0);
        if ninja {
            of_ninja.push(bench.ninja()?);
        }
        of_stat.push(bench.stats()?);
    }
    let kiln = row("kiln, nothing to do", of_kiln);
    if ninja {
        let ninja = row("ninja, nothing to do", of_ninja);
        println!("| kiln / ninja | {:.2} | |", kiln / ninja);
    }
    row("a stat of each file, one thread", of_stat);
    let (mut models, mut pictures) = (Vec::new(), Vec::new());
    for round in 0..rounds {
        // Another asset each time, so that the one before has time to age.
        models.push(bench.changed(&model(round + 1), &gltf(1_000_000 + round, "changed", ""), &ALL)?);
        pictures.push(bench.changed("models/00/0.png", &png(round as u8 + 1), &[ALL[0], ALL[4]])?);
        std::thread::sleep(Duration::from_millis(2500));
        bench.kiln(&[])?;
    }
    for (what, times) in [("one model changed", models), ("one picture changed", pictures)] {
        let stages = times.iter().map(|(_, stages)| *stages).sum::<f64>() / times.len() as f64;
        let all = row(&format!("{what}, stages included"), times.into_iter().map(|(ms, _)| ms).collect());
        println!("| {what}: its stages alone | {stages:.1} | |");
        println!("| {what}: adds beside them | {:+.0} % | |", (all - stages) / kiln * 100.0 - 100.0);
    }
    println!("| kiln's peak memory, nothing to do | {} kB | |", bench.peak().unwrap_or_else(|_| "?".into()));
    for file in fs::read_dir(bench.root.join(".kiln/v1/state"))? {
        let file = file?;
        println!("| state: {} | {} kB | |", file.file_name().to_string_lossy(), file.metadata()?.len() / 1000);
    }
    Ok(())
}

/// Prints a row; gives its median.
fn row(what: &str, mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    let median = times[times.len() / 2];
    println!("| {what} | {median:.1} | {:.0}-{:.0} |", times[0], times[times.len() - 1]);
    median
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
            let picture = if asset == 0 { r#""images":[{"uri":"0.png"}],"textures":[{"source":0}],"# } else { "" };
            fs::write(path, gltf(asset, "new", picture))?;
            ninja.push_str(&format!("build copies/{:02}/{asset}.gltf: cp {}\n", asset % 100, model(asset)));
        }
        fs::write(self.root.join("models/00/0.png"), png(0))?;
        fs::write(self.root.join("build.ninja"), ninja)?;
        Ok(fs::write(self.root.join("pipeline.toml"), PIPELINE)?)
    }

    /// A build's milliseconds and what it said.
    fn kiln(&self, more: &[&str]) -> Result<(f64, String)> {
        let mut command = Command::new(&self.kiln);
        command.args(["build", "pipeline.toml", "--backend", "cpu"]).args(more).current_dir(&self.root);
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

    /// Milliseconds of a build after a file changed, and of the stages that ran, which must be `stages`.
    fn changed(&self, path: &str, bytes: &[u8], stages: &[&str]) -> Result<(f64, f64)> {
        fs::write(self.root.join(path), bytes)?;
        let (ms, said) = self.kiln(&[])?;
        let expected = format!("{} of {} stages ran", stages.len(), ALL.len() * self.assets);
        if !said.contains(&expected) {
            return Err(format!("expected: {expected}; kiln said: {said}").into());
        }
        let report = Command::new(&self.kiln)
            .args(["build", "pipeline.toml", "--backend", "cpu", "--json"])
            .current_dir(&self.root)
            .output()?;
        let report = String::from_utf8(report.stdout)?;
        let model = format!("\"{}\"", path.replace(".png", ".gltf"));
        let asset = report.split_once(&model).ok_or("the report does not name the model")?.1;
        let seconds = |stage: &&str| {
            let after = asset.split_once(&format!("\"stage\": \"{stage}\""))?.1.split_once("\"seconds\": ")?.1;
            after.split_once(',')?.0.parse::<f64>().ok()
        };
        Ok((ms, stages.iter().filter_map(seconds).sum::<f64>() * 1e3))
    }

    fn peak(&self) -> Result<String> {
        const SCRIPT: &str = "import resource, subprocess, sys\n\
            subprocess.run(sys.argv[1:], stderr=subprocess.DEVNULL)\n\
            print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)";
        let output = Command::new("python3")
            .args(["-c", SCRIPT])
            .arg(&self.kiln)
            .args(["build", "pipeline.toml", "--backend", "cpu"])
            .current_dir(&self.root)
            .output()?;
        Ok(String::from_utf8(output.stdout)?.trim().to_owned())
    }
}

/// A model of 4 KiB: 8 x 8 quads in one file, made different by `name`, filled up with blanks.
fn gltf(asset: usize, name: &str, picture: &str) -> Vec<u8> {
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
    let material = match picture {
        "" => format!(r#"{{"name":"{asset} {name}"}}"#),
        _ => format!(r#"{{"name":"{asset} {name}","pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}}}}}}"#),
    };
    let mut text = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],{picture}
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
