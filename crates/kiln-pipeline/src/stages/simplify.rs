//! `simplify`: two actions, three under rules for submeshes. `collapse` records one collapse sequence to exhaustion, whatever the
//! levels; `parts` finds what each collapse rests on; `levels` cuts them out of it. So a changed level replays the sequence and
//! simplifies nothing anew. Where a cut by parts has to be continued, that is a part of `levels`, and its report says so. With
//! `texture-border` or a metric of texture regions the first reads the materials' pictures, too.

use std::sync::Arc;

use kiln_asset::{ImageId, LodSet, MapRole, MaterialSet, Mesh};
use kiln_engine::{Action, ActionError, Context, Outputs, Source};
use kiln_lod::normals;
use kiln_lod::simplify::parts::{PartLevel, PartRule, matches, unmatched};
use kiln_lod::simplify::texture_border::TextureBorderReport;
use kiln_lod::simplify::viewpoint::{
    Cameras, Regions, RegionsReport, SegmentationOptions, Update, ViewKind, ViewOptions, collapse_by_views,
};
use kiln_lod::simplify::{
    BorderCost, Boundary, Budget, CollapseSequence, Conditions, Dependencies, LevelsOptions, MetricKind, Parts,
    Placement, SequenceReport, SimplifyOptions, SimplifyReport, TextureBorderOptions, TextureBorders, collapse_under,
    levels_by_parts,
};
use serde::Serialize;

use super::pack::Pictures;
use super::{StageError, json, load_images, load_levels, load_materials, no_level, params};
use crate::foreign;
use crate::language::diagnostic::suggest;
use crate::language::options::{self, BoundaryRule, Normals, RuleLevel, SubmeshRule};
use crate::language::{LevelBudget, StageSettings};

/// Raised whenever the same input and parameters give another collapse sequence.
pub(crate) const COLLAPSE_VERSION: u32 = 3;
/// Raised whenever the same sequence gives other dependencies.
pub(crate) const PARTS_VERSION: u32 = 1;
/// Raised whenever the same sequence and parameters give other levels.
pub(crate) const LEVELS_VERSION: u32 = 3;

/// Keys that only the cut reads.
const LEVEL_KEYS: [&str; 6] = ["levels", "normals", "normal-angle", "placement", "prune", "submesh"];
/// Keys that the cut reads as well.
const SHARED_KEYS: [&str; 2] = ["boundary", "lock"];

/// A rule for submeshes, and whether an earlier stage has met it already.
pub(crate) type HeldRule = (SubmeshRule, bool);

/// What the actions of one stage take.
pub(crate) struct Inputs {
    /// The mesh or level that is simplified.
    pub(crate) before: Source,
    /// Its materials.
    pub(crate) materials: Source,
    /// Their images.
    pub(crate) images: Source,
}

/// Output: `sequence`.
pub(crate) fn collapse_action(
    id: String,
    label: String,
    options: &options::SimplifyOptions,
    inputs: &Inputs,
) -> Action {
    let own = options.clone();
    let mut action = Action::new(id, "simplify", COLLAPSE_VERSION, move |context| record(context, &own))
        .input("in", inputs.before.clone());
    action.label = label;
    action.params = params(&StageSettings::Simplify(options.clone()), &LEVEL_KEYS);
    action.foreign = vec![foreign::GLAM.into()];
    let sees_pictures = options.texture_border.is_some() || options.metric.metric.sees_regions();
    if sees_pictures {
        action = action.input("images", inputs.images.clone());
        action.foreign.extend([foreign::BASISU, foreign::EXR, foreign::IMAGE].map(Into::into));
        action.foreign.extend(foreign::oiio());
    }
    if sees_pictures || options.metric.metric.has_views() {
        action.foreign.push(foreign::LIBM.into());
    }
    if options.texture_border.is_none() {
        // What is not asked for leaves no trace in the fingerprint.
        action.params.retain(|(name, _)| name != "texture-border");
    }
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    let reads_materials = sees_pictures || !options.lock.0.is_empty();
    if reads_materials { action.input("materials", inputs.materials.clone()) } else { action }
}

