//! A build of one pipeline: the short way if nothing changed, else plan, run, and say what happened.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

use kiln_engine::{
    ActionError, ActionState, BuildOptions, BuildReport, ContentHash, Engine, EngineError, Event, Noop, Observer,
    Remote, RemoteError, RemoteOptions, TargetState, Verdict,
};
use kiln_pipeline::language::{Diagnostic, Sources};
use kiln_pipeline::plan::{PlanError, PlanOptions, Planned, folder_of, plan};
use kiln_pipeline::stages::{Backend, StageError};
use serde::Serialize;
use serde_json::Value;

use crate::debug_images::{StagePicture, debug_pictures};
use crate::summary::{AssetSummary, StageState, StageSummary, Summary};
use crate::{memory, worker};

/// What to build, and how. Every field has the default that the command has.
#[derive(Clone, Debug)]
pub struct Build {
    /// The pipeline file.
    pub pipeline: PathBuf,
    /// `KEY=VALUE` settings, as `--set` takes them.
    pub sets: Vec<String>,
    /// Where GPU passes run.
    pub backend: Backend,
    /// The cache's folder; `None`: `.kiln` beside the pipeline.
    pub cache: Option<PathBuf>,
    /// Stages at a time; `None`: the number of cores. Never changes what comes out.
    pub jobs: Option<usize>,
    /// Go on with other assets when one fails.
    pub keep_going: bool,
    /// Say what would run, run nothing.
    pub dry_run: bool,
    /// A cache that others share, asked for what the own one lacks; `None`: no other. Never changes what comes out.
    pub remote: Option<RemoteOptions>,
    /// Draw debug pictures of the stages that have any, fresh ones too. Changes nothing else.
    pub debug_pictures: bool,
    /// Set it to stop soon; nothing half is kept.
    pub cancel: Arc<AtomicBool>,
}

/// What a build came to.
#[derive(Debug)]
pub struct Outcome {
    /// For people and programs.
    pub summary: Summary,
    /// Doubtful things in the pipeline itself, with the texts that they point into.
    pub diagnostics: Vec<Diagnostic>,
    /// The texts.
    pub sources: Arc<Sources>,
    /// Whether it was cancelled.
    pub cancelled: bool,
    /// Where [`Build::debug_pictures`] asked for them.
    pub pictures: Vec<StagePicture>,
}

/// Why a build could not begin. What a single stage meets is in the summary.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The pipeline has defects, or cannot be read.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The cache cannot be used.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The remote's address or settings make no sense.
    #[error(transparent)]
    Remote(#[from] RemoteError),
}

impl Build {
    /// A build of `pipeline` with all defaults.
    pub fn new(pipeline: impl Into<PathBuf>) -> Build {
        Build {
            pipeline: pipeline.into(),
            sets: Vec::new(),
            backend: Backend::default(),
            cache: None,
            jobs: None,
            keep_going: false,
            dry_run: false,
            remote: None,
            debug_pictures: false,
            cancel: Arc::default(),
        }
    }

    fn cache_folder(&self) -> PathBuf {
        self.cache.clone().unwrap_or_else(|| folder_of(&self.pipeline).join(".kiln"))
    }

    /// The engine and the digest of all that makes the plan beside files.
    fn engine(&self) -> (Engine, ContentHash) {
        let name = self.pipeline.file_name().unwrap_or_default().to_string_lossy();
        let current = std::env::current_dir().unwrap_or_default();
        let has_paths = self.sets.iter().any(|set| set.starts_with("asset."));
        let key = format!(
            "kiln {} {} {:?} {:?} {:?}",
            env!("CARGO_PKG_VERSION"),
            kiln_pipeline::stages::identity(),
            self.backend,
            self.sets,
            has_paths.then_some(current)
        );
        (Engine::open(self.cache_folder(), &name), ContentHash::of(key.as_bytes()))
    }

    fn plan(&self) -> Result<Planned, PlanError> {
        let options = PlanOptions {
            sets: self.sets.clone(),
            current_folder: std::env::current_dir().unwrap_or_default(),
            backend: self.backend,
            xatlas: worker::find().map(|program| worker::runner(program, Arc::clone(&self.cancel))),
        };
        plan(&self.pipeline, &options)
    }

