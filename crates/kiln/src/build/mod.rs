//! A build of one pipeline: the short way if nothing changed, else plan, run, and say what happened.
//!
//! Parts: `part` (what it came to for one asset, and what the next build is told of it), `why`.

mod part;
mod why;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use kiln_engine::{
    BuildOptions, BuildReport, ContentHash, Dependencies, Engine, EngineError, Executor, ExecutorError, Local, Look,
    Observer, Remote, RemoteError, RemoteOptions, Verification,
};
use kiln_pipeline::language::{Diagnostic, Sources};
use kiln_pipeline::plan::{PlanError, PlanOptions, Planned, folder_of, plan};
use kiln_pipeline::stages::Backend;

use crate::claims::{self, Built};
use crate::debug_images::{StagePicture, debug_pictures};
use crate::summary::{AssetSummary, Summary, Untouched};
use crate::{farm, worker};
pub(crate) use part::defects;
use part::{Brief, Part, Peaks, device_of, memory, part};
pub use why::{WhyOutcome, WhyStage, why};

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
        let peaks = Peaks::new(observer, planned.plan.actions.len());
        let Built { report, remote, lies } =
            claims::build(&mut engine, &planned.plan, &options, &peaks, self.check_claims)?;
        let peaks = peaks.into_peaks();
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