/// Output: `dependencies`.
pub(crate) fn parts_action(id: String, label: String, inputs: &Inputs, sequence: Source) -> Action {
    let mut action = Action::new(id, "parts", PARTS_VERSION, move |context| {
        let set = load_levels(context, "in")?;
        let Some(finest) = set.levels.first() else { return Err(no_level()) };
        let sequence = CollapseSequence::from_blob(&context.input("sequence")?).map_err(StageError::Blob)?;
        let found = Dependencies::for_cuts(&finest.mesh, &sequence).map_err(StageError::Blob)?;
        Ok(Outputs::new().with("dependencies", found.to_blob()).report(json(&PartsReport { collapses: found.len() })))
    })
    .input("in", inputs.before.clone())
    .input("sequence", sequence);
    action.label = label;
    action.foreign = vec![foreign::GLAM.into()];
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    action
}

/// The sequence's report, and those of what it was made by.
#[derive(Serialize)]
struct CollapseReport<'a> {
    #[serde(flatten)]
    sequence: &'a SequenceReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    texture_border: Option<TextureBorderReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    regions: Option<RegionsReport>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

fn record(context: &Context<'_>, options: &options::SimplifyOptions) -> Result<Outputs, ActionError> {
    let set = load_levels(context, "in")?;
    let Some(finest) = set.levels.first() else { return Err(no_level()) };
    let mesh = &finest.mesh;
    let (mut texture_border, mut warnings, mut found) = (None, Vec::new(), None);
    let (mut regions, mut seen) = (None, Regions::default());
    if options.texture_border.is_some() || options.metric.metric.sees_regions() {
        let materials = load_materials(context, "materials")?;
        let encoded = load_images(context, &materials)?;
        if let Some(options) = &options.texture_border {
            context.progress(0.0, "texture borders");
            let borders = borders(mesh, &materials, &encoded, options).map_err(StageError::Picture)?;
            let report = borders.report(mesh, &materials);
            warnings.extend(doubts(&report));
            texture_border = Some(report);
            found = Some(borders);
        }
        if let Some((views, true)) = view_options(&options.metric).map(|v| (v, v.kind.sees_regions())) {
            context.progress(0.0, "texture regions");
            let (of_mesh, report) = texture_regions(mesh, &materials, &encoded, &views).map_err(StageError::Picture)?;
            warnings.extend(region_doubts(&report, options.metric.metric));
            (seen, regions) = (of_mesh, Some(report));
        }
    }
    let locked = locked(context, options, mesh)?;
    let conditions = Conditions { locked: &locked, borders: found.as_ref(), ..Conditions::default() };
    let layout = set.layout.as_ref();
    let how = collapse_options(options);
    let sequence = match view_options(&options.metric) {
        Some(views) => {
            context.progress(0.0, "views");
            collapse_by_views(mesh, &finest.quadrics, layout, &how, &conditions, &views, &seen)
                .map_err(StageError::Views)?
        }
        None => collapse_under(mesh, &finest.quadrics, layout, &how, &conditions),
    };
    let report = CollapseReport { sequence: sequence.report(), texture_border, regions, warnings };
    Ok(Outputs::new().with("sequence", sequence.to_blob()).report(json(&report)))
}

fn region_doubts(report: &RegionsReport, metric: options::Metric) -> Option<String> {
    let name = metric.as_str();
    report.pictures.is_empty().then(|| {
        format!("{name}: no submesh has a base colour texture, so each material is one region and only outlines count")
    })
}

