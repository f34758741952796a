//! A build of one pipeline: the short way if nothing changed, else plan, run, and say what happened.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

use kiln_engine::{
    ActionError, ActionState, BuildOptions, BuildReport, ContentHash, Dependencies, Engine, EngineError, Event,
    Executor, ExecutorError, Group, Local, Look, Memory, Observer, Remote, RemoteError, RemoteOptions, TargetState,
    Verdict, Verification,
};
use kiln_pipeline::language::{Diagnostic, Sources};
use kiln_pipeline::plan::{PlanError, PlanOptions, Planned, PlannedAsset, folder_of, plan};
use kiln_pipeline::stages::{Backend, StageError};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::claims::{self, Built};
use crate::debug_images::{StagePicture, debug_pictures};
use crate::summary::{AssetSummary, StageState, StageSummary, Summary, Untouched};
use crate::{farm, memory, worker};

/// What to build, and how. Every field has the default that the command has.
#[derive(Clone, Debug)]
pub struct Build {
    /// The pipeline file.
    pub pipeline: PathBuf,
    /// `KEY=VALUE` settings, as `--set` takes them.
    pub sets: Vec<String>,
    /// These models alone, relative to the pipeline's folder (or, if there is none, to the current one); empty: all. The build
    /// state of the whole pipeline stays as it is.
    pub assets: Vec<String>,
    /// Cache folders that are read where the own one lacks something, such as those that `kiln stage run` left; never written.
    pub with: Vec<PathBuf>,
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
    /// Recompute a sample of what the remote gave ([`RemoteOptions::check_share`]); a record that lied is an error, and what was made
    /// from it is made again.
    pub check_claims: bool,
    /// Draw debug pictures of the stages that have any, fresh ones too. Changes nothing else.
    pub debug_pictures: bool,
    /// Count the assets about which nothing changed instead of listing them in the summary.
    pub brief: bool,
    /// Give [`Outcome::dependencies`].
    pub dependencies: bool,
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
    /// What the outputs depend on, where [`Build::dependencies`] asked for it; not known of a cancelled build or a dry run.
    pub dependencies: Option<Dependencies>,
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
    /// Stages cannot run elsewhere.
    #[error(transparent)]
    Executor(#[from] ExecutorError),
    /// A model that the pipeline does not build.
    #[error("the pipeline does not build `{asset}`{help}")]
    NoAsset {
        /// As it was given.
        asset: String,
        /// What it builds.
        help: String,
    },
    /// A stage that the pipeline does not have.
    #[error("{asset} has no stage `{stage}`; it has {stages}")]
    NoStage {
        /// The model.
        asset: String,
        /// As it was given.
        stage: String,
        /// Those that it has.
        stages: String,
    },
    /// A command that was planned for something else.
    #[error(
        "{label}: parameters, versions or machine are not what was planned ({now} instead of {expected}); run `kiln plan` again"
    )]
    OtherPlan {
        /// The stage.
        label: String,
        /// As it was given.
        expected: String,
        /// What it is.
        now: String,
    },
}

impl Build {
    /// A build of `pipeline` with all defaults.
    pub fn new(pipeline: impl Into<PathBuf>) -> Build {
        Build {
            pipeline: pipeline.into(),
            sets: Vec::new(),
            assets: Vec::new(),
            with: Vec::new(),
            backend: Backend::default(),
            cache: None,
            jobs: None,
            keep_going: false,
            dry_run: false,
            remote: None,
            check_claims: false,
            debug_pictures: false,
            brief: false,
            dependencies: false,
            cancel: Arc::default(),
        }
    }

    pub(crate) fn cache_folder(&self) -> PathBuf {
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
        let engine = match self.assets.is_empty() {
            true => Engine::open(self.cache_folder(), &name),
            false => Engine::stateless(self.cache_folder()),
        };
        (engine.with_layers(self.with.clone()), ContentHash::of(key.as_bytes()))
    }

