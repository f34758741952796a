//! `bake`: the high mesh's surface into maps of the low mesh's atlas.

use kiln_asset::{ExtraMap, ImageId, MapRole, Mesh};
use kiln_bake::tangents::{UvSource, mikktspace};
use kiln_bake::transfer::{
    Backend, BakeInput, BakeOptions, BakeReport, Depth, Directions, HitRule, Matching, Method, NormalSpace,
    OcclusionSource, bake,
};
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
pub(crate) const VERSION: u32 = 2;

/// What a bake takes.
pub(crate) struct Inputs {
    /// The levels.
    pub low: Source,
    /// The mesh that is carried over.
    pub high: Source,
    /// Action whose `materials` and `image/N` belong to both.
    pub materials: usize,
    /// A mesh around the levels.
    pub cage: Option<Source>,
}

/// Outputs: `levels`, `materials`, `image/N`.
pub(crate) fn action(
    id: String,
    label: String,
    options: &options::BakeOptions,
    inputs: Inputs,
    backend: &OpenBackend,
) -> Action {
    let (own, device) = (options.clone(), backend.clone());
    let mut action = Action::new(id, "bake", VERSION, move |context| run(context, &own, &device))
        .input("low", inputs.low)
        .input("high", inputs.high)
        .input("materials", Source::output(inputs.materials, "materials"))
        .input("images", Source::outputs(inputs.materials, "image/"));
    if let Some(cage) = inputs.cage {
        action = action.input("cage", cage);
    }
    action.label = label;
    // The cage counts by what is in it.
    action.params = params(&StageSettings::Bake(options.clone()), &["high", "cage"]);
    action.foreign = [
        foreign::GLAM,
        foreign::OBVHS,
        foreign::MIKKTSPACE,
        foreign::BASISU,
        foreign::EXR,
        foreign::IMAGE,
        foreign::LIBM,
    ]
    .map(Into::into)
    .into();
    action.foreign.extend(foreign::oiio());
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
    let cage = match options.cage {
        Some(_) => Some(Mesh::from_blob(&context.input("cage")?).map_err(StageError::Blob)?),
        None => None,
    };
    let own = own_options(options, diagonal);
    let device = backend.0.as_deref().map_or(Backend::Cpu, Backend::Gpu);
    context.progress(0.0, "transfer");
    let input = BakeInput { high: &high, low: &low, materials: &materials, images: &decode, cage: cage.as_ref() };
    let baked = bake(&input, &own, device).map_err(StageError::Bake)?;
    let warnings = warnings(&baked.report);
    let mut outputs = Outputs::new().with("levels", baked.levels.to_blob());
    for (index, picture) in baked.pictures.iter().enumerate() {
        outputs = outputs.with(format!("image/{index}"), picture.to_blob());
    }
    Ok(outputs.with("materials", baked.materials.to_blob()).report(json(&Report { bake: baked.report, warnings })))
}

fn own_options(options: &options::BakeOptions, diagonal: f64) -> BakeOptions {
    let length = |length: Option<crate::language::length::Length>| length.map(|l| l.resolve(diagonal));
    BakeOptions {
        maps: options.maps.iter().filter_map(|map| role(*map)).collect(),
        extras: options.maps.iter().filter_map(|map| extra(*map)).collect(),
        method: match options.method {
            options::BakeMethod::MirroredVertex => Method::MirroredVertex,
            options::BakeMethod::Correspondence => Method::Correspondence,
        },
        space: match options.space {
            Space::Tangent => NormalSpace::Tangent,
            Space::Object => NormalSpace::Object,
        },
        size: options.size.unwrap_or(BakeOptions::default().size),
        samples: match options.samples {
            options::BakeSamples::One => 1,
            options::BakeSamples::Two => 2,
            options::BakeSamples::Four => 4,
            options::BakeSamples::Eight => 8,
        },
        depth: match options.depth {
            options::BakeDepth::Eight => Depth::Eight,
            options::BakeDepth::Sixteen => Depth::Sixteen,
            options::BakeDepth::Float => Depth::Float,
        },
        dilation: options.dilation,
        directions: match options.directions {
            options::BakeDirections::Smooth => Directions::Smooth,
            options::BakeDirections::Face => Directions::Face,
            options::BakeDirections::Mixed => Directions::Mixed,
        },
        hit: match options.hit {
            options::BakeHit::Outermost => HitRule::Outermost,
            options::BakeHit::Nearest => HitRule::Nearest,
        },
        front: length(options.front),
        back: length(options.back),
        back_faces: options.back_faces,
        matching: match options.matching {
            options::BakeMatch::Prefer => Matching::Prefer,
            options::BakeMatch::Name => Matching::Name,
            options::BakeMatch::Any => Matching::Any,
        },
        occlusion: match options.occlusion {
            options::BakeOcclusion::Source => OcclusionSource::Source,
            options::BakeOcclusion::Rays => OcclusionSource::Rays,
            options::BakeOcclusion::Both => OcclusionSource::Both,
        },
        rays: options.rays,
        ray_length: length(options.ray_length),
    }
}

fn warnings(report: &BakeReport) -> Vec<String> {
    let names = |roles: &[MapRole]| roles.iter().map(|role| role.name()).collect::<Vec<_>>().join(", ");
    let mut list = Vec::new();
    if report.missed > report.owned / 100 {
        list.push(format!(
            "{} of {} texels met nothing of the high mesh within {:.3e} m in front and {:.3e} m behind and were filled from their \
             neighbours; a larger `front` or `back` may help",
            report.missed, report.owned, report.front, report.back
        ));
    }
    if report.flat_faces > 0 {
        list.push(format!("{} triangles have no area on the sheet: nothing is baked for them", report.flat_faces));
    }
    // Concave corners of any detailed model cross somewhere; it matters where texels went without.
    if report.crossing_faces > 0 && report.missed > report.owned / 100 {
        list.push(format!(
            "lines of {} triangles cross within reach and are cut there; a smaller reach or directions = \"face\" avoids it",
            report.crossing_faces
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

/// The slot of a material that a map is written for.
fn role(map: MapName) -> Option<MapRole> {
    MapRole::ALL.into_iter().find(|role| role.name() == map.as_str())
}

/// The map beside the material that it is.
fn extra(map: MapName) -> Option<ExtraMap> {
    ExtraMap::ALL.into_iter().find(|extra| extra.name() == map.as_str())
}
