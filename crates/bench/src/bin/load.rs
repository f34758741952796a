//! Loading a chain of levels: kiln's containers beside a GLB of the same levels, as it is and through gltfpack.
//!
//! `cargo run --release -p kiln-bench --bin load -- MODEL... [--gltfpack CLI.js] [--folder DIR] [--runs N] [--out FILE.md]`
//!
//! The levels are 100, 50, 25, 10 and 1 % of the triangles by half-edge collapses, positions and smooth normals, floats, lossless. Files lie
//! in `--folder` (the system's for temporary files) and in the cache of the machine; a load reads or maps the file and ends when all
//! vertices and indices lie decoded in memory. gltfpack is asked for lossless floats (`-noq -c`); its decoder is meshoptimizer's own,
//! called on each buffer view, on one thread and on two. *First triangles*: until the coarsest level's vertices and indices are at hand.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Instant;

use kiln_asset::{Level, LodSet, MaterialSet, Mesh, RawMesh, Submesh, SubmeshId};
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{middle, model, name, positions_only};
use kiln_format::{AlignedBytes, Container, Provenance};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::normals::smooth;
use kiln_lod::simplify::{SimplifyOptions, collapse};
use kiln_pack::{Compression, Continuous, ExportLevels, PackOptions, Vertices, export_glb, pack};
use kiln_runtime::MappedFile;

const SHARES: [f64; 5] = [1.0, 0.5, 0.25, 0.1, 0.01];

struct Arguments {
    models: Vec<PathBuf>,
    gltfpack: Option<PathBuf>,
    folder: PathBuf,
    runs: usize,
    out: Option<PathBuf>,
}

fn main() -> ExitCode {
    let folder = std::env::temp_dir();
    let mut given = Arguments { models: Vec::new(), gltfpack: None, folder, runs: 9, out: None };
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--gltfpack" => given.gltfpack = args.next().map(PathBuf::from),
            "--folder" => given.folder = args.next().map_or(given.folder, PathBuf::from),
            "--runs" => given.runs = args.next().and_then(|v| v.parse().ok()).unwrap_or(given.runs).max(1),
            "--out" => given.out = args.next().map(PathBuf::from),
            _ => given.models.push(PathBuf::from(arg)),
        }
    }
    if given.models.is_empty() {
        eprintln!("usage: load MODEL... [--gltfpack CLI.js] [--folder DIR] [--runs N] [--out FILE.md]");
        return ExitCode::from(64);
    }
    match run(&given) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(given: &Arguments) -> Result<(), String> {
    let mut page = Page::new(given.out.clone());
    page.line("# Loading a chain of levels");
    page.line("");
    page.line(&stamp("cargo run --release -p kiln-bench --bin load -- MODEL... --gltfpack CLI.js"));
    page.line("");
    page.line(&format!(
        "Levels of 100, 50, 25, 10 and 1 % by half-edge collapses; positions and normals as floats, lossless; median of {} loads of a file in \
         the machine's cache, milliseconds. *Open*: header, tables. *Validate*: every hash and every check. *Load*: all vertices and indices \
         decoded in memory, unvalidated as gltfpack's are.",
        given.runs
    ));
    for path in &given.models {
        chain(path, given, &mut page)?;
    }
    page.finish()
}