/// What the views are asked; `None` for a metric without.
pub(super) fn view_options(choice: &options::MetricChoice) -> Option<ViewOptions> {
    let views = choice.views.as_ref()?;
    Some(ViewOptions {
        kind: match choice.metric {
            options::Metric::ViewpointEntropy => ViewKind::PolygonEntropy,
            options::Metric::ViewpointMutualInformation => ViewKind::PolygonMutualInformation,
            options::Metric::RegionEntropy => ViewKind::RegionEntropy,
            options::Metric::RegionMutualInformation => ViewKind::RegionMutualInformation,
            options::Metric::Quadric | options::Metric::Memoryless => return None,
        },
        alpha: views.alpha,
        cameras: match views.views {
            options::ViewSet::Solid(options::Solid::Icosahedron) => Cameras::Icosahedron,
            options::ViewSet::Solid(options::Solid::Dodecahedron) => Cameras::Dodecahedron,
            options::ViewSet::Count(count) => Cameras::Fibonacci(count),
        },
        size: views.size,
        update: match views.update {
            options::ViewUpdate::Exact => Update::Exact,
            options::ViewUpdate::Published => Update::Published,
        },
        segmentation: SegmentationOptions {
            sigma: views.sigma,
            k: views.k,
            min_size: views.min_size,
            reach: views.reach,
            side: views.side,
        },
        prepass: views.prepass,
    })
}

/// The regions of a mesh's textures. `encoded`: the images of `materials`.
pub(super) fn texture_regions(
    mesh: &Mesh,
    materials: &MaterialSet,
    encoded: &[Arc<[u8]>],
    views: &ViewOptions,
) -> Result<(Regions, RegionsReport), String> {
    let pictures = Pictures::new(encoded, materials.images.iter().map(|i| i.format).collect());
    Regions::new(mesh, materials, &|image: ImageId| pictures.get(image), &views.segmentation)
}

fn doubts(report: &TextureBorderReport) -> Option<String> {
    if report.pictures.is_empty() {
        return Some(
            "texture-border: no submesh has a texture in the maps that it names, so it changes nothing".into(),
        );
    }
    (report.affected == 0).then(|| "texture-border: no edge crosses a border, so it changes nothing".into())
}

pub(super) fn borders(
    mesh: &Mesh,
    materials: &MaterialSet,
    encoded: &[Arc<[u8]>],
    options: &options::TextureBorder,
) -> Result<TextureBorders, String> {
    let pictures = Pictures::new(encoded, materials.images.iter().map(|i| i.format).collect());
    let own = TextureBorderOptions {
        maps: options
            .maps
            .0
            .iter()
            .filter_map(|map| MapRole::ALL.into_iter().find(|r| r.name() == map.as_str()))
            .collect(),
        sigma: options.sigma,
        low: options.low,
        high: options.high,
        weight: options.weight,
        cost: match options.cost {
            options::BorderCost::Shift => BorderCost::Shift,
            options::BorderCost::Area => BorderCost::Area,
        },
        side: options.side,
    };
    TextureBorders::new(mesh, materials, &|image: ImageId| pictures.get(image), &own)
}

#[derive(Serialize)]
struct PartsReport {
    collapses: usize,
}

/// What the cut of one stage goes by, beside the stage's options and inputs.
pub(crate) struct Cut {
    /// The rules of the stage and of earlier ones.
    pub(crate) rules: Vec<HeldRule>,
    /// The stage's collapse sequence.
    pub(crate) sequence: Source,
    /// The mesh that errors are measured against.
    pub(crate) source: Source,
    /// There where there are rules.
    pub(crate) dependencies: Option<Source>,
    /// Whether all levels are to have vertices of the finest: then normals that a model lacks are made before the cut, smooth ones.
    pub(crate) shares_vertices: bool,
}

/// Output: `levels`.
pub(crate) fn levels_action(
    id: String,
    label: String,
    options: &options::SimplifyOptions,
    inputs: &Inputs,
    by: Cut,
) -> Action {
    let Cut { rules, sequence, source, dependencies, shares_vertices } = by;
    let (own, held) = (options.clone(), rules.clone());
    let mut action =
        Action::new(id, "levels", LEVELS_VERSION, move |context| cut(context, &own, &held, shares_vertices))
            .input("in", inputs.before.clone())
            .input("sequence", sequence)
            .input("source", source);
    if let Some(dependencies) = dependencies {
        action = action.input("dependencies", dependencies);
    }
    if shares_vertices {
        action = action.param("shares-vertices", true);
    }
    action.label = label;
    let all = params(&StageSettings::Simplify(options.clone()), &[]);
    let reads = |name: &str| LEVEL_KEYS.contains(&name) || SHARED_KEYS.contains(&name);
    action.params.extend(all.into_iter().filter(|(name, _)| reads(name)));
    let earlier: Vec<SubmeshRule> = rules.into_iter().filter(|(_, met)| *met).map(|(rule, _)| rule).collect();
    if !earlier.is_empty() {
        let text = options::rules_text(&earlier);
        action.params.push(("submesh of earlier stages".into(), kiln_engine::Value::Text(text)));
    }
    action.foreign = vec![foreign::GLAM.into(), foreign::OBVHS.into()];
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    with_materials(action, options, inputs)
}

