//! `kiln compare`: every measure between two models or levels, thresholds on them, a contact sheet.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use kiln_asset::import::{ImageLimits, decode_image};
use kiln_asset::{Asset, MapRole, MaterialSet, Mesh, Raster};
use kiln_measure::compare::{CompareOptions, Comparison, ModeError, Size, compare, contact_sheet};
use kiln_measure::{Scene, encode_png};
use kiln_pack::{Detail, PackError};
use serde::Serialize;

use super::args::CompareArgs;
use super::doctor::{open, printable, refuse};
use super::progress::Bar;
use super::{complain, data, read, write};
use crate::exit::Exit;

/// All that `--json` prints.
#[derive(Serialize)]
struct Report<'a> {
    /// The reference as it was named.
    reference_file: String,
    /// The other as it was named.
    other_file: String,
    #[serde(flatten)]
    comparison: &'a Comparison,
    /// Those that were asked for.
    thresholds: &'a [Threshold],
}

/// A figure and the limit it was held against.
#[derive(Serialize)]
struct Threshold {
    /// The option's name.
    option: &'static str,
    /// What was measured, in words.
    figure: &'static str,
    limit: f64,
    measured: f64,
    held: bool,
}

/// Exit 0, 1 when a threshold is missed, 2 when an input fails, 64 for a level that is no number.
pub(super) fn run(args: &CompareArgs) -> Exit {
    match measured(args) {
        Ok(exit) | Err(exit) => exit,
    }
}

fn measured(args: &CompareArgs) -> Result<Exit, Exit> {
    let sources = [Source::named(&args.reference)?, Source::named(&args.other)?];
    let bar = Bar::new();
    bar.at(0.0, "reading");
    let [reference, other] = &sources;
    let (reference, other) = (reference.load()?, other.load()?);
    let options = CompareOptions {
        views: args.views as usize,
        size: args.size,
        samples: args.samples as usize,
        normal_maps: !args.no_normal_maps,
        ..CompareOptions::default()
    };
    let comparison = compare(&reference.scene(), &other.scene(), &options, &|share, label| bar.at(share, label))
        .map_err(|error| complain(Exit::Failed, &error.to_string()))?;
    if let Some(path) = &args.sheet {
        bar.at(1.0, "sheet");
        let sheet = contact_sheet(&reference.scene(), &other.scene(), &comparison, args.rows as usize);
        let png = encode_png(&sheet).map_err(|error| complain(Exit::Failed, &error.to_string()))?;
        write(path, &png)?;
    }
    bar.finish();
    if let Some(path) = &args.sheet {
        eprintln!("{}: {} views", path.display(), args.rows.min(args.views));
    }

    let thresholds = thresholds(args, &comparison);
    let report = Report {
        reference_file: args.reference.display().to_string(),
        other_file: args.other.display().to_string(),
        comparison: &comparison,
        thresholds: &thresholds,
    };
    let printed = data(&if args.json {
        serde_json::to_string_pretty(&report).expect("invariant: a report is plain data")
    } else {
        table(&report)
    });
    let missed: Vec<&Threshold> = thresholds.iter().filter(|threshold| !threshold.held).collect();
    for Threshold { option, figure, limit, measured, .. } in &missed {
        eprintln!("missed: {option} {limit}: {figure} is {measured:.6}");
    }
    Ok(printed.max(if missed.is_empty() { Exit::Done } else { Exit::Short }))
}

/// Where an asset lies.
enum Source {
    Model(PathBuf),
    Level { container: PathBuf, level: Detail },
}

/// An asset with the pictures that measures look at.
struct Loaded {
    mesh: Mesh,
    materials: MaterialSet,
    images: Vec<Raster>,
}

impl Source {
    fn named(name: &Path) -> Result<Source, Exit> {
        let is_container = |path: &Path| path.extension().is_some_and(|e| e.eq_ignore_ascii_case("kiln"));
        if is_container(name) {
            return Ok(Source::Level { container: name.to_path_buf(), level: Detail::Level(0) });
        }
        match name.to_str().and_then(|text| text.rsplit_once('#')) {
            Some((container, level)) if is_container(Path::new(container)) => match level.parse() {
                Ok(level) => Ok(Source::Level { container: container.into(), level }),
                Err(error) => Err(complain(Exit::Usage, &printable(&format!("{container}#{level}: {error}")))),
            },
            _ => Ok(Source::Model(name.to_path_buf())),
        }
    }

    fn load(&self) -> Result<Loaded, Exit> {
        match self {
            Source::Model(model) => {
                let (asset, _) = open(model).map_err(|error| refuse(model, &error))?;
                let Asset { mesh, materials, images } = asset;
                let images = decoded(model, &materials, &images)?;
                Ok(Loaded { mesh, materials, images })
            }
            Source::Level { container, level } => {
                let fail = |error: PackError| complain(Exit::Failed, &format!("{}: {error}", container.display()));
                let unpacked = kiln_pack::unpack_detail(&read(container)?, *level).map_err(fail)?;
                let (mut levels, materials, images) = unpacked;
                Ok(Loaded { mesh: levels.levels.swap_remove(0).mesh, materials, images })
            }
        }
    }
}

/// The pictures of the maps that are drawn; the others stay empty.
fn decoded(model: &Path, materials: &MaterialSet, images: &[impl AsRef<[u8]>]) -> Result<Vec<Raster>, Exit> {
    let mut wanted = vec![false; images.len()];
    for reference in materials.materials.iter().flat_map(|m| MapRole::ALL.map(|role| m.map(role))) {
        let texture = reference.and_then(|reference| materials.textures.get(reference.texture.index()));
        if let Some(wanted) = texture.and_then(|texture| wanted.get_mut(texture.image.index())) {
            *wanted = true;
        }
    }
    let infos = materials.images.iter().zip(images).zip(&wanted);
    infos
        .map(|((info, bytes), wanted)| match wanted {
            true => decode_image(info.format, bytes.as_ref(), &ImageLimits::default()).map_err(|e| refuse(model, &e)),
            false => Ok(Raster::default()),
        })
        .collect()
}