    fn plan(&self, only: Option<Vec<String>>) -> Result<Planned, PlanError> {
        let options = PlanOptions {
            sets: self.sets.clone(),
            current_folder: std::env::current_dir().unwrap_or_default(),
            backend: self.backend,
            xatlas: worker::find().map(|program| worker::runner(program, Arc::clone(&self.cancel))),
            only,
        };
        plan(&self.pipeline, &options)
    }

    /// The plan of all, or of the assets that were asked for.
    pub(crate) fn plan_asked(&self) -> Result<Planned, BuildError> {
        if self.assets.is_empty() {
            return Ok(self.plan(None)?);
        }
        let root = folder_of(&self.pipeline);
        let mut names: Vec<String> = self.assets.iter().map(|asset| name_below(&root, asset)).collect();
        names.sort();
        names.dedup();
        let no_asset = |asset: &String| {
            let all = self.plan(None)?.assets;
            let near = kiln_pipeline::language::nearest(asset, all.iter().map(|asset| asset.input.as_str()));
            let count = all.len();
            let help =
                near.map_or_else(|| format!(" among its {count} models"), |near| format!("; did you mean `{near}`?"));
            Err(BuildError::NoAsset { asset: asset.clone(), help })
        };
        let planned = match self.plan(Some(names.clone())) {
            Ok(planned) => planned,
            Err(PlanError::Pipeline { .. }) if names.len() == 1 => return no_asset(&names[0]),
            Err(error) => return Err(error.into()),
        };
        match names.iter().find(|name| !planned.assets.iter().any(|asset| asset.input == **name)) {
            Some(absent) => no_asset(absent),
            // What is said of the whole pipeline is no matter of a part of it.
            None => Ok(Planned { warnings: Vec::new(), ..planned }),
        }
    }

    /// The plan of changed assets alone; `None` where that will not do: another device, or the pipeline changed just now.
    fn plan_some(&self, engine: &Engine, names: &[String]) -> Option<Planned> {
        let planned = self.plan(Some(names.to_vec())).ok()?;
        let found: Vec<&str> = planned.assets.iter().map(|asset| asset.input.as_str()).collect();
        let device = planned.assets.first().map(|asset| device_of(&planned, asset))?;
        // All assets go through the same stages: one that did not change tells the device of all.
        let other = engine.briefs().find(|(name, _)| !names.iter().any(|changed| changed == name));
        let same = other.is_none_or(|(_, brief)| Brief::parse(brief).device == device);
        (found == names && same).then_some(planned)
    }

    pub(crate) fn options(&self) -> BuildOptions {
        let defaults = BuildOptions::default();
        BuildOptions {
            jobs: self.jobs.unwrap_or(defaults.jobs).max(1),
            keep_going: self.keep_going,
            dry_run: self.dry_run,
            cancel: Arc::clone(&self.cancel),
            ..defaults
        }
    }

    /// Builds.
    ///
    /// # Errors
    /// The pipeline's defects, all at once, or a cache that cannot be used. A stage that fails is in the summary.
    pub fn run(&self, observer: &dyn Observer) -> Result<Outcome, BuildError> {
        self.run_on(&Local, observer)
    }