fn chain(path: &Path, given: &Arguments, page: &mut Page) -> Result<(), String> {
    let failed = |e: String| format!("{}: {e}", path.display());
    let (merged, _) = merge(&model(path).map_err(failed)?.mesh, &MergeOptions::default());
    let mesh = smooth(&positions_only(&merged).map_err(failed)?);
    let sequence = collapse(&mesh, &[], None, &SimplifyOptions::default());
    let mut levels = Vec::new();
    for (k, share) in SHARES.iter().enumerate() {
        let cut = sequence.reach((share * mesh.face_count() as f64) as u32);
        let mesh = sequence.replay(&mesh, cut).map_err(|e| e.to_string())?;
        levels.push(Level { mesh, error: k as f32, quadrics: Vec::new() });
    }
    let triangles: usize = levels.iter().map(|level| level.mesh.face_count()).sum();
    let set = LodSet { levels, layout: None, source_triangles: mesh.face_count() as u32 };
    page.line("");
    page.line(&format!("## {}, {} triangles in all levels", name(path), triangles));
    page.line("");
    page.head(&[
        "file",
        ":bytes",
        ":bytes a triangle",
        ":open",
        ":first triangles",
        ":load, 1 thread",
        ":2 threads",
        ":validate",
        ":hash once",
    ]);
    let forms = [
        ("container", Vertices::Own, Compression::None),
        ("container, shared vertices", Vertices::Shared, Compression::None),
        ("container, meshopt", Vertices::Own, Compression::Meshopt),
        ("container, meshopt, shared", Vertices::Shared, Compression::Meshopt),
        ("container, zstd", Vertices::Own, Compression::Zstd),
    ];
    for (what, vertices, compression) in forms {
        let options = PackOptions { vertices, compression, ..PackOptions::default() };
        let images = |_| Err("none".to_owned());
        let packed =
            pack(&set, &MaterialSet::default(), &images, &Provenance::default(), &options, &Continuous::default());
        let (bytes, _) = packed.map_err(|e| failed(e.to_string()))?;
        let file = given.folder.join("kiln-load.kiln");
        fs::write(&file, &bytes).map_err(|e| format!("{}: {e}", file.display()))?;
        container(what, &file, triangles, given.runs, page)?;
        let _ = fs::remove_file(&file);
    }
    peers(&set, triangles, given, page)
}

/// Median of the milliseconds of `runs` calls.
fn time<T>(runs: usize, mut work: impl FnMut() -> Result<T, String>) -> Result<f64, String> {
    work()?;
    let mut seconds = Vec::with_capacity(runs);
    for _ in 0..runs {
        let start = Instant::now();
        let kept = work()?;
        seconds.push(start.elapsed().as_secs_f64());
        drop(kept);
    }
    Ok(1e3 * middle(seconds))
}

/// One byte of every 64: what an upload would read.
fn touched(bytes: &[u8]) -> u64 {
    bytes.iter().step_by(64).map(|b| u64::from(*b)).sum()
}

fn level_sum(container: &Container<'_>, lod: usize) -> u64 {
    let Some(level) = container.level(lod) else { return 0 };
    let normals = level.normals().map_or(0, |n| touched(bytemuck::cast_slice(n)));
    touched(bytemuck::cast_slice(level.positions())) + normals + touched(level.indices().bytes())
}

#[allow(unsafe_code, reason = "nobody changes the file while it is mapped: this program wrote it and alone knows it")]
fn mapped(file: &Path) -> Result<MappedFile, String> {
    // Safety: as above.
    unsafe { MappedFile::open(file) }.map_err(|e| format!("{}: {e}", file.display()))
}

fn container(what: &str, file: &Path, triangles: usize, runs: usize, page: &mut Page) -> Result<(), String> {
    let sound = |e: kiln_format::FormatError| e.to_string();
    let length = fs::metadata(file).map_err(|e| e.to_string())?.len();
    let open = time(runs, || {
        let map = mapped(file)?;
        let container = Container::open_tables(&map).map_err(sound)?;
        Ok(container.level(0).map_or(0, |level| level.record.triangles))
    })?;
    let load = |threads: usize| {
        time(runs, || {
            let map = mapped(file)?;
            let container = Container::open_tables(&map).map_err(sound)?;
            container.decode(threads);
            Ok((0..SHARES.len()).map(|lod| level_sum(&container, lod)).sum::<u64>())
        })
    };
    let first = time(runs, || {
        let map = mapped(file)?;
        let container = Container::open_tables(&map).map_err(sound)?;
        Ok(level_sum(&container, SHARES.len() - 1))
    })?;
    let (one, two) = (load(1)?, load(2)?);
    let bytes = AlignedBytes::copy_of(&fs::read(file).map_err(|e| e.to_string())?);
    let validate = time(runs, || {
        let container = Container::open_tables(&bytes).map_err(sound)?;
        container.validate().map_err(sound)
    })?;
    let hash = time(runs, || Ok(blake3::hash(&bytes)))?;
    row(page, what, length, triangles, [Some(open), Some(first), Some(one), Some(two), Some(validate), Some(hash)]);
    Ok(())
}

