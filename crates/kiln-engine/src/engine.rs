//! The door: open a cache, build a plan, ask why.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use crate::build::{Built, Session};
use crate::context::join;
use crate::disk::Stat;
use crate::error::{EngineError, IoError};
use crate::files::{Files, GRANULARITY, Seen};
use crate::hash::ContentHash;
use crate::noop::{self, Noop, Watched};
use crate::plan::{Plan, Source};
use crate::remote::{Remote, RemoteReport};
use crate::report::{BuildReport, Event, Observer, Why};
use crate::state::{self, Last, State};
use crate::store::Store;

/// When a write waits for the device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Durability {
    /// Never: for tests and throw-away builds.
    Never,
    /// For output files only: a power cut may cost cache entries, which are found damaged and made again.
    #[default]
    Outputs,
    /// For the cache too.
    Always,
}

/// How to build.
#[derive(Clone, Debug)]
pub struct BuildOptions {
    /// Actions at a time; never changes what comes out.
    pub jobs: usize,
    /// Go on with what does not depend on a failed action.
    pub keep_going: bool,
    /// Say what would be done, do nothing.
    pub dry_run: bool,
    /// Set it to stop soon: what runs is asked to end, nothing half is kept.
    pub cancel: Arc<AtomicBool>,
    /// When a write waits for the device.
    pub durability: Durability,
    /// The coarsest step in which the file system may stamp files; see the module `files`. Smaller is a promise of the caller.
    pub clock_granularity: Duration,
}

impl Default for BuildOptions {
    fn default() -> BuildOptions {
        BuildOptions {
            jobs: std::thread::available_parallelism().map_or(1, usize::from),
            keep_going: false,
            dry_run: false,
            cancel: Arc::default(),
            durability: Durability::default(),
            clock_granularity: Duration::from_nanos(GRANULARITY as u64),
        }
    }
}

/// A cache folder and the build state of one pipeline.
///
/// Many engines, in one process or in many, on one machine or on several that share the folder, may work at the same time.
pub struct Engine {
    store: Store,
    state: State,
    /// The file system's time before the caller read what makes its plan; set by a fast check that found work.
    opened_at: OnceLock<i64>,
    /// Stats and contents that the last build saw.
    seen: Vec<(String, Seen)>,
    granularity: i64,
}

impl Engine {
    /// An engine on the cache folder `cache` (usually `.kiln` beside the pipeline) for the pipeline called `name`.
    ///
    /// `name` names the state file: the same for the same pipeline, whatever folder it lies in. Reads one file, writes
    /// nothing, and never fails: a state that cannot be read is an empty one.
    pub fn open(cache: impl Into<PathBuf>, name: &str) -> Engine {
        let store = Store::new(cache.into());
        let state = State::open(store.state_path(&state_name(name)));
        Engine { store, state, opened_at: OnceLock::new(), seen: Vec::new(), granularity: GRANULARITY }
    }

    /// Asks `remote` for what the cache lacks while [`Engine::build`] runs, and sends it what ran if its mode is to write.
    ///
    /// Dry runs and [`Engine::why`] do not ask it: they say what would be done without it.
    pub fn with_remote(mut self, remote: Remote) -> Engine {
        self.store = self.store.with_remote(remote);
        self
    }

    /// What the remote did during the last build; `None` without one.
    pub fn remote_report(&self) -> Option<RemoteReport> {
        self.store.remote_report()
    }

    /// If a build would find everything fresh by the stats of files alone: the note left by [`Engine::remember_noop`].
    ///
    /// Call it before the pipeline is read or folders are listed; where it finds work it makes the cache folder, to learn the file
    /// system's time. `key` as in [`Noop`], `root` as in [`Plan`]. About 1 us a
    /// file. `None` says only that a build has to look closer.
    pub fn fast_noop_check(&self, root: &Path, key: &ContentHash) -> Option<Vec<u8>> {
        let hit = self.state.noop().and_then(|frame| noop::check(frame, key, root));
        if hit.is_none() && self.store.prepare().is_ok() {
            // Without a time there is nothing to remember by: the next build looks closer again.
            if let Ok(now) = self.store.now() {
                let _ = self.opened_at.set(now);
            }
        }
        hit
    }

    /// Builds a plan. What a single action or target meets is in the report.
    ///
    /// # Errors
    /// The plan contradicts itself, or the cache folder cannot be used.
    pub fn build(
        &mut self,
        plan: &Plan,
        options: &BuildOptions,
        observer: &dyn Observer,
    ) -> Result<BuildReport, EngineError> {
        let start = Instant::now();
        self.check(plan)?;
        if !options.dry_run {
            self.store.prepare()?;
        }
        self.state.load();
        self.granularity = i64::try_from(options.clock_granularity.as_nanos()).unwrap_or(i64::MAX);
        observer.event(&Event::Planned { actions: plan.actions.len(), targets: plan.targets.len() });
        let files = Files::new(&plan.root, &self.store, &self.state, self.granularity, options.dry_run);
        let session = Session::new(plan, options, observer, &self.store, &self.state, files);
        let work = || session.run();
        let built = if options.dry_run { work() } else { self.store.during(&options.cancel, work) };
        let Built { mut report, seen, lasts } = built;
        if !options.dry_run {
            self.keep(plan, seen, lasts);
        }
        report.warnings.extend(self.store.take_warnings());
        for message in &report.warnings {
            observer.event(&Event::Warning { action: None, message });
        }
        report.seconds = start.elapsed().as_secs_f64();
        Ok(report)
    }

