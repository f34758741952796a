//! `bake`: the high mesh's surface into maps of the low mesh's atlas.

use kiln_asset::{ImageFormat, ImageId, MapRole, Mesh};
use kiln_bake::tangents::{UvSource, mikktspace};
use kiln_bake::transfer::{Backend, BakeOptions, BakeReport, HitRule, NormalSpace, bake};
use kiln_engine::{Action, ActionError, Context, Outputs, Source};
use kiln_lod::normals;
use serde::Serialize;

use super::atlas::NORMAL_ANGLE;
use super::pack::Pictures;
use super::simplify::needs_normals;
use super::{OpenBackend, StageError, json, load_images, load_levels, load_materials, params};
use crate::foreign;
use crate::language::StageSettings;
use crate::language::options::{self, MapName, Space};

/// Raised whenever the same input and parameters give other bytes.
pub(crate) const VERSION: u32 = 1;

/// Outputs: `levels`, `materials`, `image/N`.
pub(crate) fn action(
    id: String,
    label: String,
    options: &options::BakeOptions,
    low: Source,
    high: Source,
    materials: usize,
    backend: &OpenBackend,
) -> Action {
    let (own, device) = (options.clone(), backend.clone());
    let mut action = Action::new(id, "bake", VERSION, move |context| run(context, &own, &device))
        .input("low", low)
        .input("high", high)
        .input("materials", Source::output(materials, "materials"))
        .input("images", Source::outputs(materials, "image/"));
    action.label = label;
    action.params = params(&StageSettings::Bake(options.clone()), &["high"]);
    action.foreign =
        [foreign::GLAM, foreign::OBVHS, foreign::MIKKTSPACE, foreign::BASISU, foreign::IMAGE, foreign::LIBM]
            .map(Into::into)
            .into();
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    if let Some(class) = backend.device_class(crate::language::Kind::Bake) {
        action.foreign.push(foreign::WGPU.into());
        let shader = kiln_engine::ContentHash(kiln_shaders::MIRRORED_VERTEX.hash()).short();
        action.device_class = Some(format!("{class}, shader {shader}"));
    }
    action
}

/// The bake's report with what of it is soft trouble, in words.
#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    bake: BakeReport,
    warnings: Vec<String>,
}

fn run(context: &Context<'_>, options: &options::BakeOptions, backend: &OpenBackend) -> Result<Outputs, ActionError> {
    let low = load_levels(context, "low")?;
    let mut high = Mesh::from_blob(&context.input("high")?).map_err(StageError::Blob)?;
    let materials = load_materials(context, "materials")?;
    if needs_normals(&high) {
        high = normals::rebuild(&high, NORMAL_ANGLE);
    }
    let has_normal_map = high
        .submeshes
        .iter()
        .any(|s| s.material.and_then(|m| materials.materials.get(m.index())).is_some_and(|m| m.normal.is_some()));
    if high.tangents.is_none() && high.uv0.is_some() && has_normal_map {
        // The source's normal map has to be read in some frame; glTF says MikkTSpace where none is stored.
        high = mikktspace(&high, UvSource::Uv0).map_err(|e| StageError::Defect(e.to_string()))?;
    }
    let encoded = load_images(context, &materials)?;
    let pictures = Pictures::new(&encoded, materials.images.iter().map(|i| i.format).collect());
    let decode = |image: ImageId| pictures.get(image);
    let diagonal = f64::from(high.diagonal());
    let own = BakeOptions {
        maps: options.maps.iter().map(|map| role(*map)).collect(),
        space: match options.space {
            Space::Tangent => NormalSpace::Tangent,
            Space::Object => NormalSpace::Object,
        },
        size: options.size.unwrap_or(BakeOptions::default().size),
        dilation: options.dilation,
        cage: options.cage.map(|cage| cage.resolve(diagonal)),
        hit: HitRule::Nearest,
        ..BakeOptions::default()
    };
    let device = backend.0.as_deref().map_or(Backend::Cpu, Backend::Gpu);
    context.progress(0.0, "transfer");
    let (levels, set, rasters, report) =
        bake(&high, &low, &materials, &decode, &own, device).map_err(StageError::Bake)?;
    let warnings = warnings(&report);
    let mut outputs = Outputs::new().with("levels", levels.to_blob());
    let mut set = set;
    for (index, raster) in rasters.iter().enumerate() {
        let blob = raster.to_blob();
        if let Some(info) = set.images.get_mut(index) {
            info.format = ImageFormat::Raster;
            info.hash = *blake3::hash(&blob).as_bytes();
        }
        outputs = outputs.with(format!("image/{index}"), blob);
    }
    Ok(outputs.with("materials", set.to_blob()).report(json(&Report { bake: report, warnings })))
}

fn warnings(report: &BakeReport) -> Vec<String> {
    let names = |roles: &[MapRole]| roles.iter().map(|role| role.name()).collect::<Vec<_>>().join(", ");
    let mut list = Vec::new();
    if report.missed > report.owned / 100 {
        list.push(format!(
            "{} of {} texels met nothing of the high mesh within {:.3e} m and were filled from their neighbours; a larger cage may help",
            report.missed, report.owned, report.cage
        ));
    }
    if report.overlapping > 0 {
        list.push(format!("{} texels are covered by two triangles", report.overlapping));
    }
    if !report.lost_maps.is_empty() {
        list.push(format!(
            "materials have maps that `maps` does not name and that are gone: {}",
            names(&report.lost_maps)
        ));
    }
    if let Some(padding) = report.short_padding {
        list.push(format!("dilation is more than the layout's padding of {padding} texels: bands of two charts meet"));
    }
    list
}

pub(super) fn role(map: MapName) -> MapRole {
    match map {
        MapName::Normal => MapRole::Normal,
        MapName::BaseColor => MapRole::BaseColor,
        MapName::MetallicRoughness => MapRole::MetallicRoughness,
        MapName::Occlusion => MapRole::Occlusion,
        MapName::Emissive => MapRole::Emissive,
    }
}