fn row(page: &mut Page, what: &str, bytes: u64, triangles: usize, times: [Option<f64>; 6]) {
    let mut cells = vec![what.to_owned(), bytes.to_string(), format!("{:.2}", bytes as f64 / triangles as f64)];
    cells.extend(times.map(|ms| ms.map_or_else(|| "-".into(), |ms| format!("{ms:.3}"))));
    page.row(&cells);
}

/// The levels as submeshes of one mesh: one primitive each.
fn beside(set: &LodSet) -> Result<LodSet, String> {
    let mut raw = RawMesh { normals: Some(Vec::new()), ..RawMesh::default() };
    for (k, level) in set.levels.iter().enumerate() {
        let first = raw.positions.len() as u32;
        raw.positions.extend_from_slice(&level.mesh.positions);
        raw.normals.iter_mut().for_each(|n| n.extend_from_slice(level.mesh.normals.as_deref().unwrap_or_default()));
        raw.triangles.extend(level.mesh.triangles.iter().map(|t| t.map(|v| v + first)));
        raw.face_submesh.resize(raw.triangles.len(), SubmeshId(k as u32));
        let attributes = level.mesh.submeshes[0].attributes;
        raw.submeshes.push(Submesh { name: format!("level {k}"), attributes, ..Submesh::default() });
    }
    let mesh = Mesh::new(raw).map_err(|e| e.to_string())?;
    let level = Level { mesh, error: 0.0, quadrics: Vec::new() };
    Ok(LodSet { levels: vec![level], layout: None, source_triangles: set.source_triangles })
}

fn peers(set: &LodSet, triangles: usize, given: &Arguments, page: &mut Page) -> Result<(), String> {
    let all = beside(set)?;
    let (glb, _) = export_glb(&all, &MaterialSet::default(), &[], ExportLevels::One(0)).map_err(|e| e.to_string())?;
    let file = given.folder.join("kiln-load.glb");
    fs::write(&file, &glb).map_err(|e| format!("{}: {e}", file.display()))?;
    let read = time(given.runs, || {
        let bytes = fs::read(&file).map_err(|e| e.to_string())?;
        let found = Glb::new(&bytes)?;
        Ok(found.views.iter().map(|view| view.source.to_vec().len()).sum::<usize>())
    })?;
    row(page, "GLB", glb.len() as u64, triangles, [None, None, Some(read), None, None, None]);
    if let Some(program) = &given.gltfpack {
        let packed = given.folder.join("kiln-load-packed.glb");
        let arguments = ["-noq", "-c", "-kn", "-km"].map(String::from);
        let said = Command::new("node")
            .arg(program)
            .args(arguments)
            .args(["-i".as_ref(), file.as_os_str(), "-o".as_ref(), packed.as_os_str()])
            .output()
            .map_err(|e| e.to_string())?;
        if !said.status.success() {
            return Err(format!("gltfpack: {}", String::from_utf8_lossy(&said.stderr)));
        }
        let length = fs::metadata(&packed).map_err(|e| e.to_string())?.len();
        let load = |threads: usize| {
            time(given.runs, || {
                let bytes = fs::read(&packed).map_err(|e| e.to_string())?;
                Glb::new(&bytes)?.decode(threads)
            })
        };
        row(page, "gltfpack -noq -c", length, triangles, [None, None, Some(load(1)?), Some(load(2)?), None, None]);
        let _ = fs::remove_file(&packed);
    }
    let _ = fs::remove_file(&file);
    Ok(())
}

