//! `atlas`: one level gets a second UV layout, and tangents in it, so that every coarser level carries the finest one's.

use std::sync::Arc;

use kiln_asset::LodSet;
use kiln_bake::atlas::xatlas::Xatlas;
use kiln_bake::atlas::{self, AtlasOptions, UnwrapError, UnwrapperChoice, Uvunwrap};
use kiln_bake::tangents::{UvSource, mikktspace};
use kiln_engine::{Action, ActionError, Context, Outputs, Source};
use kiln_lod::normals;

use super::simplify::needs_normals;
use super::{StageError, json, load_levels, params};
use crate::foreign;
use crate::language::StageSettings;
use crate::language::options::{self, UnwrapperName};

/// Raised whenever the same input and parameters give other bytes.
pub(crate) const VERSION: u32 = 1;

/// Angle above which made normals split, degrees; only for input that comes without.
pub(crate) const NORMAL_ANGLE: f32 = 30.0;

/// Runs the worker program around xatlas: request in, reply out, or why not.
pub type XatlasWorker = Arc<dyn Fn(&[u8]) -> Result<Vec<u8>, String> + Send + Sync>;

/// Output: `levels`.
pub(crate) fn action(
    id: String,
    label: String,
    options: &options::AtlasOptions,
    input: Source,
    worker: Option<XatlasWorker>,
) -> Action {
    let own = options.clone();
    let mut action =
        Action::new(id, "atlas", VERSION, move |context| run(context, &own, worker.as_ref())).input("in", input);
    action.label = label;
    action.params = params(&StageSettings::Atlas(options.clone()), &[]);
    action.foreign = [foreign::GLAM, foreign::UVUNWRAP, foreign::MIKKTSPACE, foreign::LIBM].map(Into::into).into();
    action.numeric_class = Some(if options.unwrapper == UnwrapperName::Xatlas {
        action.foreign.push(foreign::XATLAS.into());
        foreign::cxx_class()
    } else {
        foreign::NUMERIC_CLASS.into()
    });
    action
}

fn run(
    context: &Context<'_>,
    options: &options::AtlasOptions,
    worker: Option<&XatlasWorker>,
) -> Result<Outputs, ActionError> {
    let LodSet { mut levels, source_triangles, .. } = load_levels(context, "in")?;
    let Some(mut level) = levels.drain(..).next() else {
        return Err(StageError::Defect("the stage before gave no level".into()).into());
    };
    if needs_normals(&level.mesh) {
        level.mesh = normals::rebuild(&level.mesh, NORMAL_ANGLE);
    }
    let ask = |request: &[u8]| match worker {
        Some(worker) => worker(request).map_err(UnwrapError::Worker),
        None => Err(UnwrapError::Worker(
            "the worker program kiln-xatlas was not found; build it with \
             `cargo build --release -p kiln-xatlas --features xatlas`, or use unwrapper = \"auto\""
                .into(),
        )),
    };
    let xatlas = Xatlas::new(&ask);
    let (choice, first): (_, &dyn atlas::Unwrapper) = match options.unwrapper {
        UnwrapperName::Auto => (UnwrapperChoice::Auto, &Uvunwrap::STANDARD),
        UnwrapperName::Uvunwrap => (UnwrapperChoice::Uvunwrap, &Uvunwrap::STANDARD),
        UnwrapperName::Xatlas => (UnwrapperChoice::Xatlas, &xatlas),
    };
    let asked = AtlasOptions { size: options.size, padding: options.padding, unwrapper: choice };
    context.progress(0.0, "charts");
    let (mut level, layout, report) = atlas::unwrap(&level, &asked, first).map_err(StageError::Atlas)?;
    context.progress(0.8, "tangents");
    level.mesh = mikktspace(&level.mesh, UvSource::AtlasUv).map_err(|e| StageError::Defect(e.to_string()))?;
    let set = LodSet { levels: vec![level], layout: Some(layout), source_triangles };
    Ok(Outputs::new().with("levels", set.to_blob()).report(json(&report)))
}
