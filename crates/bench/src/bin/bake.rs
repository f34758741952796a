//! A normal-map bake beside a straight per-texel ray cast with a third-party tree: seconds, texels a second, memory, agreement.
//!
//! `cargo run --release -p kiln-bench --bin bake -- MODEL [--low N] [--size N]... [--runs N] [--threads N] [--samples N] [--save FOLDER] [--out FILE]`
//!
//! MODEL is the high mesh; the low one is kiln's own level of N triangles (1,000), unwrapped. Object-space normals, outermost hits, equal
//! reach in front and behind (0.02 of the diagonal). Trees are built within the clock on both sides; dilation, which the peer does
//! not have, is off. The peer: crate `obvhs`, its two-wide tree, its rays and its triangle test, one ray a texel from the front
//! inwards until a triangle faces it; what it casts from is rasterised as kiln does. `--save` writes `low.glb`, `high.glb`, `normals.npy` (height
//! x width x 4, f32, RGB normal, A coverage) for independent bakers.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use glam::{Vec2, Vec3, Vec3A};
use kiln_asset::{ExtraMap, FaceId, Level, LodSet, MapRole, MaterialSet, Mesh};
use kiln_bake::atlas::{AtlasOptions, Uvunwrap, unwrap};
use kiln_bake::transfer::{Backend, BakeInput, BakeOptions, Depth, Directions, NormalSpace, Picture, bake};
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{memory, middle, model, name, timed};
use kiln_geom::raster::rasterise;
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::normals;
use kiln_lod::simplify::{Placement, SimplifyOptions, collapse, cut};
use kiln_pack::{ExportLevels, export_glb};
use obvhs::BvhBuildParams;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use rayon::prelude::*;

/// Reach in front and behind, share of the diagonal: what the Python reference takes by default.
const REACH: f32 = 0.02;

struct Ask {
    low: u32,
    sizes: Vec<u32>,
    runs: usize,
    threads: usize,
    samples: u32,
    save: Option<PathBuf>,
    out: Option<PathBuf>,
}