/// A GLB's buffer views as they are stored.
struct Glb<'a> {
    views: Vec<View<'a>>,
}

struct View<'a> {
    source: &'a [u8],
    /// Of a compressed view: stride, count, and whether it holds triangles.
    coded: Option<(usize, usize, bool)>,
}

impl<'a> Glb<'a> {
    fn new(bytes: &'a [u8]) -> Result<Glb<'a>, String> {
        let word = |at: usize| bytes.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
        let short = "a GLB that ends early";
        let json = word(12).ok_or(short)?;
        let text = bytes.get(20..20 + json).ok_or(short)?;
        let root: serde_json::Value = serde_json::from_slice(text).map_err(|e| e.to_string())?;
        let chunk = bytes.get(28 + json..).ok_or(short)?;
        let number = |value: &serde_json::Value| value.as_u64().unwrap_or(0) as usize;
        let mut views = Vec::new();
        for view in root["bufferViews"].as_array().into_iter().flatten() {
            let coded = ["EXT_meshopt_compression", "KHR_meshopt_compression"]
                .iter()
                .map(|name| &view["extensions"][*name])
                .find(|v| v.is_object());
            let place = coded.unwrap_or(view);
            let start = number(&place["byteOffset"]);
            let source = chunk.get(start..start + number(&place["byteLength"])).ok_or(short)?;
            let coded = coded.map(|c| (number(&c["byteStride"]), number(&c["count"]), c["mode"] == "TRIANGLES"));
            views.push(View { source, coded });
        }
        Ok(Glb { views })
    }

    /// All views decoded; the sum of one byte in 64 of each.
    fn decode(&self, threads: usize) -> Result<u64, String> {
        let next = std::sync::atomic::AtomicUsize::new(0);
        let sum = std::sync::atomic::AtomicU64::new(0);
        let work = || -> Result<(), String> {
            loop {
                let k = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                let Some(view) = self.views.get(k) else { return Ok(()) };
                let bytes = view.decode()?;
                sum.fetch_add(touched(&bytes), std::sync::atomic::Ordering::Relaxed);
            }
        };
        std::thread::scope(|scope| {
            let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
            let own = work();
            others.into_iter().try_fold((), |(), t| t.join().unwrap_or(Err("a thread died".into())))?;
            own
        })?;
        Ok(sum.into_inner())
    }
}

impl View<'_> {
    fn decode(&self) -> Result<Vec<u8>, String> {
        fn elements<const N: usize>(source: &[u8], count: usize) -> Result<Vec<u8>, String>
        where
            [u8; N]: Default,
        {
            let found = meshopt::decode_vertex_buffer::<[u8; N]>(source, count).map_err(|e| e.to_string())?;
            Ok(found.into_flattened())
        }
        match self.coded {
            None => Ok(self.source.to_vec()),
            Some((2, count, true)) => meshopt::decode_index_buffer::<u16>(self.source, count)
                .map(|v| bytemuck::cast_slice(&v).to_vec())
                .map_err(|e| e.to_string()),
            Some((_, count, true)) => meshopt::decode_index_buffer::<u32>(self.source, count)
                .map(|v| bytemuck::cast_slice(&v).to_vec())
                .map_err(|e| e.to_string()),
            Some((4, count, _)) => elements::<4>(self.source, count),
            Some((8, count, _)) => elements::<8>(self.source, count),
            Some((12, count, _)) => elements::<12>(self.source, count),
            Some((16, count, _)) => elements::<16>(self.source, count),
            Some((24, count, _)) => elements::<24>(self.source, count),
            Some((stride, ..)) => Err(format!("a stride of {stride} bytes")),
        }
    }
}