    /// Builds.
    ///
    /// # Errors
    /// The pipeline's defects, all at once, or a cache that cannot be used. A stage that fails is in the summary.
    pub fn run(&self, observer: &dyn Observer) -> Result<Outcome, BuildError> {
        let start = std::time::Instant::now();
        let (mut engine, key) = self.engine();
        let root = folder_of(&self.pipeline);
        // Where there is no cache yet there is nothing to find, and a broken pipeline shall not leave one behind.
        if !self.dry_run
            && self.cache_folder().is_dir()
            && let Some(note) = engine.fast_noop_check(&root, &key)
            && !self.debug_pictures
            && let Ok(mut summary) = serde_json::from_slice::<Summary>(&note)
        {
            summary.seconds = start.elapsed().as_secs_f64();
            return Ok(Outcome {
                summary,
                diagnostics: Vec::new(),
                sources: Arc::default(),
                cancelled: false,
                pictures: Vec::new(),
            });
        }
        let planned = self.plan()?;
        if let Some(options) = &self.remote {
            engine = engine.with_remote(Remote::open(options.clone())?);
        }
        let defaults = BuildOptions::default();
        let options = BuildOptions {
            jobs: self.jobs.unwrap_or(defaults.jobs).max(1),
            keep_going: self.keep_going,
            dry_run: self.dry_run,
            cancel: Arc::clone(&self.cancel),
            ..defaults
        };
        let peaks = Peaks { inner: observer, peaks: Mutex::new(vec![None; planned.plan.actions.len()]) };
        let report = engine.build(&planned.plan, &options, &peaks)?;
        let peaks = peaks.peaks.into_inner().unwrap_or_else(PoisonError::into_inner);
        let mut summary = summarise(&self.pipeline, &planned, &report, &peaks);
        summary.remote = engine.remote_report();
        if !self.dry_run && report.succeeded() {
            let note = serde_json::to_vec(&as_fresh(&summary)).expect("invariant: a summary is plain data");
            let noop = Noop { key, files: planned.files.clone(), folders: planned.folders.clone(), note };
            if let Err(error) = engine.remember_noop(&planned.plan, &report, &noop) {
                summary.warnings.push(error.to_string());
            }
        }
        let (pictures, missing) = match self.debug_pictures && !self.dry_run {
            true => debug_pictures(&engine, &planned, &report),
            false => Default::default(),
        };
        summary.warnings.extend(missing);
        summary.seconds = start.elapsed().as_secs_f64();
        let Planned { warnings, sources, .. } = planned;
        Ok(Outcome { summary, diagnostics: warnings, sources, cancelled: report.cancelled, pictures })
    }
}

/// Notes the process' peak memory while each action runs.
struct Peaks<'a> {
    inner: &'a dyn Observer,
    peaks: Mutex<Vec<Option<u64>>>,
}

impl Observer for Peaks<'_> {
    fn event(&self, event: &Event<'_>) {
        match event {
            Event::Started { .. } => memory::reset_peak(),
            Event::Finished { action, state: ActionState::Ran { .. }, .. } => {
                let mut peaks = self.peaks.lock().unwrap_or_else(PoisonError::into_inner);
                if let Some(slot) = peaks.get_mut(*action) {
                    *slot = memory::peak();
                }
            }
            _ => {}
        }
        self.inner.event(event);
    }
}

/// The summary that the next build gives if nothing changes.
fn as_fresh(summary: &Summary) -> Summary {
    let mut summary = summary.clone();
    for asset in &mut summary.assets {
        asset.state = "unchanged".into();
        for stage in &mut asset.stages {
            stage.state = StageState::Fresh;
            stage.reason = None;
            stage.peak_bytes = None;
        }
    }
    summary.fresh = true;
    summary.remote = None;
    summary
}

fn summarise(pipeline: &Path, planned: &Planned, report: &BuildReport, peaks: &[Option<u64>]) -> Summary {
    let mut summary = Summary {
        pipeline: pipeline.display().to_string(),
        assets: Vec::new(),
        warnings: report.warnings.clone(),
        short: Vec::new(),
        errors: Vec::new(),
        remote: None,
        fresh: report.nothing_to_do(),
        seconds: report.seconds,
    };
    for asset in &planned.assets {
        let mut stages = Vec::new();
        for (index, stage) in &asset.actions {
            let action = &report.actions[*index];
            let place = format!("{}, stage {stage}", asset.input);
            let (state, reason) = match &action.state {
                ActionState::Fresh => (StageState::Fresh, None),
                ActionState::Ran { reason, .. } => (StageState::Ran, Some(reason.to_string())),
                ActionState::WouldRun { reason } => (StageState::WouldRun, Some(reason.to_string())),
                ActionState::DependsOn { on } => (StageState::Depends, Some(report.actions[*on].id.clone())),
                ActionState::Failed(error) => {
                    summary.errors.extend(defects(error).into_iter().map(|d| format!("{place}: {d}")));
                    (StageState::Failed, Some(error.to_string()))
                }
                ActionState::Skipped { .. } => (StageState::Skipped, None),
            };
            let record = action.record.as_ref();
            let stage_report: Value =
                record.and_then(|r| serde_json::from_slice(&r.report).ok()).unwrap_or(Value::Null);
            summary.warnings.extend(action.warnings.iter().map(|w| format!("{place}: {w}")));
            soft_trouble(&place, &stage_report, &mut summary);
            stages.push(StageSummary {
                stage: stage.clone(),
                state,
                reason,
                seconds: record.map(|r| r.seconds),
                peak_bytes: peaks.get(*index).copied().flatten(),
                bytes: record.map_or(0, |r| r.outputs.iter().map(|o| o.length).sum()),
                report: stage_report,
            });
        }
        let target = &report.targets[asset.target];
        let state = match &target.state {
            TargetState::Unchanged => "unchanged",
            TargetState::Written { .. } => "written",
            TargetState::WouldWrite { .. } => "would-write",
            TargetState::DependsOn { .. } => "depends",
            TargetState::Failed(error) => {
                summary.errors.push(format!("{}: {error}", asset.output));
                "failed"
            }
            TargetState::Skipped => "skipped",
        };
        summary.assets.push(AssetSummary {
            input: asset.input.clone(),
            output: asset.output.clone(),
            state: state.into(),
            bytes: target.length.unwrap_or(0),
            stages,
        });
    }
    summary
}