    /// Why target `target` (an index) would be made again, or that it would not. Runs nothing, and changes nothing but that a
    /// damaged record is moved aside.
    ///
    /// # Errors
    /// The plan contradicts itself.
    ///
    /// # Panics
    /// If the plan has no such target.
    pub fn why(&mut self, plan: &Plan, target: usize) -> Result<Why, EngineError> {
        self.check(plan)?;
        self.state.load();
        let options = BuildOptions { dry_run: true, ..BuildOptions::default() };
        let files = Files::new(&plan.root, &self.store, &self.state, GRANULARITY, true);
        let session = Session::new(plan, &options, &crate::report::NoObserver, &self.store, &self.state, files);
        Ok(session.why(target))
    }

    /// The bytes of an output that a record names, out of the store; `None` if they are no longer there.
    pub fn blob(&self, hash: &ContentHash) -> Option<Arc<[u8]>> {
        self.store.blob(hash)
    }

    /// After a build that succeeded: lets [`Engine::fast_noop_check`] answer from now on. Returns whether it could: not if a
    /// file was written within the clock's granularity (the next build tries again), nor without a fast check before.
    ///
    /// # Errors
    /// The state file cannot be written.
    pub fn remember_noop(&mut self, plan: &Plan, report: &BuildReport, noop: &Noop) -> Result<bool, IoError> {
        let Some(watched) = self.watched(plan, report, noop) else { return Ok(false) };
        self.state.set_noop(noop::to_bytes(&noop.key, &noop.note, &watched));
        self.save(plan)?;
        Ok(true)
    }

    fn check(&self, plan: &Plan) -> Result<(), EngineError> {
        let defects = plan.defects();
        if defects.is_empty() { Ok(()) } else { Err(EngineError::InvalidPlan(defects)) }
    }

    /// Everything that a build without work looks at, sorted by path; `None` if some of it is too young.
    fn watched(&self, plan: &Plan, report: &BuildReport, noop: &Noop) -> Option<Vec<Watched>> {
        if !report.succeeded() || report.actions.len() != plan.actions.len() {
            return None;
        }
        let opened_at = *self.opened_at.get()?;
        let mut watched = Vec::new();
        for path in noop.files.iter().chain(&noop.folders) {
            let stat = noop::stat(&plan.root.join(path)).ok()?;
            let settled = |stat: &Stat| stat.latest() < opened_at.saturating_sub(self.granularity);
            watched.push((path.clone(), Some(stat.filter(settled)?)));
        }
        let mut paths = BTreeSet::new();
        for (action, done) in plan.actions.iter().zip(&report.actions) {
            for input in &action.inputs {
                if let Source::File { path } = &input.source {
                    paths.insert(path.clone());
                }
            }
            if let Some(folder) = &action.discovers {
                let found = &done.record.as_ref()?.discovered;
                paths.extend(found.iter().map(|(path, _)| join(folder, path)));
            }
        }
        paths.extend(plan.targets.iter().map(|target| target.path.clone()));
        for path in paths {
            let at = self.seen.binary_search_by(|(seen, _)| seen.cmp(&path)).ok()?;
            let seen = self.seen[at].1;
            match seen.hash {
                Some(_) => watched.push((path, Some(seen.stat?))),
                None => watched.push((path, None)),
            }
        }
        watched.sort_by(|a, b| a.0.cmp(&b.0));
        Some(watched)
    }

    /// Notes what the build saw.
    fn keep(&mut self, plan: &Plan, seen: Vec<(String, Seen)>, lasts: Vec<(usize, Last)>) {
        for (action, last) in lasts {
            self.state.set_last(&plan.actions[action].id, last);
        }
        for (path, seen) in &seen {
            let Some(hash) = seen.hash else { continue };
            let refuted = self.state.memo(path).is_some_and(|(_, known)| *known != hash);
            match seen.stat {
                Some(stat) => self.state.set_memo(path, stat, hash),
                // No file has this stat: what was known is known no more.
                None if refuted => self.state.set_memo(path, Stat::default(), hash),
                None => {}
            }
        }
        self.seen = seen;
        if let Err(error) = self.save(plan) {
            self.store.warn(format!("{error}; the next build will look closer"));
        }
    }

    /// Puts a wrong entry into the memo.
    #[cfg(test)]
    pub(crate) fn lie(&mut self, plan: &Plan, path: &str, stat: Stat, hash: ContentHash) {
        self.store.prepare().expect("a writable folder");
        self.state.load();
        self.state.set_memo(path, stat, hash);
        self.save(plan).expect("a writable folder");
    }

    fn save(&mut self, plan: &Plan) -> Result<(), IoError> {
        let seen = state::Seen {
            actions: plan.actions.iter().map(|action| action.id.as_str()).collect(),
            files: self.seen.iter().map(|(path, _)| path.as_str()).collect(),
        };
        self.state.save(&self.store, &seen)
    }
}

/// A file name for any pipeline name: its readable part and a digest.
fn state_name(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let readable: String = name.chars().map(plain).take(40).collect();
    format!("{readable}-{}", ContentHash::of(name.as_bytes()).short())
}
