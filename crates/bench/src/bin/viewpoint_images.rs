//! Image error of levels by views, beside metrics of shape: tables, and curves over the share that is kept and over alpha.
//!
//! `KILN_CORPUS=FOLDER cargo run --release -p kiln-bench --bin viewpoint_images -- [MODEL...] [--out FILE] [--alpha-most FACES]`
//!
//! Writes `docs/results/viewpoint.md` and its curves into a folder of the same name beside it. Without models: Spot, Fox, Avocado,
//! Barrel and FlightHelmet of the corpus. Curves over alpha take a sequence a place, so they are drawn for models of at most 10,000
//! faces, or as many as `--alpha-most` says.
//!
//! The error is that of P. Lindstrom and G. Turk, Image-driven simplification, 2000: root of the mean square over all pixels of 24 views
//! of 512 x 512 that no metric uses (a Fibonacci lattice; the metrics look from a dodecahedron), base colour alone, against the source.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use kiln_asset::{Asset, ImageId, Mesh, Raster};
use kiln_bench::plot::{Plot, Series};
use kiln_bench::rows::{Page, stamp};
use kiln_bench::{base_colors, memory, model, name, timed};
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::viewpoint::segmentation::segment;
use kiln_lod::simplify::viewpoint::{
    Regions, RegionsReport, SegmentationOptions, ViewKind, ViewOptions, collapse_by_views,
};
use kiln_lod::simplify::{CollapseSequence, Conditions, Placement, SimplifyOptions, collapse, cut};
use kiln_measure::render::{Mip, Picture, RenderOptions, render};
use kiln_measure::ssim::ssim;
use kiln_measure::{Camera, PixelSums, Scene, bounding_sphere, image_error};

const MODELS: [&str; 5] =
    ["Spot.glb", "Fox.glb", "Avocado/Avocado.gltf", "Barrel.glb", "FlightHelmet/FlightHelmet.gltf"];
/// Views around each model.
const VIEWS: usize = 24;
/// Pixels a side.
const SIZE: u32 = 512;
/// Shares of the curves, descending.
const SHARES: [f64; 9] = [0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1];
/// Shares of the tables and of the curves over alpha.
const TABLED: [f64; 2] = [0.5, 0.3];
const ALPHAS: [f64; 9] = [0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0];
/// Where sequences end: no share below the last is asked for.
const FLOOR: f64 = 0.1;
/// Side of the large picture that is segmented for its time.
const LARGE: u32 = 8192;

/// A way to simplify.
#[derive(Clone, Copy)]
enum Way {
    Views(ViewKind),
    /// Plane quadrics: with the slide of attributes and free placement, or neither.
    Quadric {
        full: bool,
    },
}

const WAYS: [(&str, Way); 6] = [
    ("region entropy", Way::Views(ViewKind::RegionEntropy)),
    ("region mutual information", Way::Views(ViewKind::RegionMutualInformation)),
    ("viewpoint entropy", Way::Views(ViewKind::PolygonEntropy)),
    ("viewpoint mutual information", Way::Views(ViewKind::PolygonMutualInformation)),
    ("quadric, positions, half-edge", Way::Quadric { full: false }),
    ("quadric, attributes, free", Way::Quadric { full: true }),
];

/// Which of the ways sees no texture, and which no view: what region metrics are held against.
const BLIND: [usize; 2] = [2, 4];

/// How far a level is off.
#[derive(Clone, Copy, Default)]
struct Error {
    rmse: f64,
    /// At tabled shares only: it takes longer than drawing.
    ssim: f64,
}

/// One model, every way.
struct Row {
    model: String,
    faces: usize,
    regions: RegionsReport,
    segmenting: f64,
    /// `[WAYS.len()]`: seconds and bytes of the sequence.
    costs: Vec<(f64, u64)>,
    /// `[WAYS.len()][SHARES.len()]`
    errors: Vec<Vec<Error>>,
    /// By region way, by tabled share, over alpha.
    alphas: Vec<Vec<Vec<[f64; 2]>>>,
}

fn main() -> ExitCode {
    let (mut models, mut out, mut most) = (Vec::new(), PathBuf::from("docs/results/viewpoint.md"), 10_000);
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--out" => out = args.next().map_or(out, PathBuf::from),
            "--alpha-most" => most = args.next().and_then(|v| v.parse().ok()).unwrap_or(most),
            _ => models.push(PathBuf::from(arg)),
        }
    }
    match run(models, &out, most) {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            eprintln!("{message}");
            ExitCode::FAILURE
        }
    }
}

