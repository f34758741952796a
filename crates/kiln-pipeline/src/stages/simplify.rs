//! `simplify`: two actions, three under rules for submeshes. `collapse` records one collapse sequence to exhaustion, whatever the
//! levels; `parts` finds what each collapse rests on; `levels` cuts them out of it. So a changed level replays the sequence and
//! simplifies nothing anew. Where a cut by parts has to be continued, that is a part of `levels`, and its report says so. With
//! `texture-border` the first reads the materials' pictures, too.

use std::sync::Arc;

use kiln_asset::{BlobError, ImageId, LodSet, MaterialSet, Mesh, Raster};
use kiln_engine::{Action, ActionError, Context, Outputs, Source};
use kiln_lod::normals;
use kiln_lod::simplify::parts::{PartLevel, PartRule, matches, unmatched};
use kiln_lod::simplify::texture_border::{TextureBorderReport, debug_picture};
use kiln_lod::simplify::{
    BorderCost, Boundary, Budget, CollapseSequence, Conditions, Dependencies, LevelsOptions, MetricKind, Parts,
    Placement, SequenceReport, SimplifyOptions, SimplifyReport, TextureBorderOptions, TextureBorders, collapse_under,
    levels_by_parts,
};
use serde::Serialize;

use super::bake::role;
use super::pack::Pictures;
use super::{StageError, json, load_images, load_levels, load_materials, params};
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
    if options.texture_border.is_some() {
        action = action.input("images", inputs.images.clone());
        action.foreign.extend([foreign::BASISU, foreign::IMAGE, foreign::LIBM].map(Into::into));
    } else {
        // What is not asked for leaves no trace in the fingerprint.
        action.params.retain(|(name, _)| name != "texture-border");
    }
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    let reads_materials = options.texture_border.is_some() || !options.lock.0.is_empty();
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

/// The sequence's report, and the extension's.
#[derive(Serialize)]
struct CollapseReport<'a> {
    #[serde(flatten)]
    sequence: &'a SequenceReport,
    #[serde(skip_serializing_if = "Option::is_none")]
    texture_border: Option<TextureBorderReport>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

fn record(context: &Context<'_>, options: &options::SimplifyOptions) -> Result<Outputs, ActionError> {
    let set = load_levels(context, "in")?;
    let Some(finest) = set.levels.first() else { return Err(no_level()) };
    let mesh = &finest.mesh;
    let (mut texture_border, mut warnings, mut found) = (None, Vec::new(), None);
    if let Some(options) = &options.texture_border {
        let materials = load_materials(context, "materials")?;
        let encoded = load_images(context, &materials)?;
        context.progress(0.0, "texture borders");
        let borders = borders(mesh, &materials, &encoded, options).map_err(StageError::Picture)?;
        let report = borders.report(mesh, &materials);
        warnings.extend(doubts(&report));
        texture_border = Some(report);
        found = Some(borders);
    }
    let locked = locked(context, options, mesh)?;
    let conditions = Conditions { locked: &locked, borders: found.as_ref() };
    let layout = set.layout.as_ref();
    let sequence = collapse_under(mesh, &finest.quadrics, layout, &collapse_options(options), &conditions);
    let report = CollapseReport { sequence: sequence.report(), texture_border, warnings };
    Ok(Outputs::new().with("sequence", sequence.to_blob()).report(json(&report)))
}

fn doubts(report: &TextureBorderReport) -> Option<String> {
    if report.pictures.is_empty() {
        return Some(
            "texture-border: no submesh has a texture in the maps that it names, so it changes nothing".into(),
        );
    }
    (report.affected == 0).then(|| "texture-border: no edge crosses a border, so it changes nothing".into())
}

