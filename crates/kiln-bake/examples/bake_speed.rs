//! Seconds and texels per second of an object-space normal bake, high 69,300 triangles onto low 1,000, by thread count.
//!
//! `cargo run --release -p kiln-bake --example bake_speed -- [SIZE] [gpu]`; the median of 5 runs, atlas not counted.

use std::error::Error;
use std::f32::consts::TAU;
use std::time::Instant;

use glam::Vec3;
use kiln_asset::{Level, LodSet, MapRole, MaterialSet, Mesh, RawMesh, Submesh, SubmeshId};
use kiln_bake::atlas::{AtlasOptions, Uvunwrap, unwrap};
use kiln_bake::transfer::{Backend, BakeInput, BakeOptions, Directions, NormalSpace, bake, find_hits};
use kiln_geom::math::{cos, sin};

/// A closed torus of `2 * columns * rows` triangles, radii 1 and 0.4, the tube `bump` thicker and thinner in waves.
fn torus(columns: u32, rows: u32, bump: f32) -> Result<Mesh, Box<dyn Error>> {
    let place = |u: f32, v: f32| {
        let (a, b) = (u * TAU, v * TAU);
        let r = 0.4 + bump * sin(12.0 * a) * sin(5.0 * b);
        Vec3::new((1.0 + r * cos(b)) * cos(a), r * sin(b), -(1.0 + r * cos(b)) * sin(a))
    };
    let mut raw =
        RawMesh { submeshes: vec![Submesh { name: "torus".into(), ..Submesh::default() }], ..RawMesh::default() };
    let mut normals = Vec::new();
    for j in 0..rows {
        for i in 0..columns {
            let (u, v, e) = (i as f32 / columns as f32, j as f32 / rows as f32, 1e-3);
            raw.positions.push(place(u, v));
            normals.push((place(u + e, v) - place(u - e, v)).cross(place(u, v + e) - place(u, v - e)).normalize());
            let at = |i: u32, j: u32| j % rows * columns + i % columns;
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1));
            raw.triangles.extend([[a, b, d], [a, d, c]]);
        }
    }
    raw.normals = Some(normals);
    raw.face_submesh = vec![SubmeshId(0); raw.triangles.len()];
    Ok(Mesh::new(raw)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let size = arguments.iter().find_map(|a| a.parse().ok()).unwrap_or(1024);
    let gpu = if arguments.iter().any(|a| a == "gpu") { Some(kiln_gpu::Gpu::open(true)?) } else { None };
    let backend = || gpu.as_ref().map_or(Backend::Cpu, Backend::Gpu);
    let high = torus(275, 126, 0.03)?;
    let level = Level { mesh: torus(50, 10, 0.0)?, ..Level::default() };
    let atlas = AtlasOptions { size, padding: 8, ..AtlasOptions::default() };
    let (level, layout, _) = unwrap(&level, &atlas, &Uvunwrap::default())?;
    let low = LodSet { source_triangles: high.face_count() as u32, layout: Some(layout), levels: vec![level] };
    let set = MaterialSet::default();
    let input = || BakeInput { high: &high, low: &low, materials: &set, images: &|_| Err(String::new()), cage: None };
    let reach = Some(0.02 * high.diagonal());
    let directions = if arguments.iter().any(|a| a == "face") { Directions::Face } else { Directions::Smooth };
    for threads in [1, 2] {
        let options = BakeOptions {
            maps: vec![MapRole::Normal],
            space: NormalSpace::Object,
            size,
            directions,
            front: reach,
            back: reach,
            ..BakeOptions::default()
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
        let mut seconds = Vec::new();
        let mut hit_seconds = Vec::new();
        let mut report = None;
        for _ in 0..5 {
            let start = Instant::now();
            pool.install(|| find_hits(&input(), &options, backend()).map(|_| ()))?;
            hit_seconds.push(start.elapsed().as_secs_f64());
            let start = Instant::now();
            let out = pool.install(|| bake(&input(), &options, backend()))?;
            seconds.push(start.elapsed().as_secs_f64());
            report = Some(out.report);
        }
        seconds.sort_by(f64::total_cmp);
        hit_seconds.sort_by(f64::total_cmp);
        let megatexels = size as f64 * size as f64 / 1e6;
        eprintln!(
            "{directions:?} {} -> {} triangles, {size} x {size}, {threads} threads: {:.3} s ({:.3}-{:.3}; hits alone {:.3}), {:.2} Mtexel/s of the whole map",
            high.face_count(),
            low.levels[0].mesh.face_count(),
            seconds[2],
            seconds[0],
            seconds[4],
            hit_seconds[2],
            megatexels / seconds[2],
        );
        eprintln!("{report:?}");
    }
    Ok(())
}
