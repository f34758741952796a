//! One stage of one asset as a hermetic command: declared inputs, declared outputs, no clock, no network.
//!
//! ```text
//! plan the one asset; keep the actions that the stage needs; build them in the cache
//! receipt: the names and hashes of what the stage gave       written only if it differs: what depends on it can stay as it is
//! ```
//! With an intact cache the stage alone runs, since what is before it is fresh by its records. These come from the cache, or from
//! the folders in [`Build::with`]: caches that earlier stages left, which are read and never written. A *fragment* is such a
//! folder that holds the records and blobs of one stage and nothing else, the same bytes on every run: an output that any build
//! system can keep.
//!
//! The pipeline, the model and what belongs to it must lie there for every stage, since a stage's fingerprint goes back to them.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::Path;

use kiln_engine::{
    Action, ActionError, ActionState, BuildOptions, BuildReport, Engine, Event, Observer, OutputRecord, Plan, Remote,
};
use kiln_pipeline::plan::{Planned, PlannedAsset, folder_of};

use crate::build::{Build, BuildError};
use crate::dependencies;
use crate::summary::StageState;

/// What to run.
#[derive(Clone, Debug)]
pub struct StageRun {
    /// The pipeline, its settings, the cache; [`Build::assets`] names the one model, or the pipeline has only one.
    pub build: Build,
    /// The stage as [`Graph`](crate::Graph) names it, such as `lods` or `lods/collapse`.
    pub stage: String,
    /// Fail where something before the stage would have to run.
    pub only: bool,
    /// The cache folder shall be a fragment: it is emptied first, and afterwards holds what this stage gave, without its times.
    /// Implies `only`.
    pub fragment: bool,
    /// Fail unless the stage declares this (the digest in [`Graph`](crate::Graph), or its beginning).
    pub expect: Option<String>,
}

/// What came of it.
#[derive(Debug)]
pub struct StageOutcome {
    /// Asset and stage, for people.
    pub label: String,
    /// How the stage ended.
    pub state: StageState,
    /// Why it ran, or how it failed.
    pub reason: Option<String>,
    /// How long it took, seconds, if it ran.
    pub seconds: Option<f64>,
    /// Stages before it that had to run.
    pub before: usize,
    /// What it gave, in its own order.
    pub outputs: Vec<OutputRecord>,
    /// Files that it read, relative to the pipeline's folder.
    pub inputs: Vec<String>,
    /// Files that it looked for in vain, relative to the pipeline's folder.
    pub absent: Vec<String>,
    /// What failed, in words.
    pub errors: Vec<String>,
    /// Soft trouble.
    pub warnings: Vec<String>,
    /// It was stopped.
    pub cancelled: bool,
}

impl StageOutcome {
    /// Whether the stage's results are in the cache.
    pub fn succeeded(&self) -> bool {
        self.errors.is_empty() && matches!(self.state, StageState::Fresh | StageState::Ran)
    }

    /// Names, lengths and hashes of the outputs: what depends on the stage need not look at it again while these bytes are the same.
    pub fn receipt(&self) -> String {
        let line = |output: &OutputRecord| format!("{} {} {}\n", output.hash.hex(), output.length, output.name);
        std::iter::once("kiln receipt 1\n".to_owned()).chain(self.outputs.iter().map(line)).collect()
    }

    /// A depfile for `target`, as GCC writes it: what the stage itself read. What it depends on through other stages is in their
    /// receipts.
    pub fn depfile(&self, target: &Path, root: &Path) -> String {
        let absent = self.absent.iter().map(|path| dependencies::folder_of(path));
        let inputs: BTreeSet<String> =
            self.inputs.iter().map(String::as_str).chain(absent).map(|path| dependencies::place(root, path)).collect();
        let mut text = String::new();
        dependencies::rule(&mut text, std::iter::once(target.to_string_lossy().into_owned()), inputs.iter().cloned());
        for input in inputs {
            dependencies::rule(&mut text, std::iter::once(input), std::iter::empty());
        }
        text
    }
}

/// The name of an action's stage in its asset.
pub(crate) fn stage_name(action: &Action) -> &str {
    action.id.rsplit_once('#').map_or(action.id.as_str(), |(_, stage)| stage)
}

/// Counts what runs.
struct Ran<'a> {
    inner: &'a dyn Observer,
}

impl Observer for Ran<'_> {
    fn event(&self, event: &Event<'_>) {
        // The outcome says it better.
        if !matches!(event, Event::Finished { .. } | Event::Started { .. }) {
            self.inner.event(event);
        }
    }
}

impl StageRun {
    /// Runs it.
    ///
    /// # Errors
    /// The pipeline's defects, no such asset or stage, or a cache that cannot be used. What a stage meets is in the outcome.
    pub fn run(&self, observer: &dyn Observer) -> Result<StageOutcome, BuildError> {
        let planned = self.build.plan_asked()?;
        let asset = one_asset(&planned)?;
        let action = find(&planned.plan, asset, &self.stage)?;
        self.check_expected(&planned.plan.actions[action])?;
        let (mut plan, _) = planned.plan.upto(action);
        let last = plan.actions.len() - 1;
        if self.only || self.fragment {
            for before in &mut plan.actions[..last] {
                let absent = format!("{}: neither the cache nor a folder of --with has its result", before.label);
                before.run = std::sync::Arc::new(move |_| Err(ActionError::failed(absent.clone())));
            }
        }
        let cache = self.build.cache_folder();
        if self.fragment {
            empty_fragment(&cache).map_err(|error| fragment_error("empty", &cache, error))?;
        }
        let mut engine = Engine::stateless(&cache).with_layers(self.build.with.clone());
        if let Some(options) = &self.build.remote {
            engine = engine.with_remote(Remote::open(options.clone())?);
        }
        let options = BuildOptions { dry_run: false, timed: !self.fragment, ..self.build.options() };
        let report = engine.build(&plan, &options, &Ran { inner: observer })?;
        let mut outcome = outcome(&plan, &report);
        if outcome.succeeded()
            && !self.build.with.is_empty()
            && let Some(record) = &report.actions[last].record
            && !engine.adopt(record)?
        {
            outcome.errors.push(format!("{}: its results vanished from the folders of --with", outcome.label));
        }
        if self.fragment {
            tidy_fragment(&cache).map_err(|error| fragment_error("tidy", &cache, error))?;
        }
        Ok(outcome)
    }

