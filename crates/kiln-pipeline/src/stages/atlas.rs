//! `atlas`: one level gets a second UV layout, and tangents in it, so that every coarser level carries the finest one's.
//!
//! The stage's clock is here: `time-limit` ends a run with an error, which is never kept, and so it is no part of the
//! fingerprint. Ctrl-C ends it the same way.

use std::sync::Arc;
use std::time::{Duration, Instant};

use kiln_asset::{LodSet, Submesh};
use kiln_bake::atlas::xatlas::Xatlas;
use kiln_bake::atlas::{
    self, AtlasError, AtlasOptions, AtlasReport, Planar, Stop, UnwrapError, UnwrapperChoice, Uvunwrap, Watch,
};
use kiln_bake::tangents::{UvSource, mikktspace};
use kiln_engine::{Action, ActionError, Context, Outputs, Source};
use kiln_lod::normals;
use kiln_lod::simplify::parts::matches;
use serde::Serialize;

use super::simplify::{needs_normals, unknown};
use super::{StageError, json, load_levels, params};
use crate::foreign;
use crate::language::StageSettings;
use crate::language::options::{self, DensityRule, UnwrapperName};
use crate::language::pipeline::TIME_KEYS;

/// Raised whenever the same input and parameters give other bytes.
pub(crate) const VERSION: u32 = 2;

/// Angle above which made normals split, degrees; only for input that comes without.
pub(crate) const NORMAL_ANGLE: f32 = 30.0;

/// Runs the worker program around xatlas: request and what is left of the time in, reply out, or why not.
pub type XatlasWorker = Arc<dyn Fn(&[u8], Option<Duration>) -> Result<Vec<u8>, String> + Send + Sync>;

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
    // Limits of time, and the structure of the stage: the first choose no result, and what is not asked for leaves no trace.
    action.params = params(&StageSettings::Atlas(options.clone()), &TIME_KEYS);
    if options.sheets.is_none() {
        action.params.retain(|(name, _)| name != "sheets");
    }
    if options.density.is_none() {
        action.params.retain(|(name, _)| name != "density");
    }
    action.foreign = [foreign::GLAM, foreign::UVUNWRAP, foreign::MIKKTSPACE, foreign::LIBM].map(Into::into).into();
    action.numeric_class = Some(if options.unwrapper == UnwrapperName::Xatlas {
        action.foreign.push(foreign::XATLAS.into());
        foreign::cxx_class()
    } else {
        foreign::NUMERIC_CLASS.into()
    });
    action
}

/// What ends a run: the build, or the clock.
struct Limit<'a> {
    context: &'a Context<'a>,
    seconds: u64,
    until: Option<Instant>,
}

impl<'a> Limit<'a> {
    fn new(context: &'a Context<'a>, seconds: u32) -> Limit<'a> {
        let until = (seconds > 0).then(|| Instant::now() + Duration::from_secs(seconds.into()));
        Limit { context, seconds: seconds.into(), until }
    }

    fn stop(&self) -> Option<Stop> {
        if self.context.is_cancelled() {
            return Some(Stop::Cancelled);
        }
        self.left().is_some_and(|left| left.is_zero()).then_some(Stop::TimeLimit { seconds: self.seconds })
    }

    /// What is left of the time; `None`: no limit.
    fn left(&self) -> Option<Duration> {
        self.until.map(|until| until.saturating_duration_since(Instant::now()))
    }
}