/// Materials are read where some are locked.
fn with_materials(action: Action, options: &options::SimplifyOptions, inputs: &Inputs) -> Action {
    if options.lock.0.is_empty() { action } else { action.input("materials", inputs.materials.clone()) }
}

fn collapse_options(options: &options::SimplifyOptions) -> SimplifyOptions {
    let boundary = match options.boundary {
        BoundaryRule::Along => Boundary::Along,
        BoundaryRule::Last => Boundary::Last,
        BoundaryRule::Lock => Boundary::Lock,
    };
    // Views take quadrics for their pre-pass and between equals, and so does what goes on beyond their log.
    let metric =
        if options.metric.metric == options::Metric::Memoryless { MetricKind::Memoryless } else { MetricKind::Quadric };
    SimplifyOptions { metric, boundary, attributes: options.attributes, ..SimplifyOptions::default() }
}

/// `[submesh_count]`: whether a glob of `lock` matches the submesh's material.
fn locked(context: &Context<'_>, options: &options::SimplifyOptions, mesh: &Mesh) -> Result<Vec<bool>, ActionError> {
    if options.lock.0.is_empty() {
        return Ok(vec![false; mesh.submeshes.len()]);
    }
    let materials = load_materials(context, "materials")?;
    let name = |at: usize| materials.materials.get(at).map(|material| material.name.as_str());
    let of = |submesh: &kiln_asset::Submesh| submesh.material.and_then(|id| name(id.index()));
    let locks = |name: &str| options.lock.0.iter().any(|glob| matches(glob, name));
    Ok(mesh.submeshes.iter().map(|submesh| of(submesh).is_some_and(locks)).collect())
}

/// Globs of `lock` that match no material, in words.
fn idle_locks(globs: &[String], materials: &MaterialSet) -> Vec<String> {
    let names: Vec<&str> = materials.materials.iter().map(|material| material.name.as_str()).collect();
    let idle = |glob: &&String| !names.iter().any(|name| matches(glob, name));
    globs.iter().filter(idle).map(|glob| unknown("lock", "material", glob, &names)).collect()
}

pub(super) fn unknown(what: &str, kind: &str, glob: &str, names: &[&str]) -> String {
    // A model may have thousands.
    let most = &names[..names.len().min(12)];
    let help = match suggest(&format!("{kind}s"), glob, names) {
        Some(near) if near.starts_with("did you") => format!("; {near}"),
        _ if names.is_empty() => String::new(),
        _ => format!("; the model has {}{}", most.join(", "), if most.len() < names.len() { ", ..." } else { "" }),
    };
    format!("{what} \"{glob}\" matches no {kind}{help}")
}

/// The rules as the cut takes them.
fn part_rules(rules: &[HeldRule]) -> Vec<PartRule> {
    let level = |(rule, met): &HeldRule| match &rule.level {
        RuleLevel::Keep(keep) => PartLevel::Keep(*keep),
        // The level that an earlier stage gave is what comes in.
        RuleLevel::Level(_) if *met => PartLevel::AsIncoming,
        RuleLevel::Level(level) => PartLevel::AsLevel(*level as usize),
        RuleLevel::Relative { to, factor } => {
            let to = rules.iter().rposition(|(other, _)| other.name == *to).unwrap_or(usize::MAX);
            PartLevel::Relative { to, factor: *factor }
        }
    };
    rules.iter().map(|rule| PartRule { name: rule.0.name.clone(), level: level(rule) }).collect()
}

/// The cut's report, and what it was asked in vain.
#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    levels: SimplifyReport,
    /// Rules and locks that hold for nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    short: Vec<String>,
}