/// Each defect of a failed stage.
fn defects(error: &ActionError) -> Vec<String> {
    if let ActionError::Failed(inner) = error
        && let Some(StageError::Import(import)) = inner.downcast_ref::<StageError>()
    {
        let family = import.to_string();
        let family = family.split(':').next().unwrap_or_default();
        return import.defects().iter().map(|d| format!("{family}: {d}")).collect();
    }
    vec![error.to_string()]
}

/// What reports say of budgets missed (`levels[].short`), of what was asked in vain (`short`), and of things repaired, replaced or left out (`repairs`, `warnings`).
fn soft_trouble(place: &str, report: &Value, summary: &mut Summary) {
    for (number, level) in report["levels"].as_array().into_iter().flatten().enumerate() {
        if let Some(short) = level["short"].as_str() {
            summary.short.push(format!("{place}, level {number}: {short}"));
        }
    }
    for vain in report["short"].as_array().into_iter().flatten() {
        summary.short.extend(vain.as_str().map(|text| format!("{place}: {text}")));
    }
    for repair in report["repairs"].as_array().into_iter().flatten() {
        let what = repair["sentence"].as_str().or(repair["kind"].as_str()).unwrap_or("repaired");
        let first = repair["first"].as_str().unwrap_or_default();
        summary.warnings.push(format!("{place}: {what} ({} times, first {first})", repair["count"]));
    }
    for warning in report["warnings"].as_array().into_iter().flatten() {
        if let Some(text) = warning.as_str() {
            summary.warnings.push(format!("{place}: {text}"));
        }
    }
}

/// Why an output would be built again.
#[derive(Debug, Serialize)]
pub struct WhyOutcome {
    /// The output, relative to the pipeline's folder.
    pub output: String,
    /// Whether a build would do nothing for it.
    pub fresh: bool,
    /// Each stage's verdict in order: id, and `fresh`, a reason, or what it depends on.
    pub stages: Vec<WhyStage>,
}

/// One stage's verdict.
#[derive(Debug, Serialize)]
pub struct WhyStage {
    /// The stage's id, or `output` for the file itself.
    pub stage: String,
    /// `fresh`, `stale`, `depends` or `fails`.
    pub verdict: &'static str,
    /// The first field that differs, with old and new value, in words.
    pub text: Option<String>,
    /// The same for programs.
    pub reason: Option<kiln_engine::StaleReason>,
}

/// Why `output` would be built again by `build.pipeline`; `None` if that pipeline does not build it. Runs nothing.
///
/// # Errors
/// As for [`Build::run`].
pub fn why(build: &Build, output: &Path) -> Result<Option<WhyOutcome>, BuildError> {
    let planned = build.plan()?;
    let root = folder_of(&build.pipeline);
    let wanted = absolute(output);
    let Some(asset) = planned.assets.iter().find(|asset| absolute(&root.join(&asset.output)) == wanted) else {
        return Ok(None);
    };
    let (mut engine, _) = build.engine();
    let answer = engine.why(&planned.plan, asset.target)?;
    let verdict = |stage: String, verdict: &Verdict| match verdict {
        Verdict::Fresh => WhyStage { stage, verdict: "fresh", text: None, reason: None },
        Verdict::Stale(reason) => {
            WhyStage { stage, verdict: "stale", text: Some(reason.to_string()), reason: Some(reason.clone()) }
        }
        Verdict::DependsOn { on } => {
            let name = asset.actions.iter().find(|(index, _)| index == on).map_or("another stage", |(_, name)| name);
            WhyStage { stage, verdict: "depends", text: Some(format!("depends on {name}")), reason: None }
        }
        Verdict::Fails { message } => {
            WhyStage { stage, verdict: "fails", text: Some(format!("would fail: {message}")), reason: None }
        }
    };
    let mut stages: Vec<WhyStage> = Vec::new();
    for (index, what) in &answer.actions {
        let name = asset.actions.iter().find(|(i, _)| i == index).map_or_else(String::new, |(_, name)| name.clone());
        stages.push(verdict(name, what));
    }
    stages.push(verdict("output".into(), &answer.target));
    let fresh = stages.iter().all(|s| s.verdict == "fresh");
    Ok(Some(WhyOutcome { output: asset.output.clone(), fresh, stages }))
}

/// The path without `.` and `..`, from the root; its folder's links resolved where it exists.
fn absolute(path: &Path) -> PathBuf {
    let full = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let (folder, name) = (full.parent().map(Path::to_path_buf).unwrap_or_default(), full.file_name());
    match (folder.canonicalize(), name) {
        (Ok(folder), Some(name)) => folder.join(name),
        _ => full,
    }
}