fn main() -> ExitCode {
    let mut ask = Ask { low: 1000, sizes: Vec::new(), runs: 5, threads: 1, samples: 1, save: None, out: None };
    let mut path = None;
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut number = || args.next().and_then(|v| v.parse::<u32>().ok()).unwrap_or(1).max(1);
        match arg.as_str() {
            "--low" => ask.low = number(),
            "--size" => ask.sizes.push(number()),
            "--runs" => ask.runs = number() as usize,
            "--threads" => ask.threads = number() as usize,
            "--samples" => ask.samples = number(),
            "--out" => ask.out = args.next().map(PathBuf::from),
            "--save" => ask.save = args.next().map(PathBuf::from),
            _ => path = Some(PathBuf::from(arg)),
        }
    }
    let Some(path) = path else {
        eprintln!(
            "usage: bake MODEL [--low N] [--size N]... [--runs N] [--threads N] [--samples N] [--save FOLDER] [--out FILE]"
        );
        return ExitCode::from(64);
    };
    if ask.sizes.is_empty() {
        ask.sizes.push(2048);
    }
    match rayon::ThreadPoolBuilder::new().num_threads(ask.threads).build() {
        Ok(pool) => match pool.install(|| compare(&path, &ask)) {
            Ok(()) => ExitCode::SUCCESS,
            Err(message) => {
                eprintln!("{}: {message}", path.display());
                ExitCode::FAILURE
            }
        },
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

fn compare(path: &Path, ask: &Ask) -> Result<(), String> {
    let (mesh, _) = merge(&model(path)?.mesh, &MergeOptions::default());
    let high = if mesh.normals.is_some() { mesh } else { normals::rebuild(&mesh, 180.0) };
    let sequence = collapse(&high, &[], None, &SimplifyOptions::default());
    let level = cut(&high, &[], &sequence, ask.low, Placement::Free);
    let mut page = Page::new(ask.out.clone());
    if ask.out.is_some() {
        page.line("# A bake beside a straight ray cast");
        page.line("");
        page.line(&stamp("cargo run --release -p kiln-bench --bin bake -- MODEL --out FILE"));
        page.line("");
        page.line(&format!(
            "{}: {} triangles onto {}, object-space normals, outermost hits, {} x {} samples, {} threads, median of {} runs; trees are built within \
             the clock on both sides.",
            name(path),
            high.face_count(),
            level.face_count(),
            ask.samples,
            ask.samples,
            ask.threads,
            ask.runs
        ));
        page.line("");
    }
    page.head(&[
        "size, directions",
        ":covered",
        ":s",
        ":Mtexel/s",
        ":peak MB",
        ":ray cast s",
        ":times faster",
        ":mean degrees apart",
        ":texels only one has",
    ]);
    for size in &ask.sizes {
        let atlas = AtlasOptions { size: *size, padding: 8, ..AtlasOptions::default() };
        let level = Level { mesh: normals::rebuild(&level, 180.0), ..Level::default() };
        let (level, layout, _) = unwrap(&level, &atlas, &Uvunwrap::default()).map_err(|e| e.to_string())?;
        let low = LodSet { source_triangles: high.face_count() as u32, layout: Some(layout), levels: vec![level] };
        for directions in [Directions::Face, Directions::Smooth] {
            row(&high, &low, *size, directions, ask, &mut page)?;
        }
    }
    page.finish()
}

fn row(high: &Mesh, low: &LodSet, size: u32, directions: Directions, ask: &Ask, page: &mut Page) -> Result<(), String> {
    let reach = REACH * high.diagonal();
    let options = BakeOptions {
        maps: vec![MapRole::Normal],
        space: NormalSpace::Object,
        size,
        samples: ask.samples,
        dilation: 0,
        directions,
        front: Some(reach),
        back: Some(reach),
        ..BakeOptions::default()
    };
    let set = MaterialSet::default();
    let no_images = |_| Err("no pictures".to_owned());
    let input = BakeInput { high, low, materials: &set, images: &no_images, cage: None };
    let (mut own, mut peer) = (Vec::new(), Vec::new());
    memory::reset_peak();
    let before = memory::now();
    let mut covered = 0;
    for _ in 0..ask.runs {
        let (baked, seconds) = timed(|| bake(&input, &options, Backend::Cpu));
        covered = baked.map_err(|e| e.to_string())?.report.covered;
        own.push(seconds);
    }
    let peak = memory::peak().saturating_sub(before);
    let finest = &low.levels[0].mesh;
    let mut cast = Vec::new();
    for _ in 0..ask.runs {
        let (found, seconds) = timed(|| straight(high, finest, size, directions, reach));
        (cast, _) = (found, peer.push(seconds));
    }
    // The same bake once more, in floats, to be compared.
    let exact = BakeOptions {
        maps: Vec::new(),
        extras: vec![ExtraMap::ObjectNormal, ExtraMap::Coverage],
        depth: Depth::Float,
        ..options
    };
    let baked = bake(&input, &exact, Backend::Cpu).map_err(|e| e.to_string())?;
    let deep = |k: usize| match &baked.pictures[k] {
        Picture::Deep(deep) => Ok(&deep.texels),
        Picture::Plain(_) => Err("floats were asked for".to_owned()),
    };
    let texels = deep(0)?.iter().zip(deep(1)?).map(|(n, c)| [n[0], n[1], n[2], c[0]]);
    let texels: Vec<[f32; 4]> = texels.map(|t| if t[3] > 0.0 { t } else { [0.0; 4] }).collect();
    let (mut apart, mut both, mut one) = (0.0, 0u64, 0u64);
    for (own, other) in texels.iter().zip(&cast) {
        match (own[3] > 0.99, *other != Vec3::ZERO) {
            (true, true) => {
                let own = Vec3::new(own[0], own[1], own[2]);
                apart += f64::from(own.cross(*other).length().atan2(own.dot(*other)).to_degrees());
                both += 1;
            }
            (false, false) => {}
            _ => one += 1,
        }
    }
    if let Some(folder) = &ask.save {
        save(folder, high, finest, size, directions, &texels)?;
    }
    let (own, peer) = (middle(own), middle(peer));
    let whole = f64::from(size) * f64::from(size) / 1e6;
    page.row(&[
        format!("{size}, {}", if directions == Directions::Face { "face" } else { "smooth" }),
        format!("{:.1} %", 100.0 * covered as f64 / (whole * 1e6)),
        format!("{own:.3}"),
        format!("{:.2}", whole / own),
        format!("{:.0}", peak as f64 / 1e6),
        format!("{peer:.3}"),
        format!("{:.2}", peer / own),
        format!("{:.4}", apart / both.max(1) as f64),
        one.to_string(),
    ]);
    Ok(())
}

/// `[size * size]` normals by one ray a texel; zero where nothing is hit.
fn straight(high: &Mesh, low: &Mesh, size: u32, directions: Directions, reach: f32) -> Vec<Vec3> {
    let (uv, low_normals) = (low.atlas_uv.as_deref().unwrap_or_default(), low.normals.as_deref().unwrap_or_default());
    let high_normals = high.normals.as_deref().unwrap_or_default();
    let corner = |v: u32| Vec3A::from(high.positions[v as usize]);
    let triangles: Vec<Triangle> =
        high.triangles.iter().map(|t| Triangle { v0: corner(t[0]), v1: corner(t[1]), v2: corner(t[2]) }).collect();
    let tree = build_bvh2_from_tris(&triangles, BvhBuildParams::fast_build(), &mut Duration::default());
    let mut owners = vec![u32::MAX; size as usize * size as usize];
    let mut places = vec![[0.0f32; 3]; owners.len()];
    for (face, triangle) in low.triangles.iter().enumerate() {
        let corners: [Vec2; 3] = triangle.map(|v| uv[v as usize] * size as f32);
        rasterise(corners, size, size, |x, y, bary| {
            let texel = y as usize * size as usize + x as usize;
            (owners[texel], places[texel]) = (face as u32, bary);
        });
    }
    let shoot = |(owner, bary): (&u32, &[f32; 3])| {
        if *owner == u32::MAX {
            return Vec3::ZERO;
        }
        let p = low.face_positions(FaceId(*owner));
        let place = p[0] * bary[0] + p[1] * bary[1] + p[2] * bary[2];
        let direction = match directions {
            Directions::Face => (p[1] - p[0]).cross(p[2] - p[0]).normalize(),
            _ => {
                let n = low.triangles[*owner as usize].map(|v| low_normals[v as usize]);
                (n[0] * bary[0] + n[1] * bary[1] + n[2] * bary[2]).normalize()
            }
        };
        let ray = Ray::new(Vec3A::from(place + reach * direction), Vec3A::from(-direction), 0.0, 2.0 * reach);
        let mut hit = RayHit::none();
        let found = tree.ray_traverse(ray, &mut hit, |ray, id| {
            let triangle = &triangles[tree.primitive_indices[id] as usize];
            let faces = (triangle.v1 - triangle.v0).cross(triangle.v2 - triangle.v0).dot(ray.direction) < 0.0;
            if faces { triangle.intersect(ray) } else { f32::INFINITY }
        });
        if !found {
            return Vec3::ZERO;
        }
        let face = tree.primitive_indices[hit.primitive_id as usize] as usize;
        let point = place + (reach - hit.t) * direction;
        let [a, b, c] = high.face_positions(FaceId(face as u32));
        let n = (b - a).cross(c - a);
        let whole = n.length_squared();
        let (wb, wc) = (n.dot((point - a).cross(c - a)) / whole, n.dot((b - a).cross(point - a)) / whole);
        let corners = high.triangles[face].map(|v| high_normals[v as usize]);
        (corners[0] * (1.0 - wb - wc) + corners[1] * wb + corners[2] * wc).normalize_or_zero()
    };
    owners.par_iter().zip(&places).map(shoot).collect()
}

fn save(
    folder: &Path,
    high: &Mesh,
    low: &Mesh,
    size: u32,
    directions: Directions,
    texels: &[[f32; 4]],
) -> Result<(), String> {
    std::fs::create_dir_all(folder).map_err(|e| e.to_string())?;
    let mut raw = low.clone().into_raw();
    raw.uv0 = raw.atlas_uv.take();
    raw.submeshes.iter_mut().for_each(|s| s.attributes.uv0 = true);
    let low = Mesh::new(raw).map_err(|e| e.to_string())?;
    let plain = MaterialSet { materials: vec![Default::default(); 16], ..MaterialSet::default() };
    for (name, mesh) in [("low", &low), ("high", high)] {
        let one = LodSet { levels: vec![Level { mesh: mesh.clone(), ..Level::default() }], ..LodSet::default() };
        let (bytes, _) = export_glb(&one, &plain, &[], ExportLevels::All).map_err(|e| e.to_string())?;
        std::fs::write(folder.join(format!("{name}.glb")), bytes).map_err(|e| e.to_string())?;
    }
    let file_name = if directions == Directions::Face { "face" } else { "smooth" };
    let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({size}, {size}, 4), }}");
    // The header's end is aligned to 64 bytes and is a newline.
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut file = std::fs::File::create(folder.join(format!("{file_name}.npy"))).map_err(|e| e.to_string())?;
    let mut write = |bytes: &[u8]| file.write_all(bytes).map_err(|e| e.to_string());
    write(b"\x93NUMPY\x01\x00")?;
    write(&(header.len() as u16).to_le_bytes())?;
    write(header.as_bytes())?;
    let bytes: Vec<u8> = texels.iter().flatten().flat_map(|c| c.to_le_bytes()).collect();
    write(&bytes)
}