    fn check_expected(&self, action: &Action) -> Result<(), BuildError> {
        let Some(expected) = &self.expect else { return Ok(()) };
        let now = action.declares().hex();
        if expected.len() >= 8 && now.starts_with(expected.as_str()) {
            return Ok(());
        }
        let now = now[..expected.len().clamp(8, now.len())].to_owned();
        Err(BuildError::OtherPlan { label: action.label.clone(), expected: expected.clone(), now })
    }
}

fn one_asset(planned: &Planned) -> Result<&PlannedAsset, BuildError> {
    match planned.assets.as_slice() {
        [one] => Ok(one),
        all => {
            let help = format!(": it builds {} models, and one must be named", all.len());
            Err(BuildError::NoAsset { asset: "all of them at once".into(), help })
        }
    }
}

/// The action of a stage of an asset.
fn find(plan: &Plan, asset: &PlannedAsset, stage: &str) -> Result<usize, BuildError> {
    let names = || asset.actions.iter().map(|(action, _)| (*action, stage_name(&plan.actions[*action])));
    names().find(|(_, name)| *name == stage).map(|(action, _)| action).ok_or_else(|| BuildError::NoStage {
        asset: asset.input.clone(),
        stage: stage.to_owned(),
        stages: names().map(|(_, name)| name).collect::<Vec<_>>().join(", "),
    })
}

fn outcome(plan: &Plan, report: &BuildReport) -> StageOutcome {
    let (last, before) = report.actions.split_last().expect("invariant: the stage itself is in the plan");
    let mut errors = Vec::new();
    for action in &report.actions {
        if let ActionState::Failed(error) = &action.state {
            errors.extend(crate::build::defects(error).into_iter().map(|defect| format!("{}: {defect}", action.label)));
        }
    }
    let (state, reason, seconds) = match &last.state {
        ActionState::Fresh => (StageState::Fresh, None, None),
        ActionState::Ran { reason, seconds } => (StageState::Ran, Some(reason.to_string()), Some(*seconds)),
        ActionState::Failed(error) => (StageState::Failed, Some(error.to_string()), None),
        _ => (StageState::Skipped, None, None),
    };
    let action = plan.actions.last().expect("invariant: the stage itself is in the plan");
    let mut inputs: Vec<String> = declared_files(action).map(str::to_owned).collect();
    let mut absent = Vec::new();
    if let (Some(folder), Some(record)) = (&action.discovers, &last.record) {
        for (path, content) in &record.discovered {
            let path = if folder.is_empty() { path.clone() } else { format!("{folder}/{path}") };
            if content.is_some() { &mut inputs } else { &mut absent }.push(path);
        }
    }
    StageOutcome {
        label: last.label.clone(),
        state,
        reason,
        seconds,
        before: before.iter().filter(|action| matches!(action.state, ActionState::Ran { .. })).count(),
        outputs: last.record.as_ref().map(|record| record.outputs.clone()).unwrap_or_default(),
        inputs,
        absent,
        errors,
        warnings: report.actions.iter().flat_map(|a| &a.warnings).chain(&report.warnings).cloned().collect(),
        cancelled: report.cancelled,
    }
}

/// Files that an action declares.
pub(crate) fn declared_files(action: &Action) -> impl Iterator<Item = &str> {
    action.inputs.iter().filter_map(|input| match &input.source {
        kiln_engine::Source::File { path } => Some(path.as_str()),
        _ => None,
    })
}

// --- fragments ---

/// What a fragment keeps of a cache.
const KEPT: [&str; 3] = ["actions", "blobs", "lists"];

fn fragment_error(doing: &'static str, path: &Path, source: io::Error) -> BuildError {
    BuildError::Engine(kiln_engine::IoError { doing, path: path.to_path_buf(), source }.into())
}

/// Empties a folder that is a fragment, or empty, or not there; refuses any other.
fn empty_fragment(folder: &Path) -> io::Result<()> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        entries => entries?,
    };
    let names: Vec<_> = entries.map(|entry| Ok(entry?.file_name())).collect::<io::Result<_>>()?;
    if names.is_empty() {
        return Ok(());
    }
    if names != ["v1"] || folder.join("v1/state").exists() {
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, "it holds something else than a fragment"));
    }
    fs::remove_dir_all(folder.join("v1"))
}

/// Leaves records, lists and blobs.
fn tidy_fragment(folder: &Path) -> io::Result<()> {
    for (below, keeps) in [(folder.to_path_buf(), &["v1"][..]), (folder.join("v1"), &KEPT)] {
        for entry in fs::read_dir(&below)? {
            let entry = entry?;
            if keeps.iter().any(|keep| entry.file_name() == *keep) {
                continue;
            }
            if entry.file_type()?.is_dir() { fs::remove_dir_all(entry.path())? } else { fs::remove_file(entry.path())? }
        }
    }
    Ok(())
}

/// The folder that the outcome's paths are relative to.
pub fn root(run: &StageRun) -> std::path::PathBuf {
    folder_of(&run.build.pipeline)
}
