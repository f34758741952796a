//! Containers: how long it takes to open, check and decode one, raw and coded.
//!
//! `cargo run --release -p kiln-bench --bin container -- [MEGABYTES]`
//!
//! The model is made here: a bumpy sphere of positions, normals and 32-bit indices at three levels of detail, row by row, so that
//! the raw file has about the wanted size (100 MB). Times are the least of fifteen runs on warm memory: other
//! processes only add to them; where one thread works alone, what it computed is counted, not what passed. `validate` starts from
//! fresh tables: it decodes (on two threads, if there are) and checks; the ratio is that to one BLAKE3 pass over the file on one
//! thread. Decoding alone is on one and on two threads.

use std::fmt::Write as _;
use std::io::Write as _;
use std::time::Instant;

use kiln_format::{
    AlignedBytes, Container, Content, ErrorKind, FormatError, LevelContent, Packing, Semantic, SubmeshContent, write,
};

const RUNS: usize = 15;

/// A level's arrays.
struct Level {
    positions: Vec<[f32; 3]>,
    normals: Vec<[f32; 3]>,
    indices: Vec<u32>,
}

/// A sphere of `side` x `side` vertices, rows from pole to pole, with bumps of 1 percent in two frequencies.
fn sphere(side: u32) -> Level {
    let at = |i: u32, k: u32| {
        let (u, v) =
            (k as f32 / side as f32 * std::f32::consts::TAU, i as f32 / (side - 1) as f32 * std::f32::consts::PI);
        let radius = 1.0 + 0.01 * (9.0 * u).sin() * (7.0 * v).sin() + 0.002 * (61.0 * u + 37.0 * v).sin();
        [radius * v.sin() * u.cos(), radius * v.cos(), radius * v.sin() * u.sin()]
    };
    let positions: Vec<[f32; 3]> = (0..side * side).map(|p| at(p / side, p % side)).collect();
    let normals = positions.iter().map(|p| {
        let length = p.iter().map(|x| x * x).sum::<f32>().sqrt();
        p.map(|x| x / length)
    });
    let normals = normals.collect();
    let quads = (0..side - 1).flat_map(|i| (0..side).map(move |k| (i, k)));
    let corners = quads.flat_map(|(i, k)| {
        let [a, b, c, d] =
            [(i, k), (i, (k + 1) % side), (i + 1, k), (i + 1, (k + 1) % side)].map(|(i, k)| i * side + k);
        [a, b, c, c, b, d]
    });
    Level { positions, normals, indices: corners.collect() }
}

fn content(level: &Level, lod: usize) -> LevelContent<'_> {
    let arrays = vec![(Semantic::Positions, as_bytes(&level.positions)), (Semantic::Normals, as_bytes(&level.normals))];
    LevelContent {
        error: lod as f32 * 0.001,
        error_kind: ErrorKind::Sampled,
        arrays,
        indices: &level.indices,
        index_counts: vec![level.indices.len() as u32],
        shares_vertices: false,
    }
}

fn packed(levels: &[Level], packing: Packing) -> Result<Vec<u8>, FormatError> {
    let submesh = SubmeshContent { name: "sphere".into(), material: None, attributes: 6, source_triangles: 1 };
    let levels = levels.iter().enumerate().map(|(lod, level)| content(level, lod)).collect();
    write(&Content { source_triangles: 1, levels, submeshes: vec![submesh], packing, ..Content::default() })
}

fn as_bytes(values: &[[f32; 3]]) -> &[u8] {
    bytemuck::cast_slice(values)
}

/// Milliseconds that this thread has computed, where the system tells; they are the same on a busy machine, nearly.
fn computed() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    stat.split(' ').next()?.parse::<f64>().ok().map(|nanoseconds| nanoseconds * 1e-6)
}

/// Least milliseconds: computed by this thread if it is `alone`, else passed.
fn least<S>(alone: bool, prepare: impl Fn() -> S, run: impl Fn(&S)) -> f64 {
    let times = (0..RUNS).map(|_| {
        let state = prepare();
        let (start, before) = (Instant::now(), computed());
        run(&state);
        let passed = start.elapsed().as_secs_f64() * 1e3;
        let own = before.zip(computed()).map(|(before, after)| after - before);
        own.filter(|own| alone && *own > 0.0).unwrap_or(passed)
    });
    times.fold(f64::INFINITY, f64::min)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let megabytes: f64 = std::env::args().nth(1).map_or(Ok(100.0), |arg| arg.parse())?;
    // 48 bytes a vertex with two triangles; a quarter and a sixteenth more for the coarser levels.
    let side = (megabytes * 1e6 / 48.0 / 1.3125).sqrt() as u32;
    let levels: Vec<Level> = [1, 2, 4].map(|divisor| sphere(side / divisor)).into();
    let triangles: usize = levels.iter().map(|level| level.indices.len() / 3).sum();
    let mut out = String::new();
    writeln!(
        out,
        "| packing | MB | bytes a triangle | open_tables ms | BLAKE3 once ms | validate ms | validate / BLAKE3 | decode, 1 thread ms | 2 threads ms |"
    )?;
    writeln!(out, "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")?;
    for (name, packing) in [("raw", Packing::Raw), ("meshopt", Packing::Meshopt), ("zstd", Packing::Zstd)] {
        let bytes = AlignedBytes::copy_of(&packed(&levels, packing)?);
        let tables = || Container::open_tables(&bytes);
        let open = least(false, || (), |()| drop(std::hint::black_box(tables())));
        let hash = least(
            true,
            || (),
            |()| {
                std::hint::black_box(blake3::hash(&bytes));
            },
        );
        let validate = least(packing == Packing::Raw, tables, |container| {
            let sound = container.as_ref().is_ok_and(|container| container.validate().is_ok());
            assert!(sound, "what was written is valid");
        });
        let decode = |threads| {
            least(threads == 1, tables, |container| {
                if let Ok(container) = container {
                    container.decode(threads);
                }
            })
        };
        let decode = match packing {
            Packing::Raw => "- | -".into(),
            _ => format!("{:.1} | {:.1}", decode(1), decode(2)),
        };
        let (size, each) = (bytes.len() as f64 / 1e6, bytes.len() as f64 / triangles as f64);
        let ratio = validate / hash;
        writeln!(
            out,
            "| {name} | {size:.1} | {each:.2} | {open:.3} | {hash:.1} | {validate:.1} | {ratio:.2} | {decode} |"
        )?;
    }
    writeln!(out, "\n{triangles} triangles in {} levels.", levels.len())?;
    std::io::stdout().write_all(out.as_bytes())?;
    Ok(())
}
