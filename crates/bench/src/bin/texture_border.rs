//! Image error of levels without and with the texture-border extension.
//!
//! `cargo run --release -p kiln-bench --bin texture_border -- MODEL... [--out FILE] [--sigma S] [--low L] [--high H] [--weight W]
//! [--side N]`
//!
//! Quadric metric, half-edge placement, base colour's borders. The error is that of P. Lindstrom and G. Turk, Image-driven
//! simplification, 2000: root of the mean square over all pixels of 24 views of 512 x 512, base colour alone, against the source.

#![allow(clippy::print_stdout, reason = "the table is this program's output")]

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

use kiln_asset::import::{ImageLimits, decode_image};
use kiln_asset::{Asset, ImageId, Mesh, Raster};
use kiln_bench::model;
use kiln_lod::merge::{MergeOptions, merge};
use kiln_lod::simplify::{
    BorderCost, Conditions, Placement, SimplifyOptions, TextureBorderOptions, TextureBorders, collapse, collapse_under,
    cut,
};
use kiln_measure::render::{Mip, Picture, RenderOptions, render};
use kiln_measure::{Camera, Scene, SurfaceReference, bounding_sphere, image_error};

/// Views around each model.
const VIEWS: usize = 24;
/// Pixels a side.
const SIZE: u32 = 512;
/// Shares of the triangles that are kept.
const SHARES: [f64; 2] = [0.5, 0.25];
/// Points a side for the distances.
const SAMPLES: usize = 200_000;

fn main() -> ExitCode {
    let mut options = TextureBorderOptions::default();
    let mut models = Vec::new();
    let mut out = None;
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        let mut number = || args.next().and_then(|v| v.parse::<f64>().ok());
        let known = match arg.as_str() {
            "--sigma" => number().map(|v| options.sigma = v),
            "--low" => number().map(|v| options.low = v),
            "--high" => number().map(|v| options.high = v),
            "--weight" => number().map(|v| options.weight = v),
            "--side" => number().map(|v| options.side = v as u32),
            "--out" => args.next().map(|file| out = Some(PathBuf::from(file))),
            _ => {
                models.push(PathBuf::from(arg));
                Some(())
            }
        };
        if known.is_none() {
            models.clear();
            break;
        }
    }
    if models.is_empty() {
        eprintln!(
            "usage: texture_border MODEL... [--out FILE] [--sigma S] [--low L] [--high H] [--weight W] [--side N]"
        );
        return ExitCode::from(64);
    }
    let tables = [false, true].map(|attributes| table(&models, &options, attributes));
    let text = match tables {
        [Ok(without), Ok(with)] => Ok(format!(
            "{without}\nThe same over the metric with attributes, which prices sliding textures everywhere:\n\n{with}"
        )),
        [Err(message), _] | [_, Err(message)] => Err(message),
    };
    match text {
        Ok(text) => {
            print!("{text}");
            let page = format!("{}{text}", head(&options));
            match out.map(|file| std::fs::write(&file, page).map_err(|e| format!("{}: {e}", file.display()))) {
                Some(Err(message)) => fail(&message),
                _ => ExitCode::SUCCESS,
            }
        }
        Err(message) => fail(&message),
    }
}

fn fail(message: &str) -> ExitCode {
    eprintln!("{message}");
    ExitCode::FAILURE
}

fn head(options: &TextureBorderOptions) -> String {
    let TextureBorderOptions { sigma, low, high, weight, side, .. } = options;
    format!(
        "# Texture borders: image error without and with the extension\n\n\
         Made by `cargo run --release --locked -p kiln-bench --bin texture_border -- Spot.glb FlightHelmet.gltf Barrel.glb \
         Avocado.gltf Fox.glb --out docs/results/texture-border.md` (the models of the corpus).\n\n\
         Quadric metric without UV attributes, half-edge placement, borders of the base colour (sigma {sigma}, low {low}, high \
         {high}, weight {weight}, side {side}). RMSE over all pixels of {VIEWS} views of {SIZE} x {SIZE} that no metric uses, base \
         colour alone, codes 0 to 255; mean surface distance beside it, 1e-5 diagonals, since one error never judges a level. \
         `crossed` is the share of the source's edges that cross a border. `shift` is the default, `area` the published form. Seconds \
         are those of the collapse to exhaustion, with finding the borders, pictures decoded.\n\n"
    )
}

