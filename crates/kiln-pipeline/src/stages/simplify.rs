//! `simplify`: two actions. `collapse` records one collapse sequence to exhaustion, whatever the levels; `levels` cuts them out
//! of it. So a changed level replays the sequence and simplifies nothing anew.

use kiln_asset::{LodSet, Mesh};
use kiln_engine::{Action, ActionError, Context, Outputs, Source};
use kiln_lod::normals;
use kiln_lod::simplify::{Budget, CollapseSequence, LevelsOptions, Placement, SimplifyOptions, collapse, levels};

use super::{StageError, json, load_levels, params};
use crate::foreign;
use crate::language::options::{self, Normals};
use crate::language::{LevelBudget, StageSettings};

/// Raised whenever the same input and parameters give another collapse sequence.
pub(crate) const COLLAPSE_VERSION: u32 = 1;
/// Raised whenever the same sequence and parameters give other levels.
pub(crate) const LEVELS_VERSION: u32 = 1;

/// Keys that only the cut reads.
const LEVEL_KEYS: [&str; 4] = ["levels", "normals", "normal-angle", "placement"];

/// Output: `sequence`.
pub(crate) fn collapse_action(id: String, label: String, options: &options::SimplifyOptions, input: Source) -> Action {
    let mut action = Action::new(id, "simplify", COLLAPSE_VERSION, |context| {
        let set = load_levels(context, "in")?;
        let Some(finest) = set.levels.first() else { return Err(no_level()) };
        let sequence = collapse(&finest.mesh, &finest.quadrics, set.layout.as_ref(), &SimplifyOptions::default());
        Ok(Outputs::new().with("sequence", sequence.to_blob()).report(json(sequence.report())))
    })
    .input("in", input);
    action.label = label;
    action.params = params(&StageSettings::Simplify(options.clone()), &LEVEL_KEYS);
    action.foreign = vec![foreign::GLAM.into()];
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    action
}

/// Output: `levels`. `source` is the mesh that errors are measured against.
pub(crate) fn levels_action(
    id: String,
    label: String,
    options: &options::SimplifyOptions,
    input: Source,
    sequence: Source,
    source: Source,
) -> Action {
    let own = options.clone();
    let mut action = Action::new(id, "levels", LEVELS_VERSION, move |context| cut(context, &own))
        .input("in", input)
        .input("sequence", sequence)
        .input("source", source);
    action.label = label;
    let all = params(&StageSettings::Simplify(options.clone()), &[]);
    action.params = all.into_iter().filter(|(name, _)| LEVEL_KEYS.contains(&name.as_str())).collect();
    action.foreign = vec![foreign::GLAM.into(), foreign::OBVHS.into()];
    action.numeric_class = Some(foreign::NUMERIC_CLASS.into());
    action
}

fn no_level() -> ActionError {
    StageError::Defect("the stage before gave no level".into()).into()
}

fn cut(context: &Context<'_>, options: &options::SimplifyOptions) -> Result<Outputs, ActionError> {
    let set = load_levels(context, "in")?;
    let source = Mesh::from_blob(&context.input("source")?).map_err(StageError::Blob)?;
    let Some(finest) = set.levels.first() else { return Err(no_level()) };
    let sequence = CollapseSequence::from_blob(&context.input("sequence")?).map_err(StageError::Blob)?;
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
    let how = LevelsOptions { placement, ..LevelsOptions::default() };
    let (cut, report) = levels(&finest.mesh, &finest.quadrics, &sequence, &source, &budgets, &how);
    let levels = cut
        .levels
        .into_iter()
        .map(|mut level| {
            if options.normals == Normals::Rebuild {
                level.mesh = normals::rebuild_all(&level.mesh, options.normal_angle as f32);
            } else if needs_normals(&level.mesh) {
                level.mesh = normals::rebuild(&level.mesh, options.normal_angle as f32);
            }
            level
        })
        .collect();
    let out = LodSet { levels, layout: set.layout, source_triangles: set.source_triangles };
    Ok(Outputs::new().with("levels", out.to_blob()).report(json(&report)))
}

/// Whether a submesh came without normals.
pub(crate) fn needs_normals(mesh: &Mesh) -> bool {
    mesh.normals.is_none() || mesh.submeshes.iter().any(|s| !s.attributes.normals)
}
