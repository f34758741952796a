//! Viewpoint-driven simplification: seconds for a whole sequence, and the incremental price of a candidate beside drawing everything.
//!
//! `cargo run --release -p kiln-bench --bin viewpoint -- [--quick] [--only SECTION] [--out FILE] CORPUS`: CORPUS holds `gltf/Spot.glb` and
//! `gltf/FlightHelmet/FlightHelmet.gltf`; `--quick` leaves the helmet out, `--only spot`, `candidates` or `helmet` all but that section.
//!
//! 1. Spot to 276 triangles, 20 views of 256 x 256, by each measure, published and exact.
//! 2. The same 200 candidates at 100, 50 and 10 % of Spot's triangles, by their stars and by drawing all faces in all views; the
//!    changes of all pixel counts must be equal.
//! 3. FlightHelmet to 10 % by the entropy of regions, with peak memory.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use kiln_asset::{Asset, MapRole, Mesh, Raster};
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{base_colors, memory, model, timed};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::viewpoint::cameras::{Cameras, views};
use kiln_lod::simplify::viewpoint::regions::{RegionMap, Regions};
use kiln_lod::simplify::viewpoint::{Delta, Measure, SIZE, Study, Update, ViewCondition, ViewpointOptions};
use kiln_lod::simplify::{CollapseSequence, Conditions, Placement, SimplifyOptions, collapse_under, cut};

/// Spot's last row in the thesis.
const SPOT_LEFT: u32 = 276;
/// Seconds that the thesis gives for as many triangles, on its processor and with CUDA.
const PUBLISHED: &str = "302 s published, 244 s with CUDA";
/// Candidates of the comparison.
const CANDIDATES: usize = 200;

fn main() -> ExitCode {
    let mut corpus = None;
    let (mut quick, mut only, mut out) = (false, None, None);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--quick" => quick = true,
            "--only" => only = arguments.next(),
            "--out" => out = arguments.next().map(PathBuf::from),
            _ => corpus = Some(PathBuf::from(argument)),
        }
    }
    let Some(corpus) = corpus else {
        eprintln!("usage: viewpoint [--quick] [--only SECTION] [--out FILE] CORPUS");
        return ExitCode::from(64);
    };
    match run(&corpus, quick, only.as_deref(), out) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(corpus: &Path, quick: bool, only: Option<&str>, out: Option<PathBuf>) -> Result<(), String> {
    let mut page = Page::new(out);
    page.line("# Viewpoint-driven simplification: time");
    page.line("");
    page.line(&stamp("cargo run --release -p kiln-bench --bin viewpoint -- CORPUS"));
    page.line(&format!("{} threads.", rayon::current_num_threads()));
    let spot = Model::open(&corpus.join("gltf/Spot.glb"))?;
    let wanted = |section: &str| only.is_none_or(|only| only == section);
    if wanted("spot") {
        spot_rows(&mut page, &spot)?;
    }
    if wanted("candidates") {
        // Both ways on one thread: a candidate is the unit that the loop shares out.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().map_err(|e| e.to_string())?;
        pool.install(|| comparison(&mut page, &spot))?;
    }
    if wanted("helmet") && !quick {
        helmet(&mut page, &Model::open(&corpus.join("gltf/FlightHelmet/FlightHelmet.gltf"))?)?;
    }
    page.finish()
}

/// A model, merged, with its regions.
struct Model {
    mesh: Mesh,
    regions: Regions,
}

impl Model {
    fn open(path: &Path) -> Result<Model, String> {
        let asset = model(path)?;
        let mesh = merge(&asset.mesh, &MergeOptions::default()).0;
        let regions = colour_classes(&mesh, &asset)?;
        Ok(Model { mesh, regions })
    }
}

/// Regions by colour alone: every submesh's base colour in 4 steps a channel.
fn colour_classes(mesh: &Mesh, asset: &Asset) -> Result<Regions, String> {
    let pictures = base_colors(asset)?;
    let mut ids: BTreeMap<(usize, [u8; 3]), u32> = BTreeMap::new();
    let mut id = |key: (usize, [u8; 3])| {
        let next = ids.len() as u32 + 1;
        *ids.entry(key).or_insert(next)
    };
    let mut maps = Vec::new();
    for (s, submesh) in mesh.submeshes.iter().enumerate() {
        let material = submesh.material.and_then(|m| asset.materials.materials.get(m.index()));
        let reference = material.and_then(|m| m.map(MapRole::BaseColor)).filter(|r| r.uv_set < 2);
        let texture = reference.and_then(|r| Some((r, asset.materials.textures.get(r.texture.index())?)));
        let Some((reference, texture)) = texture else {
            maps.push(RegionMap::Whole(id((s, [0; 3]))));
            continue;
        };
        let picture: &Raster = &pictures[texture.image.index()];
        let class = |texel: &[u8; 4]| id((s, [texel[0] >> 6, texel[1] >> 6, texel[2] >> 6]));
        maps.push(RegionMap::Picture {
            width: picture.width,
            height: picture.height,
            wrap: [texture.sampler.wrap_u, texture.sampler.wrap_v],
            ids: picture.texels.iter().map(class).collect(),
            set: reference.uv_set as usize,
        });
    }
    Ok(Regions { count: ids.len() as u32 + 1, maps })
}