    /// Builds, with an executor that runs what is stale elsewhere beforehand.
    ///
    /// # Errors
    /// As for [`Build::run`], or the executor's own.
    pub fn run_on(&self, executor: &dyn Executor, observer: &dyn Observer) -> Result<Outcome, BuildError> {
        let start = std::time::Instant::now();
        let (mut engine, key) = self.engine();
        let local = executor.is_local();
        let options = BuildOptions { keep_going: self.keep_going || !local, ..self.options() };
        // Where there is no cache yet there is nothing to find, and a broken pipeline shall not leave one behind.
        let may_look = !self.dry_run && self.assets.is_empty() && self.cache_folder().is_dir();
        let look = if may_look { engine.look(&folder_of(&self.pipeline), &key, &options) } else { Look::Unknown };
        if look == Look::Fresh
            && !self.debug_pictures
            && let Some(mut summary) = self.remembered(&engine)
        {
            summary.seconds = start.elapsed().as_secs_f64();
            return Ok(Outcome {
                summary,
                diagnostics: Vec::new(),
                sources: Arc::default(),
                cancelled: false,
                pictures: Vec::new(),
                dependencies: self.dependencies.then(|| engine.dependencies()),
            });
        }
        let some = match &look {
            Look::Changed(names) if !self.debug_pictures => self.plan_some(&engine, names),
            _ => None,
        };
        let partial = some.is_some();
        let mut planned = match some {
            Some(planned) => planned,
            None => {
                engine.widen();
                self.plan_asked()?
            }
        };
        if let Some(options) = &self.remote {
            engine = engine.with_remote(Remote::open(options.clone())?);
        }
        if !local && !self.dry_run {
            farm::execute(self, executor, &mut engine, &mut planned, observer)?;
        }
        let peaks = Peaks { inner: observer, peaks: Mutex::new(vec![None; planned.plan.actions.len()]) };
        let Built { report, remote, lies } =
            claims::build(&mut engine, &planned.plan, &options, &peaks, self.check_claims)?;
        let peaks = peaks.peaks.into_inner().unwrap_or_else(PoisonError::into_inner);
        let parts: Vec<Part> = planned.assets.iter().map(|asset| part(asset, &report, &peaks)).collect();
        let kept = match self.dry_run || !self.assets.is_empty() {
            true => Ok(()),
            false => engine.remember(&planned.plan, &report, &memory(key, &planned, &parts)),
        };
        let mut summary = self.summary(&report, parts);
        summary.remote = remote;
        summary.errors.extend(lies);
        summary.warnings.extend(kept.err().map(|error| format!("{error}; the next build will look closer")));
        if partial {
            self.add_untouched(&mut summary, &engine);
            planned.warnings.clear();
        }
        if self.dry_run {
            for (asset, planned) in summary.assets.iter_mut().zip(&planned.assets) {
                asset.resolved = Some(planned.resolved.clone());
            }
        }
        let (pictures, missing) = match self.debug_pictures && !self.dry_run {
            true => debug_pictures(&engine, &planned, &report),
            false => Default::default(),
        };
        summary.warnings.extend(missing);
        summary.seconds = start.elapsed().as_secs_f64();
        let known = self.dependencies && !self.dry_run && !report.cancelled;
        let Planned { warnings, sources, .. } = planned;
        Ok(Outcome {
            summary,
            diagnostics: warnings,
            sources,
            cancelled: report.cancelled,
            pictures,
            dependencies: known.then(|| engine.dependencies()),
        })
    }

    /// Builds twice in scratch caches, the second time one stage at a time on one thread, and compares: no stage may give other
    /// bytes for the same fingerprint, nor other bytes than this cache has of it. Writes no output.
    ///
    /// # Errors
    /// As for [`Build::run`].
    pub fn verify(&self, observer: &dyn Observer) -> Result<Verification, BuildError> {
        let planned = self.plan_asked()?;
        let (engine, _) = self.engine();
        let on_one_thread =
            |work: &mut (dyn FnMut() + Send)| match rayon::ThreadPoolBuilder::new().num_threads(1).build() {
                Ok(pool) => pool.install(work),
                // No further thread can be had: this one does it.
                Err(_) => work(),
            };
        Ok(engine.verify(&planned.plan, &self.options(), observer, &on_one_thread)?)
    }

    /// The summary of a build that found nothing to do; `None` if it is not known any more.
    fn remembered(&self, engine: &Engine) -> Option<Summary> {
        let mut summary = Summary::of(&self.pipeline);
        summary.fresh = true;
        self.add_untouched(&mut summary, engine);
        (self.brief || summary.untouched == Untouched::default()).then_some(summary)
    }

