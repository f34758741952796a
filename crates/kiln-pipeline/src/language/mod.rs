//! The language of pipelines: TOML in, a typed [`Pipeline`] or every defect at its place out.
//!
//! Problem. A pipeline comes as text, with a chain of parents, settings from the command line and overrides for some of
//! many assets. Out comes a chain of stages with typed options that is known to fit together, or a list of everything
//! that is wrong, each with file, span and the next step. Nothing here reads a file: parents and folders come through
//! closures, so that whoever builds can record what was read.
//!
//! ```text
//! load(file):
//!   for the file and each parent:   parse TOML, keep spans; check version, top keys, ids
//!   document = file laid over its parents (stages by id, lists replaced)
//!   put --set values into the document
//!   read [asset] and stages against the table of keys           (options, setting)
//!   walk the chain: what each stage takes and gives             (chain)
//!   for each override: the same two steps with its values put in
//!   any error -> diagnostics only, sorted by place
//! expand_inputs: list folders by the input's glob -> one build a match
//! Pipeline::for_asset(path): document + matching overrides -> stages
//! ```
//!
//! One table. Keys, types, defaults, ranges, sentences and the names a key takes are declared once, in [`options`]; the
//! parser, [`reference`](reference::reference), `--set` and the resolved form are made from it. Keys of the language
//! that this version does not implement stand in the same table under `later` and are refused by name.
//!
//! Limits. Two budgets of different kinds (a share and a count) cannot be compared before the asset is imported; that
//! a level of one kind is finer than one of another is found when it is cut. After a syntax error, only what stands
//! before it is checked further.

mod density;
pub mod diagnostic;
pub mod inputs;
pub mod length;
mod metric;
pub mod options;
pub mod pipeline;
pub mod reference;
pub mod setting;
pub mod value;

mod chain;
mod compose;
mod dom;
mod read;

#[cfg(test)]
mod tests;

use std::io;
use std::sync::Arc;

pub use compose::{LANGUAGE, normal};
pub use diagnostic::{Code, Diagnostic, Family, Origin, Severity, Source, Sources, has_errors, nearest, render_plain};
pub use inputs::{AssetBuild, DirEntry, Expansion, expand_inputs};
pub use length::{Length, Unit};
pub use options::{Kind, LevelBudget};
pub use pipeline::{
    AssetPath, AssetPaths, Override, Pipeline, RelativeTo, ResolvedPipeline, Stage, StageInput, StageSettings,
};

/// What [`load`] gives.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// `None` exactly if a diagnostic is an error.
    pub pipeline: Option<Pipeline>,
    /// Every defect, sorted by text (the file, its parents, the settings) and position.
    pub diagnostics: Vec<Diagnostic>,
    /// The texts that they point into.
    pub sources: Arc<Sources>,
}

/// Reads the pipeline `text` of the file `name` (`/`-separated), with parents through `read_base` (called with a path
/// made from `name`'s folder and the `base` that was found) and `--set` arguments `KEY=VALUE` applied in order.
pub fn load(name: &str, text: &str, sets: &[String], read_base: &dyn Fn(&str) -> io::Result<String>) -> Loaded {
    let mut report = diagnostic::Report::default();
    let pipeline = build(name, text, sets, read_base, &mut report);
    let sources = Arc::clone(&report.sources);
    let diagnostics = report.finish();
    let pipeline = pipeline.filter(|_| !has_errors(&diagnostics));
    Loaded { pipeline, diagnostics, sources }
}

fn build(
    name: &str,
    text: &str,
    sets: &[String],
    read_base: &dyn Fn(&str) -> io::Result<String>,
    report: &mut diagnostic::Report,
) -> Option<Pipeline> {
    let composed = compose::files(name, text, read_base, report)?;
    let compose::Composed { mut document, language, syntax } = composed;
    compose::settings(&mut document, sets, report);

    let asset = read::asset(&document, report);
    let drafts = read::stages(&document, report);
    let overrides = compose::overrides(&document, report);
    if !syntax.is_empty() {
        // What follows a syntax error may have been swallowed by it, so neither it nor its absence means anything.
        report.retain(|diagnostic| {
            diagnostic.code == Code::Syntax
                || !matches!(diagnostic.code, Code::KeyMissing | Code::StageNone | Code::StageIdMissing)
                    && syntax.iter().all(|(source, at)| diagnostic.source != *source || diagnostic.span.end < *at)
        });
        return None;
    }
    let stages = chain::check(drafts, report);
    check_overrides(&document, &overrides, report);

    let sources = Arc::clone(&report.sources);
    Some(Pipeline { language, asset: asset?, stages: stages?, overrides, sources, document })
}

/// Reports what each override alone would break: the defects that the document has only with its values.
fn check_overrides(document: &dom::Table, overrides: &[Override], report: &mut diagnostic::Report) {
    let known = report.found().to_vec();
    for rule in overrides {
        let mut changed = document.clone();
        compose::assign(&mut changed, &rule.set);
        let mut scratch = diagnostic::Report::new(Arc::clone(&report.sources));
        let drafts = read::stages(&changed, &mut scratch);
        chain::check(drafts, &mut scratch);
        let place = report.place(&rule.origin);
        let fresh =
            scratch.finish().into_iter().filter(|diagnostic| !known.contains(diagnostic)).map(|mut diagnostic| {
                let within = |one: &compose::Assignment| {
                    let span = &one.entry.node.origin;
                    span.source == diagnostic.source
                        && span.span.start <= diagnostic.span.start
                        && diagnostic.span.end <= span.span.end
                };
                if !rule.set.iter().any(within) {
                    diagnostic.message = format!("{} (with the override at {place})", diagnostic.message);
                }
                diagnostic
            });
        report.extend(fresh.collect::<Vec<_>>());
    }
}