fn borders(
    mesh: &Mesh,
    materials: &MaterialSet,
    encoded: &[Arc<[u8]>],
    options: &options::TextureBorder,
) -> Result<TextureBorders, String> {
    let pictures = Pictures::new(encoded, materials.images.iter().map(|i| i.format).collect());
    let own = TextureBorderOptions {
        maps: options.maps.0.iter().map(|map| role(*map)).collect(),
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

/// A picture to look at: a texture with its borders and the edges that cross them.
#[derive(Clone, Debug)]
pub struct DebugPicture {
    /// The texture's name and the map it was read as, fit for a file name.
    pub name: String,
    /// What it shows, with its counts.
    pub caption: String,
    /// The picture.
    pub picture: Raster,
}

/// What a planned collapse with `texture-border` can show, from the inputs of its action.
#[derive(Clone, Debug)]
pub struct TextureBorderView {
    /// Index of the action.
    pub action: usize,
    /// Id of the stage.
    pub stage: String,
    pub(crate) options: options::TextureBorder,
}

impl TextureBorderView {
    /// The pictures, one for each texture and map. `mesh`: bytes of the action's input `in`; `materials` and `images` likewise.
    ///
    /// # Errors
    /// The bytes are damaged.
    pub fn pictures(
        &self,
        mesh: &[u8],
        materials: &[u8],
        images: &[Arc<[u8]>],
    ) -> Result<Vec<DebugPicture>, StageError> {
        let set = super::levels_of(mesh)?;
        let finest = set.levels.first().ok_or(BlobError::Content("no level".into()))?;
        let materials = MaterialSet::from_blob(materials)?;
        let borders = borders(&finest.mesh, &materials, images, &self.options).map_err(StageError::Picture)?;
        let report = borders.report(&finest.mesh, &materials);
        let pictures = Pictures::new(images, materials.images.iter().map(|i| i.format).collect());
        let show = |index: usize| {
            let (map, counts) = (&borders.maps()[index], &report.pictures[index]);
            let texture = pictures.get(map.image).map_err(StageError::Picture)?;
            let segments = borders.segments(&finest.mesh, index);
            let safe = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
            Ok(DebugPicture {
                name: format!("{index}-{}.{}", counts.name.chars().map(safe).collect::<String>(), counts.map),
                caption: format!(
                    "{} as {}: {} border texels of {} x {}, {} of {} edges in it cross one",
                    counts.name,
                    counts.map,
                    counts.border_texels,
                    counts.width,
                    counts.height,
                    counts.affected_segments,
                    segments.len()
                ),
                picture: debug_picture(&texture, map, &segments),
            })
        };
        (0..borders.maps().len()).map(show).collect()
    }
}

#[derive(Serialize)]
struct PartsReport {
    collapses: usize,
}

/// Output: `levels`. `source` is the mesh that errors are measured against; `rules` those of the stage and of earlier ones, and
/// `dependencies` is there where there are any.
pub(crate) fn levels_action(
    id: String,
    label: String,
    options: &options::SimplifyOptions,
    rules: Vec<HeldRule>,
    inputs: &Inputs,
    [sequence, source]: [Source; 2],
    dependencies: Option<Source>,
) -> Action {
    let (own, held) = (options.clone(), rules.clone());
    let mut action = Action::new(id, "levels", LEVELS_VERSION, move |context| cut(context, &own, &held))
        .input("in", inputs.before.clone())
        .input("sequence", sequence)
        .input("source", source);
    if let Some(dependencies) = dependencies {
        action = action.input("dependencies", dependencies);
    }
    action.label = label;
    let all = params(&StageSettings::Simplify(options.clone()), &[]);
    let reads = |name: &str| LEVEL_KEYS.contains(&name) || SHARED_KEYS.contains(&name);
    action.params = all.into_iter().filter(|(name, _)| reads(name)).collect();
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

fn no_level() -> ActionError {
    StageError::Defect("the stage before gave no level".into()).into()
}

fn collapse_options(options: &options::SimplifyOptions) -> SimplifyOptions {
    let boundary = match options.boundary {
        BoundaryRule::Along => Boundary::Along,
        BoundaryRule::Last => Boundary::Last,
        BoundaryRule::Lock => Boundary::Lock,
    };
    let metric = match options.metric.0 {
        options::Metric::Quadric => MetricKind::Quadric,
        options::Metric::Memoryless => MetricKind::Memoryless,
    };
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

fn unknown(what: &str, kind: &str, glob: &str, names: &[&str]) -> String {
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

fn cut(context: &Context<'_>, options: &options::SimplifyOptions, rules: &[HeldRule]) -> Result<Outputs, ActionError> {
    let set = load_levels(context, "in")?;
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