fn cut(
    context: &Context<'_>,
    options: &options::SimplifyOptions,
    rules: &[HeldRule],
    shares_vertices: bool,
) -> Result<Outputs, ActionError> {
    let mut set = load_levels(context, "in")?;
    if let Some(finest) = set.levels.first_mut().filter(|finest| shares_vertices && needs_normals(&finest.mesh)) {
        finest.mesh = normals::smooth(&finest.mesh);
    }
    let source = Mesh::from_blob(&context.input("source")?).map_err(StageError::Blob)?;
    let Some(finest) = set.levels.first() else { return Err(no_level()) };
    let sequence = CollapseSequence::from_blob(&context.input("sequence")?).map_err(StageError::Blob)?;
    let submeshes = &finest.mesh.submeshes;
    let dependencies = match rules {
        [] => None,
        _ => Some(Dependencies::from_blob(&context.input("dependencies")?, submeshes.len()).map_err(StageError::Blob)?),
    };
    if dependencies.as_ref().is_some_and(|found| found.len() != sequence.collapses.len()) {
        return Err(StageError::Defect("the dependencies belong to another collapse sequence".into()).into());
    }
    let diagonal = f64::from(source.diagonal());
    let budgets: Vec<Budget> = options
        .levels
        .iter()
        .map(|level| match level {
            LevelBudget::Keep(share) => Budget::Keep(*share),
            LevelBudget::Triangles(count) => Budget::Triangles(*count),
            LevelBudget::Error(length) => Budget::Error(length.resolve(diagonal)),
        })
        .collect();
    let placement = match options.placement {
        options::Placement::HalfEdge => Placement::HalfEdge,
        options::Placement::Free => Placement::Free,
    };
    let prune = options.prune.map_or(0.0, |length| length.resolve(diagonal));
    let how = LevelsOptions { placement, prune, ..LevelsOptions::default() };
    let part_rules = part_rules(rules);
    let locked = locked(context, options, &finest.mesh)?;
    let parts = Parts {
        rules: &part_rules,
        dependencies: dependencies.as_ref(),
        locked: &locked,
        options: collapse_options(options),
    };
    let (cut, report) = levels_by_parts(&finest.mesh, &finest.quadrics, &sequence, &source, &budgets, &how, &parts);

    let names: Vec<&str> = submeshes.iter().map(|submesh| submesh.name.as_str()).collect();
    let vain = unmatched(&part_rules, submeshes).into_iter().filter(|rule| !rules[*rule].1);
    let mut short: Vec<String> = vain.map(|rule| unknown("rule", "submesh", &rules[rule].0.name, &names)).collect();
    if !options.lock.0.is_empty() {
        short.extend(idle_locks(&options.lock.0, &load_materials(context, "materials")?));
    }
    let levels = cut
        .levels
        .into_iter()
        .map(|mut level| {
            if options.normals == Normals::Rebuild {
                let untouched = untouched(&finest.mesh, &level.mesh);
                level.mesh = normals::rebuild_but(&level.mesh, options.normal_angle as f32, &untouched);
            } else if needs_normals(&level.mesh) {
                level.mesh = normals::rebuild(&level.mesh, options.normal_angle as f32);
            }
            level
        })
        .collect();
    let out = LodSet { levels, layout: set.layout, source_triangles: set.source_triangles };
    Ok(Outputs::new().with("levels", out.to_blob()).report(json(&Report { levels: report, short })))
}

/// `[submesh_count]`: the submeshes of which a level has all triangles and which brought normals: they keep them.
fn untouched(before: &Mesh, level: &Mesh) -> Vec<bool> {
    let ids = (0..before.submeshes.len() as u32).map(kiln_asset::SubmeshId);
    let whole = |s: kiln_asset::SubmeshId| before.submesh_faces(s).len() == level.submesh_faces(s).len();
    ids.map(|s| whole(s) && before.normals.is_some() && before.submeshes[s.index()].attributes.normals).collect()
}

/// Whether a submesh came without normals.
pub(crate) fn needs_normals(mesh: &Mesh) -> bool {
    mesh.normals.is_none() || mesh.submeshes.iter().any(|s| !s.attributes.normals)
}