fn run(mut models: Vec<PathBuf>, out: &Path, alpha_most: usize) -> Result<(), String> {
    if models.is_empty() {
        let corpus = std::env::var_os("KILN_CORPUS").ok_or("name models, or the corpus' folder in KILN_CORPUS")?;
        models.extend(MODELS.map(|model| Path::new(&corpus).join("gltf").join(model)));
    }
    let mut rows = Vec::new();
    for path in &models {
        eprintln!("{}", path.display());
        rows.push(row(path, alpha_most).map_err(|e| format!("{}: {e}", path.display()))?);
    }
    let folder = out.with_extension("");
    std::fs::create_dir_all(&folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    let mut page = Page::new(Some(out.to_path_buf()));
    head(&mut page);
    table(&mut page, &rows, "RMSE", |e| format!("{:.3}", e.rmse));
    verdict(&mut page, &rows);
    page.line("## Structural similarity");
    page.line("");
    page.line("Of the same pictures, over object pixels; 1 is equal. RMSE punishes a lost silhouette harshly.");
    page.line("");
    table(&mut page, &rows, "SSIM", |e| format!("{:.4}", e.ssim));
    curves(&mut page, &rows, &folder)?;
    costs(&mut page, &rows);
    page.finish()
}

fn head(page: &mut Page) {
    let SegmentationOptions { sigma, k, min_size, reach, side } = SegmentationOptions::default();
    page.line("# Image error of simplification by views");
    page.line("");
    page.line(&stamp("cargo run --release --locked -p kiln-bench --bin viewpoint_images"));
    page.line("");
    page.line(&format!(
        "RMSE over all pixels of {VIEWS} views of {SIZE} x {SIZE} that no metric uses, base colour alone, codes 0 to 255. The metrics look \
         from 20 views of 256 x 256, alpha 1, half-edge placement; regions by sigma {sigma}, k {k}, least size {min_size}, reach {reach}, side {side}."
    ));
    page.line("");
    page.line("## RMSE");
    page.line("");
}

fn table(page: &mut Page, rows: &[Row], what: &str, cell: impl Fn(&Error) -> String) {
    let mut columns = vec![format!("{what}: model, triangles"), ":kept".into()];
    columns.extend(WAYS.iter().map(|(way, _)| format!(":{way}")));
    page.head(&columns.iter().map(String::as_str).collect::<Vec<_>>());
    for row in rows {
        for share in TABLED {
            let mut cells = vec![format!("{}, {}", row.model, row.faces), format!("{:.0} %", 100.0 * share)];
            cells.extend(row.at(share).map(|e| cell(&e)));
            page.row(&cells);
        }
    }
    page.line("");
}

impl Row {
    /// What each way reached at a tabled share.
    fn at(&self, share: f64) -> impl Iterator<Item = Error> {
        let column = SHARES.iter().position(|s| *s == share).unwrap_or(0);
        self.errors.iter().map(move |errors| errors[column])
    }
}

/// On how many models the region metrics are below those that see no textures at every tabled share.
fn verdict(page: &mut Page, rows: &[Row]) {
    for (way, (name, _)) in WAYS.iter().enumerate().take(2) {
        for blind in BLIND {
            let below = |row: &&Row| {
                TABLED.iter().all(|share| {
                    let errors: Vec<Error> = row.at(*share).collect();
                    errors[way].rmse < errors[blind].rmse
                })
            };
            let models: Vec<&str> = rows.iter().filter(below).map(|row| row.model.as_str()).collect();
            page.line(&format!(
                "- {name} below {} at both shares on {} of {}: {}",
                WAYS[blind].0,
                models.len(),
                rows.len(),
                if models.is_empty() { "none".to_owned() } else { models.join(", ") }
            ));
        }
    }
    page.line("");
}

fn curves(page: &mut Page, rows: &[Row], folder: &Path) -> Result<(), String> {
    page.line("## Curves");
    page.line("");
    let place = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
    for row in rows {
        let line = |(way, errors): (&(&str, Way), &Vec<Error>)| Series {
            name: way.0.to_owned(),
            points: SHARES.iter().zip(errors).rev().map(|(share, e)| [100.0 * share, e.rmse]).collect(),
        };
        let kept = Plot {
            title: format!("{}: RMSE over the share that is kept", row.model),
            x: "triangles kept, %".into(),
            y: "RMSE, codes".into(),
            series: WAYS.iter().zip(&row.errors).map(line).collect(),
        };
        write(page, folder, &place, &format!("{}-kept.svg", row.model), &kept)?;
        if row.alphas.is_empty() {
            continue;
        }
        let series = |way: usize, k: usize| Series {
            name: format!("{}, {:.0} %", WAYS[way].0, 100.0 * TABLED[k]),
            points: row.alphas[way][k].clone(),
        };
        let alpha = Plot {
            title: format!("{}: RMSE over alpha", row.model),
            x: "alpha".into(),
            y: "RMSE, codes".into(),
            series: (0..4).map(|s| series(s % 2, s / 2)).collect(),
        };
        write(page, folder, &place, &format!("{}-alpha.svg", row.model), &alpha)?;
    }
    page.line("");
    Ok(())
}

fn write(page: &mut Page, folder: &Path, place: &str, file: &str, plot: &Plot) -> Result<(), String> {
    let path = folder.join(file);
    std::fs::write(&path, plot.to_svg()).map_err(|e| format!("{}: {e}", path.display()))?;
    page.line(&format!("![{}]({place}/{file})", plot.title));
    page.line("");
    Ok(())
}

fn costs(page: &mut Page, rows: &[Row]) {
    page.line("## Time and memory");
    page.line("");
    page.line(&format!(
        "Seconds of the collapse to {:.0} %, pictures segmented; in brackets the process' peak, MiB, with the model's pictures decoded. \
         `regions`: seconds to segment all base colours, and how many regions they gave.",
        100.0 * FLOOR
    ));
    page.line("");
    let mut columns = vec!["model, triangles".to_owned(), ":regions".into()];
    columns.extend(WAYS.iter().map(|(way, _)| format!(":{way}")));
    page.head(&columns.iter().map(String::as_str).collect::<Vec<_>>());
    for row in rows {
        let mut cells =
            vec![format!("{}, {}", row.model, row.faces), format!("{:.3} ({})", row.segmenting, row.regions.regions)];
        cells.extend(row.costs.iter().map(|(seconds, peak)| format!("{seconds:.2} ({})", peak >> 20)));
        page.row(&cells);
    }
    page.line("");
    let picture = large_picture();
    for side in [SegmentationOptions::default().side, 2048] {
        let options = SegmentationOptions { side, ..SegmentationOptions::default() };
        let (found, seconds) = timed(|| segment(&picture, false, Default::default(), &options));
        page.line(&format!(
            "- A picture of {LARGE} x {LARGE} texels, halved to {} x {}, falls into {} regions in {seconds:.2} s.",
            found.width, found.height, found.count
        ));
    }
}

/// Tiles of 256 texels in colours of their own, with grain.
fn large_picture() -> Raster {
    let hash = kiln_geom::sample::hash;
    let texel = |i: u32| {
        let (x, y) = (i % LARGE, i / LARGE);
        let tile = hash(u64::from(y / 256 * LARGE + x / 256));
        let grain = (hash(u64::from(i)) % 8) as u8;
        [0, 8, 16].map(|shift| ((tile >> shift) % 240) as u8 + grain)
    };
    let texels = (0..LARGE * LARGE).map(|i| {
        let [r, g, b] = texel(i);
        [r, g, b, 255]
    });
    Raster { width: LARGE, height: LARGE, texels: texels.collect() }
}

fn row(path: &Path, alpha_most: usize) -> Result<Row, String> {
    let asset = model(path)?;
    let images: Vec<Arc<Raster>> = base_colors(&asset)?.into_iter().map(Arc::new).collect();
    let (mesh, _) = merge(&asset.mesh, &MergeOptions::default());
    let decode = |image: ImageId| images.get(image.index()).map(Arc::clone).ok_or_else(|| format!("no image {image}"));
    let (regions, segmenting) =
        timed(|| Regions::new(&mesh, &asset.materials, &decode, &SegmentationOptions::default()));
    let (regions, report) = regions?;

    let pictures: Vec<Raster> = images.iter().map(|image| Raster::clone(image)).collect();
    let judge = Judge::new(&asset, &pictures);
    let mut found = Row {
        model: name(path),
        faces: mesh.face_count(),
        regions: report,
        segmenting,
        costs: Vec::new(),
        errors: Vec::new(),
        alphas: Vec::new(),
    };
    for (_, way) in WAYS {
        memory::reset_peak();
        let (sequence, seconds) = timed(|| sequence(&mesh, &regions, way, ViewOptions::default().alpha));
        found.costs.push((seconds, memory::peak()));
        let sequence = sequence?;
        let errors = SHARES.iter().map(|share| judge.level(&mesh, &sequence, way, *share));
        found.errors.push(errors.collect::<Result<_, _>>()?);
    }
    if mesh.face_count() <= alpha_most {
        for (_, way) in WAYS.iter().take(2) {
            let mut lines = vec![Vec::new(); TABLED.len()];
            for alpha in ALPHAS {
                let sequence = sequence(&mesh, &regions, *way, alpha)?;
                for (line, share) in lines.iter_mut().zip(TABLED) {
                    line.push([alpha, judge.level(&mesh, &sequence, *way, share)?.rmse]);
                }
            }
            found.alphas.push(lines);
        }
    }
    Ok(found)
}

/// The sequence of a way down to the floor.
fn sequence(mesh: &Mesh, regions: &Regions, way: Way, alpha: f64) -> Result<CollapseSequence, String> {
    let full = matches!(way, Way::Quadric { full: true });
    let options = SimplifyOptions { attributes: full, floor: FLOOR, ..SimplifyOptions::default() };
    match way {
        Way::Quadric { .. } => Ok(collapse(mesh, &[], None, &options)),
        Way::Views(kind) => {
            let views = ViewOptions { kind, alpha, ..ViewOptions::default() };
            collapse_by_views(mesh, &[], None, &options, &Conditions::default(), &views, regions)
                .map_err(|e| e.to_string())
        }
    }
}

/// How the source and its levels are drawn alike.
struct Judge<'a> {
    asset: &'a Asset,
    pictures: &'a [Raster],
    cameras: Vec<Camera>,
    options: RenderOptions,
    /// `[VIEWS]`
    source: Vec<Picture>,
}