/// The stage's report, and what of it should be heard.
#[derive(Serialize)]
struct Report {
    #[serde(flatten)]
    atlas: AtlasReport,
    /// Density rules that hold for nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    short: Vec<String>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
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
    let limit = Limit::new(context, options.time_limit);
    let ask = |request: &[u8]| match worker {
        Some(worker) => {
            worker(request, limit.left()).map_err(|why| limit.stop().map_or(UnwrapError::Worker(why), Into::into))
        }
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
        UnwrapperName::Planar => (UnwrapperChoice::Planar, &Planar),
    };
    let rules = options.density.as_ref().map_or(&[][..], |rules| &rules.0);
    let (densities, short) = densities(rules, &level.mesh.submeshes);
    let asked = AtlasOptions {
        size: options.size,
        padding: options.padding,
        unwrapper: choice,
        sheets: options.sheets.unwrap_or(1),
        densities,
    };
    let progress = |done: f32, doing: &str| context.progress(0.8 * done, doing);
    let stop = || limit.stop();
    let watch = Watch::new(&progress, &stop);
    let laid = atlas::unwrap_watched(&level, &asked, first, &watch);
    let (mut level, layout, report) = laid.map_err(|error| match error {
        AtlasError::Stopped { stop: Stop::Cancelled, .. } => ActionError::Cancelled,
        error => StageError::Atlas(error).into(),
    })?;
    context.progress(0.8, "tangents");
    level.mesh = mikktspace(&level.mesh, UvSource::AtlasUv).map_err(|e| StageError::Defect(e.to_string()))?;
    let warnings = report.warnings();
    let set = LodSet { levels: vec![level], layout: Some(layout), source_triangles };
    Ok(Outputs::new().with("levels", set.to_blob()).report(json(&Report { atlas: report, short, warnings })))
}

/// `[submesh_count]`, the factor of each, empty where all are 1; and the rules that match no submesh, in words.
fn densities(rules: &[DensityRule], submeshes: &[Submesh]) -> (Vec<f32>, Vec<String>) {
    let names: Vec<&str> = submeshes.iter().map(|submesh| submesh.name.as_str()).collect();
    let holds = |name: &&str| rules.iter().rev().find(|rule| matches(&rule.name, name));
    let factors: Vec<f32> = names.iter().map(|name| holds(name).map_or(1.0, |rule| rule.factor as f32)).collect();
    let idle = |rule: &&DensityRule| !names.iter().any(|name| matches(&rule.name, name));
    let short = rules.iter().filter(idle).map(|rule| unknown("density", "submesh", &rule.name, &names)).collect();
    (if factors.iter().all(|factor| *factor == 1.0) { Vec::new() } else { factors }, short)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule(name: &str, factor: f64) -> DensityRule {
        DensityRule { name: name.into(), factor }
    }

    #[test]
    fn the_last_rule_that_matches_holds_and_idle_ones_are_said() {
        let submeshes = ["head", "head-top", "arm"].map(|name| Submesh { name: name.into(), ..Submesh::default() });
        let (factors, short) = densities(&[rule("head*", 2.0), rule("*-top", 0.5)], &submeshes);
        assert_eq!((factors, short.len()), (vec![2.0, 0.5, 1.0], 0));
        let (factors, short) = densities(&[rule("leg", 2.0)], &submeshes);
        assert_eq!((factors.len(), short.len()), (0, 1));
        assert!(short[0].contains("\"leg\" matches no submesh"), "{short:?}");
        assert_eq!(densities(&[rule("*", 1.0)], &submeshes).0, Vec::<f32>::new());
    }

    #[test]
    fn limits_of_time_leave_no_trace_in_the_fingerprint_and_neither_do_keys_that_are_not_set() {
        let action = |options: &options::AtlasOptions| {
            let source = Source::Bytes(Arc::from(&b""[..]));
            action("id".into(), "label".into(), options, source, None).params
        };
        let standard = action(&options::AtlasOptions::default());
        let names: Vec<&str> = standard.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["unwrapper", "size", "padding"]);
        let hasty = options::AtlasOptions { time_limit: 1, ..Default::default() };
        assert_eq!(action(&hasty), standard);
        let spread = options::AtlasOptions { sheets: Some(2), ..Default::default() };
        assert_ne!(action(&spread), standard);
        let dense = options::DensityRules(vec![rule("head", 2.0)]);
        let dense = options::AtlasOptions { density: Some(dense), ..Default::default() };
        assert_eq!(action(&dense).len(), 4);
    }
}