impl Loaded {
    fn scene(&self) -> Scene<'_> {
        Scene { mesh: &self.mesh, materials: &self.materials, images: &self.images }
    }
}

/// The thresholds that were asked for, each against its figure: of flat and lit the worse, over the object's pixels.
fn thresholds(args: &CompareArgs, found: &Comparison) -> Vec<Threshold> {
    let worse = |of: fn(&ModeError) -> f64| of(&found.flat).max(of(&found.lit));
    let at_most = |option, figure, limit: Option<f64>, measured: f64| {
        limit.map(|limit| Threshold { option, figure, limit, measured, held: measured <= limit })
    };
    let at_least = |option, figure, limit: Option<f64>, measured: f64| {
        limit.map(|limit| Threshold { option, figure, limit, measured, held: measured >= limit })
    };
    let longest = args.max_distance.map(|length| f64::from(length.resolve(found.distance.diagonal)));
    let least_ssim = found.flat.ssim.object.min(found.lit.ssim.object);
    [
        at_most("--max-rmse", "the RMSE of the object's pixels", args.max_rmse, worse(|m| m.rmse_object)),
        at_most("--max-distance", "the greatest distance (m)", longest, found.distance.hausdorff),
        at_most("--max-flip", "the mean FLIP of the object's pixels", args.max_flip, worse(|m| m.flip.object)),
        at_least("--min-ssim", "the mean SSIM of the object's pixels", args.min_ssim, least_ssim),
        at_least("--min-iou", "the silhouettes' IoU", args.min_iou, found.silhouette.iou),
    ]
    .into_iter()
    .flatten()
    .collect()
}

fn table(report: &Report<'_>) -> String {
    let found = report.comparison;
    let options = &found.options;
    let side = |what: &str, file: &str, size: &Size| {
        let Size { triangles, vertices, submeshes, .. } = size;
        printable(&format!("{what:<10} {file}: {triangles} triangles, {vertices} vertices, {submeshes} submeshes"))
    };
    let mut out = String::new();
    let _ = writeln!(out, "{}", side("reference", &report.reference_file, &found.reference));
    let _ = writeln!(out, "{}", side("other", &report.other_file, &found.other));
    let _ = writeln!(
        out,
        "{:<10} {} views of {} x {} pixels; {} points on each surface, {:.2e} diag apart\n",
        "by", options.views, options.size, options.size, options.samples, found.relative_spacing
    );
    let _ = writeln!(
        out,
        "{:<10} {:>8} {:>8} {:>8} {:>8} {:>7} {:>8} {:>8} {:>8} {:>8}",
        "pictures", "RMSE", "object", "both", "worst", "PSNR", "SSIM", "object", "FLIP", "object"
    );
    let modes =
        [("flat", &found.flat), ("lit", &found.lit), ("normals", &found.normals), ("material", &found.material)];
    for (name, mode) in modes {
        let ModeError { rmse, rmse_object, rmse_both, rmse_worst, psnr, ssim, flip, .. } = mode;
        let _ = writeln!(
            out,
            "{name:<10} {rmse:>8.3} {rmse_object:>8.3} {rmse_both:>8.3} {rmse_worst:>8.3} {psnr:>7.2} {:>8.5} {:>8.5} {:>8.5} {:>8.5}",
            ssim.all, ssim.object, flip.all, flip.object
        );
    }
    let outline = &found.silhouette;
    let _ = writeln!(out, "{:<10} {:>8.3}  IoU {:.5}, XOR {:.5}", "silhouette", outline.rmse, outline.iou, outline.xor);
    let percent = |code: f64| 100.0 * code / 255.0;
    let worst = found.material.per_view_both.iter().fold(0.0f64, |worst, error| worst.max(*error));
    let _ = writeln!(
        out,
        "{:<10} {:>8.3} % of full range: material, RMSE of the pixels that both cover (worst view {:.3} %); outlines {:.3} %\n",
        "surface",
        percent(found.material.rmse_both),
        percent(worst),
        100.0 * outline.xor
    );

    let (lengths, shares) = (&found.distance, &found.relative_distance);
    let _ = writeln!(out, "{:<10} {:>10} {:>10}", "distance", "diag", "m");
    for (name, share, length) in [
        ("mean", shares.mean, lengths.mean),
        ("rms", shares.rms, lengths.rms),
        ("p99", shares.p99, lengths.p99),
        ("greatest", shares.hausdorff, lengths.hausdorff),
    ] {
        let _ = writeln!(out, "{name:<10} {share:>10.2e} {length:>10.2e}");
    }
    let _ = writeln!(out, "{:<10} {:>10.3} degrees", "normals", lengths.normal_degrees);
    let (border, other) = (&found.reference.border, &found.other.border);
    let kept = found.border_kept.map_or("no border to keep".to_owned(), |kept| format!("{:.2} % kept", 100.0 * kept));
    let _ = writeln!(out, "{:<10} {kept}: {:.4e} m, now {:.4e} m", "border", border.length, other.length);
    for Threshold { option, figure, limit, measured, held } in report.thresholds {
        let verdict = if *held { "held" } else { "missed" };
        let _ = writeln!(out, "{verdict:<10} {option} {limit}: {figure} is {measured:.6}");
    }
    out
}