impl<'a> Judge<'a> {
    fn new(asset: &'a Asset, pictures: &'a [Raster]) -> Judge<'a> {
        let sphere = bounding_sphere(&asset.mesh.positions);
        let scene = Scene { mesh: &asset.mesh, materials: &asset.materials, images: pictures };
        let standard = RenderOptions::default();
        let mip = Mip::Fixed(scene.mean_mip(sphere, SIZE * standard.supersample));
        let options = RenderOptions { width: SIZE, height: SIZE, two_sided: true, mip, ..standard };
        let mut judge = Judge { asset, pictures, cameras: Camera::views(VIEWS, sphere), options, source: Vec::new() };
        judge.source = judge.draw(&asset.mesh);
        judge
    }

    fn draw(&self, mesh: &Mesh) -> Vec<Picture> {
        let scene = Scene { mesh, materials: &self.asset.materials, images: self.pictures };
        self.cameras.iter().map(|camera| render(&scene, camera, &self.options)).collect()
    }

    /// How far the level of `mesh` with a share of its faces is off. A sequence that stops above that gives its last level.
    fn level(&self, mesh: &Mesh, sequence: &CollapseSequence, way: Way, share: f64) -> Result<Error, String> {
        let faces = (share * mesh.face_count() as f64) as u32;
        let placement = match way {
            Way::Quadric { full: true } => Placement::Free,
            _ => Placement::HalfEdge,
        };
        let level = cut(mesh, &[], sequence, faces, placement);
        if level.face_count() as u32 > faces {
            eprintln!("{} triangles where {faces} were asked", level.face_count());
        }
        let seen = self.draw(&level);
        let rmse = image_error(&self.source, &seen).map_err(|e| e.to_string())?.rmse;
        let mut sums = PixelSums::default();
        if TABLED.contains(&share) {
            for (reference, other) in self.source.iter().zip(&seen) {
                sums.merge(ssim(reference, other).map_err(|e| e.to_string())?);
            }
        }
        Ok(Error { rmse, ssim: sums.means(1.0).object })
    }
}