    /// Adds the assets that are not in the summary: listed, or counted where that will do or no more is known.
    fn add_untouched(&self, summary: &mut Summary, engine: &Engine) {
        let mut listed = std::mem::take(&mut summary.assets).into_iter().peekable();
        let mut last = ("", Brief::default());
        for (group, (name, brief)) in engine.briefs().enumerate() {
            if let Some(asset) = listed.next_if(|asset| asset.input == name) {
                summary.assets.push(asset);
                continue;
            }
            // Most assets have the same to say.
            if last.0 != brief {
                last = (brief, Brief::parse(brief));
            }
            summary.warnings.extend_from_slice(&last.1.warnings);
            summary.short.extend_from_slice(&last.1.short);
            let note = if self.brief { None } else { engine.note(group) };
            match note.and_then(|note| serde_json::from_slice::<AssetSummary>(&note).ok()) {
                Some(asset) => summary.assets.push(asset),
                None => {
                    summary.untouched.assets += 1;
                    summary.untouched.stages += last.1.stages;
                }
            }
        }
        summary.assets.extend(listed);
    }

    fn summary(&self, report: &BuildReport, parts: Vec<Part>) -> Summary {
        let mut summary = Summary::of(&self.pipeline);
        summary.fresh = report.nothing_to_do();
        summary.warnings.clone_from(&report.warnings);
        for part in parts {
            summary.warnings.extend(part.passing);
            summary.warnings.extend(part.brief.warnings);
            summary.short.extend(part.brief.short);
            summary.errors.extend(part.errors);
            summary.assets.push(part.asset);
        }
        summary
    }
}

/// What is at hand of an asset about which nothing changed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Brief {
    stages: usize,
    /// Classes of device that its stages depend on.
    device: String,
    warnings: Vec<String>,
    short: Vec<String>,
}

impl Brief {
    fn parse(text: &str) -> Brief {
        serde_json::from_str(text).unwrap_or_default()
    }
}

/// What a build came to for one asset.
struct Part {
    asset: AssetSummary,
    brief: Brief,
    /// Warnings of this build alone.
    passing: Vec<String>,
    errors: Vec<String>,
}

/// The classes of device that an asset's stages depend on.
fn device_of(planned: &Planned, asset: &PlannedAsset) -> String {
    let classes = asset.actions.iter().filter_map(|(action, _)| planned.plan.actions[*action].device_class.clone());
    classes.collect::<Vec<_>>().join("; ")
}