fn table(models: &[PathBuf], options: &TextureBorderOptions, attributes: bool) -> Result<String, String> {
    let mut out = String::from(
        "| model, triangles | crossed | kept | RMSE without | shift | area | shift, change | area, change | distance without | \
         shift | area | seconds without | shift | area |\n\
         | --- | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: | --: |\n",
    );
    for path in models {
        rows(path, options, attributes, &mut out).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    Ok(out)
}

fn rows(path: &Path, options: &TextureBorderOptions, attributes: bool, out: &mut String) -> Result<(), String> {
    let asset = model(path)?;
    let images = decoded(&asset)?;
    let (mesh, _) = merge(&asset.mesh, &MergeOptions::default());
    let how = SimplifyOptions { attributes, ..SimplifyOptions::default() };
    let mut runs = vec![timed(|| collapse(&mesh, &[], None, &how))];
    let mut crossed = 0.0;
    for cost in [BorderCost::Shift, BorderCost::Area] {
        let start = Instant::now();
        let decode = |image: ImageId| Ok(Arc::clone(&images[image.index()]));
        let options = TextureBorderOptions { cost, ..options.clone() };
        let borders = TextureBorders::new(&mesh, &asset.materials, &decode, &options)?;
        let sequence =
            collapse_under(&mesh, &[], None, &how, &Conditions { borders: Some(&borders), ..Conditions::default() });
        runs.push((sequence, start.elapsed().as_secs_f64()));
        let report = borders.report(&mesh, &asset.materials);
        crossed = 100.0 * f64::from(report.affected) / f64::from(report.edges.max(1));
    }

    let pictures: Vec<Raster> = images.iter().map(|image| Raster::clone(image)).collect();
    let views = Views::new(&asset, &pictures);
    let reference = views.draw(&mesh);
    let surface = SurfaceReference::new(&mesh, SAMPLES).ok_or("a surface without area")?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    for share in SHARES {
        let faces = (share * mesh.face_count() as f64) as u32;
        let mut judged = Vec::new();
        for (sequence, _) in &runs {
            let level = cut(&mesh, &[], sequence, faces, Placement::HalfEdge);
            if level.face_count() as u32 > faces {
                return Err(format!("{} triangles where {faces} were asked", level.face_count()));
            }
            let error = image_error(&reference, &views.draw(&level)).map_err(|e| e.to_string())?;
            let distance = surface.compare(&level).ok_or("a level without area")?.in_diagonals();
            judged.push((error.rmse, 1e5 * distance.mean));
        }
        let _ = write!(out, "| {name}, {} | {crossed:.0} % | {:.0} %", mesh.face_count(), 100.0 * share);
        for (rmse, _) in &judged {
            let _ = write!(out, " | {rmse:.3}");
        }
        for (rmse, _) in &judged[1..] {
            let _ = write!(out, " | {:+.1} %", 100.0 * (rmse / judged[0].0 - 1.0));
        }
        for (_, distance) in &judged {
            let _ = write!(out, " | {distance:.1}");
        }
        for (_, seconds) in &runs {
            let _ = write!(out, " | {seconds:.3}");
        }
        out.push_str(" |\n");
    }
    Ok(())
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let start = Instant::now();
    let result = work();
    (result, start.elapsed().as_secs_f64())
}

fn decoded(asset: &Asset) -> Result<Vec<Arc<Raster>>, String> {
    let decode = |(info, bytes): (&kiln_asset::ImageInfo, &Arc<[u8]>)| {
        decode_image(info.format, bytes, &ImageLimits::default()).map(Arc::new).map_err(|e| e.to_string())
    };
    asset.materials.images.iter().zip(&asset.images).map(decode).collect()
}

/// How the source and its levels are drawn alike.
struct Views<'a> {
    asset: &'a Asset,
    pictures: &'a [Raster],
    cameras: Vec<Camera>,
    options: RenderOptions,
}

impl<'a> Views<'a> {
    fn new(asset: &'a Asset, pictures: &'a [Raster]) -> Views<'a> {
        let sphere = bounding_sphere(&asset.mesh.positions);
        let scene = Scene { mesh: &asset.mesh, materials: &asset.materials, images: pictures };
        let standard = RenderOptions::default();
        let mip = Mip::Fixed(scene.mean_mip(sphere, SIZE * standard.supersample));
        let options = RenderOptions { width: SIZE, height: SIZE, two_sided: true, mip, ..standard };
        Views { asset, pictures, cameras: Camera::views(VIEWS, sphere), options }
    }

    fn draw(&self, mesh: &Mesh) -> Vec<Picture> {
        let scene = Scene { mesh, materials: &self.asset.materials, images: self.pictures };
        self.cameras.iter().map(|camera| render(&scene, camera, &self.options)).collect()
    }
}