fn sequence(
    model: &Model,
    textured: bool,
    left: u32,
    options: ViewpointOptions,
) -> Result<(CollapseSequence, f64), String> {
    let how = SimplifyOptions { floor: f64::from(left) / model.mesh.face_count() as f64, ..SimplifyOptions::default() };
    let (sequence, seconds) = timed(|| {
        let views = views(Cameras::default(), SIZE, &model.mesh);
        let condition = ViewCondition::new(&model.mesh, &views, textured.then_some(&model.regions), options)?;
        let conditions = Conditions { views: Some(&condition), ..Conditions::default() };
        Ok(collapse_under(&model.mesh, &[], None, &how, &conditions))
    });
    sequence
        .map(|sequence| (sequence, seconds))
        .map_err(|e: kiln_lod::simplify::viewpoint::ViewpointError| e.to_string())
}

const METRICS: [(&str, bool, Measure); 4] = [
    ("viewpoint-entropy", false, Measure::Entropy),
    ("viewpoint-mutual-information", false, Measure::MutualInformation),
    ("region-entropy", true, Measure::Entropy),
    ("region-mutual-information", true, Measure::MutualInformation),
];

fn spot_rows(page: &mut Page, spot: &Model) -> Result<(), String> {
    page.line("");
    page.line(&format!("## Spot, {} triangles, 20 views of {SIZE} x {SIZE} ({PUBLISHED})", spot.mesh.face_count()));
    page.line("");
    page.head(&["metric", "update", ":triangles left", ":s"]);
    for (name, textured, measure) in METRICS {
        for update in [Update::Exact, Update::Published] {
            let options = ViewpointOptions { measure, update, ..ViewpointOptions::default() };
            let (sequence, seconds) = sequence(spot, textured, SPOT_LEFT, options)?;
            let left = sequence.report().faces_left.to_string();
            page.row(&[name, &format!("{update:?}").to_lowercase(), &left, &format!("{seconds:.2}")]);
        }
    }
    Ok(())
}

fn comparison(page: &mut Page, spot: &Model) -> Result<(), String> {
    page.line("");
    page.line(&format!("## {CANDIDATES} candidates, by their stars and by drawing everything, both on one thread"));
    page.line("");
    page.head(&["metric", ":triangles", ":star, us", ":everything, us", ":times", "equal counts"]);
    for (name, textured, measure) in METRICS {
        let options = ViewpointOptions { measure, ..ViewpointOptions::default() };
        let (sequence, _) = sequence(spot, textured, SPOT_LEFT, options)?;
        let whole = views(Cameras::default(), SIZE, &spot.mesh);
        for share in [1.0, 0.5, 0.1] {
            let faces = (share * spot.mesh.face_count() as f64) as u32;
            let level = cut(&spot.mesh, &[], &sequence, faces, Placement::HalfEdge);
            let condition = ViewCondition::new(&level, &whole, textured.then_some(&spot.regions), options)
                .map_err(|e| e.to_string())?;
            let how = SimplifyOptions::default();
            let mut study = Study::new(&level, &how, &condition);
            let all = study.candidates();
            let chosen: Vec<[u32; 2]> = (0..CANDIDATES).map(|i| all[i * all.len() / CANDIDATES]).collect();
            let (mut star, mut everything, mut equal) = (0.0, 0.0, true);
            let mut found: Vec<(f64, Vec<Delta>)> = Vec::new();
            // The first round warms up.
            for _ in 0..2 {
                (star, found) = (0.0, Vec::with_capacity(chosen.len()));
                for candidate in &chosen {
                    if !study.read(*candidate) {
                        return Err("a candidate is not legal".into());
                    }
                    let ((cost, deltas), seconds) = timed(|| {
                        let (cost, deltas) = study.price();
                        (cost, deltas.to_vec())
                    });
                    star += seconds;
                    found.push((cost, deltas));
                }
            }
            for (candidate, (cost, mut deltas)) in chosen.iter().zip(found) {
                study.read(*candidate);
                let ((drawn, expected), seconds) = timed(|| study.draw());
                everything += seconds;
                deltas.sort_unstable_by_key(|d: &Delta| (d.view, d.region));
                equal &= deltas == expected && (cost - drawn).abs() < 1e-9;
            }
            let mean = |seconds: f64| 1e6 * seconds / chosen.len() as f64;
            page.row(&[
                name,
                &level.face_count().to_string(),
                &format!("{:.1}", mean(star)),
                &format!("{:.0}", mean(everything)),
                &format!("{:.0}", everything / star),
                if equal { "yes" } else { "NO" },
            ]);
        }
    }
    Ok(())
}

fn helmet(page: &mut Page, helmet: &Model) -> Result<(), String> {
    let faces = helmet.mesh.face_count() as u32;
    page.line("");
    page.line(&format!("## FlightHelmet, {faces} triangles to 10 %, 20 views of {SIZE} x {SIZE}"));
    page.line("");
    page.head(&["metric", ":triangles left", ":s", ":MB before", ":MB peak"]);
    memory::reset_peak();
    let before = memory::now();
    let (sequence, seconds) = sequence(helmet, true, faces / 10, ViewpointOptions::default())?;
    let megabytes = |bytes: u64| format!("{:.0}", bytes as f64 / 1e6);
    let left = sequence.report().faces_left.to_string();
    page.row(&["region-entropy", &left, &format!("{seconds:.1}"), &megabytes(before), &megabytes(memory::peak())]);
    Ok(())
}