/// What the next build has to know to find out what there is to do.
fn memory(key: ContentHash, planned: &Planned, parts: &[Part]) -> Memory {
    let json = "invariant: summaries are plain data";
    let group = |(asset, part): (&PlannedAsset, &Part)| {
        let brief = Brief { device: device_of(planned, asset), ..part.brief.clone() };
        Group {
            name: asset.input.clone(),
            actions: asset.actions.iter().map(|(action, _)| *action).collect(),
            targets: vec![asset.target],
            brief: serde_json::to_string(&brief).expect(json),
            note: serde_json::to_vec(&as_fresh(&part.asset)).expect(json),
        }
    };
    let groups = planned.assets.iter().zip(parts).map(group).collect();
    Memory { key, files: planned.files.clone(), folders: planned.folders.clone(), groups }
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

/// What the next build says of an asset if nothing changes.
fn as_fresh(asset: &AssetSummary) -> AssetSummary {
    let mut asset = asset.clone();
    asset.state = "unchanged".into();
    for stage in &mut asset.stages {
        stage.state = StageState::Fresh;
        stage.reason = None;
        stage.peak_bytes = None;
    }
    asset
}

/// The stage that an action of the plan belongs to.
fn stage_of(asset: &PlannedAsset, action: usize) -> &str {
    asset.actions.iter().find(|(index, _)| *index == action).map_or("another asset's stage", |(_, name)| name)
}

/// What a build came to for `asset`.
fn part(asset: &PlannedAsset, report: &BuildReport, peaks: &[Option<u64>]) -> Part {
    let (mut brief, mut passing, mut errors) = (Brief::default(), Vec::new(), Vec::new());
    let mut stages = Vec::new();
    for (index, stage) in &asset.actions {
        let action = &report.actions[*index];
        let place = format!("{}, stage {stage}", asset.input);
        let (state, reason) = match &action.state {
            ActionState::Fresh => (StageState::Fresh, None),
            ActionState::Ran { reason, .. } => (StageState::Ran, Some(reason.to_string())),
            ActionState::WouldRun { reason } => (StageState::WouldRun, Some(reason.to_string())),
            ActionState::DependsOn { on } => (StageState::Depends, Some(stage_of(asset, *on).to_owned())),
            ActionState::Failed(error) => {
                errors.extend(defects(error).into_iter().map(|d| format!("{place}: {d}")));
                (StageState::Failed, Some(error.to_string()))
            }
            ActionState::Skipped { .. } => (StageState::Skipped, None),
        };
        let record = action.record.as_ref();
        let stage_report: Value = record.and_then(|r| serde_json::from_slice(&r.report).ok()).unwrap_or(Value::Null);
        passing.extend(action.warnings.iter().map(|w| format!("{place}: {w}")));
        soft_trouble(&place, &stage_report, &mut brief);
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
    brief.stages = stages.len();
    let target = &report.targets[asset.target];
    let state = match &target.state {
        TargetState::Unchanged => "unchanged",
        TargetState::Written { .. } => "written",
        TargetState::WouldWrite { .. } => "would-write",
        TargetState::DependsOn { .. } => "depends",
        TargetState::Failed(error) => {
            errors.push(format!("{}: {error}", asset.output));
            "failed"
        }
        TargetState::Skipped => "skipped",
    };
    let asset = AssetSummary {
        input: asset.input.clone(),
        output: asset.output.clone(),
        state: state.into(),
        bytes: target.length.unwrap_or(0),
        stages,
        resolved: None,
    };
    Part { asset, brief, passing, errors }
}

/// Each defect of a failed stage.
pub(crate) fn defects(error: &ActionError) -> Vec<String> {
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
fn soft_trouble(place: &str, report: &Value, brief: &mut Brief) {
    for (number, level) in report["levels"].as_array().into_iter().flatten().enumerate() {
        if let Some(short) = level["short"].as_str() {
            brief.short.push(format!("{place}, level {number}: {short}"));
        }
    }
    for vain in report["short"].as_array().into_iter().flatten() {
        brief.short.extend(vain.as_str().map(|text| format!("{place}: {text}")));
    }
    for repair in report["repairs"].as_array().into_iter().flatten() {
        let what = repair["sentence"].as_str().or(repair["kind"].as_str()).unwrap_or("repaired");
        let first = repair["first"].as_str().unwrap_or_default();
        brief.warnings.push(format!("{place}: {what} ({} times, first {first})", repair["count"]));
    }
    for warning in report["warnings"].as_array().into_iter().flatten() {
        if let Some(text) = warning.as_str() {
            brief.warnings.push(format!("{place}: {text}"));
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
    let planned = build.plan(None)?;
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
            let text = format!("depends on {}", stage_of(asset, *on));
            WhyStage { stage, verdict: "depends", text: Some(text), reason: None }
        }
        Verdict::Fails { message } => {
            WhyStage { stage, verdict: "fails", text: Some(format!("would fail: {message}")), reason: None }
        }
    };
    let mut stages: Vec<WhyStage> = Vec::new();
    for (index, what) in &answer.actions {
        stages.push(verdict(stage_of(asset, *index).to_owned(), what));
    }
    stages.push(verdict("output".into(), &answer.target));
    let fresh = stages.iter().all(|s| s.verdict == "fresh");
    Ok(Some(WhyOutcome { output: asset.output.clone(), fresh, stages }))
}

/// How a plan names a model: relative to the pipeline's folder.
fn name_below(root: &Path, asset: &str) -> String {
    let plain = asset.strip_prefix("./").unwrap_or(asset);
    if root.join(plain).is_file() {
        return plain.to_owned();
    }
    let here = Path::new(plain);
    match here.strip_prefix(root) {
        Ok(below) if here.is_file() => below.to_string_lossy().into_owned(),
        _ => plain.to_owned(),
    }
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
